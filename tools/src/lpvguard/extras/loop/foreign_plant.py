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
from ...vehicle.project import Project
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
TICK_S = 0.01
"""Sample period of the simulated truck."""
OF_OUR_TRUCK = {"speed_profile"}
"""Keys of a scenario's table ``plant`` that affect any FMU. Other keys need the FMU's parameter
``scenario``."""


class Mapped(StrictModel):
    """Our quantity by a variable of the FMU: factor x variable + offset."""

    variable: str
    factor: Annotated[float, Field(allow_inf_nan=False)] = 1.0
    offset: Annotated[float, Field(allow_inf_nan=False)] = 0.0


class PlantMap(StrictModel):
    """Content of the file of ``--map``.

    Attributes
    ----------
    step_s : float or None, s, by default the sample period
    scenario : str or None
    track_m : float or None, m
    parameters : dict, values of parameters by the FMU's names
    inputs : dict, the FMU's names by our names
    outputs : dict, the FMU's names by our names
    """

    step_s: Annotated[float, Field(gt=0, le=1)] | None = None
    scenario: str | None = None
    track_m: Annotated[float, Field(gt=0, le=5)] | None = None
    parameters: dict[str, bool | int | float | str] = Field(default={})
    inputs: dict[str, str | Mapped]
    outputs: dict[str, str | Mapped]


class ForeignPlant:
    """Co-simulation FMU that replaces the vehicle.

    Parameters
    ----------
    path : Path, the FMU
    plant_map : Path or None, by default the FMU has our names
    project : Project or None, a vehicle on its own bus
        Our names are then those of its signal table: inputs are demands; speed and outputs are measured. By
        default they are those of `lpvguard fmu --as plant`.

    Raises
    ------
    InputError
        If the FMU has no binary for this machine or lacks a variable, or if the map is refused.
    """

    def __init__(self, path: Path, plant_map: Path | None = None, project: Project | None = None):
        self.path, self._project = path, project
        self._Ts_s = TICK_S if project is None else project.Ts_s
        self._demands: tuple[str, ...] = INPUTS[:1]
        self._outputs: tuple[str, ...] = OUTPUTS
        if project is not None:
            self._demands = tuple(s.name for s in project.inputs)
            self._outputs = (project.speed.name, *(s.name for s in project.outputs))
        self._inputs = (*self._demands, INPUTS[-1])
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
        inputs: dict[str, str | Mapped] = {n: n for n in self._demands if n in self._variables}
        outputs: dict[str, str | Mapped] = {n: n for n in self._outputs if n in self._variables}
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
        tables = (("inputs", chosen.inputs, self._inputs), ("outputs", chosen.outputs, self._outputs))
        for table, names, known in tables:
            for name in names:
                if name not in known:
                    raise InputError(self._where, f"{table}.{name}", "unknown", f"one of {', '.join(known)}")
        for name in self._demands:
            if name not in chosen.inputs:
                raise InputError(self._where, f"inputs.{name}", "missing", "the FMU's input for the demand")
        steps = self._Ts_s / (chosen.step_s or self._Ts_s)
        if abs(steps - round(steps)) > 1e-9:
            expected = f"a whole part of {self._Ts_s:g} s"
            raise InputError(self._where, "step_s", f"{chosen.step_s:g}", expected)
        for name in REQUIRED if self._project is None else self._outputs:
            if name not in outputs:
                raise InputError(self._where, f"outputs.{name}", "missing", "a variable of the FMU")
        if self._project is not None:
            return
        if not outputs.issuperset(WHEELS) and chosen.track_m is None:
            raise InputError(
                self._where, "outputs", "without all wheel speeds", f"{', '.join(WHEELS)}, or track_m"
            )
        if not outputs.issuperset(PRESSURES) and "brake_pressure_difference" not in outputs:
            expected = f"{' and '.join(PRESSURES)}, or brake_pressure_difference"
            raise InputError(self._where, "outputs", "without brake pressure", expected)

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
        tables: tuple[tuple[str, dict, tuple[str, ...]], ...] = (
            ("inputs", self.map.inputs, self._inputs),
            ("outputs", self.map.outputs, self._outputs),
        )
        for table, names, order in tables:
            entries = []
            for name in (n for n in order if n in names):
                value = names[name]
                mapped = Mapped(variable=value) if isinstance(value, str) else value
                reference = self._find(f"{table}.{name}", mapped.variable, NUMBERS)[1]
                entries.append(
                    f"{{name = {json.dumps(self._role(table, name))}, reference = {reference}, "
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
        if self._project is not None:
            lines.append(f"controlled = {1 + self._project.controlled}")
        return lines

    def _role(self, table: str, name: str) -> str:
        """Name for the simulator, which knows the speed of every vehicle."""
        is_speed = table == "outputs" and self._project is not None and name == self._project.speed.name
        return "speed" if is_speed else name

    def linked(self, scenario: Path, folder: Path) -> Path:
        """Unpack the FMU into a new folder, and return the file that links it.

        The file is described in firmware_sim/sim/vehicle_model.hpp. Raises InputError if the scenario changes
        the truck, and the FMU has no parameter for scenarios.
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
            "tick_s": self._Ts_s,
            "step_s": self.map.step_s or self._Ts_s,
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
