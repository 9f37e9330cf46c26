"""Thresholds of a rate: conformal where recordings suffice, else from the tail, and said so."""

import json
from importlib import resources

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.core.compiled import TESTS
from lpvguard.evaluate.comparison import MONITOR
from lpvguard.evaluate.judged_drives import JudgedDrives, calibrations_of, rate_of
from lpvguard.evaluate.summary import summary
from lpvguard.identify import identification as stage
from lpvguard.identify.calibration import RATED, Calibration, RateTarget, Recordings, calibrate
from lpvguard.identify.confirmation import design_words
from lpvguard.identify.identification import DriveSet
from lpvguard.vehicle.project import load_project, parse_project


def fleet(drives: int, per_1000_h: float, confident: bool = False) -> tuple[dict[str, float], RateTarget]:
    """Scores of drives of a quarter of an hour, each of 30 exponential blocks, and their target."""
    blocks = np.random.default_rng(1).exponential(size=(drives, 30))
    maxima = {f"d{i:03}": x.tolist() for i, x in enumerate(blocks)}
    target = RateTarget(per_1000_h, confident, maxima, dict.fromkeys(maxima, 900.0))
    return {d: max(x) for d, x in maxima.items()}, target


def test_enough_recordings_need_no_extrapolation():
    scores, target = fleet(100, 80.0)
    calibration = calibrate(scores, 0.1, target=target)
    assert calibration.alpha == pytest.approx(0.02) and calibration.extrapolation is None
    assert calibration.threshold == sorted(scores.values())[98]  # rank 99 of 101 * 0.98


def test_fewer_recordings_extrapolate_and_say_so():
    scores, target = fleet(100, 1.0)
    calibration = calibrate(scores, 0.1, target=target)
    tail = calibration.extrapolation
    assert calibration.alpha is None and tail is not None
    assert calibration.threshold == tail.threshold > max(scores.values())
    assert "1 alarms per 1000 judged hours, extrapolated from 25 hours" in calibration.claim()
    assert "975 more judged hours would make it exact" in calibration.claim()
    assert tail.interval[0] <= 1.0 <= tail.interval[1]
    again = Calibration.from_dict(json.loads(json.dumps(calibration.over(dict(target.judged_s)).to_dict())))
    assert again == calibration.over(dict(target.judged_s))
    safe = calibrate(scores, 0.1, target=fleet(100, 1.0, confident=True)[1])
    assert safe.threshold > calibration.threshold and safe.extrapolation.interval[0] <= 1.0


def test_too_few_maxima_state_no_rate():
    scores, target = fleet(100, 1.0)
    two = {d: scores[d] for d in list(scores)[:2]}
    few = RateTarget(1.0, False, {d: x[:4] for d, x in target.maxima.items()}, target.judged_s)
    calibration = calibrate(two, 0.1, target=few)
    assert calibration.extrapolation is None and calibration.threshold == max(two.values())
    assert "alpha is not stated" in calibration.claim()


def test_every_group_has_a_tail_of_its_own():
    scores, target = fleet(100, 1.0)
    groups = {d: "wet" if i % 2 else "dry" for i, d in enumerate(scores)}
    calibration = calibrate(scores, 0.1, recordings=Recordings(groups=groups), target=target)
    assert {g.extrapolation.hours for g in calibration.groups.values()} == {12.5}
    assert calibration.carried == max(
        calibration.threshold, *(g.threshold for g in calibration.groups.values())
    )
    assert (
        "group wet: threshold" in calibration.claim()
        and "extrapolated from 12.5 hours" in calibration.claim()
    )
    assert calibration.of_group("wet").threshold == calibration.groups["wet"].threshold


def test_a_rate_needs_hann_frames_and_is_left_out_of_settings_without_one():
    document = load_project("g80").model_dump(by_alias=True)
    assert not any(key.startswith("alarms_") for key in document["frame_test"])
    document["frame_test"]["alarms_per_1000_h"] = 1.0
    assert parse_project(document, "x").frame_test.alarms_per_1000_h == 1.0
    document["frames"] |= {"estimator": "dft", "length_s": 40.0}
    with pytest.raises(InputError, match="alarms_per_1000_h"):
        parse_project(document, "x")


@pytest.fixture(scope="module")
def rated(g80, synthetic, made) -> stage.StoredIdentification:
    """The synthetic drives identified with a rate."""
    settings = g80.frame_test.model_copy(update={"alarms_per_1000_h": 1.0})
    project = g80.model_copy(update={"frame_test": settings})

    def make(folder):
        stage.save(*stage.identify(project, synthetic), folder)

    return stage.load(made.folder("g80_rated", make))


@pytest.mark.slow("10 s: the synthetic drives identified with a rate")
def test_every_test_has_its_share_of_the_rate_and_evaluate_says_so(rated, synthetic):
    by_test = calibrations_of(rated)
    assert set(by_test) == set(RATED) == {*TESTS, "pools"}
    for test, c in by_test.items():
        assert c.target.per_1000_h == 0.25 and c.extrapolation is not None and c.alpha is None, test
        for drive, score in c.scores.items():
            assert max(c.target.maxima[drive]) == pytest.approx(score, rel=1e-6), (test, drive)
    judged = JudgedDrives.left_one_out(rated, DriveSet(rated.project, rated.model, synthetic))
    name = next(iter(judged.experiments))
    for test, c in judged.calibrations[name].items():
        assert name not in c.scores and c.target.per_1000_h == (1.0 if test == MONITOR else 0.25)
    rate = rate_of(judged, rated)
    assert rate["per_1000_h"] == 1.0
    assert 0 < rate["extrapolated_from_h"] < by_test["frame"].extrapolation.hours
    assert "blocks" in rated.pools.to_dict()


@pytest.mark.slow("10 s: the synthetic drives identified with a rate")
def test_the_exported_design_is_the_chosen_one(rated):
    choice = rated.confirmation
    row = next(r for r in choice.rows if r["label"] == design_words(choice.chosen))
    assert row["threshold"] == pytest.approx(rated.calibration.carried, rel=1e-6)
    words = rated.coefficients.words
    assert (int(words["confirm"]), int(words["of_last"])) == choice.chosen
    assert choice.starts > 0 and rated.designed.frame_test.confirm == choice.chosen[0]


def test_the_first_line_of_an_evaluation_states_the_rate():
    example = resources.files("lpvguard.schemas").joinpath("examples", "evaluate.json")
    evaluation = json.loads(example.read_text(encoding="utf-8"))
    evaluation["rate"] = {"per_1000_h": 1.0, "extrapolated_from_h": 0.5}
    assert "promised 1 per 1000 judged hours, extrapolated from 0.5 hours" in summary(evaluation)[0]
