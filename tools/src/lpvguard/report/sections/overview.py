"""Section "At a glance", the first screen: tested and blind regions, alarms, the controller's promises."""

from collections.abc import Iterable
from html import escape
from pathlib import Path
from statistics import median

from ...base import artefacts
from ...base.claims import claim_words, worst_frozen
from ...base.errors import InputError
from ...drives.tables import EXPERIMENTS
from ...evaluate.comparison import HELD_OUT
from ...evaluate.summary import alarm_words
from ...identify.identification import StoredIdentification
from ...identify.premise import premise
from ...replay.replayer import Alarm
from ..blindness import BLIND, EMPTY, LEVEL, PROVED, VIOLATED, MapCell, Region, cells, regions, speed_row
from ..drive_summary import DriveSummary, Nearest
from ..markup import number, yes_or_no

ALARMS_SHOWN = 4
UNEXPLAINED_SHOWN = 3
SIGNS = {PROVED: "●", BLIND: "○", EMPTY: "–", VIOLATED: "▲"}
"""Sign of each state of a cell, beside its colour."""
AS_NEAR = 5e-4
"""Largest difference between ratios to the threshold that are shown as equal."""
NEVER = 2.0
"""Largest meaningful gain error. With a larger one, the vehicle's response would have the opposite sign."""


def overview_section(
    stored: StoredIdentification,
    summaries: list[DriveSummary],
    replayed: bool,
    design: Path | None,
    evaluation: dict | None,
) -> str:
    """Make the section.

    ``summaries`` are the replayed drives; the list is empty if ``replayed`` is False. ``design`` is the
    folder of `lpvguard design`. ``evaluation`` is the JSON of `lpvguard evaluate`.
    """
    alarms = [(d, a) for d in summaries for a in d.alarms]
    grid = cells(stored.visibility, (a for _, a in alarms))
    shown = blind_map(stored, grid, (a for _, a in alarms))
    groups = stored.manifest["drives"]
    judged = {d.name for d in summaries if d.judged_s > 0}
    independent = len(judged - set(groups["bounds"]) - set(groups["calibration"]))
    return f"""<h2>At a glance</h2>{_rate(stored, evaluation)}
{_headline(grid, summaries, replayed, independent)}
<div class="glance" id="glance"><div class="wide">{_good_for(grid)}{shown}</div>
<div class="cards">{_alarms(summaries, alarms, _independence(independent, evaluation))}\
{_promise(stored, design)}{_to_do(grid, summaries)}</div></div>"""


def _rate(stored: StoredIdentification, evaluation: dict | None) -> str:
    """Alarms an hour without a fault: promised and, where an evaluation is at hand, measured."""
    words = (
        f"alarms without a fault: {stored.calibration.claim()}; not measured without --evaluation"
        if evaluation is None
        else alarm_words(evaluation)
    )
    return f'<p id="alarm-rate">{escape(words[0].upper() + words[1:])}.</p>'


def _headline(
    grid: list[list[MapCell]], summaries: list[DriveSummary], replayed: bool, independent: int
) -> str:
    """Headline: whether the model held, and on how much of its range.

    It is green only if a judged drive set neither bounds nor threshold.
    """
    flat = [c for row in grid for c in row]
    proved = sum(c.state == PROVED for c in flat)
    sees = f"A gain error of {_percent(LEVEL)} would be seen in {proved} of {len(flat)} cells of speed and "
    sees = f'<span class="{"" if proved else "no"}">{sees}frequency.</span>'
    if not replayed:
        return f'<p id="headline"><b>Not replayed.</b> {sees}</p>'
    hours = sum(d.judged_s for d in summaries) / 3600
    words = outcome(summaries)
    alarmed = any(drive.alarms for drive in summaries)
    if alarmed or independent:
        held = yes_or_no(not alarmed, words, words)
    else:
        held = f"{words}, but every drive that was judged set the bounds or the threshold"
    return f'<p id="headline" data-proved="{proved}">{held}, {hours:.2f} h judged. {sees}</p>'


def outcome(summaries: list[DriveSummary]) -> str:
    """Meaning of the drives' alarms for the model (THEORY 7.18)."""
    alarms = [a for drive in summaries for a in drive.alarms]
    if not alarms:
        return f"Not falsified: no alarm on {len(summaries)} drives"
    refuted = any(a.verdict == "invalid" for a in alarms)
    alarmed = sum(bool(drive.alarms) for drive in summaries)
    word = "Falsified" if refuted else "Degraded, not falsified"
    alarm_words = "1 alarm" if len(alarms) == 1 else f"{len(alarms)} alarms"
    return f"{word}: {alarm_words} on {alarmed} of {len(summaries)} drives"


