"""Section "Trade-off between uncertainty, disturbance and performance" of the controller design."""

from html import escape
from pathlib import Path

from ...base import artefacts
from ..markup import captioned, html_rows, number
from ..pictures.design import tradeoff_front


def tradeoff_section(folder: Path) -> str:
    """Return the section of a folder that `lpvguard design --tradeoff` wrote."""
    tradeoff = artefacts.read_json(folder / "tradeoff.json")
    rows = html_rows(
        {
            "structure": escape(r["structure"]),
            "ceiling": r["ceiling"],
            "ν̄ at the lowest bin": number(r["nu_low"]),
            "at the highest": number(r["nu_high"]),
            "λ<sub>s</sub>, s²": number(r["lambda_s"]),
            "worst μ": number(r["mu_worst"], 4),
            "no controller below": number(r["floor"], 4),
            "largest γ<sub>w</sub>": number(r["gamma_w_max"]),
        }
        for r in tradeoff["rows"]
    )
    front = captioned(
        tradeoff_front("t", tradeoff),
        "Left: the optimum over speeds for uniform ceilings on ν, and the lower bound for every controller. "
        "Right: ceiling, uncertainty and disturbance bound of the best candidate and of the project's "
        f"setting. Bounds from the {escape(tradeoff['frames'])}. “–”: the lower bound alone excluded the "
        "candidate.",
    )
    return f"""<h2>Trade-off between uncertainty, disturbance and performance</h2>
<p>{escape(tradeoff["sentence"])}</p>{front}{rows}"""
