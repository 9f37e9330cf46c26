"""The baselines say what their definitions say, are tuned on nothing they are judged by, and rank
honestly."""

from __future__ import annotations

import numpy as np
import pytest

from lpvguard.drives.frames import Estimator
from lpvguard.drives.tables import list_experiments
from lpvguard.evaluate.baseline_study import BaselineStudy
from lpvguard.evaluate.baselines import GRID, KINDS, Bank, Baseline, Scales
from lpvguard.evaluate.detection import FaultOutcome, Injection, median_time, ranking
from lpvguard.identify import run as identify
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project

SPEED = 12.0


def bank(name: str, error, input_rms) -> Bank:
    project = load_project(name)
    model = NominalModel(project)
    return Bank(model, Estimator.of(project, model), Scales(np.array(error), np.array(input_rms)))


def statistic(bank: Bank, baseline: Baseline, e: np.ndarray, v: np.ndarray) -> np.ndarray:
    return dict(bank.statistics([baseline], e, v))[baseline]


@pytest.fixture(scope="module")
def truck() -> Bank:
    return bank("truck", [0.02, 0.01], [1.0])


@pytest.fixture
def error(truck):
    random = np.random.default_rng(4)
    v = np.full(6000, SPEED)
    v[3000:3100] = 2.0  # out of range: everything starts again
    return random.standard_normal((6000, 2)) * [0.02, 0.01], v


def test_rms_is_that_of_the_whole_window_and_says_nothing_before(truck, error):
    e, v = error
    n, usable = 50, truck.estimator.settled(v)
    s = statistic(truck, Baseline("rms", window_s=0.5), e, v)
    for k in range(n, 6000, 37):
        if usable[k + 1 - n : k + 1].all():
            assert s[k] == pytest.approx(
                np.sqrt(np.mean(np.sum((e[k + 1 - n : k + 1] / [0.02, 0.01]) ** 2, axis=1))), rel=1e-9
            )
        else:
            assert s[k] == -np.inf
    assert np.isfinite(s).any() and not np.isnan(s).any()


