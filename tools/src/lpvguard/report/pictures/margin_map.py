"""Draw the margin of a drive over time and bins, and the key of these maps."""

from itertools import pairwise

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ...core.compiled import REASONS, VERDICTS
from ...replay.replayer import Replay
from .drawing import GREEN, INK, ORANGE, PINK, POINTS, RED, new_figure, picture
from .numbers import Cells, attach

REASON_WORDS = dict(
    zip(
        REASONS,
        ("evidence", "too little excitation", "speed moved too much", "speed out of range", "model settling"),
        strict=True,
    )
)
VERDICT_COLOURS = dict(zip(VERDICTS, (POINTS, GREEN, RED, "#b9d3e6", PINK, ORANGE, "#f0e442"), strict=True))
MAP_WIDTH, ROW_PIXELS = 1200, 9
"""Width of the margin map in pixels, and the height of one bin."""
MAP_PAPER = "#ffffff"
"""Maps are white on dark pages too, so that their darkest colour (the largest margin) stays visible."""


def _colours() -> matplotlib.colors.Colormap:
    return matplotlib.colormaps["cividis_r"].with_extremes(over=RED)


def _paint(kind: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Picture (K * ROW_PIXELS, W, 4) of cells, RGBA of 8 bit.

    ``kind`` (K, W) is an index into REASONS, or -1 without a frame. ``value`` (K, W) is margin / threshold.
    """
    kind, value = (np.repeat(a, ROW_PIXELS, axis=0) for a in (kind, value))
    y, x = np.indices(kind.shape)
    out = np.zeros((*kind.shape, 4))
    counted = (kind == REASONS.index("none")) | (kind == REASONS.index("not_excited"))
    out[counted] = _colours()(value[counted])
    # Frames without evidence are dotted: one quarter of their pixels has the colour.
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
    """Compute kind and margin of every cell of the map, each (K, MAP_WIDTH).

    A frame fills only its central half, because its window has most of its weight there. ``t0`` is the start
    of the drive [s], ``lengths`` (K,) are frame lengths [samples].
    """
    frames = replay.run.frames
    kind, value = np.full((len(lengths), MAP_WIDTH), -1), np.zeros((len(lengths), MAP_WIDTH))
    length_s = lengths[frames.bin] * replay.Ts
    end = frames.t_end_s - t0 + replay.Ts
    scale = MAP_WIDTH / max(replay.duration_s, replay.Ts)
    first = np.floor((end - 0.75 * length_s) * scale).astype(int)
    last = np.maximum(np.floor((end - 0.25 * length_s) * scale).astype(int), first + 1)
    for k, a, b, reason, margin in zip(frames.bin, first, last, frames.reason, frames.margin, strict=False):
        # Frames that share a pixel show the largest margin.
        if b == a + 1 and kind[k, min(a, MAP_WIDTH - 1)] >= 0 and value[k, min(a, MAP_WIDTH - 1)] > margin:
            continue
        kind[k, a:b], value[k, a:b] = reason, margin
    return kind, value


def _frames(replay: Replay, t0: float, lengths: np.ndarray, threshold: float) -> Cells:
    """Make the numbers of every frame; ``t0`` is the start of the drive [s]. See also `margin_map`."""
    frames = replay.run.frames
    end = np.round((frames.t_end_s - t0) / replay.Ts).astype(int) + 1
    order = np.lexsort((end, frames.bin))
    return Cells(
        frames.bin[order],
        end[order],
        frames.margin[order],
        frames.reason[order],
        [REASON_WORDS[r] for r in REASONS],
        lengths,
        replay.Ts,
        threshold,
    )


def _bin_labels(omega: np.ndarray) -> list[str]:
    return ["DC", *(f"{w:.2g}" for w in omega[1:])]


def _mark_alarms(axes: Axes, replay: Replay, omega: np.ndarray) -> None:
    """Draw one triangle per alarm: in the row of its bin for the frame test, otherwise above the map."""
    at = {w: k for k, w in enumerate(omega)}
    above = len(omega) - 0.4
    for test, marker in (("frame", "<"), ("energy", "v"), ("change", "d")):
        alarms = [a for a in replay.alarms if a.test == test]
        if alarms:
            axes.plot(
                [a.t_s for a in alarms],
                [above if a.bin_rad_s is None else at[a.bin_rad_s] for a in alarms],
                marker,
                ms=6,
                mfc=RED,
                mec=MAP_PAPER,
                mew=0.8,
                clip_on=False,
            )


def _draw_verdicts(axes: Axes, replay: Replay) -> None:
    """Draw the verdict over time as a bar."""
    verdict = replay.run.verdict
    edges = np.r_[0, np.flatnonzero(np.diff(verdict)) + 1, len(verdict)]
    for a, b in pairwise(edges):
        axes.axvspan(a * replay.Ts, b * replay.Ts, color=VERDICT_COLOURS[VERDICTS[verdict[a]]], lw=0)
    axes.set_yticks([])
    axes.grid(False)
    axes.set_ylabel("verdict", rotation=0, ha="right", va="center")


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
    """Draw the margin of one drive over time and bins with its alarms, and speed and verdict below it.

    ``t``, ``v`` (N,) are time [s] and speed [m/s]. ``omega``, ``lengths`` (K,) are bins [rad/s] and frame
    lengths [samples]. ``speed_range`` is the model's range [m/s].
    """
    K = len(omega)
    map_in, speed_in, verdict_in, gap_in, below_in = 0.135 * K, 0.72, 0.13, 0.13, 0.45
    height = map_in + speed_in + verdict_in + 3 * gap_in + below_in
    # The axes have fixed places. With the automatic layout, the time axes of different drives would not be
    # aligned, and each of many pictures would take 50 % longer.
    figure = new_figure(8.2, height, layout=None)
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
    attach(top, _frames(replay, t[0], lengths, threshold))
    _mark_alarms(top, replay, omega)
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
    _draw_verdicts(low, replay)
    low.set_xlabel("time after the drive's start, s")
    low.set_xlim(0.0, replay.duration_s)
    return figure


@picture
def map_key() -> Figure:
    """Draw the key of the maps: colours of margins and verdicts, patterns of unjudged frames."""
    figure = new_figure(8.2, 1.35)
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
