"""The shipped truck, and its simulator."""

from pathlib import Path

import pytest

from lpvguard.core.compiled import shipped_vehicle
from lpvguard.extras.loop.sim import Simulator


@pytest.fixture(scope="session")
def truck_folder() -> Path:
    """Generated C folder of the shipped truck, with its controller."""
    return shipped_vehicle("truck")


@pytest.fixture(scope="session")
def simulator(truck_folder) -> Simulator:
    return Simulator(truck_folder)
