"""Read the numbers of a picture back from its drawn figure, for zooming and for CSV.

A picture is drawn once. The interactive picture and the table both come from its lines, markers, bars and
cells.
"""

import csv
import io
import json
import re
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_hex
from matplotlib.container import BarContainer, ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter, FuncFormatter

MOST_POINTS, MOST_BESIDE_CELLS = 1500, 300
"""Largest number of points of a line in the page; longer lines keep local extremes. CSV has all points."""
SYMBOLS = {
    r"\bar\nu": "ν̄",
    r"\infty": "∞",
    r"\gamma": "γ",
    r"\delta": "δ",
    r"\Delta": "Δ",
    r"\nu": "ν",
    r"\mu": "μ",
    r"\rho": "ρ",
    r"\omega": "ω",
}
"""Characters for the mathematical text of the pictures."""


@dataclass(frozen=True)
class Trace:
    """Numbers of one drawn element (matplotlib artist).

    ``kind``: "line" (with or without markers), "bar", "area", "level" (horizontal at y[0]) or "instant"
    (vertical at x[0]). ``x``, ``y`` (N,): NaN breaks a line. ``look``: colour, dash, marker, size, width,
    alpha.
    """

    kind: str
    label: str
    x: np.ndarray
    y: np.ndarray
    look: dict[str, Any]


@dataclass(frozen=True)
class Cells:
    """Frames of a drive, sorted by bin, then by time.

    ``bin`` (F,), ``end`` (F,) the sample after the frame's last [samples after the drive's first], ``margin``
    (F,), ``reason`` (F,) index into ``reasons``. ``lengths`` (K,) [samples] of the bins, ``Ts`` [s],
    ``threshold`` of the margin.
    """

    bin: np.ndarray
    end: np.ndarray
    margin: np.ndarray
    reason: np.ndarray
    reasons: list[str]
    lengths: np.ndarray
    Ts: float
    threshold: float


@dataclass(frozen=True)
class Panel:
    """Axes of a picture: labels, limits, scale (logarithmic or not), named ticks and traces.

    ``row`` counts from the top; panels with the same ``shared`` number zoom together in x.
    """

    title: str
    labels: tuple[str, str]
    log: tuple[bool, bool]
    limits: tuple[tuple[float, float], tuple[float, float]]
    ticks: tuple[dict[float, str], dict[float, str]]
    row: int
    height: float
    shared: int
    traces: list[Trace] = field(default_factory=list)
    cells: Cells | None = None


_CELLS: WeakKeyDictionary[Axes, Cells] = WeakKeyDictionary()


def attach(axes: Axes, cells: Cells) -> None:
    """Attach the cells that the image in ``axes`` shows."""
    _CELLS[axes] = cells


def plain(text: str) -> str:
    """Remove the mathematical mark-up from a text of matplotlib."""
    for command, symbol in SYMBOLS.items():
        text = text.replace(command, symbol)
    return re.sub(r"[${}\\]", "", text).replace("\n", " ").strip()


# -------------------------------------------------------------------------------------------- from the figure


def panels(figure: Figure) -> list[Panel]:
    """Panels of a drawn figure that hold numbers, in the order of its axes."""
    shown = [a for a in figure.axes if a.axison and a.get_visible()]
    boxes = [a.get_window_extent() for a in shown]
    rows = sorted({round(b.y1) for b in boxes}, reverse=True)
    over = plain(figure.get_supxlabel()), plain(figure.get_supylabel())
    shared: list[Axes] = []
    with_numbers = []
    for axes, box in zip(shown, boxes, strict=True):
        first = axes.get_shared_x_axes().get_siblings(axes)[0]
        if first not in shared:
            shared.append(first)
        traces, cells = _traces(axes), _CELLS.get(axes)
        if not traces and cells is None:
            continue
        with_numbers.append(
            Panel(
                plain(axes.get_title()),
                (plain(_label(axes)) or over[0], plain(axes.get_ylabel()) or over[1]),
                (axes.get_xscale() == "log", axes.get_yscale() == "log"),
                (axes.get_xlim(), axes.get_ylim()),
                (_ticks(axes.xaxis), _ticks(axes.yaxis)),
                rows.index(round(box.y1)),
                float(box.height / figure.bbox.height),
                shared.index(first),
                traces,
                cells,
            )
        )
    return with_numbers


