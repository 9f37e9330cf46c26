"""A car's own bus: its database and project file make the C that its raw logs go through to the receiver.

Checksums are compared with autosar-e2e, and with formulas written down here from their definitions.
"""

import ctypes
from itertools import groupby
from pathlib import Path

import cantools
import numpy as np
import pytest

from lpvguard.base import native
from lpvguard.base.artefacts import write_files
from lpvguard.base.errors import InputError, InputWarning
from lpvguard.can.demand_code import demand_files, enclosed, packing
from lpvguard.can.logs import EXTENDED, Frames, read_log
from lpvguard.can.own import demand_messages, own_bus, sensor_messages
from lpvguard.can.own_loop import loop_files
from lpvguard.can.play import values_of_drive, write_candump
from lpvguard.core.coefficients import signal_table_markdown
from lpvguard.core.compiled import VERDICTS, Core, library_root
from lpvguard.drives.ingest import ingest
from lpvguard.drives.signal_map import map_of_project
from lpvguard.drives.tables import Drive
from lpvguard.fit.project_file import with_numbers
from lpvguard.replay.receive import Receiver
from lpvguard.replay.replayer import Replayer
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import CanPlace, Project, load_project
from other_car import table
from unit.generate import vehicle

PERIOD_S = 0.01
FRAMES = 60
DATA_IDS = [(7 * k + 3) % 251 for k in range(16)]
SETTINGS = {
    "toyota": {},
    "hyundai_sum": {},
    "hyundai_sum_before": {},
    "hyundai_nibbles": {"checksum_signal": "HALF"},
    "hyundai_crc8": {},
    "hyundai_canfd": {},
    "autosar_p01": {"data_id": 0x1234},
    "autosar_p02": {"data_id": DATA_IDS},
    "autosar_p05": {"data_id": 0x1234},
    "autosar_p11": {"data_id": 0x0A5F},
    "autosar_p22": {"data_id": DATA_IDS},
    "honda": {"checksum_signal": "HALF"},
    "subaru": {},
    "tesla": {},
    "chrysler": {},
    "volkswagen_xor": {},
    "nissan": {},
    "ford_speed": {},
    "ford_yaw_rate": {},
}
AT = {"ford_speed": 0, "ford_yaw_rate": 2}
"""First byte of X, where not 4: Ford's checksums cover some bytes."""
PLACES = {
    "hyundai_sum": ["CHECKSUM : 48|8@1+", "COUNTER : 0|2@1+"],
    "hyundai_sum_before": ["CHECKSUM : 48|8@1+"],
    "hyundai_nibbles": ["HALF : 63|4@0+", "COUNTER : 0|3@1+"],
    "hyundai_crc8": ["CHECKSUM : 55|8@0+", "COUNTER : 3|4@0+"],
    "hyundai_canfd": ["COUNTER : 16|8@1+"],
    "honda": ["HALF : 59|4@0+", "COUNTER : 61|2@0+"],
    "subaru": ["CHECKSUM : 0|8@1+", "COUNTER : 8|4@1+"],
    "tesla": ["CHECKSUM : 56|8@1+", "COUNTER : 52|4@1+"],
    "chrysler": ["COUNTER : 52|4@1+"],
    "volkswagen_xor": ["CHECKSUM : 56|8@1+", "COUNTER : 0|4@1+"],
    "nissan": ["CHECKSUM : 63|8@0+", "COUNTER : 51|4@0+"],
}
COUNTERS = {"toyota": 0, "hyundai_sum": 4, "hyundai_sum_before": 0, "hyundai_nibbles": 8, "hyundai_crc8": 16}
COUNTERS |= {"hyundai_canfd": 256, "autosar_p05": 256, "autosar_p02": 16, "autosar_p22": 16}
COUNTERS |= {"autosar_p01": 15, "autosar_p11": 15}
COUNTERS |= {"honda": 4, "subaru": 16, "tesla": 16, "chrysler": 16, "volkswagen_xor": 16}
COUNTERS |= {"nissan": 16, "ford_speed": 16, "ford_yaw_rate": 256}


def project(names: list[str]) -> Project:
    """A vehicle whose signals come in one message each, protected by the checksums ``names``."""
    roles = ["scheduling", "input", "output", "output", "output", "output", "input"][: len(names)]
    signals = [
        {
            "name": f"x_{name}",
            "role": role,
            "column": f"c{k}",
            "unit": "rad",
            "positive": "left",
            "min": -400.0,
            "max": 400.0,
            "can": {"message": name.upper(), "signal": "X", "factor": 2.0},
        }
        for k, (name, role) in enumerate(zip(names, roles, strict=True))
    ]
    outputs, inputs = roles.count("output"), roles.count("input")
    document = load_project("g80").model_dump(by_alias=True) | {"Ts_s": PERIOD_S, "signals": signals}
    document["model"] |= {
        "B": [["G/T"] * inputs],
        "C": [[1.0]] * outputs,
        "input_offset": None,
        "output_offset": None,
    }
    messages = {
        name.upper(): {"checksum": name, "period_ms": round(1000 * PERIOD_S), **SETTINGS[name]}
        for name in names
    }
    return Project.model_validate(document | {"can": {"dbc": "car.dbc", "messages": messages}})


