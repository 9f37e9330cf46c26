"""Asks the tests of some folders about mutants (python_mutation.py): a pytest whose loop forks per mutant.

    python_mutation_worker.py TASK       TASK: JSON file of a `Task`; without tests it lists the mutants

It collects the tests once and runs none itself. A child per test finds what the test costs and which lines it
reaches; that is kept in the scratch folder. Then a child per mutant puts the mutated code into the functions
that are loaded, and runs the tests that reach the place, the cheapest first, up to the first that fails.
Where all of them cost too much, the most direct ones are asked. As many children run at once as there are
processors.

Not asked are tests that take longer than `LONGEST_S`, tests marked slow or serial, and tests that read the
folders that all tests share (tests/made.py): those were made before the mutant was there. What a test module
works out while it is imported no mutant changes either. Caches of the package (functools) are emptied first.

A child that takes ten times as long as its tests should, or more memory than `MEMORY`, is ended: killed.
"""

from __future__ import annotations

import ast
import functools
import gc
import hashlib
import importlib
import json
import os
import pickle
import resource
import shutil
import signal
import sys
import threading
import types
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy: threads do not survive a fork

import pytest

from python_mutation import Mutants, Site

LONGEST_S = 2.0
"""Processor time of a test that is asked, with its fixtures, while its lines are noted."""
MOST_S = 5.0
"""Processor time of the most direct tests that one mutant meets; others reach much that lies elsewhere."""
CHEAP_S = 1.0
"""Processor time of the cheapest tests that it meets besides: beside other work the direct ones take longer,
and fewer of them are asked."""
GENEROUS = 10
MEMORY = 2 << 30
"""Address space beyond what the process has when a mutant is put in [byte]."""
NOT_ASKED = {"made"}
"""Fixtures of shared folders."""


@dataclass(frozen=True)
class Task:
    """``files``: path below ``package`` -> its mutants (site, change). Written to ``out``, a line
    each: file, site, change, whether it survives, and how many tests were asked."""

    package: Path  # folder of the imported package
    tests: list[Path]
    files: dict[str, list[tuple[int, int]]]
    traced: list[str]  # files of the package whose lines are noted
    scratch: Path
    out: Path
    rootdir: Path  # whose *.py tests may import


def cpu_s() -> float:
    """Processor time of this process and of the children that it waited for."""
    return sum(os.times()[:4])


def loaded(package: Path, name: str) -> Mutants:
    """Mutants of a file of the package, with the numbers that its module knows by capital names."""
    source = package / name
    known = vars(sys.modules[module_of(source)])
    constants = {
        name
        for name, value in known.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and name.isupper()
    }
    return Mutants(source.read_text(encoding="utf-8"), str(source), constants)


def module_of(source: Path) -> str:
    """Imports the module of a file; its name by the folders with an __init__.py."""
    parts = [] if source.name == "__init__.py" else [source.stem]
    folder = source.parent
    while (folder / "__init__.py").is_file():
        parts.insert(0, folder.name)
        folder = folder.parent
    name = ".".join(parts)
    importlib.import_module(name)
    return name


# --- children ---


def in_children(jobs: Iterable[Callable[[], Any]], scratch: Path) -> Iterator[tuple[int, int, bytes]]:
    """Index, status and answer of each job, every one in a child of its own, as they end. Status: 0 where the
    job returned; else the child was ended (by a signal, or by an exception of the job itself)."""
    n_at_once = len(os.sched_getaffinity(0))
    running: dict[int, tuple[int, Path]] = {}
    waiting = enumerate(jobs)
    left = True
    while running or left:
        while left and len(running) < n_at_once:
            try:
                index, job = next(waiting)
            except StopIteration:
                left = False
                break
            answer = scratch / f"child_{index}"
            pid = os.fork()
            if not pid:
                child(job, answer)
            running[pid] = (index, answer)
        if running:
            pid, status = os.wait()
            index, answer = running.pop(pid)
            folder = answer.with_suffix(".tmp")
            shutil.rmtree(folder, ignore_errors=True)
            said = answer.read_bytes() if answer.exists() else b""
            answer.unlink(missing_ok=True)
            yield index, status, said


