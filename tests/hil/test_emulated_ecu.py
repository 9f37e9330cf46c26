"""The firmware on the emulated Cortex-R5F, over its own CAN controller and a real vcan0 (tools/with-vcan):
frame for frame what the same firmware says as a process of the host. All shipped scenarios with tools/test
--full."""

import hashlib
import json
import os

import pytest

from lpvguard.base.errors import InputError
from lpvguard.core import targets
from lpvguard.extras.loop.sim import can_fault_table, load_scenario, shipped_scenarios, steady_scenario
from parts import require
from vcan import sim_words, with_vcan

FULL = os.environ.get("LPVGUARD_FULL") == "1"
R5F = targets.TARGETS["cortex-r5f"]
SHORT = steady_scenario(
    6.0,
    can_fault_table("VDC2", "unknown_id", 2.0, 2.5)
    + can_fault_table("VDC2", "lost", 3.0, 3.2)
    + can_fault_table("VDC2", "bus_off", 4.05, 4.15),
    title="lost and off the bus",
    expect='verdict = "any"\nsupervision = "reacts"\nfault_start_s = 3.0\nwithin_periods = 5',
)


@pytest.fixture(scope="module")
def on_vcan(simulator, truck_folder):
    """on_vcan(scenarios, option, ...): the runs of `lpvguard sim` on vcan0."""
    require("qemu")
    simulator.emulated("cortex-r5f")  # compiled here, and not on the one processor of the guest
    assert simulator.ecu_program.is_file()

    def run(scenarios, *options):
        done = with_vcan(*sim_words(truck_folder, *scenarios), *options, timeout=3000)
        assert done.returncode in (0, 1) and done.stdout, done.stderr
        return json.loads(done.stdout)

    return run


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    path = tmp_path_factory.mktemp("short") / "short.toml"
    path.write_text(SHORT)
    return path


def compare(emulated, host):
    assert emulated["verdicts"] == host["verdicts"] and emulated["supervision"] == host["supervision"]
    assert (emulated["frames"], emulated["frames_hash"]) == (host["frames"], host["frames_hash"])
    assert emulated["reception"] == host["reception"] and emulated["trouble_codes"] == host["trouble_codes"]
    assert emulated["missed"] == host["missed"] and emulated["diagnoses"] == host["diagnoses"]
    for key in ("judged_s", "judged_to_invalid_s", "max_margin"):
        assert emulated[key] == host[key]


@pytest.mark.serial
@pytest.mark.long("38 s: an emulator on vcan0")
def test_the_emulated_ecu_sends_the_hosts_frames_through_loss_and_bus_off(on_vcan, short, simulator):
    (host,) = on_vcan([short], "--ecu-process")
    first, again = on_vcan([short, short], "--target", "cortex-r5f")
    print(f"{first['real_time_factor']:g} simulated s per real s; {first['ecu']}")
    compare(first, host)
    states = [state for _, state in first["supervision"]]
    assert states == ["off", "live", "off", "live", "off", "live"] or states == [
        "off",
        "live",
        "hold",
        "off",
        "live",
        "off",
        "live",
    ]
    assert first["reception"]["send_failures"] == 10  # of 100 ms off the bus
    assert (
        first["ecu"]["elf_sha256"]
        == hashlib.sha256(
            simulator.emulated("cortex-r5f").program.with_suffix(".elf").read_bytes()
        ).hexdigest()
    )
    counted = first["ecu"]["instructions"]
    assert counted["ticks"] == 600 and 0 < counted["total"] / 600 < counted["worst"] < 45_000, "step and CMAC"
    assert again["ecu"] == first["ecu"], "to the instruction"


@pytest.mark.long("every scenario in an emulator")
@pytest.mark.serial
@pytest.mark.parametrize("name", shipped_scenarios() if FULL else ["every scenario"])
def test_every_scenarios_verdicts_on_the_emulated_ecu_are_the_hosts(on_vcan, name):
    (host,), (emulated,) = on_vcan([name], "--ecu-process"), on_vcan([name], "--target", "cortex-r5f")
    print(f"{name}: {emulated['real_time_factor']:g} simulated s per real s")
    compare(emulated, host)


def test_targets_without_a_can_controller_and_buses_without_a_kernel_are_refused(simulator, short):
    for name in ("cortex-m4f", "cortex-m7"):
        with pytest.raises(InputError, match="no CAN controller; expected host, cortex-r5f"):
            simulator.run(load_scenario(str(short)), bus="socketcan:vcan0", target=name)
    with pytest.raises(InputError, match="unknown"):
        simulator.run(load_scenario(str(short)), bus="socketcan:vcan0", target="cortex-m0")
    if not targets.missing_tools(R5F):
        with pytest.raises(InputError, match="expected socketcan:INTERFACE"):
            simulator.run(load_scenario(str(short)), target="cortex-r5f")
    with pytest.raises(InputError, match="expected socketcan:INTERFACE"):
        simulator.run(load_scenario(str(short)), ecu_process=True)
