"""HTML helpers of the page's sections."""

from collections.abc import Iterable
from html import escape

import numpy as np

from ..vehicle.project import Signal
from .pictures.drawing import Picture
from .pictures.numbers import to_json


def html_table(head: Iterable[str], rows: Iterable[Iterable[str]], kind: str = "") -> str:
    """Make an HTML table; ``head`` (may be empty) and cells are HTML, ``kind`` is the CSS class."""
    top = "".join(f"<th>{h}</th>" for h in head)
    top = f"<thead><tr>{top}</tr></thead>" if top else ""
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>\n" for row in rows)
    return f'<div class="scroll"><table class="{kind}">{top}<tbody>\n{body}</tbody></table></div>'


def html_rows(rows: Iterable[dict[str, str]]) -> str:
    """HTML table with the keys of its rows as head; all texts are HTML."""
    every = list(rows)
    return html_table(every[0] if every else (), (row.values() for row in every))


def captioned(picture: Picture | None, caption: str) -> str:
    """A picture, if any, with its caption in HTML and its numbers, which page.js uses for zooming."""
    below = f"<figcaption>{caption}</figcaption>" if caption else ""
    if picture is None:
        return f"<figure>{below}</figure>"
    numbers = f'<script type="application/json">{to_json(picture.panels)}</script>' if picture.panels else ""
    return f'<figure id="picture-{picture.name}">{picture.svg}{numbers}{below}</figure>'


def number(value: float | np.floating | None, digits: int = 3) -> str:
    """Format a number with this many significant digits; a dash for None or a value that is not finite."""
    return "–" if value is None or not np.isfinite(value) else f"{value:.{digits}g}"


def yes_or_no(value: bool | None, yes: str, no: str) -> str:
    """Choose the HTML text for yes or for no, with its colour; a dash for None."""
    if value is None:
        return "–"
    return f'<span class="yes">{yes}</span>' if value else f'<span class="no">{no}</span>'


def premise_words(premise: dict) -> str:
    """Describe the premise of certificates from controller.json: evidence and conclusion."""
    refuting, doubting = premise["refuting"], premise["doubting"]
    not_refuted = refuting is None or refuting["ratio"] >= 1
    words = yes_or_no(not_refuted, "Premise, not refuted:", "Premise, refuted:")
    doubt = ""
    if doubting["ratio"] < 1:
        doubt = (
            f" Room for doubt: W<sub>Δ</sub> is {number(doubting['W_delta'])} beside |δ<sub>c</sub>| + k se "
            f"= {number(doubting['delta'])} + {number(doubting['spread'])} of "
            f"{escape(doubting['output'])} at {number(doubting['omega'])} rad/s and "
            f"{number(doubting['v'])} m/s."
        )
    return f"{words} {escape(premise['sentence'])}.{doubt}"


def unit_of_norm(outputs: Iterable[Signal]) -> str:
    """Unit of a Euclidean norm over the outputs, as text."""
    units = list(dict.fromkeys(s.unit for s in outputs))
    return units[0] if len(units) == 1 else "mixed (" + ", ".join(units) + ")"
