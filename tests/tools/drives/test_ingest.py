"""Ingest: every log form gives the same table, every database decodes as cantools does, and a real log gives
its reference table."""

import json
import os
from pathlib import Path

import cantools
import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.can.decode import decode_all, load_database
from lpvguard.can.logs import EXTENDED, Frames, Table, read_log
from lpvguard.drives.ingest import ingest
from lpvguard.drives.units import unit_factor
from made import ROOT
from other_car import MAP, agrees, other_car, run, table, truth, write_log, write_map

DATA = Path(os.environ.get("LPVGUARD_DATA", ROOT.parent / "shared/data"))


# ------------------------------------------------------------------------------------------------------ forms


@pytest.mark.slow("4 s: a log in seven forms")
@pytest.mark.parametrize("form", ["log", "log.gz", "asc", "blf", "mf4", "csv", "parquet"])
def test_every_form_of_raw_log_gives_the_same_drive(form, car, tmp_path):
    log = write_log(form, other_car(), tmp_path / "drive")
    report = run(car, tmp_path / "out", log)["drive"]
    assert report["kind"] == "raw frames" and report["left_out"] == [] and report["clock_jumps"] == []
    assert agrees(tmp_path / "out/drive.csv") >= 1198
    assert report["stretches"][0]["columns"]["psi"]["terms"][0]["wraps"] == 1
    reference = decode_all(
        read_log(write_log("log", other_car(), tmp_path / "again")), load_database(car / "car.dbc")
    )
    decoded = decode_all(read_log(log), load_database(car / "car.dbc"))
    for message, signals in reference.items():
        for name, samples in signals.items():
            assert np.array_equal(decoded[message][name].value, samples.value), f"{message}.{name}"


def test_decoded_signals_are_those_of_cantools(car, tmp_path):
    frames = other_car(3.0)
    database = load_database(car / "car.dbc")
    decoded = decode_all(read_log(write_log("log", frames, tmp_path / "drive")), database)
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
        f'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 1 M: 8 A\n'
        f' SG_ S : {start}|{length}@{order}{sign} (1,0) [0|0] "" A\n'
    )
    data = rng.integers(0, 256, (64, 8), np.uint8)
    log = tmp_path / "one.log"
    log.write_text("".join(f"({k}.000000) can0 001#{row.tobytes().hex()}\n" for k, row in enumerate(data)))
    database = load_database(dbc)
    want = [database.get_message_by_name("M").decode(row.tobytes())["S"] for row in data]
    assert decode_all(read_log(log), database)["M"]["S"].value.tolist() == [float(v) for v in want]


