"""`lpvguard design`: a controller scheduled over speed, certified at every node and between nodes (step 8).

Everything is discrete from the start: the vehicle is sampled exactly at Ts, the weights by Tustin's map
(plants.py). One sample of delay follows the controller's output, so that the ECU may compute for a whole
period. The delay is part of the controller, which is therefore strictly proper.

One scaling D and one level serve all speeds, so that neighbouring controllers differ little
(engine/synthesis/scheduling.py). D-K iteration at the design speed gives the first D. A search then minimises
the level of the worst speed. The controllers are reduced to as few common poles as possible, with numerators
interpolated over speed (schedule.py). The certificates are about the controller of the core, with
interpolated float32 coefficients, in a loop with the nominal model and the weights. Mu certifies frozen
speeds: the nodes and the midpoints between them. Storage functions certify robust stability and robust
performance, each for every speed history up to a stated rate of change (engine/synthesis/lpv_certificate.py).
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar

from ..base import artefacts
from ..base.errors import InputError
from ..base.parallel import Map
from ..base.progress import Counted, Progress, counted, parts
from ..base.sampling import evenly
from ..core.scheduled import Scheduled
from ..engine.synthesis import interconnection as fig1
from ..engine.synthesis.dk import RobustPerformance, Scaling, dk_synthesis
from ..engine.synthesis.errors import SynthesisError
from ..engine.synthesis.limits import mu_floor
from ..engine.synthesis.norms import hinf_norm
from ..engine.synthesis.scheduling import closed_scaled, common_family, common_scaling
from ..engine.synthesis.statespace import StateSpace, series
from ..identify.identification import StoredIdentification
from ..identify.premise import premise, require_premise
from ..vehicle.design_settings import DesignSettings
from ..vehicle.nominal import NominalModel
from .controller_file import PresentController
from .further_certificates import (
    NOTHING,
    FurtherCertificates,
    further_certificates,
    require_further_certificates,
)
from .input_limit import input_limit
from .limiting import Limiting
from .moving_speed import Moving, certified, moving_certificates, moving_to_dict, require_moving, tuning
from .plants import DesignProblem, design_settings, vehicle_at
from .schedule import FrozenLoop, fit_by_pairs

FEWEST_PAIRS, MOST_PAIRS = 2, 19
"""Least and largest number of pole pairs that are tried for each demand. Fewer pairs than those of the
vehicle and the reference model together are not enough."""
PATIENCE = 2
"""Number of further pairs that are tried after the best number so far."""
CERTIFICATE_RTOL = 1e-6
"""Largest relative difference between a stated level and the one proved again."""
LOWER_RTOL, PEAK_RTOL = 1e-4, 1e-3
"""The same for the lower bound and for the gain at the stated peak. A search finds both, so they vary
more."""
FLOOR_RTOL = 1e-9
"""Rounding of the DC floor."""
OFF_GRID = 24
"""Number of random speeds between the nodes at which the design is also checked."""
DESIGN_SHARES, FROZEN_SHARES, VERIFY_SHARES = (9, 1, 1), (1, 15, 1), (4, 1, 4)
"""Approximate shares of the work in three progress bars."""
A_T_RTOL, STEPS = 0.01, 8
LARGER_STEP = 0.8
"""Step towards the limit of A_t while no A_t has failed, because the largest A_t lies near the limit."""
FAMILY_RTOL = 0.01
"""Largest relative excess of a truncated controller's level over the family's level."""
REACH = 3
"""The model error model must reach this multiple of the crossover frequency."""
CROSSOVER_FROM, CROSSOVER_POINTS = 1e-3, 2000
SCALING_SPEEDS = 4
"""Number of nodes, ends included, for which the common scaling is searched. The optimum moves slowly with
speed."""


def _with_delay(K: StateSpace) -> StateSpace:
    """The controller with its output delayed by one sample."""
    n_u = K.n_outputs
    return series(StateSpace(np.zeros((n_u, n_u)), np.eye(n_u), np.eye(n_u), np.zeros((n_u, n_u)), K.dt), K)


@dataclass(frozen=True)
class Design:
    """A scheduled controller and its certificates.

    Attributes
    ----------
    schedule : Scheduled
    scaling : Scaling
    certificates : list of (speed [m/s], RobustPerformance), nodes and midpoints in order
    full_order : int, order before the reduction
    off_grid : (speed [m/s], RobustPerformance), the worst certificate between these speeds
    moving : dict, certificate by claim about a moving speed (None without a proof), empty if not requested
    further : FurtherCertificates or None, about margins, a varying Delta and limits; None: not requested
    """

    schedule: Scheduled
    scaling: Scaling
    certificates: list[tuple[float, RobustPerformance]]
    full_order: int
    off_grid: tuple[float, RobustPerformance]
    moving: dict[str, Moving | None] = field(default_factory=dict)
    further: FurtherCertificates | None = None

    @property
    def worst(self) -> float:
        """Largest proved mu over all checked frozen speeds."""
        return max(p.upper for _, p in [*self.certificates, self.off_grid])


def design(
    stored: StoredIdentification,
    progress: Progress = lambda _: None,
    moving_speed: bool = True,
    workers: Map = map,
    present: PresentController | None = None,
) -> Design:
    """Synthesise a controller, schedule it over common poles and certify it.

    The present controller is kept if this identification certifies it, or if no better controller is found.
    Its scaling starts the search for a better one.

    Parameters
    ----------
    stored : StoredIdentification
    progress : Callable, reports progress
    moving_speed : bool, certify a moving speed too, default True
    workers : Map, shares the speeds
    present : PresentController, optional

    Returns
    -------
    Design

    Raises
    ------
    InputError
        If the project file has no [design], or no order certifies.

    References
    ----------
    Paper, step 8; THEORY 7.10 to 7.12.
    """
    problem = DesignProblem.from_identification(stored)
    require_premise(stored)
    frozen, moving, margins = parts(progress, *DESIGN_SHARES)
    result = None if present is None else _kept(problem, present, frozen, workers)
    if result is None or not result.worst < 1:
        other = _designed(problem, None if present is None else present.scaling, frozen, workers)
        result = other if result is None else min(result, other, key=lambda one: one.worst)
    if result.worst < 1:
        _require_reach(stored, result.schedule)
    return replace(
        result,
        moving=moving_certificates(problem, result.schedule, result.scaling, moving, workers)
        if moving_speed
        else {},
        further=further_certificates(problem, result.schedule, result.scaling, margins, workers),
    )


def frozen_optimum(stored: StoredIdentification) -> tuple[float, float]:
    """Compute the largest optimum over single frozen speeds.

    An optimum is the least bound of mu that D-K iteration finds for one speed, with the certified A_t and
    A_u. Only some of the nodes are searched.

    Parameters
    ----------
    stored : StoredIdentification

    Returns
    -------
    tuple of float, mu and its speed [m/s]
    """
    problem = DesignProblem.from_identification(stored)
    speeds = np.linspace(*problem.model.speed_range, problem.settings.nodes)

    def optimum(v: float) -> float:
        plant = problem.plant(v, delayed=True)
        return common_scaling([plant], dk_synthesis(plant).performance.scaling)[1]

    return max((optimum(float(v)), float(v)) for v in speeds[evenly(len(speeds), SCALING_SPEEDS)])


def limit_sentence(stored: StoredIdentification, result: Design) -> str:
    """Say in one sentence why a design is not certified: its largest mu, and the weights that limit mu.

    Parameters
    ----------
    stored : StoredIdentification
    result : Design

    Returns
    -------
    str
    """
    problem = DesignProblem.from_identification(stored)
    v, worst = max([*result.certificates, result.off_grid], key=lambda one: one[1].upper)
    limiting = Limiting.at_peak(problem.plant(v), result.schedule.at(v), worst)
    floor = max(
        mu_floor(problem.plant(u, delayed=True), rtol=1e-3).value for u in (*problem.model.speed_range, v)
    )
    most = f"no controller goes below {floor:.3f} with these weights"
    return (
        f"the least worst mu found is {worst.upper:.3f}, at {v:.4g} m/s and {limiting.frequency:.3g} rad/s; "
        f"{limiting.sentence()}; {most}"
    )


def crossover(schedule: Scheduled, model: NominalModel) -> float:
    """Highest frequency [rad/s] at which the loop gain is 1, over the nodes; 0 without any.

    The loop gain is |sum_j K_j P_j|. With several inputs it is the spectral radius of K P.
    """
    omega = np.geomspace(CROSSOVER_FROM, np.pi / schedule.Ts * (1 - 1e-9), CROSSOVER_POINTS)
    highest = 0.0
    for v in map(float, schedule.speeds):
        K = schedule.at(v).response(omega)[:, :, 1:]
        P = model.frequency_response(omega, v)
        above = np.flatnonzero(np.abs(np.linalg.eigvals(K @ P)).max(axis=1) >= 1)
        highest = max(highest, float(omega[above[-1]]) if len(above) else 0.0)
    return highest


def _require_reach(stored: StoredIdentification, schedule: Scheduled) -> None:
    """Raise InputError unless the model error model reaches REACH crossovers."""
    omega = stored.model_error.grid.omega
    needed = REACH * crossover(schedule, stored.model)
    if omega[-1] < needed:
        raise InputError(
            stored.folder,
            "model_error",
            f"reaches {omega[-1]:.3g} rad/s",
            f"at least {needed:.3g} rad/s, {REACH} times the crossover",
        )


def _kept(
    problem: DesignProblem, present: PresentController, progress: Progress, workers: Map
) -> Design | None:
    """Certify the present controller for this problem; None if its input limits differ from the problem's."""
    schedule, order = present.schedule, present.document["certificates"]["full_order"]
    if not _limited_by(schedule, _input_limits(problem, schedule)):
        return None
    loops = _checked_plants(problem, schedule.speeds)
    result = _certified(problem, schedule, present.scaling, order, loops, progress, workers)
    if not result.worst < 1:
        scaling = tuning(schedule, problem.plant, present.scaling, workers)(1.0)
        result = _certified(problem, schedule, scaling, order, loops, progress, workers)
    return result


