"""Compare bounds of μ and of the H∞ optimum with known values: count false, loose and refused answers.

Each family draws its problems from a seed, and ``solve`` answers them. The table has these counts:

    false         the upper bound is below the value, or the lower bound is above it, by more than rounding
    loose         the upper bound is more than 1 % above the value, and the answer does not say so
    unresolved    the answer says that its bounds differ by more than 1 %
    undetermined  the error says that rounding of the data changes the optimum
    refused       any other error

The same seed gives the same table.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np

from lpvguard.base.parallel import workers as parallel_map
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.extras.bench import _hinf_families, _mu_families, _other_families, parser, show
from lpvguard.extras.bench._mu_families import Family, problems
from lpvguard.extras.problems.solve import solve_problem
from lpvguard.extras.problems.synthesis import DIGITS

FALSE_RTOL = 1e-7
"""Relative rounding error of the value and of the answer."""
LOOSE = 1.01
FAMILIES: dict[str, list[Family]] = {
    **_mu_families.FAMILIES,
    "hinf": _hinf_families.PROBLEMS,
    **_other_families.FAMILIES,
}
BOUNDS = {
    "mu": ("mu_lower", "mu_upper"),
    "mu_interval": ("mu_lower", "mu_upper"),
    "hinf": ("gamma_lower", "gamma_achieved"),
    "multiplicative": ("nu", "nu"),
    "margin": ("t", "t"),
    "lft": ("J_lower", "J_upper"),
    "lft_margin": ("t_lower", "t_upper"),
}
"""Fields of an answer with the bounds, by kind of ``solve``."""


@dataclass(frozen=True)
class Row:
    """Counts of one family.

    Attributes
    ----------
    kind, family : str
    count, false, loose, unresolved, undetermined, refused : int
    worst : float, largest ratio of an upper bound to its value
    """

    kind: str
    family: str
    count: int
    false: int
    loose: int
    unresolved: int
    undetermined: int
    refused: int
    worst: float


COUNTS = ("false", "loose", "unresolved", "undetermined", "refused")


def _outcome(family: Family, seed: int, index: int) -> tuple[bool, bool, bool, bool, bool, float]:
    """Solve one problem; return which of ``COUNTS`` apply, and the ratio of the upper bound to the value."""
    problem, value = next(problems(family, 1, seed, index))
    if problem["kind"] in _other_families.ENGINE:
        try:
            lower, upper = _other_families.ENGINE[problem["kind"]](problem)
        except (SynthesisError, ArithmeticError, np.linalg.LinAlgError):
            return False, False, False, False, True, 1.0
        return *_judged(lower, upper, value, True), 1.0 if np.isinf(upper) else upper / value
    answer = solve_problem({"id": index, **problem})
    if answer["status"] != "ok":
        undetermined = DIGITS in answer["error"]
        return False, False, False, undetermined, not undetermined, 1.0
    lower, upper = (answer[field] for field in BOUNDS[problem["kind"]])
    judged = _judged(lower, upper, value, bool(answer.get("resolved", True)))
    return *judged, upper / value if value > 0 else 1.0


def _judged(lower: float, upper: float, value: float, resolved: bool) -> tuple[bool, bool, bool, bool, bool]:
    """Return which of ``COUNTS`` apply to an answer; a single stated bound must be near the value."""
    false = upper < value * (1 - FALSE_RTOL) or lower > value * (1 + FALSE_RTOL)
    tight = lower * LOOSE >= value if np.isinf(upper) else upper <= LOOSE * value or value == 0
    return false, resolved and not tight, not resolved, False, False


def bench_bounds(count: int, seed: int, jobs: int) -> list[Row]:
    """Return a row for each family; ``jobs`` processes solve ``count`` problems of each kind."""
    rows = []
    with parallel_map(jobs) as pool:
        for kind, families in FAMILIES.items():
            for k, family in enumerate(families):
                share = (count + k) // len(families)
                outcomes = list(pool(partial(_outcome, family, seed), range(share)))
                counts = {name: sum(bool(o[k]) for o in outcomes) for k, name in enumerate(COUNTS)}
                worst = max((o[-1] for o in outcomes), default=1.0)
                rows.append(Row(kind, family.__name__, share, worst=worst, **counts))
    return rows


def table(rows: list[Row]) -> str:
    """Return the rows as a text table, with their sums."""

    columns = ("count", *COUNTS)

    def lines() -> Iterator[str]:
        yield f"{'kind':12} {'family':22} {'problems':>8} " + " ".join(
            f"{name:>12}" for name in (*COUNTS, "worst/value")
        )
        for r in rows:
            numbers = " ".join(f"{getattr(r, name):12}" for name in COUNTS)
            yield f"{r.kind:12} {r.family:22} {r.count:8} {numbers} {r.worst:12.6f}"
        sums = [sum(getattr(r, name) for r in rows) for name in columns]
        yield f"{'all':35} {sums[0]:8} " + " ".join(f"{n:12}" for n in sums[1:])

    return "\n".join(lines())


def main(argv: list[str]) -> None:
    """Run ``lpvguard bench bounds``."""
    arguments = parser("bounds", __doc__)
    arguments.add_argument(
        "--count", type=int, default=2000, help="problems of each kind, evenly of its families"
    )
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--jobs", type=int, default=1, help="processes")
    options = arguments.parse_args(argv)
    rows = bench_bounds(options.count, options.seed, options.jobs)
    show(table(rows), [asdict(row) for row in rows], options.json_out)
