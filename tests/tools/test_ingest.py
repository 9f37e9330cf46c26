"""Ingest: every log form gives the same table; faults of logs are handled as stated and reported; bad input names itself."""

from __future__ import annotations

import gzip
import json
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("cantools")
pytest.importorskip("can")

import can
import cantools

from lpvguard import native
from lpvguard.can.dbc import dbc_text
from lpvguard.can.decode import decode_all, load_database
from lpvguard.can.logs import EXTENDED, Frames, read_log
from lpvguard.errors import InputError
from lpvguard.ingest import ingest, map_of_project, unit_factor

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("LPVGUARD_DATA", ROOT.parent / "shared/data"))

# A made-up car: Motorola and Intel, signed, float, multiplexed, an extended identifier, a CAN FD frame.
OTHER_CAR = """VERSION ""
NS_ :
BS_:
BU_: CAR
BO_ 291 STEER: 8 CAR
 SG_ ANGLE : 7|13@0- (0.1,0) [-409.6|409.5] "deg" CAR
 SG_ HEADING : 16|12@1+ (0.1,0) [0|360] "deg" CAR
 SG_ TORQUE : 43|9@0- (0.5,1) [0|0] "Nm" CAR
BO_ 2566844672 SPEED: 8 CAR
 SG_ V : 12|15@1+ (0.01,-10) [-10|300] "km/h" CAR
BO_ 512 MUXED: 8 CAR
 SG_ SELECT M : 0|4@1+ (1,0) [0|15] "" CAR
 SG_ YAW m2 : 8|16@1- (0.01,0) [-300|300] "deg/s" CAR
 SG_ TEMP m3 : 8|8@1+ (1,-40) [-40|215] "" CAR
BO_ 768 FLOAT: 8 CAR
 SG_ AY : 0|32@1- (1,0) [-20|20] "m/s2" CAR
 SG_ AX : 39|32@0- (1,0) [-20|20] "m/s2" CAR
SIG_VALTYPE_ 768 AY : 1;
SIG_VALTYPE_ 768 AX : 1;
"""
MAP = """schema = 1
Ts_s = 0.01
columns.delta = { unit = "rad", message = "STEER", signal = "ANGLE" }
columns.v = { unit = "m/s", message = "SPEED", signal = "V" }
columns.r = { unit = "rad/s", message = "MUXED", signal = "YAW", factor = -1 }
columns.ay = { unit = "m/s2", message = "FLOAT", signal = "AY", offset = 0.5 }
columns.psi = { unit = "rad", message = "STEER", signal = "HEADING", wrap = 360 }
"""
COLUMNS = {"delta": 2e-3, "v": 3e-3, "r": 2e-4, "ay": 1e-5, "psi": 2e-3}
"""Half a bit of each signal and a little for the interpolation, in the column's unit."""


def truth(t: np.ndarray) -> dict[str, np.ndarray]:
    return {
        "delta": 0.5 * np.sin(t),
        "v": 15 + 3 * np.sin(0.3 * t),
        "r": 0.2 * np.cos(t),
        "ay": 2 * np.sin(0.7 * t) + 0.5,
        "psi": 1.0 * t,
    }


def other_car(seconds: float = 12.0, start: float = 1000.0) -> list[can.Message]:
    database = cantools.database.load_string(OTHER_CAR, "dbc")
    frames = []

    def add(name: str, t: float, signals: dict, extended: bool = False) -> None:
        message = database.get_message_by_name(name)
        frames.append(
            can.Message(
                timestamp=round(start + t, 6),
                arbitration_id=message.frame_id,
                is_extended_id=extended,
                data=message.encode(signals, strict=False),
                channel=0,
            )
        )

    for k in range(round(seconds / 0.005)):
        t = 0.005 * k
        x = {name: float(v) for name, v in truth(np.array(t)).items()}
        add(
            "STEER",
            t,
            {"ANGLE": np.degrees(x["delta"]), "HEADING": np.degrees(x["psi"]) % 360, "TORQUE": -3.0},
        )
        if k % 2 == 0:
            add("SPEED", t + 0.0011, {"V": 3.6 * x["v"]}, extended=True)
            add("MUXED", t + 0.0012, {"SELECT": 2, "YAW": -np.degrees(x["r"])})
            add("MUXED", t + 0.0013, {"SELECT": 3, "TEMP": 20})
            add("FLOAT", t + 0.0014, {"AY": x["ay"] - 0.5, "AX": -1.25})
    return frames


