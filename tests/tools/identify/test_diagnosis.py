"""The scales of the diagnosis, their file, and what the compiled core finds with them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from lpvguard import schemas
from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.core.compiled import CAUSES, Core, shipped_vehicle
from lpvguard.core.seal import coefficient_source
from lpvguard.drives.faults import Fault, inject
from lpvguard.drives.frames import Estimator
from lpvguard.drives.tables import Drive
from lpvguard.identify import diagnosis
from lpvguard.identify.diagnosis import PARTS, DiagnosisScales, windows_of
from lpvguard.vehicle.nominal import NominalModel

UNIT = np.array([[4.0, 40.0]])
"""1 / sizes."""


def rich(estimator: Estimator, n: int, phase: float):
    """Nominal output (n, 1) of a rich drive, and its speed."""
    t = np.arange(n) * estimator.Ts
    yhat = 0.3 + np.sin(1.1 * t + phase) + 0.6 * np.sin(0.31 * t + 1.0) + 0.3 * np.sin(2.7 * t + phase)
    return 0.12 * yhat[:, None], np.full(n, float(np.mean(estimator.speed_range)))


def error_of(theta: np.ndarray, yhat: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """e (n, 1) that a theta of regressors over their sizes makes, without its delay, and a little noise."""
    p = yhat * UNIT[0, 0]
    return theta[0] * p + theta[2] + theta[3] * p * np.abs(p) + 1e-3 * random.standard_normal(yhat.shape)


def test_windows_estimate_what_made_them(g80):
    estimator = Estimator.from_project(g80, NominalModel(g80))
    yhat, v = rich(estimator, 20_000, 0.0)
    theta = np.array([0.2, 0.0, -0.05, 0.1])
    windows = windows_of(error_of(theta, yhat, np.random.default_rng(1)), yhat, v, estimator, UNIT)
    assert len(windows.n) > 20 and (windows.n == 125).all()
    assert windows.theta[:, 0] == pytest.approx(np.tile(theta, (len(windows.n), 1)), abs=3e-3)
    assert (windows.residue < 1e-6).all() and (windows.still > 0).all()
    short = windows_of(0 * yhat[:240], yhat[:240], v[:240], estimator, UNIT)
    assert short.n.tolist() == [], "less than half a window is settled"
    outside = windows_of(0 * yhat, yhat, 0 * v, estimator, UNIT)
    assert outside.n.tolist() == []


def scaled(
    g80, deviation: np.ndarray, drives: int = 40, samples: int = 4000, kept: int = 4000
) -> DiagnosisScales:
    """Scales of drives whose theta is drawn with these standard deviations (4,), anew after ``kept``
    samples."""
    estimator, random = Estimator.from_project(g80, NominalModel(g80)), np.random.default_rng(2)
    windows_by_drive = []
    for k in range(drives):
        yhat, v = rich(estimator, samples, 0.7 * k)
        e = [
            error_of(deviation * random.standard_normal(PARTS), yhat[at : at + kept], random)
            for at in range(0, samples, kept)
        ]
        windows_by_drive.append(windows_of(np.concatenate(e), yhat, v, estimator, UNIT))
    return DiagnosisScales.from_windows(g80, 1 / UNIT, windows_by_drive)


def test_the_spread_is_that_of_healthy_drives(g80):
    deviation = np.array([0.1, 0.0, 0.03, 0.02])
    scales = scaled(g80, deviation)
    spread = np.sqrt(np.diagonal(scales.spread[0]) / scales.enlarged[0])
    assert spread[[0, 2, 3]] == pytest.approx(deviation[[0, 2, 3]], rel=0.35)
    assert spread[1] < 0.005
    assert 1.0 <= scales.enlarged[0] < 2.5
    with pytest.raises(InputError, match="window"):
        DiagnosisScales.from_windows(g80, 1 / UNIT, [])


@pytest.mark.unhurried
def test_what_a_drive_keeps_is_told_from_what_changes_in_it(g80):
    deviation = np.array([0.1, 0.0, 0.03, 0.02])
    assert scaled(g80, deviation).kept.tolist() == [0.99]
    assert scaled(g80, deviation, kept=500).kept.tolist() == [0.0], "drawn anew every 10 s"
    assert scaled(g80, deviation, samples=1000).kept.tolist() == [0.0], "too short to tell"


def test_a_file_without_the_share_that_a_drive_keeps_is_read_as_none(g80):
    data = scaled(g80, np.array([0.05, 0.0, 0.02, 0.02]), 10).to_dict()
    del data["kept"]
    assert DiagnosisScales.restored(g80, data).kept.tolist() == [0.0]


@pytest.mark.parametrize("windows", [1, 8, 83])
def test_the_kernel_of_the_spread_sums_what_the_inverses_say(windows):
    """Windows fill their lanes, leave some empty, or are fewer than lanes are."""
    random = np.random.default_rng(windows)
    theta, root = random.standard_normal((2, PARTS, windows)), random.standard_normal((windows, 2, PARTS, 6))
    errors, moments = root @ root.swapaxes(2, 3), np.stack([np.diag([1.0, 2.0, 0.1, 3.0]) + 0.05] * 2)
    inverse = np.linalg.inv(moments + errors)
    u = (inverse @ theta.transpose(2, 0, 1)[..., None])[..., 0]
    wanted = (u[..., None] * u[..., None, :] - inverse).sum(axis=0)
    turned = np.ascontiguousarray(errors.transpose(2, 3, 1, 0))
    assert diagnosis._surplus(theta, turned, moments) == pytest.approx(wanted, rel=1e-10)


def test_what_no_record_names_is_what_healthy_vehicles_differ_by(g80):
    scales = scaled(g80, np.array([0.05, 0.0, 0.02, 0.02]), 10)
    deviation = np.array([0.02, 0.003, 0.01, 0.004])
    independent = replace(scales, spread=np.diag(deviation**2)[None], interval=2.5, kept=np.zeros(1))
    gain, delay, bias = 2.5 * deviation[:3] * np.array([UNIT[0, 0], 4 * g80.Ts_s * UNIT[0, 1], 1.0])
    assert independent.least[0] == pytest.approx([gain, delay, bias])
    name = g80.outputs[0].name
    assert independent.least_text(g80) == (
        f"{name} gain from {1 / 1.2:.2f} to {1 / 0.8:.2f}, delay below {delay:.2g} s, bias below 0.025 rad/s"
    )
    # What the other parts of theta tell of one is known; the rest is what an interval cannot tell.
    tied = np.diag(deviation**2)
    tied[0, 3] = tied[3, 0] = -0.97 * deviation[0] * deviation[3]
    known = replace(independent, spread=tied[None])
    assert known.least[0, 0] == pytest.approx(gain * np.sqrt(1 - 0.97**2))
    foretold = replace(independent, kept=np.array([0.6]))
    assert foretold.least == pytest.approx(0.8 * independent.least), "by what a long drive was before"
    wide = replace(independent, spread=100 * independent.spread)
    assert "gain from 0.33 to any above 1, delay" in wide.least_text(g80)


def test_the_file_is_as_its_schema_says_and_comes_back(g80):
    scales = scaled(g80, np.array([0.05, 0.0, 0.02, 0.02]), 10)
    data = json.loads(artefacts.to_json(scales.to_dict()))
    Draft202012Validator(schemas.schema("diagnosis")).validate(data)
    back = DiagnosisScales.restored(g80, data)
    assert back.table.crc32_by_type() == scales.table.crc32_by_type()
    assert json.loads(artefacts.to_json(back.to_dict())) == data


@pytest.fixture(scope="module")
def core(g80, tmp_path_factory):
    """The shipped core with a table of a healthy vehicle's small spread."""
    scales = scaled(g80, np.array([0.01, 0.0, 0.002, 0.004]))
    folder = tmp_path_factory.mktemp("diagnosed") / g80.name
    folder.mkdir()
    shipped = shipped_vehicle(g80.name)
    artefacts.write_files(
        folder,
        {name: (shipped / name).read_text() for name in ("lpvguard_vehicle.h", "lpvguard_coeff.c")}
        | {"lpvguard_diagnosis.c": coefficient_source(scales.table)},
    )
    return Core(folder)


