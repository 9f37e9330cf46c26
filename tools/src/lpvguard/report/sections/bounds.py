"""Sections on the bounds: Fig. 2 (disturbance), Fig. 3 (weights), the model error model, and the Pareto
fronts between disturbance and uncertainty."""

from __future__ import annotations

from html import escape

import numpy as np

from ...drives.frames import Estimator
from ...engine.overbound.weight import Weight
from ...engine.validation import s1
from ...identify.bounds import FrameSet, explain, remainder
from ...identify.model_error import ASSUMED, beyond, claim, last_telling
from ...identify.premise import weight_met
from ...identify.run import StoredIdentification
from ...identify.weights import DC_STAND_IN, SMALLEST_NU, fitting_grid
from ..markup import captioned, unit_of_norm
from ..pictures.model_error import model_error
from ..pictures.over_bins import POINTS_PER_BIN, Clouds, disturbance_design, pareto, weights_over_bounds
from .summary import premise_of


def bound_sections(stored: StoredIdentification, estimator: Estimator) -> list[str]:
    """The four sections; each begins with its h2."""
    clouds, grid = _clouds(stored, estimator), fitting_grid(estimator)
    fine = np.geomspace(grid[0], 2 * grid[-1], 400)
    return [
        f"<h2>Disturbance bound</h2>{_disturbance(stored, estimator, clouds, grid, fine)}",
        f"<h2>Weights over the bounds</h2>{_weights(stored, estimator, clouds, grid, fine)}",
        f"<h2>Model error</h2>{_model_error(stored)}",
        f"<h2>Trade-off between disturbance and uncertainty</h2>{_front(stored, estimator)}",
    ]


def _clouds(stored: StoredIdentification, estimator: Estimator) -> Clouds:
    """Points of the frames of the bound-setting drives, on the frame grid of the core."""
    with np.load(stored.folder / "spectra.npz") as spectra:
        names = spectra["names"].tolist()
        setting = np.isin(spectra["drive"], [names.index(n) for n in stored.manifest["drives"]["bounds"]])
        columns = {key: spectra[key][setting] for key in ("bin", "start", "E", "Z")}
    clouds, structure = Clouds([], [], [], []), stored.project.bounds.structure
    W_delta = stored.fitted.at(estimator.omega)[0] / stored.fitted.inflation
    for k in range(estimator.n_bins):
        of_bin = columns["bin"] == k
        frames = FrameSet(
            k,
            columns["E"][of_bin],
            columns["Z"][of_bin],
            columns["start"][of_bin],
            str(stored.folder / "spectra.npz"),
        )
        size = np.linalg.norm(frames.E, axis=1)
        nu, _ = explain(frames, estimator, stored.bounds["gamma_w"], structure)
        w = remainder(frames, estimator, W_delta, structure)
        clouds.E.append(size)
        clouds.B1.append(s1.solve(frames.E, frames.Z, size).b1)
        clouds.nu.append(nu.reshape(len(nu), stored.project.n_delta))
        clouds.w.append(np.abs(w))
    return clouds


def _magnitude(entry: dict, omega: np.ndarray) -> np.ndarray:
    """|W| (N,) at ``omega`` (N,) [rad/s] of an entry of weights.json, without the inflation."""
    return Weight.from_dict(entry["weight"]).magnitude(omega)


def _data_words(bounds: dict[str, np.ndarray], grid: np.ndarray) -> str:
    """What the caption of Fig. 2 says of B1, of DC and of bins without frames."""
    without = int((~(bounds["frames"] > 0)).sum())
    gaps = (
        f" {without} bins without a counted frame are hatched: no information."
        if without
        else " Every bin has data."
    )
    if np.nanmax(bounds["B1"]) > 0:
        b1 = (
            "Green: the right side of (9) per frame and its maximum B<sub>1</sub>, the least disturbance "
            "that one δ common to all outputs leaves to explain."
        )
    else:
        b1 = (
            "B<sub>1</sub> is 0 in every bin and has no place on the logarithmic axis: with one output δ = "
            "E/Z explains any frame without a disturbance, so the ceiling alone decides the trade-off."
        )
    stars = (
        f"Stars: DC, standing at {grid[0]:.3g} rad/s ({DC_STAND_IN:g} of the lowest bin) for want of a "
        "place; the shaded gap between is below the lowest bin, where there is no information and only "
        "longer records help."
    )
    return f"{b1} {stars}{gaps}"


