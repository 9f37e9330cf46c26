"""Fig. 1's plant, D-K iteration on the paper case, and controllers as they are sampled."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.control.design_files import case_files
from lpvguard.engine.synthesis.cases import case_plant, case_weights, differences, paper_case, read_case
from lpvguard.engine.synthesis.dk import Scaling, certify, dk_synthesis
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.hinf import hinf_synthesis
from lpvguard.engine.synthesis.interconnection import OUTPUTWISE, STRUCTURES, generalised_plant, zeros_poles
from lpvguard.engine.synthesis.limits import floor_exceeds, mu_floor
from lpvguard.engine.synthesis.mu import mu_bounds
from lpvguard.engine.synthesis.statespace import StateSpace, lft, to_discrete
from lpvguard.engine.synthesis.worst_case import close_delta, worst_case
from lpvguard.report.design_pictures import drawn
from lpvguard.vehicle import truck_model
from made import ROOT

CASE = ROOT / "tests" / "data" / "paper_case.toml"
TS = 0.005
OBJECTIVE = {"A_t": 95.0, "A_u": 1e-6}


@pytest.fixture(scope="module")
def case():
    return read_case(CASE)


@pytest.fixture(scope="module")
def rows():
    return paper_case(CASE)


def response(entry, s, gain=None):
    """A weight of the case file straight from its coefficients."""
    if "num" in entry:
        return np.polyval(entry["num"], s) / np.polyval(entry["den"], s)
    value = entry["gain"] if gain is None else gain
    return value * np.prod([s / z + 1 for z in entry["zeros"]]) / np.prod([s / p + 1 for p in entry["poles"]])


@pytest.mark.parametrize("omega", [0.0, 0.3, 7.0])
def test_every_path_of_fig_1_is_the_product_of_its_weights(case, omega):
    """The state-uncertain plant against the block diagram written out with transfer functions."""
    P = case_plant(case, OBJECTIVE, "K_is").system
    s = 1j * omega
    W = {
        k: response(
            case[k], s, OBJECTIVE.get(case[k].get("gain") if isinstance(case[k].get("gain"), str) else None)
        )
        for k in case
        if k.startswith("W_")
    }
    A, B = truck_model.continuous(case["v"], case["wheelbase"])
    resolvent = np.linalg.inv(s * np.eye(3) - A)
    r_u, d_u = (resolvent @ B)[:2, 0]
    G = dict(zip([(o, i) for o in P.outputs for i in P.inputs], P.response([omega])[0].ravel(), strict=True))
    expected = {
        ("eta_i", "u"): 1,
        ("eta_s1", "u"): d_u,
        ("eta_s0", "xi_i"): r_u * W["W_delta_i"],
        ("eta_s2", "xi_s0"): resolvent[2, 0] * W["W_delta_s"],
        ("z_t", "xi_s1"): -W["W_t"] * resolvent[0, 1] * W["W_delta_s"],
        ("z_t", "r_c"): W["W_t"] * W["W_R"] * W["W_C"],
        ("z_t", "w_r"): -W["W_t"] * W["W_wr"],
        ("z_t", "n_r"): 0,
        ("z_t", "u"): -W["W_t"] * r_u,
        ("z_u", "u"): W["W_u"],
        ("z_u", "xi_i"): 0,
        ("y_c", "r_c"): W["W_C"],
        ("y_r", "n_r"): W["W_nr"],
        ("y_r", "w_r"): W["W_wr"],
        ("y_delta", "w_delta"): W["W_wdelta"],
        ("y_delta", "n_delta"): W["W_ndelta"],
        ("y_delta", "u"): d_u,
        ("y_c", "u"): 0,
        ("y_r", "w_delta"): 0,
    }
    for path, want in expected.items():
        assert G[path] == pytest.approx(want, rel=1e-9, abs=1e-12), path


@pytest.mark.parametrize("omega", [0.0, 0.3, 7.0])
def test_every_path_with_a_delta_an_output_is_the_product_of_its_weights(case, omega):
    """K_o against the block diagram written out; its two weights differ, so that none can stand for the
    other."""
    common = case_weights(case, OBJECTIVE)
    weights = replace(common, W_delta_o=(zeros_poles(0.3, [5.0], [50.0]), zeros_poles(0.7, [], [9.0])))
    A, B = truck_model.continuous(case["v"], case["wheelbase"])
    plant = generalised_plant(A, B, weights, OUTPUTWISE)
    P, s = plant.system, 1j * omega
    W = {
        name + suffix: own.response([omega])[0, 0, 0]
        for name, systems in weights.systems().items()
        for own, suffix in zip(systems, ("",) if len(systems) == 1 else ("r", "delta"), strict=True)
    }
    r_u, d_u = (np.linalg.inv(s * np.eye(3) - A) @ B)[:2, 0]
    assert P.inputs == ("xi_r", "xi_delta", "w_r", "w_delta", "n_r", "n_delta", "r_c", "u")
    assert P.outputs == ("eta_r", "eta_delta", "z_t", "z_u", "y_c", "y_r", "y_delta")
    assert [(b.rows, b.cols) for b in plant.blocks] == [(1, 1), (1, 1)]
    assert (plant.n_delta_out, plant.n_delta_in, plant.n_control, plant.n_measurement) == (2, 2, 1, 3)
    assert W["W_delta_or"] == pytest.approx(0.3 * (s / 5 + 1) / (s / 50 + 1))
    expected = dict.fromkeys([(o, i) for o in P.outputs for i in P.inputs], 0) | {
        ("eta_r", "u"): r_u,
        ("eta_delta", "u"): d_u,
        ("z_t", "xi_r"): -W["W_t"] * W["W_delta_or"],
        ("z_t", "w_r"): -W["W_t"] * W["W_wr"],
        ("z_t", "r_c"): W["W_t"] * W["W_R"] * W["W_C"],
        ("z_t", "u"): -W["W_t"] * r_u,
        ("z_u", "u"): W["W_u"],
        ("y_c", "r_c"): W["W_C"],
        ("y_r", "xi_r"): W["W_delta_or"],
        ("y_r", "w_r"): W["W_wr"],
        ("y_r", "n_r"): W["W_nr"],
        ("y_r", "u"): r_u,
        ("y_delta", "xi_delta"): W["W_delta_odelta"],
        ("y_delta", "w_delta"): W["W_wdelta"],
        ("y_delta", "n_delta"): W["W_ndelta"],
        ("y_delta", "u"): d_u,
    }
    got = dict(zip(expected, P.response([omega])[0].ravel(), strict=True))
    for path, want in expected.items():
        assert got[path] == pytest.approx(want, rel=1e-9, abs=1e-12), path


def test_a_delay_comes_before_the_vehicle_of_K_o_and_its_weights_may_not_lack(case):
    weights = replace(
        case_weights(case, OBJECTIVE), W_delta_o=(zeros_poles(0.3, [], []), zeros_poles(0.7, [], []))
    )
    A, B = truck_model.continuous(case["v"], case["wheelbase"])
    plain, late = (generalised_plant(A, B, weights, OUTPUTWISE, TS, k).system for k in (0, 2))
    before, after = (P.response([3.0])[0] for P in (plain, late))
    u = plain.inputs.index("u")
    for k, name in enumerate(plain.outputs):
        factor = 1 if name == "z_u" else np.exp(-2j * 3.0 * TS)
        assert after[k, u] == pytest.approx(factor * before[k, u], rel=1e-9), name
    assert np.allclose(np.delete(after, u, axis=1), np.delete(before, u, axis=1))
    with pytest.raises(SynthesisError, match="W_delta_o: 0 weights"):
        generalised_plant(A, B, case_weights(case, OBJECTIVE), OUTPUTWISE)


def test_the_sampled_plant_approaches_the_continuous_one(case):
    continuous = case_plant(case, OBJECTIVE, "K_is").system.response([0.5])[0]
    sampled = case_plant(case, OBJECTIVE, "K_is", dt=1e-3).system.response([0.5])[0]
    assert np.allclose(sampled, continuous, rtol=2e-3, atol=1e-6)


def test_a_delay_multiplies_the_vehicle_path_only(case):
    plain, late = (case_plant(case, OBJECTIVE, "K_i", dt=TS, delay=k).system for k in (0, 2))
    omega, u = [3.0], plain.inputs.index("u")
    before, after = plain.response(omega)[0], late.response(omega)[0]
    lag = np.exp(-2j * 3.0 * TS)
    for name in plain.outputs:
        k = plain.outputs.index(name)
        factor = 1 if name in ("eta_i", "z_u") else lag
        assert after[k, u] == pytest.approx(factor * before[k, u], rel=1e-9)
    assert np.allclose(np.delete(after, u, axis=1), np.delete(before, u, axis=1))


def test_k_inf_is_the_reference_gamma(case):
    for objective in case["objective"]:
        plant = case_plant(case, objective, "K_inf")
        for dt in (0.0, TS):
            plant = case_plant(case, objective, "K_inf", dt=dt)
            result = hinf_synthesis(plant.system, plant.n_control, plant.n_measurement)
            assert result.gamma == pytest.approx(objective["gamma_K_inf"], rel=1e-4)


@pytest.mark.slow("6 s: the paper's case is solved")
def test_table_ii_meets_the_references_at_lower_order(rows):
    """μ at most the best level known for these weights, at a fraction of its order, wherever a controller can
    have that level: the references are rounded to three digits.
    """
    assert [r.structure for r in rows] == ["K_inf", "K_i", "K_is"] * 3
    for row in rows:
        assert row.upper <= max(row.reference, row.floor.at * (1 + 1e-4)), row
        assert row.lower >= row.upper * (1 - 1e-3), row
        assert row.reference_order is None or row.order <= row.reference_order
    assert sum(row.upper > row.reference for row in rows if row.structure != "K_inf") <= 1


@pytest.mark.unhurried
def test_no_controller_goes_below_the_floor(case, rows):
    """K_inf's floor is the DC formula; every certified level and every static gain stands above its floor."""
    for row in rows:
        assert row.floor.value <= row.lower * (1 + 1e-9) and row.floor.at <= row.floor.value * (1 + 1e-3)
        if row.structure == "K_inf":
            w, n = case["W_wr"]["gain"], case["W_nr"]["gain"]
            assert (
                row.floor.value == pytest.approx(row.A_t / np.hypot(1 / w, 1 / n), rel=1e-9)
                and row.floor.frequency == 0
            )
    random = np.random.default_rng(2)
    plant, floor = case_plant(case, OBJECTIVE, "K_is"), rows[2].floor
    G = plant.system.response([0.0])[0]
    for _ in range(300):
        Q, d = random.normal(0, 10 ** random.uniform(-1, 3), (1, 3)), np.exp(random.normal(0, 1, 2))
        M = G[:-3, :-1] + G[:-3, -1:] @ Q @ G[-3:, :-1]
        left, right = np.repeat([*d, 1], [1, 3, 2]), np.repeat([*d, 1], [1, 3, 5])
        assert np.linalg.norm(left[:, None] * M / right, 2) >= floor.value
    assert floor_exceeds(plant, 0.0, floor.value * (1 - 1e-3)) and not floor_exceeds(
        plant, 0.0, floor.at * (1 + 1e-6)
    )


