"""Least upper bound of μ by the scalings D and G.

It is the least β with Mᴴ D_L M + j (G M − Mᴴ G) ≼ β² D_R (Fan, Tits & Doyle 1991), a generalised eigenvalue
problem. The method of centres solves it (Boyd & El Ghaoui 1993). With full blocks, β is the least σ̄ of a
scaled M. Where this largest singular value is simple, Newton's method is faster.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.structure import Structure

NEWTON_STEPS, SHORTEST_STEP = 25, 1e-6
"""Limits of Newton's method for a simple largest singular value. Beyond them the method of centres is
used."""
POINT_RTOL = 1e-4
"""Relative accuracy of the bound at one of many frequencies."""
ROUNDED, ABSENT = 1e-12, 1e-40
"""Two shares of ‖M‖: the rounding of a coupling, and a substitute for a coupling that is exactly zero."""
WEAK = 1e-5
"""Couplings of M below this share of its norm do not make the scalings more extreme."""
LEAST_SIZE = 1e-3
"""Least size of M as a share of ‖M‖. Couplings without effect on μ may make up the rest of ‖M‖."""
G_WEIGHT = 0.1
"""Weight of |G|² in the definition of the centre."""
UNFELT = 1e-10
"""A G is left out if all entries of its part of Φ are below this. Where M is real, G has no effect on Φ."""


def upper_bound(
    M: np.ndarray, structure: Structure, rtol: float, target: float = 0.0
) -> tuple[float, float, np.ndarray, np.ndarray, np.ndarray]:
    """Upper bound β of μ for M (Σcols, Σrows), with its scalings.

    Returns β, a lower bound of its infimum, factors L of D_left and D_right (D = L Lᴴ), and G. D_left is
    (Σcols, Σcols), D_right (Σrows, Σrows), G (Σrows, Σcols). The search ends when β is within ``rtol``
    (relative) of the infimum, or when rounding prevents a lower β. With a ``target`` it ends as soon as β is
    below it. The scalings are then the centre of the set that proves ``target``, far from its border.

    After each centre its D + |G| is absorbed into the matrix (N ← Lᴴ N L⁻ᴴ, D + |G| = L Lᴴ). The next step
    therefore starts in well-scaled coordinates, even if the optimal scalings are badly conditioned. D alone
    is not enough: where D of a real block tends to zero, G would grow without limit.
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
        except np.linalg.LinAlgError:  # within rounding the set has no interior: ``best`` is the result
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
    """Return a size of M (Σcols, Σrows) that does not depend on units.

    It is the bound of μ with complex blocks in place of real ones. It is at least ``LEAST_SIZE`` times ‖M‖ in
    balanced units.
    """
    left, right = _both_sides(_balance(M, structure), structure)
    balanced = float(np.linalg.norm(left @ M @ np.linalg.inv(right), 2))
    kinds = {"repeated_real": "repeated_complex"}
    taken = Structure(tuple(replace(b, kind=kinds.get(b.kind, b.kind)) for b in structure.blocks))
    return max(upper_bound(M, taken, POINT_RTOL)[0], LEAST_SIZE * balanced)


def _forms(N: np.ndarray, structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Return Nᴴ E N for the basis E of D, and j (E N − Nᴴ E) for the basis E of G, with N (Σcols, Σrows)."""
    skew = 1j * (structure.skew @ N)
    return N.conj().T @ structure.left @ N, skew + np.conj(np.swapaxes(skew, 1, 2))


def simple_infimum(
    M: np.ndarray, structure: Structure, rtol: float, d: np.ndarray | None = None
) -> tuple[float, float, np.ndarray, np.ndarray, np.ndarray] | None:
    """`upper_bound` of M (Σcols, Σrows) by Newton's method, or None.

    All blocks must be full, and the largest singular value at the infimum must be simple. It is simple for up
    to three blocks, except for special M. ``d`` (blocks,) are the start scales.

    σ̄(D_L^½ M D_R^-½) is convex in the logarithms x of the blocks' scales d (Sezginer & Overton 1990). Where
    it is simple, Newton's method finds its minimum. Let ``z = D_R^-½ v`` with the right singular vector v.
    The least ``‖(M z)_i‖ / ‖z_i‖`` over the blocks is a lower bound for every scaling. At the minimum all of
    these ratios are σ̄.
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
    """σ̄ of the scaled M, its first and second derivatives (k,), (k, k) in x, and a lower bound.

    The lower bound is that of the minimum of σ̄. σ̄ is the largest eigenvalue of [0 N; Nᴴ 0], whose
    derivative by x_i is [P_i N − N Q_i] above the diagonal; ``member`` (k, Σcols + Σrows) holds the diagonals
    of P_i and −Q_i.
    """
    n = len(M)
    N = np.exp(np.repeat(x, rows))[:, None] * M * np.exp(-np.repeat(x, cols))
    both = np.zeros((len(M) + M.shape[1],) * 2, complex)
    both[:n, n:], both[n:, :n] = N, N.conj().T
    values, vectors = np.linalg.eigh(both)
    top, rest = vectors[:, -1], vectors[:, :-1]
    value = float(values[-1])
    weight = np.abs(top) ** 2
    # The derivative is S_i both + both S_i with S_i = diag(P_i, -Q_i), because the diagonal of both is zero.
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

    Couplings below ``WEAK`` times the norm are raised to this size, so that rounding makes no extreme
    scalings.
    """
    return _both_sides(_balance(M, structure, WEAK * float(np.linalg.norm(M))) ** 2, structure)


def triangular_scalings(
    M: np.ndarray, moved: np.ndarray, structure: Structure
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield factors of D_left (Σcols, Σcols) and D_right (Σrows, Σrows), and G, for a nearly triangular M.

    Repeated blocks are transformed to triangular (Schur) form. Each diagonal entry gets the D and G that
    would prove the level 1 for it alone. The couplings are then balanced against the resulting Φ. The first
    scalings count the rounding ``moved`` of the entries of M (both Σcols, Σrows) as couplings, the second
    ones do not.
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
        if own[k] > 0.5 and y:  # then 1 - |m|^2 + 2 g y = 0.5 + |m|^2
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

    Norms below ``least`` are raised to ``least``. Each d_i lies between 1 / ``reach`` and ``reach``.
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
    """β² (in units of size²) that the scalings prove, with an allowance for rounding of cancelling terms."""
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

    Damped Newton steps minimise −log det S − log det D + ½ ``G_WEIGHT`` |G|². Without the last term a G that
    increases all of S would grow without limit.
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
    """Largest distance of the infimum below the level.

    The multipliers Z of the centre prove level − gap ≤ β².

    It is tight only for scalar D_i. With a repeated block it is inf, and the search ends when the levels
    stagnate.
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
