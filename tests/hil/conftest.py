"""A small truck for the loop: few drives of the simulated truck, identified, exported with the hand-made controller."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hand_controller import hand_controller

from lpvguard import generate
from lpvguard import identify as stage
from lpvguard.control_export import load_controller
from lpvguard.export import export_vehicle
from lpvguard.project import load_project
from lpvguard.sim import Simulator


@pytest.fixture(scope="session")
def truck():
    return load_project("truck")


@pytest.fixture(scope="session")
def truck_folder(truck, tmp_path_factory) -> Path:
    """Generated C folder of a truck identified on few drives, with the hand-made controller."""
    folder = tmp_path_factory.mktemp("truck")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(generate, "BOUND_SPEEDS", (8.3, 12.0, 17.0, 21.7))
        patch.setattr(generate, "CALIBRATION_SPEEDS", (9.0, 15.0, 21.0))
        patch.setattr(generate, "ZERO_INPUT_SPEEDS", (12.0,))
        generate.generate(truck, folder / "drives", truck.seed)
    stage.save(*stage.identify(truck, folder / "drives"), folder / "identify")
    (folder / "controller.json").write_text(json.dumps(hand_controller(truck)))
    export_vehicle(stage.load(folder / "identify"), folder / "truck", load_controller(folder / "controller.json"))
    return folder / "truck"


@pytest.fixture(scope="session")
def simulator(truck_folder) -> Simulator:
    return Simulator(truck_folder)
