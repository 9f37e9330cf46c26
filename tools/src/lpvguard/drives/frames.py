"""Stage 2, the estimator: constant-Q Hann frames of nominal error e = y - yhat and nominal output yhat.

A bin k > 0 has N_k samples (even) that hold ``periods`` periods, so its frequency is periods / (N_k Ts). Bin
0 is DC and as long as the lowest bin. A frame of bin k that starts at sample i reads

    X = scale sum_{n<N} w_n x_{i+n} exp(-2 pi j c n / N),
    w_n = 1/2 - 1/2 cos(2 pi n / N),   c = periods (0 at DC)

with scale 2 / sum(w) (1 / sum(w) at DC): a sinusoid of amplitude a in the bin reads |X| = a. A frame *counts*
when two things hold (THEORY 3.2). Every sample lies in the model's speed range, at least ``settle`` samples
after the last entry into it. No speed in the frame differs by more than ``speed_tolerance`` from its mean.
The C core computes the same frames, restarted every half frame from its first sample. Bounds are set over
frames at *every* start.

The paper's plain DFT (estimator "dft") has bins of one common length: DC and every line k/(N Ts) between the
frequency limits. It has a rectangular window and one frame a drive. dft.py removes its transient, so it needs
no settling.
"""

from __future__ import annotations

import ctypes
import json
import zlib
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.signal import oaconvolve

from ..base import native
from ..base.errors import InputError
from ..base.layout import constant
from ..base.runs import runs
from ..vehicle.nominal import NominalModel
from ..vehicle.project import FrameSettings, Project


def not_for_the_core(project: Project) -> InputError:
    """Make the error for a project of the plain DFT: the core computes Hann frames only.

    Parameters
    ----------
    project : Project

    Returns
    -------
    InputError
    """
    return InputError(
        f"vehicle {project.name}",
        "frames.estimator",
        "the plain DFT, which the core does not compute: its bounds are for identify and report only",
        'estimator = "hann" and bounds made with it',
    )


def require_core(project: Project) -> None:
    """Require a project that the core can run.

    Parameters
    ----------
    project : Project

    Raises
    ------
    InputError
        If the estimator is the plain DFT.
    """
    if project.frames.estimator != "hann":
        raise not_for_the_core(project)


def settled(v: np.ndarray, speed_range: tuple[float, float], settle: int) -> np.ndarray:
    """Mark the samples whose speed has been in range long enough.

    Parameters
    ----------
    v : ndarray (N,), m/s
    speed_range : tuple[float, float], m/s
    settle : int, samples

    Returns
    -------
    ndarray (N,) of bool
    """
    in_range = (v >= speed_range[0]) & (v <= speed_range[1])
    index = np.arange(1, len(v) + 1)
    last_outside = np.maximum.accumulate(np.where(in_range, 0, index))
    return index - last_outside > settle


@lru_cache(maxsize=256)
def _turns(samples: int, cycles: int) -> np.ndarray:
    """exp(-2 pi j n c / samples), (samples, 3), for samples n and the cycles c beside and at ``cycles``."""
    lines = np.outer(np.arange(samples), cycles + np.arange(-1, 2)) % samples
    return np.exp(-2j * np.pi * lines / samples)


