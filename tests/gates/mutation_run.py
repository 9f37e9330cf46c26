"""Runs all mutants of lib/src against the unit tests, in one build (mutation.py makes them).

The build is a copy of the tree whose sources are switched. Each test program runs once without a mutant and
notes for every test case which sites it reaches. A mutant then costs the test cases that reach its site, the
cheapest first, up to the first that fails. Cases that reach very many sites are asked about those files only
that their program is about. Cases tagged ``[hour]``, which simulate one, are not asked. So a mutant costs
seconds at most, and one that survives has escaped every test that looks at its file.

A mutant counts as killed when a program fails, when the compiler's checks of undefined behaviour end it (the
gate ``sanitize`` runs the same programs under them), or when it reaches ten times as many sites as it should:
a loop that does not end.
"""

import hashlib
import json
import os
import pickle
import random
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from mutation import Change, Site, Sites, merged, numbered, read, sites_of, switched

CLANG = "19"
SEEN_BY = {"hand_truck", "toy", "separate_toy"}
"""Vehicles whose compilations show every line of lib/src."""
CHECKS = "bounds,shift,integer-divide-by-zero,null,signed-integer-overflow,float-cast-overflow,bool,alignment"
FLAGS = f"-w -O1 -Wno-c++11-narrowing -Wno-invalid-constexpr -fsanitize={CHECKS} -fsanitize-trap={CHECKS}"
PER_FILE = 8192
"""Numbers of a file, so that a change of one file leaves the others' objects as they are."""
PROGRAMS = ("unit_tests", "test_can_faults", "test_ecu_random")
PARTS = ("lib", "firmware_sim", "tests", "tools/src", "data")
GENEROUS = 10
TURNS = (100_000, 1_000_000, 10_000_000)
LONG_SITES = 400_000_000
"""Cases that reach no more sites than the first number of TURNS are asked first, then those up to the next,
and at last the others; those that reach more than LONG_SITES are long."""
ABOUT: dict[str, tuple[str, ...]] = {
    "ecu.cpp": ("test_ecu_random",),  # the other long cases are minutes of driving
    "crc32.hpp": ("test_coeff_",),
    "coefficient_checks.hpp": ("test_coeff_",),
    "control_checks.hpp": ("test_controller_",),
    "diagnosis_checks.hpp": ("test_diagnosis_",),
    "isolation_checks.hpp": ("test_isolation_",),
}
"""File -> how the names of its own programs begin: they are asked first, and they alone about long cases.
Else test_ and the file's name."""
TOUCHED = 600
"""Without LPVGUARD_FULL so many mutants at most, of the files that a change touches, without those that
either list names."""
NOTHING_TOUCHED = "skipped: no mutated source is known to have changed; LPVGUARD_FULL=1 asks all mutants"
MOST_EQUIVALENT = 0.05
SHORT_FORM = {k: v for k, v in os.environ.items() if k != "LPVGUARD_FULL"}


@dataclass(frozen=True)
class Mutant:
    """Number ``number`` of the switch: change ``index`` of a site."""

    number: int
    file: str
    site: Site
    index: int
    ordinal: int  # of those in the function that read the same, from 1

    @property
    def change(self) -> Change:
        return self.site.changes[self.index]

    @property
    def key(self) -> str:
        return f"{self.change}" + (f"  #{self.ordinal}" if self.ordinal > 1 else "")

    def __str__(self) -> str:
        return f"{self.file}:{self.site.line}: {self.site.function}: {self.key}"


@dataclass(frozen=True)
class Case:
    """A test case of a program without a mutant."""

    program: Path
    name: str
    seconds: float
    reached: int


def command(*words: object, cwd: Path | None = None, env: dict[str, str] | None = None) -> str:
    """Output of a command; RuntimeError with it where the command fails."""
    done = subprocess.run(
        [str(w) for w in words],
        cwd=cwd,
        env=env,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(str(w) for w in words)}:\n{done.stdout[-8000:]}")
    return done.stdout


# --- which files ---


