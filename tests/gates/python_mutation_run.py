"""Runs the mutants of the Python numerics (python_mutation.py) against the tests about them, and judges.

A kept library was considered. mutmut 3 writes the package again into a folder of its own and knows functions
only, not lines; cosmic-ray starts pytest anew for every mutant, which here is seconds of imports. Both change
files. Here a process that has collected the tests forks for each mutant (python_mutation_worker.py).
"""

import ast
import json
import os
import random
import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mutation import Change
from mutation_run import (
    NOTHING_TOUCHED,
    Mutant,
    Noted,
    changed_files,
    command,
    no_longer,
    noted,
    stands_in,
    table,
    table_of_lists,
    too_many,
)

PACKAGE = Path("tools", "src", "lpvguard")
TARGETS = (
    "drives/dft.py",
    "drives/frames.py",
    "engine/overbound/*.py",
    "engine/synthesis/*.py",
    "engine/validation/*.py",
    "identify/calibration.py",
    "identify/energy.py",
)
MEASURED = {
    "drives/dft.py": 64,
    "drives/frames.py": 373,
    "engine/overbound/bound.py": 118,
    "engine/overbound/certificate.py": 429,
    "engine/overbound/fit.py": 249,
    "engine/overbound/minimax.py": 567,
    "engine/overbound/noise.py": 56,
    "engine/overbound/weight.py": 294,
    "engine/synthesis/barrier.py": 398,
    "engine/synthesis/cases.py": 141,
    "engine/synthesis/central.py": 149,
    "engine/synthesis/constant_scalings.py": 432,
    "engine/synthesis/coordinates.py": 182,
    "engine/synthesis/direct_terms.py": 53,
    "engine/synthesis/errors.py": 0,
    "engine/synthesis/gamma_search.py": 393,
    "engine/synthesis/knot_search.py": 377,
    "engine/synthesis/least_level.py": 227,
    "engine/synthesis/limited_history.py": 153,
    "engine/synthesis/lpv_certificate.py": 797,
    "engine/synthesis/margins.py": 859,
    "engine/synthesis/partition.py": 213,
    "engine/synthesis/riccati.py": 534,
    "engine/synthesis/scheduling.py": 111,
    "engine/synthesis/singular.py": 121,
    "engine/synthesis/slow_delta.py": 163,
    "engine/synthesis/statespace.py": 453,
    "engine/synthesis/storage_grid.py": 86,
    "engine/synthesis/structure.py": 103,
    "engine/synthesis/table.py": 12,
    "engine/synthesis/varying.py": 346,
    "engine/synthesis/zeros.py": 183,
    "engine/validation/delta.py": 116,
    "engine/validation/lmi.py": 136,
    "engine/validation/local_search.py": 504,
    "engine/validation/problem.py": 115,
    "engine/validation/quadratic.py": 419,
    "engine/validation/relaxation.py": 433,
    "engine/validation/s1.py": 273,
    "engine/validation/s2.py": 393,
    "engine/validation/scaled_problem.py": 295,
    "engine/validation/well_posed.py": 97,
}
"""Files whose mutants have all run and are sorted, and how many those were: another number is a finding. The
gate leaves out a new file until it stands here, unless it is asked for by its name, and says so."""
ASKED = {
    "drives": ("drives/test_dft.py", "drives/test_frames.py"),
    "engine/overbound": ("engine/test_overbound_*.py", "engine/test_weights.py"),
    "engine/synthesis": ("engine/test_*.py",),
    "engine/validation": ("engine/test_validation_*.py",),
    "identify": (
        "identify/test_calibration.py",
        "identify/test_energy.py",
        "identify/test_energy_definition.py",
        "identify/test_groups.py",
    ),
}
"""Folder of a file -> the tests below tests/tools that are asked: those about it, because to note what a
whole room of costly tests reaches takes minutes; of synthesis all of the engine."""
SAMPLE = 20
"""Without LPVGUARD_FULL so many mutants are drawn of the files that a change touches, without those that
either list names."""
EQUIVALENT, OPEN = "python_equivalent_mutants.json", "python_open_mutants.json"


