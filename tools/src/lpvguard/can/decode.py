"""Decode raw frames with a database, whole arrays at a time.

This module decodes every signal that cantools describes: Intel and Motorola, signed, float, multiplexed (also
nested), in frames of up to 64 bytes. J1939 messages are found by their parameter group. Their priority is
ignored. The source address counts only if the log has frames with the address of the database.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..base.errors import InputError, InputWarning
from .catalogue import j1939_data_max
from .database_lines import read_sound_lines
from .dbc import dbc_text
from .logs import EXTENDED, Frames
from .sign_bits import sign_bits

if TYPE_CHECKING:  # cantools takes long to import
    from cantools.database.can import Database, Message, Signal

    from .protection import Place

_PRIORITY = 0x1C000000
_PDU2 = 0xF0
_NAMED = 4
"""Largest number of signals that a warning names."""


@dataclass(frozen=True)
class Samples:
    """Decoded signal: frame positions (K,), physical values (K,), number of frames left out by reason."""

    frame: np.ndarray
    value: np.ndarray
    left_out: dict[str, int] = field(default_factory=dict)


def load_database(path: Path) -> Database:
    """Load a cantools database from a DBC or another form that cantools reads.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Database

    Raises
    ------
    InputError
        If the file cannot be read. The error names the file and the line.
    """
    import cantools
    from cantools.database.can import Database

    if not Path(path).is_file():
        raise InputError(
            path, "--dbc", "no such file", "a CAN database (.dbc, .arxml, .kcd, .sym, .dbf, .xls)"
        )
    try:
        database = cantools.database.load_file(path, strict=False, encoding=_encoding(Path(path)))
    except Exception as error:  # one exception class for each form of database
        sound = _sound_dbc(Path(path)) or _by_canmatrix(Path(path))
        if sound is not None:
            _name_shared_identifiers(sound, path)
            return _with_signs(sound, path)
        is_sheet = path.suffix.lower() in (".xls", ".xlsx")
        expected = "a CAN database" + " (pip install 'canmatrix[xls,xlsx]' reads sheets)" * is_sheet
        raise InputError(path, "", f"cannot be read ({str(error).splitlines()[0]})", expected) from None
    if not isinstance(database, Database):
        raise InputError(path, "--dbc", "describes diagnostics but no messages", "a CAN database")
    _name_shared_identifiers(database, path)
    return _with_signs(database, path)


def _sound_dbc(path: Path) -> Database | None:
    """Read the readable messages of a DBC and warn about the others; None if no message can be read."""
    if path.suffix.lower() != ".dbc":
        return None
    return _sound_lines(path.read_text(_encoding(path), errors="replace"), path)


def _sound_lines(text: str, path: Path) -> Database | None:
    """Read the readable messages of a DBC's text and warn about the others; None without any."""
    database, left_out = read_sound_lines(text)
    for line in left_out if database.messages else []:
        warnings.warn(f"{path}: {line}", InputWarning, stacklevel=1)
    return database if database.messages else None


def _by_canmatrix(path: Path) -> Database | None:
    """Read the largest matrix of a file with canmatrix; None if it reads none.

    canmatrix reads further forms (DBF, XLS, XLSX), older forms (SYM 5), and ARXML that cantools refuses.
    """
    import io

    import canmatrix.formats

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            matrices = canmatrix.formats.loadp(str(path))
            largest = max(matrices.values(), key=lambda matrix: len(matrix.frames))
            text = io.BytesIO()
            canmatrix.formats.dump(largest, text, "dbc")
    except Exception:  # canmatrix has an exception class for each form, and raises Python's own
        return None
    return _sound_lines(text.getvalue().decode("iso-8859-1"), path)


def _name_shared_identifiers(database: Database, path: Path) -> None:
    """Warn of messages with one identifier."""
    by_id: dict[tuple[int, bool], list[str]] = {}
    for message in database.messages:
        by_id.setdefault((message.frame_id, message.is_extended_frame), []).append(message.name)
    for (identifier, _), names in by_id.items():
        if len(names) > 1:
            what = f"messages {' and '.join(names)} have one identifier, {identifier:#x}"
            warnings.warn(f"{path}: {what}: each is read from all its frames", InputWarning, stacklevel=1)


def _with_signs(database: Database, path: Path) -> Database:
    """Make unsigned signals signed where their stated range is negative and within signed bits, and warn."""
    signed = []
    for message in database.messages:
        for signal in message.signals:
            low, high = signal.minimum, signal.maximum
            if (
                signal.is_signed
                or signal.is_float
                or signal.offset
                or low is None
                or high is None
                or not 4 <= signal.length <= 64
            ):
                continue
            half, scale = 2 ** (signal.length - 1), float(signal.scale)
            if scale > 0 and -(half + 1.5) * scale <= low < 0 < high <= (half + 0.5) * scale:
                signal.is_signed = True
                signed.append(f"{message.name}.{signal.name}")
    if signed:
        more = f" and {len(signed) - _NAMED} more" if len(signed) > _NAMED else ""
        warnings.warn(
            f"{path}: {', '.join(signed[:_NAMED])}{more}: read as signed because of the stated range",
            InputWarning,
            stacklevel=1,
        )
    return database


