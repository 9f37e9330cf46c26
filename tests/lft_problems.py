"""Random matrices, validation problems of a known truth, and the explanation of one put back into it."""

import numpy as np

from lpvguard.engine.blocks import Block
from lpvguard.engine.validation import delta as dl
from lpvguard.engine.validation.problem import Lft
from lpvguard.engine.validation.quadratic import Form


def gauss(rng, *shape):
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)


def hermitian(rng: np.random.Generator, *shape: int) -> np.ndarray:
    a = gauss(rng, *shape, shape[-1])
    return a + a.conj().swapaxes(-1, -2)


def spd(random: np.random.Generator, n: int) -> np.ndarray:
    """A symmetric positive definite matrix."""
    X = random.standard_normal((n, n))
    return X @ X.T + 0.3 * np.eye(n)


def row(*entries: complex) -> np.ndarray:
    return np.array([entries], dtype=complex)


def scalars_of(kind: str, a: np.ndarray, b: np.ndarray, **rest) -> Form:
    return Form(a, b, repeated=kind, **rest)


def made_from_truth(rng, n_y, blocks, *, p12=False, n_w=None, size=0.3, noise=0.1, gain=0.3):
    """A point simulated with a known Delta and w; returns (problem, true sizes, w)."""
    blocks = tuple(Block(*b) for b in blocks)
    p, q, wide = sum(b.rows for b in blocks), sum(b.cols for b in blocks), n_w or n_y
    p11, p21, eta0 = gain * gauss(rng, q, p) / np.sqrt(p), gauss(rng, n_y, p), gauss(rng, q)
    p22 = np.eye(n_y, dtype=complex) if n_w is None else gauss(rng, n_y, wide)
    p12 = gain * gauss(rng, q, wide) if p12 else np.zeros((q, wide), complex)
    pieces = []
    for b in blocks:
        d = gauss(rng, b.rows, b.cols) if b.kind == "full" else np.eye(b.rows, dtype=complex)
        d *= size * rng.uniform(0.3, 1.0) / np.linalg.norm(d, 2)
        pieces.append(d * (np.exp(2j * np.pi * rng.uniform()) if b.kind == "repeated_complex" else 1.0))
    total = np.zeros((p, q), complex)
    row = col = 0
    for d in pieces:
        total[row : row + d.shape[0], col : col + d.shape[1]] = d
        row, col = row + d.shape[0], col + d.shape[1]
    w = gauss(rng, wide)
    w *= noise / np.linalg.norm(w)
    eta = np.linalg.solve(np.eye(q) - p11 @ total, p12 @ w + eta0)
    e = p21 @ total @ eta + p22 @ w
    return Lft(blocks, p11, p12, p21, p22, eta0, e), np.array([np.linalg.norm(d, 2) for d in pieces]), w


def substitute(problem, s, gamma=None):
    """Everything that a returned explanation promises, checked from the raw matrices."""
    eta = problem.p11 @ s.xi + problem.p12 @ s.w + problem.eta0
    np.testing.assert_allclose(
        problem.p21 @ s.xi + problem.p22 @ s.w, problem.e, atol=1e-8 * np.linalg.norm(problem.e)
    )
    if gamma is not None:
        assert np.linalg.norm(s.w) <= gamma * (1 + 1e-8)
    pieces = zip(
        problem.blocks,
        dl.split(problem.blocks, s.xi, "rows"),
        dl.split(problem.blocks, eta, "cols"),
        s.nu,
        strict=True,
    )
    for (block, xi, eta_i, nu), made in zip(pieces, s.verification.deltas, strict=True):
        assert np.linalg.norm(xi) <= nu * np.linalg.norm(eta_i) * (1 + 1e-8) + 1e-12
        np.testing.assert_allclose(made @ eta_i, xi, atol=1e-7 * (np.linalg.norm(xi) + 1e-9))
        if block.kind != "full":
            np.testing.assert_allclose(made, made[0, 0] * np.eye(block.rows), atol=0)
        if block.kind == "repeated_real":
            assert np.all(made.imag == 0)
    assert s.verification.residual < 1e-6
