"""Use an FMU as the vehicle of `lpvguard sim`.

A map names the variables of the FMU (`PlantMap`; example in tools/site/pages/howto/simulate.md).
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Annotated, Any
from xml.etree import ElementTree

from pydantic import Field

from ...base.documents import StrictModel, checked, read_toml
from ...base.errors import InputError
from ..fmu.package import BINARY

WHEELS = tuple(f"wheel_speed_{wheel}" for wheel in ("front_left", "front_right", "rear_left", "rear_right"))
PRESSURES = ("brake_pressure_left", "brake_pressure_right")
REQUIRED = ("speed", "yaw_rate", "steering_wheel_angle", "lateral_acceleration")
TRUTH = ("true_speed", "true_yaw_rate", "true_lateral_acceleration", "true_road_wheel_angle")
OUTPUTS = (*REQUIRED, *WHEELS, *PRESSURES, "brake_pressure_difference", *TRUTH)
"""Quantities that the loop reads from the FMU, in m/s, rad/s, rad, m/s2 and bar. Left is positive."""
INPUTS = ("brake_demand", "speed")
"""Quantities that the loop writes to the FMU."""
NUMBERS = ("Real", "Float64")
OF_OUR_TRUCK = {"speed_profile"}
"""Keys of a scenario's table ``plant`` that affect any FMU. Other keys need the FMU's parameter
``scenario``."""


class MappedOutput(StrictModel):
    """Our quantity from a variable of the FMU: factor x variable + offset.

    Attributes
    ----------
    variable : str
    factor, offset : float
    """

    variable: str
    factor: Annotated[float, Field(allow_inf_nan=False)] = 1.0
    offset: Annotated[float, Field(allow_inf_nan=False)] = 0.0


class PlantMap(StrictModel):
    """Content of the file of ``--map``.

    Attributes
    ----------
    step_s : float, s
    scenario : str or None
    track_m : float or None, m
    parameters : dict, values of parameters by the FMU's names
    inputs : dict, the FMU's names by our names
    outputs : dict, the FMU's names by our names
    """

    step_s: Annotated[float, Field(gt=0, le=0.01)] = 0.01
    scenario: str | None = None
    track_m: Annotated[float, Field(gt=0, le=5)] | None = None
    parameters: dict[str, bool | int | float | str] = Field(default={})
    inputs: dict[str, str]
    outputs: dict[str, str | MappedOutput]


class ForeignPlant:
    """Co-simulation FMU that replaces the vehicle.

    Parameters
    ----------
    path : Path, the FMU
    plant_map : Path or None, by default the names are those of `lpvguard fmu --as plant`

    Raises
    ------
    InputError
        If the FMU has no binary for this machine or lacks a variable, or if the map is refused.
    """

    def __init__(self, path: Path, plant_map: Path | None = None):
        self.path = path
        try:
            with zipfile.ZipFile(path) as archive:
                root = ElementTree.fromstring(archive.read("modelDescription.xml"))
                self._names = archive.namelist()
        except (OSError, zipfile.BadZipFile, KeyError, ElementTree.ParseError) as error:
            raise InputError(path, "--plant", f"cannot be read ({error})", "an FMU") from None
        self.version = int(float(root.get("fmiVersion", "0")))
        element = root.find("CoSimulation")
        if self.version not in BINARY or element is None:
            raise InputError(path, "--plant", "no co-simulation of FMI 2 or 3", "a co-simulation FMU")
        self._identifier = element.get("modelIdentifier", "")
        self._token = root.get("guid") or root.get("instantiationToken") or ""
        self.library = f"{BINARY[self.version]}/{self._identifier}.so"
        if self.library not in self._names:
            raise InputError(path, self.library, "missing", "a binary for x86-64 Linux")
        self._variables = dict(_variables(root, self.version))
        self._where: Path = plant_map or path
        self.map = self._own_names() if plant_map is None else self._read(plant_map)
        self._require_outputs()
        self._link = self._linked_variables()

    def _own_names(self) -> PlantMap:
        inputs = {name: name for name in INPUTS[:1] if name in self._variables}
        outputs: dict[str, str | MappedOutput] = {name: name for name in OUTPUTS if name in self._variables}
        scenario = "scenario" if "scenario" in self._variables else None
        return PlantMap(inputs=inputs, outputs=outputs, scenario=scenario)

    @staticmethod
    def _read(path: Path) -> PlantMap:
        return checked(
            PlantMap, read_toml(path, "a map of an FMU's variables"), "a map of an FMU's variables", path
        )

    def _require_outputs(self) -> None:
        """Raise InputError for an unknown name, and for a missing quantity that the loop needs."""
        chosen, outputs = self.map, set(self.map.outputs)
        for table, names, known in (("inputs", chosen.inputs, INPUTS), ("outputs", chosen.outputs, OUTPUTS)):
            for name in names:
                if name not in known:
                    raise InputError(self._where, f"{table}.{name}", "unknown", f"one of {', '.join(known)}")
        if "brake_demand" not in chosen.inputs:
            raise InputError(self._where, "inputs.brake_demand", "missing", "the FMU's input for the demand")
        for name in REQUIRED:
            if name not in outputs:
                raise InputError(self._where, f"outputs.{name}", "missing", "a variable of the FMU")
        if not outputs.issuperset(WHEELS) and chosen.track_m is None:
            raise InputError(
                self._where, "outputs", "without all wheel speeds", f"{', '.join(WHEELS)}, or track_m"
            )
        if not outputs.issuperset(PRESSURES) and "brake_pressure_difference" not in outputs:
            expected = f"{' and '.join(PRESSURES)}, or brake_pressure_difference"
            raise InputError(self._where, "outputs", "without brake pressure", expected)
        steps = 0.01 / chosen.step_s
        if abs(steps - round(steps)) > 1e-9:
            raise InputError(self._where, "step_s", f"{chosen.step_s:g}", "a whole part of 0.01 s")

    def _find(self, where: str, name: str, types: tuple[str, ...] = ()) -> tuple[str, int]:
        """Return the type and the value reference of a variable of the FMU."""
        if name not in self._variables:
            near = ", ".join(sorted(self._variables)[:20])
            raise InputError(self._where, where, f"{self.path} has no variable {name}", f"one of {near}")
        kind, reference = self._variables[name]
        if types and kind not in types:
            raise InputError(self._where, where, f"{name} is of type {kind}", " or ".join(types))
        return kind, reference

    def _linked_variables(self) -> list[str]:
        """Write the lines about the FMU's variables for the file that the simulator reads."""
        lines = []
        for table, names in (("inputs", self.map.inputs), ("outputs", self.map.outputs)):
            entries = []
            for name, value in names.items():
                mapped = MappedOutput(variable=value) if isinstance(value, str) else value
                reference = self._find(f"{table}.{name}", mapped.variable, NUMBERS)[1]
                entries.append(
                    f"{{name = {json.dumps(name)}, reference = {reference}, "
                    f"factor = {mapped.factor!r}, offset = {mapped.offset!r}}}"
                )
            lines.append(f"{table} = [{', '.join(entries)}]")
        parameters = []
        for name, number in self.map.parameters.items():
            kind, reference = self._find(f"parameters.{name}", name)
            kind = "Boolean2" if kind == "Boolean" and self.version == 2 else kind
            parameters.append(f'{{type = "{kind}", reference = {reference}, value = {json.dumps(number)}}}')
        lines.append(f"parameters = [{', '.join(parameters)}]")
        if self.map.scenario is not None:
            lines.append(f"scenario = {self._find('scenario', self.map.scenario, ('String',))[1]}")
        if self.map.track_m is not None:
            lines.append(f"track_m = {self.map.track_m!r}")
        return lines

    def linked(self, scenario: Path, folder: Path) -> Path:
        """Unpack the FMU for a run.

        Parameters
        ----------
        scenario : Path, scenario file
        folder : Path, new folder

        Returns
        -------
        Path
            File that links the FMU (firmware_sim/sim/vehicle_model.hpp).

        Raises
        ------
        InputError
            If the scenario changes the truck, and the FMU has no parameter for scenarios.
        """
        plant = read_toml(scenario, "a scenario file").get("plant", {})
        beyond = sorted(set(plant) - OF_OUR_TRUCK) if isinstance(plant, dict) else []
        if beyond and self.map.scenario is None:
            expected = "a scenario without it, or an FMU with a parameter for the scenario"
            raise InputError(
                scenario, f"plant.{beyond[0]}", f"acts on our truck, not on {self.path}", expected
            )
        with zipfile.ZipFile(self.path) as archive:
            archive.extractall(folder)
        (folder / "resources").mkdir(exist_ok=True)
        words: dict[str, Any] = {
            "library": str(folder / self.library),
            "version": self.version,
            "token": self._token,
            "resources": str(folder / "resources"),
            "step_s": self.map.step_s,
        }
        link = folder / "link.toml"
        lines = [f"{key} = {json.dumps(value)}" for key, value in words.items()]
        link.write_text("\n".join([*lines, *self._link]) + "\n", encoding="utf-8")
        return link


def _variables(root: ElementTree.Element, version: int) -> list[tuple[str, tuple[str, int]]]:
    """Name, type and value reference of each variable."""
    variables = []
    for node in root.iterfind("ModelVariables/*"):
        kind = next(child.tag for child in node if child.tag != "Annotations") if version == 2 else node.tag
        variables.append((node.get("name", ""), (kind, int(node.get("valueReference", "0")))))
    return variables
