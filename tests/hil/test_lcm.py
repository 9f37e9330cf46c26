"""LCM telemetry of the loop: what lcm-logger would have recorded, read back with what lcm-gen makes for Python."""

from __future__ import annotations

import importlib
import json
import shutil
import struct
import subprocess
import sys
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from vcan import with_vcan

from lpvguard.can.catalogue import load_catalogue
from lpvguard.receive import EVENTS
from lpvguard.sim import Simulator, can_fault_table, load_scenario, steady_scenario

LCM = Path(__file__).resolve().parents[2] / "firmware_sim" / "lcm"
SYNC = 0xEDA1DA01
VERDICTS = ("unknown", "valid", "invalid", "not_judged", "stale", "fault")


@pytest.fixture(scope="module")
def types(tmp_path_factory):
    """The generated Python package of our message types; it needs no LCM."""
    if shutil.which("lcm-gen") is None:
        pytest.skip("lcm-gen not found: install liblcm-dev and liblcm-bin")
    folder = tmp_path_factory.mktemp("types")
    subprocess.run(["lcm-gen", "-p", "--ppath", folder / "lcmtypes", *sorted(LCM.glob("*.lcm"))], check=True)
    # Its package is called like ours.
    for source in (folder / "lcmtypes" / "lpvguard").glob("*.py"):
        source.write_text(source.read_text().replace("import lpvguard.", "from . import ").replace("lpvguard.", ""))
    (folder / "lcmtypes" / "lpvguard").rename(folder / "loop_types")
    sys.path.insert(0, str(folder))
    yield importlib.import_module("loop_types")
    sys.path.remove(str(folder))


def events(path: Path):
    """(channel, data) of an LCM log."""
    raw, at = path.read_bytes(), 0
    while at < len(raw):
        sync, _, _, n_channel, n_data = struct.unpack_from(">IQQII", raw, at)
        assert sync == SYNC
        at += 28
        yield raw[at:at + n_channel].decode(), raw[at + n_channel:at + n_channel + n_data]
        at += n_channel + n_data


def test_the_loop_publishes_truth_guard_and_supervision(types, truck_folder, tmp_path):
    run = Simulator(truck_folder, lcm=True).run(load_scenario("dead_yaw_sensor"), lcm=f"file://{tmp_path / 'run.lcm'}?mode=w")
    decoded = {"LPVGUARD_TRUTH": [], "LPVGUARD_GUARD": [], "LPVGUARD_SUPERVISION": []}
    of_channel = {"LPVGUARD_TRUTH": types.truth_t, "LPVGUARD_GUARD": types.guard_t, "LPVGUARD_SUPERVISION": types.supervision_t}
    for channel, data in events(tmp_path / "run.lcm"):
        decoded[channel].append(of_channel[channel].decode(data))
    ticks = round(run["duration_s"] / 0.01)
    assert {c: len(m) for c, m in decoded.items()} == {"LPVGUARD_TRUTH": ticks, "LPVGUARD_GUARD": ticks, "LPVGUARD_SUPERVISION": ticks // 10}
    states = [("off", "hold", "live")[g.supervision] for g in decoded["LPVGUARD_GUARD"]]
    changes = [[g.utime * 1e-6, s] for g, s, before in zip(decoded["LPVGUARD_GUARD"], states, [None, *states]) if s != before]
    assert np.allclose([t for t, _ in changes], [t for t, _ in run["supervision"]]) and len(changes) == len(run["supervision"])
    last = decoded["LPVGUARD_SUPERVISION"][-1]
    vdc2 = next(w for w in last.watch if w.id == load_catalogue().message("VDC2").id)
    counted = {kind: n for kind, n in zip(EVENTS, vdc2.count) if n}
    want = run["reception"]["messages"]["VDC2"]["counts"]
    assert counted["missed"] == want["missed"] and want["accepted"] - counted["accepted"] < 10 and vdc2.state == 2
    assert last.messages == 6 and not last.bus_off and all(v > 10 for v in (t.speed for t in decoded["LPVGUARD_TRUTH"]))
    assert any(s.trouble_spn == 1808 for s in decoded["LPVGUARD_SUPERVISION"])  # yaw rate, while its message is lost


SCENARIO = steady_scenario(6.0, can_fault_table("VDC2", "lost", 4.0, 4.2), title="two processes and a logger")
# $1: folder, the rest: the loop. A logger hears nothing from before it was up.
RECORD_AND_REPLAY = """
url=udpm://239.255.76.67:7667?ttl=0
lcm-logger --quiet --force --lcm-url=$url "$1/recorded.lcm" & logger=$!
sleep 2
"${@:2}" --lcm $url || [ $? = 1 ]
sleep 1; kill -INT $logger; wait $logger || true
lcm-logger --quiet --force --lcm-url=$url "$1/replayed.lcm" & logger=$!
sleep 2
lcm-logplayer --lcm-url=$url "$1/recorded.lcm" >&2
sleep 1; kill -INT $logger; wait $logger || true
"""


def test_two_processes_on_vcan_recorded_and_replayed_give_the_same_verdicts(types, truck_folder, tmp_path):
    """Truck and firmware as two processes on a real vcan0, telemetry by multicast on lo: what lcm-logger wrote, and what a second one
    heard when lcm-logplayer played it, say the verdicts and the supervision that the run reports."""
    if shutil.which("lcm-logplayer") is None:
        pytest.skip("lcm-logplayer not found: install liblcm-bin")
    (tmp_path / "loop.toml").write_text(SCENARIO)
    assert Simulator(truck_folder, lcm=True).ecu_program.is_file()  # compiled here, and not on the one processor of the guest
    done = with_vcan("bash", "-euc", RECORD_AND_REPLAY, "replay", tmp_path, sys.executable, "-m", "lpvguard.cli", "sim", tmp_path / "loop.toml",
                     "--coefficients", truck_folder, "--bus", "socketcan:vcan0", "--ecu-process", "--pace", 2, "--json", "-")
    assert done.returncode == 0, done.stderr
    (run,) = json.loads(done.stdout)
    assert [s for _, s in run["supervision"]].count("live") == 2

    def changes(path: Path, field: str, names: tuple[str, ...]):
        said = [types.guard_t.decode(data) for channel, data in events(path) if channel == "LPVGUARD_GUARD"]
        assert [g.utime for g in said] == list(range(0, 6_000_000, 10_000)), "nothing lost"
        firsts = [next(group) for _, group in groupby(said, key=lambda g: getattr(g, field))]
        return [[g.utime * 1e-6, names[getattr(g, field)]] for g in firsts]

    for name in ("recorded", "replayed"):
        path = tmp_path / f"{name}.lcm"
        for field, names, want in (("verdict", VERDICTS, run["verdicts"]), ("supervision", ("off", "hold", "live"), run["supervision"])):
            got = changes(path, field, names)
            assert [v for _, v in got] == [v for _, v in want] and np.allclose([t for t, _ in got], [t for t, _ in want])
