"""State-space algebra: each operation against the transfer functions it claims to form."""

import numpy as np
import pytest
import scipy.linalg as sl

from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.interconnection import rational, zeros_poles
from lpvguard.engine.synthesis.statespace import (
    StateSpace,
    append,
    balanced,
    gain,
    lft,
    prewarped,
    series,
    to_continuous,
    to_discrete,
    zero_order_hold,
)

OMEGA = np.array([0.0, 0.03, 1.0, 40.0, np.inf])


def random_system(seed, n=4, m=3, p=2, dt=0.0):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A = A / (1.2 * np.abs(np.linalg.eigvals(A)).max()) if dt else A - 3 * np.eye(n)
    return StateSpace(
        A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), rng.standard_normal((p, m)), dt
    )


def test_response_matches_the_definition_at_finite_and_infinite_frequency():
    G = random_system(0)
    value = G.response(OMEGA)
    assert np.allclose(value[-1], G.D)
    assert np.allclose(value[2], G.D + G.C @ np.linalg.inv(1j * np.eye(4) - G.A) @ G.B)


def test_series_append_and_select_form_the_products_they_name():
    G, H = random_system(1, p=2), random_system(2, m=2)
    assert np.allclose(series(H, G).response(OMEGA), H.response(OMEGA) @ G.response(OMEGA))
    both = append(G, H).response(OMEGA)
    assert np.allclose(both[:, :2, :3], G.response(OMEGA)) and not np.any(both[:, :2, 3:])
    assert np.allclose(G.select([1], slice(0, 2)).response(OMEGA), G.response(OMEGA)[:, [1], :2])


def test_lft_closes_the_loop_with_direct_terms_on_both_sides():
    P, K = random_system(3, m=4, p=5), random_system(4, n=2, m=2, p=1)
    p, k = P.response(OMEGA), K.response(OMEGA)
    p11, p12, p21, p22 = p[:, :3, :3], p[:, :3, 3:], p[:, 3:, :3], p[:, 3:, 3:]
    want = p11 + p12 @ k @ np.linalg.inv(np.eye(2) - p22 @ k) @ p21
    assert np.allclose(lft(P, K).response(OMEGA), want)


def test_lft_refuses_an_algebraic_loop_that_has_no_solution():
    P = gain(np.array([[0.0, 1.0], [1.0, 2.0]]))
    with pytest.raises(SynthesisError, match="well-posed"):
        lft(P, gain(0.5))


@pytest.mark.parametrize("dt", [1e-3, 0.1, 1.0])
def test_bilinear_maps_are_inverse_and_keep_the_response_at_warped_frequencies(dt):
    G = random_system(5)
    D = to_discrete(G, dt)
    omega = np.array([0.0, 0.3, 2.0])
    assert np.allclose(D.response(2 / dt * np.arctan(omega * dt / 2)), G.response(omega))
    assert np.allclose(to_continuous(D).response(omega), G.response(omega))


def test_frequencies_are_prewarped_where_there_is_a_sampling_time():
    omega = np.array([0.0, 3.0, 20.0])
    expected = 2 / 0.1 * np.tan(np.array([0.0, 0.15, 1.0]))
    np.testing.assert_allclose(prewarped(omega, 0.1), expected, rtol=1e-14)
    assert prewarped(3.0, 0.0) == 3.0


def test_to_continuous_names_a_pole_at_minus_one():
    with pytest.raises(SynthesisError, match="z = −1"):
        to_continuous(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.1))


def test_zero_order_hold_is_the_step_response_of_the_lag():
    G = zero_order_hold(StateSpace([[-2.0]], [[3.0]], [[1.0]], [[0.0]]), 0.1)
    assert np.isclose(G.A[0, 0], np.exp(-0.2)) and np.isclose(G.B[0, 0], 1.5 * (1 - np.exp(-0.2)))


def test_balancing_keeps_the_response_and_evens_out_a_scaling_of_nine_decades():
    G = random_system(6)
    scale = np.diag([1e-9, 1.0, 1e5, 1e9])
    H = balanced(G.transformed(scale))
    assert np.allclose(H.response(OMEGA), G.response(OMEGA), rtol=1e-9)
    assert np.abs(H.A).max() < 30 * np.abs(G.A).max()


def test_zeros_poles_and_rational_agree_with_the_product():
    s = 1j * OMEGA[:-1]
    want = 2.0 * (s / 5 + 1) * (s / 60 + 1) / ((s / 0.02 + 1) * (s / 3 + 1) * (s / 50 + 1))
    assert np.allclose(zeros_poles(2.0, [5.0, 60.0], [0.02, 3.0, 50.0]).response(OMEGA[:-1])[:, 0, 0], want)
    assert np.allclose(rational([9.0], [1.0, 5.4, 9.0]).response([0.0, 1.0])[:, 0, 0], [1.0, 9 / (8 + 5.4j)])


