"""Simulated cars with a known true model error: a nonlinear single-track model, and the g80's nominal model.

Tyre forces lag by a relaxation length and saturate. The steering has a lag. An elastic element with friction
reduces small steering angles. The true error is the car's describing function divided by the nominal
response, minus 1. It depends on frequency, speed and amplitude. It is measured with sines, without
disturbance.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfilt

from ...drives.tables import Drive
from ...vehicle.nominal import NominalModel
from ...vehicle.project import Project

MASS_KG, INERTIA_KGM2 = 2000.0, 3500.0
FRONT_M, REAR_M = 1.30, 1.36
RELAXATION_M = 0.4
STEPS = 4
"""Number of integration steps per sample."""
PERIODS, SETTLE_S = 3, 4.0
"""Number of measured periods of a sine, and time before the measurement."""
SIDE_FORCE_N, NOISE_RPS, BIAS_RPS = 250.0, 6.5e-4, 1.5e-3
"""Rms of the disturbance by bank and wind, and of the noise and the bias of the yaw rate."""
PARTS = ((0.6, (0.03, 0.2)), (0.4, (0.1, 0.8)), (0.15, (0.6, 3.0)))
"""Components of the steering angle: share of the amplitude, and band [Hz]."""
MULTISINE_S, REALISATIONS = 40.0, 6
"""Period and number of the multisines that measure the best linear approximation."""
START_S = 2.0
"""Time before the record of a drive, in which the filters settle."""


@dataclass(frozen=True)
class Car:
    """Parameters of a car.

    Attributes
    ----------
    front, rear : cornering stiffness of the axles [N/rad].
    grip_n : largest side force of an axle [N].
    steering_lag_s, delay_s : first-order lag and dead time of the steering [s].
    friction_share, friction_rad : share of small angles that friction removes, and largest removed angle.
    """

    front: float = 126e3
    rear: float = 180e3
    grip_n: float = 1e6
    steering_lag_s: float = 0.03
    delay_s: float = 0.02
    friction_share: float = 0.0
    friction_rad: float = 0.01


CARS = {"linear": Car(), "friction": Car(front=115e3, grip_n=14e3, friction_share=0.2)}
"""A nearly linear car, and a car with a softer front axle that loses 20 % of its gain at small amplitudes."""


@dataclass(frozen=True)
class DriveDeviations:
    """Deviation of each drive: gain (D,) and delay (D,) [s]."""

    gain: np.ndarray
    delay_s: np.ndarray


def yaw_rates(car: Car, Ts: float, v: np.ndarray, angle: np.ndarray, side_force: np.ndarray) -> np.ndarray:
    """Simulate yaw rates (D, N) [rad/s] of cars that start straight ahead.

    The inputs (D, N) are the speed v [m/s], the road-wheel angle [rad] at the tyre, and the side force [N].
    """
    h = Ts / STEPS
    out = np.empty_like(v)
    x = np.zeros((6, len(v)))  # steering angle, slip velocity, yaw rate, front and rear force, friction angle
    last = np.zeros(len(v))
    for k in range(v.shape[1]):
        out[:, k] = x[2]
        rate = (angle[:, k] - angle[:, k - 1]) / Ts if k else last
        for step in range(STEPS):
            command = (angle[:, k - 1] if k else angle[:, 0]) + rate * h * step
            middle = x + 0.5 * h * _derivative(car, x, v[:, k], command, side_force[:, k])
            x = x + h * _derivative(car, middle, v[:, k], command + 0.5 * h * rate, side_force[:, k])
            # The stop operator of the steering angle: elastic up to friction_rad, then sliding.
            x[5] = np.clip(x[5] + h * rate, -car.friction_rad, car.friction_rad)
    return out


def _derivative(
    car: Car, x: np.ndarray, v: np.ndarray, command: np.ndarray, side_force: np.ndarray
) -> np.ndarray:
    steering, slip, rate, front, rear, friction = x
    speed = np.maximum(v, 1.0)
    forces = []
    for angle, stiffness in (
        (steering - (slip + FRONT_M * rate) / speed, car.front),
        (-(slip - REAR_M * rate) / speed, car.rear),
    ):
        linear = stiffness * angle
        forces.append(linear / np.sqrt(1 + (linear / car.grip_n) ** 2))
    out = np.zeros_like(x)
    out[0] = (command - car.friction_share * friction - steering) / car.steering_lag_s
    out[1] = (front + rear + side_force) / MASS_KG - v * rate
    out[2] = (FRONT_M * front - REAR_M * rear) / INERTIA_KGM2
    out[3] = (forces[0] - front) * speed / RELAXATION_M
    out[4] = (forces[1] - rear) * speed / RELAXATION_M
    return out


def true_error(
    car: Car, model: NominalModel, omega: np.ndarray, speed: np.ndarray, amplitude: np.ndarray
) -> np.ndarray:
    """Compute the complex error (G, S, A) of a car from its describing function.

    The shapes are omega (G,) [rad/s], speed (S,) [m/s] and amplitude (S, A) of the steering sine [rad].
    """
    Ts, out = model.Ts, np.empty((len(omega), *amplitude.shape), complex)
    v, a = np.repeat(speed, amplitude.shape[1]), amplitude.ravel()
    settle = round(SETTLE_S / Ts)
    for g, w in enumerate(omega):
        count = settle + round(2 * np.pi * PERIODS / w / Ts)
        t = Ts * np.arange(count)
        angle = a[:, None] * np.sin(w * np.maximum(t - car.delay_s, 0.0))
        r = yaw_rates(car, Ts, np.tile(v[:, None], count), angle, np.zeros((len(v), count)))
        carrier = np.column_stack([np.sin(w * t), np.cos(w * t), np.ones(count)])[settle:]
        sine, cosine, _ = np.linalg.lstsq(carrier, r[:, settle:].T, rcond=None)[0]
        nominal = [model.frequency_response(np.array([w]), float(x))[0, 0, 0] for x in speed]
        measured = (sine + 1j * cosine) / a
        out[g] = measured.reshape(amplitude.shape) / np.array(nominal)[:, None] - 1
    return out


def best_linear_error(
    car: Car, model: NominalModel, omega: np.ndarray, speed: np.ndarray, amplitude: np.ndarray
) -> np.ndarray:
    """Compute the complex error (G, S, A) of a car's best linear approximation with inputs like in drives.

    Random-phase multisines with the spectrum of the drives replace the sines of `true_error`. ``amplitude``
    is sqrt(2) times their rms (Pintelon and Schoukens, System Identification, 2012).
    """

    def rates(v: np.ndarray, angle: np.ndarray) -> np.ndarray:
        acted = np.roll(angle, round(car.delay_s / model.Ts), axis=1)
        return yaw_rates(car, model.Ts, v, acted, np.zeros_like(acted))

    U, Y = multisine_response(model.Ts, speed, amplitude, REALISATIONS, rates)
    return spectral_error(model, omega, speed, amplitude, U, Y)


def multisine_response(
    Ts: float,
    speed: np.ndarray,
    amplitude: np.ndarray,
    realisations: int,
    rates: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Compute spectra (S, A, R, K) of angle and yaw rate over the second of two multisine periods.

    The shapes are speed (S,) [m/s] and amplitude (S, A) [rad]. ``rates`` computes the yaw rates (D, N) from
    speeds and angles (D, N).
    """
    n = round(MULTISINE_S / Ts)
    lines = 2 * np.pi * np.fft.rfftfreq(n, Ts)
    random = np.random.default_rng(1)
    shape = np.sqrt(sum(spectrum_of(lines, band) * w**2 / _power(lines, band) for w, band in PARTS))
    phase = np.exp(2j * np.pi * random.random((realisations, len(lines))))
    u = np.fft.irfft(shape * phase, n, axis=1)
    u /= u.std(axis=1, keepdims=True) * np.sqrt(2)
    v = np.repeat(speed, amplitude.shape[1] * realisations)
    size = np.repeat(amplitude.ravel(), realisations)
    angle = size[:, None] * np.tile(np.hstack([u, u]), (amplitude.size, 1))
    r = rates(np.repeat(v[:, None], 2 * n, axis=1), angle)
    U, Y = (np.fft.rfft(x[:, n:], axis=1).reshape(*amplitude.shape, realisations, -1) for x in (angle, r))
    return U, Y


