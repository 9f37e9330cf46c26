"""Certificates from small Hermitian feasibility problems: max x so that sum_j y_j Q_j - x I >= 0.

The multipliers y are split into groups. A scalar group is one number >= 0. A matrix group parametrises a
Hermitian D >= 0 (the D-scaling of a repeated block). A free group has no sign (the G-scaling of a real
block). The traces of all groups with a sign sum to one. A positive x proves that the forms z^* Q_j z (and
their matrix versions) cannot all be <= 0 at once: the S-procedure. The method is Newton's method on a log
barrier. The forms have at most about ten rows. Each iterate is feasible, so the bound is rigorous wherever
the iteration stops.
"""

import ctypes
from dataclasses import dataclass

import numpy as np

from lpvguard.base import native

MAX_NEWTON = 120

ENDLESS = 1e30
"""A ray that is proved up to this length counts as endless, as in base/_native/ray.c."""

_NATIVE_N, _NATIVE_M, _NATIVE_ORDER = 16, 64, 4
"""Largest sizes for the compiled version (base/_native/ray.c); larger problems use numpy."""


@dataclass(frozen=True)
class Cone:
    """Cones of the multipliers.

    ``start[g]`` and ``size[g]`` locate group g in y. ``order[g]`` is r for Hermitian r x r PSD matrices (r =
    1: a number >= 0) and 0 for a free group.
    """

    start: tuple[int, ...]
    size: tuple[int, ...]
    order: tuple[int, ...]
    normal: np.ndarray
    """(m,) coefficients of the normalisation: traces of the signed groups."""


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
    """Make the cone of groups: ('psd', r) for a matrix D >= 0 (r x r), ('free', r) for one without a sign."""
    sizes = [(r * r, r if kind == "psd" else 0) for kind, r in groups]
    start = np.concatenate([[0], np.cumsum([size for size, _ in sizes])[:-1]]).astype(int)
    normal = np.concatenate([np.arange(size) < order for size, order in sizes]).astype(float)
    return Cone(
        tuple(int(s) for s in start),
        tuple(size for size, _ in sizes),
        tuple(order for _, order in sizes),
        normal,
    )


def _member(c: Cone, g: int, y: np.ndarray) -> np.ndarray:
    part = y[c.start[g] : c.start[g] + c.size[g]]
    return np.tensordot(part, hermitian_basis(c.order[g]), axes=1)


@dataclass(frozen=True)
class Centre:
    """A feasible ``y`` with level ``x``.

    The optimum is below ``x_above``. ``inverse`` ~ (Q(y) - x I)^-1 is the primal.
    """

    y: np.ndarray
    x: float
    x_above: float
    inverse: np.ndarray


def _interior(c: Cone, y: np.ndarray) -> bool:
    for g, r in enumerate(c.order):
        if r == 1 and y[c.start[g]] <= 0.0:
            return False
        if r > 1 and np.linalg.eigvalsh(_member(c, g, y))[0] <= 0.0:
            return False
    return True


def maximise_level(q: np.ndarray, c: Cone, *, relative: float = 0.1, absolute: float = 1e-9) -> Centre:
    """Solve the problem of the module's docstring by path-following.

    ``q`` (m, n, n) Hermitian forms, scaled to order one. It stops when the optimal level is known within
    ``relative`` of its magnitude or within ``absolute``. It also stops when the level is proved to be
    negative.
    """
    m, n = q.shape[:2]
    y = c.normal / c.normal.sum()
    matrix = np.tensordot(y, q, axes=1)
    low = np.linalg.eigvalsh(matrix)[0]
    x = float(low - 0.5 * max(1e-3, abs(low)))
    degree = n + sum(c.order)
    eps = (low - x) / 2.0
    eye = np.eye(n)
    # The last row of ``forms`` is d(Q - x I)/dx; the KKT system keeps the normalisation.
    forms = np.concatenate([q, -eye[None]])
    kkt = np.zeros((m + 2, m + 2))
    kkt[m + 1, :m] = kkt[:m, m + 1] = c.normal
    ridge = 1.0 + 1e-13 * np.eye(m + 2)  # keeps multiples small that cancel: of free forms of one span
    x_above = np.inf
    inverse = np.linalg.inv(matrix - x * eye)
    for _ in range(MAX_NEWTON):
        gradient, hessian = _barrier(inverse, forms, c, y, eps)
        kkt[: m + 1, : m + 1] = hessian
        kkt *= ridge
        try:
            step = np.linalg.solve(kkt, np.append(gradient, 0.0))[: m + 1]
        except np.linalg.LinAlgError:  # free forms of zero: the least step
            step = np.linalg.lstsq(kkt, np.append(gradient, 0.0))[0][: m + 1]
        decrement = np.sqrt(max(float(gradient @ step) / eps, 0.0))
        if not np.isfinite(decrement):
            break
        length = 1.0 if decrement < 0.25 else 1.0 / (1.0 + decrement)
        if decrement > 1.0:
            length = min(1.0, 4.0 * length)
        moved = _feasible_step(q, c, y, x, step, length)
        if moved is None:
            break
        y, x, slack, length = moved
        inverse = np.linalg.inv(slack)
        inverse = 0.5 * (inverse + inverse.conj().T)
        if decrement * length < 0.5 and decrement < 1.0:
            x_above = min(x_above, x + 2.0 * eps * degree)
            gap = x_above - x
            if x_above < 0.0 or gap <= max(absolute, relative * abs(x)):
                break
            eps *= 0.15
    return Centre(y, float(x), float(x_above), inverse)


