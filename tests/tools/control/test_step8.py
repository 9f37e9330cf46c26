"""Step 8 beside the controller: Table II of generated drives, the worst-case run, the trade-off; and the
commands that write them."""

import json
import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lpvguard import schemas
from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.control import tradeoff
from lpvguard.control.design_files import design_files
from lpvguard.control.frozen import FrozenProblem
from lpvguard.control.stored_frames import NEAR, StoredFrames, deciding
from lpvguard.control.worst_run import respond, worst_runs
from lpvguard.drives.frames import Estimator
from lpvguard.engine.synthesis.limits import Floor
from lpvguard.engine.synthesis.table import cell
from lpvguard.engine.validation import s1
from lpvguard.identify import identification as identification
from lpvguard.identify.identification import StoredIdentification
from lpvguard.identify.weights import fit_uncertainty
from lpvguard.report.design_pictures import drawn
from lpvguard.report.sections.design import design_section
from lpvguard.report.sections.tradeoff import tradeoff_section
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import parse_project

FULL = os.environ.get("LPVGUARD_FULL") == "1"


@pytest.fixture(scope="module")
def drives(common_truck, few_truck_drives):
    return identification.DriveSet(common_truck, NominalModel(common_truck), few_truck_drives)


def better_known(stored: StoredIdentification) -> StoredIdentification:
    """As identified, were the model error a third of what it is: with one Delta for both outputs |W_delta| is
    1.1 at DC, and no structure of Table II reaches mu < 1."""
    project, error = stored.project, stored.model_error
    error = replace(error, bound=error.bound / 3)
    estimator = Estimator.from_project(project, NominalModel(project))
    nu = np.array(stored.bounds["nu"], float)[:, 0]
    W = fit_uncertainty(project, estimator, error.grid.omega, (nu, error.bound[:, 0], "W_delta"))
    return replace(stored, model_error=error, fitted=replace(stored.fitted, W_delta=[W]))


@pytest.fixture(scope="module")
def problem(few_truck_common_identified, drives):
    stored = better_known(identification.load(few_truck_common_identified))
    return FrozenProblem(stored, StoredFrames(stored, drives))


@pytest.fixture(scope="module")
def cells(problem):
    """One objective, a quarter of the project's, with little effort spent on D."""
    A_t, A_u = 25.0, 1e-6
    return [
        cell(
            problem.plant(s, problem.weights(s, A_t, A_u), problem.settings.design_speed_mps),
            s,
            A_t,
            A_u,
            iterations=3,
            polish=0,
        )
        for s in ("K_inf", "K_i", "K_is")
    ]


def test_deciding_frames_have_the_maxima_of_all_frames():
    """gamma_w's rule and nu over the deciding frames are those over all frames but for NEAR, for any ceiling
    and gamma_w."""
    random = np.random.default_rng(1)
    E, Z = (random.normal(size=(4000, 2)) + 1j * random.normal(size=(4000, 2)) for _ in range(2))
    E *= 10 ** random.uniform(-2, 0, (4000, 1))
    E[:3], Z[2:5] = 0, 0
    size, z = np.linalg.norm(E, axis=1), np.linalg.norm(Z, axis=1)
    values = np.column_stack([s1.solve(E, Z, size).b1, z, np.abs(s1.least_squares_delta(E, Z))])
    near = deciding(E, Z)
    assert len(near) < 500
    enough = (values[:, None] <= (1 + NEAR) * values[near] * (1 + 1e-12)).all(axis=2)
    assert enough.any(axis=1).all()
    larger = (values[near][:, None] >= (1 + NEAR) * values[near]).all(axis=2)
    assert not larger.any(), "none is kept beside one that is larger by a step"
    for ceiling in (0.01, 0.1, 0.5):
        rule = np.hypot(values[:, 0], z * np.maximum(0, values[:, 2] - ceiling))
        assert rule[near].max() * (1 + NEAR) ** 2 >= rule.max() - z.max() * NEAR * ceiling
        gamma = rule.max()
        assert (
            s1.solve(E[near], Z[near], gamma).nu.max()
            <= s1.solve(E, Z, gamma).nu.max()
            <= ceiling * (1 + 1e-9)
        )
    none = np.zeros((0, 2), complex)
    assert len(deciding(none, none)) == 0


def test_bounds_of_the_deciding_frames_are_near_those_identified(problem):
    frames, bounds = problem.frames, problem.stored.bounds
    known = bounds["frames"] > 0
    rule = frames.gamma_rule(bounds["nu_ceiling"])
    np.testing.assert_allclose(rule[known], bounds["gamma_rule"][known], rtol=2.5 * NEAR)
    split = frames.explain(bounds["gamma_w"])
    np.testing.assert_allclose(split.nu_i[known], bounds["nu"][known, 0], atol=2 * NEAR)


