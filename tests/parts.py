"""Optional parts of the tests (tools/setup.sh installs them): a test that needs one says so, and is skipped
with the reason."""

import importlib.util
import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

from lpvguard.core import targets

PROGRAMS = {
    "chromium": ("chromium",),
    "powerpc": ("powerpc-linux-gnu-gcc", "qemu-ppc"),
    "llvm19": ("clang-19", "clang++-19"),
    "lcm": ("pkg-config", "lcm-gen", "lcm-logger", "lcm-logplayer"),
    "qemu": (),
    "uml": ("candump", "cangen", "cansend", "ip"),
}
"""Part -> programs that the path must have."""


def missing(part: str) -> str:
    """Why the part cannot be used here; empty: it can. LPVGUARD_WITHOUT leaves parts out on purpose."""
    if part in os.environ.get("LPVGUARD_WITHOUT", "").split():
        return f"LPVGUARD_WITHOUT names {part}"
    lost = [p for p in PROGRAMS[part] if shutil.which(p) is None]
    if part == "qemu":
        lost = sorted({tool for target in targets.TARGETS.values() for tool in targets.missing_tools(target)})
    if part == "lcm" and not lost:
        done = subprocess.run(
            ["pkg-config", "--print-errors", "--exists", "lcm"], capture_output=True, text=True, check=False
        )
        if done.returncode:
            return f"pkg-config: {done.stderr.strip().splitlines()[-1]}"
        lost = [] if importlib.util.find_spec("lcm") else ["the Python package lcm"]
    return f"{', '.join(lost)} not found" if lost else ""


def require(part: str) -> None:
    """Skips the test that asks when the part is missing."""
    if why := missing(part):
        pytest.skip(why)


def chromium(folder: Path, url: str, *options: str, host: str = "") -> subprocess.CompletedProcess[str]:
    """Opens a page in headless Chromium, its profile in ``folder``. It finds no host but ``host``."""
    rules = "--host-resolver-rules=MAP * ~NOTFOUND" + (f", EXCLUDE {host}" if host else "")
    alone = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", rules)
    command = ["chromium", *alone, f"--user-data-dir={folder / 'profile'}", *options, url]
    return subprocess.run(command, capture_output=True, text=True, check=True)


@cache
def tool(name: str) -> ModuleType:
    """A program below tools/ as a module, such as ``release.py``."""
    path = Path(__file__).resolve().parents[1] / "tools" / name
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(path.parent))  # as when it runs by itself
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(path.parent))
    return module


def release() -> ModuleType:
    """tools/release.py as a module."""
    return tool("release.py")


def site_builder() -> ModuleType:
    """tools/site/build.py as a module."""
    return tool("site/build.py")
