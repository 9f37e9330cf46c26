"""`lpvguard identify`: drives -> unfalsified bounds -> weights -> calibrated frame test (paper, steps 1-7).

Writes a folder with

    bounds.json       bounds per bin (bounds.py), by the drives that set them, and the estimator's window
                      error
    front.json        Pareto front nu(gamma_w) per bin, and the point on it that was taken
    model_error.json  the part of the error that follows the input, with its standard error, of the drives
                      that set the bounds and of those that judge them (model_error.py)
    weights.json      W_w per output and W_delta with their certificates, and the final inflation
    calibration.json  scores, threshold, alpha
    energy.json       energy test: filters, certificate, sigma, scores, threshold (energy.py); with Hann
                      frames only
    change.json       change test: sizes, scores, threshold (change.py); likewise
    diagnosis.json    scales of the diagnosis of alarms (diagnosis.py); likewise
    visibility.json   smallest visible gain and delay errors, at typical and at the strongest excitation met
    spectra.npz       E, Z and mean speed of frames of the bound-setting drives, thinned, for the pictures and
                      step 8's trade-offs
    project.json      the project file as it was
    MANIFEST.json     inputs, drives, estimator, and the seal of all of it (base/artefacts.py)

Every pass is one map over the drives (base/parallel.py) whose results are joined as they come: memory does
not grow with the number of drives, and neither the number of workers nor the order of the drives changes a
bit of the bounds.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ..base import artefacts
from ..base.errors import InputError
from ..base.parallel import Map
from ..base.progress import Progress
from ..base.sampling import Rows, stacked
from ..core.coefficients import Coefficients
from ..core.compiled import Core
from ..drives.frames import Estimator, not_for_the_core
from ..drives.tables import (
    EXPERIMENTS,
    Experiment,
    list_experiments,
    set_aside,
    table_hashes,
)
from ..fit.quality import Quality
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project, parse_project
from .bounds import FRONT_POINTS, Bounds, Deciders, Part, fold, front_grid
from .calibration import Calibration, Peak, Recordings, calibrate
from .change import ChangeTest
from .chosen import Chosen
from .chosen import DriveSet as DriveSet
from .diagnosis import DiagnosisScales
from .energy import EnergyTest
from .model_error import FEWEST_FRAMES, FOLDS, ErrorGrid, ModelError, Sums, model_error_pass
from .model_fit import drive_fit, require_better_than_none
from .passes import (
    DriveReader,
    Judged,
    change_met_pass,
    change_products_pass,
    covering_pass,
    diagnosis_pass,
    energy_pass,
    first_pass,
    judge,
    remainder_pass,
    spectra_file,
    thinned,
    uncertainty_pass,
)
from .scratch import scratch_core
from .visibility import Excitation, visibility
from .weights import (
    FittedWeight,
    Weights,
    coefficients_of,
    energy_filters,
    fit_bound,
    fit_uncertainty,
    fit_weights,
    smallest_disturbance,
)
from .window_error import window_error

CUTS = 5
"""Random first samples from which every bound-setting drive is replayed to find the final inflation."""
JOINED_AT_ONCE = 32
"""Samples of so many drives wait to be joined: sorting them together costs the process that joins less
time."""

"""Takes what a run does next, in words."""
Result = TypeVar("Result")


def _quiet(_: str) -> None:
    pass


@dataclass(frozen=True)
class Identification:
    """Everything that identify finds; see the module's docstring for the files. ``model_fit``: of the drives
    that set the bounds; ``others_fit``: of those that do not. ``evidence`` (K,): largest of the bound-setting
    drives by bin; empty without a core. ``peaks``: where the scores come from, by calibration drive and test.
    ``decided``: which frames decide nu and B_w."""

    project: Project
    model: NominalModel
    estimator: Estimator
    bounds: Bounds
    model_error: ModelError
    weights: Weights
    calibration: Calibration
    energy: EnergyTest | None
    change: ChangeTest | None
    diagnosis: DiagnosisScales | None
    visibility: dict
    spectra: Rows
    bound_drives: list[str]
    calibration_drives: list[str]
    noise_drives: list[str]
    left_out: dict[str, str]
    sha256: dict[str, str]
    model_fit: list[Quality]
    others_fit: list[Quality]
    evidence: np.ndarray
    peaks: dict[str, dict[str, Peak]]
    decided: dict[str, Deciders]


class _Run:
    """Passes over the drives: mapped by ``workers``, joined as they come.

    ``left_out``: drive -> why it has no counted frame; ``spectra``, ``met``: samples joined so far;
    ``evidence`` (K,): largest of the bound-setting drives by bin, once these are judged; ``peaks``: where the
    scores of each calibration drive come from, by test; ``decided``: which frames decide nu and B_w.
    """

    def __init__(self, reader: DriveReader, workers: Map, progress: Progress):
        self.reader, self.workers, self.progress = reader, workers, progress
        self.left_out: dict[str, str] = {}
        self._spectra: list[Rows] = []
        self._met: list[Excitation] = []
        self._judged_s: dict[str, float] = {}
        self.evidence = np.zeros(0)
        self.peaks: dict[str, dict[str, Peak]] = {}
        self.decided: dict[str, Deciders] = {}

    def over(
        self, what: str, task: Callable[[Experiment], Result], chosen: Iterable[Experiment]
    ) -> Iterator[Result]:
        """``task`` of every chosen drive, in order."""
        chosen = list(chosen)
        for e, result in zip(chosen, self.workers(task, chosen), strict=False):
            self.progress(f"{what} of {e.name}")
            yield result

    def first_parts(self, chosen: list[Experiment], *, keep: bool) -> Iterator[Part]:
        """Bounds before smoothing and peaks of every drive; with ``keep`` its spectra are sampled too."""
        ceiling = self.reader.project.bounds.nu_ceiling.at(self.reader.estimator.omega / (2 * np.pi))
        task = partial(first_pass, self.reader, ceiling)
        for e, (part, rows) in zip(chosen, self.over("frames", task, chosen), strict=False):
            if not part["frames"].any():
                self.left_out[e.name] = self.reader.why_without_frames()
            if keep:
                self._spectra.append(rows)
                if len(self._spectra) == JOINED_AT_ONCE:
                    self._spectra = [self.spectra]
            yield part

    @property
    def spectra(self) -> Rows:
        """Sample of the frames of all drives so far."""
        return thinned(stacked(self._spectra))

    def setting_with_frames(self, setting: list[Experiment], folder: Path) -> list[Experiment]:
        """The bound-setting drives that were not left out; InputError when none remains."""
        left = [e for e in setting if e.name not in self.left_out]
        if not left:
            name, reason = next(iter(self.left_out.items()))
            raise InputError(
                folder,
                "split " + ", ".join(self.reader.project.data.bound_split),
                "no frame counts: no judged stretch at all",
                f"at least one drive unlike {name} ({reason})",
            )
        return left

    def model_error(self, drives: Chosen) -> ModelError:
        """The model error model of the bound-setting drives, and that of the drives that judge it."""
        reader = self.reader
        grid = ErrorGrid.of(reader.project, reader.estimator)
        task = partial(model_error_pass, reader, grid)

        def folds(chosen: list[Experiment]) -> list[Sums]:
            # By name: sums of floats depend on the order.
            chosen = sorted(chosen, key=lambda e: e.name)
            found: list[Sums] = []
            for k, sums in enumerate(self.over("model error", task, chosen)):
                if k < FOLDS:
                    found.append(sums)
                else:
                    found[k % FOLDS] = found[k % FOLDS].plus(sums)
            return found

        return ModelError.of(reader.project, grid, folds(drives.setting), folds(drives.others))

    def _deciders(
        self, key: str, columns: int, setting: list[Experiment], parts: Iterable[Part]
    ) -> Iterator[Part]:
        """The parts of the ``setting`` drives, in whose passing it is kept what decides the bound ``key``."""
        self.decided[key] = Deciders(key, (self.reader.estimator.n_bins, columns))
        return self.decided[key].watched((e.name for e in setting), parts)

    def uncertainty(
        self, first: Part, gamma_w: np.ndarray, error: ModelError, setting: list[Experiment]
    ) -> tuple[Part, list[FittedWeight]]:
        """Step 5, and W_delta above it and above the model error."""
        project, estimator = self.reader.project, self.reader.estimator
        grid = front_grid(first["B1"], first["B2"], estimator, project.bounds.structure)
        parts = self.over("bounds", partial(uncertainty_pass, self.reader, gamma_w, grid), setting)
        second = fold(self._deciders("nu", project.n_delta, setting, parts))
        names = [f"W_delta of {s.name}" for s in project.outputs] if project.n_delta > 1 else ["W_delta"]
        # Class S0 has no uncertainty: all error is disturbance.
        needed = error.bound * (project.bounds.structure != "S0")
        W_delta = [
            fit_uncertainty(project, estimator, nu, error.grid.omega, asked, name)
            for nu, asked, name in zip(second["nu"].T, needed.T, names, strict=True)
        ]
        return second | {"grid": grid}, W_delta

    def bounds(
        self,
        first: Part,
        gamma_w: np.ndarray,
        second: Part,
        W_delta: list[FittedWeight],
        setting: list[Experiment],
    ) -> Bounds:
        """Step 6: B_w is what no |delta| <= W_delta explains. ``covering``: B_w is scaled until sum_j |w_j /
        B_w,j|^2 <= 1 on every frame; ``paper``: |w_j| <= B_w,j."""
        project, estimator = self.reader.project, self.reader.estimator
        size = np.column_stack([w.magnitude(estimator.omega) for w in W_delta])
        parts = self.over("bounds", partial(remainder_pass, self.reader, size), setting)
        B_w = fold(self._deciders("B_w", project.n_y, setting, parts))["B_w"]
        if project.bounds.disturbance_set == "covering" and project.n_y > 1:
            task = partial(covering_pass, self.reader, size, B_w)
            B_w = B_w * np.fmax(1.0, fold(self.over("bounds", task, setting))["scale"])[:, None]
        return Bounds(
            omega=estimator.omega,
            **{k: first[k] for k in ("frames", "excitation", "B1", "B2", "gamma_rule")},
            gamma_w=gamma_w,
            nu=second["nu"],
            B_w=B_w,
            front_gamma_w=second["grid"],
            front_nu=second["front"],
        )

    def calibrated(
        self, weights: Weights, frames: np.ndarray, drives: Chosen
    ) -> tuple[Weights, Calibration, EnergyTest | None, ChangeTest | None]:
        """Weights with their final inflation, and the tests with their thresholds; the plain DFT has the
        frame test only. ``frames`` (K,): counted frames of the bound-setting drives."""
        project, model, estimator = self.reader.project, self.reader.model, self.reader.estimator
        alpha, recordings = project.frame_test.alpha, Recordings.listed(drives.setting, drives.others)
        if estimator.window != "hann":
            inflated = self._inflated(weights, None, drives)
            scores, _, _ = self._scores(weights, None, None, drives)
            scores = {n: s / inflated.inflation for n, s in scores.items()}
            by_frames = calibrate(scores, alpha, recordings=recordings).over(self._judged_s)
            return inflated, by_frames, None, None
        filters, change = energy_filters(project, estimator, weights), self._change_test(drives)
        with scratch_core(
            project, coefficients_of(project, model, estimator, weights, 1.0, filters, change)
        ) as core:
            inflated = self._inflated(weights, core, drives)
            inflated = replace(inflated, silent=self._silent(inflated, frames))
            test = self._energy_test(inflated, drives)
            reals = coefficients_of(project, model, estimator, inflated, 1.0, test, change).flat_reals()
            scores, energy_scores, change_scores = self._scores(weights, core, reals, drives)
            test = test.calibrated(energy_scores, alpha, recordings)
            change = change.calibrated(change_scores, alpha, recordings)
            return (
                inflated,
                calibrate(scores, alpha, recordings=recordings).over(self._judged_s),
                replace(test, calibration=test.calibration.over(self._judged_s)),
                replace(change, calibration=change.calibration.over(self._judged_s)),
            )

    def visibility(self, weights: Weights, calibration: Calibration) -> dict:
        """What the judged drives could have refuted, by bin: visibility.json."""
        of, factor = self.reader.estimator, weights.inflation
        W_delta = weights.at(of.omega)[0] / factor
        return visibility(
            of.omega, of.speed_range, self.met, W_delta, calibration.carried, factor, weights.silent
        )

    @property
    def met(self) -> Excitation:
        """Excitation of all judged drives so far."""
        return Excitation.joined(self._met)

    def _judged(
        self,
        what: str,
        weights: Weights,
        core: Core | None,
        reals: np.ndarray | None,
        cuts: int,
        chosen: list[Experiment],
    ) -> Iterator[Judged]:
        task = partial(judge, self.reader, *weights.at(self.reader.estimator.omega), core, reals, cuts)
        for j in self.over(what, task, chosen):
            self._met.append(j.met)
            if len(self._met) == JOINED_AT_ONCE:
                self._met = [self.met]
            yield j

    def _inflated(self, weights: Weights, core: Core | None, drives: Chosen) -> Weights:
        """The final inflation: the least factor >= 1 on the weights with which no margin is above 1 on a
        bound-setting drive, whole or with its first samples cut; rounded up by 1e-4 when it is above 1."""
        judged = self._judged("inflation", weights, core, None, CUTS, drives.setting)
        worst = max([1.0, *(j.worst for j in judged)])
        return replace(weights, inflation=worst if worst == 1.0 else worst * (1 + 1e-4))

    def _silent(self, inflated: Weights, frames: np.ndarray) -> tuple[int, ...]:
        """Bins in which no drive that sets the bounds shows evidence above 1, once `_inflated` judged them:
        there a vehicle that does not respond would never have been refuted. And bins of fewer than
        FEWEST_FRAMES ``frames`` one after another: a further frame is beyond so few too often."""
        estimator = self.reader.estimator
        self.evidence = self.met.evidence(estimator.n_bins) / inflated.inflation
        thin = frames < FEWEST_FRAMES * estimator.length
        return tuple(int(k) for k in np.flatnonzero((self.evidence <= 1.0) | thin))

    def _energy_test(self, inflated: Weights, drives: Chosen) -> EnergyTest:
        """The energy test with the sigma that the drives with and without input ask for."""
        test = energy_filters(self.reader.project, self.reader.estimator, inflated)
        chosen = drives.setting + drives.noise
        test = test.with_sigma(fold(self.over("sigma", partial(energy_pass, self.reader, test, 0), chosen)))
        task = partial(energy_pass, self.reader, test, CUTS)
        return test.with_joint(fold(self.over("joint sigma", task, chosen)))

    def _change_test(self, drives: Chosen) -> ChangeTest:
        """The change test with the sizes that the bound-setting drives show."""
        sums = self.over("change", partial(change_products_pass, self.reader), drives.setting)
        test = ChangeTest.design(self.reader.project).with_moments(np.sum(list(sums), axis=0))
        # By name: sums of floats depend on the order.
        chosen = sorted(drives.setting, key=lambda e: e.name)
        met = self.over("change", partial(change_met_pass, self.reader, test), chosen)
        return test.with_sizes(reduce(operator.add, met))

    def diagnosis(self, change: ChangeTest | None, drives: Chosen) -> DiagnosisScales | None:
        """Scales of the diagnosis, by the sizes of the change test; None without that."""
        if change is None:
            return None
        task = partial(diagnosis_pass, self.reader, 1 / change.unit)
        windows = list(self.over("diagnosis", task, drives.setting))
        return DiagnosisScales.of(self.reader.project, change.unit, windows)

    def _scores(
        self, weights: Weights, core: Core | None, reals: np.ndarray | None, drives: Chosen
    ) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
        """Scores of the calibration drives in frame, energy and change test; adds to ``left_out`` and to the
        times judged."""
        scores, energy_scores, change_scores = {}, {}, {}
        judged = self._judged("score", weights, core, reals, 0, drives.others)
        for e, j in zip(drives.others, judged, strict=False):
            self._judged_s[e.name] = j.judged_s
            self.peaks[e.name] = j.peaks
            if j.score is None:
                self.left_out[e.name] = self.reader.why_without_frames()
            else:
                scores[e.name] = j.score
            if j.energy_score is not None:
                energy_scores[e.name] = j.energy_score
            if j.change_score is not None:
                change_scores[e.name] = j.change_score
        return scores, energy_scores, change_scores


def _of_commands(project: Project, setting: list[Experiment], parts: list[Part], folder: Path) -> Part:
    """The parts of the bound-setting drives that W_C is from, joined; InputError when there is none."""
    splits = project.data.command_splits
    chosen = [p for e, p in zip(setting, parts, strict=True) if e.split in splits]
    if not chosen:
        raise InputError(
            folder / EXPERIMENTS,
            "column split",
            f"no drive has split {' or '.join(splits)}, of data.command_split",
            "at least one drive whose input is a command as in use",
        )
    return fold(chosen)


def identify(
    project: Project,
    folder: Path,
    *,
    workers: Map = map,
    progress: Progress = _quiet,
    without: Collection[str] = (),
) -> tuple[Identification, DriveSet]:
    """Run steps 1-7 on a drive folder but for the drives ``without``; ``workers``: base/parallel.py.

    Raises InputError for bad input and when no frame of a bound-setting drive counts.
    """
    experiments = [e for e in list_experiments(Path(folder)) if e.name not in without]
    drives = DriveSet(project, NominalModel(project), experiments)
    estimator, run = drives.reader.estimator, _Run(drives.reader, workers, progress)
    hashes = table_hashes(experiments, workers)
    chosen = Chosen.by_split(project, experiments, Path(folder))
    fit_of = partial(drive_fit, drives.reader)
    model_fit, others_fit = (list(run.over("model", fit_of, of)) for of in (chosen.setting, chosen.others))
    require_better_than_none(project, model_fit, Path(folder))
    parts = list(run.first_parts(chosen.setting, keep=True))
    first = fold(parts)
    command = _of_commands(project, chosen.setting, parts, Path(folder))
    chosen = replace(chosen, setting=run.setting_with_frames(chosen.setting, folder))
    progress("weights")
    noise_peak = np.full(first["E"].shape, np.nan)
    if chosen.noise:
        noise_peak = fold(run.first_parts(chosen.noise, keep=False))["E"]
    gamma_w = fit_bound(project, estimator, first["gamma_rule"], "gamma_w", smallest_disturbance(first["B2"]))
    error, smooth = run.model_error(chosen), gamma_w.magnitude(estimator.omega)
    second, W_delta = run.uncertainty(first, smooth, error, chosen.setting)
    bounds = run.bounds(first, smooth, second, W_delta, chosen.setting)
    weights = fit_weights(
        project, estimator, bounds, gamma_w, W_delta, noise_peak, first["E"], command["Y"][:, 0]
    )
    weights, calibration, energy, change = run.calibrated(weights, bounds.frames, chosen)
    progress("window error")
    result = Identification(
        project=project,
        model=drives.reader.model,
        estimator=estimator,
        bounds=bounds,
        model_error=error,
        weights=weights,
        calibration=calibration,
        energy=energy,
        change=change,
        diagnosis=run.diagnosis(change, chosen),
        visibility=run.visibility(weights, calibration),
        spectra=run.spectra,
        bound_drives=[e.name for e in chosen.setting],
        calibration_drives=list(calibration.scores),
        noise_drives=[e.name for e in chosen.noise],
        left_out=set_aside(Path(folder)) | run.left_out,
        sha256=hashes,
        model_fit=model_fit,
        others_fit=others_fit,
        evidence=run.evidence,
        peaks=run.peaks,
        decided=run.decided,
    )
    return result, drives


def save(result: Identification, drives: DriveSet, target: Path) -> None:
    """Write the identification folder, whole or not at all."""
    bounds, estimator, weights = result.bounds, result.estimator, result.weights
    error = window_error(result.model, estimator, result.project.seed)
    table = {
        "omega_rad_s": bounds.omega,
        "length_samples": estimator.length,
        "frames": bounds.frames,
        "nu_ceiling": result.project.bounds.nu_ceiling.at(bounds.omega / (2 * np.pi)),
        "excitation": bounds.excitation,
        "B1": bounds.B1,
        "B2": bounds.B2,
        "gamma_rule": bounds.gamma_rule,
        "gamma_w": bounds.gamma_w,
        "nu": bounds.nu,
        "B_w": bounds.B_w,
        "window_error_median": error["median"],
        "window_error_percentile": error["percentile"],
    }
    front = {
        "omega_rad_s": bounds.omega,
        "points": FRONT_POINTS,
        "gamma_w": bounds.front_gamma_w,
        "nu": bounds.front_nu,
        "taken": {"gamma_w": bounds.gamma_w, "nu": bounds.nu},
    }
    with artefacts.new_folder(target, "identify", result.project.name) as folder:
        artefacts.write_files(
            folder,
            {
                "bounds.json": artefacts.to_json(table),
                "front.json": artefacts.to_json(front),
                "model_error.json": artefacts.to_json(result.model_error.to_dict(result.project)),
                "weights.json": artefacts.to_json(weights.to_dict()),
                "calibration.json": artefacts.to_json(result.calibration.to_dict()),
                **({"energy.json": artefacts.to_json(result.energy.to_dict())} if result.energy else {}),
                **({"change.json": artefacts.to_json(result.change.to_dict())} if result.change else {}),
                **(
                    {"diagnosis.json": artefacts.to_json(result.diagnosis.to_dict())}
                    if result.diagnosis
                    else {}
                ),
                "visibility.json": artefacts.to_json(result.visibility),
                "project.json": artefacts.to_json(result.project.model_dump(by_alias=True)),
                "spectra.npz": spectra_file(result.spectra, result.bound_drives),
                artefacts.MANIFEST: artefacts.manifest(
                    "identify",
                    vehicle=result.project.name,
                    estimator_id=estimator.identifier(),
                    drives={
                        "bounds": result.bound_drives,
                        "calibration": result.calibration_drives,
                        "noise": result.noise_drives,
                        "left_out": result.left_out,
                    },
                    drivers={n: e.driver for n, e in drives.experiments.items()},
                    sha256=result.sha256,
                ),
            },
        )


@dataclass(frozen=True)
class StoredIdentification:
    """An identification folder read back: what export, evaluate and report need."""

    folder: Path
    manifest: dict
    project: Project
    bounds: dict[str, np.ndarray]
    weights: dict
    fitted: Weights
    calibration: Calibration
    energy: EnergyTest | None
    change: ChangeTest | None
    diagnosis: DiagnosisScales | None
    front: dict[str, np.ndarray]
    visibility: dict
    model_error: ModelError

    @cached_property
    def coefficients(self) -> Coefficients:
        """The core's coefficients; InputError for bounds of an estimator that the core does not compute."""
        model = NominalModel(self.project)
        return coefficients_of(
            self.project,
            model,
            Estimator.of(self.project, model),
            self.fitted,
            self.calibration.carried,
            self.energy_of_core,
            self.change_of_core,
        )

    def of_group(self, group: str) -> StoredIdentification:
        """With the thresholds of all tests for drives of a group; InputError where no drive is of it."""
        known = sorted(self.calibration.groups)
        if group not in known:
            raise InputError(
                self.folder, "group", group, ", ".join(known) or f"groups, a column of {EXPERIMENTS}"
            )
        energy, change = self.energy_of_core, self.change_of_core
        return replace(
            self,
            calibration=self.calibration.of_group(group),
            energy=replace(energy, calibration=energy.calibration.of_group(group)),
            change=replace(change, calibration=change.calibration.of_group(group)),
        )

    @property
    def energy_of_core(self) -> EnergyTest:
        """The energy test; InputError for bounds of an estimator that the core does not compute."""
        if self.energy is None:
            raise not_for_the_core(self.project)
        return self.energy

    @property
    def change_of_core(self) -> ChangeTest:
        """The change test; InputError for bounds of an estimator that the core does not compute."""
        if self.change is None:
            raise not_for_the_core(self.project)
        return self.change


