"""Functions of `identify` for one drive, which workers run on every drive."""

import io
import uuid
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from ..base.parallel import Map
from ..base.sampling import Rows, first_of_each, row_hash, stacked
from ..core.compiled import Core
from ..drives.frames import Estimator
from ..drives.tables import Drive, Experiment, read_drive, require_units
from ..engine.validation import s1
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project
from .bounds import (
    FrameSet,
    Part,
    counted_frames,
    fold,
    nominal_error,
    reduce_disturbance,
    reduce_remainder,
    reduce_uncertainty,
)
from .calibration import Peak, block_maxima, change_score, energy_score, peaks, score
from .change import ChangeTest, Met, estimates_met, regressor_products
from .confirmation import Confirmed, Design, judged_drive
from .diagnosis import Windows, windows_of
from .energy import EnergyTest
from .error_domain import ErrorDomain
from .error_sums import ErrorSums, common_fit, common_products, error_sums, sum_of
from .healthy import needed
from .isolation import Changes, Isolation, Moments, WindowSums, evidence_windows, moments_of
from .narrow_error import narrow_excitation
from .pools import PoolNeeds, PoolSizes, Remainders, needs_of, remainders_of
from .resolution import resolution_of
from .visibility import Excitation

LARGEST_SPECTRA, DRAWN_SPECTRA = 250, 750
"""Numbers of frames in spectra.npz for each bin: those with the largest |E|, and a sample of all by hash."""
KEPT_BYTES = 384 << 20
"""Largest number of bytes of samples that a reader keeps. An identification reads its drives a dozen
times."""


@dataclass
class _Held:
    """A drive with its nominal output yhat (N, n_y).

    ``stretches`` are the runs of its counted frames, after their first use.
    """

    drive: Drive
    yhat: np.ndarray
    stretches: list[np.ndarray] | None = None

    def signals(self) -> tuple[Drive, np.ndarray, np.ndarray]:
        """The drive, e and yhat."""
        return self.drive, self.drive.y - self.yhat, self.yhat


class DriveReader:
    """Reads drives and computes their frames. It can be sent to a worker.

    The first drives are kept in memory up to KEPT_BYTES, as read-only arrays. A worker starts without drives.
    It has one reader for all copies of this one.

    Parameters
    ----------
    project : Project
    model : NominalModel
    """

    def __init__(self, project: Project, model: NominalModel):
        self.project, self.model, self.estimator = project, model, Estimator.from_project(project, model)
        self._kept: dict[Experiment, _Held] = {}
        self._room = KEPT_BYTES
        self._key = uuid.uuid4()
        _ = model.table  # computed once here, not by every worker

    def __reduce__(self):
        return _sent, (self._key, self.project, self.model)

    @property
    def identity(self) -> Project:
        """Everything that a result of this reader depends on (base/kept_results.py)."""
        return self.project

    def read(self, experiment: Experiment) -> tuple[Drive, np.ndarray, np.ndarray]:
        """The drive, its nominal error e and nominal output yhat (N, n_y)."""
        return self._held(experiment).signals()

    def frames(self, experiment: Experiment) -> Iterator[FrameSet]:
        """Yield the counted frames of a drive, one set for each bin."""
        return self._frames(self._held(experiment))

    def seen(self, experiment: Experiment) -> tuple[Drive, np.ndarray, np.ndarray, Iterator[FrameSet]]:
        """The drive, e and yhat (N, n_y), and the counted frames, with a single read."""
        held = self._held(experiment)
        return *held.signals(), self._frames(held)

    def _held(self, experiment: Experiment) -> _Held:
        if experiment in self._kept:
            return self._kept[experiment]
        drive = read_drive(experiment.path, self.project)
        held = _Held(drive, nominal_error(drive, self.model)[1])
        require_units(experiment.path, drive, held.yhat, self.estimator.settled(drive.v))
        arrays = [held.yhat, *(x for x in vars(drive).values() if isinstance(x, np.ndarray))]
        for array in arrays:
            array.flags.writeable = False
        size = sum(array.nbytes for array in arrays)
        if size <= self._room:
            self._kept[experiment] = held
            self._room -= size
        return held

    def _frames(self, held: _Held) -> Iterator[FrameSet]:
        if held.stretches is None and self.estimator.window == "hann":
            held.stretches = self.estimator.stretches(held.drive.v)
            self._room -= sum(runs.nbytes for runs in held.stretches)
        return counted_frames(*held.signals(), self.model, self.estimator, held.stretches)

    def why_without_frames(self) -> str:
        """Reason why a drive has no counted frame."""
        low, high = self.estimator.speed_range
        shortest_s = self.estimator.length.min() * self.estimator.Ts
        settled_s = self.estimator.settle * self.estimator.Ts
        return (
            f"no frame counts: no {shortest_s:g} s within {low:g}..{high:g} m/s and "
            f"{self.estimator.speed_tolerance:.0%} of their mean speed"
            + (f", {settled_s:.3g} s after the speed enters the range" if self.estimator.settle else "")
        )


