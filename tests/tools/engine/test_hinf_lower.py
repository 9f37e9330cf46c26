"""Lower bounds of the H∞ optimum: close to it, never above what is achieved, and refused when planted."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl

from lpvguard.engine.synthesis import hinf, hinf_lower
from lpvguard.engine.synthesis.coordinates import schur_coordinates
from lpvguard.engine.synthesis.hinf import hinf_synthesis, proved_lower_bound
from lpvguard.engine.synthesis.hinf_lower import dual_bound, dual_certificate, frequency_level
from lpvguard.engine.synthesis.statespace import StateSpace, append, to_discrete
from lpvguard.extras.bench import _hinf_families
from lpvguard.extras.bench._mu_families import problems
from lpvguard.extras.problems.solve import solve_problem

NAMES = [family.__name__ for family in _hinf_families.PROBLEMS]


def modal(poles, residues, direct) -> StateSpace:
    return StateSpace(np.diag(poles), np.ones((len(poles), 1)), [residues], [[direct]])


def companion(G: StateSpace) -> StateSpace:
    """The same response with A in companion form."""
    n, poles = G.order, np.poly(G.A)
    numerator = np.poly(G.A - G.B @ G.C) - poles
    A = np.vstack([np.eye(n)[1:], -poles[1:][::-1]])
    return StateSpace(A, np.eye(n)[:, -1:], numerator[1:][::-1][None], G.D, G.dt)


def weighted(vehicle, disturbance, tracking, effort, noise=0.01) -> StateSpace:
    """[w; n; u] to [tracking (y); effort u; y + noise n], y = vehicle u + disturbance w."""
    parts = append(disturbance, vehicle)
    y = StateSpace(parts.A, parts.B, np.ones((1, 2)) @ parts.C, np.ones((1, 2)) @ parts.D, vehicle.dt)
    n1, n2 = y.order, tracking.order
    A = sl.block_diag(y.A, tracking.A, effort.A)
    A[n1 : n1 + n2, :n1] = tracking.B @ y.C
    B = np.zeros((len(A), 3))
    B[:n1, [0, 2]], B[n1 : n1 + n2, [0, 2]] = y.B, tracking.B @ y.D
    B[n1 + n2 :, 2:] = effort.B
    C, D = np.zeros((3, len(A))), np.zeros((3, 3))
    C[0, :n1], C[0, n1 : n1 + n2], C[1, n1 + n2 :], C[2, :n1] = tracking.D @ y.C, tracking.C, effort.C, y.C
    D[0, [0, 2]], D[1, 2], D[2, [0, 2]], D[2, 1] = tracking.D @ y.D, effort.D[0, 0], y.D, noise
    return StateSpace(A, B, C, D, vehicle.dt)


def parts_of(seed: int) -> tuple[StateSpace, ...]:
    """A vehicle and three weights; of every third the disturbance's weight has no direct term."""
    random = np.random.default_rng(seed)

    def drawn(n, low, high, direct):
        poles = -(10.0 ** np.sort(random.uniform(low, high, n)))
        return modal(poles, np.abs(random.standard_normal(n)) * np.abs(poles), direct)

    return (
        drawn(2, -1, 1, 0.0),
        drawn(2, -2, 1.5, 0.0 if seed % 3 == 0 else 0.01),
        drawn(int(random.integers(2, 5)), -2.5, 2.5, 0.1 * (seed % 2)),
        drawn(1, 0.5, 2, 1.0),
    )


def problem(plant: StateSpace) -> dict:
    parts = {name: getattr(plant, name).tolist() for name in "ABCD"}
    return {"id": 1, "kind": "hinf", **parts, "dt": plant.dt, "n_control": 1, "n_measurement": 1}


def disguised(parts, form: str, seed: int) -> StateSpace:
    if form == "companion":
        return weighted(parts[0], *map(companion, parts[1:]))
    plant, random = weighted(*parts), np.random.default_rng(seed)
    n = plant.order
    turn = [np.linalg.qr(random.standard_normal((n, n)))[0] for _ in range(2)]
    if form == "dense":
        return plant.transformed(turn[0] * 10 ** np.linspace(-1, 1, n) @ turn[1])
    if form == "scaled":
        return plant.transformed(np.diag(10 ** random.uniform(-3, 3, n)))
    A = sl.block_diag(plant.A, plant.A[-1:, -1:] - 1e-6)  # a copy of a weight's state that nothing reaches
    B = np.vstack([plant.B, np.zeros((1, 3))])
    return StateSpace(A, B, np.hstack([plant.C, plant.C[:, -1:]]), plant.D)


