"""H∞ synthesis: independent references for γ, and every returned controller closed again here."""

from fractions import Fraction

import cvxpy as cp
import numpy as np
import pytest
import scipy.linalg as sl

from lpvguard.engine.synthesis import gamma_search, riccati, zeros
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.hinf import hinf_synthesis, proved_lower_bound
from lpvguard.engine.synthesis.interconnection import rational
from lpvguard.engine.synthesis.statespace import StateSpace, lft, to_discrete, zero_order_hold
from lpvguard.extras.problems.synthesis import solve_hinf


def check_certificate(plant, n_u, n_y, result, backoff=1.01, rounding=1e-9):
    """The closed loop is stable, and no point of a dense grid lies above the certified norm by more than
    ``rounding`` of the response."""
    loop = lft(plant, result.controller)
    assert loop.stability_margin() > 0
    top = np.pi / plant.dt if plant.dt else 1e6
    omega = np.concatenate([[0.0], np.geomspace(1e-6 * top, top, 4000), [] if plant.dt else [np.inf]])
    grid = np.linalg.norm(loop.response(omega), 2, axis=(1, 2)).max()
    assert grid <= result.gamma_achieved * (1 + rounding)
    assert result.gamma * (1 - 1e-6) <= result.gamma_achieved <= backoff * result.gamma


def coprime_plant(G):
    """Generalised plant of the normalised coprime factor problem: z = [y; u], w = [v1; v2], y = G(u + v1) +
    v2.
    """
    n, m, p = G.order, G.n_inputs, G.n_outputs
    B = np.hstack([G.B, np.zeros((n, p)), G.B])
    C = np.vstack([G.C, np.zeros((m, n)), G.C])
    Zmm, Zmp = np.zeros((m, m)), np.zeros((m, p))
    row = np.hstack([np.zeros((p, m)), np.eye(p), np.zeros((p, m))])
    return StateSpace(G.A, B, C, np.vstack([row, np.hstack([Zmm, Zmp, np.eye(m)]), row]))


@pytest.mark.parametrize("seed", range(6))
def test_gamma_of_the_four_block_problem_is_its_closed_form(seed):
    """γ² = 1 + λ_max(XZ) (Glover & McFarlane 1989): an answer that needs no γ-iteration; here D11 ≠ 0."""
    rng = np.random.default_rng(seed)
    n = 3 + seed
    G = StateSpace(
        rng.standard_normal((n, n)),
        rng.standard_normal((n, 2)),
        rng.standard_normal((2, n)),
        np.zeros((2, 2)),
    )
    X = sl.solve_continuous_are(G.A, G.B, G.C.T @ G.C, np.eye(2))
    Z = sl.solve_continuous_are(G.A.T, G.C.T, G.B @ G.B.T, np.eye(2))
    want = np.sqrt(1 + np.linalg.eigvals(X @ Z).real.max())
    plant = coprime_plant(G)
    result = hinf_synthesis(plant, 2, 2)
    assert result.gamma == pytest.approx(want, rel=1e-5)
    check_certificate(plant, 2, 2, result)


def lmi_optimum(A, B1, B2, C1, C2, D11, D12, D21):
    """γ_opt by the projected linear matrix inequalities of Gahinet & Apkarian (1994), a conic solver's
    answer.
    """
    n, m1, p1 = len(A), B1.shape[1], C1.shape[0]
    R, S, g = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True), cp.Variable()
    NR = sl.block_diag(sl.null_space(np.hstack([B2.T, D12.T])), np.eye(m1))
    NS = sl.block_diag(sl.null_space(np.hstack([C2, D21])), np.eye(p1))
    control = cp.bmat(
        [[A @ R + R @ A.T, R @ C1.T, B1], [C1 @ R, -g * np.eye(p1), D11], [B1.T, D11.T, -g * np.eye(m1)]]
    )
    filter_ = cp.bmat(
        [[A.T @ S + S @ A, S @ B1, C1.T], [B1.T @ S, -g * np.eye(m1), D11.T], [C1, D11, -g * np.eye(p1)]]
    )
    sides = [N.T @ M @ N for N, M in ((NR, control), (NS, filter_))]
    problem = cp.Problem(
        cp.Minimize(g),
        [0.5 * (M + M.T) << 0 for M in sides] + [cp.bmat([[R, np.eye(n)], [np.eye(n), S]]) >> 0],
    )
    problem.solve(solver="CLARABEL")
    return float(g.value)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("shape", ["regular", "no noise", "no cost", "neither", "direct"])
