"""Inputs that drive a limited loop furthest: by finite differences, and exact where nothing is cut off."""

import numpy as np
import pytest

from lpvguard.engine.synthesis import limited_history
from lpvguard.engine.synthesis.limited_history import AIMS, LimitedHistory
from lpvguard.engine.synthesis.statespace import StateSpace

T, U_MAX = 25, 1.0


def loop() -> StateSpace:
    """From [p; w1; w2] to [u; z1; z2]; the demand has no direct term."""
    random = np.random.default_rng(2)
    A = random.standard_normal((4, 4))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    B, C, D = random.standard_normal((4, 3)), random.standard_normal((3, 4)), random.standard_normal((3, 3))
    B[:, 0] *= 0.1
    D[0] = 0.0
    return StateSpace(A, B, C, D, 0.1)


def limit_itself(w: np.ndarray, u_max: float) -> tuple[np.ndarray, np.ndarray]:
    """The same run by q, the part of the demand that is cut off: p = 2 q - u."""
    G, x, u, z = loop(), np.zeros(4), [], []
    for now in w:
        wanted = float(G.C[0] @ x)
        q = wanted - np.clip(wanted, -u_max, u_max)
        inputs = np.r_[2 * q - wanted, now]
        u.append(wanted)
        z.append((G.C @ x + G.D @ inputs)[1:])
        x = G.A @ x + G.B @ inputs
    return np.array(u), np.array(z)


@pytest.mark.parametrize("u_max", [0.5, 100.0])
def test_a_run_is_that_of_the_limit_and_its_gradient_that_of_finite_differences(u_max):
    one, random = LimitedHistory(loop(), u_max), np.random.default_rng(3)
    w, by_u, by_z = (random.standard_normal(shape) for shape in ((T, 2), (T,), (T, 2)))
    u, z = one.run(w)
    assert (u_max < 1) == bool((np.abs(u) > u_max).any())
    for computed, wanted in zip((u, z), limit_itself(w, u_max), strict=True):
        assert computed == pytest.approx(wanted)
    slope, step = one.gradient(u, by_u, by_z), 1e-6

    def value(w: np.ndarray) -> float:
        u, z = one.run(w)
        return float(by_u @ u + np.sum(by_z * z))

    for k, j in ((0, 0), (7, 1), (T - 2, 0), (T - 1, 1)):
        moved = np.zeros((T, 2))
        moved[k, j] = step
        assert slope[k, j] == pytest.approx((value(w + moved) - value(w - moved)) / (2 * step), abs=1e-5)


@pytest.mark.parametrize("aim", AIMS)
def test_where_nothing_is_cut_off_the_furthest_is_that_of_the_linear_loop(aim, monkeypatch):
    """Demand and step in one climb; the gain as a power iteration does, from below."""
    one = LimitedHistory(loop(), 1e6)
    inputs = np.eye(T * 2).reshape(T * 2, T, 2)
    runs = [one.run(w) for w in inputs]
    exact = {
        "demand": 3 * np.linalg.norm([u[-1] for u, _ in runs]),
        "step": 3 * np.linalg.norm([u[-1] - u[-2] for u, _ in runs]),
        "gain": np.linalg.norm(np.array([z.ravel() for _, z in runs]), 2),
    }
    reached, w = one.furthest(aim, 3.0, np.random.default_rng(4).standard_normal((T, 2)))
    assert np.linalg.norm(w) == pytest.approx(3)
    if aim == "gain":
        assert 0.95 * exact[aim] < reached < exact[aim]
        monkeypatch.setattr(limited_history, "CLIMBS", 300)
        reached = one.furthest(aim, 3.0, w)[0]
    assert reached == pytest.approx(exact[aim], rel=2e-3 if aim == "gain" else 1e-9)


def test_beyond_the_limit_what_is_reached_was_run_and_is_no_less_than_at_the_start():
    one, start = LimitedHistory(loop(), 0.5), np.random.default_rng(5).standard_normal((T, 2))
    reached, w = one.furthest("demand", 4.0, start)
    assert abs(one.run(w)[0][-1]) == pytest.approx(reached)
    first = 4.0 * start / np.linalg.norm(start)
    assert reached > abs(one.run(first)[0][-1])


def test_at_the_limit_itself_nothing_is_cut_off():
    one = LimitedHistory(loop(), U_MAX)
    by_u, by_z = np.ones(3), np.ones((3, 2))
    within, beyond = (one.gradient(np.full(3, u), by_u, by_z) for u in (0.5, 1.5))
    np.testing.assert_array_equal(one.gradient(np.array([U_MAX, -U_MAX, 0.0]), by_u, by_z), within)
    assert not np.allclose(within, beyond)


@pytest.mark.parametrize(
    ("steps", "runs"), [([1.0] * 5, 2), ([1.0, 1 + 1e-5], 2), ([1.0, 1 + 1.1e-5, 1.0], 3)]
)
def test_a_climb_ends_where_it_gains_no_more_than_a_hundred_thousandth(steps, runs, monkeypatch):
    one, values = LimitedHistory(loop(), 0.5), iter(steps)
    tried = []
    monkeypatch.setattr(limited_history, "_aimed", lambda aim, u, z, size: tried.append(u) or next(values))
    reached, w = one.furthest("demand", 4.0, np.ones((T, 2)))
    assert len(tried) == runs and reached == max(steps[: runs - 1])
    np.testing.assert_array_equal(one.run(w)[0], tried[runs - 2])


def test_a_climb_ends_after_twelve_runs(monkeypatch):
    one, values = LimitedHistory(loop(), 0.5), iter(range(1, 100))
    monkeypatch.setattr(limited_history, "_aimed", lambda aim, u, z, size: next(values))
    assert one.furthest("demand", 4.0, np.ones((T, 2)))[0] == 12


def test_a_demand_below_zero_counts_by_its_size(monkeypatch):
    monkeypatch.setattr(limited_history, "CLIMBS", 1)
    one, start = LimitedHistory(loop(), 0.5), np.random.default_rng(5).standard_normal((T, 2))
    furthest = [one.furthest(aim, 4.0, sign * start)[0] for aim in ("demand", "step") for sign in (1, -1)]
    assert furthest[0] == furthest[1] > 0 and furthest[2] == furthest[3] > 0
