"""`lpvguard fit`: fits the numbers of a project file to drives.

Writes a folder with

    NAME.toml       the project file with the fitted numbers; its comments stay
    fit.json        values with standard errors and correlation, noise model, VAF, gain and residual tests by
                    drive and by speed, trims, findings
    MANIFEST.json   the drives' hashes, and the seal (base/artefacts.py)

Drives of the bound-setting splits are fitted; the others are only judged. A certain fault of a drive (a sign,
a unit, columns, a shift in time) is an InputError. A drive that may be of another car, or beyond the model,
is left out with a finding.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base import artefacts
from ..base.errors import InputError
from ..drives.splits import proposal_words, split_advice, splits_of
from ..drives.tables import (
    EXPERIMENTS,
    Drive,
    Experiment,
    bound_setting,
    day_of,
    list_experiments,
    read_drive,
    set_aside,
)
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project
from .damaged_drives import require_unspoiled
from .differences import differences, outlook
from .estimate import Estimate, Fit
from .plausible import DOUBT, require_plausible
from .project_file import values_of, with_numbers
from .quality import POOR_VAF, Quality, by_drive, by_speed
from .recentre import Recentring, recentred
from .suspicions import judged_beside, screened
from .unknowns import DELAY, Unknowns

APART = 0.98
"""Correlation of two unknowns' errors above which the drives cannot tell them apart."""
GAIN_OFF = 0.1
"""Difference of a drive's gain above which it is a finding."""


@dataclass(frozen=True)
class FittedModel:
    """Result of a fit.

    Attributes
    ----------
    project : Project
    estimate : Estimate
    drives, unseen : list of Drive, fitted and only judged
    by_drive, of_unseen, by_speed : list of Quality
    left_out : dict[str, str], reason by drive
    findings : list of str, sentences
    differences : list of str, parameters that differ between drives or days
    outlook : str, what the recordings that calibrate allow, and a better split
    sha256 : dict[str, str], hash by drive
    recentring : Recentring or None, where the common error should leave
    """

    project: Project
    estimate: Estimate
    drives: list[Drive]
    unseen: list[Drive]
    by_drive: list[Quality]
    of_unseen: list[Quality]
    by_speed: list[Quality]
    left_out: dict[str, str]
    findings: list[str]
    differences: list[str]
    outlook: str
    sha256: dict[str, str]
    recentring: Recentring | None = None

    def to_dict(self) -> dict:
        """Content of fit.json."""
        e, u = self.estimate, self.estimate.unknowns
        ends = u.at_end(e.theta)
        return {
            "vehicle": self.project.name,
            "unknowns": [
                {
                    "name": name,
                    "value": e.theta[i],
                    "standard_error": e.standard_error[i],
                    "start": u.start[i],
                    "low": u.low[i],
                    "high": u.high[i],
                    "at_end": name in ends,
                }
                for i, name in enumerate(u.names)
            ],
            "correlation": e.correlation,
            "plain": e.plain,
            "noise": [{"a": w.a, "sigma": w.sigma} for w in e.whitening],
            "trims": {
                d.name: {"value": t, "standard_error": s}
                for d, t, s in zip(self.drives, e.trims, e.trim_errors, strict=True)
                if len(t)
            },
            "fitted": [q.to_dict() for q in self.by_drive],
            "unseen": [q.to_dict() for q in self.of_unseen],
            "speeds": [q.to_dict() for q in self.by_speed],
            "left_out": self.left_out,
            "findings": self.findings,
            "differences": self.differences,
            "outlook": self.outlook,
            "recentring": self.recentring and self.recentring.to_dict(),
        }


