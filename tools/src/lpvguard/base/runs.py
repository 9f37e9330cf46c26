"""Runs of True in a row of flags."""

import numpy as np


def runs(mask: np.ndarray) -> np.ndarray:
    """Find every run of True.

    Parameters
    ----------
    mask : ndarray (N,) of bool

    Returns
    -------
    ndarray (R, 2), first index and the one after the last, rising
    """
    return np.flatnonzero(np.diff(np.r_[0, mask.astype(np.int8), 0])).reshape(-1, 2)
