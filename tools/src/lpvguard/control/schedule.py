"""Compute a controller over speed (core/scheduled.py): common poles; numerators and anti-windup at each node.

Controllers of the order of an H-infinity design differ from speed to speed mostly in their zeros. One set of
common poles serves all speeds with few more states. The poles come from one system: the controllers of all
nodes in parallel, each with separate inputs, their demands summed into one output. Weighted balanced
truncation reduces this system (Enns 1984). With these poles, every B is a linear least-squares fit. The
weight of both steps is the effect of a deviation dK on the scaled closed loop,

    D P12 (1 - K P22)^-1  dK  (1 - P22 K)^-1 P21 D^-1.

Balanced truncation leaves no states that nearly cancel. Such states would make B, and the storage functions
of the moving loop, vary more than necessary.

Model recovery compensates the limits (Weston and Postlethwaite 2000). Its state xi is the vehicle state
without limits minus the vehicle state with limits. It follows ``xi+ = (A_p - B_p F) xi - B_p (u - v)``. The
controller reads ``y + C_p xi`` instead of y. F xi is added to the controller's output and makes xi decay.
Both corrections together are a transfer function from u - v to v. The controller's own states can realise
this transfer function, because the zeros of K cancel the vehicle's poles. At each node, L is a linear
least-squares fit to the transfer function.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

from ..core.scheduled import Scheduled
from ..engine.synthesis.dk import Scaling
from ..engine.synthesis.interconnection import GeneralisedPlant
from ..engine.synthesis.statespace import StateSpace

FIT_POINTS = 100
"""Number of frequencies of the fits, besides zero, over five decades up to the Nyquist frequency."""
UNUSED = 1e-6
"""A measurement is left out at every node if its share of the fitted response is below this value."""
LARGEST_POLE = 1 - 1e-6
"""Largest modulus of a common pole. The weights can move a pole onto or outside the unit circle."""
RIDGE = 1e-6
"""Regularisation of each fit, as a share of a measurement's largest column. It keeps states of small effect
from cancelling each other."""
RECOVERY_RIDGE = 1e-4
RECOVERY_EFFORT = 0.03
"""Squared weight of the recovery's input (unit u_max) relative to its output (unit: steady response to
u_max)."""


@dataclass(frozen=True)
class FrozenLoop:
    """Loop at one speed: delayed controller, generalised plant, and vehicle from u to y, all discrete.

    ``controlled`` is the index of the controlled output.
    """

    controller: StateSpace
    plant: GeneralisedPlant
    vehicle: StateSpace
    controlled: int = 0


def fit_by_pairs(
    loops: Sequence[FrozenLoop], speeds: np.ndarray, scaling: Scaling, u_max: np.ndarray
) -> Callable[[int], Scheduled]:
    """Return a function that fits a schedule with a given number of pole pairs to the controllers of loops.

    There is one loop for each speed. u_max (G, n_u) is the largest |demand| at each speed [input unit]. Each
    schedule includes the delay. Raises LinAlgError if a loop has no sensitivity or no recovery.
    """
    Ts = loops[0].controller.dt
    omega = np.concatenate([[0.0], np.logspace(-5, 0, FIT_POINTS) * np.pi / Ts * (1 - 1e-9)])
    z = np.exp(1j * omega * Ts)
    fits = [fit for loop in loops for fit in _fits(loop, scaling, omega)]
    poles = _common_poles(loops, fits, z)
    n_u = loops[0].controller.n_outputs

    def fit(pairs: int) -> Scheduled:
        a = np.append(first_columns(poles(2 * pairs)), -1.0)
        B = _used(np.array([f.rows(a, z) for f in fits]), fits, a, z).reshape(len(loops), n_u, len(a), -1)
        L = np.array(
            [_recovery(loop, a, rows, top, z) for loop, rows, top in zip(loops, B, u_max, strict=True)]
        )
        return Scheduled(Ts, np.asarray(speeds, float), a, B, L, np.asarray(u_max, float))

    return fit


def _common_poles(
    loops: Sequence[FrozenLoop], fits: Sequence[_RowFit], z: np.ndarray
) -> Callable[[int], np.ndarray]:
    """Return a function that computes a given even number of common poles in the z plane."""
    density = np.sqrt(np.gradient(np.log(np.maximum(np.angle(z), 0.5 * np.angle(z[1])))))
    heard = density * np.sqrt(np.mean([f.left**2 for f in fits], axis=0))
    reached, seen, A, C = [], [], [], []
    for k, f in enumerate(fits):
        K = loops[k // loops[0].controller.n_outputs].controller
        row = K.C[k % K.n_outputs]
        pencil = z[:, None, None] * np.eye(K.order) - K.A
        X = np.linalg.solve(pencil, K.B @ f.right) * density[:, None, None]
        Y = np.linalg.solve(np.swapaxes(pencil, 1, 2), np.broadcast_to(row[:, None], (len(z), K.order, 1)))
        reached.append(_factor(np.moveaxis(X, 1, 0).reshape(K.order, -1)))
        seen.append((Y[:, :, 0] * heard[:, None]).T)
        A.append(K.A)
        C.append(row)
    R, S = sl.block_diag(*reached), _factor(np.vstack(seen))
    U, sigma, Vt = np.linalg.svd(S.T @ R)
    blocks = sl.block_diag(*A)

    def poles(count: int) -> np.ndarray:
        kept = 1 / np.sqrt(sigma[:count])
        eigenvalues = np.linalg.eigvals((S @ U[:, :count] * kept).T @ blocks @ (R @ Vt[:count].T * kept))
        size = np.abs(eigenvalues)
        return np.where(
            size < LARGEST_POLE, eigenvalues, eigenvalues * LARGEST_POLE / np.maximum(size, LARGEST_POLE)
        )

    return poles


def _factor(values: np.ndarray) -> np.ndarray:
    """Compute L (n, n) with L L' = Re(values values^H), for values (n, k)."""
    n = len(values)
    wide = np.hstack([values.real, values.imag, np.zeros((n, n))])
    R = np.asarray(np.linalg.qr(wide.T, mode="r"))
    return R.T