def _label(axes: Axes) -> str:
    """Label of the horizontal axis, otherwise of an axis that shares it."""
    labels = (a.get_xlabel() for a in axes.get_shared_x_axes().get_siblings(axes))
    return axes.get_xlabel() or next((label for label in labels if label), "")


def _ticks(axis: Axis) -> dict[float, str]:
    """Ticks with names; empty for a numeric axis."""
    formatter = axis.get_major_formatter()
    if not isinstance(formatter, (FixedFormatter, FuncFormatter)):
        return {}
    places = np.asarray(axis.get_majorticklocs(), float).tolist()
    return {p: plain(t) for p, t in zip(places, formatter.format_ticks(places), strict=True)}


def _traces(axes: Axes) -> list[Trace]:
    """Traces of the axes, in the order of drawing."""
    named = {c.lines[0]: c.get_label() for c in axes.containers if isinstance(c, ErrorbarContainer)}
    traces = [
        s for line in axes.lines if (s := _of_line(line, axes, named.get(line, line.get_label()))) is not None
    ]
    for collection in axes.collections:
        look = {"colour": _colour(collection.get_edgecolor()), "alpha": collection.get_alpha()}
        if isinstance(collection, LineCollection):
            ends = [np.asarray(s, float) for s in collection.get_segments()]
            if ends:
                x, y = (np.concatenate([np.r_[s[:, i], np.nan] for s in ends]) for i in (0, 1))
                traces.append(Trace("line", _name(collection.get_label()), x, y, look | {"width": 1.0}))
        elif isinstance(collection, PolyCollection):
            look["colour"] = _colour(collection.get_facecolor())
            for path in collection.get_paths():
                x, y = np.asarray(path.vertices, float).T
                traces.append(Trace("area", _name(collection.get_label()), x, y, look))
    for bars in axes.containers:
        if isinstance(bars, BarContainer):
            x, y, width = (
                np.array([getattr(p, f"get_{quantity}")() for p in bars.patches], float)
                for quantity in ("x", "height", "width")
            )
            look = {"colour": _colour(bars.patches[0].get_facecolor()), "widths": width.tolist()}
            traces.append(Trace("bar", _name(bars.get_label()), x + width / 2, y, look))
    return traces


def _of_line(line: Line2D, axes: Axes, label: object) -> Trace | None:
    """Trace of a line with ``label``; None if its position does not come from data."""
    in_x, in_y = line.get_transform().contains_branch_seperately(axes.transData)
    x, y = (np.asarray(v, float).ravel() for v in line.get_data(orig=False))
    if not (in_x or in_y) or not len(x):
        return None
    kind = "line" if in_x and in_y else "level" if in_y else "instant"
    marker = str(line.get_marker())
    drawn = line.get_linestyle() not in ("None", "none", " ", "")
    look = {
        "colour": _colour(line.get_color()),
        "dash": line.get_linestyle() if drawn else None,
        "width": line.get_linewidth(),
        "marker": None if marker in ("None", "none", " ", "") else marker,
        "size": line.get_markersize(),
        "hollow": line.get_markerfacecolor() == "none",
        "alpha": line.get_alpha(),
    }
    return Trace(kind, _name(label), x, y, look)


def _name(label: object) -> str:
    """Label as text; empty if matplotlib made the label itself."""
    return "" if str(label).startswith("_") else plain(str(label))


def _colour(colour: Any) -> str:
    """Hexadecimal colour; the first one if there are several."""
    rgba = np.atleast_2d(colour)[0] if not isinstance(colour, str) else colour
    return to_hex(tuple(rgba) if not isinstance(rgba, str) else rgba)


