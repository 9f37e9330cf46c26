"""modelDescription.xml of an FMU, for FMI 2.0 and FMI 3.0, and buildDescription.xml of its sources."""

from collections.abc import Sequence
from xml.etree import ElementTree as xml

from ... import __version__
from .variables import ENUMERATIONS, Variable

TOOL = f"lpvguard {__version__}"
_VARIABILITY = {"independent": "continuous"}
LOG_CATEGORIES = ("logStatusWarning", "logStatusError")


def model_description(
    version: int,
    name: str,
    title: str,
    token: str,
    period_s: float,
    variables: Sequence[Variable],
    sources: Sequence[str],
) -> bytes:
    """Return modelDescription.xml of FMI ``version`` 2 or 3. ``name`` is the model identifier, ``token``
    identifies the binary and the variables together. ``period_s`` is the only step size. ``sources`` lie
    below ``sources/``."""
    step = f"{period_s:.9g}"
    root = xml.Element(
        "fmiModelDescription",
        {
            "fmiVersion": f"{version}.0",
            "modelName": name,
            ("guid" if version == 2 else "instantiationToken"): token,
            "description": f"Nominal-error monitor of {title}",
            "generationTool": TOOL,
            "variableNamingConvention": "flat",
        },
    )
    state = "FMUstate" if version == 2 else "FMUState"
    simulation = {
        "modelIdentifier": name,
        "canHandleVariableCommunicationStepSize": "false",
        f"canGetAndSet{state}": "true",
        f"canSerialize{state}": "true",
    }
    if version == 3:
        simulation["fixedInternalStepSize"] = step
    element = xml.SubElement(root, "CoSimulation", simulation)
    if version == 2:
        files = xml.SubElement(element, "SourceFiles")
        for source in sources:
            xml.SubElement(files, "File", name=source)
    _append_types(root, version, variables)
    xml.SubElement(root, "DefaultExperiment", startTime="0", stepSize=step)
    listed = xml.SubElement(root, "ModelVariables")
    for variable in variables:
        (_variable_2 if version == 2 else _variable_3)(listed, variable)
    _append_structure(root, version, variables)
    return _text(root)


def _append_types(root: xml.Element, version: int, variables: Sequence[Variable]) -> None:
    """Append the units, the core's enumerations and the categories of messages."""
    units = xml.SubElement(root, "UnitDefinitions")
    for unit in sorted({v.unit for v in variables if v.kind == "real"}):
        xml.SubElement(units, "Unit", name=unit)
    types = xml.SubElement(root, "TypeDefinitions")
    for kind, names in ENUMERATIONS.items():
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
    initial = [(k, v) for k, v in outputs if not v.constant]
    if version == 2:
        for parent, chosen in (("Outputs", outputs), ("InitialUnknowns", initial)):
            group = xml.SubElement(structure, parent)
            for index, _ in chosen:
                xml.SubElement(group, "Unknown", index=str(index), dependencies="")
    else:
        for element_name, chosen in (("Output", outputs), ("InitialUnknown", initial)):
            for _, variable in chosen:
                xml.SubElement(
                    structure, element_name, valueReference=str(variable.reference), dependencies=""
                )


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
    return {} if variable.start is None else {"start": f"{variable.start:.17g}"}


def _variable_2(parent: xml.Element, variable: Variable) -> None:
    """Append a ScalarVariable."""
    scalar = xml.SubElement(parent, "ScalarVariable", _common(variable))
    if variable.kind == "real":
        xml.SubElement(scalar, "Real", _ranges(variable) | _start(variable))
    elif variable.kind == "integer":
        xml.SubElement(scalar, "Integer")
    else:
        xml.SubElement(scalar, "Enumeration", declaredType=variable.kind)


def _variable_3(parent: xml.Element, variable: Variable) -> None:
    """Append a variable of FMI 3."""
    if variable.kind == "real":
        xml.SubElement(parent, "Float64", _common(variable) | _ranges(variable) | _start(variable))
    elif variable.kind == "integer":
        xml.SubElement(parent, "UInt32", _common(variable))
    else:
        xml.SubElement(parent, "Enumeration", _common(variable) | {"declaredType": variable.kind})


def _text(root: xml.Element) -> bytes:
    """Return the document, indented."""
    xml.indent(root)
    return xml.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"
