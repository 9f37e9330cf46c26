"""Branch and bound of the quadratic problem, over cones of sizes and boxes of the repeated blocks'
scalars."""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpvguard.engine.validation.local_search import MAX_POLISHED, polish, repeated_starts
from lpvguard.engine.validation.quadratic import Quadratic
from lpvguard.engine.validation.relaxation import Box, BranchNode, Relaxation, Tangent

GAP = 1e-4
"""Relative gap between the two bounds at which the branch and bound stops."""

MAX_NODES = 5000
"""The branch and bound stops with its present interval after this number of nodes."""

SLACK = 1e-5
"""A separate proof uses a level that lies below the result of the search by this relative distance."""

COSTLY = 24
"""With more multipliers of repeated blocks than this, the relaxation is used less often."""


@dataclass(frozen=True)
class Interval:
    """Bounds of the optimum.

    ``lower`` is certified. ``z`` (n,) attains ``upper``, or it is None and ``upper`` inf.
    """

    lower: float
    upper: float
    z: np.ndarray | None
    nodes: int


class Incumbent:
    """Best feasible point of a problem so far: ``cost``, and ``z`` (n,) or None."""

    def __init__(self, problem: Quadratic):
        self._problem = problem
        self.cost: float = np.inf
        self.z: np.ndarray | None = None

    def offer(self, z: np.ndarray | None) -> None:
        """Repair ``z`` (n,) and store it if it is feasible and better."""
        z = self._problem.repair(z) if z is not None else None
        if z is not None:
            cost = self._problem.cost(z)
            if cost < self.cost:
                self.cost, self.z = cost, z

    def improve(self, z: np.ndarray) -> None:
        """Offer the result of a local search from ``z`` (n,)."""
        self.offer(polish(self._problem, z))

    def start(self, points: Sequence[np.ndarray]) -> float:
        """Offer the points and their local improvements. Returns the least cost before any local search."""
        for z in points:
            self.offer(z)
        raw = self.cost
        for z in points:
            self.improve(z)
        return raw


@dataclass(frozen=True)
class _NodeBounds:
    """Bounds of the cost of a node.

    ``lower`` is the best lower bound. ``edges`` and ``central`` are bounds of the relaxation at the edges of
    the cone and on its central ray. They are -inf and inf without the relaxation. ``tangent`` holds the
    bounds of the tangent. ``readings`` are candidate points.
    """

    lower: float
    edges: float
    central: float
    tangent: Tangent | None
    readings: list[np.ndarray]


def _candidates(inverse: np.ndarray | None) -> list[np.ndarray]:
    """Candidate points from the primal matrix: its last column and its two leading eigenvectors."""
    if inverse is None or not np.all(np.isfinite(inverse)):
        return []
    _, vectors = np.linalg.eigh(inverse)
    raw = [inverse[:, -1], *vectors.T[:-3:-1]]
    return [v / v[-1] for v in raw if abs(v[-1]) > 1e-9 * np.linalg.norm(v)]


def minimise(
    problem: Quadratic,
    gap: float = GAP,
    max_nodes: int = MAX_NODES,
    zero: float = 0.0,
    points: Sequence[np.ndarray] = (),
    enough: float = 0.0,
) -> Interval:
    """Bound the optimum by best-first branch and bound. The upper bound is inf without a feasible point.

    The search begins with the known explanations ``points``, each (n,). A cost below ``zero`` times the cost
    of the first feasible point counts as zero and ends the search. The search also ends when it is decided
    whether the optimum is at most ``enough``.
    """
    free = problem.zero()
    if free is not None:
        return Interval(0.0, 0.0, free, 0)
    return _Search(problem, gap).run(max_nodes, zero, points, enough)


def proves(problem: Quadratic, level: float, cost: float, max_nodes: int = 2 * MAX_NODES) -> bool:
    """Prove that no point of ``problem`` costs less than ``level``; False if there is no proof.

    Every final node of the proof is bounded again. ``cost`` is the cost of a known point and at least
    ``level``. It affects only the choice of the cuts. The result is False if ``max_nodes`` nodes are not
    enough.
    """
    if level <= 0.0:
        return True
    search = _Search(problem, max(0.0, 1.0 - level * (1.0 + SLACK) / cost))
    search.best.cost = cost
    open_nodes = [BranchNode(0.0, 0, np.eye(problem.params), {})]
    for _ in range(max_nodes):
        node = open_nodes.pop()
        bounds = search._bound(node)
        if bounds.lower < level:
            children = search._branch(node, bounds)
            if children is None:
                return False
            open_nodes += [BranchNode(bounds.lower, 0, rays, boxes) for rays, boxes in children]
        if not open_nodes:
            return True
    return False


