"""Simulate lives of vehicles: how often a healthy vehicle ever alarms, and how soon a worn vehicle alarms.

The pool is synthetic: the compiled core of the shipped g80 runs drives of the synthetic car
(drives/fixture.py). Each drive has a random gain with mean 1, for load, tyres and road. Its output is also
scaled by each of GAINS. A life interpolates its scores between these gains. Each life draws its own
calibration set and its recordings from the pool, with replacement. The sets are ranked by the distance of
their true tails from the bounds of THEORY (T35). The worst twentieth of the sets is used for many further
lives.

A drifting life is first healthy for a number of recordings. Its gain then falls to 0.9 over the next hundred.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ...base.errors import InputError
from ...base.parallel import Map, workers
from ...base.rates import hourly_words, per_hour, rate, share_words
from ...drives.faults import Fault, inject
from ...drives.fixture import drive_columns
from ...drives.tables import Drive
from ...replay.replayer import Replayer
from ...replay.vehicle_core import replayer_for
from ...vehicle.project import load_project
from ..fleet.recordings import ALPHA, ETA, JUDGED_S
from ..fleet.scores import ScoredDrive
from ..fleet.wealth import POWERS, Life, LifeTable, alarm_wealth, factors, ranks, simultaneous_tails, stepped
from . import parser, require_at_least, show

VEHICLE = "g80"
GAINS = (1.0, 0.98, 0.96, 0.94, 0.92, 0.9)
DURATION_S = 110.0
SPEEDS_MPS = (5.0, 15.5)
SIZES = (11, 100)
DRIFT, LEAST_GAIN, STATED_GAIN, WITHIN = 100, 0.9, 0.92, 30
"""Number of recordings over which the gain falls, and its end value; gain and number of recordings that
define "found in time"."""
HEALTHY_BEFORE = (0, 500)
WORST = 0.05
AGAIN = 100
"""Number of further lives for each of the worst sets."""


@dataclass(frozen=True)
class Pool:
    """Scores of the pool, and the alarms of the core's own verdict meanwhile; each is (drives, gains)."""

    scores: np.ndarray
    alarmed: np.ndarray


def _drive_scores(replayer: Replayer, spread: float, seed: int, index: int) -> list[tuple[float, bool]]:
    """Compute the score and the alarm of a drive at each of GAINS."""
    random = np.random.default_rng([seed, index])
    own = 1.0 + spread * random.standard_normal()
    Ts = replayer.project.Ts_s
    columns, _ = drive_columns(random, random.uniform(*SPEEDS_MPS), DURATION_S, Ts, None)
    output, angle = columns["r"][:, None], columns["delta"][:, None]
    drive = Drive(f"pool_{index:04d}", columns["t"], columns["v"], angle, output)
    scores = []
    for gain in GAINS:
        faulty = inject(drive, Fault("gain", own * gain), 0.0, Ts)
        piece = ScoredDrive.from_drive(replayer, faulty, round(JUDGED_S / Ts))
        if len(piece.ratios) * Ts < JUDGED_S - Ts / 2:
            raise InputError("bench lives", drive.name, f"less than {JUDGED_S:g} s judged", "a longer drive")
        scores.append((float(piece.ratios.mean()), piece.alarmed))
    return scores


def make_pool(drives: int, spread: float, seed: int, run: Map = map) -> Pool:
    """Make a pool of drives whose gains have a standard deviation of ``spread``."""
    replayer = replayer_for(load_project(VEHICLE), None, VEHICLE)
    scores = list(run(partial(_drive_scores, replayer, spread, seed), range(drives)))
    table = np.array(scores, float)
    return Pool(table[..., 0].astype(np.float32), table[..., 1] > 0)


def first_alarms(
    levels: np.ndarray, bets: np.ndarray, scores: Callable[[int], np.ndarray], recordings: int
) -> np.ndarray:
    """Compute the first recording with an alarm (lives,), 0 for never, for many lives at once.

    ``levels`` (lives, K) belongs to the calibration set of each life. ``bets`` has the shape (K + 1, bets).
    ``scores(t)`` returns the scores (lives,) of recording t.
    """
    alarm = alarm_wealth(ALPHA)
    wealth, first = np.zeros((len(levels), len(POWERS)), np.float32), np.zeros(len(levels), int)
    for t in range(recordings):
        place = (scores(t)[:, None] > levels).sum(axis=1)
        wealth, whole = stepped(wealth, t, bets[place])
        first = np.where((first == 0) & (whole >= alarm), t + 1, first)
    return first


def drawn_levels(pool: Pool, n: int, sets: int, random: np.random.Generator) -> np.ndarray:
    """Draw calibration sets of n healthy scores, with replacement; return their levels (sets, K)."""
    chosen = random.choice(pool.scores[:, 0], (sets, n))
    return np.sort(chosen, axis=1)[:, ranks(n) - 1]


def healthy_lives(pool: Pool, n: int, lives: int, recordings: int, seed: int) -> dict:
    """Share of healthy lives that ever alarm, over fresh calibration sets and over the worst 5 % of them."""
    random = np.random.default_rng([seed, n])
    levels, tails = drawn_levels(pool, n, lives, random), simultaneous_tails(n, ETA)
    bets, healthy = factors(tails), pool.scores[:, 0]
    first = first_alarms(levels, bets, lambda _: random.choice(healthy, lives), recordings)
    hours = float(np.where(first > 0, first, recordings).sum()) * JUDGED_S / 3600
    true_tails = (healthy[None, None, :] > levels[:, :, None]).mean(axis=2)
    beyond = (true_tails / tails).max(axis=1)
    worst = np.argsort(-beyond, kind="stable")[: max(1, round(WORST * lives))]
    again = np.repeat(levels[worst], AGAIN, axis=0)
    repeated = first_alarms(again, bets, lambda _: random.choice(healthy, len(again)), recordings)
    of_set = (repeated.reshape(len(worst), AGAIN) > 0).mean(axis=1)
    table = LifeTable.from_scores(range(n), ALPHA, ETA)  # the earliest alarm does not depend on the scores
    return {
        "n": n,
        "ever": rate(int((first > 0).sum()), lives),
        "ever_per_1000_judged_h": per_hour(int((first > 0).sum()), hours / 1000),
        "outside": rate(int((beyond > 1).sum()), lives),
        "worst_sets": {"count": int((repeated > 0).sum()), "of": len(repeated)},
        "worst_set": float(of_set.max()),
        "largest_factor": float(bets.max()),
        "earliest": table.earliest(Life()),
    }


