"""Summarise every replayed drive for the page: its largest statistic and the statistic over time."""

from dataclasses import dataclass

import numpy as np

from ..drives.tables import Drive
from ..identify.unexplained import Unexplained
from ..replay.replayer import Alarm, Replay, Replayer

COLUMNS = 60
"""Number of columns of a drive's small picture."""


@dataclass(frozen=True)
class Nearest:
    """The largest ratio of statistic to threshold in a drive.

    ``ratio`` is the statistic divided by the threshold; a ratio above 1 is an alarm. ``test`` is "frame",
    "energy" or "change". ``bin`` (index) and ``omega`` [rad/s] are None unless the test is the frame test.
    ``t_s`` is the end of the judged stretch [s after the drive's start].
    """

    ratio: float
    test: str
    bin: int | None
    omega: float | None
    t_s: float
    speed_mps: float


@dataclass(frozen=True)
class DriveSummary:
    """Summary of a replayed drive for the overview, the index and the section of the drive.

    ``key`` is the id of the drive's section, and ``section`` is its HTML. ``role`` is its role in the
    identification, as HTML. ``relevant_s`` [s] is the time of excited driving in range, and
    ``judged_relevant_s`` is its judged part. ``course`` (COLUMNS,) is the largest ratio of statistic to
    threshold in each column of time; it is NaN without a statistic. ``verdict`` (COLUMNS,) is the code of the
    verdict at the end of a column. ``vaf`` is the least variance accounted for of all outputs [-], or NaN if
    unknown. ``unexplained`` is the remainder of a drive that sets the bounds or calibrates, else None.
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
    """Find the largest ratio of statistic to threshold of all tests; None without a judged frame."""
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
    """Ratios (N,) of statistic to threshold for tests with one statistic per sample; 0: not judged."""
    return (
        ("energy", replay.run.energy / replayer.energy_threshold),
        ("change", replay.run.change / replayer.change_threshold),
    )


def course(replay: Replay, replayer: Replayer, t0: float) -> tuple[np.ndarray, np.ndarray]:
    """Compute ``course`` and ``verdict``, (COLUMNS,), of a DriveSummary; ``t0`` [s] is the first time."""
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
    """Index of the time column of each sample of the drive."""
    return np.clip(sample * COLUMNS // samples, 0, COLUMNS - 1).astype(int)
