"""The core on emulated Cortex-M4F, M7 and R5F: the same bits as on the host, within its budget
(lib/INTEGRATION.md)."""

import re
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.core import targets
from lpvguard.core.compiled import eigen_include, shipped_vehicle
from lpvguard.extras.bench import core as bench
from parts import require

# What the core's objects may take from libraries: moving memory, and division of 32 bits where the processor
# has none.
ALLOWED_IMPORTS = re.compile(
    r"mem(cpy|set|move|cmp)|__aeabi_(mem\w+|u?idiv(mod)?|(u?l)mul|llsl|llsr|lasr|[ful]2(u?lz|f|[lu]?2f)|u?l2f|f2u?lz)"
)
DOUBLE_HELPER = re.compile(r"__aeabi_(d\w+|\w+2d|cd\w+)|__\w+df\w*")


BUDGET = "cortex-m4f"
"""The processor that the budget is stated for."""


@pytest.fixture(scope="session")
def vehicle(tmp_path_factory):
    """The budget's vehicle and its drive."""
    folder = tmp_path_factory.mktemp("budget") / "truck"
    project = bench.write_budget_vehicle(folder)
    return folder, bench.drive_of(project)


@pytest.fixture(scope="session")
def host(vehicle):
    return targets.run_host(*vehicle)


@pytest.fixture(
    scope="session",
    params=[
        name if name == BUDGET else pytest.param(name, marks=pytest.mark.long("another processor's image"))
        for name in sorted(targets.TARGETS)
    ],
)
def name(request):
    require("qemu")
    return request.param


@pytest.fixture(scope="session")
def counted(name, vehicle):
    """The build that an ECU project makes, and one of the monitor alone."""
    return bench.count(name, *vehicle)


@pytest.mark.requirement("REQ-CORE-4")
@pytest.mark.slow("an image for every processor, counted in its emulator")
def test_results_are_the_hosts_bit_for_bit(name, vehicle, host):
    """The truck has four states: a packet of four numbers on the host would be summed in another order."""
    run = targets.run_target(name, *vehicle, same_bits=True)
    kinds = [line.split()[0] for line in run["results"]]
    assert kinds.count("frame") > 500 and kinds.count("demand") > 100 and "verdict" in kinds
    assert {int(line.split()[1]) for line in run["results"] if line.startswith("frame")} == set(range(20))
    assert run["results"] == host["results"]
    assert run["structs"] == pytest.approx(host["structs"], rel=0.2)  # pointers are half as long


def test_results_show_judged_and_falsifying_frames(host):
    """The drive reaches every branch that the comparison is about."""
    frames = [line.split() for line in host["results"] if line.startswith("frame")]
    assert {f[3] for f in frames} >= {"0", "4"}  # counted, settling
    assert {f[4] for f in frames} == {"0", "1"}  # falsified and not
    margins = np.array([int(f[6], 16) for f in frames], np.uint32).view(np.float32)
    assert np.isfinite(margins).all() and margins.max() > 1.0


@pytest.mark.requirement("REQ-CORE-2")
@pytest.mark.requirement("REQ-CORE-7")
@pytest.mark.slow("an image for every processor, counted in its emulator")
def test_counts_are_within_the_budget(counted):
    step = counted["parts"]["ecu_step"]
    if counted["target"] == BUDGET:
        assert 0 < step["worst"] <= bench.WORST_STEP
        assert counted["parts"]["ecu_init"]["worst"] <= bench.INIT
        assert sum(counted["rom"].values()) <= bench.ROM_BYTES
        assert counted["monitor_only"]["rom"] <= bench.MONITOR_ROM_BYTES
        assert counted["monitor_only"]["ram"] <= bench.MONITOR_RAM_BYTES
        assert 0 < counted["parts"]["evidence_take"]["worst"] <= bench.EVIDENCE
    assert step["worst"] / step["median"] <= bench.WORST_TO_MEDIAN
    assert counted["structs"]["ecu"] + counted["structs"]["diagnosis"] <= bench.RAM_BYTES
    # What stands in the period of a step: the sample is taken, and the rest is done beside it.
    assert counted["parts"]["diagnosis_take"]["worst"] <= 0.04 * step["worst"]
    monitor = (targets.library_root() / "include" / "lpvguard" / "monitor.h").read_text()
    assert int(re.search(r"^#define LPVG_NRECORDS (\d+)", monitor, re.MULTILINE)[1]) >= bench.RECORDED_FRAMES
    assert bench.stack_of(counted) <= bench.STACK_BYTES
    # A step in which XCP has nothing to do, with the truck's own frames.
    idle = counted["parts"]["xcp_event"]["worst"] + bench.TRUCK_FRAMES * counted["parts"]["xcp_idle"]["worst"]
    assert 0 < idle <= bench.XCP_IDLE * step["worst"]


@pytest.mark.slow("an image for every processor, counted in its emulator")
def test_the_guides_table_is_what_is_measured(counted):
    text = (targets.library_root() / "INTEGRATION.md").read_text()
    table = text.partition(bench.BUDGET[0])[2].partition(bench.BUDGET[1])[0]
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()]
    column = [row[cells[0].index(counted["title"])] for row in cells[2:]]
    assert [row[0] for row in cells[2 : 2 + len(bench.GUIDE_ROWS)]] == [row[0] for row in bench.GUIDE_ROWS]
    measured = [float(of_run(counted)) for _, _, of_run in bench.GUIDE_ROWS]
    # Compilers of other minor versions count a little differently.
    assert [float(cell) for cell in column[: len(measured)]] == pytest.approx(measured, rel=0.03), (
        "run `lpvguard bench core --guide lib/INTEGRATION.md`"
    )


