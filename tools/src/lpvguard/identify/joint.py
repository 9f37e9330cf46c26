"""One threshold for all tests together: the probability that any of them alarms is at most alpha.

A test alarms above the threshold times its unit, and above its floor. Gain, delay and bias are what most
faults change. The change test estimates them, so its unit is the smallest. The largest score of few drives
decides the threshold. With one unit for all tests, one bin of one drive would blunt the change test. Units
that no calibration drive decides keep the guarantee (THEORY 7.3; tools/DESIGN_LOG.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..core.compiled import TESTS
from .calibration import ROUNDING, Calibration, Extrapolation, GroupThreshold, RateTarget, calibrate
from .change import FLOOR

POOLS = "pools"
"""Name of the frame test's pools, which have a threshold of their own."""
FLOORS = {"frame": 1.0, "energy": 1.0 + ROUNDING, "change": FLOOR, POOLS: 1.0}
"""Smallest threshold of each test."""
UNITS = {"frame": 3.0, "energy": 3.0, "change": 1.0, POOLS: 3.0}
"""Threshold of each test, divided by the joint one."""


def joint_score(scores: Mapping[str, float | None]) -> float:
    """Compute the score of a drive in all tests together.

    Parameters
    ----------
    scores : Mapping, score by test, None for a test that judged nothing

    Returns
    -------
    float, the largest score above the floor of its test, divided by its unit, or 0 without one

    References
    ----------
    THEORY 7.3.
    """
    return max((s / UNITS[t] for t, s in scores.items() if s is not None and s > FLOORS[t]), default=0.0)


def joint_scores(tests: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Compute `joint_score` of every drive that at least one test judged.

    Parameters
    ----------
    tests : Mapping, scores by test and drive

    Returns
    -------
    dict[str, float], by drive
    """
    drives = sorted({n for scores in tests.values() for n in scores})
    return {n: joint_score({test: s[n] for test, s in tests.items() if n in s}) for n in drives}


def joint_thresholds(joint: float) -> list[float]:
    """Compute the threshold of each test of the core.

    Parameters
    ----------
    joint : float, joint threshold

    Returns
    -------
    list of float, in the order of TESTS; that of frames also serves pools
    """
    return [_threshold(test, joint) for test in TESTS]


def _threshold(test: str, joint: float) -> float:
    return max(joint * UNITS[test], FLOORS[test])


def joint_target(targets: Mapping[str, RateTarget]) -> RateTarget:
    """Compute the target of the joint score.

    Parameters
    ----------
    targets : Mapping, target by test

    Returns
    -------
    RateTarget, with the sum of the rates
    """
    drives = set.intersection(*(set(t.maxima) for t in targets.values()))
    maxima = {
        d: np.max([np.array(t.maxima[d]) / UNITS[test] for test, t in targets.items()], axis=0).tolist()
        for d in sorted(drives)
    }
    first: RateTarget = next(iter(targets.values()))
    return replace(first, per_1000_h=sum(t.per_1000_h for t in targets.values()), maxima=maxima)


def joint_calibration(tests: Mapping[str, Calibration], alpha: float) -> Calibration:
    """Calibrate the joint score.

    Parameters
    ----------
    tests : Mapping, calibration by test, with a target each or none
    alpha : float, probability that any test alarms on a further recording

    Returns
    -------
    Calibration, whose threshold is the joint one

    References
    ----------
    THEORY 7.3.
    """
    targets = {test: c.target for test, c in tests.items() if c.target is not None}
    return calibrate(
        joint_scores({test: c.scores for test, c in tests.items()}),
        alpha,
        floor=FLOORS["change"],
        recordings=next(iter(tests.values())).recordings,
        target=joint_target(targets) if targets else None,
    )


def with_joint_thresholds(tests: Mapping[str, Calibration], joint: Calibration) -> dict[str, Calibration]:
    """Give every test the joint threshold in its unit, and the claim of all tests together.

    Parameters
    ----------
    tests : Mapping, calibration by test
    joint : Calibration, of `joint_calibration`

    Returns
    -------
    dict[str, Calibration], by test
    """
    return {test: _with_joint_threshold(test, c, joint) for test, c in tests.items()}


def _with_joint_threshold(test: str, c: Calibration, joint: Calibration) -> Calibration:
    unit = UNITS[test]

    def of_group(g: GroupThreshold) -> GroupThreshold:
        threshold = None if g.threshold is None else _threshold(test, g.threshold)
        return replace(g, threshold=threshold, extrapolation=_in_unit(g.extrapolation, unit))

    return replace(
        c,
        threshold=_threshold(test, joint.threshold),
        alpha=joint.alpha,
        conditional_bound=joint.conditional_bound,
        groups={name: of_group(g) for name, g in joint.groups.items()},
        extrapolation=_in_unit(joint.extrapolation, unit),
        joint=joint,
    )


def _in_unit(tail: Extrapolation | None, unit: float) -> Extrapolation | None:
    if tail is None:
        return None
    return replace(tail, level=unit * tail.level, scale=unit * tail.scale, threshold=unit * tail.threshold)
