"""`lpvguard report`: one self-contained HTML page with every picture and table of an identification.

Every number on the page is read from the identification folder, or computed here from its frames and from a
replay of the drives through the compiled core. No script, nothing from outside, no clock time: the same input
gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import numpy as np

from .. import __version__
from ..base import artefacts
from ..core.compiled import REASONS, VERDICTS
from ..drives.frames import Estimator
from ..drives.tables import Drive
from ..engine.overbound.weight import Weight
from ..engine.validation import s1
from ..evaluate.run import (
    COUNTS_ONLY,
    EXPORTED,
    FAULT_FROM_S,
    FOUND_WITHIN_S,
    MONITOR,
    PIECE_S,
    SHORTEST_FOR_FAULTS_S,
    STARTS,
    TESTS,
    Column,
    columns,
    detector_rows,
    equal_rates,
)
from ..identify.bounds import FrameSet, counted_frames, explain
from ..identify.energy import EnergyTest
from ..identify.run import (
    DC_STAND_IN,
    SMALLEST_NU,
    DriveSet,
    StoredIdentification,
    fitting_grid,
    uncertainty_samples,
)
from ..identify.visibility import STATED_GAINS
from ..identify.window_error import PERCENTILE, SPEEDS
from ..replay.run import Replay, Replayer, excited_samples
from ..vehicle.project import Project
from . import pictures
from .design_pictures import draw

OURS = "lpvguard, both tests at one threshold"
LONGEST_STRETCH_S = 60.0
"""At most this much of a stretch is drawn, so that single corners can be seen."""
ALARMS_LISTED = 10

CSS = """
:root{--ink:#1b1e23;--soft:#565d68;--rule:#c9ced6;--paper:#fff;--card:#f6f7f9;--good:#00694d;--bad:#a63f00}
@media screen and (prefers-color-scheme:dark){:root{--ink:#e6e8ec;--soft:#a3abb8;--rule:#474e59;--paper:#14171b;
--card:#1d2127;--good:#4cc9a0;--bad:#ff9a5c}}
*{box-sizing:border-box}
body{margin:0 auto;padding:2rem 1.2rem 4rem;max-width:62rem;background:var(--paper);color:var(--ink);
font:15px/1.5 system-ui,"Segoe UI",Helvetica,Arial,sans-serif}
h1{font-size:1.6rem;line-height:1.2;margin:0 0 .3rem}
h2{font-size:1.2rem;margin:2.6rem 0 .5rem;padding-top:.6rem;border-top:1px solid var(--rule)}
h3{font-size:1rem;margin:1.6rem 0 .2rem}
p{max-width:48rem}.lead,figcaption,.note{color:var(--soft)}
figure{margin:1rem 0;break-inside:avoid}
figure svg{width:100%;height:auto;display:block}
figcaption{font-size:.87rem;max-width:50rem;margin-top:.3rem}
.scroll{overflow-x:auto;margin:.6rem 0}
table{border-collapse:collapse;font-size:.85rem;font-variant-numeric:tabular-nums}
th,td{padding:.22rem .6rem;text-align:right;border-bottom:1px solid var(--rule);vertical-align:top}
th{font-weight:600;text-align:right;background:var(--card)}
td:first-child,th:first-child,.words td{text-align:left}
.facts{display:flex;flex-wrap:wrap;gap:0 1.6rem}.tight th,.tight td{white-space:nowrap}
.tight td:first-child,.tight th:first-child{text-align:right}
.words td:first-child{white-space:nowrap}
.yes{color:var(--good);font-weight:600}.no{color:var(--bad);font-weight:600}
nav{font-size:.87rem}nav a{color:inherit;margin-right:1rem}
@media print{body{max-width:none;padding:0;font-size:10pt}nav{display:none}.scroll{overflow:visible}
section{break-inside:auto}*{-webkit-print-color-adjust:exact;print-color-adjust:exact}}
"""


@dataclass
class _Pass:
    """What one pass over the drives leaves: per-drive pages (or, for the plain DFT, table rows) and all
    counted frames."""

    sections: list = field(default_factory=list)
    bin: list[np.ndarray] = field(default_factory=list)
    Z: list[np.ndarray] = field(default_factory=list)
    slow: tuple[int, str, slice] = (0, "", slice(0, 0))
    fast: tuple[int, str, slice] = (0, "", slice(0, 0))


def write_report(
    stored: StoredIdentification,
    drives: DriveSet,
    replayer: Replayer | None,
    out: Path,
    evaluation: dict | None,
    progress: Callable[[str], None],
    loops: Path | None = None,
    design: Path | None = None,
    tradeoff: Path | None = None,
    campaign: dict | None = None,
) -> None:
    """Write the page; InputError when a drive cannot be read or ``out`` cannot be written.

    ``replayer``: None for bounds of the plain DFT, which the core does not compute; drives are then judged by
    the exact margin. ``evaluation``: JSON of `lpvguard evaluate`; ``loops``: folder written by `lpvguard sim
    -o`, with its results.json; ``design``, ``tradeoff``: folders written by `lpvguard design`, without and
    with --tradeoff; ``campaign``: summary.json of `lpvguard campaign`.
    """
    found = _Pass()
    for name in drives.experiments:
        progress(name)
        drive = drives.load(name)[0]
        if replayer is not None:
            _visit(found, stored, replayer, drive, f"d{len(found.sections)}")
        else:
            _visit_plain(found, stored, drives, drive)
    progress("pictures")
    estimator = drives.reader.estimator
    sections = [
        _summary(stored, replayer, drives),
        *_bound_sections(stored, estimator),
        _time_section(found, stored, drives),
        _visibility_section(found, stored, estimator),
        _drive_section(found, replayer) if replayer is not None else _plain_section(found),
    ]
    if evaluation is not None:
        sections.append(_evaluation_section(evaluation))
    if design is not None:
        sections.append(_design_section(design))
    if tradeoff is not None:
        sections.append(_tradeoff_section(tradeoff))
    if loops is not None:
        sections.append(_loop_section(loops))
    if campaign is not None:
        sections.append(_campaign_section(campaign))
    project = stored.project
    titles = [s[s.index("<h2>") + 4 : s.index("</h2>")] for s in sections]
    nav = "".join(f'<a href="#s{i}">{title}</a>' for i, title in enumerate(titles, start=1))
    body = "".join(f'<section id="s{i}">{s}</section>\n' for i, s in enumerate(sections, start=1))
    artefacts.write_file(
        out,
        f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="generator" content="{artefacts.mark("report")}"><meta name="viewport" content="width=device-width,initial-scale=1">
<title>lpvguard report: {escape(project.name)}</title><style>{CSS}</style></head><body>
<h1>{escape(project.title)}</h1>
<p class="lead">How wrong the nominal model can be, according to the drives; what the monitor tolerates for it, and what it said
on every drive. Words and equation numbers are those of Rödönyi and Bokor, <i>Uncertainty identification for a nominal LPV
vehicle model based on experimental data</i>. Made by lpvguard {escape(__version__)}; the same drives give the same page.</p>
<nav>{nav}</nav>
{body}</body></html>
""",
        "report",
    )


# ------------------------------------------------------------------------------------------------------ parts


def _table(head: Iterable[str], rows: Iterable[Iterable[str]], kind: str = "") -> str:
    """HTML table; cells are HTML already."""
    top = "".join(f"<th>{h}</th>" for h in head)
    top = f"<thead><tr>{top}</tr></thead>" if top else ""
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>\n" for row in rows)
    return f'<div class="scroll"><table class="{kind}">{top}<tbody>\n{body}</tbody></table></div>'


def _figure(svg: str, caption: str) -> str:
    return f"<figure>{svg}<figcaption>{caption}</figcaption></figure>"


def _number(value: float | None, digits: int = 3) -> str:
    return "–" if value is None or not np.isfinite(value) else f"{value:.{digits}g}"


def _yes(value: bool | None, yes: str, no: str) -> str:
    return (
        "–"
        if value is None
        else f'<span class="yes">{yes}</span>'
        if value
        else f'<span class="no">{no}</span>'
    )


def _units(stored: StoredIdentification) -> str:
    """Unit of a Euclidean norm over the outputs, as text."""
    units = list(dict.fromkeys(s.unit for s in stored.project.outputs))
    return units[0] if len(units) == 1 else "mixed (" + ", ".join(units) + ")"


# ---------------------------------------------------------------------------------------------------- summary


def _estimator_words(stored: StoredIdentification, estimator: Estimator) -> str:
    frames, length_s = stored.project.frames, estimator.length * estimator.Ts
    common = (
        f"{estimator.n_bins - 1} bins from {estimator.omega[1]:.3g} to {estimator.omega[-1]:.3g} rad/s and DC; "
        f"speed within ±{estimator.speed_tolerance:.0%} of the frame's mean"
    )
    if estimator.window == "rectangular":
        return (
            f"the paper's plain DFT: one rectangular frame of {length_s[0]:.4g} s a drive, its transient removed by least squares; "
            f"{common}; identifier {estimator.identifier():#010x}"
        )
    return (
        f"periodic Hann window, {frames.periods} periods a frame, {frames.bins_per_decade} bins a decade, hop "
        f"1/{frames.hop_per_frame} frame; {common}; frames {length_s[1]:.4g} s long in the lowest bin and at DC, "
        f"{length_s[-1]:.3g} s in the highest; settling {estimator.settle * estimator.Ts:.3g} s; "
        f"identifier {estimator.identifier():#010x}"
    )


def _core_words(stored: StoredIdentification, replayer: Replayer | None) -> str:
    if replayer is None:
        return "none: the core computes Hann frames only; these bounds are for analysis, and export, replay and evaluate refuse them"
    same = _same_numbers(stored, replayer)
    return _yes(
        same <= 1e-6,
        f"carries the numbers of this identification (largest relative difference {same:.1e}, float32)",
        f"carries other numbers than this identification (largest relative difference {same:.1e}): maps and verdicts "
        "below are that core's",
    )


def _summary(stored: StoredIdentification, replayer: Replayer | None, drives: DriveSet) -> str:
    project, estimator, calibration = stored.project, drives.reader.estimator, stored.calibration
    groups, drivers = stored.manifest["drives"], stored.manifest["drivers"]

    def listed(names: list[str]) -> str:
        return f"{len(names)}: " + (", ".join(f"{escape(n)} ({escape(drivers[n])})" for n in names) or "none")

    left_out = "".join(f"<br>{escape(n)}: {escape(why)}" for n, why in groups["left_out"].items())
    if calibration.alpha is None:
        claim = "not stated: too few calibration drives; the threshold is the largest score"
    else:
        claim = (
            f"{calibration.alpha:g}: a further drive, exchangeable with the {len(calibration.scores)} calibration drives, "
            f"alarms with probability at most {calibration.alpha:g} (on average over calibration sets)"
            + (", by each test; by either, at most twice that" if stored.energy else "")
        )
    conditional = (
        "–"
        if calibration.conditional_bound is None
        else (
            f"with 95 % confidence over the calibration drives the probability is below {calibration.conditional_bound:.3f}"
        )
    )
    threshold = calibration.threshold if replayer is None else replayer.threshold
    judge = (
        "the exact margin finds none above 1 on the bound-setting drives"
        if replayer is None
        else (
            "the compiled core finds no margin above 1 on the bound-setting drives, whole or with their first samples cut"
        )
    )
    rows = [
        (
            "vehicle",
            f"{escape(project.name)}: {escape(project.title)}; inputs "
            f"{_signals(project.inputs)}; outputs {_signals(project.outputs)}; "
            f"speed {estimator.speed_range[0]:g} to {estimator.speed_range[1]:g} m/s; sampled every "
            f"{project.Ts_s:g} s",
        ),
        ("drives that set the bounds", listed(groups["bounds"])),
        ("drives that calibrate the threshold", listed(groups["calibration"])),
        ("zero-input drives (noise)", listed(groups["noise"])),
        ("drives left out", f"{len(groups['left_out'])}{left_out or ': none'}"),
        (
            "model error class",
            f"{project.bounds.structure}, disturbance set “{project.bounds.disturbance_set}”",
        ),
        ("estimator", _estimator_words(stored, estimator)),
        (
            "threshold of the frame test",
            f"{threshold:.4g} on the {project.frame_test.confirm}-of-{project.frame_test.of_last} margin",
        ),
        ("alpha", claim),
        ("conditional bound", conditional),
        *([("energy test", _energy(stored.energy, project))] if stored.energy else []),
        (
            "final inflation of the weights",
            f"{stored.weights['inflation']:.6g}, the least factor with which {judge}",
        ),
        ("core that replayed the drives", _core_words(stored, replayer)),
    ]
    weights = [
        (f"W<sub>{index}</sub> of {escape(s.name)}", w)
        for index in ("w", "n")
        for s, w in zip(project.outputs, stored.weights[f"W_{index}"], strict=False)
    ]
    weights += [
        ("W<sub>Δ</sub>", stored.weights["W_delta"]),
        ("γ<sub>w</sub> smoothed", stored.weights["gamma_w"]),
    ]
    proofs = _table(
        [
            "weight",
            "order",
            "worst |W|/bound, dB",
            "no weight of this order below, dB",
            "smallest |W|/bound proved",
            "at, rad/s",
            "proved up to, rad/s",
            "stable, minimum phase",
            "bins bridged for want of data, rad/s",
        ],
        [
            [
                label,
                str(w["order"]),
                f"{w['worst_ratio_db']:.3f}",
                f"{w['lp_optimum_db']:.3f}",
                f"{w['certificate']['min_ratio']:.15g}",
                _limit(w["certificate"]["min_ratio_at"]),
                _limit(w["certificate"]["omega_max"]),
                _yes(
                    w["certificate"]["stable"]
                    and w["certificate"]["minimum_phase"]
                    and w["certificate"]["ok"],
                    "proved",
                    "not proved",
                ),
                ", ".join(_number(x) for x in w["certificate"]["without_data"]) or "none",
            ]
            for label, w in weights
        ],
    )
    return f"""<h2>Summary</h2>{_table([], rows, "words")}
<p>Each weight lies above its bound at every frequency, proved piece by piece by exact Routh arrays and Bernstein coefficients,
not on a grid, and proved anew when this page was made (for W<sub>w</sub> and W<sub>Δ</sub>); between bins a bound is log-log
linear. The worst ratio is how far the weight lies above its bound where it lies highest; the column beside it is a proved lower
limit for any weight of the same order.
DC stands at {DC_STAND_IN:g} times the lowest bin's frequency, so “at”
{estimator.omega[1] * DC_STAND_IN:.3g} rad/s means DC.</p>{proofs}{_window_error(stored, estimator)}"""


def _window_error(stored: StoredIdentification, estimator: Estimator) -> str:
    """What the estimator costs where dynamics are inverted, per bin."""

    def row(label: str, key: str) -> list[str]:
        return [label, *(_number(x, 2) for x in stored.bounds[key])]

    table = _table(
        ["relative error of ξ<sub>s</sub> \\ bin, rad/s", "DC", *(f"{w:.3g}" for w in estimator.omega[1:])],
        [row("median", "window_error_median"), row(f"{PERCENTILE}th percentile", "window_error_percentile")],
    )
    return f"""<h3>Window error</h3>{table}
<p class="note">|ξ̂<sub>s</sub> − ξ<sub>s</sub>| / |ξ<sub>s</sub>| when a known ξ<sub>s</sub> that drives the nominal model's state is found
back from such frames of that state (made-up data; largest over {SPEEDS} frozen speeds). It is the error of class S2 and of any LFT that inverts
dynamics when they are given frames of this estimator, and tells whether these frames are long enough for that; class S1
compares spectra of e and ŷ, inverts nothing and does not have it.</p>"""


def _limit(value: float | str) -> str:
    return "∞" if value == "inf" else _number(value)


def _signals(signals: list) -> str:
    return ", ".join(f"{escape(s.name)} [{escape(s.unit)}], positive: {escape(s.positive)}" for s in signals)


def _same_numbers(stored: StoredIdentification, replayer: Replayer) -> float:
    """Largest relative difference between this identification's coefficients and those of the core that
    replays."""
    ours, theirs = stored.coefficients.flat_reals(), replayer.core.compiled[1]
    if len(ours) != len(theirs):
        return float("inf")
    scale = np.maximum(np.abs(ours), np.finfo(np.float32).tiny)
    return float(np.max(np.abs(ours - theirs) / scale))


# ---------------------------------------------------------------------------------------------- Figs. 2 and 3


def _clouds(stored: StoredIdentification, estimator: Estimator) -> pictures.Clouds:
    """Points of the bound-setting drives on the core's frame grid."""
    with np.load(stored.folder / "spectra.npz") as spectra:
        names = spectra["names"].tolist()
        setting = np.isin(spectra["drive"], [names.index(n) for n in stored.manifest["drives"]["bounds"]])
        columns = {key: spectra[key][setting] for key in ("bin", "start", "E", "Z")}
    clouds = pictures.Clouds([], [], [], [])
    for k in range(estimator.n_bins):
        of_bin = columns["bin"] == k
        frames = FrameSet(
            k, *(columns[key][of_bin] for key in ("E", "Z", "start")), str(stored.folder / "spectra.npz")
        )
        size = np.linalg.norm(frames.E, axis=1)
        nu, w = explain(frames, estimator, stored.bounds["gamma_w"], stored.project.bounds.structure)
        clouds.E.append(size)
        clouds.B1.append(s1.solve(frames.E, frames.Z, size).b1)
        clouds.nu.append(nu)
        clouds.w.append(np.abs(w))
    return clouds


def _bound_sections(stored: StoredIdentification, estimator: Estimator) -> list[str]:
    bounds, project = stored.bounds, stored.project
    clouds, grid = _clouds(stored, estimator), fitting_grid(estimator)
    fine = np.geomspace(grid[0], 2 * grid[-1], 400)
    weights, inflation = stored.weights, stored.weights["inflation"]

    def curve(entry: dict) -> np.ndarray:
        return Weight.from_dict(entry["weight"]).magnitude(fine)

    points = sum(len(c) for c in clouds.E)
    without = int((~(bounds["frames"] > 0)).sum())
    gaps = (
        f" {without} bins without a counted frame are hatched: no information."
        if without
        else " Every bin has data."
    )
    if np.nanmax(bounds["B1"]) > 0:
        b1 = (
            "Green: the right side of (9) per frame and its maximum B<sub>1</sub>, the least disturbance that one δ "
            "common to all outputs leaves to explain."
        )
    else:
        b1 = (
            "B<sub>1</sub> is 0 in every bin and has no place on the logarithmic axis: with one output δ = E/Z "
            "explains any frame without a disturbance, so the ceiling alone decides the trade-off."
        )
    stars = (
        f"Stars: DC, standing at {grid[0]:.3g} rad/s ({DC_STAND_IN:g} of the lowest bin) for want of a place; the shaded "
        "gap between is below the lowest bin, where there is no information and only longer records help."
    )
    binding = np.nanargmax(
        np.where(estimator.cycles > 0, bounds["nu"] / np.maximum(bounds["nu_ceiling"], 1e-300), np.nan)
    )
    second = _figure(
        pictures.disturbance_design(
            "f2", grid, clouds, bounds, curve(weights["gamma_w"]), fine, _units(stored)
        ),
        f"<b>Counterpart of Fig. 2.</b> Grey: |E| of {points} frames of the {len(stored.manifest['drives']['bounds'])} "
        f"bound-setting drives on "
        f"the monitor's frame grid, thinned to about {pictures.POINTS_PER_BIN} a bin (the largest |E| kept). B<sub>2</sub>: "
        f"their bound over "
        f"frames at every start ({int(bounds['frames'].sum())} frames), hence on or above all points. Circles: "
        f"γ<sub>w</sub> that the rule asks for, "
        "max √(B<sub>1</sub>² + |Z|² max(0, |δ<sub>0</sub>| − ν̄)²), and at DC B<sub>2</sub>; line: the overbounding "
        "fit that is used. "
        f"{b1} {stars}{gaps} Lower panel: the ceiling ν̄(ω) on the uncertainty, set beforehand in the project file, and "
        f"what was needed in the end "
        f"(closest to its ceiling at {estimator.omega[binding]:.3g} rad/s: ν = {bounds['nu'][binding]:.3g} of "
        f"{bounds['nu_ceiling'][binding]:.3g}). "
        "How to read it: γ<sub>w</sub> near B<sub>2</sub> blames the disturbance, γ<sub>w</sub> near B<sub>1</sub> "
        "blames the model.",
    )
    needing = sum(int((c > 0).sum()) for c in clouds.nu)
    noise = (
        "Dash-dotted: the sensor's weight |W<sub>n</sub>|, the bound of the zero-input drives; W<sub>w</sub> is what B<sub>w</sub> "
        "leaves without it (step 7)."
        if weights["W_n"]
        else "Without zero-input drives there is no noise weight: W<sub>w</sub> covers B<sub>w</sub>."
    )
    samples = uncertainty_samples(estimator, bounds["nu"])
    none_allowed = (
        " Structure S0 allows no uncertainty: all error is disturbance."
        if project.bounds.structure == "S0"
        else ""
    )
    third = _figure(
        pictures.weights_over_bounds(
            "f3",
            grid,
            clouds,
            bounds,
            inflation * np.column_stack([curve(w) for w in weights["W_w"]]),
            inflation * np.column_stack([curve(w) for w in weights["W_n"]]) if weights["W_n"] else None,
            fine,
            samples,
            inflation * curve(weights["W_delta"]),
            project.outputs,
        ),
        f"<b>Counterpart of Fig. 3.</b> Left: the disturbance |w<sub>j</sub>| that is left of each frame once δ has "
        f"taken its part, its bound "
        f"B<sub>w</sub> over every start (dashed) and the weight |W<sub>w</sub>| (line, inflation {inflation:.6g} "
        f"included), per output. {noise} Right: the "
        f"uncertainty ν = min |δ| with |E − δZ| ≤ γ<sub>w</sub>; {needing} of {points} frames need any, the others (ν = "
        f"0) have no place on the "
        "axis. Dashed: the running maximum of ν from the lowest bin up, which W<sub>Δ</sub> must cover (a dip only says "
        "that no frame there "
        f"happened to need it), at least {SMALLEST_NU:g} as a weight must be positive; bounds and ν are over every "
        f"start, so they can lie above the points of the monitor's grid. ν(0) = 0 by definition.{none_allowed} "
        "How to read it: a line far above its dashed bound is conservatism of the fit, the worst is in the summary.",
    )
    return [
        f"<h2>Disturbance bound</h2>{second}",
        f"<h2>Weights over the bounds</h2>{third}",
        f"<h2>Trade-off between disturbance and uncertainty</h2>{_front(stored, estimator)}",
    ]


def _front(stored: StoredIdentification, estimator: Estimator) -> str:
    """Pareto front per bin; in words where there is none."""
    front, bounds = stored.front, stored.bounds
    if not np.isfinite(front["nu"]).any():
        return "<p>Structure S0 puts all error into the disturbance: there is nothing to trade.</p>"
    svg = pictures.pareto(
        "front", estimator.omega, front["gamma_w"], front["nu"], bounds, bounds["nu_ceiling"], _units(stored)
    )
    return _figure(
        svg,
        (
            f"<b>Pareto front.</b> The least uncertainty ν with which every frame of the bound-setting drives, at every start, is "
            f"explained with a disturbance of at most γ<sub>w</sub>: exact at {front['nu'].shape[1]} values of γ<sub>w</sub> a bin "
            "from B<sub>1</sub>, where the line ends on the left, to B<sub>2</sub>, where it meets 0. Everything below the line is "
            "falsified. Dot: the pair that was taken, by the ceiling (dashed) and the smoothing of γ<sub>w</sub> over the bins. How to "
            "read it: a dot on a steep part pays for a little less disturbance with much more uncertainty; vertical axes end at "
            "three times what was taken or allowed."
        ),
    )


# ----------------------------------------------------------------------------------------------------- Fig. 4


def _longest(mask: np.ndarray) -> slice:
    """The longest run of True."""
    edges = np.flatnonzero(np.diff(np.r_[0, mask.astype(np.int8), 0])).reshape(-1, 2)
    if not len(edges):
        return slice(0, 0)
    a, b = edges[np.argmax(edges[:, 1] - edges[:, 0])]
    return slice(int(a), int(b))


def _time_section(found: _Pass, stored: StoredIdentification, drives: DriveSet) -> str:
    stretches, words, project = [], [], stored.project
    for label, (samples, name, span) in (("lower", found.slow), ("upper", found.fast)):
        if not samples:
            words.append(f"No judged, excited stretch in the {label} third of the speed range.")
            continue
        drive, e, yhat = drives.load(name)
        shown = slice(span.start, min(span.stop, span.start + int(round(LONGEST_STRETCH_S / project.Ts_s))))
        v, error, y = drive.v[shown], e[shown], drive.y[shown]
        role = "set the bounds" if name in stored.manifest["drives"]["bounds"] else "did not set the bounds"
        title = f"{name}, {v.min():.1f} to {v.max():.1f} m/s"
        stretches.append(pictures.Stretch(title, drive.t[shown] - drive.t[0], v, y, yhat[shown]))
        rms = "; ".join(
            f"{escape(s.name)} error rms {np.std(error[:, j]):.2g} {escape(s.unit)} about its mean "
            f"{error[:, j].mean():.2g}, against {np.std(y[:, j]):.2g} of the measurement"
            for j, s in enumerate(project.outputs)
        )
        words.append(
            f"{label.capitalize()} third: {escape(name)} ({role}), {samples * project.Ts_s:.1f} s long, "
            f"{(shown.stop - shown.start) * project.Ts_s:.1f} s shown; {rms}."
        )
    svg = pictures.model_in_time("f4", stretches, project.outputs) if stretches else ""
    return "<h2>The nominal model in time</h2>" + _figure(
        svg,
        "<b>Counterpart of Fig. 4.</b> Measured output (solid) and nominal model along the measured speed (dashed), "
        "below it the nominal error e = y − ŷ on its own scale. Chosen without looking: the longest judged, in-range, excited stretch in the "
        "lower and in the upper third of the "
        "model's speed range. " + " ".join(words),
    )


# ------------------------------------------------------------------------------------ visibility, Fig. of |Z|


def _visibility_section(found: _Pass, stored: StoredIdentification, estimator: Estimator) -> str:
    unit = _units(stored)
    bin_of, Z = (np.concatenate(a) for a in (found.bin, found.Z))
    size = np.linalg.norm(Z, axis=1)
    K = estimator.n_bins

    def per_bin(statistic) -> np.ndarray:
        return np.array([statistic(size[bin_of == k]) if (bin_of == k).any() else np.nan for k in range(K)])

    overlap = " (half overlapping, so they are not independent)" if estimator.window == "hann" else ""
    figure = _figure(
        pictures.excitation(
            "f5",
            fitting_grid(estimator),
            np.bincount(bin_of, minlength=K),
            per_bin(np.max),
            per_bin(np.median),
            stored.bounds["excitation"],
            stored.bounds["gamma_w"],
            unit,
        ),
        f"<b>Excitation.</b> Largest and median |Z|, the nominal output in a frame, over the {len(bin_of)} counted "
        "frames of all drives, with the disturbance bound to compare: where the median lies below it, most frames say little about "
        "the model. Lower panel: counted "
        f"frames a bin{overlap}. Left-most: DC. Unit of |Z|: {escape(unit)}.",
    )
    seen = stored.visibility
    typical, strongest = seen["at_percentile"], seen["at_strongest"]
    names = [f"{c['speed_mps'][0]:.3g}–{c['speed_mps'][1]:.3g}" for c in typical]
    labels = ["DC", *(f"{w:.3g}" for w in estimator.omega[1:])]
    overall = _table(
        [
            "speed, m/s",
            "counted frames",
            "excitation",
            "smallest visible gain error",
            "smallest visible delay, s",
            *(s["fault"] + "?" for s in typical[0]["stated"]),
        ],
        [
            [
                n,
                str(sum(c["frames"])),
                word,
                _number(c["smallest_gain_error"]),
                _number(c["smallest_delay_s"]),
                *(_yes(s["visible"], "visible", "invisible") for s in c["stated"]),
            ]
            for n, *both in zip(names, typical, strongest, strict=False)
            for word, c in zip((f"{seen['percentile']}th percentile", "strongest"), both, strict=False)
        ],
    )

    stated = ", ".join(f"a gain of {c:g} has g = {abs(1 - c):.3g}" for c in STATED_GAINS)

    def by_bin(key: str, cells: list[dict]) -> list[list[str]]:
        return [[n, *(_number(x, 2) for x in c[key])] for n, c in zip(names, cells, strict=False)]

    head = ["speed, m/s \\ bin, rad/s", *labels]
    floor = ["any excitation", *(_number(x, 2) for x in seen["gain_error_floor"])]
    gain, gain_strongest = (
        _table(head, [*by_bin("gain_error", cells), floor]) for cells in (typical, strongest)
    )
    delay, delay_strongest = (_table(head, by_bin("delay_s", cells)) for cells in (typical, strongest))
    frames = _table(head, [[n, *(str(x) for x in c["frames"])] for n, c in zip(names, typical, strict=False)])
    size_table, size_strongest = (_table(head, by_bin("excitation", cells)) for cells in (typical, strongest))
    return f"""<h2>Excitation and what stays invisible</h2>{figure}
<h3>Smallest visible error per speed</h3>
<p>A frame of a vehicle that responds with c times the nominal output shows E = −gZ, |g| = |1 − c|, and exceeds the threshold
{seen["threshold"]:.4g} exactly when g &gt; threshold / t*(−Z, Z); with one output, when
g|Z| &gt; threshold · (B<sub>w</sub> + W<sub>Δ</sub>|Z|). A delay τ has g = |1 − e<sup>−jωτ</sup>|. Z is taken at the
{seen["percentile"]}th percentile of what the bound-setting and calibration drives met in the cell (over at most
{seen["sampled_frames"]} of its frames), so one counted frame in {100 // (100 - seen["percentile"])} is at least
as strong, and at the strongest frame met. A smaller fault is invisible unless the excitation is stronger than that, or the vehicle's ordinary
error happens to add to it; {stated}. “–”: no frame counted there.</p>{overall}
<h3>Smallest visible gain error, per speed and bin, {seen["percentile"]}th percentile</h3>{gain}
<h3>At the strongest excitation</h3>{gain_strongest}<p class="note">Last line: threshold · W<sub>Δ</sub>, below
which a gain error stays invisible however strong the excitation. Above 1
 not even a vehicle that does not respond at all would be noticed in that bin.</p>
<h3>Smallest visible delay [s], per speed and bin, {seen["percentile"]}th percentile</h3>{delay}
<h3>At the strongest excitation</h3>{delay_strongest}
<p class="note">“–”: no delay is large enough (g above 2), DC, or no frame.</p>
<h3>Excitation |Z| [{escape(unit)}] behind these numbers: {seen["percentile"]}th percentile, strongest</h3>{size_table}{size_strongest}
<h3>Counted frames</h3>{frames}"""


# ----------------------------------------------------------------------------------------------------- drives


def _visit(found: _Pass, stored: StoredIdentification, replayer: Replayer, drive: Drive, key: str) -> None:
    """Replay a drive; keep its page, its counted frames and its longest slow and fast stretch."""
    replay = replayer.replay(drive)
    frames = replay.run.frames
    counted = frames.counted
    found.bin.append(frames.bin[counted])
    found.Z.append(frames.Z[counted])
    low, high = replayer.model.speed_range
    usable = replay.judged & replay.in_range & replay.excited
    third = (high - low) / 3
    for side, inside in (("slow", drive.v <= low + third), ("fast", drive.v >= high - third)):
        span = _longest(usable & inside)
        if span.stop - span.start > getattr(found, side)[0]:
            setattr(found, side, (span.stop - span.start, drive.name, span))
    found.sections.append(_drive_page(stored, replayer, drive, replay, key))


def _visit_plain(found: _Pass, stored: StoredIdentification, drives: DriveSet, drive: Drive) -> None:
    """The drive's frame of the plain DFT, judged by the exact margin under the stored weights; its row of the
    table."""
    reader, project = drives.reader, stored.project
    estimator, model = reader.estimator, reader.model
    sets = list(counted_frames(drive, *drives.load(drive.name)[1:], model, estimator))
    row = [escape(drive.name), escape(stored.manifest["drivers"][drive.name]), _role(stored, drive.name)]
    if not len(sets[0].starts):
        found.sections.append([*row, "–", "–", "–", "–"])
        return
    E, Z = (np.concatenate([getattr(s, a) for s in sets]) for a in ("E", "Z"))
    found.bin.append(np.arange(estimator.n_bins))
    found.Z.append(Z)
    span = slice(int(sets[0].starts[0]), int(sets[0].starts[0] + estimator.length[0]))
    low, high = model.speed_range
    speed = drive.v[span].mean()
    if excited_samples(drive.u, project.Ts_s, project.frame_test.excited_std)[span].any():
        side = (
            "slow" if speed <= low + (high - low) / 3 else "fast" if speed >= high - (high - low) / 3 else ""
        )
        if side and span.stop - span.start > getattr(found, side)[0]:
            setattr(found, side, (span.stop - span.start, drive.name, span))
    margin = s1.margin(E, Z, *stored.fitted.at(estimator.omega))
    worst = int(np.argmax(margin))
    found.sections.append(
        [
            *row,
            f"{drive.t[span.start] - drive.t[0]:.4g}",
            f"{speed:.3g}",
            _number(margin[worst]),
            _number(estimator.omega[worst]),
        ]
    )


def _plain_section(found: _Pass) -> str:
    table = _table(
        [
            "drive",
            "driver",
            "part",
            "frame from, s",
            "mean speed, m/s",
            "largest margin",
            "in the bin, rad/s",
        ],
        found.sections,
    )
    return f"""<h2>Margin drive by drive</h2>
<p>One frame a drive, the first that keeps its speed, judged by the exact margin: above 1, no uncertainty and disturbance within the
weights explains it. Drives that set the bounds are at or below 1 by construction. “–”: no frame.</p>{table}"""


def _role(stored: StoredIdentification, name: str) -> str:
    groups = stored.manifest["drives"]
    if name in groups["bounds"]:
        return "set the bounds"
    if name in groups["left_out"]:
        return f"left out: {escape(groups['left_out'][name])}"
    if name in groups["noise"]:
        return "zero input: bounds the noise"
    return f"calibrates, score {stored.calibration.scores[name]:.3f}"


def _drive_page(
    stored: StoredIdentification, replayer: Replayer, drive: Drive, replay: Replay, key: str
) -> str:
    report, frames = replay.to_dict(), replay.run.frames
    svg = pictures.margin_map(
        key,
        replay,
        drive.t,
        drive.v,
        replayer.estimator.omega,
        replayer.estimator.length,
        replayer.threshold,
        replayer.model.speed_range,
    )
    share = (
        report["judged_in_range_excited_s"] / report["in_range_excited_s"]
        if report["in_range_excited_s"]
        else None
    )
    left = [
        f"{report['frames'][r]} ({100 * report['frames'][r] / max(1, len(frames.bin)):.1f} %)"
        for r in REASONS
    ]
    tables = [
        (
            [
                "duration, s",
                "judged, s",
                "of in-range, excited time",
                "largest margin",
                "alarms",
                "final verdict",
            ],
            [
                f"{replay.duration_s:.1f}",
                f"{replay.judged_s:.1f}",
                "–" if share is None else f"{share:.1%}",
                _number(replay.max_margin),
                str(len(replay.alarms)),
                escape(replay.verdict_final.replace("_", " ")),
            ],
        ),
        (
            [f"{v.replace('_', ' ')}, s" for v in VERDICTS],
            [f"{report['verdict_s'][v]:.1f}" for v in VERDICTS],
        ),
        (["frames", *(pictures.REASON_WORDS[r] for r in REASONS)], [str(len(frames.bin)), *left]),
    ]
    facts = "".join(_table(head, [row], "tight") for head, row in tables)
    alarms = ""
    if replay.alarms:
        listed = replay.alarms[:ALARMS_LISTED]
        more = (
            f'<p class="note">{len(replay.alarms) - len(listed)} more alarms; lpvguard replay --json lists all.</p>'
            if len(replay.alarms) > len(listed)
            else ""
        )
        alarms = (
            _table(
                [
                    "alarm at, s",
                    "test",
                    "bin, rad/s",
                    "speed, m/s",
                    "margin",
                    "statistic",
                    "threshold",
                    "|E|",
                    "|Z|",
                    "W<sub>Δ</sub>",
                    "B<sub>w</sub>",
                    "evidence",
                ],
                [
                    [
                        f"{a.t_s:.2f}",
                        a.test if a.band is None else f"{a.test}, {a.band}",
                        _number(a.bin_rad_s),
                        f"{a.speed_mps:.1f}",
                        _number(a.margin),
                        _number(a.statistic),
                        _number(a.threshold),
                        _number(np.linalg.norm(a.E)),
                        _number(np.linalg.norm(a.Z)),
                        _number(a.W_delta),
                        ", ".join(_number(b) for b in a.B_w),
                        _number(a.evidence),
                    ]
                    for a in listed
                ],
            )
            + more
        )
    driver = escape(stored.manifest["drivers"][drive.name])
    return f"""<h3>{escape(drive.name)} <span class="note">({driver} driver; {_role(stored, drive.name)})</span></h3>
<figure>{svg}</figure><div class="facts">{facts}</div>{alarms}"""


def _drive_section(found: _Pass, replayer: Replayer) -> str:
    key = _figure(
        pictures.map_key("key"),
        "<b>How to read the maps.</b> Time runs to the right, a line per bin, DC at the bottom. Each cell is one frame "
        "judged by the compiled core, drawn "
        f"over its central half; colour is its margin t* over the threshold {replayer.threshold:.4g} "
        f"(1/{replayer.threshold:.4g} = {1 / replayer.threshold:.2g} is t* = 1, where "
        "the fitted bounds just explain the frame). Screened cells counted, but held so little excitation that even a "
        "vehicle that does not respond would "
        "have passed: they are no evidence for the model. Patterned cells were not judged, for the reason in the key; "
        "blank: no frame. Triangles: alarms, at "
        "the end of the falsifying frame, pointing back to its cell; from above: alarms of the energy test. Below: speed, with the model's range dashed, and "
        "the monitor's verdict. In the alarm tables |E| and |Z| are "
        "Euclidean norms in output units (energy test, below, between or above its corners: |E| of F e, |Z| of F W<sub>Δ</sub> ŷ with forgetting, B<sub>w</sub> is σ), and evidence is the margin of a vehicle that does not respond. Judged seconds "
        "lie in a counted frame of any "
        "bin, with evidence or not; the verdict “valid” asks for evidence within the longest frame, so a drive can be "
        "judged all along and its verdict "
        "still be “not judged”.",
    )
    return f"<h2>Margin over time and frequency, drive by drive</h2>{key}{''.join(found.sections)}"


# ------------------------------------------------------------------------------------------------- evaluation


def _energy(test: EnergyTest, project: Project) -> str:
    """Settings and numbers of the energy test in a sentence."""
    c = test.calibration
    return (
        f"corners {', '.join(f'{f:g}' for f in test.band_hz[:-1])} and {test.band_hz[-1]:g} Hz, memory {test.memory_s:g} s, above them {test.memories_s[-1]:.3g} s and the constant {test.above:.3g} for W<sub>Δ</sub>, judged {test.settle * test.Ts:.3g} s after entering "
        f"the range; σ: {escape(test.sigma_text(project))}; {len(test.directions)} direction(s); W<sub>Δ</sub> as a filter proved above its bound on the circle "
        f"|z| = {test.rho:.6g} (least ratio {test.certificate['min_ratio']:.9g}); threshold {c.threshold:.4g}: {c.claim()}"
    )


def _detectors(detectors: dict[str, Column], best: list[str] | None = None) -> str:
    """False alarms and found faults, a column per detector (titles are text); ``best``: who leads, per
    fault."""
    return _table(
        ["", *map(escape, detectors), *(["best"] if best else [])],
        [[escape(cell) for cell in row] for row in detector_rows(list(detectors.values()), best)],
    )


def _evaluation_section(evaluation: dict) -> str:
    alarms = _table(
        [
            "drivers",
            "alarmed drives",
            f"alarmed {PIECE_S:g} s pieces",
            "95 % interval of the ratio",
            "alarmed pieces an hour judged",
            "judged, h",
        ],
        [
            [
                escape(group),
                f"{row['alarmed_drives']} of {row['drives']}",
                f"{row['alarmed']} of {row['pieces']}",
                "–" if row["interval"] is None else f"{row['interval'][0]:.3f} to {row['interval'][1]:.3f}",
                "–" if row["per_judged_h"] is None else f"{row['per_judged_h']:.2f}",
                f"{row['judged_h']:.3f}",
            ]
            for group, row in evaluation["false_alarms"].items()
        ],
    )
    tests = {MONITOR: "both tests", "frame": "frame test", "energy": "energy test"}
    claims = _table(
        ["calibration", "what its threshold promises"],
        [
            *(
                [f"{tests[t]}, as identified", escape(claim)]
                for t, claim in evaluation["claims"]["identified"].items()
            ),
            *(
                [
                    f"{tests[t]}{' at one threshold' if t == MONITOR else ''}, each drive without itself",
                    escape("; or ".join(several)),
                ]
                for t, several in evaluation["claims"]["left_one_out"].items()
            ),
        ],
        "words",
    )
    drives = _table(
        [
            "drive",
            "driver",
            *(f"{title}: threshold without it, score" for title in tests.values()),
            "alarmed pieces",
            "last piece, s",
            "judged, s",
            "of in-range, excited time",
            "faults from, s",
        ],
        [
            [
                escape(r["run"]),
                escape(r["driver"]),
                *(f"{r['calibration'][t]['threshold']:.3f}, {_number(r['scores'][t], 4)}" for t in tests),
                f"{r['alarmed'][MONITOR]} of {r['pieces']}",
                f"{r['last_piece_s']:.1f}",
                f"{r['judged_s']:.1f}",
                "–" if r["judged_of_in_range_excited"] is None else f"{r['judged_of_in_range_excited']:.0%}",
                ", ".join(f"{s:.0f}" for s in r["fault_starts_s"]) or "–",
            ]
            for r in evaluation["drives"]
        ],
    )
    left_out = "; ".join(f"{escape(n)}: {escape(why)}" for n, why in evaluation["left_out"].items())
    without = "; ".join(f"{escape(n)}: {escape(why)}" for n, why in evaluation["without_faults"].items())
    titles = {MONITOR: OURS, EXPORTED: "as exported, each test at its threshold"} | {
        t: f"{t} test alone" for t in TESTS
    }
    detectors, rates = columns(evaluation), evaluation["stated_rates"]
    exported = (
        f"as exported the two thresholds together allow at most {rates[EXPORTED]:g}"
        if rates[EXPORTED] is not None
        else "of the two thresholds as exported nothing is stated either"
    )
    figure = ""
    if any(row["cases"] for row in evaluation["faults"]):
        figure = _figure(
            pictures.time_to_find("f7", evaluation["faults"], FOUND_WITHIN_S),
            f"<b>Time to find.</b> A mark per start in a drive: judged, excited driving from the fault's start to the alarm that it caused. "
            f"Crosses: not within {FOUND_WITHIN_S:g} s (dashed). Times below {pictures.SOONEST_S:g} s stand there. Right: found of all.",
        )
    tried = len(evaluation["drives"]) - len(evaluation["without_faults"])
    return f"""<h2>Evaluation, leave one drive out</h2>
<p>Every drive that did not set the bounds runs through the compiled core with thresholds from
{escape(evaluation["threshold_rule"])}. Every second of a drive counts, judged or not: in pieces of {PIECE_S:g} s, of which the last
is as long as its column says, and in drives. The rate is alarmed pieces an hour of judged driving. The interval
resamples drives, not pieces: pieces of one drive are not exchangeable. Drives that the identification left out: {left_out or "none"}.</p>
{claims}<h3>False alarms</h3>{alarms}{drives}<h3>Injected faults</h3>
<p>Injected into {tried} of {len(evaluation["drives"])} drives, those longer than {SHORTEST_FOR_FAULTS_S:g} s, from {STARTS} instants of each after {FAULT_FROM_S:g} s, drawn so that
{FOUND_WITHIN_S:g} s of judged, excited driving follow. Found: the first alarm from then on comes within {FOUND_WITHIN_S:g} s of such driving and
before any that the same detector raises on the untouched drive; an alarm counts when the core says so, which for a frame is after its
end. A cell: starts from which the fault was found, of all (drives in which from every start), and the median time, a miss counting as
later than all. Not into {without or "none left"}.</p>{figure}{_detectors({title: detectors[name] for name, title in titles.items()})}
<p>Both tests at one threshold (an alarm by either counts) and each test alone are compared
{escape(equal_rates({titles[name]: rates[name] for name in (MONITOR, *TESTS)}))}; {exported}.</p>{_baselines(evaluation)}"""


def _baselines(evaluation: dict) -> str:
    others, detectors, rates = evaluation["baselines"], columns(evaluation), evaluation["stated_rates"]
    if not others:
        return "<h3>Beside what is used today</h3><p>Not compared: a baseline needs another calibration drive when one is left out.</p>"
    titles = {MONITOR: "lpvguard"} | {b["kind"]: b["title"] for b in others}
    searched = "; ".join(
        f"{escape(b['title'])}: {len(b['searched'])} settings, chosen "
        f"{escape(', '.join(sorted({c['parameters'] for c in b['chosen'].values()})))}, "
        f"{escape('; or '.join(sorted({c['claim'] for c in b['chosen'].values()})))}"
        for b in others
    )
    best = [", ".join(titles[n] for n in row["best"]) for row in evaluation["faults"]]
    lost = [
        f"{escape(row['fault'])} ({escape(who)})"
        for row, who in zip(evaluation["faults"], best, strict=False)
        if row["best"] and row["best"] != [MONITOR]
    ]
    return f"""<h3>Beside what is used today</h3>
<p>Three detectors on the same residual e = y − ŷ, the same drives, and thresholds from the same calibration drives by the same
rule as the monitor with both tests at one threshold. They are compared {escape(equal_rates({title: rates[name] for name, title in titles.items()}))}. Their parameters are those
that find most injected faults, then soonest, on the bound-setting and the other calibration drives; the drive under test takes part in
nothing ({searched}). Best: largest share of starts, then least median; detectors that tie are all named, and nobody where nobody
found a fault. Where the monitor does not lead alone: {"; ".join(lost) or "nowhere"}.</p>
{_detectors({OURS: detectors[MONITOR]} | {b["title"]: detectors[b["kind"]] for b in others}, best)}"""


# ----------------------------------------------------------------------------------------------------- step 8


def _design_section(folder: Path) -> str:
    controller = artefacts.read_json(folder / "controller.json")["certificates"]
    speeds = _table(
        ["speed, m/s", "μ upper", "μ lower", "peak, rad/s"],
        [
            [_number(r["v_mps"], 4), f"{r['mu_upper']:.4f}", f"{r['mu_lower']:.4f}", _number(r["peak_rad_s"])]
            for r in controller["speeds"]
        ],
        "tight",
    )
    text = f"""<h2>Controller and its certificates</h2>
<p>{escape(controller["structure"])} scheduled over speed, {controller["order"]} states: {escape(controller["claim"])}.</p>{speeds}"""
    if not (folder / "table2.json").is_file():
        return text
    table, figures = (artefacts.read_json(folder / name) for name in ("table2.json", "figures.json"))
    rows = _table(
        [
            "Table II",
            "A<sub>t</sub>",
            "A<sub>u</sub>",
            "μ upper",
            "μ lower",
            "no controller below",
            "order",
            "before reduction",
            "peak, rad/s",
        ],
        [
            [
                escape(r["structure"]),
                _number(r["A_t"], 4),
                _number(r["A_u"]),
                f"{r['mu_upper']:.4f}",
                f"{r['mu_lower']:.4f}",
                f"{r['floor']:.4f}",
                str(r["order"]),
                str(r["full_order"]),
                _number(r["peak_rad_s"]),
            ]
            for r in table["rows"]
        ],
    )
    drawn = draw(figures)
    text += f"""<h3>Table II for these drives</h3>
<p>At {table["speed_mps"]:g} m/s, sampled every {
        table["Ts_s"]:g} s, one sample of delay. μ upper is certified over all frequencies
(K<sub>∞</sub>: the closed-loop norm); K<sub>is</sub> takes state uncertainty with Λ<sub>ν</sub> = diag(1, {
        table["lambda_s"]:g} s²), its
bounds from the {
        escape(table["state_uncertainty_from"])
    }. “No controller below” bounds every controller of any order with these
weights.</p>{rows}{
        _figure(
            drawn["fig5"],
            "<b>Counterpart of Fig. 5.</b> Weights of the control problem: left what normalises signals, "
            "right the objectives of Table II.",
        )
    }"""
    if "fig6" not in figures:
        return text
    run = figures["fig6"]
    measured = _table(
        [
            "controller",
            "A<sub>t</sub>",
            "A<sub>u</sub>",
            "‖Δ‖∞",
            "Δ exact at, rad/s",
            "gain with Δ",
            "without Δ",
            "tracking error with Δ, rad/s rms",
            "without Δ",
        ],
        [
            [
                escape(r["structure"]),
                _number(r["A_t"], 4),
                _number(r["A_u"]),
                _number(r["delta_norm"]),
                _number(r["delta_rad_s"]),
                f"{r['worst_gain']:.4f}",
                f"{r['nominal_gain']:.4f}",
                _number(r["tracking_rms"]),
                _number(r["tracking_rms_without_delta"]),
            ]
            for r in run["runs"]
        ],
    )
    left = (
        f" Left out, as no objective of theirs has μ below 1: {', '.join(run['left_out'])}."
        if run["left_out"]
        else ""
    )
    return (
        text
        + _figure(
            drawn["fig6"],
            (
                f"<b>Counterpart of Fig. 6.</b> Reference: the filtered yaw rate of {escape(run['drive'])} through W<sub>R</sub>. Disturbance: that "
                f"drive's nominal error, the yaw rate's times {run['factor']:.2g} (it keeps the DC bound), band-limited noise of power "
                f"{run['noise_power']:g} before W<sub>n</sub>. K<sub>∞</sub> runs without Δ; K<sub>i</sub> and K<sub>is</sub> with the worst Δ found by the lower "
                f"bound of μ within the band of the data, realised as a stable system of constant size.{left}"
            ),
        )
        + measured
    )


def _tradeoff_section(folder: Path) -> str:
    found = artefacts.read_json(folder / "tradeoff.json")
    rows = _table(
        [
            "structure",
            "ceiling",
            "ν̄ at the lowest bin",
            "at the highest",
            "λ<sub>s</sub>, s²",
            "worst μ",
            "no controller below",
            "largest γ<sub>w</sub>",
        ],
        [
            [
                escape(r["structure"]),
                r["ceiling"],
                _number(r["nu_low"]),
                _number(r["nu_high"]),
                _number(r["lambda_s"]),
                _number(r["mu_worst"], 4),
                _number(r["floor"], 4),
                _number(r["gamma_w_max"]),
            ]
            for r in found["rows"]
        ],
    )
    return f"""<h2>Trade-off between uncertainty, disturbance and performance</h2>
<p>{escape(found["sentence"])}</p>{
        _figure(
            pictures.tradeoff_front("t", found),
            "Left: the optimum over speeds for uniform ceilings on ν, and the level below which no controller goes. Right: ceiling, uncertainty and "
            f"disturbance bound of the best candidate and of the project's setting. Bounds from the {escape(found['frames'])}; “–”: the floor alone "
            "ruled the candidate out.",
        )
    }{rows}"""


# ------------------------------------------------------------------------------------------------ closed loop


def _loop_section(folder: Path) -> str:
    results = artefacts.read_json(folder / "results.json")
    table = _table(
        [
            "scenario",
            "controller",
            "seed",
            "expected",
            "verdict at the end",
            "first invalid, s",
            "judged s from the fault to it",
            "largest margin",
            "tracking error / command, rms",
            "frames",
            "as expected",
        ],
        [
            [
                escape(r["scenario"]),
                r["controller"],
                str(r["seed"]),
                escape(r["expected"]["verdict"].replace("_", " ")),
                r["verdict_final"].replace("_", " "),
                _number(r["first_invalid_s"], 4),
                _number(r["judged_to_invalid_s"]),
                _number(r["max_margin"]),
                f"{r['tracking_rms'] / r['command_rms']:.1%}" if r["command_rms"] else "–",
                str(r["frames"]),
                _yes(not r["missed"], "yes", escape("; ".join(r["missed"]))),
            ]
            for r in results
        ],
    )
    figures = []
    for index, r in enumerate(results):
        stem = folder / f"{r['scenario']}-{r['seed']}"
        rows, frames = (
            np.genfromtxt(f"{stem}.{kind}.csv", delimiter=",", names=True, ndmin=1)
            for kind in ("telemetry", "frames")
        )
        figures.append(
            _figure(
                pictures.closed_loop(
                    f"l{index}", rows, frames, r["threshold"], r["expected"].get("fault_start_s")
                ),
                f"<b>{escape(r['title'])}</b> (seed {r['seed']}). Top: what the command filtered by the reference model asks for, "
                "and the simulated truck's true yaw rate. Middle: the pressure difference the ECU demands. Bottom: the margin of "
                "every counted frame as the ECU's monitor judged it; above the dashed line no one complex number within "
                "W_delta and no disturbance within B_w, both times the threshold, explain the frame in its bin. Dotted: the fault begins.",
            )
        )
    return f"""<h2>The closed loop over CAN frames</h2>
<p>Simulated truck, its bus encoded and decoded frame by frame, and the compiled ECU loop: model, monitor and controller, as they
go on the target. The truck shares no equation with the nominal model.</p>{table}{"".join(figures)}"""


# --------------------------------------------------------------------------------------------------- campaign


def _campaign_section(c: dict) -> str:
    names, within, tests = c["detectors"], c["within"], c["within"]["tests"]
    faulty, healthy = c["supervision"]["faulty"], c["supervision"]["healthy"]

    def share(rate: dict) -> str:
        if not rate["of"]:
            return "–"
        return f"{rate['count']} of {rate['of']}, {100 * rate['interval'][0]:.2f} to {100 * rate['interval'][1]:.2f} %"

    def percent(value: float | None) -> str:
        return "–" if value is None else f"{100 * value:.2f} %"

    def hourly(rate: dict) -> str:
        return (
            "–"
            if rate["interval"] is None
            else f"{rate['rate']:.2f}, {rate['interval'][0]:.2f} to {rate['interval'][1]:.2f}"
        )

    def best(detectors: list[str]) -> str:
        return escape(", ".join(names[d] for d in detectors))

    matched, stated = escape(c["matched_claim"]), c["matched_stated"]
    overall = _table(
        ["", *map(escape, names.values())],
        [
            [
                "runs within the bounds that alarm, 95 % interval",
                *(share(within["alarmed"][d]) for d in names),
            ],
            ["visible faults found in time, 95 % interval", *(share(c["visible"][d]) for d in names)],
            [
                "average found, calibrated thresholds",
                *(f"{c['average'][d]['calibrated']:.1%}" for d in names),
            ],
            [f"average found, {matched}", *(f"{c['average'][d]['matched']:.1%}" for d in names)],
            [
                "at the latter thresholds a further run alarms",
                *(COUNTS_ONLY if stated[d] is None else f"at most {stated[d]:.3g}" for d in names),
            ],
        ],
    )
    alarms = _table(
        [
            "test of the monitor",
            "runs within the bounds that alarm, 95 % interval",
            "calibrated to at most",
            "with 95 % confidence below",
            "such runs an hour, 95 % interval",
            "calibrated to at most",
            "alarms in all",
        ],
        [
            [
                t,
                share(r),
                percent(limit["alpha"]),
                percent(limit["conditional_bound"]),
                hourly(r["per_hour"]),
                _number(limit["per_hour"]),
                str(r["alarms"]),
            ]
            for t, r, limit in ((t, r, c["calibrated"][t]) for t, r in tests.items())
        ],
    )
    kinds = _table(
        [
            "kind",
            *(f"{escape(n)}: calibrated; {matched}" for n in names.values()),
            "best, calibrated",
            f"best, {matched}",
        ],
        [
            [
                escape(k["kind"]),
                *(f"{k['found'][d]:.0%}, {k['matched'][d]:.0%}" for d in names),
                best(k["best"]),
                best(k["best_matched"]),
            ]
            for k in c["kinds"]
        ],
    )
    severities = _table(
        [
            "kind",
            "severity",
            "t* of its own response",
            "mu of its loop",
            "runs",
            "visible runs",
            *(f"{escape(n)}: found, median s" for n in names.values()),
        ],
        [
            [
                escape(s["kind"]),
                f"{s['severity']:g} {escape(c['units'][s['kind']])}",
                _number(s["response_margin"]),
                _level(s),
                str(s["runs"]),
                str(s["visible_runs"]),
                *(f"{s['found'][d]}, {_number(s['median_s'][d])}" for d in names),
            ]
            for s in c["severities"]
        ],
    )
    hidden = "; ".join(
        f"{escape(s['kind'])} {s['severity']:g} {escape(c['units'][s['kind']])} (mu {_level(s)}, found {s['found']['monitor']} of {s['runs']})"
        for s in c["invisible"]
    )
    beaten = "; ".join(
        f"{escape(names[b['detector']])} on {escape(b['kind'])}, {b['matched']:.0%} against {b['monitor']:.0%}"
        for b in c["beaten"]
    )
    bus = _table(
        [
            "fault",
            "severity",
            "runs as required",
            "reactions due, met",
            "not live for",
            "judged",
            "runs that alarm",
            "visible runs",
        ],
        [
            [
                escape(s["kind"]),
                f"{s['severity']:g} {escape(c['units'][s['kind']])}",
                f"{s['as_required']} of {s['runs']}",
                f"{s['due']}, {s['met']}",
                f"{s['away']:.1%}",
                f"{s['judged']:.0%}",
                str(s["alarmed"]["monitor"]),
                str(s["visible_runs"]),
            ]
            for s in c["bus"]
        ],
    )
    baselines = ", ".join(escape(b["label"]) for b in c["baselines"])
    return f"""<h2>Campaign in the closed loop</h2>
<p>{within["runs"]} runs, {within["hours"]:.1f} h of driving ({within["judged_hours"]:.1f} h judged), of {
        within["plants"]
    } trucks whose own frequency
response lies within the bounds (of {within["candidates"]} drawn; largest t* {
        within["largest_margin"]:.3f}, the nominal truck's
{within["nominal_margin"]:.3f}), and {
        sum(s["runs"] for s in c["severities"])
    } runs with a fault of the truck. Intervals are exact, over runs
(Clopper and Pearson; an hour: Poisson), since alarms of one run come together.
Calibrated per drive: {
        "; ".join(f"{escape(t)} test: {escape(limit['claim'])}" for t, limit in c["calibrated"].items())
    }. Counted apart: runs of these trucks with a frame that held more demand in its bin
than their response was checked for (alarmed: {
        share(within["beyond_checked_amplitude"])
    }). A fault is <i>visible</i> in a run when off-line t* is at least 1.5 times the threshold in a
tenth of the excited frames after it; that uses nothing the monitor says. Of the alarms that were due by the bounds,
{share(c["due"])} came in time.</p>
{overall}{alarms}
<p>Baselines ({
        baselines
    }) run on the same samples with thresholds from the same calibration drives by the same rule. Those drives are of one
truck, so on trucks that differ from it within the bounds their rate is not the same: “{matched}” takes for
every detector the least threshold with which the same rule allows its alarms both in the runs within the bounds and before the faults.</p>
{
        _figure(
            pictures.detection("c0", c["severities"], c["units"], names, "matched"),
            f"<b>Detection against severity</b>, {matched}: share of runs in which the first alarm came within 60 s of "
            "judged, excited driving after the fault, and none before it. Grey: share of runs in which the fault is visible.",
        )
    }
{
        _figure(
            pictures.detection("c1", c["severities"], c["units"], names, "found"),
            "<b>Detection against severity</b>, at the thresholds calibrated on the drives of the identification.",
        )
    }
{
        _figure(
            pictures.detection_time("c2", c["severities"], c["units"], names),
            "<b>Time to the first alarm against severity</b>, at these thresholds: median judged, excited time over the runs without an alarm "
            "before the fault; no point where half of them never alarmed.",
        )
    }
<h3>Kinds of fault</h3>{kinds}<p>Where a baseline wins, {matched}: {
        beaten or "nowhere"
    }.</p><h3>Severities</h3>{severities}
<h3>Invisible, though robust performance is lost</h3><p>Upper bound of mu of the faulted loop at least 1, visible in fewer than half of the runs:
{
        hidden or "none"
    }. Some are found all the same, by the energy test or in single frames; nothing promises it. The largest mu over three speeds is meant; it exists for faults that are linear and time-invariant.</p>
<h3>Faults of the bus</h3><p>What the supervision must say at every tick follows from the frames that were on the bus and the message table:
three missed periods hold, five switch off, so does a score of five bad frames, and five good ones bring back. That is worked out
apart from the core. As required were {share(faulty["as_required"])} of the runs with a faulty bus, where of {
        faulty["due"]
    } reactions due
{faulty["met"]} came at the very tick, and {
        share(healthy["as_required"])
    } of those within the bounds, with none due. <i>Judged</i> is excited driving that the monitor judged, of the time since the fault: after every
gap its model has to settle. Alarms of model error stand beside the runs in which the samples themselves show one: a late or corrupted
value that passes for a good one.</p>{bus}"""


def _level(severity: dict) -> str:
    return _number(severity["mu_upper"]) if severity["loop_stable"] else "unstable"
