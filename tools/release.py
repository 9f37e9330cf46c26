"""Makes a release of a checkout's HEAD; `tools/release` is the command.

OUT receives, all or nothing:

    lpvguard-VERSION.tar.gz              what git archives: sources, the shipped vehicles' C, tests
    lpvguard-VERSION-py3-none-any.whl    the Python package, built from that archive
    requirements.txt                     what the wheel needs, pinned with hashes
    core/liblpvguard_VEHICLE.a           the core of each shipped vehicle, built from it in two folders
    sbom.cdx.json                        CycloneDX 1.5: what package, core and simulator need
    LICENCES.txt                         the licence of each
    SHA256SUMS                           of all of these

Times in archives are the commit's. A second build that differs in a byte is an error.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from importlib import metadata
from pathlib import Path
from uuid import NAMESPACE_URL, uuid5

ROOT = Path(__file__).resolve().parents[1]
NAMED = re.compile(r"^([A-Za-z0-9._-]+)")
BESIDE = (
    ("eigen", "libeigen3-dev", "MPL-2.0", "core: matrices of fixed size, headers only"),
    ("tomlplusplus", "libtomlplusplus-dev", "MIT", "simulator: scenario and vehicle files, headers only"),
    ("lcm", "liblcm-dev", "LGPL-2.1-or-later", "simulator: telemetry, where it is built with LCM"),
    ("catch2", "catch2", "BSL-1.0", "tests"),
)
"""Name, Debian package, SPDX licence and purpose of what is compiled in or linked."""


class Refused(Exception):
    """Nothing was written; the text says what is wrong, where, and what was expected."""


def run(*words: object, cwd: Path, **env: str) -> str:
    """Standard output of a command; Refused with its end where it fails."""
    done = subprocess.run(
        [str(w) for w in words],
        cwd=cwd,
        env={**os.environ, **env},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise Refused(f"{' '.join(map(str, words))}: status {done.returncode}\n{done.stderr[-2000:]}")
    return done.stdout


# --- what is released ---


def project_of(tree: Path) -> dict:
    """Table ``project`` of the package's pyproject.toml."""
    return tomllib.loads((tree / "tools/pyproject.toml").read_text())["project"]


VERSION = r"(\d+\.\d+\.\d+)"
STATED = {
    "tools/pyproject.toml": rf'^version = "{VERSION}"$',
    "tools/src/lpvguard/__init__.py": rf'^__version__ = "{VERSION}"$',
    "CITATION.cff": rf"^version: {VERSION}$",
    "CMakeLists.txt": rf"^project\(lpvguard VERSION {VERSION} ",
    "lib/conanfile.py": rf'^    version = "{VERSION}"',
    "lib/idf_component.yml": rf'^version: "{VERSION}"',
    "lib/library.json": rf'^ *"version": "{VERSION}"',
    "lib/vcpkg.json": rf'^ *"version": "{VERSION}"',
    "tools/examples/ros2/package.xml": rf"<version>{VERSION}</version>",
    "lib/INTEGRATION.md": rf"require `lpvguard/{VERSION}`",
    "tools/src/lpvguard/schemas/examples/manifest.json": rf'"tool": "lpvguard {VERSION}"',
}
"""File -> where it states the version. The first one is the source; `state` writes the others after it."""
MANIFEST = rf'"tool": "lpvguard {VERSION}"'
CHANGES = rf"^## {VERSION}"


def stating(tree: Path) -> dict[str, str]:
    """Every file that `state` writes -> where it states the version."""
    manifests = sorted((tree / "lib/vehicles").glob("*/MANIFEST.json"))
    return STATED | {str(path.relative_to(tree)): MANIFEST for path in manifests}


def stated_versions(tree: Path) -> dict[str, str]:
    """File -> the version that it states; the newest number of the changelog."""
    stated = {}
    for name, pattern in (stating(tree) | {"CHANGELOG.md": CHANGES}).items():
        said = re.search(pattern, (tree / name).read_text(encoding="utf-8"), re.MULTILINE)
        stated[name] = said[1] if said else "none"
    return stated


def state(tree: Path, version: str) -> None:
    """Writes ``version`` into every file that states one, and seals the manifests anew."""
    if not re.fullmatch(VERSION, version):
        raise Refused(f"--state: {version}, expected major.minor.patch")
    from lpvguard.base import artefacts

    for name, pattern in stating(tree).items():
        path = tree / name
        text = path.read_text(encoding="utf-8")
        said = re.search(pattern, text, re.MULTILINE)
        if said is None:
            raise Refused(f"{name}: states no version")
        text = text[: said.start(1)] + version + text[said.end(1) :]
        if path.name == artefacts.MANIFEST:
            text = artefacts.to_json(artefacts.sealed(json.loads(text)))
        path.write_text(text, encoding="utf-8")


