"""Smallest gain and delay error that a test can see in each speed cell and bin (T25; THEORY 7.4).

The tests are those of frames, of pools and of changes.

Both errors are computed for two excitations: the strongest one of all drives, and a typical one. One counted
frame in ten exceeds the typical excitation (PERCENTILE). Excitation is ordered by t*(-Z, Z). For one output
this is the order of |Z|. For several outputs it does not depend on their units.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..base.sampling import Rows, first_of_each, largest_of_each, row_hash, stacked
from ..engine.validation import s1

PERCENTILE = 90
"""Percentile of the typical excitation among the counted frames of a speed cell and bin (nearest rank)."""
SAMPLED_FRAMES = 400
"""Largest number of frames of a cell and bin for the percentile. More frames are sampled by hash."""
SPEED_CELLS = 5
STATED_GAINS = (0.6, 0.7)
STATED_DELAYS_S = (0.3, 0.15)


@dataclass(frozen=True)
class Excitation:
    """Excitation of counted frames in bounded memory.

    ``count`` (SPEED_CELLS, K) counts all frames. Each row holds ``group`` (cell * K + bin), ``hash``,
    ``dead`` = t*(-Z, Z) and ``size`` = |Z| [output units]. The rows are the frame of the largest ``dead`` of
    each group and a sample of SAMPLED_FRAMES.
    """

    count: np.ndarray
    strongest: Rows
    sample: Rows

    @classmethod
    def from_frames(
        cls,
        name: str,
        speed_range: tuple[float, float],
        bin_of: np.ndarray,
        speed: np.ndarray,
        Z: np.ndarray,
        W_delta: np.ndarray,
        B_w: np.ndarray,
        number: np.ndarray,
    ) -> Excitation:
        """Excitation of the F counted frames of drive ``name``.

        The frames have the bins ``bin_of`` (F,), the mean speeds ``speed`` (F,) [m/s] and the outputs Z (F,
        n_y) [output units]. ``number`` (F,) identifies the frames of a bin. ``speed_range`` [m/s] is divided
        into SPEED_CELLS equal cells. The bounds are W_delta (K, n_delta) and B_w (K, n_y).
        """
        K = len(W_delta)
        group = speed_cell(speed_range, speed) * K + bin_of
        dead = s1.margin(-Z, Z, W_delta[bin_of], B_w[bin_of])
        rows = {
            "group": group,
            "hash": row_hash(name, bin_of, number),
            "dead": dead,
            "size": np.linalg.norm(Z, axis=1),
        }
        count = np.bincount(group, minlength=SPEED_CELLS * K).reshape(SPEED_CELLS, K)
        return cls.of_rows(count, rows, rows)

    @classmethod
    def of_rows(cls, count: np.ndarray, strongest: Rows, sample: Rows) -> Excitation:
        """Excitation with the strongest ones and a sample of the given rows."""
        return cls(count, *cls._selected(strongest, sample))

    @classmethod
    def joined(cls, parts: Iterable[Excitation]) -> Excitation:
        """Excitation of the frames of all drives together."""
        parts = list(parts)
        return cls(
            np.sum([p.count for p in parts], axis=0),
            *cls._selected(stacked(p.strongest for p in parts), stacked(p.sample for p in parts)),
        )

    def evidence(self, bins: int) -> np.ndarray:
        """Largest evidence t*(-Z, Z) (K,) in each of K = ``bins`` bins, 0 without a frame."""
        largest = np.zeros(bins)
        np.maximum.at(largest, self.strongest["group"] % bins, self.strongest["dead"])
        return largest

    @staticmethod
    def _selected(strongest: Rows, sample: Rows) -> tuple[Rows, Rows]:
        return largest_of_each(strongest, strongest["dead"]), first_of_each(sample, SAMPLED_FRAMES)


def speed_cell(speed_range: tuple[float, float], speed: np.ndarray) -> np.ndarray:
    """Cell of each speed (F,) [m/s]. A speed outside the range belongs to the nearest cell."""
    cell = np.searchsorted(_edges(speed_range), speed, side="right") - 1
    return np.clip(cell, 0, SPEED_CELLS - 1)


def _edges(speed_range: tuple[float, float]) -> np.ndarray:
    return np.linspace(*speed_range, SPEED_CELLS + 1)


def visibility(
    omega: np.ndarray,
    speed_range: tuple[float, float],
    met: Excitation,
    W_delta: np.ndarray,
    threshold: float,
    inflation: float = 1.0,
    silent: Collection[int] = (),
    others: Sequence[tuple[Excitation, float]] = (),
) -> dict:
    """Smallest visible errors in each speed cell and bin, as JSON types, with None where no frame counts.

    An error is visible where any test shows it. ``omega`` (K,) [rad/s] is 0 at DC. ``W_delta`` (K, n_delta)
    is the weight behind ``met``, and ``inflation`` is a later factor on it and on B_w. Frames of the bins
    ``silent`` raise no alarm and show nothing. ``others`` are the excitation and the threshold of the other
    tests.

    ``at_percentile`` and ``at_strongest`` list the cells. Each cell has lists over the bins. They are
    ``frames``, ``excitation`` (|Z| in output units), ``gain_error`` [-], its ``limit`` (T55) and ``delay_s``.
    A delay is None at DC and where no delay has an error of this size.
    """
    edges = _edges(speed_range)

    def cells(rows_of: Callable[[Excitation], Rows], percentile: float) -> list[dict]:
        rows, listed = rows_of(met), []
        for c in range(SPEED_CELLS):
            cell = len(omega), c, percentile
            chosen = _chosen(rows, *cell)
            gain = _gains(rows, chosen, threshold * inflation)
            gain = [None if k in silent else g for k, g in enumerate(gain)]
            limit: list[float | None] = [None] * len(omega)
            for excitation, level in others:
                shown = rows_of(excitation)
                of_cell = _chosen(shown, *cell)
                seen = zip(gain, _gains(shown, of_cell, level), strict=True)
                gain = [min((g for g in both if g is not None), default=None) for both in seen]
                if "limit" in shown:
                    known = [np.nan if i is None else float(shown["limit"][i]) for i in of_cell]
                    limit = [None if np.isnan(x) else x for x in known]
            size = [None if i is None else float(rows["size"][i]) for i in chosen]
            speeds = {"speed_mps": [float(edges[c]), float(edges[c + 1])]}
            listed.append(speeds | _cell(omega, met.count[c], size, gain) | {"limit": limit})
        return listed

    return {
        "threshold": float(threshold),
        "percentile": PERCENTILE,
        "sampled_frames": SAMPLED_FRAMES,
        "omega_rad_s": omega.tolist(),
        "gain_error_floor": (threshold * inflation * W_delta.min(axis=1)).tolist(),
        "at_percentile": cells(lambda excitation: excitation.sample, PERCENTILE),
        "at_strongest": cells(lambda excitation: excitation.strongest, 100),
    }


def _chosen(rows: Rows, K: int, c: int, percentile: float) -> list[int | None]:
    """Index of the row at the percentile of excitation, for each of K bins of cell ``c``, or None."""
    return [
        _at_percentile(rows["dead"], np.flatnonzero(rows["group"] == c * K + k), percentile) for k in range(K)
    ]


def _gains(rows: Rows, chosen: list[int | None], level: float) -> list[float | None]:
    """Gain error with which each chosen row reaches ``level``."""

    dead = [0.0 if i is None else float(rows["dead"][i]) for i in chosen]
    return [level / x if x else None for x in dead]


def _cell(omega: np.ndarray, count: np.ndarray, size: list[float | None], gain: list[float | None]) -> dict:
    """Entry of a speed cell, from the frames, |Z| and visible gain error of each bin."""
    K = len(omega)
    delay = [_delay(g, w) for g, w in zip(gain, omega, strict=False)]
    return {
        "frames": count.tolist(),
        "excitation": size,
        "gain_error": gain,
        "delay_s": delay,
        "smallest_gain_error": min((g for g in gain if g is not None), default=None),
        "smallest_delay_s": min((d for d in delay if d is not None), default=None),
        "stated": [
            {"fault": f"gain {value:g}", "visible": _seen(gain, np.full(K, abs(1 - value)))}
            for value in STATED_GAINS
        ]
        + [
            {"fault": f"delay {value:g} s", "visible": _seen(gain, _delay_error(omega, value))}
            for value in STATED_DELAYS_S
        ],
    }


def _at_percentile(values: np.ndarray, members: np.ndarray, percentile: float) -> int | None:
    """Index of the member whose value has the nearest rank to ``percentile``, or None without members."""
    if not len(members):
        return None
    rank = int(np.ceil(percentile / 100 * len(members))) - 1
    return int(members[np.argsort(values[members], kind="stable")[rank]])


def _delay_error(omega: np.ndarray | float, tau: float) -> np.ndarray:
    """Size |1 - exp(-j omega tau)| of the error of a delay tau [s]."""
    return 2 * np.abs(np.sin(np.asarray(omega) * tau / 2))


def _delay(gain_error: float | None, omega: float) -> float | None:
    """Smallest delay [s] whose error reaches ``gain_error``, or None.

    A delay has an error of at most 2, and of 0 at DC.
    """
    if gain_error is None or omega == 0 or gain_error > 2:
        return None
    return float(2 * np.arcsin(gain_error / 2) / omega)


def _seen(gain_error: list[float | None], error: np.ndarray) -> bool | None:
    """Tell if an error of size ``error`` (K,) is visible in any bin, or None where the cell has no frames."""
    known = [(g, e) for g, e in zip(gain_error, error, strict=False) if g is not None]
    return any(e > g for g, e in known) if known else None
