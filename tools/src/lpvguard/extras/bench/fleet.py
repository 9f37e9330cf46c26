"""Measure `identify` on many drives: time with one and with several workers, and peak memory.

The fleet is synthetic: short drives of the g80's nominal model with another gain, a disturbance and noise.
Its frames last at most six seconds. Each time is the smaller one of two alternating runs. Both numbers of
workers must give bit-identical bounds. The peak memory is that of a separate process with one worker.
"""

import filecmp
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pa_parquet

from ...base.parallel import workers
from ...identify import identification as stage
from ...vehicle.nominal import NominalModel
from ...vehicle.project import Project, load_project, parse_project
from . import parser, show

MEMORY_DRIVES = (10, 100, 1000)
SHORT_S = 20.0


def vehicle() -> Project:
    """Project of the g80 with short frames."""
    document = load_project("g80").model_dump(by_alias=True)
    document["frames"] |= {"omega_min_radps": 3.1415927, "omega_max_radps": 15.707963, "bins_per_decade": 5}
    document["bounds"]["nu_ceiling"] = {"omega_radps": [6.2831853], "nu": [0.05]}
    document["weights"] |= {"max_order": 2}
    return parse_project(document, "fleet")


def write_fleet(folder: Path, count: int, *, duration_s: float = SHORT_S, seed: int = 0) -> None:
    """Write a folder of ``count`` drives (Parquet); two of three drives have the split train.

    Drive i is the same in every fleet.
    """
    project = vehicle()
    model, index = NominalModel(project), ["experiment,split,driver"]
    folder.mkdir(parents=True)
    for i in range(count):
        random = np.random.default_rng([seed, i])
        t = np.arange(int(duration_s / project.Ts_s)) * project.Ts_s
        v = random.uniform(5.0, 17.0) * (1 + 0.03 * np.sin(0.3 * t))
        u = sum(0.02 * np.sin(w * t + random.uniform(0, 6)) for w in (3.1, 4.9, 7.7, 12.3))[:, None]
        y = random.uniform(0.85, 1.1) * model.simulate(v, u, np.zeros(1))
        y += 2e-3 * random.standard_normal(y.shape) + 2e-3 * np.sin(random.uniform(2, 9) * t)[:, None]
        name = f"drive_{i:05d}"
        pa_parquet.write_table(
            pa.table({"t": t, "v": v, "delta": u[:, 0], "r": y[:, 0]}), folder / f"{name}.parquet"
        )
        index.append(f"{name},{'valid' if i % 3 == 2 else 'train'},robot")
    (folder / "experiments.csv").write_text("\n".join(index) + "\n")


def peak_memory_kib(folder: Path) -> int:
    """Peak memory [KiB] of a process that identifies the drives of ``folder`` (Linux)."""
    script = (
        "import sys, tempfile\nfrom pathlib import Path\n"
        "from lpvguard.extras.bench import fleet\nfrom lpvguard.identify import run as stage\n"
        "with tempfile.TemporaryDirectory() as out:\n"
        "    stage.save(*stage.identify(fleet.vehicle(), Path(sys.argv[1])), Path(out) / 'found')\n"
        "print(next(x.split()[1] for x in open('/proc/self/status') if x.startswith('VmHWM')))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(folder)], capture_output=True, text=True, check=True
    )
    return int(done.stdout)


def _identified(folder: Path, jobs: int, out: Path) -> float:
    """Seconds to identify and save with ``jobs`` workers, including their start."""
    start = time.perf_counter()
    with workers(jobs) as run:
        stage.save(*stage.identify(vehicle(), folder, workers=run), out)
    return time.perf_counter() - start


def bench_fleet(drives: int, duration_s: float, jobs: int, memory: tuple[int, ...]) -> dict:
    """Measure the time with one and with ``jobs`` workers; measure the memory for each number of drives."""
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        write_fleet(root / "drives", drives, duration_s=duration_s)
        seconds: dict[int, list[float]] = {n: [] for n in (1, jobs)}
        for _ in range(2):
            for n, taken in seconds.items():
                taken.append(_identified(root / "drives", n, root / str(n)))
        names = [p.name for p in (root / "1").iterdir()]
        same = not any(filecmp.cmpfiles(root / "1", root / str(jobs), names, shallow=False)[1:])
        kib = {}
        for count in memory:
            write_fleet(root / f"memory_{count}", count)
            kib[count] = peak_memory_kib(root / f"memory_{count}")
    one, many = min(seconds[1]), min(seconds[jobs])
    return {
        "drives": drives,
        "duration_s": duration_s,
        "jobs": jobs,
        "seconds_1": one,
        f"seconds_{jobs}": many,
        "ratio": one / many,
        "same_bytes": same,
        "peak_memory_kib": kib,
        "processors": os.cpu_count(),
        "load": os.getloadavg()[0],
    }


def main(argv: list[str]) -> None:
    """Run `lpvguard bench fleet`."""
    arguments = parser("fleet", __doc__)
    arguments.add_argument("--drives", type=int, default=200)
    arguments.add_argument("--duration", type=float, default=300.0, help="seconds of each of them")
    arguments.add_argument("--jobs", type=int, default=2)
    arguments.add_argument(
        "--memory",
        type=int,
        nargs="*",
        default=MEMORY_DRIVES,
        help="numbers of 20 s drives to measure memory with",
    )
    options = arguments.parse_args(argv)
    r = bench_fleet(options.drives, options.duration, options.jobs, tuple(options.memory))
    lines = [
        f"identify, {r['drives']} drives of {r['duration_s']:g} s: 1 worker {r['seconds_1']:.1f} s, "
        f"{r['jobs']} workers {r[f'seconds_{options.jobs}']:.1f} s, ratio {r['ratio']:.2f} "
        f"({r['processors']} processors, load {r['load']:.1f}); "
        f"{'the same bytes' if r['same_bytes'] else 'DIFFERENT BYTES'}"
    ]
    smallest = min(r["peak_memory_kib"].values(), default=1)
    lines += [
        f"peak memory, {count:>6} drives: {kib / 1024:7.1f} MiB  ({kib / smallest:.3f})"
        for count, kib in r["peak_memory_kib"].items()
    ]
    show("\n".join(lines), r, options.json_out)