# ------------------------------------------------------------------------------------ good for, and blind to


def _percent(error: float) -> str:
    """Format a gain error as HTML text, at most as NEVER."""
    return f"{100 * error:.0f} %" if error <= NEVER else f"&gt;{100 * NEVER:.0f} %"


def _short(error: float) -> str:
    """Format a gain error [%], with a decimal if rounding would hide on which side of LEVEL it is."""
    if error > NEVER:
        return f"&gt;{100 * NEVER:.0f}"
    return f"{100 * error:.{1 if 0 < abs(error - LEVEL) < 5e-3 else 0}f}"


def _frequency(omega: float, unit: str = "") -> str:
    """A frequency [rad/s] as text, with ``unit`` if any."""
    return "DC" if omega == 0 else f"{omega:.3g}{unit}"


def _data(values: dict[str, str]) -> str:
    """Attributes data-* of an element."""
    return "".join(f' data-{key}="{value}"' for key, value in values.items())


def _run_words(first: MapCell, last: MapCell) -> str:
    """Frequency range of a run of bins as text."""
    if first.bin == last.bin:
        return _frequency(first.omega, " rad/s")
    return f"{_frequency(first.omega)} to {_frequency(last.omega)} rad/s"


def _listed(name: str, regions: list[Region]) -> str:
    """A list of regions whose elements carry their speeds and frequencies."""
    items = "".join(
        f'<li data-speed-low="{r.speed_mps[0]:.4g}" data-speed-high="{r.speed_mps[1]:.4g}" data-omega="'
        + " ".join(f"{a.omega:.4g}:{b.omega:.4g}" for a, b in r.runs)
        + f'">{r.speed_mps[0]:.3g} to {r.speed_mps[1]:.3g} m/s: '
        + ", ".join(_run_words(a, b) for a, b in r.runs)
        + "</li>"
        for r in regions
    )
    return f'<ul id="{name}">{items or "<li>nowhere</li>"}</ul>'


def _good_for(grid: list[list[MapCell]]) -> str:
    """Lists of where a gain error of LEVEL is seen, and where it could stay unseen."""
    seen = regions(grid, lambda c: c.state == PROVED)
    unseen = regions(grid, lambda c: c.state in (BLIND, EMPTY))
    broken = regions(grid, lambda c: c.state == VIOLATED)
    error = f"a gain error of {_percent(LEVEL)}"
    violated = (
        f'<p><b class="no">{SIGNS[VIOLATED]} Violated:</b> the frame test alarmed at</p>'
        f"{_listed('violated', broken)}"
        if broken
        else ""
    )
    return f"""<div class="words2" data-level="{LEVEL:g}"><div><p><b class="yes">{SIGNS[PROVED]} Good for:\
</b> {error}, driven as here, is seen at</p>{_listed("seen", seen)}</div>
<div><p><b>{SIGNS[BLIND]} Blind to:</b> {error} could stay unseen at</p>{_listed("unseen", unseen)}</div>
{f"<div>{violated}</div>" if violated else ""}</div>"""


def _cell_words(cell: MapCell) -> str:
    """All numbers of a cell, as text."""
    low, high = cell.speed_mps
    where = f"{low:.3g} to {high:.3g} m/s, {_frequency(cell.omega, ' rad/s')}"
    if cell.gain_error is None:
        return f"{where}: nothing judged, nothing is known"
    alarms = f"; alarms of the frame test: {cell.alarms}" if cell.alarms else ""
    limit = "" if cell.limit is None else f"; limit {number(cell.limit)}"
    return (
        f"{where}: smallest visible gain error {number(cell.gain_error)} in one frame of ten, "
        f"{number(cell.strongest)} in the strongest of {cell.frames}, {number(cell.floor)} in frames at any "
        f"excitation{limit}{alarms}"
    )