def _checked_plants(problem: DesignProblem, speeds: np.ndarray) -> dict[float, fig1.GeneralisedPlant]:
    """Plants by speed, at the given speeds and at the midpoints between them."""
    check = np.linspace(speeds[0], speeds[-1], 2 * len(speeds) - 1)
    return {float(v): problem.plant(v) for v in check}


def _input_limits(problem: DesignProblem, schedule: Scheduled) -> np.ndarray:
    """Input limits (G, n_u) of the problem at the G speeds of a schedule."""
    return input_limit(problem.model, problem.settings, schedule.speeds, problem.weights.controlled)


def _limited_by(schedule: Scheduled, limits: np.ndarray) -> bool:
    """Tell if a schedule's input limits equal ``limits`` up to rounding."""
    return schedule.u_max.shape == limits.shape and np.allclose(schedule.u_max, limits, rtol=1e-9, atol=0)


def _certified(
    problem: DesignProblem,
    schedule: Scheduled,
    scaling: Scaling,
    full_order: int,
    loops: dict[float, fig1.GeneralisedPlant],
    progress: Progress,
    workers: Map,
) -> Design:
    """Design with its certificates at the frozen speeds of ``loops`` and at the worst speed between them."""
    return Design(
        schedule,
        scaling,
        _certificates(schedule, loops, scaling, progress, workers),
        full_order,
        worst_off_grid(schedule, scaling, problem.plant, problem.stored.project.seed, workers),
    )


