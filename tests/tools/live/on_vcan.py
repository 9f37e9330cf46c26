"""Runs under tools/with-vcan: `lpvguard live` beside a source that is killed, stays away and begins again
while a flood goes on. JSON to stdout.

python on_vcan.py FLOOD LIVE_ARGUMENTS... -- SOURCE_COMMAND...

FLOOD: a command in one word, which sends onto vcan0, or empty.
"""

import json
import re
import signal
import subprocess
import sys
import time
import urllib.request

KILL_AFTER_S, PATIENCE_S = 6.0, 240.0
"""The source's own time at which it is killed the first time; how long anything may take."""


def main() -> None:
    flood, *words = sys.argv[1:]
    at = words.index("--")
    live, source = words[:at], words[at + 1 :]
    command = [sys.executable, "-m", "lpvguard.cli", "live", *live]
    page = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    said = page.stderr.readline()
    url = re.search(r"http://\S+/", said)
    assert url, said + page.stderr.read()

    def view() -> dict:
        with urllib.request.urlopen(url[0] + "view?span=3600", timeout=60) as answer:
            return json.loads(answer.read())

    def until(what) -> dict:
        ends = time.monotonic() + PATIENCE_S
        while time.monotonic() < ends:
            if what(now := view()):
                return now
            time.sleep(0.2)
        raise AssertionError(f"waited {PATIENCE_S} s; now {now['now']}")

    first = subprocess.Popen(source, stdout=subprocess.DEVNULL)
    killed = until(lambda v: (v["now"]["t"] or 0) > KILL_AFTER_S and not v["now"]["silent"])
    first.kill()
    first.wait()
    silent = until(lambda v: v["now"]["silent"])
    interface = ["ip", "link", "set", "vcan0"]
    subprocess.run([*interface, "down"], check=True)
    time.sleep(1.5)
    away = view()
    subprocess.run([*interface, "up"], check=True)
    time.sleep(1.5)
    back = view()
    flooding = subprocess.Popen(flood.split()) if flood else None
    second = subprocess.run(source, stdout=subprocess.PIPE, text=True, check=False)
    time.sleep(1.0)
    after = view()
    if flooding:
        flooding.kill()
        flooding.wait()
    page.send_signal(signal.SIGINT)
    status = page.wait(60)
    views = {"killed": killed, "silent": silent, "away": away, "back": back, "after": after}
    print(json.dumps({"views": views, "source": second.stdout, "status": status}))


if __name__ == "__main__":
    main()
