"""Compare the model error band with known true errors: does the band contain the error, and is it narrow?

Every set draws 5 to 40 drives of 60 to 150 s from a car with a known error (`_known_cars`). It estimates the
band of a further drive only from these drives. In the first table, all drives of a set have the same car. Two
numbers are read at every frequency, speed and amplitude of the band:

    ratio      largest |delta| / W, at most 1 for a true band
    loose      median W / |delta|, by cells of speed and amplitude and for one W over all of them

In the second table, drives deviate by a random gain and delay. The table counts the further drives that lie
within the band everywhere, with a Clopper-Pearson interval of 95 %. ``sine`` is the largest ratio for the
response to single sines. No drive has this waveform.

With ``--identification``, the table shows, by speed cell and bin, the least gain error that the frame test
detects, and the limit of detection. A test that knew the form of the vehicle's error could reach the limit
(THEORY 7.19).

With ``--drives``, every group of measured drives is left out once. ``largest`` is the ratio of a drive's own
error to the band of the other groups. ``refuted`` is this ratio after subtraction of the error's own
interval.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.stats import beta

from ...base.errors import InputError
from ...base.parallel import Map, workers
from ...drives.frames import Estimator
from ...drives.tables import Drive
from ...identify.bounds import nominal_error
from ...identify.error_band import LEVEL, WAVEFORM, ErrorBand, driven_amplitudes, error_band
from ...identify.error_domain import ErrorDomain
from ...identify.error_prior import USUAL, PriorScales
from ...identify.error_sums import ErrorSums, common_fit, common_products, error_sums, joined, sum_of
from ...identify.identification import load
from ...vehicle.nominal import NominalModel
from ...vehicle.project import Project, load_project
from . import parser, show
from ._known_cars import CARS, best_linear_error, deviations_drawn, known_drives, true_error
from ._left_out import left_out, left_out_table
from ._multibody import multibody_drives, multibody_error, multibody_project

FEWEST, MOST = 5, 40
"""Least and largest number of drives in a set."""
SHORTEST_S, LONGEST_S = 60.0, 150.0
GAIN, DELAY_S = 0.02, 0.008
"""Standard deviations of the drives' gains and delays in the second table."""
FURTHER = 20
"""Number of further drives that each set judges."""
MULTIBODY_CELLS = (5, 3)
"""Speeds and amplitudes at which the error of the multi-body car is measured."""
LEVEL_OF_CELLS = 0.3
"""Gain error for which cells are counted."""
SENSITIVITY = {"sizes": "common", "deviations": "deviation", "ignorance": "ignorance"}
"""Medians of the prior that the sensitivity test halves and doubles."""


@dataclass(frozen=True)
class SetResult:
    """Result of one set of drives.

    Attributes
    ----------
    car, seed, drives : name of the car, seed and number of drives of the set
    ratio : largest |delta| / W over frequency, speed and amplitude
    ratio_all : this ratio for one W over all speeds and amplitudes
    sine : largest |delta| / W for single sines
    outside : share of cells with |delta| above W
    loose, loose_all : median of W / |delta| over cells, and over frequencies for one W
    within, further : number of further drives within the band, and number of all further drives
    """

    car: str
    seed: int
    drives: int
    deviating: bool
    ratio: float
    ratio_all: float
    sine: float
    outside: float
    loose: float
    loose_all: float
    within: int
    further: int


def sums_of(project: Project, drives: list[Drive]) -> list[ErrorSums]:
    """Compute the error sums of each drive with the model and the bins of a project."""
    model = NominalModel(project)
    estimator = Estimator.from_project(project, model)
    setup = ErrorDomain.from_estimator(estimator, project.frame_test.excited_std), model, estimator
    seen = [(d, *nominal_error(d, model)) for d in drives]
    common = common_fit(sum_of([common_products(*setup, *signals) for signals in seen]))
    return [error_sums(*setup, *signals, "", common) for signals in seen]


def one_set(project: Project, deviating: bool, job: tuple[str, int]) -> SetResult:
    """Compute the result of one set; ``job`` holds the car's name and the seed of the set."""
    name, seed = job
    car, random = CARS[name], np.random.default_rng([seed, int(deviating)])
    count = int(random.integers(FEWEST, MOST + 1))
    sizes = deviations_drawn(count, GAIN, DELAY_S, random) if deviating else None
    drives = known_drives(car, project, count, random.uniform(SHORTEST_S, LONGEST_S), random, sizes)
    band = band_of(project, joined(sums_of(project, drives)), seed)
    model = NominalModel(project)
    driven = np.geomspace(band.amplitude[:, 0] * WAVEFORM, band.amplitude[:, -1] / WAVEFORM, 4).T
    where = (model, band.omega, band.speed, driven)
    delta, sine = best_linear_error(car, *where), true_error(car, *where)
    ratio, largest = np.abs(delta) / band.upper, np.abs(delta).max(axis=(1, 2))
    within = 0
    further = deviations_drawn(FURTHER, GAIN, DELAY_S, random) if deviating else None
    if further is not None:
        turn = np.exp(-1j * np.multiply.outer(further.delay_s, band.omega))[:, :, None, None]
        own = (1 + delta) * (1 + further.gain[:, None, None, None]) * turn - 1
        within = int((np.abs(own) <= band.upper).all(axis=(1, 2, 3)).sum())
    return SetResult(
        name,
        seed,
        count,
        deviating,
        float(ratio.max()),
        float((largest / band.bound).max()),
        float((np.abs(sine) / band.upper).max()),
        float((ratio > 1).mean()),
        float(np.median(1 / ratio)),
        float(np.median(band.bound / largest)),
        within,
        FURTHER if deviating else 0,
    )