def _designed(
    problem: DesignProblem, scaling: Scaling | None, progress: Progress, workers: Map = map
) -> Design:
    """Design for ``settings``; ``scaling`` starts the search for the common scaling."""
    model, settings, controlled = problem.model, problem.settings, problem.stored.project.controlled
    synthesised = problem.with_settings(settings.for_synthesis)
    speeds = np.linspace(*model.speed_range, settings.nodes)
    plants = [synthesised.plant(v, delayed=True) for v in speeds]
    before, fitting, proving = parts(progress, *FROZEN_SHARES)
    if scaling is None:
        before(Counted("D-K iteration at the design speed", 0, 4))
        start = int(np.argmin(np.abs(speeds - settings.design_speed_mps)))
        scaling = dk_synthesis(plants[start], workers=workers).performance.scaling
    scaling, controllers = _family(plants, scaling, settings.backoff, before, workers)
    loops = _checked_plants(synthesised, speeds)
    u_max = input_limit(model, settings, speeds, controlled)
    frozen = [
        FrozenLoop(_with_delay(K), loops[float(v)], vehicle_at(model, v), controlled)
        for v, K in zip(speeds, controllers, strict=True)
    ]
    schedule = _with_fewest_poles(
        fit_by_pairs(frozen, speeds, scaling, u_max),
        MOST_PAIRS // model.n_u,
        partial(_worst_level, loops=loops, scaling=scaling, workers=workers),
        settings.order_loss,
        fitting,
    )
    if schedule is None:
        raise InputError(
            problem.stored.folder,
            "controller",
            "no set of common poles stabilises every speed",
            "more nodes, or a lower A_t",
        )
    if synthesised.settings != settings:
        scaling = tuning(schedule, problem.plant, scaling, workers)(1.0)
        loops = _checked_plants(problem, speeds)
    return _certified(problem, schedule, scaling, controllers[0].order, loops, proving, workers)


