"""Runs under tools/with-vcan: pyxcp reads an emulated ECU on vcan0. JSON to stdout.

python xcp_on_vcan.py '{"command": [..], "input": "..", "steps": N, "vdc2": ID, "list": [..], "read": [..]}'

``list`` holds names, addresses and types to record, ``read`` addresses and lengths to read at the end.
"""

import json
import subprocess
import sys
from pathlib import Path

import can

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from xcp_master import PATIENCE_S, Rows, master


def main() -> None:
    asked = json.loads(sys.argv[1])
    with can.Bus(interface="socketcan", channel="vcan0") as bus:
        emulator = subprocess.Popen(
            asked["command"], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            assert emulator.stdin
            emulator.stdin.write(asked["input"].encode())
            emulator.stdin.flush()
            if bus.recv(PATIENCE_S) is None:
                raise SystemExit("the emulated ECU says nothing")
            print(json.dumps(session(asked, bus)))
        finally:
            emulator.kill()
            emulator.wait()


def session(asked: dict, bus: can.Bus) -> dict:
    rows = Rows([tuple(one) for one in asked["list"]])
    with master(rows, interface="socketcan", channel="vcan0") as tool:
        tool.connect()
        name = tool.identifier(0)
        rows.setup()
        rows.start()
        for n in range(asked["steps"]):
            # Nothing sends faster than it is read: the controller's queue is short.
            bus.send(can.Message(arbitration_id=asked["vdc2"], is_extended_id=True, data=bytes(8)))
            rows.wait_for(n + 1)
        rows.stop()
        read = {place: bytes(tool.shortUpload(n, place)).hex() for place, n in asked["read"]}
        tool.disconnect()
    return {"name": name, "rows": rows.rows, "read": read}


if __name__ == "__main__":
    main()
