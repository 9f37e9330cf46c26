"""Section II of the paper in general: the smallest perturbation sizes and disturbance that explain one
frequency point.

    eta = P11 xi + P12 w + eta0 (= P13 u),   e = P21 xi + P22 w,   xi_i = Delta_i eta_i

with full complex, repeated complex and repeated real blocks (Lim). Every solution of the second equation is
``x = maps @ (phi, psi, 1)`` with phi = U1^* w free inside the ball (5) and psi free altogether
(:func:`parametrise`). What remains is a quadratic problem that is not convex. Its optimum is bounded from
below by the S-procedure (``lmi``) inside a branch and bound over the sizes (cones of directions) and the
scalars of repeated blocks (boxes), and from above by a feasible point that a local method improves: exact for
one or two full blocks beside a disturbance ball, an interval otherwise. Both sides are returned.

Two facts make the branch and bound short. A certificate y found at sizes p stays valid for every p' with
sum_j y_j Q_j(p') >= 0: a convex set that contains [0, p], so that a cone of directions is bounded at its
edges with an error of second order in its angle (Tuy). And a certificate is an eigenvalue problem in the
length along a ray, so each multiplier vector is used up to the largest length that it proves (Dinkelbach).
With the scalars of repeated blocks as linear constraints a certificate is affine in them too, so that a box
is bounded at its corners, again with an error of second order (:meth:`_Quadratic.tangent`).
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from lpvguard.base.errors import InputError
from lpvguard.engine.blocks import Block
from lpvguard.engine.validation import lmi, s2
from lpvguard.engine.validation.delta import Verification, least_size, split, verify

RANK_TOLERANCE = 1e-10
"""Singular values below this fraction of the largest count as zero (columns scaled to a common size)."""

IMAGE_TOLERANCE = 1e-8
"""e is in Im M when what M cannot produce is below this fraction of |e|."""

EDGE = 1e-9
"""gamma_w within this of B1, relative, counts as B1."""

ROUNDING = 1e-14
"""Rounding of B1 relative to |e|."""

CANCELLED = 1e-12
"""A signal below this fraction of the terms that it is the sum of is their rounding."""

GAP = 1e-4
"""Relative distance of the two sides at which the branch and bound stops."""

ZERO = 1e-12
"""A squared size below this fraction of that of the first point found counts as zero where zero is
attainable."""

MAX_NODES = 5000

COSTLY = 24
"""Multipliers of repeated blocks from which the relaxation is used sparingly."""

PENALTIES = 10.0 ** np.arange(-2.0, 5.0)
"""Weights of |A z|^2 beside the certificate's norm that :meth:`_Quadratic.tangent` tries."""

SAMPLES = 150
"""Draws of the scalars of repeated blocks when looking for a first feasible point."""

MAX_POLISHED = 6
"""Local searches from relaxed solutions before only improvements get one."""


@dataclass(frozen=True)
class Lft:
    """One frequency point of (1). Shapes: P11 (q, p), P12 (q, n_w), P21 (n_y, p), P22 (n_y, n_w), eta0 (q,),
    e (n_y,); p and q are the sums of the blocks' rows and cols."""

    blocks: tuple[Block, ...]
    p11: np.ndarray
    p12: np.ndarray
    p21: np.ndarray
    p22: np.ndarray
    eta0: np.ndarray
    e: np.ndarray
    source: str = "lft"

    def __post_init__(self):
        p, q = sum(b.rows for b in self.blocks), sum(b.cols for b in self.blocks)
        n_y, n_w = self.e.shape[0], self.p22.shape[-1]
        if not self.blocks or n_y == 0:
            raise InputError(self.source, "blocks, e", "empty", "at least one block and one output")
        wanted = {
            "p11": (q, p),
            "p12": (q, n_w),
            "p21": (n_y, p),
            "p22": (n_y, n_w),
            "eta0": (q,),
            "e": (n_y,),
        }
        for name, shape in wanted.items():
            a = getattr(self, name)
            if a.shape != shape:
                raise InputError(
                    self.source, name, f"shape {a.shape}", f"{shape} to fit the blocks, e and P22"
                )
            if not np.all(np.isfinite(a)):
                raise InputError(self.source, name, "a value that is not finite", "finite numbers")

    @property
    def matrices(self) -> dict[str, np.ndarray]:
        """The matrices under the names that :func:`delta.verify` uses."""
        return {"P11": self.p11, "P12": self.p12, "P21": self.p21, "P22": self.p22, "eta0": self.eta0}


@dataclass(frozen=True)
class Parametrisation:
    """All (xi, w) that satisfy (4): ``xi = xi_map @ z``, ``w = w_map @ z``, ``eta = eta_map @ z``, z = (phi,
    psi, 1).

    ``b1`` is the right side of (9), the norm of the smallest disturbance; phi = 0 attains it.
    """

    xi_map: np.ndarray
    w_map: np.ndarray
    eta_map: np.ndarray
    n_phi: int
    b1: float


def parametrise(problem: Lft) -> Parametrisation:
    """The SVD parametrisation (5)-(7). Raises InputError when e is not in Im M, M = [P21 P22]: the structure
    fails.

    The columns of M are scaled to a common size first, one factor for all of w, so that |w| keeps its
    meaning: a model in other units has the same solutions but may have M's with a condition number of 1e10.
    """
    m = np.hstack([problem.p21, problem.p22])
    p, norm_e = problem.p21.shape[1], np.linalg.norm(problem.e)
    scale = np.ones(m.shape[1])
    for columns in [
        *np.split(np.arange(p), np.cumsum([b.rows for b in problem.blocks])[:-1]),
        np.arange(p, m.shape[1]),
    ]:
        size = np.linalg.norm(m[:, columns])
        scale[columns] = 1.0 / size if size > 0.0 else 1.0
    u, s, vh = np.linalg.svd(m * scale)
    rank = int(np.sum(s > RANK_TOLERANCE * s[0])) if s.size else 0
    outside = np.linalg.norm(u[:, rank:].conj().T @ problem.e)
    if outside > IMAGE_TOLERANCE * norm_e:
        raise InputError(
            problem.source,
            "e",
            f"not in Im [P21 P22]: {outside:.3g} of |e| = {norm_e:.3g} cannot be produced",
            "a structure that can produce e, for example P22 = I",
        )
    particular = scale * (vh[:rank].conj().T @ ((u[:, :rank].conj().T @ problem.e) / s[:rank]))
    null = scale[:, None] * vh[rank:].conj().T
    w_p, n_w = particular[p:], null[p:]
    u_w, s_w, vh_w = np.linalg.svd(n_w)
    n_phi = int(np.sum(s_w > RANK_TOLERANCE * s_w[0])) if s_w.size else 0
    u1, v1, v2 = u_w[:, :n_phi], vh_w[:n_phi].conj().T, vh_w[n_phi:].conj().T
    w_min = w_p - u1 @ (u1.conj().T @ w_p)
    per_phi = null[:p] @ (v1 / s_w[:n_phi])
    xi_0 = particular[:p] - per_phi @ (u1.conj().T @ w_p)
    xi_map = np.column_stack([per_phi, null[:p] @ v2, xi_0])
    w_map = np.column_stack([u1, np.zeros((n_w.shape[0], v2.shape[1])), w_min])
    eta_map = problem.p11 @ xi_map + problem.p12 @ w_map
    eta_map[:, -1] += problem.eta0
    return Parametrisation(xi_map, w_map, eta_map, n_phi, float(np.linalg.norm(w_min)))


