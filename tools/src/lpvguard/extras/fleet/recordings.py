"""`lpvguard fleet`: score each recording of the vehicles once, in order, and update their wealth.

The first call fixes the calibration set in the state. A recording is counted only once. It is refused if its
tables have changed since then. A folder with added drives may therefore be given again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...base import artefacts
from ...base.errors import InputError
from ...base.parallel import Map
from ...base.rates import per_hour, rate
from ...drives.tables import Experiment, index_column, list_experiments, set_aside, table_hashes
from ...identify.export import SHORT_HASH
from ...replay.replayer import Replayer
from .scores import Scored, recordings_of, require_new
from .state import FleetState, Member, Terms
from .wealth import Life

JUDGED_S, ALPHA, ETA = 60.0, 0.05, 0.05
"""Defaults."""
CALIBRATED = "calibrated"


def terms_of(replayer: Replayer, judged_s: float | None, alpha: float | None, eta: float | None) -> Terms:
    """Terms with defaults in place of None; InputError for an impossible length."""
    length = JUDGED_S if judged_s is None else judged_s
    if not replayer.project.Ts_s <= length < np.inf:
        raise InputError("fleet", "judged_s", f"{length:g}", f"finite, at least {replayer.project.Ts_s:g} s")
    return Terms(
        replayer.project.name,
        str(artefacts.read_manifest(replayer.core.folder, "vehicle")["seal"]),
        length,
        ALPHA if alpha is None else alpha,
        ETA if eta is None else eta,
    )


@dataclass(frozen=True)
class Listed:
    """Drives of a folder in the order of the vehicle's life.

    Attributes
    ----------
    folder : Path
    experiments : list[Experiment]
    vehicle, left_out : dict[str, str], vehicle of each drive, and reason for each excluded drive
    """

    folder: Path
    experiments: list[Experiment]
    vehicle: dict[str, str]
    left_out: dict[str, str]

    @classmethod
    def from_folder(cls, folder: Path, order: str | None = None, by: str | None = None) -> Listed:
        """Drives of experiments.csv, sorted by the text in column ``order``, by default in the file's order.

        Column ``by`` names the vehicle; by default all drives belong to one vehicle. Raises InputError if
        pieces of a recording belong to several vehicles, or if a table is listed twice.
        """
        experiments = list_experiments(folder)
        if order is not None:
            key = index_column(folder, order)
            experiments.sort(key=lambda e: key[e.name])
        table_hashes(experiments)
        vehicle = (
            {e.name: folder.resolve().name for e in experiments} if by is None else index_column(folder, by)
        )
        first: dict[str, Experiment] = {}
        for e in experiments:
            if vehicle[first.setdefault(e.recording, e).name] != vehicle[e.name]:
                raise InputError(
                    folder, f"column {by}", f"recording {e.recording} is of two", "one a recording"
                )
        return cls(folder, experiments, vehicle, set_aside(folder))


def calibrated_state(
    replayer: Replayer,
    terms: Terms,
    folder: Path,
    workers: Map = map,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[FleetState, dict[str, str]]:
    """Make a state from a folder of calibration drives; also return why recordings were left out.

    Drives that set the bounds are left out, by their split and by the hashes in the generated folder.
    Recordings that are too short are also left out. Raises InputError if no recording remains.
    """
    identification = artefacts.read_manifest(replayer.core.folder, "vehicle").get("identification", {})
    setting = identification.get("bound_setting", [])
    listed = Listed.from_folder(folder)
    sets = {
        e.recording
        for e in listed.experiments
        if e.split in replayer.project.data.bound_split or artefacts.file_hash(e.path)[:SHORT_HASH] in setting
    }
    left_out = {**listed.left_out, **dict.fromkeys(sorted(sets), "set the bounds")}
    chosen = [e for e in listed.experiments if e.recording not in sets]
    recordings = recordings_of(replayer, chosen, terms.judged_s, workers, progress)
    left_out |= {s.name: too_short(s, terms) for s in recordings if s.score is None}
    scores = {s.name: s.score for s in recordings if s.score is not None}
    if not scores:
        raise InputError(
            folder, "", "no recording calibrates", f"one with at least {terms.judged_s:g} s of judged driving"
        )
    return FleetState(terms, scores, {s.name: s.sha256 for s in recordings if s.score is not None}), left_out


def too_short(recording: Scored, terms: Terms) -> str:
    """Text on why a recording has no score."""
    return f"{recording.judged_s:.1f} s of judged driving, less than {terms.judged_s:g} s"


def begun(
    replayer: Replayer,
    path: Path | None,
    calibration: Path | None,
    stated: Mapping[str, float | None],
    workers: Map = map,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[FleetState, dict[str, str]]:
    """Read the state from a file, or make a new one from calibration drives.

    Parameters
    ----------
    replayer : Replayer
    path : Path or None, state file
    calibration : Path or None, folder of calibration drives
    stated : Mapping, judged_s, alpha and eta, or None
    workers : Map
    progress : Callable, reports progress

    Returns
    -------
    tuple of FleetState and dict, which gives the reason for each left-out recording

    Raises
    ------
    InputError
        If both or neither of them are given, or if the file has other terms.
    """
    terms = terms_of(replayer, **stated)
    kept = FleetState.read(path) if path is not None and path.exists() else None
    if kept is not None and path is not None:
        if calibration is not None:
            raise InputError(path, "--calibration", "given, but --state has a set", "one of them")
        kept.require(path, {"vehicle": terms.vehicle, "coefficients": terms.coefficients, **stated})
        return kept, {}
    if calibration is None:
        raise InputError("fleet", "--calibration", "not given", "a folder, or a --state with a set")
    return calibrated_state(replayer, terms, calibration, workers, progress)


@dataclass
class _Results:
    """Results of a vehicle for each recording."""

    rows: list[dict[str, Any]]
    left_out: dict[str, str]
    already: int = 0


def follow(
    replayer: Replayer,
    state: FleetState,
    listed: Listed,
    left_out: dict[str, str],
    workers: Map = map,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[FleetState, dict[str, Any]]:
    """Update a state with a folder's recordings.

    On an error the state stays unchanged.

    Parameters
    ----------
    replayer : Replayer
    state : FleetState
    listed : Listed
    left_out : dict[str, str], reason for each left-out calibration recording
    workers : Map
    progress : Callable, reports progress

    Returns
    -------
    tuple of FleetState and dict, the object of `lpvguard fleet --json`

    Raises
    ------
    InputError
        If a recording was counted before with other tables or under another name, or if a table calibrated.
    """
    results = {
        name: _Results([], {}) for name in dict.fromkeys(listed.vehicle[e.name] for e in listed.experiments)
    }
    new = []
    for e in listed.experiments:
        counted = state.members.get(listed.vehicle[e.name], Member()).counted.get(e.recording)
        if counted is None:
            new.append(e)
        elif counted.get(e.name) != artefacts.file_hash(e.path):
            raise InputError(
                e.path, "", f"recording {e.recording} was counted with other tables", "as it was"
            )
        else:
            results[listed.vehicle[e.name]].already += 1
    recordings = recordings_of(replayer, new, state.terms.judged_s, workers, progress)
    require_new(listed.folder, recordings, _seen(state))
    table = state.table
    for recording in recordings:
        vehicle = listed.vehicle[next(iter(recording.sha256))]
        if recording.score is None:
            results[vehicle].left_out[recording.name] = too_short(recording, state.terms)
            continue
        member = state.members.get(vehicle, Member())
        place = int(table.place(recording.score))
        after = member.after(recording.name, recording.sha256, place, table)
        state = state.with_member(vehicle, after)
        results[vehicle].rows.append(_row(recording, place, after))
    return state, _summary(state, listed, results, left_out)


def _seen(state: FleetState) -> dict[str, str]:
    """How each table was used that may not be counted again, by hash."""
    did = {h: CALIBRATED for tables in state.calibrated.values() for h in tables.values()}
    for name, member in state.members.items():
        for recording, tables in member.counted.items():
            did |= dict.fromkeys(tables.values(), f"was counted for {name} as {recording}")
    return did


def _row(recording: Scored, place: int, after: Member) -> dict[str, Any]:
    return {
        "recording": recording.name,
        "drives": len(recording.sha256),
        "judged_s": round(recording.judged_s, 6),
        "score": recording.score,
        "levels_below": place,
        "alarmed": recording.alarmed,
        "wealth": after.life.wealth,
        "estimates": [asdict(e) for e in recording.estimates],
    }


def _calibration(state: FleetState, left_out: dict[str, str]) -> dict[str, Any]:
    """Properties of the calibration set: size, levels, factors, and the earliest possible alarm of a life."""
    table = state.table
    return {
        "recordings": table.n,
        "drives": sum(len(tables) for tables in state.calibrated.values()),
        "levels": [float(x) for x in table.levels],
        "largest_factor": float(table.factors.max()),
        "earliest": table.earliest(Life()),
        "left_out": left_out,
    }


def _summary(
    state: FleetState, listed: Listed, results: dict[str, _Results], left_out: dict[str, str]
) -> dict[str, Any]:
    vehicles = {}
    for name, result in results.items():
        member = state.members.get(name, Member())
        judged_h = sum(r["judged_s"] for r in result.rows) / 3600
        alarmed = sum(r["alarmed"] for r in result.rows)
        vehicles[name] = {
            "recordings": member.life.recordings,
            "wealth": member.life.wealth,
            "changed_at": member.life.changed_at or None,
            "changed_by": member.changed_by,
            "earliest": state.table.earliest(member.life),
            "already_counted": result.already,
            "left_out": result.left_out,
            "judged_h": judged_h,
            "alarmed": rate(alarmed, len(result.rows)),
            "alarmed_per_judged_h": per_hour(alarmed, judged_h),
            "new": result.rows,
        }
    return {
        "terms": asdict(state.terms),
        "calibration": _calibration(state, left_out),
        "vehicles": vehicles,
        "left_out": listed.left_out,
    }


def changed(result: dict[str, Any]) -> list[str]:
    """List the vehicles whose wealth has reached the alarm level.

    Parameters
    ----------
    result : dict, of `follow`

    Returns
    -------
    list of str
    """
    return [name for name, v in result["vehicles"].items() if v["changed_at"] is not None]
