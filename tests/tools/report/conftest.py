"""The report of a vehicle with one and with two outputs, made once."""

from __future__ import annotations

import pytest
from report_case import Case, vehicle, write_drives

from lpvguard.core.compiled import Core
from lpvguard.identify import run as stage
from lpvguard.identify.export import export_vehicle
from lpvguard.replay.run import Replayer


@pytest.fixture(
    scope="session",
    params=[pytest.param(1, marks=pytest.mark.slow("5 s: its pages")), 2],
    ids=["one output", "two outputs"],
)
def case(request, tmp_path_factory) -> Case:
    folder = tmp_path_factory.mktemp("report")
    project = vehicle(request.param)
    write_drives(project, folder / "drives")
    result, drives = stage.identify(project, folder / "drives")
    stage.save(result, drives, folder / "identified")
    stored = stage.load(folder / "identified")
    export_vehicle(stored, folder / project.name)
    # A threshold of its own: calibrated on "weak" itself nothing would alarm.
    return Case(stored, drives, Replayer(project, Core(folder / project.name), threshold=1.5))


@pytest.fixture(scope="session")
def page(case, tmp_path_factory) -> str:
    return case.page(tmp_path_factory.mktemp("page") / "report.html").decode()
