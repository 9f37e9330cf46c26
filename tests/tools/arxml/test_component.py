"""The AUTOSAR component, read by another parser: its C source runs under an RTE that is made of its ARXML."""

import ctypes
import subprocess
import sys
from pathlib import Path

import autosar_data
import numpy as np
import pytest

from lpvguard.base import artefacts, native
from lpvguard.core.compiled import REASONS, STATUSES, VERDICTS, library_root, shared_core
from lpvguard.drives.tables import read_drive
from lpvguard.extras.arxml.component import monitor_component

pytestmark = pytest.mark.slow("6 s: the core is compiled")
NAME = "Lpvguard_g80"
PLATFORM = """
#include <stdint.h>
typedef uint8_t uint8, boolean, Std_ReturnType;
typedef uint32_t uint32;
typedef float float32;
#define FUNC(type, memory) type
#define TRUE 1
#define FALSE 0
#define RTE_E_OK 0
"""


@pytest.fixture(scope="module")
def files(g80, vehicle) -> dict[str, str]:
    return monitor_component(g80, vehicle)


@pytest.fixture(scope="module")
def model(files, tmp_path_factory) -> autosar_data.AutosarModel:
    """The ARXML as autosar-data reads it, strictly."""
    path = tmp_path_factory.mktemp("arxml") / f"{NAME}.arxml"
    path.write_text(files[path.name])
    read = autosar_data.AutosarModel()
    _, warnings = read.load_file(str(path), True)
    assert warnings == []
    return read


def child(element, *names):
    """Content below an element; the last name's text."""
    for name in names:
        element = element.get_sub_element(name)
    return element


def type_of(model, prototype) -> tuple[str, autosar_data.Element]:
    """Platform type of a data prototype, and its properties."""
    kind = child(prototype, "TYPE-TREF").reference_target
    properties = child(
        kind, "SW-DATA-DEF-PROPS", "SW-DATA-DEF-PROPS-VARIANTS", "SW-DATA-DEF-PROPS-CONDITIONAL"
    )
    return child(properties, "BASE-TYPE-REF").reference_target.item_name, properties


def elements(model, kind: str) -> list[autosar_data.Element]:
    return [e for _, e in model.elements_dfs if e.element_name == kind]


@pytest.fixture(scope="module")
def rte(model, tmp_path_factory) -> Path:
    """Folder with the header that an RTE generator would write; its functions use plain variables."""
    lines = ["#pragma once", PLATFORM]
    for access in elements(model, "VARIABLE-ACCESS"):
        element = child(access, "ACCESSED-VARIABLE", "AUTOSAR-VARIABLE-IREF")
        port = child(element, "PORT-PROTOTYPE-REF").reference_target.item_name
        target = child(element, "TARGET-DATA-PROTOTYPE-REF").reference_target
        kind, name = type_of(model, target)[0], f"{port}_{target.item_name}"
        lines.append(f"static {kind} rte_{name};")
        if "RECEIVE" in access.parent.element_name:
            body = f"*data = rte_{name}; return rte_error;"
            lines.append(f"static Std_ReturnType Rte_Read_{name}({kind}* data) {{ {body} }}")
        else:
            body = f"rte_{name} = data; return RTE_E_OK;"
            lines.append(f"static Std_ReturnType Rte_Write_{name}({kind} data) {{ {body} }}")
    for parameter in elements(model, "PARAMETER-DATA-PROTOTYPE"):
        kind, name = type_of(model, parameter)[0], parameter.item_name
        value = child(parameter, "INIT-VALUE", "NUMERICAL-VALUE-SPECIFICATION", "VALUE").character_data
        lines.append(f"static {kind} rte_{name} = ({kind}){value};")
        lines.append(f"static {kind} Rte_CData_{name}(void) {{ return rte_{name}; }}")
    lines.insert(2, "static Std_ReturnType rte_error;")
    folder = tmp_path_factory.mktemp("rte")
    (folder / f"Rte_{NAME}.h").write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture(scope="module")
def component(files, rte, vehicle) -> ctypes.CDLL:
    """The component in a library: put an input, run, get an output."""
    (rte / "component.c").write_text(files[f"{NAME}.c"])
    wrapper = rte / "wrapper.cpp"
    wrapper.write_text(f"""extern "C" {{
#include "{rte}/component.c"
void start(uint32_t crc) {{ rte_coefficients_crc32 ^= crc; {NAME}_Init(); rte_coefficients_crc32 ^= crc; }}
void step(const float* in, double* out, int error) {{
    rte_error = (uint8_t)error;
    rte_Signals_speed = in[0]; rte_Signals_road_wheel_angle = in[1]; rte_Signals_yaw_rate = in[2];
    {NAME}_Step();
    out[0] = rte_Assessment_verdict;
    out[1] = rte_Assessment_energy_ratio;
    out[2] = rte_Assessment_change_ratio;
}} }}
""")
    library = ctypes.CDLL(str(shared_core(vehicle, [wrapper], "component", flags=[f"-I{rte}"])))
    library.start.argtypes = [ctypes.c_uint32]
    return library


