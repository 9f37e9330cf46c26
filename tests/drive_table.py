"""A drive of the g80 as a table, made up, for tests of what reads it."""

from pathlib import Path

import numpy as np


def table(folder: Path, name: str = "run.csv", **change: np.ndarray | None) -> Path:
    """Write ``folder``/``name``: 30 s at 10 m/s and 50 Hz, steering and yaw rate as sines.

    ``change``: columns (N,) that are put in or replaced; None leaves one out.
    """
    t = np.arange(0, 30, 0.02)
    columns = {
        "t": t,
        "v": np.full_like(t, 10.0),
        "delta": 0.05 * np.sin(2 * t),
        "r": 0.17 * np.sin(2 * t - 0.3),
    } | change
    columns = {k: v for k, v in columns.items() if v is not None}
    path = folder / name
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return path
