"""Baselines: five standard detectors that use the monitor's residual e = y - yhat.

All are tuned and calibrated in the same way.

    rms      root of the mean over a window of sum_j (e_j / s_j)^2
    cusum    two-sided cumulative sums of e_j / s_j minus a drift, the largest over signs and outputs (Page's
             test)
    nis      mean over a window of the normalised innovation squared of a Kalman filter (chi-square test)
    tracker  recursive least squares with forgetting of e_j = a yhat_j - b dyhat_j/dt + c: gain, delay, bias
    glr      generalised likelihood ratio of a fault in gain, delay or bias, of unknown size, that began
             within a window (Willsky and Jones)

s_j is the rms of e_j on the drives that set the bounds. The Kalman filter runs on e. The input is known, so
the error of the nominal model obeys x+ = A(v) x + w, e = C x + n. A filter on y would have the same
innovations. n has covariance diag(s_j^2), w has q^2 diag(X). X is the state covariance of the nominal model
under white input of the measured rms. The filter uses the stationary gain of the nearest of SPEED_NODES
speeds. Only samples in range and settled are used (drives/frames.py); the sums restart after any other
sample.

The tracker estimates theta = (a, b, c) of each output. A prior keeps it near 0 where nothing excites it. The
prior has the weight of ``prior`` times the memory in driving like that of the bound-setting drives. The
likelihood ratio has three directions for each output: yhat_j, -dyhat_j/dt and 1. They are filtered like e.
With q = 0 the filter ignores e. The ratio over the newest n samples is (sum nu' S^-1 phi)^2 / sum phi' S^-1
phi. The detector tries several onsets: n is the window, half of it, a quarter and so on, down to
SHORTEST_ONSET_S. The tracker's components are |theta_i|, those of the ratio are its roots. Each is divided by
its rms on the bound-setting drives. The statistic is the largest of them.

A detector alarms where its statistic exceeds its threshold. The threshold is conformal
(identify/calibration.py), from the same calibration drives, with one score per drive. If enough drives
calibrate, all detectors have the same guaranteed rate of false alarms. The parameters are searched over GRID
on the bound-setting and calibration drives. The best ones find the most injected faults in time; ties go to
the fastest. The search knows which faults are injected. The monitor's tests, frames and memories were chosen
with all measured drives in view (tools/DESIGN_LOG.md). That choice used every drive, while the baselines'
search leaves out the drive under test.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, reduce
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov
from scipy.signal import lfilter

from ..base.runs import runs
from ..drives.frames import Estimator
from ..vehicle.nominal import NominalModel, recursion

SPEED_NODES = 65
KINDS = ("rms", "cusum", "nis", "tracker", "glr")
TITLES = {
    "rms": "residual RMS",
    "cusum": "CUSUM",
    "nis": "Kalman innovation χ² (NIS)",
    "tracker": "tracker of gain, delay, bias (RLS)",
    "glr": "GLR bank for gain, delay, bias",
}
WITH_COMPONENTS = ("tracker", "glr")
SHORTEST_ONSET_S = 0.2
"""Latest onset that the likelihood ratio tries, before the newest sample."""


@dataclass(frozen=True)
class Baseline:
    """A detector with its parameters; a parameter that its kind does not use is 0.

    Attributes
    ----------
    kind : str
    window_s : float, s; the tracker's time constant of forgetting
    drift : float, of cusum, in units of s_j
    process_ratio : float, q of the filter
    prior : float, of the tracker
    """

    kind: str
    window_s: float = 0.0
    drift: float = 0.0
    process_ratio: float = 0.0
    prior: float = 0.0

    @property
    def label(self) -> str:
        """The detector and its parameters for tables; the window is in seconds."""
        if self.kind == "cusum":
            return f"cusum, drift {self.drift:g}"
        own = {"nis": f", q {self.process_ratio:g}", "glr": f", q {self.process_ratio:g}"}
        own["tracker"] = f", prior {self.prior:g}"
        return f"{self.kind}, {self.window_s:g} s" + own.get(self.kind, "")


WINDOWS_S = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0)
GRID = (
    *(Baseline("rms", window_s=w) for w in WINDOWS_S),
    *(Baseline("cusum", drift=k) for k in (0.1, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)),
    *(
        Baseline("nis", window_s=w, process_ratio=q)
        for q in (1e-4, 1e-3, 0.01, 0.03, 0.1, 0.3)
        for w in WINDOWS_S
    ),
    *(Baseline("tracker", window_s=w, prior=p) for w in WINDOWS_S[2:7] for p in (0.05, 0.1, 0.2, 0.5)),
    *(
        Baseline("glr", window_s=w, process_ratio=q)
        for q in (0.0, 0.03)
        for w in (1.25, 2.5, 5.0, 10.0, 20.0)
    ),
)
"""Parameters of the search. The longest window is the 30 s within which a fault should be found. With a
smaller q the filter follows e less; at 0, nis equals rms. The windows of the ratio share their onsets."""


@dataclass(frozen=True)
class Scales:
    """Sizes on the bound-setting drives.

    Attributes
    ----------
    error : ndarray (n_y,), rms of e [output units]
    input : ndarray (n_u,), rms of u [input units]
    moments : ndarray (n_y, 3, 3), mean products of each output's ``regressors``
    """

    error: np.ndarray
    input: np.ndarray
    moments: np.ndarray

    @classmethod
    def from_sizes(cls, drives: Iterable[Sizes]) -> Scales:
        """Means from the sums of each drive; all samples count alike."""
        sums = reduce(lambda a, b: a + b, drives)
        return cls(
            np.sqrt(sums.error / sums.count), np.sqrt(sums.input / sums.count), sums.moments / sums.count
        )


@dataclass(frozen=True)
class Sizes:
    """Sums over ``count`` usable samples of a drive, for the means of Scales."""

    error: np.ndarray
    input: np.ndarray
    moments: np.ndarray
    count: int

    @classmethod
    def from_drive(
        cls, e: np.ndarray, yhat: np.ndarray, u: np.ndarray, usable: np.ndarray, Ts: float
    ) -> Sizes:
        """Sums of a drive: e, yhat (N, n_y), u (N, n_u), usable (N,)."""
        phi = regressors(yhat, Ts)[:, :, usable]
        error, demand = (np.sum(x[usable] ** 2, axis=0) for x in (e, u))
        return cls(error, demand, np.einsum("jik,jlk->jil", phi, phi), int(usable.sum()))

    def __add__(self, other: Sizes) -> Sizes:
        return Sizes(*(getattr(self, k) + getattr(other, k) for k in vars(self)))


def regressors(yhat: np.ndarray, Ts: float) -> np.ndarray:
    """(n_y, 3, N): yhat_j, -dyhat_j/dt [1/s] and 1 for every output of yhat (N, n_y).

    A fault in gain, delay [s] or bias [output unit] makes an error along them.
    """
    slope = np.diff(yhat, axis=0, prepend=yhat[:1]) / Ts
    return np.stack([yhat.T, -slope.T, np.ones_like(yhat.T)], axis=1)


class Bank:
    """The detectors of one vehicle.

    Parameters
    ----------
    model : NominalModel
    estimator : Estimator
    scales : Scales
    sizes : Mapping, ndarray (3 n_y,) by baseline of WITH_COMPONENTS, rms of its components
    """

    def __init__(
        self,
        model: NominalModel,
        estimator: Estimator,
        scales: Scales,
        sizes: Mapping[Baseline, np.ndarray] = MappingProxyType({}),
    ):
        self.model, self.estimator, self.scales, self.sizes = model, estimator, scales, dict(sizes)

    def statistics(
        self, baselines: Iterable[Baseline], e: np.ndarray, yhat: np.ndarray, v: np.ndarray, first: int = 0
    ) -> Iterator[tuple[Baseline, np.ndarray]]:
        """Each baseline with its statistic (N - first,) along a drive from its sample ``first`` on.

        e, yhat (N, n_y), v (N,) [m/s]. -inf marks samples without a statistic.
        """
        along = _Along(self, e, yhat, v, first)
        for b in baselines:
            statistic = getattr(along, b.kind)(b)
            if b.kind in WITH_COMPONENTS:
                statistic = (statistic / np.maximum(self.sizes[b], np.finfo(float).tiny)[:, None]).max(axis=0)
            yield b, statistic

    def components(
        self, baselines: Iterable[Baseline], e: np.ndarray, yhat: np.ndarray, v: np.ndarray
    ) -> Iterator[tuple[Baseline, np.ndarray]]:
        """Each of the ``baselines`` WITH_COMPONENTS with its components (3 n_y, N) along a drive."""
        along = _Along(self, e, yhat, v, 0)
        yield from ((b, getattr(along, b.kind)(b)) for b in baselines if b.kind in WITH_COMPONENTS)

    def prepared(self, baselines: Iterable[Baseline]) -> Bank:
        """This bank with the filters of ``baselines``, so that no worker makes them."""
        for ratio in {b.process_ratio for b in baselines} - {0.0}:
            self._filters(ratio)
        return self

    def innovations(self, process_ratio: float, e: np.ndarray, v: np.ndarray) -> np.ndarray:
        """White innovations (N, n_y) of errors e (N, n_y) along a drive: L' nu with S^-1 = L L'.

        They are linear in e. With a ratio of 0 the filter ignores e.
        """
        if process_ratio == 0.0:
            return e / self.scales.error
        closed, injected, root = self._filters(process_ratio)
        node = np.rint(
            (np.clip(v, *self.model.speed_range) - self._nodes[0]) / (self._nodes[1] - self._nodes[0])
        ).astype(int)
        forced = np.einsum("kij,kj->ki", injected[node], e)
        nu = e - recursion(closed[node], forced, np.zeros(self.model.n)) @ self.model.C.T
        return np.einsum("kji,kj->ki", root[node], nu)

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
        """A (I - K C), A K and L with S^-1 = L L' of the stationary filter at each node."""
        d, C, R = self.model.discretise(self._nodes), self.model.C, np.diag(self.scales.error**2)
        closed, injected, roots = [], [], []
        for A, B in zip(d.Ad, d.B_old + d.B_new, strict=True):
            X = solve_discrete_lyapunov(A, B @ np.diag(self.scales.input**2) @ B.T)
            P = solve_discrete_are(A.T, C.T, process_ratio**2 * np.diag(np.diag(X)), R)
            S_inverse = np.linalg.inv(C @ P @ C.T + R)
            AK = A @ P @ C.T @ S_inverse
            closed.append(A - AK @ C)
            injected.append(AK)
            roots.append(np.linalg.cholesky(S_inverse))
        return np.array(closed), np.array(injected), np.array(roots)


