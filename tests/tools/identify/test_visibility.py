"""The list of invisible faults: what it calls the smallest visible error is where the exact margin crosses
the threshold."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lpvguard.drives.frames import Estimator
from lpvguard.engine.validation import s1
from lpvguard.identify.change import BLOCK, Blocks, ChangeTest
from lpvguard.identify.narrow_error import in_bins, narrow_excitation
from lpvguard.identify.visibility import PERCENTILE, SPEED_CELLS, Excitation, speed_cell, visibility
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project

OMEGA = np.array([0.0, 0.7, 2.0, 9.0])
SPEEDS = (4.0, 19.0)
THRESHOLD = 1.7
W_DELTA = np.array([[0.05], [0.1], [0.15], [0.5]])
BINS = len(OMEGA)


def case(n_y: int, frames: int = 400, seed: int = 3):
    """Counted frames of a made-up fleet: bin, speed [m/s], Z; and B_w."""
    random = np.random.default_rng(seed)
    Z = random.standard_normal((frames, n_y)) + 1j * random.standard_normal((frames, n_y))
    B_w = 10.0 ** random.uniform(-2, -1, (BINS, n_y))
    return random.integers(0, BINS, frames), random.uniform(*SPEEDS, frames), Z, B_w


def run(bin_of, speed, Z, B_w, W_delta=W_DELTA) -> dict:
    met = Excitation.from_frames("drive", SPEEDS, bin_of, speed, Z, W_delta, B_w, np.arange(len(Z)))
    return visibility(OMEGA, SPEEDS, met, W_delta, THRESHOLD)


def representative(c: int, k: int, bin_of, speed, Z, B_w, W_delta=W_DELTA) -> np.ndarray:
    """Z of the frame at the percentile, found independently: sorted by the margin of a dead vehicle, nearest
    rank."""
    width = (SPEEDS[1] - SPEEDS[0]) / SPEED_CELLS
    in_cell = (bin_of == k) & (np.minimum((speed - SPEEDS[0]) // width, SPEED_CELLS - 1) == c)
    ordered = sorted(Z[in_cell], key=lambda z: float(s1.margin(-z, z, W_delta[k], B_w[k])))
    return ordered[-(-PERCENTILE * len(ordered) // 100) - 1]


@pytest.mark.parametrize(("n_y", "n_delta"), [(1, 1), (2, 1), (3, 1), (2, 2), (3, 3)])
def test_margin_crosses_the_threshold_at_the_smallest_visible_errors(n_y, n_delta):
    """Also of one Delta an output (n_delta = n_y), with weights that differ."""
    frames, W_delta = case(n_y), W_DELTA * (1.0 + np.arange(n_delta))
    B_w, seen = frames[-1], run(*frames, W_delta)
    np.testing.assert_allclose(seen["gain_error_floor"], THRESHOLD * W_DELTA[:, 0])
    for c, cell in enumerate(seen["at_percentile"]):
        assert (np.array(cell["gain_error"]) > seen["gain_error_floor"]).all()
        for k in range(BINS):
            z = representative(c, k, *frames, W_delta)
            for factor, above in ((1 - 1e-6, False), (1 + 1e-6, True)):
                g = factor * cell["gain_error"][k]
                assert (s1.margin(-g * z, z, W_delta[k], B_w[k]) > THRESHOLD) == above
                tau = cell["delay_s"][k]
                if tau is not None:
                    late = np.exp(-1j * OMEGA[k] * factor * tau)
                    assert (s1.margin((late - 1) * z, z, W_delta[k], B_w[k]) > THRESHOLD) == above


def test_one_output_agrees_with_its_closed_form():
    frames = case(1)
    for c, cell in enumerate(run(*frames)["at_percentile"]):
        for k in range(BINS):
            z = float(np.abs(representative(c, k, *frames)[0]))
            assert cell["excitation"][k] == pytest.approx(z, rel=1e-12)
            assert cell["gain_error"][k] == pytest.approx(
                THRESHOLD * (frames[-1][k, 0] + W_DELTA[k, 0] * z) / z, rel=1e-9
            )


def test_stated_faults_follow_from_the_bins():
    frames = case(1)
    for cell in run(*frames)["at_percentile"]:
        gains = np.array(cell["gain_error"])
        stated = {s["fault"]: s["visible"] for s in cell["stated"]}
        assert stated["gain 0.6"] == (gains.min() < 0.4)
        assert stated["gain 0.7"] == (gains.min() < 0.3)
        for tau in (0.3, 0.15):
            assert stated[f"delay {tau:g} s"] == bool((np.abs(1 - np.exp(-1j * OMEGA * tau)) > gains).any())
        assert cell["smallest_gain_error"] == gains.min()
        assert cell["smallest_delay_s"] == min(d for d in cell["delay_s"] if d is not None)


def test_no_excitation_beats_the_floor_and_strong_excitation_reaches_it():
    bin_of, speed, Z, B_w = case(1)
    seen = run(bin_of, speed, 1e6 * Z, B_w)
    for cell in seen["at_percentile"]:
        assert cell["gain_error"] == pytest.approx(seen["gain_error_floor"], rel=1e-3)
        assert all(g >= f for g, f in zip(cell["gain_error"], seen["gain_error_floor"], strict=False))


def test_cells_without_frames_and_frames_without_excitation_are_none():
    bin_of, speed, Z, B_w = (
        np.array([1, 1]),
        np.array([4.5, 4.6]),
        np.zeros((2, 1), complex),
        np.full((BINS, 1), 0.1),
    )
    seen = run(bin_of, speed, Z, B_w)
    assert json.loads(json.dumps(seen)) == seen
    assert seen["at_percentile"][0]["frames"] == [0, 2, 0, 0]
    for cell in seen["at_percentile"]:
        assert cell["gain_error"] == cell["delay_s"] == [None] * BINS
        assert cell["smallest_gain_error"] is None and cell["smallest_delay_s"] is None
        assert all(s["visible"] is None for s in cell["stated"])
    assert seen["at_percentile"][0]["excitation"] == [None, 0.0, None, None]


def test_the_strongest_frame_is_at_least_as_telling_and_inflation_scales_what_is_visible():
    bin_of, speed, Z, B_w = case(2)
    seen = run(bin_of, speed, Z, B_w)
    for typical, strongest in zip(seen["at_percentile"], seen["at_strongest"], strict=False):
        assert all(s <= t for s, t in zip(strongest["gain_error"], typical["gain_error"], strict=False))
        assert strongest["frames"] == typical["frames"]
    inflated = Excitation.from_frames(
        "drive", SPEEDS, bin_of, speed, Z, 1.3 * W_DELTA, 1.3 * B_w, np.arange(len(Z))
    )
    met = Excitation.from_frames("drive", SPEEDS, bin_of, speed, Z, W_DELTA, B_w, np.arange(len(Z)))
    a, b = (
        visibility(OMEGA, SPEEDS, inflated, 1.3 * W_DELTA, THRESHOLD),
        visibility(OMEGA, SPEEDS, met, W_DELTA, THRESHOLD, 1.3),
    )
    for left, right in zip(a["at_percentile"], b["at_percentile"], strict=False):
        assert left["gain_error"] == pytest.approx(right["gain_error"], rel=1e-12)


def test_change_test_shows_a_gain_error_in_one_bin():
    """In the definition: with the smallest visible error as the only one, the ratio reaches the threshold."""
    project, random = load_project("g80"), np.random.default_rng(5)
    estimator = Estimator.from_project(project, NominalModel(project))
    test = replace(ChangeTest.design(project), size=np.full((1, 3), 0.02))
    N = 20_000
    turns = np.arange(1, 1200)[:, None] / N * 2 * np.pi
    waves = np.cos(turns * np.arange(N) + random.uniform(0, 2 * np.pi, turns.shape))
    v, yhat = np.full(N, 9.0), (waves / np.arange(10, 1209)[:, None]).sum(axis=0)[:, None]
    parts = in_bins(yhat, estimator.omega, project.Ts_s)
    np.testing.assert_allclose(parts.sum(axis=0), yhat, atol=1e-9)
    excitation = narrow_excitation(test, "drive", yhat, v, estimator)
    cell = int(speed_cell(estimator.speed_range, v[:1])[0])
    for k in (1, 4, 8):
        of_bin = excitation.strongest["dead"][excitation.strongest["group"] == cell * estimator.n_bins + k]
        hop = max(1, int(estimator.hop[k]) // BLOCK)
        for factor in (0.5, 1.0):
            error = -factor / of_bin[0] * parts[k]
            ratios = [
                np.abs(test.estimates(b)[::hop] / test.size).max()
                for b in Blocks.stretches(error, yhat, estimator.settled(v))
            ]
            assert max(ratios) == pytest.approx(factor, rel=1e-9)


def test_any_test_that_sees_an_error_makes_it_visible():
    frames = case(1)
    met = Excitation.from_frames("drive", SPEEDS, *frames[:3], W_DELTA, frames[-1], np.arange(400))
    group = np.array([0, BINS + 2])
    rows = {"group": group, "hash": group.astype(np.uint64), "dead": np.array([1e3, 1e-3])}
    other = Excitation.of_rows(np.zeros((SPEED_CELLS, BINS), int), rows, rows)
    alone = visibility(OMEGA, SPEEDS, met, W_DELTA, THRESHOLD)["at_percentile"]
    both = visibility(OMEGA, SPEEDS, met, W_DELTA, THRESHOLD, others=[(other, 2.0)])["at_percentile"]
    assert both[0]["gain_error"][0] == pytest.approx(2e-3)
    assert both[1]["gain_error"][2] == alone[1]["gain_error"][2]
    assert both[0]["gain_error"][1:] == alone[0]["gain_error"][1:]
