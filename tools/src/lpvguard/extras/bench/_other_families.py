"""Random problems with algebraically known values for the other bounds, in random coordinates.

The kinds ``multiplicative``, ``margin``, ``lft`` and ``lft_margin`` are kinds of ``solve``. ``norm`` is the
H∞ norm on which margins and certificates depend. ``nu_gap`` and ``nu_margin`` concern two plants, and a plant
with a controller. ``worst_gain`` is the largest gain over Δ. The kinds ``zoh`` and ``frequency_response`` of
``solve`` state no bound.
"""

from collections.abc import Callable

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.nu_gap import nu_gap, nu_margin
from lpvguard.engine.synthesis.statespace import StateSpace, append, gain, series, to_discrete
from lpvguard.engine.synthesis.worst_gain import worst_gain
from lpvguard.extras.bench._mu_families import Family, Problem
from lpvguard.extras.problems.fields import pairs


def _phases(rng: np.random.Generator, n: int) -> np.ndarray:
    return np.exp(1j * rng.uniform(0, 2 * np.pi, n))


def one_delta(rng: np.random.Generator) -> tuple[Problem, float]:
    """E = α Z + a part orthogonal to Z: |δ| is |α| minus the part along Z that the remaining γ_w explains."""
    n = int(rng.integers(1, 5))
    z = (rng.standard_normal(n) + 1j * rng.standard_normal(n)) * 10 ** rng.uniform(-3, 3)
    across = rng.standard_normal(n) + 1j * rng.standard_normal(n)
    across -= np.vdot(z, across) / np.vdot(z, z) * z
    size = float(np.linalg.norm(z))
    across *= 0.0 if n == 1 else size * 10 ** rng.uniform(-3, 1) / np.linalg.norm(across)
    least, alpha = float(np.linalg.norm(across)), float(10 ** rng.uniform(-2, 2))
    along = float(rng.uniform(0.0, 1.5)) * alpha * size
    gamma = float(np.hypot(least, along)) * (1 + 1e-9)
    e = alpha * _phases(rng, 1) * z + across
    nu = max(alpha - np.sqrt(gamma**2 - least**2) / size, 0.0)
    return {"kind": "multiplicative", "E": pairs(e), "Z": pairs(z), "gamma_w": gamma}, float(nu)


def outputs_apart(rng: np.random.Generator) -> tuple[Problem, float]:
    """Margin t of several outputs.

    With one δ for each output, t is the largest |E|/(W_Δ |Z| + W_w). With one common δ and E = c Z, the
    output with the tightest bound decides.
    """
    n = int(rng.integers(1, 5))
    z = rng.uniform(0.1, 1, n) * _phases(rng, n) * 10 ** rng.uniform(-2, 2)
    w = 10 ** rng.uniform(-2, 1, n)
    problem: Problem = {"kind": "margin", "Z": pairs(z), "W_w": w.tolist()}
    if rng.random() < 0.5:
        e, reach = rng.uniform(0, 3, n) * _phases(rng, n), 10 ** rng.uniform(-2, 1, n)
        t = float((np.abs(e) / (reach * np.abs(z) + w)).max())
        return problem | {"E": pairs(e), "W_delta": reach.tolist()}, t
    c, one = 10 ** rng.uniform(-2, 1), float(10 ** rng.uniform(-2, 1))
    e = c * _phases(rng, 1) * z
    return problem | {"E": pairs(e), "W_delta": one}, float(c / (one + (w / np.abs(z)).min()))


def _loop(rng: np.random.Generator) -> tuple[Problem, float, float, float]:
    """Draw a loop with a scalar δ, ξ = δ (η + p ξ), e = ξ + w, in rotated signals: the fields, e, η and p."""
    e, eta, p = (float(x) for x in 10 ** rng.uniform(-1, 1, 3))
    turns = _phases(rng, 2)
    fields = {
        "blocks": [{"type": "full", "rows": 1, "cols": 1}],
        "P11": pairs(np.array([[p * turns[0] / turns[1]]])),
        "P21": pairs(np.array([[1.0 + 0j]])),
        "eta0": pairs(np.array([eta * turns[0]])),
        "e": pairs(np.array([e * turns[1]])),
    }
    return fields, e, eta, p