def spectral_error(
    model: NominalModel,
    omega: np.ndarray,
    speed: np.ndarray,
    amplitude: np.ndarray,
    U: np.ndarray,
    Y: np.ndarray,
) -> np.ndarray:
    """Compute the complex error (G, S, A) from spectra U and Y (S, A, R, K), by local least squares.

    The shapes are omega (G,) [rad/s], speed (S,) [m/s] and amplitude (S, A) [rad].
    """
    lines = 2 * np.pi * np.arange(U.shape[-1]) / MULTISINE_S
    out = np.empty((len(omega), *amplitude.shape), complex)
    for g, w in enumerate(omega):
        near = np.abs(np.log(np.maximum(lines, 1e-9) / w)) <= max(0.05, 1.01 * np.pi / MULTISINE_S / w)
        nominal = [model.frequency_response(lines[near], float(x))[:, 0, 0] for x in speed]
        yhat = np.array(nominal)[:, None, None] * U[..., near]
        cross = ((Y[..., near] - yhat) * yhat.conj()).sum(axis=(2, 3))
        out[g] = cross / (np.abs(yhat) ** 2).sum(axis=(2, 3))
    return out


def spectrum_of(omega: np.ndarray, band_hz: tuple[float, float]) -> np.ndarray:
    """Power gain (K,) of the filter of `band_noise` at omega (K,) [rad/s], from its analogue prototype."""
    low, high = (2 * np.pi * f for f in band_hz)
    safe = np.maximum(omega, 1e-9)
    return 1 / (1 + ((safe**2 - low * high) / (safe * (high - low))) ** 4)


