"""Sections on the bounds: Fig. 2 (disturbance), Fig. 3 (weights), model error model, Pareto fronts."""

from html import escape

import numpy as np

from ...drives.frames import Estimator
from ...identify.identification import StoredIdentification
from ...identify.model_error import claim, last_telling
from ...identify.weights import DC_STAND_IN, SMALLEST_NU
from ..identification_pictures import IdentificationPictures
from ..markup import captioned
from ..pictures.over_bins import POINTS_PER_BIN
from .summary import premise_of


def bound_sections(drawn: IdentificationPictures) -> list[str]:
    """The four sections; each begins with its h2."""
    stored, estimator = drawn.stored, drawn.estimator
    return [
        f"<h2>Disturbance bound</h2>{_disturbance(stored, estimator, drawn)}",
        f"<h2>Weights over the bounds</h2>{_weights(stored, drawn)}",
        f"<h2>Model error</h2>{_model_error(stored, drawn)}",
        f"<h2>Trade-off between disturbance and uncertainty</h2>{_front(stored, drawn)}",
    ]


def _data_words(bounds: dict[str, np.ndarray], grid: np.ndarray) -> str:
    """Part of Fig. 2's caption about B1, DC and bins without frames."""
    without = int((~(bounds["frames"] > 0)).sum())
    gaps = (
        f" {without} bins without a counted frame are hatched: no information."
        if without
        else " Every bin has data."
    )
    if np.nanmax(bounds["B1"]) > 0:
        b1 = (
            "Green: the right side of (9) per frame and its maximum B<sub>1</sub>. This is the least "
            "disturbance that remains with one δ for all outputs."
        )
    else:
        b1 = (
            "B<sub>1</sub> is 0 in every bin and is not drawn, because the axis is logarithmic. With one "
            "output, δ = E/Z explains any frame without a disturbance. The ceiling alone sets the trade-off."
        )
    stars = (
        f"Stars: DC, drawn at {grid[0]:.3g} rad/s ({DC_STAND_IN:g} of the lowest bin). The shaded gap is "
        "below the lowest bin. There is no information in the gap; only longer records help."
    )
    return f"{b1} {stars}{gaps}"


def _disturbance(stored: StoredIdentification, estimator: Estimator, drawn: IdentificationPictures) -> str:
    """The picture that corresponds to Fig. 2, with its caption."""
    bounds = stored.bounds
    points = sum(len(c) for c in drawn.clouds.E)
    nu = np.fmax.reduce(bounds["nu"], axis=1)
    binding = np.nanargmax(
        np.where(estimator.cycles > 0, nu / np.maximum(bounds["nu_ceiling"], 1e-300), np.nan)
    )
    stated = stored.project.bounds.nu_ceiling is not None
    source = "set beforehand in the project file" if stated else "the band of a further drive's model error"
    return captioned(
        drawn.disturbance("f2"),
        f"<b>Counterpart of Fig. 2.</b> Grey: |E| of {points} frames of the "
        f"{len(stored.manifest['drives']['bounds'])} bound-setting drives on the monitor's frame grid, "
        f"reduced to about {POINTS_PER_BIN} per bin (the largest |E| are kept). B<sub>2</sub>: the bound of "
        f"|E| over frames at every start ({int(bounds['frames'].sum())} frames). It lies on or above all "
        "points. Circles: γ<sub>w</sub> by the rule, max √(B<sub>1</sub>² + |Z|² max(0, |δ<sub>0</sub>| − "
        "ν̄)²), and B<sub>2</sub> at DC. Line: the fit above them, which is used. "
        f"{_data_words(bounds, drawn.grid)} Lower panel: the ceiling ν̄(ω) on the uncertainty, {source}, and "
        "the needed uncertainty (closest to its ceiling at "
        f"{estimator.omega[binding]:.3g} rad/s: ν = {nu[binding]:.3g} of "
        f"{bounds['nu_ceiling'][binding]:.3g}). How to read it: if γ<sub>w</sub> is near B<sub>2</sub>, "
        "disturbance explains the error. If it is near B<sub>1</sub>, model error explains it.",
    )


