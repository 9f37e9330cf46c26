"""Raw CAN logs through the compiled receiver and the monitor: the ECU's own verdicts, a table's, and what a
spoilt log reports."""

import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path

import can
import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.can.catalogue import load_catalogue
from lpvguard.can.logs import EXTENDED, Frames, read_log
from lpvguard.can.play import encode_raw, frames_of_drive, values_of_drive, write_candump
from lpvguard.core.compiled import VERDICTS, Core
from lpvguard.drives.tables import Drive, list_experiments, read_drive
from lpvguard.extras.loop.sim import load_scenario
from lpvguard.replay.replayer import Replayer
from lpvguard.vehicle.project import load_project
from vcan import with_vcan

VDC2, GUARD_OUT = 0x18F0093E | EXTENDED, 0x0CFF01FC | EXTENDED
WARM_S = 0.4
"""Five frames of the slowest message."""


def changes(replay) -> list[tuple[float, str]]:
    """Verdicts with the times from which they held."""
    at = np.flatnonzero(np.diff(replay.run.verdict, prepend=255))
    return [(round(k * replay.Ts, 6), VERDICTS[replay.run.verdict[k]]) for k in at]


@pytest.fixture(scope="module")
def truck(truck_folder) -> Replayer:
    return Replayer(load_project("truck"), Core(truck_folder))


@pytest.fixture(scope="module")
def recorded(simulator, tmp_path_factory):
    """A run that alarms by a frame, with its log and what its ECU judged."""
    folder = tmp_path_factory.mktemp("recorded")
    run = simulator.run(load_scenario("yaw_drift"), out=folder)
    frames = np.genfromtxt(folder / "yaw_drift-1.frames.csv", delimiter=",", names=True)
    return run, folder / "yaw_drift-1.log", frames


@pytest.fixture(scope="module")
def g80_replayer(g80, core) -> Replayer:
    return Replayer(g80, core)


@pytest.fixture(scope="module")
def drive(g80, synthetic):
    return read_drive(list_experiments(synthetic)[0].path, g80)


@pytest.fixture(scope="module")
def on_bus(g80, drive) -> Frames:
    return frames_of_drive(drive.t, values_of_drive(g80, drive))


def only(frames: Frames, keep: np.ndarray) -> Frames:
    arrays = (a[keep] for a in (frames.t_ns, frames.id, frames.channel, frames.length, frames.data))
    return Frames(*arrays, frames.channels, frames.left_out)


def test_a_recorded_loop_replays_to_the_verdicts_that_its_ecu_gave(recorded, truck):
    run, log, judged = recorded
    replay = truck.replay_file(log)
    # The demand comes with 1/2048 bar from the bus, the ECU's monitor had the unrounded one: a verdict may
    # change a few steps away.
    (at, verdicts), (at_ecu, verdicts_ecu) = (
        zip(*changes(replay), strict=True),
        zip(*run["verdicts"], strict=True),
    )
    assert verdicts == verdicts_ecu and "invalid" in verdicts
    assert np.allclose(at, at_ecu, rtol=0, atol=0.05)
    # The release that follows voids the ECU's evidence: its frames begin anew then.
    frames, same = replay.run.frames, int((judged["t_end_s"] <= run["first_invalid_s"]).sum())
    assert same > 100
    for name in ("bin", "reason"):
        assert np.array_equal(getattr(frames, name)[:same], judged[name][:same])
    assert np.allclose(frames.t_end_s[:same], judged["t_end_s"][:same], atol=1e-9)
    assert np.abs(frames.margin[:same] - judged["margin"][:same]).max() < 1e-3
    assert replay.can["gaps"] == [{"from_s": 0.0, "to_s": WARM_S, "messages": ["VDC2", "EBC2", "GUARD_OUT"]}]
    gust = replay.can["messages"].pop("VDC2")  # its first frame is a step of the yaw rate
    assert gust["accepted"] > 17_000 and gust.get("gradient", 0) <= 1
    assert all(set(kinds) == {"accepted", "recovering"} for kinds in replay.can["messages"].values())


