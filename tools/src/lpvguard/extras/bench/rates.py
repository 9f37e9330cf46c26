"""Compare promised and counted alarm rates by extrapolation, for fleets with a known tail (THEORY 7.20).

A fleet has recordings of 15 minutes: 30 blocks of 30 s with one score each. Its tail is fitted as by
`identify` with ``alarms_per_1000_h``. The bench counts the exceedances of the threshold in fresh hours of the
same fleet. The scores of a family are exponential, Pareto (shape 0.25) or bounded (shape -0.25). In the
family "differing", each recording is exponential with its own scale, and all recordings together are Pareto
with shape 0.25. In the family "clusters", every score lasts two blocks.

"Covered" is the share of fleets whose true rate lies within the 95 % interval. "Kept" is the share whose true
rate is at most the promised one if the threshold is the upper end (``rate_confidence``).
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from ...base.parallel import workers
from ...base.rates import rate as share_of
from ...base.rates import share_words
from ...base.tails import Peaks, Tail
from . import numbers_of, parser, require_at_least, show

BLOCKS_PER_H, RECORDING_H, SHAPE = 120, 0.25, 0.25
RATES_PER_1000_H = (10.0, 1.0, 0.1)
BLOCKS = round(BLOCKS_PER_H * RECORDING_H)


def _exponential(random: np.random.Generator, recordings: int, n: int) -> np.ndarray:
    return random.exponential(size=(recordings, n))


def _pareto(shape: float, random: np.random.Generator, recordings: int, n: int) -> np.ndarray:
    return np.expm1(shape * random.exponential(size=(recordings, n))) / shape


def _differing(random: np.random.Generator, recordings: int, n: int) -> np.ndarray:
    scale = 1 / (SHAPE * random.gamma(1 / SHAPE, size=(recordings, 1)))
    return scale * random.exponential(size=(recordings, n))


def _clusters(random: np.random.Generator, recordings: int, n: int) -> np.ndarray:
    x = random.exponential(size=(recordings, n + 1))
    return np.maximum(x[:, 1:], x[:, :-1])


FAMILIES: dict[str, tuple[Callable[[np.random.Generator, int, int], np.ndarray], float]] = {
    "exponential": (_exponential, 0.0),
    "pareto": (partial(_pareto, SHAPE), SHAPE),
    "bounded": (partial(_pareto, -SHAPE), -SHAPE),
    "differing": (_differing, SHAPE),
    "clusters": (_clusters, 0.0),
}
"""By family: function that draws scores (recordings, n), and the shape of their tail with scale 1."""


def true_rate(shape: float, threshold: float) -> float:
    """Compute the true number of exceedances of a threshold per hour."""
    if shape == 0:
        return BLOCKS_PER_H * float(np.exp(-threshold))
    return BLOCKS_PER_H * max(0.0, 1 + shape * threshold) ** (-1 / shape)


def _fleet(family: str, hours: float, fresh: np.ndarray, seed: int, index: int) -> list[dict[str, float]]:
    """Compute the results of a fleet for every rate; ``fresh`` holds the sorted peaks of other hours."""
    draw, shape = FAMILIES[family]
    scores = draw(np.random.default_rng([seed, index, round(hours)]), round(hours / RECORDING_H), BLOCKS)
    names = [str(i) for i in range(len(scores))]
    peaks = Peaks.from_maxima(
        {n: [x] for n, x in zip(names, scores, strict=True)}, dict.fromkeys(names, RECORDING_H)
    )
    assert peaks is not None
    tail, results = Tail.fitted(peaks), []
    for rate in (r / 1000 for r in RATES_PER_1000_H):
        z, safe = tail.threshold(rate), tail.confident_threshold(rate)
        low, high = tail.interval(z)
        true = true_rate(shape, z)
        results.append(
            {
                "counted": float(len(fresh) - np.searchsorted(fresh, z, side="right")),
                "true": true,
                "covered": float(low <= true <= high),
                "kept": float(true_rate(shape, safe) <= rate),
                "interval": high / max(low, 1e-9),
            }
        )
    return results


def bench_rates(fleets: int, hours: list[float], fresh_h: float, seed: int, jobs: int) -> dict[str, Any]:
    """Compute all numbers of the table."""
    rows = []
    for number, (family, (draw, _)) in enumerate(FAMILIES.items()):
        random = np.random.default_rng([seed, 10**6 + number])
        other = draw(random, round(fresh_h / RECORDING_H), BLOCKS)
        if family == "clusters":
            other = other[:, ::2]  # each score counts once
        fresh = np.sort(other.ravel())[-round(fresh_h) :]
        for h in hours:
            with workers(jobs) as run:
                by_fleet = list(run(partial(_fleet, family, h, fresh, seed + number), range(fleets)))
            for i, promised in enumerate(RATES_PER_1000_H):
                at_rate = [f[i] for f in by_fleet]
                counted = np.array([f["counted"] for f in at_rate]) / fresh_h * 1000
                rows.append(
                    {
                        "family": family,
                        "hours": h,
                        "promised_per_1000_h": promised,
                        "counted_per_1000_h": [float(q) for q in np.quantile(counted, (0.05, 0.5, 0.95))],
                        "true_per_1000_h": 1000 * float(np.median([f["true"] for f in at_rate])),
                        "covered": share_of(int(sum(f["covered"] for f in at_rate)), fleets),
                        "kept": share_of(int(sum(f["kept"] for f in at_rate)), fleets),
                    }
                )
    return {"fleets": fleets, "fresh_h": fresh_h, "rows": rows}


def words(result: dict[str, Any]) -> str:
    """Write the table."""
    lines = [
        f"{result['fleets']} fleets a row, counted on {result['fresh_h']:g} fresh hours",
        "family       hours  promised  counted per 1000 h: 5 %, median, 95 %   covered; kept",
    ]
    for r in result["rows"]:
        low, middle, high = r["counted_per_1000_h"]
        lines.append(
            f"{r['family']:<12} {r['hours']:>5g}  {r['promised_per_1000_h']:>8g}  {low:>10.3g} "
            f"{middle:>10.3g} {high:>10.3g}             {share_words(r['covered'])}; {share_words(r['kept'])}"
        )
    return "\n".join(lines)


def main(argv: list[str]) -> None:
    """Run `lpvguard bench rates`."""
    arguments = parser("rates", __doc__)
    arguments.add_argument("--fleets", type=int, default=100, help="fleets of each family and size")
    arguments.add_argument("--hours", default="10,100", help="hours of a fleet, comma between")
    arguments.add_argument("--fresh", type=float, default=20_000.0, help="hours on which alarms are counted")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--jobs", type=int, default=1, help="processes that share the fleets")
    options = arguments.parse_args(argv)
    require_at_least("rates", options, fleets=1, fresh=1, jobs=1)
    hours = numbers_of("rates", "--hours", options.hours, lambda h: h >= 1, "hours from 1 on")
    result = bench_rates(options.fleets, hours, options.fresh, options.seed, options.jobs)
    show(words(result), result, options.json_out)
