"""Files that others wrote, damaged: a reader answers or refuses with what, where and what was expected."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from foreign_input import parse_candump_slowly

from lpvguard.base.errors import InputError, InputWarning
from lpvguard.can.logs import candump_frames, read_log
from lpvguard.vehicle.nominal import evaluate

CASES = 4000 if os.environ.get("LPVGUARD_FULL") == "1" else 60
MOST_MIB = 1024


@pytest.mark.slow("10 s: 20 kinds of files, each damaged in many ways")
def test_damaged_files_are_answered_or_refused(identified, tmp_path):
    program = Path(__file__).with_name("foreign_input.py")
    said = subprocess.run(
        [sys.executable, program, identified, tmp_path, "11", str(CASES)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, [Path(__file__).parents[1], *sys.path]))},
    )
    print(said.stdout)
    assert said.returncode == 0, said.stderr[-4000:]
    counts = re.findall(r"^(\S+): (\d+) read, (\d+) answered, (\d+) refused$", said.stdout, re.MULTILINE)
    assert len(counts) == 20
    assert all(int(read) == CASES for _, read, _, _ in counts)
    assert {name for name, _, _, refused in counts if refused == "0"} <= {"own.dbc"}  # a line costs itself
    assert int(re.search(r"^peak: (\d+) MiB$", said.stdout, re.MULTILINE)[1]) < MOST_MIB


BORDER_LINES = (
    (b"(1.5) can0 123#00", 1),
    (b"  (1.5)  can0  123#0011_0 T", 1),
    (b"(1.5) can0 123#00\r", 1),
    (b"(1.5) can0 123#00\r\r", 0),
    (b"(1.5)can0 123#00", 0),
    (b"(1.5) can0123#00", 0),
    (b"(1.5) ca\tn 123#00", 0),
    (b"(1.5) " + b"c" * 15 + b" 123#00", 1),
    (b"(1.5) " + b"c" * 16 + b" 123#00", 0),
    (b"(1.5) " + b"c" * 16 + b" 123#R", 0),
    (b"(01.5) can0 123#00", 1),
    (b"(00000000001.5) can0 123#00", 0),
    (b"(9000000000.0) can0 123#00", 1),
    (b"(9000000001.0) can0 123#00", 0),
    (b"(1.1234567890) can0 123#00", 0),
    (b"(1.5) can0 1234#00", 0),
    (b"(1.5) can0 123#0", 0),
    (b"(1.5) can0 123##1" + b"00" * 64, 1),
    (b"(1.5) can0 123##1" + b"00" * 65, 0),
)


@pytest.mark.parametrize(("line", "frames"), BORDER_LINES)
def test_both_readers_of_candump_draw_the_same_borders(line, frames):
    text = np.frombuffer(line, np.uint8)
    for read in (candump_frames, parse_candump_slowly):
        log = read(text)
        assert len(log) == frames
        assert log.left_out.get("lines that are no frame", 0) == 1 - frames


def test_both_readers_of_candump_know_as_many_interfaces():
    text = np.frombuffer(b"".join(b"(1.5) can%d 123#00\n" % k for k in range(70)), np.uint8)
    for read in (candump_frames, parse_candump_slowly):
        log = read(text)
        assert (len(log), log.left_out["lines that are no frame"]) == (64, 6)


@pytest.mark.parametrize(
    "expression", ["v\0", "(" * 500, "1/0", "9**9**9**9", "0 ** -1", "1e400 if v else v"]
)
def test_an_expression_without_a_value_is_refused(expression):
    with pytest.raises(InputError, match="here"):
        evaluate(expression, {"v": np.array([1.0])}, "here")


def test_a_frame_with_more_bits_than_can_has_is_refused(tmp_path):
    path = tmp_path / "wide.csv"
    path.write_text(
        "timestamp,arbitration_id,extended,remote,error,dlc,data\n1.0,0x1E99C0DE00,1,0,0,1,AA==\n"
    )
    with pytest.raises(InputError, match="0x1e99c0de00 has too many bits"):
        read_log(path)


@pytest.mark.parametrize("header", ["t,v,v", "t,t,v"])
def test_two_columns_of_one_name_are_told_apart_and_named(header, tmp_path):
    path = tmp_path / "twice.csv"
    path.write_text(f"{header}\n0.0,1.0,2.0\n")
    with pytest.warns(InputWarning, match="header, line 1: columns of the same name"):
        read_log(path)
