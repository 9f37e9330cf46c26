"""Section "Campaign in the closed loop": simulated trucks and faults, the monitor and the baselines."""

from html import escape

from ...base.rates import hourly_words, share_words
from ...evaluate.comparison import COUNTS_ONLY, WAYS_HEAD, way_rows
from ..markup import captioned, html_rows, html_table, number
from ..pictures.detectors import detection, detection_time
from ..pictures.drawing import Picture


def campaign_section(c: dict) -> str:
    """Return the section of a campaign, from its summary.json."""
    return f"""<h2>Campaign in the closed loop</h2>
{_falsified(c)}
{_runs(c)}
{_overall(c)}{_alarm_table(c)}
{_baselines(c)}
{_ways(c)}
{_pictures(c)}
<h3>Kinds of fault</h3>{_kind_table(c)}\
<p>Where a baseline wins, {escape(c["matched_claim"])}: {_beaten(c)}.</p>\
<h3>Severities</h3>{_severity_table(c)}
{_invisible(c)}
{_bus(c)}"""


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.2f} %"


def _severity(c: dict, row: dict) -> str:
    """Severity of a row with its unit."""
    return f"{row['severity']:g} {escape(c['units'][row['kind']])}"


def _level(severity: dict) -> str:
    """State the upper bound of mu of the loop with the fault, or state that the loop is unstable."""
    return number(severity["mu_upper"]) if severity["loop_stable"] else "unstable"


def _falsified(c: dict) -> str:
    """Paragraph on the runs within the bounds that contradict the certificate."""
    falsified = c["falsified"]
    text = f"""<p><b>Falsified certificates: {share_words(falsified["rate"])}</b> of the runs within the \
bounds. Such a run contradicts the certificate if it oscillates,
saturates for a second or leaves the tracking bound. All such runs are listed.</p>"""
    if not falsified["runs"]:
        return text
    return text + html_table(
        ["run", "seed", "truck", "mean speed, m/s", "contradiction"],
        [
            [
                str(r["number"]),
                str(r["seed"]),
                str(r["plant"]),
                f"{r['speed_mps']:.2f}",
                escape("; ".join(r["did"])),
            ]
            for r in falsified["runs"]
        ],
    )


def _checked(within: dict) -> str:
    """Speeds, amplitudes and frequencies at which the trucks' responses were measured."""
    checked = within["checked"]
    speeds = ", ".join(f"{v:g}" for v in checked["speeds_mps"])
    bars = [u for amplitudes in checked["amplitudes_bar"] for u in amplitudes]
    omega = checked["omega_rad_s"]
    return (
        f"{len(omega)} frequencies from {omega[0]:g} to {omega[-1]:g} rad/s, at {speeds} m/s, "
        f"{min(bars):.3g} to {max(bars):.3g} bar"
    )


def _runs(c: dict) -> str:
    """Paragraph that describes the runs, the rates, and the word "visible"."""
    within = c["within"]
    faulted = sum(s["runs"] for s in c["severities"])
    claims = "; ".join(f"{escape(t)} test: {escape(limit['claim'])}" for t, limit in c["calibrated"].items())
    return f"""<p>{within["runs"]} runs, {within["hours"]:.1f} h of driving \
({within["judged_hours"]:.1f} h judged), of {within["plants"]} trucks whose frequency
response lies within the bounds: |δ| ≤ W_Δ at {_checked(within)}. They were selected from \
{within["candidates"]} random trucks; their largest |δ|/W_Δ is
{within["largest_ratio"]:.3f}, that of the nominal truck {within["nominal_ratio"]:.3f}. {faulted} runs have \
a fault of the truck. Intervals are exact, over runs
(Clopper-Pearson; per hour: Poisson), because alarms of one run depend on each other.
Calibrated per drive: {claims}. A fault is <i>visible</i> in a run if off-line t* \
is at least 1.5 times the threshold in a
tenth of the excited frames after it. This does not use the monitor's results. The bounds required some \
alarms;
{share_words(c["due"])} of them came in time.</p>"""


