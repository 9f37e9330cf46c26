"""What a design's nodes have beside mu, and how fast Delta may vary: consistent with what else is known of
the same loops, and refused when altered."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from lpvguard import schemas
from lpvguard.base.errors import InputError
from lpvguard.base.parallel import workers
from lpvguard.control import design as stage
from lpvguard.control.limits import LimitRow, Limits, require_limits
from lpvguard.control.plants import vehicle_at
from lpvguard.control.robustness import (
    LOOSE,
    NodeRobustness,
    Robustness,
    compare,
)
from lpvguard.control.slow_delta import (
    NodeSlowness,
    Slowness,
    require_slowness,
    slowness,
)
from lpvguard.engine.synthesis.margins import margins, of_system
from lpvguard.engine.synthesis.statespace import gain, series
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
def found(result):
    return result.beside.robustness


def test_disk_margins_are_those_of_the_loop_broken_at_the_vehicles_input(stored, schedule, found):
    model = NominalModel(stored.project)
    for node in found.nodes:
        K = schedule.at(node.v_mps).select(slice(None), slice(1, None))
        loop = series(gain([[-1.0]], K.dt), series(K, vehicle_at(model, node.v_mps)))
        want = margins(*of_system(loop)).found
        for name in ("disk_S", "disk_T", "disk_balanced"):
            assert getattr(node, name) == pytest.approx(want[name].value, rel=1e-4)


def test_the_worst_delta_found_stays_within_the_bound_and_close_to_it(found):
    for node in found.nodes:
        assert node.worst_gain_found <= node.worst_gain * (1 + 1e-6)
        assert node.worst_gain <= 1.02 * node.worst_gain_found
        # mu below 1 bounds the worst-case gain, and 1 / mu of Delta's size at gain mu.
        assert node.mu_interval >= 1 or node.worst_gain <= node.mu_interval * (1 + 1e-3)


def test_neighbours_lie_within_the_nu_margin_and_midpoints_nearer(found):
    *inner, last = found.nodes
    assert last.nu_gap_next is None is last.nu_gap_midpoint
    for node in inner:
        assert 0 < node.nu_gap_midpoint < node.nu_gap_next < node.nu_margin <= 1


def test_workers_change_no_bit_of_what_they_share(stored, result):
    with workers(2) as run:
        assert slowness(stored, result.schedule, result.scaling, workers=run) == result.beside.slow_delta


@pytest.mark.long("35 s: a design")
def test_workers_change_no_byte_of_a_design(stored, result, tmp_path):
    with workers(2) as run:
        shared = stage.design(stored, moving_speed=False, workers=run)
    for name, one in (("alone", result), ("shared", shared)):
        stage.save(one, stored, tmp_path / name)
    alone, shared = ((tmp_path / name / "controller.json").read_bytes() for name in ("alone", "shared"))
    assert alone == shared


def test_an_altered_number_is_refused_by_name(found):
    stated = found.to_dict()
    compare(Path("controller.json"), stated, found)
    for name in asdict(found.nodes[0]):
        altered = json.loads(json.dumps(stated))
        altered["nodes"][0][name] *= 1 + (5e-3 if name in LOOSE else 5e-4)
        with pytest.raises(InputError, match=rf"robustness at .*{name}"):
            compare(Path("controller.json"), altered, found)
        altered["nodes"][0][name] = None
        with pytest.raises(InputError, match=name):
            compare(Path("controller.json"), altered, found)
    with pytest.raises(InputError, match="rows"):
        compare(Path("controller.json"), stated | {"nodes": stated["nodes"][1:]}, found)


def test_the_page_shows_every_number_of_a_node_and_a_dash_for_none(tmp_path):
    certificates = schemas.example("controller")["certificates"]
    node = NodeRobustness(8.0, 0.9931, None, 0.9842, 0.5437, 1.108, 0.7467, 0.2383, 0.0712, None)
    certificates["robustness"] = Robustness((node,), 2.0, (1.0, 1.0)).to_dict()
    (tmp_path / "controller.json").write_text(json.dumps({"certificates": certificates}))
    text = design_section(tmp_path)
    for shown in (
        "0.9931",
        "0.9842",
        "0.544",
        "1.11",
        "0.747",
        "0.2383",
        "0.0712",
        "0.456 to 2.19, 40.9°",
    ):
        assert f"<td>{shown}</td>" in text, shown
    row = next(line for line in text.split("<tr>") if "0.9931" in line)
    assert row.count("<td>–</td>") == 2
    certificates["robustness"] = None
    (tmp_path / "controller.json").write_text(json.dumps({"certificates": certificates}))
    assert "Beside μ" not in design_section(tmp_path)


def test_rates_are_proved_anew_and_larger_ones_are_refused(stored, result, schedule):
    found, path = result.beside.slow_delta, Path("controller.json")
    stated = json.loads(json.dumps(found.to_dict()))
    require_slowness(path, stated, stored, schedule, result.scaling)
    assert found.performance_rate > 0 and found.hidden_slow < found.hidden_fast
    for part, key in (
        ("performance", "performance_rate"),
        ("performance", "performance_level"),
    ):
        altered = json.loads(json.dumps(stated))
        altered["nodes"][-1][key] *= 1.3
        with pytest.raises(InputError, match=rf"slow_delta at 22 m/s, {part}"):
            require_slowness(path, altered, stored, schedule, result.scaling)
    with pytest.raises(InputError, match="hidden_slow_per_s"):
        altered = stated | {"hidden_slow_per_s": 0.5 * stated["hidden_slow_per_s"]}
        require_slowness(path, altered, stored, schedule, result.scaling)
    with pytest.raises(InputError, match="one row a node"):
        require_slowness(path, stated | {"nodes": stated["nodes"][1:]}, stored, schedule, result.scaling)


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


def test_what_is_proved_at_the_limits_is_proved_anew_and_more_is_refused(stored, result, schedule):
    found, path = result.beside.limits, Path("controller.json")
    stated = json.loads(json.dumps(found.to_dict()))
    require_limits(path, stated, stored, schedule, result.scaling)
    proved = [k for k, row in enumerate(stated["rows"]) if None not in (row["energy"], row["gain"])]
    assert found.largest_kappa >= 1 and found.energy() > 0 and proved
    for key, factor in (("gain", 0.8), ("energy", 1.01), ("stability_level", 0.99), ("kappa", 1.5)):
        altered = json.loads(json.dumps(stated))
        altered["rows"][proved[0]][key] *= factor
        with pytest.raises(InputError, match="limits at 8 m/s, kappa"):
            require_limits(path, altered, stored, schedule, result.scaling)


def test_the_page_and_the_summary_tell_how_far_the_limits_go(tmp_path):
    rows = (
        LimitRow(8.0, 1.0, 0.6, (0.0,), 1.0123, (0.0,), 2.34, (0.0,)),
        LimitRow(8.0, 2.0, 0.8, (0.0,), 19.4, (0.0,), 1.25, (0.0,)),
        LimitRow(8.0, None, 1.3, (0.0,), None, (), None, ()),
        LimitRow(22.0, 1.0, 0.7, (0.0,), None, (), 1.5, (0.0,)),
        LimitRow(22.0, 2.0, 0.9, (0.0,), None, (), 1.75, (0.0,)),
        LimitRow(22.0, None, 0.97, (0.0,), None, (), None, ()),
    )
    found = Limits(rows)
    assert found.largest_kappa == 2 and found.energy() == 1.75
    certificates = schemas.example("controller")["certificates"]
    certificates["limits"] = found.to_dict()
    (tmp_path / "controller.json").write_text(json.dumps({"certificates": certificates}))
    text = design_section(tmp_path)
    for shown in ("<td>19.4</td><td>1.25</td>", '<td>any</td><td><span class="no">not proved</span></td>'):
        assert shown in text.replace("\n", "")
