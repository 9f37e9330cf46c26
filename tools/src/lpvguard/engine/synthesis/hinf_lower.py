"""Lower bounds of the H∞ optimum by a dual certificate, whose check does not depend on its construction.

Some controller reaches a level γ exactly when R and S exist with (Gahinet & Apkarian 1994)

    N₁ᵀ L(R; A, B1, C1) N₁ ≺ 0,   N₂ᵀ L(S; Aᵀ, C1ᵀ, B1ᵀ) N₂ ≺ 0,   [R I; I S] ≽ 0,

                 ⎡ A R + R Aᵀ   R C1ᵀ   B1  ⎤
    L(R; ...) =  ⎢ C1 R         −γ I    D11 ⎥,   N₁ = null [B2ᵀ D12ᵀ 0],   N₂ = null [C2 D21 0].
                 ⎣ B1ᵀ          D11ᵀ   −γ I ⎦

Let Z₁, Z₂ ≽ 0 lie within these null spaces, and let tr(Z₁ L(R)) = tr(R Q₁) + c₁ − γ t₁. Define Q₂, c₂ and t₂
in the same way by Z₂. Where Q₁, Q₂ ≽ 0, every such γ is at least

    (c₁ + c₂ + 2 ‖Q₁^½ Q₂^½‖_*) / (t₁ + t₂).

*Proof.* Add the three inequalities, the third with the multiplier [Q₁ W; Wᵀ Q₂] ≽ 0. R and S then cancel. The
least tr W of such a multiplier is minus the nuclear norm. ∎

Any Z₁, Z₂ give a bound. The Gramians of the worst trajectories of the two Riccati equations give a good
bound. These trajectories start in the direction in which the solutions of the equations couple most.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
from scipy.optimize import minimize_scalar

from lpvguard.engine.synthesis.frequency_cells import response_rounding
from lpvguard.engine.synthesis.partition import Plant
from lpvguard.engine.synthesis.riccati import Side
from lpvguard.engine.synthesis.statespace import StateSpace

GRID, PEAKS = 100, 3
ALLOWANCE = 1e-12
"""Largest relative change of the entries, in balanced coordinates, that makes a certificate exact. It is far
above the rounding of the sums."""
BELOW = (1e-7, 1e-6, 1e-5, 3e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2)
"""Trajectories are computed at these relative distances below the claimed optimum."""


@dataclass(frozen=True)
class DualCertificate:
    """Factors of Z₁ = first firstᵀ and Z₂ = second secondᵀ: (n + p1 + m1, k) and (n + m1 + p1, k)."""

    first: np.ndarray
    second: np.ndarray


def dual_bound(P: Plant, certificate: DualCertificate, allowance: float = ALLOWANCE) -> float:
    """Return the lower bound of γ that the certificate proves for every controller of ``P``, or 0.

    The multipliers may violate their conditions by the effect of a relative change ``allowance`` of the
    plant's entries.
    """
    constant, traces, halves = 0.0, 0.0, []
    for Q, Z in ((P, certificate.first), (P.dual, certificate.second)):
        half, part, trace = _one_side(Q, Z, allowance)
        if half is None:
            return 0.0
        constant, traces = constant + part, traces + trace
        halves.append(half)
    if not traces > 0:
        return 0.0
    coupling = 2 * float(np.linalg.norm(halves[0].T @ halves[1], "nuc"))
    return max(0.0, (constant + coupling) / traces)


def _one_side(P: Plant, Z: np.ndarray, allowance: float) -> tuple[np.ndarray | None, float, float]:
    """Return a factor of Q, c and t of one side. The factor is None where Q is not ≽ 0."""
    n, p1 = len(P.A), len(P.C1)
    p, z, w = Z[:n], Z[n : n + p1], Z[n + p1 :]
    outside = P.B2.T @ p + P.D12.T @ z
    size = np.abs(P.B2).T @ np.abs(p) + np.abs(P.D12).T @ np.abs(z)
    if np.linalg.norm(outside) > allowance * np.linalg.norm(size):
        return None, 0.0, 0.0
    flow = p @ (p.T @ P.A + z.T @ P.C1)
    Q = flow + flow.T
    terms = np.abs(p) @ (np.abs(p).T @ np.abs(P.A) + np.abs(z).T @ np.abs(P.C1))
    values, vectors = np.linalg.eigh(Q)
    if values[0] < -allowance * np.linalg.norm(terms):
        return None, 0.0, 0.0
    half = vectors * np.sqrt(np.maximum(values, 0.0))
    constant = 2 * float(np.sum(p * (P.B1 @ w))) + 2 * float(np.sum(z * (P.D11 @ w)))
    return half, constant, float(np.sum(z * z) + np.sum(w * w))


def dual_certificate(P: Plant, control: Side, filter_: Side, level: float) -> DualCertificate | None:
    """Return the certificate of the worst trajectories at ``level``, or None without such trajectories.

    ``level`` is a little below the optimum. ``control`` and ``filter_`` are the Riccati equations of the
    plant and of its dual.
    """
    sides = [side for side in (_trajectories(control, level), _trajectories(filter_, level)) if side]
    if len(sides) < 2:
        return None
    starts: list[np.ndarray | None] = [None, None]
    lost = [k for k, side in enumerate(sides) if not side.definite]
    if lost:  # this equation alone excludes the level: start in the direction of negative cost
        starts[lost[0]] = np.linalg.eigh(sides[lost[0]].X)[1][:, 0]
    else:
        roots = [_root(side.X) for side in sides]
        u, _, v = np.linalg.svd(roots[0].T @ control.basis.T @ filter_.basis @ roots[1])
        starts = [np.linalg.lstsq(r.T, d, rcond=None)[0] for r, d in zip(roots, (u[:, 0], v[0]), strict=True)]
    factors = []
    for Q, side, start in zip((P, P.dual), sides, starts, strict=True):
        empty = np.zeros((len(Q.A) + len(Q.C1) + Q.B1.shape[1], 0))
        factor = empty if start is None else side.gramian_factor(Q, start, level)
        if factor is None:
            return None
        factors.append(factor)
    return DualCertificate(*factors)


@dataclass(frozen=True)
class _Trajectories:
    """Saddle-point trajectories x' = ``A`` x of one side, with z = ``C`` x and the adjoint state ``X`` x."""

    side: Side
    X: np.ndarray
    A: np.ndarray
    C: np.ndarray
    definite: bool

    def gramian_factor(self, P: Plant, start: np.ndarray, level: float) -> np.ndarray | None:
        """Return the factor of Z for the trajectory from ``start`` (n_r,)."""
        try:
            gramian = sl.solve_continuous_lyapunov(self.A, -np.outer(start, start))
        except np.linalg.LinAlgError:
            return None
        values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
        half = vectors * np.sqrt(np.maximum(values, 0.0))
        p, z = self.side.basis @ self.X @ half, self.C @ half
        return np.vstack([p, z, (P.B1.T @ p + P.D11.T @ z) / level])


