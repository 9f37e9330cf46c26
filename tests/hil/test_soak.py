"""Hours of simulated driving with random faults: nothing grows, every verdict keeps the rules, and emulated
processors do what the PC does. Two hours by default, 24 with LPVGUARD_FULL=1."""

import os
import subprocess

import pytest

from lpvguard.base.errors import InputError
from lpvguard.core.compiled import eigen_include, firmware_root, library_root
from lpvguard.extras.bench import run as run_bench
from lpvguard.extras.bench.soak import SEED, header_text, soak
from parts import require

FULL = os.environ.get("LPVGUARD_FULL") == "1"
HOURS = 24 if FULL else 2
SHORT_HOUR_MS = 3_600_000 if FULL else 120_000
"""What stands for an hour where every instruction is emulated or checked."""


def check(run, hours: int) -> None:
    assert len(run.hours) == hours and set(run.broken.values()) == {0}, run.broken
    for hour in run.hours:
        assert hour["broken"] == 0 and hour["frames_out"] > hour["ticks"] > 0
        assert 0 <= hour["valid"] <= hour["judged"] < hour["ticks"] and hour["engaged"] < hour["ticks"]


@pytest.mark.unhurried
def test_hours_of_random_faults_keep_every_rule(truck_folder):
    run = soak(truck_folder, "host", HOURS)
    check(run, HOURS)
    sums = {name: sum(hour[name] for hour in run.hours) for name in run.hours[0]}
    assert sums["faults"] > 80 * HOURS and sums["vehicle_faults"] >= HOURS
    # Something fails twice a minute: releases void the evidence, and use up the hour's engagements.
    assert sums["vehicle_faults"] <= sums["alarms"] + 2 and sums["judged"] > 0.05 * sums["ticks"]
    # A response that the watch finds wrong locks until init.
    assert sums["engaged"] > 0.3 * sums["ticks"] and run.hours[-1]["diagnosed"] > 0
    other = soak(truck_folder, "host", 1, seed=SEED + 1)
    check(other, 1)
    assert other.hours[0]["digest"] != run.hours[0]["digest"]


def test_a_truck_without_faults_is_engaged_all_the_time(truck_folder):
    run = soak(truck_folder, "host", HOURS, faults=False)
    assert set(run.broken.values()) == {0}, run.broken
    for hour in run.hours:
        assert hour["faults"] == hour["vehicle_faults"] == hour["alarms"] == 0
        assert hour["ticks"] - 240 <= hour["engaged"] < hour["ticks"]


@pytest.mark.slow("every tick in an emulator")
@pytest.mark.parametrize("target", ["cortex-m4f", "cortex-r5f"])
def test_an_emulated_processor_does_the_same_and_nothing_grows(truck_folder, target):
    require("qemu")
    host = soak(truck_folder, "host", HOURS, hour_ms=SHORT_HOUR_MS)
    run = soak(truck_folder, target, HOURS, hour_ms=SHORT_HOUR_MS)
    assert run.said == host.said and run.broken == host.broken
    for name in ("worst", "stack"):
        series = [hour[name] for hour in run.hours]
        assert 0 < series[-1] <= 1.1 * max(series[: len(series) // 2]), (name, series)


@pytest.mark.long("25 s: the core is compiled with the memory sanitizer")
def test_the_memory_sanitizer_finds_nothing(truck_folder, tmp_path):
    """A value that was never set would end the program: it, the core and what it calls are plain C and C++
    without a library."""
    require("llvm19")
    root, core = firmware_root(), library_root()
    (tmp_path / "soak_input.h").write_text(header_text(HOURS, SHORT_HOUR_MS, SEED, True))
    folders = (core / "include", core / "src", truck_folder, root / "ports", root / "ecu", tmp_path)
    flags = ["-O1", "-g1", "-ffp-contract=off", "-fsanitize=memory", "-fno-omit-frame-pointer"]
    flags += [f"-I{folder}" for folder in folders]
    cxx = [*flags, "-std=c++17", "-fno-exceptions", "-fno-rtti", "-fno-math-errno", "-DEIGEN_NO_DEBUG"]
    objects = []
    c_sources = [*sorted(truck_folder.glob("*.c")), root / "ecu" / "firmware.c", root / "ports" / "soak.c"]
    for source in [*sorted((core / "src").glob("*.cpp")), *c_sources, root / "ports" / "host" / "port.c"]:
        is_cxx = source.suffix == ".cpp"
        words = ["clang++-19", *cxx, "-isystem", eigen_include()] if is_cxx else ["clang-19", *flags]
        objects.append(tmp_path / f"{source.name}.o")
        subprocess.run([*words, "-c", source, "-o", objects[-1]], check=True)
    program = tmp_path / "soak"
    subprocess.run(["clang-19", "-fsanitize=memory", *objects, "-lm", "-o", program], check=True)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.splitlines()[-1] == "end"
    plain = soak(truck_folder, "host", HOURS, hour_ms=SHORT_HOUR_MS)
    assert f"digest {plain.hours[-1]['digest']} " in done.stdout


@pytest.mark.unhurried
def test_a_table_and_curves(tmp_path, capsys):
    run_bench("soak", ["--hours", "1", "--figure", str(tmp_path / "soak.svg")])
    said = capsys.readouterr().out
    assert said.splitlines()[0].split()[:2] == ["hour", "ticks"] and "rules broken: report 0" in said
    assert (tmp_path / "soak.svg").read_text().count("<path") > 20
    with pytest.raises(InputError, match="--hours"):
        run_bench("soak", ["--hours", "0"])
