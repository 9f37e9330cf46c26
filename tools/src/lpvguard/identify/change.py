"""Stage 5, the change test (T34; THEORY 7.7): whether gain, delay and bias are still those of the
bound-setting drives. The prior adds PRIOR memories of the products met there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np
from scipy.signal import lfilter

from ..base.errors import InputError
from ..base.layout import CONSTANTS
from ..base.runs import runs
from ..drives.frames import Estimator
from ..vehicle.project import Project
from .calibration import Calibration, RateTarget, Recordings, calibrate

BLOCK = int(CONSTANTS["NBLOCK"][0])
FIRST_BLOCK_END = 2
"""Last sample, counted from 0, of the core's first block, which is not a whole one."""
PRIOR = 0.2
"""Weight of the prior, in memories of driving as in the bound-setting drives."""
SMALLEST = 1e-2
"""Floor of a part's size over the rms of yhat_j: an error of 1 % does not count."""
FLOOR, UNSTATED_FLOOR = 0.05, 1.1
"""Least threshold, and least one without alpha, which stays above the largest of the bound-setting drives.

The core drops a block for which it has no time (change.h), the definition here none. On the largest ratios of
three vehicles' drives that made 6 % at most.
"""
UPPER = ((0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2))
"""Rows and columns of the upper triangle of a symmetric matrix of three."""


