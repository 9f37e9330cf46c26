"""`lpvguard bench soak`: run the truck's firmware over hours of driving with random faults.

The driving is simulated, with faults of bus, clock and vehicle, on this PC and on emulated processors. Each
hour is a row of the table. Driving, messages and counts are the same on every target, bit for bit, including
the digest of all sent frames. The instructions of the worst tick and the stack depth must not grow. The rules
for every tick are in firmware_sim/ports/soak.c.
"""

from dataclasses import asdict, dataclass
from pathlib import Path

from ...base.artefacts import require_replaceable_file
from ...core.compiled import firmware_root, shipped_vehicle
from ...core.targets import TARGETS, Program, run_program
from . import parser, require_at_least, show

HOUR_MS = 3_600_000
SEED = 20261123
SPEEDS_OF_A_TARGET = 20.0
"""The emulator is stopped if it takes longer than the simulated time divided by this number."""
OF_A_TARGET = ("worst", "stack")
"""Numbers that differ between targets."""


@dataclass(frozen=True)
class Soak:
    """Result of a target: one entry per hour, and the number of violations of each rule."""

    target: str
    hours: list[dict[str, int]]
    broken: dict[str, int]

    @property
    def said(self) -> list[dict[str, int]]:
        """Entries of the hours without the numbers that differ between targets."""
        return [{k: v for k, v in hour.items() if k not in OF_A_TARGET} for hour in self.hours]


def header_text(hours: int, hour_ms: int, seed: int, faults: bool) -> str:
    """Write the text of soak_input.h."""
    numbers = {"HOURS": hours, "HOUR_MS": hour_ms, "SEED": seed, "FAULTS": int(faults)}
    return "".join(f"#define SOAK_{name} {value}u\n" for name, value in numbers.items())


def soak(
    vehicle: Path, target: str, hours: int, *, hour_ms: int = HOUR_MS, seed: int = SEED, faults: bool = True
) -> Soak:
    """Run a generated folder with a controller, a bus and a diagnosis.

    ``hour_ms`` [ms] is the simulated time of an hour. Without ``faults``, the speed stays within the
    controller's range. Raises InputError like `run_program`.
    """
    root = firmware_root()
    header = header_text(hours, hour_ms, seed, faults)
    sources = (root / "ports" / "soak.c", root / "ecu" / "firmware.c")
    program = Program("soak", sources, {"soak_input.h": header}, (root / "ecu",))
    timeout_s = 60.0 + hours * hour_ms * 1e-3 / SPEEDS_OF_A_TARGET
    rows, broken = [], {}
    for line in run_program(target, vehicle, program, timeout_s=timeout_s):
        kind, *words = line.split()
        if kind == "hour":
            rows.append({name: int(value) for name, value in zip(words[::2], words[1::2], strict=True)})
        elif kind == "rule":
            broken[words[0]] = int(words[2])
    return Soak(target, rows, broken)


def table(runs: list[Soak]) -> str:
    """Write one row per hour of the first run with the numbers of every target, then the violations."""
    names = [name for name in runs[0].hours[0] if name not in (*OF_A_TARGET, "number", "digest")]
    emulated = [run for run in runs if run.target != "host"]
    head = ["hour", *names, *(f"{run.target} {name}" for run in emulated for name in OF_A_TARGET)]
    rows = [head]
    for i, hour in enumerate(runs[0].hours):
        own = [str(run.hours[i][name]) for run in emulated for name in OF_A_TARGET]
        rows.append([str(hour["number"]), *(str(hour[name]) for name in names), *own])
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
    lines = ["  ".join(word.rjust(w) for word, w in zip(row, widths, strict=True)) for row in rows]
    for run in runs:
        same = "" if run is runs[0] else f", the same as on {runs[0].target}: {run.said == runs[0].said}"
        words = ", ".join(f"{name} {n}" for name, n in run.broken.items())
        lines.append(f"{run.target}: {len(run.hours)} hours; rules broken: {words}{same}")
    return "\n".join(lines)


def draw(runs: list[Soak], path: Path) -> None:
    """Draw the numbers that must not grow, and the counts of each hour."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 9), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True)
    numbers = [hour["number"] for hour in runs[0].hours]
    for run in (run for run in runs if run.target != "host"):
        for axis, name in zip(axes, OF_A_TARGET, strict=False):
            axis.step(numbers, [hour[name] for hour in run.hours], where="mid", label=run.target)
    for name in ("faults", "vehicle_faults", "alarms", "refused"):
        axes[2].step(numbers, [h[name] for h in runs[0].hours], where="mid", label=name.replace("_", " "))
    for name in ("engaged", "judged", "valid"):
        share = [100.0 * h[name] / h["ticks"] for h in runs[0].hours]
        axes[3].step(numbers, share, where="mid", label=name)
    titles = ("worst tick [instructions]", "stack [B]", "count an hour [-]", "share of the ticks [%]")
    for axis, title in zip(axes, titles, strict=True):
        axis.set_ylabel(title)
        axis.set_ylim(bottom=0)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(loc="center right", fontsize="small")
    axes[-1].set_xlabel("hour of simulated driving [h]")
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)


def main(argv: list[str]) -> None:
    """Run `lpvguard bench soak`."""
    arguments = parser("soak", __doc__)
    arguments.add_argument("--hours", type=int, default=24)
    arguments.add_argument("--seed", type=int, default=SEED)
    arguments.add_argument("--targets", default="host", help=f"comma between: host, {', '.join(TARGETS)}")
    arguments.add_argument("--healthy", action="store_true", help="no faults, and speeds within the range")
    arguments.add_argument("--figure", type=Path, help="draw the curves there, .svg or .png")
    options = arguments.parse_args(argv)
    require_at_least("soak", options, hours=1, seed=1)
    if options.figure is not None:
        require_replaceable_file(options.figure, "bench soak")
    vehicle = shipped_vehicle("truck")
    runs = [
        soak(vehicle, name, options.hours, seed=options.seed, faults=not options.healthy)
        for name in options.targets.split(",")
    ]
    if options.figure is not None:
        draw(runs, options.figure)
    show(table(runs), [asdict(run) for run in runs], options.json_out)
