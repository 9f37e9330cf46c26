"""Pictures of detectors: times to find injected faults, and share of found faults over severity."""

import textwrap
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from ...evaluate.comparison import row_name
from ...identify.confirmation import OTHERS, Confirmation
from .drawing import BLUE, GREEN, ORANGE, PINK, POINTS, RED, SKY, new_figure, picture

SOONEST_S = 0.01
"""Least time on the logarithmic axis of `time_to_find`; smaller times are drawn here."""

DETECTOR_STYLES = (
    (BLUE, "-", "o", 2.0),
    (ORANGE, "--", "s", 1.1),
    (GREEN, "-.", "^", 1.1),
    (PINK, ":", "D", 1.1),
    (RED, (0, (5, 1)), "v", 1.1),
    (SKY, (0, (3, 1, 1, 1)), "P", 1.1),
)
OTHER_STYLES = ((POINTS, "-", "", 1.1), (POINTS, ":", "", 1.1))
"""Styles of the energy and the change test beside designs of the frame test."""


@picture
def time_to_find(faults: list[dict], allowed_s: float) -> Figure:
    """Draw the judged, excited time from each fault to the alarm that it caused, one mark per case.

    Parameters
    ----------
    faults : list of dict, rows of an evaluation
    allowed_s : float, s, time in which the alarm must come

    Returns
    -------
    Figure
    """
    figure = new_figure(8.2, 1.0 + 0.32 * len(faults))
    axes = figure.subplots()
    never = 2.0 * allowed_s
    for y, row in enumerate(faults):
        spread = (
            np.linspace(-0.22, 0.22, len(row["cases"]))
            if len(row["cases"]) > 1
            else np.zeros(len(row["cases"]))
        )
        for dy, case in zip(spread, row["cases"], strict=False):
            x = never if case["s"] is None else max(case["s"], SOONEST_S)
            is_found = case["s"] is not None
            axes.plot(x, y + dy, "o" if is_found else "X", ms=4, color=BLUE if is_found else RED)
        axes.text(
            1.01,
            y,
            f"{row['found']} of {row['counted']}",
            transform=axes.get_yaxis_transform(),
            va="center",
            fontsize=8,
        )
    axes.axvline(allowed_s, color=ORANGE, ls="--")
    axes.set_xscale("log")
    axes.set_xlim(0.8 * SOONEST_S, 1.4 * never)
    ticks = [t for t in (SOONEST_S, 0.03, 0.1, 0.3, 1, 3, 10, 30) if t <= allowed_s]
    axes.set_xticks([*ticks, never], [*(f"{t:g}" for t in ticks), "not"])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_yticks(range(len(faults)), [row_name(row) for row in faults])
    axes.invert_yaxis()
    axes.set_xlabel("judged, excited seconds from the fault to the first alarm")
    return figure


@picture
def confirmation_tradeoff(confirmation: Confirmation) -> Figure:
    """Draw the smallest gain error found in time, and the delay of a larger one, over the rate of alarms."""
    figure = new_figure(8.2, 3.2)
    panels = figure.subplots(1, 2, sharex=True)
    labels = ("smallest gain error found in time", f"s until {confirmation.shown:.2g} is found")
    for axes, key, label in zip(panels, ("least_by_rate", "delay_by_rate"), labels, strict=True):
        styles = [*DETECTOR_STYLES[: len(confirmation.rows) - len(OTHERS)], *OTHER_STYLES]
        for row, (colour, line, marker, width) in zip(confirmation.rows, styles, strict=False):
            y = np.array([np.nan if x is None else x for x in row[key]])
            axes.plot(
                confirmation.rates,
                y,
                ls=line,
                marker=marker,
                lw=width,
                ms=4,
                color=colour,
                label=row["label"],
            )
        axes.axvline(confirmation.per_1000_h, color=POINTS, ls="--")
        axes.set_xscale("log")
        axes.set_xlabel("promised alarms in 1000 h")
        axes.set_ylabel(label)
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=len(names))
    return figure


def _over_severity(
    severities: list[dict],
    units: dict[str, str],
    label: str,
    draw: Callable[[Axes, np.ndarray, list[dict]], None],
) -> Figure:
    """Draw one panel per kind of fault with more than one severity.

    ``draw(axes, x, rows)`` fills a panel with ``rows`` in the order of their severities ``x``. ``units``
    holds the unit of severity by kind of fault. ``label`` is the label of the vertical axes.
    """
    kinds = [k for k in units if sum(s["kind"] == k for s in severities) > 1]
    columns = 4
    lines = -(-len(kinds) // columns)
    figure = new_figure(9.6, 1.75 * lines + 0.5)
    panels = figure.subplots(lines, columns, sharey=True, squeeze=False).ravel()
    for axes in panels[len(kinds) :]:
        axes.set_axis_off()
    for index, (axes, kind) in enumerate(zip(panels, kinds, strict=False)):
        rows = sorted((s for s in severities if s["kind"] == kind), key=lambda s: s["severity"])
        x = np.array([s["severity"] for s in rows])
        draw(axes, x, rows)
        if index % columns == 0:
            axes.set_ylabel(label)
        axes.set_title(textwrap.fill(kind, 26))
        axes.set_xlabel(units[kind])
        low, high = x[0], x[-1]
        if len(x) > 2 and low > 0 and high / low > 15:
            axes.set_xscale("log")
            axes.set_xticks(x, [f"{v:g}" for v in x])
            axes.xaxis.set_minor_locator(NullLocator())
            axes.set_xlim(low * (low / high) ** 0.05, high * (high / low) ** 0.05)
        else:
            axes.set_xlim(low - 0.05 * (high - low), high + 0.05 * (high - low))
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


def _lines(axes: Axes, x: np.ndarray, names: dict[str, str], numbers: Callable[[str], list[float]]) -> None:
    """Draw the ``numbers`` of each detector over ``x`` (N,), in its style."""
    for detector, (colour, line, mark, width) in zip(names, DETECTOR_STYLES, strict=False):
        axes.plot(
            x, numbers(detector), line, marker=mark, ms=3.2, lw=width, color=colour, label=names[detector]
        )


@picture
def detection(severities: list[dict], units: dict[str, str], names: dict[str, str], key: str) -> Figure:
    """Draw the share of runs in which a fault was found in time over its severity.

    There is one panel per kind of fault and one line per detector.

    ``severities`` are rows of a campaign's summary, and ``key`` is "found" or "matched". ``names`` maps
    detectors to titles, the monitor first.
    """

    def draw(axes: Axes, x: np.ndarray, rows: list[dict]) -> None:
        _lines(axes, x, names, lambda detector: [s[key][detector] / s["runs"] for s in rows])
        axes.fill_between(
            x,
            0,
            [s["visible_runs"] / s["runs"] for s in rows],
            color=POINTS,
            alpha=0.25,
            lw=0,
            label="visible runs",
        )
        axes.set_ylim(-0.05, 1.05)

    return _over_severity(severities, units, "found", draw)


@picture
def detection_time(severities: list[dict], units: dict[str, str], names: dict[str, str]) -> Figure:
    """Draw the median judged, excited time [s] from a fault to the first alarm over its severity.

    A point is missing if fewer than half of the runs alarmed. The arguments are the same as for
    ``detection``.
    """

    def draw(axes: Axes, x: np.ndarray, rows: list[dict]) -> None:
        _lines(
            axes, x, names, lambda d: [np.nan if s["median_s"][d] is None else s["median_s"][d] for s in rows]
        )
        axes.set_yscale("log")
        axes.set_ylim(0.05, 200.0)

    return _over_severity(severities, units, "median, s", draw)