def _family(
    plants: list[fig1.GeneralisedPlant], start: Scaling, backoff: float, progress: Progress, workers: Map
) -> tuple[Scaling, list[StateSpace]]:
    """Search the common scaling from ``start``; make one controller for each plant, in common states."""
    progress(Counted("one scaling for all speeds", 1, 4))
    some = evenly(len(plants), SCALING_SPEEDS)
    scaling, level = common_scaling([plants[k] for k in some], start, workers)
    progress(Counted("controllers over speed", 2, 4))
    # The backoff may use at most half of the distance from the level to 1.
    backed_off = level * (1 + backoff)
    level = min(backed_off, 0.5 * (1 + level)) if level < 1 else backed_off
    at_order, rank = common_family(plants, scaling, level, workers)
    return scaling, at_order(_sound_order(at_order, rank, plants, scaling, level, workers))


def _with_fewest_poles(
    schedule_with: Callable[[int], Scheduled],
    most: int,
    worst_level: Callable[[Scheduled, float], float],
    order_loss: float,
    progress: Progress,
) -> Scheduled | None:
    """Schedule with the fewest pairs of common poles, at most ``most``, or None.

    More pairs would lower the worst level by a share of less than ``order_loss``. The result is None if no
    number of pairs stabilises every speed. ``worst_level(schedule, limit)`` returns inf for a level above the
    limit.
    """
    best, fewest, found_pairs = np.inf, None, 0
    for pairs in range(FEWEST_PAIRS, most + 1):
        progress(Counted(f"{pairs} pairs of poles", pairs**3, (most + 1) ** 3))
        schedule = schedule_with(pairs)
        worst = worst_level(schedule, best)
        if worst < np.inf and (fewest is None or worst < best * (1 - order_loss)):
            best, fewest, found_pairs = worst, schedule, pairs
        elif fewest is not None and pairs >= found_pairs + PATIENCE:
            break
    return fewest


def _sound_order(
    at_order: Callable[[int], list[StateSpace]],
    rank: int,
    plants: list[fig1.GeneralisedPlant],
    scaling: Scaling,
    level: float,
    workers: Map,
) -> int:
    """Largest order at which every controller of the family keeps ``level``.

    The last of the ``rank`` states can be rounding errors that make the loop unstable. Raises InputError if
    no order keeps the level.
    """
    for order in range(rank, 0, -1):
        loops = zip(plants, at_order(order), strict=True)
        norms = workers(partial(_scaled_norm, scaling, 1e-3), loops)
        if all(norm <= level * (1 + FAMILY_RTOL) for norm in norms):
            return order
    raise InputError(
        "design", "controllers", f"none of up to {rank} states keeps the level {level:.4g}", "a lower A_t"
    )


