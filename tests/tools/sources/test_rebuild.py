"""`lpvguard data`: a published data set comes out with the hashes of its table, or not at all."""

import hashlib
import io
import json
import os
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from lpvguard.extras.sources.table import SHIPPED, load_data_set

RATE_HZ = 20
SHIPPED_NAMES = sorted(tomllib.loads(SHIPPED.read_text(encoding="utf-8")))


def sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def git(folder: Path, *words: str) -> str:
    who = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "protocol.file.allow=always")
    done = subprocess.run(["git", *who, "-C", folder, *words], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def matlab(t: np.ndarray, **variables: np.ndarray) -> bytes:
    stream = io.BytesIO()
    savemat(stream, {"t": t, **variables})
    return stream.getvalue()


def numpy_file(values: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values)
    return stream.getvalue()


@pytest.fixture
def published(tmp_path):
    """A public repository with two commits: a MATLAB file whose second version counts, a CSV, CAN arrays; the
    table of it, and what must come out."""
    home = tmp_path / "repository"
    (home / "can").mkdir(parents=True)
    git(home, "init", "--quiet")
    git(home, "config", "uploadpack.allowAnySHA1InWant", "true")
    git(home, "config", "uploadpack.allowFilter", "true")
    # Irregular time; a straight line and a turning angle of which every value on the grid is known.
    t = 1e9 + np.array([0.0, 0.013, 0.08, 0.151, 0.2, 0.33, 0.5])
    angle = 3.0 + 2.0 * (t - t[0])
    arrays = {
        "address": np.array([0x25, 0x2E4, 0x25]),
        "data": np.array([b"\x01\x02", b"\xff" * 8, b"\x03"]),
        "src": np.array([0, 7, 128]),
        "t": np.array([5.0, 5.5, 6.25]),
    }
    old = matlab(t, v=0 * t, psi=0 * t)
    new = matlab(t, v=4.0 + 6.0 * (t - t[0]), psi=(angle + np.pi) % (2 * np.pi) - np.pi)
    raw = b"# a comment\r\nt,v,lidar\r\n0.10,1.5,99\r\n0.20,2.50,98\r\n"
    for name, data in (("run.mat", old), ("log.csv", raw)):
        (home / name).write_bytes(data)
    for name, values in arrays.items():
        (home / "can" / name).write_bytes(numpy_file(values))
    git(home, "add", ".")
    git(home, "commit", "--quiet", "-m", "a")
    first = git(home, "rev-parse", "HEAD")
    (home / "run.mat").write_bytes(new)
    git(home, "commit", "--quiet", "-am", "b")
    second = git(home, "rev-parse", "HEAD")
    git(home, "checkout", "--quiet", first)
    grid = np.arange(10) / RATE_HZ
    rows = [f"{x:.2f},{4 + 6 * x:.3f},{3 + 2 * x:.3f},{2.0:.1f}" for x in grid]
    want = {
        "run.csv": ("t,v,psi,turn\n" + "\n".join(rows) + "\n").encode(),
        "raw/log.csv": b"# a comment\nt,v\n0.10,1.5\n0.20,2.50\n",
        "bus.log": b"(5.000000) can0 025#0102000000000000\n(6.250000) can1 025#0300000000000000\n",
    }
    in_order = b"".join((home / "can" / n).read_bytes() for n in ("address", "data", "src", "t"))
    data_set = {
        "title": "A published car",
        "repository": home.as_uri(),
        "licence": "MIT",
        "index": "experiments.csv",
        "form": {
            "kind": "matlab",
            "time": "t",
            "rate_hz": RATE_HZ,
            "columns": [
                {"name": "t", "decimals": 2},
                {"name": "v", "signal": "v", "decimals": 3},
                {"name": "psi", "signal": "psi", "decimals": 3, "unwrap": True},
                {"name": "turn", "signal": "psi", "decimals": 1, "unwrap": True, "slope_samples": 5},
            ],
        },
        "files": [
            {
                "name": "run.csv",
                "commit": second,
                "path": "run.mat",
                "source_sha256": sha(new),
                "index": {"experiment": "run", "split": "train"},
            },
            {
                "name": "raw/log.csv",
                "commit": first,
                "path": "log.csv",
                "source_sha256": sha(raw),
                "form": {"kind": "csv", "columns": ["t", "v"]},
            },
            {
                "name": "bus.log",
                "commit": first,
                "path": "can",
                "source_sha256": sha(in_order),
                "form": {"kind": "can_arrays", "buses": {"0": "can0", "128": "can1"}},
            },
        ],
    }
    for f in data_set["files"]:
        f["sha256"] = sha(want[f["name"]])
    return home, data_set, want


def written(path: Path, data_set: dict) -> Path:
    """The table as TOML: JSON's strings, numbers and lists are those of TOML."""

    def plain(value: object) -> str:
        if isinstance(value, dict):
            return "{ " + ", ".join(f"{k} = {plain(v)}" for k, v in value.items()) + " }"
        return f"[{', '.join(map(plain, value))}]" if isinstance(value, list) else json.dumps(value)

    path.write_text("[car]\n" + "".join(f"{k} = {plain(v)}\n" for k, v in data_set.items()))
    return path


def test_a_clone_a_plain_folder_and_git_itself_give_the_published_bytes(lpvguard, published, tmp_path):
    home, data_set, want = published
    table = written(tmp_path / "table.toml", data_set)
    plain = tmp_path / "unpacked"
    subprocess.run(["cp", "-r", home, plain], check=True)
    git(plain, "checkout", "--quiet", data_set["files"][0]["commit"])
    subprocess.run(["rm", "-rf", plain / ".git"], check=True)
    for name, words in (("a", ("--from", home)), ("b", ("--from", plain)), ("c", ())):
        done = lpvguard("data", "car", *words, "--table", table, "-o", tmp_path / name)
        assert done.returncode == 0, done.stderr
        assert {n: (tmp_path / name / n).read_bytes() for n in want} == want
        assert (tmp_path / name / "experiments.csv").read_bytes() == b"experiment,split\r\nrun,train\r\n"
        sources = json.loads((tmp_path / name / "MANIFEST.json").read_text())["sources"]
        assert sources["run.csv"]["commit"] == data_set["files"][0]["commit"]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"source_sha256": "0" * 64}, "run.mat: sha256"),
        ({"sha256": "0" * 64}, "run.csv: sha256"),
        ({"commit": "0" * 40}, "at commit 000000000000: git cannot read it"),
        ({"path": "walk.mat"}, "walk.mat at commit"),
        ({"path": "../run.mat"}, "is not a path below a folder"),
        ({"name": "/run.csv"}, "is not a path below a folder"),
        ({"form": {"kind": "csv", "columns": ["w"]}}, "cannot be read as csv"),
        ({"form": {"kind": "excel"}}, "form"),
        ({"name": "raw/log.csv"}, "listed twice"),
    ],
)
def test_what_is_not_the_published_file_is_refused_and_nothing_is_written(
    change, says, lpvguard, published, tmp_path
):
    home, data_set, _ = published
    data_set["files"][0] |= change
    table = written(tmp_path / "table.toml", data_set)
    done = lpvguard("data", "car", "--from", home, "--table", table, "-o", tmp_path / "out")
    assert done.returncode == 2 and says in done.stderr, done.stderr
    assert not (tmp_path / "out").exists()


