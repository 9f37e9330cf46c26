"""Logs of openpilot, ROS, PX4 and ArduPilot, written by their own libraries where these write."""

import bz2
import struct
from pathlib import Path

import numpy as np
import pytest

from lpvguard.base.errors import InputError, InputWarning
from lpvguard.can.logs import Table, logs_among, read_log
from lpvguard.start.signals import ROLES, ranked

T = [round(1e9 + 2e7 * k) for k in range(50)]
SPEED = [10 + 0.1 * k for k in range(50)]
YAW = [0.01 * k - 0.2 for k in range(50)]

SCHEMA = """@0xb0c1d2e3f4a59687;
struct CarState { vEgo @0 :Float32; steeringAngleDeg @1 :Float32; yawRate @2 :Float32; standstill @3 :Bool; }
struct Vector { v @0 :List(Float32); }
struct Event {
  logMonoTime @0 :UInt64;
  union { carState @1 :CarState; gyroscope @2 :Vector; note @3 :Text; }
}
"""


def openpilot(folder: Path, name: str) -> tuple[Path, Path]:
    """A log of openpilot's form and its schema."""
    capnp = pytest.importorskip("capnp")
    schema = folder / "log.capnp"
    schema.write_text(SCHEMA)
    event, data = capnp.SchemaParser().load(str(schema)).Event, b""
    for t, v, r in zip(T, SPEED, YAW, strict=True):
        state = event.new_message(logMonoTime=t)
        of_state = state.init("carState")
        of_state.vEgo, of_state.steeringAngleDeg, of_state.yawRate = v, 100 * r, r
        gyroscope = event.new_message(logMonoTime=t + 5)
        gyroscope.init("gyroscope").v = [0.0, 0.0, r]
        data += state.to_bytes() + gyroscope.to_bytes()
    data += event.new_message(logMonoTime=T[-1], note="end").to_bytes()
    (folder / name).write_bytes(bz2.compress(data) if name.endswith("bz2") else data)
    return folder / name, schema


@pytest.mark.parametrize("name", ["rlog", "2026-04-22--qlog.bz2"])
def test_openpilots_logs_are_read_with_the_schema_that_is_named(tmp_path, name):
    log, schema = openpilot(tmp_path, name)
    read = read_log(log, schema=schema)
    assert isinstance(read, Table)
    assert read.series["carState.vEgo"].t_ns.tolist() == T
    np.testing.assert_allclose(read.series["carState.vEgo"].value, SPEED, rtol=1e-6)
    np.testing.assert_allclose(read.series["gyroscope.v.2"].value, YAW, atol=1e-6)
    assert [ranked(role, read.series)[0] for role in ROLES] == [
        "carState.vEgo",
        "carState.steeringAngleDeg",
        "carState.yawRate",
    ]
    with pytest.raises(InputError, match="--schema: not given"):
        read_log(log)


def ros_messages(store):
    """Topic, type and messages of a twist at each time."""
    vector, twist = store.types["geometry_msgs/msg/Vector3"], store.types["geometry_msgs/msg/Twist"]
    return [twist(vector(v, 0.0, 0.0), vector(0.0, 0.0, r)) for v, r in zip(SPEED, YAW, strict=True)]


