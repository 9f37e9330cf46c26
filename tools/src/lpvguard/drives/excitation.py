"""Samples of a drive at which its input is excited."""

from __future__ import annotations

import numpy as np

from ..vehicle.project import Project
from .tables import Drive

EXCITED_WINDOW_S = 10.0


def excited_samples(u: np.ndarray, Ts: float, threshold: float) -> np.ndarray:
    """Mark the samples where an input is excited.

    Parameters
    ----------
    u : ndarray (N, n_u), input units
    Ts : float, s
    threshold : float, least standard deviation over the surrounding 10 s [input unit]

    Returns
    -------
    ndarray (N,) of bool

    References
    ----------
    THEORY 11.
    """
    half = round(EXCITED_WINDOW_S / Ts / 2)
    low = np.maximum(np.arange(len(u)) - half, 0)
    high = np.minimum(np.arange(len(u)) + half + 1, len(u))
    centred = u - u.mean(axis=0)  # the difference of running sums would cancel against a large mean
    sums, squares = (np.vstack([np.zeros(u.shape[1]), np.cumsum(x, axis=0)]) for x in (centred, centred**2))
    count = (high - low)[:, None]
    mean = (sums[high] - sums[low]) / count
    variance = (squares[high] - squares[low]) / count - mean**2
    return (np.sqrt(np.maximum(variance, 0.0)) > threshold).any(axis=1)


def excited(drive: Drive, project: Project) -> np.ndarray:
    """Mark the samples of a drive where a commanded input is excited. Disturbances do not count.

    Parameters
    ----------
    drive : Drive
    project : Project

    Returns
    -------
    ndarray (N,) of bool
    """
    u = drive.u[:, : len(project.actuators)]
    return excited_samples(u, project.Ts_s, project.frame_test.excited_std)