@pytest.mark.unhurried
@pytest.mark.parametrize("form", ["companion", "dense", "scaled", "copy"])
@pytest.mark.parametrize("dt", [0.0, 0.02])
def test_the_level_does_not_depend_on_the_coordinates(form, dt):
    for seed in range(6):
        parts = parts_of(seed)
        calm, other = weighted(*parts), disguised(parts, form, seed)
        if dt:
            calm, other = to_discrete(calm, dt), to_discrete(other, dt)
        want, got = solve_problem(problem(calm)), solve_problem(problem(other))
        assert want["resolved"] and want["gamma_lower"] <= want["gamma"] <= want["gamma_achieved"]
        assert got["status"] == "ok" and got["resolved"], (seed, got)
        assert got["gamma_lower"] <= want["gamma_achieved"] * (1 + 1e-6)
        assert want["gamma_lower"] <= got["gamma_achieved"] * (1 + 1e-6)
        assert got["gamma_lower"] == pytest.approx(want["gamma_lower"], rel=2e-3)


def test_data_whose_last_digits_decide_are_refused_with_that_reason():
    """A discrete weight of six slow poles in companion form: its digits hold them to a hundredth at best."""
    parts = [to_discrete(part, 1e-3) for part in parts_of(1)]
    slow = to_discrete(modal(-(10.0 ** np.linspace(-1.5, 0.5, 6)), np.ones(6), 0.1), 1e-3)
    plant = weighted(parts[0], parts[1], companion(slow), parts[3])
    assert solve_problem(problem(plant))["status"] == "error"
    assert solve_problem(problem(weighted(parts[0], parts[1], slow, parts[3])))["resolved"]


def test_the_reason_names_how_far_the_digits_move_the_optimum_and_what_is_known(monkeypatch):
    plant = weighted(*parts_of(COUPLED[0]))
    monkeypatch.setattr(hinf, "_moved_optimum", lambda *_: 0.5)
    answer = solve_problem(problem(plant))
    assert answer["status"] == "error"
    assert "the optimum depends on the last digits of the data" in answer["error"]
    assert "a relative change of 1e-14 of the entries moves it by 0.5 of itself" in answer["error"]
    assert "known is " in answer["error"] and "<= optimum <=" in answer["error"]


@pytest.mark.unhurried
@pytest.mark.parametrize(
    ("family", "seed", "index", "said"),
    [
        pytest.param(
            "dense_companion_weight", 5309, 12, "", id="Riccati equations of no digit in Schur form"
        ),
        pytest.param("dense_companion_weight", 7741, 110, "", id="the same, 1.3e4 times the optimum"),
        pytest.param("dense_companion_weight", 7741, 15, "", id="1e-13 of the data moves it by 0.1 %"),
        pytest.param("dense_companion_weight", 7741, 86, "", id="rounding of the closed loop in its units"),
        pytest.param("dense", 7741, 465, "", id="the same, an optimum of 4.6e5"),
        pytest.param("dense_companion_weight", 7741, 787, "depends on the last digits", id="digits decide"),
        pytest.param(
            "discrete", 7741, 465, "not proved", id="a norm that the bilinear map's rounding lowers"
        ),
    ],
)
def test_hidden_coordinates_are_undone_to_the_last_digit(family, seed, index, said):
    drawn, value = next(problems(_hinf_families.PROBLEMS[NAMES.index(family)], 1, seed, index))
    answer = solve_problem({"id": index, **drawn})
    if answer["status"] == "error":
        assert said and said in answer["error"]
        return
    assert answer["gamma_lower"] <= value * (1 + 1e-7) and value * (1 - 1e-7) <= answer["gamma_achieved"]
    assert answer["resolved"] == (not said) and said in answer["note"]


def test_a_norm_below_what_no_controller_goes_below_is_refused(monkeypatch):
    plant = weighted(*parts_of(1))
    right = hinf_synthesis(plant, 1, 1)
    monkeypatch.setattr(
        "lpvguard.extras.problems.synthesis.hinf_synthesis",
        lambda *_, **__: replace(right, gamma_achieved=0.9 * right.gamma),
    )
    answer = solve_problem(problem(plant))
    assert answer["status"] == "error" and "the lower bound for every controller" in answer["error"]


