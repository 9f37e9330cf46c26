"""The resolution of a sensor bounds the disturbance from below. Rounding alone falsifies no vehicle."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from lpvguard.drives.frames import Estimator
from lpvguard.drives.tables import Drive, list_experiments, read_drive
from lpvguard.engine.validation import s1
from lpvguard.extras.bench import fleet
from lpvguard.identify import identification as stage
from lpvguard.identify.bounds import counted_frames, nominal_error
from lpvguard.identify.deciders import unresolved
from lpvguard.identify.energy import EnergyTest
from lpvguard.identify.resolution import (
    RARE,
    Resolution,
    grid_step,
    largest_of_rounding,
    noise_deviation,
    resolution_of,
)
from lpvguard.identify.scratch import scratch_core
from lpvguard.identify.weights import coefficients_of
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import parse_project

STEP = 0.02
"""rad/s: a coarse yaw rate, 1.1 degrees a second."""


def rounded(y: np.ndarray, step: float) -> np.ndarray:
    return np.round(y / step) * step


def test_the_step_of_a_grid_is_found_where_there_is_one():
    random = np.random.default_rng(1)
    y = np.cumsum(random.standard_normal(4000)) * 0.01
    q = np.radians(0.02)
    assert grid_step(rounded(y, q)) == pytest.approx(q, rel=1e-9)
    assert grid_step(rounded(y, q) + 0.123456) == pytest.approx(q, rel=1e-6), "a grid has any offset"
    written = np.array([float(f"{x:.6g}") for x in rounded(y, q)])
    assert grid_step(written) == pytest.approx(q, rel=1e-3), "written with few digits"
    assert grid_step(np.array([0.0, 0.5, 0.0, 0.0, 0.5])) == 0.5
    assert grid_step(y) == 0.0
    between = (rounded(y, q)[1:] + 0.3 * np.diff(rounded(y, q)))[:500]
    assert grid_step(np.r_[between, y[:50]]) == 0.0, "interpolated: no grid is left"
    assert np.isnan(grid_step(np.zeros(9)))


def test_noise_is_told_from_what_is_smooth_and_from_jumps():
    random = np.random.default_rng(2)
    n = 40_000
    t, settled = np.arange(n) * 0.02, np.ones(n, bool)
    smooth = 0.3 * np.sin(t) + 0.1 * t
    y = smooth + 1e-3 * random.standard_normal(n)
    y[::977] += 1.0
    assert noise_deviation(y, settled) == pytest.approx(1e-3, rel=0.03)
    settled[: n // 2] = False
    y[: n // 2] += random.standard_normal(n // 2)
    assert noise_deviation(y, settled) == pytest.approx(1e-3, rel=0.03)
    assert np.isnan(noise_deviation(y, np.zeros(n, bool)))
    assert noise_deviation(smooth, ~settled) < 2e-4


@pytest.mark.parametrize("n", [1, 2, 5, 10])
def test_the_largest_share_of_rounding_is_that_of_all_signs(n):
    random = np.random.default_rng(n)
    kernel = random.standard_normal(n) + 1j * random.standard_normal(n)
    signs = np.array(list(product((-0.5, 0.5), repeat=n)))
    assert largest_of_rounding(kernel) == pytest.approx(np.abs(signs @ kernel).max(), rel=1e-12)


def test_rounding_adds_at_most_two_over_pi_steps_to_a_frame_and_half_a_step_at_zero_frequency(g80):
    estimator = Estimator.from_project(g80, NominalModel(g80))
    floor = Resolution(np.array([STEP]), np.zeros(1)).floor(estimator)[:, 0]
    assert floor[0] == pytest.approx(STEP / 2)
    assert np.all(floor[1:] >= 2 / np.pi * STEP * (1 - 1e-4)) and np.all(floor[1:] < 0.65 * STEP)
    # Far above what white rounding adds: its root mean square is q / sqrt(12) times the kernel's norm.
    white = (
        STEP / np.sqrt(12) * np.array([np.linalg.norm(estimator.kernel(k)) for k in range(estimator.n_bins)])
    )
    assert np.all(floor > 3 * white)
    # A signal of less than half a step is lost whole, and comes close.
    k, n = 4, int(estimator.length[4])
    lost = 0.5 * STEP * np.sign(np.cos(2 * np.pi * estimator.cycles[k] / n * np.arange(n) + 0.1))
    assert 0.99 * floor[k] < np.abs(estimator.kernel(k) @ lost) <= floor[k]


@pytest.mark.slow("3 s: drives of noise")
def test_noise_alone_is_rarely_above_its_floor(g80):
    estimator, random = Estimator.from_project(g80, NominalModel(g80)), np.random.default_rng(3)
    floor = Resolution(np.zeros(1), np.array([1e-3])).floor(estimator)[:, 0]
    frames = 40_000
    for k in (0, 8, 10):
        noise = 1e-3 * random.standard_normal((frames, int(estimator.length[k])))
        above = int((np.abs(noise @ estimator.kernel(k)) > floor[k]).sum())
        # Five standard deviations of a Poisson number about 40.
        assert abs(above - RARE * frames) < 5 * np.sqrt(RARE * frames), (k, above)


def test_what_the_project_file_states_holds_and_the_least_of_the_drives_else(g80):
    drives = [np.array([[2e-3], [3e-3]]), np.array([[1e-3], [np.nan]]), np.array([[np.nan], [4e-3]])]
    least = np.fmin.reduce(drives)
    seen = Resolution.for_project(g80, least)
    assert seen.step == pytest.approx([1e-3])
    assert seen.noise == pytest.approx([np.sqrt(9e-6 - 1e-6 / 12)]), "rounding is not counted twice"
    assert Resolution.for_project(g80, np.full((2, 1), np.nan)).noise.tolist() == [0.0]
    document = g80.model_dump(by_alias=True)
    output = next(s for s in document["signals"] if s["role"] == "output")
    assert "resolution" not in output and "noise" not in output, "stored as before where nothing is stated"
    output |= {"resolution": 5e-3, "noise": 0.0}
    stated = Resolution.for_project(parse_project(document, "g80"), least)
    assert (stated.step.tolist(), stated.noise.tolist()) == ([5e-3], [0.0])
    again = parse_project(parse_project(document, "g80").model_dump(by_alias=True), "g80").outputs[0]
    assert (again.resolution, again.noise) == (5e-3, 0.0)
    document["signals"][0] |= {"resolution": 0.1}
    with pytest.raises(ValueError, match="speed: resolution and noise apply to outputs only"):
        parse_project(document, "g80")


def test_rounding_of_any_sign_stays_within_sigmas_floor(identified):
    stored, random = stage.load(identified), np.random.default_rng(4)
    test: EnergyTest = stored.energy
    floor = Resolution(np.array([STEP]), np.zeros(1)).energy_floor(test.F, test.Ts, test.memories_s)[:, 0]
    n = 6000
    v, none = np.full(n, 10.0), np.zeros((n, 1))
    largest = np.zeros(len(floor))
    for f_hz in (0.0, 0.02, 0.3, 1.0, 3.0, 25.0):
        turn = np.where(random.random(n) < f_hz * test.Ts, -1.0, 1.0) if f_hz < 25.0 else np.full(n, -1.0)
        e = (STEP / 2 * np.cumprod(turn))[:, None]
        needs = test.at_rest().needs(e, none, v)
        largest = np.fmax(largest, needs["error"][:, 0])
    assert np.all(largest <= floor)
    assert largest[0] > 0.8 * floor[0] and largest[-1] > 0.8 * floor[-1], (
        "and close to it where a sign stays or alternates"
    )
    needs = test.needs(np.full((n, 1), 1e-9), np.ones((n, 1)), v) | {"memory": test.start}
    np.testing.assert_array_equal(test.with_sigma(needs, floor[:, None]).sigma[:, 0], floor)


@pytest.fixture(scope="module")
def coarse(tmp_path_factory) -> Path:
    """Drives of a vehicle that is the model, but for its yaw rate in steps of STEP: lively ones, of which two
    in three set the bounds."""
    folder = tmp_path_factory.mktemp("coarse") / "drives"
    folder.mkdir()
    rows = ["experiment,split,driver"]
    for i in range(6):
        drive = quantised(i, 0.02)
        columns = np.column_stack([drive.t, drive.v, drive.u[:, 0], drive.y[:, 0]])
        np.savetxt(
            folder / f"d{i}.csv", columns, delimiter=",", header="t,v,delta,r", comments="", fmt="%.9g"
        )
        rows.append(f"d{i},{'valid' if i % 3 == 2 else 'train'},robot")
    (folder / "experiments.csv").write_text("\n".join(rows) + "\n")
    return folder


def quantised(seed: int, amplitude: float) -> Drive:
    """A drive with sines of this amplitude [rad] at the input."""
    project = fleet.vehicle()
    random = np.random.default_rng([5, seed])
    t = np.arange(int(120 / project.Ts_s)) * project.Ts_s
    v = random.uniform(7.0, 14.0) * (1 + 0.03 * np.sin(0.3 * t))
    u = sum(amplitude * np.sin(w * t + random.uniform(0, 6)) for w in (3.1, 4.9, 7.7, 12.3))[:, None]
    y = NominalModel(project).simulate(v, u, np.zeros(1))
    return Drive(f"d{seed}", t, v, u, rounded(y, STEP))


def falsified(identification: stage.Identification, drive: Drive) -> int:
    """How many frames of a drive have a margin above 1, and samples a ratio of the energy test."""
    assert identification.energy is not None and identification.change is not None
    coefficients = coefficients_of(
        identification.project,
        identification.model,
        identification.estimator,
        identification.weights,
        1.0,
        identification.energy,
        identification.change,
    )
    with scratch_core(identification.project, coefficients) as core:
        run = core.monitor().run_drive(drive)
    assert run.frames.counted.any()
    return int((run.frames.margin[run.frames.counted] > 1.0).sum() + (run.energy > 1.001).sum())


@pytest.mark.slow("4 s: an identification")
def test_a_vehicle_whose_only_sin_is_rounding_is_not_falsified(coarse, monkeypatch):
    """In a gentle drive the output changes by a bit or two, or reads zero, unlike in the drives that set the
    bounds."""
    identification, _ = stage.identify(fleet.vehicle(), coarse)
    assert identification.bounds.resolution.step == pytest.approx([STEP])
    floor, speaks = (
        identification.bounds.B_w_floor,
        np.setdiff1d(np.arange(identification.estimator.n_bins), identification.weights.silent),
    )
    assert len(speaks) > 3, "and yet a vehicle that does not respond would be"
    assert (identification.bounds.B_w >= floor).all() and (
        identification.bounds.B_w[speaks] == floor[speaks]
    ).any()
    (said,) = unresolved(identification)
    assert said.startswith(
        "the limit of the sensor of yaw_rate decides its B_w, and the drives need no more, at 0"
    )
    assert "steps of 0.02 rad/s, noise of 0 rad/s" in said
    gentle = [quantised(100 + i, a) for i, a in enumerate((2e-4, 5e-4, 1e-3, 2e-3))]
    assert set(np.unique(np.round(gentle[1].y / STEP))) <= {-1.0, 0.0, 1.0}, "a bit or two"
    assert [falsified(identification, drive) for drive in gentle] == [0, 0, 0, 0]

    monkeypatch.setattr(Resolution, "floor", lambda self, e: np.zeros((e.n_bins, 1)))
    monkeypatch.setattr(Resolution, "energy_floor", lambda self, F, Ts, memories_s: np.zeros((len(F), 1)))
    without, _ = stage.identify(fleet.vehicle(), coarse)
    assert min(falsified(without, drive) for drive in gentle[1:]) > 0, "without the floor it is"


@pytest.mark.unhurried
def test_frames_of_rounding_are_within_the_floor_whatever_the_drive(coarse):
    """The theorem on frames, without the core: an error of rounding alone has a margin of 1 at most."""
    project = fleet.vehicle()
    model = NominalModel(project)
    estimator = Estimator.from_project(project, model)
    floor = Resolution(np.array([STEP]), np.zeros(1)).floor(estimator)
    worst = []
    for i, amplitude in enumerate((1e-4, 7e-4, 3e-3, 0.03)):
        drive = quantised(200 + i, amplitude)
        exact = model.simulate(drive.v, drive.u, np.zeros(1))
        e, yhat = drive.y - exact, exact
        for s in counted_frames(drive, e, yhat, model, estimator):
            worst.append(s1.margin(s.E, s.Z, np.zeros((1, 1)), floor[[s.bin]]).max(initial=0.0))
    assert 0.4 < max(worst) <= 1.0
    drive = read_drive(list_experiments(coarse)[0].path, project)
    e, _ = nominal_error(drive, model)
    step, noise = resolution_of(drive, e, estimator)
    assert step == pytest.approx([STEP]) and noise == pytest.approx([0.0], abs=1e-12)
    assert np.abs(e).max() < 0.6 * STEP


def test_what_a_quick_input_does_to_the_vehicle_or_a_coarse_one_to_the_model_is_no_noise(g80):
    model, random = NominalModel(g80), np.random.default_rng(8)
    estimator = Estimator.from_project(g80, model)
    n = 6000
    t, v, noise = np.arange(n) * g80.Ts_s, np.full(n, 10.0), 1e-3 * random.standard_normal((n, 1))
    slow = 0.02 * np.sin(0.8 * t)[:, None]
    for demand, true in (
        (quick := slow + 0.05 * random.standard_normal((n, 1)), quick),
        (rounded(slow, 0.01), slow),
    ):
        y = model.simulate(v, true, np.zeros(1)) + noise
        drive = Drive("made", t, v, demand, y)
        e, _ = nominal_error(drive, model)
        stated = resolution_of(drive, e, estimator)[1, 0]
        both = [noise_deviation(x[:, 0], estimator.settled(v)) for x in (y, e)]
        assert stated == pytest.approx(1e-3, rel=0.15) and min(both) == stated
