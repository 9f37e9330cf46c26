"""`lpvguard new`: makes a project file with the reason for each line, a signal map and a folder of drives.

Writes a folder with

    NAME.toml       the project file; every guessed value has its source in a comment
    signals.toml    the signal map, for further logs (`lpvguard ingest --signals`)
    drives/         drive tables, reports and experiments.csv, every second recording to set bounds
    MANIFEST.json   the logs' hashes, and the seal
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..base import artefacts
from ..base.errors import InputError
from ..can.decode import decode_all, load_database, own_database
from ..can.logs import Frames, Series, Table, read_log, stem
from ..drives.frames import Estimator
from ..drives.ingest import Inputs, write_tables
from ..drives.resample import REORDER_S, standing_alone
from ..drives.signal_map import SignalMap
from ..drives.splits import day, groups_of, split_notes, splits_of
from ..drives.tables import Drive, index_text, read_drive
from ..drives.unit_names import DIMENSIONS as SI
from ..drives.units import unit_factor
from ..vehicle.nominal import NominalModel
from ..vehicle.physics import KindName, kind_of
from ..vehicle.project import NAME, EvaluationSettings, Project, parse_project
from .design_proposal import design_section, shown
from .own_bus_text import with_own_bus
from .readings import ROLES, Known
from .redundant import Redundant, redundant
from .signal_map_text import COLUMNS, Signals, comment, sign_bits_of, signal_map_text
from .signals import Proposal, Recording, proposed
from .steady_turn import Driven, steady_turn
from .templates import TEMPLATES, VEHICLE_PARAMETERS, Scale

if TYPE_CHECKING:  # cantools takes long to import
    pass

SPIKE, USUAL = 2.0, 0.999
"""A sample above SPIKE times the largest of the share USUAL of the samples is no measurement."""
LONGEST_STEP_S = 0.5
"""Samples further apart are a gap, as `ingest` takes it, and not driving at a slow rate."""
MANY_CHANGES = 100
"""So many changes of a signal tell how often it has a new value."""
RATES_HZ = (1000.0, 500.0, 200.0, 100.0, 50.0, 40.0, 25.0, 20.0, 10.0, 5.0)
"""Rates of a grid: the largest that the slowest signal reaches."""
JUDGED = 0.3
"""Least share of the drives that should count in the lowest bin."""
GRIDS = tuple((f, tolerance) for f in (0.1, 0.2, 0.3, 0.5) for tolerance in (0.15, 0.25, 0.35))
"""Lowest frequency [Hz] and speed tolerance, best first."""


@dataclass(frozen=True)
class NewProject:
    """Result of `new`: project, proposals, further measurements of the output, drives with their split,
    left-out logs with reasons, and sentences."""

    project: Project
    proposals: dict[str, Proposal]
    further: list[Redundant]
    splits: dict[str, str]
    left_out: dict[str, str]
    notes: list[str]


def new(
    name: str,
    logs: list[Path],
    out: Path,
    *,
    dbc: Path | None = None,
    model: str = "yaw-first-order",
    chosen: dict[str, str | None] | None = None,
    wheelbase_m: float | None = None,
    kind: KindName | None = None,
    ratio: float | None = None,
    units: dict[str, str | None] | None = None,
    channel: str | None = None,
    schema: Path | None = None,
    time: str | None = None,
    rate_hz: float | None = None,
    parts: bool = False,
) -> NewProject:
    """Make a project from logs and write its folder.

    Parameters
    ----------
    name : str, of the vehicle
    logs : list[Path]
    out : Path, new folder
    dbc : Path, optional, CAN database of raw logs
    model : str, template of the nominal model, default 'yaw-first-order'
    chosen : dict, optional, signal by role, or None to choose
    wheelbase_m : float, optional, m
    kind : str, optional, kind of vehicle, by default as the wheelbase suggests
    ratio : float, optional, steering wheel over road wheel
    units : dict, optional, unit by role, or None to find it
    channel : str, optional, of raw logs with several
    schema : Path, optional, log.capnp of openpilot's logs
    time : str, optional, time column of tables
    rate_hz : float, optional, Hz, rows a second of tables without times
    parts : bool, optional, every measurement of the yaw rate is an output, default False

    Returns
    -------
    NewProject

    Raises
    ------
    InputError
        If no signal fits a role, or no drive remains.
    """
    _require_sound(name, model, wheelbase_m)
    recordings, left_out = recordings_of(logs, dbc, channel, schema, time, rate_hz)
    known = Known(kind or kind_of(wheelbase_m), wheelbase_m, ratio)
    proposals = proposed(recordings, chosen or {}, known, units)
    measurements = redundant(recordings, proposals)
    Ts = _sample_time(recordings, [p.name for p in proposals.values()])
    limits = {role: _limits(role, p, recordings) for role, p in proposals.items()}
    database = load_database(dbc) if dbc else own_database()
    read_by = {"channel": channel, "time": time, "rate_hz": rate_hz}
    taken = proposals, limits, measurements if parts else []
    signals = signal_map_text(taken, Ts, read_by, sign_bits_of(database))
    with artefacts.new_folder(out, "new", name) as folder:
        (folder / "drives").mkdir()
        inputs = Inputs(
            database,
            dbc or "lpvguard's own DBC (no --dbc given)",
            SignalMap.model_validate(tomllib.loads(signals)),
            Path("signals.toml"),
            schema,
        )
        kept_logs = [p for p in logs if stem(p) in {r.name for r in recordings}]
        names, days = _written(kept_logs, inputs, folder / "drives", left_out)
        if not names:
            reason = next(iter(left_out.values()))
            raise InputError("new", "LOG", f"no drive remains of the logs ({reason})", "logs of driving")
        project, text, notes = _project(name, model, taken, folder / "drives", list(names), Ts, known)
        splits = splits_of(_speeds(project, folder / "drives", names), names, days)
        notes += split_notes(splits, names, days)
        artefacts.write_files(
            folder,
            {
                f"{name}.toml": text if dbc is None else with_own_bus(text, proposals, dbc),
                "signals.toml": signals,
                "drives/experiments.csv": _index(splits, names, days),
                artefacts.MANIFEST: artefacts.manifest(
                    "new", vehicle=name, inputs={p.name: artefacts.file_hash(p) for p in logs}
                ),
            },
        )
    return NewProject(project, proposals, measurements, splits, left_out, notes)


def _index(splits: dict[str, str], names: dict[str, str], days: dict[str, str]) -> str:
    """Text of experiments.csv, with a column of groups where there are any."""
    groups = groups_of({r: days[r] for r in names.values()})
    rows = [(n, split, names[n]) for n, split in splits.items()]
    if not groups:
        return index_text(rows)
    return index_text(((*row, groups[row[2]]) for row in rows), "recording", "group")


def _require_sound(name: str, model: str, wheelbase_m: float | None) -> None:
    if not re.fullmatch(NAME, name):
        raise InputError("new", "NAME", repr(name), "lower case letters, digits and _, a letter first")
    if model not in TEMPLATES:
        raise InputError("new", "--model", model, f"one of {', '.join(TEMPLATES)}")
    if wheelbase_m is None and model == "bicycle":
        raise InputError("new", "--wheelbase", "not given", "the wheelbase in m, which the bicycle needs")


def _speeds(project: Project, folder: Path, names: Iterable[str]) -> dict[str, np.ndarray]:
    """Speed (N,) of each drive."""
    return {n: read_drive(folder / f"{n}.csv", project).v for n in names}


def _written(
    logs: list[Path], inputs: Inputs, folder: Path, left_out: dict[str, str]
) -> tuple[dict[str, str], dict[str, str]]:
    """Write the drives of all logs; recording by drive, and day by recording, "" where nothing tells it.

    A single log of one drive becomes two drives: one sets the bounds, one calibrates.

    ``left_out`` gets what could not be written.
    """
    names: dict[str, str] = {}
    days: dict[str, str] = {}
    for path in logs:
        try:
            report = write_tables(path, inputs, folder, halved=len(logs) == 1)
        except InputError as error:
            left_out[stem(path)] = str(error)
            continue
        names |= {Path(d["file"]).stem: stem(path) for d in report["drives"]}
        days[stem(path)] = day(path.name, float(report["stretches"][0]["from_s"]))
    return names, days


def recordings_of(
    logs: list[Path],
    dbc: Path | None,
    channel: str | None = None,
    schema: Path | None = None,
    time: str | None = None,
    rate_hz: float | None = None,
) -> tuple[list[Recording], dict[str, str]]:
    """Read logs as recordings; also the logs that cannot be read, with the reason."""
    recordings: list[Recording] = []
    left_out: dict[str, str] = {}
    reasons: list[InputError] = []
    for path in logs:
        if any(stem(path) == r.name for r in recordings):
            raise InputError(path, "", f"two logs would both become the drive {stem(path)}", "other names")
        try:
            log = read_log(path, time_column=time, rate_hz=rate_hz, schema=schema)
            if isinstance(log, Frames):
                log = _decoded(log.of_channel(channel, path), dbc, path)
            recordings.append(_recording(stem(path), log))
        except InputError as error:
            left_out[stem(path)] = str(error)
            reasons.append(error)
    if not recordings:
        raise reasons[0] if reasons else InputError("new", "LOG", "no log given", "logs that can be read")
    return recordings, left_out


def _decoded(log: Frames, dbc: Path | None, path: Path) -> Table:
    """All signals of the database in the log; InputError where the two have nothing in common."""
    database = load_database(dbc) if dbc else own_database()
    decoded = decode_all(log, database, str(path))
    units = {f"{m.name}.{s.name}": s.unit or "" for m in database.messages for s in m.signals}
    series = {
        name: Series(log.t_ns[samples.frame], samples.value, units[name])
        for message, signals in decoded.items()
        for signal, samples in signals.items()
        if len(samples.value) and (name := f"{message}.{signal}")
    }
    if not series:
        ids = len(np.unique(log.id))
        raise InputError(
            dbc or "lpvguard's own DBC (no --dbc given)",
            "messages",
            f"none of its {len(database.messages)} messages is among the {ids} identifiers of {path.name}: "
            "it is the database of another bus",
            "--dbc with the database of this car",
        )
    return Table(series)


def _recording(name: str, table: Table) -> Recording:
    """All signals on the time axis with the most samples; a clock that jumps back goes on after its jump."""
    moving = {n: s for n, s in table.series.items() if len(s.t_ns) > 10}
    if not moving:
        raise InputError(name, "", "no signal with more than ten samples", "a log of driving")
    steps = {n: float(np.median(np.diff(s.t_ns))) * 1e-9 for n, s in moving.items()}
    fastest, longest = max(
        moving.items(), key=lambda item: (0.0 < steps[item[0]] <= LONGEST_STEP_S, len(item[1].t_ns))
    )
    if not 0.0 < (step := steps[fastest]) <= LONGEST_STEP_S:
        what = f"the median step is {step:g} s" + (": several rows have one time" if step == 0 else "")
        expected = f"times in s that grow by at most {LONGEST_STEP_S:g} s from sample to sample"
        expected += ", or --time NAME of a finer time, or --rate HZ where rows come at one rate"
        raise InputError(name, f"time of {fastest}", what, expected)
    back = {id(s.t_ns): np.diff(s.t_ns, prepend=s.t_ns[:1]) < -REORDER_S * 1e9 for s in moving.values()}
    if len(back) == 1:  # one table
        steps_ns = np.diff(longest.t_ns, prepend=longest.t_ns[:1])
        steps_ns[back[id(longest.t_ns)]] = round(LONGEST_STEP_S * 1e9)
        on = {id(longest.t_ns): np.cumsum(steps_ns)}
    else:
        on = {id(s.t_ns): s.t_ns - longest.t_ns[0] for s in moving.values()}
    axis = on[id(longest.t_ns)]
    t = axis * 1e-9
    values = {
        n: np.interp(axis, on[id(s.t_ns)][ok], s.value[ok], np.nan, np.nan)
        for n, s in moving.items()
        if (ok := _measured(s.value)).any()
    }
    steps = {n: _step_of(moving[n]) for n in values}
    return Recording(name, t, values, {n: s.unit for n, s in moving.items()}, steps)


def _step_of(series: Series) -> float:
    """Usual time [s] from one value of a signal to the next; a value that is held is one.

    A table that is merged of slow topics repeats their values, or leaves cells empty.
    """
    ok = np.isfinite(series.value)
    t, value = series.t_ns[ok] * 1e-9, series.value[ok]
    if len(t) < 2:
        return np.inf
    jumps = np.abs(np.diff(value))
    changes = np.flatnonzero(jumps) + 1
    between, usual = np.diff(t[changes]), float(np.median(np.diff(t)))
    driven = between[between <= LONGEST_STEP_S]
    if len(driven) <= MANY_CHANGES or _is_coarse(jumps[jumps > 0]):
        return usual
    return float(np.median(driven)) if float(np.median(driven)) > 1.5 * usual else usual


def _is_coarse(jumps: np.ndarray) -> bool:
    """Return whether a signal mostly changes by its resolution, and stands for want of it."""
    return bool(np.median(jumps) < 1.5 * np.quantile(jumps, 0.05))


def _measured(value: np.ndarray) -> np.ndarray:
    """True (N,) where a signal has a value that is no spike."""
    finite = np.isfinite(value)
    if not finite.any():
        return finite
    measured = finite.copy()
    measured[finite] = ~standing_alone(value[finite])
    return measured & (np.abs(value) <= SPIKE * np.quantile(np.abs(value[measured]), USUAL))


def _sample_time(recordings: list[Recording], names: list[str]) -> float:
    """Sample time [s] of the slowest of the signals; a speed changes slowly, and may be slower by half."""
    slowest = [max(r.steps_s[n] for n in names[1:]) for r in recordings]
    rate = 1.0 / float(
        np.median([max(s, 0.5 * r.steps_s[names[0]]) for s, r in zip(slowest, recordings, strict=True)])
    )
    return 1.0 / next((f for f in RATES_HZ if f <= 1.02 * rate), RATES_HZ[-1])


def _limits(role: str, proposal: Proposal, recordings: list[Recording]) -> tuple[float, float]:
    """Range of possible values, in SI; a sample beyond is a spike."""
    size = np.abs(np.concatenate([r.values[proposal.name] for r in recordings]))
    largest = SPIKE * float(np.nanquantile(size, USUAL)) * abs(proposal.factor)
    largest = float(f"{largest * (unit_factor(proposal.unit, SI[role]) or 1.0):.3g}")
    return (-0.5 * largest if role == "speed" else -largest, largest)


# ------------------------------------------------------------------------------------------- the project file


def _read(drives: Path, names: list[str], Ts: float) -> list[Drive]:
    """The written drives, before a project can check them."""
    wide = {"min": -1e9, "max": 1e9, "positive": ""}
    document = {
        "schema": 1,
        "name": "unknown",
        "title": "",
        "Ts_s": Ts,
        "seed": 0,
        "signals": [
            {"name": role, "role": kind, "column": COLUMNS[role], "unit": SI[role], **wide}
            for role, kind in zip(ROLES, ("scheduling", "input", "output"), strict=True)
        ],
        "model": {"speed_min_mps": 1.0, "speed_max_mps": 2.0, "A": [[-1.0]], "B": [[1.0]], "C": [[1.0]]},
        "frames": {"f_min_hz": 0.01 / Ts, "f_max_hz": 0.02 / Ts},
        "bounds": {},
        "weights": {},
        "frame_test": {"excited_std": 1.0},
        "data": {"bound_split": ["train"]},
    }
    project = parse_project(document, "new")
    return [read_drive(drives / f"{n}.csv", project) for n in names]


def _project(
    name: str, model: str, signals: Signals, folder: Path, names: list[str], Ts: float, known: Known
) -> tuple[Project, str, list[str]]:
    """The project, its text, and notes; frames are tried until enough of the drives counts."""
    drives = _read(folder, names, Ts)
    v = np.concatenate([d.v for d in drives])
    top = float(np.quantile(v, 0.99))
    driving = v > 0.1 * top
    low, high = (
        float(f"{x:.2g}") for x in (max(0.98 * float(np.quantile(v[driving], 0.05)), 0.15 * top), 1.02 * top)
    )
    steering = np.concatenate([_spreads(d, Ts) for d in drives])
    excited = float(f"{np.quantile(steering[steering > 0], 0.25):.1g}")
    length = known.wheelbase_m or _length_of(drives)
    scale = Scale(length, (length / 1.35, length * 1.35), float(np.median(v[driving])), high, known.kind)
    best = None
    for f_min, tolerance in GRIDS:
        text = _text(name, model, signals, Ts, (low, high), scale, (f_min, tolerance), excited)
        candidate = _with_highest_frequency(text, Ts, name)
        if candidate is None:
            continue
        project, text = candidate
        nominal = NominalModel(project)
        estimator = Estimator.from_project(project, nominal)
        judged = _judged_shares(estimator, drives)
        if best is None or judged[0] > best[3][0]:
            best = (project, text, (f_min, tolerance), judged)
        if judged[0] >= JUDGED:
            break
    if best is None:
        raise InputError(
            "new", "", f"a sample time of {Ts:g} s leaves no frames", "a log with a shorter sample time"
        )
    project, text, (f_min, tolerance), judged = best
    text += design_section(shown(drives, Ts, (low, high)), Ts)
    text += _evaluation(float(np.median([d.duration_s for d in drives])))
    project = parse_project(tomllib.loads(text), name)
    notes = [
        f"{len(drives)} drives, {sum(d.duration_s for d in drives):.0f} s, at {1 / Ts:g} Hz",
        f"frames from {2 * np.pi * f_min:.3g} to {2 * np.pi * project.frames.f_max_hz:.3g} rad/s, "
        f"speed within {tolerance:.0%} of a frame's mean: {judged[0]:.0%} of the frames' starts count in the "
        "lowest bin",
        "by bin: " + ", ".join(f"{w:.3g} rad/s {s:.0%}" for w, s in _above_dc(project, judged)),
        f"excited from {excited:g} rad over 10 s: {np.mean(steering >= excited):.0%} of the pieces of 10 s",
        f"speed range {low:g} to {high:g} m/s: from the 5th to the 99th percentile of driving, and 2% beyond",
    ]
    return project, text, notes


def _judged_shares(estimator: Estimator, drives: list[Drive]) -> list[float]:
    """Share of all samples at which a counted frame of each bin starts."""
    samples = sum(len(d.v) for d in drives)
    return [
        sum(int(estimator.counted(d.v, k).sum()) for d in drives) / samples for k in range(estimator.n_bins)
    ]


def _above_dc(project: Project, shares: list[float]) -> list[tuple[float, float]]:
    """Frequency [rad/s] and share of every bin but DC."""
    omega = Estimator.from_project(project, NominalModel(project)).omega
    return [(w, share) for w, share in zip(omega.tolist(), shares, strict=True) if w > 0]


def _spreads(drive: Drive, Ts: float) -> np.ndarray:
    """Standard deviations of the input over pieces of 10 s."""
    pieces = max(1, round(drive.duration_s / 10))
    return np.array([float(x.std()) for x in np.array_split(drive.u[:, 0], pieces)])


def _length_of(drives: list[Drive]) -> float:
    """Wheelbase [m] that the drives read."""
    turn = steady_turn([Driven(d.t, d.v, d.u[:, 0], d.y[:, 0]) for d in drives])
    assert turn is not None  # the recordings moved
    return abs(float(np.median(turn.length)))


def _with_highest_frequency(text: str, Ts: float, name: str) -> tuple[Project, str] | None:
    """The project with the highest f_max_hz, up to a fifth of the rate, that the core supports."""
    for f_max in (3.2, 2.5, 2.0, 1.6, 1.25, 1.0, 0.8):
        if f_max > 0.2 / Ts:
            continue
        tried = text.replace("OMEGA_MAX", f"{2 * np.pi * f_max:.8g}")
        try:
            project = parse_project(tomllib.loads(tried), name)
            Estimator.from_project(project, NominalModel(project))
        except InputError:
            continue
        return project, tried
    return None


def _text(
    name: str,
    model: str,
    signals: Signals,
    Ts: float,
    speeds: tuple[float, float],
    scale: Scale,
    grid: tuple[float, float],
    excited: float,
) -> str:
    """The project file without OMEGA_MAX.

    Length: one file, in its order.
    """
    lines = [
        f'# Project file of the vehicle "{name}", proposed from its logs by `lpvguard new`. Change what you',
        "# know better: every error names key and place. Next: lpvguard fit, then identify with its file.",
        "schema = 1",
        f'name = "{name}"',
        f'title = "{name}, steering angle to yaw rate"',
        f"Ts_s = {Ts:g}      # s, the rate of the slowest signal",
        "seed = 1      # of every random choice",
    ]
    kinds = ("scheduling", "input", "output")
    described = ("speed", "road_wheel_angle", "yaw_rate")
    proposals, limits, further = signals
    for role, kind, signal in zip(ROLES, kinds, described, strict=True):
        p, (least, largest) = proposals[role], limits[role]
        lines += [
            "",
            comment(f"{p.name} in {p.unit}, factor {p.factor:.6g}: {'; '.join(p.why)}."),
            "[[signals]]",
            f'name = "{signal}"',
            f'role = "{kind}"',
            f'column = "{COLUMNS[role]}"',
            f'unit = "{SI[role]}"',
            f'positive = "{"forward" if role == "speed" else "left turn"}"',
            f"min = {least:g}      # beyond it a value is impossible: twice what the logs hold",
            f"max = {largest:g}",
        ]
    for r in further:
        least, largest = limits["output"]
        lines += [
            "",
            comment(f"The same yaw rate, measured again: {r.why}."),
            "[[signals]]",
            f'name = "{r.signal}"',
            'role = "output"',
            f'column = "{r.column}"',
            f'unit = "{SI["output"]}"',
            'positive = "left turn"',
            f"min = {3 * least:g}      # three times that of the yaw rate: it is noisier",
            f"max = {3 * largest:g}",
        ]
    lines += [
        "",
        "[model]",
        f"input_delay_s = {2 * Ts:g}      # a guess; fit finds it",
        f"speed_min_mps = {speeds[0]:g}",
        f"speed_max_mps = {speeds[1]:g}",
        "input_offset = [0.0]      # trim of the steering; fit finds it",
        _with_rows(TEMPLATES[model](scale), len(further)),
        *_isolation(model, further),
        "[fit]",
        f'kind = "{scale.kind}"      # fit refuses what no {scale.kind} can do',
        "input_delay_s = [0.0, 0.5]",
        'trim = "drive"      # a trim a recording; the mean is written. "common": one for all',
        "",
        "# Three periods a frame let an alarm come early; the lowest bin decides how early.",
        "[frames]",
        'estimator = "hann"',
        "periods = 3",
        "bins_per_decade = 6",
        f"omega_min_radps = {2 * np.pi * grid[0]:.8g}",
        "omega_max_radps = OMEGA_MAX      # at most a fifth of the rate, and what the core can compute",
        f"speed_tolerance = {grid[1]:g}      # within a frame",
        "",
        "[bounds]",
        'structure = "S1"',
        "",
        "[weights]",
        "max_order = 6",
        "",
        "[frame_test]",
        "alpha = 0.10      # false alarms of a further drive, where enough drives calibrate",
        f"excited_std = {excited:g}      # rad over 10 s: the lower quartile of the logs' steering",
        "",
        "[data]",
        'bound_split = ["train"]      # in drives/experiments.csv; the others calibrate',
    ]
    return "\n".join(lines) + "\n"


def _evaluation(median_s: float) -> str:
    """Section of a project file for `evaluate`; half of the drives last ``median_s`` or longer."""
    usual = EvaluationSettings()
    quarter = min(median_s / 4, usual.found_within_s)
    begin, shortest = (
        min(most, share * median_s)
        for most, share in ((usual.fault_from_s, 0.25), (usual.shortest_drive_s, 0.6))
    )
    return f"""
