"""A replay as ROS 2 messages: two other libraries read back what the core said."""

from itertools import groupby

import numpy as np
import pytest
from mcap_ros2.reader import read_ros2_messages
from rosbags.typesys import Stores, get_typestore

from lpvguard.core.compiled import TESTS
from lpvguard.replay.alarm_text import alarm_sentence
from lpvguard.replay.ros import DIAGNOSTICS, DRIVE, ERROR, LEVELS, STALE, TWIST, WARN, write_ros2
from lpvguard.replay.series import numbers


@pytest.fixture(scope="module")
def recorded(replayer, alarmed, tmp_path_factory):
    """Path of the file, series and alarms of a drive with a fault."""
    path, said = alarmed
    series = replayer.series(replayer.read_file(path), said)
    alarms = said.to_dict()["alarms"]
    out = tmp_path_factory.mktemp("ros") / "run.mcap"
    write_ros2(out, "g80", series, alarms)
    return out, series, alarms


def read(path) -> dict[str, list]:
    """Messages by topic, in the order of the file."""
    by_topic: dict[str, list] = {}
    for message in read_ros2_messages(str(path)):
        by_topic.setdefault(message.channel.topic, []).append(message)
    return by_topic


def test_the_diagnostics_say_each_verdict_and_each_alarm(recorded):
    path, series, alarms = recorded
    messages = read(path)["/diagnostics"]
    times = [m.log_time_ns for m in messages]
    assert max(np.diff(times)) <= 1.1e9
    said = [m.ros_msg.status[0] for m in messages]
    words = {sentence for s in said for sentence in s.message.split("; frame")}
    assert all(any(alarm_sentence(alarm).removeprefix("frame") in w for w in words) for alarm in alarms)
    verdicts = [s.values[0].value for s in said]
    assert [v for v, _ in groupby(verdicts)] == [v for v, _ in groupby(series["verdict"].to_pylist())]
    assert all(
        s.level in (LEVELS.get(v, STALE), bytes([LEVELS.get(v, STALE)]))
        for s, v in zip(said, verdicts, strict=True)
    )
    assert {s.hardware_id for s in said} == {"g80"}


def test_the_ratios_say_how_near_each_test_is_to_its_threshold(recorded, replayer, alarmed):
    """Below 0.5 normal, above 1 an alarm: the largest since the message before."""
    path, series, alarms = recorded
    run = alarmed[1].run
    frames, counted = run.frames, run.frames.counted
    thresholds = (replayer.energy_threshold, replayer.change_threshold)
    for test, x, threshold in zip(("energy", "change"), (run.energy, run.change), thresholds, strict=True):
        ratio = numbers(series[f"test_ratio/{test}"])
        np.testing.assert_allclose(ratio[x > 0], x[x > 0] / threshold)
        assert np.isnan(ratio[x == 0]).all()
    ratio = numbers(series["test_ratio/frame"])
    at = np.unique(np.round((frames.t_judged_s - frames.t_judged_s[0]) * 1e6), return_inverse=True)[1]
    largest = np.zeros(at.max() + 1)
    np.maximum.at(largest, at[counted], np.maximum(frames.statistic, frames.pooled)[counted])
    np.testing.assert_allclose(ratio[np.isfinite(ratio)], largest[largest > 0] / replayer.threshold)
    t = numbers(series["t"])
    messages = read(path)["/diagnostics"]
    ends = [m.log_time_ns * 1e-9 for m in messages]
    for test in TESTS:
        ratio = numbers(series[f"test_ratio/{test}"])
        own = [a["t_s"] for a in alarms if a["test"] == test]
        soon = [(t > t_s - 1e-6) & (t < t_s + 1.0) for t_s in own]  # judged after the frame has ended
        assert own and all(np.nanmax(ratio[window]) > 1.0 for window in soon)
        assert np.nanmin(ratio) < 0.5
        for begin, end, m in zip([-1.0, *ends], ends, messages, strict=False):
            values = {v.key: v.value for v in m.ros_msg.status[0].values}
            since = ratio[(t > begin + 1e-6) & (t < end + 1e-6)]
            said = values.get(f"{test} test ratio")
            assert said == (f"{np.nanmax(since):.4g}" if np.isfinite(since).any() else None)


def test_a_part_that_differs_has_a_status_of_its_own(recorded, tmp_path):
    named = {
        "until_s": 42.0,
        "since_s": 11.0,
        "parts": ["gyro"],
        "probability": {"gyro": 0.99, "speed": 0.01},
        "what": "gyro gain",
        "value": -0.1,
        "low": -0.12,
        "high": -0.08,
        "unit": "",
        "service": "now",
        "says": "gyro: gain -0.1; check the gyro; service now",
    }
    out = tmp_path / "parts.mcap"
    write_ros2(out, "g80", recorded[1], recorded[2], [named, named | {"service": None, "value": None}])
    statuses = [(m.log_time_ns, m.ros_msg.status[0]) for m in read(out)["/diagnostics"]]
    gyro = [(t, s) for t, s in statuses if s.name == "lpvguard: gyro"]
    assert [t for t, _ in gyro] == [42 * 10**9] * 2
    assert all(s.level in (x, bytes([x])) for (_, s), x in zip(gyro, (ERROR, WARN), strict=True))
    assert gyro[0][1].message == named["says"]
    values = {v.key: v.value for v in gyro[0][1].values}
    assert values["gyro gain"] == "-0.1 (-0.12 to -0.08)" and values["service"] == "now"
    assert values["probability of gyro"] == "0.99"


def test_the_motions_are_the_recorded_signals(recorded):
    path, series, _ = recorded
    messages = read(path)
    for topic, column, part in (
        ("/vehicle/twist", "yaw_rate", lambda m: m.twist.angular.z),
        ("/vehicle/twist_nominal", "yhat/yaw_rate", lambda m: m.twist.angular.z),
        ("/vehicle/drive", "road_wheel_angle", lambda m: m.drive.steering_angle),
    ):
        values = [x for x in series[column].to_pylist() if x is not None]
        assert [part(m.ros_msg) for m in messages[topic]] == pytest.approx(values, rel=1e-6)


@pytest.mark.parametrize("kind", [DIAGNOSTICS, TWIST])
def test_the_types_are_those_of_ros_itself(recorded, kind):
    """rosbags has the definitions of ROS 2 Humble and decodes the bytes with them."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    from mcap.reader import make_reader

    with recorded[0].open("rb") as stream:
        rows = [(s.name, m.data) for s, _, m in make_reader(stream).iter_messages() if s.name == kind]
    decoded = store.deserialize_cdr(rows[-1][1], kind)
    assert decoded.header.frame_id == "base_link"


def test_ackermann_messages_have_their_five_fields(recorded):
    drive = read(recorded[0])["/vehicle/drive"][0].ros_msg.drive
    names = ("steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk")
    assert all(hasattr(drive, name) for name in names) and DRIVE.startswith("ackermann_msgs")


def test_the_command_writes_a_file_a_drive(lpvguard, vehicle, synthetic, tmp_path):
    drive = synthetic / "synthetic_01.csv"
    words = ("replay", "--vehicle", "g80", "--coefficients", vehicle, "--table", tmp_path / "t")
    done = lpvguard(*words, "--as", "ros2", drive)
    assert done.returncode in (0, 1) and "/diagnostics" in read(tmp_path / "t/synthetic_01.mcap")
