"""Check the causes that the core names for injected faults (THEORY 7.9).

A fault counts if it was found in time (detection.py), with the thresholds as exported. Its drive goes on for
DIAGNOSED_S beyond that time, so that late alarms are diagnosed, too. The diagnosis is that of the first alarm
from the fault's start on. Where a drive ends before the whole record is judged, the preliminary diagnosis
from half of it counts.

**Known** faults have one cause: gain, sign, frozen, bias, delay. The judgement of an output is "right" if the
core names this cause, "other" if it names no single cause, and "wrong" otherwise. An interval should hold the
fault's mean size from the alarm to the diagnosis. The size of a ramp is the size that it has reached so far.
A delayed input is a negative delay, because the output is then earlier than the model's.

Faults of `no_single_cause` are two simultaneous faults, a dead zone, or a saturating output. The answer
"other" is right for them. A gain is also right if its interval holds the equivalent gain. This is the
least-squares gain of the faulty output on the untouched one over the same samples. A record is uneven if the
root mean square of the untouched output differs by UNEVEN or more between the halves of these samples.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..base.rates import rate, share_words
from ..drives.faults import Fault, injected_delay_s, share_of
from ..drives.tables import Drive
from ..identify.diagnosis import DiagnosisScales
from ..replay.causes import WITH_INTERVAL, Diagnosis
from ..replay.replayer import Replay
from ..vehicle.project import Project
from .detection import WAY_WORDS, Case, JudgedClock

DIAGNOSED_S = 30.0
"""Driving after the time in which a fault may be found, for the diagnosis of its alarm."""
UNEVEN = 2.0
TRUE_CAUSE = {"freeze": "frozen", "bias": "bias", "input_delay": "delay", "output_delay": "delay"}
"""Cause by the kind of a fault; a gain below 0 is a sign."""
RIGHT, OTHER, WRONG, NOT_YET = "right", "other", "wrong", "not yet"
JUDGEMENTS = (RIGHT, OTHER, WRONG, NOT_YET)


def true_cause(fault: Fault) -> str | None:
    """Single cause of a fault, or None if it has several."""
    if fault.also is not None:
        return None
    if fault.kind == "gain":
        return "sign" if fault.value < 0 else "gain"
    return TRUE_CAUSE.get(fault.kind)


@dataclass(frozen=True)
class OutputCause:
    """Cause that the core names for an output; its interval should hold the size ``truth``, if not None."""

    output: str
    cause: str
    value: float | None
    low: float | None
    high: float | None
    truth: float | None
    judgement: str

    @property
    def held(self) -> bool | None:
        """Tell if the interval of a right cause contains the truth; None without such an interval."""
        if self.judgement != RIGHT or self.truth is None or self.low is None or self.high is None:
            return None
        return self.low <= self.truth <= self.high


@dataclass(frozen=True)
class CauseOutcome:
    """Outcome of a found fault in the drive ``run`` from ``start_s`` [s] on.

    ``after_s`` is the time from alarm to diagnosis [s], None without a diagnosis. The module's docstring
    explains ``uneven`` and ``preliminary``.
    """

    run: str
    start_s: float
    judgement: str
    after_s: float | None
    uneven: bool
    preliminary: bool
    outputs: tuple[OutputCause, ...]

    @classmethod
    def from_replay(
        cls, case: Case, project: Project, clock: JudgedClock, drive: Drive, faulty: Drive, replay: Replay
    ) -> CauseOutcome:
        """Judge a ``case`` from the start of ``clock`` on, by the ``replay`` of the ``faulty`` drive."""
        start_s = clock.first * replay.Ts
        since = [d for d in replay.diagnoses if d.alarm_s >= start_s - replay.Ts / 2]
        if not since:
            return cls(drive.name, start_s, NOT_YET, None, False, False, ())
        of_alarm = [d for d in since if d.alarm_s == since[0].alarm_s]
        first = [d for d in of_alarm if d.t_s == of_alarm[-1].t_s]
        span = slice(*(round(t / replay.Ts) for t in (first[0].alarm_s, first[0].t_s)))
        outputs = tuple(_output(case, project, d, clock.first, span, drive, faulty) for d in first)
        judgements = {o.judgement for o in outputs}
        judgement = next(j for j in (WRONG, RIGHT, OTHER) if j in judgements)
        return cls(
            drive.name,
            start_s,
            judgement,
            first[0].t_s - first[0].alarm_s,
            _uneven(drive.y[span]),
            not first[0].final,
            outputs,
        )


def _output(
    case: Case, project: Project, d: Diagnosis, first: int, span: slice, drive: Drive, faulty: Drive
) -> OutputCause:
    fault, cause = case.fault, true_cause(case.fault)
    j = [s.name for s in project.outputs].index(d.output)
    if cause is None:
        y, y_faulty = drive.y[span, j], faulty.y[span, j]
        square = float(y @ y)
        truth = float(y @ y_faulty) / square if square > 0 else None
        holds = None not in (d.low, d.high, truth) and d.low <= truth <= d.high  # type: ignore[operator]
        right = d.cause == "other" or (d.cause in ("gain", "sign") and holds)
        judgement = RIGHT if right else WRONG
        truth = None if d.cause == "other" else truth
    else:
        judgement = RIGHT if d.cause == cause else OTHER if d.cause == "other" else WRONG
        share = float(share_of(np.arange(span.start, span.stop) - first, project.Ts_s, case.ramp_s).mean())
        truth = _size(fault, j, share, project.Ts_s) if d.cause in WITH_INTERVAL else None
    return OutputCause(d.output, d.cause, d.value, d.low, d.high, truth, judgement)


def _size(fault: Fault, j: int, share: float, Ts: float) -> float:
    """Size of the injected fault in output j at a ``share`` of it."""
    if fault.kind == "gain":
        return 1.0 + share * (fault.value - 1.0)
    if fault.kind == "bias":
        return share * fault.value * (fault.spread[j] if fault.spread else 1.0)
    return share * injected_delay_s(fault.value, Ts) * (-1.0 if fault.kind == "input_delay" else 1.0)


def _uneven(y: np.ndarray) -> bool:
    """Tell if the two halves of the record (N, n_y) differ by the ratio UNEVEN or more in any output."""
    edges = (0, len(y) // 2, len(y))
    sizes = np.array([np.sqrt(np.mean(y[a:b] ** 2, axis=0)) for a, b in pairwise(edges)])
    return bool((sizes.max(axis=0) >= UNEVEN * sizes.min(axis=0)).any())


def can_be_named(fault: Fault, project: Project, scales: DiagnosisScales) -> bool:
    """Return whether a fault with one cause exceeds the difference between healthy vehicles in some output.

    The core cannot name a smaller fault, however long the record is (DiagnosisScales.least)."""
    if fault.kind == "freeze":
        return True
    least = scales.least
    sizes = [_size(fault, j, 1.0, project.Ts_s) for j in range(project.n_y)]
    if fault.kind == "gain":
        return any(abs(g - 1.0) > limits[0] * abs(g) for g, limits in zip(sizes, least, strict=True))
    part = 2 if fault.kind == "bias" else 1
    return any(abs(size) > limits[part] for size, limits in zip(sizes, least, strict=True))


CauseOutcomes = dict[Case, list[CauseOutcome]]
"""Named causes per case, where it was found."""


def cause_table(outcomes: CauseOutcomes, project: Project, scales: DiagnosisScales | None) -> dict:
    """Table of judgements as JSON, one row per case.

    The sums count the known faults, the known faults that can be named, and the faults without a single
    cause. ``scales`` decide which faults can be named; None means that this is unknown.
    """
    rows = [_row(case, members) for case, members in outcomes.items()]
    known = [m for case, members in outcomes.items() if true_cause(case.fault) is not None for m in members]
    named = [
        m
        for case, members in outcomes.items()
        if true_cause(case.fault) is not None and scales and can_be_named(case.fault, project, scales)
        for m in members
    ]
    single = [m for case, members in outcomes.items() if true_cause(case.fault) is None for m in members]
    uneven = [m for m in single if m.uneven]
    return {
        "diagnosed_s": DIAGNOSED_S,
        "rows": rows,
        "known": _counts(known),
        "can_be_named": None if scales is None else _counts(named),
        "no_single_cause": _counts(single)
        | {
            "said_other": sum(_said_other(m) for m in single),
            "uneven": len(uneven),
            "uneven_said_other": sum(_said_other(m) for m in uneven),
        },
    }


def _said_other(m: CauseOutcome) -> bool:
    return bool(m.outputs) and all(o.cause == "other" for o in m.outputs)


def _counts(members: Iterable[CauseOutcome]) -> dict:
    """Counts of found faults, judgements, preliminary diagnoses, and intervals of right causes."""
    members = list(members)
    judged = Counter(m.judgement for m in members)
    held = [o.held for m in members for o in m.outputs if o.held is not None]
    return {
        "found": len(members),
        **{j.replace(" ", "_"): judged[j] for j in JUDGEMENTS},
        "preliminary": sum(m.preliminary for m in members),
        "intervals": len(held),
        "held": sum(held),
    }


def _row(case: Case, members: list[CauseOutcome]) -> dict:
    named = Counter(o.cause for m in members for o in m.outputs)
    waits = [m.after_s for m in members if m.after_s is not None]
    return {
        "way": case.way,
        "fault": case.fault.label,
        "cause": true_cause(case.fault),
        **_counts(members),
        "named": dict(sorted(named.items())),
        "median_after_s": float(np.median(waits)) if waits else None,
        "cases": [
            {
                "run": m.run,
                "start_s": m.start_s,
                "judgement": m.judgement,
                "after_s": m.after_s,
                "uneven": m.uneven,
                "preliminary": m.preliminary,
                "outputs": [vars(o) for o in m.outputs],
            }
            for m in members
        ],
    }


CAUSE_HEAD = (
    "fault",
    "its cause",
    "found",
    "right",
    "other",
    "wrong",
    "not yet",
    "named",
    "95 % intervals hold",
)
"""Columns of cause_rows."""


def cause_rows(table: dict) -> list[list[str]]:
    """Format the table of causes.

    Parameters
    ----------
    table : dict, of `cause_table`

    Returns
    -------
    list of list of str, a row per case and one per sum
    """
    rows = []
    for row in table["rows"]:
        named = ", ".join(f"{cause} {n}" for cause, n in row["named"].items()) or "–"
        name = f"{WAY_WORDS[row['way']]}: {row['fault']}"
        rows.append([name, row["cause"] or "no single one", *_cells(row), named, _held(row)])
    for what, key in (("all with one cause", "known"), ("all without a single one", "no_single_cause")):
        rows.append([what, "", *_cells(table[key]), "", _held(table[key])])
    return rows


def _cells(counts: dict) -> list[str]:
    return [str(counts["found"]), *(str(counts[j.replace(" ", "_")]) for j in JUDGEMENTS)]


def _held(counts: dict) -> str:
    return f"{counts['held']} of {counts['intervals']}" if counts["intervals"] else "–"


def cause_sentences(table: dict) -> list[str]:
    """Summarise the table of causes in sentences, with exact 95 % intervals of the shares.

    Parameters
    ----------
    table : dict, of `cause_table`

    Returns
    -------
    list of str
    """
    known, single = table["known"], table["no_single_cause"]
    large = table["can_be_named"]
    of_large = (
        "of the faults larger than the difference between healthy vehicles: right "
        f"{_share(large[RIGHT], large['found'])}, wrong {_share(large[WRONG], large['found'])}"
        if large
        else "the difference between healthy vehicles is unknown: the identification has no diagnosis"
    )
    return [
        f"right cause: {_share(known[RIGHT], known['found'])} of the faults found",
        f"wrong cause: {_share(known[WRONG], known['found'])} of the faults found",
        of_large,
        "95 % intervals of right causes that hold the fault's size: "
        f"{_share(known['held'], known['intervals'])}",
        'without a single cause, "other" or the equivalent gain: '
        f"{_share(single[RIGHT], single['found'])} of the faults found",
        f'of these, "other" where amplitudes differ by {UNEVEN:g} or more: '
        f"{_share(single['uneven_said_other'], single['uneven'])}",
    ]


def _share(n: int, total: int) -> str:
    return share_words(rate(n, total))
