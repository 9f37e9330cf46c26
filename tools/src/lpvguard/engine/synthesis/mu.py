"""Structured singular value: the D,G upper bound to its infimum, and a lower bound by a perturbation that is
checked.

μ(M) = 1 / min{ max_i σ̄(Δ_i) : det(I − M Δ) = 0 } over Δ = diag(Δ_1, Δ_2, ...). Δ is (Σ rows) × (Σ cols) and
M (Σ cols) × (Σ rows) of the blocks: full complex, or δ I with δ complex or real.

Upper bound: the least β with  Mᴴ D_L M + j (G M − Mᴴ G) ≼ β² D_R  (Fan, Tits & Doyle 1991). The method of
centres solves this generalised eigenvalue problem (Boyd & El Ghaoui 1993). The multipliers of each centre
bound the infimum from below, so the returned number is within ``rtol`` of it. It is exact for up to three
full complex blocks. Lower bound: the mixed power iteration (Young & Doyle 1990) from many starts at once. The
Δ it ends with is scaled so that I − M Δ is singular, and that is verified.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.errors import SynthesisError


@dataclass(frozen=True)
class MuBounds:
    """lower ≤ μ ≤ upper. ``infimum``: a value that no D scaling goes below, proved when all blocks are full,
    else 0. ``delta`` (Σrows, Σcols) makes I − M Δ singular with max_i σ̄(Δ_i) = 1/lower; None when lower = 0.
    ``D_left``, ``D_right``: the scaling of ``upper``.
    """

    upper: float
    lower: float
    infimum: float
    delta: np.ndarray | None
    D_left: np.ndarray
    D_right: np.ndarray
    G: np.ndarray


def mu_bounds(M, blocks: Sequence[Block], rtol: float = 1e-8) -> MuBounds:
    """Both bounds of μ for a complex matrix ``M`` (Σcols, Σrows) and a sequence of Block.

    Raises SynthesisError when M is not finite or its shape is not that of the blocks.
    """
    M = np.asarray(M, dtype=complex)
    blocks = tuple(blocks)
    shape = (sum(b.cols for b in blocks), sum(b.rows for b in blocks))
    if M.shape != shape:
        raise SynthesisError(
            "mu", "M", f"shape {M.shape}", f"{shape}, the sums of the blocks' inputs and outputs"
        )
    if not np.all(np.isfinite(M)):
        raise SynthesisError("mu", "M", "a NaN or infinite entry", "finite numbers")
    structure = _Structure(blocks)
    upper, infimum, left, right, G = _upper_bound(M, structure, rtol)
    lower, delta = (
        _lower_bound(M, structure, left, right, upper * (1 - 1e-9), 40) if upper > 0 else (0.0, None)
    )
    D_left, D_right = left @ left.conj().T, right @ right.conj().T
    return MuBounds(upper, min(lower, upper), min(infimum, upper), delta, D_left, D_right, G)


def mu_lower(M, blocks, left, right, enough: float, starts: int = 8) -> tuple[float, np.ndarray | None]:
    """Lower bound of μ and the Δ that attains it; ``left`` M ``right``⁻¹: a well-scaled image of M, which
    speeds it up.

    The search ends early at a value of ``enough``.
    """
    return _lower_bound(np.asarray(M, dtype=complex), _Structure(tuple(blocks)), left, right, enough, starts)


class _Structure:
    """Index sets of the blocks in the rows (inputs of Δ) and columns (outputs of Δ) of M, and the real bases
    of their D and G scalings."""

    def __init__(self, blocks):
        self.blocks = blocks
        rows = np.cumsum([0] + [b.cols for b in blocks])
        cols = np.cumsum([0] + [b.rows for b in blocks])
        self.row = [slice(a, b) for a, b in itertools.pairwise(rows)]
        self.col = [slice(a, b) for a, b in itertools.pairwise(cols)]
        self.n_rows, self.n_cols = int(rows[-1]), int(cols[-1])
        left, right, skew = [], [], []
        for b, r, c in zip(blocks, self.row, self.col, strict=True):
            for E in [None] if b.kind == "full" else _hermitian_basis(b.rows):
                EL, ER = np.zeros((self.n_rows,) * 2, complex), np.zeros((self.n_cols,) * 2, complex)
                EL[r, r] = np.eye(b.cols) if E is None else E
                ER[c, c] = np.eye(b.rows) if E is None else E
                left.append(EL)
                right.append(ER)
            if b.kind == "repeated_real":
                for E in _hermitian_basis(b.rows):
                    G = np.zeros((self.n_cols, self.n_rows), complex)
                    G[c, r] = E
                    skew.append(G)
        self.left, self.right = np.array(left), np.array(right)
        self.skew = np.array(skew) if skew else np.zeros((0, self.n_cols, self.n_rows), complex)
        self.complex_only = all(b.kind != "repeated_real" for b in blocks)

    def coordinates(self, D, G) -> np.ndarray:
        """Coefficients of ``D`` in the (orthogonal) basis ``right`` and of ``G`` in ``skew``."""
        parts = [
            np.real(np.sum(basis.conj() * value, axis=(1, 2))) / np.sum(np.abs(basis) ** 2, axis=(1, 2))
            for basis, value in ((self.right, D), (self.skew, G))
        ]
        return np.concatenate(parts)

    def magnitude(self, G) -> tuple[np.ndarray, np.ndarray]:
        """|G| = (G²)^½ in the places of D_left and of D_right."""
        left, right = np.zeros((self.n_rows,) * 2, complex), np.zeros((self.n_cols,) * 2, complex)
        for b, r, c in zip(self.blocks, self.row, self.col, strict=True):
            if b.kind == "repeated_real":
                values, vectors = np.linalg.eigh(G[c, r])
                left[r, r] = right[c, c] = vectors * np.abs(values) @ vectors.conj().T
        return left, right


def _hermitian_basis(n: int) -> list[np.ndarray]:
    out = []
    for i in range(n):
        for j in range(i, n):
            E = np.zeros((n, n), complex)
            E[i, j] = E[j, i] = 1
            out.append(E)
            if j > i:
                E = np.zeros((n, n), complex)
                E[i, j], E[j, i] = 1j, -1j
                out.append(E)
    return out


def _balance(M, structure) -> np.ndarray:
    """Start scalings d_i (Osborne 1960) that even out the Frobenius norms of the blocks' rows and columns."""
    k = len(structure.blocks)
    size = np.array([[np.linalg.norm(M[r, c]) for c in structure.col] for r in structure.row])
    d = np.ones(k)
    for _ in range(50):
        before = d.copy()
        for i in range(k):
            others = np.arange(k) != i
            r = np.linalg.norm(size[i, others] / d[others])
            c = np.linalg.norm(size[others, i] * d[others])
            if r > 0 and c > 0:
                d[i] = np.clip(np.sqrt(c / r), 1e-12, 1e12)
        if np.allclose(before, d, rtol=1e-2):
            break
    return d