def _worst_level(
    schedule: Scheduled,
    limit: float,
    loops: dict[float, fig1.GeneralisedPlant],
    scaling: Scaling,
    workers: Map,
) -> float:
    """Largest norm of the scaled closed loops.

    The result is inf if a loop is unstable or exceeds ``limit``, or if the anti-windup is unstable.
    """
    if not all(schedule.injection_radius(v) < 1 for v in loops):
        return np.inf
    worst = 0.0
    closed = ((plant, schedule.at(v)) for v, plant in loops.items())
    for one in workers(partial(_scaled_norm, scaling, 1e-3), closed):
        worst = max(worst, one)
        if worst > limit:
            return np.inf
    return worst


def _scaled_norm(scaling: Scaling, rtol: float, loop: tuple[fig1.GeneralisedPlant, StateSpace]) -> float:
    """Upper bound of the norm of a plant's scaled closed loop with a controller; inf for an unstable loop."""
    return hinf_norm(closed_scaled(*loop, scaling), rtol).upper


def worst_off_grid(
    schedule: Scheduled,
    scaling: Scaling,
    plant: Callable[[float], fig1.GeneralisedPlant],
    seed: int,
    workers: Map,
) -> tuple[float, RobustPerformance]:
    """Search the worst speed between the nodes; return the speed and its certificate.

    The search takes the worst of random speeds and moves it to the peak between its neighbours.
    """
    low, high = schedule.speeds[[0, -1]].tolist()
    speeds = np.sort(np.concatenate([[low, high], np.random.default_rng(seed).uniform(low, high, OFF_GRID)]))
    norm = partial(_scaled_norm, scaling, 1e-4)
    values = list(workers(norm, ((plant(v), schedule.at(v)) for v in speeds)))
    k = int(np.argmax(values))
    around = speeds[max(k - 1, 0)], speeds[min(k + 1, len(speeds) - 1)]
    refined = minimize_scalar(
        lambda v: -norm((plant(v), schedule.at(v))), bounds=around, method="bounded", options={"maxiter": 12}
    )
    v = float(refined.x) if -refined.fun > values[k] else float(speeds[k])
    return v, _certificates(schedule, {v: plant(v)}, scaling)[0][1]


def dc_floor(weights: fig1.PlantWeights) -> float:
    """Lower bound of every controller's mu per unit of A_t: 1 / sqrt(1/|W_nr(0)|^2 + 1/|W_wr(0)|^2).

    The bound balances noise against disturbance at the controlled output r.
    """
    n, w = (abs(W[weights.controlled].response([0.0])[0, 0, 0]) for W in (weights.W_n, weights.W_w))
    return float(n * w / np.hypot(n, w))


@dataclass(frozen=True)
class LargestA_t:
    """Largest A_t with mu < 1 at every checked speed.

    Attributes
    ----------
    A_t : float, per rad/s
    product : float, A_t times the DC floor; no controller exceeds 1
    worst : float, largest mu with this A_t
    failed : float, least A_t that the design, or any controller, did not reach [per rad/s]
    """

    A_t: float
    product: float
    worst: float
    failed: float


def largest_A_t(stored: StoredIdentification, progress: Progress = lambda _: None) -> LargestA_t | None:
    """Search the largest A_t by bisection; each step makes and certifies a whole design.

    Parameters
    ----------
    stored : StoredIdentification
    progress : Callable, reports progress

    Returns
    -------
    LargestA_t, or None if the design does not reach half of the DC floor's limit
    """
    problem = DesignProblem.from_identification(stored)
    floor = dc_floor(problem.weights)
    low, high = 0.5 / floor, 1 / floor
    reached: float | None = None
    scaling, trial = None, low
    steps = 0
    while high > low * (1 + A_T_RTOL):

        def tell(text: str, trial: float = trial, step: int = steps) -> None:
            progress(Counted(f"A_t {trial:.4g}: {text}", step, max(STEPS, step + 1)))

        steps += 1

        try:
            settings = problem.settings.model_copy(update={"A_t": trial, "synthesised_for": None})
            one = _designed(problem.with_settings(settings), scaling, tell)
            worst, scaling = one.worst, one.scaling
        except (InputError, SynthesisError):
            worst = np.inf
        if worst < 1:
            low, reached = trial, worst
        else:
            high = trial
            if reached is None:
                return None
        trial = low + LARGER_STEP * (high - low) if high == 1 / floor else float(np.sqrt(low * high))
    return None if reached is None else LargestA_t(low, low * floor, reached, high)


