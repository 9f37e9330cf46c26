"""Whether a fitted model is one that a vehicle of the stated kind can have."""

import numpy as np

from ..base.errors import InputError
from ..vehicle.nominal import NominalModel
from ..vehicle.physics import KINDS, degrees_per_g
from ..vehicle.project import Project


def require_plausible(project: Project) -> None:
    """Raise InputError where the model's steady turn or lag is beyond the kind that `[fit]` states. Only a
    model from one steering angle in rad to a yaw rate in rad/s is judged. It is judged by wheelbase and
    understeer, from ``v/G = L + K v^2`` over its speeds. It is also judged by its delay plus its slowest time
    constant."""
    kind = project.fit.kind
    if kind is None or [s.unit for s in (*project.inputs, *project.outputs)] != ["rad", "rad/s"]:
        return
    ranges, model = KINDS[kind], NominalModel(project)
    v = np.linspace(*model.speed_range, 20)
    length = v / model.dc_gain(v)[:, 0, 0]
    wheelbase, understeer = np.linalg.lstsq(np.column_stack((np.ones(len(v)), v**2)), length, rcond=None)[0]
    lag = project.model.input_delay_s + 1.0 / model.slowest_pole
    quantities = {
        "wheelbase": (float(wheelbase), ranges.wheelbase_m, "m"),
        "understeer": (degrees_per_g(float(understeer)), ranges.understeer_deg_g, "deg/g"),
        "delay and time constant": (lag, ranges.lag_s, "s"),
    }
    for what, (value, (least, most), unit) in quantities.items():
        if not least <= value <= most:
            raise InputError(
                f"vehicle {project.name}",
                f"[fit] kind = {kind}",
                f"{what} of {value:.3g} {unit}: no {kind} has that, as wrong units or columns make it",
                f"{least:g} to {most:g} {unit}, another kind, or --accept-unusual",
            )
