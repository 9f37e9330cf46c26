"""Certified lower bounds of the quadratic problem over a node of the branch and bound (S-procedure).

Two facts make the branch and bound short. First, a certificate y for sizes p stays valid for every p' with
sum_j y_j Q_j(p') >= 0. This set is convex and contains [0, p]. A cone of directions is therefore bounded at
its edges, with an error of second order in its angle (Tuy). Second, a certificate along a ray is an
eigenvalue problem in the length. Each multiplier vector is therefore used up to the largest length that it
proves (Dinkelbach). If the scalars of repeated blocks enter as linear constraints, a certificate is also
affine in them. A box is therefore bounded at its corners, again with an error of second order
(:meth:`Relaxation.tangent`).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lpvguard.engine.validation import lmi
from lpvguard.engine.validation.problem import RANK_TOLERANCE
from lpvguard.engine.validation.quadratic import Form, Quadratic

PENALTIES = 10.0 ** np.arange(-2.0, 5.0)
"""Penalties on |A z|^2, relative to the certificate's norm, that :meth:`Relaxation.tangent` tries."""


@dataclass(frozen=True)
class Box:
    """Closed box for a repeated block's scalar: a real interval or a rectangle of the complex plane."""

    low: complex
    high: complex

    @property
    def centre(self) -> complex:
        """Middle of the box."""
        return 0.5 * (self.low + self.high)

    @property
    def radius(self) -> float:
        """Half the distance between ``low`` and ``high``."""
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
        return max(abs(corner) for corner in self.corners)

    @property
    def corners(self) -> list[complex]:
        """The two ends of an interval, or the four corners of a rectangle."""
        low, high = self.low, self.high
        ends = [low, complex(high.real, low.imag), complex(low.real, high.imag), high]
        return list(dict.fromkeys(ends))

    def halves(self) -> tuple[Box, Box]:
        """Two halves of the box, cut in the middle of its longer side."""
        d = self.high - self.low
        cut = 0.5 * d.real if d.real >= d.imag else 0.5j * d.imag
        return Box(self.low, self.high - cut), Box(self.low + cut, self.high)


@dataclass(order=True)
class BranchNode:
    """A cone of sizes that ``rays`` (k, params) span, and a box per repeated form (``boxes``, by index).

    ``lower`` is a certified bound of the cost over the node. ``small`` is True if the tangent gave the better
    bound at the parent.
    """

    lower: float
    serial: int
    rays: np.ndarray = field(compare=False)
    boxes: dict[int, Box] = field(compare=False)
    small: bool = field(compare=False, default=False)


@dataclass(frozen=True)
class Tangent:
    """Bounds of :meth:`Relaxation.tangent` and the primal matrix (n, n), or None.

    ``lower`` holds over the node. ``centre`` holds at the centre of the boxes on the central ray. ``box``
    holds at the corners of the boxes on the central ray. ``cone`` holds at the centre of the boxes on all
    rays.
    """

    lower: float
    centre: float
    box: float
    cone: float
    inverse: np.ndarray | None


@dataclass(frozen=True)
class _Generators:
    """Parts of a certificate.

    They are Q0 and its level part (m, n, n), their parameters (m,), and the multiplier cone.
    """

    q0: np.ndarray
    level: np.ndarray
    param: np.ndarray
    cone: lmi.Cone

    def shares(self, rays: np.ndarray) -> np.ndarray:
        """Size (k, m) of each generator's parameter on ``rays`` (k, params), 0 without a parameter."""
        return np.column_stack([rays, np.zeros(len(rays))])[:, self.param]


