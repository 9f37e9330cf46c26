"""Multi-body car with a known true error: vehicle 1 of the optional package commonroad-vehicle-models.

The model has 29 states: suspension, tyres by the magic formula, wheel spin, steering rate limit (Althoff,
Koschi and Manzinger, CommonRoad: vehicle models, 2017). Python integrates it sample by sample; one minute of
driving takes about four seconds. The drives are therefore made once, and sets are drawn from them.
"""

from functools import partial

import numpy as np

from ...base.errors import InputError
from ...base.parallel import Map
from ...drives.tables import Drive
from ...vehicle.nominal import NominalModel
from ...vehicle.project import Project, load_project
from ._known_cars import NOISE_RPS, PARTS, band_noise, multisine_response, spectral_error

STEP_S = 0.0025
"""Step of the Runge-Kutta method. A step of 0.005 s has an error of 5 % at 3.5 m/s."""
WHEELBASE_M, UNDERSTEER, LAG_S = 2.3927, 8e-4, 0.02
"""Parameters of the car's nominal model v / (L + K v^2), and its lag per speed [s/(m/s)]."""
SPEED_RANGE_MPS = (6.0, 19.0)
SPEED_GAIN = 2.0
"""Gain of the driver: acceleration per speed error [1/s]."""
DRIVES, DURATION_S = 30, 60.0
DISTURBANCE_RPS = 4e-3
"""Rms of the coloured disturbance of the yaw rate."""
EXTRA = "commonroad-vehicle-models is not installed"


def multibody_project() -> Project:
    """Project of the car: the g80's signals and frames with this car's nominal model."""
    project = load_project("g80")
    low, high = SPEED_RANGE_MPS
    parameters = {"L": WHEELBASE_M, "K": UNDERSTEER, "T1": LAG_S / WHEELBASE_M}
    model = project.model.model_copy(
        update={
            "parameters": parameters,
            "speed_min_mps": low,
            "speed_max_mps": high,
            "input_delay_s": 0.02,
            "input_offset": [0.0],
            "output_offset": [0.0],
        }
    )
    return project.model_copy(update={"model": model, "name": "multibody"})


def yaw_rate(Ts: float, columns: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Simulate the yaw rate (N,) [rad/s] from wanted speed (N,) [m/s] and road-wheel angle (N,) [rad]."""
    try:
        from vehiclemodels.init_mb import init_mb
        from vehiclemodels.parameters_vehicle1 import parameters_vehicle1
        from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
    except ImportError:
        raise InputError("bench sharpness", "--multibody", EXTRA, "pip install it") from None
    v, angle = columns
    parameters = parameters_vehicle1()
    x = np.array(init_mb([0.0, 0.0, float(angle[0]), float(v[0]), 0.0, 0.0, 0.0], parameters))
    out = np.empty(len(v))
    steps = round(Ts / STEP_S)
    for k in range(len(v)):
        out[k] = x[5]
        rate = (angle[min(k + 1, len(v) - 1)] - x[2]) / Ts
        for _ in range(steps):
            control = [rate, SPEED_GAIN * (v[k] - x[3])]
            slope = partial(_slope, vehicle_dynamics_mb, control, parameters)
            a = slope(x)
            b = slope(x + 0.5 * STEP_S * a)
            c = slope(x + 0.5 * STEP_S * b)
            x = x + STEP_S / 6 * (a + 2 * b + 2 * c + slope(x + STEP_S * c))
    return out


def _slope(dynamics, control: list[float], parameters, x: np.ndarray) -> np.ndarray:
    return np.array(dynamics(list(x), list(control), parameters))


def multibody_drives(project: Project, seed: int, workers: Map = map) -> list[Drive]:
    """Simulate DRIVES drives of the car; ``workers`` share the drives."""
    random, Ts = np.random.default_rng(seed), project.Ts_s
    low, high = SPEED_RANGE_MPS
    n = round(DURATION_S / Ts) + 1
    mean = random.uniform(low + 0.5, high - 0.5, (DRIVES, 1))
    v = np.clip(mean * (1 + 0.05 * band_noise(random, (DRIVES, n), (0.004, 0.02), Ts)), low + 0.2, high - 0.2)
    size = np.exp(random.uniform(np.log(0.015), np.log(0.08), (DRIVES, 1))) / (1 + (mean / 12) ** 2)
    angle = size * sum(w * band_noise(random, (DRIVES, n), band, Ts) for w, band in PARTS)
    rates = list(workers(partial(yaw_rate, Ts), list(zip(v, angle, strict=True))))
    disturbance = DISTURBANCE_RPS * band_noise(random, (DRIVES, n), (0.03, 1.0), Ts)
    r = np.array(rates) + disturbance + NOISE_RPS * random.standard_normal((DRIVES, n))
    t = Ts * np.arange(n)
    return [Drive(f"multibody_{k:02d}", t, v[k], angle[k, :, None], r[k, :, None]) for k in range(DRIVES)]


def multibody_error(
    model: NominalModel, omega: np.ndarray, speed: np.ndarray, amplitude: np.ndarray, workers: Map = map
) -> np.ndarray:
    """Compute the complex error (G, S, A) of the car's best linear approximation.

    The shapes are omega (G,) [rad/s], speed (S,) [m/s] and amplitude (S, A) [rad]. The amplitude is sqrt(2)
    times the rms of the angle.
    """

    def rates(v: np.ndarray, angle: np.ndarray) -> np.ndarray:
        return np.array(list(workers(partial(yaw_rate, model.Ts), list(zip(v, angle, strict=True)))))

    return spectral_error(
        model, omega, speed, amplitude, *multisine_response(model.Ts, speed, amplitude, 1, rates)
    )
