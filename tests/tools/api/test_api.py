"""The Python interface says what the command line and the core say."""

import subprocess
import sys

import control
import numpy as np
import pytest
from scipy.io import loadmat, savemat

import lpvguard
from lpvguard.api import linear
from lpvguard.base import artefacts, optional
from lpvguard.core.compiled import VERDICTS
from lpvguard.drives.tables import read_drive
from lpvguard.vehicle.nominal import NominalModel


def same_files(a, b):
    assert sorted(p.name for p in a.iterdir()) == sorted(p.name for p in b.iterdir())
    return all((b / p.name).read_bytes() == p.read_bytes() for p in a.iterdir())


@pytest.fixture(scope="module")
def identification(identified):
    return lpvguard.load(identified)


@pytest.mark.unhurried
def test_the_names_are_there_whatever_was_imported_before_and_cost_the_command_line_nothing():
    script = """
import sys, lpvguard
assert not {"pandas", "pyarrow", "scipy", "lpvguard.api.identification"} & set(sys.modules)
import lpvguard.identify.identification, lpvguard.replay.replayer
assert callable(lpvguard.identify_drives) and callable(lpvguard.replay_drive)
assert lpvguard.Monitor.__name__ == "Monitor"
try:
    lpvguard.no_such_name
except AttributeError as error:
    assert "no_such_name" in str(error)
else:
    raise AssertionError
try:
    lpvguard.identify_drives("no_such_car", "drives")
except lpvguard.InputError as error:
    assert "no_such_car" in str(error)
else:
    raise AssertionError
"""
    subprocess.run([sys.executable, "-c", script], check=True)


@pytest.mark.slow("8 s: an identification")
def test_identify_and_export_write_what_the_commands_write(g80, synthetic, identified, vehicle, tmp_path):
    made = lpvguard.identify_drives(g80, synthetic)
    stored = made.save(tmp_path / "identify")
    assert same_files(identified, stored.folder)
    assert same_files(vehicle, made.export(tmp_path / "vehicle"))
    for a, b in ((made.bounds, stored.bounds), (made.weights, stored.weights)):
        assert a.equals(b)
    with pytest.raises(ValueError, match="already"):
        stored.save(tmp_path / "again")


def test_export_takes_the_controller_and_the_group_as_the_command_does(identification, tmp_path):
    controller = tmp_path / "controller.json"
    controller.write_text("{}")
    with pytest.raises(lpvguard.InputError, match=r"controller.json: certificates: missing"):
        identification.export(tmp_path / "code", controller=tmp_path)
    with pytest.raises(lpvguard.InputError, match=r"controller.json: certificates: missing"):
        identification.export(tmp_path / "code", controller=controller)
    with pytest.raises(lpvguard.InputError, match="group: fog"):
        identification.export(tmp_path / "code", group="fog")
    assert not (tmp_path / "code").exists()


def test_bounds_and_weights_are_tables_by_frequency(identification, identified):
    stored = artefacts.read_json(identified / "bounds.json")
    assert identification.bounds.index.name == "omega_rad_s"
    assert identification.bounds.index.tolist() == stored["omega_rad_s"]
    assert identification.bounds["frames"].tolist() == stored["frames"]
    nu = np.array([row[0] for row in stored["nu"]], float)
    assert np.array_equal(identification.bounds["nu"], nu, equal_nan=True)
    assert list(identification.weights.columns) == ["W_delta", "B_w"]
    certified = identification.fitted.at(identification.omega)[0][:, 0]
    assert (certified >= identification.bounds["nu"].fillna(0))[1:].all()
    assert (identification.weights["W_delta"] <= certified * (1 + 1e-9)).all()  # the healthy set lies within
    assert identification.threshold > 0 and "drive" in identification.claim


def test_two_outputs_have_columns_of_their_names(identification):
    two = lpvguard.Identified(
        identification.project.model_copy(
            update={"signals": [*identification.project.signals, identification.project.outputs[0]]}
        ),
        None,
        identification.omega,
        identification.fitted,
        identification.calibration,
        identification._bounds | {"B_w": np.column_stack([np.arange(len(identification.omega))] * 2)},
    )
    name = identification.project.outputs[0].name
    assert f"B_w/{name}" in two.bounds.columns