def _disturbance(
    stored: StoredIdentification, estimator: Estimator, clouds: Clouds, grid: np.ndarray, fine: np.ndarray
) -> str:
    """Counterpart of Fig. 2, and what its caption says of these data."""
    bounds = stored.bounds
    points = sum(len(c) for c in clouds.E)
    nu = np.fmax.reduce(bounds["nu"], axis=1)
    binding = np.nanargmax(
        np.where(estimator.cycles > 0, nu / np.maximum(bounds["nu_ceiling"], 1e-300), np.nan)
    )
    return captioned(
        disturbance_design(
            "f2",
            grid,
            clouds,
            bounds,
            _magnitude(stored.weights["gamma_w"], fine),
            fine,
            unit_of_norm(stored.project.outputs),
        ),
        f"<b>Counterpart of Fig. 2.</b> Grey: |E| of {points} frames of the "
        f"{len(stored.manifest['drives']['bounds'])} bound-setting drives on the monitor's frame grid, "
        f"thinned to about {POINTS_PER_BIN} a bin (the largest |E| kept). B<sub>2</sub>: their bound over "
        f"frames at every start ({int(bounds['frames'].sum())} frames), hence on or above all points. "
        "Circles: γ<sub>w</sub> that the rule asks for, max √(B<sub>1</sub>² + |Z|² max(0, |δ<sub>0</sub>| − "
        "ν̄)²), and at DC B<sub>2</sub>; line: the overbounding fit that is used. "
        f"{_data_words(bounds, grid)} Lower panel: the ceiling ν̄(ω) on the uncertainty, set beforehand in "
        "the project file, and what was needed in the end (closest to its ceiling at "
        f"{estimator.omega[binding]:.3g} rad/s: ν = {nu[binding]:.3g} of "
        f"{bounds['nu_ceiling'][binding]:.3g}). How to read it: γ<sub>w</sub> near B<sub>2</sub> blames the "
        "disturbance, γ<sub>w</sub> near B<sub>1</sub> blames the model.",
    )


def _weights(
    stored: StoredIdentification, estimator: Estimator, clouds: Clouds, grid: np.ndarray, fine: np.ndarray
) -> str:
    """Counterpart of Fig. 3, and what its caption says of these data."""
    bounds, weights, inflation = stored.bounds, stored.weights, stored.weights["inflation"]
    outputs, structure = stored.project.outputs, stored.project.bounds.structure
    points = sum(len(c) for c in clouds.E)
    needing = sum(int((c > 0).any(axis=1).sum()) for c in clouds.nu)
    noise = (
        "Dash-dotted: the sensor's weight |W<sub>n</sub>|, the bound of the zero-input drives; W<sub>w</sub> "
        "is what B<sub>w</sub> leaves without it (step 7)."
        if weights["W_n"]
        else "Without zero-input drives there is no noise weight: W<sub>w</sub> covers B<sub>w</sub>."
    )
    of_structure = {
        "S0": " Structure S0 allows no uncertainty: all error is disturbance.",
        "S1_diagonal": " Structure S1_diagonal: one Δ<sub>j</sub>, and one line, an output.",
    }.get(structure, "")
    return captioned(
        weights_over_bounds(
            "f3",
            grid,
            clouds,
            bounds,
            inflation * np.column_stack([_magnitude(w, fine) for w in weights["W_w"]]),
            inflation * np.column_stack([_magnitude(w, fine) for w in weights["W_n"]])
            if weights["W_n"]
            else None,
            fine,
            stored.fitted.W_delta,
            inflation,
            outputs,
        ),
        "<b>Counterpart of Fig. 3.</b> Left, per output: the disturbance |w<sub>j</sub>| that no |δ| ≤ "
        "W<sub>Δ</sub> explains, frame by frame, and its bound B<sub>w</sub> over every start (dashed). "
        f"Line: the weight |W<sub>w</sub>|, inflation {inflation:.6g} included. {noise} Right: the "
        f"uncertainty ν = min |δ| with |E − δZ| ≤ γ<sub>w</sub>; {needing} of {points} frames need any, the "
        "others (ν = 0) have no place on the axis. Dashed: what W<sub>Δ</sub> must cover, the larger of ν at "
        "the bins and of what the model error model asks for over its whole range (next section), at least "
        f"{SMALLEST_NU:g} as a weight must be positive; B<sub>w</sub> and ν are over every start, so they "
        f"can lie above the points of the monitor's grid. ν(0) = 0 by definition.{of_structure} How to read "
        "it: a line far above its dashed bound is conservatism of the fit, the worst stands among settings "
        "and proofs.",
    )


