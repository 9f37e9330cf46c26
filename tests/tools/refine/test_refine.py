"""`lpvguard refine`: what drives refute, what is proposed of them, and what is learnt of a signed file."""

import filecmp
import json
import shutil
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import tomlkit

from lpvguard import schemas
from lpvguard.base.artefacts import write_files
from lpvguard.base.errors import InputError
from lpvguard.drives import fixture
from lpvguard.drives.faults import Fault, inject
from lpvguard.drives.tables import Drive, list_experiments
from lpvguard.extras.fleet.scores import DriveEstimate
from lpvguard.extras.refine.decisions import Decisions, Evidence, decide
from lpvguard.extras.refine.lineage import OWN, Lineage
from lpvguard.extras.refine.own import OwnGains
from lpvguard.extras.refine.proposals import _dominant, _largest, _shifted
from lpvguard.extras.refine.renewed import drawn, renew
from lpvguard.identify import identification as stage


def further(project, folder: Path, gains: dict[str, float], *, seed: int = 21, group: str = "") -> Path:
    """Folder of drives of the synthetic car whose output has these gains by name; 0: frozen."""
    folder.mkdir()
    rows = ["experiment,split,driver,group"]
    for i, (name, gain) in enumerate(gains.items()):
        columns, _ = fixture.drive_columns(
            np.random.default_rng([seed, i]), 9.0 + i % 4, 140.0, project.Ts_s, None
        )
        drive = Drive(
            name, *(columns[c] for c in ("t", "v")), columns["delta"][:, None], columns["r"][:, None]
        )
        fault = Fault("gain", gain) if gain else Fault("freeze")
        columns["r"] = inject(drive, fault, 0.0 if gain else 40.0, project.Ts_s).y[:, 0]
        write_files(folder, {f"{name}.csv": fixture.csv_text(columns)})
        rows.append(f"{name},valid,human,{group}")
    write_files(folder, {"experiments.csv": "\n".join(rows) + "\n"})
    return folder


@pytest.fixture(scope="session")
def new_drives(g80, made) -> Path:
    """A healthy drive, one with 0.7 of the gain, one whose sensor freezes, and one a little off."""
    gains = {"healthy": 1.0, "worn": 0.7, "frozen": 0.0, "off": 0.88}
    return made.folder("g80_further", lambda folder: further(g80, folder, gains))


@pytest.fixture(scope="session")
def judged(identified, synthetic, new_drives, made) -> Path:
    """The file of decisions of these drives, and the lifetime test's lives.json, in a folder."""

    def make(folder: Path) -> None:
        folder.mkdir()
        lineage = Lineage.from_folder(identified, synthetic)
        evidence = Evidence.from_paths(lineage, [new_drives], None)
        decisions, lives = decide(lineage, evidence, new_drives.parent)
        (folder / "decisions.toml").write_text(decisions.text())
        (folder / "lives.json").write_text(json.dumps(lives))

    return made.folder("g80_decisions", make)


def decisions_of(judged: Path, new_drives: Path) -> Decisions:
    """The decisions, with paths from another folder."""
    decisions = Decisions.read(judged / "decisions.toml")
    return replace(
        decisions, drives=[replace(d, path=str(new_drives / f"{d.name}.csv")) for d in decisions.drives]
    )


@pytest.mark.unhurried
def test_each_drive_gets_what_it_refutes_and_a_proposal(judged):
    decisions = Decisions.read(judged / "decisions.toml")
    healthy, worn, frozen, off = decisions.drives
    assert (healthy.refutes, healthy.proposal) == ([], "confirm") and max(healthy.ratios.values()) < 1
    assert worn.proposal == "fault" and "healthy set" in worn.refutes and worn.like == "new"
    assert "yaw_rate has 0.699" in worn.reason and "is taken for a fault" in worn.reason
    assert frozen.proposal == "fault" and "certificate set" in frozen.refutes
    assert off.proposal == "spread" and not off.accept and off.like == "new"
    lives = json.loads((judged / "lives.json").read_text())
    written = {"identification": decisions.identification, "drives": decisions.entries, "lives": lives}
    jsonschema.validate(written, schemas.schema("refine"))


@pytest.mark.unhurried
def test_the_file_is_read_back_as_it_was(judged, tmp_path):
    decisions = Decisions.read(judged / "decisions.toml")
    (tmp_path / "again.toml").write_text(decisions.text())
    assert Decisions.read(tmp_path / "again.toml") == decisions


BROKEN = {
    "nobody signed": lambda d: replace(d, signed_by=" ", drives=[replace(d.drives[0], accept=True)]),
    "a fault is not learnt": lambda d: replace(d, signed_by="A", drives=[replace(d.drives[1], accept=True)]),
    "why: empty; fault was proposed": lambda d: replace(
        d, signed_by="A", drives=[replace(d.drives[1], action="spread", accept=True)]
    ),
    "a new condition has none": lambda d: replace(
        d, signed_by="A", drives=[replace(d.drives[0], action="new condition", accept=True, why="load")]
    ),
    "accept: 1; expected true or false": lambda d: replace(d, drives=[replace(d.drives[0], accept=1)]),
    "action: 'learn'": lambda d: replace(d, drives=[replace(d.drives[0], action="learn")]),
}


