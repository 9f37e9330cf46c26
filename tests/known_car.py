"""Cars whose parameters are known, integrated finely and apart from the package, with a coloured disturbance:
what a fit has to find, and how far it may be off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, lfilter, sosfilt

from lpvguard.drives.tables import Drive
from lpvguard.vehicle.project import Project

TS = 0.02
STEPS = 10  # of the integration, a sample
SPEEDS = (5.0, 9.0, 13.0, 17.0)
NAMES = ("L", "K", "T1", "input_delay_s", "input_offset[0]", "output_offset[0]")


@dataclass(frozen=True)
class KnownCar:
    """A first-order car: wheelbase L [m], understeer K [s^2/m], lag per speed T1 [s/(m/s)], delay [s], trim
    [rad], level [rad/s]."""

    L: float
    K: float
    T1: float
    delay: float
    trim: float
    level: float

    @classmethod
    def drawn(cls, random: np.random.Generator) -> KnownCar:
        """A car of a plausible size."""
        low = (2.3, 1e-3, 4e-3, 0.0, -4e-3, -4e-3)
        high = (3.2, 5e-3, 9e-3, 0.12, 4e-3, 4e-3)
        L, K, T1, delay, trim, level = random.uniform(low, high)
        return cls(L, K, T1, round(delay * STEPS / TS) * TS / STEPS, trim, level)

    @property
    def truth(self) -> np.ndarray:
        """In the order of NAMES, (6,)."""
        return np.array([self.L, self.K, self.T1, self.delay, self.trim, self.level])

    def drive(self, random: np.random.Generator, speed: float, seconds: float, name: str) -> Drive:
        """A drive around a mean speed [m/s]: steering by a driver, side force, noise, grids."""
        n = round(seconds / TS)
        v = speed * (1 + 0.12 * coloured(random, n, (0.01, 0.05)).clip(-2, 2))
        delta = 0.02 * coloured(random, n, (0.03, 0.3)) + 0.01 * coloured(random, n, (0.3, 1.5))
        side = 0.012 * disturbance(random, n)
        lag = round(self.delay * STEPS / TS)
        acted = np.r_[np.full(lag, delta[0]), np.repeat(delta, STEPS)][: n * STEPS] - self.trim
        fine = np.repeat(v, STEPS)
        gain = fine / (self.L + self.K * fine**2)
        decay = np.exp(-TS / STEPS / (self.T1 * self.L * gain))
        wanted = gain * acted + np.repeat(side, STEPS)
        r, x = np.empty(n), wanted[0]
        for k in range(n * STEPS):
            if k % STEPS == 0:
                r[k // STEPS] = x
            x = decay[k] * x + (1 - decay[k]) * wanted[k]
        r = np.round((r + self.level + 7e-4 * random.standard_normal(n)) / 3.5e-4) * 3.5e-4
        return Drive(name, TS * np.arange(n), v, delta[:, None], r[:, None])

    def drives(self, random: np.random.Generator, seconds: float = 90.0) -> list[Drive]:
        """A drive at each of SPEEDS."""
        return [self.drive(random, v, seconds, f"at_{v:g}") for v in SPEEDS]


def coloured(random: np.random.Generator, n: int, band_hz: tuple[float, float]) -> np.ndarray:
    """Gaussian noise (n,) of unit variance within a band."""
    sos = butter(2, band_hz, "bandpass", fs=1 / TS, output="sos")
    x = sosfilt(sos, random.standard_normal(n + 5000))[5000:]
    return x / x.std()


def disturbance(random: np.random.Generator, n: int) -> np.ndarray:
    """Gaussian noise (n,) of about unit variance, with its power from DC to half a hertz."""
    pole = np.exp(-2 * np.pi * 0.5 * TS)
    return lfilter([np.sqrt(1 - pole**2)], [1.0, -pole], random.standard_normal(n + 5000))[5000:]


def guessed(project: Project) -> Project:
    """The project with a stranger's guesses in place of parameters, delay and offsets."""
    model = project.model.model_copy(
        update={
            "parameters": {"L": 2.0, "K": 2e-3, "T1": 1e-2},
            "input_delay_s": 0.05,
            "input_offset": [0.0],
            "output_offset": [0.0],
        }
    )
    return project.model_copy(update={"model": model})
