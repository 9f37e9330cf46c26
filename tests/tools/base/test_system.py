"""What the operating system does for the package: signals that wait."""

import os
import signal
import threading

import pytest

from lpvguard.base import system


@pytest.fixture
def ended(monkeypatch):
    """Signals that came through to the program's own handler, in order."""
    seen: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: seen.append(number))
    yield seen
    signal.signal(signal.SIGTERM, before)


def test_a_signal_waits_for_the_end_of_the_block_beside_a_second_thread(ended):
    done = threading.Event()
    beside = threading.Thread(target=done.wait)
    beside.start()
    try:
        with system.undisturbed():
            os.kill(os.getpid(), signal.SIGTERM)
            assert sum(range(100_000)) and ended == []
        assert ended == [signal.SIGTERM]
    finally:
        done.set()
        beside.join()


def test_a_block_without_a_signal_leaves_the_handlers_as_they_were(ended):
    handlers = {number: signal.getsignal(number) for number in (*system.ENDING_SIGNALS, signal.SIGINT)}
    with pytest.raises(OSError), system.undisturbed():
        raise OSError
    assert {number: signal.getsignal(number) for number in handlers} == handlers and ended == []
