"""Lower bound of μ over all controllers of a plant, frequency by frequency.

At one frequency a controller is any matrix Q in M = M11 + M12 Q M21. For a given D (Parrott 1978)

    min over Q of σ̄(D M D⁻¹) = max( σ̄(D M11 D⁻¹) on the kernel of M21 D⁻¹,
                                    the same of the adjoint and the kernel of M12ᴴ D )

(T14). The first term is the gain from inputs that no measurement shows. The second is the gain to outputs
that no control reaches. The infimum over D is the least D-scaled bound of any controller at that frequency.
For up to three full blocks, performance included, the D-scaled bound is μ itself. Branch and bound on ln d_i
brackets the infimum. Each box of ln d gives lower bounds of both terms. For these, d_i on the left of M takes
the lower end of the box, and d_i on the right the upper end.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.synthesis.interconnection import GeneralisedPlant

GRID = np.r_[0.0, np.geomspace(1e-3, 1e2, 16)]
"""Default frequencies of the bound [rad/s]."""
KERNEL_RTOL = 1e-9
"""Singular values of M21 and M12 below this fraction of the largest are zero."""
ROUNDING = 4 * float(np.finfo(float).eps)
"""Relative rounding error of a product of two entries in a sum."""
WIDEST = 15.0
"""Largest |ln d| searched."""
BOXES_AT_ONCE, MOST_ROUNDS = 128, 150


@dataclass(frozen=True)
class Floor:
    """Lower bound of every controller's D-scaled μ bound.

    Attributes
    ----------
    value : float, the bound, for |ln d_i| ≤ WIDEST and any order
    at : float, least bound that the search found, value ≤ infimum ≤ at
    frequency : float, rad/s
    """

    value: float
    at: float
    frequency: float


def mu_floor(plant: GeneralisedPlant, omega=GRID, rtol: float = 2e-5) -> Floor:
    """Compute the highest floor over frequencies.

    Parameters
    ----------
    plant : GeneralisedPlant
    omega : array_like (K,), rad/s, frequencies above Nyquist's are left out
    rtol : float, relative accuracy, default 2e-05

    Returns
    -------
    Floor

    References
    ----------
    THEORY 6, (T14); Parrott 1978.
    """
    omega = np.atleast_1d(np.asarray(omega, dtype=float))
    omega = omega[omega * plant.system.dt <= np.pi]
    best = Floor(0.0, 0.0, float(omega[0]))
    for frequency, G in zip(omega, plant.system.response(omega), strict=True):
        low, high = _Frequency(plant, G).infimum(rtol, best.value)
        if low > best.value:
            best = Floor(low, high, float(frequency))
    return best


def floor_exceeds(plant: GeneralisedPlant, omega: float, level: float) -> bool:
    """True when the bound exceeds ``level`` at ``omega`` [rad/s] for every D and every controller.

    False when it does not for some D, or when the search ends without a decision.
    """
    return _Frequency(plant, plant.system.response(omega)[0]).exceeds(level)


class _Frequency:
    """Both terms of Parrott's theorem at one frequency.

    Arrays ``low`` and ``high`` (k, τ) are boxes of ln d.
    """

    def __init__(self, plant: GeneralisedPlant, G: np.ndarray):
        p, m = plant.n_measurement, plant.n_control
        M11 = G[:-p, :-m]
        blocks = (*plant.blocks, plant.performance_block)
        self.rows, self.cols = np.array([b.cols for b in blocks]), np.array([b.rows for b in blocks])
        hidden = sl.null_space(G[-p:, :-m], rcond=KERNEL_RTOL)
        beyond = sl.null_space(G[:-p, -m:].conj().T, rcond=KERNEL_RTOL)
        self.unseen = M11 @ hidden, hidden
        self.unreached = M11.conj().T @ beyond, beyond
        self.dim = len(plant.blocks)

    def bound(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Lower bound (k,) of the scaled norm over each box, equal to the norm where low = high."""
        zero = np.zeros((len(low), 1))
        low, high = np.hstack([low, zero]), np.hstack([high, zero])
        seen = _gain(*self.unseen, np.repeat(low, self.rows, axis=1), np.repeat(high, self.cols, axis=1))
        return np.maximum(
            seen,
            _gain(*self.unreached, np.repeat(-high, self.cols, axis=1), np.repeat(-low, self.rows, axis=1)),
        )

    def infimum(self, rtol: float, enough: float) -> tuple[float, float]:
        """Bracket of the infimum over D. The search ends early if the infimum is below ``enough``."""
        low, high = np.full((1, self.dim), -WIDEST), np.full((1, self.dim), WIDEST)
        values, best, least, new = self.bound(low, high), np.inf, np.inf, 1
        for _ in range(MOST_ROUNDS):
            middle = 0.5 * (low[:new] + high[:new])
            best = min(best, self.bound(middle, middle).min())
            if best <= enough:
                return min(best, least, values.min()), best
            open_ = values < best * (1 - rtol)
            least = min(least, values[~open_].min(initial=np.inf))
            low, high, values = low[open_], high[open_], values[open_]
            if not len(values):
                break
            low, high, values, new = self._divided(low, high, values)
        return min(least, values.min(initial=np.inf), best), best

    def exceeds(self, level: float) -> bool:
        """Return whether the infimum over D is known to exceed ``level``."""
        low, high = np.full((1, self.dim), -WIDEST), np.full((1, self.dim), WIDEST)
        values, new = self.bound(low, high), 1
        for _ in range(MOST_ROUNDS):
            middle = 0.5 * (low[:new] + high[:new])
            if self.bound(middle, middle).min() <= level:
                return False
            open_ = values <= level
            low, high, values = low[open_], high[open_], values[open_]
            if not len(values):
                return True
            low, high, values, new = self._divided(low, high, values)
        return False

    def _divided(self, low, high, values):
        """All boxes after a cut of those with the least bounds, and the number of new boxes.

        The new boxes come first.
        """
        order = np.argsort(values, kind="stable")
        first, rest = order[:BOXES_AT_ONCE], order[BOXES_AT_ONCE:]
        children = _halves(low[first], high[first])
        boxes = zip((*children, self.bound(*children)), (low, high, values), strict=True)
        return *(np.concatenate([new, old[rest]]) for new, old in boxes), 2 * len(first)


