"""modelDescription.xml of an FMU, for FMI 2.0 and FMI 3.0, buildDescription.xml of its sources, and what
FMI-LS-BUS wants of an FMU with a CAN terminal."""

from collections.abc import Sequence
from xml.etree import ElementTree as xml

from ... import __version__
from .variables import ENUMERATIONS, Variable

TOOL = f"lpvguard {__version__}"
_VARIABILITY = {"independent": "continuous", "parameter": "fixed"}
MIME = 'application/org.fmi-standard.fmi-ls-bus.can; version="1.0.0"'
MAX_BYTES = 4096
"""Most bytes of a terminal's data, as in ls_bus.hpp."""
LOG_CATEGORIES = ("logStatusWarning", "logStatusError")


def model_description(
    version: int,
    name: str,
    text: str,
    token: str,
    period_s: float,
    variables: Sequence[Variable],
    sources: Sequence[str],
    *,
    serializes: bool = True,
) -> bytes:
    """Return modelDescription.xml of FMI ``version`` 2 or 3. ``name`` is the model identifier, ``text`` says
    what it is, ``token`` identifies the binary and the variables together. ``period_s`` is the only step
    size. ``sources`` lie below ``sources/``. ``serializes`` says that a
    state can become bytes.
    """
    step = f"{period_s:.9g}"
    root = xml.Element(
        "fmiModelDescription",
        {
            "fmiVersion": f"{version}.0",
            "modelName": name,
            ("guid" if version == 2 else "instantiationToken"): token,
            "description": text,
            "generationTool": TOOL,
            "variableNamingConvention": "structured",
        },
    )
    state = "FMUstate" if version == 2 else "FMUState"
    simulation = {
        "modelIdentifier": name,
        "canHandleVariableCommunicationStepSize": "false",
        f"canGetAndSet{state}": "true",
        f"canSerialize{state}": str(serializes).lower(),
    }
    if version == 3:
        simulation["fixedInternalStepSize"] = step
        simulation["hasEventMode"] = str(has_terminal(variables)).lower()
    element = xml.SubElement(root, "CoSimulation", simulation)
    if version == 2:
        files = xml.SubElement(element, "SourceFiles")
        for source in sources:
            xml.SubElement(files, "File", name=source)
    if version == 2:
        variables = [v for v in variables if v.kind not in ("binary", "clock")]
    _append_types(root, version, variables)
    xml.SubElement(root, "DefaultExperiment", startTime="0", stepSize=step)
    listed = xml.SubElement(root, "ModelVariables")
    for variable in variables:
        (_variable_2 if version == 2 else _variable_3)(listed, variable)
    _append_structure(root, version, variables)
    return _text(root)


def has_terminal(variables: Sequence[Variable]) -> bool:
    """Return whether there is a CAN terminal."""
    return any(v.kind == "clock" for v in variables)


def terminals(variables: Sequence[Variable]) -> dict[str, bytes]:
    """Return the files of FMI-LS-BUS by their path: the terminal and the manifest."""
    root = xml.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    kind = {"terminalKind": "org.fmi-ls-bus.network-terminal", "matchingRule": "org.fmi-ls-bus.transceiver"}
    terminal = xml.SubElement(xml.SubElement(root, "Terminals"), "Terminal", {"name": "CAN"} | kind)
    for variable in variables:
        if variable.kind in ("binary", "clock"):
            member = {"variableName": variable.name, "memberName": variable.name.removeprefix("CAN.")}
            xml.SubElement(terminal, "TerminalMemberVariable", {"variableKind": "signal"} | member)
    namespace = "http://fmi-standard.org/fmi-ls-manifest"
    xml.register_namespace("fmi-ls", namespace)
    named = {
        "name": "org.fmi-standard.fmi-ls-bus",
        "version": "1.0.0",
        "description": "Layered Standard for the simulation of bus communication",
    }
    attributes = {f"{{{namespace}}}fmi-ls-{key}": value for key, value in named.items()}
    manifest = xml.Element("fmiLayeredStandardManifest", attributes | {"isBusSimulationFMU": "false"})
    return {
        "terminalsAndIcons/terminalsAndIcons.xml": _text(root),
        "extra/org.fmi-standard.fmi-ls-bus/fmi-ls-manifest.xml": _text(manifest),
    }


def _append_types(root: xml.Element, version: int, variables: Sequence[Variable]) -> None:
    """Append the units, the core's enumerations that occur, and the categories of messages."""
    units = xml.SubElement(root, "UnitDefinitions")
    for unit in sorted({v.unit for v in variables if v.kind == "real"}):
        xml.SubElement(units, "Unit", name=unit)
    types = xml.SubElement(root, "TypeDefinitions")
    for kind, names in ENUMERATIONS.items():
        if not any(v.kind == kind for v in variables):
            continue
        if version == 2:
            items = xml.SubElement(xml.SubElement(types, "SimpleType", name=kind), "Enumeration")
        else:
            items = xml.SubElement(types, "EnumerationType", name=kind)
        for number, item in enumerate(names):
            xml.SubElement(items, "Item", name=item, value=str(number))
    categories = xml.SubElement(root, "LogCategories")
    for category in LOG_CATEGORIES:
        xml.SubElement(categories, "Category", name=category)


