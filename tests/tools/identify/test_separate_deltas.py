"""Class S1_diagonal from drives to the page: a Delta, a bound and a weight of its own for every output."""

from dataclasses import replace

import numpy as np
import pytest

from lpvguard.core.compiled import Core
from lpvguard.drives.frames import Estimator
from lpvguard.drives.tables import list_experiments, read_drive
from lpvguard.identify.export import export_vehicle
from lpvguard.identify.identification import load
from lpvguard.identify.over_drives import CUTS, FAR_BELOW
from lpvguard.identify.passes import DriveReader, energy_pass, judge
from lpvguard.identify.weights import coefficients_of
from lpvguard.report.identification_pictures import IdentificationPictures
from lpvguard.report.sections.bounds import bound_sections
from lpvguard.vehicle.nominal import NominalModel

pytestmark = pytest.mark.slow("45 s: a truck identified on few drives")


@pytest.fixture(scope="module")
def stored(few_truck_identified):
    return load(few_truck_identified)


@pytest.fixture(scope="module")
def core(stored, tmp_path_factory):
    folder = tmp_path_factory.mktemp("separate") / "truck"
    export_vehicle(stored, folder)
    return Core(folder)


def test_every_output_has_its_own_bound_and_a_weight_above_it(stored):
    estimator = Estimator.from_project(stored.project, NominalModel(stored.project))
    nu, W_delta = stored.bounds["nu"], stored.fitted.at(estimator.omega)[0]
    assert nu.shape == W_delta.shape == (estimator.n_bins, 2)
    known = np.isfinite(nu) & (nu > 0)
    assert known.any(axis=0).all() and (W_delta[known] >= nu[known] * (1 - 1e-9)).all()
    assert not np.allclose(W_delta[:, 0], W_delta[:, 1], rtol=1e-2)
    assert stored.energy.W.shape[0] == 2


def test_the_core_holds_the_weights_and_finds_no_bound_drive_outside(stored, core, few_truck_drives):
    assert core.sizes["NDELTA"] == 2 and core.sizes["NDIRECTIONS"] == 2
    np.testing.assert_allclose(core.compiled[1], stored.coefficients.flat_reals(), rtol=1e-6)
    setting = [e for e in list_experiments(few_truck_drives) if e.name in stored.manifest["drives"]["bounds"]]
    for experiment in setting:
        run = core.monitor().run_drive(read_drive(experiment.path, stored.project))
        assert run.frames.margin[run.frames.counted].max(initial=0.0) <= 1 + 1e-6
        assert run.energy.max() <= 1.001


@pytest.mark.parametrize("share", [1.0, pytest.param(0.1, marks=pytest.mark.long("6 s: another sigma"))])
def test_a_cut_drive_far_below_the_energy_tests_bound_asks_for_no_larger_sigma(
    stored, core, few_truck_drives, share
):
    """With a tenth of sigma some drives need more, and the ratio of the core is above FAR_BELOW on each of
    them."""
    reader = DriveReader(stored.project, NominalModel(stored.project))
    test = replace(stored.energy, sigma=share * stored.energy.sigma)
    arguments = stored.project, reader.model, reader.estimator, stored.fitted, 1.0, test, stored.change
    weights, reals = stored.fitted.at(reader.estimator.omega), coefficients_of(*arguments).flat_reals()
    asking = 0
    for e in list_experiments(few_truck_drives):
        if e.name in stored.manifest["drives"]["bounds"]:
            asked = np.nanmax(energy_pass(reader, test, CUTS, e)["joint"]) > 1
            asking += asked
            assert not (asked and judge(reader, *weights, core, reals, CUTS, e).energy_of_cuts < FAR_BELOW)
    assert (asking > 0) == (share < 1)


@pytest.mark.long("6 s: the pictures of a page")
def test_the_page_draws_one_line_an_output(stored):
    estimator = Estimator.from_project(stored.project, NominalModel(stored.project))
    page = "".join(bound_sections(IdentificationPictures(stored, estimator)))
    assert "one line per output" in page and page.count("<svg") == 4
