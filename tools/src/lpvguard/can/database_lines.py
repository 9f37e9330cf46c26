"""Reads a DBC with wrong lines: each costs its signal or message, not the file."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # cantools takes long to import
    from cantools.database.can import Database

_HEAD = 'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_:\n\n'
_KEPT = re.compile(r"\s*(BO_|SG_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_|BA_DEF_|BA_DEF_DEF_|BA_)\s")
"""Statements that decide how a frame is decoded."""


def read_sound_lines(text: str) -> tuple[Database, list[str]]:
    """Read the statements of a DBC that cantools can read.

    Parameters
    ----------
    text : str, the whole DBC

    Returns
    -------
    tuple of Database and list of str
        Sound statements, and a sentence for each other or corrected one: line number and text.
    """
    blocks: list[list[tuple[int, str]]] = []
    others: list[tuple[int, str]] = []
    corrected: list[tuple[int, str]] = []
    for number, line in _statements(text):
        if line.startswith("BO_ "):
            flagged = _with_flag(line)
            if flagged != line:
                corrected.append((number, line))
            blocks.append([(number, flagged)])
        elif line.lstrip().startswith("SG_ ") and blocks:
            blocks[-1].append((number, line))
        elif _KEPT.match(line):
            others.append((number, line))
    left_out: list[tuple[int, str]] = []
    lines = [line for block in blocks for line in _sound_block(block, left_out)]
    body = _HEAD + "".join(line + "\n" for line in lines)
    kept = _sound(body, others, left_out)
    database = _parsed(body + "".join(line + "\n" for _, line in kept))
    if database is None:  # statements that are sound one by one, and not together
        database = _database(_HEAD)
        left_out = [*left_out, *((number, line) for block in blocks for number, line in block)]
    said = [
        (number, f"left out, cannot be read: line {number}: {line.strip()[:80]}") for number, line in left_out
    ]
    said += [
        (
            number,
            f"line {number}: {line.strip()[:80]}: read as an identifier of 29 bits, though its flag lacks",
        )
        for number, line in corrected
    ]
    return database, [text for _, text in sorted(said)]


def _with_flag(line: str) -> str:
    """The head of a message whose identifier has more than 11 bits, with the flag that says so."""
    head = re.match(r"BO_ (\d+)", line)
    if head is None or not 0x7FF < int(head[1]) < 1 << 29:
        return line
    return f"BO_ {int(head[1]) | 1 << 31}{line[head.end() :]}"


def _statements(text: str) -> list[tuple[int, str]]:
    """Line number and text of each statement; quoted text may run over several lines."""
    statements: list[tuple[int, str]] = []
    quoted = False
    for number, line in enumerate(text.splitlines(), start=1):
        begins = re.match(r"\s*(BO_|SG_|CM_|VAL_|BA_)", line) is not None
        if quoted and not begins:
            statements[-1] = (statements[-1][0], statements[-1][1] + "\n" + line)
        else:
            statements.append((number, line))
            quoted = False
        quoted ^= line.replace('\\"', "").count('"') % 2 == 1
    return statements


def _sound_block(block: list[tuple[int, str]], left_out: list[tuple[int, str]]) -> list[str]:
    """Readable lines of one message; none if the message itself is not."""
    if _parsed(_HEAD + "\n".join(line for _, line in block)) is not None:
        return [line for _, line in block]
    header, signals = block[0], block[1:]
    if _parsed(_HEAD + header[1]) is None:
        left_out.append(header)
        return []
    kept = _sound(_HEAD + header[1] + "\n", signals, left_out)
    return [header[1], *(line for _, line in kept)]


def _sound(
    head: str, statements: list[tuple[int, str]], left_out: list[tuple[int, str]]
) -> list[tuple[int, str]]:
    """Statements that can be read after ``head``, found by halving."""
    if not statements or _parsed(head + "".join(line + "\n" for _, line in statements)) is not None:
        return statements
    if len(statements) == 1:
        left_out.append(statements[0])
        return []
    half = len(statements) // 2
    first = _sound(head, statements[:half], left_out)
    return first + _sound(head + "".join(line + "\n" for _, line in first), statements[half:], left_out)


def _parsed(text: str) -> Database | None:
    """Database of a DBC, None where cantools cannot read it."""
    try:
        return _database(text)
    except Exception:  # cantools raises many classes for a wrong text
        return None


def _database(text: str) -> Database:
    """Database of a DBC that cantools can read."""
    from cantools.database.can import Database

    database = Database(strict=False)
    database.add_dbc_string(text)
    return database
