"""Lower bound of μ by a Δ with I − M Δ singular: a search from many starts, and a check.

Where the upper bound is attained at a simple singular value, the singular vectors give Δ. Otherwise the mixed
power iteration (Young & Doyle 1990) gives candidates. A local ascent improves the best candidates where
blocks are complex or mixed.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.mu_upper import simple_infimum
from lpvguard.engine.synthesis.real_crossings import is_singular
from lpvguard.engine.synthesis.statespace import EPS
from lpvguard.engine.synthesis.structure import Structure

ATTAINED_RTOL = 1e-10
"""Relative accuracy of an attained upper bound."""
SINGULAR_RTOL = 1e-11
TINY = 1e-300
Parts = list[np.ndarray | complex]
"""A Δ of unit size, block by block: a matrix for a full block, a number for a repeated block."""
_Found = tuple[float, np.ndarray, Parts]
"""A lower bound, the Δ that attains it, and the parts of this Δ."""


def lower_bound(
    M: np.ndarray,
    structure: Structure,
    left: np.ndarray,
    right: np.ndarray,
    enough: float,
    starts: int,
    steps: int = 200,
    vectors: Sequence[np.ndarray] = (),
) -> tuple[float, np.ndarray | None]:
    """Largest β = 1/max σ̄(Δ_i) with I − M Δ singular that the search reaches, and Δ, or (0, None).

    ``vectors``, each (Σrows,), are guesses of an x with M Δ x = x, from the scalings of the upper bound. The
    factors of these scalings commute with Δ. The iteration therefore runs on the scaled, well-balanced
    matrix.
    """
    if not M.any():
        return 0.0, None
    if (meeting := _attained(M, structure, left)) is not None:
        return meeting
    N = left.conj().T @ M @ np.linalg.inv(right.conj().T)
    scaled = N / np.linalg.norm(N, 2)
    candidates = _power_iteration(scaled, structure, starts, steps)
    candidates[:0] = [_parts_of(M, structure, x, enough) for x in vectors]
    tried = (_checked(M, structure, parts) for parts in candidates + _vertices(structure, candidates[-1]))
    checked = sorted((one for one in tried if one), key=lambda one: -one[0])
    if structure.complex_only:
        for _, _, parts in checked[:3]:
            if checked[0][0] >= enough:
                break
            if one := _checked(M, structure, _align(scaled, structure, parts), checked[0][0]):
                checked.insert(0, one)
    elif any(b.kind != "repeated_real" for b in structure.blocks):
        for value, _, parts in _distinct(checked)[:6]:
            if checked[0][0] >= enough:
                break
            value, delta = _MixedAscent(M, structure, parts).run(value)
            if value > checked[0][0] and _is_singular(M, delta):
                checked.insert(0, (value, delta, parts))
    return checked[0][:2] if checked else (0.0, None)


def attained(M: np.ndarray, structure: Structure, delta: np.ndarray, moved: np.ndarray) -> float:
    """Return the lower bound of μ that a Δ proves, 1 / max_i σ̄(Δ_i), or 0.

    ``delta`` (Σrows, Σcols) proves it if it has the structure of the blocks and makes I − M Δ singular. M is
    (Σcols, Σrows), and ``moved`` is the rounding of its entries.
    """
    rest = np.array(delta, complex)
    for block, r, c in _places(structure):
        if block.kind != "full":
            number = rest[c.start, r.start]
            number = number.real if block.kind == "repeated_real" else number
            if np.abs(rest[c, r] - number * np.eye(block.rows)).max() > 8 * EPS * abs(number):
                return 0.0
        rest[c, r] = 0.0
    if rest.any() or not np.any(delta) or not is_singular(M, delta, moved):
        return 0.0
    return 1 / _size(structure, delta)


def _parts_of(M: np.ndarray, structure: Structure, x: np.ndarray, level: float) -> Parts:
    """Return the parts of the Δ of unit size for which ``level`` Δ M x is nearest to x in each block."""
    z = M @ x
    parts: Parts = []
    for block, r, c in _places(structure):
        if block.kind == "full":
            parts.append(_rank_one(x[c], z[r]))
        elif block.kind == "repeated_complex":
            parts.append(_phase(np.vdot(z[r], x[c])))
        else:
            ratio = np.vdot(z[r], x[c]).real / max(np.linalg.norm(z[r]) ** 2, TINY)
            parts.append(float(np.clip(level * ratio, -1, 1)))
    return parts


def _checked(M: np.ndarray, structure: Structure, parts: Parts, least: float = 0.0) -> _Found | None:
    """The lower bound that ``parts`` attain, or None where it is not above ``least`` or the check fails."""
    if not all(np.isfinite(part).all() for part in parts):  # extreme scalings
        return None
    value, delta = _make_singular(M, structure, parts)
    return (value, delta, parts) if delta is not None and value > least and _is_singular(M, delta) else None


def _attained(M: np.ndarray, structure: Structure, start: np.ndarray) -> tuple[float, np.ndarray] | None:
    """The upper bound and the Δ that attains it, for full blocks and a simple largest singular value.

    The blocks u_i and v_i of the singular vectors u, v then have equal lengths, and Δ_i maps u_i to v_i. The
    result is None otherwise. ``start`` (Σcols, Σcols) is a factor of D_left near that of the bound.
    """
    scales = np.array([abs(start[r.start, r.start]) for r in structure.row])
    if (infimum := simple_infimum(M, structure, ATTAINED_RTOL, scales)) is None:
        return None
    upper, _, left, right, _ = infimum
    u, _, v = np.linalg.svd(left @ M @ np.linalg.inv(right))
    u, v = u[:, 0], v[0].conj()
    parts: Parts = [_rank_one(v[c], u[r]) for _, r, c in _places(structure)]
    meeting = _checked(M, structure, parts, upper * (1 - 10 * ATTAINED_RTOL))
    return meeting and meeting[:2]


def _places(structure: Structure) -> list[tuple[Block, slice, slice]]:
    """The blocks with their rows and columns of M."""
    return list(zip(structure.blocks, structure.row, structure.col, strict=True))


def _distinct(candidates: list[_Found]) -> list[_Found]:
    """Candidates, sorted by value, whose values differ by more than rounding."""
    return [one for k, one in enumerate(candidates) if k == 0 or one[0] < candidates[k - 1][0] * (1 - 1e-6)]


def _vertices(structure: Structure, parts: Parts) -> list[Parts]:
    """``parts`` with up to 64 combinations of ±1 for the real blocks.

    A purely real optimum often lies there.
    """
    real = [k for k, b in enumerate(structure.blocks) if b.kind == "repeated_real"]
    if not real:
        return []
    out = []
    for signs in range(2 ** (min(len(real), 7) - 1)):
        one = list(parts)
        for j, k in enumerate(real):
            one[k] = -1.0 if j and signs >> (j - 1) & 1 else 1.0
        out.append(one)
    return out


def _align(M: np.ndarray, structure: Structure, parts: Parts, steps: int = 200) -> Parts:
    """Local ascent of ρ(M Q) over complex Q.

    Each step aligns each block with the gradient at the eigenvectors.
    """
    value = 0.0
    for _ in range(steps):
        Q = _assemble(structure, parts)
        values, left, right = sl.eig(M @ Q, left=True)
        k = int(np.argmax(np.abs(values)))
        if abs(values[k]) <= value * (1 + 1e-13):
            break
        value = abs(values[k])
        x, y = right[:, k], M.conj().T @ left[:, k]
        turn = _phase(values[k]) * _phase(np.vdot(left[:, k], x))
        parts = [
            turn * (_rank_one(y[c], x[r]) if block.kind == "full" else _phase(np.vdot(x[r], y[c])))
            for block, r, c in _places(structure)
        ]
    return parts


class _MixedAscent:
    """Local search over a mixed Δ.

    The real blocks q/β are closed first and leave a matrix N(β, q). The complex blocks Q are then aligned to
    N. If β is attained, any q with ρ(N Q) > β gives a higher level. A pattern search on q in [−1, 1] searches
    for such a q. A secant search then finds the new β with ρ(N Q) = β.
    """

    def __init__(self, M: np.ndarray, structure: Structure, parts: Parts):
        blocks = structure.blocks
        self.structure = structure
        self.real = [k for k, b in enumerate(blocks) if b.kind == "repeated_real"]
        rest = [k for k in range(len(blocks)) if k not in self.real]

        def join(slices: list[slice], indices: list[int]) -> np.ndarray:
            return np.concatenate([np.r_[slices[k]] for k in indices])

        r_row, r_col = join(structure.row, self.real), join(structure.col, self.real)
        c_row, c_col = join(structure.row, rest), join(structure.col, rest)
        self.rest = Structure(tuple(blocks[k] for k in rest))
        self.sizes = [blocks[k].rows for k in self.real]
        self.Mcc, self.Mcr = M[np.ix_(c_row, c_col)], M[np.ix_(c_row, r_col)]
        self.Mrc, self.Mrr = M[np.ix_(r_row, c_col)], M[np.ix_(r_row, r_col)]
        self.q = np.array([parts[k] for k in self.real])
        self.parts = [parts[k] for k in rest]

    def spectral(self, q: np.ndarray, beta: float, parts: Parts) -> tuple[complex, Parts]:
        """Largest eigenvalue of N(β, q) Q after alignment of Q from ``parts``, and the aligned parts.

        The eigenvalue is 0 where N does not exist.
        """
        diagonal = np.repeat(q, self.sizes) / beta
        try:
            inner = np.linalg.solve(np.eye(len(diagonal)) - self.Mrr * diagonal, self.Mrc)
        except np.linalg.LinAlgError:
            return 0.0, parts
        N = self.Mcc + self.Mcr * diagonal @ inner
        parts = _align(N, self.rest, parts, steps=20)
        return _largest_eigenvalue(N @ _assemble(self.rest, parts)), parts

    def run(self, beta: float, budget: int = 120) -> tuple[float, np.ndarray]:
        """Search from the level ``beta``. Returns the final level and its Δ."""
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
                    eigenvalue, parts = self.spectral(trial, beta, self.parts)
                    if abs(eigenvalue) > beta * (1 + 1e-9):
                        self.q, self.parts, better = trial, parts, True
                        beta, value = self.level(trial, beta, parts)
            if not better:
                size *= 0.4
        q, rest = iter(self.q), iter(self.parts)
        full = [
            next(q) if k in self.real else next(rest) / _phase(value)
            for k in range(len(self.structure.blocks))
        ]
        return beta, _assemble(self.structure, full) / beta

    def level(self, q: np.ndarray, beta: float, parts: Parts) -> tuple[float, complex]:
        """The β near or above ``beta`` with ρ(N(β, q) Q) = β, by secant steps, and the eigenvalue there."""
        low, f0 = beta, None
        for _ in range(40):
            value, parts = self.spectral(q, beta, parts)
            f1 = np.log(max(abs(value), TINY) / beta)
            if abs(f1) < 1e-13:
                break
            secant = f0 is not None and f0 != f1
            step = -f1 * (np.log(beta) - np.log(low)) / (f1 - f0) if secant else f1
            low, f0 = beta, f1
            beta *= np.exp(np.clip(step, -0.5, 0.5))
        self.parts = parts
        return beta, value


@np.errstate(
    over="ignore", invalid="ignore", divide="ignore"
)  # extreme scalings; ``_checked`` drops their results
def _power_iteration(N: np.ndarray, structure: Structure, starts: int, steps: int) -> list[Parts]:
    """Candidate parts of unit size, from ``starts`` parallel runs of the mixed power iteration."""
    rng = np.random.default_rng(1)
    count = starts + min(N.shape)
    b = rng.standard_normal((N.shape[1], count)) + 1j * rng.standard_normal((N.shape[1], count))
    b[:, starts:] = np.linalg.svd(N)[2][: count - starts].conj().T
    w = b.copy()
    q = np.where(np.arange(count) % 2, rng.uniform(-1, 1, (len(structure.blocks), count)), 1.0)
    z = np.zeros((N.shape[0], count), complex)
    for _ in range(steps):
        a = _unit(N @ b)
        for k, (block, r, c) in enumerate(_places(structure)):
            if block.kind == "full":
                z[r] = a[r] * (_lengths(w[c]) / _lengths(a[r]))
            else:
                z[r] = w[c] * _factor(block, a[r], w[c], b[c], q, k)
        w = _unit(N.conj().T @ z)
        before = b
        b = np.empty_like(b)
        for k, (block, r, c) in enumerate(_places(structure)):
            if block.kind == "full":
                b[c] = w[c] * (_lengths(a[r]) / _lengths(w[c]))
            else:
                b[c] = a[r] * np.conj(_factor(block, a[r], w[c], before[c], q, k))
        if np.abs(b - before).max() < 1e-13:
            break
    out = []
    for s in range(count):
        parts: Parts = []
        for k, (block, r, c) in enumerate(_places(structure)):
            u, v = w[c, s], a[r, s]
            if block.kind == "full":
                parts.append(_rank_one(u, v))
            elif block.kind == "repeated_complex":
                parts.append(_phase(np.vdot(v, u)))
            else:
                parts.append(float(q[k, s]))
        out.append(parts)
    return out


def _factor(block: Block, a: np.ndarray, w: np.ndarray, b: np.ndarray, q: np.ndarray, k: int) -> np.ndarray:
    """Factor of a repeated block: a phase, or q in [−1, 1], which is updated in place."""
    inner = np.sum(w.conj() * a, axis=0)
    if block.kind == "repeated_complex":
        return _phase(inner)
    step = np.sign(q[k]) * _lengths(b) / _lengths(a) + inner.real
    q[k] = np.clip(np.where(step == 0, 1e-3, step), -1, 1)
    return q[k]


def _phase(z: np.ndarray | complex) -> np.ndarray:
    """z / |z|, and 1 where z is zero."""
    size = np.abs(z)
    return np.where(size > 0, z / np.maximum(size, TINY), 1.0)


def _lengths(v: np.ndarray) -> np.ndarray:
    """Norms (k,) of the columns, at least `TINY`."""
    return np.maximum(np.linalg.norm(v, axis=0), TINY)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / _lengths(v)


def _rank_one(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """u v* of unit size, or zero where a vector is zero.

    The vectors are scaled first, because squares of 1e-160 have few digits.
    """
    u, v = (x / max(np.abs(x).max(initial=0.0), TINY) for x in (u, v))
    return np.outer(u, v.conj()) / max(np.linalg.norm(u) * np.linalg.norm(v), TINY)


def _largest_eigenvalue(X: np.ndarray) -> complex:
    """Eigenvalue of X with the largest absolute value."""
    values = np.linalg.eigvals(X)
    return values[np.argmax(np.abs(values))]


def _assemble(structure: Structure, parts: Parts, turn: complex = 1.0) -> np.ndarray:
    """Δ from its parts, with the complex blocks multiplied by the phase ``turn``."""
    delta = np.zeros((structure.n_cols, structure.n_rows), complex)
    for part, (block, r, c) in zip(parts, _places(structure), strict=True):
        if block.kind == "full":
            delta[c, r] = part * turn
        else:
            delta[c, r] = np.eye(block.rows) * (part if block.kind == "repeated_real" else part * turn)
    return delta


def _make_singular(M: np.ndarray, structure: Structure, parts: Parts) -> tuple[float, np.ndarray | None]:
    """Scale parts of unit size to a Δ with I − M Δ singular. Returns (β, Δ) or (0, None)."""
    if structure.complex_only:
        delta = _assemble(structure, parts)
        value = _largest_eigenvalue(M @ delta)
        return (abs(value), delta / value) if value else (0.0, None)
    best, best_delta = 0.0, None
    for vary in _free_parameters(structure, parts):
        for start in np.linalg.eigvals(M @ vary(0.0)):
            real = _make_real(M, vary, start)
            # the size of Δ may be less than 1 / value, if no block reaches its bound
            if real is not None and 1 / _size(structure, real) > best:
                best, best_delta = 1 / _size(structure, real), real
    return best, best_delta


def _size(structure: Structure, delta: np.ndarray) -> float:
    """max_i σ̄(Δ_i)."""
    return max(float(np.linalg.norm(delta[c, r], 2)) for _, r, c in _places(structure))


def _free_parameters(structure: Structure, parts: Parts) -> Iterator[Callable[[float], np.ndarray]]:
    """One-parameter families through a mixed Δ: turn the complex blocks, or move one real block."""
    if any(b.kind != "repeated_real" for b in structure.blocks):
        yield lambda s: _assemble(structure, parts, np.exp(1j * s))
    for k, block in enumerate(structure.blocks):
        if block.kind == "repeated_real":

            def move(s, k=k):
                return _assemble(
                    structure, [*parts[:k], float(np.clip(parts[k] + s, -1, 1)), *parts[k + 1 :]]
                )

            yield move


def _make_real(M: np.ndarray, vary: Callable[[float], np.ndarray], start: complex) -> np.ndarray | None:
    """Move the eigenvalue ``start`` of M Δ(0) to the real axis by secant steps.

    Returns Δ(s) / eigenvalue, or None.
    """
    s, step, value = 0.0, 1e-4, start
    for _ in range(30):
        if abs(value.imag) <= 1e-13 * abs(value):
            break
        s += step
        values = np.linalg.eigvals(M @ vary(s))
        before, value = value.imag, values[np.argmin(np.abs(values - value))]
        if value.imag == before:
            break
        step = -np.clip(value.imag * step / (value.imag - before), -0.5, 0.5)
    else:
        return None
    if abs(value.imag) > 1e-11 * abs(value) or value.real == 0:
        return None
    return vary(s) / value.real


def _is_singular(M: np.ndarray, delta: np.ndarray) -> bool:
    """Tell if det(I − M Δ) = 0 after a relative change of at most ``SINGULAR_RTOL`` of the entries of M."""
    return is_singular(M, delta, SINGULAR_RTOL * np.abs(M))
