"""Commands on a real vcan0, lent by tools/with-vcan where the kernel has none."""

from __future__ import annotations

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def with_vcan(*words: object, timeout: float = 300) -> subprocess.CompletedProcess[str]:
    """Runs a command there with this checkout's Python package; its output as text, its status unchecked."""
    command = [ROOT / "tools" / "with-vcan", "env", f"PYTHONPATH={ROOT / 'tools' / 'src'}", *words]
    return subprocess.run([str(w) for w in command], capture_output=True, text=True, timeout=timeout, check=False)
