"""Compute bounds and weights from few frames, quickly enough for a search over trade-offs.

A frame is deciding if no other frame of its bin exceeds it in B1, |Z| and |delta0| at once. The rule of
gamma_w (T8) and nu (T5) increase with each of the three. Their maxima over the deciding frames are therefore
their maxima over all frames. Deciding frames start at every sample of the drives that set the bounds. Frames
within NEAR of a kept frame are left out. Without the drives, the sample of frames in ``spectra.npz`` is used.
For each bin, this sample holds the frames of largest |E| and some random ones, on the core's grid. The
largest |w_j| over the sample and the deciding frames only approximates its bound. The result serves to choose
a trade-off. `identify` then computes the bounds for that choice.

Class S2 (paper, K_is) needs the input u and the nominal state of a frame. The frozen model at the frame's
mean speed gives both from Z. u is the least-squares input that yields Z, and ``x_nom = (zI - A_d)^-1 B_d u``.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from ..base.errors import InputError
from ..base.progress import Counted, Progress
from ..engine.validation import s1, s2
from ..identify.bounds import FrameSet, counted_frames, explain, reduce_disturbance
from ..identify.identification import DriveSet, StoredIdentification
from ..identify.weights import (
    SMALLEST_NU,
    FittedWeight,
    disturbance_weights,
    fit_bound,
    fit_uncertainty,
    smallest_disturbance,
)

NEAR = 0.02


@dataclass(frozen=True)
class Split:
    """Largest uncertainty and disturbance of each bin that explain the errors of its frames.

    Values are NaN in a bin without frames.

    Attributes
    ----------
    gamma_w : ndarray (K,)
    nu_i : ndarray (K,), input-multiplicative uncertainty
    nu_s : ndarray (K,) or None, 1/s, uncertainty of the state; None in class S1
    B_w : ndarray (K, n_y), disturbance; it covers all outputs jointly if the project requires it
    at_cap : int
        Number of frames whose best nu_s reached the well-posedness limit. nu_i alone explains these frames.
    """

    gamma_w: np.ndarray
    nu_i: np.ndarray
    nu_s: np.ndarray | None
    B_w: np.ndarray
    at_cap: int = 0


@dataclass(frozen=True)
class SplitWeights:
    """Weights that steps 6 and 7 fit to a Split; W_delta_s is None in class S1."""

    W_w: list[FittedWeight]
    W_delta_i: FittedWeight
    W_delta_s: FittedWeight | None


class StoredFrames:
    """Frames of the drives that set the bounds: the stored sample and, with drives, the deciding frames.

    Parameters
    ----------
    stored : StoredIdentification
    drives : DriveSet, optional, the identification's drives
    progress : Progress, default lambda _: None
    """

    def __init__(
        self,
        stored: StoredIdentification,
        drives: DriveSet | None = None,
        progress: Progress = lambda _: None,
    ):
        self.stored, self.project = stored, stored.project
        self.model, self.estimator = stored.model, stored.estimator
        path = stored.folder / "spectra.npz"
        with np.load(path) as spectra:
            if "speed" not in spectra:
                raise InputError(
                    path,
                    "speed",
                    "missing",
                    "an identification made by this version: run `lpvguard identify` again",
                )
            columns = {key: spectra[key] for key in ("bin", "start", "speed", "E", "Z")}
        self.sets, self.speeds = [], []
        for k in range(self.estimator.n_bins):
            of_bin = columns["bin"] == k
            E, Z, starts = (columns[key][of_bin] for key in ("E", "Z", "start"))
            self.sets.append(FrameSet(k, E, Z, starts, str(path)))
            self.speeds.append(columns["speed"][of_bin])
        self.complete = drives is not None
        if drives is not None:
            self._add_deciding(drives, progress)

    def _add_deciding(self, drives: DriveSet, progress: Progress) -> None:
        sets_and_speeds = [(s, v) for s, v in zip(self.sets, self.speeds, strict=True)]
        names = self.stored.manifest["drives"]["bounds"]
        for i, name in enumerate(names):
            progress(Counted(f"deciding frames of {name}", i, len(names)))
            drive, e, yhat = drives.load(name)
            total = np.concatenate([[0.0], np.cumsum(drive.v)])
            for s in counted_frames(drive, e, yhat, self.model, self.estimator):
                N, (old, speed) = self.estimator.length[s.bin], sets_and_speeds[s.bin]
                keep = deciding(s.E, s.Z)
                E, Z, starts = (
                    np.concatenate([getattr(old, key), getattr(s, key)[keep]]) for key in ("E", "Z", "starts")
                )
                sets_and_speeds[s.bin] = (
                    FrameSet(s.bin, E, Z, starts, old.experiment),
                    np.concatenate([speed, (total[s.starts[keep] + N] - total[s.starts[keep]]) / N]),
                )
        self.sets, self.speeds = map(list, zip(*sets_and_speeds, strict=True))

    def gamma_rule(self, ceiling: np.ndarray) -> np.ndarray:
        """Compute gamma_w (K,) of step 4 before smoothing, for a ceiling (K,) on nu."""
        return reduce_disturbance(self.sets, self.estimator, ceiling, self.project.n_y)["gamma_rule"]

    def smooth(self, rule: np.ndarray) -> np.ndarray:
        """Compute gamma_w (K,): the magnitude, at the bins, of a smooth weight above the rule."""
        floor = smallest_disturbance(self.stored.bounds["B2"])
        return fit_bound(self.project, self.estimator, rule, "gamma_w", floor).magnitude(self.estimator.omega)

    def explain(self, gamma_w: np.ndarray) -> Split:
        """Find the least nu_i of class S1 for gamma_w (K,)."""
        nu, w = zip(*(explain(s, self.estimator, gamma_w, "S1") for s in self.sets), strict=True)
        return Split(gamma_w, np.array([_largest(n) for n in nu]), None, self._disturbance(w))

    def explain_with_state(self, gamma_w: np.ndarray, lambda_s: float) -> Split:
        """Minimise nu_i^2 + lambda_s nu_s^2 of class S2 for gamma_w (K,).

        lambda_s [s^2] is the second entry of Lambda_nu = diag(1, lambda_s).
        """
        nu_i, nu_s, all_w, at_cap = [], [], [], 0
        for s, v in zip(self.sets, self.speeds, strict=True):
            nu, w = explain(s, self.estimator, gamma_w, "S1")
            state = np.zeros(len(nu))
            needing = np.flatnonzero((nu > 0) & (np.linalg.norm(s.Z, axis=1) > 0))
            if len(needing):
                u, x_nom, h_i, h_s = self._behind(s.Z[needing], v[needing], self.estimator.omega[s.bin])
                split = s2.solve(
                    s.E[needing], u, x_nom, h_i, h_s, self.model.C, gamma_w[s.bin], 1.0, lambda_s
                )
                at_cap += int(np.count_nonzero(split.at_cap))
                # S1 is S2 with nu_s = 0. It is kept where it has the lower cost, for example where Z is far
                # from a frozen response.
                good = ~split.at_cap & (split.upper <= nu[needing] ** 2)
                nu[needing[good]], state[needing[good]], w[needing[good]] = (
                    split.nu_i[good],
                    split.nu_s[good],
                    split.w[good],
                )
            nu_i.append(_largest(nu))
            nu_s.append(_largest(state))
            all_w.append(w)
        return Split(gamma_w, np.array(nu_i), np.array(nu_s), self._disturbance(all_w), at_cap)

    def weights(self, split: Split) -> SplitWeights:
        """Fit the weights of steps 6 and 7."""
        project, estimator, fitted = self.project, self.estimator, self.stored.fitted
        floor = smallest_disturbance(self.stored.bounds["B2"])
        B_w = [
            fit_bound(project, estimator, split.B_w[:, j], f"B_w of {s.name}", floor)
            for j, s in enumerate(project.outputs)
        ]

        error, nu_s = self.stored.model_error, split.nu_s
        state = None
        if nu_s is not None:
            # W_delta_s is in 1/s. W_delta_i already covers the model error. W_delta_s covers what the frames
            # need, without a dip at bins that need nothing.
            known = np.where(estimator.cycles > 0, np.fmax.accumulate(np.nan_to_num(nu_s)), np.nan)
            state = fit_bound(project, estimator, known, "W_delta_s", SMALLEST_NU)
        return SplitWeights(
            disturbance_weights(project, estimator, B_w, fitted.W_n, floor)[0],
            fit_uncertainty(
                project, estimator, error.grid.omega, (split.nu_i, error.bound[:, 0], "W_delta_i")
            ),
            state,
        )

    def _disturbance(self, w) -> np.ndarray:
        """Compute B_w (K, n_y) from the disturbances of all frames: ``w`` holds one (F, n_y) for each bin."""
        B_w = np.array(
            [_largest(np.abs(one)) if len(one) else np.full(self.project.n_y, np.nan) for one in w]
        )
        if self.project.bounds.disturbance_set == "covering":
            for k, one in enumerate(w):
                if len(one):
                    relative = np.divide(np.abs(one), B_w[k], out=np.zeros(one.shape), where=B_w[k] > 0)
                    B_w[k] *= max(1.0, np.linalg.norm(relative, axis=1).max())
        return B_w

    def _behind(self, Z, v, omega):
        """Compute the input u (F,) after the delay, x_nom (F, n), h_i (F, n) and h_s (F, n, n) of frames.

        v (F,) [m/s] are the frames' speeds. ``omega`` [rad/s] is the frequency of their bin.
        """
        speeds, index = np.unique(
            np.round(v, 2), return_inverse=True
        )  # 1 cm/s changes no entry by more than 1e-3
        A, B = self.model.matrices(np.clip(speeds, *self.model.speed_range))
        n, Ts, z = self.model.n, self.project.Ts_s, np.exp(1j * omega * self.project.Ts_s)
        augmented = np.zeros((len(A), 2 * n, 2 * n))
        augmented[:, :n, :n], augmented[:, :n, n:] = A * Ts, np.eye(n) * Ts
        sampled = expm(augmented)
        Ad, Gd = sampled[:, :n, :n], sampled[:, :n, n:]
        h_s = np.linalg.solve(z * np.eye(n) - Ad, Gd)
        h_i = (h_s @ B)[:, :, 0]
        response = h_i @ self.model.C.T
        h_s, h_i, response = h_s[index], h_i[index], response[index]
        u = np.sum(response.conj() * Z, axis=1) / np.sum(np.abs(response) ** 2, axis=1)
        return u, h_i * u[:, None], h_i, h_s


def deciding(E: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Return the indices of the deciding frames of E, Z (F, n_y).

    For every frame there is a deciding frame d. The frame's B1, |Z| and |delta0| are at most 1 + NEAR times
    those of d.
    """
    size = np.linalg.norm(E, axis=1)
    values = (s1.solve(E, Z, size).b1, np.linalg.norm(Z, axis=1), np.abs(s1.least_squares_delta(E, Z)))
    with np.errstate(divide="ignore"):
        # Values are rounded to steps of a factor 1 + NEAR. A frame replaces another frame if none of its
        # three steps is smaller.
        steps = [np.unique(np.floor(np.log(x) / np.log1p(NEAR)), return_inverse=True)[1] for x in values]
    i, j, k = steps
    highest = np.full((i.max(initial=0) + 2, j.max(initial=0) + 2), -1)
    np.maximum.at(highest, (i, j), k)
    beyond = np.maximum.accumulate(np.maximum.accumulate(highest[::-1, ::-1], axis=0), axis=1)[::-1, ::-1]
    largest = np.flatnonzero((k == highest[i, j]) & (k > beyond[i + 1, j]) & (k > beyond[i, j + 1]))
    _, first = np.unique(np.column_stack([i, j])[largest], axis=0, return_index=True)
    return np.sort(largest[first])


def _largest(values: np.ndarray) -> np.ndarray | float:
    return values.max(axis=0) if len(values) else np.nan