def database(names: list[str]) -> str:
    text = 'VERSION ""\nNS_ :\nBS_:\nBU_: CAR\n'
    for k, name in enumerate(names):
        lines = [f"X : {8 * AT.get(name, 4)}|16@1-", *PLACES.get(name, [])]
        text += f"BO_ {0x2A0 + k} {name.upper()}: 8 CAR\n"
        text += "".join(f' SG_ {line} ({"0.01" if line[0] == "X" else 1},0) [0|0] "" CAR\n' for line in lines)
    return text


def crc(value: int, data: bytes, bits: int, polynomial: int) -> int:
    """CRC register after ``data``, bit by bit."""
    for byte in data:
        for k in range(7, -1, -1):
            out = (value >> (bits - 1)) ^ (byte >> k) & 1
            value = ((value << 1) ^ (polynomial if out else 0)) & ((1 << bits) - 1)
    return value


def protected(name: str, identifier: int, data: bytearray, count: int) -> bytes:
    """The frame ``data`` (8 bytes) with counter ``count`` and checksum, by the definition of ``name``."""
    if name.startswith("autosar"):
        return autosar(name, data, count)
    if name == "toyota":
        data[7] = (identifier // 256 + identifier % 256 + 8 + sum(data[:7])) % 256
        return bytes(data)
    if name in ("honda", "subaru", "tesla", "chrysler", "volkswagen_xor", "nissan", *AT):
        return of_other_makes(name, identifier, data, count % COUNTERS[name])
    masks = {"hyundai_sum": 3, "hyundai_nibbles": 7, "hyundai_crc8": 15}
    if name in masks:
        data[0] = data[0] & ~masks[name] | count % (masks[name] + 1)
    if name == "hyundai_sum":
        data[6] = (sum(data[:6]) + data[7]) % 256
    elif name == "hyundai_sum_before":
        data[6] = sum(data[:6]) % 256
    elif name == "hyundai_nibbles":
        data[7] &= 0x0F
        data[7] |= (-sum(int(digit, 16) for digit in data.hex()) % 16) << 4
    elif name == "hyundai_crc8":
        data[6] = crc(0xFD ^ 0xDF, bytes([*data[:6], data[7]]), 8, 0x1D) ^ 0xDF
    elif name == "hyundai_canfd":
        data[2] = count % 256
        value = crc(0, bytes([*data[2:], identifier % 256, identifier // 256]), 16, 0x1021) ^ 0x5F29
        data[:2] = value.to_bytes(2, "little")
    return bytes(data)


def of_other_makes(name: str, identifier: int, data: bytearray, count: int) -> bytes:
    """The frame of a make whose checksum is a sum, an exclusive or, or the CRC of SAE J1850."""
    high, low = divmod(identifier, 256)
    if name == "honda":
        data[7] = data[7] & 0xC0 | count << 4
        halves = f"{identifier:x}" + data.hex()
        data[7] |= (8 - sum(int(digit, 16) for digit in halves)) % 16
    elif name == "subaru":
        data[1] = data[1] & 0xF0 | count
        data[0] = (high + low + sum(data[1:])) % 256
    elif name == "nissan":
        data[6] = data[6] & 0xF0 | count
        data[7] = crc(0, data[:7], 8, 0x1D) ^ 0xFF
    elif name == "ford_speed":
        data[2] = data[2] & 0xC3 | count << 2
        data[3] = 255 - (data[0] + data[1] + data[2] // 64 + count) % 256
    elif name == "ford_yaw_rate":
        data[5] = count
        data[4] = 255 - (sum(data[:4]) + count + data[6] // 64 + data[6] // 16 % 4) % 256
    elif name == "volkswagen_xor":
        data[0] = data[0] & 0xF0 | count
        data[7] = 0
        for byte in data[:7]:
            data[7] ^= byte
    else:
        data[6] = data[6] & 0x0F | count << 4
        data[7] = (
            (high + low + sum(data[:7])) % 256 if name == "tesla" else crc(0xFF, data[:7], 8, 0x1D) ^ 0xFF
        )
    return bytes(data)


def autosar(name: str, data: bytearray, count: int) -> bytes:
    """The frame by autosar-e2e; profile 22 is profile 2 in its layout."""
    e2e = pytest.importorskip("e2e", reason="pip install autosar-e2e")
    assert e2e
    from e2e import p01, p02, p05, p11

    profile, data_id = name.removeprefix("autosar_"), SETTINGS[name]["data_id"]
    at, mask = (2, 0xFF) if profile == "p05" else (1, 0x0F)
    data[at] = data[at] & ~mask | count % COUNTERS[name]
    if profile == "p01":
        p01.e2e_p01_protect(data, data_id, data_id_mode=p01.E2E_P01_DATAID_BOTH, increment_counter=False)
    elif profile == "p05":
        p05.e2e_p05_protect(data, data_id, increment_counter=False)
    elif profile == "p11":
        p11.e2e_p11_protect(data, data_id, data_id_mode=p11.E2E_P11_DATAID_BOTH, increment_counter=False)
    else:
        p02.e2e_p02_protect(data, bytes(data_id), increment_counter=False)
    return bytes(data)


def log_of(names: list[str], raw: np.ndarray, first: int = 0) -> Frames:
    """One frame of each message a period; ``raw`` (FRAMES, messages): what X is."""
    random = np.random.default_rng(5)
    rows, n = [], len(names)
    for k in range(FRAMES):
        for j, name in enumerate(names):
            data = bytearray(random.integers(0, 256, 8, np.uint8).tobytes())
            at = AT.get(name, 4)
            data[at : at + 2] = int(raw[k, j]).to_bytes(2, "little", signed=True)
            rows.append(protected(name, 0x2A0 + j, data, first + k))
    t_ns = (np.repeat(np.arange(FRAMES), n) * PERIOD_S * 1e9 + np.tile(np.arange(n), FRAMES) * 1e5).astype(
        np.int64
    )
    return Frames(
        t_ns,
        np.tile(np.arange(n, dtype=np.uint32) + 0x2A0, FRAMES),
        np.zeros(n * FRAMES, np.uint8),
        np.full(n * FRAMES, 8, np.uint8),
        np.frombuffer(b"".join(rows), np.uint8).reshape(-1, 8).copy(),
        ["can0"],
    )


GROUPS = [list(SETTINGS)[:6], list(SETTINGS)[6:11], list(SETTINGS)[11:15], list(SETTINGS)[15:]]


@pytest.fixture(scope="module", params=range(len(GROUPS)))
def bus(request, tmp_path_factory):
    """Names of checksums, and the receiver of a car that uses them."""
    names = GROUPS[request.param]
    path = tmp_path_factory.mktemp("own") / "car.dbc"
    path.write_text(database(names))
    car = project(names)
    assert car.can is not None
    return names, Receiver(car.model_copy(update={"can": car.can.model_copy(update={"dbc": str(path)})}))


def test_all_checksums_are_covered():
    from lpvguard.can.protection import PROTECTIONS

    assert set(SETTINGS) == set(PROTECTIONS) == {n for group in GROUPS for n in group}


def test_right_frames_give_their_values(bus):
    names, receiver = bus
    raw = np.random.default_rng(1).integers(-32768, 32768, (FRAMES, len(names)))
    got = receiver.receive(log_of(names, raw), "log")
    order = [receiver.signals.index(s) for s in receiver.project.signals]
    for name in names:  # the last tick comes before the last frames
        assert got.report["messages"][name.upper()] == {"accepted": FRAMES - 5, "recovering": 4}
    assert np.allclose(got.values[4:, order], 0.01 * raw[4 : len(got.t)] / 2.0, atol=1e-4)


def test_spoiled_frames_are_counted_for_what_they_are(bus):
    names, receiver = bus
    log = log_of(names, np.zeros((FRAMES, len(names)), int))
    positions = {name: np.flatnonzero(log.id == 0x2A0 + j) for j, name in enumerate(names)}
    for name in names:
        log.data[positions[name][10], AT.get(name, 4)] ^= 0x20  # a payload bit
        log.data[positions[name][30]] = log.data[positions[name][29]]  # a repeated frame
        log.length[positions[name][50]] = 7
    got = receiver.receive(log, "log")
    for name in names:
        counted = got.report["messages"][name.upper()]
        assert counted["checksum"] == 1 and counted["length"] == 1, name
        assert counted.get("repeated", 0) == (1 if COUNTERS[name] else 0), name


def test_a_counter_that_jumps_is_a_wrong_sequence_and_a_lost_frame_is_lost(bus):
    names, receiver = bus
    raw = np.zeros((FRAMES, len(names)), int)
    log, later = log_of(names, raw), log_of(names, raw, first=7)
    for j in range(len(names)):
        at = np.flatnonzero(log.id == 0x2A0 + j)
        log.data[at[20]] = later.data[at[20]]
        keep = np.ones(len(log.id), bool)
        keep[at[40]] = False
        log = log.at(keep)
        later = later.at(keep)
    got = receiver.receive(log, "log").report["messages"]
    for name in names:
        if COUNTERS[name] > 8:
            assert got[name.upper()]["sequence"] >= 1, name
        if COUNTERS[name]:
            assert got[name.upper()]["lost"] >= 1, name
        else:
            assert "sequence" not in got[name.upper()] and "lost" not in got[name.upper()], name


# ------------------------------------------------------------------------------------------ layouts, refusals

OTHER = """VERSION ""
NS_ :
BS_:
BU_: CAR
BO_ 291 STEER: 8 CAR
 SG_ ANGLE : 7|13@0- (-0.1,0.5) [-400|400] "deg" CAR
 SG_ FINE : 43|9@0- (0.001,0) [0|0] "deg" CAR
 SG_ LONG : 16|20@1+ (1,0) [0|0] "" CAR
BO_ 2566844672 SPEED: 8 CAR
 SG_ V : 12|15@1+ (0.01,-10) [-10|300] "km/h" CAR
BO_ 512 MUXED: 8 CAR
 SG_ SELECT M : 0|4@1+ (1,0) [0|15] "" CAR
 SG_ YAW m2 : 8|16@1- (0.01,0) [-300|300] "deg/s" CAR
 SG_ ROLL m3 : 8|16@1- (0.01,0) [-300|300] "deg/s" CAR
BO_ 770 WIDE: 8 CAR
 SG_ ANGLE : 11|20@0- (-0.001,0.5) [-300|300] "deg" CAR
 SG_ FINE : 32|32@1- (0.00001,0) [-400|400] "deg/s" CAR
BO_ 772 WIDEST: 8 CAR
 SG_ ALL : 0|40@1+ (1,0) [0|0] "" CAR
BO_ 771 SIGNS: 8 CAR
 SG_ YAW : 0|14@1+ (0.01,0) [0|163.82] "deg/s" CAR
 SG_ YAW_SIGN : 14|1@1+ (1,0) [0|1] "" CAR
 SG_ RATE : 16|10@1+ (1,3) [0|0] "" CAR
 SG_ RATE_SIGN : 26|1@1+ (1,0) [0|1] "" CAR
BO_ 768 REAL: 8 CAR
 SG_ AY : 0|32@1- (1,0) [-20|20] "m/s2" CAR
BO_ 769 RATE: 8 CAR
 SG_ YAW : 8|16@1- (0.01,0) [-300|300] "deg/s" CAR
 SG_ ONE : 0|1@1+ (1,0) [0|1] "" CAR
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "GenMsgCycleTime" BO_ 291 10;
BA_ "GenMsgCycleTime" BO_ 2566844672 20;
BA_ "GenMsgCycleTime" BO_ 769 10;
BA_ "GenMsgCycleTime" BO_ 512 10;
BA_ "GenMsgCycleTime" BO_ 768 10;
BA_ "GenMsgCycleTime" BO_ 770 10;
BA_ "GenMsgCycleTime" BO_ 771 10;
BA_ "GenMsgCycleTime" BO_ 772 10;
BA_ "VFrameFormat" BO_ 2566844672 3;
SIG_VALTYPE_ 768 AY : 1;
"""
CAN = {
    "speed": {"message": "SPEED", "signal": "V", "factor": 3.6},
    "road_wheel_angle": {
        "message": "STEER",
        "signal": "ANGLE",
        "plus": ["FINE"],
        "factor": -57.29577951308232,
    },
    "yaw_rate": {"message": "RATE", "signal": "YAW", "factor": 57.29577951308232},
}


def other(
    folder: Path, can: dict | None = None, messages: dict | None = None, dbc: str = "other.dbc"
) -> Path:
    """A project file of the made-up car, its database beside it."""
    import tomlkit

    (folder / "other.dbc").write_text(OTHER)
    document = load_project("g80").model_dump(by_alias=True, exclude_none=True)
    document |= {"name": "other", "Ts_s": PERIOD_S, "can": {"dbc": dbc, "messages": messages or {}}}
    for signal in document["signals"]:
        signal["can"] = (CAN | (can or {}))[signal["name"]]
    path = folder / "other.toml"
    path.write_text(tomlkit.dumps(document))
    return path


def test_motorola_signed_negative_and_summed_signals_are_read(tmp_path):
    path = other(tmp_path)
    receiver, encode = Receiver(load_project(path)), cantools.database.load_string(OTHER, "dbc")
    t = PERIOD_S * np.arange(200)
    v, delta, r = 15 + np.sin(t), 0.3 * np.sin(3 * t), 0.2 * np.cos(2 * t)
    rows = []
    for k in range(200):
        bus = -np.degrees(delta[k])
        steer = {"ANGLE": np.floor(bus), "FINE": (bus - np.floor(bus)) * 0.2, "LONG": 0}
        steer["ANGLE"] = bus - steer["FINE"]
        steer["ANGLE"] = round((steer["ANGLE"] - 0.5) / -0.1) * -0.1 + 0.5
        steer["FINE"] = bus - steer["ANGLE"]
        rows.append((k, 291, encode.encode_message("STEER", steer)))
        rows.append((k, 769, encode.encode_message("RATE", {"YAW": np.degrees(r[k]), "ONE": 1})))
        if k % 2 == 0:  # another priority and sender's frame stays the same group
            rows.append((k, 0x18FEF200 | EXTENDED, encode.encode_message("SPEED", {"V": 3.6 * v[k]})))
    speed_id = encode.get_message_by_name("SPEED").frame_id | EXTENDED
    ids = [speed_id ^ 0x0C000000 if i & EXTENDED else i for _, i, _ in rows]
    n = len(rows)
    log = Frames(
        np.array([1_000_000_000 + k * 10_000_000 for k, _, _ in rows], np.int64),
        np.array(ids, np.uint32),
        np.zeros(n, np.uint8),
        np.full(n, 8, np.uint8),
        np.frombuffer(b"".join(d for _, _, d in rows), np.uint8).reshape(-1, 8),
        ["can0"],
    )
    got = receiver.receive(log, "log")
    assert set(got.report["messages"]) == {"STEER", "SPEED", "RATE"}
    at = np.flatnonzero(got.present)
    assert len(at) > 180
    held = at - at % 2
    assert np.abs(got.values[at, 0] - v[held]).max() < 0.02
    assert np.abs(got.values[at, 1] - delta[at]).max() < 2e-5
    assert np.abs(got.values[at, 2] - r[at]).max() < 1e-4
    with pytest.raises(InputError, match=r"holds no frame of SPEED \(18FEF200|STEER \(123\)"):
        receiver.receive(log.at(log.id == 7), "log") if (log.id == 7).any() else receiver.receive(
            Frames(log.t_ns, log.id * 0 + np.uint32(7), *_rest(log)), "log"
        )


PER_RAD = 57.29577951308232
LAYOUTS = {
    "more than 16 bits": {
        "road_wheel_angle": {"message": "WIDE", "signal": "ANGLE", "factor": PER_RAD},
        "yaw_rate": {"message": "WIDE", "signal": "FINE", "factor": PER_RAD},
    },
    "a sign beside the magnitude": {"yaw_rate": {"message": "SIGNS", "signal": "YAW", "factor": PER_RAD}},
    "a multiplex": {"yaw_rate": {"message": "MUXED", "signal": "YAW", "factor": PER_RAD}},
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_wide_signed_and_multiplexed_signals_come_through_the_receiver(name, tmp_path):
    receiver = Receiver(load_project(other(tmp_path, LAYOUTS[name])))
    encode = cantools.database.load_string(OTHER, "dbc", strict=False)
    speed_id = encode.get_message_by_name("SPEED").frame_id | EXTENDED
    t = PERIOD_S * np.arange(200)
    v, delta, r = 15 + np.sin(t), 0.3 * np.sin(3 * t), 0.2 * np.cos(2 * t)
    rows = []
    for k in range(200):
        angle, yaw = np.degrees(delta[k]), np.degrees(r[k])
        raw = round((angle - 0.5) / -0.001) % (1 << 20)
        # By the definition of a DBC: bit 11 is the highest of a Motorola signal of 20 bits.
        by_hand = bytes(1) + bytes([raw >> 16, raw >> 8 & 0xFF, raw & 0xFF])
        by_hand += (round(yaw / 1e-5) % (1 << 32)).to_bytes(4, "little")
        magnitude = round(abs(yaw) * 100) | (1 << 14 if yaw < 0 else 0)
        rows += [
            (k, 770, by_hand),
            (k, 771, magnitude.to_bytes(8, "little")),
            (k, 512, bytes([2]) + (round(yaw * 100) % 65536).to_bytes(2, "little") + bytes(5)),
            (k, 512, bytes([3]) + (12345).to_bytes(2, "little") + bytes(5)),
            (k, 291, encode.encode_message("STEER", {"ANGLE": round(-angle, 1), "FINE": 0, "LONG": 0})),
        ]
        if k % 2 == 0:
            rows.append((k, speed_id, encode.encode_message("SPEED", {"V": 3.6 * v[k]})))
    log = Frames(
        np.array([1_000_000_000 + k * 10_000_000 for k, _, _ in rows], np.int64),
        np.array([i for _, i, _ in rows], np.uint32),
        np.zeros(len(rows), np.uint8),
        np.full(len(rows), 8, np.uint8),
        np.frombuffer(b"".join(d for _, _, d in rows), np.uint8).reshape(-1, 8),
        ["can0"],
    )
    got = receiver.receive(log, "log")
    at = np.flatnonzero(got.present)
    assert len(at) > 180
    precise = name == "more than 16 bits"
    assert np.abs(got.values[at, 1] - delta[at]).max() < (1e-5 if precise else 2e-3)
    assert np.abs(got.values[at, 2] - r[at]).max() < (
        5e-5 if precise else 1e-4
    )  # 2^-24 of the signal's range


def _rest(log: Frames) -> tuple:
    return log.channel, log.length, log.data, log.channels


@pytest.mark.parametrize(
    ("can", "messages", "says"),
    [
        ({"yaw_rate": {"message": "RATES", "signal": "YAW"}}, {}, "message RATES: no message.*such as RATE"),
        ({"yaw_rate": {"message": "RATE", "signal": "YAWS"}}, {}, "no signal YAWS; expected one of ONE, YAW"),
        (
            {"yaw_rate": {"message": "WIDEST", "signal": "ALL"}},
            {},
            "ALL: has 40 bits; expected .* at most 32",
        ),
        (
            {"yaw_rate": {"message": "SIGNS", "signal": "RATE"}},
            {},
            "has 10 bits, an offset of 3, and its sign in RATE_SIGN; expected .* at most 15 bits without",
        ),
        ({"yaw_rate": {"message": "REAL", "signal": "AY"}}, {}, "AY: has 32 bits of a float"),
        (
            {"yaw_rate": {"message": "MUXED", "signal": "YAW"}},
            {"MUXED": {"counter": "SELECT"}},
            "YAW: is multiplexed in a message with a counter",
        ),
        (
            {"yaw_rate": {"message": "MUXED", "signal": "YAW", "plus": ["ROLL"]}},
            {},
            "YAW, ROLL: are never in the same frame",
        ),
        ({"yaw_rate": {"message": "RATE", "signal": "YAW", "factor": 0.0}}, {}, "factor must not be 0"),
        ({}, {"RATES": {"period_ms": 10}}, "can.messages: RATES named by no signal"),
        ({}, {"RATE": {"checksum": "autosar_p11"}}, "data_id: 0 given; expected one number"),
        ({}, {"RATE": {"checksum": "autosar_p02", "data_id": 3}}, "expected a list of 16"),
        ({}, {"RATE": {"checksum": "toyota", "data_id": 3}}, "data_id: 1 given; expected none"),
        ({}, {"RATE": {"data_id": 3}}, "data_id: given without checksum"),
        ({}, {"RATE": {"checksum": "hyundai_sum"}}, "hyundai_sum has no place of its own"),
        ({}, {"RATE": {"checksum": "hyundai_sum", "checksum_signal": "YAW"}}, "checksum has 16 bits"),
        ({}, {"RATE": {"checksum": "toyota", "counter": "ALIVE"}}, "no signal ALIVE"),
        ({}, {"RATE": {"checksum": "toyota", "counter": "ONE"}}, r"ONE has 1 bit"),
        ({}, {"RATE": {"checksum": "crc"}}, "can.messages.RATE.checksum"),
    ],
)
def test_what_cannot_be_is_refused_by_name(tmp_path, can, messages, says):
    with pytest.raises(InputError, match=says):
        Receiver(load_project(other(tmp_path, can, messages)))


@pytest.mark.parametrize("name", [None, *LAYOUTS])
def test_what_the_rest_of_the_bus_sends_comes_through_the_receiver(name, tmp_path):
    """Sensor values packed by the generated C, for sums, signs, wide and multiplexed signals."""
    car = load_project(other(tmp_path, LAYOUTS.get(name)))
    signals = [car.speed, *car.inputs, *car.outputs]
    sent = sensor_messages(car, own_bus(car, signals), signals)
    header, source = packing("rest", sent, len(signals))
    write_files(tmp_path, {"lpvg_rest.h": enclosed("rest", header), "lpvg_rest.c": _INCLUDES + source})
    objects = [
        native.compile_object(tmp_path / "lpvg_rest.c", flags=(), include_dirs=[library_root() / "include"])
    ]
    library = ctypes.CDLL(str(native.compile_shared(objects, flags=(), name="rest")))
    t = PERIOD_S * np.arange(200)
    columns = np.stack([15 + np.sin(t), 0.3 * np.sin(3 * t), 0.2 * np.cos(2 * t)], axis=1)
    rows, counters = [], (ctypes.c_uint16 * len(sent))()
    for k, values in enumerate(columns):
        frames = (ctypes.c_uint8 * (16 * len(sent)))()
        assert library.lpvg_rest_pack((ctypes.c_float * 3)(*values), counters, frames) == 0
        for j, m in enumerate(s.message for s in sent):
            if k % (m.ours.period_ms // 10) == 0:
                rows.append((k, m.identifier, bytes(frames)[16 * j + 5 : 16 * j + 13]))
    got = Receiver(car).receive(
        Frames(
            np.array([1_000_000_000 + k * 10_000_000 for k, _, _ in rows], np.int64),
            np.array([i for _, i, _ in rows], np.uint32),
            np.zeros(len(rows), np.uint8),
            np.full(len(rows), 8, np.uint8),
            np.frombuffer(b"".join(d for _, _, d in rows), np.uint8).reshape(-1, 8),
            ["can0"],
        ),
        "log",
    )
    at = np.flatnonzero(got.present)
    assert len(at) > 180
    tolerance = {"more than 16 bits": (1e-5, 5e-5)}  # 2^-24 of the signal's range
    angle, yaw = tolerance.get(name, (2e-5, 1e-4))
    assert np.abs(got.values[at, 0] - columns[at - at % 2, 0]).max() < 0.002
    assert np.abs(got.values[at, 1] - columns[at, 1]).max() < angle
    assert np.abs(got.values[at, 2] - columns[at, 2]).max() < yaw


_INCLUDES = '#include "lpvg_rest.h"\n#include <math.h>\n'


def test_a_loop_that_a_frame_is_too_long_for_has_the_demands_alone(tmp_path):
    (tmp_path / "car.dbc").write_text(
        database(["hyundai_canfd", "subaru", "tesla"]).replace("HYUNDAI_CANFD: 8", "HYUNDAI_CANFD: 16")
    )
    car = project(["hyundai_canfd", "subaru", "tesla"])
    place = CanPlace(message="SUBARU", signal="X", factor=2.0)
    bus = car.can.model_copy(update={"dbc": str(tmp_path / "car.dbc"), "demand": {"x_subaru": place}})
    with pytest.warns(InputWarning, match="no ECU code: message HYUNDAI_CANFD has 16 bytes"):
        files = loop_files(car.model_copy(update={"can": bus}))
    assert files.keys() == {"lpvg_demand.h", "lpvg_demand.c"}


def test_a_message_without_a_cycle_time_asks_for_one(tmp_path):
    path = other(tmp_path)
    (tmp_path / "other.dbc").write_text(OTHER.replace('BA_ "GenMsgCycleTime" BO_ 769 10;\n', ""))
    with pytest.raises(
        InputError, match=r"RATE: the database has no cycle time.*can.messages.RATE.period_ms"
    ):
        Receiver(load_project(path))


def test_a_missing_database_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nowhere.dbc.*no such file"):
        Receiver(load_project(other(tmp_path, dbc="nowhere.dbc")))


def test_sums_stand_in_the_signal_table_and_a_fitted_project_file_keeps_its_database(tmp_path):
    path = other(tmp_path)
    table_of_signals = signal_table_markdown(load_project(path))
    assert "STEER.ANGLE + STEER.FINE = -57.2958 × value" in table_of_signals
    text = path.read_text().replace("other.dbc", "databases/other.dbc")
    assert 'dbc = "other.dbc"' in with_numbers(text, "test", {"L": 2.7})


def test_a_table_is_not_played_onto_a_bus_that_is_only_read(tmp_path):
    t = PERIOD_S * np.arange(20)
    drive = Drive("drive", t, 9.0 + 0 * t, np.zeros((20, 1)), np.zeros((20, 1)))
    with pytest.raises(InputError, match="the car's own bus, which is only read"):
        values_of_drive(load_project(other(tmp_path)), drive)


# ------------------------------------------------------------------------------------------------- a real car


def test_the_rav4s_log_gives_the_samples_of_its_table(rav4):
    """Steps of the receiver against linear interpolation: within what a signal moves in two periods.

    The log's times are those of the host: frames come in bursts, and 18 ms late now and then."""
    receiver = Receiver(load_project("rav4"))
    got = receiver.receive(read_log(rav4 / "rav4_candump.log.gz"), "log")
    for name, counted in got.report["messages"].items():
        assert counted.keys() <= {"accepted", "recovering", "missed", "early"}, name
        assert counted["accepted"] > 4900 and counted["recovering"] == 4, name
        assert counted["missed"] < 350 and counted["early"] < 60, name
    assert [gap["from_s"] for gap in got.report["gaps"]] == [0.0] and got.present.sum() > 5900
    want = table(rav4 / "rav4_100hz.csv")
    n = min(len(want["t"]), len(got.t))
    for column, k, tolerance in (("v", 0, 0.3), ("sw_angle", 1, 0.01), ("r_can", 2, 0.005)):
        error = np.abs(got.values[100:n, k] - want[column][100:n])
        assert np.quantile(error, 0.99) < tolerance, column


def test_a_flipped_bit_of_the_rav4_is_found_by_its_checksum(rav4):
    log = read_log(rav4 / "rav4_candump.log.gz")
    assert isinstance(log, Frames)
    data = log.data.copy()
    for at in np.flatnonzero(log.id == 36)[100::50]:
        data[at, 1] ^= 1
    spoiled = Frames(log.t_ns, log.id, log.channel, log.length, data, log.channels)
    got = Receiver(load_project("rav4")).receive(spoiled, "log").report["messages"]
    assert got["KINEMATICS"]["checksum"] > 90 and "checksum" not in got["STEER_ANGLE_SENSOR"]


@pytest.fixture(scope="module")
def rav4_replayer(tmp_path_factory) -> Replayer:
    """The RAV4 with bounds by hand, for a minute is too little to identify from."""
    car, folder = load_project("rav4"), tmp_path_factory.mktemp("core") / "rav4"
    folder.mkdir()
    write_files(folder, vehicle(car, NominalModel(car), size=0.5))
    return Replayer(car, Core(folder), energy_threshold=1.5, change_threshold=1e6)


def as_table(log: Frames, rav4: Path, folder: Path) -> Path:
    """The log as cantools decodes it, at 100 Hz."""
    write_candump(log, folder / "rav4.log")
    car = load_project("rav4")
    assert car.can is not None
    dbc = rav4 / "toyota_rav4_excerpt.dbc"
    ingest([folder / "rav4.log"], dbc=dbc, signals_map=map_of_project(car), out=folder / "tables")
    return folder / "tables/rav4.csv"


def with_yaw_offset(log: Frames, steps: int, from_s: float) -> Frames:
    """The log with ``steps`` more in the raw yaw rate from a time on, its checksum right again."""
    data = log.data.copy()
    for at in np.flatnonzero((log.id == 36) & (log.t_ns > log.t_ns[0] + from_s * 1e9)):
        raw = ((int(data[at, 0]) & 3) << 8 | int(data[at, 1])) + steps
        data[at, 0], data[at, 1] = data[at, 0] & 0xFC | raw >> 8, raw & 0xFF
        data[at, 7] = (36 + 8 + int(data[at, :7].sum())) % 256
    return Frames(log.t_ns, log.id, log.channel, log.length, data, log.channels)


@pytest.mark.slow("10 s: compiles the core")
@pytest.mark.parametrize("steps", [0, 8])
def test_the_rav4s_log_has_the_verdicts_of_its_table(rav4, rav4_replayer, tmp_path, steps):
    log = read_log(rav4 / "rav4_candump.log.gz")
    assert isinstance(log, Frames)
    log = with_yaw_offset(log, steps, 20.0)
    path = rav4 / "rav4_100hz.csv" if steps == 0 else as_table(log, rav4, tmp_path)
    table, raw = rav4_replayer.replay_file(path), rav4_replayer.replay_frames(log, path)
    verdicts = [[v for v, _ in groupby(r.run.verdict.tolist())] for r in (table, raw)]
    assert verdicts[0] == verdicts[1], "the same verdicts in the same order"
    assert (VERDICTS.index("invalid") in verdicts[0]) == bool(steps)
    if steps:
        assert raw.first_invalid_s == pytest.approx(table.first_invalid_s, abs=0.1)
        assert 20.0 <= raw.first_invalid_s < 21.0
    assert {(a.test, a.bin_rad_s) for a in table.alarms} == {(a.test, a.bin_rad_s) for a in raw.alarms}
    assert bool(raw.alarms) == bool(steps)
    n = min(len(table.run.verdict), len(raw.run.verdict))
    assert (table.run.verdict[:n] == raw.run.verdict[:n]).mean() > 0.99
    assert raw.judged_s == pytest.approx(table.judged_s, abs=0.5)


def test_ingest_takes_database_and_map_from_the_vehicle(rav4, lpvguard, tmp_path):
    log = rav4 / "rav4_candump.log.gz"
    done = lpvguard("ingest", log, "--vehicle", "rav4", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    got, want = table(tmp_path / "out/rav4_candump.csv"), table(rav4 / "rav4_100hz.csv")
    n = min(len(want["t"]), len(got["t"]))
    for column, tolerance in (("v", 2e-5), ("sw_angle", 6e-6), ("r_can", 1e-5)):
        assert np.abs(got[column][:n] - want[column][:n]).max() < tolerance, column
    car = load_project("rav4")
    assert car.can is not None
    twice = ingest([log], dbc=Path(car.can.dbc), signals_map=map_of_project(car), out=tmp_path / "again")
    assert twice["rav4_candump"]["drives"][0]["rows"] == len(got["t"])


@pytest.mark.parametrize("name", sorted(SETTINGS))
def test_demands_are_packed_with_the_named_checksum_and_counter(name, tmp_path):
    """Frames from the generated C, against the checksum's own definition."""
    others = [other for other in ("subaru", "hyundai_sum", "volkswagen_xor") if other != name][:2]
    names = [others[0], name, others[1]]
    (tmp_path / "car.dbc").write_text(database(names))
    car = project(names)
    place = CanPlace(message=name.upper(), signal="X", factor=2.0)
    bus = car.can.model_copy(update={"dbc": str(tmp_path / "car.dbc"), "demand": {f"x_{name}": place}})
    demands = demand_messages(car.model_copy(update={"can": bus}))
    write_files(tmp_path, demand_files(demands, 1))
    objects = [
        native.compile_object(tmp_path / "lpvg_demand.c", flags=(), include_dirs=[library_root() / "include"])
    ]
    library = ctypes.CDLL(str(native.compile_shared(objects, flags=(), name=f"demand_{name}")))
    frame = (ctypes.c_uint8 * 16)()
    counter, u = ctypes.c_uint16(0), (ctypes.c_float * 1)()
    identifier = 0x2A0 + 1
    for k, value in enumerate((0.0, 1.5, -1.5, 200.0, -200.0, 0.003), 1):
        u[0] = value
        assert library.lpvg_demand_pack(u, ctypes.byref(counter), frame) == 0
        data = bytes(frame)[5:13]
        first = AT.get(name, 4)
        raw = int.from_bytes(data[first : first + 2], "little", signed=True)
        assert raw == np.clip(np.floor(200.0 * value + 0.5), -32768, 32767)
        assert int.from_bytes(bytes(frame)[:4], "little") == identifier and frame[4] == 8
        count = k % COUNTERS[name] if COUNTERS[name] else 0
        assert counter.value == count
        wanted = protected(name, identifier, bytearray(data), count)
        assert data == wanted
    u[0] = np.nan
    before = bytes(frame)
    assert library.lpvg_demand_pack(u, ctypes.byref(counter), frame) != 0 and bytes(frame) == before
