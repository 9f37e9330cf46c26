"""The core's isolation against the package's, window for window, on a car with four redundant outputs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lpvguard.base.artefacts import write_files
from lpvguard.base.errors import InputError
from lpvguard.core.coefficients import build_coefficients, vehicle_files
from lpvguard.core.compiled import Core, PartLog
from lpvguard.drives.frames import Estimator
from lpvguard.drives.tables import Drive
from lpvguard.engine.overbound.weight import Weight
from lpvguard.extras.bench._redundant_car import FAULTS, PartFault, redundant_drives, redundant_project
from lpvguard.identify.change import ChangeTest
from lpvguard.identify.energy import EnergyTest
from lpvguard.identify.isolation import Changes, Isolation
from lpvguard.identify.isolation_table import isolation_table, parts_header, size_names
from lpvguard.replay.parts import PartNamer, alarms_begin
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import Project, parse_project

pytestmark = pytest.mark.requirement("REQ-ISO-1")
WINDOW_S = 30.0
PROJECT = redundant_project()
CHANGES = Changes(PROJECT, NominalModel(PROJECT))


@pytest.fixture(scope="module")
def isolation() -> Isolation:
    return Isolation.from_drives(CHANGES, redundant_drives(10, 180.0, 1)[0], WINDOW_S)


def core_of(project: Project, isolation: Isolation, folder: Path, *, threshold: float, double: bool) -> Core:
    """Core with placeholder bounds, whose frame test alarms above ``threshold``."""
    model = NominalModel(project)
    estimator = Estimator.from_project(project, model)
    ones = np.ones((estimator.n_bins, project.n_y))
    energy = EnergyTest.design(
        project,
        estimator,
        [Weight([0.3], [1.0])] * project.n_delta,
        estimator.omega[1:],
        np.full((estimator.n_bins - 1, project.n_delta), 0.1),
        1.0,
    )
    energy = replace(energy, sigma=np.full((len(energy.F), project.n_y), 10.0))
    quiet = ChangeTest.design(project)
    quiet = replace(quiet, largest=1e3 * quiet.largest)
    coefficients = build_coefficients(
        project,
        model,
        estimator,
        0.3 * ones[:, : project.n_delta],
        0.01 * ones,
        threshold,
        energy,
        quiet,
    )
    parts = (isolation_table(project, isolation), parts_header(project, isolation))
    files = vehicle_files(project, coefficients, {"kind": "vehicle"}, isolation=parts)
    folder.mkdir()
    write_files(folder, files)
    return Core(folder, double=double)


def words(isolation: Isolation, log: PartLog, i: int) -> tuple[float, float, bool, set[str]]:
    names = {part for k, part in enumerate(isolation.parts) if log.parts[i] >> k & 1}
    return round(float(log.from_s[i]), 6), round(float(log.until_s[i]), 6), bool(log.alarmed[i]), names


def compared(isolation: Isolation, core: Core, drive: Drive) -> int:
    """Number of windows that name something; the core's must be those of `replay`."""
    run = core.monitor().run_drive(drive)
    namer = PartNamer(PROJECT, isolation)
    begin = (drive.t[alarms_begin(run.verdict)[0]] - drive.t[0]).tolist()
    end = drive.duration_s - (CHANGES.ahead + CHANGES.step) * PROJECT.Ts_s
    expected = [n for n in namer.named(drive, begin) if n.until_s < end]
    differing = [i for i in range(len(run.parts.until_s)) if run.parts.differs[i]]
    assert [words(isolation, run.parts, i) for i in differing] == [
        (round(n.from_s, 6), round(n.until_s, 6), n.alarm_s is not None, set(n.parts)) for n in expected
    ]
    for i, n in zip(differing, expected, strict=True):
        if n.parts:
            assert isolation.parts[run.parts.likeliest[i]] == n.parts[0]
            assert size_names(isolation)[run.parts.size[i]] == n.what
            width = n.high - n.low
            for ours, theirs in ((run.parts.value[i], n.value), (run.parts.low[i], n.low)):
                assert ours == pytest.approx(theirs, abs=0.02 * width)
    return len(differing)


@pytest.mark.parametrize("double", [False, True])
def test_the_core_names_the_parts_that_replay_names(isolation, tmp_path, double):
    core = core_of(PROJECT, isolation, tmp_path / PROJECT.name, threshold=1.5, double=double)
    cases = [(), *((f,) for f in FAULTS)]
    made = redundant_drives(1, 101.0, 3, cases, 34.0)
    named = [compared(isolation, core, drives[0]) for drives in made]
    assert named[0] == 0 and sum(n > 0 for n in named) >= 10


def test_a_gap_begins_blocks_anew_and_an_alarm_begins_a_window(isolation, tmp_path):
    core = core_of(PROJECT, isolation, tmp_path / PROJECT.name, threshold=1.0, double=False)
    ((drive,),) = redundant_drives(1, 131.0, 3, [(PartFault("bias", 0.05, "wheel_rate"),)], 34.0)
    missing = np.zeros(len(drive.t), bool)
    missing[2513:2530] = missing[3007] = True
    drive = replace(drive, missing=missing)
    assert compared(isolation, core, drive) >= 2
    assert core.monitor().run_drive(drive).parts.alarmed.any()
    late = replace(drive, t=drive.t + 1e3)
    monitor = core.monitor()
    pieces = [
        monitor.run(*(x[a : a + 640] for x in (late.t, late.v, late.u, late.y, ~missing)))
        for a in range(0, len(missing), 640)
    ]
    whole = core.monitor().run_drive(late).parts
    assert np.concatenate([p.parts.value for p in pieces]) == pytest.approx(whole.value)


@pytest.mark.requirement("REQ-ISO-5")
def test_the_header_has_words_and_trouble_codes_of_every_part(isolation):
    document = PROJECT.model_dump(by_alias=True)
    check = {"check": {"wheel_rate": 'the "rear" tyres'}}
    project = parse_project(document | {"isolation": document["isolation"] | check}, "x")
    text = parts_header(project, isolation)
    assert '{"wheel_rate", "the \\"rear\\" tyres"}, {"acceleration_rate", "mounting, wiring' in text
    assert '{"yaw_rate delay", " s"}, {"yaw_rate bias", " rad/s"}' in text and '{"K factor", ""}' in text
    assert "520220  no single part\n   520221  yaw_rate\n   520222  wheel_rate\n" in text


def test_what_the_core_has_no_room_for_is_refused():
    document = PROJECT.model_dump(by_alias=True)
    settings = document["isolation"] | {"vehicle": ["K", "T1", "L"]}
    with pytest.raises(InputError, match=r"isolation\.vehicle"):
        parse_project(document | {"isolation": settings}, "x")
