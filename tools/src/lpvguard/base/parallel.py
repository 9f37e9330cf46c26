"""Map a function over drives in processes of this machine or on a Dask cluster.

Results come in the order of the items. Only a few items are under way at any time, so memory does not grow
with their number. This package joins results by maxima, sums of whole numbers and selections by a key. These
reductions are associative and exact. Results therefore have the same bits for any number of workers and any
order of drives.
"""

import multiprocessing
import multiprocessing.connection
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from itertools import islice
from typing import Any, Protocol, TypeVar

from .errors import InputError

Item = TypeVar("Item")
Result = TypeVar("Result")


class Map(Protocol):
    """Map whose call ``workers(function, items)`` yields function(item) in order.

    Workers other than ``map`` begin at once and need function, items and results that pickle.
    """

    def __call__(self, function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterator[Result]:
        """Yield function(item) of every item."""


UNDER_WAY_PER_WORKER = 6
"""Items under way per worker: a worker never waits for its next item, and few results wait to be taken."""
FARTHEST_BEHIND = 4
"""A worker gets an item that it had before unless it is more than so many items behind another."""
CONNECT_TIMEOUT_S = 20
SILENT_S = 86_400.0
"""Least time that a Dask scheduler waits for the heartbeat of a busy worker. Its default is 300 s."""


def _bounded(submit: Callable[..., Any], wait: Callable[[Any], Any], limit: Callable[[], int]) -> Map:
    """A map from ``submit(function, item)``, which returns a handle, ``wait(handle)`` and the most handles at
    a time."""

    def run(function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterator[Result]:
        rest = iter(items)
        handles: deque[Any] = deque()

        def fill() -> None:
            handles.extend(submit(function, item) for item in islice(rest, max(0, limit() - len(handles))))

        def results() -> Iterator[Result]:
            while handles:
                yield wait(handles.popleft())
                fill()

        fill()
        return results()

    return run


class _Workers:
    """Single-worker processes.

    An item goes to the worker that had it before, which may have cached it, unless that worker is behind.
    Otherwise it goes to the worker with the least to do.
    """

    def __init__(self, pools: list[ProcessPoolExecutor]):
        self._pools = pools
        self._had: dict[Any, int] = {}
        self._under_way = [0] * len(pools)

    def submit(self, function: Callable[[Item], Result], item: Item) -> Future[Result]:
        """Start function(item) and return its future."""
        chosen = least = self._under_way.index(min(self._under_way))
        try:
            had = self._had.get(item, least)
        except TypeError:
            pass  # unhashable, as arrays are: no worker keeps anything by it
        else:
            if self._under_way[had] - self._under_way[least] <= FARTHEST_BEHIND:
                chosen = had
            self._had[item] = chosen
        future = self._pools[chosen].submit(function, item)
        self._under_way[chosen] += 1
        future.add_done_callback(lambda _: self._ended(chosen))
        return future

    def _ended(self, worker: int) -> None:
        self._under_way[worker] -= 1


def _end_with_parent() -> None:
    """End this worker when the process that started the pool is gone."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return  # a process outside any pool

    def watch() -> None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _processes(jobs: int) -> Iterator[Map]:
    # A forked copy of the threads here (progress bar, arrow's readers) could hold a lock for ever.
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    if "forkserver" in methods:
        # Workers need the modules that the caller has loaded.
        context.set_forkserver_preload(sorted(name for name in sys.modules if name.startswith("lpvguard.")))
    with ExitStack() as stack:
        pools = [
            stack.enter_context(ProcessPoolExecutor(1, mp_context=context, initializer=_end_with_parent))
            for _ in range(jobs)
        ]
        try:
            submit = _Workers(pools).submit
            yield _bounded(submit, lambda future: future.result(), lambda: UNDER_WAY_PER_WORKER * jobs)
        except BaseException:
            for pool in pools:
                pool.shutdown(wait=False, cancel_futures=True)  # a run that ends waits for no unused results
            raise


def _wait_for_busy_workers(dask_scheduler: Any) -> None:
    """Raise the scheduler's worker-ttl to SILENT_S; without one it waits for ever already."""
    if dask_scheduler.worker_ttl:
        dask_scheduler.worker_ttl = max(dask_scheduler.worker_ttl, SILENT_S)


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
        client.run_on_scheduler(_wait_for_busy_workers)
        yield _bounded(
            lambda function, item: client.submit(function, item, pure=False),
            lambda future: future.result(),
            lambda: UNDER_WAY_PER_WORKER * max(1, sum(client.nthreads().values())),
        )


@contextmanager
def workers(jobs: int = 1, scheduler: str | None = None) -> Iterator[Map]:
    """Give a map over processes or a Dask cluster; with 1 and None it is plain ``map``.

    The machines of a cluster need this package and see the drives under the same paths.

    Parameters
    ----------
    jobs : int, number of processes, default 1
    scheduler : str, optional, address of the Dask scheduler

    Yields
    ------
    Map

    Raises
    ------
    InputError
        If jobs < 1, both are given, or no scheduler answers.
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