# Faults that evaluate injects: from a quarter of the median drive on, where time is left to find them.
[evaluation]
fault_from_s = {begin:.3g}
shortest_drive_s = {shortest:.3g}
found_within_s = {quarter:.3g}      # of judged, excited driving
ramp_s = {usual.ramp_s / usual.found_within_s * quarter:.3g}      # until a growing fault is whole
bias_of_spread = {usual.bias_of_spread:g}      # of the output's standard deviation within a drive
"""


def _with_rows(template: str, further: int) -> str:
    """Template of a model whose output is measured ``further`` more times: equal rows of C."""
    return re.sub(
        r"^C = \[(\[.*\])\]$", lambda m: f"C = [{', '.join([m[1]] * (1 + further))}]", template, flags=re.M
    )


def _isolation(model: str, further: list[Redundant]) -> list[str]:
    """Table that names the part that differs, where the yaw rate is measured more than once."""
    if not further:
        return []
    powers = ", ".join(f"{r.signal} = {r.speed_power}" for r in further if r.speed_power)
    changed = ", ".join(f'"{p}"' for p in VEHICLE_PARAMETERS[model])
    return [
        "# Several measurements of one yaw rate tell which part differs: identify prints the least size told",
        "# from each other part, replay names the part after an alarm.",
        "[isolation]",
        f"vehicle = [{changed}]      # parameters that tyres and load change",
        *([f"speed_power = {{ {powers} }}      # of the measured speed in an output"] if powers else []),
        "",
    ]
