"""Shipped vehicles with a [design] table, identified from few synthetic drives."""

from pathlib import Path

import pytest

from lpvguard.control import design as stage
from lpvguard.drives import fixture
from lpvguard.extras.loop.generate import generate
from lpvguard.identify import identification
from lpvguard.vehicle.design_settings import DesignSettings
from lpvguard.vehicle.project import NuCeiling, Project, load_project

STEERING = {
    "A_t": 20.0,
    "A_u": 1.6e-5,
    "W_t_poles": [0.5],
    "W_t_zeros": [40.0],
    "design_speed_mps": 11.0,
    "nodes": 4,
    "input_max": [0.3],
    "input_rate_max_per_s": [0.7],
    "lateral_acceleration_max_mps2": 4.0,
}
WITH_MOMENT = {
    **STEERING,
    "controlled": "yaw_rate",
    "structure": "K_o",
    "input_max": [0.3, 20.0],
    "input_rate_max_per_s": [0.7, 100.0],
}
FEW = [row for k, row in enumerate(fixture.PLAN) if k in (1, 2, 3, 7, 9)]


def designable(name: str, **settings) -> Project:
    """A shipped vehicle with a [design] table, and with the ceiling on nu that this design can stand."""
    project, ceiling = load_project(name), NuCeiling(f_hz=[0.5, 2.0], nu=[0.1, 0.6])
    bounds = project.bounds.model_copy(update={"nu_ceiling": ceiling})
    return project.model_copy(update={"design": DesignSettings(**settings), "bounds": bounds})


def identified_into(folder: Path, project: Project) -> None:
    """Identification folder of few synthetic drives."""
    drives = folder.with_name(f"{folder.name}_drives")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fixture, "PLAN", FEW)
        generate(project, drives, 3)
    identification.save(*identification.identify(project, drives), folder)


def designed_into(folder: Path, stored: identification.StoredIdentification) -> None:
    """Design folder for frozen speeds."""
    stage.save(stage.design(stored, moving_speed=False), stored, folder)
