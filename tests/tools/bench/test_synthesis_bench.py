"""The performance table: what it measures, and that a peer's claim is not taken for its result."""

import sys

import pytest

from lpvguard.engine.synthesis.cases import case_plant, read_case
from lpvguard.extras.bench import synthesis as bench
from lpvguard.extras.bench._peers import ask
from made import ROOT

CASE = ROOT / "tests" / "data" / "paper_case.toml"


@pytest.mark.unhurried
def test_the_table_measures_three_syntheses_at_the_papers_order():
    rows = bench.run(CASE, repeats=1)
    assert [(r.job, r.states) for r in rows] == [("H_inf", 23), ("K_i", 15), ("K_is", 18)]
    assert all(r.level < 1 and r.seconds > 0 and r.peer_seconds is None for r in rows)
    assert len(bench.table(rows).splitlines()) == 4
    assert bench.as_dicts(rows)[0]["ok"] == (rows[0].seconds <= bench.TARGET_S["H_inf"])


@pytest.mark.parametrize(
    "script, note",
    [
        ("raise SystemExit('solver panic')", "failed: solver panic"),
        (
            (
                "import json, sys; "
                'json.dump({"seconds": 1.0, "claimed": 0.5, "A": [[-1.0]], "B": [[0.0] * 3],'
                ' "C": [[0.0]], "D": [[0.0] * 3]}, open(sys.argv[2], "w"))'
            ),
            "claim not met",
        ),
        (
            (
                "import json, sys; "
                'json.dump({"seconds": 1.0, "claimed": 0.5, "A": [[1.0]], "B": [[0.0] * 3],'
                ' "C": [[0.0]], "D": [[0.0] * 3]}, open(sys.argv[2], "w"))'
            ),
            "its loop is unstable",
        ),
    ],
)
def test_a_peer_is_judged_by_the_loop_it_closes(script, note):
    case = read_case(CASE)
    plant = case_plant(case, case["objective"][0], "K_inf")
    answer = ask(sys.executable, script, bench.question(plant), 60.0)
    assert bench.judged(answer, plant)["note"] == note
