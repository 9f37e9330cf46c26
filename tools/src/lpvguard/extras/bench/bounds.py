"""Bounds of μ and of the H∞ optimum where they are known by algebra: false, loose, refused answers, counted.

Each family draws its problems from a seed; ``solve`` answers them as it answers anybody's. An answer is false
where its upper bound lies below the value or its lower bound above it, by more than rounding. It is loose
where it does not say that it is, or where its bounds are more than 1 % apart with at most four real scalars.
A refused problem got an error. The same seed gives the same table.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial

from lpvguard.base.parallel import workers as parallel_map
from lpvguard.extras.bench import _hinf_families, _mu_families, parser, show
from lpvguard.extras.bench._mu_families import Family, problems
from lpvguard.extras.problems.solve import solve_problem

FALSE_RTOL = 1e-7
"""Rounding of the value and of the answer, relative."""
LOOSE = 1.01
FAMILIES: dict[str, list[Family]] = {**_mu_families.FAMILIES, "hinf": _hinf_families.PROBLEMS}
BOUNDS = {
    "mu": ("mu_lower", "mu_upper"),
    "mu_interval": ("mu_lower", "mu_upper"),
    "hinf": ("gamma_lower", "gamma_achieved"),
}
"""Fields of an answer by kind."""


@dataclass(frozen=True)
class Row:
    """Counts of one family.

    Attributes
    ----------
    kind, family : str
    count, false, loose, refused : int
    worst : float
        Largest upper bound over its value.
    """

    kind: str
    family: str
    count: int
    false: int
    loose: int
    refused: int
    worst: float


def _outcome(family: Family, seed: int, index: int) -> tuple[bool, bool, bool, float]:
    """Return whether the answer is false, loose, refused, and its upper bound over the value."""
    problem, value = next(problems(family, 1, seed, index))
    answer = solve_problem({"id": index, **problem})
    if answer["status"] != "ok":
        return False, False, True, 1.0
    lower, upper = (answer[field] for field in BOUNDS[problem["kind"]])
    false = upper < value * (1 - FALSE_RTOL) or lower > value * (1 + FALSE_RTOL)
    ratio = upper / value if value > 0 else 1.0
    return false, ratio > LOOSE or not answer["resolved"], False, ratio


def bench_bounds(count: int, seed: int, jobs: int) -> list[Row]:
    """Return a row for each family of ``count`` problems, solved by ``jobs`` processes."""
    rows = []
    with parallel_map(jobs) as pool:
        for kind, families in FAMILIES.items():
            for family in families:
                outcomes = list(pool(partial(_outcome, family, seed), range(count)))
                false, loose, refused = ([bool(o[k]) for o in outcomes].count(True) for k in range(3))
                worst = max(o[3] for o in outcomes)
                rows.append(Row(kind, family.__name__, count, false, loose, refused, worst))
    return rows


def table(rows: list[Row]) -> str:
    """Return the rows as a text table, with their sums."""

    def lines() -> Iterator[str]:
        counts = f"{'problems':>8} {'false':>6} {'loose':>6} {'refused':>8} {'worst/value':>12}"
        yield f"{'kind':12} {'family':22} {counts}"
        for r in rows:
            yield (
                f"{r.kind:12} {r.family:22} {r.count:8} {r.false:6} {r.loose:6} {r.refused:8} {r.worst:12.6f}"
            )
        sums = [sum(getattr(r, name) for r in rows) for name in ("count", "false", "loose", "refused")]
        yield f"{'all':35} {sums[0]:8} {sums[1]:6} {sums[2]:6} {sums[3]:8}"

    return "\n".join(lines())


def main(argv: list[str]) -> None:
    """Run ``lpvguard bench bounds``."""
    options = parser("bounds", __doc__)
    options.add_argument(
        "--count", type=int, default=200, help="problems of each family (10000 in the long form)"
    )
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--jobs", type=int, default=1, help="processes")
    asked = options.parse_args(argv)
    rows = bench_bounds(asked.count, asked.seed, asked.jobs)
    show(table(rows), [asdict(row) for row in rows], asked.json_out)
