"""Whatever a log, a database, a project file, a signal map or an identification holds: a clear error or a
right answer, never another exception, a hang or more than a gibibyte.

Each example damages a good input: bytes turned, cut, doubled, exchanged for what a parser may stumble over.
What is still read is compared with a second reader where there is one, and else is sound in itself.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lpvguard.base import artefacts, native
from lpvguard.base.errors import InputError
from lpvguard.can.decode import decode_all, load_database
from lpvguard.can.logs import Frames, Table, parse_candump, parse_candump_slowly, read_log
from lpvguard.drives.signal_map import load_signal_map
from lpvguard.identify.run import load
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project
from other_car import MAP, OTHER_CAR, candump, other_car, write_log

MORE = 30 if os.environ.get("LPVGUARD_FULL") == "1" else 1
LONGEST_S = 30
MOST_BYTES = 1 << 30
TOKENS = [
    *(b"0", b"-1", b"1e308", b"1e999", b"nan", b"inf", b"-inf", b"9" * 30, b"0x", b"1_0", b"\xff\xfe"),
    *(b"\0", b"\r", b"\n", b'"', b"'", b"[", b"]]", b"{", b"}", b"=", b",", b";", b"#", b"##", b"|", b"@2"),
    *(b"(" * 40, b"**9**9**9", b"/0", b"m0 ", b"M ", b"64", b"65", b"\xc3\x28", "Ä".encode(), b"true"),
]


def budget(examples: int) -> Callable:
    """Settings of a test: examples in the short form."""
    return settings(
        max_examples=examples * MORE,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    )


@st.composite
def damage(draw, most: int = 4) -> list[tuple[str, float, int, bytes]]:
    """Changes of a file of any length: kind, place as a part of it, length, bytes."""
    change = st.tuples(
        st.sampled_from(["turn", "write", "cut", "put", "double", "end"]),
        st.floats(0, 1),
        st.integers(1, 40),
        st.sampled_from(TOKENS) | st.binary(min_size=1, max_size=6),
    )
    return draw(st.lists(change, min_size=1, max_size=most))


def damaged(good: bytes, changes: list[tuple[str, float, int, bytes]]) -> bytes:
    data = bytearray(good)
    for kind, where, length, new in changes:
        at = min(int(where * (len(data) + 1)), len(data))
        if kind == "turn" and at < len(data):
            data[at] ^= new[0] or 0xFF
        elif kind == "write":
            data[at : at + len(new)] = new
        elif kind == "cut":
            del data[at : at + length]
        elif kind == "put":
            data[at:at] = new
        elif kind == "double":
            data[at:at] = data[at : at + 8 * length]
        elif kind == "end":
            del data[at:]
    return bytes(data)


@contextmanager
def within_limits() -> Iterator[None]:
    """Fails after LONGEST_S of processor time, and where memory grows by more than MOST_BYTES."""

    def too_long(*_: object) -> None:
        raise AssertionError(f"still busy after {LONGEST_S} s of processor time")

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    old = signal.signal(signal.SIGVTALRM, too_long)
    signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, old)
    grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    assert grown < MOST_BYTES, f"{grown} bytes more"


def answered(read: Callable[[], Any], names: Path | str) -> Any:
    """What ``read`` returns; None where it refuses its input by an error that names it."""
    with within_limits():
        try:
            return read()
        except InputError as error:
            said = str(error)
            assert str(names) in said and "\n" not in said.strip(), said
            return None


# ------------------------------------------------------------------------------------------------------- logs


def require_sound(log: Frames | Table) -> None:
    if isinstance(log, Table):
        for series in log.series.values():
            assert series.t_ns.dtype == np.int64 and len(series.t_ns) == len(series.value)
        return
    n = len(log)
    assert n > 0 and {len(log.id), len(log.channel), len(log.length), len(log.data)} == {n}
    assert int(log.length.max()) <= log.data.shape[1] and int(log.channel.max()) < len(log.channels)
    behind = np.arange(log.data.shape[1]) >= log.length[:, None]
    assert not log.data[behind].any()


@budget(200)
@given(damage())
def test_both_readers_of_candump_say_the_same_of_any_text(changes):
    library = native.kernels("candump")
    if library is None:
        pytest.skip("no compiler")
    text = np.frombuffer(damaged(GOOD_DUMP, changes), np.uint8)
    fast, slow = parse_candump(text, library), parse_candump_slowly(text)
    assert fast.left_out == slow.left_out and len(fast) == len(slow)
    for a, b in ((fast.t_ns, slow.t_ns), (fast.id, slow.id), (fast.length, slow.length)):
        assert np.array_equal(a, b)
    width = min(fast.data.shape[1], slow.data.shape[1])
    assert np.array_equal(fast.data[:, :width], slow.data[:, :width])
    assert [fast.channels[i] for i in fast.channel] == [slow.channels[i] for i in slow.channel]


GOOD_DUMP = (
    candump(other_car(0.05))
    + "(1.0) vcan1 12345678##1" + "AB" * 24 + "\n(2.5) can0 123#R\n(3.25) can0 20000004#0004000000000000\n"
).encode()
DECODED = b"t,v,delta,r\n" + b"".join(b"%.2f,%.3f,0.1,%d\n" % (k / 50, 10 + k / 7, k) for k in range(40))
SEPARATED = b"\xef\xbb\xbf# a comment\nt;v\n" + b"".join(b"0,%02d;1,5\n" % k for k in range(40))


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> dict[str, bytes]:
    """A good log of every form."""
    folder, frames = tmp_path_factory.mktemp("good"), other_car(0.05)
    forms = ("log", "log.gz", "asc", "blf", "trc", "mf4", "csv", "parquet")
    logs = {form: write_log(form, frames, folder / "drive").read_bytes() for form in forms}
    return logs | {"decoded.csv": DECODED, "separated.csv": SEPARATED}


@pytest.mark.parametrize(
    "form, examples",
    [
        *(("log", 60), ("log.gz", 40), ("asc", 40), ("blf", 40), ("trc", 40), ("mf4", 12), ("csv", 40)),
        *(("parquet", 40), ("decoded.csv", 80), ("separated.csv", 40)),
    ],
)
def test_a_damaged_log_is_refused_or_read(form, examples, good, tmp_path):
    path = tmp_path / f"drive.{form}"

    @budget(examples)
    @given(damage())
    def check(changes):
        path.write_bytes(damaged(good[form], changes))
        log = answered(lambda: read_log(path), path)
        if log is not None:
            require_sound(log)

    check()


# -------------------------------------------------------------------------------------------------- databases


@budget(80)
@given(damage(2))
def test_a_damaged_database_is_refused_or_decodes_as_cantools_does(tmp_path, changes):
    path = tmp_path / "car.dbc"
    path.write_bytes(damaged(OTHER_CAR.encode(), changes))
    database = answered(lambda: load_database(path), path)
    if database is None:
        return
    frames = parse_candump_slowly(np.frombuffer(GOOD_DUMP, np.uint8))
    decoded = answered(lambda: decode_all(frames, database), "")
    if decoded is None:
        return
    for message in database.messages:
        for name, samples in decoded.get(message.name, {}).items():
            for at, value in zip(samples.frame[:5], samples.value[:5], strict=True):
                row = bytes(frames.data[at][: frames.length[at]])
                try:
                    theirs = message.decode(row, decode_choices=False, allow_truncated=True)
                except Exception:  # what cantools cannot decode it does not judge
                    continue
                if len([m for m in database.messages if m.name == message.name]) == 1 and name in theirs:
                    assert np.isclose(value, float(theirs[name]), rtol=1e-9, atol=1e-12), name


# ------------------------------------------------------------------------------- project files and signal maps

SHIPPED = resources.files("lpvguard.vehicle").joinpath("shipped")


@pytest.mark.parametrize("name", ["g80", "truck"])
def test_a_damaged_project_file_is_refused_or_is_a_model(name, tmp_path):
    text, path = SHIPPED.joinpath(f"{name}.toml").read_bytes(), tmp_path / "car.toml"

    @budget(120)
    @given(damage(2))
    def check(changes):
        path.write_bytes(damaged(text, changes))
        project = answered(lambda: load_project(path), path)
        if project is not None:
            answered(lambda: NominalModel(project), "")

    check()


LEAVES = st.sampled_from(
    [0, -1, 1e308, -1e-308, 10**40, float("nan"), float("inf"), True, None, "", "v", "1/0", "9**9**9**9"]
    + ["(-8)**0.5", "(" * 300 + "v" + ")" * 300, "v" * 10_000, "min(v)", "\0", "é", [], [[]], {}, [1e308, 0]]
)


def places(value: Any, path: tuple = ()) -> Iterator[tuple]:
    """Paths of everything in a document."""
    if path:
        yield path
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in inner:
        yield from places(part, (*path, key))


def replaced(document: Any, path: tuple, new: Any, leave_out: bool) -> Any:
    copy = json.loads(json.dumps(document))
    at = copy
    for key in path[:-1]:
        at = at[key]
    if leave_out:
        del at[path[-1]]
    else:
        at[path[-1]] = new
    return copy


@pytest.mark.parametrize("name", ["g80", "truck"])
def test_a_project_with_another_value_anywhere_is_refused_or_is_a_model(name):
    from lpvguard.vehicle.project import parse_project

    document = tomllib.loads(SHIPPED.joinpath(f"{name}.toml").read_text())
    known = sorted(places(document), key=str)

    @budget(150)
    @given(st.sampled_from(known), LEAVES, st.booleans())
    def check(path, new, leave_out):
        project = answered(lambda: parse_project(replaced(document, path, new, leave_out), "car.toml"), "car.toml")
        if project is not None:
            answered(lambda: NominalModel(project), "")

    check()


@budget(60)
@given(damage(2))
def test_a_damaged_signal_map_is_refused_or_read(tmp_path, changes):
    path = tmp_path / "map.toml"
    path.write_bytes(damaged(MAP.encode(), changes))
    answered(lambda: load_signal_map(path), path)


# --------------------------------------------------------------------------------------------- identifications


def test_a_damaged_identification_is_refused_by_its_file(identified, tmp_path):
    folder = tmp_path / "idn"
    shutil.copytree(identified, folder)
    names = sorted(p.name for p in folder.iterdir() if p.is_file())

    @budget(40)
    @given(st.sampled_from(names), damage(2))
    def check(name, changes):
        good_bytes = (identified / name).read_bytes()
        (folder / name).write_bytes(damaged(good_bytes, changes))
        found = answered(lambda: load(folder), folder)
        same = (folder / name).read_bytes() == good_bytes
        (folder / name).write_bytes(good_bytes)
        assert found is None or same or name == artefacts.MANIFEST

    check()


def test_a_sealed_identification_with_another_value_anywhere_is_refused_or_read(identified, tmp_path):
    folder = tmp_path / "idn"
    shutil.copytree(identified, folder)
    documents = {
        p.name: json.loads(p.read_text()) for p in sorted(folder.glob("*.json")) if p.name != artefacts.MANIFEST
    }
    known = {name: sorted(places(document), key=str) for name, document in documents.items()}

    @budget(60)
    @given(st.sampled_from(sorted(n for n in known if known[n])), st.floats(0, 1, exclude_max=True), LEAVES, st.booleans())
    def check(name, where, new, leave_out):
        path = known[name][int(where * len(known[name]))]
        text = json.dumps(replaced(documents[name], path, new, leave_out))
        (folder / name).write_text(text)
        artefacts.seal(folder)
        answered(lambda: load(folder), folder)
        (folder / name).write_bytes((identified / name).read_bytes())

    check()