@pytest.mark.unhurried
@pytest.mark.parametrize("message", BROKEN)
def test_what_nobody_signed_or_a_fault_is_not_learnt(judged, tmp_path, message):
    broken = BROKEN[message](Decisions.read(judged / "decisions.toml"))
    (tmp_path / "broken.toml").write_text(broken.text())
    with pytest.raises(InputError, match=message):
        Decisions.read(tmp_path / "broken.toml")


@pytest.mark.parametrize("text", ["", "a = ", 'kind = "refinement decisions"\nschema = 2', "schema = 1"])
def test_another_file_is_refused(tmp_path, text):
    (tmp_path / "other.toml").write_text(text)
    with pytest.raises(InputError, match=r"other\.toml"):
        Decisions.read(tmp_path / "other.toml")


@pytest.mark.unhurried
def test_a_known_drive_is_no_evidence(identified, synthetic, new_drives, tmp_path):
    lineage = Lineage.from_folder(identified, synthetic)
    table = list_experiments(synthetic)[0].path
    with pytest.raises(InputError, match="synthetic_00 is there already"):
        Evidence.from_paths(lineage, [table], None)
    shutil.copy(table, tmp_path / "another.csv")
    with pytest.raises(InputError, match="another is the same table as synthetic_00"):
        Evidence.from_paths(lineage, [tmp_path / "another.csv"], None)
    with pytest.raises(InputError, match="is no evidence"):
        Evidence.from_paths(lineage, [tmp_path / "none.csv"], None)
    evidence = Evidence.from_paths(lineage, [new_drives], None)
    assert set(evidence.vehicle.values()) == {"g80"} and evidence.experiments[0].name == "healthy"
    with pytest.raises(InputError, match="--drives: not given"):
        Lineage.from_folder(identified, None)


