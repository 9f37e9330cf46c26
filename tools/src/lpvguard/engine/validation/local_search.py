"""Find feasible points of the quadratic problem: improve points locally, and find first ones with repeated
blocks."""

import numpy as np
from scipy.optimize import minimize

from lpvguard.engine.validation.quadratic import Quadratic

SAMPLES = 150
"""Number of random scalars of repeated blocks in the search for a first feasible point."""

MAX_POLISHED = 6
"""Each of the first relaxed solutions gets a local search; later ones get it only if they are better."""


class _Smooth:
    """The quadratic problem as a smooth problem: min sum_j p_j over real unknowns v, with exact derivatives.

    v = (Re theta, Im theta, p divided by their first sum, Re and Im of each repeated block's scalar). The
    constraints are scaled by their values at the starting point ``z`` (n,).
    """

    def __init__(self, problem: Quadratic, z: np.ndarray):
        self.forms, self.repeated, self.params = problem.forms, problem.repeated, problem.params
        self.d = d = len(z) - 1
        scalars = [
            np.vdot(self.forms[k].b @ z, self.forms[k].a @ z)
            / max(float(np.linalg.norm(self.forms[k].b @ z) ** 2), 1e-300)
            for k in self.repeated
        ]
        sizes = np.zeros(self.params)
        for f in self.forms:
            if f.param >= 0:
                a, b = np.linalg.norm(f.a @ z) ** 2, f.slope * np.linalg.norm(f.b @ z) ** 2
                sizes[f.param] = max(sizes[f.param], min(a / max(float(b), 1e-300) - f.constant, 1e6))
        self.p_scale = max(float(sizes.sum()), 1e-12)
        self.index = {k: i for i, k in enumerate(self.repeated)}
        self.bounded = [(k, f) for k, f in enumerate(self.forms) if np.isfinite(f.constant)]
        self.norms = {
            k: max(float(np.linalg.norm(f.a @ z) ** 2), float(1e-6 * np.linalg.norm(f.a) ** 2))
            for k, f in self.bounded
        }
        self.first = np.concatenate(
            [z[:-1].real, z[:-1].imag, sizes / self.p_scale, [x for c in scalars for x in (c.real, c.imag)]]
        )
        self.gradient = np.zeros(len(self.first))
        self.gradient[2 * d : 2 * d + self.params] = 1.0
        self.bounds = (
            [(None, None)] * (2 * d) + [(0.0, None)] * self.params + [(None, None)] * (2 * len(self.repeated))
        )

    def unpack(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[complex]]:
        """z (n,), the sizes (params,) and the repeated blocks' scalars."""
        d = self.d
        z = np.append(v[:d] + 1j * v[d : 2 * d], 1.0)
        p = v[2 * d : 2 * d + self.params] * self.p_scale
        s = v[2 * d + self.params :]
        return z, p, [complex(s[2 * i], s[2 * i + 1]) for i in range(len(self.repeated))]

    def inequality(self, v: np.ndarray) -> np.ndarray:
        """Values that are >= 0 if every form with a finite constant is satisfied."""
        z, p, s = self.unpack(v)
        out: list[float | np.floating] = []
        for k, f in self.bounded:
            size = f.constant + (p[f.param] if f.param >= 0 else 0.0)
            if f.repeated:
                out.append((size * f.slope - abs(s[self.index[k]]) ** 2) / self.p_scale)
            else:
                out.append(
                    (size * f.slope * np.linalg.norm(f.b @ z) ** 2 - np.linalg.norm(f.a @ z) ** 2)
                    / self.norms[k]
                )
        return np.array(out)

    def inequality_jacobian(self, v: np.ndarray) -> np.ndarray:
        """Derivative of :meth:`inequality`, one row per form."""
        d, (z, p, s) = self.d, self.unpack(v)
        out = np.zeros((len(self.bounded), len(v)))
        for row, (k, f) in enumerate(self.bounded):
            size = f.constant + (p[f.param] if f.param >= 0 else 0.0)
            if f.repeated:
                at, scalar = 2 * d + self.params + 2 * self.index[k], s[self.index[k]]
                out[row, at : at + 2] = (-2.0 * scalar.real / self.p_scale, -2.0 * scalar.imag / self.p_scale)
                if f.param >= 0:
                    out[row, 2 * d + f.param] = f.slope
                continue
            bz, az = f.b @ z, f.a @ z
            g = (
                2.0
                * (size * f.slope * (f.b[:, :-1].conj().T @ bz) - f.a[:, :-1].conj().T @ az)
                / self.norms[k]
            )
            out[row, :d], out[row, d : 2 * d] = g.real, g.imag
            if f.param >= 0:
                out[row, 2 * d + f.param] = f.slope * np.linalg.norm(bz) ** 2 * self.p_scale / self.norms[k]
        return out

    def equality(self, v: np.ndarray) -> np.ndarray:
        """Values that are zero if a z = delta b z for every repeated block (delta real for a real one)."""
        z, _, s = self.unpack(v)
        rest = np.concatenate(
            [self.forms[k].a @ z - s[i] * (self.forms[k].b @ z) for i, k in enumerate(self.repeated)]
        )
        real = [s[i].imag for i, k in enumerate(self.repeated) if self.forms[k].repeated == "repeated_real"]
        return np.concatenate([rest.real, rest.imag, real])

    def equality_jacobian(self, v: np.ndarray) -> np.ndarray:
        """Derivative of :meth:`equality`."""
        d, (z, _, s) = self.d, self.unpack(v)
        rows, real = [], []
        for i, k in enumerate(self.repeated):
            f = self.forms[k]
            row = np.zeros((f.a.shape[0], len(v)), dtype=complex)
            linear = f.a[:, :-1] - s[i] * f.b[:, :-1]
            row[:, :d], row[:, d : 2 * d] = linear, 1j * linear
            at = 2 * d + self.params + 2 * i
            row[:, at], row[:, at + 1] = -(f.b @ z), -1j * (f.b @ z)
            rows.append(row)
            if f.repeated == "repeated_real":
                one = np.zeros(len(v))
                one[at + 1] = 1.0
                real.append(one)
        stacked = np.vstack(rows)
        return np.vstack([stacked.real, stacked.imag, *real])


