"""The table of the paper case by made-up rows: what is asked, what is told of each difference, and the scale
that would explain it."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lpvguard.engine.synthesis import cases
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.limits import Floor
from lpvguard.engine.synthesis.statespace import gain
from lpvguard.engine.synthesis.table import Cell
from lpvguard.vehicle import truck_model
from made import ROOT

CASE = ROOT / "tests" / "data" / "paper_case.toml"


def cell(structure: str = "K_i", A_t: float = 80.0, A_u: float = 1e-6, upper: float = 0.9) -> Cell:
    performance = SimpleNamespace(upper=upper, lower=0.8, bracket=SimpleNamespace(peak_frequency=0.1))
    result = SimpleNamespace(performance=performance, controller=gain(np.eye(2)), full_order=9)
    return Cell(structure, A_t, A_u, result, Floor(0.85, 0.86, 0.5), 1.5)


def row(
    *arguments, reference=None, reference_order=None, paper=None, paper_order=None, **more
) -> cases.TableRow:
    return cases.TableRow(
        **vars(cell(*arguments, **more)),
        reference=reference,
        reference_order=reference_order,
        paper=paper,
        paper_order=paper_order,
    )


@pytest.fixture
def case() -> dict:
    return cases.read_case(CASE)


def test_a_weight_that_is_missing_is_named(tmp_path: Path):
    text = CASE.read_text()
    for name in ("v", "W_ndelta"):
        path = tmp_path / "case.toml"
        path.write_text(re.sub(rf"^{name} .*$", "", text, flags=re.MULTILINE))
        with pytest.raises(SynthesisError, match=f"{name}: missing"):
            cases.read_case(path)


def test_the_vehicle_is_that_of_the_cases_speed_or_of_the_one_given(case):
    objective = case["objective"][0]
    for speed, used in ((None, 15.0), (22.0, 22.0)):
        plant = cases.case_plant(case, objective, "K_inf", speed=speed)
        A, _ = truck_model.continuous(used, 4.5)
        np.testing.assert_array_equal(plant.system.A[:3, :3], A)
        assert plant.system.dt == 0
    late = cases.case_plant(case, objective, "K_inf", dt=0.01, delay=2).system
    assert (
        late.dt == 0.01 and late.order == cases.case_plant(case, objective, "K_inf", dt=0.01).system.order + 2
    )


def test_every_structure_of_every_objective_is_a_row_beside_what_is_known_of_it(monkeypatch, case):
    del case["objective"][1]["mu_K_is"], case["objective"][1]["gamma_K_inf"], case["objective"][2]["paper"]
    asked, texts = [], []
    monkeypatch.setattr(cases, "read_case", lambda path: case)

    def made(plant, structure, A_t, A_u, **options):
        asked.append((plant.system.dt, structure, A_t, A_u, options))
        return cell(structure, A_t, A_u)

    monkeypatch.setattr(cases, "cell", made)
    rows = cases.paper_case("case.toml", progress=texts.append, steps=3)
    wanted = [
        (0.0, s, A_t, A_u, {"steps": 3})
        for A_t, A_u in ((95.0, 1e-6), (75.0, 1e-6), (95.0, 1e-7))
        for s in ("K_inf", "K_i", "K_is")
    ]
    assert asked == wanted
    assert [(str(text), text.done, text.total) for text in texts[::4]] == [
        ("K_inf, A_t 95, A_u 1e-06", 0, 9),
        ("K_i, A_t 75, A_u 1e-06", 4, 9),
        ("K_is, A_t 95, A_u 1e-07", 8, 9),
    ]
    assert [(r.reference, r.reference_order, r.paper, r.paper_order) for r in rows] == [
        (0.98399, None, 0.984, 23),
        (0.994, 19, 1.053, 30),
        (0.9986, 34, 0.986, 29),
        (None, None, 0.777, 23),
        (0.789, 19, 0.999, 30),
        (None, None, 0.777, 29),
        (0.98399, None, None, None),
        (0.994, 19, None, None),
        (0.9985, 34, None, None),
    ]
    cases.paper_case("case.toml", 0.005)
    assert {dt for dt, *_ in asked[9:]} == {0.005}
    case["objective"][0]["paper"]["orders"] = [23]
    with pytest.raises(ValueError, match="shorter"):
        cases.paper_case("case.toml")


def test_a_row_holds_its_reference_and_the_paper():
    full = row("K_is", 95.0, 1e-7, reference=0.99, reference_order=34, paper=0.985, paper_order=29)
    assert list(full.to_dict().items())[-4:] == [
        ("reference", 0.99),
        ("reference_order", 34),
        ("paper", 0.985),
        ("paper_order", 29),
    ]
    assert full.to_dict()["structure"] == "K_is"


LIMIT = "with this case's weights no controller goes below 0.85000 (at 0.5 rad/s)"


def sentence(one: cases.TableRow, monkeypatch, scale=None, rows=()) -> str:
    monkeypatch.setattr(cases, "_uncertainty_scale", lambda case, row, paper: scale)
    [text] = cases.differences({}, [one]) if not rows else [cases._difference({}, one, list(rows))]
    return text


def test_what_is_told_of_a_row_that_has_the_papers_digits(monkeypatch):
    assert sentence(row(), monkeypatch) == "The paper has no such row."
    for off in (0.0, 4.9e-4, -4.9e-4):
        text = sentence(row(paper=0.9 + off), monkeypatch)
        assert text == (
            "The level equals the paper's to three digits, because the calibrated noise and disturbance "
            f"limit the level at DC: {LIMIT}; order 0."
        )
    text = sentence(row("K_inf", paper=0.9, paper_order=23), monkeypatch)
    assert text == (
        "The level equals the paper's to three digits, because |W_nr(0)| and |W_wr(0)| were calibrated to "
        "this row: "
        f"{LIMIT}; order 0 instead of 23, because states are removed while the certified level does not rise "
        "(order before: 9)."
    )
    # Half a unit of the last digit, exactly.
    exact = sentence(row(paper=0.5, upper=0.5 + 2.0**-11), monkeypatch)
    assert exact.startswith("The level equals the paper's")
    monkeypatch.setattr(cases, "PAPER_DIGITS", 2.0**-11)
    assert sentence(row(paper=0.5, upper=0.5 + 2.0**-11), monkeypatch).startswith("The level equals")


def test_what_is_told_of_a_row_that_differs(monkeypatch):
    within = f"{LIMIT}, and this case's level is within 5.9e-02 of this limit"
    assert sentence(row(paper=1.0), monkeypatch) == f"10.0% below the paper's 1: {within}; order 0."
    assert sentence(row(paper=0.8), monkeypatch) == f"12.5% above the paper's 0.8: {within}; order 0."
    assert sentence(row(paper=1.0), monkeypatch, scale=2.345) == (
        f"10.0% below the paper's 1: {within}; this limit would be the paper's value if the uncertainty "
        "weights were 2.3 times as large, and the paper's weights are not published; order 0."
    )
    assert sentence(row(paper=0.3), monkeypatch).startswith("200.0% above")


@pytest.mark.parametrize(
    ("reference", "upper", "floor", "rounded"),
    [
        (None, 0.9, 0.85, False),
        (0.84, 0.9, 0.85, True),
        (0.9, 0.9, 0.95, False),
        (0.85, 0.9, 0.85, False),
        (0.95, 0.9, 0.97, False),
        (0.86, 0.9, 0.85, False),
    ],
)
def test_a_reference_below_the_limit_is_told_to_be_rounded(monkeypatch, reference, upper, floor, rounded):
    one = row(paper=1.0, reference=reference, upper=upper)
    one = cases.TableRow(**(vars(one) | {"floor": Floor(floor, floor, 0.5)}))
    said = f"; the reference's value {reference or 0:g} is rounded and lies below this limit"
    assert (said in sentence(one, monkeypatch)) == rounded


def test_a_level_that_moves_as_the_effort_does_is_told():
    one = row("K_i", 80.0, 1e-6, paper=1.0)
    moved = row("K_i", 60.0, 1e-6, paper=0.9, upper=0.72)
    assert cases._moves(one, 1.0, [one, moved]) == (
        "; from A_t 80, A_u 1e-06 to 60, 1e-06 the paper's level changes by -10.0%, this case's by -20.0% "
        "and A_t by -25.0%: the control effort limits the paper's level, and tracking at DC limits this "
        "case's level"
    )
    smaller = row("K_i", 60.0, 1e-7, paper=0.9)
    below = row("K_i", 80.0, 1e-6, paper=0.9)
    for other, moves in (
        (smaller, True),
        (below, True),  # a level that falls while A_t stays
        (row("K_i", 60.0, 2e-6, paper=0.9), False),
        (row("K_is", 60.0, 1e-6, paper=0.9), False),
        (row("K_i", 60.0, 1e-6), False),
        (row("K_i", 60.0, 1e-6, paper=0.79), False),  # 0.75 by tracking, and 0.04 beside it
        (row("K_i", 60.0, 1e-6, paper=0.81), True),
        (row("K_i", 60.0, 1e-6, paper=0.69), True),
        (row("K_i", 60.0, 1e-6, paper=0.71), False),
    ):
        assert bool(cases._moves(one, 1.0, [one, other])) == moves, other
    assert cases._moves(one, 0.9, [one]) == ""
    two = row("K_i", 80.0, 1e-6, paper=2.0)
    assert cases._moves(two, 2.0, [two, row("K_i", 60.0, 1e-6, paper=1.5)]) == ""


@pytest.mark.parametrize("wanted", [1.3e-3, 0.7, 1.0, 40.0, 990.0])
def test_the_scale_of_the_uncertainty_weights_that_explains_a_level_is_found(monkeypatch, wanted, case):
    one = row("K_i", 80.0, 1e-6, paper=1.0)
    asked = []
    monkeypatch.setattr(
        cases,
        "case_plant",
        lambda case, objective, structure: asked.append((case, objective, structure)) or case,
    )

    def exceeds(plant, omega, level):
        assert (omega, level) == (0.5, 1.1)
        ratios = {plant[k]["gain"] / case[k]["gain"] for k in ("W_delta_i", "W_delta_s")}
        assert max(ratios) == pytest.approx(min(ratios))
        return max(ratios) > wanted

    monkeypatch.setattr(cases, "floor_exceeds", exceeds)
    scale = cases._uncertainty_scale(case, one, 1.1)
    assert wanted * np.exp(-0.0101) <= scale <= wanted
    assert asked[0][1:] == ({"A_t": 80.0, "A_u": 1e-6}, "K_i")
    assert asked[0][0]["W_delta_i"]["poles"] == case["W_delta_i"]["poles"] and asked[0][0]["v"] == 15.0
    assert len(asked) == 2 + 11, "from 1e-3 to 1e3 in halves to a hundredth"
    ends = [weights["W_delta_s"]["gain"] / case["W_delta_s"]["gain"] for weights, *_ in asked[:2]]
    assert ends == pytest.approx([1e-3, 1e3], rel=1e-9)


@pytest.mark.parametrize("wanted", [0.9e-3, 1.1e3])
def test_beyond_a_thousand_times_no_scale_explains_a_level(monkeypatch, wanted, case):
    monkeypatch.setattr(cases, "case_plant", lambda case, objective, structure: case)
    monkeypatch.setattr(
        cases,
        "floor_exceeds",
        lambda plant, omega, level: plant["W_delta_i"]["gain"] / case["W_delta_i"]["gain"] > wanted,
    )
    assert cases._uncertainty_scale(case, row("K_is"), 1.1) is None
    monkeypatch.setattr(cases, "floor_exceeds", lambda plant, omega, level: plant["W_delta_i"]["gain"] > 0.03)
    assert cases._uncertainty_scale(case, row("K_is"), 1.1) is not None
    assert cases._uncertainty_scale(case, row("K_inf"), 1.1) is None
