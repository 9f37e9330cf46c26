"""Certificates from small Hermitian feasibility problems: max x so that sum_j y_j Q_j - x I >= 0.

The multipliers y are split into groups. A scalar group is one number >= 0. A matrix group parametrises a
Hermitian D >= 0 (the D-scaling of a repeated block). A free group has no sign (the G-scaling of a real
block). The traces of all groups with a sign sum to one. By the S-procedure, a positive x proves that the
forms z^* Q_j z (and their matrix versions) cannot all be <= 0 at once. The method is Newton's method on a log
barrier. The forms have at most about ten rows. Each iterate is feasible, so the bound is rigorous wherever
the iteration stops.
"""

import ctypes
from dataclasses import dataclass

import numpy as np

from lpvguard.base import native
from lpvguard.base.errors import InputError

SIZES = ({"N": 16, "M": 64, "R": 4}, {"N": 64, "M": 256, "R": 16})
"""Two sets of array sizes of base/_native/ray.c: rows, multipliers, and order of a group."""


@dataclass(frozen=True)
class Cone:
    """Cones of the multipliers.

    ``start[g]`` and ``size[g]`` locate group g in y. ``order[g]`` is r for positive semidefinite r x r
    matrices (numbers >= 0 for r = 1), and 0 for a free group.
    """

    start: tuple[int, ...]
    size: tuple[int, ...]
    order: tuple[int, ...]
    normal: np.ndarray
    """Coefficients (m,) of the normalisation, the sum of the traces of all groups with a sign."""


def hermitian_basis(r: int) -> np.ndarray:
    """Real basis (r*r, r, r) of the Hermitian matrices (r, r): diagonal first."""
    basis = []
    for i in range(r):
        m = np.zeros((r, r), dtype=complex)
        m[i, i] = 1.0
        basis.append(m)
    for i in range(r):
        for j in range(i):
            for unit in (1.0, 1.0j):
                m = np.zeros((r, r), dtype=complex)
                m[i, j], m[j, i] = unit, np.conj(unit)
                basis.append(m)
    return np.array(basis)


def gram(left: np.ndarray, right: np.ndarray, basis: np.ndarray | None) -> np.ndarray:
    """Compute left^* B right (k, n, n) for each B of ``basis`` (k, r, r); ``left``, ``right`` (r, n).

    With ``basis`` None, B is the identity, and ``right`` can have any number of rows.
    """
    if basis is None:
        return (left.conj().T @ right)[None]
    return np.einsum("ia,kij,jb->kab", left.conj(), basis, right)


def cone(groups: list[tuple[str, int]]) -> Cone:
    """Make the cone of groups.

    ('psd', r) stands for r x r matrices D >= 0, and ('free', r) for matrices without a sign.
    """
    sizes = [(r * r, r if kind == "psd" else 0) for kind, r in groups]
    start = np.concatenate([[0], np.cumsum([size for size, _ in sizes])[:-1]]).astype(int)
    normal = np.concatenate([np.arange(size) < order for size, order in sizes]).astype(float)
    return Cone(
        tuple(int(s) for s in start),
        tuple(size for size, _ in sizes),
        tuple(order for _, order in sizes),
        normal,
    )


@dataclass(frozen=True)
class Centre:
    """A feasible ``y`` with level ``x``.

    The optimum is below ``x_above``. ``inverse``, proportional to (Q(y) - x I)^-1, is the primal matrix.
    """

    y: np.ndarray
    x: float
    x_above: float
    inverse: np.ndarray


def _compiled(n: int, c: Cone) -> ctypes.CDLL:
    """Kernel with the smallest arrays that can hold a problem of ``n`` rows.

    Raises InputError if none can.
    """
    asked = {"N": n, "M": len(c.normal), "R": max(c.order)}
    for sizes in SIZES:
        if all(asked[key] <= sizes[key] for key in sizes):
            return native.kernels("ray", *(f"-DMAX_{key}={size}" for key, size in sizes.items()))
    raise InputError(
        "certificate",
        "size",
        f"{n} rows, {asked['M']} multipliers, groups of order {asked['R']}",
        "at most {N}, {M} and {R}".format(**SIZES[-1]),
    )


def _groups(c: Cone) -> list[np.ndarray]:
    return [np.array(part, dtype=np.int32) for part in (c.start, c.order)]


