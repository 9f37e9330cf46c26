"""The gate on Python mutants, on a program so small that the fate of each of its mutants is known."""

from pathlib import Path

import pytest

import python_mutation_run as run
from mutation_run import Mutant, command, table_of_lists
from python_mutation import Mutants
from python_mutation_run import (
    ASKED,
    EQUIVALENT,
    MEASURED,
    OPEN,
    PACKAGE,
    changed_since,
    folder_of,
    judged,
    mutants_of,
    noted,
    python_mutation_findings,
    surviving,
    target_files,
)

ROOT = Path(__file__).resolve().parents[2]
SMALL = "engine/validation/small.py"
SOURCE = """from concurrent.futures import ThreadPoolExecutor
from functools import cache

LIMIT = 30


def limited(x, times=3):
    y = 0
    for _ in range(times):
        y += x
    if y > LIMIT:
        y = LIMIT
    return y


def emptied(items):
    while items:
        items.pop()
    return items


@cache
def doubled(x):
    return 2 * x


class Line:
    def __init__(self, *, slope=4):
        self.slope = slope

    @property
    def rise(self):
        return [self.slope - k for k in range(2)]


class Steep(Line):
    def __init__(self):
        super().__init__(slope=9)


def apart(x):
    def added():
        return x + 1

    with ThreadPoolExecutor() as threads:
        return threads.submit(added).result()


def unused(x):
    return x + 1
"""
TESTS = """import pytest
from lpvguard_small.engine.validation.small import Line, Steep, apart, doubled, emptied, limited

KEPT = doubled(4)


def test_within_the_limit():
    assert limited(2) == 6


def test_beyond_it():
    assert limited(20) == 30


def test_nothing_is_left():
    assert emptied([1, 2]) == []


def test_a_kept_value():
    assert doubled(4) == KEPT == 8


def test_a_default_and_a_property():
    assert Line().rise == [4, 3]


def test_a_class_that_derives():
    assert Steep().rise == [9, 8]


def test_what_a_thread_does():
    assert apart(3) == 4


@pytest.mark.slow("would kill all")
def test_that_is_not_asked():
    assert limited(10) == 30 and limited(-11) == -33 and unused(1) == 2


@pytest.fixture
def made():
    return doubled(4)


def test_that_reads_what_was_made_before(made):
    assert limited(10) == 30 and limited(-11) == -33
"""
N_SMALL = 47
AT_THE_BORDER = {
    "if y > LIMIT:  ->  if y >= LIMIT:",
    "if y > LIMIT:  ->  if y > LIMIT + 1:",
    "if y > LIMIT:  ->  if y > LIMIT - 1:",
}
"""What no test that is asked looks at; the first is no change at all."""


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> Path:
    """A repository whose newest commit brings one file to mutate, its tests, and a configuration that knows
    their markers."""
    tree = tmp_path_factory.mktemp("tree")
    commit = ("git", "-c", "user.name=t", "-c", "user.email=t@t", "commit", "-q", "--allow-empty", "-m", "x")
    command("git", "init", "-q", "-b", "main", cwd=tree)
    command(*commit, cwd=tree)
    module = tree / PACKAGE / "engine" / "validation" / "small.py"
    module.parent.mkdir(parents=True)
    for folder in (module.parent, module.parent.parent, tree / PACKAGE):
        (folder / "__init__.py").touch()
    module.write_text(SOURCE)
    tests = tree / "tests" / "tools" / "engine" / "test_validation_small.py"
    tests.parent.mkdir(parents=True)
    tests.write_text(TESTS.replace("lpvguard_small", "lpvguard"))
    (tests.parent / "pytest.ini").write_text("[pytest]\nmarkers =\n    slow: slow\n    serial: serial\n")
    (tree / "tests" / "gates").mkdir()
    for name in (EQUIVALENT, OPEN):
        (tree / "tests" / "gates" / name).write_text("{}")
    command("git", "add", "-A", cwd=tree)
    command(*commit, cwd=tree)
    return tree


@pytest.fixture(scope="module")
def ran(tree, tmp_path_factory) -> tuple[list[Mutant], list[Mutant]]:
    """All mutants of the small program, and those that survive its tests."""
    scratch = tmp_path_factory.mktemp("scratch")
    mutants, places = mutants_of(tree, scratch, target_files(tree))
    return mutants, surviving(tree, scratch, mutants, places)


def keys_in(mutants: list[Mutant], function: str) -> set[str]:
    return {m.key for m in mutants if m.site.function == function}


