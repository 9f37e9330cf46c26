"""The ECU's FMU on the bus of the truck's FMU: the frames and verdicts of `lpvguard sim`."""

import struct
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from lxml import etree

from bus_master import Node, exchange, frames, operations, transmit
from lpvguard.core.compiled import SUPERVISION, VERDICTS, shipped_vehicle
from lpvguard.extras.fmu.package import ecu_fmu, monitor_fmu, plant_fmu
from lpvguard.extras.loop.sim import Simulator, load_scenario
from plain_fmu import Running, compile_sources

pytestmark = pytest.mark.slow("60 s: scenarios frame by frame under fmpy")
SCENARIOS = ("yaw_sign", "dead_yaw_sensor", "brake_gain_40", "lossy_bus", "corrupted_command", "load_plus_40")
EXTENDED = 0x80000000
SCHEMAS = Path(fmpy.__file__).parent / "schema" / "fmi3"
MANIFEST = "extra/org.fmi-standard.fmi-ls-bus/fmi-ls-manifest.xml"


@pytest.fixture(scope="module")
def bus_fmus(truck, tmp_path_factory) -> dict[str, Path]:
    """ECU and truck, FMI 3.0."""
    folder = tmp_path_factory.mktemp("bus")
    for kind, make in (("ecu", ecu_fmu), ("plant", plant_fmu)):
        (folder / f"{kind}.fmu").write_bytes(make(truck, shipped_vehicle("truck"), 3))
    return {kind: folder / f"{kind}.fmu" for kind in ("ecu", "plant")}


class Hash:
    """FNV-1a of frames as the simulator makes it: identifier, time, bytes."""

    def __init__(self):
        self.value, self.count = 0xCBF29CE484222325, 0

    def take(self, t_us: int, data: bytes) -> None:
        for identifier, content in frames(data):
            self.count += 1
            head = (identifier | EXTENDED).to_bytes(4, "little") + t_us.to_bytes(8, "little")
            for byte in head + content:
                self.value = ((self.value ^ byte) * 0x100000001B3) & 0xFFFFFFFFFFFFFFFF


@pytest.mark.parametrize("name", SCENARIOS)
def test_ecu_and_truck_exchange_the_frames_of_sim(name, bus_fmus, tmp_path):
    scenario = load_scenario(name)
    expected = Simulator(shipped_vehicle("truck")).run(scenario)
    ecu = Node(bus_fmus["ecu"], tmp_path / "ecu", authentication=True)
    plant = Node(bus_fmus["plant"], tmp_path / "plant", scenario=scenario.path.read_text())
    seen, verdicts, supervision = Hash(), [], []
    for k in range(round(expected["duration_s"] / ecu.period)):
        for data in exchange([ecu, plant]):
            seen.take(10_000 * k, data)
        for changes, variable, names in (
            (verdicts, "verdict", VERDICTS),
            (supervision, "supervision", SUPERVISION),
        ):
            value = names[ecu.number(variable)]
            if not changes or changes[-1][1] != value:
                changes.append([round(k * ecu.period, 9), value])
        for node in (ecu, plant):
            node.step(k * node.period)
    assert verdicts == expected["verdicts"] and supervision == expected["supervision"]
    assert (seen.count, f"{seen.value:016x}") == (expected["frames"], expected["frames_hash"])


@pytest.mark.parametrize("version", (2, 3))
@pytest.mark.parametrize("make", (ecu_fmu, plant_fmu))
def test_fmpy_and_the_schemas_find_no_problem(make, version, truck, tmp_path):
    path = tmp_path / "one.fmu"
    path.write_bytes(make(truck, shipped_vehicle("truck"), version))
    assert validate_fmu(str(path)) == []
    files = {"sources/buildDescription.xml": "BuildDescription"}
    files |= {"terminalsAndIcons/terminalsAndIcons.xml": "TerminalsAndIcons"}
    with zipfile.ZipFile(path) as archive:
        for file, schema in files.items() if version == 3 else ():
            read = etree.XMLSchema(file=str(SCHEMAS / f"fmi3{schema}.xsd"))
            read.assertValid(etree.fromstring(archive.read(file)))
        if version == 3:
            manifest = etree.fromstring(archive.read(MANIFEST))
            own = {etree.QName(key).localname: value for key, value in manifest.items()}
            assert own["fmi-ls-name"] == "org.fmi-standard.fmi-ls-bus" and own["fmi-ls-version"] == "1.0.0"
            attributes = etree.XMLSchema(file=str(SCHEMAS / "fmi3LayeredStandardManifest.xsd"))
            assert attributes is not None and own["isBusSimulationFMU"] == "false"


@pytest.mark.parametrize("kind", ("ecu", "plant"))
def test_the_sources_compile_as_their_build_description_says(kind, bus_fmus, tmp_path):
    assert compile_sources(bus_fmus[kind], tmp_path) > 12


def test_the_first_operations_configure_the_bus_simulation(bus_fmus, tmp_path):
    ecu = Node(bus_fmus["ecu"], tmp_path)
    configuration = [content for code, content in operations(ecu.send()) if code == 0x40]
    assert configuration == [bytes([1]) + (250_000).to_bytes(4, "little"), bytes([4, 1])]


