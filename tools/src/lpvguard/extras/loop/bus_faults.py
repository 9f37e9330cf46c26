"""Fault table of the bus: each fault in the closed loop, the firmware's required reaction, and its deadline.

In each row, the simulator runs with one fault of the scenario files (firmware_sim/sim/scenario.hpp), which
starts at START_S. Times are those of the firmware's ticks. A state appears in the first report after the
firmware reached it.
"""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...can.catalogue import load_catalogue
from ...core.compiled import EVENTS, SUPERVISION
from .sim import RECOVERY_S, Simulator, can_fault_table, load_scenario, steady_scenario

START_S = 20.0
_SETTLED_S = 1.0


@dataclass(frozen=True)
class BusFault:
    """Fault of a message, and the firmware's required reaction.

    periods              length of the fault in periods of the message
    seen, seen_within    first kind of event that the firmware must count, and largest number of periods until
                         then; "" if the fault has no visible effect (can.h)
    state, within        worst state that must be reported, and largest number of periods until then; "live"
                         if no other state may be reported
    """

    name: str
    message: str
    kind: str
    periods: int
    seen: str
    seen_within: float
    state: str
    within: float
    delay_s: float | None = None
    probability: float = 1.0


LOSSES = ((1, "live", 0), (3, "live", 0), (5, "off", 5), (20, "off", 5))
BUS_FAULTS = [
    *[
        BusFault(f"lost {n}", message, "lost", n, "missed", 1, state, within)
        for message in ("VDC2", "GUARD_IN")
        for n, state, within in LOSSES
    ],
    # Ticks are shorter than the 100 ms between frames, so "hold" is reported before the next good frame ends
    # it.
    *[
        BusFault(f"lost {n}", "EBC2", "lost", n, "missed", 1, state, within)
        for n, state, within in ((1, "live", 0), (3, "hold", 3), (5, "off", 5), (20, "off", 5))
    ],
    BusFault("repeated", "GUARD_IN", "repeated", 100, "repeated", 0, "off", 5),
    BusFault("repeated once", "GUARD_IN", "repeated", 1, "repeated", 0, "live", 0),
    BusFault("repeated once", "VDC2", "repeated", 1, "", 0, "live", 0),
    BusFault("swapped in pairs", "GUARD_IN", "swapped", 100, "early", 1, "off", 17),
    BusFault("delayed by 10 ms", "GUARD_IN", "delayed", 1, "early", 1, "live", 0, 0.01),
    BusFault("delayed by 50 ms", "GUARD_IN", "delayed", 100, "missed", 1, "off", 5, 0.05),
    BusFault("delayed by 1 s", "VDC2", "delayed", 100, "missed", 1, "off", 5, 1.0),
    BusFault("wrong CRC", "GUARD_IN", "corrupted", 100, "checksum", 0, "off", 5),
    BusFault("stuck counter", "GUARD_IN", "stuck_counter", 100, "repeated", 0, "off", 5),
    BusFault("wrong length", "VDC2", "wrong_length", 100, "length", 0, "off", 5),
    BusFault("unknown id", "VDC2", "unknown_id", 100, "unknown_id", 0, "live", 0),
    BusFault("babbling", "VDC2", "babbling", 100, "early", 0, "off", 1),
    BusFault("babbling", "GUARD_IN", "babbling", 100, "early", 0, "off", 1),
    BusFault("bus-off", "VDC2", "bus_off", 50, "bus_off", 0, "off", 1),
]


