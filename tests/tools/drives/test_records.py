"""Records of the compiled evidence ring as drives: the same samples, and every damaged one is refused."""

import ctypes
import struct
import zlib

import numpy as np
import pytest

from lpvguard.base import native
from lpvguard.base.errors import InputError
from lpvguard.core.compiled import library_root
from lpvguard.drives.records import read_record
from lpvguard.drives.tables import read_drive

SCALE = (2e-3, 2e-5, 1e-4)
"""Speed, steering angle and yaw rate of the g80."""
HEADER = "<4s6I4Bfq8f"


class Config(ctypes.Structure):
    """lpvg_evidence_config_t."""

    _fields_ = (
        ("buffer", ctypes.POINTER(ctypes.c_int16)),
        *((name, ctypes.c_uint32) for name in ("samples", "after", "period_us", "coefficients")),
        ("near_ratio", ctypes.c_float),
        ("scale", ctypes.c_float * 8),
        *((name, ctypes.c_uint8) for name in ("channels", "inputs", "slots")),
    )


@pytest.fixture(scope="session")
def ring():
    """The compiled evidence ring."""
    root = library_root()
    include = [root / "include", root / "src"]
    flags = ("-std=c++17", "-O2", "-fno-exceptions", "-fno-rtti", *(f"-I{p}" for p in include))
    source = root / "src/services/evidence.cpp"
    return ctypes.CDLL(
        str(native.compile_shared([source], flags=flags, include_dirs=include, name="evidence"))
    )


def recorded(ring, values: np.ndarray, event: int, *, samples: int, after: int) -> bytes:
    """Bytes of the record of an alarm at a sample."""
    buffer = (ctypes.c_int16 * (2 * samples * values.shape[1]))()
    config = Config(buffer, samples, after, 20_000, 0xC0FFEE, 0.5, (ctypes.c_float * 8)(*SCALE), 3, 1, 2)
    state = ctypes.create_string_buffer(4096)
    assert ring.lpvg_evidence_init(state, ctypes.byref(config)) == 0
    for k, row in enumerate(values.astype(np.float32)):
        level, ratio = (3, 1.75) if k >= event else (0, 0.25)
        sample = (ctypes.c_float * len(row))(*row)
        time = ctypes.c_int64(20_000 * k)
        assert ring.lpvg_evidence_take(state, time, sample, level, ctypes.c_float(ratio)) == 0
    reader, data = ctypes.create_string_buffer(64), ctypes.create_string_buffer(100_000)
    assert ring.lpvg_evidence_open(reader, state, ring.lpvg_evidence_number(state, 0)) == 0
    ring.lpvg_evidence_read.restype = ctypes.c_size_t
    n = ring.lpvg_evidence_read(reader, data, ctypes.c_size_t(len(data)))
    return data.raw[:n]


@pytest.fixture(scope="session")
def record(ring):
    """The driven values (2000, 3), and the bytes of a record of 500 of them; two have no number."""
    t = 0.02 * np.arange(2000)
    values = np.column_stack([10 + np.sin(t), 0.02 * np.sin(2 * t), 0.1 * np.cos(t)])
    values[1000, 2], values[1001, 0] = np.nan, np.nan
    return values, recorded(ring, values, 1200, samples=500, after=200)


def test_a_record_has_the_samples_around_the_event(record, g80, tmp_path):
    values, data = record
    path = tmp_path / "rec.lpve"
    path.write_bytes(data)
    contents = read_record(path)
    assert (contents.number, contents.coefficients, contents.level, contents.ratio) == (
        1,
        0xC0FFEE,
        "invalid",
        1.75,
    )
    assert (contents.before, contents.t_us, contents.inputs) == (300, 1200 * 20_000, 1)
    expected = values[901:1401]
    assert (np.nan_to_num(abs(contents.values - expected)) <= 0.51 * np.array(SCALE) + 1e-6).all()
    assert np.array_equal(np.isnan(contents.values), np.isnan(expected))
    drive = read_drive(path, g80)
    assert (drive.name, len(drive.t), drive.missing_samples) == ("rec", 500, 2)
    np.testing.assert_allclose(np.diff(drive.t), 0.02, atol=1e-9)
    np.testing.assert_allclose(drive.y[:50, 0], expected[:50, 2], atol=1e-4)


def test_every_flipped_bit_and_every_cut_is_refused(record, tmp_path):
    _, data = record
    path = tmp_path / "rec.lpve"
    for k in range(0, 8 * len(data), 97):
        flipped = bytearray(data)
        flipped[k // 8] ^= 1 << (k % 8)
        path.write_bytes(flipped)
        with pytest.raises(InputError, match=r"rec\.lpve"):
            read_record(path)
    for n in (*range(90), len(data) - 1):
        path.write_bytes(data[:n])
        with pytest.raises(InputError, match=r"rec\.lpve"):
            read_record(path)


@pytest.mark.parametrize(
    ("at", "kind", "value", "message"),
    [
        (4, "I", 2, "schema 2, 3 channels"),
        (20, "I", 499, "499 samples"),
        (28, "B", 4, "header"),
        (29, "B", 2, "2 channels"),
        (30, "B", 2, "2 inputs, 0 outputs, 20000 us a sample; expected 1 inputs, 1 outputs, 20000 us"),
        (16, "I", 10_000, "10000 us a sample; expected"),
    ],
)
def test_another_header_is_refused_by_what_is_wrong(record, g80, tmp_path, at, kind, value, message):
    data = bytearray(record[1])
    struct.pack_into(f"<{kind}", data, at, value)
    data[-4:] = zlib.crc32(data[:-4]).to_bytes(4, "little")
    (tmp_path / "rec.lpve").write_bytes(data)
    with pytest.raises(InputError, match=message):
        read_drive(tmp_path / "rec.lpve", g80)


def test_replay_reads_a_record(lpvguard, vehicle, record, tmp_path):
    (tmp_path / "rec.lpve").write_bytes(record[1])
    words = ("replay", "--vehicle", "g80", "--coefficients", vehicle, "--json", tmp_path / "r")
    done = lpvguard(*words, tmp_path / "rec.lpve")
    assert done.returncode in (0, 1), done.stderr
    assert '"run": "rec"' in (tmp_path / "r").read_text()
