"""The regularised model error model: exact sums and likelihood, and a band that holds known errors."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfilt

from lpvguard.drives.frames import Estimator
from lpvguard.drives.tables import Drive
from lpvguard.identify.error_band import driven_amplitudes, error_band
from lpvguard.identify.error_domain import ErrorDomain
from lpvguard.identify.error_prior import USUAL, ErrorPrior, OutputSums, hyperparameters
from lpvguard.identify.error_sums import (
    DIRECTIONS,
    ErrorSums,
    common_fit,
    common_products,
    counted_samples,
    deviations,
    error_sums,
    joined,
    noise_filter,
    sum_of,
)
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project

PROJECT = load_project("g80")
MODEL = NominalModel(PROJECT)
ESTIMATOR = Estimator.from_project(PROJECT, MODEL)
DOMAIN = ErrorDomain.from_estimator(ESTIMATOR, PROJECT.frame_test.excited_std)


def noise(random: np.random.Generator, n: int, band_hz: tuple[float, float]) -> np.ndarray:
    """Noise of unit variance within a band, (n,)."""
    x = sosfilt(
        butter(2, band_hz, "bandpass", fs=1 / DOMAIN.Ts, output="sos"), random.standard_normal(n + 3000)
    )
    return x[3000:] / x[3000:].std()


def drive_of(
    random: np.random.Generator,
    gain: float = 0.2,
    delay: int = 0,
    speed: float = 10.0,
    seconds: float = 60.0,
    disturbance: float = 3e-3,
) -> tuple[Drive, np.ndarray, np.ndarray]:
    """A drive whose output is 1 + gain times the nominal one, later by ``delay`` samples; with e and yhat."""
    n = round(seconds / DOMAIN.Ts)
    v = np.full(n, speed) + 0.4 * noise(random, n, (0.004, 0.02))
    u = 0.03 * noise(random, n, (0.05, 3.0))[:, None]
    yhat = MODEL.simulate(v, u, np.zeros(1))
    y = (1 + gain) * np.roll(yhat, delay, axis=0)
    y += disturbance * noise(random, n, (0.03, 1.0))[:, None] + 5e-4 * random.standard_normal((n, 1)) + 0.01
    return Drive("made_up", DOMAIN.Ts * np.arange(n), v, u, y), y - yhat, yhat


def sums_of(*drives: tuple[Drive, np.ndarray, np.ndarray], groups: list[str] | None = None) -> ErrorSums:
    named, setup = groups or [""] * len(drives), (DOMAIN, MODEL, ESTIMATOR)
    common = common_fit(sum_of([common_products(*setup, *d) for d in drives]))
    return joined([error_sums(*setup, *d, g, common) for d, g in zip(drives, named, strict=True)])


def test_the_hats_of_the_lags_sum_to_one_up_to_the_last_knot():
    inside = DOMAIN.lags[-1] - DOMAIN.lags[0] + 1
    assert np.allclose(DOMAIN.taps[:, :inside].sum(axis=0), 1)
    late = DOMAIN.lags == 3
    omega = np.array([0.7, 5.0])
    assert np.allclose(DOMAIN.response(omega)[:, late][:, 0], np.exp(-3j * omega * DOMAIN.step_s))


def test_deviations_have_unit_size_at_the_highest_bin():
    response = DOMAIN.response(DOMAIN.omega[-1:]) @ deviations(DOMAIN)
    assert np.allclose(np.abs(response), 1)
    low = np.abs(DOMAIN.response(np.array([0.05])) @ deviations(DOMAIN))[0]
    assert low[0] == pytest.approx(1) and low[1] < 0.01 and low[2] < 1e-4


def test_a_sample_counts_only_with_all_its_lags():
    inside = np.ones(400, bool)
    inside[200] = False
    counted = counted_samples(DOMAIN, inside)
    ahead = -DOMAIN.lags[0]
    k = np.flatnonzero(counted)
    first = k.min()
    assert not counted[200 - ahead : 200 + first + 1].any()
    assert counted[200 - ahead - 1] and counted[200 + first + 1] and k.max() == 400 - ahead - 1


def test_the_noise_filter_whitens_an_autoregression():
    random = np.random.default_rng(1)
    x = lfilter([1.0], [1.0, -1.4, 0.6], random.standard_normal(20000))
    whiten, variance = noise_filter(x, np.ones(len(x), bool))
    assert whiten[:3] == pytest.approx([1.0, -1.4, 0.6], abs=0.03)
    assert np.abs(whiten[3:]).max() < 0.03 and variance == pytest.approx(1.0, rel=0.03)


def test_sums_of_two_drives_are_those_of_each_added():
    random = np.random.default_rng(2)
    a, b = (sums_of(drive_of(random, seconds=30.0)) for _ in range(2))
    both, other = a.plus(b), joined([a, b])
    for name in ("gram", "cross", "square", "samples", "drive_gram", "drive_cross", "drive_own", "histogram"):
        assert np.array_equal(getattr(both, name), getattr(other, name))
    assert both.gram[0] == pytest.approx(a.gram[0] + b.gram[0])
    assert both.drive_gram.shape[0] == 2 and both.groups == ("", "")


def test_missing_and_unexcited_samples_do_not_count():
    drive, e, yhat = drive_of(np.random.default_rng(3))
    v = drive.v.copy()
    v[1500:] = 0.0
    assert sums_of((replace(drive, v=v), e, yhat)).samples[0] < 0.55 * sums_of((drive, e, yhat)).samples[0]
    still = replace(drive, u=np.full_like(drive.u, MODEL.input_offset[0]))
    assert sums_of((still, e, yhat)).samples[0] == 0


@pytest.mark.parametrize("groups", [("a", "a", "b"), ("", "", "")])
def test_evidence_and_posterior_are_those_of_the_dense_gaussian(groups):
    random = np.random.default_rng(4)
    n = 50
    prior = ErrorPrior(DOMAIN, len(set(groups)) > 1)
    p = len(prior.root(np.zeros(len(prior.names))))
    X = random.standard_normal((3, n, p)) * 0.3
    y = random.standard_normal((3, n))
    gram, cross = np.einsum("dni,dnj->ij", X, X), np.einsum("dni,dn->i", X, y)
    own = 3 * random.standard_normal((3, n, DIRECTIONS))
    sums = ErrorSums(
        gram[None],
        cross[None],
        np.array([(y**2).sum()]),
        np.array([y.size]),
        np.einsum("dni,dnj->dij", X, own)[:, None],
        np.einsum("dni,dn->di", own, y)[:, None],
        np.einsum("dni,dnj->dij", own, own)[:, None],
        np.zeros((16, 20)),
        groups,
    )
    of_output = OutputSums(sums, 0)
    everything = X.reshape(-1, p)
    values = []
    for x in (np.zeros(len(prior.names)), random.standard_normal(len(prior.names))):
        root = prior.root(x)
        K = root @ root.T
        S = np.eye(3 * n) + everything @ K @ everything.T
        for d in range(3):
            for other in range(3):
                variance = prior.deviation(x) * (d == other)
                if len(set(groups)) > 1:
                    variance = variance + prior.deviation(x, group=True) * (groups[d] == groups[other])
                S[d * n : (d + 1) * n, other * n : (other + 1) * n] += own[d] * variance @ own[other].T
        flat = y.ravel()
        dense = -0.5 * flat @ np.linalg.solve(S, flat) - 0.5 * np.linalg.slogdet(S)[1]
        posterior = of_output.posterior(prior, x)
        values.append(posterior.evidence)
        assert posterior.evidence == pytest.approx(dense, rel=1e-8)
        assert posterior.mean == pytest.approx(
            K @ everything.T @ np.linalg.solve(S, flat), rel=1e-5, abs=1e-7
        )
        covariance = K - K @ everything.T @ np.linalg.solve(S, everything @ K)
        assert posterior.root @ posterior.root.T == pytest.approx(covariance, rel=1e-4, abs=1e-7)
        evidence, slope = of_output.evidence_slope(prior, x)
        assert evidence == posterior.evidence
        steps = 1e-3 * np.eye(len(x))
        apart = [
            of_output.posterior(prior, x + h).evidence - of_output.posterior(prior, x - h).evidence
            for h in steps
        ]
        assert slope == pytest.approx(np.array(apart) / 2e-3, rel=1e-3, abs=1e-3)
    assert values[0] != values[1]


@pytest.fixture(scope="module")
def six_drives() -> ErrorSums:
    """Drives between 7 and 12 m/s with a gain error of 0.2."""
    random = np.random.default_rng(5)
    return sums_of(*(drive_of(random, speed=v) for v in (7.0, 8.0, 9.0, 10.0, 11.0, 12.0)))


@pytest.mark.slow("4 s: the hyperparameters of a band")
def test_the_band_holds_a_known_error_and_is_wide_where_nobody_drove(six_drives):
    band = error_band(DOMAIN, six_drives, 0, DOMAIN.omega, seed=1)
    driven = (band.speed > 7) & (band.speed < 12)
    below = DOMAIN.omega < 10
    assert (band.upper >= 0.2).all()
    assert (np.abs(band.centre - 0.2) <= band.k * band.sd).all()
    assert band.upper[below][:, driven].max() < 0.32
    assert band.sd[0, -1].min() > 2 * band.sd[0, driven].max()
    again = error_band(DOMAIN, six_drives, 0, DOMAIN.omega, seed=1)
    assert np.array_equal(band.upper, again.upper)


@pytest.mark.slow("8 s: the hyperparameters of two bands")
def test_drives_that_deviate_make_the_band_wider(six_drives):
    random = np.random.default_rng(6)
    gains = 0.2 + 0.06 * random.standard_normal(8)
    drives = [drive_of(random, g, speed=v) for g, v in zip(gains, np.linspace(7, 12, 8), strict=True)]
    wide = error_band(DOMAIN, sums_of(*drives), 0, DOMAIN.omega, seed=1)
    narrow = error_band(DOMAIN, six_drives, 0, DOMAIN.omega, seed=1)
    assert 0.03 < wide.hyper["gain"] < 0.12 and narrow.hyper["gain"] < 0.015
    driven = (wide.speed > 7.5) & (wide.speed < 11.5)
    assert wide.sd[0, driven].min() > 3 * narrow.sd[0, driven].max()


@pytest.mark.slow("8 s: the hyperparameters of a band")
def test_a_drive_does_not_explain_its_own_error():
    """Drives that deviate by a delay: of the drive's own error their gains would be found far from 0."""
    random = np.random.default_rng(10)
    delays = np.round(random.standard_normal(10)).astype(int)
    drives = [
        drive_of(random, 0.0, delay=d, speed=v) for d, v in zip(delays, np.linspace(5, 16, 10), strict=True)
    ]
    band = error_band(DOMAIN, sums_of(*drives), 0, DOMAIN.omega, seed=1)
    assert band.hyper["gain"] < 0.02
    middle = (band.speed > 6) & (band.speed < 15)
    assert np.abs(band.centre[0, middle]).max() < 0.05


