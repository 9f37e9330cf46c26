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
from .bounds import Bounds, FrameSet, counted_frames, disturbance_bounds, nominal_error, peak_magnitudes, uncertainty_bounds
from .calibration import Calibration, calibrate, score
from .core import Core
from .drives import EXPERIMENTS, Drive, Experiment, file_hash, list_experiments, read_drive, require_units
from .errors import InputError
from .export import Coefficients, build_coefficients, vehicle_files
from .frames import Estimator
from .nominal import NominalModel
from .project import Project, parse_project
from .weights import OverboundFit, Weight, fit_overbound, subtract_noise, verify_overbound

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
class FittedWeight:
    """A weight with the samples it was fitted above: omega, bound (K',) (NaN: no data)."""

    fit: OverboundFit
    omega: np.ndarray
    bound: np.ndarray

    def magnitude(self, omega: np.ndarray) -> np.ndarray:
        return self.fit.weight.magnitude(omega)

    def to_dict(self) -> dict:
        f = self.fit
        return {"weight": f.weight.to_dict(), "order": f.order, "worst_ratio_db": f.worst_ratio_db,
                "lp_optimum_db": f.lp_optimum_db, "certificate": f.certificate, "floored_rad_s": list(f.floored),
                "breaks_outside_rad_s": list(f.breaks_outside), "omega_rad_s": self.omega, "bound": self.bound}


