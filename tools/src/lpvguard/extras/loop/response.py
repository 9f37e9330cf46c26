"""The simulated truck's frequency response from the demand, measured with sines (`plant response`).

The demand is held over each sample, and the outputs are read at the sample instants. Hold, brake delay and
brake lag are therefore in the response. Road and wind are calm. The measured outputs are the true ones,
without noise and number grids. The controller's own sample of delay is not in it (control/true_loop.py).
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
    tables : str, variation and faults as scenario tables, "" for the truck itself
    v : float, m/s
    amplitude : float, bar, of the demand
    omega : ndarray (K,), rad/s, wanted; met within 0.05 %, because whole periods take whole samples

    Returns
    -------
    tuple of ndarray (K,) and ndarray (K, n_y) of complex
        Driven frequencies [rad/s] and response [output per bar].

    Raises
    ------
    InputError
        If the truck cannot be driven so.
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
