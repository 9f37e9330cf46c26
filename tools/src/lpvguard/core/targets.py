"""Run the core on emulated ECU processors: cross-compile it, run it in QEMU, and count instructions.

    cortex-m4f   QEMU mps2-an386          cortex-m7   QEMU mps2-an500          cortex-r5f   QEMU xlnx-zcu102,
                 RPU core 0

``run_target`` builds firmware_sim/ports/target_bench.cpp with a vehicle's generated folder and runs it over a
drive. It returns the core's results, bit for bit, and the cost of every part. Costs are *instructions, not
cycles*: QEMU models no pipeline, cache or flash waits. ``run_host`` does the same with the PC's compiler, for
comparison. ``emulated_ecu`` builds the whole firmware with the emulated CAN controller for the loop of
`lpvguard sim`.

There are two builds. The build for comparing bits uses ``-ffp-contract=off`` everywhere, because M4F and M7
have a fused multiply-add and the R5F does not. The build for counting uses the compiler's default, as in a
usual ECU project.
"""

import hashlib
import os
import re
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..base import native
from ..base.artefacts import write_files
from ..base.errors import InputError
from .compiled import core_objects, core_sources, eigen_include, firmware_root, library_root

PACKAGES = "qemu-system-arm gcc-arm-none-eabi libnewlib-arm-none-eabi libstdc++-arm-none-eabi-newlib"
"""Debian packages that hold the cross compiler, its libraries and the emulator."""

LANGUAGE = ("-O2", "-fno-math-errno", "-DNDEBUG")
SAME_BITS = "-ffp-contract=off"
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Werror")
CXX = ("-std=c++17", "-fno-exceptions", "-fno-rtti", "-fno-threadsafe-statics")
SECTIONS = {".core_code": "code", ".core_coefficients": "coefficients", ".core_libraries": "libraries"}
"""Sections of the core in the linker scripts, and their names in the report."""
SEMIHOSTING = ("-semihosting-config", "enable=on,target=native")
TIMEOUT_S = 300
R5_START = "qom-set /machine/soc/rpu-cluster/rpu-cpu[0] start-powered-off false\nsystem_reset\ncont\n"
"""Commands for QEMU's monitor that switch the RPU core on; QEMU 7.2 leaves even the boot processor off."""


@dataclass(frozen=True)
class Target:
    """A processor: compiler options, port, and the emulator's command without the ELF file."""

    name: str
    title: str
    port: str
    linker_script: str
    cpu: tuple[str, ...]
    emulator: tuple[str, ...]
    elf_option: str
    monitor_input: str | None = None
    can: tuple[str, ...] = ()
    """Options that connect the CAN controller to QEMU's bus canbus0; empty if the board has none."""


def _mps2(name: str, title: str, board: str, *cpu: str) -> Target:
    return Target(
        name,
        title,
        "cortex_m",
        "mps2.ld",
        ("-mthumb", "-mfloat-abi=hard", *cpu),
        ("qemu-system-arm", "-M", board, "-monitor", "none", "-icount", "shift=7"),
        "-kernel={elf}",
    )


EVIDENCE_CALLS = 2000
"""Number of samples over which the evidence ring's instructions are counted."""
TARGETS = {
    t.name: t
    for t in (
        _mps2("cortex-m4f", "Cortex-M4F", "mps2-an386", "-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16"),
        _mps2("cortex-m7", "Cortex-M7", "mps2-an500", "-mcpu=cortex-m7", "-mfpu=fpv5-sp-d16"),
        Target(
            "cortex-r5f",
            "Cortex-R5F",
            "cortex_r5",
            "zcu102.ld",
            ("-mcpu=cortex-r5", "-marm", "-mfloat-abi=hard", "-mfpu=vfpv3-d16"),
            (
                "qemu-system-aarch64",
                "-M",
                "xlnx-zcu102",
                "-smp",
                "5",
                "-m",
                "256M",
                "-icount",
                "shift=0",
                "-S",
                "-monitor",
                "stdio",
                "-global",
                "xlnx-zynqmp.boot-cpu=rpu-cpu[0]",
            ),
            "-device=loader,file={elf},cpu-num=4",
            R5_START,
            ("-object", "can-bus,id=canbus0", "-machine", "canbus0=canbus0"),
        ),
    )
}