class _HeldScalars:
    """The repeated blocks of a node as linear constraints (a - d b) z = 0 with fixed scalars d."""

    def __init__(self, problem: Quadratic, boxes: dict[int, Box]):
        self._forms: list[Form] = [problem.forms[k] for k in boxes]
        self.centre = np.array([box.centre for box in boxes.values()])
        self.corners = [np.array(c) for c in itertools.product(*(box.corners for box in boxes.values()))]
        self._known = [i for i, f in enumerate(self._forms) if f.param in problem.boxed]
        forms = ((problem.forms[k], box.centre) for k, box in boxes.items())
        self._unit = [1.0 / (np.linalg.norm(f.a) + abs(c) * np.linalg.norm(f.b)) for f, c in forms]

    def rows(self, scalars: np.ndarray) -> np.ndarray:
        """Rows a - d b of all blocks; each block is scaled separately."""
        return np.vstack(
            [u * (f.a - d * f.b) for u, f, d in zip(self._unit, self._forms, scalars, strict=True)]
        )

    def base(self, scalars: np.ndarray) -> float:
        """Sum of the sizes that depend on the scalars only.

        The tangent at the centre replaces each |d|^2.
        """
        centre = self.centre
        return sum(
            (2.0 * (centre[i].conjugate() * scalars[i]).real - abs(centre[i]) ** 2) / self._forms[i].slope
            - self._forms[i].constant
            for i in self._known
        )


