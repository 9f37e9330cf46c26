"""Drawn loops against what a design proves: none above it, and a claim that is too bold is refuted."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.engine.synthesis.varying import History
from lpvguard.extras.bench import _violations as violations
from lpvguard.extras.bench import proofs
from lpvguard.extras.bench._trials import Trial, Trials, _turned

SAMPLES = 300


@pytest.fixture
def designed(six_node_truck, few_truck_designed):
    """The truck on few drives, six nodes, and what its controller.json states."""
    return six_node_truck, few_truck_designed[1].read_text(encoding="utf-8")


def stated_by(designed) -> tuple:
    """The identification, and a document of one's own; a rate is what to draw, not what is proved."""
    document = json.loads(designed[1])
    document["certificates"]["moving_speed"]["stability"]["rate_mps2"] = 1.0
    return designed[0], document


def test_no_drawn_loop_is_above_what_is_proved_and_a_bolder_claim_is_refuted(designed):
    stored, document = stated_by(designed)
    names = [name for name, _, _ in Trials(stored, document, SAMPLES, 1).claims()]
    assert names[:2] == ["stability, moving speed", "mu, frozen speed"] and len(names) == 8
    rows = proofs.claim_rows(Trials(stored, document, SAMPLES, 1), 2 * len(names))
    assert [row.claim for row in rows] == names and {row.loops for row in rows} == {2}
    assert sum(row.above for row in rows) == 0
    assert all(0.05 < row.worst < 1 for row in rows)
    assert rows == proofs.claim_rows(Trials(stored, document, SAMPLES, 1), 2 * len(names))
    stated = document["certificates"]
    for row in stated["speeds"]:
        row["mu_upper"] *= 0.2
    for row in stated["robustness"]["nodes"]:
        row["worst_gain"] *= 0.2
    for row in stated["slow_delta"]["nodes"]:
        row["stability_level"] *= 0.3
    for row in stated["limits"]["rows"]:
        row["energy"] = row["energy"] and 10 * row["energy"]
    bold = {row.claim: row for row in proofs.claim_rows(Trials(stored, document, SAMPLES, 1), 2 * len(names))}
    refuted = [name for name, row in bold.items() if row.above]
    assert refuted == [names[1], names[2], names[4], names[5], names[6]]


@pytest.mark.long("20 s: optima of frozen speeds")
def test_the_largest_frozen_mu_stands_beside_the_largest_optimum_of_one_speed(designed, monkeypatch):
    """A controller of common poles is above the optimum, and not far; the optimum is that of no one's mu."""
    stored, document = stated_by(designed)
    said = document["certificates"]
    frozen = proofs.frozen_mu(stored, said)
    rows = [*said["speeds"], said["off_grid"]]
    assert frozen.mu == max(row["mu_upper"] for row in rows)
    assert frozen.v_mps in [row["v_mps"] for row in rows if row["mu_upper"] == frozen.mu]
    assert 0.8 * frozen.mu < frozen.optimum < frozen.mu
    low, high = stored.project.model.speed_min_mps, stored.project.model.speed_max_mps
    assert low <= frozen.optimum_v_mps <= high
    monkeypatch.setattr(proofs, "frozen_optimum", lambda _: (frozen.optimum, frozen.optimum_v_mps))
    said["off_grid"] |= {"mu_upper": 2 * frozen.mu, "v_mps": 13.0}
    assert proofs.frozen_mu(stored, said) == replace(frozen, mu=2 * frozen.mu, v_mps=13.0)


def test_performance_at_a_moving_speed_is_drawn_where_it_is_claimed(designed):
    stored, document = stated_by(designed)
    document["certificates"]["moving_speed"]["performance"] |= {"rate_mps2": 0.5, "level": 1.0}
    names = [name for name, _, _ in Trials(stored, document, SAMPLES, 2).claims()]
    assert names[1] == "performance, moving speed"
    trial = Trials(stored, document, SAMPLES, 2).moving_performance()
    assert 0.2 < trial.share < 1.5 and not trial.grows and "m/s" in trial.where
    document["certificates"]["moving_speed"]["performance"]["level"] = 2.0
    assert Trials(stored, document, SAMPLES, 2).moving_performance().share == trial.share / 2


def test_a_grown_loop_refutes_whatever_its_gain():
    assert Trial(0.5, True, "").above and Trial(1.1, False, "").above and not Trial(1.0, False, "").above
    row = proofs._row("x", 1.0, [Trial(0.9, False, "a"), Trial(0.5, True, "b"), Trial(0.3, False, "c")])
    assert (row.worst, row.where, row.above, row.loops) == (0.5, "b", 1, 3)


