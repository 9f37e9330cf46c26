"""Stage 5, what a healthy vehicle's error looks like after an alarm: the scales of the diagnosis (THEORY 7.9;
lib/include/lpvguard/diagnosis.h)

    e_j = theta_1 yhat_j - theta_2 dyhat_j/dt + theta_3 + theta_4 yhat_j |yhat_j| + residue             (T38)

by least squares over WINDOW_S of settled blocks. Every number is of drives that set the bounds. The
covariance of a healthy theta is that of a random effect: what its estimates from window to window show
beyond their own standard errors, by expectation and maximisation. Theta then has the covariance spread +
errors. Both are enlarged until 95 % of a drive's windows lie within the 95 % region of the other drives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2, t

from ..base.errors import InputError
from ..base.layout import DIAGNOSIS
from ..core.seal import Sealed
from ..drives.frames import Estimator
from ..vehicle.project import Project
from .change import BLOCK, FIRST_BLOCK_END

WINDOW_S = 10.0
"""Settled driving since an alarm from which causes are judged."""
DELAYS, MOST_STRIDE, REACH_S = 6, 4, 0.5
"""Delays that are tried (LPVG_DIAGNOSIS_DELAYS), blocks between them at most, and how far they reach at
least, where the stride allows."""
CELL_S = 0.8
"""Of the ring before an alarm, whose cells say since when."""
PARTS = 4
UPPER = np.triu_indices(PARTS)
COVERED = 0.95
EXCITED = 0.05
"""Mean square of yhat over its size, from which causes are judged."""
FITS = float(chi2.ppf(0.99, PARTS - 1))
MARGIN = 2.0
"""By which the next cause must be worse: chi-squared, a likelihood ratio of e."""
ROUGHER, STILLER, STILLEST = 4.0, 0.05, 0.01
"""Noise is four times the largest healthy mean square within blocks; a frozen output moves by less than a
twentieth of the least, and less than a hundredth of what the model says."""
STEPS, FEWER_STEPS = 200, 20
"""Of expectation and maximisation, from nothing, and from what nearly the same windows gave."""


@dataclass(frozen=True)
class Windows:
    """Sums over windows of a drive's settled blocks, W windows: n (W,) blocks; gram (W, n_y, 4, 4), along
    (W, n_y, 4), square (W, n_y) of e; rough, moved, still (W, n_y): mean squares of noise in blocks, of the
    changes of yhat and of y; correlated (W, n_y): variance factor of the residue's correlation."""

    n: np.ndarray
    gram: np.ndarray
    along: np.ndarray
    square: np.ndarray
    rough: np.ndarray
    moved: np.ndarray
    still: np.ndarray
    correlated: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence[Windows]) -> Windows:
        """Those of several drives, one after the other."""
        return cls(*(np.concatenate([getattr(p, name) for p in parts]) for name in vars(parts[0])))

    def of(self, chosen: np.ndarray) -> Windows:
        """The ``chosen`` (W,) ones."""
        return Windows(*(value[chosen] for value in vars(self).values()))

    @property
    def theta(self) -> np.ndarray:
        """Estimates (W, n_y, 4), as the core's."""
        return np.linalg.solve(self._regular, self.along[..., None])[..., 0]

    @property
    def residue(self) -> np.ndarray:
        """Mean square (W, n_y) that theta leaves."""
        left = self.square - np.einsum("wji,wji->wj", self.along, self.theta)
        return np.maximum(left, 0.0) / self.n[:, None]

    def errors(self, correlated: np.ndarray) -> np.ndarray:
        """Covariance (W, n_y, 4, 4) of the estimates for a given theta; correlated (n_y,)."""
        return (correlated * self.residue)[..., None, None] * np.linalg.inv(self._regular)

    @property
    def _regular(self) -> np.ndarray:
        return self.gram + 1e-5 * self.n[:, None, None, None] * np.eye(PARTS)


