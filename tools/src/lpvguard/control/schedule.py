"""Finding a controller over speed: its common poles and, at every node, its numerators and anti-windup
(core/scheduled.py).

A controller of the order of an H-infinity design differs from speed to speed mostly in its zeros: a set of
poles common to all speeds serves them all with few more states. The poles are found by variable projection
(Golub and Pereyra 1973): given them, every B is a linear least-squares fit, weighed by what a deviation of K
does to the scaled closed loop,

    D P12 (1 - K P22)^-1  dK  (1 - P22 K)^-1 P21 D^-1.

Limits are compensated by model recovery (Weston and Postlethwaite 2000). xi is the state of the loop without
limits minus the vehicle's state, and follows xi+ = (A_p - B_p F) xi - B_p (u - v). The controller reads y +
C_p xi instead of y. F xi is added to its output and makes xi decay. Both together are a transfer function
from u - v to v. The controller's own states can realise it, because K's zeros cancel the vehicle's poles. L
is a linear least-squares fit to it, per node.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
from scipy.optimize import least_squares

from ..core.scheduled import Scheduled
from ..engine.synthesis.dk import Scaling
from ..engine.synthesis.interconnection import GeneralisedPlant
from ..engine.synthesis.statespace import StateSpace

FIT_POINTS = 100
"""Frequencies of the fits, besides zero: five decades up to the Nyquist frequency."""
FIT_STEPS = 40
"""Steps of the search for poles."""
SLOPE_STEP = 1e-5
"""Of the logarithms of a pair's coefficients, for the derivatives of its a."""
RIDGE = 1e-6
"""Of a measurement's largest column, added to each fit: keeps states that contribute little from cancelling
each other."""
RECOVERY_RIDGE = 1e-4
RECOVERY_EFFORT = 0.03
"""Weight of the recovery's input, in the node's u_max, against the output, in what u_max makes of it in the
end; in squares."""


@dataclass(frozen=True)
class FrozenLoop:
    """One speed: the controller to be realised, one sample late; its generalised plant; the vehicle from u to
    y. All discrete."""

    controller: StateSpace
    plant: GeneralisedPlant
    vehicle: StateSpace


def fit(
    loops: Sequence[FrozenLoop], speeds: np.ndarray, scaling: Scaling, pairs: int, u_max: np.ndarray
) -> Scheduled:
    """The schedule of ``pairs`` pairs of poles and a delay that comes nearest to the controllers of
    ``loops``, one a speed.

    u_max (G, n_u): largest |demand| at every speed [input unit]. Raises LinAlgError where a loop's
    sensitivity or recovery does not exist.
    """
    Ts = loops[0].controller.dt
    omega = np.concatenate([[0.0], np.logspace(-5, 0, FIT_POINTS) * np.pi / Ts * (1 - 1e-9)])
    z = np.exp(1j * omega * Ts)
    fits = [fit for loop in loops for fit in _fits(loop, scaling, omega)]
    rates = np.concatenate([np.abs(_rates(loop.controller)) for loop in loops])
    start = np.clip(
        np.quantile(np.log(rates), np.linspace(0.05, 0.95, pairs)),
        np.log(2 * omega[1]),
        np.log(0.5 * omega[-1]),
    )
    low, high = np.log(omega[1]), np.log(omega[-1])

    def slopes(theta: np.ndarray) -> np.ndarray:
        a, slope = first_columns(theta, Ts), _slopes_of_columns(theta, Ts)
        return np.concatenate([f.slope(a, slope, z) for f in fits])

    found = least_squares(
        lambda theta: np.concatenate([f.miss(first_columns(theta, Ts), z) for f in fits]),
        np.column_stack([start + np.log(1.4), 2 * start]).ravel(),
        jac=slopes,
        max_nfev=FIT_STEPS,
        bounds=(np.tile([low, 2 * low], pairs), np.tile([high + np.log(2.0), 2 * high], pairs)),
    )
    a = first_columns(found.x, Ts)
    n_u = loops[0].controller.n_outputs
    B = np.array([f.rows(a, z) for f in fits]).reshape(len(loops), n_u, len(a), -1)
    L = np.array(
        [_recovery(loop.vehicle, a, rows, top, z) for loop, rows, top in zip(loops, B, u_max, strict=True)]
    )
    return Scheduled(Ts, np.asarray(speeds, float), a, B, L, np.asarray(u_max, float))


def _rates(K: StateSpace) -> np.ndarray:
    """Poles of a discrete system in rad/s, those at zero left out."""
    poles = K.poles()
    return np.log(poles[np.abs(poles) > 1e-9].astype(complex)) / K.dt