def _map_cell(row: int, cell: MapCell) -> str:
    """A cell of the map with its numbers."""
    data = {
        "speed-low": f"{cell.speed_mps[0]:.4g}",
        "speed-high": f"{cell.speed_mps[1]:.4g}",
        "omega": f"{cell.omega:.4g}",
        "gain-error": "" if cell.gain_error is None else f"{cell.gain_error:.4g}",
        "strongest": "" if cell.strongest is None else f"{cell.strongest:.4g}",
        "limit": "" if cell.limit is None else f"{cell.limit:.4g}",
        "floor": f"{cell.floor:.4g}",
        "frames": str(cell.frames),
        "alarms": str(cell.alarms),
        "state": cell.state,
    }
    shown = f"{cell.alarms}×" if cell.alarms else "" if cell.gain_error is None else _short(cell.gain_error)
    words = _cell_words(cell)
    return (
        f'<td id="cell-{row}-{cell.bin}" class="{cell.state}"{_data(data)} title="{words}">'
        f"<span>{SIGNS[cell.state]}</span> {shown}</td>"
    )


def blind_map(stored: StoredIdentification, grid: list[list[MapCell]], alarms: Iterable[Alarm]) -> str:
    """The main picture as an HTML table: speed over frequency, with the highest speed at the top.

    ``alarms`` come from all drives. Alarms of the energy and the change test have a separate column.
    """
    others = [0] * len(grid)
    for a in (a for a in alarms if a.bin_rad_s is None):
        others[speed_row(stored.visibility, a.speed_mps)] += 1
    head = "".join(f'<th scope="col">{_frequency(c.omega)}</th>' for c in grid[0])
    rows = "".join(
        f'<tr><th scope="row">{grid[r][0].speed_mps[0]:.3g}–\N{WORD JOINER}{grid[r][0].speed_mps[1]:.3g}</th>'
        + "".join(_map_cell(r, c) for c in grid[r])
        + f'<td class="{VIOLATED if others[r] else "none"}" data-other-alarms="{others[r]}">'
        + (f"<span>{SIGNS[VIOLATED]}</span> {others[r]}×" if others[r] else "none")
        + "</td></tr>"
        for r in reversed(range(len(grid)))
    )
    level = _percent(LEVEL)
    return f"""<figure class="map"><div class="scroll"><table id="blind-map">
<thead><tr><th>m/s \\ rad/s</th>{head}<th scope="col">energy, change</th></tr></thead>\
<tbody>{rows}</tbody></table></div>
<p id="map-reading" class="note" aria-live="polite">Point at a cell, or move with the arrow keys, for \
all its numbers.</p>
<figcaption><b>What the drives prove, by speed and frequency.</b> Number: the smallest gain error [%] that \
a frame, a pool of frames or the change test sees in one of ten.
<span class="key {PROVED}">{SIGNS[PROVED]} proved</span> judged, no alarm, and {level} would have been one;
<span class="key {BLIND}">{SIGNS[BLIND]} blind</span> {level} could stay unseen;
<span class="key {EMPTY}">{SIGNS[EMPTY]} no data</span>;
<span class="key {VIOLATED}">{SIGNS[VIOLATED]} violated</span> alarms, how many. The error stands alone \
here: the vehicle's ordinary error can hide or add to it.{_limit_words(grid)}</figcaption></figure>"""


def _limit_words(grid: list[list[MapCell]]) -> str:
    """Sentence that compares the limit of detection with what the tests see."""
    pairs = [(c.gain_error, c.limit) for row in grid for c in row if c.limit is not None]
    ratios = [seen / limit for seen, limit in pairs if seen is not None]
    if not ratios:
        return ""
    within = sum(limit <= LEVEL for _, limit in pairs)
    middle = median(ratios)
    return (
        f' <span id="limit" data-within="{within}" data-ratio="{middle:.4g}">A test that knew how the '
        f"vehicle errs would see {_percent(LEVEL)} in {within} cells; the numbers here are {middle:.2g} "
        "times its limit in the median.</span>"
    )


# ---------------------------------------------------------------------------------------------------- alarms


def place(test: str, omega: float | None, band: str | None = None) -> str:
    """Text with the test and frequency [rad/s] of an alarm or of the nearest approach to one."""
    if omega is None:
        return f"{test} test" + (f", {band.replace('_', ' ')} the corners" if band else "")
    return f"{test} test, {_frequency(omega, ' rad/s')}"


def _alarm_row(drive: DriveSummary, alarm: Alarm) -> str:
    ratio = alarm.statistic / alarm.threshold
    return (
        f'<tr data-drive="{escape(drive.name)}" data-t="{alarm.t_s:.2f}" data-ratio="{ratio:.4g}">'
        f'<td><a href="#{drive.key}">{escape(drive.name)}</a></td>'
        f"<td>{place(alarm.test, alarm.bin_rad_s, alarm.band)}</td><td>{ratio:.3g} ×</td>"
        f"<td>{alarm.t_s:.1f} s</td><td>{alarm.speed_mps:.3g} m/s</td></tr>"
    )