def band_of(project: Project, sums: ErrorSums, seed: int, scales: PriorScales = USUAL) -> ErrorBand:
    """Estimate the band of the first output at the project's bins."""
    estimator = Estimator.from_project(project, NominalModel(project))
    domain = ErrorDomain.from_estimator(estimator, project.frame_test.excited_std)
    return error_band(domain, sums, 0, domain.omega, seed, scales)


def sensitivity(project: Project, seed: int) -> dict[str, float]:
    """Largest relative change of the band's width if a median of the prior is halved or doubled."""
    random = np.random.default_rng([seed, 2])
    drives = known_drives(CARS["friction"], project, FEWEST, SHORTEST_S, random)
    sums = joined(sums_of(project, drives))
    usual = band_of(project, sums, seed).upper
    out = {}
    for label, field in SENSITIVITY.items():
        for factor in (0.5, 2.0):
            upper = band_of(project, sums, seed, replace(USUAL, **{field: factor})).upper
            out[f"{label} x {factor:g}"] = float(np.exp(np.abs(np.log(upper / usual)).max()))
    return out


def multibody_rows(sets: int, seed: int, over: Map) -> list[SetResult]:
    """Compute the results of sets that are drawn from one pool of the multi-body car's drives."""
    project = multibody_project()
    model = NominalModel(project)
    estimator = Estimator.from_project(project, model)
    domain = ErrorDomain.from_estimator(estimator, project.frame_test.excited_std)
    drives = multibody_drives(project, seed, over)
    sums = sums_of(project, drives)
    speed = np.linspace(*domain.speed_range, MULTIBODY_CELLS[0])
    ends = driven_amplitudes(domain, joined(sums).histogram, speed) * [WAVEFORM, 1 / WAVEFORM]
    amplitude = np.array([np.geomspace(a, b, MULTIBODY_CELLS[1]) for a, b in ends])
    delta = multibody_error(model, domain.omega, speed, amplitude, over)
    return [_multibody_set(domain, sums, delta, (speed, amplitude), seed + k) for k in range(sets)]


def _multibody_set(
    domain: ErrorDomain,
    sums: list[ErrorSums],
    delta: np.ndarray,
    cells: tuple[np.ndarray, np.ndarray],
    seed: int,
) -> SetResult:
    random = np.random.default_rng([seed, 3])
    count = int(random.integers(FEWEST, len(sums) + 1))
    chosen = joined([sums[k] for k in np.sort(random.permutation(len(sums))[:count])])
    band = error_band(domain, chosen, 0, domain.omega, seed, cells=cells)
    low, high = driven_amplitudes(domain, chosen.histogram, cells[0]).T[:, :, None]
    driven = (cells[1] >= low * WAVEFORM) & (cells[1] <= high / WAVEFORM)
    ratio = (np.abs(delta) / band.upper)[:, driven]
    largest, bound = (x[:, driven].max(axis=1) for x in (np.abs(delta), band.upper))
    return SetResult(
        "multibody",
        seed,
        count,
        False,
        float(ratio.max()),
        float((largest / bound).max()),
        float("nan"),
        float((ratio > 1).mean()),
        float(np.median(1 / ratio)),
        float(np.median(bound / largest)),
        0,
        0,
    )


def proportion(within: int, total: int) -> tuple[float, float]:
    """Clopper-Pearson interval (95 %) of a proportion."""
    low = 0.0 if within == 0 else float(beta.ppf(0.025, within, total - within + 1))
    high = 1.0 if within == total else float(beta.ppf(0.975, within + 1, total - within))
    return low, high


def table(rows: list[SetResult], changes: dict[str, float]) -> str:
    """Write the rows by car as text, and the sensitivity to the prior."""
    lines = list(_lines(rows))
    if changes:
        lines.append("prior: largest ratio of W to the usual one, 5 drives of 60 s of the car with friction")
        lines += [f"  {label:<20}{ratio:>6.2f}" for label, ratio in changes.items()]
    return "\n".join(lines)


