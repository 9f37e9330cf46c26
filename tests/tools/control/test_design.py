"""The scheduled controller: its certificate holds for the coefficients as they stand, and for no others."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.base.parallel import workers
from lpvguard.control import design as stage
from lpvguard.control import moving_speed, plants
from lpvguard.control.plants import DesignProblem
from lpvguard.control.robust_run import CompiledController, run
from lpvguard.control.schedule import FrozenLoop, fit_by_pairs
from lpvguard.control.stored_frames import StoredFrames
from lpvguard.core.control_coefficients import load_controller
from lpvguard.core.scheduled import Scheduled
from lpvguard.engine.synthesis import interconnection as fig1
from lpvguard.engine.synthesis.dk import certify
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.scheduling import closed_scaled
from lpvguard.engine.synthesis.statespace import StateSpace, lft
from lpvguard.extras.loop.sim import Simulator, load_scenario
from lpvguard.identify import identification as identification
from lpvguard.identify.export import export_vehicle
from lpvguard.vehicle.nominal import NominalModel


@pytest.fixture
def stored(six_node_truck):
    return six_node_truck


@pytest.fixture(scope="module")
def common(few_truck_common_identified):
    """The same drives with one Delta for both outputs."""
    return identification.load(few_truck_common_identified)


@pytest.fixture
def designed(few_truck_designed):
    """For frozen speeds."""
    return few_truck_designed


@pytest.fixture(scope="module")
def finer(few_truck_identified):
    """The same drives with the shipped truck's nodes: between fewer the proof at a moving speed fails."""
    return identification.load(few_truck_identified)