def load(folder: Path) -> StoredIdentification:
    """Read an identification folder; the weights' certificates are proved anew, and a failing one is an
    InputError."""
    folder = Path(folder)
    manifest = artefacts.read_manifest(folder, "identify")

    def read(name: str, use: Callable[[Any, str], Result]) -> Result:
        path = folder / f"{name}.json"
        with artefacts.reading(path):
            return use(artefacts.read_json(path), str(path))

    project = read("project", parse_project)
    bounds = read("bounds", lambda document, _: {k: np.array(v, float) for k, v in document.items()})
    calibration = read("calibration", lambda document, _: Calibration.from_dict(document))
    with artefacts.reading(folder / "project.json"):
        model = NominalModel(project)
        estimator = Estimator.of(project, model)
    if manifest.get("estimator_id") != estimator.identifier():
        raise InputError(
            folder / artefacts.MANIFEST,
            "estimator_id",
            f"{manifest.get('estimator_id')}",
            f"{estimator.identifier()}, the estimator that project.json describes",
        )
    weights, fitted = read("weights", lambda document, where: (document, Weights.from_dict(document, where)))
    energy = change = diagnosis = None
    if estimator.window == "hann":
        energy = read("energy", energy_filters(project, estimator, fitted).restored)
        change = read("change", ChangeTest.design(project).restored)
        if (folder / "diagnosis.json").is_file():  # an identification of before has none
            diagnosis = read("diagnosis", lambda document, _: DiagnosisScales.restored(project, document))
    front = read("front", lambda document, _: {k: np.array(document[k], float) for k in ("gamma_w", "nu")})
    return StoredIdentification(
        folder,
        manifest,
        project,
        bounds,
        weights,
        fitted,
        calibration,
        energy,
        change,
        diagnosis,
        front,
        read("visibility", lambda document, _: dict(document)),
        read("model_error", lambda document, _: ModelError.from_dict(project, estimator, document)),
    )
