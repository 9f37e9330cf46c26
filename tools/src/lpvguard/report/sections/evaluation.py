"""Section "Evaluation": false alarms, injected faults and baselines."""

from html import escape

from ...core.compiled import TESTS
from ...evaluate.causes import CAUSE_HEAD, cause_rows, cause_sentences
from ...evaluate.comparison import (
    ALARM_HEAD,
    CALIBRATED,
    DUEL_HEAD,
    EXPORTED,
    HELD_OUT,
    LEFT_ONE_OUT,
    MONITOR,
    REFUTABLE_HEAD,
    DetectorColumn,
    alarm_rows,
    columns,
    detector_rows,
    duel_rows,
    equal_rates,
    refutable_rows,
    row_name,
)
from ...evaluate.false_alarms import PIECE_S
from ...identify.joint import POOLS, UNITS
from ..markup import captioned, html_rows, html_table, number
from ..pictures.detectors import SOONEST_S, time_to_find

OURS = "lpvguard, all tests at one threshold"
JUDGED = {
    LEFT_ONE_OUT: ("Evaluation, leave one drive out", "Every drive that did not set the bounds"),
    HELD_OUT: ("Evaluation, held-out drives", "Every drive"),
}
"""Title of the section, and the judged drives."""
TEST_TITLES = {
    MONITOR: "all tests",
    "frame": "frame test",
    "energy": "energy test",
    "change": "change test",
    POOLS: "pools of frames",
}


def evaluation_section(evaluation: dict) -> str:
    """Return the section of an evaluation, the JSON of `lpvguard evaluate`."""
    left_out = "; ".join(f"{escape(n)}: {escape(why)}" for n, why in evaluation["left_out"].items())
    title, judged = JUDGED[evaluation["mode"]]
    return f"""<h2>{title}</h2>
<p>{judged} runs through the compiled core with thresholds from
{escape(evaluation["threshold_rule"])}. False alarms are counted by piece of \
{PIECE_S:g} s, drive and recording. Every second of a drive counts,
judged or not; a column states the length of the last piece. Rates are per recording and per hour of judged \
driving. Their intervals are exact (Clopper-Pearson; per hour: Poisson) over recordings, because \
alarms of one recording depend on each other. Drives left \
out: {left_out or "none"}.</p>
{_claim_table(evaluation)}\
<h3>False alarms</h3>{_alarm_table(evaluation)}{_drive_table(evaluation)}\
{_injected_faults(evaluation)}{_causes(evaluation)}{_baselines(evaluation)}"""


def _alarm_table(evaluation: dict) -> str:
    """False alarms of the monitor per group of drivers."""
    return html_table(ALARM_HEAD, [[escape(cell) for cell in row] for row in alarm_rows(evaluation)])


def _claim_table(evaluation: dict) -> str:
    """Table of what the thresholds promise: as identified, and for each drive without itself."""
    return html_table(
        ["calibration", "promise of its threshold"],
        [
            *(
                [f"{TEST_TITLES[t]}, as identified", escape(claim)]
                for t, claim in evaluation["claims"]["identified"].items()
            ),
            *(
                [
                    f"{TEST_TITLES[t]}{' at one threshold' if t == MONITOR else ''}, "
                    f"{CALIBRATED[evaluation['mode']]}",
                    escape("; or ".join(several)),
                ]
                for t, several in evaluation["claims"][evaluation["mode"]].items()
            ),
        ],
        "words",
    )


def _drive_table(evaluation: dict) -> str:
    """Table with one row per drive: thresholds, scores, alarms, judged time, fault instants."""
    without = " without it" if evaluation["mode"] == LEFT_ONE_OUT else ""
    return html_rows(
        {
            "drive": escape(r["run"]),
            "driver": escape(r["driver"]),
            **{
                f"{title}: threshold{without}, score": f"{r['calibration'][t]['threshold']:.3f}, "
                f"{number(r['scores'][t], 4)}"
                for t, title in TEST_TITLES.items()
            },
            "alarmed pieces": f"{r['alarmed'][MONITOR]} of {r['pieces']}",
            "last piece, s": f"{r['last_piece_s']:.1f}",
            "judged, s": f"{r['judged_s']:.1f}",
            "missing samples": str(r["missing_samples"]),
            "of in-range, excited time": "–"
            if r["judged_of_in_range_excited"] is None
            else f"{r['judged_of_in_range_excited']:.0%}",
            "faults from, s": ", ".join(f"{s:.0f}" for s in r["fault_starts_s"]) or "–",
        }
        for r in evaluation["drives"]
    )


def _time_to_find(faults: list[dict], within_s: float) -> str:
    """Picture of the times to find injected faults; empty when no fault was injected."""
    if not any(row["cases"] for row in faults):
        return ""
    return captioned(
        time_to_find("f7", faults, within_s),
        "<b>Time to find.</b> One mark per start in a drive: judged, excited driving from the fault's start "
        f"to the alarm that it caused. Crosses: not found within {within_s:g} s (dashed). Times below "
        f"{SOONEST_S:g} s are drawn at this value. Right: number found, of all.",
    )


