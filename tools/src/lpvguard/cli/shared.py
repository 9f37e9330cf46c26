"""What the verbs share: the application, options of one meaning, progress, files, and how an identification
is read."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from .. import __version__
from ..base import artefacts
from ..base.errors import InputError

_FILES = ("report", "solve", "dbc", "lcm bus", "plant")
"""Commands whose -o is a file."""
_KINDS = {"export": "vehicle", "design": None}
"""Kinds of folders that are not named as their command; design writes several."""
_running: list[str] = []
"""Name of the command that runs, as its outputs are marked."""


def _lcm_log(url: str | None) -> list[Path]:
    """The file that an LCM URL makes a log of."""
    return (
        [Path(url.removeprefix("file://").split("?")[0])]
        if url and url.startswith("file:") and "mode=w" in url
        else []
    )


def _named(name: str, given: dict[str, Any]) -> tuple[list[Path], list[Path], list[Path]]:
    """Folders and files that a command is asked to write, and every other path among its parameters."""
    folders, files, inputs = [], [], []
    for key, value in given.items():
        if key in ("out", "json_out"):
            if value is not None and str(value) != "-":
                (files if key == "json_out" or name in _FILES else folders).append(Path(value))
        elif key == "lcm":
            files += _lcm_log(value)
        elif isinstance(value, typer.Context):  # bench and plant read their options themselves
            for before, word in zip(["", *value.args], value.args, strict=False):
                option, _, rest = word.partition("=")
                if before in ("-o", "--json") or (option == "--json" and rest):
                    files += [Path(rest or word)] if (rest or word) != "-" else []
                elif Path(word).exists():
                    inputs.append(Path(word))
        else:
            # A text that is no path may also be a vehicle's name, a bus or an address.
            items = value if isinstance(value, list) else [value]
            inputs += [
                Path(v) for v in items if isinstance(v, Path) or (isinstance(v, str) and Path(v).is_file())
            ]
    return folders, [f for f in files if not f.exists() or f.is_file() or f.is_dir()], inputs


def _guarded(name: str, command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with outputs that are apart from its inputs (every other path), replace nothing but its
    own, and are its own while it runs. What is not so is refused before anything is done."""

    @wraps(command)
    def run(*arguments: Any, **given: Any) -> Any:
        folders, files, inputs = _named(name, given)
        kind = f"bench {given['name']}" if name == "bench" else name
        with ExitStack() as held:
            for path in inputs:
                artefacts.recover(path)
            if folders or files:
                artefacts.require_apart([*folders, *files], [*inputs, *_own_sources(name)])
            for target in folders:
                held.enter_context(artefacts.claimed(target))
                artefacts.require_replaceable_folder(
                    target, _KINDS.get(name, name), resumed=name == "campaign"
                )
            for target in files:
                held.enter_context(artefacts.claimed(target))
                if name != "lcm bus":  # a log has no room for a mark: its bytes decide, once they are known
                    artefacts.require_replaceable_file(target, kind)
            _running[:] = [kind]
            return command(*arguments, **given)

    return run


def _own_sources(command: str) -> list[Path]:
    """What is compiled or read without being named. The shipped folders are what `export` may write."""
    from ..core.compiled import PACKAGE, firmware_root, library_root

    library = library_root()
    found = [PACKAGE, *([library / "src", library / "include"] if command == "export" else [library])]
    try:
        return [*found, firmware_root()]
    except InputError:
        return found


class Application(typer.Typer):
    """Whose commands are all guarded."""

    prefix = ""

    def command(
        self, name: str | None = None, **options: Any
    ) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        def register(function: Callable[..., Any]) -> Callable[..., Any]:
            super(Application, self).command(name, **options)(
                _guarded(self.prefix + (name or function.__name__), function)
            )
            return function

        return register


app = Application(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="From recorded drives to a compiled monitor and controller. Exit status 0, 1 (a finding), 2 (bad input).",
)
# Away from a terminal nothing is known of the reader's width: keep rows whole.
console = Console(stderr=True, width=None if sys.stderr.isatty() else 160, soft_wrap=True)