def changed_files(tree: Path) -> set[str] | None:
    """Paths that differ from the merge base with the main branch, or, where HEAD is that, from the commit
    before it; None where git cannot say."""
    try:
        head, base = (
            command("git", *words, cwd=tree).strip()
            for words in (("rev-parse", "HEAD"), ("merge-base", "HEAD", "main"))
        )
        names = command("git", "diff", "--name-only", "HEAD^" if head == base else base, cwd=tree)
    except (RuntimeError, FileNotFoundError):
        return None
    return set(names.split())


def may_concern(changed: set[str] | None, paths: re.Pattern[str]) -> bool:
    """Whether one of `changed_files` is among ``paths``; where git cannot say, it may be."""
    return changed is None or any(paths.match(path) for path in changed)


def chosen(tree: Path, names: list[str], full: bool, only: str) -> tuple[list[str], int]:
    """Files to mutate, and how many of their mutants (0: all)."""
    if only or full:
        return ([only] if only else names), 0
    changed = changed_files(tree) or set()
    return sorted(set(names) & {Path(p).name for p in changed if p.startswith("lib/src/")}), TOUCHED


# --- the build ---


def mirror(tree: Path, work: Path, texts: dict[Path, str]) -> None:
    """Makes ``work`` a copy of the tree in which ``texts`` stand for some files; what is right stays as it
    is, so that nothing is compiled twice."""
    wanted: set[Path] = set()
    files = [
        p for part in PARTS for p in (tree / part).rglob("*") if p.is_file() and "__pycache__" not in p.parts
    ]
    files += [p for p in tree.iterdir() if p.is_file() and not p.name.startswith(".")]
    for file in files:
        name = file.relative_to(tree)
        target = work / name
        wanted.add(name)
        new = texts[name].encode("latin-1") if name in texts else file.read_bytes()
        if not target.exists() or target.read_bytes() != new:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(new)
            shutil.copymode(file, target)
    for stale in [p for p in work.rglob("*") if p.is_file() and p.relative_to(work) not in wanted]:
        if "__pycache__" not in stale.parts:
            stale.unlink()


def configure(work: Path, build: Path) -> None:
    """A folder that was configured with other settings is made anew: CMake forgets settings there where the
    compiler is another."""
    flags = f"{FLAGS} -include {work / 'tests' / 'gates' / 'mutant_switch.h'}"
    words = [
        "cmake",
        "-S",
        work,
        "-B",
        build,
        "-G",
        "Ninja",
        "-DCMAKE_BUILD_TYPE=Debug",
        "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON",
        "-DLPVG_BUILD_SIM=OFF",
        f"-DCMAKE_C_COMPILER=clang-{CLANG}",
        f"-DCMAKE_CXX_COMPILER=clang++-{CLANG}",
        f"-DCMAKE_C_FLAGS_DEBUG={flags}",
        f"-DCMAKE_CXX_FLAGS_DEBUG={flags}",
        f"-DPython3_EXECUTABLE={sys.executable}",
    ]
    settings = build / "settings"
    said = " ".join(map(str, words))
    if not settings.is_file() or settings.read_text() != said:
        shutil.rmtree(build, ignore_errors=True)
    command(*words)
    settings.write_text(said)


def with_switch(tree: Path) -> dict[Path, str]:
    """main() of the test programs, with the switch."""
    main = Path("tests", "unit", "catch_main.cpp")
    return {main: read(tree / main) + '\n#include "../gates/mutant_switch.cpp"\n'}


def core_files(tree: Path) -> list[Path]:
    """Files of lib/src; no two have one name."""
    return sorted((tree / "lib" / "src").rglob("*.[ch]pp"))


def includers(tree: Path, name: str) -> set[str]:
    """Sources of lib/src that see a file of it."""
    texts = {p.name: read(p) for p in core_files(tree)}
    seen = {name}
    while more := {n for n, t in texts.items() if any(re.search(rf'["/]{s}"', t) for s in seen)} - seen:
        seen |= more
    return {n for n in seen if n.endswith(".cpp")}


