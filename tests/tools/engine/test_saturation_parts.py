"""Pieces of the limited loop: its equations solved for the demand, its energy by another recursion, its proof
by hand."""

import numpy as np
import pytest

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis import saturation
from lpvguard.engine.synthesis.dk import Scaling
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.interconnection import GeneralisedPlant
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.saturation import LimitedLoop, _proof, _reached, limited_loop
from lpvguard.engine.synthesis.statespace import EPS, StateSpace, lft

DT = 0.1
SCALING = Scaling(np.array([[0.2, 1.0, -0.5, 2.0, 0.3]]))
L = np.array([[0.3], [0.1]])
K = StateSpace([[0.95, 0.1], [0.0, 0.5]], [[-0.03, 0.01], [-0.15, 0.02]], [[1.0, 0.9]], [[0.0, 0.0]], DT)
Z = 0.4 + 0.8j


def plant(blocks: int = 1) -> GeneralisedPlant:
    """[xi, w1, w2, u] to [eta1, eta2, z1, z2, y1, y2]; one Delta of 1 x 2, or none."""
    random = np.random.default_rng(7)
    A = np.array([[0.8, 0.05, 0.0], [0.0, 0.6, 0.1], [0.1, 0.0, 0.5]])
    B, C = 0.2 * random.standard_normal((3, 4)), 0.5 * random.standard_normal((6, 3))
    D = 0.1 * random.standard_normal((6, 4))
    D[4:, 3] = 0.0
    delta = (Block("full", 1, 2),) * blocks
    return GeneralisedPlant(StateSpace(A, B, C, D, DT), delta, blocks, 2 * blocks, 1, 2)


def by_equations(s: float) -> np.ndarray:
    """[eta, u, z] for each of [xi, p, w] at z = Z, without D: v = u - q, q = s/2 (u + p)."""
    P = plant().system
    R_P, R_K = (np.linalg.inv(Z * np.eye(len(A)) - A) for A in (P.A, K.A))
    columns = []
    for k in range(4):
        unit = np.eye(4)[k]
        w, p = np.r_[unit[0], unit[2:]], unit[1]

        def signals(u, w=w, p=p):
            q = 0.5 * s * (u + p)
            inputs = np.r_[w, u - q]
            x = R_P @ P.B @ inputs
            out = P.C @ x + P.D @ inputs
            return (K.C @ R_K @ (K.B @ out[4:] - L[:, 0] * q))[0], out

        at_0, at_1 = signals(0.0)[0], signals(1.0)[0]
        u = at_0 / (1 - (at_1 - at_0))
        out = signals(u)[1]
        columns.append(np.r_[out[:2], u, out[2:4]])
    return np.array(columns).T


@pytest.mark.parametrize("kappa", [1.0, 2.0, 5.0, np.inf])
def test_the_limited_loop_is_that_of_its_equations_between_d_and_its_inverse(kappa):
    G = limited_loop(plant(), K, L, kappa, SCALING)
    want = by_equations(saturation.sector(kappa))
    d = np.exp(0.2)
    s = 2 / DT * (Z - 1) / (Z + 1)
    for z, p in ((1.0, -0.5), (2.0, 0.3)):
        d *= (s / np.exp(z) + 1) / (s / np.exp(p) + 1)
    np.testing.assert_allclose(
        G.evaluate([Z])[0], np.diag([d, d, 1, 1, 1]) @ want @ np.diag([1 / d, 1, 1, 1]), rtol=1e-9
    )
    assert G.dt == DT


def test_without_delta_it_is_the_loop_alone():
    none = Scaling(np.zeros((0, 1)))
    G = limited_loop(plant(0), K, L, 2.0, none)
    assert (G.n_inputs, G.n_outputs, G.order) == (4, 5, 6)
    # Without a block the limit's signals come first.
    want = by_equations(0.5)[[2, 0, 1, 3, 4]][:, [1, 0, 2, 3]]
    np.testing.assert_allclose(G.evaluate([Z])[0], want)


def test_demands_that_come_late_by_a_sample_are_asked_for():
    one = plant()
    G = one.system
    D = G.D.copy()
    D[5, 3] = 0.1
    direct = GeneralisedPlant(StateSpace(G.A, G.B, G.C, D, DT), one.blocks, 1, 2, 1, 2)
    at_once = StateSpace(K.A, K.B, K.C, [[0.0, 0.1]], DT)
    for bad, controller in ((direct, K), (one, at_once)):
        with pytest.raises(SynthesisError, match="inputs with a delay of at least one sample"):
            limited_loop(bad, controller, L, 2.0, SCALING)


