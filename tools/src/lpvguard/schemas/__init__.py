"""Schemas of the JSON that lpvguard reads and writes: JSON Schema (draft 2020-12), one file a format, an
example beside each.

NAME.schema.json describes every field; ``unit`` and ``shape`` are annotations of ours. A field that is not
described is an error wherever the format is ours. examples/NAME.json is a real file with its lists shortened.
FORMATS.md is ``markdown()``.
"""

import json
import re
from collections.abc import Iterator
from importlib import resources
from typing import Any

MAY_IMPORT = ("vehicle", "drives", "loop")


def names() -> list[str]:
    """Names of the formats."""
    suffix = ".schema.json"
    return sorted(
        p.name.removesuffix(suffix) for p in resources.files(__package__).iterdir() if p.name.endswith(suffix)
    )


def schema(name: str) -> dict[str, Any]:
    """The JSON Schema of a format."""
    return _read(f"{name}.schema.json")


def example(name: str) -> Any:
    """An example that the schema of a format accepts."""
    return _read("examples", f"{name}.json")


def _read(*path: str) -> Any:
    return json.loads(resources.files(__package__).joinpath(*path).read_text(encoding="utf-8"))


def markdown() -> str:
    """The page FORMATS.md: tables and TOML files by hand (tables.md), the settings and the JSON from their
    schemas."""
    from ..drives.signal_map import SignalMap
    from ..extras.loop.sim import Expectation
    from ..vehicle.project import Project

    text = [resources.files(__package__).joinpath("tables.md").read_text(encoding="utf-8").rstrip(), ""]
    settings = (
        ("Project file", Project),
        ("Signal map", SignalMap),
        ("Table expect of a scenario", Expectation),
    )
    described = [(title, model.model_json_schema(by_alias=True)) for title, model in settings]
    for title, json_schema in [*described, *((f"{n}: {schema(n)['title']}", schema(n)) for n in names())]:
        text += [f"## {title}", "", "| field | type | unit, shape | meaning |", "| --- | --- | --- | --- |"]
        text += [
            f"| {' | '.join(cell.replace('|', chr(92) + '|').replace(chr(10), ' ') for cell in row)} |"
            for row in _rows(json_schema, json_schema, "", ())
        ]
        text.append("")
    return "\n".join(text)


def _rows(
    root: dict, node: dict, path: str, open_refs: tuple[str, ...]
) -> Iterator[tuple[str, str, str, str]]:
    """(path, type, unit and shape, meaning) of a node and of what is in it; a reference is followed once on a
    path."""
    alternatives = [a for a in node.get("anyOf", ()) if a.get("type") != "null"]
    if len(alternatives) == 1 and ("$ref" in alternatives[0] or "items" in alternatives[0]):
        node = {**alternatives[0], **{k: v for k, v in node.items() if k != "anyOf"}}
    if "$ref" in node:
        reference = node["$ref"]
        if reference in open_refs:
            return
        target = root["$defs"][reference.rsplit("/", 1)[1]]
        node, open_refs = (
            {**target, **{k: v for k, v in node.items() if k != "$ref"}},
            (*open_refs, reference),
        )
    node = _with_meanings(node)
    if path:
        yield (
            f"`{path}`",
            _type(node),
            ", ".join(node[k] for k in ("unit", "shape") if k in node),
            node.get("description", "").split("\n\n")[0],
        )
    required = node.get("required", ())
    for name, value in node.get("properties", {}).items():
        optional = "" if name in required else "?"
        yield from _rows(root, value, f"{path}.{name}{optional}".lstrip("."), open_refs)
    inner = (("items", "[]"), ("additionalProperties", ".*"))
    for key, mark in inner:
        value = node.get(key)
        if isinstance(value, dict) and ("properties" in value or "$ref" in value):
            yield from list(_rows(root, value, (path + mark).lstrip("."), open_refs))[0 if not path else 1 :]


def _with_meanings(node: dict) -> dict:
    """The node with the Attributes of its docstring as descriptions of its properties."""
    summary, _, listed = node.get("description", "").partition("\n\nAttributes\n----------\n")
    if not listed:
        return node
    properties = dict(node["properties"])
    for entry in re.split(r"\n(?! )", listed):
        line, *more = entry.split("\n")
        names, _, kind = line.partition(" : ")
        words = [*re.split(r", (?![^\[(]*[\])])", kind, maxsplit=1)[1:], " ".join(map(str.strip, more))]
        for name in set(names.split(", ")) & set(properties):
            if any(words) and "description" not in properties[name]:
                properties[name] = {**properties[name], "description": ". ".join(filter(None, words))}
    return {**node, "description": summary, "properties": properties}


def _type(node: dict) -> str:
    if "const" in node:
        return json.dumps(node["const"])
    if "enum" in node:
        return ", ".join(json.dumps(v) for v in node["enum"])
    kinds = node.get("type", [a.get("type", "value") for a in node.get("anyOf", ())] or "any")
    return kinds if isinstance(kinds, str) else " or ".join(kinds)
