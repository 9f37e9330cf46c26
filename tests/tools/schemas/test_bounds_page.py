"""THEORY 8.1 has a row for every number that is called a bound, with what proves it and a planted number."""

import json
import re
from collections.abc import Iterator

import pytest

from lpvguard import schemas
from lpvguard.extras.bench import bounds
from lpvguard.extras.bench._mu_families import problems
from lpvguard.extras.problems.solve import solve_problem
from made import ROOT

WORDS = re.compile(r"bound|certif|prove|lower|upper|above|margin|at (most|least)|no controller|promise", re.I)
"""Words that call a number a bound, in its name or its description."""
FILES = ("controller", "weights", "energy", "bounds", "robust", "table2", "tradeoff", "recertification")
NO_BOUNDS = {
    *("test", "scaling", "basis", "P", "coefficients_sha256"),  # means of a proof
    *("left_out_covered", "ratio", "beyond", "without_data", "floored_rad_s"),  # counts and places
    *("frames", "setting", "silent_bins", "disturbance_set"),  # which drives and bins
    *("confident", "memory_s", "nu_high"),  # settings
}
"""Fields whose words say so, and that state no such number."""
BESIDE = {"id", "status", "controller", "note", "omega", "cells", "peak_frequency", "regularisation"}
"""Fields of an answer beside its bounds."""
SYMBOL = re.compile(r"`(tests/[\w/.]+\.py|tools/[\w/.]+\.py):[\w.]+`")


def rows() -> list[list[str]]:
    text = (ROOT / "lib/theory/8-1-bounds.md").read_text()
    lines = [line for line in text.splitlines() if line.startswith("| ")][1:]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines if "---" not in line]


def listed() -> set[str]:
    names = (name for row in rows() for name in re.findall(r"`([^`]+)`", row[0]))
    return {name.split(".")[-1].removesuffix("[]") for name in names}


def numbers(node: dict) -> Iterator[tuple[str, str]]:
    """Yield name and description of every field of a schema that has no fields of its own."""
    for name, value in node.get("properties", {}).items():
        if '"properties"' not in json.dumps(value) and "$ref" not in json.dumps(value):
            yield name, value.get("description", "")
    for value in node.values():
        for part in value if isinstance(value, list) else [value]:
            if isinstance(part, dict):
                yield from numbers(part)


@pytest.mark.parametrize("name", FILES)
def test_every_field_of_a_file_that_is_called_a_bound_has_a_row(name):
    called = {field for field, text in numbers(schemas.schema(name)) if WORDS.search(f"{field} {text}")}
    assert called - listed() - NO_BOUNDS == set()


@pytest.mark.parametrize("kind", bounds.BOUNDS)
def test_every_number_of_an_answer_has_a_row(kind):
    problem, _ = next(problems(bounds.FAMILIES[kind][0], 1, 1))
    answer = solve_problem({"id": kind, **problem})
    assert answer["status"] == "ok"
    assert answer.keys() - listed() - BESIDE == set()


def test_every_row_says_what_is_stated_and_what_verifies_it_with_a_planted_number():
    for field, statement, verified, allowed, planted in rows():
        assert statement and allowed, field
        assert [path for path in SYMBOL.findall(verified) if path.startswith("tools/")], field
        assert [path for path in SYMBOL.findall(planted) if path.startswith("tests/")], field
