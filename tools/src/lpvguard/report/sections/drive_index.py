"""Index of the drives: one row per drive with a small picture over time and a link to its section.

page.js sorts and searches it.
"""

from html import escape
from itertools import groupby

import numpy as np

from ...core.compiled import VERDICTS
from ..drive_summary import COLUMNS, DriveSummary
from ..pictures.margin_map import VERDICT_COLOURS
from .overview import place

HEAD = (
    ("drive", "text"),
    ("driver", "text"),
    ("part", "text"),
    ("speed, m/s", "number"),
    ("duration, s", "number"),
    ("judged, s", "number"),
    ("of in-range, excited", "number"),
    ("explained", "number"),
    ("course of the margin, and verdict", ""),
    ("largest, of the threshold", "number"),
    ("where", "text"),
    ("at, s", "number"),
    ("alarms", "number"),
    ("final verdict", "text"),
)
"""Column titles, and the order in which page.js sorts them; "" does not sort."""
STEP, TOP, LINE, STRIP = 2, 2, 8, 4
"""Small picture, in pixels: column width, height beyond the axis, height of the threshold, height of the
verdicts."""
HEIGHT = 26
MOST = 1.25
"""Upper end of the picture's axis, in units of the threshold."""


def _small(drive: DriveSummary) -> str:
    """Draw the drive's largest statistic and its verdict over time as a small picture.

    Bars show the largest statistic over threshold. A dashed line shows the threshold, and triangles show
    larger values. A strip below shows the verdict.
    """
    base = HEIGHT - STRIP - 1
    scale = (base - LINE) / 1.0
    quiet, beyond, marks = "", "", ""
    for i, ratio in enumerate(drive.course):
        if np.isnan(ratio):
            continue
        x, y = STEP * i + STEP // 2, base - scale * min(float(ratio), MOST)
        bar = f"M{x} {base}V{y:.1f}"
        if ratio > 1:
            beyond += bar
            marks += f"M{x - 3} {TOP - 2}h6l-3 5z"
        else:
            quiet += bar
    strip, x = "", 0
    for code, run in groupby(drive.verdict.tolist()):
        width = STEP * len(list(run))
        strip += f'<path d="M{x} {HEIGHT - STRIP}h{width}v{STRIP}h-{width}z" fill="{_colour(code)}"/>'
        x += width
    largest = "nothing judged" if drive.nearest is None else f"largest {drive.nearest.ratio:.3g}"
    return (
        f'<svg class="small" role="img" aria-label="margin over time, of the threshold: {largest}" '
        f'viewBox="0 0 {STEP * COLUMNS} {HEIGHT}">'
        f'<path d="{quiet}" class="quiet"/><path d="{beyond}" class="beyond"/>'
        f'<path d="M0 {LINE}H{STEP * COLUMNS}" class="line"/><path d="{marks}" class="mark"/>{strip}</svg>'
    )


def _colour(code: int) -> str:
    return VERDICT_COLOURS[VERDICTS[code]]


def _explained(drive: DriveSummary) -> tuple[str, float | None]:
    """Text and value of the variance that the model explains in the drive."""
    if np.isnan(drive.vaf):
        return "–", None
    text = f"{drive.vaf:.1%}"
    return (f'<span class="no">{text}</span>' if drive.unexplained else text), drive.vaf


def _row(drive: DriveSummary) -> str:
    near = drive.nearest
    share = drive.judged_relevant_s / drive.relevant_s if drive.relevant_s else None
    low, high = drive.speed_mps
    cells: list[tuple[str, float | None]] = [
        (f"{low:.1f}–\N{WORD JOINER}{high:.1f}", low),
        (f"{drive.duration_s:.1f}", drive.duration_s),
        (f"{drive.judged_s:.1f}", drive.judged_s),
        ("–" if share is None else f"{share:.0%}", share),
        _explained(drive),
        (_small(drive), None),
        ("–" if near is None else f"{near.ratio:.3f}", None if near is None else near.ratio),
        ("–" if near is None else place(near.test, near.omega), None),
        ("–" if near is None else f"{near.t_s:.1f}", None if near is None else near.t_s),
        (f'<span class="no">▲ {len(drive.alarms)}</span>' if drive.alarms else "0", float(len(drive.alarms))),
        (escape(drive.verdict_final), None),
    ]
    texts = "".join(
        f"<td>{text}</td>" if value is None else f'<td data-value="{value:.6g}">{text}</td>'
        for text, value in cells
    )
    ratio = "" if near is None else f"{near.ratio:.4g}"
    return (
        f'<tr data-drive="{escape(drive.name)}" data-ratio="{ratio}" data-alarms="{len(drive.alarms)}">'
        f'<td><a href="#{drive.key}">{escape(drive.name)}</a></td><td>{escape(drive.driver)}</td>'
        f"<td>{drive.role}</td>{texts}</tr>\n"
    )


def drive_index(summaries: list[DriveSummary]) -> str:
    """The table, with its key."""
    head = "".join(f'<th scope="col" data-sort="{kind}">{title}</th>' for title, kind in HEAD)
    key = " ".join(
        f'<span class="key"><i style="background:{colour}"></i>{verdict.replace("_", " ")}</span>'
        for verdict, colour in VERDICT_COLOURS.items()
    )
    return f"""<h3>All drives</h3><div id="drive-tools"></div>
<div class="scroll"><table id="drive-index"><thead><tr>{head}</tr></thead>
<tbody>{"".join(_row(d) for d in summaries)}</tbody></table></div>
<p class="note">Course: the largest ratio of statistic to threshold of all tests over time. Dashed: the \
threshold. Triangles: larger values. Strip: the verdict: {key}. Largest: the largest ratio in the drive, \
above 1 an alarm. Explained: 1 − var(y − ŷ) / var(y) of the output that the nominal model explains \
least.</p>"""