@pytest.mark.slow("an image for every processor, counted in its emulator")
def test_the_memory_map_is_whole(counted):
    parts = counted["map"]
    assert {".vectors", ".core_code", ".core_coefficients", ".bss"} <= set(parts)
    assert (
        sum(parts[s]["bytes"] for s in targets.SECTIONS if s in parts)
        == sum(counted["rom"].values())
        > 10_000
    )
    ends = [(s["address"], s["address"] + s["bytes"]) for s in parts.values()]
    assert all(end <= begin for (_, end), (begin, _) in pairwise(ends))


@pytest.mark.slow("an image for every processor, counted in its emulator")
def test_the_controller_takes_a_fifth_of_what_full_matrices_take(counted):
    assert bench.dense_to_controller(counted) >= bench.DENSE_TO_CONTROLLER
    # What the demand is worth is compared on the target itself: both ask for the same (target_bench.cpp).
    assert counted["parts"]["dense_step"]["calls"] == counted["parts"]["control_step"]["calls"]
    # The step that engages; a ratchet. The rate limit by elapsed time costs it eight.
    assert counted["parts"]["control_step"]["worst"] <= 1_760


@pytest.mark.long("every processor's image, counted twice")
def test_counts_repeat_to_the_instruction(counted, name, vehicle):
    again = targets.run_target(name, *vehicle, same_bits=False)
    assert again["parts"] == counted["parts"] and again["elf_sha256"] == counted["elf_sha256"]


@pytest.mark.requirement("REQ-CORE-9")
@pytest.mark.slow("an image for every processor, counted in its emulator")
def test_the_core_imports_neither_heap_nor_text_nor_double_arithmetic(counted):
    assert [s for s in counted["imports"] if not ALLOWED_IMPORTS.fullmatch(s)] == []
    assert [s for s in counted["imports"] if DOUBLE_HELPER.fullmatch(s)] == []


@pytest.mark.long("20 s: an image of two cores")
@pytest.mark.requirement("REQ-CORE-8")
def test_two_vehicles_share_an_image(tmp_path):
    """tests/consumer/two_vehicles.c on the Cortex-M4F: cores of different sizes, one after the other."""
    target, root = targets.TARGETS["cortex-m4f"], Path(__file__).parents[1]
    require("qemu")
    subprocess.run(
        [
            sys.executable,
            root / "unit" / "generate.py",
            "vehicle",
            root / "unit" / "toy.toml",
            tmp_path / "toy",
        ],
        check=True,
    )
    core, ports = targets.library_root(), targets.firmware_root() / "ports"
    jobs = [
        (ports / "bare_metal" / "bare_metal.c", None),
        (ports / "cortex_m" / "startup.c", None),
        (root / "consumer" / "two_vehicles.c", None),
    ]
    for folder in (shipped_vehicle("g80"), tmp_path / "toy"):
        parts = ("coeff", "model", "energy", "change", "monitor")
        jobs += [(core / "src" / f"{part}.cpp", folder) for part in parts]
        jobs += [(folder / "lpvguard_coeff.c", folder), (root / "consumer" / "task.c", folder)]
    objects = []
    for source, folder in jobs:
        objects.append(tmp_path / f"{folder.name if folder else 'port'}_{source.stem}.o")
        dialect = (
            ["arm-none-eabi-g++", *targets.CXX, "-isystem", eigen_include()]
            if source.suffix == ".cpp"
            else ["arm-none-eabi-gcc", "-std=gnu99"]
        )
        flags = [*target.cpu, *targets.LANGUAGE, *targets.WARNINGS, "-DOTHER_TASK=lpvg_toy_task"]
        folders = [core / "include", core / "src", ports, *([folder] if folder else [])]
        flags += [f"-I{path}" for path in folders]
        subprocess.run([*dialect, *flags, "-c", source, "-o", objects[-1]], check=True)
    elf = tmp_path / "two_vehicles.elf"
    flags = ["--specs=nano.specs", "-nostartfiles", "-Wl,--gc-sections", "-Wl,--no-warn-rwx-segments"]
    script = ["-T", ports / "cortex_m" / target.linker_script]
    subprocess.run(["arm-none-eabi-g++", *target.cpu, *flags, *script, *objects, "-o", elf], check=True)
    alone = ["-display", "none", "-serial", "none", "-semihosting-config", "enable=on,target=native"]
    done = subprocess.run(
        [*target.emulator, *alone, "-kernel", elf],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
        timeout=targets.TIMEOUT_S,
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_missing_tools_are_named_with_their_packages(vehicle, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda tool: None)
    with pytest.raises(InputError, match=r"qemu-system-arm.*gcc-arm-none-eabi"):
        targets.run_target("cortex-m4f", *vehicle, same_bits=True)


def test_unknown_target_is_refused(vehicle):
    with pytest.raises(InputError, match="unknown; expected one of cortex-m4f"):
        targets.run_target("cortex-m0", *vehicle, same_bits=True)