def _nearest_words(drive: DriveSummary, near: Nearest, quiet: list[tuple[DriveSummary, Nearest]]) -> str:
    """Find the ``quiet`` drive that is nearest to an alarm, and the drives that are equally near."""
    data = {
        "drive": escape(drive.name),
        "ratio": f"{near.ratio:.4g}",
        "test": near.test,
        "omega": "" if near.omega is None else f"{near.omega:.4g}",
        "t": f"{near.t_s:.2f}",
        "speed": f"{near.speed_mps:.4g}",
    }
    as_near = [d for d, other in quiet if d is not drive and near.ratio - other.ratio < AS_NEAR]
    tied = ", ".join(f'<a href="#{d.key}">{escape(d.name)}</a>' for d in as_near)
    tied = f" As near: {tied}." if tied else ""
    itself = " Its score is the threshold." if abs(near.ratio - 1) < 1e-5 else ""
    return (
        f'<p id="nearest"{_data(data)}><b>Nearest to an alarm without one:</b> <a href="#{drive.key}">'
        f"{escape(drive.name)}</a>, {near.ratio:.3f} of the threshold: {place(near.test, near.omega)}, "
        f"{near.t_s:.1f} s after its start, {near.speed_mps:.3g} m/s ({drive.role}).{itself}{tied}</p>"
    )


def _independence(independent: int, evaluation: dict | None) -> str:
    """Say what alarms or their absence prove, from the number of drives that set no bound or threshold."""
    words = (
        f"{independent} of the drives set neither bounds nor threshold."
        if independent
        else "Every drive set the bounds or the threshold: no alarm on them proves little."
    )
    if evaluation is None:
        return words
    counts = evaluation["false_alarms"]["all"]
    which = (
        "Drives that the identification never saw"
        if evaluation["mode"] == HELD_OUT
        else "Each left out of its own threshold"
    )
    return (
        f'{words} <span id="left-out" data-alarmed="{counts["alarmed_drives"]}" '
        f'data-drives="{counts["drives"]}">'
        f"{which}: {counts['alarmed_drives']} of {counts['drives']} alarm.</span>"
    )


def _alarms(summaries: list[DriveSummary], alarms: list[tuple[DriveSummary, Alarm]], worth: str) -> str:
    """Card with the alarms, what they prove (``worth``, HTML), and the drive nearest to an alarm."""
    if not summaries:
        return (
            '<div class="card" id="alarms"><h3>Alarms</h3><p>Not replayed: the core computes Hann frames '
            "only. The exact margins stand drive by drive below.</p></div>"
        )
    worst = sorted(alarms, key=lambda one: -one[1].statistic / one[1].threshold)
    first: dict[str, tuple[DriveSummary, Alarm]] = {}
    for drive, alarm in worst:
        first.setdefault(drive.name, (drive, alarm))
    shown = list(first.values())[:ALARMS_SHOWN]
    head = f"{len(alarms)} on {len(first)} of {len(summaries)} drives" if alarms else "None"
    table = (
        '<div class="scroll"><table><thead><tr><th>drive</th><th>worst alarm</th><th>threshold</th>'
        "<th>at</th><th>speed</th></tr></thead>"
        f"<tbody>{''.join(_alarm_row(*one) for one in shown)}</tbody></table></div>"
        if shown
        else ""
    )
    more = f"<p>{len(first) - len(shown)} more drives with alarms.</p>" if len(first) > len(shown) else ""
    quiet = [(d, d.nearest) for d in summaries if not d.alarms and d.nearest is not None]
    nearest = max(quiet, key=lambda one: one[1].ratio, default=None)
    words = (
        _nearest_words(*nearest, quiet)
        if nearest
        else '<p id="nearest">No drive was judged without alarm.</p>'
    )
    return f"""<div class="card" id="alarms" data-alarms="{len(alarms)}" data-drives="{len(first)}">
<h3>Alarms</h3><p>{head}. {worth} <a href="#drive-index">All drives in one table</a>.</p>
{table}{more}{words}</div>"""


# ------------------------------------------------------------------------------------- controller, and to do


