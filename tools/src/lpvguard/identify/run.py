"""`lpvguard identify`: drives -> unfalsified bounds -> weights -> calibrated frame test (paper, steps 1-7).

Writes a folder with

    bounds.json       bounds per bin (bounds.py), by the drives that set them, and the estimator's window
                      error
    front.json        Pareto front nu(gamma_w) per bin, and the point on it that was taken
    weights.json      W_w per output and W_delta with their certificates, and the final inflation
    calibration.json  scores, threshold, alpha
    energy.json       energy test: filters, certificate, sigma, scores, threshold (energy.py); with Hann
                      frames only
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

import io
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base import artefacts
from ..base.errors import InputError
from ..base.parallel import Map
from ..base.sampling import Rows, first_of_each, row_hash, stacked
from ..core.coefficients import Coefficients, build_coefficients, vehicle_files
from ..core.compiled import Core
from ..drives.frames import Estimator
from ..drives.tables import EXPERIMENTS, Drive, Experiment, list_experiments, read_drive, require_units
from ..engine.overbound.certificate import verify_overbound
from ..engine.overbound.fit import OverboundFit, fit_overbound
from ..engine.overbound.noise import subtract_noise
from ..engine.overbound.weight import Weight
from ..engine.validation import s1
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project, parse_project
from .bounds import (
    FRONT_POINTS,
    Bounds,
    FrameSet,
    Part,
    counted_frames,
    fold,
    front_grid,
    nominal_error,
    reduce_covering,
    reduce_disturbance,
    reduce_uncertainty,
)
from .calibration import Calibration, calibrate, energy_score, score
from .energy import EnergyTest
from .visibility import Excitation, visibility
from .window_error import window_error

DC_STAND_IN = 0.1
"""DC has no place on a logarithmic axis: its bound stands at this fraction of the lowest bin's frequency."""
SMALLEST_NU = 1e-3
"""Floor of the uncertainty bound where the data ask for none; a weight must be positive."""
LEAST_SHARE = 0.1
"""Floor of step 7, as a part of B_w: less is left only where two weights happen to be equal, each of them a
fit to some tenths of a dB. A floor above what is left covers it; one far below would stand as a chasm in the
bound, which no weight of low order follows."""
CUTS = 5
"""Random first samples from which every bound-setting drive is replayed to find the final inflation."""
LARGEST_SPECTRA, DRAWN_SPECTRA = 250, 750
"""Frames a bin in spectra.npz: those of largest |E|, and a draw by hash among all."""

JOINED_AT_ONCE = 32
"""Samples of so many drives wait to be joined: sorting them together costs the process that joins less
time."""

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
        return {
            "weight": f.weight.to_dict(),
            "order": f.order,
            "worst_ratio_db": f.worst_ratio_db,
            "lp_optimum_db": f.lp_optimum_db,
            "certificate": f.certificate,
            "floored_rad_s": list(f.floored),
            "breaks_outside_rad_s": list(f.breaks_outside),
            "omega_rad_s": self.omega,
            "bound": self.bound,
        }


