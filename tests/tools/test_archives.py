"""The wheel and the source archive of the package."""

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
from hatchling.build import build_sdist

from made import ROOT


def contents_of_wheel(source: Path, folder: Path) -> set[str]:
    """Names of the files in the wheel of a folder or of a source archive."""
    words = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", folder]
    subprocess.run([*words, source], check=True)
    (wheel,) = folder.glob("*.whl")
    assert wheel.stat().st_size < 25e6
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


@pytest.mark.unhurried
def test_a_source_archive_gives_the_wheel_of_the_checkout(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT / "tools")
    archive = tmp_path / build_sdist(os.fspath(tmp_path))
    with tarfile.open(archive) as packed:
        assert not [name for name in packed.getnames() if "/." in name.removesuffix("/.gitignore")]
    names = contents_of_wheel(archive, tmp_path / "of_archive")
    assert "lpvguard/_lib/src/monitor/monitor.cpp" in names
    assert names == contents_of_wheel(ROOT / "tools", tmp_path / "of_checkout")