def _injected_faults(evaluation: dict) -> str:
    """Found faults for all tests at one threshold, for the tests as exported, and for each test alone."""
    without = "; ".join(f"{escape(n)}: {escape(why)}" for n, why in evaluation["without_faults"].items())
    titles = {MONITOR: OURS, EXPORTED: "as exported"} | {t: f"{t} test alone" for t in TESTS}
    detectors, rates = columns(evaluation), evaluation["stated_rates"]
    injected = evaluation["injection"]
    times = _time_to_find(evaluation["faults"], injected["within_s"])
    exported = (
        f"the thresholds as exported together allow at most {rates[EXPORTED]:g}"
        if rates[EXPORTED] is not None
        else "no rate is stated for the thresholds as exported either"
    )
    tried = len(evaluation["drives"]) - len(evaluation["without_faults"])
    compared = equal_rates({titles[name]: rates[name] for name in (MONITOR, *TESTS)})
    table = _detectors({title: detectors[name] for name, title in titles.items()})
    return f"""<h3>Injected faults</h3>
<p>Faults are injected into {tried} of {len(evaluation["drives"])} drives, those longer than \
{injected["shortest_s"]:g} s. They start at {injected["starts"]} random instants of each after \
{injected["from_s"]:g} s, with at least
{injected["within_s"]:g} s of judged, excited driving left. A ramp grows for {injected["ramp_s"]:g} s. \
“From the start” is once per drive, from its first sample on. A fault is found if the first alarm after its \
start comes within {injected["within_s"]:g} s of such driving. It must also come
before any alarm of the same detector on the untouched drive. The time of an alarm is when the core judges; \
for a frame this is after its
end. A cell: starts with the fault found, of all starts (drives with the fault found from every start), and \
the median time; a miss counts as
the latest time. No faults in: {without or "none"}.</p>{times}{table}
<p>All tests at one threshold (an alarm of any test counts; the threshold of frames, pools and energy is \
{UNITS["frame"]:g} times that of change) and each test alone are compared {escape(compared)}; \
{exported}.</p>"""


def _causes(evaluation: dict) -> str:
    """Causes that the core names; empty if it names none."""
    causes = evaluation["causes"]
    if causes is None:
        return ""
    table = html_table(CAUSE_HEAD, [[escape(cell) for cell in row] for row in cause_rows(causes)], "words")
    sentences = ". ".join(escape(line[0].upper() + line[1:]) for line in cause_sentences(causes))
    return f"""<h3>Causes named</h3>
<p>For every fault found with the thresholds as exported: the cause that the core names after 10 s of settled,
excited driving after the alarm. Not yet: there was already an alarm, or too little such driving followed. An
interval should hold the fault's mean size from alarm to diagnosis. Two faults at once, a dead zone and a
saturating output are no single cause. For them "other" is right, and so is a gain whose interval holds the
equivalent gain. {sentences}.</p>{table}"""


def _detectors(detectors: dict[str, DetectorColumn], best: list[str] | None = None) -> str:
    """Table of false alarms and found faults, one column per detector; ``best`` is the leader per fault.

    ``detectors`` has the titles as keys.
    """
    return html_table(
        ["", *map(escape, detectors), *(["best"] if best else [])],
        [[escape(cell) for cell in row] for row in detector_rows(list(detectors.values()), best)],
    )


def _baselines(evaluation: dict) -> str:
    """Compare baselines and monitor: settings, claims and leaders."""
    others, detectors, rates = evaluation["baselines"], columns(evaluation), evaluation["stated_rates"]
    if not others:
        return "<h3>Beside what is used today</h3><p>Not compared: too few drives calibrate a baseline.</p>"
    titles = {MONITOR: "lpvguard"} | {b["kind"]: b["title"] for b in others}
    searched = "; ".join(
        f"{escape(b['title'])}: {len(b['searched'])} settings, chosen "
        f"{escape(' or '.join(sorted({c['parameters'] for c in b['chosen'].values()})))}; "
        f"{escape('; or '.join(sorted({c['claim'] for c in b['chosen'].values()})))}"
        for b in others
    )
    best = [", ".join(titles[n] for n in row["best"]) for row in evaluation["faults"]]
    lost = [
        f"{escape(row_name(row))} ({escape(who)})"
        for row, who in zip(evaluation["faults"], best, strict=False)
        if row["best"] and row["best"] != [MONITOR]
    ]
    compared = equal_rates({title: rates[name] for name, title in titles.items()})
    table = _detectors({OURS: detectors[MONITOR]} | {b["title"]: detectors[b["kind"]] for b in others}, best)
    named = list(titles)
    refutable = html_table(
        ["", REFUTABLE_HEAD, *(escape(titles[name]) for name in named)],
        [[escape(cell) for cell in row] for row in refutable_rows([detectors[name] for name in named])],
    )
    against = html_table(
        DUEL_HEAD, [[escape(cell) for cell in row] for row in duel_rows(evaluation)], "words"
    )
    return f"""<h3>Beside what is used today</h3>
<p>Five detectors on the same residual e = y − ŷ, the same drives, and thresholds from the same calibration \
drives by the same
rule as the monitor with all tests at one threshold. They are compared {escape(compared)}. Their parameters \
are those
that find the most injected faults of all ways, and in a tie the fastest, on the bound-setting and the other \
calibration drives. The drive under test takes no
part ({searched}). Best: largest share of starts, then least median. Detectors in a tie are all named; none \
is named if none
found a fault. Where the monitor does not lead alone: {"; ".join(lost) or "nowhere"}.</p>
{table}
<p>The monitor and each single baseline, over the rows of faults: rows with as many found or more, with a \
smaller or larger median, rows that the monitor leads by found and then by median, and rows where it is \
behind.</p>
{against}
<p>Times from the instant at which a fault is refutable. This is the first judged instant at which the \
off-line margin of the faulty record exceeds 1 and that of the untouched record does not. A cell: found of \
these starts, and the median time; negative for an earlier alarm.</p>
{refutable}"""