def stepped(component, row: np.ndarray, error: int = 0) -> np.ndarray:
    """Results of one sample: verdict, energy ratio, change ratio."""
    inputs, results = np.asarray(row, np.float32), np.zeros(3)
    component.step(native.pointer(inputs), native.pointer(results), error)
    return results


def test_another_parser_finds_every_reference(model):
    assert model.check_references() == []
    (event,) = elements(model, "TIMING-EVENT")
    assert child(event, "PERIOD").character_data == pytest.approx(0.02)
    assert child(event, "START-ON-EVENT-REF").reference_target.item_name == f"{NAME}_Step"


def test_signals_have_units_and_ranges_and_results_the_cores_words(model, g80):
    by_name = {e.item_name: type_of(model, e)[1] for e in elements(model, "VARIABLE-DATA-PROTOTYPE")}
    for signal in (g80.speed, *g80.inputs, *g80.outputs):
        unit = child(by_name[signal.name], "UNIT-REF").reference_target
        assert child(unit, "DISPLAY-NAME").character_data == signal.unit
        rule = child(by_name[signal.name], "DATA-CONSTR-REF").reference_target
        limits = child(rule, "DATA-CONSTR-RULES", "DATA-CONSTR-RULE", "INTERNAL-CONSTRS")
        ends = [float(child(limits, f"{end}-LIMIT").character_data) for end in ("LOWER", "UPPER")]
        assert ends == [signal.min, signal.max]
    for name, words in {"verdict": VERDICTS, "reason": REASONS, "status": STATUSES}.items():
        method = child(by_name[name], "COMPU-METHOD-REF").reference_target
        scales = child(method, "COMPU-INTERNAL-TO-PHYS", "COMPU-SCALES").sub_elements
        assert [child(scale, "COMPU-CONST", "VT").character_data for scale in scales] == list(words)


def test_the_source_is_c_without_warnings(files, rte, vehicle):
    source = rte / "strict.c"
    source.write_text(files[f"{NAME}.c"])
    strict = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wno-unused-function", "-Werror"]
    folders = [f"-I{folder}" for folder in (rte, vehicle)]
    command = [*native.find_compiler(cxx=False), *strict, *folders, "-isystem", library_root() / "include"]
    subprocess.run([*command, "-fsyntax-only", source], check=True)


def test_its_verdicts_are_the_cores_bit_for_bit(component, core, g80, synthetic):
    drive = read_drive(synthetic / "synthetic_01.csv", g80)
    y = drive.y.copy()
    y[len(y) // 2 :] *= 0.5
    expected = core.monitor().run(drive.t, drive.v, drive.u, y)
    component.start(0)
    seen = np.array([stepped(component, row) for row in np.column_stack([drive.v, drive.u, y])])
    assert VERDICTS.index("invalid") in seen[:, 0]
    np.testing.assert_array_equal(seen[:, 0], expected.verdict)
    np.testing.assert_array_equal(seen[:, 1], expected.energy)
    np.testing.assert_array_equal(seen[:, 2], expected.change)


def test_it_does_not_run_with_the_coefficients_of_another_vehicle(component):
    component.start(1)
    assert stepped(component, [10.0, 0.0, 0.0])[0] == VERDICTS.index("fault")
    component.start(0)
    assert stepped(component, [10.0, 0.0, 0.0])[0] == VERDICTS.index("unknown")


def test_an_unread_signal_becomes_a_gap(component):
    component.start(0)
    for _ in range(5):
        stepped(component, [10.0, 0.0, 0.0])
    seen = [stepped(component, [10.0, 0.0, 0.0], error=1)[0] for _ in range(7)]
    assert seen[-1] == VERDICTS.index("stale") and seen[0] != seen[-1]


def test_the_command_writes_both_files_and_says_what_is_missing(lpvguard, vehicle, tmp_path, monkeypatch):
    done = lpvguard("arxml", "--vehicle", "g80", "--coefficients", vehicle, "-o", tmp_path / "component")
    assert done.returncode == 0, done.stderr
    names = {path.name for path in (tmp_path / "component").iterdir()}
    assert names == {f"{NAME}.arxml", f"{NAME}.c", artefacts.MANIFEST}
    monkeypatch.setitem(sys.modules, "autosar", None)
    refused = lpvguard("arxml", "--vehicle", "g80", "--coefficients", vehicle, "-o", tmp_path / "other")
    assert refused.returncode == 2 and "lpvguard[autosar]" in refused.stderr
    assert not (tmp_path / "other").exists()
