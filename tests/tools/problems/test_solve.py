"""The problem interface: every kind, the comparison rules, error answers that name their place, exit
statuses."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lpvguard.extras.problems import solve
from made import ROOT

GOLDEN = ROOT / "tests" / "golden" / "validation_problems.json"


def cases_file() -> Path:
    folder = Path(os.environ.get("LPVGUARD_CASES", ROOT / ".." / "shared" / "cases"))
    return folder if folder.is_file() else folder / "problems.json"


def public_problems():
    path = cases_file()
    if not path.is_file():
        pytest.skip(f"the public cases are not at {path}; set LPVGUARD_CASES")
    return [p for p in json.loads(path.read_text())["problems"] if p["kind"] not in ("mu", "hinf")]


def test_public_cases_within_their_tolerances():
    problems = public_problems()
    answers = solve.solve_problems(problems, jobs=1)
    missed = {p["id"]: solve.compare(p, a).misses for p, a in zip(problems, answers, strict=True)}
    assert {k: m for k, m in missed.items() if m} == {}


def test_golden_problems_with_independent_references():
    problems = json.loads(GOLDEN.read_text())["problems"]
    answers = solve.solve_problems(problems)
    assert {
        k["id"]: c.misses for k, a in zip(problems, answers, strict=True) if (c := solve.compare(k, a)).misses
    } == {}
    assert {p["kind"] for p in problems} >= {"multiplicative", "margin", "lft", "lft_margin"}


MULTIPLICATIVE = {
    "id": "m",
    "kind": "multiplicative",
    "E": [[0.3, 0.1], [0.2, 0.0]],
    "Z": [[1, 0], [0, 1]],
    "gamma_w": 0.3,
}
LFT = {
    "id": "l",
    "kind": "lft",
    "blocks": [{"type": "full", "rows": 1, "cols": 1}],
    "P11": [[[0.1, 0]]],
    "eta0": [[1, 0]],
    "P21": [[[1, 0]], [[0, 1]]],
    "e": [[0.3, 0], [0, 0.4]],
    "gamma_w": 0.2,
    "lambda_nu": [1.0],
}
ZOH = {"id": "z", "kind": "zoh", "model": "truck", "v": 15.0, "wheelbase": 4.5, "Ts": 0.01}


@pytest.mark.parametrize(
    "problem, words",
    [
        ({"id": 1, "kind": "cubic"}, ["kind", "cubic"]),
        ({"id": 1}, ["kind", "missing"]),
        (MULTIPLICATIVE | {"E": [[float("nan"), 0], [0, 0]]}, ["E", "finite"]),
        (MULTIPLICATIVE | {"Z": [[1, 0]]}, ["Z", "shape"]),
        (MULTIPLICATIVE | {"E": [[1, 0], [2]]}, ["E", "regular"]),
        (MULTIPLICATIVE | {"E": []}, ["E"]),
        (MULTIPLICATIVE | {"gamma_w": -1}, ["gamma_w", "negative"]),
        (MULTIPLICATIVE | {"gamma_w": None}, ["gamma_w", "missing"]),
        (MULTIPLICATIVE | {"gamma_w": "much"}, ["gamma_w"]),
        (
            MULTIPLICATIVE
            | {"kind": "multiplicative_tradeoff", "gamma_w": 1e-3, "lambda_nu": 1, "lambda_w": [1, 1]},
            ["B1"],
        ),
        (MULTIPLICATIVE | {"kind": "margin", "W_delta": 1, "W_w": [1, 0]}, ["W_w", "positive"]),
        (MULTIPLICATIVE | {"kind": "margin", "W_delta": 1, "W_w": [1]}, ["W_w", "shape"]),
        (MULTIPLICATIVE | {"kind": "margin", "W_delta": [1], "W_w": [1, 1]}, ["W_delta", "shape"]),
        (MULTIPLICATIVE | {"kind": "margin", "W_delta": [1, -1], "W_w": [1, 1]}, ["W_delta", "negative"]),
        (ZOH | {"v": 0.0}, ["v", "positive"]),
        (ZOH | {"v": 90.0}, ["v = 90", "unstable"]),
        (ZOH | {"model": "g80"}, ["model", "g80"]),
        (ZOH | {"kind": "frequency_response", "omega": 1e6}, ["omega"]),
        (LFT | {"blocks": [{"type": "round", "rows": 1, "cols": 1}]}, ["blocks[0]", "round"]),
        (LFT | {"blocks": [{"type": "repeated_real", "rows": 2, "cols": 1}]}, ["blocks[0]"]),
        (LFT | {"blocks": "full"}, ["blocks"]),
        (LFT | {"P11": [[[0.1, 0], [0, 0]]]}, ["P11", "shape"]),
        (LFT | {"P12": [[[0.1, 0]]]}, ["P12", "shape"]),
        (LFT | {"lambda_nu": [1.0, 1.0]}, ["lambda_nu"]),
        (LFT | {"gamma_w": 1e-6, "e": [[0.3, 0], [0.4, 0]]}, ["gamma_w", "B1"]),
        (LFT | {"P22": [[[0, 0]], [[0, 0]]], "e": [[0.3, 0], [0.4, 0]]}, ["e", "not in Im"]),
        (
            LFT | {"P11": [[[10, 0]]], "eta0": [[-19, 0]], "P21": [[[1, 0]]], "e": [[1, 0]], "gamma_w": 0.01},
            ["problem l", "nu", "cap"],
        ),
        (LFT | {"e": [[float("inf"), 0], [0, 0.4]]}, ["problem l", "e", "finite"]),
        ("not an object", ["object"]),
    ],
)
def test_bad_problems_get_an_error_that_names_the_place_and_stop_nothing(problem, words):
    answers = solve.solve_problems([problem, MULTIPLICATIVE])
    assert answers[0]["status"] == "error" and answers[1]["status"] == "ok"
    assert "internal" not in answers[0]["error"]
    for word in words:
        assert word in answers[0]["error"]


def larger(r, factor):
    """Another explanation of MULTIPLICATIVE: delta times ``factor``, and its own w."""
    E, Z = (np.array(MULTIPLICATIVE[k]) @ [1, 1j] for k in "EZ")
    return {"delta": factor * r.delta, "nu": abs(factor) * r.nu, "w": E - factor * r.delta * Z}


@pytest.mark.parametrize(
    "planted",
    [
        pytest.param(lambda r: {"nu": 0.999 * r.nu}, id="nu"),
        pytest.param(lambda r: {"delta": 0.999 * r.delta, "nu": 0.999 * r.nu}, id="nu and delta"),
        pytest.param(lambda r: {"w": 1.001 * r.w}, id="w"),
        pytest.param(lambda r: {"b1": 0.321 + 0 * r.b1}, id="B1"),
        pytest.param(lambda r: {"b1": 0.999 * r.b1}, id="smaller B1"),
        pytest.param(lambda r: larger(r, 1.0001), id="delta larger than it must be"),
        pytest.param(lambda r: larger(r, np.exp(1e-3j)), id="delta turned"),
    ],
)
def test_a_nu_that_its_delta_and_w_do_not_attain_is_an_error(planted, monkeypatch):
    right = solve.s1.solve
    monkeypatch.setattr(solve.s1, "solve", lambda *a: replace(right(*a), **planted(right(*a))))
    answer = solve.solve_problem(MULTIPLICATIVE | {"gamma_w": 0.32})
    assert answer["status"] == "error" and "nu: not proved" in answer["error"]


def complexes(rng, n):
    return rng.standard_normal(n) + 1j * rng.standard_normal(n)


def as_pairs(values):
    return np.stack([values.real, values.imag], axis=-1).tolist()


@pytest.mark.parametrize("decades", [0, 6])
def test_every_nu_and_margin_of_random_bins_is_proved(decades):
    rng = np.random.default_rng(decades)
    for k in range(300):
        n = 1 + k % 3
        E, Z = (complexes(rng, n) * 10.0 ** rng.uniform(-decades, decades, n) for _ in range(2))
        if k % 2:  # nearly explained by one delta
            E = Z * complexes(rng, 1) + 10.0 ** rng.uniform(-14, 0) * np.abs(E) * complexes(rng, n)
        gamma = float(solve.s1.solve(E, Z, 1.0).b1) * (1 + 10.0 ** rng.uniform(-14, 1))
        common, each = 10.0 ** rng.uniform(-decades, decades), 10.0 ** rng.uniform(-3, 3, n)
        bin_ = {
            "E": as_pairs(E),
            "Z": as_pairs(Z),
            "gamma_w": gamma,
            "W_w": (10.0 ** rng.uniform(-4, 0, n) * np.abs(E)).tolist(),
        }
        for problem in (
            {"kind": "multiplicative"},
            {"kind": "margin", "W_delta": common},
            {"kind": "margin", "W_delta": each.tolist()},
        ):
            answer = solve.solve_problem(bin_ | problem)
            assert answer["status"] == "ok", (k, answer)


@pytest.mark.parametrize("W_delta", [0.5, 0.0, [0.5, 0.2]])
def test_a_margin_that_is_not_the_least_is_an_error(W_delta, monkeypatch):
    problem = MULTIPLICATIVE | {"kind": "margin", "W_delta": W_delta, "W_w": [0.3, 0.2]}
    t = solve.solve_problem(problem)["t"]
    for factor in (1 - 1e-5, 1 + 1e-5, 1 + 1e-8):
        monkeypatch.setattr(solve.s1, "margin", lambda *_, factor=factor: factor * t)
        answer = solve.solve_problem(problem)
        assert (answer["status"] == "ok") == (factor == 1 + 1e-8)
        assert answer["status"] == "ok" or "t: not proved" in answer["error"]
    monkeypatch.setattr(solve.s1, "margin", lambda *_: 1e-5)
    nothing = problem | {"E": [[0.0, 0.0], [0.0, 0.0]]}
    assert "t: not proved" in solve.solve_problem(nothing)["error"]


def test_a_margin_takes_one_W_delta_or_one_an_output():
    common, each = (
        solve.solve_problem(MULTIPLICATIVE | {"kind": "margin", "W_delta": W, "W_w": [0.3, 0.2]})["t"]
        for W in (0.5, [0.5, 0.5])
    )
    E, Z = (np.abs(np.array(MULTIPLICATIVE[k]) @ [1, 1j]) for k in "EZ")
    assert each == pytest.approx((E / ([0.3, 0.2] + 0.5 * Z)).max()) and each <= common


def test_lft_answer_is_attained_and_holds_the_side_questions():
    a = solve.solve_problem(LFT)
    xi, w = np.array(a["xi"]) @ [1, 1j], np.array(a["w"]) @ [1, 1j]
    m = np.array(LFT["P21"]) @ [1, 1j]
    np.testing.assert_allclose(m @ xi + w, np.array(LFT["e"]) @ [1, 1j], atol=1e-12)
    assert np.linalg.norm(w) <= 0.2 * (1 + 1e-9)
    assert a["J_lower"] <= a["J_upper"] == pytest.approx(a["nu"][0] ** 2, rel=1e-9)
    assert a["nu_s_min"] == pytest.approx(a["nu"][0], rel=1e-4) and a["t_minmax"] == pytest.approx(
        a["nu"][0], rel=1e-4
    )


LFT_MARGIN = LFT | {"kind": "lft_margin", "W_delta": [0.2], "W_w": [0.2, 0.3]}


@pytest.mark.parametrize("problem", [LFT, LFT | {"lambda_w": [0.5, 0.5]}, LFT_MARGIN])
@pytest.mark.parametrize(
    "planted",
    [
        pytest.param(lambda s: {"upper": (1 - 1e-5) * s.upper}, id="upper too small"),
        pytest.param(lambda s: {"lower": (1 + 1e-5) * s.upper}, id="lower above upper"),
        pytest.param(lambda s: {"w": 2.0 * s.w}, id="larger w"),
        pytest.param(lambda s: {"nu": 1.01 * s.nu}, id="larger nu"),
    ],
)
def test_an_interval_that_its_explanation_does_not_attain_is_an_error(problem, planted, monkeypatch):
    from lpvguard.engine.validation import lft

    assert solve.solve_problem(problem)["status"] == "ok"
    name = "margin" if problem["kind"] == "lft_margin" else "optimum"
    right = getattr(lft, name)

    def wrong(*args, **options):
        solution = right(*args, **options)
        return replace(solution, **planted(solution))

    monkeypatch.setattr(lft, name, wrong)
    answer = solve.solve_problem(problem)
    assert answer["status"] == "error" and "_upper: not proved" in answer["error"]


@pytest.mark.parametrize("problem", [LFT, LFT | {"lambda_w": [0.5, 0.5]}, LFT_MARGIN])
def test_a_lower_bound_that_is_not_proved_anew_is_an_error(problem, monkeypatch):
    from lpvguard.engine.validation import lft

    stem = "t" if problem["kind"] == "lft_margin" else "J"
    right, search = solve.solve_problem(problem), lft.minimise
    monkeypatch.setattr(lft, "_one_block", lambda *_: None)
    for above, proved in ((0.999, True), (1.001, False)):

        def planted(*args, above=above, **options):
            interval = search(*args, **options)
            return replace(interval, lower=above * interval.upper)

        monkeypatch.setattr(lft, "minimise", planted)
        answer = solve.solve_problem(problem)
        if proved:
            assert 0.999 * right[f"{stem}_lower"] <= answer[f"{stem}_lower"] <= right[f"{stem}_upper"]
        else:
            assert "the lower bound: not proved" in answer["error"]


def test_lambda_w_p12_p22_and_a_missing_side_answer():
    rich = LFT | {
        "P12": [[[0.1, 0], [0, 0.1]]],
        "P22": [[[1, 0], [0, 0]], [[0.2, 0], [1, 0]]],
        "lambda_w": [0.5, 0.5],
    }
    a = solve.solve_problem(rich)
    assert a["status"] == "ok" and a["J_upper"] - a["J_lower"] <= 1e-3 * a["J_upper"]


def carry(problem, **answer):
    return problem | {"answer": answer, "rtol": 1e-6}


def test_an_answer_agrees_within_its_tolerance_and_not_beyond():
    base = solve.solve_problem(MULTIPLICATIVE)

    def ok(changes, ref):
        return solve.compare(carry(MULTIPLICATIVE, **ref), base | changes).ok

    assert ok({}, {"nu": base["nu"] * (1 + 9e-7)}) and not ok({}, {"nu": base["nu"] * (1 + 2e-6)})
    assert not ok({}, {"feasible": False}) and ok({}, {"feasible": True, "note": "ignored"})
    assert not ok({}, {"nu": None}) and ok({"nu": None}, {"nu": None}) and not ok({"nu": None}, {"nu": 0.1})
    size = np.linalg.norm(MULTIPLICATIVE["E"])
    assert ok({"B1": 0.9e-15 * size}, {"B1": 0.0}) and not ok({"B1": 2e-15 * size}, {"B1": 0.0})
    assert ok({"x": [1.0, 1e-7]}, {"x": [1.0, 0.0]}) and not ok({"x": [1.0, 1e-5]}, {"x": [1.0, 0.0]})
    assert not ok({"x": [1.0]}, {"x": [1.0, 0.0]}) and not ok({"x": "?"}, {"x": 1.0})
    assert not solve.compare(MULTIPLICATIVE, base).compared


@pytest.mark.parametrize(
    "low, up, fine",
    [
        (1.0, 1.0005, True),
        (1.0, 1.002, False),
        (0.99, 1.0, False),
        (1.0011, 1.0012, False),
        (0.9989, 0.9989, False),
    ],
)
def test_a_bracket_agrees_only_when_it_meets_the_reference_bracket_within_tolerance(low, up, fine):
    problem = carry(LFT, J_lower=0.9999, J_upper=1.0)
    problem["rtol"] = 1e-3
    assert solve.compare(problem, {"id": 1, "status": "ok", "J_lower": low, "J_upper": up}).ok is fine


def test_mu_bounds_may_not_cross_the_references_and_a_wanted_error_must_come():
    problem = carry({"id": 1, "kind": "mu"}, mu_upper=2.0, mu_lower=2.0)
    assert solve.compare(problem, {"id": 1, "status": "ok", "mu_upper": 1.9999, "mu_lower": 2.0001}).ok
    assert not solve.compare(problem, {"id": 1, "status": "ok", "mu_upper": 2.0001, "mu_lower": 2.0}).ok
    assert not solve.compare(problem, {"id": 1, "status": "error", "error": "no"}).ok
    wants_error = {"id": 1, "answer": {"status": "error"}}
    assert solve.compare(wants_error, {"id": 1, "status": "error", "error": "no"}).ok
    assert not solve.compare(wants_error, {"id": 1, "status": "ok"}).ok


def test_run_solve_exit_statuses_files_and_streams(tmp_path, capsys, monkeypatch):
    good = tmp_path / "good.json"
    good.write_text(
        json.dumps(
            {"schema": "lpvguard.problems/1", "problems": [MULTIPLICATIVE, {"id": "bad", "kind": "x"}]}
        )
    )
    out = tmp_path / "answers.json"
    assert solve.run_solve(good, out) == 0
    assert [a["status"] for a in json.loads(out.read_text())["answers"]] == ["ok", "error"]
    capsys.readouterr()
    plain = tmp_path / "list.json"
    plain.write_text(json.dumps([carry(MULTIPLICATIVE, nu=5.0)]))
    assert solve.run_solve(plain) == 1
    printed = capsys.readouterr()
    assert json.loads(printed.out)["answers"][0]["id"] == "m" and "miss: m: nu" in printed.err
    monkeypatch.setattr("sys.stdin", good.open())
    assert solve.run_solve("-", "-") == 0
    for text in ("{", '{"problems": 3}', "3"):
        plain.write_text(text)
        assert solve.run_solve(plain) == 2
    assert solve.run_solve(tmp_path / "nowhere.json") == 2
    assert solve.run_solve(good, good / "folder.json") == 2


def test_jobs_change_nothing():
    problems = [MULTIPLICATIVE | {"id": i, "gamma_w": 0.3 + 0.01 * i} for i in range(12)] + [LFT]
    assert solve.solve_problems(problems, jobs=2) == solve.solve_problems(problems, jobs=1)


def test_truck_response_matches_its_own_recursion():
    zoh = solve.solve_problem(ZOH)
    p = solve.solve_problem(ZOH | {"kind": "frequency_response", "omega": 3.0})
    a, b = np.array(zoh["Ad"]), np.array(zoh["Bd"])
    z = np.exp(1j * 3.0 * 0.01)
    expected = np.linalg.solve(z * np.eye(3) - a, b)[:2, 0]
    np.testing.assert_allclose(np.array(p["P"]) @ [1, 1j], expected, rtol=1e-10)
    dc = solve.solve_problem(ZOH | {"kind": "frequency_response", "omega": 0.0})
    assert dc["P"][0][0] == pytest.approx(-1.94 / 15.0, rel=2e-3), "r / dp = -1.94 / v per bar at DC"
