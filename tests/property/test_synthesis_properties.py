"""Properties that hold for every system: norms bracket grids, γ bounds every certified loop, μ obeys its
axioms.
"""

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.hinf import hinf_synthesis
from lpvguard.engine.synthesis.mu import mu_bounds
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import StateSpace, gain, lft, series

seeds = st.integers(0, 2**32 - 1)
FULL = os.environ.get("LPVGUARD_FULL") == "1"
quick = settings(max_examples=40 if FULL else 20, deadline=None, derandomize=True)


def stable(seed, n, m, p, spread):
    rng = np.random.default_rng(seed)
    A = np.diag(-(10.0 ** rng.uniform(-spread, spread, n))) + np.triu(rng.standard_normal((n, n)), 1)
    return StateSpace(
        A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), rng.standard_normal((p, m))
    )


@pytest.mark.unhurried
@quick
@given(seeds, st.integers(1, 8), st.integers(1, 3), st.integers(1, 3), st.floats(0, 4))
def test_no_frequency_lies_above_the_bracket_and_one_attains_it(seed, n, m, p, spread):
    G = stable(seed, n, m, p, spread)
    bracket = hinf_norm(G)
    grid = np.linalg.norm(G.response(np.r_[0, np.geomspace(1e-6, 1e6, 2000), np.inf]), 2, axis=(1, 2)).max()
    assert grid <= bracket.upper * (1 + 1e-9) and bracket.upper <= bracket.lower * (1 + 1e-5)
    assert np.isclose(np.linalg.norm(G.response([bracket.peak_frequency])[0], 2), bracket.lower, rtol=1e-6)


@pytest.mark.unhurried
@quick
@given(seeds, st.integers(1, 5), st.floats(0.1, 10))
def test_the_norm_is_homogeneous_and_submultiplicative(seed, n, factor):
    G, H = stable(seed, n, 2, 2, 2), stable(seed + 1, n, 2, 2, 2)
    assert np.isclose(
        hinf_norm(series(gain(factor * np.eye(2)), G)).upper, factor * hinf_norm(G).upper, rtol=1e-5
    )
    assert hinf_norm(series(H, G)).lower <= hinf_norm(H).upper * hinf_norm(G).upper


@pytest.mark.unhurried
@settings(max_examples=15, deadline=None, derandomize=True)
@given(seeds, st.integers(1, 7), st.booleans())
def test_no_controller_beats_gamma_and_the_returned_one_comes_near(seed, n, discrete):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) / (np.sqrt(n) if discrete else 1)
    D = rng.standard_normal((4, 4))
    D[2:, 2:] = 0
    P = StateSpace(A, rng.standard_normal((n, 4)), rng.standard_normal((4, n)), D, 0.1 if discrete else 0)
    result = hinf_synthesis(P, 2, 2)
    K = result.controller
    assert hinf_norm(lft(P, K)).lower >= result.gamma * (1 - 1e-5)
    assert result.gamma_achieved <= 1.01 * result.gamma
    other = StateSpace(K.A, K.B * 1.01, K.C, K.D, K.dt)
    assert hinf_norm(lft(P, other)).upper >= result.gamma * (1 - 1e-5)


@pytest.mark.slow("5 s: mu of random matrices")
@quick
@given(seeds, st.floats(1e-3, 1e3))
def test_mu_is_homogeneous_invariant_to_scalings_and_between_radius_and_norm(seed, factor):
    rng = np.random.default_rng(seed)
    blocks = [Block("full", 1, 1), Block("full", 2, 2), Block("repeated_complex", 2, 2)]
    M = rng.standard_normal((5, 5)) + 1j * rng.standard_normal((5, 5))
    b = mu_bounds(M, blocks)
    assert b.lower <= b.upper <= np.linalg.norm(M, 2) * (1 + 1e-9)
    assert b.upper >= np.abs(np.linalg.eigvals(M)).max() * (1 - 1e-9)
    d = np.diag([factor, 1, 1, 1 / factor, 1 / factor])
    assert np.isclose(mu_bounds(d @ M @ np.linalg.inv(d), blocks).upper, b.upper, rtol=1e-6)
    assert np.isclose(mu_bounds(factor * M, blocks).upper, factor * b.upper, rtol=1e-6)


@settings(quick, max_examples=40 if FULL else 10)
@given(seeds)
@pytest.mark.slow("5 s: real mu of random matrices")
def test_a_real_scalar_is_never_worse_than_a_complex_one(seed):
    rng = np.random.default_rng(seed)
    M = rng.standard_normal((4, 4)) + 1j * rng.standard_normal((4, 4))
    real, free = ([Block(kind, 2, 2), Block("full", 2, 2)] for kind in ("repeated_real", "repeated_complex"))
    assert mu_bounds(M, real).upper <= mu_bounds(M, free).upper * (1 + 1e-6)