def fit(
    project: Project,
    folder: Path,
    progress: Callable[[str], None] = lambda _: None,
    accept_unusual: bool = False,
    recentre: bool = False,
) -> FittedModel:
    """Fit a project's model to the bound-setting drives of a folder.

    Parameters
    ----------
    project : Project
    folder : Path, drives
    progress : Callable, reports progress
    accept_unusual : bool, accept a model that its kind of vehicle cannot have
    recentre : bool, move the common error of the frames into the model where that pays

    Returns
    -------
    FittedModel

    Raises
    ------
    InputError
        If an input does not fit, signs, units, columns or times of drives are wrong, or the model is none of
        its kind of vehicle.

    References
    ----------
    Ljung, System Identification, 2nd ed., 7.5 and 10.2.
    """
    experiments = list_experiments(Path(folder))
    _require_split(project, experiments, Path(folder))
    setting = {e.name for e in bound_setting(project, experiments, Path(folder))}
    skipped = {e.name for e in experiments if e.split in project.data.noise_split}
    progress("reading")
    drives, refused = _read(project, [e for e in experiments if e.name not in skipped])
    require_unspoiled(project, drives)
    progress("screening")
    chosen = [d for d in drives if d.name in setting]
    screen = screened(project, chosen)
    unknowns = Unknowns.from_project(project)
    unseen = [d for d in drives if d.name not in setting]
    beside, certain = judged_beside(unknowns, screen.theta, unseen)
    for name, error in {**screen.faults, **beside}.items():
        if name in screen.certain | certain:
            raise error
    for error in refused:
        raise error
    progress("fitting")
    runner = Fit(unknowns, screen.explained)
    estimate, recentring = runner.estimated(screen.theta), None
    if recentre:
        estimate, recentring = recentred(estimate.unknowns, estimate, screen.explained)
    fitted = estimate.unknowns.project(estimate.theta)
    if not accept_unusual:
        require_plausible(fitted, _doubtful(estimate))
    model = NominalModel(fitted)
    progress("judging")
    of_fitted = by_drive(model, screen.explained, estimate.whitening, estimate.trims)
    of_unseen = by_drive(model, unseen, estimate.whitening)
    return FittedModel(
        fitted,
        estimate,
        screen.explained,
        unseen,
        of_fitted,
        of_unseen,
        by_speed(model, screen.explained),
        set_aside(Path(folder)) | {name: str(error) for name, error in screen.faults.items()},
        [*map(str, [*screen.faults.values(), *beside.values()]), *_findings(estimate, of_fitted)],
        differences(runner, estimate, {e.name: e.group for e in experiments if e.group}),
        "; ".join(
            [outlook(_calibrating(experiments, setting | skipped)), *_advice(experiments, setting, drives)]
        ),
        {e.name: artefacts.file_hash(e.path) for e in experiments},
        recentring,
    )


def _require_split(project: Project, experiments: list[Experiment], folder: Path) -> None:
    """Raise InputError with a proposal where no drive sets the bounds, as after `ingest`."""
    if any(e.split in project.data.bound_split for e in experiments):
        return
    drives, _ = _read(project, experiments)
    speeds, groups = _by_recording(experiments, drives)
    proposed = proposal_words(splits_of(speeds, {r: r for r in speeds}, groups), groups)
    raise InputError(
        folder / EXPERIMENTS,
        "column split",
        f"no drive has split {' or '.join(project.data.bound_split)}",
        f"some that set the bounds and some that calibrate; {proposed}",
    )


def _calibrating(experiments: list[Experiment], others: set[str]) -> int:
    """Number of recordings that calibrate: of them no drive is among ``others``."""
    away = {e.recording for e in experiments if e.name in others}
    return len({e.recording for e in experiments} - away)


def _advice(experiments: list[Experiment], setting: set[str], drives: list[Drive]) -> list[str]:
    """A sentence where one half of the recordings lacks a speed, a group or day, or a surface."""
    speeds, groups = _by_recording(experiments, drives)
    halves = {e.recording: e.name in setting for e in experiments if e.recording in speeds}
    advice = split_advice(halves, speeds, groups)
    return [f"split: {advice}"] if advice else []