def test_the_controllers_states_stand_behind_those_of_the_inputs_scalings_and_the_plant():
    one = LimitedLoop(plant(), K, L, 2.0, SCALING)
    assert one.demand_before == 2 + 3 + 2 and one.system.order == 2 + 6 + 4
    row = np.zeros(12)
    row[5:7] = K.C[0]
    np.testing.assert_allclose(one.system.C[2], row)
    np.testing.assert_allclose(one.system.A[one.demand_before], row)
    assert one.rows == [2, 1] and one.cols == [1, 1] and one.ones.tolist() == [1.0, 1.0]
    stability, performance = one.stability(), one.performance()
    assert (stability.system.n_outputs, stability.system.n_inputs) == (3, 2)
    np.testing.assert_allclose(stability.system.D, one.system.D[:3, :2])
    assert performance.system is one.system and performance.rows == stability.rows == [2, 1]
    assert one.stable and one.kappa == 2.0


# ---------------------------------------------------------------- the gain


def searched(norm: float) -> float:
    """The least level above ``norm`` of those that nine halvings from 0.5 to 1000 meet, and 5 % more."""
    width = np.log(1e3 / 0.5) / 2**9
    return 1.05 * 0.5 * np.exp(width * np.ceil(np.log(norm / 0.5) / width))


def scaled_up(factor: float) -> GeneralisedPlant:
    one = plant(0)
    G = one.system
    C, D = G.C.copy(), G.D.copy()
    C[:4], D[:4] = factor * C[:4], factor * D[:4]
    return GeneralisedPlant(StateSpace(G.A, G.B, C, D, DT), (), 0, 0, 1, 2)


@pytest.mark.parametrize("factor", [2.0, 7.0, 300.0])
def test_without_delta_or_limit_the_gain_is_the_norm_and_five_percent(factor):
    one = scaled_up(factor)
    loop = LimitedLoop(one, K, L, 1.0, Scaling(np.zeros((0, 1))))
    norm = hinf_norm(lft(one.system, K), 1e-9).upper
    gamma, constants = loop.gain()
    assert gamma == pytest.approx(searched(norm), rel=1e-9) and constants.shape == (1,)


def test_no_gain_is_had_of_an_unstable_loop_or_beyond_a_thousand():
    none = Scaling(np.zeros((0, 1)))
    far = scaled_up(1e5)
    assert LimitedLoop(far, K, L, 1.0, none).gain() is None
    wild = StateSpace([[1.2, 0.1], [0.0, 0.5]], K.B, K.C, K.D, DT)
    loop = LimitedLoop(plant(0), wild, L, 1.0, none)
    assert not loop.stable and loop.gain() is None and loop.energy(np.zeros(1), 1.0, 1.0) is None


def test_a_loop_at_the_limit_of_stability_has_no_gain_and_no_energy(monkeypatch):
    """Its own pole at 1, which nothing reaches; no constants are searched for it."""
    A, B = np.diag([1.0, 0.5]), np.array([[0.0, 0.0], K.B[1]])
    loop = LimitedLoop(plant(0), StateSpace(A, B, K.C, K.D, DT), 0 * L, 1.0, Scaling(np.zeros((0, 1))))
    monkeypatch.setattr(saturation.ConstantScalings, "least", lambda *_: pytest.fail("searched"))
    assert loop.system.stability_margin() == 0.0
    assert not loop.stable and loop.gain() is None and loop.energy(np.zeros(1), 1.0, 1.0) is None


def searched_with(monkeypatch, loop: LimitedLoop, norms, **constants) -> tuple[list, tuple | None]:
    """What ``gain`` asks, (level, start, whether only that), and what it finds where the search from a start
    finds ``norms`` (level, start) beside the start less 1."""
    asked = []

    def least(self, sizes, rest, start, only_whether):
        asked.append((1 / rest, start[0], only_whether))
        assert len(asked) < 20
        return norms(1 / rest, start[0]), start - 1.0

    for name, value in constants.items():
        monkeypatch.setattr(saturation, name, value)
    monkeypatch.setattr(saturation.ConstantScalings, "least", least)
    monkeypatch.setattr(saturation.ConstantScalings, "proved", lambda *_: 0.5)
    return asked, loop.gain()


