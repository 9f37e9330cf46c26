"""Builds the FMUs: compiles the core and a unit around it, and packs binary, sources and descriptions."""

import hashlib
import io
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ...base.errors import InputError
from ...can.catalogue import load_catalogue
from ...can.own_loop import REST_HEADER
from ...core.compiled import DIAGNOSIS_SOURCE, Core, firmware_root, library_root, shared_core
from ...vehicle.project import Project
from .description import build_description, has_terminal, model_description, terminals
from .signals import HEADER, own_signals_header, signals_header
from .variables import (
    Variable,
    ecu_variables,
    monitor_variables,
    own_inputs,
    plain_inputs,
    plant_variables,
    received_messages,
)

BINARY = {2: "binaries/linux64", 3: "binaries/x86_64-linux"}
"""Folder of the binary, by the version of FMI."""
HERE = Path(__file__).parent
DIAGNOSIS_DEFINE = "LPVG_FMU_DIAGNOSIS"
LINK_FLAGS = ("-static-libstdc++", "-static-libgcc", f"-Wl,--version-script={HERE / 'exports.map'}")
"""Only FMI's functions are visible: FMUs and other C++ libraries of one process share no symbol."""


@dataclass(frozen=True)
class _Unit:
    """Parts of one kind of FMU beside the core.

    Attributes
    ----------
    kind, text : str, part of the identifier; what it is
    variables : sequence of Variable
    sources : sequence of Path, of C and C++
    folders : sequence of Path, of their headers
    core : sequence of str, patterns of the core's sources below lib/
    generated : dict, further headers by name
    flags : sequence of str, of the compiler
    serializes : bool, whether a state can become bytes
    """

    kind: str
    text: str
    variables: Sequence[Variable]
    sources: Sequence[Path]
    folders: Sequence[Path] = ()
    core: Sequence[str] = ("src/monitor/*.[ch]pp",)
    generated: dict[str, str] = field(default_factory=dict)
    flags: Sequence[str] = ()
    serializes: bool = True


def monitor_fmu(project: Project, folder: Path, version: int) -> bytes:
    """Return a vehicle's monitor as a co-simulation FMU.

    Parameters
    ----------
    project : Project
    folder : Path, generated folder of the vehicle, by ``lpvguard export``
    version : int, version of FMI, 2 or 3

    Returns
    -------
    bytes
        The archive. The same inputs and compiler give the same bytes.

    Raises
    ------
    InputError
        The folder is incomplete or does not compile.
    """
    core = Core(folder)
    variables = monitor_variables(project, core.thresholds)
    text = f"Nominal-error monitor of {project.title}"
    return _fmu(project, core, version, _Unit("monitor", text, variables, [HERE / "monitor.cpp"]))


def ecu_fmu(project: Project, folder: Path, version: int) -> bytes:
    """Return a vehicle's ECU as a co-simulation FMU: its firmware, with a CAN terminal in FMI 3.0.

    Parameters
    ----------
    project : Project
    folder : Path, generated folder of the vehicle with a controller
    version : int, version of FMI, 2 or 3

    Returns
    -------
    bytes
        The archive. The same inputs and compiler give the same bytes.

    Raises
    ------
    InputError
        The vehicle has no ECU, the folder is incomplete or does not compile.
    """
    core, root = _core_of_ecu(folder, "--as ecu"), firmware_root()
    own = (folder / REST_HEADER).is_file()
    received = [] if own else received_messages(load_catalogue())
    inputs = own_inputs(project) if own else plain_inputs(received)
    header = own_signals_header(inputs) if own else signals_header(received)
    unit = _Unit(
        "ecu",
        f"Guarded controller's ECU of {project.title}",
        ecu_variables(project, core.thresholds, inputs, core.period_s),
        [HERE / "ecu.cpp", root / "ecu" / "firmware.c"],
        [root / "ecu", root / "ports"],
        ["src/**/*.[ch]pp"],
        {HEADER: header},
    )
    return _fmu(project, core, version, unit)