_of_worker: dict[uuid.UUID, DriveReader] = {}
"""Reader that a worker received last, by its key."""


def _sent(key: uuid.UUID, project: Project, model: NominalModel) -> DriveReader:
    """Reader of the worker that replaces a received one."""
    if key not in _of_worker:
        _of_worker.clear()
        _of_worker[key] = DriveReader(project, model)
    return _of_worker[key]


def _spectra_rows(s: FrameSet, name: str, way: np.ndarray, estimator: Estimator) -> Rows:
    """Rows of a sample, from the frames of ``s`` whose starts the core uses.

    ``way`` (N + 1,) sums the speed.
    """
    on_grid = (
        s.starts % estimator.hop[s.bin] == 0 if estimator.window == "hann" else np.ones(len(s.starts), bool)
    )
    E, Z, start = s.E[on_grid], s.Z[on_grid], s.starts[on_grid]
    group = np.full(len(start), s.bin)
    return {
        "group": group,
        "hash": row_hash(name, group, start),
        "weakness": -np.linalg.norm(E, axis=1),
        "start": start,
        "speed": (way[start + estimator.length[s.bin]] - way[start]) / estimator.length[s.bin],
        "drive": np.full(len(start), name, dtype=object),
        "E": E,
        "Z": Z,
    }


def thinned(rows: Rows) -> Rows:
    """Sample of LARGEST_SPECTRA and DRAWN_SPECTRA rows of each bin, without duplicates.

    The sample of the union of two samples equals the sample of all rows.
    """
    both = stacked([first_of_each(rows, LARGEST_SPECTRA, "weakness"), first_of_each(rows, DRAWN_SPECTRA)])
    order = np.lexsort((both["hash"], both["group"]))
    both = {k: v[order] for k, v in both.items()}
    new = np.r_[True, (np.diff(both["hash"]) != 0) | (np.diff(both["group"]) != 0)][: len(order)]
    return {k: v[new] for k, v in both.items()}


def spectra_file(rows: Rows, bound_drives: list[str]) -> bytes:
    """Content of spectra.npz.

    It has drive (index into names), bin, start, speed (mean over the frame, m/s), E and Z.
    """
    index = {name: i for i, name in enumerate(bound_drives)}
    stream = io.BytesIO()
    np.savez(
        stream,
        names=np.array(bound_drives),
        drive=np.array([index[n] for n in rows["drive"]], int),
        bin=rows["group"],
        start=rows["start"],
        speed=rows["speed"],
        E=rows["E"],
        Z=rows["Z"],
    )
    return stream.getvalue()


def first_pass(
    reader: DriveReader, nu_ceiling: np.ndarray, experiment: Experiment
) -> tuple[Part, Rows, np.ndarray]:
    """Bounds before smoothing, peaks, a sample of the spectra, and step and noise (2, n_y) of one drive.

    ``nu_ceiling`` (K,) is the ceiling on nu in every bin, 0 at DC.
    """
    rows: list[Rows] = []
    drive, e, _, frames = reader.seen(experiment)
    way = np.concatenate([[0.0], np.cumsum(drive.v)])

    def watched() -> Iterator[FrameSet]:
        for s in frames:
            rows.append(_spectra_rows(s, experiment.name, way, reader.estimator))
            yield s

    project = reader.project
    part = reduce_disturbance(watched(), reader.estimator, nu_ceiling, project.n_y, project.controlled)
    return part, thinned(stacked(rows)), resolution_of(drive, e, reader.estimator)


def error_sums_of(
    reader: DriveReader, domain: ErrorDomain, experiments: list[Experiment], workers: Map
) -> list[ErrorSums]:
    """Compute the sums of each drive for the regularised model error model.

    Parameters
    ----------
    reader : DriveReader
    domain : ErrorDomain
    experiments : list of Experiment
    workers : Map

    Returns
    -------
    list of ErrorSums, in the order of the experiments
    """
    common = common_fit(sum_of(list(workers(partial(_common_pass, reader, domain), experiments))))
    return list(workers(partial(_error_pass, reader, domain, common), experiments))


def _common_pass(reader: DriveReader, domain: ErrorDomain, experiment: Experiment) -> np.ndarray:
    return common_products(domain, reader.model, reader.estimator, *reader.read(experiment))


def _error_pass(
    reader: DriveReader, domain: ErrorDomain, common: np.ndarray, experiment: Experiment
) -> ErrorSums:
    signals, group = reader.read(experiment), experiment.group_or_recording
    return error_sums(domain, reader.model, reader.estimator, *signals, group, common)


