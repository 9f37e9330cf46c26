"""Small changes of a C++ source that its tests must notice: where they can be made, and the text that each
makes.

Operators: relational, arithmetic, bitwise, logical, constants one up, truth values, statements left out.
Found in the text, line by line, with comments, preprocessor lines and compile-time assertions left alone. A
line is written so that an operator between operands has a space on both sides; that is how `<` is told from a
bracket of a template.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

SWAPS = {
    "<": "<=",
    "<=": "<",
    ">": ">=",
    ">=": ">",
    "==": "!=",
    "!=": "==",
    "+": "-",
    "-": "+",
    "*": "/",
    "/": "*",
    "%": "*",
    "&": "|",
    "|": "&",
    "^": "&",
    "<<": ">>",
    ">>": "<<",
    "&&": "||",
    "||": "&&",
    "+=": "-=",
    "-=": "+=",
    "|=": "&=",
}
BETWEEN = re.compile(
    r"(?<= )(" + "|".join(re.escape(o) for o in sorted(SWAPS, key=len, reverse=True)) + r")(?= )"
)
STEP = re.compile(r"\+\+|(?<!-)--(?!-)")
NOT = re.compile(r"!(?=[a-z(])")
NUMBER = re.compile(r"(?<![\w.'])(\d+)(?=U?\b)(?![.'\w]*[.'xX])")
TRUTH = re.compile(r"\b(true|false)\b")
STATEMENT = re.compile(
    r"^(?!return\b|const\b|auto\b|using\b|break\b|case\b|default\b|static\b|constexpr\b).*[=(+-].*;$"
)


@dataclass(frozen=True)
class Mutant:
    """``text`` in place of line ``line`` (from 1) of ``file``; ``was`` is the line as it stands."""

    file: str
    line: int
    was: str
    text: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.was.strip()}  ->  {self.text.strip() or '(left out)'}"

    @property
    def key(self) -> str:
        """Names the mutant whatever its line number."""
        return f"{self.file}: {self.was.strip()} -> {self.text.strip()}"


def mutants(file: str, source: str) -> list[Mutant]:
    """All mutants of a source, in the order of its text."""
    found = []
    for number, line in enumerate(source.splitlines(), 1):
        code = line.split("//")[0].rstrip()
        stripped = code.strip()
        if not stripped or stripped.startswith(("#", "static_assert", "template", "using ", "namespace")):
            continue
        texts = [code[: m.start()] + SWAPS[m[0]] + code[m.end() :] for m in BETWEEN.finditer(code)]
        texts += [
            code[: m.start()] + ("--" if m[0] == "++" else "++") + code[m.end() :]
            for m in STEP.finditer(code)
        ]
        texts += [code[: m.start()] + code[m.end() :] for m in NOT.finditer(code)]
        texts += [code[: m.start()] + str(int(m[1]) + 1) + code[m.end() :] for m in NUMBER.finditer(code)]
        texts += [
            code[: m.start()] + ("false" if m[0] == "true" else "true") + code[m.end() :]
            for m in TRUTH.finditer(code)
        ]
        texts += [""] if STATEMENT.match(stripped) else []
        found += [Mutant(file, number, line, text) for text in dict.fromkeys(texts)]
    return found


def applied(source: str, mutant: Mutant) -> str:
    lines = source.splitlines(keepends=True)
    assert lines[mutant.line - 1].rstrip("\n") == mutant.was
    lines[mutant.line - 1] = mutant.text + "\n"
    return "".join(lines)
