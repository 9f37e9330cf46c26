"""The ROS 2 node of the examples, compiled against a stub of rclcpp's interface; no ROS runs here."""

import re
import subprocess

import numpy as np
import pytest

from lpvguard import __version__
from lpvguard.base import native
from lpvguard.core.compiled import VERDICTS, core_objects
from lpvguard.drives.tables import read_drive
from lpvguard.replay.ros import LEVELS, STALE
from made import ROOT

pytestmark = pytest.mark.slow("5 s: the node and the core are compiled")
EXAMPLE, STUB = ROOT / "tools" / "examples" / "ros2", ROOT / "tests" / "consumer" / "rclcpp_stub"
INCLUDE = re.compile(r"^#include <(\S+\.hpp)>", re.MULTILINE)
STRICT = ("-std=c++17", "-Wall", "-Wextra", "-Werror")


@pytest.fixture(scope="module")
def program(vehicle, tmp_path_factory):
    """The node in a program that feeds it; each header of ROS is a line that includes the stub."""
    folder = tmp_path_factory.mktemp("ros")
    node = (EXAMPLE / "monitor_node.cpp").read_text()
    for header in INCLUDE.findall(node):
        (folder / header).parent.mkdir(parents=True, exist_ok=True)
        (folder / header).write_text(f'#include "{STUB}/stub.hpp"\n')
    flags = [*STRICT, f"-I{folder}", f"-I{EXAMPLE}"]
    objects = core_objects(vehicle, [STUB / "run.cpp"], flags=flags)
    return native.compile_executable(objects, name="ros_node")


def diagnostics(program, rows: np.ndarray, arrives) -> list[tuple[float, int, str]]:
    """Time in s, level and text of each diagnostic that the node sends."""
    table = "\n".join(
        f"{' '.join(map(repr, row.tolist()))} {int(here)}" for row, here in zip(rows, arrives, strict=True)
    )
    done = subprocess.run([program], input=table, capture_output=True, text=True, check=True)
    lines = [line.split("|")[0].split(" ", 2) for line in done.stdout.splitlines()]
    return [(int(t) * 1e-9, int(level), text) for t, level, text in lines]


@pytest.fixture(scope="module")
def faulty(g80, synthetic) -> np.ndarray:
    """Rows of time, speed, angle and yaw rate, which loses half of its gain in the middle."""
    drive = read_drive(synthetic / "synthetic_01.csv", g80)
    y = drive.y.copy()
    y[len(y) // 2 :] *= 0.5
    return np.column_stack([drive.t, drive.v, drive.u, y])


def test_the_node_says_what_the_core_says(program, core, faulty):
    rows = faulty.astype(np.float32).astype(float)
    rows[:, 0] = faulty[:, 0]
    verdict = core.monitor().run(rows[:, 0], rows[:, 1], rows[:, 2:3], rows[:, 3:]).verdict
    changes = np.flatnonzero(np.diff(verdict, prepend=0))
    said = diagnostics(program, rows, np.ones(len(rows)))
    expected = [(rows[k, 0], VERDICTS[verdict[k]].replace("_", " ")) for k in changes]
    times, _, texts = zip(*said, strict=True)
    first = [k for k, text in enumerate(texts) if k == 0 or text != texts[k - 1]]
    changed = [(times[k], texts[k]) for k in first if texts[k] != "unknown"]
    assert changed == [(pytest.approx(t, abs=1e-6), text) for t, text in expected]
    assert all(level == LEVELS.get(text.replace(" ", "_"), STALE) for _, level, text in said)
    assert np.diff(times).max() <= 1.0 + 1e-6 and "invalid" in texts


def test_a_lost_message_ends_in_stale(program, faulty):
    rows = faulty[:1000]
    arrives = rows[:, 0] < 10.0
    said = diagnostics(program, rows, arrives)
    lost = next(t for t, _, text in said if text == "stale")
    assert 10.0 < lost < 10.4


def test_the_example_is_short_and_states_the_packages_it_includes():
    node = (EXAMPLE / "monitor_node.cpp").read_text()
    assert len(node.splitlines()) <= 150
    package, build = ((EXAMPLE / name).read_text() for name in ("package.xml", "CMakeLists.txt"))
    for header in INCLUDE.findall(node):
        name = header.split("/")[0]
        assert f"<depend>{name}</depend>" in package and name in build
    assert f"<version>{__version__}</version>" in package