@dataclass(frozen=True)
class Weights:
    """Fitted weights. ``inflation`` multiplies W_w, W_n and W_delta wherever they are used.

    W_w, W_n and W_w_S0 hold one weight per output. Without zero-input drives W_n is empty, and so are W_w_S0
    and W_C, which only synthesis needs. W_w_S0: disturbance of class S0, where nothing is left to uncertainty
    (K_inf). ``floored``: step 7, frequencies [rad/s] per weight where nothing was left of B_w after the
    sensor's share.
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
        """W_delta (K,) and B_w (K, n_y) as the monitor uses them: inflation included, the sensor's share put
        back."""
        B_w = np.column_stack([w.magnitude(omega) for w in self.W_w])
        if self.W_n:
            W_n = np.column_stack([w.magnitude(omega) for w in self.W_n])
            B_w = np.hypot(B_w, W_n) if self.disturbance_set == "covering" else B_w + W_n
        return self.inflation * self.W_delta.magnitude(omega), self.inflation * B_w

    def to_dict(self) -> dict:
        lists = {key: [w.to_dict() for w in getattr(self, key)] for key in ("W_w", "W_n", "W_w_S0", "W_C")}
        return lists | {
            "W_delta": self.W_delta.to_dict(),
            "gamma_w": self.gamma_w.to_dict(),
            "floored_rad_s": self.floored,
            "disturbance_set": self.disturbance_set,
            "inflation": self.inflation,
        }

    @classmethod
    def from_dict(cls, data: dict, source: str) -> Weights:
        """Read back; every certificate is proved anew against its samples, a failing one is an InputError."""

        def weight(entry: dict, name: str) -> FittedWeight:
            omega = np.array(entry["omega_rad_s"], float)
            bound = np.array([np.nan if b is None else b for b in entry["bound"]], float)
            loaded = Weight.from_dict(entry["weight"])
            certificate = verify_overbound(loaded, omega, bound, name=name)
            if not certificate.ok:
                raise InputError(
                    source,
                    name,
                    f"the weight falls to {certificate.min_ratio:.6f} of its bound at "
                    f"{certificate.min_ratio_at:.4g} rad/s",
                    "a weight that overbounds its data",
                )
            fit = OverboundFit(
                loaded,
                entry["order"],
                entry["worst_ratio_db"],
                entry["lp_optimum_db"],
                1.0,
                certificate.to_dict(),
                {},
                tuple(entry["floored_rad_s"]),
                tuple(entry["breaks_outside_rad_s"]),
            )
            return FittedWeight(fit, omega, bound)

        lists = {
            key: [weight(e, f"{key}[{j}]") for j, e in enumerate(data[key])]
            for key in ("W_w", "W_n", "W_w_S0", "W_C")
        }
        return cls(
            **lists,
            W_delta=weight(data["W_delta"], "W_delta"),
            gamma_w=weight(data["gamma_w"], "gamma_w"),
            floored=data["floored_rad_s"],
            disturbance_set=data["disturbance_set"],
            inflation=data["inflation"],
        )


@dataclass(frozen=True)
class Identification:
    """Everything that identify finds; see the module's docstring for the files."""

    project: Project
    model: NominalModel
    estimator: Estimator
    bounds: Bounds
    weights: Weights
    calibration: Calibration
    energy: EnergyTest | None
    visibility: dict
    spectra: Rows
    bound_drives: list[str]
    calibration_drives: list[str]
    noise_drives: list[str]
    left_out: dict[str, str]
    sha256: dict[str, str]


class DriveReader:
    """Reads drives and takes their frames; what is sent to a worker."""

    def __init__(self, project: Project, model: NominalModel):
        self.project, self.model, self.estimator = project, model, Estimator.of(project, model)
        _ = model.table  # made here once, not by every worker

    def read(self, experiment: Experiment) -> tuple[Drive, np.ndarray, np.ndarray]:
        """The drive, its nominal error e and nominal output yhat (N, n_y)."""
        drive = read_drive(experiment.path, self.project)
        e, yhat = nominal_error(drive, self.model)
        require_units(experiment.path, drive, yhat, self.estimator.settled(drive.v))
        return drive, e, yhat

    def frames(self, experiment: Experiment) -> Iterator[FrameSet]:
        """The counted frames of a drive, bin by bin."""
        return counted_frames(*self.read(experiment), self.model, self.estimator)

    def why_without_frames(self) -> str:
        """Why a drive has no counted frame."""
        low, high = self.estimator.speed_range
        return (
            f"no frame counts: nowhere {self.estimator.length.min() * self.estimator.Ts:g} s within {low:g}..{high:g} m/s and "
            f"{self.estimator.speed_tolerance:.0%} of their mean speed"
            + (
                f", {self.estimator.settle * self.estimator.Ts:.3g} s after entering"
                if self.estimator.settle
                else ""
            )
        )


class DriveSet:
    """The drives of a folder, read when asked for and not kept."""

    def __init__(self, project: Project, model: NominalModel, experiments: list[Experiment]):
        self.reader = DriveReader(project, model)
        self.experiments = {e.name: e for e in experiments}

    def load(self, name: str) -> tuple[Drive, np.ndarray, np.ndarray]:
        return self.reader.read(self.experiments[name])


