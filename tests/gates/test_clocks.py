"""No test asserts wall-clock or processor time: a machine half as fast, or busy, must not fail one. Speed is
a ratio in `lpvguard bench`."""

import ast
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parents[1]
CLOCKS = {
    "time",
    "time_ns",
    "monotonic",
    "monotonic_ns",
    "perf_counter",
    "perf_counter_ns",
    "process_time",
    "process_time_ns",
    "thread_time",
    "times",
    "getrusage",
}


def reads_clock(node: ast.AST, tainted: set[str]) -> bool:
    """Whether an expression holds a call of a clock, or a name that was made from one."""
    for part in ast.walk(node):
        if isinstance(part, ast.Call):
            called = part.func
            if (
                isinstance(called, ast.Attribute)
                and isinstance(called.value, ast.Name)
                and (called.value.id, called.attr)
                in {(module, clock) for module in ("time", "os", "resource") for clock in CLOCKS}
            ):
                return True
            if isinstance(called, ast.Name) and called.id in CLOCKS - {"time", "times"}:
                return True
        if isinstance(part, ast.Name) and part.id in tainted:
            return True
    return False


def clocks_asserted(source: str) -> list[int]:
    """Lines that assert something made from a clock. Names are followed through a file's assignments and
    `append`s, whatever their scope."""
    tree = ast.parse(source)
    tainted: set[str] = set()
    while True:
        before = len(tainted)
        for node in ast.walk(tree):
            value = getattr(node, "value", None)
            targets = (
                node.targets
                if isinstance(node, ast.Assign)
                else [node.target]
                if isinstance(node, ast.AugAssign | ast.AnnAssign | ast.NamedExpr)
                else []
            )
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr in ("append", "extend")
                and node.args
            ):
                targets, value = [node.func.value], node.args[0]
            pairs = [(t, value) for t in targets if value is not None]
            for target, made_from in [
                pair
                for t, v in pairs
                for pair in (
                    zip(t.elts, v.elts, strict=False)
                    if isinstance(t, ast.Tuple) and isinstance(v, ast.Tuple)
                    else [(t, v)]
                )
            ]:
                if reads_clock(made_from, tainted):
                    tainted |= {n.id for n in ast.walk(target) if isinstance(n, ast.Name)}
        if len(tainted) == before:
            break
    return sorted(
        node.lineno
        for node in ast.walk(tree)
        if isinstance(node, ast.Assert) and reads_clock(node.test, tainted)
    )


@pytest.mark.unhurried
@pytest.mark.parametrize("path", sorted(TESTS.rglob("*.py")), ids=lambda p: str(p.relative_to(TESTS)))
def test_no_test_asserts_a_clock(path):
    assert clocks_asserted(path.read_text()) == []


@pytest.mark.parametrize(
    ("source", "lines"),
    [
        ("import time\nstart = time.process_time()\nwork()\nassert time.process_time() - start < 5.0\n", [4]),
        (
            "seconds = []\nstart = time.perf_counter()\n"
            "seconds.append(time.perf_counter() - start)\nassert len(x) and median(seconds) < 0.3\n",
            [4],
        ),
        ("a, b = f(), time.monotonic()\nlate = b - a\nassert late < 1\nassert a == 1\n", [3]),
        ("from time import perf_counter\nassert perf_counter() < 1\n", [2]),
        (
            "def clock():\n    return 0\nassert clock() == 0\n"
            "for _ in range(100):\n    time.sleep(0.05)\nassert drive.time[3] == 2\n",
            [],
        ),
    ],
)
def test_planted_clocks_are_found(source, lines):
    assert clocks_asserted(source) == lines
