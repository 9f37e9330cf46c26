"""Pieces of HTML that the sections of the page share, and the style of the page."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

import numpy as np

from ..vehicle.project import Signal

CSS = """
:root{--ink:#1b1e23;--soft:#565d68;--rule:#c9ced6;--paper:#fff;--card:#f6f7f9;--good:#00694d;--bad:#a63f00}
@media screen and \
(prefers-color-scheme:dark){:root{--ink:#e6e8ec;--soft:#a3abb8;--rule:#474e59;--paper:#14171b;
--card:#1d2127;--good:#4cc9a0;--bad:#ff9a5c}}
*{box-sizing:border-box}
body{margin:0 auto;padding:2rem 1.2rem 4rem;max-width:62rem;background:var(--paper);color:var(--ink);
font:15px/1.5 system-ui,"Segoe UI",Helvetica,Arial,sans-serif}
h1{font-size:1.6rem;line-height:1.2;margin:0 0 .3rem}
h2{font-size:1.2rem;margin:2.6rem 0 .5rem;padding-top:.6rem;border-top:1px solid var(--rule)}
h3{font-size:1rem;margin:1.6rem 0 .2rem}
p{max-width:48rem}.lead,figcaption,.note{color:var(--soft)}
figure{margin:1rem 0;break-inside:avoid}
figure svg{width:100%;height:auto;display:block}
figcaption{font-size:.87rem;max-width:50rem;margin-top:.3rem}
.scroll{overflow-x:auto;margin:.6rem 0}
table{border-collapse:collapse;font-size:.85rem;font-variant-numeric:tabular-nums}
th,td{padding:.22rem .6rem;text-align:right;border-bottom:1px solid var(--rule);vertical-align:top}
th{font-weight:600;text-align:right;background:var(--card)}
td:first-child,th:first-child,.words td{text-align:left}
.facts{display:flex;flex-wrap:wrap;gap:0 1.6rem}.tight th,.tight td{white-space:nowrap}
.tight td:first-child,.tight th:first-child{text-align:right}
.words td:first-child{white-space:nowrap}
.yes{color:var(--good);font-weight:600}.no{color:var(--bad);font-weight:600}
nav{font-size:.87rem}nav a{color:inherit;margin-right:1rem}
@media print{body{max-width:none;padding:0;font-size:10pt}nav{display:none}.scroll{overflow:visible}
section{break-inside:auto}*{-webkit-print-color-adjust:exact;print-color-adjust:exact}}
"""


def html_table(head: Iterable[str], rows: Iterable[Iterable[str]], kind: str = "") -> str:
    """A table; ``head`` (may be empty) and cells are HTML already, ``kind`` is its CSS class."""
    top = "".join(f"<th>{h}</th>" for h in head)
    top = f"<thead><tr>{top}</tr></thead>" if top else ""
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>\n" for row in rows)
    return f'<div class="scroll"><table class="{kind}">{top}<tbody>\n{body}</tbody></table></div>'


def captioned(svg: str, caption: str) -> str:
    """A picture with its caption, both HTML already."""
    return f"<figure>{svg}<figcaption>{caption}</figcaption></figure>"


def number(value: float | np.floating | None, digits: int = 3) -> str:
    """A number with this many significant digits; a dash when there is none or it is not finite."""
    return "–" if value is None or not np.isfinite(value) else f"{value:.{digits}g}"


def yes_or_no(value: bool | None, yes: str, no: str) -> str:
    """One of two texts (HTML already) in the colour that it means; a dash for None."""
    if value is None:
        return "–"
    return f'<span class="yes">{yes}</span>' if value else f'<span class="no">{no}</span>'


def premise_words(found: dict) -> str:
    """The premise of certificates, as controller.json has it, in words: evidence, and what it comes to."""
    refuting, doubting = found["refuting"], found["doubting"]
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
    return f"{words} {escape(found['sentence'])}.{doubt}"


def unit_of_norm(outputs: Iterable[Signal]) -> str:
    """Unit of a Euclidean norm over the outputs, as text."""
    units = list(dict.fromkeys(s.unit for s in outputs))
    return units[0] if len(units) == 1 else "mixed (" + ", ".join(units) + ")"
