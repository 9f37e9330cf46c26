"""The package's rooms: who may import whom, how long modules and functions may be, that a name is that of one
class only, and that tools/README.md tells it as it is.

python tests/tools/test_rooms.py             prints which room imports which, and what breaks a rule
python tests/tools/test_rooms.py --write     renews the picture in tools/README.md
"""

import ast
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "tools/src/lpvguard"
README = ROOT / "tools/README.md"
TESTS = ROOT / "tests"
MAIN = (
    "base",
    "vehicle",
    "engine",
    "can",
    "drives",
    "fit",
    "start",
    "core",
    "identify",
    "control",
    "replay",
    "evaluate",
    "report",
    "robust",
    "api",
)
"""The main path and what it stands on."""
SIDE = ("sources", "measure", "fmu", "arxml", "fleet", "refine", "loop", "live", "problems", "bench")
"""The side rooms, in the package extras."""
EXTRAS = "extras"
ORDER = (*MAIN, *SIDE, "schemas", "cli")
"""Lowest first: a room imports only from rooms before it, and of those only what its MAY_IMPORT names. So no
room of the main path imports a side room."""
MODULE_LINES, FUNCTION_LINES = 600, 60
"""Only the first line of a docstring counts."""
REASON = re.compile(r"^\s*Length: \S", re.MULTILINE)
"""A line of the docstring that says why a module or function is longer."""
PICTURE = (
    "<!-- rooms: written by `python tests/tools/test_rooms.py --write`, do not edit -->\n```\n",
    "```\n<!-- rooms: end -->",
)
STOP = re.compile(r"^\d+\. `([\w/.]+):([\w.]+)`", re.MULTILINE)
"""A stop of a walk: file, from the repository's root, and function."""


def imports(package: Path) -> dict[str, set[str]]:
    """Module -> modules of the package that it imports anywhere, functions included, or names in a string as
    to be imported."""
    paths = {
        ".".join(["lpvguard", *path.relative_to(package).with_suffix("").parts]).removesuffix(
            ".__init__"
        ): path
        for path in sorted(package.rglob("*.py"))
    }

    def known(name: str) -> str | None:
        while name not in paths and "." in name:
            name = name.rpartition(".")[0]
        return name if name in paths else None

    imports: dict[str, set[str]] = {}
    for module, path in paths.items():
        here = module if path.name == "__init__.py" else module.rpartition(".")[0]
        named = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                named |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                above = here.split(".")[: len(here.split(".")) - node.level + 1] if node.level else []
                base = ".".join([*above, *([node.module] if node.module else [])])
                named |= {f"{base}.{alias.name}" for alias in node.names}
            elif (
                isinstance(node, ast.Constant)
                and isinstance(node.value, str)
                and re.fullmatch(r"lpvguard(\.\w+)+", node.value)
            ):
                named.add(node.value)
        imports[module] = {known(name) for name in named if name.split(".")[0] == "lpvguard"} - {
            module,
            None,
            "lpvguard",
        }
    return imports


def room_of(module: str) -> str:
    """The room of a module; empty for the package itself and for the package of the side rooms."""
    parts = [part for part in module.split(".")[1:3] if part != EXTRAS]
    return parts[0] if parts else ""


def folder_of(package: Path, room: str) -> Path:
    """The folder of a room: a side room's is in EXTRAS."""
    return package / EXTRAS / room if room in SIDE else package / room


def declared(package: Path, room: str) -> tuple[str, tuple[str, ...]]:
    """Docstring and MAY_IMPORT of a room."""
    tree = ast.parse((folder_of(package, room) / "__init__.py").read_text(encoding="utf-8"))
    values = [
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "MAY_IMPORT"
    ]
    return ast.get_docstring(tree) or "", ast.literal_eval(values[0]) if values else ()


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """A circle of modules for every import that closes one."""
    done: set[str] = set()
    closed = []

    def visit(module: str, way: list[str]) -> None:
        if module in way:
            closed.append([*way[way.index(module) :], module])
        elif module not in done:
            for other in sorted(graph[module]):
                visit(other, [*way, module])
            done.add(module)

    for module in sorted(graph):
        visit(module, [])
    return closed


