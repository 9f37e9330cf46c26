"""What is used today in the monitor's place: three detectors on the same residual e = y - yhat.

They are tuned and calibrated alike.

    rms     root of the mean over a window of sum_j (e_j / s_j)^2
    cusum   two-sided cumulative sums of e_j / s_j less a drift, largest over sides and outputs (Page's test)
    nis     mean over a window of the normalised innovation squared of a Kalman filter (chi-square test)

s_j is the rms of e_j on the drives that set the bounds. The filter runs on e. With the input known,
the error of the nominal model obeys x+ = A(v) x + w, e = C x + n. Its innovations are therefore those of a
filter on y. n has covariance diag(s_j^2), w has q^2 diag(X). X is the state covariance of the nominal model
under white input of the rms met. Gains are stationary at each of SPEED_NODES speeds; the nearest one acts.
Only samples in range and settled are used (drives/frames.py); the sums restart after others.

A detector alarms where its statistic exceeds a threshold. That is the conformal one of
identify/calibration.py from the same calibration drives, one score a drive. Where enough drives calibrate,
all detectors have the same guaranteed rate of false alarms. Parameters are searched over GRID, on
bound-setting and calibration drives alone. The best find the most injected faults in time there; of those
that tie, the fastest is taken. The search knows the faults that are to be found; the monitor has no such
search.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from ..drives.frames import Estimator
from ..vehicle.nominal import NominalModel, recursion

SPEED_NODES = 65
KINDS = ("rms", "cusum", "nis")
TITLES = {"rms": "residual RMS", "cusum": "CUSUM", "nis": "Kalman innovation χ² (NIS)"}


@dataclass(frozen=True)
class Baseline:
    """One detector with its parameters; those that its kind does not have are 0."""

    kind: str
    window_s: float = 0.0
    drift: float = 0.0
    process_ratio: float = 0.0

    @property
    def label(self) -> str:
        """The detector and its parameters in words, for tables: the window in seconds, drift and process
        ratio bare numbers."""
        if self.kind == "cusum":
            return f"cusum, drift {self.drift:g}"
        return f"{self.kind}, {self.window_s:g} s" + (
            f", q {self.process_ratio:g}" if self.kind == "nis" else ""
        )


WINDOWS_S = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0)
GRID = (
    *(Baseline("rms", window_s=w) for w in WINDOWS_S),
    *(Baseline("cusum", drift=k) for k in (0.1, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)),
    *(
        Baseline("nis", window_s=w, process_ratio=q)
        for q in (1e-4, 1e-3, 0.01, 0.03, 0.1, 0.3)
        for w in WINDOWS_S
    ),
)
"""What is searched. Windows up to the 30 s within which a fault is wanted; as q falls the filter follows e
less, until nis is rms."""


@dataclass(frozen=True)
class Scales:
    """Sizes on the bound-setting drives: error (n_y,) rms of e [output units], input (n_u,) rms of u [input
    units]."""

    error: np.ndarray
    input: np.ndarray

    @classmethod
    def of(cls, drives: Iterable[tuple[np.ndarray, np.ndarray]]) -> Scales:
        """From (e, u) of each drive at its usable samples; all samples count alike."""
        sizes = [(np.sum(e**2, axis=0), np.sum(u**2, axis=0), len(e)) for e, u in drives]
        count = sum(samples for *_, samples in sizes)
        error, given = (reduce(np.add, [of[i] for of in sizes]) for i in (0, 1))
        return cls(np.sqrt(error / count), np.sqrt(given / count))


class Bank:
    """The detectors of one vehicle."""

    def __init__(self, model: NominalModel, estimator: Estimator, scales: Scales):
        self.model, self.estimator, self.scales = model, estimator, scales

    def statistics(
        self, baselines: Iterable[Baseline], e: np.ndarray, v: np.ndarray
    ) -> Iterator[tuple[Baseline, np.ndarray]]:
        """Each baseline with its statistic (N,) along a drive: e (N, n_y), v (N,); -inf where it says
        nothing."""
        usable = self.estimator.settled(v)
        scaled = e / self.scales.error
        index = np.arange(1, len(v) + 1)
        run = index - np.maximum.accumulate(np.where(usable, 0, index))
        totals: dict[
            float, np.ndarray
        ] = {}  # running sums of squares: of e for rms, of the innovations of each filter
        for b in baselines:
            if b.kind == "cusum":
                yield b, _cusum(scaled, b.drift, usable)
                continue
            if b.process_ratio not in totals:
                squares = (
                    np.sum(scaled**2, axis=1) if b.kind == "rms" else self._innovations(b.process_ratio, e, v)
                )
                totals[b.process_ratio] = np.concatenate([[0.0], np.cumsum(np.where(usable, squares, 0.0))])
            mean = self._mean(totals[b.process_ratio], b.window_s, run)
            yield b, np.where(mean >= 0, np.sqrt(np.maximum(mean, 0.0)), -np.inf) if b.kind == "rms" else mean

    def _mean(self, total: np.ndarray, window_s: float, run: np.ndarray) -> np.ndarray:
        """Mean over the last window_s of what ``total`` (N + 1,) sums, none of it negative; -inf where the
        window is not within the ``run`` (N,) of usable samples that ends there."""
        n = max(1, round(window_s / self.estimator.Ts))
        mean = np.full(len(run), -np.inf)
        # A difference of sums may round below zero, whose root would be NaN.
        mean[n - 1 :] = np.where(run[n - 1 :] >= n, np.maximum((total[n:] - total[:-n]) / n, 0.0), -np.inf)
        return mean

    def _innovations(self, process_ratio: float, e: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(N,) nu' S^-1 nu along a drive."""
        closed, injected, S_inverse = self._filters(process_ratio)
        node = np.rint(
            (np.clip(v, *self.model.speed_range) - self._nodes[0]) / (self._nodes[1] - self._nodes[0])
        ).astype(int)
        forced = np.einsum("kij,kj->ki", injected[node], e)
        nu = e - recursion(closed[node], forced, np.zeros(self.model.n)) @ self.model.C.T
        return np.einsum("ki,kij,kj->k", nu, S_inverse[node], nu)

    @cached_property
    def _nodes(self) -> np.ndarray:
        return np.linspace(*self.model.speed_range, SPEED_NODES)

    def _filters(self, process_ratio: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        cached = self._cache.get(process_ratio)
        if cached is None:
            cached = self._cache[process_ratio] = self._stationary(process_ratio)
        return cached

    @cached_property
    def _cache(self) -> dict[float, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        return {}

    def _stationary(self, process_ratio: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A (I - K C), A K and S^-1 of the stationary filter at each node."""
        d, C, R = self.model.discretise(self._nodes), self.model.C, np.diag(self.scales.error**2)
        closed, injected, inverses = [], [], []
        for A, B in zip(d.Ad, d.B_old + d.B_new, strict=True):
            X = solve_discrete_lyapunov(A, B @ np.diag(self.scales.input**2) @ B.T)
            P = solve_discrete_are(A.T, C.T, process_ratio**2 * np.diag(np.diag(X)), R)
            S_inverse = np.linalg.inv(C @ P @ C.T + R)
            AK = A @ P @ C.T @ S_inverse
            closed.append(A - AK @ C)
            injected.append(AK)
            inverses.append(S_inverse)
        return np.array(closed), np.array(injected), np.array(inverses)


def _cusum(scaled: np.ndarray, drift: float, usable: np.ndarray) -> np.ndarray:
    """max over outputs and signs of g_k = max(0, g_{k-1} +- x_k - drift), from 0 at each first usable
    sample."""
    out = np.full(len(scaled), -np.inf)
    edges = np.flatnonzero(np.diff(np.r_[0, usable.astype(np.int8), 0])).reshape(-1, 2)
    for a, b in edges:
        x = np.ascontiguousarray(scaled[a:b].T)
        S = np.cumsum(np.vstack([x, -x]) - drift, axis=1)
        out[a:b] = (S - np.minimum(np.minimum.accumulate(S, axis=1), 0.0)).max(axis=0)
    return out
