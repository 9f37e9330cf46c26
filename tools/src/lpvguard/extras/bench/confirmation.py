"""Cost and benefit of confirmation: k of the last m frames must exceed the threshold (THEORY 7.20).

A fleet has frames of 10 s, of the families of ``bench rates``. For every design k of m the tail of the k-th
largest of the last m scores gives the threshold at a promised rate. Counted are the alarms on fresh hours of
the same fleet. A fault raises every score by the same amount. Its least size is stated that 95 % of drives
find within a delay, as a share of the threshold of a single frame. A target of rate and delay chooses the
design of the least size.
"""

from functools import partial
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ...base.parallel import workers
from ...base.rates import rate as share
from ...base.rates import share_words
from ...base.tails import Peaks, Tail, separate
from . import numbers_of, parser, require_at_least, show
from .rates import BLOCKS, FAMILIES, RATES_PER_1000_H, RECORDING_H

FRAMES, FRAME_S = 3, 10.0
"""Frames of a block of 30 s, and their length."""
DESIGNS = ((1, 1), (2, 2), (2, 3), (2, 6), (3, 3), (3, 6))
"""Designs k of m."""
FOUND = 0.95
"""Share of the drives that find a fault of the stated size."""
SEARCHED = 2000
"""Drives of which a fault is found or not."""


def confirmed(scores: np.ndarray, k: int, m: int) -> np.ndarray:
    """k-th largest of the last m scores (recordings, n) along each recording, -inf where there are fewer."""
    padded = np.pad(scores, ((0, 0), (m - 1, 0)), constant_values=-np.inf)
    return np.partition(sliding_window_view(padded, m, axis=1), m - k, axis=2)[..., m - k]


def least_found(noise: np.ndarray, threshold: float, k: int, m: int) -> float:
    """Size that FOUND of the drives find with their first frames of a fault, whose noise is (drives, n)."""
    largest = confirmed(noise, k, m).max(axis=1)
    return threshold - float(np.quantile(largest, 1 - FOUND, method="lower"))


def _scores(family: str, seed: list[int], recordings: int) -> np.ndarray:
    return FAMILIES[family][0](np.random.default_rng(seed), recordings, FRAMES * BLOCKS)


def _design(
    family: str, hours: float, fresh_h: float, delays: list[float], seed: int, design: tuple[int, int]
) -> list[dict[str, Any]]:
    """Results of a design at every rate."""
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
    """All numbers of the table."""
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
    return {"hours": hours, "fresh_h": fresh_h, "inside": inside, "rows": rows}


def words(result: dict[str, Any]) -> str:
    """The table."""
    delays = list(result["rows"][0]["least"])
    lines = [
        f"thresholds from {result['hours']:g} hours, counted on {result['fresh_h']:g} fresh ones",
        "family       k of m  promised  counted per 1000 h (interval)       least fault found within "
        + ", ".join(f"{d} s" for d in delays),
    ]
    for r in result["rows"]:
        low, high = r["interval_per_1000_h"]
        k, m = r["design"]
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
            f"{r['family']:<12} {k} of {m}  {r['promised_per_1000_h']:>8g}  {r['counted_per_1000_h']:>8.3g} "
            f"({low:.2g} to {high:.2g})".ljust(66)
            + "".join(sizes)
        )
    lines += [
        "*: the design that a target of this rate and delay chooses",
        f"counted within the interval: {share_words(result['inside'])}",
    ]
    return "\n".join(lines)


def main(argv: list[str]) -> None:
    """`lpvguard bench confirmation`."""
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
