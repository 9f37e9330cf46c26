"""H∞-optimal output feedback with a certificate, continuous and discrete, regular and singular problems.

Two coupled Riccati equations (Glover & Doyle 1988; Zhou, Doyle & Glover 1996, section 17.1: general D11)
decide whether a level γ can be reached. The search on γ starts from what single frequencies allow, most often
the optimum of a weighted problem, and else brackets it; the controller is the central one at a level a little
above it, and the norm reported for it is that of the true closed loop on the plant as given.

Singular problems (D12 or D21 without full rank, zeros on the imaginary axis) are solved, not refused. The
optimum comes from exact reduction. A control direction may have no direct cost; then the states that it
drives can be set at no cost, and they become the controls of a smaller problem (Stoorvogel 1992; in LMI form
Gahinet & Apkarian 1994, where the free block of R takes the place of the feedback). The smaller problem does
not contain the Parrott bound at the frequency where rank is lost; that bound is kept separately. The
controller comes from a regular plant: an extra cost ε on the free directions, an extra noise ε on the
unmeasured ones. A level reached for it is reached for the original plant too, since its cost is larger. ε is
the largest power of ten whose certified norm is close enough.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.linalg as sl
from scipy.optimize import minimize_scalar

from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.norms import NormBracket, axis_frequencies, hinf_norm
from lpvguard.engine.synthesis.statespace import (
    EPS,
    StateSpace,
    balancing,
    lft,
    scaled_states,
    to_continuous,
    to_discrete,
)

RANK_RTOL = 1e-9  # singular values of a column-scaled D12 (row-scaled D21) below this count as zero
AXIS_COST = (
    1e-7  # state cost, relative to ‖C1‖, that moves zeros off the imaginary axis in the optimum's search
)
MAX_WORK = 1000  # controllers tried times states: bounds the time of a problem whose optimum is out of reach
ZERO_RTOL = 1e-12  # a system matrix this near to losing rank, by parts of its entries, has a zero
STIFF = 1e4  # a Hamiltonian this much larger than the plant's A has lost digits to nearly free controls
LIMIT_RTOL = 1e-4  # rounding allowed for in the bound of a single frequency
CANCELLED = 1e-9  # share of G11 at a frequency below which what v leaves of it is rounding
GAMMA_RTOL = 1e-6  # width of the bracket of a regular problem's optimum


@dataclass(frozen=True)
class HinfResult:
    """A controller with its certificate.

    gamma: the optimum (infimum over stabilising controllers) by the Riccati equations. resolved: whether the
    controller comes within the back-off of it; else gamma is a claim, and what is known is gamma_lower ≤
    optimum ≤ gamma_achieved. gamma_lower: what single frequencies allow at best; gamma less the width of its
    bracket where resolved. gamma_achieved ≥ ‖F_l(P, K)‖∞: upper end of the bracket of the closed loop's norm
    on the plant as given; ``certificate`` is the whole bracket, its peak frequency in rad/s. regularisation:
    ε of the controller's design plant, 0 for a regular problem. notes: what was singular. basis (n, n): the
    state of the plant as given that the controller's state x_K stands for is basis x_K; controllers of
    neighbouring plants are neighbours in those coordinates.
    """

    controller: StateSpace
    gamma: float
    gamma_achieved: float
    certificate: NormBracket
    basis: np.ndarray
    gamma_lower: float
    resolved: bool = True
    regularisation: float = 0.0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Plant:
    """The generalised plant cut into its blocks; D22 is zero here."""

    A: np.ndarray
    B1: np.ndarray
    B2: np.ndarray
    C1: np.ndarray
    C2: np.ndarray
    D11: np.ndarray
    D12: np.ndarray
    D21: np.ndarray

    @property
    def dual(self) -> _Plant:
        return _Plant(
            self.A.T, self.C1.T, self.C2.T, self.B1.T, self.B2.T, self.D11.T, self.D21.T, self.D12.T
        )


class _Riccati(NamedTuple):
    """A stabilising solution, symmetric (n, n), and whether it is positive semidefinite within rounding."""

    X: np.ndarray
    definite: bool


@dataclass(frozen=True)
class _Side:
    """One Riccati equation: the problem x' = A x + B1 w + B2 u, z = C1 x + D11 w + D12 u with D12 of full
    column rank.

    basis (n, n_r): the states that remain after the free ones were removed; the solution is basis X_r basisᵀ.
    bound: the least γ that D11 and D12 allow (full information). axis: frequencies in rad/s of zeros on the
    imaginary axis; weight: the state cost (times I) that moves them off it.
    """

    A: np.ndarray
    B1: np.ndarray
    B2: np.ndarray
    C1: np.ndarray
    D11: np.ndarray
    D12: np.ndarray
    basis: np.ndarray
    bound: float = 0.0
    axis: tuple[float, ...] = ()
    weight: float = 0.0

    @staticmethod
    def regular(P: _Plant) -> _Side:
        """The control side of a plant whose D12 has full column rank: nothing to remove."""
        return _Side(
            P.A,
            P.B1,
            P.B2,
            P.C1,
            P.D11,
            P.D12,
            np.eye(len(P.A)),
            _unreachable_gain(P.D11, P.D12, np.zeros(P.B2.shape[1])),
        )

    def solve(self, gamma: float) -> _Riccati | None:
        """The stabilising solution at ``gamma``, original coordinates, (n, n); None when there is none."""
        if gamma <= self.bound * (1 + 1e-12):
            return None
        if len(self.A) == 0:
            return _Riccati(np.zeros((len(self.basis), len(self.basis))), True)
        try:
            found = _stabilising(_hamiltonian(self, gamma), self, gamma)
        except np.linalg.LinAlgError:
            return None
        return found and _Riccati(self.basis @ found.X @ self.basis.T, found.definite)

    @cached_property
    def _closed(self) -> StateSpace | None:
        """[G11 G12] from [w; v] to z with an LQ gain closed (u = F x + v); None where there is none."""
        F = _stabilising_gain(self.A, self.B2) if len(self.A) and self.B2.size and not self.axis else None
        if F is None:
            return None
        B, D = np.hstack([self.B1, self.B2]), np.hstack([self.D11, self.D12])
        return StateSpace(self.A + self.B2 @ F, B, self.C1 + self.D12 @ F, D)

    def frequency_bound(self, level: float | None = None) -> float:
        """A level that full information does not go below: max over frequencies of σ̄ of the part of G11(jω)
        that no v cancels through G12(jω).

        The frequencies: DC and those of the poles, or, with a ``level``, those where the bound may cross it
        (axis eigenvalues of the Hamiltonian) and the points between them. 0 where no gain closes the loop.
        """
        G = self._closed
        if G is None:
            return 0.0
        if level is None:
            omega = np.abs(np.concatenate([[0.0], np.linalg.eigvals(self.A), G.poles()]))
        else:
            try:
                H = _balance_hamiltonian(_hamiltonian(self, level))[0]
            except np.linalg.LinAlgError:  # the level is that of D11 itself
                return 0.0
            omega = axis_frequencies(H, np.linalg.norm(self.A, 2))
        response = G.response(np.unique(omega))
        response = response[np.isfinite(response).all(axis=(1, 2))]
        known, free = np.split(response, [self.B1.shape[1]], axis=2)
        size = np.linalg.norm(free, axis=1, keepdims=True)
        U, sigma, _ = np.linalg.svd(free / np.where(size > 0, size, 1), full_matrices=False)
        sure = sigma[:, -1] > 1e-5  # near a zero the range of G12 is rounding
        U, known = U[sure], known[sure]
        rest = known - U @ (U.conj().swapaxes(1, 2) @ known)
        size, whole = (np.linalg.norm(M, 2, axis=(1, 2)) for M in (rest, known))
        return float(size[size > CANCELLED * whole].max(initial=0.0))


def hinf_synthesis(
    plant: StateSpace,
    n_control: int,
    n_measurement: int,
    backoff: float = 0.008,
    rtol: float = GAMMA_RTOL,
    guess: float | None = None,
) -> HinfResult:
    """Controller u = K y with ‖F_l(P, K)‖∞ ≤ (1 + backoff) γ_opt, certified; u the last inputs, y the last
    outputs.

    Exists when (A, B2) is stabilisable and (A, C2) detectable; SynthesisError says which is not and what to
    change. Singular problems are regularised and the result says so. ``backoff`` keeps the controller's poles
    slow: at the optimum itself they run off to infinity. ``rtol``: width of the bracket of γ_opt; ``guess``:
    a level near it, which only saves time.
    """
    best, failure = None, None
    for coordinates in (_calm, _modal):
        try:
            result = _synthesis(plant, n_control, n_measurement, backoff, rtol, guess, coordinates)
        except (SynthesisError, np.linalg.LinAlgError) as exc:
            failure = failure or exc
            continue
        if best is None or result.gamma_achieved < best.gamma_achieved:
            best = result
        if best.resolved:
            return best
    if best is not None:
        return best
    if isinstance(failure, SynthesisError) and failure.source == "H-infinity synthesis":
        raise SynthesisError(failure.source, failure.where, failure.what, _expected(plant)) from failure
    raise failure


def _synthesis(plant, n_control, n_measurement, backoff, rtol, guess, coordinates) -> HinfResult:
    """``hinf_synthesis`` with the Riccati equations in one choice of ``coordinates``."""
    problem, D22, shift, basis = _posed(plant, n_control, n_measurement, coordinates)
    try:
        gamma = problem.optimum(rtol, guess)
    except SynthesisError:
        if not problem.singular:
            raise
        gamma = problem.floor
        problem.notes.append("the optimum could not be bracketed: gamma is a lower bound only")

    def restore(K: StateSpace) -> StateSpace:
        K = _absorb(K, D22)
        K = to_discrete(K, plant.dt) if plant.dt else K
        return StateSpace(
            K.A, K.B, K.C, K.D + shift, plant.dt, plant.outputs[-n_measurement:], plant.inputs[-n_control:]
        )

    return _certified(plant, problem, gamma, backoff, restore, basis)


def improved_level(
    plant: StateSpace, n_control: int, n_measurement: int, level: float | None, rtol: float
) -> float | None:
    """γ_opt to ``rtol`` when it lies below ``level``, else None: decided by one pair of Riccati equations.
    Without a ``level``: γ_opt.
    """
    problem = _posed(plant, n_control, n_measurement)[0]
    return problem.optimum(rtol, level) if level is None or problem.reached(level) else None


def _posed(
    plant, n_control, n_measurement, coordinates=None
) -> tuple[_Problem, np.ndarray, np.ndarray, np.ndarray]:
    """The continuous problem of any plant, its D22, the static feedback that was closed first, and the basis
    (n, n) in which the problem has the plant's state; checks existence. ``coordinates``: those of the state,
    ``_calm`` unless given.
    """
    _check_shape(plant, n_control, n_measurement)
    shift, shifted = _move_pole_at_minus_one(plant, n_control, n_measurement)
    basis = np.eye(plant.order)
    if plant.order:
        first = balancing(shifted)
        shifted = to_continuous(scaled_states(shifted, first))
        second = balancing(shifted)
        shifted, third = (coordinates or _calm)(scaled_states(shifted, second))
        basis = (first * second)[:, None] * third
    blocks, D22 = _blocks(shifted, n_control, n_measurement)
    _check_stabilisable(blocks, plant)
    return _Problem(blocks), D22, shift, basis


def _calm(G: StateSpace) -> tuple[StateSpace, np.ndarray]:
    """G in the coordinates of a balanced Schur form where those leave much less than G's own, G itself
    otherwise; and the basis of these coordinates.

    Scaling alone cannot undo a dense, badly conditioned change of coordinates: ‖A‖ then is far above its
    eigenvalues.
    """
    own = np.eye(G.order)
    if G.order < 2:
        return G, own
    schur = sl.schur(G.A)[1]
    other = G.transformed(schur)
    t = balancing(other)
    other = scaled_states(other, t)
    return (other, schur * t) if np.linalg.norm(other.A) < 0.1 * np.linalg.norm(G.A) else (G, own)


def _modal(G: StateSpace) -> tuple[StateSpace, np.ndarray]:
    """G with A in real blocks, one for each pole or pair: slow modes stand apart from fast ones; and the
    basis. G itself where the eigenvectors do not span the space.
    """
    values, vectors = np.linalg.eig(G.A)
    T = sl.cdf2rdf(values, vectors)[1] if np.iscomplexobj(values) else vectors
    if G.order < 2 or not np.linalg.cond(T) < 1e10:
        return G, np.eye(G.order)
    other = G.transformed(T)
    t = balancing(other)
    return scaled_states(other, t), T * t


def _certified(plant, problem, gamma, backoff, restore, basis) -> HinfResult:
    """The first controller whose certified norm is within ``backoff`` of ``gamma``; the best one when none
    is.
    """
    best = None

    budget = int(np.clip(MAX_WORK / max(plant.order, 1), 25, 100))

    def attempt(level, epsilon):
        nonlocal best, budget
        if budget <= 0:
            return
        budget -= 1
        try:
            central = problem.controller(level, epsilon)
            if central is None:
                return
            t = balancing(central) if central.order else np.ones(0)
            K = restore(scaled_states(central, t))
            norm = hinf_norm(lft(plant, K), rtol=1e-5)
        except (
            np.linalg.LinAlgError,
            SynthesisError,
        ):  # a controller that cannot be realised is no controller
            return
        if best is None or norm.upper < best.gamma_achieved:
            claim = min(gamma, norm.lower)
            best = HinfResult(
                K,
                claim,
                norm.upper,
                norm,
                basis * t,
                claim * (1 - GAMMA_RTOL),
                regularisation=epsilon,
                notes=tuple(problem.notes),
            )

    def good():
        return best is not None and best.gamma_achieved <= gamma * (1 + backoff)

    for epsilon, share in problem.attempts():
        if gamma > 0:
            attempt(gamma * (1 + share * backoff), epsilon)
        if good():
            return best
    _descend(problem, gamma, attempt, lambda: np.inf if best is None else best.gamma_achieved, good)
    if best is None or not np.isfinite(best.gamma_achieved):
        raise SynthesisError(
            "H-infinity synthesis",
            f"gamma {gamma:.6g}",
            "no controller passed its certificate",
            _expected(plant),
        )
    if good():
        return best
    lower = min(problem.certain, best.certificate.lower)
    note = (
        f"not resolved: the optimum lies between {lower:.4g} and {best.gamma_achieved:.4g}; the Riccati equations claim "
        f"{gamma:.4g}, and the best controller has poles up to {np.abs(best.controller.poles()).max(initial=0.0):.3g}"
    )
    return replace(
        best,
        gamma_lower=lower,
        resolved=False,
        notes=(*best.notes, note, *filter(None, [_frail_pole(plant)])),
    )


def _frail_pole(plant: StateSpace) -> str:
    """The pole of the plant as given that the last digits of A's entries leave uncertain, in a sentence;
    empty where there is none.

    First-order bound eps |y|ᵀ|A||x| / |yᴴx| on a pole's movement; it does not depend on the units of the
    states.
    """
    if plant.order == 0:
        return ""
    poles, left, right = sl.eig(plant.A, left=True, right=True)
    overlap = np.abs(np.sum(left.conj() * right, axis=0))
    moved = (
        EPS * np.sum(np.abs(left) * (np.abs(plant.A) @ np.abs(right)), axis=0) / np.maximum(overlap, 1e-300)
    )
    room = np.abs(1 - np.abs(poles)) if plant.dt else np.abs(poles.real)
    k = int(np.argmax(moved / np.maximum(room, 1e-300)))
    if moved[k] <= 1e-3 * room[k]:
        return ""
    return f"the last digits of A move its pole at {poles[k]:.4g} by up to {moved[k]:.1g}"


def _expected(plant: StateSpace) -> str:
    """What would help: balanced coordinates only where the plant's own are shown to be the trouble."""
    frail = _frail_pole(plant)
    return f"balanced or modal coordinates: {frail}" if frail else "an optimum that double precision can show"


