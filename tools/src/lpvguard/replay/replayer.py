"""Stage 8, replay: run recorded drives and raw CAN logs through the compiled C core and store its results."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from ..base.errors import InputError
from ..base.runs import runs
from ..can.logs import Frames, is_raw_table, read_log, stem
from ..can.play import frames_of_drive, values_of_drive
from ..core.compiled import CAUSES, CHANGE_PARTS, REASONS, STATUSES, VERDICTS, Core, Run, band_names
from ..drives.excitation import excited
from ..drives.frames import Estimator
from ..drives.tables import TABLE_SUFFIXES, Drive, read_drive, require_units, speed_of_missing
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project
from .causes import Diagnosis, diagnosed
from .parts import NamedPart, PartNamer, alarms_begin
from .receive import Receiver
from .series import table_of


@dataclass(frozen=True)
class ChangeEstimate:
    """Estimate of the change test in an output: e = gain yhat - delay_s dyhat/dt + bias [output unit]."""

    gain: float
    delay_s: float
    bias: float


@dataclass(frozen=True)
class Alarm:
    """An alarm with its evidence.

    In a frame alarm, E and Z are the frame's DFT of error and nominal output. An energy alarm means that the
    energy test's ratio exceeded its threshold after one memory time below it. Its bin_rad_s and W_delta are
    None. Its B_w holds the band's sigma, E the norms of F e_j, and Z the norms of F W_delta yhat_j. In a
    change alarm, B_w, E and Z are empty.

    Attributes
    ----------
    t_s : float, s, end of the judged stretch
    test : str, "frame", "energy" or "change"
    bin_rad_s : float or None, rad/s, frequency of the frame's bin
    speed_mps : float, m/s
    margin, evidence, statistic, threshold : float, t* or ratio, its evidence, and the two compared numbers
    W_delta : list (n_delta,) of float, or None
    B_w : list (n_y,) of float, output units
    E, Z : list (n_y,) of complex, output units
    direction : list (n_y,) of float, or None, weights of the outputs in units of sigma
    band : str or None, of core.band_names
    output, part : str or None, of the change test; ``part`` is one of core.CHANGE_PARTS
    estimate : ChangeEstimate or None
    pooled : float or None, ratio of the pool of a frame alarm
    beyond : str or None
        "disturbance" if a vehicle without response would not have alarmed, else "model"; None for the change
        test.
    verdict : str, "invalid" if the alarm refutes the certificate's set, else "degraded" (THEORY 7.18)
    """

    t_s: float
    test: str
    bin_rad_s: float | None
    speed_mps: float
    margin: float
    evidence: float
    statistic: float
    threshold: float
    W_delta: list[float] | None
    B_w: list[float]
    E: list[complex]
    Z: list[complex]
    direction: list[float] | None = None
    band: str | None = None
    output: str | None = None
    part: str | None = None
    estimate: ChangeEstimate | None = None
    pooled: float | None = None
    beyond: str | None = None
    verdict: str = "degraded"


def _beyond(evidence: float, threshold: float) -> str:
    """Name of the bound that an alarm refutes (THEORY 7.4)."""
    return "model" if evidence > threshold else "disturbance"


@dataclass(frozen=True)
class Replay:
    """Results of the core for one drive, with times in s after its first sample.

    Attributes
    ----------
    name : str
    duration_s : float, s
    run : Run
    judged : ndarray (N,) of bool, the sample lies in a counted frame
    in_range, excited : ndarray (N,) of bool
    falsified : ndarray (N,) of bool, a falsifying frame was judged at the sample
    pooled : ndarray (N,) of bool, a falsifying pool of frames was judged at the sample
    over : ndarray (N,) of bool, the energy test's ratio is above its threshold
    changed : ndarray (N,) of bool, the change test's ratio is above its threshold
    alarms : list of Alarm, of all tests, in the order of time
    Ts : float, s
    missing_samples : int
    can : dict or None, outcome of a raw log's frames, and gaps (receive.py)
    start_s : float, s, the drive's own time at its first sample, which ``run`` uses
    diagnoses : tuple of Diagnosis, one per alarm and output, in the order of time
    parts : tuple of NamedPart, or None if the vehicle has no isolation
    """

    name: str
    duration_s: float
    run: Run
    judged: np.ndarray  # (N,) bool: the sample lies in a counted frame
    in_range: np.ndarray  # (N,) bool
    excited: np.ndarray  # (N,) bool
    falsified: np.ndarray  # (N,) bool: with this sample the core judged a frame that falsifies
    pooled: np.ndarray  # (N,) bool: with this sample the core judged a pool of frames that falsifies
    over: np.ndarray  # (N,) bool: the energy test's ratio is above its threshold
    changed: np.ndarray  # (N,) bool: the change test's ratio is above its threshold
    alarms: list[Alarm]  # of all tests, in the order of time
    Ts: float
    missing_samples: int = 0
    can: dict[str, Any] | None = None  # of a raw log: outcome of its frames, and gaps (receive.py)
    start_s: float = 0.0  # the drive's own time at its first sample, which ``run`` uses
    diagnoses: tuple[Diagnosis, ...] = ()  # one per alarm and output, in the order of time
    parts: tuple[NamedPart, ...] | None = None

    @property
    def judged_intervals(self) -> list[list[float]]:
        """Time spans [t0, t1] covered by counted frames, overlapping ones joined [s]."""
        return [[float(a) * self.Ts, float(b) * self.Ts] for a, b in runs(self.judged)]

    @property
    def judged_s(self) -> float:
        """Time in counted frames [s]."""
        return float(self.judged.sum() * self.Ts)

    @property
    def max_margin(self) -> float | None:
        """Largest t* of the counted frames; None if there are none."""
        counted = self.run.frames.counted
        return float(self.run.frames.margin[counted].max()) if counted.any() else None

    @property
    def first_invalid_s(self) -> float | None:
        """Time of the first verdict "invalid" [s after the first sample]; None if there is none."""
        invalid = np.flatnonzero(self.run.verdict == VERDICTS.index("invalid"))
        return float(invalid[0] * self.Ts) if len(invalid) else None

    @property
    def first_degraded_s(self) -> float | None:
        """Time of the first verdict "degraded" [s after the first sample]; None if there is none."""
        degraded = np.flatnonzero(self.run.verdict == VERDICTS.index("degraded"))
        return float(degraded[0] * self.Ts) if len(degraded) else None

    @property
    def verdict_final(self) -> str:
        """Verdict at the last sample."""
        return VERDICTS[self.run.verdict[-1]]

    def left_out(self) -> dict[str, int]:
        """Number of frames by the reason why they did not count or counted without evidence."""
        return {r: int((self.run.frames.reason == i).sum()) for i, r in enumerate(REASONS)}

    def to_dict(self) -> dict[str, Any]:
        """The object of `lpvguard replay --json`."""
        relevant = self.in_range & self.excited
        return {
            "run": self.name,
            "duration_s": round(self.duration_s, 6),
            "judged": [[round(a, 6), round(b, 6)] for a, b in self.judged_intervals],
            "judged_s": round(self.judged_s, 6),
            "missing_samples": self.missing_samples,
            "verdict_final": self.verdict_final,
            "first_invalid_s": self.first_invalid_s,
            "first_degraded_s": self.first_degraded_s,
            "max_margin": self.max_margin,
            "max_energy_ratio": float(self.run.energy.max()) if self.run.energy.any() else None,
            "max_change_ratio": float(self.run.change.max()) if self.run.change.any() else None,
            "alarms": [asdict(a) for a in self.alarms],
            "diagnoses": [asdict(d) for d in self.diagnoses],
            **({} if self.parts is None else {"parts": [asdict(p) for p in self.parts]}),
            "in_range_excited_s": round(float(relevant.sum() * self.Ts), 6),
            "judged_in_range_excited_s": round(float((relevant & self.judged).sum() * self.Ts), 6),
            "frames": self.left_out(),
            "verdict_s": {
                v: round(float((self.run.verdict == i).sum() * self.Ts), 6) for i, v in enumerate(VERDICTS)
            },
            "refused_samples": {
                s: int((self.run.status == i).sum())
                for i, s in enumerate(STATUSES)
                if i and (self.run.status == i).any()
            },
            **({} if self.can is None else {"can": self.can}),
        }


@dataclass(frozen=True)
class Recorded:
    """Content of a drive table or raw log.

    Attributes
    ----------
    drive : Drive
    can : dict or None, outcome of a raw log's frames
    """

    drive: Drive
    can: dict[str, Any] | None = None


class Replayer:
    """Runs drives of one vehicle through its compiled core.

    Parameters
    ----------
    project : Project
    core : Core
    threshold, energy_threshold, change_threshold : float or None, optional
    pool_scale : ndarray (SPEEDS, K, 2, n_y) or None, optional, replaces the scale in the coefficients
    namer : PartNamer or None, optional, names parts; by default the one of the core's folder, if any
    """

    def __init__(
        self,
        project: Project,
        core: Core,
        *,
        threshold: float | None = None,
        energy_threshold: float | None = None,
        change_threshold: float | None = None,
        pool_scale: np.ndarray | None = None,
        namer: PartNamer | None = None,
    ):
        self.project, self.core = project, core
        self.namer = PartNamer.beside(project, core.folder) if namer is None else namer
        self.model = NominalModel(project)
        self.estimator = Estimator.from_project(project, self.model)
        sizes = tuple(core.sizes[d] for d in ("NU", "NY", "NBINS", "NDELTA"))
        expected = (project.n_u, project.n_y, self.estimator.n_bins, project.n_delta)
        if sizes != expected:
            raise InputError(
                core.folder,
                "sizes",
                "{} inputs, {} outputs, {} bins, {} blocks Delta".format(*sizes),
                f"those of vehicle {project.name}: {', '.join(map(str, expected))}",
            )
        if core.estimator_id() != self.estimator.identifier():
            raise InputError(
                core.folder,
                "estimator",
                f"bounds from estimator {core.estimator_id():#010x}",
                f"{self.estimator.identifier():#010x}, the one the project file describes",
            )
        core.monitor()  # the core refuses wrong coefficients here, before a field of them is read
        reals = core.compiled[1].copy()
        fields = core.fields(reals)
        thresholds = {
            "threshold": threshold,
            "energy_threshold": energy_threshold,
            "change_threshold": change_threshold,
        }
        for name, value in thresholds.items():
            if value is not None:
                fields[name][0] = value
        if pool_scale is not None:
            fields["pool_scale"][:] = pool_scale
        self._reals = None if set(thresholds.values()) == {None} and pool_scale is None else reals
        self.threshold, self.energy_threshold, self.change_threshold = (
            float(fields[name][0]) for name in thresholds
        )
        self.W_delta, self.B_w = fields["W_delta"], fields["B_w"]
        self.sigma, self.directions = 1.0 / fields["energy_scale"], fields["energy_direction"]
        self.bands = band_names(len(self.sigma))
        self.change_unit, self.change_size = 1.0 / fields["change_unit"], 1.0 / fields["change_scale"]
        self.change_block_s = float(fields["change_block_s"][0])

    def replay(self, drive: Drive) -> Replay:
        """Run one drive."""
        monitor = (
            self.core.monitor() if self._reals is None else self.core.monitor(reals=self._reals, seal=True)
        )
        run = monitor.run_drive(drive)
        frames, Ts, t0 = run.frames, self.project.Ts_s, drive.t[0]
        judged = frames.judged(len(drive.t), t0, Ts, self.estimator.length)
        low, high = self.model.speed_range
        at = np.round((frames.t_judged_s - t0) / Ts).astype(int)
        falsified, pooled = np.zeros((2, len(drive.t)), bool)
        falsified[at[frames.falsified & (frames.statistic > self.threshold)]] = True
        pooled[at[frames.pooled > self.threshold]] = True
        in_range = (drive.v >= low) & (drive.v <= high)
        if drive.missing is not None:
            in_range &= ~drive.missing
        alarms, diagnoses = self.alarms(run, t0), tuple(self.diagnoses(run, t0))
        parts = None
        if self.namer is not None:
            onsets = [(d.alarm_s, d.since_s) for d in diagnoses]
            begin = drive.t[alarms_begin(run.verdict)[0]] - t0
            parts = tuple(self.namer.named(drive, begin.tolist(), onsets))
        return Replay(
            drive.name,
            drive.duration_s,
            run,
            judged,
            in_range,
            self.excited(drive),
            falsified,
            pooled,
            run.energy > self.energy_threshold,
            run.change > self.change_threshold,
            alarms,
            Ts,
            drive.missing_samples,
            start_s=float(t0),
            diagnoses=diagnoses,
            parts=parts,
        )

    def diagnoses(self, run: Run, t0: float) -> Iterator[Diagnosis]:
        """Diagnoses of a run, one per alarm and output; ``t0`` [s] becomes time 0."""
        causes = run.causes
        for i in range(len(causes.cause)):
            alarm_s = float(causes.t_alarm_s[i] - t0)
            yield diagnosed(
                self.project,
                CAUSES[causes.cause[i]],
                int(causes.output[i]),
                (float(causes.value[i]), float(causes.low[i]), float(causes.high[i])),
                found_s=float(causes.t_found_s[i] - t0),
                alarm_s=alarm_s,
                since_s=alarm_s - float(causes.onset_s[i]),
                at_least=bool(causes.before[i]),
                final=bool(causes.final[i]),
            )

    def alarms(self, run: Run, t0: float) -> list[Alarm]:
        """Alarms of a run in the order of time; ``t0`` [s] becomes time 0."""
        alarms = [*self._frame_alarms(run, t0), *self._energy_alarms(run, t0), *self._change_alarms(run, t0)]
        return sorted(alarms, key=lambda a: a.t_s)

    def _frame_alarms(self, run: Run, t0: float) -> list[Alarm]:
        """An alarm for each falsifying frame; ``t0`` [s] is the time of the drive's first sample."""
        frames = run.frames
        return [
            Alarm(
                float(frames.t_end_s[i] - t0),
                "frame",
                float(self.estimator.omega[frames.bin[i]]),
                float(frames.speed[i]),
                float(frames.margin[i]),
                float(frames.evidence[i]),
                float(frames.statistic[i]),
                self.threshold,
                self.W_delta[frames.bin[i]].tolist(),
                self.B_w[frames.bin[i]].tolist(),
                frames.E[i].tolist(),
                frames.Z[i].tolist(),
                pooled=float(frames.pooled[i]),
                beyond=_beyond(float(frames.evidence[i]), self.threshold),
                verdict=frames.verdict[i],
            )
            for i in np.flatnonzero(frames.falsified)
        ]

    def _energy_alarms(self, run: Run, t0: float) -> list[Alarm]:
        """Alarms of the energy test; ``t0`` [s] is the time of the drive's first sample."""
        log = run.energy_alarms
        places = zip(*divmod(log.bin, len(self.directions)), strict=True)
        return [
            Alarm(
                float(log.t_end_s[i] - t0),
                "energy",
                None,
                float(log.speed[i]),
                float(log.margin[i]),
                float(log.evidence[i]),
                float(log.statistic[i]),
                self.energy_threshold,
                None,
                self.sigma[band].tolist(),
                log.E[i].real.tolist(),
                log.Z[i].real.tolist(),
                self.directions[direction].tolist(),
                self.bands[band],
                beyond=_beyond(float(log.evidence[i]), self.energy_threshold),
                verdict=log.verdict[i],
            )
            for i, (band, direction) in enumerate(places)
        ]

    def _change_alarms(self, run: Run, t0: float) -> list[Alarm]:
        """Alarms of the change test; ``t0`` [s] is the time of the drive's first sample."""
        log = run.change_alarms
        return [
            Alarm(
                float(log.t_end_s[i] - t0),
                "change",
                None,
                float(log.speed[i]),
                float(log.margin[i]),
                float(log.evidence[i]),
                float(log.statistic[i]),
                self.change_threshold,
                None,
                [],
                [],
                [],
                output=self.project.outputs[output].name,
                part=CHANGE_PARTS[part],
                estimate=ChangeEstimate(
                    float(log.E[i, 0].real), float(log.E[i, 0].imag), float(log.Z[i, 0].real)
                ),
            )
            for i, (output, part) in enumerate(zip(*divmod(log.bin, len(CHANGE_PARTS)), strict=True))
        ]

    def excited(self, drive: Drive) -> np.ndarray:
        """(N,) True where the drive is excited (THEORY 11)."""
        return excited(drive, self.project)

    def summarise_file(
        self, path: Path, channel: str | None = None, with_series: bool = False
    ) -> tuple[dict[str, Any], pa.Table | None] | InputError:
        """JSON object of `lpvguard replay` for one file, and its time series if ``with_series`` (series.py).

        If the file cannot be read, it returns the InputError.
        """
        try:
            recorded = self.read_file(path, channel)
            replay = self.replay_recorded(recorded)
            return replay.to_dict(), self.series(recorded, replay) if with_series else None
        except InputError as error:
            return error

    def replay_file(self, path: Path, channel: str | None = None) -> Replay:
        """Read, check and run one drive table, or the given ``channel`` of a raw CAN log."""
        return self.replay_recorded(self.read_file(path, channel))

    def read_file(self, path: Path, channel: str | None = None) -> Recorded:
        """Read and check one drive table, or the given ``channel`` of a raw CAN log."""
        log = read_raw_log(path)
        if log is not None:
            return self.received(log, path, channel)
        drive = read_drive(path, self.project)
        nominal_output = self.model.simulate(drive.v, drive.u, drive.y[0])
        require_units(path, drive, nominal_output, self.estimator.settled(drive.v))
        return Recorded(drive)

    def replay_recorded(self, recorded: Recorded) -> Replay:
        """Run the content of a file."""
        return replace(self.replay(recorded.drive), can=recorded.can)

    def series(self, recorded: Recorded, replay: Replay) -> pa.Table:
        """Time series of the record and the core's results, one row per sample (series.py)."""
        drive = recorded.drive
        yhat = self.model.simulate(drive.v, drive.u, drive.y[0])
        return self.series_of(drive, yhat, replay.run, float(drive.t[0]))

    def series_of(self, drive: Drive, yhat: np.ndarray, run: Run, t0: float) -> pa.Table:
        """One piece of a time series, with nominal outputs ``yhat`` (N, n_y); t counts from ``t0`` [s]."""
        thresholds = {
            "frame": self.threshold,
            "energy": self.energy_threshold,
            "change": self.change_threshold,
        }
        return table_of(self.project, yhat, self.estimator.omega, thresholds, drive, run, t0)

    def series_columns(self) -> list[str]:
        """Names of the columns of every series of this vehicle."""
        n_u, n_y, none = self.project.n_u, self.project.n_y, np.zeros(0)
        drive = Drive("", none, none, np.zeros((0, n_u)), np.zeros((0, n_y)))
        run = self.core.monitor().run(drive.t, drive.v, drive.u, drive.y)
        return self.series_of(drive, drive.y, run, 0.0).column_names

    def replay_frames(self, log: Frames, path: Path, channel: str | None = None) -> Replay:
        """Process the frames of a raw CAN log with the compiled receiver and the monitor, as on the ECU."""
        return self.replay_recorded(self.received(log, path, channel))

    def received(self, log: Frames, path: Path, channel: str | None = None) -> Recorded:
        """Sample the frames of a raw CAN log with the compiled receiver, as on the ECU."""
        received = self.receiver.receive(log, path, channel=channel)
        if not received.present.any():
            raise InputError(
                path,
                "",
                "no sample at all: " + _why_not_live(received.report),
                "every message of the vehicle, live",
            )
        # Ticks without a sample keep the newest values (zero before the first), so that statistics of the
        # input stay finite.
        values = np.nan_to_num(received.values)
        n_u, missing = self.project.n_u, ~received.present
        drive = Drive(
            stem(path),
            received.t,
            np.where(missing, speed_of_missing(self.project), values[:, 0]),
            values[:, 1 : 1 + n_u],
            values[:, 1 + n_u : 1 + n_u + self.project.n_y],
            missing=missing if missing.any() else None,
        )
        return Recorded(drive, received.report)

    @cached_property
    def receiver(self) -> Receiver:
        """The compiled receiver of the vehicle's bus."""
        return Receiver(self.project)


