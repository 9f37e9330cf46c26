"""The command line. Exit status: 0 done, 1 a finding (falsified, alarmed, an answer missed), 2 bad input.

Results that machines read go to the file named with --json (``-``: standard output); progress and messages go to
standard error. Nothing is written except where -o or --json says.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from functools import partial, wraps
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from . import __version__, artefacts
from .errors import InputError

_FILES = ("report", "solve", "dbc", "lcm bus", "plant")
"""Commands whose -o is a file."""
_KINDS = {"export": "vehicle", "design": None}
"""Kinds of folders that are not named as their command; design writes several."""
_running: list[str] = []
"""Name of the command that runs, as its outputs are marked."""


def _lcm_log(url: str | None) -> list[Path]:
    """The file that an LCM URL makes a log of."""
    return [Path(url.removeprefix("file://").split("?")[0])] if url and url.startswith("file:") and "mode=w" in url else []


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
            for before, word in zip(["", *value.args], value.args):
                option, _, rest = word.partition("=")
                if before in ("-o", "--json") or option == "--json" and rest:
                    files += [Path(rest or word)] if (rest or word) != "-" else []
                elif Path(word).exists():
                    inputs.append(Path(word))
        else:
            # A text that is no path may also be a vehicle's name, a bus or an address.
            items = value if isinstance(value, list) else [value]
            inputs += [Path(v) for v in items if isinstance(v, Path) or (isinstance(v, str) and Path(v).is_file())]
    return folders, [f for f in files if not f.exists() or f.is_file() or f.is_dir()], inputs


def _guarded(name: str, command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with outputs that are apart from its inputs (every other path), replace nothing but its own, and are its own
    while it runs. What is not so is refused before anything is done."""

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
                artefacts.require_replaceable_folder(target, _KINDS.get(name, name), resumed=name == "campaign")
            for target in files:
                held.enter_context(artefacts.claimed(target))
                if name != "lcm bus":  # a log has no room for a mark: its bytes decide, once they are known
                    artefacts.require_replaceable_file(target, kind)
            _running[:] = [kind]
            return command(*arguments, **given)

    return run


def _own_sources(command: str) -> list[Path]:
    """What is compiled or read without being named. The shipped folders are what `export` may write."""
    from .core import PACKAGE, firmware_root, library_root

    library = library_root()
    found = [PACKAGE, *([library / "src", library / "include"] if command == "export" else [library])]
    try:
        return [*found, firmware_root()]
    except InputError:
        return found


