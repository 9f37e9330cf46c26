"""Make one run of a campaign: simulate it, replay it through the compiled core, judge it by every detector.

The visible effect of a fault is measured off line from the samples of the run, in double precision. The
estimator is the one that set the bounds. Frames begin at every STRIDE-th sample. Class Offline derives the
time at which an alarm is *due*. A run does not count for a detector that alarms before the fault.
"""

from __future__ import annotations

import tempfile
from dataclasses import asdict, dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv as pa_csv

from ....base.documents import read_toml
from ....core.compiled import SUPERVISION, TESTS, Core
from ....drives.tables import Drive
from ....engine.validation import s1
from ....evaluate.baselines import Bank, Baseline, Scales
from ....evaluate.comparison import MONITOR
from ....evaluate.detection import JudgedClock
from ....evaluate.false_alarms import alarming
from ....identify.bounds import nominal_error
from ....replay.replayer import Replay, Replayer, read_raw_log
from ..sim import RECOVERY_S, Simulator
from ..supervision import LIVE, Reactions, limits, needed_messages, required
from .conduct import AT_LIMIT, STEERING_RADPS, band_rms, longest_stretch, steady_line
from .scenarios import ROOM, UNIT, Drawn, PlannedRun
from .tracking import TrackingBound

FOUND_WITHIN_S = 60.0
STRIDE = 10
"""Number of samples between the starts of the off-line frames."""
TELEMETRY_S = 0.1
"""Period of the rows of the simulator's telemetry."""
VISIBLE_RATIO = 1.5
"""A frame shows a fault if its t* is at least this multiple of the threshold."""