def drifting_lives(pool: Pool, n: int, healthy: int, lives: int, seed: int) -> dict:
    """Compute when drifting lives alarm; ``healthy`` recordings precede the drift."""
    random = np.random.default_rng([seed, n, healthy + 1])
    levels, bets = drawn_levels(pool, n, lives, random), factors(simultaneous_tails(n, ETA))

    def scores(t: int) -> np.ndarray:
        gain = 1.0 - (1.0 - LEAST_GAIN) * min(1.0, max(0, t + 1 - healthy) / DRIFT)
        at = (1.0 - gain) / (GAINS[0] - GAINS[1])
        low = min(int(at), len(GAINS) - 2)
        drive = random.integers(len(pool.scores), size=lives)
        share = np.float32(at - low)
        return (1 - share) * pool.scores[drive, low] + share * pool.scores[drive, low + 1]

    stated = healthy + round(DRIFT * (1.0 - STATED_GAIN) / (1.0 - LEAST_GAIN))
    first = first_alarms(levels, bets, scores, stated + WITHIN)
    true = first > healthy
    return {
        "n": n,
        "healthy_before": healthy,
        "in_time": rate(int(true.sum()), lives),
        "before_stated_gain": rate(int((true & (first <= stated)).sum()), lives),
        "false": rate(int(((first > 0) & ~true).sum()), lives),
        "median_after_drift": float(np.median(first[true] - healthy)) if true.any() else None,
    }


def bench_lives(pool: Pool, lives: int, recordings: int, seed: int) -> dict:
    """All numbers of the table."""
    return {
        "drives": len(pool.scores),
        "judged_s": JUDGED_S,
        "alpha": ALPHA,
        "eta": ETA,
        "recordings": recordings,
        "alarmed_alone": {
            f"{gain:g}": rate(int(a.sum()), len(a)) for gain, a in zip(GAINS, pool.alarmed.T, strict=True)
        },
        "healthy": [healthy_lives(pool, n, lives, recordings, seed) for n in SIZES],
        "drifting": [drifting_lives(pool, n, h, lives, seed) for n in SIZES for h in HEALTHY_BEFORE],
    }


def _share(share: dict) -> str:
    """Write a share without an interval, because the lives of one set are not independent."""
    return f"{share['count']} of {share['of']}, {100 * share['count'] / share['of']:.2f} %"


def words(r: dict) -> str:
    """The table."""
    lines = [
        f"pool: {r['drives']} core-run drives, {r['judged_s']:g} s judged each; alpha {r['alpha']:g}, "
        f"eta {r['eta']:g}; lives of {r['recordings']} recordings",
        "drives in which the core's own verdict alarms, by gain: "
        + "; ".join(f"{gain}: {share_words(a)}" for gain, a in r["alarmed_alone"].items()),
    ]
    for h in r["healthy"]:
        lines.append(
            f"n = {h['n']}: healthy lives that ever alarm {share_words(h['ever'])}, in 1000 judged "
            f"hours {hourly_words(h['ever_per_1000_judged_h'])}; sets outside the bounds "
            f"{share_words(h['outside'])}; lives of the worst 5 % of sets {_share(h['worst_sets'])}, of "
            f"the worst set {100 * h['worst_set']:.0f} %; a factor of {h['largest_factor']:.3g} at most, so "
            f"an alarm after {h['earliest']} recordings above all at the earliest"
        )
    for d in r["drifting"]:
        after = "–" if d["median_after_drift"] is None else f"{d['median_after_drift']:g}"
        lines.append(
            f"n = {d['n']}, gain to {LEAST_GAIN:g} after {d['healthy_before']} healthy recordings: found at "
            f"most {WITHIN} after {STATED_GAIN:g} {share_words(d['in_time'])}; before {STATED_GAIN:g} "
            f"{share_words(d['before_stated_gain'])}; median {after} after the drift began; false before it "
            f"{share_words(d['false'])}"
        )
    return "\n".join(lines)


def main(argv: list[str]) -> None:
    """Run `lpvguard bench lives`."""
    arguments = parser("lives", __doc__)
    arguments.add_argument("--drives", type=int, default=300, help="core-run drives of the pool")
    arguments.add_argument(
        "--lives", type=int, default=10_000, help="lives, each with a fresh calibration set"
    )
    arguments.add_argument("--recordings", type=int, default=1000, help="of a healthy life")
    arguments.add_argument(
        "--spread", type=float, default=0.03, help="standard deviation of the drives' own gains"
    )
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--jobs", type=int, default=1, help="processes that share the drives of the pool")
    options = arguments.parse_args(argv)
    require_at_least("lives", options, drives=1, lives=1, recordings=1, jobs=1)
    with workers(options.jobs) as run:
        pool = make_pool(options.drives, options.spread, options.seed, run)
    result = bench_lives(pool, options.lives, options.recordings, options.seed) | {"spread": options.spread}
    show(words(result), result, options.json_out)
