"""The loop over LCM: what is published, recorded by lcm-logger, replayed by lcm-logplayer, heard and led by
Python clients."""

import json
import sys
from itertools import groupby
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.can.catalogue import load_catalogue
from lpvguard.cli.lcm import lcm_send
from lpvguard.core.compiled import CAUSES, EVENTS, SUPERVISION, VERDICTS
from lpvguard.extras.loop.lcm_client import (
    CHANNELS,
    Action,
    Client,
    constants,
    message_types,
    read_log,
    watch,
)
from lpvguard.extras.loop.sim import Simulator, can_fault_table, load_scenario, steady_scenario
from parts import missing, require
from vcan import sim_words, with_vcan

pytestmark = pytest.mark.skipif(bool(missing("lcm")), reason=missing("lcm"))

SCENARIO = steady_scenario(
    30.0, can_fault_table("VDC2", "lost", 1.5, 1.7), title="two processes and a logger"
)


@pytest.fixture(scope="module")
def lcm_simulator(truck_folder) -> Simulator:
    return Simulator(truck_folder, lcm=True)


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "loop.toml"
    path.write_text(SCENARIO)
    return load_scenario(str(path))


def heard(path: Path) -> dict[str, list]:
    """Messages of an LCM log by channel."""
    by_channel: dict[str, list] = {channel: [] for channel in CHANNELS}
    for channel, message in read_log(path):
        by_channel[channel].append(message)
    return by_channel


def encoded(messages: list) -> list[bytes]:
    return [m.encode() for m in messages]


def require_in_order(part: list, whole: list) -> None:
    """Every message of ``part`` is one of ``whole``, in its order. Multicast repeats nothing: how many a busy
    machine loses says nothing of ours, so a quarter will do."""
    rest = iter(encoded(whole))
    assert all(m in rest for m in encoded(part)) and len(part) >= 0.25 * len(whole)


def changes(guard: list, field: str, names: tuple[str, ...]) -> list[list]:
    firsts = [next(group) for _, group in groupby(guard, key=lambda g: getattr(g, field))]
    return [[g.utime / 1e6, names[getattr(g, field)]] for g in firsts]


@pytest.mark.unhurried
def test_what_is_published_is_what_the_run_reports(lcm_simulator, tmp_path):
    run = lcm_simulator.run(load_scenario("dead_yaw_sensor"), lcm=f"file://{tmp_path / 'run.lcm'}?mode=w")
    said = heard(tmp_path / "run.lcm")
    ticks = round(run["duration_s"] / 0.01)
    assert {
        c: len(said[c])
        for c in (
            "LPVGUARD_TRUTH",
            "LPVGUARD_GUARD",
            "LPVGUARD_SUPERVISION",
            "LPVGUARD_BUS",
            "LPVGUARD_CONTROL",
        )
    } == {
        "LPVGUARD_TRUTH": ticks,
        "LPVGUARD_GUARD": ticks,
        "LPVGUARD_SUPERVISION": ticks // 10,
        "LPVGUARD_BUS": run["frames"],
        "LPVGUARD_CONTROL": 0,
    }
    assert changes(said["LPVGUARD_GUARD"], "supervision", SUPERVISION) == run["supervision"]
    assert changes(said["LPVGUARD_GUARD"], "verdict", VERDICTS) == run["verdicts"]
    assert (
        max(m.margin for m in said["LPVGUARD_MARGINS"]) == pytest.approx(run["max_margin"], rel=1e-8)
        and run["max_margin"] > 0.01
    )
    assert [s.state for s in said["LPVGUARD_STATUS"]] == [0] * (ticks // 100) + [2]
    last = said["LPVGUARD_SUPERVISION"][-1]
    vdc2 = next(w for w in last.watch if w.id == load_catalogue().message("VDC2").id)
    counted = {kind: n for kind, n in zip(EVENTS, vdc2.count, strict=False) if n}
    want = run["reception"]["messages"]["VDC2"]["counts"]
    assert (
        counted["missed"] == want["missed"]
        and want["accepted"] - counted["accepted"] < 10
        and vdc2.state == 2
    )
    assert (
        last.messages == 6
        and not last.bus_off
        and all(v > 10 for v in (t.speed for t in said["LPVGUARD_TRUTH"]))
    )
    assert any(
        s.trouble_spn == 1808 for s in said["LPVGUARD_SUPERVISION"]
    )  # yaw rate, while its message is lost


@pytest.mark.unhurried
def test_the_bus_of_an_lcm_log_is_the_candump_log_and_replays_to_the_same_verdicts(
    lcm_simulator, lpvguard, truck_folder, tmp_path
):
    run = lcm_simulator.run(
        load_scenario("brake_gain_40"),
        lcm=f"file://{tmp_path / 'run.lcm'}?mode=w",
        out=tmp_path,
        report_only=True,  # or what the loop does after its release decides the last verdict
    )
    done = lpvguard("lcm", "bus", tmp_path / "run.lcm", "-o", tmp_path / "mirror.log")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "mirror.log").read_bytes() == (tmp_path / "brake_gain_40-1.log").read_bytes()
    done = lpvguard(
        "replay", "--vehicle", "truck", "--coefficients", truck_folder, tmp_path / "mirror.log", "--json", "-"
    )
    (replayed,) = json.loads(done.stdout)
    assert done.returncode == 1 and replayed["first_invalid_s"] == pytest.approx(
        run["first_invalid_s"], abs=0.011
    )
    assert replayed["verdict_final"] == run["verdict_final"] == "invalid"


