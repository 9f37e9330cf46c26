"""Make a catalogue for a car's own bus from the messages of its CAN database that the vehicle needs.

Every needed message of the car becomes a message of the catalogue, which the core's receiver supervises
(can.h). Each needed signal keeps its raw bits, as an unsigned number in Intel order. The module
``own_code.py`` generates the C code that converts a frame of the car into a frame of the catalogue. The car's
checksum and counter become the CRC and counter of E2E profile 11. A wrong checksum becomes a wrong CRC. A
repeated counter becomes a repeated counter.

There are limits. A signal has at most 16 bits and is in every frame of its message. A message has at most 64
bits of signals, or 52 bits with a checksum or a counter. There are at most 8 messages.
"""

from __future__ import annotations

import difflib
import re
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.errors import InputError, InputWarning
from ..vehicle.project import CanPlace, Checksum, OwnMessage, Project, Signal
from .catalogue import E2E_BITS, OWN_NODE, BusSignal, Catalogue, Message
from .codegen import ANY_PRIORITY
from .decode import contradicting_range, is_j1939, load_database, signal_pieces
from .logs import EXTENDED
from .protection import PROTECTIONS, Place, Protection
from .sign_bits import sign_bits

if TYPE_CHECKING:  # cantools takes long to import
    from cantools.database.can import Database
    from cantools.database.can import Message as CarMessage
    from cantools.database.can import Signal as CarSignal

    Bits = CarSignal | Place

OWN_ADDRESS, CAR_ADDRESS = 0xFC, 0x00
_PROPRIETARY_B = 0xFF00
"""First of the 256 parameter groups that J1939 reserves for manufacturers; the catalogue's messages use
them."""
_SIGNAL_BITS, _WIDEST_BITS, _FRAME_BITS = 16, 32, 64
"""Largest number of bits of a catalogue signal, of a car signal (carried by two of them), and of a frame."""
_ROUNDING = 0.5
"""Tolerance, in raw steps of a signal, at the ends of a stated range."""


@dataclass(frozen=True)
class Carried:
    """Signal of the car, or one half of it, with the catalogue signal that carries its bits.

    ``flip`` holds the raw bits to invert, so that the value is unsigned and increases with the physical
    value. ``sign`` is the bit with the sign of a magnitude. The value then counts from the middle of the
    range.
    """

    name: str
    car: Bits
    ours: BusSignal
    flip: int
    sign: Bits | None = None


@dataclass(frozen=True)
class CarriedMessage:
    """Message of the car, the catalogue message that carries it, and the places of checksum and counter.

    ``checksum_name`` is None for a message without a checksum. ``counters`` is the number of values that the
    counter takes. ``any_priority`` marks a J1939 group.
    """

    car: CarMessage
    ours: Message
    signals: list[Carried]
    any_priority: bool
    checksum_name: Checksum | None
    checksum: Bits | None
    counter: Bits | None
    counters: int
    data_ids: list[int]
    selector: Bits | None = None
    selected: tuple[int, ...] = ()

    @property
    def identifier(self) -> int:
        """Identifier of the car's message, with the flag EXTENDED."""
        return self.car.frame_id | (EXTENDED if self.car.is_extended_frame else 0)

    @property
    def mask(self) -> int:
        """Identifier bits that identify the message: all bits except the priority of a J1939 group."""
        return ANY_PRIORITY if self.any_priority and self.car.is_extended_frame else 0xFFFFFFFF


@dataclass(frozen=True)
class CarBus:
    """Part of a car's own bus that the receiver needs.

    Attributes
    ----------
    catalogue : Catalogue
    messages : list of CarriedMessage
    places : dict, message and signals of the catalogue by vehicle signal; the signals' sum is factor * value
    """

    catalogue: Catalogue
    messages: list[CarriedMessage]
    places: dict[str, tuple[Message, list[BusSignal], float]]