def loop_of_delta(rng: np.random.Generator) -> tuple[Problem, float]:
    """Loop of δ: the least ξ is e − γ_w, so |δ| = ξ/(η + p ξ)."""
    fields, e, eta, p = _loop(rng)
    gamma = e * float(rng.uniform(0.05, 0.95))
    weight = float(10 ** rng.uniform(-2, 2))
    nu = (e - gamma) / (eta + p * (e - gamma))
    return {"kind": "lft", **fields, "gamma_w": gamma, "lambda_nu": [weight]}, float(weight * nu**2)


def margin_of_a_loop(rng: np.random.Generator) -> tuple[Problem, float]:
    """Margin of a loop: the smaller root t of e − t W_w = t W_Δ (η + p (e − t W_w))."""
    fields, e, eta, p = _loop(rng)
    a, b = (float(x) for x in 10 ** rng.uniform(-2, 1, 2))
    half = (a + b * eta + b * p * e) / 2
    t = e / (half + np.sqrt(half**2 - a * b * p * e))
    return {"kind": "lft_margin", **fields, "W_delta": [b], "W_w": [a]}, float(t)


def full_block(rng: np.random.Generator) -> tuple[Problem, float]:
    """e = Δ η + w with one full Δ: the size of Δ is (|e| − γ_w)/|η|."""
    rows, cols = (int(n) for n in rng.integers(1, 4, 2))
    e, eta = (rng.standard_normal(n) * 10 ** rng.uniform(-2, 2) * _phases(rng, n) for n in (rows, cols))
    size = float(np.linalg.norm(e))
    gamma = size * float(rng.uniform(0.05, 0.95))
    problem = {
        "kind": "lft",
        "blocks": [{"type": "full", "rows": rows, "cols": cols}],
        "P11": pairs(np.zeros((cols, rows), complex)),
        "P21": pairs(np.eye(rows, dtype=complex)),
        "eta0": pairs(eta),
        "e": pairs(e),
        "gamma_w": gamma,
        "lambda_nu": [1.0],
    }
    return problem, float(((size - gamma) / np.linalg.norm(eta)) ** 2)


# --- systems ---


def _first_order(a: float, b: float, c: float, d: float) -> StateSpace:
    return StateSpace(np.array([[a]]), np.array([[b]]), np.array([[c]]), np.array([[d]]))


def _hidden(rng: np.random.Generator, G: StateSpace, discrete: bool = True) -> StateSpace:
    """Add an unreachable state to G and change its coordinates; sometimes convert it to discrete time."""
    if rng.random() < 0.3:
        C = np.hstack([G.C, rng.standard_normal((G.n_outputs, 1))])
        G = StateSpace(sl.block_diag(G.A, -1.0), np.vstack([G.B, np.zeros((1, G.n_inputs))]), C, G.D)
    T = np.linalg.qr(rng.standard_normal((G.order, G.order)))[0] * 10.0 ** rng.uniform(-2, 2, G.order)
    G = G.transformed(T)
    return to_discrete(G, float(10 ** rng.uniform(-2, -1))) if discrete and rng.random() < 0.4 else G


def _turned(rng: np.random.Generator, G: StateSpace) -> StateSpace:
    """Rotate the inputs and the outputs of G."""
    left, right = (np.linalg.qr(rng.standard_normal((n, n)))[0] for n in (G.n_outputs, G.n_inputs))
    return series(gain(left), series(G, gain(right)))


def _resonance(rng: np.random.Generator) -> tuple[StateSpace, float]:
    damping, omega = 10 ** rng.uniform(-3, 0.1), 10 ** rng.uniform(-1, 2)
    peak = 1 / (2 * damping * np.sqrt(1 - damping**2)) if damping < np.sqrt(0.5) else 1.0
    A = omega * np.array([[0.0, 1.0], [-1.0, -2 * damping]])
    G = StateSpace(A, np.array([[0.0], [omega]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)))
    return G, float(peak)


def resonances(rng: np.random.Generator) -> tuple[Problem, float]:
    """Parallel resonances with damping down to 1e-3, with rotated inputs and outputs."""
    parts = [_resonance(rng) for _ in range(int(rng.integers(1, 4)))]
    G = _hidden(rng, _turned(rng, append(*(G for G, _ in parts))))
    return {"kind": "norm", "systems": (G,)}, max(peak for _, peak in parts)


def all_passes(rng: np.random.Generator) -> tuple[Problem, float]:
    """Gain with all-passes whose poles span four decades: the norm is the gain."""
    size, G = float(10 ** rng.uniform(-3, 3)), gain([[1.0]])
    for a in 10 ** rng.uniform(-2, 2, int(rng.integers(1, 5))):
        G = series(_first_order(-a, 1.0, -2 * a, 1.0), G)
    return {"kind": "norm", "systems": (_hidden(rng, series(gain([[size]]), G)),)}, size