@pytest.mark.slow("8 s: the hyperparameters of two bands")
def test_deviations_that_groups_share_count_as_the_groups():
    random = np.random.default_rng(7)
    gains = np.repeat(0.1 + 0.08 * random.standard_normal(6), 3)
    drives = [drive_of(random, g, speed=v) for g, v in zip(gains, np.tile([8, 9.5, 11], 6), strict=True)]
    band = error_band(DOMAIN, sums_of(*drives, groups=list(np.repeat(list("abcdef"), 3))), 0, DOMAIN.omega, 1)
    assert band.hyper["group_gain"] > 4 * band.hyper["gain"]
    pooled = error_band(DOMAIN, sums_of(*drives), 0, DOMAIN.omega, 1)
    assert "group_gain" not in pooled.hyper and pooled.hyper["gain"] > 0.03


@pytest.mark.slow("4 s: the hyperparameters of a band")
def test_a_vehicle_that_responds_sooner_than_its_model_is_held():
    random = np.random.default_rng(8)
    drives = [drive_of(random, 0.0, delay=-6, speed=v) for v in np.linspace(6, 14, 6)]
    band = error_band(DOMAIN, sums_of(*drives), 0, DOMAIN.omega, 1)
    truth = np.exp(6j * DOMAIN.omega * DOMAIN.Ts) - 1
    middle = (band.speed > 6) & (band.speed < 14)
    assert (np.abs(truth)[:, None, None] <= band.upper).all()
    assert np.abs(band.centre[:6, middle] - truth[:6, None, None]).max() < 0.05


