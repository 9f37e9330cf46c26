"""What all pictures share: colours, style, and the way from a matplotlib figure to inline SVG.

Ink, rules and paper are CSS variables of the page (--ink, --rule, --paper), so one picture is legible on
light, dark and printed pages. The other colours are Okabe and Ito's: colour-blind readers tell them apart.
Line styles tell them apart as well. Point clouds are rasterised. Frequencies are in rad/s, signals in the
units of the signal table.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Concatenate, Literal, ParamSpec

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

Arguments = ParamSpec("Arguments")

INK, RULE, PAPER = "#010203", "#040506", "#070809"
"""Stand-ins that become CSS variables; no other element may use them."""
BLUE, SKY, GREEN, RED, ORANGE, PINK, POINTS = (
    "#1b84c6",
    "#56b4e9",
    "#009e73",
    "#d55e00",
    "#e69f00",
    "#cc79a7",
    "#8a8f98",
)

STYLE: dict[RcKeyType, object] = {
    "svg.fonttype": "path",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "legend.fontsize": 8.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.edgecolor": INK,
    "axes.titlecolor": INK,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "legend.facecolor": PAPER,
    "legend.edgecolor": RULE,
    "legend.framealpha": 0.85,
    "grid.color": RULE,
    "grid.linewidth": 0.5,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.linewidth": 0.7,
    "lines.linewidth": 1.4,
}


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """An empty figure of this width and height [inch]; ``layout`` None: the caller places the axes."""
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasSVG(figure)
    return figure


def _svg(figure: Figure, name: str) -> str:
    """The figure as inline SVG; ``name`` keeps its ids apart from those of the page's other pictures."""
    stream = io.StringIO()
    metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    style: dict[RcKeyType, object] = {"svg.hashsalt": name, **STYLE}
    with matplotlib.rc_context(style):
        figure.savefig(stream, format="svg", metadata=metadata, dpi=140)
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r' (xmlns(:\w+)?|version)="[^"]*"', "", text)
    text = re.sub(r'( id="|xlink:href="#|url\(#)', rf"\g<1>{name}-", text)
    for stand_in, variable in ((INK, "--ink"), (RULE, "--rule"), (PAPER, "--paper")):
        text = text.replace(stand_in, f"var({variable})")
    return text


def picture(draw: Callable[Arguments, Figure]) -> Callable[Concatenate[str, Arguments], str]:
    """Decorator of a function that draws a figure in the style of the report.

    The decorated function takes a name before its arguments and returns the inline SVG. The name must be its
    own on a page: it keeps the ids of the pictures apart.
    """

    def wrapped(name: str, *arguments: Arguments.args, **named: Arguments.kwargs) -> str:
        with matplotlib.rc_context(STYLE):
            return _svg(draw(*arguments, **named), name)

    wrapped.__doc__ = draw.__doc__
    return wrapped


def legend_above(axes: Axes, columns: int) -> None:
    """Legend above the axes on the left, in this many columns."""
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0, 1.0),
        ncols=columns,
        frameon=False,
        markerscale=1.4,
        handletextpad=0.5,
        columnspacing=1.2,
    )


def standalone(svg: str) -> str:
    """An inline picture as an SVG file of its own, dark on white."""
    for variable, colour in (("--ink", "#1b1e23"), ("--rule", "#c9ced6"), ("--paper", "#ffffff")):
        svg = svg.replace(f"var({variable})", colour)
    return (
        svg.replace(
            "<svg",
            '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
            ' style="background:#ffffff"',
            1,
        )
        + "\n"
    )
