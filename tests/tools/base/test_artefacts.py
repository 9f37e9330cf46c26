"""Files are written whole or not at all, and nothing that is not ours is replaced."""

import json
import os
import subprocess
import sys
import threading

import numpy as np
import pytest

from lpvguard.base import artefacts
from lpvguard.base.errors import InputError


def test_a_pipe_is_written_to_and_stays_a_pipe(tmp_path):
    pipe, got = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: got.append(pipe.read_text()))
    reader.start()
    artefacts.write_file(pipe, "verdict\n", "report")
    reader.join(timeout=10)
    assert got == ["verdict\n"] and pipe.is_fifo()


def test_a_failing_block_leaves_the_old_folder_and_no_scratch(tmp_path):
    target = tmp_path / "out"
    with artefacts.new_folder(target, "sim") as folder:
        artefacts.write_files(folder, {"MANIFEST.json": artefacts.manifest("sim"), "a.txt": "old"})
    with pytest.raises(RuntimeError), artefacts.new_folder(target, "sim") as folder:
        artefacts.write_files(folder, {"a.txt": "new"})
        raise RuntimeError
    assert (target / "a.txt").read_text() == "old" and [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_place_that_cannot_be_written_is_an_input_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        artefacts.write_file(tmp_path / "file" / "x.json", "{}", "replay")


def test_json_is_strict_and_plain():
    text = artefacts.to_json({"a": np.array([1.0, np.nan]), "b": np.int64(3), "c": 1 + 2j})
    assert '"a": [1.0, null]' in text and '"b": 3' in text and "NaN" not in text


def test_short_values_share_lines_of_json():
    value = {"names": [f"drive {k:02}" for k in range(30)], "rows": [[0.1] * 20, {"x": [1, 2]}]}
    text = artefacts.to_json(value)
    lines = text.splitlines()
    assert json.loads(text) == value
    assert max(map(len, lines)) <= 100
    assert lines[-4:-1] == ["  ],", '  {"x": [1, 2]}', " ]"]


WINDOWS = """
import ctypes, errno, fcntl, hashlib, os, platform, shutil, signal, subprocess, sys, tempfile, types
from pathlib import Path
import numpy

def locking(handle, mode, count):
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise PermissionError(errno.EACCES, "locked") from None

def nameless(name, **_):
    raise TypeError("no library without a name")

def open_file(path, *words, **at):
    if not at and os.path.isdir(path):  # with dir_fd it is rmtree as it works here
        raise PermissionError(errno.EACCES, "a folder", str(path))
    return opened(path, *words, **at)

opened, os.open, ctypes.CDLL = os.open, open_file, nameless
sys.modules["msvcrt"] = types.SimpleNamespace(locking=locking, LK_NBLCK=2)
sys.modules["fcntl"], sys.platform = None, "win32"
del signal.pthread_sigmask, signal.SIGHUP, os.O_DIRECTORY, os.O_NOFOLLOW
from lpvguard.base import artefacts, native
from lpvguard.base.errors import InputError

for text in ("old", "new"):
    with artefacts.new_folder(Path("out"), "sim") as folder:
        artefacts.write_files(folder, {"MANIFEST.json": artefacts.manifest("sim"), "a.txt": text})
print(Path("out/a.txt").read_text(), sorted(os.listdir(".")))
Path(".mine.lpvguard").mkdir()
Path(".mine.lpvguard/new").write_text("mine")
try:
    with artefacts.claimed(Path("mine")):
        pass
except InputError as error:
    print(".mine.lpvguard" in str(error), os.listdir(".mine.lpvguard"))
with artefacts.claimed(Path("held")):
    print("held", flush=True)
    sys.stdin.read()
print(sorted(os.listdir(".")))
"""


def test_folders_are_written_and_held_where_the_system_has_no_posix_calls(tmp_path):
    """The branch for Windows, with what Windows lacks taken away and `msvcrt.locking` made of flock."""

    def start() -> subprocess.Popen:
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        return subprocess.Popen([sys.executable, "-c", WINDOWS], cwd=tmp_path, text=True, **pipes)

    with start() as first:
        assert first.stdout.readline() == "new ['out']\n", first.stderr.read()
        assert first.stdout.readline() == "True ['new']\n"
        assert first.stdout.readline() == "held\n"
        (tmp_path / ".mine.lpvguard" / "new").unlink()
        (tmp_path / ".mine.lpvguard").rmdir()
        with start() as second:
            said = second.communicate()[1]
        assert "held by another run" in said
        rest, said = first.communicate()
        assert said == "" and first.returncode == 0 and "held.lpvguard" not in rest
