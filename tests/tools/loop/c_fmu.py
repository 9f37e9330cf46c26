"""FMUs of vehicles in C (c_fmu.h), built for tests."""

import shutil
import subprocess
import zipfile
from pathlib import Path

KINDS = {
    "input": 'causality="input"',
    "parameter": 'causality="parameter" variability="fixed"',
    "output": 'causality="output"',
}

STARTS = {"input": 'start="0"', "parameter": 'start="0"', "output": ""}


def c_fmu(name: str, variables: dict[str, tuple[int, str]], folder: Path) -> Path:
    """Builds NAME.c beside this file to NAME.fmu (FMI 2.0) in a folder.

    ``variables`` holds value reference and causality by name."""
    binary = folder / f"{name}.so"
    source = Path(__file__).with_name(f"{name}.c")
    command = [shutil.which("gcc") or "cc", "-O2", "-shared", "-fPIC", source, "-lm", "-o", binary]
    subprocess.run([str(word) for word in command], check=True)
    scalars = "".join(
        f'<ScalarVariable name="{variable}" valueReference="{reference}" {KINDS[kind]}>'
        f"<Real {STARTS[kind]}/></ScalarVariable>"
        for variable, (reference, kind) in variables.items()
    )
    description = (
        f'<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{{1}}">'
        f'<CoSimulation modelIdentifier="{name}"/>'
        f"<ModelVariables>{scalars}</ModelVariables><ModelStructure/></fmiModelDescription>"
    )
    with zipfile.ZipFile(folder / f"{name}.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", description)
        archive.write(binary, f"binaries/linux64/{name}.so")
    return folder / f"{name}.fmu"
