"""Kinds ``lft`` and ``lft_margin`` of the problem interface, for :mod:`lpvguard.engine.validation.lft`."""

from collections.abc import Callable
from typing import TypeGuard

import numpy as np

from lpvguard.base.errors import InputError
from lpvguard.engine.blocks import Block
from lpvguard.engine.validation import lft
from lpvguard.engine.validation.problem import Lft
from lpvguard.engine.validation.scaled_problem import Solution
from lpvguard.extras.problems.fields import Fields, pairs

GAP = 4e-4
"""Relative gap between the bounds at which the branch and bound stops; the interface requires 1e-3."""

ATTAINED_RTOL = 1e-6
"""Allowed rounding between an upper bound and the explanation that attains it, as for its Delta."""

SIDE_NODES = 800
"""Largest number of nodes for ``nu_s_min`` and ``t_minmax``; a few nodes find their attained values."""


def _blocks(f: Fields) -> tuple[Block, ...]:
    raw = f.raw("blocks")
    if not isinstance(raw, list) or not raw:
        raise f.error("blocks", repr(raw), "a list of {type, rows, cols}")
    blocks = []
    for i, item in enumerate(raw):
        where = f"blocks[{i}]"
        if not isinstance(item, dict):
            raise f.error(where, repr(item), "{type, rows, cols}")
        rows, cols = item.get("rows"), item.get("cols")
        if not (_is_integer(rows) and _is_integer(cols)):
            raise f.error(where, f"rows, cols = {[rows, cols]}", "two positive integers")
        try:
            blocks.append(Block(str(item.get("type")), rows, cols))
        except InputError as exc:
            raise f.error(f"{where}.{exc.where}", exc.what, exc.expected) from None
    return tuple(blocks)


def _is_integer(value: object) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool)


def _problem(f: Fields) -> Lft:
    blocks = _blocks(f)
    p, q = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    e = f.complex("e", (None,))
    p21 = f.complex("P21", (e.size, p))
    p22 = f.complex("P22", (e.size, None)) if f.has("P22") else np.eye(e.size, dtype=complex)
    p12 = f.complex("P12", (q, p22.shape[1])) if f.has("P12") else np.zeros((q, p22.shape[1]), dtype=complex)
    return Lft(blocks, f.complex("P11", (q, p)), p12, p21, p22, f.complex("eta0", (q,)), e, f.source)


def _explanation(s: Solution) -> dict:
    return {
        "nu": s.nu.tolist(),
        "xi": pairs(s.xi),
        "w": pairs(s.w),
        "delta": [pairs(d) for d in s.verification.deltas],
        "residual": s.verification.residual,
    }


def _require_attained(f: Fields, name: str, s: Solution, cost: float, size: float, gamma: float) -> None:
    """Raise InputError unless the explanation's cost equals the upper bound and is not below the lower bound.

    ``cost`` follows from the explanation's nu and w. ``size`` is |w|, at most ``gamma``. Their Delta is
    verified where it is built.
    """
    upper = s.upper * (1 + ATTAINED_RTOL)
    if cost <= upper and s.lower <= upper and size <= gamma * (1 + ATTAINED_RTOL):
        return
    raise f.error(
        f"{name}_lower, {name}_upper",
        f"not proved: {s.lower:.9g} and {s.upper:.9g}, where the explanation costs {cost:.9g} with |w| = "
        f"{size:.9g}",
        "data scaled to similar sizes",
    )


def _or_reason(answer: dict, name: str, solver: Callable[[], float]) -> None:
    """Answer a secondary question of ``lft``; a failure gives null with a reason."""
    try:
        answer[name] = float(solver())
    except InputError as exc:
        answer[name] = None
        answer[f"{name}_reason"] = str(exc)


def solve_lft(f: Fields) -> dict:
    """Answer kind ``lft``: the optimum of (8) as an interval, its explanation, and two secondary results.

    Raises InputError that names the field of an impossible problem.
    """
    problem = _problem(f)
    tau, n_w = len(problem.blocks), problem.p22.shape[1]
    gamma = f.number("gamma_w")
    lambda_w = f.weights("lambda_w", n_w) if f.has("lambda_w") else None
    lambda_nu = f.weights("lambda_nu", tau)
    s = lft.optimum(problem, gamma, lambda_nu, lambda_w, gap=GAP)
    cost = float(lambda_nu @ s.nu**2)
    cost += 0.0 if lambda_w is None else float(lambda_w @ np.abs(s.w) ** 2)
    _require_attained(f, "J", s, cost, float(np.linalg.norm(s.w)), gamma)
    answer = {"J_lower": s.lower, "J_upper": s.upper, "B1": s.b1} | _explanation(s)

    def smallest_last_block() -> float:
        return lft.smallest_last_block(problem, gamma, gap=GAP, max_nodes=SIDE_NODES, known=s)[1]

    def smallest_common_size() -> float:
        common = lft.smallest_common_size(problem, gamma, gap=GAP, max_nodes=SIDE_NODES, known=s)
        return np.sqrt(common.upper)

    _or_reason(answer, "nu_s_min", smallest_last_block)
    _or_reason(answer, "t_minmax", smallest_common_size)
    return answer


def solve_lft_margin(f: Fields) -> dict:
    """Answer kind ``lft_margin``: the margin t as an interval, and its explanation.

    Raises InputError that names the field of an impossible problem.
    """
    problem = _problem(f)
    w_delta = f.weights("W_delta", len(problem.blocks), positive=True)
    w_w = f.weights("W_w", problem.p22.shape[1], positive=True)
    s = lft.margin(problem, w_delta, w_w)
    level = max((s.nu / w_delta).max(initial=0.0), (np.abs(s.w) / w_w).max(initial=0.0))
    _require_attained(f, "t", s, float(level), 0.0, 0.0)
    return {"t_lower": s.lower, "t_upper": s.upper} | _explanation(s)
