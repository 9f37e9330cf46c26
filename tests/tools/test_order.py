"""The order of the files (tests/order.py): the dearest first, by what the slow marks state."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from order import UNSTATED_S, dearest_file_first, stated_seconds

FIXTURE = "60 s: a truck identified"


@dataclass
class Item:
    path: Path
    name: str
    reasons: tuple[str, ...] = ()
    mark: str = "slow"
    skipped: bool = False

    def iter_markers(self, name):
        return [getattr(pytest.mark, name)(reason).mark for reason in self.reasons if name == self.mark]

    def get_closest_marker(self, name):
        return pytest.mark.skip.mark if name == "skip" and self.skipped else None


def names(*files):
    """Names in their order; ``files``: (file, reasons of each of its tests)."""
    items = [
        Item(Path(file), f"{file}{i}", reasons) for file, tests in files for i, reasons in enumerate(tests)
    ]
    return " ".join(item.name for item in dearest_file_first(items, [FIXTURE]))


def test_a_file_costs_the_sum_of_its_tests():
    a, b = ("a", [()] * 3), ("b", [(), ("6.5 s: a core",)])
    assert names(a, b) == names(b, a) == "b0 b1 a0 a1 a2"
    assert names(b, ("c", [("3 s: x",), ("4 s: y",)])) == "c0 c1 b0 b1"


def test_a_shared_fixture_counts_once_a_file():
    of_fixture, own = ("f", [(FIXTURE,)] * 3), ("o", [("61 s: its own",)])
    assert names(of_fixture, own) == "o0 f0 f1 f2"
    assert names(of_fixture, ("p", [("59 s: its own",)])) == "f0 f1 f2 p0"


def test_a_long_test_counts_where_it_runs():
    quick, slow = Item(Path("q"), "q0"), Item(Path("s"), "s0", ("9 s: x",))
    for skipped, first in ((False, "l0"), (True, "s0")):
        long = Item(Path("l"), "l0", ("30 s: x",), "long", skipped)
        assert dearest_file_first([quick, slow, long], [])[0].name == first


def test_the_second_file_does_not_wait_for_what_the_first_one_makes():
    makes, waits = ("m", [(FIXTURE, "9 s: more")]), ("w", [(FIXTURE,)])
    own, quick = ("o", [("5 s: its own",)]), ("q", [()])
    assert names(waits, quick, own, makes) == "m0 o0 w0 q0"
    assert names(waits, makes) == "m0 w0"
    assert names() == ""


@pytest.mark.parametrize(
    ("reason", "seconds"),
    [
        ("12 s: x", 12.0),
        ("4.5 s a case", 4.5),
        ("in real time on vcan0", UNSTATED_S),
        ("2 steps", UNSTATED_S),
    ],
)
def test_seconds_are_read_from_the_reason(reason, seconds):
    assert stated_seconds(reason) == seconds