def contradicting_range(signal: Signal, both_signs: bool = False) -> str:
    """Explain why the stated range of a signal must be wrong.

    A range is wrong if both its ends are above, or both below, the ends that the raw bits can reach. It then
    forbids values that occur and allows impossible values. Such a database often states raw values. The range
    of a quantity with both signs is also wrong if it leaves out one sign that the bits have.

    Parameters
    ----------
    signal : Signal
    both_signs : bool, the quantity is known to have both signs, default False

    Returns
    -------
    str, empty if the range can be right
    """
    least, most = signal.minimum, signal.maximum
    if signal.is_float or least is None or most is None or not least < most:
        return ""
    whole = 2**signal.length
    ends = (-whole // 2, whole // 2 - 1) if signal.is_signed else (0, whole - 1)
    low, high = sorted(float(signal.offset) + float(signal.scale) * end for end in ends)
    room = abs(float(signal.scale))
    beyond = (least > low + room and most > high + room) or (least < low - room and most < high - room)
    one_sided = both_signs and low < -room and room < high and (least >= 0 or most <= 0)
    if not (beyond or one_sided):
        return ""
    return (
        f"signal {signal.name}: the database's range [{least:g}|{most:g}] contradicts its bits, which "
        f"reach from {low:g} to {high:g}; the range is ignored"
    )


def _encoding(path: Path) -> str | None:
    """Encoding of a text file that does not state its encoding: UTF-8 if valid, else that of Vector's tools.

    Units such as "°/s" need the right encoding.
    """
    if path.suffix.lower() not in {".dbc", ".sym"}:
        return None
    try:
        path.read_bytes().decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def own_database() -> Database:
    """Return the cantools database of our own DBC.

    Returns
    -------
    Database
    """
    from cantools.database.can import Database

    database = Database()
    database.add_dbc_string(dbc_text())
    return database


def is_j1939(message: Message) -> bool:
    """Tell if the database marks a message as a J1939 parameter group.

    Parameters
    ----------
    message : Message, of cantools

    Returns
    -------
    bool
    """
    return message.protocol == "j1939"


def find_frames(
    frames: Frames,
    message: Message,
    *,
    j1939: bool,
    channel: str | None = None,
    source_address: int | None = None,
    where: str = "",
) -> np.ndarray:
    """Find the frames of a message.

    Parameters
    ----------
    frames : Frames
    message : Message, of cantools
    j1939 : bool, find the frames by parameter group
    channel : str, optional, by default the channel that has the message
    source_address : int, optional, address of the sender
    where : str, name of the log in errors

    Returns
    -------
    ndarray (K,) of int, positions in the log

    Raises
    ------
    InputError
        If a message is on several channels, or a J1939 group comes from several senders, and neither is
        chosen.
    """
    if j1939 and message.is_extended_frame:
        matching = _j1939(frames, message, source_address, where)
    else:
        matching = frames.id == np.uint32(message.frame_id | (EXTENDED if message.is_extended_frame else 0))
    if channel is not None:
        if channel not in frames.channels:
            raise InputError(
                where, "channel", f"{channel} is not in the log", f"one of {', '.join(frames.channels)}"
            )
        matching &= frames.channel == frames.channels.index(channel)
    elif len(present := np.unique(frames.channel[matching])) > 1:
        raise InputError(
            where,
            message.name,
            "is on the channels " + " and ".join(frames.channels[c] for c in present),
            "--channel, or channel in the signal map, that chooses one",
        )
    return np.flatnonzero(matching)


def _j1939(frames: Frames, message, source_address: int | None, where: str) -> np.ndarray:
    peer_to_peer = (message.frame_id >> 16 & 0xFF) < _PDU2
    group_mask = np.uint32(0x9FFFFFFF & ~_PRIORITY & ~0xFF & (~0xFF00 if peer_to_peer else ~0))
    of_group = (frames.id & group_mask) == (np.uint32(message.frame_id | EXTENDED) & group_mask)
    sender = (frames.id & np.uint32(0xFF)).astype(np.uint8)
    present = np.unique(sender[of_group]).tolist()
    address = source_address if source_address is not None else message.frame_id & 0xFF
    if address not in present and source_address is None:
        if len(present) > 1:
            raise InputError(
                where,
                message.name,
                "comes from the source addresses " + ", ".join(f"{a:#04x}" for a in present),
                "source_address in the signal map, that chooses one",
            )
        return of_group
    return of_group & (sender == address)


def decode_signal(
    frames: Frames, positions: np.ndarray, message: Message, signal: Signal, *, j1939_codes: bool
) -> Samples:
    """Decode a signal in chosen frames.

    Three kinds of frames are left out and counted: too short frames, frames of another multiplex, and frames
    whose value is not finite.

    Parameters
    ----------
    frames : Frames
    positions : ndarray (K,) of int, frames in the log
    message : Message, of cantools
    signal : Signal, of cantools
    j1939_codes : bool, also leave out raw values above the data range

    Returns
    -------
    Samples, in the signal's unit
    """
    left_out: dict[str, int] = {}
    rows = frames.data[positions]
    keep = frames.length[positions] > max(byte for byte, _, _ in signal_pieces(signal))
    if not keep.all():
        left_out["frame too short"] = int((~keep).sum())
    keep &= _multiplexed(rows, message, signal)
    raw = _raw(rows, signal)
    if j1939_codes and not signal.is_signed and not signal.is_float and signal.length > 1:
        data = raw <= np.uint64(j1939_data_max(signal.length))
        if not (data | ~keep).all():
            left_out["not available or error"] = int((~data & keep).sum())
        keep &= data
    value = _number(raw, signal)
    if not keep.all():
        positions, value = positions[keep], value[keep]
    with np.errstate(invalid="ignore", over="ignore"):  # a float signal may have any value
        physical = value * float(signal.scale) + float(signal.offset)
    finite = np.isfinite(physical)
    if not finite.all():
        left_out["not a number"] = int((~finite).sum())
        positions, physical = positions[finite], physical[finite]
    return Samples(positions, physical, left_out)


def signed(frames: Frames, samples: Samples, message: Message, bit: Signal) -> Samples:
    """Give each sample of a magnitude the sign from a bit of the same frame.

    Parameters
    ----------
    frames : Frames
    samples : Samples, samples of the magnitude
    message : Message, of cantools
    bit : Signal, 0 for positive values, otherwise the value is negative

    Returns
    -------
    Samples
    """
    turned = decode_signal(frames, samples.frame, message, bit, j1939_codes=False)
    sign = np.ones(len(samples.frame))
    sign[np.searchsorted(samples.frame, turned.frame)] -= 2.0 * (turned.value != 0)
    return Samples(samples.frame, sign * samples.value, samples.left_out)


def decode_all(frames: Frames, database, where: str = "") -> dict[str, dict[str, Samples]]:
    """Decode every signal of a database; a sign bit of the same message gives a magnitude its sign.

    Parameters
    ----------
    frames : Frames
    database : Database, of cantools
    where : str, name of the log in errors

    Returns
    -------
    dict[str, dict[str, Samples]], by message and signal
    """
    decoded = {}
    for message in database.messages:
        j1939 = is_j1939(message)
        positions = find_frames(frames, message, j1939=j1939, where=where)
        if len(positions):
            of_message = {
                s.name: decode_signal(frames, positions, message, s, j1939_codes=j1939)
                for s in message.signals
            }
            for name, bit in sign_bits(message).items():
                of_message[name] = signed(frames, of_message[name], message, message.get_signal_by_name(bit))
            decoded[message.name] = of_message
    return decoded


def _multiplexed(rows: np.ndarray, message, signal) -> np.ndarray:
    """Mask (K,) of the frames that contain the signal; nested multiplexers are followed upwards."""
    present = np.ones(len(rows), bool)
    while signal.multiplexer_ids:
        selector = message.get_signal_by_name(signal.multiplexer_signal)
        present &= np.isin(_raw(rows, selector), np.array(signal.multiplexer_ids, np.uint64))
        signal = selector
    return present


def signal_pieces(signal: Signal | Place) -> list[tuple[int, int, int]]:
    """(byte, lowest bit in the byte, number of bits) for each byte of a signal, most significant first."""
    pieces, left = [], signal.length
    if signal.byte_order == "big_endian":  # start: the most significant bit
        byte, high = divmod(signal.start, 8)
        while left:
            bits = min(high + 1, left)
            pieces.append((byte, high + 1 - bits, bits))
            left, byte, high = left - bits, byte + 1, 7
        return pieces
    byte, low = divmod(signal.start, 8)  # start: the least significant bit
    while left:
        bits = min(8 - low, left)
        pieces.append((byte, low, bits))
        left, byte, low = left - bits, byte + 1, 0
    return pieces[::-1]


def _raw(rows: np.ndarray, signal) -> np.ndarray:
    """Unsigned raw values (K,); bytes beyond a frame read as 0, and the caller leaves such frames out."""
    raw = np.zeros(len(rows), np.uint64)
    for byte, low, bits in signal_pieces(signal):
        raw <<= np.uint64(bits)
        if byte < rows.shape[1]:
            raw |= (rows[:, byte] >> np.uint8(low) & np.uint8((1 << bits) - 1)).astype(np.uint64)
    return raw


def _number(raw: np.ndarray, signal) -> np.ndarray:
    if signal.is_float:
        unsigned, floating = {16: ("<u2", "<f2"), 32: ("<u4", "<f4"), 64: ("<u8", "<f8")}[signal.length]
        with np.errstate(invalid="ignore"):  # signalling NaN
            return raw.astype(unsigned).view(floating).astype(float)
    if signal.is_signed:
        left = np.uint64(64 - signal.length)
        return ((raw << left).view(np.int64) >> np.int64(64 - signal.length)).astype(float)
    return raw.astype(float)
