"""`lpvguard identify`: drives -> unfalsified bounds -> weights -> calibrated frame test (paper, steps 1-7).

Writes a folder with

    bounds.json       bounds per bin (bounds.py), by the drives that set them
    weights.json      W_w per output and W_delta with their certificates, and the final inflation
    calibration.json  scores, threshold, alpha
    spectra.npz       E and Z of the frames on the core's grid, for the pictures
    project.json      the project file as it was
    MANIFEST.json     inputs, drives, estimator
"""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from . import artefacts
from .bounds import Bounds, FrameSet, counted_frames, disturbance_bounds, nominal_error, uncertainty_bounds
from .calibration import Calibration, calibrate, score
from .core import Core
from .drives import EXPERIMENTS, Drive, Experiment, file_hash, list_experiments, read_drive, require_units
from .errors import InputError
from .export import Coefficients, build_coefficients, vehicle_files, write_files
from .frames import Estimator
from .nominal import NominalModel
from .project import Project, parse_project
from .weights import OverboundFit, Weight, fit_overbound, verify_overbound

DC_STAND_IN = 0.1
"""DC has no place on a logarithmic axis: its bound stands at this fraction of the lowest bin's frequency."""
SMALLEST_NU = 1e-3
"""Floor of the uncertainty bound where the data ask for none; a weight must be positive."""
CUTS = 5
"""Random first samples from which every bound-setting drive is replayed to find the final inflation."""
DRIVES_IN_MEMORY = 4

Progress = Callable[[str], None]


def _quiet(_: str) -> None:
    pass


