"""The fault table at firmware level (lpvguard/extras/loop/bus_faults.py): every fault shows the
state that it must, by its limit."""

import dataclasses
import json

import pytest

from lpvguard.extras.loop.bus_faults import BUS_FAULTS, BusFault, run_fault


@pytest.mark.parametrize("fault", BUS_FAULTS, ids=lambda c: f"{c.message} {c.name}")
def test_each_fault_is_met_in_time(fault, simulator):
    row = run_fault(simulator, fault)
    assert row["missed"] == []
    assert row["demand_max_bar"] > 0.3, "the loop was steering"


def test_the_table_finds_what_is_missing(simulator):
    lost = BusFault("lost", "VDC2", "lost", 20, "missed", 1, "off", 5)

    def missing(**changes) -> str:
        return "; ".join(run_fault(simulator, dataclasses.replace(lost, **changes))["missed"])

    assert missing() == ""
    assert "state off, not hold" in missing(state="hold")
    assert "off after 50 ms" in missing(within=4)
    assert "first seen as missed, not as checksum" in missing(seen="checksum")
    assert "seen after 10 ms" in missing(seen_within=0.5)
    assert "state live, not off" in missing(periods=1)


def test_foreign_frames_change_no_output(simulator, tmp_path):
    """Ten foreign frames with each VDC2: whatever else goes over the bus stays the same, byte for byte."""
    flood = next(c for c in BUS_FAULTS if c.kind == "unknown_id")
    logs = []
    for name, probability in (("flood", 1), ("quiet", 0)):
        run_fault(simulator, dataclasses.replace(flood, probability=probability), out=tmp_path / name)
        logs.append((tmp_path / name / "fault-1.log").read_text().splitlines())
    foreign = [line for line in logs[0] if "18FFEE00" in line]
    assert len(foreign) == 1000 and not any("18FFEE00" in line for line in logs[1])
    assert [line for line in logs[0] if "18FFEE00" not in line] == logs[1]


@pytest.mark.unhurried
def test_the_command_prints_the_table(lpvguard, truck_folder):
    done = lpvguard("bench", "can", "--coefficients", truck_folder, "--json", "-")
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)
    assert [(r["fault"], r["message"]) for r in rows] == [(c.name, c.message) for c in BUS_FAULTS]
    assert "bus-off" in done.stderr and "stuck counter" in done.stderr
