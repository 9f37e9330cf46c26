"""Judged samples of a drive: in the model's speed range, with the initial state forgotten."""

import numpy as np

from ..drives.frames import settled
from ..drives.tables import Drive
from ..vehicle.nominal import NominalModel


def judged_samples(model: NominalModel, v: np.ndarray) -> np.ndarray:
    """(N,) True where the speed v (N,) [m/s] has been in the model's range for its settling time."""
    return settled(v, model.speed_range, model.settle_samples)


def stretches_of(mask: np.ndarray, shortest: int) -> list[slice]:
    """The runs of True in mask (N,) that hold at least ``shortest`` samples."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= shortest]


def liveliest(drive: Drive, samples: int) -> slice:
    """Find the stretch in which the outputs spread most.

    Parameters
    ----------
    drive : Drive
    samples : int, its length; a shorter drive is taken whole

    Returns
    -------
    slice
    """
    n = min(samples, len(drive.t))
    if n == len(drive.t):
        return slice(0, n)
    total = np.vstack([np.zeros(drive.y.shape[1]), np.cumsum(drive.y, axis=0)])
    squares = np.vstack([np.zeros(drive.y.shape[1]), np.cumsum(drive.y**2, axis=0)])
    spread = (squares[n:] - squares[:-n]) / n - ((total[n:] - total[:-n]) / n) ** 2
    first = int(np.argmax(np.sum(spread / np.maximum(drive.y.var(axis=0), 1e-300), axis=1)))
    return slice(first, first + n)
