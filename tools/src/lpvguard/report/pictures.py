"""Pictures of the report, as inline SVG whose bytes depend on the data only.

Ink, rules and paper are CSS variables of the page (--ink, --rule, --paper), so one picture is legible on
light, dark and printed pages; the other colours are Okabe and Ito's, told apart by colour-blind readers and
by line style besides. Point clouds are rasterised. Frequencies in rad/s; signals in the units of the signal
table.
"""

from __future__ import annotations

import io
import re
import textwrap
from collections.abc import Callable
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullFormatter, NullLocator

from ..core.compiled import REASONS, VERDICTS
from ..replay.run import Replay

INK, RULE, PAPER = "#010203", "#040506", "#070809"
"""Stand-ins that become CSS variables; no other element may use them."""
BLUE, SKY, GREEN, RED, ORANGE, PINK, POINTS = (
    "#1b84c6",
    "#56b4e9",
    "#009e73",
    "#d55e00",
    "#e69f00",
    "#cc79a7",
    "#8a8f98",
)
REASON_WORDS = dict(
    zip(
        REASONS,
        ("evidence", "too little excitation", "speed moved too much", "speed out of range", "model settling"),
        strict=True,
    )
)
VERDICT_COLOURS = dict(zip(VERDICTS, (POINTS, GREEN, RED, "#b9d3e6", PINK, ORANGE), strict=True))
MOST_BIN_LABELS = 6
POINTS_PER_BIN = 400
"""More points in a bin are thinned: the largest stay, of the others every n-th in order of size."""

STYLE = {
    "svg.fonttype": "path",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "legend.fontsize": 8.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.edgecolor": INK,
    "axes.titlecolor": INK,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "legend.facecolor": PAPER,
    "legend.edgecolor": RULE,
    "legend.framealpha": 0.85,
    "grid.color": RULE,
    "grid.linewidth": 0.5,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.linewidth": 0.7,
    "lines.linewidth": 1.4,
}


@dataclass(frozen=True)
class Clouds:
    """Points per bin, lists over bins of arrays over frames: |E|, B1 (right side of (9)), nu, |w| (F,
    n_y)."""

    E: list[np.ndarray]
    B1: list[np.ndarray]
    nu: list[np.ndarray]
    w: list[np.ndarray]


def _figure(width: float, height: float, layout: str | None = "constrained") -> Figure:
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasSVG(figure)
    return figure


def _svg(figure: Figure, name: str) -> str:
    """The figure as inline SVG; ``name`` keeps its ids apart from those of the page's other pictures."""
    stream = io.StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with matplotlib.rc_context({"svg.hashsalt": name, **STYLE}):
        figure.savefig(stream, format="svg", metadata=nothing, dpi=140)
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r' (xmlns(:\w+)?|version)="[^"]*"', "", text)
    text = re.sub(r'( id="|xlink:href="#|url\(#)', rf"\g<1>{name}-", text)
    for stand_in, variable in ((INK, "--ink"), (RULE, "--rule"), (PAPER, "--paper")):
        text = text.replace(stand_in, f"var({variable})")
    return text


def picture(draw):
    """Decorator: ``draw(name, ...)`` returns a Figure and runs in the report's style; the result is its SVG
    text."""

    def wrapped(name: str, *arguments) -> str:
        with matplotlib.rc_context(STYLE):
            return _svg(draw(*arguments), name)

    wrapped.__doc__ = draw.__doc__
    return wrapped