def test_state_uncertainty_takes_over_what_lambda_leaves_to_it(problem):
    """Each frame's pair explains it: nu_i falls and nu_s grows with a dearer input uncertainty; without room
    nothing is needed. The lag's state, u times 1/T_b = 10/s, makes nu_s cheap: the trade is at large
    lambda."""
    gamma_w = problem.stored.bounds["gamma_w"]
    cheap, dear = (problem.frames.explain_with_state(gamma_w, x) for x in (10.0, 1000.0))
    alone = problem.frames.explain(gamma_w)
    assert np.nanmax(cheap.nu_i) < np.nanmax(dear.nu_i) <= np.nanmax(alone.nu_i) * (1 + 1e-6)
    assert np.nanmax(cheap.nu_s) > np.nanmax(dear.nu_s) > 0
    large = problem.frames.explain_with_state(1.01 * problem.stored.bounds["B2"], 1.0)
    assert np.nanmax(large.nu_i) == np.nanmax(large.nu_s) == 0


def test_state_of_a_frame_is_that_of_the_frozen_model(problem):
    """u, as late as it reaches the vehicle, and x_nom read from Z reproduce Z where Z is the model's own
    response."""
    v, omega, u = np.array([9.0, 20.0]), 1.3, np.array([0.3 + 1j, -2.0])
    Z = (
        problem.model.frequency_response([omega], 9.0)[0, :, 0] * u[0],
        problem.model.frequency_response([omega], 20.0)[0, :, 0] * u[1],
    )
    input_, x_nom, _, h_s = problem.frames._behind(np.array(Z), v, omega)
    late = np.exp(-1j * omega * problem.stored.project.model.input_delay_s)
    np.testing.assert_allclose(input_, late * u, rtol=1e-9)
    np.testing.assert_allclose(x_nom @ problem.model.C.T, Z, rtol=1e-9)
    assert h_s.shape == (2, 4, 4)


def test_table_ii_is_certified_from_both_sides_and_above_its_floor(cells):
    for c in cells:
        assert c.lower <= c.upper < 1.2 and c.floor.value <= c.upper and c.order <= c.full_order
        assert "seconds" not in c.to_dict()
    K_inf, K_i, K_is = cells
    assert K_inf.upper < K_i.upper < K_is.upper


def test_worst_case_runs_and_files(problem, cells, drives, tmp_path):
    """The drive is the measured one nearest to the design speed; files hold no time and are the same bytes
    again; each opens."""
    runs = worst_runs(problem, cells, drives)
    assert (
        runs.drive.endswith("17mps")
        and 0 < runs.factor <= 1
        and [r.cell.structure for r in runs.runs] == ["K_inf", "K_i", "K_is"]
    )
    for r in runs.runs[1:]:
        assert r.worst.size == pytest.approx(1, abs=1e-5) and r.worst.gain <= r.cell.upper * (1 + 1e-6)
        assert r.tracking_rms != r.tracking_rms_nominal
    assert runs.runs[0].tracking_rms == runs.runs[0].tracking_rms_nominal
    files = design_files(problem, cells, runs)
    assert files == design_files(problem, cells, worst_runs(problem, cells, drives))
    assert set(files) == {"table2.json", "table2.csv", "figures.json"}
    pictures = drawn(files)
    assert set(pictures) == {"fig5.svg", "fig6.svg"} and pictures == drawn(files)
    for picture in pictures.values():
        assert picture.startswith("<svg xmlns=") and "var(--" not in picture
    controller = schemas.example("controller")
    artefacts.write_files(tmp_path, files | {"controller.json": json.dumps(controller)})
    section = design_section(tmp_path)
    assert "Counterpart of Fig. 5" in section and "Counterpart of Fig. 6" in section and runs.drive in section
    assert section.count("<svg") == 2 and f"{cells[1].upper:.4f}" in section


def test_a_simulated_sine_has_the_gain_of_the_frequency_response(problem, cells):
    loop = problem.plant("K_inf", problem.weights("K_inf", 1.0, 1.0), 17.0).system.select([0], [4])
    t = np.arange(20000) * loop.dt
    y = respond(loop, np.sin(2.0 * t)[:, None])[-5000:, 0]
    assert np.abs(y).max() == pytest.approx(abs(loop.response([2.0])[0, 0, 0]), rel=1e-3)


class Reckoned(tradeoff._Search):
    """Levels by a formula in the place of syntheses: least at ceilings of 0.2 and 0.8, with lambda_s at 4."""

    def posed(self, c):
        off = [np.log(c.low / 0.2), np.log(c.high / 0.8), np.log((c.lambda_s or 0.01) / 4.0)]
        level = 0.5 + 0.1 * np.square(off).sum()
        floor = Floor(0.9 * level, level, 1.0)
        return tradeoff.Outcome(c, np.array([]), None, floor, None, None), [level]


