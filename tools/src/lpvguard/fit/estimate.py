"""The fit: parameters, delay and offsets with the least whitened error of prediction.

    e(theta) = y - yhat(theta),   V(theta) = sum over drives and outputs |A(q) e(theta)|^2 / sigma^2

A and sigma are the noise model of the residuals (noise.py). Fit and noise model alternate until theta rests.
This is generalised least squares, which is efficient for a coloured disturbance (Ljung, System
Identification, 2nd ed., 7.5 and 10.2). If that leaves much more of the outputs than plain least squares do,
the residuals are model error and no noise. Then the plain fit is taken. A trim per drive enters linearly and
is projected out.

Standard errors come from a sandwich ``H^-1 S H^-1``. The matrix H comes from the whitened derivatives. The
matrix S is the spread of the scores over blocks of the drives. The errors hold where the noise differs by
speed or drive, and allow for correlation that the noise model leaves.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from ..base.errors import InputError
from ..drives.tables import Drive
from ..vehicle.nominal import NominalModel
from . import noise
from .noise import Whitening
from .stretches import few_stretches, judged_samples, stretches_of
from .unknowns import DELAY, Unknowns

PASSES = 5
"""Most alternations of fit and noise model."""
RESTS = 0.05
"""The fit rests when no unknown moves by more than this share of its standard error."""
BLOCKS, COLOURED_BLOCKS = 120, 40
"""Approximate number of blocks of all drives for the spread of the scores.

Coloured residuals are remembered longer, so the blocks of a plain fit are longer.
"""
WORSE = 1.3
"""Largest ratio of the remainders of a whitened and a plain fit."""
PRECISE, ROUGH = 1e-7, 1e-4
"""Share by which the least squares fall in the last step of a fit, and of its beginning."""
SHORTEST_S = 2.0
"""Shorter stretches of judged speed are left out."""
HOPELESS = 1e3
"""Residual, in sigma, of parameters with which the model is unstable."""


@dataclass(frozen=True)
class Estimate:
    """Values and covariance of the unknowns: theta (p,), covariance (p, p), trims (n_drives, n_u).

    The trims are less the common input_offset; trim_errors has the same shape. Both have no columns where the
    trim is common, and are NaN where nothing is judged.
    """

    unknowns: Unknowns
    theta: np.ndarray
    covariance: np.ndarray
    whitening: list[Whitening]
    trims: np.ndarray
    trim_errors: np.ndarray
    plain: bool
    """Whether plain least squares were taken."""

    @property
    def standard_error(self) -> np.ndarray:
        """Standard errors (p,) in the units of the unknowns."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> np.ndarray:
        """Correlation (p, p) of the estimates' errors."""
        s = np.where(self.standard_error > 0, self.standard_error, 1.0)
        return self.covariance / np.outer(s, s)


