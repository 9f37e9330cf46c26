"""`lpvguard fleet` and what it is made of: scores of recordings, the state between calls, the table."""

import csv
import json
import re
import shutil
import subprocess
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from lpvguard import schemas
from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.core.compiled import library_root
from lpvguard.drives.tables import list_experiments
from lpvguard.extras.fleet.export import MAGIC, SCHEMA, crc32
from lpvguard.extras.fleet.recordings import JUDGED_S
from lpvguard.extras.fleet.scores import ScoredDrive, recordings_of
from lpvguard.extras.fleet.state import FleetState
from lpvguard.extras.fleet.wealth import LEVELS, MOST, POWERS, START
from lpvguard.replay.vehicle_core import replayer_for

CALIBRATE = 11
"""Drives of the synthetic car that did not set the bounds."""


@pytest.fixture(scope="module")
def replayer(g80):
    return replayer_for(g80, None, "g80")


def write_drives(folder: Path, tables: dict[str, np.ndarray], columns: list[str], **more: list[str]) -> Path:
    """A folder of drives, in the order given; ``more``: further columns of experiments.csv."""
    folder.mkdir()
    for name, table in tables.items():
        np.savetxt(folder / f"{name}.csv", table, "%.9g", ",", header=",".join(columns), comments="")
    with (folder / "experiments.csv").open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["experiment", "split", *more])
        rows.writerows(
            [name, "life", *(values[i] for values in more.values())] for i, name in enumerate(tables)
        )
    return folder


@pytest.fixture(scope="module")
def tables(synthetic) -> tuple[dict[str, np.ndarray], list[str]]:
    """Four synthetic drives, by name, and their columns t, v, delta, r."""
    names = [f"synthetic_{i:02d}" for i in (5, 7, 8, 9)]
    head = (synthetic / f"{names[0]}.csv").read_text().split("\n", 1)[0].split(",")
    return {n: np.loadtxt(synthetic / f"{n}.csv", delimiter=",", skiprows=1) for n in names}, head


def worn(tables, gain: float, prefix: str = "worn") -> dict[str, np.ndarray]:
    """The drives with their yaw rate times ``gain``."""
    factor = np.array([1.0, 1.0, 1.0, gain])
    return {f"{prefix}_{name[-2:]}": table * factor for name, table in tables.items()}


def test_a_score_is_the_mean_ratio_of_the_first_judged_minute(replayer, synthetic, g80):
    e = next(e for e in list_experiments(synthetic) if e.name == "synthetic_06")
    (recording,) = recordings_of(replayer, [e], 60.0)
    recorded = replayer.read_file(e.path)
    change = replayer.replay(recorded.drive).run.change
    judged = change[(change > 0) & replayer.estimator.settled(recorded.drive.v)][:3000]
    assert recording.score == pytest.approx(judged.mean(), rel=1e-12)
    assert recording.judged_s == 60.0 and not recording.alarmed
    (short,) = recordings_of(replayer, [e], 1e4)
    assert short.score is None and 60.0 < short.judged_s < 140.0


def test_pieces_of_a_recording_have_one_score_and_the_estimate_is_the_fault(replayer, tables, tmp_path):
    drives, columns = tables
    faulty = worn(dict(list(drives.items())[:2]), 0.8)
    for table in faulty.values():
        table[:, 3] += 0.02
    folder = write_drives(tmp_path / "d", faulty, columns, recording=["one", "one"])
    experiments = list_experiments(folder)
    (recording,) = recordings_of(replayer, experiments, 150.0)
    read = [replayer.read_file(e.path).drive for e in experiments]
    pieces = [ScoredDrive.from_drive(replayer, drive, 7500) for drive in read]
    assert recording.name == "one" and len(recording.sha256) == 2 and recording.alarmed
    ratios = np.concatenate([p.ratios for p in pieces])
    assert recording.score == pytest.approx(ratios[:7500].mean(), rel=1e-12)
    assert len(pieces[0].ratios) < 7500 < len(ratios)
    (estimate,) = recording.estimates
    assert estimate.output == "yaw_rate"
    assert estimate.gain == pytest.approx(-0.2, abs=0.03)
    assert estimate.bias == pytest.approx(0.02, abs=3e-3)
    assert estimate.delay_s == pytest.approx(0.0, abs=0.03)


