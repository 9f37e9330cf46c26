"""Stage 5, the energy test (T19): does one causal Delta for all outputs, or one for each output, explain the
drive?

THEORY 7.2 has the assumptions and the proof. It defines the weight (T20) and the bands F (T21, T22). It also
covers a restart in the middle of a drive (T19b). sigma is first set for every output alone. A common factor
for each band then makes the test hold for the fan of directions too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.signal import bilinear_zpk, lfilter, sosfilt, zpk2sos

from ..base.documents import in_hertz, in_radians
from ..base.errors import InputError
from ..base.runs import runs
from ..core.compiled import band_names
from ..drives.frames import Estimator
from ..engine.overbound.certificate import verify_overbound
from ..engine.overbound.weight import Weight
from ..engine.synthesis.statespace import prewarped
from ..vehicle.project import EnergyTestSettings, Project
from .calibration import ROUNDING, Calibration, RateTarget, Recordings, calibrate
from .remembered import remembered

FAN_BITS = 4
"""With two outputs there are 2^4 directions, evenly over the half circle in units of sigma."""
FEWEST_SETTLED = 5.0
"""A transient counts as ended after this number of time constants, as in drives/frames.py."""
SMALLEST_SIGMA = 1e-2
"""Least sigma_j, relative to the largest ||F e_j|| and ||F W_delta yhat_j||. Float sums in units of sigma are
then accurate enough."""
UNBOUNDED = 1e6
"""Factor on B_w and sigma of the core where the test claims nothing. It makes them far larger than the
signals of a vehicle, but within the range of float (lib/src/monitor/margin.hpp)."""
STATED_RTOL = 1e-8
"""Largest relative difference between stored numbers and those recomputed from the weights."""


def fan(n_y: int) -> np.ndarray:
    """Directions a (D, n_y) up to their sign, in units of sigma, with sum |a_j| = 1.

    They include single outputs.

    For two outputs their order is bit-reversed. Successive judgements then use distant directions, because
    neighbours are nearly equal.
    """
    if n_y == 2:
        turn = np.array([int(f"{k:0{FAN_BITS}b}"[::-1], 2) for k in range(2**FAN_BITS)]) / 2**FAN_BITS
        directions = np.column_stack([np.cos(np.pi * turn), np.sin(np.pi * turn)])
        directions[turn == 0.5, 0] = 0.0
    else:
        signs = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * n_y, indexing="ij"), axis=-1).reshape(-1, n_y)
        directions = signs[
            len(signs) // 2 + 1 :
        ]  # the later half, whose first entry that is not 0 is positive
    return directions / np.abs(directions).sum(axis=1, keepdims=True)


def _sections(zeros: np.ndarray, poles: np.ndarray, gain: float, rate: float, rho: float) -> np.ndarray:
    """Second-order sections (S, 6) in z of a filter in s. z/rho replaces z in the bilinear transform."""
    z, p, k = bilinear_zpk(zeros, poles, gain, rate)
    return zpk2sos(rho * z, rho * p, k)  # there are as many zeros as poles, so the gain is the same


def _bands(corner_rad: np.ndarray, rate: float) -> np.ndarray:
    """Sections (B, S, 6) in z of the band filters between the warped corners [rad/s]."""
    one, nothing = np.zeros(1), np.zeros(0)
    bands = [
        _sections(nothing, -corner_rad, np.prod(corner_rad), rate, 1.0),
        *(
            _sections(one, -corner_rad[b:], np.prod(corner_rad[b + 1 :]), rate, 1.0)
            for b in range(len(corner_rad))
        ),
    ]
    return _padded(bands)


def _padded(filters: list[np.ndarray]) -> np.ndarray:
    """Sections (N, S, 6) of N filters with at most S sections, padded with sections of gain 1."""
    passing = np.array([[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
    most = max(map(len, filters))
    return np.stack([np.concatenate([f, *[passing] * (most - len(f))]) for f in filters])


def in_delta(sections: np.ndarray) -> np.ndarray:
    """Coefficients b0, b1, b2, a1, a2 (..., 5) in the operator z - 1, from sections (..., 6) in z."""
    b, a = sections[..., :3], sections[..., 3:]
    return np.stack(
        [b[..., 0], 2 * b[..., 0] + b[..., 1], b.sum(-1), 2 * a[..., 0] + a[..., 1], a.sum(-1)], axis=-1
    )


def _raised(
    project: Project, W_delta: Sequence[Weight], warped: np.ndarray, bounds: np.ndarray
) -> Iterator[tuple[float, Weight, dict]]:
    """Raise each weight above its bound by a gain >= 1.

    Yields the gain, the weight with this gain, and its certificate. The bounds are the rows of ``bounds``
    (n_delta, K) at ``warped`` (K,) [rad/s].
    """
    if not len(W_delta) == len(bounds) == project.n_delta:
        raise InputError(
            f"vehicle {project.name}",
            "W_delta",
            f"{len(W_delta)} weights, {len(bounds)} bounds",
            f"{project.n_delta} of each for structure {project.bounds.structure}",
        )
    name = "W_delta, warped"
    for W, bound in zip(W_delta, bounds, strict=True):
        gain = max(1.0, (1 + 1e-9) / verify_overbound(W, warped, bound, name=name).min_ratio)
        raised = Weight(W.num * gain, W.den)
        certificate = verify_overbound(raised, warped, bound, name=name)
        if not certificate.ok:
            raise InputError(
                name,
                f"{certificate.min_ratio_at:.4g} rad/s",
                f"{certificate.min_ratio:.9f} of its bound",
                "a weight that stays above its bound",
            )
        yield gain, raised, certificate.to_dict()


def _norm_in(sums: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """sqrt(a' G a) (n, D) for each matrix G of ``sums`` (n, n_y, n_y) and direction a (D, n_y)."""
    products = directions[:, :, None] * directions[:, None, :]
    squares = sums.reshape(len(sums), -1) @ products.reshape(len(directions), -1).T
    return np.sqrt(np.maximum(squares, 0.0))


@dataclass(frozen=True)
class EnergyTest:
    """Filters, sigma and calibration of the energy test in B bands.

    Attributes
    ----------
    Ts, memory_s : float, s
    band_hz : tuple of float, Hz, the B - 1 corners
    settle : int, settling time in samples
    speed_range : tuple[float, float], m/s
    F : ndarray (B, S, 6), sections in z of each band
    W : ndarray (n_delta, S, 6), sections in z of the weight of each Delta
    gain : ndarray (n_delta,), factor on W_delta that keeps it above its bound after warping
    certificate : list of dict, one for each Delta
    directions : ndarray (D, n_y), in units of sigma
    sigma : ndarray (B, n_y), output units
    start : ndarray (B, n_y), bound of the memory at a restart [output units]
    joint : ndarray (B,), common factor >= 1 in sigma for the fan of directions
    calibration : Calibration
    silent : tuple of int, bands without a threshold and without alarms, because no frame shows evidence
    refuting : float, larger ratios also refute the W_delta of the certificate (THEORY 7.18), default 1

    References
    ----------
    THEORY 7.2.
    """

    Ts: float
    memory_s: float
    band_hz: tuple[float, ...]
    settle: int
    speed_range: tuple[float, float]
    F: np.ndarray
    W: np.ndarray
    gain: np.ndarray
    certificate: list[dict]
    directions: np.ndarray
    sigma: np.ndarray
    start: np.ndarray
    joint: np.ndarray
    calibration: Calibration = field(default_factory=lambda: Calibration(1.0 + ROUNDING, {}, None, None))
    silent: tuple[int, ...] = ()
    refuting: float = 1.0

    @classmethod
    def design(
        cls,
        project: Project,
        estimator: Estimator,
        W_delta: Sequence[Weight],
        omega: np.ndarray,
        bound: np.ndarray,
        inflation: float,
    ) -> EnergyTest:
        """Filters for the n_delta weights W_delta of the project, before sigma is known.

        The weights lie above the samples ``bound`` (K, n_delta) at ``omega`` (K,), times the final inflation.
        Raises InputError for settings without a valid test, and for weights of another structure.

        """
        Ts, settings = estimator.Ts, project.energy_test
        corners = settings.band_hz or (project.frames.f_min_hz, project.frames.f_max_hz)
        memory = settings.memory_s or 1.0 / project.frames.f_min_hz
        corner_rad = np.array([2 / Ts * np.tan(np.pi * f * Ts) for f in corners])
        low_rad = corner_rad[0]
        if not memory * low_rad > 1:
            raise InputError(
                f"vehicle {project.name}",
                "energy_test",
                f"memory {memory:g} s, band from {2 * np.pi * corners[0]:.4g} rad/s",
                f"a memory above {1 / low_rad:.3g} s, because the filters must forget faster than the sums",
            )
        warped, bounds = prewarped(np.asarray(omega), Ts), np.transpose(bound)
        gain, raised, certificate = zip(*_raised(project, W_delta, warped, bounds), strict=True)
        rho = np.exp(-Ts / memory)
        settle = max(estimator.settle, int(np.ceil(FEWEST_SETTLED / low_rad / Ts)))
        each = (len(corners) + 1, project.n_y)
        return cls(
            Ts,
            memory,
            tuple(corners),
            settle,
            estimator.speed_range,
            _bands(corner_rad, 1 / Ts),
            _padded(
                [
                    _sections(W.zeros(), W.poles(), inflation * W.num[0] / W.den[0], 1 / Ts, rho)
                    for W in raised
                ]
            ),
            np.array(gain),
            list(certificate),
            fan(project.n_y) if project.n_delta == 1 else np.eye(project.n_y),
            np.ones(each),
            np.zeros(each),
            np.ones(each[0]),
        )

    @property
    def memories_s(self) -> np.ndarray:
        """Time constants (B,) [s] of the left sums. The first one is also that of the right sums."""
        return self.memory_s * np.array([*[1.0] * len(self.band_hz), self.band_hz[0] / self.band_hz[-1]])

    @property
    def single(self) -> bool:
        """True if each output has a separate Delta. Every direction is then one output."""
        return len(self.W) > 1

    @property
    def bands(self) -> tuple[str, ...]:
        """Names of the bands."""
        return band_names(len(self.band_hz) + 1)

    @property
    def rho(self) -> float:
        """Forgetting factor per sample of Delta and the right sums."""
        return float(np.exp(-self.Ts / self.memory_s))

    @property
    def rearm(self) -> int:
        """Number of samples without an exceedance before another alarm, one memory."""
        return int(np.ceil(self.memory_s / self.Ts))

    def sigma_text(self, project: Project) -> str:
        """Text with sigma of each output, below, between and above the corners."""
        bands = ", ".join(self.bands)
        return "; ".join(
            f"{signal.name} {', '.join(f'{x:.3g}' for x in per_band)} {signal.unit} ({bands} the corners)"
            for signal, per_band in zip(project.outputs, self.sigma.T, strict=False)
        )

    @property
    def claim_text(self) -> str:
        """Text with the claim of a ratio above 1 and its assumptions (THEORY 7.2)."""
        blocks = "a Delta for each output" if self.single else "one Delta for all outputs"
        return (
            f"given sigma, a ratio above 1 refutes every error Delta W_delta yhat with {blocks}, linear, "
            f"time-invariant, causal and |Delta(z)| <= 1 for |z| >= {self.rho:.6g} (memory {self.memory_s:g} "
            "s), in every band; after a restart this holds if the model has settled and earlier driving "
            "left no more in Delta, W_delta and the filters than the drives of the identification could"
        )

    def at_rest(self) -> EnergyTest:
        """The test for whole drives, which have no memory before their start."""
        return replace(self, start=np.zeros_like(self.start))

    def norms(
        self, e: np.ndarray, yhat: np.ndarray, v: np.ndarray
    ) -> Iterator[tuple[int, int, np.ndarray, np.ndarray]]:
        """Yield the sums of each stretch in the speed range and each band.

        They are the first judged sample, the band, and the left and right matrices of products (n, n_y, n_y).
        """
        for first, band, *sides in self._sides(e, yhat, v):
            yield first, band, *self._matrices(band, *sides)

    def _matrices(self, band: int, left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Left and right matrices of products (n, n_y, n_y) of a stretch in one band, from `_sides`."""
        of_left = self._sums(band, left[:, None] * left)
        of_right = self._sums(0, right[:, None] * right)[..., self.settle :]
        return np.moveaxis(of_left, -1, 0), np.moveaxis(of_right, -1, 0)

    def _stretches(self, v: np.ndarray) -> Iterator[slice]:
        """Runs of samples within the speed range that are longer than the settling time."""
        inside = (v >= self.speed_range[0]) & (v <= self.speed_range[1])
        for first, end in runs(inside):
            if end - first > self.settle:
                yield slice(first, end)

    def _sides(
        self, e: np.ndarray, yhat: np.ndarray, v: np.ndarray
    ) -> Iterator[tuple[int, int, np.ndarray, np.ndarray]]:
        """Yield the filtered signals of each stretch in the speed range and each band.

        They are the first judged sample, the band, F e from this sample on (n_y, n), and F W_delta yhat from
        ``settle`` samples earlier.
        """
        for stretch in self._stretches(v):
            error, explained = (np.ascontiguousarray(x.T) for x in (e[stretch], self.weighted(yhat[stretch])))
            for band, F in enumerate(self.F):
                yield (
                    stretch.start + self.settle,
                    band,
                    sosfilt(F, error)[:, self.settle :],
                    sosfilt(F, explained),
                )

    def weighted(self, yhat: np.ndarray) -> np.ndarray:
        """W_delta yhat_j (N, n_y) of the nominal output (N, n_y), from rest, with the weight of its Delta."""
        if len(self.W) == 1:
            return sosfilt(self.W[0], yhat, axis=0)
        return np.column_stack([sosfilt(W, column) for W, column in zip(self.W, yhat.T, strict=True)])

    def _sums(self, band: int, products: np.ndarray) -> np.ndarray:
        """Sums over the last axis with the forgetting of a band's left sums. That of band 0 is rho."""
        return lfilter([1.0], [1.0, -np.exp(-2 * self.Ts / self.memories_s[band])], products)

    def _memory(self, band: int, samples: int, a: np.ndarray) -> np.ndarray:
        """Bound (samples, D) of the memory before the restart, in directions ``a`` (D, n_y).

        It begins at the first judged sample.
        """
        fading = self.rho ** (self.settle + 1 + np.arange(samples))
        return np.outer(fading, np.abs(a) @ self.start[band])

    def ratios(self, e: np.ndarray, yhat: np.ndarray, v: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
        """Yield the ratios of each stretch in the speed range and each band.

        They are the first judged sample, the band, and left side / right side (n, D) in every direction.
        """
        for first, band, left, right in self.norms(e, yhat, v):
            a = self.directions / self.sigma[band]
            allowed = _norm_in(right, a) + self._memory(band, len(left), a)
            yield first, band, _norm_in(left, a) / (allowed + 1.0)

    def needs(self, e: np.ndarray, yhat: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
        """Sigma that a drive needs, for each output (B, n_y) and jointly (B,), and its largest norms.

        The drive has e and yhat (N, n_y) and v (N,). The result is NaN where nothing is judged.
        """
        out = {key: np.full(self.sigma.shape, np.nan) for key in ("sigma", "error", "bound")} | {
            "joint": np.full(len(self.F), np.nan)
        }
        for _, band, *sides in self._sides(e, yhat, v):
            needed = self._needs_in(band, *sides)
            for key, value in needed.items():
                out[key][band] = np.fmax(out[key][band], value)
        return out

    def _needs_in(self, band: int, left: np.ndarray, right: np.ndarray) -> dict[str, np.ndarray]:
        """`needs` of a stretch in one band, from the result of `_sides`."""
        if self.single:
            diagonals = self._sums(band, left**2), self._sums(0, right**2)[:, self.settle :]
        else:
            left, right = self._matrices(band, left, right)
            diagonals = tuple(np.einsum("njj->jn", x) for x in (left, right))
        error, bound = (np.sqrt(x) for x in diagonals)
        bound += self._memory(band, bound.shape[1], np.eye(len(bound))).T
        needed = {"sigma": (error - bound).max(axis=1)}
        if self.single:
            joint = (needed["sigma"] / self.sigma[band]).max()
        else:
            a = self.directions / self.sigma[band]
            allowed = _norm_in(right, a) + self._memory(band, len(left), a)
            joint = (_norm_in(left, a) - allowed).max()
        return needed | {"error": error.max(axis=1), "bound": bound.max(axis=1), "joint": joint}

    def memory_met(self, e: np.ndarray, yhat: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Largest memory (B, n_y) of F W_delta yhat and F e at a restart at any sample of a drive.

        The drive has e and yhat (N, n_y) and v (N,). The result is NaN where nothing is judged.
        """
        largest = np.full(self.sigma.shape, np.nan)
        for stretch in self._stretches(v):
            for j, (error, nominal) in enumerate(zip(e[stretch].T, yhat[stretch].T, strict=True)):
                W = self.W[min(j, len(self.W) - 1)]
                for band, F in enumerate(self.F):
                    right = remembered(np.concatenate([W, F]), nominal, self.rho)
                    left = remembered(F, error, self.rho, settle=self.settle)
                    largest[band, j] = np.fmax(largest[band, j], left + right)
        return largest

    def with_sigma(self, needs: dict[str, np.ndarray], floor: np.ndarray | float = 0.0) -> EnergyTest:
        """The test with sigma of each band and output from ``needs`` over all identification drives.

        Sigma is at least ``floor`` (B, n_y), the limit of the sensors. The memory at a restart is the largest
        one of these drives.
        """
        size = np.maximum(needs["error"], needs["bound"])
        if not (size > 0).all():
            raise InputError(
                "energy test",
                "",
                "it judges no excited drive among those that set the bounds",
                f"at least {self.settle * self.Ts:.3g} s "
                f"within {self.speed_range[0]:g}..{self.speed_range[1]:g} m/s",
            )
        sigma = np.maximum(np.maximum(needs["sigma"], SMALLEST_SIGMA * size), floor)
        return replace(self, sigma=sigma, start=needs["memory"])

    def with_joint(self, needs: dict[str, np.ndarray]) -> EnergyTest:
        """The test with sigma raised by a common factor, so that it holds for the fan of directions too.

        ``needs`` are those with sigma of each output, and NaN where nothing is judged.
        """
        joint = np.fmax(1.0, needs["joint"])
        return replace(self, sigma=self.sigma * joint[:, None], joint=joint)

    def calibrated(
        self, scores: dict[str, float], alpha: float, recordings: Recordings, target: RateTarget | None = None
    ) -> EnergyTest:
        """The test with the threshold from the scores of calibration drives."""
        floor = 1.0 + ROUNDING
        return replace(
            self, calibration=calibrate(scores, alpha, floor=floor, recordings=recordings, target=target)
        )

    def coefficients(self) -> tuple[dict[str, int], dict[str, int], dict[str, np.ndarray]]:
        """Sizes, whole numbers and real numbers of this test for coeff.h."""
        words = {"energy_settle": self.settle, "energy_rearm": self.rearm}
        tangent = np.tan(np.pi * np.array(self.band_hz) * self.Ts)
        sigma = self.sigma.copy()
        sigma[list(self.silent)] *= UNBOUNDED
        reals = {
            "energy_corner": tangent / (1 + tangent),
            "energy_W": in_delta(self.W),
            "energy_scale": 1 / sigma,
            "energy_forget": -np.expm1(-2 * self.Ts / self.memories_s),
            "energy_start": self.start,
            "energy_direction": self.directions,
            "energy_threshold": self.calibration.exported,
            "energy_certificate": self.refuting,
        }
        return (
            {"NWEIGHT": self.W.shape[1], "NDIRECTIONS": len(self.directions), "NBANDS": len(self.F)},
            words,
            reals,
        )

    def to_dict(self) -> dict:
        """Convert to JSON types, for `restored`."""
        document = {
            "memory_s": self.memory_s,
            "band_hz": list(self.band_hz),
            "bands": list(self.bands),
            "settle_samples": self.settle,
            "gain": self.gain,
            "certificate": self.certificate,
            "directions": self.directions,
            "sigma": self.sigma,
            "start": self.start,
            "joint": self.joint,
            "calibration": self.calibration.to_dict(),
        }
        return in_radians(document, EnergyTestSettings.FREQUENCIES)

    def restored(self, data: dict, where: str) -> EnergyTest:
        """The test with the stored sigma and calibration of ``data``. Raises InputError for other filters."""
        if "above" in data:  # the field `start` then held squares
            raise InputError(
                where,
                "above",
                "made by an earlier version",
                "an identification by this version: run `lpvguard identify` again",
            )
        corners = in_hertz(data, EnergyTestSettings.FREQUENCIES)["band_hz"]
        stored = (data["memory_s"], *corners, data["settle_samples"], *data.get("bands", ()))
        if stored != (self.memory_s, *self.band_hz, self.settle, *self.bands):
            raise InputError(
                where,
                "memory_s, band_radps, settle_samples, bands",
                f"{(data['memory_s'], data.get('band_radps'), *stored[1 + len(corners) :])}",
                "the values of project.json",
            )
        self._require_stated(data, where)
        return replace(
            self,
            sigma=np.array(data["sigma"]),
            start=np.array(data["start"]),
            joint=np.array(data["joint"]),
            calibration=Calibration.from_dict(data["calibration"]),
        )

    def _require_stated(self, data: dict, where: str) -> None:
        """Raise InputError for impossible values, or for gains and certificates of other weights.

        sigma must be positive, ``start`` not negative, and ``joint`` at least 1.
        """
        least = {"sigma": np.finfo(float).tiny, "start": 0.0, "joint": 1.0}
        for name, low in least.items():
            value, shape = np.array(data[name], float), getattr(self, name).shape
            if value.shape != shape or not (np.isfinite(value) & (value >= low)).all():
                raise InputError(where, name, f"{data[name]}", f"finite numbers {shape} of at least {low:g}")
        if not np.allclose(data["gain"], self.gain, rtol=STATED_RTOL, atol=0):
            raise InputError(where, "gain", f"{data['gain']}", f"{self.gain}, the gain of the weights")
        for one, proved in zip(data["certificate"], self.certificate, strict=True):
            held = one["ok"] and one["min_ratio"] <= proved["min_ratio"] * (1 + STATED_RTOL)
            if not held or one["max_ratio"] < proved["max_ratio"] * (1 - STATED_RTOL):
                raise InputError(
                    where, "certificate", "does not prove the weight", "the certificate of the weights"
                )
