"""Certify a controller in the field for another identification: at full performance, at lower, or not at all.

The coefficients stay the same. Only the weights of the model set change. If mu reaches 1, the objectives A_t
and A_u are divided by one common level. The level is the least one that is proved at every speed of the
certificate.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..base.parallel import Map
from ..base.progress import Progress, counted
from ..identify.identification import StoredIdentification
from ..identify.premise import require_premise
from .controller_file import PresentController
from .design import worst_off_grid
from .moving_speed import certified
from .plants import DesignProblem

PROVED, LOWER, NOT = "proved", "proved at lower performance", "not proved"
HIGHEST_LEVEL, STEPS = 64.0, 8
"""Largest level that is tried, and number of bisection steps of its logarithm."""


@dataclass(frozen=True)
class Recertification:
    """Certificates at frozen speeds with the previous and with the new identification.

    Attributes
    ----------
    verdict : str, PROVED, LOWER or NOT
    level : float or None, divisor of A_t and A_u; None: no level is proved
    rows : list of dict, with v_mps, and with the upper bounds mu_before and mu_after at level 1
    at_level : list of float, upper bound of mu at ``level`` for each row
    """

    verdict: str
    level: float | None
    rows: list[dict[str, float]]
    at_level: list[float]

    @property
    def proved(self) -> bool:
        """Tell if mu is below 1 with unchanged objectives."""
        return self.verdict == PROVED


def recertified(
    path: Path, stored: StoredIdentification, progress: Progress = lambda _: None, workers: Map = map
) -> Recertification:
    """Certify a controller.json for another identification of its vehicle.

    Parameters
    ----------
    path : Path, controller.json or its folder
    stored : StoredIdentification
    progress : Callable, reports progress
    workers : Map, shares the speeds

    Returns
    -------
    Recertification

    Raises
    ------
    InputError
        If the file cannot be read or belongs to another vehicle, or if drives refute the model set.
    """
    present = PresentController.from_path(path, stored)
    require_premise(stored)
    schedule, scaling, stated = present.schedule, present.scaling, present.document["certificates"]
    problem = DesignProblem.from_identification(stored)
    before = {row["v_mps"]: row["mu_upper"] for row in [*stated["speeds"], stated["off_grid"]]}
    worst = worst_off_grid(schedule, scaling, problem.plant, stored.project.seed, workers)[0]
    speeds = [*before, worst] if worst not in before else [*before]

    def upper(posed: DesignProblem) -> list[float]:
        plants = [posed.plant(v) for v in speeds]
        tasks = [
            (plant, schedule.at(v), scaling if plant.blocks else None)
            for v, plant in zip(speeds, plants, strict=True)
        ]
        texts = [f"certificate at {v:.3g} m/s" for v in speeds]
        return [bound.upper for bound in counted(progress, texts, workers(certified, tasks))]

    def at_level(level: float) -> list[float]:
        settings = problem.settings
        objectives = {"A_t": settings.A_t / level, "A_u": settings.A_u / level, "synthesised_for": None}
        return upper(problem.with_settings(settings.model_copy(update=objectives)))

    mu = upper(problem)
    rows = [
        {"v_mps": v, "mu_before": before.get(v, before[stated["off_grid"]["v_mps"]]), "mu_after": m}
        for v, m in zip(speeds, mu, strict=True)
    ]
    if max(mu) < 1:
        return Recertification(PROVED, 1.0, rows, mu)
    top = at_level(HIGHEST_LEVEL)
    if not max(top) < 1:
        return Recertification(NOT, None, rows, top)
    low, high, at_high = 0.0, 1.0, top
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        bounds = at_level(HIGHEST_LEVEL**middle)
        if max(bounds) < 1:
            high, at_high = middle, bounds
        else:
            low = middle
    return Recertification(LOWER, HIGHEST_LEVEL**high, rows, at_high)
