"""Least disturbance bound that a sensor can resolve, from its resolution and noise (THEORY 7.13).

The bound-setting drives show the step of the recording grid of each output, and its noise at frequencies
above all frames. The project file may state either value. Rounding changes a sample by at most half a step
for any signal. Its effect on a frame or on an energy therefore has a bound that needs no data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import sosfreqz
from scipy.stats import norm

from ..drives.frames import Estimator
from ..drives.tables import Drive
from ..vehicle.project import Project
from .change import BLOCK

GRID_FIT = 0.1
"""Largest distance of values from their grid, in steps."""
SAME = 1e-6
"""Differences below this share of the span count as rounding of printed digits."""
RARE = 1e-3
"""Share of frames of pure noise that may exceed the floor of the noise."""
MEDIAN_OF_SQUARE = float(norm.ppf(0.75) ** 2)
"""Median of the square of a normal variable of variance 1."""


def grid_step(y: np.ndarray) -> float:
    """Step of the grid of the samples y (N,). It is 0 without a grid and NaN for constant samples."""
    values = np.unique(y)
    gaps = np.diff(values)
    if not len(gaps):
        return np.nan
    gaps = np.where(gaps > SAME * (values[-1] - values[0]), gaps, 0.0)
    least = gaps[gaps > 0].min()
    # The smallest gaps are one step each. All values together then give more digits of the step.
    step = gaps[(gaps > 0) & (gaps < 1.5 * least)].mean()
    at = np.r_[0.0, np.cumsum(np.rint(gaps / step))]
    middle = at - at.mean()
    step = float(middle @ values / (middle @ middle))
    off = values - values.mean() - step * middle
    return step if np.abs(off).max() <= GRID_FIT * step else 0.0


def noise_deviation(y: np.ndarray, settled: np.ndarray) -> float:
    """Standard deviation of white noise in the samples y (N,).

    Only blocks whose samples are all ``settled`` (N,) count. (y_0 - y_1 - y_2 + y_3)/2 of a block has the
    variance of the noise and does not depend on mean and slope. The median ignores rare jumps. The result is
    NaN without a block.
    """
    blocks = len(y) // BLOCK
    whole = settled[: BLOCK * blocks].reshape(blocks, BLOCK).all(axis=1)
    y = y[: BLOCK * blocks].reshape(blocks, BLOCK)[whole]
    if not len(y):
        return np.nan
    return float(np.sqrt(np.median((0.5 * (y @ np.array([1.0, -1.0, -1.0, 1.0]))) ** 2) / MEDIAN_OF_SQUARE))


def largest_of_rounding(kernel: np.ndarray) -> float:
    """Largest effect of rounding to steps of 1 on a frame: max |sum_n kernel_n r_n| over all |r_n| <= 1/2.

    ``kernel`` is (N,). The sums fill a zonotope whose edges are kernel_n. Its vertices follow from the edges
    in the order of their angles.
    """
    edges = np.where((kernel.imag < 0) | ((kernel.imag == 0) & (kernel.real < 0)), -kernel, kernel)
    edges = edges[np.argsort(np.angle(edges), kind="stable")]
    vertices = np.cumsum(edges) - edges.sum() / 2
    return float(np.abs(vertices).max())


@dataclass(frozen=True)
class Resolution:
    """Resolution of every output.

    ``step`` (n_y,) is that of its grid, and ``noise`` (n_y,) its noise without that of rounding. Both are in
    output units, and 0 where none is visible.
    """

    step: np.ndarray
    noise: np.ndarray

    @classmethod
    def for_project(cls, project: Project, seen: np.ndarray) -> Resolution:
        """Resolution from the project file, or else from the bound-setting drives.

        ``seen`` (2, n_y) is the least result of `resolution_of` over these drives, NaN without a value.
        """
        step, noise = np.nan_to_num(seen)
        for j, s in enumerate(project.outputs):
            step[j] = step[j] if s.resolution is None else s.resolution
            noise[j] = noise[j] if s.noise is None else s.noise
        return cls(step, np.sqrt(np.maximum(noise**2 - step**2 / 12, 0.0)))

    def floor(self, estimator: Estimator) -> np.ndarray:
        """Least disturbance bound (K, n_y).

        It is the effect of rounding plus the noise that a share RARE of frames exceeds.
        """
        kernels = [estimator.kernel(k) for k in range(estimator.n_bins)]
        rounding = np.array([largest_of_rounding(kernel) for kernel in kernels])
        # A frame of noise is a complex normal number, or a real one at zero frequency.
        beyond = np.where(estimator.cycles > 0, np.sqrt(-np.log(RARE)), norm.ppf(1 - RARE / 2))
        size = beyond * np.array([np.linalg.norm(kernel) for kernel in kernels])
        return rounding[:, None] * self.step + size[:, None] * self.noise

    def energy_floor(self, F: np.ndarray, Ts: float, memories_s: np.ndarray) -> np.ndarray:
        """Least sigma (B, n_y) of the energy test, the effect of rounding on the norm of each band.

        ``F`` (B, S, 6) are the sections of the bands in z. ``memories_s`` (B,) are the time constants of
        forgetting.
        """
        rho = np.exp(-Ts / memories_s)
        share = [_gain_inside(f, r) / np.sqrt(1 - r**2) / 2 for f, r in zip(F, rho, strict=True)]
        return np.array(share)[:, None] * self.step


def _gain_inside(sections: np.ndarray, rho: float) -> float:
    """Largest magnitude on |z| = rho of a filter with sections (S, 6) in z."""
    powers = rho ** np.array([0.0, -1.0, -2.0])
    inside = sections * np.r_[powers, powers]
    omega = np.r_[0.0, np.geomspace(1e-6, np.pi, 4096)]
    return float(np.abs(sosfreqz(inside, omega)[1]).max())


def resolution_of(drive: Drive, e: np.ndarray, estimator: Estimator) -> np.ndarray:
    """Step and noise (2, n_y) of a drive with the nominal error ``e`` (N, n_y).

    The noise is the smaller one of the noise of the output and of e. A fast input increases the former, a
    coarse input the latter.
    """
    settled = estimator.settled(drive.v)
    noise = [min(noise_deviation(x, settled) for x in pair) for pair in zip(drive.y.T, e.T, strict=True)]
    return np.array([[grid_step(y) for y in drive.y.T], noise])
