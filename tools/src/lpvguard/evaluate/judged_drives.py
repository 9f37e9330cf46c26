"""Choose the drives to judge and the calibrations that judge them.

Either each drive of the identification is judged without itself, or held-out drives are judged. The stored
calibration judges held-out drives; they calibrate nothing. A drive of a group is judged with the threshold of
that group, if there is one.

A held-out table with the bytes of a table that set bounds or noise, or that calibrated, is refused. Other
pieces of its recording are also refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..drives.tables import Experiment, list_experiments, table_hashes
from ..identify.calibration import Calibration, Recordings, calibrate
from ..identify.change import calibrated_change
from ..identify.identification import DriveSet, StoredIdentification
from ..identify.joint import FLOORS, POOLS, joint_calibration, with_joint_thresholds
from .comparison import HELD_OUT, LEFT_ONE_OUT, MONITOR

SAW = {"bounds": "set the bounds", "calibration": "calibrated", "noise": "set the noise"}
"""Use of a group of drives in the identification."""


@dataclass(frozen=True)
class JudgedDrives:
    """Drives by name, their recordings, and the calibrations that judge them.

    ``pool_scale`` (SPEEDS, K, 2, n_y) of a drive scales the pools without its recording; None without pools.
    ``mode`` is LEFT_ONE_OUT or HELD_OUT. ``rule`` describes the calibrating drives.
    """

    mode: str
    rule: str
    experiments: dict[str, Experiment]
    calibrations: dict[str, dict[str, Calibration]]
    recordings: Recordings
    pool_scale: dict[str, np.ndarray | None]

    @classmethod
    def left_one_out(cls, stored: StoredIdentification, drives: DriveSet) -> JudgedDrives:
        """Judge each calibration drive by drives of other recordings; InputError if no frame counts."""
        if not stored.calibration.scores:
            raise InputError(
                stored.folder,
                "drives",
                "no calibration drive has a counted frame, so no drive is left to evaluate",
                "at least one drive whose "
                f"split is not {' or '.join(stored.project.data.bound_split)} and in which a frame counts",
            )
        names, recordings = list(stored.calibration.scores), stored.calibration.recordings
        return cls(
            LEFT_ONE_OUT,
            "all other drives that did not set the bounds",
            {name: drives.experiments[name] for name in names},
            {name: _of_group(_calibrations(stored, name), recordings.groups.get(name)) for name in names},
            recordings,
            {
                name: None if (p := stored.pools) is None else p.scale(recordings.named(name))
                for name in names
            },
        )

    @classmethod
    def held_out(cls, stored: StoredIdentification, experiments: list[Experiment]) -> JudgedDrives:
        """Judge drives that the identification never saw by its stored calibration."""
        together = _calibrations(stored, None)[MONITOR]
        as_stored = {MONITOR: together, **calibrations_of(stored)}
        return cls(
            HELD_OUT,
            "drives that took no part in the identification",
            {e.name: e for e in experiments},
            {e.name: _of_group(as_stored, e.group) for e in experiments},
            Recordings.listed((), experiments),
            {e.name: None if stored.pools is None else stored.pools.scale() for e in experiments},
        )


def rate_of(judged: JudgedDrives, stored: StoredIdentification) -> dict | None:
    """Target rate and the least hours that a threshold is extrapolated from; None without a target."""
    target = stored.project.frame_test.alarms_per_1000_h
    if target is None:
        return None
    tails = [calibrations[MONITOR].extrapolation for calibrations in judged.calibrations.values()]
    hours = [t.hours for t in tails if t is not None]
    return {"per_1000_h": target, "extrapolated_from_h": min(hours) if hours else None}


def _of_group(calibrations: dict[str, Calibration], group: str | None) -> dict[str, Calibration]:
    """Thresholds for drives of the group."""
    return {what: c.of_group(group) for what, c in calibrations.items()}


def _calibrations(stored: StoredIdentification, without: str | None) -> dict[str, Calibration]:
    """Calibrations of the monitor and each test on all calibration drives but those of ``without``."""
    scores = {test: c.scores for test, c in calibrations_of(stored).items()}
    targets = {test: c.target for test, c in calibrations_of(stored).items()}
    if stored.pools is not None:
        scores[POOLS], targets[POOLS] = stored.pools.scores(without), stored.pools.target(without)
    rules: dict[str, Callable[..., Calibration]] = {
        "frame": calibrate,
        "energy": partial(calibrate, floor=FLOORS["energy"]),
        "change": calibrated_change,
        POOLS: calibrate,
    }
    alpha, recordings = stored.project.frame_test.alpha, stored.calibration.recordings
    tests = {
        test: rules[test](
            {k: scores[test][k] for k in recordings.others(scores[test], without)},
            alpha,
            recordings=recordings,
            target=targets[test],
        )
        for test in scores
    }
    together = joint_calibration(tests, alpha)
    if stored.project.frame_test.joint:
        tests = with_joint_thresholds(tests, together)
    return {**tests, MONITOR: together}


def calibrations_of(stored: StoredIdentification) -> dict[str, Calibration]:
    """Return the stored calibration of each test.

    Parameters
    ----------
    stored : StoredIdentification

    Returns
    -------
    dict[str, Calibration], by test

    Raises
    ------
    InputError
        If there is only the frame test, as with frames of the plain DFT.
    """
    if stored.energy is None or stored.change is None:
        raise InputError(
            stored.folder, "energy", "there is no energy test", "an identification with Hann frames"
        )
    calibrations = {
        "frame": stored.calibration,
        "energy": stored.energy.calibration,
        "change": stored.change.calibration,
    }
    return calibrations if stored.pools is None else calibrations | {POOLS: stored.pools.calibration}


def drives_to_judge(stored: StoredIdentification, folders: Iterable[Path]) -> list[Experiment]:
    """List the drives of folders that the identification never saw.

    Parameters
    ----------
    stored : StoredIdentification
    folders : Iterable[Path]

    Returns
    -------
    list of Experiment

    Raises
    ------
    InputError
        If the identification saw a drive or a piece of its recording, or if a name or table occurs twice.
    """
    experiments: dict[str, Experiment] = {}
    for e in (e for folder in folders for e in list_experiments(folder)):
        if (other := experiments.setdefault(e.name, e)) is not e:
            raise InputError(e.path, "", f"has the same name as {other.path}", "drives of different names")
    chosen = list(experiments.values())
    seen = {stored.manifest["sha256"][n]: (n, SAW[k]) for k in SAW for n in stored.manifest["drives"][k]}
    for name, digest in table_hashes(chosen).items():
        if digest in seen:
            raise InputError(
                experiments[name].path,
                "",
                f"is the same table as {seen[digest][0]}, which {seen[digest][1]} in {stored.folder}",
                "drives that the identification did not see",
            )
    for e in chosen:
        _require_new_recording(stored, e)
    return chosen


def _require_new_recording(stored: StoredIdentification, e: Experiment) -> None:
    """Raise InputError for another piece of a recording that the identification knows."""
    if e.recording == e.name:
        return
    for what, did in SAW.items():
        for name in stored.manifest["drives"][what]:
            if stored.calibration.recordings.named(name) == e.recording:
                raise InputError(
                    e.path,
                    "",
                    f"is a piece of recording {e.recording}, as is {name}, which {did} in {stored.folder}",
                    "recordings that the identification did not see",
                )