@pytest.mark.unhurried
def test_accepted_drives_are_learnt_and_the_next_round_begins_there(
    lpvguard, g80, identified, synthetic, judged, new_drives, tmp_path
):
    signed = decisions_of(judged, new_drives).accepting("A. Person")
    signed = replace(signed, drives=[replace(d, accept=d.name == "healthy") for d in signed.drives])
    (tmp_path / "signed.toml").write_text(signed.text())
    done = lpvguard(
        "refine", identified, "--drives", synthetic, "--apply", tmp_path / "signed.toml", "-o",
        tmp_path / "refined", "--json", tmp_path / "table.json", "--keep", tmp_path / "kept",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    table = json.loads((tmp_path / "table.json").read_text())
    assert table["drives"] == [16, 17] and "thresholds" in table
    assert "frame test, threshold" in done.stderr
    jsonschema.validate(table, schemas.schema("refined"))
    kept = json.loads((tmp_path / "refined/table.json").read_text())
    assert kept == {key: value for key, value in table.items() if key != "written_by"}
    picture = (tmp_path / "refined/bounds.svg").read_text()
    assert picture.count("<svg") == 1 and drawn(g80, kept) == picture

    index = (tmp_path / "refined/drives/experiments.csv").read_text().splitlines()
    assert index[-1] == "healthy,valid,human"
    stage.save(*stage.identify(g80, tmp_path / "refined/drives"), tmp_path / "anew")
    names = sorted(p.name for p in (tmp_path / "anew").iterdir())
    same = filecmp.cmpfiles(tmp_path / "anew", tmp_path / "refined/identification", names, False)
    assert same == (names, [], [])

    lineage = Lineage.from_folder(tmp_path / "refined", None)
    # The lifetime test has counted all drives that were judged, learnt or not.
    assert set(lineage.life.members["g80"].counted) == {"healthy", "worn", "off"} | (
        {"frozen"} & set(lineage.life.members["g80"].counted)
    )
    with pytest.raises(InputError, match="is another one"):
        renew(lineage, tmp_path / "signed.toml", tmp_path / "again")
    with pytest.raises(InputError, match="a refined folder has them"):
        Lineage.from_folder(tmp_path / "refined", synthetic)


@pytest.mark.unhurried
def test_a_drive_that_changed_since_it_was_judged_is_refused(
    identified, synthetic, judged, new_drives, tmp_path
):
    shutil.copytree(new_drives, tmp_path / "new")
    signed = decisions_of(judged, tmp_path / "new").accepting("A")
    (tmp_path / "signed.toml").write_text(signed.text())
    with (tmp_path / "new/healthy.csv").open("a") as file:
        file.write("\n")
    with pytest.raises(InputError, match="has changed since it was judged"):
        renew(Lineage.from_folder(identified, synthetic), tmp_path / "signed.toml", tmp_path / "out")
    none = replace(signed, drives=[replace(d, accept=False) for d in signed.drives])
    (tmp_path / "none.toml").write_text(none.text())
    with pytest.raises(InputError, match="no drive is accepted"):
        renew(Lineage.from_folder(identified, synthetic), tmp_path / "none.toml", tmp_path / "out")


def test_a_common_error_of_all_drives_recentres():
    def estimates(gains):
        return [(DriveEstimate("r", g, 0.0, 0.0),) for g in gains]

    known = estimates([0.1, 0.11, 0.12])
    said = _shifted(known)
    assert said.keys() == {(0, "gain")} and said[0, "gain"].startswith(
        "gain of r is off by +0.11 in the mean"
    )
    assert not _shifted(estimates([0.1, 0.11])) and not _shifted(estimates([0.1, -0.1, 0.02]))
    assert _dominant((DriveEstimate("r", 0.13, 0.0, 0.0),), _largest(known)) == (0, "gain")
    assert _dominant((DriveEstimate("r", 0.13, 0.01, 0.0),), _largest(known)) == (0, "delay_s")


@pytest.mark.slow("five refinements of 16 drives and more")
def test_a_gain_that_drifts_to_0_7_is_never_learnt_as_healthy(g80, identified, synthetic, tmp_path):
    """Each round a person accepts all that is proposed. The drift is slower than every refinement."""
    gains = 1 - 0.3 * np.arange(1, 31) / 30
    folder, drives = identified, synthetic
    for turn in range(5):
        names = {f"day_{i:02d}": gains[i] for i in range(6 * turn, 6 * turn + 6)}
        new = further(g80, tmp_path / f"new_{turn}", names, seed=30 + turn)
        lineage = Lineage.from_folder(folder, drives)
        decisions, lives = decide(lineage, Evidence.from_paths(lineage, [new], None), tmp_path)
        accepted = [d for d in decisions.drives if d.proposal != "fault"]
        assert all(names[d.name] > 0.83 for d in accepted), [(d.name, d.proposal) for d in accepted]
        if turn == 4:
            assert lives["vehicles"]["g80"]["changed_at"] is not None
            assert all("lifetime test" in d.reason for d in decisions.drives)
        if accepted:
            signed = decisions.accepting("A trusting person")
            (tmp_path / f"{turn}.toml").write_text(signed.text())
            renew(lineage, tmp_path / f"{turn}.toml", tmp_path / f"refined_{turn}")
            folder, drives = tmp_path / f"refined_{turn}", None


def test_decisions_are_toml_that_a_person_can_edit(tmp_path):
    document = tomlkit.parse(Decisions("seal", "", []).text())
    assert document["signed_by"] == "" and document["identification"] == "seal"


def of_vehicles(folder: Path) -> Path:
    """Name the vehicle of each drive by the drive's name before the last underscore."""
    index = folder / "experiments.csv"
    head, *rows = index.read_text().splitlines()
    named = [f"{row},{row.split(',')[0].rpartition('_')[0]}" for row in rows]
    index.write_text("\n".join([f"{head},vehicle", *named]) + "\n")
    return folder


@pytest.mark.slow("a refinement of 16 drives and more")
def test_a_heavy_vehicle_is_healthy_beside_itself_and_its_wear_is_seen(g80, identified, synthetic, tmp_path):
    first = of_vehicles(
        further(g80, tmp_path / "first", {f"{v}_{i}": 0.6 for v in ("heavy", "old") for i in range(4)})
    )
    lineage = Lineage.from_folder(identified, synthetic)
    evidence = Evidence.from_paths(lineage, [first], "vehicle")
    decisions, _ = decide(lineage, evidence, tmp_path)
    assert {d.proposal for d in decisions.drives} == {"fault"}
    inspected = decisions.text().replace("accept = false", "accept = true")
    inspected = inspected.replace('action = "fault"', 'action = "spread"').replace(
        'why = ""', 'why = "heavy"'
    )
    (tmp_path / "signed.toml").write_text(inspected.replace('signed_by = ""', 'signed_by = "A"'))
    renew(lineage, tmp_path / "signed.toml", tmp_path / "refined")

    own = OwnGains.read(tmp_path / "refined" / OWN)
    assert own.vehicles["heavy"].gain == pytest.approx((0.6,), abs=0.03)
    # A worn light vehicle has the gain of the heavy one.
    later = {f"{v}_{i}": g for v, g in (("heavy", 0.6), ("light", 0.6), ("old", 0.45)) for i in range(4, 8)}
    lineage = Lineage.from_folder(tmp_path / "refined", None)
    evidence = Evidence.from_paths(
        lineage, [of_vehicles(further(g80, tmp_path / "later", later, seed=22))], "vehicle"
    )
    drives = decide(lineage, evidence, tmp_path)[0].drives
    assert [d.proposal == "fault" for d in drives] == 4 * [False] + 8 * [True]
    assert "of the first model's gain" in drives[4].reason
    assert "of old's own gain; from 0.15 off on" in drives[8].reason
