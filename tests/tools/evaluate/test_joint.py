"""One threshold for all tests: scores, thresholds and rates in the unit of each test."""

import numpy as np
import pytest

from lpvguard.core.compiled import TESTS
from lpvguard.evaluate.comparison import POOLS
from lpvguard.evaluate.joint import FLOORS, UNITS, joint_score, joint_scores, joint_target, joint_thresholds
from lpvguard.identify.calibration import RateTarget


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
