"""Storage function that proves the induced gain of a scheduled closed loop while the speed moves.

The loop is x+ = A(v) x + B(v) w, z = C(v) x + D(v) w with v+ - v in [-a Ts, a Ts]. With P(v) > 0 and

    F(v, v+) = [P(v) 0; 0 I] - [A B]' P(v+) [A B] - [C D]' [C D] > 0     for all v in the range and |v+ - v|
                                                                         <= a Ts

x' P(v) x is a storage function: the gain from w to z is below 1 for every speed history with |dv/dt| <= a,
from rest. The adjoint loop is ``x+ = A' x + C' z, w = B' x + D' z`` with time reversed. Both loops have the
same gain over the same histories, so a storage function of either loop is enough. If the controller's B
depends on the speed, a change of speed moves the controller's states. In the adjoint loop B becomes an output
matrix, and the states do not move.

``find`` tries the adjoint first, then the loop. A barrier method on a grid of speeds searches for
P0 + v P1 + P2 / v, in which F is linear. If it fails, strict bounded-real Riccati equations give another P.
Each P is replaced by a piecewise linear one with ``KNOTS`` knots between two nodes of the controller.

``prove`` covers the speed range by cells and tests F at the ends of each cell. A matrix bounds the decrease
of F between both ends:

- P is affine in a cell. P(v+) is a mean of affine matrices (``Storage.afterwards``), and each is tested.
- F is concave along the chord between the ends, except for one product of dP and dM, with dP the change of
  P(v+), and M = [A B]. A bound of this product is subtracted.
- [M; N] (N = [C D]) deviates from its chord only in the vehicle's rows (in the adjoint: columns). All other
  entries are affine between two nodes of the controller. Bounds on the derivatives of the vehicle's
  zero-order hold over the cell (``NominalModel.hold_bounds``) bound the deviation.

A failing cell is cut in two, down to ``SMALLEST_CELL``. Near a knot the cut is at the speed from which one
step reaches the knot. The two parts then have fewer slopes of P. Every test uses eigenvalues with a margin
for rounding.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.synthesis.barrier import feasible
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import EPS, StateSpace
from lpvguard.engine.synthesis.storage_grid import StorageGrid, parts_in, refined, terms, unmoved

SMALLEST_CELL = 1e-3
"""The proof fails if a cell fails that is narrower than this [m/s]."""
INSIDE = 4
"""Least distance of a cut from the ends of its cell, in units in the last place. Rounding moves a cut by
less."""
FIRST_CELLS = 2
"""First number of cells between two knots."""
MOST_CELLS = 1000
"""Largest number of cells of a proof. A larger proof would take too long, because every export repeats it."""
FIRST_RATE, LARGEST_RATE, SMALLEST_RATE = 0.25, 8.0, 0.015
"""First, largest and smallest trial rate |dv/dt| [m/s^2]. The rate changes by factors of four. A truck brakes
with less than the largest rate."""
SHARES = (0.95, 0.7, 0.5)
"""Shares of the rate on the grid that the proof between its speeds tries. Riccati solutions vary irregularly
between the knots and use the last share only."""
GRIDS = (1, 2, 4)
"""Numbers of search intervals between two nodes. After a failed proof the next number is tried."""
KNOTS = 16
"""Number of segments of a storage function between two nodes. The loss between knots is of second order."""
DOUBLINGS = 20
"""Number of doublings of the steps that a Gramian sums: a million steps, or three hours at 0.01 s."""
HIDDEN = 1e-12
"""Share of the largest Gramian entry that is added to the Gramians of the coordinates."""
SLACKS = (3e-4, 1e-4, 3e-5, 1e-5, 1e-6)
"""Squares of the extra input and output on every state, which make the Riccati equations at frozen speeds
strict."""


@dataclass(frozen=True)
class Family:
    """The scaled closed loop over speed.

    Attributes
    ----------
    at : Callable
        Returns the StateSpace at a speed [m/s]. Its last ``n_probes`` outputs are the vehicle's state and
        inputs.
    nodes : ndarray (K,), m/s
        Between two nodes every entry outside the vehicle's rows is affine in the speed.
    vehicle : slice, rows of [A B] that are Xi(v) times the probes
    n_probes : int
    hold_bounds : Callable, returns entrywise bounds of |Xi'| and |Xi''| from ``low`` to ``high`` [m/s]
    Ts : float, s
    adjoint : bool, storage functions belong to the adjoint loop
    """

    at: Callable[[float], StateSpace]
    nodes: np.ndarray
    vehicle: slice
    n_probes: int
    hold_bounds: Callable[[float, float], tuple[np.ndarray, np.ndarray]]
    Ts: float
    adjoint: bool = False

    def loop(self, v: float) -> StateSpace:
        """The loop, or its adjoint, at speed v [m/s], without probes."""
        return self.unprobed(self.at(v))

    def unprobed(self, G: StateSpace) -> StateSpace:
        """The system of ``at``, or its adjoint, without probes."""
        G = G.select(slice(0, G.n_outputs - self.n_probes), slice(None))
        return StateSpace(G.A.T, G.C.T, G.B.T, G.D.T, G.dt) if self.adjoint else G


def relevant(family: Family, rows: slice, columns: slice) -> Family:
    """Restrict a family to some inputs and outputs, and remove states without effect at every speed.

    Parameters
    ----------
    family : Family
    rows : slice, outputs that are kept, besides the probes
    columns : slice, inputs that are kept

    Returns
    -------
    Family
    """
    loops = [family.at(float(v)) for v in refined(family.nodes, 2)]
    [n_z] = {G.n_outputs - family.n_probes for G in loops}

    def any_of(parts: list[np.ndarray]) -> np.ndarray:
        return np.max([np.abs(part) for part in parts], axis=0) > 0

    # An entry that is affine between nodes and zero at two speeds is zero. The vehicle's rows are treated as
    # full.
    moves: np.ndarray = any_of([G.A for G in loops])
    moves[family.vehicle] |= any_of([G.C[n_z:] for G in loops]).any(axis=0)
    entered: np.ndarray = np.asarray(any_of([G.B[:, columns] for G in loops]).any(axis=1))
    entered[family.vehicle] |= any_of([G.D[n_z:, columns] for G in loops]).any()
    read: np.ndarray = np.asarray(any_of([G.C[rows] for G in loops]).any(axis=0))
    for _ in range(len(moves)):
        entered, read = entered | (moves @ entered), read | (moves.T @ read)
    kept = np.flatnonzero(entered & read)
    vehicle = np.flatnonzero((kept >= family.vehicle.start) & (kept < family.vehicle.stop))

    def at(v: float) -> StateSpace:
        G = family.at(v)
        outputs = np.append(np.arange(n_z)[rows], np.arange(n_z, G.n_outputs))
        return StateSpace(
            G.A[np.ix_(kept, kept)],
            G.B[kept][:, columns],
            G.C[np.ix_(outputs, kept)],
            G.D[outputs][:, columns],
            G.dt,
        )

    def hold_bounds(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
        first, second = family.hold_bounds(low, high)
        held = kept[vehicle] - family.vehicle.start
        return first[held], second[held]

    span = slice(vehicle[0], vehicle[-1] + 1) if len(vehicle) else slice(0, 0)
    return replace(family, at=at, vehicle=span, hold_bounds=hold_bounds)


@dataclass(frozen=True)
class Storage:
    """Storage function P(v), linear between knots, in the coordinates x = basis x~.

    Attributes
    ----------
    basis : ndarray (n, n)
    knots : ndarray (K,), m/s
    P : ndarray (K, n, n), at the knots
    adjoint : bool, whether P belongs to the adjoint loop
    """

    basis: np.ndarray
    knots: np.ndarray
    P: np.ndarray
    adjoint: bool = False

    def at(self, v: float) -> np.ndarray:
        """P(v)."""
        return self._continued(self._segment(v), v)

    def _segment(self, v: float) -> int:
        """Index of the segment that contains v; beyond the knots, of the outermost segment."""
        return int(np.clip(np.searchsorted(self.knots, v) - 1, 0, len(self.knots) - 2))

    def _continued(self, k: int, v: float) -> np.ndarray:
        """Linear function of segment k, evaluated at v."""
        share = (v - self.knots[k]) / (self.knots[k + 1] - self.knots[k])
        return (1 - share) * self.P[k] + share * self.P[k + 1]

    @cached_property
    def slopes(self) -> np.ndarray:
        """dP/dv in every segment, (K - 1, n, n)."""
        return np.diff(self.P, axis=0) / np.diff(self.knots)[:, None, None]

    def afterwards(self, low: float, high: float, step: float) -> list[tuple[np.ndarray, np.ndarray]]:
        """Pairs of matrices at ``low`` and ``high`` of one segment that bound P(v+).

        Each pair defines a chord over [low, high]. For every v in it and |v+ - v| <= ``step``, P(v+) is a
        mean of the chords at v. If v + step (or v - step) lies in the same segment for all v, the chords are
        P there and P at the knots between. Otherwise they are P(v) plus a step along the slope of each
        segment between.
        """
        reserve = INSIDE * np.spacing(high)
        own = self._segment(0.5 * (low + high))
        pairs = []
        for sign in (1, -1):
            reached = [self._segment(v + sign * step) for v in (low + reserve, high - reserve)]
            far = sign * max(sign * k for k in reached)
            if reached[0] == reached[1]:
                first, last = min(own, far), max(own, far)
                pairs += [(P, P) for P in self.P[first + 1 : last + 1]]
                ends = [self._continued(far, v + sign * step) for v in (low, high)]
                pairs.append((ends[0], ends[1]))
            else:
                moves = [sign * step * self.slopes[k] for k in range(own, far + sign, sign)]
                pairs += [(self.at(low) + move, self.at(high) + move) for move in moves]
        return pairs

    def cut(self, low: float, high: float, step: float) -> float:
        """Return a speed that cuts low..high.

        It is the speed nearest to the middle with a knot ``step`` away, or else the middle.
        """
        inner = self.knots[1:-1]
        bends = np.concatenate([inner - step, inner + step])
        middle, reserve = 0.5 * (low + high), INSIDE * np.spacing(high)
        bends = bends[(bends > low + reserve) & (bends < high - reserve)]
        return float(min(bends, key=lambda v: abs(v - middle), default=middle))


@dataclass(frozen=True)
class Proof:
    """Result of ``prove``: the number of cells, and the least eigenvalue of F less its remainder.

    The eigenvalue is relative to the mean of the storage's eigenvalues.
    """

    cells: int
    margin: float


@dataclass(frozen=True)
class LpvCertificate:
    """Certificate of a gain below 1 for |dv/dt| <= rate.

    Attributes
    ----------
    rate : float, m/s^2
    storage : Storage
    P : ndarray (3, n, n), P0, P1, P2 in ``storage.basis``, or None
        It is None for Riccati solutions and with ``own_knots``.
    proof : Proof
    not_found : float or None, m/s^2, least rate at which the search failed
    level, gain : float, weights of the loop (least_level.py)
    own_knots : bool, whether P was searched as piecewise linear between the storage's knots
    """

    rate: float
    storage: Storage
    P: np.ndarray | None
    proof: Proof
    not_found: float | None
    level: float = 1.0
    gain: float = 1.0
    own_knots: bool = False


def prove(family: Family, storage: Storage, rate: float) -> Proof | None:
    """Prove a storage function for all speeds between the first and the last node.

    Parameters
    ----------
    family : Family
    storage : Storage
    rate : float, m/s^2, largest |dv/dt|

    Returns
    -------
    Proof, or None if it fails

    References
    ----------
    THEORY 6.
    """
    family = replace(family, adjoint=storage.adjoint)
    ends: dict[float, _End] = {}

    def end(v: float) -> _End:
        if v not in ends:
            ends[v] = _End.at_speed(family, storage, v)
        return ends[v]

    if min(np.linalg.eigvalsh(P)[0] for P in storage.P) <= 0:
        return None
    cells, margin = 0, np.inf
    edges = np.union1d(family.nodes, storage.knots)
    todo = list(itertools.pairwise(map(float, refined(edges, FIRST_CELLS))))
    scale = np.trace(storage.P.mean(axis=0)) / len(storage.basis)
    while todo:
        low, high = todo.pop()
        slack = _cell_slack(family, storage, end(low), end(high), rate)
        if slack is None:
            if high - low < SMALLEST_CELL or cells + len(todo) > MOST_CELLS:
                return None
            between = storage.cut(low, high, rate * family.Ts)
            todo += [(low, between), (between, high)]
        else:
            cells, margin = cells + 1, min(margin, slack / scale)
    return Proof(cells, margin)


@dataclass(frozen=True)
class _End:
    """The loop at one end of a cell: S = [A B; C D] (n + p, n + m) and P.

    The vehicle's share of S is ``left`` Xi(v) ``right``.
    """

    v: float
    S: np.ndarray
    left: np.ndarray
    right: np.ndarray
    P: np.ndarray

    @classmethod
    def at_speed(cls, family: Family, storage: Storage, v: float) -> _End:
        G = family.at(v)
        S = np.vstack(parts_in(family.unprobed(G), storage.basis))
        return cls(v, S, *_share(family, storage.basis, G, S.shape), storage.at(v))

    @cached_property
    def sizes(self) -> tuple[float, float]:
        """Largest row sum of |P|, and the square of the norm of S."""
        return float(np.linalg.norm(self.P, np.inf)), float(np.linalg.norm(self.S, 2) ** 2)


def _share(
    family: Family, basis: np.ndarray, G: StateSpace, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Factors left and right of Xi(v) in S, in the coordinates of ``basis``.

    In the adjoint they are the factors of its transpose. G is the family at v.
    """
    n = len(basis)
    rows, probes = np.eye(n)[:, family.vehicle], np.hstack([G.C, G.D])[G.n_outputs - family.n_probes :]
    if family.adjoint:
        rows, probes = probes.T, rows.T
    left, right = np.zeros((shape[0], rows.shape[1])), np.zeros((len(probes), shape[1]))
    left[: len(rows)], right[:, : probes.shape[1]] = rows, probes
    left[:n], right[:, :n] = np.linalg.solve(basis, left[:n]), right[:, :n] @ basis
    return left, right


