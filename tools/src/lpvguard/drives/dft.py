"""The paper's plain DFT estimator: one rectangular frame per experiment at constant speed, without transient.

Let ``X(k) = sum_{n<N} x_n z_k^-n`` with ``z_k = exp(2 pi j k / N)``. At the DFT's own lines, the recursion
``x_{n+1} = Ad x_n + B_old u_{n-d-1} + B_new u_{n-d}`` reads

    X(k) = (z_k I - Ad)^-1 (B_old U_old(k) + B_new U_new(k) + z_k (x_0 - x_N)),

Let Z = C (z_k I - Ad)^-1 (B_old U_old + B_new U_new). Y - Z then holds the transient

    C (z_k I - Ad)^-1 z_k (x_0 - x_N)

in addition to the model's error: |Y - Z| / |Y| would be near one even without an error. x_0 - x_N is a real
vector of n numbers. It is fitted by least squares over all lines but DC, which holds the offsets. The
remainder is E, which is zero on data of the nominal model.
"""

import numpy as np

from ..vehicle.nominal import NominalModel
from .frames import Estimator
from .tables import Drive


def lines(x: np.ndarray, estimator: Estimator) -> np.ndarray:
    """Compute the scaled DFT at the estimator's lines.

    A sinusoid of amplitude a in a line reads a; DC reads the mean.

    Parameters
    ----------
    x : ndarray (..., N, m)
    estimator : Estimator

    Returns
    -------
    ndarray (..., K, m) of complex, units of x
    """
    return _scale(estimator)[:, None] * np.fft.fft(x, axis=-2)[..., estimator.cycles, :]


def _scale(estimator: Estimator) -> np.ndarray:
    return np.where(estimator.cycles > 0, 2.0, 1.0) / estimator.length


def resolvent(Ad: np.ndarray, estimator: Estimator) -> tuple[np.ndarray, np.ndarray]:
    """z (K,) on the unit circle and (z I - Ad)^-1 (K, n, n) at the estimator's bins."""
    z = np.exp(1j * estimator.omega * estimator.Ts)
    return z, np.linalg.inv(z[:, None, None] * np.eye(len(Ad)) - Ad)


def spectra(
    drive: Drive, start: int, model: NominalModel, estimator: Estimator
) -> tuple[np.ndarray, np.ndarray]:
    """Compute nominal error and nominal output of a frame, by the model at the frame's mean speed.

    Parameters
    ----------
    drive : Drive
    start : int, first sample of the frame
    model : NominalModel
    estimator : Estimator

    Returns
    -------
    tuple of E and Z, ndarray (K, n_y) of complex, units of the outputs

    References
    ----------
    THEORY 3.2; paper, (2).
    """
    frame = slice(start, start + int(estimator.length[0]))
    held = model.discretise(np.array([drive.v[frame].mean()]))
    z, inverse = resolvent(held.Ad[0], estimator)
    older, newer = (lines(u[frame], estimator) for u in model.acting_inputs(drive.u))
    driven = np.einsum("ij,kj->ki", held.B_old[0], older) + np.einsum("ij,kj->ki", held.B_new[0], newer)
    Z = np.einsum("ij,kjl,kl->ki", model.C, inverse, driven)
    error = lines(drive.y[frame] - model.output_offset, estimator) - Z
    transient = (_scale(estimator) * z)[:, None, None] * (model.C @ inverse)
    rows, right = transient[1:].reshape(-1, model.n), error[1:].ravel()
    gap = np.linalg.lstsq(np.vstack([rows.real, rows.imag]), np.r_[right.real, right.imag], rcond=None)[0]
    Z[0] += model.output_offset
    return error - transient @ gap, Z
