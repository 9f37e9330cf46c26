"""Pools of frames: what they sum, which bound holds them, and how often a further recording exceeds it."""

from types import SimpleNamespace

import numpy as np
import pytest

from lpvguard.core.compiled import Core
from lpvguard.drives.frames import Estimator
from lpvguard.identify import identification as stage
from lpvguard.identify.bounds import FrameSet
from lpvguard.identify.calibration import Recordings, calibrate
from lpvguard.identify.identification import DriveSet
from lpvguard.identify.pools import (
    CANDIDATES,
    FEWEST_OF_SPEED,
    SPEEDS,
    PoolNeeds,
    Pools,
    PoolSizes,
    Remainders,
    chosen_share,
    needs_of,
    pooled,
    reached,
    remainders_of,
    speeds_of,
)
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project

PROJECT = load_project("g80")
ESTIMATOR = Estimator.from_project(PROJECT, NominalModel(PROJECT))
SIZES = PoolSizes.for_project(PROJECT, ESTIMATOR)
K = ESTIMATOR.n_bins


def frames_of(random: np.random.Generator, k: int, starts: np.ndarray, gain: complex = 0.3) -> FrameSet:
    """Frames of two outputs in bin k, E = gain Z + w."""
    Z, w = random.standard_normal((2, len(starts), 2, 2)) @ [1, 1j]
    return FrameSet(k, gain * Z + 0.1 * w, Z, starts)


def hand_made(needs: np.ndarray, names: list[str], recording_of: dict[str, str] | None = None) -> Pools:
    """Pools with ``needs`` (R, SPEEDS, k, n_y), all shown; ``recording_of``: recording by drive."""
    drives = recording_of or {n: n for n in names}
    calibration = calibrate(dict.fromkeys(drives, 1.0), 0.1, recordings=Recordings(recording_of or {}))
    nothing = np.zeros(needs.shape[1:])
    sizes = PoolSizes(*np.ones((2, needs.shape[2]), int))
    own, by_name = np.ones(needs.shape[1:3], bool), dict(zip(names, needs, strict=True))
    return Pools(sizes, nothing + 0.1, nothing + 1e-6, own, by_name, by_name, calibration)


def test_a_fault_fills_a_pool_in_the_time_allowed():
    length, hop = ESTIMATOR.length * PROJECT.Ts_s, ESTIMATOR.hop * PROJECT.Ts_s
    held = SIZES.parts * SIZES.frames
    span = length + (held - 1) * hop
    allowed = PROJECT.evaluation.found_within_s
    assert np.all((span <= allowed + 1e-9) | (held == 1))
    assert np.all(span + SIZES.parts * hop > allowed) and held.max() > 50
    assert SIZES.counts(K - 1) == range(int(held[-1] - SIZES.frames[-1] + 1), int(held[-1] + 1))


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_pool_sums_the_frames_that_end_before_it(count):
    hop = int(ESTIMATOR.hop[-1])
    starts = np.r_[np.arange(3, 5 * hop), np.arange(8 * hop + 1, 12 * hop + 7)]
    s = frames_of(np.random.default_rng(count), K - 1, starts)
    ((along, size),) = pooled(s, ESTIMATOR, [count])
    at = {int(start): i for i, start in enumerate(starts)}
    for i in range(0, len(starts), 7):
        members = [at[x] for n in range(count) if (x := int(starts[i]) - n * hop) in at]
        power = (np.abs(s.Z[members]) ** 2).sum(axis=0)
        expected = np.abs((s.Z[members].conj() * s.E[members]).sum(axis=0)) / np.sqrt(power)
        assert along[i] == pytest.approx(expected) and size[i] == pytest.approx(np.sqrt(power))