def _descend(problem, gamma, attempt, reached, good) -> None:
    """Lower levels step by step while ε falls, from any level that can be reached at all."""
    level = max(gamma, 1e-6)
    while not np.isfinite(reached()) and level < 1e12:
        for epsilon in (1e-1, 1e-2, 1e-3, 1e-4, 1e-6) if problem.singular else (0.0,):
            attempt(level, epsilon)
        level *= 10
    start = reached()
    for epsilon in 10.0 ** -np.arange(1.0, 13.0) if problem.singular else (0.0,):
        for factor in (0.03, 0.3, 0.6, 0.9, 1.0):
            if good() or reached() <= 1e-7 * start:
                return
            if np.isfinite(reached()):
                attempt(max(factor * reached(), gamma * 1.005), epsilon)


def _check_shape(plant, n_control, n_measurement):
    for name, count, available, kind in (
        ("n_control", n_control, plant.n_inputs, "inputs"),
        ("n_measurement", n_measurement, plant.n_outputs, "outputs"),
    ):
        if not (isinstance(count, (int, np.integer)) and 1 <= count < available):
            raise SynthesisError(
                "generalised plant",
                name,
                f"{count}",
                f"a whole number from 1 to {available - 1}: the plant has {available} {kind}",
            )


def _move_pole_at_minus_one(plant, n_control, n_measurement) -> tuple[np.ndarray, StateSpace]:
    """A static feedback u = K0 y + ũ that clears z = −1 of poles, and the plant from ũ; zero where none is
    there.
    """
    shift = np.zeros((n_control, n_measurement))
    if not plant.dt or plant.order == 0 or np.abs(plant.poles() + 1).min() > 1e-6:
        return shift, plant
    B2, C2, D = plant.B[:, -n_control:], plant.C[-n_measurement:], plant.D
    rng = np.random.default_rng(0)
    size = 0.1 * (1 + np.linalg.norm(plant.A, 2)) / (EPS + np.linalg.norm(B2, 2) * np.linalg.norm(C2, 2))
    shift = size * rng.standard_normal(shift.shape)
    S = np.linalg.inv(np.eye(n_measurement) - D[-n_measurement:, -n_control:] @ shift)
    inject, rows = shift @ S, slice(-n_measurement, None)
    cols = slice(-n_control, None)
    A = plant.A + B2 @ inject @ C2
    B = plant.B + B2 @ inject @ D[rows]
    C = plant.C + D[:, cols] @ inject @ C2
    return shift, StateSpace(A, B, C, D + D[:, cols] @ inject @ D[rows], plant.dt)


