"""`lpvguard design --tradeoff`: search the ceiling on nu and the Lambda_nu with the least worst mu.

A candidate is a ceiling nu_bar(omega) and a structure. The ceiling is linear over log omega between levels at
the lowest and the highest bin. The structure is K_i (class S1), or K_is (class S2) with Lambda_nu = diag(1,
lambda_s). Step 4 gives gamma_w of a candidate, and steps 5 to 7 give its weights, from few frames
(stored_frames.py). The level of a candidate is the optimum over speeds with the best common D
(engine/synthesis/scheduling.py). The level is an upper bound of the worst mu of the best frozen controllers,
and `design` starts from it. The floor (engine/synthesis/limits.py) is a lower bound for every controller, at
a hundredth of the cost. A candidate is not synthesised if its floor is not below the best level so far.

The search first tries uniform ceilings for both structures (the front). From the best candidate, it then
changes the two ends of the ceiling and lambda_s in steps. The project's own ceiling is always a candidate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..base import artefacts
from ..base.progress import Counted, Progress
from ..engine.synthesis.dk import Scaling, dk_synthesis
from ..engine.synthesis.interconnection import GeneralisedPlant
from ..engine.synthesis.limits import Floor, mu_floor
from ..engine.synthesis.scheduling import common_scaling
from ..engine.synthesis.table import to_csv
from ..vehicle.project import NuCeiling
from .frozen import FrozenProblem
from .limiting import Limiting
from .stored_frames import Split, SplitWeights

LEVELS = (0.05, 0.1, 0.2, 0.35, 0.6)
"""Uniform ceilings of the front."""
LARGEST_LEVEL = 0.9
"""Largest ceiling. At nu = 1 the model says nothing about the response."""
LEVEL_STEP, LAMBDA_STEP = 1.6, 4.0
AS_GOOD = 1e-3
"""Relative difference of levels that is ignored. A floor within ten times this difference counts as
reached."""
ROUNDS = 2
MOST_CANDIDATES = 2 * (1 + len(LEVELS)) + ROUNDS * 6
"""Largest number of passes over the candidate's numbers after the front."""


@dataclass(frozen=True)
class Candidate:
    """Candidate with a ceiling ``low`` at the lowest bin and ``high`` at the highest, linear over log omega.

    ``lambda_s`` [s^2] is None for K_i. With ``own`` the candidate has the project's ceiling.
    """

    low: float
    high: float
    lambda_s: float | None
    own: bool = False

    @property
    def structure(self) -> str:
        """K_i or K_is."""
        return "K_i" if self.lambda_s is None else "K_is"

    @property
    def key(self) -> tuple:
        """Key for comparison that ignores rounding."""
        return (*np.round([self.low, self.high, self.lambda_s or 0.0], 9), self.own)

    def moved(self, name: str, factor: float) -> Candidate | None:
        """Multiply the number ``name`` (low, high or lambda_s) by ``factor``; None if the candidate lacks it.

        Each end of the ceiling is at most LARGEST_LEVEL.
        """
        value = getattr(self, name)
        if value is None:
            return None
        value = value * factor if name == "lambda_s" else min(value * factor, LARGEST_LEVEL)
        return replace(self, **{name: value}, own=False)


@dataclass(frozen=True)
class Outcome:
    """Ceiling (K,), split (K,), floor and level of a candidate; the level is the optimum over speeds.

    The level is None if the floor already excludes the candidate.
    """

    candidate: Candidate
    ceiling: np.ndarray
    split: Split
    floor: Floor
    level: float | None
    scaling: Scaling | None

    def to_dict(self) -> dict:
        """Row of tradeoff.json."""
        c = self.candidate
        return {
            "structure": c.structure,
            "ceiling": "project" if c.own else "two levels",
            "nu_low": self.ceiling[1],
            "nu_high": self.ceiling[-1],
            "lambda_s": c.lambda_s,
            "mu_worst": self.level,
            "floor": self.floor.value,
            "floor_rad_s": self.floor.frequency,
            "gamma_w_max": float(np.nanmax(self.split.gamma_w)),
            "nu_i_max": float(np.nanmax(self.split.nu_i)),
            "nu_s_max": None if self.split.nu_s is None else float(np.nanmax(self.split.nu_s)),
        }


@dataclass(frozen=True)
class Measured(Outcome):
    """Outcome of a synthesised candidate, with its level and its scaling."""

    level: float
    scaling: Scaling


