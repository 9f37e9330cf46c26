"""`lpvguard design`: synthesise the scheduled controller, certify it as the core runs it, and compare
structures (paper, step 8)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..base.errors import InputError
from .shared import (
    JsonOut,
    Out,
    app,
    design_case,
    design_tradeoff,
    design_vehicle,
    stored_for,
    stored_with_drives,
)


@app.command(
    epilog="""Examples: lpvguard design --vehicle truck out/identify --drives out/drives -o out/design

lpvguard design --vehicle truck out/identify --drives out/drives --tradeoff -o out/tradeoff

lpvguard design --case paper_case.toml -o out/paper"""
)
def design(
    out: Out,
    identification: Annotated[Path | None, typer.Argument(help="Folder written by identify.")] = None,
    vehicle: Annotated[
        str | None, typer.Option("--vehicle", help="Shipped vehicle, or path to a project file.")
    ] = None,
    drives: Annotated[
        Path | None,
        typer.Option(
            help="The drive folder it was identified from: makes Fig. 6 and the "
            "state uncertainty's bounds exact."
        ),
    ] = None,
    case: Annotated[
        Path | None,
        typer.Option(help="Table II of a case file with every weight frozen, instead of a vehicle's."),
    ] = None,
    tradeoff: Annotated[
        bool,
        typer.Option(
            "--tradeoff",
            help="Search the ceiling on nu, gamma_w and Lambda_nu for the "
            "least worst mu over speed, instead of designing.",
        ),
    ] = False,
    largest_A_t: Annotated[
        bool, typer.Option("--largest-A-t", help="Search the largest A_t with mu < 1 at every speed too.")
    ] = False,
    table: Annotated[bool, typer.Option(help="Table II, Figs. 5 and 6 beside the controller.")] = True,
    json_out: JsonOut = None,
) -> None:
    """Synthesise the scheduled controller, certify it as the core runs it, and compare structures (paper,
    step 8).

    Exit 1 when robust performance (mu below 1) is not certified: at a speed, in a row of the case's table, or
    by any trade-off."""
    if case is not None:
        if (
            identification is not None
            or vehicle is not None
            or drives is not None
            or tradeoff
            or largest_A_t
            or not table
        ):
            raise InputError(
                "design",
                "--case",
                "given with a vehicle, drives, --tradeoff, --largest-A-t or --no-table",
                "a case file alone",
            )
        raise typer.Exit(design_case(case, out, json_out))
    if tradeoff and (largest_A_t or not table):
        raise InputError(
            "design", "--tradeoff", "given with --largest-A-t or --no-table", "neither: nothing is designed"
        )
    if identification is None or vehicle is None:
        raise InputError("design", "--vehicle, IDENTIFICATION", "missing", "both, or --case")
    stored, drive_set = (
        (stored_for(identification, vehicle), None)
        if drives is None
        else stored_with_drives(identification, drives, vehicle)
    )
    if tradeoff:
        raise typer.Exit(design_tradeoff(stored, drive_set, out, json_out))
    raise typer.Exit(design_vehicle(stored, drive_set, table, largest_A_t, out, json_out))
