"""Constant block scalings of a loop. They prove a norm for uncertainty that varies arbitrarily fast.

They are searched on a grid of frequencies. The proved level is the upper bound of the scaled norm over all
frequencies.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import EPS, StateSpace

GRID = 160
"""Number of frequencies on which constants are searched."""
SLOWEST = 1e-4
"""Lowest frequency above 0 of the grid [rad/s]."""
NORM_RTOL = 1e-5
SEARCH_STEPS, SHORTENED = 40, 30
"""Largest number of Newton steps, and of the times that one step is shortened."""
SHORTER = 0.05, 0.5
"""Least and largest factor by which a step is shortened."""
LONGEST_STEP = 4.0
"""Longest step of a constant's logarithm. Far from the optimum the curvature is too small to limit a step."""
LEAST_GAIN = 1e-8
"""The search ends when a step promises a smaller decrease of the mean's logarithm."""
LEAST_GAP = 1e-6
"""Least gap between the largest eigenvalue and another one in a second derivative, relative to the
largest."""
POWER = 300.0
"""Power of the mean over frequency. This mean replaces the largest value: it is smooth, and convex in the
constants' logarithms."""
FARTHEST = 30.0
"""Largest |logarithm| of a constant. It bounds constants that have no effect."""


class ConstantScalings:
    """Constant scalings of a stable discrete ``system``, whose first signals belong to the blocks.

    Block i has ``rows[i]`` outputs and ``cols[i]`` inputs of the system. The other signals are performance.
    The first ``fixed`` blocks keep the constant 1.
    """

    def __init__(self, system: StateSpace, rows: Sequence[int], cols: Sequence[int], fixed: int = 0):
        self.system, self.rows, self.cols, self.fixed = system, list(rows), list(cols), fixed

    @property
    def free(self) -> int:
        """Number of constants."""
        return len(self.rows) - self.fixed

    def scaled(self, sizes: np.ndarray, rest: float, log_constants: np.ndarray) -> StateSpace:
        """The scaled loop.

        ``sizes`` (blocks,) are the gains of the blocks' uncertainty. ``rest`` is the factor of the other
        outputs. ``log_constants`` (free,) are the logarithms of the constants.
        """
        left, right = self._factors(sizes, rest, log_constants)
        G = self.system
        return StateSpace(G.A, G.B * right, G.C * left[:, None], G.D * left[:, None] * right, G.dt)

    def proved(self, sizes: np.ndarray, rest: float, log_constants: np.ndarray) -> float:
        """Upper bound of the scaled loop's norm over all frequencies.

        ``sizes`` (blocks,), ``rest`` and ``log_constants`` (free,) are those of ``scaled``.
        """
        return hinf_norm(self.scaled(sizes, rest, log_constants), NORM_RTOL).upper

    def least(
        self, sizes: np.ndarray, rest: float, start: np.ndarray, only_whether: bool = False
    ) -> tuple[float, np.ndarray]:
        """Search for the least norm on the grid and the logarithms (free,) of its constants.

        ``sizes`` (blocks,) and ``rest`` are those of ``scaled``. The search begins at ``start`` (free,). With
        ``only_whether`` it ends as soon as the norm is below 1.
        """
        constants = self._least_mean(sizes, rest, start, only_whether) if self.free else start
        return self._largest(sizes, rest, constants), constants

    def _least_mean(
        self, sizes: np.ndarray, rest: float, start: np.ndarray, only_whether: bool
    ) -> np.ndarray:
        """The logarithms (free,) with the least power mean, by Newton's method."""
        x = np.clip(start, -FARTHEST, FARTHEST)
        value, slope, curvature = self._mean(sizes, rest, x)
        for _ in range(SEARCH_STEPS):
            # A constant without effect stays. A constant at its limit moves only inwards.
            ridge = EPS**0.5 * max(float(np.abs(curvature).max()), 1.0) * np.eye(len(x))
            moves = (np.abs(x) < FARTHEST) | (x * slope > 0)
            slope, kept = np.where(moves, slope, 0.0), np.outer(moves, moves)
            step = -np.linalg.solve(np.where(kept, curvature, 0.0) + ridge, slope)
            step *= LONGEST_STEP / max(float(np.abs(step).max()), LONGEST_STEP)
            promised = -float(slope @ step)
            # The largest value is at most the mean times the number of frequencies, and at least the mean.
            below = value + np.log(len(self._grid)) / POWER < 0
            if promised < LEAST_GAIN or (only_whether and below):
                break
            for _ in range(SHORTENED):
                tried = np.clip(x + step, -FARTHEST, FARTHEST)
                new = self._mean(sizes, rest, tried)
                if new[0] < value - 1e-4 * promised:
                    break
                less = _shorter(new[0] - value, promised, float(new[1] @ step))
                step, promised = less * step, less * promised
            else:
                break
            x, (value, slope, curvature) = tried, new
        return x

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
        self, sizes: np.ndarray, rest: float, log_constants: np.ndarray
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """Power mean of the largest singular value over frequency.

        Returns its logarithm, and the slope (free,) and curvature (free, free) of the logarithm.
        """
        left, right = self._factors(sizes, rest, log_constants)
        N = left[:, None] * self._grid * right
        gram = N @ np.conj(np.swapaxes(N, 1, 2))
        # Drop frequencies whose values are too small to change the mean. sigma^2 is at most the trace.
        diagonal = np.diagonal(gram, axis1=1, axis2=2).real
        counts = diagonal.sum(axis=1) >= diagonal.max() * EPS ** (2 / POWER)
        N, frequencies = N[counts], len(N)
        values, U = np.linalg.eigh(gram[counts])
        log_sigma = 0.5 * np.log(np.maximum(values[:, -1], 1e-300))
        slopes, curvatures = self._derivatives(N, np.maximum(values, 1e-300), U)
        top = log_sigma.max()
        weight = np.exp(POWER * (log_sigma - top))
        share = weight / weight.sum()
        slope = share @ slopes
        curvature = np.tensordot(share, curvatures, 1) + POWER * (
            (slopes.T * share) @ slopes - np.outer(slope, slope)
        )
        return float(top + np.log(weight.sum() / frequencies) / POWER), slope, curvature

    def _derivatives(self, N: np.ndarray, values: np.ndarray, U: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slope (k, free) and curvature (k, free, free) of the logarithm of the largest singular value.

        The responses are N (k, rows, columns). ``values`` (ascending) and U are the eigenvalues and
        eigenvectors of N N^H. With the rows P_i and columns Q_i of block i, d(N N^H) = P_i N N^H + N N^H P_i
        - 2 N Q_i N^H.
        """
        largest, u = values[:, -1], U[:, :, -1]
        sigma = np.sqrt(largest)[:, None, None]
        v = (u[:, None, :] @ np.conj(N))[:, 0] / sigma[:, 0]
        in_rows, in_columns = self._of_blocks
        of_u, of_v = u[:, None, :] * in_rows, v[:, None, :] * in_columns
        a, b = (np.abs(of_u) ** 2).sum(axis=2), (np.abs(of_v) ** 2).sum(axis=2)
        slopes = a - b
        back = of_u @ np.conj(N)
        # u_m^H d(N N^H) u for every eigenvector u_m except that of the largest eigenvalue.
        turned = (largest[:, None, None] + values[:, None, :]) * (of_u @ np.conj(U))
        turned -= 2 * sigma * (of_v @ np.swapaxes(N, 1, 2) @ np.conj(U))
        gap = np.maximum(largest[:, None] - values[:, :-1], LEAST_GAP * largest[:, None])[:, None, :]
        turned = turned[:, :, :-1]
        both = 4 * sigma * _real_products(back, of_v)
        second = 2 * (_real_products(back, back) + _real_products(turned / gap, turned))
        second -= both + np.swapaxes(both, 1, 2)
        second += (2 * a + 4 * b)[:, :, None] * np.eye(self.free) * largest[:, None, None]
        return slopes, 0.5 * second / largest[:, None, None] - 2 * slopes[:, :, None] * slopes[:, None, :]

    @cached_property
    def _of_blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """Masks of the outputs (free, rows) and inputs (free, columns) of each block with a constant."""
        G, blocks = self.system, np.arange(self.fixed, len(self.rows))[:, None]
        block_numbers = [np.repeat(np.arange(len(sizes)), sizes) for sizes in (self.rows, self.cols)]
        return (
            1.0 * (np.append(block_numbers[0], np.full(G.n_outputs - len(block_numbers[0]), -1)) == blocks),
            1.0 * (np.append(block_numbers[1], np.full(G.n_inputs - len(block_numbers[1]), -1)) == blocks),
        )

    def _largest(self, sizes: np.ndarray, rest: float, log_constants: np.ndarray) -> float:
        left, right = self._factors(sizes, rest, log_constants)
        N = left[:, None] * self._grid * right
        return float(np.sqrt(np.linalg.eigvalsh(N @ np.conj(np.swapaxes(N, 1, 2)))[:, -1].max()))


def _shorter(change: float, promised: float, slope: float) -> float:
    """Fraction of a step at which the cubic through both ends has its minimum.

    The step changes the value by ``change``, begins with the slope -``promised`` and ends with ``slope``.
    """
    # The argument of the root is positive, because the value has not fallen by a quarter of the promise.
    a, b = slope - promised - 2 * change, 3 * change + 2 * promised - slope
    return float(np.clip(promised / (b + np.sqrt(b * b + 3 * a * promised)), *SHORTER))


def _real_products(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Re left_i^H right_j (k, n, n), for ``left`` and ``right`` (k, n, m)."""
    return (np.conj(left) @ np.swapaxes(right, 1, 2)).real