def fitting_grid(estimator: Estimator) -> np.ndarray:
    omega = estimator.omega.copy()
    omega[0] = DC_STAND_IN * omega[1]
    return omega


def smallest_disturbance(B2: np.ndarray) -> float:
    """Smallest disturbance bound: a weight must be positive where a bound is zero."""
    return 1e-6 * float(np.nanmax(B2))


def uncertainty_samples(estimator: Estimator, nu: np.ndarray) -> np.ndarray:
    """What W_delta must cover: the running maximum of nu from the lowest bin up, nothing at DC.

    Neglected dynamics grow with frequency, and a dip in nu only tells that no frame happened to need
    uncertainty there. nu(0) = 0 by definition; below the lowest bin any small value will do (paper, step 6).
    """
    running = np.fmax.accumulate(np.where(estimator.cycles > 0, np.fmax(nu, SMALLEST_NU), SMALLEST_NU))
    return np.where((estimator.cycles > 0) & np.isfinite(nu), running, np.nan)


def _fit_settings(project: Project) -> dict:
    return {"max_order": project.weights.max_order, "tol_db": project.weights.tolerance_db}


def fit_bound(
    project: Project, estimator: Estimator, bound: np.ndarray, name: str, floor: float
) -> FittedWeight:
    omega = fitting_grid(estimator)
    # What the weight is proved against: the floor applied.
    raised = np.where(np.isnan(bound), np.nan, np.fmax(bound, floor))
    return FittedWeight(fit_overbound(omega, raised, name=name, **_fit_settings(project)), omega, raised)


def fit_weights(
    project: Project,
    estimator: Estimator,
    bounds: Bounds,
    gamma_w: FittedWeight,
    noise: np.ndarray,
    error: np.ndarray,
    command: np.ndarray,
) -> Weights:
    """Steps 6 and 7. ``noise``, ``error`` (K, n_y): peaks of E without and with input; ``command`` (K,): of
    the first output.

    Without zero-input drives (``noise`` all NaN) B_w itself is W_w.
    """
    floor = smallest_disturbance(bounds.B2)
    names = [s.name for s in project.outputs]

    def fit_all(bound: np.ndarray, what: str) -> list[FittedWeight]:
        return [
            fit_bound(project, estimator, bound[:, j], f"{what} of {n}", floor) for j, n in enumerate(names)
        ]

    W_delta = fit_bound(project, estimator, uncertainty_samples(estimator, bounds.nu), "nu", SMALLEST_NU)
    chosen = {"disturbance_set": project.bounds.disturbance_set}
    B_w = fit_all(bounds.B_w, "B_w")
    if np.isnan(noise).all():
        return Weights(B_w, W_delta, gamma_w, [], [], [], {}, **chosen)
    W_n = fit_all(noise, "W_n")
    # A covering set is an ellipsoid: n_y outputs at their peaks together need sqrt(n_y).
    cover = np.sqrt(project.n_y) if project.bounds.disturbance_set == "covering" else 1.0
    floored: dict[str, list[float]] = {}

    def without_noise(B: list[FittedWeight], what: str) -> list[FittedWeight]:
        weights, empty = disturbance_weights(project, estimator, B, W_n, floor, what)
        floored.update({f"{what} of {n}": e for n, e in zip(names, empty, strict=False)})
        return weights

    return Weights(
        without_noise(B_w, "W_w"),
        W_delta,
        gamma_w,
        W_n,
        without_noise(fit_all(cover * error, "B_w of S0"), "W_w of S0"),
        [fit_bound(project, estimator, command, "W_C", floor)],
        floored,
        **chosen,
    )


