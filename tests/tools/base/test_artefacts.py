"""Files are written whole or not at all, and nothing that is not ours is replaced."""

from __future__ import annotations

import os
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
    assert '"a": [\n  1.0,\n  null\n ]' in text and '"b": 3' in text and "NaN" not in text
