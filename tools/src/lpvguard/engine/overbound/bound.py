"""Checked samples of a bound, without empty bins, scaled to values near one.

Between samples, ln bound is linear in ln w. Below the first sample and above the last it is constant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ...base.errors import InputError

_MAX_RANGE = 1e60
"""Largest allowed ratio of the largest to the smallest bound."""


@dataclass(frozen=True)
class SampledBound:
    """A checked bound without NaN samples: ``omega`` (K,) in rad/s, ``bound`` (K,) divided by ``level``.

    ``unit`` and ``level`` are powers of two near the middle of omega and bound, so the change of units is
    exact. With y = (w/unit)^2, powers of y and squares of the bound stay in range. ``without_data``:
    frequencies (rad/s) of NaN samples. ``floored``: frequencies (rad/s) where the floor replaced a smaller
    bound.
    """

    omega: np.ndarray
    bound: np.ndarray
    unit: float
    level: float
    without_data: tuple[float, ...]
    floored: tuple[float, ...]

    @classmethod
    def read(cls, source: str, omega: ArrayLike, bound: ArrayLike, floor: float | None) -> SampledBound:
        """Check the arguments of :func:`fit.fit_overbound` and return the bound.

        Raises InputError for invalid values; the error names ``source`` and the index or frequency.
        """
        omega, bound = np.asarray(omega, dtype=float), np.asarray(bound, dtype=float)
        if omega.ndim != 1 or bound.shape != omega.shape or omega.size == 0:
            raise InputError(
                source,
                "",
                f"omega has shape {omega.shape} and bound {bound.shape}",
                "two lists of the same length >= 1",
            )
        for wrong, expected in (
            (~np.isfinite(omega) | (omega <= 0), "a finite frequency > 0 rad/s"),
            (np.append(False, np.diff(omega) <= 0), "strictly increasing frequencies"),
        ):
            if wrong.any():
                at = int(np.argmax(wrong))
                raise InputError(source, f"omega[{at}]", f"{omega[at]!r}", expected)
        known = ~np.isnan(bound)
        if not known.any():
            raise InputError(source, "bound", "every value is NaN", "data in at least one bin")
        wrong = known & ((bound < 0) | np.isinf(bound))
        if wrong.any():
            at = int(np.argmax(wrong))
            raise InputError(
                source, f"bound[{at}] at {omega[at]:g} rad/s", f"{bound[at]}", "a finite value >= 0, or NaN"
            )
        if floor is not None and not (np.isfinite(floor) and floor > 0):
            raise InputError(source, "floor", f"{floor!r}", "a finite number > 0")
        raised = known & (bound < (floor or 0.0))
        w, b = omega[known], np.where(raised, floor or 0.0, bound)[known]
        if (b == 0).any():
            raise InputError(
                source,
                f"bound at {w[np.argmin(b)]:g} rad/s",
                "is 0, but no weight is zero on an interval",
                "a floor > 0",
            )
        if b.max() / b.min() > _MAX_RANGE:
            raise InputError(
                source,
                f"bound at {w[np.argmin(b)]:g} rad/s",
                f"is {b.min()}, while the largest value is {b.max()}",
                f"a range of at most {_MAX_RANGE:g}",
            )
        unit, level = (2.0 ** round(0.5 * (math.log2(v.min()) + math.log2(v.max()))) for v in (w, b))
        return cls(w, b / level, unit, level, tuple(omega[~known].tolist()), tuple(omega[raised].tolist()))

    def reciprocal(self) -> SampledBound:
        """The same samples with 1/bound as bound."""
        return replace(self, bound=1.0 / self.bound)

    @property
    def y(self) -> np.ndarray:
        """(K,) squared frequencies (w/unit)^2."""
        return (self.omega / self.unit) ** 2