def uncertainty_pass(
    reader: DriveReader, gamma_w: np.ndarray, grid: np.ndarray, experiment: Experiment
) -> Part:
    """Reduce a drive to its nu of step 5 at gamma_w (K,), and to its front over ``grid``.

    ``grid`` is (K, FRONT_POINTS).
    """
    return reduce_uncertainty(
        reader.frames(experiment),
        reader.estimator,
        gamma_w,
        grid,
        reader.project.n_y,
        reader.project.bounds.structure,
    )


def healthy_pass(reader: DriveReader, experiment: Experiment) -> np.ndarray:
    """Return the needs (K, P, n_y) of a drive for the healthy set, see `needed`."""
    project = reader.project
    frames = list(reader.frames(experiment))
    return needed(frames, reader.estimator, project.n_delta, project.bounds.structure)


def pool_needs_pass(reader: DriveReader, sizes: PoolSizes, experiment: Experiment) -> PoolNeeds:
    """Needs of a drive for the bounds of pools."""
    drive, _, _, frames = reader.seen(experiment)
    return needs_of(experiment, frames, drive.v, reader.estimator, sizes, reader.project.n_y)


def pool_remainder_pass(
    reader: DriveReader, sizes: PoolSizes, W: np.ndarray, own: np.ndarray, experiment: Experiment
) -> Remainders:
    """Remainders of a drive's pools (`remainders_of`); ``W`` (SPEEDS, K, n_y), ``own`` (SPEEDS, K)."""
    drive, _, _, frames = reader.seen(experiment)
    return remainders_of(experiment, frames, drive.v, reader.estimator, sizes, W, own)


def remainder_pass(
    reader: DriveReader, W_delta: np.ndarray, joint: bool, experiment: Experiment
) -> tuple[Part, list[np.ndarray]]:
    """Reduce a drive to the |w_j| that no |delta| <= W_delta (K, n_delta) explains (`reduce_remainder`)."""
    return reduce_remainder(
        reader.frames(experiment),
        reader.estimator,
        W_delta,
        reader.project.n_y,
        reader.project.bounds.structure,
        joint,
    )


class Judged(NamedTuple):
    """Results of the tests on a drive.

    ``worst`` is the largest margin. The scores are None where a test judged nothing. ``met`` is the
    excitation, and ``judged_s`` the judged time [s]. ``peaks`` are the peaks by test, empty without a core.
    ``energy_of_cuts`` is the largest ratio of the energy test in the cut runs, 0 where it judged nothing.
    ``maxima`` are the maxima of the scores in blocks, by test.
    """

    worst: float
    score: float | None
    energy_score: float | None
    change_score: float | None
    met: Excitation
    judged_s: float
    peaks: dict[str, Peak]
    energy_of_cuts: float = 0.0
    maxima: dict[str, list[float]] = {}  # noqa: RUF012


def confirmation_pass(
    reader: DriveReader,
    core: Core,
    reals: np.ndarray,
    designs: tuple[Design, ...],
    planted: frozenset[str],
    experiment: Experiment,
) -> Confirmed:
    """Judge a drive by all ``designs``, and with gain errors if it is among the ``planted``.

    ``reals`` (R,) are the numbers of the core.
    """
    drive, estimator = reader.read(experiment)[0], reader.estimator
    with_errors = experiment.name in planted
    return judged_drive(core, reals, drive, reader.project, estimator.length, designs, planted=with_errors)


def judge(
    reader: DriveReader,
    W_delta: np.ndarray,
    B_w: np.ndarray,
    core: Core | None,
    reals: np.ndarray | None,
    cuts: int,
    experiment: Experiment,
) -> Judged:
    """Judge a drive by the compiled core.

    It is judged as a whole, and for ``worst`` also from ``cuts`` random first samples. Without a core (plain
    DFT) the exact margin for W_delta (K, n_delta) and B_w (K, n_y) judges the drive.
    """
    speed_range, name = reader.estimator.speed_range, experiment.name
    drive, _, _, frames = reader.seen(experiment)
    if core is None:
        sets = list(frames)
        bin_of, start = (
            np.concatenate(a)
            for a in zip(*((np.full(len(s.E), s.bin), s.starts) for s in sets), strict=False)
        )
        E, Z = (np.concatenate([getattr(s, a) for s in sets]) for a in ("E", "Z"))
        worst = s1.margin(E, Z, W_delta[bin_of], B_w[bin_of]).max(initial=0.0)
        speed = np.array(
            [drive.v[a : a + n].mean() for a, n in zip(start, reader.estimator.length[bin_of], strict=False)]
        )
        return Judged(
            worst,
            float(worst) if len(E) else None,
            None,
            None,
            Excitation.from_frames(name, speed_range, bin_of, speed, Z, W_delta, B_w, start),
            _covered_s(start, reader.estimator.length[bin_of], reader.project.Ts_s),
            {},
        )
    worst = energy_of_cuts = 0.0
    for cut in _first_samples(reader, name, len(drive.t), cuts):
        run = core.monitor(reals=reals, seal=reals is not None).run_drive(drive.from_sample(cut))
        counted = run.frames.counted
        worst = max(worst, float(run.frames.margin[counted].max(initial=0.0)))
        if cut == 0:
            whole, of_whole = run, counted
        else:
            energy_of_cuts = max(energy_of_cuts, energy_score(run) or 0.0)
    f = whole.frames
    met = Excitation.from_frames(
        name,
        speed_range,
        f.bin[of_whole],
        f.speed[of_whole],
        f.Z[of_whole],
        W_delta,
        B_w,
        np.round(f.t_end_s[of_whole] * 1e6).astype(np.int64),
    )
    Ts = reader.project.Ts_s
    judged_s = float(f.judged(len(drive.t), drive.t[0], Ts, reader.estimator.length).sum() * Ts)
    test_peaks = peaks(whole, drive.t[0], Ts, reader.estimator.length)
    scores = score(whole), energy_score(whole), change_score(whole)
    maxima = block_maxima(whole, drive.t[0], Ts)
    return Judged(worst, *scores, met, judged_s, test_peaks, energy_of_cuts, maxima)