def own_bus(project: Project, signals: Sequence[Signal] | None = None) -> CarBus:
    """Describe the own bus of a vehicle with ``[can]``.

    Parameters
    ----------
    project : Project
    signals : sequence of Signal, optional, needed signals, by default all

    Returns
    -------
    CarBus

    Raises
    ------
    InputError
        If the database lacks a needed entry, or if a signal cannot be carried.
    """
    where = f"vehicle {project.name}"
    if project.can is None:
        raise InputError(where, "can", "no [can] table", "a [can] table with dbc")
    used: dict[str, list[str]] = {}
    needed = project.signals if signals is None else signals
    for s in needed:
        place = _place(s.name, s.can, where)
        used.setdefault(place.message, []).extend((place.signal, *place.plus))
    database, path = _database(project.can.dbc), project.can.dbc
    signed = {
        (s.can.message, s.can.signal)
        for s in (*project.inputs, *project.outputs)
        if s.can is not None and not s.can.plus and s.min < 0 < s.max
    }
    messages = []
    for number, (name, names) in enumerate(used.items()):
        settings = project.can.messages.get(name, OwnMessage())
        car = _car_message(database, name, path, where)
        both_signs = [n for n in names if (name, n) in signed]
        messages.append(
            _carried(car, list(dict.fromkeys(names)), settings, number, f"{where}, {path}", both_signs)
        )
    catalogue = Catalogue.model_validate(
        {
            "schema": 1,
            "nodes": [
                {"name": OWN_NODE, "address": OWN_ADDRESS, "comment": "the receiver"},
                {"name": "CAR", "address": CAR_ADDRESS, "comment": "every sender of the car"},
            ],
            "messages": [m.ours.model_dump() for m in messages],
        }
    )
    ours = {m.car.name: (catalogue.message(m.ours.name), m.signals) for m in messages}
    places = {}
    for s in needed:
        if s.can is not None:
            message, carried = ours[s.can.message]
            summands = (s.can.signal, *s.can.plus)
            halves = [c.ours for n in summands for c in carried if c.name == n]
            places[s.name] = (message, halves, s.can.factor)
    return CarBus(catalogue, messages, places)


def refused_values(project: Project, values: Mapping[str, np.ndarray]) -> list[str]:
    """Name the signals of whose values the receiver of the own bus would refuse some.

    Parameters
    ----------
    project : Project, with ``[can]``
    values : Mapping, values (N,) by vehicle signal, in their units

    Returns
    -------
    list of str, a sentence each

    Raises
    ------
    InputError
        As `own_bus`.
    """
    sentences = []
    for name, (message, halves, factor) in own_bus(project).places.items():
        accepted = halves[0].supervise
        if accepted is None or len(halves) > 1 or name not in values:
            continue
        on_bus = factor * values[name][np.isfinite(values[name])]
        step = abs(halves[0].scale)
        outside = int(((on_bus < accepted.min - step) | (on_bus > accepted.max + step)).sum())
        if outside:
            sentences.append(
                f"{name}: {outside} of {len(on_bus)} samples of the drives lie outside the range of the "
                f"database, [{accepted.min:g}|{accepted.max:g}] in {message.title.split()[0]}; an ECU that "
                "is generated from it refuses such frames"
            )
    return sentences


@dataclass(frozen=True)
class Sent:
    """Message of the car with values of a vector, such as the demands of a controller.

    ``signals`` holds the signals whose sum carries an element, its index, and the factor from element to bus
    value.
    """

    message: CarriedMessage
    signals: list[tuple[list[CarSignal], int, float]]


def demand_messages(project: Project) -> list[Sent]:
    """List the messages of a vehicle's own bus that carry its demands, as can.demand places them.

    Raises InputError if the database lacks a message or signal, or a signal cannot be sent.
    """
    assert project.can is not None
    where, path = f"vehicle {project.name}, can.demand", project.can.dbc
    by_message: dict[str, list[tuple[str, int, float]]] = {}
    for k, s in enumerate(project.inputs):
        place = project.can.demand[s.name]
        if place.plus:
            raise InputError(where, s.name, f"plus = {list(place.plus)}", "one signal")
        by_message.setdefault(place.message, []).append((place.signal, k, place.factor))
    demands = []
    for number, (name, signals) in enumerate(by_message.items()):
        car = _car_message(_database(path), name, path, where)
        settings = project.can.messages.get(name, OwnMessage())
        carried = _carried(car, [signal for signal, *_ in signals], settings, number, f"{where}, {path}")
        signs = sign_bits(car)
        for signal, *_ in signals:
            if signal in signs:
                raise InputError(where, signal, f"has its sign in {signs[signal]}", "a signed signal")
        demands.append(Sent(carried, [([_car_signal(car, s, where)], k, factor) for s, k, factor in signals]))
    return demands