def test_improper_weights_are_refused():
    with pytest.raises(SynthesisError, match="proper"):
        rational([1.0, 0.0, 1.0], [1.0, 2.0])
    with pytest.raises(SynthesisError, match="zeros"):
        zeros_poles(1.0, [1.0], [])


@pytest.mark.parametrize("field, value", [("A", [[np.nan]]), ("B", [[1.0, 2.0]]), ("dt", -1.0)])
def test_bad_matrices_are_named(field, value):
    parts = {"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "D": [[0.0]], "dt": 0.0, field: value}
    with pytest.raises(SynthesisError, match=field):
        StateSpace(**parts)


def test_a_system_keeps_its_own_read_only_matrices_and_takes_short_forms():
    A = np.array([[-1.0]])
    G = StateSpace(A, [[2.0]], [3.0], 4, 1)
    A[0, 0] = 9.0
    assert (G.A.tolist(), G.C.tolist(), G.D.tolist()) == ([[-1.0]], [[3.0]], [[4.0]])
    assert G.dt == 1.0 and isinstance(G.dt, float) and not G.A.flags.writeable
    constant = StateSpace([], [], [], [[1.0, 2.0, 3.0]])
    assert (constant.A.shape, constant.B.shape, constant.C.shape) == ((0, 0), (0, 3), (1, 0))
    assert constant.order == 0 and constant.poles().tolist() == [] and constant.stability_margin() == np.inf
    assert (G.n_inputs, constant.n_inputs, constant.n_outputs) == (1, 3, 1)
    assert StateSpace([[]], [], [], [[1.0]]).order == 0
    with pytest.raises(SynthesisError, match=r"A: shape \(1, 2\); expected shape \(1, 1\)"):
        StateSpace([[1.0, 2.0]], [[1.0]], [[1.0]], [[0.0]])
    for A, B, C in (([[1.0]], [], [[1.0]]), ([], [[1.0]], [])):
        with pytest.raises(SynthesisError, match="B: shape"):
            StateSpace(A, B, C, [[0.0]])
    with pytest.raises(SynthesisError, match="dt"):
        StateSpace([[1.0]], [[1.0]], [[1.0]], [[0.0]], np.inf)
    with pytest.raises(SynthesisError, match="dt"):
        StateSpace([[1.0]], [[1.0]], [[1.0]], [[0.0]], -0.5)


def test_names_are_as_many_as_signals_or_none_and_follow_them():
    parts = [[-1.0]], [[1.0, 2.0]], [[1.0]], [[0.0, 0.0]]
    G = StateSpace(*parts, 0.0, ["a", "b"], ["z"])
    assert (G.inputs, G.outputs) == (("a", "b"), ("z",))
    assert StateSpace(*parts).inputs == () == StateSpace(*parts, 0.0, (), ("z",)).inputs
    for inputs, outputs, named in ((("a",), ("z",), "inputs"), (("a", "b"), ("y", "z"), "outputs")):
        with pytest.raises(SynthesisError, match=f"{named}: [12] names"):
            StateSpace(*parts, 0.0, inputs, outputs)
    assert G.select(slice(None), [1]).inputs == ("b",) and G.select([0], slice(1, 2)).inputs == ("b",)
    H = StateSpace([[-2.0]], [[1.0]], [[1.0], [1.0]], [[0.0], [0.0]], 0.0, ("z",), ("p", "q"))
    assert (series(H, G).inputs, series(H, G).outputs) == (("a", "b"), ("p", "q"))
    assert (append(H, G).inputs, append(H, G).outputs) == (("z", "a", "b"), ("p", "q", "z"))
    bare = StateSpace(*parts, 0.0, ("a", "b"))
    assert append(H, bare).inputs == append(H, bare).outputs == append(bare, H).inputs == ()
    assert append(H, StateSpace(*parts, 0.0, (), ("z",))).outputs == ()
    closed = lft(append(H, gain([[0.5]])), gain([[1.0]]))
    assert (closed.inputs, closed.outputs) == ((), ())
    whole = StateSpace(*parts, 0.0, ("a", "b"), ("z",))
    both = append(whole, whole)
    closed = lft(both, gain([[0.1]]))
    assert (closed.inputs, closed.outputs) == (("a", "b", "a"), ("z",))
    assert closed.dt == 0.0
    for sampled in (to_discrete(G, 0.1), zero_order_hold(G, 0.1)):
        assert (sampled.inputs, sampled.outputs) == (("a", "b"), ("z",))
    back = to_continuous(to_discrete(G, 0.1))
    assert (back.inputs, back.outputs, back.dt) == (("a", "b"), ("z",), 0.0)


def test_systems_of_two_sampling_times_are_not_joined():
    one, other = gain([[1.0]], 0.1), gain([[1.0]], 0.2)
    for join in (series, append, lambda a, b: append(a, a, b), lft):
        with pytest.raises(SynthesisError, match=r"dt: 0\.[12] and 0\.[12]"):
            join(one, other)
    wide = gain(0.5 * np.eye(2), 0.1)
    with pytest.raises(SynthesisError, match="dt"):
        lft(wide, other)
    assert gain([[1.0]]).dt == 0 and series(one, one).dt == append(one, one).dt == lft(wide, one).dt == 0.1


def test_the_margin_is_the_distance_of_the_nearest_pole_from_instability():
    A = np.diag([-0.5, 0.25, -0.75])
    rest = np.zeros((3, 1)), np.zeros((1, 3)), [[0.0]]
    assert StateSpace(A, *rest, 0.1).stability_margin() == pytest.approx(0.25)
    assert StateSpace(A, *rest).stability_margin() == pytest.approx(-0.25)
    assert StateSpace(A - np.eye(3), *rest).stability_margin() == pytest.approx(0.75)


def test_many_points_are_those_of_one_at_a_time_and_a_pole_is_infinite():
    G = random_system(7, n=40)
    many = np.linspace(0.0, 9.0, 1300)  # 1250 at once
    response = G.response(many)
    for k in (0, 1, 777, 1249, 1250, 1299):
        np.testing.assert_allclose(response[k], G.evaluate([1j * many[k]])[0], rtol=1e-12)
    lag = StateSpace(np.diag([1.0, 2.0]), np.eye(2), [[1.0, 1.0], [0.0, 1.0]], 5 * np.eye(2))
    at = lag.evaluate([0.0, 1.0, 3.0], skip=np.array([True, False, False]))
    np.testing.assert_allclose(at[0], 5 * np.eye(2))
    assert np.isinf(at[1]).all()
    np.testing.assert_allclose(at[2], [[5.5, 1.0], [0.0, 6.0]])
    near = lag.evaluate([1.0, 0.0])[1]
    np.testing.assert_allclose(near, [[4.0, -0.5], [0.0, 4.5]])
    assert lag.evaluate([0.0], skip=np.array([True]))[0].tolist() == [[5.0, 0.0], [0.0, 5.0]]
    sampled = StateSpace([[0.5]], [[1.0]], [[1.0]], [[2.0]], 0.1)
    np.testing.assert_allclose(sampled.response([np.inf, 0.0])[:, 0, 0], [2.0, 4.0])


def test_a_loop_is_singular_from_a_condition_of_a_hundred_million_million_on():
    plant = np.zeros((3, 3))
    plant[1:, 1:] = np.eye(2)
    for off, bad in ((0.9e-14, True), (1.2e-14, False)):
        K = np.diag([0.0, 1.0 - off])
        if bad:
            with pytest.raises(SynthesisError, match="well-posed"):
                lft(gain(plant), gain(K))
        else:
            assert lft(gain(plant), gain(K)).D.shape == (1, 1)
    G = random_system(9)
    none = gain(np.zeros((0, 0)))
    np.testing.assert_allclose(lft(G, none).response(OMEGA), G.response(OMEGA))


def test_balancing_makes_rows_and_columns_of_like_norm_and_leaves_self_couplings_out():
    """x1' = -1e6 x1 + 2^20 x2, x2' = 2^-20 x1; w and z reach both states alike but for 2^-10 and 2^10."""
    A = np.array([[-1e6, 2.0**20], [2.0**-20, -3.0]])
    G = StateSpace(A, [[2.0**10], [2.0**-10]], [[2.0**-10, 2.0**10]], [[0.0]])
    H = balanced(G)
    np.testing.assert_array_equal(np.abs(H.A - np.diag(np.diag(A))), [[0.0, 1.0], [1.0, 0.0]])
    assert np.abs(np.log2(np.r_[np.abs(H.B[:, 0]), np.abs(H.C[0])])).max() <= 1.0
    assert balanced(gain([[3.0]])).D.tolist() == [[3.0]]
    # Signals alone decide where states are not coupled.
    alone = StateSpace(-np.eye(2), [[2.0**12], [1.0]], [[2.0**-12, 1.0]], [[0.0]])
    np.testing.assert_array_equal(balanced(alone).B, [[1.0], [1.0]])
    np.testing.assert_array_equal(balanced(alone).C, [[1.0, 1.0]])


@pytest.mark.parametrize("alpha", [0.7, 30.0])
def test_a_bilinear_map_may_have_any_alpha(alpha):
    G = random_system(10)
    D = to_discrete(G, 0.1, alpha)
    z = np.array([0.3 + 0.4j, -2.0, 1.5j])
    s = alpha * (z - 1) / (z + 1)
    assert np.allclose(D.evaluate(z), G.evaluate(s))
    assert np.allclose(to_continuous(D, alpha).evaluate(s), G.evaluate(s))
    assert to_continuous(G) is G
    # The states' units are kept: both maps scale inputs and outputs by sqrt(2 alpha).
    inverse = np.linalg.inv(alpha * np.eye(4) - G.A)
    np.testing.assert_allclose(D.B, np.sqrt(2 * alpha) * inverse @ G.B)
    np.testing.assert_allclose(to_continuous(D, alpha).B, G.B)


def test_maps_refuse_poles_that_are_too_near_to_where_they_have_none():
    rest = np.eye(2), np.eye(2), np.eye(2)
    for off, bad in ((0.9e-13, True), (1.2e-13, False)):
        G = StateSpace(np.diag([-1 + off, 0.0]), *rest, 0.1)
        if bad:
            with pytest.raises(SynthesisError, match="z = −1"):
                to_continuous(G)
        else:
            assert to_continuous(G).order == 2
    with pytest.raises(SynthesisError, match="pole at 20 rad/s"):
        to_discrete(StateSpace(np.diag([20.0, 0.0]), *rest), 0.1)
    with pytest.raises(SynthesisError, match="pole at 20 rad/s"):
        to_discrete(StateSpace(np.diag([20.0 * (1 - 7e-16), 0.0]), *rest), 0.1)
    near = StateSpace(np.diag([20.0 * (1 - 4e-15), 0.0]), *rest)
    assert to_discrete(near, 0.1).order == 2
    for one in (to_continuous(gain([[2.0]], 0.1)), to_discrete(gain([[2.0]]), 0.1)):
        assert one.D.tolist() == [[2.0]]


def test_what_vanishes_in_the_image_is_exactly_zero():
    """Two states that an input does not reach and an output does not show; a zero at z = -1."""
    random = np.random.default_rng(11)
    A = sl.block_diag(0.4 * random.standard_normal((3, 3)), 0.3 * random.standard_normal((2, 2)))
    B, C = random.standard_normal((5, 2)), random.standard_normal((2, 5))
    B[3:, 0], C[0, 3:] = 0.0, 0.0
    plus = np.linalg.inv(np.eye(5) + A)
    G = StateSpace(A, B, C, C @ plus @ B, 0.1)  # G(-1) = 0
    H = to_continuous(G)
    assert not H.A[:3, 3:].any() and not H.A[3:, :3].any()
    assert not H.B[3:, 0].any() and not H.C[0, 3:].any() and not H.D.any()
    assert np.abs(H.A[:3, :3]).min() > 0 and np.abs(H.B[3:, 1]).min() > 0 and np.abs(H.C[1]).min() > 0
    small = StateSpace([[0.5]], [[1e-9]], [[1e-9]], [[1e-3]], 0.1)
    image = to_continuous(small)
    assert image.B[0, 0] == pytest.approx(np.sqrt(40) / 1.5 * 1e-9) and image.D[0, 0] == pytest.approx(1e-3)
    # 1 - 1.5 / 1.5: what is left of terms that sum to 2 counts from 1000 eps of that on.
    for left, kept in ((2.2e3, True), (1.8e3, False)):
        one = StateSpace([[0.5]], [[1.5]], [[1.0]], [[1.0 + left * np.finfo(float).eps]], 0.1)
        assert bool(to_continuous(one).D[0, 0]) == kept


def test_zero_order_hold_is_the_series_of_the_exponential():
    G = random_system(12)
    H, dt = zero_order_hold(G, 1e-3), 1e-3
    np.testing.assert_allclose(H.A, np.eye(4) + G.A * dt + G.A @ G.A * dt**2 / 2, atol=1e-7)
    np.testing.assert_allclose(H.B, G.B * dt + G.A @ G.B * dt**2 / 2, atol=1e-7)
    np.testing.assert_array_equal(H.C, G.C)
    np.testing.assert_array_equal(H.D, G.D)
    assert H.dt == dt


@pytest.mark.parametrize("seed", range(12))
def test_zeros_that_the_sampled_matrices_show_only_by_what_cancels_come_back_as_zeros(seed):
    """Of the others some are small, 1e-11 beside entries of size 1: those come back too."""
    random = np.random.default_rng(seed)

    def drawn(*shape):
        M = random.choice([-1.0, 1.0], shape) * random.uniform(0.5, 1.5, shape)
        return M * random.choice([0.0, 1e-11, 1.0, 1.0], shape)

    H = StateSpace(drawn(4, 4) - 4 * np.eye(4), drawn(4, 2), drawn(3, 4), drawn(3, 2))
    back = to_continuous(to_discrete(H, 0.4))
    for name in ("A", "B", "C", "D"):
        was, now = getattr(H, name), getattr(back, name)
        np.testing.assert_array_equal(now == 0, was == 0, name)
        np.testing.assert_allclose(now, was, rtol=1e-2)
