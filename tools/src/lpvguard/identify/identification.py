"""`lpvguard identify`: drives -> unfalsified bounds -> weights -> calibrated frame test (paper, steps 1-7).

Writes a folder with

    bounds.json       bounds in each bin (bounds.py) and the window error of the estimator
    front.json        Pareto front nu(gamma_w) in each bin, and the chosen point on it
    model_error.json  the part of the error that the input explains, with its standard error, for the drives
                      that set the bounds and for those that judge them (model_error.py)
    weights.json      W_w of each output and W_delta with their certificates, and the final inflation
    calibration.json  scores, threshold, alpha
    energy.json       energy test: filters, certificate, sigma, scores, threshold (energy.py); only with Hann
                      frames
    change.json       change test: sizes, scores, threshold (change.py); only with Hann frames
    confirmation.json designs k of m of the frame test, compared; only with a rate (confirmation.py)
    joint.json        scores and threshold of all tests together; only with frame_test.joint
    pools.json        bounds of pools of frames, and the remainders behind them (pools.py); only with Hann
                      frames
    diagnosis.json    scales of the diagnosis of alarms (diagnosis.py); only with Hann frames
    isolation.json    scales of the search for the faulty part (isolation.py); only with [isolation]
    visibility.json   smallest visible gain and delay errors, at typical and at the strongest excitation
    spectra.npz       E, Z and mean speed of a sample of the frames of the bound-setting drives, for the
                      pictures and the trade-offs of step 8
    project.json      copy of the project file
    MANIFEST.json     inputs, drives, estimator, and the seal of the folder (base/artefacts.py)

Every pass maps a function over the drives (base/parallel.py) and joins its results as they arrive. Memory
does not grow with the number of drives, except for kept samples (KEPT_BYTES of passes.py). The bounds do not
depend on the number of workers or the order of the drives, not even in the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..base import artefacts
from ..base.errors import InputError
from ..base.parallel import Map
from ..base.progress import Progress
from ..base.sampling import Rows
from ..core.coefficients import Coefficients
from ..drives.frames import Estimator, not_for_the_core
from ..drives.tables import EXPERIMENTS, Experiment, table_hashes
from ..fit.quality import Quality
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project, parse_project
from .bounds import FRONT_POINTS, Bounds, Part, fold
from .calibration import Calibration
from .change import ChangeTest
from .confirmation import Confirmation
from .diagnosis import DiagnosisScales
from .drive_set import Chosen
from .drive_set import DriveSet as DriveSet
from .energy import EnergyTest
from .isolation import Isolation
from .model_error import ModelError
from .model_fit import drive_fit, require_better_than_none
from .over_drives import Origins, OverDrives
from .passes import spectra_file
from .pools import Pools
from .weights import (
    Weights,
    coefficients_of,
    energy_filters,
    fit_bound,
    fit_weights,
    smallest_disturbance,
    with_healthy,
)
from .window_error import window_error

Result = TypeVar("Result")
Test = TypeVar("Test", EnergyTest, ChangeTest, Pools)
ISOLATION = "isolation.json"
"""File of the isolation scales in folders of `identify` and `export`."""


def _quiet(_: str) -> None:
    pass


@dataclass(frozen=True)
class Identification:
    """Result of identify. The docstring of the module lists the files.

    Attributes
    ----------
    project : Project
    model : NominalModel
    estimator : Estimator
    bounds : Bounds
    model_error : ModelError
    weights : Weights
    calibration : Calibration
    energy : EnergyTest or None
    change : ChangeTest or None
    pools : Pools or None
    confirmation : Confirmation or None
    diagnosis : DiagnosisScales or None
    isolation : Isolation or None
    visibility : dict
    spectra : Rows
    bound_drives, calibration_drives, noise_drives : list[str]
    left_out, sha256 : dict[str, str]
    model_fit, others_fit : list[Quality]
    origins : Origins
    """

    project: Project
    model: NominalModel
    estimator: Estimator
    bounds: Bounds
    model_error: ModelError
    weights: Weights
    calibration: Calibration
    energy: EnergyTest | None
    change: ChangeTest | None
    pools: Pools | None
    confirmation: Confirmation | None
    diagnosis: DiagnosisScales | None
    isolation: Isolation | None
    visibility: dict
    spectra: Rows
    bound_drives: list[str]
    calibration_drives: list[str]
    noise_drives: list[str]
    left_out: dict[str, str]
    sha256: dict[str, str]
    model_fit: list[Quality]
    others_fit: list[Quality]
    origins: Origins


def _of_commands(drives: DriveSet, setting: list[Experiment], parts: list[Part]) -> Part:
    """Joined parts of the bound-setting drives for W_C. Raises InputError when there is no such drive."""
    splits = drives.reader.project.data.command_splits
    chosen = [p for e, p in zip(setting, parts, strict=True) if e.split in splits]
    if not chosen:
        raise drives.index_error(
            f"no drive has split {' or '.join(splits)}, from data.command_split",
            "at least one drive whose input is a usual command",
        )
    return fold(chosen)


def _ceiling(project: Project, estimator: Estimator, error: ModelError) -> np.ndarray:
    """Ceiling (K,) on nu at the bins, 0 at DC: that of the project, or else the band of the model error."""
    stated = project.bounds.nu_ceiling
    if stated is None:
        return error.at_bins(estimator).max(axis=1)
    return stated.at(estimator.omega / (2 * np.pi))


def _weighted(
    run: OverDrives, chosen: Chosen, error: ModelError, first: Part, noise: np.ndarray, command: np.ndarray
) -> tuple[Bounds, Weights]:
    """Bounds and weights of steps 4 to 7.

    ``first`` is the joined part of the bound-setting drives. ``noise`` (K, n_y) and ``command`` (K,) are
    peaks.
    """
    project, estimator = run.reader.project, run.reader.estimator
    gamma_w = fit_bound(project, estimator, first["gamma_rule"], "gamma_w", smallest_disturbance(first["B2"]))
    smooth = gamma_w.magnitude(estimator.omega)
    second, W_delta = run.uncertainty(first, smooth, error, chosen.setting)
    bounds = run.bounds(first, smooth, second, W_delta, chosen.setting)
    floor = np.fmax(bounds.B_w_floor, smallest_disturbance(bounds.B2))
    healthy = partial(run.healthy, error, floor, chosen.setting)
    rest = gamma_w, W_delta, noise, first["E"], command, run.workers
    if project.bounds.nu_ceiling is not None:
        weights = fit_weights(project, estimator, bounds, *rest)
        return bounds, replace(weights, healthy=healthy(*weights.at(estimator.omega)))
    own = healthy(np.column_stack([w.magnitude(estimator.omega) for w in W_delta]))
    # The set of the certificate must contain the healthy set, so that its refutation implies leaving the
    # latter.
    bounds = replace(bounds, B_w=np.fmax(bounds.B_w, own.B_w))
    weights = fit_weights(project, estimator, bounds, *rest)
    weights = with_healthy(project, estimator, weights, own, run.workers)
    return bounds, weights


def identify(
    project: Project,
    folder: Path,
    *,
    workers: Map = map,
    progress: Progress = _quiet,
    without: Collection[str] = (),
) -> tuple[Identification, DriveSet]:
    """Run steps 1-7 on a drive folder.

    Parameters
    ----------
    project : Project
    folder : Path, folder with the drives and experiments.csv
    workers : Map
    progress : Callable, reports progress
    without : Collection[str], drives to leave out, default ()

    Returns
    -------
    tuple of Identification and DriveSet

    Raises
    ------
    InputError
        If an input is not valid, no bound-setting drive has a frame, or no drive calibrates.

    References
    ----------
    Paper, steps 1-7; THEORY 3 to 7.
    """
    drives = DriveSet(project, NominalModel(project), folder, without)
    estimator, run = drives.reader.estimator, OverDrives(drives, workers, progress)
    hashes = table_hashes(list(drives.experiments.values()), workers)
    chosen = Chosen.by_split(drives)
    fit_of = partial(drive_fit, drives.reader)
    model_fit, others_fit = (
        list(run.over("model", fit_of, group)) for group in (chosen.setting, chosen.others)
    )
    require_better_than_none(drives, model_fit)
    error = run.model_error(chosen)
    ceiling = _ceiling(project, estimator, error)
    parts = list(run.first_parts(chosen.setting, ceiling, keep=True))
    first = fold(parts)
    command = _of_commands(drives, chosen.setting, parts)
    chosen = run.with_frames(chosen)
    progress("weights")
    noise_peak = np.full(first["E"].shape, np.nan)
    if chosen.noise:
        noise_peak = fold(run.first_parts(chosen.noise, ceiling, keep=False))["E"]
    bounds, weights = _weighted(run, chosen, error, first, noise_peak, command["Y"])
    weights, calibration, energy, change, pools, confirmation = run.calibrated(weights, bounds, chosen)
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
        pools=pools,
        confirmation=confirmation,
        diagnosis=run.diagnosis(change, chosen),
        isolation=run.isolation(chosen),
        visibility=run.visibility(weights, calibration, pools, change),
        spectra=run.spectra,
        bound_drives=[e.name for e in chosen.setting],
        calibration_drives=list(calibration.scores),
        noise_drives=[e.name for e in chosen.noise],
        left_out=drives.set_aside | run.left_out,
        sha256=hashes,
        model_fit=model_fit,
        others_fit=others_fit,
        origins=run.origins,
    )
    return result, drives


def _bounds_table(result: Identification) -> dict[str, np.ndarray]:
    """Content of bounds.json."""
    bounds, estimator = result.bounds, result.estimator
    error = window_error(result.model, estimator, result.project.seed)
    return {
        "omega_rad_s": bounds.omega,
        "length_samples": estimator.length,
        "frames": bounds.frames,
        "nu_ceiling": _ceiling(result.project, estimator, result.model_error),
        "excitation": bounds.excitation,
        "B1": bounds.B1,
        "B2": bounds.B2,
        "gamma_rule": bounds.gamma_rule,
        "gamma_w": bounds.gamma_w,
        "nu": bounds.nu,
        "B_w": bounds.B_w,
        "B_w_floor": bounds.B_w_floor,
        "resolution": bounds.resolution.step,
        "sensor_noise": bounds.resolution.noise,
        "window_error_median": error["median"],
        "window_error_percentile": error["percentile"],
    }


def save(result: Identification, drives: DriveSet, target: Path) -> None:
    """Write the identification folder, whole or not at all.

    Parameters
    ----------
    result : Identification
    drives : DriveSet, drives of the identification
    target : Path, new folder

    Raises
    ------
    InputError
        If the folder may not be replaced.
    """
    bounds, weights, joint = result.bounds, result.weights, result.calibration.joint
    table = _bounds_table(result)
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
                **({"joint.json": artefacts.to_json(joint.to_dict())} if joint else {}),
                **({"energy.json": artefacts.to_json(result.energy.to_dict())} if result.energy else {}),
                **({"change.json": artefacts.to_json(result.change.to_dict())} if result.change else {}),
                **({"pools.json": artefacts.to_json(result.pools.to_dict())} if result.pools else {}),
                **(
                    {"confirmation.json": artefacts.to_json(result.confirmation.to_dict())}
                    if result.confirmation
                    else {}
                ),
                **(
                    {"diagnosis.json": artefacts.to_json(result.diagnosis.to_dict())}
                    if result.diagnosis
                    else {}
                ),
                **({ISOLATION: artefacts.to_json(result.isolation.to_dict())} if result.isolation else {}),
                "visibility.json": artefacts.to_json(result.visibility),
                "project.json": artefacts.to_json(result.project.model_dump(by_alias=True)),
                "spectra.npz": spectra_file(result.spectra, result.bound_drives),
                artefacts.MANIFEST: artefacts.manifest(
                    "identify",
                    vehicle=result.project.name,
                    estimator_id=result.estimator.identifier(),
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
    """Identification that was read from its folder.

    Attributes
    ----------
    folder : Path
    manifest : dict
    project : Project
    model : NominalModel, of the project
    estimator : Estimator, of the project's frames
    bounds, front : dict of ndarray, contents of bounds.json and front.json by name
    weights : dict
    fitted : Weights
    calibration : Calibration
    energy : EnergyTest or None
    change : ChangeTest or None
    pools : Pools or None
    confirmation : Confirmation or None
    diagnosis : DiagnosisScales or None
    isolation : Isolation or None
    visibility : dict
    model_error : ModelError
    """

    folder: Path
    manifest: dict
    project: Project
    model: NominalModel
    estimator: Estimator
    bounds: dict[str, np.ndarray]
    weights: dict
    fitted: Weights
    calibration: Calibration
    energy: EnergyTest | None
    change: ChangeTest | None
    pools: Pools | None
    confirmation: Confirmation | None
    diagnosis: DiagnosisScales | None
    isolation: Isolation | None
    front: dict[str, np.ndarray]
    visibility: dict
    model_error: ModelError

    @property
    def designed(self) -> Project:
        """The project with the chosen confirmation of the frame test."""
        return self.project if self.confirmation is None else self.confirmation.of_project(self.project)

    @cached_property
    def coefficients(self) -> Coefficients:
        """Coefficients of the core. Raises InputError for an estimator that the core does not support."""
        threshold = self.calibration.exported
        return coefficients_of(
            self.designed,
            self.model,
            self.estimator,
            self.fitted,
            threshold,
            self.energy_of_core,
            self.change_of_core,
            None if self.pools is None else self.pools.beside(threshold, self.pools.calibration.exported),
        )

    def of_group(self, group: str) -> StoredIdentification:
        """The identification with the thresholds of a group.

        Raises InputError where no drive belongs to it.
        """
        known = sorted(self.calibration.groups)
        if group not in known:
            raise InputError(
                self.folder, "group", group, ", ".join(known) or f"groups, a column of {EXPERIMENTS}"
            )
        energy, change, pools = self.energy_of_core, self.change_of_core, self.pools
        return replace(
            self,
            calibration=self.calibration.of_group(group),
            pools=None if pools is None else replace(pools, calibration=pools.calibration.of_group(group)),
            energy=replace(energy, calibration=energy.calibration.of_group(group)),
            change=replace(change, calibration=change.calibration.of_group(group)),
        )

    @property
    def energy_of_core(self) -> EnergyTest:
        """The energy test. Raises InputError for an estimator that the core does not support."""
        if self.energy is None:
            raise not_for_the_core(self.project)
        return self.energy

    @property
    def change_of_core(self) -> ChangeTest:
        """The change test. Raises InputError for an estimator that the core does not support."""
        if self.change is None:
            raise not_for_the_core(self.project)
        return self.change


def _of_project(project: Project, path: Path, manifest: dict) -> tuple[NominalModel, Estimator]:
    """Model and estimator of a stored project. Raises InputError for an estimator of another kind."""
    with artefacts.reading(path):
        model = NominalModel(project)
        estimator = Estimator.from_project(project, model)
    if manifest.get("estimator_id") != estimator.identifier():
        raise InputError(
            path.parent / artefacts.MANIFEST,
            "estimator_id",
            f"{manifest.get('estimator_id')}",
            f"{estimator.identifier()}, the estimator of project.json",
        )
    return model, estimator


def _with_joint(test: Test, joint: Calibration) -> Test:
    return replace(test, calibration=replace(test.calibration, joint=joint))


def load(folder: Path) -> StoredIdentification:
    """Read an identification folder and prove its weights' certificates again.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    StoredIdentification

    Raises
    ------
    InputError
        If a file is not valid or was changed, or a certificate fails.
    """
    folder = Path(folder)
    manifest = artefacts.read_manifest(folder, "identify")

    def path_of(name: str) -> Path:
        return folder / f"{name}.json"

    def read(name: str, use: Callable[..., Result], *where: str) -> Result:
        with artefacts.reading(path_of(name)):
            return use(artefacts.read_json(path_of(name)), *where)

    def read_if_there(name: str, use: Callable[..., Result]) -> Result | None:
        return read(name, use) if path_of(name).is_file() else None

    project = read("project", parse_project, str(path_of("project")))
    bounds = read("bounds", lambda document: {k: np.array(v, float) for k, v in document.items()})
    model, estimator = _of_project(project, path_of("project"), manifest)
    weights, fitted = read("weights", lambda x: (x, Weights.from_dict(x, str(path_of("weights")))))
    calibration = read("calibration", Calibration.from_dict)
    energy = change = diagnosis = pools = confirmation = None
    if estimator.window == "hann":
        filters = energy_filters(project, estimator, fitted)
        energy = read("energy", filters.restored, str(path_of("energy")))
        change = read("change", ChangeTest.design(project).restored, str(path_of("change")))
        # Older identifications have neither pools nor diagnosis; a confirmation needs a rate.
        pools = read_if_there("pools", Pools.from_dict)
        confirmation = read_if_there("confirmation", Confirmation.from_dict)
        diagnosis = read_if_there("diagnosis", partial(DiagnosisScales.restored, project))
        if project.frame_test.joint:
            joint = read("joint", Calibration.from_dict)
            calibration = replace(calibration, joint=joint)
            energy, change = _with_joint(energy, joint), _with_joint(change, joint)
            pools = pools and _with_joint(pools, joint)
    isolation = read_if_there("isolation", Isolation.from_dict)
    front = read("front", lambda document: {k: np.array(document[k], float) for k in ("gamma_w", "nu")})
    return StoredIdentification(
        folder,
        manifest,
        project,
        model,
        estimator,
        bounds,
        weights,
        fitted,
        calibration,
        energy,
        change,
        pools,
        confirmation,
        diagnosis,
        isolation,
        front,
        read("visibility", dict),
        read("model_error", partial(ModelError.from_dict, project, estimator)),
    )
