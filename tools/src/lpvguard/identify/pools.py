"""Pools of frames: sums of the error that the input explains (THEORY 7.17; lib/include/lpvguard/monitor.h).

The remainder of a pool is ``|sum of conj(Z) E| / sqrt(P) - W sqrt(P)`` with P = sum of |Z|^2. Its bound B is
the largest remainder of all drives, including those that calibrate. W is chosen on the drives that set the
bounds.

The score of a drive is its largest remainder, divided by the bound of all other recordings. A bound without
one recording is at most the exported bound. A further exchangeable recording therefore exceeds the threshold
of these scores with probability at most alpha (T52). All drives can serve both the bounds and the threshold.
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
"""Number of pools of each bin in the sample for the typical excitation."""


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


@dataclass(frozen=True)
class PoolNeeds:
    """Largest remainders of drives for each of P CANDIDATES of W, and a sample of their pools.

    ``largest`` is (K, P, n_y) [output units]. ``seen`` maps a recording to the mask (K,) of bins with frames.
    ``sample`` has the columns ``group`` (bin), ``hash`` and ``size`` (F, n_y), which is sqrt(P).
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
    e: Experiment, frames: Iterable[FrameSet], estimator: Estimator, sizes: PoolSizes, n_y: int
) -> PoolNeeds:
    """Compute the needs of the drive ``e`` for pools of the ``sizes``."""
    largest, seen = np.zeros((estimator.n_bins, len(CANDIDATES), n_y)), np.zeros(estimator.n_bins, bool)
    rows = [{"group": np.zeros(0, int), "hash": np.zeros(0, np.uint64), "size": np.zeros((0, n_y))}]
    for s in frames:
        if not len(s.E):
            continue
        seen[s.bin] = True
        for along, size in pooled(s, estimator, sizes.counts(s.bin)[-1:]):
            for p, W in enumerate(CANDIDATES):
                largest[s.bin, p] = np.maximum((along - W * size).max(axis=0), 0.0)
            on_grid = np.flatnonzero(s.starts % estimator.hop[s.bin] == 0)
            group = np.full(len(on_grid), s.bin)
            hashes = row_hash(e.name, group, s.starts[on_grid])
            rows.append({"group": group, "hash": hashes, "size": size[on_grid]})
    return PoolNeeds(largest, {e.recording: seen}, first_of_each(stacked(rows), SAMPLED))