# --- the nonconvex quadratic problem


@dataclass(frozen=True)
class _Form:
    """|a z|^2 <= (constant + sizes[param]) slope |b z|^2, and for a repeated block a z = delta b z as well.

    ``param`` -1: the constant alone; inf when a repeated block has no bound (its own cap is infinite).
    ``parts``: the signals that a is stacked from, when there are several.
    """

    a: np.ndarray
    b: np.ndarray
    constant: float = 0.0
    param: int = -1
    slope: float = 1.0
    repeated: str | None = None
    parts: tuple[np.ndarray, ...] = ()


@dataclass(frozen=True)
class _Box:
    """Closed box of a repeated block's scalar: real interval, or rectangle of the complex plane."""

    low: complex
    high: complex

    @property
    def centre(self) -> complex:
        return 0.5 * (self.low + self.high)

    @property
    def radius(self) -> float:
        return 0.5 * abs(self.high - self.low)

    @property
    def least(self) -> float:
        """Smallest modulus in the box."""
        d = self.high - self.low
        c = self.centre
        return float(np.hypot(max(abs(c.real) - 0.5 * d.real, 0.0), max(abs(c.imag) - 0.5 * d.imag, 0.0)))

    @property
    def most(self) -> float:
        """Largest modulus in the box."""
        return max(abs(self.low), abs(self.high), abs(complex(self.low.real, self.high.imag)))

    @property
    def corners(self) -> list[complex]:
        """Two ends of an interval, four corners of a rectangle."""
        low, high = self.low, self.high
        ends = [low, complex(high.real, low.imag), complex(low.real, high.imag), high]
        return list(dict.fromkeys(ends))

    def halves(self) -> tuple[_Box, _Box]:
        d = self.high - self.low
        cut = 0.5 * d.real if d.real >= d.imag else 0.5j * d.imag
        return _Box(self.low, self.high - cut), _Box(self.low + cut, self.high)


def _cancels(a: np.ndarray, z: np.ndarray) -> bool:
    """True when a @ z is zero up to the rounding of its own terms."""
    return bool(np.linalg.norm(a @ z) <= CANCELLED * np.linalg.norm(np.abs(a) @ np.abs(z)))


def _gram(left: np.ndarray, right: np.ndarray, basis: np.ndarray | None) -> np.ndarray:
    """left^* B right for each B of ``basis`` (m, r, r), m forms; None: the identity alone."""
    if basis is None:
        return (left.conj().T @ right)[None]
    return np.einsum("ia,kij,jb->kab", left.conj(), basis, right)


@dataclass
class _Best:
    cost: float = np.inf
    z: np.ndarray | None = None


@dataclass(order=True)
class _Node:
    lower: float
    serial: int
    rays: np.ndarray = field(compare=False)
    boxes: dict[int, _Box] = field(compare=False)
    small: bool = field(compare=False, default=False)
    """The tangent's bound was the better one at the parent."""


@dataclass(frozen=True)
class _Tangent:
    """Bounds of :meth:`_Quadratic.tangent`: ``lower`` over the node; at the boxes' centre on the central ray,
    over the corners there (``box``), over the rays there (``cone``); primal matrix or None."""

    lower: float
    centre: float
    box: float
    cone: float
    inverse: np.ndarray | None


@dataclass(frozen=True)
class Interval:
    """Two-sided answer: ``lower`` is certified, ``upper`` attained at ``z``."""

    lower: float
    upper: float
    z: np.ndarray | None
    nodes: int


