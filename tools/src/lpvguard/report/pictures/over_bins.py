"""Pictures over the frequency bins: Figs. 2 and 3 of the paper, Pareto fronts and excitation.

Frequencies are in rad/s. DC is drawn to the left of the lowest bin.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullFormatter

from ...identify.weights import FittedWeight
from ...vehicle.project import Signal
from .drawing import BLUE, GREEN, INK, ORANGE, PINK, POINTS, RED, SKY, legend_above, new_figure, picture

MOST_BIN_LABELS = 6
POINTS_PER_BIN = 400
"""Largest number of points in a bin: the largest points are kept, and every n-th of the others by size."""
DELTA_COLOURS = ((RED, BLUE), (ORANGE, SKY), (PINK, GREEN), (POINTS, INK))
"""Colours of a bound and its weight, one pair per Delta."""
FRONT_COLUMNS = 5
MOST_FRONTS = 30
"""Largest number of panels of the Pareto picture; with more bins, only every n-th bin is drawn."""


@dataclass(frozen=True)
class Clouds:
    """Points of the frames in each bin: |E| (F,), B1 (F,) from (9), nu (F, n_delta) and |w| (F, n_y)."""

    E: list[np.ndarray]
    B1: list[np.ndarray]
    nu: list[np.ndarray]
    w: list[np.ndarray]


def _thin(values: np.ndarray) -> np.ndarray:
    """Reduce ``values`` (F,) to about POINTS_PER_BIN, including the largest."""
    if len(values) <= POINTS_PER_BIN:
        return values
    ordered = np.sort(values)[::-1]
    kept = POINTS_PER_BIN // 4
    return np.concatenate([ordered[:kept], ordered[kept :: -(-len(ordered) // (POINTS_PER_BIN - kept))]])


def _cloud(axes: Axes, grid: np.ndarray, values: list[np.ndarray], colour: str, label: str) -> None:
    """Draw the points of each bin from ``values``, one (F,) per bin; DC (bin 0) has stars.

    Zeros are left out, because the axis is logarithmic.
    """
    shown = [_thin(v[v > 0]) for v in values]
    x = np.concatenate([np.full(len(v), w) for v, w in zip(shown[1:], grid[1:], strict=False)])
    if not len(x):
        return
    axes.plot(
        x,
        np.concatenate(shown[1:]),
        ".",
        ms=3.5,
        color=colour,
        alpha=0.6,
        mec="none",
        rasterized=True,
        label=label,
    )
    axes.plot(
        np.full(len(shown[0]), grid[0]),
        shown[0],
        "*",
        ms=6,
        color=colour,
        alpha=0.7,
        mec="none",
        rasterized=True,
    )


def _bound(axes: Axes, grid: np.ndarray, values: np.ndarray, style: str, label: str, **look: Any) -> None:
    """Draw a bound (K,) over the bins, with a star at DC, because no data lie between DC and the next bin.

    ``look``: further arguments of matplotlib's ``Axes.plot``.
    """
    drawn = np.where(values > 0, values, np.nan)
    (line,) = axes.plot(grid[1:], drawn[1:], style, label=label, **look)
    axes.plot(grid[:1], drawn[:1], "*", ms=9, color=line.get_color(), mfc=look.get("mfc", line.get_color()))


def _bins(axes: Axes, grid: np.ndarray, without: np.ndarray, *, label: bool = True) -> None:
    """Set a logarithmic frequency axis with labels at some bins and DC at ``grid[0]``.

    ``without`` (K,) marks bins without a counted frame; they are hatched.
    """
    step = -(-len(grid) // MOST_BIN_LABELS)
    named = grid[1::step]
    axes.set_xscale("log")
    axes.set_xlim(grid[0] / 1.5, grid[-1] * 1.5)
    axes.set_xticks([grid[0], *named], ["DC", *(f"{w:.3g}" for w in named)])
    axes.xaxis.set_minor_locator(FixedLocator(grid[1:].tolist()))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.axvspan(grid[0] * 1.6, grid[1] / 1.2, color=POINTS, alpha=0.12, lw=0)
    for w in grid[without]:
        axes.axvspan(w / 1.12, w * 1.12, facecolor="none", edgecolor=POINTS, hatch="////", lw=0)
        axes.text(
            w,
            0.5,
            "no information",
            rotation=90,
            ha="center",
            va="center",
            fontsize=7,
            transform=axes.get_xaxis_transform(),
        )
    if label:
        axes.set_xlabel("frequency of the bin, rad/s")


@picture
def disturbance_design(
    grid: np.ndarray,
    clouds: Clouds,
    bounds: dict[str, np.ndarray],
    gamma_fine: np.ndarray,
    fine: np.ndarray,
    unit: str,
) -> Figure:
    """Draw Fig. 2: the disturbance bound and its parts, and the upper limit on the uncertainty below.

    Points are |E| and B1 of frames. Lines are B1, B2 and gamma_w, by the rule and smoothed. ``bounds`` holds
    arrays of bounds.json; ``gamma_fine`` (N,) is the smoothed gamma_w at ``fine`` (N,) [rad/s].
    """
    figure = new_figure(8.2, 5.6)
    top, low = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1.1])
    without = ~(bounds["frames"] > 0)
    _cloud(top, grid, clouds.E, POINTS, "$|E|$ of a frame")
    _cloud(top, grid, clouds.B1, GREEN, "right side of (9)")
    _bound(top, grid, bounds["B2"], "--s", "$B_2$, all starts", ms=4, color=RED)
    if np.nanmax(bounds["B1"]) > 0:
        _bound(top, grid, bounds["B1"], ":^", "$B_1$, all starts", ms=4, color=GREEN)
    _bound(
        top,
        grid,
        bounds["gamma_rule"],
        "o",
        r"$\gamma_w$ asked for by the rule",
        ms=5,
        mfc="none",
        color=BLUE,
    )
    top.plot(fine, gamma_fine, "-", color=BLUE, label=r"$\gamma_w$ smoothed")
    top.set_yscale("log")
    top.set_ylabel(f"Euclidean norm, {unit}")
    top.set_ylim(bottom=min(_decent_bottom(c, bounds["B2"]) for c in (clouds.E, clouds.B1)))
    _bins(top, grid, without, label=False)
    legend_above(top, 3)
    low.plot(grid[1:], bounds["nu_ceiling"][1:], "-o", ms=3.5, color=PINK, label=r"ceiling $\bar\nu(\omega)$")
    for d, nu in enumerate(bounds["nu"].T):
        low.plot(grid[1:], nu[1:], "v^<>"[d], ms=4, color=INK, label="_" * min(d, 1) + r"$\nu$ needed")
    low.set_ylim(0, 1.15 * max(np.nanmax(bounds["nu_ceiling"]), np.nanmax(bounds["nu"])))
    low.set_ylabel(r"$|\delta|$, –")
    low.legend(loc="upper left", bbox_to_anchor=(0.12, 1.0))
    _bins(low, grid, without)
    return figure


def _decent_bottom(clouds: list[np.ndarray], bound: np.ndarray) -> float:
    """Lower end of a logarithmic axis: the 1 % quantile of the points above a thousandth of the bound.

    Otherwise a few points near zero would compress all others.
    """
    values, largest = np.concatenate(clouds), float(np.nanmax(bound))
    values = values[values > 1e-3 * largest]
    return float(np.quantile(values, 0.01)) if len(values) else 0.05 * largest


@picture
def weights_over_bounds(
    grid: np.ndarray,
    clouds: Clouds,
    bounds: dict[str, np.ndarray],
    W_w: np.ndarray,
    W_n: np.ndarray | None,
    fine: np.ndarray,
    uncertainty: Sequence[FittedWeight],
    inflation: float,
    outputs: Sequence[Signal],
) -> Figure:
    """Draw Fig. 3: left |w_j|, the bound B_w and the weights of each output; right nu and W_delta.

    ``W_w`` (N, n_y) and ``W_n`` (N, n_y), or None where there is no noise weight, are magnitudes at ``fine``
    (N,) [rad/s]. ``uncertainty``: W_delta and the samples that it must exceed, one pair per Delta. W_delta is
    drawn times ``inflation``.
    """
    figure = new_figure(8.2, 3.6 if len(outputs) == 1 else 2.9 * len(outputs))
    left, beside = figure.subfigures(1, 2, width_ratios=[1, 1], squeeze=False).flat
    without = ~(bounds["frames"] > 0)
    for j, axes in enumerate(np.atleast_1d(left.subplots(len(outputs), 1))):
        points = [w[:, j] for w in clouds.w]
        _cloud(axes, grid, points, POINTS, "$|w|$ of a frame")
        _bound(axes, grid, bounds["B_w"][:, j], "--s", "$B_w$, all starts", ms=4, color=RED)
        axes.plot(fine, W_w[:, j], "-", color=BLUE, label="$|W_w|$")
        if W_n is not None:
            axes.plot(fine, W_n[:, j], "-.", color=GREEN, label="$|W_n|$")
        axes.set_yscale("log")
        bottom = _decent_bottom(points, bounds["B_w"][:, j])
        axes.set_ylim(bottom=bottom if W_n is None else min(bottom, 0.7 * W_n[:, j].min()))
        axes.set_ylabel(f"{outputs[j].name.replace('_', ' ')}, {outputs[j].unit}")
        _bins(axes, grid, without, label=j == len(outputs) - 1)
    legend_above(left.axes[0], 3)
    right = beside.subplots()
    points = [nu.ravel() for nu in clouds.nu]
    _cloud(right, grid, points, POINTS, r"$\nu$ of a frame")
    required = np.concatenate([w.bound for w in uncertainty])
    top, last = np.nanmax(required), max(grid[-1], *(w.omega[-1] for w in uncertainty))
    wide = np.geomspace(grid[0], last, 400)
    for d, (weight, (of_bound, of_weight)) in enumerate(zip(uncertainty, DELTA_COLOURS, strict=False)):
        name = f", {outputs[d].name.replace('_', ' ')}" if len(uncertainty) > 1 else ""
        size = inflation * weight.magnitude(wide)
        right.plot(weight.omega, weight.bound, "--s", ms=3, color=of_bound, label=f"asked for{name}")
        right.plot(wide, size, "-", color=of_weight, label=rf"$|W_\Delta|${name}")
        top = max(top, size.max())
    right.set_yscale("log")
    right.set_ylim(_decent_bottom(points, required), 2 * top)
    right.set_ylabel(r"uncertainty size $|\delta|$, –")
    legend_above(right, 3 if len(uncertainty) == 1 else 1)
    _bins(right, grid, without)
    if last > grid[-1]:
        decades = 10.0 ** np.arange(np.ceil(np.log10(grid[1])), np.log10(last))
        right.set_xticks([grid[0], *decades], ["DC", *(f"{w:g}" for w in decades)])
        right.xaxis.set_minor_locator(FixedLocator(uncertainty[0].omega[1:].tolist()))
        right.set_xlim(right=1.5 * last)
        right.set_xlabel("frequency, rad/s")
    return figure


@picture
def sets_side_by_side(
    omega: np.ndarray, sets: dict[str, dict[str, np.ndarray]], outputs: Sequence[Signal]
) -> Figure:
    """Draw the bounds of two identifications: left |W_delta|, right B_w of each output.

    Parameters
    ----------
    omega : ndarray (K,), rad/s
    sets : dict, W_delta (2, K, n_delta) and B_w (2, K, n_y) by name of the set, before and after
    outputs : Sequence of Signal

    Returns
    -------
    Figure
    """
    figure = new_figure(8.2, 3.2 if len(outputs) == 1 else 2.6 * len(outputs))
    grid = np.where(omega > 0, omega, omega[omega > 0].min() / 2)
    names = [s.name.replace("_", " ") for s in outputs]
    n_delta = next(iter(sets.values()))["W_delta"].shape[2]
    labels = {
        "W_delta": [rf"$|W_\Delta|$, {name}" for name in names] if n_delta > 1 else [r"$|W_\Delta|$"],
        "B_w": [f"$B_w$, {name}, {s.unit}" for name, s in zip(names, outputs, strict=True)],
    }
    looks: dict[str, dict[str, Any]] = {"before": {"color": POINTS, "lw": 3.0}, "after": {"color": BLUE}}
    for column, (bound, of_rows) in zip(
        figure.subfigures(1, 2, squeeze=False).flat, labels.items(), strict=True
    ):
        panels = column.subplots(len(of_rows), squeeze=False)[:, 0]
        for j, axes in enumerate(panels):
            for (name, bounds), style in zip(sets.items(), ("-o", "--s"), strict=True):
                for (when, look), values in zip(looks.items(), bounds[bound], strict=True):
                    _bound(axes, grid, values[:, j], style, f"{name}, {when}", ms=3, **look)
            axes.set_yscale("log")
            axes.set_ylabel(of_rows[j])
            _bins(axes, grid, np.zeros(len(grid), bool), label=axes is panels[-1])
        legend_above(panels[0], 2)
    return figure


@picture
def pareto(
    omega: np.ndarray,
    gamma_w: np.ndarray,
    nu: np.ndarray,
    taken: dict[str, np.ndarray],
    ceiling: np.ndarray,
    unit: str,
) -> Figure:
    """Draw the Pareto fronts nu(gamma_w) (K, P), one panel per bin.

    ``taken`` is the chosen point, gamma_w (K,) and nu (K, n_delta); ``ceiling`` (K,) is the upper limit on
    nu.
    """
    known = np.flatnonzero(np.isfinite(nu).any(axis=1))
    shown = known[:: -(-len(known) // MOST_FRONTS)]
    rows = -(-len(shown) // FRONT_COLUMNS)
    figure = new_figure(8.2, 0.5 + 1.5 * rows)
    panels = figure.subplots(rows, FRONT_COLUMNS, squeeze=False).ravel()
    for axes, k in zip(panels, shown, strict=False):
        top = 3 * max(np.max(taken["nu"][k]), ceiling[k])
        axes.plot(gamma_w[k], nu[k], "-", color=BLUE, label=r"front $\nu(\gamma_w)$")
        axes.axhline(ceiling[k], ls="--", lw=0.9, color=PINK, label=r"ceiling $\bar\nu$")
        for d, nu_taken in enumerate(taken["nu"][k]):
            axes.plot(taken["gamma_w"][k], nu_taken, "o", ms=5, color=RED, label="_" * min(d, 1) + "taken")
        axes.set_ylim(-0.04 * top, top)
        axes.set_xlim(left=0)
        axes.set_title(f"{omega[k]:.3g} rad/s", fontsize=8)
        axes.tick_params(labelsize=7)
        axes.xaxis.set_major_locator(MaxNLocator(3))
    for axes in panels[len(shown) :]:
        axes.set_axis_off()
    figure.supxlabel(rf"disturbance bound $\gamma_w$, {unit}", fontsize=9)
    figure.supylabel(r"uncertainty $\nu$, –", fontsize=9)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3, frameon=False)
    return figure


@picture
def excitation(
    grid: np.ndarray,
    frames: np.ndarray,
    size_max: np.ndarray,
    size_median: np.ndarray,
    every_start_max: np.ndarray,
    disturbance: np.ndarray,
    unit: str,
) -> Figure:
    """Draw |Z| per bin with the disturbance bound, and the number of counted frames.

    All arrays are (K,). ``every_start_max`` is the largest |Z| over frames at every start of the
    bound-setting drives. ``unit`` is the unit of |Z| and ``disturbance``.
    """
    figure = new_figure(8.2, 4.0)
    top, low = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    without = ~(frames > 0)
    _bound(top, grid, size_max, "-^", "largest $|Z|$, all drives", ms=4.5, color=BLUE)
    _bound(top, grid, size_median, "-o", "median $|Z|$, all drives", ms=4, color=SKY)
    _bound(
        top, grid, every_start_max, ":v", "largest $|Z|$, bound-setting drives, all starts", ms=4, color=GREEN
    )
    _bound(top, grid, disturbance, "--", r"$\gamma_w$, to compare with", color=RED)
    top.set_yscale("log")
    top.set_ylabel(f"$|Z|$, {unit}")
    legend_above(top, 2)
    _bins(top, grid, without, label=False)
    low.bar(grid, frames, width=0.25 * grid, color=SKY)
    low.set_yscale("log")
    low.set_ylim(0.8, 2.0 * max(1, frames.max()))
    low.set_ylabel("counted frames")
    _bins(low, grid, without)
    return figure
