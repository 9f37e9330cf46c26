"""Measure the simulated truck's frequency response from the demand with sines (`plant response`).

The demand is held over each sample, and the outputs are read at the sample instants. The response therefore
includes hold, brake delay and brake lag. There is no road or wind disturbance. The outputs are the true ones,
without noise and quantisation. The response excludes the controller's own sample of delay
(control/true_loop.py).
"""

import io
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from ...base.errors import InputError
from .generate import plant_tool


def frequency_response(
    tables: str, v: float, amplitude: float, omega: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Measure the truck's frequency response from the demand.

    Parameters
    ----------
    tables : str, variation and faults as scenario tables, "" for the unchanged truck
    v : float, m/s
    amplitude : float, bar, amplitude of the demand
    omega : ndarray (K,), rad/s, wanted frequencies, rounded by up to 0.05 % to whole periods in whole samples

    Returns
    -------
    tuple of ndarray (K,) and ndarray (K, n_y) of complex
        Used frequencies [rad/s] and response [output per bar].

    Raises
    ------
    InputError
        If the truck cannot be driven with these settings.
    """
    tool = plant_tool()
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "truck.toml"
        path.write_text(f"[plant]\nspeed_profile = [[0.0, {v:.9g}]]\n" + tables, encoding="utf-8")
        options = ("--scenario", path, "--speed", f"{v:.9g}", "--amplitude", f"{amplitude:.9g}")
        command = [tool, "response", *options, "--omega", ",".join(f"{w:.9g}" for w in omega)]
        done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise InputError(tool, "response", done.stderr.strip(), "a truck that can be driven")
    rows = np.loadtxt(io.StringIO(done.stdout), delimiter=",", skiprows=1, ndmin=2)
    return rows[:, 0], rows[:, 1::2] + 1j * rows[:, 2::2]
