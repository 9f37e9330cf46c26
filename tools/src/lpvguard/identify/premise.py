"""Test of the premise of a certificate, |delta| <= W_delta, by drives that did not set the bounds (THEORY
7.6).

At every frequency, output, speed cell and amplitude class of the judging drives, the premise is

    refuted where W_delta < |delta_c| - k se,   doubtful where W_delta < |delta_c| + k se                (T33)

W_delta is the weight of the certificate, with inflation and Tustin's map of the frequency. It is 0 for K_inf,
which is certified without uncertainty.
"""

from dataclasses import dataclass

import numpy as np

from ..base.errors import InputError
from ..engine.synthesis.statespace import prewarped
from .identification import StoredIdentification


@dataclass(frozen=True)
class Least:
    """Least ratio of W_delta to the error of the judging drives, at ``omega`` [rad/s] and ``v`` [m/s].

    ``delta`` is |delta_c|, ``spread`` is k se, and ``W_delta`` is the weight at this frequency.
    """

    ratio: float
    output: str
    omega: float
    v: float
    delta: float
    spread: float
    W_delta: float

    def sentence(self, sign: str) -> str:
        """Sentence with the ratio. ``sign`` is the sign of k se."""
        return (
            f"W_delta = {self.W_delta:.3g} is {self.ratio:.3g} times |delta_c| {sign} k se = "
            f"{self.delta:.3g} {sign} {self.spread:.3g} of {self.output} "
            f"at {self.omega:.3g} rad/s and {self.v:.3g} m/s"
        )


@dataclass(frozen=True)
class Premise:
    """Judgement of W_delta by the judging drives.

    Attributes
    ----------
    refuting : Least or None, ratio to |delta_c| - k se, None where this is nowhere above 0
    doubting : Least, ratio to |delta_c| + k se
    coverage : float, share of the folds of bound-setting drives that the bound of the others covers
    folds : int, number of these folds
    """

    refuting: Least | None
    doubting: Least
    coverage: float
    folds: int

    @property
    def refuted(self) -> bool:
        """Whether a drive that did not set the bounds refutes W_delta."""
        return self.refuting is not None and self.refuting.ratio < 1

    @property
    def doubtful(self) -> bool:
        """Tell if such a drive allows an error above W_delta."""
        return self.doubting.ratio < 1

    def sentence(self) -> str:
        """Sentence with the evidence."""
        least = "the drives that did not set the bounds need no uncertainty"
        if self.refuting is not None:
            least = f"for the drives that did not set the bounds, {self.refuting.sentence('-')}"
        left_out = f"{self.coverage:.0%} of {self.folds}" if self.folds else "none, because there is only one"
        return (
            f"premise |delta| <= W_delta at every frequency: {least}; folds of drives that the bound of the "
            f"other folds covers: {left_out}"
        )

    def to_dict(self) -> dict:
        """Convert to JSON types."""
        return {
            "sentence": self.sentence(),
            "refuting": None if self.refuting is None else vars(self.refuting),
            "doubting": vars(self.doubting),
            "left_out_covered": self.coverage,
            "folds": self.folds,
        }


def weight_met(stored: StoredIdentification, omega: np.ndarray) -> np.ndarray:
    """Compute |W_delta| of certificates, with inflation and Tustin's map of the frequency.

    Parameters
    ----------
    stored : StoredIdentification
    omega : ndarray (K,), rad/s, below half the sampling rate

    Returns
    -------
    ndarray (K, n_delta)
    """
    Ts = stored.project.Ts_s
    return stored.fitted.at(prewarped(omega, Ts))[0]


def premise(stored: StoredIdentification) -> Premise:
    """Judge the fitted W_delta by the judging drives.

    Parameters
    ----------
    stored : StoredIdentification

    Returns
    -------
    Premise

    Raises
    ------
    InputError
        If there are no judging drives, or none is informative.

    References
    ----------
    THEORY 7.6, (T33).
    """
    error = stored.model_error
    if error.judging is None or not np.isfinite(error.judging.se).any():
        raise InputError(
            stored.folder,
            "premise",
            "no drive judges W_delta: every drive set the bounds, or none is excited long enough",
            "drives of another split with excitation",
        )
    omega, names = error.grid.omega, [s.name for s in stored.project.outputs]
    W = np.broadcast_to(weight_met(stored, omega), (len(omega), len(names)))
    settings = stored.project.design
    if settings is not None and settings.structure == "K_inf":
        W = np.zeros_like(W)
    judging = error.judging
    # An uninformative frame cannot refute, because it supports no claim beyond 1 + rho.
    informative = np.isfinite(judging.se) & (judging.k * judging.se < 1)

    def least(against: np.ndarray) -> Least | None:
        sizes = np.where(informative & (against > 0), against, 0.0)
        if not sizes.any():
            return None
        ratio = W[:, :, None, None] / np.maximum(sizes, 1e-300)
        at = np.unravel_index(np.argmin(ratio), ratio.shape)
        g, j = int(at[0]), int(at[1])
        return Least(
            float(ratio[at]),
            names[j],
            float(omega[g]),
            float(judging.v[at]),
            float(np.abs(judging.delta[at])),
            float(judging.k * judging.se[at]),
            float(W[g, j]),
        )

    doubting = least(judging.upper)
    if doubting is None:
        raise InputError(
            stored.folder,
            "premise",
            "no drive that did not set the bounds gives information about the model error",
            "more excitation",
        )
    return Premise(least(judging.lower), doubting, error.coverage, len(error.left_out))


def require_premise(stored: StoredIdentification) -> Premise:
    """Require that no judging drive refutes the premise.

    Parameters
    ----------
    stored : StoredIdentification

    Returns
    -------
    Premise

    Raises
    ------
    InputError
        If a judging drive refutes it, or there are no judging drives.
    """
    judged = premise(stored)
    if judged.refuted and judged.refuting is not None:
        raise InputError(
            stored.folder,
            "W_delta",
            judged.refuting.sentence("-"),
            "a W_delta that the drives outside the bound-setting split do not refute",
        )
    return judged
