"""The input limit over speed: the rule, and the line between nodes that never lies above it."""

from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from lpvguard.control.input_limit import ROOM, input_limit, rule
from lpvguard.core.scheduled import Scheduled
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project
from made import ROOT

TRUCK = resources.files("lpvguard.vehicle").joinpath("shipped", "truck.toml").read_text()
GAINS = {
    "constant": "p6",  # with Table I the steady lateral acceleration of a bar is the same at every speed
    "rising": "p6*v/15",
    "falling": "p6*15/v",
    "steep": "p6*(v/15)**4",
    "hump": "p6*(0.2 + (v - 15)**2/40)",
    "changing its sign": "p6*(v - 14.1)/10",
}
"""What stands for p6 in the model: how the steady lateral acceleration of a bar moves over speed."""


def vehicle(tmp_path: Path, gain: str, **settings) -> tuple[NominalModel, object]:
    """The truck with another gain over speed and other settings of its design."""
    path = tmp_path / "truck.toml"
    assert TRUCK.count('"p6"') == 1
    path.write_text(TRUCK.replace('"p6"', f'"{gain}"'))
    project = load_project(path)
    return NominalModel(project), project.design.model_copy(update=settings)


def scheduled(speeds: np.ndarray, u_max: np.ndarray) -> Scheduled:
    n_u = u_max.shape[1]
    empty = np.zeros((len(speeds), n_u, 1, 3))
    return Scheduled(0.01, speeds, np.array([-1.0]), empty, empty[..., :n_u], u_max)


def steady_acceleration(model: NominalModel, v: float, u: np.ndarray) -> float:
    """v |yaw rate| [m/s2] in the end, from a simulation: no DC gain in it."""
    A, B = (m[0] for m in model.matrices(np.array([v])))
    x, step = np.zeros(len(A)), 0.01
    inverse = np.linalg.inv(np.eye(len(A)) - step * A)
    for _ in range(20000):
        x = inverse @ (x + step * B @ u)
    return abs(v * (model.C @ x)[0])


@pytest.mark.parametrize("gain", GAINS.values(), ids=GAINS)
@pytest.mark.parametrize("nodes", [2, 8])
def test_the_interpolated_limit_is_nowhere_above_the_rule(tmp_path, gain, nodes):
    model, settings = vehicle(tmp_path, gain)
    speeds = np.linspace(*model.speed_range, nodes)
    limit = scheduled(speeds, input_limit(model, settings, speeds))
    v = np.random.default_rng(nodes).uniform(*model.speed_range, 1000)
    allowed = rule(model, settings, v)[:, 0]
    limits = np.array([limit.limit(x)[0] for x in v])  # as the core interpolates it, float32 coefficients
    assert (limits <= allowed).all() and (limits > 0).all()
    for x in [*speeds, model.speed_range[0] - 5.0, model.speed_range[1] + 5.0]:
        inside = np.clip(x, *model.speed_range)
        assert limit.limit(x)[0] <= rule(model, settings, np.array([inside]))[0, 0]


@pytest.mark.parametrize(("gain", "lost"), [("p6", ROOM), ("p6*v/15", 0.016), ("p6*15/v", ROOM)])
def test_with_8_nodes_little_of_the_rule_is_lost(tmp_path, gain, lost):
    """A line through the rule's own values lies above it where the rule is convex; lowering it costs this."""
    model, settings = vehicle(tmp_path, gain)
    settings = settings.model_copy(update={"input_max": [60.0]})
    speeds = np.linspace(*model.speed_range, 8)
    v = np.linspace(*model.speed_range, 501)
    ratio = np.interp(v, speeds, input_limit(model, settings, speeds)[:, 0]) / rule(model, settings, v)[:, 0]
    assert 1 - 2 * lost <= ratio.min() and 1 - 2 * ROOM <= ratio.max() <= 1 - ROOM / 2


@pytest.mark.parametrize("v", [8.0, 13.3, 22.0])
def test_held_at_the_rule_the_model_turns_at_the_acceleration_asked_for(tmp_path, v):
    model, settings = vehicle(tmp_path, GAINS["rising"], input_max=[60.0], lateral_acceleration_max_mps2=3.0)
    assert steady_acceleration(model, v, rule(model, settings, np.array([v]))[0]) == pytest.approx(3.0)


def test_where_the_actuator_is_the_limit_its_number_stays_as_given(tmp_path):
    model, settings = vehicle(tmp_path, GAINS["rising"], input_max=[2.0])
    speeds = np.linspace(*model.speed_range, 8)
    limit = input_limit(model, settings, speeds)[:, 0]
    # The first node that the rule lowers; the node before it is an end of a cell that the rule enters.
    first = int(np.flatnonzero(rule(model, settings, speeds)[:, 0] < 2.0)[0])
    np.testing.assert_array_equal(limit[: first - 1], 2.0)
    assert first > 1 and (limit[first - 1 :] < 2.0).all() and (np.diff(limit[first - 1 :]) < 0).all()


def test_without_a_lateral_acceleration_the_limit_is_input_max_alone(tmp_path):
    model, settings = vehicle(tmp_path, "p6", lateral_acceleration_max_mps2=None)
    speeds = np.linspace(*model.speed_range, 5)
    np.testing.assert_array_equal(input_limit(model, settings, speeds), np.full((5, 1), 6.0))


def test_two_inputs_share_the_acceleration_and_one_without_effect_keeps_its_own(tmp_path, monkeypatch):
    toy, settings = load_project(ROOT / "tests" / "unit" / "toy.toml"), load_project("truck").design
    model = NominalModel(toy)
    settings = settings.model_copy(update={"input_max": [9.0, 50.0], "lateral_acceleration_max_mps2": 2.0})
    speeds = np.linspace(*model.speed_range, 6)
    v = 11.0
    each = rule(model, settings, np.array([v]))[0]
    alone = [steady_acceleration(model, v, each * np.eye(2)[k]) for k in range(2)]
    bound = [1.0 if each[k] < settings.input_max[k] else 0.0 for k in range(2)]
    assert sum(bound) >= 1
    for share, bounded in zip(alone, bound, strict=True):
        assert share == pytest.approx(1.0) if bounded else share <= 1.0
    both = max(steady_acceleration(model, v, each * np.array([1.0, sign])) for sign in (1.0, -1.0))
    assert both <= 2.0 * (1 + 1e-9)
    matrices = model.matrices
    monkeypatch.setattr(model, "matrices", lambda v: (matrices(v)[0], matrices(v)[1] * [0.0, 1.0]))
    limit = input_limit(model, settings, speeds)
    np.testing.assert_array_equal(limit[:, 0], 9.0)
    assert limit.shape == (6, 2)