def _upper_bound(M, structure, rtol):
    """β, the infimum's lower bound, factors L of D_left and D_right (D = L Lᴴ) and G by the method of
    centres.

    After each centre its D + |G| is absorbed into the matrix (N ← Lᴴ N L⁻ᴴ, D + |G| = L Lᴴ). The next one so
    starts in well-scaled coordinates even where ever worse conditioned scalings approach the infimum. D alone
    would leave an ever larger G where a real block's D vanishes beside it.
    """
    d = _balance(M, structure)
    left = np.diag(
        np.concatenate([np.full(b.cols, s) for b, s in zip(structure.blocks, d, strict=True)])
    ).astype(complex)
    right = np.diag(
        np.concatenate([np.full(b.rows, s) for b, s in zip(structure.blocks, d, strict=True)])
    ).astype(complex)
    size = np.linalg.norm(left @ M @ np.linalg.inv(right), 2)
    G = np.zeros((structure.n_cols, structure.n_rows), complex)
    if size == 0:
        return 0.0, 0.0, left, right, G
    trace = np.concatenate(
        [np.real(np.trace(structure.left, axis1=1, axis2=2)), np.zeros(len(structure.skew))]
    )
    n_d = len(structure.left)
    D_left, D_right = np.eye(structure.n_rows, dtype=complex), np.eye(structure.n_cols, dtype=complex)
    level, best, infimum = 1.1, np.inf, 0.0
    kept = left, right, D_left, D_right, G
    for _ in range(300):
        N = left.conj().T @ M @ np.linalg.inv(right.conj().T) / size
        quad = N.conj().T @ structure.left @ N
        skew = 1j * (structure.skew @ N)
        skew = skew + np.conj(np.swapaxes(skew, 1, 2))
        x = structure.coordinates(D_right, G)
        F = np.concatenate([level * structure.right - quad, -skew])
        try:
            x, Z = _centre(x, F, structure, trace)
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
        if value < best:
            best, kept = value, (left, right, D_left, D_right, G)
        left, right, D_left, D_right, G = kept
        if best <= infimum * (1 + 2 * rtol) or best < 1e-14 or level - best < 1e-3 * rtol * level:
            break
        level = best + 0.05 * (level - best)
    left, right, D_left, D_right, G = kept
    return (
        size * np.sqrt(max(best, 0.0)),
        size * np.sqrt(max(infimum, 0.0)),
        left @ np.linalg.cholesky(D_left),
        right @ np.linalg.cholesky(D_right),
        size * right @ G @ left.conj().T,
    )


