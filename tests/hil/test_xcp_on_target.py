"""pyxcp reads the ECU on the emulated Cortex-R5F over a real vcan0, at the places that its A2L names."""

import json
import sys
from pathlib import Path

import pytest

from lpvguard.core import targets
from lpvguard.extras.measure.image import read_instance
from parts import require
from vcan import with_vcan

pytest.importorskip("pyxcp", reason="pip install pyxcp")
HERE = Path(__file__).resolve().parent
STEPS = 40
VDC2 = 0x18F0093E


@pytest.fixture(scope="module")
def elf(truck_folder) -> Path:
    require("qemu")
    ports = targets.firmware_root() / "ports" / "cortex_r5_ecu"
    folders = (ports, targets.firmware_root() / "ecu")
    program = targets.Program("xcp_ecu", (HERE / "xcp_ecu.cpp", ports / "can0.c"), {}, folders)
    return targets.image_with_debug_information("cortex-r5f", truck_folder, program)


@pytest.mark.long("30 s: an emulator on vcan0")
@pytest.mark.serial
@pytest.mark.requirement("REQ-XCP-6")
def test_a_measurement_tool_reads_the_emulated_ecu(elf):
    instance = read_instance(elf, "ecu", ("lpvg_truck_ecu_t",))
    at = {f.path: (instance.address + f.offset, f.bytes) for f in instance.fields}
    command, text = targets.on_can("cortex-r5f", elf, "vcan0")
    done = with_vcan(
        sys.executable,
        HERE / "xcp_on_vcan.py",
        json.dumps(
            {
                "command": command,
                "input": text,
                "steps": STEPS,
                "vdc2": VDC2,
                "list": [
                    ("now_us", at[".now_us"][0], "U32"),  # of eight bytes, more than a frame holds
                    ("verdict", at[".report.verdict"][0], "U8"),
                    ("causes", at[".causes"][0], "U16"),
                ],
                "read": [at[".kept.period_us"], at[".kept.rate_max"], (at[".now_us"][0], 4)],
            }
        ),
    )
    assert done.returncode == 0 and done.stdout, done.stderr
    said = json.loads(done.stdout)
    assert said["name"] == "truck"
    rows = said["rows"]
    assert [row["now_us"] for row in rows] == [10_000 * (k + 1) for k in range(STEPS)]
    assert {row["verdict"] for row in rows} == {0}, "unknown: no message is live"
    assert all(row["causes"] & 2 for row in rows)
    period, rate, now = (
        bytes.fromhex(said["read"][str(at[p][0])]) for p in (".kept.period_us", ".kept.rate_max", ".now_us")
    )
    assert int.from_bytes(period, "little") == 10_000 and rate == b"\x00\x00\x20\x42"
    assert int.from_bytes(now, "little") == 10_000 * STEPS
