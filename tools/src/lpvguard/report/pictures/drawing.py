"""Shared code of all pictures: colours, style, and the conversion of a matplotlib figure to inline SVG.

Ink, rules and paper are CSS variables of the page (--ink, --rule, --paper), so a picture is legible on light,
dark and printed pages. The other colours are the palette of Okabe and Ito for colour-blind readers. Line
styles differ too. Point clouds are stored as bitmaps. Frequencies are in rad/s, signals in the units of the
signal table.
"""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Concatenate, Literal, ParamSpec

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from ...base.errors import InputError
from .numbers import Panel, panels, to_csv

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

Arguments = ParamSpec("Arguments")

INK, RULE, PAPER = "#010203", "#040506", "#070809"
"""Colours that stand for CSS variables; no other element may use them."""
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


_kept: ContextVar[list[Picture]] = ContextVar("kept")


@contextmanager
def kept() -> Iterator[list[Picture]]:
    """Collect every picture drawn within the block, in the order of drawing."""
    token = _kept.set([])
    try:
        yield _kept.get()
    finally:
        _kept.reset(token)


@dataclass(frozen=True)
class Picture:
    """A drawn picture.

    Attributes
    ----------
    name : str, unique on a page
    svg : str, inline SVG
    panels : list of Panel, the numbers that it shows
    """

    name: str
    svg: str
    panels: list[Panel]

    def _repr_svg_(self) -> str:
        """SVG for a notebook."""
        return standalone(self)

    @property
    def csv(self) -> str:
        """The numbers as a table of text; InputError for a picture without numbers."""
        if not self.panels:
            raise InputError(self.name, "", "a picture without numbers", "one with axes")
        return to_csv(self.panels)

    def save(self, path: str | Path) -> None:
        """Write the picture by the suffix: .svg, or .csv for its numbers."""
        suffix = Path(path).suffix.lower()
        if suffix not in (".svg", ".csv"):
            raise InputError(path, "suffix", suffix or "none", ".svg or .csv")
        Path(path).write_text(standalone(self) if suffix == ".svg" else self.csv, encoding="utf-8")


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """Make an empty figure, sizes in inch; with ``layout`` None the caller places the axes."""
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasSVG(figure)
    return figure


def _svg(figure: Figure, name: str) -> str:
    """The figure as inline SVG; ``name`` makes its ids unique on the page."""
    stream = io.StringIO()
    metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    style: dict[RcKeyType, object] = {"svg.hashsalt": name, **STYLE}
    with matplotlib.rc_context(style):
        figure.savefig(stream, format="svg", metadata=metadata, dpi=140)
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r' (xmlns(:\w+)?|version)="[^"]*"', "", text)
    text = _compact(text)
    text = re.sub(r'( id="|xlink:href="#|url\(#)', rf"\g<1>{name}-", text)
    for stand_in, variable in ((INK, "--ink"), (RULE, "--rule"), (PAPER, "--paper")):
        text = text.replace(stand_in, f"var({variable})")
    return text


def _compact(svg: str) -> str:
    """Shorten an SVG: round coordinates to 0.01 point, drop unused ids, comments and line breaks."""

    def rounded(match: re.Match[str]) -> str:
        return re.sub(r"-?\d+\.\d{3,}", lambda n: f"{float(n.group()):.2f}", match.group())

    svg = re.sub(r"<!--.*?-->", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\b(?:d|x|y)="[^"]*"|translate\([^)]*\)', rounded, svg)
    used = set(re.findall(r'(?:xlink:href="|url\()#([^")]+)', svg))
    svg = re.sub(r' id="([^"]*)"', lambda m: m.group() if m.group(1) in used else "", svg)
    svg = re.sub(r">\s+<", "><", re.sub(r"\s+", " ", svg))
    before = ""
    while before != svg:
        before, svg = svg, re.sub(r"<g>((?:<(?:use|path|image) [^>]*/>)*)</g>", r"\1", svg)
    return svg


def shared(page: str) -> str:
    """Return the page with letter outlines and styles of its pictures stated only once."""
    return _share_styles(_share_glyphs(page))


