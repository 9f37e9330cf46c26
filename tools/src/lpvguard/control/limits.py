"""Prove stability and gain at frozen speeds while the demand is limited, with anti-windup (THEORY 7.12).

A row holds for every LTI Delta within W_delta, while the wanted demand stays within kappa times its limit.
The loop is then stable, and the gain from [w; n; r_c] to z is bounded. The row also bounds the energy of [w;
n; r_c]. Below this bound, the demand stays within kappa times its limit, and its rate limit has no effect.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..base.parallel import Map
from ..base.progress import Progress, counted
from ..base.sampling import evenly
from ..core.scheduled import Scheduled
from ..engine.synthesis.dk import Scaling
from ..engine.synthesis.saturation import LimitedLoop
from .plants import DesignProblem

KAPPAS = (1.0, 1.5, 2.0, np.inf)
"""Ratios kappa of the wanted demand to its limit. 1: the limit is never exceeded; inf: any demand."""
SPEEDS = 4
"""Nodes, ends included."""
ENERGY_RTOL, LEVEL_RTOL = 1e-5, 1e-4
"""Largest relative differences between stated numbers and those proved again."""


@dataclass(frozen=True)
class LimitRow:
    """Proofs at one speed, for wanted demands within kappa times their limits.

    Attributes
    ----------
    v_mps : float, m/s
    kappa : float or None, None: any demand
    stability_level : float or None
        A level below 1 proves stability, with the constants. None: the loop is unstable in the middle of the
        sector.
    stability_constants : tuple of float
    gain : float or None, bound from [w; n; r_c] to z; None: none found
    gain_constants : tuple of float
    energy : float or None, norm of [w; n; r_c] up to which the demand stays within kappa; None: none found
    energy_constants : tuple of float
    """

    v_mps: float
    kappa: float | None
    stability_level: float | None
    stability_constants: tuple[float, ...]
    gain: float | None
    gain_constants: tuple[float, ...]
    energy: float | None
    energy_constants: tuple[float, ...]

    @property
    def stable(self) -> bool:
        """Whether stability is proved."""
        return self.stability_level is not None and self.stability_level < 1


@dataclass(frozen=True)
class Limits:
    """Rows in the order of speed, then of kappa."""

    rows: tuple[LimitRow, ...]

    @property
    def largest_kappa(self) -> float:
        """Largest kappa with a proof of stability at every speed; 0 without any."""
        stable = {k: all(r.stable for r in self.rows if r.kappa == k) for k in self._kappas()}
        return max((np.inf if k is None else k for k, held in stable.items() if held), default=0.0)

    def energy(self) -> float:
        """Largest energy that is proved at every speed for one kappa; 0 without any."""
        by_speed: dict[float, float] = {}
        for row in self.rows:
            by_speed[row.v_mps] = max(by_speed.get(row.v_mps, 0.0), row.energy or 0.0)
        return min(by_speed.values())

    def _kappas(self) -> list[float | None]:
        return list(dict.fromkeys(row.kappa for row in self.rows))

    def to_dict(self) -> dict:
        """Entry of controller.json."""
        return {
            "claim": "frozen speeds, every LTI Delta within W_delta, anti-windup as the core runs it: while "
            "the wanted demand is within kappa times u_max the loop is stable where stability_level is below "
            "1, and the gain from [w; n; r_c] to z is at most gain; every [w; n; r_c] with a norm of at most "
            "energy keeps the wanted demand there and its steps within the rate limit",
            "rows": [asdict(row) for row in self.rows],
        }


def limits(
    problem: DesignProblem,
    schedule: Scheduled,
    scaling: Scaling,
    progress: Progress = lambda _: None,
    workers: Map = map,
) -> Limits:
    """Compute the rows of SPEEDS nodes and of every kappa; ``workers`` share the rows."""
    some = evenly(len(schedule.speeds), SPEEDS)
    points = [(float(schedule.speeds[k]), kappa) for k in some for kappa in KAPPAS]
    rows = workers(
        partial(_row, schedule, largest_step(problem, schedule)), _loops(problem, schedule, scaling, points)
    )
    return Limits(tuple(counted(progress, _texts(points), rows)))


def _texts(points: list[tuple[float, float]]) -> list[str]:
    return [f"limits at {v:.3g} m/s" for v, _ in points]


def _row(schedule: Scheduled, step_max: np.ndarray, point: tuple[float, LimitedLoop]) -> LimitRow:
    v, loop = point
    stability = loop.stability()
    level, constants = stability.least(loop.ones, 1.0, np.zeros(stability.free))
    level = stability.proved(loop.ones, 1.0, constants) if loop.stable else np.inf
    held = level < 1
    gain = loop.gain() if held else None
    starts = [constants, *([] if gain is None else [gain[1]])]
    bounded, u_max = np.isfinite(loop.kappa), schedule.limit(v)
    kept = loop.largest_energy(starts, u_max, step_max) if held and bounded else None
    return LimitRow(
        v,
        loop.kappa if bounded else None,
        level if np.isfinite(level) else None,
        tuple(map(float, constants)),
        None if gain is None else gain[0],
        () if gain is None else tuple(map(float, gain[1])),
        None if kept is None else kept.energy,
        () if kept is None else tuple(map(float, kept.log_constants)),
    )


def require_limits(
    path: Path,
    stated: dict | None,
    problem: DesignProblem,
    schedule: Scheduled,
    scaling: Scaling,
    progress: Progress = lambda _: None,
    workers: Map = map,
) -> None:
    """Raise InputError unless the constants in ``stated`` prove the numbers in ``stated``.

    ``stated`` is certificates.limits of ``path``; None claims nothing. ``workers`` share the rows.
    """
    if stated is None:
        return
    rows = stated["rows"]
    points = [(row["v_mps"], np.inf if row["kappa"] is None else row["kappa"]) for row in rows]
    step_max = largest_step(problem, schedule)
    loops = zip(rows, _loops(problem, schedule, scaling, points), strict=True)
    for _ in counted(
        progress, _texts(points), workers(partial(_require_row, path, schedule, step_max), loops)
    ):
        pass


def _require_row(
    path: Path, schedule: Scheduled, step_max: np.ndarray, stated_row: tuple[dict, tuple[float, LimitedLoop]]
) -> None:
    """Raise InputError unless a row's constants prove its numbers for its loop."""
    row, (v, loop) = stated_row

    def refuse(name: str, value: float | None) -> None:
        raise InputError(
            path,
            f"certificates.limits at {row['v_mps']:g} m/s, kappa {row['kappa']}, {name}",
            f"{value} when proved again, not {row[name]}",
            "the constants, coefficients and weights that were certified",
        )

    constants = np.array(row["stability_constants"], float)
    level = loop.stability().proved(loop.ones, 1.0, constants) if loop.stable else np.inf
    stated_level = np.inf if row["stability_level"] is None else row["stability_level"]
    same = stated_level == level or abs(level - stated_level) <= LEVEL_RTOL * level
    if not same or (stated_level < 1) != (level < 1):
        refuse("stability_level", level)
    if row["gain"] is not None:
        constants = np.array(row["gain_constants"], float)
        level = loop.performance().proved(loop.ones, 1 / row["gain"], constants)
        if not level < 1:
            refuse("gain", row["gain"] * level)
    if row["energy"] is not None:
        constants = np.array(row["energy_constants"], float)
        energy = loop.energy(constants, schedule.limit(v), step_max)
        if energy is None or not abs(energy - row["energy"]) <= ENERGY_RTOL * energy:
            refuse("energy", energy)


def largest_step(problem: DesignProblem, schedule: Scheduled) -> np.ndarray:
    """Return the largest change of each demand from one sample to the next that its rate limit allows.

    Parameters
    ----------
    problem : DesignProblem
    schedule : Scheduled

    Returns
    -------
    ndarray (n_u,), input unit
    """
    return np.array(problem.settings.input_rate_max_per_s) * schedule.Ts


def _loops(
    problem: DesignProblem, schedule: Scheduled, scaling: Scaling, points: list[tuple[float, float]]
) -> Iterator[tuple[float, LimitedLoop]]:
    """Yield the speed and the limited loop for each speed and kappa in ``points``."""
    for v, kappa in points:
        plant = problem.plant(v)
        yield v, LimitedLoop(plant, schedule.at(v), schedule.injection(v), kappa, scaling)
