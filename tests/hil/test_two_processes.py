"""Firmware and plant as two processes on a real vcan0 (tools/with-vcan): nothing lost or late; floods of
foreign frames, and babbling with an identifier of the loop's own. The long forms (10 minutes of simulated
time; a flood of 60 s) run with tools/test --full."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lpvguard.base import artefacts
from lpvguard.can.decode import decode_all, own_database
from lpvguard.can.logs import read_log
from lpvguard.extras.loop.sim import RECOVERY_S, load_scenario, steady_scenario
from vcan import sim_words, with_vcan

FULL = os.environ.get("LPVGUARD_FULL") == "1"
WARM_S = 3.0


@pytest.fixture
def loop(simulator, truck_folder, tmp_path):
    """loop(seconds, flood seconds, commands): the same run in memory, and as two processes beside the
    commands."""

    def run(duration: float, for_s: float = 0.0, *commands: str, more: str = ""):
        path = tmp_path / "loop.toml"
        path.write_text(steady_scenario(duration, more))
        want = simulator.run(load_scenario(str(path)))
        assert simulator.ecu_program.is_file()  # compiled here, and not on the one processor of the guest
        sim = [*sim_words(truck_folder, path), "--ecu-process", "-o", tmp_path / "out"]
        if commands:
            words = [word for c in commands for word in ["--", *c.split()]][1:]
            beside = [sys.executable, Path(__file__).with_name("on_vcan.py")]
            sim = [*beside, *sim, "--pace", 1, "--", WARM_S, for_s, *words]
        done = with_vcan(*sim, timeout=900)
        if commands:
            assert done.returncode == 0, done.stderr
            said = json.loads(done.stdout)
            assert isinstance(said["loop"], list), said["loop"]
            return want, said["loop"][0], said
        assert done.returncode in (0, 1) and done.stdout, done.stderr
        return want, json.loads(done.stdout)[0], {}

    return run


def all_good(run) -> bool:
    """Nothing but good frames, by the supervision's count."""
    return all(set(m["counts"]) <= {"accepted", "recovering"} for m in run["reception"]["messages"].values())


@pytest.mark.serial
@pytest.mark.slow("in real time on vcan0")
def test_two_processes_lose_nothing_and_send_the_frames_of_one(loop):
    want, got, _ = loop(600.0 if FULL else 30.0)
    print(f"{got['duration_s']:g} s, {got['frames']} frames")
    assert got["frames_hash"] == want["frames_hash"] and got["frames"] == want["frames"]
    assert all_good(got) and got["reception"]["send_failures"] == 0
    assert got["verdicts"] == want["verdicts"] and got["supervision"] == want["supervision"]
    assert got["reception"] == want["reception"]


@pytest.mark.long("a flood on vcan0 in real time")
@pytest.mark.serial
def test_a_flood_of_foreign_identifiers_changes_nothing(loop):
    """The filter: lpvguard_ecu hands the kernel identifier and mask of each message that it supervises; no
    other frame is received."""
    for_s = 60.0
    want, got, beside = loop(
        WARM_S + for_s + 3.0,
        for_s,
        "cangen -g 0 -p 10 vcan0",
        "cangen -e -I 18F0043E -g 0 -p 10 vcan0",
        "cansend vcan0 123#DEADBEEF",
    )
    print(f"{beside['sent']} frames on the bus in {beside['took_s']:.1f} s")
    assert beside["sent"] > 500 * for_s, "a flood"
    assert got["frames_hash"] == want["frames_hash"] and all_good(got)
    assert got["verdicts"] == want["verdicts"] and got["supervision"] == want["supervision"]
    assert {"18F0093E", "0CFF01FC"} <= {line.split()[2].split("#")[0] for line in beside["tail"].splitlines()}


@pytest.mark.long("a flood on vcan0 in real time")
@pytest.mark.serial
def test_babbling_with_an_identifier_of_ours(loop, truck_folder, tmp_path):
    """Safe state within 5 periods of its first frame, no demand out of its limits, live again within 1 s of
    its last."""
    for_s = 60.0
    _, got, beside = loop(WARM_S + for_s + 4.0, for_s, "cangen -e -I 18F0093E -L 8 -g 0 -p 10 vcan0")
    vdc2 = got["reception"]["messages"]["VDC2"]
    print(f"{beside['sent']} frames on the bus in {beside['took_s']:.1f} s; VDC2 by kind: {vdc2['counts']}")
    assert beside["sent"] > 500 * for_s
    begin_s = min(t for kind, t in vdc2["first_s"].items() if kind not in ("accepted", "recovering"))
    changes = [(t, s) for t, s in got["supervision"] if t > 1.0]
    assert changes[0][1] != "live" and begin_s <= changes[0][0] <= begin_s + 5 * 0.01
    # Of the log's tail: how many good frames came after the last foreign one; the loop sends one each 10 ms.
    own = read_log(tmp_path / "out" / "loop-1.log")
    good = {row.tobytes() for row in own.data}
    heard = [line.split()[2].split("#") for line in beside["tail"].splitlines()]
    foreign = [bytes.fromhex(data) not in good for identifier, data in heard if identifier == "18F0093E"]
    last = max(i for i, is_foreign in enumerate(foreign) if is_foreign)
    after_s = (len(foreign) - 1 - last) * 0.01
    tail_ended_s = (
        next(
            i
            for i, data in enumerate(own.data[own.id == 0x98F0093E][::-1])
            if data.tobytes().hex().upper() == [d for i, d in heard if i == "18F0093E"][-1]
        )
        * 0.01
    )
    end_s = got["duration_s"] - tail_ended_s - after_s
    live_s, state = changes[-1]
    print(
        f"off {(changes[0][0] - begin_s) * 1e3:.0f} ms after its first frame, "
        f"live {(live_s - end_s) * 1e3:.0f} ms after its last"
    )
    assert state == "live" and live_s <= end_s + RECOVERY_S
    assert not any(s == "live" for t, s in changes if begin_s < t < end_s)
    limits = artefacts.read_manifest(truck_folder, "vehicle")["controller"]
    demand = decode_all(own, own_database())["GUARD_OUT"]["dp_demand"].value
    assert np.abs(demand).max() <= np.max(limits["u_max"]) + 1 / 2048 and np.abs(demand).max() > 0.1
    assert np.abs(np.diff(demand)).max() <= limits["rate_max"][0] * 0.01 + 1 / 2048
    ticks = np.arange(len(demand)) * 0.01
    released = (ticks > begin_s + np.max(limits["u_max"]) / limits["rate_max"][0] + 0.05) & (ticks < end_s)
    assert released.sum() > 100 and np.abs(demand[released]).max() <= 1 / 2048