def _barrier(
    inverse: np.ndarray, forms: np.ndarray, c: Cone, y: np.ndarray, eps: float
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient (m + 1,) and negative Hessian (m + 1, m + 1) in (y, x) of x + eps times the log barrier.

    ``inverse``: (Q(y) - x I)^-1. ``forms`` (m + 1, n, n): derivatives of Q(y) - x I.
    """
    count, n = forms.shape[:2]
    scaled = inverse @ forms
    gradient = eps * np.einsum("jii->j", scaled).real
    gradient[count - 1] += 1.0
    flat = scaled.reshape(count, n * n)
    hessian = eps * (flat @ scaled.transpose(0, 2, 1).reshape(count, n * n).T).real
    for g, r in enumerate(c.order):
        s = slice(c.start[g], c.start[g] + c.size[g])
        if r == 1:
            gradient[s] += eps / y[s]
            hessian[s, s] += eps / y[s] ** 2
        elif r > 1:
            d = np.linalg.inv(_member(c, g, y)) @ hermitian_basis(r)
            gradient[s] += eps * np.einsum("jii->j", d).real
            hessian[s, s] += eps * np.einsum("jab,kba->jk", d, d).real
    return gradient, hessian


def _feasible_step(
    q: np.ndarray, c: Cone, y: np.ndarray, x: float, step: np.ndarray, length: float
) -> tuple[np.ndarray, float, np.ndarray, float] | None:
    """(y, x, Q(y) - x I, length) after halving the step until it is feasible; None if it never is."""
    m, n = q.shape[:2]
    while length > 1e-10:
        y_new, x_new = y + length * step[:m], float(x + length * step[m])
        slack = np.tensordot(y_new, q, axes=1) - x_new * np.eye(n)
        if _interior(c, y_new):
            try:
                np.linalg.cholesky(slack)
                return y_new, x_new, slack, length
            except np.linalg.LinAlgError:
                pass
        length *= 0.5
    return None


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


def _ray_length_numpy(
    q0: np.ndarray, level: np.ndarray, c: Cone, cutoff: float
) -> tuple[float, np.ndarray | None, np.ndarray | None]:
    length, beyond = 0.0, np.inf
    y: np.ndarray | None = None
    inverse: np.ndarray | None = None
    for turn in range(80):
        ahead = turn % 2 == 1
        at = length
        if ahead and np.isfinite(beyond):
            far = beyond > 4.0 * length
            at = np.sqrt(max(length, 1e-6 * beyond) * beyond) if far else 0.5 * (length + beyond)
        elif ahead:
            at = max(cutoff, length) if np.isfinite(cutoff) else 8.0 * length
        centre = maximise_level(q0 - at * level, c, relative=0.3, absolute=1e-8)
        error = rounding(centre.y, q0)
        if ahead and centre.x <= error:
            beyond = at
            continue
        inverse = centre.inverse
        if centre.x <= error:
            break
        y = centre.y
        zero, slopes = np.tensordot(y, q0, axes=1), np.tensordot(y, level, axes=1)[None]
        (proved,) = reach(zero, slopes, error)
        longer = max(at, float(proved))
        longer = np.inf if longer > ENDLESS else longer
        done = not ahead and (longer <= length * (1.0 + 1e-6) or beyond <= longer * (1.0 + 1e-5))
        length = max(length, longer)
        if done or length >= cutoff:
            break
    return length, y, inverse


def ray_length(
    q0: np.ndarray, level: np.ndarray, c: Cone, cutoff: float = np.inf
) -> tuple[float, np.ndarray | None, np.ndarray | None]:
    """Largest certified length, its multipliers y (m,) or None, and the primal matrix (n, n) at the end.

    ``q0``, ``level`` (m, n, n): the forms are Q0 - length L, L >= 0. No point satisfies all of them at a
    smaller length. The method is Dinkelbach's iteration: each y is used up to the largest length that it
    proves. Bisection steps are added, because far from the end a step can be a hundred times too short. The
    search stops at ``cutoff``.
    """
    m, n = q0.shape[:2]
    lib = native.kernels("ray")
    if lib is None or n > _NATIVE_N or m > _NATIVE_M or max(c.order) > _NATIVE_ORDER:
        return _ray_length_numpy(q0, level, c, cutoff)
    q0, level = np.ascontiguousarray(q0, dtype=complex), np.ascontiguousarray(level, dtype=complex)
    y, inverse, certified = np.zeros(m), np.zeros((n, n), dtype=complex), ctypes.c_int()
    groups = [np.array(part, dtype=np.int32) for part in (c.start, c.order)]
    pointer = ctypes.c_void_p
    lib.lpvg_ray.restype = ctypes.c_double
    length = lib.lpvg_ray(
        n,
        m,
        len(c.order),
        *(a.ctypes.data_as(pointer) for a in (*groups, q0, level)),
        ctypes.c_double(cutoff),
        y.ctypes.data_as(pointer),
        ctypes.byref(certified),
        inverse.ctypes.data_as(pointer),
    )
    return length, y if certified.value else None, inverse
