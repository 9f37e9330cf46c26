"""A further signal gates the range: outside its own, samples are missing, in a table and on the bus."""

import tomllib
from importlib import resources

import numpy as np
import pytest

from drive_table import table
from lpvguard.base.errors import InputError
from lpvguard.can.play import frames_of_drive, values_of_drive
from lpvguard.core.coefficients import signal_table_markdown
from lpvguard.drives.signal_map import map_of_project
from lpvguard.drives.tables import list_experiments, read_drive
from lpvguard.replay.replayer import Replayer, bus_frames
from lpvguard.vehicle.project import Signal, parse_project

LATERAL = {"message": "VDC2", "signal": "lateral_acceleration", "factor": 1.0}
GATE = Signal(
    name="lateral", role="gate", column="ay", unit="m/s2", positive="left", min=-1.0, max=1.0, can=LATERAL
)


@pytest.fixture(scope="module")
def gated(g80):
    return g80.model_copy(update={"signals": [*g80.signals, GATE]})


@pytest.fixture(scope="module")
def drive(g80, synthetic):
    return read_drive(list_experiments(synthetic)[1].path, g80)


def test_samples_that_a_gate_shuts_out_are_missing_however_many(gated, core, drive, tmp_path):
    ay = drive.v * drive.y[:, 0]
    ay[500:503] = np.nan
    path = table(tmp_path, t=drive.t, v=drive.v, delta=drive.u[:, 0], r=drive.y[:, 0], ay=ay)
    gated_drive = read_drive(path, gated)
    shut = ~(np.abs(ay) <= 1.0)
    assert shut.mean() > 0.2 and np.array_equal(gated_drive.missing, shut)
    assert gated_drive.y.shape[1] == 1 and np.allclose(gated_drive.present.y, drive.y[~shut], atol=1e-8)
    replayed = Replayer(gated, core).replay(gated_drive)
    assert replayed.missing_samples == shut.sum() and not replayed.judged[shut].any()


def test_a_table_in_which_a_gate_never_opens_is_refused_and_one_without_its_column(gated, drive, tmp_path):
    columns = {"t": drive.t, "v": drive.v, "delta": drive.u[:, 0], "r": drive.y[:, 0]}
    with pytest.raises(InputError, match=r"line 2, column ay: 5; expected -1 to 1 m/s2"):
        read_drive(table(tmp_path, ay=np.full_like(drive.t, 5.0), **columns), gated)
    with pytest.raises(InputError, match="column ay is missing"):
        read_drive(table(tmp_path, **columns), gated)


def test_a_log_has_no_sample_where_the_bus_says_that_a_gate_is_shut(gated, g80, core, drive, tmp_path):
    frames = frames_of_drive(drive.t, values_of_drive(g80, drive))
    known, with_gate = (Replayer(p, core).received(frames, tmp_path / "a.log").drive for p in (g80, gated))
    ay = known.v * known.y[:, 0]
    sure = np.abs(np.abs(ay) - 1.0) > 0.1  # the bus carries it rounded, and speed every 100 ms
    sure &= ~known.missing if known.missing is not None else True
    shut = np.abs(ay) > 1.0
    assert (shut & sure).sum() > 500
    assert np.array_equal(with_gate.missing[sure], shut[sure])
    assert with_gate.y.shape == known.y.shape
    path = table(tmp_path, t=drive.t, v=drive.v, delta=drive.u[:, 0], r=drive.y[:, 0], ay=0 * drive.t)
    with pytest.raises(InputError, match="holds no gate signals, but the bus needs them"):
        bus_frames(path, gated)


def test_ingest_keeps_what_a_gate_shuts_out_and_the_signal_table_has_it(gated):
    column = map_of_project(gated).columns["ay"]
    assert column.min is None and column.max is None
    assert "| lateral | gate | ay |" in signal_table_markdown(gated)


def test_a_vehicle_that_is_steered_has_no_gates():
    text = (resources.files("lpvguard.vehicle") / "shipped" / "truck.toml").read_text(encoding="utf-8")
    document = tomllib.loads(text)
    document["signals"].append(GATE.model_dump(exclude={"can"}))
    with pytest.raises(InputError, match=r"design: the ECU does not read gates, so lateral"):
        parse_project(document, "truck.toml")
