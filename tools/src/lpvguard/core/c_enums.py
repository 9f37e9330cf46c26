"""Read the names of the C core's enumerations from its headers."""

import re
from pathlib import Path

from ..base.errors import InputError

_TYPE = r"typedef enum {name} \{{(?P<body>.*?)\}} {name};"
_COMMENT = re.compile(r"//.*$", re.MULTILINE)
_MEMBER = re.compile(r"\s*(?P<name>\w+)\s*=\s*(?P<value>\d+)\s*")


def enum_names(header: Path, name: str) -> tuple[str, ...]:
    """Read the member names of ``typedef enum name`` in the order of their values 0, 1, ...

    The common prefix is removed. A last member that only states the number of members is left out.

    Parameters
    ----------
    header : Path
    name : str

    Returns
    -------
    tuple of str

    Raises
    ------
    InputError
        If the header has no such type, or its values have gaps.
    """
    definition = re.search(_TYPE.format(name=name), header.read_text(encoding="utf-8"), re.DOTALL)
    items = (
        []
        if definition is None
        else [m for m in _COMMENT.sub("", definition["body"]).split(",") if m.strip()]
    )
    parsed = [_MEMBER.fullmatch(item) for item in items]
    members = [(m["name"], int(m["value"])) for m in parsed if m is not None]
    prefix = name.removesuffix("t")
    while prefix.count("_") > 1 and any(not m.startswith(prefix) for m, _ in members):
        prefix = prefix[:-1].rpartition("_")[0] + "_"
    if (
        not members
        or None in parsed
        or [value for _, value in members] != list(range(len(members)))
        or any(not m.startswith(prefix) for m, _ in members)
    ):
        raise InputError(
            header,
            name,
            "not found, or not numbered from 0 without gaps",
            f"members {name.removesuffix('t')}* = 0, 1, ...",
        )
    names = [member.removeprefix(prefix) for member, _ in members]
    return tuple(names[:-1] if names[-1] == "count" else names)