def _overall(c: dict) -> str:
    """Table of false alarms and found faults, one column per detector."""
    names, within, stated = c["detectors"], c["within"], c["matched_stated"]
    matched = escape(c["matched_claim"])
    return html_table(
        ["", *map(escape, names.values())],
        [
            [
                "runs within the bounds that alarm, 95 % interval",
                *(share_words(within["alarmed"][d]) for d in names),
            ],
            ["visible faults found in time, 95 % interval", *(share_words(c["visible"][d]) for d in names)],
            [
                "average found, calibrated thresholds",
                *(f"{c['average'][d]['calibrated']:.1%}" for d in names),
            ],
            [f"average found, {matched}", *(f"{c['average'][d]['matched']:.1%}" for d in names)],
            [
                "at the latter thresholds a further run alarms",
                *(COUNTS_ONLY if stated[d] is None else f"at most {stated[d]:.3g}" for d in names),
            ],
        ],
    )


def _alarm_table(c: dict) -> str:
    """Table of alarms in the runs within the bounds, per test of the monitor, with the calibrated rate."""
    tests = c["within"]["tests"]
    return html_table(
        [
            "test of the monitor",
            "runs within the bounds that alarm, 95 % interval",
            "calibrated to at most",
            "with 95 % confidence below",
            "such runs an hour, 95 % interval",
            "calibrated to at most",
            "such runs an hour judged, 95 % interval",
            "alarms in all",
        ],
        [
            [
                t,
                share_words(r),
                _percent(limit["alpha"]),
                _percent(limit["conditional_bound"]),
                hourly_words(r["per_hour"]),
                number(limit["per_hour"]),
                hourly_words(r["per_judged_hour"]),
                str(r["alarms"]),
            ]
            for t, r, limit in ((t, r, c["calibrated"][t]) for t, r in tests.items())
        ],
    )


def _baselines(c: dict) -> str:
    """Calibration and comparison of the baselines."""
    baselines = ", ".join(escape(b["label"]) for b in c["baselines"])
    return f"""<p>Baselines ({baselines}) run on the same samples. Their thresholds come from the same \
calibration drives by the same rule. These drives are of one
truck, so the rate is different on other trucks within the bounds. \
“{escape(c["matched_claim"])}” therefore uses for
each detector the least threshold at which the same rule allows its alarms in the runs within the \
bounds and before the faults.</p>"""


def _ways(c: dict) -> str:
    """Faults that begin in several ways: at once, growing, from the start of the run."""
    names = [escape(title) for title in c["detectors"].values()]
    rows = [[escape(cell) for cell in row] for row in way_rows(c)]
    return f"""<p>Faults of the truck begin in several ways. All other results in this section are for the \
first way, at once. A cell: share found at
calibrated thresholds, share found {escape(c["matched_claim"])}, and median time from the fault's start.</p>
{html_table([*WAYS_HEAD, *names], rows)}"""


def drawn_campaign(c: dict) -> dict[str, Picture]:
    """Draw detection and time to the first alarm over severity.

    Parameters
    ----------
    c : dict, summary.json of `lpvguard campaign`

    Returns
    -------
    dict[str, Picture], by name
    """
    severities, units, names = c["severities"], c["units"], c["detectors"]
    return {
        "matched": detection("c0", severities, units, names, "matched"),
        "found": detection("c1", severities, units, names, "found"),
        "time": detection_time("c2", severities, units, names),
    }


def _pictures(c: dict) -> str:
    """These pictures with their captions."""
    drawn = drawn_campaign(c)
    matched = captioned(
        drawn["matched"],
        f"<b>Detection against severity</b>, {escape(c['matched_claim'])}: share of runs in which the first "
        "alarm came within 60 s of judged, excited driving after the fault, and none before it. Grey: share "
        "of runs in which the fault is visible.",
    )
    calibrated = captioned(
        drawn["found"],
        "<b>Detection against severity</b>, at the thresholds calibrated on the drives of the "
        "identification.",
    )
    time = captioned(
        drawn["time"],
        "<b>Time to the first alarm against severity</b>, at these thresholds: median judged, excited time "
        "over the runs without an alarm before the fault. No point: half of the runs or more never alarmed.",
    )
    return f"{matched}\n{calibrated}\n{time}"