def _share_glyphs(page: str) -> str:
    """Draw every letter of the page's pictures once, at the start of its body."""
    outlines: dict[str, str] = {}

    def taken(match: re.Match[str]) -> str:
        return "" if outlines.setdefault(match.group(2), match.group(3)) == match.group(3) else match.group()

    page = re.sub(rf'<path id="([\w-]+?)-({GLYPH})"([^>]*?)/>', taken, page)
    kept = set(re.findall(rf'<path id="([\w-]+?-{GLYPH})"', page))
    page = re.sub(
        rf'xlink:href="#([\w-]+?)-({GLYPH})"',
        lambda m: m.group() if f"{m.group(1)}-{m.group(2)}" in kept else f'href="#{m.group(2)}"',
        page,
    ).replace("<defs></defs>", "")
    drawn = "".join(f'<path id="{name}"{rest}/>' for name, rest in sorted(outlines.items()))
    letters = f'<svg class="glyphs" aria-hidden="true" width="0" height="0"><defs>{drawn}</defs></svg>'
    return page.replace("<body>", f"<body>{letters}", 1)


def _share_styles(page: str) -> str:
    """Turn each style that the page's pictures repeat into a class of one style sheet in its head."""
    pictures = re.compile(r"<svg.*?</svg>", re.DOTALL)
    style = re.compile(r' style="([^"]*)"')
    page = page.replace(f'<defs><style type="text/css">{EVERYWHERE}</style></defs>', "")
    counted = Counter(style.findall("".join(pictures.findall(page))))
    often = sorted(text for text, times in counted.items() if times >= OFTEN)
    names = {text: f"m{n}" for n, text in enumerate(often)}

    def named(match: re.Match[str]) -> str:
        return f' class="{names[match.group(1)]}"' if match.group(1) in names else match.group()

    sheet = f"svg {EVERYWHERE}" + "".join(f".{name}{{{text}}}" for text, name in names.items())
    page = pictures.sub(lambda m: style.sub(named, m.group()), page)
    return page.replace("</head>", f"<style>{sheet}</style></head>", 1)


EVERYWHERE = "*{stroke-linejoin: round; stroke-linecap: butt}"
"""Style that matplotlib repeats in every element."""
OFTEN = 3
"""Least number of repetitions for which a style gets a name."""
GLYPH = r"DejaVu\w+(?:-\w+)*-[0-9a-f]+"
"""Name that matplotlib gives to a letter's outline: its font and its hexadecimal number."""


def picture(draw: Callable[Arguments, Figure]) -> Callable[Concatenate[str, Arguments], Picture]:
    """Decorate a function that draws a figure, so that it returns a Picture in the report's style.

    The decorated function takes a name before its arguments and returns the picture. The name must be unique
    on a page, because the ids of the picture contain it.
    """

    def wrapped(name: str, *arguments: Arguments.args, **named: Arguments.kwargs) -> Picture:
        with matplotlib.rc_context(STYLE):
            figure = draw(*arguments, **named)
            drawn = Picture(name, _svg(figure, name), panels(figure))
        if (kept := _kept.get(None)) is not None:
            kept.append(drawn)
        return drawn

    wrapped.__doc__ = draw.__doc__
    return wrapped


def legend_above(axes: Axes, columns: int) -> None:
    """Place a legend above the axes on the left, in this many columns."""
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0, 1.0),
        ncols=columns,
        frameon=False,
        markerscale=1.4,
        handletextpad=0.5,
        columnspacing=1.2,
    )


def files(pictures: list[Picture]) -> dict[str, str]:
    """Files by name: every picture as SVG, and its numbers, if any, as CSV."""
    texts = {f"{p.name}.svg": standalone(p) for p in pictures}
    return texts | {f"{p.name}.csv": p.csv for p in pictures if p.panels}


def standalone(picture: Picture) -> str:
    """Write a picture as an independent SVG file, dark on white.

    Parameters
    ----------
    picture : Picture

    Returns
    -------
    str
    """
    svg = picture.svg
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
