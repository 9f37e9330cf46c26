"""Solve a list of problems in plain JSON with the numerical engine and return a list of answers.

Schema ``lpvguard.problems/1``: complex numbers are ``[re, im]``, matrices row-major nested lists. Kinds:
``zoh``, ``frequency_response``, ``multiplicative``, ``multiplicative_tradeoff``, ``margin``, ``lft``,
``lft_margin``, ``mu``, ``mu_interval``, ``hinf``. A bad problem gets ``{"id", "status": "error", "error":
"<where, what; expected>"}`` and never stops the others. A problem with an ``answer`` is compared with it.
"""

import json
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...base.artefacts import write_json
from ...base.errors import InputError
from ...engine.validation import s1
from .fields import Fields, pairs

ANSWERS_SCHEMA = "lpvguard.answers/1"
BRACKET_GAP = 1e-3
"""Largest relative gap between the two bounds of an answer."""

EXPLAINED_RTOL = 1e-11
"""Allowed rounding of an explanation by delta and w, relative to its terms."""

MARGIN_RTOL, MARGIN_ROUNDING = 1e-6, 1e-13
"""Relative distances from a margin and from E / W_w at which the check tests whether the margin is
attained."""

DATA_ROUNDING = 4.0 * float(np.finfo(float).eps)
"""Relative rounding of E and Z that appears in B1."""


def _truck(f: Fields) -> tuple[float, float, float]:
    if f.raw("model") != "truck":
        raise f.error("model", repr(f.raw("model")), "'truck'")
    return f.number("v", positive=True), f.number("wheelbase", positive=True), f.number("Ts", positive=True)


def _solve_zoh(f: Fields) -> dict:
    from lpvguard.vehicle import truck_model  # slow: it loads the project files

    a_d, b_d = truck_model.zoh(*_truck(f))
    return {"Ad": a_d.tolist(), "Bd": b_d.tolist(), "state": ["r", "delta", "delta_dot"]}


def _solve_frequency_response(f: Fields) -> dict:
    from lpvguard.vehicle import truck_model

    return {"P": pairs(truck_model.frequency_response(*_truck(f), f.number("omega")))}


def _bin(f: Fields) -> tuple[np.ndarray, np.ndarray]:
    e = f.complex("E", (None,))
    if e.size == 0:
        raise f.error("E", "empty", "at least one output")
    return e, f.complex("Z", e.shape)


def _solve_multiplicative(f: Fields) -> dict:
    e, z = _bin(f)
    r = s1.solve(e, z, f.number("gamma_w"))
    feasible = bool(r.feasible)
    if feasible:
        _require_explained(f, e, z, r)
    answer = {"B1": float(r.b1), "feasible": feasible, "nu": float(r.nu) if feasible else None}
    return answer | ({"delta": pairs(r.delta), "w": pairs(r.w)} if feasible else {})


def _require_explained(f: Fields, e: np.ndarray, z: np.ndarray, r: s1.S1Result) -> None:
    """Raise InputError unless nu is the least size of a delta that explains E with B1 <= |w| <= gamma_w.

    For any y, |E - delta Z| is at least (Re y^H E - |delta| |y^H Z|) / |y|. For y = w (with delta y^H Z real
    and not negative) or y = delta Z, this exceeds gamma_w for every smaller delta.
    """
    gamma, nu = f.number("gamma_w"), abs(complex(r.delta))
    left, size = (float(np.linalg.norm(x)) for x in (e - r.delta * z - r.w, r.w))
    terms = EXPLAINED_RTOL * float(np.linalg.norm(e) + nu * np.linalg.norm(z))
    held = left <= terms and max(size, float(r.b1)) <= gamma * (1 + EXPLAINED_RTOL) + terms
    least = nu == 0.0
    if not least:
        moved = r.delta * z
        along = np.vdot(moved, r.w)
        y = r.w - (along - max(along.real, 0.0)) / np.vdot(moved, moved) * moved
        least = any(
            np.vdot(x, e).real - nu * abs(np.vdot(x, z)) >= (gamma - terms) * np.linalg.norm(x)
            for x in (y, moved)
        )
    rest = float(np.linalg.norm(e - np.vdot(z, e) / (np.vdot(z, z) or 1.0) * z))
    held &= abs(rest - float(r.b1)) <= EXPLAINED_RTOL * float(np.linalg.norm(e))
    if not (held and least and abs(nu - float(r.nu)) <= EXPLAINED_RTOL * nu):
        what = f"not proved: nu {float(r.nu):.9g}, |delta| {nu:.9g}, |w| {size:.9g}, off by {left:.3g}"
        raise f.error("nu", what, "data scaled to similar sizes")


