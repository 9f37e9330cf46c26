"""The generated C codec and our DBC against cantools, canmatrix and autosar-e2e; the facts of SAE J1939-71
and E2E profile 11.

The compiled codec runs through ctypes on whole arrays: a small C loop around each function comes with it, so
that all raw values and a million frames take seconds. The same sources run on a big-endian processor when one
can be emulated.
"""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from compiled_codec import (
    CATALOGUE,
    GENERATED,
    Frame,
    check_codes,
    check_every_raw_value,
    check_frames,
    check_refusals,
    check_rounding,
    compiled,
    database,
    decode,
    encode,
    physical_values,
    written,
)
from lpvguard.base.errors import InputError
from lpvguard.can.catalogue import load_catalogue
from lpvguard.can.codegen import SOURCE, codec_files
from lpvguard.can.dbc import dbc_text
from made import ROOT
from parts import require

SIGNALS = [pytest.param(m, s, id=f"{m.name}.{s.name}") for m in GENERATED for s in m.signals]
FRAMES = 1_000_000


@pytest.fixture(scope="session")
def codec(tmp_path_factory):
    return compiled(tmp_path_factory.mktemp("codec"))


# -------------------------------------------------------------------------------------------- every raw value


@pytest.mark.parametrize("m, s", SIGNALS)
def test_every_raw_value_decodes_as_cantools_says_and_comes_back(m, s, codec):
    check_every_raw_value(codec, m, s)
    reference = database().get_message_by_name(m.name).get_signal_by_name(s.name)
    back = [reference.conversion.scaled_to_raw(float(v)) for v in physical_values(m.name, s.name)]
    assert back == list(range(1 << s.length)), "cantools itself comes back"


@pytest.mark.parametrize("m, s", SIGNALS)
def test_codes_above_the_data_decode_as_absent_error_or_reserved(m, s, codec):
    check_codes(codec, m, s)


@pytest.mark.parametrize("m, s", SIGNALS)
def test_encode_saturates_and_rounds(m, s, codec):
    check_rounding(codec, m, s)


# --------------------------------------------------------------------------------------------------- frames