@pytest.mark.unhurried
def test_each_difference_to_the_paper_is_one_sentence_that_the_weights_explain(case, rows):
    difference = differences(case, rows)
    assert all(text.count(". ") == 0 and text.endswith(".") for text in difference)
    assert "calibrated" in difference[0] and f"{rows[0].floor.value:.5f}" in difference[0]
    scale = float(re.search(r"uncertainty weights were ([\d.]+) times", difference[2]).group(1))
    grown = case | {k: case[k] | {"gain": case[k]["gain"] * scale} for k in ("W_delta_i", "W_delta_s")}
    assert mu_floor(case_plant(grown, OBJECTIVE, "K_is"), 0.0).at == pytest.approx(rows[2].paper, abs=2e-3)
    assert "the control effort limits" in difference[1] and "the control effort limits" not in difference[2]
    assert "rounded" in difference[5] and rows[5].floor.value > rows[5].reference


@pytest.mark.slow("4 s: a case is solved")
def test_the_files_of_a_case_hold_every_row_with_its_difference_and_no_time(case, rows):
    files = case_files("paper_case.toml", case, rows)
    table = json.loads(files["table2.json"])["rows"]
    assert [r["difference"] for r in table] == differences(case, rows)
    assert [r["mu_upper"] for r in table] == [r.upper for r in rows] and not any(
        "second" in key for key in table[0]
    )
    read = list(csv.DictReader(files["table2.csv"].splitlines()))
    assert (
        len(read) == 9
        and float(read[1]["floor"]) == pytest.approx(rows[1].floor.value)
        and read[0]["reference_order"] == ""
    )
    assert drawn(files)["fig5.svg"].count("</svg>") == 1


