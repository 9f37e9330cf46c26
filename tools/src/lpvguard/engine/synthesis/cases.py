"""The paper case: a TOML file with every weight of Fig. 1, and Table II computed from these weights."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lpvguard.base.documents import read_toml
from lpvguard.base.progress import Counted
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.interconnection import (
    PAPER_WEIGHTS,
    STRUCTURES,
    GeneralisedPlant,
    PlantWeights,
    generalised_plant,
    weight_from_table,
)
from lpvguard.engine.synthesis.limits import floor_exceeds
from lpvguard.engine.synthesis.table import Cell, cell
from lpvguard.vehicle import truck_model

PAPER_DIGITS = 5e-4
"""Half a unit of the last digit that the paper prints."""


@dataclass(frozen=True)
class TableRow(Cell):
    """A cell with the numbers of the reference and of the paper.

    Attributes
    ----------
    reference, paper : float or None, mu
    reference_order, paper_order : int or None
    """

    reference: float | None
    reference_order: int | None
    paper: float | None
    paper_order: int | None

    def to_dict(self) -> dict:
        """The row of the cell, extended by the numbers of the reference and of the paper."""
        names = ("reference", "reference_order", "paper", "paper_order")
        return super().to_dict() | {name: getattr(self, name) for name in names}


def read_case(path) -> dict:
    """Read a case file.

    Parameters
    ----------
    path : path

    Returns
    -------
    dict

    Raises
    ------
    InputError
        If it cannot be read, or a weight is missing.
    """
    case = read_toml(Path(path), "a case file")
    for name in ("v", "wheelbase", "objective", *PAPER_WEIGHTS):
        if name not in case:
            raise SynthesisError(path, name, "missing", "a case file as tests/data/paper_case.toml")
    return case


def case_weights(case: dict, objective: dict) -> PlantWeights:
    """Build the ten weights of a case with one objective's A_t and A_u.

    Parameters
    ----------
    case : dict, the case file
    objective : dict, with A_t and A_u

    Returns
    -------
    PlantWeights
    """
    gains = {"A_t": objective["A_t"], "A_u": objective["A_u"]}
    return PlantWeights.of_paper({name: weight_from_table(case[name], **gains) for name in PAPER_WEIGHTS})


def case_plant(
    case: dict,
    objective: dict,
    structure: str,
    *,
    speed: float | None = None,
    dt: float = 0.0,
    delay: int = 0,
) -> GeneralisedPlant:
    """Build Fig. 1 for one objective of a case.

    Parameters
    ----------
    case : dict, the case file
    objective : dict, with A_t and A_u
    structure : str
    speed : float, m/s, optional, by default the speed of the case
    dt : float, s, 0 for continuous time, default 0.0
    delay : int, samples, default 0

    Returns
    -------
    GeneralisedPlant
    """
    weights = case_weights(case, objective)
    A, B = truck_model.continuous(case["v"] if speed is None else speed, case["wheelbase"])
    return generalised_plant(A, B, weights, structure, dt, delay)


def paper_case(
    path, dt: float = 0.0, progress: Callable[[str], None] = lambda _: None, **options
) -> list[TableRow]:
    """Compute Table II for a case file: K_inf, K_i and K_is for each of its objectives.

    Parameters
    ----------
    path : path, the case file
    dt : float, s, 0 for continuous time, default 0.0
    progress : Callable, reports progress
    **options : passed to `dk_synthesis`

    Returns
    -------
    list of TableRow

    References
    ----------
    Paper, Table II.
    """
    case = read_case(path)
    rows: list[TableRow] = []
    most = len(case["objective"]) * len(STRUCTURES)
    for objective in case["objective"]:
        A_t, A_u, paper = objective["A_t"], objective["A_u"], objective.get("paper", {})
        for structure, paper_order in zip(
            STRUCTURES, paper.get("orders", [None] * len(STRUCTURES)), strict=True
        ):
            progress(Counted(f"{structure}, A_t {A_t:g}, A_u {A_u:g}", len(rows), most))
            known = (
                {"mu": objective.get("gamma_K_inf")}
                if structure == "K_inf"
                else objective.get(f"mu_{structure}", {})
            )
            made = cell(case_plant(case, objective, structure, dt=dt), structure, A_t, A_u, **options)
            rows.append(
                TableRow(
                    **vars(made),
                    reference=known.get("mu"),
                    reference_order=known.get("order"),
                    paper=paper.get(structure),
                    paper_order=paper_order,
                )
            )
    return rows


def differences(case: dict, rows: list[TableRow]) -> list[str]:
    """Explain for each row why its level differs from the paper's.

    Parameters
    ----------
    case : dict, the case file
    rows : list of TableRow

    Returns
    -------
    list of str, one sentence for each row
    """
    return [_difference(case, row, rows) for row in rows]


def _difference(case: dict, row: TableRow, rows: list[TableRow]) -> str:
    if row.paper is None:
        return "The paper has no such row."
    limit = (
        f"with this case's weights no controller goes below {row.floor.value:.5f} "
        f"(at {row.floor.frequency:g} rad/s)"
    )
    apart = row.upper / row.paper - 1
    order = (
        f"order {row.order} instead of {row.paper_order}, because states are removed while the certified "
        f"level does not rise (order before: {row.full_order})"
        if row.paper_order
        else f"order {row.order}"
    )
    beyond = (
        ""
        if row.reference is None or row.upper <= row.reference or row.floor.value <= row.reference
        else (f"; the reference's value {row.reference:g} is rounded and lies below this limit")
    )
    if abs(row.upper - row.paper) <= PAPER_DIGITS:
        why = (
            "|W_nr(0)| and |W_wr(0)| were calibrated to this row"
            if row.structure == "K_inf"
            else "the calibrated noise and disturbance limit the level at DC"
        )
        return f"The level equals the paper's to three digits, because {why}: {limit}{beyond}; {order}."
    size = "above" if apart > 0 else "below"
    text = (
        f"{abs(apart):.1%} {size} the paper's {row.paper:g}: {limit}, "
        f"and this case's level is within {row.upper / row.floor.value - 1:.1e} of this limit"
    )
    scale = _uncertainty_scale(case, row, row.paper)
    if scale is not None:
        text += (
            f"; this limit would be the paper's value if the uncertainty weights were {scale:.2g} times as "
            "large, and the paper's weights are not published"
        )
    return f"{text}{_moves(row, row.paper, rows)}{beyond}; {order}."


def _moves(row: TableRow, paper: float, rows: list[TableRow]) -> str:
    """Text on how the structure's level changes with the objective.

    It is empty where tracking may limit the paper's level. A level that tracking limits changes with A_t
    alone. ``paper`` is the row's level in the paper.
    """
    for other in rows:
        if other.structure != row.structure or other is row or other.paper is None:
            continue
        by_tracking = other.A_t / row.A_t
        if other.A_u <= row.A_u and abs(other.paper / paper - by_tracking) > 0.05:
            return (
                f"; from A_t {row.A_t:g}, A_u {row.A_u:g} to {other.A_t:g}, {other.A_u:g} the paper's level "
                f"changes by {other.paper / paper - 1:+.1%}, this case's by "
                f"{other.upper / row.upper - 1:+.1%} and A_t by {by_tracking - 1:+.1%}: "
                "the control effort limits the paper's level, and tracking at DC limits this case's level"
            )
    return ""


def _uncertainty_scale(case: dict, row: TableRow, paper: float) -> float | None:
    """Factor on W_delta_i and W_delta_s that makes the row's limit equal to ``paper``.

    None without uncertainty, or where no factor from 1e-3 to 1e3 does so.
    """
    if row.structure == "K_inf":
        return None

    def exceeds(log_scale: float) -> bool:
        scaled = {
            k: case[k] | {"gain": case[k]["gain"] * np.exp(log_scale)} for k in ("W_delta_i", "W_delta_s")
        }
        plant = case_plant(case | scaled, {"A_t": row.A_t, "A_u": row.A_u}, row.structure)
        return floor_exceeds(plant, row.floor.frequency, paper)

    low, high = np.log(1e-3), np.log(1e3)
    if exceeds(low) or not exceeds(high):
        return None
    while high - low > 1e-2:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if exceeds(middle) else (middle, high)
    return float(np.exp(low))