def child(job: Callable[[], Any], answer: Path) -> None:
    """Runs a job in this new process and ends it."""
    status = 1
    try:
        folder = answer.with_suffix(".tmp")
        folder.mkdir(parents=True, exist_ok=True)
        os.environ["PYTEST_DEBUG_TEMPROOT"] = str(folder)
        silent = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(silent, stream)
        answer.write_bytes(pickle.dumps(job()))
        status = 0
    finally:
        os._exit(status)


def limited(seconds: float) -> None:
    """Ends this process by a signal after so much processor time, or when it waits for ever."""
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.setitimer(signal.ITIMER_REAL, 60 + 20 * seconds)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


class Reports:
    """What pytest says about the tests that run in this process."""

    def __init__(self) -> None:
        self.failed = False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.failed |= report.failed


def passes(items: list[pytest.Item]) -> bool:
    """Whether all pass or are skipped, up to the first that does not."""
    reports = Reports()
    items[0].config.pluginmanager.register(reports)
    for item, following in zip(items, [*items[1:], None], strict=True):
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        if reports.failed:
            return False
    return True


@dataclass(frozen=True)
class Living:
    """Functions of the package by file, name and first line, and its caches: looked up before any fork,
    because a look at every object copies the memory that a child shares."""

    functions: dict[tuple[str, str, int], list[types.FunctionType]]
    caches: list[Any]

    @classmethod
    def now(cls, package: Path) -> Living:
        gc.collect()
        functions: dict[tuple[str, str, int], list[types.FunctionType]] = {}
        caches = []
        for thing in gc.get_objects():
            if isinstance(thing, types.FunctionType):
                code = thing.__code__
                if code.co_filename.startswith(f"{package}/"):
                    place = (code.co_filename, code.co_qualname, code.co_firstlineno)
                    functions.setdefault(place, []).append(thing)
            elif isinstance(thing, functools._lru_cache_wrapper):
                inner = getattr(thing.__wrapped__, "__code__", None)  # of none where C wrote it
                if inner is not None and inner.co_filename.startswith(f"{package}/"):
                    caches.append(thing)
        return cls(functions, caches)

    def forget(self) -> None:
        """Empties what functools keeps."""
        for cache in self.caches:
            cache.cache_clear()


# --- what a test costs and reaches ---


def reached_by(
    item: pytest.Item, package: Path, traced: set[str], living: Living
) -> tuple[bool, float, dict[str, list[int]]]:
    """Whether a test passes, its seconds with its fixtures, and the files of the package that it reaches; the
    lines of those that are ``traced``. It is ended where it takes much longer than a test that is asked."""
    begin = f"{package}/"
    lines_by_file: dict[str, set[int]] = {}

    def line(frame: types.FrameType, event: str, _: object) -> Any:
        if event == "line":
            lines_by_file[frame.f_code.co_filename].add(frame.f_lineno)
        return line

    def call(frame: types.FrameType, _: str, __: object) -> Any:
        name = frame.f_code.co_filename
        if name.startswith(begin):
            lines_by_file.setdefault(name, set())
            return line if name in traced else None
        return None

    living.forget()
    limited(2 * LONGEST_S)
    began = cpu_s()
    threading.settrace(call)
    sys.settrace(call)
    good = passes([item])
    sys.settrace(None)
    threading.settrace(None)
    return (
        good,
        cpu_s() - began,
        {name.removeprefix(begin): sorted(lines_by_file[name]) for name in sorted(lines_by_file)},
    )


@dataclass(frozen=True)
class Case:
    item: pytest.Item
    seconds: float
    reached: dict[str, set[int]]


def by_cost(case: Case) -> tuple[float, str]:
    return case.seconds, case.item.nodeid