def rosbag(folder: Path, version: int) -> Path:
    """A rosbag of version 1 or 2 with a twist."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    kind = "geometry_msgs/msg/Twist"
    if version == 1:
        store, path = get_typestore(Stores.ROS1_NOETIC), folder / "drive.bag"
        with Writer1(path) as writer:
            connection = writer.add_connection("/car/twist", kind, typestore=store)
            for t, message in zip(T, ros_messages(store), strict=True):
                writer.write(connection, t, store.serialize_ros1(message, kind))
        return path
    store, path = get_typestore(Stores.ROS2_HUMBLE), folder / "drive"
    plugin = StoragePlugin.MCAP if version == 3 else StoragePlugin.SQLITE3
    with Writer2(path, version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection("/car/twist", kind, typestore=store)
        for t, message in zip(T, ros_messages(store), strict=True):
            writer.write(connection, t, store.serialize_cdr(message, kind))
    return path


@pytest.mark.parametrize("version", [1, 2, 3], ids=["rosbag1", "rosbag2", "rosbag2 in MCAP"])
def test_rosbags_are_read(tmp_path, version):
    path = rosbag(tmp_path, version)
    assert logs_among([path]) == [path] and logs_among([tmp_path]) == [path]
    read = read_log(path)
    assert read.series["car_twist.linear.x"].t_ns.tolist() == T
    np.testing.assert_allclose(read.series["car_twist.linear.x"].value, SPEED)
    units = {name: series.unit for name, series in read.series.items()}
    assert units["car_twist.linear.x"] == "m/s" and units["car_twist.angular.z"] == "rad/s"
    assert ranked("speed", read.series) == ["car_twist.linear.x"]
    assert ranked("output", read.series) == ["car_twist.angular.z"]


def test_an_mcap_file_is_read(tmp_path):
    pytest.importorskip("mcap_ros2")
    from mcap_ros2.writer import Writer

    path = tmp_path / "drive.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        kind = writer.register_msgdef("car_msgs/State", "float64 speed\nfloat32[3] gyro\nstring note")
        for t, v, r in zip(T, SPEED, YAW, strict=True):
            message = {"speed": v, "gyro": [0.0, 0.0, r], "note": ""}
            writer.write_message("/state", kind, message, log_time=t, publish_time=t)
        writer.finish()
    read = read_log(path)
    assert read.series["state.speed"].t_ns.tolist() == T
    np.testing.assert_allclose(read.series["state.gyro.2"].value, YAW, atol=1e-7)


def mcap_of(path: Path, *channels: tuple[str, str]) -> Path:
    """An MCAP file with the speed in channels of given topics and encodings."""
    pytest.importorskip("mcap")
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for topic, encoding in channels:
            kind = "jsonschema" if encoding == "json" else encoding
            schema = writer.register_schema("State", kind, b'{"type": "object"}')
            channel = writer.register_channel(topic, encoding, schema)
            for t, v in zip(T, SPEED, strict=True):
                writer.add_message(channel, t, f'{{"car": {{"speed": {v}}}}}'.encode(), t)
        writer.finish()
    return path


def test_jsons_messages_of_mcap_are_read_beside_others(tmp_path):
    read = read_log(mcap_of(tmp_path / "drive.mcap", ("/state", "json"), ("/other", "protobuf")))
    assert list(read.series) == ["state.car.speed"] and read.series["state.car.speed"].t_ns.tolist() == T
    np.testing.assert_allclose(read.series["state.car.speed"].value, SPEED)
    with pytest.raises(InputError, match="its messages are in protobuf; expected those of ROS 2, or JSON"):
        read_log(mcap_of(tmp_path / "other.mcap", ("/other", "protobuf")))


def test_px4s_ulog_is_read(tmp_path):
    """Written by hand after PX4's definition of the form: pyulog writes only what it has read."""
    pytest.importorskip("pyulog")

    def record(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + record(b"B", bytes(40))
    data += record(b"F", b"vehicle_angular_velocity:uint64_t timestamp;float[3] xyz;")
    data += record(b"A", struct.pack("<BH", 0, 1) + b"vehicle_angular_velocity")
    for t, r in zip(T, YAW, strict=True):
        data += record(b"D", struct.pack("<HQfff", 1, t // 1000, 0.0, 0.0, r))
    (tmp_path / "drive.ulg").write_bytes(data)
    read = read_log(tmp_path / "drive.ulg")
    series = read.series["vehicle_angular_velocity.xyz[2]"]
    assert series.t_ns.tolist() == T
    np.testing.assert_allclose(series.value, YAW, atol=1e-7)
    assert ranked("output", read.series) == ["vehicle_angular_velocity.xyz[2]"]


def test_ardupilots_dataflash_is_read(tmp_path, capsys):
    """Written by hand after ArduPilot's definition of the form: pymavlink reads it only."""
    pytest.importorskip("pymavlink")

    def defined(kind: int, length: int, name: str, types: str, columns: str) -> bytes:
        texts = [x.encode().ljust(n, b"\0") for x, n in ((name, 4), (types, 16), (columns, 64))]
        return b"\xa3\x95\x80" + struct.pack("<BB", kind, length) + b"".join(texts)

    data = defined(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    data += defined(129, 3 + 16, "IMU", "Qff", "TimeUS,GyrX,GyrZ")
    for t, r in zip(T, YAW, strict=True):
        data += b"\xa3\x95\x81" + struct.pack("<Qff", t // 1000, 0.0, r)
    (tmp_path / "drive.bin").write_bytes(data)
    read = read_log(tmp_path / "drive.bin")
    position = defined(130, 15, "GPS", "Qf", "TimeUS,Spd") + b"\xa3\x95\x82" + struct.pack("<Qf", 10**6, 5.0)
    (tmp_path / "damaged.bin").write_bytes(data + position)  # a GPS message without the week
    with pytest.warns(InputWarning, match="damaged.bin: pymavlink calls [1-9][0-9]* messages damaged"):
        assert set(read_log(tmp_path / "damaged.bin").series) > set(read.series)
    assert capsys.readouterr().out == ""
    assert read.series["IMU.GyrZ"].t_ns.tolist() == T
    np.testing.assert_allclose(read.series["IMU.GyrZ"].value, YAW, atol=1e-7)
    assert ranked("output", read.series) == ["IMU.GyrZ"]


def test_ardupilots_dataflash_as_text_is_read(tmp_path):
    pytest.importorskip("pymavlink")
    lines = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 129, 19, IMU, Qff, TimeUS,GyrX,GyrZ",
        *(f"IMU, {t // 1000}, 0.0, {r:.6f}" for t, r in zip(T, YAW, strict=True)),
    ]
    (tmp_path / "drive.log").write_text("\n".join(lines) + "\n")
    read = read_log(tmp_path / "drive.log")
    assert isinstance(read, Table) and read.series["IMU.GyrZ"].t_ns.tolist() == T
    np.testing.assert_allclose(read.series["IMU.GyrZ"].value, YAW, atol=1e-6)


def test_mavlinks_telemetry_is_read(tmp_path):
    pytest.importorskip("pymavlink")
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    sender, data = mavlink.MAVLink(None), b""
    for t, v, r in zip(T, SPEED, YAW, strict=True):
        for message in (
            mavlink.MAVLink_vfr_hud_message(0.0, v, 0, 0, 0.0, 0.0),
            mavlink.MAVLink_attitude_message(t // 10**6, 0.0, 0.0, 0.0, 0.0, 0.0, r),
        ):
            data += struct.pack(">Q", t // 1000 + 10**15) + message.pack(sender)
    (tmp_path / "drive.tlog").write_bytes(data)
    read = read_log(tmp_path / "drive.tlog")
    speed = read.series["VFR_HUD.groundspeed"]
    assert np.allclose(np.diff(speed.t_ns), 2e7, atol=300)
    np.testing.assert_allclose(speed.value, SPEED, rtol=1e-6)
    assert [ranked(role, read.series)[0] for role in ("speed", "output")] == [
        "VFR_HUD.groundspeed",
        "ATTITUDE.yawspeed",
    ]


def test_velocities_to_the_north_are_no_speed():
    names = ["vehicle_local_position.vx", "vehicle_odometry.velocity[0]", "sensor_gps.vel_m_s"]
    assert ranked("speed", names) == ["sensor_gps.vel_m_s"]
    assert ranked("input", ["vehicle_imu.delta_angle[0]", "servo.steering"]) == ["servo.steering"]


@pytest.mark.parametrize("name", ["drive.bag", "drive.mcap", "drive.ulg", "rlog"])
def test_a_file_that_is_no_such_log_is_refused_by_name(tmp_path, name):
    (tmp_path / name).write_bytes(b"no log at all, only text")
    (tmp_path / "log.capnp").write_text(SCHEMA.replace("b0c1", "b0c2"))
    with pytest.raises(InputError, match=f"{name}: (cannot be read|holds no number|reading it needs)"):
        read_log(tmp_path / name, schema=tmp_path / "log.capnp")
