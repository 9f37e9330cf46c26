"""Ingest: what logs suffer is handled as stated and reported, J1939 senders are told apart, and bad input is
refused by name."""

from pathlib import Path
from types import SimpleNamespace

import cantools
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pa_parquet
import pytest

from lpvguard.base.errors import InputError
from lpvguard.can.dbc import dbc_text
from lpvguard.can.logs import read_log
from lpvguard.drives.ingest import ingest
from lpvguard.drives.signal_map import map_of_project
from other_car import COLUMNS, MAP, OTHER_CAR, agrees, other_car, run, table, write_log, write_map

# ------------------------------------------------------------------------------------------- what logs suffer


def test_frames_of_every_kind_in_candump(tmp_path):
    log = tmp_path / "kinds.log"
    log.write_text(
        "(1.000001) can0 123#0102030405060708\n"
        "(1.000002) vcan12 18F0093E#FFff\n"
        "(1.000003) can0 7FF#\n"
        "(1.000004) can0 123#R8\n"
        "(1.000005) can0 20000040#0000000000000000\n"
        "\n(1.000006000) can0 123##1" + "AB" * 24 + "\r\n"
        "(1.0000071) can0 123#11 R\n"
        "(1.0) can0 1234#00\n(1.0) can0 123#0\nnot a frame\n(1.000009) can0 123#22"
    )
    frames = read_log(log)
    assert frames.t_ns.tolist() == [1000001000, 1000002000, 1000003000, 1000006000, 1000007100, 1000009000]
    assert frames.id.tolist() == [0x123, 0x98F0093E, 0x7FF, 0x123, 0x123, 0x123]
    assert frames.length.tolist() == [8, 2, 0, 24, 1, 1]
    assert [frames.channels[c] for c in frames.channel] == ["can0", "vcan12", "can0", "can0", "can0", "can0"]
    assert frames.data.shape[1] == 64 and frames.data[3].tolist() == [0xAB] * 24 + [0] * 40
    assert frames.left_out == {
        "error reports": 1,
        "remote frames": 1,
        "lines that are no frame": 3,
        "first line that is no frame": 9,
    }


def test_a_gap_cuts_the_drive_and_is_reported(car, tmp_path):
    frames = [m for m in other_car() if not (m.arbitration_id == 0x200 and 1004.0 < m.timestamp < 1006.0)]
    report = run(car, tmp_path / "out", write_log("log", frames, tmp_path / "drive"))["drive"]
    assert [d["file"] for d in report["drives"]] == ["drive_1.csv", "drive_2.csv"]
    (left,) = report["left_out"]
    assert left["columns"] == ["r"] and left["reason"] == "samples further apart than max_gap_s"
    assert 1003.9 < left["from_s"] < 1004.01 and 1005.9 < left["to_s"] < 1006.02
    assert report["stretches"][0]["columns"]["r"]["terms"][0]["gaps"] == 1
    for file in ("drive_1.csv", "drive_2.csv"):
        agrees(tmp_path / "out" / file)
    assert (tmp_path / "out/experiments.csv").read_text().splitlines() == [
        "experiment,split,recording",
        "drive_1,unassigned,drive",
        "drive_2,unassigned,drive",
    ]


def test_a_wrap_that_the_map_does_not_name_is_suspected(car, tmp_path):
    text = MAP.replace(", wrap = 360", "")
    report = run(car, tmp_path / "out", write_log("log", other_car(), tmp_path / "drive"), map_text=text)[
        "drive"
    ]
    counts = {
        name: c["terms"][0].get("suspected_wraps") for name, c in report["stretches"][0]["columns"].items()
    }
    assert counts == {"delta": 0, "v": 0, "r": 0, "ay": 0, "psi": 1}


def test_a_short_gap_is_interpolated(car, tmp_path):
    frames = [m for m in other_car() if not (m.arbitration_id == 0x200 and 1004.0 < m.timestamp < 1004.3)]
    report = run(car, tmp_path / "out", write_log("log", frames, tmp_path / "drive"))["drive"]
    assert (
        len(report["drives"]) == 1
        and report["stretches"][0]["columns"]["r"]["terms"][0]["longest_pause_s"] > 0.29
    )


