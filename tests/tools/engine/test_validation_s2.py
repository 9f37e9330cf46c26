"""Class S2: certified sizes of an uncertainty of input and state, compared with scans and with the general
solver."""

from dataclasses import replace

import numpy as np
import pytest

from lft_problems import gauss
from lpvguard.base.errors import InputError
from lpvguard.engine.blocks import Block
from lpvguard.engine.validation import lft, s2
from lpvguard.engine.validation.problem import Lft
from lpvguard.extras.bench.validation import truck_points

S2_KEYS = ("e", "u", "x_nom", "h_i", "h_s", "c", "gamma_w")


def test_s2_on_truck_data_is_certified_and_attained():
    data = truck_points(4, 64, seed=5)
    r = s2.solve(*(data[k] for k in S2_KEYS))
    assert not r.at_cap.any()
    assert np.all(r.upper - r.lower <= 1.01e-4 * r.upper)
    np.testing.assert_allclose(r.nu_i**2 + r.nu_s**2, r.upper, rtol=1e-7)
    to_d = np.concatenate([data["h_i"][:, :, None], data["h_s"]], axis=2)
    d = (to_d @ r.xi[:, :, None])[:, :, 0]
    np.testing.assert_allclose(d @ data["c"].T + r.w, data["e"], atol=1e-9 * np.abs(data["e"]).max())
    assert np.all(np.linalg.norm(r.w, axis=1) <= data["gamma_w"] * (1 + 1e-9))
    eta = np.linalg.norm(data["x_nom"] + d, axis=1)
    np.testing.assert_allclose(np.linalg.norm(r.xi[:, 1:], axis=1), r.nu_s * eta, rtol=1e-9)


def test_s2_matches_a_scan_of_semidefinite_relaxations():
    cp = pytest.importorskip("cvxpy")
    data = truck_points(2, 8, seed=3)
    r = s2.solve(*(data[k] for k in S2_KEYS))
    for k in (2, 11):
        gain = np.column_stack([data["h_i"][k], data["h_s"][k]])
        m = data["c"] @ gain
        scale = np.linalg.norm(data["e"][k]) / np.linalg.norm(m, axis=0)
        w_map = np.column_stack([-m * scale, data["e"][k]]) / data["gamma_w"][k]
        eta = np.column_stack([gain * scale, data["x_nom"][k]])
        xi_i, xi_s = np.zeros((1, 5)), np.zeros((3, 5))
        xi_i[0, 0], xi_s[:, 1:4] = scale[0] / abs(data["u"][k]), np.diag(scale[1:])
        # Orthonormal coordinates: with the raw ones the conic solver fails.
        _, whiten = np.linalg.qr(
            np.vstack([xi_i * abs(data["u"][k]) / scale[0], xi_s / scale[1:, None], w_map])
        )
        maps = [m @ np.linalg.inv(whiten) for m in (xi_i, w_map, xi_s, eta, np.eye(5)[4:])]
        first, ball, block, inner, one = (a.conj().T @ a for a in maps)
        unit = r.upper[k]

        def least(nu, first=first, ball=ball, block=block, inner=inner, one=one, unit=unit):
            x = cp.Variable((5, 5), hermitian=True)
            limits = [x >> 0, cp.real(cp.trace(one @ x)) == 1, cp.real(cp.trace(ball @ x)) <= 1]
            limits.append(cp.real(cp.trace((block - nu**2 * inner) @ x)) / np.trace(block).real <= 0)
            try:
                value = cp.Problem(cp.Minimize(cp.real(cp.trace((first / unit) @ x))), limits).solve(
                    solver=cp.CLARABEL
                )
            except (
                cp.SolverError
            ):  # where nu is too small for any explanation it gives up instead of saying so
                return np.inf
            return value * unit + nu**2

        scan = [least(r.nu_s[k] * factor) for factor in (0.8, 0.95, 1.0, 1.05, 1.25, 2.0)]
        assert min(scan) >= r.lower[k] * (1 - 1e-4), "no point of the scan may lie below the certified bound"
        assert scan[2] <= r.upper[k] * (1 + 1e-3)


def square(m: np.ndarray) -> np.ndarray:
    return m.conj().T @ m