def test_gamma_agrees_with_a_conic_solver(seed, shape):
    rng = np.random.default_rng(100 + seed)
    n = 3
    A, B1, B2 = rng.standard_normal((n, n)), rng.standard_normal((n, 3)), rng.standard_normal((n, 2))
    C1, C2 = rng.standard_normal((3, n)), rng.standard_normal((2, n))
    D11 = rng.standard_normal((3, 3)) * (shape == "direct")
    D12 = rng.standard_normal((3, 2)) * (shape not in ("no cost", "neither"))
    D21 = rng.standard_normal((2, 3)) * (shape not in ("no noise", "neither"))
    want = lmi_optimum(A, B1, B2, C1, C2, D11, D12, D21)
    plant = StateSpace(
        A, np.hstack([B1, B2]), np.vstack([C1, C2]), np.block([[D11, D12], [D21, np.zeros((2, 2))]])
    )
    result = hinf_synthesis(plant, 2, 2)
    assert result.gamma == pytest.approx(want, rel=2e-3)
    assert bool(result.regularisation) == (shape in ("no noise", "no cost", "neither"))
    check_certificate(plant, 2, 2, result)


def random_plant(seed):
    """Regular, of order 4 to 13, with direct terms from w to z in every second one."""
    rng = np.random.default_rng(seed)
    n = 4 + seed
    D = np.zeros((6, 6))
    D[:4, :4] = 0.3 * rng.standard_normal((4, 4)) * (seed % 2)
    D[2:4, 4:], D[4:, 2:4] = 0.1 * np.eye(2), 0.1 * np.eye(2)
    A = rng.standard_normal((n, n)) / np.sqrt(n) - (1 + 0.5 * (seed % 3)) * np.eye(n)
    return StateSpace(A, rng.standard_normal((n, 6)), rng.standard_normal((6, n)), D)


@pytest.mark.parametrize("seed", range(10))
def test_the_bound_of_single_frequencies_saves_time_and_changes_nothing(seed, monkeypatch):
    plant = random_plant(seed)
    result = hinf_synthesis(plant, 2, 2)
    check_certificate(plant, 2, 2, result)
    monkeypatch.setattr(riccati.Side, "frequency_bound", lambda self, level=None: 0.0)
    assert result.gamma == pytest.approx(hinf_synthesis(plant, 2, 2).gamma, rel=3e-6)


def test_an_optimum_set_by_one_frequency_takes_few_riccati_equations(monkeypatch):
    """A resonant disturbance's peak, off the frequencies of the poles: γ = σ̄ there, found without a
    search."""
    plant = weighted_sensitivity(rational([1.0], [1.0, 3.0, 5.0]), rational([2.0, 4.0], [1.0, 1.2, 9.0]))
    C, D = np.insert(plant.C, 1, 0.0, axis=0), np.insert(plant.D, 1, [0.0, 1.0], axis=0)
    plant, calls = StateSpace(plant.A, plant.B, C, D), []
    coupling = gamma_search.GammaProblem.coupling
    monkeypatch.setattr(
        gamma_search.GammaProblem,
        "coupling",
        lambda self, gamma: calls.append(gamma) or coupling(self, gamma),
    )
    result = hinf_synthesis(plant, 1, 1)
    check_certificate(plant, 1, 1, result)
    assert len(calls) <= 6


def test_a_control_input_that_reaches_no_state_can_only_be_left_at_zero():
    """|w1 -> z1| of 2/(s + 4) peaks at 1/2, whatever u adds to z2."""
    plant = StateSpace(
        [[-4.0]], [[2.0, 0.0, 0.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]]
    )
    result = hinf_synthesis(plant, 1, 1)
    check_certificate(plant, 1, 1, result)
    assert result.gamma == pytest.approx(0.5, rel=1e-5)


def test_a_wrong_bound_of_a_single_frequency_is_found_out(monkeypatch):
    plant = random_plant(3)
    want = hinf_synthesis(plant, 2, 2).gamma
    monkeypatch.setattr(riccati.Side, "frequency_bound", lambda self, level=None: 1.5 * want)
    assert hinf_synthesis(plant, 2, 2).gamma == pytest.approx(want, rel=3e-6)


