"""Bracket of the H∞ norm: a lower bound at a frequency that attains it, and an upper bound by a level test.

Continuous time uses the eigenvalues of the Hamiltonian matrix (Boyd & Balakrishnan 1990; Bruinsma & Steinbuch
1990). A bilinear map first makes a discrete system continuous and keeps its norm.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.synthesis.statespace import EPS, StateSpace, balanced, to_continuous

SMALLEST = 1e-100
"""Level that replaces zero. The square of B / level must not overflow."""


@dataclass(frozen=True)
class NormBracket:
    """Bracket of an H∞ norm: lower ≤ ‖G‖∞ ≤ upper, both inf when G is unstable.

    Attributes
    ----------
    lower, upper : float
    peak_frequency : float, rad/s, where σ̄(G) is lower, possibly inf or 0
    """

    lower: float
    upper: float
    peak_frequency: float


def hinf_norm(G: StateSpace, rtol: float = 1e-6) -> NormBracket:
    """Bracket ‖G‖∞ with upper ≤ (1 + rtol) lower, plus rounding.

    Rounding is that of G at its peak and of the bilinear map. DC and infinite (or Nyquist) frequency are
    included. Rounding of A may raise σ̄(G) at DC or at the frequency of a pole above this level. upper then
    is the raised value. The response is evaluated at each frequency where an eigenvalue of the Hamiltonian is
    near the imaginary axis, and between such neighbours. Near means a real part below 1e-3 of its magnitude,
    far more than rounding moves it. The test therefore also detects a crossing that rounding has moved off
    the axis.

    Parameters
    ----------
    G : StateSpace
    rtol : float, default 1e-06

    Returns
    -------
    NormBracket, (inf, inf) for an unstable G

    Raises
    ------
    ArithmeticError
        If 60 levels do not suffice.
    """
    if not G.stability_margin() > 0:
        return NormBracket(np.inf, np.inf, np.nan)
    H = balanced(to_continuous(balanced(G)))

    def warp(omega: float) -> float:
        return float(2 / G.dt * np.arctan(omega * G.dt / 2)) if G.dt else float(omega)

    poles = H.poles()
    start = np.concatenate([[0.0, np.inf], np.abs(poles), np.abs(poles.imag)])
    omega = np.unique(start)
    values, moved = _sizes(H, omega)
    k = int(np.argmax(values))
    lower, peak = float(values[k]), float(omega[k])
    if not (np.any(H.B) and np.any(H.C)):
        return NormBracket(lower, lower, warp(peak))
    lifted = float((values + moved)[np.isfinite(omega)].max())
    drift = _drift(G, H, omega, warp)

    def rounding(omega: float) -> float:
        return float(_sizes(H, np.array([omega]))[1][0]) + drift

    for _ in range(60):
        level = max(lower * (1 + rtol), SMALLEST)
        candidates = _crossings(H, level)
        if candidates.size == 0:
            return NormBracket(lower, max(level + rounding(peak), lifted), warp(peak))
        value, where = _largest(H, candidates)
        if value <= level:
            peak = where if value > lower else peak
            return NormBracket(max(lower, value), max(level + rounding(peak), lifted), warp(peak))
        lower, peak = value, where
    raise ArithmeticError("the level test of the H-infinity norm did not settle in 60 steps")


def _drift(G: StateSpace, H: StateSpace, omega: np.ndarray, warp: Callable[[float], float]) -> float:
    """Largest σ̄ over ``omega`` (k,) of the rounding error of the bilinear map from a discrete G to H."""
    if not G.dt or not G.order:
        return 0.0
    change = H.response(omega) - G.response([warp(w) for w in omega])
    return float(
        np.linalg.norm(change[np.isfinite(change).all(axis=(1, 2))], 2, axis=(1, 2)).max(initial=0.0)
    )


def _largest(H: StateSpace, omega) -> tuple[float, float]:
    """max over ``omega`` of σ̄(H(jω)) and the frequency that attains it."""
    omega = np.unique(omega)
    values = np.linalg.norm(H.response(omega), 2, axis=(1, 2))
    k = int(np.argmax(values))
    return float(values[k]), float(omega[k])


def _sizes(H: StateSpace, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """σ̄(H(jω)) at each of ``omega`` (k,), and its change by rounding of A's entries.

    The change is of first order in a few units in the last place of each entry, so it does not depend on the
    units of the states. It is far below any rtol unless the loop is nearly unstable or its signals differ by
    many decades. Rounding of large entries of A may hide a slow pole; the change is then large at the
    frequency of the pole.
    """
    response = np.broadcast_to(H.D.astype(complex), (len(omega), *H.D.shape)).copy()
    moved, finite = np.zeros(len(omega)), np.isfinite(omega)
    left, right = _both_sides(H, omega[finite])
    response[finite] += H.C @ right
    entries = np.abs(left).swapaxes(1, 2) @ np.abs(H.A) @ np.abs(right)
    moved[finite] = 8 * EPS * np.linalg.norm(entries, axis=(1, 2))
    return np.linalg.norm(response, 2, axis=(1, 2)), moved


def _both_sides(H: StateSpace, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(jω − A)⁻ᵀ Cᵀ (k, n, p) and (jω − A)⁻¹ B (k, n, m) at each of ``omega`` (k,), by one factorisation."""
    left = np.empty((len(omega), *H.C.T.shape), complex)
    right = np.empty((len(omega), *H.B.shape), complex)
    factor, solve = sl.get_lapack_funcs(("getrf", "getrs"), (right,))
    minus_A, B, C_T = np.asfortranarray(-H.A, complex), H.B.astype(complex), H.C.T.astype(complex)
    for k, w in enumerate(omega if H.order else ()):
        pencil = minus_A.copy(order="F")
        pencil.ravel(order="K")[:: H.order + 1] += 1j * w
        lu, pivots, singular = factor(pencil, overwrite_a=True)
        if singular:
            raise np.linalg.LinAlgError("a pole on the imaginary axis")
        right[k], left[k] = solve(lu, pivots, B)[0], solve(lu, pivots, C_T, trans=1)[0]
    return left, right


