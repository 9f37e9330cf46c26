"""The stranger, by the tutorial alone: every command that tools/TUTORIAL.md shows runs in its order on
logs of a car, ends as shown, and says what is shown."""

import csv
import json
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from made import ROOT

TUTORIAL = ROOT / "tools" / "TUTORIAL.md"
BLOCK = re.compile(r"^```console\n(.*?)^```$", re.MULTILINE | re.DOTALL)
DECIMAL = re.compile(r"-?\d+\.\d+")
TOKEN = re.compile(rf"{DECIMAL.pattern}|\w+|[^\w\s]")
STATUS = re.compile(r"# exit (\d)")


@dataclass(frozen=True)
class Shown:
    """A command as shown: words after the program's name, exit status, and the lines of its output."""

    words: list[str]
    status: int
    lines: list[str]


def shown(text: str) -> list[Shown]:
    """Commands of a document's console blocks, in order; "..." stands for lines that are not shown."""
    commands = []
    for block in BLOCK.findall(text):
        for piece in re.split(r"^\$ ", block.replace("\\\n", " "), flags=re.MULTILINE)[1:]:
            command, *lines = piece.splitlines()
            program, *words = shlex.split(command, comments=True)
            assert program == "lpvguard", f"no command of this package: {command}"
            status = STATUS.search(command)
            shown_lines = [line for line in lines if line != "..."]
            commands.append(Shown(words, int(status[1]) if status else 0, shown_lines))
    return commands


def missing(said: str, lines: list[str]) -> list[str]:
    """Shown lines that were not said. The console's width does not count, nor do the last digits of decimals:
    another processor may round otherwise."""
    words = TOKEN.findall(said)

    def was_said(line: str) -> bool:
        wanted = TOKEN.findall(line)
        places = range(len(words) - len(wanted) + 1)
        return any(all(map(_same, wanted, words[k : k + len(wanted)])) for k in places)

    return [line for line in lines if not was_said(line)]


def _same(wanted: str, word: str) -> bool:
    if not (DECIMAL.fullmatch(wanted) and DECIMAL.fullmatch(word)):
        return wanted == word
    return float(word) == pytest.approx(float(wanted), rel=0.01)


def test_commands_statuses_and_output_are_read_from_a_document():
    block = "$ lpvguard a \\\n    'b c'   # exit 1: why\nsaid\n...\n$ lpvguard d\n"
    assert shown(f"Words.\n```console\n{block}```\n") == [
        Shown(["a", "b c"], 1, ["said"]),
        Shown(["d"], 0, []),
    ]
    with pytest.raises(AssertionError, match="no command of this package: rm x"):
        shown("```console\n$ rm x\n```\n")


def test_a_line_that_was_not_said_is_found():
    lines = ["was said", "was never said", "L 0.3057 m", "L 0.33 m", "drive_4-2 0.3"]
    said = "as it was\nsaid by it; L   0.3056 m; drive_4-1 0.3"
    assert missing(said, lines) == ["was never said", "L 0.33 m", "drive_4-2 0.3"]


@pytest.mark.long("100 s: fit, identification and evaluation of 16 recordings")
def test_a_car_goes_from_its_logs_to_its_page(measured, lpvguard, few_baselines, tmp_path):
    _follow_the_tutorial(measured, tmp_path, lambda words: lpvguard(*words, cwd=tmp_path))


@pytest.mark.long("40 s: fit and identification of 22 recordings")
def test_a_car_whose_drives_differ_as_a_fault_would_is_silent(race_car, lpvguard, tmp_path):
    (tmp_path / "logs").symlink_to(race_car)
    at = {"cwd": tmp_path}
    assert lpvguard("new", "racer", "logs", "--wheelbase", "0.33", "-o", "racer", **at).returncode == 0
    fitted = lpvguard("fit", "--vehicle", "racer/racer.toml", "racer/drives", "-o", "fitted", **at)
    assert fitted.returncode == 1 and "differs between days or groups" in fitted.stdout + fitted.stderr
    done = lpvguard("identify", "--vehicle", "fitted/racer.toml", "racer/drives", "-o", "found", **at)
    assert done.returncode == 0
    seen = json.loads((tmp_path / "found" / "visibility.json").read_text())
    limit = np.array([c["limit"] for c in seen["at_percentile"]], float)
    ours = np.array([c["gain_error"] for c in seen["at_percentile"]], float)
    assert (limit <= 0.3).sum() <= 2 and np.isfinite(limit).sum() > 15
    assert not (ours[:, 1:] <= 0.3).any()  # the change test sees steady turns


@pytest.mark.long("10 min: packages installed, and every command in a process of its own")
def test_the_installed_wheel_follows_the_tutorial_without_a_compiler(measured, tmp_path):
    built = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", tmp_path]
    subprocess.run([*built, ROOT / "tools"], check=True)
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.stat().st_size < 25e6
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    programs = tmp_path / "venv" / "bin"
    subprocess.run([programs / "pip", "install", "-q", f"{wheel}[compiler]"], check=True)
    alone = {"PATH": str(programs), "HOME": str(tmp_path), "LPVGUARD_CACHE": str(tmp_path / "cache")}

    def run(words):
        command = [programs / "lpvguard", *words]
        return subprocess.run(command, cwd=tmp_path, env=alone, capture_output=True, text=True, check=False)

    _follow_the_tutorial(measured, tmp_path, run)


def _follow_the_tutorial(drives: Path, folder: Path, run) -> None:
    (folder / "logs").mkdir()
    names = list(csv.DictReader((drives / "experiments.csv").open()))
    for name in names:
        (folder / "logs" / f"{name['experiment']}.csv").symlink_to(drives / f"{name['experiment']}.csv")
    commands = shown(TUTORIAL.read_text(encoding="utf-8"))
    verbs = [c.words[0] for c in commands]
    chain = ["new", "fit", "identify", "export", "replay", "evaluate", "report"]
    assert [v for v in verbs if v in chain] == chain
    for command in commands:
        done = run(command.words)
        assert done.returncode == command.status, (command.words, done.stderr)
        assert missing(done.stdout + done.stderr, command.lines) == [], command.words
    _of_use(folder)


def _of_use(folder: Path) -> None:
    """What the chain found is what is known of this car, and all drives are judged."""
    fitted = json.loads((folder / "fitted" / "fit.json").read_text())
    values = {u["name"]: u["value"] for u in fitted["unknowns"]}
    assert 2.4 < values["L"] < 2.8 and 0.02 < values["input_delay_s"] < 0.05
    assert len(fitted["unseen"]) == 9 and min(q["vaf"][0] for q in fitted["unseen"]) > 0.99
    assert 1.0 <= json.loads((folder / "identified" / "calibration.json").read_text())["threshold"] < 3.0
    seen = json.loads((folder / "identified" / "visibility.json").read_text())
    gains = [g for c in seen["at_percentile"] for g in c["gain_error"] if g is not None]
    assert sum(g <= 0.3 for g in gains) >= 15, "the monitor sees 30 % at the frequencies that drivers use"
    evaluated = json.loads((folder / "evaluated.json").read_text())
    assert len(evaluated["drives"]) - len(evaluated["without_faults"]) >= 4
    assert any(row["fault"] == "output + 0.5 of its spread" for row in evaluated["faults"])
    assert (folder / "page.html").stat().st_size > 100_000