def test_a_score_is_the_remainder_over_the_bound_of_the_others():
    needs = np.random.default_rng(2).uniform(0.1, 1.0, (6, SPEEDS, 4, 2))
    recording_of = {"a1": "a", "a2": "a", "b": "b", "c": "c", "d": "d"}
    pools = hand_made(needs, ["a", "b", "c", "d", "e", "f"], recording_of)
    for without, out in ((None, None), ("a2", 0), ("d", 3)):
        kept = [i for i in range(6) if i != out]
        scores = pools.scores(without)
        assert set(scores) == {d for d, r in recording_of.items() if out is None or r != pools_name(out)}
        for drive, score in scores.items():
            i = "abcdef".index(recording_of[drive])
            others = np.max([needs[m] for m in kept if m != i], axis=0)
            assert score == pytest.approx((needs[i] / others).max())
        assert pools.bound(None if out is None else pools_name(out)) == pytest.approx(needs[kept].max(axis=0))
    assert hand_made(needs[:1], ["a"]).scores() == {"a": pytest.approx(needs[0].max() / 1e-6)}
    assert pools.speeds_text().endswith("12 of 12 parts of the speed range and bins")
    assert pools.scale() == pytest.approx(np.stack([1 / needs.max(axis=0), np.full(needs.shape[1:], 10)], 2))
    assert pools.beside(3.0, 2.0).scale() == pytest.approx(1.5 * pools.scale())


def pools_name(i: int) -> str:
    """Recording i of the test above."""
    return "abcdef"[i]


def test_a_further_recording_exceeds_the_threshold_at_most_at_the_stated_rate():
    random, alarms, trials = np.random.default_rng(3), 0, 400
    for _ in range(trials):
        needs = random.lognormal(0.0, 1.0, (12, SPEEDS, 3, 1)) * random.lognormal(0.0, 1.0, (12, 1, 1, 1))
        names = [str(i) for i in range(11)]
        pools = hand_made(needs[:11], names).calibrated(names, 0.1, Recordings())
        alarms += (needs[11] * pools.scale()[:, :, 0]).max() > pools.calibration.threshold
    assert pools.calibration.alpha == 0.1
    assert alarms / trials <= 0.1
    assert alarms > 0


def test_frames_near_the_ends_of_a_part_also_set_its_bounds():
    estimator, k = ESTIMATOR, K - 1
    low, high = estimator.speed_range
    v = np.linspace(low, high, 400 * int(estimator.hop[k]))
    s = frames_of(np.random.default_rng(1), k, np.arange(0, len(v) - int(estimator.length[k]), 7))
    mean, part = speeds_of(s, np.concatenate([[0.0], np.cumsum(v)]), estimator)
    position = (mean - low) / (high - low)
    assert np.array_equal(part, np.floor(3 * position)) and set(part) == {0, 1, 2}
    inside = reached(mean, estimator.speed_range)
    assert inside[-1].all()
    for at in range(SPEEDS):
        assert np.array_equal(inside[at], (position >= at / 3 - 0.1) & (position <= (at + 1) / 3 + 0.1))


def needs_at(speeds: list[float], bin_with_frames: int = 5) -> PoolNeeds:
    """Needs of recordings, each of one of the ``speeds`` [m/s]."""
    starts = np.arange(0, 40 * int(ESTIMATOR.hop[5]))
    random = np.random.default_rng(4)
    parts = []
    for i, speed in enumerate(speeds):
        e = SimpleNamespace(name=str(i), recording=str(i))
        frames = [frames_of(random, bin_with_frames, starts), FrameSet(6, *np.zeros((2, 0, 2)), starts[:0])]
        v = np.full(int(starts[-1] + ESTIMATOR.length[5]), speed)
        parts.append(needs_of(e, frames, v, ESTIMATOR, SIZES, 2))
    return PoolNeeds.joined(parts)


def test_the_share_sees_the_smallest_error_and_a_pool_of_one_recording_is_silent():
    low, high = ESTIMATOR.speed_range
    both, floor = needs_at([low + 0.5, high - 0.5]), np.full((K, 2), 1e-3)
    W, silent, own = chosen_share(both, floor)
    assert not own.any()  # of all speeds, where recordings are few
    assert set(np.argwhere(~silent)[:, 1]) == {5} and not silent[:, 5].any()
    for j in range(2):
        typical = np.percentile(both.sample["size"][both.sample["group"] == SPEEDS * K + 5, j], 90)
        seen = np.maximum(CANDIDATES, np.maximum(both.largest[-1, 5, :, j], 1e-3) / typical)
        assert np.all(W[:, 5, j] == CANDIDATES[seen.argmin()])
    assert chosen_share(needs_at([low + 0.5]), floor)[1].all()
    assert chosen_share(PoolNeeds(both.largest + 1e3, both.seen, both.sample), floor)[1].all()


