"""The limit of detection is that of a test with full knowledge of the vehicle and of the spread of drives."""

import numpy as np
import pytest
from scipy.stats import norm

from lpvguard.identify.bounds import FrameSet
from lpvguard.identify.limit import LimitSums

NOISE = 0.3


def drive(random: np.random.Generator, gain: float, frames: int = 200) -> tuple[np.ndarray, FrameSet]:
    """Frames of a drive in speed cell 1 and bin 2: E = gain Z + w with E|w|^2 = NOISE^2."""
    Z, w = random.standard_normal((2, frames, 1, 2)) @ [1, 1j] / np.sqrt(2)
    return np.ones(frames, int), FrameSet(2, gain * Z + NOISE * w, Z, np.arange(frames))


def sums(random: np.random.Generator, gains: np.ndarray) -> LimitSums:
    return LimitSums.joined(LimitSums.from_frames([drive(random, g)], (2, 3, 1)) for g in gains)


def test_a_matched_filter_at_the_limit_finds_half_of_the_faults():
    random = np.random.default_rng(4)
    sums_of_drive = sums(random, np.full(40, 0.05))
    cell, k, size = np.ones(1, int), np.full(1, 2), np.full((1, 1), 3.0)
    limit = sums_of_drive.gain_error(1.5, cell, k, size)[0]
    assert limit == pytest.approx(1.5 * NOISE / np.sqrt(2) / 3.0, rel=0.05)
    w = NOISE / np.sqrt(2) * random.standard_normal(20000)
    shares = [((g * 3.0 + w) / 3.0 > limit).mean() for g in (0.0, limit)]
    assert shares == pytest.approx([0.0668, 0.5], abs=0.02)


def test_drives_that_differ_raise_the_limit():
    random = np.random.default_rng(5)
    S, between = sums(random, 0.1 * random.standard_normal(400)).spread()
    assert S[1, 2, 0] == pytest.approx(NOISE**2, rel=0.02)
    assert np.sqrt(between[1, 2, 0]) == pytest.approx(0.1, rel=0.1)
    assert np.isnan(S[0]).all() and np.isnan(S[1, :2]).all()


def test_a_single_drive_or_frame_tells_of_no_limit():
    random = np.random.default_rng(6)
    alone = sums(random, np.zeros(1))
    where = np.ones(1, int), np.full(1, 2), np.ones((1, 1))
    assert np.isnan(alone.gain_error(1.0, *where)).all()
    short = LimitSums.joined(
        LimitSums.from_frames([drive(random, 0.0, frames=1)], (2, 3, 1)) for _ in range(3)
    )
    assert not short.drives.any() and np.isnan(short.gain_error(1.0, *where)).all()


def test_looks_share_the_level():
    sums_of_drive = sums(np.random.default_rng(7), np.zeros(10))
    one = sums_of_drive.quantile(0.1, drives=10, held=np.full(3, 1e9))
    assert one == pytest.approx(1.2816, abs=1e-4)
    # 200 frames a drive in pools of 50, to either side: eight looks
    assert norm.cdf(sums_of_drive.quantile(0.1, drives=10, held=np.full(3, 50))) ** 8 == pytest.approx(0.9)