class _Search:
    """One run of :func:`minimise`."""

    def __init__(self, problem: Quadratic, gap: float):
        self.problem, self.gap = problem, gap
        self.relaxation, self.best = Relaxation(problem), Incumbent(problem)
        self._polished = 0
        self._first_boxes: dict[int, Box] = {}
        # The time of a Newton step grows with the cube of the number of multipliers. With two larger blocks
        # the relaxation takes fifty times as long as the tangent. It is left out if the tangent gave the
        # better bound.
        self._costly = (
            sum(
                (3 if f.repeated == "repeated_real" else 2) * len(f.a) ** 2
                for f in problem.forms
                if f.repeated
            )
            > COSTLY
        )

    def run(self, max_nodes: int, zero: float, points: Sequence[np.ndarray], enough: float) -> Interval:
        """Run the search with the parameters of :func:`minimise`."""
        best, serial = self.best, 0
        first = best.start([self.problem.origin(), *points])
        open_nodes = [BranchNode(0.0, serial, np.eye(self.problem.params), {})]
        closed = np.inf
        while open_nodes and serial < max_nodes:
            node = heapq.heappop(open_nodes)
            decided = enough > 0.0 and (best.cost <= enough or node.lower > enough)
            if decided or node.lower >= best.cost * (1.0 - self.gap):
                closed = min(closed, node.lower)
                break
            bounds = self._bound(node)
            self._read(bounds.readings)
            if serial == 0 and not np.isfinite(best.cost):
                first = best.start(repeated_starts(self.problem))
            first = best.cost if np.isinf(first) else first
            if np.isfinite(first) and best.cost <= zero * first:
                return Interval(0.0, 0.0, best.z, serial + 1)
            children = None if bounds.lower >= best.cost * (1.0 - self.gap) else self._branch(node, bounds)
            if children is None:
                closed = min(closed, bounds.lower)
                continue
            tangent = bounds.tangent
            small = tangent is not None and tangent.lower > max(bounds.edges, node.lower)
            for rays, boxes in children:
                serial += 1
                heapq.heappush(open_nodes, BranchNode(bounds.lower, serial, rays, boxes, small))
        remaining = min((n.lower for n in open_nodes), default=np.inf)
        return Interval(min(closed, remaining, best.cost), best.cost, best.z, serial + 1)

    def _bound(self, node: BranchNode) -> _NodeBounds:
        """Bound a node by its boxes, then by the tangent, then (if still open) by the relaxation."""
        best = self.best
        lower = max(node.lower, self.relaxation.box_bound(node, set(range(self.problem.params))))
        tangent = self.relaxation.tangent(node, best.cost)
        readings = _candidates(tangent.inverse) if tangent is not None else []
        lower = max(lower, tangent.lower if tangent is not None else 0.0)
        edges, central = -np.inf, np.inf
        if lower < best.cost * (1.0 - self.gap) and not (node.small and self._costly):
            edges, central, inverse = self.relaxation.lower(
                node, best.cost * (1.0 - self.gap) * (1.0 + 1e-12)
            )
            lower = max(lower, edges)
            readings += _candidates(inverse)
        return _NodeBounds(lower, edges, central, tangent, readings)

    def _read(self, readings: list[np.ndarray]) -> None:
        """Offer the points of a node.

        Each of the first points gets a local search, later ones only if they improve.
        """
        best = self.best
        for z in readings if self._polished < MAX_POLISHED else readings[:1]:
            before = best.cost
            best.offer(z)
            if self._polished < MAX_POLISHED or best.cost < before:
                self._polished += 1
                best.improve(z)

    def _branch(
        self, node: BranchNode, bounds: _NodeBounds
    ) -> list[tuple[np.ndarray, dict[int, Box]]] | None:
        """(rays, boxes) of two nodes that cover this node; None if it cannot be cut.

        The widest pair of rays or the widest box is cut in the middle.
        """
        problem, best, tangent = self.problem, self.best, bounds.tangent
        cone_loss, relaxation_loss = bounds.central - bounds.edges, best.cost - bounds.central
        if tangent is not None and tangent.lower > bounds.edges:
            cone_loss, relaxation_loss = tangent.centre - tangent.cone, 2.0 * (tangent.centre - tangent.box)
        to_box = problem.boxed and not node.boxes and np.isfinite(best.cost)
        if not to_box and (cone_loss >= 0.5 * relaxation_loss or not problem.repeated):
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
        return self._cut_box(node) if np.isfinite(best.cost) else None

    def _cut_box(self, node: BranchNode) -> list[tuple[np.ndarray, dict[int, Box]]] | None:
        """(rays, boxes) of the two halves of a node's widest box; None if no box can be cut."""
        problem, rays, boxes = self.problem, node.rays, node.boxes
        if not boxes:
            # A block without a cap and without a cost has no bounded box and cannot be cut.
            boxes = {
                k: self._first_box(k) for k in problem.repeated if np.isfinite(problem.forms[k].constant)
            }
            if not boxes:
                return None
            self._first_boxes = self._first_boxes or boxes
            free = [p for p in range(problem.params) if p not in problem.boxed]
            rays = np.eye(problem.params)[free] if free else np.zeros((1, problem.params))
        share = {k: boxes[k].radius / max(self._first_boxes[k].radius, 1e-300) for k in boxes}
        widest = max(share, key=lambda k: share[k])
        if share[widest] > 1e-9:
            return [(rays, boxes | {widest: half}) for half in boxes[widest].halves()]
        return None

    def _first_box(self, k: int) -> Box:
        """Box of the scalars of the repeated form ``k`` that the best cost so far does not exclude."""
        f = self.problem.forms[k]
        paid = self.best.cost if f.param >= 0 else 0.0
        bound = np.sqrt((f.constant + paid) * f.slope) * (1.0 + 1e-9)
        return (
            Box(-bound, bound) if f.repeated == "repeated_real" else Box(-bound * (1 + 1j), bound * (1 + 1j))
        )
