"""The energy test worked out sample by sample from its inequality, on filters of hand-made numbers."""

import itertools
import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import sosfilt

from lpvguard.base.errors import InputError
from lpvguard.drives.frames import Estimator
from lpvguard.engine.overbound.weight import Weight
from lpvguard.identify import energy
from lpvguard.identify.calibration import ROUNDING
from lpvguard.identify.energy import SMALLEST_SIGMA, EnergyTest, fan

TS, MEMORY, BAND_HZ, SETTLE = 0.1, 3.0, (0.5, 2.0), 4
N = 60


def section(*numbers: float) -> np.ndarray:
    return np.array([list(numbers)])


@pytest.fixture
def test() -> EnergyTest:
    """Two outputs under one Delta, two corners, so three bands."""
    random = np.random.default_rng(1)
    return EnergyTest(
        Ts=TS,
        memory_s=MEMORY,
        band_hz=BAND_HZ,
        settle=SETTLE,
        speed_range=(2.0, 20.0),
        F=np.stack(
            [
                section(0.3, 0.1, 0, 1, -0.5, 0),
                section(0.5, -0.5, 0, 1, -0.3, 0),
                section(0.8, -0.8, 0, 1, 0.1, 0),
            ]
        ),
        W=section(0.6, 0.2, 0, 1, -0.4, 0)[None],
        gain=np.ones(1),
        certificate=[{"ok": True, "min_ratio": 1.0, "max_ratio": 1.5}],
        directions=fan(2),
        sigma=random.uniform(0.5, 2.0, (3, 2)),
        start=random.uniform(0.1, 1.0, (3, 2)),
        joint=np.ones(3),
    )


@pytest.fixture
def drive() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Error, nominal output and speed: in range from sample 5 to 29, at the limits too, and from 34 on."""
    random = np.random.default_rng(2)
    v = np.full(N, 10.0)
    v[:5], v[30:34] = 1.99, 20.01
    v[5], v[29] = 2.0, 20.0
    return random.standard_normal((N, 2)), random.standard_normal((N, 2)), v


def forgotten(x: np.ndarray, memory: float) -> np.ndarray:
    """sum_{t <= T} rho^(2 (T - t)) x(t) x(t)' (n, 2, 2)."""
    kept, out, total = math.exp(-2 * TS / memory), [], np.zeros((2, 2))
    for row in x:
        total = kept * total + np.outer(row, row)
        out.append(total)
    return np.array(out)


def by_definition(test: EnergyTest, e, yhat, v):
    """(first judged sample, band, left, right) of every stretch."""
    memories = [MEMORY, MEMORY, MEMORY * BAND_HZ[0] / BAND_HZ[-1]]
    for first, end in ((5, 30), (34, N)):
        for band in range(3):
            explained = sosfilt(test.W[0], yhat[first:end], axis=0)
            left, right = (sosfilt(test.F[band], x, axis=0) for x in (e[first:end], explained))
            yield (
                first + SETTLE,
                band,
                forgotten(left[SETTLE:], memories[band]),
                forgotten(right, MEMORY)[SETTLE:],
            )


def right_side(test: EnergyTest, right, band: int, t: int, a: np.ndarray) -> float:
    """Right side of (T19b) without sigma, ``t`` samples after the first judged one, in direction ``a``."""
    fading = math.exp(-(SETTLE + t + 1) * TS / MEMORY)
    return math.sqrt(a @ right[t] @ a) + fading * sum(abs(a) * test.start[band])


