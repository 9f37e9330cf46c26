"""controller.json: what is accepted, what is refused and by which name, and what the generated folder says of
it."""

import hashlib
import json

import numpy as np
import pytest

from hand_controller import hand_controller
from lpvguard.base.errors import InputError
from lpvguard.can.bus import bus_source
from lpvguard.core.control_coefficients import control_files, load_controller
from lpvguard.vehicle.project import CanPlace, load_project, parse_project


@pytest.fixture(scope="module")
def truck():
    return load_project("truck")


@pytest.fixture(scope="module")
def document(truck):
    return hand_controller(truck)


@pytest.fixture
def load(tmp_path):
    def loaded(document):
        path = tmp_path / "controller.json"
        path.write_text(document if isinstance(document, str) else json.dumps(document))
        return load_controller(path)

    return loaded


def changed(key, change):
    return lambda d: {**d, key: change(np.array(d[key], float)).tolist()}


def test_a_good_controller_keeps_its_numbers(load, document, truck, tmp_path):
    controller = load({**document, "certificates": {"gamma": 1.0}})
    assert controller.sizes == {"NK": 5, "NM": 3, "NG": 5}
    np.testing.assert_array_equal(controller.reals["A1"], document["a"])
    np.testing.assert_array_equal(
        controller.reals["BL"], np.concatenate([document["B"], document["L"]], axis=3)
    )
    np.testing.assert_array_equal(controller.reals["u_max"], document["u_max"])
    manifest = controller.manifest()
    assert manifest["u_max"] is controller.reals["u_max"]
    assert "certificates" not in manifest
    assert manifest["sha256"] == hashlib.sha256((tmp_path / "controller.json").read_bytes()).hexdigest()
    assert set(control_files(truck, controller)) == {
        "lpvguard_control.c",
        "lpvguard_bus.c",
        "lpvg_can_codec.h",
        "lpvg_can_codec.c",
    }


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: "[]", "not an object"),
        (lambda d: "{", "JSON"),
        (lambda d: {k: v for k, v in d.items() if k != "L"}, "L"),
        (lambda d: {**d, "B": [[1.0], [2.0, 3.0]]}, "B"),
        (lambda d: {**d, "Ts_s": "fast"}, "Ts_s"),
        (lambda d: {**d, "Ts_s": -1.0}, "Ts_s"),
        (changed("speeds", lambda v: v[:1]), "speeds"),
        (changed("speeds", lambda v: v[::-1]), "speeds"),
        (changed("speeds", lambda v: v + np.array([0, 0, 0.1, 0, 0])), "equally spaced"),
        (changed("a", lambda a: a[None]), "dimensions"),
        (changed("a", lambda a: a[:4]), "B"),
        (changed("a", lambda a: a + np.array([0, 0, 0, 1e-4, 0])), "stable poles"),
        (changed("L", lambda gain: gain[:3]), "L"),
        (changed("L", lambda gain: 0 * gain + 1e3), "spectral radius"),
        (changed("B", lambda b: b * np.nan), "finite"),
        (changed("u_max", lambda u: -u), "u_max"),
        (changed("u_max", lambda u: u * (np.arange(5) < 4)[:, None]), "u_max"),
        (changed("u_max", lambda u: u[0]), r"u_max: shape \(1,\); expected shape \(5, 1\)"),
        (changed("u_max", lambda u: u[:4]), "u_max"),
        (changed("rate_max", lambda u: 0 * u), "rate_max"),
    ],
)
def test_bad_controllers_are_refused_by_name(load, document, change, says):
    with pytest.raises(InputError, match=says):
        load(change(document))


def test_too_many_states_are_refused(load, document):
    big = {"a": np.zeros(21), "B": np.zeros((5, 2, 21, 3)), "L": np.zeros((5, 2, 21, 2))}
    with pytest.raises(InputError, match="42 states"):
        load({**document, **{k: v.tolist() for k, v in big.items()}})


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (changed("speeds", lambda v: v + 1.0), "speeds"),
        (lambda d: {**d, "Ts_s": 0.02}, "Ts_s"),
        (changed("B", lambda b: b[..., :2]), "measurements"),
    ],
)
def test_a_controller_of_another_vehicle_is_refused(load, document, truck, change, says):
    with pytest.raises(InputError, match=says):
        control_files(truck, load(change(document)))


def _with_place(project, index, **place):
    signals = list(project.signals)
    can = signals[index].can.model_copy(update=place) if place else None
    signals[index] = signals[index].model_copy(update={"can": can})
    return project.model_copy(update={"signals": signals})


@pytest.mark.parametrize(
    ("index", "place", "says"),
    [
        (0, {}, "speed"),
        (1, {}, "brake_pressure_difference"),
        (1, {"factor": 2.0}, "dp_demand"),
        (1, {"message": "VDC2"}, "VDC2"),
        (2, {"message": "GUARD_OUT"}, "GUARD_OUT"),
        (2, {"signal": "colour"}, "colour"),
        (2, {"message": "NONE"}, "NONE"),
    ],
)
def test_signals_without_a_usable_place_on_the_bus_are_refused(truck, index, place, says):
    with pytest.raises(InputError, match=says):
        bus_source(_with_place(truck, index, **place))


def test_a_demand_on_the_cars_own_bus_is_packed_and_without_a_place_there_is_the_controller_alone(load):
    """A measured steering angle is no demand of ours; [can.demand] says which message carries it."""
    rav4 = load_project("rav4")
    controller = load(hand_controller(rav4))
    assert set(control_files(rav4, controller)) == {"lpvguard_control.c"}
    place = CanPlace(message="STEER_ANGLE_SENSOR", signal="STEER_ANGLE", factor=57.3)
    bus = rav4.can.model_copy(update={"demand": {"steering_wheel_angle": place}})
    files = control_files(rav4.model_copy(update={"can": bus}), controller)
    assert {"lpvguard_control.c", "lpvg_demand.c", "lpvguard_bus.c", "lpvg_rest.c"} < set(files)
    assert "check_toyota" in files["lpvg_demand.c"]
    halved = place.model_copy(update={"plus": ("STEER_FRACTION",)})
    bus = rav4.can.model_copy(update={"demand": {"steering_wheel_angle": halved}})
    with pytest.raises(InputError, match="expected one signal"):
        control_files(rav4.model_copy(update={"can": bus}), controller)


@pytest.mark.parametrize("demand", [{"speed": {"message": "A", "signal": "B"}}])
def test_places_of_demands_are_those_of_the_inputs(demand):
    document = load_project("rav4").model_dump(by_alias=True)
    with pytest.raises(InputError, match=r"can\.demand: speed, expected every input: steering_wheel_angle"):
        parse_project(document | {"can": {"dbc": "rav4.dbc", "demand": demand}}, "rav4")
