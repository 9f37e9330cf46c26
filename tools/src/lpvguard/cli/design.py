"""`lpvguard design`: synthesise the scheduled controller, certify it as the core runs it, and compare
structures (paper, step 8)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..base import artefacts
from ..base.errors import InputError
from ..base.parallel import workers
from ..base.progress import Progress, parts
from .shared import Jobs, JsonOut, Out, app, console, emit, progress_bar, stored_for, stored_with_drives
from .tables import (
    print_case,
    print_cells,
    print_certificates,
    print_largest_A_t,
    print_limits,
    print_moving_speed,
    print_premise,
    print_robustness,
    print_slow_delta,
    print_summary,
    print_tradeoff,
)

SHARES, TABLE_SHARES = (10, 3, 60), (1, 9)
"""Approximate shares of the work: design, comparison of structures, largest A_t; reading, all others."""

if TYPE_CHECKING:
    from ..control.controller_file import PresentController
    from ..control.design import Design
    from ..engine.synthesis.table import Cell
    from ..identify.identification import DriveSet, StoredIdentification


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
        typer.Option(help="The drives it was identified from: makes Fig. 6 and bounds with the state exact."),
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
            "least worst mu over speed, instead of designing. For one Delta (S0, S1) only.",
        ),
    ] = False,
    largest_A_t: Annotated[
        bool, typer.Option("--largest-A-t", help="Search the largest A_t with mu < 1 at speeds looked at.")
    ] = False,
    table: Annotated[
        bool, typer.Option(help="Table II, Figs. 5 and 6 beside the controller, where there is one Delta.")
    ] = True,
    moving_speed: Annotated[
        bool,
        typer.Option(
            help="Search for proofs while the speed moves, which takes longest. Without, none is claimed."
        ),
    ] = True,
    present: Annotated[
        Path | None,
        typer.Option("--from", help="Present controller.json: kept where proved, or no better one is found."),
    ] = None,
    json_out: JsonOut = None,
    jobs: Jobs = 1,
) -> None:
    """Synthesise the scheduled controller, certify it as the core runs it, and compare structures (paper,
    step 8).

    Bounds that drives which did not set them refute are refused; the premise is printed beside mu.

    Exit 1 when robust performance (mu below 1) is not certified: at a speed, in a row of the case's table, or
    by any trade-off."""
    from ..control.controller_file import PresentController

    only_designed = largest_A_t or not (table and moving_speed) or jobs > 1 or present is not None
    if case is not None:
        vehicles = identification is not None or vehicle is not None or drives is not None
        others = vehicles or tradeoff or only_designed
        _refuse("--case", others, "a case file alone", "a vehicle, drives, --tradeoff, ")
        raise typer.Exit(_design_case(case, out, json_out))
    if tradeoff:
        _refuse("--tradeoff", only_designed, "none of them: nothing is designed")
    if identification is None or vehicle is None:
        raise InputError("design", "--vehicle, IDENTIFICATION", "missing", "both, or --case")
    stored, drive_set = _read(identification, vehicle, drives)
    if tradeoff:
        raise typer.Exit(_design_tradeoff(stored, drive_set, out, json_out))
    searched = {"table": table, "largest_A_t": largest_A_t, "moving_speed": moving_speed}
    before = None if present is None else PresentController.from_path(present, stored)
    raise typer.Exit(_design_vehicle(stored, drive_set, out, json_out, jobs, present=before, **searched))


def _refuse(option: str, is_set: bool, expected: str, more: str = "") -> None:
    """Raise InputError if an option is set beside options that ignore it."""
    if is_set:
        ignored = f"given with {more}--largest-A-t, --no-table, --no-moving-speed, --from or --jobs"
        raise InputError("design", option, ignored, expected)


def _read(
    identification: Path, vehicle: str, drives: Path | None
) -> tuple[StoredIdentification, DriveSet | None]:
    if drives is None:
        return stored_for(identification, vehicle), None
    return stored_with_drives(identification, drives, vehicle)


def _design_vehicle(
    stored: StoredIdentification,
    drive_set: DriveSet | None,
    out: Path,
    json_out: str | None,
    jobs: int,
    *,
    table: bool,
    largest_A_t: bool,
    moving_speed: bool,
    present: PresentController | None = None,
) -> int:
    """Design and certify a vehicle's controller, with Table II and the figures where ``table``, for frozen
    speeds alone without ``moving_speed``. Returns the exit status: 1 when mu is not certified below 1."""
    from ..control import design as stage
    from ..control.frozen import compared
    from ..control.plants import design_settings
    from ..identify.premise import premise

    cells: list[Cell] = []
    more: dict[str, str] = {}
    with_table = table and compared(stored)
    with progress_bar("design") as tell, workers(jobs) as run:
        weights = (*SHARES[:1], SHARES[1] if with_table else 0, SHARES[2] if largest_A_t else 0)
        designing, comparing, searching = parts(tell, *weights)
        result = stage.design(stored, designing, moving_speed, run, present)
        if with_table:
            cells, more = _table_and_figures(stored, drive_set, comparing)
        largest = stage.largest_A_t(stored, searching) if largest_A_t else None
        stage.save(result, stored, out, more, largest)
    rows = [
        {"v_mps": v, "mu_upper": p.upper, "mu_lower": p.lower, "peak_rad_s": p.bracket.peak_frequency}
        for v, p in result.certificates
    ]
    emit(json_out, rows)
    print_certificates(rows)
    if cells:
        print_cells(cells)
        if drive_set is None:
            console.print("Fig. 6 needs the drives: --drives")
    elif table:
        console.print(
            "Table II compares structures with one Delta for one input and two outputs: left out for this "
            "vehicle"
        )
    _print_design(result, design_settings(stored).structure, present)
    print_premise(premise(stored))
    if largest_A_t:
        print_largest_A_t(largest)
    print_moving_speed(result)
    print_robustness(result)
    print_slow_delta(result)
    print_limits(result)
    print_summary(stored.project.name, result, out)
    if not result.worst < 1:
        console.print(f"why: {stage.limit_sentence(stored, result)}")
    return 0 if result.worst < 1 else 1


def _print_design(result: Design, structure: str, present: PresentController | None) -> None:
    """Order and worst mu of a designed controller, on the grid of speeds and off it; whether it is the
    present one."""
    from ..control.design import OFF_GRID

    console.print(
        f"{structure}: {result.schedule.order} states (of {result.full_order} per speed before), "
        f"{len(result.schedule.speeds)} nodes; worst mu at most {result.worst:.4f}"
    )
    speed, worst = result.off_grid
    console.print(f"worst of {OFF_GRID} speeds off the grid: mu at most {worst.upper:.4f} at {speed:.4g} m/s")
    if present is not None:
        kept = result.schedule.digest() == present.schedule.digest()
        console.print("the present controller stays" if kept else "the present controller is replaced")


def _table_and_figures(
    stored: StoredIdentification, drive_set: DriveSet | None, tell: Progress
) -> tuple[list[Cell], dict[str, str]]:
    """Table II of a vehicle, and the files of table and figures; Fig. 6 needs the drives."""
    from ..control.design_files import design_files
    from ..control.frozen import FrozenProblem
    from ..control.stored_frames import StoredFrames
    from ..control.worst_run import worst_runs
    from ..report.design_pictures import drawn

    reading, comparing = parts(tell, *TABLE_SHARES)
    problem = FrozenProblem(stored, StoredFrames(stored, drive_set, reading))
    cells = problem.table(comparing)
    tell("worst-case runs")
    runs = None if drive_set is None else worst_runs(problem, cells, drive_set)
    files = design_files(problem, cells, runs)
    return cells, files | drawn(files)


def _design_tradeoff(
    stored: StoredIdentification, drive_set: DriveSet | None, out: Path, json_out: str | None
) -> int:
    """Search the trade-off and write it. Returns the exit status: 1 when no candidate is below 1."""
    from ..control.frozen import FrozenProblem
    from ..control.stored_frames import StoredFrames
    from ..control.tradeoff import search
    from ..report.design_pictures import drawn

    with progress_bar("trade-off") as tell:
        reading, searching = parts(tell, *TABLE_SHARES)
        tradeoff = search(FrozenProblem(stored, StoredFrames(stored, drive_set, reading)), searching)
        files = tradeoff.files()
        with artefacts.new_folder(out, "design-tradeoff", stored.project.name) as folder:
            artefacts.write_files(
                folder,
                files
                | drawn(files)
                | {
                    artefacts.MANIFEST: artefacts.manifest(
                        "design-tradeoff", vehicle=stored.project.name, identification=stored.manifest
                    )
                },
            )
    emit(json_out, artefacts.read_json(out / "tradeoff.json"))
    print_tradeoff(tradeoff)
    console.print(f"written to {out}")
    level = tradeoff.best.level
    return 0 if level is not None and level < 1 else 1


def _design_case(path: Path, out: Path, json_out: str | None) -> int:
    """Table II of a case file. Returns the exit status: 1 when a row is not certified below 1."""
    from ..control.design_files import case_files
    from ..engine.synthesis.cases import paper_case, read_case
    from ..report.design_pictures import drawn

    case = read_case(path)
    with progress_bar("design") as tell:
        rows = paper_case(path, progress=tell)
        tell("differences to the paper")
        files = case_files(path.name, case, rows)
        with artefacts.new_folder(out, "design-case") as folder:
            artefacts.write_files(
                folder,
                files
                | drawn(files)
                | {
                    artefacts.MANIFEST: artefacts.manifest(
                        "design-case", case=path.name, sha256=artefacts.file_hash(path)
                    )
                },
            )
    table = artefacts.read_json(out / "table2.json")["rows"]
    emit(json_out, table)
    print_case(rows, table)
    console.print(f"written to {out}")
    return 0 if all(r.upper < 1 for r in rows) else 1
