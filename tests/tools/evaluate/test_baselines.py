"""The baselines say what their definitions say, are tuned on nothing they are judged by, and rank
honestly."""

from dataclasses import replace

import numpy as np
import pytest

from lpvguard.drives.frames import Estimator
from lpvguard.evaluate.baseline_study import BaselineStudy, Merit, alarmed
from lpvguard.evaluate.baselines import GRID, KINDS, Bank, Baseline, Scales, Sizes, regressors
from lpvguard.evaluate.comparison import DUEL_HEAD, duel_rows, duels
from lpvguard.evaluate.detection import Injection, median_time, ranking
from lpvguard.identify import identification as identify
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project

SPEED = 12.0
SHORT = Baseline("glr", window_s=0.4)


def bank(name: str, error, input_rms) -> Bank:
    project = load_project(name)
    model = NominalModel(project)
    moments = np.broadcast_to(np.diag([0.04, 0.01, 1.0]), (model.n_y, 3, 3))
    sizes = {b: np.ones(3 * model.n_y) for b in (*GRID, SHORT)}
    scales = Scales(np.array(error), np.array(input_rms), moments)
    return Bank(model, Estimator.from_project(project, model), scales, sizes)


def statistic(bank: Bank, baseline: Baseline, e: np.ndarray, v: np.ndarray, yhat=None, first=0) -> np.ndarray:
    yhat = np.zeros_like(e) if yhat is None else yhat
    return dict(bank.statistics([baseline], e, yhat, v, first))[baseline]


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


@pytest.mark.unhurried
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


@pytest.fixture
def nominal(error):
    """A nominal output that moves beside the errors."""
    e, _ = error
    return np.cumsum(np.random.default_rng(5).standard_normal(e.shape), axis=0) * 0.01


def test_the_tracker_is_the_regularised_fit_with_forgetting(truck, error, nominal):
    e, v = error
    b, Ts, usable = (
        Baseline("tracker", window_s=0.5, prior=0.2),
        truck.estimator.Ts,
        truck.estimator.settled(v),
    )
    (components,) = (c for _, c in truck.components([b], e, nominal, v))
    for k in (2900, 5999):
        first = k - int(np.argmin(usable[k::-1])) + 1 if not usable[: k + 1].all() else 0
        age = np.arange(k - first, -1, -1) * Ts
        for j in range(2):
            slope = np.r_[0.0, np.diff(nominal[:, j])] / Ts
            phi = np.stack([nominal[:, j], -slope, np.ones(len(v))], axis=1)[first : k + 1]
            weighted = phi * np.exp(-age / 0.5)[:, None]
            R = weighted.T @ phi + 0.2 * 0.5 / Ts * truck.scales.moments[j]
            theta = np.linalg.solve(R, weighted.T @ e[first : k + 1, j])
            np.testing.assert_allclose(components[3 * j : 3 * j + 3, k], np.abs(theta), rtol=1e-6)
    assert (components[:, ~usable] == -np.inf).all()


def test_the_ratio_is_that_of_the_best_onset_and_direction(truck, error, nominal):
    e, v = error
    Ts, usable = truck.estimator.Ts, truck.estimator.settled(v)
    s = statistic(truck, SHORT, e, v, nominal)
    for k in range(200, 6000, 97):
        best = []
        for n in (40, 20):
            if not usable[k + 1 - n : k + 1].all():
                continue
            newest = slice(k + 1 - n, k + 1)
            for j, size in enumerate((0.02, 0.01)):
                slope = np.r_[0.0, np.diff(nominal[:, j])] / Ts
                for phi in (nominal[newest, j], slope[newest], np.ones(n)):
                    best.append(abs(e[newest, j] @ phi) / np.sqrt(phi @ phi) / size)
        assert s[k] == (pytest.approx(max(best), rel=1e-6) if best else -np.inf)


@pytest.mark.parametrize("q", [0.0, 0.03])
def test_a_fault_along_a_direction_is_recovered(truck, q):
    """Without noise the ratio of the fault's own direction is the whole energy of the filtered error."""
    random, v = np.random.default_rng(6), np.full(4000, SPEED)
    nominal = np.cumsum(random.standard_normal((4000, 2)), axis=0) * 0.01
    e = 0.3 * nominal * [1.0, 0.0]
    b = Baseline("glr", window_s=5.0, process_ratio=q)
    (components,) = (c for _, c in truck.components([b], e, nominal, v))
    n = round(5.0 / truck.estimator.Ts)
    white = truck.innovations(q, e, v)[-n:]
    assert components[0, -1] == pytest.approx(np.sqrt(np.sum(white**2)), rel=1e-6) == components[:, -1].max()


