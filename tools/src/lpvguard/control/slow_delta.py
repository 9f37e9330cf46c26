"""Largest proved rate of a varying Delta at every node, and the rates that frames cannot show (THEORY 7.11).

Delta is any causal linear system of gain 1. At a rate r [1/s], it changes from one sample to the next by a
system of gain at most r Ts. The speed is frozen.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..base.parallel import Map
from ..base.progress import Progress, counted
from ..core.scheduled import Scheduled
from ..engine.synthesis.dk import Scaling
from ..engine.synthesis.interconnection import GeneralisedPlant
from ..engine.synthesis.slow_delta import SlowLoop
from ..engine.synthesis.statespace import StateSpace
from .plants import DesignProblem

LEVEL_RTOL = 1e-4
"""Largest relative difference between a stated level and the one proved again."""
FULL_SWING = 2.0
"""Change of a Delta of size 1 that changes its sign."""


@dataclass(frozen=True)
class NodeSlowness:
    """Proved rates at one node.

    The gain is below 1 up to performance_rate [1/s]; the loop is stable up to stability_rate [1/s]. The
    constants and the level of each rate prove it. A rate of None with a level below 1 means any rate, proved
    without D(s). A rate of 0 means no proof.
    """

    v_mps: float
    performance_rate: float
    performance_constants: tuple[float, ...]
    performance_level: float | None
    stability_rate: float | None
    stability_constants: tuple[float, ...]
    stability_level: float


@dataclass(frozen=True)
class Slowness:
    """Proved rates of all nodes, and the rates that frames cannot show.

    ``hidden_slow`` and ``hidden_fast`` [1/s] are the rates of a sign change within the longest and the
    shortest frame.
    """

    nodes: tuple[NodeSlowness, ...]
    hidden_slow: float
    hidden_fast: float

    @property
    def performance_rate(self) -> float:
        """Rate [1/s] proved at every node."""
        return min(node.performance_rate for node in self.nodes)

    @property
    def stability_rate(self) -> float | None:
        """Rate [1/s] proved at every node; None: any rate."""
        return min((n.stability_rate for n in self.nodes if n.stability_rate is not None), default=None)

    def to_dict(self) -> dict:
        """Entry of controller.json."""
        return {
            "claim": "frozen speeds, every causal linear Delta of gain 1 within W_delta that changes in gain "
            "by at most rate x Ts from sample to sample: gain below 1 up to performance_rate, stable up to "
            "stability_rate (null: at any rate)",
            "performance_rate_per_s": self.performance_rate,
            "stability_rate_per_s": self.stability_rate,
            "hidden_slow_per_s": self.hidden_slow,
            "hidden_fast_per_s": self.hidden_fast,
            "nodes": [asdict(node) for node in self.nodes],
        }


def slowness(
    problem: DesignProblem,
    schedule: Scheduled,
    scaling: Scaling,
    progress: Progress = lambda _: None,
    workers: Map = map,
) -> Slowness | None:
    """Compute the rates of every node with the stored scaling D(s); None for a design without Delta.

    ``workers`` share the nodes.
    """
    if not len(scaling.log_parameters):
        return None
    nodes = workers(partial(_node, scaling), _closed(problem, schedule))
    return Slowness(tuple(counted(progress, _texts(schedule), nodes)), *hidden_rates(problem))


def _texts(schedule: Scheduled) -> list[str]:
    return [f"slow Delta at {v:.3g} m/s" for v in schedule.speeds]


def _node(scaling: Scaling, closed: tuple[float, GeneralisedPlant, StateSpace]) -> NodeSlowness:
    v, plant, K = closed
    moving, still = _loops(plant, K, scaling)
    performance = moving[0].search()
    fast = still.at(0.0)
    rate: float | None = None
    if not fast.level < 1:
        slow = moving[1].search()
        rate, fast = (0.0, fast) if slow is None else (slow.rate, slow)
    return NodeSlowness(
        v,
        0.0 if performance is None else performance.rate,
        () if performance is None else tuple(map(float, performance.log_constants)),
        None if performance is None else performance.level,
        rate,
        tuple(map(float, fast.log_constants)),
        fast.level,
    )


def hidden_rates(problem: DesignProblem) -> tuple[float, float]:
    """Rates [1/s] at which a Delta of size 1 changes its sign within the longest and the shortest frame.

    A frame shows only the mean of such a Delta.
    """
    lengths = np.asarray(problem.stored.bounds["length_samples"], float) * problem.model.Ts
    return float(FULL_SWING / lengths.max()), float(FULL_SWING / lengths.min())


def require_slowness(
    path: Path,
    stated: dict | None,
    problem: DesignProblem,
    schedule: Scheduled,
    scaling: Scaling,
    progress: Progress = lambda _: None,
    workers: Map = map,
) -> None:
    """Raise InputError unless the constants in ``stated`` prove the rates in ``stated``.

    ``stated`` is certificates.slow_delta of ``path``; None claims nothing. ``workers`` share the nodes.
    """
    if stated is None:
        return
    nodes = stated["nodes"]
    if [row["v_mps"] for row in nodes] != [float(v) for v in schedule.speeds]:
        raise InputError(
            path,
            "certificates.slow_delta.nodes",
            "the speeds of the rows are not the nodes",
            "one row for each node",
        )
    rates = [row["performance_rate"] for row in nodes], [row["stability_rate"] for row in nodes]
    least = min(rates[0]), min((r for r in rates[1] if r is not None), default=None)
    of_frames = hidden_rates(problem)
    for name, want in (
        ("performance_rate_per_s", least[0]),
        ("stability_rate_per_s", least[1]),
        ("hidden_slow_per_s", of_frames[0]),
        ("hidden_fast_per_s", of_frames[1]),
    ):
        value = stated[name]
        same = value is want if value is None or want is None else np.isclose(value, want, rtol=1e-9, atol=0)
        if not same:
            raise InputError(
                path, f"certificates.slow_delta.{name}", f"{value}", f"{want} from nodes and frames"
            )
    stated_nodes = zip(nodes, _closed(problem, schedule), strict=True)
    for _ in counted(
        progress, _texts(schedule), workers(partial(_require_node, path, scaling), stated_nodes)
    ):
        pass


def _require_node(
    path: Path, scaling: Scaling, stated_node: tuple[dict, tuple[float, GeneralisedPlant, StateSpace]]
) -> None:
    """Raise InputError unless a row's constants prove its rates for its loop."""
    row, (v, plant, K) = stated_node
    moving, still = _loops(plant, K, scaling)
    any_rate = row["stability_rate"] is None
    for part, loop, rate in (
        ("performance", moving[0], row["performance_rate"]),
        ("stability", still if any_rate else moving[1], 0.0 if any_rate else row["stability_rate"]),
    ):
        if rate == 0 and not (part == "stability" and any_rate):
            continue
        level = loop.proved(rate, np.array(row[f"{part}_constants"]))
        stated_level = row[f"{part}_level"]
        if not level < 1 or not abs(level - stated_level) <= LEVEL_RTOL * stated_level:
            raise InputError(
                path,
                f"certificates.slow_delta at {v:g} m/s, {part}",
                f"the level is {level:.7g} when proved again, not {stated_level:.7g}",
                "the rate, constants, coefficients and weights that were certified, and a level below 1",
            )


def _closed(
    problem: DesignProblem, schedule: Scheduled
) -> Iterator[tuple[float, GeneralisedPlant, StateSpace]]:
    """Yield the speed, the generalised plant and the controller of each node."""
    for v in map(float, schedule.speeds):
        yield v, problem.plant(v), schedule.at(v)


def _loops(
    plant: GeneralisedPlant, K: StateSpace, scaling: Scaling
) -> tuple[tuple[SlowLoop, SlowLoop], SlowLoop]:
    """Make the loops with D(s) for performance and for stability, and the loop without D(s) for stability."""
    constant = Scaling(scaling.log_parameters[:, :1])
    with_D = SlowLoop(plant, K, scaling, True), SlowLoop(plant, K, scaling, False)
    return with_D, SlowLoop(plant, K, constant, False)
