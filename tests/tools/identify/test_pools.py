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
    PoolNeeds,
    Pools,
    PoolSizes,
    Remainders,
    chosen_share,
    needs_of,
    pooled,
    remainders_of,
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
    """Pools with W = 0 and ``needs`` (R, k, n_y); ``recording_of``: recording by calibration drive."""
    drives = recording_of or {n: n for n in names}
    calibration = calibrate(dict.fromkeys(drives, 1.0), 0.1, recordings=Recordings(recording_of or {}))
    nothing = np.zeros(needs.shape[1:])
    sizes = PoolSizes(np.ones(len(nothing), int), np.ones(len(nothing), int))
    return Pools(sizes, nothing, nothing + 1e-6, dict(zip(names, needs, strict=True)), calibration)


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
    needs = np.random.default_rng(2).uniform(0.1, 1.0, (6, 4, 2))
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
    assert pools.beside(3.0, 2.0).scale() == pytest.approx(1.5 * pools.scale())


def pools_name(i: int) -> str:
    """Recording i of the test above."""
    return "abcdef"[i]


def test_a_further_recording_exceeds_the_threshold_at_most_at_the_stated_rate():
    random, alarms, trials = np.random.default_rng(3), 0, 400
    for _ in range(trials):
        needs = random.lognormal(0.0, 1.0, (12, 3, 1)) * random.lognormal(0.0, 1.0, (12, 1, 1))
        names = [str(i) for i in range(11)]
        pools = hand_made(needs[:11], names).calibrated(names, 0.1, Recordings())
        alarms += (needs[11] * pools.scale()).max() > pools.calibration.threshold
    assert pools.calibration.alpha == 0.1
    assert alarms / trials <= 0.1
    assert alarms > 0


def test_the_share_sees_the_smallest_error_and_a_pool_of_one_recording_is_silent():
    random = np.random.default_rng(4)
    starts = np.arange(0, 40 * int(ESTIMATOR.hop[5]))
    experiments = [SimpleNamespace(name=n, recording=n) for n in "ab"]
    parts = [
        needs_of(
            e,
            [frames_of(random, 5, starts), FrameSet(6, *np.zeros((2, 0, 2)), starts[:0])],
            ESTIMATOR,
            SIZES,
            2,
        )
        for e in experiments
    ]
    both = PoolNeeds.joined(parts)
    floor = np.full((K, 2), 1e-3)
    W, silent = chosen_share(both, floor)
    assert set(np.argwhere(~silent)[:, 0]) == {5}
    for j in range(2):
        typical = np.percentile(both.sample["size"][:, j], 90)
        seen = CANDIDATES + np.maximum(both.largest[5, :, j], 1e-3) / typical
        assert W[5, j] == CANDIDATES[seen.argmin()]
    assert chosen_share(parts[0], floor)[1].all()
    assert chosen_share(PoolNeeds(both.largest + 1e3, both.seen, both.sample), floor)[1].all()


def test_the_excitation_says_which_gain_error_a_pool_shows():
    starts = np.arange(0, 40 * int(ESTIMATOR.hop[5]))
    s = frames_of(np.random.default_rng(5), 5, starts)
    W, B = np.full((K, 2), 0.1), np.tile([2.0, 1.0], (K, 1))
    v = np.full(int(starts[-1] + ESTIMATOR.length[5]), 10.0)
    e = SimpleNamespace(name="a", recording="a")
    remainders = remainders_of(e, [s], v, ESTIMATOR, SIZES, W)
    met = Remainders.joined([remainders, remainders]).excitation(W, B, 1.5)
    assert np.all(met.sample["floor"] == 0.1)
    assert np.median(met.sample["limit"]) == pytest.approx(0.045, rel=0.3)
    size = np.concatenate([size for _, size in pooled(s, ESTIMATOR, SIZES.counts(5)[:1])])
    on_grid = size[starts % ESTIMATOR.hop[5] == 0]
    assert met.strongest["dead"].max() == pytest.approx(
        1 / (0.1 + 1 / max(on_grid[:, 0].max() / 2, on_grid[:, 1].max()))
    )
    largest = max(float((along - 0.1 * z).max()) for along, z in pooled(s, ESTIMATOR, SIZES.counts(5)))
    assert remainders.largest.max() == pytest.approx(largest)


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
        stated = (pools.needs[name] / pools.bound()).max() * unit
        assert largest <= stated * (1 + 1e-4)
        shown.append(largest / stated)
    assert max(shown) > 0.8


def test_pools_are_read_back_as_written(identified):
    pools = stage.load(identified).pools
    again = Pools.from_dict(
        {k: v if isinstance(v, dict) else np.array(v).tolist() for k, v in pools.to_dict().items()}
    )
    assert np.array_equal(again.scale(), pools.scale()) and again.scores() == pools.scores()
    assert np.array_equal(np.isinf(again.floor), np.isinf(pools.floor))
