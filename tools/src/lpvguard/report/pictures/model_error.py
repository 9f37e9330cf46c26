"""Picture of the model error model beside W_delta.

Estimates come from the drives that set the bounds and from those that judge them. Frequencies are in rad/s.
"""

from collections.abc import Sequence
from itertools import pairwise
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ...identify.model_error import ErrorEstimate, ModelError
from .drawing import BLUE, GREEN, INK, ORANGE, PINK, POINTS, RED, SKY, new_figure, picture

CLASS_COLOURS = (BLUE, ORANGE, GREEN, PINK, SKY)
"""Colours of the amplitude classes, smallest first; they repeat after the last."""
APART = 0.022
"""Relative distance between the classes at one frequency, so that no bar hides another."""
LEAST = 1e-2
"""Lower end of the axis; smaller errors are drawn at this end."""
REASON_WIDTH = 26


@picture
def model_error(
    error: ModelError,
    omega: np.ndarray,
    W_delta: np.ndarray,
    last: Sequence[float | None],
    beyond: np.ndarray,
    reasons: Sequence[str],
    names: Sequence[str],
) -> Figure:
    """Draw |delta_c| over frequency, one panel per output, with W_delta and the assumption beyond the data.

    ``W_delta`` (N, n_y) at ``omega`` (N,) [rad/s] includes inflation. ``last`` holds each output's last
    informative frequency [rad/s], or None. ``beyond`` (G, n_y) is 1 + rho at the grid's frequencies.
    ``reasons`` and ``names`` have one text per output.
    """
    figure = new_figure(8.2, 0.6 + 3.3 * len(names))
    panels = np.atleast_1d(figure.subplots(len(names), 1, sharex=True))
    grid = error.grid.omega
    for j, axes in enumerate(panels):
        _estimates(axes, error.setting, grid, j, "o", "above")
        if error.judging is not None:
            _estimates(axes, error.judging, grid, j, "x", "both")
        axes.plot(omega, W_delta[:, j], "-", lw=1.8, color=RED, label=r"$|W_\Delta|$")
        top = 4 * max(W_delta[:, j].max(), beyond[:, j].max())
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(LEAST, top)
        axes.set_xlim(grid[0] / 1.2, grid[-1] * 1.2)
        axes.set_ylabel(rf"{names[j].replace('_', ' ')}: $|\delta|$, –")
        _assumed(axes, grid, beyond[:, j], last[j], reasons[j])
    panels[-1].set_xlabel("frequency, rad/s")
    _legend(figure, error)
    return figure


def _estimates(axes: Axes, estimate: ErrorEstimate, grid: np.ndarray, j: int, marker: str, bars: str) -> None:
    """Draw |delta_c| of output j in every cell with bars of k se, upwards or (``bars`` "both") both ways.

    Uninformative estimates, k se >= 1, are pale.
    """
    classes = estimate.se.shape[-1]
    for a in range(classes):
        x = np.repeat(grid * (1 + APART * (a - (classes - 1) / 2)), estimate.se.shape[2])
        size = np.abs(estimate.delta[:, j, :, a]).ravel()
        upper, lower = (b[:, j, :, a].ravel() for b in (estimate.upper, estimate.lower))
        tells = upper - size < 1
        for chosen, alpha in ((tells, 0.8), (~tells & np.isfinite(size), 0.18)):
            y = np.maximum(size[chosen], LEAST)
            down = y - np.maximum(lower[chosen], LEAST) if bars == "both" else np.zeros(len(y))
            axes.errorbar(
                x[chosen],
                y,
                yerr=[np.maximum(down, 0.0), np.maximum(upper[chosen] - y, 0.0)],
                fmt=marker,
                ms=3.0 if marker == "o" else 4.0,
                mew=0.9,
                lw=0.7,
                color=CLASS_COLOURS[a % len(CLASS_COLOURS)],
                alpha=alpha,
                label=("setting the bounds" if marker == "o" else "judging")
                + (f", amplitude class {a + 1}" if classes > 1 else "")
                + ("" if alpha > 0.5 else ", cannot tell"),
            )


def _assumed(axes: Axes, grid: np.ndarray, beyond: np.ndarray, last: float | None, reason: str) -> None:
    """Shade the range beyond the ``last`` informative frequency, with 1 + rho and the ``reason``."""
    start = grid[0] if last is None else last
    if last is not None:
        axes.axvline(last, ls=":", lw=1.0, color=INK)
    if start >= grid[-1]:
        return
    after = grid > start if last is not None else grid >= start
    axes.axvspan(start, grid[-1] * 1.2, color=POINTS, alpha=0.15, lw=0)
    axes.plot(grid[after], beyond[after], "--", lw=1.2, color=INK, label=r"assumed: $1 + \rho$")
    axes.text(
        np.sqrt(start * grid[-1]),
        1.5 * LEAST,
        fill(f"assumed: {reason}", REASON_WIDTH),
        ha="center",
        va="bottom",
        fontsize=7,
    )


def _legend(figure: Figure, error: ModelError) -> None:
    """Draw the legend: markers for drives, colours for classes, and the lines."""
    edges = [0.0, *error.grid.amplitude_edges.tolist(), np.inf]
    entries = [
        Line2D([], [], color=POINTS, marker="o", ms=4, ls="-", label="setting the bounds, + k se"),
        *(
            [Line2D([], [], color=POINTS, marker="x", ms=5, ls="-", label="judging, ± k se")]
            if error.judging is not None
            else []
        ),
        Line2D([], [], color=RED, lw=1.8, label=r"$|W_\Delta|$"),
        Line2D([], [], color=INK, ls="--", lw=1.2, label=r"assumed: $1 + \rho$"),
        Line2D([], [], color=INK, ls=":", lw=1.0, label="last informative frequency"),
    ]
    if len(edges) > 2:
        for a, (low, high) in enumerate(pairwise(edges)):
            text = f"amplitude above {low:g}" if np.isinf(high) else f"amplitude {low:g} to {high:g}"
            colour = CLASS_COLOURS[a % len(CLASS_COLOURS)]
            entries.append(Line2D([], [], color=colour, marker="s", ls="", ms=5, label=text))
    figure.legend(handles=entries, loc="outside upper left", ncols=3, frameon=False)
