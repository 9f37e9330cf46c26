"""A campaign of damaged foreign input: logs, CAN databases, project files, signal maps, drives,
identifications.

    python foreign_input.py IDENTIFICATION FOLDER SEED CASES

For each kind CASES files are made in FOLDER from a good one, by damage that SEED draws, and read. A reader
has to answer or to refuse with an InputError. Anything else ends the campaign, and the file stays. A line a
kind says how many were answered and refused; the last line is the process's peak memory in MiB.
"""

import faulthandler
import gzip
import json
import re
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path

import can
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from asammdf import MDF, Signal
from scipy.io import savemat

from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.can import logs
from lpvguard.can.dbc import dbc_text
from lpvguard.can.decode import load_database
from lpvguard.can.log_types import ERROR_REPORT, EXTENDED, LATEST_S, Frames, frames_of_rows
from lpvguard.can.logs import candump_frames, read_log
from lpvguard.drives.signal_map import load_signal_map
from lpvguard.drives.tables import read_drive
from lpvguard.identify import identification as stage
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import Project, load_project
from made import ROOT

HANG_S = 120
"""A reader that has not come back after so many seconds hangs."""
TOKENS = (
    *(
        b"\0",
        b"\xff\xfe",
        b"\xc3",
        b"\n",
        b"\r",
        b"#",
        b'"',
        b"'",
        b",",
        b";",
        b"=",
        b"[",
        b"]",
        b"{",
        b"(",
        b")",
    ),
    *(b"nan", b"-inf", b"1e999", b"-1", b"0", b"99999999999999999999", b"0x", b"null", b"true", b"[]", b"{}"),
    *(b"**", b"9**9**9**9", b"v**v**v", b"1/0", b"sqrt(-1)", b"__import__('os')", b"(" * 300, b"lambda:0"),
)
"""What damage puts in: characters and words that end or begin something somewhere."""
VALUES = (None, True, 0, -1, 2**70, 1e308, float("nan"), "", "nan", [], [[]], {}, {"a": 1}, [None], ["x"])
"""What damage puts in place of a value in JSON."""


def damaged(good: bytes, random: np.random.Generator) -> bytes:
    """``good`` with one to four places changed: flipped, cut, doubled, moved, or with a token put in."""
    data = bytearray(good)
    for _ in range(int(random.integers(1, 5))):
        a, b = sorted(random.integers(0, len(data) + 1, 2).tolist())
        b = min(b, a + int(random.integers(1, 64)))
        what = int(random.integers(0, 7))
        if what == 0 and a < len(data):
            data[a] ^= 1 << int(random.integers(0, 8))
        elif what == 1:
            del data[a:b]
        elif what == 2:
            data[a:a] = data[a:b] * int(random.integers(1, 50))
        elif what == 3:
            data[a:b] = TOKENS[int(random.integers(len(TOKENS)))]
        elif what == 4:
            data[a:a] = TOKENS[int(random.integers(len(TOKENS)))]
        elif what == 5:
            piece = data[a:b]
            del data[a:b]
            place = int(random.integers(0, len(data) + 1))
            data[place:place] = piece
        elif random.random() < 0.3:
            del data[a:]
    return bytes(data)


def places(value: object, path: tuple = ()) -> Iterator[tuple]:
    """Paths of all values in a JSON document, but of a list's only the first eight."""
    inside: Iterable[tuple] = ()
    if isinstance(value, dict):
        inside = value.items()
    elif isinstance(value, list):
        inside = enumerate(value[:8])
    for key, item in inside:
        yield (*path, key)
        yield from places(item, (*path, key))


def damage_document(document: dict, random: np.random.Generator) -> None:
    """One value replaced, or one key taken away."""
    entries = list(places(document))
    *path, last = entries[int(random.integers(len(entries)))]
    holder = document
    for key in path:
        holder = holder[key]
    if random.random() < 0.3:
        del holder[last]
    else:
        holder[last] = VALUES[int(random.integers(len(VALUES)))]