@pytest.fixture(scope="module")
def moving(finer, tmp_path_factory):
    """A design for a moving speed, too, and its controller.json; the search for performance takes minutes and
    has tests of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(moving_speed, "find_level", lambda *_: None)
        result = stage.design(finer)
    folder = tmp_path_factory.mktemp("design") / "design"
    stage.save(result, finer, folder)
    return result, folder / "controller.json"


def with_settings(stored, **changes):
    """The same identification with other objectives, which are synthesised for unless others are given."""
    own = {"synthesised_for": None, "A_u": 1e-6} if "A_t" in changes else {}
    settings = stored.project.design.model_copy(update=own | changes)
    return replace(stored, project=stored.project.model_copy(update={"design": settings}))


def test_robust_performance_is_proved_at_every_node_and_midway(designed):
    result, _ = designed
    assert len(result.certificates) == 2 * len(result.schedule.speeds) - 1
    assert all(
        proved.lower <= proved.upper * (1 + 1e-9) and proved.upper < 1.2 for _, proved in result.certificates
    )


def test_the_certificate_is_proved_anew_and_an_altered_coefficient_is_refused(stored, designed, tmp_path):
    _, path = designed
    with workers(2) as two:
        stage.verify(path, stored, workers=two)
    document = json.loads(path.read_text())
    random = np.random.default_rng(3)
    for key in ("a", "B", "u_max"):
        changed = np.array(document[key])
        biggest = np.argsort(np.abs(changed).ravel())[-3:]
        index = np.unravel_index(random.choice(biggest), changed.shape)
        changed[index] *= 1.001
        altered = {**document, key: changed.tolist()}
        (tmp_path / "controller.json").write_text(artefacts.to_json(artefacts.sealed(altered)))
        with pytest.raises(InputError, match="coefficients_sha256"):
            stage.verify(tmp_path / "controller.json", stored)
    (tmp_path / "controller.json").write_text(
        json.dumps({**document, "u_max": [[2 * x for x in node] for node in document["u_max"]]})
    )
    with pytest.raises(InputError, match="seal: does not fit"):
        stage.verify(tmp_path / "controller.json", stored)
    with pytest.raises(InputError, match=r"u_max: .* from the project's limits"):
        stage.verify(path, with_settings(stored, lateral_acceleration_max_mps2=5.0))
    flat = {**document, "u_max": np.ravel(document["u_max"]).tolist()}  # the same bytes in another shape
    (tmp_path / "controller.json").write_text(artefacts.to_json(artefacts.sealed(flat)))
    with pytest.raises(InputError, match=r"u_max: .* from the project's limits"):
        stage.verify(tmp_path / "controller.json", stored)
    # With a sum that fits, the proof is what refuses.
    changed = np.array(document["a"])
    changed[np.argmax(np.abs(changed))] *= 1.001
    altered = {**document, "a": changed.tolist()}
    altered["certificates"] = {
        **document["certificates"],
        "coefficients_sha256": Scheduled.read(altered).digest(),
    }
    (tmp_path / "controller.json").write_text(artefacts.to_json(artefacts.sealed(altered)))
    with pytest.raises(InputError, match="certificate at"):
        stage.verify(tmp_path / "controller.json", stored)


@pytest.mark.parametrize(
    "place, key, factor",
    [
        ("speeds", "mu_upper", 0.999),
        ("speeds", "mu_lower", 0.99),
        ("speeds", "mu_lower", 1.0005),
        ("speeds", "peak_rad_s", 300.0),
        ("off_grid", "mu_upper", 1.001),
        (None, "A_t", 1.01),
        (None, "A_u", 10.0),
        (None, "dc_floor", 1.001),
    ],
)
def test_a_stated_number_that_is_not_what_is_proved_is_refused(
    stored, designed, tmp_path, place, key, factor
):
    document = json.loads(designed[1].read_text())
    stated = document["certificates"]
    target = stated if place is None else stated[place][3] if place == "speeds" else stated[place]
    target[key] = factor * target[key] if target[key] else factor
    (tmp_path / "controller.json").write_text(artefacts.to_json(artefacts.sealed(document)))
    with pytest.raises(InputError, match=key):
        stage.verify(tmp_path / "controller.json", stored)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({}, None),
        ({"product": 0.6}, "largest_A_t.product"),
        ({"worst": 1.0}, "largest_A_t: A_t 100 with mu 1,"),
        ({"failed": 99.0}, "largest_A_t: A_t 100"),
        ({"failed": 201.0}, "at most 200"),
        ({"dc_floor": None}, "dc_floor: None"),
    ],
)
def test_a_floor_or_a_largest_A_t_beyond_it_is_refused(change, what, tmp_path):
    largest = {"A_t": 100.0, "product": 0.5, "worst": 0.99, "failed": 101.0} | change
    stated = {"dc_floor": largest.pop("dc_floor", 0.005), "largest_A_t": largest}
    if what is None:
        stage._require_floor(tmp_path, stated, 0.005)
        stage._require_floor(tmp_path, {"dc_floor": None, "largest_A_t": None}, np.nan)
    else:
        with pytest.raises(InputError, match=what):
            stage._require_floor(tmp_path, stated, 0.005)


@pytest.mark.long("70 s: a search at a moving speed")
def test_robust_stability_is_proved_at_a_moving_speed_and_proved_anew(finer, moving):
    """The truck brakes with 2 m/s2; what is not searched for is not claimed. Stability is at level 1 and of
    the design's D."""
    result, path = moving
    stated = json.loads(path.read_text())["certificates"]["moving_speed"]
    assert result.moving["stability"].lpv.rate >= 2 and result.moving["performance"] is None
    assert stated["stability"]["rate_mps2"] == result.moving["stability"].lpv.rate
    assert stated["performance"]["rate_mps2"] is None
    assert stated["stability"]["level"] == stated["stability"]["gain"] == 1
    np.testing.assert_array_equal(stated["stability"]["scaling"], result.scaling.log_parameters)
    families = moving_speed.scaled_families(
        DesignProblem.from_identification(finer), result.schedule, result.scaling
    )
    whole = families["performance"].at(15.0).order
    assert stated["stability"]["states"] == families["stability"].at(15.0).order < whole


@pytest.mark.long("70 s: a search at a moving speed")
@pytest.mark.parametrize(
    "what", ["faster", "wider", "coefficient", "performance", "other basis", "no level", "no gain", "margin"]
)
def test_a_claim_of_a_moving_speed_that_is_not_proved_is_refused(finer, moving, what):
    result, _ = moving
    schedule, one = result.schedule, result.moving["stability"]
    said = json.loads(artefacts.to_json(moving_speed._moving("stability", one)))
    claim = "stability"
    if what == "faster":
        said["rate_mps2"] *= 30
    elif what == "wider":  # the same nodes over a range that begins 2 m/s lower
        schedule = replace(schedule, speeds=np.linspace(6.0, schedule.speeds[-1], len(schedule.speeds)))
    elif what == "coefficient":
        schedule = replace(schedule, B=schedule.B * np.array([1.0, 1.5, 1.0]))
    elif what == "performance":
        claim = "performance"
    elif what == "margin":
        said["margin"] *= 1.1
    elif what == "no level":
        del said["level"]
    elif what == "no gain":
        said["gain"] = 0.0
    else:
        said["basis"] = said["basis"][:-1]
    assert not moving_speed._holds((finer, schedule, claim, said))


