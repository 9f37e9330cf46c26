"""Builds the FMU: compiles the core, and packs binary, sources and descriptions."""

import hashlib
import io
import zipfile
from pathlib import Path

from ...core.compiled import DIAGNOSIS_SOURCE, Core, library_root, shared_core
from ...vehicle.project import Project
from .description import build_description, model_description
from .variables import monitor_variables

BINARY = {2: "binaries/linux64", 3: "binaries/x86_64-linux"}
"""Folder of the binary, by the version of FMI."""
WRAPPER = Path(__file__).with_name("monitor.cpp")
DIAGNOSIS_DEFINE = "LPVG_FMU_DIAGNOSIS"
LINK_FLAGS = ("-static-libstdc++", "-static-libgcc")


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
    name = f"lpvguard_{project.name}_monitor"
    sources = _sources(folder)
    compiled = sorted(path for path in sources if path.endswith((".cpp", ".c")))
    defines = [DIAGNOSIS_DEFINE] if core.diagnoses else []
    flags = [f"-D{define}" for define in defines]
    binary = shared_core(folder, WRAPPER, "fmu", flags=flags, link=LINK_FLAGS).read_bytes()
    variables = monitor_variables(project, core.thresholds)
    token = hashlib.sha256(binary)
    for path, content in sources.items():
        token.update(path.encode() + b"\0" + content)
    description = model_description(
        version, name, project.title, "{" + token.hexdigest()[:32] + "}", core.period_s, variables, compiled
    )
    files = {"modelDescription.xml": description, f"{BINARY[version]}/{name}.so": binary}
    files |= {f"sources/{path}": content for path, content in sources.items()}
    if version == 3:
        files["sources/buildDescription.xml"] = build_description(
            name, compiled, ("include", "src", "vehicle"), defines
        )
    return _archive(files)


def _sources(folder: Path) -> dict[str, bytes]:
    """Return the wrapper, the monitor and the generated folder by their paths below ``sources/``."""
    root = library_root()
    patterns = ["include/**/*.h", "src/monitor/*.[ch]pp"]
    if (folder / DIAGNOSIS_SOURCE).is_file():
        patterns.append("src/services/diagnosis*.[ch]pp")
    paths = {str(path.relative_to(root)): path for pattern in patterns for path in root.glob(pattern)}
    paths |= {f"vehicle/{path.name}": path for path in sorted(folder.glob("*.[ch]"))}
    return {"monitor_fmu.cpp": WRAPPER.read_bytes()} | {
        name: path.read_bytes() for name, path in paths.items()
    }


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