def messages() -> list[can.Message]:
    """Thirty frames of two buses, classic and FD, one remote and one error report."""
    made = [
        can.Message(
            timestamp=1e9 + 0.01 * k,
            arbitration_id=0x18F0093E if k % 3 else 0x123,
            is_extended_id=bool(k % 3),
            is_remote_frame=k == 7,
            is_fd=k == 11,
            data=b"" if k == 7 else bytes(range(12 if k == 11 else 8)),
            channel=k % 2,
        )
        for k in range(30)
    ]
    return [*made, can.Message(timestamp=1e9 + 1, is_error_frame=True, channel=0)]


def good_logs(folder: Path) -> dict[str, bytes]:
    """Name of a kind of log -> a small good one."""
    folder.mkdir(parents=True)
    raw = ("log", "asc", "blf", "trc", "csv", "mf4")
    for suffix in raw:
        with can.Logger(folder / f"raw.{suffix}") as log:
            for message in messages():
                if suffix not in ("trc", "csv") or not (message.is_fd or message.is_error_frame):
                    log.on_message_received(message)
    logs = {f"raw.{s}": (folder / f"raw.{s}").read_bytes() for s in raw}
    logs["raw.log.gz"] = gzip.compress(logs["raw.log"], mtime=0)
    text = "# speeds\nt,v,delta\n" + "".join(f"{0.01 * k:.2f},{10 + k},{0.01 * k}\n" for k in range(30))
    logs["table.csv"] = text.encode()
    t = np.arange(30) * 0.01
    pa.parquet.write_table(pa.table({"t": t, "v": t + 10}), folder / "table.parquet")
    logs["table.parquet"] = (folder / "table.parquet").read_bytes()
    for version, suffix in (("4.10", "mf4"), ("3.30", "mdf")):
        with MDF(version=version) as mdf:
            mdf.append([Signal(t + 10, t, name="v", unit="m/s")])
            logs[f"table.{suffix}"] = mdf.save(folder / f"table.{suffix}").read_bytes()
    return logs


def good_drives(folder: Path, project: Project) -> dict[str, bytes]:
    """Name of a form of drive -> a short one with the columns that the project records."""
    t = np.arange(60) * project.Ts_s
    columns = {"t": t} | {s.column: 0.01 * np.sin(t) for s in project.recorded}
    columns[project.speed.column] += 10.0
    pa.csv.write_csv(pa.table(columns), folder / "drive.csv")
    pa.parquet.write_table(pa.table(columns), folder / "drive.parquet")
    savemat(folder / "drive.mat", columns)
    savemat(folder / "packed.mat", columns, do_compression=True)
    names = ("drive.csv", "drive.parquet", "drive.mat", "packed.mat")
    return {name: (folder / name).read_bytes() for name in names}


def parse_candump_slowly(text: np.ndarray) -> Frames:
    """Frames of the candump log ``text`` (bytes,), read line by line: what the compiled parser must say."""
    rows: list[tuple[int, int, str, bytes]] = []
    left_out: dict[str, int] = {}
    interfaces: set[bytes] = set()

    def leave_out(kind: str) -> None:
        left_out[kind] = left_out.get(kind, 0) + 1

    for number, line in enumerate(text.tobytes().split(b"\n"), start=1):
        if line in (b"", b"\r"):
            continue
        match = logs._LINE.fullmatch(line)
        kind = "" if match is not None and int(match[1]) <= LATEST_S else "lines that are no frame"
        if match is not None and not kind:
            seconds, fraction, interface, identifier, remote, data = match.groups()
            value = int(identifier, 16)
            if len(identifier) == 8 and value & ERROR_REPORT:
                kind = "error reports"
            elif remote:
                kind = "remote frames"
            elif interface not in interfaces and len(interfaces) == logs._CHANNELS:
                kind = "lines that are no frame"
            else:
                interfaces.add(interface)
                flagged = value & 0x1FFFFFFF | EXTENDED if len(identifier) == 8 else value
                t_ns = int(seconds) * 10**9 + int(fraction.ljust(9, b"0"))
                rows.append((t_ns, flagged, interface.decode(errors="replace"), bytes.fromhex(data.decode())))
        if kind:
            leave_out(kind)
        if kind == "lines that are no frame":
            left_out.setdefault("first line that is no frame", number)
    return frames_of_rows(rows, left_out)