def sensor_messages(project: Project, bus: CarBus, signals: Sequence[Signal]) -> list[Sent]:
    """List the messages of a vehicle's own bus that carry ``signals``, with these as elements."""
    where = f"vehicle {project.name}"
    sent: list[Sent] = []
    for m in bus.messages:
        of_message = [(k, s.can) for k, s in enumerate(signals) if s.can and s.can.message == m.car.name]
        places = [
            ([_car_signal(m.car, name, where) for name in (c.signal, *c.plus)], k, c.factor)
            for k, c in of_message
        ]
        sent.append(Sent(m, places))
    return sent


def _place(name: str, place: CanPlace | None, where: str) -> CanPlace:
    if place is None:
        raise InputError(where, f"signal {name}", "no place on the bus", "can = { message, signal, factor }")
    return place


@cache
def _database(path: str) -> Database:
    return load_database(Path(path))


def _car_message(database: Database, name: str, path: str, where: str) -> CarMessage:
    matches = [m for m in database.messages if m.name == name]
    if len(matches) != 1:
        near = difflib.get_close_matches(name, [m.name for m in database.messages], n=3, cutoff=0.4)
        raise InputError(
            f"{where}, {path}",
            f"message {name}",
            f"{len(matches) or 'no'} message(s) of this name",
            f"one{', such as ' + ', '.join(near) if near else ''}",
        )
    return matches[0]


def _car_signal(car: CarMessage, name: str, where: str) -> CarSignal:
    signal = next((s for s in car.signals if s.name == name), None)
    if signal is None:
        raise InputError(
            where,
            f"message {car.name}",
            f"no signal {name}",
            f"one of {', '.join(s.name for s in car.signals)}",
        )
    return signal


def _carried(
    car: CarMessage,
    names: list[str],
    settings: OwnMessage,
    number: int,
    where: str,
    both_signs: Collection[str] = (),
) -> CarriedMessage:
    """Make message ``number`` of the catalogue with the signals ``names`` of ``car``, in this order.

    ``both_signs`` names signals of quantities that have both signs.
    """
    place = f"message {car.name}"
    period_ms = settings.period_ms or car.cycle_time
    if not period_ms:
        raise InputError(where, place, "the database has no cycle time", f"can.messages.{car.name}.period_ms")
    checksum, counter, counters = _protection(car, settings, where)
    protected = checksum is not None or counter is not None
    start, signals = E2E_BITS if protected else 0, []
    signs = sign_bits(car)
    for k, name in enumerate(names):
        signal = _car_signal(car, name, where)
        sign = _car_signal(car, signs[name], where) if name in signs else None
        carried_name = f"s{k}_" + _word(name).lower()
        signals += _carry(signal, sign, carried_name, start, f"{where}, {place}", name in both_signs)
        start = signals[-1].ours.start + signals[-1].ours.length
    selector, selected = _multiplex(car, names, counter is not None, f"{where}, {place}")
    if start > _FRAME_BITS:
        raise InputError(
            where,
            place,
            f"{', '.join(names)} have {sum(c.ours.length for c in signals)} bits",
            f"at most {_FRAME_BITS - (E2E_BITS if protected else 0)} bits of one message",
        )
    group = _PROPRIETARY_B + number
    ours = Message(
        name=f"M{number}_" + _word(car.name).upper(),
        title=f"{car.name} of the car's own bus",
        pgn=group,
        id=0x18 << 24 | group << 8 | CAR_ADDRESS,
        period_ms=int(period_ms),
        e2e={"profile": 11, "data_id": number} if protected else None,
        signals=[c.ours for c in signals],
    )
    data_id = settings.data_id
    data_ids = data_id if isinstance(data_id, list) else [] if data_id is None else [data_id]
    return CarriedMessage(
        car,
        ours,
        signals,
        is_j1939(car),
        settings.checksum,
        checksum,
        counter,
        counters,
        data_ids,
        selector,
        selected,
    )