def disturbance_weights(
    project: Project,
    estimator: Estimator,
    B_w: list[FittedWeight],
    W_n: list[FittedWeight],
    floor: float,
    what: str = "W_w",
) -> tuple[list[FittedWeight], list[list[float]]]:
    """Step 7: W_w per output, what is left of B_w after the sensor's share, and the frequencies [rad/s] where
    nothing is."""
    omega, weights, floored = fitting_grid(estimator), [], []
    for b, noise, output in zip(B_w, W_n, project.outputs, strict=True):
        left, empty = subtract_noise(
            b.magnitude(omega),
            noise.magnitude(omega),
            omega,
            floor=np.fmax(floor, LEAST_SHARE * b.magnitude(omega)),
            disturbance_set=project.bounds.disturbance_set,
        )
        weights.append(fit_bound(project, estimator, left, f"{what} of {output.name}", floor))
        floored.append(empty)
    return weights, floored


@contextmanager
def _scratch_core(project: Project, coefficients: Coefficients) -> Iterator[Core]:
    """A core compiled from coefficients in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / project.name
        target.mkdir()
        artefacts.write_files(target, vehicle_files(project, coefficients, {}))
        yield Core(target)


def coefficients_of(
    project: Project,
    model: NominalModel,
    estimator: Estimator,
    weights: Weights,
    threshold: float,
    energy: EnergyTest,
) -> Coefficients:
    """The core's coefficients for these weights."""
    return build_coefficients(project, model, estimator, *weights.at(estimator.omega), threshold, energy)


def energy_filters(project: Project, estimator: Estimator, weights: Weights) -> EnergyTest:
    """The energy test's filters for these weights; sigma is yet to be found."""
    fitted = weights.W_delta
    return EnergyTest.design(
        project, estimator, fitted.fit.weight, fitted.omega, fitted.bound, weights.inflation
    )


# ---------------------------------------------------------------------------------- what is done to one drive


def _spectra_rows(s: FrameSet, name: str, v: np.ndarray, estimator: Estimator) -> Rows:
    """The frames that the core would see, as rows of a sample; ``v`` (N,): the drive's speed."""
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
        "speed": np.array([v[a : a + estimator.length[s.bin]].mean() for a in start], float),
        "drive": np.full(len(start), name, dtype=object),
        "E": E,
        "Z": Z,
    }


def _thinned(rows: Rows) -> Rows:
    """LARGEST_SPECTRA and DRAWN_SPECTRA rows a bin, each once; of the union of two thinned parts again those
    of all."""
    both = stacked([first_of_each(rows, LARGEST_SPECTRA, "weakness"), first_of_each(rows, DRAWN_SPECTRA)])
    order = np.lexsort((both["hash"], both["group"]))
    both = {k: v[order] for k, v in both.items()}
    new = np.r_[True, (np.diff(both["hash"]) != 0) | (np.diff(both["group"]) != 0)][: len(order)]
    return {k: v[new] for k, v in both.items()}


def _first_pass(reader: DriveReader, nu_ceiling: np.ndarray, experiment: Experiment) -> tuple[Part, Rows]:
    """Bounds before smoothing, peaks, and a sample of the spectra."""
    rows: list[Rows] = []
    drive, e, yhat = reader.read(experiment)

    def watched() -> Iterator[FrameSet]:
        for s in counted_frames(drive, e, yhat, reader.model, reader.estimator):
            rows.append(_spectra_rows(s, experiment.name, drive.v, reader.estimator))
            yield s

    part = reduce_disturbance(watched(), reader.estimator, nu_ceiling, reader.project.n_y)
    return part, _thinned(stacked(rows))


def _uncertainty_pass(
    reader: DriveReader, gamma_w: np.ndarray, grid: np.ndarray, experiment: Experiment
) -> Part:
    return reduce_uncertainty(
        reader.frames(experiment),
        reader.estimator,
        gamma_w,
        grid,
        reader.project.n_y,
        reader.project.bounds.structure,
    )


def _covering_pass(reader: DriveReader, gamma_w: np.ndarray, B_w: np.ndarray, experiment: Experiment) -> Part:
    return reduce_covering(
        reader.frames(experiment), reader.estimator, gamma_w, B_w, reader.project.bounds.structure
    )


class Judged(NamedTuple):
    """What the tests say of a drive: its largest margin, its scores (None: nothing judged), and its
    excitation."""

    worst: float
    score: float | None
    energy_score: float | None
    met: Excitation


