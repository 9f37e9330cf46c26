"""The order in which workers take the files of tests."""

import re
from collections.abc import Iterable
from pathlib import Path

import pytest

QUICK_S, UNSTATED_S = 0.2, 5.0
"""Processor seconds of a test without a mark or that is skipped, and of one whose mark states none."""


def stated_seconds(reason: str) -> float:
    """Processor seconds that a slow or long mark states."""
    match = re.search(r"(\d+(?:\.\d+)?) s\b", reason)
    return float(match[1]) if match else UNSTATED_S


def dearest_file_first(items: list[pytest.Item], of_fixtures: Iterable[str]) -> list[pytest.Item]:
    """Tests by file, as workers take them, the dearest file first, so that no worker is left with a long one
    at the end; the order within a file stays. Reasons ``of_fixtures`` count once a file.

    The second file is the dearest that needs none of the first one's fixtures: a worker that took another
    would wait until they are made.
    """
    shared = set(of_fixtures)
    cost: dict[Path, float] = {}
    fixtures: dict[Path, set[str]] = {}
    for item in items:
        skipped = item.get_closest_marker("skip") is not None
        marks = [mark for name in ("slow", "long") if not skipped for mark in item.iter_markers(name)]
        reasons = {str(mark.args[0]) for mark in marks}
        own = max(map(stated_seconds, reasons - shared), default=QUICK_S)
        cost[item.path] = cost.get(item.path, 0.0) + own
        fixtures.setdefault(item.path, set()).update(reasons & shared)
    for path, reasons in fixtures.items():
        cost[path] += sum(map(stated_seconds, reasons))
    files = sorted(cost, key=lambda path: -cost[path])
    if apart := [path for path in files[1:] if not fixtures[path] & fixtures[files[0]]]:
        files.remove(apart[0])
        files.insert(1, apart[0])
    return sorted(items, key=lambda item: files.index(item.path))
