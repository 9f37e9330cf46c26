"""Summary of every replayed drive for the page: its nearest approach to an alarm, and its course."""

from dataclasses import dataclass

import numpy as np

from ..drives.tables import Drive
from ..identify.unexplained import Unexplained
from ..replay.replayer import Alarm, Replay, Replayer

COLUMNS = 60
"""Number of columns of a drive's small picture."""


@dataclass(frozen=True)
class Nearest:
    """A drive's nearest approach to an alarm, or its largest excess.

    ``ratio``: statistic over threshold, an alarm above 1. ``test``: "frame", "energy" or "change". ``bin``:
    index and ``omega`` [rad/s]; None unless for the frame test. ``t_s``: end of the judged stretch [s after
    the drive's start]; ``speed_mps`` [m/s].
    """

    ratio: float
    test: str
    bin: int | None
    omega: float | None
    t_s: float
    speed_mps: float


@dataclass(frozen=True)
class DriveSummary:
    """A replayed drive for overview, index and its section.

    ``key``: id of its section. ``role``: in the identification, HTML. ``relevant_s`` and
    ``judged_relevant_s`` [s]: in range and excited, and the judged part. ``course`` (COLUMNS,): largest
    statistic over threshold that ended in a column of time, NaN without any. ``verdict`` (COLUMNS,): code of
    the verdict at a column's end. ``vaf``: least over the outputs, NaN if unknown [-]. ``unexplained``:
    remainder of a drive that sets the bounds or calibrates; else None. ``section``: HTML.
    """

    key: str
    name: str
    driver: str
    role: str
    speed_mps: tuple[float, float]
    duration_s: float
    judged_s: float
    relevant_s: float
    judged_relevant_s: float
    verdict_final: str
    nearest: Nearest | None
    alarms: list[Alarm]
    course: np.ndarray
    verdict: np.ndarray
    vaf: float
    unexplained: Unexplained | None
    section: str


def nearest(replay: Replay, replayer: Replayer, drive: Drive) -> Nearest | None:
    """Place of the largest statistic of any test in units of its threshold; None without a judged frame."""
    frames, candidates = replay.run.frames, []
    counted = np.flatnonzero(frames.counted)
    if len(counted):
        i = counted[np.argmax(frames.statistic[counted])]
        k = int(frames.bin[i])
        candidates.append(
            Nearest(
                float(frames.statistic[i]) / replayer.threshold,
                "frame",
                k,
                float(replayer.estimator.omega[k]),
                float(frames.t_end_s[i] - drive.t[0]),
                float(frames.speed[i]),
            )
        )
    for test, values in _ratios(replay, replayer):
        if (values > 0).any():
            n = int(np.argmax(values))
            candidates.append(Nearest(float(values[n]), test, None, None, n * replay.Ts, float(drive.v[n])))
    return max(candidates, key=lambda near: near.ratio, default=None)


def _ratios(replay: Replay, replayer: Replayer) -> tuple[tuple[str, np.ndarray], ...]:
    """Ratios (N,) to the threshold of the tests with one a sample; 0: not judged."""
    return (
        ("energy", replay.run.energy / replayer.energy_threshold),
        ("change", replay.run.change / replayer.change_threshold),
    )


def course(replay: Replay, replayer: Replayer, t0: float) -> tuple[np.ndarray, np.ndarray]:
    """Course and verdict of a DriveSummary, each (COLUMNS,); ``t0``: time of the drive's first sample [s]."""
    frames, samples = replay.run.frames, len(replay.run.verdict)
    ratio = np.full(COLUMNS, -np.inf)
    counted = frames.counted
    end = np.round((frames.t_end_s[counted] - t0) / replay.Ts)
    np.maximum.at(ratio, _column(end, samples), frames.statistic[counted] / replayer.threshold)
    for _, values in _ratios(replay, replayer):
        judged = np.flatnonzero(values > 0)
        np.maximum.at(ratio, _column(judged, samples), values[judged])
    last = np.minimum(np.arange(1, COLUMNS + 1) * samples // COLUMNS, samples) - 1
    return np.where(np.isfinite(ratio), ratio, np.nan), replay.run.verdict[np.maximum(last, 0)]


def _column(sample: np.ndarray, samples: int) -> np.ndarray:
    """Column of each sample of a drive with so many samples."""
    return np.clip(sample * COLUMNS // samples, 0, COLUMNS - 1).astype(int)
