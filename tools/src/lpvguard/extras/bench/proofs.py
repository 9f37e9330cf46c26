"""Try to refute every certificate of a design with random loops, and search the least rate with a violation.

The first table has random loops within the limits of each certificate, each with its worst input
(bench/_trials.py). For every proof, it shows the worst number divided by the proved number. No ratio may be
above 1. The second table has the proved rate, and the least |dv/dt| at which a search finds a gain above 1,
or growth. The search uses admissible Delta (bench/_violations.py). A search without a violation proves
nothing. A line between the tables compares the largest mu at a frozen speed with the largest optimum of
controllers for one speed. The difference is the cost of scheduling, or of synthesis for other objectives.
"""

import argparse
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from ...base.claims import worst_frozen
from ...base.errors import InputError
from ...control import controller_file
from ...control.design import frozen_optimum
from ...identify import identification as identify
from . import parser, show
from ._trials import NEAR, Trial, Trials
from ._violations import Found, Search, fastest_growth, least_violating

LOOPS, SEED, SAMPLES = 500, 21, 3000
LARGEST_MPS2, SMALLEST_MPS2 = 50.0, 0.015
"""Range of rates in the search for a violation. A braking vehicle reaches about a fifth of the largest
rate."""
WANTED = 0.5
"""Wanted ratio of the proved rate to the least violating rate."""


@dataclass(frozen=True)
class ClaimRow:
    """Trials of a claim at ``rate_mps2`` (None: frozen speeds).

    ``worst`` is the largest reached share of the bound, and ``where`` describes its loop. ``above`` is the
    number of trials that refute the claim.
    """

    claim: str
    rate_mps2: float | None
    loops: int
    worst: float
    where: str
    above: int


@dataclass(frozen=True)
class FrozenMu:
    """Largest proved ``mu`` at a frozen speed, and largest ``optimum`` of controllers for a single speed."""

    mu: float
    v_mps: float
    optimum: float
    optimum_v_mps: float


@dataclass(frozen=True)
class RateRow:
    """Proved rate (None: nothing proved) and least violating rate (None: none up to ``tried_mps2``).

    ``without_mps2`` is the largest rate below the violating rate at which the search found no violation.
    """

    claim: str
    proved_mps2: float | None
    violating_mps2: float | None
    without_mps2: float
    tried_mps2: float

    @property
    def ratio(self) -> float | None:
        """Ratio of the proved rate to the violating rate; None without a violation."""
        return None if self.violating_mps2 is None else (self.proved_mps2 or 0.0) / self.violating_mps2


def main(argv: list[str]) -> None:
    """Run `lpvguard bench proofs IDENTIFICATION DESIGN`."""
    arguments = parser("proofs", __doc__)
    arguments.add_argument("identification", type=Path, help="folder written by identify")
    arguments.add_argument("design", type=Path, help="folder written by design")
    arguments.add_argument("--loops", type=_count, default=LOOPS, help="of all certificates together")
    arguments.add_argument("--samples", type=_count, default=SAMPLES, help="of a history")
    arguments.add_argument("--seed", type=int, default=SEED)
    arguments.add_argument("--no-search", action="store_true", help="leave out the search over rates")
    options = arguments.parse_args(argv)
    stored = identify.load(options.identification)
    path = options.design / "controller.json"
    document = controller_file.require_designed_for(stored, path)
    if not document["certificates"]["scaling_log_parameters"]:
        raise InputError(path, "structure", "a design without Delta", "K_i or K_o")
    if document["certificates"]["structure"] == "K_is":
        raise InputError(path, "structure", "K_is", "K_i or K_o, because the search only varies scalar Delta")
    trials = Trials(stored, document, options.samples, options.seed)
    claims = claim_rows(trials, options.loops)
    rates = [] if options.no_search else rate_rows(trials)
    frozen = frozen_mu(stored, document["certificates"])
    show("\n".join(lines(claims, frozen, rates)), as_dict(claims, frozen, rates), options.json_out)


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text}: at least 1")
    return value


