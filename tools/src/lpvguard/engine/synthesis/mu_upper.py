"""The upper bound of μ to its infimum.

It is the least β with  Mᴴ D_L M + j (G M − Mᴴ G) ≼ β² D_R  (Fan, Tits & Doyle 1991), a generalised eigenvalue
problem. The method of centres solves it (Boyd & El Ghaoui 1993). With full blocks it is the least singular
value of a scaled M, and where that is simple Newton's method finds it sooner.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.structure import Structure

NEWTON_STEPS, SHORTEST_STEP = 25, 1e-6
"""Of the search where the largest singular value is simple, before the method of centres takes over."""
POINT_RTOL = 1e-4
"""Of the bound at one of many frequencies."""
ROUNDED, ABSENT = 1e-12, 1e-40
"""Shares of ‖M‖ that rounding may leave of a coupling, and that stand for one that is exactly zero."""
WEAK = 1e-5
"""Couplings of M below this share of its norm make no scalings more extreme."""
LEAST_SIZE = 1e-3
"""Share of ‖M‖ that counts as its size where couplings that Δ does not feel make up the rest."""
G_WEIGHT = 0.1
"""Weight of |G|² in the centre that is searched for."""
UNFELT = 1e-10
"""Entries of a G's part of Φ below this count as zero: where M is real, G has no part in it."""


def upper_bound(
    M: np.ndarray, structure: Structure, rtol: float, target: float = 0.0
) -> tuple[float, float, np.ndarray, np.ndarray, np.ndarray]:
    """β for M (Σcols, Σrows), the infimum's lower bound, factors L of D_left and D_right (D = L Lᴴ), and G.

    D_left is (Σcols, Σcols), D_right (Σrows, Σrows), G (Σrows, Σcols). The search ends when β is within
    ``rtol`` (relative) of the infimum, or when rounding lets it go no lower. With a ``target`` it ends below
    that β. The scalings are then the centre of those that prove ``target``, far from the borders of that set.

    After each centre its D + |G| is absorbed into the matrix (N ← Lᴴ N L⁻ᴴ, D + |G| = L Lᴴ). The next one so
    starts in well-scaled coordinates even where ever worse conditioned scalings approach the infimum. D alone
    would leave an ever larger G where a real block's D vanishes beside it.
    """
    d = _balance(M, structure)
    left, right = _both_sides(d, structure)
    size = float(np.linalg.norm(left @ M @ np.linalg.inv(right), 2))
    G = np.zeros((structure.n_cols, structure.n_rows), complex)
    if size == 0:
        return 0.0, 0.0, left, right, G
    if (simple := simple_infimum(M, structure, rtol, d)) is not None:
        return simple
    trace = np.r_[np.real(np.trace(structure.left, axis1=1, axis2=2)), np.zeros(len(structure.skew))]
    n_d = len(structure.left)
    D_left, D_right = np.eye(structure.n_rows, dtype=complex), np.eye(structure.n_cols, dtype=complex)
    level, best, infimum = 1.1, np.inf, 0.0
    goal = (target / size) ** 2 if target else -np.inf
    kept = left, right, D_left, D_right, G
    for _ in range(300):
        quad, skew = _forms(left.conj().T @ M @ np.linalg.inv(right.conj().T) / size, structure)
        x = structure.coordinates(D_right, G)
        F = np.concatenate([level * structure.right - quad, -skew])
        felt = np.r_[np.ones(n_d, bool), np.abs(skew).max((1, 2), initial=0.0) > UNFELT]
        try:
            x[felt], Z = _centre(x[felt], F[felt], structure, trace[felt])
        except np.linalg.LinAlgError:  # the set has no interior left within rounding: ``best`` is its level
            break
        D_left, D_right = (np.tensordot(x[:n_d], basis, 1) for basis in (structure.left, structure.right))
        infimum = max(infimum, level - _dual_gap(x, Z, structure, trace))
        G = np.tensordot(x[n_d:], structure.skew, 1)
        G_left, G_right = structure.magnitude(G)
        L, R = np.linalg.cholesky(D_left + G_left), np.linalg.cholesky(D_right + G_right)
        left, right = left @ L, right @ R
        L, R = np.linalg.inv(L), np.linalg.inv(R)
        D_left, D_right, G = L @ D_left @ L.conj().T, R @ D_right @ R.conj().T, R @ G @ L.conj().T
        value = _level(M, left, right, D_left, D_right, G, size)
        if value < best or (level == goal and value < goal):
            best, kept = value, (left, right, D_left, D_right, G)
        left, right, D_left, D_right, G = kept
        settled = best <= infimum * (1 + 2 * rtol) or best < 1e-14 or level - best < 1e-3 * rtol * level
        if (level == goal) if best < goal else settled:
            break
        level = goal if best < goal else best + 0.05 * (level - best)
    return (
        size * np.sqrt(max(best, 0.0)),
        size * np.sqrt(infimum),
        left @ np.linalg.cholesky(D_left),
        right @ np.linalg.cholesky(D_right),
        size * right @ G @ left.conj().T,
    )


