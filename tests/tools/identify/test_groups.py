"""Groups of experiments.csv: a threshold a group where recordings are enough, the pooled one otherwise."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.drives.tables import Experiment, list_experiments
from lpvguard.evaluate.judged_drives import JudgedDrives
from lpvguard.identify import identification as identify
from lpvguard.identify.calibration import ROUNDING, Calibration, Recordings, calibrate
from lpvguard.identify.identification import DriveSet
from lpvguard.vehicle.nominal import NominalModel

SIZES = {"dry": 19, "wet": 12, "snow": 3}


def made_up() -> tuple[dict[str, float], Recordings]:
    """Scores of drives by group: dry 1.01 to 1.19, wet 2.01 to 2.12, snow 3.01 to 3.03."""
    groups = {f"{g}{k}": g for g, n in SIZES.items() for k in range(1, n + 1)}
    level = dict(zip(SIZES, (1, 2, 3), strict=True))
    scores = {d: level[g] + 0.01 * int(d.removeprefix(g)) for d, g in groups.items()}
    return scores, Recordings(groups=groups)


def test_a_group_with_enough_recordings_has_its_own_threshold_and_the_others_the_pooled_one():
    scores, recordings = made_up()
    calibration = calibrate(scores, 0.1, recordings=recordings)
    # ceil(20 * 0.9) = 18 of 19; ceil(13 * 0.9) = 12 of 12; of all 34 the 32nd.
    dry, wet, snow = (calibration.of_group(g) for g in SIZES)
    assert (dry.threshold, wet.threshold) == (scores["dry18"], scores["wet12"])
    assert snow.threshold == calibration.threshold == scores["snow1"]
    assert calibration.carried == calibration.threshold and dry.carried == scores["dry18"]
    assert dry.claim().startswith("group dry: threshold 1.18, alpha 0.1 from 19 recordings, with 95 % ")
    said = snow.claim()
    assert said == (
        "group snow: 3 recordings are too few for a separate threshold; the group has the pooled "
        "threshold without alpha"
    )
    assert snow.alpha is None is snow.conditional_bound and dry.alpha == wet.alpha == calibration.alpha == 0.1
    assert calibration.claim().startswith("pooled: alpha 0.1 from 34 drives") and said in calibration.claim()
    assert dry.claim() in calibration.claim() and wet.claim() in calibration.claim()
    assert calibration.claim().endswith("the core has the largest, 3.01")
    assert (
        calibration.of_group(None) == calibration
        and "group fog: 0 recordings" in calibration.of_group("fog").claim()
    )


def test_groups_that_are_too_small_share_a_sentence():
    scores, _ = made_up()
    groups = {d: d.rstrip("0123456789") + (d[-1] if d.startswith("snow") else "") for d in scores}
    claim = calibrate(scores, 0.1, recordings=Recordings(groups=groups)).claim()
    assert "groups snow1, snow2, snow3: too few recordings for separate thresholds" in claim


def test_the_core_carries_the_largest_threshold_so_that_every_claim_holds():
    scores, recordings = made_up()
    calm = {d: s for d, s in scores.items() if not d.startswith("snow")}
    calibration = calibrate(
        {d: (0.5 if d.startswith("dry") else s) for d, s in calm.items()}, 0.3, recordings=recordings
    )
    own = {g.threshold for g in calibration.groups.values()}
    assert calibration.groups.keys() == {"dry", "wet"} and None not in own
    assert calibration.carried == max(own) > calibration.threshold and min(own) == 1.0, "at least the floor"


def test_groups_are_stored_and_without_a_column_nothing_changes():
    scores, recordings = made_up()
    calibration = calibrate(scores, 0.1, recordings=recordings)
    for c in (calibration, calibration.of_group("dry"), calibration.of_group("snow")):
        assert Calibration.from_dict(json.loads(json.dumps(c.to_dict()))) == c
    plain = calibrate(scores, 0.1)
    assert plain.to_dict().keys() == {"threshold", "scores", "alpha", "conditional_bound"}
    assert plain.carried == plain.threshold and plain.of_group("dry") == plain
    assert plain.claim() == calibrate(scores, 0.1).claim() and "group" not in plain.claim()


@pytest.mark.unhurried
def test_the_alpha_of_a_group_is_kept_where_the_pooled_threshold_fails_it():
    """Nine in ten recordings are of a calm group. The pooled threshold lets most of the others alarm."""
    random, trials, alpha = np.random.default_rng(6), 1500, 0.1
    alarms = {"pooled": 0, "own": 0}
    for _ in range(trials):
        level = {"calm": 0.0, "rough": 1.5}
        groups = {f"{g}{k}": g for g, n in (("calm", 90), ("rough", 10)) for k in range(n)}
        scores = {d: float(np.exp(level[g] + 0.3 * random.normal())) for d, g in groups.items()}
        calibration = calibrate(scores, alpha, floor=0.0, recordings=Recordings(groups=groups))
        further = np.exp(level["rough"] + 0.3 * random.normal())
        alarms["pooled"] += further > calibration.threshold
        alarms["own"] += further > calibration.of_group("rough").threshold
    assert alarms["own"] / trials == pytest.approx(1 / 11, abs=0.025) and alarms["pooled"] / trials > 0.5


def experiment(name: str, recording: str, group: str | None) -> Experiment:
    return Experiment(name, Path(f"{name}.csv"), "valid", "human", recording, group)


def test_a_recording_is_of_one_group():
    pieces = [experiment("a", "day", "dry"), experiment("b", "day", "wet")]
    with pytest.raises(
        InputError, match=r"column group.*a \(dry\) and b \(wet\) belong to one recording, day"
    ):
        Recordings.listed((), pieces)
    with pytest.raises(InputError, match="column group: c has no group, but other drives have one"):
        Recordings.listed((), [pieces[0], experiment("c", "c", None)])
    listed = Recordings.listed([experiment("s", "s", "dry")], [replace(pieces[1], group="dry"), pieces[0]])
    assert listed.groups == {"b": "dry", "a": "dry"} and listed.named("b") == "day"


@pytest.mark.unhurried
def test_the_column_is_read_and_each_drive_is_judged_by_the_threshold_of_its_group(
    identified, synthetic, g80, tmp_path
):
    stored = identify.load(identified)
    with pytest.raises(InputError, match=r"group.*dry.*expected groups, a column of experiments.csv"):
        stored.of_group("dry")
    scores = dict.fromkeys(stored.calibration.scores, 1.0)
    dry = list(scores)[:10]
    recordings = Recordings(groups=dict.fromkeys(dry, "dry") | {list(scores)[10]: "wet"})
    grouped = replace(
        stored,
        calibration=calibrate({d: 2.0 if d in dry else 3.0 for d in scores}, 0.1, recordings=recordings),
        energy=stored.energy.calibrated({d: 4.0 if d in dry else 5.0 for d in scores}, 0.1, recordings),
        change=stored.change.calibrated({d: 6.0 if d in dry else 7.0 for d in scores}, 0.1, recordings),
    )
    reals = [grouped.coefficients.reals, grouped.of_group("dry").coefficients.reals]
    names = ("energy_threshold", "change_threshold", "threshold")
    exported = [[float(r[name]) / (1 + ROUNDING) for r in reals] for name in names]
    np.testing.assert_allclose(exported, [[5.0, 4.0], [7.0, 6.0], [3.0, 2.0]], rtol=1e-12)
    with pytest.raises(InputError, match="expected dry, wet"):
        grouped.of_group("fog")
    drives = DriveSet(g80, NominalModel(g80), synthetic)
    alone = JudgedDrives.left_one_out(grouped, drives).calibrations
    assert {alone[d]["frame"].threshold for d in dry} == {2.0}
    assert all("group wet: 0 recordings are too few" in c.claim() for c in alone[list(scores)[10]].values())
    (tmp_path / "new.csv").write_text("t\n")
    (tmp_path / "experiments.csv").write_text("experiment,split,group\nnew,x,dry\n")
    new = list_experiments(tmp_path)
    assert new[0].group == "dry"
    judged = JudgedDrives.held_out(grouped, new)
    assert judged.calibrations["new"]["frame"].threshold == 2.0 and judged.recordings.groups == {"new": "dry"}
