"""False alarms of a detector on drives without a fault: in pieces of 60 s, in drives and in recordings.

Every second of a drive counts, judged or not. A drive's last piece may be shorter. Rates are stated per
recording and per hour of judged driving; judged is the monitor's for all detectors. Exact intervals
(rates.py) are over recordings, for alarms of one recording come together. They hold for drives that are
judged by one calibration. Where each drive is judged by the others, the drives share what calibrates:
at a stated alpha no more than a share alpha of them can alarm, whatever the test (THEORY 7.3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.rates import per_hour, rate
from ..replay.replayer import Replay

PIECE_S = 60.0


@dataclass(frozen=True)
class FalseAlarms:
    """Alarmed and all 60 s pieces, a drive's shorter last one included; and drives, and recordings.

    drives, alarmed_drives: all, and those with an alarmed piece; judged_h: hours of judged driving;
    per_judged_h: alarmed pieces an hour of it, None without any. recordings: those that alarm, of all, as
    rates.rate has it; recordings_per_judged_h: those an hour of judged driving, as rates.per_hour has it.
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
    def of(cls, counts: list[tuple[int, int]], judged_s: list[float], recordings: list[str]) -> FalseAlarms:
        """``counts``: (alarmed, all) pieces of each drive; ``judged_s``: the judged seconds of each;
        ``recordings``: what each is a piece of."""
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
    """The object of FalseAlarms from (alarmed, all) pieces of every one of the drives' ``rows``."""
    return vars(FalseAlarms.of(counts, [r["judged_s"] for r in rows], [r["recording"] for r in rows]))


def alarming(replay: Replay, test: str | None = None) -> np.ndarray:
    """(N,) True at samples where a test (None: any) speaks against the model.

    For "frame" these are the samples with which a falsifying frame was judged. For "energy" and
    "change" they are all samples above the threshold, because these tests' values persist. A frame is judged
    once.
    """
    found = {"frame": replay.falsified, "energy": replay.over, "change": replay.changed}
    return np.logical_or.reduce(list(found.values())) if test is None else found[test]


def piece_starts(samples: int, Ts: float) -> np.ndarray:
    """First samples (P,) of the 60 s pieces of a drive of ``samples`` at ``Ts`` [s].

    The last piece is what remains, up to 60 s with the closing sample.
    """
    return np.arange(0, max(1, samples - 1), round(PIECE_S / Ts))


def alarmed_pieces(replay: Replay, test: str | None = None) -> tuple[int, int]:
    """(alarmed, all) 60 s pieces of a drive, by a test (None: any)."""
    starts = piece_starts(len(replay.judged), replay.Ts)
    return int(np.logical_or.reduceat(alarming(replay, test), starts).sum()), len(starts)