def missing_tools(target: Target) -> list[str]:
    """Programs that `run_target` needs but that are not installed."""
    tools = (
        "arm-none-eabi-gcc",
        "arm-none-eabi-g++",
        "arm-none-eabi-readelf",
        "arm-none-eabi-nm",
        target.emulator[0],
    )
    return [tool for tool in tools if shutil.which(tool) is None]


@dataclass(frozen=True)
class Input:
    """A drive as input of the core, rounded to float, one row per sample.

    Attributes
    ----------
    v : ndarray (N,), m/s
    u : ndarray (N, n_u)
    y : ndarray (N, n_y)
    """

    v: np.ndarray
    u: np.ndarray
    y: np.ndarray

    def header(self) -> str:
        """C++ text of target_input.h."""
        rows = np.column_stack([self.v, self.u, self.y]).astype(np.float32)
        text = ",\n".join("{" + ", ".join(f"{float(x).hex()}F" for x in row) + "}" for row in rows)
        return (
            f"// Made by lpvguard.core.targets: speed, inputs, outputs, one row a sample.\n#pragma once\n"
            f"#define TARGET_INPUT_SAMPLES {len(rows)}U\n"
            f"static const float target_input[TARGET_INPUT_SAMPLES][{rows.shape[1]}] = {{\n{text}}};\n"
        )


@dataclass(frozen=True)
class Program:
    """Program that runs on a target with the core and the port.

    Attributes
    ----------
    name : str
    sources : tuple of Path
    headers : dict[str, str], text of generated headers by name
    folders : tuple of Path, folders of the sources' headers
    """

    name: str
    sources: tuple[Path, ...]
    headers: dict[str, str]
    folders: tuple[Path, ...] = ()


def _target(name: str) -> Target:
    if name not in TARGETS:
        raise InputError(name, "target", "unknown", f"one of {', '.join(TARGETS)}")
    missing = missing_tools(TARGETS[name])
    if missing:
        raise InputError(
            f"target {name}", "", f"{', '.join(missing)} not found", f"the Debian packages {PACKAGES}"
        )
    return TARGETS[name]


@dataclass(frozen=True)
class EmulatedEcu:
    """Firmware of one vehicle for an emulated processor.

    Attributes
    ----------
    target : str
    program : Path, script that starts it with the arguments of lpvguard_ecu
    elf_sha256 : str, identifies the image
    """

    target: str
    program: Path
    elf_sha256: str


def _emulator(target: Target, elf: Path) -> list[str]:
    """Emulator command for an image, without a console."""
    return [
        *target.emulator,
        "-display",
        "none",
        "-serial",
        "none",
        *target.elf_option.format(elf=elf).split("=", 1),
    ]


def on_can(name: str, elf: Path, interface: str) -> tuple[list[str], str]:
    """Command and standard input that run an image with its CAN controller on a SocketCAN interface.

    Raises InputError like `emulated_ecu`.
    """
    target = _with_can(name)
    host = f"can-host-socketcan,id=can,if={interface},canbus=canbus0"
    command = [*_emulator(target, elf), *target.can, "-object", host, *SEMIHOSTING]
    return command, target.monitor_input or ""


def _with_can(name: str) -> Target:
    """Return the target if its emulated machine has a CAN controller; InputError otherwise."""
    if name in TARGETS and not TARGETS[name].can:
        raise InputError(
            name,
            "target",
            "QEMU's board has no CAN controller",
            ", ".join(["host", *(t.name for t in TARGETS.values() if t.can)]),
        )
    return _target(name)


