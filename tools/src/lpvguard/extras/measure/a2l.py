"""Write the ASAP2 description (A2L) of a vehicle's object in an integrator's image.

Address, type and size of a field come from the image's debug information. Text and unit come from the comment
in the core's header. The range comes from that comment, the signal table, the enumeration or the type of the
number. Names of values come from the enumerations of the headers. Pointers are left out. The file can also
describe access to an XCP slave in the image. The text depends only on these inputs and has no time of day.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ...base.errors import InputError
from ...core.c_enums import enum_names
from ...vehicle.project import Project, Signal
from .header_fields import Described, described_fields
from .image import Instance, PlacedField, read_instance
from .xcp_access import XcpAccess, if_data

_TYPES = {
    ("unsigned", 1): ("UBYTE", 0.0, 255.0),
    ("unsigned", 2): ("UWORD", 0.0, 65535.0),
    ("unsigned", 4): ("ULONG", 0.0, 4294967295.0),
    ("unsigned", 8): ("A_UINT64", 0.0, float(2**64 - 1)),
    ("signed", 1): ("SBYTE", -128.0, 127.0),
    ("signed", 2): ("SWORD", -32768.0, 32767.0),
    ("signed", 4): ("SLONG", -2147483648.0, 2147483647.0),
    ("signed", 8): ("A_INT64", -float(2**63), float(2**63 - 1)),
    ("bool", 1): ("UBYTE", 0.0, 1.0),
    ("float", 4): ("FLOAT32_IEEE", -3.4028234663852886e38, 3.4028234663852886e38),
    ("float", 8): ("FLOAT64_IEEE", -1.7976931348623157e308, 1.7976931348623157e308),
}
"""ASAP2's name and range of each number type of the core, by kind and bytes."""
NO_YES = ("no", "yes")
"""Values of a bool."""
_ENUM_IN_TEXT = re.compile(r"lpvg_\w+_t")
_SHOWN = {"FLOAT32_IEEE": "%15.9", "FLOAT64_IEEE": "%24.17"}
"""Width and digits to print every number of the type exactly; other types have no digits."""
_DIMENSIONS = 3
"""Number of axes of MATRIX_DIM in ASAP2 1.6, the fastest first."""


@dataclass(frozen=True)
class Measurement:
    """A field in the A2L, or one element of an array whose elements have different units.

    ``dims`` are as in C: the last index runs fastest. ``values`` names the values 0, 1, ...; it is () for a
    number.
    """

    name: str
    text: str
    datatype: str
    unit: str
    low: float
    high: float
    values: tuple[str, ...]
    enum: str
    offset: int
    dims: tuple[int, ...]


def a2l_text(
    project: Project, elf: Path, symbol: str, include: Path, xcp: XcpAccess | None = None
) -> tuple[str, int]:
    """Write the A2L of an object in an image.

    Parameters
    ----------
    project : Project
    elf : Path, the image
    symbol : str, the vehicle's lpvg_ecu_t, or its lpvg_monitor_t in an image without controller
    include : Path, folder of the core's headers for the image
    xcp : XcpAccess, optional, identifiers of the slave

    Returns
    -------
    tuple of str and int, the text and the number of measurements

    Raises
    ------
    InputError
        If the image or the object does not fit, or the headers do not describe a field.

    References
    ----------
    ASAM MCD-2 MC (ASAP2) 1.6.
    """
    prefix = f"lpvg_{project.name}_"
    instance = read_instance(elf, symbol, (f"{prefix}ecu_t", f"{prefix}monitor_t"))
    described = described_fields(include)
    enums = _Enums(include)
    measurements = [
        m
        for field in instance.fields
        for m in _measurements(project, symbol, field, _description(described, field, prefix, include), enums)
    ]
    period_us = round(project.Ts_s * 1e6)
    access = if_data(xcp, period_us, instance.big_endian, include) if xcp else []
    return _document(project, instance, measurements, access), len(measurements)


class _Enums:
    """Members of the enumerations in the headers, each read once."""

    def __init__(self, include: Path) -> None:
        self.headers = {
            name: header
            for header in sorted(include.glob("*.h"))
            for name in re.findall(
                r"^typedef enum (\w+) \{", header.read_text(encoding="utf-8"), re.MULTILINE
            )
        }
        self.read: dict[str, tuple[str, ...]] = {}

    def __getitem__(self, name: str) -> tuple[str, ...]:
        if name not in self.read:
            self.read[name] = enum_names(self.headers[name], name)
        return self.read[name]

    def named_by(self, field: PlacedField, text: str) -> str:
        """Enumeration of a field, from its type or from the first word of its text; "" if there is none."""
        match = _ENUM_IN_TEXT.match(text)
        name = field.enum or (match[0] if match else "")
        return name if name in self.headers else ""


def _description(
    described: dict[str, dict[str, Described]], field: PlacedField, prefix: str, include: Path
) -> Described:
    struct_name = field.struct.replace(prefix, "lpvg_", 1)
    described_field = described.get(struct_name, {}).get(field.name)
    if described_field is None or not described_field.text:
        raise InputError(
            include,
            f"{struct_name}.{field.name}",
            "not described",
            "the headers that the image was built with",
        )
    if field.kind == "float" and described_field.unit is None:
        raise InputError(
            include, f"{struct_name}.{field.name}", "no unit", "a unit in square brackets, or [-]"
        )
    return described_field


