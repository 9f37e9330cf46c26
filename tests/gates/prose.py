"""The gate on prose: sentences that people read once.

    long        a sentence has more than 25 words
    inversion   a sentence begins with what belongs behind its verb: "Of ...", "Nor ...", "So does ..."
    riddle      a phrase that sends the reader back: "but for", "other ones", "the one before"
    claims      a sentence with two semicolons: make each claim a sentence of its own

The gate reads the documents of ``DOCUMENTS``, the public docstrings of ``DOCSTRINGS`` and the comments of
``HEADERS``. Blocks of code, inline code, formulas, addresses, units and matrices in brackets do not count. A
table cell, a line "name   text", a list item and a heading end a sentence. In a header, each status of a list
"Returns ...; ..." ends a sentence too.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

MOST_WORDS = 25
DOCUMENTS = (
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "README.md",
    "data/README.md",
    "firmware_sim/README.md",
    "lib/COEFFICIENTS.md",
    "lib/INTEGRATION.md",
    "lib/MISRA.md",
    "lib/MISRA_CPP.md",
    "lib/README.md",
    "lib/REQUIREMENTS.md",
    "lib/THEORY.md",
    "lib/theory/*.md",
    "tests/README.md",
    "tools/README.md",
    "tools/TUTORIAL.md",
    "tools/site/pages/**/*.md",
)
"""Patterns of the documents that the gate reads."""
DOCSTRINGS = (
    "tests/gates/prose.py",
    "tests/gates/references.py",
    "tools/release.py",
    "tools/site/*.py",
    "tools/src/lpvguard/**/*.py",
)
"""Patterns of the Python modules whose public docstrings the gate reads."""
HEADERS = ("lib/include/lpvguard/*.h",)
"""Patterns of the C headers whose documentation comments the gate reads."""
INVERSION = re.compile(
    r"(?:Of|Nor|Neither of|So (?:does|do|did|is|are|was|has|have)|Beside (?:it|them|this|these)"
    r"|(?:Not|Never|Nowhere) (?:\w+ed|\w+n) (?:is|are|were|was)|Only then)\b"
)
RIDDLES = re.compile(
    r"\b(?:but for|other ones|of before|the one before|none of which|as much \w+ as|than they were before"
    r"|stands? (?:beside|in for)|what is not|that of which|nothing else than|by itself alone)\b",
    re.IGNORECASE,
)
NEXT = r"[A-Z0-9|`∎]|[^\x00-\x7f]|\w{1,2}_|[b-z]\d?²?[ ,]|se²|sd |code\b|lpvg\w+"
ENDING = re.compile(rf"[.!?](?:[\"')\]]*)\s+(?=[\"'(\[]*(?:{NEXT}))")
"""End of a sentence, and what the next may begin with: a capital, a number, a symbol or a name of code."""
ABBREVIATION = re.compile(r"\b(?:e\.g|i\.e|cf|vs|Fig|Figs|Eq|No|approx|min|max|St|Jr|Proc|IEEE|J)\.$")
RST_TABLE = re.compile(r"^=+(?: +=+)+\n(?:.+\n)*=+(?: +=+)+$", re.MULTILINE)
SECTION = re.compile(r"^([A-Z][\w ]*)\n-{3,}$", re.MULTILINE)
FENCE = re.compile(r"^(```+|~~~+)[^\n]*\n.*?^\1[ \t]*$", re.MULTILINE | re.DOTALL)


def units(text: str) -> Iterator[tuple[int, str]]:
    """First line and words of every paragraph, list item, table cell and heading of a Markdown text."""
    text = FENCE.sub(lambda m: "\n" * m[0].count("\n"), text)
    text = RST_TABLE.sub(lambda m: "\n" * m[0].count("\n"), text)
    text = re.sub(r"<!--.*?-->", lambda m: "\n" * m[0].count("\n"), text, flags=re.DOTALL)
    start, words = 0, ""
    for number, line in enumerate([*text.splitlines(), ""], 1):
        begins = re.match(r"\s*(?:[-*+] |\d+\. |#+ |\||>)|\S+(?:, \S+)* {2,}\S", line)
        if not line.strip() or begins or line.startswith("    "):
            if words:
                yield start, words
            words = ""
        if line.startswith("|"):
            yield from ((number, cell.strip()) for cell in re.split(r"(?<!\\)\|", line) if cell.strip(" -:"))
        elif line.strip() and (words or begins or not line.startswith("    ")):
            start, words = (start, f"{words} {line.strip()}") if words else (number, line.strip())
            if re.match(r"\s*#", line):
                yield start, words
                words = ""


def sentences(words: str) -> list[str]:
    """Sentences of a paragraph, without its markup."""
    words = re.sub(r"!?\[((?:[^\[\]]|\[[^\]]*\])*)\]\([^)]*\)", r"\1", words)
    words = re.sub(r"\{\w+\}(?=`)", "", words)
    words = re.sub(r"``[^`]+``|`[^`]+`", "code", words)
    words = re.sub(r"\[[^\[\]]*\]", "", words)
    words = re.sub(r"https?://\S+", "address", re.sub(r"[*]{1,2}(?=\S)|(?<=\S)[*]{1,2}", "", words))
    words = re.sub(r"^(?:[-*+]|\d+\.|#+|>)\s+", "", words)
    out, rest = [], words
    for m in ENDING.finditer(words):
        piece = words[len(words) - len(rest) : m.end()]
        if not ABBREVIATION.search(piece.strip()):
            out.append(piece.strip())
            rest = words[m.end() :]
    return [*out, rest.strip()]


def breaches(words: str) -> Iterator[str]:
    """Return the breaches of the rules in a paragraph."""
    for sentence in sentences(words):
        shown = sentence if len(sentence) < 90 else f"{sentence[:87]}..."
        count = sum(bool(re.search(r"[^\W_]", word)) for word in sentence.split())
        if count > MOST_WORDS:
            yield f"long: {count} words, at most {MOST_WORDS}: {shown}"
        if INVERSION.match(sentence):
            yield f"inversion: begin with the subject: {shown}"
        for riddle in RIDDLES.findall(sentence):
            yield f"riddle: {riddle!r}: {shown}"
        if sentence.count(";") > 1:
            yield f"claims: make each a sentence: {shown}"


def entries_apart(said: str) -> str:
    """A numpydoc docstring with each entry of its sections, and its description, as a paragraph."""
    first, *rest = SECTION.split(said)
    for title, body in zip(rest[::2], rest[1::2], strict=True):
        lines = [f"\n{line.strip()}\n" if line[:1].strip() else line.strip() for line in body.splitlines()]
        first += f"\n{title}\n\n" + "\n".join(lines).replace("\n\n", "\n \n")
    return first


def docstrings(text: str) -> Iterator[tuple[int, str]]:
    """Line and text of the module's docstring and of every public class, function and method."""

    def visit(node: ast.Module | ast.ClassDef) -> Iterator[tuple[int, str]]:
        said = ast.get_docstring(node)
        if said:
            yield node.body[0].lineno, entries_apart(said)
        for inner in node.body:
            if isinstance(inner, ast.FunctionDef) and not inner.name.startswith("_"):
                docstring = ast.get_docstring(inner)
                if docstring:
                    yield inner.body[0].lineno, entries_apart(docstring)
            elif isinstance(inner, ast.ClassDef) and not inner.name.startswith("_"):
                yield from visit(inner)

    yield from visit(ast.parse(text))