def _level(M, left, right, D_left, D_right, G, size) -> float:
    """β² (in units of size²) that the scalings prove, rounding of the large terms that cancel included."""
    inverse = np.linalg.inv(right.conj().T)
    N = left.conj().T @ M @ inverse / size
    GN = 1j * (G @ N)
    terms = np.linalg.norm(np.abs(left).T @ np.abs(M) @ np.abs(inverse)) / size
    rounding = 8 * np.finfo(float).eps * terms * (np.linalg.norm(N) + 2 * np.linalg.norm(G))
    W = N.conj().T @ D_left @ N + GN + GN.conj().T + rounding * np.eye(len(D_right))
    return float(sl.eigvalsh(W, D_right)[-1])


def _centre(x, F, structure, trace):
    """Analytic centre of {S(x) = Σ x_k F_k ≻ 0, D(x) ≻ 0, tr D_left = const} by damped Newton; x and S⁻¹
    there.
    """
    n_d = len(structure.left)

    def factors(point):
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


def _whiten(L, F):
    """L⁻¹ F_k L⁻ᴴ for every k."""
    inverse = np.linalg.inv(L)
    return inverse @ F @ inverse.conj().T


def _dual_gap(x, Z, structure, trace) -> float:
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


def _lower_bound(M, structure, left, right, enough: float, starts: int, steps: int = 200):
    """Largest β found with I − M Δ singular and max σ̄(Δ_i) = 1/β, and that Δ; (0, None) when none was found.

    The factors of the upper bound's scalings commute with Δ, so the iteration runs on the scaled,
    well-balanced matrix.
    """
    N = left.conj().T @ M @ np.linalg.inv(right.conj().T)
    scaled = N / np.linalg.norm(N, 2)
    candidates = _power_iteration(scaled, structure, starts, steps)
    found = []
    for parts in candidates + _vertices(structure, candidates[-1]):
        value, delta = _make_singular(M, structure, parts)
        if value > 0 and _is_singular(M, delta):
            found.append((value, delta, parts))
    found.sort(key=lambda one: -one[0])
    if structure.complex_only:
        for _, _, parts in found[:3]:
            if found[0][0] >= enough:
                break
            value, delta = _make_singular(M, structure, _align(scaled, structure, parts))
            if value > found[0][0] and _is_singular(M, delta):
                found.insert(0, (value, delta, parts))
    elif any(b.kind != "repeated_real" for b in structure.blocks):
        for value, _, parts in _distinct(found)[:6]:
            if found[0][0] >= enough:
                break
            value, delta = _MixedAscent(M, structure, parts).run(value)
            if value > found[0][0] and _is_singular(M, delta):
                found.insert(0, (value, delta, parts))
    return found[0][:2] if found else (0.0, None)


