"""Simulated car with four redundant measurements of its yaw rate, and single faults of its parts.

The true car is a bicycle model with side slip and tyres without lag. Bank and wind disturb it. Two outputs
are the gyro, and the rear wheels' speed difference divided by the track. The other two are the lateral
acceleration divided by the measured speed, and the course rate of a satellite receiver with lag. Loads, tyres
and sensors differ a little between healthy drives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from ...drives.tables import Drive
from ...vehicle.project import Project, load_project, parse_project
from ._known_cars import band_noise

MASS_KG, YAW_INERTIA, FRONT_M, REAR_M = 2000.0, 3500.0, 1.30, 1.36
FRONT_STIFFNESS, REAR_STIFFNESS = 126e3, 180e3
SPEEDS_MPS = (5.0, 19.0)
LAG_SAMPLES, COURSE_LAG_S = 1, 0.2
LAG = 0.0134
"""Lag of the nominal model per speed [s/(m/s)], fitted to healthy drives."""
STEPS = 4
NOISE = {"yaw_rate": 6e-4, "wheel_rate": 8e-3, "acceleration_rate": 6e-3, "course_rate": 6e-3}
"""Outputs, and standard deviation of their white noise [rad/s]."""
HEALTHY = {"load": 0.03, "tyre": 0.03, "gain": 0.005, "bias": 1e-3, "speed": 0.003, "offset": 4e-4}
"""Spread between healthy drives, relative or in rad/s or rad."""


@dataclass(frozen=True)
class PartFault:
    """Fault of a part. ``kind`` is gain, bias or delay of a signal, or speed, tyre, load or offset."""

    kind: str
    value: float
    signal: str = ""

    @property
    def part(self) -> str:
        """Part that the isolation must name."""
        return {"speed": "speed", "tyre": "vehicle", "load": "vehicle", "offset": "road_wheel_angle"}.get(
            self.kind, self.signal
        )

    @property
    def label(self) -> str:
        """Name of the fault."""
        return {
            "gain": f"{self.signal} × {self.value:g}",
            "bias": f"{self.signal} {self.value:+g} rad/s",
            "delay": f"{self.signal} {self.value:g} s late",
            "speed": f"speed × {self.value:g}",
            "tyre": f"tyres × {self.value:g}",
            "load": f"load × {self.value:g}",
            "offset": f"steering offset {np.degrees(self.value):.2g}°",
        }[self.kind]


FAULTS = (
    *(
        PartFault(kind, value, signal)
        for signal in ("yaw_rate", "wheel_rate")
        for kind, value in (("gain", 0.9), ("bias", 0.02), ("delay", 0.2))
    ),
    PartFault("gain", 0.9, "road_wheel_angle"),
    PartFault("delay", 0.2, "road_wheel_angle"),
    PartFault("speed", 1.05),
    PartFault("tyre", 0.75),
    PartFault("load", 1.25),
    PartFault("offset", float(np.radians(0.5))),
)
"""The twelve single faults. The offset is an offset of the road-wheel angle."""
FURTHER = tuple(
    PartFault(kind, value, signal)
    for signal in ("acceleration_rate", "course_rate")
    for kind, value in (("gain", 0.9), ("bias", 0.02), ("delay", 0.2))
)
"""The same faults for the other two outputs."""
DOUBLE = tuple((FAULTS[i], FAULTS[j]) for i, j in ((0, 4), (1, 11), (2, 6), (8, 9), (3, 9), (0, 8)))
"""Pairs of simultaneous faults of different parts."""

NUISANCES = (
    (PartFault("load", 0.8),),
    (PartFault("load", 1.3),),
    (PartFault("tyre", 0.8),),
    (PartFault("tyre", 1.15),),
    (PartFault("tyre", 0.8), PartFault("load", 1.3)),
)
"""Loads, a wet road or worn tyres, other tyres, and two at once: no faults."""


@cache
def redundant_project() -> Project:
    """Project of the car: the g80's project, with four outputs of one nominal model."""
    document = load_project("g80").model_dump(by_alias=True)
    output = next(s for s in document["signals"] if s["role"] == "output")
    document["signals"] = [s for s in document["signals"] if s["role"] != "output"] + [
        output | {"name": name, "column": name, "can": None} for name in NOISE
    ]
    document["model"] |= {
        "C": [[1.0]] * 4,
        "input_offset": [0.0],
        "output_offset": [0.0] * 4,
        "speed_min_mps": SPEEDS_MPS[0] - 1.5,
        "speed_max_mps": SPEEDS_MPS[1] + 2.0,
    }
    length = FRONT_M + REAR_M
    weak = REAR_M * REAR_STIFFNESS - FRONT_M * FRONT_STIFFNESS
    understeer = MASS_KG * weak / (length * FRONT_STIFFNESS * REAR_STIFFNESS)
    document["model"]["parameters"] |= {"L": length, "K": understeer, "T1": LAG}
    document |= {
        "name": "redundant",
        "title": "A car with four measurements of its yaw rate",
        "design": None,
        "bounds": document["bounds"] | {"structure": "S1_diagonal"},
        "frames": document["frames"] | {"omega_max_radps": 12.566371},
        "isolation": {"vehicle": ["K", "T1"], "speed_power": {"acceleration_rate": -1}},
    }
    return parse_project(document, "the redundant car")


