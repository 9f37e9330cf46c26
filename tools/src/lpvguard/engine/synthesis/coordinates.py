"""Coordinates of the state in which the Riccati equations lose few digits; the least certain pole of a
plant."""

from dataclasses import replace

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.synthesis.statespace import EPS, StateSpace, balancing, scaled_states

SPARE = 128
"""Number of binary digits of T⁻¹ A T below the last digit of the data."""
BITS = 53
"""Binary digits of a double."""
SMALLER, LEAST = 0.1, 0.2
"""Two shares of ‖A‖. A Schur form is used only if its norm is below ``SMALLER``. It is not tried if the norm
of the eigenvalues is above ``LEAST``, because exact products then gain too little."""
CONDITION = 1e10
"""Largest condition number of the eigenvectors that may serve as a basis."""
TINY = 1e-300
"""Stands for zero in a denominator."""
UNCERTAIN = 1e-3
"""Largest movement of a pole by rounding, as a share of its distance to the stability border."""
REFINEMENTS = 5
"""Number of corrections of T⁻¹. Each adds the digits that the condition of T leaves: about six at 1e10."""


def schur_coordinates(G: StateSpace) -> tuple[StateSpace, np.ndarray]:
    """G in the coordinates of a balanced Schur form, and the basis T (n, n) with x = T x̃.

    G itself is returned unless these coordinates reduce ‖A‖ to less than ``SMALLER`` of its value. A dense,
    badly conditioned change of coordinates makes ‖A‖ far larger than the eigenvalues, and scaling alone
    cannot undo it.
    """
    # The norm of the eigenvalues is a lower bound of the norm of every similar matrix.
    if np.linalg.norm(np.linalg.eigvals(G.A)) >= LEAST * np.linalg.norm(G.A):
        return G, np.eye(G.order)
    schur = sl.schur(G.A)[1]
    other = transformed(G, schur)
    t = balancing(other)
    other = scaled_states(other, t)
    smaller = np.linalg.norm(other.A) < SMALLER * np.linalg.norm(G.A)
    return (other, schur * t) if smaller else (G, np.eye(G.order))


def modal_coordinates(G: StateSpace) -> tuple[StateSpace, np.ndarray]:
    """G with one real block of A for each pole or pair, and the basis T (n, n) with x = T x̃.

    Slow modes are then separate from fast ones. G is returned where the eigenvectors do not span the space.
    """
    values, vectors = np.linalg.eig(G.A)
    T = sl.cdf2rdf(values, vectors)[1] if np.iscomplexobj(values) else vectors
    if G.order < 2 or not np.linalg.cond(T) < CONDITION:
        return G, np.eye(G.order)
    other = transformed(G, T)
    t = balancing(other)
    return scaled_states(other, t), T * t


def transformed(G: StateSpace, T: np.ndarray) -> StateSpace:
    """G in the coordinates x = T x̃, with T (n, n). Every entry is exact to its last digit.

    In bad coordinates many digits of the data cancel here. Products therefore use whole numbers, which are
    exact, and exact remainders refine T⁻¹.
    """
    bits = BITS - min(int(np.frexp(X[X != 0])[1].min(initial=0)) for X in (G.A, G.B, G.C, T))
    A, B, C, left = (_whole(X, bits) for X in (G.A, G.B, G.C, T))
    known = np.hstack([A @ left, B << bits]) << SPARE
    quotient = np.zeros(known.shape, dtype=object)
    for _ in range(REFINEMENTS):
        rest = np.linalg.solve(T, _rounded(known - left @ quotient, 2 * bits + SPARE))
        quotient = quotient + _whole(rest, bits + SPARE)
    X, n = _rounded(quotient, bits + SPARE), G.order
    if not np.linalg.norm(rest) <= EPS * np.linalg.norm(X):
        raise np.linalg.LinAlgError("coordinates of the state that rounding decides")
    return replace(G, A=X[:, :n], B=X[:, n:], C=_rounded(C @ left, 2 * bits))


def _whole(X: np.ndarray, bits: int) -> np.ndarray:
    """X · 2**bits as whole numbers, rounded down."""
    part, exponent = np.frexp(X)
    shift = exponent.astype(object) + (bits - BITS)
    whole = (part * 2.0**BITS).astype(np.int64).astype(object)
    return (whole << np.maximum(shift, 0)) >> np.maximum(-shift, 0)


def _rounded(whole: np.ndarray, bits: int) -> np.ndarray:
    """Whole numbers divided by 2**bits, as floats, with one rounding each."""
    return np.array([x / 2**bits for x in whole.flat]).reshape(whole.shape)


def frail_pole(plant: StateSpace) -> str:
    """A sentence on the pole that the last digits of A leave most uncertain.

    It is empty where every pole is certain. It uses the first-order bound eps |y|ᵀ|A||x| / |yᴴx| on a pole's
    movement; it does not depend on the units of the states.
    """
    if plant.order == 0:
        return ""
    poles, left, right = sl.eig(plant.A, left=True, right=True)
    overlap = np.abs(np.sum(left.conj() * right, axis=0))
    moved = EPS * np.sum(np.abs(left) * (np.abs(plant.A) @ np.abs(right)), axis=0) / np.maximum(overlap, TINY)
    room = np.abs(1 - np.abs(poles)) if plant.dt else np.abs(poles.real)
    k = int(np.argmax(moved / np.maximum(room, TINY)))
    if moved[k] <= UNCERTAIN * room[k]:
        return ""
    return f"the last digits of A move the pole at {poles[k]:.4g} by up to {moved[k]:.1g}"
