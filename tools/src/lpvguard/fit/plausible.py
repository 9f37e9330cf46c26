"""Whether a fitted model is one that a vehicle of the stated kind can have."""

from collections.abc import Sequence

import numpy as np

from ..base.errors import InputError
from ..vehicle.nominal import NominalModel
from ..vehicle.physics import KINDS, degrees_per_g
from ..vehicle.project import Project

DOUBT = 2.0
"""Standard errors by which an unknown may be other than fitted."""


def require_plausible(project: Project, doubtful: Sequence[Project] = ()) -> None:
    """Raise InputError where the model's steady turn or lag is beyond the kind that `[fit]` states. Only a
    model from one steering angle in rad to a yaw rate in rad/s is judged. It is judged by wheelbase and
    understeer, from ``v/G = L + K v^2`` over its speeds. It is also judged by its delay plus its slowest time
    constant. ``doubtful`` are models with one unknown at an end of its confidence interval. The drives do not
    exclude what one of them has within a range."""
    kind = project.fit.kind
    if kind is None or [s.unit for s in (*project.actuators, *project.outputs)] != ["rad", "rad/s"]:
        return
    ranges = KINDS[kind]
    judged = {
        "wheelbase": (ranges.wheelbase_m, "m"),
        "understeer": (ranges.understeer_deg_g, "deg/g"),
        "delay and time constant": (ranges.lag_s, "s"),
    }
    own_values, others = _values(project), [_values(other) for other in doubtful]
    for k, (what, ((least, most), unit)) in enumerate(judged.items()):
        values = np.array([own_values[k], *(other[k] for other in others)])
        if values.max() < least or values.min() > most:
            raise InputError(
                f"vehicle {project.name}",
                f"[fit] kind = {kind}",
                f"{what} of {own_values[k]:.3g} {unit}: no {kind} has that, as wrong units or columns "
                "make it",
                f"{least:g} to {most:g} {unit}, another kind, or --accept-unusual",
            )


def _values(project: Project) -> tuple[float, float, float]:
    """Wheelbase [m], understeer [deg/g] and lag [s] of a model."""
    model = NominalModel(project)
    v = np.linspace(*model.speed_range, 20)
    length = v / model.dc_gain(v)[:, 0, 0]
    wheelbase, understeer = np.linalg.lstsq(np.column_stack((np.ones(len(v)), v**2)), length, rcond=None)[0]
    lag = project.model.input_delay_s + 1.0 / model.slowest_pole
    return float(wheelbase), degrees_per_g(float(understeer)), lag
