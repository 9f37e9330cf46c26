"""True and promised margins of the loop at one speed and one amplitude of the demand (THEORY 7.5).

True margins are those of the controller with a measured response of the vehicle. Promised margins are the
least margins over all certified loops: the nominal model with |delta| <= W_delta. W_delta is evaluated at
(2/Ts) tan(omega Ts/2), as in Tustin's map of the plant.

A measured response goes from the demand of a sample to the outputs at the sample instants, just before the
demand changes. It contains hold, actuator delay and actuator lag. The controller contains its own sample of
delay (``Scheduled`` is strictly proper). The loop therefore has each delay once.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..base.errors import InputError
from ..core.scheduled import Scheduled
from ..engine.synthesis.margins import LoopMargins, Response, guaranteed, margins, of_samples
from ..engine.synthesis.statespace import StateSpace
from ..identify.identification import StoredIdentification
from ..identify.weights import Weights
from ..vehicle.nominal import NominalModel
from .input_limit import turning_limit
from .plants import design_settings

LATERAL_ACCELERATION_MAX = 4.0
"""[m/s^2] Largest predicted steady lateral acceleration. Above it tyres are not nearly linear."""
PROMISED_GRID = 400
LAST = 1 - 1e-6
"""Highest frequency of the promise, as a share of half the sampling frequency."""


@dataclass(frozen=True)
class MeasuredResponse:
    """Response to sines at one speed and amplitude.

    Attributes
    ----------
    v : float, m/s
    asked, amplitude : float, requested and actual amplitude of the demand [input unit]
    omega : ndarray (K,), rad/s
    G : ndarray (K, n_y) of complex, outputs per demand
    """

    v: float
    asked: float
    amplitude: float
    omega: np.ndarray
    G: np.ndarray


@dataclass(frozen=True)
class Deviation:
    """Largest |delta_j| / W_delta of output j, at ``omega`` [rad/s]; ``delta`` is |G_j/P_j - 1|."""

    output: str
    omega: float
    delta: float
    W_delta: float

    @property
    def ratio(self) -> float:
        """|delta| / W_delta; above 1 the vehicle is not in the certified set."""
        return self.delta / self.W_delta


@dataclass(frozen=True)
class TrueLoop:
    """The true loop at one speed and amplitude.

    Attributes
    ----------
    v : float, m/s
    asked, amplitude : float, as in ``MeasuredResponse``
    margins : LoopMargins
    deviations : tuple of Deviation, one for each output
    """

    v: float
    asked: float
    amplitude: float
    margins: LoopMargins
    deviations: tuple[Deviation, ...]


def require_certified_by_W_delta(stored: StoredIdentification) -> None:
    """Require a structure whose certificate is about W_delta alone: K_i or K_o.

    Parameters
    ----------
    stored : StoredIdentification

    Raises
    ------
    InputError
        If the structure is another one.
    """
    structure = design_settings(stored).structure
    if structure not in ("K_i", "K_o"):
        raise InputError(
            f"vehicle {stored.project.name}",
            "design.structure",
            f"{structure}: its certificate needs more than W_delta",
            "K_i or K_o",
        )


def certified_weight(fitted: Weights, Ts: float, omega: np.ndarray) -> np.ndarray:
    """Compute W_delta as the certificate of a sampled loop uses it.

    Parameters
    ----------
    fitted : Weights
    Ts : float, s
    omega : ndarray (K,), rad/s

    Returns
    -------
    ndarray (K, n_delta)
    """
    return fitted.at(2 / Ts * np.tan(omega * Ts / 2))[0]


def within_use(model: NominalModel, v: float, amplitudes: Sequence[float]) -> list[float]:
    """Reduce amplitudes u of the demand so that the lateral acceleration is at most LATERAL_ACCELERATION_MAX.

    The predicted steady lateral acceleration is v |G_r(0)| u. The yaw rate r is the first output.

    Parameters
    ----------
    model : NominalModel
    v : float, m/s
    amplitudes : Sequence[float], input unit

    Returns
    -------
    list of float, input unit
    """
    edge = float(turning_limit(model, LATERAL_ACCELERATION_MAX, np.array([v]))[0, 0])
    return [min(u, edge) for u in amplitudes]


def deviations(
    outputs: Sequence[str], omega: np.ndarray, delta: np.ndarray, W_delta: np.ndarray
) -> tuple[Deviation, ...]:
    """Find the deviation with the largest ratio for each output.

    Parameters
    ----------
    outputs : Sequence[str], names
    omega : ndarray (K,), rad/s
    delta : ndarray (K, n_y), |G_j/P_j - 1|
    W_delta : ndarray (K, n_delta)

    Returns
    -------
    tuple of Deviation
    """
    W = np.broadcast_to(W_delta, delta.shape)
    worst = np.argmax(delta / W, axis=0)
    return tuple(
        Deviation(name, float(omega[k]), float(delta[k, j]), float(W[k, j]))
        for j, (name, k) in enumerate(zip(outputs, worst, strict=True))
    )


class CertifiedLoop:
    """Nominal loop of a design with its uncertainty weight.

    The loop is broken at the vehicle's input, with negative feedback. L is the sum of L_j = -K_j P_j over the
    outputs j.

    Parameters
    ----------
    stored : StoredIdentification
    schedule : Scheduled, the controller

    Raises
    ------
    InputError
        If the structure is not K_i or K_o, whose certificates are about W_delta alone.
    """

    def __init__(self, stored: StoredIdentification, schedule: Scheduled):
        require_certified_by_W_delta(stored)
        self.stored, self.schedule = stored, schedule
        self.model: NominalModel = stored.model
        self.outputs = [signal.name for signal in stored.project.outputs]

    def amplitudes(self, v: float, amplitudes: Sequence[float]) -> list[float]:
        """Reduce ``amplitudes`` as `within_use` does."""
        return within_use(self.model, v, amplitudes)

    def W_delta(self, omega: np.ndarray) -> np.ndarray:
        """Certified weight (K, n_delta) of the sampled loop at ``omega`` (K,) [rad/s].

        n_delta is 1 (one delta for all outputs) or n_y.
        """
        return certified_weight(self.stored.fitted, self.model.Ts, omega)

    def promised(self, v: float) -> LoopMargins | None:
        """Least margins over all vehicles within W_delta at speed ``v`` [m/s]; None if a loop is unstable."""
        K = self._controller(v)
        last = LAST * np.pi / self.model.Ts

        def parts(omega: np.ndarray) -> np.ndarray:
            return -_feedback(K, omega) * self._nominal(omega, v)

        def radius(omega: np.ndarray) -> np.ndarray:
            W = self.W_delta(omega)
            return (np.abs(parts(omega).reshape(*W.shape, -1).sum(axis=2)) * W).sum(axis=1)

        grid = np.concatenate([[0.0], np.geomspace(1e-3, last, PROMISED_GRID)])
        return guaranteed(lambda omega: parts(omega).sum(axis=1), radius, grid)

    def true(self, measured: MeasuredResponse) -> TrueLoop:
        """Make the loop of the controller with a measured response.

        G/P is interpolated between the measured frequencies and constant below the first one. K and P are
        exact at every frequency.
        """
        v, omega = measured.v, measured.omega
        K = self._controller(v)
        ratio = measured.G / self._nominal(omega, v)
        true_over_nominal: list[Response] = [of_samples(omega, column) for column in ratio.T]

        def loop(at: np.ndarray) -> np.ndarray:
            G = self._nominal(at, v) * np.column_stack([part(at) for part in true_over_nominal])
            return -(_feedback(K, at) * G).sum(axis=1)

        return TrueLoop(
            v,
            measured.asked,
            measured.amplitude,
            margins(loop, np.concatenate([[0.0], omega])),
            deviations(self.outputs, omega, np.abs(ratio - 1), self.W_delta(omega)),
        )

    def _nominal(self, omega: np.ndarray, v: float) -> np.ndarray:
        """Nominal response (K, n_y), input delay included."""
        return self.model.frequency_response(omega, v)[..., 0]

    def _controller(self, v: float) -> StateSpace:
        """Controller at speed v [m/s]; raise InputError for an unstable one (Nyquist's condition)."""
        K = self.schedule.at(v)
        if K.stability_margin() <= 0:
            raise InputError("controller", f"v = {v:g} m/s", "has an unstable pole", "stable poles")
        return K


def _feedback(K: StateSpace, omega: np.ndarray) -> np.ndarray:
    """Response (K, n_y) of the controller from the outputs; its first input is the reference."""
    return K.response(omega)[:, 0, 1:]