def _distinct(found) -> list:
    """Of candidates sorted by value those that differ in it by more than rounding."""
    return [one for k, one in enumerate(found) if k == 0 or one[0] < found[k - 1][0] * (1 - 1e-6)]


def _vertices(structure, parts) -> list[list]:
    """``parts`` with the real blocks at every combination of ±1 (up to 64 of them): where a pure real optimum
    often lies.
    """
    real = [k for k, b in enumerate(structure.blocks) if b.kind == "repeated_real"]
    out = []
    for signs in range(2 ** max(min(len(real), 7) - 1, 0) if real else 0):
        one = list(parts)
        for j, k in enumerate(real):
            one[k] = -1.0 if j and signs >> (j - 1) & 1 else 1.0
        out.append(one)
    return out


def _align(M, structure, parts, steps: int = 200) -> list:
    """Local ascent of ρ(M Q) over complex Q: each block turned to the gradient at the eigenvectors."""
    value = 0.0
    for _ in range(steps):
        Q = _assemble(structure, parts)
        values, left, right = sl.eig(M @ Q, left=True)
        k = int(np.argmax(np.abs(values)))
        x, y = right[:, k], M.conj().T @ left[:, k]
        inner = np.vdot(left[:, k], x)
        turn = values[k] / max(abs(values[k]), 1e-300) * inner / max(abs(inner), 1e-300)
        new = []
        for block, r, c in zip(structure.blocks, structure.row, structure.col, strict=True):
            if block.kind == "full":
                new.append(
                    turn
                    * np.outer(y[c], x[r].conj())
                    / max(np.linalg.norm(y[c]) * np.linalg.norm(x[r]), 1e-300)
                )
            else:
                overlap = np.vdot(x[r], y[c])
                new.append(turn * overlap / max(abs(overlap), 1e-300))
        if abs(values[k]) <= value * (1 + 1e-13):
            break
        value, parts = abs(values[k]), new
    return parts


class _MixedAscent:
    """Local search over a mixed Δ: the real blocks q/β are closed first, the complex ones are aligned to what
    is left.

    At a level β that is reached, any q for which the rest N(β, q) has ρ(N Q) > β raises the level; a pattern
    search on q in [−1, 1] looks for one, and a secant search on β finds the level at which ρ(N Q) = β again.
    """

    def __init__(self, M, structure, parts):
        real = [b.kind == "repeated_real" for b in structure.blocks]
        self.structure, self.real = structure, real

        def join(slices: list[slice], kind: bool) -> np.ndarray:
            return np.concatenate([np.r_[s] for s, r in zip(slices, real, strict=True) if r == kind])

        self.r_row, self.r_col = join(structure.row, True), join(structure.col, True)
        c_row, c_col = join(structure.row, False), join(structure.col, False)
        self.rest = _Structure(tuple(b for b, r in zip(structure.blocks, real, strict=True) if not r))
        self.sizes = [b.rows for b, r in zip(structure.blocks, real, strict=True) if r]
        self.Mcc, self.Mcr = M[np.ix_(c_row, c_col)], M[np.ix_(c_row, self.r_col)]
        self.Mrc, self.Mrr = M[np.ix_(self.r_row, c_col)], M[np.ix_(self.r_row, self.r_col)]
        self.q = np.array([p for p, r in zip(parts, real, strict=True) if r])
        self.parts = [p for p, r in zip(parts, real, strict=True) if not r]

    def spectral(self, q, beta, parts):
        """ρ(N(β, q) Q) with Q aligned from ``parts``: the eigenvalue and the aligned parts; 0 where N does
        not exist.
        """
        diagonal = np.repeat(q, self.sizes) / beta
        try:
            inner = np.linalg.solve(np.eye(len(diagonal)) - self.Mrr * diagonal, self.Mrc)
        except np.linalg.LinAlgError:
            return 0.0, parts
        N = self.Mcc + self.Mcr * diagonal @ inner
        parts = _align(N, self.rest, parts, steps=20)
        values = np.linalg.eigvals(N @ _assemble(self.rest, parts))
        return values[np.argmax(np.abs(values))], parts

    def run(self, beta, budget: int = 120):
        """Search from level ``beta``; the level reached and Δ there."""
        size = 0.4
        beta, value = self.level(self.q, beta, self.parts)
        while size > 1e-5 and budget > 0:
            better = False
            for k in range(len(self.q)):
                for sign in (1, -1):
                    trial = self.q.copy()
                    trial[k] = np.clip(trial[k] + sign * size, -1, 1)
                    if trial[k] == self.q[k]:
                        continue
                    budget -= 1
                    found, parts = self.spectral(trial, beta, self.parts)
                    if abs(found) > beta * (1 + 1e-9):
                        self.q, self.parts, better = trial, parts, True
                        beta, value = self.level(trial, beta, parts)
            size *= 1.0 if better else 0.4
        q, rest = iter(self.q), iter(self.parts)
        full = [next(q) if r else next(rest) * (abs(value) / value if value else 1.0) for r in self.real]
        return beta, _assemble(self.structure, full) / beta

    def level(self, q, beta, parts):
        """The β ≥ about ``beta`` at which ρ(N(β, q) Q) = β, by secant steps; and the eigenvalue there."""
        low, value = beta, 0.0
        f0 = None
        for _ in range(40):
            value, parts = self.spectral(q, beta, parts)
            f1 = np.log(max(abs(value), 1e-300) / beta)
            if abs(f1) < 1e-13:
                break
            secant = f0 is not None and f0 != f1
            step = -f1 * (np.log(beta) - np.log(low)) / (f1 - f0) if secant else f1
            low, f0 = beta, f1
            beta *= np.exp(np.clip(step, -0.5, 0.5))
        self.parts = parts
        return beta, value


