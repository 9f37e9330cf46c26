"""Gaussian prior of the model error and its marginal likelihood over sums of drives (THEORY 7.15)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, cho_solve, solve_triangular
from scipy.optimize import minimize

from .error_domain import AMPLITUDE_KNOTS, SPEED_DEGREE, UNIT_LAGS, ErrorDomain
from .error_sums import DIRECTIONS, ErrorSums

SIZES = {
    "common": 0.1,
    "speed": 0.05,
    "speed_decay": 2.0,
    "amplitude": 0.05,
    "speed_amplitude": 0.05,
    "dynamic": 4.0,
    "direct": 1.0,
    "decay": 2.0,
    "gain": 0.02,
    "delay": 0.05,
    "second": 0.02,
    "group_gain": 0.02,
    "group_delay": 0.05,
    "group_second": 0.02,
}
"""Medians of the hyperparameters.

common, speed, amplitude and speed_amplitude are sizes of the error at zero frequency, by feature. speed_decay
is the power with which the sizes for speed fall with the degree. dynamic is the ratio of the size at the
highest bin to that at zero frequency. direct is the ratio of the direct part to the first lag. decay is
relative to the geometric mean of the frequencies of the bins. All others are deviations of drives and of
groups, as sizes of the error at the highest bin.
"""
SPREAD = 1.0
"""Standard deviation of the logarithms of the hyperparameters."""
IGNORANCE = 1.0
"""Size, at the highest bin, of an error that no data inform. It falls with the square of the frequency."""
IGNORANCE_DECAY = 1.0
"""This size falls by this power of 1 / k for the polynomial of speed of degree k - 1."""
AMPLITUDE_LENGTH = 1.0
"""Correlation length of the error over the amplitude [knots]."""
JITTER = 1e-9
"""Share of the largest variance that is added to a covariance before its root is computed."""
STEP, CURVATURE_STEP = 1e-4, 0.05
"""Steps of the first and second numerical derivatives by the logarithms of hyperparameters."""
TOLERANCE = 1e-2
"""The search ends when the log posterior rises by less than this."""
LARGEST = 4.0
"""Logarithms of hyperparameters stay within this number of SPREAD of their medians."""


@dataclass(frozen=True)
class PriorScales:
    """Factors on the medians of the prior.

    Attributes
    ----------
    common, deviation, ignorance : float
        Factors on all sizes of the common error, of the deviations, and of the uninformed error.
    """

    common: float = 1.0
    deviation: float = 1.0
    ignorance: float = 1.0


USUAL = PriorScales()
"""The prior with its constants unchanged."""


class ErrorPrior:
    """Prior of the lag values of every feature, and of the deviations of drives and groups.

    A hyperparameter vector holds logarithms of ratios to SIZES, in their order.
    """

    def __init__(self, domain: ErrorDomain, groups: bool, scales: PriorScales = USUAL):
        self.domain, self.scales = domain, scales
        self.groups = groups
        self.names = [n for n in SIZES if groups or not n.startswith("group_")]

    @cached_property
    def _centre(self) -> float:
        """Geometric mean of the frequencies of the bins, times the step [rad]."""
        return float(np.exp(np.log(self.domain.omega).mean()) * self.domain.step_s)

    @cached_property
    def _ignorance(self) -> np.ndarray:
        """Root (L, m) of the covariance of the uninformed error.

        It is that of second differences of white values at unit lags.
        """
        count = UNIT_LAGS[1] - UNIT_LAGS[0] - 1
        differences = np.zeros((len(self.domain.lags), count))
        for k in range(count):
            differences[k : k + 3, k] = 1.0, -2.0, 1.0
        highest = 2 - 2 * np.cos(self.domain.omega[-1] * self.domain.step_s)
        return IGNORANCE * self.scales.ignorance / highest / np.sqrt(count) * differences

    @cached_property
    def _alike_amplitudes(self) -> np.ndarray:
        """Root (A, A) of the covariance of errors at the knots of the amplitude."""
        knots = np.arange(AMPLITUDE_KNOTS)
        return _root_of(np.exp(-0.5 * ((knots[:, None] - knots) / AMPLITUDE_LENGTH) ** 2))

    def size(self, x: np.ndarray, name: str) -> float:
        """Hyperparameter ``name`` from the logarithms x (H,)."""
        value = SIZES[name] * float(np.exp(x[self.names.index(name)]))
        if name in ("common", "speed", "amplitude", "speed_amplitude"):
            return value * self.scales.common
        return (
            value if name in ("dynamic", "direct", "decay", "speed_decay") else value * self.scales.deviation
        )

    def root(self, x: np.ndarray) -> np.ndarray:
        """Root (p, r) of the covariance of the lag values of all features, from the logarithms x (H,).

        The product of the root with its transpose is the covariance.
        """
        lags, lag = self.domain.lags, self._lag_root(x)
        speed = self.size(x, "speed") * np.arange(1.0, SPEED_DEGREE + 1) ** -self.size(x, "speed_decay")
        amplitude = self._alike_amplitudes
        blocks = [
            np.diag(np.r_[self.size(x, "common"), speed]),
            self.size(x, "amplitude") * amplitude,
            self.size(x, "speed_amplitude") * amplitude,
        ]
        out = np.kron(block_diag(*blocks), lag)
        count = 1 + SPEED_DEGREE
        by_speed = np.diag(np.arange(1.0, count + 1) ** -IGNORANCE_DECAY)
        ignorance = np.kron(np.eye(len(out) // len(lags), count) @ by_speed, self._ignorance)
        return np.hstack([out, ignorance])

    def _lag_root(self, x: np.ndarray) -> np.ndarray:
        """Root (L, L + 1) of the covariance over lags: a gain, and dynamics that vanish at DC."""
        lags, rate = self.domain.lags, self.size(x, "decay") * self._centre
        far = np.maximum(np.abs(lags)[:, None], np.abs(lags))
        same_side = (lags < 0)[:, None] == (lags < 0)
        gain = (lags == 0).astype(float)
        tuned = np.where(same_side, np.exp(-rate * far), 0.0)
        tuned += tuned.max() * self.size(x, "direct") ** 2 * np.outer(gain, gain)
        root = _root_of(tuned)
        steady = root.T @ self.domain.taps.sum(axis=1)
        # Condition on a response of 0 at zero frequency.
        root -= np.outer(root @ steady, steady) / (steady @ steady)
        highest = self.domain.response(self.domain.omega[-1:])[0]
        root *= self.size(x, "dynamic") / np.linalg.norm(highest @ root)
        return np.column_stack([gain, root])

    def deviation(self, x: np.ndarray, group: bool = False) -> np.ndarray:
        """Variances (DIRECTIONS,) of the deviation of a drive or a ``group``, from the logarithms x (H,)."""
        prefix = "group_" if group else ""
        return np.array([self.size(x, f"{prefix}{n}") ** 2 for n in ("gain", "delay", "second")])


@dataclass(frozen=True)
class Posterior:
    """Gaussian posterior of the lag values of one output for fixed hyperparameters.

    Attributes
    ----------
    mean : (p,) lag values of all features.
    root : (p, r) matrix whose product with its transpose is the covariance.
    evidence : logarithm of the marginal likelihood, less a constant.
    """

    mean: np.ndarray
    root: np.ndarray
    evidence: float


class OutputSums:
    """Sums of one output, from which the posterior for any hyperparameters follows."""

    def __init__(self, sums: ErrorSums, output: int):
        self.gram, self.cross = sums.gram[output], sums.cross[output]
        self.square, self.samples = float(sums.square[output]), float(sums.samples[output])
        self.drive_gram, self.drive_cross = sums.drive_gram[:, output], sums.drive_cross[:, output]
        self.own = sums.drive_own[:, output]
        names = sorted(set(sums.groups))
        self.members = [np.flatnonzero([g == n for g in sums.groups]) for n in names]

    def reduced(
        self, drive: np.ndarray, group: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Sums with the deviations of drives and groups integrated out.

        ``drive`` and ``group`` (DIRECTIONS,) are variances; ``group`` is None where drives have no groups.
        Returns gram (p, p), cross (p,), and the term of the deviations in the log likelihood.
        """
        U, c, A = self.drive_gram, self.drive_cross, self.own
        gram, cross, logs = self._without(self.gram, self.cross, U, c, A, drive)
        if group is None:
            return gram, cross, logs
        H = _inner(A, drive)
        U_left = U - np.einsum("dpi,dij,djk->dpk", U, H, A)
        c_left = c - np.einsum("di,dij,djk->dk", c, H, A)
        A_left = A - A @ H @ A
        U, c, A = (np.stack([x[m].sum(axis=0) for m in self.members]) for x in (U_left, c_left, A_left))
        gram, cross, more = self._without(gram, cross, U, c, A, group)
        return gram, cross, logs + more

    @staticmethod
    def _without(
        gram: np.ndarray, cross: np.ndarray, U: np.ndarray, c: np.ndarray, A: np.ndarray, variance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, float]:
        H = _inner(A, variance)
        root = np.linalg.cholesky(H)
        flat = np.swapaxes(U @ root, 1, 2).reshape(-1, U.shape[1])
        inner = np.einsum("di,dij->dj", c, root)
        gain = 0.5 * float((inner**2).sum())
        sizes = np.linalg.slogdet(np.eye(DIRECTIONS) + variance[:, None] * A)[1]
        return gram - flat.T @ flat, cross - flat.T @ inner.ravel(), gain - 0.5 * float(sizes.sum())

    def posterior(self, prior: ErrorPrior, x: np.ndarray) -> Posterior:
        """Posterior for hyperparameters with the logarithms x (H,)."""
        return self._solved(prior, x)[0]

    def evidence_slope(self, prior: ErrorPrior, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Logarithm of the marginal likelihood and its derivatives (H,) by the logarithms x (H,).

        R is the root of the prior. m and P are the posterior mean and covariance. S and c are the reduced
        sums. l is the term of the deviations in the log likelihood. Changes dR, dS, dc and dl change the
        logarithm by

            (c - S m)' dR w - tr(M^-1 R' S dR) + m' dc - m' dS m / 2 - tr(P dS) / 2 + dl,   m = R w
        """
        posterior, R, gram, cross, logs = self._solved(prior, x)
        variances = self._variances(prior, x)
        P = posterior.root @ posterior.root.T
        left = cross - gram @ posterior.mean
        # S R M^-1 = S R - S P S R, and R' (c - S m) = w.
        by_root = np.outer(left, R.T @ left) - gram @ (R - P @ (gram @ R))
        by_gram = -0.5 * (np.outer(posterior.mean, posterior.mean) + P)
        slope = np.empty(len(x))
        for k, h in enumerate(STEP * np.eye(len(x))):
            after = self._variances(prior, x + h)
            if all(np.array_equal(u, v) for u, v in zip(variances, after, strict=True)):
                slope[k] = (by_root * (prior.root(x + h) - R)).sum() / STEP
                continue
            new_gram, new_cross, new_logs = self.reduced(*after)
            change = (
                (by_gram * (new_gram - gram)).sum() + posterior.mean @ (new_cross - cross) + new_logs - logs
            )
            slope[k] = change / STEP
        return posterior.evidence, slope

    @staticmethod
    def _variances(prior: ErrorPrior, x: np.ndarray) -> list[np.ndarray]:
        return [prior.deviation(x, group) for group in ((False, True) if prior.groups else (False,))]

    def _solved(
        self, prior: ErrorPrior, x: np.ndarray
    ) -> tuple[Posterior, np.ndarray, np.ndarray, np.ndarray, float]:
        """Posterior, the prior's root and the reduced sums of `reduced`."""
        gram, cross, logs = self.reduced(*self._variances(prior, x))
        R = prior.root(x)
        M = R.T @ gram @ R
        M[np.diag_indices_from(M)] += 1.0
        C = np.linalg.cholesky(M)
        inner = R.T @ cross
        solved = cho_solve((C, True), inner)
        evidence = 0.5 * inner @ solved - np.log(np.diag(C)).sum() + logs - 0.5 * self.square
        root = solve_triangular(C, R.T, lower=True).T
        return Posterior(R @ solved, root, float(evidence)), R, gram, cross, logs


