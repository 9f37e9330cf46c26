"""Physical ranges for kinds of vehicles on tyres, to check units and results."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

KindName = Literal["car", "truck", "model", "other"]
STANDARD_GRAVITY = 9.80665
"""m/s^2."""


def degrees_per_g(understeer: float) -> float:
    """Convert an understeer gradient to deg/g.

    Parameters
    ----------
    understeer : float, s^2/m, road-wheel angle per lateral acceleration

    Returns
    -------
    float, deg/g
    """
    return float(np.degrees(understeer) * STANDARD_GRAVITY)


@dataclass(frozen=True)
class VehicleKind:
    """Ranges of a kind of vehicle.

    Attributes
    ----------
    wheelbase_m : (low, high), m
    speed_mps : (low, high), m/s, of a log's 99th percentile
    ratio : (low, high) or None, steering wheel over road wheel, None without a steering wheel
    understeer_deg_g : (low, high), deg/g
    lag_s : (low, high), s, of the yaw rate behind the steering
    lateral_mps2, angle_rad : float, m/s^2 and rad, largest 99th percentile
    """

    wheelbase_m: tuple[float, float]
    speed_mps: tuple[float, float]
    ratio: tuple[float, float] | None
    understeer_deg_g: tuple[float, float]
    lag_s: tuple[float, float] = (0.02, 0.6)
    lateral_mps2: float = 12.0
    angle_rad: float = 0.8


KINDS: dict[KindName, VehicleKind] = {
    "car": VehicleKind((1.8, 4.0), (1.5, 70.0), (8.0, 25.0), (-1.0, 8.0)),
    "truck": VehicleKind((2.5, 9.0), (1.5, 40.0), (8.0, 30.0), (-2.0, 12.0)),
    "model": VehicleKind((0.05, 1.2), (0.3, 25.0), None, (-4.0, 20.0), (0.0, 0.6), 20.0),
    "other": VehicleKind((0.05, 20.0), (0.3, 90.0), (8.0, 30.0), (-4.0, 20.0), (0.0, 1.0), 20.0),
}


def kind_of(wheelbase_m: float | None) -> KindName:
    """Return the kind of vehicle that a wheelbase suggests.

    Parameters
    ----------
    wheelbase_m : float or None, m

    Returns
    -------
    str, a car if the wheelbase is None
    """
    if wheelbase_m is None or KINDS["car"].wheelbase_m[0] <= wheelbase_m <= KINDS["car"].wheelbase_m[1]:
        return "car"
    if wheelbase_m <= KINDS["model"].wheelbase_m[1]:
        return "model"
    return "truck" if 4.0 < wheelbase_m <= KINDS["truck"].wheelbase_m[1] else "other"
