"""`lpvguard design`: weights -> controller scheduled over speed, certified frozen at every node and between nodes (step 8).

Everything is discrete from the start: the vehicle sampled exactly at Ts, the weights by Tustin's map, and one sample of
delay between the controller's output and the vehicle, so that the ECU may take a whole period to compute. The delay then
belongs to the controller, which makes it strictly proper.

One scaling D (started by D-K iteration at the design speed, then the best for the worst speed) and one level serve all
speeds, so that neighbouring controllers differ little (synthesis/scheduling.py). They are truncated by one projection, which
leaves them in common coordinates, and interpolated entry by entry. What is certified is the controller the core runs: float32 coefficients, interpolated, closed with the nominal model
and the weights at frozen speeds, at the nodes and midway between them. Frozen speeds: no claim is made about how fast the
speed may change.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy.linalg as sl

from . import artefacts
from .errors import InputError
from .identify import FittedWeight, Progress, StoredIdentification
from .nominal import NominalModel
from .project import DesignSettings
from .synthesis import interconnection as fig1
from .synthesis.dk import RobustPerformance, Scaling, certify, dk_synthesis
from .synthesis.norms import hinf_norm
from .synthesis.scheduling import closed_scaled, common_family, common_scaling
from .synthesis.statespace import StateSpace, append, gain, series

SMALLEST_ORDER = 4
"""Before the delay: fewer states than the vehicle and the reference model have between them cannot do the job."""
PATIENCE = 3
"""Orders tried beyond the best one so far."""
CERTIFICATE_RTOL = 1e-6
"""Largest relative difference between a stated level and the one proved anew."""
SCALING_SPEEDS = 4
"""Nodes, ends included, for which the common scaling is searched: the optimum moves slowly with speed."""


@dataclass(frozen=True)
class Scheduled:
    """Strictly proper discrete controllers at the node speeds, in common coordinates: x+ = A x + B m, u = C x.

    speeds (G,); A (G, n, n), B (G, n, 1 + n_y), C (G, n_u, n); m = [reference, outputs]. L (G, n, n_u): A - L C is stable;
    it feeds the applied input back while the actuator limits.
    """

    Ts: float
    speeds: np.ndarray
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    L: np.ndarray

    def at(self, v: float) -> StateSpace:
        """The controller the core runs at speed v: float32 coefficients with A - I formed in double, interpolated."""
        eye = np.eye(self.A.shape[1])
        return StateSpace(eye + self._between(self.A - eye, v), self._between(self.B, v), self._between(self.C, v),
                          np.zeros((self.C.shape[1], self.B.shape[2])), self.Ts)

    def injection_radius(self, v: float) -> float:
        """Spectral radius of A - L C at speed v, each interpolated as the core does."""
        A, L, C = (self._between(m, v) for m in (self.A, self.L, self.C))
        return float(np.abs(np.linalg.eigvals(A - L @ C)).max())

    def _between(self, values: np.ndarray, v: float) -> np.ndarray:
        position = np.clip((v - self.speeds[0]) / (self.speeds[-1] - self.speeds[0]), 0.0, 1.0) * (len(self.speeds) - 1)
        k = min(int(position), len(self.speeds) - 2)
        rounded = values[k:k + 2].astype(np.float32).astype(float)
        return (1 - (position - k)) * rounded[0] + (position - k) * rounded[1]


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
    late = series(plant.system, append(gain(np.eye(n_w), dt), shift))
    return replace(plant, system=replace(late, inputs=plant.system.inputs))


def _with_delay(K: StateSpace) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The controller that holds its own output back by one sample: states [x, u]; D is 0."""
    n, n_u = K.order, K.n_outputs
    A = np.block([[K.A, np.zeros((n, n_u))], [K.C, np.zeros((n_u, n_u))]])
    return A, np.vstack([K.B, K.D]), np.hstack([np.zeros((n_u, n)), np.eye(n_u)])