class _Quadratic:
    """min sum_j p_j over z = (theta, 1) of length ``n`` and p >= 0 (``params`` of them) subject to
    :class:`_Form` s."""

    def __init__(self, forms: Sequence[_Form], params: int, n: int):
        self.forms, self.params, self._n = list(forms), params, n
        self.repeated = [k for k, f in enumerate(self.forms) if f.repeated]
        users = [f.param for f in self.forms]
        # A size that one repeated block alone decides: its box bounds it, so it needs no direction of its
        # own.
        self._boxed = {
            self.forms[k].param for k in self.repeated if users.count(self.forms[k].param) == 1
        } - {-1}
        self._first_boxes: dict[int, _Box] = {}
        # A Newton step takes the cube of the number of multipliers: with two larger blocks the relaxation
        # costs fifty times the tangent's, and is left out where that was the better bound.
        self._costly = (
            sum((3 if f.repeated == "repeated_real" else 2) * len(f.a) ** 2 for f in self.forms if f.repeated)
            > COSTLY
        )
        plain = [k for k, f in enumerate(self.forms) if not f.repeated and np.isfinite(f.constant)]
        self._plain = self._certificate_forms({}, plain) if plain else None

    # -- certificates

    def _certificate_forms(self, boxes: dict[int, _Box], only: Sequence[int] | None = None):
        """Generators Q0 (m, n, n), level part G (m, n, n) with the parameter of each, and the multiplier
        cone; of all forms or of those in ``only``."""
        q0, level, param, groups = [], [], [], []

        def add(kind, order, zero, slope_part, index):
            size = max(float(np.max(np.abs(zero))), 1e-300)
            q0.extend(zero / size)
            level.extend(slope_part / size)
            param.extend([index] * len(zero))
            groups.append((kind, order))

        for k in range(len(self.forms)) if only is None else only:
            f = self.forms[k]
            r = f.a.shape[0] if f.repeated else 1
            basis = lmi.hermitian_basis(r) if f.repeated else None

            if k in boxes and f.param in self._boxed:
                aa, bb = _gram(f.a, f.a, basis), _gram(f.b, f.b, basis)
                add("psd", r, aa - boxes[k].most ** 2 * bb, 0.0 * bb, -1)
            elif np.isfinite(f.constant):
                aa, bb = _gram(f.a, f.a, basis), f.slope * _gram(f.b, f.b, basis)
                add("psd", r, aa - f.constant * bb, bb if f.param >= 0 else 0.0 * bb, f.param)
            if f.repeated == "repeated_real":
                cross = 1j * _gram(f.a, f.b, basis)
                add("free", r, cross + cross.conj().transpose(0, 2, 1), 0.0 * cross, -1)
            if k in boxes:
                box = boxes[k]
                d, bb = f.a - box.centre * f.b, _gram(f.b, f.b, basis)
                add("psd", r, _gram(d, d, basis) - box.radius**2 * bb, 0.0 * bb, -1)
        return np.array(q0), np.array(level), np.array(param), lmi.cone(groups)

    def lower(self, node: _Node, cutoff: float):
        """Certified lower bound over a node: (bound, bound on the central ray, primal directions)."""
        q0, level, param, cone = self._certificate_forms(node.boxes) if self.repeated else self._plain
        base = self._box_bound(node, self._boxed)
        weight = np.append(node.rays.mean(axis=0), 0.0)
        length, y, inverse = lmi.ray_length(
            q0, level * weight[param][:, None, None], cone, max(cutoff - base, 0.0)
        )
        edges = 0.0
        if y is not None:
            rays = np.column_stack([node.rays, np.zeros(len(node.rays))])
            slopes = np.tensordot(rays[:, param] * y, level, axes=1)
            edges = float(np.min(lmi.reach(np.tensordot(y, q0, axes=1), slopes, lmi.rounding(y, q0))))
        return base + edges, base + length, inverse

    def tangent(self, node: _Node, cutoff: float) -> _Tangent | None:
        """Second bound over a node with boxes, whose error is of second order in their size; None without
        one.

        At the boxes' centre c the repeated blocks are linear constraints, A(c) z = 0 with rows a - c b, and
        the others give multipliers y on its kernel. Finsler: some Y makes the certificate Q(y, p) + Y^* A(c)
        + A(c)^* Y positive on the whole space. With the same y and Y it is affine in the scalars and the
        sizes, so that it holds over the box when it holds at its corners, and |delta|^2 lies above its
        tangent at c. Y's part outside the kernel is free: a ladder of penalties on |A z|^2 is tried and the
        best corner bound kept.
        """
        if self._plain is None or not node.boxes:
            return None
        q0, level, param, cone = self._plain
        keys = list(node.boxes)
        centre = np.array([node.boxes[k].centre for k in keys])
        unit = [
            1.0 / (np.linalg.norm(self.forms[k].a) + abs(c) * np.linalg.norm(self.forms[k].b))
            for k, c in zip(keys, centre, strict=True)
        ]

        def rows(scalars):
            return np.vstack(
                [
                    u * (self.forms[k].a - d * self.forms[k].b)
                    for u, k, d in zip(unit, keys, scalars, strict=True)
                ]
            )

        def base(scalars):
            known = [i for i, k in enumerate(keys) if self.forms[k].param in self._boxed]
            return sum(
                (2.0 * (centre[i].conjugate() * scalars[i]).real - abs(centre[i]) ** 2)
                / self.forms[keys[i]].slope
                for i in known
            )

        left, s, vh = np.linalg.svd(rows(centre))
        rank = int(np.sum(s > RANK_TOLERANCE * s[0]))
        normal, kernel = vh[:rank].conj().T, vh[rank:].conj().T
        rays = np.vstack([node.rays.mean(axis=0), node.rays])
        rays = np.column_stack([rays, np.zeros(len(rays))])[:, param]
        at_centre = base(centre)
        inverse, length = None, 0.0
        if kernel.shape[1]:
            reduced = [kernel.conj().T @ m @ kernel for m in (q0, level * rays[0][:, None, None])]
            length, y, inverse = lmi.ray_length(*reduced, cone, max(cutoff - at_centre, 0.0))
            if y is None:
                return None
            inverse = kernel @ inverse @ kernel.conj().T
        else:
            y = cone.normal / cone.normal.sum()
        zero, slopes = np.tensordot(y, q0, axes=1), np.tensordot(rays * y, level, axes=1)
        at = zero - (length if np.isfinite(length) else 0.0) * slopes[0]
        outside = normal.conj().T @ at @ normal
        # Y^* = lift @ pinv(A N); lift makes the certificate block diagonal: ``at`` on the kernel, the penalty
        # outside.
        to_rows = (left[:, :rank] / s[:rank]).conj().T
        penalties = np.linalg.norm(at) * PENALTIES
        cross = -kernel @ (kernel.conj().T @ at @ normal)
        lifts = cross + 0.5 * normal @ (penalties[:, None, None] * np.diag(s[:rank] ** 2) - outside)
        duals = lifts @ to_rows
        corners = [np.array(c) for c in itertools.product(*(node.boxes[k].corners for k in keys))]
        terms = np.stack([duals @ rows(scalars) for scalars in [centre, *corners]])
        errors = lmi.rounding(y, q0) + 8.0 * len(zero) * np.finfo(float).eps * np.linalg.norm(
            duals, axis=(1, 2)
        )
        lengths = lmi.reaches(
            zero + terms + terms.conj().swapaxes(-1, -2), slopes, np.broadcast_to(errors, terms.shape[:2])
        )
        # (1 + corners, penalties, 1 + rays)
        bounds = lengths + np.array([base(scalars) for scalars in [centre, *corners]])[:, None, None]
        kept = int(np.argmax(bounds[1:, :, 1:].min(axis=(0, 2))))
        return _Tangent(
            float(bounds[1:, kept, 1:].min()),
            at_centre + length,
            float(bounds[1:, kept, 0].min()),
            float(bounds[0, kept, 1:].min()),
            inverse,
        )

    # -- feasible points

    def cost(self, z: np.ndarray) -> float:
        """sum of the least sizes that z needs; inf outside the constant constraints."""
        p = np.zeros(self.params)
        for f in self.forms:
            a, b = np.linalg.norm(f.a @ z) ** 2, f.slope * np.linalg.norm(f.b @ z) ** 2
            if f.param < 0:
                if np.isfinite(f.constant) and a > f.constant * b * (1.0 + 1e-9):
                    return np.inf
            elif a > 0.0:
                p[f.param] = max(p[f.param], a / b - f.constant if b > 0.0 else np.inf)
        return float(np.sum(np.maximum(p, 0.0)))

    def _on_subspace(self, z: np.ndarray, deltas: dict[int, complex]):
        """Project z on the linear constraints a z = delta b z; None when they have no solution."""
        if not deltas:
            return z, None
        # Rows of a block in units of its own: sizes of blocks may be 1e10 apart.
        rows, terms = [], []
        for k, d in deltas.items():
            f = self.forms[k]
            unit = (np.linalg.norm(f.a) + abs(d) * np.linalg.norm(f.b)) or 1.0
            rows.append((f.a - d * f.b) / unit)
            terms.append((np.abs(f.a) + abs(d) * np.abs(f.b)) / unit)  # a and d b may cancel
        rows, terms = np.vstack(rows), np.vstack(terms)
        left, right = rows[:, :-1], -rows[:, -1]
        fix, *_ = np.linalg.lstsq(left, right - left @ z[:-1], rcond=RANK_TOLERANCE)
        z = np.append(z[:-1] + fix, 1.0)
        if np.linalg.norm(rows @ z) > 1e-9 * np.linalg.norm(terms @ np.abs(z)):
            return None, None
        _, s, vh = np.linalg.svd(left)
        rank = int(np.sum(s > RANK_TOLERANCE * s.max(initial=0.0)))
        return z, vh[rank:].conj().T

    def repair(self, z: np.ndarray) -> np.ndarray | None:
        """Nearby point that satisfies the constant constraints exactly, or None."""
        deltas = {}
        for k in self.repeated:
            f = self.forms[k]
            xi, eta = f.a @ z, f.b @ z
            power = np.vdot(eta, eta).real
            d = np.vdot(eta, xi) / power if power > 0.0 else 0.0
            deltas[k] = d.real if f.repeated == "repeated_real" else d
        z, null = self._on_subspace(z, deltas)
        if z is None:
            return None
        fixed = [f for f in self.forms if f.param < 0 and not f.repeated and np.isfinite(f.constant)]
        for f in fixed:
            # A constant constraint is a ball, its b z the same for all theta: shrink towards its centre.
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

    def polish(self, z: np.ndarray) -> np.ndarray | None:
        """Local improvement of a starting point (SLSQP on theta, the sizes and the repeated scalars)."""
        d, reps = len(z) - 1, self.repeated
        scalars = [
            np.vdot(self.forms[k].b @ z, self.forms[k].a @ z)
            / max(np.linalg.norm(self.forms[k].b @ z) ** 2, 1e-300)
            for k in reps
        ]
        p0 = np.zeros(self.params)
        for f in self.forms:
            if f.param >= 0:
                a, b = np.linalg.norm(f.a @ z) ** 2, f.slope * np.linalg.norm(f.b @ z) ** 2
                p0[f.param] = max(p0[f.param], min(a / max(b, 1e-300) - f.constant, 1e6))
        p_scale = max(p0.sum(), 1e-12)
        n_rep = 2 * len(reps)

        def unpack(v):
            zz = np.append(v[:d] + 1j * v[d : 2 * d], 1.0)
            p = v[2 * d : 2 * d + self.params] * p_scale
            s = v[2 * d + self.params :]
            return zz, p, [complex(s[2 * i], s[2 * i + 1]) for i in range(len(reps))]

        index = {k: i for i, k in enumerate(reps)}
        bounded = [(k, f) for k, f in enumerate(self.forms) if np.isfinite(f.constant)]
        norms = {k: max(np.linalg.norm(f.a @ z) ** 2, 1e-6 * np.linalg.norm(f.a) ** 2) for k, f in bounded}

        def inequality(v):
            zz, p, s = unpack(v)
            out = []
            for k, f in bounded:
                size = f.constant + (p[f.param] if f.param >= 0 else 0.0)
                if f.repeated:
                    out.append((size * f.slope - abs(s[index[k]]) ** 2) / p_scale)
                else:
                    out.append(
                        (size * f.slope * np.linalg.norm(f.b @ zz) ** 2 - np.linalg.norm(f.a @ zz) ** 2)
                        / norms[k]
                    )
            return np.array(out)

        def inequality_jac(v):
            zz, p, s = unpack(v)
            out = np.zeros((len(bounded), len(v)))
            for row, (k, f) in enumerate(bounded):
                size = f.constant + (p[f.param] if f.param >= 0 else 0.0)
                if f.repeated:
                    at = 2 * d + self.params + 2 * index[k]
                    out[row, at : at + 2] = (
                        -2.0 * s[index[k]].real / p_scale,
                        -2.0 * s[index[k]].imag / p_scale,
                    )
                    if f.param >= 0:
                        out[row, 2 * d + f.param] = f.slope
                    continue
                bz, az = f.b @ zz, f.a @ zz
                g = (
                    2.0
                    * (size * f.slope * (f.b[:, :-1].conj().T @ bz) - f.a[:, :-1].conj().T @ az)
                    / norms[k]
                )
                out[row, :d], out[row, d : 2 * d] = g.real, g.imag
                if f.param >= 0:
                    out[row, 2 * d + f.param] = f.slope * np.linalg.norm(bz) ** 2 * p_scale / norms[k]
            return out

        def equality(v):
            zz, _, s = unpack(v)
            res = [self.forms[k].a @ zz - s[i] * (self.forms[k].b @ zz) for i, k in enumerate(reps)]
            res = np.concatenate(res)
            real = [s[i].imag for i, k in enumerate(reps) if self.forms[k].repeated == "repeated_real"]
            return np.concatenate([res.real, res.imag, real])

        def equality_jac(v):
            zz, _, s = unpack(v)
            rows, real = [], []
            for i, k in enumerate(reps):
                f = self.forms[k]
                j = np.zeros((f.a.shape[0], len(v)), dtype=complex)
                lin = f.a[:, :-1] - s[i] * f.b[:, :-1]
                j[:, :d], j[:, d : 2 * d] = lin, 1j * lin
                at = 2 * d + self.params + 2 * i
                j[:, at], j[:, at + 1] = -(f.b @ zz), -1j * (f.b @ zz)
                rows.append(j)
                if f.repeated == "repeated_real":
                    one = np.zeros(len(v))
                    one[at + 1] = 1.0
                    real.append(one)
            j = np.vstack(rows)
            return np.vstack([j.real, j.imag, *real])

        v0 = np.concatenate(
            [z[:-1].real, z[:-1].imag, p0 / p_scale, [x for c in scalars for x in (c.real, c.imag)]]
        )
        gradient = np.zeros(len(v0))
        gradient[2 * d : 2 * d + self.params] = 1.0
        bounds = [(None, None)] * (2 * d) + [(0.0, None)] * self.params + [(None, None)] * n_rep
        constraints = [{"type": "ineq", "fun": inequality, "jac": inequality_jac}]
        if reps:
            constraints.append({"type": "eq", "fun": equality, "jac": equality_jac})
        with np.errstate(all="ignore"):
            done = minimize(
                lambda v: float(gradient @ v),
                v0,
                jac=lambda v: gradient,
                bounds=bounds,
                constraints=constraints,
                method="SLSQP",
                options={"maxiter": 200, "ftol": 1e-10},
            )
        return unpack(done.x)[0] if np.all(np.isfinite(done.x)) else None

    def _inside(self, deltas: dict[int, complex]) -> tuple[float, np.ndarray | None]:
        """Point with a z = delta b z that violates the constant constraints least, and how far: ratio <= 1 is
        inside."""
        z, null = self._on_subspace(self._origin(), deltas)
        if z is None:
            return np.inf, None
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

    def _origin(self) -> np.ndarray:
        return np.append(np.zeros(self._n - 1, dtype=complex), 1.0)

    def _repeated_starts(self) -> list[np.ndarray]:
        """Points inside the constant constraints for problems with repeated blocks: sampling, then descent on
        them.

        The scalars are sampled up to a few times the size at which the block, from its constant input,
        reaches the scale of its output.
        """
        if not self.repeated:
            return []
        generator = np.random.default_rng(0)
        bounds = []
        for k in self.repeated:
            f = self.forms[k]
            bottom = np.linalg.norm(f.b[:, -1])
            bounds.append(4.0 * np.linalg.norm(f.a) / bottom if bottom > 0.0 else 1.0)
        real = [self.forms[k].repeated == "repeated_real" for k in self.repeated]

        def scalars(v):
            return {
                k: complex(v[2 * i], 0.0 if real[i] else v[2 * i + 1]) for i, k in enumerate(self.repeated)
            }

        def violation(v):
            return self._inside(scalars(v))[0]

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
        for level, v in draws[:MAX_POLISHED]:
            v = np.array(v)
            if level > 1.0:
                v = minimize(
                    lambda x: max(violation(x), 1.0 - 1e-9),
                    v,
                    method="Nelder-Mead",
                    options={"maxfev": 100 * v.size, "xatol": 0.0, "fatol": 0.0},
                ).x
            level, z = self._inside(scalars(v))
            if level <= 1.0 + 1e-9:
                starts.append(z)
        return starts

    def zero(self) -> np.ndarray | None:
        """A point that needs no size at all, when there is one: the optimum is then exactly zero."""
        if any(f.repeated and f.param < 0 for f in self.forms):
            return None
        # Each signal in units of its own: xi and w may be 1e14 apart, or their weights, and one must not hide
        # in the other's rounding.
        wanted = [
            a / (np.linalg.norm(a) or 1.0) for f in self.forms if f.param >= 0 for a in f.parts or (f.a,)
        ]
        rows = np.vstack([np.zeros((0, self._n)), *wanted])
        left = rows[:, :-1]
        theta, *_ = np.linalg.lstsq(left, -rows[:, -1], rcond=RANK_TOLERANCE)
        z = np.append(theta, 1.0)
        _, s, vh = np.linalg.svd(left)
        null = vh[int(np.sum(s > RANK_TOLERANCE * max(s[0], 1e-300))) if s.size else 0 :].conj().T
        fixed = [f for f in self.forms if f.param < 0]
        for f in fixed:
            step, *_ = np.linalg.lstsq(f.a[:, :-1] @ null, -(f.a @ z), rcond=RANK_TOLERANCE)
            z = z + np.append(null @ step, 0.0)
        if not all(_cancels(a, z) for a in wanted):
            return None
        inside = all(
            np.linalg.norm(f.a @ z) ** 2 <= f.constant * f.slope * np.linalg.norm(f.b @ z) ** 2 for f in fixed
        )
        return z if inside else None

    def _offer(self, z: np.ndarray | None, best: _Best) -> None:
        z = self.repair(z) if z is not None else None
        if z is not None:
            cost = self.cost(z)
            if cost < best.cost:
                best.cost, best.z = cost, z

    def start(self, best: _Best, points: Sequence[np.ndarray]) -> float:
        """Offer the points and what a local search makes of them; the least cost before any search."""
        for z in points:
            self._offer(z, best)
        raw = best.cost
        for z in points:
            self._offer(self.polish(z), best)
        return raw

    def _candidates(self, inverse: np.ndarray) -> list[np.ndarray]:
        """Rank-one readings of the primal matrix: its leading vector, and its column of t."""
        if not np.all(np.isfinite(inverse)):
            return []
        _, vectors = np.linalg.eigh(inverse)
        raw = [inverse[:, -1], vectors[:, -1], vectors[:, -2] if len(vectors) > 1 else vectors[:, -1]]
        return [v / v[-1] for v in raw if abs(v[-1]) > 1e-9 * np.linalg.norm(v)]

    # -- branch and bound

    def solve(
        self,
        gap: float = GAP,
        max_nodes: int = MAX_NODES,
        zero: float = 0.0,
        points: Sequence[np.ndarray] = (),
        enough: float = 0.0,
    ) -> Interval:
        """Both sides of the optimum by best-first branch and bound; the upper side is inf when no point was
        found.

        ``points``: (n,) each, known explanations to begin with. A cost below ``zero`` times that of the first
        point found counts as zero and ends the search. It ends as well once the optimum is known to be at
        most ``enough``, or above it.
        """
        free = self.zero()
        if free is not None:
            return Interval(0.0, 0.0, free, 0)
        best, serial = _Best(), 0
        first = self.start(best, [self._origin(), *points])
        rays = np.eye(self.params)
        open_nodes = [_Node(0.0, serial, rays, {})]
        closed = np.inf
        polished = 0
        while open_nodes and serial < max_nodes:
            node = heapq.heappop(open_nodes)
            decided = enough > 0.0 and (best.cost <= enough or node.lower > enough)
            if decided or node.lower >= best.cost * (1.0 - gap):
                closed = min(closed, node.lower)
                break
            lower = max(node.lower, self._box_bound(node, set(range(self.params))))
            tangent = self.tangent(node, best.cost)
            readings = (
                self._candidates(tangent.inverse)
                if tangent is not None and tangent.inverse is not None
                else []
            )
            lower = max(lower, tangent.lower if tangent is not None else 0.0)
            edges, central = -np.inf, np.inf
            if lower < best.cost * (1.0 - gap) and not (node.small and self._costly):
                edges, central, inverse = self.lower(node, best.cost * (1.0 - gap) * (1.0 + 1e-12))
                lower = max(lower, edges)
                readings += self._candidates(inverse)
            for z in readings if polished < MAX_POLISHED else readings[:1]:
                before = best.cost
                self._offer(z, best)
                if polished < MAX_POLISHED or best.cost < before:
                    polished += 1
                    self._offer(self.polish(z), best)
            if serial == 0 and not np.isfinite(best.cost):
                first = self.start(best, self._repeated_starts())
            first = best.cost if np.isinf(first) else first
            if np.isfinite(first) and best.cost <= zero * first:
                return Interval(0.0, 0.0, best.z, serial + 1)
            if lower >= best.cost * (1.0 - gap):
                closed = min(closed, lower)
                continue
            children = self._branch(node, edges, central, best, tangent)
            if children is None:
                closed = min(closed, lower)
                continue
            small = tangent is not None and tangent.lower > max(edges, node.lower)
            for ray, boxes in children:
                serial += 1
                heapq.heappush(open_nodes, _Node(lower, serial, ray, boxes, small))
        remaining = min((n.lower for n in open_nodes), default=np.inf)
        return Interval(min(closed, remaining, best.cost), best.cost, best.z, serial + 1)

    def _box_bound(self, node: _Node, params: set[int]) -> float:
        """sum of the sizes among ``params`` that the boxes of repeated blocks force."""
        total = np.zeros(self.params)
        for k, box in node.boxes.items():
            f = self.forms[k]
            if f.param in params:
                total[f.param] = max(total[f.param], box.least**2 / f.slope - f.constant)
        return float(total.sum())

    def _branch(self, node: _Node, edges: float, central: float, best: _Best, tangent: _Tangent | None):
        """Two nodes that cover this one: its widest pair of rays cut in the middle, or its widest box; None
        when neither can be."""
        cone_loss, relaxation_loss = central - edges, best.cost - central
        if tangent is not None and tangent.lower > edges:
            cone_loss, relaxation_loss = tangent.centre - tangent.cone, 2.0 * (tangent.centre - tangent.box)
        to_box = self._boxed and not node.boxes and np.isfinite(best.cost)
        if len(node.rays) > 1 and not to_box and (cone_loss >= 0.5 * relaxation_loss or not self.repeated):
            spread = np.linalg.norm(node.rays[:, None] - node.rays[None], axis=-1)
            i, j = np.unravel_index(np.argmax(spread), spread.shape)
            if spread[i, j] > 1e-6:
                middle = 0.5 * (node.rays[i] + node.rays[j])
                children = []
                for keep in (i, j):
                    rays = node.rays.copy()
                    rays[j if keep == i else i] = middle
                    children.append((rays, node.boxes))
                return children
        if self.repeated and np.isfinite(best.cost):
            rays, boxes = node.rays, node.boxes
            if not boxes:
                # A block without a cap or a size to pay for has no bounded box: its part of the interval
                # stays open.
                boxes = {
                    k: self._first_box(k, best.cost)
                    for k in self.repeated
                    if self.forms[k].param >= 0 or np.isfinite(self.forms[k].constant)
                }
                if not boxes:
                    return None
                self._first_boxes = self._first_boxes or boxes
                free = [p for p in range(self.params) if p not in self._boxed]
                rays = np.eye(self.params)[free] if free else np.zeros((1, self.params))
            share = {k: boxes[k].radius / max(self._first_boxes[k].radius, 1e-300) for k in boxes}
            widest = max(share, key=share.get)
            if share[widest] > 1e-9:
                return [(rays, boxes | {widest: half}) for half in boxes[widest].halves()]
        return None

    def _first_box(self, k: int, cost: float) -> _Box:
        f = self.forms[k]
        bound = np.sqrt((f.constant + (cost if f.param >= 0 else 0.0)) * f.slope) * (1.0 + 1e-9)
        return (
            _Box(-bound, bound)
            if f.repeated == "repeated_real"
            else _Box(-bound * (1 + 1j), bound * (1 + 1j))
        )


