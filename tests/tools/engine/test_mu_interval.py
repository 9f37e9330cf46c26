"""The bound of mu on intervals: above every point of a fine grid, close to the largest, and no further."""

import numpy as np
import pytest

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.cases import case_plant, read_case
from lpvguard.engine.synthesis.dk import dk_synthesis
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.mu import mu_bounds, mu_interval
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import StateSpace, lft, to_discrete
from lpvguard.extras.problems.solve import solve_problem
from made import ROOT

FULL = [Block("full", 1, 1), Block("full", 2, 2)]
REAL = [Block("repeated_real", 2, 2), Block("full", 1, 1)]
COMPLEX = [Block("repeated_complex", 2, 2), Block("full", 1, 1)]


def loop_of(seed: int, damping: float = 0.3) -> StateSpace:
    random = np.random.default_rng(seed)
    A = random.standard_normal((5, 5))
    A -= (np.linalg.eigvals(A).real.max() + damping) * np.eye(5)
    B, C = random.standard_normal((5, 3)), random.standard_normal((3, 5))
    return StateSpace(A, B, C, 0.1 * random.standard_normal((3, 3)))


def largest_on_grid(loop, blocks, omega) -> float:
    return max(mu_bounds(M, blocks, 1e-6).upper for M in loop.response(omega))


OF_REAL = pytest.mark.long("10 s: with a real block each loop takes ten times as long")


@pytest.mark.unhurried
@pytest.mark.parametrize(
    ("blocks", "seed"),
    [
        pytest.param(blocks, seed, id=f"{name}-{seed}", marks=marks)
        for name, blocks, marks in (("full", FULL, ()), ("real", REAL, OF_REAL), ("complex", COMPLEX, ()))
        for seed in (1, 2, 3)
    ],
)
def test_it_is_above_every_point_and_close_to_the_largest(blocks, seed):
    loop = loop_of(seed)
    interval = mu_interval(loop, blocks, 0.0, np.inf)
    fine = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 40), interval.omega * np.linspace(0.9, 1.1, 7)])
    assert largest_on_grid(loop, blocks, fine) <= interval.upper * (1 + 1e-9)
    at_peak = mu_bounds(loop.response([interval.omega])[0], blocks, 1e-6).upper
    assert interval.upper <= at_peak * 1.005


def test_of_one_full_block_it_is_the_norm():
    for loop in (loop_of(4), to_discrete(loop_of(4), 0.1)):
        last = np.pi / loop.dt if loop.dt else np.inf
        interval, norm = mu_interval(loop, [Block("full", 3, 3)], 0.0, last), hinf_norm(loop)
        assert norm.lower * (1 - 1e-9) <= interval.upper <= norm.upper * 1.0025


@pytest.mark.parametrize("blocks", [FULL, REAL])
def test_a_level_that_is_asked_for_is_proved_and_a_lower_one_is_not(blocks):
    loop = loop_of(1)
    interval = mu_interval(loop, blocks, 0.0, np.inf)
    at_peak = mu_bounds(loop.response([interval.omega])[0], blocks, 1e-6).upper
    for share in (1.0015, 1.3):
        upper = mu_interval(loop, blocks, 0.0, np.inf, least=share * at_peak).upper
        assert share * at_peak <= upper <= max(share * at_peak, 1.0021 * interval.lower)
    assert mu_interval(loop, blocks, 0.0, np.inf, least=0.999 * at_peak).upper > at_peak


def test_a_peak_outside_of_the_interval_does_not_count():
    loop = StateSpace([[-0.01, 1.0], [-1.0, -0.01]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    block = [Block("full", 1, 1)]
    assert mu_interval(loop, block, 0.0, np.inf).upper > 49
    beyond = mu_interval(loop, block, 2.0, np.inf)
    at_its_end = np.linalg.norm(loop.response([2.0])[0])
    assert at_its_end <= beyond.upper <= 1.01 * at_its_end


def test_a_peak_narrower_than_any_grid_is_found():
    loop = StateSpace([[-1e-6, 1.0], [-1.0, -1e-6]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    interval = mu_interval(loop, [Block("full", 1, 1)], 0.5, 3.0)
    assert 0.999 * 5e5 < interval.upper < 1.005 * 5e5 and interval.omega == pytest.approx(1.0, abs=1e-6)


@pytest.mark.slow("10 s: two syntheses of the paper's case")
@pytest.mark.parametrize("structure", ["K_i", "K_is"])
def test_the_papers_controllers_keep_their_mu_between_frequencies(structure):
    plant = case_plant(
        read_case(ROOT / "tests" / "data" / "paper_case.toml"), {"A_t": 95.0, "A_u": 1e-6}, structure
    )
    result = dk_synthesis(plant)
    loop = lft(plant.system, result.controller)
    blocks = [*plant.blocks, plant.performance_block]
    interval = mu_interval(loop, blocks, 0.0, np.inf)
    assert interval.upper <= result.performance.upper * 1.003
    assert interval.upper <= 1.005 * largest_on_grid(loop, blocks, [interval.omega])


def problem(**changes) -> dict:
    loop = loop_of(1)
    parts = {name: getattr(loop, name).tolist() for name in "ABCD"}
    blocks = [{"type": b.kind, "rows": b.cols, "cols": b.rows} for b in FULL]
    return {"id": 1, "kind": "mu_interval", **parts, "blocks": blocks, **changes}


def test_a_problem_is_answered():
    answer = solve_problem(problem())
    assert answer["status"] == "ok" and answer["mu_upper"] == mu_interval(loop_of(1), FULL, 0.0, np.inf).upper
    part = solve_problem(problem(low=3.0, high=4.0))
    assert part["mu_upper"] < answer["mu_upper"] and 3 <= part["omega"] <= 4


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"A": (-loop_of(1).A).tolist()}, "loop"),
        ({"blocks": [{"type": "full", "rows": 1, "cols": 1}]}, "loop"),
        ({"low": 2.0, "high": 1.0}, "low, high"),
        ({"low": -1.0}, "low, high"),
        ({"A": (0.1 * np.eye(5)).tolist(), "dt": 0.1, "high": 40.0}, "low, high"),
        ({"low": "x"}, "low"),
        ({"blocks": None}, "blocks"),
    ],
)
def test_a_bad_problem_is_refused_with_its_field(changes, where):
    answer = solve_problem(problem(**changes))
    assert answer["status"] == "error" and where in answer["error"]


def test_more_cells_than_allowed_are_an_error(monkeypatch):
    monkeypatch.setattr("lpvguard.engine.synthesis.frequency_cells.MOST_CELLS", 2)
    with pytest.raises(SynthesisError, match="cells do not cover"):
        mu_interval(loop_of(1), FULL, 0.0, np.inf)
