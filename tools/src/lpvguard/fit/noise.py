"""Noise model of a fit: an autoregression of the residuals of all drives, which whitens them.

    A(q) e_k = sigma n_k,   A(q) = 1 + a_1 q^-1 + ... + a_m q^-m

Coefficients are least squares over all stretches, each drive weighted by its own sigma. The order m is the
least of Schwarz's criterion (Ljung, System Identification, 2nd ed., 16.4).
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

LARGEST_ORDER = 30


@dataclass(frozen=True)
class Whitening:
    """Coefficients a (m + 1,) of A with a_0 = 1, and sigma (n_drives,), of one output."""

    a: np.ndarray
    sigma: np.ndarray

    @property
    def order(self) -> int:
        """Order m."""
        return len(self.a) - 1

    def filtered(self, x: np.ndarray) -> np.ndarray:
        """A(q) of the columns of a stretch x (N, n); without its first m samples: (N - m, n)."""
        return lfilter(self.a, [1.0], x, axis=0)[self.order :] if self.order else x


def white(stretches: list[list[np.ndarray]]) -> Whitening:
    """No autoregression, and the drives' own sigma; ``stretches`` as in `fitted`, entry by entry."""
    return Whitening(np.ones(1), _spread(stretches))


def fitted(stretches: list[list[np.ndarray]]) -> Whitening:
    """Autoregression of residuals, from each drive's stretches (N,), each about its own mean."""
    order = min(LARGEST_ORDER, max(len(e) for drive in stretches for e in drive) // 20)
    sigma = _spread(stretches)
    a = np.ones(1)
    for _ in range(2):  # the weights come from the innovations of the first pass
        moments, count = np.zeros((order + 1, order + 1)), 0
        for drive, s in zip(stretches, sigma, strict=True):
            for e in drive:
                if len(e) > order:
                    lagged = np.lib.stride_tricks.sliding_window_view(e, order + 1)[:, ::-1]
                    moments += lagged.T @ lagged / s**2
                    count += len(lagged)
        a = _least_of_schwarz(moments, count)
        sigma = _spread([[lfilter(a, [1.0], e)[len(a) - 1 :] for e in drive] for drive in stretches])
    return Whitening(a, sigma)


def _spread(stretches: list[list[np.ndarray]]) -> np.ndarray:
    power = [np.concatenate(drive) if drive else np.zeros(0) for drive in stretches]
    return np.array([max(float(np.sqrt(np.mean(e**2))), 1e-12) if len(e) else 1.0 for e in power])


def _least_of_schwarz(moments: np.ndarray, count: int) -> np.ndarray:
    """Coefficients of the order with the least criterion; ``moments`` are of lags 0..m."""
    best, least = np.ones(1), count * np.log(moments[0, 0] / count)
    for m in range(1, len(moments)):
        tail = np.linalg.lstsq(moments[1 : m + 1, 1 : m + 1], -moments[1 : m + 1, 0], rcond=None)[0]
        power = moments[0, 0] + moments[0, 1 : m + 1] @ tail
        criterion = count * np.log(max(power, 1e-300) / count) + m * np.log(count)
        if criterion < least:
            best, least = np.r_[1.0, tail], criterion
    return best
