"""The gate on references: whatever text, equation, requirement, file or symbol the repository names is in it.

Looked at in every text file of the tree, except this gate and its planted bugs:

    THEORY n.m, (Tn)      a section, an equation of the pages in lib/theory
    paper                 its equations (1) to (9), steps 1 to 8, sections I to VII, Tables I and II, Figs. 1
                          to 6
    REQ-...-n             a requirement of lib/REQUIREMENTS.md
    section n             of a work that is named with its year, or of a standard, within the words before
    *.md                  a file of the tree, or FOLDER/name.md, where the package writes "name.md" and the
                          tree has no such folder

and in Markdown, comments and docstrings besides:

    [text](link#anchor)   a file or folder, from the folder of the text, and a heading of it
    lib/..., tools/...    a file or folder of the tree
    name.py, path/name.h  a file of the tree whose path ends so, or one that a program of the tree writes:
                          "name.h" stands in a .py; NAME.lcm, DIR/name.h: capitals stand for what the user
                          chooses
    `path:symbol`         a file of the tree, and a function, class, method, constant or requirement's test in
                          it

Every equation of THEORY has one row in its table of places, with an implementation and a test.
"""

from __future__ import annotations

import ast
import io
import os
import re
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

SUFFIXES = {".py", ".md", ".h", ".hpp", ".c", ".cpp", ".S", ".ld", ".toml", ".cmake", ".txt", ".lcm", ".sh"}
PROGRAMS = {"tools/demo", "tools/docs", "tools/test", "tools/lpvguard", "tools/with-vcan"}
LEFT_OUT = {"build", "out", "__pycache__"}
PLANTED = {"tests/gates/gates.py", "tests/gates/references.py"}
THEORY = "lib/theory/"
NUMBER = re.compile(r"\d+")

SOURCE = r"(?:py|cpp|hpp|h|c|S|cmake|lcm)"
PLACE = re.compile(rf"`([\w./-]+\.{SOURCE}):([\w.-]+)`")
TREE_PATH = re.compile(
    r"(?<![\w/.$}{<>*~-])(?:\./)?((?:lib|tools|tests|firmware_sim|data)/[\w./-]*\w)(?![\w/<>{}*-]|\.\w)"
)
SOURCE_NAME = re.compile(rf"(?<![\w/.$}}{{<>*~-])((?:\w[\w-]*/)*\w[\w.-]*\.{SOURCE})(?![\w/({{<>-]|\.\w)")
TEXT_NAME = re.compile(r"(?<![\w/.*}>-])((?:[\w.-]+/)*[\w-]+\.md)\b(?!\()")
LINK = re.compile(r"\]\((?![a-z]+:)([^)#\s]*)(?:#([^)\s]*))?\)")

# Name of what is cited -> pattern whose groups hold it, and what exists.
PAPER = {
    "step": (re.compile(r"\b[Ss]teps? (\d+)(?:(?:-|–| to | and )(\d+))?\b"), {str(n) for n in range(1, 9)}),
    "figure": (
        re.compile(r"\bFigs?\. (\d+)(?:(?:,| and| to) (\d+))?(?:(?:,| and| to) (\d+))?"),
        {str(n) for n in range(1, 7)},
    ),
    "table": (re.compile(r"\bTable ([IVX]+)\b"), {"I", "II"}),
    "section": (re.compile(r"\b[Ss]ection ([IVX]+)\b"), {"I", "II", "III", "IV", "V", "VI", "VII"}),
    "equation": (
        re.compile(
            r"\b(?:[Pp]aper|side of|ball|Optimum of|Minimum of|J of|point of|satisfy|in)"
            r"\s+\((\d{1,2})\)(?: to \((\d{1,2})\))?"
        ),
        {str(n) for n in range(1, 10)},
    ),
}
WORK = re.compile(r"\b(?:19|20)\d\d\b|\b(?:ISO|SAE|IEC|MISRA|AUTOSAR)\b")


@dataclass
class Found:
    """References counted, and those that lead nowhere."""

    count: int = 0
    dangling: list[str] = field(default_factory=list)

    def see(self, good: bool, where: str, what: str) -> None:
        self.count += 1
        if not good:
            self.dangling.append(f"{where}: {what}")


def files_of(tree: Path) -> dict[str, Path]:
    """Every file of the tree by its path from the root, hidden and built ones left out."""
    out = {}
    for folder, folders, names in os.walk(tree):
        folders[:] = sorted(f for f in folders if f not in LEFT_OUT and not f.startswith("."))
        out |= {(Path(folder) / n).relative_to(tree).as_posix(): Path(folder) / n for n in sorted(names)}
    return out


@cache
def matches(pattern: re.Pattern[str], text: str) -> tuple[re.Match[str], ...]:
    """All of a pattern in a text, looked for once: the self-test reads the tree again for each bug."""
    return tuple(pattern.finditer(text))


@cache
def statements(text: str) -> list[ast.stmt]:
    """Statements of a Python source."""
    return ast.parse(text).body