def _judge(
    reader: DriveReader,
    W_delta: np.ndarray,
    B_w: np.ndarray,
    core: Core | None,
    reals: np.ndarray | None,
    cuts: int,
    experiment: Experiment,
) -> Judged:
    """Judge a drive, whole and (for ``worst``) from ``cuts`` random first samples, by the compiled core;
    without one (plain DFT) by the exact margin under W_delta (K,), B_w (K, n_y)."""
    speed_range, name = reader.estimator.speed_range, experiment.name
    drive, e, yhat = reader.read(experiment)
    if core is None:
        sets = list(counted_frames(drive, e, yhat, reader.model, reader.estimator))
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
            Excitation.of(name, speed_range, bin_of, speed, Z, W_delta, B_w, start),
        )
    worst = 0.0
    for cut in _first_samples(reader, name, len(drive.t), cuts):
        run = core.monitor(reals=reals, seal=reals is not None).run_drive(drive.from_sample(cut))
        counted = run.frames.counted
        worst = max(worst, float(run.frames.margin[counted].max(initial=0.0)))
        if cut == 0:
            whole, of_whole = run, counted
    f = whole.frames
    met = Excitation.of(
        name,
        speed_range,
        f.bin[of_whole],
        f.speed[of_whole],
        f.Z[of_whole],
        W_delta,
        B_w,
        np.round(f.t_end_s[of_whole] * 1e6).astype(np.int64),
    )
    return Judged(worst, score(whole), energy_score(whole), met)


