"""Services of the operating system for writing files. No other module asks for the system.

It gives a lock that ends with its process, exchanges two names in one step, forces a file onto the disk and
puts signals off. Linux has all of it. On other systems:

    exchange    False: the caller then renames twice
    undisturbed Windows: does nothing; Ctrl-C may end a program within the block
    sync        Windows: files only, because a folder cannot be opened there
    rename_over Windows: removes an empty folder first, in a separate step
    locks       Windows: `msvcrt.locking` on a file of the folder, because a folder cannot be locked there
"""

import ctypes
import errno
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

if sys.platform == "win32":
    import msvcrt
    import time

    ENDING_SIGNALS = (signal.SIGTERM,)
else:
    import fcntl

    ENDING_SIGNALS = (signal.SIGTERM, signal.SIGHUP)
    """Signals that end a program unless it asks for them."""

_RENAME_EXCHANGE, _AT_FDCWD = 2, -100
_POLL_S = 0.1
"""Pause between two tries for a lock, where the system cannot wait for one."""


def lock_folder(folder: Path, file: str) -> int | None:
    """Lock an existing folder for this process.

    Returns a handle for `unlock_folder`, or None when another process holds it. The kernel unlocks it when
    the process ends. ``file`` names a file in the folder that carries the lock where a folder cannot. Raises
    FileNotFoundError when the folder vanished.
    """
    if sys.platform == "win32":
        handle = os.open(folder / file, os.O_RDWR | os.O_CREAT)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
            return handle
        except OSError:
            os.close(handle)
            return None
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(handle), folder.lstat()):
            return handle
    except BlockingIOError:
        os.close(handle)
        return None
    except BaseException:
        os.close(handle)
        raise
    os.close(handle)
    raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(folder))


def unlock_folder(handle: int, folder: Path, file: str) -> None:
    """Unlock and remove a folder of `lock_folder`. Raises OSError when anything but the lock is in it."""
    if sys.platform == "win32":
        os.close(handle)  # an open file cannot be removed there
        (folder / file).unlink()
        folder.rmdir()
        return
    try:
        folder.rmdir()
    finally:
        os.close(handle)


@contextmanager
def locked_file(path: Path) -> Iterator[IO[str]]:
    """Make a file on demand and lock it for the block; other processes wait."""
    with path.open("w") as stream:
        if sys.platform == "win32":
            while True:
                try:
                    msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
                    break
                except OSError:
                    time.sleep(_POLL_S)
        else:
            fcntl.flock(stream, fcntl.LOCK_EX)
        yield stream


def open_standard_streams() -> None:
    """Open an empty stream for each missing standard input, output or error.

    Otherwise the next opened file takes the stream's number, and a compiler's messages go into it.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest free number: this one
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))


@contextmanager
def undisturbed() -> Iterator[None]:
    """Put off the signals that end a program until the block is through.

    Handlers wait, because Python calls them in the main thread even for a blocked signal. Threads other than
    the main one need nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {number: signal.getsignal(number) for number in (*ENDING_SIGNALS, signal.SIGINT)}
    before = {number: handler for number, handler in before.items() if handler is not None}
    try:
        for number in before:
            signal.signal(number, lambda number, _: came.append(number))
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for late in came:
            signal.raise_signal(late)


def sync(path: Path) -> None:
    """Force a file, or the names in a folder, onto the disk."""
    if sys.platform == "win32":
        if path.is_dir():
            return
        handle = os.open(path, os.O_RDWR)  # a handle for reading alone cannot be synced there
    else:
        handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def exchange(a: Path, b: Path) -> bool:
    """Exchange two names in one step; False where the system cannot. Raises OSError when it fails."""
    try:
        call = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):  # TypeError: Windows has no library without a name
        return False
    if call(_AT_FDCWD, os.fsencode(a), _AT_FDCWD, os.fsencode(b), _RENAME_EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP):
        return False
    raise OSError(code, os.strerror(code), str(b))


def rename_over(new: Path, place: Path) -> None:
    """Rename to a name that is free, a file or an empty folder."""
    if sys.platform == "win32" and place.is_dir():
        place.rmdir()
    new.replace(place)