def _solve_multiplicative_tradeoff(f: Fields) -> dict:
    e, z = _bin(f)
    gamma = f.number("gamma_w")
    r = s1.tradeoff(e, z, gamma, f.number("lambda_nu"), f.weights("lambda_w", e.size))
    if not np.isfinite(r.cost):
        b1 = float(s1.solve(e, z, gamma).b1)
        raise f.error(
            "gamma_w", f"{gamma:.6g} is below the smallest disturbance B1 = {b1:.6g}", "gamma_w >= B1"
        )
    return {"J": float(r.cost), "nu": float(r.nu), "delta": pairs(r.delta), "w": pairs(r.w)}


def _solve_margin(f: Fields) -> dict:
    e, z = _bin(f)
    w_delta = f.weights("W_delta", e.size) if isinstance(f.raw("W_delta"), list) else f.number("W_delta")
    w_w = f.weights("W_w", e.size, positive=True)
    t = float(s1.margin(e, z, w_delta, w_w))
    groups = [np.arange(e.size)] if np.size(w_delta) == 1 else [np.array([j]) for j in range(e.size)]
    reaches = np.broadcast_to(w_delta, len(groups))
    slack = MARGIN_RTOL * t + MARGIN_ROUNDING * float((np.abs(e) / w_w).max())
    for level, within in ((t + slack, True), (t - slack, False)):
        kept = all(
            _within(e[g], z[g], level * reach, level * w_w[g])
            for g, reach in zip(groups, reaches, strict=True)
        )
        if kept != within and level > 0.0:
            raise f.error("t", f"not proved: {t:.9g}", "data scaled to similar sizes")
    return {"t": t}


def _within(e: np.ndarray, z: np.ndarray, reach: float, w: np.ndarray) -> bool:
    """Tell if one delta within ``reach`` gives |E_j - delta Z_j| <= ``w`` (n,) for every output.

    If discs have a common point, a centre of a disc or a crossing of two circles is common, too.
    """
    tell = z != 0
    centres = np.append(e[tell] / z[tell], 0.0)
    radii = np.append(w[tell] / np.abs(z[tell]), reach)
    order = np.argsort(radii)  # points are relative to the centre of the smaller disc
    centres, radii = centres[order], radii[order]
    i, j = np.triu_indices(len(radii), 1)
    apart = centres[j] - centres[i]
    far = np.where(apart == 0, 1.0, np.abs(apart))
    turn = apart / far
    along = 0.5 * ((far - radii[j]) / far * (far + radii[j]) + radii[i] / far * radii[i])
    along = np.clip(along, -radii[i], radii[i])
    aside = 1j * np.sqrt(radii[i] ** 2 - along**2)
    points = np.concatenate(
        [centres, centres[i] + (along + aside) * turn, centres[i] + (along - aside) * turn]
    )
    rounding = 2 * DATA_ROUNDING * (np.abs(e) + np.abs(points)[:, None] * np.abs(z))
    kept = np.abs(e - points[:, None] * z) <= w + rounding
    return bool(np.any(kept.all(axis=1) & (np.abs(points) <= reach * (1 + 2 * DATA_ROUNDING))))


def _solve_lft(f: Fields) -> dict:
    from .lft import solve_lft

    return solve_lft(f)


def _solve_lft_margin(f: Fields) -> dict:
    from .lft import solve_lft_margin

    return solve_lft_margin(f)


def _solve_mu(f: Fields) -> dict:
    from .synthesis import solve_mu

    return solve_mu(f.problem)


def _solve_mu_interval(f: Fields) -> dict:
    from .synthesis import solve_mu_interval

    return solve_mu_interval(f.problem)


def _solve_hinf(f: Fields) -> dict:
    from .synthesis import solve_hinf

    return solve_hinf(f.problem)


