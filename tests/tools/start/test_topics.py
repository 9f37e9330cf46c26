"""A folder with a table a topic is one recording; its rate is that of steering and yaw rate."""

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.can.logs import logs_among, read_log
from lpvguard.drives.ingest import ingest
from lpvguard.start.new_project import new

SPEED_HZ, STEER_HZ, IMU_HZ = 10, 50, 200


def write_recording(folder, start_s, mean_mps=12.0):
    """A minute of a car of 2.7 m in three tables, two as `rostopic echo -p` writes, each at its rate."""
    folder.mkdir(parents=True)
    t = np.arange(0.0, 60.0, 1 / IMU_HZ)
    v = mean_mps + 4 * np.sin(0.2 * t)
    delta = 0.03 * np.sin(0.7 * t) + 0.02 * np.sin(2.1 * t)
    r = np.zeros_like(t)
    for k in range(1, len(t)):
        steady = v[k] * delta[k] / (2.7 + 0.002 * v[k] ** 2)
        r[k] = r[k - 1] + (steady - r[k - 1]) / (0.15 * IMU_HZ)
    stamp_ns = np.round((start_s + t) * 1e9).astype(np.int64)

    def write(name, header, columns, rate_hz):
        at = slice(None, None, IMU_HZ // rate_hz)
        rows = (
            ",".join([str(stamp), *(f"{x:.6f}" for x in row)])
            for stamp, *row in zip(stamp_ns[at], *(c[at] for c in columns), strict=True)
        )
        (folder / name).write_text("\n".join([header, *rows]) + "\n")

    write("odom.csv", "%time,field.twist.twist.linear.x,field.twist.twist.linear.y", (v, 0 * v), SPEED_HZ)
    write("steering.csv", "timestamp [ns],angle [rad]", (delta,), STEER_HZ)
    write("imu.csv", "%time,field.angular_velocity.x,field.angular_velocity.z", (0 * r, r), IMU_HZ)
    return folder


@pytest.fixture
def logs(tmp_path):
    for k in range(2):
        write_recording(tmp_path / "logs" / f"run{k}", 1_700_000_000 + 100 * k, 11.0 + 2 * k)
    return tmp_path / "logs"


def test_each_folder_of_topics_is_a_recording(logs, tmp_path):
    recordings = logs_among([logs])
    assert [p.name for p in recordings] == ["run0", "run1"] and logs_among([recordings[0]]) == recordings[:1]
    made = new("mine", recordings, tmp_path / "out", wheelbase_m=2.7)
    assert {role: (p.name, p.unit, p.factor) for role, p in made.proposals.items()} == {
        "speed": ("odom.field.twist.twist.linear.x", "m/s", 1.0),
        "input": ("steering.angle [rad]", "rad", 1.0),
        "output": ("imu.field.angular_velocity.z", "rad/s", 1.0),
    }
    assert made.project.Ts_s == 0.05  # twice the speed's rate, which is the slowest
    again = ingest(
        recordings, dbc=None, signals_map=tmp_path / "out" / "signals.toml", out=tmp_path / "again"
    )
    written = (tmp_path / "out" / "drives" / "run0.csv").read_text()
    assert len(again) == 2 and (tmp_path / "again" / "run0.csv").read_text() == written


def test_tables_of_one_logger_stay_recordings_of_their_own(tmp_path):
    for k in range(2):
        (tmp_path / f"d{k}.csv").write_text("t,speed,steer,yaw_rate\n0,1,2,3\n0.1,1,2,3\n")
    (tmp_path / "other.csv").write_text("t,speed,steer,yaw_rate,temperature\n0,1,2,3,4\n0.1,1,2,3,4\n")
    assert [p.name for p in logs_among([tmp_path])] == ["d0.csv", "d1.csv", "other.csv"]


def test_topics_without_a_time_in_common_are_named(logs):
    late = (logs / "run1" / "imu.csv").read_text()
    (logs / "run0" / "imu.csv").write_text(late)
    with pytest.raises(InputError, match=r"imu, odom: have no time in common: .* expected tables of one rec"):
        read_log(logs / "run0")
