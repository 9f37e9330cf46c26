"""Names of the core's enumerations, read from its headers."""

import re

import pytest

from lpvguard.base.errors import InputError
from lpvguard.can.catalogue import load_catalogue
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


def test_members_may_share_a_part_of_the_types_name_only(tmp_path):
    (tmp_path / "gear.h").write_text(
        HEADER.replace("gear_t", "gear_lever_t").replace("gear_count", "gear_held")
    )
    assert enum_names(tmp_path / "gear.h", "lpvg_gear_lever_t") == ("park", "drive", "held")


@pytest.mark.parametrize(
    ("old", "new"),
    [("drive  = 1", "drive = 3"), ("lpvg_gear_t {", "lpvg_gears_t {"), ("lpvg_gear_park", "park")],
)
def test_a_header_that_does_not_say_so_is_refused(tmp_path, old, new):
    (tmp_path / "gear.h").write_text(HEADER.replace(old, new))
    with pytest.raises(InputError, match=r"gear\.h: lpvg_gear_t"):
        enum_names(tmp_path / "gear.h", "lpvg_gear_t")


def test_the_documented_words_of_the_replay_are_those_of_the_headers():
    assert core.VERDICTS == ("unknown", "valid", "invalid", "not_judged", "stale", "fault", "degraded")
    assert core.REASONS == ("none", "not_excited", "speed_moved", "out_of_range", "settling")
    assert core.TESTS == ("frame", "energy", "change") and core.SUPERVISION == ("off", "hold", "live")
    assert len(core.STATUSES) == 12 and core.STATUSES[-1] == "not_ready"
    assert len(core.EVENTS) == 18 and core.EVENTS[-1] == "lost"


LCM = sorted((core.firmware_root() / "lcm").glob("*.lcm"))
STATED = re.compile(r"(lpvg_\w+_t): ((?:\d+ \w+(?:, )?)+)")


def stated_otherwise(text: str) -> list[str]:
    """Enumerations of which a comment of ``text`` (`lpvg_verdict_t: 0 unknown, 1 valid`) says other members
    than the headers do."""
    include = core.library_root() / "include" / "lpvguard"
    wrong = []
    for name, said in STATED.findall(text):
        header = next(h for h in sorted(include.glob("*.h")) if f"typedef enum {name} " in h.read_text())
        members = ", ".join(f"{i} {member}" for i, member in enumerate(enum_names(header, name)))
        wrong += [] if said == members else [name]
    return wrong


def test_the_lcm_types_state_the_members_of_the_headers():
    assert [p.name for p in LCM if stated_otherwise(p.read_text())] == []
    named = [name for p in LCM for name, _ in STATED.findall(p.read_text())]
    assert sorted(named) == [
        *("lpvg_can_state_t", "lpvg_can_state_t", "lpvg_cause_t", "lpvg_reason_t", "lpvg_verdict_t")
    ]
    guard = next(p for p in LCM if p.name == "lpvguard_guard.lcm").read_text()
    assert stated_otherwise(guard.replace("3 not_judged", "3 not_known")) == ["lpvg_verdict_t"]
    assert stated_otherwise(guard.replace(", 2 live", "")) == ["lpvg_can_state_t"]


@pytest.mark.parametrize(
    ("signal", "names"), [("monitor_verdict", core.VERDICTS), ("supervision_state", core.SUPERVISION)]
)
def test_the_can_catalogue_states_the_members_of_the_headers(signal, names):
    report = load_catalogue().message("GUARD_OUT")
    values = next(s.values for s in report.signals if s.name == signal)
    assert values == {name: i for i, name in enumerate(names)}