def _model_error(stored: StoredIdentification) -> str:
    """The model error model beside W_delta, and the premise of every certificate in a sentence."""
    project, error = stored.project, stored.model_error
    grid, names = error.grid.omega, [s.name for s in project.outputs]
    wide = np.geomspace(grid[0], grid[-1], 400)
    said = {b.output: b.reason for b in project.model_error.beyond}
    last = [None if k < 0 else float(grid[k]) for k in last_telling(error.setting)]
    W_delta = np.broadcast_to(weight_met(stored, wide), (len(wide), len(names)))
    svg = model_error(
        "model-error",
        error,
        wide,
        W_delta,
        last,
        beyond(project, error.grid),
        [said.get(name, ASSUMED) for name in names],
        names,
    )
    told = ", ".join(
        f"{escape(name)} {'nowhere' if w is None else f'to {w:.3g} rad/s'}"
        for name, w in zip(names, last, strict=True)
    )
    moved = error.setting.moved[np.isfinite(error.setting.se)]
    caption = (
        f"<b>Model error.</b> |δ<sub>c</sub>|, the part of the error that follows the input, in "
        f"{error.grid.cells[0]} speed cells and {error.grid.cells[1]} amplitude classes. "
        f"{escape(claim(project))}. Bars: k = {error.setting.k:.2f} standard errors, a simultaneous level of "
        "95 %; pale: k se is 1 or more, so a vehicle that does not respond would not have been refuted. "
        f"Doubling the frames moves {np.mean(moved < 1):.0%} of the estimates by less than their standard "
        f"error. Drives tell: {told}. Beyond, shaded, 1 + ρ is assumed for the reason that stands there. How "
        "to read it: the line must lie above the bars of the drives that set the bounds, and above the lower "
        "end of the others' bars."
    )
    return f"<p>{premise_of(stored)}</p>{captioned(svg, caption)}"


def _front(stored: StoredIdentification, estimator: Estimator) -> str:
    """Pareto front per bin; in words where there is none."""
    front, bounds = stored.front, stored.bounds
    if not np.isfinite(front["nu"]).any():
        return "<p>Structure S0 puts all error into the disturbance: there is nothing to trade.</p>"
    svg = pareto(
        "front",
        estimator.omega,
        front["gamma_w"],
        front["nu"],
        bounds,
        bounds["nu_ceiling"],
        unit_of_norm(stored.project.outputs),
    )
    return captioned(
        svg,
        (
            "<b>Pareto front.</b> The least uncertainty ν with which every frame of the bound-setting "
            "drives, at every start, is explained with a disturbance of at most γ<sub>w</sub>: exact at "
            f"{front['nu'].shape[1]} values of γ<sub>w</sub> a bin from B<sub>1</sub>, where the line ends "
            "on the left, to B<sub>2</sub>, where it meets 0. Everything below the line is falsified. Dot: "
            "the pair that was taken, by the ceiling (dashed) and the smoothing of γ<sub>w</sub> over the "
            "bins. How to read it: a dot on a steep part pays for a little less disturbance with much more "
            "uncertainty; vertical axes end at three times what was taken or allowed."
        ),
    )
