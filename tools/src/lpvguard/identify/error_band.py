"""Predictive band of the model error of a further drive (THEORY 7.15).

The marginal likelihood gives the hyperparameters. The band includes their uncertainty. It is computed from
draws of the hyperparameters, of the common error and of the deviation of a further drive. The width of the
band is one factor times the standard deviation. With the stated confidence, a further drive lies within the
band at all frequencies, speeds and amplitudes together. The factor is the least one with this property.
"""

from dataclasses import dataclass

import numpy as np

from .error_domain import ErrorDomain
from .error_prior import USUAL, ErrorPrior, Hyperparameters, OutputSums, PriorScales, hyperparameters
from .error_sums import AMPLITUDE_CELLS_PER_KNOT, SPEED_CELLS, ErrorSums, deviations

LEVEL = 0.01
"""1 - confidence that a further drive lies within the band everywhere."""
HYPER_DRAWS, DRAWS_EACH = 64, 64
"""Number of draws of hyperparameters, and of errors for each of them."""
SPEED_NODES, AMPLITUDE_NODES = 9, 4
"""Number of speeds over the range, and of driven amplitudes at each speed, at which the band is computed."""
INTERPOLATION = 0.15
"""Interpolation error between these speeds and amplitudes, relative to the largest variation of the error."""
WAVEFORM = 1.5
"""Largest factor between the effective amplitudes of inputs with the same rms and different waveforms."""
RARE = 0.02
"""Share of the samples near a speed that lie beyond each end of the driven amplitudes."""


@dataclass(frozen=True)
class ErrorBand:
    """Band of the error of one output over frequency, speed and amplitude.

    Attributes
    ----------
    omega : (G,) [rad/s].
    speed : (S,) [m/s].
    amplitude : (S, A) [input unit].
    centre : (G, S, A) complex, posterior mean.
    sd : (G, S, A) standard deviation of the error of a further drive about ``centre``.
    k : factor on ``sd``.
    mean : (p,) posterior mean of the lag values.
    prior, most_probable : prior of the lag values, and its hyperparameters.
    """

    omega: np.ndarray
    speed: np.ndarray
    amplitude: np.ndarray
    centre: np.ndarray
    sd: np.ndarray
    k: float
    mean: np.ndarray
    prior: ErrorPrior
    most_probable: Hyperparameters

    @property
    def hyper(self) -> dict[str, float]:
        """Most probable hyperparameters, by name."""
        return {n: self.prior.size(self.most_probable.x, n) for n in self.prior.names}

    @property
    def lower(self) -> np.ndarray:
        """Lower bound (G, S, A) of |delta| by frequency, speed and amplitude."""
        return np.maximum(np.abs(self.centre) - self.k * self.sd, 0.0)

    @property
    def upper(self) -> np.ndarray:
        """Upper bound (G, S, A) of |delta| by frequency, speed and amplitude."""
        return np.abs(self.centre) + self.k * self.sd

    def typical(self, alpha: float) -> np.ndarray:
        """Compute the bound (G,) of |delta| that a further drive exceeds with probability ``alpha``.

        The probability is for one frequency, with a complex normal error. The result is the median over
        speeds and amplitudes.
        """
        return np.median(np.abs(self.centre) + np.sqrt(-np.log(alpha)) * self.sd, axis=(1, 2))

    @property
    def bound(self) -> np.ndarray:
        """Upper bound (G,) of |delta| over all speeds and amplitudes."""
        return self.upper.max(axis=(1, 2))