def _by_recording(
    experiments: list[Experiment], drives: list[Drive]
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Speed (N,) of each recording, and its group or day."""
    v = {d.name: d.v for d in drives}
    read = [e for e in experiments if e.name in v]
    speeds = {
        r: np.concatenate([v[e.name][np.isfinite(v[e.name])] for e in read if e.recording == r])
        for r in dict.fromkeys(e.recording for e in read)
    }
    return speeds, {e.recording: e.group or day_of(e.recording) for e in read}


def _doubtful(estimate: Estimate) -> list[Project]:
    """The project with one unknown each at an end of its confidence interval."""
    unknowns, errors = estimate.unknowns, np.diag(DOUBT * estimate.standard_error)
    ends = np.clip(estimate.theta + np.vstack((errors, -errors)), unknowns.low, unknowns.high)
    return [unknowns.project(theta) for theta in ends]


def _read(project: Project, experiments: list[Experiment]) -> tuple[list[Drive], list[InputError]]:
    """All drives, and the errors of those with values outside their signals' ranges.

    A wrong unit then gets its own message first.
    """
    drives, refused = [], []
    for e in experiments:
        try:
            drives.append(read_drive(e.path, project))
        except InputError as error:
            drives.append(read_drive(e.path, project, any_values=True))
            refused.append(error)
    return drives, refused


def _findings(estimate: Estimate, qualities: list[Quality]) -> list[str]:
    """Findings of a successful fit."""
    u, theta = estimate.unknowns, estimate.theta
    findings = [
        f"{name} is at the end of its range, {theta[u.names.index(name)]:.4g}: the drives do not tell it, or "
        "the range is too narrow"
        for name in u.at_end(theta)
    ]
    if estimate.plain:
        findings.append(
            "the residuals are the model's own error and no noise: plain least squares were taken, and "
            "another model may do better"
        )
    stated_delay = u.base.model.input_delay_s
    if DELAY in u.names and stated_delay > u.high[u.names.index(DELAY)]:
        findings.append(
            f"the project file's delay of {stated_delay:g} s does not fit the drives; their delay is "
            f"{theta[u.names.index(DELAY)]:.4g} s"
        )
    for i, j in zip(*np.where(np.triu(np.abs(estimate.correlation), 1) > APART), strict=True):
        findings.append(
            f"the drives do not separate {u.names[i]} and {u.names[j]}: the correlation of their errors is "
            f"{estimate.correlation[i, j]:.3f}"
        )
    for q in qualities:
        for j, signal in enumerate(u.base.outputs):
            if q.vaf[j] < POOR_VAF:
                findings.append(f"{q.name}: the model explains only {q.vaf[j]:.1%} of {signal.name}")
            elif abs(q.gain[j] - 1) > GAIN_OFF:
                findings.append(f"{q.name}: {signal.name} is {q.gain[j]:.2f} times the model's")
    return findings


def _database(project: Project) -> dict[str, bytes]:
    """CAN database of the car's own bus, beside a project file."""
    return {} if project.can is None else {Path(project.can.dbc).name: Path(project.can.dbc).read_bytes()}


def save(
    result: FittedModel, text: str, where: str, out: Path, files: Mapping[str, str] | None = None
) -> None:
    """Write the folder of `lpvguard fit`.

    Parameters
    ----------
    result : FittedModel
    text : str, of the project file
    where : str, origin of the text
    out : Path
    files : Mapping[str, str], optional, further files

    Raises
    ------
    InputError
        If the folder may not be replaced.
    """
    values = values_of(result.estimate.unknowns, result.estimate.theta)
    with artefacts.new_folder(out, "fit", result.project.name) as folder:
        artefacts.write_files(
            folder,
            {
                f"{result.project.name}.toml": with_numbers(text, where, values),
                **_database(result.project),
                "fit.json": artefacts.to_json(result.to_dict()),
                **(files or {}),
                artefacts.MANIFEST: artefacts.manifest(
                    "fit", vehicle=result.project.name, sha256=result.sha256
                ),
            },
        )