@pytest.mark.parametrize("scale", ["common", "deviation", "ignorance"])
def test_scales_of_the_prior_change_what_they_name(scale):
    usual = ErrorPrior(DOMAIN, groups=False)
    wider = ErrorPrior(DOMAIN, groups=False, scales=replace(USUAL, **{scale: 2.0}))
    x = np.zeros(len(usual.names))
    ratios = (wider.root(x) ** 2).sum() / (usual.root(x) ** 2).sum()
    deviation = wider.deviation(x) / usual.deviation(x)
    assert np.allclose(deviation, 4.0 if scale == "deviation" else 1.0)
    assert (ratios > 1.01) == (scale != "deviation")


def test_an_instrument_frees_the_estimate_of_the_drivers_feedback():
    random = np.random.default_rng(9)
    biased, free = [], []
    for _ in range(4):
        n = 4000
        outside = 0.03 * noise(random, n, (0.05, 2.0))
        d = 0.08 * noise(random, n, (0.05, 2.0))
        v = np.full(n, 10.0)
        u = (outside - 0.3 * d)[:, None]
        yhat = MODEL.simulate(v, u, np.zeros(1))
        y = 1.1 * yhat + d[:, None]
        drive = Drive("closed", DOMAIN.Ts * np.arange(n), v, u, y)
        biased.append((drive, y - yhat, yhat))
        free.append((replace(drive, instrument=outside), y - yhat, yhat))
    errors = []
    for drives in (biased, free):
        sums = sums_of(*drives)
        own = sums.drive_gram[:, 0][:, : len(DOMAIN.lags), 0]
        zero = int(np.flatnonzero(DOMAIN.lags == 0)[0])
        errors.append(abs(sums.drive_cross[:, 0, 0].sum() / own[:, zero].sum() - 0.1))
    assert errors[0] > 0.1 and errors[1] < 0.05