def claim_rows(trials: Trials, loops: int) -> list[ClaimRow]:
    """Make a row for each certificate; the certificates share ``loops`` evenly, with at least one each."""
    claims = list(trials.claims())
    rows = []
    for k, (name, rate, job) in enumerate(claims):
        share = max(1, loops // len(claims) + (k < loops % len(claims)))
        rows.append(_row(name, rate, [job() for _ in range(share)]))
    return rows


def _row(name: str, rate: float | None, trials: list[Trial]) -> ClaimRow:
    worst = max(trials, key=lambda one: (one.grows, one.share))
    return ClaimRow(name, rate, len(trials), worst.share, worst.where, sum(one.above for one in trials))


def frozen_mu(stored: identify.StoredIdentification, certificates: dict) -> FrozenMu:
    """Find the largest mu of ``certificates`` over frozen speeds, and the largest optimum."""
    worst = worst_frozen(certificates)
    return FrozenMu(worst["mu_upper"], worst["v_mps"], *frozen_optimum(stored))


def rate_rows(trials: Trials) -> list[RateRow]:
    """Search the least violating rate for stability and for performance."""
    stated = trials.stated["moving_speed"]

    def grows(rate: float) -> bool:
        return fastest_growth(trials.stability, rate, trials.samples, trials.seed)[0] > 1

    search = Search(trials.performance, trials.samples, trials.seed)
    level = stated["performance"].get("level", 1.0)
    last: Found | None = None

    def exceeds(rate: float) -> bool:
        nonlocal last
        violation = search.at(rate, level, last)
        last = violation if violation.gain > level else last
        return violation.gain > level

    rows = []
    for claim, violates in (("stability", grows), ("performance", exceeds)):
        ladder = least_violating(violates, LARGEST_MPS2, SMALLEST_MPS2)
        proved = stated[claim]["rate_mps2"]
        rows.append(RateRow(claim, proved, ladder.rate, ladder.without, LARGEST_MPS2))
    return rows


def lines(claims: list[ClaimRow], frozen: FrozenMu, rates: list[RateRow]) -> Iterator[str]:
    """Write both tables as text, with the line between them."""
    yield f"{'proof':30}{'m/s2':>7}{'loops':>7}{'worst':>8}{'above':>7}  where the worst was found"
    for row in claims:
        rate = "-" if row.rate_mps2 is None else f"{row.rate_mps2:.3g}"
        yield f"{row.claim:30}{rate:>7}{row.loops:>7}{row.worst:>8.3f}{row.above:>7}  {row.where}"
    far = [row.claim for row in claims if row.worst < NEAR]
    above, loops = sum(row.above for row in claims), sum(row.loops for row in claims)
    yield f"{above} of {loops} loops are above what is proved"
    if far:
        yield f"further than {1 - NEAR:.0%} from the bound: {'; '.join(far)}"
    yield (
        f"frozen speed: mu at most {frozen.mu:.4f}, at {frozen.v_mps:.4g} m/s; of controllers for one speed "
        f"at most {frozen.optimum:.4f}, at {frozen.optimum_v_mps:.4g} m/s: "
        f"mu is {frozen.mu / frozen.optimum - 1:.1%} above it"
    )
    if rates:
        yield ""
        yield f"{'claim':14}{'proved m/s2':>12}{'violated m/s2':>15}{'none found at':>15}{'ratio':>8}"
    for one in rates:
        proved = "nothing" if one.proved_mps2 is None else f"{one.proved_mps2:.3g}"
        if one.ratio is None:
            yield f"{one.claim:14}{proved:>12}{'no violation found up to ' + format(one.tried_mps2, 'g'):>30}"
        else:
            short = "" if one.ratio >= WANTED else f"  below {WANTED:g}"
            yield (
                f"{one.claim:14}{proved:>12}{one.violating_mps2:>15.3g}{one.without_mps2:>15.3g}"
                f"{one.ratio:>8.2f}{short}"
            )


def as_dict(claims: list[ClaimRow], frozen: FrozenMu, rates: list[RateRow]) -> dict:
    """Numbers for ``--json``."""
    return {
        "claims": [asdict(row) for row in claims],
        "above": sum(row.above for row in claims),
        "frozen_mu": asdict(frozen),
        "rates": [asdict(row) | {"ratio": row.ratio} for row in rates],
        "wanted_ratio": WANTED,
    }
