"""The new identification of signed decisions, and both identifications side by side."""

from __future__ import annotations

import csv
import io
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...base import artefacts
from ...base.errors import InputError
from ...base.parallel import Map
from ...drives.tables import EXPERIMENTS, TABLE_SUFFIXES, index_rows, list_experiments
from ...fit import fitted_model
from ...fit.project_file import text_of
from ...identify import identification as stage
from ...replay.replayer import Replayer
from ...report.pictures.drawing import standalone
from ...report.pictures.over_bins import sets_side_by_side
from ...vehicle.project import Project
from ..fleet.scores import DriveEstimate
from .decisions import GROUP_OF_KNOWN, Decisions, DriveDecision, Evidence
from .lineage import DRIVES, IDENTIFICATION, KIND, LIFE, ORIGIN, OWN, Lineage, put
from .own import OwnGains, estimated_file, responses
from .proposals import CONDITION, RECENTRE

DECISIONS, FIT, TABLE, PICTURE = "decisions.toml", "fit", "table.json", "bounds.svg"
SETS = {"certificate": "certificate", "frame_test": "frame test"}
"""Names for people of the two sets of `compared`."""


def renew(
    lineage: Lineage,
    path: Path,
    out: Path,
    vehicle: str | None = None,
    workers: Map = map,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Identify with the accepted drives, and write the refined folder.

    Parameters
    ----------
    lineage : Lineage
    path : Path, file of decisions
    out : Path, new folder
    vehicle : str or None, project file, which a new nominal model is written from
    workers : Map
    progress : Callable, reports progress

    Returns
    -------
    dict, of `compared`

    Raises
    ------
    InputError
        If the decisions are of another identification, are not signed, or a drive has changed.
    """
    decisions, here = Decisions.read(path), path.absolute().parent
    if decisions.identification != lineage.stored.manifest["seal"]:
        raise InputError(
            path, "identification", "is another one", f"that of {lineage.stored.folder}: judge again"
        )
    accepted = decisions.accepted
    if not accepted:
        raise InputError(path, "", "no drive is accepted", "accept = true in an entry at least")
    recentred = any(d.action == RECENTRE for d in accepted)
    if recentred and vehicle is None:
        raise InputError("refine", "--vehicle", "not given", "the project file: a drive recentres the model")
    for d in decisions.drives:
        if artefacts.file_hash(d.experiment(here).path) != d.sha256:
            raise InputError(d.experiment(here).path, "", "has changed since it was judged", "judge again")
    evidence = Evidence(
        [d.experiment(here) for d in decisions.drives], {d.name: d.vehicle for d in decisions.drives}
    )
    project = lineage.stored.project
    with artefacts.new_folder(out, KIND, project.name) as folder:
        progress("own gains and lifetime test")
        _write_drives(lineage, evidence, accepted, folder, workers)
        if recentred:
            progress("new nominal model")
            fitted = fitted_model.fit(project, folder / DRIVES)
            fitted_model.save(fitted, text_of(str(vehicle)), str(vehicle), folder / FIT)
            project = fitted.project
        result, drives = stage.identify(project, folder / DRIVES, workers=workers, progress=progress)
        stage.save(result, drives, folder / IDENTIFICATION)
        shutil.copytree(lineage.origin, folder / ORIGIN)
        shutil.copyfile(path, folder / DECISIONS)
        lineage_of = {"seal": lineage.stored.manifest["seal"], "signed_by": decisions.signed_by}
        note = artefacts.manifest(
            KIND,
            vehicle=project.name,
            before=lineage_of,
            accepted={d.name: d.action for d in accepted},
            refused=[d.name for d in decisions.drives if not d.accept],
        )
        table = compared(lineage.stored, stage.load(folder / IDENTIFICATION))
        files = {TABLE: artefacts.to_json(table), PICTURE: drawn(project, table), artefacts.MANIFEST: note}
        artefacts.write_files(folder, files)
        return table


def _write_drives(
    lineage: Lineage, evidence: Evidence, accepted: list[DriveDecision], folder: Path, workers: Map
) -> None:
    """Write the own gains, all drives divided by them, and the lifetime test's state."""
    with lineage.first() as first:
        own = own_gains(lineage, first, evidence, {d.name for d in accepted}, workers)
        artefacts.write_files(folder, {OWN: own.text})
        with evidence.divided(own, lineage.stored.project, folder, workers) as divided:
            _merge(lineage, accepted, divided, folder / DRIVES)
            divided.lived(lineage, first, workers)[0].write(folder / LIFE)


def own_gains(
    lineage: Lineage, first: Replayer, evidence: Evidence, accepted: set[str], workers: Map = map
) -> OwnGains:
    """Own gains, also of the vehicles of which drives are accepted for the first time.

    The vehicle with the project's name is that of the first identification, and has gains of 1.
    """
    own, estimates_of = lineage.own, partial(estimated_file, first)
    if not own.known:
        calibrating = set(lineage.stored.manifest["drives"]["calibration"])
        known = [e for e in list_experiments(lineage.drives) if e.name in calibrating]
        own = OwnGains(tuple(map(float, responses(list(workers(estimates_of, known))).mean(axis=0))))
    without = {*own.vehicles, lineage.stored.project.name}
    new = [e for e in evidence.experiments if e.name in accepted and evidence.vehicle[e.name] not in without]
    by_vehicle: dict[str, list[tuple[DriveEstimate, ...]]] = {}
    for e, estimates in zip(new, workers(estimates_of, new), strict=True):
        by_vehicle.setdefault(evidence.vehicle[e.name], []).append(estimates)
    for vehicle, first_drives in by_vehicle.items():
        own = own.joined(vehicle, first_drives)
    return own


def _merge(lineage: Lineage, accepted: list[DriveDecision], divided: Evidence, folder: Path) -> None:
    """Write the folder of the known and the accepted drives; files are linked."""
    folder.mkdir()
    rows = index_rows(lineage.drives / EXPERIMENTS)
    for row in rows:
        for suffix in TABLE_SUFFIXES:
            if (table := lineage.drives / f"{row['experiment']}{suffix}").is_file():
                put(table.resolve(), folder / table.name)
    tables = {e.name: e.path for e in divided.experiments}
    for d in accepted:
        table = tables[d.name]
        put(table.resolve(), folder / f"{d.name}{table.suffix}")
    roles = {*lineage.stored.project.data.bound_split, *lineage.stored.project.data.noise_split}
    further = [
        {"experiment": d.name, "split": d.split, "driver": d.driver}
        | ({"recording": d.recording} if d.recording != d.name else {})
        | ({"group": d.group} if d.group else {})
        for d in accepted
    ]
    every = [*rows, *further]
    if any(d.action == CONDITION for d in accepted) or any(row.get("group") for row in rows):
        for row in every:
            if row["split"] not in roles and not row.get("group"):
                row["group"] = GROUP_OF_KNOWN
    columns = list(dict.fromkeys(column for row in every for column in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(every)
    artefacts.write_files(folder, {EXPERIMENTS: text.getvalue()})


def compared(before: stage.StoredIdentification, after: stage.StoredIdentification) -> dict[str, Any]:
    """Compare two identifications of the same frames: a pair [before, after] by name; bounds by bin."""
    both = before, after
    omega = after.estimator.omega
    tests = {
        "frame": [s.calibration for s in both],
        "energy": [s.energy_of_core.calibration for s in both],
        "change": [s.change_of_core.calibration for s in both],
    }
    at_bins = [s.fitted.at(omega) for s in both]
    of_frames = [s.fitted.of_frames(omega) for s in both]
    return {
        "drives": [len(s.manifest["sha256"]) for s in both],
        "omega_rad_s": omega,
        "nu": [s.bounds["nu"] for s in both],
        "B_w": [s.bounds["B_w"] for s in both],
        "certificate": {"W_delta": [W for W, _ in at_bins], "B_w": [B for _, B in at_bins]},
        "frame_test": {"W_delta": [W for W, _ in of_frames], "B_w": [B for _, B in of_frames]},
        "silent_bins": [list(s.fitted.silent) for s in both],
        "thresholds": {test: [c.carried for c in calibrations] for test, calibrations in tests.items()},
        "alpha": {test: [c.alpha for c in calibrations] for test, calibrations in tests.items()},
        "alpha_below": {
            test: [c.conditional_bound for c in calibrations] for test, calibrations in tests.items()
        },
        "smallest_gain_error": [_smallest_gain(s) for s in both],
    }


def drawn(project: Project, result: dict[str, Any]) -> str:
    """Draw the bounds of both identifications that `compared` returns, as an SVG."""
    sets = {name: {b: np.array(x) for b, x in result[key].items()} for key, name in SETS.items()}
    return standalone(sets_side_by_side("bounds", np.array(result["omega_rad_s"]), sets, project.outputs))


def _smallest_gain(stored: stage.StoredIdentification) -> float | None:
    """Smallest gain error that typical excitation shows, of all speed cells."""
    gains = [c["smallest_gain_error"] for c in stored.visibility["at_percentile"]]
    return min((g for g in gains if g is not None), default=None)


def rows_of(result: dict[str, Any]) -> list[dict[str, str]]:
    """Write the table for people.

    Parameters
    ----------
    result : dict, of `compared`

    Returns
    -------
    list of dict, rows by column
    """

    def number(x: float | None) -> str:
        return "–" if x is None else f"{x:.4g}"

    def row(name: str, pair: list[Any]) -> dict[str, str]:
        return {"": name, "before": number(pair[0]), "after": number(pair[1])}

    rows = [{"": "drives", "before": str(result["drives"][0]), "after": str(result["drives"][1])}]
    for key, name in SETS.items():
        for bound in ("W_delta", "B_w"):
            pair = result[key][bound]
            rows.append(row(f"{name}, mean {bound}", [float(np.mean(x)) for x in pair]))
            growth = pair[1] / np.maximum(pair[0], np.finfo(float).tiny)
            rows.append({"": f"{name}, {bound} after / before", "before": "1",
                         "after": f"{growth.min():.4g} to {growth.max():.4g}"})  # fmt: skip
    for key, name in {"thresholds": "threshold", "alpha": "alpha", "alpha_below": "alpha below"}.items():
        rows += [row(f"{test} test, {name}", pair) for test, pair in result[key].items()]
    rows.append(row("smallest visible gain error", result["smallest_gain_error"]))
    silent = [str(len(x)) for x in result["silent_bins"]]
    return [*rows, {"": "silent bins", "before": silent[0], "after": silent[1]}]