@pytest.mark.long("7 s: a million frames")
def test_a_million_random_frames_unpack_and_pack(codec):
    for m in GENERATED:
        check_frames(codec, m, -(-FRAMES // len(GENERATED)))


@pytest.mark.parametrize("m", GENERATED, ids=lambda m: m.name)
def test_what_is_missing_or_too_short_is_refused_and_a_packed_frame_is_whole(m, codec):
    check_refusals(codec, m)


# -------------------------------------------------------------------------------------------------------- E2E


def _protect(codec, data: bytes, data_id: int, counter: int) -> bytes:
    frame = Frame(0, len(data), (ctypes.c_uint8 * 8)(*data), 0)
    step = ctypes.c_uint8(counter)
    assert codec.lpvg_can_e2e_protect(ctypes.byref(frame), ctypes.c_uint16(data_id), ctypes.byref(step)) == 0
    assert step.value == (counter + 1) % 15
    return bytes(frame.data)[: len(data)]


def test_e2e_vector_of_the_specification(codec):
    assert _protect(codec, bytes(8), 0x0123, 0)[0] == 0xCC


def test_protection_of_the_codec_equals_autosar_e2e(codec):
    p11 = pytest.importorskip("e2e.p11", reason="pip install autosar-e2e")
    rng = np.random.default_rng(11)
    for _ in range(5000):
        length, data_id, counter = (
            int(rng.integers(2, 9)),
            int(rng.integers(0, 1 << 16)),
            int(rng.integers(0, 15)),
        )
        ours = _protect(codec, rng.bytes(length), data_id, counter)
        theirs = bytearray(ours)
        theirs[0] = 0
        p11.e2e_p11_protect(theirs, data_id, data_id_mode=p11.E2E_P11_DATAID_BOTH, increment_counter=False)
        assert bytes(theirs) == ours
        assert p11.e2e_p11_check(bytearray(ours), data_id, data_id_mode=p11.E2E_P11_DATAID_BOTH)


# ------------------------------------------------------------------------------------- DBC and facts of J1939


def test_dbc_opens_in_canmatrix_as_j1939():
    formats = pytest.importorskip("canmatrix.formats", reason="pip install canmatrix")
    matrix = formats.loads_flat(dbc_text(), "dbc")
    assert {(f.name, f.pgn, f.cycle_time, f.is_j1939) for f in matrix.frames} == {
        (m.name, m.pgn, m.period_ms, True) for m in CATALOGUE.messages
    }
    assert {
        (f.name, s.name, s.start_bit, s.size, float(s.factor), float(s.offset))
        for f in matrix.frames
        for s in f.signals
        if not s.name.startswith("e2e_")
    } == {
        (m.name, s.name, s.start, s.length, s.scale, s.offset) for m in CATALOGUE.messages for s in m.signals
    }


def test_dbc_in_cantools_carries_group_spn_and_cycle():
    for m in CATALOGUE.messages:
        reference = database().get_message_by_name(m.name)
        assert (reference.frame_id, reference.is_extended_frame, reference.length) == (m.id, True, 8)
        assert (reference.protocol, reference.cycle_time) == ("j1939", m.period_ms)
        assert reference.dbc.attributes["PGN"].value == m.pgn
        for s in m.signals:
            assert reference.get_signal_by_name(s.name).spn == s.spn or s.spn is None


def test_the_command_writes_the_dbc(lpvguard, tmp_path):
    assert lpvguard("dbc").stdout == dbc_text()
    assert lpvguard("dbc", "-o", tmp_path / "our.dbc").returncode == 0
    assert (tmp_path / "our.dbc").read_text() == dbc_text()


# message, signal, PGN, id, period [ms], SPN, first bit, bits, scale, offset: SAE J1939-71, written a second
# time on purpose
FACTS = [
    ("VDC2", "steering_wheel_angle", 61449, 0x18F0093E, 10, 1807, 0, 16, 1 / 1024, -31.374),
    ("VDC2", "yaw_rate", 61449, 0x18F0093E, 10, 1808, 24, 16, 1 / 8192, -3.92),
    ("VDC2", "lateral_acceleration", 61449, 0x18F0093E, 10, 1809, 40, 16, 1 / 2048, -15.687),
    ("VDC2", "longitudinal_acceleration", 61449, 0x18F0093E, 10, 1810, 56, 8, 0.1, -12.5),
    ("EBC2", "front_axle_speed", 65215, 0x18FEBF0B, 100, 904, 0, 16, 1 / 256, 0),
    *[
        ("EBC2", name, 65215, 0x18FEBF0B, 100, 905 + i, 16 + 8 * i, 8, 1 / 16, -7.8125)
        for i, name in enumerate(
            f"relative_speed_{axle}_{side}"
            for axle in ("front", "rear1", "rear2")
            for side in ("left", "right")
        )
    ],
    ("CCVS1", "wheel_based_speed", 65265, 0x18FEF100, 100, 84, 8, 16, 1 / 256, 0),
    *[
        ("EBC3", name, 65197, 0x18FEAD0B, 100, 1091 + i, 8 * i, 8, 5, 0)
        for i, name in enumerate(
            f"pressure_{axle}_{side}"
            for axle in ("front", "rear1", "rear2", "rear3")
            for side in ("left", "right")
        )
    ],
    ("EBC1", "abs_active", 61441, 0x18F0010B, 100, 563, 4, 2, 1, 0),
    ("EBC1", "brake_pedal_position", 61441, 0x18F0010B, 100, 521, 8, 8, 0.4, 0),
]


@pytest.mark.parametrize("fact", FACTS, ids=lambda f: f"{f[0]}.{f[1]}")
def test_the_catalogues_messages_have_the_numbers_of_j1939(fact):
    m = CATALOGUE.message(fact[0])
    s = next(s for s in m.signals if s.name == fact[1])
    assert (m.name, s.name, m.pgn, m.id, m.period_ms, s.spn, s.start, s.length, s.scale, s.offset) == fact
    assert m.e2e is None, "standard messages carry neither counter nor checksum"


def test_zero_yaw_rate_is_not_on_the_grid(codec):
    m = CATALOGUE.message("VDC2")
    s = next(s for s in m.signals if s.name == "yaw_rate")
    raw = encode(codec, m, s, np.zeros(1))
    assert raw[0] == 32113 and math.isclose(decode(codec, m, s, raw)[0][0], 4.4e-5, rel_tol=0.02)


def test_dm1_of_the_core_reads_as_the_dbc_says(codec):
    class Dtc(ctypes.Structure):
        _fields_ = [("spn", ctypes.c_uint32), ("fmi", ctypes.c_uint8), ("occurrence", ctypes.c_uint8)]

    frame, dtc = Frame(), Dtc(0x51234, 19, 5)
    assert (
        codec.lpvg_can_dm1_pack(
            ctypes.byref(frame),
            ctypes.c_uint8(CATALOGUE.own_address),
            ctypes.c_uint8(0x14),
            ctypes.byref(dtc),
        )
        == 0
    )
    assert frame.id & 0x1FFFFFFF == CATALOGUE.message("DM1").id
    got = database().get_message_by_name("DM1").decode(bytes(frame.data), decode_choices=False)
    assert got == {
        "protect_lamp": 0,
        "amber_warning_lamp": 1,
        "red_stop_lamp": 1,
        "malfunction_indicator_lamp": 0,
        "spn_low": 0x1234,
        "spn_high": 5,
        "fmi": 19,
        "occurrence_count": 5,
        "conversion_method": 0,
    }


# -------------------------------------------------------------------------------------------------- generator


def test_generated_text_depends_on_the_catalogue_alone():
    assert codec_files() == codec_files(load_catalogue()) and dbc_text() == dbc_text(load_catalogue())


@pytest.mark.parametrize(
    "old, new, what",
    [
        ("id = 0x18F0093E", "id = 0x18F0083E", "does not carry PGN"),
        ("start = 24\nlength = 16", "start = 8\nlength = 16", "overlaps"),
        ("length = 16", "length = 12", "J1939 codes exist"),
        ("address = 0x3E", "address = 0x3F", "no node has the source address"),
        ('name = "LPVGUARD"', 'name = "OTHER"', "must be called LPVGUARD"),
        ("data_id = 0x4C02", "data_id = 0x4C01", "must be unique"),
        (
            "start = 16\nlength = 16\nscale = 0.00048828125",
            "start = 8\nlength = 16\nscale = 0.00048828125",
            "E2E header",
        ),
        ("schema = 1", "schema = 2", "1"),
        ("min = -15.0", "min = -40.0", "supervise must lie within"),
        ("[[nodes]]", "[[", "TOML"),
    ],
    ids=range(10),
)
def test_a_spoilt_catalogue_is_refused_by_name(old, new, what, tmp_path):
    text = (ROOT / "tools/src/lpvguard/can/catalogue.toml").read_text()
    assert old in text
    path = tmp_path / "catalogue.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=what) as error:
        load_catalogue(path)
    assert str(path) in str(error.value)


# ------------------------------------------------------------------------------------------------- big-endian


@pytest.mark.slow("2 s: a codec for another processor")
def test_codec_on_a_big_endian_processor(codec, tmp_path):
    require("powerpc")
    compiler, emulator = shutil.which("powerpc-linux-gnu-gcc"), shutil.which("qemu-ppc")
    written(tmp_path)
    blocks = []
    for m in GENERATED:
        columns = "".join(
            f"    for (i = 0; i < N; ++i) {{ one[i] = raw[{len(m.signals)} * i + {k}]; }}\n"
            f"    loop_{m.name}_{s.name}_decode(one, N, x, q);\n"
            f'    for (i = 0; i < N; ++i) {{ memcpy(&bits, &x[i], 4); printf("%u %d %08x\\n", one[i], q[i], '
            f"q[i] == 1 ? (unsigned)bits : 0u); }}\n"
            for k, s in enumerate(m.signals)
        )
        blocks.append(
            f"    loop_{m.name}_unpack(data, N, raw);\n    loop_{m.name}_pack(raw, N, back);\n"
            '    for (i = 0; i < 8 * N; ++i) { printf("%02x", back[i]); }\n    puts("");\n' + columns
        )
    (tmp_path / "main.c").write_text(
        '#include "loops.c"\n#include <stdio.h>\nenum { N = 500 };\n'
        "static uint8_t data[8 * N], back[8 * N]; "
        "static uint16_t raw[8 * N], one[N]; static float x[N]; static int q[N];\n"
        "int main(void) { long i; uint32_t bits, r = 1u;\n"
        "    for (i = 0; i < 8 * N; ++i) { r = r * 1664525u + 1013904223u; data[i] = (uint8_t)(r >> 24); }\n"
        + "".join(blocks)
        + "    return 0;\n}\n"
    )

    def output(cc: str, *run: str) -> str:
        elf, flags = tmp_path / f"{Path(cc).name}.elf", ["-std=c99", "-O2", "-ffp-contract=off", "-static"]
        include = ["-I", ROOT / "lib/include"]
        subprocess.run([cc, *flags, *include, "main.c", SOURCE, "-o", elf], cwd=tmp_path, check=True)
        return subprocess.run([*run, elf], capture_output=True, text=True, check=True).stdout

    big, little = output(compiler, emulator), output(shutil.which("cc"))
    assert big == little and len(big) > 100_000
