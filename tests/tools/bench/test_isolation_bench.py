"""`lpvguard bench isolation`: one drive a fault."""

import json

import numpy as np
import pytest
import tomlkit

from lpvguard.base.errors import InputError
from lpvguard.drives.tables import index_text
from lpvguard.extras.bench import isolation, run
from lpvguard.extras.bench._redundant_car import redundant_drives, redundant_project


@pytest.mark.slow("6 s: 25 faults")
def test_the_confusion_table_counts_every_drive(tmp_path, capsys):
    out = tmp_path / "isolation.json"
    run("isolation", ["--drives", "1", "--json", str(out)])
    text, result = capsys.readouterr().out, json.loads(out.read_text())
    assert all(sum(r["outcomes"].values()) == 1 for r in result["rows"])
    assert result["right"]["of"] == 12 and result["right"]["count"] >= 10 and result["wrong"]["count"] == 0
    assert "by structure vehicle is told from yaw_rate, wheel_rate" in text


@pytest.mark.slow("10 s: scales of 20 and of 60 drives")
def test_other_loads_and_tyres_are_the_vehicle_and_silent_where_declared(capsys):
    result = isolation.bench_nuisance(2, 60.0, 1, 1)
    undeclared, declared = result["rows"][:6], result["rows"][6:]
    assert undeclared[0]["outcomes"]["healthy"] == 2 and result["wrong"]["count"] == 0
    assert result["right"]["of"] == 10 and result["right"]["count"] >= 4
    assert all(r["outcomes"]["healthy"] == 2 for r in declared)
    assert "load × 0.8, declared" in isolation.words(result)


@pytest.mark.slow("25 s: an hour with each of five nuisances")
def test_differing_windows_are_counted_in_hours(monkeypatch, capsys):
    monkeypatch.setattr(isolation, "LONG_S", 120.0)
    monkeypatch.setattr(isolation, "LONG_DRIVES", 15)
    result = isolation.bench_nuisance_hours(0.5, 60.0, 1, 1)
    rows = {r["nuisance"]: r for r in result["rows"]}
    assert result["drives"] == 15 and len(rows) == 18
    assert all(r["judged_h"] == pytest.approx(15 / 60) for r in rows.values())
    undeclared, declared = (rows[f"load × 1.3, {kind}"] for kind in ("undeclared", "declared"))
    assert undeclared["differ"] > 10 > declared["differ"]
    assert undeclared["sensor"]["count"] <= 1 and undeclared["sensor"]["of"] > 10
    assert rows["load × 1.3, declared, rated"]["differ"] <= declared["differ"]
    text = isolation.hour_words(result)
    assert "15 drives of 120 s each" in text and "tyres × 0.8 and load × 1.3, declared, rated" in text


def test_outcomes_tell_one_of_several_and_wrong_apart():
    judged = isolation.outcome
    assert judged((), False, {"a"}) == "healthy" and judged((), True, {"a"}) == "no single"
    assert judged(("a",), True, {"a"}) == "right" and judged(("b",), True, {"a"}) == "wrong"
    assert judged(("b", "a"), True, {"a"}) == "one of" and judged(("b", "c"), True, {"a"}) == "wrong"


def _redundant_folder(folder, count, duration_s):
    """Project file and drives of the redundant car, as files."""
    project = redundant_project()
    document = project.model_dump(by_alias=True, exclude_none=True) | {"fit": {}, "evaluation": {}}
    (folder / "car.toml").write_text(tomlkit.dumps(json.loads(json.dumps(document))))
    (folder / "drives").mkdir()
    columns = ["t", *(s.column for s in (project.speed, *project.inputs, *project.outputs))]
    for d in redundant_drives(count, duration_s, 3)[0]:
        table = np.column_stack([d.t, d.v, d.u, d.y])
        path = folder / "drives" / f"{d.name}.csv"
        np.savetxt(path, table, "%.9g", ",", header=",".join(columns), comments="")
    rows = [(f"redundant_{k:03d}", "train", f"redundant_{k:03d}") for k in range(count)]
    (folder / "drives" / "experiments.csv").write_text(index_text(rows))
    return ["--vehicle", str(folder / "car.toml"), "--data", str(folder / "drives")]


@pytest.mark.slow("5 s: scales of three folds")
def test_faults_of_every_sensor_are_planted_in_drives_that_the_scales_have_not_seen(tmp_path, capsys):
    options, out = _redundant_folder(tmp_path, 3, 100.0), tmp_path / "out.json"
    run("isolation", [*options, "--window", "30", "--json", str(out)])
    result = json.loads(out.read_text())
    assert result["drives"] == 9 and "wrong_of_two" not in result
    assert len(result["rows"]) == 1 + 4 * 3 + 3 + 1 and result["rows"][-1]["fault"] == "speed factor +0.2"
    assert result["right"]["count"] > 0.5 * result["right"]["of"] and result["wrong"]["count"] <= 2
    assert result["rows"][0]["outcomes"]["healthy"] >= 8
    assert "9 drives a fault" in capsys.readouterr().out


def test_too_few_drives_and_half_of_the_options_are_refused(tmp_path):
    options = _redundant_folder(tmp_path, 1, 50.0)
    with pytest.raises(InputError, match="1 pieces of 30 s in 1 drives; expected three drives"):
        run("isolation", [*options, "--window", "30"])
    with pytest.raises(InputError, match="one is missing"):
        run("isolation", options[:2])
    with pytest.raises(InputError, match="isolation: missing"):
        run("isolation", ["--vehicle", "g80", *options[2:]])


@pytest.mark.parametrize("option", ["--drives", "--window", "--jobs"])
def test_sizes_that_make_no_sense_are_refused(option):
    with pytest.raises(InputError, match=option):
        run("isolation", [option, "0"])
