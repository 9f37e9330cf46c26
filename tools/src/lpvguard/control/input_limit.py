"""The controller's input limit over speed, from the actuator and the nominal lateral acceleration.

    |u_k|_max(v) = min(input_max_k, a_max / (n_u v |G_1k(0; v)|))

G_1k(0; v) [rad/s per input unit] is the nominal model's DC gain from input k to the controlled output, the
yaw rate. Inputs held at their limits, with any signs, give v |yaw rate| <= a_max in the steady state. By the
triangle inequality, each of the n_u inputs may take an equal share. The rule limits changes of the input. It
ignores offsets of the model, transients and the model error.

The core interpolates linearly between nodes. Where the rule falls as 1 / v^2, it is convex in v, so a line
between two of its values lies above the rule. Each node's limit is therefore reduced by the smallest factor
that keeps both adjacent lines below the rule.
"""

import numpy as np

from ..vehicle.design_settings import DesignSettings
from ..vehicle.nominal import NominalModel

POINTS = 1024
"""Number of points between two nodes at which the line is compared with the rule."""
ROOM = 1e-5
"""Share of the rule that is used. The rest is a margin for speeds between the points and for float rounding
in the core."""


def turning_limit(model: NominalModel, a_max: float, v: np.ndarray, controlled: int = 0) -> np.ndarray:
    """Compute the input limit of the lateral acceleration, ``a_max / (n_u v |G_1k(0; v)|)``.

    Speeds v (m,) are in m/s and ``a_max`` in m/s^2. The result (m, n_u) [input unit] is inf for an input that
    does not turn the vehicle.
    """
    with np.errstate(divide="ignore"):
        return a_max / (model.n_u * v[:, None] * np.abs(model.dc_gain(v)[:, controlled]))


def rule(model: NominalModel, settings: DesignSettings, v: np.ndarray, controlled: int = 0) -> np.ndarray:
    """Rule for |u|_max (m, n_u) [input unit] at speeds v (m,) [m/s]; without a_max it is input_max."""
    input_max = np.tile(np.array(settings.input_max), (len(v), 1))
    if settings.lateral_acceleration_max_mps2 is None:
        return input_max
    return np.minimum(input_max, turning_limit(model, settings.lateral_acceleration_max_mps2, v, controlled))


def input_limit(
    model: NominalModel, settings: DesignSettings, speeds: np.ndarray, controlled: int = 0
) -> np.ndarray:
    """Compute |u|_max (G, n_u) [input unit] at ascending nodes ``speeds`` (G,) [m/s].

    The lines between the nodes stay below `rule`.
    """
    nodes = rule(model, settings, speeds, controlled)
    weight = np.linspace(0.0, 1.0, POINTS + 1)
    between = speeds[:-1, None] + weight * np.diff(speeds)[:, None]
    exact = rule(model, settings, between.ravel(), controlled).reshape(*between.shape, -1)
    line = nodes[:-1, None] + weight[:, None] * np.diff(nodes, axis=0)[:, None]
    below_input_max = (exact < np.array(settings.input_max)).any(axis=1)
    factor = np.where(below_input_max, (1 - ROOM) * (exact / line).min(axis=1), 1.0)
    return nodes * np.minimum(np.vstack([factor[:1], factor]), np.vstack([factor, factor[-1:]]))
