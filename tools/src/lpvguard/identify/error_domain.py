"""Domain of the regularised model error model: lags, speed and amplitude (THEORY 7.15).

The error of output j is the response to the nominal output by an impulse response over lags,

    e_j(t) = sum_k g_j(k; s, a) yhat_j(t - k) + offset + disturbance

Here s is the relative speed, and a is the amplitude of the first input. g is a sum of features of (s, a).
Each feature has values at knots of the lag and is linear between them. Knots are one step apart at small
lags, then their distance grows geometrically. With lags below 0 the vehicle may respond sooner than the model
does.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.ndimage import uniform_filter1d
from scipy.signal import firwin, oaconvolve

from ..drives.frames import Estimator
from ..drives.tables import Drive
from ..vehicle.nominal import NominalModel

UNIT_LAGS = (-2, 5)
"""First and last of the knots that are one step apart [steps]."""
KNOT_RATIO = 1.35
"""Ratio of successive knots beyond the last of UNIT_LAGS."""
MEMORY_RAD = 1.5
"""Longest lag times the frequency of the lowest bin [rad]."""
OVERSAMPLING = 2.5
"""Least ratio of the Nyquist frequency of the decimated signals to the frequency of the highest bin."""
SLOW = 0.05
"""Below this share of the highest speed the scale of speed is nearly linear, and above it nearly
logarithmic."""
SPEED_DEGREE = 6
"""Highest degree of the polynomials of speed."""
AMPLITUDE_RATIO, AMPLITUDE_KNOTS = 2.5, 6
"""Ratio of neighbouring knots of the amplitude, and number of knots."""
AMPLITUDE_WINDOW_S = 10.0
"""Length of the window around a sample for the amplitude of the input [s]."""


@dataclass(frozen=True)
class ErrorDomain:
    """Lags, speeds and amplitudes over which the error is estimated.

    Attributes
    ----------
    Ts : sampling period of the drives [s].
    decimation : samples of the drives that make one step.
    omega : (K,) frequencies of the bins without DC [rad/s].
    speed_range : lowest and highest speed of the model [m/s].
    least_amplitude : amplitude below which a sample does not count [input unit].
    """

    Ts: float
    decimation: int
    omega: np.ndarray
    speed_range: tuple[float, float]
    least_amplitude: float

    @classmethod
    def from_estimator(cls, estimator: Estimator, excited_std: float) -> ErrorDomain:
        """Domain for the bins of an estimator. ``excited_std`` [input unit] is a scalar."""
        omega = estimator.omega[estimator.cycles > 0]
        decimation = max(1, int(np.pi / (OVERSAMPLING * omega[-1] * estimator.Ts)))
        return cls(estimator.Ts, decimation, omega, estimator.speed_range, np.sqrt(2) * excited_std)

    @property
    def step_s(self) -> float:
        """Period of the decimated signals [s]."""
        return self.Ts * self.decimation

    @cached_property
    def lags(self) -> np.ndarray:
        """Rising knots (L,) of the lag [steps]."""
        knots = list(range(UNIT_LAGS[0], UNIT_LAGS[1] + 1))
        longest = MEMORY_RAD / self.omega[0] / self.step_s
        while knots[-1] < longest:
            knots.append(max(knots[-1] + 1, round(KNOT_RATIO * knots[-1])))
        return np.array(knots)

    @cached_property
    def taps(self) -> np.ndarray:
        """Weights (L, M) of all lags for each knot.

        The lags go from lags[0] to the end of the hat function of the last knot.
        """
        end = 2 * self.lags[-1] - self.lags[-2]
        every = np.arange(self.lags[0], end)
        knots = np.r_[self.lags, end]
        return np.array([np.interp(every, knots, row) for row in np.eye(len(self.lags), len(knots))])

    def response(self, omega: np.ndarray) -> np.ndarray:
        """Frequency response (G, L) of the taps of each knot at ``omega`` (G,) [rad/s]."""
        every = self.lags[0] + np.arange(self.taps.shape[1])
        return np.exp(-1j * np.outer(omega, every) * self.step_s) @ self.taps.T

    @property
    def lowest_knot(self) -> float:
        """Lowest knot of the amplitude [input unit]. Samples below it do not count."""
        return self.least_amplitude / AMPLITUDE_RATIO

    @cached_property
    def amplitude_knots(self) -> np.ndarray:
        """Knots (A,) of the amplitude [input unit]."""
        return self.lowest_knot * AMPLITUDE_RATIO ** np.arange(AMPLITUDE_KNOTS)

    def relative_speed(self, v: np.ndarray) -> np.ndarray:
        """Relative speed s of speeds v [m/s], in the shape of v.

        It is -1 and 1 at the ends of the speed range.

        s is linear in log(v + SLOW * highest speed), because dynamics change with 1/v, and most at low speed.
        """
        low, high = self.speed_range
        slow = SLOW * high
        place = np.log(np.maximum(v, low) + slow)
        first, last = np.log(low + slow), np.log(high + slow)
        return (2 * place - first - last) / (last - first)

    def features(self, s: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Features (N, F) of relative speed s (N,) and amplitude a (N,) [input unit].

        They are Chebyshev polynomials of s, hat functions h_i of log a, and s h_i. Beyond the outer knots the
        hat functions are constant.
        """
        place = np.log(np.maximum(a, self.lowest_knot) / self.lowest_knot) / np.log(AMPLITUDE_RATIO)
        knots = np.arange(AMPLITUDE_KNOTS)
        hats = np.column_stack([np.interp(place, knots, row) for row in np.eye(AMPLITUDE_KNOTS)])
        return np.column_stack([chebvander(s, SPEED_DEGREE), hats, s[:, None] * hats])

    def decimated(self, signals: np.ndarray) -> np.ndarray:
        """Every ``decimation``-th sample (m, N') of signals (m, N), after a low-pass filter without delay."""
        if self.decimation == 1:
            return signals
        half = 10 * self.decimation
        low_pass = firwin(2 * half + 1, 0.85 / self.decimation)
        padded = np.pad(signals, ((0, 0), (half, half)), mode="edge")
        return oaconvolve(padded, low_pass[None], mode="valid", axes=1)[:, :: self.decimation]

    def amplitude(self, drive: Drive, model: NominalModel) -> np.ndarray:
        """Amplitude (N,) of the first input near each sample, sqrt(2) times its rms [input unit]."""
        width = max(1, round(AMPLITUDE_WINDOW_S / self.Ts))
        square = uniform_filter1d((drive.u[:, 0] - model.input_offset[0]) ** 2, width, mode="nearest")
        return np.sqrt(2 * np.maximum(square, 0.0))