def weighted_sensitivity(G, W):
    """z = W (w − G u), y = w − G u: no cost on u at all, so D12 = 0."""
    n, k = G.order, W.order
    A = np.block([[G.A, np.zeros((n, k))], [-W.B @ G.C, W.A]])
    B = np.block([[np.zeros((n, 1)), G.B], [W.B, np.zeros((k, 1))]])
    C = np.block([[-W.D @ G.C, W.C], [-G.C, np.zeros((1, k))]])
    return StateSpace(A, B, C, np.array([[W.D[0, 0], 0.0], [1.0, 0.0]]))


def test_a_right_half_plane_zero_sets_gamma_by_interpolation():
    """S(2) = 1 for every stabilising controller, so γ = |W(2)| (and D12 = 0 leaves nothing else)."""
    plant = weighted_sensitivity(rational([1.0, -2.0], [1.0, 3.0, 5.0]), rational([1.0, 10.0], [1.0, 0.1]))
    result = hinf_synthesis(plant, 1, 1)
    assert result.gamma == pytest.approx(12 / 2.1, rel=1e-4)
    check_certificate(plant, 1, 1, result)


def test_a_zero_on_the_imaginary_axis_sets_gamma_by_interpolation():
    """G(0) = 0 makes S(0) = 1: γ = |W(0)|, although no Riccati equation sees it in the limit."""
    plant = weighted_sensitivity(rational([1.0, 0.0], [1.0, 2.0, 1.0]), rational([3.0], [1.0, 1.0]))
    result = hinf_synthesis(plant, 1, 1)
    assert result.gamma == pytest.approx(3.0, rel=1e-3)
    assert any("imaginary axis" in note for note in result.notes)
    check_certificate(plant, 1, 1, result)


def test_a_level_near_the_floor_of_the_direct_terms_is_not_taken_for_reached():
    """G(3j) = 0 makes S(3j) = 1, far above what D11 allows: γ ≥ |[W(3j); 0.3]|."""
    W = rational([0.3, 1.0], [1.0, 0.1])
    plant = weighted_sensitivity(rational([1.0, 0.0, 9.0], np.poly([-1.0, -2.0, -3.0])), W)
    C, D = np.insert(plant.C, 1, 0.0, axis=0), np.insert(plant.D, 1, [0.3, 0.0], axis=0)
    result = hinf_synthesis(StateSpace(plant.A, plant.B, C, D), 1, 1)
    assert result.gamma >= np.hypot(0.3, abs(W.response([3.0])[0, 0, 0])) * (1 - 1e-4)


def wide_plant(seed=1, slow=2e-5, fast=500.0):
    """Poles from ``slow`` to ``fast`` rad/s, non-normal coupling, a tiny cost on u."""
    rng = np.random.default_rng(seed)
    n = 8
    A = np.diag(-np.geomspace(slow, fast, n)) + np.triu(rng.standard_normal((n, n)), 1) * 0.1
    B, C = rng.standard_normal((n, 4)), rng.standard_normal((4, n))
    D = np.zeros((4, 4))
    D[1, 2], D[0, 3], D[2, 0], D[3, 1] = 1e-3, 1.0, 0.1, 0.01
    return StateSpace(A, B, C, D)


def test_gamma_does_not_depend_on_the_units_of_state_control_or_measurement():
    plant = wide_plant()
    gamma = hinf_synthesis(plant, 2, 2).gamma
    rng = np.random.default_rng(5)
    T = np.diag(10.0 ** rng.uniform(-6, 6, 8))
    left, right = np.diag([1, 1, 1e5, 1e-4]), np.diag([1, 1, 1e-6, 1e3])
    scaled = StateSpace(
        np.linalg.inv(T) @ plant.A @ T,
        np.linalg.inv(T) @ plant.B @ right,
        left @ plant.C @ T,
        left @ plant.D @ right,
    )
    result = hinf_synthesis(scaled, 2, 2)
    assert result.gamma == pytest.approx(gamma, rel=1e-5)
    check_certificate(scaled, 2, 2, result)


@pytest.mark.parametrize("dt", [0.0, 0.005])
@pytest.mark.parametrize("kind", ["dense", "diagonal"])
def test_a_badly_conditioned_realisation_gives_the_same_gamma(kind, dt):
    rng = np.random.default_rng(2)
    plant = wide_plant(slow=0.02)
    plant = to_discrete(plant, dt) if dt else plant
    T = rng.standard_normal((8, 8)) if kind == "dense" else np.diag(10.0 ** rng.uniform(-6, 6, 8))
    result = hinf_synthesis(plant.transformed(T), 2, 2)
    assert result.gamma == pytest.approx(hinf_synthesis(plant, 2, 2).gamma, rel=1e-4)
    check_certificate(plant.transformed(T), 2, 2, result)


