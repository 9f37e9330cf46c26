"""Seeded synthetic drives of a passenger car, for machines without the measured data.

The truth is a two-state bicycle model (side-slip and yaw rate, tyre cornering stiffness) with its own delay,
not the nominal model. A lateral disturbance, a sensor bias of each drive, noise and quantisation are added.
The drives replace measured ones in tests and the demo. Numbers about a measured car come from measured drives
only.

A vehicle with a second input, in kN m, has torque vectoring: a yaw moment that acts without delay.
"""

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfilt

from ..base.artefacts import write_files
from ..base.errors import InputError
from ..vehicle.project import Project

Row = tuple[str, str, str]
"""Experiment, split, driver."""

MASS_KG, YAW_INERTIA = 2000.0, 3500.0  # kg, kg m^2
FRONT_M, REAR_M = 1.30, 1.36  # m, centre of gravity to the axles
FRONT_STIFFNESS, REAR_STIFFNESS = 126e3, 180e3  # N/rad per axle; understeer of the nominal model's size
DELAY_SAMPLES = 1
STEPS = 4  # integration steps a sample
ANGLE_GRID_RAD, RATE_GRID_RPS = np.radians(0.1) / 15.87, np.radians(0.02)
# (split, driver, mean speed m/s, duration s): as mixed as the measured runs.
PLAN = [("train", "human", v, 150.0) for v in (5.0, 9.0, 13.0, 16.0, 7.0)] + [
    ("valid", driver, v, 140.0)
    for driver, v in (
        ("human", 6.0),
        ("human", 8.0),
        ("human", 11.0),
        ("mpc", 12.0),
        ("mpc", 14.0),
        ("mpc", 15.0),
        ("mpc", 10.0),
        ("lmpc", 5.0),
        ("lmpc", 5.5),
        ("lmpc", 6.5),
        ("lmpc", 6.0),
    )
]


def _coloured(random: np.random.Generator, n: int, band_hz: tuple[float, float], Ts: float) -> np.ndarray:
    """Gaussian noise of unit variance within a band."""
    x = sosfilt(butter(2, band_hz, "bandpass", fs=1 / Ts, output="sos"), random.standard_normal(n + 2000))[
        2000:
    ]
    return x / x.std()


def _yaw_moment(random: np.random.Generator, n: int, mean_speed: float, Ts: float) -> np.ndarray:
    """Yaw moment (n,) [kN m] that turns the car about three quarters as much as the steering."""
    return 12.0 / (1.0 + 0.02 * mean_speed**2) * _coloured(random, n, (0.05, 1.0), Ts)


def drive_columns(
    random: np.random.Generator, mean_speed: float, duration: float, Ts: float, seed: list[int] | None
) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
    """Simulate a drive of the synthetic car.

    Parameters
    ----------
    random : np.random.Generator
    mean_speed : float, m/s
    duration, Ts : float, s
    seed : list of int, optional, of the yaw moment; None: the car has none

    Returns
    -------
    tuple of the columns, dict of ndarray (n,), and the yaw moment, ndarray (n,) [kN m] or None
    """
    n = round(duration / Ts) + 1
    t = np.arange(n) * Ts
    # Starts and ends at standstill; in between the speed wanders by some ten per cent.
    wander = 0.06 * _coloured(random, n, (0.004, 0.02), Ts)
    v = (
        mean_speed
        * np.clip(np.minimum(t / 8.0, (t[-1] - t) / 8.0), 0.0, 1.0)
        * (1.0 + np.clip(wander, -0.2, 0.2))
    )
    slip_angle = 0.25 / (1.0 + 0.02 * mean_speed**2)
    delta = (
        slip_angle
        * (
            0.7 * _coloured(random, n, (0.02, 0.12), Ts)
            + 0.35 * _coloured(random, n, (0.1, 0.6), Ts)
            + 0.05 * _coloured(random, n, (0.5, 2.0), Ts)
        )
        * 0.4
    )
    side_force = 250.0 * _coloured(random, n, (0.05, 1.0), Ts)  # N: bank and wind
    acted = np.r_[np.zeros(DELAY_SAMPLES), delta[: n - DELAY_SAMPLES]]
    moment = None if seed is None else _yaw_moment(np.random.default_rng(seed), n, mean_speed, Ts)
    turning = np.zeros(n) if moment is None else 1e3 * moment  # N m

    h = Ts / STEPS
    slip, rate, r = 0.0, 0.0, np.empty(n)
    for k in range(n):
        r[k] = rate
        speed = max(v[k], 1.0)  # the slip angle has no meaning at standstill
        for _ in range(STEPS):
            front = FRONT_STIFFNESS * (acted[k] - slip - FRONT_M * rate / speed)
            rear = REAR_STIFFNESS * (-slip + REAR_M * rate / speed)
            slip += h * ((front + rear + side_force[k]) / (MASS_KG * speed) - rate)
            rate += h * (FRONT_M * front - REAR_M * rear + turning[k]) / YAW_INERTIA
    moving = np.clip(v / 2.0, 0.0, 1.0)
    r = r * moving + 1.5e-3 * random.standard_normal() + 9e-4 + 6.5e-4 * random.standard_normal(n)
    columns = {
        "t": t,
        "v": v,
        "delta": np.round(delta / ANGLE_GRID_RAD) * ANGLE_GRID_RAD,
        "r": np.round(r / RATE_GRID_RPS) * RATE_GRID_RPS,
    }
    return columns, moment


def csv_text(columns: dict[str, np.ndarray]) -> str:
    """Write a drive table.

    Parameters
    ----------
    columns : dict of ndarray (n,), by name; the first is the time [s]

    Returns
    -------
    str
    """
    stream = io.StringIO()
    stream.write(",".join(columns) + "\n")
    np.savetxt(
        stream,
        np.column_stack(list(columns.values())),
        fmt=["%.2f", *["%.9g"] * (len(columns) - 1)],
        delimiter=",",
    )
    return stream.getvalue()


def write_drives(project: Project, folder: Path, seed: int, tell: Callable[[str], None]) -> list[Row]:
    """Write the car's drive tables into an existing folder.

    Parameters
    ----------
    project : Project
    folder : Path
    seed : int
    tell : Callable, reports progress

    Returns
    -------
    list of Row, rows of experiments.csv

    Raises
    ------
    InputError
        If a second input is no yaw moment in kN m.
    """
    vectored = project.inputs[1] if project.n_u == 2 else None
    if vectored is not None and vectored.unit != "kN m":
        raise InputError(
            f"vehicle {project.name}",
            f"signal {vectored.name}",
            f"in {vectored.unit}",
            "a yaw moment in kN m",
        )
    rows = []
    for index, (split, driver, speed, duration) in enumerate(PLAN):
        name = f"synthetic_{index:02d}"
        tell(name)
        # One stream a drive: a drive does not change when others are added.
        random = np.random.default_rng([seed, index])
        own = None if vectored is None else [seed, index, 1]
        columns, moment = drive_columns(random, speed, duration, project.Ts_s, own)
        if vectored is not None and moment is not None:
            columns[vectored.column] = moment
        write_files(folder, {f"{name}.csv": csv_text(columns)})
        rows.append((name, split, driver))
    return rows
