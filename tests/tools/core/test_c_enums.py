"""Names of the core's enumerations, read from its headers."""

from __future__ import annotations

import pytest

from lpvguard.base.errors import InputError
from lpvguard.core import compiled as core
from lpvguard.core.c_enums import enum_names

HEADER = """typedef enum lpvg_gear_t {
    lpvg_gear_park = 0,     ///< Zero = rest, always.
    lpvg_gear_drive  = 1,
    lpvg_gear_count = 2
} lpvg_gear_t;
"""


def test_names_come_in_the_order_of_their_values_without_the_count(tmp_path):
    (tmp_path / "gear.h").write_text(HEADER)
    assert enum_names(tmp_path / "gear.h", "lpvg_gear_t") == ("park", "drive")


@pytest.mark.parametrize(
    ("old", "new"),
    [("drive  = 1", "drive = 3"), ("lpvg_gear_t {", "lpvg_gears_t {"), ("lpvg_gear_park", "park")],
)
def test_a_header_that_does_not_say_so_is_refused(tmp_path, old, new):
    (tmp_path / "gear.h").write_text(HEADER.replace(old, new))
    with pytest.raises(InputError, match=r"gear\.h: lpvg_gear_t"):
        enum_names(tmp_path / "gear.h", "lpvg_gear_t")


def test_the_documented_words_of_the_replay_are_those_of_the_headers():
    assert core.VERDICTS == ("unknown", "valid", "invalid", "not_judged", "stale", "fault")
    assert core.REASONS == ("none", "not_excited", "speed_moved", "out_of_range", "settling")
    assert core.TESTS == ("frame", "energy") and core.SUPERVISION == ("off", "hold", "live")
    assert len(core.STATUSES) == 12 and core.STATUSES[-1] == "not_ready"
    assert len(core.EVENTS) == 18 and core.EVENTS[-1] == "lost"
