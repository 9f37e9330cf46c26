"""The performance table: its rows, its targets and the points it is measured on."""

import json
from inspect import signature

import numpy as np
import pytest

from lpvguard.cli.bench import bench as command
from lpvguard.engine.validation import s1
from lpvguard.extras.bench import _memory as memory
from lpvguard.extras.bench import names
from lpvguard.extras.bench import validation as bench
from made import ROOT


def test_rows_carry_figures_targets_and_the_certified_gap():
    rows = bench.run(experiments=2, bins=16, peers=False)
    assert [r.kernel for r in rows] == ["S1", "margin", "S2"]
    assert all(r.points == 32 and r.us_per_point > 0 and r.peer_us is None for r in rows)
    assert rows[2].worst_gap <= 1.01e-4
    assert {r.kernel: r.target_us for r in rows} == {"S1": 0.02, "margin": 0.1, "S2": 500.0}
    assert len(bench.table(rows).splitlines()) == 4
    assert json.loads(json.dumps(bench.as_dicts(rows)))[0]["ok"] in (True, False)


def test_points_repeat_with_their_seed_and_lie_between_b1_and_the_error():
    first, again = bench.truck_points(2, 8, seed=3), bench.truck_points(2, 8, seed=3)
    assert all(np.array_equal(first[k], again[k]) for k in first)
    b1 = s1.solve(first["e"], first["z"], 0.0).b1
    assert np.all(first["gamma_w"] >= b1) and np.all(first["gamma_w"] < np.linalg.norm(first["e"], axis=1))


@pytest.mark.unhurried
@pytest.mark.parametrize("fraction", memory.FRACTIONS)
def test_no_draw_exceeds_the_bound_that_its_memory_allows(fraction):
    t, bound = memory.draw(fraction, 1000, seed=5)
    assert (t <= bound).all()
    if fraction >= 0.1:  # a fiftieth of it would be refuted
        assert (t > 1 + 0.02 * (bound - 1)).any()


@pytest.mark.unhurried
def test_alarms_without_disturbance_come_with_memory():
    rows = memory.rows(1000, seed=1)
    largest, share = [r.largest for r in rows], [r.share_above_1 for r in rows]
    assert largest[0] <= 1 < largest[2] and largest == sorted(largest)
    assert share[0] == 0.0 and share == sorted(share)


@pytest.mark.slow("3 s: the bench of validation")
def test_the_table_of_memory_stands_in_the_log_as_the_command_prints_it(capsys):
    bench.main(["--memory"])
    printed = capsys.readouterr().out.strip()
    assert printed in (ROOT / "tools" / "DESIGN_LOG.md").read_text()


def test_the_help_names_every_bench():
    said = signature(command, eval_str=True).parameters["name"].annotation.__metadata__[0].help
    assert said.split(";")[0] == ", ".join(names()[:-1]) + f" or {names()[-1]}"
