"""Stage 7, replay: recorded drives through the compiled C core, and what it said, in a form people and machines can read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .core import REASONS, STATUSES, VERDICTS, Core, Run
from .drives import Drive, read_drive, require_units
from .errors import InputError
from .frames import Estimator
from .nominal import NominalModel
from .project import Project

EXCITED_WINDOW_S = 10.0


@dataclass(frozen=True)
class Alarm:
    """A falsifying frame with what a person needs to believe it."""

    t_s: float
    test: str
    bin_rad_s: float
    speed_mps: float
    margin: float
    evidence: float
    statistic: float
    threshold: float
    W_delta: float
    B_w: list[float]
    E: list[complex]
    Z: list[complex]


@dataclass(frozen=True)
class Replay:
    """One drive through the core. Times are seconds after the drive's first sample."""

    name: str
    duration_s: float
    run: Run
    judged: np.ndarray          # (N,) bool: the sample lies in a counted frame
    in_range: np.ndarray        # (N,) bool
    excited: np.ndarray         # (N,) bool
    alarms: list[Alarm]
    Ts: float

    @property
    def judged_intervals(self) -> list[list[float]]:
        """Joined spans [t0, t1] of counted frames [s]."""
        edges = np.flatnonzero(np.diff(np.r_[0, self.judged.astype(np.int8), 0]))
        return [[float(a) * self.Ts, float(b) * self.Ts] for a, b in edges.reshape(-1, 2)]

    @property
    def judged_s(self) -> float:
        return float(self.judged.sum() * self.Ts)

    @property
    def max_margin(self) -> float | None:
        counted = self.run.frames.counted
        return float(self.run.frames.margin[counted].max()) if counted.any() else None

    @property
    def first_invalid_s(self) -> float | None:
        invalid = np.flatnonzero(self.run.verdict == VERDICTS.index("invalid"))
        return float(invalid[0] * self.Ts) if len(invalid) else None

    @property
    def verdict_final(self) -> str:
        return VERDICTS[self.run.verdict[-1]]

    def left_out(self) -> dict[str, int]:
        """Frames by the reason why they did not count, or counted without evidence."""
        return {r: int((self.run.frames.reason == i).sum()) for i, r in enumerate(REASONS)}

    def to_dict(self) -> dict[str, Any]:
        """The object of `lpvguard replay --json`."""
        relevant = self.in_range & self.excited
        return {
            "run": self.name, "duration_s": round(self.duration_s, 6),
            "judged": [[round(a, 6), round(b, 6)] for a, b in self.judged_intervals],
            "judged_s": round(self.judged_s, 6), "verdict_final": self.verdict_final,
            "first_invalid_s": self.first_invalid_s, "max_margin": self.max_margin,
            "alarms": [vars(a) for a in self.alarms],
            "in_range_excited_s": round(float(relevant.sum() * self.Ts), 6),
            "judged_in_range_excited_s": round(float((relevant & self.judged).sum() * self.Ts), 6),
            "frames": self.left_out(),
            "verdict_s": {v: round(float((self.run.verdict == i).sum() * self.Ts), 6) for i, v in enumerate(VERDICTS)},
            "refused_samples": {s: int((self.run.status == i).sum()) for i, s in enumerate(STATUSES)
                                if i and (self.run.status == i).any()},
        }


def excited_samples(u: np.ndarray, Ts: float, threshold: float) -> np.ndarray:
    """(N,) True where the standard deviation of an input over the surrounding 10 s exceeds ``threshold``."""
    half = int(round(EXCITED_WINDOW_S / Ts / 2))
    low = np.maximum(np.arange(len(u)) - half, 0)
    high = np.minimum(np.arange(len(u)) + half + 1, len(u))
    centred = u - u.mean(axis=0)  # the difference of running sums would cancel against a large mean
    sums, squares = (np.vstack([np.zeros(u.shape[1]), np.cumsum(x, axis=0)]) for x in (centred, centred**2))
    count = (high - low)[:, None]
    mean = (sums[high] - sums[low]) / count
    variance = (squares[high] - squares[low]) / count - mean**2
    return (np.sqrt(np.maximum(variance, 0.0)) > threshold).any(axis=1)


class Replayer:
    """Runs drives of one vehicle through its compiled core, with the compiled-in or with given coefficients."""

    def __init__(self, project: Project, core: Core, *, threshold: float | None = None):
        self.project, self.core = project, core
        self.model = NominalModel(project)
        self.estimator = Estimator.of(project, self.model)
        if (core.n_u, core.n_y, core.n_bins) != (project.n_u, project.n_y, self.estimator.n_bins):
            raise InputError(core.folder, "sizes", f"{core.n_u} inputs, {core.n_y} outputs, {core.n_bins} bins",
                             f"those of vehicle {project.name}: {project.n_u}, {project.n_y}, {self.estimator.n_bins}")
        words, reals = core.compiled
        # Words: magic, schema, number size, 7 sizes, then the estimator (coeff.h).
        if int(words[10]) != self.estimator.identifier():
            raise InputError(core.folder, "estimator", f"bounds were made with estimator {int(words[10]):#010x}",
                             f"{self.estimator.identifier():#010x}, the one the project file describes")
        self._reals = None
        if threshold is not None:
            self._reals = reals.copy()
            self._reals[-1] = threshold
        K, n_y = core.n_bins, core.n_y
        tail = self._reals if self._reals is not None else reals
        self.threshold = float(tail[-1])
        self.B_w = tail[-1 - K * n_y:-1].reshape(K, n_y)
        self.W_delta = tail[-1 - K * n_y - K:-1 - K * n_y]

    def replay(self, drive: Drive) -> Replay:
        """Run one drive."""
        monitor = self.core.monitor() if self._reals is None else self.core.monitor(reals=self._reals, seal=True)
        run = monitor.run_drive(drive)
        frames, Ts, t0 = run.frames, self.project.Ts_s, drive.t[0]
        judged = np.zeros(len(drive.t), bool)
        for k, end in zip(frames.bin[frames.counted], frames.t_end_s[frames.counted]):
            last = int(round((end - t0) / Ts))
            judged[last + 1 - self.estimator.length[k]:last + 1] = True
        low, high = self.model.speed_range
        alarms = [Alarm(float(frames.t_end_s[i] - t0), "frame", float(self.estimator.omega[frames.bin[i]]),
                        float(frames.speed[i]), float(frames.margin[i]), float(frames.evidence[i]),
                        float(frames.statistic[i]), self.threshold, float(self.W_delta[frames.bin[i]]),
                        self.B_w[frames.bin[i]].tolist(), frames.E[i].tolist(), frames.Z[i].tolist())
                  for i in np.flatnonzero(frames.falsified)]
        return Replay(drive.name, drive.duration_s, run, judged, (drive.v >= low) & (drive.v <= high),
                      self.excited(drive), alarms, Ts)

    def excited(self, drive: Drive) -> np.ndarray:
        """(N,) True where the drive is excited (DESIGN 4.2)."""
        return excited_samples(drive.u, self.project.Ts_s, self.project.frame_test.excited_std)

    def summarise_file(self, path: Path) -> dict[str, Any] | InputError:
        """The object of `lpvguard replay --json` for one drive table, or why it could not be read."""
        try:
            return self.replay_file(path).to_dict()
        except InputError as error:
            return error

    def replay_file(self, path: Path) -> Replay:
        """Read, check and run one drive table."""
        drive = read_drive(path, self.project)
        nominal_output = self.model.simulate(drive.v, drive.u, drive.y[0])
        require_units(path, drive, nominal_output, self.estimator.settled(drive.v))
        return self.replay(drive)