def _root_of(covariance: np.ndarray) -> np.ndarray:
    """Lower triangular root (n, n) of a covariance (n, n), after JITTER of its largest variance is added."""
    return np.linalg.cholesky(covariance + JITTER * covariance.max() * np.eye(len(covariance)))


def _inner(A: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Posterior covariance (D, 3, 3) of deviations with products A (D, 3, 3) and prior variances (3,)."""
    return np.linalg.inv(np.diag(1 / variance) + A)


@dataclass(frozen=True)
class Hyperparameters:
    """Most probable hyperparameters ``x`` (H,), logarithms of ratios to SIZES, and their spread.

    ``root`` (H, H) times its transpose is their covariance.
    """

    x: np.ndarray
    root: np.ndarray

    def draws(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Draws (count, H) of the logarithms. The first draw is the most probable value."""
        normal = random.standard_normal((count, len(self.x)))
        normal[0] = 0.0
        limit = LARGEST * SPREAD
        return np.clip(self.x + normal @ self.root.T, -limit, limit)


def hyperparameters(prior: ErrorPrior, sums: OutputSums) -> Hyperparameters:
    """Hyperparameters with the largest posterior probability, and their covariance by Laplace's method."""
    n, limit = len(prior.names), LARGEST * SPREAD

    def loss(x: np.ndarray) -> tuple[float, np.ndarray]:
        evidence, slope = sums.evidence_slope(prior, x)
        return 0.5 * float(x @ x) / SPREAD**2 - evidence, x / SPREAD**2 - slope

    scale = max(1.0, abs(loss(np.zeros(n))[0]))
    fit = minimize(
        loss,
        np.zeros(n),
        jac=True,
        method="L-BFGS-B",
        bounds=[(-limit, limit)] * n,
        options={"maxiter": 200, "ftol": TOLERANCE / scale},
    )
    apart = CURVATURE_STEP * np.eye(n)
    hessian = np.array([loss(fit.x + h)[1] - loss(fit.x - h)[1] for h in apart]) / (2 * CURVATURE_STEP)
    values, vectors = np.linalg.eigh(0.5 * (hessian + hessian.T))
    # The prior alone has the curvature 1 / SPREAD^2.
    return Hyperparameters(fit.x, vectors / np.sqrt(np.maximum(values, 0.5 / SPREAD**2)))
