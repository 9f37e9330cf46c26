"""Recentring: what least squares leave common to all drives moves into the model, where it pays."""

import numpy as np
import pytest

from known_car import KnownCar, guessed
from lpvguard.base.errors import InputError
from lpvguard.drives.tables import Drive
from lpvguard.fit.estimate import Fit
from lpvguard.fit.recentre import recentred
from lpvguard.fit.unknowns import Unknowns
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project

SPEEDS = (6.0, 9.0, 12.0, 15.0, 18.0)


@pytest.fixture(scope="module")
def fitted():
    """A car's drives, its unknowns and their estimate by least squares."""
    random = np.random.default_rng(3)
    car, unknowns = (KnownCar.drawn(random), Unknowns.from_project(guessed(load_project("g80"))))
    drives = [car.drive(random, v, 90.0, f"at_{v:g}") for v in SPEEDS]
    return car, drives, unknowns, Fit(unknowns, drives).estimated(unknowns.start)


def relative(project, truth, speeds=SPEEDS) -> float:
    """Root mean square of G_true / G - 1 over the speeds and the frames' frequencies."""
    omega = 2 * np.pi * np.geomspace(0.1, 1.5, 20)
    both = [[NominalModel(p).frequency_response(omega, v)[:, 0, 0] for v in speeds] for p in (truth, project)]
    return float(np.sqrt(np.mean(np.abs(np.divide(*both) - 1) ** 2)))


@pytest.mark.slow("4 s: a fit and its recentring")
def test_a_wrong_estimate_comes_back_to_the_car(fitted):
    car, drives, unknowns, estimate = fitted
    truth = unknowns.project(car.truth)
    wrong = estimate.theta * np.array([1.2, 0.7, 1.5, 0.8, 1.0, 1.0])
    far = type(estimate)(
        unknowns, wrong, estimate.covariance, estimate.whitening, *[np.zeros((0, 0))] * 2, False
    )
    near, how = recentred(unknowns, far, drives)
    assert how.taken and how.left_out < 0.5 * how.fitted
    assert relative(unknowns.project(near.theta), truth) < 0.2 * relative(unknowns.project(wrong), truth)
    assert np.array_equal(near.theta[4:], wrong[4:])  # offsets stay
    assert np.all(np.abs(near.theta - car.truth)[:4] <= 5 * near.standard_error[:4])


@pytest.mark.slow("4 s: a fit and its recentring")
def test_what_does_not_pay_is_not_taken(fitted):
    car, drives, unknowns, estimate = fitted
    right = type(estimate)(
        unknowns, car.truth.copy(), estimate.covariance, estimate.whitening, *[np.zeros((0, 0))] * 2, False
    )
    same, how = recentred(unknowns, right, drives[:2])
    assert not how.taken and how.left_out >= how.fitted and same is right


def test_several_inputs_and_drives_without_frames_are_refused(fitted):
    _, drives, unknowns, estimate = fitted
    short = [Drive(d.name, d.t[:60], d.v[:60], d.u[:60], d.y[:60]) for d in drives]
    with pytest.raises(InputError, match="no drive has 3 frames of a bin"):
        recentred(unknowns, estimate, short)
    two = Unknowns.from_project(load_project("vectoring"))
    with pytest.raises(InputError, match="2 inputs"):
        recentred(two, type(estimate)(two, two.start, *[None] * 4, False), [])
