"""Robustness of a design's loop at every speed node, besides mu (THEORY 7.10).

The results are mu over all frequencies, the worst-case gain, disk margins at the vehicle's input, and the
nu-gap to the neighbouring vehicles. They concern frozen speeds, the core's coefficients and the nominal
vehicle. Worst-case gain and mu are bounds over every Delta of size 1.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from ..base.errors import InputError
from ..base.parallel import Map
from ..base.progress import Progress, counted
from ..base.sampling import evenly
from ..core.scheduled import Scheduled
from ..engine.synthesis.dk import Scaling
from ..engine.synthesis.interconnection import GeneralisedPlant
from ..engine.synthesis.margins import SKEWS
from ..engine.synthesis.mu import mu_interval
from ..engine.synthesis.norms import hinf_norm
from ..engine.synthesis.nu_gap import nu_gap, nu_margin
from ..engine.synthesis.statespace import StateSpace, lft
from ..engine.synthesis.worst_case import worst_case
from ..engine.synthesis.worst_gain import worst_gain
from ..vehicle.nominal import NominalModel
from .plants import DesignProblem, vehicle_at

FOUND_RTOL, EXACT_RTOL = 2e-3, 1e-5
"""Largest relative differences between stated and computed numbers, for a searched bound and for a norm."""
LOOSE = {"mu_interval", "worst_gain", "worst_gain_found"}
UPPER = ("mu_interval", "worst_gain")
"""Fields with upper bounds. A stated bound may exceed the proved bound by FOUND_RTOL. It may not be
smaller."""
PROVED_RTOL = 1e-9
"""Rounding of a stated upper bound."""
SCALING_NODES, SCALING_STEPS = 3, 60
"""Number of neighbour pairs with which the units of the nu-gap are searched, and steps of the search."""


@dataclass(frozen=True)
class NodeRobustness:
    """Robustness at one node.

    Attributes
    ----------
    v_mps : float, m/s
    mu_interval : float, bound of mu proved at every frequency
    worst_gain : float or None
        Bound of the gain from [w; n; r_c] to z over every Delta of size 1. None: no bound proved.
    worst_gain_found : float or None, gain with the worst Delta that is found; None: no Delta found
    disk_S, disk_T, disk_balanced : float
        Disk margins at all vehicle inputs at once (T27). The units of the inputs are in proportion to their
        limits.
    nu_margin : float, b(P, K)
    nu_gap_next, nu_gap_midpoint : float or None
        nu-gaps to the vehicle at the next node and at the midpoint before the next node. None at the last
        node.
    """

    v_mps: float
    mu_interval: float
    worst_gain: float | None
    worst_gain_found: float | None
    disk_S: float
    disk_T: float
    disk_balanced: float
    nu_margin: float
    nu_gap_next: float | None
    nu_gap_midpoint: float | None


@dataclass(frozen=True)
class Robustness:
    """Robustness of all nodes, with the units for the nu-gap of the first input and the outputs (n_y,).

    The units of further inputs are in proportion to the input limits in the middle of the speed range.
    """

    nodes: tuple[NodeRobustness, ...]
    unit_u: float
    units_y: tuple[float, ...]

    def to_dict(self) -> dict:
        """Entry of controller.json."""
        return {
            "claim": "frozen speeds, LTI Delta of size 1: mu_interval and worst_gain hold at every frequency "
            "between 0 and half the sampling frequency; disk margins are those of the nominal loop; "
            "a vehicle nearer than nu_margin in the nu-gap is stabilised",
            "unit_u": self.unit_u,
            "units_y": list(self.units_y),
            "nodes": [asdict(node) for node in self.nodes],
        }


def robustness(
    problem: DesignProblem,
    schedule: Scheduled,
    scaling: Scaling,
    progress: Progress = lambda _: None,
    workers: Map = map,
) -> Robustness:
    """Compute the robustness of every node; ``workers`` share the nodes.

    ``scaling`` helps the search for the worst Delta.
    """
    unit_u, units_y = _units(problem.model, schedule, workers)
    return _with_units(problem, schedule, scaling, unit_u, units_y, progress, workers)


def require_robustness(
    path: Path,
    stated: dict | None,
    problem: DesignProblem,
    schedule: Scheduled,
    scaling: Scaling,
    progress: Progress = lambda _: None,
    workers: Map = map,
) -> None:
    """Raise InputError unless a new computation confirms ``stated``, certificates.robustness of ``path``.

    The computation uses the stated units. None claims nothing. A stated upper bound below the recomputed one
    is accepted if it is proved.
    """
    if stated is not None:
        units = stated["unit_u"], tuple(stated["units_y"])
        recomputed = _with_units(problem, schedule, scaling, *units, progress, workers, stated["nodes"])
        compare(path, stated, recomputed)


def compare(path: Path, stated: dict, recomputed: Robustness) -> None:
    """Raise InputError that names the node and the number if ``stated`` differs from ``recomputed``."""
    if len(stated["nodes"]) != len(recomputed.nodes):
        raise InputError(
            path,
            "certificates.robustness.nodes",
            f"{len(stated['nodes'])} rows",
            f"{len(recomputed.nodes)} nodes",
        )
    for row, node in zip(stated["nodes"], recomputed.nodes, strict=True):
        for name, want in asdict(node).items():
            above = FOUND_RTOL if name in LOOSE else EXACT_RTOL
            below = PROVED_RTOL if name in UPPER else above
            value = row[name]
            room = 0.0 if want is None else abs(want)
            same = value is want if None in (value, want) else -below * room <= value - want <= above * room
            if not same:
                raise InputError(
                    path,
                    f"certificates.robustness at {node.v_mps:g} m/s, {name}",
                    f"{want} when computed again, not {value}",
                    "the coefficients and weights that were certified",
                )


def _with_units(
    problem: DesignProblem,
    schedule: Scheduled,
    scaling: Scaling,
    unit_u: float,
    units_y: tuple[float, ...],
    progress: Progress,
    workers: Map,
    stated: Sequence[dict] = (),
) -> Robustness:
    speeds = [float(v) for v in schedule.speeds]
    units_u = unit_u * _proportions(schedule)
    nodes_to_judge = [
        _Asked(
            v,
            problem.plant(v),
            schedule.at(v),
            vehicle_at(problem.model, v),
            tuple(
                vehicle_at(problem.model, other)
                for after in speeds[k + 1 : k + 2]
                for other in (after, 0.5 * (v + after))
            ),
            {name: stated[k][name] for name in UPPER} if k < len(stated) else {},
        )
        for k, v in enumerate(speeds)
    ]
    texts = [f"margins at {v:.3g} m/s" for v in speeds]
    nodes = workers(partial(_node, scaling, units_u, units_y), nodes_to_judge)
    return Robustness(tuple(counted(progress, texts, nodes)), unit_u, units_y)


@dataclass(frozen=True)
class _Asked:
    """Data of one node: generalised plant, controller, vehicle, and neighbouring vehicles.

    The neighbours are the vehicles at the next node and at the midpoint before it; the last node has none.
    ``stated`` holds the upper bounds to prove, by name.
    """

    v: float
    plant: GeneralisedPlant
    K: StateSpace
    P: StateSpace
    neighbours: tuple[StateSpace, ...]
    stated: dict[str, float | None]

    def proved(self, name: str, bound: Callable[[float], float]) -> float:
        """Return the stated upper bound ``name`` if it is proved, otherwise the recomputed one.

        ``bound(level)`` searches an upper bound from ``level`` on. The stated level is tried only if it is
        below the bound that ``bound`` finds from level 0.
        """
        value, stated = bound(0.0), self.stated.get(name)
        near = stated is not None and value * (1 - FOUND_RTOL) <= stated < value
        return bound(stated) if near and stated is not None else value


def _proportions(schedule: Scheduled) -> np.ndarray:
    """Ratio (n_u,) of each demand's limit to the first demand's limit, in the middle of the speed range."""
    limit = schedule.limit(float(schedule.speeds[len(schedule.speeds) // 2]))
    return limit / limit[0]


def _node(scaling: Scaling, units_u: np.ndarray, units_y: tuple[float, ...], at: _Asked) -> NodeRobustness:
    plant, K = at.plant, at.K
    loop, last = lft(plant.system, K), np.pi / plant.system.dt
    performance = plant.performance_block
    gain = at.proved(
        "worst_gain", lambda least: worst_gain(loop, plant.blocks, performance, 0.0, last, least=least).upper
    )
    mu = at.proved(
        "mu_interval",
        lambda least: mu_interval(loop, [*plant.blocks, performance], 0.0, last, least=least).upper,
    )
    try:
        worst = worst_case(plant, K, scaling if plant.blocks else None).gain
    except ArithmeticError:
        worst = None
    back, here = _feedback(K), _in_units(at.P, units_u, units_y)
    # The margin of several inputs holds in units in proportion to the input limits.
    alike, ones = units_u / units_u[0], (1.0,) * len(units_y)
    of_inputs = _in_units(at.P, alike, ones), _controller_in_units(back, alike, ones)
    gaps = [nu_gap(here, _in_units(other, units_u, units_y)).upper for other in at.neighbours]
    return NodeRobustness(
        at.v,
        mu,
        gain if np.isfinite(gain) else None,
        worst,
        **{f"disk_{name}": _disk(*of_inputs, skew) for name, skew in SKEWS.items()},
        nu_margin=nu_margin(here, _controller_in_units(back, units_u, units_y)),
        nu_gap_next=gaps[0] if gaps else None,
        nu_gap_midpoint=gaps[1] if gaps else None,
    )


def _feedback(K: StateSpace) -> StateSpace:
    """Controller without its first input, the reference."""
    return K.select(slice(None), slice(1, None))


def _disk(P: StateSpace, K: StateSpace, skew: float) -> float:
    """Disk margin (T27) at the inputs of P with u = K y: the reciprocal of ‖S + ½(skew − 1) I‖∞."""
    # System from [w, u] to [w + u, y]. Closed with u = K y, it is S from w to w + u.
    n_u = P.n_inputs
    both = StateSpace(
        P.A,
        np.hstack([P.B, P.B]),
        np.vstack([np.zeros((n_u, P.order)), P.C]),
        np.vstack([np.hstack([np.eye(n_u)] * 2), np.hstack([P.D, P.D])]),
        P.dt,
    )
    S = lft(both, K)
    shifted = StateSpace(S.A, S.B, S.C, S.D + 0.5 * (skew - 1) * np.eye(n_u), S.dt)
    return float(1 / hinf_norm(shifted).upper)


def _in_units(P: StateSpace, units_u: np.ndarray, units_y: tuple[float, ...]) -> StateSpace:
    y = np.array(units_y)[:, None]
    return StateSpace(P.A, P.B * units_u, P.C / y, P.D * units_u / y, P.dt)


def _controller_in_units(K: StateSpace, units_u: np.ndarray, units_y: tuple[float, ...]) -> StateSpace:
    y, u = np.array(units_y), units_u[:, None]
    return StateSpace(K.A, K.B * y, K.C / u, K.D * y / u, K.dt)


def _units(model: NominalModel, schedule: Scheduled, workers: Map) -> tuple[float, tuple[float, ...]]:
    """Search the units with the smallest nu-gaps between neighbours relative to b(P, K).

    The search starts from the steady input and outputs at the input limit, in the middle of the speed range.
    """
    speeds = [float(v) for v in schedule.speeds]
    middle = speeds[len(speeds) // 2]
    P = vehicle_at(model, middle)
    unit_u = float(schedule.limit(middle)[0])
    units_u = unit_u * _proportions(schedule)
    first = np.log(np.abs(P.response([0.0])[0]) @ units_u + 1e-12)
    some = [
        (*(vehicle_at(model, v) for v in speeds[k : k + 2]), _feedback(schedule.at(speeds[k])))
        for k in evenly(len(speeds) - 1, SCALING_NODES)
    ]

    def largest(log_units: np.ndarray) -> float:
        return max(workers(partial(_log_ratio, units_u, tuple(np.exp(log_units))), some))

    optimum = minimize(largest, first, method="Nelder-Mead", options={"maxfev": SCALING_STEPS, "xatol": 1e-2})
    return unit_u, tuple(float(x) for x in np.exp(optimum.x))


def _log_ratio(
    units_u: np.ndarray, units_y: tuple[float, ...], at: tuple[StateSpace, StateSpace, StateSpace]
) -> float:
    """Compute log(nu-gap / b(P, K)) of a vehicle, its neighbour and its feedback.

    The result is inf in units in which only rounding errors remain.
    """
    here, after = (_in_units(P, units_u, units_y) for P in at[:2])
    try:
        margin = nu_margin(here, _controller_in_units(at[2], units_u, units_y))
        return float(np.log(nu_gap(here, after).upper / margin))
    except (np.linalg.LinAlgError, ValueError):
        return np.inf
