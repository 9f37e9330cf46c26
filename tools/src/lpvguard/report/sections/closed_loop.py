"""Section "The closed loop over CAN frames": simulated runs of the compiled ECU code."""

from html import escape
from pathlib import Path

import numpy as np

from ...base import artefacts
from ..markup import captioned, html_rows, number, yes_or_no
from ..pictures.drawing import Picture
from ..pictures.over_time import closed_loop


def drawn_run(folder: Path, name: str, r: dict) -> Picture:
    """Draw a simulated run.

    Parameters
    ----------
    folder : Path, of `lpvguard sim -o`
    name : str, of the picture, unique on a page
    r : dict, a run of results.json

    Returns
    -------
    Picture
    """
    rows, frames = (
        np.genfromtxt(folder / f"{r['scenario']}-{r['seed']}.{kind}.csv", delimiter=",", names=True, ndmin=1)
        for kind in ("telemetry", "frames")
    )
    return closed_loop(
        name, rows, frames, r["threshold"], r["expected"].get("fault_start_s"), r["first_invalid_s"]
    )


def _run(folder: Path, name: str, r: dict) -> str:
    """Picture and caption of the run ``r``."""
    return captioned(
        drawn_run(folder, name, r),
        f"<b>{escape(r['title'])}</b> (seed {r['seed']}). Top: the reference (filtered command) and the "
        "simulated truck's true yaw rate. Middle: the pressure difference that the ECU demands. Bottom: the "
        "margin of every counted frame from the ECU's monitor. Above the dashed line, no complex number "
        "within W<sub>Δ</sub> and no disturbance within B<sub>w</sub>, both times the threshold, explain the "
        "frame in its bin. Dotted: start of the fault. Solid: the first verdict invalid, by any test. Energy "
        "and change test have no frames and are not drawn.",
    )


def loop_section(folder: Path) -> str:
    """Return the section of a folder that `lpvguard sim -o` wrote: results.json and tables of the runs."""
    results = artefacts.read_json(folder / "results.json")
    table = html_rows(
        {
            "scenario": escape(r["scenario"]),
            "controller": r["controller"],
            "seed": str(r["seed"]),
            "expected": escape(r["expected"]["verdict"].replace("_", " ")),
            "verdict at the end": r["verdict_final"].replace("_", " "),
            "first invalid, s": number(r["first_invalid_s"], 4),
            "judged s from the fault to it": number(r["judged_to_invalid_s"]),
            "largest margin": number(r["max_margin"]),
            "tracking error / command, rms": f"{r['tracking_rms'] / r['command_rms']:.1%}"
            if r["command_rms"]
            else "–",
            "frames": str(r["frames"]),
            "as expected": yes_or_no(not r["missed"], "yes", escape("; ".join(r["missed"]))),
        }
        for r in results
    )
    figures = [_run(folder, f"l{index}", r) for index, r in enumerate(results)]
    return f"""<h2>The closed loop over CAN frames</h2>
<p>Simulated truck, its bus encoded and decoded frame by frame, and the compiled ECU loop: model, monitor \
and controller, as they
go on the target. The truck shares no equation with the nominal model.</p>{table}{"".join(figures)}"""