def _injection(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> np.ndarray:
    """L with A - L C stable: the stationary Kalman gain that trusts the applied input as much as the measurements."""
    Q = B @ B.T + 1e-9 * np.trace(B @ B.T) * np.eye(len(A))
    R = 1e-3 * np.trace(C @ Q @ C.T) * np.eye(len(C)) + 1e-12 * np.eye(len(C))
    P = sl.solve_discrete_are(A.T, C.T, Q, R)
    return A @ P @ C.T @ np.linalg.inv(C @ P @ C.T + R)


def _schedule(controllers: list[StateSpace], speeds: np.ndarray, Ts: float) -> Scheduled:
    realised = [_with_delay(K) for K in controllers]
    A, B, C = (np.stack([r[i] for r in realised]) for i in range(3))
    return Scheduled(Ts, speeds, A, B, C, np.stack([_injection(*r) for r in realised]))


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


def design(stored: StoredIdentification, progress: Progress = lambda _: None) -> Design:
    """Synthesise, truncate, schedule and certify. InputError when the project file has no [design] or no order certifies."""
    settings = stored.project.design
    if settings is None:
        raise InputError(f"vehicle {stored.project.name}", "design", "no [design] table", "objectives for step 8")
    return _designed(stored, settings, None, progress)


def _designed(stored: StoredIdentification, settings: DesignSettings, scaling: Scaling | None, progress: Progress) -> Design:
    """The design for ``settings``; ``scaling``: where the search for the common scaling starts."""
    model, weights = NominalModel(stored.project), _weights(stored, settings)
    speeds = np.linspace(*model.speed_range, settings.nodes)
    plants = [_plant(stored, model, weights, v, True) for v in speeds]
    if scaling is None:
        progress("D-K iteration at the design speed")
        start = int(np.argmin(np.abs(speeds - settings.design_speed_mps)))
        # K_inf has no blocks to scale.
        scaling = dk_synthesis(plants[start]).performance.scaling or Scaling(np.zeros((0, 1)))
    progress("one scaling for all speeds")
    some = np.unique(np.linspace(0, len(plants) - 1, SCALING_SPEEDS).round().astype(int))
    scaling, level = common_scaling([plants[k] for k in some], scaling)
    progress("controllers over speed")
    at_order, full_order = common_family(plants, scaling, level * (1 + settings.backoff))
    check = np.linspace(speeds[0], speeds[-1], 2 * len(speeds) - 1)
    loops = {float(v): _plant(stored, model, weights, v, False) for v in check}
    best, found = None, None
    for order in range(SMALLEST_ORDER, full_order + 1):
        progress(f"order {order}")
        try:
            schedule = _schedule(at_order(order), speeds, stored.project.Ts_s)
        except np.linalg.LinAlgError:
            continue  # no injection gain exists at this order
        if not all(schedule.injection_radius(v) < 1 for v in loops):
            continue
        worst = _worst_level(schedule, loops, scaling, np.inf if best is None else best)
        if worst < np.inf and (best is None or worst < best * (1 - settings.order_loss)):
            best, found = worst, schedule
        elif found is not None and schedule.A.shape[1] >= found.A.shape[1] + PATIENCE:
            break
    if found is None:
        raise InputError(stored.folder, "controller", "no truncation of the scheduled controller stabilises every speed",
                         "more nodes, or a lower A_t")
    progress("certificates")
    return Design(found, scaling, _certificates(found, loops, scaling), full_order)


def _worst_level(schedule: Scheduled, loops: dict[float, fig1.GeneralisedPlant], scaling: Scaling, limit: float) -> float:
    """Largest norm of the scaled closed loops; inf when one is unstable, or as soon as one lies above ``limit``."""
    worst = 0.0
    for v, plant in loops.items():
        worst = max(worst, hinf_norm(closed_scaled(plant, schedule.at(v), scaling), rtol=1e-3).upper)
        if worst > limit:
            return np.inf
    return worst


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
    schedule = Scheduled(document["Ts_s"], *(np.array(document[key], float) for key in ("speeds", "A", "B", "C", "L")))
    model, weights = NominalModel(stored.project), _weights(stored, settings)
    loops = {row["v_mps"]: _plant(stored, model, weights, row["v_mps"], False) for row in stated["speeds"]}
    scaling = Scaling(np.array(stated["scaling_log_parameters"], float).reshape(-1, stated["scaling_columns"]))
    for row, (v, proved) in zip(stated["speeds"], _certificates(schedule, loops, scaling)):
        if not abs(proved.upper - row["mu_upper"]) <= CERTIFICATE_RTOL * row["mu_upper"]:
            raise InputError(path, f"certificate at {v:g} m/s", f"mu is at most {proved.upper:.7g}, not {row['mu_upper']:.7g}",
                             "the coefficients and weights that were certified")


def save(result: Design, stored: StoredIdentification, target: Path, more: dict[str, str] | None = None) -> None:
    """Write controller.json, its manifest and ``more`` files (name: text), whole or not at all."""
    settings, schedule = stored.project.design, result.schedule
    controller = {
        "kind": "controller", "schema": 1, "Ts_s": schedule.Ts, "speeds": schedule.speeds, "A": schedule.A, "B": schedule.B, "C": schedule.C, "L": schedule.L,
        "u_max": settings.input_max, "rate_max": settings.input_rate_max_per_s,
        "certificates": {
            "claim": "frozen speeds, float32 coefficients, interpolated, closed with the nominal model and the weights: "
                     "mu <= mu_upper < 1 means robust performance for every LTI Delta within W_delta",
            "test": "bracket of the scaled closed loop's H-infinity norm by level-set tests of its Hamiltonian",
            "structure": settings.structure, "A_t": settings.A_t, "A_u": settings.A_u,
            "order": schedule.A.shape[1], "full_order": result.full_order,
            "scaling_log_parameters": result.scaling.log_parameters,
            "scaling_columns": result.scaling.log_parameters.shape[1],
            "speeds": [{"v_mps": v, "mu_upper": p.upper, "mu_lower": p.lower, "peak_rad_s": p.bracket.peak_frequency}
                       for v, p in result.certificates]}}
    with artefacts.new_folder(target) as folder:
        artefacts.write_files(folder, {
            **(more or {}), "controller.json": artefacts.to_json(controller),
            artefacts.MANIFEST: artefacts.manifest("design", vehicle=stored.project.name, identification=stored.manifest)})