def _first_samples(reader: DriveReader, name: str, samples: int, cuts: int) -> list[int]:
    """0 and ``cuts`` random first samples in the first half of a drive."""
    # A stream of random numbers for each drive: the other drives and their order make no difference.
    random = np.random.default_rng([reader.project.seed, zlib.crc32(name.encode())])
    return [0, *random.integers(1, max(2, samples // 2), cuts).tolist()]


def _energy_pass(reader: DriveReader, test: EnergyTest, cuts: int, experiment: Experiment) -> Part:
    """What a drive asks of sigma: whole, from rest; with its first samples cut, from what Delta may
    remember."""
    drive = reader.read(experiment)[0]

    def parts() -> Iterator[Part]:
        for cut in _first_samples(reader, experiment.name, len(drive.t), cuts):
            rest = drive.from_sample(cut)
            yield (test if cut else test.at_rest()).needs(*nominal_error(rest, reader.model), rest.v)

    return fold(parts())


# ------------------------------------------------------------------------------------------------- all drives


def identify(
    project: Project, folder: Path, *, workers: Map = map, progress: Progress = _quiet
) -> tuple[Identification, DriveSet]:
    """Run steps 1-7 on a drive folder, with the drives mapped by ``workers`` (base/parallel.py).

    Raises InputError for bad input and when no frame of a bound-setting drive counts.
    """
    model = NominalModel(project)
    experiments = list_experiments(Path(folder))
    drives = DriveSet(project, model, experiments)
    reader, estimator = drives.reader, drives.reader.estimator
    setting = [e for e in experiments if e.split in project.data.bound_split]
    noise = [e for e in experiments if e.split in project.data.noise_split]
    others = [e for e in experiments if e not in setting and e not in noise]
    if not setting:
        raise InputError(
            Path(folder) / EXPERIMENTS,
            "column split",
            f"no drive has split {' or '.join(project.data.bound_split)}",
            "at least one drive that sets the bounds",
        )

    def over(what: str, task: Callable, chosen: list[Experiment]) -> Iterator:
        for e, result in zip(chosen, workers(task, chosen), strict=False):
            progress(f"{what} of {e.name}")
            yield result

    left_out: dict[str, str] = {}
    spectra: list[Rows] = []

    def first_parts(chosen: list[Experiment], *, keep: bool) -> Iterator[Part]:
        task = partial(_first_pass, reader, project.bounds.nu_ceiling.at(estimator.omega / (2 * np.pi)))
        for e, (part, rows) in zip(chosen, over("frames", task, chosen), strict=False):
            if not part["frames"].any():
                left_out[e.name] = reader.why_without_frames()
            if keep:
                spectra.append(rows)
                if len(spectra) == JOINED_AT_ONCE:
                    spectra[:] = [_thinned(stacked(spectra))]
            yield part

    first = fold(first_parts(setting, keep=True))
    setting = [e for e in setting if e.name not in left_out]
    if not setting:
        name, reason = next(iter(left_out.items()))
        raise InputError(
            folder,
            "split " + ", ".join(project.data.bound_split),
            "no frame counts: no judged stretch at all",
            f"at least one drive unlike {name} ({reason})",
        )
    progress("weights")
    noise_peak = np.full(first["E"].shape, np.nan)
    if noise:
        noise_peak = fold(first_parts(noise, keep=False))["E"]
    gamma_w = fit_bound(project, estimator, first["gamma_rule"], "gamma_w", smallest_disturbance(first["B2"]))
    bounds = _bounds(reader, first, gamma_w.magnitude(estimator.omega), partial(over, "bounds"), setting)
    weights = fit_weights(project, estimator, bounds, gamma_w, noise_peak, first["E"], first["Y"][:, 0])
    weights, calibration, energy, met = _calibrate(reader, weights, over, setting, noise, others, left_out)
    progress("window error")
    result = Identification(
        project,
        model,
        estimator,
        bounds,
        weights,
        calibration,
        energy,
        visibility(
            estimator.omega,
            estimator.speed_range,
            met,
            weights.at(estimator.omega)[0] / weights.inflation,
            calibration.threshold,
            weights.inflation,
        ),
        _thinned(stacked(spectra)),
        [e.name for e in setting],
        list(calibration.scores),
        [e.name for e in noise],
        left_out,
        dict(
            zip(drives.experiments, workers(artefacts.file_hash, [e.path for e in experiments]), strict=False)
        ),
    )
    return result, drives


def _bounds(
    reader: DriveReader, first: Part, gamma_w: np.ndarray, over: Callable, setting: list[Experiment]
) -> Bounds:
    """Steps 5-6. ``covering``: B_w is scaled until sum_j |w_j / B_w,j|^2 <= 1 on every frame; ``paper``:
    |w_j| <= B_w,j."""
    project, estimator = reader.project, reader.estimator
    grid = front_grid(first["B1"], first["B2"], estimator, project.bounds.structure)
    second = fold(over(partial(_uncertainty_pass, reader, gamma_w, grid), setting))
    B_w = second["B_w"]
    if project.bounds.disturbance_set == "covering" and project.n_y > 1:
        scale = fold(over(partial(_covering_pass, reader, gamma_w, B_w), setting))["scale"]
        B_w = B_w * np.fmax(1.0, scale)[:, None]
    return Bounds(
        estimator.omega,
        *(first[k] for k in ("frames", "excitation", "B1", "B2", "gamma_rule")),
        gamma_w,
        second["nu"],
        B_w,
        grid,
        second["front"],
    )


def _calibrate(
    reader: DriveReader,
    weights: Weights,
    over: Callable,
    setting: list[Experiment],
    noise: list[Experiment],
    others: list[Experiment],
    left_out: dict[str, str],
) -> tuple[Weights, Calibration, EnergyTest | None, Excitation]:
    """Final inflation, the energy test's sigma, scores of the other drives and the thresholds of both tests;
    adds to ``left_out``; excitation of all of them.

    The inflation is the least factor >= 1 on the weights with which no margin is above 1 on a bound-setting
    drive, whole or with its first samples cut; rounded up by 1e-4 when it is above 1.
    """
    project, model, estimator = reader.project, reader.model, reader.estimator
    plain = weights.at(estimator.omega)
    met: list[Excitation] = []

    def judged(
        what: str, core: Core | None, reals: np.ndarray | None, cuts: int, chosen: list[Experiment]
    ) -> Iterator[Judged]:
        for j in over(what, partial(_judge, reader, *plain, core, reals, cuts), chosen):
            met.append(j.met)
            if len(met) == JOINED_AT_ONCE:
                met[:] = [Excitation.joined(met)]
            yield j

    def energy_test(inflated: Weights) -> EnergyTest:
        test = energy_filters(project, estimator, inflated)
        test = test.with_sigma(fold(over("sigma", partial(_energy_pass, reader, test, 0), setting + noise)))
        return test.with_joint(
            fold(over("joint sigma", partial(_energy_pass, reader, test, CUTS), setting + noise))
        )

    def run(core: Core | None) -> tuple[Weights, Calibration, EnergyTest | None]:
        worst = reduce(max, (j.worst for j in judged("inflation", core, None, CUTS, setting)), 1.0)
        inflated = replace(weights, inflation=worst if worst == 1.0 else worst * (1 + 1e-4))
        test = energy_test(inflated) if core else None
        reals = coefficients_of(project, model, estimator, inflated, 1.0, test).flat_reals() if core else None
        scores, energy_scores = {}, {}
        for e, j in zip(others, judged("score", core, reals, 0, others), strict=False):
            if j.score is None:
                left_out[e.name] = reader.why_without_frames()
            else:
                scores[e.name] = j.score if core else j.score / inflated.inflation
            if j.energy_score is not None:
                energy_scores[e.name] = j.energy_score
        alpha = project.frame_test.alpha
        return inflated, calibrate(scores, alpha), test and test.calibrated(energy_scores, alpha)

    if estimator.window != "hann":
        return *run(None), Excitation.joined(met)
    with _scratch_core(
        project,
        coefficients_of(project, model, estimator, weights, 1.0, energy_filters(project, estimator, weights)),
    ) as core:
        return *run(core), Excitation.joined(met)


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
                "weights.json": artefacts.to_json(weights.to_dict()),
                "calibration.json": artefacts.to_json(result.calibration.to_dict()),
                **({"energy.json": artefacts.to_json(result.energy.to_dict())} if result.energy else {}),
                "visibility.json": artefacts.to_json(result.visibility),
                "project.json": artefacts.to_json(result.project.model_dump(by_alias=True)),
                "spectra.npz": _spectra_file(result.spectra, result.bound_drives),
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


def _spectra_file(rows: Rows, bound_drives: list[str]) -> bytes:
    """Columns drive (index into names), bin, start, speed (mean over the frame, m/s), E, Z."""
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
    front: dict[str, np.ndarray]
    visibility: dict

    @cached_property
    def coefficients(self) -> Coefficients:
        """The core's coefficients; InputError for bounds of an estimator that the core does not compute."""
        model = NominalModel(self.project)
        return coefficients_of(
            self.project,
            model,
            Estimator.of(self.project, model),
            self.fitted,
            self.calibration.threshold,
            self.energy,
        )


def load(folder: Path) -> StoredIdentification:
    """Read an identification folder; the weights' certificates are proved anew, and a failing one is an
    InputError."""
    folder = Path(folder)
    manifest = artefacts.read_manifest(folder, "identify")
    project = parse_project(artefacts.read_json(folder / "project.json"), str(folder / "project.json"))
    bounds = {k: np.array(v, float) for k, v in artefacts.read_json(folder / "bounds.json").items()}
    weights = artefacts.read_json(folder / "weights.json")
    calibration = Calibration(**artefacts.read_json(folder / "calibration.json"))
    model = NominalModel(project)
    estimator = Estimator.of(project, model)
    if manifest["estimator_id"] != estimator.identifier():
        raise InputError(
            folder / artefacts.MANIFEST,
            "estimator_id",
            f"{manifest['estimator_id']:#010x}",
            f"{estimator.identifier():#010x}, the estimator that project.json describes",
        )
    fitted = Weights.from_dict(weights, str(folder / "weights.json"))
    energy = None
    if estimator.window == "hann":
        energy = energy_filters(project, estimator, fitted).restored(
            artefacts.read_json(folder / "energy.json"), str(folder / "energy.json")
        )
    stored_front = artefacts.read_json(folder / "front.json")
    front = {k: np.array(stored_front[k], float) for k in ("gamma_w", "nu")}
    return StoredIdentification(
        folder,
        manifest,
        project,
        bounds,
        weights,
        fitted,
        calibration,
        energy,
        front,
        artefacts.read_json(folder / "visibility.json"),
    )