def find_sites(tree: Path, work: Path, build: Path, files: Iterable[str]) -> dict[str, Sites]:
    """Sites by file, of all compilations that see it; those of an unchanged source are kept in ``build``."""
    paths = {str(p): p.name for p in core_files(tree)}
    texts = {path: read(Path(path)) for path in paths}
    wanted = set().union(*(includers(tree, name) for name in files))
    several: dict[str, list[Sites]] = {name: [] for name in files}
    for entry in json.loads((build / "compile_commands.json").read_text()):
        words = shlex.split(entry["command"].replace(str(work), str(tree)))
        library = re.search(r"lpvguard_(\w+)\.dir", words[words.index("-o") + 1])
        if Path(words[-1]).name not in wanted or library is None or library[1] not in SEEN_BY:
            continue
        # Without the header that is compiled ahead: it is the copy's.
        ahead = {i + k for i, word in enumerate(words) if word == "-Xclang" for k in (0, 1)}
        words = [word for i, word in enumerate(words) if i not in ahead]
        words = [*words[: words.index("-o")], words[-1]]
        for path, sites in dumped(words, build, texts).items():
            if paths[path] in several:
                several[paths[path]].append(sites)
    return {name: merged(several_sites) for name, several_sites in several.items()}


def dumped(words: list[str], build: Path, texts: dict[str, str]) -> dict[str, Sites]:
    """Sites that one compilation shows."""
    seen = command(*words, "-E", cwd=build)
    here = Path(__file__).parent
    code = (here / "mutation.py").read_bytes()
    kept = build / "sites" / hashlib.sha256(seen.encode() + code).hexdigest()
    if not kept.exists():
        filters = ("lpvg", "(anonymous namespace)")
        dump_json = ("-fsyntax-only", "-Xclang", "-ast-dump=json")
        dump = "".join(
            command(*words, *dump_json, "-Xclang", f"-ast-dump-filter={what}", cwd=build) for what in filters
        )
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_bytes(pickle.dumps(sites_of(dump, texts)))
    sites: dict[str, Sites] = pickle.loads(kept.read_bytes())
    return sites


def mutants_of(file: str, sites: Sites, first: int) -> list[Mutant]:
    mutants: list[Mutant] = []
    seen: dict[tuple[str, str], int] = {}
    for number, site in numbered(sites, first):
        for index, change in enumerate(site.changes):
            same = (site.function, str(change))
            seen[same] = seen.get(same, 0) + 1
            mutants.append(Mutant(number + index, file, site, index, seen[same]))
    return mutants


# --- running ---


def run_program(program: Path, *which: str, **settings: object) -> int:
    """Exit status of a program without LPVGUARD_FULL, up to the first case that fails."""
    words = [str(program), "--abort", *which]
    return subprocess.run(
        words,
        env={**SHORT_FORM, **{k: str(v) for k, v in settings.items()}},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=False,
    ).returncode


def listed(cases: Iterable[Case]) -> str:
    """Names of cases as Catch2's --input-file takes them: a comma would end one."""
    return "".join(re.sub(r"([\\,\[])", r"\\\1", case.name) + "\n" for case in cases)


def reached_by(programs: list[Path], scratch: Path) -> dict[int, list[Case]]:
    """Number of a site -> test cases that reach it; RuntimeError where a program fails without a mutant."""
    cases_by_number: dict[int, list[Case]] = {}

    def run(program: Path) -> Path:
        note = scratch / f"{program.name}.reached"
        note.unlink(missing_ok=True)
        if run_program(program, "~[hour]", LPVGUARD_REACHED=note):
            raise RuntimeError(f"{program.name}: fails before anything is changed")
        return note

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for program, note in zip(programs, pool.map(run, programs), strict=True):
            cases: list[Case] = []
            for line in note.read_text().splitlines():
                seconds, reached, name, *numbers = line.split("\t")
                case = Case(program, name, float(seconds), int(reached))
                cases.append(case)
                for number in numbers:
                    cases_by_number.setdefault(int(number), []).append(case)
            note.write_text(listed(cases))
            words = [str(program), "--list-test-names-only", "--input-file", str(note)]
            chosen = subprocess.run(
                words, text=True, stdout=subprocess.PIPE, check=False
            ).stdout  # exits with their number
            if set(chosen.splitlines()) != {case.name for case in cases}:
                raise RuntimeError(f"{program.name}: its test cases cannot be chosen by their names")
    return cases_by_number


def is_own(program: Path, file: str) -> bool:
    """Whether a test program is about a file."""
    return program.name.startswith(ABOUT.get(file, (f"test_{Path(file).stem}",)))


