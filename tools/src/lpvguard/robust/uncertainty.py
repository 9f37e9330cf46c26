"""Fit uncertainty sets to frequency responses, and weights above their radius."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.errors import InputError
from ..engine.overbound.fit import fit_overbound
from .systems import frequencies, python_control

if TYPE_CHECKING:
    import control

FORMS = {
    "additive": "G = G0 + E",
    "multiplicative_input": "G = G0 (I + E)",
    "multiplicative_output": "G = (I + E) G0",
    "inverse_input": "G = G0 (I - E)^-1",
    "inverse_output": "G = (I - E)^-1 G0",
    "feedback": "G = G0 (I - E G0)^-1",
    "coprime": "G = (M + E_M)^-1 (N + E_N), G0 = M^-1 N normalised",
}
"""Forms of an uncertainty set. E is any stable system with largest singular value at most the radius."""

CONSISTENT = 1e-9
"""Largest relative part of G that the best E may leave unexplained."""


@dataclass(frozen=True)
class UncertaintySet:
    """Smallest set of one form that contains all measured responses.

    Attributes
    ----------
    form : str
        One of ``FORMS``.
    omega : ndarray, shape (k,)
        Frequencies in rad/s.
    residuals : ndarray, shape (n, k, rows, cols)
        E for each response. For ``coprime`` it is [E_N, E_M].
    radius : ndarray, shape (k,)
        Largest singular value of E over all responses.
    """

    form: str
    omega: np.ndarray
    residuals: np.ndarray
    radius: np.ndarray

    def weight(self, max_order: int = 4) -> tuple[control.TransferFunction, float]:
        """Fit a weight above the radius (see ``overbound``)."""
        return overbound(self.omega, self.radius, max_order)


def overbound(omega: Any, magnitude: Any, max_order: int = 4) -> tuple[control.TransferFunction, float]:
    """Fit a stable minimum-phase weight of low order that is proved to lie above samples.

    Parameters
    ----------
    omega : array_like, shape (k,)
        Increasing frequencies in rad/s.
    magnitude : array_like, shape (k,)
        Samples; NaN where nothing is known. Samples of 0 are raised to 1e-6 times the largest.
    max_order : int
        Highest order, at most 8.

    Returns
    -------
    weight : control.TransferFunction
        Its magnitude is at least the samples' linear interpolation in logarithms, at every frequency.
    worst_ratio : float
        Proved upper bound of the ratio of the weight to the samples.

    Raises
    ------
    InputError
        A frequency or a sample is impossible, or no weight could be certified.

    References
    ----------
    lib/THEORY.md 5.3; the paper, section III.
    """
    omega, magnitude = frequencies(omega), np.asarray(magnitude, dtype=float)
    largest = float(np.nanmax(magnitude, initial=0.0))
    fit = fit_overbound(
        omega, magnitude, max_order=max_order, floor=1e-6 * largest or 1e-12, name="overbound"
    )
    return python_control().tf(fit.weight.num, fit.weight.den), float(10 ** (fit.worst_ratio_db / 20))


def uncertainty_set(omega: Any, nominal: Any, responses: Any, form: str) -> UncertaintySet:
    """Find the smallest set of one form around a nominal model that contains measured responses.

    Parameters
    ----------
    omega : array_like, shape (k,)
        Increasing frequencies in rad/s.
    nominal : array_like, shape (k, p, m), or control.StateSpace or control.TransferFunction
        Nominal response G0.
    responses : array_like, shape (n, k, p, m)
        Measured responses G.
    form : str
        One of ``FORMS``.

    Raises
    ------
    InputError
        A shape or number is wrong, or no E of this form reproduces a response exactly.

    References
    ----------
    Zhou, Doyle and Glover 1996, chapters 8 and 9; for ``coprime`` Vinnicombe 2001, chapter 3.
    """
    if form not in FORMS:
        raise InputError("uncertainty_set", "form", repr(form), "one of " + ", ".join(FORMS))
    omega = frequencies(omega)
    G0 = _samples(nominal, omega, "nominal")
    G = np.asarray(responses, dtype=complex)
    if G.ndim != 4 or G.shape[1:] != G0.shape or len(G) == 0 or not np.isfinite(G).all():
        raise InputError(
            "uncertainty_set", "responses", f"shape {G.shape}", f"finite (n, {', '.join(map(str, G0.shape))})"
        )
    residuals, implied = _residual(form, G0[None], G)
    error = np.linalg.norm(implied - G, axis=(2, 3)) / np.maximum(np.linalg.norm(G, axis=(2, 3)), 1e-300)
    if not (error <= CONSISTENT).all():
        n, k = np.unravel_index(int(np.argmax(np.where(np.isnan(error), np.inf, error))), error.shape)
        raise InputError(
            "uncertainty_set",
            f"response {n} at {omega[k]:.4g} rad/s",
            f"no E of the form {FORMS[form]} reproduces it",
            "another form, for example additive or coprime",
        )
    return UncertaintySet(form, omega, residuals, np.linalg.norm(residuals, 2, axis=(2, 3)).max(axis=0))


def _samples(system: Any, omega: np.ndarray, name: str) -> np.ndarray:
    """Return the response (k, p, m) of a system or of samples; InputError for another shape."""
    package = python_control()
    if isinstance(system, package.lti.LTI):
        samples = np.moveaxis(
            np.atleast_3d(package.frequency_response(system, omega, squeeze=False).complex), -1, 0
        )
    else:
        samples = np.asarray(system, dtype=complex)
    if samples.ndim != 3 or len(samples) != len(omega) or not np.isfinite(samples).all():
        raise InputError("uncertainty_set", name, f"shape {samples.shape}", f"finite ({len(omega)}, p, m)")
    return samples


def _residual(form: str, G0: np.ndarray, G: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest E of a form and the response that results from E."""
    p, m = G.shape[-2:]
    I_p, I_m = np.eye(p), np.eye(m)
    pinv = np.linalg.pinv
    if form == "additive":
        return G - G0, G
    if form == "multiplicative_input":
        E = pinv(G0) @ (G - G0)
        return E, G0 @ (I_m + E)
    if form == "multiplicative_output":
        E = (G - G0) @ pinv(G0)
        return E, (I_p + E) @ G0
    if form == "inverse_input":  # G - G0 = G E
        E = pinv(G) @ (G - G0)
        return E, G0 @ pinv(I_m - E)
    if form == "inverse_output":  # G - G0 = E G
        E = (G - G0) @ pinv(G)
        return E, pinv(I_p - E) @ G0
    if form == "feedback":  # G - G0 = G E G0
        E = pinv(G) @ (G - G0) @ pinv(G0)
        return E, G0 @ pinv(I_m - E @ G0)
    # G0 = M^-1 N with M M* + N N* = I: M is (I + G0 G0*)^-1/2 up to a unitary factor, which changes no size.
    # (M + E_M) G = N + E_N, so [E_N, E_M] [I; -G] = M G - N; the smallest solution takes the pseudo-inverse.
    values, vectors = np.linalg.eigh(I_p + G0 @ np.conj(np.swapaxes(G0, -1, -2)))
    M = (vectors / np.sqrt(values)[..., None, :]) @ np.conj(np.swapaxes(vectors, -1, -2))
    N = M @ G0
    stack = np.concatenate([np.broadcast_to(I_m, (*G.shape[:-2], m, m)), -G], axis=-2)
    E = (M @ G - N) @ pinv(stack)
    return E, np.linalg.solve(M + E[..., m:], N + E[..., :m])