def run_fault(simulator: Simulator, fault: BusFault, **options: Any) -> dict[str, Any]:
    """Run one fault and make its row of the table; ``options`` go to Simulator.run.

    ``missed`` holds a sentence for each late or missing reaction.
    """
    period_s = load_catalogue().message(fault.message).period_ms / 1000
    # A frame that is due exactly at the end is good again. The last delayed frame arrives later.
    window_s = fault.periods * period_s - simulator.project.Ts_s / 2
    end_s = START_S + window_s + (fault.delay_s or 0.0)
    more = {} if fault.delay_s is None else {"delay_s": fault.delay_s}
    injected = can_fault_table(
        fault.message, fault.kind, START_S, START_S + window_s, probability=fault.probability, **more
    )
    text = steady_scenario(end_s + RECOVERY_S + _SETTLED_S, injected, title=fault.name)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fault.toml"
        path.write_text(text)
        result = simulator.run(load_scenario(str(path)), **options)
    kind, seen_s = _first_seen(result["reception"]["messages"], fault.message)
    states = [(t, state) for t, state in result["supervision"] if t >= START_S]
    worst = min((state for _, state in states), key=SUPERVISION.index, default="live")
    reached_s = next((t for t, state in states if state == worst), None)
    live_s = states[-1][0] if states and states[-1][1] == "live" else None
    row = {
        "fault": fault.name,
        "message": fault.message,
        "period_ms": round(period_s * 1e3),
        "seen": kind,
        "seen_after_ms": _after(seen_s, START_S),
        "state": worst,
        "state_after_ms": _after(reached_s, START_S),
        "limit_ms": round(fault.within * period_s * 1e3),
        "live_again_after_ms": _after(live_s, end_s),
        "demand_max_bar": result["demand_max_bar"],
    }
    return row | {"missed": list(_missed(fault, row, period_s * 1e3))}


def table(simulator: Simulator, tell: Callable[[str], None] = lambda _: None) -> list[dict[str, Any]]:
    """Run every fault of the bus.

    Parameters
    ----------
    simulator : Simulator
    tell : Callable, reports progress

    Returns
    -------
    list of dict, rows in the order of the faults
    """
    rows = []
    for fault in BUS_FAULTS:
        tell(f"{fault.name}, {fault.message}")
        rows.append(run_fault(simulator, fault))
    return rows


def as_text(rows: list[dict[str, Any]]) -> str:
    """Format the table of bus faults.

    Times are in ms after the start of the fault. The last column is in ms after its end.

    Parameters
    ----------
    rows : list of dict, result of `table`

    Returns
    -------
    str
    """
    head = (
        f"{'fault':<18} {'message':<9} {'period':>6} {'first seen as':<14} {'at':>5} "
        f"{'state':<5} {'at':>5} {'limit':>6} {'live again':>11}  missed"
    )

    def show(x: float | None) -> str:
        return "–" if x is None else f"{x:.0f}"

    def line(r: dict[str, Any]) -> str:
        return (
            f"{r['fault']:<18} {r['message']:<9} {r['period_ms']:>6} "
            f"{r['seen'] or 'nothing':<14} {show(r['seen_after_ms']):>5} "
            f"{r['state']:<5} {show(r['state_after_ms']):>5} {show(r['limit_ms'] or None):>6} "
            f"{show(r['live_again_after_ms']):>11}  {'; '.join(r['missed']) or 'nothing'}"
        )

    return "\n".join([head, *map(line, rows)])


def _first_seen(messages: dict[str, Any], message: str) -> tuple[str, float | None]:
    """First event that is not a good frame, with its time; it concerns the message or no message.

    Of several simultaneous events, the one that the firmware checks first is returned.
    """
    seen = [
        (t, EVENTS.index(kind), kind)
        for name in (message, "other")
        for kind, t in messages[name]["first_s"].items()
        if kind not in ("accepted", "recovering")
    ]
    t, _, kind = min(seen, default=(None, 0, ""))
    return kind, t


def _after(t_s: float | None, from_s: float) -> float | None:
    return None if t_s is None else round((t_s - from_s) * 1e3, 3)


def _missed(fault: BusFault, row: dict[str, Any], period_ms: float) -> Iterator[str]:
    """Yield a sentence for each late or missing reaction of a row."""
    if row["seen"] != fault.seen:
        yield f"first seen as {row['seen'] or 'nothing'}, not as {fault.seen or 'nothing'}"
    elif fault.seen and row["seen_after_ms"] > fault.seen_within * period_ms:
        yield f"seen after {row['seen_after_ms']:g} ms"
    if row["state"] != fault.state:
        yield f"state {row['state']}, not {fault.state}"
    elif fault.state != "live":
        if row["state_after_ms"] > fault.within * period_ms:
            yield f"{fault.state} after {row['state_after_ms']:g} ms"
        if row["live_again_after_ms"] is None or row["live_again_after_ms"] > RECOVERY_S * 1e3:
            yield f"not live again within {RECOVERY_S:g} s"
