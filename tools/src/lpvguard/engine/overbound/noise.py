"""Subtract the noise of the sensors from the disturbance, step 7 of the paper (T9)."""

import numpy as np
from numpy.typing import ArrayLike

from ...base.errors import InputError
from .weight import Weight


def subtract_noise(
    B_w: Weight | ArrayLike,
    W_n: Weight | ArrayLike,
    omega: ArrayLike,
    *,
    disturbance_set: str,
    floor: ArrayLike,
) -> tuple[np.ndarray, list[float]]:
    """Subtract the magnitude of the sensor's noise from that of the disturbance (step 7).

    Parameters
    ----------
    B_w, W_n : Weight, or array_like (K,) of magnitudes, NaN in a bin without data
    omega : array_like (K,), rad/s
    disturbance_set : str, "paper" for |B_w| - |W_n|, or "covering" for sqrt(|B_w|^2 - |W_n|^2)
    floor : float or array_like (K,), > 0, least value of the result

    Returns
    -------
    tuple of ndarray (K,) and list of float
        The values, and the frequencies [rad/s] at which the floor replaces the difference.

    Raises
    ------
    InputError
        If magnitudes, floors or the set are invalid.

    References
    ----------
    Paper, step 7; THEORY 5.3, (T9).

    Examples
    --------
    >>> options = {"disturbance_set": "covering", "floor": 0.1}
    >>> values, lost = subtract_noise([5.0, 1.0], [3.0, 2.0], [1.0, 10.0], **options)
    >>> values.tolist(), lost
    ([4.0, 0.1], [10.0])
    """
    omega = np.asarray(omega, dtype=float)
    total, noise = (_magnitudes(what, value, omega) for what, value in (("B_w", B_w), ("W_n", W_n)))
    floor = np.broadcast_to(np.asarray(floor, dtype=float), omega.shape)
    if not np.all(np.isfinite(floor) & (floor > 0)):
        raise InputError(
            "noise subtraction",
            "floor",
            f"{floor[~(floor > 0) | ~np.isfinite(floor)][0]}",
            "a finite number > 0",
        )
    if disturbance_set == "paper":
        left = total - noise
    elif disturbance_set == "covering":
        left = np.copysign(np.sqrt(np.abs(total - noise) * (total + noise)), total - noise)
    else:
        raise InputError(
            "noise subtraction", "disturbance_set", f"{disturbance_set!r}", "'paper' or 'covering'"
        )
    return np.maximum(left, floor), omega[left <= 0].tolist()


def _magnitudes(what: str, value: Weight | ArrayLike, omega: np.ndarray) -> np.ndarray:
    if isinstance(value, Weight):
        return value.magnitude(omega)
    value = np.asarray(value, dtype=float)
    if value.shape != omega.shape:
        raise InputError(
            "noise subtraction", what, f"shape {value.shape}", f"the shape of omega, {omega.shape}"
        )
    wrong = np.flatnonzero((value < 0) | np.isinf(value))
    if wrong.size:
        raise InputError(
            "noise subtraction",
            f"{what} at {omega[wrong[0]]:g} rad/s",
            f"{value[wrong[0]]}",
            "a finite magnitude >= 0 or NaN",
        )
    return value