@pytest.mark.long("70 s: a search at a moving speed")
def test_a_storage_function_at_knots_of_its_own_is_proved_anew_and_none_over_other_speeds(finer, moving):
    """The same storage function, stated by its values at the knots between which it is linear."""
    result, _ = moving
    one = result.moving["stability"]
    at_knots = replace(one, lpv=replace(one.lpv, own_knots=True, P=None))
    said = json.loads(artefacts.to_json(moving_speed._moving("stability", at_knots)))
    assert len(said["P"]) == len(said["knots_mps"]) == len(one.lpv.storage.knots)
    assert moving_speed._holds((finer, result.schedule, "stability", said))
    knots = said["knots_mps"]
    for wrong in (
        {"knots_mps": knots[1:]},
        {"knots_mps": knots[1:], "P": said["P"][1:]},
        {"knots_mps": [*knots[:-1], knots[-1] + 1.0]},
        {"knots_mps": [knots[0], knots[2], knots[1], *knots[3:]]},
        {"knots_mps": [], "P": []},
        {"knots_mps": None},
    ):
        assert not moving_speed._holds((finer, result.schedule, "stability", {**said, **wrong}))


@pytest.mark.long("70 s: a search at a moving speed")
def test_a_faster_rate_in_controller_json_is_refused(finer, moving, tmp_path):
    document = json.loads(moving[1].read_text())
    for claim in moving_speed.CLAIMS:
        altered = json.loads(json.dumps(document))
        said = altered["certificates"]["moving_speed"]
        said[claim] = {**said["stability"], "rate_mps2": 30 * said["stability"]["rate_mps2"]}
        (tmp_path / "controller.json").write_text(artefacts.to_json(artefacts.sealed(altered)))
        with pytest.raises(InputError, match=rf"moving_speed\.{claim}"):
            stage.verify(tmp_path / "controller.json", finer)


@pytest.mark.parametrize("asked", [True, False])
def test_the_command_searches_at_a_moving_speed_unless_told_not_to(finer, asked, monkeypatch, tmp_path):
    from lpvguard.cli import design as command

    moving = []

    def design(stored, progress, moving_speed, workers, present):
        moving.append(moving_speed)
        raise InputError("design", "x", "stopped here", "no more")

    monkeypatch.setattr(stage, "design", design)
    with pytest.raises(InputError, match="stopped here"):
        searched = {"table": False, "largest_A_t": False, "moving_speed": asked}
        command._design_vehicle(finer, None, tmp_path / "out", None, 1, **searched)
    assert moving == [asked]


@pytest.mark.long("30 s: two designs for frozen speeds")
def test_synthesis_for_other_objectives_changes_the_controller_and_not_what_is_certified(stored):
    """The controller is that of the A_t and A_u that are synthesised for; its mu is of A_t and A_u
    themselves, under a D that suits these."""
    one = with_settings(stored, A_t=40.0, synthesised_for=[60.0, 1.5e-6], nodes=4, order_loss=0.05)
    asked = one.project.design.for_synthesis
    other = with_settings(one, A_t=asked.A_t, A_u=asked.A_u, synthesised_for=None)
    assert (asked.A_t, asked.A_u) == (60.0, 1.5e-6) and one.project.design.A_t == 40.0
    soft, hard = (stage._designed(x, x.project.design, None, lambda _: None) for x in (one, other))
    for name in ("speeds", "a", "B", "L", "u_max"):
        np.testing.assert_array_equal(getattr(soft.schedule, name), getattr(hard.schedule, name))
    for (v, proved), (_, harder) in zip(soft.certificates, hard.certificates, strict=True):
        again = certify(DesignProblem.from_identification(one).plant(v), soft.schedule.at(v), soft.scaling)
        assert proved.upper == pytest.approx(again.upper, rel=1e-9) and proved.upper < harder.upper
    assert soft.off_grid[1].upper < hard.off_grid[1].upper

    def worst(scaling):
        loops = [
            closed_scaled(
                DesignProblem.from_identification(one).plant(float(v)), soft.schedule.at(float(v)), scaling
            )
            for v in soft.schedule.speeds
        ]
        return max(hinf_norm(G, rtol=1e-4).upper for G in loops)

    assert worst(soft.scaling) < worst(hard.scaling)


