"""Count false alarms of a detector on drives without a fault, by 60 s piece, drive and recording.

Every second of a drive counts, judged or not. A drive's last piece may be shorter. Rates are stated per
recording and per hour of the monitor's judged driving, for all detectors. Exact intervals (rates.py) are over
recordings, because alarms of one recording depend on each other. The intervals hold if one calibration judges
all drives. In leave-one-out, the drives share their calibration data. At a stated alpha at most a share alpha
of these drives can then alarm, whatever the test (THEORY 7.3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.rates import per_hour, rate
from ..replay.replayer import Replay

PIECE_S = 60.0


@dataclass(frozen=True)
class FalseAlarms:
    """False alarms by 60 s piece, drive and recording. The shorter last piece of a drive counts too.

    Attributes
    ----------
    drives, alarmed_drives : int, all drives, and those with an alarmed piece
    pieces, alarmed : int, all pieces, and the alarmed ones
    judged_h : float, hours of judged driving
    per_judged_h : float or None, alarmed pieces per hour of judged driving
    recordings : dict, share of recordings that alarm, as from rates.rate
    recordings_per_judged_h : dict, alarming recordings per hour of judged driving, as from rates.per_hour
    """

    drives: int
    alarmed_drives: int
    pieces: int
    alarmed: int
    judged_h: float
    per_judged_h: float | None
    recordings: dict
    recordings_per_judged_h: dict

    @classmethod
    def from_counts(
        cls, counts: list[tuple[int, int]], judged_s: list[float], recordings: list[str]
    ) -> FalseAlarms:
        """False alarms from (alarmed, all) pieces, judged seconds and recording of each drive."""
        alarmed, pieces = (int(sum(c[i] for c in counts)) for i in (0, 1))
        judged_h = sum(judged_s) / 3600
        alarming = {r for r, c in zip(recordings, counts, strict=True) if c[0]}
        return cls(
            drives=len(counts),
            alarmed_drives=sum(c[0] > 0 for c in counts),
            pieces=pieces,
            alarmed=alarmed,
            judged_h=judged_h,
            per_judged_h=alarmed / judged_h if judged_h else None,
            recordings=rate(len(alarming), len(set(recordings))),
            recordings_per_judged_h=per_hour(len(alarming), judged_h),
        )


def false_alarms(counts: list[tuple[int, int]], rows: list[dict]) -> dict:
    """FalseAlarms object from the (alarmed, all) pieces in each drive's row."""
    return vars(
        FalseAlarms.from_counts(counts, [r["judged_s"] for r in rows], [r["recording"] for r in rows])
    )


def alarming(replay: Replay, test: str | None = None) -> np.ndarray:
    """Mark the samples at which a test contradicts the model.

    A falsifying frame marks the sample at which it is judged. The energy and the change test mark all samples
    above their threshold.

    Parameters
    ----------
    replay : Replay
    test : str, optional, "frame", "pools", "energy" or "change", by default any

    Returns
    -------
    ndarray (N,) of bool
    """
    by_test = {
        "frame": replay.falsified,
        "pools": replay.pooled,
        "energy": replay.over,
        "change": replay.changed,
    }
    return np.logical_or.reduce(list(by_test.values())) if test is None else by_test[test]


def piece_starts(samples: int, Ts: float) -> np.ndarray:
    """First samples (P,) of the 60 s pieces of a drive of ``samples`` at ``Ts`` [s].

    The last piece is the remainder, up to 60 s with the closing sample.
    """
    return np.arange(0, max(1, samples - 1), round(PIECE_S / Ts))


def alarmed_pieces(replay: Replay, test: str | None = None) -> tuple[int, int]:
    """Number of (alarmed, all) 60 s pieces of a drive, by a test; None means by any test."""
    starts = piece_starts(len(replay.judged), replay.Ts)
    return int(np.logical_or.reduceat(alarming(replay, test), starts).sum()), len(starts)