def emulated_ecu(name: str, vehicle: Path) -> EmulatedEcu:
    """Build the firmware (firmware_sim/ports/cortex_r5_ecu) of a generated folder, bit-equal to the host.

    Parameters
    ----------
    name : str, the target
    vehicle : Path, generated folder

    Returns
    -------
    EmulatedEcu

    Raises
    ------
    InputError
        If tools are missing, the firmware does not build, or the machine has no CAN controller.
    """
    target = _with_can(name)
    ports, ecu = firmware_root() / "ports", firmware_root() / "ecu"
    here = ports / "cortex_r5_ecu"
    program = Program(
        "ecu",
        (
            *sorted(here.glob("*.c*")),
            *sorted((ports / "ecu_process").glob("*.cpp")),
            *sorted(ecu.glob("*.c")),
        ),
        {},
        (here, ports / "ecu_process", ecu),
    )
    elf, _ = _build(target, vehicle, program, (*LANGUAGE, SAME_BITS))
    command = " ".join(map(shlex.quote, [*_emulator(target, elf), *target.can]))
    # Arguments: INTERFACE --engage yes|no --time-line FD. The emulator ends when the simulator ends.
    script = (
        "#!/bin/sh\nexport QEMU_AUDIO_DRV=none\n"
        f'exec setpriv --pdeathsig TERM {command} -chardev "socket,id=time,fd=$5" '
        '-object "can-host-socketcan,id=can,if=$1,canbus=canbus0" '
        '-semihosting-config "enable=on,target=native,chardev=time,arg=$3" '
        f">/dev/null <<'END'\n{target.monitor_input or ''}END\n"
    )
    start = elf.with_suffix(".sh")
    with tempfile.TemporaryDirectory(prefix="build", dir=elf.parent) as scratch:
        new = Path(scratch) / start.name
        new.write_text(script)
        new.chmod(0o755)
        os.replace(new, start)
    return EmulatedEcu(name, start, hashlib.sha256(elf.read_bytes()).hexdigest())


def image_with_debug_information(name: str, vehicle: Path, program: Program) -> Path:
    """ELF file of a program with the core, built as for an ECU with -g. Errors as in `run_target`."""
    return _build(_target(name), vehicle, program, (*LANGUAGE, "-g"))[0]


@dataclass(frozen=True)
class Verdicts:
    """Verdicts of an image with only the monitor.

    Each drive has a list of (sample, verdict) with the changes of the verdict. ``rom`` is as in `run_target`.
    ``ram_bytes`` is the RAM of the monitor.
    """

    changes: list[list[tuple[int, int]]]
    rom: dict[str, int]
    ram_bytes: int


def run_verdicts(
    name: str, vehicle: Path, drives: Sequence[Input], *, double: bool = False, fused: bool = False
) -> Verdicts:
    """Run only the monitor over drives on a target.

    Parameters
    ----------
    name : str, the target
    vehicle : Path, generated folder
    drives : Sequence[Input]
    double : bool, numbers are double, default False
    fused : bool, fuse multiply and add where the processor can, default False

    Returns
    -------
    Verdicts

    Raises
    ------
    InputError
        If tools are missing, or the program does not build or fails.
    """
    target = _target(name)
    numbers = ("-DLPVG_DOUBLE",) if double else ()
    language = (*LANGUAGE, "-ffp-contract=fast" if fused else SAME_BITS, *numbers)
    whole = Input(*(np.concatenate([getattr(drive, field) for drive in drives]) for field in ("v", "u", "y")))
    starts = np.cumsum([0, *(len(drive.v) for drive in drives)])
    header = whole.header() + (
        f"#define TARGET_DRIVES {len(drives)}U\n"
        "static const unsigned long target_drives[TARGET_DRIVES + 1U] = "
        f"{{{', '.join(f'{start}UL' for start in starts)}}};\n"
    )
    program = Program("verdicts", (firmware_root() / "ports" / "verdicts.cpp",), {"target_input.h": header})
    elf, _ = _build(target, vehicle, program, language)
    changes: list[list[tuple[int, int]]] = []
    ram_bytes, ended = 0, False
    for line in run_image(name, elf):
        kind, *words = line.split()
        if kind == "size":
            ram_bytes = int(words[1])
        elif kind == "drive":
            changes.append([])
        elif kind == "verdict":
            changes[-1].append((int(words[0]), int(words[1])))
        ended = kind == "end"
    if not ended:
        raise InputError(f"target {name}", f"run of {elf.name}", "it did not finish", "a last line `end`")
    return Verdicts(changes, _sections(elf)["rom"], ram_bytes)


def run_program(name: str, vehicle: Path, program: Program, *, timeout_s: float = TIMEOUT_S) -> list[str]:
    """Run a program with the core on a target, or on this PC for ``host``.

    The results are bit-equal on all targets.

    Parameters
    ----------
    name : str, target or ``host``
    vehicle : Path, generated folder
    program : Program
    timeout_s : float, s, of the emulator

    Returns
    -------
    list of str, lines that it writes

    Raises
    ------
    InputError
        If tools are missing, or the program does not build or fails.
    """
    if name == "host":
        return _host_lines(vehicle, program)
    elf, _ = _build(_target(name), vehicle, program, (*LANGUAGE, SAME_BITS))
    return run_image(name, elf, timeout_s)