@pytest.mark.unhurried
def test_an_optimum_that_cannot_be_bracketed_is_not_claimed(monkeypatch):
    """Where rounding hides every level of a singular problem, the controller and its certificate still come
    back."""
    plant = weighted_sensitivity(rational([1.0, -2.0], [1.0, 3.0, 5.0]), rational([1.0, 10.0], [1.0, 0.1]))
    want = hinf_synthesis(plant, 1, 1).gamma
    monkeypatch.setattr(gamma_search.GammaProblem, "coupling", lambda self, gamma: None)
    result = hinf_synthesis(plant, 1, 1)
    assert result.gamma <= want <= result.gamma_achieved
    assert any("lower bound only" in note for note in result.notes)


def test_a_companion_realisation_gives_the_same_gamma():
    """Controllable canonical coordinates of poles four decades apart: rows up to 1e8."""
    G = rational([1.0, 3.0, 2.0], np.poly([-0.02, -0.5, -3.0, -50.0, -200.0]))
    coefficients = np.poly(np.linalg.eigvals(G.A)).real
    raw = StateSpace(
        np.vstack([np.eye(5)[1:], -coefficients[:0:-1]]),
        np.eye(5)[:, -1:],
        [[2.0, 3.0, 1.0, 0.0, 0.0]],
        [[0.0]],
    )
    assert hinf_synthesis(coprime_plant(raw), 1, 1).gamma == pytest.approx(
        hinf_synthesis(coprime_plant(G), 1, 1).gamma, rel=1e-5
    )


def mixed_sensitivity(n, slow, fast):
    """z = [W1 e; W2 u] with W1's pole at ``slow`` and W2's at ``fast`` rad/s, y = e = w - G u, G of order n -
    2."""
    rng = np.random.default_rng(n)
    poles, zeros = 10 ** rng.uniform(-1, 1.5, n - 2), 10 ** rng.uniform(-1, 1.5, n - 3)
    num, den = np.poly(-zeros), np.poly(-poles)
    G, W1, W2 = (
        rational(num * den[-1] / num[-1], den),
        rational([0.5, 1.0], [1.0, slow]),
        rational([1.0, 1.0], [1 / fast, 1.0]),
    )
    g, Z = G.order, np.zeros
    A = sl.block_diag(G.A, W1.A, W2.A)
    A[g, :g] = -W1.B[0, 0] * G.C[0]
    B = np.block([[Z((g, 2)), G.B], [W1.B * [1, 0.01], Z((1, 1))], [Z((1, 2)), W2.B]])
    C = np.block([[-W1.D * G.C, W1.C, Z((1, 1))], [Z((1, g + 1)), 0.01 * W2.C], [-G.C, Z((1, 2))]])
    d1, d2 = W1.D[0, 0], 0.01 * W2.D[0, 0]
    return StateSpace(A, B, C, [[d1, 0.01 * d1, 0], [0, 0, d2], [1, 0.01, 0]])


def companion(G):
    """G in controllable canonical coordinates of the sum of its inputs, transformed in exact arithmetic."""
    n = G.order

    def exact(M):
        return [[Fraction(x) for x in row] for row in np.asarray(M).tolist()]

    def times(X, Y):
        return [
            [sum(a * b for a, b in zip(row, col, strict=True)) for col in zip(*Y, strict=True)] for row in X
        ]

    def solve(M, R):
        M = [row + rest for row, rest in zip(M, R, strict=True)]
        for i in range(n):
            k = max(range(i, n), key=lambda k: abs(M[k][i]))
            M[i], M[k] = M[k], M[i]
            M[i] = [x / M[i][i] for x in M[i]]
            M = [
                row if k == i else [x - row[i] * y for x, y in zip(row, M[i], strict=True)]
                for k, row in enumerate(M)
            ]
        return [row[n:] for row in M]

    def numbers(M):
        return np.array([[float(x) for x in row] for row in M])

    A, v, krylov = exact(G.A), exact(G.B.sum(axis=1, keepdims=True)), []
    for _ in range(n):
        krylov.append([row[0] for row in v])
        v = times(A, v)
    K = [list(row) for row in zip(*krylov, strict=True)]
    a = [row[0] for row in solve(K, [[-row[0]] for row in v])] + [Fraction(1)]
    T = times(K, [[a[i + j + 1] if i + j < n else Fraction(0) for j in range(n)] for i in range(n)])
    rows = np.vstack([np.eye(n)[1:], [-float(x) for x in a[:-1]]])
    return StateSpace(rows, numbers(solve(T, exact(G.B))), numbers(times(exact(G.C), T)), G.D)