class _Extremes:
    """Minima and maxima of all windows of a signal (N,).

    Those of windows of 2^j samples are kept; any window is the union of two.
    """

    def __init__(self, x: np.ndarray):
        self._of = [(x, x)]

    def of_windows(self, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Minima and maxima of the windows of ``samples`` samples, (N - samples + 1,) each."""
        power = samples.bit_length() - 1
        while len(self._of) <= power:
            self._of.append(self._joined(len(self._of) - 1, 1 << (len(self._of) - 1)))
        return self._joined(power, samples - (1 << power))

    def _joined(self, power: int, apart: int) -> tuple[np.ndarray, np.ndarray]:
        low, high = self._of[power]
        starts = len(low) - apart
        return np.minimum(low[:starts], low[apart:]), np.maximum(high[:starts], high[apart:])


@dataclass(frozen=True)
class Estimator:
    """Frame grid of a vehicle: everything that two comparable bounds must share.

    Attributes
    ----------
    Ts : float, s
    length : ndarray (K,) of int, samples of a frame
    cycles : ndarray (K,) of int, periods in a frame, 0 at DC
    settle : int, samples
    speed_tolerance : float, relative
    speed_range : tuple[float, float], m/s
    window : str, ``hann``, or ``rectangular`` for the plain DFT
    """

    Ts: float
    length: np.ndarray
    cycles: np.ndarray
    settle: int
    speed_tolerance: float
    speed_range: tuple[float, float]
    window: Literal["hann", "rectangular"] = "hann"

    @classmethod
    def from_project(cls, project: Project, model: NominalModel) -> Estimator:
        """Estimator of a project (THEORY 3.2). Raises InputError for settings that it cannot realise."""
        settings: FrameSettings = project.frames
        if settings.length_s is not None:
            return cls._plain_dft(project, model, settings, settings.length_s)
        decades = np.log10(settings.f_max_hz / settings.f_min_hz)
        # The tolerance keeps a last bin that the decimal settings place exactly at f_max.
        n_bins = int(np.floor(decades * settings.bins_per_decade + 1e-9)) + 1
        f = settings.f_min_hz * 10.0 ** (np.arange(n_bins) / settings.bins_per_decade)
        length = 2 * np.round(settings.periods / f / project.Ts_s / 2).astype(int)
        if len(np.unique(length)) != n_bins or length[-1] < 4 * settings.periods:
            raise InputError(
                f"vehicle {project.name}",
                "frames",
                f"the highest bins hold {length[-1]} samples a frame",
                f"at least {4 * settings.periods} and different lengths; lower omega_max_radps or "
                "bins_per_decade",
            )
        latency = constant(
            "NLATENCY", {"NBINS": n_bins + 1, "NY": project.n_y, "NDELTA": project.n_delta}
        )  # DC included
        if length[-1] // 2 <= latency:
            highest = settings.periods / (2 * (latency + 1) * project.Ts_s)
            raise InputError(
                f"vehicle {project.name}",
                "frames",
                f"{n_bins + 1} bins and half frames of {length[-1] // 2}",
                f"half frames longer than {latency} samples, as the core spreads its work over samples: "
                f"lower omega_max_radps to {2 * np.pi * highest:.3g} or less, or take more periods a frame",
            )
        return cls(
            project.Ts_s,
            np.r_[length[0], length],
            np.r_[0, np.full(n_bins, settings.periods)],
            model.settle_samples,
            settings.speed_tolerance,
            model.speed_range,
        )

    @classmethod
    def _plain_dft(
        cls, project: Project, model: NominalModel, settings: FrameSettings, length_s: float
    ) -> Estimator:
        N = round(length_s / project.Ts_s)
        lines = np.arange(N // 2)
        f = lines / (N * project.Ts_s)
        inside = lines[
            (lines > 0) & (f >= settings.f_min_hz * (1 - 1e-9)) & (f <= settings.f_max_hz * (1 + 1e-9))
        ]
        if 2 * len(inside) * project.n_y <= model.n:
            raise InputError(
                f"vehicle {project.name}",
                "frames.length_s",
                f"{len(inside)} lines from {2 * np.pi * settings.f_min_hz:.4g} to "
                f"{2 * np.pi * settings.f_max_hz:.4g} rad/s",
                f"more than the {model.n} unknowns of the transient; longer frames",
            )
        return cls(
            project.Ts_s,
            np.full(len(inside) + 1, N),
            np.r_[0, inside],
            0,
            settings.speed_tolerance,
            model.speed_range,
            "rectangular",
        )

    @property
    def omega(self) -> np.ndarray:
        """Frequencies of the bins (K,) [rad/s]; 0 is DC."""
        return 2 * np.pi * self.cycles / (self.length * self.Ts)

    @property
    def n_bins(self) -> int:
        """Number of bins K, DC included."""
        return len(self.length)

    def identifier(self) -> int:
        """CRC-32 of the estimator's definition, on which bounds and core must agree."""
        definition = {
            "window": self.window,
            "Ts_ns": round(self.Ts * 1e9),
            "length": self.length.tolist(),
            "cycles": self.cycles.tolist(),
            "hop_per_frame": int(self.length[0] // self.hop[0]),
            "scale": "2/sum(w), 1/sum(w) at DC",
            "settle": self.settle,
            "speed_tolerance": repr(self.speed_tolerance),
            "speed_range": [repr(s) for s in self.speed_range],
        }
        return zlib.crc32(json.dumps(definition, sort_keys=True).encode())

    @property
    def hop(self) -> np.ndarray:
        """Samples (K,) between frames: half a frame, or a whole one."""
        return self.length // (2 if self.window == "hann" else 1)

    def kernel(self, k: int) -> np.ndarray:
        """Scaled window times exponential of bin k, (N_k,) complex."""
        n = np.arange(self.length[k])
        w = 0.5 - 0.5 * np.cos(2 * np.pi * n / self.length[k]) if self.window == "hann" else np.ones(len(n))
        scale = (2.0 if self.cycles[k] else 1.0) / w.sum()
        return scale * w * np.exp(-2j * np.pi * self.cycles[k] * n / self.length[k])

    def settled(self, v: np.ndarray) -> np.ndarray:
        """True (N,) where the speed v (N,) has been in range for more than ``settle`` samples."""
        return settled(v, self.speed_range, self.settle)

    def counted(self, v: np.ndarray, k: int) -> np.ndarray:
        """True (N - N_k + 1,) for the start samples whose frame of bin k counts; v (N,) [m/s]."""
        return self._counted(_Extremes(v), *self._sums(v), k)

    def stretches(self, v: np.ndarray) -> list[np.ndarray]:
        """Runs of counting frames per bin: first start and the one after the last (R, 2); v (N,) [m/s]."""
        extremes, sums = _Extremes(v), self._sums(v)
        return [runs(self._counted(extremes, *sums, k)) for k in range(self.n_bins)]

    def _sums(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sums (N + 1,) of the speed and of the settled samples before each."""
        return np.concatenate([[0.0], np.cumsum(v)]), np.concatenate([[0], np.cumsum(self.settled(v))])

    def _counted(self, v: _Extremes, total: np.ndarray, whole: np.ndarray, k: int) -> np.ndarray:
        N = int(self.length[k])
        if len(total) <= N:
            return np.zeros(0, bool)
        low, high = v.of_windows(N)
        mean = (total[N:] - total[:-N]) / N
        steady = (low >= (1 - self.speed_tolerance) * mean) & (high <= (1 + self.speed_tolerance) * mean)
        return steady & (whole[N:] - whole[:-N] == N)

    def transform(self, x: np.ndarray, k: int, starts: np.ndarray) -> np.ndarray:
        """Frames (S, m) of bin k of the signals x (N, m) at the start samples (S,), complex."""
        if not len(starts):
            return np.zeros((0, x.shape[1]), complex)
        if self.window == "hann":
            return self._slid(np.ascontiguousarray(x, float), k, starts)
        kernel = self.kernel(k)[::-1, None]
        return oaconvolve(x, kernel, mode="valid", axes=0)[starts]

    def _slid(self, x: np.ndarray, k: int, starts: np.ndarray) -> np.ndarray:
        """Compute `transform` by sliding sums over stretches of close starts."""
        N, m = int(self.length[k]), x.shape[1]
        turn = _turns(N, int(self.cycles[k]))
        scale = ctypes.c_double((2.0 if self.cycles[k] else 1.0) / (0.5 * N))
        spectra = []
        for near in np.split(starts, np.flatnonzero(np.diff(starts) > N) + 1):
            first = int(near[0])
            every = np.empty((int(near[-1]) - first + 1, m), complex)
            sizes = (ctypes.c_ssize_t(size) for size in (len(every), m, N))
            arrays = (native.pointer(x[first:]), native.pointer(turn), scale, native.pointer(every))
            native.kernels("hann").lpvg_hann(*sizes, *arrays)
            spectra.append(every if len(every) == len(near) else every[near - first])
        return spectra[0] if len(spectra) == 1 else np.concatenate(spectra)