def candump(frames: list[can.Message], interface: str = "can0") -> str:
    return "".join(
        f"({m.timestamp:.6f}) {interface} {m.arbitration_id:0{8 if m.is_extended_id else 3}X}#{m.data.hex().upper()}\n"
        for m in frames
    )


@pytest.fixture(scope="module")
def car(tmp_path_factory):
    folder = tmp_path_factory.mktemp("car")
    (folder / "car.dbc").write_text(OTHER_CAR)
    (folder / "map.toml").write_text(MAP)
    return folder


def run(car: Path, out: Path, *logs: Path, dbc: Path | None = None, map_text: str | None = None) -> dict:
    path = car / "map.toml"
    if map_text is not None:
        path = out.parent / "map.toml"
        path.write_text(map_text)
    return ingest(logs, dbc=dbc or car / "car.dbc", signals_map=path, out=out)


def table(path: Path) -> dict[str, np.ndarray]:
    import pyarrow.csv as pa_csv
    import pyarrow.parquet as pa_parquet

    read = pa_parquet.read_table(path) if path.suffix == ".parquet" else pa_csv.read_csv(path)
    return {name: read.column(name).to_numpy() for name in read.column_names}


def agrees(path: Path, start: float = 0.0014, columns=COLUMNS) -> int:
    """Rows of the table, after comparing it with the truth; ``start``: time of its t = 0 after the log's start."""
    got = table(path)
    want = truth(got["t"] + start)
    for name, tolerance in columns.items():
        # MUXED and others were sampled at the tick but stamped up to 1.4 ms later: a shift, not an error of ingest
        assert (
            np.abs(got[name] - want[name]).max()
            < tolerance + 0.0014 * np.abs(np.gradient(want[name], got["t"])).max()
        ), name
    assert np.allclose(np.diff(got["t"]), 0.01, atol=1e-9)
    return len(got["t"])


# ------------------------------------------------------------------------------------------------------------- forms


def _write(form: str, frames: list[can.Message], path: Path) -> Path:
    if form == "log":
        path = path.with_suffix(".log")
        path.write_text(candump(frames))
    elif form == "log.gz":
        path = path.with_name(path.name + ".log.gz")
        path.write_bytes(gzip.compress(candump(frames).encode(), mtime=0))
    elif form == "parquet":
        import pyarrow as pa
        import pyarrow.parquet as pa_parquet

        path = path.with_suffix(".parquet")
        pa_parquet.write_table(
            pa.table(
                {
                    "timestamp": [m.timestamp for m in frames],
                    "data": [bytes(m.data) for m in frames],
                    "arbitration_id": [m.arbitration_id for m in frames],
                    "extended": [m.is_extended_id for m in frames],
                }
            ),
            path,
        )
    else:
        if form == "mf4":
            pytest.importorskip("asammdf", reason="pip install asammdf")
        path = path.with_suffix(f".{form}")
        with can.Logger(path) as writer:
            for message in frames:
                writer.on_message_received(message)
    return path


@pytest.mark.parametrize("form", ["log", "log.gz", "asc", "blf", "mf4", "csv", "parquet"])
def test_every_form_of_raw_log_gives_the_same_drive(form, car, tmp_path):
    log = _write(form, other_car(), tmp_path / "drive")
    report = run(car, tmp_path / "out", log)["drive"]
    assert report["kind"] == "raw frames" and report["left_out"] == [] and report["clock_jumps"] == []
    assert agrees(tmp_path / "out/drive.csv") >= 1198
    assert report["stretches"][0]["columns"]["psi"]["terms"][0]["wraps"] == 1
    reference = decode_all(
        read_log(_write("log", other_car(), tmp_path / "again")), load_database(car / "car.dbc")
    )
    decoded = decode_all(read_log(log), load_database(car / "car.dbc"))
    for message, signals in reference.items():
        for name, samples in signals.items():
            assert np.array_equal(decoded[message][name].value, samples.value), f"{message}.{name}"


