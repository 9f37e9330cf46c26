"""What a design's nodes have beside mu, and how fast Delta may vary: consistent with what else is known of
the same loops, and refused when altered."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lpvguard import schemas
from lpvguard.base.errors import InputError
from lpvguard.base.parallel import workers
from lpvguard.control import design as stage
from lpvguard.control.limits import LimitRow, Limits, _require_row, require_limits
from lpvguard.control.plants import DesignProblem, vehicle_at
from lpvguard.control.robustness import LOOSE, UPPER, NodeRobustness, Robustness, _Asked, compare
from lpvguard.control.slow_delta import NodeSlowness, Slowness, require_slowness, slowness
from lpvguard.engine.synthesis.margins import margins, of_system
from lpvguard.engine.synthesis.mu import mu_interval
from lpvguard.engine.synthesis.statespace import gain, lft, series
from lpvguard.engine.synthesis.worst_gain import worst_gain
from lpvguard.report.sections.design import design_section
from lpvguard.vehicle.nominal import NominalModel


@pytest.fixture(scope="module")
def stored(six_node_truck):
    return six_node_truck


@pytest.fixture(scope="module")
def result(few_truck_designed):
    return few_truck_designed[0]


@pytest.fixture(scope="module")
def schedule(result):
    return result.schedule


@pytest.fixture(scope="module")
def robust(result):
    return result.further.robustness


@pytest.fixture(scope="module")
def problem(stored):
    return DesignProblem.from_identification(stored)


def test_disk_margins_are_those_of_the_loop_broken_at_the_vehicles_input(stored, schedule, robust):
    model = NominalModel(stored.project)
    for node in robust.nodes:
        K = schedule.at(node.v_mps).select(slice(None), slice(1, None))
        loop = series(gain([[-1.0]], K.dt), series(K, vehicle_at(model, node.v_mps)))
        want = margins(*of_system(loop)).by_name
        for name in ("disk_S", "disk_T", "disk_balanced"):
            assert getattr(node, name) == pytest.approx(want[name].value, rel=1e-4)


def test_the_worst_delta_found_stays_within_the_bound_and_close_to_it(robust):
    for node in robust.nodes:
        assert node.worst_gain_found <= node.worst_gain * (1 + 1e-6)
        assert node.worst_gain <= 1.02 * node.worst_gain_found
        # mu below 1 bounds the worst-case gain, and 1 / mu of Delta's size at gain mu.
        assert node.mu_interval >= 1 or node.worst_gain <= node.mu_interval * (1 + 1e-3)


def test_neighbours_lie_within_the_nu_margin_and_midpoints_nearer(robust):
    *inner, last = robust.nodes
    assert last.nu_gap_next is None is last.nu_gap_midpoint
    for node in inner:
        assert 0 < node.nu_gap_midpoint < node.nu_gap_next < node.nu_margin <= 1


def test_workers_change_no_bit_of_what_they_share(problem, result):
    with workers(2) as run:
        assert slowness(problem, result.schedule, result.scaling, workers=run) == result.further.slow_delta


@pytest.mark.long("35 s: a design")
def test_workers_change_no_byte_of_a_design(stored, result, tmp_path):
    with workers(2) as run:
        shared = stage.design(stored, moving_speed=False, workers=run)
    for name, one in (("alone", result), ("shared", shared)):
        stage.save(one, stored, tmp_path / name)
    alone, shared = ((tmp_path / name / "controller.json").read_bytes() for name in ("alone", "shared"))
    assert alone == shared


def test_an_altered_number_is_refused_by_name(robust):
    stated = robust.to_dict()
    compare(Path("controller.json"), stated, robust)
    for name in asdict(robust.nodes[0]):
        altered = json.loads(json.dumps(stated))
        for share in (5e-3 if name in LOOSE else 5e-5, -1e-6 if name in UPPER else -5e-3):
            altered["nodes"][0][name] = stated["nodes"][0][name] * (1 + share)
            with pytest.raises(InputError, match=rf"robustness at .*{name}"):
                compare(Path("controller.json"), altered, robust)
        altered["nodes"][0][name] = None
        with pytest.raises(InputError, match=name):
            compare(Path("controller.json"), altered, robust)
    slack = json.loads(json.dumps(stated))
    for name in UPPER:
        slack["nodes"][0][name] *= 1 + 1e-3
    compare(Path("controller.json"), slack, robust)
    with pytest.raises(InputError, match="rows"):
        compare(Path("controller.json"), stated | {"nodes": stated["nodes"][1:]}, robust)


@pytest.mark.parametrize(
    ("stated", "asked", "kept"),
    [
        (None, [0.0], 2.0),
        (2.0, [0.0], 2.0),
        (2.1, [0.0], 2.0),
        (1.999, [0.0, 1.999], 1.999),
        (1.9, [0.0], 2.0),
    ],
)
def test_an_upper_bound_is_proved_as_stated_where_it_is_just_below_what_is_found(stated, asked, kept):
    levels = []

    def bound(least):
        levels.append(least)
        return least or 2.0

    node = _Asked(8.0, None, None, None, (), {} if stated is None else {"worst_gain": stated})
    assert node.proved("worst_gain", bound) == kept and levels == asked
    assert node.proved("worst_gain", lambda least: 2.0) == 2.0, "one that is not proved is not kept"


@pytest.mark.parametrize(("share", "held"), [(1 - 2e-4, True), (1 - 1.99e-3, False)])
def test_a_bound_stated_a_little_lower_is_proved_as_it_is_and_a_false_one_is_refused(
    stored, schedule, robust, share, held
):
    """Planted: bounds within the tolerance of the search, which another machine may have found, or not."""
    node = robust.nodes[0]
    problem = DesignProblem.from_identification(stored)
    plant, vehicle = problem.plant(node.v_mps), vehicle_at(problem.model, node.v_mps)
    loop, last = lft(plant.system, schedule.at(node.v_mps)), np.pi / plant.system.dt
    blocks, performance = plant.blocks, plant.performance_block
    bounds = {
        "mu_interval": lambda least: mu_interval(loop, [*blocks, performance], 0.0, last, least=least).upper,
        "worst_gain": lambda least: worst_gain(loop, blocks, performance, 0.0, last, least=least).upper,
    }
    stated = {name: share * getattr(node, name) for name in bounds}
    asked = _Asked(node.v_mps, plant, schedule.at(node.v_mps), vehicle, (), stated)
    proved = {name: asked.proved(name, bound) for name, bound in bounds.items()}
    assert (proved == stated) is held
    rows = Robustness((node,), 1.0, (1.0, 1.0)), replace(robust, nodes=(replace(node, **proved),))
    altered = rows[0].to_dict()
    altered["nodes"][0] |= stated
    if held:
        compare(Path("controller.json"), altered, rows[1])
    else:
        with pytest.raises(InputError, match=r"robustness at 8 m/s, (mu_interval|worst_gain)"):
            compare(Path("controller.json"), altered, rows[1])


def test_the_page_shows_every_number_of_a_node_and_a_dash_for_none(tmp_path):
    certificates = schemas.example("controller")["certificates"]
    node = NodeRobustness(8.0, 0.9931, None, 0.9842, 0.5437, 1.108, 0.7467, 0.2383, 0.0712, None)
    certificates["robustness"] = Robustness((node,), 2.0, (1.0, 1.0)).to_dict()
    (tmp_path / "controller.json").write_text(json.dumps({"certificates": certificates}))
    text = design_section(tmp_path)
    for shown in ("0.9931", "0.9842", "0.544", "1.11", "0.747", "0.2383", "0.0712", "0.456 to 2.19, 40.9°"):
        assert f"<td>{shown}</td>" in text, shown
    row = next(line for line in text.split("<tr>") if "0.9931" in line)
    assert row.count("<td>–</td>") == 2
    certificates["robustness"] = None
    (tmp_path / "controller.json").write_text(json.dumps({"certificates": certificates}))
    assert "Beside μ" not in design_section(tmp_path)


def test_rates_are_proved_anew_and_larger_ones_are_refused(problem, result, schedule):
    slowness, path = result.further.slow_delta, Path("controller.json")
    stated = json.loads(json.dumps(slowness.to_dict()))
    require_slowness(path, stated, problem, schedule, result.scaling)
    assert slowness.performance_rate > 0 and slowness.hidden_slow < slowness.hidden_fast
    for part, key in (("performance", "performance_rate"), ("performance", "performance_level")):
        altered = json.loads(json.dumps(stated))
        altered["nodes"][-1][key] *= 1.3
        with pytest.raises(InputError, match=rf"slow_delta at 22 m/s, {part}"):
            require_slowness(path, altered, problem, schedule, result.scaling)
    with pytest.raises(InputError, match="hidden_slow_per_s"):
        altered = stated | {"hidden_slow_per_s": 0.5 * stated["hidden_slow_per_s"]}
        require_slowness(path, altered, problem, schedule, result.scaling)
    with pytest.raises(InputError, match="one row for each node"):
        require_slowness(path, stated | {"nodes": stated["nodes"][1:]}, problem, schedule, result.scaling)


def test_the_page_says_which_hidden_rates_are_covered(tmp_path):
    certificates = schemas.example("controller")["certificates"]
    nodes = (
        NodeSlowness(8.0, 0.0436, (0.0, 0.0), 0.999, None, (0.0, 0.0), 0.6066),
        NodeSlowness(9.0, 0.0512, (0.0, 0.0), 0.999, 3.25, (0.0, 0.0), 0.9871),
    )
    certificates["slow_delta"] = Slowness(nodes, 0.0333, 1.05).to_dict()
    (tmp_path / "controller.json").write_text(json.dumps({"certificates": certificates}))
    text = design_section(tmp_path)
    assert (
        '<span class="yes">above 0.0333/s</span>' in text and '<span class="no">below 1.05/s</span>' in text
    )
    assert "stable up to 3.25/s" in text and "<td>any</td><td>0.6066</td>" in text


def test_what_is_proved_at_the_limits_is_proved_anew_and_more_is_refused(problem, result, schedule):
    at_limits, path = result.further.limits, Path("controller.json")
    stated = json.loads(json.dumps(at_limits.to_dict()))
    require_limits(path, stated, problem, schedule, result.scaling)
    proved = [k for k, row in enumerate(stated["rows"]) if None not in (row["energy"], row["gain"])]
    assert at_limits.largest_kappa >= 1 and at_limits.energy() > 0 and proved
    for key, factor in (("gain", 0.8), ("energy", 1.0001), ("stability_level", 0.99), ("kappa", 1.5)):
        altered = json.loads(json.dumps(stated))
        altered["rows"][proved[0]][key] *= factor
        with pytest.raises(InputError, match="limits at 8 m/s, kappa"):
            require_limits(path, altered, problem, schedule, result.scaling)


@pytest.mark.parametrize(("anew", "held"), [(1.00004, False), (0.99996, True)])
def test_a_level_below_one_is_stated_only_where_it_is_below_one_anew(anew, held):
    class Loop:
        stable, ones = True, np.ones(1)

        def stability(self):
            return SimpleNamespace(proved=lambda *_: anew)

    row = {"v_mps": 8.0, "kappa": 1.0, "stability_level": 0.99999, "gain": None, "energy": None}
    asked = row | {"stability_constants": []}, (8.0, Loop())
    if held:
        _require_row(Path("controller.json"), None, 0.1, asked)
    else:
        with pytest.raises(InputError, match=r"stability_level: 1\.00004 when proved again"):
            _require_row(Path("controller.json"), None, 0.1, asked)


def test_the_page_and_the_summary_tell_how_far_the_limits_go(tmp_path):
    rows = (
        LimitRow(8.0, 1.0, 0.6, (0.0,), 1.0123, (0.0,), 2.34, (0.0,)),
        LimitRow(8.0, 2.0, 0.8, (0.0,), 19.4, (0.0,), 1.25, (0.0,)),
        LimitRow(8.0, None, 1.3, (0.0,), None, (), None, ()),
        LimitRow(22.0, 1.0, 0.7, (0.0,), None, (), 1.5, (0.0,)),
        LimitRow(22.0, 2.0, 0.9, (0.0,), None, (), 1.75, (0.0,)),
        LimitRow(22.0, None, 0.97, (0.0,), None, (), None, ()),
    )
    stated_limits = Limits(rows)
    assert stated_limits.largest_kappa == 2 and stated_limits.energy() == 1.75
    certificates = schemas.example("controller")["certificates"]
    certificates["limits"] = stated_limits.to_dict()
    (tmp_path / "controller.json").write_text(json.dumps({"certificates": certificates}))
    text = design_section(tmp_path)
    for shown in ("<td>19.4</td><td>1.25</td>", '<td>any</td><td><span class="no">not proved</span></td>'):
        assert shown in text.replace("\n", "")
