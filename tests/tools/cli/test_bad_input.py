"""Bad input: one line that names file, place and expectation, exit status 2, nothing half-written."""

import shutil
import subprocess
import sys

import numpy as np
import pytest

from drive_table import table
from lpvguard.base import artefacts
from lpvguard.can.dbc import dbc_text
from lpvguard.drives.tables import list_experiments

ANOTHER_CORE = pytest.mark.slow("3 s: a core compiled with it")


def with_value(index, column, value):
    def make(folder):
        path = table(folder)
        lines = path.read_text().splitlines()
        cells = lines[index].split(",")
        cells[["t", "v", "delta", "r"].index(column)] = value
        lines[index] = ",".join(cells)
        path.write_text("\n".join(lines) + "\n")
        return path

    return make


def empty(folder):
    (folder / "run.csv").touch()
    return folder / "run.csv"


def binary(folder):
    (folder / "run.csv").write_bytes(bytes(range(256)) * 40)
    return folder / "run.csv"


def header_only(folder):
    (folder / "run.csv").write_text("t,v,delta,r\n")
    return folder / "run.csv"


t = np.arange(0, 30, 0.02)
BAD_TABLES = {
    "missing column": (lambda f: table(f, delta=None), ["column delta"]),
    "time backwards": (with_value(100, "t", "0.5"), ["line 101", "column t", "increasing"]),
    "time repeated": (with_value(100, "t", "1.94"), ["column t", "increasing"]),
    "a gap": (lambda f: table(f, t=t + np.where(t > 5, 1.0, 0.0)), ["column t", "uniform grid of 0.02 s"]),
    "wrong rate": (lambda f: table(f, t=t / 2), ["uniform grid of 0.02 s"]),
    "time NaN": (with_value(50, "t", "nan"), ["line 51", "column t", "finite"]),
    "time blank": (with_value(50, "t", ""), ["line 51", "column t", "finite"]),
    "all NaN": (lambda f: table(f, r=np.full_like(t, np.nan)), ["line 2", "column r", "1500 such values"]),
    "text": (with_value(50, "v", "fast"), ["line 51", "column v", "fast"]),
    "degrees out of range": (
        lambda f: table(f, delta=np.degrees(0.05 * np.sin(2 * t))),
        ["column delta", "degrees", "rad"],
    ),
    "small angles in degrees": (
        lambda f: table(f, delta=np.degrees(0.01 * np.sin(2 * t)), r=0.034 * np.sin(2 * t - 0.3)),
        ["57.3", "degrees"],
    ),
    "yaw rate in degrees": (
        lambda f: table(f, delta=0.008 * np.sin(2 * t), r=np.degrees(0.027 * np.sin(2 * t - 0.3))),
        ["57.3", "degrees"],
    ),
    "km/h": (lambda f: table(f, v=np.full_like(t, 100.0)), ["column v", "m/s"]),
    "empty file": (empty, ["empty"]),
    "header only": (header_only, ["samples"]),
    "binary": (binary, ["run.csv"]),
    "no such file": (lambda f: f / "nothing.csv", ["no such file"]),
    "no judged stretch": (lambda f: table(f, v=np.full_like(t, 1.0)), ["no judged stretch at all"]),
}


@pytest.mark.parametrize("case", BAD_TABLES)
def test_replay_refuses_the_table_by_place(case, lpvguard, tmp_path):
    make, says = BAD_TABLES[case]
    path = make(tmp_path)
    done = lpvguard("replay", "--vehicle", "g80", path)
    assert done.returncode == 2, done.stderr
    line = next(x for x in done.stderr.splitlines() if x.startswith("lpvguard: error"))
    assert "Traceback" not in done.stderr and path.stem in line
    for text in says:
        assert text in line, line


def test_a_readable_drive_is_still_answered_beside_an_unreadable_one(lpvguard, tmp_path):
    import json

    done = lpvguard("replay", "--vehicle", "g80", empty(tmp_path), table(tmp_path, "good.csv"), "--json", "-")
    assert done.returncode == 2 and [d["run"] for d in json.loads(done.stdout)] == ["good"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["replay", "--vehicle", "g81", "x.csv"], "unknown vehicle"),
        (["replay", "--vehicle", "nothing.toml", "x.csv"], "nothing.toml"),
        (["replay", "--vehicle", "g80", "x.csv", "--coefficients", "nowhere"], "nowhere"),
        (["identify", "--vehicle", "g80", "nowhere", "-o", "out"], "no such folder"),
        (["export", "--vehicle", "g80", "nowhere", "-o", "out"], "MANIFEST.json"),
        (["generate", "--vehicle", "g80", "--seed", "-1", "-o", "out"], "--seed"),
    ],
)
def test_bad_arguments_end_with_status_2_and_leave_nothing_behind(arguments, says, lpvguard, tmp_path):
    done = lpvguard(*arguments, cwd=tmp_path)
    assert done.returncode == 2 and says in done.stderr and "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())