@pytest.mark.unhurried
@pytest.mark.parametrize("structure, dt", [("K_i", 0.0), ("K_is", TS)])
def test_the_worst_delta_is_stable_of_size_one_and_reaches_the_certificate(case, rows, structure, dt):
    row = rows[STRUCTURES.index(structure)]
    plant = case_plant(case, OBJECTIVE, structure, dt=dt)
    K = to_discrete(row.controller, dt) if dt else row.controller
    worst = worst_case(plant, K, row.result.performance.scaling)
    closed = close_delta(lft(plant.system, K), worst.delta)
    assert worst.delta.stability_margin() > 0 and closed.stability_margin() > 0
    assert worst.size == pytest.approx(1, abs=1e-5)
    assert row.upper * (1 - 1e-3) < worst.gain <= row.upper * (1 + 1e-3) and worst.nominal < worst.gain
    assert np.linalg.norm(closed.response([worst.frequency])[0], 2) == pytest.approx(worst.gain, rel=1e-9)


@pytest.mark.unhurried
def test_away_from_dc_the_worst_delta_takes_the_phases_it_needs(case, rows):
    """At 0.3 rad/s no Δ of size 1 among many random ones raises the gain further, and its own gain is that of
    a complex matrix."""
    plant, K = case_plant(case, OBJECTIVE, "K_is", dt=TS), to_discrete(rows[2].controller, TS)
    worst = worst_case(plant, K, rows[2].result.performance.scaling, np.array([0.3]))
    M, random = lft(plant.system, K).response([0.3])[0], np.random.default_rng(4)
    assert np.abs(worst.delta.response([0.3])[0].imag).max() > 0.1
    flat = np.linalg.svd(worst.delta.response(np.geomspace(1e-2, 600, 40)), compute_uv=False)
    assert np.allclose(flat[:, :2], 1, atol=1e-9) and np.allclose(flat[:, 2:], 0, atol=1e-9)
    for _ in range(500):
        delta = np.zeros((4, 4), complex)
        block = random.normal(size=(3, 3)) + 1j * random.normal(size=(3, 3))
        delta[0, 0], delta[1:, 1:] = (
            np.exp(1j * random.uniform(0, 2 * np.pi)),
            block / np.linalg.norm(block, 2),
        )
        inner = np.linalg.solve(np.eye(4) - M[:4, :4] @ delta, M[:4, 4:])
        assert np.linalg.norm(M[4:, 4:] + M[4:, :4] @ delta @ inner, 2) <= worst.gain * (1 + 1e-9)


