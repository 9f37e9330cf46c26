"""Vehicles of any supported size, for tests of the core's generality: no car, but stable, scheduled and
seeded."""

from dataclasses import dataclass

import numpy as np

from lpvguard.core.control_coefficients import ControllerCoefficients, build_controller
from lpvguard.vehicle.project import Project, parse_project

TS = 0.01
SPEEDS = (8.0, 22.0)
PERIODS, BINS_PER_DECADE, SHORTEST = 6, 50, 332
"""The shortest frame holds SHORTEST samples; a half one exceeds the latency of 64 bins."""


@dataclass(frozen=True)
class Sizes:
    """States, inputs, outputs, bins (DC included), whole samples of input delay, controller states of each
    demand; class of the model error."""

    n_x: int
    n_u: int
    n_y: int
    bins: int
    delay: int = 0
    n_k: int = 1
    structure: str = "S1"


def synthetic_project(sizes: Sizes, name: str = "synthetic") -> Project:
    """A chain of ``n_x`` first-order lags whose rates rise with speed, each driving the one before it."""
    rng = np.random.default_rng([sizes.n_x, sizes.n_u, sizes.n_y])
    n = sizes.n_x
    A = [[0.0] * n for _ in range(n)]
    for i in range(n):
        A[i][i] = f"-{rng.uniform(4.0, 12.0):.6f} - {rng.uniform(0.05, 0.1):.6f}*v"
        if i + 1 < n:
            A[i][i + 1] = float(rng.uniform(1.0, 3.0))
    B = [
        [f"{rng.uniform(0.5, 1.0):.6f} + v/{rng.uniform(50, 100):.6f}" for _ in range(sizes.n_u)]
        for _ in range(n)
    ]
    C = rng.uniform(0.2, 1.0, (sizes.n_y, n)) + (np.arange(n) % sizes.n_y == np.arange(sizes.n_y)[:, None])
    f_max = PERIODS / (SHORTEST * TS)

    def signal(role: str, i: int, limit: float) -> dict:
        return {
            "name": f"{role}_{i}",
            "role": role,
            "column": f"{role[0]}{i}",
            "unit": "1",
            "positive": "left",
            "min": -limit,
            "max": limit,
        }

    return parse_project(
        {
            "schema": 1,
            "name": name,
            "title": "Synthetic test vehicle",
            "Ts_s": TS,
            "seed": 1,
            "signals": [
                {**signal("scheduling", 0, 1.0), "unit": "m/s", "min": -1.0, "max": 60.0},
                *(signal("input", i, 10.0) for i in range(sizes.n_u)),
                *(signal("output", j, 1e4) for j in range(sizes.n_y)),
            ],
            "model": {
                "speed_min_mps": SPEEDS[0],
                "speed_max_mps": SPEEDS[1],
                "input_delay_s": sizes.delay * TS,
                "input_offset": [0.1] * sizes.n_u,
                "output_offset": [-0.2] * sizes.n_y,
                "A": A,
                "B": B,
                "C": C.tolist(),
            },
            "frames": {
                "periods": PERIODS,
                "bins_per_decade": BINS_PER_DECADE,
                "f_max_hz": f_max,
                "speed_tolerance": 0.5,
                "f_min_hz": f_max / 10 ** ((sizes.bins - 2 + 1e-4) / BINS_PER_DECADE)
                if sizes.bins > 2
                else f_max * (1 - 1e-4),
            },
            "bounds": {"structure": sizes.structure, "nu_ceiling": {"f_hz": [1.0], "nu": [0.3]}},
            "weights": {},
            "frame_test": {"excited_std": 0.1},
            "data": {"bound_split": ["train"]},
        },
        name,
    )


def synthetic_controller(sizes: Sizes, *, nodes: int = 5) -> ControllerCoefficients:
    """Stable pairs of poles, from 0.3 to 20 rad/s, and a single one where n_k is odd; L = 0."""
    rng = np.random.default_rng([sizes.n_k, sizes.n_u, sizes.n_y, 9])
    decay, turn = rng.uniform(0.3, 20.0, (2, sizes.n_k // 2))
    d = np.expm1((-decay + 1j * turn) * TS)  # a pole less one, of every pair
    a = np.column_stack([2 * d.real, -(np.abs(d) ** 2)]).ravel()
    scale = TS * np.column_stack([np.ones(len(d)), np.abs(d)]).ravel()
    if sizes.n_k % 2:
        a, scale = np.append(a, np.expm1(-0.5 * TS)), np.append(scale, TS)
    B = (
        np.linspace(1.0, 1.5, nodes)[:, None, None, None]
        * scale[:, None]
        * rng.standard_normal((sizes.n_u, sizes.n_k, 1 + sizes.n_y))
    )
    return build_controller(
        TS,
        np.linspace(*SPEEDS, nodes),
        a,
        B,
        np.zeros((nodes, sizes.n_u, sizes.n_k, sizes.n_u)),
        6.0 * np.add.outer(np.linspace(1.0, 0.6, nodes) ** 2, 0.1 * np.arange(sizes.n_u)),
        np.full(sizes.n_u, 40.0),
    )
