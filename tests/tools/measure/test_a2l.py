"""The A2L of the truck's ECU in an image: places are those that the program itself takes, nothing is left
out, and another implementation of ASAP2 reads it."""

import re
import struct
import subprocess
from itertools import pairwise
from pathlib import Path

import pytest
from pya2l.parser import A2lParser

from lpvguard.base.errors import InputError
from lpvguard.core import targets
from lpvguard.core.compiled import VERDICTS, library_root, shipped_vehicle
from lpvguard.extras.measure.a2l import a2l_text
from lpvguard.extras.measure.header_fields import described_fields
from lpvguard.extras.measure.image import read_instance
from lpvguard.extras.measure.xcp_access import XcpAccess, if_data
from lpvguard.vehicle.project import load_project
from parts import require

INCLUDE = library_root() / "include" / "lpvguard"
BYTES = {"UBYTE": 1, "UWORD": 2, "ULONG": 4, "A_INT64": 8, "FLOAT32_IEEE": 4}
TYPE = "#include <lpvguard/{header}.h>\n{of}lpvg_{type}_t {name};\n"


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    """Makes an object file with debug information of C text for a shipped vehicle, by the PC's compiler."""

    def make(text: str, vehicle: str = "truck", *options: str) -> Path:
        folder = tmp_path_factory.mktemp("image")
        source, elf = folder / "image.c", folder / "image.elf"
        source.write_text(text + "int main(void) { return 0; }\n")
        include = [f"-I{library_root() / 'include'}", f"-I{shipped_vehicle(vehicle)}"]
        command = ["gcc", "-no-pie", *(options or ("-g",)), *include, source, "-o", elf]
        subprocess.run([str(c) for c in command], check=True)
        return elf

    return make


@pytest.fixture(scope="module")
def truck_elf(image) -> Path:
    return image(TYPE.format(header="ecu", of="", type="ecu", name="ecu"))


@pytest.fixture(scope="module")
def truck_text(truck_elf) -> str:
    return a2l_text(load_project("truck"), truck_elf, "ecu", INCLUDE)[0]


@pytest.fixture(scope="module")
def truck(truck_text):
    return parsed(truck_text)


def parsed(text: str):
    """The module of an A2L as pya2l reads it,."""
    with A2lParser() as parser:
        tree = parser.tree_from_a2l(text.encode())
        # It keeps what no grammar of its own names, and says so.
        assert all("may be used at most once here" in w for w in parser.warnings)
        assert not parser.warnings or "/begin IF_DATA" in text
    (module,) = tree.PROJECT.MODULE
    return module


def elements(m) -> int:
    """Elements of the array that a measurement is."""
    dim = m.MATRIX_DIM
    return dim.XDim.Value * dim.YDim.Value * dim.ZDim.Value if dim.XDim.Value else 1


def taken(module) -> list[tuple[int, int, str]]:
    """Address, bytes and name of every measurement, by address."""
    return sorted(
        (m.ECU_ADDRESS.Address.Value, BYTES[m.DataType.Value] * elements(m), m.Name.Value)
        for m in module.MEASUREMENT
    )


def test_every_byte_of_the_object_is_measured_but_pointers_and_padding(truck_elf, truck):
    """No two overlap, and what lies between two is a pointer, or less than the alignment of what follows."""
    instance = read_instance(truck_elf, "ecu", ("lpvg_truck_ecu_t",))
    places = [(a - instance.address, n) for a, n, _ in taken(truck)]
    assert len(instance.pointers) == 5, "coefficients three times, the controller's, rules"
    places = sorted([*places, *instance.pointers, (instance.bytes, 1)])
    for (a, n), (b, _) in pairwise(places):
        assert a + n <= b and b - a - n < 8 and (b == a + n or b % 2 == 0)
    assert len(truck.MEASUREMENT) > 600


def test_every_measurement_has_text_unit_range_and_conversion(truck):
    methods = {c.Name.Value: c for c in truck.COMPU_METHOD}
    tables = {t.Name.Value: [v.OutVal.Value for v in t.InValOutVal] for t in truck.COMPU_VTAB}
    for m in truck.MEASUREMENT:
        method = methods[m.Conversion.Value]
        assert m.LongIdentifier.Value and m.PHYS_UNIT.Unit.Value == method.Unit.Value != ""
        assert m.LowerLimit.Value < m.UpperLimit.Value
        if method.COMPU_TAB_REF.ConversionTable.Value:
            assert m.UpperLimit.Value == len(tables[method.COMPU_TAB_REF.ConversionTable.Value]) - 1
    assert tables["VT.lpvg_verdict_t"] == list(VERDICTS)
    assert tables["VT.lpvg_ecu_engagement_t"] == ["released", "engaged", "locked"]