@dataclass(frozen=True)
class ListedSite:
    """What mutation_run.py reads of a site."""

    function: str
    line: int
    changes: tuple[Change, ...]


def target_files(tree: Path) -> list[str]:
    """Mutated files below the package, those with code."""
    package = tree / PACKAGE
    names = {p.relative_to(package).as_posix() for pattern in TARGETS for p in package.glob(pattern)}
    return sorted(name for name in names if not name.endswith("__init__.py"))


def folder_of(name: str) -> str:
    return name.rpartition("/")[0]


def touched(tree: Path, names: list[str]) -> list[str]:
    """The files that a change touches."""
    begin, changed = f"{PACKAGE.as_posix()}/", changed_files(tree) or set()
    return sorted(set(names) & {path.removeprefix(begin) for path in changed})


def asked_worker(tree: Path, scratch: Path, task: dict[str, Any]) -> list[list[Any]]:
    """Lines that python_mutation_worker.py answers; RuntimeError with what it says where it fails."""
    scratch.mkdir(parents=True, exist_ok=True)
    out = scratch / "answer.txt"
    out.unlink(missing_ok=True)
    words = {
        "package": str(tree / PACKAGE),
        "out": str(out),
        "scratch": str(scratch),
        "rootdir": str(tree / "tests"),
    }
    (scratch / "task.json").write_text(json.dumps(words | task))
    worker = Path(__file__).with_name("python_mutation_worker.py")
    command(
        sys.executable,
        worker,
        scratch / "task.json",
        cwd=tree / "tools",
        env={**os.environ, "PYTHONPATH": str(tree / "tools" / "src")},
    )
    return [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []


def mutants_of(
    tree: Path, scratch: Path, names: list[str]
) -> tuple[list[Mutant], dict[Mutant, tuple[int, int]]]:
    """Mutants of files in the order of their text, and which (site, change) each is."""
    mutants: list[Mutant] = []
    places = {}
    seen: dict[tuple[str, str, str], int] = {}
    sites: dict[str, int] = {}
    for name, function, line, texts in asked_worker(tree, scratch, {"files": names}):
        site = ListedSite(function, line, tuple(Change(*c) for c in texts))
        at = sites[name] = sites.get(name, -1) + 1
        for index, change in enumerate(site.changes):
            same = (name, function, str(change))
            seen[same] = seen.get(same, 0) + 1
            mutant = Mutant(len(mutants), name, site, index, seen[same])
            mutants.append(mutant)
            places[mutant] = (at, index)
    return mutants, places


def imported(test: Path) -> set[str]:
    """Dotted names of what a test file imports by ``from``, and of the modules that it takes that from."""
    modules = set()
    for node in ast.walk(ast.parse(test.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            modules |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return modules


def asked_about(tree: Path, folder: str, names: Iterable[str] = ()) -> list[Path]:
    """The tests about a folder, or those of them that import one of its files ``names`` themselves."""
    there = tree / "tests" / "tools"
    tests = sorted({path for asked in ASKED[folder] for path in there.glob(asked)})
    modules = {f"{PACKAGE.name}.{name.removesuffix('.py').replace('/', '.')}" for name in names}
    return [test for test in tests if not modules or modules & imported(test)]


def surviving(
    tree: Path,
    scratch: Path,
    mutants: list[Mutant],
    places: dict[Mutant, tuple[int, int]],
    near: bool = False,
) -> list[Mutant]:
    """``near``: file by file, of the tests about its folder only those that import it themselves. Among all
    of them the time that one mutant may take leaves some out, and to note what they reach takes minutes."""
    alive: set[tuple[str, int, int]] = set()
    together: dict[str, dict[str, list[tuple[int, int]]]] = {}
    for mutant in sorted(mutants, key=lambda m: m.file):
        group = together.setdefault(mutant.file if near else folder_of(mutant.file), {})
        group.setdefault(mutant.file, []).append(places[mutant])
    for files in together.values():
        folder = folder_of(next(iter(files)))
        tests = [str(path) for path in asked_about(tree, folder, files if near else ())]
        if not tests:
            alive |= {(name, *place) for name, there in files.items() for place in there}
            continue
        fates = asked_worker(tree, scratch, {"files": files, "tests": tests, "traced": target_files(tree)})
        alive |= {(name, site, index) for name, site, index, survives, _ in fates if survives}
    return [m for m in mutants if (m.file, *places[m]) in alive]


def judged(
    mutants: list[Mutant], survived: list[Mutant], equivalent: Noted, known: Noted, all_of: set[str]
) -> list[str]:
    """Findings: survivors that neither file names, and arguments that a test refutes."""
    findings = [
        f"survived: {m}" for m in survived if not stands_in(m, equivalent) and not stands_in(m, known)
    ]
    return findings + [f"{EQUIVALENT}: {what}" for what in no_longer(mutants, survived, equivalent, all_of)]


def changed_since(mutants: list[Mutant], measured: Mapping[str, int]) -> list[str]:
    """Findings: measured files that have another number of mutants; ``mutants``: all of one file or more."""
    now = Counter(m.file for m in mutants)
    return [
        f"{name}: {now[name]} mutants, and {measured[name]} when all had run: run all again"
        for name in sorted(now.keys() & measured.keys())
        if now[name] != measured[name]
    ]


def python_listed_table(tree: Path, scratch: Path) -> list[str]:
    """`table_of_lists` of all mutants of the measured files."""
    mutants, _ = mutants_of(tree, scratch, sorted(MEASURED))
    return table_of_lists(mutants, noted(tree, EQUIVALENT), noted(tree, OPEN))


def python_mutation_findings(
    tree: Path,
    scratch: Path,
    full: bool,
    only: str,
    sample: int = SAMPLE,
    measured: Mapping[str, int] = MEASURED,
) -> list[str]:
    """Findings on the mutants of the Python numerics: of all measured files where ``full``, of ``only`` one
    file, or of ``sample`` drawn ones. ``measured``: files and their numbers, as `MEASURED`."""
    every = target_files(tree)
    names = [name for name in every if name in measured]
    files = [only] if only else names if full else touched(tree, names)
    if not files:
        print(NOTHING_TOUCHED)
        return []
    equivalent, known = noted(tree, EQUIVALENT), noted(tree, OPEN)
    all_of = set(files) if full or only else set()
    try:
        mutants, places = mutants_of(tree, scratch, files)
        changed = changed_since(mutants, measured)
        if not all_of:
            listed = [m for m in mutants if stands_in(m, equivalent) or stands_in(m, known)]
            print(f"{', '.join(files)}: {len(mutants)} mutants, {len(listed)} of them listed, {sample} drawn")
            rest = [m for m in mutants if m not in set(listed)]
            mutants = sorted(random.Random(6).sample(rest, min(sample, len(rest))), key=lambda m: m.number)
        left = surviving(tree, scratch, mutants, places, near=True)
        survived = surviving(tree, scratch, left, places)
    except RuntimeError as error:
        return [str(error)]
    for mutant in survived:
        if stands_in(mutant, known):
            print(f"open: {mutant}")
    for what in no_longer(mutants, survived, known, all_of):
        print(f"{OPEN}: {what}")
    print("\n".join(table(mutants, survived, equivalent, known)))
    if left_out := sorted(set(every) - set(measured) - {only}):
        print(f"not measured: {', '.join(left_out)}")
    findings = changed + judged(mutants, survived, equivalent, known, all_of)
    return findings + (too_many(mutants, survived, equivalent) if full and not only else [])