def _measurements(
    project: Project, symbol: str, field: PlacedField, described: Described, enums: _Enums
) -> Iterator[Measurement]:
    """One measurement, or one per output if the elements belong to outputs with different units."""
    datatype, *limits = _TYPES[field.kind, field.bytes]
    enum = enums.named_by(field, described.text)
    values = NO_YES if field.kind == "bool" else enums[enum] if enum else ()
    low, high = (0.0, float(len(values) - 1)) if values else described.limits or limits
    outputs = project.outputs
    units = {s.unit for s in outputs}
    by_output = described.unit == "output unit" and len(units) > 1 and field.dims[:1] == (len(outputs),)
    name = symbol + field.path
    if not by_output:
        signals = _signals(project, field, described)
        if signals and described.limits is None:
            low, high = min(s.min for s in signals), max(s.max for s in signals)
        unit = _unit(project, described.unit or "-")
        yield Measurement(
            name, described.text, datatype, unit, low, high, values, enum, field.offset, field.dims
        )
        return
    inner = field.dims[1:]
    step = field.bytes
    for n in inner:
        step *= n
    is_signal = bool(_signals(project, field, described))
    for j, output in enumerate(outputs):
        ends = (output.min, output.max) if is_signal else (low, high)
        text = f"{described.text}: {output.name}"
        yield Measurement(
            f"{name}[{j}]", text, datatype, output.unit, *ends, values, enum, field.offset + j * step, inner
        )


def _signals(project: Project, field: PlacedField, described: Described) -> list[Signal]:
    """Signals of the table in a field; empty for a quantity that is computed from signals."""
    if field.struct.endswith("_bus_signals_t") and field.name in ("speed", "y"):
        return project.of_role("scheduling") if field.name == "speed" else list(project.outputs)
    return list(project.inputs) if described.unit == "input unit" else []


def _unit(project: Project, unit: str) -> str:
    """The header's unit with the units of the signal table inserted; a list if they differ."""
    for role, signals in (("input", project.inputs), ("output", project.outputs)):
        of_all = " | ".join(dict.fromkeys(s.unit for s in signals))
        whole = unit == f"{role} unit" or " | " not in of_all
        unit = unit.replace(f"{role} unit", of_all if whole else f"({of_all})")
    return unit


def _number(value: float) -> str:
    return f"{value:.0f}" if value == int(value) and abs(value) < 1e20 else repr(value)


def _text(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _document(
    project: Project, instance: Instance, measurements: list[Measurement], access: list[str]
) -> str:
    order = "MSB_FIRST" if instance.big_endian else "MSB_LAST"
    what = f"{instance.struct} {instance.symbol}, {instance.bytes} bytes"
    lines = [
        "ASAP2_VERSION 1 60",
        f"/begin PROJECT lpvguard {_text(project.title)}",
        f"/begin MODULE {project.name} {_text(what)}",
        f"/begin MOD_COMMON {_text('')}",
        f"BYTE_ORDER {order}",
        "ALIGNMENT_BYTE 1",
        "/end MOD_COMMON",
        *access,
    ]
    methods: dict[str, list[str]] = {}
    for m in measurements:
        methods.setdefault(_method(m), _conversion(m))
        lines += _measurement(instance, m)
    for name in sorted(methods):
        lines += methods[name]
    return "\n".join([*lines, "/end MODULE", "/end PROJECT", ""])


def _method(m: Measurement) -> str:
    """Name of the conversion method, from the enumeration or from unit and type."""
    if m.values:
        return f"CM.{m.enum or 'no_yes'}"
    kind = m.datatype.split("_")[0].lower() if m.datatype in _SHOWN else "whole"
    unit = re.sub(r"\W", lambda c: f"_{ord(c[0]):X}_", m.unit)
    return f"CM.{kind}.{unit}"


def _conversion(m: Measurement) -> list[str]:
    name = _method(m)
    if not m.values:
        shown = _SHOWN.get(m.datatype, "%20.0")
        return [
            f"/begin COMPU_METHOD {name} {_text('as it is')} IDENTICAL {_text(shown)} {_text(m.unit)}",
            "/end COMPU_METHOD",
        ]
    table = name.replace("CM.", "VT.", 1)
    return [
        f"/begin COMPU_METHOD {name} {_text('names of the values')} TAB_VERB {_text('%3.0')} {_text(m.unit)}",
        f"COMPU_TAB_REF {table}",
        "/end COMPU_METHOD",
        f"/begin COMPU_VTAB {table} {_text('names of the values')} TAB_VERB {len(m.values)}",
        *(f"{i} {_text(value)}" for i, value in enumerate(m.values)),
        'DEFAULT_VALUE "damaged"',
        "/end COMPU_VTAB",
    ]


def _measurement(instance: Instance, m: Measurement) -> list[str]:
    lines = [
        f"/begin MEASUREMENT {m.name} {_text(m.text)}",
        f"{m.datatype} {_method(m)} 0 0 {_number(m.low)} {_number(m.high)}",
        f"ECU_ADDRESS 0x{instance.address + m.offset:08X}",
        "ECU_ADDRESS_EXTENSION 0",
        f"PHYS_UNIT {_text(m.unit)}",
        f"SYMBOL_LINK {_text(instance.symbol)} {m.offset}",
    ]
    if m.dims:
        fastest_first = [*reversed(m.dims), *[1] * (_DIMENSIONS - len(m.dims))]
        lines.append(f"MATRIX_DIM {' '.join(map(str, fastest_first))}")
    return [*lines, "/end MEASUREMENT"]
