"""The core's rooms: which source or header may include which.

python tests/tools/test_core_rooms.py        prints what breaks a rule
"""

import re
import shutil
from pathlib import Path

import pytest

LIB = Path(__file__).resolve().parents[2] / "lib"
ORDER = ("monitor", "guard", "services")
"""Lowest first: a file includes only files of its own room and of rooms before it. So nothing of the core
includes a service, and the monitor alone is an image."""
HEADERS = {
    "bus.h": "guard",
    "cause.h": "monitor",
    "config.h": "monitor",
    "findings.h": "guard",
    "status.h": "monitor",
}
"""Rooms of the public headers that no source is named after."""
INCLUDE = re.compile(r'^#include "([^"]+)"', re.MULTILINE)


def rooms(lib: Path) -> dict[Path, str]:
    """File of the core -> its room; a public header's room is that of the source of its name."""
    sources = {path: path.parent.name for path in sorted((lib / "src").rglob("*.[ch]pp"))}
    named = HEADERS | {f"{path.stem}.h": room for path, room in sources.items() if path.suffix == ".cpp"}
    headers = sorted((lib / "include" / "lpvguard").glob("*.h"))
    return sources | {path: named.get(path.name, "") for path in headers}


def faults(lib: Path) -> list[str]:
    """Every file without a room, and every include of a room above."""
    room_of = rooms(lib)
    wrong = [f"{path.name} stands in no room" for path, room in room_of.items() if room not in ORDER]
    for path, room in room_of.items():
        for name in INCLUDE.findall(path.read_text(encoding="utf-8")):
            places = (lib / "include" / name, lib / "src" / name, path.parent / name)
            other = next((room_of[place] for place in places if place in room_of), room)
            if room in ORDER and other in ORDER[ORDER.index(room) + 1 :]:
                wrong.append(f"{path.name} of {room} includes {name} of {other}")
    return wrong


def test_a_file_includes_only_files_of_its_room_and_of_rooms_below():
    assert faults(LIB) == []


@pytest.mark.parametrize(
    "file, line, said",
    [
        ("src/guard/ecu.cpp", "lpvguard/xcp.h", "ecu.cpp of guard includes lpvguard/xcp.h of services"),
        (
            "include/lpvguard/monitor.h",
            "lpvguard/diagnosis.h",
            "monitor.h of monitor includes lpvguard/diagnosis.h of services",
        ),
        (
            "src/monitor/model.cpp",
            "guard/control_begin.hpp",
            "model.cpp of monitor includes guard/control_begin.hpp of guard",
        ),
        ("include/lpvguard/other.h", "lpvguard/status.h", "other.h stands in no room"),
    ],
)
def test_a_planted_include_is_found(tmp_path, file, line, said):
    for folder in ("src", "include"):
        shutil.copytree(LIB / folder, tmp_path / folder)
    with (tmp_path / file).open("a") as stream:
        stream.write(f'#include "{line}"\n')
    assert faults(tmp_path) == [said]


if __name__ == "__main__":
    print("\n".join(faults(LIB)))
