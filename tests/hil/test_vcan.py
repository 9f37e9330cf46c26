"""A real vcan0 through tools/with-vcan: what we play, candump logs, and ingest reads back."""

import sys

import numpy as np
import pytest

from lpvguard.can.logs import read_log
from vcan import with_vcan

PLAYER = """
import subprocess, sys, time
import can, numpy as np
from lpvguard.can.play import frames_of_drive, play, write_candump
T = np.arange(0, 2, 0.02)
frames = frames_of_drive(T, {("VDC2", "yaw_rate"): 0.1 * np.sin(T), ("CCVS1", "wheel_based_speed"): 54 + T})
write_candump(frames, sys.argv[1])
with open(sys.argv[2], "wb") as out:
    logger = subprocess.Popen(["candump", "-L", "-n", str(len(frames) + 1), "-T", "20000", "vcan0"],
        stdout=out,
    )
    with can.Bus("vcan0", interface="socketcan", receive_own_messages=False) as bus:
        time.sleep(0.5)                       # candump is listening
        subprocess.run(["cansend", "vcan0", "123#DEADBEEF"], check=True)
        play(frames, bus, speed=4.0)
    logger.wait(timeout=30)
"""


@pytest.mark.slow("10 s: a drive on a kernel's bus")
@pytest.mark.serial
def test_what_is_played_is_what_candump_logs_and_ingest_reads(tmp_path):
    (tmp_path / "player.py").write_text(PLAYER)
    done = with_vcan(sys.executable, tmp_path / "player.py", tmp_path / "sent.log", tmp_path / "logged.log")
    assert done.returncode == 0, done.stderr
    sent, logged = read_log(tmp_path / "sent.log"), read_log(tmp_path / "logged.log")
    assert logged.id[0] == 0x123 and logged.data[0, :4].tobytes().hex() == "deadbeef"
    assert np.array_equal(logged.id[1:], sent.id) and np.array_equal(logged.data[1:], sent.data)
