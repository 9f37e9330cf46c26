"""Texts on the frames that decide the bounds and thresholds of an identification, and on silent bins.

A user should check a frame that alone decides a bound or a threshold. A crash, a slide or a wrong sample may
have caused it. No frame is dropped automatically. experiments.csv can set a drive aside, with a reason.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..drives.tables import EXPERIMENTS
from .calibration import Calibration, calibrate
from .identification import Identification
from .joint import FLOORS, POOLS, joint_score
from .model_error import FEWEST_FRAMES

ONE_FRAME = 1.1
"""A frame alone decides a number if the number exceeds its value without the frame by this factor."""
OUTLYING, FEWEST_TO_COMPARE = 3.5, 5
"""Limit of the modified z-score (Iglewicz and Hoaglin) of an outlier, and least number of scores to compare.

The z-score uses the logarithms of the scores, their median and their median absolute deviation.
"""


class Decision(NamedTuple):
    """``text`` names what decides a number.

    ``alone`` is True if one frame does, which calls for a warning.
    """

    text: str
    alone: bool


def decides_bounds(result: Identification) -> list[Decision]:
    """Name the drive and time that decide each nu above 0 and each B_w above its floor.

    Where one frame decides alone, the text also states the bound without this frame and those that overlap
    it.

    Parameters
    ----------
    result : Identification

    Returns
    -------
    list of Decision
    """
    Ts, decisions = result.project.Ts_s, []
    for key, decided in result.origins.decided.items():
        shared = decided.largest.shape[1] == 1 and key == "nu"
        names = [""] if shared else [f" of {s.name}" for s in result.project.outputs]
        floor = result.bounds.B_w_floor if key == "B_w" else np.zeros(decided.largest.shape)
        for k, j in np.argwhere(decided.largest > floor):
            value, without = float(decided.largest[k, j]), float(decided.without[k, j])
            alone = value > ONE_FRAME * without
            decisions.append(
                Decision(
                    f"{_frequency(result, k)}: {decided.drive[k, j]} decides {key}{names[j]}, {value:.3g}, "
                    f"from {decided.first[k, j] * Ts:.4g} s on"
                    + (f"; one frame alone decides: without it {without:.3g}" if alone else ""),
                    alone,
                )
            )
    return decisions


def decides_thresholds(result: Identification) -> list[Decision]:
    """Name the drive, the time and the bin or band that decide each threshold, or the joint one.

    Where one frame decides alone, the text also states the threshold without this frame.

    Parameters
    ----------
    result : Identification

    Returns
    -------
    list of Decision
    """
    tests, joint = _tests(result), result.calibration.joint
    if joint is None:
        return [_decides(result, f"{test} test", c, {test: c}) for test, c in tests.items()]
    if result.pools is not None:
        tests[POOLS] = result.pools.calibration
    return [_decides(result, "all tests", joint, tests)]


def _tests(result: Identification) -> dict[str, Calibration]:
    calibrations = {
        "frame": result.calibration,
        "energy": None if result.energy is None else result.energy.calibration,
        "change": None if result.change is None else result.change.calibration,
    }
    return {test: c for test, c in calibrations.items() if c is not None}


def _decides(result: Identification, what: str, c: Calibration, tests: Mapping[str, Calibration]) -> Decision:
    """Name what decides the threshold of ``c``, which judges the scores of ``tests``."""
    if c.extrapolation is not None:
        return Decision(f"{what}: the tail of the scores decides the threshold {c.carried:.4g}", False)
    drive = c.decided_by
    if drive is None:
        return Decision(f"{what}: the floor of the test decides the threshold {c.carried:.4g}", False)
    scores = {name: x.scores.get(drive) for name, x in tests.items()}
    test = max(scores, key=lambda name: joint_score({name: scores[name]}))
    joint = len(tests) > 1
    text = (
        f"{what}: {drive} decides the threshold {c.carried:.4g}{f' by its score in {test}' if joint else ''}"
        f"{_where(result, test, drive)}"
    )
    peak = result.origins.peaks[drive].get(test)
    if peak is None or peak.without is None:  # the place is unknown without a core
        return Decision(text, False)
    without = joint_score(scores | {test: peak.without}) if joint else peak.without
    left = calibrate(
        c.scores | {drive: without},
        result.project.frame_test.alpha,
        floor=FLOORS["change" if joint else test],
        recordings=c.recordings,
        target=c.target,
    ).carried
    if c.carried <= ONE_FRAME * left:
        return Decision(text, False)
    return Decision(f"{text}; one frame alone decides: without it {left:.4g}", True)


def _where(result: Identification, test: str, drive: str) -> str:
    """Text that extends a sentence by the time and place of a drive's score, empty without a core."""
    peak = result.origins.peaks[drive].get(test)
    if peak is None:
        return ""
    text = f", at {peak.t_s:.4g} s"
    if peak.place is not None and test == "frame":
        return f"{text}, {_frequency(result, peak.place)}"
    if peak.place is not None and result.energy is not None:
        return f"{text}, band {result.energy.bands[peak.place]}"
    return text


