"""Build each Delta_i from (xi_i, eta_i), and verify that Delta explains the data."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpvguard.base.errors import InputError
from lpvguard.engine.blocks import Block


def split(blocks: Sequence[Block], vector: np.ndarray, side: str) -> list[np.ndarray]:
    """Split a stacked signal or a map (Σ, m) to it by blocks.

    The signal is xi (Σrows,) for the ``side`` 'rows', or eta (Σcols,) for 'cols'.
    """
    ends = np.cumsum([getattr(b, side) for b in blocks])
    return np.split(vector, ends[:-1])


def least_size(xi: np.ndarray, eta: np.ndarray) -> float:
    """Least ||Delta_i|| that maps ``eta`` (cols,) to ``xi`` (rows,), if a Delta_i exists: |xi| / |eta|.

    It is 0 for xi = 0, and inf for eta = 0 with xi not 0.
    """
    top, bottom = float(np.linalg.norm(xi)), float(np.linalg.norm(eta))
    if top == 0.0:
        return 0.0
    return top / bottom if bottom > 0.0 else np.inf


def construct(block: Block, xi: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Build the Delta_i (rows, cols) of least norm with the block's structure that maps ``eta`` to ``xi``.

    A full block is xi eta^* / |eta|^2. A repeated block is ``delta I`` with ``delta = eta^* xi / |eta|^2``; a
    real block uses the real part. Call :func:`verify` to check that this delta maps eta to xi. Raises
    InputError when eta = 0 but xi is not.
    """
    if not np.any(xi):
        return np.zeros((block.rows, block.cols), dtype=complex)
    power = float(np.vdot(eta, eta).real)
    if power == 0.0:
        raise InputError("Delta", f"{block.kind} block", "eta = 0 but xi is not", "an eta that is not zero")
    if not block.repeated:
        return np.outer(xi, np.conj(eta)) / power
    scalar = np.vdot(eta, xi) / power
    return (scalar.real if block.kind == "repeated_real" else scalar) * np.eye(block.rows, dtype=complex)


@dataclass(frozen=True)
class Verification:
    """Result of :func:`verify`.

    ``deltas`` has one Delta_i (rows, cols) for each block. ``sizes`` (tau,) are their largest singular
    values. ``residual`` is |e - M [xi; w]| relative to |e|, where xi = Delta eta comes from a new simulation.
    """

    deltas: list[np.ndarray]
    sizes: np.ndarray
    residual: float


def verify(
    blocks: Sequence[Block], p: dict[str, np.ndarray], e, w, xi, nu, *, rtol: float = 1e-6
) -> Verification:
    """Build Delta from (xi, w), close the loop with it and check that it reproduces the data.

    ``p`` holds P11, P12, P21, P22 and eta0 = P13 u. ``nu`` (tau,) bounds the sizes. The solution of (I - P11
    Delta) eta = P12 w + eta0 closes the loop, so xi is only used to build Delta. Raises InputError when a
    block is larger than its nu or the data are not reproduced. Every explanation of this package is verified
    in this way.
    """
    eta = p["P11"] @ xi + p["P12"] @ w + p["eta0"]
    pieces = list(zip(blocks, split(blocks, xi, "rows"), split(blocks, eta, "cols"), strict=True))
    deltas = [construct(*piece) for piece in pieces]
    sizes = np.array([np.linalg.norm(d, 2) for d in deltas])
    full = np.zeros((xi.size, eta.size), dtype=complex)
    row = col = 0
    for d in deltas:
        full[row : row + d.shape[0], col : col + d.shape[1]] = d
        row, col = row + d.shape[0], col + d.shape[1]
    closed = np.linalg.solve(np.eye(eta.size) - p["P11"] @ full, p["P12"] @ w + p["eta0"])
    y = p["P21"] @ (full @ closed) + p["P22"] @ w
    residual = float(np.linalg.norm(e - y) / max(np.linalg.norm(e), np.finfo(float).tiny))
    if residual > rtol:
        raise InputError(
            "Delta", "re-simulated data", f"a relative error of {residual:.3g}", f"at most {rtol:g}"
        )
    if np.any(sizes > np.asarray(nu) * (1.0 + rtol)):
        raise InputError("Delta", "size", f"{sizes}", f"at most nu = {np.asarray(nu)}")
    return Verification(deltas, sizes, residual)