@pytest.mark.parametrize(("better", "at_other"), [(0.0, 0.9), (-4.0, 0.9), (0.0, 2.0), (-4.0, 2.0)])
def test_the_search_for_a_gain_goes_on_from_the_better_of_its_two_starts(monkeypatch, better, at_other):
    """Levels 0.5 to 50, gains above 5 are had: of 10 halvings the first says no, and so on as by hand."""

    def norms(level, start):
        return at_other if level > 49.9 and start != better else 5.0 / level

    loop = LimitedLoop(plant(), K, L, 2.0, SCALING)
    asked, (gamma, constants) = searched_with(monkeypatch, loop, norms, LARGEST_GAIN=50.0, GAIN_RTOL=1.2)
    # ln 0.5 .. ln 50: halves are 5 and the root of 250, then nothing.
    levels, starts, only = zip(*asked, strict=True)
    assert levels == pytest.approx([50.0, 50.0, 5.0, 250**0.5]) and all(only)
    assert starts == pytest.approx([0.0, -4.0, better - 1, better - 1])
    assert gamma == pytest.approx(1.05 * 250**0.5) and constants == pytest.approx([better - 2] * 2)


def test_a_gain_is_searched_as_finely_as_asked(monkeypatch):
    loop, whole = LimitedLoop(plant(), K, L, 2.0, SCALING), float(np.log(50.0) - np.log(0.5))
    asked, (gamma, _) = searched_with(monkeypatch, loop, lambda *_: 0.5, LARGEST_GAIN=50.0, GAIN_RTOL=whole)
    assert len(asked) == 2 and gamma == pytest.approx(1.05 * 50.0)
    asked, energy = searched_with(monkeypatch, loop, lambda *_: 1.0)
    assert len(asked) == 2 and energy is None


def test_a_gain_that_is_not_proved_is_none(monkeypatch):
    loop = LimitedLoop(plant(), K, L, 2.0, SCALING)
    assert loop.gain() is not None
    seen = []
    monkeypatch.setattr(
        saturation.ConstantScalings, "proved", lambda self, sizes, rest, x: seen.append((sizes, rest)) or 1.0
    )
    assert loop.gain() is None
    monkeypatch.setattr(saturation.ConstantScalings, "proved", lambda *_: 0.999)
    assert seen[0][1] == pytest.approx(1 / loop.gain()[0]) and seen[0][0].tolist() == [1.0, 1.0]


# ---------------------------------------------------------------- the energy


def reached_slowly(A, B, C, D, samples: int = 4000) -> np.ndarray:
    """The least Q by its own recursion from 0."""
    Q = np.zeros_like(A)
    for _ in range(samples):
        V = A @ Q @ C.T + B @ D.T
        Q = A @ Q @ A.T + B @ B.T + V @ np.linalg.solve(np.eye(len(D)) - D @ D.T - C @ Q @ C.T, V.T)
    return Q


@pytest.mark.parametrize("kappa", [1.2, 2.0])
def test_the_energy_keeps_demand_and_step_to_their_bounds_in_the_reached_ellipsoid(kappa):
    loop = LimitedLoop(plant(), K, L, kappa, SCALING)
    x = np.array([-3.9, -3.7])
    G = loop.performance().scaled(loop.ones, 1.0, x).select(slice(0, 3), slice(None))
    Q = reached_slowly(G.A, G.B, G.C, G.D)
    wanted = np.zeros(len(Q))
    wanted[5:7] = K.C[0]
    step = wanted.copy()
    step[7] = -1.0
    largest, moved = np.sqrt(wanted @ Q @ wanted), np.sqrt(step @ Q @ step)
    for u_max, step_max in ((1.0, 50.0), (50.0, 1.0), (2.0, 50.0)):
        want = min(kappa * u_max / largest, step_max / moved)
        assert loop.energy(x, u_max, step_max) == pytest.approx(want, rel=1e-4)


def test_the_energy_has_the_unit_of_the_disturbance():
    """w in a unit a billion times smaller, where the limit has no part: kappa is 1."""
    G, energies = plant(0).system, []
    for unit in (1.0, 1e-9):
        scale = np.array([unit, unit, unit, 1.0])
        one = GeneralisedPlant(StateSpace(G.A, G.B * scale, G.C, G.D * scale, DT), (), 0, 0, 1, 2)
        loop = LimitedLoop(one, K, L, 1.0, Scaling(np.zeros((0, 1))))
        energies.append(loop.energy(np.array([-30.0]), 1.0, 2.0))
    assert energies[1] == pytest.approx(1e9 * energies[0], rel=1e-3)