@dataclass(frozen=True)
class Weights:
    """Fitted weights: ``W_w`` per output, ``W_delta``; ``inflation`` multiplies all of them and is included already."""

    W_w: list[OverboundFit]
    W_delta: OverboundFit
    gamma: OverboundFit
    inflation: float

    def at(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """W_delta (K,) and B_w (K, n_y) at the bins, inflation included."""
        B_w = np.column_stack([w.weight.magnitude(omega) for w in self.W_w])
        return self.inflation * self.W_delta.weight.magnitude(omega), self.inflation * B_w


@dataclass(frozen=True)
class Identification:
    """Everything that identify finds; see the module's docstring for the files."""

    project: Project
    model: NominalModel
    estimator: Estimator
    bounds: Bounds
    weights: Weights
    calibration: Calibration
    bound_drives: list[str]
    calibration_drives: list[str]
    left_out: dict[str, str]


class DriveSet:
    """The drives of a folder, read when asked for; a few are kept, so memory does not grow with their number."""

    def __init__(self, project: Project, model: NominalModel, experiments: list[Experiment]):
        self.project, self.model, self.estimator = project, model, Estimator.of(project, model)
        self.experiments = {e.name: e for e in experiments}
        self.load = lru_cache(DRIVES_IN_MEMORY)(self._load)

    def _load(self, name: str) -> tuple[Drive, np.ndarray, np.ndarray]:
        path = self.experiments[name].path
        drive = read_drive(path, self.project)
        e, yhat = nominal_error(drive, self.model)
        require_units(path, drive, yhat, self.estimator.settled(drive.v))
        return drive, e, yhat


def _fitting_grid(estimator: Estimator) -> np.ndarray:
    omega = estimator.omega.copy()
    omega[0] = DC_STAND_IN * omega[1]
    return omega


def _floor(B2: np.ndarray) -> float:
    """Smallest disturbance bound: a weight must be positive where a bound is zero."""
    return 1e-6 * float(np.nanmax(B2))


def _uncertainty_samples(estimator: Estimator, nu: np.ndarray) -> np.ndarray:
    """What W_delta must cover: the running maximum of nu from the lowest bin up, nothing at DC.

    Neglected dynamics grow with frequency, and a dip in nu only tells that no frame happened to need uncertainty there.
    nu(0) = 0 by definition; below the lowest bin any small value will do (paper, step 6).
    """
    running = np.fmax.accumulate(np.where(estimator.cycles > 0, np.fmax(nu, SMALLEST_NU), SMALLEST_NU))
    return np.where((estimator.cycles > 0) & np.isfinite(nu), running, np.nan)


def _fit_settings(project: Project) -> dict:
    return {"max_order": project.weights.max_order, "tol_db": project.weights.tolerance_db}


def smooth_disturbance_bound(project: Project, estimator: Estimator, bounds: Bounds) -> OverboundFit:
    """Step 4: a smooth gamma_w above what the rule asks for."""
    return fit_overbound(_fitting_grid(estimator), bounds.gamma_rule, floor=_floor(bounds.B2), name="gamma_w",
                         **_fit_settings(project))


def fit_weights(project: Project, estimator: Estimator, bounds: Bounds, gamma: OverboundFit) -> Weights:
    """Step 6: W_w over B_w of each output and W_delta over nu."""
    omega, settings = _fitting_grid(estimator), _fit_settings(project)
    W_w = [fit_overbound(omega, bounds.B_w[:, j], floor=_floor(bounds.B2), name=f"B_w of {s.name}", **settings)
           for j, s in enumerate(project.outputs)]
    W_delta = fit_overbound(omega, _uncertainty_samples(estimator, bounds.nu), name="nu", **settings)
    return Weights(W_w, W_delta, gamma, 1.0)


@contextmanager
def _scratch_core(project: Project, coefficients: Coefficients) -> Iterator[Core]:
    """A core compiled from coefficients in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / project.name
        target.mkdir()
        write_files(target, vehicle_files(project, coefficients, {}))
        yield Core(target)


def _final_inflation(drives: DriveSet, names: list[str], core: Core, seed: int) -> float:
    """Least factor >= 1 on the weights with which the compiled core finds no margin above 1 on a bound-setting drive,
    whole or with its first samples cut; rounded up by 1e-4 when it is above 1."""
    random = np.random.default_rng(seed)
    worst = 1.0
    for name in names:
        drive = drives.load(name)[0]
        for cut in [0, *random.integers(1, max(2, len(drive.t) // 2), CUTS).tolist()]:
            frames = core.monitor().run_drive(drive.from_sample(cut)).frames
            if frames.counted.any():
                worst = max(worst, float(frames.margin[frames.counted].max()))
    return worst if worst == 1.0 else worst * (1 + 1e-4)


def coefficients_of(project: Project, model: NominalModel, estimator: Estimator, weights: Weights,
                    threshold: float) -> Coefficients:
    """The core's coefficients for these weights."""
    return build_coefficients(project, model, estimator, *weights.at(estimator.omega), threshold)


def identify(project: Project, folder: Path, *, progress: Progress = _quiet) -> tuple[Identification, DriveSet]:
    """Run steps 1-7 on a drive folder.

    Raises InputError for bad input and when no frame of a bound-setting drive counts.
    """
    model = NominalModel(project)
    estimator = Estimator.of(project, model)
    experiments = list_experiments(Path(folder))
    drives = DriveSet(project, model, experiments)
    bound_drives = [e.name for e in experiments if e.split in project.data.bound_split]
    others = [e.name for e in experiments if e.split not in project.data.bound_split]
    if not bound_drives:
        raise InputError(Path(folder) / EXPERIMENTS, "column split",
                         f"no drive has split {' or '.join(project.data.bound_split)}",
                         "at least one drive that sets the bounds")

    def source() -> Iterator[Iterator[FrameSet]]:
        for name in bound_drives:
            progress(f"frames of {name}")
            yield counted_frames(*drives.load(name), estimator)

    nu_ceiling = project.bounds.nu_ceiling.at(estimator.omega / (2 * np.pi))
    bounds = disturbance_bounds(source, estimator, nu_ceiling)
    if not bounds.frames.any():
        raise InputError(folder, "split " + ", ".join(project.data.bound_split), "no frame counts: no judged stretch at all",
                         f"speed in {model.speed_range[0]:g}..{model.speed_range[1]:g} m/s, steady within "
                         f"{estimator.speed_tolerance:.0%} for {estimator.length[-1] * estimator.Ts:.3g} s or more")
    progress("weights")
    gamma = smooth_disturbance_bound(project, estimator, bounds)
    uncertainty_bounds(source, estimator, bounds, gamma.weight.magnitude(estimator.omega), project.n_y,
                       structure=project.bounds.structure, disturbance_set=project.bounds.disturbance_set)
    weights = fit_weights(project, estimator, bounds, gamma)

    progress("compiling the core")
    with _scratch_core(project, coefficients_of(project, model, estimator, weights, 1.0)) as core:
        weights = replace(weights, inflation=_final_inflation(drives, bound_drives, core, project.seed))
        reals = coefficients_of(project, model, estimator, weights, 1.0).flat_reals()
        scores, left_out = {}, {}
        for name in others:
            progress(f"score of {name}")
            value = score(core.monitor(reals=reals, seal=True).run_drive(drives.load(name)[0]))
            if value is None:
                left_out[name] = "no frame counts: speed out of range or not steady"
            else:
                scores[name] = value
    calibration = calibrate(scores, project.frame_test.alpha)
    result = Identification(project, model, estimator, bounds, weights, calibration, bound_drives, list(scores), left_out)
    return result, drives


def save(result: Identification, drives: DriveSet, target: Path) -> None:
    """Write the identification folder, whole or not at all."""
    bounds, estimator = result.bounds, result.estimator
    table = {"omega_rad_s": bounds.omega, "length_samples": estimator.length, "frames": bounds.frames,
             "nu_ceiling": result.project.bounds.nu_ceiling.at(bounds.omega / (2 * np.pi)),
             "excitation": bounds.excitation, "B1": bounds.B1, "B2": bounds.B2, "gamma_rule": bounds.gamma_rule,
             "gamma_w": bounds.gamma_w, "nu": bounds.nu, "B_w": bounds.B_w}
    weights = result.weights
    inputs = {name: file_hash(e.path) for name, e in drives.experiments.items()}
    with artefacts.new_folder(target) as folder:
        write_files(folder, {
            "bounds.json": artefacts.to_json(table),
            "weights.json": artefacts.to_json({
                "inflation": weights.inflation, "W_w": [_fit_dict(f) for f in weights.W_w],
                "W_delta": _fit_dict(weights.W_delta), "gamma_w": _fit_dict(weights.gamma)}),
            "calibration.json": artefacts.to_json(result.calibration.to_dict()),
            "project.json": artefacts.to_json(result.project.model_dump(by_alias=True)),
            "spectra.npz": _spectra(result, drives),
            artefacts.MANIFEST: artefacts.manifest(
                "identify", vehicle=result.project.name, estimator_id=estimator.identifier(),
                drives={"bounds": result.bound_drives, "calibration": result.calibration_drives,
                        "left_out": result.left_out},
                drivers={n: e.driver for n, e in drives.experiments.items()}, sha256=inputs)})


def _fit_dict(fit: OverboundFit) -> dict:
    return {"weight": fit.weight.to_dict(), "order": fit.order, "worst_ratio_db": fit.worst_ratio_db,
            "lp_optimum_db": fit.lp_optimum_db, "certificate": fit.certificate, "floored_rad_s": list(fit.floored)}


def _spectra(result: Identification, drives: DriveSet) -> bytes:
    """Frames on the core's grid of all drives: columns drive, bin, start, E, Z."""
    names = list(drives.experiments)
    columns: dict[str, list[np.ndarray]] = {key: [] for key in ("drive", "bin", "start", "E", "Z")}
    for index, name in enumerate(names):
        for s in counted_frames(*drives.load(name), result.estimator, hop_only=True):
            columns["drive"].append(np.full(len(s.starts), index))
            columns["bin"].append(np.full(len(s.starts), s.bin))
            columns["start"].append(s.starts)
            columns["E"].append(s.E)
            columns["Z"].append(s.Z)
    stream = io.BytesIO()
    np.savez(stream, names=np.array(names), **{k: np.concatenate(v) for k, v in columns.items()})
    return stream.getvalue()


@dataclass(frozen=True)
class StoredIdentification:
    """An identification folder read back: what export, evaluate and report need."""

    folder: Path
    manifest: dict
    project: Project
    bounds: dict[str, np.ndarray]
    weights: dict
    calibration: Calibration
    coefficients: Coefficients


def load(folder: Path) -> StoredIdentification:
    """Read an identification folder; the weights' certificates are proved anew, and a failing one is an InputError."""
    folder = Path(folder)
    manifest = artefacts.read_manifest(folder, "identify")
    project = parse_project(artefacts.read_json(folder / "project.json"), str(folder / "project.json"))
    bounds = {k: np.array(v, float) for k, v in artefacts.read_json(folder / "bounds.json").items()}
    weights = artefacts.read_json(folder / "weights.json")
    calibration = Calibration(**artefacts.read_json(folder / "calibration.json"))
    model = NominalModel(project)
    estimator = Estimator.of(project, model)
    if manifest["estimator_id"] != estimator.identifier():
        raise InputError(folder / artefacts.MANIFEST, "estimator_id", f"{manifest['estimator_id']:#010x}",
                         f"{estimator.identifier():#010x}, the estimator that project.json describes")
    omega = _fitting_grid(estimator)

    def weight(entry: dict, bound: np.ndarray, name: str) -> Weight:
        loaded = Weight.from_dict(entry["weight"])
        certificate = verify_overbound(loaded, omega, bound, name=name)
        if not certificate.ok:
            raise InputError(folder / "weights.json", name, f"the weight falls to {certificate.min_ratio:.6f} of its bound "
                             f"at {certificate.min_ratio_at:.4g} rad/s", "a weight that overbounds its data")
        return loaded

    floor = _floor(bounds["B2"])
    W_w = [weight(e, np.fmax(bounds["B_w"][:, j], floor), f"W_w[{j}]") for j, e in enumerate(weights["W_w"])]
    W_delta = weight(weights["W_delta"], _uncertainty_samples(estimator, bounds["nu"]), "W_delta")
    inflation = weights["inflation"]
    coefficients = build_coefficients(project, model, estimator, inflation * W_delta.magnitude(estimator.omega),
                                      inflation * np.column_stack([w.magnitude(estimator.omega) for w in W_w]),
                                      calibration.threshold)
    return StoredIdentification(folder, manifest, project, bounds, weights, calibration, coefficients)