def test_clock_jumps_cut_and_are_reported(car, tmp_path):
    first, second, third = other_car(4.0), other_car(4.0, start=500.0), other_car(4.0, start=1e9)
    report = run(car, tmp_path / "out", write_log("log", first + second + third, tmp_path / "drive"))["drive"]
    assert [j["kind"] for j in report["clock_jumps"]] == ["backwards", "pause or jump forwards"]
    assert report["clock_jumps"][0]["from_s"] > 1003.9 and report["clock_jumps"][0]["to_s"] == 500.0
    assert [d["rows"] for d in report["drives"]] == [399, 399, 399]
    for k in (1, 2):
        agrees(tmp_path / f"out/drive_{k}.csv")


def test_slightly_disordered_frames_are_sorted(car, tmp_path):
    frames = other_car()
    for k in range(50, len(frames) - 50, 100):
        frames[k], frames[k + 7] = frames[k + 7], frames[k]
    report = run(car, tmp_path / "out", write_log("log", frames, tmp_path / "drive"))["drive"]
    assert report["clock_jumps"] == [] and len(report["drives"]) == 1
    agrees(tmp_path / "out/drive.csv")


def test_values_outside_the_limits_and_short_frames_are_left_out(car, tmp_path):
    frames = other_car()
    frames[2000].data = frames[2000].data[:1]
    database = cantools.database.load_string(OTHER_CAR, "dbc")
    spike = next(m for m in frames[3000:] if m.arbitration_id == 0x123)
    spike.data = bytearray(database.encode_message("STEER", {"ANGLE": 400.0, "HEADING": 0, "TORQUE": 0}))
    text = MAP.replace('signal = "ANGLE"', 'signal = "ANGLE", min = -1.0, max = 1.0').replace(
        'columns.psi = { unit = "rad", message = "STEER", signal = "HEADING", wrap = 360 }\n', ""
    )
    report = run(car, tmp_path / "out", write_log("log", frames, tmp_path / "drive"), map_text=text)["drive"]
    left = report["stretches"][0]["columns"]["delta"]["terms"][0]["left_out"]
    assert left["outside min and max of the map"] == 1
    assert (
        sum(
            c["terms"][0]["left_out"].get("frame too short", 0)
            for c in report["stretches"][0]["columns"].values()
        )
        == 1
    )
    agrees(tmp_path / "out/drive.csv", columns={k: v for k, v in COLUMNS.items() if k != "psi"})


# ------------------------------------------------------------------------------------------------------ J1939

J1939_MAP = """schema = 1
Ts_s = 0.02
columns.r = { unit = "rad/s", message = "VDC2", signal = "yaw_rate" }
columns.v = { unit = "m/s", message = "CCVS1", signal = "wheel_based_speed" }
"""


def j1939_log(*, vdc2: tuple[int, ...] = (0x18F0093E,), absent: range = range(0)) -> str:
    database = cantools.database.load_string(dbc_text(), "dbc")
    lines = []
    for k in range(1000):
        t = 0.01 * k
        data = bytearray(
            database.encode_message(
                "VDC2",
                {
                    "steering_wheel_angle": 0,
                    "yaw_rate": 0.1 * np.sin(t),
                    "lateral_acceleration": 0,
                    "longitudinal_acceleration": 0,
                },
            )
        )
        if k in absent:
            data[3:5] = b"\xff\xff" if k % 2 else b"\x00\xfe"
        lines += [f"({t:.6f}) can0 {id_:08X}#{data.hex()}\n" for id_ in vdc2]
        if k % 10 == 0:
            lines.append(
                f"({t:.6f}) can0 18FEF100#"
                f"{database.encode_message('CCVS1', {'wheel_based_speed': 54.0}).hex()}\n"
            )
    return "".join(lines)


def run_j1939(tmp_path: Path, text: str, map_text: str = J1939_MAP) -> tuple[dict, Path]:
    for name, content in (("ours.dbc", dbc_text()), ("drive.log", text), ("map.toml", map_text)):
        (tmp_path / name).write_text(content)
    return ingest(
        [tmp_path / "drive.log"],
        dbc=tmp_path / "ours.dbc",
        signals_map=tmp_path / "map.toml",
        out=tmp_path / "out",
    )["drive"], tmp_path / "out"


