"""Docstrings of the package: there, with the shapes of arrays, in sentences that are short enough.

Public is what has no leading underscore, in a module and package that have none, and is not defined inside a
function. What one room offers to another, and everything in ``api``, has numpydoc's form besides.

python tests/gates/test_docstrings.py        prints how many findings each room has, and each of them
"""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from numpydoc.docscrape import NumpyDocString
from numpydoc.hooks.validate_docstrings import AstValidator
from numpydoc.validate import validate

from made import ROOT

PACKAGE = ROOT / "tools/src/lpvguard"
WORDS = 25
"""The longest sentence of a public docstring's first paragraph."""
ARRAY = re.compile(r"\b(?:np\.ndarray|ndarray|NDArray|ArrayLike)\b")
SHAPE = re.compile(
    r"\([\w*+/ .-]*(?:,[\w*+/ .,-]*|\bn_\w+|[A-Z])\)|\bscalar\b|[Ss]hapes? |\bentry by entry\b"
)
"""A shape as "(N, n_y)", "(n,)", or in words: scalar; the shape of something else; entry by entry."""
FORMULA = re.compile(r"``[^`]*``|`[^`]*`|\([^()]*\)|https?://\S+")
"""What is not read as words: code, what stands in brackets, addresses."""
Function = ast.FunctionDef | ast.AsyncFunctionDef


def public(tree: ast.Module) -> Iterator[tuple[str, ast.ClassDef | Function, str]]:
    """(qualified name, node, docstring of the class around it) of everything public in a module."""
    for node in tree.body:
        if isinstance(node, (ast.ClassDef, *Function.__args__)) and not node.name.startswith("_"):
            yield node.name, node, ""
            if isinstance(node, ast.ClassDef):
                around = ast.get_docstring(node) or ""
                for inner in node.body:
                    if isinstance(inner, Function) and not inner.name.startswith("_"):
                        yield f"{node.name}.{inner.name}", inner, around


def sentences(docstring: str) -> Iterator[str]:
    """Sentences of the first paragraph, and items of a list that are divided by semicolons, without indented
    blocks, code and what stands in brackets."""
    paragraph = docstring.split("\n\n")[0]
    lines = [line for i, line in enumerate(paragraph.splitlines()) if i == 0 or not line.startswith("    ")]
    yield from re.split(r"(?<=[.;!?])\s+(?=\S)", FORMULA.sub("x", " ".join(lines)))


