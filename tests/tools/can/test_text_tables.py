"""Text tables as loggers write them, times in any usual form, and raw frames as tables."""

import bz2
import gzip
import json
import lzma
import re
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pa_parquet
import pytest
from scipy.io import savemat

from lpvguard.base.errors import InputError, InputWarning
from lpvguard.can.logs import Frames, Table, logs_among, read_log, stem

MILLISECONDS = lambda t: f"{1000 * t:.0f}"  # noqa: E731
ROWS = [(0.02 * k, 10 + 0.5 * k, -1.5 + k) for k in range(40)]


def text(
    header: str, delimiter: str, time=lambda t: f"{t:.3f}", comma: bool = False, before: str = ""
) -> str:
    """A table of ROWS under a header."""
    lines = [delimiter.join([time(t), f"{v:.2f}", f"{d:.3f}"]) for t, v, d in ROWS]
    body = "\n".join(lines).replace(".", ",") if comma else "\n".join(lines)
    return f"{before}{header}\n{body}\n"


FORMS = {
    "tabs": text("t\tv\td", "\t"),
    "semicolons and commas": text("t;v;d", ";", comma=True),
    "tabs and commas": text("t\tv\td", "\t", comma=True),
    "bars": text("t|v|d", "|"),
    "blanks": text("t v d", "  "),
    "Time [s]": text("Time [s],v,d", ","),
    "preamble": text("t,v,d", ",", before="Logger 3.1\nvehicle: mine\n\n"),
    "comments": text("t,v,d", ",", before="# logger 3.1, serial 5\n"),
    "row of units": text("t,v,d\ns,km/h,deg", ","),
    "units in brackets": text("t;v;d\n[s];[km/h];[deg]", ";"),
    "milliseconds by name": text("time_ms,v,d", ",", lambda t: f"{1000 * t:.0f}"),
    "milliseconds in brackets": text("Zeit (ms);v;d", ";", lambda t: f"{1000 * t:.1f}", comma=True),
    "microseconds": text("timestamp_us,v,d", ",", lambda t: f"{1e6 * t:.0f}"),
    "nanoseconds of an epoch": text(
        "%time,v,d", ",", lambda t: f"{1_700_000_000_000_000_000 + round(1e9 * t)}"
    ),
    "milliseconds of an epoch": text("timestamp,v,d", ",", lambda t: f"{1_700_000_000_000 + round(1e3 * t)}"),
    "seconds of an epoch": text("epoch,v,d", ",", lambda t: f"{1_700_000_000 + t:.3f}"),
    "ISO 8601": text("time,v,d", ",", lambda t: f"2026-04-22T03:45:{t:06.3f}Z"),
    "a date with a zone": text("DateTime,v,d", ",", lambda t: f"2026-04-22 03:45:{t:06.3f}+02:00"),
    "a German date": text("Zeit;v;d", ";", lambda t: f"22.04.2026 03:45:{t:06.3f}", comma=True).replace(
        "22,04,2026", "22.04.2026"
    ),
    "a time of day": text("Uhrzeit,v,d", ",", lambda t: f"03:45:{t:06.3f}"),
    "past midnight": text(
        "time,v,d",
        ",",
        lambda t: f"{'23:59:59' if t < 0.4 else '00:00:00'}.{round(600 + 1000 * t) % 1000:03d}",
    ),
    "stamp of ROS": text("stamp.secs,stamp.nsecs,v,d", ",", lambda t: f"1700000000,{round(1e9 * t)}"),
    "a delimiter at the end": text("t;v;d;", ";").replace("\n", ";\n").replace(";;", ";"),
    "quoted": text('"t","v","d"', ","),
    "quoted decimal commas": re.sub(r"[^;\n]+", r'"\g<0>"', text("t;v;d", ";", comma=True)).replace(";", ","),
    "a header in a comment": text("# time(s),v,d", ",", before="# logger 3.1\n"),
    "a header in a comment, blanks": text("% t v d", " "),
    "row of units, then a blank line": text("t,v,d\ns,km/h,deg\n", ","),
    "rows of units and of sources": text("timestamp,v,d\nunix time,km/h,deg\n,100: gps,200: obd", ","),
    "units in the header's cells": text(
        '"Interval"|"ms"|0|25,"v"|"km/h"|0|25,"d"|"deg"|0|25', ",", MILLISECONDS
    ),
    "units behind the numbers": re.sub(r"(,[\d.]+)(,[-\d.]+)\n", r"\1 km/h\2 deg\n", text("t,v,d", ",")),
    "thousands set apart": text("Time [ms],v,d", ",", lambda t: f'"{1e6 + 1e3 * t:,.0f}"'),
    "thousands with points": text(
        "Zeit [ms];v;d", ";", lambda t: f"{1e6 + 1e3 * t:,.0f},0".replace(",", "#", 2), comma=True
    ).replace("#", "."),
    "minutes and seconds": text("time,v,d", ",", lambda t: f"03:{t:06.3f}"),
    "a time of day with four colons": text("time,v,d", ",", lambda t: f"03:45:{t:06.3f}".replace(".", ":")),
    "a month in letters": text("Device Time,v,d", ",", lambda t: f"22-Apr-2026 03:45:{t:06.3f}"),
    "an American date": text("time,v,d", ",", lambda t: f"04/22/2026 03:45:{t:06.3f} PM"),
    "a date in digits": text("time,v,d", ",", lambda t: f"20260422T0345{t:06.3f}"),
    "date and time apart": text("Datum;Uhrzeit;v;d", ";", lambda t: f"22.04.2026;03:45:{t:06.3f}"),
    "a clock's digits": text("UTC,v,d", ",", lambda t: f"{125859.7 + t + 40 * (t > 0.29):.3f}"),
    "a clock's digits past midnight": text(
        "time,v,d", ",", lambda t: f"{round(235959700 + 1000 * t) if t < 0.29 else round(1000 * t) - 300}"
    ),
    "French": text("Temps (s);v;d", ";", comma=True),
    "asammdf": text("timestamps,v,d", ","),
    "a line of words as wide as the table above": text(
        "t,v,d",
        ",",
        before='"Format","MoTeC CSV File"\n"Venue",,"Track"\n"Rate","50","Hz"\n"Duration","9"\n\n',
    ),
    "each line in quotes": "t,v,d,note\n"
    + "".join(f'"{line},""a""" \n'.replace(" ", "") for line in text("t,v,d", ",").splitlines()[1:]),
    "minutes": text("time [min],v,d", ",", lambda t: f"{t / 60:.10f}"),
    "hours": text("time_h,v,d", ",", lambda t: f"{t / 3600:.12f}"),
    "no zeros in front": text("elapsed,v,d", ",", lambda t: f"0:0:{t:.3f}"),
    "days of pandas": text("time,v,d", ",", lambda t: f"1 days 00:00:{t:09.6f}"),
    "two digits of a year": text("Date Time,v,d", ",", lambda t: f"4/22/26 03:45:{t:06.3f}"),
    "two digits of a German year": text("Zeit,v,d", ",", lambda t: f"22.04.26 03:45:{t:06.3f}"),
    "Chinese": text("\u65f6\u95f4(s),v,d", ","),
    "a minus of typographers": text("t,v,d", ",").replace("-", "\u2212"),
    "an exponent of Fortran": re.sub(r"([\d.]+)\n", r"\1D+00\n", text("t,v,d", ",")),
    "quotes and brackets": re.sub(r"([\d.]+),([-\d.]+)\n", r"""="\1",[\2]\n""", text("t,v,d", ",")),
    "a zone of letters": text("time,v,d", ",", lambda t: f"2026-04-22 03:45:{t:06.3f} CEST"),
    "decimal commas and a point": re.sub(
        r"^([\d,]+);", lambda m: m[0].replace(",", "."), text("t;v;d", ";", comma=True), flags=re.M
    ),
    "a column of time that is none": text("GPS Time,Time,v,d", ",", lambda t: f"Wed Apr 22 03:45,{t:.3f}"),
    "days of a spreadsheet": text("time,v,d", ",", lambda t: f"{45769 + t / 86400:.12f}"),
    "UTC in ISO 8601": text("utc,v,d", ",", lambda t: f"2026-04-22T03:45:{t:06.3f}Z"),
    "milliseconds since 1970": text("unix_ms,v,d", ",", lambda t: f"{1_700_000_000_000 + round(1e3 * t)}"),
    "dates under no word for time": text("Orario,v,d", ",", lambda t: f"22/04/2026 03:45:{t:06.3f}"),
    "since 1970 under no word for time": text("k,v,d", ",", lambda t: f"{1_700_000_000 + t:.3f}"),
    "days of MATLAB": text("time,v,d", ",", lambda t: f"{739000 + t / 86400:.12f}"),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.filterwarnings("ignore::lpvguard.base.errors.InputWarning")
def test_a_text_table_is_read_in_whatever_form_it_has(tmp_path, form):
    (tmp_path / "log.csv").write_text(FORMS[form], encoding="utf-8")
    log = read_log(tmp_path / "log.csv")
    assert isinstance(log, Table) and list(log.series) == ["v", "d"]
    v = log.series["v"]
    np.testing.assert_allclose(
        (v.t_ns - v.t_ns[0]) / 1e9, [t for t, _, _ in ROWS], atol=1e-5 if "days" in form else 2e-7
    )
    np.testing.assert_allclose(v.value, [x for _, x, _ in ROWS])
    np.testing.assert_allclose(log.series["d"].value, [x for _, _, x in ROWS])
    assert v.unit == ("km/h" if "unit" in form else "")


def test_columns_of_one_name_are_told_apart(tmp_path):
    (tmp_path / "log.csv").write_text(text("t,v,v", ","))
    with pytest.warns(InputWarning, match=r"line 1: columns of the same name \(v\): .* called v #2"):
        assert list(read_log(tmp_path / "log.csv").series) == ["v", "v #2"]


def test_rows_without_times_need_their_rate(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text(text("number,v,d", ",", lambda t: f"{50 * t:.0f}"))
    with pytest.raises(InputError, match=r"no time column; .* --time NAME, or --rate HZ"):
        read_log(log)
    np.testing.assert_allclose(read_log(log, rate_hz=50.0).series["v"].t_ns, [1e9 * t for t, _, _ in ROWS])


@pytest.mark.parametrize("step", ("0.02", "{:.4f}"))
def test_steps_are_no_times(tmp_path, step):
    random = np.random.default_rng(3)
    (tmp_path / "log.csv").write_text(
        text("time,v,d", ",", lambda t: step.format(0.02 + 0.001 * random.random()))
    )
    with pytest.raises(InputError, match=r"column time: .* --rate HZ"):
        read_log(tmp_path / "log.csv")


@pytest.mark.parametrize("kind", [pa.timestamp("us"), pa.timestamp("ns", "UTC"), pa.duration("ms")])
def test_times_of_a_parquet_table_are_read(tmp_path, kind):
    t, v, _ = zip(*ROWS, strict=True)
    unit = {"us": 1e6, "ns": 1e9, "ms": 1e3}[kind.unit]
    table = pa.table({"v": v, "time": pa.array([round(x * unit) for x in t], pa.int64()).cast(kind)})
    pa_parquet.write_table(table, tmp_path / "log.parquet")
    series = read_log(tmp_path / "log.parquet").series["v"]
    np.testing.assert_allclose(series.t_ns / 1e9, t, atol=1e-9)


def test_vectors_of_a_matlab_file_are_read_as_a_table(tmp_path):
    t, v, d = np.array(ROWS).T
    savemat(tmp_path / "log.mat", {"Time_ms": 1000 * t, "v": v, "d": d, "car": "mine"})
    log = read_log(tmp_path / "log.mat")
    assert sorted(log.series) == ["d", "v"] and log.series["v"].t_ns[1] == 20 * 10**6


def test_other_encodings_and_suffixes_are_read(tmp_path):
    (tmp_path / "wide.txt").write_bytes(FORMS["tabs"].encode("utf-16"))
    (tmp_path / "bare.csv").write_bytes(FORMS["semicolons and commas"].encode("utf-16-le"))
    (tmp_path / "big.csv").write_bytes(FORMS["bars"].encode("utf-16-be"))
    assert list(read_log(tmp_path / "bare.csv").series) == ["v", "d"]
    assert list(read_log(tmp_path / "big.csv").series) == ["v", "d"]
    (tmp_path / "old.tsv").write_bytes(FORMS["tabs"].replace("\td", "\tWinkel [°]").encode("cp1252"))
    assert list(read_log(tmp_path / "wide.txt").series) == ["v", "d"]
    assert list(read_log(tmp_path / "old.tsv").series) == ["v", "Winkel [°]"]


PACK = {".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress}


@pytest.mark.parametrize("suffix", PACK)
def test_packed_tables_are_read(tmp_path, suffix):
    log = tmp_path / f"drive.csv{suffix}"
    log.write_bytes(PACK[suffix](FORMS["tabs"].encode()))
    assert logs_among([tmp_path]) == [log] and stem(log) == "drive"
    assert list(read_log(log).series) == ["v", "d"]
    log.write_bytes(PACK[suffix](FORMS["tabs"].encode())[:-20])
    with pytest.raises(InputError, match="cannot be read"):
        read_log(log)


def test_the_logs_in_an_archive_are_read(tmp_path):
    log = tmp_path / "drive.zip"
    with zipfile.ZipFile(log, "w") as archive:
        archive.writestr("logs/one.csv", FORMS["tabs"])
    assert list(read_log(log).series) == ["v", "d"] and logs_among([tmp_path]) == [log]
    with zipfile.ZipFile(log, "a") as archive:
        archive.writestr("logs/two.csv", FORMS["tabs"])
    with pytest.raises(InputError, match=r"holds 2 files \(logs/one.csv, logs/two.csv\); expected one log"):
        read_log(log)
    for named in (log, tmp_path):
        inside = logs_among([named])
        assert [stem(p) for p in inside] == ["one", "two"] and inside[0].parent.parent.name == "drive.zip"
        assert list(read_log(inside[1]).series) == ["v", "d"]
    with zipfile.ZipFile(tmp_path / "binary.zip", "w") as archive:
        archive.writestr("table.mat", b"")
    assert [p.name for p in logs_among([tmp_path / "binary.zip"])] == ["table.mat"]
    log.write_bytes(log.read_bytes()[:-30])
    with pytest.raises(InputError, match=r"drive.zip: cannot be read \(.*\); expected a whole .zip"):
        logs_among([log])


VBO = """File created on 12/05/2024 at 12:59:30

[header]
satellites
time
velocity kmh
Steer

[channel units]
deg

[comments]
Log Rate (Hz) : 50.00

[column names]
sats time velocity Steer

[data]
"""


def test_a_vbox_file_is_read(tmp_path):
    log = tmp_path / "drive.vbo"
    rows = (f"012 {125859.7 + t + 40 * (t > 0.29):.2f} {v:07.3f} {d:+.6E}" for t, v, d in ROWS)
    log.write_text(VBO + "\n".join(rows) + "\n")
    with pytest.warns(InputWarning, match="digits of a clock, HHMMSS"):
        read = read_log(log)
    v = read.series["velocity"]
    np.testing.assert_allclose((v.t_ns - v.t_ns[0]) / 1e9, [t for t, _, _ in ROWS], atol=1e-7)
    np.testing.assert_allclose(v.value, [x for _, x, _ in ROWS])
    assert v.unit == "kmh" and read.series["Steer"].unit == "deg"
    log.write_text(VBO.replace("[column names]", "[names]") + "1 2 3 4\n")
    with pytest.raises(InputError, match=r"\[column names\]: no such section"):
        read_log(log)


SIGNAL_A_ROW = {
    "OBD.csv": '"SECONDS";"PID";"VALUE";"UNITS"\n'
    + "".join(f'"{t:.3f}";"v";"{v}";"km/h"\n"{t + 0.001:.3f}";"d";"{d}";"deg"\n' for t, v, d in ROWS),
    "telemetry.csv": "timestamp,car,telemetry_name,telemetry_value\n"
    + "".join(f"{t:.3f},7,v,{v}\n{t + 0.001:.3f},7,d,{d}\n" for t, v, d in ROWS),
    "openXC.json": "".join(
        json.dumps({"name": n, "value": x, "timestamp": 1.7e9 + t}) + "\n"
        for t, v, d in ROWS
        for n, x in (("v", v), ("d", d), ("door", "driver"))
    ),
    "drive.jsonl": "".join(json.dumps({"t": t, "v": v, "in": {"x": 1}, "d": d}) + "\n" for t, v, d in ROWS),
    "list.json": json.dumps([{"time": t, "v": v, "d": d, "ok": True} for t, v, d in ROWS]),
    "lists.json": json.dumps(
        dict(zip(("time", "v", "d"), zip(*ROWS, strict=True), strict=True)) | {"car": "x"}
    ),
    "inside.json": json.dumps({"car": "x", "data": [{"time": t, "v": v, "d": d} for t, v, d in ROWS]}),
    "influx.csv": "#group,false,false\n#datatype,string,dateTime:RFC3339\n#default,,\n"
    ",result,_time,_value,_field\n"
    + "".join(
        f",,2023-11-14T22:13:{20 + t:06.3f}Z,{x},{n}\n"
        for k, n in ((1, "v"), (2, "d"))
        for t, *_ in ROWS
        for x in (ROWS[round(50 * t)][k],)
    ),
}


@pytest.mark.parametrize("name", SIGNAL_A_ROW)
def test_tables_with_a_signal_a_row_and_json_are_read(tmp_path, name):
    (tmp_path / name).write_text(SIGNAL_A_ROW[name])
    log = read_log(tmp_path / name)
    assert isinstance(log, Table) and stem(tmp_path / name) == name.split(".")[0]
    for k, signal in enumerate(("v", "d"), start=1):
        series = log.series[signal]
        np.testing.assert_allclose((series.t_ns - series.t_ns[0]) / 1e9, [t for t, _, _ in ROWS], atol=2e-7)
        np.testing.assert_allclose(series.value, [row[k] for row in ROWS])
    assert log.series["v"].unit == ("km/h" if name == "OBD.csv" else "")
    assert "door" not in log.series


def test_a_text_of_no_json_and_a_folder_with_settings_are_told(tmp_path):
    (tmp_path / "drive.jsonl").write_text('{"t": 0.0, "v": 1}\n{"t": 0.02')
    with pytest.raises(InputError, match=r"drive.jsonl: no JSON \(.*\); expected an object a line"):
        read_log(tmp_path / "drive.jsonl")
    (tmp_path / "drive.jsonl").write_text("[1, 2]")
    with pytest.raises(InputError, match="holds no object"):
        read_log(tmp_path / "drive.jsonl")
    (tmp_path / "settings.json").write_text("{}")
    assert logs_among([tmp_path]) == [tmp_path / "drive.jsonl"]


def test_times_read_by_shape_are_named_and_doubtful_ones_asked(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text(text("time,v,d", ",", lambda t: f"{1000 * t:.0f}"))
    with pytest.warns(InputWarning, match="column time is taken to be in ms: its steps are 20"):
        read_log(log)
    log.write_text(text("time,v,d", ",", lambda t: f"{50 * t:.0f}"))
    with pytest.raises(InputError, match="column time: its steps of 1 are a second, or a thousandth"):
        read_log(log)


def test_a_stray_cell_and_a_line_cut_short_are_named(tmp_path):
    log, lines = tmp_path / "log.csv", text("t,v,d", ",").splitlines()
    lines[7] = lines[7].replace(",13.", ",oops13.")
    lines[-1] = lines[-1].rsplit(",", 1)[0]
    log.write_text("\n".join(lines) + "\n")
    with pytest.warns(InputWarning) as warned:
        read = read_log(log)
    said = " ".join(str(w.message) for w in warned)
    assert "1 line(s) without 3 cells" in said and "column v: 1 of 39 cells hold no number" in said
    assert len(read.series["d"].value) == 39 and np.isnan(read.series["v"].value).sum() == 1


def test_a_column_with_numbers_and_other_cells_is_named(tmp_path):
    (tmp_path / "log.csv").write_text(text("t,v,d", ",").replace(",-1.500", ",(1.5)").replace(",0.500", ",?"))
    with pytest.warns(
        InputWarning, match=r"column d: 2 of 40 cells hold no number, the first '\(1.5\)' in row 1"
    ):
        assert list(read_log(tmp_path / "log.csv").series) == ["v"]


RAW = {
    "GVRET": "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3\n"
    "1000,0000027E,false,Rx,0,2,0A,FF,\n21000,18FEF100,true,Rx,0,3,01,02,03\n",
    "GVRET, a delimiter at the end": "Time Stamp,ID,Extended,Bus,LEN,D1,D2,D3\n"
    "1000,0000027E,false,0,2,0A,FF,\n21000,18FEF100,true,0,3,01,02,03,\n",
    "lists of Python": ",timestamp,can_id,data_length,data\n"
    "0,0.001,27E,2,\"['0A', 'FF']\"\n1,0.021,18FEF100,3,\"['01', '02', '03']\"\n",
    "Cabana": "time,addr,bus,data\n0.001,0x27e,0,0x0AFF\n0.021,0x18FEF100,0,0x010203\n",
    "comma": "time,addr,bus,data\n0.001,638,0,0aff\n0.021,419361024,0,010203\n",
    "CSS": "TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;ESI;RTR;DataBytes\n"
    "0.001;0;27E;0;2;2;0;0;0;0;0;0AFF\n0.021;0;18FEF100;1;3;3;0;0;0;0;0;010203\n",
    "python-can": "timestamp,arbitration_id,extended,remote,error,dlc,data\n"
    "0.001,0x27e,0,0,0,2,Cv8=\n0.021,0x18fef100,1,0,0,3,AQID\n",
    "Vehicle Spy": "Intrepid Control Systems\nVersion,101\n\n"
    "Abs Time(Sec),Er,Network,Arb ID,Remote,Xtd,B1,B2,B3,B4\n"
    "0.001,F,HS CAN,27E,F,F,0A,FF,,\n0.021,F,HS CAN,18FEF100,F,T,01,02,03,\n",
    "Kvaser, decimal bytes": "Time,Channel,ID,Flags,DLC,Data0,Data1,Data2,Counter\n"
    "0.001,0,638,2,2,10,255,,1\n0.021,0,419361024,4,3,1,2,3,2\n",
    "lists of numbers": 'time,can_id,data\n0.001,638,"[10, 255]"\n0.021,419361024,"[1, 2, 3]"\n',
    "bytes of Python": "time,id,data\n0.001,27E,b'\\n\\xff'\n0.021,18FEF100,bytearray(b'\\x01\\x02\\x03')\n",
    "ZLG": "Index,Time Stamp,Channel,ID,Format,Len,Data\n"
    "0,0.001,ch1,0x0000027E,Standard,2,x| 0A FF\n1,0.021,ch1,0x18FEF100,Extend,3,x| 01 02 03\n",
    "CL2000": '# Value separator: ";"\nTimestamp;Type;ID;Data\n20231114T221320001;0;27E;0AFF\n'
    "20231114T221320021;1;18FEF100;010203\n",
    "CL1000": '# Value separator: ";"\nTimestamp;Type;ID;Data\n01T000000001;0;27E;0AFF\n'
    "01T000000021;1;18FEF100;010203\n",
    "IXXAT": "ASCII Trace IXXAT Automation GmbH  Version: 1.3\nDate: 22.4.2026\n"
    '"Time","Identifier (hex)","Format","Flags","Data (hex)"\n'
    '"00:00:00.001","27E","Std","","0A FF "\n"00:00:00.021","18FEF100","Ext","","01 02 03 "\n',
    "PCAN-Explorer": "Time (ms),Direction,ID (hex),DLC,Data (hex)\n"
    "1,Rx,27E,2,0A FF\n21,Rx,18FEF100,3,01 02 03\n",
    "CANalyzer": "Time;Chn;ID;Dir;Type;DLC;D0;D1;D2\n"
    "0.001;1;27E;Rx;d;2;0A;FF;\n0.021;1;18FEF100x;Rx;d;3;01;02;03\n",
    "milliseconds of a board": "timestamp_ms,id,ext,len,b0,b1,b2\n"
    "1,27E,0,2,0A,FF,\n21,18FEF100,1,3,01,02,03\n",
    "nanoseconds": "timestamp_ns,can_id,data\n1000000,0x27e,0A FF\n21000000,0x18fef100,01 02 03\n",
    "strym": "Time,Bus,MessageID,Message,MessageLength\n0.001,0,638,0aff,2\n0.021,0,419361024,010203,3\n",
}


@pytest.mark.parametrize("form", RAW)
def test_raw_frames_as_a_table_are_read(tmp_path, form):
    (tmp_path / "log.csv").write_text(RAW[form])
    log = read_log(tmp_path / "log.csv")
    assert isinstance(log, Frames)
    assert np.diff(log.t_ns).tolist() == pytest.approx([20e6], abs=300)
    assert log.t_ns[0] == 10**6 or "T" in RAW[form].splitlines()[-1]
    assert log.length.tolist() == [2, 3]
    assert log.id.tolist() == [0x27E, 0x98FEF100]
    assert log.data[:, :3].tolist() == [[0x0A, 0xFF, 0], [1, 2, 3]]


def test_a_length_that_is_not_that_of_the_bytes_is_named(tmp_path):
    (tmp_path / "log.csv").write_text(
        RAW["GVRET"].replace("0,3,01", "0,2,01").replace("0,2,0A,FF", "0,3,0A,FF")
    )
    with pytest.raises(InputError, match="line 2: no frame"):
        read_log(tmp_path / "log.csv")
    (tmp_path / "log.csv").write_text(RAW["strym"].replace("010203,3", "010203,4"))
    with pytest.raises(InputError, match=r"line 3: no frame \(3 bytes, where its length says 4"):
        read_log(tmp_path / "log.csv")