class _Along:
    """Statistics (M,) along one drive from its sample ``first`` on; settings of a kind share computations."""

    def __init__(self, bank: Bank, e: np.ndarray, yhat: np.ndarray, v: np.ndarray, first: int):
        self.bank, self.e, self.yhat, self.v, self.first = bank, e, yhat, v, first
        self.usable = bank.estimator.settled(v)
        index = np.arange(1, len(v) + 1)
        self.run = (index - np.maximum.accumulate(np.where(self.usable, 0, index)))[first:]
        self.edges = runs(self.usable)
        self._shared: dict[tuple, Any] = {}

    def rms(self, b: Baseline) -> np.ndarray:
        """Root of the mean square of the scaled error; -inf: window not full."""
        mean = self._mean_square(0.0, b.window_s)
        return np.where(mean >= 0, np.sqrt(np.maximum(mean, 0.0)), -np.inf)

    def nis(self, b: Baseline) -> np.ndarray:
        """Mean of nu' S^-1 nu; -inf: window not full."""
        return self._mean_square(b.process_ratio, b.window_s)

    def cusum(self, b: Baseline) -> np.ndarray:
        """Largest g_k = max(0, g_{k-1} +- x_k - drift) of all outputs; g restarts from 0 after a gap."""
        scaled = self.e / self.bank.scales.error
        out = np.full(len(scaled), -np.inf)
        for begin, end in self.edges:
            x = np.ascontiguousarray(scaled[begin:end].T)
            S = np.cumsum(np.vstack([x, -x]) - b.drift, axis=1)
            out[begin:end] = (S - np.minimum(np.minimum.accumulate(S, axis=1), 0.0)).max(axis=0)
        return out[self.first :]

    def tracker(self, b: Baseline) -> np.ndarray:
        """(3 n_y, M) sizes of the estimated gain, delay and bias of each output; -inf at unusable samples."""
        weight, sizes = b.prior * b.window_s / self.bank.estimator.Ts, []
        moments = self.bank.scales.moments[..., None]
        for (R, r), M in zip(self._once(self._forgetting, b.window_s), moments, strict=True):
            sizes.append(np.abs(_solved(R + weight * M, r)))
        return np.where(self.run > 0, np.concatenate(sizes), -np.inf)

    def glr(self, b: Baseline) -> np.ndarray:
        """Root of the largest ratio over all onsets, (3 n_y, M) per direction; -inf where none is usable."""
        n, shortest = self._samples(b.window_s), self._samples(SHORTEST_ONSET_S)
        out = self._once(self._ratio, b.process_ratio, n)
        while n // 2 >= shortest:
            n //= 2
            out = np.maximum(out, self._once(self._ratio, b.process_ratio, n))
        return np.sqrt(out, where=out >= 0, out=np.full_like(out, -np.inf))

    def _once(self, make: Callable, *parameters: float) -> Any:
        """Result of ``make`` for these parameters, cached."""
        key = (make.__name__, *parameters)
        if key not in self._shared:
            self._shared[key] = make(*parameters)
        return self._shared[key]

    def _samples(self, seconds: float) -> int:
        return max(1, round(seconds / self.bank.estimator.Ts))

    def _summed(self, x: np.ndarray) -> np.ndarray:
        """Running sums (m, N + 1) of x (m, N) at usable samples."""
        total = np.zeros((len(x), x.shape[1] + 1))
        np.cumsum(np.where(self.usable, x, 0.0), axis=1, out=total[:, 1:])
        return total

    def _over(self, total: np.ndarray, n: int) -> np.ndarray:
        """Sums over the newest n samples (..., M), fewer at the start, from running sums (..., N + 1)."""
        begin = self.first + 1 - n
        before = total[..., max(0, begin) : max(0, total.shape[-1] - n)]
        newest = total[..., self.first + 1 :].copy()
        newest[..., newest.shape[-1] - before.shape[-1] :] -= before
        return newest

    def _mean_square(self, process_ratio: float, window_s: float) -> np.ndarray:
        """Mean square of the innovations over the last window_s.

        It is -inf where the window exceeds the run of usable samples.
        """
        total, n = self._once(self._squares, process_ratio), self._samples(window_s)
        # A difference of sums may round below zero, whose root would be NaN.
        return np.where(self.run >= n, np.maximum(self._over(total, n) / n, 0.0), -np.inf)

    def _squares(self, process_ratio: float) -> np.ndarray:
        """Running sums (N + 1,) of the squared innovations."""
        nu = self._once(self._white_error, process_ratio)
        return self._summed(np.sum(nu**2, axis=1)[None])[0]

    def _white_error(self, process_ratio: float) -> np.ndarray:
        return self.bank.innovations(process_ratio, self.e, self.v)

    def _phi(self) -> np.ndarray:
        return regressors(self.yhat, self.bank.estimator.Ts)

    def _forgetting(self, memory_s: float) -> list[tuple[np.ndarray, np.ndarray]]:
        """Forgetting sums of phi phi' (3, 3, M) and phi e_j (3, M) by output; they restart after a gap."""
        keep, forgetting = float(np.exp(-self.bank.estimator.Ts / memory_s)), []
        for j, phi in enumerate(self._once(self._phi)):
            products = np.concatenate([phi[list(UPPER[0])] * phi[list(UPPER[1])], phi * self.e[:, j]])
            sums = np.zeros_like(products)
            for begin, end in self.edges:
                sums[:, begin:end] = lfilter([1.0], [1.0, -keep], products[:, begin:end], axis=1)
            newest = sums[:, self.first :]
            forgetting.append((newest[list(SYMMETRIC)].reshape(3, 3, -1), newest[len(UPPER[0]) :]))
        return forgetting

    def _onsets(self, process_ratio: float) -> tuple[np.ndarray, np.ndarray]:
        """Running sums (3 n_y, N + 1) of nu' phi and phi' phi, white, per direction."""
        nu = self._once(self._white_error, process_ratio)
        pairs = []
        for j, kinds in enumerate(self._once(self._phi)):
            for along in kinds:
                direction = np.zeros_like(self.e)
                direction[:, j] = along
                white = self.bank.innovations(process_ratio, direction, self.v)
                pairs.append((np.sum(nu * white, axis=1), np.sum(white**2, axis=1)))
        cross, power = (self._summed(np.array(x)) for x in zip(*pairs, strict=True))
        return cross, power

    def _ratio(self, process_ratio: float, n: int) -> np.ndarray:
        """(3 n_y, M) ratios with an onset n samples ago; -inf where these are not usable."""
        cross, power = self._once(self._onsets, process_ratio)
        fits, excitation = self._over(cross, n), self._over(power, n)
        # Differences of sums round; a direction without excitation has no statistic.
        least = 1e-9 * power[:, -1:] + np.finfo(float).tiny
        ratio = np.where(excitation > least, fits**2 / np.maximum(excitation, least), 0.0)
        return np.where(self.run >= n, ratio, -np.inf)


UPPER = ((0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2))
"""Rows and columns of the upper triangle of a symmetric matrix of three."""
SYMMETRIC = (0, 1, 2, 1, 3, 4, 2, 4, 5)
"""Position in UPPER of each entry of the whole matrix, row by row."""


def _solved(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """x (3, N) with A x = b, for symmetric positive definite A (3, 3, N) and b (3, N).

    It uses Cramer's rule on A with a diagonal of 1.
    """
    scale = 1.0 / np.sqrt(np.maximum(A[[0, 1, 2], [0, 1, 2]], np.finfo(float).tiny))
    p, q, r = (A[i, k] * scale[i] * scale[k] for i, k in ((0, 1), (0, 2), (1, 2)))
    c = b * scale
    cofactors = (
        (1 - r * r, q * r - p, p * r - q),
        (q * r - p, 1 - q * q, p * q - r),
        (p * r - q, p * q - r, 1 - p * p),
    )
    determinant = cofactors[0][0] + p * cofactors[0][1] + q * cofactors[0][2]
    x = np.stack([sum(f * value for f, value in zip(row, c, strict=True)) for row in cofactors])
    return x / determinant * scale