class _Application(typer.Typer):
    """Whose commands are all guarded."""

    prefix = ""

    def command(self, name: str | None = None, **options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        def register(function: Callable[..., Any]) -> Callable[..., Any]:
            super(_Application, self).command(name, **options)(_guarded(self.prefix + (name or function.__name__), function))
            return function

        return register


app = _Application(add_completion=False, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False,
                  context_settings={"help_option_names": ["-h", "--help"]},
                  help="From recorded drives to a compiled monitor and controller. Exit status 0, 1 (a finding), 2 (bad input).")
# Away from a terminal nothing is known of the reader's width: keep rows whole.
console = Console(stderr=True, width=None if sys.stderr.isatty() else 160, soft_wrap=True)

Vehicle = Annotated[str, typer.Option("--vehicle", help="Shipped vehicle, or path to a project file (*.toml).")]
Out = Annotated[Path, typer.Option("-o", "--out", help="Folder or file to write.")]
JsonOut = Annotated[str | None, typer.Option("--json", help="Write JSON to this file; - is standard output.")]
Jobs = Annotated[int, typer.Option(min=1, help="Processes of this machine that share the drives.")]
Scheduler = Annotated[str | None, typer.Option(help="Address of a Dask scheduler whose workers share the drives.")]
LCM_DEFAULT = "udpm://239.255.76.67:7667?ttl=0"
Coefficients = Annotated[Path | None, typer.Option("--coefficients", help="Generated folder (default: the shipped one).")]


@contextmanager
def _progress(title: str) -> Iterator[Callable[[str], None]]:
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(bar_width=20), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda text: bar.update(task, description=f"{title}: {text}")


def _emit(json_out: str | None, value: Any, *, each: bool = False) -> None:
    if json_out:
        artefacts.write_json(json_out, value, _running[0], each=each)


def _load_project(vehicle: str):
    from .project import load_project

    return load_project(vehicle)


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        print(f"lpvguard {__version__}")
        raise typer.Exit()


@app.command(epilog="Example: lpvguard generate --vehicle g80 -o out/drives --seed 1")
def generate(vehicle: Vehicle, out: Out,
             seed: Annotated[int | None, typer.Option(help="Seed (default: the project file's).")] = None) -> None:
    """Write seeded synthetic drives of a vehicle: tables and experiments.csv."""
    from .generate import generate as run

    project = _load_project(vehicle)
    with _progress("generate") as tell:
        count = run(project, out, project.seed if seed is None else seed, tell)
    console.print(f"{count} drives written to {out}")


@app.command(epilog="Example: lpvguard plant frequency-response", context_settings={
    "allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []})
def plant(context: typer.Context) -> None:
    """Run the simulated truck's own tool: its frequency response against Table I, single experiments, a digest."""
    from .generate import plant_tool

    words = list(context.args)
    at = words.index("-o") + 1 if "-o" in words[:-1] else None
    with nullcontext() if at is None else artefacts.new_file(Path(words[at]), "plant") as scratch:
        if at is not None:
            words[at] = scratch
        status = subprocess.run([plant_tool(), *words], check=False).returncode
        if at is None or status:
            raise typer.Exit(status)


@app.command(epilog="Example: lpvguard ingest drive.log --dbc car.dbc --signals map.toml -o out/drives")
def ingest(logs: Annotated[list[Path], typer.Argument(help="candump (-l, -L, .gz), ASC, BLF, TRC, MF4, CSV or Parquet.")],
           out: Out,
           dbc: Annotated[Path | None, typer.Option(help="CAN database (default: our own J1939 one).")] = None,
           signals: Annotated[Path | None, typer.Option(help="Signal map (TOML).")] = None,
           vehicle: Annotated[str | None, typer.Option("--vehicle", help="Take the signal map from this vehicle.")] = None,
           json_out: JsonOut = None) -> None:
    """Turn logs into uniform drive tables, with a report of what was left out and why. Needs no model."""
    from .ingest import ingest as run
    from .ingest import map_of_project

    if (signals is None) == (vehicle is None):
        raise InputError("ingest", "--signals, --vehicle", "both or neither given", "exactly one of them")
    with _progress("ingest"):
        report = run(logs, dbc=dbc, signals_map=signals or map_of_project(_load_project(vehicle)), out=out)
    _emit(json_out, report, each=True)
    console.print(f"{len(logs)} log(s) read; tables and reports written to {out}")


@app.command(epilog="Example: lpvguard dbc -o lpvguard.dbc; candump -L vcan0 | .venv/bin/cantools decode -s lpvguard.dbc")
def dbc(out: Annotated[Path | None, typer.Option("-o", "--out", help="File to write (default: standard output).")] = None) -> None:
    """Write the CAN database of our bus (DBC), for any tool that shows or sends decoded traffic."""
    from .can.dbc import dbc_text

    if out is None:
        sys.stdout.write(dbc_text())
    else:
        artefacts.write_file(out, dbc_text(), "dbc")


@app.command(epilog="Example: lpvguard identify --vehicle g80 DRIVES -o out/identify")
def identify(vehicle: Vehicle, drives: Annotated[Path, typer.Argument(help="Folder of drives with experiments.csv.")],
             out: Out, json_out: JsonOut = None, jobs: Jobs = 1, scheduler: Scheduler = None) -> None:
    """Find the unfalsified bounds, fit the weights, calibrate the frame test (paper, steps 1-7)."""
    from . import identify as stage
    from .parallel import workers

    project = _load_project(vehicle)
    with _progress("identify") as tell, workers(jobs, scheduler) as run:
        result, drive_set = stage.identify(project, drives, workers=run, progress=tell)
        stage.save(result, drive_set, out)
    _emit(json_out, {"bound_drives": result.bound_drives, "calibration_drives": result.calibration_drives,
                     "left_out": result.left_out, **result.calibration.to_dict(), "inflation": result.weights.inflation,
                     "energy": result.energy.to_dict() if result.energy else None})
    c = result.calibration
    console.print(f"{len(result.bound_drives)} drives set the bounds: {', '.join(result.bound_drives)}")
    console.print(f"{len(result.calibration_drives)} others calibrate: {', '.join(result.calibration_drives) or 'none'}")
    for name, reason in result.left_out.items():
        console.print(f"left out: {name}: {reason}")
    if result.energy is not None:
        console.print(f"energy test: threshold {result.energy.calibration.threshold:.4g} ({result.energy.calibration.claim()}), sigma "
                      + result.energy.sigma_text(project))
    console.print(f"threshold {c.threshold:.4g} ({c.claim()}); final inflation {result.weights.inflation:.6g}; written to {out}")


@app.command(epilog="""Examples: lpvguard design --vehicle truck out/identify --drives out/drives -o out/design

lpvguard design --vehicle truck out/identify --drives out/drives --tradeoff -o out/tradeoff

lpvguard design --case paper_case.toml -o out/paper""")
def design(out: Out, identification: Annotated[Path | None, typer.Argument(help="Folder written by identify.")] = None,
           vehicle: Annotated[str | None, typer.Option("--vehicle", help="Shipped vehicle, or path to a project file.")] = None,
           drives: Annotated[Path | None, typer.Option(help="The drive folder it was identified from: makes Fig. 6 and the "
                                                            "state uncertainty's bounds exact.")] = None,
           case: Annotated[Path | None, typer.Option(help="Table II of a case file with every weight frozen, instead of a "
                                                          "vehicle's.")] = None,
           tradeoff: Annotated[bool, typer.Option("--tradeoff", help="Search the ceiling on nu, gamma_w and Lambda_nu for the "
                                                                     "least worst mu over speed, instead of designing.")] = False,
           largest_A_t: Annotated[bool, typer.Option("--largest-A-t", help="Search the largest A_t with mu < 1 at every speed too.")] = False,
           table: Annotated[bool, typer.Option(help="Table II, Figs. 5 and 6 beside the controller.")] = True,
           json_out: JsonOut = None) -> None:
    """Synthesise the scheduled controller, certify it as the core runs it, and compare structures (paper, step 8).

    Exit 1 when robust performance (mu below 1) is not certified: at a speed, in a row of the case's table, or by any trade-off."""
    if case is not None:
        if identification is not None or vehicle is not None or drives is not None or tradeoff or largest_A_t or not table:
            raise InputError("design", "--case", "given with a vehicle, drives, --tradeoff, --largest-A-t or --no-table",
                             "a case file alone")
        raise typer.Exit(_design_case(case, out, json_out))
    if tradeoff and (largest_A_t or not table):
        raise InputError("design", "--tradeoff", "given with --largest-A-t or --no-table", "neither: nothing is designed")
    if identification is None or vehicle is None:
        raise InputError("design", "--vehicle, IDENTIFICATION", "missing", "both, or --case")
    stored, drive_set = (_stored(identification, vehicle), None) if drives is None else _stored_with_drives(identification, drives, vehicle)
    if tradeoff:
        raise typer.Exit(_design_tradeoff(stored, drive_set, out, json_out))
    raise typer.Exit(_design_vehicle(stored, drive_set, table, largest_A_t, out, json_out))


def _design_vehicle(stored, drive_set, table: bool, largest_A_t: bool, out: Path, json_out: str | None) -> int:
    from . import design as stage

    cells = []
    with _progress("design") as tell:
        result = stage.design(stored, tell)
        more = {}
        if table:
            from .design_files import design_files
            from .design_pictures import drawn
            from .frozen import FrozenProblem
            from .stored_frames import StoredFrames
            from .worst_run import worst_runs

            problem = FrozenProblem(stored, StoredFrames(stored, drive_set, tell))
            cells = problem.table(tell)
            tell("worst-case runs")
            more = design_files(problem, cells, None if drive_set is None else worst_runs(problem, cells, drive_set))
            more |= drawn(more)
        largest = stage.largest_A_t(stored, tell) if largest_A_t else None
        stage.save(result, stored, out, more, largest)
    rows = [{"v_mps": v, "mu_upper": p.upper, "mu_lower": p.lower, "peak_rad_s": p.bracket.peak_frequency}
            for v, p in result.certificates]
    _emit(json_out, rows)
    speeds = Table("v m/s", "mu upper", "mu lower", "peak rad/s", box=None)
    for row in rows:
        speeds.add_row(f"{row['v_mps']:.4g}", f"{row['mu_upper']:.4f}", f"{row['mu_lower']:.4f}", f"{row['peak_rad_s']:.3g}")
    console.print(speeds)
    if cells:
        _show_cells(cells)
        if drive_set is None:
            console.print("Fig. 6 needs the drives: --drives")
    worst = result.worst
    console.print(f"{stored.project.design.structure}: {result.schedule.order} states (of {result.full_order} per "
                  f"speed before), {len(result.schedule.speeds)} nodes; worst mu {worst:.4f}; written to {out}")
    console.print(f"worst of {stage.OFF_GRID} speeds off the grid: mu {result.off_grid[1].upper:.4f} at {result.off_grid[0]:.4g} m/s")
    if largest_A_t:
        console.print("largest A_t: none with mu < 1 from half the DC floor's limit on" if largest is None else
                      f"largest A_t with mu < 1 at every speed: {largest.A_t:.4g}, times the DC floor {largest.product:.3f} "
                      f"(mu {largest.worst:.4f}; not reached at {largest.failed:.4g})")
    console.print("moving speed: " + ("no storage function was found, nothing is claimed" if result.lpv is None else
                  f"gain below 1 proved for |dv/dt| up to {result.lpv.rate:.3g} m/s2, {result.lpv.proof.cells} cells"))
    return 0 if worst < 1 else 1


def _design_tradeoff(stored, drive_set, out: Path, json_out: str | None) -> int:
    from .design_pictures import drawn
    from .frozen import FrozenProblem
    from .stored_frames import StoredFrames
    from .tradeoff import search

    with _progress("trade-off") as tell:
        found = search(FrozenProblem(stored, StoredFrames(stored, drive_set, tell)), tell)
        files = found.files()
        with artefacts.new_folder(out, "design-tradeoff", stored.project.name) as folder:
            artefacts.write_files(folder, files | drawn(files) | {artefacts.MANIFEST: artefacts.manifest(
                "design-tradeoff", vehicle=stored.project.name, identification=stored.manifest)})
    _emit(json_out, artefacts.read_json(out / "tradeoff.json"))
    shown = Table("structure", "nu low", "nu high", "lambda_s", "worst mu", "none below", box=None)
    for o in found.outcomes:
        c = o.candidate
        shown.add_row(c.structure + (" (project)" if c.own else ""), f"{o.ceiling[1]:.3g}", f"{o.ceiling[-1]:.3g}",
                      "–" if c.lambda_s is None else f"{c.lambda_s:.3g}", "–" if o.level is None else f"{o.level:.4f}", f"{o.floor.value:.4f}")
    console.print(shown)
    console.print(found.sentence)
    for key, value in found.setting().items():
        console.print(f"to take it, write into the project file {key} = {_toml(value)} and identify again")
    console.print(f"written to {out}")
    return 0 if found.best.level < 1 else 1


def _show_cells(cells) -> None:
    """Table II on the console, with the times that no file holds."""
    shown = Table("Table II", "A_t", "A_u", "mu upper", "mu lower", "none below", "order", "before", "time s", box=None)
    for c in cells:
        shown.add_row(c.structure, f"{c.A_t:.4g}", f"{c.A_u:.2g}", f"{c.upper:.5f}", f"{c.lower:.5f}", f"{c.floor.value:.5f}",
                      str(c.order), str(c.full_order), f"{c.seconds:.2f}")
    console.print(shown)


def _design_case(path: Path, out: Path, json_out: str | None) -> int:
    from .design_files import case_files
    from .design_pictures import drawn
    from .synthesis.cases import paper_case, read_case

    case = read_case(path)
    with _progress("design") as tell:
        rows = paper_case(path, progress=tell)
        tell("differences to the paper")
        files = case_files(path.name, case, rows)
        with artefacts.new_folder(out, "design-case") as folder:
            artefacts.write_files(folder, files | drawn(files) | {artefacts.MANIFEST: artefacts.manifest(
                "design-case", case=path.name, sha256=artefacts.file_hash(path))})
    table = artefacts.read_json(out / "table2.json")["rows"]
    _emit(json_out, table)
    _show_cells(rows)
    known = Table("Table II", "A_t", "A_u", "ours", "reference", "order", "paper", "order", box=None)
    number = lambda x: "–" if x is None else f"{x:g}"
    for r in rows:
        known.add_row(r.structure, f"{r.A_t:.4g}", f"{r.A_u:.2g}", f"{r.upper:.5f}", number(r.reference), number(r.reference_order),
                      number(r.paper), number(r.paper_order))
    console.print(known)
    for row in table:
        console.print(f"{row['structure']}, A_t {row['A_t']:g}, A_u {row['A_u']:g}: {row['difference']}")
    console.print(f"written to {out}")
    return 0 if all(r.upper < 1 for r in rows) else 1


@app.command(epilog="Example: lpvguard export --vehicle g80 out/identify -o lib/vehicles/g80")
def export(vehicle: Vehicle, identification: Annotated[Path, typer.Argument(help="Folder written by identify.")],
           out: Out, controller: Annotated[Path | None, typer.Option(help="controller.json, or the folder written by design.")]
           = None) -> None:
    """Generate the C folder of a vehicle: coefficients, controller, signal table, CAN codec, manifest."""
    from .control_export import load_controller
    from .design import verify
    from .export import export_vehicle

    stored = _stored(identification, vehicle)
    if controller is not None and controller.is_dir():
        controller = controller / "controller.json"
    if controller is not None:
        verify(controller, stored)
    export_vehicle(stored, out, load_controller(controller) if controller else None)
    console.print(f"{stored.project.name}: written to {out}")


@app.command(epilog="Examples: lpvguard replay --vehicle g80 RUN.csv --json -; lpvguard replay --vehicle truck RUN.log --to socketcan:vcan0")
def replay(vehicle: Vehicle,
           logs: Annotated[list[Path], typer.Argument(help="Drive tables (CSV or Parquet), or raw CAN logs of the vehicle's bus.")],
           coefficients: Coefficients = None, json_out: JsonOut = None, jobs: Jobs = 1, scheduler: Scheduler = None,
           channel: Annotated[str | None, typer.Option(help="Interface of a raw log with several.")] = None,
           to: Annotated[str | None, typer.Option("--to", metavar="socketcan:INTERFACE", help="Play onto this bus and judge nothing.")] = None,
           speed: Annotated[float | None, typer.Option(help="With --to: times the recorded pace; inf does not wait (default 1).")] = None,
           ) -> None:
    """Run recorded drives through the compiled C core. Exit 1 when any drive alarmed, 2 when any was unreadable.

    Raw logs go through the CAN receiver of the core; "can" in the JSON says what became of the frames, and where samples lack.
    """
    if to is not None:
        _play(_load_project(vehicle), logs, to, 1.0 if speed is None else speed, channel)
        return
    if speed is not None:
        raise InputError("replay", "--speed", "given without --to", "a bus to play onto")
    from .parallel import workers

    replayer = _replayer(vehicle, coefficients)
    done: list[dict[str, Any]] = []
    failed = 0
    with _progress("replay") as tell, workers(jobs, scheduler) as run:
        for log, result in zip(logs, run(partial(replayer.summarise_file, channel=channel), [log.absolute() for log in logs])):
            tell(log.name)
            if isinstance(result, InputError):
                failed += 1
                _complain(result)
            else:
                done.append(result)
    if done and not any(r["judged_s"] for r in done):
        failed += 1
        low, high = replayer.model.speed_range
        _complain(InputError(", ".join(r["run"] for r in done), "", "no judged stretch at all",
                             f"some steady driving between {low:g} and {high:g} m/s"))
    _emit(json_out, done)
    table = Table("drive", "duration s", "judged s", "verdict", "first invalid s", "max margin", "max energy ratio", "alarms", box=None)
    for r in done:
        table.add_row(r["run"], f"{r['duration_s']:.1f}", f"{r['judged_s']:.1f}", r["verdict_final"],
                      "–" if r["first_invalid_s"] is None else f"{r['first_invalid_s']:.2f}",
                      "–" if r["max_margin"] is None else f"{r['max_margin']:.3f}",
                      "–" if r["max_energy_ratio"] is None else f"{r['max_energy_ratio']:.3f}", str(len(r["alarms"])))
    console.print(table)
    console.print(f"thresholds: frame test {replayer.threshold:.4g}, energy test {replayer.energy_threshold:.4g}; core {replayer.core.folder}")
    for r in done:
        for a in r["alarms"][:3]:
            console.print(f"{r['run']}: t = {a['t_s']:.2f} s, {_alarm(a)}; a dead vehicle would read {a['evidence']:.2f}")
        if len(r["alarms"]) > 3:
            console.print(f"{r['run']}: {len(r['alarms']) - 3} more alarms (--json lists all)")
        if "can" in r:
            _print_reception(r["run"], r["can"])
    raise typer.Exit(2 if failed else 1 if any(r["alarms"] for r in done) else 0)


@app.command(epilog="Examples: lpvguard sim nominal yaw_sign --json -\n\ntools/with-vcan lpvguard sim nominal --bus socketcan:vcan0 --target cortex-r5f")
def sim(scenarios: Annotated[list[str], typer.Argument(help="Shipped scenarios, or paths to scenario files (*.toml).")],
        vehicle: Annotated[str, typer.Option("--vehicle", help="Shipped vehicle with a controller.")] = "truck",
        coefficients: Coefficients = None,
        bus: Annotated[str, typer.Option(help="What carries the CAN frames: memory, or socketcan:INTERFACE.")] = "memory",
        ecu_process: Annotated[bool, typer.Option("--ecu-process", help="Run the firmware as a process of its own (with --bus socketcan).")] = False,
        target: Annotated[str, typer.Option(help="Whose instructions the firmware runs on: host, or cortex-r5f in QEMU with its own CAN "
                                            "controller (with --bus socketcan).")] = "host",
        pace: Annotated[float | None, typer.Option(min=1e-3, max=1e3, help="At most so many times real time (default: as fast as it goes).")] = None,
        controller: Annotated[Literal["designed", "feedforward", "off"], typer.Option(
            help="feedforward: the command over the model's DC gain; off: never engaged.")] = "designed",
        seed: Annotated[int | None, typer.Option(min=0, help="First seed (default: the scenario's).")] = None,
        seeds: Annotated[int, typer.Option(min=1, help="Runs of each scenario, with consecutive seeds.")] = 1,
        lcm: Annotated[str | None, typer.Option(metavar="URL", help="Publish telemetry there and take commands, as LCM reads it.")] = None,
        paused: Annotated[bool, typer.Option("--paused", help="Begin when a client says resume (with --lcm).")] = False,
        out: Annotated[Path | None, typer.Option("-o", "--out", help="Folder for frame logs (candump -L), telemetry and results.json.")] = None,
        json_out: JsonOut = None) -> None:
    """Close the loop with the simulated truck over CAN frames. Exit 1 when a run did not show what its scenario expects."""
    from .core import shipped_vehicle
    from .sim import Simulator, load_scenario

    if paused and (lcm is None or lcm.startswith("file:")):
        raise InputError("--paused", "", f"no client can reach --lcm {lcm}", "--lcm with a URL such as " + LCM_DEFAULT)
    loaded = [load_scenario(name) for name in scenarios]
    runs = []
    with _progress("sim") as tell:
        tell("compiling")
        simulator = Simulator(coefficients or shipped_vehicle(vehicle), controller=controller, lcm=lcm is not None)
        with nullcontext() if out is None else artefacts.new_folder(out, "sim", simulator.project.name) as folder:
            for scenario in loaded:
                first = scenario.seed if seed is None else seed
                for number in range(first, first + seeds):
                    tell(f"{scenario.name}, seed {number}")
                    runs.append(simulator.run(scenario, seed=number, bus=bus, out=folder, ecu_process=ecu_process, target=target,
                                              pace=pace, lcm=lcm, paused=paused))
            if folder is not None:
                # How fast this machine was belongs to nobody's results.
                results = [{k: v for k, v in r.items() if k != "real_time_factor"} for r in runs]
                artefacts.write_files(folder, {"results.json": artefacts.to_json(results), artefacts.MANIFEST: artefacts.manifest(
                    "sim", vehicle=simulator.project.name, controller=controller, scenarios=[s.name for s in loaded])})
    _emit(json_out, runs)
    table = Table("scenario", "seed", "verdict", "invalid at s", "judged s to it", "max margin", "tracking", "x real time", "missed",
                  box=None)
    for r in runs:
        invalid = ("–", "–") if r["first_invalid_s"] is None else (f"{r['first_invalid_s']:.2f}", f"{r['judged_to_invalid_s']:.2f}")
        ratio = f"{r['tracking_rms'] / r['command_rms']:.1%}" if r["command_rms"] else "–"
        table.add_row(r["scenario"], str(r["seed"]), r["verdict_final"], *invalid,
                      f"{r['max_margin']:.3f}", ratio, f"{r['real_time_factor']:.0f}", "; ".join(r["missed"]) or "nothing")
    console.print(table)
    console.print(f"{bus} bus, controller {controller}, coefficients {simulator.folder}")
    for r in runs:
        if "ecu" in r:
            ecu, counted = r["ecu"], r["ecu"]["instructions"]
            console.print(f"{r['scenario']}: {ecu['target']}, ELF {ecu['elf_sha256'][:16]}; of {counted['ticks']} ticks the worst took {counted['worst']} "
                          f"instructions, the mean {counted['total'] / counted['ticks']:.0f} (not cycles)")
    raise typer.Exit(1 if any(r["missed"] for r in runs) else 0)


lcm_app = _Application(no_args_is_help=True, rich_markup_mode=None, help="Watch and lead a simulation that runs with `sim --lcm URL`.")
lcm_app.prefix = "lcm "
app.add_typer(lcm_app, name="lcm")
LcmUrl = Annotated[str, typer.Option("--url", help="Where it publishes, as LCM reads it.")]


@lcm_app.command("watch", epilog="Example: lpvguard lcm watch --silence 60")
def lcm_watch(url: LcmUrl = LCM_DEFAULT,
              silence: Annotated[float, typer.Option(min=0.1, help="Give up after so many seconds without a message.")] = 10.0) -> None:
    """Print what changes: verdict, supervision, trouble codes, the margin of every counted frame, commands. Ends with the run."""
    from .lcm_client import Client, watch

    heard = 0
    for heard, line in enumerate(watch(Client(url).messages(silence)), start=1):
        print(line, flush=True)
    if not heard:
        raise InputError(url, "", f"nothing heard within {silence:g} s", "a simulation that runs with --lcm at this URL")


@lcm_app.command("send", epilog="Examples: lpvguard lcm send step --ticks 100\n\n"
                 "lpvguard lcm send inject 'plant.sensor_fault = [{signal = \"yaw_rate\", gain = 0.7}]'\n\n"
                 "lpvguard lcm send clear 'plant.sensor_fault[0]'")
def lcm_send(action: Annotated[Literal["pause", "resume", "step", "stop", "inject", "clear"], typer.Argument(help="stop ends the run, clear ends a fault.")],
             entry: Annotated[str, typer.Argument(help="inject: one entry of a scenario file (TOML) without start_s: can_fault, plant.sensor_fault, "
                                                  "plant.actuator_fault, plant.surroundings_fault, plant.speed_change. clear: its name.")] = "",
             ticks: Annotated[int, typer.Option(min=1, help="step: so many ticks of 10 ms, then paused again.")] = 1,
             url: LcmUrl = LCM_DEFAULT) -> None:
    """Tell it what to do, and print from when it acts. Exit 2 when it refuses or does not answer."""
    from .lcm_client import STATES, Client

    answer = Client(url).command(action, entry, ticks=ticks)
    print(f"{answer.utime * 1e-6:.2f} s: {STATES[answer.state]}{', ' if answer.entry else ''}{answer.entry}")


@lcm_app.command("bus", epilog="Example: lpvguard lcm bus RECORDED.lcm -o DRIVE.log && lpvguard replay --vehicle truck DRIVE.log")
def lcm_bus(log: Annotated[Path, typer.Argument(help="Log of lcm-logger.")], out: Out) -> None:
    """The CAN frames of an LCM log as candump -L writes them: the log that `sim -o` writes, byte for byte."""
    from .lcm_client import log_line, read_log

    lines = [log_line(message) for channel, message in read_log(log) if channel == "LPVGUARD_BUS"]
    if not lines:
        raise InputError(log, "LPVGUARD_BUS", "holds no frame", "a log of lcm-logger while a simulation ran with --lcm")
    artefacts.write_file(out, "".join(lines), "lcm bus")


@app.command(epilog="Example: lpvguard evaluate --vehicle g80 out/identify DRIVES --json out/evaluation.json")
def evaluate(vehicle: Vehicle, identification: Annotated[Path, typer.Argument(help="Folder written by identify.")],
             drives: Annotated[Path, typer.Argument(help="The drive folder it was made from.")],
             coefficients: Coefficients = None, json_out: JsonOut = None, jobs: Jobs = 1, scheduler: Scheduler = None) -> None:
    """False alarms and detection of injected faults, leave-one-drive-out, through the compiled core."""
    from .evaluate import FOUND_WITHIN_S, MONITOR, PIECE_S, TESTS, columns
    from .evaluate import evaluate as stage
    from .parallel import workers

    stored, drive_set = _stored_with_drives(identification, drives, vehicle)
    replayer = _replayer(vehicle, coefficients)
    with _progress("evaluate") as tell, workers(jobs, scheduler) as run:
        result = stage(stored, drive_set, replayer.core, workers=run, progress=tell)
    _emit(json_out, result)
    alarms = Table("drivers", "alarmed drives", f"alarmed {PIECE_S:g} s pieces", "95 % interval of the ratio", "an hour judged", "judged, h",
                   box=None)
    for group, row in result["false_alarms"].items():
        interval = "–" if row["interval"] is None else f"{row['interval'][0]:.3f} .. {row['interval'][1]:.3f}"
        hourly = "–" if row["per_judged_h"] is None else f"{row['per_judged_h']:.2f}"
        alarms.add_row(group, f"{row['alarmed_drives']} of {row['drives']}", f"{row['alarmed']} of {row['pieces']}", interval, hourly,
                       f"{row['judged_h']:.3f}")
    console.print(alarms)
    short = [f"{r['run']} {r['last_piece_s']:.1f} s" for r in result["drives"] if r["last_piece_s"] < PIECE_S]
    console.print(f"last pieces that are shorter: {', '.join(short) or 'none'}")
    for test, claim in result["claims"]["identified"].items():
        console.print(f"{test} test as identified: {claim}")
    for what, claims in result["claims"]["left_one_out"].items():
        console.print(f"{'both tests at one threshold' if what == 'monitor' else what + ' test'}, each drive without itself: {'; or '.join(claims)}")
    for name, reason in result["left_out"].items():
        console.print(f"left out: {name}: {reason}")
    for name, reason in result["without_faults"].items():
        console.print(f"no fault injected: {name}: {reason}")
    console.print(f"faults injected into {len(result['drives']) - len(result['without_faults'])} of {len(result['drives'])} drives; "
                  f"found within {FOUND_WITHIN_S:g} s of judged, excited driving, of all starts (drives: from every start), and the median time:")
    detectors, others = columns(result), [b["kind"] for b in result["baselines"]]
    console.print(_detector_table({name: d for name, d in detectors.items() if name not in others}))
    _print_rates(detectors, [MONITOR, *TESTS])
    if others:
        beside = [MONITOR, *others]
        console.print(_detector_table({name: detectors[name] for name in beside}, [", ".join(row["best"]) for row in result["faults"]]))
        _print_rates(detectors, beside)
    else:
        console.print("no baselines: they need another calibration drive when one is left out")


@app.command(epilog="Example: lpvguard campaign out/truck/identify out/truck/drives -o out/campaign --coefficients out/truck/vehicle")
def campaign(identification: Annotated[Path, typer.Argument(help="Folder written by identify.")],
             drives: Annotated[Path, typer.Argument(help="The drive folder it was made from.")],
             out: Out, vehicle: Annotated[str, typer.Option("--vehicle", help="Shipped vehicle with a controller.")] = "truck",
             coefficients: Coefficients = None,
             design: Annotated[Path | None, typer.Option(help="Folder written by design: also mu of the faulted loops.")] = None,
             hours: Annotated[float, typer.Option(min=0.05, help="Simulated driving of trucks within the bounds.")] = 100.0,
             repeats: Annotated[int, typer.Option(min=1, help="Runs of each severity of each fault.")] = 10,
             seed: Annotated[int, typer.Option(min=0, help="Seed of everything that is drawn.")] = 1,
             json_out: JsonOut = None, jobs: Jobs = 1, scheduler: Scheduler = None) -> None:
    """Score the monitor and the baselines over many simulated runs; stopped half-way, the same command goes on. Exit 1: a claim missed."""
    from . import campaign as stage
    from .core import shipped_vehicle
    from .parallel import workers

    stored, drive_set = _stored_with_drives(identification, drives)
    folder = coefficients or shipped_vehicle(vehicle)
    _require_settings(artefacts.read_manifest(folder, "vehicle")["project"], folder, stored.project, identification)
    with _progress("campaign") as tell, workers(jobs, scheduler) as run:
        summary = stage.campaign(stored, drive_set, folder, out, seed=seed,
                                 size=stage.Size(hours, repeats), controller=design and design / "controller.json",
                                 workers=run, progress=tell)
    _emit(json_out, summary)
    _print_campaign(summary)
    raise typer.Exit(1 if summary["missed"] else 0)


def _print_campaign(summary: dict[str, Any]) -> None:
    from .evaluate import COUNTS_ONLY

    within, detectors = summary["within"], summary["detectors"]
    console.print(f"{within['hours']:.1f} h of {within['plants']} trucks within the bounds by their own frequency response (of {within['candidates']} drawn)")
    rates = Table("test", "runs that alarm", "calibrated", "such runs an hour", "calibrated", box=None)
    for test, seen in within["tests"].items():
        calibrated, hourly = summary["calibrated"][test], seen["per_hour"]
        interval = "" if hourly["interval"] is None else f"{hourly['rate']:.2f} ({hourly['interval'][0]:.2f} .. {hourly['interval'][1]:.2f})"
        stated = ("not stated", "") if calibrated["alpha"] is None else (f"{calibrated['alpha']:.2%}", f"{calibrated['per_hour']:.2f}")
        rates.add_row(test, _rate(seen), stated[0], interval, stated[1])
    console.print(rates)
    console.print(f"apart, with more demand than was checked: {_rate(within['beyond_checked_amplitude'])}")
    table = Table("", *detectors.values(), box=None)
    for title, of in (("runs within the bounds that alarm", within["alarmed"]), ("visible faults found in time", summary["visible"])):
        table.add_row(title, *(_rate(of[d]) for d in detectors))
    matched, stated = summary["matched_claim"], summary["matched_stated"]
    for title, key in (("average found", "calibrated"), (f"average found, {matched}", "matched")):
        table.add_row(title, *(f"{summary['average'][d][key]:.1%}" for d in detectors))
    table.add_row("at the latter thresholds a further run alarms", *(COUNTS_ONLY if stated[d] is None else f"at most {stated[d]:.3g}" for d in detectors))
    console.print(table)
    kinds = Table(f"average over severities: calibrated; {matched}", *detectors.values(), f"best, {matched}", box=None)
    for k in summary["kinds"]:
        kinds.add_row(k["kind"], *(f"{k['found'][d]:.0%}, {k['matched'][d]:.0%}" for d in detectors), ", ".join(detectors[d] for d in k["best_matched"]))
    console.print(kinds)
    for b in summary["beaten"]:
        console.print(f"a baseline wins, {matched}: {detectors[b['detector']]} on {b['kind']}, {b['matched']:.0%} against {b['monitor']:.0%}")
    for s in summary["invisible"]:
        console.print(f"invisible, though {'mu is ' + format(s['mu_upper'], '.2f') if s['loop_stable'] else 'the loop is unstable'}: "
                      f"{s['kind']} {s['severity']:g} {summary['units'][s['kind']]}, found {s['found']['monitor']} of {s['runs']}")
    bus = Table("fault of the bus, by severity", "runs as required", "reactions met", "not live", "judged", "alarmed, visible runs", box=None)
    for kind in dict.fromkeys(s["kind"] for s in summary["bus"]):
        rows = [s for s in summary["bus"] if s["kind"] == kind]
        severities = ", ".join(f"{s['severity']:g}" for s in rows)
        bus.add_row(f"{kind}: {severities} {summary['units'][kind]}", _of(rows, "as_required", "runs"), _of(rows, "met", "due"),
                    *(f"{min(s[k] for s in rows):.0%} .. {max(s[k] for s in rows):.0%}" for k in ("away", "judged")),
                    f"{sum(s['alarmed']['monitor'] for s in rows)}, {sum(s['visible_runs'] for s in rows)}")
    console.print(bus)
    for which, said in summary["supervision"].items():
        console.print(f"supervision of a {which} bus as its frames require: {_rate(said['as_required'])} runs; "
                      f"of {said['due']} reactions due {said['met']} at the very tick")
    for text in summary["missed"]:
        console.print(f"missed: {text}")


def _of(rows: list[dict], count: str, of: str) -> str:
    return f"{sum(r[count] for r in rows)} of {sum(r[of] for r in rows)}"


def _rate(rate: dict) -> str:
    return f"{rate['count']} of {rate['of']}" + ("" if rate["interval"] is None else f" ({rate['interval'][0]:.2%} .. {rate['interval'][1]:.2%})")


@app.command(epilog="Example: lpvguard report out/identify DRIVES --vehicle g80 -o out/report.html")
def report(identification: Annotated[Path, typer.Argument(help="Folder written by identify.")],
           drives: Annotated[Path, typer.Argument(help="The drive folder it was made from.")],
           vehicle: Vehicle, out: Out, coefficients: Coefficients = None,
           evaluation: Annotated[Path | None, typer.Option(help="JSON written by evaluate.")] = None,
           loops: Annotated[Path | None, typer.Option(help="Folder written by sim -o.")] = None,
           campaign: Annotated[Path | None, typer.Option(help="Folder written by campaign.")] = None,
           design: Annotated[Path | None, typer.Option(help="Folder written by design.")] = None,
           tradeoff: Annotated[Path | None, typer.Option(help="Folder written by design --tradeoff.")] = None) -> None:
    """One self-contained HTML page with every picture and table."""
    from .report import write_report

    for kind, folder in (("sim", loops), ("campaign", campaign), ("design", design), ("design-tradeoff", tradeoff)):
        if folder is not None:
            artefacts.read_manifest(folder, kind)
    stored, drive_set = _stored_with_drives(identification, drives, vehicle)
    replayer = _replayer(vehicle, coefficients) if stored.project.frames.estimator == "hann" else None
    with _progress("report") as tell:
        write_report(stored, drive_set, replayer, out, artefacts.read_json(evaluation) if evaluation else None, tell,
                     loops, design, tradeoff, artefacts.read_json(campaign / "summary.json") if campaign else None)
    console.print(f"written to {out}")


@app.command(epilog="Example: lpvguard solve problems.json -o answers.json --jobs 2")
def solve(problems: Annotated[str, typer.Argument(help="JSON list of problems; - is standard input.")],
          out: Annotated[str | None, typer.Option("-o", "--out", help="Answers (default: standard output).")] = None,
          jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1) -> None:
    """Answer problems of the numerical engine; those that carry an answer are compared, exit 1 on any miss."""
    from .solve import run_solve

    raise typer.Exit(run_solve(problems, out, jobs))


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True},
             epilog="Example: lpvguard bench validation --json out/validation.json")
def bench(context: typer.Context,
          name: Annotated[str, typer.Argument(help="can, core, fleet, robust, synthesis, validation or weights; NAME -- --help for options.")],
          ) -> None:
    """Measure performance, beside peers in the same run; prints a table."""
    from .bench import run

    run(name, context.args)


def _detector_table(detectors: dict[str, Any], best: list[str] | None = None) -> Table:
    """False alarms and found faults, a column per detector (evaluate.Column); ``best``: who leads, per fault."""
    from .evaluate import detector_rows

    table = Table("", *detectors, *(["best"] if best else []), box=None)
    for row in detector_rows(list(detectors.values()), best):
        table.add_row(*row)
    return table


def _print_rates(detectors: dict[str, Any], names: list[str]) -> None:
    from .evaluate import equal_rates

    console.print(f"{', '.join(names)} are compared {equal_rates({name: detectors[name].stated for name in names})}")


def _alarm(a: dict[str, Any]) -> str:
    if a["test"] == "energy":
        def listed(values: list[float]) -> str:
            return ", ".join(f"{x:.3g}" for x in values)

        return (f"energy test, v = {a['speed_mps']:.1f} m/s: ratio {a['margin']:.2f} > {a['threshold']:.2f} {a['band']} the corners, in direction "
                f"({listed(a['direction'])}); ||F e|| = {listed(a['E'])} against ||F W_delta yhat|| {listed(a['Z'])} + sigma "
                f"{listed(a['B_w'])}")
    return (f"frame test, {a['bin_rad_s']:.3g} rad/s, v = {a['speed_mps']:.1f} m/s: "
            f"margin {a['margin']:.2f} (statistic {a['statistic']:.2f} > {a['threshold']:.2f}); |E| = "
            f"{_norm(a['E']):.3g} against W_delta {a['W_delta']:.3g} x |Z| {_norm(a['Z']):.3g} + B_w "
            f"{', '.join(f'{b:.3g}' for b in a['B_w'])}")


def _print_reception(run: str, can: dict[str, Any]) -> None:
    for message, kinds in can["messages"].items():
        rejected = ", ".join(f"{n} {kind}" for kind, n in kinds.items() if kind not in ("accepted", "recovering"))
        if rejected:
            console.print(f"{run}: {message}: {kinds.get('accepted', 0)} frames used; {rejected}")
    for gap in can["gaps"][:3]:
        console.print(f"{run}: no sample from {gap['from_s']:.2f} to {gap['to_s']:.2f} s: {', '.join(gap['messages'])} not live")
    if len(can["gaps"]) > 3:
        console.print(f"{run}: {len(can['gaps']) - 3} more gaps (--json lists all)")


def _play(project, logs: list[Path], to: str, speed: float, channel: str | None) -> None:
    import can

    from .can.play import play
    from .replay import bus_frames

    kind, _, interface = to.partition(":")
    if kind != "socketcan" or not interface:
        raise InputError("replay", "--to", to, "socketcan:INTERFACE")
    if not speed > 0:
        raise InputError("replay", "--speed", f"{speed:g}", "a number above 0, or inf")
    loaded = [(log, bus_frames(log, project).of_channel(channel, log)) for log in logs]
    try:
        with can.Bus(interface, interface="socketcan", fd=True) as bus, _progress("replay") as tell:
            for log, frames in loaded:
                tell(f"{log.name} onto {interface}")
                late = play(frames, bus, speed=speed)
                console.print(f"{log.name}: {len(frames)} frames onto {interface}, the latest {late * 1e3:.1f} ms behind its time")
    except (OSError, can.CanError) as error:
        raise InputError("replay", f"--to {to}", str(error), "a SocketCAN interface that is up (tools/with-vcan lends one)") from None


def _toml(value: Any) -> str:
    return "{ " + ", ".join(f"{k} = {v}" for k, v in value.items()) + " }" if isinstance(value, dict) else f"{value:g}"


def _norm(values: list[complex]) -> float:
    return sum(abs(x) ** 2 for x in values) ** 0.5


def _replayer(vehicle: str, coefficients: Path | None):
    from .core import Core, shipped_vehicle
    from .frames import require_core
    from .replay import Replayer

    project = _load_project(vehicle)
    require_core(project)
    folder = coefficients or shipped_vehicle(project.name)
    _require_settings(artefacts.read_manifest(folder, "vehicle")["project"], folder, project, vehicle)
    return Replayer(project, Core(folder))


def _require_settings(stored: dict[str, Any], where: Path, project, vehicle: object) -> None:
    """InputError naming the first setting in which the project file is not the one that ``where`` was made with. All count but the
    title, of which nothing is computed."""
    given = json.loads(artefacts.to_json(project.model_dump(by_alias=True)))
    differs = artefacts.first_difference({**stored, "title": None}, {**given, "title": None})
    if differs is not None:
        setting, old, new = differs
        raise InputError(setting, "", f"{json.dumps(old)} in {where}, {json.dumps(new)} in {vehicle}",
                         "the settings that it was made with, or made anew with these")


def _stored(identification: Path, vehicle: str):
    from . import identify as stage

    stored, project = stage.load(identification), _load_project(vehicle)
    if stored.project.name != project.name:
        raise InputError(identification, "vehicle", stored.project.name, f"an identification of {vehicle}")
    _require_settings(artefacts.read_json(identification / "project.json"), identification, project, vehicle)
    return stored


def _stored_with_drives(identification: Path, folder: Path, vehicle: str | None = None):
    """The identification and the drives that it was made from. ``vehicle`` None: of whatever vehicle."""
    from . import identify as stage
    from .drives import list_experiments
    from .nominal import NominalModel

    stored = stage.load(identification) if vehicle is None else _stored(identification, vehicle)
    experiments = list_experiments(folder)
    for e in experiments:
        if stored.manifest["sha256"].get(e.name) != artefacts.file_hash(e.path):
            raise InputError(e.path, "", "is not the file that was identified", f"the drives of {identification}")
    return stored, stage.DriveSet(stored.project, NominalModel(stored.project), experiments)


def _complain(error: InputError) -> None:
    print(f"lpvguard: error: {error}", file=sys.stderr)


def _end(number: int, _: Any) -> None:
    """Ends the program as an error does, so that nothing half-written stays behind."""
    signal.signal(number, signal.SIG_IGN)
    sys.exit(128 + number)


def main() -> None:
    """Entry point of the console script."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) == signal.SIG_DFL:  # nohup ignores the second
            signal.signal(number, _end)
    try:
        app()
        sys.stdout.flush()
    except InputError as error:
        _complain(error)
        sys.exit(2)
    except BrokenPipeError:
        sys.exit(2)


if __name__ == "__main__":
    main()
