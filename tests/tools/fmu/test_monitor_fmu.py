"""The monitor's FMU, run by fmpy: valid descriptions, the core's own verdicts, states that come back."""

import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from lpvguard.core.compiled import CAUSES, VERDICTS
from lpvguard.drives.tables import read_drive
from lpvguard.extras.fmu.package import monitor_fmu
from plain_fmu import Running, compile_sources

pytestmark = pytest.mark.slow("6 s: the core is compiled and runs under fmpy")
VERSIONS = (2, 3)
RESULTS = ("verdict", "cause", "margin", "energy_ratio", "change_ratio", "cause_value")


@pytest.fixture(scope="module")
def fmus(g80, vehicle, tmp_path_factory) -> dict[int, Path]:
    """The monitor of the synthetic g80 as an FMU, by the version of FMI."""
    folder = tmp_path_factory.mktemp("fmu")
    for version in VERSIONS:
        (folder / f"{version}.fmu").write_bytes(monitor_fmu(g80, vehicle, version))
    return {version: folder / f"{version}.fmu" for version in VERSIONS}


@pytest.fixture(scope="module")
def faulty(g80, synthetic):
    """A drive whose yaw rate loses half of its gain in the middle."""
    drive = read_drive(synthetic / "synthetic_01.csv", g80)
    y = drive.y.copy()
    y[len(y) // 2 :] *= 0.5
    return drive, y


def _results(running: Running) -> tuple:
    return (*running.codes(*RESULTS[:2]), *running.numbers(*RESULTS[2:]))


@pytest.fixture(params=VERSIONS)
def running(request, fmus, tmp_path):
    return Running(fmus[request.param], tmp_path, request.param)


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_and_the_schema_find_no_problem(fmus, version):
    assert validate_fmu(str(fmus[version])) == []


@pytest.mark.parametrize("version", VERSIONS)
def test_the_description_names_signals_units_ranges_and_the_cores_words(fmus, version, g80):
    read = fmpy.read_model_description(str(fmus[version]))
    variables = {v.name: v for v in read.modelVariables}
    for signal in (g80.speed, *g80.inputs, *g80.outputs):
        variable = variables[signal.name]
        assert (variable.causality, variable.unit) == ("input", signal.unit)
        assert (float(variable.min), float(variable.max)) == (signal.min, signal.max)
    words = {t.name: [item.name for item in t.items] for t in read.typeDefinitions}
    assert words["verdict"] == list(VERDICTS) and words["cause"] == list(CAUSES)


def test_verdicts_and_ratios_are_the_cores_bit_for_bit(running, core, faulty):
    drive, y = faulty
    expected = core.monitor().run(drive.t, drive.v, drive.u, y)
    inputs = np.column_stack([drive.v, drive.u, y])
    seen = []
    for t, row in zip(drive.t, inputs, strict=True):
        running.step(t, row)
        seen.append(_results(running))
    verdict, cause, _, energy, change, _ = (np.array(column) for column in zip(*seen, strict=True))
    assert VERDICTS.index("invalid") in verdict and CAUSES.index("gain") in cause
    np.testing.assert_array_equal(verdict, expected.verdict)
    np.testing.assert_array_equal(energy, expected.energy)
    np.testing.assert_array_equal(change, expected.change)


@pytest.mark.long("30 s: eight drives sample by sample under fmpy")
def test_eight_drives_have_the_verdicts_of_replay(fmus, core, g80, synthetic, tmp_path):
    """Every second drive turns 1.5 times as fast as it should from its middle on."""
    tables = sorted(synthetic.glob("synthetic_*.csv"))[:8]
    verdicts = set()
    for k, table in enumerate(tables):
        drive = read_drive(table, g80)
        y = drive.y.copy()
        y[len(y) // 2 :] *= 1.5 if k % 2 else 1.0
        version = VERSIONS[k // 2 % 2]
        running = Running(fmus[version], tmp_path / table.stem, version)
        seen = []
        for t, *row in zip(drive.t, drive.v, drive.u[:, 0], y[:, 0], strict=True):
            running.step(t, np.array(row))
            seen.append(running.codes("verdict")[0])
        np.testing.assert_array_equal(seen, core.monitor().run(drive.t, drive.v, drive.u, y).verdict)
        verdicts |= {VERDICTS[code] for code in seen}
    assert len(tables) == 8 and {"valid", "invalid"} <= verdicts


def test_a_saved_state_goes_on_with_the_same_bytes(running, faulty):
    drive, y = faulty
    inputs = np.column_stack([drive.v, drive.u, y])
    begin = len(y) // 2 - 200
    for k in range(begin):
        running.step(drive.t[k], inputs[k])
    rng = np.random.default_rng(3)
    for start in sorted(rng.integers(begin, begin + 400, 50)):
        saved = running.state()
        results = []
        for _ in range(2):
            running.restore(saved)
            assert running.state() == saved
            for k in range(start, start + 20):
                running.step(drive.t[k] + 1e4, inputs[k])
            results.append((_results(running), running.state()))
        assert results[0] == results[1]
        running.restore(saved)


def test_another_vehicles_state_and_a_cut_one_are_refused(running):
    saved = running.state()
    for data in (saved[:-1], saved[:20] + bytes(4) + saved[24:]):
        with pytest.raises(FMICallException):
            running.restore(data)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_input_that_is_no_number_is_an_error(running, value):
    with pytest.raises(FMICallException):
        running.feed(np.array([20.0, value, 0.0]))


def test_a_wrong_step_size_is_an_error_that_names_the_sample_period(running):
    with pytest.raises(FMICallException):
        running.step(0.0, np.array([20.0, 0.0, 0.0]), 0.5 * running.period)
    if running.version == 3:
        assert f"expected the sample period {running.period:g} s" in running.said[-1]


def test_an_output_cannot_be_set(running):
    reference = running.references["margin"]
    with pytest.raises(FMICallException):
        (running.fmu.setReal if running.version == 2 else running.fmu.setFloat64)([reference], [1.0])


def test_the_sources_compile_as_their_build_description_says(fmus, tmp_path):
    assert compile_sources(fmus[3], tmp_path) > 6


def test_the_command_writes_the_same_bytes_twice_and_sources_that_are_the_cores(lpvguard, vehicle, tmp_path):
    out = tmp_path / "g80.fmu"
    command = ("fmu", "--vehicle", "g80", "--coefficients", vehicle, "-o", out)
    assert lpvguard(*command).returncode == 0
    first = out.read_bytes()
    assert lpvguard(*command).returncode == 0 and out.read_bytes() == first
    with zipfile.ZipFile(out) as archive:
        names = archive.namelist()
        assert archive.read("sources/vehicle/lpvguard_coeff.c") == (vehicle / "lpvguard_coeff.c").read_bytes()
    assert "sources/buildDescription.xml" in names
    out.write_text("something else")
    assert "was not written by `lpvguard fmu`" in lpvguard(*command).stderr
