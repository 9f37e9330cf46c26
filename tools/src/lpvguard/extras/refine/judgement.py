"""Judges further drives: the statements that each refutes, and the known drives that it is like.

Three statements can be refuted. A frame refutes the certificate when its margin under W_delta and B_w exceeds
1. It refutes the certificate set if a vehicle without response would have exceeded 1, too. Otherwise it
refutes the disturbance bound. An alarm of any test of the core refutes the healthy set.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ...base.errors import InputError
from ...base.parallel import Map
from ...core.compiled import Core
from ...drives.tables import Drive, Experiment, list_experiments
from ...identify.calibration import ROUNDING, Calibration, change_score, energy_score, score
from ...identify.identification import StoredIdentification
from ...identify.scratch import scratch_core
from ...replay.replayer import Replayer
from ..fleet.scores import DriveEstimate
from .lineage import Lineage, compiled
from .own import estimated, estimated_file

CERTIFICATE, HEALTHY, DISTURBANCE = "certificate set", "healthy set", "disturbance bound"
ALL, NEW = "all", "new"
"""Likeness: the only group, where experiments.csv names none, and no group."""
BROKEN = ("frozen", "sign", "noise")
"""Causes of the diagnosis that are broken sensors."""


@dataclass(frozen=True)
class Judgement:
    """Judgement of a drive.

    Attributes
    ----------
    experiment : Experiment
    vehicle : str
    refutes : tuple of str, of CERTIFICATE, HEALTHY and DISTURBANCE
    ratios : dict[str, float], largest number of every test over its threshold, and ``certificate``: margin
    like : str, group of known drives whose scores are as large, or NEW
    estimates : tuple of DriveEstimate, relative to the first identification's model
    broken : str or None, diagnosis of a broken sensor, in words
    """

    experiment: Experiment
    vehicle: str
    refutes: tuple[str, ...]
    ratios: dict[str, float]
    like: str
    estimates: tuple[DriveEstimate, ...]
    broken: str | None


@dataclass(frozen=True)
class _Cores:
    """Compiled cores that judge drives: of now, of the certificate alone, and of the first identification."""

    now: Replayer
    certificate: Core
    first: Replayer

    def findings(self, experiment: Experiment) -> _Findings:
        """Judge one drive. Raises InputError where it cannot be read, or nothing of it is judged."""
        drive = self.now.read_file(experiment.path).drive
        replay = self.now.replay(drive)
        run, frames = replay.run, replay.run.frames
        scores = {"frame": score(run), "energy": energy_score(run), "change": change_score(run)}
        if set(scores.values()) == {None}:
            raise InputError(
                experiment.path, "", "no test judges it", "settled driving within the model's speeds"
            )
        margin, model = self._certificate(drive)
        thresholds = self.now.threshold, self.now.energy_threshold, self.now.change_threshold
        ratios = {t: (s or 0.0) / x for (t, s), x in zip(scores.items(), thresholds, strict=True)}
        ratios["pool"] = float(frames.pooled[frames.counted].max(initial=0.0)) / self.now.threshold
        refutes = []
        if margin > 1 + ROUNDING:
            refutes.append(CERTIFICATE if model else DISTURBANCE)
        if max(ratios.values()) > 1:
            refutes.append(HEALTHY)
        broken = next((d.says for d in replay.diagnoses if d.final and d.cause in BROKEN), None)
        ratios["certificate"] = margin
        return _Findings(tuple(refutes), ratios, scores, estimated(self.first, drive), broken)

    def _certificate(self, drive: Drive) -> tuple[float, bool]:
        """Largest margin of the certificate, and whether a vehicle without response would exceed 1, too."""
        frames = self.certificate.monitor().run_drive(drive).frames
        margin = np.where(frames.counted, frames.margin, 0.0)
        over = margin > 1 + ROUNDING
        return float(margin.max(initial=0.0)), bool((over & (frames.evidence > 1)).any())


@dataclass(frozen=True)
class _Findings:
    """Statements of the cores on a drive, as of `Judgement`; ``scores`` by test, None: it judged nothing."""

    refutes: tuple[str, ...]
    ratios: dict[str, float]
    scores: dict[str, float | None]
    estimates: tuple[DriveEstimate, ...]
    broken: str | None


@dataclass(frozen=True)
class Judge:
    """Judges drives against ``stored``, the identification of now, and the first one of its lineage."""

    stored: StoredIdentification
    _cores: _Cores

    @property
    def first(self) -> Replayer:
        """The first identification's core."""
        return self._cores.first

    @classmethod
    @contextmanager
    def for_lineage(cls, lineage: Lineage) -> Iterator[Judge]:
        """Judge of a lineage."""
        stored = lineage.stored
        # All bins of the certificate count, also those that raise no alarm.
        alone = replace(stored, fitted=replace(stored.fitted, healthy=None, silent=()), pools=None)
        with ExitStack() as stack:
            cores = _Cores(
                stack.enter_context(compiled(stored)),
                stack.enter_context(scratch_core(stored.project, alone.coefficients)),
                stack.enter_context(lineage.first()),
            )
            yield cls(stored, cores)

    def judged(
        self, experiments: Sequence[Experiment], vehicle: Mapping[str, str], workers: Map = map
    ) -> Iterator[Judgement]:
        """Judge drives, in order; ``vehicle`` by name of drive. Raises InputError as `_Cores.findings`."""
        findings = workers(self._cores.findings, experiments)
        for e, f in zip(experiments, findings, strict=True):
            like = _like(self.stored, f.scores)
            yield Judgement(e, vehicle[e.name], f.refutes, f.ratios, like, f.estimates, f.broken)

    def known_estimates(self, folder: Path, workers: Map = map) -> list[tuple[DriveEstimate, ...]]:
        """Estimates of the drives of a folder that set bounds or calibrate."""
        drives = self.stored.manifest["drives"]
        known = {*drives["bounds"], *drives["calibration"]}
        experiments = [e for e in list_experiments(folder) if e.name in known]
        return list(workers(partial(estimated_file, self.first), experiments))


def _like(stored: StoredIdentification, scores: dict[str, float | None]) -> str:
    """First group whose largest score in every test is not exceeded."""
    tests: dict[str, Calibration] = {
        "frame": stored.calibration,
        "energy": stored.energy_of_core.calibration,
        "change": stored.change_of_core.calibration,
    }
    for group in sorted(stored.calibration.groups) or [ALL]:
        largest = {
            test: max(
                (s for d, s in c.scores.items() if group == ALL or c.recordings.groups.get(d) == group),
                default=0.0,
            )
            for test, c in tests.items()
        }
        if all(s is None or s <= largest[test] for test, s in scores.items()):
            return group
    return NEW
