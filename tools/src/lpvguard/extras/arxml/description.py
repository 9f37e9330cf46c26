"""ARXML of a monitor's software component: types, units, interfaces, ports, runnables, parameters."""

import re
from collections.abc import Sequence
from typing import Any

from ...base.optional import optional
from ..fmu.variables import ENUMERATIONS, Variable

RELEASE = "4.2.2"
"""Release of the AUTOSAR schema."""
SIGNALS, ASSESSMENT = "Signals", "Assessment"
"""Names of the required port and of the provided port."""


def type_of(variable: Variable) -> str:
    """Return the platform type of a variable: float32, uint32, or uint8 of an enumeration."""
    return {"real": "float32", "integer": "uint32"}.get(variable.kind, "uint8")


def description(
    name: str,
    period_s: float,
    received: Sequence[Variable],
    sent: Sequence[Variable],
    parameters: dict[str, float],
    coefficients_crc: int,
) -> str:
    """Write the ARXML of a component (AUTOSAR Classic Platform 4.2.2, Software Component Template).

    ``received`` and ``sent`` are the elements of the required and of the provided port. ``parameters`` holds
    the thresholds of the coefficients, and ``coefficients_crc`` their CRC-32. Raises InputError without the
    package autosar.
    """
    autosar = optional("autosar", "autosar")
    workspace = autosar.workspace(version=RELEASE)
    types = _types(workspace, (*received, *sent))
    interfaces = workspace.createPackage("Interfaces", role="PortInterface")
    components = workspace.createPackage("Components", role="ComponentType")
    component = components.createApplicationSoftwareComponent(name)
    access = []
    for port, elements in ((SIGNALS, received), (ASSESSMENT, sent)):
        interface = f"{port}_I"
        interfaces.createSenderReceiverInterface(
            interface, [autosar.DataElement(v.name, f"{v.name}_T") for v in elements]
        )
        initial = [{"dataElement": v.name, "initValue": _initial(v)} for v in elements]
        create = component.createRequirePort if port == SIGNALS else component.createProvidePort
        create(port, interface, comspec=initial)
        access += [f"{port}/{v.name}" for v in elements]
    behavior = component.behavior
    behavior.createRunnable(f"{name}_Init")
    behavior.createRunnable(f"{name}_Step", portAccess=access)
    behavior.createInitEvent(f"{name}_Init")
    behavior.createTimingEvent(f"{name}_Step", period=period_s * 1e3)
    types.createImplementationDataType("threshold_T", "/DataTypes/BaseTypes/float32")
    types.createImplementationDataType("crc32_T", "/DataTypes/BaseTypes/uint32")
    stated = {key: (value, "threshold_T") for key, value in parameters.items()}
    for key, (value, kind) in (stated | {"coefficients_crc32": (coefficients_crc, "crc32_T")}).items():
        number = autosar.constant.NumericalValue(None, value)
        behavior.createSharedDataParameter(key, kind, swCalibrationAccess="READ-ONLY", initValue=number)
    return workspace.toXML() + "\n"


def _types(workspace: Any, variables: Sequence[Variable]) -> Any:
    """Create the package of types: one for each variable, with its unit, range or names."""
    types = workspace.createPackage("DataTypes", role="DataType")
    base = types.createSubPackage("BaseTypes")
    for name, bits, encoding in (("float32", 32, "IEEE754"), ("uint32", 32, None), ("uint8", 8, None)):
        base.createSwBaseType(name, bits, encoding=encoding, nativeDeclaration=name)
    types.createSubPackage("CompuMethods", role="CompuMethod")
    types.createSubPackage("DataConstrs", role="DataConstraint")
    types.createSubPackage("Units", role="Unit")
    for unit in sorted({v.unit for v in variables if v.kind == "real"}):
        types.createUnit(_short_name(unit), unit)
    for v in variables:
        settings: dict[str, Any] = {}
        if v.kind in ENUMERATIONS:
            settings["valueTable"] = list(ENUMERATIONS[v.kind])
        elif v.kind == "real":
            settings = {"unit": _short_name(v.unit), "offset": 0, "scaling": 1, "forceFloat": True}
            if v.low is not None and v.high is not None:  # as text: the package makes integers of numbers
                settings |= {"lowerLimit": repr(float(v.low)), "upperLimit": repr(float(v.high))}
        types.createImplementationDataType(f"{v.name}_T", f"/DataTypes/BaseTypes/{type_of(v)}", **settings)
    return types


def _initial(variable: Variable) -> float:
    """Return the value before the first one: the start of an input, else 0."""
    return 0 if variable.kind != "real" else float(variable.start or 0.0)


def _short_name(unit: str) -> str:
    """Return a unit as an identifier: m/s becomes unit_m_per_s."""
    words = unit.replace("/", "_per_").replace("*", "_").replace("^", "")
    return "unit_" + re.sub(r"\W", lambda c: f"_{ord(c[0]):X}_", words, flags=re.ASCII)
