"""The non-convex quadratic problem of an LFT point: the least sizes p over all signals z.

The problem is min sum_j p_j over z = (theta, 1) and p >= 0 subject to :class:`Form` s. A full block or the
disturbance's ball is a form. A repeated block is a form and an equation a z = delta b z with one scalar
delta.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpvguard.engine.validation.problem import RANK_TOLERANCE

CANCELLED = 1e-12
"""A sum below this fraction of the size of its terms counts as rounding."""


@dataclass(frozen=True)
class Form:
    """Constraint |a z|^2 <= (constant + sizes[param]) slope |b z|^2; if repeated, also a z = delta b z.

    ``a`` (r, n), ``b`` (r', n); r = r' for a repeated block, whose kind is ``repeated``. ``param`` -1 means
    that only the constant acts. The constant is inf if a repeated block has no bound (an infinite cap).
    ``parts`` holds the signals that ``a`` stacks, if there are several.
    """

    a: np.ndarray
    b: np.ndarray
    constant: float = 0.0
    param: int = -1
    slope: float = 1.0
    repeated: str | None = None
    parts: tuple[np.ndarray, ...] = ()


def cancels(a: np.ndarray, z: np.ndarray) -> bool:
    """Return whether a @ z is zero up to the rounding of its terms, for ``a`` (r, n) and ``z`` (n,)."""
    return bool(np.linalg.norm(a @ z) <= CANCELLED * np.linalg.norm(np.abs(a) @ np.abs(z)))


class Quadratic:
    """Problem: min sum_j p_j over z = (theta, 1) of length ``n`` and ``params`` sizes p >= 0, s.t. ``forms``.

    ``repeated`` holds the indices of the forms of repeated blocks. ``boxed`` holds the sizes that depend on
    one repeated block only. The box of this block bounds such a size, so the size needs no separate
    direction.
    """

    def __init__(self, forms: Sequence[Form], params: int, n: int):
        self.forms, self.params, self.n = list(forms), params, n
        self.repeated = [k for k, f in enumerate(self.forms) if f.repeated]
        users = [f.param for f in self.forms]
        self.boxed = {self.forms[k].param for k in self.repeated if users.count(self.forms[k].param) == 1} - {
            -1
        }

    def origin(self) -> np.ndarray:
        """The point theta = 0, (n,)."""
        return np.append(np.zeros(self.n - 1, dtype=complex), 1.0)

    def scalar(self, k: int, z: np.ndarray) -> complex:
        """Scalar of repeated form ``k`` that maps b z best to a z.

        It is real for a real block, and 0 for b z = 0.
        """
        f = self.forms[k]
        xi, eta = f.a @ z, f.b @ z
        power = np.vdot(eta, eta).real
        d = np.vdot(eta, xi) / power if power > 0.0 else 0.0
        return d.real if f.repeated == "repeated_real" else d

    def cost(self, z: np.ndarray) -> float:
        """Sum of the least sizes for ``z`` (n,), or inf where ``z`` violates a constraint without a size."""
        p = np.zeros(self.params)
        for f in self.forms:
            a, b = np.linalg.norm(f.a @ z) ** 2, f.slope * np.linalg.norm(f.b @ z) ** 2
            if f.param < 0:
                if np.isfinite(f.constant) and a > f.constant * b * (1.0 + 1e-9):
                    return np.inf
            elif a > 0.0:
                p[f.param] = max(p[f.param], a / b - f.constant if b > 0.0 else np.inf)
        return float(np.sum(p))

    def on_subspace(
        self, z: np.ndarray, deltas: dict[int, complex]
    ) -> tuple[np.ndarray, np.ndarray | None] | None:
        """Project ``z`` on the constraints a z = delta b z.

        Returns also a basis (n - 1, m) of the free directions.

        ``deltas`` maps the index of a repeated form to its scalar. The basis is None without repeated forms,
        because all directions are free. The result is None if the constraints have no solution.
        """
        if not deltas:
            return z, None
        # The rows of each block are scaled separately, because sizes of blocks may differ by 1e10.
        scaled, sizes = [], []
        for k, d in deltas.items():
            f = self.forms[k]
            unit = (np.linalg.norm(f.a) + abs(d) * np.linalg.norm(f.b)) or 1.0
            scaled.append((f.a - d * f.b) / unit)
            sizes.append((np.abs(f.a) + abs(d) * np.abs(f.b)) / unit)  # a and d b may cancel
        rows, terms = np.vstack(scaled), np.vstack(sizes)
        left, right = rows[:, :-1], -rows[:, -1]
        fix, *_ = np.linalg.lstsq(left, right - left @ z[:-1], rcond=RANK_TOLERANCE)
        z = np.append(z[:-1] + fix, 1.0)
        if np.linalg.norm(rows @ z) > 1e-9 * np.linalg.norm(terms @ np.abs(z)):
            return None
        _, s, vh = np.linalg.svd(left)
        rank = int(np.sum(s > RANK_TOLERANCE * s.max(initial=0.0)))
        return z, vh[rank:].conj().T

    def repair(self, z: np.ndarray) -> np.ndarray | None:
        """A point near ``z`` (n,) that satisfies the constraints without a size exactly, or None."""
        projected = self.on_subspace(z, {k: self.scalar(k, z) for k in self.repeated})
        if projected is None:
            return None
        z, null = projected
        fixed = [f for f in self.forms if f.param < 0 and not f.repeated and np.isfinite(f.constant)]
        for f in fixed:
            # A constraint without a size is a ball, because b z is constant. Move towards its centre.
            limit = f.constant * f.slope * np.linalg.norm(f.b @ z) ** 2
            if np.linalg.norm(f.a @ z) ** 2 <= limit * (1.0 + 1e-12):
                continue
            basis = np.eye(len(z) - 1, dtype=complex) if null is None else null
            step, *_ = np.linalg.lstsq(f.a[:, :-1] @ basis, -(f.a @ z), rcond=RANK_TOLERANCE)
            move = np.append(basis @ step, 0.0)
            v, d = f.a @ z, f.a @ move
            # |v + tau d|^2 = limit, smaller root
            qa, qb, qc = np.vdot(d, d).real, np.vdot(v, d).real, np.vdot(v, v).real - limit
            disc = qb * qb - qa * qc
            if qa == 0.0 or disc < -1e-9 * qb * qb:
                return None
            z = z + (qc / (-qb + np.sqrt(max(disc, 0.0)))) * move
        return z

    def inside(self, deltas: dict[int, complex]) -> tuple[float, np.ndarray | None]:
        """The ratio and the point z with a z = delta b z that violates the constraints least.

        Only constraints without a size count. ``deltas`` is that of :meth:`on_subspace`. A point with a ratio
        of at most 1 is inside. The ratio is inf and z is None if no point has these scalars.
        """
        projected = self.on_subspace(self.origin(), deltas)
        if projected is None:
            return np.inf, None
        z, null = projected
        fixed = [f for f in self.forms if f.param < 0 and not f.repeated]
        if not fixed:
            return 0.0, z
        if null is None:
            null = np.eye(len(z) - 1, dtype=complex)
        left = np.vstack([f.a[:, :-1] @ null / np.sqrt(f.constant * f.slope) for f in fixed])
        right = np.concatenate([f.a @ z / np.sqrt(f.constant * f.slope) for f in fixed])
        step, *_ = np.linalg.lstsq(left, -right, rcond=RANK_TOLERANCE)
        z = z + np.append(null @ step, 0.0)
        return max(
            float(np.linalg.norm(f.a @ z) / np.sqrt(f.constant * f.slope) / np.linalg.norm(f.b @ z))
            for f in fixed
        ), z

    def zero(self) -> np.ndarray | None:
        """A point (n,) with all sizes zero, which makes the optimum exactly zero, or None."""
        if any(f.repeated and f.param < 0 for f in self.forms):
            return None
        # Each signal is scaled separately. xi and w, or their weights, may differ by 1e14, and the smaller
        # one must not be lost in the rounding of the larger.
        kernels = [
            a / (np.linalg.norm(a) or 1.0) for f in self.forms if f.param >= 0 for a in f.parts or (f.a,)
        ]
        rows = np.vstack([np.zeros((0, self.n)), *kernels])
        left = rows[:, :-1]
        theta, *_ = np.linalg.lstsq(left, -rows[:, -1], rcond=RANK_TOLERANCE)
        z = np.append(theta, 1.0)
        _, s, vh = np.linalg.svd(left)
        null = vh[int(np.sum(s > RANK_TOLERANCE * s.max(initial=0.0))) :].conj().T
        fixed = [f for f in self.forms if f.param < 0]
        for f in fixed:
            step, *_ = np.linalg.lstsq(f.a[:, :-1] @ null, -(f.a @ z), rcond=RANK_TOLERANCE)
            z = z + np.append(null @ step, 0.0)
        if not all(cancels(a, z) for a in kernels):
            return None
        inside = all(
            np.linalg.norm(f.a @ z) ** 2 <= f.constant * f.slope * np.linalg.norm(f.b @ z) ** 2 for f in fixed
        )
        return z if inside else None