def _cell_slack(family: Family, storage: Storage, one: _End, two: _End, rate: float) -> float | None:
    """Least eigenvalue of F less its remainder at both ends of a cell.

    None where this eigenvalue, F or P(v+) is not positive.
    """
    n, width = len(storage.basis), two.v - one.v
    first, second = family.hold_bounds(one.v, two.v)
    S = (one.S, two.S)
    E = np.eye(n, one.S.shape[1])
    dM = two.S[:n] - one.S[:n]
    # The product of Xi and a factor R that varies in the cell deviates from its chord by rho1 R + rho2 dR,
    # with |rho1| <= width^2/8 |Xi''| and |rho2| <= width/4 |Xi'|.
    bound = np.hstack([width**2 / 8 * second] * 2 + [width / 4 * first])
    left, right = one.left, one.right
    if family.adjoint:
        bound, left = bound.T, np.hstack([left, two.left, two.left - left])
    else:
        right = np.vstack([right, two.right, two.right - right])
    slacks = []
    for after in storage.afterwards(one.v, two.v, rate * family.Ts):
        Q = [sl.block_diag(P, np.eye(len(one.S) - n)) for P in after]
        F = [_dissipation(end, q, E) for end, q in zip((one, two), Q, strict=True)]
        if not all(map(_positive, (*after, *F))):
            return None
        inverse, dP = np.linalg.inv(sum(F)), _absolute(after[1] - after[0])
        remainder = 0.25 * _weighed(dM.T @ dP @ dM, sum(s[:n].T @ dP @ s[:n] for s in S), inverse)
        reached = [s.T @ q @ left for s in S for q in Q]
        remainder += _crossed(reached, bound, right, inverse)
        pressed = bound.T @ sum(np.abs(left.T @ q @ left) for q in Q) @ bound.sum(axis=1)
        remainder += (right.T * pressed) @ right
        for end, f, q in zip((one, two), F, Q, strict=True):
            on_P, on_Q = end.sizes
            size = on_P + on_Q * np.linalg.norm(q, np.inf)
            value = np.linalg.eigvalsh(f - remainder)[0] - 4 * len(f) * EPS * size
            if not value > 0:
                return None
            slacks.append(value)
    return float(min(slacks))