@pytest.mark.long("30 s: designs for ever larger A_t")
def test_the_largest_A_t_is_bracketed_below_the_dc_floors_limit(stored, monkeypatch):
    """The project's own A_t is reached; what fails is no more than the tolerance above, and below the limit
    of any controller."""
    monkeypatch.setattr(stage, "A_T_RTOL", 0.9)
    largest, settings = stage.largest_A_t(stored), stored.project.design
    assert largest.worst < 1 and settings.A_t <= largest.A_t < largest.failed <= 1.9 * largest.A_t
    floor = stage.dc_floor(DesignProblem(stored, settings).weights)
    assert largest.product == pytest.approx(largest.A_t * floor)
    assert largest.product > 0.45 and largest.failed * floor < 1 - 1e-9


def test_K_is_is_refused_where_frames_cannot_tell_the_states_uncertainty(common):
    with pytest.raises(InputError, match=r"median error of \d+% at .*plain DFT"):
        stage.design(with_settings(common, structure="K_is"))


def with_exact_frames(stored):
    """As if the window cost nothing, so that the rest of class S2's path can be walked."""
    return replace(
        stored, bounds={**stored.bounds, "window_error_median": 0 * stored.bounds["window_error_median"]}
    )


def test_K_is_takes_the_states_own_bound_in_1_per_s(common):
    one = with_settings(with_exact_frames(common), structure="K_is")
    weights, frames = DesignProblem.from_identification(one).weights, StoredFrames(one)
    split = frames.explain_with_state(one.bounds["gamma_w"], one.project.design.lambda_s)
    omega = frames.estimator.omega
    for system, nu in ((weights.W_delta_s, split.nu_s), (weights.W_delta_i, split.nu_i)):
        seen = np.isfinite(nu)
        assert (np.abs(system.response(omega)[seen, 0, 0]) >= nu[seen] * (1 - 1e-6)).all()
    assert not np.allclose(weights.W_delta_s.response(omega), weights.W_delta_i.response(omega), rtol=0.1)


def test_the_states_uncertainty_is_searched_once(common, monkeypatch):
    """For each lambda_s, whatever else the settings are."""
    asked = []

    class Frames:
        def __init__(self, stored):
            asked.append(stored)

        def explain_with_state(self, gamma_w, lambda_s):
            return lambda_s

        def weights(self, split):
            return split

    monkeypatch.setattr(plants, "StoredFrames", Frames)
    one, settings = with_exact_frames(common), common.project.design
    variants = [settings.model_copy(update={"lambda_s": x}) for x in (0.5, 0.5, 2.0, 0.5)]
    problem = DesignProblem(one, settings)
    assert [problem.with_settings(s).state_uncertainty() for s in variants] == [0.5, 0.5, 2.0, 0.5]
    assert asked == [one, one]


@pytest.mark.parametrize("factor", [0.1, 60.0])
def test_another_unit_of_time_leaves_the_loop_of_K_is_as_it_was(common, factor):
    """x' = A x + B u + xi_s: in a unit of time `factor` times longer A, B and W_delta_s grow by that
    factor."""
    model, settings = NominalModel(common.project), common.project.design
    A, B = (m[0] for m in model.matrices(np.array([15.0])))
    weights = DesignProblem(common, settings).weights
    scaled = {
        name: tuple(replace(w, A=factor * w.A, B=factor * w.B) for w in systems)
        for name, systems in weights.systems().items()
    }
    single = {
        name: own if isinstance(getattr(weights, name), tuple) else own[0] for name, own in scaled.items()
    }
    slower = replace(weights, **single)
    rate = replace(slower.W_delta_s, C=factor * slower.W_delta_s.C, D=factor * slower.W_delta_s.D)
    omega = np.geomspace(1e-2, 30.0, 40)
    want = fig1.generalised_plant(A, B, weights, "K_is").system.response(omega)
    got = fig1.generalised_plant(
        factor * A, factor * B, replace(slower, W_delta_s=rate), "K_is"
    ).system.response(factor * omega)
    np.testing.assert_allclose(got, want, rtol=1e-8, atol=1e-10)
    as_if_dimensionless = fig1.generalised_plant(factor * A, factor * B, slower, "K_is").system.response(
        factor * omega
    )
    assert np.abs(as_if_dimensionless - want).max() > 1e-2 * np.abs(want).max()


def test_a_controller_for_no_uncertainty_is_refused_because_the_vehicle_errs(common):
    """K_inf presupposes the nominal model itself, which the drives that judge refute."""
    with pytest.raises(InputError, match=r"W_delta = 0 is 0 times \|delta_c\| - k se = .* do not refute"):
        stage.design(with_settings(common, structure="K_inf"))