# ------------------------------------------------------------------------------------------ to page and table


def to_csv(panels: list[Panel]) -> str:
    """Make a table with one row per point or frame. A frame has start and end [s], bin and margin."""
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(["panel", "series", "x_label", "y_label", "x", "y", "x_end", "value", "reason"])
    for number, p in enumerate(panels, start=1):
        head = [p.title or str(number)]
        for s in p.traces:
            for x, y in zip(s.x, s.y, strict=True):
                if np.isfinite(x) and np.isfinite(y):
                    table.writerow([*head, s.label, *p.labels, f"{x:.9g}", f"{y:.9g}", "", "", ""])
        if p.cells is not None:
            c = p.cells
            for k, end, m, r in zip(c.bin, c.end, c.margin, c.reason, strict=True):
                times = [f"{c.Ts * n:.9g}" for n in (end - c.lengths[k], end)]
                cell = [times[0], p.ticks[1].get(float(k), str(k)), times[1], f"{m:.9g}", c.reasons[r]]
                table.writerow([*head, "margin of a frame", *p.labels, *cell])
    return out.getvalue()


def to_json(panels: list[Panel]) -> str:
    """Compact JSON of the panels, for page.js: numbers with five digits, long lines thinned."""
    most = MOST_BESIDE_CELLS if any(p.cells for p in panels) else MOST_POINTS
    objects = []
    for p in panels:
        panel: dict[str, Any] = {
            "title": p.title,
            "labels": p.labels,
            "log": p.log,
            "limits": [_short(limits) for limits in p.limits],
            "ticks": [[[_digits(at), name] for at, name in ticks.items()] for ticks in p.ticks],
            "row": p.row,
            "height": round(p.height, 3),
            "shared": p.shared,
            "series": [_told(t, most) for t in p.traces],
        }
        if p.cells is not None:
            panel["cells"] = _told_cells(p.cells)
        objects.append(panel)
    return json.dumps(objects, ensure_ascii=False, separators=(",", ":")).replace("</", "<\\/")


def _told_cells(cells: Cells) -> dict[str, Any]:
    """Compact cells: frames per bin, run-length coded steps of the ends [samples], reasons as digits."""
    steps: list[int] = []
    for k in range(len(cells.lengths)):
        for step, same in groupby(np.diff(cells.end[cells.bin == k], prepend=0).tolist()):
            steps += [int(step), len(list(same))]
    return {
        "count": np.bincount(cells.bin, minlength=len(cells.lengths)).tolist(),
        "steps": steps,
        "margin": _short(cells.margin, 3),
        "reason": "".join(map(str, cells.reason.tolist())),
        "reasons": cells.reasons,
        "lengths": cells.lengths.tolist(),
        "Ts": cells.Ts,
        "threshold": _digits(cells.threshold),
    }


def _told(trace: Trace, most: int) -> dict[str, Any]:
    x, y = (trace.x, trace.y) if trace.kind != "line" else _thinned(trace.x, trace.y, most)
    look = {k: v for k, v in trace.look.items() if v is not None}
    return {"kind": trace.kind, "label": trace.label, "x": _short(x), "y": _short(y), **look}


def _thinned(x: np.ndarray, y: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Reduce to about ``most`` points: the extremes of each of most / 2 stretches."""
    if len(x) <= most:
        return x, y
    kept = []
    for part in np.array_split(np.arange(len(x)), most // 2):
        values = np.nan_to_num(y[part])
        kept += sorted({int(part[np.argmin(values)]), int(part[np.argmax(values)])})
    return x[kept], y[kept]


def _digits(value: float, digits: int = 5) -> float | None:
    return float(f"{value:.{digits}g}") if np.isfinite(value) else None


def _short(values: Any, digits: int = 5) -> list[float | None]:
    return [_digits(float(v), digits) for v in values]