@pytest.mark.parametrize(
    ("fault", "cause", "value"),
    [
        (Fault("gain", 0.6), "gain", 0.6),
        (Fault("gain", -1.0), "sign", -1.0),
        (Fault("output_delay", 0.3), "delay", 0.3),
        (Fault("input_delay", 0.3), "delay", -0.3),
        (Fault("bias", 0.2), "bias", 0.2),
        (Fault("freeze"), "frozen", None),
    ],
    ids=lambda x: x.label if isinstance(x, Fault) else "",
)
def test_the_compiled_core_names_an_injected_fault(g80, core, fault, cause, value):
    model = NominalModel(g80)
    n = 4500
    t = np.arange(n) * g80.Ts_s
    v = np.full(n, float(np.mean(model.speed_range)))
    u = 0.05 * (np.sin(1.1 * t) + 0.6 * np.sin(0.31 * t + 1.0) + 0.3 * np.sin(2.7 * t))[:, None]
    u = u + model.input_offset
    drive = Drive("made", t, v, u, model.simulate(v, u, np.zeros(1)))
    start_s = 40.0
    run = core.monitor().run_drive(inject(drive, fault, start_s, g80.Ts_s))
    final = run.causes.final.tolist()[:2]
    # After an alarm within two samples of the jump, half of the record does not name a sign or a bias.
    assert final == ([True] if cause in ("sign", "bias") else [False, True])
    for i, (sooner, later) in enumerate([(5.0, 6.5), (10.0, 11.5)][-len(final) :]):
        assert CAUSES[run.causes.cause[i]] == cause
        assert sooner < run.causes.t_found_s[i] - run.causes.t_alarm_s[0] < later
        if value is not None:
            assert run.causes.low[i] <= value <= run.causes.high[i]
        onset = run.causes.t_alarm_s[i] - run.causes.onset_s[i]
        assert abs(onset - start_s) < 4.0


def test_a_folder_without_a_table_finds_no_cause(g80):
    core = Core(shipped_vehicle(g80.name))
    n = 200
    run = core.monitor().run(np.arange(n) * g80.Ts_s, np.full(n, 10.0), np.zeros((n, 1)), np.zeros((n, 1)))
    assert len(run.causes.cause) == 0