@pytest.mark.parametrize("structure", ["K_inf", "K_i", "K_is"])
def test_the_other_structures_go_from_design_to_the_closed_loop(common, tmp_path, monkeypatch, structure):
    """K_inf below the gate, which refuses it."""
    stored = with_exact_frames(common)
    # The certificate at a moving speed has tests of its own.
    for search in ("find", "find_level"):
        monkeypatch.setattr(moving_speed, search, lambda *_: None)
    monkeypatch.setattr(stage, "OFF_GRID", 4)
    if structure == "K_inf":
        monkeypatch.setattr(stage, "require_premise", stage.premise)
    one = with_settings(stored, structure=structure, nodes=3, A_t=15.0, order_loss=0.05)
    result = stage.design(one)
    stage.save(result, one, tmp_path / "design")
    stage.verify(tmp_path / "design" / "controller.json", one)
    assert np.isfinite(result.worst)
    export_vehicle(one, tmp_path / "vehicle", load_controller(tmp_path / "design" / "controller.json"))
    ran = Simulator(tmp_path / "vehicle").run(load_scenario("nominal"))
    assert ran["tracking_rms"] < ran["command_rms"]


def test_the_compiled_controller_keeps_the_certified_gain(stored, designed, tmp_path):
    result, path = designed
    export_vehicle(stored, tmp_path / "vehicle", load_controller(path))
    compiled = CompiledController(tmp_path / "vehicle")
    for v, proved in (result.certificates[0], result.certificates[9]):
        plant, controller = DesignProblem.from_identification(stored).plant(v), result.schedule.at(v)
        row = run(compiled, plant, controller, v, proved, 10, 1)
        assert row.kept and row.rounding > 0
        # A run of finite length does not fill a narrow peak, or one at DC.
        assert row.worst >= 0.9 * row.worst_gain >= 0.9 * row.sampled
        assert not replace(row, bound=0.9 * row.worst).kept


def test_the_certified_controller_is_the_one_the_core_is_given(designed):
    result, path = designed
    coefficients, schedule = load_controller(path), result.schedule
    reals, v = coefficients.reals, schedule.speeds[2]
    assert list(coefficients.words["sizes"]) == [len(schedule.a), 3, len(schedule.speeds), 1]
    n = len(schedule.a)
    A1 = np.zeros((n, n))
    for j in range(n):
        A1[j, j - j % 2] = np.float32(reals["A1"][j])
        if j % 2 == 0 and j + 1 < n:
            A1[j, j + 1] = 1.0
    np.testing.assert_array_equal(schedule.at(v).A, np.eye(n) + A1)
    # At a node too B is interpolated, in double: nodes that are no binary fractions cost a rounding.
    compiled_B = reals["BL"][2, 0, :, :3].astype(np.float32).astype(float)
    np.testing.assert_allclose(schedule.at(v).B, compiled_B, rtol=0, atol=1e-12 * np.abs(compiled_B).max())
    np.testing.assert_array_equal(schedule.at(v).C, [np.arange(n) % 2 == 0])