def test_decoding_equals_cantools(car, tmp_path):
    frames = other_car(3.0)
    database = load_database(car / "car.dbc")
    decoded = decode_all(read_log(_write("log", frames, tmp_path / "drive")), database)
    want: dict[str, dict[str, list[float]]] = {}
    for m in frames:
        message = database.get_message_by_frame_id(m.arbitration_id)
        for name, value in message.decode(m.data, decode_choices=False).items():
            want.setdefault(message.name, {}).setdefault(name, []).append(value)
    assert {m: set(s) for m, s in want.items()} == {m: set(s) for m, s in decoded.items()}
    for message, signals in want.items():
        for name, values in signals.items():
            assert np.allclose(decoded[message][name].value, values, rtol=1e-12, atol=1e-12), (
                f"{message}.{name}"
            )


@pytest.mark.parametrize("seed", range(40))
def test_any_layout_of_a_signal_equals_cantools(seed, tmp_path):
    rng = np.random.default_rng(seed)
    length, order, sign = int(rng.integers(1, 65)), int(rng.integers(0, 2)), "+-"[rng.integers(0, 2)]
    first = int(rng.integers(0, 65 - length))
    start = first if order else 8 * (first // 8) + 7 - first % 8
    dbc = tmp_path / "one.dbc"
    dbc.write_text(
        f'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 1 M: 8 A\n SG_ S : {start}|{length}@{order}{sign} (1,0) [0|0] "" A\n'
    )
    data = rng.integers(0, 256, (64, 8), np.uint8)
    log = tmp_path / "one.log"
    log.write_text("".join(f"({k}.000000) can0 001#{row.tobytes().hex()}\n" for k, row in enumerate(data)))
    database = load_database(dbc)
    want = [database.get_message_by_name("M").decode(row.tobytes())["S"] for row in data]
    assert decode_all(read_log(log), database)["M"]["S"].value.tolist() == [float(v) for v in want]


@pytest.mark.parametrize("form", ["csv", "parquet", "mf4"])
def test_decoded_logs(form, car, tmp_path):
    t = np.arange(0, 10, 0.02)
    x = truth(t)
    columns = {"t": t, "ANGLE": np.degrees(x["delta"]), "V": 3.6 * x["v"]}
    path = tmp_path / f"drive.{form}"
    if form == "csv":
        np.savetxt(
            path,
            np.column_stack(list(columns.values())),
            delimiter=",",
            header=",".join(columns),
            comments="",
            fmt="%.9g",
        )
    elif form == "parquet":
        import pyarrow as pa
        import pyarrow.parquet as pa_parquet

        pa_parquet.write_table(pa.table(columns), path)
    else:
        asammdf = pytest.importorskip("asammdf", reason="pip install asammdf")
        with asammdf.MDF() as mdf:
            mdf.append(
                [asammdf.Signal(columns[n], t, name=n, unit=u) for n, u in (("ANGLE", "deg"), ("V", "km/h"))]
            )
            mdf.save(path)
    source = (
        "" if form == "mf4" else ', source_unit = "deg"',
        "" if form == "mf4" else ', source_unit = "km/h"',
    )
    report = ingest(
        [path],
        dbc=None,
        out=tmp_path / "out",
        signals_map=_map(
            tmp_path,
            f'''schema = 1
Ts_s = 0.01
columns.delta = {{ unit = "rad", signal = "ANGLE"{source[0]} }}
columns.v = {{ unit = "m/s", signal = "V"{source[1]} }}''',
        ),
    )
    assert report["drive"]["kind"] == "decoded signals"
    assert agrees(tmp_path / "out/drive.csv", start=0.0, columns={"delta": 1e-4, "v": 1e-4}) == 999


def test_decoded_logs_with_gaps_absent_values_and_a_clock_that_goes_back(car, tmp_path):
    t = np.concatenate((np.arange(0, 4, 0.02), np.arange(6, 8, 0.02), np.arange(1, 3, 0.02)))
    x = np.sin(t)
    text = [f"{a:.2f},{b:.6f}" for a, b in zip(t, x)]
    text[50] = "1.00,"
    (tmp_path / "drive.csv").write_text("t,x\n" + "\n".join(text) + "\n")
    report = ingest(
        [tmp_path / "drive.csv"],
        dbc=None,
        out=tmp_path / "out",
        signals_map=_map(tmp_path, 'schema = 1\nTs_s = 0.01\n[columns.x]\nunit = "rad"\nsignal = "x"'),
    )["drive"]
    assert [j["kind"] for j in report["clock_jumps"]] == ["pause or jump forwards", "backwards"]
    assert report["stretches"][0]["columns"]["x"]["terms"][0]["left_out"] == {"no value": 1}
    assert [(d["rows"], d["t_first_s"], d["log_time_of_first_row_s"]) for d in report["drives"]] == [
        (399, 0.0, 0.0),
        (199, 6.0, 6.0),
        (199, 1.0, 1.0),
    ]


def _map(folder: Path, text: str) -> Path:
    (folder / "signals.toml").write_text(text)
    return folder / "signals.toml"


# ------------------------------------------------------------------------------------------------- what logs suffer


@pytest.mark.parametrize("way", ["compiled", "without a compiler"])
def test_frames_of_every_kind_in_candump(way, tmp_path, monkeypatch):
    if way == "compiled" and native.kernels("candump") is None:
        pytest.skip("no compiler")
    if way != "compiled":
        monkeypatch.setenv("LPVGUARD_NO_NATIVE", "1")
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
    report = run(car, tmp_path / "out", _write("log", frames, tmp_path / "drive"))["drive"]
    assert [d["file"] for d in report["drives"]] == ["drive_1.csv", "drive_2.csv"]
    (left,) = report["left_out"]
    assert left["columns"] == ["r"] and left["reason"] == "samples further apart than max_gap_s"
    assert 1003.9 < left["from_s"] < 1004.01 and 1005.9 < left["to_s"] < 1006.02
    assert report["stretches"][0]["columns"]["r"]["terms"][0]["gaps"] == 1
    for file in ("drive_1.csv", "drive_2.csv"):
        agrees(tmp_path / "out" / file)
    assert (tmp_path / "out/experiments.csv").read_text().splitlines() == [
        "experiment,split",
        "drive_1,unassigned",
        "drive_2,unassigned",
    ]


def test_a_wrap_that_the_map_does_not_name_is_suspected(car, tmp_path):
    text = MAP.replace(", wrap = 360", "")
    report = run(car, tmp_path / "out", _write("log", other_car(), tmp_path / "drive"), map_text=text)[
        "drive"
    ]
    counts = {
        name: c["terms"][0].get("suspected_wraps") for name, c in report["stretches"][0]["columns"].items()
    }
    assert counts == {"delta": 0, "v": 0, "r": 0, "ay": 0, "psi": 1}


def test_a_short_gap_is_interpolated(car, tmp_path):
    frames = [m for m in other_car() if not (m.arbitration_id == 0x200 and 1004.0 < m.timestamp < 1004.3)]
    report = run(car, tmp_path / "out", _write("log", frames, tmp_path / "drive"))["drive"]
    assert (
        len(report["drives"]) == 1
        and report["stretches"][0]["columns"]["r"]["terms"][0]["longest_pause_s"] > 0.29
    )


def test_clock_jumps_cut_and_are_reported(car, tmp_path):
    first, second, third = other_car(4.0), other_car(4.0, start=500.0), other_car(4.0, start=1e9)
    report = run(car, tmp_path / "out", _write("log", first + second + third, tmp_path / "drive"))["drive"]
    assert [j["kind"] for j in report["clock_jumps"]] == ["backwards", "pause or jump forwards"]
    assert report["clock_jumps"][0]["from_s"] > 1003.9 and report["clock_jumps"][0]["to_s"] == 500.0
    assert [d["rows"] for d in report["drives"]] == [399, 399, 399]
    for k in (1, 2):
        agrees(tmp_path / f"out/drive_{k}.csv")


def test_slightly_disordered_frames_are_sorted(car, tmp_path):
    frames = other_car()
    for k in range(50, len(frames) - 50, 100):
        frames[k], frames[k + 7] = frames[k + 7], frames[k]
    report = run(car, tmp_path / "out", _write("log", frames, tmp_path / "drive"))["drive"]
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
    report = run(car, tmp_path / "out", _write("log", frames, tmp_path / "drive"), map_text=text)["drive"]
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


# --------------------------------------------------------------------------------------------------------------- J1939

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
                f"({t:.6f}) can0 18FEF100#{database.encode_message('CCVS1', {'wheel_based_speed': 54.0}).hex()}\n"
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
            signals_map=_map(tmp_path, J1939_MAP),
        )
    ingest(
        [tmp_path / "drive.log"],
        dbc=tmp_path / "bare.dbc",
        out=tmp_path / "out",
        signals_map=_map(tmp_path, J1939_MAP.replace("Ts_s", "j1939 = true\nTs_s")),
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

    def signal(column, unit, low, high, **can_place):
        return SimpleNamespace(
            name=column, column=column, unit=unit, min=low, max=high, can=SimpleNamespace(**can_place)
        )

    project = SimpleNamespace(
        name="truck",
        Ts_s=0.01,
        signals=[
            signal("v", "m/s", -1, 60, message="CCVS1", signal="wheel_based_speed", factor=3.6),
            signal("r", "rad/s", -2, 2, message="VDC2", signal="yaw_rate", factor=1.0),
        ],
    )
    ingest([tmp_path / "drive.log"], dbc=None, signals_map=map_of_project(project), out=tmp_path / "out")
    got = table(tmp_path / "out/drive.csv")
    assert np.allclose(got["v"], 15.0) and np.abs(got["r"] - 0.1 * np.sin(got["t"])).max() < 1.0 / 8192
    project.signals[0].can = None
    with pytest.raises(InputError, match="v have no `can` entry"):
        map_of_project(project)


# ----------------------------------------------------------------------------------------------------------- bad input


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
    log = _write("log", other_car(1.0), tmp_path / "drive")
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
        ("drive.parquet", "not parquet", "cannot be parsed"),
        ("drive.log", "(1.0) can0 123#0000000000000000\n", "columns|nothing remains"),
    ],
    ids=range(11),
)
def test_a_log_that_cannot_be_used_is_refused_by_name(name, content, what, car, tmp_path):
    log = tmp_path / name
    if content is not None:
        log.write_text(content)
    with pytest.raises(InputError, match=what) as error:
        run(car, tmp_path / "out", log)
    assert name in str(error.value)