def comments(text: str) -> Iterator[tuple[int, str]]:
    """First line and text of each block of ``///`` lines and of each part of a ``///<`` comment."""
    for block in re.finditer(r"(?:^[ ]*///(?!<).*\n)+", text, re.MULTILINE):
        said = re.sub(r"^[ ]*/// ?", "", block[0], flags=re.MULTILINE)
        said = re.sub(r"^(Returns .*?)(?=\n\n|\Z)", statuses_apart, said, flags=re.MULTILINE | re.DOTALL)
        yield text.count("\n", 0, block.start()) + 1, said
    for comment in re.finditer(r"///<[ ]*(.*?)\s*(?:\[[^\[\]]*\])?$", text, re.MULTILINE):
        for part in comment[1].split("; "):
            yield text.count("\n", 0, comment.start()) + 1, part


def statuses_apart(returns: re.Match[str]) -> str:
    """A list of statuses "Returns ok; bad_argument ..." with each status as a list item."""
    return re.sub(r";\s", "\n- ", returns[1])


def prose(tree: Path, scratch: Path) -> list[str]:
    """The gate: every breach with file and line. A pattern that names no file is a finding too."""
    findings, read = [], 0
    for pattern in (*DOCUMENTS, *DOCSTRINGS, *HEADERS):
        paths = sorted(tree.glob(pattern))
        findings += [] if paths else [f"{pattern}: names no file"]
        for path in paths:
            text, name = path.read_text(encoding="utf-8"), path.relative_to(tree).as_posix()
            read_texts = {".py": docstrings, ".h": comments}.get(path.suffix, lambda text: [(1, text)])
            for first, said in read_texts(text):
                for line, words in units(said):
                    read += 1
                    findings += [f"{name}:{first + line - 1}: {breach}" for breach in breaches(words)]
    print(f"{read} paragraphs, {len(findings)} findings")
    return findings
