"""`lpvguard fit` from files to files."""

import json

import jsonschema
import numpy as np
import pytest

from known_car import KnownCar
from lpvguard import schemas
from lpvguard.base.artefacts import read_manifest
from lpvguard.base.errors import InputError
from lpvguard.fit.plausible import require_plausible
from lpvguard.fit.project_file import text_of, with_numbers
from lpvguard.vehicle.project import load_project


def write(folder, drive) -> None:
    table = np.column_stack([drive.t, drive.v, drive.u, drive.y])
    np.savetxt(folder / f"{drive.name}.csv", table, "%.9g", ",", header="t,v,delta,r", comments="")


@pytest.fixture
def folder(tmp_path):
    """Three drives of a known car; the last does not set bounds."""
    random = np.random.default_rng(5)
    car = KnownCar(2.8, 0.003, 0.006, 0.05, 0.001, 0.001)
    names = []
    for v, split in ((6.0, "train"), (14.0, "train"), (10.0, "valid")):
        drive = car.drive(random, v, 50.0, f"at_{v:g}")
        (tmp_path / "drives").mkdir(exist_ok=True)
        write(tmp_path / "drives", drive)
        names.append(f"{drive.name},{split}")
    (tmp_path / "drives" / "experiments.csv").write_text("experiment,split\n" + "\n".join(names) + "\n")
    return tmp_path


@pytest.mark.unhurried
def test_the_project_file_gets_the_numbers_and_keeps_its_comments(lpvguard, folder):
    done = lpvguard(
        "fit", "--vehicle", "g80", folder / "drives", "-o", folder / "fit", "--json", folder / "f.json"
    )
    assert done.returncode == 0, done.stderr
    project = load_project(folder / "fit" / "g80.toml")
    assert abs(project.model.parameters["L"] - 2.8) < 0.2 and abs(project.model.input_delay_s - 0.05) < 0.004
    kept = [
        [line.partition("#")[2] for line in text.splitlines() if "#" in line]
        for text in ((folder / "fit" / "g80.toml").read_text(), text_of("g80"))
    ]
    assert kept[0] == kept[1]
    stored = json.loads((folder / "fit" / "fit.json").read_text())
    assert [q["name"] for q in stored["unseen"]] == ["at_10"] and stored["unseen"][0]["vaf"][0] > 0.9
    validator = jsonschema.Draft202012Validator(schemas.schema("fit"))
    assert list(validator.iter_errors(stored)) == []
    assert list(validator.iter_errors(json.loads((folder / "f.json").read_text()))) == []
    read_manifest(folder / "fit", "fit")
    assert (folder / "fit" / "measured.svg").read_text().startswith("<svg")
    assert stored["recentring"] is None
    done = lpvguard("fit", "--vehicle", "g80", folder / "drives", "-o", folder / "centred", "--recentre")
    centred = json.loads((folder / "centred" / "fit.json").read_text())
    assert done.returncode == 0 and "recentring: median error of frames" in done.stderr
    assert list(validator.iter_errors(centred)) == [] and centred["recentring"]["fitted"] > 0


@pytest.mark.slow("3 s: two fits")
def test_the_same_drives_give_the_same_bytes(lpvguard, folder):
    for name in ("a", "b"):
        assert lpvguard("fit", "--vehicle", "g80", folder / "drives", "-o", folder / name).returncode == 0
    for file in ("g80.toml", "fit.json", "measured.svg"):
        assert (folder / "a" / file).read_bytes() == (folder / "b" / file).read_bytes()


@pytest.mark.unhurried
def test_a_wrong_unit_is_refused_by_name_before_the_range_of_the_signal(lpvguard, folder):
    path = folder / "drives" / "at_10.csv"
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    rows[:, 2] = np.degrees(rows[:, 2])
    np.savetxt(path, rows, "%.9g", ",", header="t,v,delta,r", comments="")
    done = lpvguard("fit", "--vehicle", "g80", folder / "drives", "-o", folder / "fit")
    assert done.returncode == 2 and "at_10: column delta: is in deg" in done.stderr
    assert not (folder / "fit").exists()


@pytest.mark.slow("2 s: a fit")
def test_a_delay_that_is_not_there_is_a_finding_and_identify_refuses_it(lpvguard, folder):
    late = folder / "late.toml"
    late.write_text(with_numbers(text_of("g80"), "g80", {"input_delay_s": 20.0}))
    done = lpvguard("fit", "--vehicle", late, folder / "drives", "-o", folder / "fit")
    assert done.returncode == 1 and "the project file's delay of 20 s does not fit the drives" in done.stderr
    refused = lpvguard("identify", "--vehicle", late, folder / "drives", "-o", folder / "out")
    assert refused.returncode == 2 and "the model is worse than no model" in refused.stderr


def test_half_the_rate_and_shuffled_time_are_named(lpvguard, folder):
    path = folder / "drives" / "at_6.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], *lines[1::2]]) + "\n")
    done = lpvguard("fit", "--vehicle", "g80", folder / "drives", "-o", folder / "fit")
    assert done.returncode == 2 and "the table has 0.5 times the rate of the project file" in done.stderr
    order = np.random.default_rng(0).permutation(len(lines) - 1) + 1
    path.write_text("\n".join([lines[0], *(lines[k] for k in order)]) + "\n")
    done = lpvguard("fit", "--vehicle", "g80", folder / "drives", "-o", folder / "fit")
    assert done.returncode == 2 and "the rows are shuffled" in done.stderr


def test_a_model_that_no_car_can_have_is_refused_unless_told(g80):
    require_plausible(g80)
    stated = g80.model_copy(update={"fit": g80.fit.model_copy(update={"kind": "car"})})
    require_plausible(stated)
    for change, says in (
        ({"input_delay_s": 1.3}, "delay and time constant of 1.3"),
        ({"B": [[f"3.6*({b})" for b in row] for row in g80.model.B]}, "wheelbase of 0.7"),
    ):
        model = stated.model.model_copy(update=change)
        strange = stated.model_copy(update={"model": model})
        with pytest.raises(InputError, match=says):
            require_plausible(strange, [strange])
        require_plausible(strange, [stated])  # the drives do not exclude a car


def test_a_split_is_proposed_where_none_is_made_and_where_one_half_lacks_speeds(lpvguard, folder):
    index = folder / "drives" / "experiments.csv"
    fit = ("fit", "--vehicle", "g80", folder / "drives", "-o", folder / "fit")
    made = index.read_text()
    index.write_text(made.replace("train", "unassigned").replace("valid", "unassigned"))
    done = lpvguard(*fit)
    assert done.returncode == 2 and "by speed: at_6, at_14 train, at_10 valid" in done.stderr
    index.write_text(made.replace("at_14,train", "at_14,valid").replace("at_10,valid", "at_10,train"))
    done = lpvguard(*fit)
    said = "split: at_14 calibrate at higher speeds than all that set the bounds; by speed: at_6, at_14 train"
    assert said in " ".join((done.stdout + done.stderr).split())