def read_candump_twice(path: Path) -> None:
    """Both readers of candump say the same."""
    log, text = read_log(path), np.frombuffer(path.read_bytes(), np.uint8)
    compiled, slow = candump_frames(text), parse_candump_slowly(text)
    named = [[f.channels[c] for c in f.channel] for f in (compiled, slow)]
    same = all(np.array_equal(getattr(compiled, k), getattr(slow, k)) for k in ("t_ns", "id", "length"))
    same = same and named[0] == named[1] and compiled.left_out == slow.left_out
    if not same or len(log) != len(compiled):
        raise AssertionError(f"the readers of candump differ: {compiled} and {slow}")


def read_project(path: Path) -> None:
    NominalModel(load_project(path)).matrices(np.array([5.0, 10.0]))


def campaign(name: str, read: Callable[[], object], cases: int, prepare: Callable[[], None]) -> None:
    """``prepare`` and ``read`` in turn; prints how often an answer came and how often a refusal."""
    answered = 0
    for _ in range(cases):
        prepare()
        faulthandler.dump_traceback_later(HANG_S, exit=True)
        try:
            read()
        except InputError as error:
            assert error.source and error.what, error
        else:
            answered += 1
        finally:
            faulthandler.cancel_dump_traceback_later()
    print(f"{name}: {cases} read, {answered} answered, {cases - answered} refused", flush=True)


def of_file(path: Path, good: bytes, random: np.random.Generator) -> Callable[[], None]:
    """What writes ``path`` anew, with other damage each time."""
    return lambda: (path.write_bytes(damaged(good, random)), None)[1]


def of_identification(good: Path, folder: Path, random: np.random.Generator) -> Callable[[], None]:
    """What makes ``folder`` anew: one of its documents damaged, and the seals renewed."""
    names = sorted(path.name for path in good.glob("*.json"))

    def prepare() -> None:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(good, folder)
        path = folder / names[int(random.integers(len(names)))]
        document = json.loads(path.read_text())
        damage_document(document, random)
        path.write_text(json.dumps(artefacts.sealed(document) if "seal" in document else document))
        if path.name != artefacts.MANIFEST:
            artefacts.seal(folder)

    return prepare


def peak_mib() -> int:
    """Largest memory this program held (MiB); getrusage's would count that of the program that began it."""
    match = re.search(r"^VmHWM:\s+(\d+) kB$", Path("/proc/self/status").read_text(), re.MULTILINE)
    assert match
    return int(match[1]) // 1024


def main(identification: Path, folder: Path, seed: int, cases: int) -> None:
    logs = good_logs(folder / "good")
    kinds: dict[str, tuple[bytes, Callable[[Path], object]]] = {
        name: (good, read_candump_twice if name == "raw.log" else read_log) for name, good in logs.items()
    }
    kinds["own.dbc"] = dbc_text().encode(), load_database
    shipped = ROOT / "tools" / "src" / "lpvguard" / "vehicle" / "shipped"
    for name in ("g80", "truck"):
        kinds[f"{name}.toml"] = (shipped / f"{name}.toml").read_bytes(), read_project
    kinds["map.toml"] = (
        b'schema = 1\nTs_s = 0.01\nchannel = "can0"\n[columns.v]\nunit = "m/s"\nmessage = "SPEED"\n'
        b'signal = "SPEED"\nfactor = 0.25\nmin = 0.0\n[columns.delta]\nunit = "rad"\n'
        b'terms = [{ message = "STEER", signal = "ANGLE", wrap = 6.28 }, { signal = "FRACTION" }]\n',
        load_signal_map,
    )
    project = load_project(shipped / "g80.toml")
    kinds |= {
        name: (good, partial(read_drive, project=project))
        for name, good in good_drives(folder / "good", project).items()
    }
    for k, (name, (good, read)) in enumerate(kinds.items()):
        path = folder / name
        campaign(
            name, lambda p=path, r=read: r(p), cases, of_file(path, good, np.random.default_rng([seed, k]))
        )
    copy, random = folder / "identification", np.random.default_rng([seed, len(kinds)])
    prepare = of_identification(identification, copy, random)
    campaign("identification", lambda: stage.load(copy), cases, prepare)
    print(f"peak: {peak_mib()} MiB")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
