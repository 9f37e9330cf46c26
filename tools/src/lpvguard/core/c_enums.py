"""Names of the C core's enumerations, read from its headers: they are stated there and nowhere else."""

from __future__ import annotations

import re
from pathlib import Path

from ..base.errors import InputError

_TYPE = r"typedef enum {name} \{{(?P<body>.*?)\}} {name};"
_MEMBER = re.compile(r"^\s*(?P<name>\w+)\s*=\s*(?P<value>\d+),?\s*(?:///<.*)?$", re.MULTILINE)


def enum_names(header: Path, name: str) -> tuple[str, ...]:
    """Names of the members of ``typedef enum name`` in the order of their values 0, 1, ..., without the type's prefix and without a member
    that only counts. Raises InputError when the header has no such type, or its values have gaps."""
    found = re.search(_TYPE.format(name=name), header.read_text(encoding="utf-8"), re.DOTALL)
    members = [] if found is None else [(m["name"], int(m["value"])) for m in _MEMBER.finditer(found["body"])]
    prefix = name.removesuffix("_t") + "_"
    if not members or [value for _, value in members] != list(range(len(members))) or any(not m.startswith(prefix) for m, _ in members):
        raise InputError(header, name, "not found, or not numbered from 0 without gaps", f"members {prefix}* = 0, 1, ...")
    names = [member.removeprefix(prefix) for member, _ in members]
    return tuple(names[:-1] if names[-1] == "count" else names)
