"""The pictures of what `lpvguard design` writes: Figs. 5 and 6, and the trade-off, each drawn from the
numbers in its file."""

from __future__ import annotations

import json

import numpy as np

from . import pictures


def draw(figures: dict) -> dict[str, str]:
    """Inline SVG by name of what figures.json holds."""
    out = {}
    if "fig5" in figures:
        f = figures["fig5"]
        signals = [(n, np.array(v), u) for n, v, u in f["signals"]]
        command = None if f["command"] is None else tuple(np.array(x, float) for x in f["command"])
        out["fig5"] = pictures.performance_weights(
            "w5", np.array(f["omega_rad_s"]), signals, [(n, np.array(v)) for n, v in f["objectives"]], command
        )
    if "fig6" in figures:
        out["fig6"] = pictures.worst_case_runs("w6", figures["fig6"])
    return out


def drawn(files: dict[str, str]) -> dict[str, str]:
    """SVG files by name of what figures.json and tradeoff.json among ``files`` (name: text) hold."""
    svg = draw(json.loads(files["figures.json"])) if "figures.json" in files else {}
    if "tradeoff.json" in files:
        svg["tradeoff"] = pictures.tradeoff_front("t", json.loads(files["tradeoff.json"]))
    return {f"{name}.svg": pictures.standalone(text) for name, text in svg.items()}
