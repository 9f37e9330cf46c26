"""`lpvguard refine`: judge further drives, propose what to learn, learn what a person signs."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..base import artefacts
from ..base.errors import InputError
from .refine_tables import print_recertified
from .shared import Jobs, JsonOut, Keep, Out, Scheduler, app, console, emit, keeping, progress_bar
from .tables import print_rows

if TYPE_CHECKING:
    from ..base.parallel import Map
    from ..base.progress import Progress
    from ..control.recertify import Recertification
    from ..extras.refine.decisions import Decisions

KIND = "recertification"


@app.command(
    epilog="Example: lpvguard refine out/identify NEW --drives DRIVES -o out/decisions.toml; edit it; then "
    "lpvguard refine out/identify --drives DRIVES --apply out/decisions.toml -o out/refined"
)
def refine(
    identification: Annotated[
        Path, typer.Argument(help="Folder written by identify, or by refine --apply before.")
    ],
    evidence: Annotated[
        list[Path] | None, typer.Argument(help="Folders of drives, drive tables and records of the ECU.")
    ] = None,
    *,
    out: Out,
    drives: Annotated[
        Path | None, typer.Option(help="Folder of the drives that were identified; a refined folder has it.")
    ] = None,
    by: Annotated[
        str | None, typer.Option(help="Column of experiments.csv that names the vehicle (default: one).")
    ] = None,
    apply: Annotated[
        Path | None, typer.Option(help="Signed file of decisions: identify with what it accepts.")
    ] = None,
    controller: Annotated[
        Path | None,
        typer.Option(help="controller.json or folder of design: certify it for this identification."),
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option("--vehicle", help="Project file, where a drive recentres the model.")
    ] = None,
    json_out: JsonOut = None,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    keep: Keep = None,
) -> None:
    """Judge further drives, and learn what a person signed.

    With EVIDENCE it proposes what to learn. With --apply it identifies with what was accepted. With
    --controller it certifies the controller in the field.

    Exit 1 when a drive refutes anything, a vehicle changed, or the controller is not proved.
    """
    from ..base.parallel import workers
    from ..extras.fleet.recordings import changed
    from ..extras.refine.renewed import PICTURE, rows_of

    if sum((apply is not None, bool(evidence), controller is not None)) != 1:
        raise InputError("refine", "EVIDENCE, --apply, --controller", "none or several", "one of them")
    with progress_bar("refine") as tell, workers(jobs, scheduler) as started, keeping(keep, started) as run:
        if controller is not None:
            recertification = _recertified(identification, controller, tell, run)
        elif apply is not None:
            table = _learnt(identification, drives, apply, out, vehicle, tell, run)
        else:
            decisions, lives = _decided(identification, drives, evidence or [], by, out, tell, run)
    if controller is not None:
        artefacts.write_json(str(out), asdict(recertification), KIND)
        emit(json_out, asdict(recertification))
        print_recertified(recertification)
        raise typer.Exit(0 if recertification.proved else 1)
    if apply is not None:
        emit(json_out, table)
        print_rows(rows_of(table))
        console.print(f"written to {out}; bounds before and after in {out / PICTURE}")
        return
    emit(json_out, {"identification": decisions.identification, "drives": decisions.entries, "lives": lives})
    print_rows(decisions.rows)
    console.print(f"written to {out}: edit it, sign it, then refine {identification} --apply {out}")
    raise typer.Exit(1 if changed(lives) or any(d.refutes for d in decisions.drives) else 0)


def _decided(
    identification: Path,
    drives: Path | None,
    evidence: list[Path],
    by: str | None,
    out: Path,
    tell: Progress,
    run: Map,
) -> tuple[Decisions, dict[str, Any]]:
    """Judge the evidence and write the file of decisions."""
    from ..extras.refine.decisions import KIND as DECISIONS
    from ..extras.refine.decisions import Evidence, decide
    from ..extras.refine.lineage import Lineage

    lineage = Lineage.from_folder(identification, drives)
    evidence_drives = Evidence.from_paths(lineage, evidence, by)
    artefacts.require_apart([out], [identification, lineage.drives, *evidence])
    decisions, lives = decide(lineage, evidence_drives, out.parent, run, tell)
    artefacts.write_file(out, decisions.text(), DECISIONS)
    return decisions, lives


def _learnt(
    identification: Path,
    drives: Path | None,
    decisions: Path,
    out: Path,
    vehicle: str | None,
    tell: Progress,
    run: Map,
) -> dict[str, Any]:
    """Identify with what is accepted."""
    from ..extras.refine.lineage import Lineage
    from ..extras.refine.renewed import renew

    lineage = Lineage.from_folder(identification, drives)
    artefacts.require_apart([out], [identification, decisions, lineage.drives])
    return renew(lineage, decisions, out, vehicle, run, tell)


def _recertified(folder: Path, controller: Path, tell: Progress, run: Map) -> Recertification:
    """Certify a controller for an identification or a refined folder."""
    from ..control.recertify import recertified
    from ..extras.refine.lineage import IDENTIFICATION
    from ..identify import identification as stage

    stored = stage.load(folder / IDENTIFICATION if (folder / IDENTIFICATION).is_dir() else folder)
    return recertified(controller, stored, tell, run)