class Relaxation:
    """Computes lower bounds of a :class:`quadratic.Quadratic` over nodes."""

    def __init__(self, problem: Quadratic):
        self.problem = problem
        plain = [k for k, f in enumerate(problem.forms) if not f.repeated and np.isfinite(f.constant)]
        self._plain = self._generators({}, plain) if plain else None

    def _generators(self, boxes: dict[int, Box], only: Sequence[int] | None = None) -> _Generators:
        """Generators of all forms or of those in ``only``."""
        forms, boxed = self.problem.forms, self.problem.boxed
        q0: list[np.ndarray] = []
        level: list[np.ndarray] = []
        param: list[int] = []
        groups: list[tuple[str, int]] = []

        def add(kind: str, order: int, zero: np.ndarray, slope_part: np.ndarray, index: int) -> None:
            size = max(float(np.max(np.abs(zero))), 1e-300)
            q0.extend(zero / size)
            level.extend(slope_part / size)
            param.extend([index] * len(zero))
            groups.append((kind, order))

        for k in range(len(forms)) if only is None else only:
            f = forms[k]
            r = f.a.shape[0] if f.repeated else 1
            basis = lmi.hermitian_basis(r) if f.repeated else None

            if k in boxes and f.param in boxed:
                aa, bb = lmi.gram(f.a, f.a, basis), lmi.gram(f.b, f.b, basis)
                add("psd", r, aa - boxes[k].most ** 2 * bb, 0.0 * bb, -1)
            elif np.isfinite(f.constant):
                aa, bb = lmi.gram(f.a, f.a, basis), f.slope * lmi.gram(f.b, f.b, basis)
                add("psd", r, aa - f.constant * bb, bb if f.param >= 0 else 0.0 * bb, f.param)
            if f.repeated == "repeated_real":
                cross = 1j * lmi.gram(f.a, f.b, basis)
                add("free", r, cross + cross.conj().transpose(0, 2, 1), 0.0 * cross, -1)
            if k in boxes:
                box = boxes[k]
                d, bb = f.a - box.centre * f.b, lmi.gram(f.b, f.b, basis)
                add("psd", r, lmi.gram(d, d, basis) - box.radius**2 * bb, 0.0 * bb, -1)
        return _Generators(np.array(q0), np.array(level), np.array(param), lmi.cone(groups))

    def box_bound(self, node: BranchNode, params: set[int]) -> float:
        """Least sum of the sizes ``params`` that the boxes of repeated blocks allow."""
        total = np.zeros(self.problem.params)
        for k, box in node.boxes.items():
            f = self.problem.forms[k]
            if f.param in params:
                total[f.param] = max(total[f.param], box.least**2 / f.slope - f.constant)
        return float(total.sum())

    def lower(self, node: BranchNode, cutoff: float) -> tuple[float, float, np.ndarray | None]:
        """Certified lower bound over a node, bound on its central ray, and primal matrix (n, n) or None."""
        g = self._generators(node.boxes) if self.problem.repeated or self._plain is None else self._plain
        base = self.box_bound(node, self.problem.boxed)
        shares = g.shares(node.rays)
        length, y, inverse = lmi.ray_length(
            g.q0, g.level * shares.mean(axis=0)[:, None, None], g.cone, max(cutoff - base, 0.0)
        )
        edges = 0.0
        if y is not None:
            slopes = np.tensordot(shares * y, g.level, axes=1)
            edges = float(np.min(lmi.reach(np.tensordot(y, g.q0, axes=1), slopes, lmi.rounding(y, g.q0))))
        return base + edges, base + length, inverse

    def tangent(self, node: BranchNode, cutoff: float) -> Tangent | None:
        """Second bound over a node with boxes, with an error of second order in their size, or None.

        At the boxes' centre c the repeated blocks are linear constraints, A(c) z = 0 with rows a - c b. The
        other forms give multipliers y on the kernel of A(c). By Finsler's lemma some Y makes the certificate
        Q(y, p) + Y^* A(c) + A(c)^* Y positive on the whole space. With the same y and Y the certificate is
        affine in the scalars and the sizes. It therefore holds over the box if it holds at the corners,
        because |delta|^2 lies above its tangent at c. The part of Y outside the kernel is free. The method
        tries several penalties on |A z|^2 and keeps the best corner bound.
        """
        if self._plain is None or not node.boxes:
            return None
        g, held = self._plain, _HeldScalars(self.problem, node.boxes)
        left, s, vh = np.linalg.svd(held.rows(held.centre))
        rank = int(np.sum(s > RANK_TOLERANCE * s[0]))
        normal, kernel = vh[:rank].conj().T, vh[rank:].conj().T
        shares = g.shares(np.vstack([node.rays.mean(axis=0), node.rays]))
        at_centre = held.base(held.centre)
        length, inverse = 0.0, None
        y: np.ndarray | None = g.cone.normal / g.cone.normal.sum()
        if kernel.shape[1]:
            q0, level = (kernel.conj().T @ m @ kernel for m in (g.q0, g.level * shares[0][:, None, None]))
            length, y, reduced = lmi.ray_length(q0, level, g.cone, max(cutoff - at_centre, 0.0))
            inverse = None if reduced is None else kernel @ reduced @ kernel.conj().T
        if y is None:
            return None
        zero, slopes = np.tensordot(y, g.q0, axes=1), np.tensordot(shares * y, g.level, axes=1)
        at = zero - (length if np.isfinite(length) else 0.0) * slopes[0]
        to_rows = (left[:, :rank] / s[:rank]).conj().T
        duals = _lifts(at, kernel, normal, s[:rank]) @ to_rows
        scalars = [held.centre, *held.corners]
        terms = np.stack([duals @ held.rows(d) for d in scalars])
        errors = lmi.rounding(y, g.q0) + 8.0 * len(zero) * np.finfo(float).eps * np.linalg.norm(
            duals, axis=(1, 2)
        )
        lengths = lmi.reaches(
            zero + terms + terms.conj().swapaxes(-1, -2), slopes, np.broadcast_to(errors, terms.shape[:2])
        )
        # (1 + corners, penalties, 1 + rays)
        bounds = lengths + np.array([held.base(d) for d in scalars])[:, None, None]
        kept = int(np.argmax(bounds[1:, :, 1:].min(axis=(0, 2))))
        return Tangent(
            float(bounds[1:, kept, 1:].min()),
            at_centre + length,
            float(bounds[1:, kept, 0].min()),
            float(bounds[0, kept, 1:].min()),
            inverse,
        )


def _lifts(at: np.ndarray, kernel: np.ndarray, normal: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Matrices ``lift`` (penalties, n, rank) with Y^* = lift pinv(A N), where N is ``normal``.

    A lift makes the certificate block diagonal, with ``at`` on the kernel and the penalty outside. ``s`` are
    the singular values of A.
    """
    outside = normal.conj().T @ at @ normal
    penalties = np.linalg.norm(at) * PENALTIES
    cross = -kernel @ (kernel.conj().T @ at @ normal)
    return cross + 0.5 * normal @ (penalties[:, None, None] * np.diag(s**2) - outside)
