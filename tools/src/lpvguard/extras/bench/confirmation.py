"""Cost and benefit of confirmation: k of the last m frames must exceed the threshold (THEORY 7.20).

A fleet has frames of 10 s, from the families of ``bench rates``. A design k of m alarms by the k-th largest
of the last m scores. The tail of this score gives the threshold for a promised rate. The bench counts the
alarms in fresh hours of the same fleet. A fault raises every score by the same amount. The table states the
least size that 95 % of the drives detect within a delay, as a share of the threshold of a single frame. For
each target of rate and delay, the bench marks the design with the least size.
"""

from functools import partial
from typing import Any

import numpy as np

from ...base.parallel import workers
from ...base.rates import rate as share
from ...base.rates import share_words
from ...base.tails import Peaks, Tail, separate
from ...identify.confirmation import DESIGNS, confirmed, design_words
from . import numbers_of, parser, require_at_least, show
from .rates import BLOCKS, FAMILIES, RATES_PER_1000_H, RECORDING_H

FRAMES, FRAME_S = 3, 10.0
"""Number of frames in a block of 30 s, and length of a frame."""
FOUND = 0.95
"""Share of the drives that must detect a fault of the stated size."""
SEARCHED = 2000
"""Number of drives with a fault."""


def least_found(noise: np.ndarray, threshold: float, k: int, m: int) -> float:
    """Least size of a fault that the share FOUND of the drives detects in its first n frames.

    ``noise`` (drives, n) holds the scores of these frames without the fault.
    """
    largest = confirmed(noise, k, m).max(axis=1)
    return threshold - float(np.quantile(largest, 1 - FOUND, method="lower"))


def _scores(family: str, seed: list[int], recordings: int) -> np.ndarray:
    return FAMILIES[family][0](np.random.default_rng(seed), recordings, FRAMES * BLOCKS)


def _design(
    family: str, hours: float, fresh_h: float, delays: list[float], seed: int, design: tuple[int, int]
) -> list[dict[str, Any]]:
    """Compute the results of a design for every rate."""
    number = list(FAMILIES).index(family)
    maxima, faulty = [], _scores(family, [seed, number, 3], SEARCHED)
    for part, h in enumerate((hours, fresh_h)):
        scores = confirmed(_scores(family, [seed, number, part], round(h / RECORDING_H)), *design)
        maxima.append(np.maximum(scores, 0.0).reshape(-1, BLOCKS, FRAMES).max(axis=2))
    blocks = {str(i): [x] for i, x in enumerate(maxima[0])}
    peaks = Peaks.from_maxima(blocks, dict.fromkeys(blocks, RECORDING_H))
    assert peaks is not None
    tail, rows = Tail.fitted(peaks), []
    for rate in RATES_PER_1000_H:
        z = tail.threshold(rate / 1000)
        low, high = tail.interval(z)
        over = maxima[1][(maxima[1] > z).any(axis=1)]
        counted = sum(peak > z for x in over for peak in separate(x)) / fresh_h
        least = {d: least_found(faulty[:, : int(d / FRAME_S)], z, *design) for d in delays}
        rows.append(
            {
                "family": family,
                "design": list(design),
                "promised_per_1000_h": rate,
                "threshold": z,
                "interval_per_1000_h": [1000 * low, 1000 * high],
                "counted_per_1000_h": 1000 * counted,
                "inside": bool(low <= counted <= high),
                "least": least,
            }
        )
    return rows


def bench_confirmation(
    hours: float, fresh_h: float, delays: list[float], seed: int, jobs: int
) -> dict[str, Any]:
    """Compute all numbers of the table."""
    rows: list[dict[str, Any]] = []
    for family in FAMILIES:
        with workers(jobs) as run:
            judge = partial(_design, family, hours, fresh_h, delays, seed)
            by_design = list(run(judge, DESIGNS))
        for same_rate in zip(*by_design, strict=True):
            single = same_rate[0]["threshold"]
            for row in same_rate:
                row["least"] = {f"{d:g}": size / single for d, size in row["least"].items()}
            rows += same_rate
    inside = share(sum(r["inside"] for r in rows), len(rows))
    chosen = [
        min(rows[i : i + len(DESIGNS)], key=lambda r: r["least"][f"{d:g}"])
        for i in range(0, len(rows), len(DESIGNS))
        for d in delays
    ]
    inside_chosen = share(sum(r["inside"] for r in chosen), len(chosen))
    return {"hours": hours, "fresh_h": fresh_h, "inside": inside, "chosen": inside_chosen, "rows": rows}


def words(result: dict[str, Any]) -> str:
    """Write the table."""
    delays = list(result["rows"][0]["least"])
    lines = [
        f"thresholds from {result['hours']:g} hours, counted on {result['fresh_h']:g} fresh ones",
        "family       k of m  promised  counted per 1000 h (interval)       least fault found within "
        + ", ".join(f"{d} s" for d in delays),
    ]
    for r in result["rows"]:
        low, high = r["interval_per_1000_h"]
        same = [
            x
            for x in result["rows"]
            if (x["family"], x["promised_per_1000_h"]) == (r["family"], r["promised_per_1000_h"])
        ]
        sizes = []
        for d in delays:
            best = min(x["least"][d] for x in same)
            size = r["least"][d]
            sizes.append(f"{size:6.2f}" if np.isfinite(size) else f"{'–':>6}")
            sizes[-1] += "*" if size == best else " "
        lines.append(
            f"{r['family']:<12} {design_words(r['design'])}  {r['promised_per_1000_h']:>8g}  "
            f"{r['counted_per_1000_h']:>8.3g} ({low:.2g} to {high:.2g})".ljust(66)
            + "".join(sizes)
        )
    lines += [
        "*: the design that a target of this rate and delay chooses; of these counted within the interval: "
        f"{share_words(result['chosen'])}",
        f"counted within the interval: {share_words(result['inside'])}",
    ]
    return "\n".join(lines)


def main(argv: list[str]) -> None:
    """Run `lpvguard bench confirmation`."""
    arguments = parser("confirmation", __doc__)
    arguments.add_argument("--hours", type=float, default=30.0, help="hours that set the thresholds")
    arguments.add_argument("--fresh", type=float, default=20_000.0, help="hours on which alarms are counted")
    arguments.add_argument("--delays", default="10,30,60,120", help="s, comma between")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--jobs", type=int, default=1, help="processes that share the designs")
    options = arguments.parse_args(argv)
    require_at_least("confirmation", options, hours=3, fresh=1, jobs=1)
    limits = (FRAME_S, 3600 * RECORDING_H)
    delays = numbers_of(
        "confirmation", "--delays", options.delays, lambda d: limits[0] <= d <= limits[1], "10 to 900 s"
    )
    result = bench_confirmation(options.hours, options.fresh, delays, options.seed, options.jobs)
    show(words(result), result, options.json_out)
