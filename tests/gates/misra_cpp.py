"""What holds lib/src against MISRA C++:2023: the table of lib/MISRA_CPP.md, read row by row.

A row says by what its rule is checked: a warning of gcc or clang, a check of clang-tidy, or the absence of a
feature as a regular expression on the sources without their comments. Other rows are argued, deviations or
unchecked, and are counted. Nothing here says "compliant".
"""

import re
import subprocess
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from mutation_run import changed_files, may_concern

RULES = 179
CLANG_TIDY = "clang-tidy-19"
BY_TOOL = ("gcc", "clang", "tidy", "absent")
BY_WORD = ("argued", "deviation", "unchecked")
ROW = re.compile(
    r"^\| (?:Dir )?(\d+\.\d+\.\d+) \| (mandatory|required|advisory) \| (\w+) \| (.+) \|$", re.MULTILINE
)
CONCERNS_ALL = re.compile(
    r"lib/(?:src|include)/.*\.hp{0,2}$|lib/MISRA_CPP\.md$|tools/src/lpvguard/core/|tests/gates/misra_cpp\.py$"
)
"""Paths whose change concerns every source."""
COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
TIDY_FINDING = re.compile(r"^(\S+:\d+):\d+: (?:warning|error): (.+)$", re.MULTILINE)


@dataclass(frozen=True)
class Row:
    """A rule, its category, by what it is checked and the checks or the reason."""

    rule: str
    category: str
    by: str
    what: str

    @property
    def names(self) -> list[str]:
        """What stands in code marks: warnings, checks, or one regular expression."""
        return [name.replace("\\|", "|") for name in re.findall(r"`(.+?)`", self.what)]


def rows_of(table: Path) -> list[Row]:
    """The rows of lib/MISRA_CPP.md."""
    return [Row(*groups) for groups in ROW.findall(table.read_text())]


def units_of_change(tree: Path, units: list[Path]) -> list[Path]:
    """Of the sources ``units`` those of which a change can alter what a compiler says (`changed_files`): all,
    where it touches a header, what writes one, the table, this file, or git cannot say."""
    changed = changed_files(tree)
    if may_concern(changed, CONCERNS_ALL):
        return units
    return [unit for unit in units if str(unit.relative_to(tree)) in changed]


def misra_cpp_findings(tree: Path, vehicle: Path, full: bool, only: str = "") -> list[str]:
    """Findings on lib/src of ``tree``, or on its file ``only``, one sentence each. Compilers and clang-tidy
    are asked about all sources where ``full``, else about those of `units_of_change`.

    ``vehicle``: the generated folder that it is compiled for.
    """
    rows = rows_of(tree / "lib" / "MISRA_CPP.md")
    by = Counter(row.by for row in rows)
    print(", ".join(f"{by[kind]} {kind}" for kind in (*BY_TOOL, *BY_WORD)))
    findings = [f"MISRA_CPP.md: {len(rows)} rows, {RULES} wanted"] if len(rows) != RULES else []
    findings += [
        f"MISRA_CPP.md: {r} stands twice" for r, n in Counter(row.rule for row in rows).items() if n > 1
    ]
    findings += [
        f"MISRA_CPP.md: {row.rule} is checked by {row.by}, which nothing knows"
        for row in rows
        if row.by not in (*BY_TOOL, *BY_WORD)
    ]
    sources = sorted((tree / "lib" / "src").rglob(only or "*.[ch]pp"))
    findings += absent([row for row in rows if row.by == "absent"], sources)
    every = [path for path in sources if path.suffix == ".cpp"]
    units = every if full or only else units_of_change(tree, every)
    print(f"compilers and clang-tidy: {len(units)} of {len(every)} sources; LPVGUARD_FULL=1 asks all")
    eigen = subprocess.run(
        ["pkg-config", "--cflags-only-I", "eigen3"], stdout=subprocess.PIPE, text=True, check=True
    ).stdout.split()
    options = [
        "-std=c++17",
        *(f"-I{folder}" for folder in (tree / "lib" / "include", tree / "lib" / "src", vehicle)),
        *(word.replace("-I", "-isystem") for word in eigen),
    ]
    for kind, compiler in (("gcc", "g++"), ("clang", "clang++")):
        warnings = sorted({name for row in rows if row.by == kind for name in row.names})
        for unit in units:
            done = subprocess.run(
                [compiler, "-fsyntax-only", "-O2", "-Werror", *warnings, *options, str(unit)],
                stderr=subprocess.PIPE,
                text=True,
                check=False,
            )
            findings += [f"{unit.name} by {compiler}:\n{done.stderr}"] if done.returncode else []
    return findings + tidy(
        sorted({name for row in rows if row.by == "tidy" for name in row.names}), units, options
    )


def absent(rows: list[Row], sources: list[Path]) -> list[str]:
    """Rows whose feature is there after all."""
    texts = {path: COMMENT.sub("", path.read_text()) for path in sources}
    return [
        f"{path.name}: {match[0].strip()!r}, which MISRA_CPP.md {row.rule} says is absent"
        for row in rows
        for name in row.names
        for path, text in texts.items()
        if (match := re.search(name, text, re.MULTILINE))
    ]


def tidy(checks: list[str], units: list[Path], options: list[str]) -> list[str]:
    """What clang-tidy finds; a check that it does not know is a finding too."""
    chosen = f"--checks=-*,{','.join(checks)}"
    known = subprocess.run(
        [CLANG_TIDY, chosen, "--list-checks"], stdout=subprocess.PIPE, text=True, check=True
    ).stdout.split()
    findings = [f"MISRA_CPP.md: {CLANG_TIDY} knows no {check}" for check in checks if check not in known]
    if not units:
        return findings
    done = subprocess.run(
        [CLANG_TIDY, chosen, "--quiet", *map(str, units), "--", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        check=False,
    )
    return findings + [f"{Path(place).name}: {what}" for place, what in TIDY_FINDING.findall(done.stdout)]