def block_means(x: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Means (M, m) of signals x (N, m) over the blocks whose last samples are ``ends`` (M,)."""
    return reduce(np.add, (x[ends + k] for k in range(1 - BLOCK, 1))) / BLOCK


@dataclass(frozen=True)
class Blocks:
    """Settled blocks of a drive whose predecessor the core knows, as a stretch.

    Attributes
    ----------
    ends : ndarray (M,) of int, last sample of each
    e : ndarray (M, n_y), means of e_j [output units]
    phi : ndarray (M, n_y, 3), regressors [output units], the second per block
    """

    ends: np.ndarray
    e: np.ndarray
    phi: np.ndarray

    @classmethod
    def stretches(cls, e: np.ndarray, yhat: np.ndarray, usable: np.ndarray) -> Iterator[Blocks]:
        """Stretches of blocks of ``usable`` (N,) samples; e, yhat (N, n_y)."""
        ends = np.arange(FIRST_BLOCK_END + BLOCK, len(e), BLOCK)
        at = ends[:, None] + np.arange(1 - BLOCK, 1)
        whole = usable[at].all(axis=1)
        for first, end in runs(whole):
            mean_e, mean = (block_means(x, ends[first:end]) for x in (e, yhat))
            phi = np.stack([mean[1:], -np.diff(mean, axis=0), np.ones_like(mean[1:])], axis=-1)
            yield cls(ends[first:end][1:], mean_e[1:], phi)


@dataclass(frozen=True)
class Met:
    """Estimates along drives over ``count`` blocks: largest |theta_i| (n_y, 3) [output units], sum of
    squares.

    The sum ``squares`` is (n_y, 3).
    """

    largest: np.ndarray
    squares: np.ndarray
    count: int

    def __add__(self, other: Met) -> Met:
        return Met(
            np.maximum(self.largest, other.largest), self.squares + other.squares, self.count + other.count
        )


@dataclass(frozen=True)
class ChangeTest:
    """Memory, sizes and calibration of the change test.

    Attributes
    ----------
    Ts, memory_s : float, s
    unit : ndarray (n_y, 2), rms of yhat_j and of its change over a block [output units]
    moments : ndarray (n_y, 3, 3), mean products of the regressors over their rms
    largest : ndarray (n_y, 3), largest |theta_i| on the bound-setting drives [output units]
    size : ndarray (n_y, 3), |theta_i| at a ratio of 1 [output units]
    calibration : Calibration
    """

    Ts: float
    memory_s: float
    unit: np.ndarray
    moments: np.ndarray
    largest: np.ndarray
    size: np.ndarray
    calibration: Calibration = field(default_factory=lambda: Calibration(UNSTATED_FLOOR, {}, None, None))

    @classmethod
    def design(cls, project: Project) -> ChangeTest:
        """A test with its memory, before its sizes are known. InputError for a memory of less than two
        blocks."""
        memory = project.change_test.memory_s or 0.25 / project.frames.f_min_hz
        shortest = 2 * BLOCK * project.Ts_s
        if project.change_test.memory_s is not None and memory < shortest:
            raise InputError(
                f"vehicle {project.name}",
                "change_test.memory_s",
                f"{memory:g} s",
                f"at least {shortest:g} s, two blocks of {BLOCK} samples",
            )
        n_y = project.n_y
        return cls(
            project.Ts_s,
            max(memory, shortest),
            np.ones((n_y, 2)),
            np.tile(np.eye(3), (n_y, 1, 1)),
            np.ones((n_y, 3)),
            np.ones((n_y, 3)),
        )

    @property
    def keep(self) -> float:
        """Share of the sums after a block."""
        return float(np.exp(-BLOCK * self.Ts / self.memory_s))

    @property
    def prior(self) -> np.ndarray:
        """Prior of the sums of products (n_y, 3, 3). A thousandth of the identity keeps it positive
        definite."""
        met = 0.999 * self.moments + 0.001 * np.eye(3)
        return PRIOR / (1 - self.keep) * met

    def estimates(self, blocks: Blocks) -> np.ndarray:
        """theta (M, n_y, 3) [output units] along a stretch, from rest."""
        phi = blocks.phi / np.concatenate([self.unit, np.ones((len(self.unit), 1))], axis=1)
        products = np.concatenate(
            [phi[..., list(UPPER[0])] * phi[..., list(UPPER[1])], phi * blocks.e[..., None]], axis=-1
        )
        sums = lfilter([1.0], [1.0, -self.keep], products, axis=0)
        gram = np.empty((*phi.shape, 3))
        gram[..., UPPER[0], UPPER[1]] = gram[..., UPPER[1], UPPER[0]] = sums[..., : len(UPPER[0])]
        return np.linalg.solve(gram + self.prior, sums[..., len(UPPER[0]) :, None])[..., 0]

    def with_moments(self, sums: np.ndarray) -> ChangeTest:
        """The test with sizes and prior from the ``products`` of all bound-setting drives; InputError without
        blocks.

        ``sums`` has shape (n_y, 3, 3).
        """
        count = sums[0, 2, 2]
        if count == 0:
            raise InputError(
                "change test", "", "no block of a drive that sets the bounds", "settled driving in range"
            )
        mean = sums / count
        rms = np.sqrt(np.maximum(np.diagonal(mean, axis1=1, axis2=2), np.finfo(np.float32).tiny ** 0.5))
        return replace(self, unit=rms[:, :2], moments=mean / (rms[:, :, None] * rms[:, None, :]))

    def with_sizes(self, met: Met) -> ChangeTest:
        """The test with sizes from the estimates ``met`` on all bound-setting drives.

        A part's rms is over all blocks, its largest is one block. Sizes by the rms therefore leave no part
        half blind for one block (tools/DESIGN_LOG.md).
        """
        rms = np.sqrt(met.squares / max(1, met.count))
        ratio = np.divide(met.largest, rms, out=np.ones_like(rms), where=rms > 0).max()
        return replace(self, largest=met.largest, size=np.maximum(ratio * rms, SMALLEST * self.unit[:, :1]))

    def calibrated(
        self,
        scores: dict[str, float],
        alpha: float,
        recordings: Recordings,
        target: RateTarget | None = None,
    ) -> ChangeTest:
        """The test with the threshold from the scores of calibration drives."""
        return replace(self, calibration=calibrated_change(scores, alpha, recordings, target))

    def coefficients(self) -> tuple[dict[str, int], dict[str, int], dict[str, np.ndarray]]:
        """Sizes, words and numbers of coeff.h."""
        reals = {
            "change_block_s": BLOCK * self.Ts,
            "change_unit": 1 / self.unit,
            "change_prior": self.prior[:, UPPER[0], UPPER[1]],
            "change_scale": 1 / self.size,
            "change_forget": 1 - self.keep,
            "change_threshold": self.calibration.exported,
        }
        words = {"change_rearm": len(self.unit) * int(np.ceil(self.memory_s / (BLOCK * self.Ts)))}
        return {}, words, {name: np.array(value) for name, value in reals.items()}

    def sizes_text(self, project: Project) -> str:
        """Largest gain, delay and bias of the bound-setting drives, per output."""
        block_s = BLOCK * self.Ts
        return "; ".join(
            f"{signal.name} {largest[0] / unit[0]:.3g}, {largest[1] / unit[1] * block_s:.3g} s, "
            f"{largest[2]:.3g} {signal.unit} (gain, delay, bias)"
            for signal, largest, unit in zip(project.outputs, self.largest, self.unit, strict=True)
        )

    def to_dict(self) -> dict:
        """JSON-able, for `restored`."""
        return {
            "memory_s": self.memory_s,
            "unit": self.unit,
            "moments": self.moments,
            "largest": self.largest,
            "size": self.size,
            "calibration": self.calibration.to_dict(),
        }

    def restored(self, data: dict, where: str) -> ChangeTest:
        """The test with stored sizes and calibration; InputError when ``data`` is of another memory."""
        if data["memory_s"] != self.memory_s:
            raise InputError(
                where, "memory_s", f"{data['memory_s']:g}", f"{self.memory_s:g}, which project.json describes"
            )
        return replace(
            self,
            unit=np.array(data["unit"], float),
            moments=np.array(data["moments"], float),
            largest=np.array(data["largest"], float),
            size=np.array(data.get("size", data["largest"]), float),  # before 2026-11-24 it was the largest
            calibration=Calibration.from_dict(data["calibration"]),
        )


def calibrated_change(
    scores: Mapping[str, float], alpha: float, recordings: Recordings, target: RateTarget | None = None
) -> Calibration:
    """Calibrate the change test from the scores of calibration drives.

    Parameters
    ----------
    scores : Mapping, by drive
    alpha : float, probability of an alarm on a further recording
    recordings : Recordings
    target : RateTarget, optional, in place of alpha

    Returns
    -------
    Calibration

    References
    ----------
    THEORY 7.7.
    """
    return calibrate(
        scores,
        alpha,
        floor=FLOOR,
        unstated_floor=UNSTATED_FLOOR,
        recordings=recordings,
        target=target,
    )


def regressor_products(e: np.ndarray, yhat: np.ndarray, v: np.ndarray, estimator: Estimator) -> np.ndarray:
    """Sums (n_y, 3, 3) of products of the regressors over a drive; e, yhat (N, n_y), v (N,)."""
    total = np.zeros((e.shape[1], 3, 3))
    for blocks in Blocks.stretches(e, yhat, estimator.settled(v)):
        total += np.einsum("mji,mjk->jik", blocks.phi, blocks.phi)
    return total


def estimates_met(
    test: ChangeTest, e: np.ndarray, yhat: np.ndarray, v: np.ndarray, estimator: Estimator
) -> Met:
    """Estimates along a drive, e and yhat (N, n_y), v (N,); without a block where nothing is settled."""
    met = Met(np.zeros((e.shape[1], 3)), np.zeros((e.shape[1], 3)), 0)
    for blocks in Blocks.stretches(e, yhat, estimator.settled(v)):
        theta = np.abs(test.estimates(blocks))
        met += Met(theta.max(axis=0, initial=0.0), np.sum(theta**2, axis=0), len(theta))
    return met