def redundant_drives(
    count: int,
    duration_s: float,
    seed: int,
    faults: Sequence[tuple[PartFault, ...]] = ((),),
    from_s: float = 0.0,
) -> list[list[Drive]]:
    """Simulate drives of the car: one list for every set of faults, which begin at ``from_s``.

    Drive k has the same road, driver and disturbances in every list.
    """
    Ts, random = redundant_project().Ts_s, np.random.default_rng(seed)
    n = round(duration_s / Ts) + 1
    v, angle, force = _driving(random, (count, n), Ts)
    noise = {name: s * random.standard_normal((count, n)) for name, s in NOISE.items()}
    own = {
        key: s * random.standard_normal((count, 1)) for key, s in HEALTHY.items() if key in ("load", "tyre")
    }
    sensors = {key: HEALTHY[key] * random.standard_normal((count, len(NOISE))) for key in ("gain", "bias")}
    speed = 1 + HEALTHY["speed"] * random.standard_normal((count, 1))
    offset = HEALTHY["offset"] * random.standard_normal((count, 1))
    t, drives_by_fault = Ts * np.arange(n), []
    for together in faults:

        def changed(
            kind: str, healthy: float, signal: str = "", together: tuple[PartFault, ...] = together
        ) -> np.ndarray:
            value = next((f.value for f in together if (f.kind, f.signal) == (kind, signal)), healthy)
            return np.where(t >= from_s, value, healthy)

        load = (1 + own["load"]) * changed("load", 1.0)
        rate, slip_rate = _motion(v, angle, force, load, (1 + own["tyre"]) * changed("tyre", 1.0), Ts)
        truth = {
            "yaw_rate": rate,
            "wheel_rate": rate,
            "acceleration_rate": rate + slip_rate,
            "course_rate": _late(rate + slip_rate, np.full(n, COURSE_LAG_S), Ts),
        }
        measured_v = v * speed * changed("speed", 1.0)
        y = []
        for j, (name, x) in enumerate(truth.items()):
            late = _late(x, changed("delay", 0.0, name), Ts)
            scaled = late * (1 + sensors["gain"][:, j, None]) * changed("gain", 1.0, name)
            if name == "acceleration_rate":
                scaled = scaled * v / measured_v
            y.append(scaled + sensors["bias"][:, j, None] + changed("bias", 0.0, name) + noise[name])
        steering = _late(angle, changed("delay", 0.0, "road_wheel_angle"), Ts) * changed(
            "gain", 1.0, "road_wheel_angle"
        )
        steering = steering + offset + changed("offset", 0.0)
        outputs = np.stack(y, axis=-1)
        drives_by_fault.append(
            [
                Drive(f"redundant_{k:03d}", t, measured_v[k], steering[k, :, None], outputs[k])
                for k in range(count)
            ]
        )
    return drives_by_fault


def _driving(
    random: np.random.Generator, shape: tuple[int, int], Ts: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw speed [m/s], road-wheel angle [rad] and side force [N] of drives, each of ``shape`` (count, n)."""
    low, high = SPEEDS_MPS
    mean = random.uniform(low + 2.5, high - 2.5, (shape[0], 1))
    v = np.clip(mean * (1 + 0.25 * band_noise(random, shape, (0.01, 0.05), Ts)), low, high)
    bands = ((0.7, (0.02, 0.12)), (0.35, (0.1, 0.6)), (0.05, (0.5, 2.0)))
    angle = sum(w * band_noise(random, shape, band, Ts) for w, band in bands)
    return v, 0.1 / (1 + 0.02 * mean**2) * angle, 250.0 * band_noise(random, shape, (0.05, 1.0), Ts)


def _late(x: np.ndarray, delay_s: np.ndarray, Ts: float) -> np.ndarray:
    """Delay signals (count, n) by ``delay_s`` (n,), rounded to whole samples."""
    at = np.arange(x.shape[1]) - np.round(delay_s / Ts).astype(int)
    return x[:, np.maximum(at, 0)]


def _motion(
    v: np.ndarray, angle: np.ndarray, force: np.ndarray, load: np.ndarray, tyre: np.ndarray, Ts: float
) -> tuple[np.ndarray, np.ndarray]:
    """Simulate the yaw rate and the rate of the slip angle (count, n) [rad/s].

    ``load`` and ``tyre`` (count, n) are factors.
    """
    acted = np.concatenate([np.repeat(angle[:, :1], LAG_SAMPLES, axis=1), angle[:, :-LAG_SAMPLES]], axis=1)
    slip, rate = np.zeros(len(v)), np.zeros(len(v))
    rates, slips, h = np.empty(v.shape), np.empty(v.shape), Ts / STEPS
    for k in range(v.shape[1]):
        speed, mass, grip = v[:, k], MASS_KG * load[:, k], tyre[:, k]
        rates[:, k] = rate
        for step in range(STEPS):
            front = grip * FRONT_STIFFNESS * (acted[:, k] - slip - FRONT_M * rate / speed)
            rear = grip * REAR_STIFFNESS * (-slip + REAR_M * rate / speed)
            change = (front + rear + force[:, k]) / (mass * speed) - rate
            if step == 0:
                slips[:, k] = change
            slip = slip + h * change
            rate = rate + h * (FRONT_M * front - REAR_M * rear) / (YAW_INERTIA * load[:, k])
    return rates, slips
