"""ROS 2 recordings of the live page: what is written is what replay says, and CAN frames of one are read."""

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from live_case import Given, asked, cut

from lpvguard.base.errors import InputError
from lpvguard.can.logs import EXTENDED
from lpvguard.drives.tables import list_experiments, read_drive
from lpvguard.extras.live.sources import ROS_FRAME, Ros2Source, open_source
from lpvguard.extras.live.watch import Watch
from lpvguard.identify.isolation import Changes, Isolation
from lpvguard.replay.parts import PartNamer
from lpvguard.replay.replayer import Replayer
from lpvguard.replay.ros import Ros2Recorder, write_ros2
from lpvguard.vehicle.project import IsolationSettings

pytest.importorskip("mcap_ros2", reason="the package mcap-ros2-support (lpvguard[ros2])")

from mcap_ros2.reader import read_ros2_messages
from mcap_ros2.writer import Writer

FRAME = "uint32 id\nbool is_rtr\nbool is_extended\nbool is_error\nuint8 dlc\nuint8[8] data\n"
HEADER = (
    f"std_msgs/Header header\n{FRAME}{'=' * 80}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\n"
    f"string frame_id\n{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


def contents(path) -> dict[str, list]:
    """Fields below the header, by topic."""
    by_topic: dict[str, list] = {}
    for message in read_ros2_messages(str(path)):
        ros = message.ros_msg
        if message.channel.topic == "/diagnostics":
            (status,) = ros.status
            said = [(pair.key, pair.value) for pair in status.values]
            by_topic.setdefault("/diagnostics", []).append((status.level, status.message, said))
        else:
            part = ros.drive.steering_angle if hasattr(ros, "drive") else ros.twist.angular.z
            by_topic.setdefault(message.channel.topic, []).append(part)
    return by_topic


def watched(replayer, frames, path) -> Watch:
    """The watch after these frames in pieces, recorded as MCAP of ROS 2."""
    with path.open("wb") as stream:
        recorder = Ros2Recorder(stream, "g80")
        watch = Watch(replayer, Given(), 3600, listeners=[recorder])
        for piece in cut(frames, 5000):
            watch.take(piece)
        recorder.close()
    return watch


def test_a_recording_in_pieces_is_that_of_replay(replayer, faulty, tmp_path):
    frames, path = faulty
    watched(replayer, frames, tmp_path / "live.mcap")
    said = replayer.replay_frames(frames, path)
    series = replayer.series(replayer.received(frames, path), said)
    write_ros2(tmp_path / "replay.mcap", "g80", series, said.to_dict()["alarms"])
    live, whole = contents(tmp_path / "live.mcap"), contents(tmp_path / "replay.mcap")
    assert live.keys() == whole.keys() and len(live) > 1
    for topic, rows in live.items():
        n = min(len(rows), len(whole[topic]) - 2)  # the last tick waits for a frame after it
        assert n >= len(whole[topic]) - 2
        same = rows[:n] == whole[topic][:n]
        assert same if topic == "/diagnostics" else rows[:n] == pytest.approx(whole[topic][:n], abs=1e-9)


def test_the_part_is_named_on_the_page_and_in_the_recording(replayer, synthetic, faulty, tmp_path):
    frames, path = faulty
    project = replayer.project.model_copy(update={"isolation": IsolationSettings(vehicle=("K", "T1"))})
    changes = Changes(project, replayer.model)
    healthy = [read_drive(e.path, project) for e in list_experiments(synthetic)]
    namer = PartNamer(project, Isolation.from_drives(changes, healthy, 30.0))
    naming = Replayer(replayer.project, replayer.core, namer=namer)
    watch = watched(naming, frames, tmp_path / "live.mcap")
    whole = naming.replay_frames(frames, path).parts
    wanted = [p.says for p in whole if p.until_s < watch.view(10.0, None, 10)["now"]["t"] - 1.0]
    says = [a["says"] for a in watch.view(3600.0, None, 10)["alarms"] if a["says"].startswith("part: ")]
    assert len(wanted) >= 1 and len(says) == len(wanted)
    names = [text.removeprefix("part: ").split(";")[0].split(":")[0] for text in says]
    assert names == [text.split(";")[0].split(":")[0] for text in wanted]
    diagnostics = contents(tmp_path / "live.mcap")["/diagnostics"]
    in_recording = [message for _, message, values in diagnostics if values[0][0] == "since s"]
    assert [f"part: {text}" for text in in_recording] == says


@pytest.fixture
def bag(faulty, tmp_path) -> Path:
    """An MCAP file of ROS 2 with the frames of a bus."""
    frames = faulty[0].at(slice(0, 9000))
    with (tmp_path / "bus.mcap").open("wb") as stream:
        writer = Writer(stream)
        kind = writer.register_msgdef(ROS_FRAME, HEADER)
        for t, identifier, length, data in zip(
            frames.t_ns, frames.id, frames.length, frames.data, strict=True
        ):
            stamp = {"sec": int(t) // 10**9, "nanosec": int(t) % 10**9}
            message = {"header": {"stamp": stamp, "frame_id": ""}, "id": int(identifier) & ~EXTENDED}
            message |= {"is_extended": bool(identifier & EXTENDED), "is_rtr": False, "is_error": False}
            message |= {"dlc": int(length), "data": data[:8].tolist()}
            writer.write_message("/from_can_bus", kind, message, int(t), int(t))
        writer.finish()
    return tmp_path / "bus.mcap"


def test_the_frames_of_a_bag_are_those_of_the_bus(bag, faulty):
    source = open_source(str(bag))
    assert isinstance(source, Ros2Source)
    pieces = source.pieces()
    first, second, third, silence = (next(pieces) for _ in range(4))
    assert silence is None
    for name in ("t_ns", "id", "length"):
        joined = np.concatenate([getattr(piece, name) for piece in (first, second, third)])
        np.testing.assert_array_equal(joined, getattr(faulty[0], name)[:9000])


def test_a_bag_without_frames_is_named(faulty, replayer, tmp_path):
    with (tmp_path / "no.mcap").open("wb") as stream:
        Ros2Recorder(stream, "g80").close()
    with pytest.raises(InputError, match=f"no message of {ROS_FRAME}"):
        next(Ros2Source(tmp_path / "no.mcap").pieces())


@pytest.mark.slow("10 s: a process that is interrupted")
def test_the_command_reads_a_bag_and_writes_one(bag, g80, vehicle, tmp_path):
    words = ["live", "--vehicle", "g80", "--coefficients", vehicle, bag, "--ros", tmp_path / "out.mcap"]
    command = [sys.executable, "-m", "lpvguard.cli", *map(str, words)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as live:
        line = live.stderr.readline()
        url = re.search(r"http://\S+", line)[0]
        while (now := json.loads(asked(f"{url}view?span=10"))["now"])["t"] is None:
            assert now["trouble"] == ""
        live.send_signal(signal.SIGINT)
        assert live.wait(60) == 0
    by_topic = contents(tmp_path / "out.mcap")
    assert by_topic["/diagnostics"] and by_topic["/vehicle/twist"]
