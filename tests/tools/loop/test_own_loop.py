"""The ECU's loop on a car's own bus: in `sim` and as an FMU, with another car's FMU as the vehicle."""

import subprocess
from dataclasses import replace
from pathlib import Path

import cantools
import numpy as np
import pytest
from c_fmu import c_fmu
from fmpy.validation import validate_fmu

from any_vehicle import STEERING, WITH_MOMENT, designable, designed_into, identified_into
from bus_master import Node, frames, transmit
from lpvguard.base.errors import InputError
from lpvguard.can.logs import EXTENDED, read_log
from lpvguard.control.controller_export import export_chosen
from lpvguard.core.compiled import VERDICTS, library_root
from lpvguard.extras.fmu.package import ecu_fmu, plant_fmu
from lpvguard.extras.loop.foreign_plant import ForeignPlant
from lpvguard.extras.loop.sim import Simulator, can_fault_table, load_scenario, steady_scenario
from lpvguard.identify import identification
from own_car import DATA_ID, DBC, on_own_bus
from plain_fmu import Running, compile_sources

pytestmark = pytest.mark.slow("60 s: a car identified and designed, its loop and FMUs compiled")
VARIABLES = {
    "delta": (0, "input"),
    "moment": (1, "input"),
    "v_wanted": (2, "input"),
    "on_angle": (3, "parameter"),
    "kmh": (10, "output"),
    "yaw_deg": (11, "output"),
}
MAP = """
step_s = 0.005
[parameters]
on_angle = {gain}
[inputs]
road_wheel_angle = "delta"
{more}speed = "v_wanted"
[outputs]
speed = {{ variable = "kmh", factor = 0.2777777777777778 }}
yaw_rate = {{ variable = "yaw_deg", factor = 0.017453292519943295 }}
"""
MOMENT = 'yaw_moment = { variable = "moment", factor = 0.001 }\n'
COMMAND, GUARD_OUT, DM1 = 0x1A2, 0x0CFF01FC | EXTENDED, 0x18FECAFC | EXTENDED
FROM_ECU = (COMMAND, GUARD_OUT, DM1)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(
            ("g80", STEERING),
            id="1x1",
            marks=pytest.mark.long("60 s: a second vehicle, from drives to its loop"),
        ),
        pytest.param(("vectoring", WITH_MOMENT), id="2x1"),
    ],
)
def vehicle(request, made, tmp_path_factory) -> Path:
    """Generated folder of a designed car on its own bus."""
    (name, settings), folder = request.param, tmp_path_factory.mktemp("own")
    project = designable(name, **settings)
    stored = identification.load(
        made.folder(f"{name}_for_design", lambda path: identified_into(path, project))
    )
    design = made.folder(f"{name}_designed", lambda path: designed_into(path, stored))
    export_chosen(replace(stored, project=on_own_bus(stored.project, folder)), folder / "vehicle", design)
    return folder / "vehicle"


@pytest.fixture(scope="module")
def simulator(vehicle) -> Simulator:
    return Simulator(vehicle)


@pytest.fixture(scope="module")
def steered_car(tmp_path_factory) -> Path:
    """FMU of another car, in C."""
    return c_fmu("steered_car", VARIABLES, tmp_path_factory.mktemp("steered_car"))


def plant_of(simulator: Simulator, fmu: Path, folder: Path, gain: float = 1.0) -> ForeignPlant:
    """The other car with a factor on its steering."""
    more = MOMENT if simulator.project.n_u == 2 else ""
    (folder / "map.toml").write_text(MAP.format(gain=gain, more=more))
    return ForeignPlant(fmu, folder / "map.toml", simulator.project)


def run(simulator: Simulator, fmu: Path, folder: Path, gain: float = 1.0, faults: str = "", **more) -> dict:
    (folder / "steady.toml").write_text(steady_scenario(40.0, faults, speed_mps=10.3, **more))
    scenario = load_scenario(str(folder / "steady.toml"))
    return simulator.run(scenario, plant=plant_of(simulator, fmu, folder, gain), out=folder / "runs")


