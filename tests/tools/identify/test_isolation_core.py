"""The core's isolation against the package's, window for window, on a car with four redundant outputs."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.core.compiled import Core, PartLog
from lpvguard.drives.tables import Drive
from lpvguard.extras.bench._redundant_car import FAULTS, PartFault, redundant_drives, redundant_project
from lpvguard.extras.bench.core import write_redundant_vehicle
from lpvguard.identify.isolation import Changes, Isolation
from lpvguard.identify.isolation_table import parts_header, size_names
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
    """Core of the car, whose frame test alarms above ``threshold``."""
    write_redundant_vehicle(folder, project, isolation, threshold)
    return Core(folder, double=double)


def words(isolation: Isolation, log: PartLog, i: int) -> tuple[float, float, bool, set[str]]:
    names = {part for k, part in enumerate(isolation.parts) if log.parts[i] >> k & 1}
    return round(float(log.from_s[i]), 6), round(float(log.until_s[i]), 6), bool(log.alarmed[i]), names


def compared(project: Project, isolation: Isolation, core: Core, drive: Drive) -> int:
    """Number of windows that name something; the core's must be those of `replay`."""
    run = core.monitor().run_drive(drive)
    namer = PartNamer(project, isolation)
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
    named = [compared(PROJECT, isolation, core, drives[0]) for drives in made]
    assert named[0] == 0 and sum(n > 0 for n in named) >= 10


def test_a_gap_begins_blocks_anew_and_an_alarm_begins_a_window(isolation, tmp_path):
    core = core_of(PROJECT, isolation, tmp_path / PROJECT.name, threshold=1.0, double=False)
    ((drive,),) = redundant_drives(1, 131.0, 3, [(PartFault("bias", 0.05, "wheel_rate"),)], 34.0)
    missing = np.zeros(len(drive.t), bool)
    missing[2513:2530] = missing[3007] = True
    drive = replace(drive, missing=missing)
    assert compared(PROJECT, isolation, core, drive) >= 2
    assert core.monitor().run_drive(drive).parts.alarmed.any()
    late = replace(drive, t=drive.t + 1e3)
    monitor = core.monitor()
    pieces = [
        monitor.run(*(x[a : a + 640] for x in (late.t, late.v, late.u, late.y, ~missing)))
        for a in range(0, len(missing), 640)
    ]
    whole = core.monitor().run_drive(late).parts
    assert np.concatenate([p.parts.value for p in pieces]) == pytest.approx(whole.value)


def drawn(random: np.random.Generator) -> tuple[Project, list[PartFault]]:
    """A project whose signals are parts of their own or of one another, and up to two faults of any size."""
    signals = [*(s.name for s in PROJECT.outputs), "road_wheel_angle"]
    pair = random.choice(signals, 2, replace=False).tolist()
    document = PROJECT.model_dump(by_alias=True)
    if random.random() < 0.5:
        document["isolation"] |= {"parts": dict.fromkeys(pair, "both")}
    kinds = {"gain": 0.3, "bias": 0.03, "speed": 0.1, "tyre": 0.3, "load": 0.3, "offset": 0.02}
    faults = []
    for kind in random.choice(list(kinds), random.integers(3), replace=False):
        size = kinds[kind] * random.normal()
        signal = str(random.choice(signals[:-1])) if kind in ("gain", "bias") else ""
        faults.append(PartFault(str(kind), size + (kind not in ("bias", "offset")), signal))
    return parse_project(document, "x"), faults


def scales(random: np.random.Generator, project: Project, like: Isolation) -> Isolation:
    """Scales of no vehicle: sizes, residue and limits are drawn about those of ``like``."""

    def spread_by(share: float, n: int) -> np.ndarray:
        return np.exp(share * random.normal(size=n))

    settings = project.isolation
    names = [*(s.name for s in project.outputs), *(s.name for s in project.inputs), project.speed.name]
    part = {name: settings.part_of(name) for name in names}
    usual = dict(zip({c.what: c for c in like.columns}, spread_by(0.4, len(like.columns)), strict=False))
    columns = [
        replace(c, part=part.get(c.what.split()[0], c.part), fault=c.fault * usual[c.what])
        for c in like.columns
    ]
    m, n_y = len(columns), project.n_y
    root = random.normal(size=(n_y, 2 * n_y)) / np.sqrt(2 * n_y)
    size = np.sqrt(np.diag(like.S)) * spread_by(0.5, n_y)
    return replace(
        like,
        columns=columns,
        mean=0.5 * like.spread * random.normal(size=m),
        spread=like.spread * spread_by(0.7, m),
        A=like.A + 0.1 * random.normal(size=like.A.shape),
        S=size[:, None] * (root @ root.T) * size,
        scale=random.uniform(1.0, 4.0),
        least=random.uniform(2.0, 12.0),
        lack=random.uniform(0.0, 40.0),
        window_s=float(random.choice([20.0, 24.0, 30.0])),
    )


SEEDS = range(40 if os.environ.get("LPVGUARD_FULL") == "1" else 4)


@pytest.mark.slow("2 s a seed: a table is drawn and compiled")
def test_random_tables_name_the_same_parts_as_the_oracle(isolation, tmp_path):
    named = 0
    for seed in SEEDS:
        random = np.random.default_rng(seed)
        project, faults = drawn(random)
        own = scales(random, project, isolation)
        core = core_of(project, own, tmp_path / f"{seed}", threshold=random.uniform(1.0, 3.0), double=True)
        ((drive,),) = redundant_drives(1, 101.0, 100 + seed, [tuple(faults)], random.uniform(5.0, 60.0))
        missing = np.zeros(len(drive.t), bool)
        for first in random.integers(0, len(drive.t), random.integers(3)):
            missing[first : first + random.integers(1, 40)] = True
        named += compared(project, own, core, replace(drive, missing=missing))
    assert named >= len(SEEDS)


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
