"""Run live frames through the compiled core and keep the newest results in ring buffers.

One thread takes frames from the source and judges them (`Watch.run`). Readers copy a few numbers under a
lock. A reader delays the source only during such a copy.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any, Protocol

import numpy as np
import pyarrow as pa

from ...base.errors import InputError
from ...can.bus import REFERENCE, command_authentication
from ...can.logs import Frames
from ...core.compiled import REASONS, VERDICTS, Run
from ...drives.tables import Drive
from ...replay.alarm_text import alarm_sentence
from ...replay.parts import RunningParts
from ...replay.receive import Receiver
from ...replay.replayer import Alarm, Replayer
from ...vehicle.nominal import RunningModel
from .sampling import Sampler
from .sources import FrameSource

ALARMS = 1000
"""Number of newest alarms that are kept."""
LISTED = 100
"""Number of newest alarms that a reader gets at once."""
SILENT_S = 1.0
"""Time without a frame after which the source counts as silent [s]."""


class Ring:
    """Ring buffer with the newest rows of numbers."""

    def __init__(self, rows: int, columns: int):
        self._rows = np.full((rows, columns), np.nan)
        self.count = 0
        """Number of all rows so far; the oldest row that is kept has the number max(0, count - rows)."""

    def put(self, new: np.ndarray) -> None:
        """Add rows (N, columns) in place of the oldest rows."""
        size = len(self._rows)
        kept = new[-size:]
        at = (self.count + len(new) - len(kept) + np.arange(len(kept))) % size
        self._rows[at] = kept
        self.count += len(new)

    def rows(self, first: int, end: int, step: int = 1) -> np.ndarray:
        """Copy (N, columns) of every ``step``-th kept row from number ``first`` to before ``end``."""
        first = max(first, self.count - len(self._rows), 0)
        numbers = np.arange(first + -first % step, min(end, self.count), step)
        return self._rows[numbers % len(self._rows)]

    def find(self, t: float) -> int:
        """Number of the first kept row whose column 0, which increases, is at least ``t``."""
        low, high = max(self.count - len(self._rows), 0), self.count
        while low < high:
            middle = (low + high) // 2
            if self._rows[middle % len(self._rows), 0] < t:
                low = middle + 1
            else:
                high = middle
        return low


class Listener(Protocol):
    """Interface of an object that receives every judged piece."""

    def listens(self) -> bool:
        """Return whether the listener needs data now."""
        ...

    def hear(self, series: pa.Table, alarms: list[Alarm], parts: Sequence[dict[str, Any]] = ()) -> None:
        """Receive a piece of the time series (replay/series.py), its alarms and parts, on the page's clock.

        ``parts`` has the form of the JSON of `replay`.
        """
        ...


class Watch:
    """Judges a source with the compiled core of a vehicle and keeps the newest results.

    Parameters
    ----------
    replayer : Replayer
    source : FrameSource
    window_s : float, s, length of the results that are kept
    channel : str, optional, interface, for a log with several interfaces
    clock : Callable, s, measures the source's silence
    listeners : sequence of Listener, receive the judged pieces
    """

    def __init__(
        self,
        replayer: Replayer,
        source: FrameSource,
        window_s: float,
        channel: str | None = None,
        clock: Callable[[], float] = time.monotonic,
        listeners: Sequence[Listener] = (),
    ):
        project = replayer.project
        self.replayer, self.source, self._clock, self._listeners = replayer, source, clock, listeners
        self._receiver = Receiver(project, command=project.can is None)
        self._sampler = Sampler(self._receiver, channel)
        self.signals = [s.name for s in self._receiver.signals]
        outputs = [s.name for s in project.outputs]
        self.columns = [
            "t",
            *self.signals,
            *(f"yhat/{name}" for name in outputs),
            "command",
            "verdict",
            "present",
            "energy",
            "band",
            "change",
        ]
        self._ring = Ring(max(round(window_s / project.Ts_s), 1), len(self.columns))
        n_bins = replayer.estimator.n_bins
        self._judged = Ring(n_bins * max(round(window_s), 10), 5)
        self._newest = np.full((n_bins, 5), np.nan)
        self._alarms: deque[dict[str, Any]] = deque(maxlen=ALARMS)
        self._n_alarms, self._reasons = 0, dict.fromkeys(REASONS, 0)
        self._lock = threading.Lock()
        self._heard_at: float | None = None
        self._authentication: str | None = None
        self._monitor = replayer.core.monitor()
        self._model: RunningModel | None = None
        self._parts: RunningParts | None = None
        self._restarts = 0
        self._stop = threading.Event()
        self.failed = ""

    def run(self) -> None:
        """Receive and judge frames until ``stop``, in a separate thread."""
        try:
            for frames in self.source.pieces():
                if self._stop.is_set():
                    return
                if frames is not None:
                    self.take(frames)
        except InputError as error:
            self.failed = str(error)
        except Exception as error:
            self.failed = f"{type(error).__name__}: {error}"
            raise

    def stop(self) -> None:
        """End ``run`` at the next piece."""
        self._stop.set()

    def take(self, frames: Frames) -> None:
        """Judge the samples that ``frames`` complete."""
        self._heard_at = self._clock()
        self._authentication = command_authentication(frames) or self._authentication
        for t, values, present in self._sampler.take(frames):
            self._judge(t, values, present)

    def _judge(self, t: np.ndarray, values: np.ndarray, present: np.ndarray) -> None:
        n_u, n_y = self.replayer.project.n_u, self.replayer.project.n_y
        clean = np.nan_to_num(values)
        v, u, y = clean[:, 0], clean[:, 1 : 1 + n_u], clean[:, 1 + n_u : 1 + n_u + n_y]
        run = self._monitor.run(t, v, u, y, present)
        if self._restarts != self._sampler.jumps:
            self._restarts, self._model, self._parts = self._sampler.jumps, None, None
        if self._model is None and present.any():
            self._model = RunningModel(self.replayer.model, y[np.argmax(present)])
        yhat = np.full_like(y, np.nan) if self._model is None else self._model.run(v, u)
        more = values.shape[1] > len(self.signals)
        command = values[:, -1:] if more else np.full((len(t), 1), np.nan)
        shown = np.where(present[:, None], np.hstack([clean[:, : len(self.signals)], yhat, command]), np.nan)
        energy, change = (np.where(ratio > 0, ratio, np.nan) for ratio in (run.energy, run.change))
        verdicts = np.column_stack([run.verdict, present, energy, run.energy_band, change])
        frames = run.frames
        counted = frames.counted
        judged = np.column_stack(
            [frames.t_judged_s, frames.bin, frames.statistic, frames.margin, frames.evidence]
        )[counted]
        raised = self.replayer.alarms(run, 0.0)
        piece = Drive("live", t, v, u, y, missing=~present.astype(bool))
        parts = self._parts_of(piece, run)
        alarms = [{"t_s": a.t_s, "says": alarm_sentence(a)} for a in raised]
        with self._lock:
            self._ring.put(np.column_stack([t, shown, verdicts]))
            self._judged.put(judged)
            self._newest[judged[:, 1].astype(int)] = judged
            self._alarms.extend(alarms)
            self._alarms.extend({"t_s": p["until_s"], "says": f"part: {p['says']}"} for p in parts)
            self._n_alarms += len(alarms)
            for reason, n in zip(*np.unique(frames.reason, return_counts=True), strict=True):
                self._reasons[REASONS[reason]] += int(n)
        listening = [one for one in self._listeners if one.listens()]
        if listening:
            series = self.replayer.series_of(piece, yhat, run, 0.0)
            for listener in listening:
                listener.hear(series, raised, parts)

    def _parts_of(self, piece: Drive, run: Run) -> list[dict[str, Any]]:
        """Parts that are named by the windows that end in a piece, in the form of the JSON of `replay`."""
        namer = self.replayer.namer
        if namer is None:
            return []
        self._parts = self._parts or RunningParts(namer)
        onsets = [(d.alarm_s, d.since_s) for d in self.replayer.diagnoses(run, 0.0)]
        return [asdict(p) for p in self._parts.take(piece, run.verdict, onsets)]

    def silent_s(self) -> float | None:
        """Time since the newest frame [s]; None before the first frame."""
        return None if self._heard_at is None else self._clock() - self._heard_at

    def what(self) -> dict[str, Any]:
        """Constants: names, units, bins, thresholds."""
        project, replayer = self.replayer.project, self.replayer
        return {
            "title": project.title,
            "vehicle": project.name,
            "source": self.source.name,
            "units": {s.name: s.unit for s in self._receiver.signals},
            "speed": project.speed.name,
            "inputs": [s.name for s in project.inputs],
            "outputs": [s.name for s in project.outputs],
            "omega": replayer.estimator.omega.tolist(),
            "threshold": replayer.threshold,
            "energy_threshold": replayer.energy_threshold,
            "change_threshold": replayer.change_threshold,
            "bands": list(replayer.bands),
            "command_of": self._command_of(),
        }

    def _command_of(self) -> str | None:
        """Output that the driver's command on the bus refers to; None without a command."""
        if self._receiver.columns == len(self.signals):
            return None
        output = REFERENCE.signal.removesuffix("_command")
        matches = (s.name for s in self.replayer.project.outputs if s.can and s.can.signal == output)
        return next(matches, None)

    def view(self, span_s: float, until: float | None, most: int) -> dict[str, Any]:
        """Data of the last ``span_s`` [s] before ``until`` [s] (None: now), with at most ``most`` rows."""
        with self._lock:
            count = self._ring.count
            newest = self._ring.rows(count - 1, count)
            end = count if until is None else self._ring.find(until)
            t_end = newest[0, 0] if len(newest) and until is None else until or 0.0
            first = self._ring.find(t_end - span_s)
            # The step counts from the very first row, so that the same rows are drawn as time passes.
            step = 1 << max(0, int(np.ceil(np.log2(max(end - first, 1) / most))))
            rows = self._ring.rows(first, end, step)
            oldest = self._ring.rows(self._ring.find(-np.inf), self._ring.find(-np.inf) + 1)
            judged = self._judged.rows(self._judged.find(t_end - span_s), self._judged.find(t_end))
            frames, alarms = self._newest.copy(), list(self._alarms)
            n_alarms, reasons = self._n_alarms, dict(self._reasons)
        return {
            "now": self._now(newest, float(oldest[0, 0]) if len(oldest) else None),
            "series": {name: _numbers(column) for name, column in zip(self.columns, rows.T, strict=True)},
            "bins": self._bins(frames if until is None else judged, judged),
            "alarms": alarms[-LISTED:],
            "n_alarms": n_alarms,
            "frames": reasons,
            "can": self._can(),
        }

    def _now(self, newest: np.ndarray, oldest: float | None) -> dict[str, Any]:
        silent = self.silent_s()
        row = dict(zip(self.columns, newest[0].tolist(), strict=True)) if len(newest) else {}
        return {
            "t": row.get("t"),
            "oldest": oldest,
            "verdict": VERDICTS[int(row["verdict"])] if row else "unknown",
            "silent_s": silent,
            "silent": silent is None or silent > SILENT_S,
            "lost": self.source.lost,
            "restarts": self._sampler.jumps,
            "command_authentication": self._authentication,
            "trouble": self.failed or self.source.trouble,
        }

    def _bins(self, newest: np.ndarray, judged: np.ndarray) -> dict[str, list[float | None]]:
        """For each bin: numbers of the newest frame, and the largest statistic of the window."""
        n_bins = len(self._newest)
        last, largest = np.full((n_bins, 5), np.nan), np.full(n_bins, np.nan)
        for row in newest[np.isfinite(newest[:, 0])]:
            last[int(row[1])] = row
        np.fmax.at(largest, judged[:, 1].astype(int), judged[:, 2])
        return {
            "t": _numbers(last[:, 0]),
            "statistic": _numbers(last[:, 2]),
            "margin": _numbers(last[:, 3]),
            "evidence": _numbers(last[:, 4]),
            "largest": _numbers(largest),
        }

    def _can(self) -> dict[str, Any]:
        """Outcome of the frames since the source's clock began, and which needed messages are live."""
        counts, live = self._sampler.counts, self._sampler.live
        if counts is None or live is None:
            return {"messages": {}, "other": {}, "live": {}}
        needed = [self._receiver.on_bus(m) for m in self._receiver.needed]
        states = dict(zip(needed, live.tolist(), strict=True))
        return {**self._receiver.counted(counts), "live": states}

    def drive(self, begin: float, end: float) -> tuple[list[str], np.ndarray]:
        """Longest stretch without a gap between ``begin`` and ``end`` [s] as a drive table.

        It returns the column names and numbers (N, columns); N is 0 if there is no sample.
        """
        project = self.replayer.project
        with self._lock:
            rows = self._ring.rows(self._ring.find(begin), self._ring.find(end))
        present = rows[:, self.columns.index("present")] > 0 if len(rows) else np.zeros(0, bool)
        step = np.r_[np.inf, np.diff(rows[:, 0])] if len(rows) else np.zeros(0)
        begins = np.flatnonzero(present & ((step > 1.5 * project.Ts_s) | ~np.r_[False, present[:-1]]))
        longest = slice(0, 0)
        for i, a in enumerate(begins):
            stop = int(begins[i + 1]) if i + 1 < len(begins) else len(rows)
            stop = int(a) + int(np.argmin(np.r_[present[a:stop], False]))
            if stop - int(a) > longest.stop - longest.start:
                longest = slice(int(a), stop)
        signals = self._receiver.signals
        return ["t", *(s.column for s in signals)], rows[longest, : 1 + len(signals)]


def _numbers(values: np.ndarray) -> list[float | None]:
    """Numbers for JSON, rounded as needed for a picture; None for a number that is not finite."""
    return [round(x, 5) if np.isfinite(x) else None for x in values.tolist()]
