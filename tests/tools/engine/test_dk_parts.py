"""The pieces of the D-K iteration: scalings by their formula, fits by power means and differences, searches
by scripted levels, and reduction by what a truncation keeps."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg as sl

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis import dk
from lpvguard.engine.synthesis.dk import Scaling
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant
from lpvguard.engine.synthesis.norms import NormBracket, hinf_norm
from lpvguard.engine.synthesis.statespace import StateSpace, gain, lft, to_discrete

ONE = Block("full", 1, 1)
BLOCKS = (Block("full", 2, 1), Block("full", 1, 3))


def plant(seed: int = 0, blocks=BLOCKS, dt: float = 0.0) -> GeneralisedPlant:
    """A random stable plant of order 2 with w of 3, z of 1, two controls and one measurement."""
    random = np.random.default_rng(seed)
    n_in, n_out = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    A = np.array([[-1.0, 0.4], [-0.3, -2.0]])
    D = 0.3 * random.standard_normal((n_out + 2, n_in + 5))
    D[-1, -2:] = 0.0
    B, C = random.standard_normal((2, n_in + 5)), random.standard_normal((n_out + 2, 2))
    G = StateSpace(A, B, C, D)
    return GeneralisedPlant(to_discrete(G, dt) if dt else G, tuple(blocks), n_in, n_out, 2, 1)


def magnitude(row, omega):
    """|d| as its product of corners."""
    z, p = np.exp(row[1::2]), np.exp(row[2::2])
    return np.exp(row[0]) * np.prod(np.abs(1j * omega / z + 1) / np.abs(1j * omega / p + 1))


PARAMETERS = np.array([[0.3, -0.5, 0.2, 1.0, -1.3], [-0.7, 0.1, 2.0, -2.0, 0.4]])

# ---------------------------------------------------------------- the scaling


def test_a_scaling_is_its_product_of_corners_on_every_channel_of_its_block():
    scaling, omega = Scaling(PARAMETERS), np.array([0.0, 0.6, 30.0])
    left, right = (D.response(omega) for D in scaling.systems(plant()))
    d = np.exp(scaling.log_magnitude(omega))
    for k, w in enumerate(omega):
        one, two = (magnitude(row, w) for row in PARAMETERS)
        np.testing.assert_allclose(d[:, k], [one, two], rtol=1e-12)
        np.testing.assert_allclose(np.abs(left[k]), np.diag([one, two, two, two, 1.0]), rtol=1e-12)
        np.testing.assert_allclose(
            np.abs(right[k]), np.diag([1 / one, 1 / one, 1 / two, 1.0, 1.0, 1.0]), rtol=1e-12
        )
        assert left[k, 0, 0] * right[k, 0, 0] == pytest.approx(1.0)
    with pytest.raises(ValueError):
        Scaling(PARAMETERS[:1]).systems(plant())


def test_a_constant_scaling_has_no_corner_and_without_blocks_none_is_left():
    scaling = Scaling(np.array([[0.4], [-0.2]]))
    np.testing.assert_allclose(scaling.log_magnitude([0.0, 5.0]), [[0.4, 0.4], [-0.2, -0.2]])
    np.testing.assert_array_equal(scaling.log_gradient([0.0, 5.0]), np.ones((2, 1, 2)))
    left, right = Scaling(np.zeros((0, 1))).systems(plant(blocks=()))
    assert (left.D.tolist(), right.D.tolist()) == ([[1.0]], np.eye(3).tolist())


# ---------------------------------------------------------------- the work at one plant


def test_the_grid_has_dc_eight_decades_and_infinity_and_every_block_its_rows_and_columns():
    work = dk._Work(plant())
    assert work.omega[0] == 0.0 and work.omega[-1] == 1e12 and len(work.omega) == 66
    np.testing.assert_allclose(work.omega[[1, 64]], [1e-4, 1e4])
    np.testing.assert_allclose(np.diff(np.log(work.omega[1:-1])), np.log(1e8) / 63)
    assert work.rows == [slice(0, 1), slice(1, 4), slice(4, 5)]
    assert work.cols == [slice(0, 2), slice(2, 3), slice(3, 6)]
    assert (dk.SLOWEST, dk.FASTEST) == (1e-4, 1e4)


def test_a_frequency_of_the_image_is_one_of_the_sampled_plant():
    one = plant(dt=0.2)
    work = dk._Work(one)
    np.testing.assert_allclose(
        work.system.response([7.0])[0], one.system.response([work.unwarp(7.0)])[0], rtol=1e-9
    )
    assert dk._Work(plant()).unwarp(7.0) == 7.0


def test_a_scaled_plant_keeps_its_control_and_a_scaled_loop_has_none():
    one, scaling, omega = plant(), Scaling(PARAMETERS), np.array([0.3, 4.0])
    work = dk._Work(one)
    left, right = (D.response(omega) for D in scaling.systems(one))
    G = one.system.response(omega)
    response = work.scaled(one.system, scaling).response(omega)
    np.testing.assert_allclose(response[:, :5, :6], left @ G[:, :5, :6] @ right, rtol=1e-9)
    np.testing.assert_allclose(response[:, :5, 6:], left @ G[:, :5, 6:], rtol=1e-9)
    np.testing.assert_allclose(response[:, 5:, :6], G[:, 5:, :6] @ right, rtol=1e-9)
    np.testing.assert_allclose(response[:, 5:, 6:], G[:, 5:, 6:], rtol=1e-9, atol=1e-12)
    loop = one.system.select(slice(0, 5), slice(0, 6))
    np.testing.assert_allclose(
        work.scaled(loop, scaling).response(omega), left @ G[:, :5, :6] @ right, rtol=1e-9
    )


def test_synthesis_and_norm_are_asked_about_the_scaled_plant(monkeypatch):
    one, scaling = plant(dt=0.1), Scaling(PARAMETERS)
    work, asked = dk._Work(one), []

    def said(*args, **options):
        asked.append((args, options))
        return "said"

    for name in ("hinf_synthesis", "improved_level", "hinf_norm"):
        monkeypatch.setattr(dk, name, said)
    assert work.controller(scaling, backoff=0.1) == "said"
    assert work.improved(3.0, scaling) == "said"
    assert work.scaled_norm(work.system.select(slice(0, 5), slice(0, 6)), scaling) == "said"
    wanted = work.scaled(work.system, scaling)
    assert [(len(args) - 1, options) for args, options in asked] == [
        (2, {"backoff": 0.1}),
        (3, {"rtol": 2e-5}),
        (0, {"rtol": 1e-5}),
    ]
    assert asked[0][0][1:] == (2, 1) and asked[1][0][1:] == (2, 1, 3.0)
    for args, _ in asked:
        G = args[0].response([0.7])[0]
        np.testing.assert_allclose(G, wanted.response([0.7])[0, : len(G), : G.shape[1]], rtol=1e-9)


# ---------------------------------------------------------------- the fit of a scaling


@pytest.fixture
def posed(monkeypatch) -> dict:
    """Calls of `fit` to the minimiser, which returns parameters beyond the fastest and the slowest."""
    asked = {}

    def minimize(objective, x0, **options):
        asked.update(objective=objective, x0=x0, options=options)
        return SimpleNamespace(x=np.linspace(-20.0, 20.0, len(x0)))

    monkeypatch.setattr(dk, "minimize", minimize)
    return asked


@pytest.mark.parametrize("power", [3.0, 10.0])
def test_a_fit_minimises_the_power_mean_of_the_scaled_gains(posed, power):
    one = plant()
    work, loop = dk._Work(one), one.system.select(slice(0, 5), slice(0, 6))
    scaling = work.fit(loop, Scaling(PARAMETERS), power)
    assert posed["options"] == {"jac": True, "method": "BFGS", "options": {"maxiter": 40, "gtol": 1e-6}}
    np.testing.assert_array_equal(posed["x0"], PARAMETERS.ravel())
    np.testing.assert_allclose(
        scaling.log_parameters, np.clip(np.linspace(-20.0, 20.0, 10), *np.log([1e-4, 1e4])).reshape(2, 5)
    )
    value, slope = posed["objective"](posed["x0"])
    M = loop.response(work.omega)
    gains = []
    for w, m in zip(work.omega, M, strict=True):
        one, two = (magnitude(row, w) for row in PARAMETERS)
        gains.append(np.linalg.norm(np.diag([one, two, two, two, 1]) @ m / [one, one, two, 1, 1, 1], 2))
    assert value == pytest.approx(np.log(np.mean(np.array(gains) ** power)) / power, rel=1e-10)
    for k, h in enumerate(1e-5 * np.eye(10)):
        ahead, behind = (posed["objective"](posed["x0"] + s * h)[0] for s in (1, -1))
        assert slope[k] == pytest.approx((ahead - behind) / 2e-5, rel=1e-5, abs=1e-8)
    far = np.where(np.arange(10) == 4, 50.0, posed["x0"])  # as at the fastest pole
    near = np.where(np.arange(10) == 4, np.log(1e4), posed["x0"])
    assert posed["objective"](far)[0] == posed["objective"](near)[0]


def test_a_fit_starts_beside_the_point_where_zeros_and_poles_meet(posed):
    """Equal corners are stationary, and equal pairs would stay equal. Different corners and a constant are
    the start."""
    one = plant()
    work, loop = dk._Work(one), one.system.select(slice(0, 5), slice(0, 6))
    work.fit(loop, Scaling(np.tile([0.5, -2.0, -2.0], (2, 1))), 10.0)
    third = np.log(3.0)
    np.testing.assert_allclose(posed["x0"], np.tile([0.5, -2.0 + third, -2.0 - third], 2))
    work.fit(loop, Scaling(np.tile([0.5, -2.0, -2.0, -2.0, -2.0], (2, 1))), 10.0)
    pairs = [-2.0 + centre + side for centre in (-np.log(10) / 2, np.log(10) / 2) for side in (third, -third)]
    np.testing.assert_allclose(posed["x0"], np.tile([0.5, *pairs], 2))
    for corners in ([0.5, -1.0, -2.0], [0.5, -2.0, -1.0]):
        work.fit(loop, Scaling(np.tile(corners, (2, 1))), 10.0)
        np.testing.assert_allclose(posed["x0"], np.tile(corners, 2))
    work.fit(loop, Scaling(np.array([[0.5], [0.2]])), 10.0)
    np.testing.assert_allclose(posed["x0"], [0.5, 0.2])


def test_a_fit_leaves_a_loop_without_gain_finite(posed):
    one = plant()
    dk._Work(one).fit(gain(np.zeros((5, 6))), Scaling(PARAMETERS), 10.0)
    value, slope = posed["objective"](posed["x0"])
    assert value == pytest.approx(np.log(1e-150)) and np.isfinite(slope).all()


def test_a_fit_finds_the_scaling_of_a_constant_loop():
    """Of [a b; c d] with one scalar Delta the best d is sqrt(|c / b|)."""
    one = GeneralisedPlant(gain(np.zeros((3, 3))), (ONE,), 1, 1, 1, 1)
    scaling = dk._Work(one).fit(gain(np.array([[0.5, 8.0], [0.02, 0.3]])), Scaling(np.zeros((1, 1))), 10.0)
    assert np.exp(scaling.log_parameters[0, 0]) == pytest.approx(np.sqrt(0.02 / 8.0), rel=1e-4)


# ---------------------------------------------------------------- certificates


def test_the_lower_bound_is_the_best_at_the_peak_and_the_two_highest_lines(monkeypatch):
    one, scaling = plant(), Scaling(PARAMETERS)
    work, loop = dk._Work(one), one.system.select(slice(0, 5), slice(0, 6))
    asked = []

    def mu_lower(M, blocks, left, right, enough):
        asked.append((M, blocks, left, right, enough))
        return [0.4, 0.7, 0.6][len(asked) - 1], len(asked)

    monkeypatch.setattr(dk, "mu_lower", mu_lower)
    value, omega, delta = work.lower(loop, scaling, 0.123)
    left, right = scaling.systems(one)
    gains = np.linalg.norm(
        left.response(work.omega) @ loop.response(work.omega) @ right.response(work.omega), 2, axis=(1, 2)
    )
    points = sorted([0.123, *work.omega[np.argsort(gains)[-2:]]])
    assert (value, omega, delta) == (0.7, points[1], 2) and len(asked) == 3
    for w, (M, blocks, L, R, enough) in zip(points, asked, strict=True):
        np.testing.assert_allclose(M, loop.response([w])[0])
        assert blocks == (*BLOCKS, Block("full", 3, 1))
        one, two = (magnitude(row, w) for row in PARAMETERS)
        np.testing.assert_allclose(L, np.diag([one, two, two, two, 1.0]), rtol=1e-9)
        np.testing.assert_allclose(R, np.diag([one, one, two, 1.0, 1.0, 1.0]), rtol=1e-9)
        assert enough == pytest.approx(gains.max() * (1 - 1e-6), rel=1e-10) and enough < gains.max()


def closed(dt: float = 0.0) -> tuple[GeneralisedPlant, StateSpace]:
    """A plant of a constant loop with one scalar Delta, mu = 2 (sum of the products of a matrix of rank 1)
    below a pole at 3 rad/s; and a controller that does nothing."""
    C = np.array([[1.0], [4.0], [0.0]])
    G = StateSpace([[-3.0]], [[3 * 1.2, 3 * 0.2, 0.0]], C, np.zeros((3, 3)))
    one = GeneralisedPlant(to_discrete(G, dt) if dt else G, (ONE,), 1, 1, 1, 1)
    return one, gain([[0.0]], dt)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_a_certificate_has_the_gain_of_the_better_scaling_and_mu_below_it(dt):
    one, K = closed(dt)
    performance = dk.certify(one, K)
    assert performance.upper == performance.bracket.upper == pytest.approx(2.0, rel=1e-3)
    assert performance.upper >= 2.0 * (1 - 1e-9) and performance.bracket.lower <= performance.upper
    assert performance.lower == pytest.approx(2.0, rel=1e-6)
    assert performance.lower_frequency < 0.1 and performance.delta.shape == (2, 2)
    performance = dk.certify(one, K, Scaling(np.array([[np.log(np.sqrt(4 * 0.2 / 1.2) * 1e-3)]])))
    assert performance.upper == pytest.approx(2.0, rel=1e-4), "fitted anew"
    assert performance.scaling.log_parameters.shape == (1, 1)


def test_of_two_scalings_the_lower_level_counts_with_its_own_frequencies(monkeypatch):
    one, K = closed(0.1)
    start, other = Scaling(np.array([[0.1]])), Scaling(np.array([[0.2]]))
    levels = {0.1: NormBracket(3.0, 3.1, 5.0), 0.2: NormBracket(2.0, 2.1, 7.0)}
    powers, asked = [], []

    def fit(self, loop, scaling, power):
        powers.append((scaling, power))
        return other

    def lower(self, loop, scaling, peak):
        asked.append((scaling, peak))
        return 1.5, 9.0, "delta"

    monkeypatch.setattr(dk._Work, "fit", fit)
    monkeypatch.setattr(dk._Work, "lower", lower)
    monkeypatch.setattr(
        dk._Work, "scaled_norm", lambda self, loop, scaling: levels[scaling.log_parameters[0, 0]]
    )
    work = dk._Work(one)
    for scaling, wanted in ((start, other), (other, other)):
        performance = dk.certify(one, K, scaling)
        assert performance.scaling is wanted and (
            performance.upper,
            performance.lower,
            performance.delta,
        ) == (2.1, 1.5, "delta")
        assert performance.lower_frequency == work.unwarp(9.0)
        assert performance.bracket == NormBracket(2.0, 2.1, work.unwarp(7.0))
    assert powers == [(start, 200), (other, 200)] and asked == [(other, 7.0), (other, 7.0)]
    levels |= {0.1: NormBracket(1.0, 1.1, 5.0), 0.0: NormBracket(9.0, 9.1, 5.0)}
    assert dk.certify(one, K, start).scaling is start
    dk.certify(one, K)
    np.testing.assert_allclose(powers[-1][0].log_parameters, [[0.0, np.log(0.1), np.log(0.1)]])


@pytest.mark.parametrize(("pole", "stable"), [(1.0, False), (0.0, False), (-0.5, True)])
def test_a_loop_that_is_not_stable_has_no_level(pole, stable):
    G = StateSpace([[pole]], [[1.0, 1.0, 0.0]], [[1.0], [1.0], [0.0]], np.zeros((3, 3)))
    one = GeneralisedPlant(G, (ONE,), 1, 1, 1, 1)
    performance = dk.certify(one, gain([[0.0]]))
    assert np.isfinite(performance.upper) == stable
    if not stable:
        assert performance.upper == performance.lower == np.inf and np.isnan(performance.lower_frequency)
        assert performance.bracket.lower == performance.bracket.upper == np.inf and performance.delta is None
        assert performance.scaling.log_parameters.shape == (1, 3)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_without_blocks_the_level_is_the_norm_of_the_loop(dt):
    one = plant(blocks=(), dt=dt)
    performance = dk.certify(one, gain(np.zeros((2, 1)), dt))
    wanted = hinf_norm(one.system.select(slice(0, 1), slice(0, 3)))
    assert performance.bracket == wanted and (performance.upper, performance.lower) == (
        wanted.upper,
        wanted.lower,
    )
    assert performance.lower_frequency == wanted.peak_frequency and performance.delta is None
    assert performance.scaling.log_parameters.shape == (0, 1)


# ---------------------------------------------------------------- the iteration


class Scripted:
    """Replaces `_Work`: scripted levels of K steps, and a record of the calls."""

    def __init__(self, levels):
        self.levels, self.asked, self.scalings, self.fits = iter(levels), [], [], []
        self.system = gain(np.zeros((3, 3)))
        self.controllers = iter(gain([[float(k)]]) for k in range(1, 99))

    def __call__(self, one):
        self.plant = one
        return self

    def controller(self, scaling, **options):
        self.asked.append((float(scaling.log_parameters.sum()), options))
        self.scalings.append(scaling)
        return SimpleNamespace(gamma=next(self.levels), gamma_achieved=2.0, controller=next(self.controllers))

    def fit(self, loop, scaling, power):
        self.fits.append((loop.n_inputs, power))
        return Scaling(np.full(scaling.log_parameters.shape, float(len(self.fits))))


@pytest.fixture
def scripted(monkeypatch):
    """Run dk_synthesis with scripted levels. Returns its calls and its result."""

    def run(levels, blocks=(ONE,), dt=0.0, **options):
        work, seen = Scripted(levels), {}
        one = GeneralisedPlant(gain(np.zeros((3, 3)), dt), tuple(blocks), len(blocks), len(blocks), 1, 1)

        def polish(work, scaling, level, budget, workers):
            seen["polish"] = float(scaling.log_parameters.sum()), level, budget, workers
            return 0.9, Scaling(np.full(scaling.log_parameters.shape, 100.0))

        def reduce(work, K, scaling, level):
            seen["reduce"] = float(K.D[0, 0]), float(scaling.log_parameters.sum()), level
            return StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])

        def certify(one, K, scaling):
            seen["certify"] = one, K, float(scaling.log_parameters.sum())
            return "certified"

        for name, fake in (
            ("_Work", work),
            ("_polish", polish),
            ("reduce_controller", reduce),
            ("certify", certify),
        ):
            monkeypatch.setattr(dk, name, fake)
        return dk.dk_synthesis(one, **options), work, seen

    return run


def test_k_and_d_steps_take_turns_and_the_best_scaling_is_polished(scripted):
    result, work, seen = scripted([5.0, 4.0, 3.0, 3.5, 1.0])
    k_step = {"rtol": 2e-5}
    assert work.asked == [
        (0.0, k_step | {"guess": None}),
        (3.0, k_step | {"guess": 5.0}),
        (6.0, k_step | {"guess": 4.0}),
        (9.0, k_step | {"guess": 3.0}),
        (300.0, {"backoff": 3e-4, "guess": 0.9}),
    ]
    assert work.fits == [(2, 10)] * 3
    assert seen["polish"] == (6.0, 3.0, 40, map)
    assert seen["reduce"] == (5.0, 300.0, pytest.approx(2.0 * (1 + 3e-5), rel=1e-12))
    assert seen["certify"][2] == 300.0 and seen["certify"][1].order == 1
    assert result.history == (5.0, 4.0, 3.0, 3.5, 0.9) and result.performance == "certified"
    assert result.full_order == 0 and result.controller is seen["certify"][1]
    assert result.controller.dt == 0.0 and result.controller.A.tolist() == [[-1.0]]


@pytest.mark.parametrize(
    ("levels", "steps"),
    [
        ([5.0, 5.0, 5.0, 9.0], 3),  # the second D step has to count
        ([5.0, 4.0, 4.0 * (1 - 0.9e-4), 9.0], 3),
        ([5.0, 4.0, 4.0 * (1 - 1e-4), 9.0, 1.0], 4),
        ([5.0, 4.0, 4.0 * (1 - 1.1e-4), 3.0, 9.0, 1.0], 5),
        ([5.0, 6.0, 5.5, 5.0, 4.0, 4.0, 9.0], 6),
    ],
)
def test_steps_end_where_one_gains_nothing_but_not_before_the_third(scripted, levels, steps):
    _, work, seen = scripted(levels, iterations=9)
    assert len(work.asked) == steps + 1 and len(work.fits) == steps - 1
    assert seen["polish"][1] == min(levels[:steps])


def test_four_steps_are_taken_unless_another_number_is_asked_for(scripted):
    for options, steps in (({}, 4), ({"iterations": 5}, 5)):
        _, work, _ = scripted(np.arange(9.0, 0.0, -1.0), **options)
        assert len(work.fits) == steps - 1


def test_of_equal_levels_the_first_counts_and_one_step_is_enough(scripted):
    _, work, seen = scripted([5.0, 5.0, 5.0, 9.0], polish=7, workers="workers")
    assert seen["polish"] == (0.0, 5.0, 7, "workers")
    result, work, _ = scripted([5.0, 1.0], iterations=1, reduction_loss=0.5)
    assert result.history == (5.0, 0.9) and not work.fits


def test_the_scaling_starts_as_it_is_given_or_as_identity_of_its_degree(scripted):
    start = Scaling(np.array([[7.0]]))
    _, work, _ = scripted([5.0, 1.0], iterations=1, start=start)
    assert work.scalings[0] is start
    for options, shape in (({}, (2, 3)), ({"degree": 0}, (2, 1)), ({"degree": 2}, (2, 5))):
        _, work, _ = scripted([5.0, 1.0], iterations=1, blocks=(ONE, ONE), **options)
        np.testing.assert_array_equal(work.scalings[0].log_parameters, np.zeros(shape))


def test_a_sampled_plant_has_a_sampled_controller(scripted):
    result, _, seen = scripted([5.0, 1.0], iterations=1, dt=0.1)
    assert result.controller is seen["certify"][1] and result.controller.dt == 0.1
    np.testing.assert_allclose(result.controller.A, [[0.95 / 1.05]])


def test_without_blocks_one_synthesis_is_all(scripted):
    result, work, seen = scripted([5.0], blocks=())
    assert work.asked == [(0.0, {"backoff": 3e-4, "guess": None})] and result.history == ()
    assert "polish" not in seen and work.scalings[0].log_parameters.shape == (0, 3)


def test_blocks_are_full():
    blocks = (ONE, Block("repeated_complex", 1, 1))
    with pytest.raises(SynthesisError, match="blocks"):
        dk.dk_synthesis(GeneralisedPlant(gain(np.zeros((4, 4))), blocks, 2, 2, 1, 1))


# ---------------------------------------------------------------- the search for parameters


class Measured:
    """Replaces `_Work`: scripted levels, and a record of the trials with the levels that they must beat."""

    def __init__(self, levels):
        self.levels, self.asked = iter(levels), []

    def improved(self, level, scaling):
        self.asked.append((level, scaling.log_parameters))
        return next(self.levels, None)


START = np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]])


def moved(asked, start=START):
    """For every trial, the parameter that it changes, and the change."""
    moves = []
    for _, x in asked:
        [place] = np.argwhere(np.abs(x - start) > 1e-12)
        moves.append((*map(int, place), round(float((x - start)[tuple(place)]), 9)))
    return moves


def test_a_search_that_finds_nothing_goes_both_ways_thrice_with_half_the_step():
    """Gains first, then poles and zeros from the last."""
    work = Measured([])
    level, scaling = dk._polish(work, Scaling(START), 2.0, 999, map)
    moves = [(0, 0), (1, 0), (0, 2), (1, 2), (0, 1), (1, 1)]
    assert moved(work.asked) == [
        (*move, sign * size) for size in (0.08, 0.04, 0.02) for move in moves for sign in (1.0, -1.0)
    ]
    assert level == 2.0 and scaling.log_parameters.tolist() == START.tolist()
    assert {asked for asked, _ in work.asked} == {2.0 * (1 - 1e-5)}


def test_a_step_that_gains_is_kept_and_its_way_is_tried_first_again():
    start = np.array([[0.0], [3.0]])
    # The second move gains downwards, twice; then nothing does.
    work = Measured([None, None, None, 1.5, None, None, 1.4])
    level, scaling = dk._polish(work, Scaling(start), 2.0, 999, map)
    assert level == 1.4
    np.testing.assert_allclose(scaling.log_parameters, [[0.0], [2.84]])
    trials = np.array([x[:, 0] for _, x in work.asked])
    down = 3 - 0.08 * np.arange(4)
    np.testing.assert_allclose(
        trials[:11],
        [
            *([0.08, 3.0], [-0.08, 3.0], [0.0, 3.08], [0.0, down[1]]),
            *([0.08, down[1]], [-0.08, down[1]], [0.0, down[2]]),
            *([0.08, down[2]], [-0.08, down[2]], [0.0, down[3]], [0.0, down[1]]),
        ],
    )
    np.testing.assert_allclose(trials[11:13], [[0.04, down[2]], [-0.04, down[2]]])
    beaten = [asked / (1 - 1e-5) for asked, _ in work.asked[3:8]]
    np.testing.assert_allclose(beaten, [2.0, 1.5, 1.5, 1.5, 1.4], rtol=1e-12)
    assert len(trials) == 7 + 3 * 4


@pytest.mark.parametrize("budget", [0, 1, 2, 3, 5])
def test_a_search_spends_its_budget(budget):
    for levels in ([], [1.9] * budget):
        work = Measured(levels)
        dk._polish(work, Scaling(START), 2.0, budget, map)
        assert len(work.asked) == budget


def test_a_budget_counts_what_was_looked_at_and_no_parameters_are_no_search():
    """Workers begin with both ways; the first one that gains is taken."""
    taken = []

    def workers(function, trials):
        taken.append(len(trials))
        return list(map(function, trials))

    work = Measured([1.9, 1.8] * 2 + [1.7])
    level, _ = dk._polish(work, Scaling(START), 2.0, 3, workers)
    assert (level, taken) == (1.7, [2, 2, 1, 0, 0, 0])
    assert dk._polish(Measured([]), Scaling(np.zeros((0, 3))), 2.0, 9, map)[0] == 2.0
    with pytest.raises(ValueError):
        dk._polish(Measured([]), Scaling(START), 2.0, 9, lambda function, trials: [None])


# ---------------------------------------------------------------- reduction


@pytest.mark.parametrize("rank", range(6))
def test_the_least_order_that_keeps_the_level_is_searched_by_halves(rank, monkeypatch):
    K = gain([[99.0]])
    work = SimpleNamespace(system="system", scaled=lambda system, scaling: (system, scaling))
    for least in range(1, rank + 2):
        asked = []

        def norm(order, rtol, least=least, asked=asked):
            assert rtol == 1e-5
            asked.append(order)
            return SimpleNamespace(upper=2.0 if order >= least else 2.0 + 1e-12)

        monkeypatch.setattr(dk, "_truncations", lambda scaled, one: (int, rank))
        monkeypatch.setattr(dk, "lft", lambda scaled, order: order)
        monkeypatch.setattr(dk, "hinf_norm", norm)
        monkeypatch.setattr(dk, "balanced", lambda order: f"order {order}")
        wanted = K if least > rank else f"order {least}"
        assert dk.reduce_controller(work, K, "scaling", 2.0) == wanted
        assert len(asked) <= np.ceil(np.log2(rank + 1)) and all(1 <= order <= rank for order in asked)


def controlled() -> tuple[StateSpace, StateSpace]:
    """A stable plant of order 2 with w and z of 2, and a controller of order 3, unstable by itself."""
    P = StateSpace(
        [[-1.0, 0.5], [0.0, -2.0]],
        [[1.0, -0.4, 1.0], [0.3, 0.5, 1.0]],
        [[1.0, 0.2], [-0.3, 0.6], [1.0, 0.0]],
        np.zeros((3, 3)),
    )
    K = StateSpace(
        [[0.2, 0.1, 0.0], [0.0, -1.5, 0.4], [0.3, 0.0, -4.0]],
        [[1.0], [0.4], [0.2]],
        [[-3.0, 0.5, 0.3]],
        [[-0.7]],
    )
    return P, K


def blocks_of_gramians(P: StateSpace, K: StateSpace) -> tuple[np.ndarray, np.ndarray]:
    loop = lft(P, K)
    assert loop.stability_margin() > 0
    reach = sl.solve_continuous_lyapunov(loop.A, -loop.B @ loop.B.T)
    seen = sl.solve_continuous_lyapunov(loop.A.T, -loop.C.T @ loop.C)
    return reach[P.order :, P.order :], seen[P.order :, P.order :]


def test_truncations_are_in_the_coordinates_that_balance_the_controller_in_its_loop():
    P, K = controlled()
    truncated, rank = dk._truncations(P, K)
    assert rank == 3
    whole = truncated(3)
    np.testing.assert_allclose(whole.response([0.0, 1.3]), K.response([0.0, 1.3]), rtol=1e-9)
    reach, seen = blocks_of_gramians(P, whole)
    np.testing.assert_allclose(reach, np.diag(np.diag(reach)), atol=1e-9 * reach.max())
    np.testing.assert_allclose(reach, seen, atol=1e-9 * reach.max())
    assert (np.diff(np.diag(reach)) < 0).all()
    part = truncated(2)
    np.testing.assert_allclose(part.A, whole.A[:2, :2])
    np.testing.assert_allclose(part.B, whole.B[:2])
    np.testing.assert_allclose(part.C, whole.C[:, :2])
    assert part.D.tolist() == K.D.tolist() and part.dt == 0.0


def test_states_that_the_loop_does_not_reach_or_see_have_no_rank(monkeypatch):
    P, K = controlled()
    hidden = StateSpace(
        sl.block_diag(K.A, np.diag([-1.0, -2.0])), [*K.B, [0.0], [1.0]], [[*K.C[0], 1.0, 0.0]], K.D
    )
    truncated, rank = dk._truncations(P, hidden)
    assert rank == 3
    np.testing.assert_allclose(truncated(3).response([0.7]), K.response([0.7]), rtol=1e-6)
    unit = np.array([1e-5, 1e-5, 1.0])
    quiet = StateSpace(P.A, P.B * unit, P.C * unit[:, None], P.D)
    assert dk._truncations(quiet, hidden)[1] == 3, "in another unit of w and z"
    lonely = StateSpace([[-1.0]], [[0.0]], [[0.0]], [[-0.5]])
    truncated, rank = dk._truncations(P, lonely)
    assert rank == 0
    work = SimpleNamespace(system=P, scaled=lambda system, scaling: system)
    assert dk.reduce_controller(work, lonely, Scaling(np.zeros((0, 1))), 99.0) is lonely

    def none(*_):
        raise np.linalg.LinAlgError

    monkeypatch.setattr(dk.sl, "solve_continuous_lyapunov", none)
    truncated, rank = dk._truncations(P, K)
    assert rank == 0 and truncated(1) is K


def test_a_reduced_controller_keeps_the_level_with_fewer_states():
    P, K = controlled()
    work = SimpleNamespace(system=P, scaled=lambda system, scaling: system)
    level = hinf_norm(lft(P, K)).upper
    reduced = dk.reduce_controller(work, K, Scaling(np.zeros((0, 1))), 1.5 * level)
    assert 1 <= reduced.order < 3 and hinf_norm(lft(P, reduced)).upper <= 1.5 * level


def test_a_factor_of_a_gramian_drops_what_rounding_made_negative():
    turn = sl.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
    X, skew = turn * [4.0, 1.0, -1e-9] @ turn.T, np.array([[0, 1, 2], [-1, 0, 3], [-2, -3, 0.0]])
    F = dk.gramian_factor(X + skew)
    assert F.shape == (3, 3)
    np.testing.assert_allclose(F @ F.T, turn * [4.0, 1.0, 0.0] @ turn.T, atol=1e-12)