def outlying(result: Identification) -> list[str]:
    """Name each calibration drive whose score is an outlier, for example after a crash.

    The drive still calibrates.

    Parameters
    ----------
    result : Identification

    Returns
    -------
    list of str, sentences
    """
    sentences = []
    for test, c in _tests(result).items():
        scores = {drive: s for drive, s in c.scores.items() if s > 0}
        if len(scores) < FEWEST_TO_COMPARE or (test == "frame" and _all_silent(result)):
            continue
        size = np.log(list(scores.values()))
        middle = float(np.median(size))
        deviation = 1.4826 * float(np.median(np.abs(size - middle)))
        least = middle + max(OUTLYING * deviation, np.log(ONE_FRAME))
        sentences += [
            f"{test} test: the score of {drive}, {s:.4g}, is an outlier among the calibration drives, whose "
            f"median is {np.exp(middle):.3g}{_where(result, test, drive)}; the drive calibrates unless "
            f"{EXPERIMENTS} sets it aside"
            for drive, s in scores.items()
            if np.log(s) > least
        ]
    return sentences


def _all_silent(result: Identification) -> bool:
    return len(result.weights.silent) == len(result.bounds.omega)


def unresolved(result: Identification) -> list[str]:
    """Name each output whose disturbance bound the sensor decides and no drive.

    Parameters
    ----------
    result : Identification

    Returns
    -------
    list of str, sentences
    """
    sentences, bounds = [], result.bounds
    for j, signal in enumerate(result.project.outputs):
        bins = np.flatnonzero(bounds.B_w[:, j] <= bounds.B_w_floor[:, j])
        if len(bins):
            step, noise = bounds.resolution.step[j], bounds.resolution.noise[j]
            sentences.append(
                f"the limit of the sensor of {signal.name} decides its B_w, and the drives need no more, at "
                f"{', '.join(_frequency(result, k) for k in bins.tolist())}: steps of {step:.3g} "
                f"{signal.unit}, noise of {noise:.3g} {signal.unit}"
            )
    return sentences


def silence(result: Identification) -> list[str]:
    """Name the silent bins, and the silent bands of the energy test.

    Parameters
    ----------
    result : Identification

    Returns
    -------
    list of str, sentences
    """
    sentences = []
    for k in result.weights.silent:
        few = f"fewer than {FEWEST_FRAMES} successive frames set its bounds"
        weak = (
            "on the drives that set the bounds a vehicle that does not respond would have had margins of at "
            f"most {result.origins.evidence[k]:.2f}"
        )
        why = weak if result.origins.evidence[k] <= 1 else few
        if _all_silent(result) and result.bounds.omega[k] == 0:
            why = "every other bin is silent"
        sentences.append(f"{_frequency(result, k)} is silent: {why}")
    if result.energy is not None and result.energy.silent:
        names = ", ".join(result.energy.bands[b] for b in result.energy.silent)
        sentences.append(f"energy test: silent in the bands {names}, because every bin is silent")
    return sentences


def _frequency(result: Identification, k: int) -> str:
    return f"{result.bounds.omega[k]:.3g} rad/s"