def test_two_logs_of_one_name_are_refused(car, tmp_path):
    (tmp_path / "b").mkdir()
    logs = [
        _write("log", other_car(1.0), tmp_path / "drive"),
        _write("asc", other_car(1.0), tmp_path / "b/drive"),
    ]
    with pytest.raises(InputError, match="two logs"):
        run(car, tmp_path / "out", *logs)


def test_units():
    assert unit_factor("km/h", "m/s") == pytest.approx(1 / 3.6) and unit_factor(
        "°/s", "rad/s"
    ) == pytest.approx(np.pi / 180)
    assert unit_factor("Nm", "Nm") == 1.0 and unit_factor("raw", "raw") == 1.0
    assert unit_factor("raw", "rad") is None and unit_factor("deg", "deg/s") is None


def test_the_same_input_gives_the_same_bytes(car, tmp_path):
    log = _write("log", other_car(2.0), tmp_path / "drive")
    contents = []
    for folder in ("one", "two"):
        run(car, tmp_path / folder, log)
        contents.append({p.name: p.read_bytes() for p in sorted((tmp_path / folder).iterdir())})
    assert contents[0] == contents[1]
    assert set(contents[0]) == {"drive.csv", "drive.report.json", "experiments.csv", "MANIFEST.json"}
    assert set(json.loads(contents[0]["MANIFEST.json"])["inputs"]) == {"drive.log", "car.dbc"}