def _dissipation(end: _End, Q: np.ndarray, E: np.ndarray) -> np.ndarray:
    F = E.T @ end.P @ E - end.S.T @ Q @ end.S
    k = len(end.P)
    F[k:, k:] += np.eye(len(F) - k)
    return 0.5 * (F + F.T)


def _positive(X: np.ndarray) -> bool:
    """Whether a Cholesky factor of X exists."""
    try:
        np.linalg.cholesky(X)
    except np.linalg.LinAlgError:
        return False
    return True


def _absolute(X: np.ndarray) -> np.ndarray:
    """Absolute value |X| of a symmetric X, with -|X| <= X <= |X|."""
    values, vectors = np.linalg.eigh((X + X.T) / 2)
    return (vectors * np.abs(values)) @ vectors.T


def _weighed(X: np.ndarray, Y: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """eta X + Y / eta for X, Y >= 0, with the eta that minimises its trace times ``inverse``.

    ``inverse`` is the inverse of F.
    """
    x, y = np.sum(inverse * X), np.sum(inverse * Y)
    if not (x > 0 and y > 0):
        return X + Y
    eta = np.sqrt(y / x)
    return eta * X + Y / eta


def _crossed(left: list[np.ndarray], bound: np.ndarray, right: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Upper bound of x rho r + (x rho r)' for every mean x of ``left`` (N, a) and |rho| <= bound (a, b).

    r = ``right`` (b, N). The eta of each product minimises the trace of its bound times ``inverse``.
    """
    x_size = np.sqrt(sum(np.sum(x * (inverse @ x), axis=0) for x in left))
    r_size = np.sqrt(np.sum(right.T * (inverse @ right.T), axis=0))
    x_safe, r_safe = (np.where(size > 0, size, 1.0) for size in (x_size, r_size))
    # A product with a factor 0 is 0 and needs no bound.
    moved, heard = np.any([np.any(x != 0, axis=0) for x in left], axis=0), np.any(right != 0, axis=1)
    on_x, on_r = bound @ (r_safe * heard) / x_safe, (x_safe * moved) @ bound / r_safe
    return sum((x * on_x) @ x.T for x in left) + (right.T * on_r) @ right


def polynomial_storage(family: Family, basis: np.ndarray, P: np.ndarray) -> Storage:
    """Evaluate P0 + v P1 + P2 / v at the knots that refine the family's nodes.

    Parameters
    ----------
    family : Family
    basis : ndarray (n, n), coordinates
    P : ndarray (3, n, n)

    Returns
    -------
    Storage
    """
    knots = refined(family.nodes, KNOTS)
    return Storage(basis, knots, np.tensordot(terms(knots), P, 1), family.adjoint)


def riccati_storage(family: Family) -> Storage | None:
    """Solve the strict bounded-real Riccati equation at every knot.

    Parameters
    ----------
    family : Family

    Returns
    -------
    Storage, or None if the gain at a frozen speed is not below 1
    """
    knots = refined(family.nodes, KNOTS)
    frozen = frozen_at(family, knots)
    return frozen and Storage(frozen[0], knots, frozen[2], family.adjoint)


def frozen_at(family: Family, speeds: np.ndarray):
    """Basis (n, n), pairs ([A B], [C D]) and Riccati solutions (k, n, n) at ``speeds`` (k,), or None.

    One basis serves all speeds.
    """
    loops = [family.loop(v) for v in speeds]
    if not all(G.stability_margin() > 0 for G in loops):
        return None
    basis = _coordinates(loops)
    parts = [parts_in(G, basis) for G in loops]
    frozen = _frozen(parts, family.Ts)
    return None if frozen is None else _even(basis, parts, frozen)


def find(family: Family) -> LpvCertificate | None:
    """Search for the storage function with the largest proved rate, of the adjoint or else of the loop.

    Parameters
    ----------
    family : Family

    Returns
    -------
    LpvCertificate, or None

    References
    ----------
    THEORY 6.
    """
    for adjoint in (True, False):
        one = replace(family, adjoint=adjoint)
        certificate = _polynomial(one) or _riccati(one)
        if certificate is not None:
            return certificate
    return None


def _polynomial(family: Family) -> LpvCertificate | None:
    """Certificate by P0 + v P1 + P2 / v with the largest proved rate."""
    for parts in GRIDS:
        any_feasible, proved = _on_grid(family, refined(family.nodes, parts))
        if proved is not None or not any_feasible:
            return proved
    return None


def _on_grid(family: Family, grid: np.ndarray) -> tuple[bool, LpvCertificate | None]:
    """Search at the speeds ``grid``, and prove between them.

    Returns whether the search succeeded, and the certificate.
    """
    start = frozen_at(family, grid)
    if start is None:
        return False, None
    basis, parts, frozen = start
    search = StorageGrid.from_parts(family.Ts, grid, basis, parts)
    P, unit = search.fitted(frozen), unmoved(parts).F(frozen).mean(axis=0)
    stored: list[tuple[float, np.ndarray]] = []
    failed: float | None = None
    while (rate := _next_rate(stored[-1][0] if stored else None, failed)) is not None:
        solution = feasible(search.barrier(rate), P, unit)
        if solution is not None:
            P = solution
            stored.append((rate, search.coefficients(solution)))
        else:
            failed = rate
    for on_grid, coefficients in reversed(stored):
        storage = polynomial_storage(family, basis, coefficients)
        for share in SHARES:
            proof = prove(family, storage, share * on_grid)
            if proof is not None:
                return True, LpvCertificate(share * on_grid, storage, coefficients, proof, failed)
    return bool(stored), None


def _riccati(family: Family) -> LpvCertificate | None:
    """Certificate by the Riccati solutions at the knots."""
    storage = riccati_storage(family)
    if storage is None:
        return None
    rate = SHARES[-1] * _rate_at_knots(family, storage)
    proof = prove(family, storage, rate)
    return None if proof is None else LpvCertificate(rate, storage, None, proof, None)


def _rate_at_knots(family: Family, storage: Storage) -> float:
    """The largest rate for which F > 0 at the knots."""
    parts = [parts_in(family.loop(v), storage.basis) for v in storage.knots]
    largest = np.inf
    for k, ((M, _), F) in enumerate(zip(parts, unmoved(parts).F(storage.P), strict=True)):
        L = np.linalg.inv(np.linalg.cholesky(F)) @ M.T
        for slope in storage.slopes[max(k - 1, 0) : k + 1]:
            largest = min(largest, 1 / (family.Ts * np.abs(np.linalg.eigvalsh(L @ slope @ L.T)).max()))
    return float(largest)


def _next_rate(reached: float | None, failed: float | None) -> float | None:
    """Next trial rate from the largest feasible and the least failed one [m/s^2]; None ends the search."""
    if reached is None:
        if failed is None:
            return FIRST_RATE
        return failed / 4 if failed / 4 >= SMALLEST_RATE else None
    if failed is None:
        return min(4 * reached, LARGEST_RATE) if reached < LARGEST_RATE else None
    return float(np.sqrt(reached * failed)) if failed > 2.1 * reached else None


def _coordinates(loops: list[StateSpace]) -> np.ndarray:
    """Basis in which both Gramians, summed over the loops, are nearly equal and diagonal.

    States are first scaled to similar Gramians. HIDDEN times the largest entry is added to each Gramian.
    States that are hardly reached or observed then do not make the basis singular. The factors of the
    Gramians are never multiplied, because the products could overflow.
    """
    reach = _rows(np.hstack([_reached(G.A, G.B) for G in loops]))
    seen = _rows(np.hstack([_reached(G.A.T, G.C.T) for G in loops]))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.sqrt(np.linalg.norm(reach, axis=1) / np.linalg.norm(seen, axis=1))
    t = np.where(np.isfinite(t) & (t > 0), t, 1.0)
    R, S = (
        _rows(np.hstack([X, np.sqrt(HIDDEN) * np.linalg.norm(X, axis=1).max() * np.eye(len(t))]))
        for X in (reach / t[:, None], seen * t[:, None])
    )
    _, sigma, Vt = np.linalg.svd(S.T @ R)
    return t[:, None] * (R @ Vt.T / np.sqrt(sigma))


def _reached(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Factor L (n, n) of a Gramian, L L' = A L L' A' + B B', by doubling. A (n, n) is stable."""
    L = _rows(B)
    for _ in range(DOUBLINGS):
        L, A = _rows(np.hstack([L, A @ L])), A @ A
    return L


def _rows(X: np.ndarray) -> np.ndarray:
    """L (n, n) with L L' = X X'."""
    R = np.asarray(np.linalg.qr(np.hstack([X, np.zeros((len(X), len(X)))]).T, mode="r"))
    return R.T


def _frozen(parts: list[tuple[np.ndarray, np.ndarray]], Ts: float) -> np.ndarray | None:
    """Strict solutions (k, n, n) of the bounded-real Riccati equation at every speed, with one slack for all.

    None where the gain at a frozen speed is not below 1.
    """
    for slack in SLACKS:
        out = []
        for M, N in parts:
            n, m = len(M), M.shape[1] - len(M)
            extra = np.sqrt(slack) * np.eye(n)
            B, C = np.hstack([M[:, n:], extra]), np.vstack([N[:, :n], extra])
            D = sl.block_diag(N[:, n:], np.zeros((n, n)))
            if hinf_norm(StateSpace(M[:, :n], B, C, D, Ts), rtol=1e-3).upper >= 1:
                break
            try:
                P = sl.solve_discrete_are(
                    M[:, :n], B, C.T @ C, D.T @ D - np.eye(m + n), s=C.T @ D, balanced=False
                )
            except (
                np.linalg.LinAlgError,
                ValueError,
            ):  # ValueError: the pencil is too ill-conditioned to order
                break
            out.append(0.5 * (P + P.T))
        else:
            return np.array(out)
    return None


def _even(basis, parts, frozen):
    """Coordinates with a diagonal mean of the frozen solutions, and the identity as mean dissipation.

    Slow states lose little of their storage in a step. In other coordinates they would dominate the curvature
    of the barrier.
    """
    n = len(basis)
    lost = unmoved(parts).F(frozen).mean(axis=0)[:n, :n]
    T = sl.eigh(frozen.mean(axis=0), lost)[1]
    wide = [sl.block_diag(T, np.eye(M.shape[1] - n)) for M, _ in parts]
    return (
        basis @ T,
        [(np.linalg.solve(T, M @ W), N @ W) for (M, N), W in zip(parts, wide, strict=True)],
        T.T @ frozen @ T,
    )