def windows_of(
    e: np.ndarray, yhat: np.ndarray, v: np.ndarray, estimator: Estimator, unit: np.ndarray
) -> Windows:
    """The windows of a drive, each of half the blocks of the one before; e, yhat (N, n_y), v (N,), ``unit``
    (n_y, 2): 1 / size of yhat and of its change over a block. One of at least half the length where there are
    no more."""
    ends = np.arange(FIRST_BLOCK_END, len(e), BLOCK)[1:]
    at = ends[:, None] + np.arange(1 - BLOCK, 1)
    whole = estimator.settled(v)[at].all(axis=1)
    taken = np.flatnonzero(whole[1:] & whole[:-1]) + 1
    mean_e, mean = (x[at].mean(axis=1) for x in (e, yhat))
    change = np.diff(mean, axis=0, prepend=mean[:1])
    noise = 0.5 * ((e + yhat)[at] * np.array([1.0, -1.0, -1.0, 1.0])[:, None]).sum(axis=1)
    p = mean * unit[:, 0]
    phi = np.stack([p, -change * unit[:, 1], np.ones_like(p), p * np.abs(p)], axis=-1)
    length = round(WINDOW_S / (BLOCK * estimator.Ts))
    starts = range(0, max(len(taken) - length // 2, 0), length // 2)
    found = [taken[s : s + length] for s in starts if s == 0 or s + length <= len(taken)]
    n_y = e.shape[1]
    rows: list[Windows] = [_empty(n_y)]
    whole_change = change + np.diff(mean_e, axis=0, prepend=mean_e[:1])
    for index in found:
        f, x = phi[index], mean_e[index]
        one = Windows(
            np.array([float(len(index))]),
            np.einsum("mji,mjk->jik", f, f)[None],
            np.einsum("mji,mj->ji", f, x)[None],
            (x**2).sum(axis=0)[None],
            (noise[index] ** 2).mean(axis=0)[None],
            (change[index] ** 2).mean(axis=0)[None],
            (whole_change[index] ** 2).mean(axis=0)[None],
            np.ones((1, n_y)),
        )
        left = x - np.einsum("mji,ji->mj", f, one.theta[0])
        rows.append(Windows(**{**vars(one), "correlated": _correlated(left)[None]}))
    return Windows.joined(rows)


def _empty(n_y: int) -> Windows:
    shapes = ((), (n_y, PARTS, PARTS), (n_y, PARTS), *[(n_y,)] * 5)
    return Windows(*(np.zeros((0, *shape)) for shape in shapes))


def _correlated(left: np.ndarray) -> np.ndarray:
    """1 + 2 sum of the correlations of a residue (M, n_y) up to the first that is not positive, (n_y,)."""
    found = np.ones(left.shape[1])
    for j, r in enumerate(left.T):
        total = float(r @ r)
        for lag in range(1, len(r) // 2):
            share = float(r[lag:] @ r[:-lag]) / total if total > 0 else 0.0
            if share <= 0:
                break
            found[j] += 2 * share
    return found


def _spread(theta: np.ndarray, errors: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """Second moments (n_y, 4, 4) of a random theta about 0, of estimates (W, n_y, 4) with ``errors`` (W, n_y,
    4, 4), by expectation and maximisation; ``start`` (n_y, 4, 4): those of nearly the same windows."""
    moments = np.einsum("wji,wjk->jik", theta, theta) / len(theta)
    scale = np.sqrt(np.einsum("jii->ji", moments)) + 1e-12
    found = np.stack([np.diag(s**2) for s in scale])
    least = 1e-6 * found
    if start is not None:
        found = start
    for _ in range(STEPS if start is None else FEWER_STEPS):
        gain = found @ np.linalg.inv(found + errors)
        mean = np.einsum("wjik,wjk->wji", gain, theta)
        left = found - gain @ found
        found = (np.einsum("wji,wjk->jik", mean, mean) + left.sum(axis=0)) / len(theta) + least
    return (found + found.swapaxes(1, 2)) / 2


def _squares(theta: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return np.einsum("wji,wji->wj", theta, np.linalg.solve(covariance, theta[..., None])[..., 0])


@dataclass(frozen=True)
class DiagnosisScales:
    """What the drives that set the bounds show of every output; ``unit`` (n_y, 2) as the change test's sizes.

    spread (n_y, 4, 4): covariance of a healthy theta. correlated (n_y,): on the variance of its estimate.
    residue (n_y, 2), rough, still (n_y,): as in diagnosis.h. enlarged (n_y,): factor on both covariances,
    included. interval: half width of a 95 % interval in standard deviations. windows, drives: how many there
    were."""

    Ts: float
    unit: np.ndarray
    spread: np.ndarray
    correlated: np.ndarray
    residue: np.ndarray
    rough: np.ndarray
    still: np.ndarray
    enlarged: np.ndarray
    interval: float
    windows: int
    drives: int

    @classmethod
    def of(cls, project: Project, unit: np.ndarray, drives: Sequence[Windows]) -> DiagnosisScales:
        """From the windows of every bound-setting drive; ``unit`` (n_y, 2): sizes. InputError where there are
        none."""
        drives = [w for w in drives if len(w.n)]
        if not drives:
            raise InputError(
                "diagnosis",
                "",
                "no drive that sets the bounds has a window",
                f"{WINDOW_S / 2:g} s of settled driving in range, at least",
            )
        every = Windows.joined(drives)
        correlated = every.correlated.mean(axis=0)
        theta, errors = every.theta, every.errors(correlated)
        spread = _spread(theta, errors)
        enlarged, interval = _needed(drives, correlated, spread)
        y_square = every.gram[..., 0, 0] / every.n[:, None] * unit[:, 0] ** 2
        share = np.maximum((every.residue * y_square).sum(0) / (y_square**2).sum(0), 1e-6)
        constant = (every.residue - share * y_square).max(axis=0)
        least = 1e-6 * unit[:, 0] ** 2
        moving = every.moved > 0
        ratio = np.where(moving, every.still / np.where(moving, every.moved, 1.0), np.inf).min(axis=0)
        return cls(
            project.Ts_s,
            unit,
            enlarged[:, None, None] * spread,
            enlarged * correlated,
            np.column_stack([np.maximum(constant, least), share]),
            ROUGHER * np.maximum(every.rough.max(axis=0), least),
            np.clip(STILLER * ratio, 1e-6, STILLEST),
            enlarged,
            interval,
            len(every.n),
            len(drives),
        )

    @property
    def table(self) -> DiagnosisTable:
        """The core's."""
        block_s = BLOCK * self.Ts
        n_y = len(self.unit)
        words = {
            **DIAGNOSIS.head({"NY": n_y}),
            "sample_period_us": round(self.Ts * 1e6),
            "blocks": max(8, round(WINDOW_S / block_s)),
            "stride": int(np.clip(np.ceil(REACH_S / (DELAYS * block_s)), 1, MOST_STRIDE)),
            "cell_blocks": max(1, round(CELL_S / block_s)),
        }
        reals = {
            "block_s": block_s,
            "unit": 1 / self.unit,
            "spread": self.spread[:, UPPER[0], UPPER[1]],
            "correlated": self.correlated,
            "residue": self.residue,
            "rough": self.rough,
            "still": self.still,
            "excited": EXCITED,
            "fits": FITS,
            "margin": MARGIN,
            "interval": self.interval,
        }
        return DiagnosisTable({}, words, {name: np.array(value, float) for name, value in reals.items()})

    def to_dict(self) -> dict:
        """JSON-able, for `restored`: diagnosis.json."""
        return {"window_s": WINDOW_S, **{k: v for k, v in vars(self).items() if k != "Ts"}}

    @classmethod
    def restored(cls, project: Project, data: dict) -> DiagnosisScales:
        """Those of diagnosis.json."""
        scalars: dict[str, Any] = {k: data[k] for k in ("interval", "windows", "drives")}
        arrays: dict[str, Any] = {
            k: np.array(v, float) for k, v in data.items() if k not in ("window_s", *scalars)
        }
        return cls(project.Ts_s, **scalars, **arrays)

    @property
    def least(self) -> np.ndarray:
        """Least change of gain, delay [s] and bias (n_y, 3) that an interval can tell from none.

        However long the record is: healthy vehicles differ by as much. Of a gain g it is of (g - 1)/g, as g
        scales the spread."""
        alone = self.interval / np.sqrt(np.einsum("jii->ji", np.linalg.inv(self.spread)))
        return alone[:, : PARTS - 1] / np.column_stack(
            [self.unit / [1.0, BLOCK * self.Ts], np.ones(len(self.unit))]
        )

    def least_text(self, project: Project) -> str:
        """`least` per output, in words."""
        return "; ".join(
            f"{s.name} gain from {1 / (1 + gain):.2f} to "
            f"{f'{1 / (1 - gain):.2f}' if gain < 1 else 'any above 1'}, "
            f"delay below {delay:.2g} s, bias below {bias:.2g} {s.unit}"
            for s, (gain, delay, bias) in zip(project.outputs, self.least, strict=True)
        )


@dataclass(frozen=True)
class DiagnosisTable(Sealed):
    """The scales as the core has them (diagnosis.h)."""

    LAYOUT = DIAGNOSIS


def _needed(
    drives: Sequence[Windows], correlated: np.ndarray, spread: np.ndarray
) -> tuple[np.ndarray, float]:
    """Factor (n_y,) on the covariances, 1 or more, with which COVERED of the windows lie within the region
    that the other drives make; with one drive its own. Half width of an interval, in standard deviations.

    The latter is Student's t with as many degrees of freedom as drives, since about 0 each gives the spread
    one. It is more where COVERED of the windows' gains, delays or biases ask for it, all else being free.
    """
    squares, estimates = [], []
    for k, w in enumerate(drives):
        rest = Windows.joined([d for i, d in enumerate(drives) if i != k or len(drives) == 1])
        covariance = _spread(rest.theta, rest.errors(correlated), spread) + w.errors(correlated)
        squares.append(_squares(w.theta, covariance))
        information = np.linalg.inv(covariance)
        alone = np.einsum("wjik,wjk->wji", information, w.theta)
        estimates.append(np.abs(alone) / np.sqrt(np.einsum("wjii->wji", information)))
    enlarged = np.maximum(
        1.0, np.quantile(np.concatenate(squares), COVERED, axis=0) / chi2.ppf(COVERED, PARTS)
    )
    sizes = np.concatenate(estimates)[..., : PARTS - 1] / np.sqrt(enlarged)[:, None]
    usual = float(t.ppf((1 + COVERED) / 2, len(drives)))
    return enlarged, max(usual, float(np.quantile(sizes, COVERED, axis=0).max()))