def read_raw_log(path: Path) -> Frames | None:
    """Read the frames of a raw CAN log.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Frames, or None if the path is a drive table

    Raises
    ------
    InputError
        If the file is neither a raw log nor a drive table.
    """
    if path.suffix.lower() in TABLE_SUFFIXES and not is_raw_table(path):
        return None
    log = read_log(path)
    if not isinstance(log, Frames):
        raise InputError(
            path, "", "holds decoded signals", "a raw CAN log, or a drive table made by `lpvguard ingest`"
        )
    return log


def bus_frames(path: Path, project: Project) -> Frames:
    """Read the CAN frames that `lpvguard replay --to` sends.

    A raw log keeps its frames. The samples of a drive table are packed into the vehicle's messages.

    Parameters
    ----------
    path : Path
    project : Project

    Returns
    -------
    Frames

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    log = read_raw_log(path)
    if log is not None:
        return log
    if project.gates:
        raise InputError(
            path,
            "",
            "a drive table holds no gate signals, but the bus needs them",
            "a raw log, for a vehicle with gates",
        )
    drive = read_drive(path, project).present
    return frames_of_drive(drive.t, values_of_drive(project, drive))


def _why_not_live(report: dict[str, Any]) -> str:
    """Text with the number of frames by kind for each needed message."""
    return "; ".join(
        f"{name}: " + (", ".join(f"{n} {kind}" for kind, n in kinds.items()) or "none")
        for name, kinds in report["messages"].items()
    )