def faults(package: Path, order: tuple[str, ...] = ORDER) -> list[str]:
    """Everything that is wrong with the rooms."""
    graph = imports(package)
    wrong = [
        f"{module} stands in no room of ORDER"
        for module in graph
        if room_of(module) and room_of(module) not in order
    ]
    wrong += [
        f"{module} stands {'outside' if room_of(module) in SIDE else 'in'} {EXTRAS}"
        for module in graph
        if room_of(module) and (room_of(module) in SIDE) != module.startswith(f"lpvguard.{EXTRAS}.")
    ]
    used: dict[str, set[str]] = {room: set() for room in order}
    for module, others in graph.items():
        room = room_of(module)
        for other in sorted(others) if room in order else ():
            if room_of(other) in order[order.index(room) + 1 :]:
                wrong.append(f"{module} imports {other}: {room_of(other)} stands above {room}")
            elif room_of(other) != room:
                used[room].add(room_of(other))
    for room in order:
        says, may = declared(package, room)
        if len(says) < 80:
            wrong.append(f"{room}/__init__.py does not say what comes in and what goes out")
        wrong += [
            f"{room} imports {other}, which its MAY_IMPORT does not name"
            for other in sorted(used[room] - set(may))
        ]
        wrong += [
            f"MAY_IMPORT of {room} names {other}, which it does not import"
            for other in sorted(set(may) - used[room])
        ]
    return wrong + ["circle: " + " -> ".join(circle) for circle in circles(graph)]


def lines_of(node: ast.Module | ast.ClassDef | ast.FunctionDef, lines: int) -> int:
    """``lines`` without what follows the first line of each docstring of a node and of what it holds."""
    documented = [n for n in ast.walk(node) if isinstance(n, (ast.Module, ast.ClassDef, ast.FunctionDef))]
    return lines - sum((ast.get_docstring(n) or "").count("\n") for n in documented)


def long_ones(package: Path) -> dict[str, int]:
    """ "module.py" or "module.py:function" -> lines, of all that are longer than allowed without a reason."""
    too_long = {}
    for path in sorted(package.rglob("*.py")):
        name, text = str(path.relative_to(package)), path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        lines = lines_of(tree, len(text.splitlines()))
        if lines > MODULE_LINES and not REASON.search(ast.get_docstring(tree) or ""):
            too_long[name] = lines

        def functions(node: ast.AST, above: str, name: str = name) -> None:
            for child in ast.iter_child_nodes(node):
                inner = (
                    f"{above}.{child.name}"
                    if above and hasattr(child, "name")
                    else getattr(child, "name", above)
                )
                if isinstance(child, ast.FunctionDef):
                    lines = lines_of(child, child.end_lineno - child.lineno + 1)
                    if lines > FUNCTION_LINES and not REASON.search(ast.get_docstring(child) or ""):
                        too_long[f"{name}:{inner}"] = lines
                functions(child, inner)

        functions(tree, "")
    return too_long