INDICES = {
    "no UTF-8": ("experiment,split\nfährt,train\n".encode("latin-1"), "experiments.csv: cannot be read"),
    "NUL": (b"experiment,split\nru\0n,train\n", "experiments.csv: line 2: no table"),
    "a cell of 200 kB": (
        b"experiment,split\n" + bytes(200_000).replace(b"\0", b"x"),
        "cannot be read (field",
    ),
    "divided by ;": (b"experiment;split\nrun;train\n", "header: column experiment is missing, there is"),
    "empty": (b"", "header: column experiment is missing"),
}


@pytest.mark.parametrize("case", INDICES)
def test_an_index_that_is_none_is_refused_by_place(case, lpvguard, tmp_path):
    drives = tmp_path / "drives"
    drives.mkdir()
    table(drives)
    text, says = INDICES[case]
    (drives / "experiments.csv").write_bytes(text)
    done = lpvguard("identify", "--vehicle", "g80", drives, "-o", tmp_path / "id")
    assert done.returncode == 2 and says in done.stderr and "Traceback" not in done.stderr, done.stderr


def test_an_index_with_a_byte_order_mark_is_read(tmp_path):
    table(tmp_path)
    (tmp_path / "experiments.csv").write_text("experiment,split\nrun,train\n", encoding="utf-8-sig")
    assert [e.name for e in list_experiments(tmp_path)] == ["run"]


def test_what_the_system_refuses_is_named(lpvguard, tmp_path):
    done = lpvguard("dbc", "-o", "a" * 300, cwd=tmp_path)
    assert done.returncode == 2 and f"{'a' * 300}: cannot be used (File name too long)" in done.stderr


@pytest.mark.slow("2 s a case: a process")
@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_command_needs_no_standard_stream(closed, tmp_path):
    """Nor does what it prints go into a file that takes the number of a closed one."""
    words = ["dbc", "-o", tmp_path / "out.dbc"]
    script = f'exec "$0" -m lpvguard.cli "$@" {closed}'
    done = subprocess.run(["sh", "-c", script, sys.executable, *words], capture_output=True, check=False)
    assert done.returncode == 0 and (tmp_path / "out.dbc").read_text() == dbc_text(), done.stderr


def test_identify_leaves_nothing_behind_when_a_drive_is_bad(lpvguard, synthetic, tmp_path):
    drives = tmp_path / "drives"
    shutil.copytree(synthetic, drives)
    lines = (drives / "synthetic_03.csv").read_text().splitlines()
    lines[200] = lines[200].replace(",", ",fast,", 1).rsplit(",", 1)[0]
    (drives / "synthetic_03.csv").write_text("\n".join(lines) + "\n")
    done = lpvguard("identify", "--vehicle", "g80", drives, "-o", tmp_path / "out" / "id")
    assert done.returncode == 2 and "synthetic_03.csv: line 201" in done.stderr
    assert not list((tmp_path / "out").iterdir()) if (tmp_path / "out").exists() else True


def test_identify_refuses_drives_without_any_counted_frame(lpvguard, tmp_path):
    drives = tmp_path / "drives"
    drives.mkdir()
    table(drives, "slow.csv", v=np.full_like(t, 2.0))
    (drives / "experiments.csv").write_text("experiment,split\nslow,train\n")
    done = lpvguard("identify", "--vehicle", "g80", drives, "-o", tmp_path / "id")
    assert (
        done.returncode == 2 and "no judged stretch at all" in done.stderr and not (tmp_path / "id").exists()
    )


@pytest.mark.unhurried
@pytest.mark.parametrize("split", ["train", "valid"])
def test_identify_refuses_drives_of_which_nothing_calibrates(split, lpvguard, synthetic, tmp_path):
    """Every drive sets the bounds; or the only one that calibrates is never judged."""
    drives = tmp_path / "drives"
    drives.mkdir()
    shutil.copy(synthetic / "synthetic_01.csv", drives)
    table(drives, "slow.csv", v=np.full_like(t, 2.0))
    (drives / "experiments.csv").write_text(f"experiment,split\nsynthetic_01,train\nslow,{split}\n")
    done = lpvguard("identify", "--vehicle", "g80", drives, "-o", tmp_path / "id")
    assert done.returncode == 2 and not (tmp_path / "id").exists()
    said = " ".join(done.stderr.split())
    if split == "train":
        assert "experiments.csv: column split: no drive calibrates: every drive sets the bounds" in said
    else:
        assert "drives that calibrate (1): no drive calibrates: no test judges one (slow: no" in said
    assert [p.name for p in tmp_path.iterdir()] == ["drives"]


