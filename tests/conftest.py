"""Shared by all tests: what kind a test is, what it cost, and the vehicles that many tests read
(tests/made.py)."""

import io
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import typer.main

from lpvguard import cli
from lpvguard.control.design import Design, design
from lpvguard.control.design import save as save_design
from lpvguard.core.compiled import Core
from lpvguard.evaluate import baseline_study
from lpvguard.evaluate.baselines import Baseline
from lpvguard.extras.loop import generate as drive_maker
from lpvguard.identify import identification as stage
from lpvguard.identify.export import export_vehicle
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import Project, load_project
from made import ROOT, Store, digest_of, store
from order import dearest_file_first

COLLECTED = pytest.StashKey[int]()
BEGAN = pytest.StashKey[float]()
TESTS = Path(__file__).resolve().parent
SERIAL = (TESTS / "hil", TESTS / "tools" / "live")
"""Folders of tests marked serial, in which alone tools/test looks for them."""
KINDS = ("unit", "property", "golden", "fault", "hil", "fuzz", "gates", "tools")
FEW_DRIVES = {
    "BOUND_SPEEDS": (8.3, 12.0, 17.0, 21.7),
    "CALIBRATION_SPEEDS": (10.0,),
    "ZERO_INPUT_SPEEDS": (12.0, 17.0),
    "SWEEPS_BAR": (0.24, 0.8, 2.1),
}
"""Without a sweep in every class of amplitudes the manoeuvres alone ask for more than any controller keeps
(mu 2.4 without 0.8 bar, 0.90 with it)."""

FULL = os.environ.get("LPVGUARD_FULL") == "1"
SLOW_FIXTURES = {
    "few_truck_identified": "60 s: a truck identified on few drives",
    "few_truck_designed": "60 s: a design",
    "measured_identified": "10 s: the measured drives identified",
}
"""Fixtures that make every test that asks for them slow, and why (CPU seconds, once a run)."""
LONG_FIXTURES = {
    "few_truck_common_identified": "30 s: a truck identified with one Delta",
    "truck_identified": "over 60 s: the truck identified as shipped",
}
"""Fixtures that make every test that asks for them long, and why."""
MARKERS = (
    "requirement(id): verifies this requirement of lib/REQUIREMENTS.md",
    "unhurried: not part of tools/test --fast: over half a processor second; mutants meet it",
    "slow(reason): the same from 3 on; mutants do not meet it; says what takes them",
    "long(reason): part of tools/test --full (LPVGUARD_FULL=1) alone, else skipped and counted; says why",
    "serial: on vcan0, with an emulator or in real time; no other test runs beside it, and none in --fast",
    *(f"{kind}: a kind of test, the first folder below tests/" for kind in KINDS),
)


def pytest_configure(config: pytest.Config) -> None:
    for marker in MARKERS:
        config.addinivalue_line("markers", marker)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """A test's marker is its kind, the first folder below tests/."""
    config.stash[COLLECTED] = len(items)
    for item in items:
        kind = item.path.relative_to(TESTS).parts[0]
        if kind not in KINDS:
            raise pytest.UsageError(f"{item.path}: {kind} is no kind of test ({', '.join(KINDS)})")
        if (slow := item.get_closest_marker("slow")) and not slow.args:
            raise pytest.UsageError(f"{item.nodeid}: slow without the reason")
        if item.get_closest_marker("serial") and not any(item.path.is_relative_to(path) for path in SERIAL):
            raise pytest.UsageError(f"{item.nodeid}: serial outside of {', '.join(p.name for p in SERIAL)}")
        item.add_marker(kind)
        for name in SLOW_FIXTURES.keys() & set(item.fixturenames):
            item.add_marker(pytest.mark.slow(SLOW_FIXTURES[name]))
        for name in LONG_FIXTURES.keys() & set(item.fixturenames):
            item.add_marker(pytest.mark.long(LONG_FIXTURES[name]))
        if (long := item.get_closest_marker("long")) and not FULL:
            item.add_marker(pytest.mark.skip(reason=f"LPVGUARD_FULL: {long.args[0]}"))
    items[:] = dearest_file_first(items, {**SLOW_FIXTURES, **LONG_FIXTURES}.values())