def test_a_controller_that_has_common_poles_is_met(stored, designed):
    """The fit's own result, given as what is to be met at every node, comes back within what its ridge
    costs."""
    result, _ = designed
    schedule, model = result.schedule, NominalModel(stored.project)
    loops = [
        FrozenLoop(
            schedule.at(v), DesignProblem.from_identification(stored).plant(v), stage.vehicle_at(model, v)
        )
        for v in schedule.speeds
    ]
    again = fit_by_pairs(loops, schedule.speeds, result.scaling, schedule.u_max)(len(schedule.a) // 2)
    omega = np.logspace(-2, np.log10(np.pi / schedule.Ts), 50)
    for v in schedule.speeds:
        wanted = schedule.at(v).response(omega)
        assert np.abs(again.at(v).response(omega) - wanted).max() <= 1e-3 * np.abs(wanted).max()


def test_random_deltas_within_the_bound_keep_the_certified_performance(stored, designed):
    """Closed with stable Delta of size at most 1 / mu the norm from disturbances to objectives is at most
    mu."""
    result, _ = designed
    v, proved = result.certificates[4]
    plant = DesignProblem.from_identification(stored).plant(v)
    loop = lft(plant.system, result.schedule.at(v))
    level, random = proved.upper, np.random.default_rng(5)
    assert [(b.rows, b.cols) for b in plant.blocks] == [(1, 1)] * 2
    omega = np.concatenate([[0.0], np.logspace(-3, np.log10(np.pi / plant.system.dt), 400)])
    M = loop.response(omega)
    for _ in range(50):
        pole, sign = random.uniform(-0.99, 0.99, 2), random.choice([-1.0, 1.0], 2)
        size = sign * (1 - np.abs(pole)) / level / max(1.0, level)
        delta = StateSpace(np.diag(pole), np.eye(2), np.diag(size), np.zeros((2, 2)), plant.system.dt)
        D = delta.response(omega)
        fed_back = np.linalg.solve(np.eye(2) - M[:, :2, :2] @ D, M[:, :2, 2:])
        closed = M[:, 2:, 2:] + M[:, 2:, :2] @ D @ fed_back
        assert np.linalg.norm(closed, 2, axis=(1, 2)).max() <= level * (1 + 1e-9)


def test_without_zero_input_drives_or_objectives_the_reason_is_named(stored, g80, identified):
    with pytest.raises(InputError, match=r"no \[design\] table"):
        stage.design(identification.load(identified))


class SaturatedLoop:
    """The nominal vehicle at a speed under the schedule's law, in double, with or without limits."""

    def __init__(self, result, model, v, settings):
        schedule = result.schedule
        self.vehicle, self.K = stage.vehicle_at(model, v), schedule.at(v)
        self.L, self.Ts = schedule._rows(schedule.L, v)[:, 0], schedule.Ts
        self.u_max, self.rate = schedule.limit(v)[0], settings.input_rate_max_per_s[0] * schedule.Ts
        self.top = (
            self.vehicle.C @ np.linalg.solve(np.eye(self.vehicle.order) - self.vehicle.A, self.vehicle.B)
        )[0, 0] * self.u_max

    def run(self, command, state=None, limits=True):
        """Controlled output, applied and wanted demand (N,), and the states (controller, vehicle) before
        every sample."""
        x, xp = state or (np.zeros(self.K.order), np.zeros(self.vehicle.order))
        u, rows, states = 0.0, [], []
        for r in command:
            y, wanted = self.vehicle.C @ xp, (self.K.C @ x)[0]
            u = (
                np.clip(np.clip(wanted, -self.u_max, self.u_max), u - self.rate, u + self.rate)
                if limits
                else wanted
            )
            rows.append((y[0], u, wanted))
            states.append((x, xp))
            x = self.K.A @ x + self.K.B @ np.append(r, y) + self.L * (u - wanted)
            xp = self.vehicle.A @ xp + self.vehicle.B[:, 0] * u
        return *np.array(rows).T, states

    def settling(self, y, band):
        """Seconds after which |y| stays within ``band``."""
        outside = np.flatnonzero(np.abs(y) > band)
        return self.Ts * (outside[-1] + 1) if len(outside) else 0.0


@pytest.mark.requirement("REQ-CTL-5")
@pytest.mark.parametrize("v", [8.0, 9.0, 11.0, 17.0, 22.0])
@pytest.mark.parametrize("overdriven", [1.1, 3.0])
def test_after_saturation_the_loop_settles_as_if_there_had_been_none(stored, designed, v, overdriven):
    """A minute of a command that full demand cannot follow, then zero: the demand leaves its stop at once,
    and from the moment it has, the loop settles as the loop without limits does from the same state."""
    loop = SaturatedLoop(designed[0], NominalModel(stored.project), v, stored.project.design)
    minute, after = round(60 / loop.Ts), round(25 / loop.Ts)
    y, u, wanted, states = loop.run(np.append(np.full(minute, overdriven * loop.top), np.zeros(after)))
    assert abs(u[minute - 1]) == loop.u_max
    assert loop.Ts * np.flatnonzero(np.abs(u[minute:]) < 0.9 * loop.u_max)[0] <= 0.5
    left = np.flatnonzero(np.abs(wanted) > loop.u_max)[-1] + 1  # the rate limit may still act
    band = 0.05 * abs(y[minute - 1])
    free, *_ = loop.run(np.zeros(len(y) - left), states[left], limits=False)
    assert loop.settling(y[left:], band) <= 1.1 * loop.settling(free, band) + loop.Ts
    # All in all: the linear loop's settling from where full demand led, and what the lost demand takes to be
    # made up for.
    linear, *_ = loop.run(np.append(np.full(minute, loop.top), np.zeros(after)), limits=False)
    assert loop.settling(y[minute:], band) <= 2.8 * loop.settling(
        linear[minute:], 0.05 * abs(linear[minute - 1])
    )
