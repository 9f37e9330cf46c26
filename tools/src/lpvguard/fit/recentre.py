"""Unknowns of least relative error over speed and frequency: the common error moved into the nominal model.

Least squares weigh an error by its size, a bound W_Δ by its share of the output. The frames of a drive say

    1 + delta = sum Y conj(Z) / sum |Z|^2

for each speed, bin and output, with Z the nominal output of the fitted unknowns. At a frozen speed the error
of other unknowns theta is then ``r = (1 + delta) G(fitted) / G(theta) - 1``. Recentring minimises the sum of
a robust loss of r, weighted by its coherence, and simulates no drive again. Drives that were left out decide
whether it pays.

A sum of squares would follow drives whose error no parameters can take up, as friction at small amplitudes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import approx_fprime, least_squares

from ..base.errors import InputError
from ..drives.frames import Estimator
from ..drives.tables import Drive
from ..vehicle.nominal import NominalModel
from .estimate import HOPELESS, Estimate
from .unknowns import DELAY, Unknowns

CELLS = 8
"""Speed cells of equal width, in which the frames of a drive are pooled."""
FOLDS = 5
USUAL = 0.1
"""Relative error from which a group counts in proportion to its error, and no longer to the square."""
FEWEST_FRAMES = 3
"""Fewest frames of a drive in a cell that say a ratio."""


@dataclass(frozen=True)
class Recentring:
    """Median relative errors of the frames: of the fitted unknowns, and of recentred ones on drives left out.

    ``taken`` tells whether recentred unknowns are taken.
    """

    fitted: float
    left_out: float
    taken: bool

    def to_dict(self) -> dict:
        """Plain values, as in fit.json."""
        return {"fitted": self.fitted, "left_out": self.left_out, "taken": self.taken}


def recentred(unknowns: Unknowns, estimate: Estimate, drives: Sequence[Drive]) -> tuple[Estimate, Recentring]:
    """Move the common error of drives into the parameters and the delay, where it pays.

    Standard errors come from the scores of the drives. The estimate stays the given one, by least squares,
    where drives that were left out, a fifth at a time, have no smaller error. Raises InputError if the model
    has several inputs, or no frame counts.
    """
    error = _RelativeError(unknowns, estimate.theta, drives)
    fold = error.drive % FOLDS
    left = [np.abs(error(error.least(fold != k))[fold == k]) for k in range(FOLDS)]
    fitted, left_out = (float(np.median(x)) for x in (np.abs(error(error.fitted)), np.concatenate(left)))
    if left_out >= fitted:
        return estimate, Recentring(fitted, left_out, False)
    x = error.least(np.full(len(fold), True))
    covariance = np.array(estimate.covariance)
    covariance[error.free], covariance[:, error.free] = 0.0, 0.0
    covariance[np.ix_(error.free, error.free)] = error.covariance(x)
    return replace(estimate, theta=error.theta(x), covariance=covariance), Recentring(fitted, left_out, True)


class _RelativeError:
    """Relative errors (m, n_y) of m groups of frames, of the free unknowns x (q,)."""

    def __init__(self, unknowns: Unknowns, theta: np.ndarray, drives: Sequence[Drive]):
        project = unknowns.project(theta)
        if project.n_u > 1:
            raise InputError(
                f"vehicle {project.name}", "--recentre", f"{project.n_u} inputs", "a model of one input"
            )
        self.unknowns, self._all = unknowns, theta
        self.free = [i for i, n in enumerate(unknowns.names) if n == DELAY or n in project.model.parameters]
        model = NominalModel(project)
        estimator = Estimator.from_project(project, model)
        groups = [group for i, d in enumerate(drives) for group in _groups(i, d, model, estimator)]
        if not groups:
            raise InputError(
                f"vehicle {project.name}",
                "--recentre",
                f"no drive has {FEWEST_FRAMES} frames of a bin",
                "longer drives at steady speeds, or a smaller frames.periods",
            )
        columns = list(zip(*groups, strict=True))
        self.drive, bins = (np.array(x) for x in columns[:2])
        self._omega = estimator.omega[bins]
        self._speeds, self._speed = np.unique(np.array(columns[2]), return_inverse=True)
        self.weight = np.array(columns[4])
        self._target = np.array(columns[3]) * self._response(model)
        self.fitted = theta[self.free]

    def theta(self, x: np.ndarray) -> np.ndarray:
        """All unknowns (p,)."""
        theta = self._all.copy()
        theta[self.free] = x
        return theta

    def _response(self, model: NominalModel) -> np.ndarray:
        """Response (m, n_y) of the groups' speeds and frequencies."""
        d = model.discretise(self._speeds)
        Ad, old, new = (a[self._speed] for a in (d.Ad, d.B_old, d.B_new))
        z = np.exp(1j * self._omega * model.Ts)[:, None, None]
        return (model.C @ np.linalg.solve(z * np.eye(model.n) - Ad, (old / z + new) * z**-model.delay))[
            ..., 0
        ]

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Weighted errors (m, n_y), complex."""
        try:
            model = self.unknowns.model(self.theta(x))
        except InputError:
            return np.full(self.weight.shape, HOPELESS + 0j)
        return self.weight * (self._target / self._response(model) - 1)

    def _real(self, x: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        e = self(x)[chosen]
        return np.stack([e.real, e.imag], axis=2).reshape(len(e), -1)

    def least(self, chosen: np.ndarray) -> np.ndarray:
        """The x of least error of the chosen groups (m,), from the fitted and from the project's unknowns."""
        u = self.unknowns
        starts = (u.inside(self._all)[self.free], u.inside(u.start)[self.free])
        bounds = (u.low[self.free], u.high[self.free])
        solutions = [
            least_squares(
                lambda x: self._real(x, chosen).ravel(),
                s,
                bounds=bounds,
                x_scale="jac",
                loss="cauchy",
                f_scale=USUAL,
            )
            for s in starts
        ]
        return min(solutions, key=lambda f: f.cost).x

    def covariance(self, x: np.ndarray) -> np.ndarray:
        """Covariance (q, q) of x by the sandwich of the drives' scores."""
        everything = np.full(len(self.drive), True)
        r = self._real(x, everything)
        J = approx_fprime(x, lambda y: self._real(y, everything).ravel()).reshape(*r.shape, len(x))
        w = 1 / (1 + (r / USUAL) ** 2)
        slopes = np.einsum("ij,ij,ijk->ik", w, r, J)
        s = np.array([slopes[self.drive == i].sum(axis=0) for i in np.unique(self.drive)])
        inverse = np.linalg.pinv(np.einsum("ij,ijk,ijl->kl", w, J, J), hermitian=True)
        return inverse @ (s.T @ s) @ inverse * len(s) / max(1, len(s) - len(x))