def _power_iteration(N, structure, starts, steps) -> list[list]:
    """Unit-size perturbations, per block an array (full) or a number, from ``starts`` runs side by side."""
    rng = np.random.default_rng(1)
    count = starts + min(N.shape)
    b = rng.standard_normal((N.shape[1], count)) + 1j * rng.standard_normal((N.shape[1], count))
    b[:, starts:] = np.linalg.svd(N)[2][: count - starts].conj().T
    w = b.copy()
    q = np.where(np.arange(count) % 2, rng.uniform(-1, 1, (len(structure.blocks), count)), 1.0)
    z = np.zeros((N.shape[0], count), complex)
    tiny = 1e-300
    for _ in range(steps):
        a = _unit(N @ b)
        for k, (block, r, c) in enumerate(zip(structure.blocks, structure.row, structure.col, strict=True)):
            if block.kind == "full":
                z[r] = a[r] * (np.linalg.norm(w[c], axis=0) / (np.linalg.norm(a[r], axis=0) + tiny))
            else:
                z[r] = w[c] * _factor(block, a[r], w[c], b[c], q, k)
        w = _unit(N.conj().T @ z)
        before = b
        b = np.empty_like(b)
        for k, (block, r, c) in enumerate(zip(structure.blocks, structure.row, structure.col, strict=True)):
            if block.kind == "full":
                b[c] = w[c] * (np.linalg.norm(a[r], axis=0) / (np.linalg.norm(w[c], axis=0) + tiny))
            else:
                b[c] = a[r] * np.conj(_factor(block, a[r], w[c], before[c], q, k))
        if np.abs(b - before).max() < 1e-13:
            break
    out = []
    for s in range(count):
        parts = []
        for k, (block, r, c) in enumerate(zip(structure.blocks, structure.row, structure.col, strict=True)):
            u, v = w[c, s], a[r, s]
            if block.kind == "full":
                parts.append(np.outer(u, v.conj()) / max(np.linalg.norm(u) * np.linalg.norm(v), tiny))
            elif block.kind == "repeated_complex":
                inner = np.vdot(v, u)
                parts.append(inner / abs(inner) if abs(inner) > 0 else 1.0 + 0j)
            else:
                parts.append(float(q[k, s]))
        out.append(parts)
    return out