def asked(file: str, cases: list[Case]) -> list[Case]:
    """The cases that are asked about a file: of the long ones only those of its own programs, each with one
    vehicle."""
    long: dict[str, Case] = {}
    for case in sorted(cases, key=lambda c: (c.reached, c.program.name)):
        if case.reached > LONG_SITES and is_own(case.program, file):
            long.setdefault(case.name, case)
    return [c for c in cases if c.reached <= LONG_SITES] + list(long.values())


def turns(file: str, cases: list[Case]) -> list[list[Case]]:
    """Cases in the order in which they run, one program each: the cheap ones of every program first, the
    file's own programs before the others. A program runs its cases in an order of its own."""
    by_turn: dict[tuple[int, bool, Path], list[Case]] = {}
    for case in cases:
        cost = sum(case.reached > most for most in TURNS)
        by_turn.setdefault((cost, not is_own(case.program, file), case.program), []).append(case)
    return [by_turn[turn] for turn in sorted(by_turn)]


def survives(mutant: Mutant, groups: list[list[Case]], scratch: Path) -> bool:
    """Whether no group of test cases notices the mutant."""
    note = scratch / f"{mutant.number}.cases"
    for group in groups:
        note.write_text(listed(group))
        status = run_program(
            group[0].program,
            "--input-file",
            str(note),
            LPVGUARD_MUTANT=mutant.number,
            LPVGUARD_SITES_MAX=GENEROUS * sum(c.reached for c in group) + 1_000_000,
            LPVGUARD_CPU_S=int(GENEROUS * sum(c.seconds for c in group)) + 20,
        )
        if status:
            break
    else:
        status = 0
    note.unlink(missing_ok=True)
    return status == 0


def surviving(mutants: list[Mutant], cases_by_number: dict[int, list[Case]], scratch: Path) -> list[Mutant]:
    def run(mutant: Mutant) -> bool:
        cases = asked(mutant.file, cases_by_number.get(mutant.number - mutant.index, []))
        return survives(mutant, turns(mutant.file, cases), scratch)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        fates = list(pool.map(run, mutants))
    return [m for m, alive in zip(mutants, fates, strict=True) if alive]


# --- the verdict ---

Noted = dict[str, dict[str, dict[str, str]]]
"""File -> function -> mutant -> why no test notices it."""
EQUIVALENT, OPEN = "equivalent_mutants.json", "open_mutants.json"
"""Mutants that no test can notice, and those that none notices yet."""


def noted(tree: Path, name: str) -> Noted:
    notes: Noted = json.loads((tree / "tests" / "gates" / name).read_text())
    return notes


def stands_in(mutant: Mutant, notes: Noted) -> bool:
    return mutant.key in notes.get(mutant.file, {}).get(mutant.site.function, {})


def table(mutants: list[Mutant], survived: list[Mutant], equivalent: Noted, known: Noted) -> list[str]:
    """Lines of the table by file, and its sum, as gates/MUTANTS.md has it; ``open``: survived, and ``known``
    to do so. ``survived``: what neither list names."""
    rows = [
        "| file | mutants | killed | equivalent | open | survived |",
        "| --- | --: | --: | --: | --: | --: |",
    ]
    for name in [*dict.fromkeys(m.file for m in mutants), ""]:
        mine = [m for m in mutants if not name or m.file == name]
        alive = [m for m in survived if not name or m.file == name]
        equal = sum(stands_in(m, equivalent) for m in alive)
        still = sum(stands_in(m, known) for m in alive)
        counts = (len(mine), len(mine) - len(alive), equal, still, len(alive) - equal - still)
        rows.append(f"| {name or '**all**'} | {' | '.join(map(str, counts))} |")
    return rows


def no_longer(mutants: list[Mutant], survived: list[Mutant], notes: Noted, all_of: set[str]) -> list[str]:
    """What notes name and does not survive; ``all_of``: files of which every mutant ran."""
    alive = {(m.file, m.site.function, m.key) for m in survived}
    ran = {(m.file, m.site.function, m.key) for m in mutants}
    findings = []
    for file, functions in notes.items():
        for function, reasons in functions.items():
            for key in reasons:
                place = (file, function, key)
                if place not in alive and (place in ran or file in all_of):
                    why = "is killed" if place in ran else "is no mutant"
                    findings.append(f"{file}: {function}: {key}: {why}: take it out")
    return findings


