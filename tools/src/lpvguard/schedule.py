"""Controllers over speed as one realisation with fixed poles: what lib/include/lpvguard/controller.h runs.

A controller of the order of an H-infinity design differs from speed to speed mostly in its zeros: a set of poles common to
all speeds serves them all with few more states, and then

    K(z, v) = c(z)' B(v),    c(z) = C (z I - A)^-1 with A, C constant,

has an interpolation that is exact (B linear in v: the response at a constant speed is the linear interpolation of its
neighbours'), states that mean the same at every speed, and only B to be scheduled. A is block diagonal of pairs of poles in
delta-operator observer form (Middleton and Goodwin 1990), [[1 + a, 1], [a', 1]]: real poles become complex without
a jump in a, a', and C needs no multiplication. The poles are found by variable projection (Golub and Pereyra 1973): given
them, every B is a linear least-squares fit, weighed by what a deviation of K does to the scaled closed loop,

    D P12 (1 - K P22)^-1  dK  (1 - P22 K)^-1 P21 D^-1.

Limits are compensated by model recovery (Weston and Postlethwaite 2000). xi is the state of the loop without limits minus the
vehicle's state, and follows xi+ = (A_p - B_p F) xi - B_p (u - v). The controller reads y + C_p xi instead of y. F xi is added to its
output and makes xi decay. Both together are a transfer function from u - v to v. The controller's own states can realise it,
because K's zeros cancel the vehicle's poles. L is a linear least-squares fit to it, per node.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
from scipy.optimize import least_squares

from .synthesis.dk import Scaling
from .synthesis.interconnection import GeneralisedPlant
from .synthesis.statespace import StateSpace

FIT_POINTS = 100
"""Frequencies of the fits, besides zero: five decades up to the Nyquist frequency."""
FIT_STEPS = 40
"""Steps of the search for poles."""
RIDGE = 1e-6
"""Of the largest column, added to each fit: keeps states that contribute little from cancelling each other."""
RECOVERY_RIDGE = 1e-4
RECOVERY_EFFORT = 0.03
"""Weight of the recovery's input, in u_max, against the output, in what u_max makes of it in the end; in squares."""


@dataclass(frozen=True)
class Scheduled:
    """Strictly proper discrete controllers over speed: x+ = A x + B(v) m + L(v) (u - C x), u = C x, per demand.

    speeds (G,), equally spaced; a (n,): first columns of the pairs of A - I, then of a single state where n is odd, the same
    for every demand; B (G, n_u, n, 1 + n_y); L (G, n_u, n, n_u). m = [reference, outputs].
    """

    Ts: float
    speeds: np.ndarray
    a: np.ndarray
    B: np.ndarray
    L: np.ndarray

    @classmethod
    def read(cls, document: dict) -> Scheduled:
        """From a controller.json."""
        return cls(document["Ts_s"], *(np.array(document[key], float) for key in ("speeds", "a", "B", "L")))

    def digest(self) -> str:
        """SHA-256 over every coefficient: which controller a certificate is about."""
        arrays = (np.array(self.Ts), self.speeds, self.a, self.B, self.L)
        return hashlib.sha256(b"".join(np.ascontiguousarray(x, "<f8").tobytes() for x in arrays)).hexdigest()

    @property
    def order(self) -> int:
        """States of all demands."""
        return self.B.shape[1] * len(self.a)

    def at(self, v: float) -> StateSpace:
        """The controller the core runs at speed v: float32 coefficients with A - I formed in double, interpolated."""
        A, C = self._constant()
        B = self._between(self.B, v)
        return StateSpace(A, B, C, np.zeros((len(C), B.shape[1])), self.Ts)

    def injection_radius(self, v: float) -> float:
        """Spectral radius of A - L C at speed v."""
        A, C = self._constant()
        return float(np.abs(np.linalg.eigvals(A - self._between(self.L, v) @ C)).max())

    def _constant(self) -> tuple[np.ndarray, np.ndarray]:
        """A and C of all demands."""
        A, c = realisation(self.a.astype(np.float32).astype(float))
        n_u = self.B.shape[1]
        return np.kron(np.eye(n_u), A), np.kron(np.eye(n_u), c)

    def _between(self, values: np.ndarray, v: float) -> np.ndarray:
        """(order, columns): rows of B or L at speed v."""
        position = np.clip((v - self.speeds[0]) / (self.speeds[-1] - self.speeds[0]), 0.0, 1.0) * (len(self.speeds) - 1)
        k = min(int(position), len(self.speeds) - 2)
        rounded = values[k:k + 2].astype(np.float32).astype(float)
        return ((1 - (position - k)) * rounded[0] + (position - k) * rounded[1]).reshape(self.order, -1)