def test_signs_turn_to_what_the_derivative_favours():
    """z = s w with s = 1 or -1 beside z = 1: signs of both blocks add up where both are 1, or both -1."""
    signs = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    S = np.array([[[0.0, 0.0], [0.0, 2 + a + 0.5 * b]] for a, b in signs])
    w = np.ones((6, 1))
    assert (_turned(S, signs, np.array([3, 1, 2, 0, 3, 1]), 1, w) == 0).all()
    best = History(S, np.zeros(6, int), 1).gain(w, 3)[0]
    assert best == pytest.approx(3.5)


def test_the_tables_tell_what_was_found_and_what_was_not():
    claims = [
        proofs.ClaimRow("stability, moving speed", 2.8, 7, 0.719, "triangle", 0),
        proofs.ClaimRow("limits, gain", None, 6, 0.25, "8 m/s, kappa 2", 0),
    ]
    rates = [
        proofs.RateRow("stability", 2.8, None, 50.0, 50.0),
        proofs.RateRow("performance", None, 0.098, 0.08, 50.0),
        proofs.RateRow("performance", 0.06, 0.098, 0.08, 50.0),
    ]
    frozen = proofs.FrozenMu(0.84, 21.0, 0.8, 8.0)
    text = list(proofs.lines(claims, frozen, rates))
    assert "0 of 13 loops are above what is proved" in text
    assert "further than 30% from the bound: limits, gain" in text
    (line,) = [one for one in text if one.startswith("frozen speed")]
    assert "mu at most 0.8400, at 21 m/s" in line and "0.8000, at 8 m/s: mu is 5.0% above it" in line
    assert text[-3].endswith("no violation found up to 50") and "nothing" in text[-2]
    assert text[-2].endswith("0.00  below 0.5") and text[-1].endswith("0.61")
    numbers = proofs.as_dict(claims, frozen, rates)
    assert numbers["above"] == 0 and [row["ratio"] for row in numbers["rates"]] == [
        None,
        0.0,
        pytest.approx(0.06 / 0.098),
    ]


def test_both_ladders_are_climbed_and_stand_beside_what_is_proved(monkeypatch):
    stated = {"moving_speed": {"stability": {"rate_mps2": 2.8}, "performance": {"rate_mps2": None}}}
    trials = SimpleNamespace(
        stated=stated, stability="stability", performance="performance", samples=10, seed=1
    )

    class Searched:
        def __init__(self, loop, samples, seed):
            assert (loop, samples, seed) == ("performance", 10, 1)

        def at(self, rate, enough, before):
            """Begins with the Delta of the last violation."""
            assert enough == 1.0 and (before is None or before.gain > 1) and bool(before) == (rate < 50)
            return violations.Found(1.01 if rate > 0.3 else 0.99, (), np.zeros(0), np.zeros(0))

    monkeypatch.setattr(proofs, "Search", Searched)
    monkeypatch.setattr(proofs, "fastest_growth", lambda loop, rate, samples, seed: (0.9, np.zeros(0)))
    stability, performance = proofs.rate_rows(trials)
    assert (stability.proved_mps2, stability.violating_mps2, stability.ratio) == (2.8, None, None)
    assert performance.without_mps2 <= 0.3 < performance.violating_mps2 and performance.ratio == 0


@pytest.mark.parametrize(("changes", "what"), [({"scaling_log_parameters": []}, "without Delta"),
                                               ({"structure": "K_is"}, "K_is")])  # fmt: skip
def test_a_design_without_scalar_delta_is_refused(monkeypatch, tmp_path, changes, what):
    stated = {"structure": "K_o", "scaling_log_parameters": [[0.0]]} | changes
    monkeypatch.setattr(proofs.identify, "load", lambda folder: None)
    monkeypatch.setattr(
        proofs.controller_file, "require_designed_for", lambda stored, path: {"certificates": stated}
    )
    with pytest.raises(InputError, match=what):
        proofs.main([str(tmp_path), str(tmp_path)])


@pytest.mark.parametrize("option", ["--loops", "--samples"])
def test_fewer_than_one_is_refused(option, capsys):
    with pytest.raises(SystemExit) as stopped:
        proofs.main(["a", "b", option, "0"])
    assert stopped.value.code == 2 and "at least 1" in capsys.readouterr().err
