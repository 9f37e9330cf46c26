"""The ν-gap between two plants and its robust-stability margin (THEORY 7.10).

With normalised coprime factors G₁ = [N₁; M₁] and G̃₂ = [−M̃₂, Ñ₂] the chordal distance of two plants at a
frequency is σ̄(G̃₂G₁). The ν-gap is ‖G̃₂G₁‖∞ if det(I + P₂ᴴP₁) has the right winding number, and 1 otherwise.
A controller with b(P₁, K) > ν(P₁, P₂) stabilises P₂ too. Both norms are bracketed over all frequencies. The
factors come from Riccati equations. A check compares their distance with the distance of the plants'
responses.
"""

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.norms import NormBracket, hinf_norm
from lpvguard.engine.synthesis.statespace import StateSpace, balanced, lft, same_time, series, to_continuous

NORM_RTOL = 1e-6
DISTANCE_ATOL = 1e-6
"""Largest difference between the chordal distances (at most 1) of the plants and of their factors."""


def nu_gap(first: StateSpace, second: StateSpace) -> NormBracket:
    """Bracket the ν-gap of two plants, with its frequency [rad/s].

    Parameters
    ----------
    first, second : StateSpace

    Returns
    -------
    NormBracket, (1, 1) for a wrong winding number

    Raises
    ------
    SynthesisError
        If shapes or dt differ, or a mode is not stabilisable or not detectable.

    References
    ----------
    THEORY 7.10.
    """
    same_time(first, second)
    if first.D.shape != second.D.shape:
        raise SynthesisError(
            "nu_gap", "second", f"{second.D.shape} system", f"{first.D.shape}, the shape of the first plant"
        )
    dt = first.dt
    P1, P2 = (balanced(to_continuous(balanced(P))) for P in (first, second))
    chordal = series(_left_factor(P2), _right_factor(P1))
    if _unstable_zeros(P1, P2) != P2.order:
        return NormBracket(1.0, 1.0, np.nan)
    norm = hinf_norm(chordal, NORM_RTOL)
    _require_distance(P1, P2, chordal, norm.peak_frequency)
    where = norm.peak_frequency
    return NormBracket(
        norm.lower, min(norm.upper, 1.0), float(2 / dt * np.arctan(where * dt / 2)) if dt else where
    )


def nu_margin(plant: StateSpace, controller: StateSpace) -> float:
    """Compute b(P, K), the reciprocal of ‖[I; K](I − P K)⁻¹[I, P]‖∞, for u = K y.

    Parameters
    ----------
    plant, controller : StateSpace

    Returns
    -------
    float, proved lower bound of b, 0 for an unstable loop

    References
    ----------
    THEORY 7.10.
    """
    n, p, m = plant.order, plant.n_outputs, plant.n_inputs
    # From [w_y, w_u, u] to [y, u, y]: y = P (u + w_u) + w_y.
    B = np.hstack([np.zeros((n, p)), plant.B, plant.B])
    C = np.vstack([plant.C, np.zeros((m, n)), plant.C])
    measured = np.hstack([np.eye(p), plant.D, plant.D])
    D = np.vstack([measured, np.hstack([np.zeros((m, p + m)), np.eye(m)]), measured])
    return float(1 / hinf_norm(lft(StateSpace(plant.A, B, C, D, plant.dt), controller), NORM_RTOL).upper)


def _require_distance(P1: StateSpace, P2: StateSpace, chordal: StateSpace, peak: float) -> None:
    """Raise SynthesisError unless the plants and their factors have the same chordal distance.

    The check uses ``peak`` [rad/s], zero, infinity, and the frequencies of the plants' poles.
    """
    omega = np.unique(np.concatenate([[0.0, peak, np.inf], np.abs(P1.poles()), np.abs(P2.poles())]))
    omega = omega[[_has_response(P1, w) and _has_response(P2, w) for w in omega]]
    of_factors = np.linalg.norm(chordal.response(omega), 2, axis=(1, 2))
    for w, G1, G2, size in zip(omega, P1.response(omega), P2.response(omega), of_factors, strict=True):
        distance = float(np.linalg.norm(_root(G2) @ (G2 - G1) @ _root(G1.conj().T).conj().T, 2))
        if not abs(distance - size) <= DISTANCE_ATOL:
            raise SynthesisError(
                "nu_gap",
                f"{w:.6g} rad/s",
                f"not proved: the plants' distance is {distance:.7g}, that of their factors {size:.7g}",
                "plants whose inputs and outputs are scaled to like sizes",
            )


def _has_response(P: StateSpace, omega: float) -> bool:
    """Return whether P has no pole within rounding of j ``omega``."""
    return not P.order or np.isinf(omega) or np.abs(P.poles() - 1j * omega).min() > 1e-9 * max(omega, 1.0)


def _root(G: np.ndarray) -> np.ndarray:
    """Return a root R of (I + G Gᴴ)⁻¹ = Rᴴ R, for G (p, m)."""
    return np.linalg.inv(np.linalg.cholesky(np.eye(len(G)) + G @ G.conj().T))


def _unstable_zeros(P1: StateSpace, P2: StateSpace) -> int:
    """Number of zeros of det(I + P₂(−s)ᵀ P₁(s)) with a positive real part, -1 for a zero at infinity.

    The winding number is right if this number is the order of P₂. A zero on the axis means a chordal distance
    of 1, which the norm shows.
    """
    adjoint = StateSpace(-P2.A.T, -P2.C.T, P2.B.T, P2.D.T)
    H = series(adjoint, P1)
    try:
        inverse = np.linalg.inv(np.eye(len(H.D)) + H.D)
    except np.linalg.LinAlgError:
        return -1
    zeros = np.linalg.eigvals(H.A - H.B @ inverse @ H.C)
    return int((zeros.real > 0).sum())


def _right_factor(P: StateSpace) -> StateSpace:
    """Normalised right factors [N; M] of P."""
    R = np.eye(P.n_inputs) + P.D.T @ P.D
    F = _gain(P)
    root = np.linalg.inv(np.linalg.cholesky(R)).T
    return StateSpace(
        P.A + P.B @ F, P.B @ root, np.vstack([P.C + P.D @ F, F]), np.vstack([P.D, np.eye(P.n_inputs)]) @ root
    )


def _left_factor(P: StateSpace) -> StateSpace:
    """Normalised left factors [−M̃, Ñ] of P."""
    dual = StateSpace(P.A.T, P.C.T, P.B.T, P.D.T)
    S = np.eye(P.n_outputs) + P.D @ P.D.T
    H = _gain(dual).T
    root = np.linalg.inv(np.linalg.cholesky(S))
    return StateSpace(
        P.A + H @ P.C,
        np.hstack([-H, P.B + H @ P.D]),
        root @ P.C,
        root @ np.hstack([-np.eye(P.n_outputs), P.D]),
    )


def _gain(P: StateSpace) -> np.ndarray:
    """State feedback F (m, n) of the normalised right factors."""
    R = np.eye(P.n_inputs) + P.D.T @ P.D
    if not P.order:
        return np.zeros((P.n_inputs, 0))
    try:
        X = sl.solve_continuous_are(P.A, P.B, P.C.T @ P.C, R, s=P.C.T @ P.D)
    except np.linalg.LinAlgError as error:
        raise SynthesisError(
            "nu_gap", "plant", "its Riccati equation has no solution", "no hidden unstable mode"
        ) from error
    return -np.linalg.solve(R, P.D.T @ P.C + P.B.T @ X)
