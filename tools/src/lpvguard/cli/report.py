"""`lpvguard report`: one self-contained HTML page with every picture and table."""

from pathlib import Path
from typing import Annotated

import typer

from ..base import artefacts
from ..base.errors import InputError
from .shared import Coefficients, Out, Vehicle, app, console, progress_bar, replayer_of, stored_with_drives


def _evaluation(path: Path) -> dict:
    """Content of an evaluation. Raises InputError for anything else, and for one of an earlier version."""
    document: dict = artefacts.read_json(path)
    with artefacts.reading(path):
        old = any("precluded" not in duel for duel in document["duels"])
    if old:
        raise InputError(
            path, "duels[].precluded", "missing", "an evaluation by this version: evaluate again"
        )
    return document


@app.command(epilog="Example: lpvguard report out/identify DRIVES --vehicle g80 -o out/report.html")
def report(
    identification: Annotated[Path, typer.Argument(help="Folder written by identify.")],
    drives: Annotated[Path, typer.Argument(help="The drive folder it was made from.")],
    vehicle: Vehicle,
    out: Out,
    coefficients: Coefficients = None,
    evaluation: Annotated[Path | None, typer.Option(help="JSON written by evaluate.")] = None,
    loops: Annotated[Path | None, typer.Option(help="Folder written by sim -o.")] = None,
    campaign: Annotated[Path | None, typer.Option(help="Folder written by campaign.")] = None,
    design: Annotated[Path | None, typer.Option(help="Folder written by design.")] = None,
    tradeoff: Annotated[Path | None, typer.Option(help="Folder written by design --tradeoff.")] = None,
    pictures: Annotated[
        Path | None, typer.Option(help="Also write every picture as SVG and CSV into this folder.")
    ] = None,
) -> None:
    """One self-contained HTML page with every picture and table."""
    from ..report.page import write_report

    for kind, folder in (
        ("sim", loops),
        ("campaign", campaign),
        ("design", design),
        ("design-tradeoff", tradeoff),
    ):
        if folder is not None:
            artefacts.read_manifest(folder, kind)
    judged = _evaluation(evaluation) if evaluation else None
    stored, drive_set = stored_with_drives(identification, drives, vehicle)
    replayer = replayer_of(vehicle, coefficients) if stored.project.frames.estimator == "hann" else None
    with progress_bar("report") as tell:
        write_report(
            stored,
            drive_set,
            replayer,
            out,
            judged,
            tell,
            loops,
            design,
            tradeoff,
            artefacts.read_json(campaign / "summary.json") if campaign else None,
            pictures,
        )
    console.print(f"written to {out}")