def _crossings(H: StateSpace, level: float) -> np.ndarray:
    """Frequencies where σ̄(H(jω)) may equal ``level``, and points between them; empty when there are none."""
    n = H.order
    B, D, C = H.B / level, H.D / level, H.C
    if H.n_inputs > H.n_outputs:  # the transpose has the same norm and a smaller D.T @ D
        A, B, C, D = H.A.T, C.T / level, H.B.T, D.T
    else:
        A = H.A
    R = np.eye(D.shape[1]) - D.T @ D
    F = np.linalg.solve(R, np.hstack([D.T @ C, B.T]))
    hamiltonian = np.block([[A, np.zeros((n, n))], [-C.T @ C, -A.T]]) + np.vstack([B, -C.T @ D]) @ F
    return axis_frequencies(hamiltonian, float(np.linalg.norm(A)))


def near_axis(eigenvalues: np.ndarray, scale: float) -> np.ndarray:
    """(K,) True for eigenvalues (K,) that are imaginary up to rounding.

    ``scale`` is ‖A‖ of the system. Rounding moves an eigenvalue of a nearly defective cluster by about
    sqrt(eps) times the matrix norm.
    """
    return np.abs(eigenvalues.real) <= 1e-3 * np.abs(eigenvalues) + 1e2 * EPS * scale


def axis_frequencies(hamiltonian: np.ndarray, scale: float) -> np.ndarray:
    """Frequencies (K,) [rad/s] of eigenvalues near the imaginary axis, DC, and points between and above them.

    The result is empty when no eigenvalue of ``hamiltonian`` (2n, 2n) lies near the axis. ``scale`` is ‖A‖ of
    the system.
    """
    eigenvalues = np.linalg.eigvals(hamiltonian)
    cross = np.unique(np.abs(eigenvalues.imag[near_axis(eigenvalues, scale)]))
    if cross.size == 0:
        return cross
    cross = np.concatenate([[0.0], cross[cross > 0]])
    between = 0.5 * (cross[1:] + cross[:-1])
    geometric = np.sqrt(cross[2:] * cross[1:-1])
    return np.concatenate([cross, between, geometric, [2 * cross[-1]]])