def first_columns(theta: np.ndarray, Ts: float) -> np.ndarray:
    """a of pairs with s^2 + p s + q = 0, theta = (ln p, ln q, ...), and of a state at z = 0: the delay."""
    p, q = np.exp(theta[0::2]), np.exp(theta[1::2])
    # Sum of the two e^(s Ts) less 2, and minus the product of the two e^(s Ts) - 1, without cancellation.
    root = Ts * np.sqrt((p * p / 4 - q).astype(complex))
    first, second = (np.expm1(-p * Ts / 2 + sign * root) for sign in (1, -1))
    return np.append(np.column_stack([(first + second).real, -(first * second).real]).ravel(), -1.0)


def _slopes_of_columns(theta: np.ndarray, Ts: float) -> np.ndarray:
    """Derivatives (pairs, 2, 2) of each pair's a by its ln p and by its ln q, by central differences:
    smooth at double poles, too."""
    out = np.empty((len(theta) // 2, 2, 2))
    for k in (0, 1):
        step = np.zeros(len(theta))
        step[k::2] = SLOPE_STEP
        change = first_columns(theta + step, Ts) - first_columns(theta - step, Ts)
        out[:, k] = change[:-1].reshape(-1, 2) / (2 * SLOPE_STEP)
    return out


def observed(a: np.ndarray, z: np.ndarray) -> np.ndarray:
    """C (z I - A)^-1, (k, n): what each state adds to the demand."""
    d = z[:, None] - 1
    first, second = a[: len(a) // 2 * 2].reshape(-1, 2).T
    pair = 1 / (d * d - first * d - second)
    columns = np.stack([d * pair, pair], axis=2).reshape(len(z), -1)
    return np.hstack([columns, 1 / (d - a[-1])]) if len(a) % 2 else columns


def _stacked(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values.real, values.imag])


@dataclass(frozen=True)
class _RowFit:
    """One demand at one speed: response (k, m) to be met, weights left (k,) and right (k, m, m) of a
    deviation."""

    response: np.ndarray
    left: np.ndarray
    right: np.ndarray

    def problem(self, a: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Matrix, right-hand side and scales of the states, of the least-squares problem for B (n, m)."""
        seen = observed(a, z)
        size = np.sqrt(np.mean(np.abs(seen) ** 2, axis=0))
        K = np.einsum("k,kj,kmc->kcjm", self.left, seen / size, self.right).reshape(self.response.size, -1)
        wanted = np.einsum("k,km,kmc->kc", self.left, self.response, self.right).ravel()
        # By measurement: one that the loop must hardly use weighs its columns up by orders of magnitude.
        largest = np.linalg.norm(K, axis=0).reshape(len(a), -1).max(axis=0)
        ridge = RIDGE * np.diag(np.tile(largest, len(a)))
        return np.vstack([_stacked(K), ridge]), np.append(_stacked(wanted), np.zeros(len(ridge))), size

    def miss(self, a: np.ndarray, z: np.ndarray) -> np.ndarray:
        """What the best B leaves."""
        K, wanted, _ = self.problem(a, z)
        Q = np.linalg.qr(K)[0]
        return wanted - Q @ (Q.T @ wanted)

    def slope(self, a: np.ndarray, by_theta: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Derivatives of ``miss`` by theta, (rows, 2 pairs), variable projection's (Golub and Pereyra 1973).

        by_theta (pairs, 2, 2): of ``_slopes_of_columns``. That the ridge moves with the poles, by a millionth
        part of a column, is left out.
        """
        K, wanted, size = self.problem(a, z)
        Q, R = np.linalg.qr(K)
        inside = Q.T @ wanted
        left_over = (wanted - Q @ inside)[: 2 * self.response.size].reshape(2, *self.response.shape)
        pairs, m = len(by_theta), self.response.shape[1]
        B = sl.solve_triangular(R, inside).reshape(len(a), m)[: 2 * pairs].reshape(pairs, 2, m)
        scales = size[: 2 * pairs].reshape(pairs, 2)
        d = z - 1
        numerator = np.stack([d, np.ones_like(d)])  # of a pair's two states
        # pair = 1 / (d^2 - a d - a'), so its derivative is pair^2 (da d + da').
        pair = observed(a, z)[:, 1 : 2 * pairs : 2].T
        moved = pair[:, None] ** 2 * (by_theta @ numerator)  # (pairs, 2 of theta, k)
        seen = np.einsum("pj,pjm,jk,kmc,k->pkc", 1 / scales, B, numerator, self.right, self.left)
        V = (moved[..., None] * seen[:, None]).reshape(2 * pairs, -1)
        V = np.hstack([V.real, V.imag, np.zeros((2 * pairs, len(K) - 2 * V.shape[1]))]).T
        back = np.einsum("k,kmc,kc->km", self.left, self.right.conj(), left_over[0] + 1j * left_over[1])
        weights = np.einsum("ptk,jk->ptjk", moved, numerator).conj() @ back
        W = np.zeros((len(a), m, pairs, 2))
        for k in range(pairs):
            W[2 * k : 2 * k + 2, :, k] = np.moveaxis(weights[k].real / scales[k][:, None], 0, 2)
        return Q @ (Q.T @ V - sl.solve_triangular(R, W.reshape(len(R), -1), trans="T")) - V

    def rows(self, a: np.ndarray, z: np.ndarray) -> np.ndarray:
        """The best B (n, m)."""
        K, wanted, size = self.problem(a, z)
        return np.linalg.lstsq(K, wanted, rcond=None)[0].reshape(len(a), -1) / size[:, None]


def _fits(loop: FrozenLoop, scaling: Scaling, omega: np.ndarray) -> list[_RowFit]:
    """One fit a demand, weighed by the scaled closed loop."""
    plant, K = loop.plant, loop.controller.response(omega)
    P = plant.system.response(omega)
    n_z, n_w = P.shape[1] - plant.n_measurement, P.shape[2] - plant.n_control
    P22 = P[:, n_z:, n_w:]
    left = P[:, :n_z, n_w:] @ np.linalg.inv(np.eye(plant.n_control) - K @ P22)
    right = np.linalg.solve(np.eye(plant.n_measurement) - P22 @ K, P[:, n_z:, :n_w])
    row = col = 0
    for block, d in zip(plant.blocks, np.exp(scaling.log_magnitude(omega)), strict=False):
        left[:, row : row + block.cols] *= d[:, None, None]
        right[:, :, col : col + block.rows] /= d[:, None, None]
        row, col = row + block.cols, col + block.rows
    square = right @ np.conj(np.swapaxes(right, 1, 2))
    floor = 1e-12 * np.trace(square, axis1=1, axis2=2).real[:, None, None] * np.eye(plant.n_measurement)
    factor = np.linalg.cholesky(square + floor)
    return [_RowFit(K[:, i], np.linalg.norm(left[:, :, i], axis=1), factor) for i in range(plant.n_control)]


def _recovery(
    vehicle: StateSpace, a: np.ndarray, B: np.ndarray, u_max: np.ndarray, z: np.ndarray
) -> np.ndarray:
    """L (n_u, n, n_u) at one speed (the module's docstring), B (n_u, n, 1 + n_y) without the reference's
    column, u_max (n_u,)."""
    A_p, B_p, C_p = vehicle.A, vehicle.B, vehicle.C
    eye, n_u = np.eye(len(A_p)), len(u_max)
    in_the_end = (C_p @ np.linalg.solve(eye - A_p, B_p))[0] * u_max
    Q, R = np.outer(C_p[0], C_p[0]) / (in_the_end @ in_the_end), RECOVERY_EFFORT * np.diag(u_max**-2.0)
    X = sl.solve_discrete_are(A_p, B_p, Q, R)
    F = np.linalg.solve(R + B_p.T @ X @ B_p, B_p.T @ X @ A_p)
    seen = observed(a, z)
    shown = np.einsum("kj,ijm->kim", seen, B[:, :, 1:]) @ C_p + F
    wanted = -shown @ np.linalg.solve(
        z[:, None, None] * eye - A_p + B_p @ F, np.broadcast_to(B_p, (len(z), *B_p.shape))
    )
    # With L the demand under limits is (1 + wanted)^-1 of what it would be: a deviation counts by that.
    weight = np.linalg.norm(np.linalg.inv(np.eye(n_u) + wanted), axis=1)
    L = np.empty((n_u, len(a), n_u))
    for i in range(n_u):
        K = seen * weight[:, i, None]
        size = np.linalg.norm(K, axis=0)
        problem = np.vstack([_stacked(K / size), RECOVERY_RIDGE * np.eye(len(a))])
        target = np.vstack([_stacked(wanted[:, i] * weight[:, i, None]), np.zeros((len(a), n_u))])
        L[i] = np.linalg.lstsq(problem, target, rcond=None)[0] / size[:, None]
    return L
