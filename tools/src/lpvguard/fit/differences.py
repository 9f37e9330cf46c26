"""Parameters of each drive and of each day beside those of all: do they differ by more than their errors?

A drive's own parameters follow from those of all by one Gauss-Newton step on its whitened residuals. A day's
step takes the residuals of all its drives. The errors come from scores over short blocks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from ..base.rates import recordings_for
from ..drives.tables import day_of
from .estimate import Estimate, Fit
from .unknowns import DELAY

BLOCK_S = 3.0
"""Length of the blocks whose scores tell a drive's errors."""
BLOCKS_AN_UNKNOWN = 3
"""Fewest blocks of a drive for each unknown; a shorter drive says nothing."""
BY_CHANCE = 1e-3
"""Probability of a warning where nothing differs, over all unknowns."""
LEAST = 0.05
"""Least difference that counts, as a share of the value; of a delay, half a sample."""
WORST_CONDITION = 1e12
"""Condition of a drive's normal equations beyond which it cannot tell its parameters apart."""
_ALPHAS = (0.2, 0.1, 0.05, 0.02, 0.01)


@dataclass(frozen=True)
class _Own:
    """Own parameters (p,) of a drive or day, with their variances (p,)."""

    name: str
    theta: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True)
class _Sums:
    """Sums over the m blocks of a drive: J^T J (m, p, p), J^T r (m, p), and its number of residuals."""

    products: np.ndarray
    slopes: np.ndarray
    samples: int

    @classmethod
    def of_blocks(cls, r: np.ndarray, J: np.ndarray, count: int) -> _Sums:
        """Sums of residuals r (n,) and derivatives J (n, p) over ``count`` blocks."""
        blocks = list(zip(np.array_split(r, count), np.array_split(J, count), strict=True))
        return cls(np.array([j.T @ j for _, j in blocks]), np.array([j.T @ x for x, j in blocks]), len(r))


def differences(fit: Fit, estimate: Estimate, groups: Mapping[str, str]) -> list[str]:
    """Name the parameters that differ between drives, and between groups, by more than their errors.

    ``groups`` holds the group by drive; drives without one have the date in their name. The test is that of
    Cochran, The combination of estimates from different experiments, Biometrics 10, 1954.
    """
    compared = [
        i
        for i, name in enumerate(estimate.unknowns.names)
        if "offset" not in name and name not in estimate.unknowns.at_end(estimate.theta)
    ]
    names = [estimate.unknowns.names[i] for i in compared]
    values = np.abs(estimate.theta[compared])
    least = [0.5 * fit.Ts if n == DELAY else LEAST * x for n, x in zip(names, values, strict=True)]
    of_drives = [
        _Sums.of_blocks(r, J[:, compared], max(1, round(len(r) / fit.n_y * fit.Ts / BLOCK_S)))
        for r, J in zip(fit.residuals(estimate.theta), fit.derivatives(estimate.theta), strict=True)
    ]
    parts: dict[str, dict[str, list[int]]] = {"drives": {}, "days or groups": {}}
    for k, drive in enumerate(fit.drives):
        parts["drives"][drive.name] = [k]
        if group := groups.get(drive.name) or day_of(drive.name):
            parts["days or groups"].setdefault(group, []).append(k)
    sentences = []
    for what, members in parts.items():
        own = [
            one
            for name, at in sorted(members.items())
            if (one := _own(fit, name, estimate.theta[compared], [of_drives[k] for k in at]))
        ]
        sentences += _sentences(what, own, names, least)
    return sentences


def _own(fit: Fit, name: str, theta: np.ndarray, parts: list[_Sums]) -> _Own | None:
    """Own parameters of drives; None for too short ones."""
    products, slopes = (np.concatenate(x) for x in zip(*((p.products, p.slopes) for p in parts), strict=True))
    H = products.sum(axis=0)
    seconds = sum(p.samples for p in parts) / fit.n_y * fit.Ts
    if seconds < BLOCK_S * BLOCKS_AN_UNKNOWN * len(theta) or np.linalg.cond(H) > WORST_CONDITION:
        return None
    inverse = np.linalg.inv(H)
    step = -inverse @ slopes.sum(axis=0)
    s = slopes + products @ step
    spread = s.T @ s * len(s) / (len(s) - len(theta))
    return _Own(name, theta + step, np.diag(inverse @ spread @ inverse))


def _sentences(what: str, own: list[_Own], names: list[str], least: list[float]) -> list[str]:
    """A sentence for each parameter that differs, by Cochran's Q."""
    sentences = []
    for i, name in enumerate(names if len(own) > 1 else []):
        values, errors = np.array([o.theta[i] for o in own]), np.sqrt([o.variance[i] for o in own])
        mean = np.sum(values / errors**2) / np.sum(1 / errors**2)
        q = float(np.sum(((values - mean) / errors) ** 2))
        size = np.abs(values - mean) / errors
        certain = size > 2  # of the others the value says nothing
        if q <= chi2.isf(BY_CHANCE / len(names), len(own) - 1) or not certain.any():
            continue
        low, high = (int(pick(np.where(certain, values, mean))) for pick in (np.argmin, np.argmax))
        if values[high] - values[low] < least[i]:
            continue
        ends = [f"{values[k]:.4g} (standard error {errors[k]:.2g}) in {own[k].name}" for k in (low, high)]
        sentences.append(
            f"{name} differs between {what} by more than its errors: {ends[0]}, {ends[1]}; "
            "one model has to allow for both, or each gets a project file of its own"
        )
    return sentences


def outlook(recordings: int) -> str:
    """Say what a number of calibrating recordings allows, and how many more the next claim needs.

    >>> outlook(9)
    '9 recordings calibrate: alpha 0.1; 10 more would allow alpha 0.05'
    """
    needed = {alpha: recordings_for(alpha) for alpha in _ALPHAS}
    allowed = [alpha for alpha, n in needed.items() if n <= recordings]
    now = f"alpha {allowed[-1]:g}" if allowed else "no alpha"
    following = next((alpha for alpha, n in needed.items() if n > recordings), None)
    more = f"; {needed[following] - recordings} more would allow alpha {following:g}" if following else ""
    return f"{recordings} recordings calibrate: {now}{more}"
