"""Loops drawn within the limits of each certificate of a controller.json, each with its worst input found.

A trial draws a stable Delta. It is an all-pass of first order, a sampled rational system up to fourth order,
or one that the lower bound of mu constructs. Its gain is 1, or 1/mu for trials of mu. The input is not drawn.
The loop's adjoint finds the input with the largest gain over a finite horizon. Where the demand is limited,
the input is the one that climbs furthest.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from ...base.sampling import evenly
from ...control import controller_file
from ...control.limits import largest_step
from ...control.moving_speed import scaled_families
from ...control.plants import DesignProblem
from ...control.robust_run import sampled_block
from ...control.violations import (
    Loop,
    SpeedGrid,
    closed_period,
    drawn_corners,
    injected,
    ramps,
    sinusoid,
    triangle,
)
from ...core.scheduled import Scheduled
from ...engine.synthesis.dk import Scaling
from ...engine.synthesis.limited_history import AIMS, LimitedHistory
from ...engine.synthesis.saturation import limited_loop
from ...engine.synthesis.statespace import StateSpace, append
from ...engine.synthesis.varying import History, OverSpeed, close
from ...engine.synthesis.worst_case import close_delta, worst_case
from ...identify.identification import StoredIdentification

CONSTRUCTED = 4
"""Nodes at which mu's lower bound constructs a Delta."""
NEAR = 0.7
"""Share of a bound from which the worst found counts as near it."""
SWITCHES = 4
"""Times that a Delta of any rate is turned to what the derivative favours."""
ABOVE = 1e-6
"""Share above a bound that counts as above: what simulation in double may leave."""


@dataclass(frozen=True)
class Trial:
    """A trial.

    ``share`` is the reached over the proved number. ``grows`` says that a loop that is proved stable grew.
    ``where`` is the place.
    """

    share: float
    grows: bool
    where: str

    @property
    def above(self) -> bool:
        """Whether the trial refutes the proof."""
        return self.grows or self.share > 1 + ABOVE