def _multiplex(
    car: CarMessage, names: list[str], counted: bool, where: str
) -> tuple[CarSignal | None, tuple[int, ...]]:
    """Selector of the multiplex that contains ``names``, and its values for them; None and () without one.

    Raises InputError if no frame has all the signals, if the selector is itself multiplexed, or if the
    message has a counter. A multiplex would see only some values of the counter.
    """
    multiplexed = [s for name in names if (s := _car_signal(car, name, where)).multiplexer_ids]
    if not multiplexed:
        return None, ()
    selector = _car_signal(car, multiplexed[0].multiplexer_signal or "", where)
    selected = set(multiplexed[0].multiplexer_ids or ())
    for signal in multiplexed:
        selected &= set(signal.multiplexer_ids or ()) if signal.multiplexer_signal == selector.name else set()
    what = ", ".join(s.name for s in multiplexed)
    if not selected or selector.multiplexer_ids or selector.is_float or selector.length > _SIGNAL_BITS:
        raise InputError(
            where,
            what,
            "are never in the same frame",
            "signals of one multiplex whose selector is not itself multiplexed",
        )
    if counted:
        raise InputError(
            where, what, "is multiplexed in a message with a counter", "a message without a counter"
        )
    return selector, tuple(sorted(selected))


def _word(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9]", "_", name)


def _carry(
    signal: CarSignal, sign: CarSignal | None, name: str, start: int, where: str, both_signs: bool
) -> list[Carried]:
    """Carry a signal of the car as one unsigned signal, or as the sum of two, from bit ``start`` on."""
    widest = _SIGNAL_BITS - 1 if sign else _WIDEST_BITS
    if signal.is_float or signal.length > widest or (sign and signal.offset):
        raise InputError(
            where,
            f"signal {signal.name}",
            f"has {signal.length} bits{' of a float' if signal.is_float else ''}"
            + (f", an offset of {float(signal.offset):g}, and its sign in {sign.name}" if sign else ""),
            f"an integer of at most {widest} bits" + (" without an offset" if sign else ""),
        )
    scale, offset = float(signal.scale), float(signal.offset)
    length = signal.length + (1 if sign else 0)
    top, whole = 1 << (length - 1), (1 << length) - 1
    flip = top if signal.is_signed else 0
    if signal.is_signed or sign:
        offset -= scale * top
    if scale < 0:
        flip, offset, scale = flip ^ whole, offset + scale * whole, -scale
    accepted = _accepted(signal, offset, offset + scale * whole, both_signs and not sign)
    if sign and accepted:
        end = max(abs(accepted["min"]), abs(accepted["max"]))
        accepted = {"min": max(-end, offset), "max": min(end, offset + scale * whole)}

    def ours(
        part: str, first: int, bits: int, step: float, least: float, supervised: dict | None
    ) -> BusSignal:
        return BusSignal(
            name=name + part,
            start=first,
            length=bits,
            scale=step,
            offset=least,
            unit=signal.unit or "",
            positive="",
            coding="plain",
            supervise=supervised,
        )

    if length <= _SIGNAL_BITS:
        return [Carried(signal.name, signal, ours("", start, length, scale, offset, accepted), flip, sign)]
    low = (1 << _SIGNAL_BITS) - 1
    upper, lower = _halves(signal)
    room = scale * low  # largest value of the lower half
    if accepted:
        accepted = {"min": max(accepted["min"] - room, offset), "max": accepted["max"]}
    high = ours("_high", start, upper.length, scale * (low + 1), offset, accepted)
    rest = ours("_low", start + upper.length, _SIGNAL_BITS, scale, 0.0, None)
    return [
        Carried(signal.name, upper, high, flip >> _SIGNAL_BITS),
        Carried(signal.name, lower, rest, flip & low),
    ]


