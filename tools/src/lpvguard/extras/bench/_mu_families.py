"""Random μ problems with an algebraically known value, for one frequency and for intervals.

A problem is a dict in the form of ``solve``. The families are hard on purpose. M is real or nearly real,
badly scaled, or needs extreme scalings because of its couplings. Other families have hidden copies of states,
or poles that nearly coincide.
"""

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import numpy as np
from scipy.linalg import block_diag, schur
from scipy.optimize import minimize_scalar

Problem = dict[str, Any]
Family = Callable[[np.random.Generator], tuple[Problem, float]]
"""Function that draws a problem and its μ from a random generator."""


def _block(kind: str, size: int = 1) -> Problem:
    return {"type": kind, "rows": size, "cols": size}


def _point(M: np.ndarray, blocks: list[Problem], mu: float) -> tuple[Problem, float]:
    return {"kind": "mu", "M": np.stack([M.real, M.imag], axis=-1).tolist(), "blocks": blocks}, mu


def _complex(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def _scaling(rng: np.random.Generator, sizes: list[int], decades: float) -> np.ndarray:
    """Draw a diagonal scaling that is constant on each block."""
    return np.repeat(10.0 ** rng.uniform(-decades, decades, len(sizes)), sizes)


def diagonal(rng: np.random.Generator) -> tuple[Problem, float]:
    """Diagonal M: μ is the largest |m| of complex scalars and of real scalars with real m."""
    n = int(rng.integers(1, 5))
    kinds = [str(rng.choice(["repeated_real", "full", "repeated_complex"])) for _ in range(n)]
    m = rng.standard_normal(n) * 10 ** rng.uniform(-2, 2, n) + 0j
    turned = rng.random(n) < 0.3
    m[turned] *= np.exp(1j * rng.uniform(0.2, 2.9, int(turned.sum())))
    counted = [abs(x) for x, kind in zip(m, kinds, strict=True) if kind != "repeated_real" or x.imag == 0]
    return _point(np.diag(m), [_block(kind) for kind in kinds], max(counted, default=0.0))


def _least_slope(c: np.ndarray, real: np.ndarray) -> float:
    """Compute μ of a rank-one M: min over s of Σ_real |Re c + s Im c| + Σ_complex |c| √(1 + s²)."""

    def value(s: float) -> float:
        return float(
            np.abs(c[real].real + s * c[real].imag).sum() + np.abs(c[~real]).sum() * np.sqrt(1 + s * s)
        )

    imag = np.where(c.imag == 0, np.inf, c.imag)
    breaks = np.append(-c.real / imag, 0.0)
    best = min(value(s) for s in breaks)
    optimum = minimize_scalar(
        lambda angle: value(np.tan(angle)),
        bounds=(-1.5707, 1.5707),
        method="bounded",
        options={"xatol": 1e-11},
    )
    return min(best, float(optimum.fun))


def rank_one(rng: np.random.Generator) -> tuple[Problem, float]:
    """Rank-one M = a bᴴ: det(I − M Δ) = 1 − Σ b_iᴴ Δ_i a_i.

    The term of a scalar is δ_i b_iᴴ a_i. The term of a full block can have any phase.
    """
    n = int(rng.integers(2, 6))
    real = rng.random(n) < 0.7
    if real.sum() > 4:
        real[0] = False
    c, a, b, blocks = np.zeros(n, complex), [], [], []
    for k in range(n):
        rows, cols = (int(s) for s in rng.integers(1, 3, 2))
        cols = rows if real[k] else cols
        a.append(_complex(rng, rows) * 10 ** rng.uniform(-2, 2))
        b.append(_complex(rng, cols))
        blocks.append({"type": "repeated_real" if real[k] else "full", "rows": rows, "cols": cols})
        c[k] = np.vdot(b[k], a[k]) if real[k] else np.linalg.norm(a[k]) * np.linalg.norm(b[k])
    M = np.outer(np.concatenate(a), np.concatenate(b).conj())
    return _point(M, blocks, _least_slope(c, real))


def real_matrix(rng: np.random.Generator) -> tuple[Problem, float]:
    """Real M with real scalars: det(I − M Δ) is affine in each δ_i, so it vanishes first at a vertex."""
    n = int(rng.integers(1, 5))
    d = _scaling(rng, [1] * n, 2.0)
    M = rng.standard_normal((n, n))
    best = 0.0
    for signs in product([1.0, -1.0], repeat=n):
        values = np.linalg.eigvals(M * np.array(signs))
        best = max(best, *np.where(np.abs(values.imag) <= 1e-9 * np.abs(values), values.real, 0.0))
    return _point(d[:, None] * M / d, [_block("repeated_real")] * n, float(best))


def repeated(rng: np.random.Generator) -> tuple[Problem, float]:
    """Repeated scalars: μ is the largest |eigenvalue|; for real scalars only real eigenvalues count."""
    parts, blocks, best = [], [], 0.0
    for _ in range(int(rng.integers(1, 4))):
        size = int(rng.integers(1, 4))
        kind = str(rng.choice(["repeated_real", "repeated_complex"]))
        values = _complex(rng, size)
        actual = rng.random(size) < 0.6
        values[actual] = values[actual].real
        T = _complex(rng, size, size)
        parts.append(T @ np.diag(values) @ np.linalg.inv(T))
        blocks.append(_block(kind, size))
        counted = values if kind == "repeated_complex" else values[actual]
        best = max(best, *np.abs(counted)) if len(counted) else best
    return _point(block_diag(*parts), blocks, float(best))


def triangular(rng: np.random.Generator) -> tuple[Problem, float]:
    """Block triangular M with strong couplings that do not affect det(I − M Δ)."""
    n = int(rng.integers(2, 5))
    real = rng.random(n) < 0.6
    m = rng.standard_normal(n) + 1j * np.where(real, 0.0, rng.standard_normal(n))
    M = np.diag(m) + np.triu(_complex(rng, n, n) * 10 ** rng.uniform(-2, 1.5), 1)
    blocks = [_block("repeated_real" if r else "full") for r in real]
    return _point(M, blocks, float(np.abs(m).max()))


def similar(rng: np.random.Generator) -> tuple[Problem, float]:
    """Problem of another family, with new units and coordinates of each block that commute with Δ."""
    family = (diagonal, rank_one, real_matrix, repeated, triangular)[int(rng.integers(5))]
    problem, mu = family(rng)
    blocks = problem["blocks"]
    left, right = [], []
    for b in blocks:
        size = 10.0 ** rng.uniform(-4, 4)
        if b["type"] == "full":  # unitary factors do not change μ
            left.append(size * np.linalg.qr(_complex(rng, b["rows"], b["rows"]))[0])
            right.append(np.linalg.qr(_complex(rng, b["cols"], b["cols"]))[0] / size)
        else:
            T = size * _complex(rng, b["rows"], b["rows"])
            left.append(T)
            right.append(np.linalg.inv(T))
    M = np.array(problem["M"]) @ [1, 1j]
    return _point(block_diag(*left) @ M @ block_diag(*right), blocks, mu)


def ring(rng: np.random.Generator) -> tuple[Problem, float]:
    """Scalars in a ring: det(I − M Δ) = 1 − Π m_i δ_i, so μ is the geometric mean of |m_i|."""
    n = int(rng.integers(2, 6))
    gains = 10 ** rng.uniform(-4, 4, n) * rng.choice([-1, 1], n) + 0j
    real = n < 5 and rng.random() < 0.5
    if not real:
        gains *= np.exp(1j * rng.uniform(0, 2 * np.pi, n))
    kinds = ["repeated_real"] * n if real else rng.choice(["full", "repeated_complex"], n).tolist()
    mu = float(np.exp(np.log(np.abs(gains)).mean()))
    return _point(np.roll(np.diag(gains), 1, axis=1), [_block(kind) for kind in kinds], mu)


def nilpotent(rng: np.random.Generator) -> tuple[Problem, float]:
    """Nilpotent M without feedback: μ is 0 for all couplings."""
    n = int(rng.integers(2, 5))
    M = np.triu(_complex(rng, n, n), 1) * 10 ** rng.uniform(-3, 3)
    order = rng.permutation(n)
    kinds = rng.choice(["repeated_real", "full", "repeated_complex"], n).tolist()
    return _point(M[np.ix_(order, order)], [_block(kind) for kind in kinds], 0.0)


# --- intervals ---


def _lags(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[float, float]]:
    """Return A, B, C of k/(s + a)^m, and |G| at each frequency where it is real."""
    m, k, a = (
        int(rng.integers(1, 6)),
        float(rng.choice([-1, 1]) * 10 ** rng.uniform(-1, 1)),
        10 ** rng.uniform(-1, 1),
    )
    A = -a * np.eye(m) + a * np.eye(m, k=-1)
    B, C = np.zeros((m, 1)), np.zeros((1, m))
    B[0], C[0, -1] = a, k
    crossings = {0.0: abs(k)}
    for n in range(1, m):
        if n * np.pi / m < np.pi / 2 - 1e-9:
            crossings[a * np.tan(n * np.pi / m)] = abs(k) * np.cos(n * np.pi / m) ** m
    return A, B, C, crossings


def _twins(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[float, float]]:
    """Return A, B, C of a resonance or of two poles at a distance of 1e-6; it is real only at 0."""
    if rng.random() < 0.5:
        damping, size = 10 ** rng.uniform(-3, 0), float(rng.choice([-1, 1]) * rng.uniform(0.1, 3))
        A = np.array([[0.0, 1.0], [-1.0, -2 * damping]])
        return A, np.array([[0.0], [size]]), np.array([[1.0, 0.0]]), {0.0: abs(size)}
    a = rng.uniform(0.5, 2)
    A = np.array([[-a, 0.0], [1.0, -a - 1e-6]])
    return A, np.array([[1.0], [0.0]]), np.array([[0.0, 1.0]]), {0.0: 1 / (a * (a + 1e-6))}


def _resonance_peak(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return A, B, C of k/(s² + 2 ζ s + 1), and the peak of |G|."""
    damping, k = float(rng.uniform(0.01, 1.5)), float(rng.uniform(0.1, 3))
    peak = k / (2 * damping * np.sqrt(1 - damping**2)) if damping < np.sqrt(0.5) else k
    return np.array([[0.0, 1.0], [-1.0, -2 * damping]]), np.array([[0.0], [k]]), np.array([[1.0, 0.0]]), peak


def _disguised(
    rng: np.random.Generator, A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, sizes: list[int]
) -> Problem:
    """Return the fields of a system with the same μ: other states and units, hidden copies of states."""
    if rng.random() < 0.3 and len(A):
        k = int(rng.integers(len(A)))
        A = block_diag(A, A[k, k] - 0.1)
        B = np.vstack(
            [B, np.zeros((1, B.shape[1])) if rng.random() < 0.5 else rng.standard_normal((1, B.shape[1]))]
        )
        C = np.hstack([C, np.zeros((C.shape[0], 1))])
    T = np.linalg.qr(rng.standard_normal(A.shape))[0] if rng.random() < 0.5 else np.eye(len(A))
    T = 10.0 ** rng.uniform(-2, 2, len(A))[:, None] * T if rng.random() < 0.5 else T
    inverse = np.linalg.inv(T)
    d = _scaling(rng, sizes, 1.5)
    return {
        "kind": "mu_interval",
        "A": (T @ A @ inverse).tolist(),
        "B": (T @ B / d).tolist(),
        "C": (d[:, None] * (C @ inverse)).tolist(),
        "D": (d[:, None] * D / d).tolist(),
    }


def _joined(
    rng: np.random.Generator, parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]], coupled: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Join systems in parallel channels; ``coupled`` adds one-way couplings that det(I − M Δ) ignores."""
    A, B, C = (block_diag(*(p[k] for p in parts)) for k in range(3))
    D = np.zeros((C.shape[0], B.shape[1]))
    if coupled:
        D = np.triu(rng.standard_normal(D.shape), 1)
    return A, B, C, D


def one_real(rng: np.random.Generator) -> tuple[Problem, float]:
    """One real scalar, over all frequencies or over an interval."""
    A, B, C, crossings = _lags(rng) if rng.random() < 0.6 else _twins(rng)
    problem = _disguised(rng, A, B, C, np.zeros((1, 1)), [1])
    problem["blocks"] = [_block("repeated_real")]
    if rng.random() < 0.3 and len(crossings) > 1:
        first = sorted(crossings)[1]
        problem["low"] = 0.5 * first
        crossings = {w: size for w, size in crossings.items() if w > 0}
        if rng.random() < 0.5:
            problem["high"] = 1.5 * first
            crossings = {w: size for w, size in crossings.items() if w <= 1.5 * first}
    return problem, max(crossings.values())


def several_real(rng: np.random.Generator) -> tuple[Problem, float]:
    """Two to four real scalars with one-way couplings."""
    drawn = [_lags(rng) if rng.random() < 0.6 else _twins(rng) for _ in range(int(rng.integers(2, 5)))]
    system = _joined(rng, [part[:3] for part in drawn], rng.random() < 0.7)
    problem = _disguised(rng, *system, [1] * len(drawn))
    problem["blocks"] = [_block("repeated_real")] * len(drawn)
    return problem, max(max(crossings.values()) for *_, crossings in drawn)


def repeated_real(rng: np.random.Generator) -> tuple[Problem, float]:
    """One real scalar, repeated two or three times; M is triangular in other coordinates."""
    drawn = [_lags(rng) if rng.random() < 0.6 else _twins(rng) for _ in range(int(rng.integers(2, 4)))]
    A, B, C, D = _joined(rng, [part[:3] for part in drawn], True)
    T = np.linalg.qr(rng.standard_normal(D.shape))[0]
    problem = _disguised(rng, A, B @ T.T, T @ C, T @ D @ T.T, [len(drawn)])
    problem["blocks"] = [_block("repeated_real", len(drawn))]
    return problem, max(max(crossings.values()) for *_, crossings in drawn)


def coupled_real(rng: np.random.Generator) -> tuple[Problem, float]:
    """N g with a lag g and N ≻ 0: μ = λ_max(N) |g| where g is real, because N Δ has real eigenvalues."""
    n = int(rng.integers(2, 5))
    A, B, C, crossings = _lags(rng)
    N = rng.standard_normal((n, n))
    N = N @ N.T + 0.1 * np.eye(n)
    one = np.eye(n)
    problem = _disguised(rng, np.kron(one, A), np.kron(one, B), np.kron(N, C), np.zeros((n, n)), [1] * n)
    problem["blocks"] = [_block("repeated_real")] * n
    return problem, float(np.linalg.eigvalsh(N)[-1]) * max(crossings.values())


def interval_polynomial(rng: np.random.Generator) -> tuple[Problem, float]:
    """Stable polynomial with interval coefficients: four corner polynomials decide (Kharitonov 1978)."""
    n = int(rng.integers(2, 5))
    roots = -(10.0 ** rng.uniform(-0.7, 0.7, n)) + 0j
    for k in range(0, n - 1, 2):
        if rng.random() < 0.6:
            roots[k] = roots[k].real + 1j * 10 ** rng.uniform(-0.7, 0.7)
            roots[k + 1] = np.conj(roots[k])
    a = np.real(np.poly(roots))[:0:-1]  # coefficients of s^0, s^1, ...
    r = a * rng.uniform(0.2, 1.0, n)
    signs = np.array(
        [np.resize(s, n) for s in ([1, 1, -1, -1], [-1, -1, 1, 1], [1, -1, -1, 1], [-1, 1, 1, -1])]
    )

    def stable(level: float) -> bool:
        corners = a + r * signs / level
        return all(np.roots(np.append(1.0, c[::-1])).real.max() < 0 for c in corners)

    low, high = 1e-3, float(np.max(r / a)) * 1e3
    for _ in range(100):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if stable(middle) else (middle, high)
    A = np.vstack([np.eye(n)[1:], -a])
    B = np.zeros((n, n))
    B[-1] = 1.0
    problem = _disguised(rng, A, B, -np.diag(r), np.zeros((n, n)), [1] * n)
    problem["blocks"] = [_block("repeated_real")] * n
    return problem, high


def real_and_performance(rng: np.random.Generator) -> tuple[Problem, float]:
    """Real scalar and full block with one-way couplings: μ is a gain at a real crossing or a peak gain."""
    A, B, C, crossings = _lags(rng) if rng.random() < 0.6 else _twins(rng)
    A2, B2, C2, peak = _resonance_peak(rng)
    system = _joined(rng, [(A, B, C), (A2, B2, C2)], rng.random() < 0.7)
    problem = _disguised(rng, *system, [1, 1])
    problem["blocks"] = [_block("repeated_real"), _block("full")]
    return problem, max(*crossings.values(), peak)


def complex_blocks(rng: np.random.Generator) -> tuple[Problem, float]:
    """Two or three full scalars with one-way couplings: μ is the largest peak gain."""
    drawn = [_resonance_peak(rng) for _ in range(int(rng.integers(2, 4)))]
    system = _joined(rng, [part[:3] for part in drawn], False)
    problem = _disguised(rng, *system, [1] * len(drawn))
    problem["blocks"] = [_block("full")] * len(drawn)
    return problem, max(part[3] for part in drawn)


def lightly_damped(rng: np.random.Generator) -> tuple[Problem, float]:
    """Real scalar on a resonance with damping down to 1e-5; the response is real only at 0."""
    damping, omega, k = 10 ** rng.uniform(-5, -2), 10 ** rng.uniform(-2, 3), float(rng.uniform(0.1, 3))
    A = np.array([[0.0, omega], [-omega, -2 * damping * omega]])
    B, C = np.array([[0.0], [k * omega]]), np.array([[1.0, 0.0]])
    problem = _disguised(rng, A, B, C, np.zeros((1, 1)), [1])
    problem["blocks"] = [_block("repeated_real")]
    beside, end = omega * (1 + rng.uniform(-1e-3, 1e-3)), str(rng.choice(["low", "high", "none"]))
    if end != "none":
        problem[end] = beside
    return problem, 0.0 if end == "low" else k


def delayed(rng: np.random.Generator) -> tuple[Problem, float]:
    """Gain with a delay of whole samples: |G| is the gain at every frequency."""
    n, k = int(rng.integers(1, 7)), float(rng.uniform(0.1, 3))
    C = np.zeros((1, n))
    C[0, -1] = k
    problem = _disguised(rng, np.eye(n, k=-1), np.eye(n)[:, :1], C, np.zeros((1, 1)), [1])
    kind = str(rng.choice(["repeated_real", "full"]))
    return problem | {"dt": 10 ** rng.uniform(-3, 0), "blocks": [_block(kind)]}, k


def discrete(rng: np.random.Generator) -> tuple[Problem, float]:
    """Problem of another family after the bilinear map, which changes frequencies and keeps μ."""
    while True:
        family = _CONTINUOUS[int(rng.integers(len(_CONTINUOUS)))]
        problem, mu = family(rng)
        if "low" not in problem:
            break
    return problem | _tustin(problem, float(10 ** rng.uniform(-2, 0))), mu


def _tustin(problem: Problem, dt: float) -> Problem:
    """Return the fields of the problem after the bilinear map."""
    A, B, C, D = (np.array(problem[key], float) for key in "ABCD")
    inverse = np.linalg.inv(2 / dt * np.eye(len(A)) - A)
    root = 2 / np.sqrt(dt)
    return {
        "A": (inverse @ (2 / dt * np.eye(len(A)) + A)).tolist(),
        "B": (root * inverse @ B).tolist(),
        "C": (root * C @ inverse).tolist(),
        "D": (D + C @ inverse @ B).tolist(),
        "dt": dt,
    }


def cascade(rng: np.random.Generator) -> tuple[Problem, float]:
    """Loops of stages with pole −a − r δ: δ shifts eigenvalues by r δ, so μ is r / (least damping)."""
    parts, blocks, worst = [], [], 0.0
    for _ in range(int(rng.integers(1, 3))):
        n = int(rng.integers(2, 4))
        loop = rng.standard_normal((n, n)) * 10 ** rng.uniform(-1, 1)
        room, r = 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(-1, 1)
        A = schur(loop)[0] - (np.linalg.eigvals(loop).real.max() + room) * np.eye(n)
        T = np.linalg.qr(rng.standard_normal((n, n)))[0]
        parts.append((A, -r * T.T, T))
        blocks.append(_block("repeated_real", n))
        values = np.linalg.eigvals(A)
        worst = max(worst, r / float(np.abs(values.real).min()))
    system = _joined(rng, parts, False)
    problem = _disguised(rng, *system, [b["rows"] for b in blocks])
    return problem | {"blocks": blocks}, worst


def beside_the_axis(rng: np.random.Generator) -> tuple[Problem, float]:
    """k 2 ζ s/(s² + 2 ζ s + 1) with ζ down to 1e-9: the response is real only at 1 rad/s, where it is k."""
    damping, omega, k = 10 ** rng.uniform(-9, -5), 10 ** rng.uniform(-1, 2), float(rng.uniform(0.1, 3))
    A = omega * np.array([[0.0, 1.0], [-1.0, -2 * damping]])
    B, C = np.array([[0.0], [2 * damping * omega]]), np.array([[0.0, k]])
    problem = {key: part.tolist() for key, part in (("A", A), ("B", B), ("C", C), ("D", np.zeros((1, 1))))}
    problem |= {"kind": "mu_interval", "blocks": [_block(str(rng.choice(["repeated_real", "full"])))]}
    if rng.random() < 0.5:
        problem |= {"low": 0.5 * omega, "high": 2 * omega}
    return problem, k


def at_the_ends(rng: np.random.Generator) -> tuple[Problem, float]:
    """Problem whose μ lies at an end of the interval.

    A lag has its largest gain at the beginning. N s/(s + a) with N ≻ 0 has it at infinity, or at half the
    sampling rate.
    """
    a, k = (float(x) for x in 10 ** rng.uniform(-1, 1, 2))
    if rng.random() < 0.4:
        A, B, C, D = (np.array([[x]]) for x in (-a, a, k, 0.0))
        problem = _disguised(rng, A, B, C, D, [1])
        low = 0.0 if rng.random() < 0.3 else float(a * 10 ** rng.uniform(-1, 1))
        return problem | {"blocks": [_block("full")], "low": low}, k / float(np.hypot(1.0, low / a))
    n = int(rng.integers(1, 4))
    N = rng.standard_normal((n, n))
    N = k * (N @ N.T + 0.1 * np.eye(n))
    one = np.eye(n)
    problem = _disguised(rng, -a * one, one, -a * N, N, [1] * n)
    problem["blocks"] = [_block("repeated_real")] * n
    problem |= _tustin(problem, float(10 ** rng.uniform(-2, 0))) if rng.random() < 0.5 else {}
    return problem, float(np.linalg.eigvalsh(N)[-1])


_CONTINUOUS: list[Family] = [
    one_real,
    several_real,
    repeated_real,
    coupled_real,
    interval_polynomial,
    real_and_performance,
    complex_blocks,
]
FAMILIES: dict[str, list[Family]] = {
    "mu": [diagonal, rank_one, real_matrix, repeated, triangular, similar, ring, nilpotent],
    "mu_interval": [*_CONTINUOUS, discrete, lightly_damped, delayed, cascade, beside_the_axis, at_the_ends],
}


def problems(family: Family, count: int, seed: int, first: int = 0) -> Iterator[tuple[Problem, float]]:
    """Yield ``count`` problems of a family with their μ, from problem number ``first`` on."""
    for index in range(first, first + count):
        yield family(np.random.default_rng([seed, index]))
