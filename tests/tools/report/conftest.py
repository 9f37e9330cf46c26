"""The report of a vehicle with one and with two outputs, made once a run: a session's fixture is made anew
whenever another number of outputs is asked for, in each file of tests."""

from pathlib import Path

import pytest
import report_case
from report_case import Case, vehicle, write_drives

from lpvguard.core.compiled import Core
from lpvguard.identify import identification as stage
from lpvguard.identify.export import export_vehicle
from lpvguard.replay.replayer import Replayer
from lpvguard.vehicle.nominal import NominalModel
from made import digest_of

RECIPE = digest_of(Path(report_case.__file__))[:16]


@pytest.fixture(
    scope="session",
    params=[pytest.param(1, marks=pytest.mark.long("its identification and its pages")), 2],
    ids=["one output", "two outputs"],
)
def case(request, made) -> Case:
    project = vehicle(request.param)

    def make(folder: Path) -> None:
        folder.mkdir()
        write_drives(project, folder / "drives")
        result, drives = stage.identify(project, folder / "drives")
        stage.save(result, drives, folder / "identified")
        export_vehicle(stage.load(folder / "identified"), folder / "vehicle")

    folder = made.folder(f"report_{request.param}_{RECIPE}", make)
    drives = stage.DriveSet(project, NominalModel(project), folder / "drives")
    # A threshold of its own: calibrated on "weak" itself nothing would alarm.
    replayer = Replayer(project, Core(folder / "vehicle"), threshold=1.5)
    return Case(stage.load(folder / "identified"), drives, replayer)


@pytest.fixture(scope="session")
def page(case, made) -> str:
    def make(folder: Path) -> None:
        folder.mkdir()
        case.page(folder / "report.html")

    return (made.folder(f"page_{case.stored.project.name}_{RECIPE}", make) / "report.html").read_text(
        encoding="utf-8"
    )
