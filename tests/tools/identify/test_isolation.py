"""Parts of a car with four redundant outputs: what each changes, which is named, and which are not
separable."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.core.compiled import VERDICTS
from lpvguard.drives.tables import Drive
from lpvguard.extras.bench._redundant_car import (
    DOUBLE,
    FAULTS,
    PartFault,
    redundant_drives,
    redundant_project,
)
from lpvguard.identify.isolation import ODDS, Changes, Isolation, is_separable, odds_of, residual_structure
from lpvguard.replay.parts import PartNamer, RunningParts
from lpvguard.report.sections.isolation import isolation_section
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project, parse_project

PROJECT = redundant_project()
CHANGES = Changes(PROJECT, NominalModel(PROJECT))
BEGIN_S, WINDOW_S = 40.0, 60.0


@pytest.fixture(scope="module")
def isolation() -> Isolation:
    return Isolation.from_drives(CHANGES, redundant_drives(20, 180.0, 1)[0], WINDOW_S)


def test_a_column_is_what_its_part_does():
    drive = redundant_drives(1, 60.0, 3)[0][0]
    model = NominalModel(PROJECT)
    yhat = model.simulate(drive.v, drive.u, drive.y[0])
    _, change = CHANGES.along(drive)
    assert change.shape == (len(drive.t), 4, 4 * 5 + 5 + 1 + 2)
    assert np.array_equal(change[:, 0, 0], yhat[:, 0]) and not change[:, 1:, 0].any()
    assert np.all(change[:, 1, 9] == 1.0) and not change[:, [0, 2, 3], 9].any()
    # A steering angle that is measured 2 % too large: the car turns less than its nominal model.
    small = model.simulate(drive.v, drive.u / 1.02, drive.y[0]) - yhat
    settled = slice(100, -10)
    assert change[settled, :, 20] == pytest.approx(1.02 * small[settled] / 0.02, abs=1e-6)
    late = model.simulate(drive.v, np.vstack([drive.u[10:], np.repeat(drive.u[-1:], 10, axis=0)]), drive.y[0])
    assert change[settled, :, 22] == pytest.approx((late - yhat)[settled] / 0.2, abs=0.04)
    straight = model.simulate(drive.v, drive.u - 0.01, drive.y[0]) - yhat
    assert change[:, :, 24] == pytest.approx(straight / 0.01)
    slow = model.simulate(drive.v / 1.02, drive.u, drive.y[0]) - yhat
    assert change[:, :2, 25] == pytest.approx(slow[:, :2] / 0.02)
    assert change[:, 2, 25] == pytest.approx(slow[:, 2] / 0.02 - yhat[:, 2])


def test_a_rate_of_alarms_raises_the_odds_that_a_window_needs():
    def odds(rate: float | None) -> float:
        settings = PROJECT.frame_test.model_copy(update={"alarms_per_1000_h": rate})
        return odds_of(PROJECT.model_copy(update={"frame_test": settings}), 60.0)

    assert odds(None) == odds(1000.0) == ODDS
    assert odds(10.0) == pytest.approx(np.log(6000.0))


@pytest.mark.slow("10 s: twelve faults in four drives each")
def test_the_part_of_every_single_fault_is_named(isolation):
    drives = redundant_drives(4, 101.0, 2, [(), *((f,) for f in FAULTS)], BEGIN_S)
    right = wrong = 0
    for fault, faulty_drives in zip((None, *FAULTS), drives, strict=True):
        for drive in faulty_drives:
            finding = isolation.name(isolation.evidence(list(CHANGES.blocks(drive, BEGIN_S, 100.0))))
            if fault is None:
                assert not finding.differs and finding.words() == "no part differs"
                continue
            right += finding.parts == (fault.part,)
            wrong += finding.differs and bool(finding.parts) and fault.part not in finding.parts
    assert right >= 0.85 * 4 * len(FAULTS) and wrong == 0


def test_a_size_has_an_interval_and_two_faults_are_no_single_part(isolation):
    bias = PartFault("bias", 0.02, "yaw_rate")
    both = (bias, PartFault("offset", 0.02))
    (one,), (two,) = redundant_drives(1, 101.0, 4, [(bias,), both], BEGIN_S)
    finding = isolation.name(isolation.evidence(list(CHANGES.blocks(one, BEGIN_S, 100.0))))
    assert finding.parts == ("yaw_rate",) and finding.what == "yaw_rate bias" and finding.unit == "rad/s"
    assert (
        finding.value == pytest.approx(0.02, abs=4e-3) and "yaw_rate: yaw_rate bias +0.0" in finding.words()
    )
    finding = isolation.name(isolation.evidence(list(CHANGES.blocks(two, BEGIN_S, 100.0))))
    assert finding.differs and finding.parts in ((), ("road_wheel_angle",), ("yaw_rate",))
    assert all(len({f.part for f in pair}) == 2 for pair in DOUBLE)


@pytest.mark.slow("5 s: two faults in twenty drives")
def test_two_faults_at_once_are_not_named_by_a_third_part(isolation):
    both = (PartFault("speed", 1.05), PartFault("tyre", 0.75))
    names = []
    for drive in redundant_drives(20, 101.0, 2, [both], BEGIN_S)[0]:
        finding = isolation.name(isolation.evidence(list(CHANGES.blocks(drive, BEGIN_S, 100.0))))
        names.append(finding.parts)
    assert all({"speed", "vehicle"} & set(parts) for parts in names)
    assert any({"speed", "vehicle", "road_wheel_angle"} <= set(parts) for parts in names)


def test_structure_says_which_parts_a_residual_tells_apart():
    structure = residual_structure(PROJECT)
    assert structure["yaw_rate"][0] == "yaw_rate" and len(structure["yaw_rate"]) == 4
    assert structure["vehicle"] == ["yaw_rate", "wheel_rate", "acceleration_rate", "course_rate"]
    assert is_separable(structure, "yaw_rate", "vehicle") and is_separable(structure, "vehicle", "yaw_rate")
    assert not is_separable(structure, "vehicle", "road_wheel_angle")
    assert is_separable(structure, "speed", "vehicle") and not is_separable(structure, "vehicle", "speed")


def test_one_output_tells_no_parts_apart_by_structure():
    document = load_project("g80").model_dump(by_alias=True) | {"isolation": {"vehicle": ["K"]}}
    structure = residual_structure(parse_project(document, "x"))
    assert not any(is_separable(structure, a, b) for a in structure for b in structure)


def test_isolable_sizes_fall_with_time_and_are_never_below_that_of_a_healthy_vehicle(isolation):
    short, long = isolation.isolable(30.0), isolation.isolable(3000.0)
    for what, row in short.items():
        assert all(row[part] >= row[""] * (1 - 1e-9) for part in row)
        assert all(long[what][part] <= row[part] for part in row)
    assert short["yaw_rate bias"]["wheel_rate"] < 0.02
    rows = list(isolation.isolable_rows(PROJECT))
    assert rows[0]["size of"] == "yaw_rate gain" and rows[0]["yaw_rate"] == ""
    assert rows[0]["vehicle"].endswith("*") and not rows[-1]["road_wheel_angle"].endswith("*")
    page = isolation_section(isolation, PROJECT)
    assert page.count("<tr>") == 1 + len(rows) and "<td>yaw_rate bias [rad/s]</td>" in page


def test_a_usual_fault_is_told_after_the_driving_with_which_it_is_isolable(isolation):
    after = isolation.told_after()
    for column in isolation.columns:
        for other, seconds in after[column.what].items():
            if np.isinf(seconds):
                assert isolation.isolable(36_000.0)[column.what][other] > column.fault
            elif seconds > 1.06 and (column.kind != "delay"):
                assert isolation.isolable(seconds)[column.what][other] <= column.fault
                assert isolation.isolable(seconds / 1.06)[column.what][other] > column.fault
    assert after["yaw_rate gain"]["wheel_rate"] < after["K factor"]["road_wheel_angle"]


def test_scales_are_read_back_and_name_parts_in_windows_of_a_drive(isolation, tmp_path):
    again = Isolation.from_dict(json.loads(json.dumps(isolation.to_dict(), default=lambda a: a.tolist())))
    fault = PartFault("gain", 0.8, "wheel_rate")
    drive = redundant_drives(1, 125.0, 5, [(fault,)], BEGIN_S)[0][0]
    namer = PartNamer(PROJECT, again)
    named = list(namer.named(drive, [60.0], [(60.0, 41.0)]))
    assert [n.from_s for n in named][-1] == 60.0 and named[-1].alarm_s == 60.0 and named[-1].until_s == 120.0
    assert named[-1].parts == ("wheel_rate",) and named[-1].service == "now"
    assert named[-1].says.endswith(
        "since about 41 s; check mounting, wiring and calibration of wheel_rate; service now"
    )
    assert list(namer.named(redundant_drives(1, 125.0, 5)[0][0], [])) == []
    assert PartNamer.beside(PROJECT, tmp_path) is None


def test_pieces_of_a_drive_name_the_parts_that_the_whole_drive_names(isolation):
    namer = PartNamer(PROJECT, isolation)
    fault = PartFault("gain", 0.8, "wheel_rate")
    drive = redundant_drives(1, 190.0, 5, [(fault,)], BEGIN_S)[0][0]
    late = replace(drive, t=drive.t + 500.0)
    alarms, onsets = [60.0, 70.0], [(60.0, 41.0)]
    whole = list(namer.named(drive, alarms, onsets))
    running, names = RunningParts(namer), []
    for a in range(0, len(drive.t), 70):
        at = slice(a, a + 70)
        piece = Drive("piece", late.t[at], drive.v[at], drive.u[at], drive.y[at])
        inside = np.isin(np.round(piece.t - 500.0, 6), alarms)
        verdict = np.where(inside, VERDICTS.index("invalid"), VERDICTS.index("valid"))
        names += running.take(piece, verdict, [(500.0 + a, 500.0 + s) for a, s in onsets if inside.any()])
    assert [(n.from_s, n.alarm_s) for n in whole] == [(0.0, None), (60.0, 60.0), (120.0, None)]
    assert [(n.from_s - 500, n.until_s - 500, n.alarm_s, n.parts) for n in names] == [
        (n.from_s, n.until_s, n.alarm_s and n.alarm_s + 500, n.parts) for n in whole
    ]
    assert names[1].value == pytest.approx(whole[1].value, abs=1e-3)
    assert "since about 541 s" in names[1].says


def test_drives_without_a_whole_window_are_refused(isolation):
    with pytest.raises(InputError, match=r"window_s: no drive has 60 s .* longer drives or a shorter"):
        isolation.finished([[], []])


@pytest.mark.parametrize(
    "isolation",
    [{"vehicle": ["mass"]}, {"speed_power": {"speed": 1}}, {"parts": {"nothing": "x"}}, {"window_s": 1}],
)
def test_settings_that_name_nothing_are_refused(isolation):
    document = load_project("g80").model_dump(by_alias=True)
    assert "isolation" not in document
    with pytest.raises(InputError, match="isolation"):
        parse_project(document | {"isolation": isolation}, "x")
