"""Score recordings: the mean of the change test's ratio over a fixed length of judged driving.

A sample is judged if the speed is in range, the model has settled, and the core has a ratio. A recording is
one drive, or several successive drives that experiments.csv marks as pieces of it. Only the first
``judged_s`` seconds count, so a longer recording does not get a higher score. A shorter recording has no
score and is reported by name.

The ratio comes from the compiled core. Its mean shows lasting changes, and its maximum shows the worst
moment. Least-squares sums over the same samples give an estimate of gain, delay and bias.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ...base import artefacts
from ...base.errors import InputError
from ...base.parallel import Map
from ...core.compiled import CHANGE_PARTS, is_alarming
from ...drives.tables import Drive, Experiment
from ...identify.bounds import nominal_error
from ...identify.change import Blocks
from ...replay.replayer import Replayer


@dataclass(frozen=True)
class ScoredDrive:
    """Contribution of a drive to its recording's score.

    Attributes
    ----------
    drive, recording, sha256 : str, the two names and the hash of the table
    ratios : ndarray (M,), of the judged samples
    products : ndarray (n_y, 3, 3), sums of products of regressors over whole blocks, with the delay in
    seconds
    along : ndarray (n_y, 3), sums of regressors times error over whole blocks
    alarmed : bool, the verdict was invalid or degraded at some time up to the last judged sample
    """

    drive: str
    recording: str
    sha256: str
    ratios: np.ndarray
    products: np.ndarray
    along: np.ndarray
    alarmed: bool

    @classmethod
    def from_drive(cls, replayer: Replayer, drive: Drive, most: int) -> ScoredDrive:
        """Compute the contribution of a drive with at most ``most`` judged samples; it has no hash."""
        run = replayer.replay(drive).run
        judged = np.flatnonzero(replayer.estimator.settled(drive.v) & (run.change > 0))[:most]
        usable = np.zeros(len(drive.t), bool)
        usable[judged] = True
        e, yhat = nominal_error(drive, replayer.model)
        n_y = e.shape[1]
        products, along = np.zeros((n_y, len(CHANGE_PARTS), len(CHANGE_PARTS))), np.zeros((n_y, 3))
        for blocks in Blocks.stretches(e, yhat, usable):
            phi = blocks.phi / np.array([1.0, replayer.change_block_s, 1.0])
            products += np.einsum("mji,mjk->jik", phi, phi)
            along += np.einsum("mji,mj->ji", phi, blocks.e)
        until = judged[-1] + 1 if len(judged) else 0
        alarmed = is_alarming(run.verdict[:until]).any()
        return cls(drive.name, drive.name, "", run.change[judged], products, along, bool(alarmed))


@dataclass(frozen=True)
class DriveEstimate:
    """Least-squares estimate for an output over a recording: e = gain yhat - delay_s dyhat/dt + bias.

    Attributes
    ----------
    output : str
    gain : float
    delay_s : float, s
    bias : float, output unit
    """

    output: str
    gain: float
    delay_s: float
    bias: float


@dataclass(frozen=True)
class Scored:
    """A recording: its drives with the hashes of their tables, the counted judged time [s], and the score.

    The score is None if this time is too short.
    """

    name: str
    sha256: dict[str, str]
    judged_s: float
    score: float | None
    estimates: tuple[DriveEstimate, ...]
    alarmed: bool


def _piece(replayer: Replayer, most: int, experiment: Experiment) -> ScoredDrive | InputError:
    """Score one drive file; errors are returned, so that they can pass between processes."""
    try:
        recorded = replayer.read_file(experiment.path)
    except InputError as error:
        return error
    fields = vars(ScoredDrive.from_drive(replayer, recorded.drive, most))
    named = {"recording": experiment.recording, "sha256": artefacts.file_hash(experiment.path)}
    return ScoredDrive(**{**fields, "drive": experiment.name, **named})


def recordings_of(
    replayer: Replayer,
    experiments: Sequence[Experiment],
    judged_s: float,
    workers: Map = map,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Scored]:
    """Score the recordings of drives, in the order of their first drives.

    The samples of a recording are kept until it is complete. ``judged_s`` is the judged driving per score
    [s]. ``progress`` gets the name of each scored drive. Raises InputError if a drive cannot be read.
    """
    most = round(judged_s / replayer.project.Ts_s)
    missing = Counter(e.recording for e in experiments)
    waiting: dict[str, list[ScoredDrive]] = {name: [] for name in missing}
    recordings: dict[str, Scored] = {}
    for piece in workers(partial(_piece, replayer, most), experiments):
        if isinstance(piece, InputError):
            raise piece
        progress(piece.drive)
        waiting[piece.recording].append(piece)
        missing[piece.recording] -= 1
        if missing[piece.recording] == 0:
            recordings[piece.recording] = scored(
                replayer, piece.recording, waiting.pop(piece.recording), most
            )
    return [recordings[name] for name in missing]


def scored(replayer: Replayer, name: str, pieces: list[ScoredDrive], most: int) -> Scored:
    """Join the pieces of a recording, in the order of time.

    The last piece that is needed contributes only its first samples to the score, and its sums in proportion.

    Parameters
    ----------
    replayer : Replayer
    name : str, of the recording
    pieces : list of ScoredDrive
    most : int, judged samples that a score needs

    Returns
    -------
    Scored
    """
    products, along = np.zeros_like(pieces[0].products), np.zeros_like(pieces[0].along)
    left, alarmed = most, False
    for piece in pieces:
        alarmed |= left > 0 and piece.alarmed
        share = min(1.0, left / len(piece.ratios)) if len(piece.ratios) else 0.0
        left = max(0, left - len(piece.ratios))
        products += share * piece.products
        along += share * piece.along
    ratios = np.concatenate([p.ratios for p in pieces])
    return Scored(
        name,
        {p.drive: p.sha256 for p in pieces},
        min(len(ratios), most) * replayer.project.Ts_s,
        float(ratios[:most].mean()) if len(ratios) >= most else None,
        tuple(
            DriveEstimate(signal.name, *map(float, np.linalg.lstsq(A, b, rcond=1e-9)[0]))
            for signal, A, b in zip(replayer.project.outputs, products, along, strict=True)
        ),
        alarmed,
    )


def require_new(path: Path, scores: Iterable[Scored], seen: dict[str, str]) -> None:
    """Raise InputError if ``seen`` (use by hash) contains a table."""
    for recording in scores:
        for drive, digest in recording.sha256.items():
            if digest in seen:
                raise InputError(
                    path, drive, f"is a table that {seen[digest]}", "drives that were not used before"
                )
