"""Error of windowed spectra where dynamics are inverted, for class S2 and the general LFT (THEORY 4.2).

Class S1 compares windowed spectra of e and yhat and inverts no dynamics. Class S2 needs xi_s in G_d xi_s = (z
I - Ad) d, with d = x - x_nom. A Hann frame of x_{n+1} is only approximately z times that of x_n. Here a known
white xi_s [state units per s] drives the nominal model at frozen speeds. xi_s is then estimated from frames
of d, and its relative error is the window error. For the plain DFT with known x_0 - x_N it is only rounding.
"""

from collections.abc import Iterator

import numpy as np
from scipy.linalg import expm

from ..drives.dft import lines
from ..drives.frames import Estimator
from ..vehicle.nominal import NominalModel, recursion

SPEEDS = 3
"""Number of frozen speeds over the whole range. The result is the largest median and percentile over these
speeds."""
FRAMES = 40
PERCENTILE = 90


def window_error(model: NominalModel, estimator: Estimator, seed: int) -> dict[str, np.ndarray]:
    """``median`` and ``percentile`` (K,) of |xi_hat - xi| / |xi| over FRAMES frames of each bin.

    They are the largest over SPEEDS speeds.
    """
    errors = [_at_speed(model, estimator, v, seed) for v in np.linspace(*model.speed_range, SPEEDS)]
    return {
        "median": np.max([np.median(e, axis=0) for e in errors], axis=0),
        "percentile": np.max([np.percentile(e, PERCENTILE, axis=0) for e in errors], axis=0),
    }


def _at_speed(model: NominalModel, estimator: Estimator, v: float, seed: int) -> np.ndarray:
    """Relative errors (FRAMES, K) at the speed v [m/s]."""
    n = model.n
    A = model.matrices(np.array([v]))[0][0]
    both = expm(np.block([[A, np.eye(n)], [np.zeros((n, 2 * n))]]) * model.Ts)
    Ad, Gd = both[:n, :n], both[:n, n:]
    samples = model.settle_samples + int((FRAMES + 1) * estimator.hop.max() + estimator.length.max())
    xi = np.random.default_rng(seed).standard_normal((samples, n))
    d = recursion(np.broadcast_to(Ad, (samples, n, n)), xi @ Gd.T, np.zeros(n))
    z = np.exp(1j * estimator.omega * estimator.Ts)
    out = np.empty((FRAMES, estimator.n_bins))
    for k, starts, true, D in _frames(xi, d, model.settle_samples, estimator):
        # The plain DFT subtracts z (d_0 - d_N). A Hann window has no such correction, which causes its error.
        ends = (
            (d[starts] - d[starts + estimator.length[k]]) * estimator.kernel(k)[0]
            if estimator.window == "rectangular"
            else 0.0
        )
        estimate = (z[k] * (D - ends) - D @ Ad.T) @ np.linalg.inv(Gd).T
        out[:, k] = np.linalg.norm(estimate - true, axis=1) / np.linalg.norm(true, axis=1)
    return out


def _frames(
    xi: np.ndarray, d: np.ndarray, first: int, estimator: Estimator
) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield for each bin its number, starts (F,), frames of xi and frames of d (F, n)."""
    both, n = np.hstack([xi, d]), d.shape[1]
    if estimator.window == "rectangular":  # all bins have the same frames, so one transform is enough
        starts = first + estimator.hop[0] * np.arange(FRAMES)
        every = lines(np.stack([both[s : s + estimator.length[0]] for s in starts]), estimator)
        for k in range(estimator.n_bins):
            yield k, starts, every[:, k, :n], every[:, k, n:]
    else:
        for k in range(estimator.n_bins):
            starts = first + estimator.hop[k] * np.arange(FRAMES)
            X = estimator.transform(both, k, starts)
            yield k, starts, X[:, :n], X[:, n:]
