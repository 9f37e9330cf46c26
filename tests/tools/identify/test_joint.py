"""One threshold for all tests: scores, thresholds and rates in the unit of each test."""

import json

import jsonschema
import numpy as np
import pytest

from lpvguard.core.compiled import TESTS, Core
from lpvguard.evaluate.evaluation import evaluate
from lpvguard.identify import identification as stage
from lpvguard.identify.calibration import RateTarget, Recordings, calibrate
from lpvguard.identify.export import export_vehicle
from lpvguard.identify.joint import (
    FLOORS,
    POOLS,
    UNITS,
    joint_calibration,
    joint_score,
    joint_scores,
    joint_target,
    joint_thresholds,
    with_joint_thresholds,
)
from lpvguard.schemas import schema
from lpvguard.vehicle.project import EvaluationSettings


def test_a_joint_score_is_the_largest_in_its_unit_above_its_floor():
    assert joint_score({"frame": 3.0, "change": 0.9}) == 1.0
    assert joint_score({"frame": 3.0, "change": 1.1, POOLS: 3.6}) == pytest.approx(1.2)
    assert joint_score({"frame": None, "energy": 1.5}) == 0.5
    assert joint_score({"frame": 1.0, "energy": FLOORS["energy"], "change": 0.05}) == 0.0
    assert joint_score({"frame": None, "energy": None}) == 0.0


def test_joint_scores_are_of_every_drive_that_a_test_judged():
    tests = {"frame": {"a": 1.5, "b": 6.0}, "energy": {"b": 3.0, "c": 1.5}, "change": {"a": 0.7}}
    assert joint_scores(tests) == {"a": 0.7, "b": 2.0, "c": 0.5}
    assert joint_scores({}) == {}


def test_a_score_is_above_the_joint_threshold_exactly_where_a_test_alarms():
    random = np.random.default_rng(56)
    alarmed = 0
    for _ in range(2000):
        scores = dict(zip((*TESTS, POOLS), 3 * random.lognormal(-1.0, 0.7, 4), strict=True))
        joint = random.uniform(0.05, 1.5)
        thresholds = dict(zip(TESTS, joint_thresholds(joint), strict=True))
        thresholds[POOLS] = thresholds["frame"]  # as in the core
        alarms = any(scores[test] > h for test, h in thresholds.items())
        assert (joint_score(scores) > joint) == alarms
        alarmed += alarms
    assert 400 < alarmed < 1600


def test_a_joint_target_has_the_largest_maxima_in_units_and_the_sum_of_rates():
    a = RateTarget(0.5, False, {"d": [1.5, 6.0], "e": [1.0]}, {})
    b = RateTarget(0.5, False, {"d": [2.0, 1.0]}, {})
    joint = joint_target({"frame": a, "change": b})
    assert UNITS["frame"] == 3.0
    assert joint.per_1000_h == 1.0 and joint.maxima == {"d": [2.0, 2.0]}


DRIVES = [f"drive_{i}" for i in range(10)]


def calibrations(groups=None, target=None):
    """Calibrations of four tests; pools decide the joint threshold by drive_9."""
    recordings = Recordings(groups=groups or {})
    scores = {
        "frame": {d: 0.9 + 0.1 * i for i, d in enumerate(DRIVES)},
        "energy": dict.fromkeys(DRIVES, 1.2),
        "change": {d: 0.05 * i for i, d in enumerate(DRIVES)},
        POOLS: {d: 0.3 * i for i, d in enumerate(DRIVES)},
    }
    return {t: calibrate(s, 0.1, recordings=recordings, target=target) for t, s in scores.items()}


def test_every_test_gets_the_joint_threshold_in_its_unit_and_the_claim_of_all():
    tests = calibrations()
    joint = joint_calibration(tests, 0.1)
    assert joint.threshold == pytest.approx(0.9) and joint.decided_by == "drive_9"
    together = with_joint_thresholds(tests, joint)
    assert {t: c.carried for t, c in together.items()} == pytest.approx(
        {"frame": 2.7, "energy": 2.7, "change": 0.9, POOLS: 2.7}
    )
    for test, c in together.items():
        assert c.scores == tests[test].scores and c.alpha == 0.1
        assert c.claim() == "all tests together: alpha 0.1 from 10 drives, with 95 % confidence below 0.259"
        assert c.decided_by == "drive_9" and c.stated == f"threshold {c.carried:.4g}"
    assert tests["change"].stated.startswith("threshold 1 (alpha 0.1 from 10 drives")


def test_a_group_has_the_joint_threshold_of_its_drives():
    groups = dict.fromkeys(DRIVES, "dry")
    together = with_joint_thresholds(calibrations(groups), joint_calibration(calibrations(groups), 0.1))
    dry = together["change"].of_group("dry")
    assert dry.carried == pytest.approx(0.9) and dry.group == "dry"
    assert dry.claim().startswith(
        "all tests together: group dry: threshold 0.9, alpha 0.1 from 10 recordings"
    )


def test_a_rate_of_all_tests_is_extrapolated_in_the_unit_of_each():
    random = np.random.default_rng(5)
    maxima = {d: random.exponential(0.2, 40).tolist() for d in DRIVES}
    target = RateTarget(0.25, False, maxima, dict.fromkeys(DRIVES, 1200.0))
    joint = joint_calibration(calibrations(target=target), 0.1)
    together = with_joint_thresholds(calibrations(target=target), joint)
    assert joint.target.per_1000_h == 1.0
    for test, c in together.items():
        assert c.threshold == pytest.approx(max(UNITS[test] * joint.threshold, FLOORS[test]))
        assert c.extrapolation.threshold == pytest.approx(UNITS[test] * joint.extrapolation.threshold)


@pytest.mark.long("25 s: an identification and its evaluation")
def test_what_is_exported_is_what_evaluate_compares(tmp_path, g80, synthetic, few_baselines):
    project = g80.model_copy(update={"frame_test": g80.frame_test.model_copy(update={"joint": True})})
    result, drives = stage.identify(project, synthetic)
    stage.save(result, drives, tmp_path / "identified")
    stored = stage.load(tmp_path / "identified")
    joint = stored.calibration.joint
    jsonschema.validate(
        json.loads((tmp_path / "identified" / "joint.json").read_text()), schema("calibration")
    )
    exported = [c.carried for c in (stored.calibration, stored.energy.calibration, stored.change.calibration)]
    assert exported == joint_thresholds(joint.threshold)
    export_vehicle(stored, tmp_path / "vehicle")
    once = EvaluationSettings(bias=0.05, starts=1)
    evaluation = evaluate(stored, drives, Core(tmp_path / "vehicle"), settings=once)
    assert evaluation["tests"]["exported"]["faults"] == [
        {k: v for k, v in row.items() if k != "best"} for row in evaluation["faults"]
    ]
    assert evaluation["stated_rates"]["exported"] == evaluation["stated_rates"]["monitor"]
    assert evaluation["claims"]["identified"]["change"].startswith("all tests together: ")
