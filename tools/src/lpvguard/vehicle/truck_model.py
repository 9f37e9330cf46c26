"""The paper's nominal truck at one frozen speed, any speed and wheelbase: continuous, exact zero-order hold,
frequency response. Equations and Table I stand in vehicle/shipped/truck.toml, with the brakes' lag as a last
state; here the input is the brake pressure itself, as in the paper.

The state is ``[r, delta, delta_dot]``: yaw rate [rad/s], road-wheel angle [rad], its rate [rad/s]. The input
is the brake pressure difference [bar], right minus left. The outputs are ``[r, delta]``; left is positive.

>>> a, b = zoh(speed_mps=5.0, wheelbase_m=3.6, ts_s=0.005)
>>> float(round(a[0, 0], 12))
0.950430911794
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from lpvguard.base.errors import InputError
from lpvguard.vehicle.nominal import state_space
from lpvguard.vehicle.project import load_project

_MODEL = load_project("truck").model

C = np.array(_MODEL.C)[:, :3]
"""Output matrix (2, 3): yaw rate and steering angle are measured."""


def _positive(value: float, name: str, unit: str) -> float:
    number = float(value)
    if not np.isfinite(number) or number <= 0.0:
        raise InputError("truck model", name, repr(value), f"a finite positive number in {unit}")
    return number


def continuous(speed_mps: float, wheelbase_m: float) -> tuple[np.ndarray, np.ndarray]:
    """State matrix A(v) (3, 3) and input matrix B (3, 1) of section IV.

    Raises InputError for a speed or wheelbase that is not finite and positive, and for a speed at which the
    model is unstable. The paper's parameters turn unstable at high speed. Both errors name the speed.
    """
    v = _positive(speed_mps, "v", "m/s")
    length = _positive(wheelbase_m, "wheelbase", "m")
    parameters = _MODEL.parameters | {"l": length}
    whole = state_space(_MODEL.model_copy(update={"parameters": parameters}), v, "truck model")[0][0]
    a, b = whole[:3, :3], whole[:3, 3:]
    pole = float(np.max(np.linalg.eigvals(a).real))
    if pole >= 0.0:
        raise InputError(
            "truck model", f"v = {v:g} m/s", f"unstable, pole at {pole:.3g} 1/s", "a stable speed"
        )
    return a, b


def zoh(speed_mps: float, wheelbase_m: float, ts_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Exact zero-order hold: A_d (3, 3) and B_d (3, 1), by one exponential of the augmented matrix."""
    a, b = continuous(speed_mps, wheelbase_m)
    ts = _positive(ts_s, "Ts", "s")
    phi = expm(np.block([[a, b], [np.zeros((1, 4))]]) * ts)
    return phi[:3, :3], phi[:3, 3:]


def frequency_response(speed_mps: float, wheelbase_m: float, ts_s: float, omega_rad_s) -> np.ndarray:
    """G(e^{j omega Ts}) of the zero-order-hold model: complex, shape of ``omega_rad_s`` + (2,), rad/s and rad
    per bar.

    Frequencies above Nyquist are refused: there the sampled model only repeats itself.
    """
    a_d, b_d = zoh(speed_mps, wheelbase_m, ts_s)
    omega = np.asarray(omega_rad_s, dtype=float)
    if not np.all(np.isfinite(omega)) or np.any(omega < 0.0) or np.any(omega * ts_s > np.pi * (1 + 1e-12)):
        raise InputError("truck model", "omega", f"{omega_rad_s!r}", f"0 to pi/Ts = {np.pi / ts_s:.6g} rad/s")
    # z - 1 and A_d - I are formed without cancellation, so DC and 1e-3 rad/s keep full accuracy.
    half = 0.5 * omega * ts_s
    z_minus_1 = 2j * np.sin(half) * np.exp(1j * half)
    lhs = z_minus_1[..., None, None] * np.eye(3) - (a_d - np.eye(3))
    return (C @ np.linalg.solve(lhs, np.broadcast_to(b_d.astype(complex), (*omega.shape, 3, 1))))[..., 0]
