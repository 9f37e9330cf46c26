"""Folders that many tests read, made once: by one worker of a run, for all of them and for later runs on the
same sources.

A folder lies below build/made/DIGEST. DIGEST is a hash of everything that it is made from: the package, the
core, the simulated truck, the recipes in tests/, the versions of Python, NumPy and SciPy, and the processor.
"""

import fcntl
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy
import scipy

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ("tools/src", "lib", "firmware_sim", "tests/made.py", "tests/any_vehicle.py", "tests/conftest.py")


def digest_of(folder: Path) -> str:
    """Hash of the names and bytes of all files below ``folder``, or of the one file."""
    sha = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()) if folder.is_dir() else [folder]:
        if "__pycache__" not in path.parts:
            content = path.read_bytes()
            sha.update(f"{path.relative_to(folder)} {len(content)} ".encode() + content)
    return sha.hexdigest()


def sources_digest() -> str:
    words = [digest_of(ROOT / name) for name in SOURCES]
    words += [sys.version, numpy.__version__, scipy.__version__, platform.processor()]
    cpuinfo = Path("/proc/cpuinfo")
    words += (
        [line for line in cpuinfo.read_text().splitlines() if line.startswith(("flags", "Features"))][:1]
        if cpuinfo.is_file()
        else []
    )
    return hashlib.sha256("\n".join(words).encode()).hexdigest()[:16]


@contextmanager
def locked(path: Path, kind: int) -> Iterator[bool]:
    """Holds a lock (fcntl.LOCK_*) on a file; False: another process holds it and LOCK_NB was asked for."""
    with path.open("a") as file:
        try:
            fcntl.flock(file, kind)
        except BlockingIOError:
            yield False
            return
        yield True


class Store:
    """The folders of one digest. A test reads them; one that changes something copies it first."""

    def __init__(self, root: Path):
        self.root = root
        self._given: dict[Path, str] = {}
        root.mkdir(exist_ok=True)

    def folder(self, name: str, make: Callable[[Path], None]) -> Path:
        """The folder ``name``; ``make(path)`` writes it when it is not there yet, whole or not at all."""
        target = self.root / name
        with locked(self.root / f".{name}.lock", fcntl.LOCK_EX):
            if not target.is_dir():
                with tempfile.TemporaryDirectory(dir=self.root, prefix=f".{name}-") as scratch:
                    make(Path(scratch) / name)
                    os.replace(Path(scratch) / name, target)
        self._given.setdefault(target, digest_of(target))
        return target

    def changed(self) -> list[str]:
        """Names of the folders that are no longer what was given out; they are removed, so that the next run
        makes them anew."""
        changed = [
            target
            for target, digest in self._given.items()
            if not target.is_dir() or digest_of(target) != digest
        ]
        for target in changed:
            shutil.rmtree(target, ignore_errors=True)
        return [target.name for target in changed]


@contextmanager
def store(base: Path) -> Iterator[Store]:
    """The store below ``base``, held while in use. Folders of other digests that no run holds are removed."""
    base.mkdir(parents=True, exist_ok=True)
    digest = sources_digest()
    with locked(base / f"{digest}.lock", fcntl.LOCK_SH):
        for other in base.iterdir():
            if other.is_dir() and other.name != digest:
                with locked(base / f"{other.name}.lock", fcntl.LOCK_EX | fcntl.LOCK_NB) as free:
                    if free:
                        shutil.rmtree(other, ignore_errors=True)
        yield Store(base / digest)


EXAMPLES = ROOT / "tools" / "examples"


def run_example(name: str, *words: object) -> str:
    """Return what an example script prints."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "tools" / "src")}
    command = [sys.executable, EXAMPLES / name, *map(str, words)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout
