"""Fig. 1 for any number of inputs and outputs: a car with one input, and one with two, from drives to
certificates."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from any_vehicle import STEERING, WITH_MOMENT, designable, identified_into
from lpvguard.base.errors import InputError
from lpvguard.control import design as stage
from lpvguard.control.controller_export import export_chosen
from lpvguard.control.frozen import FrozenProblem
from lpvguard.control.moving_speed import moving_certificates
from lpvguard.control.plants import DesignProblem
from lpvguard.control.stored_frames import StoredFrames
from lpvguard.engine.synthesis.statespace import lft
from lpvguard.identify import identification
from made import run_example

VEHICLES = [
    pytest.param(
        ("g80", STEERING),
        id="1x1",
        marks=pytest.mark.long("60 s: a second vehicle, from drives to certificates"),
    ),
    pytest.param(("vectoring", WITH_MOMENT), id="2x1"),
]


@pytest.fixture(scope="module", params=VEHICLES)
def stored(request, made) -> identification.StoredIdentification:
    name, settings = request.param
    project = designable(name, **settings)
    return identification.load(
        made.folder(f"{name}_for_design", lambda folder: identified_into(folder, project))
    )


@pytest.fixture(scope="module")
def designed(stored, tmp_path_factory) -> tuple[stage.Design, Path]:
    """A design for frozen speeds and its folder."""
    result = stage.design(stored, moving_speed=False)
    folder = tmp_path_factory.mktemp("design") / "design"
    stage.save(result, stored, folder)
    return result, folder


def test_the_car_is_certified_and_the_certificates_are_proved_anew(stored, designed, tmp_path):
    result, folder = designed
    assert result.worst < 1
    stage.verify(folder / "controller.json", stored)
    document = json.loads((folder / "controller.json").read_text())
    n_u = stored.project.n_u
    assert np.shape(document["B"])[1:] == (n_u, len(document["a"]), 2)
    assert np.shape(document["u_max"]) == (4, n_u)
    beside = document["certificates"]
    assert all(row["stability_level"] < 1 for row in beside["limits"]["rows"] if row["kappa"] == 1.0)
    assert all(node["disk_balanced"] > 0.3 for node in beside["robustness"]["nodes"])
    assert document["certificates"]["slow_delta"]["performance_rate_per_s"] > 0


@pytest.mark.long("90 s: a search at a moving speed")
def test_stability_is_proved_while_the_speed_moves_and_performance_where_a_storage_function_is_found(
    stored, designed, tmp_path
):
    result, _ = designed
    problem = DesignProblem.from_identification(stored)
    moving = moving_certificates(problem, result.schedule, result.scaling)
    assert moving["stability"].lpv.rate >= 2.0
    assert (moving["performance"] is not None) == (stored.project.n_u == 2)
    stage.save(replace(result, moving=moving), stored, tmp_path / "design")
    stage.verify(tmp_path / "design" / "controller.json", stored)


def test_members_of_the_set_keep_the_certified_gain(stored, designed):
    """Constant errors of the vehicle's response within W_delta, of both signs, at a speed between nodes."""
    result, _ = designed
    v = 10.3
    plant, K = DesignProblem.from_identification(stored).plant(v), result.schedule.at(v)
    loop = lft(plant.system, K)
    n = plant.n_delta_in
    M = loop.response(np.geomspace(1e-3, np.pi / stored.project.Ts_s * 0.999, 300))
    for sign in (-1.0, 1.0):
        delta = sign * np.eye(n)
        fed_back = np.linalg.solve(np.eye(n) - M[:, :n, :n] @ delta, M[:, :n, n:])
        closed = M[:, n:, n:] + M[:, n:, :n] @ delta @ fed_back
        assert np.linalg.norm(closed, 2, axis=(1, 2)).max() <= max(1.0, result.worst)


def test_the_yaw_rate_of_the_nominal_car_follows_the_command(stored, designed):
    result, _ = designed
    v = 10.3
    loop = lft(DesignProblem.from_identification(stored).plant(v).system, result.schedule.at(v))
    follows = loop.response([0.05])[0, loop.outputs.index("z_t"), loop.inputs.index("r_c")]
    W = DesignProblem.from_identification(stored).weights
    command = abs((W.W_t.response([0.05]) * W.W_R.response([0.05]) * W.W_C.response([0.05]))[0, 0, 0])
    assert abs(follows) < 0.1 * command


def test_without_a_design_at_identification_the_command_is_missing(stored):
    bare = replace(stored, fitted=replace(stored.fitted, W_C=[]))
    with pytest.raises(InputError, match=r"W_C: missing, because the identification had no \[design\] table"):
        _ = DesignProblem.from_identification(bare).weights


def test_table_ii_is_for_the_papers_vehicle(stored):
    with pytest.raises(InputError, match="one input and two outputs"):
        FrozenProblem(stored, StoredFrames(stored))


def test_a_demand_that_is_not_met_is_told_with_the_weight_that_limits(stored):
    """A vehicle ten times as uncertain and disturbed as identified: one of both limits."""
    settings = stored.project.design.model_copy(update={"nodes": 2})
    uncertain = replace(stored.fitted, inflation=10.0)
    project = stored.project.model_copy(update={"design": settings})
    asked = replace(stored, project=project, fitted=uncertain)
    result = stage.design(asked, moving_speed=False)
    said = stage.limit_sentence(asked, result)
    assert result.worst > 1
    assert f"the least worst mu found is {result.worst:.3f}" in said
    limits = "disturbance (W_w)" if stored.project.n_u == 1 else "uncertainty (W_delta)"
    assert limits in said and "no controller goes below" in said


def test_further_inputs_are_weighed_by_the_rate_limits(stored):
    rates = np.array(stored.project.design.input_rate_max_per_s)
    sizes = [abs(W.response([3.0])[0, 0, 0]) for W in DesignProblem.from_identification(stored).weights.W_u]
    np.testing.assert_allclose(sizes, sizes[0] * rates[0] / rates)


def test_the_compiled_controller_keeps_the_gain_with_members_of_the_set(stored, designed, tmp_path, lpvguard):
    """The generated folder has no bus, since no message of ours carries the demand."""
    _, design = designed
    vehicle = tmp_path / "vehicle"
    export_chosen(stored, vehicle, design)
    assert (vehicle / "lpvguard_control.c").is_file() and not (vehicle / "lpvguard_bus.c").exists()
    arguments = ("sim", "--members", stored.folder, "--coefficients", vehicle, "--draws", 4)
    done = lpvguard(*arguments, "--design", design, "--json", "-")
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)
    assert len(rows) == 4 and all(row["kept"] and 0 < row["worst"] <= row["bound"] for row in rows)
    refused = lpvguard(*arguments)
    assert refused.returncode == 2 and "--design, --coefficients and no scenario" in refused.stderr
    refused = lpvguard("sim")
    assert refused.returncode == 2 and "SCENARIOS: missing" in refused.stderr


@pytest.mark.long("30 s: a design of its own")
def test_the_example_prints_mu_over_speed(stored):
    said = run_example("mu_over_speed.py", stored.folder)
    assert len(said.splitlines()) == 7 and "<= mu <=" in said
