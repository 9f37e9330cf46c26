"""Stage 5, the change test (T34; THEORY 7.7): do gain, delay and bias still match the bound-setting
drives?"""

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
"""Last sample, counted from 0, of the first block in the core, which is shorter than the others."""
PRIOR = 0.2
"""Weight of the prior: it counts as this number of memory lengths of the bound-setting drives."""
SMALLEST = 1e-2
"""Least size of a part, relative to the rms of yhat_j. Smaller errors than 1 % do not count."""
FLOOR, UNSTATED_FLOOR = 0.05, 1.1
"""Least threshold, and least threshold without alpha.

The latter is above the largest ratio of the bound-setting drives. The core drops a block for which it has no
time (change.h), but this module drops none. On the drives of three vehicles this changed the largest ratios
by at most 6 %.
"""
UPPER = ((0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2))
"""Rows and columns of the upper triangle of a 3 x 3 matrix."""


def block_means(x: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Means (M, m) of the signals x (N, m) over the blocks that end at the samples ``ends`` (M,)."""
    return reduce(np.add, (x[ends + k] for k in range(1 - BLOCK, 1))) / BLOCK


@dataclass(frozen=True)
class Blocks:
    """Successive settled blocks of a drive. The core also knows the block before each of them.

    Attributes
    ----------
    ends : ndarray (M,) of int, last sample of each block
    e : ndarray (M, n_y), means of e_j [output units]
    phi : ndarray (M, n_y, 3), regressors [output units], the second one per block
    """

    ends: np.ndarray
    e: np.ndarray
    phi: np.ndarray

    @classmethod
    def stretches(cls, e: np.ndarray, yhat: np.ndarray, usable: np.ndarray) -> Iterator[Blocks]:
        """Yield the stretches of blocks whose samples are all ``usable`` (N,), with e and yhat (N, n_y)."""
        ends = np.arange(FIRST_BLOCK_END + BLOCK, len(e), BLOCK)
        at = ends[:, None] + np.arange(1 - BLOCK, 1)
        whole = usable[at].all(axis=1)
        for first, end in runs(whole):
            mean_e, mean = (block_means(x, ends[first:end]) for x in (e, yhat))
            phi = np.stack([mean[1:], -np.diff(mean, axis=0), np.ones_like(mean[1:])], axis=-1)
            yield cls(ends[first:end][1:], mean_e[1:], phi)


@dataclass(frozen=True)
class Met:
    """Summary of the estimates theta along drives, over ``count`` blocks.

    ``largest`` (n_y, 3) is the largest |theta_i| [output units]. ``squares`` (n_y, 3) is the sum of its
    squares.
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
    unit : ndarray (n_y, 2), rms of yhat_j and of its change from block to block [output units]
    moments : ndarray (n_y, 3, 3), mean products of the regressors, divided by their rms
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
        """A test with its memory, before its sizes are known.

        Raises InputError for a memory of less than two blocks.
        """
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
        """Factor of the sums from block to block."""
        return float(np.exp(-BLOCK * self.Ts / self.memory_s))

    @property
    def prior(self) -> np.ndarray:
        """Prior of the sums of products (n_y, 3, 3): PRIOR memory lengths of the mean products.

        A thousandth of the identity keeps it positive definite.
        """
        met = 0.999 * self.moments + 0.001 * np.eye(3)
        return PRIOR / (1 - self.keep) * met

    def estimates(self, blocks: Blocks, chosen: slice = slice(None)) -> np.ndarray:
        """theta (m, n_y, 3) [output units] along a stretch, from rest, of the ``chosen`` blocks."""
        phi = blocks.phi / np.concatenate([self.unit, np.ones((len(self.unit), 1))], axis=1)
        products = np.concatenate(
            [phi[..., list(UPPER[0])] * phi[..., list(UPPER[1])], phi * blocks.e[..., None]], axis=-1
        )
        sums = lfilter([1.0], [1.0, -self.keep], products, axis=0)[chosen]
        gram = np.empty((*sums.shape[:-1], 3, 3))
        gram[..., UPPER[0], UPPER[1]] = gram[..., UPPER[1], UPPER[0]] = sums[..., : len(UPPER[0])]
        return np.linalg.solve(gram + self.prior, sums[..., len(UPPER[0]) :, None])[..., 0]

    def with_moments(self, sums: np.ndarray) -> ChangeTest:
        """The test with units and prior from the products of all bound-setting drives.

        ``sums`` (n_y, 3, 3) are the sums of `regressor_products`. Raises InputError without a block.
        """
        count = sums[0, 2, 2]
        if count == 0:
            raise InputError(
                "change test",
                "",
                "the drives that set the bounds have no settled block",
                "settled driving in range",
            )
        mean = sums / count
        rms = np.sqrt(np.maximum(np.diagonal(mean, axis1=1, axis2=2), np.finfo(np.float32).tiny ** 0.5))
        return replace(self, unit=rms[:, :2], moments=mean / (rms[:, :, None] * rms[:, None, :]))

    def with_sizes(self, met: Met) -> ChangeTest:
        """The test with sizes from the estimates ``met`` on all bound-setting drives.

        The rms of a part uses all blocks, its maximum only one. All sizes are therefore proportional to the
        rms. One unusual block then makes no single part insensitive (tools/DESIGN_LOG.md).
        """
        rms = np.sqrt(met.squares / max(1, met.count))
        ratio = np.divide(met.largest, rms, out=np.ones_like(rms), where=rms > 0).max()
        return replace(self, largest=met.largest, size=np.maximum(ratio * rms, SMALLEST * self.unit[:, :1]))

    def calibrated(
        self, scores: dict[str, float], alpha: float, recordings: Recordings, target: RateTarget | None = None
    ) -> ChangeTest:
        """The test with the threshold from the scores of calibration drives."""
        return replace(self, calibration=calibrated_change(scores, alpha, recordings, target))

    def coefficients(self) -> tuple[dict[str, int], dict[str, int], dict[str, np.ndarray]]:
        """Sizes, whole numbers and real numbers of this test for coeff.h."""
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
        """Text with the largest gain, delay and bias of the bound-setting drives for each output."""
        block_s = BLOCK * self.Ts
        return "; ".join(
            f"{signal.name} {largest[0] / unit[0]:.3g}, {largest[1] / unit[1] * block_s:.3g} s, "
            f"{largest[2]:.3g} {signal.unit} (gain, delay, bias)"
            for signal, largest, unit in zip(project.outputs, self.largest, self.unit, strict=True)
        )

    def to_dict(self) -> dict:
        """Convert to JSON types, for `restored`."""
        return {
            "memory_s": self.memory_s,
            "unit": self.unit,
            "moments": self.moments,
            "largest": self.largest,
            "size": self.size,
            "calibration": self.calibration.to_dict(),
        }

    def restored(self, data: dict, where: str) -> ChangeTest:
        """The test with the stored sizes and calibration of ``data``.

        Raises InputError for another memory.
        """
        if data["memory_s"] != self.memory_s:
            raise InputError(
                where, "memory_s", f"{data['memory_s']:g}", f"{self.memory_s:g}, the memory of project.json"
            )
        return replace(
            self,
            unit=np.array(data["unit"], float),
            moments=np.array(data["moments"], float),
            largest=np.array(data["largest"], float),
            size=np.array(data.get("size", data["largest"]), float),  # older files have no size
            calibration=Calibration.from_dict(data["calibration"]),
        )


def calibrated_change(
    scores: Mapping[str, float], alpha: float, recordings: Recordings, target: RateTarget | None = None
) -> Calibration:
    """Calibrate the change test from the scores of calibration drives.

    Parameters
    ----------
    scores : Mapping, score by drive
    alpha : float, probability of an alarm on a further recording
    recordings : Recordings
    target : RateTarget, optional, target rate in place of alpha

    Returns
    -------
    Calibration

    References
    ----------
    THEORY 7.7.
    """
    return calibrate(
        scores, alpha, floor=FLOOR, unstated_floor=UNSTATED_FLOOR, recordings=recordings, target=target
    )


def regressor_products(e: np.ndarray, yhat: np.ndarray, v: np.ndarray, estimator: Estimator) -> np.ndarray:
    """Sums (n_y, 3, 3) of the products of the regressors over a drive.

    The drive has e and yhat (N, n_y) and v (N,).
    """
    total = np.zeros((e.shape[1], 3, 3))
    for blocks in Blocks.stretches(e, yhat, estimator.settled(v)):
        total += np.einsum("mji,mjk->jik", blocks.phi, blocks.phi)
    return total


def estimates_met(
    test: ChangeTest, e: np.ndarray, yhat: np.ndarray, v: np.ndarray, estimator: Estimator
) -> Met:
    """Summary of the estimates along a drive, with e and yhat (N, n_y) and v (N,)."""
    met = Met(np.zeros((e.shape[1], 3)), np.zeros((e.shape[1], 3)), 0)
    for blocks in Blocks.stretches(e, yhat, estimator.settled(v)):
        theta = np.abs(test.estimates(blocks))
        met += Met(theta.max(axis=0, initial=0.0), np.sum(theta**2, axis=0), len(theta))
    return met