_SOLVERS: dict[str, Callable[[Fields], dict]] = {
    "zoh": _solve_zoh,
    "frequency_response": _solve_frequency_response,
    "multiplicative": _solve_multiplicative,
    "multiplicative_tradeoff": _solve_multiplicative_tradeoff,
    "margin": _solve_margin,
    "lft": _solve_lft,
    "lft_margin": _solve_lft_margin,
    "mu": _solve_mu,
    "mu_interval": _solve_mu_interval,
    "hinf": _solve_hinf,
}
"""Solver by kind. A kind imports slow modules itself: scipy.optimize would double the start-up time."""


def solve_problem(problem: Any) -> dict:
    """Answer one problem; bad input gives an error answer and no exception.

    Parameters
    ----------
    problem : Any, JSON value

    Returns
    -------
    dict
    """
    if not isinstance(problem, dict):
        return {
            "id": None,
            "status": "error",
            "error": f"problem: {type(problem).__name__}; expected an object",
        }
    identity = {"id": problem.get("id")}
    fields = Fields(problem)
    try:
        kind = fields.raw("kind")
        if not isinstance(kind, str) or kind not in _SOLVERS:
            raise fields.error("kind", repr(kind), "one of " + ", ".join(_SOLVERS))
        return identity | {"status": "ok"} | _SOLVERS[kind](fields)
    except InputError as exc:
        text = str(exc) if str(exc).startswith(fields.source) else f"{fields.source}: {exc}"
        return identity | {"status": "error", "error": text}
    except Exception as exc:
        return identity | {
            "status": "error",
            "error": f"{fields.source}: internal error, {type(exc).__name__}: {exc}",
        }


