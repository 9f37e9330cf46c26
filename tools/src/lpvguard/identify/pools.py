"""Pools of frames: sums of the error that the input explains (THEORY 7.17; lib/include/lpvguard/monitor.h).

The error of a pool is ``|sum of conj(Z) E| / sqrt(P)`` with P = sum of |Z|^2. It may reach the larger of B
and W sqrt(P). W is chosen on the drives that set the bounds. The remainder of a pool is its error where that
exceeds W sqrt(P), else 0. B is the largest remainder of all drives, those that calibrate included. The
scheduling range has parts with bounds of their own. The score of a drive is its largest remainder over the
bound of all other recordings. Without a recording every bound is at most what is exported. A further
exchangeable recording therefore exceeds the threshold of these scores with probability at most alpha (T52).
No drive is spent.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..base.layout import constant
from ..base.sampling import Rows, first_of_each, largest_of_each, row_hash, stacked
from ..drives.frames import Estimator
from ..drives.tables import Experiment
from ..vehicle.project import Project
from .bounds import FrameSet
from .calibration import Calibration, RateTarget, Recordings, block_of, calibrate
from .healthy import CANDIDATES, TYPICAL
from .limit import LimitSums
from .visibility import SAMPLED_FRAMES, SPEED_CELLS, Excitation, speed_cell

SAMPLED = 750
"""Pools a bin and part of the speed range from which typical excitation is read."""
SPEEDS = constant("NSPEEDS", {})
"""Parts of the scheduling range with bounds of their own."""
REACH = 0.1
"""Share of the scheduling range by which drives beyond a part's ends also set its bounds."""
FEWEST_OF_SPEED = 20
"""Fewest bound-setting recordings of bounds at a speed: one more exceeds the largest of 20 in 5 % of cases.
With fewer the bounds are those of all speeds."""