def test_a_state_that_nothing_reaches_costs_no_energy():
    one = plant(0).system
    A = np.pad(one.A, ((0, 1), (0, 1)))
    A[3, 3] = 0.5
    G = StateSpace(A, np.pad(one.B, ((0, 1), (0, 0))), np.pad(one.C, ((0, 0), (0, 1))), one.D, DT)
    more = GeneralisedPlant(G, (), 0, 0, 1, 2)
    energies = [
        LimitedLoop(p, K, L, 1.5, Scaling(np.zeros((0, 1)))).energy(np.array([-4.0]), 1.0, 2.0)
        for p in (plant(0), more)
    ]
    assert energies[1] == pytest.approx(energies[0], rel=1e-9)


@pytest.mark.parametrize(("margin", "proved"), [(0.5, False), (1.0, False), (1.5, True)])
def test_an_energy_needs_a_proof_beyond_the_reserve(monkeypatch, margin, proved):
    loop = LimitedLoop(plant(), K, L, 2.0, SCALING)
    monkeypatch.setattr(saturation, "_proof", lambda *_: margin)
    assert (loop.energy(np.array([-3.9, -3.7]), 1.0, 1.0) is not None) == proved
    monkeypatch.setattr(saturation, "_reached", lambda *_: None)
    assert loop.energy(np.array([-3.9, -3.7]), 1.0, 1.0) is None


def test_the_largest_energy_is_that_of_the_best_start_and_offset(monkeypatch):
    loop = LimitedLoop(plant(), K, L, 2.0, SCALING)
    asked = []

    def energy(constants, u_max, step_max):
        asked.append((*constants, u_max, step_max))
        return None if constants[0] > 1.5 else 10.0 - abs(constants[1] - 3.0)

    monkeypatch.setattr(loop, "energy", energy)
    reachable = loop.largest_energy([np.array([0.0, 0.5]), np.array([-1.0, 1.0])], 0.7, 0.3)
    assert reachable.energy == 10.0 and reachable.log_constants.tolist() == [1.0, 3.0]
    assert len(asked) == 10 and {one[2:] for one in asked} == {(0.7, 0.3)}
    assert [one[0] for one in asked[:5]] == [-4.0, -2.0, 0.0, 2.0, 4.0]
    assert loop.largest_energy([np.array([9.0, 0.0])], 0.7, 0.3) is None


def small(gain: float = 1.0) -> tuple[np.ndarray, ...]:
    random = np.random.default_rng(11)
    A = np.array([[0.7, 0.2, 0.0], [-0.1, 0.6, 0.3], [0.0, 0.1, 0.5]])
    B, C, D = (random.standard_normal(shape) for shape in ((3, 2), (2, 3), (2, 2)))
    size = hinf_norm(StateSpace(A, B, C, D, DT)).upper
    return A, B, gain / size * C, gain / size * D


def test_the_doubling_ends_at_the_least_solution():
    A, B, C, D = small(0.9)
    slack = np.diag([1e-3, 2e-3, 3e-3])
    Q = _reached(A, B, C, D, slack)
    V = A @ Q @ C.T + B @ D.T
    again = A @ Q @ A.T + B @ B.T + slack + V @ np.linalg.solve(np.eye(2) - D @ D.T - C @ Q @ C.T, V.T)
    np.testing.assert_allclose(again, Q, rtol=1e-10)
    np.testing.assert_allclose(_reached(A, B, C, D, 0 * slack), reached_slowly(A, B, C, D), rtol=1e-9)
    np.testing.assert_array_equal(Q, Q.T)


def doubled(poles, inputs) -> np.ndarray | None:
    """Without outputs Q is the Gramian: of each pole a and input b the sum of b^2 a^(2 k)."""
    n = len(poles)
    none = np.zeros((1, n))
    return _reached(np.diag(poles), np.diag(inputs), none, np.zeros((1, n)), np.zeros((n, n)))


def test_the_doubling_ends_with_what_a_step_adds_at_the_rounding_of_the_largest_entry(monkeypatch):
    """Of a pole at 1/2 step k adds 2^-(2^k) of what there is: 2^-64 in the sixth, below the rounding."""
    np.testing.assert_allclose(doubled([0.5, 0.0], [1.0, 1.0]), np.diag([4 / 3, 1.0]), rtol=1e-15)
    # A step adds 1/4 beside an entry of which that is the rounding.
    np.testing.assert_array_equal(
        doubled([0.5, 0.0], [1.0, 0.5 / EPS**0.5]), np.diag([1.25, 0.25 / EPS]), err_msg="one step"
    )
    monkeypatch.setattr(saturation, "DOUBLINGS", 6)
    np.testing.assert_allclose(doubled([0.5], [1.0]), [[4 / 3]], rtol=1e-15)
    monkeypatch.setattr(saturation, "DOUBLINGS", 5)
    assert doubled([0.5], [1.0]) is None


