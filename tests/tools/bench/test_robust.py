"""The table of true margins: measured over speeds and amplitudes, as described, and marked where the truck is
beyond the weight."""

import json
from types import SimpleNamespace

import jsonschema
import numpy as np
import pytest

from hand_controller import hand_controller
from lpvguard import schemas
from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.control.true_loop import CertifiedLoop
from lpvguard.core.scheduled import Scheduled
from lpvguard.extras.bench import robust
from lpvguard.vehicle.nominal import NominalModel

FEW = np.geomspace(0.05, 60.0, 60)


@pytest.fixture
def few(monkeypatch):
    """Two speeds and fewer frequencies."""
    monkeypatch.setattr(robust, "SPEEDS", 2)
    monkeypatch.setattr(robust, "OMEGA", FEW)


def loop_with(project, size: float) -> CertifiedLoop:
    fitted = SimpleNamespace(at=lambda omega: (np.full((len(omega), 1), size), None))
    document = hand_controller(project)
    # A tenth of the feedback: stable also around a truck with lag and delay.
    B = np.array(document["B"])
    B[..., 1:] *= 0.1
    stored = SimpleNamespace(project=project, fitted=fitted, model=NominalModel(project))
    return CertifiedLoop(stored, Scheduled.read(document | {"B": B.tolist()}))


@pytest.mark.long("15 s: the truck measured over speed")
def test_a_weight_that_is_too_small_is_named_with_speed_frequency_and_both_numbers(truck, few):
    asked = [0.5, 1e3]
    wide = robust.true_table(loop_with(truck, 1e3), asked, map)
    assert wide["beyond"] == 0 and not any("BEYOND" in line for line in robust.true_lines(wide))
    small = robust.true_table(loop_with(truck, 1e-3), asked, map)
    speeds = [truck.model.speed_min_mps, truck.model.speed_max_mps]
    assert [row["v_mps"] for row in small["promised"]] == speeds
    assert [row["v_mps"] for row in small["true"]] == [v for v in speeds for _ in asked]
    assert [row["asked"] for row in small["true"]] == asked * 2
    assert all(row["amplitude"] < row["asked"] for row in small["true"][1::2])
    assert small["beyond"] == len(small["true"]) * truck.n_y
    lines = [line for line in robust.true_lines(small) if "BEYOND W_delta" in line]
    rows = [(row, d) for row in small["true"] for d in row["deviations"]]
    assert len(lines) == len(rows)
    for line, (row, d) in zip(lines, rows, strict=True):
        shown = [float(word) for word in line.split()[:6]]
        wanted = [row["v_mps"], row["amplitude"], d["ratio"], d["delta"], d["W_delta"], d["omega_rad_s"]]
        assert shown == pytest.approx(wanted, abs=6e-3) and d["output"] in line
        assert d["ratio"] == pytest.approx(d["delta"] / 1e-3)
        assert np.abs(FEW / d["omega_rad_s"] - 1).min() < 1e-3


@pytest.mark.long("10 s: a faulty truck measured over speed")
def test_a_fault_of_the_truck_is_in_the_table_and_the_table_is_as_described(truck, few):
    loop = loop_with(truck, 0.5)
    table = robust.true_table(loop, [0.5], map)
    halved = "[[plant.actuator_fault]]\nstart_s = 0.0\nbrake_gain_ratio = 0.5\n"
    weak = robust.true_table(loop, [1.0], map, halved)
    for one, other in zip(table["true"], weak["true"], strict=True):
        ups = [row["margins"]["gain_up"]["value"] for row in (one, other)]
        assert ups[1] == pytest.approx(2 * ups[0], rel=0.02)  # twice the demand at half the force
    example = schemas.example("robust") | table
    errors = jsonschema.Draft202012Validator(schemas.schema("robust")).iter_errors(
        json.loads(artefacts.to_json(artefacts.marked(example, "bench robust")))
    )
    assert [e.message for e in errors] == []


def test_amplitudes_come_from_the_command_or_the_project_file():
    assert robust.amplitudes(None, None) == list(robust.AMPLITUDES_BAR)
    assert robust.amplitudes(None, [0.7]) == [0.7]
    assert robust.amplitudes("0.5,2", [1.0]) == [0.5, 2.0]
    for bad in ("", "0.5,", "0", "-1", "nan", "inf", "much"):
        with pytest.raises(InputError, match="--amplitudes"):
            robust.amplitudes(bad, [1.0])


def test_a_loop_that_is_unstable_or_promised_nothing_says_so_in_the_text():
    margins = None
    lines = robust.true_lines(
        {
            "promised": [{"v_mps": 9.0, "margins": margins}],
            "true": [
                {"v_mps": 9.0, "amplitude": 0.5, "unstable_poles": 2, "margins": margins, "deviations": []}
            ],
        }
    )
    text = "\n".join(lines)
    assert "none: a vehicle within W_delta is unstable" in text and "UNSTABLE: 2 poles" in text
