"""The healthy set of the frame test: it holds the drives' frames, and sees what such a set can see."""

import json

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from lpvguard import schemas
from lpvguard.drives.frames import Estimator
from lpvguard.identify import identification as stage
from lpvguard.identify.bounds import FrameSet
from lpvguard.identify.healthy import CANDIDATES, HealthySet, healthy_set, needed
from lpvguard.identify.premise import premise
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project, parse_project

PROJECT = load_project("g80")
ESTIMATOR = Estimator.from_project(PROJECT, NominalModel(PROJECT))
K = ESTIMATOR.n_bins
FLOOR = np.full((K, 1), 1e-6)


def drive(random: np.random.Generator, gain: float, disturbance: float, frames: int = 400) -> list[FrameSet]:
    """Frames of a drive in bin 3, E = gain Z + w."""
    Z = (random.standard_normal((frames, 2)) @ [1, 1j])[:, None]
    w = disturbance * np.exp(2j * np.pi * random.random((frames, 1)))
    return [FrameSet(3, gain * Z + w, Z, np.arange(frames))]


def chosen(
    drives: list[list[FrameSet]], typical: float, largest: float = 2.0, within: np.ndarray | None = None
) -> HealthySet:
    """Their set, of a further drive of ``typical`` error."""
    rows = {
        "Z": np.concatenate([d[0].Z for d in drives]),
        "group": np.full(sum(len(d[0].Z) for d in drives), 3),
    }
    errors = np.zeros((2, K, 1))
    errors[0, 3], errors[1, 3] = typical, largest
    return healthy_set([needed(d, ESTIMATOR, 1, "S1") for d in drives], rows, FLOOR, *errors, within)


def largest_margin(healthy: HealthySet, drives: list[list[FrameSet]]) -> float:
    return max(
        float((np.abs(s.E) / (healthy.B_w[3] + healthy.W_delta[3] * np.abs(s.Z))).max())
        for d in drives
        for s in d
    )


def test_what_a_drive_asks_for_is_the_largest_remainder():
    (frames,) = drive(np.random.default_rng(1), 0.3, 0.01)
    needs = needed([frames], ESTIMATOR, 1, "S1")
    assert needs.shape == (K, len(CANDIDATES), 1) and not needs[[0, 1, 2]].any()
    for p in (0, 10, 20):
        largest = np.maximum(0, np.abs(frames.E) - CANDIDATES[p] * np.abs(frames.Z)).max()
        assert needs[3, p, 0] == pytest.approx(largest)


def test_the_pair_sees_the_smallest_gain_error_of_all_that_hold_the_frames():
    random = np.random.default_rng(2)
    drives = [drive(random, gain, 0.05) for gain in (0.1, 0.1, 0.1)]
    healthy = chosen(drives, typical=0.0)
    assert largest_margin(healthy, drives) <= 1 + 1e-9
    every = np.concatenate([np.abs(d[0].Z) for d in drives])[:, 0]
    typical = np.percentile(every, 90)
    seen = float(healthy.W_delta[3, 0] + healthy.B_w[3, 0] / typical)
    for W in CANDIDATES:
        B = max(float(np.maximum(0, np.abs(d[0].E) - W * np.abs(d[0].Z)).max()) for d in drives)
        assert seen <= 1.1 * (W + B / typical)


def test_a_further_drive_with_the_typical_error_asks_for_more_uncertainty():
    random = np.random.default_rng(3)
    drives = [drive(random, 0.0, 0.05) for _ in range(3)]
    without, beside = (chosen(drives, typical) for typical in (0.0, 0.3))
    assert beside.W_delta[3, 0] > 0.1 > without.W_delta[3, 0]
    assert beside.W_delta[3, 0] < 0.35


def test_w_delta_stays_within_the_certificates():
    random = np.random.default_rng(4)
    healthy = chosen([drive(random, gain, 0.05) for gain in (0.0, 0.6)], typical=0.5, largest=0.2)
    assert healthy.W_delta[3, 0] <= 0.2
    assert (healthy.W_delta > 0).all()


@pytest.mark.parametrize("W", [0.1234, 0.4321])
def test_a_certificate_that_is_given_limits_the_set(W):
    """With its least B_w for the frames nothing but the certificate is left; with more room it is sharper."""
    drives = [drive(np.random.default_rng(7), gain, 0.05) for gain in (0.1, 0.1, 0.4)]
    least = max(float((np.abs(d[0].E) - W * np.abs(d[0].Z)).max()) for d in drives)
    within = np.full((K, 1), least)
    narrow, wide = (chosen(drives, 0.3, W, b) for b in (within, 10 * within))
    assert narrow.W_delta[3, 0] == W and narrow.B_w[3, 0] == least
    for healthy, B in ((narrow, least), (wide, 10 * least)):
        assert largest_margin(healthy, drives) <= 1 + 1e-9
        assert healthy.W_delta[3, 0] <= W and healthy.B_w[3, 0] <= B
    assert wide.B_w[3, 0] < 5 * least


