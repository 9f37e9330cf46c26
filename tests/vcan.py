"""Commands on a real vcan0, lent by tools/with-vcan where the kernel has none, or on lo alone."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from parts import require

ROOT = Path(__file__).resolve().parents[1]


def with_vcan(
    *words: object, timeout: float = 300, interfaces: str = "vcan0"
) -> subprocess.CompletedProcess[str]:
    """Runs a command there with this checkout's Python package; its output as text, its status unchecked.
    Skips the test where no kernel has SocketCAN and none can be lent. ``interfaces``: none, and there is lo
    alone, with multicast.

    A run there is in real time, or takes an emulator or UML for itself: its test is marked serial.
    """
    assert "PYTEST_XDIST_WORKER" not in os.environ, "a test on vcan0 needs the marker serial"
    require("uml")
    command = [ROOT / "tools" / "with-vcan", "env", f"PYTHONPATH={ROOT / 'tools' / 'src'}", *words]
    done = subprocess.run(
        [str(w) for w in command],
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
        env={**os.environ, "WITH_VCAN_IFACES": interfaces},
    )
    if done.returncode == 125 and "no AF_CAN here" in done.stderr:
        pytest.skip(done.stderr.strip())
    return done


def sim_words(coefficients: Path, *scenarios: object) -> list[object]:
    """Words of `lpvguard sim` on vcan0 with JSON on standard output."""
    program = [sys.executable, "-m", "lpvguard.cli", "sim", *scenarios]
    return [*program, "--coefficients", coefficients, "--bus", "socketcan:vcan0", "--json", "-"]