def test_statistics_from_a_sample_on_are_those_of_the_whole_drive(truck, error, nominal):
    e, v = error
    for b in (*(next(b for b in GRID if b.kind == kind) for kind in KINDS), SHORT):
        whole = statistic(truck, b, e, v, nominal)
        for first in (1, 3050, 5990):
            np.testing.assert_array_equal(statistic(truck, b, e, v, nominal, first), whole[first:])


def test_scales_are_means_over_all_usable_samples(error):
    e, v = error
    usable, u = v > 5.0, np.ones((len(v), 1))
    scales = Scales.from_sizes(
        [Sizes.from_drive(e, e, u, usable, 0.01), Sizes.from_drive(2 * e, e, u, usable, 0.01)]
    )
    np.testing.assert_allclose(scales.error, np.sqrt(2.5 * np.mean(e[usable] ** 2, axis=0)))
    phi = regressors(e, 0.01)[1][:, usable]
    np.testing.assert_allclose(scales.moments[1], phi @ phi.T / usable.sum())


@pytest.fixture(scope="module")
def study(g80, synthetic, identified, core):
    stored = identify.load(identified)
    drives = identify.DriveSet(g80, NominalModel(g80), synthetic)
    names = tuple(stored.calibration.scores)
    usual = Injection.usual()
    few = replace(usual, starts=2, ways=("step", "start"), faults=usual.faults[::3])
    return BaselineStudy(stored, drives, core, left_out=names, injection=few), names


@pytest.mark.slow("10 s: two evaluations")
@pytest.mark.parametrize("kind", KINDS)
def test_the_drive_under_test_takes_part_in_nothing(study, kind):
    """Whatever its statistics and cases are, parameters and threshold for it stay the same."""
    baseline_study, names = study
    for name in names[:3]:
        before = baseline_study.best(kind, name)
        largest, merits = dict(baseline_study.largest), dict(baseline_study.merits)
        try:
            baseline_study.largest[name] = {b: np.full(3, 1e9) for b in GRID}
            baseline_study.merits[name] = {
                key: Merit(1000 + i, 0.0) for i, key in enumerate(next(iter(merits.values())))
            }
            assert baseline_study.best(kind, name) == before
            without = {n: baseline_study.largest[n][before[0]].max() for n in names if n != name}
            threshold = before[1].threshold
            assert threshold <= max(without.values()) and any(
                np.isclose(threshold, s) for s in without.values()
            )
        finally:
            baseline_study.largest, baseline_study.merits = largest, merits


@pytest.mark.unhurried
def test_no_setting_of_the_grid_finds_more_on_the_drives_of_the_search(study):
    baseline_study, names = study

    def finds(b: Baseline) -> int:
        h = baseline_study.calibration(b, names[0]).threshold
        return sum(m[b, h].detected for n, m in baseline_study.merits.items() if n != names[0])

    for kind in KINDS:
        best, _ = baseline_study.best(kind, names[0])
        assert finds(best) == max(finds(b) for b in GRID if b.kind == kind) > 0


@pytest.mark.unhurried
def test_an_alarm_in_the_last_seconds_is_counted(study):
    """Every sample from ``piece_starts`` on belongs to a piece, the drive's remainder after whole minutes
    too."""
    baseline_study, names = study
    pieces = baseline_study.largest[names[0]][GRID[0]]
    assert alarmed(pieces, np.inf) == (0, len(pieces))
    assert alarmed(np.r_[np.full(len(pieces) - 1, -np.inf), 2.0], 1.0) == (1, len(pieces))