def _promise(stored: StoredIdentification, design: Path | None) -> str:
    """Card with the controller's promise and the premise of every promise."""
    try:
        evidence = premise(stored)
        least = evidence.refuting
        words = yes_or_no(not evidence.refuted, "Premise not refuted", "Premise refuted")
        evidence_words = (
            "drives that did not set the bounds need no uncertainty"
            if least is None
            else f"W<sub>Δ</sub> is {number(least.ratio)} times what drives that did not set the bounds ask "
            f"for, at least ({escape(least.output.replace('_', ' '))}, {number(least.omega)} rad/s, "
            f"{number(least.v)} m/s)"
        )
        doubt = (
            ' <b class="no">Room for doubt:</b> within their standard errors a larger error is possible.'
            if evidence.doubtful
            else ""
        )
        held = f"{words}: {evidence_words}.{doubt}"
    except InputError as error:
        held = f'<span class="no">Premise not judged:</span> {escape(error.what)}.'
    if design is None:
        return (
            '<div class="card" id="promise"><h3>Controller</h3><p>None on this page: it promises nothing '
            f"about a closed loop. For any certificate: {held}</p></div>"
        )
    said_of = artefacts.read_json(design / "controller.json")["certificates"]
    mu = worst_frozen(said_of)["mu_upper"]
    speeds = [r["v_mps"] for r in said_of["speeds"]]
    moving = ", ".join(
        claim_words(claim, claim_entry["level"], claim_entry["rate_mps2"])
        for claim, claim_entry in said_of["moving_speed"].items()
        if claim_entry["rate_mps2"]
    )
    return f"""<div class="card" id="promise" data-mu="{mu:.6g}"><h3>Controller</h3>
<p>{yes_or_no(mu < 1, "Robust performance proved", "Robust performance not proved")}: μ ≤ {mu:.4f} at \
{len(speeds)} frozen speeds from {min(speeds):.3g} to {max(speeds):.3g} m/s and one between, for every \
vehicle within |δ| ≤ W<sub>Δ</sub>. {
        f"At a moving speed: {moving}." if moving else "Nothing is claimed of a moving speed."
    }</p><p>{held}</p></div>"""


def _unexplained(summaries: list[DriveSummary]) -> str:
    """Drives that the model does not explain, worst first, with advice; "" if there are none."""
    worst = sorted(
        ((d, d.unexplained) for d in summaries if d.unexplained is not None), key=lambda one: one[1].vaf
    )
    if not worst:
        return ""
    named = ", ".join(
        f'<a href="#{d.key}">{escape(d.name)}</a> ({"sets bounds" if u.sets_bounds else "calibrates"}, '
        f"{1 - u.vaf:.0%} of {escape(u.output.replace('_', ' '))} left)"
        for d, u in worst[:UNEXPLAINED_SHOWN]
    )
    more = f" and {len(worst) - UNEXPLAINED_SHOWN} more" if len(worst) > UNEXPLAINED_SHOWN else ""
    return (
        f'<span id="unexplained" data-drives="{len(worst)}"><b class="no">Look at these drives:</b> the '
        f"model leaves more than half of {named}{more}. Bounds and thresholds hold on them, and grow. Where "
        f"the model is not meant for them, write no and why into {EXPERIMENTS}.</span>"
    )


def _to_do(grid: list[list[MapCell]], summaries: list[DriveSummary]) -> str:
    """Card with remedies for blind cells, and drives that reduce visibility."""
    level = _percent(LEVEL)
    flat = [c for row in grid for c in row]
    louder = regions(grid, lambda c: c.state == BLIND and c.floor <= LEVEL)
    empty = regions(grid, lambda c: c.state == EMPTY)
    never = sum(c.state == BLIND and c.floor > LEVEL for c in flat)
    lines = [line for line in [_unexplained(summaries)] if line]
    if empty:
        lines.append(f"Drive there, nothing was counted:{_listed('to-drive', empty)}")
    if louder:
        lines.append(f"Excite more; {level} can be seen there:{_listed('to-excite', louder)}")
    if never:
        lines.append(
            f"{never} of {len(flat)} cells stay blind to {level} at any excitation: only a better nominal "
            "model, hence smaller W<sub>Δ</sub>, helps."
        )
    items = "".join(f"<li>{line}</li>" for line in lines)
    return f'<div class="card" id="to-do"><h3>To see more</h3><ul>{items or "<li>nothing</li>"}</ul></div>'