def test_both_sides_are_the_sums_of_the_inequality(test, drive):
    norms, wanted = list(test.norms(*drive)), list(by_definition(test, *drive))
    assert [(f, b) for f, b, _, _ in norms] == [(f, b) for f, b, _, _ in wanted]
    for (_, _, left, right), (_, _, one, two) in zip(norms, wanted, strict=True):
        np.testing.assert_allclose(left, one, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(right, two, rtol=1e-10, atol=1e-12)


def test_a_stretch_is_judged_when_it_is_longer_than_it_takes_to_settle(test, drive):
    e, yhat, _ = drive
    v = np.full(N, 1.0)
    v[10 : 10 + SETTLE] = 5.0
    assert list(test.norms(e, yhat, v)) == []
    v[10 : 11 + SETTLE] = 5.0
    norms = list(test.norms(e, yhat, v))
    assert [(first, band, len(left), len(right)) for first, band, left, right in norms] == [
        (14, b, 1, 1) for b in range(3)
    ]


def test_ratios_are_of_the_roots_in_every_direction(test, drive):
    for (first, band, ratios), (f, b, left, right) in zip(
        test.ratios(*drive), by_definition(test, *drive), strict=True
    ):
        assert (first, band) == (f, b) and ratios.shape == (len(left), 16)
        for d, direction in enumerate(test.directions):
            a = direction / test.sigma[band]
            for t in (0, 7, len(left) - 1):
                wanted = math.sqrt(a @ left[t] @ a) / (right_side(test, right, band, t, a) + 1)
                assert ratios[t, d] == pytest.approx(wanted, rel=1e-9)


def test_needs_are_the_largest_over_all_stretches(test, drive):
    needs = test.needs(*drive)
    sides = list(by_definition(test, *drive))
    for band in range(3):
        samples = [(s[2][t], s[3], t) for s in sides if s[1] == band for t in range(len(s[2]))]
        error = np.array([[math.sqrt(left[i, i]) for i in (0, 1)] for left, _, _ in samples])
        bound = np.array([[right_side(test, r, band, t, a) for a in np.eye(2)] for _, r, t in samples])
        np.testing.assert_allclose(needs["error"][band], error.max(axis=0), rtol=1e-9)
        np.testing.assert_allclose(needs["bound"][band], bound.max(axis=0), rtol=1e-9)
        np.testing.assert_allclose(needs["sigma"][band], (error - bound).max(axis=0), rtol=1e-9)
        a = test.directions / test.sigma[band]
        joint = [
            [math.sqrt(d @ left @ d) - right_side(test, r, band, t, d) for d in a] for left, r, t in samples
        ]
        assert needs["joint"][band] == pytest.approx(np.max(joint), rel=1e-9)
    still = test.needs(drive[0], drive[1], np.zeros(N))
    assert all(np.isnan(value).all() for value in still.values())


def test_sigma_is_what_is_needed_and_no_less_than_its_floor(test):
    needs = {
        "sigma": np.array([[0.5, -1.0], [1e-5, 0.3], [2.0, 0.02]]),
        "error": np.array([[1.0, 0.5], [3.0, 1.0], [1.0, 1.0]]),
        "bound": np.array([[2.0, 0.25], [1.0, 2.0], [0.5, 3.0]]),
        "memory": np.array([[0.7, 0.8], [0.9, 1.0], [1.1, 1.2]]),
    }
    sized = test.with_sigma(needs)
    size = [[2.0, 0.5], [3.0, 2.0], [1.0, 3.0]]
    wanted = [
        [0.5, SMALLEST_SIGMA * 0.5],
        [SMALLEST_SIGMA * 3.0, 0.3],
        [2.0, max(0.02, SMALLEST_SIGMA * 3.0)],
    ]
    np.testing.assert_allclose(sized.sigma, wanted)
    assert (sized.sigma >= SMALLEST_SIGMA * np.array(size)).all()
    floor = np.array([[1.5, 0.0], [0.001, 0.6], [2.0, 0.01]])  # what the sensors cannot tell
    np.testing.assert_allclose(test.with_sigma(needs, floor).sigma, np.maximum(wanted, floor))
    np.testing.assert_allclose(test.with_sigma(needs, 0.4).sigma, np.maximum(wanted, 0.4))
    np.testing.assert_allclose(sized.start, needs["memory"])
    for key, value in (("error", 0.0), ("error", np.nan)):
        spoiled = {k: v.copy() for k, v in needs.items()}
        spoiled[key][1, 1] = value
        spoiled["bound"][1, 1] = value
        with pytest.raises(InputError, match="it judges no excited drive among those that set the bounds"):
            test.with_sigma(spoiled)
    joint = sized.with_joint({"joint": np.array([0.4, 1.0, 2.5])})
    assert joint.joint.tolist() == [1.0, 1.0, 2.5]
    np.testing.assert_allclose(joint.sigma, sized.sigma * [[1.0], [1.0], [2.5]])


def test_the_core_gets_the_numbers_of_the_definition(test):
    sizes, words, reals = test.coefficients()
    assert sizes == {"NWEIGHT": 1, "NDIRECTIONS": 16, "NBANDS": 3}
    assert words == {"energy_settle": SETTLE, "energy_rearm": 30}
    # A low-pass 1 / (1 + s / w) in the bilinear transform answers a step with t / (1 + t) at once.
    tangent = [math.tan(math.pi * f * TS) for f in BAND_HZ]
    np.testing.assert_allclose(reals["energy_corner"], [t / (1 + t) for t in tangent])
    memories = [MEMORY, MEMORY, MEMORY * 0.25]
    np.testing.assert_allclose(test.memories_s, memories)
    np.testing.assert_allclose(reals["energy_forget"], [1 - math.exp(-2 * TS / m) for m in memories])
    np.testing.assert_allclose(reals["energy_scale"] * test.sigma, 1.0)
    assert reals["energy_threshold"] == pytest.approx((1.0 + ROUNDING) ** 2)
    np.testing.assert_array_equal(reals["energy_start"], test.start)
    assert test.at_rest().start.tolist() == np.zeros((3, 2)).tolist()
    assert test.rho == pytest.approx(math.exp(-TS / MEMORY)) and test.bands == energy.band_names(3)
    assert replace(test, memory_s=3.01).rearm == 31


def test_a_stored_test_comes_back_and_another_one_is_refused(test):
    scores = {f"d{k}": 1.0 + k / 10 for k in range(12)}
    one = test.calibrated(scores, 0.2, energy.Calibration(1.0, {}, None, None).recordings)
    assert one.calibration.threshold == 1.0 + 1.0 and one.calibration.alpha == 0.2
    low = {d: s / 100 for d, s in scores.items()}
    assert test.calibrated(low, 0.2, one.calibration.recordings).calibration.threshold == 1.0 + ROUNDING
    data = json.loads(json.dumps(one.to_dict(), default=np.ndarray.tolist))
    blank = replace(test, sigma=0 * test.sigma, start=0 * test.start, joint=0 * test.joint)
    assert "band_hz" not in data
    older = {k: v for k, v in data.items() if k != "band_radps"} | {"band_hz": list(test.band_hz)}
    assert blank.restored(older, "here").calibration == one.calibration
    again = blank.restored(data, "here")
    for name in ("sigma", "start", "joint"):
        np.testing.assert_array_equal(getattr(again, name), getattr(one, name))
    assert again.calibration == one.calibration
    for name, value in (
        ("memory_s", 3.1),
        ("band_radps", [0.5, 2.1]),
        ("settle_samples", 5),
        ("bands", ["a"]),
    ):
        with pytest.raises(InputError, match="here"):
            blank.restored(data | {name: value}, "here")


@pytest.mark.parametrize(
    ("planted", "name"),
    [
        (lambda d: {"sigma": [[0.0, *row[1:]] for row in d["sigma"]]}, "sigma"),
        (lambda d: {"sigma": d["sigma"][1:]}, "sigma"),
        (lambda d: {"start": [[-1e-9, *row[1:]] for row in d["start"]]}, "start"),
        (lambda d: {"joint": [0.999, 1.0, 1.0]}, "joint"),
        (lambda d: {"joint": [float("nan"), 1.0, 1.0]}, "joint"),
        (lambda d: {"gain": [1.0 + 1e-7]}, "gain"),
        (lambda d: {"above": [0.7]}, "above"),
        (lambda d: {"certificate": [d["certificate"][0] | {"ok": False}]}, "certificate"),
        (lambda d: {"certificate": [d["certificate"][0] | {"min_ratio": 1.001}]}, "certificate"),
        (lambda d: {"certificate": [d["certificate"][0] | {"max_ratio": 1.499}]}, "certificate"),
    ],
)
def test_a_stored_number_that_is_none_or_not_the_weights_is_refused(test, planted, name):
    data = json.loads(json.dumps(test.to_dict(), default=np.ndarray.tolist))
    test.restored(data, "here")
    with pytest.raises(InputError, match=f"here: {name}"):
        test.restored(data | planted(data), "here")


@pytest.mark.parametrize("n_y", [1, 2, 3])
def test_directions_are_of_unit_sum_each_once_and_hold_every_output_alone(n_y):
    directions = fan(n_y)
    assert len(directions) == {1: 1, 2: 16, 3: 13}[n_y]
    np.testing.assert_allclose(np.abs(directions).sum(axis=1), 1.0)
    for i in range(len(directions)):
        for k in range(i):
            for sign in (-1, 1):
                assert np.abs(directions[i] - sign * directions[k]).max() > 0.05
    for unit in np.eye(n_y):
        assert any(np.array_equal(d, unit) for d in directions)
    assert all(d[np.flatnonzero(d)[0]] > 0 for d in directions) or n_y == 2


def test_three_outputs_are_seen_in_every_choice_of_signs():
    seen = {tuple(np.sign(d).astype(int)) for d in fan(3)}
    assert seen == {s for s in itertools.product((-1, 0, 1), repeat=3) if any(s) and s > (0, 0, 0)}
    for d in fan(3):
        sizes = np.abs(d[d != 0])
        np.testing.assert_allclose(sizes, 1 / len(sizes))


def test_two_outputs_are_seen_from_sixteen_even_angles_in_bit_reversed_order():
    directions = fan(2)
    turns = [int(f"{k:04b}"[::-1], 2) / 16 for k in range(16)]
    for d, turn in zip(directions, turns, strict=True):
        x = np.array([math.cos(math.pi * turn), math.sin(math.pi * turn)])
        np.testing.assert_allclose(d, x / np.abs(x).sum(), atol=1e-15)
    assert directions[1].tolist() == [0.0, 1.0]


def test_the_design_takes_corners_memory_and_settling_from_the_settings(g80, g80_model):
    estimator = Estimator.from_project(g80, g80_model)
    low_hz, high_hz = g80.frames.f_min_hz, g80.frames.f_max_hz
    plain = g80.model_copy(
        update={"energy_test": g80.energy_test.model_copy(update={"band_hz": None, "memory_s": None})}
    )
    W = Weight([1.0, 2.0], [1.0, 8.0])  # rises from 0.25 to 1
    test = EnergyTest.design(plain, estimator, [W], [1.0, 2.0], [[0.2], [0.2]], 1.5)
    assert test.band_hz == (low_hz, high_hz) and test.memory_s == 1 / low_hz
    low_rad = 2 / g80.Ts_s * math.tan(math.pi * low_hz * g80.Ts_s)
    assert test.settle == max(estimator.settle, math.ceil(5 / low_rad / g80.Ts_s))
    slow = replace(estimator, settle=10_000)
    assert EnergyTest.design(plain, slow, [W], [1.0, 2.0], [[0.2], [0.2]], 1.5).settle == 10_000
    assert test.speed_range == estimator.speed_range and test.gain.tolist() == [1.0]
    assert (
        test.sigma.tolist() == [[1.0]] * 3
        and test.start.tolist() == [[0.0]] * 3
        and test.joint.tolist() == [1.0] * 3
    )
    set_ = g80.model_copy(
        update={
            "energy_test": g80.energy_test.model_copy(update={"band_hz": (0.2, 0.9, 3.0), "memory_s": 4.0})
        }
    )
    other = EnergyTest.design(set_, estimator, [W], [1.0, 2.0], [[0.2], [0.2]], 1.0)
    assert other.band_hz == (0.2, 0.9, 3.0) and other.memory_s == 4.0 and len(other.F) == 4
    np.testing.assert_allclose(other.memories_s, [4.0, 4.0, 4.0, 4.0 * 0.2 / 3.0])


def test_a_memory_must_outlast_the_slowest_filter(g80, g80_model):
    estimator = Estimator.from_project(g80, g80_model)
    low_rad = 2 / g80.Ts_s * math.tan(math.pi * 0.2 * g80.Ts_s)
    for factor, fits in ((1.01, True), (0.99, False)):
        settings = g80.energy_test.model_copy(update={"band_hz": (0.2, 3.0), "memory_s": factor / low_rad})
        project = g80.model_copy(update={"energy_test": settings})
        if fits:
            EnergyTest.design(project, estimator, [Weight([1.0], [1.0])], [1.0], [[0.2]], 1.0)
        else:
            with pytest.raises(InputError, match="must forget faster than the sums"):
                EnergyTest.design(project, estimator, [Weight([1.0], [1.0])], [1.0], [[0.2]], 1.0)


def test_a_silent_band_has_a_million_times_its_sigma_in_the_core_alone(test):
    silent = replace(test, silent=(1,))
    scale = silent.coefficients()[2]["energy_scale"]
    np.testing.assert_allclose(1 / scale[[0, 2]], test.sigma[[0, 2]], rtol=1e-14)
    np.testing.assert_allclose(1 / scale[1], 1e6 * test.sigma[1], rtol=1e-8)
    assert silent.sigma.tolist() == test.sigma.tolist()


def test_a_memory_that_just_equals_the_slowest_filters_is_refused(g80, g80_model):
    estimator = Estimator.from_project(g80, g80_model)
    # The corner of which one over its warped frequency, times that, is 1 in all digits.
    refused = 0
    for low_hz in np.linspace(0.2, 0.3, 20):
        low_rad = 2 / g80.Ts_s * np.tan(np.pi * low_hz * g80.Ts_s)
        memory = 1.0 / low_rad
        if memory * low_rad != 1.0:
            continue
        refused += 1
        settings = g80.energy_test.model_copy(update={"band_hz": (low_hz, 3.0), "memory_s": memory})
        project = g80.model_copy(update={"energy_test": settings})
        with pytest.raises(InputError, match="must forget faster than the sums"):
            EnergyTest.design(project, estimator, [Weight([1.0], [1.0])], [1.0], [[0.2]], 1.0)
    assert refused > 5


def test_a_weight_below_its_bound_is_raised_to_what_the_certificate_proves(g80, g80_model):
    estimator = Estimator.from_project(g80, g80_model)
    for level in np.geomspace(0.11, 0.97, 12):
        W = Weight([level, 2.0 * level], [1.0, 3.0])
        test = EnergyTest.design(g80, estimator, [W], [1.0, 2.0], [[0.9], [0.9]], 1.0)
        least = level * 2.0 / 3.0  # of |W|, at rest
        assert test.gain[0] == pytest.approx(max(1.0, 0.9 / least), rel=3e-9)
        assert test.certificate[0]["ok"] and test.certificate[0]["min_ratio"] >= 1.0


def test_a_factor_common_to_numerator_and_denominator_changes_no_filter(g80, g80_model):
    estimator = Estimator.from_project(g80, g80_model)
    one, two = (
        EnergyTest.design(g80, estimator, [W], [1.0, 2.0], [[0.2], [0.2]], 1.0)
        for W in (Weight([1.0, 2.0], [1.0, 8.0]), Weight([4.0, 8.0], [4.0, 32.0]))
    )
    np.testing.assert_allclose(two.W, one.W, rtol=1e-12)


def test_weights_and_bounds_are_as_many_as_the_structure_has(g80, g80_model):
    estimator, W = Estimator.from_project(g80, g80_model), Weight([1.0], [1.0])
    for weights, bound in (([W, W], [[0.2]]), ([W], [[0.2, 0.2]]), ([W, W], [[0.2, 0.2]])):
        with pytest.raises(InputError, match="1 of each for structure"):
            EnergyTest.design(g80, estimator, weights, [1.0], bound, 1.0)
    with pytest.raises(InputError, match=r"W_delta, warped.*expected a weight that stays above its bound"):
        EnergyTest.design(g80, estimator, [Weight([1.0, -1.0], [1.0, 1.0])], [1.0], [[0.2]], 1.0)


def test_shorter_filters_are_padded_with_what_passes_all():
    one, two = np.ones((1, 6)), 2 * np.ones((2, 6))
    padded = energy._padded([one, two])
    assert padded.shape == (2, 2, 6)
    assert (
        padded[0].tolist() == [[1.0] * 6, [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]]
        and padded[1].tolist() == two.tolist()
    )


def test_words_say_sigma_by_output_and_band(test):
    outputs = [SimpleNamespace(name="yaw", unit="rad/s"), SimpleNamespace(name="ay", unit="m/s2")]
    text = replace(test, sigma=np.array([[1.0, 4.0], [2.0, 5.0], [3.0, 6.0]])).sigma_text(
        SimpleNamespace(outputs=outputs)
    )
    bands = ", ".join(test.bands)
    assert text == f"yaw 1, 2, 3 rad/s ({bands} the corners); ay 4, 5, 6 m/s2 ({bands} the corners)"