def cpu_seconds() -> float:
    """Processor time of this process and of the children that it waited for."""
    return sum(os.times()[:4])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    item.stash[BEGAN] = cpu_seconds()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    began = cpu_seconds()
    try:
        return (yield)
    finally:
        item.user_properties.append(("cpu_call", f"{cpu_seconds() - began:.2f}"))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo) -> None:
    """What a test cost, for tools/summarise_tests.py: its processor seconds, with and without fixtures."""
    if call.when == "teardown":
        item.user_properties.append(("cpu", f"{cpu_seconds() - item.stash[BEGAN]:.2f}"))


def pytest_sessionfinish(session: pytest.Session) -> None:
    """How many tests there are, whether they run or not, beside the JUnit file for tools/summarise_tests.py.
    Of workers of pytest-xdist the process that leads them hears it."""
    config = session.config
    count = config.stash.get(COLLECTED, 0)
    if hasattr(config, "workeroutput"):
        config.workeroutput["collected"] = count
    elif config.option.xmlpath:
        Path(config.option.xmlpath).with_suffix(".collected").write_text(f"{count}\n")


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node) -> None:
    if output := getattr(node, "workeroutput", None):  # a worker that broke off has none
        node.config.stash[COLLECTED] = output["collected"]


def measured_folder() -> Path:
    """Folder of the measured data; the test that asks is skipped, with a reason, when it is absent."""
    folder = Path(os.environ.get("LPVGUARD_DATA", ROOT.parent / "shared" / "data"))
    if not (folder / "genesis_g80" / "experiments.csv").is_file():
        pytest.skip("the measured drives are absent: set LPVGUARD_DATA (data/README.md)")
    return folder


@pytest.fixture(scope="session")
def race_car() -> Path:
    """Raw recordings of a 1:10 race car, which no project file here is about."""
    folder = measured_folder() / "f1tenth_ini" / "raw"
    if not folder.is_dir():
        pytest.skip("the race car's recordings are absent: set LPVGUARD_DATA (data/README.md)")
    return folder


@pytest.fixture(scope="session")
def rav4() -> Path:
    """A minute of raw CAN frames of a car with a bus of its own, and the table decoded from them."""
    folder = measured_folder() / "comma2k19_rav4"
    if not folder.is_dir():
        pytest.skip("the RAV4's log is absent: set LPVGUARD_DATA (data/README.md)")
    return folder


@pytest.fixture(scope="session")
def measured() -> Path:
    return measured_folder() / "genesis_g80"


@pytest.fixture(scope="session")
def made() -> Iterator[Store]:
    """Folders that are made once a run; at the end nobody has changed any."""
    with store(ROOT / "build" / "made") as folders:
        yield folders
        assert folders.changed() == [], "a test changed a folder that all tests read: it has to copy it first"


def identify_into(folder: Path, project: Project, drives: Path) -> None:
    stage.save(*stage.identify(project, drives), folder)


@pytest.fixture(scope="session")
def g80():
    return load_project("g80")


@pytest.fixture(scope="session")
def g80_model(g80):
    return NominalModel(g80)


@pytest.fixture(scope="session")
def synthetic(g80, made) -> Path:
    """Folder of the synthetic drives."""
    return made.folder("g80_drives", lambda folder: drive_maker.generate(g80, folder, seed=7))


@pytest.fixture(scope="session")
def identified(g80, synthetic, made) -> Path:
    """Identification folder of the synthetic drives."""
    return made.folder("g80_identified", lambda folder: identify_into(folder, g80, synthetic))


@pytest.fixture(scope="session")
def vehicle(identified, made) -> Path:
    """Generated C folder of the synthetic identification."""
    return made.folder("g80_vehicle", lambda folder: export_vehicle(stage.load(identified), folder))


@pytest.fixture(scope="session")
def core(vehicle) -> Core:
    return Core(vehicle)


@pytest.fixture(scope="session")
def measured_identified(g80, measured, made) -> Path:
    """Identification folder of the measured drives."""
    return made.folder(
        f"measured_identified_{digest_of(measured)[:16]}", lambda folder: identify_into(folder, g80, measured)
    )


@pytest.fixture(scope="session")
def truck() -> Project:
    return load_project("truck")


@pytest.fixture(scope="session")
def truck_drives(truck, made) -> Path:
    """Folder of the simulated truck's drives, as shipped."""
    return made.folder("truck_drives", lambda folder: drive_maker.generate(truck, folder, truck.seed))