def test_parquet_output(car, tmp_path):
    log = _write("log", other_car(2.0), tmp_path / "drive")
    run(car, tmp_path / "out", log, map_text=MAP.replace("Ts_s = 0.01", 'Ts_s = 0.01\nformat = "parquet"'))
    agrees(tmp_path / "out/drive.parquet")


# ---------------------------------------------------------------------------------------------------------- real data

RAV4 = DATA / "comma2k19_rav4"
needs_rav4 = pytest.mark.skipif(not RAV4.is_dir(), reason=f"no {RAV4.name} in LPVGUARD_DATA")


@needs_rav4
def test_the_rav4_log_gives_the_reference_table(tmp_path):
    terms = ", ".join(
        f'{{ message = "WHEEL_SPEEDS", signal = "WHEEL_SPEED_{w}", factor = 0.25 }}'
        for w in ("FL", "FR", "RL", "RR")
    )
    map_path = _map(
        tmp_path,
        f"""schema = 1
Ts_s = 0.01
channel = "can0"
columns.v = {{ unit = "m/s", terms = [{terms}] }}
columns.sw_angle = {{ unit = "rad", terms = [{{ message = "STEER_ANGLE_SENSOR", signal = "STEER_ANGLE" }},
                                            {{ message = "STEER_ANGLE_SENSOR", signal = "STEER_FRACTION" }}] }}
columns.sw_rate = {{ unit = "rad/s", message = "STEER_ANGLE_SENSOR", signal = "STEER_RATE" }}
columns.r_can = {{ unit = "rad/s", message = "KINEMATICS", signal = "YAW_RATE" }}
columns.ay = {{ unit = "m/s2", message = "KINEMATICS", signal = "ACCEL_Y", factor = -1 }}
columns.lka_cmd = {{ unit = "raw", message = "STEERING_LKA", signal = "STEER_TORQUE_CMD", channel = "can1" }}
""",
    )
    ingest(
        [RAV4 / "rav4_candump.log.gz"],
        dbc=RAV4 / "toyota_rav4_excerpt.dbc",
        signals_map=map_path,
        out=tmp_path / "out",
    )
    got, want = table(tmp_path / "out/rav4_candump.csv"), table(RAV4 / "rav4_100hz.csv")
    rows = len(want["t"])
    assert len(got["t"]) >= rows
    # the reference is rounded to 5 decimals
    for name, tolerance in {
        "t": 1e-9,
        "sw_angle": 6e-6,
        "v": 2e-5,
        "sw_rate": 2e-5,
        "r_can": 1e-5,
        "ay": 1e-4,
        "lka_cmd": 6e-3,
    }.items():
        assert np.abs(got[name][:rows] - want[name]).max() <= tolerance, name