def test_amplitudes_are_those_driven_about_a_speed():
    histogram = np.zeros((16, 20))
    histogram[4, 8], histogram[12, 4] = 100, 100
    slow, fast = driven_amplitudes(DOMAIN, histogram, np.array(DOMAIN.speed_range))
    assert slow[1] > slow[0] and fast[1] > fast[0]
    assert slow[0] > fast[1] / 1.5**2
    nobody = driven_amplitudes(DOMAIN, np.zeros((16, 20)), np.array([10.0]))
    assert np.isfinite(nobody).all()


def test_hyperparameters_of_no_data_are_the_priors():
    prior = ErrorPrior(DOMAIN, groups=False)
    p = len(prior.root(np.zeros(len(prior.names))))
    empty = ErrorSums(
        np.zeros((1, p, p)),
        np.zeros((1, p)),
        np.zeros(1),
        np.zeros(1),
        np.zeros((1, 1, p, DIRECTIONS)),
        np.zeros((1, 1, DIRECTIONS)),
        np.zeros((1, 1, DIRECTIONS, DIRECTIONS)),
        np.zeros((16, 20)),
        ("",),
    )
    hyper = hyperparameters(prior, OutputSums(empty, 0))
    assert np.abs(hyper.x).max() < 1e-3
    assert np.allclose(hyper.root @ hyper.root.T, np.eye(len(hyper.x)), atol=0.02)