def _certificates(
    schedule: Scheduled,
    loops: dict[float, fig1.GeneralisedPlant],
    scaling: Scaling | None,
    progress: Progress = lambda _: None,
    workers: Map = map,
) -> list[tuple[float, RobustPerformance]]:
    loops_to_certify = [
        (plant, schedule.at(v), scaling if plant.blocks else None) for v, plant in loops.items()
    ]
    texts = [f"certificate at {v:.3g} m/s" for v in loops]
    return list(zip(loops, counted(progress, texts, workers(certified, loops_to_certify)), strict=True))


def verify(
    path: Path, stored: StoredIdentification, progress: Progress = lambda _: None, workers: Map = map
) -> None:
    """Prove the certificates of a controller.json again, with the weights of this identification.

    ``workers`` share the speeds. Raises InputError for an unstable loop, for a wrong number, or for an
    objective or input limit that differs from the project's. The error names the speed.
    """
    present, settings = PresentController.from_path(path, stored), design_settings(stored)
    stated, schedule, scaling = present.document["certificates"], present.schedule, present.scaling
    if (path.parent / artefacts.MANIFEST).is_file():
        artefacts.read_manifest(path.parent, "design")
    if stated.get("coefficients_sha256") != schedule.digest():
        raise InputError(
            path,
            "certificates.coefficients_sha256",
            "differs from the hash of speeds, a, B, L and u_max",
            "the coefficients that were certified",
        )
    require_premise(stored)
    problem = DesignProblem(stored, settings)
    _require_settings(path, stated, schedule, settings, problem)
    _require_floor(path, stated, dc_floor(problem.weights))
    rows = [*stated["speeds"], stated["off_grid"]]
    loops = {row["v_mps"]: problem.plant(row["v_mps"]) for row in rows}
    frozen, moving, margins = parts(progress, *VERIFY_SHARES)
    proved_rows = dict(_certificates(schedule, loops, scaling, frozen, workers))
    for row in rows:
        _compare(path, row, proved_rows[row["v_mps"]], loops[row["v_mps"]], schedule)
    require_moving(path, stated, problem, schedule, moving, workers)
    require_further_certificates(path, stated, problem, schedule, scaling, margins, workers)


def _require_settings(
    path: Path, stated: dict, schedule: Scheduled, settings: DesignSettings, problem: DesignProblem
) -> None:
    """Raise InputError unless objectives and input limits are those of the project."""
    for key in ("A_t", "A_u"):
        if stated[key] != getattr(settings, key):
            raise InputError(
                path, f"certificates.{key}", repr(stated[key]), f"{getattr(settings, key)!r} of the project"
            )
    limits = _input_limits(problem, schedule)
    if not _limited_by(schedule, limits):
        raise InputError(
            path, "u_max", f"{schedule.u_max.tolist()}", f"{limits.tolist()} from the project's limits"
        )


def _require_floor(path: Path, stated: dict, floor: float) -> None:
    """Raise InputError unless the stated DC floor is ``floor`` and allows the stated largest A_t."""
    largest = stated["largest_A_t"]
    recomputed = {"dc_floor": (stated["dc_floor"], floor)}
    if largest is not None:
        recomputed["largest_A_t.product"] = largest["product"], largest["A_t"] * floor
        if not (largest["worst"] < 1 and 0 < largest["A_t"] < largest["failed"] <= (1 + FLOOR_RTOL) / floor):
            raise InputError(
                path,
                "certificates.largest_A_t",
                f"A_t {largest['A_t']:.6g} with mu {largest['worst']:.6g}, failed {largest['failed']:.6g}",
                f"mu below 1, and A_t below the failed A_t and at most {1 / floor:.6g}",
            )
    for name, (value, want) in recomputed.items():
        same = (
            value is None if np.isnan(want) else value is not None and abs(value - want) <= FLOOR_RTOL * want
        )
        if not same:
            raise InputError(path, f"certificates.{name}", f"{value}", f"{want:.9g} for these weights")


