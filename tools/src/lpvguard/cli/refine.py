"""`lpvguard refine`: judge further drives, propose what to learn, learn what a person signs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..base import artefacts
from .shared import Jobs, JsonOut, Keep, Out, Scheduler, app, console, emit, keeping, progress_bar
from .tables import print_rows


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
    vehicle: Annotated[
        str | None, typer.Option("--vehicle", help="Project file, where a drive recentres the model.")
    ] = None,
    json_out: JsonOut = None,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    keep: Keep = None,
) -> None:
    """Judge further drives and propose what to learn; with --apply, learn what a person signed.

    Nothing is learnt without a signature. Exit 1 when a drive refutes anything, or a vehicle changed.
    """
    from ..base.errors import InputError
    from ..base.parallel import workers
    from ..extras.refine.decisions import KIND, Evidence, decide
    from ..extras.refine.lineage import Lineage
    from ..extras.refine.renewed import renew, rows_of

    if (apply is None) == (not evidence):
        raise InputError("refine", "EVIDENCE", "given with --apply, or neither", "one of them")
    lineage = Lineage.from_folder(identification, drives)
    with progress_bar("refine") as tell, workers(jobs, scheduler) as started, keeping(keep, started) as run:
        if apply is not None:
            artefacts.require_apart([out], [identification, apply, lineage.drives])
            result = renew(lineage, apply, out, vehicle, run, tell)
        else:
            drives_to_judge = Evidence.from_paths(lineage, evidence or [], by)
            artefacts.require_apart([out], [identification, lineage.drives, *(evidence or [])])
            decisions, lives = decide(lineage, drives_to_judge, out.parent, run, tell)
            artefacts.write_file(out, decisions.text(), KIND)
    if apply is not None:
        emit(json_out, result)
        print_rows(rows_of(result))
        console.print(f"written to {out}")
        return
    emit(json_out, {"identification": decisions.identification, "drives": decisions.entries, "lives": lives})
    print_rows(decisions.rows)
    console.print(f"written to {out}: edit it, sign it, then refine {identification} --apply {out}")
    changed = [name for name, v in lives["vehicles"].items() if v["changed_at"] is not None]
    raise typer.Exit(1 if changed or any(d.refutes for d in decisions.drives) else 0)