def _weights(stored: StoredIdentification, drawn: IdentificationPictures) -> str:
    """The picture that corresponds to Fig. 3, with its caption."""
    weights, inflation = stored.weights, stored.weights["inflation"]
    clouds, structure = drawn.clouds, stored.project.bounds.structure
    points = sum(len(c) for c in clouds.E)
    needing = sum(int((c > 0).any(axis=1).sum()) for c in clouds.nu)
    noise = (
        "Dash-dotted: the sensor's weight |W<sub>n</sub>|, the bound of the zero-input drives. "
        "W<sub>w</sub> covers B<sub>w</sub> minus this noise (step 7)."
        if weights["W_n"]
        else "Without zero-input drives there is no noise weight: W<sub>w</sub> covers B<sub>w</sub>."
    )
    of_structure = {
        "S0": " Structure S0 allows no uncertainty: all error is disturbance.",
        "S1_diagonal": " Structure S1_diagonal: one Δ<sub>j</sub> and one line per output.",
    }.get(structure, "")
    return captioned(
        drawn.weights("f3"),
        "<b>Counterpart of Fig. 3.</b> Left, per output: the disturbance |w<sub>j</sub>| of each frame that "
        "no |δ| ≤ W<sub>Δ</sub> explains, and its bound B<sub>w</sub> over every start (dashed). "
        f"Line: the weight |W<sub>w</sub>|, inflation {inflation:.6g} included. {noise} Right: the "
        f"uncertainty ν = min |δ| with |E − δZ| ≤ γ<sub>w</sub>; {needing} of {points} frames need it. "
        "Frames with ν = 0 are not drawn. Dashed: what W<sub>Δ</sub> must cover. This is the maximum of ν at "
        "the bins and of the bound of the model error model over its range (next section). It is at least "
        f"{SMALLEST_NU:g}, because a weight must be positive. B<sub>w</sub> and ν use every start, so they "
        f"can lie above the points of the monitor's grid. ν(0) = 0 by definition.{of_structure} How to read "
        "it: a line far above its dashed bound shows that the fit is conservative. The section on settings "
        "and proofs states the worst ratio.",
    )


def _model_error(stored: StoredIdentification, drawn: IdentificationPictures) -> str:
    """Model error model together with W_delta, and one sentence on the premise of every certificate."""
    project, error = stored.project, stored.model_error
    names = [s.name for s in project.outputs]
    last = [None if k < 0 else float(error.grid.omega[k]) for k in last_telling(error.setting)]
    reach = ", ".join(
        f"{escape(name)} {'nowhere' if w is None else f'to {w:.3g} rad/s'}"
        for name, w in zip(names, last, strict=True)
    )
    moved = error.setting.moved[np.isfinite(error.setting.se)]
    caption = (
        f"<b>Model error.</b> |δ<sub>c</sub>|, the part of the error that follows the input, in "
        f"{error.grid.cells[0]} speed cells and {error.grid.cells[1]} amplitude classes. "
        f"{escape(claim(project))}. Bars: k = {error.setting.k:.2f} standard errors, a simultaneous level of "
        "95 %. Pale: k se is 1 or more, so a vehicle that does not respond would not have been refuted. "
        f"Doubling the frames moves {np.mean(moved < 1):.0%} of the estimates by less than their standard "
        f"error. Drives are informative: {reach}. Beyond (shaded), 1 + ρ is assumed for the stated reason. "
        "How to read it: the line must lie above the bars of the drives that set the bounds, and above the "
        "lower end of all other bars."
    )
    return f"<p>{premise_of(stored)}</p>{captioned(drawn.model_error('model-error'), caption)}"


def _front(stored: StoredIdentification, drawn: IdentificationPictures) -> str:
    """Pareto front per bin, or a sentence if there is none."""
    front, shown = stored.front, drawn.front("front")
    if shown is None:
        return "<p>Structure S0 puts all error into the disturbance, so there is no trade-off.</p>"
    return captioned(
        shown,
        (
            "<b>Pareto front.</b> The least uncertainty ν that explains every frame of the bound-setting "
            "drives, at every start, with a disturbance of at most γ<sub>w</sub>: exact at "
            f"{front['nu'].shape[1]} values of γ<sub>w</sub> per bin, from B<sub>1</sub> (left end of the "
            "line) to B<sub>2</sub> (ν = 0). Every pair below the line is falsified. Dot: the chosen pair, "
            "by the ceiling (dashed) and the smoothing of γ<sub>w</sub> over bins. How to read it: at a dot "
            "on a steep part, a little less disturbance costs much more uncertainty. Vertical axes end at "
            "three times the chosen or allowed value."
        ),
    )
