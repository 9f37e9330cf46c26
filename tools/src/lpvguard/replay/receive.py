"""Sample raw CAN logs with the compiled receiver: supervision and decoder of lib/, as on the ECU.

can/logs.py reads the logs. replayer.py passes the samples to the monitor.

There is one tick per sample period of the vehicle. A tick reads the newest accepted value of every signal, as
in lpvg_ecu_step; nothing is interpolated. A tick gives a sample if every message that carries a signal of the
vehicle is live (can.h). Otherwise there is a gap. A tick lies half a period after the mean arrival time of
the fastest of these messages. Jitter below half a period then moves no frame to another tick. A log of the
simulator gives the samples that its ECU had, except that the demand has the resolution of the bus.

Frames of a car's own bus (``[can]`` of the project file) are first converted to frames of a catalogue
(can/own.py).

A clock that goes back by more than REORDER_S, or forward by more than CLOCK_JUMP_S, is a jump. A jump is
replayed as a pause of PAUSE_S.
"""

from __future__ import annotations

import ctypes
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ..base import native
from ..base.errors import InputError
from ..base.runs import runs
from ..can.bus import REFERENCE, take_case
from ..can.catalogue import BusSignal, Catalogue, Message, load_catalogue
from ..can.codegen import ANY_PRIORITY, SOURCE, codec_files, messages_in_order
from ..can.logs import EXTENDED, Frames
from ..can.own import CarBus, own_bus
from ..can.own_code import SOURCE as OWN_SOURCE
from ..can.own_code import own_files
from ..core.compiled import EVENTS, SUPERVISION, library_root
from ..drives.resample import clock_of
from ..vehicle.project import Project, Signal

LIVE = SUPERVISION.index("live")
CLOCK_JUMP_S = 60.0
PAUSE_S = 1.0


@dataclass(frozen=True)
class Received:
    """A sampled log: t (N,) [s] from 0, values (N, signals), present (N,) bool, and the report."""

    t: np.ndarray
    values: np.ndarray
    present: np.ndarray
    report: dict[str, Any]


@dataclass(frozen=True)
class _Place:
    """Place of a vehicle's signal on the bus: the sum of the listed bus signals is factor * value."""

    message: Message
    signals: tuple[BusSignal, ...]
    factor: float


@dataclass(frozen=True)
class _Bus:
    """The bus of a vehicle.

    ``sent`` gives each message's name on the bus, its identifier with flags, and the identifying bits.
    ``files`` is the generated C.
    """

    catalogue: Catalogue
    places: list[_Place]
    sent: dict[str, tuple[str, int, int]]
    files: dict[str, str]


