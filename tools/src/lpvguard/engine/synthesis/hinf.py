"""H∞-optimal output feedback with a certificate, for continuous and discrete, regular and singular problems.

Two coupled Riccati equations (Glover & Doyle 1988; Zhou, Doyle & Glover 1996, section 17.1: general D11)
decide whether a level γ can be reached (``gamma_search``, ``riccati``). The controller is the central one at
a level a little above the optimum (``central``). The reported norm is that of the closed loop with the
original plant.

In a singular problem D12 or D21 lacks full rank, or P12 or P21 has zeros on the imaginary axis. Such problems
are solved as well (``singular``, ``zeros``). Exact reduction gives the optimum. A regular plant with an extra
cost and an extra noise ε gives the controller. ε is the largest power of ten whose certified norm is close
enough.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from lpvguard.engine.synthesis.coordinates import (
    frail_pole,
    modal_coordinates,
    schur_coordinates,
    transformed,
)
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.gamma_search import GAMMA_RTOL, GammaProblem
from lpvguard.engine.synthesis.hinf_lower import ALLOWANCE, frequency_level, proved_level
from lpvguard.engine.synthesis.norms import NormBracket, hinf_norm
from lpvguard.engine.synthesis.partition import (
    Plant,
    absorb_feedthrough,
    check_existence,
    check_shape,
    move_pole_at_minus_one,
    partition,
)
from lpvguard.engine.synthesis.statespace import (
    StateSpace,
    balancing,
    lft,
    scaled_states,
    to_continuous,
    to_discrete,
)

MAX_WORK = 1000
"""Bound of the number of trial controllers times the number of states. It limits the time of a problem whose
optimum is out of reach."""
PERTURBED, DEDUCTED = 3, 3.0
"""Number of trial changes of the data. A dual bound is reduced by ``DEDUCTED`` times the largest change of
the optimum that they cause."""
DATA_RTOL, MAPPED_RTOL = 1e-14, 1e-11
"""Relative change of the data in a trial: some tens of rounding units, and more in discrete time, where the
bilinear map rounds the data."""
NORM_RTOL, WIDEST = 1e-5, 0.1
"""Relative width of a norm bracket without rounding, and the largest width at which other coordinates are
tried."""
LEVEL_RTOL, MOVED_RTOL, CLAIM_RTOL = 1e-4, 1e-5, 1e-7
"""Relative accuracy of an optimum: below a given level, for changed data, and as a cap of a dual bound."""

Coordinates = Callable[[StateSpace], tuple[StateSpace, np.ndarray]]
"""Function that returns a system in other coordinates of its state, and the basis (n, n)."""


@dataclass(frozen=True)
class HinfResult:
    """A controller with its certificate.

    ``gamma`` is the optimum (infimum over stabilising controllers) by the Riccati equations. It is not
    proved; ``proved_lower_bound`` proves a level below it. ``resolved`` says whether the controller is within
    the back-off of the optimum. ``gamma_achieved`` ≥ ‖F_l(P, K)‖∞ is the proved upper bound of the closed
    loop's norm. ``certificate`` is the whole bracket, with the peak frequency in rad/s. ``regularisation`` is
    ε of the controller's design plant, 0 for a regular problem. ``notes`` describe singularities. ``basis``
    (n, n) maps the controller's state x_K to the coordinates of the plant's state, as basis x_K. In these
    coordinates, neighbouring plants have neighbouring controllers.
    """

    controller: StateSpace
    gamma: float
    gamma_achieved: float
    certificate: NormBracket
    basis: np.ndarray
    resolved: bool = True
    regularisation: float = 0.0
    notes: tuple[str, ...] = ()


def hinf_synthesis(
    plant: StateSpace,
    n_control: int,
    n_measurement: int,
    backoff: float = 0.008,
    rtol: float = GAMMA_RTOL,
    guess: float | None = None,
    level: float | None = None,
    thorough: bool = False,
) -> HinfResult:
    """Synthesise a controller u = K y with ‖F_l(P, K)‖∞ ≤ (1 + backoff) γ_opt, certified.

    It exists when (A, B2) is stabilisable and (A, C2) detectable. Singular problems are regularised, and a
    note in the result says so.

    Parameters
    ----------
    plant : StateSpace, its last inputs are u and its last outputs are y
    n_control, n_measurement : int, sizes of u and y
    backoff : float, relative distance from the optimum, where the controller's poles diverge, default 0.008
    rtol : float, width of the bracket of γ_opt
    guess : float, optional, level near γ_opt, which saves time
    level : float, optional, level above γ_opt for the controller, instead of backoff and bracket
    thorough : bool, try all coordinates of the state even if the first resolves the problem, default False

    Returns
    -------
    HinfResult

    Raises
    ------
    SynthesisError
        If no controller exists. The error names the failing condition and the remedy.

    References
    ----------
    THEORY 6; Zhou, Doyle & Glover 1996.
    """
    best: HinfResult | None = None
    failures: list[SynthesisError | np.linalg.LinAlgError] = []
    for coordinates in (schur_coordinates, modal_coordinates):
        try:
            posed = _posed(plant, n_control, n_measurement, coordinates)
            if level is not None:
                guess = posed.problem.optimum(LEVEL_RTOL)
                backoff = max(level / guess - 1, LEVEL_RTOL)
            result = _synthesis(posed, backoff, rtol, guess)
        except (SynthesisError, np.linalg.LinAlgError) as exc:
            failures.append(exc)
            continue
        if best is None or result.gamma_achieved < best.gamma_achieved:
            best = result
        if best.resolved and not thorough:
            return best
    if best is not None:
        return best
    first = failures[0]
    if isinstance(first, SynthesisError) and first.source == "H-infinity synthesis":
        raise SynthesisError(first.source, first.where, first.what, _expected(plant)) from first
    raise first


def improved_level(
    plant: StateSpace, n_control: int, n_measurement: int, level: float, rtol: float, least: float = 0.0
) -> float | None:
    """γ_opt to ``rtol`` where it lies below ``level``, else None. One pair of Riccati equations decides this.

    Where γ_opt lies below ``least``, ``least`` is returned."""
    problem = _posed(plant, n_control, n_measurement, schur_coordinates).problem
    if least > 0 and problem.reached(least):
        return least
    return problem.optimum(rtol, level) if problem.reached(level) else None


def optimal_level(plant: StateSpace, n_control: int, n_measurement: int, rtol: float) -> float:
    """γ_opt to the relative accuracy ``rtol``. Raises SynthesisError where no level can be reached."""
    return _posed(plant, n_control, n_measurement, schur_coordinates).problem.optimum(rtol)


@dataclass(frozen=True)
class LowerBound:
    """A proved lower bound of the optimum.

    Attributes
    ----------
    value : float, lower bound of γ for every controller
    moved : float
        Largest relative change of the optimum when the data change by ``DATA_RTOL`` and the balanced plant by
        ``ALLOWANCE``. It is 0 where single frequencies decide.
    size : float, largest gain from w to z at zero and at the frequencies of the poles
    """

    value: float
    moved: float
    size: float


def proved_lower_bound(plant: StateSpace, n_control: int, n_measurement: int, gamma: float) -> LowerBound:
    """Prove a lower bound of the H∞ optimum on the given numbers of the plant.

    Parameters
    ----------
    plant : StateSpace
    n_control, n_measurement : int, as in `hinf_synthesis`
    gamma : float, the optimum that the Riccati equations claim

    Returns
    -------
    LowerBound

    Notes
    -----
    The bound at single frequencies always holds. A dual certificate holds for the plant in other coordinates,
    which exact products compute. Its bound is reduced by the effect of rounding errors on the optimum, which
    trial changes of the data estimate.
    """
    value, size = frequency_level(plant, n_control, n_measurement), _gain(plant, n_control, n_measurement)
    moved = np.inf
    for coordinates in (schur_coordinates, modal_coordinates):
        if value >= gamma * (1 - LEVEL_RTOL) or not plant.order:
            return LowerBound(value, 0.0 if moved == np.inf else moved, size)
        here = _moved_optimum(plant, n_control, n_measurement, coordinates, ALLOWANCE)
        moved = min(moved, here)
        if here < 1 / DEDUCTED:
            problem = _posed(plant, n_control, n_measurement, coordinates).problem
            claim = problem.optimum(CLAIM_RTOL) / (1 + CLAIM_RTOL)
            dual = proved_level(problem.P, problem.control, problem.filter, claim)
            value = max(value, min(dual, claim) * (1 - DEDUCTED * here))
    return LowerBound(value, moved, size)


def _gain(plant: StateSpace, n_control: int, n_measurement: int) -> float:
    """Return the largest σ̄ from w to z at zero and at the frequencies of the poles, where it is finite."""
    rates = np.abs(np.log(plant.poles() + 0j).imag) / plant.dt if plant.dt else np.abs(plant.poles())
    M = plant.response(np.append(rates, 0.0))[:, :-n_measurement, :-n_control]
    return float(np.linalg.norm(M[np.isfinite(M).all((1, 2))], 2, axis=(1, 2)).max(initial=0.0))


def moved_by_digits(plant: StateSpace, n_control: int, n_measurement: int) -> tuple[float, float]:
    """Measure how far the last digits of the data move the optimum.

    Parameters
    ----------
    plant : StateSpace
    n_control, n_measurement : int, as in `hinf_synthesis`

    Returns
    -------
    tuple[float, float]
        Relative change of the data, and the largest relative change of the optimum that it caused. The change
        of the optimum is the least over the choices of coordinates.
    """
    moved = min(
        _moved_optimum(plant, n_control, n_measurement, coordinates, 0.0)
        for coordinates in (schur_coordinates, modal_coordinates)
    )
    return _data_share(plant), moved


def _data_share(plant: StateSpace) -> float:
    return MAPPED_RTOL if plant.dt else DATA_RTOL


def _moved_optimum(
    plant: StateSpace, n_control: int, n_measurement: int, coordinates: Coordinates, allowance: float
) -> float:
    """Return the largest relative change of the optimum over trial changes of the data.

    The trials change the original data, and by ``allowance`` the entries in ``coordinates``. The result is
    inf where the search finds no optimum.
    """
    levels = []
    for seed in (None, *range(PERTURBED)):
        signs = np.random.default_rng(seed).choice

        def changed(part: np.ndarray, share: float, seed=seed, signs=signs) -> np.ndarray:
            return part if seed is None else part * (1 + share * signs([-1.0, 1.0], part.shape))

        A, B, C, D = (changed(getattr(plant, name), _data_share(plant)) for name in "ABCD")
        other = replace(plant, A=A, B=B, C=C, D=D)
        try:
            P = _posed(other, n_control, n_measurement, coordinates).problem.P
            P = Plant(*(changed(getattr(P, field.name), allowance) for field in fields(P)))
            levels.append(GammaProblem(P).optimum(MOVED_RTOL))
        except (SynthesisError, np.linalg.LinAlgError):
            return np.inf
    own = levels[0]
    return float(np.abs(np.array(levels) - own).max()) / (own if own > 0 else 1.0)


@dataclass(frozen=True)
class _Posed:
    """The continuous problem of a plant, and the data that map its controller back to the original plant.

    D22 (p2, m2) is the feedthrough that the problem leaves out. shift (m2, p2) is the static feedback that
    was closed first. basis (n, n) holds the problem's coordinates: x_plant = basis x_problem.
    """

    plant: StateSpace
    problem: GammaProblem
    D22: np.ndarray
    shift: np.ndarray
    basis: np.ndarray

    def norm(self, K: StateSpace) -> NormBracket:
        """Norm of the original plant closed by its controller K.

        Where rounding makes the bracket wide, the coordinates of the problem may narrow it. Both computations
        must find the loop stable. The new upper end does not lie below the lower end of the first bracket.
        """
        norm = hinf_norm(lft(self.plant, K), rtol=NORM_RTOL)
        wide = norm.lower * (1 + 2 * NORM_RTOL) < norm.upper <= norm.lower * (1 + WIDEST)
        if not wide or np.count_nonzero(self.basis) <= len(self.basis):
            return norm
        other = hinf_norm(lft(transformed(self.plant, self.basis), K), rtol=NORM_RTOL)
        upper = max(other.upper, norm.lower)
        return replace(norm, upper=upper, lower=min(norm.lower, other.upper)) if upper < norm.upper else norm

    def restore(self, K: StateSpace) -> StateSpace:
        """Controller of the original plant from the controller K of the problem.

        It has the sample time and the names of the plant.
        """
        plant, (n_u, n_y) = self.plant, self.shift.shape
        K = absorb_feedthrough(K, self.D22)
        K = to_discrete(K, plant.dt) if plant.dt else K
        return StateSpace(
            K.A, K.B, K.C, K.D + self.shift, plant.dt, plant.outputs[-n_y:], plant.inputs[-n_u:]
        )


def _posed(plant: StateSpace, n_control: int, n_measurement: int, coordinates: Coordinates) -> _Posed:
    """The problem with its state in ``coordinates``. Raises SynthesisError unless a controller exists."""
    check_shape(plant, n_control, n_measurement)
    shift, shifted = move_pole_at_minus_one(plant, n_control, n_measurement)
    basis = np.eye(plant.order)
    if plant.order:
        first = balancing(shifted)
        shifted = to_continuous(scaled_states(shifted, first))
        second = balancing(shifted)
        shifted, third = coordinates(scaled_states(shifted, second))
        basis = (first * second)[:, None] * third
    blocks, D22 = partition(shifted, n_control, n_measurement)
    check_existence(blocks, plant)
    return _Posed(plant, GammaProblem(blocks), D22, shift, basis)


def _synthesis(posed: _Posed, backoff: float, rtol: float, guess: float | None) -> HinfResult:
    """First controller whose certified norm is within ``backoff`` of the optimum, else the best one."""
    problem = posed.problem
    try:
        gamma = problem.optimum(rtol, guess)
    except SynthesisError:
        if not problem.singular:
            raise
        gamma = problem.floor
        problem.notes.append("the optimum could not be bracketed: gamma is a lower bound only")
    trials = _Trials(posed, gamma, backoff)
    trials.near_optimum()
    if not trials.good:
        trials.descend()
    best = trials.best
    if best is None or not np.isfinite(best.gamma_achieved):
        raise SynthesisError(
            "H-infinity synthesis",
            f"gamma {gamma:.6g}",
            "no controller passed its certificate",
            _expected(posed.plant),
        )
    return best if trials.good else _unresolved(best, posed, gamma)


class _Trials:
    """Trial controllers of one problem. ``best`` has the least certified norm so far.

    ``gamma`` is the optimum that the Riccati equations claim. ``backoff`` is the relative distance above it
    at which a controller is good enough.
    """

    def __init__(self, posed: _Posed, gamma: float, backoff: float):
        self.posed, self.gamma, self.backoff = posed, gamma, backoff
        self.budget = int(np.clip(MAX_WORK / max(posed.plant.order, 1), 25, 100))
        self.best: HinfResult | None = None

    @property
    def reached(self) -> float:
        """Least certified norm so far, inf before the first controller."""
        return np.inf if self.best is None else self.best.gamma_achieved

    @property
    def good(self) -> bool:
        """Whether the best controller is within the back-off of the optimum."""
        return self.best is not None and self.reached <= self.gamma * (1 + self.backoff)

    def attempt(self, level: float, epsilon: float) -> None:
        """Make the central controller at ``level`` with regularisation ``epsilon``, and certify it."""
        if self.budget <= 0:
            return
        self.budget -= 1
        posed = self.posed
        try:
            central = posed.problem.controller(level, epsilon)
            if central is None:
                return
            t = balancing(central) if central.order else np.ones(0)
            K = posed.restore(scaled_states(central, t))
            norm = posed.norm(K)
        except (np.linalg.LinAlgError, SynthesisError):  # the controller cannot be realised
            return
        if self.best is None or norm.upper < self.best.gamma_achieved:
            claim = min(self.gamma, norm.lower)
            self.best = HinfResult(
                K,
                claim,
                norm.upper,
                norm,
                posed.basis * t,
                regularisation=epsilon,
                notes=tuple(posed.problem.notes),
            )

    def near_optimum(self) -> None:
        """Try levels within the back-off of the optimum, mild controllers first, until one is good."""
        for epsilon, share in self.posed.problem.attempts():
            if self.gamma > 0:
                self.attempt(self.gamma * (1 + share * self.backoff), epsilon)
            if self.good:
                return

    def descend(self) -> None:
        """Start from any reachable level, then lower the level and ε step by step."""
        singular, level = self.posed.problem.singular, max(self.gamma, 1e-6)
        while not np.isfinite(self.reached) and level < 1e12:
            for epsilon in (1e-1, 1e-2, 1e-3, 1e-4, 1e-6) if singular else (0.0,):
                self.attempt(level, epsilon)
            level *= 10
        start = self.reached
        for epsilon in (10.0 ** -np.arange(1.0, 13.0)).tolist() if singular else [0.0]:
            for factor in (0.03, 0.3, 0.6, 0.9, 1.0):
                if self.good or self.reached <= 1e-7 * start:
                    return
                if np.isfinite(self.reached):
                    self.attempt(max(factor * self.reached, self.gamma * 1.005), epsilon)


def _unresolved(best: HinfResult, posed: _Posed, gamma: float) -> HinfResult:
    """``best`` marked as not resolved, with a note on its distance from ``gamma``."""
    fastest = np.abs(best.controller.poles()).max(initial=0.0)
    note = (
        f"not resolved: the best controller achieves {best.gamma_achieved:.4g} and has poles up to "
        f"{fastest:.3g}; the Riccati equations claim {gamma:.4g}"
    )
    notes = (*best.notes, note, *filter(None, [frail_pole(posed.plant)]))
    return replace(best, resolved=False, notes=notes)


def _expected(plant: StateSpace) -> str:
    """Remedy in words: balanced coordinates only where rounding of the plant's own makes a pole uncertain."""
    frail = frail_pole(plant)
    return f"balanced or modal coordinates: {frail}" if frail else "an optimum that double precision can show"