def _halves(signal: CarSignal) -> tuple[Place, Place]:
    """Places of a signal's upper bits and of its lowest _SIGNAL_BITS bits."""
    above = signal.length - _SIGNAL_BITS
    if signal.byte_order == "little_endian":
        return Place(signal.start + _SIGNAL_BITS, above), Place(signal.start, _SIGNAL_BITS)
    down = 8 * (signal.start // 8) + 7 - signal.start % 8 + above  # counted from the first bit of the frame
    lower = 8 * (down // 8) + 7 - down % 8
    return Place(signal.start, above, "big_endian"), Place(lower, _SIGNAL_BITS, "big_endian")


def _accepted(
    signal: CarSignal, low: float, high: float, both_signs: bool = False
) -> dict[str, float] | None:
    """Range of the database, rounded and limited to the raw values' range ``low`` to ``high``.

    The result is None if the database states no range, or a range that must be wrong.
    """
    if signal.minimum is None or signal.maximum is None or not signal.minimum < signal.maximum:
        return None
    if why := contradicting_range(signal, both_signs):
        warnings.warn(why, InputWarning, stacklevel=1)
        return None
    rounding = _ROUNDING * abs(float(signal.scale))
    least, most = max(low, float(signal.minimum) - rounding), min(high, float(signal.maximum) + rounding)
    return {"min": least, "max": most} if least < most else None


def _protection(car: CarMessage, settings: OwnMessage, where: str) -> tuple[Bits | None, Bits | None, int]:
    """Places of checksum and counter (None without one), and the number of values of the counter.

    Raises InputError if the settings do not fit the message.
    """
    place = f"can.messages.{car.name}"
    named = _named(car, settings.counter, "COUNTER", f"{place}.counter", where)
    if settings.checksum is None:
        for key, value in (("checksum_signal", settings.checksum_signal), ("data_id", settings.data_id)):
            if value is not None:
                raise InputError(where, f"{place}.{key}", "given without checksum", "checksum = its name")
        return None, named, 0 if named is None else 1 << named.length
    kind = PROTECTIONS[settings.checksum]
    checksum = _named(car, settings.checksum_signal, "CHECKSUM", f"{place}.checksum_signal", where)
    checksum = checksum or _at(kind.checksum, car)
    if checksum is None:
        raise InputError(where, place, f"{settings.checksum} has no place of its own", "checksum_signal")
    _require_fit(kind, checksum, car, settings, where)
    counter = named or kind.counter
    if kind.data_ids > 1 and counter != kind.counter and (counter is None or counter.length != 4):
        raise InputError(where, place, "the data id depends on the counter", "a counter of 4 bits")
    return checksum, counter, 0 if counter is None else kind.counters or 1 << counter.length


def _named(car: CarMessage, stated: str | None, usual: str, field: str, where: str) -> Any:
    """Signal with the stated name, otherwise the one with the usual name; None if there is neither."""
    name = stated or usual
    signal = next((s for s in car.signals if s.name == name), None)
    if signal is None and stated is not None:
        raise InputError(
            where, field, f"no signal {stated}", f"one of {', '.join(s.name for s in car.signals)}"
        )
    if signal is not None and (signal.length < 2 or signal.length > _SIGNAL_BITS):
        raise InputError(where, field, f"{name} has {signal.length} bit(s)", f"2 to {_SIGNAL_BITS} bits")
    return signal


def _at(place: Place | None, car: CarMessage) -> Place | None:
    if place is None or place.start >= 0:
        return place
    return Place(8 * car.length + place.start, place.length, place.byte_order)


def _require_fit(kind: Protection, checksum: Bits, car: CarMessage, settings: OwnMessage, where: str) -> None:
    """Raise InputError unless the checksum's width, bytes, frame length and data ids fit its definition."""
    place = f"can.messages.{car.name}"
    pieces = signal_pieces(checksum)
    if checksum.length != kind.bits or len(pieces) != max(kind.bits // 8, 1) or pieces[0][0] >= car.length:
        raise InputError(
            where,
            place,
            f"the checksum has {checksum.length} bits from bit {checksum.start} on",
            f"{kind.bits} bits within {max(kind.bits // 8, 1)} byte(s) of the frame for {settings.checksum}",
        )
    if kind.lengths and car.length not in kind.lengths:
        raise InputError(
            where, place, f"{car.length} bytes", f"a frame of {', '.join(map(str, kind.lengths))} bytes"
        )
    data_id = settings.data_id
    count = len(data_id) if isinstance(data_id, list) else 0 if data_id is None else 1
    if count != kind.data_ids or isinstance(data_id, list) != (kind.data_ids > 1):
        expected = {0: "none", 1: "one number"}.get(kind.data_ids, f"a list of {kind.data_ids}")
        raise InputError(where, f"{place}.data_id", f"{count} given", f"{expected} for {settings.checksum}")
