"""Read a DBC with wrong lines: a wrong line loses only its signal or message, not the whole file."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # cantools takes long to import
    from cantools.database.can import Database

_HEAD = 'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_:\n\n'
_KEPT = re.compile(r"\s*(BO_|SG_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_|BA_DEF_|BA_DEF_DEF_|BA_)\s")
"""Statements that decide how a frame is decoded."""
_ABOUT = re.compile(r'\s*(?:(?:VAL_|SIG_VALTYPE_|SG_MUL_VAL_)|BA_\s+"[^"]*"\s+(?:BO_|SG_))\s+(\d+)\s')
"""Word of a statement that holds the identifier of the message, by the statement's keyword."""

_HEAD_LIKE = re.compile(r"\s*(?!SG_|SIG_|VAL_)\w*\s*\d+\s+\w+\s*:\s*\d+\s")
"""A head of a message whose first word is wrong."""

_Line = tuple[int, str]
"""Line number and text of a statement."""


@dataclass
class _Message:
    """Statements of a message: its head, its signals, and further statements about them."""

    identifier: str
    head: _Line
    signals: list[_Line] = field(default_factory=list)
    about: list[_Line] = field(default_factory=list)

    def parts(self) -> tuple[str, str]:
        """Text of the message, and text of the further statements about it."""
        return _joined([self.head, *self.signals]), _joined(self.about)


def read_sound_lines(text: str) -> tuple[Database, list[str]]:
    """Read the statements of a DBC that cantools can read.

    The list holds a sentence, with line number and text, for each statement that was left out or corrected.
    """
    messages: list[_Message] = []
    definitions: list[_Line] = []
    corrected: list[_Line] = []
    left_out: list[_Line] = []
    message: _Message | None = None
    for number, line in _statements(text):
        if head := re.match(r"BO_ (\d+)", line):
            flagged = _flagged(head[1])
            if flagged != head[1]:
                corrected.append((number, line))
            message = _Message(flagged, (number, f"BO_ {flagged}{line[head.end() :]}"))
            messages.append(message)
        elif _HEAD_LIKE.match(line):
            message = None
            left_out.append((number, line))
        elif line.lstrip().startswith("SG_ ") and messages:
            (message.signals if message else left_out).append((number, line))
        elif about := _ABOUT.match(line):
            flagged = _flagged(about[1])
            statement = line[: about.start(1)] + flagged + line[about.end(1) :]
            if described := next((m for m in messages if m.identifier == flagged), None):
                described.about.append((number, statement))
        elif _KEPT.match(line):
            definitions.append((number, line))
    definitions = _sound_lines(_HEAD, definitions, left_out)
    sound = _sound_messages(messages, _joined(definitions), left_out)
    database = _parsed(_text(sound, _joined(definitions)))
    if database is None:  # each statement is readable by itself, but not all together
        database = _database(_HEAD)
        left_out += [line for m in sound for line in (m.head, *m.signals, *m.about)]
    sentences = [
        (number, f"left out, cannot be read: line {number}: {line.strip()[:80]}") for number, line in left_out
    ]
    sentences += [
        (
            number,
            f"line {number}: {line.strip()[:80]}: read as a 29-bit identifier, although the flag is missing",
        )
        for number, line in corrected
    ]
    return database, [text for _, text in sorted(sentences)]


def _flagged(identifier: str) -> str:
    """Add the flag of a 29-bit identifier if the identifier has more than 11 bits."""
    number = int(identifier)
    return str(number | 1 << 31 if 0x7FF < number < 1 << 29 else number)


def _statements(text: str) -> list[_Line]:
    """Line number and text of each statement; a quoted text may cover several lines."""
    statements: list[_Line] = []
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


def _sound_messages(messages: list[_Message], definitions: str, left_out: list[_Line]) -> list[_Message]:
    """Readable parts of the messages; halving the list finds the messages with a wrong line."""
    if _parsed(_text(messages, definitions)) is not None:
        return messages
    if len(messages) == 1:
        return _sound_message(messages[0], definitions, left_out)
    half = len(messages) // 2
    return [
        m for part in (messages[:half], messages[half:]) for m in _sound_messages(part, definitions, left_out)
    ]


def _sound_message(message: _Message, definitions: str, left_out: list[_Line]) -> list[_Message]:
    """Message with its readable statements; an empty list if its head is not readable."""
    head = _HEAD + _joined([message.head])
    if _parsed(head) is None:
        left_out.append(message.head)
        return []
    signals = _sound_lines(head, message.signals, left_out)
    about = _sound_lines(head + _joined(signals) + definitions, message.about, left_out)
    return [_Message(message.identifier, message.head, signals, about)]


def _sound_lines(head: str, lines: list[_Line], left_out: list[_Line]) -> list[_Line]:
    """Statements that can be read after ``head``; halving the list finds them."""
    if not lines or _parsed(head + _joined(lines)) is not None:
        return lines
    if len(lines) == 1:
        left_out.append(lines[0])
        return []
    half = len(lines) // 2
    first = _sound_lines(head, lines[:half], left_out)
    return first + _sound_lines(head + _joined(first), lines[half:], left_out)


def _text(messages: list[_Message], definitions: str) -> str:
    """Text of a DBC with messages and definitions."""
    parts = [m.parts() for m in messages]
    return _HEAD + "".join(p[0] for p in parts) + definitions + "".join(p[1] for p in parts)


def _joined(lines: list[_Line]) -> str:
    return "".join(line + "\n" for _, line in lines)


def _parsed(text: str) -> Database | None:
    """Read a DBC; None if cantools cannot read it, or if its last statement has no end."""
    try:
        return _database(text + 'CM_ "";\n')
    except Exception:  # cantools raises many classes for a wrong text
        return None


def _database(text: str) -> Database:
    """Read a DBC that cantools can read."""
    from cantools.database.can import Database

    database = Database(strict=False)
    database.add_dbc_string(text)
    return database
