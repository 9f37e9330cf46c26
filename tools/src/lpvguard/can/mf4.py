"""Read MF4 files with asammdf: frames of bus logging, or one channel for each signal."""

from pathlib import Path

import numpy as np

from ..base.errors import InputError
from .damaged import require_sound_blocks
from .log_types import EXTENDED, FD_BYTES, LATEST_S, Frames, Series, Table


def read_mf4(path: Path) -> Frames | Table:
    """Read an MF4 file; raise InputError if it cannot be read."""
    try:
        from asammdf import MDF
    except ImportError:
        raise InputError(path, "", "reading MF4 needs the package asammdf", "pip install asammdf") from None
    try:
        require_sound_blocks(path)
        with MDF(path) as mdf:
            places = [
                (g, entry)
                for name, entries in mdf.channels_db.items()
                if name == "CAN_DataFrame"
                for g, entry in entries
            ]
            return _mf4_frames(mdf, places) if places else _mf4_signals(mdf)
    except InputError:
        raise
    except Exception as error:  # asammdf has no exception class for a broken file
        raise InputError(
            path, "", f"cannot be read ({type(error).__name__}: {error})", "an MF4 file"
        ) from None


def _mf4_frames(mdf, places: list[tuple[int, int]]) -> Frames:
    t, id_, channel, length, data = [], [], [], [], []
    for group, index in places:
        whole = mdf.get(group=group, index=index, raw=True)
        names = {name.rsplit(".", 1)[-1]: name for name in whole.samples.dtype.names}

        def part(key: str, default: int, n: int = len(whole.samples), names=names, whole=whole) -> np.ndarray:
            return whole.samples[names[key]] if key in names else np.full(n, default)

        payload = np.asarray(whole.samples[names["DataBytes"]], np.uint8)
        identifier = np.asarray(part("ID", 0), np.int64)
        extended = np.where(part("IDE", 0) != 0, True, identifier > 0x7FF)
        t.append(_mf4_time(whole.timestamps))
        id_.append((identifier & 0x1FFFFFFF | np.where(extended, EXTENDED, 0)).astype(np.uint32))
        channel.append(np.asarray(part("BusChannel", 0), np.uint8))
        length.append(np.asarray(part("DataLength", payload.shape[1]), np.uint8))
        data.append(payload)
    width = 8 if max(d.shape[1] for d in data) <= 8 else FD_BYTES
    padded = np.concatenate([np.pad(d, ((0, 0), (0, width - d.shape[1]))) for d in data])
    t_ns = np.concatenate(t)
    order = np.argsort(
        t_ns, kind="stable"
    )  # each group holds one bus, so the frames of all groups must be sorted by time
    numbers = np.concatenate(channel)[order]
    present, position = np.unique(numbers, return_inverse=True)
    return Frames(
        t_ns[order],
        np.concatenate(id_)[order],
        position.astype(np.uint8),
        np.concatenate(length)[order],
        padded[order],
        [str(n) for n in present],
    )


def _mf4_time(t_s: np.ndarray) -> np.ndarray:
    """Convert times (N,) from s to ns; raise ValueError for an impossible time."""
    bad = t_s[~(np.abs(t_s) <= LATEST_S)]
    if len(bad):
        raise ValueError(f"time {bad[0]} s")
    return np.rint(t_s * 1e9).astype(np.int64)


def _mf4_signals(mdf) -> Table:
    series: dict[str, Series] = {}
    for group, content in enumerate(mdf.groups):
        for index, channel in enumerate(content.channels):
            if mdf.masters_db.get(group) == index:
                continue
            signal = mdf.get(group=group, index=index)
            if signal.samples.ndim == 1 and signal.samples.dtype.kind in "iufb":
                value = signal.samples.astype(float)
                if signal.invalidation_bits is not None:
                    value[np.asarray(signal.invalidation_bits, bool)] = np.nan
                series.setdefault(
                    channel.name, Series(_mf4_time(signal.timestamps), value, signal.unit or "")
                )
    return Table(series)