class Notes:
    """What is known of the tests of one file: seconds, reached lines by file, and the hash of each such file.
    A note holds while neither the tests nor a file that they reach changes."""

    def __init__(self, tests: Path, task: Task) -> None:
        self.package = task.package
        known = hashlib.sha256()
        for path in (tests, *tests.parent.glob("conftest.py"), *task.rootdir.glob("*.py")):
            known.update(path.read_bytes())
        self.path = task.scratch / "reached" / f"{tests.stem}_{known.hexdigest()[:16]}.json"
        self.tests: dict[str, dict[str, Any]] = (
            json.loads(self.path.read_text()) if self.path.exists() else {}
        )

    def hash_of(self, name: str) -> str:
        file = self.package / name
        return hashlib.sha256(file.read_bytes()).hexdigest()[:16] if file.is_file() else ""

    def known(self, item: pytest.Item) -> bool:
        note = self.tests.get(item.nodeid)
        return note is not None and all(self.hash_of(name) == was for name, was in note["of"].items())

    def put(self, item: pytest.Item, seconds: float, reached: dict[str, list[int]] | None) -> None:
        hashes = {name: self.hash_of(name) for name in reached or {}}
        self.tests[item.nodeid] = {"seconds": seconds, "reached": reached, "of": hashes}

    def case(self, item: pytest.Item) -> Case | None:
        """None: too dear to be asked."""
        note = self.tests[item.nodeid]
        if note["reached"] is None:
            return None
        return Case(item, note["seconds"], {name: set(lines) for name, lines in note["reached"].items()})

    def save(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_text(json.dumps(self.tests))


def cases(items: list[pytest.Item], task: Task, living: Living) -> list[Case]:
    """The tests that are asked, with what they cost and reach, the cheapest first."""
    notes = {path: Notes(path, task) for path in {item.path for item in items}}
    unknown = [item for item in items if not notes[item.path].known(item)]
    traced = {str(task.package / name) for name in task.traced}
    jobs = [functools.partial(reached_by, item, task.package, traced, living) for item in unknown]
    failing = []
    for index, status, said in in_children(jobs, task.scratch):
        item = unknown[index]
        good, seconds, reached = pickle.loads(said) if not status else (True, LONGEST_S, None)
        if not good:
            failing.append(item.nodeid)
            continue
        notes[item.path].put(item, seconds, reached if seconds < LONGEST_S else None)
        notes[item.path].save()
    if failing:
        raise pytest.UsageError(f"fail before anything is changed: {', '.join(sorted(failing))}")
    cases = [notes[item.path].case(item) for item in items]
    return sorted((case for case in cases if case), key=by_cost)


# --- mutants ---


def codes_in(code: types.CodeType) -> Iterator[types.CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield constant
            yield from codes_in(constant)


def put_in(mutants: Mutants, site: Site, index: int, living: Living) -> None:
    """The code of a changed function, or its default, into the functions that live."""
    new = mutants.applied(site, index)
    [code] = [
        c for c in codes_in(new) if c.co_qualname == site.function and c.co_firstlineno == site.first_line
    ]
    functions = living.functions.get((mutants.path, site.function, site.first_line))
    if not functions:
        raise LookupError(f"no function {site.function} lives")
    for function in functions:
        # A function with super() has a cell for its class, also where the mutant leaves super() out.
        held = function.__code__.co_freevars
        function.__code__ = code if code.co_freevars else code.replace(co_freevars=held)
        if site.default is not None:
            change_default(function, site.default, site.new[index])


def change_default(function: types.FunctionType, name: str, new: ast.AST) -> None:
    """A parameter's changed default: an expression of numbers."""
    value = ast.literal_eval(cast(ast.expr, new))
    if name in (function.__kwdefaults__ or {}):
        function.__kwdefaults__ = {**function.__kwdefaults__, name: value}
    else:
        code, old = function.__code__, function.__defaults__ or ()
        at = code.co_varnames[: code.co_argcount].index(name) - code.co_argcount
        changed = list(old)
        changed[at] = value
        function.__defaults__ = tuple(changed)


def fate(mutants: Mutants, site: int, index: int, asked: list[Case], living: Living) -> bool | str:
    """Whether a mutant survives the tests, or why it cannot be put in; in a child."""
    if not asked:
        return True
    try:
        put_in(mutants, mutants.sites[site], index, living)
        living.forget()
    except Exception as error:
        return repr(error)
    limited(2.0 + GENEROUS * sum(case.seconds for case in asked))
    return passes([case.item for case in asked])


def asked_about(lines: range, name: str, known: list[Case]) -> list[Case]:
    """The tests that reach one of the lines, the cheapest first: of them the most direct ones, in `MOST_S`,
    and the cheapest others, in `CHEAP_S`.

    Of what a direct test reaches much lies in the file ``name``: what is asked there it notices most likely.
    """

    def directness(case: Case) -> float:
        return len(case.reached[name]) / sum(map(len, case.reached.values()))

    def first(those: list[Case], left: float) -> list[Case]:
        out = []
        for case in those:
            if case.seconds <= left:
                left -= case.seconds
                out.append(case)
        return out

    reaching = [case for case in known if case.reached.get(name, set()).intersection(lines)]
    direct = first(sorted(reaching, key=directness, reverse=True), MOST_S)
    others = sorted((case for case in reaching if case not in direct), key=by_cost)
    return sorted([*direct, *first(others, CHEAP_S)], key=by_cost)


class Loop:
    """In place of pytest's loop."""

    def __init__(self, task: Task) -> None:
        self.task = task

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [
            item
            for item in items
            if not NOT_ASKED.intersection(getattr(item, "fixturenames", ()))
            and not item.get_closest_marker("slow")
            and not item.get_closest_marker("serial")
        ]

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        if session.testsfailed:
            raise session.Interrupted("errors during collection")
        task = self.task
        living = Living.now(task.package)
        gc.freeze()
        known = cases(session.items, task, living)
        work: list[tuple[str, int, int, list[Case]]] = []
        mutants = {name: loaded(task.package, name) for name in task.files}
        for name, wanted in task.files.items():
            for site, index in wanted:
                work.append((name, site, index, asked_about(mutants[name].sites[site].lines, name, known)))
        gc.freeze()
        jobs = (functools.partial(fate, mutants[n], s, i, asked, living) for n, s, i, asked in work)
        for k, status, said in in_children(jobs, task.scratch):
            name, site, index, asked = work[k]
            alive = pickle.loads(said) if not status else False
            if isinstance(alive, str):
                raise pytest.UsageError(f"{name}:{mutants[name].sites[site].line}: mutant {index}: {alive}")
            with task.out.open("a") as out:  # a line each, so that a long run can be watched
                out.write(json.dumps([name, site, index, alive, len(asked)]) + "\n")
        return True


def listing(package: Path, names: Iterable[str]) -> Iterator[list[Any]]:
    """Of every site: file, function, line, and (was, becomes) of its mutants."""
    for name in names:
        for site in loaded(package, name).sites:
            yield [name, site.function, site.line, [(c.was, c.becomes) for c in site.changes]]


def main() -> int:
    words = json.loads(Path(sys.argv[1]).read_text())
    package, out = Path(words["package"]), Path(words["out"])
    if "tests" not in words:
        out.write_text("".join(json.dumps(line) + "\n" for line in listing(package, words["files"])))
        return 0
    tests = [Path(t) for t in words["tests"]]
    task = Task(
        package, tests, words["files"], words["traced"], Path(words["scratch"]), out, Path(words["rootdir"])
    )
    options = ["-qq", "-s", "-p", "no:cacheprovider", "-p", "no:xdist"]
    return int(pytest.main([*options, *map(str, task.tests)], plugins=[Loop(task)]))


if __name__ == "__main__":
    sys.exit(main())
