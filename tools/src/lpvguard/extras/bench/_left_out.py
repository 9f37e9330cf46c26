"""Compare drives with the error band of the other drives; leave each group out once (THEORY 7.15)."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from ...base.errors import InputError
from ...base.parallel import Map
from ...drives.frames import Estimator
from ...drives.tables import list_experiments
from ...identify.error_band import ErrorBand, error_band
from ...identify.error_domain import ErrorDomain
from ...identify.error_sums import DIRECTIONS, ErrorSums, deviations, joined
from ...identify.passes import DriveReader, error_sums_of
from ...vehicle.nominal import NominalModel
from ...vehicle.project import Project

DOUBT = 0.01
"""Probability that the own error of a drive lies beyond its interval. The interval is subtracted."""


@dataclass(frozen=True)
class LeftOut:
    """Result for one output of a drive whose group was left out.

    Attributes
    ----------
    drive, group, output : names.
    within : share of the bins at which the drive's own error lies within the others' band.
    largest : largest ratio of the drive's own error to the band over bins.
    refuted : largest ratio after subtraction of the error's interval; above 1 the drive refutes the band.
    vehicle_bound : (K,) bound of the other drives over all speeds and amplitudes.
    """

    drive: str
    group: str
    output: str
    within: float
    largest: float
    refuted: float
    vehicle_bound: list[float]


def left_out(
    project: Project, folder: Path, seed: int, workers: Map
) -> tuple[list[LeftOut], list[ErrorBand]]:
    """Compare every drive with the band of the other groups; return also the band of all drives."""
    model = NominalModel(project)
    reader, estimator = DriveReader(project, model), Estimator.from_project(project, model)
    domain = ErrorDomain.from_estimator(estimator, project.frame_test.excited_std)
    experiments = sorted(list_experiments(folder), key=lambda e: e.name)
    sums = error_sums_of(reader, domain, experiments, workers)
    groups = [e.group_or_recording for e in experiments]
    names = sorted(set(groups))
    if len(names) < 2:
        raise InputError(folder, "column group", f"{len(names)} group", "at least two")
    parts = [(g, [s for group, s in zip(groups, sums, strict=True) if group != g]) for g in names]
    rows = []
    outputs = range(project.n_y)
    for j in outputs:
        task = partial(_band_of, domain, j, seed)
        for (name, _), band in zip(parts, workers(task, [joined(rest) for _, rest in parts]), strict=True):
            own = [(e, s) for e, s in zip(experiments, sums, strict=True) if e.group_or_recording == name]
            output = project.outputs[j].name
            rows += [_beside(domain, band, e.name, name, output, s, j) for e, s in own if s.samples[j]]
    return rows, [_band_of(domain, j, seed, joined(sums)) for j in outputs]


def _band_of(domain: ErrorDomain, output: int, seed: int, sums: ErrorSums) -> ErrorBand:
    return error_band(domain, sums, output, domain.omega, seed)


def _beside(
    domain: ErrorDomain, band: ErrorBand, drive: str, group: str, output: str, sums: ErrorSums, j: int
) -> LeftOut:
    """Compare the error of a drive with the band of the other groups."""
    T, cells = deviations(domain), sums.histogram.sum()
    covariance = np.linalg.pinv(sums.drive_own[0, j], rcond=1e-10, hermitian=True)
    deviation = covariance @ (sums.drive_cross[0, j] - band.mean @ sums.drive_gram[0, j])
    response = domain.response(band.omega) @ T
    quantile = np.sqrt(chi2.ppf(1 - DOUBT, DIRECTIONS))
    spread = quantile * np.sqrt(np.einsum("gi,ij,gj->g", response.conj(), covariance, response).real)
    share = sums.histogram.sum(axis=1) / cells
    middle = -1 + (2 * np.arange(len(share)) + 1) / len(share)
    node = int(np.argmin(np.abs(domain.relative_speed(band.speed) - share @ middle)))
    factor = 1 + band.centre[:, node]
    size = np.abs(band.centre[:, node] + factor * (response @ deviation)[:, None])
    ratio = size / band.upper[:, node]
    least = np.maximum(size - np.abs(factor) * spread[:, None], 0) / band.upper[:, node]
    return LeftOut(
        drive,
        group,
        output,
        float((ratio.max(axis=1) <= 1).mean()),
        float(ratio.max()),
        float(least.max()),
        band.bound.tolist(),
    )


def left_out_table(rows: list[LeftOut], bands: list[ErrorBand]) -> str:
    """Write the rows as text, one line for each drive, and the weight W of all drives."""
    lines = [f"{'left out':<28}{'group':<24}{'output':<16}{'within':>8}{'largest':>9}{'refuted':>9}"]
    lines += [
        f"{r.drive:<28.27}{r.group:<24.23}{r.output:<16.15}{r.within:>8.0%}{r.largest:>9.2f}{r.refuted:>9.2f}"
        for r in rows
    ]
    for band in bands:
        middle = np.median(band.upper, axis=(1, 2))
        lines.append("rad/s  " + " ".join(f"{w:7.2f}" for w in band.omega))
        lines.append("W      " + " ".join(f"{w:7.3f}" for w in band.bound))
        lines.append("median " + " ".join(f"{w:7.3f}" for w in middle))
    refuting = sum(r.refuted > 1 for r in rows)
    lines.append(f"{sum(r.largest <= 1 for r in rows)} of {len(rows)} within, {refuting} refute")
    return "\n".join(lines)
