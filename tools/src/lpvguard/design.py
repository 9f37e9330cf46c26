"""`lpvguard design`: weights -> controller scheduled over speed, certified frozen at every node and between nodes (step 8).

Everything is discrete from the start: the vehicle sampled exactly at Ts, the weights by Tustin's map, and one sample of
delay between the controller's output and the vehicle, so that the ECU may take a whole period to compute. The delay then
belongs to the controller, which makes it strictly proper.

One scaling D (found by D-K iteration at the design speed) serves all speeds, so that neighbouring controllers differ
little. They are brought to as few common poles as will do, with numerators interpolated over speed (schedule.py). What is
certified is the controller the core runs: float32 coefficients, interpolated, closed with the nominal model and the weights
at frozen speeds, at the nodes and midway between them. Frozen speeds: no claim is made about how fast the speed may change.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import artefacts
from .errors import InputError
from .identify import FittedWeight, Progress, StoredIdentification
from .nominal import NominalModel
from .project import DesignSettings
from .schedule import FrozenLoop, Scheduled, fit
from .synthesis import interconnection as fig1
from .synthesis.dk import RobustPerformance, Scaling, certify, dk_synthesis, frozen_controllers
from .synthesis.statespace import StateSpace, append, gain, lft, series, zero_order_hold

FEWEST_PAIRS, MOST_PAIRS = 2, 19
"""Of poles, for each demand: fewer than the vehicle and the reference model have between them cannot do the job."""
PATIENCE = 2
"""Pairs tried beyond the best number so far."""
CERTIFICATE_RTOL = 1e-6
"""Largest relative difference between a stated level and the one proved anew."""


def _system(weight: FittedWeight, inflation: float) -> StateSpace:
    return fig1.rational(inflation * weight.fit.weight.num, weight.fit.weight.den)


def _weights(stored: StoredIdentification, settings: DesignSettings) -> fig1.Weights:
    fitted = stored.fitted
    if not fitted.W_n or not fitted.W_C:
        raise InputError(stored.folder, "W_n, W_C", "missing: no drive of the noise split",
                         "zero-input drives listed under data.noise_split")
    W_w = fitted.W_w_S0 if settings.structure == "K_inf" else fitted.W_w
    g = fitted.inflation
    return fig1.Weights(
        W_R=fig1.rational(settings.W_R_num, settings.W_R_den), W_C=_system(fitted.W_C[0], 1.0),
        W_t=fig1.zeros_poles(settings.A_t, settings.W_t_zeros, settings.W_t_poles),
        W_u=fig1.zeros_poles(settings.A_u, settings.W_u_zeros, settings.W_u_poles),
        W_nr=_system(fitted.W_n[0], g), W_ndelta=_system(fitted.W_n[1], g), W_wr=_system(W_w[0], g),
        W_wdelta=_system(W_w[1], g), W_delta_i=_system(fitted.W_delta, g), W_delta_s=_system(fitted.W_delta, g))


def _delayed(plant: fig1.GeneralisedPlant) -> fig1.GeneralisedPlant:
    """The plant with one sample of delay in front of its control input."""
    n_w, n_u, dt = plant.system.n_inputs - plant.n_control, plant.n_control, plant.system.dt
    shift = StateSpace(np.zeros((n_u, n_u)), np.eye(n_u), np.eye(n_u), np.zeros((n_u, n_u)), dt)
    return fig1.GeneralisedPlant(series(plant.system, append(gain(np.eye(n_w), dt), shift)), plant.blocks, plant.n_delta_out,
                                 plant.n_delta_in, plant.n_control, plant.n_measurement)


def _with_delay(K: StateSpace) -> StateSpace:
    """The controller that holds its own output back by one sample."""
    n_u = K.n_outputs
    return series(StateSpace(np.zeros((n_u, n_u)), np.eye(n_u), np.eye(n_u), np.zeros((n_u, n_u)), K.dt), K)


@dataclass(frozen=True)
class Design:
    """A scheduled controller and its certificates: ``certificates`` per speed, nodes and midpoints in order."""

    schedule: Scheduled
    scaling: Scaling
    certificates: list[tuple[float, RobustPerformance]]
    full_order: int


def _plant(stored: StoredIdentification, model: NominalModel, weights: fig1.Weights, v: float,
           delayed: bool) -> fig1.GeneralisedPlant:
    A, B = (m[0] for m in model.matrices(np.array([v])))
    plant = fig1.generalised_plant(A, B, weights, stored.project.design.structure, stored.project.Ts_s)
    return _delayed(plant) if delayed else plant


def _vehicle(model: NominalModel, v: float, Ts: float) -> StateSpace:
    """The nominal vehicle at speed v, sampled."""
    A, B = (m[0] for m in model.matrices(np.array([v])))
    return zero_order_hold(StateSpace(A, B, model.C, np.zeros((model.n_y, B.shape[1]))), Ts)


def design(stored: StoredIdentification, progress: Progress = lambda _: None) -> Design:
    """Synthesise, schedule over common poles and certify. InputError when the project file has no [design] or no order certifies."""
    settings = stored.project.design
    if settings is None:
        raise InputError(f"vehicle {stored.project.name}", "design", "no [design] table", "objectives for step 8")
    model = NominalModel(stored.project)
    weights = _weights(stored, settings)
    speeds = np.linspace(*model.speed_range, settings.nodes)
    start = int(np.argmin(np.abs(speeds - settings.design_speed_mps)))
    progress("D-K iteration at the design speed")
    scaling = dk_synthesis(_plant(stored, model, weights, speeds[start], True)).performance.scaling
    scaling = scaling or Scaling(np.zeros((0, 1)))  # K_inf has no blocks to scale
    progress("controllers over speed")
    at_order, full_order = frozen_controllers([_plant(stored, model, weights, v, True) for v in speeds], scaling, settings.backoff)
    check = np.linspace(speeds[0], speeds[-1], 2 * len(speeds) - 1)
    loops = {float(v): _plant(stored, model, weights, v, False) for v in check}
    input_max = np.array(settings.input_max)
    frozen = [FrozenLoop(_with_delay(K), loops[float(v)], _vehicle(model, v, stored.project.Ts_s))
              for v, K in zip(speeds, at_order(full_order))]
    best, found, found_pairs = None, None, 0
    for pairs in range(FEWEST_PAIRS, MOST_PAIRS // len(input_max) + 1):
        progress(f"{pairs} pairs of poles")
        schedule = fit(frozen, speeds, scaling, pairs, input_max)
        if not all(schedule.injection_radius(v) < 1 and lft(plant.system, schedule.at(v)).stability_margin() > 0
                   for v, plant in loops.items()):
            continue
        proved = _certificates(schedule, loops, scaling)
        worst = max(p.upper for _, p in proved)
        if best is None or worst < best * (1 - settings.order_loss):
            best, found, found_pairs = worst, (schedule, proved), pairs
        elif pairs >= found_pairs + PATIENCE:
            break
    if found is None:
        raise InputError(stored.folder, "controller", "no set of common poles stabilises every speed",
                         "more nodes, or a lower A_t")
    return Design(found[0], scaling, found[1], full_order)


def _certificates(schedule: Scheduled, loops: dict[float, fig1.GeneralisedPlant],
                  scaling: Scaling | None) -> list[tuple[float, RobustPerformance]]:
    return [(v, certify(plant, schedule.at(v), scaling if plant.blocks else None)) for v, plant in loops.items()]


def verify(path: Path, stored: StoredIdentification) -> None:
    """Prove the certificates of a controller.json anew, for its coefficients as they stand and these weights.

    InputError names the speed at which the loop is unstable or its level is not the one stated.
    """
    settings = stored.project.design
    document = artefacts.read_json(path)
    if settings is None or "certificates" not in document:
        raise InputError(path, "certificates", "missing", "a file that `lpvguard design` wrote for this vehicle")
    stated = document["certificates"]
    schedule = Scheduled(document["Ts_s"], *(np.array(document[key], float) for key in ("speeds", "a", "B", "L")))
    model, weights = NominalModel(stored.project), _weights(stored, settings)
    loops = {row["v_mps"]: _plant(stored, model, weights, row["v_mps"], False) for row in stated["speeds"]}
    scaling = Scaling(np.array(stated["scaling_log_parameters"], float).reshape(-1, stated["scaling_columns"]))
    for row, (v, proved) in zip(stated["speeds"], _certificates(schedule, loops, scaling)):
        if not abs(proved.upper - row["mu_upper"]) <= CERTIFICATE_RTOL * row["mu_upper"]:
            raise InputError(path, f"certificate at {v:g} m/s", f"mu is at most {proved.upper:.7g}, not {row['mu_upper']:.7g}",
                             "the coefficients and weights that were certified")


def save(result: Design, stored: StoredIdentification, target: Path) -> None:
    """Write controller.json and its manifest, whole or not at all."""
    settings, schedule = stored.project.design, result.schedule
    controller = {
        "kind": "controller", "schema": 2, "Ts_s": schedule.Ts, "speeds": schedule.speeds, "a": schedule.a, "B": schedule.B,
        "L": schedule.L,
        "u_max": settings.input_max, "rate_max": settings.input_rate_max_per_s,
        "certificates": {
            "claim": "frozen speeds, float32 coefficients, interpolated, closed with the nominal model and the weights: "
                     "mu <= mu_upper < 1 means robust performance for every LTI Delta within W_delta",
            "test": "bracket of the scaled closed loop's H-infinity norm by level-set tests of its Hamiltonian",
            "structure": settings.structure, "A_t": settings.A_t, "A_u": settings.A_u,
            "order": schedule.order, "full_order": result.full_order,
            "scaling_log_parameters": result.scaling.log_parameters,
            "scaling_columns": result.scaling.log_parameters.shape[1],
            "speeds": [{"v_mps": v, "mu_upper": p.upper, "mu_lower": p.lower, "peak_rad_s": p.bracket.peak_frequency}
                       for v, p in result.certificates]}}
    with artefacts.new_folder(target) as folder:
        artefacts.write_files(folder, {
            "controller.json": artefacts.to_json(controller),
            artefacts.MANIFEST: artefacts.manifest("design", vehicle=stored.project.name, identification=stored.manifest)})