def _power(omega: np.ndarray, band_hz: tuple[float, float]) -> float:
    return float(spectrum_of(omega, band_hz).sum())


def deviations_drawn(count: int, gain: float, delay_s: float, random: np.random.Generator) -> DriveDeviations:
    """Draw normal deviations of ``count`` drives with the standard deviations ``gain`` and ``delay_s``."""
    return DriveDeviations(gain * random.standard_normal(count), delay_s * random.standard_normal(count))


def band_noise(
    random: np.random.Generator, shape: tuple[int, int], band_hz: tuple[float, float], Ts: float
) -> np.ndarray:
    """Draw Gaussian noise of unit variance within a frequency band."""
    settle = round(40 / Ts)
    white = random.standard_normal((shape[0], shape[1] + settle))
    x = sosfilt(butter(2, band_hz, "bandpass", fs=1 / Ts, output="sos"), white, axis=1)[:, settle:]
    return x / x.std(axis=1, keepdims=True)


def known_drives(
    car: Car,
    project: Project,
    count: int,
    duration_s: float,
    random: np.random.Generator,
    deviation: DriveDeviations | None = None,
) -> list[Drive]:
    """Simulate drives of a car; each has its own mean speed, amplitude, bias and disturbance.

    ``deviation`` changes the gain of a drive by the factor 1 + gain, and adds to its delay.
    """
    Ts = project.Ts_s
    n = round((duration_s + START_S) / Ts) + 1
    low, high = project.model.speed_min_mps, project.model.speed_max_mps
    mean = random.uniform(low, high, (count, 1))
    v = np.clip(mean * (1 + 0.06 * band_noise(random, (count, n), (0.004, 0.02), Ts)), low, high)
    size = np.exp(random.uniform(np.log(0.015), np.log(0.12), (count, 1))) / (1 + (mean / 12) ** 2)
    delta = size * sum(w * band_noise(random, (count, n), band, Ts) for w, band in PARTS)
    force = SIDE_FORCE_N * band_noise(random, (count, n), (0.03, 1.0), Ts)
    gain, late = (np.zeros(count),) * 2 if deviation is None else (deviation.gain, deviation.delay_s)
    t = np.arange(n) * Ts
    acted = np.array([np.interp(t - car.delay_s - x, t, row) for x, row in zip(late, delta, strict=True)])
    r = yaw_rates(car, Ts, v, acted * (1 + gain[:, None]), force)
    r += BIAS_RPS * random.standard_normal((count, 1)) + NOISE_RPS * random.standard_normal((count, n))
    first = round(START_S / Ts)
    return [
        Drive(
            f"drive_{k:03d}", t[first:] - t[first], v[k, first:], delta[k, first:, None], r[k, first:, None]
        )
        for k in range(count)
    ]
