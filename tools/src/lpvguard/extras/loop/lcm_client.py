"""Clients of a simulation that runs with `lpvguard sim --lcm URL`: read its channels and logs, send commands.

lcm-gen makes the message types of firmware_sim/lcm on first use. firmware_sim/README.md has the table of
channels. This module needs the extra ``lcm`` (``pip install './tools[lcm]'``).

    client = Client("udpm://239.255.76.67:7667?ttl=0")
    answer = client.command("inject", 'plant.sensor_fault = [{signal = "yaw_rate", gain = 0.7}]')
    for channel, message in client.messages(timeout_s=2.0):
        if channel == "LPVGUARD_MARGINS":
            print(message.frequency, message.statistic / message.threshold)
    client.command("clear", answer.entry)
"""

import hashlib
import importlib.util
import secrets
import shutil
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

from ...base import native
from ...base.errors import InputError
from ...can.logs import ERROR_REPORT, EXTENDED, candump_line
from ...core.compiled import CAUSES, REASONS, SUPERVISION, VERDICTS, firmware_root
from ...replay.causes import cause_sentence

CHANNELS = {
    "LPVGUARD_TRUTH": "truth_t",
    "LPVGUARD_GUARD": "guard_t",
    "LPVGUARD_SUPERVISION": "supervision_t",
    "LPVGUARD_BUS": "bus_t",
    "LPVGUARD_MARGINS": "margin_t",
    "LPVGUARD_CAUSES": "cause_t",
    "LPVGUARD_STATUS": "status_t",
    "LPVGUARD_CONTROL": "control_t",
}
"""Channel -> message type."""
Action = Literal["pause", "resume", "step", "stop", "inject", "clear"]
INSTALL = "the Debian packages liblcm-dev and liblcm-bin, or pip install './tools[lcm]'"


def generator() -> str:
    """Return the path of lcm-gen; raise InputError if there is none."""
    beside = Path(sys.executable).with_name("lcm-gen")
    path = shutil.which("lcm-gen") or (str(beside) if beside.is_file() else None)
    if path is None:
        raise InputError("lcm-gen", "", "not found", INSTALL)
    return path


@cache
def message_types() -> ModuleType:
    """Import the package ``lpvguard_lcm`` of message types; lcm-gen makes the package on first use."""
    sources = sorted((firmware_root() / "lcm").glob("*.lcm"))
    digest = hashlib.sha256(b"\0".join(s.read_bytes() for s in sources)).hexdigest()[:24]
    folder = native.cache_dir() / f"lcm-{digest}"
    if not folder.is_dir():
        with tempfile.TemporaryDirectory(dir=native.cache_dir()) as scratch:
            made = Path(scratch) / "types"
            subprocess.run(
                [generator(), "-p", "--ppath", made, *sources], check=True, stdout=subprocess.DEVNULL
            )
            try:
                made.rename(folder)
            except OSError:
                if not folder.is_dir():  # otherwise another process made it meanwhile
                    raise
    spec = importlib.util.spec_from_file_location("lpvguard_lcm", folder / "lpvguard_lcm" / "__init__.py")
    if spec is None or spec.loader is None:
        raise InputError(folder, "", "holds no Python package", "what lcm-gen -p makes")
    package = importlib.util.module_from_spec(spec)
    sys.modules["lpvguard_lcm"] = package  # its modules import each other by this name
    spec.loader.exec_module(package)
    return package


def constants(type_name: str) -> dict[str, int]:
    """Constants of a message type by lower-case name, for example the actions of control_t."""
    members = vars(getattr(message_types(), type_name))
    return {name.lower(): value for name, value in members.items() if name.isupper()}


def state_name(status: Any) -> str:
    """Name the state of a status_t.

    Parameters
    ----------
    status : status_t

    Returns
    -------
    str
    """
    return next(name for name, value in constants("status_t").items() if value == status.state)


def _lcm() -> ModuleType:
    try:
        import lcm
    except ImportError:
        raise InputError("lcm", "", "the Python package is not installed", INSTALL) from None
    return lcm


def decode(channel: str, data: bytes) -> Any:
    """Decode a message of a channel; raise InputError for a message of another type or version."""
    try:
        return getattr(message_types(), CHANNELS[channel]).decode(data)
    except ValueError as error:
        raise InputError(channel, "", str(error), f"a {CHANNELS[channel]} as firmware_sim/lcm says") from None


def read_log(path: Path) -> Iterator[tuple[str, Any]]:
    """Read our messages from a log of lcm-logger, in the order of the log.

    Parameters
    ----------
    path : Path

    Yields
    ------
    tuple (channel, message)

    Raises
    ------
    InputError
        If the file is not a log of lcm-logger.
    """
    lcm = _lcm()
    if not path.is_file():
        raise InputError(path, "", "no such file", "a log of lcm-logger")
    log = lcm.EventLog(path)
    try:
        for event in log:
            if event.channel in CHANNELS:
                yield event.channel, decode(event.channel, event.data)
    finally:
        log.close()


def log_line(frame: Any) -> str:
    """Write a bus_t as a line of candump -L, like `lpvguard sim -o`.

    Parameters
    ----------
    frame : bus_t

    Returns
    -------
    str
    """
    flags = (EXTENDED if frame.extended else 0) | (ERROR_REPORT if frame.error else 0)
    return candump_line(frame.utime, "can0", frame.id | flags, frame.data[: frame.dlc])