def run_image(name: str, elf: Path, timeout_s: float = TIMEOUT_S) -> list[str]:
    """Run an image in the target's emulator for at most ``timeout_s`` [s] and return its lines.

    Raises InputError when the run fails.
    """
    target = _target(name)
    command = [*_emulator(target, elf), *SEMIHOSTING]
    # Semihosting writes to standard error. QEMU's monitor writes to standard output.
    try:
        done = subprocess.run(
            command,
            input=target.monitor_input or "",
            capture_output=True,
            text=True,
            check=False,
            timeout=timeout_s,
            env={**os.environ, "QEMU_AUDIO_DRV": "none"},
        )
    except subprocess.TimeoutExpired:
        raise InputError(
            f"target {name}", "run", f"no end after {timeout_s:g} s", "a run that ends"
        ) from None
    if done.returncode != 0:
        raise InputError(
            f"target {name}",
            f"run of {elf.name}",
            f"status {done.returncode}: {done.stderr.strip()[-300:]}",
            "a run that ends with status 0",
        )
    return done.stderr.splitlines()


def run_target(name: str, vehicle: Path, drive: Input, *, same_bits: bool) -> dict[str, Any]:
    """Build the benchmark program for a target and run it in QEMU over a drive.

    Parameters
    ----------
    name : str, the target
    vehicle : Path, generated folder
    drive : Input
    same_bits : bool, results are bit-equal on all targets; False allows fused operations, for counting

    Returns
    -------
    dict
        Keys: ``target``, ``elf_sha256``, ``rom {code, coefficients, libraries}``, ``structs {name: bytes}``,
        ``map {section: {address, bytes}}``, ``parts {name: {calls, worst, median, stack}}``, ``imports``,
        ``results``. ``parts`` are in instructions per call and bytes. ``imports`` are the symbols that the
        core's objects need from libraries. ``results`` are text lines.

    Raises
    ------
    InputError
        If tools are missing, or the program does not build or fails.
    """
    target = _target(name)
    program = _bench_of(drive)
    elf, imports = _build(target, vehicle, program, (*LANGUAGE, SAME_BITS) if same_bits else LANGUAGE)
    report = _parse(run_image(name, elf))
    if not report["ended"]:
        raise InputError(f"target {name}", f"run of {elf.name}", "it did not finish", "a last line `end`")
    return {
        "target": name,
        "title": target.title,
        "elf_sha256": hashlib.sha256(elf.read_bytes()).hexdigest(),
        **_sections(elf),
        "imports": imports,
        **report,
    }


def run_evidence(name: str, vehicle: Path) -> dict[str, Any]:
    """Count the instructions of the evidence ring on a target, in a separate image.

    Parameters
    ----------
    name : str, the target
    vehicle : Path, generated folder with an ECU

    Returns
    -------
    dict, ``structs`` and ``parts`` as in `run_target`

    Raises
    ------
    InputError
        If tools are missing, or the program does not build or fails.
    """
    at_rest = Input(np.zeros(EVIDENCE_CALLS), *(np.zeros((EVIDENCE_CALLS, n)) for n in (1, 2)))
    header = at_rest.header() + "#define TARGET_EVIDENCE\n"
    program = Program(
        "evidence_bench", (firmware_root() / "ports" / "target_bench.cpp",), {"target_input.h": header}
    )
    elf, _ = _build(_target(name), vehicle, program, LANGUAGE)
    report = _parse(run_image(name, elf))
    if not report["ended"]:
        raise InputError(f"target {name}", f"run of {elf.name}", "it did not finish", "a last line `end`")
    return report


def run_host(vehicle: Path, drive: Input) -> dict[str, Any]:
    """Run the same program on this PC, where all instruction counts are zero.

    Parameters
    ----------
    vehicle : Path, generated folder
    drive : Input

    Returns
    -------
    dict, ``results`` and ``structs`` as in `run_target`

    Raises
    ------
    InputError
        If it does not build.
    """
    return {"target": "host", **_parse(_host_lines(vehicle, _bench_of(drive)))}


def _bench_of(drive: Input) -> Program:
    return Program(
        "target_bench", (firmware_root() / "ports" / "target_bench.cpp",), {"target_input.h": drive.header()}
    )