@pytest.mark.parametrize(
    "id_", [0x18F0093E, 0x0CF0093E, 0x08F00921], ids=["as in the DBC", "other priority", "other sender too"]
)
def test_j1939_groups_are_found_by_pgn(id_, tmp_path):
    _, out = run_j1939(tmp_path, j1939_log(vdc2=(id_,)))
    got = table(out / "drive.csv")
    assert np.abs(got["r"] - 0.1 * np.sin(got["t"])).max() < 1.0 / 8192 and np.allclose(got["v"], 15.0)


def test_a_database_that_does_not_say_j1939_is_told_so_by_the_map(tmp_path):
    bare = "\n".join(
        line for line in dbc_text().splitlines() if "VFrameFormat" not in line and "ProtocolType" not in line
    )
    (tmp_path / "bare.dbc").write_text(bare)
    (tmp_path / "drive.log").write_text(j1939_log(vdc2=(0x0CF00921,)))
    with pytest.raises(InputError, match="nothing remains"):
        ingest(
            [tmp_path / "drive.log"],
            dbc=tmp_path / "bare.dbc",
            out=tmp_path / "out",
            signals_map=write_map(tmp_path, J1939_MAP),
        )
    ingest(
        [tmp_path / "drive.log"],
        dbc=tmp_path / "bare.dbc",
        out=tmp_path / "out",
        signals_map=write_map(tmp_path, J1939_MAP.replace("Ts_s", "j1939 = true\nTs_s")),
    )
    assert np.abs(table(tmp_path / "out/drive.csv")["r"]).max() < 0.11


def test_j1939_absent_values_are_gaps_and_counted(tmp_path):
    report, out = run_j1939(tmp_path, j1939_log(absent=range(300, 400)))
    assert report["stretches"][0]["columns"]["r"]["terms"][0]["left_out"] == {"not available or error": 100}
    assert [d["file"] for d in report["drives"]] == ["drive_1.csv", "drive_2.csv"]
    for d in report["drives"]:
        got = table(out / d["file"])
        assert np.abs(got["r"] - 0.1 * np.sin(got["t"])).max() < 1.0 / 8192


def test_j1939_several_senders_are_told_apart_or_refused(tmp_path):
    exact, _ = run_j1939(tmp_path, j1939_log(vdc2=(0x18F0093E, 0x18F00921)))
    assert exact["stretches"][0]["columns"]["r"]["terms"][0]["frames"] == 1000, "the address of the DBC wins"
    with pytest.raises(InputError, match=r"0x21, 0x22.*source_address"):
        run_j1939(tmp_path, j1939_log(vdc2=(0x18F00922, 0x18F00921)))
    chosen, _ = run_j1939(
        tmp_path,
        j1939_log(vdc2=(0x18F00922, 0x18F00921)),
        J1939_MAP.replace('"yaw_rate"', '"yaw_rate", source_address = 0x22'),
    )
    assert chosen["stretches"][0]["columns"]["r"]["terms"][0]["frames"] == 1000


def test_a_vehicle_with_can_places_needs_no_map_and_no_dbc(tmp_path):
    (tmp_path / "drive.log").write_text(j1939_log())

    def signal(column, unit, low, high, role, **can_place):
        return SimpleNamespace(
            name=column,
            column=column,
            unit=unit,
            min=low,
            max=high,
            role=role,
            can=SimpleNamespace(**can_place),
        )

    project = SimpleNamespace(
        name="truck",
        Ts_s=0.01,
        signals=[
            signal(
                "v", "m/s", -1, 60, "speed", message="CCVS1", signal="wheel_based_speed", factor=3.6, plus=()
            ),
            signal("r", "rad/s", -2, 2, "output", message="VDC2", signal="yaw_rate", factor=1.0, plus=()),
        ],
    )
    ingest([tmp_path / "drive.log"], dbc=None, signals_map=map_of_project(project), out=tmp_path / "out")
    got = table(tmp_path / "out/drive.csv")
    assert np.allclose(got["v"], 15.0) and np.abs(got["r"] - 0.1 * np.sin(got["t"])).max() < 1.0 / 8192
    project.signals[0].can = None
    with pytest.raises(InputError, match="v have no `can` entry"):
        map_of_project(project)