def test_the_search_steps_to_where_no_step_betters_it_and_tries_nothing_twice(monkeypatch):
    monkeypatch.setattr(tradeoff, "ROUNDS", 9)
    monkeypatch.setattr(tradeoff, "speeds", lambda p: [p.settings.design_speed_mps])
    monkeypatch.setattr(
        tradeoff, "dk_synthesis", lambda *_, **__: SimpleNamespace(performance=SimpleNamespace(scaling=None))
    )
    monkeypatch.setattr(tradeoff, "common_scaling", lambda levels, start: (start, levels[0]))
    of_project = SimpleNamespace(
        stored=SimpleNamespace(bounds={"nu_ceiling": np.array([0.0, 0.5, 0.9])}),
        settings=SimpleNamespace(lambda_s=1.0, design_speed_mps=15.0),
        frames=None,
    )
    run = Reckoned(of_project, lambda _: None)
    run.front()
    before = run.best()
    run.refine()
    best, step = run.best(), np.log(tradeoff.LEVEL_STEP)
    assert best.level < before.level and best.candidate.structure == "K_is"
    assert abs(np.log(best.candidate.low / 0.2)) <= step / 2 + 1e-9
    assert best.candidate.high == pytest.approx(0.9, rel=0.3) and best.candidate.lambda_s == 4.0
    keys = [o.candidate.key for o in run.outcomes]
    assert len(keys) == len(set(keys))
    apart = [o for o in run.outcomes if o.level is None]
    assert apart and all(o.floor.value >= best.level for o in apart)


def test_trade_off_finds_no_worse_than_the_projects_own_and_says_what_limits(problem, monkeypatch, tmp_path):
    monkeypatch.setattr(tradeoff, "LEVELS", (0.1,))
    monkeypatch.setattr(tradeoff, "ROUNDS", 1 if FULL else 0)
    monkeypatch.setattr(tradeoff, "speeds", lambda p: [p.settings.design_speed_mps])
    trade_off = tradeoff.search(problem)
    levels = [o.level for o in trade_off.outcomes if o.level is not None]
    assert (
        trade_off.best.level <= min(levels) * (1 + tradeoff.AS_GOOD)
        and trade_off.best.level <= trade_off.own.level
        and trade_off.own.candidate.own
    )
    for o in trade_off.outcomes:
        assert o.level is None or o.floor.value <= o.level
        if o.level is None:
            assert o.floor.value >= trade_off.best.level
    assert (
        sum(trade_off.limit["enters_by"].values())
        == pytest.approx(1)
        == sum(trade_off.limit["leaves_by"].values())
    )
    assert "What limits it" in trade_off.sentence and f"{trade_off.best.level:.3f}" in trade_off.sentence
    document = problem.stored.project.model_dump(by_alias=True)
    document["bounds"]["nu_ceiling"] = trade_off.setting()["bounds.nu_ceiling"]
    ceiling = parse_project(document, "test").bounds.nu_ceiling.at(
        problem.frames.estimator.omega / (2 * np.pi)
    )
    np.testing.assert_allclose(ceiling, trade_off.best.ceiling, rtol=1e-5)
    files = trade_off.files()
    assert set(drawn(files)) == {"tradeoff.svg"}
    artefacts.write_files(tmp_path, files)
    assert tradeoff_section(tmp_path).count("<svg") == 1


def test_the_sentence_is_honest_when_nothing_reaches_one(problem, monkeypatch):
    monkeypatch.setattr(tradeoff, "LEVELS", ())
    monkeypatch.setattr(tradeoff, "ROUNDS", 0)
    monkeypatch.setattr(tradeoff, "speeds", lambda p: [p.settings.design_speed_mps])
    hard = problem.stored.project.model_copy(
        update={"design": problem.settings.model_copy(update={"A_t": 400.0})}
    )
    trade_off = tradeoff.search(FrozenProblem(replace(problem.stored, project=hard), problem.frames))
    assert (
        trade_off.best.level >= 1
        and "No candidate reaches mu < 1" in trade_off.sentence
        and "no controller can" in trade_off.sentence
    )


def test_commands_name_what_is_missing(lpvguard, few_truck_common_identified, tmp_path):
    for arguments, word in (
        (("design", "-o", tmp_path / "x"), "--case"),
        (("design", "--case", "a.toml", "--tradeoff", "-o", tmp_path / "x"), "a case file alone"),
        (("design", "--case", tmp_path / "none.toml", "-o", tmp_path / "x"), "none.toml"),
    ):
        done = lpvguard(*arguments)
        assert done.returncode == 2 and word in done.stderr and not (tmp_path / "x").exists()
    old = tmp_path / "old"
    old.mkdir()
    with np.load(few_truck_common_identified / "spectra.npz") as spectra:
        np.savez(old / "spectra.npz", **{k: spectra[k] for k in spectra if k != "speed"})
    stored = identification.load(few_truck_common_identified)
    with pytest.raises(InputError, match="identify` again"):
        StoredFrames(replace(stored, folder=old))