def shared_class_names(package: Path) -> dict[str, list[str]]:
    """Name -> the modules that define it, of every public class that is defined more than once."""
    defined: dict[str, list[str]] = {}
    for path in sorted(package.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                defined.setdefault(node.name, []).append(str(path.relative_to(package)))
    return {name: modules for name, modules in defined.items() if len(modules) > 1}


def picture(package: Path) -> str:
    """Each room and the rooms that it imports, as README shows them."""
    rows = [" ".join((f"{room:9}", *(c for c in ORDER if c in declared(package, room)[1]))) for room in ORDER]
    return "\n".join(row.rstrip() for row in rows) + "\n"


def exists(stop: tuple[str, str]) -> bool:
    """Whether a stop's file is there and defines its function."""
    file, function = stop
    path = ROOT / file
    if not path.is_file():
        return False
    text, name = path.read_text(encoding="utf-8"), function.split(".")[-1]
    if path.suffix != ".py":
        return (
            re.search(
                rf"^(?!\s*(?:return|//))[^\n=;]*[\w>&*]\s*[ *&](?:\w+::)?{name}\s*\(", text, re.MULTILINE
            )
            is not None
        )
    body: list[ast.stmt] = ast.parse(text).body
    for part in function.split("."):
        node = next(
            (n for n in body if isinstance(n, (ast.FunctionDef, ast.ClassDef)) and n.name == part), None
        )
        if node is None:
            return False
        body = node.body
    return True


@pytest.mark.unhurried
def test_rooms_import_only_what_stands_below_them_and_in_no_circle():
    assert faults(PACKAGE) == []


@pytest.fixture
def planted(tmp_path):
    """A package of two rooms in order."""
    for room, may in (("low", "()"), ("high", '("low",)')):
        (tmp_path / room).mkdir()
        (tmp_path / room / "__init__.py").write_text(
            f'"""{"What comes in, and what goes out. " * 3}"""\n\nMAY_IMPORT = {may}\n'
        )
    (tmp_path / "__init__.py").write_text("")
    (tmp_path / "low" / "a.py").write_text("")
    (tmp_path / "low" / "b.py").write_text("from . import a\n")
    (tmp_path / "high" / "c.py").write_text("from ..low import a\n")
    assert faults(tmp_path, ("low", "high")) == []
    return tmp_path


@pytest.mark.parametrize(
    "file, text, said",
    [
        (
            "low/a.py",
            "from ..high import c\n",
            "lpvguard.low.a imports lpvguard.high.c: high stands above low",
        ),
        (
            "low/a.py",
            "def f():\n    from lpvguard.high.c import a\n",
            "lpvguard.low.a imports lpvguard.high.c: high stands above low",
        ),
        (
            "low/a.py",
            'from importlib import import_module\nimport_module("lpvguard.high.c")\n',
            "high stands above low",
        ),
        ("low/a.py", "from .b import a\n", "circle: lpvguard.low.a -> lpvguard.low.b -> lpvguard.low.a"),
        ("high/c.py", "", "MAY_IMPORT of high names low, which it does not import"),
        ("high/__init__.py", '"""Short."""\nMAY_IMPORT = ("low",)\n', "high/__init__.py does not say"),
        (
            "high/__init__.py",
            f'"""{"x" * 90}"""\nMAY_IMPORT = ()\n',
            "high imports low, which its MAY_IMPORT does not name",
        ),
        ("third/__init__.py", "", "lpvguard.third stands in no room"),
    ],
)
def test_a_planted_fault_is_found(planted, file, text, said):
    (planted / file).parent.mkdir(exist_ok=True)
    (planted / file).write_text(text)
    assert any(said in fault for fault in faults(planted, ("low", "high")))


def test_a_planted_import_of_a_side_room_is_found(tmp_path):
    for folder in ("vehicle", f"{EXTRAS}/loop"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "__init__.py").write_text(f'"""{"What comes in. " * 9}"""\n\nMAY_IMPORT = ()\n')
    for folder in ("", EXTRAS):
        (tmp_path / folder / "__init__.py").write_text("")
    (tmp_path / EXTRAS / "loop" / "a.py").write_text("")
    assert faults(tmp_path, ("vehicle", "loop")) == []
    (tmp_path / "vehicle" / "b.py").write_text(f"def f():\n    from ..{EXTRAS}.loop import a\n")
    assert f"lpvguard.vehicle.b imports lpvguard.{EXTRAS}.loop.a: loop stands above vehicle" in faults(
        tmp_path, ("vehicle", "loop")
    )
    (tmp_path / "vehicle" / "b.py").write_text("")
    (tmp_path / "loop").mkdir()
    (tmp_path / "loop" / "c.py").write_text("")
    assert f"lpvguard.loop.c stands outside {EXTRAS}" in faults(tmp_path, ("vehicle", "loop"))


@pytest.mark.unhurried
def test_nothing_is_longer_than_allowed():
    assert long_ones(PACKAGE) == {}


def test_a_planted_long_function_is_found_unless_it_says_why(tmp_path):
    body = "    x = 1\n" * FUNCTION_LINES
    (tmp_path / "a.py").write_text(f"class A:\n  def f():\n{body}\n")
    assert long_ones(tmp_path) == {"a.py:A.f": FUNCTION_LINES + 1}
    (tmp_path / "a.py").write_text(
        f'def f():\n    """It does.\n\n    Length: one table, in one place.\n    """\n{body}\n'
    )
    assert long_ones(tmp_path) == {}
    (tmp_path / "a.py").write_text("x = 1\n" * (MODULE_LINES + 1))
    assert long_ones(tmp_path) == {"a.py": MODULE_LINES + 1}


@pytest.mark.unhurried
def test_no_public_class_name_is_defined_twice():
    """One type for one noun: a reader who knows a name knows what it is in every room."""
    assert shared_class_names(PACKAGE) == {}


def test_a_planted_second_class_of_a_name_is_found(planted):
    (planted / "low" / "a.py").write_text("class Signal: ...\nclass _Search: ...\n")
    (planted / "high" / "c.py").write_text("from ..low.a import Signal\nclass _Search: ...\n")
    assert shared_class_names(planted) == {}, "an import is no definition, and a private name stays at home"
    (planted / "high" / "c.py").write_text("class Signal: ...\n")
    assert shared_class_names(planted) == {"Signal": ["high/c.py", "low/a.py"]}


def test_the_picture_in_the_readme_is_that_of_the_packages():
    text = README.read_text(encoding="utf-8")
    assert text.partition(PICTURE[0])[2].partition(PICTURE[1])[0] == picture(PACKAGE)
    table = re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)
    assert table == list(ORDER)