@pytest.mark.unhurried
def test_the_largest_statistic_is_that_of_each_piece_and_none_is_left_out(study, g80, synthetic):
    baseline_study, names = study
    drive, e, yhat = identify.DriveSet(g80, NominalModel(g80), synthetic).load(names[0])
    statistics = dict(baseline_study.bank.statistics(GRID[:1], e, yhat, drive.v))[GRID[0]]
    largest, length = baseline_study.largest[names[0]][GRID[0]], round(60.0 / g80.Ts_s)
    assert len(largest) == -(-(len(drive.v) - 1) // length)
    for i, value in enumerate(largest):
        end = None if i == len(largest) - 1 else (i + 1) * length
        assert value == statistics[i * length : end].max()


@pytest.mark.unhurried
def test_components_have_the_size_of_1_on_the_bound_setting_drives(study, g80, synthetic, identified):
    baseline_study, _ = study
    drives = identify.DriveSet(g80, NominalModel(g80), synthetic)
    setting = identify.load(identified).manifest["drives"]["bounds"]
    b = next(b for b in GRID if b.kind == "tracker")
    squares, count = 0.0, 0
    for name in setting:
        drive, e, yhat = drives.load(name)
        (components,) = (c for _, c in baseline_study.bank.components([b], e, yhat, drive.v))
        said = components[:, np.isfinite(components[0])]
        squares, count = squares + np.sum(said**2, axis=1), count + said.shape[1]
    np.testing.assert_allclose(baseline_study.bank.sizes[b], np.sqrt(squares / count))


@pytest.mark.unhurried
def test_without_scores_a_baseline_never_alarms(study):
    """No drive on which it spoke calibrates it, and 0 is no threshold."""
    baseline_study, names = study
    largest = dict(baseline_study.largest)
    try:
        baseline_study.largest.update({n: {b: np.full(3, -np.inf) for b in GRID} for n in names})
        calibration = baseline_study.calibration(GRID[0], names[0])
        assert (
            calibration.threshold == np.inf
            and calibration.alpha is None
            and "not stated" in calibration.claim()
        )
    finally:
        baseline_study.largest = largest


def test_a_duel_counts_rows_and_names_where_the_monitor_is_behind():
    def rows(*outcomes: tuple[int, float | None], alarms: int = 0) -> list[dict]:
        """Of each row's 7 starts as many found; the untouched drive alarms at the last ``alarms`` of them."""
        return [
            {
                "way": "ramp",
                "fault": f,
                "found": n,
                "counted": 7,
                "median_s": s,
                "cases": [
                    {"s": s if k < n else None, "untouched_s": 9.0 if k >= 7 - alarms else None}
                    for k in range(7)
                ],
            }
            for f, (n, s) in zip("abcde", outcomes, strict=True)
        ]

    ours = rows((7, 2.0), (7, 3.0), (6, 1.0), (0, None), (5, 2.0), alarms=1)
    other = rows((6, 1.0), (7, 3.0), (7, 2.0), (0, None), (5, 1.0), alarms=3)
    (duel,) = duels(ours, [{"kind": "rms", "faults": other}])
    assert [r["leads"] for r in duel["rows"]] == ["monitor", "tie", "rms", "nobody", "rms"]
    assert duel["behind"] == ["c", "e"] and duel["found"] == [25, 25] and duel["counted"] == 35
    assert (duel["as_often"], duel["sooner"], duel["later"]) == (4, 1, 2)
    assert duel["precluded"] == [0 + 0 + 1 + 1 + 1, 1 + 0 + 0 + 3 + 2]
    words = dict(zip(DUEL_HEAD, duel_rows({"duels": [duel]})[0], strict=True))
    assert words["missed for an alarm of its own, both"] == "3 and 6" and words["behind on"] == "c; e"


def test_a_duel_of_all_ways_has_one_row_a_fault_and_the_times_of_all_starts():
    def rows(**times: list[float | None]) -> list[dict]:
        """A fault in every way, with the times of its starts."""
        return [
            {
                "way": way,
                "fault": "a",
                "found": sum(s is not None for s in row_times),
                "counted": len(row_times),
                "median_s": median_time(row_times),
                "cases": [{"s": s, "untouched_s": None} for s in row_times],
            }
            for way, row_times in times.items()
        ]

    ours, other = rows(step=[1.0, 2.0], start=[9.0]), rows(step=[1.5, 1.5], start=[None])
    *ways, together = duels(ours, [{"kind": "rms", "faults": other}])
    assert [d["way"] for d in ways] == ["step", "start"] and together["way"] == "all"
    assert [d["rows"][0]["leads"] for d in ways] == ["tie", "monitor"]
    (row,) = together["rows"]
    assert (row["found"], row["counted"], row["median_s"]) == ([3, 2], 3, [2.0, 1.5])
    assert row["leads"] == "monitor" and together["found"] == [3, 2] and together["counted"] == 3
    assert duel_rows({"duels": [together]})[0][0] == "all ways"


def test_ranking_is_by_share_then_time_and_names_all_that_tie():
    def row(detected, counted, median):
        return {"found": detected, "counted": counted, "median_s": median}

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
