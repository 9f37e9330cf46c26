"""One map over drives: here, in processes of this machine, or on the machines of a Dask cluster.

Results come in the order of the items, whatever finishes first. Only a few items are under way or waiting at
any time, so memory does not grow with their number. This package joins results by maxima, sums of whole
numbers and selections by a key. These reductions are associative and exact: bounds are the same bits for any
number of workers and any order of drives.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from itertools import islice
from typing import Any, Protocol, TypeVar

from .errors import InputError

Item = TypeVar("Item")
Result = TypeVar("Result")


class Map(Protocol):
    """``workers(function, items)`` yields function(item) in order.

    Function, items and results must pickle unless it is ``map``.
    """

    def __call__(self, function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterator[Result]:
        """function(item) of every item."""


UNDER_WAY_PER_WORKER = 2
"""A worker never waits for its next item, and no more results than this wait to be taken."""
CONNECT_TIMEOUT_S = 20


def _bounded(submit: Callable[..., Any], wait: Callable[[Any], Any], limit: Callable[[], int]) -> Map:
    """A map from ``submit(function, item)``, which returns a handle, ``wait(handle)``, and the most handles
    at a time."""

    def run(function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterator[Result]:
        rest = iter(items)
        handles: deque[Any] = deque()
        while True:
            handles.extend(submit(function, item) for item in islice(rest, max(0, limit() - len(handles))))
            if not handles:
                return
            yield wait(handles.popleft())

    return run


def _end_with_parent() -> None:
    """Ends this worker when the process that started the pool is gone: killed, it could not say so, and
    workers would wait for ever."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return  # a process that nobody started for a pool

    def watch() -> None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _processes(jobs: int) -> Iterator[Map]:
    # Threads run here (progress bar, arrow's readers), and a forked copy of them could hold a lock for ever.
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    if "forkserver" in methods:
        # What the caller has loaded by now, its workers need too.
        context.set_forkserver_preload(sorted(name for name in sys.modules if name.startswith("lpvguard.")))
    with ProcessPoolExecutor(max_workers=jobs, mp_context=context, initializer=_end_with_parent) as pool:
        try:
            yield _bounded(pool.submit, lambda future: future.result(), lambda: UNDER_WAY_PER_WORKER * jobs)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)  # a run that ends does not wait for unused results
            raise


@contextmanager
def _cluster(address: str) -> Iterator[Map]:
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "--scheduler", address, "Dask is not installed", "pip install 'lpvguard[dask]'"
        ) from None
    try:
        client = Client(address, timeout=CONNECT_TIMEOUT_S)
    except (OSError, ValueError) as error:
        raise InputError(
            "--scheduler",
            address,
            f"no scheduler answers ({error})".strip(),
            "the address of a running scheduler, like tcp://host:8786",
        ) from None
    with client:
        yield _bounded(
            lambda function, item: client.submit(function, item, pure=False),
            lambda future: future.result(),
            lambda: UNDER_WAY_PER_WORKER * max(1, sum(client.nthreads().values())),
        )


@contextmanager
def workers(jobs: int = 1, scheduler: str | None = None) -> Iterator[Map]:
    """The map of ``jobs`` processes, or of the Dask cluster at ``scheduler``; with 1 and None plain ``map``.

    The machines of a cluster must have this package and see the drives under the same paths. Raises
    InputError for jobs < 1, for both at once, and when no scheduler answers.
    """
    if jobs < 1:
        raise InputError("--jobs", "", str(jobs), "at least 1")
    if scheduler is not None and jobs != 1:
        raise InputError("--jobs", "", "given together with --scheduler", "one of them")
    if scheduler is not None:
        with _cluster(scheduler) as run:
            yield run
    elif jobs > 1:
        with _processes(jobs) as run:
            yield run
    else:
        yield map