def judged(
    mutants: list[Mutant], survived: list[Mutant], equivalent: Noted, known: Noted, all_of: set[str]
) -> list[str]:
    """Findings: survivors that neither file names, and arguments that a test refutes."""
    findings = [
        f"survived: {m}" for m in survived if not stands_in(m, equivalent) and not stands_in(m, known)
    ]
    findings += [f"{EQUIVALENT}: {what}" for what in no_longer(mutants, survived, equivalent, all_of)]
    return findings


def too_many(mutants: list[Mutant], survived: list[Mutant], equivalent: Noted) -> list[str]:
    """A finding where more than a twentieth is argued away."""
    equal = sum(stands_in(m, equivalent) for m in survived)
    return [f"{equal} of {len(mutants)} mutants are argued equivalent: more than 5 %"] * (
        equal > MOST_EQUIVALENT * len(mutants)
    )


def table_of_lists(mutants: list[Mutant], equivalent: Noted, known: Noted) -> list[str]:
    """The table of ``mutants`` as the two lists have it, without a run.

    What is not listed counts as killed, which LPVGUARD_FULL=1 holds against the tests.
    """
    listed = [m for m in mutants if stands_in(m, equivalent) or stands_in(m, known)]
    return table(mutants, listed, equivalent, known)


def listed_table(tree: Path, scratch: Path, names: list[str]) -> list[str]:
    """`table_of_lists` of all mutants of the files ``names`` of lib/src."""
    work, build = scratch / "mutated", scratch / "build"
    mirror(tree, work, with_switch(tree))
    configure(work, build)
    sites = find_sites(tree, work, build, names)
    mutants = [m for name in names for m in mutants_of(name, sites[name], 0)]
    return table_of_lists(mutants, noted(tree, EQUIVALENT), noted(tree, OPEN))


def mutation_findings(tree: Path, scratch: Path, names: list[str], full: bool, only: str) -> list[str]:
    """Findings on the mutants of the files ``names`` of lib/src: of all of them where ``full``, of ``only``
    one, or of those that a change touches."""
    work, build = scratch / "mutated", scratch / "build"
    files, sample = chosen(tree, names, full, only)
    if not files:
        print(NOTHING_TOUCHED)
        return []
    main = with_switch(tree)
    try:
        mirror(tree, work, main)
        configure(work, build)
        sites = find_sites(tree, work, build, files)
        first = {name: PER_FILE * i for i, name in enumerate(names)}
        texts = {
            p.relative_to(tree): switched(read(p), sites[p.name], first[p.name])
            for p in core_files(tree)
            if p.name in files
        }
        mirror(tree, work, main | texts)
        command("cmake", "--build", build, "--target", *PROGRAMS)
        programs = sorted(p for p in build.rglob("test_*") if p.is_file() and os.access(p, os.X_OK))
        cases_by_number = reached_by(programs, scratch)
    except RuntimeError as error:
        return [str(error)]
    mutants = [m for n in files for m in mutants_of(n, sites[n], first[n])]
    equivalent, known = noted(tree, EQUIVALENT), noted(tree, OPEN)
    all_of = set() if sample else set(files)
    if sample:
        # What survives costs most: what is listed is run in full only.
        listed = sum(stands_in(m, equivalent) or stands_in(m, known) for m in mutants)
        mutants = [m for m in mutants if not stands_in(m, equivalent) and not stands_in(m, known)]
        print(f"{len(mutants)} mutants, and {listed} listed ones, which LPVGUARD_FULL=1 runs")
        mutants = sorted(random.Random(6).sample(mutants, min(sample, len(mutants))), key=lambda m: m.number)
    survived = surviving(mutants, cases_by_number, scratch)
    for mutant in survived:
        if stands_in(mutant, known):
            print(f"open: {mutant}")
    for what in no_longer(mutants, survived, known, all_of):
        print(f"{OPEN}: {what}")
    print("\n".join(table(mutants, survived, equivalent, known)))
    print(f"{sum(stands_in(m, known) for m in survived)} open survivors, which no test notices yet")
    findings = judged(mutants, survived, equivalent, known, all_of)
    return findings + (too_many(mutants, survived, equivalent) if full and not only else [])