Vehicle = Annotated[
    str, typer.Option("--vehicle", help="Shipped vehicle, or path to a project file (*.toml).")
]
Out = Annotated[Path, typer.Option("-o", "--out", help="Folder or file to write.")]
JsonOut = Annotated[str | None, typer.Option("--json", help="Write JSON to this file; - is standard output.")]
Jobs = Annotated[int, typer.Option(min=1, help="Processes of this machine that share the drives.")]
Scheduler = Annotated[
    str | None, typer.Option(help="Address of a Dask scheduler whose workers share the drives.")
]
LCM_DEFAULT = "udpm://239.255.76.67:7667?ttl=0"
Coefficients = Annotated[
    Path | None, typer.Option("--coefficients", help="Generated folder (default: the shipped one).")
]


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[str], None]]:
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda text: bar.update(task, description=f"{title}: {text}")


def emit(json_out: str | None, value: Any, *, each: bool = False) -> None:
    if json_out:
        artefacts.write_json(json_out, value, _running[0], each=each)


def project_of(vehicle: str):
    from ..vehicle.project import load_project

    return load_project(vehicle)


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        print(f"lpvguard {__version__}")
        raise typer.Exit()


def design_vehicle(stored, drive_set, table: bool, largest_A_t: bool, out: Path, json_out: str | None) -> int:
    from ..control import design as stage

    cells = []
    with progress_bar("design") as tell:
        result = stage.design(stored, tell)
        more = {}
        if table:
            from ..control.design_files import design_files
            from ..control.frozen import FrozenProblem
            from ..control.stored_frames import StoredFrames
            from ..control.worst_run import worst_runs
            from ..report.design_pictures import drawn

            problem = FrozenProblem(stored, StoredFrames(stored, drive_set, tell))
            cells = problem.table(tell)
            tell("worst-case runs")
            more = design_files(
                problem, cells, None if drive_set is None else worst_runs(problem, cells, drive_set)
            )
            more |= drawn(more)
        largest = stage.largest_A_t(stored, tell) if largest_A_t else None
        stage.save(result, stored, out, more, largest)
    rows = [
        {"v_mps": v, "mu_upper": p.upper, "mu_lower": p.lower, "peak_rad_s": p.bracket.peak_frequency}
        for v, p in result.certificates
    ]
    emit(json_out, rows)
    speeds = Table("v m/s", "mu upper", "mu lower", "peak rad/s", box=None)
    for row in rows:
        speeds.add_row(
            f"{row['v_mps']:.4g}",
            f"{row['mu_upper']:.4f}",
            f"{row['mu_lower']:.4f}",
            f"{row['peak_rad_s']:.3g}",
        )
    console.print(speeds)
    if cells:
        _show_cells(cells)
        if drive_set is None:
            console.print("Fig. 6 needs the drives: --drives")
    worst = result.worst
    console.print(
        f"{stored.project.design.structure}: {result.schedule.order} states (of {result.full_order} per "
        f"speed before), {len(result.schedule.speeds)} nodes; worst mu {worst:.4f}; written to {out}"
    )
    console.print(
        f"worst of {stage.OFF_GRID} speeds off the grid: mu {result.off_grid[1].upper:.4f} at {result.off_grid[0]:.4g} m/s"
    )
    if largest_A_t:
        console.print(
            "largest A_t: none with mu < 1 from half the DC floor's limit on"
            if largest is None
            else f"largest A_t with mu < 1 at every speed: {largest.A_t:.4g}, times the DC floor {largest.product:.3f} "
            f"(mu {largest.worst:.4f}; not reached at {largest.failed:.4g})"
        )
    console.print(
        "moving speed: "
        + (
            "no storage function was found, nothing is claimed"
            if result.lpv is None
            else f"gain below 1 proved for |dv/dt| up to {result.lpv.rate:.3g} m/s2, {result.lpv.proof.cells} cells"
        )
    )
    return 0 if worst < 1 else 1


def design_tradeoff(stored, drive_set, out: Path, json_out: str | None) -> int:
    from ..control.frozen import FrozenProblem
    from ..control.stored_frames import StoredFrames
    from ..control.tradeoff import search
    from ..report.design_pictures import drawn

    with progress_bar("trade-off") as tell:
        found = search(FrozenProblem(stored, StoredFrames(stored, drive_set, tell)), tell)
        files = found.files()
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
    shown = Table("structure", "nu low", "nu high", "lambda_s", "worst mu", "none below", box=None)
    for o in found.outcomes:
        c = o.candidate
        shown.add_row(
            c.structure + (" (project)" if c.own else ""),
            f"{o.ceiling[1]:.3g}",
            f"{o.ceiling[-1]:.3g}",
            "–" if c.lambda_s is None else f"{c.lambda_s:.3g}",
            "–" if o.level is None else f"{o.level:.4f}",
            f"{o.floor.value:.4f}",
        )
    console.print(shown)
    console.print(found.sentence)
    for key, value in found.setting().items():
        console.print(f"to take it, write into the project file {key} = {_toml(value)} and identify again")
    console.print(f"written to {out}")
    return 0 if found.best.level < 1 else 1


