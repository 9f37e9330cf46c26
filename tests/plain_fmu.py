"""An FMU of either version under fmpy, without event mode."""

import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

from lpvguard.core.compiled import eigen_include

BUILD = ("SourceFile", "IncludeDirectory", "PreprocessorDefinition")


def compile_sources(path: Path, folder: Path) -> int:
    """Compile an FMU's sources as its build description says; returns their number."""
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    root = ElementTree.parse(folder / "sources/buildDescription.xml")
    words = [[node.get("name") for node in root.iter(tag)] for tag in BUILD]
    sources, includes, defines = words
    options = [f"-I{folder}" for folder in (*includes, eigen_include())] + [f"-D{name}" for name in defines]
    command = ["g++", "-std=c++17", "-fsyntax-only", "-x", "c++", *options, *sources]
    done = subprocess.run(command, cwd=folder / "sources", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return len(sources)


class Running:
    """An FMU that runs in this process, of either version."""

    def __init__(self, path: Path, folder: Path, version: int):
        self.version, self.said = version, []
        self.description = fmpy.read_model_description(str(path))
        self.period = float(self.description.defaultExperiment.stepSize)
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        arguments = {
            "guid": self.description.guid if version == 2 else self.description.instantiationToken,
            "unzipDirectory": fmpy.extract(str(path), str(folder)),
            "modelIdentifier": self.description.coSimulation.modelIdentifier,
        }
        self.fmu = (FMU2Slave if version == 2 else FMU3Slave)(**arguments)
        self.fmu.instantiate(**({} if version == 2 else {"logMessage": self._heard}))
        if version == 2:
            self.fmu.setupExperiment()
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def _heard(self, _environment, _status, _category, message) -> None:
        self.said.append(message.decode())

    def feed(self, inputs: np.ndarray) -> None:
        references = range(len(inputs))
        (self.fmu.setReal if self.version == 2 else self.fmu.setFloat64)(list(references), inputs.tolist())

    def set(self, **values: float) -> None:
        setter = self.fmu.setReal if self.version == 2 else self.fmu.setFloat64
        setter([self.references[name] for name in values], list(values.values()))

    def numbers(self, *names: str) -> list[float]:
        getter = self.fmu.getReal if self.version == 2 else self.fmu.getFloat64
        return getter([self.references[name] for name in names])

    def codes(self, *names: str) -> list[int]:
        getter = self.fmu.getInteger if self.version == 2 else self.fmu.getInt64
        return getter([self.references[name] for name in names])

    def step(self, t: float, inputs: np.ndarray | None = None, period: float | None = None) -> None:
        if inputs is not None:
            self.feed(inputs)
        self.fmu.doStep(t, period or self.period)

    def state(self) -> bytes:
        """The serialized state."""
        if self.version == 2:
            kept = self.fmu.getFMUstate()
            data = self.fmu.serializeFMUstate(kept)
            self.fmu.freeFMUstate(kept)
        else:
            kept = self.fmu.getFMUState()
            data = self.fmu.serializeFMUState(kept)
            self.fmu.freeFMUState(kept)
        return bytes(data)

    def restore(self, data: bytes) -> None:
        if self.version == 2:
            kept = self.fmu.deSerializeFMUstate(data)
            self.fmu.setFMUstate(kept)
            self.fmu.freeFMUstate(kept)
        else:
            kept = self.fmu.deserializeFMUState(data)
            self.fmu.setFMUState(kept)
            self.fmu.freeFMUState(kept)