def test_where_the_gain_is_above_one_nothing_is_proved():
    A, B, C, D = small(1.1)
    Q = _reached(A, B, C, D, np.zeros((3, 3)))
    assert Q is None or not _proof(A, B, C, D, Q) > 1


def test_the_proof_is_the_least_eigenvalue_over_its_reserve():
    """One state: Q = 1 after scaling. M = [a b; c 0] and F = I - M M'."""
    a, b, c, q = 0.5, 0.4, 0.3, 4.0
    M = np.array([[a, b / 2], [2 * c, 0.0]])  # in units in which Q is 1
    F = np.eye(2) - M @ M.T
    reserve = 64 * EPS * (1 + np.linalg.norm(np.abs(M) @ np.abs(M.T), 2))
    proof = _proof(np.array([[a]]), np.array([[b]]), np.array([[c]]), np.zeros((1, 1)), np.array([[q]]))
    assert proof == pytest.approx(np.linalg.eigvalsh(F)[0] / reserve, rel=1e-9)
    # Two states that Q couples, and a direct term.
    A, B, C, D = small(0.5)
    A, B, C = A[:2, :2], B[:2], C[:, :2]
    Q = np.array([[1.0, 0.6], [0.6, 1.0]])
    M, whole = np.block([[A, B], [C, D]]), np.eye(4)
    whole[:2, :2] = Q
    F = whole - M @ whole @ M.T
    reserve = 64 * EPS * (1.6 + np.linalg.norm(np.abs(M) @ whole @ np.abs(M.T), 2))
    assert _proof(A, B, C, D, Q) == pytest.approx(np.linalg.eigvalsh(F)[0] / reserve, rel=1e-9)
    # The same in other units of the states.
    t = np.array([8.0, 0.25])
    units = (A * t / t[:, None], B / t[:, None], C * t, D, Q / t / t[:, None])
    assert _proof(*units) == pytest.approx(_proof(A, B, C, D, Q), rel=1e-9)


def test_the_proof_takes_the_symmetric_part_of_q_and_its_size_without_signs():
    A, B, C, D = small(0.5)
    Q = np.array([[1.0, 0.5, -0.3], [0.5, 1.0, 0.1], [-0.3, 0.1, 1.0]])
    M, whole = np.block([[A, B], [C, D]]), np.eye(5)
    whole[:3, :3] = Q
    F = whole - M @ whole @ M.T
    size = np.linalg.eigvalsh(Q)[-1] + np.linalg.norm(np.abs(M) @ np.abs(whole) @ np.abs(M.T), 2)
    want = np.linalg.eigvalsh(F)[0] / (64 * EPS * size)
    skew = 0.2 * np.array([[0.0, 1.0, -2.0], [-1.0, 0.0, 3.0], [2.0, -3.0, 0.0]])
    assert _proof(A, B, C, D, Q) == pytest.approx(want, rel=1e-9)
    assert _proof(A, B, C, D, Q + skew) == pytest.approx(want, rel=1e-9)


def test_the_reserve_for_rounding_is_counted_in_units_of_it(monkeypatch):
    """One state: scaled, Q is 1, as large as 1 / EPS units."""
    one = (np.zeros((1, 1)),) * 4 + (np.array([[4.0]]),)
    monkeypatch.setattr(saturation, "RESERVE", 1 / EPS)
    assert _proof(*one) == -np.inf
    monkeypatch.setattr(saturation, "RESERVE", 1 / EPS - 1)
    assert _proof(*one) == pytest.approx(1.0)


def test_a_q_that_is_not_surely_positive_proves_nothing():
    A, B, C, D = (0.1 * np.eye(2),) * 4
    for Q in (
        np.diag([1.0, 0.0]),
        np.diag([1.0, -1.0]),
        np.array([[1.0, np.nan], [np.nan, 1.0]]),
        np.array([[1.0, 2.0], [2.0, 1.0]]),
        np.array([[1.0, 1 - 50 * EPS], [1 - 50 * EPS, 1.0]]),
    ):
        assert _proof(A, B, C, D, Q) == -np.inf
    near = np.array([[1.0, 1 - 300 * EPS], [1 - 300 * EPS, 1.0]])
    assert _proof(A, B, C, D, near) > -np.inf