# --- the problems of the interface


@dataclass(frozen=True)
class Solution:
    """Interval of the optimum and the explanation that attains ``upper``.

    ``nu`` (tau,) sizes of the blocks, ``xi``, ``eta``, ``w`` the signals, ``verification`` the Delta built
    from them and re-simulated; ``b1`` as in (9).
    """

    lower: float
    upper: float
    nu: np.ndarray
    xi: np.ndarray
    eta: np.ndarray
    w: np.ndarray
    b1: float
    verification: Verification
    nodes: int


class _Posed:
    """One LFT point in well-scaled coordinates: the maps of the blocks and of w, and the way back."""

    def __init__(
        self, problem: Lft, w_scale: np.ndarray, gamma_w: float = np.inf, without: Sequence[int] = ()
    ):
        """``without``: blocks whose xi_i is held at zero."""
        self.problem = problem
        par = parametrise(problem)
        self.b1 = par.b1
        # At gamma_w = B1 the ball is one point: phi = 0 is a constraint, and the solvers have no interior.
        self.least_ball = par.b1 * (1.0 - EDGE) - ROUNDING * np.linalg.norm(problem.e)
        self.ball_is_point = gamma_w <= par.b1 * (1.0 + EDGE) + ROUNDING * np.linalg.norm(problem.e)
        if self.ball_is_point:
            keep = np.r_[par.n_phi : par.xi_map.shape[1]]
            par = replace(
                par,
                xi_map=par.xi_map[:, keep],
                w_map=par.w_map[:, keep],
                eta_map=par.eta_map[:, keep],
                n_phi=0,
            )
        etas = split(problem.blocks, par.eta_map, "cols")
        dead = [i for i, eta in enumerate(etas) if i in without or not np.any(eta)]
        maps = self._without(par, dead) if dead else (par.xi_map, par.w_map, par.eta_map)
        size_e = np.linalg.norm(problem.e) or 1.0
        rows = []
        for xi, p21 in zip(split(problem.blocks, maps[0], "rows"), self._columns(problem), strict=True):
            gain = np.linalg.norm(p21)
            rows.append(xi * (gain / size_e if gain > 0.0 else 1.0))
        scaled = np.vstack([*rows, maps[1] / w_scale[:, None]])
        q, r = np.linalg.qr(scaled[:, :-1])
        shift = q.conj().T @ scaled[:, -1]
        rest = np.linalg.norm(scaled[:, -1] - q @ shift)
        self._kappa = rest if rest > 1e-9 * max(np.linalg.norm(shift), 1e-300) else 1.0
        d = r.shape[0]
        back = np.zeros((d + 1, d + 1), dtype=complex)
        if d:
            back[:d, :d] = np.linalg.inv(r)
            back[:d, d] = -(back[:d, :d] @ shift) / self._kappa
        back[d, d] = 1.0 / self._kappa
        self._xi, self._w, self._eta = (m @ back for m in maps)
        self.t = np.zeros((1, d + 1), dtype=complex)
        self.t[0, -1] = 1.0 / self._kappa
        self.dead = dead

    @staticmethod
    def _columns(problem: Lft) -> list[np.ndarray]:
        return [m.T for m in split(problem.blocks, problem.p21.T, "rows")]

    def _without(self, par: Parametrisation, dead: list[int]):
        """Maps with xi_i = 0 for the blocks whose eta_i is zero whatever happens."""
        pieces = split(self.problem.blocks, par.xi_map, "rows")
        rows = np.vstack([pieces[i] for i in dead])
        left, right = rows[:, :-1], -rows[:, -1]
        u, s, vh = np.linalg.svd(left)
        rank = int(np.sum(s > RANK_TOLERANCE * max(s[0], 1e-300))) if s.size else 0
        point = vh[:rank].conj().T @ ((u[:, :rank].conj().T @ right) / s[:rank])
        if np.linalg.norm(left @ point - right) > IMAGE_TOLERANCE * max(np.linalg.norm(right), 1e-300):
            raise InputError(
                self.problem.source,
                f"block {dead[0] + 1}",
                "its input eta is zero, so it cannot explain e",
                "eta0 != 0",
            )
        change = np.zeros((left.shape[1] + 1, left.shape[1] - rank + 1), dtype=complex)
        change[:-1, :-1], change[:-1, -1], change[-1, -1] = vh[rank:].conj().T, point, 1.0
        return par.xi_map @ change, par.w_map @ change, par.eta_map @ change

    @cached_property
    def xi(self) -> list[np.ndarray]:
        """Maps to xi_i per block."""
        return split(self.problem.blocks, self._xi, "rows")

    @cached_property
    def eta(self) -> list[np.ndarray]:
        """Maps to eta_i per block."""
        return split(self.problem.blocks, self._eta, "cols")

    @property
    def n(self) -> int:
        """Free variables plus one."""
        return self.t.shape[1]

    @property
    def w(self) -> np.ndarray:
        """Map to w."""
        return self._w

    def constant_eta(self, i: int) -> bool:
        """True when block i's input does not depend on the free variables."""
        return not np.any(self.eta[i][:, :-1])

    def signals(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(xi, eta, w) at a point in scaled coordinates; a xi_i that is only rounding is exactly zero.

        Rounding in xi_i = 0 has no direction: it is no multiple of eta_i, as a repeated block's xi_i has to
        be, and gives a full block a size.
        """
        z = z / (self.t @ z)[0]
        xi = np.concatenate([np.zeros(len(m)) if _cancels(m, z) else m @ z for m in self.xi])
        return xi, self._eta @ z, self._w @ z

    def points(self, known: Solution | None) -> list[np.ndarray]:
        """The point in scaled coordinates of an explanation found before; none for None."""
        if known is None:
            return []
        maps, signals = np.vstack([self._xi, self._w]), np.concatenate([known.xi, known.w])
        size = np.maximum(np.linalg.norm(maps, axis=1), 1e-300)
        rest = (signals * self.t[0, -1] - maps[:, -1]) / size
        theta, *_ = np.linalg.lstsq(maps[:, :-1] / size[:, None], rest, rcond=RANK_TOLERANCE)
        return [np.append(theta, 1.0)]

    def finish(self, interval: Interval, what: str) -> Solution:
        """Build and verify the explanation; refuse one that needs a perturbation at the well-posedness
        cap."""
        problem = self.problem
        if interval.z is None:
            raise InputError(
                problem.source,
                what,
                "no Delta of this structure explains e within the bounds",
                "larger bounds, or another structure",
            )
        xi, eta, w = self.signals(interval.z)
        pieces = zip(split(problem.blocks, xi, "rows"), split(problem.blocks, eta, "cols"), strict=True)
        nu = np.array([least_size(a, b) for a, b in pieces])
        if not well_posed(problem, nu):
            caps = ", ".join(f"{c:.6g}" for c in block_caps(problem))
            raise InputError(
                problem.source,
                "nu",
                f"{np.array2string(nu, precision=6)} is at or above the well-posedness cap "
                f"(single full blocks: {caps}): no certificate that every allowed Delta keeps the LFT regular",
                "sizes below the cap",
            )
        verification = verify(problem.blocks, problem.matrices, problem.e, w, xi, nu)
        return Solution(interval.lower, interval.upper, nu, xi, eta, w, self.b1, verification, interval.nodes)


def block_caps(problem: Lft) -> np.ndarray:
    """(tau,) 1 / sigma_max(P11,ii): at this size a single full block makes I - P11 Delta singular; inf where
    P11,ii = 0."""
    caps = []
    row = col = 0
    for b in problem.blocks:
        gain = np.linalg.norm(problem.p11[row : row + b.cols, col : col + b.rows], 2)
        caps.append(1.0 / gain if gain > 0.0 else np.inf)
        row, col = row + b.cols, col + b.rows
    return np.array(caps)


def well_posed(problem: Lft, nu: np.ndarray) -> bool:
    """Certified: no Delta of the structure with ||Delta_i|| <= nu_i makes I - P11 Delta singular.

    First by the spectral radius of the matrix of block norms, then by the S-procedure on |xi_i| <= nu_i |(P11
    xi)_i| with the multipliers of each block's structure: a matrix for a repeated scalar, and one more for a
    real one (the D-G scalings of mu).
    """
    nu = np.asarray(nu, dtype=float)
    etas = split(problem.blocks, problem.p11, "cols")
    norms = np.array(
        [[np.linalg.norm(part.T, 2) for part in split(problem.blocks, eta.T, "rows")] for eta in etas]
    )
    if np.max(np.abs(np.linalg.eigvals(norms * nu))) < 1.0:
        return True
    live = [i for i, b in enumerate(nu) if b > 0.0]
    xi = split(problem.blocks, np.eye(problem.p11.shape[1], dtype=complex), "rows")
    keep = np.concatenate([np.argmax(np.abs(xi[i]), axis=1) for i in live])
    forms, groups = [], []
    for i in live:
        block = problem.blocks[i]
        basis = lmi.hermitian_basis(block.rows) if block.repeated else None
        a, b = xi[i][:, keep], nu[i] * etas[i][:, keep]
        pieces = [("psd", _gram(a, a, basis) - _gram(b, b, basis))]
        if block.kind == "repeated_real":
            cross = 1j * _gram(a, b, basis)
            pieces.append(("free", cross + cross.conj().transpose(0, 2, 1)))
        for kind, piece in pieces:
            forms.extend(piece / (np.max(np.abs(piece)) or 1.0))
            groups.append((kind, block.rows if block.repeated else 1))
    forms = np.array(forms)
    level = lmi.maximise_level(forms, lmi.cone(groups), absolute=1e-10)
    return level.x > lmi.rounding(level.y, forms)


def _block_form(posed: _Posed, i: int, **bound) -> _Form:
    block = posed.problem.blocks[i]
    return _Form(
        posed.xi[i],
        posed.eta[i],
        repeated=block.kind if block.repeated and block.rows > 1 else _scalar(block),
        **bound,
    )


def _scalar(block: Block) -> str | None:
    """A 1 x 1 complex scalar is a full block; a real one keeps its reality."""
    return block.kind if block.kind == "repeated_real" else None


def _ball(posed: _Posed, gamma_w: float) -> list[_Form]:
    return [] if posed.ball_is_point else [_Form(posed.w, posed.t, constant=gamma_w**2)]


def _pose(problem: Lft, gamma_w: float, without: Sequence[int] = ()) -> _Posed:
    if not np.isfinite(gamma_w) or gamma_w < 0.0:
        raise InputError(problem.source, "gamma_w", f"{gamma_w}", "a finite number that is not negative")
    posed = _Posed(
        problem, np.full(problem.p22.shape[1], gamma_w or np.linalg.norm(problem.e) or 1.0), gamma_w, without
    )
    if gamma_w < posed.least_ball:
        raise InputError(
            problem.source,
            "gamma_w",
            f"{gamma_w:.6g} is below the smallest disturbance B1 = {posed.b1:.6g}",
            "gamma_w >= B1",
        )
    return posed


def optimum(problem: Lft, gamma_w: float, lambda_nu, lambda_w=None, *, gap: float = GAP) -> Solution:
    """Optimum of (8): min sum_i lambda_nu,i nu_i^2 + sum_j lambda_w,j |w_j|^2 subject to |w| <= gamma_w.

    ``lambda_nu`` (tau,), ``lambda_w`` (n_w,) >= 0, default 0. Raises InputError when e is not in Im M,
    gamma_w < B1, nothing in the structure explains e, or the optimum lies at the well-posedness cap.
    """
    posed = _pose(problem, gamma_w)
    lam = np.asarray(lambda_nu, dtype=float)
    forms, quadratic = _ball(posed, gamma_w), []
    params = 0
    if lambda_w is not None and np.any(lambda_w):
        quadratic.append(np.sqrt(np.asarray(lambda_w, dtype=float))[:, None] * posed.w)
    for i, block in enumerate(problem.blocks):
        if i in posed.dead:
            continue
        if posed.constant_eta(i) and not block.repeated and lam[i] > 0.0:
            quadratic.append(
                posed.xi[i] * (np.sqrt(lam[i]) * np.linalg.norm(posed.t) / np.linalg.norm(posed.eta[i]))
            )
        elif lam[i] > 0.0:
            forms.append(_block_form(posed, i, param=params, slope=1.0 / lam[i]))
            params += 1
        elif block.repeated:
            forms.append(_block_form(posed, i, constant=block_caps(problem)[i] ** 2))
    if quadratic:
        forms.append(_Form(np.vstack(quadratic), posed.t, param=params, parts=tuple(quadratic)))
        params += 1
    quadratic_problem = _Quadratic(forms, max(params, 1), posed.n)
    interval = (
        _one_block(quadratic_problem, block_caps(problem), posed) if quadratic and params == 2 else None
    )
    if interval is None or not interval.upper - interval.lower <= 2.0 * gap * interval.upper:
        interval = quadratic_problem.solve(gap=gap)
    return posed.finish(interval, "gamma_w")


def _one_block(problem: _Quadratic, caps: np.ndarray, posed: _Posed) -> Interval | None:
    """The compiled S2 kernel for one full block with a varying input beside a plain quadratic cost; None if
    it is not that."""
    ball, block, cost = problem.forms if len(problem.forms) == 3 else (None, None, None)
    start = problem.repair(problem._origin()) if ball is not None and not problem.repeated else None
    if start is None or problem.zero() is not None or len(start) > s2.MAX_N or len(start) < 2:
        return None
    which = next(i for i, xi in enumerate(posed.xi) if xi is block.a)
    trivial = problem.cost(start)
    if not 0.0 < trivial < np.inf:
        return None

    def gram(m):
        return m.conj().T @ m

    weight = np.linalg.norm(block.a) ** 2
    t_row, rim = gram(ball.b), ball.constant * (1.0 + 1e-12)
    forms = np.stack(
        [
            gram(cost.a) / (trivial * np.linalg.norm(cost.b) ** 2),
            gram(ball.a) / rim - t_row,
            gram(block.a) / weight,
            gram(block.b) * (block.slope * trivial / weight),
        ]
    )
    forms[1] /= np.linalg.norm(ball.b) ** 2
    p_max = caps[which] ** 2 / (block.slope * trivial) * (1.0 - 1e-9)
    out = s2.solve_forms(forms[None], start[None], p_max)
    if not np.isfinite(out.upper[0]) or out.p[0] > s2.NEAR_CAP**2 * p_max:
        return None
    best = _Best()
    problem.start(best, [out.z[0]])
    lower = float(out.lower[0] * trivial)
    return Interval(lower, max(best.cost, lower), best.z, int(out.duals[0]))


def _last_block_is_free(problem: Lft, gamma_w: float, gap: float, max_nodes: int) -> bool:
    """True when an explanation without the last block was found: the smallest disturbance that one needs is
    at most gamma_w. Only asked beside repeated blocks: without them the least-squares point of
    :meth:`_Quadratic.zero` decides.
    """
    last = len(problem.blocks) - 1
    try:
        posed = _pose(problem, gamma_w, [last])
    except InputError:
        return False  # e is not in the image of the other blocks and w
    caps = block_caps(problem)
    forms = [_Form(posed.w, posed.t, param=0)]
    forms += [
        _block_form(posed, i, constant=caps[i] ** 2)
        for i in range(last)
        if problem.blocks[i].repeated and i not in posed.dead
    ]
    limit = gamma_w**2 * (1.0 + (EDGE if posed.ball_is_point else ROUNDING))
    return _Quadratic(forms, 1, posed.n).solve(gap, max_nodes, enough=limit).upper <= limit


def smallest_last_block(
    problem: Lft,
    gamma_w: float,
    *,
    gap: float = GAP,
    max_nodes: int = MAX_NODES,
    known: Solution | None = None,
) -> tuple[float, float]:
    """(lower, upper) of the smallest size of the last block alone, the others free, at the same gamma_w.

    ``known``: an explanation at the same gamma_w to begin with.
    Raises InputError as :func:`optimum` does, and when that size is at or above the block's own cap.
    """
    posed = _pose(problem, gamma_w)
    last = len(problem.blocks) - 1
    if last in posed.dead:
        return 0.0, 0.0
    forms = _ball(posed, gamma_w)
    caps = block_caps(problem)
    others = [i for i in range(last) if problem.blocks[i].repeated and i not in posed.dead]
    if others and _last_block_is_free(problem, gamma_w, gap, max_nodes):
        return 0.0, 0.0
    forms += [_block_form(posed, i, constant=caps[i] ** 2) for i in others]
    forms.append(_block_form(posed, last, param=0))
    interval = _Quadratic(forms, 1, posed.n).solve(gap, max_nodes, ZERO, posed.points(known))
    lower, upper = float(np.sqrt(interval.lower)), float(np.sqrt(interval.upper))
    cap = caps[last]
    if not upper < cap:
        raise InputError(
            problem.source,
            f"block {last + 1}",
            f"needs {upper:.6g}, at or above its cap {cap:.6g}",
            "a size below",
        )
    return lower, upper


def smallest_common_size(
    problem: Lft,
    gamma_w: float,
    *,
    gap: float = GAP,
    max_nodes: int = MAX_NODES,
    known: Solution | None = None,
) -> Solution:
    """Smallest t with all nu_i <= t at the same gamma_w; bounds are on t^2.

    ``known``: an explanation at the same gamma_w to begin with.
    """
    posed = _pose(problem, gamma_w)
    forms = _ball(posed, gamma_w)
    forms += [_block_form(posed, i, param=0) for i in range(len(problem.blocks)) if i not in posed.dead]
    interval = _Quadratic(forms, 1, posed.n).solve(gap, max_nodes, points=posed.points(known))
    return posed.finish(interval, "gamma_w")


def margin(problem: Lft, w_delta, w_w, *, gap: float = GAP) -> Solution:
    """Least t with nu_i <= t W_delta,i and |w_j| <= t W_w,j: the margin with one bound per output; bounds are
    on t.

    ``w_delta`` (tau,), ``w_w`` (n_w,), both > 0.
    """
    w_delta, w_w = np.asarray(w_delta, dtype=float), np.asarray(w_w, dtype=float)
    posed = _Posed(problem, w_w)
    forms = [_Form(posed.w[j : j + 1], posed.t, param=0, slope=float(b) ** 2) for j, b in enumerate(w_w)]
    forms += [
        _block_form(posed, i, param=0, slope=float(b) ** 2)
        for i, b in enumerate(w_delta)
        if i not in posed.dead
    ]
    solution = posed.finish(_Quadratic(forms, 1, posed.n).solve(gap=2.0 * gap), "W_delta, W_w")
    return replace(solution, lower=float(np.sqrt(solution.lower)), upper=float(np.sqrt(solution.upper)))
