"""Healthy set: W_delta and B_w of the frame test in each bin, as small as the drives allow (THEORY 7.16)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.sampling import Rows
from ..drives.frames import Estimator
from .bounds import FrameSet, remainder_sizes

CANDIDATES = np.r_[1e-3, np.geomspace(0.01, 2.0, 32)]
"""Candidate values of W_delta. The core needs a value above 0."""
TYPICAL = 90
"""Percentile of the excitation at which the candidates are compared."""
LARGEST_FACTOR = 1e3
"""Factor on a pair that no smaller factor makes cover a drive that is left out."""
TINY = 1e-300


@dataclass(frozen=True)
class HealthySet:
    """Bounds of the frame test at the bins: W_delta (K, n_delta) and B_w (K, n_y) [output units].

    They include ``factor`` (K, n_delta), which is at least 1. ``folds`` (K,) is the number of drives, or
    folds of drives, with frames in the bin.
    """

    W_delta: np.ndarray
    B_w: np.ndarray
    factor: np.ndarray
    folds: np.ndarray

    def to_dict(self) -> dict:
        """Convert to JSON types, for `from_dict`."""
        return vars(self).copy()

    @classmethod
    def from_dict(cls, data: dict) -> HealthySet:
        """Healthy set from the result of `to_dict`."""
        return cls(*(np.array(data[key], float) for key in ("W_delta", "B_w", "factor", "folds")))


def needed(frames: list[FrameSet], estimator: Estimator, n_delta: int, structure: str) -> np.ndarray:
    """B_w (K, P, n_y) that the ``frames`` of a drive need with each of P CANDIDATES; 0 without a frame."""
    n_y = frames[0].E.shape[1]
    out = np.zeros((estimator.n_bins, len(CANDIDATES), n_y))
    for s in frames:
        if not len(s.E):
            continue
        for p, W in enumerate(CANDIDATES):
            if n_y == 1 or n_delta > 1:  # this also holds at zero frequency
                sizes = s.sizes[0] - W * s.sizes[1]
            else:
                sizes = remainder_sizes(s, estimator, np.full((estimator.n_bins, n_delta), W), structure)
            out[s.bin, p] = np.maximum(sizes.max(axis=0), 0.0)
    return out


def healthy_set(
    needs: list[np.ndarray],
    spectra: Rows,
    floor: np.ndarray,
    typical: np.ndarray,
    largest: np.ndarray,
    within: np.ndarray | None = None,
) -> HealthySet:
    """The pair W_delta, B_w of every bin and Delta with the smallest visible gain error.

    Each of ``needs`` (K, P, n_y) is the result of `needed` for a drive or fold. ``spectra`` is a sample of
    their frames, with columns ``group`` (bin) and Z (F, n_y). ``floor`` (K, n_y) is the limit of the sensors.
    ``typical`` (K, n_delta) is the error of a further drive at typical speed and amplitude. ``largest`` (K,
    n_delta) is W_delta of the certificate, and ``within`` (K, n_y) its B_w, where given. The pair is at most
    that of the certificate.
    """
    each, (K, n_delta), n_y = np.array(needs), largest.shape, floor.shape[1]
    within = np.full(floor.shape, np.inf) if within is None else within
    outputs = [[j] for j in range(n_y)] if n_delta > 1 else [list(range(n_y))]
    W_delta, B_w, factor = np.zeros((K, n_delta)), floor.copy(), np.ones((K, n_delta))
    for k in range(K):
        Z = np.abs(spectra["Z"][spectra["group"] == k])
        for d, indices in enumerate(outputs):
            errors = float(typical[k, d]), float(largest[k, d]), within[k, indices]
            W, B, factor[k, d] = _best(each[:, k][:, :, indices], Z[:, indices], floor[k, indices], *errors)
            W_delta[k, d], B_w[k, indices] = W, B
    folds = each.any(axis=(2, 3)).sum(axis=0)
    # The threshold contains the factor that all bins share.
    factor = np.where(folds[:, None] > 0, factor / factor[folds > 0].min(initial=np.inf), 1.0)
    columns = factor if n_delta > 1 else np.repeat(factor, n_y, axis=1)
    scaled = np.minimum(factor * W_delta, np.maximum(W_delta, largest))
    return HealthySet(scaled, np.minimum(columns * B_w, np.maximum(B_w, within)), factor, folds)


def _best(
    each: np.ndarray, Z: np.ndarray, floor: np.ndarray, typical: float, largest: float, within: np.ndarray
) -> tuple[float, np.ndarray, float]:
    """W_delta, B_w (m,) and factor of one bin.

    ``each`` (D, P, m) are the needs of the drives, and Z (F, m) is |Z|.
    """
    needed = each[each.any(axis=(1, 2))]
    most = needed.max(axis=0, initial=0.0)
    B_of = np.maximum(most, floor)
    strongest = Z.max(axis=0, initial=0.0)
    reached = np.maximum(CANDIDATES, typical)
    further = _at(reached, B_of) + (reached - CANDIDATES)[:, None] * strongest
    pairs = [(W, B) for W, B in zip(CANDIDATES, B_of, strict=True) if largest >= W and (within >= B).all()]
    if np.isfinite(within).all():
        pairs.append((largest, within))
    best: tuple[float, float, np.ndarray, float] | None = None
    for W, B in pairs or [(CANDIDATES[0], B_of[0])]:
        factor = max(1.0, _least_factor(further, B, W))
        own = np.array([_at(W, drive) for drive in needed])
        # Without the drive with the largest need, the next one decides.
        for d in np.unique(own.argmax(axis=0)) if len(own) > 1 else ():
            rest = np.maximum(np.delete(own, d, axis=0).max(axis=0), floor)
            factor = max(factor, _least_factor(needed[d], rest, W))
        g = np.max(Z / np.maximum(B, TINY), axis=1) if len(Z) else np.zeros(1)
        visible = factor * (W + 1 / max(float(np.percentile(g, TYPICAL)), TINY))
        if best is None or visible < best[0]:
            best = visible, float(W), B, factor
    assert best is not None
    return best[1:]


def _at(W: float | np.ndarray, of_candidates: np.ndarray) -> np.ndarray:
    """Columns of ``of_candidates`` (P, m), interpolated at W: (m,) for a scalar W, (Q, m) for W (Q,)."""
    return np.stack([np.interp(W, CANDIDATES, column) for column in of_candidates.T], axis=-1)


def _least_factor(own: np.ndarray, B: np.ndarray, W: float) -> float:
    """Least s with own(s W) <= s B in every column, where ``own`` (P, m) is convex and falls with W."""
    low, high = 0.0, LARGEST_FACTOR
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if np.all(_at(middle * W, own) <= middle * B) else (middle, high)
    return high