def test_signals_have_the_unit_and_range_of_the_signal_table(truck):
    by_name = {m.Name.Value: m for m in truck.MEASUREMENT}
    for name, unit, low, high in (
        ("ecu.signals.speed", "m/s", -1, 40),
        ("ecu.signals.y[0]", "rad/s", -1.5, 1.5),
        ("ecu.signals.y[1]", "rad", -0.75, 0.75),
        ("ecu.report.demand", "bar", -12.5, 12.5),
        ("ecu.supervisor.watch[2].score", "-", 0, 5),
    ):
        m = by_name[name]
        assert (m.PHYS_UNIT.Unit.Value, m.LowerLimit.Value, m.UpperLimit.Value) == (unit, low, high)
    assert by_name["ecu.report.verdict"].Conversion.Value == "CM.lpvg_verdict_t"
    assert by_name["ecu.kept.rate_max"].PHYS_UNIT.Unit.Value == "bar/s"
    assert by_name["ecu.monitor.signal"].PHYS_UNIT.Unit.Value == "rad/s | rad"
    dim = by_name["ecu.monitor.signal"].MATRIX_DIM
    assert (dim.XDim.Value, dim.YDim.Value, dim.ZDim.Value) == (4, 8, 1), "fastest first"


@pytest.mark.slow("an image for every processor, run in its emulator")
@pytest.mark.parametrize("name", sorted(targets.TARGETS))
def test_places_are_what_the_program_takes_on_the_target(name, truck, tmp_path):
    """The compiler works out the address and size of every measured name; the running program says them."""
    require("qemu")
    names = [m.Name.Value for m in truck.MEASUREMENT]
    rows = "".join(f'    {{"{n}", &{n}, sizeof({n})}},\n' for n in names)
    source = tmp_path / "places.cpp"
    source.write_text(
        '#include "port.h"\n#include "text.hpp"\n#include "lpvguard/ecu.h"\n'
        "namespace { lpvg_ecu_t ecu; struct Row { const char* name; const void* place; unsigned bytes; };\n"
        f"const Row rows[] = {{\n{rows}}}; }}\n"
        "int main() {\n"
        "    const lpvg_ecu_config_t config = {true, 0U, 0U, false, {2.07F, 5.0F, 1.5F, 0.15F, 100U}, "
        "{0.14F, 0.04F, 30U, 0.32F}};\n"
        "    const auto status = lpvg_ecu_init(&ecu, &lpvg_coeff, &lpvg_control_coeff, &config, 0);\n"
        "    if (status != lpvg_status_ok) { return 1; }\n"
        "    for (const Row& row : rows) {\n        char text[200];\n        Text line(text, sizeof text);\n"
        "        line.put(row.name).put(' ').number(reinterpret_cast<uintptr_t>(row.place));\n"
        "        line.put(' ').number(row.bytes).put('\\n');\n"
        "        port_write(text);\n    }\n    return 0;\n}\n"
    )
    elf = targets.image_with_debug_information(
        name, shipped_vehicle("truck"), targets.Program("places", (source,), {})
    )
    said = {}
    for line in (text for text in targets.run_image(name, elf) if text.startswith("ecu.")):  # QEMU warns
        what, address, size = line.split()
        said[what] = (int(address), int(size))
    text, n = a2l_text(load_project("truck"), elf, "ecu", INCLUDE)
    assert {what: (a, size) for a, size, what in taken(parsed(text))} == said and n == len(said)


def test_a_vehicle_without_controller_is_described_by_its_monitor(image):
    elf = image(TYPE.format(header="monitor", of="static volatile ", type="monitor", name="watch"), "g80")
    text, n = a2l_text(load_project("g80"), elf, "watch", INCLUDE)
    module = parsed(text)
    assert n == len(module.MEASUREMENT) > 300 and module.Name.Value == "g80"


def test_the_same_image_gives_the_same_text_and_a_double_core_its_own(image, truck_elf, truck_text):
    assert a2l_text(load_project("truck"), truck_elf, "ecu", INCLUDE)[0] == truck_text
    object_of = TYPE.format(header="ecu", of="", type="ecu", name="ecu2")
    text, n = a2l_text(
        load_project("truck"), image(object_of, "truck", "-g", "-DLPVG_DOUBLE"), "ecu2", INCLUDE
    )
    assert n == truck_text.count("/begin MEASUREMENT") and "FLOAT64_IEEE CM.float64.bar_2F_s" in text


@pytest.mark.parametrize(
    "text, options, said",
    [
        (
            TYPE.format(header="ecu", of="", type="ecu", name="loop"),
            ("-g",),
            "ecu: no such object; expected one of loop",
        ),
        (
            TYPE.format(header="ecu", of="", type="ecu", name="ecu"),
            ("-g0", "-s"),
            "no debug information; .* with -g",
        ),
        ("int ecu;\n", ("-g",), "ecu: is int; expected an object of lpvg_truck_ecu_t or"),
        ("int other;\n", ("-g",), "no such object; expected a variable of lpvg_truck_ecu_t or .* -g"),
    ],
)
def test_an_image_that_does_not_hold_the_object_is_refused(image, text, options, said):
    with pytest.raises(InputError, match=said):
        a2l_text(load_project("truck"), image(text, "truck", *options), "ecu", INCLUDE)