def _kind_table(c: dict) -> str:
    """Table of the share found per kind of fault and detector, at both sets of thresholds, and the leader."""
    names, matched = c["detectors"], escape(c["matched_claim"])

    def best(detectors: list[str]) -> str:
        return escape(", ".join(names[d] for d in detectors))

    return html_rows(
        {
            "kind": escape(k["kind"]),
            **{
                f"{escape(n)}: calibrated; {matched}": f"{k['found'][d]:.0%}, {k['matched'][d]:.0%}"
                for d, n in names.items()
            },
            "best, calibrated": best(k["best"]),
            f"best, {matched}": best(k["best_matched"]),
        }
        for k in c["kinds"]
    )


def _beaten(c: dict) -> str:
    """Kinds of fault on which a baseline finds more than the monitor."""
    names = c["detectors"]
    return (
        "; ".join(
            f"{escape(names[b['detector']])} on {escape(b['kind'])}, {b['matched']:.0%} against "
            f"{b['monitor']:.0%}"
            for b in c["beaten"]
        )
        or "nowhere"
    )


def _severity_table(c: dict) -> str:
    """Table with one row per kind and severity: distance, mu, runs, and what each detector found."""
    names = c["detectors"]
    return html_rows(
        {
            "kind": escape(s["kind"]),
            "severity": _severity(c, s),
            "|δ|/W_Δ of its own response; above 1: at least": number(s["response_ratio"]),
            "mu of its loop": _level(s),
            "runs": str(s["runs"]),
            "visible runs": str(s["visible_runs"]),
            **{
                f"{escape(n)}: found, median s": f"{s['found'][d]}, {number(s['median_s'][d])}"
                for d, n in names.items()
            },
        }
        for s in c["severities"]
    )


def _invisible(c: dict) -> str:
    """Faults that lose robust performance although few runs show it."""
    hidden = "; ".join(
        f"{escape(s['kind'])} {_severity(c, s)} (mu {_level(s)}, found {s['found']['monitor']} of "
        f"{s['runs']})"
        for s in c["invisible"]
    )
    return f"""<h3>Invisible, though robust performance is lost</h3><p>Upper bound of mu of the faulted loop \
at least 1, visible in fewer than half of the runs:
{hidden or "none"}. The energy test or single frames find some of them, but this is not promised. \
mu is the largest over three speeds; it exists for linear, time-invariant faults.</p>"""


def _bus(c: dict) -> str:
    """Required and actual reactions of the supervision to bus faults."""
    faulty, healthy = c["supervision"]["faulty"], c["supervision"]["healthy"]
    return f"""<h3>Faults of the bus</h3><p>The frames on the bus and the message table determine the state \
of the supervision at every tick.
Three missed periods give hold. Five missed periods or a score of five bad frames give off. Five good frames \
give live again. This is computed
independently of the core. The states were as required in {share_words(faulty["as_required"])} of the runs \
with a faulty bus; {faulty["met"]} of
{faulty["due"]} required reactions came at the exact tick. They were as required in \
{share_words(healthy["as_required"])} of the runs within the bounds,
which require no reaction. <i>Judged</i> is the share of excited driving since the fault that the monitor \
judged: after
every gap its model has to settle. Two columns count alarms of model error, and runs in which the samples \
themselves have an error: a late or corrupted
value that passes as good. <code>GUARD_IN</code> was {c["command_authentication"]}.</p>\
{_bus_table(c)}"""


def _bus_table(c: dict) -> str:
    """Table with one row per bus fault and severity."""
    return html_rows(
        {
            "fault": escape(s["kind"]),
            "severity": _severity(c, s),
            "runs as required": f"{s['as_required']} of {s['runs']}",
            "reactions due, met": f"{s['due']}, {s['met']}",
            "not live for": f"{s['away']:.1%}",
            "judged": f"{s['judged']:.0%}",
            "runs that alarm": str(s["alarmed"]["monitor"]),
            "visible runs": str(s["visible_runs"]),
        }
        for s in c["bus"]
    )
