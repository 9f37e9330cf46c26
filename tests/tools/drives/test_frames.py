"""The estimator against its defining sums, and the conditions under which a frame counts."""

from __future__ import annotations

import re

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.drives.frames import Estimator
from lpvguard.vehicle.nominal import NominalModel


@pytest.fixture(scope="module")
def estimator(g80, g80_model):
    return Estimator.of(g80, g80_model)


def test_a_sinusoid_in_the_bin_reads_its_amplitude_and_others_do_not_see_dc(estimator):
    n = np.arange(4000)
    for k in range(estimator.n_bins):
        x = np.column_stack([0.7 * np.cos(estimator.omega[k] * estimator.Ts * n + 0.3), np.full(len(n), 5.0)])
        X = estimator.transform(x, k, np.array([0, 11]))
        expected = 0.7 * np.cos(0.3) if k == 0 else 0.7
        np.testing.assert_allclose(np.abs(X[0, 0]), expected, rtol=1e-9)
        np.testing.assert_allclose(np.abs(X[:, 1]), 5.0 if k == 0 else 0.0, atol=1e-9)


def test_transform_is_the_defining_sum(estimator):
    x = np.random.default_rng(3).standard_normal((2000, 2))
    for k in (0, 4, estimator.n_bins - 1):
        N = estimator.length[k]
        starts = np.array([0, 5, 2000 - N])
        w = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(N) / N)
        scale = (2 if estimator.cycles[k] else 1) / w.sum()
        rotation = np.exp(-2j * np.pi * estimator.cycles[k] * np.arange(N) / N)
        direct = [[scale * np.sum(w * rotation * x[s : s + N, j]) for j in range(2)] for s in starts]
        np.testing.assert_allclose(estimator.transform(x, k, starts), direct, atol=1e-13)


def brute_counted(estimator, v, k):
    N, out = int(estimator.length[k]), []
    good, run = [], 0
    for speed in v:
        run = run + 1 if estimator.speed_range[0] <= speed <= estimator.speed_range[1] else 0
        good.append(run > estimator.settle)
    for s in range(len(v) - N + 1):
        piece = v[s : s + N]
        steady = np.all(np.abs(piece / piece.mean() - 1) <= estimator.speed_tolerance)
        out.append(bool(steady and all(good[s : s + N])))
    return np.array(out, bool)


@pytest.mark.parametrize("seed", range(4))
def test_counted_frames_are_those_of_the_definition(estimator, seed):
    random = np.random.default_rng(seed)
    v = np.repeat(random.uniform(2.0, 20.0, 12), random.integers(20, 120, 12)) * (
        1 + 0.05 * random.standard_normal()
    )
    v = np.convolve(v, np.ones(15) / 15, mode="same")
    for k in (estimator.n_bins - 1, estimator.n_bins - 4):
        np.testing.assert_array_equal(estimator.counted(v, k), brute_counted(estimator, v, k))


def test_a_drive_shorter_than_the_frame_has_none(estimator):
    assert estimator.counted(np.full(40, 10.0), 0).shape == (0,)


def test_the_identifier_moves_with_every_part_of_the_definition(estimator):
    from dataclasses import replace

    changed = [
        replace(estimator, Ts=0.01),
        replace(estimator, settle=estimator.settle + 1),
        replace(estimator, speed_tolerance=0.16),
        replace(estimator, speed_range=(3.5, 20.0)),
        replace(estimator, cycles=np.r_[0, estimator.cycles[1:] + 1]),
    ]
    identifiers = {e.identifier() for e in [estimator, *changed]}
    assert len(identifiers) == len(changed) + 1


def test_bins_too_high_for_the_core_name_the_highest_frequency(g80):
    """At 25 Hz a fifth of the rate is beyond what the core can spread over samples; the message says how far
    it goes, and that far it goes."""
    frames = g80.frames.model_copy(update={"f_min_hz": 0.5, "f_max_hz": 5.0, "periods": 3})
    slow = g80.model_copy(update={"Ts_s": 0.04, "frames": frames})
    with pytest.raises(
        InputError, match=r"lower f_max_hz to [0-9.]+ or less, or take more periods"
    ) as refused:
        Estimator.of(slow, NominalModel(slow))
    highest = float(re.search(r"f_max_hz to ([0-9.]+)", str(refused.value))[1])
    fits = slow.model_copy(update={"frames": frames.model_copy(update={"f_max_hz": highest})})
    assert Estimator.of(fits, NominalModel(fits)).n_bins > 4
    longer = slow.model_copy(update={"frames": frames.model_copy(update={"periods": 8})})
    assert Estimator.of(longer, NominalModel(longer)).omega[-1] > 0.9 * 2 * np.pi * 4.0
