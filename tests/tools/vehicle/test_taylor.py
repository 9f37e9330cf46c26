"""Interval Taylor arithmetic encloses a function and its derivatives; the bounds of the zero-order hold that
rest on it do too."""

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.engine.synthesis.statespace import StateSpace, zero_order_hold
from lpvguard.vehicle.nominal import NominalModel, evaluate
from lpvguard.vehicle.project import load_project
from lpvguard.vehicle.taylor import Taylor

FUNCTIONS = [
    (lambda v: 3 / v + 2 * v, lambda v: -3 / v**2 + 2, lambda v: 3 / v**3),
    (lambda v: (v - 1) ** 3 / (v**2 + 1), None, None),
    (lambda v: -(v**-2) * (4 - v) / 7, None, None),
    (lambda v: root(3 * v**2 - v), None, None),
    (lambda v: abs(-v) * 2, lambda v: 2 + 0 * v, lambda v: 0 * v),
]


def root(x):
    return evaluate("sqrt(x)", {"x": x}, "test")


@pytest.mark.parametrize("case", range(len(FUNCTIONS)))
@pytest.mark.parametrize("low, high", [(1.0, 1.1), (2.0, 5.0), (8.0, 8.02)])
def test_values_and_derivatives_lie_in_the_enclosure(case, low, high):
    f, *known = FUNCTIONS[case]
    enclosure = f(Taylor.variable(low, high))
    v = np.linspace(low, high, 41)
    h = 1e-4
    slope = known[0](v) if known[0] else (f(v + h) - f(v - h)) / (2 * h)
    bend = known[1](v) if known[1] else (f(v + h) - 2 * f(v) + f(v - h)) / (2 * h**2)
    for k, (values, room) in enumerate(((f(v), 1e-12), (slope, 1e-6), (bend, 1e-6))):
        assert enclosure.low[k] <= values.min() + room and values.max() - room <= enclosure.high[k]


def test_what_cannot_be_enclosed_is_refused():
    with pytest.raises(ZeroDivisionError):
        1 / Taylor.variable(-1.0, 1.0)
    with pytest.raises(TypeError):
        Taylor.variable(1.0, 2.0) ** 0.5
    with pytest.raises(ZeroDivisionError):
        Taylor.variable(-1.0, 1.0).sqrt()
    for kinked in ("abs(v - 1.5)", "min(v, 1.5)", "max(1.5, v, 1)"):
        with pytest.raises(TypeError, match="kink"):
            evaluate(kinked, {"v": Taylor.variable(1.0, 2.0)}, "test")


@pytest.mark.parametrize("low, high", [(8.0, 8.1), (12.0, 14.0), (21.0, 22.0)])
@pytest.mark.parametrize("late_s", [0.04, 0.0473])
def test_the_zero_order_hold_moves_no_faster_than_its_bounds(low, high, late_s):
    truck = load_project("truck")
    settings = truck.model.model_copy(update={"input_delay_s": late_s})
    model = NominalModel(truck.model_copy(update={"model": settings}))
    n = model.n
    first, second = model.hold_bounds(low, high)

    def hold(v):
        A, B = (m[0] for m in model.matrices(np.array([v])))
        G = zero_order_hold(
            StateSpace(A, np.hstack([B, np.eye(n)]), np.eye(n), np.zeros((n, 1 + n))), model.Ts
        )
        if not model.delay_fraction:
            return np.hstack([G.A, G.B])
        held = model.discretise(np.array([v]))
        return np.hstack([G.A, held.B_old[0], held.B_new[0], G.B[:, 1:]])

    h = 1e-3
    for v in np.linspace(low + h, high - h, 7):
        slope, bend = (hold(v + h) - hold(v - h)) / (2 * h), (hold(v + h) - 2 * hold(v) + hold(v - h)) / h**2
        assert (np.abs(slope) <= first * (1 + 1e-6) + 1e-12).all()
        assert (np.abs(bend) <= second * (1 + 1e-3) + 1e-8).all()
    assert (
        first.max() < 3 * np.abs(hold(high) - hold(low)).max() / (high - low) + 1e-12
    )  # not a bound that says nothing


def test_a_model_that_cannot_be_bounded_is_named():
    truck = load_project("truck")
    rows = [["-p1*l/v + p2*v", "p1", 0.0], [0.0, 0.0, 1.0], ["p3*l/v**1.5", "-p3", "p5"]]
    model = NominalModel(truck.model_copy(update={"model": truck.model.model_copy(update={"A": rows})}))
    with pytest.raises(InputError, match="whole exponents"):
        model.hold_bounds(10.0, 11.0)


@pytest.mark.parametrize("low, high, slope", [(1.0, 1.4, 0.0), (1.6, 2.0, 2.0)])
def test_min_and_max_are_bounded_on_either_side_of_their_kink(low, high, slope):
    enclosure = evaluate("max(min(v, 9), 1.5) * 2", {"v": Taylor.variable(low, high)}, "test")
    assert enclosure.low[1] == enclosure.high[1] == slope
    assert (enclosure.low[0], enclosure.high[0]) == ((3.0, 3.0) if slope == 0 else (2 * low, 2 * high))
