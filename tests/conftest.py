"""Shared fixtures: the synthetic drives, their identification and compiled core, and the measured drives where present."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from lpvguard import identify as stage
from lpvguard.core import Core
from lpvguard.export import export_vehicle
from lpvguard.generate import generate
from lpvguard.nominal import NominalModel
from lpvguard.project import load_project

ROOT = Path(__file__).resolve().parents[1]


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "requirement(id): verifies this requirement of lib/REQUIREMENTS.md")


def measured_folder() -> Path:
    """Folder of the measured data; the test that asks is skipped, with a reason, when it is absent."""
    folder = Path(os.environ.get("LPVGUARD_DATA", ROOT.parent / "shared" / "data"))
    if not (folder / "genesis_g80" / "experiments.csv").is_file():
        pytest.skip("the measured drives are absent: set LPVGUARD_DATA (data/README.md)")
    return folder


@pytest.fixture(scope="session")
def measured() -> Path:
    return measured_folder() / "genesis_g80"


@pytest.fixture(scope="session")
def g80():
    return load_project("g80")


@pytest.fixture(scope="session")
def g80_model(g80):
    return NominalModel(g80)


@pytest.fixture(scope="session")
def synthetic(g80, tmp_path_factory) -> Path:
    """Folder of the synthetic drives."""
    folder = tmp_path_factory.mktemp("synthetic") / "drives"
    generate(g80, folder, seed=7)
    return folder


@pytest.fixture(scope="session")
def identified(g80, synthetic, tmp_path_factory) -> Path:
    """Identification folder of the synthetic drives."""
    folder = tmp_path_factory.mktemp("identified") / "g80"
    stage.save(*stage.identify(g80, synthetic), folder)
    return folder


@pytest.fixture(scope="session")
def vehicle(identified, tmp_path_factory) -> Path:
    """Generated C folder of the synthetic identification."""
    folder = tmp_path_factory.mktemp("vehicle") / "g80"
    export_vehicle(stage.load(identified), folder)
    return folder


@pytest.fixture(scope="session")
def core(vehicle) -> Core:
    return Core(vehicle)


@pytest.fixture
def lpvguard():
    """Run the command line in a process of its own; returns the completed process."""

    def run(*arguments: object, **options) -> subprocess.CompletedProcess:
        command = [sys.executable, "-m", "lpvguard.cli", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, check=False, **options)

    return run