class Receiver:
    """Compiled receiver of a vehicle for speed, inputs, outputs and gates, in this order.

    It reads frames of the catalogue, or of the car's own bus.

    Parameters
    ----------
    project : Project
    command : bool, add a column with the driver's yaw-rate command if the bus has it, default False

    Raises
    ------
    InputError
        If a signal has no place on the bus, or no compiler is available.
    """

    def __init__(self, project: Project, command: bool = False):
        self.project = project
        self.signals = project.recorded
        if project.can is None:
            bus = _our_bus(self.signals, load_catalogue())
        else:
            bus = _car_bus(self.signals, own_bus(project))
        self._rules = messages_in_order(bus.catalogue)
        self._sent = bus.sent
        self.needed = [m for m in self._rules if any(m is p.message for p in bus.places)]
        self._places = [*bus.places, *([_command_place(bus.catalogue)] if command else [])]
        self.n_rules = len(self._rules)
        library = _library(project.name, _take_source(self._places), *sorted(bus.files.items()))
        self.library = ctypes.CDLL(str(library))
        sizes = (ctypes.c_uint32 * 2)()
        self.library.lpvgb_receiver_sizes(sizes)
        if tuple(sizes) != (self.n_rules, len(EVENTS)):
            raise AssertionError("the events of can.h and of this module differ")

    def receive(self, frames: Frames, where: str | Path, *, channel: str | None = None) -> Received:
        """Sample a log.

        Raises InputError if the log holds no needed message. Raises it also if the messages come from several
        channels and ``channel`` chooses none.
        """
        frames, ours = self._one_channel(frames.of_channel(channel, where), where)
        fastest = min(m.period_ms for m in self.needed) * 1000
        t_us, order, jumps = _one_clock(frames.t_ns, ours, fastest)
        period = round(self.project.Ts_s * 1e6)
        # The first sample comes after the first frame of a counted message. The time before it is not a gap.
        first = round(int(t_us[np.flatnonzero(ours[order])[0]]) / fastest) * fastest + fastest // 2
        ticks = max(int(t_us[-1] - first) // period + 1, 1)
        running = self.running(min(int(t_us[0]), first), where)
        values, states = running.take(t_us, frames.at(order), first, ticks)
        counts = running.counts
        live, present = self.presence(values, states)
        t = np.arange(ticks) * self.project.Ts_s
        report = {
            "channel": frames.channels[int(frames.channel[0])],
            **self.counted(counts),
            "not_frames": frames.left_out,
            "gaps": self._gaps(t, live, present),
            "clock_jumps": jumps,
        }
        return Received(t, values, present, report)

    def running(self, start_us: int, where: str | Path) -> RunningReceiver:
        """Start a receiver whose clock begins at ``start_us`` [us]; it takes frames in pieces.

        Raises InputError when the supervision refuses the start time.
        """
        return RunningReceiver(self, start_us, where)

    def presence(self, values: np.ndarray, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Masks: (needed, N) each needed message is live; (N,) the sample passes all gates.

        ``values`` (N, columns) and ``states`` (N, rules) come from ``RunningReceiver.take``.
        """
        live = np.array([states[:, self._rules.index(m)] == LIVE for m in self.needed])
        present = live.all(axis=0) & np.isfinite(values[:, : len(self.signals)]).all(axis=1)
        for i, s in enumerate(self.signals):
            if s.role == "gate":
                present &= (values[:, i] >= s.min) & (values[:, i] <= s.max)
        return live, present

    def counted(self, counts: np.ndarray) -> dict[str, Any]:
        """Number of frames by outcome, from ``counts`` (rules + 1, events).

        The key "messages" holds each needed or seen message, and "other" holds the sum of all others.
        """
        return {"messages": self._counted(counts), "other": _named(counts[-1])}

    def _one_channel(self, frames: Frames, where: str | Path) -> tuple[Frames, np.ndarray]:
        """Frames of the single channel with needed messages, and the mask (N,) of these frames.

        Raises InputError when no channel has needed messages, or several channels have them.
        """
        ours = self.ours(frames)
        if not ours.any():
            raise InputError(
                where,
                "",
                "holds no frame of " + ", ".join(map(self.called, self.needed)),
                f"a log of the bus of vehicle {self.project.name}; `lpvguard ingest --dbc` takes other buses",
            )
        channels = [frames.channels[c] for c in np.unique(frames.channel[ours])]
        if len(channels) > 1:
            raise InputError(
                where,
                "channel",
                f"the vehicle's messages come from {', '.join(channels)}",
                "the option --channel",
            )
        frames = frames.of_channel(channels[0], where)
        return frames, self.ours(frames)

    def on_bus(self, message: Message) -> str:
        """Name of a message on the bus."""
        return self._sent[message.name][0]

    def called(self, message: Message) -> str:
        """Name and identifier on the bus of a needed message, as text."""
        name, identifier, _ = self._sent[message.name]
        return f"{name} ({identifier & ~EXTENDED:0{8 if identifier & EXTENDED else 3}X})"

    @property
    def columns(self) -> int:
        """Columns of the values that ``RunningReceiver.take`` returns."""
        return len(self._places)

    def ours(self, frames: Frames) -> np.ndarray:
        """Mask (N,) of the frames of needed messages; J1939 groups match at any priority."""
        ours = np.zeros(len(frames.id), bool)
        for m in self.needed:
            _, identifier, mask = self._sent[m.name]
            ours |= (frames.id & np.uint32(mask)) == np.uint32(identifier & mask)
        return ours

    def _counted(self, counts: np.ndarray) -> dict[str, dict[str, int]]:
        """Frames and periods by kind, for needed messages and messages in the log."""
        missed = EVENTS.index("missed")
        return {
            self._sent[m.name][0]: _named(row)
            for m, row in zip(self._rules, counts, strict=False)
            if m in self.needed or row[:missed].any()
        }

    def _gaps(self, t: np.ndarray, live: np.ndarray, present: np.ndarray) -> list[dict[str, Any]]:
        """Stretches without a sample, from their first tick to the next tick with a sample or the end."""
        edges = runs(~present)
        return [
            {
                "from_s": round(float(t[a]), 6),
                "to_s": round(float(t[min(b, len(t) - 1)]), 6),
                "messages": [
                    self._sent[m.name][0]
                    for m, row in zip(self.needed, live, strict=False)
                    if not row[a:b].all()
                ],
            }
            for a, b in edges
        ]


class RunningReceiver:
    """A running receiver of a vehicle; frames arrive in one or several pieces.

    Parameters
    ----------
    receiver : Receiver
    start_us : int, us, start of the receiver's clock
    where : str or Path, name of the log in errors
    """

    def __init__(self, receiver: Receiver, start_us: int, where: str | Path):
        self._receiver, self._lib, self._where = receiver, receiver.library, where
        self._period_us = round(receiver.project.Ts_s * 1e6)
        self._lib.lpvgb_receiver_create.restype = ctypes.c_void_p
        self._lib.lpvgb_receive.restype = ctypes.c_int64
        n_values = ctypes.c_int64(receiver.columns)
        handle = self._lib.lpvgb_receiver_create(ctypes.c_int64(start_us), n_values)
        self._handle = ctypes.c_void_p(handle)
        if not handle:
            self._refused()
        self.counts = np.zeros((receiver.n_rules + 1, len(EVENTS)), np.uint32)
        """(rules + 1, events) number of frames so far by outcome."""

    def __del__(self) -> None:
        self._lib.lpvgb_receiver_destroy(self._handle)

    def take(
        self, t_us: np.ndarray, frames: Frames, first_us: int, ticks: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Process frames with increasing times t_us (N,) [us], up to the last of ``ticks`` ticks.

        There is one tick per sample period from ``first_us`` [us] on. Returns values (ticks, columns), NaN
        before a signal's first value, and states of the supervision (ticks, rules). Raises InputError when
        the supervision refuses a time.
        """
        values = np.empty((ticks, self._receiver.columns))
        states = np.empty((ticks, self._receiver.n_rules), np.uint8)
        log = (t_us, frames.id, frames.length, frames.data)
        arrays: list[np.ndarray] = [np.ascontiguousarray(a) for a in log]
        results: list[np.ndarray] = [values, states, self.counts]
        done = self._lib.lpvgb_receive(
            self._handle,
            ctypes.c_int64(len(t_us)),
            *map(_pointer, arrays),
            ctypes.c_int64(arrays[3].shape[1]),
            ctypes.c_int64(first_us),
            ctypes.c_int64(self._period_us),
            ctypes.c_int64(ticks),
            *map(_pointer, results),
        )
        if done < 0:
            self._refused()
        return values, states

    def _refused(self) -> NoReturn:
        raise InputError(
            self._where, "", "the receiver refused the log's times", "times from 0 to 292000 years"
        )


def _our_bus(signals: list[Signal], catalogue: Catalogue) -> _Bus:
    """The bus of the catalogue, whose identifiers match in all bits but the priority."""
    return _Bus(
        catalogue,
        [_place(s, catalogue) for s in signals],
        {m.name: (m.name, m.id | EXTENDED, ANY_PRIORITY) for m in catalogue.messages},
        codec_files(catalogue),
    )


def _command_place(catalogue: Catalogue) -> _Place:
    """Place of the driver's command on the bus of the catalogue."""
    message = catalogue.message(REFERENCE.message)
    signal = next(s for s in message.signals if s.name == REFERENCE.signal)
    return _Place(message, (signal,), REFERENCE.factor)


def _car_bus(signals: list[Signal], bus: CarBus) -> _Bus:
    """The car's own bus, carried by messages of a derived catalogue."""
    places = [bus.places[s.name] for s in signals]
    return _Bus(
        bus.catalogue,
        [_Place(message, tuple(carried), factor) for message, carried, factor in places],
        {m.ours.name: (m.car.name, m.identifier, m.mask) for m in bus.messages},
        {**codec_files(bus.catalogue), **own_files(bus)},
    )


def _place(signal: Signal, catalogue: Catalogue) -> _Place:
    """Place of a vehicle's signal on the bus of the catalogue; InputError if it has none."""
    where = f"vehicle signal {signal.name}"
    if signal.can is None:
        raise InputError(
            where, "can", "no place on the bus", "can = { message, signal, factor } in the project file"
        )
    message = catalogue.message(signal.can.message)
    if message.codec != "generated":
        raise InputError(where, "can", f"{message.name} is packed by the core", "another message")
    by_name = {s.name: s for s in message.signals}
    names = (signal.can.signal, *signal.can.plus)
    for name in names:
        if name not in by_name:
            raise InputError(
                where,
                "can",
                f"{message.name}.{name} is not in the CAN catalogue",
                f"one of {', '.join(by_name)}",
            )
    return _Place(message, tuple(by_name[name] for name in names), signal.can.factor)


def _take_source(places: list[_Place]) -> str:
    """C code of lpvgb_take: value = bus value / factor, in the float arithmetic of the ECU (can/bus.py)."""
    cases = ""
    for name in dict.fromkeys(p.message.name for p in places):
        numbered = [(i, p) for i, p in enumerate(places) if p.message.name == name]
        statements = [
            f"values[{i}] = (double)({_sum(p)} * (float){1.0 / p.factor:.17g});" for i, p in numbered
        ]
        cases += take_case(numbered[0][1].message, [s for _, p in numbered for s in p.signals], statements)
    return (
        '#include "lpvg_can_codec.h"\n\n'
        'extern "C" void lpvgb_take(double* values, uint8_t index, const lpvg_can_frame_t* frame)\n'
        f"{{\n    switch (index) {{\n{cases}    default:\n        break;\n    }}\n}}\n"
    )


def _sum(place: _Place) -> str:
    names = " + ".join(s.name for s in place.signals)
    return names if len(place.signals) == 1 else f"({names})"


@cache
def _library(name: str, take: str, *generated: tuple[str, str]) -> Path:
    root = library_root()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for file, text in (*generated, ("take.cpp", take)):
            (folder / file).write_text(text, encoding="utf-8")
        own = [folder / OWN_SOURCE] if (folder / OWN_SOURCE).is_file() else []
        sources = [
            folder / SOURCE,
            *own,
            folder / "take.cpp",
            root / "src" / "guard" / "can.cpp",
            Path(__file__).with_name("receiver.cpp"),
        ]
        try:
            return native.compile_shared(
                sources,
                flags=("-std=c++17", "-O2", "-ffp-contract=off", *(["-DLPVGB_OWN_BUS"] if own else [])),
                include_dirs=[root / "include", folder],
                name=f"receiver_{name}",
            )
        except native.NativeError as error:
            raise InputError(
                f"vehicle {name}", "compiling the CAN receiver", str(error).strip(), "a C++17 compiler"
            ) from None


def _one_clock(
    t_ns: np.ndarray, ours: np.ndarray, period_us: int
) -> tuple[np.ndarray, np.ndarray, list[dict]]:
    """Increasing times [us] from 0, the order of the frames, and the jumps of the log's clock.

    Every stretch between jumps is shifted. The needed frames then arrive at multiples of ``period_us`` in the
    circular mean.
    """
    clock = clock_of(t_ns, CLOCK_JUMP_S)
    times: list[np.ndarray] = []
    order: list[np.ndarray] = []
    end = 0
    for a, b in zip(clock.cuts, clock.cuts[1:], strict=False):
        at = a + np.argsort(t_ns[a:b], kind="stable")
        t = (t_ns[at] - t_ns[at[0]]) // 1000
        phase = phase_us(t[ours[at]] if ours[at].any() else t, period_us)
        start = -(-end // period_us) * period_us + (PAUSE_S * 1e6 if times else period_us)
        times.append(t + round(start - phase))
        order.append(at)
        end = int(times[-1][-1])
    return np.concatenate(times), np.concatenate(order), clock.jumps


def phase_us(t_us: np.ndarray, period_us: int) -> float:
    """Compute the circular mean of times within a period.

    Parameters
    ----------
    t_us : ndarray (N,), us
    period_us : int, us

    Returns
    -------
    float, us
    """
    return float(np.angle(np.exp(2j * np.pi / period_us * t_us).mean()) / (2 * np.pi) * period_us)


def _named(row: np.ndarray) -> dict[str, int]:
    return {name: int(n) for name, n in zip(EVENTS, row, strict=False) if n}


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)