@dataclass(frozen=True)
class Remainders:
    """Largest remainders of drives, and samples of their pools.

    ``largest`` (K, n_y) [output units] holds the largest remainders, and ``blocks`` (b, K, n_y) those in each
    block of one drive. Rows have ``group`` (speed cell * K + bin), ``hash`` and ``size`` (F, n_y), which is
    sqrt(P). ``strongest`` holds the rows with the largest size of each output. ``sums`` are the sums for the
    limit of detection.
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
        """Excitation of the pools, from the ratio of a vehicle without response with W and B (K, n_y).

        ``limit`` is the gain error that a test with full knowledge of the vehicle could see (T55).
        """

        def shown(rows: Rows) -> Rows:
            cell, k = np.divmod(rows["group"], len(W))
            with np.errstate(divide="ignore"):
                seen = W[k] + B[k] / rows["size"]
            best = seen.argmin(axis=1)
            return {
                "group": rows["group"],
                "hash": rows["hash"],
                "dead": 1 / seen.min(axis=1),
                "size": np.linalg.norm(rows["size"], axis=1),
                "floor": W[k, best],
                "limit": self.sums.gain_error(quantile, cell, k, rows["size"]),
            }

        return Excitation.of_rows(
            np.zeros((SPEED_CELLS, len(W)), int), shown(self.strongest), shown(self.sample)
        )


def remainders_of(
    e: Experiment,
    frames: Iterable[FrameSet],
    v: np.ndarray,
    estimator: Estimator,
    sizes: PoolSizes,
    W: np.ndarray,
) -> Remainders:
    """Compute the remainders of the drive ``e`` for ``W`` (K, n_y). ``v`` (N,) is its speed [m/s]."""
    K, Ts, way = estimator.n_bins, estimator.Ts, np.concatenate([[0.0], np.cumsum(v)])
    blocks = np.zeros((int(block_of(len(v) * Ts)) + 1, *W.shape))
    met: list[tuple[np.ndarray, FrameSet]] = []
    rows = [{"group": np.zeros(0, int), "hash": np.zeros(0, np.uint64), "size": np.zeros((0, W.shape[1]))}]
    for s in frames:
        if not len(s.E):
            continue
        for first, (along, size) in enumerate(pooled(s, estimator, sizes.counts(s.bin))):
            block = block_of((s.starts + estimator.length[s.bin]) * Ts)
            np.maximum.at(blocks[:, s.bin], block, along - W[s.bin] * size)
            if first == 0:
                on_grid = s.starts % estimator.hop[s.bin] == 0
                start, N = s.starts[on_grid], estimator.length[s.bin]
                cell = speed_cell(estimator.speed_range, (way[start + N] - way[start]) / N)
                hashes = row_hash(e.name, np.full(len(start), s.bin), start)
                rows.append({"group": cell * K + s.bin, "hash": hashes, "size": size[on_grid]})
                met.append((cell, replace(s, E=s.E[on_grid], Z=s.Z[on_grid], starts=start)))
    every = stacked(rows)
    sums = LimitSums.from_frames(met, (SPEED_CELLS, *W.shape))
    return Remainders.of_rows(blocks.max(axis=0), every, every, sums, blocks)


@dataclass(frozen=True)
class Pools:
    """Bounds of pools of frames, and the remainders behind them.

    Attributes
    ----------
    sizes : PoolSizes
    W : ndarray (K, n_y), share of |yhat| that a pool allows for
    floor : ndarray (K, n_y), least bound [output units], inf where the pool is silent
    needs : dict, largest remainders (K, n_y) [output units], by recording
    calibration : Calibration, from the scores of the calibration drives
    unit : float, exported ratio of a remainder that equals its bound, default 1
    blocks : dict, largest remainders (b, K, n_y) in blocks, by calibration drive
        It is empty without a target rate.
    """

    sizes: PoolSizes
    W: np.ndarray
    floor: np.ndarray
    needs: dict[str, np.ndarray]
    calibration: Calibration
    unit: float = 1.0
    blocks: dict[str, np.ndarray] = field(default_factory=dict)

    @cached_property
    def _table(self) -> np.ndarray:
        return np.array(list(self.needs.values())).reshape(len(self.needs), *self.W.shape)

    def bound(self, without: str | None = None) -> np.ndarray:
        """Bounds B (K, n_y) [output units] from all recordings except ``without``."""
        chosen = [x for n, x in self.needs.items() if n != without]
        return np.maximum(self.floor, np.max(chosen, axis=0, initial=0.0)) if chosen else self.floor

    def scale(self, without: str | None = None) -> np.ndarray:
        """Unit divided by B (K, n_y), 0 where the pool is silent."""
        return self.unit / self.bound(without)

    def beside(self, threshold: float, own: float) -> Pools:
        """The pools in a unit in which their threshold ``own`` becomes the ``threshold`` of frames."""
        return replace(self, unit=threshold / own)

    def ratios(self, without: str | None = None) -> dict[str, float]:
        """Largest ratio of a remainder to the bound of all others, for every recording except ``without``."""
        bounds = self._bounds_of_others(without)
        return {n: float((self.needs[n] / bound).max()) for n, bound in bounds.items()}

    def _bounds_of_others(self, without: str | None) -> dict[str, np.ndarray]:
        """Bound (K, n_y) from all other recordings, for every recording except ``without``."""
        kept = [i for i, n in enumerate(self.needs) if n != without]
        names, table = list(self.needs), self._table[kept]
        if not kept:
            return {}
        order = np.argsort(table, axis=0)
        most = np.take_along_axis(table, order[-1:], axis=0)[0]
        next_most = np.take_along_axis(table, order[-2:-1], axis=0)[0] if len(kept) > 1 else 0 * most
        others = np.where(np.arange(len(kept))[:, None, None] == order[-1], next_most, most)
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
            d: (x / bounds[named[d]]).max(axis=(1, 2)).tolist()
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
        return {}, words, {"pool_W": self.W, "pool_scale": self.scale()}

    def to_dict(self) -> dict:
        """Convert to JSON types, for `from_dict`."""
        return {
            "parts": self.sizes.parts,
            "frames": self.sizes.frames,
            "W": self.W,
            "floor": np.where(np.isinf(self.floor), np.nan, self.floor),
            "needs": self.needs,
            **({"blocks": self.blocks} if self.blocks else {}),
            "calibration": self.calibration.to_dict(),
        }

    def stated(self) -> dict:
        """Result of `to_dict` with the bounds in place of the remainders."""
        kept = {key: value for key, value in self.to_dict().items() if key not in ("needs", "blocks")}
        bound = self.bound()
        return kept | {"B": np.where(np.isinf(bound), np.nan, bound)}

    @classmethod
    def from_dict(cls, data: dict) -> Pools:
        """Pools from the result of `to_dict`."""
        floor = np.array(data["floor"], float)
        return cls(
            PoolSizes(np.array(data["parts"], int), np.array(data["frames"], int)),
            np.array(data["W"], float),
            np.where(np.isnan(floor), np.inf, floor),
            {n: np.array(x, float) for n, x in data["needs"].items()},
            Calibration.from_dict(data["calibration"]),
            blocks={n: np.array(x, float) for n, x in data.get("blocks", {}).items()},
        )


def chosen_share(needs: PoolNeeds, floor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Choose W (K, n_y) with the smallest visible gain error at typical excitation.

    Also returns the mask (K, n_y) of silent pools. ``needs`` are those of the bound-setting drives. ``floor``
    (K, n_y) is the limit of the sensors [output units]. A pool is silent where fewer than two recordings have
    frames, or where a vehicle without response would not exceed the bound.
    """
    W, silent = np.zeros(floor.shape), np.ones(floor.shape, bool)
    for k, j in np.ndindex(*floor.shape):
        size = needs.sample["size"][needs.sample["group"] == k, j]
        typical = float(np.percentile(size, TYPICAL)) if len(size) else 0.0
        if typical > 0 and sum(bins[k] for bins in needs.seen.values()) > 1:
            seen = CANDIDATES + np.maximum(needs.largest[k, :, j], floor[k, j]) / typical
            W[k, j], silent[k, j] = CANDIDATES[seen.argmin()], seen.min() >= 1
    return W, silent
