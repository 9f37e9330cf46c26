"""Split conformal calibration against its definition: ranks counted out, bounds worked out from the binomial
distribution, and words that state those numbers."""

import json
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import binom

from lpvguard.base.errors import InputError
from lpvguard.drives.tables import Experiment
from lpvguard.identify.calibration import (
    NO_RECORDINGS,
    Calibration,
    GroupThreshold,
    Peak,
    Recordings,
    calibrate,
    change_score,
    energy_score,
    peaks,
    score,
)
from lpvguard.identify.drive_set import DriveSet, require_calibration


def scores_of(n: int, seed: int = 0) -> dict[str, float]:
    """Distinct scores above 1 in no order."""
    values = 1.0 + 0.1 * np.random.default_rng(seed).permutation(np.arange(1, n + 1))
    return {f"d{k}": float(v) for k, v in enumerate(values)}


@pytest.mark.parametrize("alpha", ["0.05", "0.1", "0.2", "0.3", "0.9"])
@pytest.mark.parametrize("n", [8, 9, 10, 19, 20, 29, 40])
def test_the_threshold_is_the_rank_of_the_theorem_and_the_bound_that_of_the_binomial(n, alpha):
    scores = scores_of(n)
    calibration = calibrate(scores, float(alpha))
    exact = (n + 1) * (1 - Fraction(alpha))
    rank = -(-exact.numerator // exact.denominator)
    if n < 9 or rank > n:
        assert calibration.alpha is None is calibration.conditional_bound
        assert calibration.threshold == max(scores.values())
        assert calibration.claim() == f"alpha is not stated: too few calibration drives ({n})"
        return
    assert calibration.threshold == sorted(scores.values())[rank - 1]
    assert calibration.alpha == float(alpha)
    # A false-alarm probability above p would put rank scores or more below the threshold too rarely.
    p = brentq(lambda p: binom.sf(rank - 1, n, 1 - p) - 0.05, 1e-9, 1 - 1e-9, xtol=1e-12)
    assert calibration.conditional_bound == pytest.approx(p, abs=1e-9)
    assert calibration.claim() == (
        f"alpha {float(alpha):g} from {n} drives, with 95 % confidence below "
        f"{calibration.conditional_bound:.3f}"
    )


def test_the_bound_holds_over_calibrations_with_its_confidence():
    """Uniform scores: a further one is above the threshold t with probability 1 - t."""
    random = np.random.default_rng(3)
    held = 0
    for _ in range(2000):
        scores = dict(enumerate(random.uniform(size=19).tolist()))
        calibration = calibrate(scores, 0.1, floor=0.0)
        held += 1 - calibration.threshold <= calibration.conditional_bound
    assert held / 2000 == pytest.approx(0.95, abs=0.012)


def test_no_threshold_is_below_the_floor():
    low = {d: s / 100 for d, s in scores_of(20).items()}
    assert calibrate(low, 0.1).threshold == 1.0
    assert calibrate(low, 0.1, floor=0.02).threshold == sorted(low.values())[18]
    few = {"a": 0.2, "b": 0.4}
    assert calibrate(few, 0.1).threshold == 1.0
    assert calibrate(few, 0.1, floor=0.3).threshold == 0.4
    assert calibrate(few, 0.1, floor=0.3, unstated_floor=0.7).threshold == 0.7
    assert calibrate(low, 0.1, floor=0.02, unstated_floor=9.0).threshold == sorted(low.values())[18]
    assert calibrate({}, 0.1).threshold == 1.0


PIECES = Recordings(by_drive={"a1": "a", "a2": "a", "b1": "b", "c1": "c", "c2": "c"}, setting=("c",))


def test_a_recording_scores_its_worst_piece_and_one_that_set_the_bounds_none():
    scores = {"a1": 1.5, "a2": 1.2, "b1": 1.1, "c1": 9.0, "c2": 8.0, "d": 1.3}
    assert PIECES.largest(scores) == {"a": 1.5, "b": 1.1, "d": 1.3}
    assert PIECES.largest(dict(reversed(scores.items()))) == {"a": 1.5, "b": 1.1, "d": 1.3}
    assert PIECES.named("a2") == "a" and PIECES.named("d") == "d"
    assert PIECES.others(scores, None) == list(scores)
    assert PIECES.others(scores, "a1") == ["b1", "c1", "c2", "d"]
    assert PIECES.others(scores, "d") == ["a1", "a2", "b1", "c1", "c2"]
    assert NO_RECORDINGS.largest(scores) == scores
    calibration = calibrate(scores, 0.1, recordings=PIECES)
    assert calibration.alpha is None and calibration.threshold == 9.0
    assert calibration.claim() == (
        "alpha is not stated: 6 drives calibrate, from 3 recordings that did not set the bounds; drives of "
        "one recording are not independent, and 2 drives belong to recordings that set the bounds"
    )
    without = calibrate({"a1": 1.5, "b1": 1.1}, 0.1, recordings=PIECES)
    assert without.claim().endswith("drives of one recording are not independent")
    assert without.units() == "2 recordings" and calibrate({"x": 1.0}, 0.1).units() == "1 drives"


def test_pieces_of_one_recording_are_one_draw():
    scores = scores_of(20)
    halves = {f"{d}{part}": s - 0.01 * part for d, s in scores.items() for part in (0, 1)}
    recordings = Recordings(by_drive={piece: piece[:-1] for piece in halves})
    calibration, plain = calibrate(halves, 0.1, recordings=recordings), calibrate(scores, 0.1)
    assert (calibration.threshold, calibration.conditional_bound) == (
        plain.threshold,
        plain.conditional_bound,
    )
    assert calibration.claim().startswith("alpha 0.1 from 20 recordings, ")


def test_the_claim_an_hour_is_the_rate_of_recordings_of_the_mean_length():
    """19 recordings of 90 s are judged: 0.475 h. alpha 0.1 a recording is 0.1 * 19 / 0.475 = 4 an hour."""
    scores = scores_of(19)
    judged = dict.fromkeys(scores, 90.0)
    calibration = calibrate(scores, 0.1).over(judged | {"another": 1e9})
    assert calibration.judged_s == judged
    bound = calibration.conditional_bound * 19 / 0.475
    assert calibration.hourly == f"; 4 and {bound:.3g} per judged hour, from 0.475 h"
    assert calibration.claim().endswith(calibration.hourly)
    assert calibrate(scores, 0.1).hourly == ""
    assert calibrate(scores, 0.01).over(judged).hourly == "", "no alpha, no rate"


def test_the_claim_an_hour_leaves_out_recordings_that_set_the_bounds_and_counts_pieces_once():
    scores = scores_of(20)
    recordings = Recordings(by_drive={"d0": "r", "d1": "r", "d2": "s"}, setting=("s",))
    calibration = calibrate(scores, 0.2, recordings=recordings).over(dict.fromkeys(scores, 360.0))
    # 18 recordings: r of two drives, 17 of one. 19 drives are judged for 0.1 h each.
    assert calibration.alpha == 0.2 and calibration.hourly.startswith(f"; {0.2 * 18 / 1.9:.3g} and ")
    assert calibration.hourly.endswith("per judged hour, from 1.9 h")


def test_each_group_states_its_own_hours():
    scores = scores_of(30)
    groups = {d: ("wet" if k < 11 else "dry") for k, d in enumerate(scores)}
    judged = {d: (720.0 if g == "wet" else 36.0) for d, g in groups.items()}
    calibration = calibrate(scores, 0.2, recordings=Recordings(groups=groups)).over(judged)
    dry, wet = (calibration.of_group(g) for g in ("dry", "wet"))
    assert set(dry.scores) == {d for d, g in groups.items() if g == "dry"} and len(wet.scores) == 11
    assert (
        wet.claim().endswith("per judged hour, from 2.2 h") and f"; {0.2 * 11 / 2.2:.3g} and " in wet.claim()
    )
    assert (
        dry.claim().endswith("per judged hour, from 0.19 h")
        and f"; {0.2 * 19 / 0.19:.3g} and " in dry.claim()
    )
    assert f"from {2.2 + 0.19:.3g} h" in calibration.claim()
    assert dry.groups == {"dry": calibration.groups["dry"]} and dry.group == "dry"
    assert dry.carried == dry.threshold == calibration.groups["dry"].threshold
    assert calibration.carried == max(calibration.threshold, dry.threshold, wet.threshold)
    assert calibration.of_group(None).threshold == calibration.carried
    unknown = calibration.of_group("ice")
    assert unknown.threshold == calibration.threshold and unknown.alpha is None and unknown.scores == {}


def test_a_group_without_a_threshold_of_its_own_does_not_raise_what_is_carried():
    calibration = Calibration(
        2.0, {}, 0.1, 0.2, groups={"a": GroupThreshold(3), "b": GroupThreshold(20, 2.5, 0.1, 0.2)}
    )
    assert calibration.carried == 2.5
    assert Calibration(3.0, {}, 0.1, 0.2, groups={"b": GroupThreshold(20, 2.5, 0.1, 0.2)}).carried == 3.0
    assert calibration.of_group("a").carried == 2.0


@pytest.mark.parametrize("recordings", [NO_RECORDINGS, PIECES, Recordings(groups={"d0": "x", "d1": "y"})])
def test_what_is_stored_comes_back(recordings):
    calibration = calibrate(scores_of(12) | {"a1": 1.0}, 0.2, recordings=recordings)
    for one in (calibration, calibration.over(dict.fromkeys(calibration.scores, 60.0))):
        stored = json.loads(json.dumps(one.to_dict()))
        assert Calibration.from_dict(stored) == one
        assert ("recordings" in stored) == bool(recordings.by_drive)
        assert ("groups" in stored) == bool(recordings.groups)
        assert ("judged_s" in stored) == bool(one.judged_s)


def run(*, counted, statistic, energy=(0.0,), change=(0.0,)) -> SimpleNamespace:
    frames = SimpleNamespace(counted=np.array(counted), statistic=np.array(statistic))
    return SimpleNamespace(frames=frames, energy=np.array(energy), change=np.array(change))


def test_a_drive_scores_the_largest_counted_frame_and_the_largest_ratios_or_nothing():
    judged = run(
        counted=[True, False, True], statistic=[0.5, 9.0, 0.7], energy=[0.0, 0.4, 0.3], change=[0.2, 0.0, 0.1]
    )
    assert (score(judged), energy_score(judged), change_score(judged)) == (0.7, 0.4, 0.2)
    silent = run(counted=[False], statistic=[9.0])
    assert (score(silent), energy_score(silent), change_score(silent)) == (None, None, None)


def test_the_rank_is_exact_however_the_product_rounds():
    """10 * (1 - 0.7) in floating point is a little more than 3."""
    for n in (9, 19, 24, 39, 99):
        scores = {f"d{k}": float(k + 2) for k in range(n)}
        for percent in range(1, 100):
            rank = -(-(n + 1) * (100 - percent) // 100)
            calibration = calibrate(scores, percent / 100)
            assert calibration.threshold == (rank + 1 if rank <= n else n + 1), (n, percent)


def drive(name: str, recording: str, group: str | None = None) -> Experiment:
    return Experiment(name, Path("drives") / f"{name}.csv", "valid", "human", recording, group)


def test_recordings_are_read_from_the_list_of_experiments_once():
    setting = [drive("s1", "s1"), drive("s2", "day"), drive("s3", "night")]
    others = [drive("o1", "day"), drive("o2", "o2"), drive("o3", "dusk"), drive("o4", "night")]
    recordings = Recordings.listed(iter(setting), iter(others))
    assert recordings.by_drive == {"s2": "day", "s3": "night", "o1": "day", "o3": "dusk", "o4": "night"}
    assert recordings.setting == ("day", "night") and recordings.groups == {}
    grouped = Recordings.listed(setting[:1], [drive("o1", "day", "wet"), drive("o2", "o2", "dry")])
    assert grouped.groups == {"o1": "wet", "o2": "dry"} and grouped.setting == ()


def test_an_hour_is_3600_s():
    scores = scores_of(19)
    calibration = calibrate(scores, 0.1).over(dict.fromkeys(scores, 1805.3 / 19))
    assert calibration.hourly.endswith("per judged hour, from 0.501 h")


def run_of(frames, energy=(0.0, 0.0), change=(0.0, 0.0), energy_band=(0, 0)) -> SimpleNamespace:
    """Results of the core for a drive. A frame has a bin, an end [s], a statistic, and whether it counted."""
    columns = [np.array(column) for column in zip(*frames, strict=True)]
    return SimpleNamespace(
        frames=SimpleNamespace(**dict(zip(("bin", "t_end_s", "statistic", "counted"), columns, strict=True))),
        energy=np.array(energy),
        change=np.array(change),
        energy_band=np.array(energy_band),
    )


def test_a_peak_is_the_largest_that_counted_and_what_is_left_without_the_frames_that_overlap_it():
    length = np.array([4, 2])  # at 0.5 s: frames of bin 0 overlap up to 1.5 s, and do not from 2 s on
    first = (0, 16.0, 4.0, True)
    overlapping = [(0, 17.5, 3.0, True), (0, 14.25, 3.5, True)]
    others = [(0, 14.0, 1.5, True), (1, 16.0, 1.2, True)]
    silent = (1, 16.0, 9.0, False)
    by_test = peaks(run_of([*overlapping, silent, first, *others]), 10.0, 0.5, length)
    assert by_test == {"frame": Peak(6.0, 0, 1.5)}
    assert peaks(run_of([first, others[1], silent]), 10.0, 0.5, length) == {"frame": Peak(6.0, 0, 1.2)}
    small = (1, 18.0, 0.4, True)
    assert peaks(run_of([small, first]), 10.0, 0.5, length)["frame"].without == 0.4
    assert peaks(run_of([first, *overlapping]), 10.0, 0.5, length)["frame"].without == 0.0
    assert peaks(run_of([silent]), 10.0, 0.5, length) == {}


def test_a_peak_of_the_energy_test_names_its_band_and_one_of_the_change_test_none():
    silent = [(1, 16.0, 9.0, False)]
    run = run_of(silent, (0.0, 0.2, 0.5, 0.3), (0.3, 0.6, 0.4, 0.1), (0, 1, 2, 1))
    assert peaks(run, 10.0, 0.5, np.array([4, 2])) == {"energy": Peak(1.0, 2), "change": Peak(0.5)}


def test_the_drive_that_decides_is_the_one_whose_score_the_core_carries():
    calibration = calibrate(scores_of(20), 0.1)
    assert (
        calibration.scores[calibration.decided_by]
        == calibration.threshold
        != next(iter(calibration.scores.values()))
    )
    assert calibrate(scores_of(20), 0.1, floor=100.0).decided_by is None


def test_without_a_drive_that_calibrates_there_is_no_threshold(tmp_path):
    drives = object.__new__(DriveSet)
    drives.folder = tmp_path
    require_calibration(drives, iter(["a", "b"]), {"a": "too short"}, True)
    with pytest.raises(
        InputError, match=r"experiments.csv: column split: no drive calibrates: every drive.*at least 9 rec"
    ):
        require_calibration(drives, [], {"a": "too short"}, True)
    with pytest.raises(InputError, match=r"calibrate \(3\): .*no test judges one \(b: too short\)"):
        require_calibration(
            drives, ["a", "b", "c"], {"x": "silent", "b": "too short", "c": "no speed"}, False
        )
    with pytest.raises(InputError, match=r"calibrate \(1\): .*\(every bin is silent\)"):
        require_calibration(drives, iter(["a"]), {"b": "too short"}, False)
