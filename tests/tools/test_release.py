"""tools/release: what it refuses, and what it makes: the same bytes from the same commit, and papers that say
what is installed."""

import hashlib
import json
import shutil
import subprocess
import sys
import tarfile
from importlib import metadata
from pathlib import Path

import pytest

from drive_table import table
from made import ROOT
from parts import release

OWN = ("-c", "user.name=test", "-c", "user.email=test@localhost")


@pytest.fixture(scope="module")
def checkout(tmp_path_factory) -> Path:
    """This tree, committed in a repository of its own."""
    folder = tmp_path_factory.mktemp("release") / "checkout"
    away = shutil.ignore_patterns(".git", ".venv", "build", "out", "__pycache__", ".*cache*", ".hypothesis")
    shutil.copytree(ROOT, folder, ignore=away)
    for words in (("init", "-q"), ("add", "-A"), (*OWN, "commit", "-q", "-m", "all")):
        subprocess.run(["git", *words], cwd=folder, check=True)
    return folder


def test_a_tree_that_is_not_as_committed_is_refused(checkout, tmp_path):
    (checkout / "stray").write_text("")
    try:
        with pytest.raises(release().Refused, match=r"not as committed(.|\n)*stray"):
            release().release(checkout, tmp_path / "out", draft=True)
    finally:
        (checkout / "stray").unlink()
    assert not (tmp_path / "out").exists()


def test_a_changelog_that_is_not_of_the_version_and_a_folder_that_is_there_are_refused(
    checkout, tmp_path, monkeypatch
):
    module = release()
    if "## Unreleased" in (checkout / "CHANGELOG.md").read_text():
        with pytest.raises(module.Refused, match="Unreleased, expected"):
            module.version_of(checkout, draft=False)
    with pytest.raises(module.Refused, match="is there, expected a folder that is not"):
        module.release(checkout, tmp_path, draft=True)
    said = module.stated_versions(checkout)
    monkeypatch.setattr(module, "stated_versions", lambda tree: said | {"CITATION.cff": "9.9.9"})
    with pytest.raises(module.Refused, match=r"CITATION\.cff: states 9\.9\.9, expected "):
        module.version_of(checkout, draft=True)
    assert list(tmp_path.iterdir()) == []


def test_a_build_that_differs_is_refused(tmp_path):
    for name, data in (("a", b"1"), ("b", b"2")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "core.a").write_bytes(data)
    with pytest.raises(release().Refused, match=r"core\.a: two builds in different folders differ"):
        release().require_same([tmp_path / "a" / "core.a"], [tmp_path / "b" / "core.a"])


@pytest.mark.unhurried
def test_the_papers_name_what_is_installed():
    module = release()
    parts = module.components(ROOT)
    named = {part["name"]: part["version"] for part in parts}
    assert {"numpy", "scipy", "pyarrow", "pydantic", "eigen", "lcm"} <= set(named)
    for name, version in named.items():
        if name not in [beside[0] for beside in module.BESIDE]:
            assert version == metadata.version(name)
    document = json.loads(module.bill_of_materials("1.2.3", "c" * 40, parts))
    assert document["specVersion"] == "1.5" and len(document["components"]) == len(parts)
    assert document["dependencies"][0]["dependsOn"] == [part["bom-ref"] for part in parts]
    listed = module.licences(parts)
    assert listed.count("\n") == len(parts) + 1 and "MPL-2.0" in listed


@pytest.mark.slow("wheel and core archives are built twice")
@pytest.mark.long("four builds of the core")
def test_a_release_is_whole_and_its_wheel_replays_a_drive(checkout, tmp_path):
    version = release().release(checkout, tmp_path / "out", draft=True)
    out = tmp_path / "out"
    names = sorted(str(p.relative_to(out)) for p in out.rglob("*") if p.is_file())
    archive, wheel = f"lpvguard-{version}.tar.gz", f"lpvguard-{version}-py3-none-any.whl"
    cores = [f"core/liblpvguard_{name}.a" for name in ("g80", "truck")]
    assert names == sorted(
        ["LICENCES.txt", "SHA256SUMS", *cores, archive, wheel, "requirements.txt", "sbom.cdx.json"]
    )
    sums = dict(reversed(line.split("  ")) for line in (out / "SHA256SUMS").read_text().splitlines())
    assert sums.keys() == set(names) - {"SHA256SUMS"}
    assert all(hashlib.sha256((out / n).read_bytes()).hexdigest() == digest for n, digest in sums.items())
    with tarfile.open(out / archive) as packed:
        inside = {name.partition("/")[2] for name in packed.getnames()}
    assert {"lib/vehicles/g80/lpvguard_coeff.c", "tools/test", "LICENSE"} <= inside
    # The wheel alone, with this environment's packages: another folder's code must not be needed.
    place = tmp_path / "site"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--disable-pip-version-check"]
    subprocess.run([*pip, "--target", place, out / wheel], check=True)
    drive = table(tmp_path)
    done = subprocess.run(
        [sys.executable, "-m", "lpvguard.cli", "replay", "--vehicle", "g80", drive, "--json", "-"],
        cwd=tmp_path,
        env={"PATH": "/usr/bin:/bin", "PYTHONPATH": str(place), "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode in (0, 1) and json.loads(done.stdout), done.stderr
