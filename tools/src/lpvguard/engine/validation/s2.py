"""Class S2: an input-multiplicative scalar and one full block on the state, certified globally (T6).

    G_d xi_s = (z I - A_d) d - B_d xi_i,     d = x - x_nom,     e = C d + w
    |xi_i| <= nu_i |u|,    |xi_s| <= nu_s |x_nom + d|,    |w| <= gamma_w
    min lambda_i nu_i^2 + lambda_s nu_s^2

With G_d = int_0^Ts e^{As} ds, nu_s is a rate (1/s); with G_d = I it is a size per sample. At fixed nu_s this
is a complex quadratic problem with two constraints. It has no duality gap if nu_s < 1/sigma_max(H_s), H_s =
(z I - A_d)^-1 G_d. At that cap an allowed Delta_s makes the loop singular. A branch and bound in
base/_native/s2.c finds the optimum over nu_s; a numpy version is in this module. ``solve_forms`` is the
kernel for any problem with one full block and plain quadratics.
"""

from __future__ import annotations

import ctypes
import heapq
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

_MAX_DUALS, _MAX_NEWTON = 240, 60


@dataclass(frozen=True)
class FormsResult:
    """Result per point: certified ``lower``, and ``upper``, which size ``p`` and point ``z`` (n,) attain.

    ``duals``: dual problems used.
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
    lib = native.kernels("s2")
    if lib is None:
        for k in range(points):
            out[k], z[k] = _Point(forms[k], float(p_max[k]), gap).solve(z[k])
    else:
        size, pointer = ctypes.c_ssize_t, ctypes.c_void_p
        lib.lpvg_s2(
            size(points),
            size(n),
            *(a.ctypes.data_as(pointer) for a in (forms, p_max)),
            ctypes.c_double(gap),
            *(a.ctypes.data_as(pointer) for a in (z, out)),
        )
    return FormsResult(out[:, 0], out[:, 1], out[:, 2], z, out[:, 3].astype(int))


def _to_zero(x: np.ndarray, step: np.ndarray) -> float:
    """Number of steps until the first positive ``x`` reaches zero; inf if none decreases."""
    falling = step < 0.0
    return float(min(-x[falling] / step[falling], default=np.inf))


@dataclass
class _Dual:
    mu: np.ndarray
    slope: float = 0.0
    z: np.ndarray | None = None


@dataclass
class _Interval:
    lo: float
    hi: float
    lower: float
    lo_slope: float
    known: bool
    at: _Dual


class _Point:
    """One point of :func:`solve_forms` in numpy: the algorithm of base/_native/s2.c, step by step."""

    def __init__(self, forms: np.ndarray, p_max: float, gap: float):
        self.q0, self.qw, self.a, self.b = forms
        self.p_max, self.gap, self.n = p_max, gap, len(self.q0)
        self.cost, self.p, self.z = np.inf, 0.0, None

    def _factor(self, mu, p):
        """L(mu, p) with the factor of S_TT and C^-1 S_Tt; NaN if S_TT is not positive definite."""
        s = self.q0 + mu[0] * self.qw + mu[1] * (self.a - p * self.b)
        d = self.n - 1
        try:
            c = np.linalg.cholesky(s[:d, :d])
        except np.linalg.LinAlgError:
            return np.nan, None, None
        y = np.linalg.solve(c, s[:d, d])
        return float(s[d, d].real - np.vdot(y, y).real), c, y

    def _form(self, q, z):
        return float(np.vdot(z, q @ z).real)

    def _maximise_dual(
        self, p: float, fine: float, coarse: float, beyond: float, enough: float, at: _Dual
    ) -> bool:
        d = self.n - 1
        mu = at.mu
        value, c, y = self._factor(mu, p)
        for _ in range(60):
            if not np.isnan(value):
                break
            mu[1] *= 0.25
            value, c, y = self._factor(mu, p)
        if np.isnan(value):
            return False
        pair = (self.qw, self.a - p * self.b)
        slack = coarse / mu
        for it in range(_MAX_NEWTON):
            z = np.append(-np.linalg.solve(c.conj().T, y), 1.0)
            g = np.array([self._form(q, z) for q in pair])
            u = [np.linalg.solve(c, (q @ z)[:d]) for q in pair]
            gap = -float(mu @ g)
            at.z, at.slope = z, 1.0 - mu[1] * self._form(self.b, z)
            if p + value > enough:
                break
            if np.all(g <= 0.0) and (gap <= fine or (gap <= coarse and p + value > beyond)):
                break
            if it == 0:
                slack = np.maximum(-g, slack)
            hessian = 2.0 * np.array([[np.vdot(v, w).real for v in u] for w in u]) + np.diag(slack / mu)
            mean = 0.5 * float(mu @ slack)
            step = np.linalg.solve(hessian, g)
            move = -slack - slack / mu * step
            reach = min(1.0, _to_zero(np.concatenate([mu, slack]), np.concatenate([step, move])))
            left = 0.5 * float((mu + reach * step) @ (slack + reach * move))
            eps = max(mean * max((left / mean) ** 3, 1e-3), 0.05 * fine)
            step = np.linalg.solve(hessian, g + eps / mu)
            move = eps / mu - slack - slack / mu * step
            if not np.isfinite(step.sum()):
                break
            length = min(1.0, 0.95 * _to_zero(mu, step))
            merit, before = value + eps * np.log(mu[0] * mu[1]), mu.copy()
            for _ in range(40):
                mu[:] = before + length * step
                value, c, y = self._factor(mu, p)
                if value + eps * np.log(mu[0] * mu[1]) >= merit - 1e-12 * abs(merit):
                    slack = np.maximum(slack + length * move, 0.05 * slack)
                    break
                length *= 0.4
            else:
                mu[:] = before
                break
        return True

    def _offer(self, z) -> None:
        a, b = self._form(self.a, z), self._form(self.b, z)
        p = 0.0 if a <= 0.0 else a / b if b > 0.0 else np.inf
        cost = p + self._form(self.q0, z)
        if self._form(self.qw, z) <= 0.0 and p <= self.p_max and cost < self.cost:
            self.cost, self.p, self.z = cost, p, z.copy()

    def _bound(self, v: _Interval) -> float:
        floor = max(v.lower, v.lo)
        if not v.known:
            return floor
        return max(floor, min(v.lo + self._factor(v.at.mu, v.lo)[0], v.hi + self._factor(v.at.mu, v.hi)[0]))

    @staticmethod
    def _cut(v: _Interval) -> float:
        if v.lo <= 0.0:
            return v.hi * (0.125 if v.at.slope > 0.0 else 0.5)
        ratio, f0, f1 = v.hi / v.lo, v.lo_slope * v.lo, v.at.slope * v.hi
        x = min(0.85, max(0.15, -f0 / (f1 - f0))) if f0 < 0.0 < f1 else 0.5
        return v.lo * ratio**x if ratio > 1.5 else v.lo + x * (v.hi - v.lo)

    def _evaluate(self, v: _Interval) -> None:
        cost = min(self.cost, 1.0)  # 1: the scale of the problem, before any point is known
        np.maximum(v.at.mu, 1e-3 * cost, out=v.at.mu)
        enough = min(self.cost, 1e9) + (v.hi - v.lo)
        v.known = self._maximise_dual(
            v.hi, 0.1 * self.gap * cost, 0.02 * cost, 1.05 * self.cost, enough, v.at
        )
        if v.known:
            self._offer(v.at.z)
        v.lower = self._bound(v)

    def solve(self, start: np.ndarray):
        """Compute ((lower, upper, p, duals), z) by best-first branch and bound over p."""
        self._offer(start)
        first = _Interval(0.0, min(self.p_max, self.cost), 0.0, -1.0, False, _Dual(np.ones(2)))
        self._evaluate(first)
        duals = 1
        heap = [(first.lower, duals, first)]
        while heap[0][0] < self.cost * (1.0 - self.gap) and duals < _MAX_DUALS:
            right = heapq.heappop(heap)[2]
            left = _Interval(
                right.lo,
                self._cut(right),
                right.lower,
                right.lo_slope,
                False,
                _Dual(right.at.mu.copy(), right.at.slope),
            )
            right.lo = left.hi
            duals += 1
            self._evaluate(left)
            right.lo_slope = left.at.slope if left.known else -1.0
            right.lower = self._bound(right)
            for serial, child in ((2 * duals, left), (2 * duals + 1, right)):
                heapq.heappush(heap, (child.lower, serial, child))
        lower = min(heap[0][0], self.cost)
        return (lower, self.cost, self.p, duals), start if self.z is None else self.z


@dataclass(frozen=True)
class S2Result:
    """Result per point (K,): certified ``lower`` <= optimum <= ``upper``, which the explanation attains.

    ``nu_i``, ``nu_s`` (K,): the sizes. ``xi`` (K, 1 + n_x), ``w`` (K, n_y): the signals. ``duals``: dual
    problems used. Points with gamma_w < B1 have inf bounds and NaN signals. ``at_cap`` marks points whose
    best nu_s is the well-posedness cap, or whose bounds did not meet near the cap. Their numbers do not bound
    the vehicle; they show that the class does not fit.
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
    """Checked arguments of :func:`solve`, one row per point."""

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
            raise InputError("S2", "names", f"{len(names)} for {points} points", "one a point")

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
        require(self.u != 0.0, "u", "zero", "an input: without one there is no multiplicative uncertainty")


@dataclass(frozen=True)
class _Maps:
    """Maps from well-scaled coordinates z = (theta, 1) to signals: ``xi``, ``w`` and ``eta`` (K, ., n)."""

    xi: np.ndarray
    w: np.ndarray
    eta: np.ndarray

    @classmethod
    def from_data(cls, data: _Data) -> _Maps:
        """Maps with free xi = (xi_i, xi_s): w = e - C d with d = h_i xi_i + h_s xi_s, and eta = x_nom + d."""
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
    """Forms (K, 4, n, n) of :func:`solve_forms`, scaled by the cost (K,) at ``start`` (K, n), and this
    cost."""
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
    gap : float, relative distance of the two sides
    names : Sequence[str], optional, experiment and bin of each point, for messages

    Returns
    -------
    S2Result

    Raises
    ------
    InputError
        If shapes do not fit, or a value is not finite or not positive; the error names the point.

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
    # A point inside the ball: from the least-squares point towards the one with the smallest w.
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
    """(B1 = min |w|, z) per point: z lies between theta = 0 and the point with |w| = B1, as near to 0 as |w|
    <= gamma allows."""
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