def _blocks(plant, n_u, n_y) -> tuple[_Plant, np.ndarray]:
    w, u = slice(0, plant.n_inputs - n_u), slice(plant.n_inputs - n_u, None)
    z, y = slice(0, plant.n_outputs - n_y), slice(plant.n_outputs - n_y, None)
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    return _Plant(A, B[:, w], B[:, u], C[z], C[y], D[z, w], D[z, u], D[y, w]), D[y, u]


def _absorb(K: StateSpace, D22: np.ndarray) -> StateSpace:
    """K (I + D22 K)⁻¹: the controller for the plant with D22 from the one designed without it."""
    if not np.any(D22):
        return K
    S = np.linalg.inv(np.eye(D22.shape[0]) + D22 @ K.D)
    return StateSpace(K.A - K.B @ S @ D22 @ K.C, K.B @ S, K.C - K.D @ S @ D22 @ K.C, K.D @ S)


def _check_stabilisable(P: _Plant, plant: StateSpace) -> None:
    """Popov–Belevitch–Hautus test of (A, B2) and (C2, A) at every pole that is not strictly stable."""
    if P.A.size == 0:
        return
    scale = np.linalg.norm(P.A, 2) or 1.0
    for A, B, what, missing, change in (
        (P.A, P.B2, "(A, B2) is not stabilisable", "the control inputs do not reach", "an actuator for it"),
        (P.A.T, P.C2.T, "(C2, A) is not detectable", "the measurements do not show", "a sensor for it"),
    ):
        unit = scale * B / max(np.linalg.norm(B, 2), 1e-300)
        for pole in np.linalg.eigvals(A):
            if pole.real < -1e-12 * scale:
                continue
            sigma = np.linalg.svd(np.hstack([A - pole * np.eye(len(A)), unit]), compute_uv=False)[-1]
            if sigma < 1e-11 * scale:
                shown = _to_point(pole, plant)
                raise SynthesisError(
                    "generalised plant",
                    what,
                    f"{missing} the pole at {shown:.6g}",
                    f"{change}, or that mode left out of the plant (an integrating weight made a slow lag)",
                )


