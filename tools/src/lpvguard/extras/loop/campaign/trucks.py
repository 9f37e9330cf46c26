"""Find the trucks within the bounds by their frequency response, and compute mu of the loops with a fault.

G is the truck's measured response to sines on a flat road without wind (`plant response`), with w = 0. It is
measured at OMEGA and RESPONSE_SPEEDS with the amplitudes RESPONSE_BAR. The last amplitude is reduced to the
lateral-acceleration limit. P is the nominal response. A truck is within the bounds if each output has

    |delta_j| = |G_j / P_j - 1| <= W_delta,j

at every measured point, with W_delta of the certificate. Speeds and demands of the runs lie in the checked
ranges (scenarios.py). The selection of trucks uses neither the monitor nor a run.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ....base.errors import InputError
from ....base.parallel import Map
from ....base.progress import Progress
from ....control.controller_file import faulted_performance
from ....control.true_loop import certified_weight, deviations, require_certified_by_W_delta, within_use
from ....identify.identification import StoredIdentification
from ....identify.weights import Weights
from ....vehicle.nominal import NominalModel
from ....vehicle.project import Project
from ..response import frequency_response
from . import faults
from .conduct import LEAST_BAR
from .scenarios import HIGHEST_COMMAND_RADPS, draw_variation

PLANTS = 24
"""Number of trucks within the bounds that share the runs "within"."""
RESPONSE_SPEEDS = (8.0, 12.0, 17.0, 22.0)
RESPONSE_BAR = (LEAST_BAR, 0.7, np.inf)
OMEGA = (np.geomspace(1.0, 60.0, 28), np.geomspace(0.02, 1.0, 12, endpoint=False))
"""[rad/s] Frequencies of the measurement. Slow ones are last, because they need most of the time, and because
most trucks beyond the bounds exceed them above 1 rad/s."""
LOOP_SPEEDS = (8.5, 15.0, 21.5)
"""Speeds at which mu of a loop with a fault is computed; the largest value counts."""


@dataclass(frozen=True)
class Distance:
    """Distance of a truck from the nominal model.

    ``ratio`` is the largest |delta_j| / W_delta,j. The measurement ends when the ratio exceeds 1. A ratio
    above 1 is therefore a lower bound. ``output``, ``omega_radps``, ``speed_mps`` and ``amplitude_bar`` tell
    where this ratio occurs. ``least_gain`` is the least |G_1/P_1| of a truck within the bounds, at the
    largest amplitude, up to the highest frequency of a command.
    """

    ratio: float
    output: str
    omega_radps: float
    speed_mps: float
    amplitude_bar: float
    least_gain: float | None


@dataclass(frozen=True)
class CertifiedSet:
    """Set of trucks of a certificate: a project's nominal model and its fitted weights."""

    project: Project
    fitted: Weights

    @classmethod
    def from_identification(cls, stored: StoredIdentification) -> CertifiedSet:
        """Make the set of an identification; raise InputError if its certificate needs more than W_delta."""
        require_certified_by_W_delta(stored)
        return cls(stored.project, stored.fitted)

    def distance(self, tables: str) -> Distance:
        """Measure the distance of the truck with these scenario tables, until it exceeds the bounds."""
        model, outputs = NominalModel(self.project), [signal.name for signal in self.project.outputs]
        worst, least_gain = Distance(0.0, outputs[0], 0.0, 0.0, 0.0, None), np.inf
        for v, amplitude, omegas in self._points(model):
            omega, G = frequency_response(tables, v, amplitude, omegas)
            ratio = G / model.frequency_response(omega, v)[..., 0]
            if amplitude == within_use(model, v, RESPONSE_BAR)[-1]:
                gain = np.abs(ratio[omega <= HIGHEST_COMMAND_RADPS, 0])
                least_gain = min(least_gain, float(gain.min()))
            W = certified_weight(self.fitted, model.Ts, omega)
            for d in deviations(outputs, omega, np.abs(ratio - 1), W):
                if d.ratio > worst.ratio:
                    worst = Distance(d.ratio, d.output, d.omega, v, amplitude, None)
            if worst.ratio > 1:
                return worst
        return replace(worst, least_gain=least_gain)

    def checked(self) -> dict[str, Any]:
        """Speeds (S,) [m/s], amplitudes (S, A) [bar] and frequencies (K,) [rad/s] of `distance`, for JSON."""
        model = NominalModel(self.project)
        return {
            "speeds_mps": list(RESPONSE_SPEEDS),
            "amplitudes_bar": [within_use(model, v, RESPONSE_BAR) for v in RESPONSE_SPEEDS],
            "omega_rad_s": sorted(np.concatenate(OMEGA).tolist()),
        }

    @staticmethod
    def _points(model: NominalModel) -> Iterator[tuple[float, float, np.ndarray]]:
        """Yield (speed, amplitude, frequencies) of every measurement."""
        for omega in OMEGA:
            for v in RESPONSE_SPEEDS:
                for amplitude in within_use(model, v, RESPONSE_BAR):
                    yield v, amplitude, omega


def plants(certified: CertifiedSet, seed: int, workers: Map, progress: Progress) -> dict[str, Any]:
    """Draw trucks until PLANTS of them are within the bounds; measure the trucks with faults, too."""
    candidates: list[dict[str, Any]] = []
    while sum(c["ratio"] <= 1 for c in candidates) < PLANTS:
        tables = [draw_variation(seed, len(candidates) + i) for i in range(8)]
        if len(candidates) >= 20 * PLANTS:
            raise InputError(
                "campaign",
                "within",
                f"{len(candidates)} trucks drawn, too few within the bounds",
                f"{PLANTS} that are",
            )
        for t, distance in zip(tables, workers(certified.distance, tables), strict=False):
            progress(f"frequency response of truck {len(candidates)}")
            candidates.append({"tables": t, **vars(distance)})
    chosen = [(kind, x) for kind in faults.KINDS if kind.response for x in kind.values]
    faulted = []
    texts = [k.text(x, "start") for k, x in chosen]
    for (kind, x), distance in zip(chosen, workers(certified.distance, texts), strict=False):
        progress(f"frequency response, {kind.name} {x:g}")
        faulted.append({"kind": kind.name, "severity": x, **vars(distance)})
    nominal = vars(certified.distance(""))
    return {"checked": certified.checked(), "nominal": nominal, "candidates": candidates, "faulted": faulted}


def loop_levels(stored: StoredIdentification, controller: Path, progress: Progress) -> list[dict[str, Any]]:
    """Largest upper bound of mu over LOOP_SPEEDS for each linear fault in the loop; None if unstable."""
    rows = []
    linear = [(kind, x, kind.loop) for kind in faults.KINDS if kind.loop for x in kind.values]
    for kind, x, loop in linear:
        progress(f"mu, {kind.name} {x:g}")
        applied, measured = loop(x, stored.project.Ts_s)
        levels = [faulted_performance(controller, stored, v, applied, measured) for v in LOOP_SPEEDS]
        rows.append(
            {
                "kind": kind.name,
                "severity": x,
                "stable": bool(np.isfinite(max(levels))),
                "mu_upper": max(levels) if np.isfinite(max(levels)) else None,
            }
        )
    return rows