def _halves(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes cut in two across their widest side."""
    side = np.argmax(high - low, axis=1)
    row = np.arange(len(low))
    cut = 0.5 * (low[row, side] + high[row, side])
    upper, lower = low.copy(), high.copy()
    upper[row, side], lower[row, side] = cut, cut
    return np.concatenate([low, upper]), np.concatenate([lower, high])


def _gain(image: np.ndarray, source: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Lower bound of max over v of ‖exp(left) image v‖ / ‖exp(right) source v‖.

    It is computed for each row of ``left`` and ``right``. It is the ratio for one computed v, less the
    possible rounding of its terms. It holds for any v.
    """
    if source.shape[1] == 0:
        return np.zeros(len(left))
    R = np.linalg.qr(np.exp(right)[:, :, None] * source, mode="r")
    scaled = np.exp(left)[:, :, None] * image
    adjoint = np.linalg.solve(np.conj(np.swapaxes(R, 1, 2)), np.conj(np.swapaxes(scaled, 1, 2)))
    v = np.linalg.solve(R, np.linalg.svd(adjoint, full_matrices=False)[0][:, :, :1])[:, :, 0].T
    moved = ROUNDING * len(v) * np.abs(v)
    above = np.maximum(np.abs(image @ v) - np.abs(image) @ moved, 0.0).T * np.exp(left)
    below = (np.abs(source @ v) + np.abs(source) @ moved).T * np.exp(right)
    return np.linalg.norm(above, axis=1) / np.linalg.norm(below, axis=1)