def _trajectories(side: Side, level: float) -> _Trajectories | None:
    solution = side.solve(level)
    if solution is None or not len(side.A):
        return None
    inverse = np.linalg.pinv(side.basis)
    X = inverse @ solution.X @ inverse.T
    B, D = np.hstack([side.B1, side.B2]), np.hstack([side.D11, side.D12])
    R = D.T @ D
    m1 = side.B1.shape[1]
    R[:m1, :m1] -= level**2 * np.eye(m1)
    F = -np.linalg.solve(R, D.T @ side.C1 + B.T @ X)
    A = side.A + B @ F
    if not np.linalg.eigvals(A).real.max() < 0:
        return None
    return _Trajectories(side, 0.5 * (X + X.T), A, side.C1 + D @ F, solution.definite)


def _root(X: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(X)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def proved_level(P: Plant, control: Side, filter_: Side, gamma: float) -> float:
    """Return the largest level near ``gamma`` that a dual certificate proves for ``P``, or 0.

    ``gamma`` is the optimum that the Riccati equations of P claim.
    """
    best = 0.0
    for share in BELOW:
        certificate = dual_certificate(P, control, filter_, gamma * (1 - share))
        if certificate is not None:
            best = max(best, dual_bound(P, certificate))
        if best >= gamma * (1 - 10 * share):
            break
    return best


def frequency_level(plant: StateSpace, n_control: int, n_measurement: int) -> float:
    """Return the lower bound of γ for every controller from single frequencies, with rounding deducted.

    At each frequency, the left kernel of M12 and the right kernel of M21 leave a part of M11. No matrix Q
    makes σ̄(M11 + M12 Q M21) less than the norm of this part (Parrott 1978). A local search improves the
    largest values of a grid around the poles.
    """
    poles = plant.poles()
    rates = np.abs(np.log(poles[poles != 0]) / plant.dt) if plant.dt else np.abs(poles)
    rates = rates[np.isfinite(rates) & (rates > 0)]
    last = np.pi / plant.dt if plant.dt else np.inf
    if len(rates) == 0:
        return max(_level_at(plant, n_control, n_measurement, w) for w in (0.0, last))
    grid = np.geomspace(0.1 * rates.min(), min(10 * rates.max(), last), GRID)
    grid = np.unique(np.concatenate([[0.0], np.minimum(rates, last), grid, [last]]))
    levels = np.array([_level_at(plant, n_control, n_measurement, w) for w in grid])
    best = float(levels.max())
    for k in np.argsort(levels)[-PEAKS:]:
        if 0 < k < len(grid) - 1 and grid[k - 1] > 0 and np.isfinite(grid[k + 1]):
            peak = minimize_scalar(
                lambda x: -_level_at(plant, n_control, n_measurement, np.exp(x)),
                bounds=np.log(grid[[k - 1, k + 1]]),
                method="bounded",
                options={"xatol": 1e-10},
            )
            best = max(best, -float(peak.fun))
    return best


def _level_at(plant: StateSpace, n_control: int, n_measurement: int, omega: float) -> float:
    """Return the lower bound of γ for every controller at ``omega`` [rad/s], or 0 where rounding hides it."""
    M = plant.response([omega])[0]
    moved = response_rounding(plant, omega)
    p, m = len(M) - n_measurement, M.shape[1] - n_control
    if not (np.isfinite(M).all() and np.isfinite(moved).all()):
        return 0.0
    M11, rounding = M[:p, :m], float(np.linalg.norm(moved[:p, :m]))
    return max(
        _uncancelled(M11, M[:p, m:], rounding, float(np.linalg.norm(moved[:p, m:]))),
        _uncancelled(M11.conj().T, M[p:, :m].conj().T, rounding, float(np.linalg.norm(moved[p:, :m]))),
    )


def _uncancelled(known: np.ndarray, free: np.ndarray, rounding: float, moved: float) -> float:
    """Return σ̄ of the part of ``known`` that no Q cancels through ``free``, with rounding deducted."""
    scale = np.linalg.norm(free, axis=0)
    if free.shape[1] >= len(free) or not scale.all():
        return 0.0
    U, sigma, _ = np.linalg.svd(free / scale)
    rest = float(np.linalg.norm(U[:, free.shape[1] :].conj().T @ known, 2))
    turned = moved / float(scale.min()) / float(sigma[-1]) if sigma[-1] > 0 else np.inf
    return max(0.0, rest - rounding - min(turned, 1e300) * float(np.linalg.norm(known, 2)))