def version_of(tree: Path, draft: bool) -> str:
    """The version on which all files agree. Refused where one does not, or where the tree is not HEAD's."""
    dirty = run("git", "status", "--porcelain", cwd=tree)
    if dirty:
        raise Refused(f"{tree}: not as committed, expected a clean checkout:\n{dirty}")
    stated = stated_versions(tree)
    version = stated["tools/pyproject.toml"]
    newest = re.search(r"^## (.+)$", (tree / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    if not draft and (newest is None or newest[1].split()[0] != version):
        said = newest[1] if newest else "nothing"
        raise Refused(f"CHANGELOG.md: its first section is {said}, expected {version} (--draft: as it is)")
    for name, said in stated.items():
        if said != version:
            raise Refused(f"{name}: states {said}, expected {version} as tools/pyproject.toml does")
    return version


# --- archives ---


def source_archive(tree: Path, version: str, target: Path) -> None:
    """What git archives of HEAD, compressed without a time of its own."""
    plain = subprocess.run(
        ["git", "archive", "--format=tar", f"--prefix=lpvguard-{version}/", "HEAD"],
        cwd=tree,
        stdout=subprocess.PIPE,
        check=True,
    ).stdout
    with target.open("wb") as raw, gzip.GzipFile("", "wb", 9, raw, mtime=0) as packed:
        packed.write(plain)


def unpacked(archive: Path, folder: Path) -> Path:
    """The one folder that a source archive holds, in ``folder``."""
    folder.mkdir(parents=True)
    run("tar", "--extract", "--file", archive, "--directory", folder, cwd=folder)
    (inside,) = folder.iterdir()
    return inside


def wheel(sources: Path, target: Path, epoch: str) -> Path:
    """The wheel of unpacked sources, in ``target``; ``epoch``: the time of its files."""
    pip = (sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check")
    alone = ("--no-deps", "--no-build-isolation", "--wheel-dir", target)
    run(*pip, *alone, sources / "tools", cwd=sources, SOURCE_DATE_EPOCH=epoch)
    (made,) = target.glob("*.whl")
    return made


def core_archives(sources: Path, target: Path) -> list[Path]:
    """liblpvguard_VEHICLE.a of every shipped vehicle, in ``target``."""
    with tempfile.TemporaryDirectory() as build:
        run("cmake", "-S", sources, "-B", build, "-G", "Ninja", "-DLPVG_BUILD_TESTS=OFF", cwd=sources)
        run("cmake", "--build", build, cwd=sources)
        target.mkdir()
        return [Path(shutil.copy2(made, target)) for made in sorted(Path(build).glob("liblpvguard_*.a"))]


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def require_same(once: list[Path], again: list[Path]) -> None:
    """Refused where two builds of the same sources differ."""
    for a, b in zip(once, again, strict=True):
        if (a.name, digest(a)) != (b.name, digest(b)):
            raise Refused(f"{a.name}: two builds in different folders differ, expected the same bytes")


# --- papers ---


def requirements(tree: Path) -> list[str]:
    """Names of the distributions that the package needs, and of those that they need. Extras are left out.
    Refused where one is not installed."""
    waiting = list(project_of(tree)["dependencies"])
    names: dict[str, str] = {}
    while waiting:
        wanted = waiting.pop()
        if "extra ==" in wanted:
            continue
        name, _, marker = wanted.partition(";")
        said = NAMED.match(name)
        assert said is not None
        key = re.sub(r"[-_.]+", "-", said[1]).lower()
        if key in names or _not_here(marker):
            continue
        try:
            names[key] = metadata.distribution(said[1]).metadata["Name"]
        except metadata.PackageNotFoundError:
            raise Refused(f"{said[1]}: not installed, expected what tools/pyproject.toml asks for") from None
        waiting += metadata.requires(said[1]) or []
    return [names[key] for key in sorted(names)]


def _not_here(marker: str) -> bool:
    """Whether a requirement's marker names another interpreter or system than this one."""
    from pip._vendor.packaging.markers import Marker

    return bool(marker.strip()) and not Marker(marker.strip()).evaluate()


def licence_of(name: str) -> str:
    """The licence that a distribution states: its expression, its classifiers, or its words' first line."""
    said = metadata.metadata(name)
    classifiers = [
        c.rsplit(" :: ", 1)[1] for c in said.get_all("Classifier") or [] if c.startswith("License :: ")
    ]
    own = [said[key].strip().partition("\n")[0] for key in ("License-Expression", "License") if key in said]
    return own[0] if "License-Expression" in said else ", ".join(classifiers) or (*own, "not stated")[0]


def installed_version(package: str) -> str:
    """Version of a Debian package here; empty where dpkg knows none."""
    done = subprocess.run(
        ["dpkg-query", "-W", "-f=${Version}", package], capture_output=True, text=True, check=False
    )
    return done.stdout.strip() if done.returncode == 0 else ""


def components(tree: Path) -> list[dict]:
    """CycloneDX components: Python distributions, then what is compiled in or linked."""
    listed = []
    for name in requirements(tree):
        version = metadata.version(name)
        listed.append(
            {
                "type": "library",
                "bom-ref": f"pkg:pypi/{name.lower()}@{version}",
                "name": name,
                "version": version,
                "purl": f"pkg:pypi/{name.lower()}@{version}",
                "licenses": [{"license": {"name": licence_of(name)}}],
                "description": "Python package",
            }
        )
    for name, package, licence, purpose in BESIDE:
        version = installed_version(package)
        listed.append(
            {
                "type": "library",
                "bom-ref": f"pkg:deb/debian/{package}@{version}",
                "name": name,
                "version": version or "not installed",
                "purl": f"pkg:deb/debian/{package}@{version}",
                "licenses": [{"license": {"id": licence}}],
                "description": purpose,
            }
        )
    return listed


def bill_of_materials(version: str, commit: str, parts: list[dict]) -> str:
    """CycloneDX 1.5 as JSON, without a time."""
    own = f"pkg:generic/lpvguard@{version}"
    document = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "serialNumber": f"urn:uuid:{uuid5(NAMESPACE_URL, own + commit)}",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": own,
                "name": "lpvguard",
                "version": version,
                "licenses": [{"license": {"id": "MIT"}}],
                "properties": [{"name": "commit", "value": commit}],
            }
        },
        "components": parts,
        "dependencies": [{"ref": own, "dependsOn": [part["bom-ref"] for part in parts]}],
    }
    return json.dumps(document, indent=1) + "\n"