def test_cusum_is_pages_recursion_from_zero_at_each_start(truck, error):
    e, v = error
    usable, drift = truck.estimator.settled(v), 0.25
    s = statistic(truck, Baseline("cusum", drift=drift), e, v)
    g = np.zeros((2, 2))
    for k in range(6000):
        if not usable[k]:
            g[:] = 0.0
            assert s[k] == -np.inf
            continue
        x = e[k] / [0.02, 0.01]
        g = np.maximum(0.0, g + np.array([x, -x]) - drift)
        assert s[k] == pytest.approx(g.max(), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("q", [0.003, 0.3])
def test_the_innovations_of_the_process_that_the_filter_assumes_are_chi_square(truck, q):
    """Simulated with the covariances of the module's docstring, nu' S^-1 nu has the mean n_y and nu is
    white."""
    from scipy.linalg import solve_discrete_lyapunov

    random, N = np.random.default_rng(8), 40_000
    d = truck.model.discretise(np.array([SPEED]))
    A, B = d.Ad[0], (d.B_old + d.B_new)[0]
    size = q * np.sqrt(np.diag(solve_discrete_lyapunov(A, B @ B.T)))
    x, e = np.zeros(len(A)), np.empty((N, 2))
    for k in range(N):
        e[k] = truck.model.C @ x + random.standard_normal(2) * [0.02, 0.01]
        x = A @ x + random.standard_normal(len(A)) * size
    nis = statistic(truck, Baseline("nis", window_s=0.01, process_ratio=q), e, np.full(N, SPEED))
    assert nis[2000:].mean() == pytest.approx(2.0, rel=0.03)
    assert nis[2000:].var() == pytest.approx(4.0, rel=0.1)


def test_with_little_process_noise_nis_becomes_the_mean_square(truck, error):
    """The filter then ignores e, and S is the covariance of the scales."""
    e, v = error
    nis, rms = (
        statistic(truck, b, e, v)
        for b in (Baseline("nis", window_s=1.0, process_ratio=1e-7), Baseline("rms", window_s=1.0))
    )
    said = np.isfinite(rms)
    np.testing.assert_allclose(nis[said], rms[said] ** 2, rtol=1e-3)


@pytest.fixture(scope="module")
def study(g80, synthetic, identified, core):
    stored = identify.load(identified)
    drives = identify.DriveSet(g80, NominalModel(g80), list_experiments(synthetic))
    names = tuple(stored.calibration.scores)
    return BaselineStudy(stored, drives, core, left_out=names, injection=Injection.usual()), names


@pytest.mark.parametrize("kind", KINDS)
def test_the_drive_under_test_takes_part_in_nothing(study, kind):
    """Whatever its statistics and cases are, parameters and threshold for it stay the same."""
    found, names = study
    for name in names[:3]:
        before = found.best(kind, name)
        largest, cases = dict(found.largest), dict(found.cases)
        try:
            found.largest[name] = {b: np.full(3, 1e9) for b in GRID}
            found.cases[name] = {
                key: {label: [FaultOutcome(name, 60.0, 0.02, None)] * 9 for label in table}
                for key, table in next(c for c in cases.values() if c).items()
            }
            assert found.best(kind, name) == before
            without = {n: found.largest[n][before[0]].max() for n in names if n != name}
            assert before[1] <= max(without.values()) and any(
                np.isclose(before[1], s) for s in without.values()
            )
        finally:
            found.largest, found.cases = largest, cases


def test_no_setting_of_the_grid_finds_more_on_the_drives_of_the_search(study):
    found, names = study

    def finds(b: Baseline) -> int:
        h = found.calibration(b, names[0]).threshold
        return sum(
            c.found
            for n, table in found.cases.items()
            if n != names[0] and table
            for of in table[b, h].values()
            for c in of
        )

    for kind in KINDS:
        best, _ = found.best(kind, names[0])
        assert finds(best) == max(finds(b) for b in GRID if b.kind == kind)


def test_an_alarm_in_the_last_seconds_is_counted(study):
    """Every sample from ``piece_starts`` on belongs to a piece, the drive's remainder after whole minutes
    too."""
    found, names = study
    b, name = GRID[0], names[0]
    pieces = found.largest[name][b]
    assert found.own.alarmed_pieces(b, np.inf, name) == (0, len(pieces))
    last = {b: np.r_[np.full(len(pieces) - 1, -np.inf), 2.0]}
    largest = dict(found.largest)
    try:
        found.largest[name] = last
        assert found.own.alarmed_pieces(b, 1.0, name) == (1, len(pieces))
    finally:
        found.largest = largest


def test_the_largest_statistic_is_that_of_each_piece_and_none_is_left_out(study, g80, synthetic):
    found, names = study
    drive, e, _ = identify.DriveSet(g80, NominalModel(g80), list_experiments(synthetic)).load(names[0])
    statistics = dict(found.bank.statistics(GRID[:1], e, drive.v))[GRID[0]]
    largest, length = found.largest[names[0]][GRID[0]], round(60.0 / g80.Ts_s)
    assert len(largest) == -(-(len(drive.v) - 1) // length)
    for i, value in enumerate(largest):
        end = None if i == len(largest) - 1 else (i + 1) * length
        assert value == statistics[i * length : end].max()


def test_without_scores_a_baseline_never_alarms(study):
    """No drive on which it spoke calibrates it, and 0 is no threshold."""
    found, names = study
    largest = dict(found.largest)
    try:
        found.largest.update({n: {b: np.full(3, -np.inf) for b in GRID} for n in names})
        calibration = found.calibration(GRID[0], names[0])
        assert (
            calibration.threshold == np.inf
            and calibration.alpha is None
            and "not stated" in calibration.claim()
        )
    finally:
        found.largest = largest


def test_ranking_is_by_share_then_time_and_names_all_that_tie():
    def row(found, counted, median):
        return {"found": found, "counted": counted, "median_s": median}

    assert ranking({"monitor": row(7, 7, 3.0), "rms": row(6, 7, 0.1)}) == ["monitor"]
    assert ranking({"monitor": row(7, 7, 3.0), "rms": row(7, 7, 2.0)}) == ["rms"]
    assert ranking({"monitor": row(7, 7, 2.0), "rms": row(7, 7, 2.0), "nis": row(5, 7, 1.0)}) == [
        "monitor",
        "rms",
    ]
    assert ranking({"monitor": row(0, 7, None), "nis": row(0, 7, None)}) == [], (
        "nobody is best who found nothing"
    )
    assert ranking({"monitor": row(0, 7, None), "nis": row(1, 7, None)}) == ["nis"]
    assert ranking({"monitor": row(0, 0, None), "nis": row(0, 0, None)}) == []
    assert median_time([1.0, None, 3.0]) == 3.0 and median_time([None, None, 1.0]) is None
    assert median_time([]) is None
