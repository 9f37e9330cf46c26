"""A fit finds what is known, and its standard errors are those that the seeds show.

With LPVGUARD_FULL=1 the campaign runs over 200 cars, and holds each unknown to the stated numbers.
"""

import os

import numpy as np
import pytest

from known_car import NAMES, KnownCar, guessed
from lpvguard.drives.tables import list_experiments, read_drive
from lpvguard.fit import noise
from lpvguard.fit.estimate import Fit
from lpvguard.fit.quality import by_drive, pooled_vaf
from lpvguard.fit.stretches import FEW, few_stretches, judged_samples
from lpvguard.fit.unknowns import TriedModel, Unknowns
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import FitSettings

FULL = os.environ.get("LPVGUARD_FULL") == "1"
SEEDS = 200 if FULL else 6


def campaign(project, seeds: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors and stated standard errors (seeds, 6) over drawn cars."""
    unknowns = Unknowns.from_project(guessed(project))
    assert unknowns.names == NAMES
    errors, stated = [], []
    for seed in range(seeds):
        random = np.random.default_rng([17, seed])
        car = KnownCar.drawn(random)
        estimate = Fit(unknowns, car.drives(random)).estimated(unknowns.start)
        errors.append(estimate.theta - car.truth)
        stated.append(estimate.standard_error)
    return np.array(errors), np.array(stated)


@pytest.mark.slow("10 s: 6 cars fitted, 200 with LPVGUARD_FULL=1")
def test_known_parameters_are_found_within_honest_standard_errors(g80):
    errors, stated = campaign(g80, SEEDS)
    inside = np.sum(np.abs(errors) <= 2 * stated, axis=0)
    ratio = np.sqrt(np.mean(stated**2, axis=0)) / np.std(errors, axis=0)
    if FULL:
        assert np.all(inside >= 183), dict(zip(NAMES, inside, strict=True))
        assert np.all((ratio > 0.8) & (ratio < 1.25)), dict(zip(NAMES, ratio, strict=True))
    else:
        assert np.all(np.abs(errors) <= 3.5 * stated)
        assert np.all(inside >= SEEDS - 2) and np.sum(inside) >= 6 * SEEDS - 5


@pytest.mark.unhurried
def test_one_car_is_found_from_far_away_guesses(g80):
    random = np.random.default_rng(1)
    car = KnownCar.drawn(random)
    unknowns = Unknowns.from_project(guessed(g80))
    estimate = Fit(unknowns, car.drives(random, 60.0)).estimated(unknowns.start)
    assert np.all(np.abs(estimate.theta - car.truth) <= 4 * estimate.standard_error)
    assert estimate.standard_error[NAMES.index("input_delay_s")] < 2e-3
    assert np.allclose(np.diag(estimate.correlation), 1.0)


@pytest.mark.unhurried
def test_a_trim_a_drive_is_found_and_its_mean_is_the_projects(g80):
    random = np.random.default_rng(2)
    car = KnownCar.drawn(random)
    drives = car.drives(random, 60.0)
    trims = np.array([0.05, -0.05, 0.1, 0.0])
    for d, trim in zip(drives, trims, strict=True):
        d.u[:] += trim
    project = guessed(g80).model_copy(update={"fit": FitSettings(trim="drive")})
    unknowns = Unknowns.from_project(project)
    estimate = Fit(unknowns, drives).estimated(unknowns.start)
    written = estimate.unknowns.base.model.input_offset
    assert np.abs(estimate.trims[:, 0] - (trims - trims.mean())).max() < 4e-3
    assert written is not None and abs(written[0] - car.trim - trims.mean()) < 3e-3
    assert "input_offset[0]" not in estimate.unknowns.names


def test_the_triangle_of_all_drives_has_the_products_of_their_residuals(g80):
    random = np.random.default_rng(6)
    unknowns = Unknowns.from_project(guessed(g80))
    fit = Fit(unknowns, KnownCar.drawn(random).drives(random, 20.0))
    fit.whitening = [noise.white(fit._stretches(fit.errors(unknowns.start))[0])]
    triangle = fit._reduced(unknowns.start)
    whole = np.column_stack(
        [np.concatenate(list(x)) for x in (fit.residuals(unknowns.start), fit.derivatives(unknowns.start))]
    )
    products = whole.T @ whole
    scale = np.sqrt(np.outer(np.diag(products), np.diag(products)))
    assert np.abs(triangle.T @ triangle - products).max() < 1e-9 * scale.max()
    assert triangle[0, 0] > 0 and not triangle[1:, 0].any()


def test_of_many_samples_few_are_judged_stretches_at_all_speeds(g80):
    random, model = np.random.default_rng(7), NominalModel(g80)
    car = KnownCar.drawn(random)
    drives = [car.drive(random, v, 400.0, f"at_{v:g}") for v in np.linspace(6.0, 18.0, 8)]
    assert few_stretches(model, drives[:2]) == drives[:2]
    late = len(drives[0].t) - 4000
    drives[0].v[:late] = 0.0  # what moves most outside of the speed range does not count
    drives[0].y[:late] *= 10.0
    few = few_stretches(model, drives)
    assert [d.name for d in few] == [d.name for d in drives]
    assert sum(len(d.t) for d in few) < FEW + 8 * (model.settle_samples + 1)
    assert judged_samples(model, few[0].v).sum() > 3000


@pytest.mark.slow("6 s: a car fitted by few samples first, and by all")
def test_a_beginning_of_few_samples_ends_where_all_end(g80, monkeypatch):
    random = np.random.default_rng(8)
    car, unknowns = KnownCar.drawn(random), Unknowns.from_project(guessed(g80))
    drives = car.drives(random, 60.0)
    whole = Fit(unknowns, drives).estimated(unknowns.start)
    monkeypatch.setattr("lpvguard.fit.stretches.FEW", 2000)
    monkeypatch.setattr("lpvguard.fit.stretches.OF_A_DRIVE", (500, 1000))
    begun = Fit(unknowns, drives).estimated(unknowns.start)
    assert np.all(np.abs(begun.theta - whole.theta) <= 0.05 * whole.standard_error)


def test_the_quick_model_is_the_nominal_one(g80):
    random = np.random.default_rng(3)
    drive = KnownCar.drawn(random).drive(random, 12.0, 30.0, "a")
    quick, exact = (kind(g80).simulate(drive.v, drive.u, drive.y[0]) for kind in (TriedModel, NominalModel))
    assert np.abs(quick - exact).max() < 1e-5 * np.abs(exact).max()


def test_an_autoregression_is_found_and_makes_the_residuals_white():
    random = np.random.default_rng(4)
    from scipy.signal import lfilter

    e = [lfilter([1.0], [1.0, -1.5, 0.7], s * random.standard_normal(4000)) for s in (1.0, 3.0)]
    autoregression = noise.fitted([[x] for x in e])
    assert autoregression.order == 2 and np.abs(autoregression.a - [1.0, -1.5, 0.7]).max() < 0.05
    assert np.abs(autoregression.sigma / [1.0, 3.0] - 1).max() < 0.05


@pytest.mark.slow("12 s: the measured drives fitted")
def test_on_measured_drives_it_explains_unseen_ones_at_least_as_well_as_the_published_parameters(
    g80, measured
):
    experiments = list_experiments(measured)
    setting = [read_drive(e.path, g80) for e in experiments if e.split == "train"]
    unseen = [read_drive(e.path, g80) for e in experiments if e.split != "train"]
    unknowns = Unknowns.from_project(g80)
    estimate = Fit(unknowns, setting).estimated(unknowns.start)
    ours, published = (
        by_drive(NominalModel(project), unseen, []) for project in (unknowns.project(estimate.theta), g80)
    )
    assert pooled_vaf(ours) >= pooled_vaf(published)
    assert np.mean([q.vaf for q in ours]) >= np.mean([q.vaf for q in published])