def test_a_bin_whose_drives_differ_is_wider_than_one_whose_drives_agree():
    random = np.random.default_rng(5)
    alike, unlike = ([drive(random, g, 0.05) for g in gains] for gains in ((0.1, 0.1, 0.1), (0.1, 0.1, 0.5)))
    both = [[*a, FrameSet(4, u[0].E, u[0].Z, u[0].starts)] for a, u in zip(alike, unlike, strict=True)]
    rows = {
        "Z": np.concatenate([s.Z for d in both for s in d]),
        "group": np.concatenate([np.full(len(s.Z), s.bin) for d in both for s in d]),
    }
    largest = np.full((K, 1), 2.0)
    healthy = healthy_set(
        [needed(d, ESTIMATOR, 1, "S1") for d in both], rows, FLOOR, np.zeros((K, 1)), largest
    )
    assert healthy.factor[4, 0] > 1.1 * healthy.factor[3, 0] and healthy.factor.min() == 1
    assert healthy.folds.tolist() == [3 if k in (3, 4) else 0 for k in range(K)]
    again = HealthySet.from_dict(healthy.to_dict())
    assert np.array_equal(again.B_w, healthy.B_w) and np.array_equal(again.W_delta, healthy.W_delta)


def test_every_delta_has_a_pair_of_its_own():
    random = np.random.default_rng(6)
    one, other = drive(random, 0.0, 0.05)[0], drive(random, 0.5, 0.05)[0]
    both = FrameSet(3, np.hstack([one.E, other.E]), np.hstack([one.Z, other.Z]), one.starts)
    rows = {"Z": both.Z, "group": np.full(len(both.Z), 3)}
    needs = [needed([both], ESTIMATOR, 2, "S1_diagonal")] * 2
    healthy = healthy_set(needs, rows, np.full((K, 2), 1e-6), np.zeros((K, 2)), np.full((K, 2), 2.0))
    assert healthy.W_delta.shape == (K, 2) and healthy.B_w.shape == (K, 2)
    assert healthy.W_delta[3, 1] > healthy.W_delta[3, 0]


@pytest.mark.slow("15 s: an identification with bands of the model error")
def test_without_a_ceiling_the_band_sets_w_delta_and_the_frames_have_their_own_set(synthetic, tmp_path):
    document = PROJECT.model_dump(by_alias=True)
    document["bounds"]["nu_ceiling"] = None
    project = parse_project(document, "g80")
    identification, drives = stage.identify(project, synthetic)
    stage.save(identification, drives, tmp_path / "found")
    stored = stage.load(tmp_path / "found")
    error, healthy = stored.model_error, stored.fitted.healthy
    assert len(error.bands) == 1 and error.coverage == 1
    omega = error.grid.omega
    assert (stored.fitted.W_delta[0].magnitude(omega) >= error.bound[:, 0] * (1 - 1e-9)).all()
    assert stored.bounds["nu_ceiling"][1:] == pytest.approx(error.at_bins(ESTIMATOR)[1:, 0])
    W_delta, B_w = stored.fitted.at(ESTIMATOR.omega)
    ours = stored.fitted.of_frames(ESTIMATOR.omega)
    assert (ours[0] <= W_delta * (1 + 1e-9)).all() and (ours[1] <= B_w * (1 + 1e-9)).all()
    speaking = [k for k in range(K) if k not in stored.fitted.silent]
    core = np.array(stored.coefficients.reals["W_delta"]).reshape(K, -1)
    assert speaking and core[speaking] == pytest.approx(ours[0][speaking])
    assert np.array_equal(healthy.B_w, identification.weights.healthy.B_w)
    assert not premise(stored).refuted
    for name in ("model_error", "weights"):
        read = json.loads((tmp_path / "found" / f"{name}.json").read_text())
        Draft202012Validator(schemas.schema(name)).validate(read)


@pytest.mark.slow("10 s: an identification with bands of the model error")
def test_with_a_ceiling_the_certificate_stays_and_the_frames_have_their_own_set_within(synthetic, tmp_path):
    document = PROJECT.model_dump(by_alias=True)
    document["bounds"]["nu_ceiling"] = {"f_hz": [0.5, 2.0], "nu": [0.1, 0.6]}
    identification, drives = stage.identify(parse_project(document, "g80"), synthetic)
    stage.save(identification, drives, tmp_path / "found")
    stored = stage.load(tmp_path / "found")
    ours, certificate = (f(ESTIMATOR.omega) for f in (stored.fitted.of_frames, stored.fitted.at))
    assert all(
        (a <= b * (1 + 1e-9)).all() and (a < 0.9 * b).any() for a, b in zip(ours, certificate, strict=True)
    )
    # What sets B_w of the certificate is the remainder beside its own W_delta alone.
    assert stored.fitted.W_w[0].bound == pytest.approx(identification.bounds.B_w[:, 0])
    assert not stored.fitted.W_delta_healthy and stored.energy.refuting == 1
    speaking = [k for k in range(K) if k not in stored.fitted.silent]
    for names, pair in ((("W_delta", "B_w"), ours), (("W_certificate", "B_certificate"), certificate)):
        for name, expected in zip(names, pair, strict=True):
            core = np.array(stored.coefficients.reals[name]).reshape(K, -1)
            assert core[speaking] == pytest.approx(expected[speaking])