def scaled_size(M: np.ndarray, structure: Structure) -> float:
    """Return the bound of M (Σcols, Σrows) with its real blocks taken as complex: no units enter it.

    It is at least ``LEAST_SIZE`` of ‖M‖ in balanced units.
    """
    left, right = _both_sides(_balance(M, structure), structure)
    balanced = float(np.linalg.norm(left @ M @ np.linalg.inv(right), 2))
    kinds = {"repeated_real": "repeated_complex"}
    taken = Structure(tuple(replace(b, kind=kinds.get(b.kind, b.kind)) for b in structure.blocks))
    return max(upper_bound(M, taken, POINT_RTOL)[0], LEAST_SIZE * balanced)


def _forms(N: np.ndarray, structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Return Nᴴ E N of each D's basis and j (E N − Nᴴ E) of each G's, for N (Σcols, Σrows)."""
    skew = 1j * (structure.skew @ N)
    return N.conj().T @ structure.left @ N, skew + np.conj(np.swapaxes(skew, 1, 2))


def simple_infimum(
    M: np.ndarray, structure: Structure, rtol: float, d: np.ndarray | None = None
) -> tuple[float, float, np.ndarray, np.ndarray, np.ndarray] | None:
    """`upper_bound` of M (Σcols, Σrows) if all blocks are full and the largest singular value is simple.

    None otherwise. The value at the infimum counts. It is simple for up to three blocks, except for special
    M. ``d`` (blocks,) are the start scales.

    σ̄(D_L^½ M D_R^-½) is convex in the logarithms x of the blocks' scales d (Sezginer & Overton 1990). Where
    it is simple, Newton's method finds its minimum. Let ``z = D_R^-½ v`` with the right singular vector v. No
    scaling goes below the least ``‖(M z)_i‖ / ‖z_i‖`` over the blocks. At the minimum all of these are σ̄.
    """
    k = len(structure.blocks)
    if k == 1 or any(b.kind != "full" for b in structure.blocks):
        return None
    rows, cols = ([getattr(b, side) for b in structure.blocks] for side in ("cols", "rows"))
    member = np.zeros((k, structure.n_rows + structure.n_cols))
    for member_i, r, c in zip(member, structure.row, structure.col, strict=True):
        member_i[r], member_i[structure.n_rows + c.start : structure.n_rows + c.stop] = 1.0, -1.0
    x = np.log(_balance(M, structure) if d is None else d)
    value, slope, curvature, low = _newton_model(M, x, rows, cols, member)
    for _ in range(NEWTON_STEPS):
        if value <= low * (1 + 0.5 * rtol):
            left, right = (_spread(np.exp(x), sizes) for sizes in (rows, cols))
            I_left, I_right = (np.eye(n, dtype=complex) for n in (structure.n_rows, structure.n_cols))
            G = np.zeros((structure.n_cols, structure.n_rows), complex)
            upper = np.sqrt(max(_level(M, left, right, I_left, I_right, G, value), 0.0)) * value
            return upper, min(low, upper), left, right, G
        try:
            step = -np.linalg.solve(curvature[:-1, :-1], slope[:-1])  # a common factor of all scales is free
        except np.linalg.LinAlgError:
            return None
        if not (np.isfinite(step).all() and slope[:-1] @ step < 0):
            return None
        length = min(1.0, 2.0 / np.abs(step).max())
        while length > SHORTEST_STEP:
            ahead = x + np.append(length * step, 0.0)
            there = _newton_model(M, ahead, rows, cols, member)
            if there[0] < value or there[0] <= there[3] * (1 + 0.5 * rtol):
                break
            length *= 0.5
        else:
            return None
        x, (value, slope, curvature, low) = ahead, there
    return None


def _newton_model(
    M: np.ndarray, x: np.ndarray, rows: list[int], cols: list[int], member: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray, float]:
    """σ̄ of the scaled M, its first and second derivatives (k,), (k, k) in x, and the bound from below.

    σ̄ is the largest eigenvalue of [0 N; Nᴴ 0], whose derivative by x_i is [P_i N − N Q_i] above the
    diagonal; ``member`` (k, Σcols + Σrows) holds the diagonals of P_i and −Q_i.
    """
    n = len(M)
    N = np.exp(np.repeat(x, rows))[:, None] * M * np.exp(-np.repeat(x, cols))
    both = np.zeros((len(M) + M.shape[1],) * 2, complex)
    both[:n, n:], both[n:, :n] = N, N.conj().T
    values, vectors = np.linalg.eigh(both)
    top, rest = vectors[:, -1], vectors[:, :-1]
    value = float(values[-1])
    weight = np.abs(top) ** 2
    # S_i both + both S_i with S_i = diag(P_i, -Q_i) is the derivative, for both has zeros on its diagonal.
    turned = member * top
    slope = 2 * value * (member @ weight)
    first = turned @ both.T + value * turned
    second = 2 * np.real(turned.conj() @ both @ turned.T) + 2 * value * (member * weight) @ member.T
    coupled = first @ rest.conj()
    with np.errstate(divide="ignore", invalid="ignore"):  # a double value: the caller sees no finite step
        curvature = second + 2 * np.real((coupled / (value - values[:-1])) @ coupled.conj().T)
    out, into = (member > 0) @ weight, (member < 0) @ weight
    heard = into > 0
    return value, slope, curvature, value * float(np.sqrt(np.min(out[heard] / into[heard])))


def balance(M: np.ndarray, structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Return D_left (Σcols, Σcols) and D_right (Σrows, Σrows) that even out the blocks' norms of M.

    Couplings below ``WEAK`` of the norm count as that large, so that rounding makes no extreme scalings.
    """
    return _both_sides(_balance(M, structure, WEAK * float(np.linalg.norm(M))) ** 2, structure)


def triangular_scalings(
    M: np.ndarray, moved: np.ndarray, structure: Structure
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield factors of D_left (Σcols, Σcols) and D_right (Σrows, Σrows), and G, that suit a nearly
    triangular M.

    Repeated blocks are taken to their triangular (Schur) form. Each number on the diagonal gets the D and G
    that would prove it alone at level 1. Couplings are balanced against the Φ of these. First, rounding
    ``moved`` of the entries of M (both Σcols, Σrows) counts as a coupling, and then none does.
    """
    finer, turns, real = [], [], []
    for block, r, c in zip(structure.blocks, structure.row, structure.col, strict=True):
        alone = block.kind == "full" or block.rows == 1
        finer += [block] if alone else [Block("full", 1, 1)] * block.rows
        real += [block.kind == "repeated_real"] * (1 if alone else block.rows)
        turns.append(
            (np.eye(block.cols), np.eye(block.rows)) if alone else (sl.schur(M[r, c], "complex")[1],) * 2
        )
    one_by_one = Structure(tuple(finer))
    left, right = (sl.block_diag(*sides) for sides in zip(*turns, strict=True))
    turned = left.conj().T @ M @ right
    places = list(zip(one_by_one.row, one_by_one.col, strict=True))
    own = np.array([np.linalg.norm(turned[place]) for place in places])
    g, phi = np.zeros(len(own)), np.ones(len(own))
    for k in np.flatnonzero(real):
        y = turned[places[k]].imag.item()
        if own[k] > 0.5 and y:  # 1 - |m|^2 + 2 g y is 0.5 + |m|^2 then
            g[k], phi[k] = (own[k] ** 2 - 0.25) / y, 0.5 + own[k] ** 2
    rows, cols = ([getattr(b, side) for b in finer] for side in ("cols", "rows"))
    felt = np.repeat(1 + (np.abs(g) + own) / np.sqrt(phi), rows)[:, None] / np.repeat(np.sqrt(phi), cols)
    rounding = np.abs(left).T @ moved @ np.abs(right)
    for couplings, floor in ((np.abs(turned) + rounding, ROUNDED), (np.abs(turned), ABSENT)):
        size = felt * couplings
        scales = _balance(size, one_by_one, floor * float(np.linalg.norm(size)), 1 / floor)
        a, b = _both_sides(scales, one_by_one)
        G = np.zeros((len(b), len(a)), complex)
        for k in np.flatnonzero(g):
            G[places[k][::-1]] = g[k] * scales[k] ** 2
        yield left @ a, right @ b, right @ G @ left.conj().T


def _both_sides(scales: np.ndarray, structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Return the blocks' ``scales`` as diagonal matrices (Σcols, Σcols) and (Σrows, Σrows)."""
    rows, cols = ([getattr(b, side) for b in structure.blocks] for side in ("cols", "rows"))
    return _spread(scales, rows), _spread(scales, cols)


def _spread(scales: np.ndarray, sizes: list[int]) -> np.ndarray:
    """Diagonal complex matrix with each of ``scales`` repeated ``sizes`` times."""
    return np.diag(np.repeat(scales, sizes)).astype(complex)


def _balance(M: np.ndarray, structure: Structure, least: float = 0.0, reach: float = 1e12) -> np.ndarray:
    """Start scalings d_i (Osborne 1960) that even out the Frobenius norms of the blocks' rows and columns.

    Norms below ``least`` count as that large. Each d_i is at most ``reach``, and at least 1 over it.
    """
    k = len(structure.blocks)
    size = np.array([[np.linalg.norm(M[r, c]) for c in structure.col] for r in structure.row])
    size = np.maximum(size, least)
    d = np.ones(k)
    for _ in range(50):
        before = d.copy()
        for i in range(k):
            others = np.arange(k) != i
            r = np.linalg.norm(size[i, others] / d[others])
            c = np.linalg.norm(size[others, i] * d[others])
            if r > 0 and c > 0:
                d[i] = np.clip(np.sqrt(c / r), 1 / reach, reach)
        if np.allclose(before, d, rtol=1e-2):
            break
    return d


def _level(
    M: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
    D_left: np.ndarray,
    D_right: np.ndarray,
    G: np.ndarray,
    size: float,
) -> float:
    """β² (in units of size²) that the scalings prove, rounding of the large terms that cancel included."""
    inverse = np.linalg.inv(right.conj().T)
    N = left.conj().T @ M @ inverse / size
    GN = 1j * (G @ N)
    terms = np.linalg.norm(np.abs(left).T @ np.abs(M) @ np.abs(inverse)) / size
    rounding = 8 * np.finfo(float).eps * terms * (np.linalg.norm(N) + 2 * np.linalg.norm(G))
    W = N.conj().T @ D_left @ N + GN + GN.conj().T + rounding * np.eye(len(D_right))
    return float(sl.eigvalsh(W, D_right)[-1])


def _centre(
    x: np.ndarray, F: np.ndarray, structure: Structure, trace: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre of {S(x) = Σ x_k F_k ≻ 0, D(x) ≻ 0, tr D_left = const}, and S⁻¹ there.

    Damped Newton steps lead to the least of −log det S − log det D + ½ ``G_WEIGHT`` |G|². Without the last
    term a G that lifts all of S would grow without limit.
    """
    n_d = len(structure.left)

    def factors(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (
            np.linalg.cholesky(np.tensordot(point, F, 1)),
            np.linalg.cholesky(np.tensordot(point[:n_d], structure.left, 1)),
        )

    LS, LD = factors(x)
    for _ in range(60):
        WS, WD = _whiten(LS, F), _whiten(LD, structure.left)
        g = -np.real(np.trace(WS, axis1=1, axis2=2))
        g[:n_d] -= np.real(np.trace(WD, axis1=1, axis2=2))
        WS, WD = WS.reshape(len(F), -1), WD.reshape(n_d, -1)
        H = np.real(WS @ WS.conj().T)
        H[:n_d, :n_d] += np.real(WD @ WD.conj().T)
        g[n_d:] += G_WEIGHT * x[n_d:]
        H[n_d:, n_d:] += G_WEIGHT * np.eye(len(x) - n_d)
        scale = 1 / np.sqrt(np.diag(H))
        K = np.zeros((len(x) + 1,) * 2)
        K[:-1, :-1] = H * scale * scale[:, None]
        K[-1, :-1] = K[:-1, -1] = trace * scale / np.linalg.norm(trace * scale)
        step = np.linalg.lstsq(K, np.append(-g * scale, 0.0), rcond=1e-14)[0][:-1] * scale
        decrement = np.sqrt(max(step @ H @ step, 0.0))
        length = 1 / (1 + decrement) if decrement > 0.25 else 1.0
        moved = None
        while moved is None and length > 1e-6:
            try:
                moved = factors(x + length * step)
            except np.linalg.LinAlgError:  # only rounding can leave the set here
                length *= 0.5
        if moved is None:
            break
        x, (LS, LD) = x + length * step, moved
        if decrement < 1e-5:
            break
    inverse = np.linalg.inv(LS)
    return x, inverse.conj().T @ inverse


def _whiten(L: np.ndarray, F: np.ndarray) -> np.ndarray:
    """L⁻¹ F_k L⁻ᴴ for every k."""
    inverse = np.linalg.inv(L)
    return inverse @ F @ inverse.conj().T


def _dual_gap(x: np.ndarray, Z: np.ndarray, structure: Structure, trace: np.ndarray) -> float:
    """How far below the level the infimum can lie: the centre's multipliers Z prove level − gap ≤ β².

    Tight for scalar D_i only; with a repeated block nothing is proved (inf) and the levels' stagnation ends
    the search.
    """
    if any(b.kind != "full" for b in structure.blocks):
        return np.inf
    n_d = len(structure.left)
    D = np.tensordot(x[:n_d], structure.left, 1)
    nu = (len(Z) + len(D)) / (trace @ x)
    slack = nu * np.eye(len(D)) - np.linalg.inv(D)
    return max(
        np.real(np.trace(slack[r, r])) / np.real(np.trace(Z[c, c]))
        for r, c in zip(structure.row, structure.col, strict=True)
    )
