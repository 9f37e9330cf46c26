"""Class S2: an input-multiplicative scalar and one full block on the state, certified globally (T6).

    G_d xi_s = (z I - A_d) d - B_d xi_i,     d = x - x_nom,     e = C d + w
    |xi_i| <= nu_i |u|,    |xi_s| <= nu_s |x_nom + d|,    |w| <= gamma_w
    min lambda_i nu_i^2 + lambda_s nu_s^2

With G_d = int_0^Ts e^{As} ds, nu_s is a rate (1/s). With G_d = I, nu_s is a size per sample. At fixed nu_s
this is a complex quadratic problem with two constraints. Its dual has no gap as long as nu_s <
1/sigma_max(H_s), H_s = (z I - A_d)^-1 G_d. At this cap an allowed Delta_s makes the loop singular. Branch and
bound in base/_native/s2.c finds the optimum over nu_s. ``solve_forms`` calls this kernel for any problem with
one full block and plain quadratics.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpvguard.base import native
from lpvguard.base.errors import InputError

GAP = 1e-4
"""Relative gap between the two bounds at which the branch and bound stops."""

NEAR_CAP = 1.0 - 1e-4
"""An optimum at or above this fraction of the well-posedness cap results from the cap, not from the data."""

MAX_N = 16
"""Largest number of free variables plus one that the kernel accepts."""


@dataclass(frozen=True)
class FormsResult:
    """Result at every point: certified ``lower``, and ``upper``.

    Size ``p`` and point ``z`` (n,) attain ``upper``. ``duals`` is the number of dual problems that were
    solved.
    """

    lower: np.ndarray
    upper: np.ndarray
    p: np.ndarray
    z: np.ndarray
    duals: np.ndarray


def solve_forms(forms: np.ndarray, z0: np.ndarray, p_max, *, gap: float = GAP) -> FormsResult:
    """Solve min z* Q0 z + p over z = (theta, 1), p <= p_max, s.t. z* Qw z <= 0 and z* (A - p B) z <= 0.

    ``forms`` (points, 4, n, n) are the Hermitian Q0, Qw, A and B. They are scaled so that the cost at the
    feasible ``z0`` (points, n) is about one. The last element of ``z0`` is 1. ``p_max`` has the shape
    (points,). Raises InputError when n > 16.
    """
    forms, z = np.ascontiguousarray(forms, dtype=complex), np.array(z0, dtype=complex, order="C")
    points, n = z.shape
    if not 2 <= n <= MAX_N:
        raise InputError("S2", "free variables", f"{n - 1}", f"1 to {MAX_N - 1}")
    p_max = np.ascontiguousarray(np.broadcast_to(np.asarray(p_max, dtype=float), (points,)))
    out = np.empty((points, 4))
    native.kernels("s2").lpvg_s2(
        *map(ctypes.c_ssize_t, (points, n)),
        *map(native.pointer, (forms, p_max)),
        ctypes.c_double(gap),
        *map(native.pointer, (z, out)),
    )
    return FormsResult(out[:, 0], out[:, 1], out[:, 2], z, out[:, 3].astype(int))


@dataclass(frozen=True)
class S2Result:
    """Result at every point (K,): certified ``lower`` <= optimum <= ``upper``, which the explanation attains.

    ``nu_i`` and ``nu_s`` (K,) are the sizes. ``xi`` (K, 1 + n_x) and ``w`` (K, n_y) are the signals.
    ``duals`` is the number of solved dual problems. Points with gamma_w < B1 have inf bounds and NaN signals.
    ``at_cap`` marks points whose best nu_s is the well-posedness cap, or whose bounds did not meet near the
    cap. The numbers at such points do not bound the vehicle. They show that the class does not fit.
    """

    lower: np.ndarray
    upper: np.ndarray
    nu_i: np.ndarray
    nu_s: np.ndarray
    xi: np.ndarray
    w: np.ndarray
    duals: np.ndarray
    b1: np.ndarray
    at_cap: np.ndarray


def _gram(m: np.ndarray) -> np.ndarray:
    return np.swapaxes(m.conj(), -1, -2) @ m


@dataclass(frozen=True)
class _Data:
    """Checked arguments of :func:`solve`, with one row for each point."""

    e: np.ndarray
    u: np.ndarray
    x_nom: np.ndarray
    h_i: np.ndarray
    h_s: np.ndarray
    c: np.ndarray
    gamma: np.ndarray
    lam_i: np.ndarray
    lam_s: np.ndarray

    def check(self, names: Sequence[str] | None) -> None:
        """Raise the InputErrors of :func:`solve`."""
        points, n_y = self.e.shape
        n_x = self.x_nom.shape[-1]
        shapes = {
            "u": (self.u, (points,)),
            "x_nom": (self.x_nom, (points, n_x)),
            "h_i": (self.h_i, (points, n_x)),
            "h_s": (self.h_s, (points, n_x, n_x)),
            "c": (self.c, (n_y, n_x)),
        }
        for name, (array, shape) in shapes.items():
            if array.shape != shape:
                raise InputError("S2", name, f"shape {array.shape}", f"{shape}")
        if names is not None and len(names) != points:
            raise InputError("S2", "names", f"{len(names)} for {points} points", "one for each point")

        def require(good: np.ndarray, name: str, what: str, expected: str) -> None:
            bad = ~good.reshape(points, -1).all(axis=1)
            if bad.any():
                k = int(np.argmax(bad))
                raise InputError(
                    "S2", f"{name}, {f'point {k}' if names is None else names[k]}", what, expected
                )

        for name in ("e", "u", "x_nom", "h_i", "h_s"):
            require(np.isfinite(getattr(self, name)), name, "a value that is not finite", "finite numbers")
        require(np.isfinite(self.gamma), "gamma_w", "a value that is not finite", "finite numbers")
        for name, array in (("gamma_w", self.gamma), ("lambda_i", self.lam_i), ("lambda_s", self.lam_s)):
            require(array > 0.0, name, "zero or negative", "a positive number")
        require(
            self.u != 0.0, "u", "zero", "an input that is not zero, which multiplicative uncertainty needs"
        )


@dataclass(frozen=True)
class _Maps:
    """Maps from well-scaled coordinates z = (theta, 1) to signals: ``xi``, ``w`` and ``eta`` (K, ., n)."""

    xi: np.ndarray
    w: np.ndarray
    eta: np.ndarray

    @classmethod
    def from_data(cls, data: _Data) -> _Maps:
        """Maps of the free xi = (xi_i, xi_s) to w = e - C d and to eta = x_nom + d.

        d is h_i xi_i + h_s xi_s.
        """
        e, points, n_x = data.e, len(data.e), data.x_nom.shape[-1]
        d = n_x + 1
        to_d = np.concatenate([data.h_i[:, :, None], data.h_s], axis=2)
        gain = data.c @ to_d
        size_e = np.maximum(np.linalg.norm(e, axis=1), data.gamma)
        unit_i = np.linalg.norm(gain[:, :, 0], axis=1) / size_e
        unit_s = np.linalg.norm(gain[:, :, 1:], axis=(1, 2)) / size_e
        scale = np.concatenate([unit_i[:, None], np.repeat(unit_s[:, None], n_x, axis=1)], axis=1)
        stacked = np.concatenate([scale[:, :, None] * np.eye(d), -gain / data.gamma[:, None, None]], axis=1)
        column_t = np.concatenate([np.zeros((points, d)), e / data.gamma[:, None]], axis=1)
        q, r = np.linalg.qr(stacked)
        shift = np.swapaxes(q.conj(), 1, 2) @ column_t[:, :, None]
        back = np.zeros((points, d, d + 1), dtype=complex)
        back[:, :, :d] = np.linalg.inv(r)
        back[:, :, d:] = -back[:, :, :d] @ shift
        t_row = np.zeros(d + 1)
        t_row[-1] = 1.0
        w_map = e[:, :, None] * t_row - gain @ back
        eta_map = data.x_nom[:, :, None] * t_row + to_d @ back
        return cls(back, w_map, eta_map)


def _at(maps: np.ndarray, z: np.ndarray) -> np.ndarray:
    """``maps`` (K, m, n) times ``z`` (K, n)."""
    return (maps @ z[:, :, None]).reshape(maps.shape[:2])


def _problem(data: _Data, maps: _Maps, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forms (K, 4, n, n) of :func:`solve_forms`, scaled by a cost, and this cost (K,).

    The cost is that at ``start`` (K, n).
    """
    per_i = data.lam_i / np.abs(data.u) ** 2
    q0, a, b = per_i[:, None, None] * _gram(maps.xi[:, :1]), _gram(maps.xi[:, 1:]), _gram(maps.eta)
    ball = _gram(maps.w) / data.gamma[:, None, None] ** 2
    ball[:, -1, -1] -= 1.0
    xi_0, eta_0 = _at(maps.xi, start), _at(maps.eta, start)
    block_0 = np.sum(np.abs(xi_0[:, 1:]) ** 2, axis=1) / np.maximum(
        np.sum(np.abs(eta_0) ** 2, axis=1), 1e-300
    )
    cost = per_i * np.abs(xi_0[:, 0]) ** 2 + data.lam_s * block_0
    trivial = np.where(cost > 0.0, cost, 1.0)
    weight = np.trace(a, axis1=1, axis2=2).real
    forms = np.stack(
        [
            q0 / trivial[:, None, None],
            ball,
            a / weight[:, None, None],
            b * (trivial / data.lam_s / weight)[:, None, None],
        ],
        axis=1,
    )
    return forms, trivial


