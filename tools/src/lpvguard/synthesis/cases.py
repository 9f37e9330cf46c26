"""The paper case: every weight of Fig. 1 frozen in one TOML file, and Table II computed from it beside the
paper's.
"""

from __future__ import annotations

import time
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path

from lpvguard import truck_model
from lpvguard.synthesis.dk import DKResult, dk_synthesis
from lpvguard.synthesis.errors import SynthesisError
from lpvguard.synthesis.interconnection import (
    STRUCTURES,
    GeneralisedPlant,
    Weights,
    generalised_plant,
    weight_from_table,
)


@dataclass(frozen=True)
class TableRow:
    """One cell of Table II: ours (certified upper bound of μ, lower bound, order, seconds), a reference's and
    the paper's.

    ``full_order``: the order before reduction. reference, reference_order, paper, paper_order: None where not
    given.
    """

    structure: str
    A_t: float
    A_u: float
    upper: float
    lower: float
    order: int
    full_order: int
    seconds: float
    reference: float | None
    reference_order: int | None
    paper: float | None
    paper_order: int | None
    result: DKResult


def read_case(path) -> dict:
    """The case file as a dict; SynthesisError when it cannot be read or a weight is missing."""
    try:
        case = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError) as exc:
        raise SynthesisError(path, "file", str(exc), "a case file in TOML") from exc
    for name in ("v", "wheelbase", "objective", *(f.name for f in fields(Weights))):
        if name not in case:
            raise SynthesisError(path, name, "missing", "a case file as cases/paper_case.toml")
    return case


def case_plant(
    case: dict,
    objective: dict,
    structure: str,
    *,
    speed: float | None = None,
    dt: float = 0.0,
    delay: int = 0,
) -> GeneralisedPlant:
    """Fig. 1 for one objective (A_t, A_u) of a case; ``speed`` in m/s replaces the case's own."""
    gains = {"A_t": objective["A_t"], "A_u": objective["A_u"]}
    weights = Weights(**{f.name: weight_from_table(case[f.name], **gains) for f in fields(Weights)})
    A, B = truck_model.continuous(case["v"] if speed is None else speed, case["wheelbase"])
    return generalised_plant(A, B, weights, structure, dt, delay)


def paper_case(path, dt: float = 0.0, **options) -> list[TableRow]:
    """Table II for a case file: K_inf, K_i and K_is for each of its objectives, in that order.

    ``dt`` > 0 designs in discrete time. ``options`` go to dk_synthesis.
    """
    case, rows = read_case(path), []
    for objective in case["objective"]:
        for k, structure in enumerate(STRUCTURES):
            plant = case_plant(case, objective, structure, dt=dt)
            start = time.perf_counter()
            result = dk_synthesis(plant, **options)
            seconds = time.perf_counter() - start
            known = objective.get(
                f"mu_{structure}", {"mu": objective.get("gamma_K_inf")} if structure == "K_inf" else {}
            )
            paper = objective.get("paper", {})
            orders = paper.get("orders")
            rows.append(
                TableRow(
                    structure,
                    objective["A_t"],
                    objective["A_u"],
                    result.performance.upper,
                    result.performance.lower,
                    result.controller.order,
                    result.full_order,
                    seconds,
                    known.get("mu"),
                    known.get("order"),
                    paper.get(structure),
                    orders and orders[k],
                    result,
                )
            )
    return rows


def format_table(rows: list[TableRow]) -> str:
    """The rows as fixed-width text: ours, the reference's and the paper's side by side."""
    lines = [
        (f"{'':6}{'A_t':>6}{'A_u':>8}{'certified':>11}{'lower':>9}{'order':>7}{'time':>8}"
        f"{'reference':>11}{'order':>7}{'paper':>8}{'order':>7}")
    ]
    for r in rows:
        lines.append(
            f"{r.structure:6}{r.A_t:>6g}{r.A_u:>8.0e}{r.upper:>11.5f}{r.lower:>9.5f}{r.order:>7d}"
            f"{r.seconds:>7.2f}s{_or_dash(r.reference):>11}{_or_dash(r.reference_order):>7}"
            f"{_or_dash(r.paper):>8}{_or_dash(r.paper_order):>7}"
        )
    return "\n".join(lines)


def _or_dash(value) -> str:
    return "-" if value is None else f"{value:g}"
