"""Sample live frames with the compiled receiver, one sample per tick, as on the ECU.

The clock is the same as in replay/receive.py, but its phase comes only from the first FIRST_S of frames.
"""

import numpy as np

from ...base.errors import InputError
from ...can.logs import Frames
from ...replay.receive import CLOCK_JUMP_S, PAUSE_S, Receiver, RunningReceiver, phase_us

FIRST_S = 1.0
"""Frames of this long [s] set the phase of the ticks."""
REORDER_S = 1.0
"""A frame older than the newest by more than this restarts the clock [s]."""
HELD = 100_000
"""Most frames held while the phase is unknown; beyond, the oldest are dropped."""


class Sampler:
    """Samples of a vehicle from live frames."""

    def __init__(self, receiver: Receiver, channel: str | None):
        """``channel`` is the used interface; None means the only one with messages of the vehicle."""
        self._receiver, self._channel, self._given = receiver, channel, channel is not None
        self._period_us = round(receiver.project.Ts_s * 1e6)
        self.jumps = 0
        """Number of restarts of the source's clock."""
        self.counts: np.ndarray | None = None
        """(rules + 1, events) number of frames by outcome since the clock began; None before the first."""
        self.live: np.ndarray | None = None
        """(needed,) True for the needed messages that are live at the newest tick."""
        self._next_us = 0  # time of the next tick on the page's clock
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._running: RunningReceiver | None = None
        self._held: Frames | None = None
        self._newest_ns = -1

    def take(self, frames: Frames) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Yield the samples that ``frames`` complete, piece by piece: t (N,) [s], values, present (N,).

        The values have shape (N, columns).
        """
        frames = self._of_channel(frames)
        pieces = []
        while len(frames):
            t = frames.t_ns
            before = np.r_[self._newest_ns if self._newest_ns >= 0 else t[0], t[:-1]]
            step = t - np.maximum.accumulate(before)
            jumped = np.flatnonzero((step < -REORDER_S * 1e9) | (step > CLOCK_JUMP_S * 1e9))
            cut = int(jumped[0]) if len(jumped) else len(frames)
            if cut:
                pieces.append(self._stretch(frames.at(slice(0, cut))))
            if len(jumped):
                self._next_us += round(PAUSE_S * 1e6)
                self.jumps += 1
                self._begin_anew()
            frames = frames.at(slice(cut, None))
        return [piece for piece in pieces if piece is not None]

    def _of_channel(self, frames: Frames) -> Frames:
        """Frames of one channel; InputError if several have the vehicle's messages and none is given."""
        if not self._given:
            heard = np.unique(frames.channel[self._receiver.ours(frames)])
            names = {frames.channels[k] for k in heard} | ({self._channel} if self._channel else set())
            if len(names) > 1:
                sources = f"the vehicle's messages come from {', '.join(sorted(names))}"
                raise InputError("live", "channel", sources, "the option --channel")
            self._channel = next(iter(names), None)
        if self._channel not in frames.channels:
            return frames.at(slice(0, 0))
        return frames.of_channel(self._channel, "live")

    def _stretch(self, frames: Frames) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Yield the samples of frames without a jump of the clock among them."""
        if self._held is not None:
            frames = _after(self._held, frames)
        self._newest_ns = int(frames.t_ns.max())
        frames = frames.at(np.argsort(frames.t_ns, kind="stable"))
        if self._running is None and not self._begun(frames):
            self._held = frames.at(slice(-HELD, None))
            return None
        assert self._running is not None
        # A frame older than the newest tick counts for the next tick.
        t_us = np.maximum(frames.t_ns // 1000 + self._shift_us, self._next_us - self._period_us)
        ticks = int((t_us[-1] - self._next_us - 1) // self._period_us) + 1
        if ticks <= 0:
            self._held = frames
            return None
        first = self._next_us
        self._next_us = first + ticks * self._period_us
        later = int(np.searchsorted(t_us, self._next_us - self._period_us, side="right"))
        self._held = frames.at(slice(later, None))
        values, states = self._running.take(t_us[:later], frames.at(slice(0, later)), first, ticks)
        live, present = self._receiver.presence(values, states)
        self.counts, self.live = self._running.counts, live[:, -1]
        t = (first + self._period_us * np.arange(ticks, dtype=np.int64)) * 1e-6
        return t, values, present

    def _begun(self, frames: Frames) -> bool:
        """Set phase and start of the ticks as soon as FIRST_S of frames have arrived."""
        ours = self._receiver.ours(frames)
        if not ours.any() or frames.t_ns[-1] - frames.t_ns[ours][0] < FIRST_S * 1e9:
            return False
        period = min(m.period_ms for m in self._receiver.needed) * 1000
        t_us = frames.t_ns // 1000
        start = -(-self._next_us // period) * period + period
        shift = start - phase_us(t_us[ours] - t_us[0], period) - int(t_us[0])
        self._shift_us = round(shift)
        first_ours = int(t_us[ours][0]) + self._shift_us
        self._next_us = round(first_ours / period) * period + period // 2
        try:
            self._running = self._receiver.running(min(int(t_us[0]) + self._shift_us, self._next_us), "live")
        except InputError:
            return False
        return True


def _after(first: Frames, second: Frames) -> Frames:
    """Join frames of one channel, ``second`` after ``first``."""
    width = max(first.data.shape[1], second.data.shape[1])
    data = [np.pad(f.data, ((0, 0), (0, width - f.data.shape[1]))) for f in (first, second)]
    pairs = [(getattr(first, k), getattr(second, k)) for k in ("t_ns", "id", "length")]
    t_ns, id_, length = (np.concatenate(pair) for pair in pairs)
    return Frames(t_ns, id_, np.zeros(len(t_ns), np.uint8), length, np.concatenate(data), second.channels[:1])
