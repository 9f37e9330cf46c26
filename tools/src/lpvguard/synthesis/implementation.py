"""From a designed controller to numbers a microcontroller runs: sampling, delta form, float32.

What comes out is verified like any controller: ``dk.certify`` on the discrete plant.

The core computes x += F x + B u, y = C x + D u with F = A − I formed in double: a slow pole of 0.02 rad/s at
5 ms is 0.9999, and rounding 1 − 1e-4 to float32 would lose four digits of it. F is block diagonal with a
bounded-condition transformation (Bavely & Stewart 1979): modal where modes separate, small blocks where they
do not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl
from scipy.linalg import lapack

from lpvguard.synthesis.errors import SynthesisError
from lpvguard.synthesis.statespace import StateSpace, to_discrete

MAX_COUPLING = 100.0
"""Largest entry of a decoupling step: modes that need more stay in one block."""


@dataclass(frozen=True)
class DeltaForm:
    """x⁺ = x + F x + B u, y = C x + D u; F (n, n) block diagonal with ``sizes``, double or float32, dt in
    seconds.
    """

    F: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    sizes: tuple[int, ...]
    dt: float

    @property
    def nonzeros(self) -> int:
        """Coefficients that are not zero: the multiplications of one step."""
        return int(sum(np.count_nonzero(M) for M in (self.F, self.B, self.C, self.D)))

    def system(self) -> StateSpace:
        """The same controller as a discrete state-space system, A = I + F in double."""
        F, B, C, D = (np.asarray(M, dtype=float) for M in (self.F, self.B, self.C, self.D))
        return StateSpace(np.eye(len(F)) + F, B, C, D, self.dt)

    def rounded(self, dtype=np.float32) -> DeltaForm:
        """Every coefficient rounded to ``dtype``; SynthesisError when one overflows or becomes denormal."""
        out = {}
        for name in "FBCD":
            M = getattr(self, name)
            with np.errstate(over="ignore"):
                R = M.astype(dtype)
            if not np.all(np.isfinite(R)) or np.any((M != 0) & (np.abs(R) < np.finfo(dtype).tiny)):
                raise SynthesisError(
                    "delta form",
                    name,
                    f"a coefficient outside the range of {np.dtype(dtype).name}",
                    "a controller with signals scaled to order one",
                )
            out[name] = R
        return replace(self, **out)


def discretise(K: StateSpace, dt: float) -> StateSpace:
    """Tustin's map of a continuous controller; a controller already at ``dt`` is returned as it is.

    Raises SynthesisError for a controller of another sampling time.
    """
    if K.dt == dt:
        return K
    if K.dt:
        raise SynthesisError("controller", "dt", f"{K.dt:g} s", f"a continuous controller or one at {dt:g} s")
    return replace(to_discrete(K, dt), inputs=K.inputs, outputs=K.outputs)


def delta_form(K: StateSpace, max_coupling: float = MAX_COUPLING) -> DeltaForm:
    """Block-diagonal delta form of a discrete controller (n states, same response), each state scaled by a
    power of two so that what drives it and what it drives are of like size.
    """
    if not K.dt:
        raise SynthesisError("controller", "dt", "0", "a discrete controller (see discretise)")
    n = K.order
    if n == 0:
        return DeltaForm(K.A, K.B, K.C, K.D, (), K.dt)
    T, Q = sl.schur(K.A - np.eye(n))
    basis, sizes, first = Q.copy(), [], 0
    while first < n:
        size = _block_size(T, first)
        while True:
            last = first + size
            if last == n:
                break
            X = sl.solve_sylvester(T[first:last, first:last], -T[last:, last:], -T[first:last, last:])
            if np.abs(X).max(initial=0.0) <= max_coupling:
                basis[:, last:] += basis[:, first:last] @ X
                T[first:last, last:] = 0
                break
            size += _pull_nearest(T, basis, first, last)
        sizes.append(size)
        first += size
    F = sl.block_diag(
        *(T[a : a + s, a : a + s] for a, s in zip(np.cumsum([0, *sizes[:-1]]), sizes, strict=True))
    )
    B, C = np.linalg.solve(basis, K.B), K.C @ basis
    scale = _even_scales(B, C, sizes)
    return DeltaForm(F, B / scale[:, None], C * scale, np.array(K.D), tuple(sizes), K.dt)


def _block_size(T, k) -> int:
    return 2 if k + 1 < len(T) and T[k + 1, k] != 0 else 1


def _pull_nearest(T, basis, first, last) -> int:
    """Move the rest's eigenvalue that is nearest to the block first:last beside it; its size, 1 or 2."""
    mean = np.trace(T[first:last, first:last]) / (last - first)
    at, best, k = last, np.inf, last
    while k < len(T):
        size = _block_size(T, k)
        distance = abs(np.trace(T[k : k + size, k : k + size]) / size - mean)
        if distance < best:
            at, best = k, distance
        k += size
    rest, rotation, _ = lapack.dtrexc(T[last:, last:], np.eye(len(T) - last), at - last + 1, 1)
    T[last:, last:] = rest
    T[first:last, last:] = T[first:last, last:] @ rotation
    basis[:, last:] = basis[:, last:] @ rotation
    return _block_size(T, last)


def _even_scales(B, C, sizes) -> np.ndarray:
    """One power of two per block: √(‖its rows of B‖ / ‖its columns of C‖)."""
    scale, first = np.ones(len(B)), 0
    for size in sizes:
        part = slice(first, first + size)
        b, c = np.linalg.norm(B[part]), np.linalg.norm(C[:, part])
        if b > 0 and c > 0:
            scale[part] = 2.0 ** np.round(0.5 * np.log2(b / c))
        first += size
    return scale
