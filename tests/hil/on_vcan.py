"""Runs under tools/with-vcan: the loop as two processes on vcan0 in real time, with other programs on the
same bus. JSON to stdout.

python on_vcan.py SIMULATOR_ARGUMENTS... -- AFTER_S FOR_S COMMAND [-- COMMAND]...

The commands start AFTER_S after the first frame of the loop and are ended FOR_S later; candump then logs the
end of it.
"""

import json
import subprocess
import sys
import time
from pathlib import Path

SENT = Path("/sys/class/net/vcan0/statistics/tx_packets")


def groups(words: list[str]) -> list[list[str]]:
    split: list[list[str]] = [[]]
    for word in words:
        if word == "--":
            split.append([])
        else:
            split[-1].append(word)
    return split


def main() -> None:
    simulator, (after_s, for_s, *first), *others = groups(sys.argv[1:])
    candump = subprocess.Popen(["candump", "-L", "-n", "1", "vcan0"], stdout=subprocess.PIPE)
    loop = subprocess.Popen(simulator, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    candump.wait(timeout=120)
    time.sleep(float(after_s))
    before, started = int(SENT.read_text()), time.monotonic()
    senders = [subprocess.Popen(command) for command in [first, *others] if command]
    time.sleep(float(for_s) - 0.3)
    tail = subprocess.Popen(["candump", "-L", "-T", "3000", "vcan0"], stdout=subprocess.PIPE)
    time.sleep(0.3)
    for sender in senders:
        sender.terminate()
        sender.wait()
    took, sent = time.monotonic() - started, int(SENT.read_text()) - before
    heard = tail.communicate()[0].decode()
    answer, complaint = loop.communicate(timeout=600)
    print(
        json.dumps(
            {
                "loop": json.loads(answer) if answer else complaint,
                "status": loop.returncode,
                "sent": sent,
                "took_s": took,
                "tail": heard,
            }
        )
    )


if __name__ == "__main__":
    main()