@pytest.mark.unhurried
def test_the_causes_of_an_alarm_are_in_the_result_on_the_bus_and_over_lcm(lcm_simulator, tmp_path):
    url = f"file://{tmp_path / 'run.lcm'}?mode=w"
    run = lcm_simulator.run(load_scenario("brake_gain_40"), lcm=url, report_only=True)
    said = heard(tmp_path / "run.lcm")["LPVGUARD_CAUSES"]
    assert [d["cause"] for d in run["diagnoses"]] == ["gain", "gain"]
    for m, d in zip(said, run["diagnoses"], strict=True):
        assert (m.utime * 1e-6, m.alarm_utime * 1e-6) == pytest.approx((d["t_s"], d["alarm_s"]))
        assert d["low"] < 0.4 < d["high"] and abs(d["since_s"] - 60.0) < 3.0
        numbers = (m.value, m.low, m.high, m.onset_utime * 1e-6)
        assert numbers == pytest.approx([d[k] for k in ("value", "low", "high", "since_s")])
        assert (CAUSES[m.cause], m.before) == (d["cause"], d["at_least"])
    assert [m.output for m in said] == [0, 1]
    codes = [(t, code["spn"]) for t, code in run["trouble_codes"] if code["fmi"] == 13]
    diagnosis = run["diagnoses"][0]
    # The code says so from half of the record on; that of a test which alarms later says it with its alarm.
    assert diagnosis["alarm_s"] + 5.0 < codes[0][0] < diagnosis["t_s"] - 3.0
    assert len({spn for _, spn in codes}) == len(codes) == 2
    lines = [line for line in watch(read_log(tmp_path / "run.lcm")) if "of the nominal output" in line]
    assert len(lines) == 2 and "output 0 0." in lines[0]