def licences(parts: list[dict]) -> str:
    """A line a component: name, version, licence, purpose."""
    rows = [("lpvguard", "", "MIT", "LICENSE, NOTICE")]
    for part in parts:
        stated = part["licenses"][0]["license"]
        rows.append((part["name"], part["version"], stated.get("id") or stated["name"], part["description"]))
    widths = [max(len(row[i]) for row in rows) for i in range(4)]
    return "".join(
        "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() + "\n" for row in rows
    )


# --- the command ---


def release(tree: Path, out: Path, draft: bool) -> str:
    """Makes everything in ``out``; its version. Refused, and nothing written, where something is wrong."""
    version = version_of(tree, draft)
    if out.exists():
        raise Refused(f"{out}: is there, expected a folder that is not")
    commit = run("git", "rev-parse", "HEAD", cwd=tree).strip()
    epoch = run("git", "log", "-1", "--format=%ct", cwd=tree).strip()
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as folder:
        made, twice = Path(folder, "made"), [Path(folder, name) for name in ("one", "the-other")]
        made.mkdir()
        archive = made / f"lpvguard-{version}.tar.gz"
        print(f"source archive of {commit[:12]}", file=sys.stderr)
        source_archive(tree, version, archive)
        wheels, cores = [], []
        for place in twice:
            sources = unpacked(archive, place / "sources")
            print("wheel and core archives", file=sys.stderr)
            wheels.append(wheel(sources, place / "wheel", epoch))
            cores.append(core_archives(sources, place / "core"))
        require_same([wheels[0], *cores[0]], [wheels[1], *cores[1]])
        shutil.copy2(wheels[0], made)
        shutil.copytree(twice[0] / "core", made / "core")
        shutil.copy2(tree / "tools" / "locks" / "run.txt", made / "requirements.txt")
        parts = components(tree)
        (made / "sbom.cdx.json").write_text(bill_of_materials(version, commit, parts))
        (made / "LICENCES.txt").write_text(licences(parts))
        files = sorted(p for p in made.rglob("*") if p.is_file())
        sums = "".join(f"{digest(p)}  {p.relative_to(made)}\n" for p in files)
        (made / "SHA256SUMS").write_text(sums)
        made.rename(out)
    return version


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="tools/release", description=__doc__.splitlines()[0])
    parser.add_argument("--draft", action="store_true", help="the changelog may say Unreleased")
    parser.add_argument("--tag", action="store_true", help="set the annotated tag vVERSION besides")
    parser.add_argument("--state", metavar="VERSION", help="write VERSION into every file that states one")
    parser.add_argument("out", type=Path, nargs="?")
    options = parser.parse_args(argv)
    try:
        if options.state is not None:
            state(ROOT, options.state)
            return 0
        if options.out is None:
            parser.error("OUT is missing")
        if options.tag and options.draft:
            raise Refused("--tag: not with --draft, a tag is for good")
        version = release(ROOT, options.out.resolve(), options.draft)
        if options.tag:
            run("git", "tag", "-a", f"v{version}", "-m", f"lpvguard {version}", cwd=ROOT)
    except Refused as error:
        print(f"tools/release: {error}", file=sys.stderr)
        return 2
    print((options.out / "SHA256SUMS").read_text(), end="")
    print(f"lpvguard {version} in {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