def test_every_room_has_its_folder_of_tests_and_no_other_is_there():
    folders = {path.parent.name for path in Path(__file__).parent.glob("*/test_*.py")}
    assert folders == set(ORDER)


def imported_tests(text: str) -> list[str]:
    """Modules of tests and conftests that a module's ``text`` imports anywhere: which file such a name means
    depends on what pytest collected before."""
    named = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            named += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            named.append(node.module or "")
    return [name for name in named if re.match(r"(test_|conftest\b)", name.rpartition(".")[2])]


@pytest.mark.slow("3 s: every file is read")
def test_no_test_imports_from_another_test():
    """What two tests need stands in a module of tests/."""
    imported = {path.name: imported_tests(path.read_text(encoding="utf-8")) for path in TESTS.rglob("*.py")}
    assert {name: others for name, others in imported.items() if others} == {}
    planted = "import conftest\ndef f():\n    from test_bad_input import table\n"
    assert imported_tests(planted) == ["conftest", "test_bad_input"]


def test_every_stop_of_the_walks_exists():
    text = README.read_text(encoding="utf-8")
    walks = re.split(r"^### ", text.partition("## Three walks")[2].partition("\n## ")[0], flags=re.MULTILINE)[
        1:
    ]
    assert len(walks) == 3
    for walk in walks:
        stops = STOP.findall(walk)
        assert 3 <= len(stops) <= 8 and len(stops) == len(re.findall(r"^\d+\. ", walk, re.MULTILINE)), walk
        assert [stop for stop in stops if not exists(stop)] == []
    assert not exists(("tools/src/lpvguard/drives/tables.py", "no_such_function")) and not exists(
        ("lib/src/guard/ecu.cpp", "no_such_function")
    )


def main() -> None:
    """The room graph and what breaks a rule, printed; with --write, the picture in README renewed."""
    print(picture(PACKAGE))
    for fault in faults(PACKAGE):
        print(fault)
    for name, lines in sorted(long_ones(PACKAGE).items(), key=lambda item: -item[1]):
        print(f"{lines:5} {name}")
    for name, modules in shared_class_names(PACKAGE).items():
        print(f"class {name} is defined in {', '.join(modules)}")
    if "--write" in sys.argv[1:]:
        text = README.read_text(encoding="utf-8")
        before, begin, rest = text.partition(PICTURE[0])
        _, end, after = rest.partition(PICTURE[1])
        if not end:
            raise SystemExit(f"{README} has no place for the picture")
        README.write_text(before + begin + picture(PACKAGE) + end + after, encoding="utf-8")


if __name__ == "__main__":
    main()