def as_the_bus_carries_it(project, table: Drive) -> Drive:
    """The table in the resolution of the bus, each signal held for the period of its message."""
    catalogue, k = load_catalogue(), np.arange(len(table.t))

    def carried(signal, x):
        message = catalogue.message(signal.can.message)
        on_bus = next(s for s in message.signals if s.name == signal.can.signal)
        samples = max(round(message.period_ms / 1000 / project.Ts_s), 1)
        held = x[k // samples * samples]
        return on_bus.physical(encode_raw(on_bus, signal.can.factor * held).astype(float)) / signal.can.factor

    u, y = (
        np.column_stack([carried(s, x) for s, x in zip(group, values.T, strict=False)])
        for group, values in ((project.inputs, table.u), (project.outputs, table.y))
    )
    return Drive(table.name, table.t, carried(project.speed, table.v), u, y)


@pytest.mark.unhurried
def test_a_table_on_the_bus_replays_as_the_table(g80, g80_replayer, synthetic):
    """Every synthetic drive: the verdicts of the table itself; and, frame by frame, those of what the bus
    carries of it. The thresholds stand 1 % higher: the drive that set one lies at it by definition, to either
    side when its speed comes every 100 ms."""
    core, compared, different = g80_replayer.core, 0, 0
    g80_replayer = Replayer(
        g80,
        core,
        threshold=1.01 * g80_replayer.threshold,
        energy_threshold=1.01 * g80_replayer.energy_threshold,
        change_threshold=1.01 * g80_replayer.change_threshold,
    )
    for experiment in list_experiments(synthetic):
        table = read_drive(experiment.path, g80)
        log = g80_replayer.replay_frames(
            frames_of_drive(table.t, values_of_drive(g80, table)), experiment.path
        )
        start = round(log.can["gaps"][0]["to_s"] / g80.Ts_s)
        assert start * g80.Ts_s == WARM_S and len(log.can["gaps"]) == 1
        carried = g80_replayer.replay(as_the_bus_carries_it(g80, table).from_sample(start))
        assert changes(log) == [
            (0.0, "unknown"),
            *[(round(t + WARM_S, 6), v) for t, v in changes(carried)[1:]],
        ]
        ours, theirs = log.run.frames, carried.run.frames
        assert np.array_equal(ours.bin, theirs.bin) and np.array_equal(ours.reason, theirs.reason)
        # The C decoder's float against double here: 2e-6 rad next to an offset of 31.374 rad.
        assert np.abs(ours.margin - theirs.margin).max() < 2e-3
        direct = g80_replayer.replay(table.from_sample(start))
        assert [v for _, v in changes(log)] == [v for _, v in changes(direct)]
        # Speed comes every 100 ms only: frames at the very edge of what speed may do can count in one and not
        # in the other.
        n = min(len(ours.bin), len(direct.run.frames.bin))
        different += int((ours.counted[:n] != direct.run.frames.counted[:n]).sum())
        compared += n
    assert compared > 1000 and different < 0.01 * compared


@pytest.mark.unhurried
@pytest.mark.parametrize("suffix", [".asc", ".blf", ".mf4", ".csv", ".log.gz"])
def test_every_form_of_log_gives_the_same_answer(on_bus, g80_replayer, tmp_path, suffix):
    on_bus = only(on_bus, on_bus.t_ns < 30 * 10**9)
    if suffix == ".log.gz":
        write_candump(on_bus, tmp_path / "drive.log")
        subprocess.run(["gzip", tmp_path / "drive.log"], check=True)
    else:
        with can.Logger(tmp_path / f"drive{suffix}") as logger:
            for t, i, row in zip(on_bus.t_ns.tolist(), on_bus.id.tolist(), on_bus.data, strict=False):
                logger(
                    can.Message(
                        timestamp=1.7e9 + t / 1e9,
                        arbitration_id=i & 0x1FFFFFFF,
                        data=row.tobytes(),
                        channel=1,
                    )
                )
    want = g80_replayer.replay_frames(on_bus, Path("drive.log")).to_dict()
    got = g80_replayer.replay_file(tmp_path / f"drive{suffix}").to_dict()
    for answer in (want, got):
        answer["can"].pop("channel")
    assert got == want


def test_each_rejection_is_counted_by_kind_and_gaps_are_reported(recorded, truck):
    log = read_log(recorded[1])
    vdc2, own = np.flatnonzero(log.id == VDC2), np.flatnonzero(log.id == GUARD_OUT)
    length, data = log.length.copy(), log.data.copy()
    length[vdc2[3000:3002]] = 7
    data[vdc2[4000], 3:5] = 0xFF  # yaw rate not available
    data[own[5000:5003], 3] ^= 1  # checksum
    keep = np.ones(len(log), bool)
    keep[vdc2[6000:6050]] = False  # half a second of silence
    spoilt = only(dataclasses.replace(log, length=length, data=data), keep)
    replay = truck.replay_frames(spoilt, recorded[1])
    counted = replay.can["messages"]
    assert (
        counted["VDC2"]["length"] == 2
        and counted["VDC2"]["absent"] == 1
        and counted["VDC2"]["missed"] == 50 + 2 + 1
    )
    assert counted["GUARD_OUT"]["checksum"] == 3 and counted["GUARD_OUT"]["missed"] == 3
    # Three periods late, 3.5 of them until that shows at a tick; back with the fifth good frame.
    assert [(g["from_s"], g["to_s"], g["messages"]) for g in replay.can["gaps"][1:]] == [
        (60.03, 60.54, ["VDC2"])
    ]
    assert VERDICTS[replay.run.verdict[6040]] == "stale"


def test_jumps_of_the_clock_are_pauses_and_the_rest_is_judged(on_bus, g80_replayer):
    half = len(on_bus) // 2
    t_ns = on_bus.t_ns.copy()
    t_ns[half:] -= 3600 * 10**9 + 3_700_000  # the logger was started anew, in another phase
    replay = g80_replayer.replay_frames(dataclasses.replace(on_bus, t_ns=t_ns), Path("drive.log"))
    assert [j["kind"] for j in replay.can["clock_jumps"]] == ["backwards"]
    gap = replay.can["gaps"][1]
    assert 1.0 < gap["to_s"] - gap["from_s"] < 2.0 and len(replay.can["gaps"]) == 2
    assert set(replay.can["messages"]["VDC2"]) == {"accepted", "recovering", "missed"}
    whole = g80_replayer.replay_frames(on_bus, Path("drive.log"))
    assert 0.7 < replay.judged_s / whole.judged_s <= 1.0


def test_jitter_and_disorder_of_arrival_lose_no_sample(on_bus, g80_replayer):
    jitter = np.random.default_rng(5).uniform(0, 2.4e6, len(on_bus)).astype(np.int64)
    replay = g80_replayer.replay_frames(
        dataclasses.replace(on_bus, t_ns=on_bus.t_ns + jitter), Path("drive.log")
    )
    whole = g80_replayer.replay_frames(on_bus, Path("drive.log"))
    assert len(replay.can["gaps"]) == 1 and set(replay.can["messages"]["VDC2"]) == {"accepted", "recovering"}
    assert np.array_equal(replay.run.frames.margin, whole.run.frames.margin)


def test_logs_that_cannot_be_judged_say_why(on_bus, g80, g80_replayer, tmp_path):
    with pytest.raises(InputError, match=r"no frame of VDC2 .*CCVS1"):
        g80_replayer.replay_frames(only(on_bus, on_bus.id == 7), Path("x.log"))
    with pytest.raises(InputError, match=r"no sample at all: VDC2: .*CCVS1: .*missed"):
        g80_replayer.replay_frames(only(on_bus, on_bus.id == VDC2), Path("x.log"))
    twice = dataclasses.replace(
        on_bus, channel=(np.arange(len(on_bus)) % 2).astype(np.uint8), channels=["can0", "can1"]
    )
    with pytest.raises(InputError, match=r"can0, can1.*--channel"):
        g80_replayer.replay_frames(twice, Path("x.log"))
    with pytest.raises(InputError, match="can7 is not in the log"):
        g80_replayer.replay_frames(twice, Path("x.log"), "can7")
    without = g80.model_copy(update={"signals": [s.model_copy(update={"can": None}) for s in g80.signals]})
    with pytest.raises(InputError, match="no place on the bus"):
        Replayer(without, g80_replayer.core).replay_frames(on_bus, Path("x.log"))


@pytest.mark.unhurried
def test_the_command_reports_reception_and_its_status_is_that_of_the_verdict(
    lpvguard, recorded, truck_folder, tmp_path
):
    done = lpvguard(
        "replay", "--vehicle", "truck", "--coefficients", truck_folder, recorded[1], "--json", "-"
    )
    assert done.returncode == 1, done.stderr
    result = json.loads(done.stdout)[0]
    assert result["run"] == "yaw_drift-1" and result["first_invalid_s"] == recorded[0]["first_invalid_s"]
    assert (
        result["can"]["messages"]["GUARD_OUT"]["accepted"] > 10_000
        and "VDC2, EBC2, GUARD_OUT not live" in done.stderr
    )
    (tmp_path / "foreign.log").write_text("(1.000000) can0 123#00\n")
    done = lpvguard("replay", "--vehicle", "truck", "--coefficients", truck_folder, tmp_path / "foreign.log")
    assert done.returncode == 2 and "foreign.log" in done.stderr and "VDC2" in done.stderr
    for options, says in (
        (["--to", "tin:cans"], "socketcan:INTERFACE"),
        (["--to", "socketcan:none99"], "none99"),
        (["--to", "socketcan:none99", "--speed", "0"], "--speed"),
        (["--speed", "2"], "without --to"),
    ):
        done = lpvguard("replay", "--vehicle", "truck", "--coefficients", truck_folder, recorded[1], *options)
        assert done.returncode == 2 and says in done.stderr


RECORDER = """
import subprocess, sys
logged, count, drive, *options = sys.argv[1:]
with open(logged, "wb") as out:
    logger = subprocess.Popen(["candump", "-L", "-n", count, "-T", "60000", "vcan0"], stdout=out)
    done = subprocess.run([
        sys.executable, "-m", "lpvguard.cli", "replay", drive, "--to", "socketcan:vcan0", *options
    ])
    logger.wait(timeout=60)
sys.exit(done.returncode)
"""


@pytest.mark.serial
@pytest.mark.parametrize(
    "kind",
    [
        pytest.param("table", marks=pytest.mark.long("17 s: another kernel is started")),
        pytest.param("log", marks=pytest.mark.long("another kernel is started")),
    ],
)
def test_what_is_played_onto_a_bus_is_what_candump_logs(kind, on_bus, g80, drive, synthetic, tmp_path):
    (tmp_path / "recorder.py").write_text(RECORDER)
    seconds = 8.0
    short = only(on_bus, on_bus.t_ns <= seconds * 1e9)
    if kind == "table":
        source = tmp_path / "drive.csv"
        lines = list_experiments(synthetic)[0].path.read_text().splitlines(keepends=True)
        source.write_text("".join(lines[: 2 + round(seconds / g80.Ts_s)]))
    else:
        source = tmp_path / "drive.log"
        write_candump(short, source)
    done = with_vcan(
        sys.executable,
        tmp_path / "recorder.py",
        tmp_path / "logged.log",
        len(short),
        source,
        "--vehicle",
        "g80",
        "--speed",
        4,
    )
    assert done.returncode == 0, done.stderr
    logged = read_log(tmp_path / "logged.log")
    assert np.array_equal(logged.id, short.id) and np.array_equal(logged.data, short.data)
    # At four times the pace, but for what the command itself says that it was late.
    late_s = float(re.search(r"the latest ([\d.]+) ms behind", done.stdout + done.stderr)[1]) / 1e3
    took_s, due_s = (logged.t_ns[-1] - logged.t_ns[0]) / 1e9, (short.t_ns[-1] - short.t_ns[0]) / 1e9 / 4
    assert abs(took_s - due_s) <= late_s + 0.5