@needs_rav4
def test_decoding_is_ten_times_the_python_loop():
    from lpvguard.bench.can import bench_decode

    if native.kernels("candump") is None:
        pytest.skip("no compiler")
    result = bench_decode(
        RAV4 / "rav4_candump.log.gz", RAV4 / "toyota_rav4_excerpt.dbc", frames=1_000_000, peer_frames=66_234
    )
    assert result["ratio"] >= 10, result
    assert result["frames_per_s"] >= 2e6, result


# ------------------------------------------------------------------------------------------------ databases of any kind

ODD_DBC = """VERSION ""
NS_ :
BS_:
BU_: CAR
BO_ 100 TWICE: 8 CAR
 SG_ YAW : 7|16@0- (0.01,0) [-300|300] "{unit}" CAR
BO_ 2147483748 TWICE: 8 CAR
 SG_ YAW : 0|16@1- (0.02,0) [-300|300] "{unit}" CAR
"""


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
@pytest.mark.parametrize("identifier, factor", [("064", 0.01), ("00000064", 0.02)])
def test_units_in_any_encoding_and_names_given_twice(encoding, identifier, factor, tmp_path):
    """The same name for a standard and an extended identifier of the same number: told apart by what the log holds."""
    (tmp_path / "car.dbc").write_bytes(ODD_DBC.format(unit="°/s").encode(encoding))
    order = "big" if identifier == "064" else "little"
    (tmp_path / "drive.log").write_text(
        "".join(f"({0.01 * k:.6f}) can0 {identifier}#{k.to_bytes(2, order).hex()}000000000000\n" for k in range(100))
    )
    (tmp_path / "map.toml").write_text(
        'schema = 1\nTs_s = 0.01\ncolumns.r = { unit = "rad/s", message = "TWICE", signal = "YAW" }\n'
    )
    ingest([tmp_path / "drive.log"], dbc=tmp_path / "car.dbc", signals_map=tmp_path / "map.toml", out=tmp_path / "out")
    table = np.genfromtxt(tmp_path / "out" / "drive.csv", delimiter=",", names=True)
    assert np.allclose(table["r"], np.deg2rad(factor * np.arange(100)), atol=1e-12)


def test_a_name_that_two_messages_of_the_log_carry_is_refused(tmp_path):
    (tmp_path / "car.dbc").write_text(ODD_DBC.format(unit="deg/s"))
    (tmp_path / "drive.log").write_text("(0.0) can0 064#0000000000000000\n(0.1) can0 00000064#0000000000000000\n")
    (tmp_path / "map.toml").write_text(
        'schema = 1\nTs_s = 0.01\ncolumns.r = { unit = "rad/s", message = "TWICE", signal = "YAW" }\n'
    )
    with pytest.raises(InputError, match="2 messages are called TWICE"):
        ingest([tmp_path / "drive.log"], dbc=tmp_path / "car.dbc", signals_map=tmp_path / "map.toml", out=tmp_path / "out")