def test_a_foreign_folder_is_never_overwritten(lpvguard, synthetic, tmp_path):
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.txt").write_text("years")
    done = lpvguard("generate", "--vehicle", "g80", "-o", precious)
    assert done.returncode == 2 and "was not written by lpvguard" in done.stderr
    assert (precious / "thesis.txt").read_text() == "years"


@pytest.mark.parametrize(
    ("file", "old", "new", "says"),
    [
        ("lpvguard_vehicle.h", "#define LPVG_ESTIMATOR_ID ", "#define LPVG_ESTIMATOR_ID 1", "bad_estimator"),
        pytest.param(
            "lpvguard_vehicle.h",
            "#define LPVG_NCELLS 32",
            "#define LPVG_NCELLS 33",
            "bad_size",
            marks=ANOTHER_CORE,
        ),
        pytest.param(
            "lpvguard_coeff.c",
            ".threshold = LPVG_NUMBER(",
            ".threshold = LPVG_NUMBER(1",
            "bad_crc",
            marks=ANOTHER_CORE,
        ),
        pytest.param(
            "lpvguard_coeff.c",
            ".settle_samples = 18U",
            ".settle_samples = 19U",
            "bad_crc",
            marks=ANOTHER_CORE,
        ),
    ],
)
def test_coefficients_of_another_estimator_or_size_are_refused(
    file, old, new, says, lpvguard, vehicle, tmp_path
):
    copy = tmp_path / "g80"
    shutil.copytree(vehicle, copy)
    text = (copy / file).read_text()
    assert old in text
    (copy / file).write_text(text.replace(old, new, 1))
    refused = lpvguard("replay", "--vehicle", "g80", "--coefficients", copy, table(tmp_path))
    assert refused.returncode == 2 and f"{file}: is not the file" in refused.stderr
    artefacts.seal(copy)  # what the seal does not notice is noticed all the same
    done = lpvguard("replay", "--vehicle", "g80", "--coefficients", copy, table(tmp_path))
    assert done.returncode == 2 and says in done.stderr, done.stderr


def test_a_vehicle_of_another_estimator_does_not_run_with_these_coefficients(lpvguard, vehicle, tmp_path):
    from importlib import resources

    text = resources.files("lpvguard.vehicle").joinpath("shipped", "g80.toml").read_text()
    (tmp_path / "g80.toml").write_text(text.replace("speed_tolerance = 0.15", "speed_tolerance = 0.2"))
    done = lpvguard("replay", "--vehicle", tmp_path / "g80.toml", "--coefficients", vehicle, table(tmp_path))
    assert done.returncode == 2 and "frames.speed_tolerance: 0.15 in" in done.stderr


@pytest.mark.parametrize(
    "words",
    [
        ("--case", "case.toml", "--largest-A-t"),
        ("--case", "case.toml", "--no-table"),
        ("--case", "case.toml", "--no-moving-speed"),
        ("--case", "case.toml", "--tradeoff"),
        ("--vehicle", "truck", "identify", "--tradeoff", "--largest-A-t"),
        ("--vehicle", "truck", "identify", "--tradeoff", "--no-table"),
        ("--vehicle", "truck", "identify", "--tradeoff", "--no-moving-speed"),
    ],
)
def test_design_refuses_options_that_it_would_ignore(words, lpvguard, tmp_path):
    done = lpvguard("design", *words, "-o", tmp_path / "out")
    assert done.returncode == 2 and "expected" in done.stderr and words[-1] in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "says"),
    [("{}", "has unexpected content"), ('{"duels": [{"way": "ramp"}]}', "duels[].precluded: missing")],
)
def test_a_page_refuses_an_evaluation_of_another_shape(text, says, lpvguard, identified, synthetic, tmp_path):
    (tmp_path / "evaluation.json").write_text(text)
    arguments = (
        "--vehicle",
        "g80",
        "--evaluation",
        tmp_path / "evaluation.json",
        "-o",
        tmp_path / "page.html",
    )
    done = lpvguard("report", identified, synthetic, *arguments)
    assert done.returncode == 2 and "evaluation.json" in done.stderr and says in done.stderr, done.stderr
    assert not (tmp_path / "page.html").exists()