@pytest.mark.unhurried
def test_wear_is_found_and_the_state_goes_on_where_it_was(lpvguard, synthetic, tables, tmp_path):
    drives, columns = tables
    before, after = worn(drives, 0.8), worn(drives, 0.7, "older")
    days = [str(day) for day in (5, 6, 7, 8, 1, 2, 3, 4)]
    folder = write_drives(tmp_path / "car", after | before, columns, day=days, car=["x"] * 8)
    index, state, out = folder / "experiments.csv", tmp_path / "state.json", tmp_path / "out.json"
    arguments = ("fleet", "--vehicle", "g80", "--json", str(out), str(folder))
    calibrated = ("--calibration", str(synthetic))
    # In one go, ordered by a column, of a vehicle that another names.
    done = lpvguard(*arguments, *calibrated, "--order", "day", "--by", "car")
    assert done.returncode == 1, done.stderr
    whole = json.loads(out.read_text())
    assert not list(jsonschema.Draft202012Validator(schemas.schema("fleet")).iter_errors(whole))
    assert [r["recording"] for r in whole["vehicles"]["x"]["new"]] == [*before, *after]

    def listed(names: list[str]) -> None:
        index.write_text("experiment,split\n" + "".join(f"{name},life\n" for name in names))

    # In two calls, the folder grown between them.
    listed([*before])
    done = lpvguard(*arguments, *calibrated, "--state", str(state))
    assert done.returncode == 0, done.stderr
    first = json.loads(out.read_text())["vehicles"]["car"]
    assert first["changed_at"] is None and first["recordings"] == 4 and first["earliest"] == 3
    assert f"{CALIBRATE} recordings ({CALIBRATE} drives)" in done.stderr
    assert "synthetic_00: set the bounds" in done.stderr
    listed([*before, *after])
    done = lpvguard(*arguments, "--state", str(state))
    assert done.returncode == 1, done.stderr
    vehicle = json.loads(out.read_text())["vehicles"]["car"]
    assert vehicle["already_counted"] == 4 and vehicle["recordings"] == 8 and vehicle["changed_at"] == 7
    assert "changed by recording 7, older_08" in done.stderr and "falsif" not in done.stderr
    assert re.search(r"gain 0\.[67]\d\d of the model's", done.stderr)
    assert vehicle["alarmed"]["of"] == 4 and vehicle["judged_h"] == pytest.approx(4 / 60)
    stored = json.loads(state.read_text())
    assert not list(jsonschema.Draft202012Validator(schemas.schema("fleet_state")).iter_errors(stored))
    assert vehicle["wealth"] == whole["vehicles"]["x"]["wealth"]


@pytest.fixture(scope="module")
def state(replayer, synthetic) -> FleetState:
    """Calibrated by made-up scores, so that no drive needs to run."""
    from lpvguard.extras.fleet.recordings import terms_of

    scores = {f"c{i}": 0.1 * i for i in range(1, 12)}
    return FleetState(terms_of(replayer, None, None, None), scores, {n: {n: f"hash {n}"} for n in scores})


@pytest.mark.parametrize(
    ("spoil", "what"),
    [
        (lambda d: d["calibration"].update(c1=9.0), "changed after"),
        (lambda d: d.pop("seal"), "seal"),
        (lambda d: d.update(schema=2), "kind, schema"),
        (lambda d: d.update(kind="identify"), "kind, schema"),
        (lambda d: d["terms"].update(vehicle="other"), "changed after"),
    ],
)
def test_a_tampered_state_is_refused(state, tmp_path, spoil, what):
    path = tmp_path / "state.json"
    state.write(path)
    assert FleetState.read(path) == state
    document = json.loads(path.read_text())
    spoil(document)
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=what):
        FleetState.read(path)


@pytest.mark.parametrize("name", ["vehicle", "coefficients", "judged_s", "alpha", "eta"])
def test_a_foreign_state_is_refused_by_the_name_of_what_differs(state, name):
    own = getattr(state.terms, name)
    state.require(Path("s"), {name: own, "alpha": None})
    with pytest.raises(InputError, match=rf"terms\.{name}"):
        state.require(Path("s"), {name: "other" if isinstance(own, str) else own / 2})


