"""Drives that the identification never saw, judged with its calibration as stored; which are refused."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest

from lpvguard import schemas
from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.base.rates import per_hour, rate
from lpvguard.cli.evaluation_tables import print_evaluation
from lpvguard.evaluate.evaluation import evaluate
from lpvguard.evaluate.judged_drives import calibrations_of, drives_to_judge
from lpvguard.identify import identification as identify
from lpvguard.identify.calibration import Recordings
from lpvguard.replay.replayer import Replayer
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import EvaluationSettings

SHORT = 20
"""Lines of a table that are too few for any frame."""


def held_out(folder: Path, synthetic: Path, drives: dict[str, str]) -> Path:
    """A folder of drives, name -> recording, no table of which is one of the identification's: the rows of a
    synthetic drive begin elsewhere."""
    folder.mkdir()
    for name in drives:
        header, *lines = (synthetic / "synthetic_08.csv").read_text().splitlines()
        times, rest = zip(*(line.split(",", 1) for line in lines), strict=True)
        first = sum(map(ord, folder.name + name))
        shifted = [*rest[first:], *rest[:first]]
        lines = [f"{t},{values}" for t, values in zip(times, shifted, strict=True)]
        kept = lines[:SHORT] if name == "short" else lines
        (folder / f"{name}.csv").write_text("\n".join([header, *kept]) + "\n")
    index = "".join(f"{n},new,human,{r},dry\n" for n, r in drives.items())
    (folder / "experiments.csv").write_text("experiment,split,driver,recording,group\n" + index)
    return folder


@pytest.fixture(scope="module")
def stored(identified):
    return identify.load(identified)


@pytest.mark.parametrize(
    ("name", "did"), [("synthetic_02", "set the bounds"), ("synthetic_07", "calibrated")]
)
def test_a_table_that_the_identification_saw_is_refused_by_its_bytes(stored, synthetic, tmp_path, name, did):
    folder = held_out(tmp_path / "new", synthetic, {"one": "", "two": ""})
    shutil.copy(synthetic / f"{name}.csv", folder / "two.csv")
    with pytest.raises(InputError, match=f"is the same table as {name}, which {did}") as caught:
        drives_to_judge(stored, [folder])
    assert caught.value.source.endswith("two.csv") and str(stored.folder) in str(caught.value)


def test_a_drive_is_judged_once_and_no_piece_of_a_known_recording(stored, synthetic, tmp_path):
    one = held_out(tmp_path / "monday", synthetic, {"a": "m", "b": ""})
    two = held_out(tmp_path / "saturday", synthetic, {"b": ""})
    assert [e.name for e in drives_to_judge(stored, [one])] == ["a", "b"]
    with pytest.raises(InputError, match=r"saturday.*has the same name as .*monday"):
        drives_to_judge(stored, [one, two])
    two = held_out(tmp_path / "sunday", synthetic, {"c": ""})
    shutil.copy(one / "a.csv", two / "c.csv")
    with pytest.raises(InputError, match="c is the same table as a, byte for byte"):
        drives_to_judge(stored, [one, two])
    known = replace(stored.calibration, recordings=Recordings({"synthetic_07": "m"}))
    with pytest.raises(InputError, match="is a piece of recording m, as is synthetic_07, which calibrated"):
        drives_to_judge(replace(stored, calibration=known), [one])


def test_the_command_refuses_before_it_judges(lpvguard, identified, synthetic, tmp_path):
    words = ("evaluate", "--vehicle", "g80", identified, synthetic, "--drives-to-judge")
    done = lpvguard(*words, synthetic)
    assert done.returncode == 2 and "is the same table as synthetic_00, which set the bounds" in done.stderr
    done = lpvguard(*words, tmp_path / "none")
    assert done.returncode == 2 and "no such folder" in done.stderr


@pytest.mark.slow("10 s: baselines are tuned, and judge")
def test_held_out_drives_are_judged_with_the_thresholds_as_stored(
    stored, synthetic, core, g80, tmp_path, few_baselines, capsys
):
    chosen = {"first": "day", "second": "day", "short": ""}
    folder = held_out(tmp_path / "new", synthetic, chosen)
    drives = identify.DriveSet(g80, NominalModel(g80), synthetic)
    once = EvaluationSettings(bias=0.05, starts=1)
    table = evaluate(stored, drives, core, held_out=drives_to_judge(stored, [folder]), settings=once)
    described = jsonschema.Draft202012Validator(schemas.schema("evaluate"))
    assert [e.message for e in described.iter_errors(json.loads(artefacts.to_json(table)))] == []
    assert table["mode"] == "held_out" and table["left_out"].keys() == {"short"}
    assert [r["run"] for r in table["drives"]] == ["first", "second"]
    kept = calibrations_of(stored)
    replayer = Replayer(
        g80,
        core,
        threshold=kept["frame"].threshold,
        energy_threshold=kept["energy"].threshold,
        change_threshold=kept["change"].threshold,
    )
    for row in table["drives"]:
        for test, calibration in kept.items():
            assert row["calibration"][test]["threshold"] == calibration.threshold
            assert table["claims"]["held_out"][test] == [calibration.claim()]
        seen = replayer.replay_file(folder / f"{row['run']}.csv")
        assert row["scores"]["frame"] == seen.run.frames.statistic[seen.run.frames.counted].max()
        assert row["judged_s"] == seen.judged_s
        assert bool(row["alarmed"]["exported"]) == bool(seen.alarms)
    counted = table["tests"]["exported"]["false_alarms"]
    assert counted["drives"] == 2 and counted["recordings"] == rate(int(counted["alarmed"] > 0), 1)
    assert counted["recordings_per_judged_h"] == per_hour(
        counted["recordings"]["count"], sum(r["judged_s"] for r in table["drives"]) / 3600
    )
    assert {r["group"] for r in table["drives"]} == {"dry"}
    assert table["false_alarms"]["group dry"] == table["false_alarms"]["all"]
    for b in table["baselines"]:
        assert b["chosen"].keys() == {"first", "second"} and b["chosen"]["first"] == b["chosen"]["second"]
        assert "from 11 drives" in b["chosen"]["first"]["claim"]
    assert [row["way"] for row in table["faults"]] == [
        w for w in ("step", "ramp", "start") for _ in range(10)
    ]
    assert all(row["counted"] == 2 for row in table["faults"])
    for detector_rows in (table["faults"], *(b["faults"] for b in table["baselines"])):
        for row, ours in zip(detector_rows, table["faults"], strict=True):
            cases = row["cases"]
            assert [c["refutable_s"] for c in cases] == [c["refutable_s"] for c in ours["cases"]]
            assert row["refutable"] == sum(c["refutable_s"] is not None for c in cases)
            assert row["refutable_found"] == sum(
                c["refutable_s"] is not None and c["s"] is not None for c in cases
            )
    assert {(d["way"], d["kind"]) for d in table["duels"]} == {
        (way, b.kind) for way in ("step", "ramp", "start", "all") for b in few_baselines
    }
    print_evaluation(table)
    shown = capsys.readouterr()
    assert "from the start: output × 0.6" in shown.out + shown.err and "behind on" in shown.out + shown.err


def test_when_nothing_is_judged_the_reason_is_named(stored, synthetic, core, g80, tmp_path):
    folder = held_out(tmp_path / "new", synthetic, {"short": ""})
    drives = identify.DriveSet(g80, NominalModel(g80), synthetic)
    with pytest.raises(InputError, match=r"no frame counts.*no drive to judge is left"):
        evaluate(stored, drives, core, held_out=drives_to_judge(stored, [folder]))