def polish(problem: Quadratic, z: np.ndarray) -> np.ndarray | None:
    """Improve a starting point ``z`` (n,) by SLSQP over theta, the sizes and the repeated scalars.

    The result need not be feasible; it is None if it is not finite.
    """
    smooth = _Smooth(problem, z)
    constraints = [{"type": "ineq", "fun": smooth.inequality, "jac": smooth.inequality_jacobian}]
    if problem.repeated:
        constraints.append({"type": "eq", "fun": smooth.equality, "jac": smooth.equality_jacobian})
    with np.errstate(all="ignore"):
        done = minimize(
            lambda v: float(smooth.gradient @ v),
            smooth.first,
            jac=lambda v: smooth.gradient,
            bounds=smooth.bounds,
            constraints=constraints,
            method="SLSQP",
            options={"maxiter": 200, "ftol": 1e-10},
        )
    return smooth.unpack(done.x)[0] if np.all(np.isfinite(done.x)) else None


def repeated_starts(problem: Quadratic) -> list[np.ndarray]:
    """Find points (n,) that fulfil the constraints without a size, for problems with repeated blocks.

    Random scalars of the blocks are drawn first, and a descent improves the best draws. The largest draw is a
    few times a reference size, at which the constant input of the block gives the scale of its output. The
    seed is fixed.
    """
    if not problem.repeated:
        return []
    generator = np.random.default_rng(0)
    bounds = []
    for k in problem.repeated:
        f = problem.forms[k]
        bottom = np.linalg.norm(f.b[:, -1])
        bounds.append(4.0 * np.linalg.norm(f.a) / bottom if bottom > 0.0 else 1.0)
    real = [problem.forms[k].repeated == "repeated_real" for k in problem.repeated]

    def scalars(v: np.ndarray) -> dict[int, complex]:
        return {
            k: complex(v[2 * i], 0.0 if real[i] else v[2 * i + 1]) for i, k in enumerate(problem.repeated)
        }

    def violation(v: np.ndarray) -> float:
        return problem.inside(scalars(v))[0]

    draws = []
    for _ in range(SAMPLES):
        size = np.array(bounds) * 10.0 ** generator.uniform(-3.0, 0.0, len(bounds))
        phase = np.where(
            real,
            generator.choice([-1.0, 1.0], len(bounds)),
            np.exp(2j * np.pi * generator.uniform(size=len(bounds))),
        )
        point = size * phase
        v = np.column_stack([point.real, point.imag]).ravel()
        draws.append((violation(v), tuple(v)))
    draws.sort()
    starts = []
    for level, drawn in draws[:MAX_POLISHED]:
        v = np.array(drawn)
        if level > 1.0:
            v = minimize(
                lambda x: max(violation(x), 1.0 - 1e-9),
                v,
                method="Nelder-Mead",
                options={"maxfev": 100 * v.size, "xatol": 0.0, "fatol": 0.0},
            ).x
        level, z = problem.inside(scalars(v))
        if z is not None and level <= 1.0 + 1e-9:
            starts.append(z)
    return starts