@dataclass(frozen=True)
class Offline:
    """Evidence of a fault in the samples of a run, independent of the monitor, in double precision.

    ``visible_share`` is the share of frames with t* of at least VISIBLE_RATIO times the threshold. It counts
    frames that lie wholly in excited driving after the fault, and is 0 without frames. ``due_s`` [s after the
    fault] is the time by which a monitor with these bounds must alarm; None means never. The monitor judges
    one frame per half frame. If t* exceeds this limit for all starts within half a frame, the monitor judges
    one of these frames. ``median`` and ``largest`` describe t* of the frames after the fault.
    """

    visible_share: float
    due_s: float | None
    median: float | None
    largest: float

    @classmethod
    def from_drive(cls, replayer: Replayer, drive: Drive, from_s: float) -> Offline:
        """Measure the evidence in ``drive`` of a fault that begins at ``from_s`` [s of the run].

        The frames are judged with the bounds and the threshold of ``replayer``.
        """
        model, estimator = replayer.model, replayer.estimator
        e, yhat = nominal_error(drive, model)
        both = np.hstack([e, yhat])
        calm = np.concatenate([[0], np.cumsum(~replayer.excited(drive))])
        first = first_sample(drive, from_s, model.Ts)
        in_excited: list[np.ndarray] = []
        later_on: list[np.ndarray] = []
        due = np.inf
        for k, length in enumerate(estimator.length):
            counted = estimator.counted(drive.v, k)[::STRIDE]
            starts = STRIDE * np.flatnonzero(counted)
            starts = starts[starts + length > first]
            frames = estimator.transform(both, k, starts)
            margins = s1.margin(
                frames[:, : e.shape[1]], frames[:, e.shape[1] :], replayer.W_delta[k], replayer.B_w[k]
            )
            later = starts >= first
            later_on.append(margins[later])
            in_excited.append(margins[later & (calm[starts + length] == calm[starts])])
            begin = first_stretch(starts, margins >= VISIBLE_RATIO * replayer.threshold, length // 2)
            due = due if begin is None else min(due, (begin + length // 2 + length - first) * model.Ts)
        excited, after = np.concatenate(in_excited), np.concatenate(later_on)
        share = float((excited >= VISIBLE_RATIO * replayer.threshold).mean()) if len(excited) else 0.0
        return cls(
            share,
            due if np.isfinite(due) else None,
            float(np.median(after)) if len(after) else None,
            float(after.max(initial=0.0)),
        )


def first_stretch(starts: np.ndarray, above: np.ndarray, length: int) -> int | None:
    """First of ``starts`` (S,) from which ``above`` (S,) is True for ``length`` samples; None without one.

    The starts are STRIDE apart, except for gaps.
    """
    good = starts[above]
    edges = np.flatnonzero(np.diff(good) != STRIDE) + 1
    return next(
        (int(run[0]) for run in np.split(good, edges) if len(run) and run[-1] - run[0] >= length), None
    )


def first_sample(drive: Drive, run_s: float, Ts: float) -> int:
    """Index of the sample nearest to ``run_s`` [s of the run]; 0 for times before the drive.

    The drive begins when the ECU has all signals, some tenths of a second after the run's start.
    """
    return max(0, round((run_s - float(drive.t[0])) / Ts))


Numbers = tuple[Any, ...]
"""Numbers of an array as nested tuples or lists."""


@dataclass(frozen=True)
class Detectors:
    """Baselines with their scales, thresholds and component sizes (if they have components)."""

    scales: tuple[Numbers, ...]
    baselines: tuple[tuple[Baseline, float, Numbers], ...]

    @classmethod
    def from_tuning(cls, tuned: dict[str, Any]) -> Detectors:
        """Read the detectors from baselines.json."""

        def frozen(x: Any) -> Any:
            return tuple(map(frozen, x)) if isinstance(x, list) else x

        return cls(
            tuple(frozen(tuned["scales"][f.name]) for f in fields(Scales)),
            tuple((Baseline(**b["parameters"]), b["threshold"], frozen(b["sizes"])) for b in tuned["chosen"]),
        )


@dataclass(frozen=True)
class Context:
    """Inputs of every worker; each worker builds the simulator and the core from ``folder`` and its cache."""

    folder: Path
    seed: int
    detectors: Detectors
    tracking: TrackingBound

    @cached_property
    def tools(self) -> tuple[Simulator, Simulator, Replayer, Bank]:
        """Simulators with and without controller, replayer, and baseline detectors.

        Every process builds them once. They are not pickled.
        """
        return _tools(self.folder, self.detectors)

    def __getstate__(self) -> dict:
        return {k: v for k, v in self.__dict__.items() if k != "tools"}


@lru_cache(maxsize=2)
def _tools(folder: Path, detectors: Detectors) -> tuple[Simulator, Simulator, Replayer, Bank]:
    simulator = Simulator(folder)
    replayer = Replayer(simulator.project, Core(folder))
    return (
        simulator,
        Simulator(folder, controller="off"),
        replayer,
        Bank(
            replayer.model,
            replayer.estimator,
            Scales(*map(np.array, detectors.scales)),
            {b: np.array(sizes) for b, _, sizes in detectors.baselines},
        ),
    )


def run_planned(context: Context, planned: PlannedRun) -> dict[str, Any]:
    """Simulate and replay one run, and judge it by every detector; return a row of the Parquet files."""
    simulator, free_truck, replayer, bank = context.tools
    drawn = Drawn.for_run(float(simulator.u_max.min()), context.seed, planned)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "scenario.toml"
        telemetry = path.with_suffix(".csv")
        # Without control, the truck ignores the command. This run gives its free motion and the demand.
        path.write_text(drawn.text(planned.tables, UNIT), encoding="utf-8")
        _, left_alone = free_truck.drive(path, telemetry=telemetry)
        free = read_telemetry(telemetry)
        size = drawn.size(replayer.model, free["wanted_radps"], TELEMETRY_S)
        if planned.plant >= 0:
            size = _within_limit(simulator, drawn, planned.tables, size, path)
        path.write_text(drawn.text(planned.tables, size), encoding="utf-8")
        log = path.with_suffix(".log") if "can_fault" in planned.tables else None
        facts, drive = simulator.drive(path, log=log, telemetry=telemetry)
        scenario = read_toml(path, "a scenario file")
        reactions = supervision(simulator, facts, scenario, log, planned.fault_s)
        did = conduct(context.tracking, simulator, drawn, drive, free, left_alone, read_telemetry(telemetry))
    replay = replayer.replay(drive)
    clock = JudgedClock.from_replay(replay, first_sample(drive, planned.fault_s, replay.Ts), FOUND_WITHIN_S)
    offline = Offline.from_drive(replayer, drive, planned.fault_s)
    row: dict[str, Any] = {
        "number": planned.number,
        "kind": planned.kind,
        "severity": planned.severity,
        "way": planned.way,
        "plant": planned.plant,
        "seed": facts["seed"],
        "fault_s": planned.fault_s,
        "duration_s": float(facts["duration_s"]),
        "speed_mps": float(drive.v.mean()),
        "frames_hash": facts["frames_hash"],
        "authenticated": facts["reception"]["authentication"] is not None,
        "brake_gain": float(scenario["plant"].get("variation", {}).get("brake_gain_ratio", 1.0)),
        "demand_max_bar": float(facts["demand_max_bar"]),
        **did,
        "tracking_ratio": facts["tracking_rms"] / facts["command_rms"] if facts["command_rms"] else None,
        "judged_s": replay.judged_s,
        "excited_after_s": float(clock.seconds[-1]),
        "visible_share": offline.visible_share,
        "due_s": offline.due_s,
        "offline_median": offline.median,
        "offline_max": offline.largest,
        "ecu_invalid_s": next((float(t) for t, verdict in facts["verdicts"] if verdict == "invalid"), None),
        **{f"supervision_{key}": value for key, value in asdict(reactions).items()},
    }
    for test in TESTS:
        hits = alarming(replay, test)
        row |= {
            f"alarms_{test}": sum(a.test == test for a in replay.alarms),
            f"alarmed_{test}": bool(hits.any()),
            f"{test}_found_s": clock.read(hits),
        }
    row |= _judged(MONITOR, _statistic(replayer, replay, drive), 1.0, clock)
    thresholds = {b: h for b, h, _ in context.detectors.baselines}
    for b, values in bank.statistics(thresholds, *nominal_error(drive, replayer.model), drive.v):
        row |= _judged(b.kind, values, thresholds[b], clock)
    return row


def _within_limit(simulator: Simulator, drawn: Drawn, tables: str, size: float, path: Path) -> float:
    """Reduce the ``size`` of the command [rad/s] if the loop would need more than ROOM of its limit.

    Steps need a larger peak demand than their tracking suggests. A run at half the size measures the need;
    ``path`` is the file of its scenario.
    """
    path.write_text(drawn.text(tables, size / 2), encoding="utf-8")
    facts, _ = simulator.drive(path)
    most = 0.5 * ROOM * float(simulator.u_max.min())
    return size * most / max(most, facts["demand_max_bar"])


def conduct(
    tracking: TrackingBound,
    simulator: Simulator,
    drawn: Drawn,
    drive: Drive,
    free: dict[str, np.ndarray],
    left_alone: Drive,
    loop: dict[str, np.ndarray],
) -> dict[str, float]:
    """Compute a row's columns about the closed loop (conduct.py), and the limits of ``tracking``.

    ``free`` and ``loop`` are the telemetry, columns (N,), of the truck ``left_alone`` and of the loop.
    """
    u, Ts = drive.u[:, 0], simulator.project.Ts_s
    line = steady_line(u, Ts, drawn.command.highest)
    error = loop["wanted_radps"] - loop["yaw_rate_radps"]
    w, n = disturbed(free, left_alone)
    return {
        "line_bar": line.bar,
        "line_radps": line.radps,
        "limited_stretch_s": limited_stretch(simulator, drive),
        "wanted_rms_radps": band_rms(loop["wanted_radps"], TELEMETRY_S, STEERING_RADPS),
        "error_rms_radps": band_rms(error, TELEMETRY_S, STEERING_RADPS),
        "free_rms_radps": band_rms(free["yaw_rate_radps"], TELEMETRY_S, STEERING_RADPS),
        "allowed_rms_radps": tracking.rms(loop["command_radps"], w, n, TELEMETRY_S, Ts),
    }


def disturbed(free: dict[str, np.ndarray], measured: Drive) -> tuple[np.ndarray, np.ndarray]:
    """Return the motion that road and wind cause in a truck without control, and the noise of its sensors.

    The motion (N, 2) holds yaw rate and road-wheel angle [rad/s, rad] every TELEMETRY_S. The noise is (M, 2)
    at the samples of ``measured``.
    """
    w = np.column_stack([free["yaw_rate_radps"], free["road_wheel_rad"]])
    true = np.column_stack([np.interp(measured.t, free["t_s"], x) for x in w.T])
    return w, measured.y - true


def limited_stretch(simulator: Simulator, drive: Drive) -> float:
    """Find the longest time that the demand of a drive is at the controller's limit.

    Parameters
    ----------
    simulator : Simulator
    drive : Drive

    Returns
    -------
    float, s
    """
    limit = np.interp(drive.v, simulator.nodes, simulator.u_max[:, 0])
    return longest_stretch(np.abs(drive.u[:, 0]) >= AT_LIMIT * limit, simulator.project.Ts_s)


def read_telemetry(path: Path) -> dict[str, np.ndarray]:
    """Read the columns (N,) of the simulator's telemetry, every TELEMETRY_S."""
    table = pa_csv.read_csv(path)
    return {name: table[name].to_numpy() for name in table.column_names}


def supervision(
    simulator: Simulator, facts: dict[str, Any], scenario: dict[str, Any], log: Path | None, from_s: float
) -> Reactions:
    """Compare the ECU's reports about its bus with the states that the frames require.

    ``facts`` and ``scenario`` are the simulator's output and input. ``log`` holds the frames. None means a
    bus without fault, for which the supervision must be live. ``from_s`` [s] is the start of the comparison,
    but the comparison never starts before the bus is live.
    """
    project, Ts = simulator.project, simulator.project.Ts_s
    first, end = round(max(from_s, RECOVERY_S) / Ts), round(facts["duration_s"] / Ts)
    ticks_us = np.arange(first, end) * round(Ts * 1e6)
    times, states = zip(*facts["supervision"], strict=True)
    newest = np.searchsorted(np.round(np.array(times) * 1e6), ticks_us, side="right") - 1
    reported = np.array([SUPERVISION.index(s) for s in states])[newest]
    frames = None if log is None else read_raw_log(log)
    if frames is None:
        return Reactions.from_states(reported, np.full(len(ticks_us), LIVE), Ts)
    off_us = [
        round(fault["start_s"] * 1e6) for fault in scenario.get("can_fault", ()) if fault["kind"] == "bus_off"
    ]
    must = required(frames, needed_messages(project), ticks_us, off_us, limits(project))
    return Reactions.from_states(reported, must, Ts)


def _statistic(replayer: Replayer, replay: Replay, drive: Drive) -> np.ndarray:
    """Statistic (N,) of the monitor: largest ratio of a test's statistic to its threshold; above 1: alarm.

    The frame test counts at samples with judged frames. The statistic is -inf at samples without any test.
    """
    frames, ratios = (
        replay.run.frames,
        ((replay.run.energy, replayer.energy_threshold), (replay.run.change, replayer.change_threshold)),
    )
    statistic = np.max([np.where(x > 0, x / threshold, -np.inf) for x, threshold in ratios], axis=0)
    at = np.round((frames.t_judged_s - drive.t[0]) / replay.Ts).astype(int)
    np.maximum.at(statistic, at[frames.counted], frames.statistic[frames.counted] / replayer.threshold)
    return statistic


def _judged(name: str, statistic: np.ndarray, threshold: float, clock: JudgedClock) -> dict[str, Any]:
    """Make the fields NAME_before and NAME_found_s, and the largest statistics before and after the fault."""
    within = slice(clock.first, int(np.searchsorted(clock.seconds, FOUND_WITHIN_S, side="right")))
    before = float(statistic[: clock.first].max(initial=-np.inf))
    return {
        f"{name}_before": before > threshold,
        f"{name}_found_s": clock.read(statistic > threshold),
        f"{name}_score_before": before,
        f"{name}_score_within": float(statistic[within].max(initial=-np.inf)),
        f"{name}_score": float(statistic.max(initial=-np.inf)),
    }