@pytest.mark.unhurried
def test_bad_input_is_one_error_and_leaves_the_state(lpvguard, synthetic, tables, state, tmp_path):
    drives, columns = tables
    folder = write_drives(tmp_path / "life", dict(list(drives.items())[:1]), columns)
    path = tmp_path / "state.json"
    state.write(path)
    calibrated, with_state = ("--calibration", str(synthetic)), ("--state", str(path))

    def refused(*options: str) -> str:
        before = path.read_bytes()
        done = lpvguard("fleet", "--vehicle", "g80", str(folder), *options)
        assert done.returncode == 2 and path.read_bytes() == before
        return done.stderr

    assert "--calibration: not given" in refused()
    assert "--state has a set" in refused(*with_state, *calibrated)
    assert "terms.alpha" in refused(*with_state, "--alpha", "0.01")
    assert "column day" in refused(*with_state, "--order", "day")
    assert "judged_s: 0" in refused("--judged-s", "0", *calibrated)
    assert "judged_s: inf" in refused("--judged-s", "inf", *calibrated)
    assert "no recording calibrates" in refused("--judged-s", "500", *calibrated)
    assert "lies inside" in refused(*calibrated, "--state", str(folder / "state.json"))
    table = folder / "synthetic_05.csv"
    assert "lies inside" in refused(*calibrated, "--export", str(table))
    for mine in (tmp_path / "mine.json", tmp_path / "mine.h"):
        mine.write_text('{"mine": 1}')
        option = "--state" if mine.suffix == ".json" else "--export"
        assert "was not written by `lpvguard fleet`" in refused(*calibrated, option, str(mine))
    shutil.copy(synthetic / table.name, table)
    assert "synthetic_05: is a table that calibrated" in refused(*calibrated)
    assert lpvguard("fleet", "--vehicle", "g80", str(folder), *with_state).returncode == 0
    assert FleetState.read(path).members["life"].life.recordings == 1
    table.write_text(table.read_text().rsplit("\n", 2)[0] + "\n")  # a sample less
    assert "was counted with other tables" in refused(*with_state)


@pytest.mark.unhurried
def test_the_exported_table_compiles_and_has_the_cores_constants(state, tmp_path):
    from lpvguard.extras.fleet.export import header

    source = (library_root() / "include/lpvguard/life.h").read_text()
    stated = dict(re.findall(r"#define LPVG_LIFE_(\w+) (\w+)", source))
    own = {
        "MAGIC": MAGIC,
        "SCHEMA": SCHEMA,
        "LEVELS": LEVELS,
        "BETS": len(POWERS),
        "START": START,
        "MOST": MOST,
    }
    assert {k: int(stated[k].rstrip("U"), 0) for k in own} == own
    (tmp_path / "table.h").write_text(header(state))
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include "table.h"\nint main(void) {\n'
        '    printf("%u %d\\n", (unsigned)lpvg_g80_life_table.crc32,\n'
        "           (int)lpvg_life_table_check(&lpvg_g80_life_table));\n    return 0;\n}\n"
    )
    life, program = library_root() / "src/services/life.cpp", tmp_path / "main"
    includes = [f"-I{library_root() / folder}" for folder in ("include", "src")]
    flags = [*includes, "-Wall", "-Wextra", "-Werror"]
    c = ["gcc", "-std=c99", "-pedantic", "-c", str(tmp_path / "main.c"), "-o", str(tmp_path / "main.o")]
    subprocess.run([*c, *flags], check=True)
    subprocess.run(
        ["g++", "-std=c++17", str(life), str(tmp_path / "main.o"), "-o", program, *flags], check=True
    )
    said = subprocess.run([program], capture_output=True, text=True, check=True).stdout.split()
    assert said == [str(crc32(state.table, JUDGED_S)), "0"]


def test_the_table_is_replaced_by_its_own_command_only(state, tmp_path):
    from lpvguard.extras.fleet.export import header

    path = tmp_path / "table.h"
    for _ in range(2):
        artefacts.write_file(path, header(state), "fleet")
    path.write_text("/* mine */\n")
    with pytest.raises(InputError, match="not written by"):
        artefacts.write_file(path, header(state), "fleet")