def test_replay_gives_frames_and_series_as_tables(vehicle, synthetic, tmp_path):
    said = lpvguard.replay_drive("g80", synthetic / "synthetic_01.csv", coefficients=vehicle)
    frames = said.frames[said.frames["reason"] == "none"]
    assert frames["margin"].max() <= said.summary.max_margin
    assert frames["t_judged_s"].min() > 0 and (frames["t_judged_s"] >= frames["t_end_s"]).all()
    assert len(said.series) == said.arrow.num_rows == len(said.summary.run.verdict)
    assert said.alarms == []
    said.save_mat(tmp_path / "series.mat")
    back = loadmat(tmp_path / "series.mat", squeeze_me=True)
    assert np.array_equal(back["e_yaw_rate"], said.series["e/yaw_rate"])
    assert np.array_equal(back["verdict_code"], said.summary.run.verdict)


@pytest.mark.unhurried
def test_push_by_push_the_monitor_says_what_it_says_in_one_run(g80, vehicle, core, synthetic):
    drive = read_drive(synthetic / "synthetic_01.csv", g80).before_sample(3000)
    run = core.monitor().run_drive(drive)
    monitor = lpvguard.Monitor("g80", vehicle)
    assert monitor.sample_time_s == g80.Ts_s

    def pushed():
        return [monitor.push(*row) for row in zip(drive.t, drive.v, drive.u, drive.y, strict=True)]

    said = pushed()
    assert [s.verdict for s in said] == [VERDICTS[code] for code in run.verdict]
    assert [s.frame.margin for s in said if s.frame] == run.frames.margin.tolist() != []
    assert [s.energy_ratio or 0.0 for s in said] == run.energy.tolist()
    monitor.reset()
    assert pushed() == said
    assert monitor.push(0.0, 10.0, 0.0, 0.0).status != "ok", "time that goes back is refused by the core"
    with pytest.raises(ValueError, match="inputs"):
        monitor.push(99.0, 10.0, [0.0, 0.0], 0.0)


@pytest.mark.parametrize("delay_s", [0.0, 0.013, 0.02, 0.05])
def test_the_nominal_model_of_python_control_has_the_models_response(g80, delay_s):
    project = g80.model_copy(update={"model": g80.model.model_copy(update={"input_delay_s": delay_s})})
    omega = np.geomspace(0.1, 20, 7)
    G = linear.nominal(project, 12.0)
    assert isinstance(G, control.StateSpace) and G.dt == g80.Ts_s
    want = NominalModel(project).frequency_response(omega, 12.0)[:, 0, 0]
    assert G(np.exp(1j * omega * G.dt)) == pytest.approx(want, rel=1e-9)
    with pytest.raises(lpvguard.InputError, match="speed range"):
        linear.nominal(project, 1e3)


def test_the_weights_of_python_control_are_those_of_the_certificate(identification):
    W = linear.weights(identification)
    assert np.abs(W["W_delta"][0](1j * identification.omega)) == pytest.approx(
        identification.fitted.at(identification.omega)[0][:, 0]
    )
    scale = identification.fitted.inflation
    assert np.abs(W["W_w"][0](2j)) == pytest.approx(
        scale * identification.fitted.W_w[0].magnitude(np.array(2.0))
    )


def test_a_package_that_is_not_there_is_named_with_its_extra():
    with pytest.raises(lpvguard.InputError, match=r"pip install 'lpvguard\[pandas\]'"):
        optional.optional("no_such_package", "pandas")


def test_matlab_tables_are_drives(g80, synthetic, tmp_path):
    drive = read_drive(synthetic / "synthetic_01.csv", g80)
    columns = {"t": drive.t, "v": drive.v, "delta": drive.u[:, 0], "r": drive.y[:, 0]}
    savemat(tmp_path / "a.mat", columns | {"comment": "of the car", "gain": 2.0}, oned_as="column")
    again = read_drive(tmp_path / "a.mat", g80)
    assert all(np.array_equal(getattr(again, n), getattr(drive, n)) for n in ("t", "v", "u", "y"))
    savemat(tmp_path / "b.mat", columns | {"r": drive.y[:-1, 0]})
    with pytest.raises(lpvguard.InputError, match="different lengths"):
        read_drive(tmp_path / "b.mat", g80)
    (tmp_path / "c.mat").write_bytes(b"MATLAB 5.0 no more" * 20)
    with pytest.raises(lpvguard.InputError, match="cannot be parsed"):
        read_drive(tmp_path / "c.mat", g80)
