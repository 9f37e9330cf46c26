"""Convert drives to frames of the catalogue's messages, and send frames to a bus or to a candump log.

`encode` is the numpy version of the generated C codec. It rounds to the nearest raw value, saturates, and
sends NaN as "not available". It sets unused bits to 1. It adds E2E profile 11 if the catalogue states it.
"""

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from .catalogue import BusSignal, Message, load_catalogue
from .logs import EXTENDED, Frames, candump_line

_CRC8_POLYNOMIAL = 0x1D
COUNTERS = 15
"""Counters of E2E profile 11 run from 0 to 14."""


def _crc8_table() -> np.ndarray:
    crc = np.arange(256)
    for _ in range(8):
        crc = np.where(crc & 0x80, crc << 1 ^ _CRC8_POLYNOMIAL, crc << 1) & 0xFF
    return crc.astype(np.uint8)


def protect(data: np.ndarray, data_id: int, first_counter: int = 0) -> None:
    """Write E2E profile 11, data-id mode BOTH, into consecutive frames ``data`` (N, 8) of a message."""
    data[:, 1] = data[:, 1] & 0xF0 | ((first_counter + np.arange(len(data))) % COUNTERS).astype(np.uint8)
    data[:, 0] = e2e_crc(data, data_id)


def e2e_crc(data: np.ndarray, data_id: int) -> np.ndarray:
    """Compute the CRC (byte 0) of frames by E2E profile 11, data-id mode BOTH.

    Parameters
    ----------
    data : ndarray (N, 8) of uint8
    data_id : int

    Returns
    -------
    ndarray (N,) of uint8

    References
    ----------
    AUTOSAR_PRS_E2EProtocol.
    """
    table = _crc8_table()
    crc = np.full(len(data), table[table[data_id & 0xFF] ^ data_id >> 8], np.uint8)
    for column in data.T[1:]:
        crc = table[crc ^ column]
    return crc


def encode_raw(signal: BusSignal, physical: np.ndarray) -> np.ndarray:
    """Convert physical to raw values (N,); NaN gives the largest code, "not available"."""
    steps = np.floor((np.asarray(physical, float) - signal.offset) / signal.scale + 0.5)
    absent = (1 << signal.length) - 1
    return np.where(np.isnan(steps), absent, np.clip(steps, 0, signal.raw_max)).astype(np.uint64)


def encode(message: Message, values: Mapping[str, np.ndarray], n: int) -> np.ndarray:
    """Make the data (n, 8) of a message; signals without ``values`` are sent as "not available"."""
    whole = np.full(n, 0xFFFFFFFFFFFFFFFF, np.uint64)
    for signal in message.signals:
        if signal.name in values:
            mask = np.uint64((1 << signal.length) - 1 << signal.start)
            whole = whole & ~mask | encode_raw(signal, values[signal.name]) << np.uint64(signal.start)
    data = whole.astype("<u8").view(np.uint8).reshape(n, 8).copy()
    if message.e2e:
        protect(data, message.e2e.data_id)
    return data


def frames_of_drive(t: np.ndarray, values: Mapping[tuple[str, str], np.ndarray]) -> Frames:
    """Make the frames of a drive; each message is sent with its own period from t[0] on.

    Parameters
    ----------
    t : ndarray (N,), s, increasing
    values : Mapping, bus values (N,) by (message, signal), interpolated linearly

    Returns
    -------
    Frames

    Raises
    ------
    InputError
        If the catalogue lacks a message.
    """
    catalogue = load_catalogue()
    parts = []
    for name in dict.fromkeys(message for message, _ in values):
        message = catalogue.message(name)
        times = (
            t[0]
            + np.arange(int((t[-1] - t[0]) * 1000 / message.period_ms + 1e-6) + 1) * message.period_ms / 1000
        )
        signals = {
            signal: np.interp(times, t, x) for (carrier, signal), x in values.items() if carrier == name
        }
        parts.append(
            (
                np.rint(times * 1e9).astype(np.int64),
                message.id | EXTENDED,
                encode(message, signals, len(times)),
            )
        )
    t_ns = np.concatenate([p[0] for p in parts])
    id_ = np.concatenate([np.full(len(p[0]), p[1], np.uint32) for p in parts])
    order = np.lexsort((id_, t_ns))  # of simultaneous frames, the lower identifier is sent first, as on a bus
    n = len(order)
    return Frames(
        t_ns[order],
        id_[order],
        np.zeros(n, np.uint8),
        np.full(n, 8, np.uint8),
        np.concatenate([p[2] for p in parts])[order],
        ["can0"],
    )