def test_saved_states_go_on_with_the_same_bytes_and_in_another_instance(bus_fmus, tmp_path):
    text = load_scenario("dead_yaw_sensor").path.read_text()
    ecu = Node(bus_fmus["ecu"], tmp_path / "ecu", authentication=True)
    plant = Node(bus_fmus["plant"], tmp_path / "plant", scenario=text)
    other = Node(bus_fmus["ecu"], tmp_path / "other", authentication=True)

    def run(controller: Node, start: int, end: int) -> list[bytes]:
        sent = []
        for k in range(start, end):
            sent += exchange([controller, plant])
            for node in (controller, plant):
                node.step(k * node.period)
        return sent

    begin = 0
    instants = np.random.default_rng(60).choice(np.arange(5, 3000, 11), 50, replace=False)
    for instant in sorted(instants.tolist()):
        run(ecu, begin, instant)
        saved, truth = ecu.state(), plant.fmu.getFMUState()
        first = run(ecu, instant, instant + 10)
        after = ecu.state()
        ecu.restore(saved)
        plant.fmu.setFMUState(truth)
        assert ecu.state() == saved
        assert run(ecu, instant, instant + 10) == first and ecu.state() == after
        other.restore(saved)
        plant.fmu.setFMUState(truth)
        assert run(other, instant, instant + 10) == first and other.state() == after
        plant.fmu.freeFMUState(truth)
        begin = instant + 10


def test_a_corrupt_operation_comes_back_as_a_format_error_and_notifications_change_nothing(
    bus_fmus, tmp_path
):
    ecu = Node(bus_fmus["ecu"], tmp_path)
    unknown = struct.pack("<II", 0x77, 8)
    wrong = struct.pack("<IIIBBH", 0x10, 18, 1, 0, 0, 9) + b"ab"
    fine = transmit(0x18F0093E, bytes(8)) + struct.pack("<III", 0x20, 12, 7) + struct.pack("<IIB", 0x41, 9, 1)
    cut = struct.pack("<II", 0x10, 400) + b"abc"
    ecu.receive(unknown + fine + wrong + cut)
    refused = [content[2:] for code, content in operations(ecu.send()) if code == 0x01]
    assert refused == [unknown, wrong, cut]
    assert ecu.said == []


def test_what_an_importer_does_wrong_is_named(bus_fmus, tmp_path):
    ecu = Node(bus_fmus["ecu"], tmp_path / "ecu")
    with pytest.raises(FMICallException):
        ecu.step(0.0)
    assert "CAN.Tx_Clock has not ticked; activate it every 0.01 s in event mode" in ecu.said[-1]
    ecu.fmu.enterEventMode()
    ecu.send()
    with pytest.raises(FMICallException):
        ecu.fmu.doStep(0.0, ecu.period)
    assert "in event mode" in ecu.said[-1]
    with pytest.raises(FMICallException):
        ecu.step(0.0, 0.02)
    assert "expected the sample period 0.01 s" in ecu.said[-1]
    with pytest.raises(FMICallException):
        ecu.receive(b"x" * 8)
    assert "outside event mode" in ecu.said[-1]
    with pytest.raises(FMICallException):
        ecu.fmu.setFloat64([0], [float("nan")])
    assert "expected a finite number" in ecu.said[-1]
    with pytest.raises(FMICallException):
        ecu.fmu.setBoolean([300], [True])
    assert "fixed once the initialisation has ended" in ecu.said[-1]
    with pytest.raises(Exception, match=r"instantiate|fmi3ExitInitializationMode"):
        Node(bus_fmus["plant"], tmp_path / "plant", scenario="title = 1")


def test_an_fmu_without_a_terminal_is_named(g80, vehicle, tmp_path):
    (tmp_path / "monitor.fmu").write_bytes(monitor_fmu(g80, vehicle, 3))
    with pytest.raises(ValueError, match=r"no terminalsAndIcons\.xml; expected a CAN terminal"):
        Node(tmp_path / "monitor.fmu", tmp_path / "monitor")


@pytest.mark.parametrize("version", (2, 3))
def test_plain_signals_close_the_loop_without_a_bus(version, truck, tmp_path):
    nodes = {}
    for kind, make in (("ecu", ecu_fmu), ("plant", plant_fmu)):
        path = tmp_path / f"{kind}.fmu"
        path.write_bytes(make(truck, shipped_vehicle("truck"), version))
        nodes[kind] = Running(path, tmp_path / kind, version)
    ecu, plant = nodes["ecu"], nodes["plant"]
    speeds = ("wheel_speed_rear_left", "wheel_speed_rear_right")
    for k in range(3000):
        speed, r, steering, lateral, *wheels = plant.numbers(
            "speed", "yaw_rate", "steering_wheel_angle", "lateral_acceleration", *speeds
        )
        left, right = plant.numbers("brake_pressure_left", "brake_pressure_right")
        ecu.set(
            **{
                "VDC2.yaw_rate": r,
                "VDC2.steering_wheel_angle": steering,
                "VDC2.lateral_acceleration": lateral,
                "EBC2.front_axle_speed": 3.6 * speed,
                "EBC2.relative_speed_rear1_left": 3.6 * (wheels[0] - speed),
                "EBC2.relative_speed_rear1_right": 3.6 * (wheels[1] - speed),
                "GUARD_IN.dp_measured": right - left,
                "GUARD_IN.yaw_rate_command": 0.05 if k % 1000 < 500 else -0.05,
                "GUARD_IN.control_request": float(k > 20),
            }
        )
        ecu.step(k * ecu.period)
        plant.set(brake_demand=ecu.numbers("brake_pressure_difference")[0])
        plant.step(k * plant.period)
    assert ecu.codes("supervision", "engagement") == [SUPERVISION.index("live"), 1]
    assert abs(plant.numbers("true_yaw_rate")[0] + 0.05) < 0.02
    assert ecu.codes("frames")[0] > 0


def test_a_vehicle_without_ecu_is_refused(g80, vehicle, lpvguard, tmp_path):
    words = ("--vehicle", "g80", "--coefficients", vehicle, "--as", "ecu", "-o", tmp_path / "x.fmu")
    assert "the vehicle has no ECU" in lpvguard("fmu", *words).stderr