def solve(
    e,
    u,
    x_nom,
    h_i,
    h_s,
    c,
    gamma_w,
    lambda_i=1.0,
    lambda_s=1.0,
    *,
    gap: float = GAP,
    names: Sequence[str] | None = None,
) -> S2Result:
    """Compute the optimum of (8) for class S2 at K points.

    Parameters
    ----------
    e : array_like (K, n_y) of complex
    u : array_like (K,) of complex
    x_nom : array_like (K, n_x) of complex
    h_i : array_like (K, n_x) of complex, (zI - A_d)^-1 B_d
    h_s : array_like (K, n_x, n_x) of complex, (zI - A_d)^-1 G_d
    c : array_like (n_y, n_x)
    gamma_w, lambda_i, lambda_s : array_like (K,) or float, > 0
    gap : float, relative gap between the bounds
    names : Sequence[str], optional, experiment and bin of each point, for messages

    Returns
    -------
    S2Result

    Raises
    ------
    InputError
        If shapes do not fit, or a value is not finite or not positive. The error names the point.

    References
    ----------
    Paper, (8); THEORY 4.2, (T6).
    """
    e, u, x_nom, h_i, h_s, c = (np.asarray(a, dtype=complex) for a in (e, u, x_nom, h_i, h_s, c))
    points = len(e)
    gamma, lam_i, lam_s = (
        np.broadcast_to(np.asarray(a, dtype=float), (points,)) for a in (gamma_w, lambda_i, lambda_s)
    )
    data = _Data(e, u, x_nom, h_i, h_s, c, gamma, lam_i, lam_s)
    data.check(names)
    maps = _Maps.from_data(data)
    # The start lies inside the ball, between the least-squares point and the point with the smallest w.
    b1, start = _inside_ball(maps.w, gamma)
    feasible = b1 <= gamma
    forms, trivial = _problem(data, maps, start)
    cap_s = 1.0 / np.linalg.norm(h_s, 2, axis=(1, 2))
    p_max = lam_s * cap_s**2 * (1.0 - 1e-9) / trivial
    out = solve_forms(forms[feasible], start[feasible], p_max[feasible], gap=gap)

    def spread(values: np.ndarray, fill: float = np.inf) -> np.ndarray:
        full = np.full((points, *values.shape[1:]), fill, dtype=values.dtype)
        full[feasible] = values
        return full

    upper, lower = spread(out.upper * trivial[feasible]), spread(out.lower * trivial[feasible])
    z = spread(out.z, np.nan)
    z[~np.isfinite(upper)] = np.nan
    xi, w, eta = _at(maps.xi, z), _at(maps.w, z), _at(maps.eta, z)
    nu_s = np.linalg.norm(xi[:, 1:], axis=1) / np.linalg.norm(eta, axis=1)
    # A disturbance alone explains these points. Their optimum is zero, which a relative gap cannot reach.
    silent = np.linalg.norm(e, axis=1) <= gamma
    for array, value in ((lower, 0.0), (upper, 0.0), (nu_s, 0.0), (xi, 0.0), (w, e[silent])):
        array[silent] = value
    met = np.isfinite(upper) & (lower >= (1.0 - 10.0 * gap) * upper)
    at_cap = feasible & (~met | (nu_s >= NEAR_CAP * cap_s))
    return S2Result(lower, upper, np.abs(xi[:, 0]) / np.abs(u), nu_s, xi, w, spread(out.duals, 0), b1, at_cap)


def _inside_ball(w_map: np.ndarray, gamma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """B1 = min |w| and a point z with |w| <= gamma, for each point.

    z lies between theta = 0 and the point with |w| = B1, as near to 0 as the ball allows.
    """
    w_t, w_theta = w_map[:, :, -1], w_map[:, :, :-1]
    u, s, vh = np.linalg.svd(w_theta, full_matrices=False)
    keep = s > 1e-12 * s[:, :1]
    along = np.where(keep, _at(np.swapaxes(u.conj(), 1, 2), w_t), 0.0)
    rest = w_t - _at(u, along)
    b1 = np.linalg.norm(rest, axis=1)
    room = np.sqrt(np.maximum((gamma - b1) * (gamma + b1), 0.0))
    size = np.linalg.norm(along, axis=1)
    # Slightly inside, so that rounding does not put the start outside.
    fraction = np.where(size > room, 1.0 - (1.0 - 1e-9) * room / np.maximum(size, 1e-300), 0.0)
    inverse = np.divide(1.0, s, out=np.zeros_like(s), where=keep)
    theta = -_at(np.swapaxes(vh.conj(), 1, 2), inverse * along) * fraction[:, None]
    return b1, np.concatenate([theta, np.ones((len(gamma), 1))], axis=1)