def test_an_unknown_data_set_and_a_folder_that_is_not_there_are_refused(lpvguard, tmp_path):
    done = lpvguard("data", "horse", "-o", tmp_path / "out")
    assert done.returncode == 2 and ", ".join(SHIPPED_NAMES) in done.stderr
    done = lpvguard("data", SHIPPED_NAMES[0], "--from", tmp_path / "none", "-o", tmp_path / "out")
    assert done.returncode == 2 and "no such folder" in done.stderr


def test_the_shipped_table_has_the_hashes_of_the_measured_data(measured):
    seen = 0
    for name in SHIPPED_NAMES:
        for f in load_data_set(name).files:
            stored = measured.parent / name / f.name
            if stored.is_file():  # a log may be packed there
                assert sha(stored.read_bytes()) == f.sha256, stored
                seen += 1
    assert seen >= 16


@pytest.mark.slow("5 s: every shipped data set made anew")
@pytest.mark.parametrize("name", SHIPPED_NAMES)
def test_a_shipped_data_set_is_rebuilt_from_its_repository(name, lpvguard, tmp_path):
    """LPVGUARD_SOURCES: a folder of clones, named as the repositories are."""
    data = load_data_set(name)
    clone = Path(os.environ.get("LPVGUARD_SOURCES", "/nonexistent")) / data.repository.rpartition("/")[2]
    if not clone.is_dir():
        pytest.skip(f"no clone of {data.repository}: set LPVGUARD_SOURCES (data/README.md)")
    done = lpvguard("data", name, "--from", clone, "-o", tmp_path / name)
    assert done.returncode == 0, done.stderr
    assert {f.name for f in data.files} <= {
        p.relative_to(tmp_path / name).as_posix() for p in (tmp_path / name).rglob("*")
    }
