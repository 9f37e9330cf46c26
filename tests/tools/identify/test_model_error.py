"""The model error model on made-up drives of a vehicle whose error is known."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.drives.frames import Estimator
from lpvguard.drives.tables import Drive
from lpvguard.engine.validation import s1
from lpvguard.identify import model_error
from lpvguard.identify.bounds import FrameSet, fold, nominal_error, remainder
from lpvguard.identify.drive_set import Chosen, DriveSet
from lpvguard.identify.identification import _quiet, identify
from lpvguard.identify.model_error import (
    BIASED,
    INSTRUMENTAL,
    LEAST_FRAMES,
    PERIODS,
    ErrorEstimate,
    ErrorGrid,
    ModelError,
    Sums,
    beyond,
    claim,
    drive_sums,
    last_telling,
    prediction_error_filter,
    uncertainty_bound,
)
from lpvguard.identify.over_drives import OverDrives
from lpvguard.identify.weights import SMALLEST_NU
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import Project, parse_project

TS, RATE = 0.05, 2.0
"""Sample period [s], and the rate of the toy vehicle's one lag [1/s]."""
SAMPLES = 8000
DELTAS = (np.array([0.25, 0.15, -0.1]), np.array([-0.2, 0.0, 0.35]))
"""Errors of the two outputs, as impulse responses over samples."""


def toy(outputs: int = 1, **settings) -> Project:
    """First-order lags of unit gain, alike at every speed; ``settings``: of [model_error]."""

    def signal(role: str, name: str, unit: str, low: float, high: float) -> dict:
        return {
            "name": name,
            "role": role,
            "column": name,
            "unit": unit,
            "positive": "left",
            "min": low,
            "max": high,
        }

    return parse_project(
        {
            "schema": 1,
            "name": "toy",
            "title": "Toy vehicle",
            "Ts_s": TS,
            "seed": 1,
            "signals": [
                signal("scheduling", "v", "m/s", -1.0, 60.0),
                signal("input", "u", "1", -100.0, 100.0),
                *(signal("output", f"y{j}", "1", -1e3, 1e3) for j in range(outputs)),
            ],
            "model": {
                "speed_min_mps": 8.0,
                "speed_max_mps": 22.0,
                "A": [[-RATE]],
                "B": [[RATE]],
                "C": [[1.0]] * outputs,
            },
            "frames": {
                "periods": 3,
                "bins_per_decade": 5,
                "f_min_hz": 0.1,
                "f_max_hz": 0.7,
                "speed_tolerance": 0.15,
            },
            "bounds": {
                "structure": "S1_diagonal" if outputs > 1 else "S1",
                "nu_ceiling": {"f_hz": [1.0], "nu": [0.3]},
            },
            "model_error": {"speed_cells": 1, **settings},
            "weights": {},
            "frame_test": {"excited_std": 0.01},
            "data": {"bound_split": ["train"]},
        },
        "toy",
    )


class Toy:
    """A toy vehicle with its model, estimator and grid."""

    def __init__(self, outputs: int = 1, **settings):
        self.project = toy(outputs, **settings)
        self.model = NominalModel(self.project)
        self.estimator = Estimator.from_project(self.project, self.model)
        self.grid = ErrorGrid.from_project(self.project, self.estimator)

    def sums(self, drive: Drive) -> Sums:
        signals = nominal_error(drive, self.model)
        return drive_sums(self.grid, self.model, self.estimator, 0.01, drive, *signals)

    def drive(self, seed, v, u, deltas, disturbance, name="drive") -> Drive:
        """y = yhat + delta yhat + w of white noise, by output; ``v``, ``u`` (N,) or numbers."""
        t = TS * np.arange(len(u))
        v = np.broadcast_to(np.asarray(v, float), t.shape)
        yhat = self.model.simulate(v, u[:, None], np.zeros(self.project.n_y))
        noise = disturbance * np.random.default_rng([seed, 1]).standard_normal(yhat.shape)
        e = np.column_stack([lfilter(d, [1.0], z) for d, z in zip(deltas, yhat.T, strict=True)])
        return Drive(name, t, v, u[:, None], yhat + e + noise)

    def estimate(self, drives) -> ErrorEstimate:
        total = Sums.none(self.grid, self.project.n_y)
        for drive in drives:
            total = total.plus(self.sums(drive))
        return ErrorEstimate.from_sums(total, self.grid)


