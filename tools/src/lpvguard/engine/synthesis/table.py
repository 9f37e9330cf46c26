"""Cells of Table II: a controller per structure and objective, its certificate, and the floor of any
controller.

Seconds are measured for the console; files are made from ``Cell.to_dict`` and ``to_csv``, which leave them
out.
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
    A_t, A_u : float, the objective
    result : DKResult, controller with its certificate
    floor : Floor, lower bound of any controller
    seconds : float, s of the synthesis
    """

    structure: str
    A_t: float
    A_u: float
    result: DKResult
    floor: Floor
    seconds: float

    @property
    def upper(self) -> float:
        """Certified upper bound of μ (K_inf: of the closed-loop norm)."""
        return self.result.performance.upper

    @property
    def lower(self) -> float:
        """Lower bound of the same loop's μ, by a Δ that was checked."""
        return self.result.performance.lower

    @property
    def controller(self) -> StateSpace:
        """The reduced controller, in the plant's time."""
        return self.result.controller

    @property
    def order(self) -> int:
        """States after reduction."""
        return self.controller.order

    @property
    def full_order(self) -> int:
        """States before reduction."""
        return self.result.full_order

    def to_dict(self) -> dict:
        """The cell without its time: the same input gives the same bytes."""
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
    A_t, A_u : float, the objective
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
    rows : Sequence[dict], of ``Cell.to_dict``, with any further columns

    Returns
    -------
    str
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(rows[0])
    writer.writerows([f"{x:.9g}" if isinstance(x, float) else x for x in row.values()] for row in rows)
    return stream.getvalue()