def test_an_optimum_of_zero_is_resolved():
    plant = StateSpace([[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], [[0.0, 1.0], [1.0, 0.0]])
    answer = solve_problem(problem(plant))
    assert answer["status"] == "ok" and answer["resolved"] and answer["gamma_achieved"] < 1e-9


def posed_at(seed: int):
    posed = hinf._posed(weighted(*parts_of(seed)), 1, 1, schur_coordinates)
    return posed.problem, posed.problem.optimum(1e-8)


COUPLED = (2, 9)
"""Seeds of which no single frequency decides."""


@pytest.mark.parametrize("seed", COUPLED)
def test_a_certificate_proves_nearly_the_optimum(seed):
    game, optimum = posed_at(seed)
    certificate = dual_certificate(game.P, game.control, game.filter, optimum * (1 - 1e-6))
    assert optimum * (1 - 1e-4) <= dual_bound(game.P, certificate) <= optimum * (1 + 1e-7)
    assert frequency_level(weighted(*parts_of(seed)), 1, 1) < optimum * (1 - 1e-3), "it is needed"


@pytest.mark.parametrize("seed", range(8))
def test_no_certificate_of_any_level_proves_more_than_the_optimum(seed):
    game, optimum = posed_at(seed)
    for share in (0.5, 0.9, 0.99, 1.01, 2.0):
        certificate = dual_certificate(game.P, game.control, game.filter, share * optimum)
        if certificate is not None:
            assert dual_bound(game.P, certificate) <= optimum * (1 + 1e-7)


@pytest.mark.parametrize("seed", COUPLED)
def test_a_planted_certificate_is_refused(seed):
    """Its parts are changed by 1 %, so that they leave the null space, or Q is not positive."""
    game, optimum = posed_at(seed)
    right = dual_certificate(game.P, game.control, game.filter, optimum * (1 - 1e-6))
    random = np.random.default_rng(seed)
    wrong = []
    for name in ("first", "second"):
        factor = getattr(right, name)
        wrong.append(replace(right, **{name: factor * (1 + 0.01 * random.standard_normal(factor.shape))}))
        n = len(game.P.A)
        moved = factor.copy()
        moved[:n] *= 1.01
        wrong.append(replace(right, **{name: moved}))
    assert [dual_bound(game.P, one) for one in wrong] == [0.0] * len(wrong)
    assert max(dual_bound(game.P, one, np.inf) for one in wrong) > 0, "the checks are what refuses them"


def test_a_false_claim_of_the_optimum_is_not_proved(monkeypatch):
    """A claim of 200 where the optimum is below 10 leaves what is proved, and the answer says that."""
    plant = weighted(*parts_of(1))
    right = hinf_synthesis(plant, 1, 1)
    lower = proved_lower_bound(plant, 1, 1, 200 * right.gamma)
    assert lower.value <= right.gamma_achieved
    monkeypatch.setattr(
        "lpvguard.extras.problems.synthesis.hinf_synthesis",
        lambda *_, **__: replace(right, gamma=200 * right.gamma, gamma_achieved=200 * right.gamma),
    )
    monkeypatch.setattr(hinf, "_moved_optimum", lambda *_: 0.0)
    answer = solve_problem(problem(plant))
    assert not answer["resolved"] and answer["gamma_lower"] <= right.gamma_achieved
    assert "not proved: the optimum lies between" in answer["note"]


def static(D) -> StateSpace:
    return StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((3, 0)), D)


def test_rounding_is_deducted_at_a_frequency():
    """No Q cancels the second row; of a control whose path is rounding nothing is proved."""
    plant = static([[3.0, 1.0], [4.0, 0.0], [1.0, 0.0]])
    assert frequency_level(plant, 1, 1) == pytest.approx(4.0, rel=1e-12)
    assert frequency_level(static([[3.0, 0.0], [4.0, 0.0], [1.0, 0.0]]), 1, 1) == 0.0
    known, free = np.array([[3.0], [4.0]]), np.array([[1.0], [0.0]])
    assert hinf_lower._uncancelled(known, free, 0.5, 0.1) == pytest.approx(4.0 - 0.5 - 0.1 * 5.0)
