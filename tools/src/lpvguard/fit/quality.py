"""Quality of a model on drives: variance accounted for, gain and residual tests, by drive and by speed.

    VAF_j = 1 - var(y_j - yhat_j) / var(y_j)

over the judged samples. A VAF below 0 is worse than no model. Residual tests are those of Ljung, System
Identification, 2nd ed., 16.6, on whitened residuals. They correlate them with their own past, and with the
past of the model's output. Both are given in standard deviations of white residuals, the largest over the
lags.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from ..drives.tables import Drive, missing_words
from ..vehicle.nominal import NominalModel
from .noise import Whitening
from .stretches import judged_samples

LAGS_S = 1.0
"""Residuals are tested at lags up to this."""
PASSED = 4.0
"""A test is passed below this many standard deviations, the largest of some fifty lags."""
POOR_VAF = 0.9
"""A model below it is called poor."""
CELLS = 4
"""Speed cells, each with the same number of judged samples."""


@dataclass(frozen=True)
class Quality:
    """Quality of a model on some samples.

    Attributes
    ----------
    name : str
    judged_s : float, s
    speed_mps : tuple[float, float], m/s, least and largest
    vaf, gain : ndarray (n_y,)
    variance : ndarray (n_y,), of the outputs, output units squared
    whiteness, left_by_input : ndarray (n_y,), standard deviations, NaN without a noise model
    missing : int, missing samples of the drive
    """

    name: str
    judged_s: float
    speed_mps: tuple[float, float]
    vaf: np.ndarray
    gain: np.ndarray
    variance: np.ndarray
    whiteness: np.ndarray
    left_by_input: np.ndarray
    missing: int = 0

    def to_dict(self) -> dict:
        """Plain values, as in fit.json."""
        return {
            "name": self.name,
            "judged_s": self.judged_s,
            "speed_mps": self.speed_mps,
            "vaf": self.vaf,
            "gain": self.gain,
            "variance": self.variance,
            "whiteness": self.whiteness,
            "left_by_input": self.left_by_input,
        }


def quality(
    name: str, v: np.ndarray, y: np.ndarray, yhat: np.ndarray, Ts: float, whitening: list[Whitening]
) -> Quality:
    """Quality on judged samples: v (N,) [m/s], y and yhat (N, n_y); Ts [s]. NaN where it is undefined."""
    n_y = y.shape[1]
    vaf, gain, white, left = (np.full(n_y, np.nan) for _ in range(4))
    variance = y.var(axis=0) if len(y) else np.zeros(n_y)
    for j in range(n_y):
        if len(v) < 3 or not np.var(y[:, j]) > 0:
            continue
        e = y[:, j] - yhat[:, j]
        vaf[j] = 1.0 - np.var(e) / np.var(y[:, j])
        if np.var(yhat[:, j]) > 0:
            gain[j] = np.cov(y[:, j], yhat[:, j])[0, 1] / np.var(yhat[:, j], ddof=1)
        if whitening:
            white[j], left[j] = _residual_tests(e, yhat[:, j], whitening[j].a, round(LAGS_S / Ts))
    speeds = (float(v.min()), float(v.max())) if len(v) else (np.nan, np.nan)
    return Quality(name, len(v) * Ts, speeds, vaf, gain, variance, white, left)


def _residual_tests(e: np.ndarray, yhat: np.ndarray, a: np.ndarray, lags: int) -> tuple[float, float]:
    """Largest correlation of the whitened residual with its past and with that of the model's output, in
    standard deviations."""
    n = lfilter(a, [1.0], e)[len(a) - 1 :]
    z = lfilter(a, [1.0], yhat)[len(a) - 1 :]
    n, z = (x - x.mean() for x in (n, z))
    if len(n) < 4 * lags or not (n.any() and z.any()):
        return np.nan, np.nan
    own = [np.dot(n[k:], n[:-k]) for k in range(1, lags + 1)] / np.dot(n, n)
    scale = np.sqrt(np.dot(n, n) * np.dot(z, z))
    cross = [np.dot(n[k:], z[: len(z) - k]) for k in range(lags + 1)] / scale
    return float(np.abs(own).max() * np.sqrt(len(n))), float(np.abs(cross).max() * np.sqrt(len(n)))


def by_drive(
    model: NominalModel, drives: list[Drive], whitening: list[Whitening], trims: np.ndarray | None = None
) -> list[Quality]:
    """Quality of each drive; ``trims`` (n_drives, n_u) are less the common input_offset, or None."""
    qualities = []
    for i, d in enumerate(drives):
        u = d.u - np.nan_to_num(trims[i]) if trims is not None and trims.shape[1] else d.u
        qualities.append(of_drive(model, d, model.simulate(d.v, u, d.y[0]), whitening))
    return qualities


def of_drive(model: NominalModel, drive: Drive, yhat: np.ndarray, whitening: list[Whitening]) -> Quality:
    """Compute the quality of a model on one drive.

    Parameters
    ----------
    model : NominalModel
    drive : Drive
    yhat : ndarray (N, n_y), nominal output [output units]
    whitening : list of Whitening, one an output; without any, residuals are not tested

    Returns
    -------
    Quality
    """
    judged = judged_samples(model, drive.v)
    result = quality(drive.name, drive.v[judged], drive.y[judged], yhat[judged], model.Ts, whitening)
    return replace(result, missing=drive.missing_samples)


def by_speed(model: NominalModel, drives: list[Drive]) -> list[Quality]:
    """Quality on all drives together, in CELLS of speed.

    Residuals are not tested, because cells break the time axis.
    """
    parts = [
        (d.v[j], d.y[j], model.simulate(d.v, d.u, d.y[0])[j])
        for d in drives
        if (j := judged_samples(model, d.v)).any()
    ]
    if not parts:
        return []
    v, y, yhat = (np.concatenate(column) for column in zip(*parts, strict=True))
    edges = np.quantile(v, np.linspace(0, 1, CELLS + 1))
    cells = [(a, b) for a, b in pairwise(edges) if b > a]
    qualities = []
    for a, b in cells:
        at = (v >= a) & ((v < b) | (b == edges[-1]))
        qualities.append(quality(f"{a:.3g} to {b:.3g} m/s", v[at], y[at], yhat[at], model.Ts, []))
    return qualities


def gaps(qualities: list[Quality]) -> list[str]:
    """Word the missing samples, a line a drive with any.

    Parameters
    ----------
    qualities : list of Quality

    Returns
    -------
    list of str
    """
    return [missing_words(q.name, q.missing) for q in qualities if q.missing]


def pooled_vaf(qualities: list[Quality]) -> np.ndarray:
    """Compute the VAF of all samples together; a drive counts by its length and its variance.

    Parameters
    ----------
    qualities : list of Quality

    Returns
    -------
    ndarray (n_y,)
    """
    seconds = np.array([q.judged_s for q in qualities])[:, None]
    there = seconds * np.array([q.variance for q in qualities])
    left = there * (1 - np.nan_to_num(np.array([q.vaf for q in qualities])))
    with np.errstate(invalid="ignore", divide="ignore"):
        return 1 - left.sum(axis=0) / there.sum(axis=0)