@pytest.mark.slow("7 s: a module with its mutants")
def test_what_a_test_asks_about_is_killed_and_the_rest_survives(ran):
    mutants, survived = ran
    assert keys_in(survived, "limited") == AT_THE_BORDER
    assert keys_in(survived, "unused") == keys_in(mutants, "unused") != set()
    assert (
        keys_in(survived, "doubled")
        == keys_in(survived, "Line.rise")
        == keys_in(survived, "Line.__init__")
        == set()
    )
    assert len({(m.site.function, m.key) for m in mutants}) == len(mutants) > 30


@pytest.mark.slow("7 s: a module with its mutants")
def test_a_loop_that_does_not_end_is_killed(ran):
    mutants, survived = ran
    assert "items.pop()  ->  (left out)" in keys_in(mutants, "emptied") - keys_in(survived, "emptied")


@pytest.mark.slow("7 s: a module with its mutants")
def test_defaults_properties_and_what_is_kept_are_changed(ran):
    mutants, _ = ran
    assert "def __init__(self, *, slope=4):  ->  def __init__(self, *, slope=5):" in keys_in(
        mutants, "Line.__init__"
    )
    assert "def limited(x, times=3):  ->  def limited(x, times=2):" in keys_in(mutants, "limited")
    assert "return 2 * x  ->  return 2 / x" in keys_in(mutants, "doubled")
    assert "return [self.slope - k for k in range(2)]  ->  return [self.slope for k in range(2)]" in keys_in(
        mutants, "Line.rise"
    )


@pytest.mark.slow("7 s: a module with its mutants")
def test_a_function_that_no_longer_asks_its_base_class_is_changed(ran):
    mutants, survived = ran
    assert "super().__init__(slope=9)  ->  (left out)" in keys_in(mutants, "Steep.__init__")
    assert not keys_in(survived, "Steep.__init__")


@pytest.mark.slow("7 s: a module with its mutants")
def test_lines_that_a_thread_runs_are_reached(ran):
    mutants, survived = ran
    assert "return x + 1  ->  return x - 1" in keys_in(mutants, "apart") and not keys_in(survived, "apart")


@pytest.mark.slow("7 s: a module with its mutants")
def test_findings_name_every_survivor_once_and_what_is_noted_in_vain(ran):
    mutants, survived = ran
    file = survived[0].file
    argued = {file: {"limited": {"if y > LIMIT:  ->  if y >= LIMIT:": "the same number"}}}
    killed = next(m for m in mutants if m not in survived)
    stale = {file: {killed.site.function: {killed.key: ""}}}
    assert len(judged(mutants, survived, {}, {}, set())) == len(survived)
    assert len(judged(mutants, survived, argued, {}, {file})) == len(survived) - 1
    assert judged(mutants, [], stale, {}, {file}) == [
        f"{EQUIVALENT}: {file}: {killed.site.function}: {killed.key}: is killed: take it out"
    ]


@pytest.mark.long("13 s: a module with its mutants")
def test_a_sample_meets_the_tests_that_import_its_file_before_the_others(tree, tmp_path):
    far = tree / "tests" / "tools" / "engine" / "test_validation_far.py"
    far.write_text(
        f"from importlib import import_module\n\n\ndef test_unused():\n"
        f'    assert import_module("lpvguard.{SMALL[:-3].replace("/", ".")}").unused(1) == 2\n'
    )
    mutants, places = mutants_of(tree, tmp_path, [SMALL])
    unused = [m for m in mutants if m.site.function == "unused"]
    try:
        assert surviving(tree, tmp_path, unused, places, near=True) == unused
        assert surviving(tree, tmp_path, unused, places) == []
        findings = python_mutation_findings(
            tree, tmp_path, full=False, only="", sample=N_SMALL, measured={SMALL: N_SMALL}
        )
    finally:
        far.unlink()
    assert findings and not any("unused" in finding for finding in findings)


@pytest.mark.unhurried
@pytest.mark.parametrize("full", [False, True])
def test_near_tests_are_asked_first_and_file_by_file(full, monkeypatch, tmp_path):
    """Both files lie in one folder, so that all of its tests are asked about both at once."""
    tasks = []

    def answer(tree, scratch, task):
        if "tests" not in task:
            return [[name, "f", 1, [["x + 1", "x - 1"]]] for name in task["files"]]
        tasks.append((sorted(task["files"]), len(task["tests"])))
        return [[name, *at, True, 1] for name, places in task["files"].items() for at in places]

    names = ["engine/synthesis/dk.py", "engine/synthesis/mu.py"]
    monkeypatch.setattr(run, "asked_worker", answer)
    monkeypatch.setattr(run, "touched", lambda tree, known: known)
    findings = python_mutation_findings(ROOT, tmp_path, full, "", measured=dict.fromkeys(names, 1))
    assert [files for files, _ in tasks] == [[names[0]], [names[1]], names]
    assert all(0 < near < tasks[2][1] for _, near in tasks[:2])
    assert sum(finding.startswith("survived: ") for finding in findings) == 2