def drawn(seed: int, n: int, unit: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Forms (4, n, n) of :func:`s2.solve_forms` and a point (n,) inside their ball, of cost ``unit``."""
    rng = np.random.default_rng(seed)
    cost, ball, a, b = (square(gauss(rng, r, n)) for r in (1 + seed % 3, 2, n - 1, n - 1))
    z = np.append(gauss(rng, n - 1), 1.0)
    at = [np.vdot(z, q @ z).real for q in (cost, ball, a, b)]
    ball[-1, -1] -= at[1] * rng.uniform(1.0001, 2.0)
    b *= 10.0 ** rng.uniform(-1.0, 1.0)
    size = (at[2] / np.vdot(z, b @ z).real + at[0]) / unit
    return np.stack([cost / size, ball, a, b * size]), z


@pytest.mark.parametrize(
    ("q0", "qw", "a", "b", "size"),
    [
        (0.5, 0.0, 3.0, 2.0, 1.5),
        (0.5, -1.0, 0.0, 2.0, 0.0),
        (0.5, -1.0, -3.0, 2.0, 0.0),
        (0.5, -1.0, 0.0, 0.0, 0.0),
        (0.5, -1.0, 20.0, 2.0, 10.0),
        (0.5, 1e-9, 3.0, 2.0, np.inf),
        (0.5, -1.0, 20.1, 2.0, np.inf),
        (0.5, -1.0, 1e-9, 0.0, np.inf),
        (0.5, -1.0, 3.0, -2.0, np.inf),
    ],
)
def test_s2_a_point_counts_inside_the_ball_and_up_to_the_cap(q0, qw, a, b, size):
    """Forms with these values at every point, and a cap of 10. They have no dual: no size is excluded."""
    forms = np.stack([np.diag([0.0, value]) for value in (q0, qw, a, b)])
    answer = s2.solve_forms(forms[None], [[0.3j, 1.0]], 10.0)
    assert answer.upper == pytest.approx(size + q0)
    assert answer.p == pytest.approx(size if np.isfinite(size) else 0.0)
    assert answer.lower == 0.0 and answer.duals == 240


def test_s2_and_the_general_solver_agree():
    data = truck_points(2, 3, seed=2)
    r = s2.solve(*(data[k] for k in S2_KEYS))
    for k in range(len(data["u"])):
        p11 = np.zeros((4, 4), complex)
        p11[1:] = np.column_stack([data["h_i"][k], data["h_s"][k]])
        problem = Lft(
            (Block("full", 1, 1), Block("full", 3, 3)),
            p11,
            np.zeros((4, 2), complex),
            data["c"] @ p11[1:],
            np.eye(2, dtype=complex),
            np.append(data["u"][k], data["x_nom"][k]),
            data["e"][k],
        )
        s = lft.optimum(problem, data["gamma_w"][k], [1.0, 1.0])
        assert s.lower <= r.upper[k] * (1 + 1e-9) and r.lower[k] <= s.upper * (1 + 1e-9)
        assert s.upper == pytest.approx(r.upper[k], rel=3e-4)


def test_s2_marks_points_that_only_the_cap_stops():
    data = truck_points(2, 20, seed=11)
    args = [np.array(data[k]) for k in S2_KEYS]
    assert not s2.solve(*args).at_cap.any()
    args[0], args[-1] = 100 * args[0], 100 * args[-1]
    r = s2.solve(*args)
    cap = 1.0 / np.linalg.norm(data["h_s"], 2, axis=(1, 2))
    assert r.at_cap.any() and not r.at_cap.all()
    assert np.all(r.nu_s[~r.at_cap] < s2.NEAR_CAP * cap[~r.at_cap])
    k = int(np.argmax(r.at_cap))
    p11 = np.zeros((4, 4), complex)
    p11[1:] = np.column_stack([data["h_i"][k], data["h_s"][k]])
    problem = Lft(
        (Block("full", 1, 1), Block("full", 3, 3)),
        p11,
        np.zeros((4, 2), complex),
        data["c"] @ p11[1:],
        np.eye(2, dtype=complex),
        np.append(data["u"][k], data["x_nom"][k]),
        args[0][k],
    )
    with pytest.raises(InputError, match="cap"):
        lft.optimum(problem, args[-1][k], [1.0, 1.0])


def test_s2_is_exactly_zero_where_the_disturbance_explains_all():
    data = truck_points(1, 6, seed=4)
    args = [np.array(data[k]) for k in S2_KEYS]
    args[-1][2] = 1.01 * np.linalg.norm(args[0][2])
    r = s2.solve(*args)
    assert r.upper[2] == r.lower[2] == r.nu_i[2] == r.nu_s[2] == 0.0 and np.all(r.upper[[0, 1, 3, 4, 5]] > 0)
    np.testing.assert_array_equal(r.w[2], args[0][2])


def test_s2_names_the_bad_point():
    data = truck_points(1, 4, seed=0)
    args = [np.array(data[k]) for k in S2_KEYS]
    args[0][2, 1] = np.nan
    with pytest.raises(InputError, match="e, point 2"):
        s2.solve(*args)
    names = [f"drive {k // 2}, {1.5 + k % 2} rad/s" for k in range(len(args[0]))]
    with pytest.raises(InputError, match=r"e, drive 1, 1\.5 rad/s: a value that is not finite"):
        s2.solve(*args, names=names)
    for slot, value, what in ((1, 0.0, "u"), (6, -1.0, "gamma_w")):
        bad = [np.array(data[k]) for k in S2_KEYS]
        bad[slot][3] = value
        with pytest.raises(InputError, match=f"{what}, drive 1, 2.5 rad/s"):
            s2.solve(*bad, names=names)
    with pytest.raises(InputError, match="names"):
        s2.solve(*[np.array(data[k]) for k in S2_KEYS], names=names[1:])
    args = [np.array(data[k]) for k in S2_KEYS]
    with pytest.raises(InputError, match=r"x_nom|h_i"):
        s2.solve(*args[:3], args[3][:, :2], *args[4:])


# --- the parts of :func:`s2.solve` ---


def data_of(points: int = 3, n_x: int = 2, n_y: int = 3, seed: int = 3) -> s2._Data:
    rng = np.random.default_rng(seed)
    e, x_nom, c = gauss(rng, points, n_y), gauss(rng, points, n_x), gauss(rng, n_y, n_x)
    gamma, lam_i, lam_s = (rng.uniform(0.5, 2.0, points) for _ in range(3))
    return s2._Data(
        e,
        gauss(rng, points),
        x_nom,
        gauss(rng, points, n_x),
        gauss(rng, points, n_x, n_x),
        c,
        gamma,
        lam_i,
        lam_s,
    )


def signals_at(data: s2._Data, maps: s2._Maps, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """xi, w and eta (K, .) at ``z`` (K, n), which is checked to solve the equations."""
    xi, w, eta = (np.einsum("kij,kj->ki", m, z) for m in (maps.xi, maps.w, maps.eta))
    d = data.h_i * xi[:, :1] + np.einsum("kij,kj->ki", data.h_s, xi[:, 1:])
    np.testing.assert_allclose(w, data.e - d @ data.c.T, atol=1e-11)
    np.testing.assert_allclose(eta, data.x_nom + d, atol=1e-11)
    return xi, w, eta


def points_for(data: s2._Data, seed: int = 8) -> np.ndarray:
    points, n_x = data.x_nom.shape
    return np.column_stack([gauss(np.random.default_rng(seed), points, n_x + 1), np.ones(points)])


@pytest.mark.parametrize("unit", [1.0, 1e6])
def test_s2_has_coordinates_in_which_all_signals_together_are_a_sphere(unit):
    """|.|^2 of what each signal does to e, or to gamma_w where that is more, and of w over gamma_w: |theta|^2
    beside a constant."""
    data = data_of()
    data = replace(data, h_s=unit * data.h_s, e=data.e * [[0.01], [2.0], [2.0]])
    maps = s2._Maps.from_data(data)
    size_e = np.linalg.norm(data.e, axis=1)
    assert (size_e < data.gamma).tolist() == [True, False, False]
    size_e[0] = data.gamma[0]
    share_i = np.linalg.norm(data.h_i @ data.c.T, axis=1) / size_e
    share_s = np.linalg.norm(data.c @ data.h_s, axis=(1, 2)) / size_e

    def size(z: np.ndarray) -> np.ndarray:
        xi, w, _ = signals_at(data, maps, z)
        parts = [xi[:, :1] * share_i[:, None], xi[:, 1:] * share_s[:, None], w / data.gamma[:, None]]
        return np.sum(np.abs(np.hstack(parts)) ** 2, axis=1)

    centre = points_for(data) * [0.0, 0.0, 0.0, 1.0]
    for seed in range(3):
        z = points_for(data, seed)
        want = np.sum(np.abs(z[:, :-1]) ** 2, axis=1) + size(centre)
        np.testing.assert_allclose(size(z), want, rtol=1e-8)


def test_s2_puts_its_problem_in_units_of_what_the_start_costs():
    data = data_of()
    maps, start, z = s2._Maps.from_data(data), points_for(data, 1), points_for(data, 2)
    xi, _, eta = signals_at(data, maps, start)
    price = data.lam_i / np.abs(data.u) ** 2
    block = np.sum(np.abs(xi[:, 1:]) ** 2, axis=1) / np.sum(np.abs(eta) ** 2, axis=1)
    forms, cost = s2._problem(data, maps, start)
    np.testing.assert_allclose(cost, price * np.abs(xi[:, 0]) ** 2 + data.lam_s * block, rtol=1e-10)
    xi, w, eta = signals_at(data, maps, z)
    quadratic, ball, a, b = np.einsum("ki,kfij,kj->fk", z.conj(), forms, z).real
    np.testing.assert_allclose(quadratic * cost, price * np.abs(xi[:, 0]) ** 2, rtol=1e-10)
    np.testing.assert_allclose(ball, np.sum(np.abs(w) ** 2, axis=1) / data.gamma**2 - 1, rtol=1e-10)
    # lambda_s nu_s^2 = p times the cost is a p at which the block's form is zero.
    nu = np.sum(np.abs(xi[:, 1:]) ** 2, axis=1) / np.sum(np.abs(eta) ** 2, axis=1)
    np.testing.assert_allclose(a / b * cost, data.lam_s * nu, rtol=1e-10)
    np.testing.assert_allclose(np.trace(forms[:, 2], axis1=1, axis2=2), 1.0)
    _, dearer = s2._problem(data, replace(maps, eta=1e-3 * maps.eta), start)
    np.testing.assert_allclose(dearer - cost, (1e6 - 1) * data.lam_s * block, rtol=1e-10)
    # What costs nothing at the start has a unit of one, and what has no state costs no division.
    still = replace(maps, xi=maps.xi * [[1.0] * 3 + [0.0]], eta=maps.eta * [[1.0] * 3 + [0.0]])
    with np.errstate(all="raise"):
        forms, cost = s2._problem(data, still, points_for(data) * [0.0, 0.0, 0.0, 1.0])
    np.testing.assert_array_equal(cost, 1.0)
    np.testing.assert_allclose(
        np.einsum("ki,kij,kj->k", z.conj(), forms[:, 0], z).real,
        price * np.abs(np.einsum("kj,kj->k", still.xi[:, 0], z)) ** 2,
        rtol=1e-10,
    )


def test_s2_starts_on_the_rim_of_the_ball_on_the_way_to_the_least_disturbance():
    rng = np.random.default_rng(4)
    maps = gauss(rng, 5, 4, 3)
    maps[3, :, 1] = 2j * maps[3, :, 0]  # one direction
    maps[4, :, :2] = 0.0  # none
    none, pinv = np.linalg.norm(maps[:, :, -1], axis=1), np.linalg.pinv(maps[:, :, :2], rcond=1e-9)
    theta = -np.einsum("kij,kj->ki", pinv, maps[:, :, -1])
    least = np.linalg.norm(np.einsum("kij,kj->ki", maps[:, :, :2], theta) + maps[:, :, -1], axis=1)
    for share in (0.2, 0.7):
        gamma = least + share * (none - least)
        b1, z = s2._inside_ball(maps[:4], gamma[:4])
        np.testing.assert_allclose(b1, least[:4], rtol=1e-12)
        size = np.linalg.norm(np.einsum("kij,kj->ki", maps[:4], z), axis=1)
        left = np.sqrt((size - b1) * (size + b1) / ((gamma[:4] - b1) * (gamma[:4] + b1)))
        np.testing.assert_allclose(1 - left, 1e-9, atol=1e-13)
        fraction = np.einsum("ki,ki->k", z[:, :2], theta[:4].conj()) / np.sum(np.abs(theta[:4]) ** 2, axis=1)
        np.testing.assert_allclose(z[:, :2], fraction[:, None] * theta[:4], atol=1e-12)
        assert np.all((fraction.real > 0) & (fraction.real < 1)) and np.all(z[:, 2] == 1.0)
    with np.errstate(all="raise"):
        b1, z = s2._inside_ball(maps, 1.1 * none)
    np.testing.assert_allclose(b1, least, rtol=1e-12)
    np.testing.assert_array_equal(z, 5 * [[0.0, 0.0, 1.0]])
    # No more than the least, or less: all the way.
    one = np.array([[[1.0, 0.0, 2.0], [0.0, 1.0, 3.0], [0.0, 0.0, 4.0]]], complex)
    for gamma in (4.0, 3.0):
        b1, z = s2._inside_ball(one, np.array([gamma]))
        assert b1 == 4.0
        np.testing.assert_allclose(z, [[-2.0, -3.0, 1.0]])
    # A ball of just the size of w without any signal: none of the way.
    b1, z = s2._inside_ball(np.array([[[1.0, 4.0], [0.0, 3.0]]], complex), np.array([5.0]))
    assert b1 == 3.0 and not z[0, 0] and z[0, 1] == 1.0


@pytest.mark.parametrize("weak, b1", [(1.1e-12, 0.0), (0.9e-12, 1.0)])
def test_s2_a_direction_of_less_than_a_trillionth_moves_no_disturbance(weak, b1):
    maps = np.array([[[1.0, 0.0, 1.0], [0.0, weak, 1.0]]], complex)
    inside, z = s2._inside_ball(maps, np.array([1.2]))
    assert inside == pytest.approx(b1, abs=1e-9)
    assert (abs(z[0, 1]) > 1.0) == (b1 == 0.0)


def answered(monkeypatch, data: s2._Data, **named) -> tuple[s2.S2Result, tuple, np.ndarray]:
    """What :func:`s2.solve` makes of an answer of its kernel, what it asked, and the points of the answer.

    The answer lies between 0.8 and 0.9 of the start's cost, at points beside the start.
    """
    asked = []

    def kernel(forms, start, p_max, *, gap):
        asked.append((forms, start, p_max, gap))
        k = len(start)
        z = start + 0.1 * np.append(np.ones(start.shape[1] - 1), 0.0)
        upper = np.full(k, 0.9)
        upper[named.get("lost", [])] = np.inf
        return s2.FormsResult(upper * named.get("low", 0.9), upper, np.zeros(k), z, np.arange(k) + 7)

    monkeypatch.setattr(s2, "solve_forms", kernel)
    gap = {"gap": named["gap"]} if "gap" in named else {}
    arguments = (data.e, data.u, data.x_nom, data.h_i, data.h_s, data.c, data.gamma, data.lam_i, data.lam_s)
    return s2.solve(*arguments, **gap), asked[0], asked[0][1]


def test_s2_gives_back_what_its_kernel_found_and_nothing_where_no_disturbance_is_enough(monkeypatch):
    data = data_of(points=5)
    b1 = s2._inside_ball(s2._Maps.from_data(data).w, data.gamma)[0]
    gamma = 0.5 * (b1 + np.linalg.norm(data.e, axis=1))
    gamma[1] = 0.9 * b1[1]
    data = replace(data, gamma=gamma)
    with np.errstate(invalid="raise"):
        solution, (forms, start, p_max, gap), _ = answered(monkeypatch, data, lost=[2])
    maps, where = s2._Maps.from_data(data), [0, 2, 3, 4]
    assert gap == s2.GAP and len(forms) == 4
    want = s2._inside_ball(maps.w, gamma)[1]
    np.testing.assert_array_equal(start, want[where])
    all_forms, cost = s2._problem(data, maps, want)
    np.testing.assert_array_equal(forms, all_forms[where])
    cap = 1 / np.array([np.linalg.svd(h)[1][0] for h in data.h_s])
    np.testing.assert_allclose(p_max, (data.lam_s * cap**2 * (1 - 1e-9) / cost)[where], rtol=1e-12)
    z = want + 0.1 * np.array([1, 1, 1, 0])
    np.testing.assert_allclose(solution.upper, 0.9 * cost * [1, np.inf, 1, np.inf, 1], rtol=1e-14)
    np.testing.assert_allclose(solution.lower, 0.81 * cost * [1, np.inf, 1, np.inf, 1], rtol=1e-14)
    np.testing.assert_array_equal(solution.duals, [7, 0, 8, 9, 10])
    np.testing.assert_array_equal(solution.b1, s2._inside_ball(maps.w, gamma)[0])
    good = [0, 2, 4]
    xi, w, eta = signals_at(data, maps, z)
    np.testing.assert_allclose(solution.xi[good], xi[good], rtol=1e-12)
    np.testing.assert_allclose(solution.w[good], w[good], rtol=1e-12)
    np.testing.assert_allclose(solution.nu_i[good], (np.abs(xi[:, 0]) / np.abs(data.u))[good], rtol=1e-14)
    nu_s = np.linalg.norm(xi[:, 1:], axis=1) / np.linalg.norm(eta, axis=1)
    np.testing.assert_allclose(solution.nu_s[good], nu_s[good], rtol=1e-12)
    for array in (solution.xi, solution.w, solution.nu_i, solution.nu_s):
        assert np.isnan(array[[1, 3]]).all()
    assert solution.at_cap.tolist() == [True, False, True, True, True], "the bounds are not near"


def test_s2_says_at_the_cap_where_the_bounds_stay_apart_or_the_size_is_the_caps(monkeypatch):
    data = data_of(points=1, n_y=2)
    data = replace(data, gamma=0.9 * np.linalg.norm(data.e, axis=1), h_s=0.01 * data.h_s)
    for low, at_cap in ((1 - 0.99e-2, False), (1 - 1.01e-2, True)):
        solution, *_ = answered(monkeypatch, data, low=low, gap=1e-3)
        assert solution.at_cap.tolist() == [at_cap]
    one = replace(data, h_s=np.eye(2)[None].astype(complex))
    for share, at_cap in ((1.0, True), (1 + 1e-15, False)):
        monkeypatch.setattr(s2, "NEAR_CAP", share * answered(monkeypatch, one, low=1.0)[0].nu_s[0])
        assert answered(monkeypatch, one, low=1.0)[0].at_cap.tolist() == [at_cap]
    near = solution.nu_s[0] * np.linalg.norm(data.h_s[0], 2)
    for share, at_cap in ((0.99989, False), (0.99991, True)):
        # h_s over a factor and xi_s times it are the same d: the size over its cap is what counts.
        monkeypatch.setattr(s2, "NEAR_CAP", near / share * (1 - 1e-4))
        assert answered(monkeypatch, data, low=1.0)[0].at_cap.tolist() == [at_cap]


def test_s2_a_disturbance_of_all_that_is_allowed_explains_alone(monkeypatch):
    data = data_of(points=2, n_y=2)
    data = replace(data, e=np.array([[3.0, 4j], [3.0, 4.001j]]), gamma=np.full(2, 5.0))
    solution, *_ = answered(monkeypatch, data)
    assert (solution.lower[0], solution.upper[0], solution.nu_i[0], solution.nu_s[0]) == (0.0, 0.0, 0.0, 0.0)
    np.testing.assert_array_equal(solution.w[0], data.e[0])
    assert not solution.xi[0].any() and solution.upper[1] > 0.0 and not solution.at_cap[0]


def test_s2_takes_its_arguments_by_shape_and_names_each_that_is_not_positive_or_finite():
    data = data_of()
    data.check(None)
    data.check(["a", "b", "c"])
    for name in ("u", "x_nom", "h_i", "h_s", "c"):
        array = getattr(data, name)
        for axis in range(array.ndim):
            longer = np.concatenate([array, np.take(array, [0], axis)], axis)
            with pytest.raises(InputError, match=r"S2.*shape"):
                replace(data, **{name: longer}).check(None)
    for names in (["a", "b"], ["a", "b", "c", "d"]):
        with pytest.raises(InputError, match="one for each point"):
            data.check(names)
    places = {"e": "e", "u": "u", "x_nom": "x_nom", "h_i": "h_i", "h_s": "h_s", "gamma": "gamma_w"}
    for name, prefix in places.items():
        for bad in (np.nan, np.inf):
            spoiled = getattr(data, name).copy()
            spoiled.reshape(3, -1)[1, -1] = bad
            with pytest.raises(InputError, match=f"{prefix}, point 1: a value that is not finite"):
                replace(data, **{name: spoiled}).check(None)
            with pytest.raises(InputError, match=f"{prefix}, b: a value that is not finite"):
                replace(data, **{name: spoiled}).check(["a", "b", "c"])
    for name, prefix in (("gamma", "gamma_w"), ("lam_i", "lambda_i"), ("lam_s", "lambda_s")):
        for bad in (0.0, -1.0):
            spoiled = getattr(data, name).copy()
            spoiled[2] = bad
            with pytest.raises(InputError, match=f"{prefix}, point 2: zero or negative"):
                replace(data, **{name: spoiled}).check(None)
    replace(data, lam_i=0.5 * np.ones(3), gamma=1e-9 * np.ones(3), u=np.array([1e-9, 1, 1])).check(None)
    with pytest.raises(InputError, match="u, point 0: zero"):
        replace(data, u=np.array([0.0, 1, 1])).check(None)


def test_s2_a_least_disturbance_of_just_what_is_allowed_is_enough(monkeypatch):
    data, inside = data_of(), s2._inside_ball
    monkeypatch.setattr(s2, "_inside_ball", lambda w, gamma: (gamma.copy(), inside(w, gamma)[1]))
    assert np.isfinite(answered(monkeypatch, data)[0].upper).all()


def test_s2_takes_lists_and_a_point_without_an_error(monkeypatch):
    data = data_of()
    arguments = (data.e, data.u, data.x_nom, data.h_i, data.h_s, data.c, data.gamma)
    solution = answered(monkeypatch, replace(data, lam_i=np.ones(3), lam_s=np.ones(3)))[0]
    np.testing.assert_array_equal(s2.solve(*(a.tolist() for a in arguments)).upper, solution.upper)
    monkeypatch.undo()
    data.e[1] = 0.0
    with np.errstate(all="raise", under="ignore"):
        solution = s2.solve(*arguments)
    assert solution.lower[1] == solution.upper[1] == solution.nu_s[1] == 0.0 and solution.duals[1] == 1


def test_s2_prices_are_one_where_none_are_given(monkeypatch):
    data = replace(data_of(), lam_i=np.ones(3), lam_s=np.ones(3))
    solution = answered(monkeypatch, data)[0]
    arguments = (data.e, data.u, data.x_nom, data.h_i, data.h_s, data.c, data.gamma)
    np.testing.assert_array_equal(s2.solve(*arguments).upper, solution.upper)
    one = s2.solve(*arguments[:-1], 2.0)
    np.testing.assert_array_equal(one.upper, s2.solve(*arguments[:-1], np.full(3, 2.0)).upper)


def test_s2_kernel_takes_one_to_fifteen_free_variables_and_as_many_points_as_there_are():
    for n, fits in ((1, False), (2, True), (16, True), (17, False)):
        forms = np.zeros((1, 4, n, n), complex)
        forms[0, 0], forms[0, 1, -1, -1], forms[0, 3] = np.eye(n), -1.0, np.eye(n)
        start = np.zeros((1, n))
        start[0, -1] = 1.0
        if fits:
            assert s2.solve_forms(forms, start, 1.0).upper == pytest.approx(1.0)
        else:
            with pytest.raises(InputError, match=rf"free variables: {n - 1}: expected 1 to 15|{n - 1}"):
                s2.solve_forms(forms, start, 1.0)
    (first, one), (second, two) = drawn(0, 3), drawn(1, 3)
    forms, start = np.stack([first, second]), np.stack([one, two])
    kept = start.copy()
    both = s2.solve_forms(forms, start, [2.0, 0.9])
    np.testing.assert_array_equal(start, kept)
    for k, (form, z, p_max) in enumerate(((first, one, 2.0), (second, two, 0.9))):
        alone = s2.solve_forms(form[None], z[None], p_max, gap=s2.GAP)
        for field in ("lower", "upper", "p", "z", "duals"):
            np.testing.assert_array_equal(getattr(both, field)[k], getattr(alone, field)[0])
        a, b = (np.vdot(both.z[k], q @ both.z[k]).real for q in form[2:])
        assert both.p[k] == pytest.approx(a / b, rel=1e-9), "the size of the point"
        attained = both.p[k] + np.vdot(both.z[k], form[0] @ both.z[k]).real
        assert both.upper[k] == pytest.approx(attained, rel=1e-9)
        assert (1 - 1.01 * s2.GAP) * attained < both.lower[k] < both.upper[k]
        assert 2 <= both.duals[k] <= 240
    assert both.duals.dtype.kind == "i"
