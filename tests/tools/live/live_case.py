"""What the tests of the live page share: sources that the test feeds, and the page while it is served."""

import asyncio
import threading
import urllib.request
from contextlib import contextmanager

from lpvguard.can.logs import Frames
from lpvguard.extras.live.server import serve
from lpvguard.extras.live.watch import Watch


class Given:
    """Pieces of frames, then silence for ever; ``taken`` is set when the last was taken."""

    name, lost, trouble = "given", 0, ""

    def __init__(self, pieces=()):
        self._pieces, self.taken = pieces, threading.Event()

    def pieces(self):
        yield from self._pieces
        self.taken.set()
        while not threading.Event().wait(0.01):
            yield None


def cut(frames: Frames, size: int) -> list[Frames]:
    return [frames.at(slice(a, a + size)) for a in range(0, len(frames), size)]


@contextmanager
def served(watch: Watch):
    """The URL of the page of ``watch`` while it is served."""
    loop_ends_url, ready = [], threading.Event()

    async def main():
        ends = asyncio.Event()
        loop_ends_url.extend([asyncio.get_running_loop(), ends])
        await serve(watch, 0, lambda url: (loop_ends_url.append(url), ready.set()), ends)

    thread = threading.Thread(target=lambda: asyncio.run(main()))
    thread.start()
    assert ready.wait(60)
    try:
        yield loop_ends_url[2]
    finally:
        loop_ends_url[0].call_soon_threadsafe(loop_ends_url[1].set)
        thread.join(60)
    assert not thread.is_alive()


def asked(url: str, **headers: str) -> bytes:
    with urllib.request.urlopen(urllib.request.Request(url, headers=headers)) as answer:
        return answer.read()
