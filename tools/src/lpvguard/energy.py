"""Stage 5, the energy test: one causal Delta for all outputs, from rest until now (DESIGN 4.8; lib/include/lpvguard/energy.h).

    || sum_j a_j F e_j || <= || sum_j a_j F W_delta yhat_j || + sum_j |a_j| sigma_j     for every real a, at every time T,

||x||^2 = sum_{t <= T} rho^(2 (T - t)) x(t)^2. It holds when e_j = Delta (W_delta yhat_j) + w_j with

* Delta linear, time-invariant, causal, |Delta(z)| <= 1 for |z| >= rho, common to all outputs, at rest when the sums begin;
* ||F w_j|| <= sigma_j at every T.

Proof: F commutes with Delta; rho^-t turns the norm into that of plain truncated sums and Delta(z) into Delta(rho z), whose gain
over the unit circle bounds the truncated sums because it is causal. So an exceedance falsifies (W_delta, sigma).

**The weight** is a filter, and what counts is its magnitude on |z| = rho. s = (2/Ts) (z/rho - 1)/(z/rho + 1) takes that circle to
the imaginary axis, so the filter W_delta(s(z)) has there the magnitude of the fitted weight at the warped frequency
(2/Ts) tan(omega Ts/2), however slow the weight's poles are. ``verify_overbound`` proves it above the samples of nu at their warped
frequencies, after a gain >= 1 where the weight falls with frequency. F is (plain bilinear) a first-order high-pass and low-pass;
any stable F is sound.

**sigma_j** is the least number with which the inequality of output j alone holds, from rest, at every sample of every drive that
set the bounds or the noise; then all are multiplied by the least common factor with which it holds for the fan of directions a
too. Every direction is a condition by itself; the core tests one a sample in turn.

**Starting in the middle** of a drive, as a core does, the left sum may begin at any time, but the right one must hold what Delta
remembers: it starts at the largest energy met on the identification drives. Then what holds on a whole drive holds on it from any
sample on, but for the transients of the model and of F; the common factor above covers those of drives cut at random.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.signal import bilinear_zpk, lfilter, sosfilt, zpk2sos

from .calibration import Calibration, calibrate
from .errors import InputError
from .frames import Estimator
from .project import Project
from .weights import Weight, verify_overbound

FAN_DIRECTIONS = 16
"""Directions for two outputs, evenly over the half circle in units of sigma."""
FEWEST_SETTLED = 5.0
"""Time constants after which a transient counts as gone, as in frames.py."""
SMALLEST_SIGMA = 1e-2
"""Floor of sigma_j over the largest ||F e_j|| and ||F W_delta yhat_j||: in units of sigma, sums stay where float adds finely enough."""
ROUNDING = 1e-3
"""What float may add to a ratio: a threshold never lies nearer to 1 (test_energy.py measures it)."""


def fan(n_y: int) -> np.ndarray:
    """Directions (D, n_y) up to their sign, sum |a_j| = 1, single outputs among them, in units of sigma."""
    if n_y == 2:
        angle = np.pi * np.arange(FAN_DIRECTIONS) / FAN_DIRECTIONS
        directions = np.column_stack([np.cos(angle), np.sin(angle)])
        directions[FAN_DIRECTIONS // 2, 0] = 0.0
    else:
        signs = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * n_y, indexing="ij"), axis=-1).reshape(-1, n_y)
        directions = signs[len(signs) // 2 + 1:]  # the later half: first entry that is not 0 is positive
    return directions / np.abs(directions).sum(axis=1, keepdims=True)


def _sections(zeros: np.ndarray, poles: np.ndarray, gain: float, rate: float, rho: float) -> np.ndarray:
    """Second-order sections (S, 6) in z of a filter in s, with z/rho for z in the bilinear transform."""
    z, p, k = bilinear_zpk(zeros, poles, gain, rate)
    return zpk2sos(rho * z, rho * p, k)  # as many zeros as poles: the gain is the same


def in_delta(sections: np.ndarray) -> np.ndarray:
    """b0, b1, b2, a1, a2 (S, 5) in the operator z - 1 of sections (S, 6) in z, as the core takes them."""
    b, a = sections[:, :3], sections[:, 3:]
    return np.column_stack([b[:, 0], 2 * b[:, 0] + b[:, 1], b.sum(axis=1), 2 * a[:, 0] + a[:, 1], a.sum(axis=1)])


@dataclass(frozen=True)
class EnergyTest:
    """Filters, sigma and calibration. Units: sigma in the outputs' own; ``start`` (n_y,) energies in units of sigma^2.

    F, W: sections (S, 6) in z. ``gain``: what W_delta was raised by to stay above its bound when warped. ``joint``: the common
    factor >= 1 in sigma that the fan, or a cut drive, asked for. ``directions`` (D, n_y) in units of sigma.
    """

    Ts: float
    memory_s: float
    band_hz: tuple[float, float]
    settle: int
    speed_range: tuple[float, float]
    F: np.ndarray
    W: np.ndarray
    gain: float
    certificate: dict
    directions: np.ndarray
    sigma: np.ndarray
    start: np.ndarray
    joint: float = 1.0
    calibration: Calibration = field(default_factory=lambda: Calibration(1.0 + ROUNDING, {}, None, None))

    @classmethod
    def design(cls, project: Project, estimator: Estimator, W_delta: Weight, omega: np.ndarray, bound: np.ndarray,
               inflation: float) -> EnergyTest:
        """Filters for W_delta, which lies above the samples ``bound`` (K,) at ``omega``, times the final inflation; sigma is 1 yet."""
        Ts, settings = estimator.Ts, project.energy_test
        low, high = settings.band_hz or (project.frames.f_min_hz, project.frames.f_max_hz)
        memory = settings.memory_s or 1.0 / project.frames.f_min_hz
        low_rad, high_rad = (2 / Ts * np.tan(np.pi * f * Ts) for f in (low, high))
        if not memory * low_rad > 1:
            raise InputError(f"vehicle {project.name}", "energy_test", f"memory {memory:g} s, band from {low:g} Hz",
                             f"a memory above {1 / low_rad:.3g} s: the high-pass must forget faster than the sums")
        warped = 2 / Ts * np.tan(np.asarray(omega) * Ts / 2)
        gain = max(1.0, (1 + 1e-9) / verify_overbound(W_delta, warped, bound, name="W_delta, warped").min_ratio)
        raised = Weight(W_delta.num * gain, W_delta.den)
        certificate = verify_overbound(raised, warped, bound, name="W_delta, warped")
        if not certificate.ok:
            raise InputError("W_delta, warped", f"{certificate.min_ratio_at:.4g} rad/s", f"{certificate.min_ratio:.9f} of its bound",
                             "a weight that stays above its bound")
        rho = np.exp(-Ts / memory)
        settle = max(estimator.settle, int(np.ceil(FEWEST_SETTLED / low_rad / Ts)))
        n_y = project.n_y
        return cls(Ts, memory, (low, high), settle, estimator.speed_range,
                   _sections(np.zeros(1), np.array([-low_rad, -high_rad]), high_rad, 1 / Ts, 1.0),
                   _sections(raised.zeros(), raised.poles(), inflation * raised.num[0] / raised.den[0], 1 / Ts, rho),
                   gain, certificate.to_dict(), fan(n_y), np.ones(n_y), np.zeros(n_y))

    @property
    def rho(self) -> float:
        return float(np.exp(-self.Ts / self.memory_s))

    @property
    def rearm(self) -> int:
        """Samples without an exceedance before another alarm: one memory."""
        return int(np.ceil(self.memory_s / self.Ts))

    def at_rest(self) -> EnergyTest:
        """With nothing remembered at the start."""
        return replace(self, start=np.zeros_like(self.start))

    def norms(self, e: np.ndarray, yhat: np.ndarray, v: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Left and right matrices of products (n, n_y, n_y), in units of sigma, per stretch in speed range, where judged."""
        inside = (v >= self.speed_range[0]) & (v <= self.speed_range[1])
        for first, end in np.flatnonzero(np.diff(np.r_[0, inside.astype(np.int8), 0])).reshape(-1, 2):
            if end - first <= self.settle:
                continue
            left = sosfilt(self.F, e[first:end] / self.sigma, axis=0)
            right = sosfilt(self.W, sosfilt(self.F, yhat[first:end] / self.sigma, axis=0), axis=0)
            yield (self._sums(left[self.settle:], np.zeros(len(self.start))), self._sums(right, self.start)[self.settle:])

    def _sums(self, x: np.ndarray, start: np.ndarray) -> np.ndarray:
        products = x[:, :, None] * x[:, None, :]
        forget = self.rho**2
        return lfilter([1.0], [1.0, -forget], products, axis=0, zi=forget * np.diag(start)[None])[0]

    def norm_in(self, sums: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """sqrt(a' G a) (n, D) of matrices (n, n_y, n_y)."""
        return np.sqrt(np.maximum(np.einsum("di,nij,dj->nd", directions, sums, directions), 0.0))

    def ratios(self, e: np.ndarray, yhat: np.ndarray, v: np.ndarray) -> Iterator[np.ndarray]:
        """Left side over right (n, D) in every direction, per stretch in speed range, where judged."""
        for left, right in self.norms(e, yhat, v):
            yield self.norm_in(left, self.directions) / (self.norm_in(right, self.directions) + 1.0)

    def needs(self, e: np.ndarray, yhat: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
        """What a drive asks of sigma: per output and jointly, and the largest norms met; NaN where nothing is judged."""
        nothing = np.full(len(self.sigma), np.nan)
        out = {"sigma": nothing, "error": nothing, "bound": nothing, "joint": np.array(np.nan)}
        single = np.eye(len(self.sigma))
        for left, right in self.norms(e, yhat, v):
            error, bound = self.norm_in(left, single), self.norm_in(right, single)
            joint = self.norm_in(left, self.directions) - self.norm_in(right, self.directions)
            for key, value in (("sigma", (error - bound).max(axis=0)), ("error", error.max(axis=0)),
                               ("bound", bound.max(axis=0)), ("joint", joint.max())):
                out[key] = np.fmax(out[key], value)
        return out

    def with_sigma(self, needs: dict[str, np.ndarray]) -> EnergyTest:
        """sigma per output from ``needs`` over all identification drives, met with sigma = 1; and what Delta may remember at the
        start: the largest energy met, for each output; n_y times, because products of different outputs start at zero."""
        size = np.maximum(needs["error"], needs["bound"])
        if not (size > 0).all():
            raise InputError("energy test", "", "no excited drive that sets the bounds is judged by it", f"{self.settle * self.Ts:.3g} s "
                             f"and more within {self.speed_range[0]:g}..{self.speed_range[1]:g} m/s")
        sigma = np.maximum(needs["sigma"], SMALLEST_SIGMA * size)
        return replace(self, sigma=sigma, start=len(sigma) * (needs["bound"] / sigma) ** 2)

    def with_joint(self, needs: dict[str, np.ndarray]) -> EnergyTest:
        """sigma raised until the fan of directions holds too; ``needs`` met with sigma per output."""
        joint = max(1.0, float(needs["joint"]))
        return replace(self, sigma=self.sigma * joint, start=self.start / joint**2, joint=joint)

    def calibrated(self, scores: dict[str, float], alpha: float) -> EnergyTest:
        """With the threshold from the scores of calibration drives."""
        return replace(self, calibration=calibrate(scores, alpha, floor=1.0 + ROUNDING))

    def coefficients(self) -> tuple[dict[str, int], dict[str, int], dict[str, np.ndarray]]:
        """Sizes, words and numbers of coeff.h."""
        words = {"energy_settle": self.settle, "energy_rearm": self.rearm}
        reals = {"energy_F": in_delta(self.F)[0], "energy_W": in_delta(self.W), "energy_scale": 1 / self.sigma,
                 "energy_forget": -np.expm1(-2 * self.Ts / self.memory_s), "energy_start": self.start,
                 "energy_direction": self.directions, "energy_threshold": self.calibration.threshold}
        return {"NWEIGHT": len(self.W), "NDIRECTIONS": len(self.directions)}, words, reals

    def to_dict(self) -> dict:
        return {"memory_s": self.memory_s, "band_hz": list(self.band_hz), "settle_samples": self.settle, "gain": self.gain,
                "certificate": self.certificate, "directions": self.directions, "sigma": self.sigma, "start": self.start,
                "joint": self.joint, "calibration": self.calibration.to_dict()}

    def restored(self, data: dict, where: str) -> EnergyTest:
        """With the stored sigma and calibration; InputError when ``data`` belongs to other filters."""
        stored = (data["memory_s"], *data["band_hz"], data["settle_samples"])
        if stored != (self.memory_s, *self.band_hz, self.settle):
            raise InputError(where, "memory_s, band_hz, settle_samples", f"{stored}", "those that project.json describes")
        return replace(self, sigma=np.array(data["sigma"]), start=np.array(data["start"]), joint=data["joint"],
                       calibration=Calibration(**data["calibration"]))