def _append_structure(root: xml.Element, version: int, variables: Sequence[Variable]) -> None:
    """Append the outputs, and those that are known after the initialisation only."""
    structure = xml.SubElement(root, "ModelStructure")
    outputs = [(k, v) for k, v in enumerate(variables, 1) if v.causality == "output"]
    initial = [(k, v) for k, v in outputs if not v.constant and v.clock is None]
    if version == 2:
        for parent, chosen in (("Outputs", outputs), ("InitialUnknowns", initial)):
            group = xml.SubElement(structure, parent)
            for index, _ in chosen:
                xml.SubElement(group, "Unknown", index=str(index), dependencies="")
    else:
        for element_name, chosen in (("Output", outputs), ("InitialUnknown", initial)):
            for _, variable in chosen:
                dependencies = " ".join(map(str, variable.dependencies))
                reference = str(variable.reference)
                xml.SubElement(structure, element_name, valueReference=reference, dependencies=dependencies)


def build_description(
    name: str, sources: Sequence[str], folders: Sequence[str], defines: Sequence[str]
) -> bytes:
    """Return buildDescription.xml of FMI 3.0: how to compile the sources; Eigen 3.4 comes from outside."""
    root = xml.Element("fmiBuildDescription", fmiVersion="3.0")
    one = xml.SubElement(
        root, "BuildConfiguration", modelIdentifier=name, description="needs Eigen 3.4 headers"
    )
    files = xml.SubElement(one, "SourceFileSet", language="C++17")
    for source in sources:
        xml.SubElement(files, "SourceFile", name=source)
    for define in defines:
        xml.SubElement(files, "PreprocessorDefinition", name=define)
    for folder in folders:
        xml.SubElement(files, "IncludeDirectory", name=folder)
    return _text(root)


def _ranges(variable: Variable) -> dict[str, str]:
    """Return unit and range of a real variable as attributes."""
    stated = {"unit": variable.unit, "min": variable.low, "max": variable.high}
    return {
        key: f"{value:.17g}" if isinstance(value, float) else str(value)
        for key, value in stated.items()
        if value is not None
    }


def _common(variable: Variable) -> dict[str, str]:
    """Return the attributes that FMI 2 and FMI 3 share."""
    return {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "description": variable.description,
        "causality": variable.causality,
        "variability": _VARIABILITY.get(variable.causality, "constant" if variable.constant else "discrete"),
    }


def _start(variable: Variable) -> dict[str, str]:
    """Return the start value as an attribute, where there is one."""
    if variable.start is None:
        return {}
    value = variable.start
    if isinstance(value, bool):
        return {"start": str(value).lower()}
    return {"start": value if isinstance(value, str) else f"{value:.17g}"}


def _variable_2(parent: xml.Element, variable: Variable) -> None:
    """Append a ScalarVariable."""
    scalar = xml.SubElement(parent, "ScalarVariable", _common(variable))
    if variable.kind == "real":
        xml.SubElement(scalar, "Real", _ranges(variable) | _start(variable))
    elif variable.kind in _TYPES:
        xml.SubElement(scalar, _TYPES[variable.kind][0], _start(variable))
    else:
        xml.SubElement(scalar, "Enumeration", declaredType=variable.kind)


_TYPES = {"integer": ("Integer", "UInt32"), "boolean": ("Boolean", "Boolean"), "string": ("String", "String")}
"""Types of FMI 2.0 and of FMI 3.0."""


def _variable_3(parent: xml.Element, variable: Variable) -> None:
    """Append a variable of FMI 3."""
    common = _common(variable)
    if variable.kind == "real":
        xml.SubElement(parent, "Float64", common | _ranges(variable) | _start(variable))
    elif variable.kind == "binary":
        binary = {"clocks": str(variable.clock), "mimeType": MIME, "maxSize": str(MAX_BYTES)}
        element = xml.SubElement(parent, "Binary", common | binary)
        if variable.start is not None:
            xml.SubElement(element, "Start", value=str(variable.start))
    elif variable.kind == "clock":
        interval = {"intervalVariability": "triggered"}
        if variable.interval_s is not None:
            interval = {"intervalVariability": "constant", "intervalDecimal": f"{variable.interval_s:.9g}"}
        xml.SubElement(parent, "Clock", common | interval)
    elif variable.kind == "string":
        element = xml.SubElement(parent, "String", common)
        xml.SubElement(element, "Start", value=str(variable.start))
    elif variable.kind in _TYPES:
        xml.SubElement(parent, _TYPES[variable.kind][1], common | _start(variable))
    else:
        xml.SubElement(parent, "Enumeration", common | {"declaredType": variable.kind})


def _text(root: xml.Element) -> bytes:
    """Return the document, indented."""
    xml.indent(root)
    return xml.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"
