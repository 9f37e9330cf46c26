"""Lower bound of μ for real parameters: the smallest δ that makes I − M(jω) Δ singular, and its frequency.

A loop with only real parameters becomes singular at single frequencies, where an eigenvalue of M(jω) Δ
crosses the real axis. A grid of frequencies would miss them, and the power iteration works at one frequency.
Here δ and ω change together. With left and right null vectors y, x of I − M Δ the condition is linear to
first order,

    yᴴ (I − M(jω) Δ) x + Σ_i δ̇_i ∂_i + ω̇ ∂_ω = 0,

and its solution δ with the smallest max_i |δ_i| has a closed form. The iteration repeats this step. A check
ensures that I − M Δ is singular for an M that differs from the given M by rounding only.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.synthesis.statespace import EPS
from lpvguard.engine.synthesis.structure import Structure

ROUNDING = 64 * EPS
"""Relative rounding error of the entries of M that is allowed in every bound with real parameters."""
STEPS, RESTORING = 25, 8
LONGEST, SHORTENED = 0.5, 0.8
"""Longest first step, relative to max |δ_i| and to ω, and the factor by which each further step is
shorter."""
NEARBY = 1e-5
"""Relative step of ω in the numerical derivative of M."""


@dataclass(frozen=True)
class Crossing:
    """A Δ that makes I − M(jω) Δ singular.

    Attributes
    ----------
    value : float, 1 / max_i |δ_i|, a lower bound of μ at ``omega``; 0 where the search failed
    omega : float, frequency in rad/s
    delta : ndarray (Σrows, Σcols), or None where the search failed
    """

    value: float
    omega: float
    delta: np.ndarray | None


NOTHING = Crossing(0.0, np.nan, None)


def is_singular(M: np.ndarray, delta: np.ndarray, moved: np.ndarray) -> bool:
    """Return whether I − M' Δ is singular for some M' within rounding ``moved`` of M (p, m), with Δ (m, p).

    Signals are scaled first, so that the result does not depend on their units. With the singular vectors y,
    x of σ_min, a rank-one change of M Δ of size σ_min makes the matrix singular. Rounding allows a change |yᴴ
    dM Δ x| of up to |y|ᵀ ``moved`` |Δ| |x|.
    """
    closed = M @ delta
    scale = sl.matrix_balance(np.abs(closed), permute=False, separate=True)[1][0]
    left, sigma, right = np.linalg.svd(np.eye(len(M)) - closed * scale / scale[:, None])
    change = (moved @ np.abs(delta)) * scale / scale[:, None]
    return bool(sigma[-1] <= np.abs(left[:, -1]) @ change @ np.abs(right[-1]) + 4 * EPS * len(M))


def least_parameters(A: np.ndarray, b: np.ndarray, free: np.ndarray | None) -> tuple[np.ndarray, float]:
    """Solve A δ + free s = b for the δ (k,) with the smallest max_i |δ_i|. Returns δ and s.

    A (2, k) holds the real and imaginary parts of one complex equation, or (1, k) one real equation. ``free``
    (2,) is the column of the variable s, whose size does not count; without ``free`` s is 0. δ is NaN where
    there is no solution. The dual problem is max λᵀb / ‖Aᵀλ‖₁ with λ orthogonal to ``free``. Without ``free``
    the optimal λ is orthogonal to one column of A.
    """
    k = A.shape[1]
    if len(A) == 1:
        size = np.abs(A).sum()
        return (np.sign(A[0]) * b[0] / size if size > 0 else np.full(k, np.nan)), 0.0
    if free is not None:
        normal = np.array([-free[1], free[0]])
        weights = normal @ A
        size = np.abs(weights).sum()
        length = free @ free
        if not (size > 0 and length > 0):
            return np.full(k, np.nan), 0.0
        delta = np.sign(weights) * (normal @ b) / size
        return delta, float(free @ (b - A @ delta) / length)
    best = np.full(k, np.nan)
    for j in range(k):
        normal, length = np.array([-A[1, j], A[0, j]]), A[:, j] @ A[:, j]
        weights = normal @ A
        weights[j] = 0.0
        size = np.abs(weights).sum()
        if not (size > 0 and length > 0):
            continue
        delta = np.sign(weights) * (normal @ b) / size
        delta[j] = A[:, j] @ (b - A @ delta) / length
        if not np.abs(best).max() <= np.abs(delta).max():
            best = delta
    return best, 0.0


def nearest_parameters(
    A: np.ndarray, b: np.ndarray, free: np.ndarray | None, delta: np.ndarray, omega: float
) -> tuple[np.ndarray, float]:
    """Solve A δ + free s = b for the δ nearest to ``delta`` (k,), with s weighted by 1 / ``omega`` [rad/s].

    A (2, k) or (1, k), b (2,) or (1,), ``free`` (2,) and the result are those of ``least_parameters``.
    """
    if free is None:
        return delta + np.linalg.pinv(A) @ (b - A @ delta), 0.0
    whole = np.column_stack([A * np.abs(delta).max(), free * omega])
    change = np.linalg.pinv(whole) @ (b - A @ delta)
    return delta + change[:-1] * np.abs(delta).max(), float(change[-1] * omega)


class RealSearch:
    """Search for the smallest real Δ of a loop with only real blocks, from ``low`` to ``high`` [rad/s].

    ``response`` returns M (Σcols, Σrows) at a frequency [rad/s], and the rounding of its entries.
    """

    def __init__(
        self,
        response: Callable[[float], tuple[np.ndarray, np.ndarray]],
        structure: Structure,
        low: float,
        high: float,
    ):
        self.response, self.structure, self.low, self.high = response, structure, low, high
        self.sizes = [b.rows for b in structure.blocks]

    def delta(self, parameters: np.ndarray) -> np.ndarray:
        """Δ, shape (Σrows, Σrows), with the values ``parameters``, shape (k,)."""
        return np.diag(np.repeat(parameters, self.sizes))

    def polished(self, parameters: np.ndarray, omega: float) -> Crossing:
        """Return the best crossing of a search from ``parameters`` (k,) at ``omega`` [rad/s]."""
        best = NOTHING
        for moving in (True, False) if self.low < omega < self.high else (False,):
            for steps in (0, STEPS):
                here = self._reached(np.array(parameters, float), omega, moving, steps)
                best = here if here.value > best.value else best
        return best

    def _reached(self, delta: np.ndarray, omega: float, moving: bool, steps: int) -> Crossing:
        """Take ``steps`` ever shorter steps towards a smaller δ, and then find the nearest singular δ."""
        longest = LONGEST
        for step in range(steps + RESTORING):
            M, moved = self.response(omega)
            if not np.isfinite(M).all():
                return NOTHING
            A, b, along = self._equation(M, delta, omega if moving else None)
            if step < steps:
                target, change = least_parameters(A, b, along)
            else:
                target, change = nearest_parameters(A, b, along, delta, omega)
            if not np.isfinite(target).all() or not target.any():
                return NOTHING
            size, length = np.abs(delta).max(), np.abs(target - delta).max()
            share = min(1.0, longest * size / length if length > 0 else 1.0)
            if moving and change:
                share = min(share, longest * omega / abs(change))
                omega = float(np.clip(omega + share * change, self.low, self.high))
            delta = delta + share * (target - delta)
            longest = longest * SHORTENED if step < steps else LONGEST
        M, moved = self.response(omega)
        if not np.isfinite(M).all() or not is_singular(M, self.delta(delta), moved):
            return NOTHING
        return Crossing(float(1 / np.abs(delta).max()), omega, self.delta(delta))

    def _equation(
        self, M: np.ndarray, delta: np.ndarray, omega: float | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """The condition yᴴ (I − M Δ) x = 0, linear in the new δ and dω.

        Returns A (2, k) or (1, k), b, and the column of dω.
        """
        if omega is None and not M.imag.any():
            M = M.real
        loop = np.eye(len(M)) - M @ self.delta(delta)
        left, _, right = np.linalg.svd(loop)
        y, x = left[:, -1].conj(), right[-1].conj()
        terms = (y @ M) * x
        slope = np.add.reduceat(terms, np.cumsum([0, *self.sizes[:-1]]))
        rhs = y @ x
        parts = (lambda z: np.array([z.real, z.imag])) if np.iscomplexobj(M) else (lambda z: np.array([z]))
        along = None
        if omega is not None:
            nearby, _ = self.response(omega * (1 + NEARBY))
            along = parts(y @ ((nearby - M) / (omega * NEARBY)) @ (np.repeat(delta, self.sizes) * x))
        return parts(slope), parts(rhs), along

    def starts(self, omega: np.ndarray, count: int, real_part: float = 1.0) -> list[tuple[np.ndarray, float]]:
        """Return starts (δ, ω) of the search on a grid ``omega`` (K,) [rad/s], the smallest δ first.

        All |δ_i| of a start are equal. Q has the entries ±1. An eigenvalue of M(jω) Q marks a start in two
        cases. Its real part is at least ``real_part`` times its magnitude, or it crosses the real axis before
        the next frequency. At most ``count`` starts have a real M, and as many have another M, because an
        eigenvalue may be nearly real over a wide range.
        """
        M = np.array([self.response(w)[0] for w in omega])
        finite = np.isfinite(M).all((1, 2))
        M, omega = M[finite], omega[finite]
        marks: list[tuple[float, int, int]] = []
        for n, q in enumerate(signs := _signs(len(self.sizes))):
            values = np.linalg.eigvals(M * np.repeat(q, self.sizes))
            real = np.abs(values.real) >= real_part * (1 - 1e-9) * np.abs(values)
            if len(values) > 1:
                near = np.argmin(np.abs(values[1:, None, :] - values[:-1, :, None]), axis=2)
                after = np.take_along_axis(values[1:], near, 1)
                real[:-1] |= (after.imag * values[:-1].imag < 0) & (after.real * values[:-1].real > 0)
            kept = np.where(real, values.real, 0.0)
            largest = np.take_along_axis(kept, np.abs(kept).argmax(1)[:, None], 1)[:, 0]
            marks += [(value, n, j) for j, value in enumerate(largest) if value]
        marks.sort(key=lambda mark: -abs(mark[0]))
        where_real = ~M.imag.any((1, 2))
        marks = [m for real in (True, False) for m in [m for m in marks if where_real[m[2]] == real][:count]]
        return [(signs[n] / value, float(omega[j])) for value, n, j in marks]


def _signs(k: int) -> np.ndarray:
    """Combinations of ±1, shape (at most 64, k), with the first entry 1. For k ≤ 7 they are complete."""
    varied = min(k, 7) - 1
    signs = np.ones((2**varied, k))
    for i in range(varied):
        signs[:, 1 + i] -= 2.0 * (np.arange(2**varied) >> i & 1)
    return signs