def _show_cells(cells) -> None:
    """Table II on the console, with the times that no file holds."""
    shown = Table(
        "Table II", "A_t", "A_u", "mu upper", "mu lower", "none below", "order", "before", "time s", box=None
    )
    for c in cells:
        shown.add_row(
            c.structure,
            f"{c.A_t:.4g}",
            f"{c.A_u:.2g}",
            f"{c.upper:.5f}",
            f"{c.lower:.5f}",
            f"{c.floor.value:.5f}",
            str(c.order),
            str(c.full_order),
            f"{c.seconds:.2f}",
        )
    console.print(shown)


def design_case(path: Path, out: Path, json_out: str | None) -> int:
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
    _show_cells(rows)
    known = Table("Table II", "A_t", "A_u", "ours", "reference", "order", "paper", "order", box=None)
    number = lambda x: "–" if x is None else f"{x:g}"
    for r in rows:
        known.add_row(
            r.structure,
            f"{r.A_t:.4g}",
            f"{r.A_u:.2g}",
            f"{r.upper:.5f}",
            number(r.reference),
            number(r.reference_order),
            number(r.paper),
            number(r.paper_order),
        )
    console.print(known)
    for row in table:
        console.print(f"{row['structure']}, A_t {row['A_t']:g}, A_u {row['A_u']:g}: {row['difference']}")
    console.print(f"written to {out}")
    return 0 if all(r.upper < 1 for r in rows) else 1


def print_campaign(summary: dict[str, Any]) -> None:
    from ..evaluate.run import COUNTS_ONLY

    within, detectors = summary["within"], summary["detectors"]
    console.print(
        f"{within['hours']:.1f} h of {within['plants']} trucks within the bounds by their own frequency response (of {within['candidates']} drawn)"
    )
    rates = Table("test", "runs that alarm", "calibrated", "such runs an hour", "calibrated", box=None)
    for test, seen in within["tests"].items():
        calibrated, hourly = summary["calibrated"][test], seen["per_hour"]
        interval = (
            ""
            if hourly["interval"] is None
            else f"{hourly['rate']:.2f} ({hourly['interval'][0]:.2f} .. {hourly['interval'][1]:.2f})"
        )
        stated = (
            ("not stated", "")
            if calibrated["alpha"] is None
            else (f"{calibrated['alpha']:.2%}", f"{calibrated['per_hour']:.2f}")
        )
        rates.add_row(test, _rate(seen), stated[0], interval, stated[1])
    console.print(rates)
    console.print(f"apart, with more demand than was checked: {_rate(within['beyond_checked_amplitude'])}")
    table = Table("", *detectors.values(), box=None)
    for title, of in (
        ("runs within the bounds that alarm", within["alarmed"]),
        ("visible faults found in time", summary["visible"]),
    ):
        table.add_row(title, *(_rate(of[d]) for d in detectors))
    matched, stated = summary["matched_claim"], summary["matched_stated"]
    for title, key in (("average found", "calibrated"), (f"average found, {matched}", "matched")):
        table.add_row(title, *(f"{summary['average'][d][key]:.1%}" for d in detectors))
    table.add_row(
        "at the latter thresholds a further run alarms",
        *(COUNTS_ONLY if stated[d] is None else f"at most {stated[d]:.3g}" for d in detectors),
    )
    console.print(table)
    kinds = Table(
        f"average over severities: calibrated; {matched}", *detectors.values(), f"best, {matched}", box=None
    )
    for k in summary["kinds"]:
        kinds.add_row(
            k["kind"],
            *(f"{k['found'][d]:.0%}, {k['matched'][d]:.0%}" for d in detectors),
            ", ".join(detectors[d] for d in k["best_matched"]),
        )
    console.print(kinds)
    for b in summary["beaten"]:
        console.print(
            f"a baseline wins, {matched}: {detectors[b['detector']]} on {b['kind']}, {b['matched']:.0%} against {b['monitor']:.0%}"
        )
    for s in summary["invisible"]:
        console.print(
            f"invisible, though {'mu is ' + format(s['mu_upper'], '.2f') if s['loop_stable'] else 'the loop is unstable'}: "
            f"{s['kind']} {s['severity']:g} {summary['units'][s['kind']]}, found {s['found']['monitor']} of {s['runs']}"
        )
    bus = Table(
        "fault of the bus, by severity",
        "runs as required",
        "reactions met",
        "not live",
        "judged",
        "alarmed, visible runs",
        box=None,
    )
    for kind in dict.fromkeys(s["kind"] for s in summary["bus"]):
        rows = [s for s in summary["bus"] if s["kind"] == kind]
        severities = ", ".join(f"{s['severity']:g}" for s in rows)
        bus.add_row(
            f"{kind}: {severities} {summary['units'][kind]}",
            _of(rows, "as_required", "runs"),
            _of(rows, "met", "due"),
            *(f"{min(s[k] for s in rows):.0%} .. {max(s[k] for s in rows):.0%}" for k in ("away", "judged")),
            f"{sum(s['alarmed']['monitor'] for s in rows)}, {sum(s['visible_runs'] for s in rows)}",
        )
    console.print(bus)
    for which, said in summary["supervision"].items():
        console.print(
            f"supervision of a {which} bus as its frames require: {_rate(said['as_required'])} runs; "
            f"of {said['due']} reactions due {said['met']} at the very tick"
        )
    for text in summary["missed"]:
        console.print(f"missed: {text}")


