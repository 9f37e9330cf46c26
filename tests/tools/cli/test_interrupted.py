"""Commands that are killed, or find the disk full, leave the old result or the new one (interrupted.py does
it and judges)."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("interrupted.py")
FULL = os.environ.get("LPVGUARD_FULL") == "1"


def interrupted(*words: object) -> dict:
    done = subprocess.run(
        [sys.executable, SCRIPT, *map(str, words)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.unhurried
@pytest.mark.parametrize(
    "command",
    [
        "replay",
        pytest.param("export", marks=pytest.mark.long("12 s: a process for every step")),
        pytest.param("campaign", marks=pytest.mark.long("25 s: a process for every step")),
    ],
)
def test_no_step_at_which_a_command_ends_leaves_a_torn_result(command):
    """Each of the three ways to end at a third of the steps, together at all; all at all with
    LPVGUARD_FULL=1."""
    report = interrupted("steps", 1 if FULL else 3, command)
    assert report["runs"] >= (30 if FULL else 10) and report["torn"] == [] and report["missed"] == []


@pytest.mark.long("14 s: a process for every instant")
def test_no_random_instant_does():
    count = 200 if FULL else 8
    report = interrupted("kills", 1, count)
    assert report["runs"] == count and report["torn"] == []
    assert report["fell"]["while it wrote"] > count / 4, "kills after the end prove nothing"