@pytest.mark.unhurried
@pytest.mark.parametrize("fast", [500.0, 2e4])
@pytest.mark.parametrize("n", [4, 6, 8, 10, 12])
def test_slow_weights_and_companion_forms_give_the_gamma_of_a_calm_realisation(n, fast):
    """A weight's pole at 2e-5 rad/s is a zero of P21 there, which is not on the imaginary axis: no note may
    say so."""
    plant = mixed_sensitivity(n, 2e-5, fast)
    result = hinf_synthesis(plant, 1, 1)
    modal = sl.schur(plant.A)[1]
    rng = np.random.default_rng(2)
    U, V = (np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(2))
    dense = plant.transformed(U @ np.diag(np.geomspace(1, 1e3, n)) @ V)
    for other in (plant, companion(plant), plant.transformed(modal), to_discrete(plant, 0.005), dense):
        got = hinf_synthesis(other, 1, 1)
        assert not any("axis" in note for note in got.notes)
        assert got.gamma == pytest.approx(result.gamma, rel=1e-3)
        if (
            other is dense and not got.resolved
        ):  # rounding of its entries alone moves the closed loop's norm that far
            assert got.gamma <= result.gamma * (1 + 1e-3) and result.gamma <= got.gamma_achieved
            continue
        assert got.resolved and got.gamma <= got.gamma_achieved
        lower = proved_lower_bound(other, 1, 1, got.gamma)
        assert lower.value <= got.gamma_achieved
        assert other is dense or lower.value >= 0.999 * got.gamma
        check_certificate(other, 1, 1, got, rounding=1e-4 if other is dense else 1e-9)


@pytest.mark.unhurried
@pytest.mark.parametrize("size", [1e6, 1e8, 1e10])
def test_what_rounding_of_the_plant_hides_is_not_claimed(size):
    """Dense coordinates of this condition move the slow poles by more than their size: the plant as given is
    another."""
    rng = np.random.default_rng(2)
    plant = mixed_sensitivity(6, 2e-5, 2e4)
    calm = hinf_synthesis(plant, 1, 1)
    U, V = (np.linalg.qr(rng.standard_normal((6, 6)))[0] for _ in range(2))
    other = plant.transformed(U @ np.diag(np.geomspace(1, size, 6)) @ V)
    try:
        got = hinf_synthesis(other, 1, 1)
    except SynthesisError as refused:
        assert "last digits of A move the pole" in str(refused)
        return
    assert not got.resolved and calm.gamma <= got.gamma_achieved
    lower = proved_lower_bound(other, 1, 1, got.gamma)
    assert lower.moved > 1e-2 and lower.value <= calm.gamma_achieved, "the digits do not determine it"
    assert any("not resolved" in note for note in got.notes) and any(
        "last digits of A" in note for note in got.notes
    )
    loop = lft(other, got.controller)
    grid = np.r_[0, np.geomspace(1e-6, 1e6, 2000)]
    assert (
        loop.stability_margin() > 0
        and np.linalg.norm(loop.response(grid), 2, axis=(1, 2)).max() <= got.gamma_achieved
    )


@pytest.mark.parametrize("omega", [0.0, 0.3, 7.0])
@pytest.mark.parametrize("shift", [0.0, 1e-6, 1e-4])
def test_a_zero_counts_as_on_the_axis_only_when_it_is(omega, shift):
    num = np.real(np.poly(np.array([1j, -1j]) * omega - shift)) if omega else np.array([1.0, shift])
    G = rational(num, np.poly([-2e4, -1.0, -3.0]))
    side = riccati.Side(G.A, np.zeros((3, 1)), G.B, G.C, np.zeros((1, 1)), np.zeros((1, 1)), np.eye(3))
    defect = zeros.rank_defect(side, omega)
    assert (defect <= zeros.ZERO_RTOL) == (shift == 0.0)


def test_the_controller_backs_off_from_the_poles_of_the_optimum():
    plant = wide_plant(3)
    assert np.abs(hinf_synthesis(plant, 2, 2).controller.poles()).max() < 1e6


