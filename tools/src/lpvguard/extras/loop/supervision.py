"""Compute the required states of the bus supervision from the frames and the message table.

The rules are in lib/include/lpvguard/can.h. This module follows the rules, not lib/src/guard/can.cpp, so that
the two implementations test each other. Each message starts with the state "off" and has its period from the
table:

    off -> live         RECOVER_FRAMES good frames in a row
    live -> hold -> off the newest good frame is older than HOLD_MISSED + 1/2, then OFF_MISSED + 1/2 periods;
                        a good frame ends "hold"
    live, hold -> off   the score reaches SCORE_OFF; a bad frame adds 1, a good frame subtracts 1, down to 0;
                        recovery sets the score to 0
    live, hold -> off   WINDOW_BAD of the newest WINDOW frames were bad
    any -> off          ARRIVALS frames came within ARRIVALS_PERIODS periods; all frames are then bad until
                        ARRIVALS frames take longer
    any -> off          a bus-off report

A frame is bad when one of these holds:

    time        it comes within a quarter of a period after the previous one (babbling)
    length      its length is not 8 bytes
    checksum    its checksum is wrong, if the table states a checksum
    counter     its counter repeats, is 15, or increases by more than COUNTER_STEP, if the table states one
    signal      a supervised signal is "error", "not available" or outside its range, or it has changed by
                more than its rate allows, plus one raw step, since the newest good frame

In the state "off", the counter and the values are forgotten.

At every tick, the ECU reports the worst state of the messages that its vehicle needs. It also reports "off"
if all messages are live, but a newest good value is outside the range of the vehicle's signal table. The ECU
refuses such a sample.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ...base.runs import runs
from ...can.bus import OVERRIDE, REFERENCE
from ...can.catalogue import BusSignal, Message, load_catalogue
from ...can.codegen import ANY_PRIORITY, GAP_FRACTION
from ...can.logs import EXTENDED, Frames
from ...can.play import COUNTERS, e2e_crc
from ...core.compiled import SUPERVISION
from ...vehicle.project import Project

OFF, HOLD, LIVE = (SUPERVISION.index(state) for state in ("off", "hold", "live"))
"""States of lpvg_can_state_t; a smaller value is worse."""
HOLD_MISSED, OFF_MISSED = 3, 5
SCORE_OFF, RECOVER_FRAMES, COUNTER_STEP = 5, 5, 5
WINDOW, WINDOW_BAD = 16, 8
ARRIVALS, ARRIVALS_PERIODS = 8, 6


def needed_messages(project: Project) -> list[Message]:
    """List the messages that a vehicle's ECU needs: for speed, outputs, command, and the driver's brakes."""
    catalogue = load_catalogue()
    places = [project.speed.can, REFERENCE, OVERRIDE, *(s.can for s in project.outputs)]
    return [catalogue.message(name) for name in sorted({p.message for p in places if p is not None})]


Limits = Mapping[tuple[str, str], tuple[float, float]]
"""Least and largest accepted bus value by message and signal."""


def limits(project: Project) -> dict[tuple[str, str], tuple[float, float]]:
    """Limits of the monitor's signals on the bus, from the vehicle's signal table."""
    by_signal = {}
    for s in (project.speed, *project.outputs):
        if s.can is not None:
            ends = s.can.factor * s.min, s.can.factor * s.max
            by_signal[s.can.message, s.can.signal] = min(ends), max(ends)
    return by_signal


def required(
    frames: Frames,
    messages: Sequence[Message],
    ticks_us: np.ndarray,
    bus_off_us: Sequence[int] = (),
    within: Limits = MappingProxyType({}),
) -> np.ndarray:
    """Compute the required state (N,) at each tick (N,) [us].

    ``frames`` are in the order of arrival. ``bus_off_us`` holds the times of bus-off reports. ``within``
    holds the limits of the vehicle (see `limits`).
    """
    worst, refused = np.full(len(ticks_us), LIVE), np.zeros(len(ticks_us), bool)
    for message in messages:
        at = np.flatnonzero(
            (frames.id & np.uint32(ANY_PRIORITY)) == np.uint32((message.id | EXTENDED) & ANY_PRIORITY)
        )
        watch = _watched(
            message, frames.t_ns[at] // 1000, frames.length[at], frames.data[at, :8], sorted(bus_off_us)
        )
        times, states = zip(*watch.changes, strict=False)
        worst = np.minimum(worst, np.array(states)[np.searchsorted(times, ticks_us, side="right") - 1])
        newest = np.searchsorted([t for t, _ in watch.taken], ticks_us, side="right")  # 0: no good frame yet
        for column, signal in enumerate(message.supervised):
            if (message.name, signal.name) in within:
                low, high = within[message.name, signal.name]
                value = np.array(
                    [low, *(signal.scale * values[column] + signal.offset for _, values in watch.taken)]
                )
                refused |= ((value < low) | (value > high))[newest]
    return np.where(refused & (worst == LIVE), OFF, worst)


@dataclass
class _Watch:
    """Supervision of one message at the time of its newest frame.

    ``changes`` holds (time [us], state from then on). ``taken`` holds (time [us], raw values) of each good
    frame.
    """

    period: int
    state: int = OFF
    accepted: int = 0
    score: int = 0
    in_row: int = 0
    counter: int | None = None
    values: list[int] | None = None
    arrived: int | None = None
    arrivals: int = 0
    fast: bool = False

    def __post_init__(self) -> None:
        self.changes = [(-1, OFF)]
        self.taken: list[tuple[int, list[int]]] = []
        self.window = deque[bool](maxlen=WINDOW)

    def go(self, t: int, state: int) -> None:
        if state == OFF:
            self.in_row, self.counter, self.values = 0, None, None
            self.window.clear()
        if state != self.state:
            self.state = state
            self.changes.append((t, state))

    def pass_time(self, t: int) -> None:
        due = self.accepted + self.period // 2 + 1
        held, off = due + HOLD_MISSED * self.period, due + OFF_MISSED * self.period
        if t >= held and self.state == LIVE:
            self.go(held, HOLD)
        if t >= off:
            self.go(off, OFF)

    def arrive(self, t: int) -> None:
        if self.arrived is None:
            self.arrived = t
            return
        self.arrivals += 1
        if self.arrivals == ARRIVALS:
            self.fast = t - self.arrived < ARRIVALS_PERIODS * self.period
            self.arrived, self.arrivals = t, 0

    def bad(self, t: int) -> None:
        self.score = min(self.score + 1, SCORE_OFF)
        if self.state == OFF:
            self.in_row, self.values = 0, None
        elif self.score == SCORE_OFF or self.fast:
            self.go(t, OFF)
        self.window.append(True)
        if self.state != OFF and sum(self.window) >= WINDOW_BAD:
            self.go(t, OFF)

    def good(self, t: int, values: list[int]) -> None:
        self.accepted, self.values = t, values
        self.taken.append((t, values))
        if self.state != OFF:
            self.score = max(0, self.score - 1)
            self.window.append(False)
            self.go(t, LIVE)
            return
        self.in_row += 1
        if self.in_row == RECOVER_FRAMES:
            self.score, self.in_row = 0, 0
            self.window.clear()
            self.go(t, LIVE)


def _watched(
    message: Message, t_us: np.ndarray, length: np.ndarray, data: np.ndarray, bus_off_us: Sequence[int]
) -> _Watch:
    """Supervise the frames of a message, given by t_us (N,), length (N,) and data (N, 8)."""
    signals = message.supervised
    raw = np.column_stack([_raw(data, s) for s in signals]) if signals else np.zeros((len(t_us), 0), int)
    early = np.diff(t_us, prepend=-message.period_ms * 1000) < message.period_ms * 1000 // GAP_FRACTION
    unreadable = early | (length != 8)
    if message.e2e:
        unreadable |= (e2e_crc(data, message.e2e.data_id) != data[:, 0]) | ((data[:, 1] & 0x0F) >= COUNTERS)
    outside = np.zeros(len(t_us), bool)
    rates = []  # column, raw steps per microsecond
    rules = [s.supervise for s in signals if s.supervise is not None]
    for k, (signal, rule, column) in enumerate(zip(signals, rules, raw.T, strict=True)):
        outside |= (
            (column < math.ceil((rule.min - signal.offset) / signal.scale))
            | (column > math.floor((rule.max - signal.offset) / signal.scale))
            | (column >= (signal.raw_error_min or 1 << signal.length))
        )
        if rule.max_rate:
            rates.append((k, rule.max_rate / signal.scale * 1e-6))
    watch, reports = _Watch(message.period_ms * 1000), list(bus_off_us)
    for t, wrong, counter, beyond, values in zip(
        t_us.tolist(),
        unreadable.tolist(),
        (data[:, 1] & 0x0F).tolist(),
        outside.tolist(),
        raw.tolist(),
        strict=False,
    ):
        while reports and reports[0] <= t:
            watch.pass_time(reports[0])
            watch.go(reports.pop(0), OFF)
        watch.pass_time(t)
        watch.arrive(t)
        wrong = wrong or watch.fast
        if not wrong and message.e2e:
            wrong = (
                watch.counter is not None and not 1 <= (counter - watch.counter) % COUNTERS <= COUNTER_STEP
            )
            watch.counter = counter
        if not wrong and not beyond and watch.values is not None:
            since = max(t - watch.accepted, watch.period)
            for k, rate in rates:
                beyond = beyond or abs(values[k] - watch.values[k]) > rate * since + 1
        if wrong or beyond:
            watch.bad(t)
        else:
            watch.good(t, values)
    for t in (*reports, np.iinfo(np.int64).max):
        watch.pass_time(int(t))
        watch.go(int(t), OFF)
    return watch


def _raw(data: np.ndarray, signal: BusSignal) -> np.ndarray:
    whole = np.ascontiguousarray(data).view("<u8")[:, 0]
    return (whole >> np.uint64(signal.start) & np.uint64((1 << signal.length) - 1)).astype(int)


@dataclass(frozen=True)
class Reactions:
    """Comparison of the reported states with the required states.

    due             number of intervals in which a state worse than live is required
    met             number of these intervals in which no tick reported a better state than required
    late_s          longest uninterrupted time with a better state than required [s]
    unwarranted_s   time with a worse state than required [s]
    away_s          time in which a state other than live was required [s]
    """

    due: int
    met: int
    late_s: float
    unwarranted_s: float
    away_s: float

    @classmethod
    def from_states(cls, reported: np.ndarray, required: np.ndarray, Ts: float) -> Reactions:
        """Compare reported and required states (N,) at ticks with the period ``Ts`` [s]."""
        missed = reported > required
        stretches = _stretches(required < LIVE)
        late = max((b - a for a, b in _stretches(missed)), default=0)
        return cls(
            len(stretches),
            sum(not missed[a:b].any() for a, b in stretches),
            late * Ts,
            float((reported < required).sum() * Ts),
            float((required < LIVE).sum() * Ts),
        )


def _stretches(where: np.ndarray) -> list[tuple[int, int]]:
    """List [begin, end) of each run of True."""
    return [(int(a), int(b)) for a, b in runs(where)]
