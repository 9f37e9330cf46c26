"""The change test: its estimate, its sizes, and that the core says what the definition says."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.core.compiled import CHANGE_PARTS
from lpvguard.drives.faults import Fault, inject
from lpvguard.drives.frames import Estimator
from lpvguard.drives.tables import read_drive
from lpvguard.identify import identification as stage
from lpvguard.identify.bounds import nominal_error
from lpvguard.identify.calibration import NO_RECORDINGS
from lpvguard.identify.change import (
    BLOCK,
    FLOOR,
    UNSTATED_FLOOR,
    Blocks,
    ChangeTest,
    Met,
    calibrated_change,
    estimates_met,
    regressor_products,
)
from lpvguard.replay.replayer import Replayer
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import parse_project

ROUNDING = 2e-3
"""Of a ratio in float."""


def fault_drive(estimator: Estimator, gain: float, delay_s: float, bias: float, n: int = 40_000):
    """e, yhat (n, 1) and v (n,) of an output with these faults, richly excited."""
    t = np.arange(n) * estimator.Ts
    yhat = 0.2 + np.sin(1.1 * t) + 0.6 * np.sin(0.31 * t + 1.0)
    slope = 1.1 * np.cos(1.1 * t) + 0.6 * 0.31 * np.cos(0.31 * t + 1.0)
    e = gain * yhat - delay_s * slope + bias
    return e[:, None], yhat[:, None], np.full(n, float(np.mean(estimator.speed_range)))


def designed(project, estimator: Estimator, e, yhat, v) -> ChangeTest:
    """With the sizes of one drive."""
    test = ChangeTest.design(project).with_moments(regressor_products(e, yhat, v, estimator))
    return test.with_sizes(estimates_met(test, e, yhat, v, estimator))


def test_gain_delay_and_bias_are_estimated_in_their_units(g80):
    estimator = Estimator.from_project(g80, NominalModel(g80))
    healthy = fault_drive(estimator, 0.0, 0.0, 0.0)
    test = replace(designed(g80, estimator, *healthy), memory_s=200.0)
    for gain, delay_s, bias in ((-0.3, 0.0, 0.0), (0.0, 0.05, 0.0), (0.0, 0.0, 0.1), (0.2, -0.03, 0.05)):
        e, yhat, v = fault_drive(estimator, gain, delay_s, bias)
        (blocks,) = Blocks.stretches(e, yhat, estimator.settled(v))
        # A prior of a fifth of a memory pulls towards 0 by about a sixth: that of each, and no more.
        theta = test.estimates(blocks)[-1, 0]
        unit = np.array([test.unit[0, 0], test.unit[0, 1] / (BLOCK * test.Ts), 1.0])
        assert theta / unit == pytest.approx(np.array([gain, delay_s, bias]) / 1.2, rel=0.03, abs=2e-3)


def test_where_nothing_is_excited_the_prior_keeps_the_estimate(g80):
    estimator = Estimator.from_project(g80, NominalModel(g80))
    test = designed(g80, estimator, *fault_drive(estimator, 0.1, 0.02, 0.05))
    e, yhat, v = fault_drive(estimator, 0.5, 0.1, 0.0)
    met = estimates_met(test, 1e-3 * e, 1e-3 * yhat, v, estimator)
    assert (met.largest < 2e-2 * test.largest).all(), "faults five times as large"


def test_blocks_are_whole_settled_and_begin_with_the_one_after_the_first(g80):
    estimator = Estimator.from_project(g80, NominalModel(g80))
    n = 100
    usable = np.ones(n, bool)
    usable[40] = False
    index = np.arange(n, dtype=float)[:, None]
    first, second = Blocks.stretches(index, 2 * index, usable)
    assert first.ends[0] == 10 and (np.diff(first.ends) == BLOCK).all() and first.ends[-1] == 38
    assert second.ends[0] == 50, "42 holds sample 40 and 46 is only remembered"
    assert first.e[:, 0] == pytest.approx(first.ends - 1.5)
    assert first.phi[:, 0, 0] == pytest.approx(2 * (first.ends - 1.5))
    assert (first.phi[:, 0, 1] == -2.0 * BLOCK).all() and (first.phi[:, 0, 2] == 1.0).all()
    assert next(Blocks.stretches(index[:9], index[:9], usable[:9])).ends.tolist() == []
    assert list(Blocks.stretches(index, index, np.zeros(n, bool))) == []
    assert estimator.Ts > 0


def test_the_core_says_what_the_definition_says(identified, synthetic, g80, core):
    stored, model = stage.load(identified), NominalModel(g80)
    test, estimator = stored.change, Estimator.from_project(g80, model)
    judged = 0
    for name in ("synthetic_06", "synthetic_08"):
        drive = read_drive(synthetic / f"{name}.csv", g80)
        for faulty in (drive, inject(drive, Fault("gain", 0.5), 50.0, g80.Ts_s)):
            said = core.monitor().run_drive(faulty).change
            for blocks in Blocks.stretches(*nominal_error(faulty, model), estimator.settled(faulty.v)):
                ratio = np.abs(test.estimates(blocks) / test.size).max(axis=2)[:, 0]
                # Judged in one of the pushes after the block, before the next ends.
                later = said[blocks.ends[:-1] + BLOCK - 1]
                assert later[:30] == pytest.approx(ratio[:30], rel=ROUNDING, abs=ROUNDING)
                # A block beside which the core has no time is lost; that fades with the memory.
                assert np.abs(later - ratio[:-1]).max() < 0.1 * max(1.0, ratio.max())
                assert later.max() == pytest.approx(ratio.max(), rel=UNSTATED_FLOOR - 1)
                judged += len(later)
    assert judged > 1000


def test_alpha_alone_decides_the_threshold_and_without_it_the_bound_setting_drives_stay_below():
    scores = {f"drive_{k}": 0.1 * k for k in range(10)}
    few = dict(list(scores.items())[:3])
    stated, unstated = (calibrated_change(s, 0.2, NO_RECORDINGS) for s in (scores, few))
    assert (stated.threshold, stated.alpha) == (pytest.approx(0.8), 0.2)
    assert (unstated.threshold, unstated.alpha) == (UNSTATED_FLOOR, None)
    assert calibrated_change(dict.fromkeys(scores, 0.0), 0.2, NO_RECORDINGS).threshold == FLOOR


def test_sizes_are_the_rms_of_the_bound_setting_drives_and_scores_the_cores(identified, synthetic, g80, core):
    stored, model = stage.load(identified), NominalModel(g80)
    test, estimator = stored.change, Estimator.from_project(g80, model)
    theta = np.concatenate(
        [
            test.estimates(blocks)[:, 0]
            for name in stored.manifest["drives"]["bounds"]
            for drive in [read_drive(synthetic / f"{name}.csv", g80)]
            for blocks in Blocks.stretches(*nominal_error(drive, model), estimator.settled(drive.v))
        ]
    )
    largest, rms = np.abs(theta).max(axis=0), np.sqrt(np.mean(theta**2, axis=0))
    assert test.largest[0] == pytest.approx(largest)
    assert test.size[0] == pytest.approx(np.maximum(rms * (largest / rms).max(), 0.01 * test.unit[0, 0]))
    assert np.abs(theta / test.size).max() == pytest.approx(1.0), "as large as was met"
    assert test.calibration.threshold == max(test.calibration.scores.values())  # 9 to 18 drives, alpha 0.1
    assert set(test.calibration.scores) <= set(stored.manifest["drives"]["calibration"])
    for name, score in test.calibration.scores.items():
        said = core.monitor().run_drive(read_drive(synthetic / f"{name}.csv", g80)).change.max()
        assert said == pytest.approx(score, rel=1e-5)


def test_an_alarm_names_output_part_and_estimate(core, g80, synthetic):
    drive = read_drive(synthetic / "synthetic_08.csv", g80)
    replayer = Replayer(g80, core, threshold=1e9, energy_threshold=1e9)
    assert not replayer.replay(drive).changed.any()
    replay = replayer.replay(inject(drive, Fault("gain", 0.3), 60.0, g80.Ts_s))
    alarm = replay.alarms[0]
    assert {a.test for a in replay.alarms} == {"change"} and alarm.t_s > 60.0
    assert replay.changed[round(alarm.t_s / g80.Ts_s)] and alarm.margin > alarm.threshold
    assert alarm.output == "yaw_rate" and alarm.part in CHANGE_PARTS and alarm.evidence > 1
    unit, size = replayer.change_unit[0], replayer.change_size[0]
    estimate = np.array(
        [alarm.estimate.gain, alarm.estimate.delay_s / (BLOCK * g80.Ts_s), alarm.estimate.bias]
    )
    ratios = np.abs(estimate * [*unit, 1.0]) / size
    assert (
        ratios.max() == pytest.approx(alarm.margin, rel=1e-4) and CHANGE_PARTS[ratios.argmax()] == alarm.part
    )
    assert replay.to_dict()["max_change_ratio"] == pytest.approx(replay.run.change.max())


def test_a_memory_of_less_than_two_blocks_and_another_than_stored_are_refused(g80, identified, tmp_path):
    document = g80.model_dump(by_alias=True)
    document["change_test"]["memory_s"] = g80.Ts_s
    with pytest.raises(InputError, match=r"change_test.memory_s: .* two blocks of 4 samples"):
        ChangeTest.design(parse_project(document, "short"))
    copy = tmp_path / "copy"
    shutil.copytree(identified, copy)
    data = json.loads((copy / "change.json").read_text())
    (copy / "change.json").write_text(json.dumps(data | {"memory_s": 2 * data["memory_s"]}))
    artefacts.seal(copy)
    with pytest.raises(InputError, match=r"memory_s: .* the memory of project.json"):
        stage.load(copy)


def test_without_a_settled_block_there_are_no_sizes(g80):
    with pytest.raises(InputError, match="the drives that set the bounds have no settled block"):
        ChangeTest.design(g80).with_moments(np.zeros((1, 3, 3)))


def test_an_output_that_never_moved_has_finite_coefficients(g80):
    sums = np.zeros((1, 3, 3))
    sums[0, 2, 2] = 100.0
    test = ChangeTest.design(g80).with_moments(sums).with_sizes(Met(np.zeros((1, 3)), np.zeros((1, 3)), 100))
    assert all(np.isfinite(np.float32(x)).all() for x in test.coefficients()[2].values())
