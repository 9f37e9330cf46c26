"""No command removes or replaces what it did not write, and nothing edited is taken for what was written:
exit 2, and nothing changes."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from importlib import resources
from pathlib import Path

import pytest

from drive_table import table
from hand_controller import hand_controller
from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.core.compiled import library_root, shipped_vehicle
from lpvguard.core.control_coefficients import load_controller
from lpvguard.vehicle.project import load_project

VEHICLES = resources.files("lpvguard.vehicle").joinpath("shipped")


def contents(root: Path) -> dict[str, str]:
    """Everything below a folder: names, kinds, links and hashes."""

    def content(p: Path) -> str:
        if p.is_symlink():
            return f"-> {os.readlink(p)}"
        return "folder" if p.is_dir() else hashlib.sha256(p.read_bytes()).hexdigest()

    return {p.relative_to(root).as_posix(): content(p) for p in sorted(root.rglob("*"))}


@pytest.fixture
def run(lpvguard):
    """The command line: words -> exit status and what it said."""

    def call(*words: object) -> tuple[int, str]:
        done = lpvguard(*words)
        return done.returncode, done.stderr

    return call


@pytest.fixture
def here(tmp_path, monkeypatch, synthetic, identified, vehicle):
    """What a user has: drives, an identification, a generated folder, his project file, logs and notes."""
    home = tmp_path / "home"
    home.mkdir()
    for name, folder in (("drives", synthetic), ("idn", identified), ("car", vehicle)):
        shutil.copytree(folder, home / name)
    text = VEHICLES.joinpath("g80.toml").read_text()
    (home / "car.toml").write_text(text)
    (home / "alpha.toml").write_text(
        text.replace("[frame_test]", "[frame_test]\nalpha = 0.05")
        if "alpha" not in text
        else text.replace("alpha = 0.1", "alpha = 0.05")
    )
    table(home, "x.csv")
    (home / "map.toml").write_text('schema = 1\nTs_s = 0.02\n[columns.v]\nunit = "m/s"\nsignal = "v"\n')
    (home / "problems.json").write_text("[]")
    (home / "list.json").write_text('[{"mine": 1}]')
    (home / "object.json").write_text('{"kind": "evaluation", "mine": 1}')
    (home / "linked").symlink_to("idn")
    (home / "x-link.csv").symlink_to("x.csv")
    os.link(home / "x.csv", home / "x-hard.csv")
    (home / "case.toml").write_text("schema = 1\n")
    (home / "notes").mkdir()
    (home / "notes" / "thesis.txt").write_text("years")
    monkeypatch.chdir(home)
    return home


INGEST = "ingest x.csv --signals map.toml"
REPLAY = "replay --vehicle g80 --coefficients car x.csv"
EVALUATE = "evaluate --vehicle g80 idn drives --coefficients car"
REFUSED = {
    # An output that is an input, or lies inside or above one.
    "identify drives -o drives": "identify --vehicle g80 drives -o drives",
    "export idn -o idn": "export --vehicle g80 idn -o idn",
    "a trailing slash": "export --vehicle g80 idn -o idn/",
    "another spelling": "export --vehicle g80 idn -o drives/../idn",
    "a symbolic link": "export --vehicle g80 idn -o linked",
    "the input linked": "export --vehicle g80 linked -o idn",
    "inside the identification": "export --vehicle g80 idn -o idn/c",
    "above the identification": "export --vehicle g80 notes/../idn -o ../home",
    "the current folder": "export --vehicle g80 idn -o .",
    "the folder above": "export --vehicle g80 idn -o ..",
    "the root": "export --vehicle g80 idn -o /",
    "the root in disguise": "export --vehicle g80 idn -o /../",
    "generate here": "generate --vehicle g80 -o .",
    "replay over its drive": f"{REPLAY} --json x.csv",
    "replay over a link to its drive": f"{REPLAY} --json x-link.csv",
    "replay over a hard link to its drive": f"{REPLAY} --json x-hard.csv",
    "replay into its coefficients": f"{REPLAY} --json car/foo.json",
    "replay over its coefficients": f"{REPLAY} --json car/lpvguard_coeff.c",
    "identify --json into its drives": "identify --vehicle g80 drives -o new --json drives/found.json",
    "identify --json into its own output": "identify --vehicle g80 drives -o new --json new/found.json",
    "evaluate into the identification": f"{EVALUATE} --json idn/evaluation.json",
    "evaluate over the index": f"{EVALUATE} --json drives/experiments.csv",
    "report over the project file": "report idn drives --vehicle car.toml --coefficients car -o car.toml",
    "report into the identification": "report idn drives --vehicle g80 --coefficients car -o idn/report.html",
    "ingest over its map": f"{INGEST} -o new --json map.toml",
    "ingest into a foreign folder": f"{INGEST} -o notes",
    "solve over its problems": "solve problems.json -o problems.json",
    "design over its case": "design --case case.toml -o out --json case.toml",
    "the package's own vehicles": f"dbc -o {VEHICLES.joinpath('g80.toml')}",
    "the shipped coefficients": f"replay --vehicle g80 x.csv --json {shipped_vehicle('g80') / 'replay.json'}",
    # What somebody else wrote, or another command.
    "a folder of notes": "generate --vehicle g80 -o notes",
    "an identification by generate": "generate --vehicle g80 -o idn",
    "a generated folder by ingest": f"{INGEST} -o car",
    "drives by sim": "sim nominal -o drives",
    "a user's list": f"{REPLAY} --json list.json",
    "a user's object": f"{EVALUATE} --json object.json",
    "a page over a table": "report idn drives --vehicle g80 --coefficients car -o x.csv",
    "a database over notes": "dbc -o notes/thesis.txt",
    "answers over a user's list": "solve problems.json -o list.json",
    "numbers over a user's list": "bench bounds --json list.json",
    "the truck's drives over a table": "plant generate -o x.csv",
    "a recording over a table": "sim nominal --lcm file://x.csv?mode=w",
    "a file for a folder": "generate --vehicle g80 -o x.csv",
    "a folder for a file": f"{REPLAY} --json notes",
    "a campaign over notes": "campaign idn drives -o notes --coefficients car",
    # A project file that is not the one it was made with.
    "export of other settings": "export --vehicle alpha.toml idn -o new",
    "design of other settings": "design --vehicle alpha.toml idn -o new",
    "replay of other settings": "replay --vehicle alpha.toml --coefficients car x.csv",
    "evaluate of other settings": f"{EVALUATE} --json new.json".replace("g80", "alpha.toml"),
    "report of other settings": "report idn drives --vehicle alpha.toml --coefficients car -o new.html",
}


@pytest.mark.parametrize("case", REFUSED)
def test_it_is_refused_and_nothing_changes(case, run, here):
    words = REFUSED[case].split()
    before, package = contents(here), contents(Path(str(VEHICLES)))
    status, said = run(*words)
    assert status == 2 and said.startswith("lpvguard: error: ") and said.count("\n") == 1, said
    assert contents(here) == before and contents(Path(str(VEHICLES))) == package
    target = next((words[i + 1] for o in ("--json", "-o") for i, w in enumerate(words) if w == o), "x.csv")
    if "alpha.toml" in words:
        assert (
            said.startswith("lpvguard: error: frame_test.alpha: 0.1 in ") and ", 0.05 in alpha.toml" in said
        )
    else:
        assert target.strip("/") in said or target.rpartition("/")[2] in said, said


EDITS = {
    "the threshold": (
        "idn/calibration.json",
        '"threshold": ',
        '"threshold": 1',
        "export --vehicle g80 idn -o new",
    ),
    "a weight": ("idn/weights.json", '"inflation": ', '"inflation": 1', EVALUATE),
    "a bound": (
        "idn/bounds.json",
        '"B_w": [',
        '"B_w": [ ',
        "report idn drives --vehicle g80 --coefficients car -o new.html",
    ),
    "a setting": ("idn/project.json", '"alpha": 0.1', '"alpha": 0.2', "design --vehicle g80 idn -o new"),
    "a hash": (
        "idn/MANIFEST.json",
        '"calibration.json": "',
        '"calibration.json": "0',
        "export --vehicle g80 idn -o new",
    ),
    "a coefficient": (
        "car/lpvguard_coeff.c",
        ".threshold = LPVG_NUMBER(",
        ".threshold = LPVG_NUMBER(1",
        REPLAY,
    ),
    "a size": (
        "car/lpvguard_vehicle.h",
        "#define LPVG_NCELLS 32",
        "#define LPVG_NCELLS 33",
        "sim nominal --coefficients car",
    ),
    "a signal": ("car/SIGNALS.md", "#", "##", EVALUATE),
    "a stored setting": ("car/MANIFEST.json", '"alpha": 0.1', '"alpha": 0.2', REPLAY),
}


@pytest.mark.parametrize("what", EDITS)
def test_an_edit_is_refused_by_its_file(what, run, here):
    file, old, new, words = EDITS[what]
    text = (here / file).read_text()
    assert old in text
    (here / file).write_text(text.replace(old, new, 1))
    before = contents(here)
    status, said = run(*words.split())
    assert status == 2 and file in said and "changed after" in said and contents(here) == before, said


@pytest.mark.parametrize("change", ["more", "fewer", "edited"])
def test_a_folder_that_is_not_what_its_manifest_lists_is_neither_replaced_nor_read(change, run, here):
    if change == "more":
        (here / "car" / "extra.c").write_text("int extra;\n")
    elif change == "fewer":
        (here / "car" / "SIGNALS.md").unlink()
    else:
        (here / "car" / "SIGNALS.md").write_text("mine")
    name = "extra.c" if change == "more" else "SIGNALS.md"
    before = contents(here)
    for words in ("export --vehicle g80 idn -o car", REPLAY):
        status, said = run(*words.split())
        assert status == 2 and f"car/{name}" in said and contents(here) == before, said


@pytest.mark.unhurried
def test_what_is_ours_is_replaced_and_ends_the_same(run, here):
    before = contents(here)
    assert run(*["export", "--vehicle", "car.toml", "idn", "-o", "car"])[0] == 0
    assert contents(here) == before, "the same input gives the same bytes, and nothing stays beside it"
    (here / "title.toml").write_text((here / "car.toml").read_text().replace('title = "', 'title = "My '))
    assert run(*["export", "--vehicle", "title.toml", "idn", "-o", "car"])[0] == 0, (
        "nothing is computed of a title"
    )
    for words in (
        f"{REPLAY} --json replay.json",
        f"{INGEST} -o tables --json i.json",
        "solve problems.json -o answers.json",
        "dbc -o our.dbc",
    ):
        for _ in range(2):
            assert run(*words.split())[0] in (0, 1), words
    (here / "tables" / "experiments.csv").write_text("experiment,split\nx,train\n")
    status, said = run(*f"{INGEST} -o tables".split())
    assert status == 2 and "experiments.csv" in said, "an index that the user filled in is his"


@pytest.mark.unhurried
def test_the_second_of_two_runs_is_refused_while_the_first_holds_the_folder(run, here):
    before = contents(here)
    script = (
        "import sys\nfrom pathlib import Path\nfrom lpvguard.base import artefacts\n"
        "with artefacts.claimed(Path('car')):\n    print('held', flush=True)\n    sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as first:
        assert first.stdout.readline() == "held\n"
        held = contents(here)
        status, said = run(*["export", "--vehicle", "g80", "idn", "-o", "car"])
        assert status == 2 and "car" in said and "another run" in said and contents(here) == held
        assert run(*REPLAY.split())[0] in (0, 1), "who reads is not held up"
        first.kill()
    assert run(*["export", "--vehicle", "g80", "idn", "-o", "car"])[0] == 0 and contents(here) == before, (
        "the lock ends with its process"
    )


def test_a_foreign_folder_by_the_name_of_a_work_folder_stays(run, here):
    (here / ".car.lpvguard").mkdir()
    (here / ".car.lpvguard" / "new").write_text("mine")
    before = contents(here)
    status, said = run(*["export", "--vehicle", "g80", "idn", "-o", "car"])
    assert status == 2 and ".car.lpvguard/new" in said and contents(here) == before


def test_a_half_done_swap_is_undone_by_whoever_reads_next(run, here):
    work = here / ".car.lpvguard"
    work.mkdir()
    (work / "lpvguard-scratch").touch()
    (work / "new").mkdir()
    (here / "car").rename(work / "old")
    assert (
        run(*REPLAY.split())[0] in (0, 1) and (here / "car" / "MANIFEST.json").is_file() and not work.exists()
    )


def test_an_edited_controller_is_refused_by_its_own_seal(tmp_path):
    path = tmp_path / "controller.json"
    document = json.loads(
        artefacts.to_json(artefacts.sealed({"kind": "controller", **hand_controller(load_project("truck"))}))
    )
    path.write_text(json.dumps(document))
    load_controller(path)
    path.write_text(json.dumps(document | {"u_max": [[2 * x for x in node] for node in document["u_max"]]}))
    with pytest.raises(InputError, match="seal: does not fit"):
        load_controller(path)


@pytest.mark.parametrize(
    "name", sorted(p.parent.name for p in library_root().glob("vehicles/*/MANIFEST.json"))
)
def test_the_shipped_folders_are_sealed_and_have_the_shipped_settings(name):
    stored = artefacts.read_manifest(shipped_vehicle(name), "vehicle")["project"]
    document = json.loads(artefacts.to_json(load_project(name).model_dump(by_alias=True)))
    assert artefacts.first_difference(stored, document) is None


def test_the_first_difference_is_named_by_its_path():
    a = {"x": {"y": [1, {"z": 2.0}]}, "w": None}
    assert artefacts.first_difference(a, json.loads(json.dumps(a))) is None
    assert artefacts.first_difference(a, {"x": {"y": [1, {"z": 3.0}]}, "w": None}) == ("x.y[1].z", 2.0, 3.0)
    assert artefacts.first_difference({"x": [1]}, {"x": [1, 2]}) == ("x", [1], [1, 2])
    assert artefacts.first_difference({"x": 1}, {"x": True}) == ("x", 1, True)