def demands_of(log) -> np.ndarray:
    """Demands (N, 2) [deg, N m] of the frames of COMMAND, whose counter and checksum are right."""
    message = cantools.database.load_string(DBC, "dbc").get_message_by_name("COMMAND")
    at = np.flatnonzero(log.id == COMMAND)
    rows = log.data[at, :8]
    assert ((rows[:, 1] & 15) == (1 + np.arange(len(rows))) % 15).all()
    assert [crc_p01(row) for row in rows[:50]] == rows[:50, 0].tolist()
    decoded = [message.decode(row.tobytes()) for row in rows]
    return np.array([[d["ANGLE"], d["MOMENT"]] for d in decoded])


def crc_p01(row: np.ndarray) -> int:
    """CRC of AUTOSAR's profile 1, mode BOTH, bit by bit: polynomial 0x1D over data id and the other bytes."""
    crc = 0
    for byte in (DATA_ID, 0, *row[1:].tolist()):
        for k in range(7, -1, -1):
            out = crc >> 7 ^ byte >> k & 1
            crc = crc << 1 & 0xFF ^ (0x1D if out else 0)
    return crc


def test_the_certified_controller_steers_another_car_over_the_cars_own_frames(
    simulator, steered_car, tmp_path
):
    got = run(simulator, steered_car, tmp_path)
    assert got["missed"] == [] and got["verdict_final"] in ("valid", "not_judged")
    assert got["tracking_rms"] < 0.15 * got["command_rms"]
    assert set(got["reception"]["messages"]) == {"SPEED", "MOTION", "GUARD_IN", "other"}
    assert all(
        m["counts"].keys() <= {"accepted", "recovering"} for m in got["reception"]["messages"].values()
    )
    log = read_log(tmp_path / "runs" / "steady-1.log")
    assert (log.id == 0x1A0).sum() == 3999 and (log.id == COMMAND).sum() == 2000
    angle, moment = np.abs(demands_of(log)).max(axis=0)
    assert np.radians(angle) == pytest.approx(got["demand_max"][0], rel=1e-6)
    if simulator.project.n_u == 2:
        assert moment == pytest.approx(1000.0 * got["demand_max"][1], rel=1e-6)
    again = run(simulator, steered_car, tmp_path)
    assert again["frames_hash"] == got["frames_hash"]


def test_a_weak_steering_is_found_and_every_demand_released(simulator, steered_car, tmp_path):
    got = run(simulator, steered_car, tmp_path, gain=0.3, expect='verdict = "any"\nsupervision = "live"')
    assert got["verdict_final"] == "invalid" and got["first_invalid_s"] < 10.0
    demands = demands_of(read_log(tmp_path / "runs" / "steady-1.log"))
    released = round((got["first_invalid_s"] + 1.0) / 0.02)
    assert np.abs(demands[:released, 0]).max() > 0 and (demands[released:] == 0.0).all()


@pytest.mark.parametrize("kind", ("lost", "corrupted", "repeated", "wrong_length"))
@pytest.mark.parametrize("message", ("SPEED", "GUARD_IN"))
def test_faults_of_the_cars_messages_release_within_six_periods(
    message, kind, simulator, steered_car, tmp_path
):
    expect = 'verdict = "any"\nsupervision = "reacts"\nwithin_periods = 6\n'
    expect += "fault_start_s = 20.0\nfault_end_s = 25.0"
    fault = can_fault_table(message, kind, 20.0, 25.0)
    got = run(simulator, steered_car, tmp_path, faults=fault, expect=expect)
    assert got["missed"] == []