def _factor(block, a, w, b, q, k):
    """The number that a repeated block multiplies by: a phase, or q in [−1, 1] (updated in place)."""
    inner = np.sum(w.conj() * a, axis=0)
    if block.kind == "repeated_complex":
        return np.where(np.abs(inner) > 0, inner / np.maximum(np.abs(inner), 1e-300), 1.0)
    step = (
        np.sign(q[k]) * np.linalg.norm(b, axis=0) / np.maximum(np.linalg.norm(a, axis=0), 1e-300) + inner.real
    )
    q[k] = np.clip(np.where(step == 0, 1e-3, step), -1, 1)
    return q[k]


def _unit(v):
    return v / np.maximum(np.linalg.norm(v, axis=0), 1e-300)


def _assemble(structure, parts, turn=1.0):
    """Δ from its parts, complex blocks turned by the phase ``turn``."""
    delta = np.zeros((structure.n_cols, structure.n_rows), complex)
    for block, r, c, part in zip(structure.blocks, structure.row, structure.col, parts, strict=True):
        if block.kind == "full":
            delta[c, r] = part * turn
        else:
            delta[c, r] = np.eye(block.rows) * (part if block.kind == "repeated_real" else part * turn)
    return delta


def _make_singular(M, structure, parts):
    """Scale a unit perturbation to Δ with I − M Δ singular; (β, Δ) or (0, None)."""
    if structure.complex_only:
        delta = _assemble(structure, parts)
        values = np.linalg.eigvals(M @ delta)
        value = values[np.argmax(np.abs(values))]
        return (abs(value), delta / value) if abs(value) > 0 else (0.0, None)
    best, found = 0.0, None
    for vary in _free_parameters(structure, parts):
        for start in np.linalg.eigvals(M @ vary(0.0)):
            value, delta = _make_real(M, vary, start)
            # a Δ whose blocks all lie inside their bounds is smaller than 1/value
            value = 1 / _size(structure, delta) if value > 0 else 0.0
            if value > best:
                best, found = value, delta
    return best, found


def _size(structure, delta) -> float:
    """max_i σ̄(Δ_i)."""
    return max(
        float(np.linalg.norm(delta[c, r], 2)) for r, c in zip(structure.row, structure.col, strict=True)
    )


def _free_parameters(structure, parts):
    """One-parameter families through a mixed Δ that keep its size: turn the complex blocks, or move one real
    block.
    """
    if any(b.kind != "repeated_real" for b in structure.blocks):
        yield lambda s: _assemble(structure, parts, np.exp(1j * s))
    for k, block in enumerate(structure.blocks):
        if block.kind == "repeated_real":

            def move(s, k=k):
                return _assemble(
                    structure, [*parts[:k], float(np.clip(parts[k] + s, -1, 1)), *parts[k + 1 :]]
                )

            yield move


def _make_real(M, vary, start):
    """Secant steps take the eigenvalue ``start`` of M Δ(s) to the real axis; (β, Δ(s)/±β) or (0, None)."""
    s0, value = 0.0, start
    s1 = 1e-4
    f0 = value.imag
    for _ in range(30):
        if abs(value.imag) <= 1e-13 * abs(value):
            break
        values = np.linalg.eigvals(M @ vary(s1))
        value = values[np.argmin(np.abs(values - value))]
        f1 = value.imag
        if f1 == f0:
            break
        s0, s1, f0 = s1, s1 - np.clip(f1 * (s1 - s0) / (f1 - f0), -0.5, 0.5), f1
    else:
        return 0.0, None
    if abs(value.imag) > 1e-11 * abs(value) or value.real == 0:
        return 0.0, None
    delta = vary(s0 if abs(start.imag) > 1e-13 * abs(start) else 0.0)
    return abs(value.real), delta / value.real


def _is_singular(M, delta) -> bool:
    """det(I − M Δ) = 0 within rounding."""
    sigma = np.linalg.svd(np.eye(len(M)) - M @ delta, compute_uv=False)
    return bool(sigma[-1] <= 1e-9 * max(sigma[0], 1.0))