def values_of_drive(project, drive) -> dict[tuple[str, str], np.ndarray]:
    """Return the bus values that `frames_of_drive` sends for a drive.

    The bus value is factor * value for every signal with a CAN place. A receiver refuses a frame that lacks a
    supervised signal. If the drive lacks such a signal, it is replaced: lateral acceleration by speed * yaw
    rate (steady cornering), every other signal by 0.

    Parameters
    ----------
    project : Project
    drive : Drive, N samples

    Returns
    -------
    dict, ndarray (N,) by (message, signal)

    Raises
    ------
    InputError
        If a signal has no place.
    """
    catalogue = load_catalogue()
    if project.can is not None:
        raise InputError(
            f"vehicle {project.name}",
            "can",
            "is on the car's own bus, which is only read",
            "a raw log, or a vehicle on the bus of the CAN catalogue",
        )
    columns = [
        (project.speed, drive.v),
        *((s, drive.u[:, j]) for j, s in enumerate(project.inputs)),
        *((s, drive.y[:, j]) for j, s in enumerate(project.outputs)),
    ]
    without = [s.name for s, _ in columns if s.can is None]
    if without:
        raise InputError(
            f"vehicle {project.name}",
            "signals",
            f"{', '.join(without)} have no `can` entry",
            "can = { message, signal, factor }",
        )
    values = {(s.can.message, s.can.signal): s.can.factor * x for s, x in columns}
    steady = drive.v * values.get(("VDC2", "yaw_rate"), 0.0)
    for message in dict.fromkeys(message for message, _ in values):
        for signal, accepted in catalogue.message(message).rules:
            fill = steady if signal.name == "lateral_acceleration" else np.zeros(len(drive.t))
            values.setdefault((message, signal.name), np.clip(fill, accepted.min, accepted.max))
    return values


def write_candump(frames: Frames, path: Path) -> None:
    """Write the frames in the form of ``candump -l``."""
    lines = (
        candump_line(t // 1000, frames.channels[c], i, d[:n].tobytes())
        for t, c, i, n, d in zip(
            frames.t_ns.tolist(),
            frames.channel.tolist(),
            frames.id.tolist(),
            frames.length.tolist(),
            frames.data,
            strict=False,
        )
    )
    Path(path).write_text("".join(lines), encoding="ascii")


def play(
    frames: Frames,
    bus,
    *,
    speed: float = 1.0,
    sleep: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> float:
    """Send frames on a bus at the recorded pace.

    A frame is never sent early. Delays do not accumulate, because every frame is timed from the start. If the
    log's clock goes back, the next frame is sent at once.

    Parameters
    ----------
    frames : Frames
    bus : Bus, of python-can
    speed : float, factor of the recorded pace, inf: no waiting, default 1.0
    sleep, clock : Callable, by default functions of the module time

    Returns
    -------
    float, s, largest lateness
    """
    import can

    due = np.concatenate(([0.0], np.cumsum(np.maximum(np.diff(frames.t_ns), 0)) / 1e9 / speed))
    late, start = 0.0, clock()
    for due_s, id_, length, data in zip(
        due.tolist(), frames.id.tolist(), frames.length.tolist(), frames.data, strict=False
    ):
        ahead = start + due_s - clock()
        if ahead > 0:
            sleep(ahead)
        late = max(late, -ahead)
        bus.send(
            can.Message(
                arbitration_id=id_ & 0x1FFFFFFF,
                is_extended_id=bool(id_ & EXTENDED),
                is_fd=length > 8,
                data=data[:length].tobytes(),
            )
        )
    return late