def maximise_level(q: np.ndarray, c: Cone, *, relative: float = 0.1, absolute: float = 1e-9) -> Centre:
    """Solve the problem of the module's docstring by path-following.

    ``q`` (m, n, n) are Hermitian forms of order one. The search stops when the optimal level is known within
    ``relative`` of its magnitude or within ``absolute``. It also stops when the level is proved to be
    negative.
    """
    m, n = q.shape[:2]
    q = np.ascontiguousarray(q, dtype=complex)
    y, above, inverse = np.empty(m), ctypes.c_double(), np.empty((n, n), dtype=complex)
    search = _compiled(n, c).lpvg_level
    search.restype = ctypes.c_double
    x = search(
        n,
        m,
        len(c.order),
        *map(native.pointer, (*_groups(c), q)),
        ctypes.c_double(relative),
        ctypes.c_double(absolute),
        native.pointer(y),
        ctypes.byref(above),
        native.pointer(inverse),
    )
    return Centre(y, x, above.value, inverse)


def rounding(y: np.ndarray, forms: np.ndarray) -> float:
    """Bound on the rounding error (2-norm) of sum_j y_j forms_j; ``y`` (m,), ``forms`` (m, n, n).

    Free multipliers may be large and cancel. A certificate must not depend on the rounding that remains.
    """
    _, n, _ = forms.shape
    return 4.0 * n * np.finfo(float).eps * float(np.abs(y) @ np.linalg.norm(forms, axis=(1, 2)))


def reach(zero: np.ndarray, slopes: np.ndarray, error: float = 0.0) -> np.ndarray:
    """Largest length (k,) up to which ``zero`` - length ``slopes[k]`` is >= 0.

    ``zero`` (n, n) has the error ``error`` (2-norm); ``slopes`` (k, n, n) >= 0. The length is inf if nothing
    limits it, and 0 if ``zero`` is not positive definite.
    """
    zero = zero - error * np.eye(len(zero))
    try:
        factor = np.linalg.inv(np.linalg.cholesky(0.5 * (zero + zero.conj().T)))
    except np.linalg.LinAlgError:
        return np.zeros(len(slopes))
    top = np.linalg.eigvalsh(factor @ slopes @ factor.conj().T)[:, -1]
    return np.divide(1.0 - 1e-12, top, out=np.full(len(slopes), np.inf), where=top > 0.0)


def reaches(zeros: np.ndarray, slopes: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """:func:`reach` (..., k) for many ``zeros`` (..., n, n) with ``errors`` (...,); ``slopes`` (k, n, n).

    The result is -inf where a zero is not positive definite.
    """
    _, n, _ = slopes.shape
    zeros = zeros - errors[..., None, None] * np.eye(n)
    good = np.linalg.eigvalsh(zeros)[..., 0] > errors
    out = np.full((*good.shape, len(slopes)), -np.inf)
    factor = np.linalg.inv(np.linalg.cholesky(zeros[good]))[:, None]
    top = np.linalg.eigvalsh(factor @ slopes @ factor.conj().swapaxes(-1, -2))[..., -1]
    out[good] = np.divide(1.0 - 1e-12, top, out=np.full(top.shape, np.inf), where=top > 0.0)
    return out


def ray_length(
    q0: np.ndarray, level: np.ndarray, c: Cone, cutoff: float = np.inf
) -> tuple[float, np.ndarray | None, np.ndarray | None]:
    """Largest certified length, its multipliers y (m,) or None, and the primal matrix (n, n) at the end.

    The forms are Q0 - length L with L >= 0, from ``q0`` and ``level`` (m, n, n). No point satisfies all of
    them at a smaller length. The method is Dinkelbach's iteration, which uses each y up to the largest length
    that it proves. Far from the end such a step can be a hundred times too short, so steps of bisection lie
    between. The search stops at ``cutoff``.
    """
    m, n = q0.shape[:2]
    q0, level = np.ascontiguousarray(q0, dtype=complex), np.ascontiguousarray(level, dtype=complex)
    y, inverse, certified = np.zeros(m), np.zeros((n, n), dtype=complex), ctypes.c_int()
    search = _compiled(n, c).lpvg_ray
    search.restype = ctypes.c_double
    length = search(
        n,
        m,
        len(c.order),
        *map(native.pointer, (*_groups(c), q0, level)),
        ctypes.c_double(cutoff),
        native.pointer(y),
        ctypes.byref(certified),
        native.pointer(inverse),
    )
    return length, y if certified.value else None, inverse