@pytest.mark.unhurried
def test_the_gate_draws_where_it_is_not_asked_for_all(tree, tmp_path, capsys):
    findings = python_mutation_findings(
        tree, tmp_path, full=False, only="", sample=5, measured={SMALL: N_SMALL}
    )
    said = capsys.readouterr().out
    assert "5 drawn" in said and said.splitlines()[-1].startswith("| **all** | 5 |")
    assert all(f.startswith("survived: engine/validation/small.py:") for f in findings)


def test_a_file_with_another_number_of_mutants_than_when_all_ran_is_told(tree, tmp_path, capsys):
    module = tree / PACKAGE / SMALL
    module.write_text(SOURCE + "\n\ndef added(x):\n    return -x\n")
    try:
        findings = python_mutation_findings(
            tree, tmp_path, full=False, only="", sample=0, measured={SMALL: N_SMALL}
        )
    finally:
        module.write_text(SOURCE)
    assert findings == [f"{SMALL}: {N_SMALL + 1} mutants, and {N_SMALL} when all had run: run all again"]


@pytest.mark.long("12 s: a module with its mutants")
def test_a_test_that_fails_without_a_mutant_is_told(tree, tmp_path):
    tests = tree / "tests" / "tools" / "engine" / "test_validation_wrong.py"
    tests.write_text("def test_wrong():\n    assert 1 == 2\n")
    try:
        [finding] = python_mutation_findings(tree, tmp_path, full=True, only="", measured={SMALL: N_SMALL})
    finally:
        tests.unlink()
    assert "fail before anything is changed: " in finding and "test_wrong" in finding


def changes(source: str) -> list[str]:
    return [str(c) for site in Mutants(source, "x.py").sites for c in site.changes]


@pytest.mark.parametrize(
    ("was", "becomes"),
    [
        ("a + b", ["a - b", "a", "b"]),
        ("a @ b.T", ["a * b.T", "a @ b"]),
        ("a <= b", ["a < b", "a > b"]),
        ("a and b", ["a or b", "b", "a"]),
        ("-a", ["a"]),
        ("max(a, 2.5)", ["min(a, 2.5)", "max(a, 3.5)", "max(a, 1.5)", "max(a, 0.0)"]),
        ("np.sqrt(a)", ["a"]),
        ("a.conj()", ["a"]),
        ("a if b else c", ["a if True else c", "a if False else c"]),
        ("f(a, 'text', axis=0)", ["f(a, 'text', axis=1)", "f(a, 'text', axis=-1)"]),
    ],
)
def test_operators(was, becomes):
    source = f"def g(a, b, c):\n    return {was}\n"
    assert changes(source) == [f"return {was}  ->  return {new}" for new in becomes]


def test_statements():
    lines = ("b = 0", "a.x = b", "b = a", "for c in a:", "    if c:", "        return b", "h(b)")
    source = "def g(a):\n" + "".join(f"    {line}\n" for line in lines)
    left_out = [c.removesuffix("  ->  (left out)") for c in changes(source) if c.endswith("(left out)")]
    assert left_out == ["a.x = b", "b = a", "return b", "h(b)"]


def test_texts_annotations_decorators_and_what_is_raised_stay():
    source = "@f(1)\ndef g(a: 'x | y') -> 'p + q':\n    'text'\n    raise E(1 + 2, f'{a - 1}')\n"
    assert changes(source) == ["raise E(1 + 2, f'{a - 1}')  ->  (left out)"]


def test_every_target_is_a_file_whose_folder_has_tests():
    names = target_files(ROOT)
    assert len(names) > 30 and set(names) >= MEASURED.keys()
    assert {folder_of(name) for name in names} == ASKED.keys()
    for asked in ASKED.values():
        assert all(list((ROOT / "tests" / "tools").glob(name)) for name in asked)


@pytest.mark.slow("4 s: every mutant is made")
def test_measured_files_have_the_mutants_that_ran_and_the_lists_and_the_page_name_them(tmp_path):
    """A changed line makes its entries void: LPVGUARD_FULL=1 would tell it late."""
    lists = [noted(ROOT, name) for name in (EQUIVALENT, OPEN)]
    files = sorted({file for notes in lists for file in notes} | MEASURED.keys())
    mutants, _ = mutants_of(ROOT, tmp_path, files)
    assert changed_since(mutants, MEASURED) == []
    there = {(m.file, m.site.function, m.key) for m in mutants}
    for notes in lists:
        for file, functions in notes.items():
            for function, reasons in functions.items():
                assert {(file, function, key) for key in reasons} <= there
                assert all(reasons.values())
    measured = table_of_lists([m for m in mutants if m.file in MEASURED], *lists)
    assert "\n".join(measured) in (ROOT / "tests" / "gates" / "MUTANTS.md").read_text()
