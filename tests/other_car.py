"""A made-up car, its database and logs: Motorola and Intel, signed, float, multiplexed, an extended
identifier, a CAN FD frame."""

import gzip
from pathlib import Path

import can
import cantools
import numpy as np

from lpvguard.drives.ingest import ingest

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
        f"({m.timestamp:.6f}) {interface} "
        f"{m.arbitration_id:0{8 if m.is_extended_id else 3}X}#{m.data.hex().upper()}\n"
        for m in frames
    )


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
    """Rows of the table, after comparing it with the truth; ``start``: time of its t = 0 after the log's
    start."""
    got = table(path)
    want = truth(got["t"] + start)
    for name, tolerance in columns.items():
        # MUXED and others were sampled at the tick but stamped up to 1.4 ms later: a shift, not an error of
        # ingest
        assert (
            np.abs(got[name] - want[name]).max()
            < tolerance + 0.0014 * np.abs(np.gradient(want[name], got["t"])).max()
        ), name
    assert np.allclose(np.diff(got["t"]), 0.01, atol=1e-9)
    return len(got["t"])


def write_log(form: str, frames: list[can.Message], path: Path) -> Path:
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
        path = path.with_suffix(f".{form}")
        with can.Logger(path) as writer:
            for message in frames:
                writer.on_message_received(message)
    return path


def write_map(folder: Path, text: str) -> Path:
    (folder / "signals.toml").write_text(text)
    return folder / "signals.toml"