# -------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    "old, new, what",
    [
        (
            'message = "STEER", signal = "ANGLE"',
            'message = "STEERING", signal = "ANGLE"',
            "no message STEERING.*such as STEER",
        ),
        ('signal = "ANGLE"', 'signal = "ANGEL"', "no signal ANGEL.*such as ANGLE"),
        ('unit = "rad/s"', 'unit = "m"', "YAW is in deg/s, the column in m"),
        ("Ts_s = 0.01", "Ts_s = -0.01", "Ts_s.*greater than 0"),
        ("Ts_s = 0.01", 'Ts_s = 0.01\nchannel = "can7"', "can7 is not in the log"),
        ("Ts_s = 0.01", "Ts_s = 0.01\nTs = 1", "Ts: "),
        ("schema = 1", "schema = ", "TOML"),
        ("columns.v", "columns.t", "t is the time"),
        (
            'message = "SPEED", signal = "V"',
            'max = 9, terms = [{ signal = "V" }, { signal = "W" }]',
            "min and max judge",
        ),
        ('message = "SPEED", signal = "V"', 'message = "SPEED"', "signal.*Field required"),
    ],
    ids=range(10),
)
def test_a_map_that_does_not_fit_is_refused_by_name(old, new, what, car, tmp_path):
    assert old in MAP
    log = write_log("log", other_car(1.0), tmp_path / "drive")
    with pytest.raises(InputError, match=what) as error:
        run(car, tmp_path / "out", log, map_text=MAP.replace(old, new, 1))
    assert "map.toml" in str(error.value)


@pytest.mark.parametrize(
    "name, content, what",
    [
        ("missing.log", None, "no such file"),
        ("drive.xyz", "x", "unknown kind of log"),
        ("drive.log", "", "no frame"),
        ("drive.log", "hello\nworld\n", "line 1.*no frame"),
        ("drive.log.gz", "not gzip", "cannot be read"),
        ("drive.blf", "not blf", "cannot be read"),
        ("drive.mf4", "not mf4", "cannot be read"),
        ("drive.csv", "a,b\n1,2\n", "no time column"),
        ("drive.csv", "t,x\n0,1\n1,2\n", "no column ANGLE"),
        ("drive.csv", "t,ANGLE\n0,1\n1e12,2\n", r"line 3, column t: a time of 1e\+12 s"),
        ("drive.parquet", "not parquet", "cannot be parsed"),
        ("drive.log", "(1.0) can0 123#0000000000000000\n", "columns|nothing remains"),
    ],
    ids=range(12),
)
def test_a_log_that_cannot_be_used_is_refused_by_name(name, content, what, car, tmp_path):
    log = tmp_path / name
    if content is not None:
        log.write_text(content)
    with pytest.raises(InputError, match=what) as error:
        run(car, tmp_path / "out", log)
    assert name in str(error.value)


@pytest.mark.parametrize(
    "column, value, what",
    [
        ("timestamp", np.inf, "time inf s"),
        ("timestamp", 1e12, "time 1000000000000.0 s"),
        ("arbitration_id", 1 << 40, "too many bits"),
        ("data", bytes(65), "65 bytes of data"),
    ],
)
def test_a_raw_table_is_refused_by_the_row_that_is_no_frame(column, value, what, tmp_path):
    columns = {"timestamp": [0.0, 1.0], "arbitration_id": [0x123, 0x123], "data": [b"\0", b"\1"]}
    columns[column][1] = value
    pa_parquet.write_table(pa.table(columns), tmp_path / "raw.parquet")
    with pytest.raises(InputError, match=rf"raw.parquet: row 2: no frame \(.*{what}"):
        read_log(tmp_path / "raw.parquet")


def test_two_logs_of_one_name_are_refused(car, tmp_path):
    (tmp_path / "b").mkdir()
    logs = [
        write_log("log", other_car(1.0), tmp_path / "drive"),
        write_log("asc", other_car(1.0), tmp_path / "b/drive"),
    ]
    with pytest.raises(InputError, match="two logs"):
        run(car, tmp_path / "out", *logs)
