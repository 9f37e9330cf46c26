"""Draw random loops within the limits of each certificate of a design, and search their worst inputs.

A trial draws a stable Delta. It is a first-order all-pass, a rational system up to fourth order, or the Delta
of mu's lower bound. The gain of Delta is 1, or 1/mu for trials of mu. The input is searched and not drawn.
The adjoint of the loop gives the input with the largest gain over a finite horizon. For a limited demand, an
ascent gives the input.
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
from ...core.scheduled import Scheduled
from ...engine.synthesis.dk import Scaling
from ...engine.synthesis.limited_history import AIMS, LimitedHistory
from ...engine.synthesis.saturation import limited_loop
from ...engine.synthesis.statespace import StateSpace, append
from ...engine.synthesis.varying import History, OverSpeed, close
from ...engine.synthesis.worst_case import close_delta, worst_case
from ...identify.identification import StoredIdentification
from ._violations import Loop, SpeedGrid, closed_period, drawn_corners, injected, ramps, sinusoid, triangle

CONSTRUCTED = 4
"""Number of nodes at which the lower bound of mu constructs a Delta."""
NEAR = 0.7
"""A worst number of at least this share of a bound counts as near the bound."""
SWITCHES = 4
"""Number of sign changes by the derivative for a Delta of any rate."""
ABOVE = 1e-6
"""Relative excess from which a number counts as above its bound. Rounding can cause a smaller excess."""


@dataclass(frozen=True)
class Trial:
    """Result of a trial.

    ``share`` is the reached number divided by the proved number. ``grows`` tells that a loop with proved
    stability grew. ``where`` describes the loop.
    """

    share: float
    grows: bool
    where: str

    @property
    def above(self) -> bool:
        """Tell if the trial refutes the proof."""
        return self.grows or self.share > 1 + ABOVE


class Trials:
    """Trials of one design; ``samples`` is the length of a history."""

    def __init__(self, stored: StoredIdentification, document: dict, samples: int, seed: int):
        self.stored, self.problem, self.samples = stored, DesignProblem.from_identification(stored), samples
        self.stated, self.schedule = document["certificates"], Scheduled.read(document)
        self.scaling = controller_file.stated_scaling(document)
        self.random = np.random.default_rng(seed)
        self.Ts, self.seed = self.schedule.Ts, seed
        self.unscaled = Scaling(np.zeros((len(self.scaling.log_parameters), 1)))

    def claims(self) -> Iterator[tuple[str, float | None, Callable[[], Trial]]]:
        """Yield each claim of the file: name, proved rate (None: frozen speed), function for a trial."""
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
        """Loop from [w; n; r_c] to z over speed."""
        return self._loop(scaled_families(self.problem, self.schedule, self.unscaled)["performance"])

    @cached_property
    def stability(self) -> Loop:
        """Loop from Delta's outputs to its inputs."""
        return self._loop(injected(scaled_families(self.problem, self.schedule, self.unscaled)["stability"]))

    @cached_property
    def scaled_channels(self) -> Loop:
        """Channels of Delta with D(s); their proved gain is below 1."""
        return Loop(
            OverSpeed(scaled_families(self.problem, self.schedule, self.scaling)["stability"]), 0, self.Ts
        )

    def moving_stability(self) -> Trial:
        """Run a history at the proved rate: gain of Delta's scaled channels, growth with a random Delta."""
        rate = self.stated["moving_speed"]["stability"]["rate_mps2"]
        speeds, name = self._profile(rate)
        gain, _ = self.scaled_channels.history(speeds, self.scaled_channels.delta(())).gain(self._input(0))
        period = closed_period(SpeedGrid.for_rate(*self._range, rate, self.Ts), speeds)
        grows = self.stability.history(period, self.drawn()).growth() > 1
        return Trial(gain, grows, name)

    def moving_performance(self) -> Trial:
        """Run a history at the proved rate with a random Delta; compare its gain with the proved level."""
        claim = self.stated["moving_speed"]["performance"]
        speeds, name = self._profile(claim["rate_mps2"])
        history = self.performance.history(speeds, self.drawn())
        return Trial(history.gain(self._input(1))[0] / claim["level"], False, name)

    def frozen(self) -> Trial:
        """Run a trial at a speed with a proved mu: with a Delta of gain 1/mu, the gain is at most mu."""
        row = self._one_of(self.stated["speeds"])
        return self._frozen(row["v_mps"], row["mu_upper"], 1 / row["mu_upper"])

    def worst_gain(self) -> Trial:
        """Run a trial at a node with a proved worst-case gain."""
        row = self._one_of(self._nodes("robustness", "worst_gain"))
        return self._frozen(row["v_mps"], row["worst_gain"], 1.0)

    def slow_delta(self) -> Trial:
        """Run a trial at a node with a weighted mean of two Delta; the weights change at the proved rate."""
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
        """Run a trial at a node with all-passes whose signs switch to increase the gain.

        The number is the scaled gain from Delta's outputs to its inputs. By the small-gain theorem, it is at
        most level / (1 − level).
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
        """Run a trial for a row of the limits: an ascent over inputs of the stated energy for ``aim``."""
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
        """Draw a stable Delta of gain 1."""
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
        """Delta of size 1 that the lower bound of mu constructs at some nodes."""
        speeds = self.schedule.speeds[evenly(len(self.schedule.speeds), CONSTRUCTED)]
        worst = [worst_case(self.problem.plant(v), self.schedule.at(v), self.scaling) for v in speeds]
        return [
            StateSpace(one.delta.A, one.delta.B, one.delta.C / one.size, one.delta.D / one.size, self.Ts)
            for one in worst
        ]

    def _frozen(self, v: float, bound: float, size: float) -> Trial:
        """Compute the gain with a Delta of gain ``size`` at speed ``v`` [m/s], divided by ``bound``."""
        drawn = self.drawn()
        delta = StateSpace(drawn.A, drawn.B, drawn.C * size, drawn.D * size, drawn.dt)
        history = self.performance.history(np.full(self.samples, v), delta)
        return Trial(history.gain(self._input(1))[0] / bound, False, f"{v:.4g} m/s")

    def _profile(self, rate: float) -> tuple[np.ndarray, str]:
        """Draw a speed history (samples,) [m/s] with a largest |dv/dt| of ``rate``, and its name."""
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
        """Draw a first input (samples, m) of the whole loop or of Delta's channels."""
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
        """Rows of the limits with a proved energy; for the aim "gain" also with a proved gain."""
        stated = self.stated.get("limits")
        rows = stated["rows"] if stated else []
        return [row for row in rows if row["energy"] and (aim != "gain" or row["gain"])]


def _side_by_side(one: StateSpace, other: StateSpace) -> tuple[StateSpace, StateSpace]:
    """Give two systems the common state vector of both."""
    both = append(one, other)
    A, B = both.A, np.vstack([one.B, other.B])
    first = StateSpace(A, B, np.hstack([one.C, np.zeros_like(other.C)]), one.D, one.dt)
    second = StateSpace(A, B, np.hstack([np.zeros_like(one.C), other.C]), other.D, one.dt)
    return first, second


def _turned(S: np.ndarray, signs: np.ndarray, index: np.ndarray, n: int, w: np.ndarray) -> np.ndarray:
    """For every sample (T,), choose the row of ``signs`` (K, blocks) that increases the gain most.

    S (K, n + p, n + m) holds the system of each row, and w (T, m) is the input.
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
    """Find the index (T,) of each of ``wanted`` (T, blocks) among the rows of ``signs`` (K, blocks)."""
    return np.argmax((wanted[:, None, :] == signs[None]).all(axis=2), axis=1)
