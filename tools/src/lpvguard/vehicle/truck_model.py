"""The paper's nominal truck model at a frozen speed, for any speed and wheelbase.

It gives the continuous model, the exact zero-order hold and the frequency response.
The equations and Table I are in vehicle/shipped/truck.toml, with the lag of the brakes as an additional
state. Here the input is the brake pressure, as in the paper.

The state is ``[r, delta, delta_dot]``: yaw rate [rad/s], road-wheel angle [rad], its rate [rad/s]. The input
is the brake pressure difference [bar], right minus left. The outputs are ``[r, delta]``; left is positive.

>>> a, b = zoh(speed_mps=5.0, wheelbase_m=3.6, ts_s=0.005)
>>> float(round(a[0, 0], 12))
0.950430911794
"""

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
    """Return A(v) and B of the truck's continuous model.

    The paper's parameters turn unstable at high speed.

    Parameters
    ----------
    speed_mps : float, m/s
    wheelbase_m : float, m

    Returns
    -------
    tuple of ndarray (3, 3) and (3, 1)

    Raises
    ------
    InputError
        If a value is not finite and positive, or the model is unstable at the speed.

    References
    ----------
    Paper, section IV.
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
    """Discretise the truck exactly by zero-order hold, with one exponential of the augmented matrix.

    Parameters
    ----------
    speed_mps : float, m/s
    wheelbase_m : float, m
    ts_s : float, s

    Returns
    -------
    tuple of A_d, ndarray (3, 3), and B_d, ndarray (3, 1)
    """
    a, b = continuous(speed_mps, wheelbase_m)
    ts = _positive(ts_s, "Ts", "s")
    phi = expm(np.block([[a, b], [np.zeros((1, 4))]]) * ts)
    return phi[:3, :3], phi[:3, 3:]


def frequency_response(speed_mps: float, wheelbase_m: float, ts_s: float, omega_rad_s) -> np.ndarray:
    """Return G(e^{j omega Ts}) of the zero-order-hold model.

    Parameters
    ----------
    speed_mps : float, m/s
    wheelbase_m : float, m
    ts_s : float, s
    omega_rad_s : array_like (...), rad/s

    Returns
    -------
    ndarray (..., 2) of complex, rad/s and rad per bar

    Raises
    ------
    InputError
        If a frequency is above Nyquist, where the sampled model repeats itself.
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