def white(seed: int, samples: int = SAMPLES, rms: float = 1.0) -> np.ndarray:
    return rms * np.random.default_rng([seed, 0]).standard_normal(samples)


def response(delta: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Of an impulse response over samples, (K,)."""
    return np.exp(-1j * np.outer(omega * TS, np.arange(len(delta)))) @ delta


def errors(estimate: ErrorEstimate, grid: ErrorGrid, deltas=DELTAS) -> np.ndarray:
    """|estimate - truth| / se, in the shape of the cells."""
    truth = np.stack([response(d, grid.omega) for d in deltas[: estimate.se.shape[1]]], axis=1)
    return np.abs(estimate.delta - truth[:, :, None, None]) / estimate.se


@pytest.fixture(scope="module")
def cells():
    """Two outputs with different errors, two speed cells and two amplitude classes, white disturbance."""
    vehicle = Toy(2, speed_cells=2, amplitude_edges=[1.0])
    drives = [
        vehicle.drive(10 * i + j, v, white(10 * i + j, rms=rms), DELTAS, 0.1, f"d{i}{j}")
        for i, v in enumerate((10.0, 20.0))
        for j, rms in enumerate((0.3, 1.5))
    ]
    return vehicle, drives


def test_the_estimate_is_within_k_standard_errors_in_every_cell(cells):
    vehicle, drives = cells
    estimate = vehicle.estimate(drives)
    assert estimate.se.shape == (len(vehicle.grid.omega), 2, 2, 2) and np.isfinite(estimate.se).all()
    off = errors(estimate, vehicle.grid)
    assert (off <= estimate.k).all(), off.max()
    assert 0.4 < np.mean(off**2) < 1.6, "se is what it says, neither too small nor too large"
    # The strong class tells more: its disturbance is the same.
    assert np.median(estimate.se[..., 1] / estimate.se[..., 0]) < 0.4
    estimates = sum(len(np.unique(row)) for row in estimate.se.reshape(-1, 4))
    assert estimate.k == pytest.approx(np.sqrt(np.log(estimates / 0.05))) and estimates < estimate.se.size
    assert (estimate.n >= LEAST_FRAMES).all() and set(estimate.periods.ravel()) <= set(PERIODS)


def test_a_coloured_disturbance_does_not_bias_it():
    vehicle, off = Toy(), []
    for seed in range(5):
        drive = vehicle.drive(seed, 15.0, white(seed, 12000), DELTAS[:1], 0.0)
        noise = lfilter([0.3], [1.0, -0.95], white(100 + seed, 12000))[:, None]
        estimate = vehicle.estimate([replace(drive, y=drive.y + noise)])
        truth = response(DELTAS[0], vehicle.grid.omega)[:, None, None, None]
        off.append((estimate.delta - truth) / estimate.se)
    off = np.array(off)
    assert np.abs(off).max() <= np.sqrt(np.log(off.size / 0.05)), "at the simultaneous level of all of them"
    assert np.abs(off.mean(axis=0)).max() <= np.sqrt(np.log(off[0].size / 0.01) / len(off)) * 1.3


def closed_loop(seeds: range) -> list[Drive]:
    """Drives whose driver steers against the output: u = r - 0.8 y of a sample ago; y = 1.2 yhat + w."""
    count, a = len(seeds), np.exp(-RATE * TS)
    r = np.column_stack([white(s) for s in seeds])
    w = lfilter([0.1], [1.0, -0.97], np.column_stack([white(50 + s) for s in seeds]), axis=0)
    u, yhat, state, last = np.zeros_like(r), np.zeros_like(r), np.zeros(count), np.zeros(count)
    for k in range(len(r)):
        yhat[k] = state
        u[k] = r[k] - 0.8 * last
        last = 1.2 * state + w[k]
        state = a * state + (1 - a) * u[k]
    t = TS * np.arange(len(r))
    return [
        Drive(f"d{i}", t, np.full(len(t), 15.0), u[:, [i]], 1.2 * yhat[:, [i]] + w[:, [i]], r[:, i])
        for i in range(count)
    ]


def test_an_instrument_removes_the_bias_of_a_driver_who_steers_against_the_disturbance():
    blind, instrumented = Toy(), Toy(instrument="r")
    drives, delta = closed_loop(range(8)), [np.array([0.2])]
    least_squares = blind.estimate([replace(d, instrument=None) for d in drives])
    instrumental = instrumented.estimate(drives)
    low = blind.grid.omega < 2.0
    assert (errors(least_squares, blind.grid, delta)[low] > 2 * least_squares.k).all()
    assert (errors(instrumental, instrumented.grid, delta) <= instrumental.k).all()
    assert claim(blind.project) == BIASED and claim(instrumented.project) == INSTRUMENTAL
    assert "may be biased" in BIASED or "biases it" in BIASED


def test_cells_with_few_frames_are_pooled_and_never_skipped():
    vehicle = Toy(speed_cells=4, amplitude_edges=[1.0])
    # Long in the first cell, short in the second, nothing in the third and fourth, all of one class.
    drives = [
        vehicle.drive(1, 9.0, white(1, rms=0.3), DELTAS[:1], 0.1),
        vehicle.drive(2, 13.0, white(2, 900, 0.3), DELTAS[:1], 0.1),
    ]
    estimate = vehicle.estimate(drives)
    assert np.isfinite(estimate.se).all() and (estimate.n >= LEAST_FRAMES).all()
    for own in (estimate.delta, estimate.se, estimate.n):  # one line fits all: every cell has it
        assert (own == own[:, :, :1, :1]).all()
    # The level is nominal: of 20 seeds 8 have a frequency beyond it (THEORY 7.6).
    assert (errors(estimate, vehicle.grid) <= estimate.k).mean() > 0.9
    none = vehicle.estimate([])
    assert not np.isfinite(none.se).any() and (none.lower == 0).all() and np.isinf(none.upper).all()


def test_cells_that_no_line_fits_are_estimated_by_themselves():
    vehicle, drives = Toy(speed_cells=4), []
    for k, (v, size) in enumerate(((9.5, 0.2), (13.0, 0.6), (17.0, 0.2), (20.0, 0.6))):
        drives.append(vehicle.drive(k, v, white(k), [np.array([size])], 0.05, f"d{k}"))
    estimate = vehicle.estimate(drives)
    fast = vehicle.grid.omega > 2.0  # where the cells have frames enough to object to a line
    assert (estimate.upper[:, 0, :, 0] >= np.array([0.2, 0.6, 0.2, 0.6]))[fast].all()
    # Two cells of one speed each lie on a line; all four do not.
    assert all(len(np.unique(se)) == 2 for se in estimate.se[fast, 0])
    assert (np.diff(estimate.delta.real[fast, 0, :, 0])[:, [0, 2]] == 0).all()


def test_an_error_that_varies_with_speed_within_a_cell_is_followed():
    vehicle, drives = Toy(), []
    for seed in range(6):
        v = np.linspace(8.2, 21.8, SAMPLES)[:: 1 if seed % 2 else -1]
        drive = vehicle.drive(seed, v, white(seed), [np.zeros(1)], 0.05)
        yhat = vehicle.model.simulate(drive.v, drive.u, np.zeros(1))
        drives.append(replace(drive, y=drive.y + (0.1 + 0.03 * (v[:, None] - 8.0)) * yhat))
    estimate = vehicle.estimate(drives)
    truth = 0.1 + 0.03 * (estimate.v - 8.0)
    short = estimate.periods * 2 * np.pi / vehicle.grid.omega[:, None, None, None] < 30.0
    assert (np.abs(estimate.delta - truth) <= estimate.k * estimate.se + 0.01)[short].all()
    mean = 0.1 + 0.03 * (15.0 - 8.0)
    assert (estimate.v > 17.0).all() and (np.abs(estimate.delta) > 1.2 * mean).all(), (
        "the larger end is taken"
    )


def test_whitening_finds_the_error_where_yhat_falls_steeply(monkeypatch):
    """Below 1 rad/s the model is good, above it is wrong by 100 %; the input falls by 60 dB a decade."""
    vehicle = Toy()
    b, a = butter(3, 0.8 * TS / np.pi)
    hb, ha = butter(2, 2.5 * TS / np.pi, "high")
    u = lfilter(b, a, white(3, 40000, 30.0)) + white(4, 40000, 1e-3)
    drive = vehicle.drive(5, 15.0, u, [np.zeros(1)], 1e-4)
    yhat = vehicle.model.simulate(drive.v, drive.u, np.zeros(1))
    drive = replace(drive, y=drive.y + lfilter(hb, ha, yhat, axis=0))
    omega, z = vehicle.grid.omega, np.exp(-1j * vehicle.grid.omega * TS)
    truth = np.polyval(hb[::-1], z) / np.polyval(ha[::-1], z)
    informed = (omega > 2.0) & (omega < 6.0)

    def relative() -> np.ndarray:
        delta = vehicle.estimate([drive]).delta[:, 0, 0, 0]
        return np.abs(delta - truth)[informed] / np.abs(truth)[informed]

    assert relative().max() < 0.12
    monkeypatch.setattr(model_error, "PERIODS", (3,))
    monkeypatch.setattr(model_error, "prediction_error_filter", lambda _: np.eye(1, 9)[0])
    assert relative().max() > 0.3, "frames of 3 periods without a filter see what is below"


def test_the_filter_whitens():
    x = lfilter([1.0], [1.0, -1.6, 0.8], white(1, 20000))
    taps = prediction_error_filter(x)
    np.testing.assert_allclose(taps[:3], [1.0, -1.6, 0.8], atol=0.05)
    assert np.abs(taps[3:]).max() < 0.05
    assert prediction_error_filter(np.ones(100)).tolist() == [1.0, *[0.0] * 8]


def test_where_the_data_are_silent_the_bound_is_one_plus_rho():
    vehicle = Toy(beyond=[{"output": "y0", "ratio": "1 + 0.1*omega", "reason": "known"}])
    b, a = butter(4, 2.0 * TS / np.pi)
    drive = vehicle.drive(1, 15.0, lfilter(b, a, white(1, rms=3.0)), DELTAS[:1], 0.1)
    estimate = vehicle.estimate([drive])
    dead, omega = beyond(vehicle.project, vehicle.grid), vehicle.grid.omega
    np.testing.assert_allclose(dead[:, 0], 2 + 0.1 * omega)
    last = last_telling(estimate)[0]
    assert 0 < last < len(omega) - 3
    bound = uncertainty_bound(vehicle.project, vehicle.grid, estimate)
    assert (bound[last + 1 :] >= dead[last + 1 :]).all()
    before = slice(0, last + 1)
    assert (bound[before, 0] == estimate.upper[before, 0, 0, 0]).all() and (bound[before] < 1.0).all()
    silent = ErrorEstimate.from_sums(Sums.none(vehicle.grid, 1), vehicle.grid)
    np.testing.assert_array_equal(uncertainty_bound(vehicle.project, vehicle.grid, silent), dead)
    assert last_telling(silent)[0] == -1
    written = ModelError(vehicle.grid, estimate, bound, None, []).to_dict(vehicle.project)
    assert written["beyond"]["y0"]["reason"] == "known"
    assert written["beyond"]["y0"]["last_rad_s"] == omega[last]
    np.testing.assert_array_equal(beyond(Toy().project, vehicle.grid), 2.0)


@pytest.mark.parametrize("ratio", [0.5, "1 - 0.01*omega"])
def test_a_ratio_below_one_is_refused_with_its_name(ratio):
    vehicle = Toy(beyond=[{"output": "y0", "ratio": ratio, "reason": "hope"}])
    with pytest.raises(InputError, match=r"beyond of y0: ratio: .*at least 1 at every frequency"):
        beyond(vehicle.project, vehicle.grid)


def test_an_output_that_is_none_and_edges_that_fall_are_refused():
    with pytest.raises(InputError, match="no output is named yaw"):
        toy(beyond=[{"output": "yaw", "ratio": 1.0, "reason": "known"}])
    with pytest.raises(InputError, match="amplitude_edges must rise"):
        toy(amplitude_edges=[1.0, 0.5])


def test_the_same_bytes_for_any_order_of_the_drives(tmp_path):
    vehicle, rows = Toy(), ["experiment,split"]
    for k, split in enumerate(("train", "train", "train", "valid", "valid")):
        drive = vehicle.drive(k, 10.0 + 2 * k, white(k, 2500), DELTAS[:1], 0.1)
        np.savetxt(
            tmp_path / f"d{k}.csv",
            np.column_stack([drive.t, drive.v, drive.u, drive.y]),
            delimiter=",",
            header="t,v,u,y0",
            comments="",
        )
        rows.append(f"d{k},{split}")
    (tmp_path / "experiments.csv").write_text("\n".join(rows) + "\n")

    def written(order: list[int]) -> str:
        drives = DriveSet(vehicle.project, vehicle.model, tmp_path)
        listed = list(drives.experiments.values())
        drives.experiments = {listed[k].name: listed[k] for k in order}
        error = OverDrives(drives, map, _quiet).model_error(Chosen.by_split(drives))
        return artefacts.to_json(error.to_dict(vehicle.project))

    text = written([0, 1, 2, 3, 4])
    assert written([4, 1, 3, 0, 2]) == text
    read = ModelError.from_dict(vehicle.project, vehicle.estimator, json.loads(text))
    assert json.loads(artefacts.to_json(read.to_dict(vehicle.project))) == json.loads(text), (
        "what is read back is what was written"
    )


def test_frames_are_doubled_until_that_moves_the_estimate_by_less_than_its_error():
    """A delay of 1 s: frames of 4 periods of a high frequency are shorter than a few of it."""
    vehicle = Toy()
    delay = np.r_[np.zeros(20), 0.5]
    drive = vehicle.drive(1, 15.0, white(1, 20000), [delay], 0.02)
    estimate, sums = vehicle.estimate([drive]), vehicle.sums(drive)
    high = vehicle.grid.omega > 6.0
    assert (estimate.periods[high] >= 16).all()
    only = Sums(*(f.copy() for f in sums))
    for field in only:
        field[:, 1:] = 0
    shortest = ErrorEstimate.from_sums(only, vehicle.grid)
    truth = response(delay, vehicle.grid.omega)

    def off(estimate: ErrorEstimate) -> np.ndarray:
        return np.abs(estimate.delta[:, 0, 0, 0] - truth)[high]

    assert (off(estimate) < 0.5 * off(shortest)).all()
    # Where doubling changes nothing the short frames, which are many, are taken.
    plain = vehicle.estimate([vehicle.drive(1, 15.0, white(1, 20000), [np.array([0.3])], 0.1)])
    assert np.mean(plain.periods == PERIODS[0]) > 0.5 and np.mean(plain.moved < 1) > 0.7


def test_a_drive_unlike_the_others_is_not_covered_when_it_is_left_out():
    vehicle = Toy()
    alike = [vehicle.sums(vehicle.drive(k, 15.0, white(k), DELTAS[:1], 0.1)) for k in range(4)]
    other = vehicle.sums(vehicle.drive(9, 15.0, white(9), [np.array([0.9])], 0.1))
    error = ModelError.from_sums(vehicle.project, vehicle.grid, alike, [])
    assert error.coverage == 1.0 and len(error.left_out) == 4 and error.judging is None
    mixed = ModelError.from_sums(vehicle.project, vehicle.grid, [*alike, other], [other])
    assert mixed.coverage == 0.8 and mixed.left_out[-1] < 1 < min(mixed.left_out[:-1])
    assert np.isnan(ModelError.from_sums(vehicle.project, vehicle.grid, alike[:1], []).coverage)


def test_class_S0_is_given_no_uncertainty_and_drives_of_commands_must_be_there(tmp_path):
    vehicle = Toy()
    rows = [vehicle.drive(k, 10.0 + 2 * k, white(k, 2500), DELTAS[:1], 0.1) for k in range(2)]
    for drive, name in zip(rows, ("a", "b"), strict=True):
        np.savetxt(
            tmp_path / f"{name}.csv",
            np.column_stack([drive.t, drive.v, drive.u, drive.y]),
            delimiter=",",
            header="t,v,u,y0",
            comments="",
        )
    (tmp_path / "experiments.csv").write_text("experiment,split\na,train\nb,sweep\n")
    document = vehicle.project.model_dump(by_alias=True)
    document["data"] |= {"bound_split": ["train", "sweep", "town"], "command_split": ["town"]}
    with pytest.raises(InputError, match=r"no drive has split town, from data\.command_split"):
        identify(parse_project(document, "toy"), tmp_path)
    with pytest.raises(InputError, match="command_split must be among bound_split"):
        parse_project({**document, "data": {"bound_split": ["train"], "command_split": ["town"]}}, "toy")
    chosen = Chosen.by_split(DriveSet(vehicle.project, vehicle.model, tmp_path)).setting
    error = ModelError.from_sums(vehicle.project, vehicle.grid, [vehicle.sums(d) for d in rows], [])
    for structure, least in (("S0", 0.0), ("S1", 0.2)):
        bounds = vehicle.project.bounds.model_copy(update={"structure": structure})
        project = vehicle.project.model_copy(update={"bounds": bounds})
        run = OverDrives(DriveSet(project, vehicle.model, tmp_path), map, _quiet)
        ceiling = project.bounds.nu_ceiling.at(run.reader.estimator.omega / (2 * np.pi))
        first = fold(run.first_parts(chosen, ceiling, keep=False))
        gamma_w = 2 * first["B2"]
        _, (W_delta,) = run.uncertainty(first, gamma_w, error, chosen)
        sizes = W_delta.magnitude(vehicle.grid.omega)
        assert sizes.max() < 2 * SMALLEST_NU if structure == "S0" else sizes.min() > least


@pytest.mark.parametrize("structure", ["S0", "S1", "S1_diagonal"])
def test_the_remainder_is_the_least_that_no_delta_within_the_bound_explains(structure):
    project = toy(2)
    project = project.model_copy(
        update={"bounds": project.bounds.model_copy(update={"structure": structure})}
    )
    estimator = Estimator.from_project(project, NominalModel(project))
    rng = np.random.default_rng(3)
    E, Z = (rng.normal(size=(20, 2)) + 1j * rng.normal(size=(20, 2)) for _ in range(2))
    Z[0] = 0.0
    n = 2 if structure == "S1_diagonal" else 1
    W = np.tile(np.array([0.5, 0.8])[:n], (estimator.n_bins, 1))
    w = remainder(FrameSet(2, E, Z, np.arange(20)), estimator, W, structure)
    radius, angle = np.linspace(0, 1, 41), np.linspace(0, 2 * np.pi, 181)
    disc = np.outer(radius, np.exp(1j * angle)).ravel()
    if structure == "S0":
        best = np.abs(E)
        np.testing.assert_array_equal(w, E)
    elif structure == "S1":
        best = np.linalg.norm(E[:, None] - 0.5 * disc[:, None] * Z[:, None], axis=2).min(axis=1)
        np.testing.assert_allclose(np.linalg.norm(w, axis=1), best, atol=0.03)
        assert (np.linalg.norm(w, axis=1) <= best + 1e-12).all()
        free = np.abs(s1.least_squares_delta(E[1:], Z[1:])) <= 0.5
        assert free.any() and not free.all()
    else:
        best = np.abs(E[:, None] - W[2] * disc[:, None] * Z[:, None]).min(axis=1)
        np.testing.assert_allclose(np.abs(w), best, atol=0.05)
        assert (np.abs(w) <= best + 1e-12).all()
    at_dc = remainder(FrameSet(0, E, Z, np.arange(20)), estimator, W, structure)
    np.testing.assert_array_equal(at_dc, E)