@dataclass(frozen=True)
class Weights:
    """Fitted weights. ``inflation`` multiplies W_w, W_n and W_delta wherever they are used.

    W_w, W_n and W_w_S0 hold one weight per output. Without zero-input drives W_n is empty, and so are W_w_S0 and W_C,
    which only synthesis needs. W_w_S0: disturbance of class S0, where nothing is left to uncertainty (K_inf).
    ``floored``: step 7, frequencies [rad/s] per weight where nothing was left of B_w after the sensor's share.
    """

    W_w: list[FittedWeight]
    W_delta: FittedWeight
    gamma_w: FittedWeight
    W_n: list[FittedWeight]
    W_w_S0: list[FittedWeight]
    W_C: list[FittedWeight]
    floored: dict[str, list[float]]
    disturbance_set: str
    inflation: float = 1.0

    def at(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """W_delta (K,) and B_w (K, n_y) as the monitor uses them: inflation included, the sensor's share put back."""
        B_w = np.column_stack([w.magnitude(omega) for w in self.W_w])
        if self.W_n:
            W_n = np.column_stack([w.magnitude(omega) for w in self.W_n])
            B_w = np.hypot(B_w, W_n) if self.disturbance_set == "covering" else B_w + W_n
        return self.inflation * self.W_delta.magnitude(omega), self.inflation * B_w

    def to_dict(self) -> dict:
        lists = {key: [w.to_dict() for w in getattr(self, key)] for key in ("W_w", "W_n", "W_w_S0", "W_C")}
        return lists | {"W_delta": self.W_delta.to_dict(), "gamma_w": self.gamma_w.to_dict(), "floored_rad_s": self.floored,
                        "disturbance_set": self.disturbance_set, "inflation": self.inflation}

    @classmethod
    def from_dict(cls, data: dict, source: str) -> Weights:
        """Read back; every certificate is proved anew against its samples, a failing one is an InputError."""

        def weight(entry: dict, name: str) -> FittedWeight:
            omega = np.array(entry["omega_rad_s"], float)
            bound = np.array([np.nan if b is None else b for b in entry["bound"]], float)
            loaded = Weight.from_dict(entry["weight"])
            certificate = verify_overbound(loaded, omega, bound, name=name)
            if not certificate.ok:
                raise InputError(source, name, f"the weight falls to {certificate.min_ratio:.6f} of its bound at "
                                 f"{certificate.min_ratio_at:.4g} rad/s", "a weight that overbounds its data")
            fit = OverboundFit(loaded, entry["order"], entry["worst_ratio_db"], entry["lp_optimum_db"], 1.0,
                               certificate.to_dict(), {}, tuple(entry["floored_rad_s"]), tuple(entry["breaks_outside_rad_s"]))
            return FittedWeight(fit, omega, bound)

        lists = {key: [weight(e, f"{key}[{j}]") for j, e in enumerate(data[key])] for key in ("W_w", "W_n", "W_w_S0", "W_C")}
        return cls(**lists, W_delta=weight(data["W_delta"], "W_delta"), gamma_w=weight(data["gamma_w"], "gamma_w"),
                   floored=data["floored_rad_s"], disturbance_set=data["disturbance_set"], inflation=data["inflation"])


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
    noise_drives: list[str]
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


def fitting_grid(estimator: Estimator) -> np.ndarray:
    omega = estimator.omega.copy()
    omega[0] = DC_STAND_IN * omega[1]
    return omega


def _floor(B2: np.ndarray) -> float:
    """Smallest disturbance bound: a weight must be positive where a bound is zero."""
    return 1e-6 * float(np.nanmax(B2))


def uncertainty_samples(estimator: Estimator, nu: np.ndarray) -> np.ndarray:
    """What W_delta must cover: the running maximum of nu from the lowest bin up, nothing at DC.

    Neglected dynamics grow with frequency, and a dip in nu only tells that no frame happened to need uncertainty there.
    nu(0) = 0 by definition; below the lowest bin any small value will do (paper, step 6).
    """
    running = np.fmax.accumulate(np.where(estimator.cycles > 0, np.fmax(nu, SMALLEST_NU), SMALLEST_NU))
    return np.where((estimator.cycles > 0) & np.isfinite(nu), running, np.nan)


def _fit_settings(project: Project) -> dict:
    return {"max_order": project.weights.max_order, "tol_db": project.weights.tolerance_db}


def _fit(project: Project, estimator: Estimator, bound: np.ndarray, name: str, floor: float) -> FittedWeight:
    omega = fitting_grid(estimator)
    # What the weight is proved against: the floor applied.
    raised = np.where(np.isnan(bound), np.nan, np.fmax(bound, floor))
    return FittedWeight(fit_overbound(omega, raised, name=name, **_fit_settings(project)), omega, raised)


def fit_weights(project: Project, estimator: Estimator, bounds: Bounds, gamma_w: FittedWeight,
                noise: np.ndarray, error: np.ndarray, command: np.ndarray) -> Weights:
    """Steps 6 and 7. ``noise``, ``error`` (K, n_y): peaks of E without and with input; ``command`` (K,): of the first output.

    Without zero-input drives (``noise`` all NaN) B_w itself is W_w.
    """
    floor = _floor(bounds.B2)
    omega, names = fitting_grid(estimator), [s.name for s in project.outputs]

    def fit_all(bound: np.ndarray, what: str) -> list[FittedWeight]:
        return [_fit(project, estimator, bound[:, j], f"{what} of {n}", floor) for j, n in enumerate(names)]

    W_delta = _fit(project, estimator, uncertainty_samples(estimator, bounds.nu), "nu", SMALLEST_NU)
    chosen = {"disturbance_set": project.bounds.disturbance_set}
    B_w = fit_all(bounds.B_w, "B_w")
    if np.isnan(noise).all():
        return Weights(B_w, W_delta, gamma_w, [], [], [], {}, **chosen)
    W_n = fit_all(noise, "W_n")
    # A covering set is an ellipsoid: n_y outputs at their peaks together need sqrt(n_y).
    cover = np.sqrt(project.n_y) if project.bounds.disturbance_set == "covering" else 1.0
    floored: dict[str, list[float]] = {}

    def without_noise(B: list[FittedWeight], what: str) -> list[FittedWeight]:
        left = []
        for j, b in enumerate(B):
            values, empty = subtract_noise(b.magnitude(omega), W_n[j].magnitude(omega), omega, floor=floor, **chosen)
            floored[f"{what} of {names[j]}"] = empty
            left.append(values)
        return fit_all(np.column_stack(left), what)

    return Weights(without_noise(B_w, "W_w"), W_delta, gamma_w, W_n,
                   without_noise(fit_all(cover * error, "B_w of S0"), "W_w of S0"),
                   [_fit(project, estimator, command, "W_C", floor)], floored, **chosen)


@contextmanager
def _scratch_core(project: Project, coefficients: Coefficients) -> Iterator[Core]:
    """A core compiled from coefficients in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / project.name
        target.mkdir()
        artefacts.write_files(target, vehicle_files(project, coefficients, {}))
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
    others = [e.name for e in experiments if e.split not in (*project.data.bound_split, *project.data.noise_split)]
    if not bound_drives:
        raise InputError(Path(folder) / EXPERIMENTS, "column split",
                         f"no drive has split {' or '.join(project.data.bound_split)}",
                         "at least one drive that sets the bounds")

    noise_drives = [e.name for e in experiments if e.split in project.data.noise_split]

    def frames_of(names: list[str]) -> Iterator[Iterator[FrameSet]]:
        for name in names:
            progress(f"frames of {name}")
            yield counted_frames(*drives.load(name), estimator)

    def source() -> Iterator[Iterator[FrameSet]]:
        return frames_of(bound_drives)

    nu_ceiling = project.bounds.nu_ceiling.at(estimator.omega / (2 * np.pi))
    bounds = disturbance_bounds(source, estimator, nu_ceiling)
    if not bounds.frames.any():
        raise InputError(folder, "split " + ", ".join(project.data.bound_split), "no frame counts: no judged stretch at all",
                         f"speed in {model.speed_range[0]:g}..{model.speed_range[1]:g} m/s, steady within "
                         f"{estimator.speed_tolerance:.0%} for {estimator.length[-1] * estimator.Ts:.3g} s or more")
    progress("weights")
    gamma_w = _fit(project, estimator, bounds.gamma_rule, "gamma_w", _floor(bounds.B2))
    uncertainty_bounds(source, estimator, bounds, gamma_w.magnitude(estimator.omega), project.n_y,
                       structure=project.bounds.structure, disturbance_set=project.bounds.disturbance_set)
    noise, _ = peak_magnitudes(frames_of(noise_drives), estimator, project.n_y)
    error, output = peak_magnitudes(source(), estimator, project.n_y)
    weights = fit_weights(project, estimator, bounds, gamma_w, noise, error, output[:, 0])

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
    result = Identification(project, model, estimator, bounds, weights, calibration, bound_drives, list(scores), noise_drives,
                            left_out)
    return result, drives


def save(result: Identification, drives: DriveSet, target: Path) -> None:
    """Write the identification folder, whole or not at all."""
    bounds, estimator = result.bounds, result.estimator
    table = {"omega_rad_s": bounds.omega, "length_samples": estimator.length, "frames": bounds.frames,
             "nu_ceiling": result.project.bounds.nu_ceiling.at(bounds.omega / (2 * np.pi)),
             "excitation": bounds.excitation, "B1": bounds.B1, "B2": bounds.B2, "gamma_rule": bounds.gamma_rule,
             "gamma_w": bounds.gamma_w, "nu": bounds.nu, "B_w": bounds.B_w}
    inputs = {name: file_hash(e.path) for name, e in drives.experiments.items()}
    with artefacts.new_folder(target) as folder:
        artefacts.write_files(folder, {
            "bounds.json": artefacts.to_json(table),
            "weights.json": artefacts.to_json(result.weights.to_dict()),
            "calibration.json": artefacts.to_json(result.calibration.to_dict()),
            "project.json": artefacts.to_json(result.project.model_dump(by_alias=True)),
            "spectra.npz": _spectra(result, drives),
            artefacts.MANIFEST: artefacts.manifest(
                "identify", vehicle=result.project.name, estimator_id=estimator.identifier(),
                drives={"bounds": result.bound_drives, "calibration": result.calibration_drives,
                        "noise": result.noise_drives, "left_out": result.left_out},
                drivers={n: e.driver for n, e in drives.experiments.items()}, sha256=inputs)})


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
    fitted: Weights
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
    fitted = Weights.from_dict(weights, str(folder / "weights.json"))
    coefficients = coefficients_of(project, model, estimator, fitted, calibration.threshold)
    return StoredIdentification(folder, manifest, project, bounds, weights, fitted, calibration, coefficients)