@pytest.mark.parametrize("dt", [0.005, 0.1])
def test_discrete_synthesis_of_a_tustin_image_gives_the_continuous_gamma(dt):
    plant = coprime_plant(rational([1.0, 3.0], [1.0, 0.5, -2.0]))
    discrete = to_discrete(plant, dt)
    result = hinf_synthesis(discrete, 1, 1)
    assert result.gamma == pytest.approx(hinf_synthesis(plant, 1, 1).gamma, rel=1e-5)
    check_certificate(discrete, 1, 1, result)


def test_a_sampled_plant_with_delays_and_no_noise_is_solved_and_certified():
    plant = zero_order_hold(
        weighted_sensitivity(rational([1.0], [1.0, 1.0, 2.0]), rational([2.0], [1.0, 0.1])), 0.1
    )
    A = np.block(
        [[plant.A, plant.B[:, 1:]], [np.zeros((1, plant.order + 1))]]
    )  # one sample of delay on u: z = 0
    B = np.block([[plant.B[:, :1], np.zeros((plant.order, 1))], [np.array([[0.0, 1.0]])]])
    C = np.hstack([plant.C, plant.D[:, 1:]])
    delayed = StateSpace(A, B, C, np.hstack([plant.D[:, :1], np.zeros((2, 1))]), 0.1)
    result = hinf_synthesis(delayed, 1, 1)
    check_certificate(delayed, 1, 1, result)


def test_a_discrete_pole_at_minus_one_is_no_obstacle():
    A = np.diag([-1.0, 0.5])
    plant = StateSpace(
        A,
        np.array([[1.0, 0, 1.0], [0.3, 0, 1.0]]),
        np.array([[1.0, 1.0], [0, 0], [1.0, 0.5]]),
        np.array([[0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]]),
        0.1,
    )
    result = hinf_synthesis(plant, 1, 1)
    check_certificate(plant, 1, 1, result)


def test_d22_is_part_of_the_loop():
    base = coprime_plant(rational([1.0], [1.0, -1.0]))
    D = base.D.copy()
    D[-1, -1] = 0.7
    plant = StateSpace(base.A, base.B, base.C, D)
    result = hinf_synthesis(plant, 1, 1)
    assert result.gamma == pytest.approx(hinf_synthesis(base, 1, 1).gamma, rel=1e-6)
    check_certificate(plant, 1, 1, result)


@pytest.mark.parametrize("which, message", [("B", "stabilisable"), ("C", "detectable")])
def test_a_mode_out_of_reach_is_named_with_its_pole(which, message):
    B, C = np.ones((2, 2)), np.ones((2, 2))
    (B if which == "B" else C)[1] = 0.0
    if which == "C":
        C = np.array([[1.0, 1.0], [1.0, 0.0]])
    A = np.diag([-1.0, 0.25])
    B = np.array([[1.0, 1.0], [1.0, 0.0]]) if which == "B" else np.ones((2, 2))
    plant = StateSpace(A, B, C if which == "C" else np.ones((2, 2)), np.array([[0, 1.0], [1.0, 0]]))
    with pytest.raises(SynthesisError, match=message) as caught:
        hinf_synthesis(plant, 1, 1)
    assert "0.25" in str(caught.value) and "expected" in str(caught.value)


@pytest.mark.parametrize(
    "change, where",
    [
        ({"n_control": 0}, "n_control"),
        ({"n_measurement": 9}, "n_measurement"),
        ({"A": [[1.0, 2.0]]}, "A"),
        ({"D": None}, "D"),
        ({"C": [[1.0, "x"]]}, "C"),
        ({"dt": -1}, "dt"),
        ({"A": [[float("nan")]]}, "A"),
    ],
)
def test_solve_names_the_bad_field(change, where):
    problem = {
        "id": "p",
        "A": [[-1.0]],
        "B": [[1.0, 1.0]],
        "C": [[1.0], [1.0]],
        "D": [[0.0, 1.0], [1.0, 0.0]],
        "n_control": 1,
        "n_measurement": 1,
        "dt": 0,
    }
    # 1 without a controller; -1 / (s + 3) cancels the disturbance, and rounding may leave nothing.
    assert 0 <= solve_hinf(problem)["gamma"] < 1
    with pytest.raises(SynthesisError, match=where):
        solve_hinf(problem | change)