def arrays(node: Function) -> bool:
    """Whether a function takes or gives an array, as its annotations say."""
    notes = [a.annotation for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
    return any(ARRAY.search(ast.unparse(note)) for note in (*notes, node.returns) if note is not None)


def findings(path: Path, name: str) -> list[str]:
    """What is wrong with the docstrings of a module, each with its place."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    here = ast.get_docstring(tree) or ""
    faults = [] if here else [f"{name}: no docstring"]
    texts = [(name, here)]
    for what, node, around in public(tree):
        place, text = f"{name}:{what}", ast.get_docstring(node) or ""
        if not text:
            faults.append(f"{place}: no docstring")
            continue
        texts.append((place, text))
        if isinstance(node, Function) and arrays(node) and not SHAPE.search(f"{text} {around}"):
            faults.append(f"{place}: arrays without a shape")
    for place, text in texts:
        for sentence in sentences(text):
            if (words := len(re.findall(r"[^\W_][\w'.-]*", sentence))) > WORDS:
                faults.append(f"{place}: {words} words in one sentence: {sentence[:60]} …")
    return faults


def of_package() -> dict[str, list[str]]:
    """Findings by module, those of private modules left out."""
    paths = sorted(PACKAGE.rglob("*.py"))
    names = [str(path.relative_to(PACKAGE)) for path in paths]
    return {
        name: findings(path, name)
        for path, name in zip(paths, names, strict=True)
        if not re.search(r"(^|/)_(?!_)", name)
    }


@pytest.mark.unhurried
def test_every_public_docstring_says_what_it_has_to():
    faults = [finding for of_module in of_package().values() for finding in of_module]
    assert faults == []


FORM = {
    *("GL06", "GL07", "GL08"),  # sections: unknown, out of order; no docstring
    *("SS01", "SS02", "SS03", "SS06"),  # summary: missing, lower case, no full stop, several lines
    *("PR01", "PR02", "PR03", "PR04", "PR05", "PR10"),  # parameters: missing, unknown, out of order, no type
    *("RT01", "YD01"),  # no Returns, no Yields
}
"""Codes of numpydoc's validation. A parameter's line holds type, shape and unit; describing is optional."""


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")


def taken(path: Path, modules: dict[str, ast.Module]) -> Iterator[tuple[str, str]]:
    """(module, name) of everything that a module takes from modules of the package."""
    name = module_name(path)
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    aliases = {}
    for node in ast.walk(modules[name]):
        if isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            source = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                if f"{source}.{alias.name}" in modules:
                    aliases[alias.asname or alias.name] = f"{source}.{alias.name}"
                else:
                    yield source, alias.name
    for node in ast.walk(modules[name]):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in aliases:
            yield aliases[node.value.id], node.attr


def room(module: str) -> str:
    return next((part for part in module.split(":")[0].split(".")[1:] if part != "extras"), "")


def offered() -> Iterator[tuple[str, Path, ast.ClassDef | Function, ast.AST]]:
    """(place, file, definition, its surroundings) of what a room offers to others, and of all of ``api``."""
    paths = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}
    modules = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in paths.items()}
    wanted = {
        (source, name)
        for importer, path in paths.items()
        for source, name in taken(path, modules)
        if room(source) != room(importer)
    }
    for module, tree in modules.items():
        owners = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
        for name, node, _ in public(tree):
            owner = owners.get(name.rpartition(".")[0])
            if room(module) == "api" or (owner is None and (module, name) in wanted):
                yield f"{module}:{name}", paths[module], node, owner or tree


def undescribed(node: ast.ClassDef) -> set[str]:
    """Fields of a class that neither its docstring nor a text after the field describes."""
    sections = NumpyDocString(ast.get_docstring(node) or "")
    said = {n for s in ("Parameters", "Attributes") for row in sections[s] for n in row.name.split(", ")}
    fields = {
        field.target.id
        for field, after in zip(node.body, [*node.body[1:], None], strict=True)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and not field.target.id.startswith("_")
        and "ClassVar" not in ast.unparse(field.annotation)
        and not (isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant))
    }
    return fields - said


def breaches(place: str, path: Path, node: ast.ClassDef | Function, around: ast.AST) -> list[str]:
    """Return numpydoc's findings in one docstring, by the codes of FORM, each with its place."""
    checked = validate(place, AstValidator, ast_node=node, filename=path, ancestry=[around])
    decorators = [ast.unparse(d) for d in node.decorator_list]
    codes = FORM - {"RT01"} if any("property" in d for d in decorators) else FORM
    broken = [f"{place}: {code} {text}" for code, text in checked["errors"] if code in codes]
    if isinstance(node, ast.ClassDef) and (names := undescribed(node)):
        broken.append(f"{place}: fields without a description: {', '.join(sorted(names))}")
    return broken


@pytest.mark.unhurried
def test_what_a_room_offers_has_numpydoc_form():
    broken = [breach for what in offered() for breach in breaches(*what)]
    assert broken == []


OFFERED = '''class Filter:
    """Filter of first order.

    Attributes
    ----------
    pole : float, rad/s
    """

    pole: float


def gain(x: np.ndarray, low: float) -> np.ndarray:
    """Limit a signal from below.

    Parameters
    ----------
    x : ndarray (N,), m/s
    low : float, m/s

    Returns
    -------
    ndarray (N,)

    Raises
    ------
    ValueError
        If x is empty.
    """
    return x
'''


@pytest.mark.parametrize(
    "old, new, finding",
    [
        ("from below.", "from below", "SS03"),
        ("signal from", "signal\n    from", "SS06"),
        ("    low : float, m/s\n", "", "PR01"),
        ("x :", "xx :", "PR02"),
        ("low : float, m/s\n", "low\n", "PR04"),
        ("Returns\n    -------", "Result\n    ------", "GL06"),
        ("    Returns\n    -------\n    ndarray (N,)\n\n", "", "RT01"),
        ("    pole : float, rad/s", "    zero : float, rad/s", "fields without a description: pole"),
    ],
)
def test_a_planted_breach_of_the_form_is_found(tmp_path, old, new, finding):
    def all_breaches(text: str) -> list[str]:
        path = tmp_path / "planted.py"
        path.write_text(text)
        tree = ast.parse(text)
        return [breach for node in tree.body for breach in breaches("planted", path, node, tree)]

    assert all_breaches(OFFERED) == [] and OFFERED.count(old) == 1
    assert [b for b in all_breaches(OFFERED.replace(old, new)) if finding in b] != []


GOOD = '''"""A module."""

import numpy as np


class Filter:
    """Coefficients (n, 2)."""

    def response(self, omega: np.ndarray) -> np.ndarray:
        """At ``omega`` (K,); returns (K, n)."""

    def _state(self, x: np.ndarray):
        pass


def gain(x: float) -> float:
    """Twice x. The other half of the signal, which nobody has asked for so far, stays where it was before. Of
    another sentence `code with a great many words in it, however many there are of them` counts as one.

        an indented block, however many words there are in it, is a formula and not a sentence to be read in
        one go by anybody, so it does not count either
    """
'''


@pytest.mark.parametrize(
    "old, new, finding",
    [
        ('"""A module."""', "", "planted.py: no docstring"),
        ('"""Coefficients (n, 2)."""', "", "planted.py:Filter: no docstring"),
        ('"""At ``omega`` (K,); returns (K, n)."""', "pass", "planted.py:Filter.response: no docstring"),
        ("(n, 2)", "", "planted.py:Filter.response: arrays without a shape"),
        ("before. Of", "before and of", "planted.py:gain: 26 words in one sentence"),
    ],
)
def test_a_planted_fault_is_found(tmp_path, old, new, finding):
    path = tmp_path / "planted.py"
    path.write_text(GOOD)
    assert findings(path, path.name) == []
    text = GOOD.replace("; returns (K, n)", "").replace("(K,)", "") if old == "(n, 2)" else GOOD
    assert old in text
    path.write_text(text.replace(old, new, 1))
    assert [f for f in findings(path, path.name) if f.startswith(finding)] != []


def room_of(name: str) -> str:
    """The folder in which a module stands, for a side room without that of all side rooms."""
    return name.removeprefix("extras/").split("/")[0]


def main() -> None:
    """The findings, and how many each room has."""
    by_module = of_package()
    rooms = Counter(dict.fromkeys((room_of(name) for name in by_module if "/" in name), 0))
    for name, of_module in by_module.items():
        rooms[room_of(name)] += len(of_module)
        print("\n".join(of_module), end="\n" * bool(of_module))
    print("\n".join(f"{count:5} {room}" for room, count in rooms.most_common()))


if __name__ == "__main__":
    main()
