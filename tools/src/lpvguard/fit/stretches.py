"""Judged samples of a drive: in the model's speed range, with the initial state forgotten."""

from dataclasses import replace

import numpy as np

from ..drives.frames import settled
from ..drives.tables import Drive
from ..vehicle.nominal import NominalModel

FEW, OF_A_DRIVE = 50_000, (6_000, 12_500)
"""Samples with which a fit begins where there are more, and fewest and most of a longer drive among them."""


def judged_samples(model: NominalModel, v: np.ndarray) -> np.ndarray:
    """(N,) True where the speed v (N,) [m/s] has been in the model's range for its settling time."""
    return settled(v, model.speed_range, model.settle_samples)


def stretches_of(mask: np.ndarray, shortest: int) -> list[slice]:
    """The runs of True in mask (N,) that hold at least ``shortest`` samples."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= shortest]


def few_stretches(model: NominalModel, drives: list[Drive]) -> list[Drive]:
    """Choose stretches of about FEW samples; the list itself where all drives together have no more.

    The drives are at equal steps in the order of their mean speeds. The stretch of
    a drive is where its judged outputs spread most. It begins with the time that forgets the initial state.
    """
    if sum(len(d.t) for d in drives) <= FEW:
        return drives
    judged = {id(d): judged_samples(model, d.v) for d in drives}
    by_speed = sorted((d for d in drives if judged[id(d)].any()), key=lambda d: (float(np.mean(d.v)), d.name))
    usual = float(np.mean([min(len(d.t), OF_A_DRIVE[0]) for d in by_speed]))
    count = min(len(by_speed), max(1, round(FEW / usual)))
    chosen = np.linspace(0, len(by_speed) - 1, count).round().astype(int)
    samples = int(np.clip(FEW // count, *OF_A_DRIVE))
    few = []
    for d in (by_speed[i] for i in chosen):
        at = judged[id(d)]
        there = replace(d, y=np.where(at[:, None], d.y, d.y[at].mean(axis=0)))
        lively = liveliest(there, samples)
        s = slice(max(0, lively.start - model.settle_samples), lively.stop)
        few.append(Drive(d.name, d.t[s], d.v[s], d.u[s], d.y[s]))
    return few


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
