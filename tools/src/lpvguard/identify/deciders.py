"""What decides the bounds and the thresholds of an identification, in words, and where a bin is silent.

A frame that alone decides a bound or a threshold is worth a look: a crash, a slide or a wrong sample may have
made it. Nothing is dropped in silence: experiments.csv sets a drive aside, with its reason.
"""

from __future__ import annotations

import numpy as np

from .calibration import Calibration, calibrate
from .model_error import FEWEST_FRAMES
from .run import Identification

ONE_FRAME = 1.1
"""One frame is said to decide a number that is larger by this factor than it would be without it."""


def decides_bounds(result: Identification) -> list[str]:
    """A sentence for every nu and B_w above 0: the drive, and the time of the frame that decides it. Where
    one frame does: what it would be without that one and those that overlap it."""
    Ts, said = result.project.Ts_s, []
    for key, of in result.origins.decided.items():
        shared = of.largest.shape[1] == 1 and key == "nu"
        names = [""] if shared else [f" of {s.name}" for s in result.project.outputs]
        for k, j in np.argwhere(of.largest > 0):
            value, without = float(of.largest[k, j]), float(of.without[k, j])
            said.append(
                f"{_hertz(result, k)}: {of.drive[k, j]} decides {key}{names[j]}, {value:.3g}, from "
                f"{of.first[k, j] * Ts:.4g} s on"
                + (f"; one frame does: without it {without:.3g}" if value > ONE_FRAME * without else "")
            )
    return said


def decides_thresholds(result: Identification) -> list[str]:
    """A sentence for every threshold: the drive, the time and the bin or band that decide it. Where one frame
    does: what the threshold would be without it."""
    tests: dict[str, Calibration | None] = {
        "frame": result.calibration,
        "energy": None if result.energy is None else result.energy.calibration,
        "change": None if result.change is None else result.change.calibration,
    }
    return [_decides(result, test, c) for test, c in tests.items() if c is not None]


def _decides(result: Identification, test: str, c: Calibration) -> str:
    drive = c.decided_by
    if drive is None:
        return f"{test} test: no drive decides the threshold {c.carried:.4g}, its floor"
    said = f"{test} test: {drive} decides the threshold {c.carried:.4g}"
    peak = result.origins.peaks[drive].get(test)
    if peak is None:  # without a core nothing says where
        return said
    said += f", at {peak.t_s:.4g} s"
    if peak.place is not None and test == "frame":
        said += f", {_hertz(result, peak.place)}"
    elif peak.place is not None and result.energy is not None:
        said += f", band {result.energy.bands[peak.place]}"
    if peak.without is None:
        return said
    alpha = result.project.frame_test.alpha
    left = calibrate(c.scores | {drive: peak.without}, alpha, recordings=c.recordings).carried
    return said if c.carried <= ONE_FRAME * left else f"{said}; one frame does: without it {left:.4g}"


def silence(result: Identification) -> list[str]:
    """A sentence for each silent bin, and one for silent bands of the energy test."""
    said = []
    for k in result.weights.silent:
        few = f"fewer than {FEWEST_FRAMES} frames one after another set its bounds"
        weak = (
            "on the drives that set the bounds a vehicle that does not respond would have had margins up to "
            f"{result.origins.evidence[k]:.2f}"
        )
        said.append(f"{_hertz(result, k)} is silent: {weak if result.origins.evidence[k] <= 1 else few}")
    if result.energy is not None and result.energy.silent:
        names = ", ".join(result.energy.bands[b] for b in result.energy.silent)
        said.append(f"energy test: silent in the bands {names}, since every bin is")
    return said


def _hertz(result: Identification, k: int) -> str:
    return f"{result.bounds.omega[k] / (2 * np.pi):.3g} Hz"
