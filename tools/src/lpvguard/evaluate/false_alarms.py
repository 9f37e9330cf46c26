"""False alarms of a detector on drives without a fault, in pieces of 60 s and in drives.

Every second of a drive counts, judged or not. A drive's last piece may be shorter. The rate is alarmed pieces
an hour of judged driving; judged is the monitor's for all detectors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..replay.run import Replay

PIECE_S = 60.0
BOOTSTRAP_DRAWS = 10_000


@dataclass(frozen=True)
class Pieces:
    """Alarmed and all 60 s pieces, a drive's shorter last one included, with a 95 % interval of their ratio
    from resampling drives.

    drives, alarmed_drives: all, and those with an alarmed piece; judged_h: hours of judged driving;
    per_judged_h: alarmed pieces an hour of it, None without any.
    """

    drives: int
    alarmed: int
    pieces: int
    interval: tuple[float, float] | None
    alarmed_drives: int
    judged_h: float
    per_judged_h: float | None

    @classmethod
    def of(cls, counts: list[tuple[int, int]], judged_s: list[float], seed: int) -> Pieces:
        """``counts``: (alarmed, all) pieces of each drive; ``judged_s``: the judged seconds of each."""
        alarmed, pieces = (int(sum(c[i] for c in counts)) for i in (0, 1))
        judged_h = sum(judged_s) / 3600
        rest = sum(c[0] > 0 for c in counts), judged_h, alarmed / judged_h if judged_h else None
        if not pieces:
            return cls(len(counts), 0, 0, None, *rest)
        draws = np.random.default_rng(seed).integers(0, len(counts), (BOOTSTRAP_DRAWS, len(counts)))
        table = np.array(counts, float)[draws].sum(axis=1)
        ratio = table[:, 0] / np.maximum(table[:, 1], 1.0)
        low, high = np.percentile(ratio[table[:, 1] > 0], [2.5, 97.5])
        return cls(len(counts), alarmed, pieces, (float(low), float(high)), *rest)


def alarming(replay: Replay, test: str | None = None) -> np.ndarray:
    """(N,) True at samples where a test (None: either) falsifies the model.

    For "frame" these are the samples with which a falsifying frame was judged. For "energy" they are all
    samples above the threshold, because this test's value persists. A frame is judged once.
    """
    return {"frame": replay.falsified, "energy": replay.over, None: replay.falsified | replay.over}[test]


def piece_starts(samples: int, Ts: float) -> np.ndarray:
    """First samples (P,) of the 60 s pieces of a drive of ``samples`` at ``Ts`` [s].

    The last piece is what remains, up to 60 s with the closing sample.
    """
    return np.arange(0, max(1, samples - 1), round(PIECE_S / Ts))


def alarmed_pieces(replay: Replay, test: str | None = None) -> tuple[int, int]:
    """(alarmed, all) 60 s pieces of a drive, by a test (None: either)."""
    starts = piece_starts(len(replay.judged), replay.Ts)
    return int(np.logical_or.reduceat(alarming(replay, test), starts).sum()), len(starts)