@dataclass(frozen=True)
class TradeOff:
    """Result of the search.

    Attributes
    ----------
    problem : FrozenProblem
    outcomes : list of Outcome, in the order tried
    best, own : Measured, the best candidate and the project's setting
    limit : dict, numbers that describe what limits the best candidate
    sentence : str, the limit in words
    """

    problem: FrozenProblem
    outcomes: list[Outcome]
    best: Measured
    own: Measured
    limit: dict
    sentence: str

    def files(self) -> dict[str, str]:
        """Make tradeoff.json and tradeoff.csv."""
        rows = [o.to_dict() for o in self.outcomes]
        document = {
            "kind": "tradeoff",
            "schema": 1,
            "vehicle": self.problem.stored.project.name,
            "speeds_mps": speeds(self.problem),
            "A_t": self.problem.settings.A_t,
            "A_u": self.problem.settings.A_u,
            "frames": "deciding frames of the drives"
            if self.problem.frames.complete
            else "stored sample of frames",
            "sentence": self.sentence,
            "limit": self.limit,
            "best": self.best.to_dict(),
            "own": self.own.to_dict(),
            "setting": self.setting(),
            "rows": rows,
            "omega_rad_s": self.problem.frames.estimator.omega,
            "detail": {
                name: {
                    "ceiling": o.ceiling,
                    "gamma_w": o.split.gamma_w,
                    "nu_i": o.split.nu_i,
                    "nu_s": o.split.nu_s,
                    "B_w": o.split.B_w,
                }
                for name, o in (("best", self.best), ("own", self.own))
            },
        }
        return {"tradeoff.json": artefacts.to_json(document), "tradeoff.csv": to_csv(rows)}

    def setting(self) -> dict:
        """Best setting, for the project file."""
        omega = self.problem.frames.estimator.omega
        own = self.problem.stored.project.bounds.nu_ceiling
        ceiling = own if self.best.candidate.own else between(self.best.candidate, omega)
        return {"bounds.nu_ceiling": None if ceiling is None else ceiling.model_dump()} | (
            {} if self.best.candidate.lambda_s is None else {"design.lambda_s": self.best.candidate.lambda_s}
        )


def between(c: Candidate, omega: np.ndarray) -> NuCeiling:
    """Ceiling of a candidate in the form of the project file, over the bins omega (K,) [rad/s]."""
    return NuCeiling.model_validate({"omega_radps": omega[[1, -1]], "nu": [c.low, c.high]})


def speeds(problem: FrozenProblem) -> list[float]:
    """Both ends of the model's range and the design speed [m/s]."""
    low, high = problem.stored.model.speed_range
    return sorted({low, problem.settings.design_speed_mps, high})


class _Search:
    """Search with all tried candidates in ``outcomes`` and the synthesised ones in ``made``."""

    def __init__(self, problem: FrozenProblem, progress: Progress):
        self.problem, self.progress, self.frames = problem, progress, problem.frames
        self.outcomes: list[Outcome] = []
        self.made: list[Measured] = []
        self.known: dict[tuple, Outcome] = {}

    def best(self) -> Measured:
        """First candidate with the least level (K_i is tried before K_is); call `front` first."""
        least = min(o.level for o in self.made)
        return next(o for o in self.made if o.level <= least * (1 + AS_GOOD))

    def ceiling(self, c: Candidate) -> np.ndarray:
        """The candidate's ceiling on nu at the bins, (K,)."""
        omega = self.frames.estimator.omega
        if c.own:
            return self.problem.stored.bounds["nu_ceiling"]
        return between(c, omega).at(omega / (2 * np.pi))

    def plants(self, c: Candidate, fitted: SplitWeights) -> list[GeneralisedPlant]:
        """The generalised plants at ``speeds`` with these weights."""
        s = self.problem.settings
        weights = self.problem.weights(c.structure, s.A_t, s.A_u, fitted)
        return [self.problem.plant(c.structure, weights, v) for v in speeds(self.problem)]

    def split(self, c: Candidate) -> tuple[np.ndarray, Split]:
        """The candidate's ceiling (K,) and the split of the error under its gamma_w."""
        ceiling = self.ceiling(c)
        gamma_w = self.frames.smooth(self.frames.gamma_rule(ceiling))
        return ceiling, (
            self.frames.explain(gamma_w)
            if c.lambda_s is None
            else self.frames.explain_with_state(gamma_w, c.lambda_s)
        )

    def posed(self, c: Candidate) -> tuple[Outcome, list[GeneralisedPlant]]:
        """Compute the candidate's split and floor, and its plants over speed, without synthesis."""
        n = len(self.outcomes)
        text = f"candidate {n + 1}: {c.structure}, ceiling {c.low:.3g} to {c.high:.3g}"
        text += "" if c.lambda_s is None else f", lambda_s {c.lambda_s:.3g}"
        self.progress(Counted(text, n, MOST_CANDIDATES))
        ceiling, split = self.split(c)
        plants = self.plants(c, self.frames.weights(split))
        floor = max((mu_floor(p, rtol=1e-3) for p in plants), key=lambda f: f.value)
        return Outcome(c, ceiling, split, floor, None, None), plants

    def synthesised(
        self, outcome: Outcome, plants: list[GeneralisedPlant], start: Scaling | None
    ) -> Measured:
        """Add the level to an outcome by synthesis.

        ``start`` starts the search for the scaling. With None, D-K iteration at the design speed starts it.
        """
        middle = plants[speeds(self.problem).index(self.problem.settings.design_speed_mps)]
        start = start or dk_synthesis(middle, iterations=3, polish=0).performance.scaling
        scaling, level = common_scaling(plants, start)
        made = Measured(outcome.candidate, outcome.ceiling, outcome.split, outcome.floor, level, scaling)
        self.made.append(made)
        self.outcomes.append(made)
        self.known[outcome.candidate.key] = made
        return made

    def tried(self, c: Candidate, start: Scaling) -> Outcome:
        """Return the outcome of a candidate; synthesise only if its floor is below the best level."""
        if c.key in self.known:
            return self.known[c.key]
        outcome, plants = self.posed(c)
        if outcome.floor.value < self.best().level:
            return self.synthesised(outcome, plants, start)
        self.known[c.key] = outcome
        self.outcomes.append(outcome)
        return outcome

    def front(self) -> None:
        """Try uniform ceilings. The scaling of the previous ceiling starts the next search."""
        low, high = self.problem.stored.bounds["nu_ceiling"][[1, -1]].tolist()
        for lambda_s in (None, self.problem.settings.lambda_s):
            made = self.synthesised(*self.posed(Candidate(low, high, lambda_s, own=True)), None)
            for level in LEVELS:
                made = self.synthesised(*self.posed(Candidate(level, level, lambda_s)), made.scaling)

    def refine(self) -> None:
        """Change one number of the best candidate at a time, while this improves the level."""
        for _ in range(ROUNDS):
            before = self.best()
            for move, step in (("low", LEVEL_STEP), ("high", LEVEL_STEP), ("lambda_s", LAMBDA_STEP)):
                for factor in (step, 1 / step):
                    centre = self.best()
                    moved = centre.candidate.moved(move, factor)
                    if moved is not None and self.tried(moved, centre.scaling) is self.best():
                        break
            if self.best() is before:
                break