# $1: folder, the rest: the loop. A logger hears nothing from before it was up. The Python package has
# wrappers of the same names in front of LCM's programs, which keep signals to themselves.
RECORD_AND_REPLAY = """
PATH=$(pkg-config --variable=prefix lcm)/bin:$PATH
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


@pytest.mark.serial
@pytest.mark.long("30 s: two processes on vcan0")
def test_two_processes_on_vcan_recorded_and_replayed_give_the_same_verdicts(
    lcm_simulator, scenario, truck_folder, tmp_path
):
    """Truck and firmware as two processes on a real vcan0, telemetry by multicast on lo: what lcm-logger
    wrote, and what a second one heard when lcm-logplayer played it, is on every channel what one process
    alone publishes, and says the verdicts of the run."""
    assert lcm_simulator.ecu_program.is_file()  # compiled here, and not on the one processor of the guest
    lcm_simulator.run(scenario, lcm=f"file://{tmp_path / 'alone.lcm'}?mode=w")
    done = with_vcan(
        "bash",
        "-euc",
        RECORD_AND_REPLAY,
        "replay",
        tmp_path,
        *sim_words(truck_folder, scenario.path),
        *("--ecu-process", "--pace", 2),
    )
    assert done.returncode == 0, done.stderr
    (run,) = json.loads(done.stdout)
    assert [s for _, s in run["supervision"]].count("live") == 2 and "valid" in [
        v for _, v in run["verdicts"]
    ]
    alone, recorded, replayed = (
        heard(tmp_path / f"{name}.lcm") for name in ("alone", "recorded", "replayed")
    )
    assert len(alone["LPVGUARD_MARGINS"]) > 20
    for channel in CHANNELS:
        require_in_order(replayed[channel], recorded[channel])
        if channel != "LPVGUARD_GUARD":  # its statistic comes off the bus, in steps of GUARD_OUT
            require_in_order(recorded[channel], alone[channel])
    statistic = {g.utime: g.statistic for g in alone["LPVGUARD_GUARD"]}
    assert max(statistic.values()) > 0.05
    for log in (recorded, replayed):
        for field, names, want in (
            ("verdict", VERDICTS, run["verdicts"]),
            ("supervision", SUPERVISION, run["supervision"]),
        ):
            got = changes(log["LPVGUARD_GUARD"], field, names)
            assert [v for _, v in got] == [v for _, v in want] and np.allclose(
                [t for t, _ in got], [t for t, _ in want], atol=0.3
            )
        assert max(abs(g.statistic - statistic[g.utime]) for g in log["LPVGUARD_GUARD"]) <= 0.5 / 1024 + 1e-9


@pytest.mark.long("40 s: an emulator on vcan0")
@pytest.mark.serial
def test_the_emulated_ecu_publishes_what_the_host_does(lcm_simulator, scenario, truck_folder, tmp_path):
    """Margins, supervision and bus of the firmware on the Cortex-R5F, message for message those of the
    host's."""
    require("qemu")
    lcm_simulator.emulated("cortex-r5f")
    lcm_simulator.run(scenario, lcm=f"file://{tmp_path / 'host.lcm'}?mode=w")
    lcm = f"file://{tmp_path / 'r5f.lcm'}?mode=w"
    done = with_vcan(*sim_words(truck_folder, scenario.path), "--target", "cortex-r5f", "--lcm", lcm)
    assert done.returncode in (0, 1) and done.stdout, done.stderr
    host, r5f = heard(tmp_path / "host.lcm"), heard(tmp_path / "r5f.lcm")
    assert len(host["LPVGUARD_MARGINS"]) > 20
    for channel in (
        "LPVGUARD_MARGINS",
        "LPVGUARD_SUPERVISION",
        "LPVGUARD_BUS",
        "LPVGUARD_TRUTH",
        "LPVGUARD_STATUS",
    ):
        assert encoded(r5f[channel]) == encoded(host[channel]), channel


# A client that leads a run step by step, so that what it does falls on the same ticks always; and another one
# that watches.
LEAD = """
import json, subprocess, sys
from lpvguard.base.errors import InputError
from lpvguard.extras.loop.lcm_client import Client, state_name
URL = "udpm://239.255.76.67:7667?ttl=0"
client, cli = Client(URL), [sys.executable, "-m", "lpvguard.cli"]
def started(*words):
    return subprocess.Popen([*cli, *words], stdout=subprocess.PIPE, text=True)

watching = started("lcm", "watch", "--url", URL, "--silence", "100")
loop = started("sim", *sys.argv[1:], "--lcm", URL, "--paused", "--json", "-")

def paused_at():
    status = (m for c, m in client.messages(100) if c == "LPVGUARD_STATUS" and m.id == 0)
    return next(m.utime for m in status if state_name(m) == "paused" and m.utime != at)

at = None
at = paused_at()
said = [at]
def step(ticks):
    global at
    client.command("step", ticks=ticks, timeout_s=20)
    at = paused_at()
    said.append(at)
step(500)
lost = client.command("inject", '[[can_fault]]\\nmessage = "VDC2"\\nkind = "lost"', timeout_s=20)
try:
    client.command("inject", 'can_fault = [{message = "VDC3", kind = "lost"}]', timeout_s=20)
except InputError as error:
    refused = str(error)
step(50)
clear = [*cli, "lcm", "send", "clear", lost.entry, "--url", URL]
found = subprocess.run(clear, capture_output=True, text=True)
step(250)
stop = client.command("stop", timeout_s=20)
heard = {}
for channel, message in client.messages(2.0):
    heard[channel] = heard.get(channel, 0) + 1
print(json.dumps({"said": said, "lost": [lost.utime, lost.entry], "refused": refused,
                  "found": [found.returncode, found.stdout, found.stderr], "stop": stop.utime,
                  "run": json.loads(loop.communicate()[0]),
                  "watched": watching.communicate()[0].splitlines()}))
"""