def random_database(rng: np.random.Generator) -> str:
    """Text of a DBC: up to 64 bytes, both byte orders, signed, float, multiplexed, standard and extended identifiers."""
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: CAR"]
    floats = []
    for number in range(int(rng.integers(1, 6))):
        length = int(rng.choice([1, 2, 5, 8, 8, 8, 24, 64]))
        extended = bool(rng.integers(2))
        identifier = 16 * int(rng.integers(1 << (25 if extended else 7))) + number | (0x80000000 if extended else 0)
        lines.append(f"BO_ {identifier} M{number}: {length} CAR")
        fixed, of_page = np.zeros(8 * length, bool), np.zeros((2, 8 * length), bool)
        multiplexed = length > 1 and rng.random() < 0.4
        if multiplexed:
            fixed[:1] = True
            lines.append(' SG_ PAGE M : 0|1@1+ (1,0) [0|0] "" CAR')
        for k in range(int(rng.integers(1, 9))):
            floating = rng.random() < 0.2
            bits = int(rng.choice([32, 64]) if floating else rng.integers(1, 65))
            page = int(rng.integers(2)) if multiplexed and rng.random() < 0.6 else None
            big = bool(rng.integers(2))
            start = int(rng.integers(8 * length))
            first = start - start % 8 + 7 - start % 8 if big else start  # position counted from the most significant bit of byte 0
            places = np.arange(first, first + bits)
            if places[-1] >= 8 * length:
                continue
            places = places - places % 8 + 7 - places % 8 if big else places
            taken = fixed | (of_page[page] if page is not None else of_page.any(axis=0))
            if taken[places].any():
                continue
            (fixed if page is None else of_page[page])[places] = True
            sign = "-" if floating or rng.integers(2) else "+"
            scale, offset = rng.choice(["1", "0.1", "-0.5", "0.00390625", "1E-005"]), rng.choice(["0", "-40", "12.5"])
            lines.append(f' SG_ S{k} {"" if page is None else f"m{page} "}: {start}|{bits}@{0 if big else 1}{sign} ({scale},{offset}) [0|0] "km/h" CAR')
            if floating:
                floats.append(f"SIG_VALTYPE_ {identifier} S{k} : {1 if bits == 32 else 2};")
    return "\n".join([*lines, *floats, ""])


@pytest.mark.parametrize("seed", range(30))
def test_any_database_decodes_as_cantools_does(seed):
    rng = np.random.default_rng(seed)
    database = cantools.database.load_string(random_database(rng), "dbc")
    ids, rows = [], []
    for message in database.messages:
        pages = sorted({page for s in message.signals for page in s.multiplexer_ids or []})
        for _ in range(50):
            ids.append(message.frame_id | (EXTENDED if message.is_extended_frame else 0))
            row = bytearray(rng.bytes(message.length))
            if pages:  # cantools refuses a page without a signal
                row[0] = row[0] & 0xFE | int(rng.choice(pages))
            rows.append(bytes(row))
    n = len(ids)
    data = np.array([list(row.ljust(64, b"\0")) for row in rows], np.uint8)
    frames = Frames(np.arange(n) * 10**6, np.array(ids, np.uint32), np.zeros(n, np.uint8),
                    np.array([len(row) for row in rows], np.uint8), data, ["can0"])
    decoded = decode_all(frames, database)
    ours = {(name, signal, int(at)): x for name, signals in decoded.items() for signal, s in signals.items()
            for at, x in zip(s.frame, s.value)}
    theirs = {}
    for at, row in enumerate(rows):
        message = database.messages[at // 50]
        values = message.decode(row, decode_choices=False)
        theirs |= {(message.name, signal, at): float(x) for signal, x in values.items() if np.isfinite(x)}
    assert ours.keys() == theirs.keys() and (len(ours) >= 50 or not any(m.signals for m in database.messages))
    assert all(np.isclose(ours[key], x, rtol=1e-12, atol=0) for key, x in theirs.items())
