"""Draw Figs. 5 and 6 and the trade-off from the files of `lpvguard design`."""

import json

import numpy as np

from .pictures.design import performance_weights, tradeoff_front, worst_case_runs
from .pictures.drawing import Picture, standalone


def draw(figures: dict) -> dict[str, Picture]:
    """Pictures of figures.json by name, "fig5" and "fig6"."""
    out = {}
    if "fig5" in figures:
        f = figures["fig5"]
        signals = [(n, np.array(v), u) for n, v, u in f["signals"]]
        command = None
        if f["command"] is not None:
            omega, bound = f["command"]
            command = (np.array(omega, float), np.array(bound, float))
        out["fig5"] = performance_weights(
            "w5", np.array(f["omega_rad_s"]), signals, [(n, np.array(v)) for n, v in f["objectives"]], command
        )
    if "fig6" in figures:
        out["fig6"] = worst_case_runs("w6", figures["fig6"])
    return out


def pictures(files: dict[str, str]) -> dict[str, Picture]:
    """Draw figures.json and tradeoff.json.

    Parameters
    ----------
    files : dict[str, str], text by file name; a missing file has no pictures

    Returns
    -------
    dict[str, Picture], by name
    """
    by_name = draw(json.loads(files["figures.json"])) if "figures.json" in files else {}
    if "tradeoff.json" in files:
        by_name["tradeoff"] = tradeoff_front("t", json.loads(files["tradeoff.json"]))
    return by_name


def drawn(files: dict[str, str]) -> dict[str, str]:
    """Draw figures.json and tradeoff.json as SVG files.

    Parameters
    ----------
    files : dict[str, str], text by file name; a missing file has no pictures

    Returns
    -------
    dict[str, str], SVG by file name
    """
    return {f"{name}.svg": standalone(picture) for name, picture in pictures(files).items()}