@pytest.mark.parametrize("form", ["csv", "parquet", "mf4"])
def test_every_form_of_decoded_log_gives_the_same_drive(form, car, tmp_path):
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
        signals_map=write_map(
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
    text = [f"{a:.2f},{b:.6f}" for a, b in zip(t, x, strict=False)]
    text[50] = "1.00,"
    (tmp_path / "drive.csv").write_text("t,x\n" + "\n".join(text) + "\n")
    report = ingest(
        [tmp_path / "drive.csv"],
        dbc=None,
        out=tmp_path / "out",
        signals_map=write_map(tmp_path, 'schema = 1\nTs_s = 0.01\n[columns.x]\nunit = "rad"\nsignal = "x"'),
    )["drive"]
    assert [j["kind"] for j in report["clock_jumps"]] == ["pause or jump forwards", "backwards"]
    assert report["stretches"][0]["columns"]["x"]["terms"][0]["left_out"] == {"no value": 1}
    assert [(d["rows"], d["t_first_s"], d["log_time_of_first_row_s"]) for d in report["drives"]] == [
        (399, 0.0, 0.0),
        (199, 6.0, 6.0),
        (199, 1.0, 1.0),
    ]


def test_units_convert_only_within_one_quantity():
    assert unit_factor("km/h", "m/s") == pytest.approx(1 / 3.6) and unit_factor(
        "°/s", "rad/s"
    ) == pytest.approx(np.pi / 180)
    assert unit_factor("Nm", "Nm") == 1.0 and unit_factor("raw", "raw") == 1.0
    assert unit_factor("raw", "rad") is None and unit_factor("deg", "deg/s") is None


def test_a_column_over_the_speed_and_a_rate_of_a_course(tmp_path):
    """A course of 4 deg/s clockwise that a table repeats five times, and an acceleration over the speed."""
    t = 0.02 * np.arange(500)
    course = (350 + 4.0 * t[np.arange(500) // 5 * 5]) % 360
    v = np.where(t < 2, 0.5, 10.0)
    log, path = tmp_path / "log.csv", tmp_path / "map.toml"
    table = np.column_stack([t, v, course, 7.0 * np.ones(500)])
    np.savetxt(log, table, "%.9g", ",", header="t,v,course,ay", comments="")
    text = """schema = 1
Ts_s = 0.02
[columns.v]
unit = "m/s"
signal = "v"
[columns.turning]
unit = "rad/s"
signal = "course"
source_unit = "deg"
factor = -1.0
wrap = 360.0
rate = true
[columns.across]
unit = "rad/s"
over = "v"
over_min = 2.0
offset = 1.0
terms = [{ signal = "ay", scale = 1.0 }]
"""
    path.write_text(text)
    ingest([log], dbc=None, signals_map=path, out=tmp_path / "out")
    made = np.genfromtxt(tmp_path / "out/log.csv", delimiter=",", names=True)
    assert made["turning"] == pytest.approx(np.radians(-4.0)) and len(made) >= 489
    assert made["across"] == pytest.approx(8.0 / np.maximum(made["v"], 2.0))
    wrong = {"over = w is no column": ('over = "v"', 'over = "w"'), "needs a scale": (", scale = 1.0", "")}
    for says, change in wrong.items():
        path.write_text(text.replace(*change))
        with pytest.raises(InputError, match=says):
            ingest([log], dbc=None, signals_map=path, out=tmp_path / "other")


def test_the_same_input_gives_the_same_bytes(car, tmp_path):
    log = write_log("log", other_car(2.0), tmp_path / "drive")
    contents = []
    for folder in ("one", "two"):
        run(car, tmp_path / folder, log)
        contents.append({p.name: p.read_bytes() for p in sorted((tmp_path / folder).iterdir())})
    assert contents[0] == contents[1]
    assert set(contents[0]) == {"drive.csv", "drive.report.json", "experiments.csv", "MANIFEST.json"}
    assert set(json.loads(contents[0]["MANIFEST.json"])["inputs"]) == {"drive.log", "car.dbc"}


def test_parquet_is_written_when_the_map_asks_for_it(car, tmp_path):
    log = write_log("log", other_car(2.0), tmp_path / "drive")
    run(car, tmp_path / "out", log, map_text=MAP.replace("Ts_s = 0.01", 'Ts_s = 0.01\nformat = "parquet"'))
    agrees(tmp_path / "out/drive.parquet")


# -------------------------------------------------------------------------------------------------- real data

RAV4 = DATA / "comma2k19_rav4"
needs_rav4 = pytest.mark.skipif(not RAV4.is_dir(), reason=f"no {RAV4.name} in LPVGUARD_DATA")


@needs_rav4
def test_the_rav4_log_gives_the_reference_table(tmp_path):
    terms = ", ".join(
        f'{{ message = "WHEEL_SPEEDS", signal = "WHEEL_SPEED_{w}", factor = 0.25 }}'
        for w in ("FL", "FR", "RL", "RR")
    )
    map_path = write_map(
        tmp_path,
        f"""schema = 1
Ts_s = 0.01
channel = "can0"
columns.v = {{ unit = "m/s", terms = [{terms}] }}
columns.sw_angle = {{ unit = "rad", terms = [
    {{ message = "STEER_ANGLE_SENSOR", signal = "STEER_ANGLE" }},
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


@pytest.mark.unhurried
@needs_rav4
def test_decoding_is_ten_times_the_python_loop():
    from lpvguard.extras.bench.can import bench_decode

    result = bench_decode(
        RAV4 / "rav4_candump.log.gz", RAV4 / "toyota_rav4_excerpt.dbc", frames=1_000_000, peer_frames=66_234
    )
    assert result["ratio"] >= 10, result
    assert result["frames_per_s"] >= 2e6, result


# -------------------------------------------------------------------------------------- databases of any kind

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
    """The same name for a standard and an extended identifier of the same number: told apart by what the log
    holds."""
    (tmp_path / "car.dbc").write_bytes(ODD_DBC.format(unit="°/s").encode(encoding))
    order = "big" if identifier == "064" else "little"
    (tmp_path / "drive.log").write_text(
        "".join(
            f"({0.01 * k:.6f}) can0 {identifier}#{k.to_bytes(2, order).hex()}000000000000\n"
            for k in range(100)
        )
    )
    (tmp_path / "map.toml").write_text(
        'schema = 1\nTs_s = 0.01\ncolumns.r = { unit = "rad/s", message = "TWICE", signal = "YAW" }\n'
    )
    ingest(
        [tmp_path / "drive.log"],
        dbc=tmp_path / "car.dbc",
        signals_map=tmp_path / "map.toml",
        out=tmp_path / "out",
    )
    table = np.genfromtxt(tmp_path / "out" / "drive.csv", delimiter=",", names=True)
    assert np.allclose(table["r"], np.deg2rad(factor * np.arange(100)), atol=1e-12)


def test_a_name_that_two_messages_of_the_log_carry_is_refused(tmp_path):
    (tmp_path / "car.dbc").write_text(ODD_DBC.format(unit="deg/s"))
    (tmp_path / "drive.log").write_text(
        "(0.0) can0 064#0000000000000000\n(0.1) can0 00000064#0000000000000000\n"
    )
    (tmp_path / "map.toml").write_text(
        'schema = 1\nTs_s = 0.01\ncolumns.r = { unit = "rad/s", message = "TWICE", signal = "YAW" }\n'
    )
    with pytest.raises(InputError, match="2 messages are called TWICE"):
        ingest(
            [tmp_path / "drive.log"],
            dbc=tmp_path / "car.dbc",
            signals_map=tmp_path / "map.toml",
            out=tmp_path / "out",
        )


def random_database(rng: np.random.Generator) -> str:
    """Text of a DBC: up to 64 bytes, both byte orders, signed, float, multiplexed, standard and extended
    identifiers."""
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: CAR"]
    floats = []
    for number in range(int(rng.integers(1, 6))):
        length = int(rng.choice([1, 2, 5, 8, 8, 8, 24, 64]))
        extended = bool(rng.integers(2))
        identifier = 16 * int(rng.integers(1 << (25 if extended else 7))) + number | (
            0x80000000 if extended else 0
        )
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
            first = (
                start - start % 8 + 7 - start % 8 if big else start
            )  # position counted from the most significant bit of byte 0
            places = np.arange(first, first + bits)
            if places[-1] >= 8 * length:
                continue
            places = places - places % 8 + 7 - places % 8 if big else places
            taken = fixed | (of_page[page] if page is not None else of_page.any(axis=0))
            if taken[places].any():
                continue
            (fixed if page is None else of_page[page])[places] = True
            sign = "-" if floating or rng.integers(2) else "+"
            scale, offset = (
                rng.choice(["1", "0.1", "-0.5", "0.00390625", "1E-005"]),
                rng.choice(["0", "-40", "12.5"]),
            )
            lines.append(
                f" SG_ S{k} {'' if page is None else f'm{page} '}: "
                f'{start}|{bits}@{0 if big else 1}{sign} ({scale},{offset}) [0|0] "km/h" CAR'
            )
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
    frames = Frames(
        np.arange(n) * 10**6,
        np.array(ids, np.uint32),
        np.zeros(n, np.uint8),
        np.array([len(row) for row in rows], np.uint8),
        data,
        ["can0"],
    )
    decoded = decode_all(frames, database)
    ours = {
        (name, signal, int(at)): x
        for name, signals in decoded.items()
        for signal, s in signals.items()
        for at, x in zip(s.frame, s.value, strict=False)
    }
    theirs = {}
    for at, row in enumerate(rows):
        message = database.messages[at // 50]
        values = message.decode(row, decode_choices=False)
        theirs |= {(message.name, signal, at): float(x) for signal, x in values.items() if np.isfinite(x)}
    assert ours.keys() == theirs.keys() and (len(ours) >= 50 or not any(m.signals for m in database.messages))
    assert all(np.isclose(ours[key], x, rtol=1e-12, atol=0) for key, x in theirs.items())


@pytest.mark.parametrize(
    "text",
    [
        "\ufefft,v\n0.0,1.5\n0.1,2.5\n0.2,3.5\n",
        "# a comment, with commas\n\nt, v\n0.0,1.5\n0.1,2.5\n0.2,3.5\n",
        "t;v\n0,0;1,5\n0,1;2,5\n0,2;3,5\n",
        "t;v\r\n0.0;1.5\r\n0.1;2.5\r\n0.2;3.5\r\n",
    ],
    ids=["byte-order mark", "comments", "decimal commas", "semicolons"],
)
def test_csv_is_read_as_people_have_it(tmp_path, text):
    (tmp_path / "log.csv").write_bytes(text.encode())
    log = read_log(tmp_path / "log.csv")
    assert isinstance(log, Table)
    assert log.series["v"].value.tolist() == [1.5, 2.5, 3.5]
    assert log.series["v"].t_ns.tolist() == [0, 10**8, 2 * 10**8]


def test_candumps_screen_with_time_stamps_is_read_as_its_log(tmp_path):
    screen = (
        " (1345212884.318850)  can0  18F0093E   [8]  FF FF 00 FF 00 FF 00 12\n"
        " (1345212884.319850)  can0  123   [2]  0A 0B   '..'\r\n"
        " (1345212884.320850)  can1  RX - -  124   [0] \n"
        " (1345212884.321850)  can0  123  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B\n"
        " (1345212884.322850)  can0  123   [4]  remote request\n"
    )
    logged = (
        "(1345212884.318850) can0 18F0093E#FFFF00FF00FF0012\n"
        "(1345212884.319850) can0 123#0A0B\n"
        "(1345212884.320850) can1 124#\n"
        "(1345212884.321850) can0 123##0000102030405060708090A0B\n"
        "(1345212884.322850) can0 123#R4\n"
    )
    read = []
    for name, text in (("screen.log", screen), ("log.log", logged)):
        (tmp_path / name).write_bytes(text.encode())
        read.append(read_log(tmp_path / name))
    one, other = read
    assert isinstance(one, Frames) and isinstance(other, Frames)
    assert len(one) == 4 and one.left_out == other.left_out and one.channels == other.channels
    for key in ("t_ns", "id", "channel", "length", "data"):
        assert np.array_equal(getattr(one, key), getattr(other, key)), key


def test_candumps_binary_and_swapped_screens_are_read_as_its_log(tmp_path):
    (tmp_path / "screen.log").write_text(
        " (1.000000)  can0  123   [2]  00001010 11110001\n"
        " (1.100000)  can0  123   [2]  F1`0A\n"
        " (1.200000)  can0  123   [8]  00000000 11110001\n"
        " (1.300000)  can0  123   [3]  0A F1\n"
    )
    log = read_log(tmp_path / "screen.log")
    assert isinstance(log, Frames)
    assert log.data[:, :2].tolist() == [[0x0A, 0xF1], [0x0A, 0xF1]] and log.length.tolist() == [2, 2]
    assert log.left_out == {"lines that are no frame": 2, "first line that is no frame": 3}


BAD_LINES = {
    "extended without flag": ("BO_ 316495015 OTHER: 8 A", "BO_ 316495015"),
    "number without zero": ('BO_ 5 OTHER: 8 A\n SG_ X : 0|8@1+ (.25,0) [0|255] "" A', "SG_ X"),
    "name with digit": ('BO_ 5 OTHER: 8 A\n SG_ 2ND : 0|8@1+ (1,0) [0|255] "" A', "SG_ 2ND"),
    "values of no signal": ('VAL_ 291 GONE 0 "off" 1 "on" ;', "VAL_ 291 GONE"),
}


@pytest.mark.parametrize("case", BAD_LINES)
def test_a_bad_line_of_a_database_costs_that_line(tmp_path, case):
    bad, named = BAD_LINES[case]
    path = tmp_path / "car.dbc"
    path.write_text(
        'VERSION ""\n\nBU_: A\n\nBO_ 291 STEER: 8 A\n SG_ V : 32|16@1+ (0.01,0) [0|655.35] "km/h" A\n\n'
        + bad
        + '\n\nBO_ 7 LAST: 8 A\n SG_ W : 0|8@1- (1,0) [0|0] "" A\n'
    )
    with pytest.warns(UserWarning, match=named):
        database = load_database(path)
    assert database.get_message_by_name("STEER").signals[0].scale == 0.01
    assert database.get_message_by_name("LAST").signals[0].is_signed


def test_a_comment_without_a_name_costs_nothing(tmp_path):
    path = tmp_path / "car.dbc"
    path.write_text(
        'VERSION ""\n\nBU_: A\n\nBO_ 291 STEER: 8 A\n SG_ V : 32|16@1+ (1,0) [0|9] "" A\n\n'
        'CM_ SG_ 291 "a comment\nof two lines";\n'
    )
    assert [m.name for m in load_database(path).messages] == ["STEER"]