def _host_lines(vehicle: Path, program: Program) -> list[str]:
    """Run a program on this PC and return its lines up to the last line ``end``."""
    ports = firmware_root() / "ports"
    with tempfile.TemporaryDirectory() as scratch:
        write_files(Path(scratch), program.headers)
        includes = [
            *program.folders,
            ports,
            Path(scratch),
            library_root() / "include",
            library_root() / "src",
            vehicle,
        ]
        flags = (*CXX[:3], *LANGUAGE, SAME_BITS)
        try:
            objects = core_objects(vehicle)
            objects += [
                native.compile_object(source, flags=flags, include_dirs=includes)
                for source in (*program.sources, ports / "host" / "port.c")
            ]
            executable = native.compile_executable(objects, flags=(), name=program.name)
        except native.NativeError as error:
            raise InputError(
                vehicle, "compiling the target program for the host", str(error), "a C++17 compiler"
            ) from None
    done = subprocess.run([executable], capture_output=True, text=True, check=False)
    lines = done.stdout.splitlines()
    if done.returncode != 0 or lines[-1:] != ["end"]:
        raise InputError(
            vehicle, "running the target program on the host", done.stdout.strip()[-300:], "a run that ends"
        )
    return lines


def _sources(vehicle: Path) -> tuple[list[Path], list[Path]]:
    """Sources of the core and the vehicle."""
    return core_sources(library_root(), Path(vehicle)), sorted(Path(vehicle).glob("*.c"))


def _build(
    target: Target, vehicle: Path, program: Program, language: tuple[str, ...]
) -> tuple[Path, list[str]]:
    """Cached ELF file, and the symbols that the core's objects need from libraries."""
    vehicle = Path(vehicle)
    sources = _named_sources(target, vehicle, program)
    flags = (*target.cpu, *language, *WARNINGS, "-ffunction-sections", "-fdata-sections")
    key = _build_key(target, vehicle, program, sources, flags)
    stem = native.cache_dir() / f"{program.name}_{target.name}-{key}"
    elf, symbols = stem.with_suffix(".elf"), stem.with_suffix(".imports")
    if not (elf.is_file() and symbols.is_file()):
        with tempfile.TemporaryDirectory(prefix="build", dir=stem.parent) as scratch:
            folder = Path(scratch)
            objects = _compile(vehicle, program, sources, flags, folder)
            _link(target, objects, folder / "out.elf", vehicle)
            (folder / "imports").write_text(
                "\n".join(_imports([o for o in objects if not o.name.startswith("port_")]))
            )
            os.replace(folder / "imports", symbols)
            os.replace(folder / "out.elf", elf)
    return elf, symbols.read_text().split()


def _named_sources(target: Target, vehicle: Path, program: Program) -> dict[str, Path]:
    """Sources by object name; the linker scripts select the core's objects by the prefix of the name."""
    ports = firmware_root() / "ports"
    port = ports / target.port
    core_sources, vehicle_sources = _sources(vehicle)
    port_sources = (
        *program.sources,
        ports / "bare_metal" / "bare_metal.c",
        *sorted(port.glob("*.c")),
        *sorted(port.glob("*.S")),
    )
    return {
        **{f"core_{p.stem}": p for p in core_sources},
        **{f"vehicle_{p.stem}": p for p in vehicle_sources},
        **{f"port_{p.stem}": p for p in port_sources},
    }


def _build_key(
    target: Target, vehicle: Path, program: Program, sources: dict[str, Path], flags: tuple[str, ...]
) -> str:
    """Hash of compiler, flags, sources and headers."""
    ports, core = firmware_root() / "ports", library_root()
    key = hashlib.sha256()
    version = subprocess.run(
        ["arm-none-eabi-gcc", "--version"], capture_output=True, text=True, check=True
    ).stdout
    for text in (version, *flags, *CXX, *program.headers.values()):
        key.update(text.encode() + b"\0")
    for path in (
        *sources.values(),
        ports / target.port / target.linker_script,
        *sorted(ports.glob("*.h*")),
        *(h for folder in program.folders for h in sorted(folder.glob("*.h*"))),
        *sorted(vehicle.glob("*.h")),
        *sorted((core / "include").rglob("*.h")),
        *sorted((core / "src").rglob("*.hpp")),
    ):
        key.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return key.hexdigest()[:24]