class Fit:
    """Drives of one project, and the residuals of any values of its unknowns."""

    def __init__(self, unknowns: Unknowns, drives: Sequence[Drive]):
        self.unknowns, self.drives = unknowns, list(drives)
        project = unknowns.base
        self.Ts, self.n_u, self.n_y = project.Ts_s, project.n_u, project.n_y
        self.own_trim = project.fit.trim == "drive"
        self.whitening: list[Whitening] = []
        self.pieces = self._pieces(unknowns.start)

    def _pieces(self, theta: np.ndarray) -> list[list[slice]]:
        """Judged stretches of each drive: in the speed range, initial state forgotten. InputError without
        any."""
        model = self.unknowns.model(theta)
        shortest = max(round(SHORTEST_S / self.Ts), 3 * noise.LARGEST_ORDER)
        pieces = [stretches_of(judged_samples(model, d.v), shortest) for d in self.drives]
        if not any(pieces):
            low, high = model.speed_range
            raise InputError(
                ", ".join(d.name for d in self.drives),
                "speed",
                f"nowhere {shortest * self.Ts:g} s within {low:g} to {high:g} m/s",
                "drives within speed_min_mps and speed_max_mps, and the speed in m/s",
            )
        return pieces

    def errors(self, theta: np.ndarray) -> list[np.ndarray]:
        """e = y - yhat of every drive, (N, n_y) each; theta (p,)."""
        model = self.unknowns.model(theta)
        return [_error(model, d) for d in self.drives]

    def _trim_response(self, model: NominalModel, d: Drive) -> np.ndarray:
        """Change (N, n_y, n_u) of a drive's e per unit of trim."""
        at_rest = model.simulate(d.v, d.u, d.y[0])
        units = np.eye(self.n_u)
        return np.stack([at_rest - model.simulate(d.v, d.u - unit, d.y[0]) for unit in units], axis=2)

    def _whitened(self, i: int, x: np.ndarray) -> np.ndarray:
        """Whitened, scaled columns of drive i, by output and stretch, of x (N, n_y) or (N, n_y, n)."""
        x = x.reshape(*x.shape[:2], -1)
        parts = [
            w.filtered(x[s, j]) / w.sigma[i] for j, w in enumerate(self.whitening) for s in self.pieces[i]
        ]
        return np.concatenate(parts) if parts else np.zeros((0, x.shape[2]))

    def _model(self, theta: np.ndarray) -> NominalModel | None:
        """The model of theta (p,); None where it is unstable."""
        try:
            return self.unknowns.model(theta)
        except InputError:
            return None

    def _residual(self, i: int, model: NominalModel | None) -> np.ndarray:
        """Whitened residuals (n,) of drive i, its trim projected out; HOPELESS without a model."""
        drive = self.drives[i]
        if model is None:
            return np.full(len(self._whitened(i, drive.y)), HOPELESS)
        e = self._whitened(i, _error(model, drive))
        if not self.own_trim:
            return e[:, 0]
        t = self._whitened(i, self._trim_response(model, drive))
        return e[:, 0] - t @ _regressed(t, e)[:, 0]

    def residuals(self, theta: np.ndarray) -> Iterator[np.ndarray]:
        """Whitened residuals of every drive (n,), its trim projected out; theta (p,)."""
        model = self._model(theta)
        return (self._residual(i, model) for i in range(len(self.drives)))

    def derivatives(self, theta: np.ndarray) -> Iterator[np.ndarray]:
        """Derivatives of the residuals of every drive, (n, p), by central differences inside the ranges."""
        u, moved = self.unknowns, []
        for j, step in enumerate(u.step):
            ends = np.clip(theta[j] + np.array([-step, step]), u.low[j], u.high[j])
            models = [self._model(np.r_[theta[:j], end, theta[j + 1 :]]) for end in ends]
            moved.append((*models, ends[1] - ends[0]))
        for i in range(len(self.drives)):
            yield np.column_stack([(self._residual(i, b) - self._residual(i, a)) / w for a, b, w in moved])

    def _reduced(self, theta: np.ndarray) -> np.ndarray:
        """Residuals and derivatives of all drives, turned into a triangle (p + 1, p + 1) drive by drive.

        An orthogonal transformation keeps norms and products, so least squares are the same. The first
        column are the residuals, with their norm as its only entry.
        """
        size = len(theta) + 1
        triangle = np.zeros((size, size))
        for r, J in zip(self.residuals(theta), self.derivatives(theta), strict=True):
            whole = np.vstack([triangle, np.column_stack([r, J])])
            triangle = np.asarray(np.linalg.qr(whole, mode="r"), float)
        triangle[0] *= np.copysign(1.0, triangle[0, 0])
        return triangle

    def minimised(self, theta: np.ndarray, precision: float = PRECISE) -> np.ndarray:
        """Unknowns (p,) of least V near theta (p,), with the noise model fixed.

        It ends when V falls by less than ``precision``, as a share.
        """
        first = np.eye(len(theta) + 1)[0]
        return least_squares(
            lambda x: first * np.sqrt(sum(r @ r for r in self.residuals(x))),
            self.unknowns.inside(theta),
            lambda x: self._reduced(x)[:, 1:],
            bounds=(self.unknowns.low, self.unknowns.high),
            x_scale="jac",
            ftol=precision,
            xtol=1e-6,
            max_nfev=40,
        ).x

    def begun(self, theta: np.ndarray) -> np.ndarray:
        """Unknowns (p,) of least plain squares on few stretches, from theta (p,) with the best delay."""
        few = few_stretches(self.unknowns.model(theta), self.drives)
        fit = self if few is self.drives else Fit(self.unknowns, few)
        return fit._plain(fit._with_delay(theta), ROUGH)

    def _plain(self, theta: np.ndarray, precision: float) -> np.ndarray:
        """Unknowns (p,) of least plain squares near theta (p,)."""
        self.pieces = self._pieces(theta)
        stretches = self._stretches(self.errors(theta))
        self.whitening = [noise.white([[np.ones(1)] for _ in drives]) for drives in stretches]
        return self.minimised(theta, precision)

    def _with_delay(self, theta: np.ndarray) -> np.ndarray:
        """Theta with the best delay, of those a sample apart, when a gain is free."""
        if DELAY not in self.unknowns.names:
            return theta
        j, best = self.unknowns.names.index(DELAY), (np.inf, theta)
        low, high = self.unknowns.low[j], self.unknowns.high[j]
        for delay in np.linspace(low, high, min(60, max(3, round((high - low) / self.Ts) + 1))):
            trial = np.r_[theta[:j], delay, theta[j + 1 :]]
            left = 0.0
            for d, e, pieces in zip(self.drives, self.errors(trial), self.pieces, strict=True):
                for s in pieces:
                    y, yhat = (x - x.mean(0) for x in (d.y[s], d.y[s] - e[s]))
                    gain = np.sum(y * yhat, 0) / np.maximum(np.sum(yhat * yhat, 0), 1e-300)
                    left += float(np.sum((y - gain * yhat) ** 2 / self._scale**2))
            if left < best[0]:
                best = (left, trial)
        return best[1]

    @property
    def _scale(self) -> np.ndarray:
        """Standard deviations (n_y,) of the outputs over all drives."""
        return np.maximum(np.std(np.concatenate([d.y for d in self.drives]), axis=0), 1e-12)

    def _stretches(self, errors: list[np.ndarray]) -> list[list[list[np.ndarray]]]:
        """Judged stretches of the errors, for each output and each drive."""
        return [
            [[e[s, j] for s in pieces] for e, pieces in zip(errors, self.pieces, strict=True)]
            for j in range(self.n_y)
        ]

    def _trimmed_errors(self, theta: np.ndarray) -> list[np.ndarray]:
        errors = self.errors(theta)
        if not self.own_trim:
            return errors
        trims, _ = self._trims(theta)
        model = self.unknowns.model(theta)
        return [
            e + self._trim_response(model, drive) @ np.nan_to_num(d)
            for e, drive, d in zip(errors, self.drives, trims, strict=True)
        ]

    def _trims(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Trim of every drive beside the common input_offset, and its standard error: (n_drives, n_u).

        It is NaN where nothing is judged, and has no columns where the trim is common.
        """
        if not self.own_trim:
            return np.zeros((len(self.drives), 0)), np.zeros((len(self.drives), 0))
        model = self.unknowns.model(theta)
        trims, errors_of = [], []
        for i, drive in enumerate(self.drives):
            e, t = (self._whitened(i, x) for x in (_error(model, drive), self._trim_response(model, drive)))
            if not len(e):
                trims.append(np.full(self.n_u, np.nan))
                errors_of.append(np.full(self.n_u, np.nan))
                continue
            d = -_regressed(t, e)[:, 0]
            trims.append(d)
            left = np.mean((e[:, 0] + t @ d) ** 2)
            errors_of.append(np.sqrt(left * np.diag(np.linalg.pinv(t.T @ t))))
        return np.array(trims), np.array(errors_of)

    def estimated(self, theta: np.ndarray) -> Estimate:
        """Fit and noise model in turn, from theta (p,) and what few stretches say, until the fit rests."""
        plain = theta = self._plain(self.begun(theta), ROUGH)
        least = self._left(plain)
        for _ in range(PASSES):
            self.pieces = self._pieces(theta)
            self.whitening = [noise.fitted(drives) for drives in self._stretches(self._trimmed_errors(theta))]
            before, theta = theta, self.minimised(theta)
            covariance = self._covariance(theta, BLOCKS)
            if np.all(np.abs(theta - before) <= RESTS * np.sqrt(np.diag(covariance))):
                break
        taken = self._left(theta) > WORSE * least
        if taken:
            theta = self._plain(plain, PRECISE)
            covariance = self._covariance(theta, COLOURED_BLOCKS)
        trims, trim_errors = self._trims(theta)
        if self.own_trim:
            theta, trims = self._mean_trim_written(theta, trims)
        return Estimate(self.unknowns, theta, covariance, list(self.whitening), trims, trim_errors, taken)

    def _left(self, theta: np.ndarray) -> float:
        """Sum of the outputs' remainders, each over its variance, about the mean of each stretch."""
        errors = self._trimmed_errors(theta)
        return sum(
            float(np.sum((e[s] - e[s].mean(0)) ** 2 / self._scale**2))
            for e, pieces in zip(errors, self.pieces, strict=True)
            for s in pieces
        )

    def _mean_trim_written(self, theta: np.ndarray, trims: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The unknowns, with the mean trim as input_offset of their project."""
        mean = np.nanmean(trims, axis=0)
        model = self.unknowns.base.model
        offset = [float(a + b) for a, b in zip(model.input_offset or [], mean, strict=True)]
        base = self.unknowns.base.model_copy(
            update={"model": model.model_copy(update={"input_offset": offset})}
        )
        self.unknowns = Unknowns(
            base, *(getattr(self.unknowns, key) for key in ("names", "start", "low", "high", "step"))
        )
        return theta, trims - mean

    def _covariance(self, theta: np.ndarray, blocks: int) -> np.ndarray:
        """Covariance (p, p) of the unknowns by the sandwich of blocks. Unknowns at an end of their range
        count as known."""
        free = np.array([name not in self.unknowns.at_end(theta) for name in self.unknowns.names])
        residuals = list(self.residuals(theta))
        H = np.zeros((free.sum(),) * 2)
        length = max(1, sum(len(r) for r in residuals) // blocks)
        scores = []
        for r, J in zip(residuals, self.derivatives(theta), strict=True):
            H += J[:, free].T @ J[:, free]
            count = max(1, round(len(r) / length))
            whole = J[:, free] * r[:, None]
            scores += [part.sum(axis=0) for part in np.array_split(whole, count)]
        s = np.array(scores)
        spread = s.T @ s * len(s) / max(1, len(s) - free.sum())
        inverse = np.linalg.pinv(H, hermitian=True)
        covariance = np.zeros((len(theta),) * 2)
        covariance[np.ix_(free, free)] = inverse @ spread @ inverse
        return covariance


def _error(model: NominalModel, drive: Drive) -> np.ndarray:
    """e = y - yhat (N, n_y) of a drive."""
    return drive.y - model.simulate(drive.v, drive.u, drive.y[0])


def _regressed(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Least-squares coefficients (n, 1) of target (N, 1) on columns (N, n)."""
    return np.linalg.lstsq(columns, target, rcond=None)[0]