def search(problem: FrozenProblem, progress: Progress = lambda _: None) -> TradeOff:
    """Search the best trade-off; see the module's docstring.

    Parameters
    ----------
    problem : FrozenProblem
    progress : Callable, reports progress

    Returns
    -------
    TradeOff
    """
    run = _Search(problem, progress)
    run.front()
    run.refine()
    best = run.best()
    own = next(o for o in run.made if o.candidate.own and o.candidate.lambda_s is None)
    progress("what limits the best")
    limit = _limit(run, best)
    return TradeOff(problem, run.outcomes, best, own, limit, _sentence(run, best, own, limit))


def _limit(run: _Search, best: Measured) -> dict:
    """Describe what limits the best candidate: the speed, and the share of each signal at the peak of mu."""
    plants = run.plants(best.candidate, run.frames.weights(best.split))
    made = [dk_synthesis(plant, iterations=2, polish=0, start=best.scaling) for plant in plants]
    k = int(np.argmax([result.performance.upper for result in made]))
    v, plant, result = speeds(run.problem)[k], plants[k], made[k]
    performance = result.performance
    limiting = Limiting.at_peak(plant, result.controller, performance)
    return {
        "speed_mps": v,
        "mu_upper": performance.upper,
        "mu_lower": performance.lower,
        "peak_rad_s": limiting.frequency,
        "enters_by": limiting.enters_by,
        "leaves_by": limiting.leaves_by,
        "floor": best.floor.value,
        "floor_rad_s": best.floor.frequency,
    }


def _sentence(run: _Search, best: Measured, own: Measured, limit: dict) -> str:
    c = best.candidate
    where = (
        "the project's own ceiling"
        if c.own
        else f"a ceiling of {c.low:.3g} at the lowest bin and {c.high:.3g} at the highest"
    )
    text = (
        f"Least worst mu {best.level:.3f} with {c.structure}, {where}"
        + ("" if c.lambda_s is None else f", lambda_s {c.lambda_s:.3g} s^2")
        + f" (K_i with the project's ceiling: {own.level:.3f}). "
    )
    if best.level >= 1:
        least = min(o.floor.value for o in run.outcomes)
        text += "No candidate reaches mu < 1: with these objectives " + (
            f"no controller can, as every candidate's floor is at least {least:.3f}. "
            if least >= 1
            else f"the floors (down to {least:.3f}) leave it open to other D or controllers. "
        )

    def at(omega: float) -> str:
        return "DC" if omega < 1e-2 * run.frames.estimator.omega[1] else f"{omega:.3g} rad/s"

    text += (
        f"What limits it: at {limit['speed_mps']:g} m/s and {at(limit['peak_rad_s'])} "
        f"{Limiting(limit['peak_rad_s'], limit['enters_by'], limit['leaves_by']).sentence()}; "
        f"with these weights no controller goes below {limit['floor']:.3f} (at {at(limit['floor_rad_s'])})"
    )
    reached = best.level <= best.floor.value * (1 + 10 * AS_GOOD)
    return text + (
        ": it is reached, so only other objectives, noise or disturbance bounds lower mu." if reached else "."
    )