def _to_point(pole, plant):
    """A pole of the continuous image as a pole of ``plant`` (z-plane for a discrete one)."""
    return (2 / plant.dt + pole) / (2 / plant.dt - pole) if plant.dt else pole


def _hamiltonian(side: _Side, gamma: float) -> np.ndarray:
    """Hamiltonian of the Riccati equation (2n, 2n) at a γ above the Parrott bound of its D11."""
    n, m1 = side.A.shape[0], side.B1.shape[1]
    B = np.hstack([side.B1 / gamma, side.B2])
    D = np.hstack([side.D11 / gamma, side.D12])
    R = D.T @ D
    R[:m1, :m1] -= np.eye(m1)
    F = np.linalg.solve(R, np.hstack([D.T @ side.C1, B.T]))
    H = np.block([[side.A, np.zeros((n, n))], [-side.C1.T @ side.C1, -side.A.T]])
    left = np.vstack([B, -side.C1.T @ D])
    out = H - left @ F
    # what is left where terms cancel is rounding; balancing would blow it up
    terms = np.abs(H) + np.abs(left) @ np.abs(F)
    out[np.abs(out) <= 500 * EPS * terms] = 0.0
    out[n:, :n] -= side.weight**2 * np.eye(n)
    return out


def _balance_hamiltonian(H: np.ndarray, floor: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Symplectic diagonal scaling diag(t, 1/t) by powers of two (as in Benner 2001); returns the scaled H and
    t.

    Entries up to ``floor`` times the largest one have no say in the choice of t.
    """
    n = H.shape[0] // 2
    off = np.abs(H)
    np.fill_diagonal(off, 0)
    off[off <= floor * off.max(initial=0.0)] = 0.0
    with np.errstate(invalid="ignore"):  # scipy reads the scales as row numbers too, which large ones are not
        _, (scale, _) = sl.matrix_balance(off, separate=True, permute=False)
    logs = np.log2(scale)
    t = 2.0 ** np.round(0.5 * (logs[:n] - logs[n:]))
    both = np.concatenate([t, 1 / t])
    return H * both / both[:, None], t


def _stabilising(H: np.ndarray, side: _Side | None = None, gamma: float = np.inf) -> _Riccati | None:
    """X = X2 X1⁻¹ from the stable invariant subspace of H, symmetric; None when eigenvalues lie on the axis.

    The balancing that takes every entry seriously is tried first; where rounding stands in place of zeros (X
    exactly singular) it makes X1 nearly singular, and a balancing that ignores such entries is used. Where H
    is much larger than the A of its ``side`` (nearly free controls) the answer is trusted only when it is
    well conditioned; else the extended pencil decides, which never forms the inverse that made H large.
    """
    best = None
    for floor in (0.0, EPS):
        balanced_H, t = _balance_hamiltonian(H, floor)
        found, condition = _subspace_solution(balanced_H, t)
        if found is not None and (best is None or condition < best[1]):
            best = found, condition
        if (best is not None and best[1] < 1e10) or (found is None and condition == 0.0):
            break
    if (
        side is not None
        and (best is None or best[1] > 1e6)
        and (np.linalg.norm(balanced_H) > STIFF * np.linalg.norm(side.A * t / t[:, None]))
    ):
        for scale in (t, np.ones_like(t)):
            found, condition = _pencil_solution(side, gamma, scale)
            if found is not None and (best is None or condition < best[1]):
                best = found, condition
    return best and best[0]


def _subspace_solution(H: np.ndarray, t: np.ndarray) -> tuple[_Riccati | None, float]:
    """The solution from one balanced H, and the condition of its X1 (0 when the axis is in the way)."""
    n = H.shape[0] // 2
    T, U, stable = sl.schur(H, sort="lhp", check_finite=False)
    if stable != n or _touches_axis(T):
        return None, 0.0
    speed = np.abs(np.diag(T)).min()  # of the slowest real part
    return _from_basis(U[:n, :n], U[n:, :n], t, noise=1e2 * EPS * np.linalg.norm(T) / max(speed, EPS))


def _pencil_solution(side: _Side, gamma: float, t: np.ndarray) -> tuple[_Riccati | None, float]:
    """The same solution from the extended pencil in (x, λ, [w; u], z), where γ and D enter unsquared (Van
    Dooren 1981).

    The algebraic variables are eliminated by an orthogonal transformation; ``t`` scales x and 1/t scales λ.
    """
    n, m1, m = side.A.shape[0], side.B1.shape[1], side.B1.shape[1] + side.B2.shape[1]
    p = side.C1.shape[0]
    A, C = side.A * t / t[:, None], side.C1 * t
    B, D = np.hstack([side.B1 / gamma, side.B2]) / t[:, None], np.hstack([side.D11 / gamma, side.D12])
    J = np.diag(np.r_[np.ones(m1), np.zeros(m - m1)])
    Z = np.zeros
    M = np.block(
        [
            [A, Z((n, n)), B, Z((n, p))],
            [-np.diag((side.weight * t) ** 2), -A.T, Z((n, m)), -C.T],
            [C, Z((p, n)), D, -np.eye(p)],
            [Z((m, n)), B.T, -J, D.T],
        ]
    )
    Q = sl.qr(M[:, 2 * n :], mode="full")[0][:, m + p :].T
    try:
        S, _, alpha, beta, _, V = sl.ordqz(
            Q @ M[:, : 2 * n], Q[:, : 2 * n], sort="lhp", output="real", check_finite=False
        )
    except ValueError:  # eigenvalues of both sides too close to be told apart
        return None, 0.0
    stable = np.count_nonzero(alpha.real * beta < 0)
    if stable != n or np.any(np.abs(alpha.real) <= 20 * EPS * np.linalg.norm(S) + 1e-11 * np.abs(alpha.imag)):
        return None, 0.0
    speed = np.abs(alpha.real / np.where(beta == 0, EPS, beta)).min()
    return _from_basis(V[:n, :n], V[n:, :n], t, noise=1e2 * EPS * np.linalg.norm(S) / speed)


def _from_basis(
    U1: np.ndarray, U2: np.ndarray, t: np.ndarray, noise: float = 0.0
) -> tuple[_Riccati | None, float]:
    """X = U2 U1⁻¹ in the units before ``t``, from an orthonormal basis [U1; U2] of the stable subspace.

    ``noise``: error of the basis where it is larger than rounding.
    """
    condition = np.linalg.cond(U1)
    skew = U1.T @ U2
    if np.abs(skew - skew.T).max() > 1e-5 or not condition < 1 / EPS:
        return None, condition
    X = np.linalg.solve(U1.T, U2.T)
    X = 0.5 * (X + X.T)
    # in these units U is orthogonal, so X carries an error of about eps · cond(U1) · (1 + ‖X‖)
    values = np.linalg.eigvalsh(X)
    tolerance = min(max(1e4 * EPS, min(noise, 1e-9)) * condition, 0.1)
    definite = values[0] >= -tolerance * (1 + values[-1])
    return _Riccati(X / t / t[:, None], bool(definite)), condition


def _touches_axis(T: np.ndarray) -> bool:
    """Whether an eigenvalue of the real Schur form T is, within rounding, on the imaginary axis."""
    diagonal, sub = np.diag(T), np.diag(T, -1)
    size = np.abs(diagonal)
    imaginary = np.zeros_like(size)
    pairs = np.flatnonzero(sub)
    width = np.sqrt(np.abs(sub[pairs] * T[pairs, pairs + 1]))
    imaginary[pairs] = imaginary[pairs + 1] = width
    return bool(np.any(size <= 20 * EPS * np.linalg.norm(T) + 1e-11 * imaginary))


def _direct_scale(rate: float, B2, C1) -> np.ndarray:
    """Size that each control's direct cost would have if it acted like the path through states of ``rate``,
    (m2,).
    """
    return np.linalg.norm(B2, axis=0) * np.linalg.norm(C1) / max(rate, 1e-300)


def _column_rank(D: np.ndarray, scale: np.ndarray) -> tuple[int, np.ndarray]:
    """Rank of D and V (m, m) so that D V = [full rank, 0].

    Columns are brought to unit length first (a control's unit is arbitrary); one far below ``scale`` counts
    as zero.
    """
    size = np.linalg.norm(D, axis=0)
    live = (size > RANK_RTOL * scale) & (size > 0)
    weight = np.where(live, 1 / np.where(live, size, 1), 1.0)
    _, sigma, Vt = np.linalg.svd(D * np.where(live, weight, 0.0))
    rank = int(np.count_nonzero(sigma > RANK_RTOL * sigma.max(initial=0.0))) if np.any(live) else 0
    return rank, weight[:, None] * Vt.T


def _reduce(P: _Plant) -> _Side:
    """The Riccati problem that decides the control side of P, free directions removed until D12 has full
    rank.
    """
    A, B1, B2, C1, D12 = P.A, P.B1, P.B2, P.C1, P.D12
    rate = np.linalg.norm(A, 2)
    basis = np.eye(A.shape[0])
    while B2.shape[1]:
        rank, V = _column_rank(D12, _direct_scale(rate, B2, C1))
        if rank == B2.shape[1]:
            break
        paid, free = B2 @ V[:, :rank], B2 @ V[:, rank:]
        cost = D12 @ V[:, :rank]
        if free.size == 0:
            B2, D12 = paid, cost
            break
        size = np.linalg.norm(free, axis=0)
        free = free / np.where(size > 0, size, 1)
        U, sigma, _ = np.linalg.svd(free)
        U[np.abs(U) < 4 * EPS] = 0.0
        r = int(np.count_nonzero(sigma > RANK_RTOL))
        if r == 0:
            B2, D12 = paid, cost
            break
        driven, rest = U[:, :r], U[:, r:]
        A, B1, B2, C1, D12, basis = (
            rest.T @ A @ rest,
            rest.T @ B1,
            np.hstack([rest.T @ paid, rest.T @ A @ driven]),
            C1 @ rest,
            np.hstack([cost, C1 @ driven]),
            basis @ rest,
        )
    bound = _unreachable_gain(P.D11, D12, _direct_scale(rate, B2, C1))
    if A.size == 0:
        return _Side(A, B1, B2, C1, P.D11, D12, basis, bound)
    side = _Side(A, B1, B2, C1, P.D11, D12, basis, bound)
    axis = _axis_zeros(side, rate)
    return replace(side, axis=axis, weight=AXIS_COST * max(np.linalg.norm(P.C1, 2), EPS)) if axis else side


def _axis_zeros(side: _Side, scale: float) -> tuple[float, ...]:
    """Frequencies of the imaginary-axis zeros of x' = A x + B2 u, z = C1 x + D12 u.

    Candidates are the axis eigenvalues of its LQ problem. Those are at least double, so rounding moves them
    by the square root of eps times the norm (``scale``: that of A), and a slow zero looks like one on the
    axis: only where the system matrix itself loses rank is there a zero.
    """
    H = _hamiltonian(replace(side, B1=side.B1[:, :0], D11=side.D11[:, :0]), 1.0)
    eigenvalues = np.linalg.eigvals(_balance_hamiltonian(H)[0])
    near = np.abs(eigenvalues.real) <= 1e-7 * np.abs(eigenvalues) + 1e-8 * scale
    found = []
    for omega in np.abs(eigenvalues.imag[near]):
        if any(abs(omega - known) <= 1e-6 * omega + 1e-7 * scale for known in found):
            continue
        width = 1e-6 * omega + 1e-7 * scale
        points = [0.0] if omega <= width else []
        points.append(
            minimize_scalar(
                lambda w: _rank_defect(side, w),
                bounds=(max(omega - width, 0.0), omega + width),
                method="bounded",
                options={"xatol": 1e-15 * (omega + width)},
            ).x
        )
        best = min(points, key=lambda w: _rank_defect(side, w))
        if _rank_defect(side, best) <= ZERO_RTOL:
            found.append(best)
    return tuple(np.unique(np.round(found, 12)))


def _rank_defect(side: _Side, omega: float) -> float:
    """Distance of the system matrix [A − jωI, B2; C1, D12] from loss of column rank, as a part of its
    entries: its smallest singular value after rows and columns are brought to unit size (0: jω is a zero).
    """
    M = np.block([[side.A - 1j * omega * np.eye(len(side.A)), side.B2], [side.C1, side.D12]])
    if M.shape[0] < M.shape[1]:
        return 0.0
    for _ in range(8):
        for axis in (1, 0):
            size = np.sqrt(np.abs(M).max(axis=axis, keepdims=True))
            M = M / np.where(size > 0, size, 1)
    return float(np.linalg.svd(M, compute_uv=False)[-1])


def _unreachable_gain(D11, D12, scale) -> float:
    """σ̄ of the part of D11 that no u can cancel through D12, for any rank of D12."""
    rank, V = _column_rank(D12, scale)
    Q = sl.qr(D12 @ V[:, :rank], mode="full")[0] if rank else np.eye(D11.shape[0])
    rest = Q[:, rank:].T @ D11
    return float(np.linalg.norm(rest, 2)) if rest.size else 0.0


def _parrott(P: _Plant) -> float:
    """min over D_K of σ̄(D11 + D12 D_K D21) (Parrott 1978), for any rank of D12 and D21."""
    return max(
        _unreachable_gain(Q.D11, Q.D12, _direct_scale(np.linalg.norm(Q.A, 2), Q.B2, Q.C1))
        for Q in (P, P.dual)
    )


def _axis_bounds(P: _Plant, frequencies) -> list[float]:
    """Parrott bounds at the imaginary-axis zeros: there the loop cannot change part of T11 + T12 Q T21.

    T11, T12, T21 are the stable factors of all closed loops (Zhou, Doyle & Glover 1996, section 12.8), with
    an LQ gain F and its dual L.
    """
    if not frequencies:
        return []
    n = len(P.A)
    F, L = _stabilising_gain(P.A, P.B2), _stabilising_gain(P.A.T, P.C2.T)
    if F is None or L is None:
        return []
    L = L.T
    AF, AL, CF, BL = P.A + P.B2 @ F, P.A + L @ P.C2, P.C1 + P.D12 @ F, P.B1 + L @ P.D21
    T11 = StateSpace(
        np.block([[AF, -P.B2 @ F], [np.zeros((n, n)), AL]]),
        np.vstack([P.B1, BL]),
        np.hstack([CF, -P.D12 @ F]),
        P.D11,
    )
    T12, T21 = StateSpace(AF, P.B2, CF, P.D12), StateSpace(AL, BL, P.C2, P.D21)
    out = []
    for G11, G12, G21 in zip(*(T.response(frequencies) for T in (T11, T12, T21)), strict=True):
        for side, free in ((G11, G12), (G11.conj().T, G21.conj().T)):
            U, sigma, _ = np.linalg.svd(free / np.maximum(np.linalg.norm(free, axis=0), 1e-300))
            rank = int(np.count_nonzero(sigma > 1e-5))
            rest = U[:, rank:].conj().T @ side
            out.append(float(np.linalg.norm(rest, 2)) if rest.size else 0.0)
    return out


def _stabilising_gain(A: np.ndarray, B: np.ndarray) -> np.ndarray | None:
    """LQ gain F (m, n) with A + B F stable, unit weights in balanced units; None where there is none, so for
    B = 0."""
    width = np.linalg.norm(B, 2)
    if width == 0:
        return None
    size, n = np.linalg.norm(A, 2) / width, len(A)
    scaled = size * B
    X = _stabilising(np.block([[A, -scaled @ scaled.T], [-np.eye(n), -A.T]]))
    return None if X is None else -size * scaled.T @ X.X


def _above_one(value: float | None) -> bool:
    return value is not None and value > 1


class _Problem:
    """One continuous plant: the search for its optimum and the central controllers."""

    def __init__(self, P: _Plant):
        self.P = P
        self.control, self.filter = _reduce(P), _reduce(P.dual)
        n = P.A.shape[0]
        self.notes: list[str] = []
        self.rank_lost = False
        for side, Q, name, signal in (
            (self.control, P, "D12", "controls without direct cost"),
            (self.filter, P.dual, "D21", "measurements without noise"),
        ):
            wanted = Q.D12.shape[1]
            rank, _ = _column_rank(Q.D12, _direct_scale(np.linalg.norm(Q.A, 2), Q.B2, Q.C1))
            if rank < wanted:
                self.rank_lost = True
                self.notes.append(
                    f"{name} has rank {rank} of {wanted} ({signal}): {n - side.A.shape[0]} states freed"
                )
            if side.axis:
                where = "P12" if name == "D12" else "P21"
                shown = ", ".join(f"{w:.4g}" for w in side.axis)
                self.notes.append(f"{where} has zeros on the imaginary axis at {shown} rad/s")
        self.axis = tuple(sorted(set(self.control.axis + self.filter.axis)))
        self.floor = max([_parrott(P)] + _axis_bounds(P, self.axis))
        self.soft = [False, False]
        if self.singular:
            probe = self._extended(1e-2)
            scale = np.linalg.norm(P.A, 2)
            self.soft = [bool(_axis_zeros(_Side.regular(Q), scale)) for Q in (probe, probe.dual)]

    @property
    def singular(self) -> bool:
        return self.rank_lost or bool(self.axis)

    @property
    def certain(self) -> float:
        """A level that no controller goes below, whatever the Riccati equations say: single frequencies,
        direct terms."""
        return max(self.floor, self.control.frequency_bound(), self.filter.frequency_bound())

    def coupling(self, gamma: float) -> float | None:
        """γ²/ρ(XY), above 1 exactly when γ is reached; negative past a blow-up of X or Y; None without
        solution.
        """
        X = self.control.solve(gamma)
        Y = self.filter.solve(gamma) if X is not None else None
        return None if Y is None else _margin(X, Y, gamma)

    def reached(self, gamma: float) -> bool:
        """Whether some stabilising controller reaches ``gamma``."""
        return gamma > self.floor and _above_one(self.coupling(gamma))

    def optimum(self, rtol: float, guess: float | None = None) -> float:
        """The infimum of reachable γ, to ``rtol``: what single frequencies allow where that is reached, else
        a bracket from above it or around ``guess``, then secant steps.

        From above, because far below the optimum the Riccati equations are rounding and may seem to be
        solved.
        """
        limit, value = self._frequency_limit(rtol)
        floor, floor_value, start = limit, value, max(2 * limit, 1.0)
        if _above_one(value):
            if not self.reached(limit * (1 - LIMIT_RTOL)):
                return limit
            floor, floor_value, start = self.floor, None, limit
        scale, growth = max(self.floor, 1e-3), 10.0
        if guess:
            start, growth = max(guess, limit * (1 + rtol)), 1 + 20 * rtol
        if start > limit:
            value = self.coupling(start)
        if _above_one(value):
            high, high_value, low, low_value = start, value, floor, floor_value
            while low < high / growth:
                trial = high / growth
                value = self.coupling(trial)
                if not _above_one(value):
                    low, low_value = trial, value
                    break
                high, high_value, growth = trial, value, growth**2 if guess else growth
                if high < 1e-12 * scale:
                    return floor
            if low == 0.0:
                return 0.0
        else:
            low, low_value, high, high_value = start, value, start, None
            while high_value is None:
                high, growth = high * growth, growth**2 if guess else growth
                value = self.coupling(high)
                if _above_one(value):
                    high_value = value
                else:
                    low, low_value = high, value
                if high > 1e14 * scale:
                    raise SynthesisError(
                        "H-infinity synthesis",
                        "gamma",
                        f"no level up to {high:.1g} can be reached",
                        "an optimum that double precision can show",
                    )
        return self._narrow(rtol, low, low_value, high, high_value)

    def _frequency_limit(self, rtol: float) -> tuple[float, float | None]:
        """A level ``rtol`` above the largest bound of a single frequency, and the ``coupling`` there.

        While a Riccati equation has no solution, the axis eigenvalues of its Hamiltonian show frequencies of
        a larger bound, if one exists (as in Bruinsma & Steinbuch 1990).
        """
        sides = self.control, self.filter
        bound, level, value = max(side.frequency_bound() for side in sides), self.floor, None
        if self.axis or bound * (1 - LIMIT_RTOL) <= level:  # near the floor rounding hides what is reached
            return level, None
        for _ in range(20):
            if bound <= level:
                break
            level = bound * (1 + min(rtol, GAMMA_RTOL))  # the finer one costs no more
            value = self.coupling(level)
            if value is not None:
                break
            bound = max(side.frequency_bound(level) for side in sides)
        return level, value

    def _narrow(self, rtol, low, low_value, high, high_value) -> float:
        """Secant steps on γ²/ρ − 1 in log γ, guarded by bisection, until high/low ≤ 1 + rtol."""
        stalled = 0
        for step in range(80):
            if high <= low * (1 + rtol):
                break
            a, b = np.log(low), np.log(high)
            width = b - a
            middle = a + 0.5 * width
            if (
                low_value is not None
                and np.isfinite(high_value)
                and abs(low_value) < 1e3
                and stalled < 2
                and step % 4 != 3
            ):
                t = (1 - low_value) / (high_value - low_value)
                # aim a little past the root, so that the next step has it from the other side
                past = 0.3 * rtol + (0.02 * width * (0.5 - t) if stalled else 0.0)
                middle = np.clip(
                    a + t * width + (past if t < 0.5 else -past), a + 1e-4 * width, b - 1e-4 * width
                )
            gamma = float(np.exp(middle))
            value = self.coupling(gamma)
            if _above_one(value):
                high, high_value = gamma, value
            else:
                low, low_value = gamma, value
            stalled = stalled + 1 if np.log(high / low) > 0.5 * width else 0
        return high

    def attempts(self):
        """(ε, share of the back-off) in the order to try; mild controllers first."""
        if not self.singular:
            yield from ((0.0, share) for share in (0.97, 0.5, 0.25))
        for exponent in range(1, 15):
            yield 10.0**-exponent, 0.9

    def controller(self, gamma: float, epsilon: float) -> StateSpace | None:
        """Central controller at ``gamma`` of the plant with extra cost and noise ε; None when it is not
        reached.
        """
        P = self.P if epsilon == 0 else self._extended(epsilon)
        return central_controller(P, gamma)

    def _extended(self, epsilon: float) -> _Plant:
        P = self.P
        cost_u, cost_x = _extension(P, self.soft[0], epsilon)
        noise_y, noise_x = _extension(P.dual, self.soft[1], epsilon)
        C1 = np.vstack([P.C1, np.zeros((cost_u.shape[0], P.A.shape[0])), cost_x])
        D12 = np.vstack([P.D12, cost_u, np.zeros((cost_x.shape[0], P.D12.shape[1]))])
        B1 = np.hstack([P.B1, np.zeros((P.A.shape[0], noise_y.shape[0])), noise_x.T])
        D21 = np.hstack([P.D21, noise_y.T, np.zeros((P.D21.shape[0], noise_x.shape[0]))])
        D11 = np.zeros((C1.shape[0], B1.shape[1]))
        D11[: P.D11.shape[0], : P.D11.shape[1]] = P.D11
        return _Plant(P.A, B1, P.B2, C1, P.C2, D11, D12, D21)


def _extension(P: _Plant, axis: bool, epsilon: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows ε·u and, when ``axis``, ε·x, in units of the plant's own costs."""
    size = max(np.linalg.norm(P.C1, 2), EPS)
    reach = np.linalg.norm(P.B2, axis=0)
    unit = np.where(reach > 0, reach / max(reach.max(), 1e-300), 1.0)
    return epsilon * size * np.diag(unit), epsilon * size * np.eye(P.A.shape[0]) if axis else np.zeros(
        (0, len(P.A))
    )


def _margin(control: _Riccati, filter_: _Riccati, gamma: float) -> float:
    """γ²/ρ(XY); −1 when X or Y is not positive semidefinite: then γ lies below one of them blowing up."""
    if not (control.definite and filter_.definite):
        return -1.0
    if control.X.size == 0:
        return np.inf
    largest = np.linalg.eigvals(control.X @ filter_.X).real.max()
    return np.inf if largest <= 0 else gamma**2 / largest


def central_controller(P: _Plant, gamma: float) -> StateSpace | None:
    """Central controller at level γ of a regular plant (Zhou, Doyle & Glover 1996, theorem 17.1); None below
    γ_opt.
    """
    n, m1, p1 = P.A.shape[0], P.B1.shape[1], P.C1.shape[0]
    control, filter_ = _Side.regular(P), _Side.regular(P.dual)
    X, Y = control.solve(gamma), filter_.solve(gamma)
    if X is None or Y is None or not _margin(X, Y, gamma) > 1:
        return None
    X, Y = X.X, Y.X
    # w divided by γ makes the level 1; Y of that plant is Y/γ²
    Y = Y / gamma**2
    B1, D11, D21 = P.B1 / gamma, P.D11 / gamma, P.D21 / gamma
    Dc, Dr = np.hstack([D11, P.D12]), np.vstack([D11, D21])
    R = Dc.T @ Dc - np.diag(np.r_[np.ones(m1), np.zeros(P.B2.shape[1])])
    Rt = Dr @ Dr.T - np.diag(np.r_[np.ones(p1), np.zeros(P.C2.shape[0])])
    F = -np.linalg.solve(R, Dc.T @ P.C1 + np.hstack([B1, P.B2]).T @ X)
    L = -np.linalg.solve(Rt, Dr @ B1.T + np.vstack([P.C1, P.C2]) @ Y).T
    inner, outer = P.C2 + D21 @ F[:m1], P.B2 + L[:, :p1] @ P.D12
    Dk = _central_feedthrough(D11, P.D12, D21)
    Bk = np.linalg.solve(np.eye(n) - Y @ X, -L[:, p1:] + outer @ Dk)
    Ck = F[m1:] - Dk @ inner
    Ak = P.A + B1 @ F[:m1] + P.B2 @ F[m1:] - Bk @ inner
    return StateSpace(Ak, Bk, Ck, Dk)


def _central_feedthrough(D11: np.ndarray, D12: np.ndarray, D21: np.ndarray) -> np.ndarray:
    """The D_K with σ̄(D11 + D12 D_K D21) < 1 that the central controller has; zero when D11 is."""
    if not np.any(D11):
        return np.zeros((D12.shape[1], D21.shape[0]))
    m2, p2 = D12.shape[1], D21.shape[0]
    Qz, Ru = sl.qr(D12, mode="full")
    Qw, Ry = sl.qr(D21.T, mode="full")
    inside = Qz.T @ D11 @ Qw
    D1122, D1121, D1112, D1111 = inside[:m2, :p2], inside[:m2, p2:], inside[m2:, :p2], inside[m2:, p2:]
    Dk = -D1121 @ D1111.T @ np.linalg.solve(np.eye(len(D1111)) - D1111 @ D1111.T, D1112) - D1122
    return np.linalg.solve(Ru[:m2], np.linalg.solve(Ry[:p2], Dk.T).T)