def driven_amplitudes(domain: ErrorDomain, histogram: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Return the lowest and highest driven amplitude near each speed.

    A speed without samples gets the amplitudes of the nearest speed with samples.

    Parameters
    ----------
    domain : ErrorDomain
    histogram : ndarray (S', A') of int, from `ErrorSums`
    speed : ndarray (S,), m/s

    Returns
    -------
    ndarray (S, 2), input unit
    """
    cells = AMPLITUDE_CELLS_PER_KNOT * (len(domain.amplitude_knots) - 1)
    low, high = domain.amplitude_knots[[0, -1]]
    edges = np.geomspace(low, high, cells + 1)
    middle = -1 + (2 * np.arange(SPEED_CELLS) + 1) / SPEED_CELLS
    filled = np.flatnonzero(histogram.sum(axis=1) > 0)
    if not len(filled):
        return np.tile(domain.amplitude_knots[[0, 0]], (len(speed), 1))
    out = np.empty((len(speed), 2))
    for k, s in enumerate(domain.relative_speed(speed)):
        nearest = filled[np.argmin(np.abs(middle[filled] - s))]
        about = np.abs(middle - middle[nearest]) < 2.5 / SPEED_CELLS
        share = np.cumsum(histogram[about].sum(axis=0))
        share = share / share[-1]
        ends = edges[[np.searchsorted(share, RARE), 1 + np.searchsorted(share, 1 - RARE)]]
        out[k] = np.maximum(ends, domain.least_amplitude) * [1 / WAVEFORM, WAVEFORM]
    return out


def band_cells(domain: ErrorDomain, histogram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speeds (S,) over the range of the model [m/s], and driven amplitudes (S, A) at each speed."""
    speed = np.linspace(*domain.speed_range, SPEED_NODES)
    ends = driven_amplitudes(domain, histogram, speed)
    return speed, np.array([np.geomspace(a, b, AMPLITUDE_NODES) for a, b in ends])


def error_band(
    domain: ErrorDomain,
    sums: ErrorSums,
    output: int,
    omega: np.ndarray,
    seed: int,
    scales: PriorScales = USUAL,
    cells: tuple[np.ndarray, np.ndarray] | None = None,
    like: ErrorBand | None = None,
) -> ErrorBand:
    """Compute the band of the error of a further drive.

    Parameters
    ----------
    domain : ErrorDomain
    sums : ErrorSums
    output : int, index of the output
    omega : ndarray (G,), rad/s
    seed : int, seed of the draws
    scales : PriorScales, default USUAL
    cells : tuple, optional
        Speeds (S,) [m/s] and amplitudes (S, A) [input unit], by default the driven ones.
    like : ErrorBand, optional, band of more drives, whose hyperparameters are used

    Returns
    -------
    ErrorBand

    References
    ----------
    THEORY 7.15.
    """
    of_output = OutputSums(sums, output)
    if like is None:
        prior = ErrorPrior(domain, 1 < len(set(sums.groups)) < len(sums.groups), scales)
        hyper = hyperparameters(prior, of_output)
    else:
        prior, hyper = like.prior, like.most_probable
    speed, amplitude = band_cells(domain, sums.histogram) if cells is None else cells
    s = np.repeat(domain.relative_speed(speed), amplitude.shape[1])
    features = domain.features(s, amplitude.ravel())
    random = np.random.default_rng(seed)
    values, own = _draws(prior, of_output, hyper, random)
    lags = np.einsum("cf,nfl->ncl", features, values.reshape(len(values), features.shape[1], -1))
    response = domain.response(omega)
    # The common error in every draw (G, N, C), and then the error of a further drive.
    common = np.einsum("gl,ncl->gnc", response, lags, optimize=True)
    # The deviation of a drive is a factor on the response of the vehicle.
    factor = 1 + common.mean(axis=1, keepdims=True)
    error = common + (response @ deviations(domain) @ own.T)[:, :, None] * factor
    centre = error.mean(axis=1)
    sd = np.sqrt((np.abs(error - centre[:, None]) ** 2).mean(axis=1))
    needed = ((np.abs(error) - np.abs(centre)[:, None]) / sd[:, None]).max(axis=(0, 2))
    k = max(0.0, float(np.quantile(needed, 1 - LEVEL, method="higher")))
    variation = np.abs(centre - centre.mean(axis=1, keepdims=True)).max(axis=1, keepdims=True)
    sd = np.hypot(sd, INTERPOLATION * variation)
    shape = (len(omega), *amplitude.shape)
    shaped = centre.reshape(shape), sd.reshape(shape)
    return ErrorBand(omega, speed, amplitude, *shaped, k, values.mean(axis=0), prior, hyper)


def _draws(
    prior: ErrorPrior, sums: OutputSums, hyper: Hyperparameters, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Draws (N, p) of the lag values of the common error, and (N, 3) of the deviation of a further drive."""
    values, own = [], []
    for x in hyper.draws(HYPER_DRAWS, random):
        posterior = sums.posterior(prior, x)
        normal = random.standard_normal((DRAWS_EACH, posterior.root.shape[1]))
        values.append(posterior.mean + normal @ posterior.root.T)
        variance = prior.deviation(x)
        if prior.groups:
            variance = variance + prior.deviation(x, group=True)
        own.append(np.sqrt(variance) * random.standard_normal((DRAWS_EACH, len(variance))))
    return np.concatenate(values), np.concatenate(own)
