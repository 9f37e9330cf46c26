"""The generated C codec as a shared library, and what it has to do, held against cantools.

Every check takes a library, so that the tests ask it of the codec (tests/tools/can) and of its mutants
(tests/gates/test_codec_mutants.py). A C loop around each function comes with the library: all raw values and
a million frames take seconds.
"""

import ctypes
import subprocess
from functools import cache
from pathlib import Path

import cantools
import numpy as np

from lpvguard.can.catalogue import BusSignal, Catalogue, Message, load_catalogue
from lpvguard.can.codegen import HEADER, SOURCE, codec_files
from lpvguard.can.dbc import dbc_text
from lpvguard.can.logs import EXTENDED
from made import ROOT

CATALOGUE = load_catalogue()
GENERATED = [m for m in CATALOGUE.messages if m.codec == "generated"]
STRICT = ["-std=c99", "-pedantic", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror"]
OK, BAD_ARGUMENT, BAD_SAMPLE = 0, 1, 9
TOP = {2: (1, 2, 3), 4: (0xD, 0xE, 0xF), 8: (0xFA, 0xFE, 0xFF), 16: (0xFAFF, 0xFE00, 0xFF00)}
"""By a signal's bits: the largest raw value that is data, the least of an error, the least of what is absent
(SAE J1939-71, table 1)."""


class Frame(ctypes.Structure):
    """lpvg_can_frame_t."""

    _fields_ = [
        ("id", ctypes.c_uint32),
        ("dlc", ctypes.c_uint8),
        ("data", ctypes.c_uint8 * 8),
        ("t_us", ctypes.c_int64),
    ]


@cache
def database() -> cantools.database.Database:
    """The project's DBC as cantools reads it."""
    return cantools.database.load_string(dbc_text(), "dbc")


def loops(catalogue: Catalogue) -> str:
    """C loops around every function of the codec, so that Python calls once per array."""
    parts = [f'#include "{HEADER}"\n#include <string.h>\n']
    for m in (m for m in catalogue.messages if m.codec == "generated"):
        name = f"lpvg_can_{m.name.lower()}"
        parts.append(
            f"void loop_{m.name}_unpack(const uint8_t* data, long n, uint16_t* raw) {{\n"
            f"  for (long i = 0; i < n; ++i) {{ lpvg_can_frame_t f; {name}_t s; "
            f"f.dlc = 8u; f.id = 0u; f.t_us = 0;\n"
            f"    memcpy(f.data, data + 8 * i, 8u); "
            f"if ({name}_unpack(&s, &f) != lpvg_status_ok) {{ return; }}\n"
        )
        parts += [f"    raw[{len(m.signals)} * i + {k}] = s.{s.name};\n" for k, s in enumerate(m.signals)]
        parts.append(
            f"  }}\n}}\nvoid loop_{m.name}_pack(const uint16_t* raw, long n, uint8_t* data) {{\n"
            f"  for (long i = 0; i < n; ++i) {{ lpvg_can_frame_t f; {name}_t s; memset(&f, 0x3C, sizeof f);\n"
        )
        for k, s in enumerate(m.signals):
            parts.append(f"    s.{s.name} = raw[{len(m.signals)} * i + {k}];\n")
        parts.append(
            f"    if ({name}_pack(&s, &f) != lpvg_status_ok) {{ return; }} "
            f"memcpy(data + 8 * i, f.data, 8u);\n  }}\n}}\n"
        )
        for s in m.signals:
            parts.append(
                f"void loop_{m.name}_{s.name}_encode(const float* x, long n, uint16_t* raw) {{\n"
                f"  for (long i = 0; i < n; ++i) {{ "
                f"raw[i] = lpvg_can_encode(&{name}_{s.name}, x[i]); }}\n}}\n"
                f"void loop_{m.name}_{s.name}_decode(const uint16_t* raw, long n, float* x, int* q) {{\n"
                f"  for (long i = 0; i < n; ++i) {{ "
                f"q[i] = (int)lpvg_can_decode(&{name}_{s.name}, raw[i], x + i); }}\n}}\n"
            )
    return "".join(parts)


def written(folder: Path) -> None:
    """The generated sources and the loops around them, into ``folder``."""
    for name, text in codec_files().items():
        (folder / name).write_text(text)
    (folder / "loops.c").write_text(loops(CATALOGUE))


def compiled(folder: Path) -> ctypes.CDLL:
    """The generated codec and the core's can.cpp as one shared library, compiled as strictly as the project
    is."""
    written(folder)
    include = ["-I", str(ROOT / "lib/include"), "-I", str(folder)]
    # Contraction off, as everywhere where bits are compared.
    c = ["cc", *STRICT, "-ffp-contract=off", "-fPIC", *include, "-c", SOURCE, "loops.c"]
    subprocess.run(c, cwd=folder, check=True)
    cpp = ["c++", "-std=c++17", "-O2", "-fPIC", "-shared", *include, str(ROOT / "lib/src/guard/can.cpp")]
    objects = ["lpvg_can_codec.o", "loops.o", "-o", "codec.so"]
    subprocess.run([*cpp, *objects], cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "codec.so"))


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def decode(codec: ctypes.CDLL, m: Message, s: BusSignal, raw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Physical values and qualities (n,) of raw values (n,)."""
    raw = np.ascontiguousarray(raw, np.uint16)
    x, q = np.zeros(len(raw), np.float32), np.empty(len(raw), np.int32)
    getattr(codec, f"loop_{m.name}_{s.name}_decode")(
        pointer(raw), ctypes.c_long(len(raw)), pointer(x), pointer(q)
    )
    return x, q


def encode(codec: ctypes.CDLL, m: Message, s: BusSignal, x: np.ndarray) -> np.ndarray:
    """Raw values (n,) of physical values (n,)."""
    x = np.ascontiguousarray(x, np.float32)
    raw = np.empty(len(x), np.uint16)
    getattr(codec, f"loop_{m.name}_{s.name}_encode")(pointer(x), ctypes.c_long(len(x)), pointer(raw))
    return raw


@cache
def physical_values(message: str, signal: str) -> np.ndarray:
    """What cantools reads in every raw value of a signal (2^bits,)."""
    reference = database().get_message_by_name(message).get_signal_by_name(signal)
    raw = range(1 << reference.length)
    return np.array([reference.conversion.raw_to_scaled(r, decode_choices=False) for r in raw])


def check_every_raw_value(codec: ctypes.CDLL, m: Message, s: BusSignal) -> None:
    """Every raw value decodes as cantools says, and comes back."""
    raw = np.arange(1 << s.length)
    x, q = decode(codec, m, s, raw)
    good = raw <= s.raw_max
    want = physical_values(m.name, s.name)
    # float32: half a unit in the last place of each of the three rounded quantities, at the largest magnitude
    # involved
    tolerance = 2.0**-23 * max(abs(s.offset), abs(s.physical_max)) * 2
    assert np.abs(x[good] - want[good]).max() <= tolerance
    assert np.isnan(x[~good]).all()
    assert (q[good] == 1).all()
    assert np.array_equal(encode(codec, m, s, x[good]), raw[good])
    assert np.array_equal(encode(codec, m, s, want[good]), raw[good])


def check_codes(codec: ctypes.CDLL, m: Message, s: BusSignal) -> None:
    """Codes above the data decode as absent, error or reserved."""
    raw = np.arange(1 << s.length)
    _, q = decode(codec, m, s, raw)
    data, error, absent = TOP[s.length]
    assert np.array_equal(q, np.select([raw <= data, raw >= absent, raw >= error], [1, 0, 2], 3))


def check_rounding(codec: ctypes.CDLL, m: Message, s: BusSignal) -> None:
    """Encoding saturates, and rounds to the nearest, upwards from the middle."""
    far = np.array([-np.inf, -1e30, s.physical_min - s.scale, np.inf, 1e30, s.physical_max + s.scale, np.nan])
    assert encode(codec, m, s, far).tolist() == [0, 0, 0, *[s.raw_max] * 3, (1 << s.length) - 1]
    steps = np.random.default_rng(1).uniform(0, s.raw_max, 100_000)
    x = np.float32(s.offset + s.scale * steps)
    exact = (x.astype(float) - s.offset) / s.scale
    # Nearer to a tie than float32 resolves, either neighbour is right.
    decided = np.abs(exact % 1 - 0.5) > 0.02
    assert decided.mean() > 0.9
    assert np.array_equal(encode(codec, m, s, x)[decided], np.rint(exact[decided]).astype(np.uint16))
    if s.offset == 0 and np.log2(s.scale) % 1 == 0:  # the middle has no rounding
        below = np.arange(s.raw_max)
        assert np.array_equal(encode(codec, m, s, s.scale * (below + 0.5)), below + 1)


def used_bits(m: Message) -> np.ndarray:
    """Bits (8,) bytes of a frame that signals lie in."""
    used = np.zeros(64, bool)
    for s in m.signals:
        used[s.start : s.start + s.length] = True
    return np.packbits(used, bitorder="little")


@cache
def random_frames(message: str, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Frames (n, 8) of any bytes, and the raw values (n, n_signals) that cantools reads in each."""
    data = np.random.default_rng(20261121).integers(0, 256, (n, 8), np.uint8)
    order = [s.name for s in CATALOGUE.message(message).signals]
    reference, whole = database().get_message_by_name(message), data.tobytes()
    raw = [
        [decoded[name] for name in order]
        for i in range(n)
        for decoded in [reference.decode(whole[8 * i : 8 * i + 8], decode_choices=False, scaling=False)]
    ]
    return data, np.array(raw, np.uint16)


def check_frames(codec: ctypes.CDLL, m: Message, n: int) -> None:
    """Random frames unpack as cantools says, and what was unpacked packs to the same bits, the others 1."""
    data, want = random_frames(m.name, n)
    raw = np.empty((n, len(m.signals)), np.uint16)
    getattr(codec, f"loop_{m.name}_unpack")(pointer(data), ctypes.c_long(n), pointer(raw))
    assert np.array_equal(raw, want)
    back = np.zeros_like(data)
    getattr(codec, f"loop_{m.name}_pack")(pointer(raw), ctypes.c_long(n), pointer(back))
    used = used_bits(m)
    assert np.array_equal(back & used, data & used)
    unused = ~used if m.e2e is None else ~used & np.array([0, 0xF0, *[255] * 6], np.uint8)
    assert ((back & unused) == unused).all(), "unused bits are sent as 1"
    if m.e2e:
        assert (back[:, 0] == 0).all() and (back[:, 1] & 0x0F == 0).all(), "the E2E header is still empty"


def check_refusals(codec: ctypes.CDLL, m: Message) -> None:
    """Without a message or a frame, and of a frame too short, nothing is read or written; a frame that was
    packed has the message's identifier and length."""
    pack = getattr(codec, f"lpvg_can_{m.name.lower()}_pack")
    unpack = getattr(codec, f"lpvg_can_{m.name.lower()}_unpack")
    message = ctypes.create_string_buffer(b"\x5a" * 64, 64)
    before = message.raw
    frame = Frame(0, 7, (ctypes.c_uint8 * 8)(*[0xA5] * 8), 77)
    assert unpack(message, ctypes.byref(frame)) == BAD_SAMPLE
    frame.dlc = 8
    untouched = bytes(frame)
    assert unpack(None, ctypes.byref(frame)) == BAD_ARGUMENT
    assert unpack(message, None) == BAD_ARGUMENT
    assert message.raw == before
    assert pack(None, ctypes.byref(frame)) == BAD_ARGUMENT
    assert pack(message, None) == BAD_ARGUMENT
    assert bytes(frame) == untouched
    assert unpack(message, ctypes.byref(frame)) == OK
    frame.dlc = 0
    assert pack(message, ctypes.byref(frame)) == OK
    assert (frame.id, frame.dlc, frame.t_us) == (EXTENDED | m.id, 8, 77)
