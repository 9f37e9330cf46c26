"""Which trucks lie within the bounds by their own frequency response, and mu of the loops with a fault.

G is the truck's measured response to sines of RESPONSE_AMPLITUDES_BAR, at the bins and at RESPONSE_SPEEDS,
on a flat road without wind (`plant response`). P is the nominal response, and U is CHECKED_AMPLITUDE_BAR in
every bin. A truck is within the bounds when t* of E = (G - P)U, Z = PU is at most 1.

The disturbance bound used here leaves out the share W_n that zero-input driving needs. Then a frame whose
input stays below U in its bin is explained by some |delta| <= W_delta, road, wind and sensors included. Runs
with a frame of larger input are counted apart. Nothing here uses what the monitor says.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import InputError
from ...base.parallel import Map
from ...control.design import faulted_performance
from ...drives.frames import Estimator
from ...engine.validation import s1
from ...identify.run import Progress, StoredIdentification
from ...vehicle.nominal import NominalModel
from ..response import frequency_response
from . import faults
from .scenarios import draw_variation

PLANTS = 24
"""Trucks within the bounds that share the runs "within"."""
RESPONSE_SPEEDS = (8.3, 12.0, 17.0, 21.7)
RESPONSE_AMPLITUDES_BAR = (0.5, 1.5)
CHECKED_AMPLITUDE_BAR = 0.75
"""More than the frames of nearly all runs within hold; the others are counted apart. Bounds found from drives
say nothing of a demand that the drives did not hold: at 1.5 bar, of one frequency, the nominal truck itself
leaves them by a third, at 0.5 to 0.7 rad/s."""
LOOP_SPEEDS = (8.5, 15.0, 21.5)
"""Where mu of a faulted loop is computed; the largest is stated."""


@dataclass(frozen=True)
class WeightMagnitudes:
    """Magnitudes of an identification's weights, which a truck's frequency response is held against.

    omega (K,): the bins [rad/s]. W_delta (K, n_delta). B_w (K, n_y): the share W_n (K, n_y) included.
    """

    omega: np.ndarray
    W_delta: np.ndarray
    B_w: np.ndarray
    W_n: np.ndarray

    @classmethod
    def of(cls, stored: StoredIdentification, estimator: Estimator) -> WeightMagnitudes:
        """The weights at the bins, inflation included. InputError where it has no zero-input drives."""
        fitted = stored.fitted
        if not fitted.W_n:
            raise InputError(
                stored.folder,
                "W_n",
                "missing: no drive of the noise split",
                "an identification with zero-input drives",
            )
        return cls(
            estimator.omega,
            *fitted.at(estimator.omega),
            fitted.inflation * np.column_stack([w.magnitude(estimator.omega) for w in fitted.W_n]),
        )


def response_margin(
    model: NominalModel,
    weights: WeightMagnitudes,
    tables: str,
    demand_bar: float | np.ndarray = CHECKED_AMPLITUDE_BAR,
) -> float:
    """Largest t* of a truck's own frequency response over speeds, amplitudes and bins; see the module's
    docstring.

    ``tables``: its variation and faults, as scenario tables. ``demand_bar``: |U| that the frames may hold,
    for all bins or (K,). 1 or less: within the bounds.
    """
    U = np.broadcast_to(demand_bar, weights.omega.shape)[:, None]
    left, worst = np.maximum(weights.B_w - weights.W_n, 1e-12), 0.0
    for v in RESPONSE_SPEEDS:
        for amplitude in RESPONSE_AMPLITUDES_BAR:
            omega, G = frequency_response(tables, v, amplitude, weights.omega)
            P = model.frequency_response(omega, v)[..., 0]
            worst = max(worst, float(s1.margin((G - P) * U, P * U, weights.W_delta, left).max()))
    return worst


def plants(
    model: NominalModel, weights: WeightMagnitudes, seed: int, workers: Map, progress: Progress
) -> dict[str, Any]:
    """Trucks within the bounds, in the order drawn until there are PLANTS, and t* of every faulted truck that
    has a response."""
    margin = partial(response_margin, model, weights)
    candidates: list[dict[str, Any]] = []
    while sum(c["margin"] <= 1 for c in candidates) < PLANTS:
        tables = [draw_variation(seed, len(candidates) + i) for i in range(8)]
        if len(candidates) >= 20 * PLANTS:
            raise InputError(
                "campaign",
                "within",
                f"{len(candidates)} trucks drawn, too few within the bounds",
                f"{PLANTS} that are",
            )
        for t, value in zip(tables, workers(margin, tables), strict=False):
            progress(f"frequency response of truck {len(candidates)}")
            candidates.append({"tables": t, "margin": value})
    chosen = [(kind, x) for kind in faults.KINDS if kind.response for x in kind.values]
    faulted = []
    for (kind, x), value in zip(
        chosen, workers(margin, [k.text(x, start_s=0.0) for k, x in chosen]), strict=False
    ):
        progress(f"frequency response, {kind.name} {x:g}")
        faulted.append({"kind": kind.name, "severity": x, "margin": value})
    return {"nominal": margin(""), "candidates": candidates, "faulted": faulted}


def loop_levels(stored: StoredIdentification, controller: Path, progress: Progress) -> list[dict[str, Any]]:
    """Upper bound of mu of the certified loop with each linear fault in it, largest over LOOP_SPEEDS; None
    where it is not stable."""
    found = []
    linear = [(kind, x, kind.loop) for kind in faults.KINDS if kind.loop for x in kind.values]
    for kind, x, loop in linear:
        progress(f"mu, {kind.name} {x:g}")
        applied, measured = loop(x, stored.project.Ts_s)
        levels = [faulted_performance(controller, stored, v, applied, measured) for v in LOOP_SPEEDS]
        found.append(
            {
                "kind": kind.name,
                "severity": x,
                "stable": bool(np.isfinite(max(levels))),
                "mu_upper": max(levels) if np.isfinite(max(levels)) else None,
            }
        )
    return found
