"""The table of features in CONTRIBUTING.md: every file of the project belongs to one feature.

python tests/tools/test_features.py         prints the table with the lines of code, tests and documents
"""

import re
import subprocess
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
GUIDE = ROOT / "CONTRIBUTING.md"
MARKS = ("<!-- features -->", "<!-- features: end -->")
KINDS = {"code": "tools/src/lpvguard", "tests": "tests/tools", "documents": ""}
"""Column of the table -> the folder that its paths lie in where there is such a path; else the root."""
OWNED = ("tools/src/lpvguard/", "lib/src/", "lib/include/", "lib/vehicles/", "firmware_sim/", "tests/")
"""Below these every file belongs to a feature."""
FOLDERS = ("lib", "firmware_sim", "tests", "tools", "data")
"""A path that begins with one of these is one from the root."""


@dataclass(frozen=True)
class Feature:
    """A row of the table; ``paths`` by kind, as patterns from the root."""

    name: str
    user: str
    task: str
    paths: dict[str, tuple[str, ...]]


def features(text: str) -> list[Feature]:
    """The rows of the table."""
    rows = text.partition(MARKS[0])[2].partition(MARKS[1])[0].strip().splitlines()[2:]
    features = []
    for row in rows:
        name, user, task, *cells = (cell.strip() for cell in row.strip("|").split("|"))
        paths = {}
        for (kind, folder), cell in zip(KINDS.items(), cells, strict=True):
            named = re.findall(r"`([^`]+)`", cell)
            from_root = [p.split("/")[0] in FOLDERS or not folder or p.endswith(".md") for p in named]
            paths[kind] = tuple(
                p if root else f"{folder}/{p}" for p, root in zip(named, from_root, strict=True)
            )
        features.append(Feature(name, user, task, paths))
    return features


def owner(file: str, kind: str, rows: list[Feature]) -> list[Feature]:
    """The features that name a file, or a folder of it, by the longest pattern: one where all is well."""
    matches = [
        (len(pattern), row)
        for row in rows
        for pattern in row.paths[kind]
        if file == pattern or file.startswith(f"{pattern}/") or fnmatch(file, pattern)
    ]
    longest = max((length for length, _ in matches), default=0)
    return [row for length, row in matches if length == longest]


def tracked() -> list[str]:
    """Files that git tracks."""
    done = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def kind_of(file: str) -> str:
    """Column in which a file counts."""
    if file.endswith(".md"):
        return "documents"
    return "tests" if file.startswith("tests/") else "code"


def faults(files: list[str], rows: list[Feature]) -> list[str]:
    """Files that belong to no feature or to several, and paths of the table that name nothing."""
    wrong = []
    for file in files:
        kind = kind_of(file)
        owners = owner(file, kind, rows)
        if len(owners) > 1 or (not owners and kind != "documents" and file.startswith(OWNED)):
            wrong.append(f"{file} belongs to {len(owners)} features")
    for row in rows:
        for kind, patterns in row.paths.items():
            for pattern in patterns:
                if not any(f == pattern or f.startswith(f"{pattern}/") or fnmatch(f, pattern) for f in files):
                    wrong.append(f"{row.name}: {kind} {pattern} names nothing")
    return wrong


def table(files: list[str], rows: list[Feature]) -> str:
    """The table with lines."""
    lines = {row.name: dict.fromkeys(KINDS, 0) for row in rows}
    for file in files:
        for row in owner(file, kind_of(file), rows)[:1]:
            content = b"" if file.endswith(".svg") else (ROOT / file).read_bytes()
            lines[row.name][kind_of(file)] += 0 if b"\0" in content else content.count(b"\n")
    total = {kind: sum(n[kind] for n in lines.values()) for kind in KINDS}
    head = ["| feature | who uses it | for what | code | tests | documents |", "|" + " --- |" * 6]
    body = [
        f"| {row.name} | {row.user} | {row.task} | "
        + " | ".join(str(n) for n in lines[row.name].values())
        + " |"
        for row in rows
    ]
    return "\n".join([*head, *body, "| **all** | | | " + " | ".join(str(n) for n in total.values()) + " |"])


@pytest.mark.unhurried
def test_every_file_belongs_to_one_feature():
    rows = features(GUIDE.read_text(encoding="utf-8"))
    assert len({row.name for row in rows}) == len(rows) > 20
    assert all(row.user and row.task for row in rows)
    assert faults(tracked(), rows) == []


def test_a_planted_file_without_a_feature_is_found():
    rows = [Feature("a", "u", "t", {"code": ("tools/src/lpvguard/a",), "tests": (), "documents": ()})]
    files = ["tools/src/lpvguard/a/x.py", "tools/src/lpvguard/b.py"]
    assert faults(files, rows) == ["tools/src/lpvguard/b.py belongs to 0 features"]
    assert faults(files[:1], [*rows, *rows]) == ["tools/src/lpvguard/a/x.py belongs to 2 features"]
    assert faults([], rows) == ["a: code tools/src/lpvguard/a names nothing"]


if __name__ == "__main__":
    print(table(tracked(), features(GUIDE.read_text(encoding="utf-8"))))