@pytest.mark.serial
@pytest.mark.long("11 s: in real time on vcan0")
def test_after_bus_off_the_driver_restarts_and_the_loop_is_live_within_1_s(loop):
    fault = '[[can_fault]]\nmessage = "VDC2"\nkind = "bus_off"\nstart_s = 4.05\nend_s = 4.15'
    _, got, _ = loop(7.0, more=fault)
    (off_s, off), (live_s, live) = [(t, s) for t, s in got["supervision"] if t > 1.0]
    # Reports stop with the bus; the vehicle releases the brakes when it has missed five.
    assert (off, live) == ("off", "live") and 4.05 <= off_s <= 4.05 + 5 * 0.01 and live_s <= 4.15 + RECOVERY_S
    assert got["reception"]["messages"]["other"]["first_s"]["bus_off"] == 4.05
    assert got["reception"]["send_failures"] == 10, (
        "100 ms until the restart: the report of each tick, refused by the driver"
    )


REAL_TIME = """
import subprocess, sys
ecu = subprocess.Popen([sys.argv[1], "vcan0", "--seconds", "30"], stdout=subprocess.PIPE)
heard = subprocess.Popen(["candump", "-L", "-T", "30000", "vcan0,0CFF01FC:1FFFFFFF"], stdout=subprocess.PIPE)
replay = [sys.executable, "-m", "lpvguard.cli", "replay", sys.argv[2], "--vehicle", "truck"]
subprocess.run([*replay, "--to", "socketcan:vcan0"], check=True)
ecu.terminate()
heard.terminate()
print(ecu.communicate()[0].decode().strip())
print(heard.communicate()[0].count(b"\\n"))
"""


@pytest.mark.long("half a minute in real time on vcan0")
@pytest.mark.serial
def test_the_firmware_alone_hears_and_answers_a_played_drive(simulator, tmp_path):
    """Recorded frames onto the bus at their pace, the ECU's program on it: no simulator and no common
    clock."""
    path = tmp_path / "loop.toml"
    path.write_text(steady_scenario(6.0))
    simulator.run(load_scenario(str(path)), out=tmp_path)
    lines = (tmp_path / "loop-1.log").read_text().splitlines(keepends=True)
    (tmp_path / "truck.log").write_text(
        "".join(line for line in lines if "FC#" not in line)
    )  # all but the ECU's own
    (tmp_path / "real_time.py").write_text(REAL_TIME)
    done = with_vcan(sys.executable, tmp_path / "real_time.py", simulator.ecu_program, tmp_path / "truck.log")
    assert done.returncode == 0, done.stderr
    counters, reports = done.stdout.splitlines()
    accepted = {row[0]: row[2][1] + row[2][2] for row in json.loads(counters)["rules"]}
    print(f"{accepted[0x18F0093E]} of 600 VDC2 taken, {reports} reports sent")
    # A busy machine may be late most of the time; the exact counts are those of the tests in simulated time.
    assert accepted[0x18F0093E] > 30 and accepted[0x18FF000B] > 30 and accepted[0x18FEBF0B] > 3
    assert int(reports) > 30


def test_the_firmware_alone_says_what_is_wrong(simulator):
    for arguments, says in (
        (["vcan9"], "vcan9"),
        ([], "usage"),
        (["vcan0", "--engage", "maybe"], "usage"),
        (["vcan0", "--seconds", "x"], "usage"),
        (["a_name_longer_than_any"], "Invalid argument"),
    ):
        done = subprocess.run(
            [simulator.ecu_program, *arguments], capture_output=True, text=True, check=False
        )
        assert done.returncode == 2 and says in done.stderr


@pytest.mark.serial
def test_the_firmware_alone_says_whether_it_has_a_key(simulator):
    none = {"passed": 0, "alone": 0, "length": 0, "forged": 0}
    for key, said in (("test", none), ("none", None)):
        done = with_vcan(simulator.ecu_program, "vcan0", "--seconds", "0.2", "--key", key)
        assert done.returncode == 0 and json.loads(done.stdout)["authentication"] == said
