"""Random H∞ problems with an algebraically known optimum, in random coordinates.

A four-block problem of normalised coprime factors has γ² = 1 + λ_max(XZ) (Glover & McFarlane 1989). A zero of
the plant in the right half plane sets γ by interpolation. The optimum does not depend on the coordinates of
the state, or on the units of control and measurement. An all-pass at the outputs does not change the optimum.
States that no input reaches do not change it either.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import wraps

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.synthesis.statespace import StateSpace, append, gain, series, to_discrete
from lpvguard.extras.bench._mu_families import Family, Problem


@dataclass(frozen=True)
class HinfCase:
    """Generalised plant and its optimum ``gamma``."""

    plant: StateSpace
    n_control: int
    n_measurement: int
    gamma: float


def coprime(rng: np.random.Generator) -> HinfCase:
    """z = [y; u], w = [v1; v2], y = G(u + v1) + v2 with a random G of 1 to 6 states."""
    n, m, p = int(rng.integers(1, 7)), int(rng.integers(1, 3)), int(rng.integers(1, 3))
    return _coprime(*(rng.standard_normal(shape) for shape in ((n, n), (n, m), (p, n))))


def _coprime(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> HinfCase:
    n, m, p = len(A), B.shape[1], len(C)
    X = sl.solve_continuous_are(A, B, C.T @ C, np.eye(m))
    Z = sl.solve_continuous_are(A.T, C.T, B @ B.T, np.eye(p))
    gamma = float(np.sqrt(1 + np.linalg.eigvals(X @ Z).real.max()))
    row = np.hstack([np.zeros((p, m)), np.eye(p), np.zeros((p, m))])
    D = np.vstack([row, np.hstack([np.zeros((m, m + p)), np.eye(m)]), row])
    plant = StateSpace(A, np.hstack([B, np.zeros((n, p)), B]), np.vstack([C, np.zeros((m, n)), C]), D)
    return HinfCase(plant, m, p, gamma)


def interpolation(rng: np.random.Generator) -> HinfCase:
    """z = W (w − G u), y = w − G u; G(s0) = 0 at one s0 > 0, W = 1/(s + lag): γ = W(s0), and D12 = 0."""
    zero, lag = rng.uniform(0.5, 5.0), rng.uniform(0.05, 0.5)
    a, b = rng.uniform(1.0, 4.0, 2)
    A = np.array([[0.0, 1.0, 0.0], [-a * b, -a - b, 0.0], [zero, -1.0, -lag]])
    C = np.array([[0.0, 0.0, 1.0], [zero, -1.0, 0.0]])
    B, D = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]]), np.array([[0.0, 0.0], [1.0, 0.0]])
    plant = StateSpace(A, B, C, D)
    return HinfCase(plant, 1, 1, 1 / (zero + lag))


def close_poles(rng: np.random.Generator) -> HinfCase:
    """Four-block problem whose G has three poles at distances of 1e-6."""
    poles = rng.uniform(-2.0, -0.5) + 1e-6 * np.arange(3.0)
    return _coprime(np.diag(poles), rng.uniform(0.5, 2.0, (3, 1)), rng.uniform(0.5, 2.0, (1, 3)))


def dense(rng: np.random.Generator) -> HinfCase:
    """Four-block problem in dense coordinates with condition numbers up to 1e4."""
    case = coprime(rng)
    return replace(case, plant=case.plant.transformed(_coordinates(rng, case.plant.order, 4.0)))


def badly_scaled(rng: np.random.Generator) -> HinfCase:
    """Four-block problem whose states, controls and measurements have units that differ by up to 1e6."""
    case = coprime(rng)
    P = case.plant.transformed(np.diag(10.0 ** rng.uniform(-6, 6, case.plant.order)))
    left, right = np.ones(P.n_outputs), np.ones(P.n_inputs)
    left[-case.n_measurement :] = 10.0 ** rng.uniform(-3, 3, case.n_measurement)
    right[-case.n_control :] = 10.0 ** rng.uniform(-3, 3, case.n_control)
    plant = StateSpace(P.A, P.B * right, left[:, None] * P.C, left[:, None] * P.D * right)
    return replace(case, plant=plant)


def companion_weight(rng: np.random.Generator) -> HinfCase:
    """Problem with an all-pass in companion form at the first output; its poles span up to four decades."""
    case = coprime(rng)
    poles = -(10.0 ** np.sort(rng.uniform(-2, 2, int(rng.integers(2, 5)))))
    n, den = len(poles), np.poly(poles)
    num = den * (-1.0) ** np.arange(n + 1)
    A = np.vstack([np.eye(n)[1:], -den[:0:-1]])
    weight = StateSpace(A, np.eye(n)[:, -1:], (num - den)[None, :0:-1], np.eye(1))
    rest = gain(np.eye(case.plant.n_outputs - 1))
    return replace(case, plant=series(append(weight, rest), case.plant))


def dense_companion_weight(rng: np.random.Generator) -> HinfCase:
    """Problem of `companion_weight` in dense coordinates with condition numbers up to 100."""
    case = companion_weight(rng)
    return replace(case, plant=case.plant.transformed(_coordinates(rng, case.plant.order, 2.0)))


def unreached_copy(rng: np.random.Generator) -> HinfCase:
    """Four-block problem with a stable copy of the states that every output shows and no input reaches."""
    case = coprime(rng)
    P = case.plant
    copy = P.A - (max(np.linalg.eigvals(P.A).real.max(), 0.0) + 1.0) * np.eye(P.order)
    A, B = sl.block_diag(P.A, copy), np.vstack([P.B, np.zeros_like(P.B)])
    plant = StateSpace(A, B, np.hstack([P.C, P.C]), P.D)
    return replace(case, plant=plant.transformed(_coordinates(rng, plant.order, 1.0)))


def discrete(rng: np.random.Generator) -> HinfCase:
    """Tustin image of a four-block problem, in dense coordinates with condition numbers up to 100."""
    case = coprime(rng)
    dt = 10.0 ** rng.uniform(-2, -1)
    plant = to_discrete(case.plant, dt)
    return replace(case, plant=plant.transformed(_coordinates(rng, plant.order, 2.0)))


def _coordinates(rng: np.random.Generator, n: int, decades: float) -> np.ndarray:
    """Draw a dense matrix (n, n) with a condition number up to 10**decades."""
    U, V = (np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(2))
    return U * 10.0 ** rng.uniform(-decades / 2, decades / 2, n) @ V


_CASES: tuple[Callable[[np.random.Generator], HinfCase], ...] = (
    coprime,
    interpolation,
    close_poles,
    dense,
    badly_scaled,
    companion_weight,
    dense_companion_weight,
    unreached_copy,
    discrete,
)


def _as_problem(case: Callable[[np.random.Generator], HinfCase]) -> Family:
    """Convert a family of cases to a family of problems for ``solve``."""

    @wraps(case)
    def problem(rng: np.random.Generator) -> tuple[Problem, float]:
        drawn = case(rng)
        parts = {key: getattr(drawn.plant, key).tolist() for key in "ABCD"}
        counts = {"n_control": drawn.n_control, "n_measurement": drawn.n_measurement}
        return {"kind": "hinf", **parts, "dt": drawn.plant.dt, **counts}, drawn.gamma

    return problem


PROBLEMS: list[Family] = [_as_problem(case) for case in _CASES]