def _thin(values: np.ndarray) -> np.ndarray:
    """At most about POINTS_PER_BIN of ``values``, always the largest ones."""
    if len(values) <= POINTS_PER_BIN:
        return values
    ordered = np.sort(values)[::-1]
    kept = POINTS_PER_BIN // 4
    return np.concatenate([ordered[:kept], ordered[kept :: -(-len(ordered) // (POINTS_PER_BIN - kept))]])


def _cloud(axes: Axes, grid: np.ndarray, values: list[np.ndarray], colour: str, label: str) -> None:
    """Points over the bins; DC (bin 0) as stars. Zeros have no place on a logarithmic axis and are left
    out."""
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


def _bound(axes: Axes, grid: np.ndarray, values: np.ndarray, style: str, label: str, **look) -> None:
    """A bound over the bins with DC as a star of its own: nothing is known between DC and the lowest bin."""
    drawn = np.where(values > 0, values, np.nan)
    (line,) = axes.plot(grid[1:], drawn[1:], style, label=label, **look)
    axes.plot(grid[:1], drawn[:1], "*", ms=9, color=line.get_color(), mfc=look.get("mfc", line.get_color()))


def _bins(axes: Axes, grid: np.ndarray, without: np.ndarray, *, label: bool = True) -> None:
    """Logarithmic frequency axis that names some of the bins, with DC at its stand-in place; bins without
    frames are marked."""
    step = -(-len(grid) // MOST_BIN_LABELS)
    named = grid[1::step]
    axes.set_xscale("log")
    axes.set_xlim(grid[0] / 1.5, grid[-1] * 1.5)
    axes.set_xticks([grid[0], *named], ["DC", *(f"{w:.3g}" for w in named)])
    axes.xaxis.set_minor_locator(FixedLocator(grid[1:]))
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


def _legend_above(axes: Axes, columns: int) -> None:
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0, 1.0),
        ncols=columns,
        frameon=False,
        markerscale=1.4,
        handletextpad=0.5,
        columnspacing=1.2,
    )


@picture
def disturbance_design(
    grid, clouds: Clouds, bounds: dict[str, np.ndarray], gamma_fine, fine, unit: str
) -> Figure:
    """Fig. 2: |E| and B1 points, B1, B2, gamma_w as the rule asks and smoothed; below, the ceiling that made
    it."""
    figure = _figure(8.2, 5.6)
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
    _legend_above(top, 3)
    low.plot(grid[1:], bounds["nu_ceiling"][1:], "-o", ms=3.5, color=PINK, label=r"ceiling $\bar\nu(\omega)$")
    low.plot(grid[1:], bounds["nu"][1:], "v", ms=4, color=INK, label=r"$\nu$ needed")
    low.set_ylim(0, 1.15 * max(np.nanmax(bounds["nu_ceiling"]), np.nanmax(bounds["nu"])))
    low.set_ylabel(r"$|\delta|$, –")
    low.legend(loc="upper left", bbox_to_anchor=(0.12, 1.0))
    _bins(low, grid, without)
    return figure


def _decent_bottom(clouds: list[np.ndarray], bound: np.ndarray) -> float:
    """Lower end of a logarithmic axis: the 1 % quantile of the points that are not tiny beside the bound, so
    that a few near-zeros do not squeeze the rest."""
    values, largest = np.concatenate(clouds), float(np.nanmax(bound))
    values = values[values > 1e-3 * largest]
    return float(np.quantile(values, 0.01)) if len(values) else 0.05 * largest


@picture
def weights_over_bounds(
    grid, clouds: Clouds, bounds: dict[str, np.ndarray], W_w, W_n, fine, samples, W_delta, outputs
) -> Figure:
    """Fig. 3: |w_j| points, B_w, W_w and (where known, else None) the noise weight W_n per output; nu points,
    the bound that W_delta covers, and W_delta."""
    figure = _figure(8.2, 3.6 if len(outputs) == 1 else 2.9 * len(outputs))
    frames = figure.subfigures(1, 2, width_ratios=[1, 1])
    without = ~(bounds["frames"] > 0)
    for j, axes in enumerate(np.atleast_1d(frames[0].subplots(len(outputs), 1))):
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
    _legend_above(frames[0].axes[0], 3)
    right = frames[1].subplots()
    _cloud(right, grid, clouds.nu, POINTS, r"$\nu$ of a frame")
    _bound(right, grid, samples, "--s", "running bound", ms=4, color=RED)
    right.plot(fine, W_delta, "-", color=BLUE, label=r"$|W_\Delta|$")
    right.set_yscale("log")
    right.set_ylim(_decent_bottom(clouds.nu, samples), 2 * max(W_delta.max(), np.nanmax(samples)))
    right.set_ylabel(r"uncertainty size $|\delta|$, –")
    _legend_above(right, 3)
    _bins(right, grid, without)
    return figure


FRONT_COLUMNS = 5
MOST_FRONTS = 30
"""Panels of the Pareto picture: of more bins every n-th is drawn."""


@picture
def pareto(
    omega, gamma_w: np.ndarray, nu: np.ndarray, taken: dict[str, np.ndarray], ceiling: np.ndarray, unit: str
) -> Figure:
    """nu over gamma_w (K, P), a panel per bin; ``taken`` gamma_w, nu (K,), and the ceiling (K,) on nu."""
    known = np.flatnonzero(np.isfinite(nu).any(axis=1))
    shown = known[:: -(-len(known) // MOST_FRONTS)]
    rows = -(-len(shown) // FRONT_COLUMNS)
    figure = _figure(8.2, 0.5 + 1.5 * rows)
    panels = figure.subplots(rows, FRONT_COLUMNS, squeeze=False).ravel()
    for axes, k in zip(panels, shown, strict=False):
        top = 3 * max(taken["nu"][k], ceiling[k])
        axes.plot(gamma_w[k], nu[k], "-", color=BLUE, label=r"front $\nu(\gamma_w)$")
        axes.axhline(ceiling[k], ls="--", lw=0.9, color=PINK, label=r"ceiling $\bar\nu$")
        axes.plot(taken["gamma_w"][k], taken["nu"][k], "o", ms=5, color=RED, label="taken")
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


@dataclass(frozen=True)
class Stretch:
    """A piece of a drive: t (N,) [s after the drive's start], v (N,) [m/s], y, yhat (N, n_y)."""

    title: str
    t: np.ndarray
    v: np.ndarray
    y: np.ndarray
    yhat: np.ndarray


@picture
def model_in_time(stretches: list[Stretch], outputs) -> Figure:
    """Fig. 4: measurement and nominal model, and the nominal error, on each stretch."""
    rows = 2 * len(outputs)
    figure = _figure(8.2, 1.2 + 3.2 * len(outputs))
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


@picture
def excitation(
    grid,
    frames: np.ndarray,
    size_max: np.ndarray,
    size_median: np.ndarray,
    every_start_max: np.ndarray,
    disturbance: np.ndarray,
    unit: str,
) -> Figure:
    """|Z| per bin against the disturbance bound, and how many frames counted."""
    figure = _figure(8.2, 4.0)
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
    _legend_above(top, 2)
    _bins(top, grid, without, label=False)
    low.bar(grid, frames, width=0.25 * grid, color=SKY)
    low.set_yscale("log")
    low.set_ylim(0.8, 2.0 * max(1, frames.max()))
    low.set_ylabel("counted frames")
    _bins(low, grid, without)
    return figure


MAP_WIDTH, ROW_PIXELS = 1200, 9
"""Pixels of the map over margin: along time, and of one bin."""
MAP_PAPER = "#ffffff"
"""Maps stand on white on dark pages too: their darkest colour means the largest margin and must not
vanish."""


def _colours() -> matplotlib.colors.Colormap:
    return matplotlib.colormaps["cividis_r"].with_extremes(over=RED)


def _paint(kind: np.ndarray, value: np.ndarray) -> np.ndarray:
    """RGBA picture of cells: ``kind`` (K, W) index into REASONS or -1 (no frame), ``value`` (K, W) margin /
    threshold."""
    kind, value = (np.repeat(a, ROW_PIXELS, axis=0) for a in (kind, value))
    y, x = np.indices(kind.shape)
    out = np.zeros((*kind.shape, 4))
    counted = (kind == REASONS.index("none")) | (kind == REASONS.index("not_excited"))
    out[counted] = _colours()(value[counted])
    # Frames without evidence are shown through a screen: same colour, three quarters of the pixels left open.
    screen = (kind == REASONS.index("not_excited")) & ~((x % 4 < 2) & (y % 3 == 1))
    out[screen, 3] = 0.12
    for reason, mask in (
        ("speed_moved", (x + y) % 8 < 2),
        ("out_of_range", np.ones_like(x, bool)),
        ("settling", x % 6 < 2),
    ):
        drawn = (kind == REASONS.index(reason)) & mask
        out[drawn] = (*to_rgb(POINTS), 0.45 if reason == "out_of_range" else 0.9)
    out[::ROW_PIXELS] = 0.0
    return np.round(out * 255).astype(np.uint8)


def _cells(replay: Replay, t0: float, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Kind and margin of every cell of the map. A frame stands on its central half, where its window has its
    weight."""
    frames = replay.run.frames
    kind, value = np.full((len(lengths), MAP_WIDTH), -1), np.zeros((len(lengths), MAP_WIDTH))
    length_s = lengths[frames.bin] * replay.Ts
    end = frames.t_end_s - t0 + replay.Ts
    scale = MAP_WIDTH / max(replay.duration_s, replay.Ts)
    first = np.floor((end - 0.75 * length_s) * scale).astype(int)
    last = np.maximum(np.floor((end - 0.25 * length_s) * scale).astype(int), first + 1)
    for k, a, b, reason, margin in zip(frames.bin, first, last, frames.reason, frames.margin, strict=False):
        # Of frames that share a pixel the largest margin must not vanish.
        if b == a + 1 and kind[k, min(a, MAP_WIDTH - 1)] >= 0 and value[k, min(a, MAP_WIDTH - 1)] > margin:
            continue
        kind[k, a:b], value[k, a:b] = reason, margin
    return kind, value


def _bin_labels(omega: np.ndarray) -> list[str]:
    return ["DC", *(f"{w:.2g}" for w in omega[1:])]


@picture
def margin_map(
    replay: Replay,
    t: np.ndarray,
    v: np.ndarray,
    omega: np.ndarray,
    lengths: np.ndarray,
    threshold: float,
    speed_range: tuple[float, float],
) -> Figure:
    """Margin over time and bin of one drive, alarms, speed and verdict below."""
    K = len(omega)
    map_in, speed_in, verdict_in, gap_in, below_in = 0.135 * K, 0.72, 0.13, 0.13, 0.45
    height = map_in + speed_in + verdict_in + 3 * gap_in + below_in
    # Placed by hand: laid out automatically this picture, of which there are many, would take half as long
    # again, and time axes of different drives would not line up.
    figure = _figure(8.2, height, layout=None)
    top, middle, low = figure.subplots(
        3,
        1,
        sharex=True,
        height_ratios=[map_in, speed_in, verdict_in],
        gridspec_kw={
            "left": 0.075,
            "right": 0.985,
            "top": 1 - gap_in / height,
            "bottom": below_in / height,
            "hspace": 3 * gap_in / (map_in + speed_in + verdict_in),
        },
    )
    kind, margin = _cells(replay, t[0], lengths)
    extent = (0.0, replay.duration_s, -0.5, K - 0.5)
    top.imshow(_paint(kind, margin / threshold)[::-1], aspect="auto", extent=extent, interpolation="none")
    at = {w: k for k, w in enumerate(omega)}
    # An alarm of the energy test belongs to no bin: above the map.
    for test, marker in (("frame", "<"), ("energy", "v")):
        alarms = [a for a in replay.alarms if a.test == test]
        if alarms:
            top.plot(
                [a.t_s for a in alarms],
                [K - 0.4 if a.bin_rad_s is None else at[a.bin_rad_s] for a in alarms],
                marker,
                ms=6,
                mfc=RED,
                mec=MAP_PAPER,
                mew=0.8,
                clip_on=False,
            )
    top.set_facecolor(MAP_PAPER)
    top.set_yticks(range(K), _bin_labels(omega), fontsize=7)
    top.set_ylabel("bin, rad/s")
    top.grid(False)
    middle.plot(t - t[0], v, "-", color=INK, lw=0.9)
    for limit in speed_range:
        middle.axhline(limit, color=ORANGE, ls="--", lw=0.9)
    middle.set_ylabel("speed, m/s")
    middle.set_ylim(bottom=min(0.0, v.min()))
    middle.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    edges = np.r_[0, np.flatnonzero(np.diff(replay.run.verdict)) + 1, len(t)]
    for a, b in zip(edges[:-1], edges[1:], strict=False):
        low.axvspan(
            a * replay.Ts, b * replay.Ts, color=VERDICT_COLOURS[VERDICTS[replay.run.verdict[a]]], lw=0
        )
    low.set_yticks([])
    low.grid(False)
    low.set_ylabel("verdict", rotation=0, ha="right", va="center")
    low.set_xlabel("time after the drive's start, s")
    low.set_xlim(0.0, replay.duration_s)
    return figure


@picture
def map_key() -> Figure:
    """Key of the maps: colours of the margin, patterns of what was not judged, colours of the verdicts."""
    figure = _figure(8.2, 1.35)
    axes = figure.subplots(1, 3, width_ratios=[1.2, 1.25, 1.0])
    bar = figure.colorbar(
        ScalarMappable(Normalize(0.0, 1.0), _colours()),
        cax=axes[0].inset_axes([0.02, 0.55, 0.9, 0.2]),
        orientation="horizontal",
        extend="max",
    )
    bar.set_label("margin $t^*$ / threshold (red: above)")
    for row, (reason, text) in enumerate((r, t) for r, t in REASON_WORDS.items() if r != "none"):
        sample = _paint(np.full((1, 40), REASONS.index(reason)), np.full((1, 40), 0.6))
        axes[1].inset_axes([0.0, 0.78 - 0.26 * row, 0.14, 0.2]).imshow(
            sample, aspect="auto", interpolation="none"
        )
        axes[1].child_axes[-1].set(xticks=[], yticks=[], facecolor=MAP_PAPER)
        axes[1].text(0.18, 0.88 - 0.26 * row, text, va="center", fontsize=8)
    for row, (verdict, colour) in enumerate(VERDICT_COLOURS.items()):
        x, y = 0.5 * (row % 2), 0.88 - 0.34 * (row // 2)
        axes[2].add_patch(matplotlib.patches.Rectangle((x, y - 0.1), 0.1, 0.2, color=colour, lw=0))
        axes[2].text(x + 0.13, y, verdict.replace("_", " "), va="center", fontsize=8)
    for a in axes:
        a.set(xlim=(0, 1), ylim=(0, 1))
        a.axis("off")
    return figure


SOONEST_S = 0.01
"""Where times below stand in `time_to_find`: its axis is logarithmic."""


@picture
def time_to_find(faults: list[dict], allowed_s: float) -> Figure:
    """Judged, excited seconds from each fault to the alarm it caused, a mark per case."""
    figure = _figure(8.2, 1.0 + 0.32 * len(faults))
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
            found = case["s"] is not None
            axes.plot(x, y + dy, "o" if found else "X", ms=4, color=BLUE if found else RED)
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
    axes.set_yticks(range(len(faults)), [row["fault"] for row in faults])
    axes.invert_yaxis()
    axes.set_xlabel("judged, excited seconds from the fault to the first alarm")
    return figure


@picture
def closed_loop(
    rows: np.ndarray, frames: np.ndarray, threshold: float, fault_start_s: float | None
) -> Figure:
    """Yaw rate against what was wanted, the demand, and the margins of the counted frames, over one simulated
    run.

    ``rows``: telemetry with t_s, wanted_radps, yaw_rate_radps, demand_bar; ``frames``: t_end_s, reason,
    margin.
    """
    figure = _figure(8.2, 5.2)
    rate, demand, margin = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
    rate.plot(rows["t_s"], rows["wanted_radps"], "--", color=RED, lw=1.0, label="wanted, filtered command")
    rate.plot(rows["t_s"], rows["yaw_rate_radps"], "-", color=INK, lw=0.8, label="truck")
    rate.set_ylabel("yaw rate, rad/s")
    demand.plot(rows["t_s"], rows["demand_bar"], "-", color=BLUE, lw=0.8)
    demand.set_ylabel("demand, bar")
    counted = frames[frames["reason"] <= 1]
    above = counted["margin"] > threshold
    margin.plot(
        counted["t_end_s"][~above],
        counted["margin"][~above],
        ".",
        ms=2.5,
        color=BLUE,
        label="frame",
        rasterized=True,
    )
    margin.plot(counted["t_end_s"][above], counted["margin"][above], "v", ms=4, color=RED, label="falsifies")
    margin.axhline(threshold, color=INK, lw=0.9, ls="--", label="threshold")
    margin.set_ylabel("margin t*, –")
    margin.set_xlabel("time, s")
    margin.set_ylim(
        0.0, max(1.2 * threshold, min(4.0 * threshold, 1.1 * float(counted["margin"].max(initial=0.0))))
    )
    if fault_start_s is not None:
        for axes in (rate, demand, margin):
            axes.axvline(fault_start_s, color=RED, lw=0.9, ls=":")
    for axes in (rate, margin):
        axes.legend(loc="upper left", ncols=3, fontsize="small")
    return figure


DETECTOR_STYLES = (
    (BLUE, "-", "o", 2.0),
    (ORANGE, "--", "s", 1.1),
    (GREEN, "-.", "^", 1.1),
    (PINK, ":", "D", 1.1),
)


def _over_severity(
    severities: list[dict], units: dict[str, str], draw: Callable[[Axes, np.ndarray, list[dict]], None]
) -> Figure:
    """A panel per kind of fault with more than one severity; ``draw(axes, x, rows)`` fills it, rows in the
    order of their severity x."""
    kinds = [k for k in units if sum(s["kind"] == k for s in severities) > 1]
    columns = 4
    lines = -(-len(kinds) // columns)
    figure = _figure(9.6, 1.75 * lines + 0.5)
    panels = figure.subplots(lines, columns, sharey=True, squeeze=False).ravel()
    for axes in panels[len(kinds) :]:
        axes.set_axis_off()
    for axes, kind in zip(panels, kinds, strict=False):
        rows = sorted((s for s in severities if s["kind"] == kind), key=lambda s: s["severity"])
        x = np.array([s["severity"] for s in rows])
        draw(axes, x, rows)
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


@picture
def detection(severities: list[dict], units: dict[str, str], names: dict[str, str], key: str) -> Figure:
    """Share of runs in which a fault was found in time, against its severity: a panel per kind, a line per
    detector.

    ``severities``: rows of a campaign's summary; ``key``: "found" or "matched"; ``names``: detector -> title,
    ours first.
    """

    def draw(axes: Axes, x: np.ndarray, rows: list[dict]) -> None:
        for detector, (colour, line, mark, width) in zip(names, DETECTOR_STYLES, strict=False):
            axes.plot(
                x,
                [s[key][detector] / s["runs"] for s in rows],
                line,
                marker=mark,
                ms=3.2,
                lw=width,
                color=colour,
                label=names[detector],
            )
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
        if axes.get_subplotspec().is_first_col():
            axes.set_ylabel("found")

    return _over_severity(severities, units, draw)


@picture
def detection_time(severities: list[dict], units: dict[str, str], names: dict[str, str]) -> Figure:
    """Median judged, excited time [s] from a fault to the first alarm, against its severity; no point where
    fewer than half alarmed."""

    def draw(axes: Axes, x: np.ndarray, rows: list[dict]) -> None:
        for detector, (colour, line, mark, width) in zip(names, DETECTOR_STYLES, strict=False):
            axes.plot(
                x,
                [np.nan if s["median_s"][detector] is None else s["median_s"][detector] for s in rows],
                line,
                marker=mark,
                ms=3.2,
                lw=width,
                color=colour,
                label=names[detector],
            )
        axes.set_yscale("log")
        axes.set_ylim(0.05, 200.0)
        if axes.get_subplotspec().is_first_col():
            axes.set_ylabel("median, s")

    return _over_severity(severities, units, draw)


# ----------------------------------------------------------------------------------------------------- step 8

STRUCTURE_LOOKS = {
    "K_inf": ("-.", GREEN, r"$K_\infty$"),
    "K_i": (":", RED, "$K_i$"),
    "K_is": ("--", BLUE, "$K_{is}$"),
}
"""Line, colour and name of each structure; the lines are the paper's."""


@picture
def performance_weights(
    omega: np.ndarray,
    signals: list[tuple[str, np.ndarray, str]],
    objectives: list[tuple[str, np.ndarray]],
    command: tuple[np.ndarray, np.ndarray] | None,
) -> Figure:
    """Fig. 5: |W| over omega (K,) [rad/s]. ``signals``: name, (K,), unit of what normalises signals;
    ``objectives``: of W_t and W_u; ``command``: frequencies and bound of the measured yaw rate behind W_C,
    where there is one."""
    figure = _figure(8.2, 3.4)
    left, right = figure.subplots(1, 2, sharex=True)
    for (name, values, unit), colour, line in zip(
        signals, (BLUE, GREEN, ORANGE, RED, PINK), ("-", "--", "-.", ":", "-"), strict=False
    ):
        left.plot(omega, values, line, color=colour, label=f"{name}, {unit}")
    if command is not None:
        left.plot(*command, "s", ms=4, color=BLUE, mfc="none", label="measured yaw rate")
    lines = ("-", "--", ":", "-.")
    for index, (name, values) in enumerate(objectives):
        right.plot(
            omega,
            values,
            lines[index % 4],
            color=RED if "W_t" in name else BLUE if "W_u" in name else GREEN,
            label=name,
        )
    for axes in (left, right):
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("frequency, rad/s")
        axes.legend(fontsize=7)
    left.set_ylabel("magnitude")
    return figure


@picture
def worst_case_runs(run: dict) -> Figure:
    """Fig. 6: pressure difference above, yaw rate below; ``run`` as in worst_run.WorstRuns.to_dict."""
    figure = _figure(8.2, 5.2)
    top, low = figure.subplots(2, 1, sharex=True)
    low.plot(run["t_s"], run["wanted_radps"], "-", color=INK, lw=1.0, label="reference, $W_R r_c$")
    for one in run["runs"]:
        line, colour, name = STRUCTURE_LOOKS[one["structure"]]
        label = name + (" without $\\Delta$" if one["structure"] == "K_inf" else " with its worst $\\Delta$")
        top.plot(run["t_s"], one["u_bar"], line, color=colour, lw=1.0, label=label)
        low.plot(run["t_s"], one["r_radps"], line, color=colour, lw=1.0, label=label)
    top.set_ylabel(r"$\Delta p$, bar")
    low.set_ylabel("yaw rate, rad/s")
    low.set_xlabel("time, s")
    for axes in (top, low):
        _legend_above(axes, 4)
    return figure


def standalone(svg: str) -> str:
    """An inline picture as an SVG file of its own, dark on white."""
    for variable, colour in (("--ink", "#1b1e23"), ("--rule", "#c9ced6"), ("--paper", "#ffffff")):
        svg = svg.replace(f"var({variable})", colour)
    return (
        svg.replace(
            "<svg",
            '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
            ' style="background:#ffffff"',
            1,
        )
        + "\n"
    )


@picture
def tradeoff_front(found: dict) -> Figure:
    """The front of `design --tradeoff`: worst mu and floor over uniform ceilings, and the best candidate;
    beside it the ceilings and gamma_w of the best and of the project's setting. ``found``: tradeoff.json."""
    figure = _figure(8.2, 3.6)
    left, right = figure.subplots(1, 2)
    uniform = [
        r
        for r in found["rows"]
        if r["ceiling"] != "project" and r["nu_low"] == r["nu_high"] and r["mu_worst"] is not None
    ]
    for structure in ("K_i", "K_is"):
        rows = sorted((r for r in uniform if r["structure"] == structure), key=lambda r: r["nu_low"])
        rows = [r for r in rows if r["lambda_s"] == rows[0]["lambda_s"]]
        _, colour, name = STRUCTURE_LOOKS[structure]
        level = [r["nu_low"] for r in rows]
        left.plot(level, [r["mu_worst"] for r in rows], "-o", ms=4, color=colour, label=name)
        left.plot(
            level,
            [r["floor"] for r in rows],
            "--",
            color=colour,
            lw=0.9,
            label=f"{name}, no controller below",
        )
    best = found["best"]
    left.plot(
        [np.sqrt(best["nu_low"] * best["nu_high"])],
        [best["mu_worst"]],
        "*",
        ms=11,
        color=INK,
        label="best, at its mean ceiling",
    )
    left.axhline(1.0, color=PINK, lw=0.9, ls=":")
    left.set_xscale("log")
    left.set_xticks([0.05, 0.1, 0.2, 0.4, 0.8], ["0.05", "0.1", "0.2", "0.4", "0.8"])
    left.xaxis.set_minor_formatter(NullFormatter())
    left.set_xlabel(r"uniform ceiling $\bar\nu$, –")
    left.set_ylabel(r"worst $\mu$ over speed")
    left.set_ylim(0.0, min(2.5, 1.1 * max(1.0, *(r["mu_worst"] for r in uniform), best["mu_worst"])))
    omega = np.array(found["omega_rad_s"])[1:]
    for name, style, colour in (("best", "-", BLUE), ("own", "--", RED)):
        detail = {
            k: np.array(v, float)[1:]
            for k, v in found["detail"][name].items()
            if k in ("ceiling", "gamma_w", "nu_i")
        }
        label = {"best": "best", "own": "project"}[name]
        right.plot(omega, detail["ceiling"], style, color=colour, label=rf"$\bar\nu$, {label}")
        right.plot(
            omega,
            np.where(detail["nu_i"] > 0, detail["nu_i"], np.nan),
            style + "o",
            ms=3,
            lw=0.6,
            color=colour,
            label=rf"$\nu_i$, {label}",
        )
        right.plot(
            omega, detail["gamma_w"], style, color=colour, lw=2.2, alpha=0.45, label=rf"$\gamma_w$, {label}"
        )
    right.set_xscale("log")
    right.set_yscale("log")
    right.set_xlabel("frequency of the bin, rad/s")
    for axes in (left, right):
        axes.legend(fontsize=7)
    return figure
