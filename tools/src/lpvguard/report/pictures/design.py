"""Pictures of the controller design (step 8): Figs. 5 and 6 of the paper, and the trade-off."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from .drawing import BLUE, GREEN, INK, ORANGE, PINK, RED, legend_above, new_figure, picture

STRUCTURE_LOOKS = {
    "K_inf": ("-.", GREEN, r"$K_\infty$"),
    "K_i": (":", RED, "$K_i$"),
    "K_is": ("--", BLUE, "$K_{is}$"),
}
"""Line style, colour and name of each structure; the line styles are those of the paper."""


@picture
def performance_weights(
    omega: np.ndarray,
    signals: list[tuple[str, np.ndarray, str]],
    objectives: list[tuple[str, np.ndarray]],
    command: tuple[np.ndarray, np.ndarray] | None,
) -> Figure:
    """Fig. 5: magnitudes of the weights over omega (K,) [rad/s].

    ``signals``: name, |W| (K,) and unit of each weight that normalises a signal. ``objectives``: name and |W|
    (K,) of W_t and W_u. ``command``: frequencies [rad/s] and bound of the measured yaw rate that W_C covers,
    or None.
    """
    figure = new_figure(8.2, 3.4)
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
    """Draw Fig. 6, with pressure difference and yaw rate, from ``run``, the object fig6 of figures.json."""
    figure = new_figure(8.2, 5.2)
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
        legend_above(axes, 4)
    return figure


def _draw_levels(axes: Axes, tradeoff: dict) -> None:
    """Draw worst mu and its lower bound over uniform ceilings on nu, and the best candidate."""
    uniform = [
        r
        for r in tradeoff["rows"]
        if r["ceiling"] != "project" and r["nu_low"] == r["nu_high"] and r["mu_worst"] is not None
    ]
    for structure in ("K_i", "K_is"):
        rows = sorted((r for r in uniform if r["structure"] == structure), key=lambda r: r["nu_low"])
        rows = [r for r in rows if r["lambda_s"] == rows[0]["lambda_s"]]
        _, colour, name = STRUCTURE_LOOKS[structure]
        level = [r["nu_low"] for r in rows]
        axes.plot(level, [r["mu_worst"] for r in rows], "-o", ms=4, color=colour, label=name)
        axes.plot(
            level,
            [r["floor"] for r in rows],
            "--",
            color=colour,
            lw=0.9,
            label=f"{name}, no controller below",
        )
    best = tradeoff["best"]
    axes.plot(
        [np.sqrt(best["nu_low"] * best["nu_high"])],
        [best["mu_worst"]],
        "*",
        ms=11,
        color=INK,
        label="best, at its mean ceiling",
    )
    axes.axhline(1.0, color=PINK, lw=0.9, ls=":")
    axes.set_xscale("log")
    axes.set_xticks([0.05, 0.1, 0.2, 0.4, 0.8], ["0.05", "0.1", "0.2", "0.4", "0.8"])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(r"uniform ceiling $\bar\nu$, –")
    axes.set_ylabel(r"worst $\mu$ over speed")
    axes.set_ylim(0.0, min(2.5, 1.1 * max(1.0, *(r["mu_worst"] for r in uniform), best["mu_worst"])))


def _draw_ceilings(axes: Axes, tradeoff: dict) -> None:
    """Draw ceiling, nu_i and gamma_w over the bins, for the best candidate and the project's setting."""
    omega = np.array(tradeoff["omega_rad_s"])[1:]
    for key, label, style, colour in (("best", "best", "-", BLUE), ("own", "project", "--", RED)):
        ceiling, gamma_w, nu_i = (
            np.array(tradeoff["detail"][key][k], float)[1:] for k in ("ceiling", "gamma_w", "nu_i")
        )
        axes.plot(omega, ceiling, style, color=colour, label=rf"$\bar\nu$, {label}")
        axes.plot(
            omega,
            np.where(nu_i > 0, nu_i, np.nan),
            style + "o",
            ms=3,
            lw=0.6,
            color=colour,
            label=rf"$\nu_i$, {label}",
        )
        axes.plot(omega, gamma_w, style, color=colour, lw=2.2, alpha=0.45, label=rf"$\gamma_w$, {label}")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("frequency of the bin, rad/s")


@picture
def tradeoff_front(tradeoff: dict) -> Figure:
    """Draw the trade-off: left worst mu over uniform ceilings, right the best candidate's bounds.

    ``tradeoff``: tradeoff.json.
    """
    figure = new_figure(8.2, 3.6)
    left, right = figure.subplots(1, 2)
    _draw_levels(left, tradeoff)
    _draw_ceilings(right, tradeoff)
    for axes in (left, right):
        axes.legend(fontsize=7)
    return figure
