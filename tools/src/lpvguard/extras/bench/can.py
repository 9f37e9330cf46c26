"""`lpvguard bench can`: speed of decoding CAN logs, or reactions of the closed loop to faults on the bus.

With a log and its database, the bench measures decoding. It repeats a candump log up to the wanted number of
frames, and decodes every signal of the database from the text file. In the same run, a loop of python-can's
reader and cantools' decode_message decodes a part of the same file. Both use one process and one thread.
Times are processor times (user and system), so that other work on the machine has little effect on the ratio.

Without a log, the bench prints the fault table of the closed loop (loop/bus_faults.py): each fault on the
bus, and the firmware's reaction.
"""

from __future__ import annotations

import gzip
import os
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from ...base.errors import InputError
from ...can.decode import decode_all, load_database
from ...can.logs import Frames, read_log
from ...core.compiled import shipped_vehicle
from ..loop import bus_faults
from ..loop.sim import Simulator
from . import parser, show

if TYPE_CHECKING:  # cantools takes long to import
    from cantools.database.can import Database


def bench_decode(log: Path, dbc: Path, *, frames: int = 5_000_000, peer_frames: int = 200_000) -> dict:
    """Measure the frames per second of both decoders, and their ratio; ``log`` is a candump log (also .gz).

    The peer decodes only ``peer_frames`` frames. It is a loop, so its rate does not depend on their number.
    """
    text = gzip.decompress(Path(log).read_bytes()) if Path(log).suffix == ".gz" else Path(log).read_bytes()
    text = text if text.endswith(b"\n") else text + b"\n"
    database = load_database(dbc)
    with tempfile.TemporaryDirectory() as folder:
        whole, part = Path(folder) / "whole.log", Path(folder) / "part.log"
        lines = text.splitlines(keepends=True)
        whole.write_bytes(text * -(-frames // len(lines)))
        part.write_bytes(b"".join((lines * -(-peer_frames // len(lines)))[:peer_frames]))
        read_log(part)  # compiles the parser when the cache is empty
        start = time.process_time()
        raw = read_log(whole)
        if not isinstance(raw, Frames):
            raise InputError(log, "", "holds decoded signals", "a candump log")
        read = time.process_time()
        decoded = decode_all(raw, database)
        end = time.process_time()
        peer_signals, peer_s = _peer(part, database)
    signals = sum(len(s.value) for message in decoded.values() for s in message.values())
    ours, peer = len(raw) / (end - start), peer_frames / peer_s
    return {
        "frames": len(raw),
        "signals": signals,
        "read_s": read - start,
        "decode_s": end - read,
        "frames_per_s": ours,
        "peer": "python-can + cantools loop",
        "peer_frames": peer_frames,
        "peer_signals": peer_signals,
        "peer_frames_per_s": peer,
        "ratio": ours / peer,
        "processors": os.cpu_count(),
    }


def _peer(path: Path, database: Database) -> tuple[int, float]:
    import can

    known = {m.frame_id for m in database.messages}
    signals = 0
    start = time.process_time()
    with can.LogReader(path) as reader:
        for message in reader:
            if message.arbitration_id in known:
                signals += len(
                    database.decode_message(
                        message.arbitration_id,
                        message.data,  # type: ignore[arg-type]  # any buffer will do, says its code
                        decode_choices=False,
                    )
                )
    return signals, time.process_time() - start


def main(argv: list[str]) -> None:
    """Run `lpvguard bench can [LOG DBC]`; exit with 1 if a required reaction is missing or late."""
    arguments = parser("can", __doc__)
    arguments.add_argument(
        "log", type=Path, nargs="?", help="candump log, also .gz; without: the fault table"
    )
    arguments.add_argument("dbc", type=Path, nargs="?")
    arguments.add_argument("--frames", type=int, default=5_000_000)
    arguments.add_argument(
        "--coefficients", type=Path, help="generated folder for the fault table (default: the shipped truck)"
    )
    options = arguments.parse_args(argv)
    if options.log is None:
        rows = bus_faults.table(Simulator(options.coefficients or shipped_vehicle("truck")))
        show(bus_faults.as_text(rows), rows, options.json_out)
        raise SystemExit(1 if any(row["missed"] for row in rows) else 0)
    if options.dbc is None:
        arguments.error("a log needs its database")
    result = bench_decode(options.log, options.dbc, frames=options.frames)
    show(
        "\n".join(
            [
                f"{'lpvguard':<28} {result['frames_per_s'] / 1e6:8.3f} M frames/s  "
                f"({result['frames']} frames, {result['signals']} values; "
                f"reading {result['read_s']:.2f} s, decoding {result['decode_s']:.2f} s)",
                f"{result['peer']:<28} {result['peer_frames_per_s'] / 1e6:8.3f} M frames/s  "
                f"({result['peer_frames']} frames, {result['peer_signals']} values)",
                f"{'ratio':<28} {result['ratio']:8.1f}",
            ]
        ),
        result,
        options.json_out,
    )
