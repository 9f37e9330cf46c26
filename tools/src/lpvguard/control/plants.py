"""Fig. 1 of an identified vehicle: its settings, its weights and the generalised plant at a frozen speed.
Everything is discrete from the start: the vehicle sampled exactly at Ts, the weights by Tustin's map. The
model's input delay is whole samples before the vehicle; the performance weight W_u has no delay."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..base.errors import InputError
from ..engine.synthesis import interconnection as fig1
from ..engine.synthesis.statespace import StateSpace, append, gain, series, zero_order_hold
from ..identify.identification import StoredIdentification
from ..identify.weights import FittedWeight
from ..vehicle.design_settings import DesignSettings
from ..vehicle.nominal import NominalModel
from .stored_frames import SplitWeights, StoredFrames

LARGEST_WINDOW_ERROR = 0.1
"""Largest median error of the state's uncertainty from frames, over bins, for a design of K_is."""


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
        If there is none.
    """
    if stored.project.design is None:
        raise InputError(
            f"vehicle {stored.project.name}", "design", "no [design] table", "objectives for step 8"
        )
    return stored.project.design


def weight_system(weight: FittedWeight, inflation: float) -> StateSpace:
    """A fitted weight times ``inflation`` as a continuous system, s in rad/s."""
    return fig1.rational(inflation * weight.fit.weight.num, weight.fit.weight.den)


def whole_delay(model: NominalModel) -> int:
    """The model's input delay [samples]; InputError where it is not whole."""
    if model.delay_fraction:
        raise InputError(
            "model",
            "input_delay_s",
            f"{model.delay + model.delay_fraction:.6g} samples",
            f"a whole number of samples of {model.Ts:g} s for a design",
        )
    return model.delay


def vehicle_at(model: NominalModel, v: float) -> StateSpace:
    """Nominal vehicle from u to y at speed v [m/s], sampled with held input, delay included."""
    A, B = (m[0] for m in model.matrices(np.array([v])))
    free = StateSpace(A, B, model.C, np.zeros((model.n_y, B.shape[1])))
    held = zero_order_hold(free, model.Ts)
    return series(held, append(*[delay_line(whole_delay(model), model.Ts)] * model.n_u))


def delay_line(samples: int, dt: float) -> StateSpace:
    """One signal, delayed by ``samples``."""
    return StateSpace(
        np.eye(samples, k=1),
        np.eye(samples)[:, -1:],
        np.eye(samples)[:1],
        np.full((1, 1), float(not samples)),
        dt,
    )


@dataclass(frozen=True)
class DesignProblem:
    """Problem of Fig. 1 of an identified vehicle: model, weights and generalised plants over speed.

    Attributes
    ----------
    stored : StoredIdentification
    settings : DesignSettings, structure, A_t, A_u and shapes, the project's or others

    References
    ----------
    Paper, Fig. 1 and section V.
    """

    stored: StoredIdentification
    settings: DesignSettings
    _split_by_lambda_s: dict[float, SplitWeights] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, stored: StoredIdentification) -> DesignProblem:
        """The problem that the project's [design] table states; InputError without one."""
        return cls(stored, design_settings(stored))

    def with_settings(self, settings: DesignSettings) -> DesignProblem:
        """The problem of the same vehicle with other settings."""
        return replace(self, settings=settings)

    @property
    def model(self) -> NominalModel:
        """The nominal model."""
        return self.stored.model

    def state_uncertainty(self) -> SplitWeights:
        """Class S2's weights at the identified gamma_w: W_delta_i dimensionless, W_delta_s in 1/s; searched
        once for each lambda_s. xi_s adds to the state's derivative. It is found by inverting dynamics, which
        windows only approximate: InputError where the frames cannot tell it."""
        stored, lambda_s = self.stored, self.settings.lambda_s
        error = stored.bounds["window_error_median"]
        worst = int(np.nanargmax(error))
        if error[worst] > LARGEST_WINDOW_ERROR:
            omega = stored.bounds["omega_rad_s"][worst]
            raise InputError(
                stored.folder,
                "design.structure",
                f"K_is: these frames find the state's uncertainty with a median "
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
        """Weights of Fig. 1: some from the settings, the others as identified. Raises InputError without
        drives of the noise split. It also raises InputError when identification and design differ in
        uncertainty. S1_diagonal goes with K_o, S1 with K_i and K_is, and K_inf with each."""
        stored, settings, fitted = self.stored, self.settings, self.stored.fitted
        outputwise = settings.structure == fig1.OUTPUTWISE
        if settings.structure != "K_inf" and outputwise != (len(fitted.W_delta) > 1):
            raise InputError(
                stored.folder,
                "bounds.structure",
                f"{stored.project.bounds.structure} with design.structure = {settings.structure}",
                "S1_diagonal with K_o, S1 with K_i or K_is: one uncertainty for bounds and design",
            )
        if not fitted.W_n or not fitted.W_C:
            raise InputError(
                stored.folder,
                "W_n, W_C",
                "missing: no drive of the noise split",
                "zero-input drives listed under data.noise_split",
            )
        W_w, W_delta_i, W_delta_s = (
            fitted.W_w_S0 if settings.structure == "K_inf" else fitted.W_w,
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
            W_u=fig1.zeros_poles(settings.A_u, settings.W_u_zeros, settings.W_u_poles),
            W_nr=weight_system(fitted.W_n[0], g),
            W_ndelta=weight_system(fitted.W_n[1], g),
            W_wr=weight_system(W_w[0], g),
            W_wdelta=weight_system(W_w[1], g),
            W_delta_i=weight_system(W_delta_i, g),
            W_delta_s=weight_system(W_delta_s, g),
            W_delta_r=weight_system(fitted.W_delta[0], g) if outputwise else None,
            W_delta_delta=weight_system(fitted.W_delta[1], g) if outputwise else None,
        )

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

    delayed: with one more sample of delay before the control input, for the controller's computation. probes:
    as in ``generalised_plant``.
    """
    A, B = (m[0] for m in model.matrices(np.array([v])))
    late = whole_delay(model)
    plant = fig1.generalised_plant(A, B, weights, structure, model.Ts, late, probes)
    if not delayed:
        return plant
    n_w, n_u, dt = plant.system.n_inputs - plant.n_control, plant.n_control, plant.system.dt
    computed = series(plant.system, append(gain(np.eye(n_w), dt), *[delay_line(1, dt)] * n_u))
    return replace(plant, system=replace(computed, inputs=plant.system.inputs))
