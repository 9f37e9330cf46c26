"""Invariances of the validation engine, on drawn problems (fixed draws: a failure repeats)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lpvguard.engine.blocks import Block
from lpvguard.engine.validation import lft, s1
from lpvguard.engine.validation.delta import split
from lpvguard.engine.validation.problem import Lft, parametrise

SEEDS = st.integers(0, 2**32 - 1)
fast = settings(derandomize=True, max_examples=150, deadline=None)
slow = settings(derandomize=True, max_examples=12, deadline=None)


def gauss(rng, *shape):
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)


def unitary(rng, n):
    return np.linalg.qr(gauss(rng, n, n))[0]


def s1_point(seed, n_y):
    rng = np.random.default_rng(seed)
    e, z = gauss(rng, n_y), gauss(rng, n_y) * 10.0 ** rng.uniform(-3, 3)
    b1 = float(s1.solve(e, z, 0.0).b1)
    return rng, e, z, b1 + rng.uniform(0.01, 1.1) * (np.linalg.norm(e) - b1)


@fast
@given(SEEDS, st.integers(1, 4))
def test_s1_scaling_permutation_and_unitary_invariance(seed, n_y):
    rng, e, z, gamma = s1_point(seed, n_y)
    base = s1.solve(e, z, gamma)
    a, b = (10.0 ** rng.uniform(-6, 6) * np.exp(2j * np.pi * rng.uniform()) for _ in range(2))
    scaled = s1.solve(a * e, b * z, abs(a) * gamma)
    np.testing.assert_allclose(scaled.nu, base.nu * abs(a / b), rtol=1e-9, atol=1e-14 * abs(a / b))
    np.testing.assert_allclose(scaled.b1, base.b1 * abs(a), rtol=1e-9, atol=1e-14 * abs(a))
    order, u = rng.permutation(n_y), unitary(rng, n_y)
    for turned in (s1.solve(e[order], z[order], gamma), s1.solve(u @ e, u @ z, gamma)):
        np.testing.assert_allclose(turned.nu, base.nu, rtol=1e-8, atol=1e-12 / np.linalg.norm(z))
        np.testing.assert_allclose(turned.b1, base.b1, rtol=1e-8, atol=1e-13)


@fast
@given(SEEDS, st.integers(1, 4))
def test_s1_nu_falls_as_gamma_grows_and_b1_is_the_edge(seed, n_y):
    _, e, z, _ = s1_point(seed, n_y)
    b1 = float(s1.solve(e, z, 0.0).b1)
    nu = s1.solve(e, z, np.linspace(b1, 1.05 * np.linalg.norm(e), 40)).nu
    assert np.all(np.isfinite(nu)) and np.all(np.diff(nu) <= 1e-12 * nu[0])
    assert nu[-1] == 0.0
    if b1 > 0.0:
        assert not s1.solve(e, z, b1 * (1 - 1e-9)).feasible


@fast
@given(SEEDS, st.integers(1, 4))
def test_s1_and_margin_never_exceed_the_truth(seed, n_y):
    rng = np.random.default_rng(seed)
    delta, z = rng.uniform(0, 0.5) * np.exp(2j * np.pi * rng.uniform()), gauss(rng, n_y)
    w = 0.2 * gauss(rng, n_y)
    e = delta * z + w
    assert s1.solve(e, z, np.linalg.norm(w) * (1 + 1e-12)).nu <= abs(delta) * (1 + 1e-9) + 1e-12
    assert s1.margin(e, z, abs(delta), np.abs(w)) <= 1 + 1e-9


@pytest.mark.unhurried
@fast
@given(SEEDS, st.integers(1, 4))
def test_margin_is_homogeneous_monotone_and_order_free(seed, n_y):
    rng = np.random.default_rng(seed)
    e, z = gauss(rng, n_y), gauss(rng, n_y)
    w_delta, w_w, a = rng.uniform(0.01, 1), rng.uniform(0.01, 1, n_y), 10.0 ** rng.uniform(-5, 5)
    t = float(s1.margin(e, z, w_delta, w_w))
    order = rng.permutation(n_y)
    np.testing.assert_allclose(s1.margin(e[order], z[order], w_delta, w_w[order]), t, rtol=1e-10)
    np.testing.assert_allclose(s1.margin(a * e, a * z, w_delta, a * w_w), t, rtol=1e-10)
    np.testing.assert_allclose(s1.margin(e, z, a * w_delta, a * w_w), t / a, rtol=1e-10)
    assert s1.margin(e, z, 1.3 * w_delta, w_w) <= t * (1 + 1e-12)
    assert s1.margin(e, z, w_delta, w_w * rng.uniform(1, 2, n_y)) <= t * (1 + 1e-12)


def lft_point(seed):
    """Two full blocks with P12 and a square P22, simulated from a known Delta and w."""
    rng = np.random.default_rng(seed)
    blocks = (Block("full", 1, 1), Block("full", 2, 2))
    n_y = int(rng.integers(1, 4))
    p11, p12, p21, eta0 = 0.2 * gauss(rng, 3, 3), 0.2 * gauss(rng, 3, n_y), gauss(rng, n_y, 3), gauss(rng, 3)
    d = np.zeros((3, 3), complex)
    d[0, 0], inner = 0.3 * rng.uniform() * np.exp(2j * np.pi * rng.uniform()), gauss(rng, 2, 2)
    d[1:, 1:] = inner * (0.3 * rng.uniform() / np.linalg.norm(inner, 2))
    w = gauss(rng, n_y)
    w *= 0.1 / np.linalg.norm(w)
    eta = np.linalg.solve(np.eye(3) - p11 @ d, p12 @ w + eta0)
    e = p21 @ d @ eta + w
    return (
        rng,
        Lft(blocks, p11, p12, p21, np.eye(n_y, dtype=complex), eta0, e),
        abs(d[0, 0]),
        np.linalg.norm(d[1:, 1:], 2),
    )


@pytest.mark.unhurried
@slow
@given(SEEDS)
def test_lft_unitary_and_scaling_invariance(seed):
    rng, p, _, _ = lft_point(seed)
    gamma = 0.5 * np.linalg.norm(p.e)
    base = lft.optimum(p, gamma, [1.0, 1.0])
    # Unitary changes of y and w together, of the second block's xi and eta, and a common unit of all outputs.
    q, left, right, a = (
        unitary(rng, p.e.size),
        np.eye(3, dtype=complex),
        np.eye(3, dtype=complex),
        10.0 ** rng.uniform(-4, 4),
    )
    left[1:, 1:], right[1:, 1:] = unitary(rng, 2), unitary(rng, 2)
    turned = Lft(
        p.blocks,
        right @ p.p11 @ left.conj().T,
        right @ p.p12 @ q.conj().T / a,
        a * q @ p.p21 @ left.conj().T,
        q @ p.p22 @ q.conj().T,
        right @ p.eta0,
        a * q @ p.e,
    )
    other = lft.optimum(turned, a * gamma, [1.0, 1.0])
    assert other.lower <= base.upper * (1 + 1e-6) + 1e-14 and base.lower <= other.upper * (1 + 1e-6) + 1e-14
    # Scaling a block's input by c divides its size by c.
    c = rng.uniform(0.2, 5.0)
    stretch = np.diag([1.0, c, c])
    stretched = Lft(p.blocks, stretch @ p.p11, stretch @ p.p12, p.p21, p.p22, stretch @ p.eta0, p.e)
    scaled = lft.optimum(stretched, gamma, [1.0, c**2])
    assert scaled.lower <= base.upper * (1 + 1e-6) + 1e-14 and base.lower <= scaled.upper * (1 + 1e-6) + 1e-14


@pytest.mark.unhurried
@slow
@given(SEEDS)
def test_lft_falls_as_gamma_grows_and_never_exceeds_the_truth(seed):
    _, p, nu_1, nu_2 = lft_point(seed)
    true = nu_1**2 + nu_2**2
    last = np.inf
    for gamma in (0.1, 0.15, 0.25):
        s = lft.optimum(p, gamma * (1 + 1e-9), [1.0, 1.0])
        assert s.lower <= s.upper <= true * (1 + 1e-6)
        assert s.upper - s.lower <= 1e-3 * s.upper
        assert s.lower <= last * (1 + 1e-9)
        last = s.upper


@pytest.mark.unhurried
@slow
@given(SEEDS)
def test_every_returned_delta_re_simulates_the_data(seed):
    _, p, _, _ = lft_point(seed)
    s = lft.optimum(p, 0.11, [1.0, 0.5])
    d = np.zeros((3, 3), complex)
    d[:1, :1], d[1:, 1:] = s.verification.deltas
    eta = np.linalg.solve(np.eye(3) - p.p11 @ d, p.p12 @ s.w + p.eta0)
    np.testing.assert_allclose(p.p21 @ (d @ eta) + p.p22 @ s.w, p.e, atol=1e-7 * np.linalg.norm(p.e))
    for block, xi, inner, nu in zip(
        p.blocks, split(p.blocks, d @ eta, "rows"), split(p.blocks, eta, "cols"), s.nu, strict=True
    ):
        assert np.linalg.norm(xi) <= nu * np.linalg.norm(inner) * (1 + 1e-6) + 1e-12, block
    assert np.linalg.norm(s.w) <= 0.11 * (1 + 1e-8)


@pytest.mark.unhurried
@slow
@given(SEEDS)
def test_random_explanations_are_never_below_the_certified_bound(seed):
    rng, p, _, _ = lft_point(seed)
    gamma = 0.2
    s = lft.optimum(p, gamma, [1.0, 1.0])
    par = parametrise(p)
    d = par.xi_map.shape[1] - 1
    for _ in range(300):
        z = gauss(rng, d) * 10.0 ** rng.uniform(-2, 1)
        room = np.sqrt(max(gamma**2 - par.b1**2, 0.0)) * rng.uniform()
        z[: par.n_phi] *= room / np.linalg.norm(z[: par.n_phi])
        z = np.append(z, 1.0)
        sizes = [
            np.linalg.norm(a @ z) / np.linalg.norm(b @ z)
            for a, b in zip(
                split(p.blocks, par.xi_map, "rows"), split(p.blocks, par.eta_map, "cols"), strict=True
            )
        ]
        assert sizes[0] ** 2 + sizes[1] ** 2 >= s.lower * (1 - 1e-9)
