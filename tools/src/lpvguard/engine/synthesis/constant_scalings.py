"""Constants that scale the blocks of a loop: what proves a norm for uncertainty that varies at any speed.

They are searched on a grid of frequencies. What is claimed is the upper end of the scaled norm's bracket
over all frequencies.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import EPS, StateSpace

GRID = 160
"""Frequencies on which constants are searched."""
SLOWEST = 1e-4
"""rad/s"""
NORM_RTOL = 1e-5
SEARCH_STEPS = 40
POWERS = (10.0, 300.0)
"""Of the mean over frequency that stands for the largest value, one after the other: it is smooth and, in the
logarithms of the constants, convex."""
FARTHEST = 30.0
"""Largest |logarithm| of a constant: what never matters must not wander off."""


class ConstantScalings:
    """A stable discrete ``system`` whose first outputs and inputs belong to blocks of ``rows`` and ``cols``
    signals. The rest is performance. The first ``fixed`` blocks keep the constant 1."""

    def __init__(self, system: StateSpace, rows: Sequence[int], cols: Sequence[int], fixed: int = 0):
        self.system, self.rows, self.cols, self.fixed = system, list(rows), list(cols), fixed

    @property
    def free(self) -> int:
        """Number of constants."""
        return len(self.rows) - self.fixed

    def scaled(self, sizes: np.ndarray, rest: float, log_constants: np.ndarray) -> StateSpace:
        """The scaled loop: ``sizes`` (blocks,) of what is connected to each block, ``rest``: factor of the
        other outputs, and the logarithms (free,) of the constants."""
        left, right = self._factors(sizes, rest, log_constants)
        G = self.system
        return StateSpace(G.A, G.B * right, G.C * left[:, None], G.D * left[:, None] * right, G.dt)

    def proved(self, sizes: np.ndarray, rest: float, log_constants: np.ndarray) -> float:
        """The norm from above, over all frequencies; ``sizes`` (blocks,), ``rest`` and ``log_constants``
        (free,) as of ``scaled``."""
        return hinf_norm(self.scaled(sizes, rest, log_constants), NORM_RTOL).upper

    def least(self, sizes: np.ndarray, rest: float, start: np.ndarray) -> tuple[float, np.ndarray]:
        """The least norm on the grid, and the logarithms (free,) of its constants; ``sizes`` (blocks,) and
        ``rest`` as of ``scaled``, ``start`` (free,): where the search begins."""
        for power in POWERS if self.free else ():
            start = minimize(
                lambda x, power=power: self._mean(sizes, rest, x, power),
                start,
                jac=True,
                method="BFGS",
                options={"maxiter": SEARCH_STEPS, "gtol": 1e-4},
            ).x
            start = np.clip(start, -FARTHEST, FARTHEST)
        return self._largest(sizes, rest, start), start

    @cached_property
    def _grid(self) -> np.ndarray:
        """The loop's response, (frequencies, rows, columns)."""
        omega = np.concatenate([[0.0], np.geomspace(SLOWEST, np.pi / self.system.dt * (1 - 1e-9), GRID)])
        return self.system.response(omega)

    def _factors(
        self, sizes: np.ndarray, rest: float, log_constants: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        log = np.concatenate([np.zeros(self.fixed), log_constants])
        left, right = np.repeat(np.exp(log) * sizes, self.rows), np.repeat(np.exp(-log), self.cols)
        G = self.system
        return (
            np.append(left, np.full(G.n_outputs - len(left), rest)),
            np.append(right, np.ones(G.n_inputs - len(right))),
        )

    def _mean(
        self, sizes: np.ndarray, rest: float, log_constants: np.ndarray, power: float
    ) -> tuple[float, np.ndarray]:
        """Logarithm of the power mean over frequency of the largest singular value, and its slope."""
        clipped = np.clip(log_constants, -FARTHEST, FARTHEST)
        left, right = self._factors(sizes, rest, clipped)
        N = left[:, None] * self._grid * right
        gram = N @ np.conj(np.swapaxes(N, 1, 2))
        # What is below the largest by so much has no part in the mean; sigma^2 is at most the trace.
        diagonal = np.diagonal(gram, axis1=1, axis2=2).real
        counts = diagonal.sum(axis=1) >= diagonal.max() * EPS ** (2 / power)
        N, frequencies = N[counts], len(N)
        values, U = np.linalg.eigh(gram[counts])
        log_sigma, u = 0.5 * np.log(np.maximum(values[:, -1], 1e-300)), U[:, :, -1]
        v = np.einsum("kij,ki->kj", N, u.conj()) / np.exp(log_sigma)[:, None]
        top = log_sigma.max()
        weight = np.exp(power * (log_sigma - top))
        slopes = np.array(
            [
                (np.abs(u[:, r]) ** 2).sum(axis=1) - (np.abs(v[:, c]) ** 2).sum(axis=1)
                for r, c in zip(_slices(self.rows), _slices(self.cols), strict=True)
            ][self.fixed :]
        )
        slope = slopes @ weight / weight.sum()
        return float(top + np.log(weight.sum() / frequencies) / power), np.where(
            clipped == log_constants, slope, 0.0
        )

    def _largest(self, sizes: np.ndarray, rest: float, log_constants: np.ndarray) -> float:
        left, right = self._factors(sizes, rest, log_constants)
        N = left[:, None] * self._grid * right
        return float(np.sqrt(np.linalg.eigvalsh(N @ np.conj(np.swapaxes(N, 1, 2)))[:, -1].max()))


def _slices(sizes: Sequence[int]) -> list[slice]:
    edges = np.cumsum([0, *sizes])
    return [slice(a, b) for a, b in itertools.pairwise(edges)]