class Trials:
    """The trials of one design; ``samples``: of a history."""

    def __init__(self, stored: StoredIdentification, document: dict, samples: int, seed: int):
        self.stored, self.problem, self.samples = stored, DesignProblem.from_identification(stored), samples
        self.stated, self.schedule = document["certificates"], Scheduled.read(document)
        self.scaling = controller_file.stated_scaling(document)
        self.random = np.random.default_rng(seed)
        self.Ts, self.seed = self.schedule.Ts, seed
        self.unscaled = Scaling(np.zeros((len(self.scaling.log_parameters), 1)))

    def claims(self) -> Iterator[tuple[str, float | None, Callable[[], Trial]]]:
        """Claims of the file: name, proved rate (None: the speed is frozen), and function that draws a
        trial."""
        moving = {claim: row["rate_mps2"] for claim, row in self.stated["moving_speed"].items()}
        if moving.get("stability"):
            yield "stability, moving speed", moving["stability"], self.moving_stability
        if moving.get("performance"):
            yield "performance, moving speed", moving["performance"], self.moving_performance
        yield "mu, frozen speed", None, self.frozen
        if self._nodes("robustness", "worst_gain"):
            yield "worst-case gain, nodes", None, self.worst_gain
        if self._nodes("slow_delta", "performance_rate"):
            yield "slow Delta, performance", None, self.slow_delta
        if self._switched():
            yield "Delta of any rate, stability", None, self.switched_delta
        for aim in AIMS:
            if self._limits(aim):
                yield f"limits, {aim}", None, partial(self.limited, aim)

    @cached_property
    def performance(self) -> Loop:
        """The loop from [w; n; r_c] to z over speed."""
        return self._loop(scaled_families(self.problem, self.schedule, self.unscaled)["performance"])

    @cached_property
    def stability(self) -> Loop:
        """Loop from Delta's outputs to its inputs."""
        return self._loop(injected(scaled_families(self.problem, self.schedule, self.unscaled)["stability"]))

    @cached_property
    def scaled_channels(self) -> Loop:
        """Delta's channels with D(s), whose proved gain is below 1."""
        return Loop(
            OverSpeed(scaled_families(self.problem, self.schedule, self.scaling)["stability"]), 0, self.Ts
        )

    def moving_stability(self) -> Trial:
        """A history at the proved rate: gain of Delta's scaled channels, and growth with a drawn Delta."""
        rate = self.stated["moving_speed"]["stability"]["rate_mps2"]
        speeds, name = self._profile(rate)
        gain, _ = self.scaled_channels.history(speeds, self.scaled_channels.delta(())).gain(self._input(0))
        period = closed_period(SpeedGrid.for_rate(*self._range, rate, self.Ts), speeds)
        grows = self.stability.history(period, self.drawn()).growth() > 1
        return Trial(gain, grows, name)

    def moving_performance(self) -> Trial:
        """A history at the proved rate with a drawn Delta: its gain over the proved level."""
        claim = self.stated["moving_speed"]["performance"]
        speeds, name = self._profile(claim["rate_mps2"])
        history = self.performance.history(speeds, self.drawn())
        return Trial(history.gain(self._input(1))[0] / claim["level"], False, name)

    def frozen(self) -> Trial:
        """Trial at a speed with a proved mu: a Delta of gain 1/mu leaves a gain of mu."""
        row = self._one_of(self.stated["speeds"])
        return self._frozen(row["v_mps"], row["mu_upper"], 1 / row["mu_upper"])

    def worst_gain(self) -> Trial:
        """Trial at a node with a proved worst-case gain."""
        row = self._one_of(self._nodes("robustness", "worst_gain"))
        return self._frozen(row["v_mps"], row["worst_gain"], 1.0)

    def slow_delta(self) -> Trial:
        """Trial at a node: a mean of two Delta whose weights move at the proved rate."""
        row = self._one_of(self._nodes("slow_delta", "performance_rate"))
        grid = SpeedGrid.for_rate(-1.0, 1.0, row["performance_rate"], self.Ts)
        shape = triangle if self.random.random() < 0.5 else sinusoid
        places = shape(grid, self.samples, -1.0, 1.0, self.random.random())
        one, other = self.drawn(), self.drawn()
        S = self.performance.over.at(np.array([row["v_mps"]]))
        ends = [close(S, self.performance.over.n, both)[0] for both in _side_by_side(one, other)]
        visited, index = np.unique(places, return_inverse=True)
        share = 0.5 * (1 + visited)[:, None, None]
        history = History(share * ends[0] + (1 - share) * ends[1], index, self._states(one, other))
        gain, _ = history.gain(self._input(1))
        return Trial(gain, False, f"{row['v_mps']:.4g} m/s, {shape.__name__} between two Delta")

    def switched_delta(self) -> Trial:
        """Trial at a node: all-passes whose signs switch as the derivative favours.

        The number is the scaled gain from Delta's outputs to its inputs, bounded by level / (1 − level)
        (small gain).
        """
        row = self._one_of(self._switched())
        blocks, level = self.stability.blocks, row["stability_level"]
        corners = drawn_corners(self.random, blocks)
        signs = np.array(np.meshgrid(*[[1.0, -1.0]] * blocks, indexing="ij")).reshape(blocks, -1).T
        open_loop = self.stability.over.at(np.array([row["v_mps"]]))
        S = np.array(
            [
                close(
                    open_loop,
                    self.stability.over.n,
                    self.stability.delta([(s * sign, c) for s, (sign, c) in zip(some, corners, strict=True)]),
                )[0]
                for some in signs
            ]
        )
        n = self.stability.over.n + self.stability.delta(corners).order
        d = np.exp(self.scaling.log_parameters[:, 0] + np.array(row["stability_constants"]))
        S[:, n:], S[:, :, n:] = S[:, n:] * d[:, None], S[:, :, n:] / d
        w, index, gain = self._input(0), self.random.integers(0, len(S), self.samples), 0.0
        for _ in range(SWITCHES):
            reached, w = History(S, index, n).gain(w, 4)
            gain = max(gain, reached)
            index = _turned(S, signs, index, n, w)
        bound = level / (1 - level)
        return Trial(gain / bound, False, f"{row['v_mps']:.4g} m/s, switched signs")

    def limited(self, aim: str) -> Trial:
        """Trial at a row of the limits: an input of the stated energy that climbs for the ``aim``."""
        row = self._one_of(self._limits(aim))
        v, kappa = row["v_mps"], row["kappa"]
        plant, K = self.problem.plant(v), self.schedule.at(v)
        loop = limited_loop(plant, K, self.schedule.injection(v), np.inf, self.unscaled)
        closed = close_delta(loop, self.drawn()) if plant.blocks else loop
        u_max = float(self.schedule.limit(v)[0])
        start = self.random.standard_normal((self.samples // 2, plant.performance_block.rows))
        reached, _ = LimitedHistory(closed, u_max).furthest(aim, row["energy"], start)
        step_max = largest_step(self.problem, self.schedule)
        bound = {"demand": kappa * u_max, "step": step_max, "gain": row["gain"]}[aim]
        return Trial(reached / bound, False, f"{v:.4g} m/s, kappa {kappa:g}")

    def drawn(self) -> StateSpace:
        """A stable Delta of gain 1."""
        kind = self.random.integers(0, 3)
        if kind == 0:
            return self.performance.delta(drawn_corners(self.random, self.performance.blocks))
        if kind == 1:
            return append(
                *(sampled_block(self.random, 1, 1, 1.0, self.Ts) for _ in range(self.performance.blocks))
            )
        return self._constructed[self.random.integers(0, len(self._constructed))]

    @cached_property
    def _constructed(self) -> list[StateSpace]:
        """Delta of size 1 that mu's lower bound constructs at some nodes."""
        speeds = self.schedule.speeds[evenly(len(self.schedule.speeds), CONSTRUCTED)]
        worst = [worst_case(self.problem.plant(v), self.schedule.at(v), self.scaling) for v in speeds]
        return [
            StateSpace(one.delta.A, one.delta.B, one.delta.C / one.size, one.delta.D / one.size, self.Ts)
            for one in worst
        ]

    def _frozen(self, v: float, bound: float, size: float) -> Trial:
        """Gain with a Delta of gain ``size`` at speed ``v`` [m/s], over ``bound``."""
        drawn = self.drawn()
        delta = StateSpace(drawn.A, drawn.B, drawn.C * size, drawn.D * size, drawn.dt)
        history = self.performance.history(np.full(self.samples, v), delta)
        return Trial(history.gain(self._input(1))[0] / bound, False, f"{v:.4g} m/s")

    def _profile(self, rate: float) -> tuple[np.ndarray, str]:
        """A history (samples,) [m/s] of largest |dv/dt| ``rate``, and its name."""
        low, high = self._range
        grid = SpeedGrid.for_rate(low, high, rate, self.Ts)
        first, last = (
            np.sort(self.random.uniform(low, high, 2)) if self.random.random() < 0.5 else (low, high)
        )
        kind, start = self.random.choice(["triangle", "sinusoid", "ramps"]), self.random.random()
        if kind == "ramps":
            levels, hold = self.random.uniform(first, last, 6), int(self.random.integers(0, 300))
            return ramps(grid, self.samples, levels, hold), f"ramps, {first:.3g} to {last:.3g} m/s"
        shape = triangle if kind == "triangle" else sinusoid
        return shape(grid, self.samples, first, last, start), f"{kind}, {first:.3g} to {last:.3g} m/s"

    @property
    def _range(self) -> tuple[float, float]:
        return float(self.schedule.speeds[0]), float(self.schedule.speeds[-1])

    def _loop(self, family) -> Loop:
        return Loop(OverSpeed(family), len(self.scaling.log_parameters), self.Ts)

    def _input(self, performance: int) -> np.ndarray:
        """A first input (samples, m): of the whole loop or of Delta's channels."""
        loop = self.performance if performance else self.stability
        return self.random.standard_normal((self.samples, loop.inputs))

    def _one_of(self, rows: list[dict]) -> dict:
        return rows[int(self.random.integers(len(rows)))]

    def _states(self, *deltas: StateSpace) -> int:
        return self.performance.over.n + sum(delta.order for delta in deltas)

    def _nodes(self, part: str, name: str) -> list[dict]:
        """Nodes of a part of the certificates for which the number ``name`` is proved."""
        stated = self.stated.get(part)
        return [row for row in stated["nodes"] if row[name]] if stated else []

    def _switched(self) -> list[dict]:
        """Nodes that are proved stable for a Delta of any rate."""
        return [
            row
            for row in self._nodes("slow_delta", "stability_level")
            if row["stability_rate"] is None and row["stability_level"] < 1
        ]

    def _limits(self, aim: str) -> list[dict]:
        """Rows of the limits with an energy, for the gain also with a gain."""
        stated = self.stated.get("limits")
        rows = stated["rows"] if stated else []
        return [row for row in rows if row["energy"] and (aim != "gain" or row["gain"])]


def _side_by_side(one: StateSpace, other: StateSpace) -> tuple[StateSpace, StateSpace]:
    """Each of two systems with the states of both."""
    both = append(one, other)
    A, B = both.A, np.vstack([one.B, other.B])
    first = StateSpace(A, B, np.hstack([one.C, np.zeros_like(other.C)]), one.D, one.dt)
    second = StateSpace(A, B, np.hstack([np.zeros_like(one.C), other.C]), other.D, one.dt)
    return first, second


def _turned(S: np.ndarray, signs: np.ndarray, index: np.ndarray, n: int, w: np.ndarray) -> np.ndarray:
    """Row of ``signs`` (K, blocks) for every sample (T,) that the derivative of the gain favours.

    S (K, n + p, n + m) belongs to these rows, w (T, m) is the input.
    """
    history, turned = History(S, index, n), np.empty((len(index), signs.shape[1]))
    for block in range(signs.shape[1]):
        up = signs.copy()
        up[:, block] = 1.0
        down = signs.copy()
        down[:, block] = -1.0
        dS = S[_row_of(signs, up)] - S[_row_of(signs, down)]
        slope = history.slopes(dS, w)
        turned[:, block] = np.where(slope >= 0, 1.0, -1.0)
    return _row_of(signs, turned)


def _row_of(signs: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The row (T,) of ``signs`` (K, blocks) that each of ``wanted`` (T, blocks) is."""
    return np.argmax((wanted[:, None, :] == signs[None]).all(axis=2), axis=1)
