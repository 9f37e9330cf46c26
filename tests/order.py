"""The order in which workers take the files of tests."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import pytest

QUICK_S, UNSTATED_S = 0.2, 5.0
"""Processor seconds of a test that is not marked slow, and of one whose mark states none."""


def stated_seconds(reason: str) -> float:
    """Processor seconds that a slow mark states."""
    found = re.search(r"(\d+(?:\.\d+)?) s\b", reason)
    return float(found[1]) if found else UNSTATED_S


def dearest_file_first(items: list[pytest.Item], of_fixtures: Iterable[str]) -> list[pytest.Item]:
    """Tests by file, as workers take them, the dearest file first, so that no worker is left with a long one
    at the end; the order within a file stays. Reasons ``of_fixtures`` count once a file."""
    shared = set(of_fixtures)
    cost: dict[Path, float] = {}
    fixtures: dict[Path, set[str]] = {}
    for item in items:
        reasons = {str(mark.args[0]) for mark in item.iter_markers("slow")}
        own = max(map(stated_seconds, reasons - shared), default=QUICK_S)
        cost[item.path] = cost.get(item.path, 0.0) + own
        fixtures.setdefault(item.path, set()).update(reasons & shared)
    for path, reasons in fixtures.items():
        cost[path] += sum(map(stated_seconds, reasons))
    return sorted(items, key=lambda item: -cost[item.path])