@pytest.mark.unhurried
def test_the_certificate_lies_above_mu_at_every_frequency(case, rows):
    row = rows[2]
    plant = case_plant(case, {"A_t": row.A_t, "A_u": row.A_u}, "K_is")
    loop = lft(plant.system, row.result.controller)
    blocks = (*plant.blocks, plant.performance_block)
    for M in loop.response(np.r_[0.0, np.geomspace(1e-4, 1e3, 12), np.inf]):
        assert mu_bounds(M, blocks).upper <= row.upper * (1 + 1e-6)


@pytest.mark.unhurried
def test_the_worst_perturbation_found_makes_the_loop_singular(case, rows):
    row = rows[1]
    performance = row.result.performance
    plant = case_plant(case, {"A_t": row.A_t, "A_u": row.A_u}, "K_i")
    M = lft(plant.system, row.result.controller).response([performance.lower_frequency])[0]
    sigma = np.linalg.svd(np.eye(len(M)) - M @ performance.delta, compute_uv=False)
    assert sigma[-1] < 1e-8 and np.linalg.norm(performance.delta, 2) == pytest.approx(
        1 / performance.lower, rel=1e-6
    )


@pytest.mark.unhurried
def test_sampling_and_one_sample_of_delay_keep_the_level(case, rows):
    for row in rows[:3]:
        objective = {"A_t": row.A_t, "A_u": row.A_u}
        K, scaling = to_discrete(row.result.controller, TS), row.result.performance.scaling
        for delay in (0, 1):
            plant = case_plant(case, objective, row.structure, dt=TS, delay=delay)
            assert certify(plant, K, scaling).upper <= row.upper * (1 + 2e-3)


@pytest.mark.unhurried
def test_a_tampered_controller_loses_its_certificate(case, rows):
    row = rows[1]
    plant = case_plant(case, {"A_t": row.A_t, "A_u": row.A_u}, "K_i")
    K = row.result.controller
    assert certify(plant, StateSpace(K.A, 1.02 * K.B, K.C, K.D)).upper > row.upper * 1.005
    assert certify(plant, StateSpace(K.A, -K.B, K.C, K.D)).upper > 10 * row.upper
    assert certify(plant, StateSpace(-K.A, K.B, K.C, K.D)).upper == np.inf


@pytest.mark.unhurried
def test_design_in_discrete_time_reaches_the_continuous_level(case, rows):
    plant = case_plant(case, OBJECTIVE, "K_i", dt=0.01)
    result = dk_synthesis(plant)
    assert result.controller.dt == 0.01
    assert result.performance.upper == pytest.approx(rows[1].upper, rel=2e-3)


def test_scaling_gradient_is_the_derivative_of_its_magnitude():
    rng = np.random.default_rng(0)
    x, omega = rng.standard_normal((2, 5)), np.geomspace(0.01, 100, 5)
    gradient = Scaling(x).log_gradient(omega)
    for i in range(2):
        for j in range(5):
            moved = x.copy()
            moved[i, j] += 1e-6
            difference = (Scaling(moved).log_magnitude(omega) - Scaling(x).log_magnitude(omega))[i] / 1e-6
            assert np.allclose(gradient[i, j], difference, atol=1e-5)


@pytest.mark.parametrize(
    "call, where",
    [
        (lambda c: case_plant(c, OBJECTIVE, "K_x"), "structure"),
        (lambda c: case_plant(c, OBJECTIVE, "K_i", delay=1), "delay"),
        (lambda c: read_case("no such file"), "file"),
    ],
)
def test_bad_requests_are_named(case, call, where):
    with pytest.raises(InputError, match=where):
        call(case)