@pytest.mark.serial
@pytest.mark.slow("10 s: four commands, and 8 s of simulated time")
def test_a_python_client_leads_a_run_and_what_it_did_can_be_run_again(
    lcm_simulator, simulator, scenario, truck_folder, tmp_path
):
    (tmp_path / "lead.py").write_text(LEAD)
    message_types()  # made here, once
    done = with_vcan(
        sys.executable,
        tmp_path / "lead.py",
        scenario.path,
        "--coefficients",
        truck_folder,
        "--pace",
        10,  # at 100 a watcher that a busy machine holds up loses messages, which LCM does not send again
        "-o",
        tmp_path / "out",
        interfaces="",
    )
    assert done.returncode == 0, done.stderr
    got = json.loads(done.stdout)
    (run,) = got["run"]
    assert (
        got["said"] == [0, 5_000_000, 5_500_000, 8_000_000]
        and got["stop"] == 8_000_000
        and run["duration_s"] == 8.0
    )
    assert got["lost"] == [5_010_000, "can_fault[1]"]
    assert (
        "refused" in got["refused"] and 'can_fault.message = "VDC3": expected one of: VDC2' in got["refused"]
    )
    assert got["found"] == [0, "5.51 s: paused, can_fault[1]\n", ""]
    off = [t for t, state in run["supervision"] if t > 5.0 and state != "live"]
    live = [t for t, state in run["supervision"] if t > 5.0 and state == "live"]
    assert 5.01 < off[0] <= 5.06 and 5.51 < live[-1] <= 6.51
    assert [
        line.split("s  ")[1] for line in got["watched"] if "can_fault" in line and "refused" not in line
    ] == ["paused can_fault[1]"] * 2
    assert any("refused: command: can_fault.message" in line for line in got["watched"]) and got["watched"][
        -1
    ].endswith("ended")
    assert any("supervision off" in line for line in got["watched"])

    applied = load_scenario(str(tmp_path / "out" / "loop-1.applied.toml"))
    again = simulator.run(applied, out=tmp_path)
    assert (again["frames"], again["frames_hash"]) == (run["frames"], run["frames_hash"])
    assert again["verdicts"] == run["verdicts"] and again["supervision"] == run["supervision"]
    assert (tmp_path / "loop-1.applied-1.log").read_bytes() == (tmp_path / "out" / "loop-1.log").read_bytes()
    assert simulator.run(scenario)["frames_hash"] != run["frames_hash"]


@pytest.mark.unhurried
def test_what_goes_wrong_is_said(lpvguard, scenario, tmp_path):
    done = lpvguard("sim", "nominal", "--paused", "--lcm", f"file://{tmp_path / 'x.lcm'}?mode=w")
    assert done.returncode == 2 and "--paused" in done.stderr and "no client can reach" in done.stderr
    done = lpvguard("lcm", "bus", tmp_path / "none.lcm", "-o", tmp_path / "x.log")
    assert done.returncode == 2 and "no such file" in done.stderr and not (tmp_path / "x.log").exists()
    (tmp_path / "foreign.lcm").write_bytes(b"")
    done = lpvguard("lcm", "bus", tmp_path / "foreign.lcm", "-o", tmp_path / "x.log")
    assert done.returncode == 2 and "holds no frame" in done.stderr
    with pytest.raises(InputError, match="LCM"):
        Client("carrier-pigeon://roof")
    done = lpvguard("sim", scenario.path, "--lcm", "carrier-pigeon://roof")
    assert done.returncode == 2 and "cannot be opened" in done.stderr


def test_a_channel_of_another_version_is_not_read_as_ours(tmp_path):
    import lcm

    log = lcm.EventLog(tmp_path / "old.lcm", "w")
    log.write_event(0, "LPVGUARD_GUARD", bytes(40))
    log.close()
    with pytest.raises(InputError, match="guard_t"):
        list(read_log(tmp_path / "old.lcm"))


def test_actions_of_client_and_command_line_are_those_of_the_message_type():
    actions = tuple(constants("control_t"))
    assert (
        actions
        == get_args(Action)
        == get_args(get_args(get_type_hints(lcm_send, include_extras=True)["action"])[0])
    )
    assert tuple(constants("status_t")) == ("running", "paused", "ended")


def test_watching_says_what_changes_once():
    types = message_types()
    guard, again, status, ended = types.guard_t(), types.guard_t(), types.status_t(), types.status_t()
    guard.verdict = again.verdict = 1
    again.utime, status.id, status.reason, ended.state, ended.utime = 10_000, 7, "because", 2, 20_000
    said = list(
        watch(
            [
                ("LPVGUARD_GUARD", guard),
                ("LPVGUARD_GUARD", again),
                ("LPVGUARD_STATUS", status),
                ("LPVGUARD_STATUS", ended),
                ("LPVGUARD_GUARD", types.guard_t()),
            ]
        )
    )
    assert said == [
        "     0.00 s  verdict valid, supervision off, statistic 0.000",
        "     0.00 s  refused: because",
        "     0.02 s  ended",
    ]