def _compile(
    vehicle: Path, program: Program, sources: dict[str, Path], flags: tuple[str, ...], folder: Path
) -> list[Path]:
    """Compile all sources into ``folder`` with the program's headers. The core's objects are cached."""
    write_files(folder, program.headers)
    ports, core = firmware_root() / "ports", library_root()
    eigen = ("-isystem", eigen_include())
    includes = [f"-I{p}" for p in (core / "include", core / "src", vehicle, ports, folder, *program.folders)]

    def compile_one(item: tuple[str, Path]) -> Path:
        name, source = item
        if name.startswith("core_"):
            object_file = _core_object(vehicle, source, (*flags, *CXX, *map(str, eigen)))
            return Path(shutil.copyfile(object_file, folder / f"{name}.o"))
        is_cxx = source.suffix == ".cpp"
        dialect = (*CXX, *eigen) if is_cxx else ("-std=gnu99",)
        tool = "arm-none-eabi-g++" if is_cxx else "arm-none-eabi-gcc"
        _tool([tool, *flags, *dialect, *includes, "-c", source, "-o", folder / f"{name}.o"], source)
        return folder / f"{name}.o"

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(compile_one, sources.items()))


def _core_object(vehicle: Path, source: Path, flags: tuple[str, ...]) -> Path:
    """Cached object of one of the core's sources for a vehicle."""
    includes = (library_root() / "include", library_root() / "src", vehicle)
    try:
        return native.compile_object(source, flags=flags, include_dirs=includes, compiler="arm-none-eabi-g++")
    except native.NativeError as error:
        raise InputError(source, "building for the target", str(error), "sources that build") from None


def _link(target: Target, objects: list[Path], elf: Path, vehicle: Path) -> None:
    """Link to ``elf`` with the target's linker script."""
    script = firmware_root() / "ports" / target.port / target.linker_script
    options = ("--specs=nano.specs", "-nostartfiles", "-Wl,--gc-sections", "-Wl,--no-warn-rwx-segments")
    _tool(["arm-none-eabi-g++", *target.cpu, *options, "-T", script, *objects, "-o", elf], vehicle)


def _tool(command: Sequence[object], source: Path) -> str:
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise InputError(
            source,
            "building for the target",
            f"{' '.join(map(str, command))}\n{done.stderr.strip()[:2000]}",
            "sources that build",
        )
    return done.stdout


def _imports(objects: list[Path]) -> list[str]:
    """Symbols that the objects need but do not define."""
    needed: set[str] = set()
    defined: set[str] = set()
    for line in _tool(["arm-none-eabi-nm", *objects], objects[0]).splitlines():
        *_, kind, symbol = line.rsplit(maxsplit=2) if len(line.split()) > 1 else ("", "", "")
        (needed if kind == "U" else defined).add(symbol)
    return sorted(needed - defined)


def _sections(elf: Path) -> dict[str, Any]:
    """``rom``, and ``map`` with the sections that use memory on the target, by address."""
    listed = {}
    for line in _tool(["arm-none-eabi-readelf", "--section-headers", "--wide", elf], elf).splitlines():
        section = re.match(
            r" *\[ *\d+\] (\.\S+) +\w+ +([0-9a-f]{8}) [0-9a-f]{6} ([0-9a-f]{6}) [0-9a-f]{2} +\w*A", line
        )
        if section:
            listed[section[1]] = {"address": int(section[2], 16), "bytes": int(section[3], 16)}
    return {
        "rom": {what: listed.get(name, {"bytes": 0})["bytes"] for name, what in SECTIONS.items()},
        "map": {
            name: s
            for name, s in sorted(listed.items(), key=lambda item: item[1]["address"])
            if s["bytes"] > 0
        },
    }


def _parse(lines: list[str]) -> dict[str, Any]:
    """Parse the output of target_bench.cpp."""
    structs, parts, results = {}, {}, []
    for line in lines:
        kind, *words = line.split() or [""]
        if kind == "size":
            structs[words[0]] = int(words[1])
        elif kind == "part":
            parts[words[0]] = dict(
                zip(("calls", "worst", "median", "stack"), map(int, words[1:]), strict=False)
            )
        elif kind in ("frame", "verdict", "demand"):
            results.append(line.strip())
    return {"structs": structs, "parts": parts, "results": results, "ended": lines[-1:] == ["end"]}