def watch(messages: Iterable[tuple[str, Any]]) -> Iterator[str]:
    """Describe every change in a stream of messages in words, until the run ends.

    Parameters
    ----------
    messages : Iterable of (channel, message)

    Yields
    ------
    str, a line
    """
    newest: dict[str, Any] = {}

    def changed(what: str, value: Any) -> bool:
        before, newest[what] = newest.get(what), value
        return value != before

    for channel, m in messages:
        lines = []
        if channel == "LPVGUARD_GUARD" and changed("guard", (m.verdict, m.supervision)):
            lines.append(
                f"verdict {VERDICTS[m.verdict]}, supervision {SUPERVISION[m.supervision]}, "
                f"statistic {m.statistic:.3f}"
            )
        elif (
            channel == "LPVGUARD_SUPERVISION"
            and changed("trouble", (m.trouble_spn, m.trouble_fmi))
            and m.trouble_spn
        ):
            lines.append(f"trouble code SPN {m.trouble_spn} FMI {m.trouble_fmi}")
        elif channel == "LPVGUARD_MARGINS" and m.reason <= REASONS.index("not_excited"):
            lines.append(
                f"bin {m.bin} at {m.frequency:.3g} rad/s: t* {m.margin:.3f}, "
                f"statistic {m.statistic:.3f} of {m.threshold:.3f}"
                f"{', too little excitation' if m.reason else ''}; "
                f"energy ratio {m.energy_ratio:.3f} of {m.energy_threshold:.3f}; "
                f"change ratio {m.change_ratio:.3f} of {m.change_threshold:.3f}"
            )
        elif channel == "LPVGUARD_CAUSES":
            named, numbers, onset_s = f"output {m.output}", (m.value, m.low, m.high), m.onset_utime * 1e-6
            lines.append(cause_sentence(named, "", CAUSES[m.cause], numbers, onset_s, m.before))
        elif channel == "LPVGUARD_STATUS" and (m.id or changed("state", m.state)):
            lines.append(
                f"refused: {m.reason}" if m.reason else f"{state_name(m)}{' ' if m.entry else ''}{m.entry}"
            )
        yield from (f"{m.utime * 1e-6:9.2f} s  {line}" for line in lines)
        if channel == "LPVGUARD_STATUS" and m.state == m.ENDED and not m.id:
            return


class Client:
    """Client that reads channels of a simulation and controls it, in one thread.

    Late reading loses no message, unless ``queue`` limits the number of waiting messages.

    Parameters
    ----------
    url : str, URL of LCM
    channels : Iterable[str], default all channels
    queue : int, largest number of waiting messages of a channel, 0: no limit, default 0

    Raises
    ------
    InputError
        If the URL cannot be opened.
    """

    def __init__(self, url: str, channels: Iterable[str] = CHANNELS, queue: int = 0):
        try:
            self._lcm = _lcm().LCM(url)
        except RuntimeError as error:
            raise InputError(
                url, "LCM", str(error), "a URL as LCM reads it, such as udpm://239.255.76.67:7667?ttl=0"
            ) from None
        self._heard: deque[tuple[str, Any]] = deque()
        for channel in channels:
            self._lcm.subscribe(channel, self._hear).set_queue_capacity(queue)

    def messages(self, timeout_s: float) -> Iterator[tuple[str, Any]]:
        """Yield (channel, message) until no message arrives within ``timeout_s`` [s]."""
        while self._heard or self._lcm.handle_timeout(round(timeout_s * 1e3)) > 0:
            while self._heard:
                yield self._heard.popleft()

    def waiting(self, timeout_s: float, most: int) -> list[tuple[str, Any]]:
        """Return up to ``most`` waiting (channel, message); if none waits, wait up to ``timeout_s`` [s]."""
        left_ms = round(timeout_s * 1e3)
        while len(self._heard) < most and self._lcm.handle_timeout(left_ms) > 0:
            left_ms = 0
        return [self._heard.popleft() for _ in range(min(most, len(self._heard)))]

    def command(self, action: Action, entry: str = "", *, ticks: int = 1, timeout_s: float = 5.0) -> Any:
        """Send a control_t (firmware_sim/lcm/lpvguard_control.lcm) and return the answering status_t.

        `messages` still returns the other messages. Raises InputError if the simulation refuses the command,
        or if no answer arrives within ``timeout_s`` [s].
        """
        types = message_types()
        request = types.control_t()
        request.id, request.action, request.entry, request.ticks = (
            1 + secrets.randbits(62),
            constants("control_t")[action],
            entry,
            ticks,
        )
        self._lcm.publish("LPVGUARD_CONTROL", request.encode())
        ends = time.monotonic() + timeout_s
        seen = len(self._heard)
        while (left_s := ends - time.monotonic()) > 0:
            self._lcm.handle_timeout(max(1, round(left_s * 1e3)))
            for channel, message in list(self._heard)[seen:]:
                if channel == "LPVGUARD_STATUS" and message.id == request.id:
                    if not message.accepted:
                        raise InputError("simulation", action, f"refused: {message.reason}")
                    return message
            seen = len(self._heard)
        raise InputError(
            "simulation", action, f"no answer within {timeout_s:g} s", "one that runs with --lcm at this URL"
        )

    def _hear(self, channel: str, data: bytes) -> None:
        self._heard.append((channel, decode(channel, data)))