def test_the_ecus_fmu_answers_the_frames_of_sim_with_its_bytes(vehicle, simulator, steered_car, tmp_path):
    project = simulator.project
    got = run(simulator, steered_car, tmp_path, gain=0.5, expect='verdict = "any"\nsupervision = "live"')
    log = read_log(tmp_path / "runs" / "steady-1.log")
    (tmp_path / "ecu.fmu").write_bytes(ecu_fmu(project, vehicle, 3))
    assert validate_fmu(str(tmp_path / "ecu.fmu")) == []
    assert compile_sources(tmp_path / "ecu.fmu", tmp_path / "sources") > 12
    ecu = Node(tmp_path / "ecu.fmu", tmp_path / "ecu", authentication=True)
    tick = np.maximum(-(-log.t_ns // 20_000_000), 0)  # a frame between two ticks arrives at the later one
    verdicts: list[list] = []
    for k in range(round(got["duration_s"] / project.Ts_s)):
        of_tick = log.at(tick == k)
        sent = [
            (int(i), d[:n].tobytes())
            for i, d, n in zip(of_tick.id, of_tick.data, of_tick.length, strict=True)
        ]
        ecu.receive(b"".join(can_operation(i, d) for i, d in sent if i not in FROM_ECU))
        assert frames(ecu.send()) == [(i & 0x1FFFFFFF, d) for i, d in sent if i in FROM_ECU], k
        verdict = VERDICTS[ecu.number("verdict")]
        if not verdicts or verdicts[-1][1] != verdict:
            verdicts.append([pytest.approx(k * project.Ts_s), verdict])
        ecu.step(k * ecu.period)
    assert got["verdicts"] == verdicts and "invalid" in str(verdicts)


def can_operation(identifier: int, data: bytes) -> bytes:
    """Operation that sends a frame of either format."""
    operation = bytearray(transmit(identifier & 0x1FFFFFFF, data))
    operation[12] = identifier & EXTENDED != 0
    return bytes(operation)


@pytest.mark.parametrize("version", (2, 3))
def test_plain_signals_close_the_loop_with_the_nominal_car(version, vehicle, simulator, tmp_path):
    project = simulator.project
    (tmp_path / "ecu.fmu").write_bytes(ecu_fmu(project, vehicle, version))
    assert validate_fmu(str(tmp_path / "ecu.fmu")) == []
    ecu = Running(tmp_path / "ecu.fmu", tmp_path / "ecu", version)
    with pytest.raises(InputError, match="a vehicle on its own bus"):
        plant_fmu(project, vehicle, version)
    gain, lag_s, r, before = 10.3 / (2.66 + 0.0027 * 10.3**2), 0.0482, 0.0, 0.0  # the nominal car at 10.3 m/s
    for k in range(1000):
        command = {"GUARD_IN.reference": 0.05, "GUARD_IN.control_request": float(k > 20)}
        ecu.set(speed=10.3, yaw_rate=r, **command)
        ecu.step(k * ecu.period)
        r += (1.0 - np.exp(-ecu.period / lag_s)) * (gain * before - r)
        angle, *moments = ecu.numbers(*(s.name for s in project.inputs))
        before = angle + 0.00507 * sum(moments)
    assert ecu.codes("engagement") == [1] and r == pytest.approx(0.05, abs=0.005)
    saved = ecu.state()
    ecu.step(20.0)
    ecu.restore(saved)
    assert ecu.state() == saved


def test_the_exported_c_is_strict_c99_without_a_warning(vehicle, tmp_path):
    words = [
        "gcc",
        "-std=c99",
        "-pedantic",
        "-Wall",
        "-Wextra",
        "-Wconversion",
        "-Wdouble-promotion",
        "-Wshadow",
        "-Werror",
    ]
    sources = sorted(vehicle.glob("*.c"))
    assert len(sources) == 8
    for source in sources:
        folders = ["-I", library_root() / "include", "-I", vehicle]
        subprocess.run([*words, *folders, "-c", source, "-o", tmp_path / "one.o"], check=True)


def test_what_does_not_fit_is_named(vehicle, simulator, steered_car, lpvguard, tmp_path):
    (tmp_path / "steady.toml").write_text(steady_scenario(5.0, speed_mps=10.3))
    scenario = load_scenario(str(tmp_path / "steady.toml"))
    with pytest.raises(InputError, match="--plant: missing; expected an FMU of the vehicle"):
        simulator.run(scenario)
    with pytest.raises(InputError, match="--controller: feedforward; expected designed, or off"):
        Simulator(vehicle, controller="feedforward")
    (tmp_path / "map.toml").write_text(
        MAP.format(gain=1.0, more="").replace('road_wheel_angle = "delta"\n', "")
    )
    with pytest.raises(InputError, match=r"inputs\.road_wheel_angle: missing"):
        ForeignPlant(steered_car, tmp_path / "map.toml", simulator.project)
    with pytest.raises(InputError, match=r"expected one of: SPEED MOTION GUARD_IN"):
        run(simulator, steered_car, tmp_path, faults=can_fault_table("VDC2", "lost", 1.0, 2.0))
    (tmp_path / "steady.toml").write_text(steady_scenario(5.0, speed_mps=10.3))
    plant_of(simulator, steered_car, tmp_path)
    words = ("--coefficients", vehicle, "--plant", steered_car, "--map", tmp_path / "map.toml")
    done = lpvguard("sim", tmp_path / "steady.toml", *words)
    assert done.returncode == 0, done.stderr