def _groups(
    i: int, drive: Drive, model: NominalModel, estimator: Estimator
) -> Iterator[tuple[int, int, float, np.ndarray, np.ndarray]]:
    """Groups of drive i: i, bin, mean speed [m/s], ratios (n_y,) and roots of weights (n_y,)."""
    low, high = model.speed_range
    both = np.hstack([drive.y, model.simulate(drive.v, drive.u, drive.y[0])])
    total = np.concatenate([[0.0], np.cumsum(drive.v)])
    for k in range(1, estimator.n_bins):
        N = int(estimator.length[k])
        starts = np.flatnonzero(estimator.counted(drive.v, k))[:: int(estimator.hop[k])]
        speed = (total[starts + N] - total[starts]) / N
        Y, Z = np.split(estimator.transform(both, k, starts), 2, axis=1)
        cell = np.floor((speed - low) / (high - low) * CELLS)
        for c in np.unique(cell):
            at = cell == c
            power = np.sum(np.abs(Z[at]) ** 2, axis=0)
            if at.sum() < FEWEST_FRAMES or not power.all():
                continue
            cross = np.sum(Y[at] * Z[at].conj(), axis=0)
            coherence = np.abs(cross) / np.sqrt(power * np.sum(np.abs(Y[at]) ** 2, axis=0))
            yield i, k, float(speed[at].mean()), cross / power, coherence