def first_columns(poles: np.ndarray) -> np.ndarray:
    """Compute the coefficients a (n,) of the pole pairs of ``poles`` (n,) in the z plane, slowest pair first.

    Each complex pole is followed by its conjugate. The number of real poles is even.
    """
    real = np.sort(poles[np.abs(poles.imag) < 1e-9].real)[::-1]
    upper = poles[poles.imag >= 1e-9]
    pairs = np.vstack([np.column_stack([upper, upper.conj()]), real.reshape(-1, 2)]) - 1
    pairs = pairs[np.argsort(np.abs(pairs[:, 0]), kind="stable")]
    return np.column_stack([pairs.sum(axis=1), -pairs.prod(axis=1)]).real.ravel()


def _used(B: np.ndarray, fits: Sequence[_RowFit], a: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Set B (k, n, m) to zero for the measurements that no fit needs, which saves states in proofs."""
    share = np.zeros(B.shape[2])
    for rows, f in zip(B, fits, strict=True):
        K = f.left[:, None] * (observed(a, z) @ rows)
        parts = np.linalg.norm(K[:, :, None] * f.right, axis=(0, 2))
        share = np.maximum(share, parts / np.linalg.norm(parts))
    return np.where(share > UNUSED, B, 0.0)


def observed(a: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Compute C (z I - A)^-1 (k, n), the contribution of each state to the demand."""
    d = z[:, None] - 1
    first, second = a[: len(a) // 2 * 2].reshape(-1, 2).T
    pair = 1 / (d * d - first * d - second)
    columns = np.stack([d * pair, pair], axis=2).reshape(len(z), -1)
    return np.hstack([columns, 1 / (d - a[-1])]) if len(a) % 2 else columns


def _stacked(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values.real, values.imag])


@dataclass(frozen=True)
class _RowFit:
    """Fit of one demand at one speed: target response (k, m), left weight (k,) and right weight (k, m, m)."""

    response: np.ndarray
    left: np.ndarray
    right: np.ndarray

    def problem(self, a: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return matrix, right-hand side and state scales of the least-squares problem for B (n, m)."""
        seen = observed(a, z)
        size = np.sqrt(np.mean(np.abs(seen) ** 2, axis=0))
        K = np.einsum("k,kj,kmc->kcjm", self.left, seen / size, self.right).reshape(self.response.size, -1)
        target = np.einsum("k,km,kmc->kc", self.left, self.response, self.right).ravel()
        # Each measurement has its own scale. The columns of a measurement of little effect are much larger.
        largest = np.linalg.norm(K, axis=0).reshape(len(a), -1).max(axis=0)
        ridge = RIDGE * np.diag(np.tile(largest, len(a)))
        return np.vstack([_stacked(K), ridge]), np.append(_stacked(target), np.zeros(len(ridge))), size

    def rows(self, a: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Compute the best B (n, m)."""
        K, target, size = self.problem(a, z)
        return np.linalg.lstsq(K, target, rcond=None)[0].reshape(len(a), -1) / size[:, None]


def _fits(loop: FrozenLoop, scaling: Scaling, omega: np.ndarray) -> list[_RowFit]:
    """Make one fit for each demand, weighted by the scaled closed loop."""
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


def _recovery(loop: FrozenLoop, a: np.ndarray, B: np.ndarray, u_max: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Compute the anti-windup gain L (n_u, n, n_u) at one speed; see the module's docstring.

    The reference column of B (n_u, n, 1 + n_y) is not used. u_max is (n_u,).
    """
    A_p, B_p, C_p = loop.vehicle.A, loop.vehicle.B, loop.vehicle.C
    eye, n_u = np.eye(len(A_p)), len(u_max)
    c = C_p[loop.controlled]
    in_the_end = (C_p @ np.linalg.solve(eye - A_p, B_p))[loop.controlled] * u_max
    Q, R = np.outer(c, c) / (in_the_end @ in_the_end), RECOVERY_EFFORT * np.diag(u_max**-2.0)
    X = sl.solve_discrete_are(A_p, B_p, Q, R)
    F = np.linalg.solve(R + B_p.T @ X @ B_p, B_p.T @ X @ A_p)
    seen = observed(a, z)
    shown = np.einsum("kj,ijm->kim", seen, B[:, :, 1:]) @ C_p + F
    recovery = -shown @ np.linalg.solve(
        z[:, None, None] * eye - A_p + B_p @ F, np.broadcast_to(B_p, (len(z), *B_p.shape))
    )
    # At its limits, the demand is scaled by (1 + recovery)^-1. The same factor weights a deviation.
    weight = np.linalg.norm(np.linalg.inv(np.eye(n_u) + recovery), axis=1)
    L = np.empty((n_u, len(a), n_u))
    for i in range(n_u):
        K = seen * weight[:, i, None]
        size = np.linalg.norm(K, axis=0)
        problem = np.vstack([_stacked(K / size), RECOVERY_RIDGE * np.eye(len(a))])
        target = np.vstack([_stacked(recovery[:, i] * weight[:, i, None]), np.zeros((len(a), n_u))])
        L[i] = np.linalg.lstsq(problem, target, rcond=None)[0] / size[:, None]
    return L
