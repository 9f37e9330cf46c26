"""Class S2: certified sizes of an uncertainty of input and state, compared with scans, with the general
solver and between engines."""

from __future__ import annotations

import numpy as np
import pytest

from lpvguard.base import native
from lpvguard.base.errors import InputError
from lpvguard.bench.validation import truck_points
from lpvguard.engine.blocks import Block
from lpvguard.engine.validation import lft, s2
from lpvguard.engine.validation.problem import Lft

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


def test_s2_engines_agree(monkeypatch):
    if native.kernels("s2") is None:
        pytest.skip("no C compiler: nothing to compare with")
    data = truck_points(2, 5, seed=9)
    compiled = s2.solve(*(data[k] for k in S2_KEYS))
    monkeypatch.setenv("LPVGUARD_NO_NATIVE", "1")
    plain = s2.solve(*(data[k] for k in S2_KEYS))
    np.testing.assert_allclose(compiled.upper, plain.upper, rtol=1e-4)
    assert np.all(plain.lower <= compiled.upper * (1 + 1e-9)) and np.all(
        compiled.lower <= plain.upper * (1 + 1e-9)
    )


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
