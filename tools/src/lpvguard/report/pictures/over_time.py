"""Pictures of signals over time: Fig. 4 of the paper, and a run of the closed loop."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...vehicle.project import Signal
from .drawing import BLUE, INK, RED, new_figure, picture


@dataclass(frozen=True)
class Stretch:
    """A piece of a drive.

    Attributes
    ----------
    title : str
    t : ndarray (N,), s after the drive's start
    v : ndarray (N,), m/s
    y, yhat : ndarray (N, n_y), output units
    """

    title: str
    t: np.ndarray
    v: np.ndarray
    y: np.ndarray
    yhat: np.ndarray


@picture
def model_in_time(stretches: list[Stretch], outputs: Sequence[Signal]) -> Figure:
    """Draw Fig. 4: measurement, nominal model and nominal error on each stretch.

    Parameters
    ----------
    stretches : list[Stretch]
    outputs : Sequence[Signal]

    Returns
    -------
    Figure
    """
    rows = 2 * len(outputs)
    figure = new_figure(8.2, 1.2 + 3.2 * len(outputs))
    grid = np.atleast_2d(
        figure.subplots(
            rows,
            len(stretches),
            sharex="col",
            sharey="row",
            squeeze=False,
            height_ratios=[2, 1] * len(outputs),
        )
    )
    for column, s in enumerate(stretches):
        for j, signal in enumerate(outputs):
            above, below = grid[2 * j, column], grid[2 * j + 1, column]
            above.plot(s.t, s.y[:, j], "-", color=INK, lw=1.0, label="measured")
            above.plot(s.t, s.yhat[:, j], "--", color=RED, lw=1.2, label="nominal model")
            below.plot(s.t, s.y[:, j] - s.yhat[:, j], "-", color=BLUE, lw=0.8)
            below.axhline(0.0, color=INK, lw=0.6)
            if column == 0:
                above.set_ylabel(f"{signal.name.replace('_', ' ')}, {signal.unit}")
                below.set_ylabel(f"error, {signal.unit}")
        grid[0, column].set_title(s.title)
        grid[-1, column].set_xlabel("time after the drive's start, s")
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2, frameon=False)
    return figure


def _margins(axes: Axes, counted: np.ndarray, threshold: float) -> None:
    """Draw the margins of the counted frames. Above four thresholds they stand at the upper edge."""
    t, margin = counted["t_end_s"], counted["margin"]
    top = max(1.2 * threshold, min(4.0 * threshold, 1.1 * float(margin.max(initial=0.0))))
    below, beyond = margin <= threshold, margin > top
    above = ~below & ~beyond
    axes.plot(t[below], margin[below], ".", ms=2.5, color=BLUE, label="frame", rasterized=True)
    axes.plot(t[above], margin[above], "v", ms=4, color=RED, label="falsifies")
    if beyond.any():
        edge = np.full(beyond.sum(), 0.96 * top)
        axes.plot(t[beyond], edge, "^", ms=4, color=INK, label="falsifies, above the axis")
    axes.axhline(threshold, color=INK, lw=0.9, ls="--", label="threshold")
    axes.set_ylabel("margin t*, –")
    axes.set_xlabel("time, s")
    axes.set_ylim(0.0, top)


@picture
def closed_loop(
    rows: np.ndarray,
    frames: np.ndarray,
    threshold: float,
    fault_start_s: float | None,
    first_invalid_s: float | None,
) -> Figure:
    """Draw yaw rate and reference, demand, and the margins of the counted frames in a simulated run.

    ``rows`` (N,): telemetry with fields t_s, wanted_radps, yaw_rate_radps, demand_bar. ``frames`` (F,):
    fields t_end_s, reason, margin. ``fault_start_s`` and ``first_invalid_s`` [s] are marked if given. Margins
    above four thresholds are drawn at the upper edge.
    """
    figure = new_figure(8.2, 5.6)
    rate, demand, margin = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
    rate.plot(rows["t_s"], rows["wanted_radps"], "--", color=RED, lw=1.0, label="wanted, filtered command")
    rate.plot(rows["t_s"], rows["yaw_rate_radps"], "-", color=INK, lw=0.8, label="truck")
    rate.set_ylabel("yaw rate, rad/s")
    demand.plot(rows["t_s"], rows["demand_bar"], "-", color=BLUE, lw=0.8)
    demand.set_ylabel("demand, bar")
    _margins(margin, frames[frames["reason"] <= 1], threshold)
    if fault_start_s is not None:
        for axes in (rate, demand, margin):
            axes.axvline(fault_start_s, color=RED, lw=0.9, ls=":")
    if first_invalid_s is not None:
        margin.axvline(first_invalid_s, color=INK, lw=0.9, label="first invalid")
    for axes in (rate, margin):
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, fontsize="small", frameon=False)
    return figure