def test_a_file_that_is_no_image_is_refused(tmp_path):
    (tmp_path / "a.elf").write_bytes(struct.pack("<I", 1) * 40)
    with pytest.raises(InputError, match=r"a\.elf: no ELF"):
        a2l_text(load_project("truck"), tmp_path / "a.elf", "ecu", INCLUDE)
    with pytest.raises(InputError, match=r"b\.elf: cannot be read"):
        a2l_text(load_project("truck"), tmp_path / "b.elf", "ecu", INCLUDE)


def test_a_field_without_description_or_unit_is_refused(truck_elf, tmp_path):
    for header in INCLUDE.glob("*.h"):
        (tmp_path / header.name).write_text(header.read_text())
    ecu = (INCLUDE / "ecu.h").read_text()
    for pattern, said in (
        (r"  ///< result of the actuator check", "lpvg_ecu_t.actuator_failed: not described"),
        (r" +\[input unit\](?=\n    int64_t live_us)", "lpvg_ecu_t.expected: no unit"),
    ):
        planted, n = re.subn(pattern, "", ecu)
        assert n == 1
        (tmp_path / "ecu.h").write_text(planted)
        with pytest.raises(InputError, match=re.escape(said)):
            a2l_text(load_project("truck"), truck_elf, "ecu", tmp_path)
    with pytest.raises(InputError, match="no struct in its headers"):
        described_fields(tmp_path / "none")


def test_the_access_of_the_slave_stands_beside_the_measurements(truck_elf, truck_text):
    access = XcpAccess.parse("0x98EF27F9:0x7FF")
    text, n = a2l_text(load_project("truck"), truck_elf, "ecu", INCLUDE, access)
    lines = if_data(access, 10_000, False, INCLUDE)
    before, _, rest = text.partition("\n".join(lines) + "\n")
    assert before + rest == truck_text
    (block,) = parsed(text).IF_DATA
    names = [blob.Generic.Name.Value for blob in block.Blob][1:]
    assert (block.Name.Value, names) == ("XCPplus", ["PROTOCOL_LAYER", "DAQ", "XCP_ON_CAN"])
    assert n == text.count("/begin MEASUREMENT")
    assert "CAN_ID_MASTER 0x98EF27F9\nCAN_ID_SLAVE 0x000007FF\n" in text
    assert "BYTE_ORDER_MSB_FIRST" in if_data(access, 10_000, True, INCLUDE)


@pytest.mark.parametrize(
    "text, said",
    [
        ("", "expected COMMANDS:ANSWERS"),
        ("0x1", "'0x1'"),
        ("1:2:3", "'1:2:3'"),
        ("0x18EF27F9:0x98EFF927", "0x18ef27f9 is not an identifier"),
        ("0x1:0xC0000000", "0xc0000000 is not an identifier"),
        ("-1:2", "not an identifier"),
        ("5:5", "equal"),
    ],
)
def test_identifiers_that_are_none_are_refused(text, said):
    with pytest.raises(InputError, match=said):
        XcpAccess.parse(text)


def test_headers_without_a_slave_are_refused(tmp_path):
    with pytest.raises(InputError, match="LPVG_XCP_ODT_ENTRIES_MAX: not there"):
        if_data(XcpAccess(1, 2), 10_000, False, tmp_path)


@pytest.mark.unhurried
def test_the_command_writes_it_and_renews_its_own(image, truck_elf, truck_text, lpvguard, tmp_path):
    out = tmp_path / "truck.a2l"
    done = lpvguard("a2l", "--vehicle", "truck", "--elf", truck_elf, "--instance", "ecu", "-o", out)
    assert done.returncode == 0 and out.read_text() == truck_text
    assert f"{truck_text.count('/begin MEASUREMENT')} measurements of ecu" in done.stderr
    again = image(TYPE.format(header="ecu", of="int before = 1;\n", type="ecu", name="other"))
    for place, status in ((out, 0), (truck_elf, 2)):
        arguments = ("--elf", again, "--instance", "other", "-o", place)
        assert lpvguard("a2l", "--vehicle", "truck", *arguments).returncode == status, (
            "its own file, and no other"
        )
    assert 'SYMBOL_LINK "other"' in out.read_text()
    arguments = ("--elf", truck_elf, "--instance", "ecu", "-o", out, "--xcp")
    assert lpvguard("a2l", "--vehicle", "truck", *arguments, "0x1").returncode == 2
    assert lpvguard("a2l", "--vehicle", "truck", *arguments, "0x98EF27F9:0x98EFF927").returncode == 0
    assert "CAN_ID_MASTER 0x98EF27F9\n" in out.read_text()