def _of(rows: list[dict], count: str, of: str) -> str:
    return f"{sum(r[count] for r in rows)} of {sum(r[of] for r in rows)}"


def _rate(rate: dict) -> str:
    return f"{rate['count']} of {rate['of']}" + (
        "" if rate["interval"] is None else f" ({rate['interval'][0]:.2%} .. {rate['interval'][1]:.2%})"
    )


def _toml(value: Any) -> str:
    return (
        "{ " + ", ".join(f"{k} = {v}" for k, v in value.items()) + " }"
        if isinstance(value, dict)
        else f"{value:g}"
    )


def replayer_of(vehicle: str, coefficients: Path | None):
    from ..core.compiled import Core, shipped_vehicle
    from ..drives.frames import require_core
    from ..replay.run import Replayer

    project = project_of(vehicle)
    require_core(project)
    folder = coefficients or shipped_vehicle(project.name)
    require_settings(artefacts.read_manifest(folder, "vehicle")["project"], folder, project, vehicle)
    return Replayer(project, Core(folder))


def require_settings(stored: dict[str, Any], where: Path, project, vehicle: object) -> None:
    """InputError naming the first setting in which the project file is not the one that ``where`` was made
    with. All count but the title, of which nothing is computed."""
    given = json.loads(artefacts.to_json(project.model_dump(by_alias=True)))
    differs = artefacts.first_difference({**stored, "title": None}, {**given, "title": None})
    if differs is not None:
        setting, old, new = differs
        raise InputError(
            setting,
            "",
            f"{json.dumps(old)} in {where}, {json.dumps(new)} in {vehicle}",
            "the settings that it was made with, or made anew with these",
        )


def stored_for(identification: Path, vehicle: str):
    from ..identify import run as stage

    stored, project = stage.load(identification), project_of(vehicle)
    if stored.project.name != project.name:
        raise InputError(identification, "vehicle", stored.project.name, f"an identification of {vehicle}")
    require_settings(artefacts.read_json(identification / "project.json"), identification, project, vehicle)
    return stored


def stored_with_drives(identification: Path, folder: Path, vehicle: str | None = None):
    """The identification and the drives that it was made from. ``vehicle`` None: of whatever vehicle."""
    from ..drives.tables import list_experiments
    from ..identify import run as stage
    from ..vehicle.nominal import NominalModel

    stored = stage.load(identification) if vehicle is None else stored_for(identification, vehicle)
    experiments = list_experiments(folder)
    for e in experiments:
        if stored.manifest["sha256"].get(e.name) != artefacts.file_hash(e.path):
            raise InputError(
                e.path, "", "is not the file that was identified", f"the drives of {identification}"
            )
    return stored, stage.DriveSet(stored.project, NominalModel(stored.project), experiments)


def complain(error: InputError) -> None:
    print(f"lpvguard: error: {error}", file=sys.stderr)