def solve_problems(problems: Sequence[Any], jobs: int = 1) -> list[dict]:
    """Answer problems in order with ``jobs`` processes. The answers do not depend on ``jobs``."""
    if jobs <= 1 or len(problems) < 2:
        return [solve_problem(p) for p in problems]
    with ProcessPoolExecutor(max_workers=jobs) as pool:
        return list(pool.map(solve_problem, problems, chunksize=max(1, len(problems) // (8 * jobs))))


@dataclass
class Comparison:
    """Result of one comparison; ``misses`` holds one line per field outside its tolerance."""

    id: Any
    compared: bool
    misses: list[str] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """True if no field missed; also True if there was nothing to compare with."""
        return not self.misses


def _value_miss(name: str, got: Any, ref: Any, rtol: float, scale: float) -> str | None:
    if ref is None or isinstance(ref, bool):
        return None if got is ref else f"{name}: {got}; expected {ref}"
    if got is None:
        return f"{name}: missing; expected {ref}"
    try:
        x, r = np.asarray(got, dtype=float), np.asarray(ref, dtype=float)
    except (TypeError, ValueError):
        return f"{name}: {got!r}; expected {ref!r}"
    if x.shape != r.shape:
        return f"{name}: shape {x.shape}; expected {r.shape}"
    if r.ndim > 1 and r.shape[-1] == 2 and name == "P":
        x, r = x[..., 0] + 1j * x[..., 1], r[..., 0] + 1j * r[..., 1]
    error, size = np.max(np.abs(x - r), initial=0.0), np.max(np.abs(r), initial=0.0)
    limit = rtol * max(size, 1e-9 * scale)
    if name == "B1":
        limit = max(limit, DATA_ROUNDING * scale)
    return None if error <= limit else f"{name}: off by {error:.3g}; expected within {limit:.3g}"


def _bracket_misses(stem: str, answer: dict, ref: dict, rtol: float) -> list[str]:
    low, up = answer.get(f"{stem}_lower"), answer.get(f"{stem}_upper")
    if low is None or up is None:
        return [f"{stem}_lower, {stem}_upper: missing"]
    ref_low, ref_up = ref[f"{stem}_lower"], ref[f"{stem}_upper"]
    misses = []
    if not low <= ref_up * (1 + rtol):
        misses.append(f"{stem}_lower: {low:.9g}; expected at most {ref_up * (1 + rtol):.9g}")
    if not up >= ref_low * (1 - rtol):
        misses.append(f"{stem}_upper: {up:.9g}; expected at least {ref_low * (1 - rtol):.9g}")
    if not up <= ref_up * (1 + rtol):
        misses.append(f"{stem}_upper: {up:.9g}; expected at most {ref_up * (1 + rtol):.9g}")
    if not up - low <= BRACKET_GAP * up:
        misses.append(f"{stem}: gap {(up - low) / up:.3g}; expected at most {BRACKET_GAP:g}")
    return misses


def compare(problem: dict, answer: dict) -> Comparison:
    """Compare an answer with the reference answer in the problem, by the rules of the interface.

    The rule is ``|x - ref| <= rtol max(|ref|, 1e-9 scale)``, for arrays by their largest element. The scale
    is ||E|| for B1 and 1 otherwise. Intervals and mu have one-sided rules. A reference with status ``error``
    requires an error. One exception is added: a B1 below the rounding of its data (DATA_ROUNDING ||E||)
    equals zero, because such reference values are rounding errors themselves.
    """
    ref = problem.get("answer") if isinstance(problem, dict) else None
    if not isinstance(ref, dict):
        return Comparison(answer.get("id"), compared=False)
    result = Comparison(answer.get("id"), compared=True)
    wants_error = ref.get("status") == "error" or "error" in ref
    if wants_error or answer.get("status") != "ok":
        if wants_error != (answer.get("status") == "error"):
            result.misses.append(
                f"status: {answer.get('error', 'ok')}; expected {'an error' if wants_error else 'ok'}"
            )
        return result
    rtol = float(problem.get("rtol", 1e-6))
    done = {"id", "status", "note"}
    for stem in ("J", "t"):
        if f"{stem}_lower" in ref and f"{stem}_upper" in ref:
            result.misses += _bracket_misses(stem, answer, ref, rtol)
            done |= {f"{stem}_lower", f"{stem}_upper"}
    for name, sign in (("mu_upper", 1.0), ("mu_lower", -1.0)):
        if name in ref:
            done.add(name)
            got = answer.get(name)
            if got is None or not sign * (got - ref[name]) <= rtol * abs(ref[name]):
                result.misses.append(
                    f"{name}: {got}; expected {'at most' if sign > 0 else 'at least'} {ref[name]}"
                )
    for name in (n for n in ref if n not in done):
        scale = float(np.linalg.norm(np.asarray(problem["E"], dtype=float))) if name == "B1" else 1.0
        miss = _value_miss(name, answer.get(name), ref[name], rtol, scale)
        if miss:
            result.misses.append(miss)
    return result


def _read(path: str) -> list:
    try:
        text = sys.stdin.read() if path == "-" else Path(path).read_text(encoding="utf-8")
    except OSError as exc:
        raise InputError(
            path, "", exc.strerror or str(exc), "a readable file, or - for standard input"
        ) from exc
    try:
        data = json.loads(text)
    except json.JSONDecodeError as exc:
        raise InputError(path, f"line {exc.lineno}, column {exc.colno}", exc.msg, "JSON") from exc
    problems = data.get("problems") if isinstance(data, dict) else data
    if not isinstance(problems, list):
        raise InputError(path, "", "no list of problems", 'a list, or an object with "problems": [...]')
    return problems


def run_solve(path_or_dash: str | os.PathLike, out: str | os.PathLike | None = None, jobs: int = 1) -> int:
    """Solve a file of problems.

    It writes misses and a summary to standard error.

    Parameters
    ----------
    path_or_dash : path, or ``-`` for standard input
    out : path, optional, for the answers, by default or with ``-`` standard output
    jobs : int, processes, default 1

    Returns
    -------
    int, exit status: 0 ok, 1 any miss, 2 bad input
    """
    try:
        problems = _read(os.fspath(path_or_dash))
    except InputError as exc:
        print(f"error: {exc}", file=sys.stderr)
        return 2
    answers = solve_problems(problems, jobs)
    try:
        write_json(
            "-" if out is None else os.fspath(out), {"schema": ANSWERS_SCHEMA, "answers": answers}, "solve"
        )
    except InputError as exc:
        print(f"error: {exc}", file=sys.stderr)
        return 2
    comparisons = [compare(p, a) for p, a in zip(problems, answers, strict=True)]
    for c in comparisons:
        for miss in c.misses:
            print(f"miss: {c.id}: {miss}", file=sys.stderr)
    errors = sum(a["status"] == "error" for a in answers)
    compared = sum(c.compared for c in comparisons)
    missed = sum(not c.ok for c in comparisons)
    print(
        f"{len(problems)} problems, {errors} with an error; {compared} compared, {missed} missed",
        file=sys.stderr,
    )
    return 1 if missed else 0
