"""Format, lint and types of the tree by the settings that it carries; each gate finds what is planted."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TOOLS = ROOT / "tools"
C_FOLDERS = ("lib/include", "lib/src", "firmware_sim", "tests", "tools/src/lpvguard")
"""What people write; lib/vehicles is generated."""
RUFF = (sys.executable, "-m", "ruff")
CHECK = (*RUFF, "check", "--config", "pyproject.toml")
FORMAT = (*RUFF, "format", "--check", "--config", "pyproject.toml")
MYPY = (sys.executable, "-m", "mypy", "--cache-dir", ROOT / "build" / "mypy")
ANOTHER_FULL = re.compile(
    r"""["']LPVGUARD_FULL["'] (not )?in os\.environ|environ\[["']LPVGUARD_FULL|"""
    r"""(getenv|environ\.get)\(["']LPVGUARD_FULL["'][^)]*\)(?! [!=]= ["']1["'])"""
)
"""Asks whether LPVGUARD_FULL is set, or for its value, but not whether it is 1."""
RIDDLES = {"found", "told", "given", "of"}
"""Names that do not say what the thing is; keys of files may be among them."""
PLANTED = {CHECK: "import os\n", FORMAT: "x = {  'a':1 }\n"}


def riddles(text: str) -> list[str]:
    """Functions, parameters and variables of a module that have a name of RIDDLES, by line."""
    named = {
        (node.lineno, name)
        for node in ast.walk(ast.parse(text))
        for name in (
            node.name if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) else None,
            node.arg if isinstance(node, ast.arg) else None,
            node.id if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) else None,
        )
        if name in RIDDLES
    }
    return [f"{line}: {name}" for line, name in sorted(named)]


def run(*command: object) -> subprocess.CompletedProcess[str]:
    """From tools/, where the settings are."""
    words = [str(word) for word in command]
    return subprocess.run(words, cwd=TOOLS, capture_output=True, text=True, check=False)


def c_files() -> list[Path]:
    return sorted(
        path
        for folder in C_FOLDERS
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".c", ".h", ".cpp", ".hpp")
    )


def clang_format(*files: Path) -> subprocess.CompletedProcess[str]:
    return run(
        Path(sys.executable).with_name("clang-format"),
        "--dry-run",
        "--Werror",
        f"--style=file:{ROOT / '.clang-format'}",
        *files,
    )


@pytest.mark.parametrize("command", [CHECK, FORMAT], ids=["lint", "format"])
def test_python_keeps_the_rules(command):
    done = run(*command, "src", "examples", "site", "release.py", "summarise_tests.py", "../tests")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("command", [CHECK, FORMAT], ids=["lint", "format"])
def test_a_planted_breach_is_found(command, tmp_path):
    path = tmp_path / "planted.py"
    path.write_text(PLANTED[command])
    assert run(*command, path).returncode == 1


def test_names_say_what_the_thing_is():
    python = sorted(path for folder in ("tools/src", "tests") for path in (ROOT / folder).rglob("*.py"))
    named = [f"{path.relative_to(ROOT)}:{riddle}" for path in python for riddle in riddles(path.read_text())]
    assert len(python) > 300 and named == []


@pytest.mark.parametrize(
    "text",
    [
        "def of(): pass",
        "def f(*, given): pass",
        "def f(**told): pass",
        "found = 1",
        "[of for of in x]",
        "if found := f(): pass",
        "class A:\n    of: int",
    ],
)
def test_a_planted_riddle_is_found(text):
    assert len(riddles(text)) == 1


def test_a_key_and_an_attribute_may_have_any_name():
    assert riddles('x = {"found": d.found}\nprint(x["of"])') == []


def test_the_long_forms_run_where_the_variable_is_1_alone():
    """tools/test sets it to 0 or 1: where a test asks whether it is set, the long form runs always."""
    python = [path for path in (ROOT / "tests").rglob("*.py") if path != Path(__file__).resolve()]
    asking = [path for path in python if ANOTHER_FULL.search(path.read_text())]
    assert len(python) > 100 and asking == []


@pytest.mark.parametrize(
    ("text", "another"),
    [
        ('os.environ.get("LPVGUARD_FULL") == "1"', False),
        ('os.environ.get("LPVGUARD_FULL") != "1"', False),
        ('os.environ.get("LPVGUARD_FULL")', True),
        ('os.getenv("LPVGUARD_FULL", "")', True),
        ('"LPVGUARD_FULL" not in os.environ', True),
        ('os.environ["LPVGUARD_FULL"] == "1"', True),
    ],
)
def test_another_question_is_found(text, another):
    assert bool(ANOTHER_FULL.search(text)) == another


@pytest.mark.unhurried
def test_c_and_cpp_are_formatted():
    files = c_files()
    assert len(files) > 50
    done = clang_format(*files)
    assert done.returncode == 0, done.stderr


def test_planted_c_that_is_not_formatted_is_found(tmp_path):
    path = tmp_path / "planted.c"
    path.write_text("int  f( void ){return 1;}\n")
    assert clang_format(path).returncode == 1


@pytest.mark.slow("60 s: mypy without its cache")
def test_the_package_is_typed_throughout():
    assert (TOOLS / "src" / "lpvguard" / "py.typed").is_file()
    done = run(*MYPY)
    assert done.returncode == 0, done.stdout


@pytest.mark.slow("20 s: mypy of one file and what it imports, without the other test's cache")
def test_a_planted_type_error_is_found(tmp_path):
    path = tmp_path / "planted.py"
    path.write_text('x: int = "text"\n')
    done = run(*MYPY, path)
    assert done.returncode == 1 and "[assignment]" in done.stdout
