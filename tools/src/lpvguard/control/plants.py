"""Fig. 1 of an identified vehicle: its settings, its weights and the generalised plant at a frozen speed.

Everything is discrete from the start: the vehicle is sampled exactly at Ts, the weights by Tustin's map.
Whole samples of the model's input delay lie before the vehicle; a fraction of a sample lies within it. The
performance weights W_u have no delay. The weight of input k is W_u1 rate_1 / rate_k, with the first input's
weight W_u1 and the inputs' rate limits.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..base.errors import InputError
from ..engine.synthesis import interconnection as fig1
from ..engine.synthesis.statespace import StateSpace, append, gain, series
from ..identify.identification import StoredIdentification
from ..identify.weights import FittedWeight
from ..vehicle.design_settings import DesignSettings
from ..vehicle.nominal import NominalModel
from .stored_frames import SplitWeights, StoredFrames

LEAST_NOISE = 0.01
"""Least noise of a sensor, as a share of the least disturbance weight, because every measurement has
noise."""
LARGEST_WINDOW_ERROR = 0.1
"""Largest median error, over bins, with which frames may determine the state uncertainty for a design of
K_is."""


def design_settings(stored: StoredIdentification) -> DesignSettings:
    """Return the project's [design] table.

    Parameters
    ----------
    stored : StoredIdentification

    Returns
    -------
    DesignSettings

    Raises
    ------
    InputError
        If the project file has no [design] table.
    """
    if stored.project.design is None:
        raise InputError(
            f"vehicle {stored.project.name}", "design", "no [design] table", "objectives for step 8"
        )
    return stored.project.design


def weight_system(weight: FittedWeight, inflation: float) -> StateSpace:
    """A fitted weight times ``inflation`` as a continuous system, s in rad/s."""
    return fig1.rational(inflation * weight.fit.weight.num, weight.fit.weight.den)


def vehicle_at(model: NominalModel, v: float) -> StateSpace:
    """Nominal vehicle from u to y at speed v [m/s], sampled with held input, delay included."""
    A, B = (m[0] for m in model.matrices(np.array([v])))
    free = StateSpace(A, B, model.C, np.zeros((model.n_y, B.shape[1])))
    held = fig1.held_with_delay(free, model.n_u, model.Ts, model.delay_fraction)
    outputs = held.select(slice(0, model.n_y), slice(None))
    return series(outputs, append(*[fig1.delay_line(model.delay, model.Ts)] * model.n_u))


@dataclass(frozen=True)
class DesignProblem:
    """Problem of Fig. 1 of an identified vehicle: model, weights and generalised plants over speed.

    Attributes
    ----------
    stored : StoredIdentification
    settings : DesignSettings, structure, A_t, A_u and shapes, from the project or from the caller

    References
    ----------
    Paper, Fig. 1 and section V.
    """

    stored: StoredIdentification
    settings: DesignSettings
    _split_by_lambda_s: dict[float, SplitWeights] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def from_identification(cls, stored: StoredIdentification) -> DesignProblem:
        """Make the problem of the project's [design] table; raise InputError without such a table."""
        return cls(stored, design_settings(stored))

    def with_settings(self, settings: DesignSettings) -> DesignProblem:
        """The problem of the same vehicle with other settings."""
        return replace(self, settings=settings)

    @property
    def model(self) -> NominalModel:
        """The nominal model."""
        return self.stored.model

    def state_uncertainty(self) -> SplitWeights:
        """Weights of class S2 at the identified gamma_w: W_delta_i dimensionless, W_delta_s in 1/s.

        xi_s adds to the derivative of the state. The inverse dynamics give xi_s, but a windowed DFT only
        approximates them. Raises InputError if the frames determine xi_s with too large an error.
        """
        stored, lambda_s = self.stored, self.settings.lambda_s
        error = stored.bounds["window_error_median"]
        worst = int(np.nanargmax(error))
        if error[worst] > LARGEST_WINDOW_ERROR:
            omega = stored.bounds["omega_rad_s"][worst]
            raise InputError(
                stored.folder,
                "design.structure",
                f"K_is: these frames determine the state uncertainty with a median "
                f"error of {error[worst]:.0%} at {omega:.3g} rad/s",
                f"K_i, or frames whose error is at most {LARGEST_WINDOW_ERROR:.0%}: "
                'the plain DFT, frames.estimator = "dft"',
            )
        if lambda_s not in self._split_by_lambda_s:
            frames = StoredFrames(stored)
            split = frames.explain_with_state(stored.bounds["gamma_w"], lambda_s)
            self._split_by_lambda_s[lambda_s] = frames.weights(split)
        return self._split_by_lambda_s[lambda_s]

    @cached_property
    def weights(self) -> fig1.PlantWeights:
        """Weights of Fig. 1, from the settings and from the identification.

        Without drives for the noise, W_n is the standard deviation of the sensors' noise. W_w then also
        contains this noise. Raises InputError if identification and design have different uncertainty
        structures. K_o needs S1_diagonal. K_i and K_is need S1. K_inf accepts both. With a single output, K_o
        also accepts S1.
        """
        stored, settings, fitted = self.stored, self.settings, self.stored.fitted
        outputwise, n_y = settings.structure == fig1.OUTPUTWISE, stored.project.n_y
        if settings.structure != "K_inf" and len(fitted.W_delta) != (n_y if outputwise else 1):
            raise InputError(
                stored.folder,
                "bounds.structure",
                f"{stored.project.bounds.structure} with design.structure = {settings.structure}",
                "S1_diagonal with K_o, or S1 with K_i or K_is: the same uncertainty for bounds and design",
            )
        if not fitted.W_C:
            raise InputError(
                stored.folder,
                "W_C",
                "missing, because the identification had no [design] table",
                "`lpvguard identify` again with this project file",
            )
        W_w, W_delta_i, W_delta_s = (
            fitted.W_w_S0 if settings.structure == "K_inf" and fitted.W_w_S0 else fitted.W_w,
            fitted.W_delta[0],
            fitted.W_delta[0],
        )
        if settings.structure == "K_is":
            state = self.state_uncertainty()
            W_w, W_delta_i, W_delta_s = state.W_w, state.W_delta_i, state.W_delta_s or state.W_delta_i
        g = fitted.inflation
        return fig1.PlantWeights(
            W_R=fig1.rational(settings.W_R_num, settings.W_R_den),
            W_C=weight_system(fitted.W_C[0], 1.0),
            W_t=fig1.zeros_poles(settings.A_t, settings.W_t_zeros, settings.W_t_poles),
            W_u=tuple(
                fig1.zeros_poles(
                    settings.A_u * settings.input_rate_max_per_s[0] / rate,
                    settings.W_u_zeros,
                    settings.W_u_poles,
                )
                for rate in settings.input_rate_max_per_s
            ),
            W_n=tuple(weight_system(W, g) for W in fitted.W_n) or self._sensor_noise(),
            W_w=tuple(weight_system(W, g) for W in W_w),
            W_delta_i=weight_system(W_delta_i, g),
            W_delta_s=weight_system(W_delta_s, g),
            W_delta_o=tuple(weight_system(W, g) for W in fitted.W_delta) if outputwise else (),
            outputs=tuple(s.column for s in stored.project.outputs),
            controlled=stored.project.controlled,
        )

    def _sensor_noise(self) -> tuple[StateSpace, ...]:
        """Constant W_n (n_y,) from the sensors' noise and resolution in the drives that set the bounds."""
        bounds, fitted = self.stored.bounds, self.stored.fitted
        seen = np.hypot(bounds["sensor_noise"], bounds["resolution"] / np.sqrt(12))
        least = [LEAST_NOISE * W.magnitude(self.stored.estimator.omega).min() for W in fitted.W_w]
        return tuple(fig1.rational([max(pair)], [1.0]) for pair in zip(seen.tolist(), least, strict=True))

    def plant(self, v: float, *, delayed: bool = False, probes: bool = False) -> fig1.GeneralisedPlant:
        """The discrete generalised plant at speed v [m/s], as `plant_at` makes it."""
        return plant_at(self.model, self.weights, v, delayed, self.settings.structure, probes)


def plant_at(
    model: NominalModel,
    weights: fig1.PlantWeights,
    v: float,
    delayed: bool,
    structure: str,
    probes: bool = False,
) -> fig1.GeneralisedPlant:
    """Discrete generalised plant at speed v [m/s], the model's input delay included.

    ``delayed`` adds one sample of delay before the control input, for the controller's computation.
    ``probes`` is the option of `generalised_plant`.
    """
    A, B = (m[0] for m in model.matrices(np.array([v])))
    late = model.delay + model.delay_fraction
    plant = fig1.generalised_plant(A, B, weights, structure, model.Ts, late, probes, model.C)
    if not delayed:
        return plant
    n_w, n_u, dt = plant.system.n_inputs - plant.n_control, plant.n_control, plant.system.dt
    computed = series(plant.system, append(gain(np.eye(n_w), dt), *[fig1.delay_line(1, dt)] * n_u))
    return replace(plant, system=replace(computed, inputs=plant.system.inputs))