def test_a_part_of_the_speeds_has_its_own_bounds_where_recordings_suffice():
    low, high = ESTIMATOR.speed_range
    slow = [low + 0.5] * FEWEST_OF_SPEED
    needs = needs_at([*slow, high - 0.5])
    largest = needs.largest.copy()
    largest[[1, 2, 3]] += 2.0
    W, _, own = chosen_share(PoolNeeds(largest, needs.seen, needs.sample), np.full((K, 2), 1e-3))
    assert np.array_equal(own[:, 5], [True, False, False]) and not own[:, 6].any()
    assert np.all(W[0, 5] < W[1, 5]) and np.all(W[1] == W[2])
    assert not chosen_share(needs_at(slow[1:]), np.full((K, 2), 1e-3))[2].any()


def test_the_excitation_says_which_gain_error_a_pool_shows():
    starts = np.arange(0, 40 * int(ESTIMATOR.hop[5]))
    s = frames_of(np.random.default_rng(5), 5, starts)
    W, B = np.full((SPEEDS, K, 2), 0.1), np.tile([2.0, 1.0], (SPEEDS, K, 1))
    B[[0, 2]] = 1e3
    low, high = ESTIMATOR.speed_range
    v = np.full(int(starts[-1] + ESTIMATOR.length[5]), (low + high) / 2)
    e = SimpleNamespace(name="a", recording="a")
    own = np.ones((SPEEDS, K), bool)
    remainders = remainders_of(e, [s], v, ESTIMATOR, SIZES, W, own)
    met = Remainders.joined([remainders, remainders]).excitation(W, B, 1.5)
    assert np.median(met.sample["limit"]) == pytest.approx(0.045, rel=0.3)
    size = np.concatenate([size for _, size in pooled(s, ESTIMATOR, SIZES.counts(5)[:1])])
    on_grid = size[starts % ESTIMATOR.hop[5] == 0]
    error = 1 / max(on_grid[:, 0].max() / 2, on_grid[:, 1].max())
    assert met.strongest["dead"].max() == pytest.approx(1 / max(0.1, error))
    of_pools = list(pooled(s, ESTIMATOR, SIZES.counts(5)))
    largest = max(float(along[along > 0.1 * z].max()) for along, z in of_pools)
    assert remainders.largest.max() == pytest.approx(largest)
    assert not remainders.largest[[0, 2]].any()
    assert remainders.blocks is not None
    assert np.array_equal(remainders.blocks.max(axis=0), remainders.largest)
    of_all = remainders_of(e, [s], v, ESTIMATOR, SIZES, W, ~own)
    assert np.all(of_all.largest == remainders.largest[1])
    assert of_all.blocks is not None and np.array_equal(of_all.blocks.max(axis=0), remainders.largest)
    nothing = remainders_of(e, [s], v, ESTIMATOR, SIZES, W + 1e3, own)
    assert not nothing.largest.any()


def test_the_core_reads_no_more_than_the_remainders_say(g80, synthetic, identified, core: Core):
    stored = stage.load(identified)
    drives = DriveSet(g80, NominalModel(g80), synthetic)
    pools = stored.pools
    assert pools is not None and (pools.scale() > 0).any()
    unit = stored.calibration.exported / pools.calibration.exported
    shown = []
    for name in list(drives.experiments)[:4]:
        frames = core.monitor().run_drive(drives.load(name)[0]).frames
        largest = frames.pooled[frames.counted].max()
        stated = (pools.shown[name] / pools.bound()).max() * unit
        assert largest <= stated * (1 + 1e-4)
        shown.append(largest / stated)
    assert max(shown) > 0.8


def test_pools_are_read_back_as_written(identified):
    pools = stage.load(identified).pools
    again = Pools.from_dict(
        {k: v if isinstance(v, dict) else np.array(v).tolist() for k, v in pools.to_dict().items()}
    )
    assert "0 of 33 parts" in again.speeds_text() and "fewer than 20 recordings" in again.speeds_text()
    assert np.array_equal(again.scale(), pools.scale()) and again.scores() == pools.scores()
    assert np.array_equal(np.isinf(again.floor), np.isinf(pools.floor))