@pytest.fixture(scope="session")
def truck_identified(truck, truck_drives, made) -> Path:
    """Identification folder of the simulated truck, as shipped."""
    return made.folder("truck_identified", lambda folder: identify_into(folder, truck, truck_drives))


@pytest.fixture(scope="session")
def few_truck_drives(truck, made) -> Path:
    """Few drives of the simulated truck (FEW_DRIVES), for tests whose cost grows with their number."""

    def make(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            for name, values in FEW_DRIVES.items():
                patch.setattr(drive_maker, name, values)
            drive_maker.generate(truck, folder, truck.seed)

    return made.folder("few_truck_drives", make)


@pytest.fixture(scope="session")
def few_truck_identified(truck, few_truck_drives, made) -> Path:
    """Identification folder of the few drives."""
    return made.folder("few_truck_identified", lambda folder: identify_into(folder, truck, few_truck_drives))


@pytest.fixture(scope="session")
def six_node_truck(few_truck_identified) -> stage.StoredIdentification:
    """The truck identified on few drives, with as few nodes as leave mu near 1 between them."""
    stored = stage.load(few_truck_identified)
    settings = stored.project.design.model_copy(update={"nodes": 6})
    return replace(stored, project=stored.project.model_copy(update={"design": settings}))


@pytest.fixture(scope="session")
def few_truck_designed(six_node_truck, made) -> tuple[Design, Path]:
    """Its controller for frozen speeds, and the controller.json of it."""

    def make(folder: Path) -> None:
        result = design(six_node_truck, moving_speed=False)
        folder.mkdir()
        save_design(result, six_node_truck, folder / "design")
        (folder / "design.pickle").write_bytes(pickle.dumps(result))

    folder = made.folder("few_truck_designed", make)
    return pickle.loads((folder / "design.pickle").read_bytes()), folder / "design" / "controller.json"


@pytest.fixture(scope="session")
def common_truck(truck) -> Project:
    """The truck with one Delta for both outputs, for Table II, the trade-off and K_is."""
    return truck.model_copy(
        update={
            "bounds": truck.bounds.model_copy(update={"structure": "S1"}),
            "design": truck.design.model_copy(update={"structure": "K_i"}),
        }
    )


@pytest.fixture(scope="session")
def few_truck_common_identified(common_truck, few_truck_drives, made) -> Path:
    """Identification folder of the few drives with one Delta."""
    return made.folder(
        "few_truck_common_identified", lambda folder: identify_into(folder, common_truck, few_truck_drives)
    )


COMMAND_OF = cache(typer.main.get_command)
"""Typer makes its commands from the functions anew at each call, which takes as long as most of them run."""


@pytest.fixture
def lpvguard(monkeypatch):
    """Run the command line; returns the completed process. Without options, or with ``cwd`` alone, it runs in
    this process, which spares the imports; with other options of subprocess.run in a process of its own."""
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setattr(typer.main, "get_command", COMMAND_OF)

    def run(*arguments: object, cwd: Path | None = None, **options) -> subprocess.CompletedProcess:
        words = [*map(str, arguments)]
        if options:
            command = [sys.executable, "-m", "lpvguard.cli", *words]
            return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, **options)
        streams = [io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for _ in range(2)]
        status: int | str | None = 0
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["lpvguard", *words])
            patch.setattr(sys, "stdout", streams[0])
            patch.setattr(sys, "stderr", streams[1])
            if cwd is not None:
                patch.chdir(cwd)
            try:
                cli.main()
            except SystemExit as end:
                status = end.code or 0
        for stream in streams:
            stream.flush()
        said = [stream.buffer.getvalue().decode() for stream in streams]
        return subprocess.CompletedProcess(words, status, *said)

    return run


@pytest.fixture
def few_baselines(monkeypatch) -> tuple[Baseline, ...]:
    """One or two settings of each baseline to choose from, so that the search of `evaluate` is short."""
    few = (
        Baseline("rms", window_s=20.0),
        Baseline("cusum", drift=8.0),
        Baseline("nis", window_s=20.0, process_ratio=0.001),
        Baseline("tracker", window_s=2.0, prior=0.2),
        Baseline("glr", window_s=10.0),
        Baseline("glr", window_s=20.0),
    )
    monkeypatch.setattr(baseline_study, "GRID", few)
    return few
