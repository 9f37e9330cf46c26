"""Nominal model: exact hold against an ordinary differential equation solver, delay, speed table, frequency
response."""

from importlib import resources
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from lpvguard.base.errors import InputError
from lpvguard.core.coefficients import build_coefficients
from lpvguard.drives.frames import Estimator
from lpvguard.engine.overbound.weight import Weight
from lpvguard.identify.change import ChangeTest
from lpvguard.identify.energy import EnergyTest
from lpvguard.vehicle.nominal import NominalModel, evaluate, tabulate
from lpvguard.vehicle.project import load_project


@pytest.fixture(params=[0.0, 0.02, 0.025, 0.05])
def delayed(request, tmp_path):
    text = resources.files("lpvguard.vehicle").joinpath("shipped", "g80.toml").read_text()
    path = tmp_path / "car.toml"
    path.write_text(text.replace("input_delay_s = 0.025", f"input_delay_s = {request.param}"))
    return NominalModel(load_project(path)), request.param


def test_recursion_solves_the_differential_equation_with_held_delayed_input(delayed):
    model, delay = delayed
    random = np.random.default_rng(1)
    n, Ts, v = 40, model.Ts, 9.0
    u = random.standard_normal((n, 1))
    A, B = (m[0] for m in model.matrices(v))

    def held(t):
        return u[max(int(np.floor((t - delay) / Ts + 1e-9)), 0), 0] - model.input_offset[0]

    yhat = model.simulate(np.full(n, v), u, np.array([0.3]))
    x = 0.3 - model.output_offset[0]
    for k in range(n - 1):
        assert yhat[k, 0] == pytest.approx(x + model.output_offset[0], abs=1e-6)
        # The input is constant on the pieces between its (delayed) steps: integrate each.
        switch = [
            k * Ts,
            *([k * Ts + model.delay_fraction * Ts] if model.delay_fraction else []),
            (k + 1) * Ts,
        ]
        for a, b in pairwise(switch):
            value = held((a + b) / 2)
            x = solve_ivp(
                lambda _, s, w=value: A[0, 0] * s + B[0, 0] * w, (a, b), [x], rtol=1e-10, atol=1e-12
            ).y[0, -1]


def test_frequency_response_is_that_of_the_recursion(delayed):
    model, _ = delayed
    omega, v, n = 3.0, 11.0, 4000
    t = np.arange(n) * model.Ts
    u = np.cos(omega * t)[:, None] + model.input_offset
    y = model.simulate(np.full(n, v), u, np.zeros(1))[:, 0] - model.output_offset[0]
    tail = slice(n // 2, None)
    basis = np.column_stack([np.cos(omega * t[tail]), -np.sin(omega * t[tail])])
    re, im = np.linalg.lstsq(basis, y[tail], rcond=None)[0]
    assert model.frequency_response([omega], v)[0, 0, 0] == pytest.approx(re + 1j * im, abs=1e-6)


def test_speed_table_error_is_as_stated_between_its_nodes(g80_model):
    v = np.random.default_rng(2).uniform(*g80_model.speed_range, 2000)
    exact = g80_model.discretise(v)
    exact = np.concatenate([m.reshape(len(v), -1) for m in (exact.Ad, exact.B_old, exact.B_new)], axis=1)
    worst = np.abs(g80_model.table.at(v) - exact).max(axis=0) / np.abs(exact).max(axis=0)
    assert worst.max() <= 1.05 * g80_model.table.error <= 1.05e-6


def test_the_error_of_a_table_that_no_number_of_cells_makes_exact_is_that_of_all_its_points():
    """A bump between the few points of a cell that refuse most tables, and a kink that they refuse."""

    def entries(v):
        return np.column_stack([v + 0.1 * np.exp(-(((v - 63.06) / 0.01) ** 2)), v + 0.01 * np.abs(v - 0.5)])

    table = tabulate(entries, 0.0, 64.0)
    v = 63.0 + np.linspace(0.0, 1.0, 33)
    off = np.abs(table.at(v) - entries(v)) / np.abs(entries(np.linspace(0.0, 64.0, 101))).max(axis=0)
    assert len(table.cell) == 64 and off.max() > 5e-4
    assert table.error >= off.max() * (1 - 1e-9)


def test_outside_its_range_the_model_runs_at_the_nearest_speed_but_refuses_a_frequency_response(g80_model):
    u, y = np.full((5, 1), 0.1), np.zeros(1)
    np.testing.assert_array_equal(
        g80_model.simulate(np.full(5, 0.0), u, y), g80_model.simulate(np.full(5, 3.5), u, y)
    )
    with pytest.raises(InputError, match="v = 25"):
        g80_model.frequency_response([1.0], 25.0)


def test_crc_of_python_is_the_crc_of_the_core(core, identified):
    from lpvguard.identify.identification import load

    assert int(core.words["crc32"][0]) == load(identified).coefficients.crc32(4)


def test_coefficients_follow_the_signal_table(g80, g80_model):
    estimator = Estimator.from_project(g80, g80_model)
    energy = EnergyTest.design(g80, estimator, [Weight([1.0], [1.0])], [1.0, 2.0], [[0.5], [0.5]], 1.0)
    ones = np.ones((estimator.n_bins, 1))
    c = build_coefficients(g80, g80_model, estimator, ones, ones, 1.0, energy, ChangeTest.design(g80))
    assert c.reals["input_valid"].tolist() == [[-0.8, 0.8]] and c.sizes["DELAY"] == 1


@pytest.mark.parametrize(
    ("expression", "value"),
    [("abs(v - 9)", [4.0, 1.0]), ("sqrt(v - 1) + 1", [3.0, 4.0]), ("max(min(v, 8), 6, 2*k)", [6.0, 8.0])],
)
def test_expressions_know_abs_min_max_and_sqrt(expression, value):
    v = np.array([5.0, 10.0])
    assert evaluate(expression, {"v": v, "k": 2.5}, "test").tolist() == value
    assert evaluate(expression, {"v": 10.0, "k": 2.5}, "test") == value[1]


@pytest.mark.parametrize(
    ("expression", "says"),
    [
        ("sqrt(v - 6)", "'sqrt\\(v - 6\\)' has a negative argument"),
        ("sqrt(v, 2)", "expected one value"),
        ("min(v)", "expected two values or more"),
        ("exp(v)", "cannot use 'exp\\(v\\)'.*abs, min, max, sqrt"),
        ("max(v, 1, key=v)", "cannot use"),
    ],
)
def test_a_wrong_function_is_refused_by_name(expression, says):
    with pytest.raises(InputError, match=says):
        evaluate(expression, {"v": np.array([5.0, 10.0])}, "test")