@dataclass(frozen=True)
class FrozenLoop:
    """One speed: the controller to be realised, one sample late; its generalised plant; the vehicle from u to y. All discrete."""

    controller: StateSpace
    plant: GeneralisedPlant
    vehicle: StateSpace


def realisation(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A (n, n) and C (1, n) of one demand's states, pairs and a single one where n is odd."""
    n = len(a)
    A, heads = np.eye(n), np.arange(0, n, 2)
    A[np.arange(n), np.arange(n) // 2 * 2] += a
    A[heads[:n // 2], heads[:n // 2] + 1] = 1.0
    return A, np.isin(np.arange(n), heads)[None].astype(float)


def engagement(a: np.ndarray, B: np.ndarray) -> np.ndarray:
    """E (n, 2): x += E (u - C x, -(C (A x + B m) - C x)) makes this and the next wanted demand u; a, B as in ``Scheduled``.

    The likeliest such change: least in the metric of the covariance that white m of equal size at all speeds gives x.
    Where no state can meet both, the second is left out. Raises LinAlgError unless the poles are stable.
    """
    A, c = realisation(a)
    if np.abs(np.linalg.eigvals(A)).max() >= 1:
        raise np.linalg.LinAlgError("a pole on or outside the unit circle")
    drive = np.moveaxis(B, 2, 0).reshape(len(a), -1)
    size = np.linalg.norm(drive, axis=1)
    P = sl.solve_discrete_lyapunov(A, drive @ drive.T) if size.any() else np.eye(len(a))
    M = np.vstack([c, c @ (A - np.eye(len(a)))])
    first = P @ c.T / (c @ P @ c.T)
    rest = M[1] - M[1] @ first * c  # what the second constraint asks for when the first is met
    left = (rest @ P @ rest.T).item()
    if left <= 1e-9 * (M[1] @ P @ M[1]):
        return np.hstack([first, np.zeros_like(first)])
    second = P @ rest.T / left
    return np.hstack([first - second * (M[1] @ first), second])


def fit(loops: Sequence[FrozenLoop], speeds: np.ndarray, scaling: Scaling, pairs: int, u_max: np.ndarray) -> Scheduled:
    """The schedule of ``pairs`` pairs of poles and a delay that comes nearest to the controllers of ``loops``, one a speed.

    u_max (n_u,): largest demand. Raises LinAlgError where a loop's sensitivity or recovery does not exist.
    """
    Ts = loops[0].controller.dt
    omega = np.concatenate([[0.0], np.logspace(-5, 0, FIT_POINTS) * np.pi / Ts * (1 - 1e-9)])
    z = np.exp(1j * omega * Ts)
    fits = [fit for loop in loops for fit in _fits(loop, scaling, omega)]
    rates = np.concatenate([np.abs(_rates(loop.controller)) for loop in loops])
    start = np.clip(np.quantile(np.log(rates), np.linspace(0.05, 0.95, pairs)), np.log(2 * omega[1]), np.log(0.5 * omega[-1]))
    low, high = np.log(omega[1]), np.log(omega[-1])
    found = least_squares(lambda theta: np.concatenate([f.miss(_first_columns(theta, Ts), z) for f in fits]),
                          np.column_stack([start + np.log(1.4), 2 * start]).ravel(), max_nfev=FIT_STEPS,
                          bounds=(np.tile([low, 2 * low], pairs), np.tile([high + np.log(2.0), 2 * high], pairs)))
    a = _first_columns(found.x, Ts)
    n_u = loops[0].controller.n_outputs
    B = np.array([f.rows(a, z) for f in fits]).reshape(len(loops), n_u, len(a), -1)
    L = np.array([_recovery(loop.vehicle, a, rows, u_max, z) for loop, rows in zip(loops, B)])
    return Scheduled(Ts, np.asarray(speeds, float), a, B, L)


def _rates(K: StateSpace) -> np.ndarray:
    """Poles of a discrete system in rad/s, those at zero left out."""
    poles = K.poles()
    return np.log(poles[np.abs(poles) > 1e-9].astype(complex)) / K.dt


def _first_columns(theta: np.ndarray, Ts: float) -> np.ndarray:
    """a of pairs with s^2 + p s + q = 0, theta = (ln p, ln q, ...), and of a state at z = 0: the delay."""
    p, q = np.exp(theta[0::2]), np.exp(theta[1::2])
    # Sum of the two e^(s Ts) less 2, and minus the product of the two e^(s Ts) - 1, without cancellation.
    root = Ts * np.sqrt((p * p / 4 - q).astype(complex))
    first, second = (np.expm1(-p * Ts / 2 + sign * root) for sign in (1, -1))
    return np.append(np.column_stack([(first + second).real, -(first * second).real]).ravel(), -1.0)


def _observed(a: np.ndarray, z: np.ndarray) -> np.ndarray:
    """C (z I - A)^-1, (k, n): what each state adds to the demand."""
    d = z[:, None] - 1
    first, second = a[:len(a) // 2 * 2].reshape(-1, 2).T
    pair = 1 / (d * d - first * d - second)
    columns = np.stack([d * pair, pair], axis=2).reshape(len(z), -1)
    return np.hstack([columns, 1 / (d - a[-1])]) if len(a) % 2 else columns


def _stacked(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values.real, values.imag])


@dataclass(frozen=True)
class _RowFit:
    """One demand at one speed: response (k, m) to be met, weights left (k,) and right (k, m, m) of a deviation."""

    response: np.ndarray
    left: np.ndarray
    right: np.ndarray

    def problem(self, a: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Matrix, right-hand side and scales of the states, of the least-squares problem for B (n, m)."""
        seen = _observed(a, z)
        size = np.sqrt(np.mean(np.abs(seen) ** 2, axis=0))
        K = np.einsum("k,kj,kmc->kcjm", self.left, seen / size, self.right).reshape(self.response.size, -1)
        wanted = np.einsum("k,km,kmc->kc", self.left, self.response, self.right).ravel()
        ridge = RIDGE * np.linalg.norm(K, axis=0).max() * np.eye(K.shape[1])
        return np.vstack([_stacked(K), ridge]), np.append(_stacked(wanted), np.zeros(len(ridge))), size

    def miss(self, a: np.ndarray, z: np.ndarray) -> np.ndarray:
        """What the best B leaves."""
        K, wanted, _ = self.problem(a, z)
        Q = np.linalg.qr(K)[0]
        return wanted - Q @ (Q.T @ wanted)

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
    for block, d in zip(plant.blocks, np.exp(scaling.log_magnitude(omega))):
        left[:, row:row + block.rows] *= d[:, None, None]
        right[:, :, col:col + block.cols] /= d[:, None, None]
        row, col = row + block.rows, col + block.cols
    square = right @ np.conj(np.swapaxes(right, 1, 2))
    floor = 1e-12 * np.trace(square, axis1=1, axis2=2).real[:, None, None] * np.eye(plant.n_measurement)
    factor = np.linalg.cholesky(square + floor)
    return [_RowFit(K[:, i], np.linalg.norm(left[:, :, i], axis=1), factor) for i in range(plant.n_control)]


def _recovery(vehicle: StateSpace, a: np.ndarray, B: np.ndarray, u_max: np.ndarray, z: np.ndarray) -> np.ndarray:
    """L (n_u, n, n_u) at one speed (the module's docstring), B (n_u, n, 1 + n_y) without the reference's column."""
    A_p, B_p, C_p = vehicle.A, vehicle.B, vehicle.C
    eye, n_u = np.eye(len(A_p)), len(u_max)
    in_the_end = (C_p @ np.linalg.solve(eye - A_p, B_p))[0] * u_max
    Q, R = np.outer(C_p[0], C_p[0]) / (in_the_end @ in_the_end), RECOVERY_EFFORT * np.diag(u_max ** -2.0)
    X = sl.solve_discrete_are(A_p, B_p, Q, R)
    F = np.linalg.solve(R + B_p.T @ X @ B_p, B_p.T @ X @ A_p)
    seen = _observed(a, z)
    shown = np.einsum("kj,ijm->kim", seen, B[:, :, 1:]) @ C_p + F
    wanted = -shown @ np.linalg.solve(z[:, None, None] * eye - A_p + B_p @ F, np.broadcast_to(B_p, (len(z), *B_p.shape)))
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
