"""Cells of Table II: a controller for each structure and objective, its certificate, and a lower bound of μ.

The measured seconds are for the console only. ``Cell.to_dict`` and ``to_csv`` leave them out of files.
"""

import csv
import io
import time
from collections.abc import Sequence
from dataclasses import dataclass

from lpvguard.engine.synthesis.dk import DKResult, dk_synthesis
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant
from lpvguard.engine.synthesis.limits import Floor, mu_floor
from lpvguard.engine.synthesis.statespace import StateSpace

COLUMNS = (
    "structure",
    "A_t",
    "A_u",
    "mu_upper",
    "mu_lower",
    "order",
    "full_order",
    "peak_rad_s",
    "floor",
    "floor_rad_s",
)


@dataclass(frozen=True)
class Cell:
    """One cell of Table II.

    Attributes
    ----------
    structure : str
    A_t, A_u : float, gains of the objective
    result : DKResult, controller with its certificate
    floor : Floor, lower bound of μ for every controller
    seconds : float, s, duration of the synthesis
    """

    structure: str
    A_t: float
    A_u: float
    result: DKResult
    floor: Floor
    seconds: float

    @property
    def upper(self) -> float:
        """Certified upper bound of μ, or of the closed-loop norm for K_inf."""
        return self.result.performance.upper

    @property
    def lower(self) -> float:
        """Lower bound of μ of the same loop, by a checked Δ."""
        return self.result.performance.lower

    @property
    def controller(self) -> StateSpace:
        """The reduced controller, discrete where the plant is discrete."""
        return self.result.controller

    @property
    def order(self) -> int:
        """Number of states after reduction."""
        return self.controller.order

    @property
    def full_order(self) -> int:
        """Number of states before reduction."""
        return self.result.full_order

    def to_dict(self) -> dict:
        """The cell without its duration, so that the same input gives the same bytes."""
        values = (
            self.structure,
            self.A_t,
            self.A_u,
            self.upper,
            self.lower,
            self.order,
            self.full_order,
            self.result.performance.bracket.peak_frequency,
            self.floor.value,
            self.floor.frequency,
        )
        return dict(zip(COLUMNS, values, strict=True))


def cell(plant: GeneralisedPlant, structure: str, A_t: float, A_u: float, **options) -> Cell:
    """Design and certify one controller.

    Parameters
    ----------
    plant : GeneralisedPlant
    structure : str
    A_t, A_u : float, gains of the objective
    **options : passed to `dk_synthesis`

    Returns
    -------
    Cell
    """
    start = time.perf_counter()
    result = dk_synthesis(plant, **options)
    seconds = time.perf_counter() - start
    return Cell(structure, A_t, A_u, result, mu_floor(plant), seconds)


def to_csv(rows: Sequence[dict]) -> str:
    """Write rows as CSV with a header.

    Parameters
    ----------
    rows : Sequence[dict], from ``Cell.to_dict``, possibly with further columns

    Returns
    -------
    str
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(rows[0])
    writer.writerows([f"{x:.9g}" if isinstance(x, float) else x for x in row.values()] for row in rows)
    return stream.getvalue()
