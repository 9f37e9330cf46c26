"""The last lines of an evaluation: at most ten, alarms an hour first, in words."""

import json
from copy import deepcopy
from importlib import resources

import pytest

from lpvguard.evaluate.comparison import DetectorColumn, columns, detector_rows, refutable_rows
from lpvguard.evaluate.summary import summary


@pytest.fixture
def evaluation():
    example = resources.files("lpvguard.schemas").joinpath("examples", "evaluate.json")
    return json.loads(example.read_text(encoding="utf-8"))


def test_alarms_an_hour_stand_first_and_the_best_baseline_last(evaluation):
    lines = summary(evaluation)
    assert len(lines) <= 10
    assert lines[0] == (
        "alarms without a fault: promised at most 2.05 per judged hour, 1.87 measured "
        "(95 %: 0.047 to 10.4); 1 of 11 drives alarm in 0.536 h"
    )
    assert "70 of 70 starts found within 30 s" in lines[1] and lines[2].startswith(
        "found: step: output × 0.6 (35"
    )
    assert lines[-1].startswith("best baseline: cusum finds 70 of 70 starts, we 70")


def test_what_is_exported_has_a_line_where_it_differs(evaluation):
    exported = evaluation["tests"]["exported"]
    for row in exported["faults"]:
        row["found"] = 30
    exported["false_alarms"]["alarmed_drives"] = 2
    line = (
        "with a threshold for each test, as exported: 60 starts found, 2 of 11 drives alarm; "
        "frame_test.joint = true exports one for all tests"
    )
    assert summary(evaluation)[2] == line
    exported["faults"] = deepcopy(evaluation["faults"])
    exported["false_alarms"] = deepcopy(evaluation["false_alarms"]["all"])
    assert not any("as exported" in x for x in summary(evaluation))


def test_what_is_missed_partly_found_or_without_a_drive_has_a_line_each(evaluation):
    rows = evaluation["faults"]
    rows += [deepcopy(rows[0]) for _ in range(3)]
    for row, name, detected, counted in zip(rows[2:], "abc", (0, 17, 0), (35, 35, 0), strict=True):
        row |= {"fault": name, "found": detected, "counted": counted, "median_s": None}
    lines = summary(evaluation)
    assert "of 4 faults 2 found, 1 partly found, 1 missed" in lines[1]
    assert {
        "partly found: step: b (17 of 35)",
        "missed: step: a (0 of 35)",
        "no drive qualifies for: step: c",
    } <= set(lines)
    evaluation["stated_rates"]["monitor"] = None
    evaluation["duels"] = []
    lines = summary(evaluation)
    assert "no rate is promised, because too few drives calibrate, 1.87 measured" in lines[0]
    assert lines[-1] == "no baseline: too few drives calibrate one"


def test_faults_without_a_drive_share_one_row(evaluation):
    monitor = columns(evaluation)["monitor"]
    faults = [deepcopy(row) for row in [*monitor.faults, *monitor.faults]]
    for row, name in zip(faults[2:], "cd", strict=True):
        row |= {"fault": name, "counted": 0, "found": 0, "cases": []}
    column = DetectorColumn(monitor.alarms, faults, monitor.stated)
    rows = detector_rows([column], ["monitor", "tie", "x", "x"])
    assert [row[0] for row in rows[7:]] == [
        "step: output × 0.6",
        "step: output × -1",
        "no drive qualifies: step: c; step: d",
        "step: all faults",
    ]
    assert [row[-1] for row in rows[7:]] == ["monitor", "tie", "", ""]
    assert len(refutable_rows([column])) == 2