def integrators(rng: np.random.Generator) -> tuple[Problem, float]:
    """k/s and c/s in each channel: the nu-gap is the largest |k − c|/(k + c)."""
    n = int(rng.integers(1, 4))
    k = 10 ** rng.uniform(-1, 1, (2, n))
    zero, one = np.zeros((n, n)), np.eye(n)
    turns = [np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(2)]
    systems = tuple(
        StateSpace(zero, one @ turns[1], turns[0] * row, zero).transformed(
            np.linalg.qr(rng.standard_normal((n, n)))[0]
        )
        for row in k
    )
    return {"kind": "nu_gap", "systems": systems}, float((np.abs(k[0] - k[1]) / k.sum(axis=0)).max())


def static_plants(rng: np.random.Generator) -> tuple[Problem, float]:
    """Gains p and q in each channel: the nu-gap is the largest |p − q|/√((1 + p²)(1 + q²))."""
    p, q = (float(x) for x in 10 ** rng.uniform(-2, 2, 2) * rng.choice([-1, 1], 2))
    systems = tuple(_first_order(-1.0, 0.0, 1.0, x) for x in (p, q))
    return {"kind": "nu_gap", "systems": systems}, float(abs(p - q) / np.sqrt((1 + p * p) * (1 + q * q)))


def integrator_and_gain(rng: np.random.Generator) -> tuple[Problem, float]:
    """k/s with the feedback −c: b(P, K) is 1/√(1 + c²), times c if c < 1."""
    k, c = (float(x) for x in 10 ** rng.uniform(-2, 2, 2))
    t = float(10 ** rng.uniform(-3, 3))
    plant = _first_order(0.0, k * t, 1 / t, 0.0)
    return {"kind": "nu_margin", "systems": (plant, gain([[-c]]))}, float(min(1.0, c) / np.sqrt(1 + c * c))


def positive_loop(rng: np.random.Generator) -> tuple[Problem, float]:
    """Positive gains with one lag: Δ = I at frequency 0 is worst, as the series in Δ shows."""
    n = int(rng.integers(1, 4))
    N = rng.uniform(0.0, 1.0, (n + 1, n + 1))
    N[:n, :n] *= rng.uniform(0.1, 0.9) / np.abs(np.linalg.eigvals(N[:n, :n])).max()
    worst = N[n, n] + N[n, :n] @ np.linalg.solve(np.eye(n) - N[:n, :n], N[:n, n])
    d = np.append(10.0 ** rng.uniform(-2, 2, n), 1.0)
    a = 10 ** rng.uniform(-1, 1)
    lag = append(*(_first_order(-a, a, 1.0, 0.0) for _ in range(n + 1)))
    G = _hidden(rng, series(gain(d[:, None] * N / d), lag), discrete=False)
    blocks = [Block(str(rng.choice(["full", "repeated_real"])), 1, 1) for _ in range(n)]
    return {"kind": "worst_gain", "systems": (G,), "blocks": blocks}, float(worst)


def _norm(problem: Problem) -> tuple[float, float]:
    bracket = hinf_norm(*problem["systems"])
    return bracket.lower, bracket.upper


def _nu_gap(problem: Problem) -> tuple[float, float]:
    bracket = nu_gap(*problem["systems"])
    return bracket.lower, bracket.upper


def _nu_margin(problem: Problem) -> tuple[float, float]:
    return nu_margin(*problem["systems"]), np.inf


def _worst_gain(problem: Problem) -> tuple[float, float]:
    (loop,) = problem["systems"]
    bound = worst_gain(loop, problem["blocks"], Block("full", 1, 1), 0.0, np.inf)
    return 0.0, bound.upper


ENGINE: dict[str, Callable[[Problem], tuple[float, float]]] = {
    "norm": _norm,
    "nu_gap": _nu_gap,
    "nu_margin": _nu_margin,
    "worst_gain": _worst_gain,
}
"""Lower and upper bounds of the engine for quantities that are no kind of ``solve``."""
FAMILIES: dict[str, list[Family]] = {
    "multiplicative": [one_delta],
    "margin": [outputs_apart],
    "lft": [loop_of_delta, full_block],
    "lft_margin": [margin_of_a_loop],
    "norm": [resonances, all_passes],
    "nu_gap": [integrators, static_plants],
    "nu_margin": [integrator_and_gain],
    "worst_gain": [positive_loop],
}