def _covered_s(start: np.ndarray, length: np.ndarray, Ts: float) -> float:
    """Time [s] that frames cover, with ``length`` (F,) samples from the sample ``start`` (F,) on."""
    frames_open = np.zeros(int((start + length).max(initial=0)) + 1, int)
    np.add.at(frames_open, start, 1)
    np.add.at(frames_open, start + length, -1)
    return float((np.cumsum(frames_open) > 0).sum() * Ts)


def _first_samples(reader: DriveReader, name: str, samples: int, cuts: int) -> list[int]:
    """Return 0 and ``cuts`` random samples in the first half of a drive."""
    # Each drive has its own random stream, so the result does not depend on other drives or their order.
    random = np.random.default_rng([reader.project.seed, zlib.crc32(name.encode())])
    return [0, *random.integers(1, max(2, samples // 2), cuts).tolist()]


def energy_pass(reader: DriveReader, test: EnergyTest, cuts: int, experiment: Experiment) -> Part:
    """Return the sigma that a drive needs, as a whole from rest and in cut runs with a memory of Delta.

    Without ``cuts`` the result also has the largest memory in the drive. With ``cuts`` the whole drive is
    judged only for directions of several outputs, because sigma already covers single outputs.
    """
    drive, e, yhat = reader.read(experiment)

    def parts() -> Iterator[Part]:
        if not cuts or not test.single:
            yield test.at_rest().needs(e, yhat, drive.v)
        if not cuts:
            yield {"memory": test.memory_met(e, yhat, drive.v)}
        for cut in _first_samples(reader, experiment.name, len(drive.t), cuts)[1:]:
            rest = drive.from_sample(cut)
            yield test.needs(*nominal_error(rest, reader.model), rest.v)

    return fold(parts())


def change_products_pass(reader: DriveReader, experiment: Experiment) -> np.ndarray:
    """Return the sums (n_y, 3, 3) of products of the regressors of the change test over a drive."""
    drive, e, yhat = reader.read(experiment)
    return regressor_products(e, yhat, drive.v, reader.estimator)


def change_met_pass(reader: DriveReader, test: ChangeTest, experiment: Experiment) -> Met:
    """Return the summary of the estimates of the change test along a drive."""
    drive, e, yhat = reader.read(experiment)
    return estimates_met(test, e, yhat, drive.v, reader.estimator)


def narrow_pass(reader: DriveReader, test: ChangeTest, experiment: Experiment) -> Excitation:
    """Return what the change test shows of gain errors in single bins along a drive."""
    drive, _, yhat = reader.read(experiment)
    return narrow_excitation(test, experiment.name, yhat, drive.v, reader.estimator)


def diagnosis_pass(reader: DriveReader, unit: np.ndarray, experiment: Experiment) -> Windows:
    """Return the windows of a drive for the scales of the diagnosis. ``unit`` (n_y, 2) is 1 / sizes."""
    drive, e, yhat = reader.read(experiment)
    return windows_of(e, yhat, drive.v, reader.estimator, unit)


def isolation_moments_pass(reader: DriveReader, changes: Changes, experiment: Experiment) -> Moments:
    """Return the moments of a drive for the isolation scales."""
    return moments_of(changes, reader.read(experiment)[0])


def isolation_windows_pass(
    reader: DriveReader, changes: Changes, begun: Isolation, experiment: Experiment
) -> list[WindowSums]:
    """Return the windows of a drive for the isolation scales."""
    return evidence_windows(changes, begun, reader.read(experiment)[0])
