"""Section II of the paper: the smallest perturbation and disturbance that explain one frequency point.

    eta = P11 xi + P12 w + eta0 (= P13 u),   e = P21 xi + P22 w,   xi_i = Delta_i eta_i

with full complex, repeated complex and repeated real blocks (Lim). Every solution of the second equation is
``x = maps @ (phi, psi, 1)`` where phi = U1^* w is free inside the ball (5) and psi is completely free
(:func:`problem.parametrise`). The remaining quadratic problem is not convex (``quadratic``). The S-procedure
(``relaxation``) in a branch and bound (``branch``) gives the lower bound. A feasible point from a local
search (``local_search``) gives the upper bound. The bounds meet for one or two full blocks and a disturbance
ball. Otherwise a gap between them may remain. Both bounds are returned.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from lpvguard.base.errors import InputError
from lpvguard.engine.validation import s2
from lpvguard.engine.validation.branch import GAP, MAX_NODES, SLACK, Incumbent, Interval, minimise, proves
from lpvguard.engine.validation.problem import Lft
from lpvguard.engine.validation.quadratic import Form, Quadratic
from lpvguard.engine.validation.scaled_problem import (
    EDGE,
    ROUNDING,
    ScaledProblem,
    Solution,
    ball,
    block_form,
    scaled_problem,
)
from lpvguard.engine.validation.well_posed import block_caps

ZERO = 1e-12
"""A squared size below this fraction of the first feasible point's counts as zero where zero is
attainable."""


def optimum(
    problem: Lft, gamma_w: float, lambda_nu: ArrayLike, lambda_w: ArrayLike | None = None, *, gap: float = GAP
) -> Solution:
    """Compute the optimum of (8): min sum lambda_nu,i nu_i^2 + sum lambda_w,j |w_j|^2 with |w| <= gamma_w.

    Parameters
    ----------
    problem : Lft
    gamma_w : float, bound on |w|
    lambda_nu : array_like (tau,), >= 0
    lambda_w : array_like (n_w,), optional, >= 0, by default 0
    gap : float, relative gap between the bounds

    Returns
    -------
    Solution

    Raises
    ------
    InputError
        If e is not in Im M, gamma_w < B1, no Delta explains e, or the optimum is at the well-posedness cap.

    References
    ----------
    Paper, section II, (8).
    """
    scaled = scaled_problem(problem, gamma_w)
    lam = np.asarray(lambda_nu, dtype=float)
    forms = ball(scaled, gamma_w)
    quadratic: list[np.ndarray] = []
    params = 0
    weights = np.zeros(len(scaled.w)) if lambda_w is None else np.asarray(lambda_w, dtype=float)
    if weights.any():
        quadratic.append(np.sqrt(weights)[:, None] * scaled.w)
    for i, block in enumerate(problem.blocks):
        if i in scaled.dead:
            continue
        if scaled.constant_eta(i) and not block.repeated and lam[i] > 0.0:
            quadratic.append(
                scaled.xi[i] * (np.sqrt(lam[i]) * np.linalg.norm(scaled.t) / np.linalg.norm(scaled.eta[i]))
            )
        elif lam[i] > 0.0:
            forms.append(block_form(scaled, i, param=params, slope=1.0 / lam[i]))
            params += 1
        elif block.repeated:
            forms.append(block_form(scaled, i, constant=block_caps(problem)[i] ** 2))
    if quadratic:
        forms.append(Form(np.vstack(quadratic), scaled.t, param=params, parts=tuple(quadratic)))
        params += 1
    quadratic_problem = Quadratic(forms, max(params, 1), scaled.n)
    interval = (
        _one_block(quadratic_problem, block_caps(problem), scaled) if quadratic and params == 2 else None
    )
    if interval is None or not interval.upper - interval.lower <= 2.0 * gap * interval.upper:
        interval = minimise(quadratic_problem, gap=gap)
    return scaled.finish(_proved(quadratic_problem, interval, problem.source), "gamma_w")


def _proved(problem: Quadratic, interval: Interval, source: str) -> Interval:
    """Return the interval if a proof separate from the search confirms its lower bound; else InputError."""
    if interval.z is None:
        return interval
    lower = interval.lower * (1.0 - SLACK)
    if not proves(problem, lower, interval.upper):
        raise InputError(
            source,
            "the lower bound",
            f"not proved: the cost is at least {lower:.9g}, and {interval.upper:.9g} is attained",
            "data scaled to similar sizes",
        )
    return replace(interval, lower=lower)


def _one_block(problem: Quadratic, caps: np.ndarray, scaled: ScaledProblem) -> Interval | None:
    """Solve by the compiled S2 kernel for one full block and a quadratic cost; None for other problems."""
    if len(problem.forms) != 3 or problem.repeated:
        return None
    ball_form, block, cost = problem.forms
    start = problem.repair(problem.origin())
    if start is None or problem.zero() is not None or len(start) > s2.MAX_N or len(start) < 2:
        return None
    which = next(i for i, xi in enumerate(scaled.xi) if xi is block.a)
    trivial = problem.cost(start)
    if trivial == np.inf:
        return None

    def square(m: np.ndarray) -> np.ndarray:
        return m.conj().T @ m

    weight = np.linalg.norm(block.a) ** 2
    t_row, rim = square(ball_form.b), ball_form.constant * (1.0 + 1e-12)
    forms = np.stack(
        [
            square(cost.a) / (trivial * np.linalg.norm(cost.b) ** 2),
            square(ball_form.a) / rim - t_row,
            square(block.a) / weight,
            square(block.b) * (block.slope * trivial / weight),
        ]
    )
    forms[1] /= np.linalg.norm(ball_form.b) ** 2
    p_max = caps[which] ** 2 / (block.slope * trivial) * (1.0 - 1e-9)
    out = s2.solve_forms(forms[None], start[None], p_max)
    [lower], [upper], [p], [z], [duals] = out.lower, out.upper, out.p, out.z, out.duals
    if not np.isfinite(upper) or p > s2.NEAR_CAP**2 * p_max:
        return None
    best = Incumbent(problem)
    best.start([z])
    certified = float(lower * trivial)
    return Interval(certified, max(best.cost, certified), best.z, int(duals))


def _last_block_is_free(problem: Lft, gamma_w: float, gap: float, max_nodes: int) -> bool:
    """Return whether a disturbance of at most gamma_w explains e without the last block.

    This is only for structures with repeated blocks. In others the least-squares point of
    :meth:`quadratic.Quadratic.zero` decides.
    """
    last = len(problem.blocks) - 1
    try:
        scaled = scaled_problem(problem, gamma_w, [last])
    except InputError:
        return False  # e is not in the image of the other blocks and w
    caps = block_caps(problem)
    forms = [Form(scaled.w, scaled.t, param=0)]
    forms += [
        block_form(scaled, i, constant=caps[i] ** 2)
        for i in range(last)
        if problem.blocks[i].repeated and i not in scaled.dead
    ]
    limit = gamma_w**2 * (1.0 + (EDGE if scaled.ball_is_point else ROUNDING))
    return minimise(Quadratic(forms, 1, scaled.n), gap, max_nodes, enough=limit).upper <= limit


def smallest_last_block(
    problem: Lft,
    gamma_w: float,
    *,
    gap: float = GAP,
    max_nodes: int = MAX_NODES,
    known: Solution | None = None,
) -> tuple[float, float]:
    """Bound the smallest size of the last block at a given gamma_w, with all other blocks free.

    Parameters
    ----------
    problem : Lft
    gamma_w : float, bound on |w|
    gap : float, relative gap between the bounds
    max_nodes : int, largest number of nodes of the branch and bound
    known : Solution, optional, explanation at the same gamma_w, from which the search starts

    Returns
    -------
    tuple of float, lower and upper bound

    Raises
    ------
    InputError
        If `optimum` would raise it, or the size is at or above the cap of the block.
    """
    scaled = scaled_problem(problem, gamma_w)
    last = len(problem.blocks) - 1
    if last in scaled.dead:
        return 0.0, 0.0
    forms = ball(scaled, gamma_w)
    caps = block_caps(problem)
    others = [i for i in range(last) if problem.blocks[i].repeated and i not in scaled.dead]
    if others and _last_block_is_free(problem, gamma_w, gap, max_nodes):
        return 0.0, 0.0
    forms += [block_form(scaled, i, constant=caps[i] ** 2) for i in others]
    forms.append(block_form(scaled, last, param=0))
    interval = minimise(Quadratic(forms, 1, scaled.n), gap, max_nodes, ZERO, scaled.points(known))
    lower, upper = float(np.sqrt(interval.lower)), float(np.sqrt(interval.upper))
    cap = caps[last]
    if not upper < cap:
        raise InputError(
            problem.source,
            f"block {last + 1}",
            f"needs {upper:.6g}, which is at or above its cap {cap:.6g}",
            "a smaller size",
        )
    return lower, upper


def smallest_common_size(
    problem: Lft,
    gamma_w: float,
    *,
    gap: float = GAP,
    max_nodes: int = MAX_NODES,
    known: Solution | None = None,
) -> Solution:
    """Compute the smallest t with all nu_i <= t at a given gamma_w.

    Parameters
    ----------
    problem : Lft
    gamma_w : float, bound on |w|
    gap : float, relative gap between the bounds
    max_nodes : int, largest number of nodes of the branch and bound
    known : Solution, optional, explanation at the same gamma_w, from which the search starts

    Returns
    -------
    Solution with the interval of t^2

    Raises
    ------
    InputError
        If `optimum` raises it.
    """
    scaled = scaled_problem(problem, gamma_w)
    forms = ball(scaled, gamma_w)
    forms += [block_form(scaled, i, param=0) for i in range(len(problem.blocks)) if i not in scaled.dead]
    interval = minimise(Quadratic(forms, 1, scaled.n), gap, max_nodes, points=scaled.points(known))
    return scaled.finish(interval, "gamma_w")


def margin(problem: Lft, w_delta: ArrayLike, w_w: ArrayLike, *, gap: float = GAP) -> Solution:
    """Compute the margin: the least t with nu_i <= t W_delta,i and |w_j| <= t W_w,j for all i and j.

    Parameters
    ----------
    problem : Lft
    w_delta : array_like (tau,), > 0
    w_w : array_like (n_w,), > 0
    gap : float, relative gap between the bounds

    Returns
    -------
    Solution with the interval of t

    Raises
    ------
    InputError
        If `optimum` raises it.
    """
    delta, w = np.asarray(w_delta, dtype=float), np.asarray(w_w, dtype=float)
    scaled = ScaledProblem(problem, w)
    forms = [Form(scaled.w[j : j + 1], scaled.t, param=0, slope=float(b) ** 2) for j, b in enumerate(w)]
    forms += [
        block_form(scaled, i, param=0, slope=float(b) ** 2)
        for i, b in enumerate(delta)
        if i not in scaled.dead
    ]
    quadratic = Quadratic(forms, 1, scaled.n)
    interval = _proved(quadratic, minimise(quadratic, gap=2.0 * gap), problem.source)
    solution = scaled.finish(interval, "W_delta, W_w")
    return replace(solution, lower=float(np.sqrt(solution.lower)), upper=float(np.sqrt(solution.upper)))