def _compare(
    path: Path, row: dict, proved: RobustPerformance, plant: fig1.GeneralisedPlant, schedule: Scheduled
) -> None:
    """Raise InputError unless a row states the proved numbers.

    A loop can have several equal peaks. At the stated peak the scaled gain must therefore reach mu.
    """
    v = row["v_mps"]
    loop = closed_scaled(plant, schedule.at(v), proved.scaling)
    at_peak = (
        np.linalg.norm(loop.response([row["peak_rad_s"]])[0], 2) if np.isfinite(proved.upper) else np.inf
    )
    for name, value, rtol in (
        ("mu_upper", proved.upper, CERTIFICATE_RTOL),
        ("mu_lower", proved.lower, LOWER_RTOL),
    ):
        if not abs(value - row[name]) <= rtol * abs(row[name]):
            raise InputError(
                path,
                f"certificate at {v:g} m/s, {name}",
                f"{value:.7g} when proved again, not {row[name]:.7g}",
                "the coefficients and weights that were certified",
            )
    if not abs(at_peak - row["mu_upper"]) <= PEAK_RTOL * row["mu_upper"]:
        raise InputError(
            path,
            f"certificate at {v:g} m/s, peak_rad_s",
            f"the gain at {row['peak_rad_s']:.6g} rad/s is {at_peak:.6g}",
            f"the stated mu {row['mu_upper']:.6g}",
        )


def _row(v: float, proved: RobustPerformance) -> dict[str, float]:
    return {
        "v_mps": v,
        "mu_upper": proved.upper,
        "mu_lower": proved.lower,
        "peak_rad_s": proved.bracket.peak_frequency,
    }


def save(
    result: Design,
    stored: StoredIdentification,
    target: Path,
    more: dict[str, str] | None = None,
    largest: LargestA_t | None = None,
) -> None:
    """Write controller.json, its manifest and further files, whole or not at all.

    Parameters
    ----------
    result : Design
    stored : StoredIdentification
    target : Path, new folder
    more : dict, optional, text by file name
    largest : LargestA_t, optional

    Raises
    ------
    InputError
        If the folder may not be replaced.
    """
    settings, schedule = design_settings(stored), result.schedule
    controller = {
        "kind": "controller",
        "schema": 3,
        "Ts_s": schedule.Ts,
        "speeds": schedule.speeds,
        "a": schedule.a,
        "B": schedule.B,
        "L": schedule.L,
        "u_max": schedule.u_max,
        "rate_max": settings.input_rate_max_per_s,
        "certificates": {
            "claim": "frozen speeds, float32 coefficients, interpolated, closed with the nominal model and "
            "the weights: mu <= mu_upper < 1 means robust performance for every LTI Delta within W_delta, on "
            "the premise that the vehicle is within W_delta",
            "test": "bracket of the scaled closed loop's H-infinity norm by level-set tests of its "
            "Hamiltonian",
            "premise": premise(stored).to_dict(),
            "structure": settings.structure,
            "A_t": settings.A_t,
            "A_u": settings.A_u,
            "order": schedule.order,
            "full_order": result.full_order,
            "coefficients_sha256": schedule.digest(),
            "scaling_log_parameters": result.scaling.log_parameters,
            "scaling_columns": result.scaling.log_parameters.shape[1],
            "moving_speed": moving_to_dict(result.moving),
            **(NOTHING if result.further is None else result.further.to_dict()),
            "dc_floor": dc_floor(DesignProblem(stored, settings).weights),
            "largest_A_t": None if largest is None else asdict(largest),
            "off_grid": {"speeds": OFF_GRID, "seed": stored.project.seed, **_row(*result.off_grid)},
            "speeds": [_row(v, p) for v, p in result.certificates],
        },
    }
    with artefacts.new_folder(target, "design", stored.project.name) as folder:
        artefacts.write_files(
            folder,
            {
                **(more or {}),
                "controller.json": artefacts.to_json(artefacts.sealed(controller)),
                artefacts.MANIFEST: artefacts.manifest(
                    "design", vehicle=stored.project.name, identification=stored.manifest
                ),
            },
        )
