"""The paper's plain DFT estimator: one rectangular frame per experiment at constant speed, its transient
removed exactly.

With X(k) = sum_{n<N} x_n z_k^-n, z_k = exp(2 pi j k / N), the recursion x_{n+1} = Ad x_n + B_old u_{n-d-1} +
B_new u_{n-d} reads at the DFT's own lines

    X(k) = (z_k I - Ad)^-1 (B_old U_old(k) + B_new U_new(k) + z_k (x_0 - x_N)),

Let Z = C (z_k I - Ad)^-1 (B_old U_old + B_new U_new). Y - Z then holds the transient

    C (z_k I - Ad)^-1 z_k (x_0 - x_N)

besides the model's error: |Y - Z| / |Y| would be near one even without an error. x_0 - x_N is a real vector
of n numbers. It is fitted by least squares over all lines but DC, which holds the offsets. What is left is E.
On data of the nominal model that is zero.
"""

from __future__ import annotations

import numpy as np

from ..vehicle.nominal import NominalModel
from .frames import Estimator
from .tables import Drive


def lines(x: np.ndarray, estimator: Estimator) -> np.ndarray:
    """Scaled DFT (..., K, m) at the estimator's lines of x (..., N, m): a sinusoid of amplitude a in a line
    reads a, DC its mean."""
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
    """E and Z (K, n_y) of the frame that starts at sample ``start``, by the model at the frame's mean
    speed."""
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