@dataclass(frozen=True)
class PoolSizes:
    """Number of parts of a pool (K,), and of frames of a part (K,), for each bin."""

    parts: np.ndarray
    frames: np.ndarray

    @classmethod
    def for_project(cls, project: Project, estimator: Estimator) -> PoolSizes:
        """Sizes of pools that fit into the required time to detect a fault, at least one frame."""
        length, hop = estimator.length * project.Ts_s, estimator.hop * project.Ts_s
        room = np.floor((project.evaluation.found_within_s - length) / hop + 1e-9).astype(int) + 1
        parts = np.clip(room, 1, constant("NPOOL", {"NY": project.n_y}))
        return cls(parts, np.maximum(room, 1) // parts)

    def counts(self, k: int) -> range:
        """Possible numbers of frames in a pool of bin k after all its parts are in use."""
        parts, frames = int(self.parts[k]), int(self.frames[k])
        return range((parts - 1) * frames + 1, parts * frames + 1)


def pooled(
    s: FrameSet, estimator: Estimator, counts: Iterable[int]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the pools of the last n frames that end with each frame of ``s``, for every n of ``counts``.

    Each result is |sum of conj(Z) E| / sqrt(P) and sqrt(P), both (F, n_y) [output units]. Only counted frames
    are summed.
    """
    hop = int(estimator.hop[s.bin])
    rows = int(s.starts[-1]) // hop + 1
    products = np.zeros((rows * hop, 2 * s.E.shape[1]), complex)
    products[s.starts] = np.hstack([s.Z.conj() * s.E, np.abs(s.Z) ** 2])
    sums = np.cumsum(products.reshape(rows, hop, -1), axis=0)
    for n in counts:
        window = sums.copy()
        window[n:] -= sums[:-n]
        along, power = np.hsplit(window.reshape(rows * hop, -1)[s.starts], 2)
        size = np.sqrt(np.maximum(power.real, 0.0))
        yield np.abs(np.divide(along, size, out=np.zeros_like(along), where=size > 0)), size


def speeds_of(s: FrameSet, way: np.ndarray, estimator: Estimator) -> tuple[np.ndarray, np.ndarray]:
    """Mean speed [m/s] of F frames, and their part of the scheduling range, each (F,).

    ``way`` (N + 1,) has the sums of the drive's speed. The part is that of the core.
    """
    length, (low, high) = estimator.length[s.bin], estimator.speed_range
    mean = (way[s.starts + length] - way[s.starts]) / length
    edges = low + np.arange(1, SPEEDS) * ((high - low) / SPEEDS)
    return mean, np.searchsorted(edges, mean, side="right")


def reached(speed: np.ndarray, speed_range: tuple[float, float]) -> np.ndarray:
    """Which frames (SPEEDS + 1, F) of speeds (F,) [m/s] set the bounds of a part; last, of all speeds."""
    low, high = speed_range
    part, reach = (high - low) / SPEEDS, REACH * (high - low)
    begin = low + part * np.arange(SPEEDS)[:, None]
    within = (speed >= begin - reach) & (speed <= begin + part + reach)
    return np.vstack([within, np.ones(len(speed), bool)])


@dataclass(frozen=True)
class PoolNeeds:
    """Largest remainders of drives for each of P CANDIDATES of W, and a sample of their pools.

    ``largest`` is (SPEEDS + 1, K, P, n_y) [output units], the last for all speeds. ``seen`` has the bins
    (SPEEDS + 1, K) with frames by recording. ``sample`` has the columns ``group`` (part * K + bin), ``hash``
    and ``size`` (F, n_y), sqrt(P).
    """

    largest: np.ndarray
    seen: dict[str, np.ndarray]
    sample: Rows

    @classmethod
    def joined(cls, parts: Iterable[PoolNeeds]) -> PoolNeeds:
        """Needs of all drives together."""
        total: PoolNeeds | None = None
        for part in parts:
            if total is None:
                total = part
                continue
            new = {r: total.seen.get(r, False) | bins for r, bins in part.seen.items()}
            sample = first_of_each(stacked([total.sample, part.sample]), SAMPLED)
            total = cls(np.maximum(total.largest, part.largest), total.seen | new, sample)
        assert total is not None
        return total


def needs_of(
    e: Experiment, frames: Iterable[FrameSet], v: np.ndarray, estimator: Estimator, sizes: PoolSizes, n_y: int
) -> PoolNeeds:
    """Return what the frames of a drive with the speed ``v`` (N,) [m/s] need as bounds."""
    K, way = estimator.n_bins, np.concatenate([[0.0], np.cumsum(v)])
    largest = np.zeros((SPEEDS + 1, K, len(CANDIDATES), n_y))
    seen = np.zeros((SPEEDS + 1, K), bool)
    rows = [{"group": np.zeros(0, int), "hash": np.zeros(0, np.uint64), "size": np.zeros((0, n_y))}]
    for s in frames:
        if not len(s.E):
            continue
        inside = reached(speeds_of(s, way, estimator)[0], estimator.speed_range)
        for along, size in pooled(s, estimator, sizes.counts(s.bin)[-1:]):
            for at in np.flatnonzero(inside.any(axis=1)):
                seen[at, s.bin] = True
                error, reach = along[inside[at]], size[inside[at]]
                for p, W in enumerate(CANDIDATES):
                    largest[at, s.bin, p] = remainder(error, reach, W).max(axis=0)
                on_grid = np.flatnonzero(inside[at] & (s.starts % estimator.hop[s.bin] == 0))
                group = np.full(len(on_grid), at * K + s.bin)
                hashes = row_hash(e.name, group % K, s.starts[on_grid])
                rows.append({"group": group, "hash": hashes, "size": size[on_grid]})
    return PoolNeeds(largest, {e.recording: seen}, first_of_each(stacked(rows), SAMPLED))


def remainder(along: np.ndarray, size: np.ndarray, W: np.ndarray | float) -> np.ndarray:
    """Errors of pools (F, n_y) beyond W times their ``size``, else 0."""
    return np.where(along > W * size, along, 0.0)


@dataclass(frozen=True)
class Remainders:
    """Largest remainders of drives, and samples of their pools.

    ``largest`` is (SPEEDS, K, n_y) [output units], of the frames that set the bounds. ``blocks`` (b, SPEEDS,
    K, n_y) has those at a part's speeds alone, in blocks of one drive. Rows have ``group`` (speed cell * K +
    bin), ``part`` of the scheduling range, ``hash`` and ``size`` (F, n_y), sqrt(P). ``strongest`` has those
    of the largest size in each output. ``sums`` are those of the limit of detection.
    """

    largest: np.ndarray
    strongest: Rows
    sample: Rows
    sums: LimitSums
    blocks: np.ndarray | None = None

    @classmethod
    def of_rows(
        cls,
        largest: np.ndarray,
        strongest: Rows,
        sample: Rows,
        sums: LimitSums,
        blocks: np.ndarray | None = None,
    ) -> Remainders:
        """Remainders with samples of the given rows."""
        best = stacked(largest_of_each(strongest, column) for column in strongest["size"].T)
        return cls(largest, best, first_of_each(sample, SAMPLED_FRAMES), sums, blocks)

    @classmethod
    def joined(cls, parts: Iterable[Remainders]) -> Remainders:
        """Remainders of all drives together."""
        parts = list(parts)
        return cls.of_rows(
            np.max([p.largest for p in parts], axis=0),
            stacked(p.strongest for p in parts),
            stacked(p.sample for p in parts),
            LimitSums.joined(p.sums for p in parts),
        )

    def excitation(self, W: np.ndarray, B: np.ndarray, quantile: float) -> Excitation:
        """Excitation of the pools by what a vehicle without response would show.

        W and B (SPEEDS, K, n_y) are the bounds.

        ``limit`` is the gain error that a test with full knowledge of the vehicle could see (T55).
        """

        def shown(rows: Rows) -> Rows:
            cell, k = np.divmod(rows["group"], W.shape[1])
            with np.errstate(divide="ignore"):
                seen = np.maximum(W[rows["part"], k], B[rows["part"], k] / rows["size"])
            return {
                "group": rows["group"],
                "hash": rows["hash"],
                "dead": 1 / seen.min(axis=1),
                "size": np.linalg.norm(rows["size"], axis=1),
                "limit": self.sums.gain_error(quantile, cell, k, rows["size"]),
            }

        return Excitation.of_rows(
            np.zeros((SPEED_CELLS, W.shape[1]), int), shown(self.strongest), shown(self.sample)
        )


def remainders_of(
    e: Experiment,
    frames: Iterable[FrameSet],
    v: np.ndarray,
    estimator: Estimator,
    sizes: PoolSizes,
    W: np.ndarray,
    own: np.ndarray,
) -> Remainders:
    """Return the remainders beside ``W`` (SPEEDS, K, n_y) of a drive with the speed ``v`` (N,) [m/s].

    ``own`` (SPEEDS, K) says where bounds are those of a part's speeds, not of all.
    """
    (_, K, n_y), Ts, way = W.shape, estimator.Ts, np.concatenate([[0.0], np.cumsum(v)])
    largest = np.zeros(W.shape)
    blocks = np.zeros((int(block_of(len(v) * Ts)) + 1, *W.shape))
    met: list[tuple[np.ndarray, FrameSet]] = []
    nothing = np.zeros(0, int)
    rows = [{"group": nothing, "part": nothing, "hash": np.zeros(0, np.uint64), "size": np.zeros((0, n_y))}]
    for s in frames:
        if not len(s.E):
            continue
        speed, part = speeds_of(s, way, estimator)
        inside = reached(speed, estimator.speed_range)[:SPEEDS] | ~own[:, s.bin, None]
        block = block_of((s.starts + estimator.length[s.bin]) * Ts)
        for first, (along, size) in enumerate(pooled(s, estimator, sizes.counts(s.bin))):
            for at in np.flatnonzero(inside.any(axis=1)):
                rest = remainder(along, size, W[at, s.bin])
                largest[at, s.bin] = np.maximum(largest[at, s.bin], rest[inside[at]].max(axis=0))
                np.maximum.at(blocks[:, at, s.bin], block[part == at], rest[part == at])
            if first == 0:
                on_grid = s.starts % estimator.hop[s.bin] == 0
                start = s.starts[on_grid]
                cell = speed_cell(estimator.speed_range, speed[on_grid])
                hashes = row_hash(e.name, np.full(len(start), s.bin), start)
                group = cell * K + s.bin
                rows.append({"group": group, "part": part[on_grid], "hash": hashes, "size": size[on_grid]})
                met.append((cell, replace(s, E=s.E[on_grid], Z=s.Z[on_grid], starts=start)))
    every = stacked(rows)
    sums = LimitSums.from_frames(met, (SPEED_CELLS, K, n_y))
    return Remainders.of_rows(largest, every, every, sums, blocks)


@dataclass(frozen=True)
class Pools:
    """Bounds of pools of frames, and the remainders behind them.

    Attributes
    ----------
    sizes : PoolSizes
    W : ndarray (SPEEDS, K, n_y), share of |yhat| that a pool allows for
    floor : ndarray (SPEEDS, K, n_y), least bound [output units]; infinite where the pool is silent
    own : ndarray (SPEEDS, K), whether the bounds are those of a part's speeds, not of all
    needs : dict, largest remainders (SPEEDS, K, n_y) by recording [output units]
    shown : dict, the same of the pools at a part's speeds alone, which the core compares
    calibration : Calibration, of the calibration drives' scores
    unit : float, ratio of a remainder that equals its bound, default 1
    blocks : dict, ``shown`` (b, SPEEDS, K, n_y) in blocks by calibration drive; empty without a rate
    """

    sizes: PoolSizes
    W: np.ndarray
    floor: np.ndarray
    own: np.ndarray
    needs: dict[str, np.ndarray]
    shown: dict[str, np.ndarray]
    calibration: Calibration
    unit: float = 1.0
    blocks: dict[str, np.ndarray] = field(default_factory=dict)

    @cached_property
    def _table(self) -> np.ndarray:
        return np.array(list(self.needs.values())).reshape(len(self.needs), *self.W.shape)

    def bound(self, without: str | None = None) -> np.ndarray:
        """Bounds B (SPEEDS, K, n_y) [output units] of all recordings but ``without``."""
        chosen = [x for n, x in self.needs.items() if n != without]
        return np.maximum(self.floor, np.max(chosen, axis=0, initial=0.0)) if chosen else self.floor

    def scale(self, without: str | None = None) -> np.ndarray:
        """Unit over B and over W (SPEEDS, K, 2, n_y); over B it is 0 where the pool is silent."""
        return self.unit / np.stack([self.bound(without), self.W], axis=2)

    def beside(self, threshold: float, own: float) -> Pools:
        """Scale the pools' ratios so that their threshold ``own`` becomes the ``threshold`` of frames."""
        return replace(self, unit=threshold / own)

    def ratios(self, without: str | None = None) -> dict[str, float]:
        """Largest ratio of a remainder to the bound of all others, for every recording except ``without``."""
        bounds = self._bounds_of_others(without)
        return {n: float((self.shown[n] / bound).max()) for n, bound in bounds.items()}

    def _bounds_of_others(self, without: str | None) -> dict[str, np.ndarray]:
        """Bound (SPEEDS, K, n_y) of all others for every recording but ``without``."""
        kept = [i for i, n in enumerate(self.needs) if n != without]
        names, table = list(self.needs), self._table[kept]
        if not kept:
            return {}
        order = np.argsort(table, axis=0)
        most = np.take_along_axis(table, order[-1:], axis=0)[0]
        next_most = np.take_along_axis(table, order[-2:-1], axis=0)[0] if len(kept) > 1 else 0 * most
        others = np.where(np.arange(len(kept))[:, None, None, None] == order[-1], next_most, most)
        bounds = np.maximum(others, self.floor)
        return {names[i]: bounds[row] for row, i in enumerate(kept)}

    def calibrated(
        self, drives: Iterable[str], alpha: float, recordings: Recordings, target: RateTarget | None = None
    ) -> Pools:
        """The pools with the threshold from the scores of calibration drives.

        ``target`` does not need maxima.
        """
        ratio = self.ratios()
        scores = {d: ratio[recordings.named(d)] for d in drives}
        if target is not None:
            target = replace(target, maxima=self.maxima(recordings))
        return replace(self, calibration=calibrate(scores, alpha, recordings=recordings, target=target))

    def maxima(self, recordings: Recordings, without: str | None = None) -> dict[str, list[float]]:
        """Largest ratio in each block of every drive, except drives of the recording ``without``."""
        bounds = self._bounds_of_others(without)
        named = {d: recordings.named(d) for d in self.blocks}
        return {
            d: (x / bounds[named[d]]).max(axis=(1, 2, 3)).tolist()
            for d, x in self.blocks.items()
            if named[d] in bounds
        }

    def target(self, without: str | None = None) -> RateTarget | None:
        """Target rate, if any. The recording of the drive ``without`` is left out."""
        c = self.calibration
        if c.target is None or without is None:
            return c.target
        return replace(c.target, maxima=self.maxima(c.recordings, c.recordings.named(without)))

    def scores(self, without: str | None = None) -> dict[str, float]:
        """Score of every calibration drive. The recording of the drive ``without`` is left out."""
        named = self.calibration.recordings.named
        out = None if without is None else named(without)
        ratio = self.ratios(out)
        return {d: ratio[named(d)] for d in self.calibration.scores if named(d) != out}

    def coefficients(self) -> tuple[dict[str, int], dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Sizes, whole numbers and real numbers of the pools for coeff.h."""
        words = {"pool_parts": self.sizes.parts, "pool_frames": self.sizes.frames}
        return {}, words, {"pool_scale": self.scale()}

    def speeds_text(self) -> str:
        """State in words how many bounds come from a part's speeds and how many from all speeds."""
        own, parts = int(self.own.sum()), self.own.size
        text = f"pools: bounds of their own speeds in {own} of {parts} parts of the speed range and bins"
        few = f"; fewer than {FEWEST_OF_SPEED} recordings set the others, which have those of all speeds"
        return text if own == parts else text + few

    def to_dict(self) -> dict:
        """Convert to JSON types, for `from_dict`."""
        return {
            "parts": self.sizes.parts,
            "frames": self.sizes.frames,
            "W": self.W,
            "floor": np.where(np.isinf(self.floor), np.nan, self.floor),
            "own": self.own,
            "needs": self.needs,
            "shown": self.shown,
            **({"blocks": self.blocks} if self.blocks else {}),
            "calibration": self.calibration.to_dict(),
        }

    @classmethod
    def from_dict(cls, data: dict) -> Pools:
        """Pools from the result of `to_dict`."""
        floor = np.array(data["floor"], float)
        return cls(
            PoolSizes(np.array(data["parts"], int), np.array(data["frames"], int)),
            np.array(data["W"], float),
            np.where(np.isnan(floor), np.inf, floor),
            np.array(data["own"], bool),
            {n: np.array(x, float) for n, x in data["needs"].items()},
            {n: np.array(x, float) for n, x in data["shown"].items()},
            Calibration.from_dict(data["calibration"]),
            blocks={n: np.array(x, float) for n, x in data.get("blocks", {}).items()},
        )


def chosen_share(needs: PoolNeeds, floor: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Choose W (SPEEDS, K, n_y), the silent pools, and where bounds are of a part's speeds (SPEEDS, K).

    W sees the smallest gain error at typical excitation. ``needs`` are those of the bound-setting drives,
    ``floor`` (K, n_y) the sensors' limit [output units]. A pool is silent where fewer than two recordings
    have frames, or where a vehicle without response would not exceed the bound.
    """
    shape, K = (SPEEDS, *floor.shape), len(floor)
    W, silent = np.full(shape, CANDIDATES[0]), np.ones(shape, bool)
    count = sum((seen.astype(int) for seen in needs.seen.values()), np.zeros((SPEEDS + 1, K), int))
    own = count[:SPEEDS] >= FEWEST_OF_SPEED
    for at, k, j in np.ndindex(*shape):
        source = at if own[at, k] else SPEEDS
        size = needs.sample["size"][needs.sample["group"] == source * K + k, j]
        typical = float(np.percentile(size, TYPICAL)) if len(size) else 0.0
        if typical > 0 and count[source, k] > 1:
            reach = np.maximum(needs.largest[source, k, :, j], floor[k, j]) / typical
            seen = np.maximum(CANDIDATES, reach)
            W[at, k, j], silent[at, k, j] = CANDIDATES[seen.argmin()], seen.min() >= 1
    return W, silent, own
