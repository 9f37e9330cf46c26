"""Runs of True in a row of flags."""

from __future__ import annotations

import numpy as np


def runs(mask: np.ndarray) -> np.ndarray:
    """First index and the one after the last (R, 2) of every run of True in ``mask`` (N,), rising."""
    return np.flatnonzero(np.diff(np.r_[0, mask.astype(np.int8), 0])).reshape(-1, 2)