def plant_fmu(project: Project, folder: Path, version: int) -> bytes:
    """Return the simulated truck as a co-simulation FMU, with a CAN terminal in FMI 3.0.

    Parameters
    ----------
    project : Project, of the truck
    folder : Path, its generated folder with a controller
    version : int, version of FMI, 2 or 3

    Returns
    -------
    bytes
        The archive. The same inputs and compiler give the same bytes.

    Raises
    ------
    InputError
        The vehicle has no ECU, there is no checkout, or something does not compile.
    """
    core, root = _core_of_ecu(folder, "--as plant"), firmware_root()
    if (folder / REST_HEADER).is_file():
        raise InputError(folder, "--as plant", "a vehicle on its own bus", "the simulated truck's folder")
    truth, sim = root / "plant", root / "sim"
    scenario = (root / "scenarios" / "nominal.toml").read_text(encoding="utf-8")
    texts = {"truck_text": (truth / "truck.toml").read_text(encoding="utf-8"), "scenario_text": scenario}
    lines = [f'inline constexpr const char* {name} = R"toml({text})toml";\n' for name, text in texts.items()]
    unit = _Unit(
        "plant",
        "Simulated two-axle truck steered by braking",
        plant_variables(scenario, core.period_s),
        [
            HERE / "plant.cpp",
            *sorted((truth / "src").glob("*.cpp")),
            *(sim / f"{name}.cpp" for name in ("command", "scenario", "truck_node", "vehicle_node")),
            root / "ecu" / "firmware.c",
        ],
        [truth / "include", truth / "src", sim, root / "ecu", root / "ports"],
        ["src/**/*.[ch]pp"],
        {"lpvg_fmu_texts.hpp": "#pragma once\n" + "".join(lines)},
        ("-fexceptions", "-frtti"),
        serializes=False,
    )
    return _fmu(project, core, version, unit)


def _core_of_ecu(folder: Path, where: str) -> Core:
    """Return the core of a folder with an ECU."""
    if not (folder / "lpvguard_bus.c").is_file():
        expected = "a folder exported with a controller whose demand a CAN message carries"
        raise InputError(folder, where, "the vehicle has no ECU", expected)
    return Core(folder)


def _fmu(project: Project, core: Core, version: int, unit: _Unit) -> bytes:
    """Return the archive of a unit around a vehicle's core."""
    name = f"lpvguard_{project.name}_{unit.kind}"
    defines = [DIAGNOSIS_DEFINE] if core.diagnoses else []
    flags = [*unit.flags, *(f"-D{define}" for define in defines)]
    own = [*unit.sources, HERE / "fmi.cpp"]
    sources = _sources(core.folder, unit, own)
    compiled = sorted(path for path in sources if path.endswith((".cpp", ".c")))
    with tempfile.TemporaryDirectory() as scratch:
        for header, text in unit.generated.items():
            (Path(scratch) / header).write_text(text)
        folders = [*unit.folders, Path(scratch)]
        library = shared_core(core.folder, own, "fmu", flags=flags, link=LINK_FLAGS, include_dirs=folders)
        binary = library.read_bytes()
    token = hashlib.sha256(binary)
    for path, content in sources.items():
        token.update(path.encode() + b"\0" + content)
    digest = "{" + token.hexdigest()[:32] + "}"
    description = model_description(
        version, name, unit.text, digest, core.period_s, unit.variables, compiled, serializes=unit.serializes
    )
    files = {"modelDescription.xml": description, f"{BINARY[version]}/{name}.so": binary}
    files |= {f"sources/{path}": content for path, content in sources.items()}
    if version == 3:
        includes = [".", "include", "src", "vehicle", *map(_place, unit.folders)]
        files["sources/buildDescription.xml"] = build_description(name, compiled, includes, defines)
        files |= terminals(unit.variables) if has_terminal(unit.variables) else {}
    return _archive(files)


def _sources(folder: Path, unit: _Unit, own: Sequence[Path]) -> dict[str, bytes]:
    """Return unit, core and generated folder by their paths below ``sources/``."""
    root = library_root()
    patterns = ["include/**/*.h", *unit.core]
    if (folder / DIAGNOSIS_SOURCE).is_file():
        patterns.append("src/services/diagnosis*.[ch]pp")
    paths = {str(path.relative_to(root)): path for pattern in patterns for path in root.glob(pattern)}
    paths |= {f"vehicle/{path.name}": path for path in sorted(folder.glob("*.[ch]"))}
    headers = [path for place in (HERE, *unit.folders) for path in sorted(place.rglob("*.h*"))]
    paths |= {_place(path): path for path in (*own, *headers)}
    return {name: path.read_bytes() for name, path in paths.items()} | {
        name: text.encode() for name, text in unit.generated.items()
    }


def _place(path: Path) -> str:
    """Return where a file or folder of this room, or of firmware_sim/, lies below ``sources/``."""
    return path.name if path.parent == HERE else str(path.relative_to(firmware_root().parent))


def _archive(files: dict[str, bytes]) -> bytes:
    """Return a ZIP archive without clock times."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, files[name])
    return out.getvalue()