@cache
def unwrapped(text: str) -> str:
    """``text`` in one line of the same length, without what a comment's lines begin with."""
    return re.sub(r"\n[ \t]*(?:///?<?|#+|\*)?[ \t]*", lambda m: " " * len(m[0]), text)


@cache
def prose(path: Path, text: str) -> str:
    """What people read of a file, all else blanked: Markdown whole; comments and docstrings of sources."""
    if path.suffix == ".md":
        return text
    spans = (
        list(_python_prose(text))
        if path.suffix == ".py"
        else [
            m.span()
            for m in re.finditer(
                r"//[^\n]*|/\*.*?\*/"
                if path.suffix in (".h", ".hpp", ".c", ".cpp", ".lcm")
                else r"(?:^|(?<=\s))#(?!include|define|if|endif|else|undef|error|pragma)[^\n]*",
                text,
                re.DOTALL,
            )
        ]
    )
    out = [c if c == "\n" else " " for c in text]
    for start, end in spans:
        out[start:end] = text[start:end]
    return "".join(out)


def _python_prose(text: str) -> Iterator[tuple[int, int]]:
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    before, depth = tokenize.NEWLINE, 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        statement = depth == 0 and before in (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
        if token.type == tokenize.COMMENT or (token.type == tokenize.STRING and statement):
            yield tuple(starts[row - 1] + column for row, column in (token.start, token.end))
        depth += (token.string in "([{") - (token.string in ")]}") if token.type == tokenize.OP else 0
        before = before if token.type in (tokenize.NL, tokenize.COMMENT) else token.type


def defines(path: Path, symbol: str) -> bool:
    """Whether a source defines ``symbol``; ``REQ-...``: whether a test in it verifies that requirement."""
    text = path.read_text(encoding="utf-8")
    if symbol.startswith("REQ-"):
        return f"[{symbol}]" in text or f'requirement("{symbol}")' in text
    if path.suffix == ".py":
        body = statements(text)
        for name in symbol.split("."):
            inner = [n for n in body if name in _names(n)]
            if not inner:
                return False
            body = getattr(inner[0], "body", [])
        return True
    name = re.escape(symbol)
    return (
        re.search(
            rf"^[^\n=;/]*\b(?:class|struct|enum)\s+{name}\b"
            rf"|^(?!\s*(?:return|//))[^\n=;]*[\w>&*]\s*[ *&](?:\w+::)?{name}\s*\(",
            text,
            re.MULTILINE,
        )
        is not None
    )


def _names(node: ast.stmt) -> set[str]:
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        return {node.name}
    targets = (
        node.targets
        if isinstance(node, ast.Assign)
        else [node.target]
        if isinstance(node, ast.AnnAssign)
        else []
    )
    return {t.id for t in targets if isinstance(t, ast.Name)}


@cache
def anchors(text: str) -> frozenset[str]:
    """Anchors of a Markdown text's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return frozenset(re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings)


@dataclass(frozen=True)
class Theory:
    """Sections and equations of the theory that may be cited, and its text in the order of their numbers."""

    sections: list[str]
    equations: list[str]
    works: list[str]
    text: str

    @classmethod
    def read(cls, files: dict[str, Path]) -> Theory:
        names = [name for name in files if name.startswith(THEORY)]
        names.sort(key=lambda name: [int(n) for n in NUMBER.findall(name)])
        text = "\n".join(files[name].read_text(encoding="utf-8") for name in names)
        return cls(
            re.findall(r"^#+ (\d+(?:\.\d+)?)\.? ", text, re.MULTILINE),
            re.findall(r"\\tag\{T(\d+)\}", text),
            re.findall(r"^(\d+)\. .*$", text.partition("# 12. References")[2], re.MULTILINE),
            text,
        )

    def check(self, findings: Found) -> None:
        """Numbers run on, each equation has its row (where implemented, where tested), and the works cited
        are those listed."""
        for what, numbers in (
            ("section", list(dict.fromkeys(s.partition(".")[0] for s in self.sections))),
            ("equation", self.equations),
            ("work", self.works),
        ):
            findings.see(
                numbers == [str(n + 1) for n in range(len(numbers))],
                THEORY,
                f"{what}s are numbered {', '.join(numbers)}",
            )
        rows = re.findall(r"^\| \(T(\d+)\) \|([^|]*)\|([^|]*)\|$", self.text, re.MULTILINE)
        for number in self.equations:
            row = [r for r in rows if r[0] == number]
            findings.see(
                len(row) == 1 and all(PLACE.search(column) for column in row[0][1:]),
                THEORY,
                f"(T{number}) has no row that says where it is implemented and where tested",
            )
        cited = {
            n for group in re.findall(r"\[(\d+(?:, \d+)*)\](?!\()", self.text) for n in group.split(", ")
        }
        for number in sorted(cited | set(self.works), key=int):
            findings.see(
                number in cited and number in self.works,
                THEORY,
                f"work [{number}] is {'not cited' if number in self.works else 'not listed'}",
            )


def references(tree: Path, scratch: Path) -> list[str]:
    """The gate: prints how many references there are, returns those that lead nowhere."""
    files, findings = files_of(tree), Found()
    folders = {p.as_posix() for f in files for p in Path(f).parents}
    theory = Theory.read(files)
    theory.check(findings)
    stated = set(
        re.findall(
            r"^\| (REQ-[A-Z][A-Z0-9]*-\d+) \|",
            files["lib/REQUIREMENTS.md"].read_text(encoding="utf-8"),
            re.MULTILINE,
        )
    )
    endings = {"/".join(f.split("/")[i:]) for f in files for i in range(f.count("/") + 1)}
    endings |= {
        made
        for f, p in files.items()
        if p.suffix == ".py" and f not in PLANTED
        for made in re.findall(rf'"([\w-]+\.{SOURCE})"', p.read_text(encoding="utf-8"))
    }
    texts = {
        text
        for f, p in files.items()
        if f.startswith("tools/src/") and p.suffix == ".py"
        for text in re.findall(r'"([\w-]+\.md)"', p.read_text(encoding="utf-8"))
    }

    for name, path in files.items():
        if name in PLANTED or (path.suffix not in SUFFIXES and name not in PROGRAMS):
            continue
        text = path.read_text(encoding="utf-8")

        def where(at: int, text: str = text, name: str = name) -> str:
            return f"{name}:{text.count(chr(10), 0, at) + 1}"

        line = unwrapped(text)
        _citations(line, where, name, theory, stated, findings)
        for m in matches(TEXT_NAME, line):
            folder, _, text_name = m[1].rpartition("/")
            findings.see(
                m[1] in endings
                or os.path.normpath(Path(name).parent / m[1]) in files
                or (text_name in texts and folder not in folders),
                where(m.start()),
                f"{m[1]} is no text of the repository",
            )
        read = prose(path, text)
        for m in matches(PLACE, read):
            findings.see(
                m[1] in files and defines(files[m[1]], m[2]),
                where(m.start()),
                f"{m[1]} does not define {m[2]}" if m[1] in files else f"no file {m[1]}",
            )
        for m in matches(TREE_PATH, read):
            findings.see(m[1] in files or m[1] in folders, where(m.start()), f"no file or folder {m[1]}")
        for m in matches(SOURCE_NAME, read):
            if re.match(r"[A-Z_]+[./]", m[1]):
                continue
            findings.see(
                m[1] in endings or os.path.normpath(Path(name).parent / m[1]) in files,
                where(m.start()),
                f"no file {m[1]}",
            )
        for m in matches(LINK, text) if path.suffix == ".md" else ():
            target = os.path.normpath(Path(name).parent / m[1]) if m[1] else name
            findings.see(
                target in files or target in folders or target == ".",
                where(m.start()),
                f"link to {m[1]}, which does not exist",
            )
            if m[2] and target in files:
                findings.see(
                    m[2] in anchors(files[target].read_text(encoding="utf-8")),
                    where(m.start()),
                    f"{target} has no heading #{m[2]}",
                )
    print(f"{findings.count} references, {len(findings.dangling)} dangling")
    return findings.dangling


def _citations(line: str, where, name: str, theory: Theory, stated: set[str], findings: Found) -> None:
    """Citations of THEORY, the paper, requirements and sections of other works in ``line``, a whole file."""
    for m in matches(re.compile(r"\bTHEORY\b(?!\.md|\"|`)"), line):
        cited = re.match(r"\s+(\d+(?:\.\d+)?(?:(?:,| and)\s+\d+\.\d+)*)|\s+\(T\d+\)", line[m.end() :])
        numbers = re.findall(r"\d+(?:\.\d+)?", cited[1]) if cited and cited[1] else []
        findings.see(
            cited is not None and all(n in theory.sections for n in numbers),
            where(m.start()),
            f"THEORY has no section {', '.join(numbers) or line[m.end() : m.end() + 12].strip()}",
        )
    for m in matches(re.compile(r"\(T(\d+)\)"), line):
        findings.see(m[1] in theory.equations, where(m.start()), f"THEORY has no equation (T{m[1]})")
    for what, (pattern, known) in PAPER.items():
        for m in matches(pattern, line):
            for number in filter(None, m.groups()):
                findings.see(number in known, where(m.start()), f"the paper has no {what} {number}")
    for m in matches(re.compile(r"\bREQ-[A-Z][A-Z0-9]*-\d+\b"), line):
        findings.see(m[0] in stated, where(m.start()), f"{m[0]} is no requirement")
    for m in matches(re.compile(r"\b[Ss]ection (\d+(?:\.\d+)*)"), line):
        own = name.startswith(THEORY) and m[1] in theory.sections
        findings.see(
            own or WORK.search(line[max(0, m.start() - 120) : m.start()]) is not None,
            where(m.start()),
            f"section {m[1]} of no work that is named",
        )
    for m in matches(re.compile(r"\bDESIGN (?:\d|asks|says)"), line):
        findings.see(False, where(m.start()), "DESIGN is no text of the repository")
