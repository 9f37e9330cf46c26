"""Tables of `refine` and of `export --delta` for people, on standard error."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .shared import console
from .tables import print_rows

if TYPE_CHECKING:
    from ..control.recertify import Recertification
    from ..core.coefficient_changes import FieldChange


def print_changes(changes: list[FieldChange]) -> None:
    """The coefficients that changed between two generated folders."""
    print_rows(
        {
            "changed": c.name,
            "numbers": "file" if c.name.endswith(".c") else f"{c.changed} of {c.numbers}",
            "largest relative change": "–" if c.largest is None else f"{c.largest:.3g}",
        }
        for c in changes
    )
    if not changes:
        console.print("no coefficient changed")


def print_recertified(recertification: Recertification) -> None:
    """Certificates of a controller against another set."""
    print_rows(
        {
            "speed m/s": f"{row['v_mps']:.4g}",
            "mu before": f"{row['mu_before']:.4g}",
            "mu now": f"{row['mu_after']:.4g}",
            "at the level": f"{mu:.4g}",
        }
        for row, mu in zip(recertification.rows, recertification.at_level, strict=True)
    )
    level = (
        ""
        if recertification.level is None or recertification.level == 1
        else f": A_t and A_u over {recertification.level:.4g}"
    )
    console.print(f"{recertification.verdict}{level}")