def _lines(rows: list[SetResult]) -> Iterator[str]:
    for deviating in (False, True):
        chosen = [r for r in rows if r.deviating == deviating]
        for name in dict.fromkeys(r.car for r in chosen):
            of_car = [r for r in chosen if r.car == name]
            yield f"{name}, {'drives deviate' if deviating else 'one car'}: {len(of_car)} sets"
            yield (
                f"  ratio, worst {max(r.ratio for r in of_car):.2f} by cell, "
                f"{max(r.ratio_all for r in of_car):.2f} for one W; cells outside "
                f"{np.mean([r.outside for r in of_car]):.2%}, sets with any "
                f"{sum(r.ratio > 1 for r in of_car)}; sine {max(r.sine for r in of_car):.2f}"
            )
            yield (
                f"  loose, median {np.median([r.loose for r in of_car]):.2f} by cell, "
                f"{np.median([r.loose_all for r in of_car]):.2f} for one W; worst set "
                f"{max(r.loose for r in of_car):.2f}, {max(r.loose_all for r in of_car):.2f}"
            )
            if deviating:
                within, further = sum(r.within for r in of_car), sum(r.further for r in of_car)
                low, high = proportion(within, further)
                yield (
                    f"  further drives within: {within} of {further}, interval {low:.3f} to {high:.3f}, "
                    f"stated {1 - LEVEL:g}"
                )


def _measured(vehicle: str, folder: Path, seed: int, jobs: int) -> tuple[str, dict]:
    """Compute the table and the numbers for measured drives."""
    with workers(jobs) as over:
        rows, bands = left_out(load_project(vehicle), folder, seed, over)
    numbers = {
        "left_out": [asdict(r) for r in rows],
        "omega_rad_s": bands[0].omega,
        "bound": [b.bound for b in bands],
        "hyperparameters": [b.hyper for b in bands],
    }
    return left_out_table(rows, bands), numbers


def beside_the_limit(folder: Path) -> tuple[str, dict]:
    """Compute the table and the numbers of an identification: detected gain errors and their limits."""
    seen = load(folder).visibility
    cells = seen["at_percentile"]
    if "limit" not in cells[0]:
        raise InputError(folder, "limit", "made by an earlier version", "an identification by this version")
    ours, limit = (np.array([c[key] for c in cells], float) for key in ("gain_error", "limit"))
    ratio, known = ours / limit, np.isfinite(limit)
    lines = ["visible gain error / limit [%], by speed; columns: bins [rad/s]"]
    lines.append(f"{'m/s':>12}" + "".join(f"{w:>12.3g}" for w in seen["omega_rad_s"]))
    for cell, row in zip(cells, zip(ours, limit, strict=True), strict=True):
        numbers = (f"{100 * a:.0f} / {100 * b:.1f}" for a, b in zip(*row, strict=True))
        lines.append("{:>5.3g} - {:>4.3g}".format(*cell["speed_mps"]) + "".join(f"{n:>12}" for n in numbers))
    of_level = [int((x <= LEVEL_OF_CELLS).sum()) for x in (ours, limit)]
    middle = float(np.nanmedian(ratio)) if np.isfinite(ratio).any() else None
    lines.append(
        f"{of_level[0]} of {ours.size} cells see {LEVEL_OF_CELLS:.0%}, at the limit {of_level[1]} of "
        f"{known.sum()} known; ours over the limit {'-' if middle is None else f'{middle:.2f}'} in the median"
    )
    result = {"gain_error": ours, "limit": limit, "median_ratio": middle, "cells": of_level}
    return "\n".join(lines), result


def main(argv: list[str]) -> None:
    """Run `lpvguard bench sharpness`."""
    arguments = parser("sharpness", __doc__)
    arguments.add_argument("--sets", type=int, default=20, help="random sets of drives a table and car (20)")
    arguments.add_argument("--seed", type=int, default=0, help="first seed of the sets (0)")
    arguments.add_argument("--jobs", type=int, default=1, help="worker processes (1)")
    arguments.add_argument("--no-sensitivity", action="store_true", help="leave the prior's sensitivity out")
    arguments.add_argument("--multibody", action="store_true", help="the multi-body car besides, 15 minutes")
    arguments.add_argument("--drives", type=Path, help="measured drives: every group is left out once")
    arguments.add_argument(
        "--vehicle", default="g80", help="vehicle of --drives: a name or a project file (g80)"
    )
    arguments.add_argument("--identification", type=Path, help="folder of `identify`: beside the limit")
    options = arguments.parse_args(argv)
    if options.sets < 1 or options.seed < 0:
        raise InputError(
            "bench sharpness", "--sets, --seed", f"{options.sets}, {options.seed}", "from 1 and 0 on"
        )
    if options.identification is not None:
        show(*beside_the_limit(options.identification), options.json_out)
        return
    if options.drives is not None:
        show(*_measured(options.vehicle, options.drives, options.seed, options.jobs), options.json_out)
        return
    project = load_project("g80")
    jobs = [(name, options.seed + k) for name in CARS for k in range(options.sets)]
    with workers(options.jobs) as over:
        rows = [r for dev in (False, True) for r in over(partial(one_set, project, dev), jobs)]
        if options.multibody:
            rows += multibody_rows(options.sets, options.seed, over)
    changes = {} if options.no_sensitivity else sensitivity(project, options.seed)
    result = {"sets": [asdict(r) for r in rows], "sensitivity": changes, "level": LEVEL}
    show(table(rows, changes), result, options.json_out)
