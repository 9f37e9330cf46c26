"""ThreadSanitizer over simulated loops that run at once: nothing is shared between instances, as the headers
promise ("one instance per thread"), and each sends what it sends alone."""

import os
import re
import subprocess
from pathlib import Path

import pytest

from lpvguard.base import native
from lpvguard.extras.loop.sim import load_scenario, loop_objects, steady_scenario
from made import ROOT

FOUND = 66
"""Exit status of a program in which the sanitizer found something."""
FAULTS = "[[plant.actuator_fault]]\nstart_s = 5.0\nbrake_gain_ratio = 0.0\n"
DURATION_S = 120.0 if os.environ.get("LPVGUARD_FULL") == "1" else 20.0
RACE = "#include <thread>\nint n; int main() { std::thread a([] { ++n; }); ++n; a.join(); }\n"


@pytest.fixture(scope="module")
def sanitized():
    """Environment in which `native` compiles with the sanitizer; skipped where it finds no planted race."""
    (compiler,) = native.find_compiler(cxx=True)
    wrapper = native.cache_dir() / "thread-sanitizer-c++"  # a place that stays, because it is hashed
    new = wrapper.with_suffix(f".{os.getpid()}")
    new.write_text(f'#!/bin/sh\nexec "{compiler}" "$@" -O1 -g1 -fsanitize=thread\n')
    new.chmod(0o755)
    os.replace(new, wrapper)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CXX", str(wrapper))
        yield wrapper


@pytest.fixture(scope="module")
def program(sanitized, truck_folder, tmp_path_factory) -> Path:
    source = tmp_path_factory.mktemp("race") / "race.cpp"
    source.write_text(RACE)
    try:
        race = native.compile_executable([source], flags=("-std=c++17",), name="race")
    except native.NativeError as error:
        pytest.skip(f"no program can be linked with ThreadSanitizer: {str(error).splitlines()[-1]}")
    done = subprocess.run([race], capture_output=True, text=True, check=False)
    if "unexpected memory mapping" in done.stderr:
        pytest.skip("this ThreadSanitizer cannot start under this kernel's layout of memory")
    assert done.returncode == FOUND and "data race" in done.stderr
    objects = loop_objects(truck_folder, Path(__file__).with_name("loops_in_threads.cpp"))
    return native.compile_executable(objects, flags=(), name="loops_in_threads")


@pytest.fixture
def scenarios(tmp_path):
    """Two of them: a healthy truck and one that loses its brakes."""
    texts = {"steady": "", "fault": FAULTS}
    paths = []
    for seed, (name, tables) in enumerate(texts.items(), start=1):
        paths.append(tmp_path / f"{name}.toml")
        paths[-1].write_text(steady_scenario(DURATION_S, tables, seed=seed))
    return paths


def ran(program: Path, *words: object) -> subprocess.CompletedProcess[str]:
    parameters = ROOT / "firmware_sim" / "plant" / "truck.toml"
    command = [
        program,
        *(w for w in words if w == "--shared"),
        parameters,
        *(w for w in words if w != "--shared"),
    ]
    environment = {**os.environ, "TSAN_OPTIONS": f"exitcode={FOUND}"}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.slow("30 s: the simulator is compiled with the thread sanitizer")
def test_loops_at_once_share_nothing(program, scenarios, simulator):
    done = ran(program, *scenarios, scenarios[0])
    assert done.returncode == 0 and done.stderr == "", done.stderr[:3000]
    sent = [line.split() for line in done.stdout.splitlines()]
    alone = [simulator.run(load_scenario(str(path)), report_only=True) for path in scenarios]
    assert [int(count) for count, _ in sent[:2]] == [run["frames"] for run in alone]
    assert [hash_ for _, hash_ in sent[:2]] == [run["frames_hash"] for run in alone]
    assert sent[2] == sent[0] != sent[1]


@pytest.mark.slow("30 s: the simulator is compiled with the thread sanitizer")
def test_two_loops_on_one_ecu_are_reported(program, scenarios):
    done = ran(program, "--shared", *scenarios)
    assert "data race" in done.stderr
    assert re.search(r"lpvg_\w+_(ecu|monitor|model|control)|MemoryBus", done.stderr), done.stderr[:3000]
