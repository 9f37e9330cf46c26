"""Pages of the site that are made from the code: verbs, C headers, Python modules, the theory's contents."""

from __future__ import annotations

import ast
import re
import textwrap
from pathlib import Path

HEADER_ITEM = re.compile(r"((?:^///[^\n]*\n)+)((?:^(?!///|\n|#)[^\n]*\n)+)", re.MULTILINE)
Definition = ast.FunctionDef | ast.ClassDef
DEFINITIONS = (ast.FunctionDef, ast.ClassDef)


def pages(tree: Path) -> dict[str, str]:
    """Name in the site -> Markdown text of every generated page."""
    return {
        "reference/verbs": verbs(),
        **{f"reference/c/{path.stem}": c_header(path) for path in c_headers(tree)},
        "reference/c/index": c_index(tree),
        **python_pages(tree),
    }


# --- verbs ---


def verbs() -> str:
    """Return the help text of every verb of the command line."""
    import click
    import typer

    from lpvguard import cli

    root = typer.main.get_command(cli.app)
    text = ["# Verbs", "", "Each verb prints this text with `--help`.", ""]

    def describe(command: click.Command, path: list[str], parent: click.Context | None) -> None:
        context = type(command).context_class(
            command, info_name=path[-1], parent=parent, terminal_width=100, max_content_width=100
        )
        level = "#" * min(len(path) + (len(path) == 1), 4)
        text.extend(
            [f"{level} {' '.join(path)}", "", "```text", command.get_help(context).rstrip(), "```", ""]
        )
        for name in getattr(command, "commands", {}):
            describe(command.commands[name], [*path, name], context)

    describe(root, ["lpvguard"], None)
    return "\n".join(text)


# --- C headers ---


def c_headers(tree: Path) -> list[Path]:
    """The public headers, in the order of their names."""
    return sorted((tree / "lib" / "include" / "lpvguard").glob("*.h"))


def c_index(tree: Path) -> str:
    """The list of headers with the question that each answers."""
    rows = []
    for path in c_headers(tree):
        first = path.read_text(encoding="utf-8").partition("\n")[0]
        rows.append(f"| [{path.name}]({path.stem}.md) | {markdown(first.partition(' -- ')[2])} |")
    names = [path.stem for path in c_headers(tree)]
    return "\n".join(
        [
            *("# C headers", "", "| header | what it is |", "| --- | --- |", *rows, ""),
            *("```{toctree}", ":hidden:", "", *names, "```", ""),
        ]
    )


def markdown(text: str) -> str:
    """A comment's words as Markdown: what would be markup stands for itself."""
    kept = r"(``[^`]*``|`[^`]*`|(?<![\w*])\*\w[\w ]*\*(?!\w))"  # code, and words that are emphasised
    return "".join(
        part if re.fullmatch(kept, part) else re.sub(r"([\\*_<>\[\]|#])", r"\\\1", part)
        for part in re.split(kept, text)
    )


def comment_blocks(lines: list[str]) -> list[str]:
    """Paragraphs and indented blocks of a comment as Markdown."""
    out: list[str] = []
    for block in re.split(r"\n\s*\n", "\n".join(lines)):
        if not block.strip():
            continue
        if all(line.startswith("  ") for line in block.splitlines()):
            out += ["```text", textwrap.dedent(block), "```", ""]
        elif re.match(r"(?:Use|Cost|Threads|RAM|Integrity):", block):
            for item in re.split(r"\n(?=\w+:)", block):
                word, _, rest = item.partition(":")
                out += [f"**{word}.** {markdown(' '.join(rest.split()))}", ""]
        else:
            out += [markdown(" ".join(block.split())), ""]
    return out


def c_header(path: Path) -> str:
    """The page of one header: its head, its types and every function with its comment."""
    text = path.read_text(encoding="utf-8")
    head = []
    lines = text.splitlines()
    while lines and lines[0].startswith("///"):
        head.append(re.sub(r"^/// ?", "", lines.pop(0)))
    title = head[0].partition(" -- ")[2]
    out = [f"# {path.name}", "", markdown(title[:1].upper() + title[1:]), ""]
    out += [f"The source is {{source}}`{path.name} <lib/include/lpvguard/{path.name}>`.", ""]
    out += comment_blocks(head[1:])
    body = "\n".join(lines)
    types = re.findall(
        r"^(?:///[^\n]*\n)*typedef (?:enum|struct|union)[^{;]*\{.*?^\} *\w+ *;",
        body,
        re.MULTILINE | re.DOTALL,
    )
    constants = re.findall(r"^#define \w+ [^\n\\]*///<[^\n]*$", body, re.MULTILINE)
    if constants:
        out += ["## Constants", "", "```c", *constants, "```", ""]
    if types:
        out += ["## Types", ""]
        for item in types:
            name = item.rstrip(" ;").rsplit(None, 1)[-1]
            out += [f"### {name}", "", "```c", item, "```", ""]
    functions = [
        (comment, declaration)
        for comment, declaration in HEADER_ITEM.findall(body + "\n")
        if re.search(r"\blpvg_\w+\s*\(", declaration) and "typedef" not in declaration
    ]
    if functions:
        out += ["## Functions", ""]
    for comment, declaration in functions:
        name = re.search(r"\b(lpvg_\w+)\s*\(", declaration)
        assert name is not None
        out += [f"### {name[1]}", "", "```c", declaration.partition("{")[0].strip(), "```", ""]
        out += comment_blocks([re.sub(r"^/// ?", "", line) for line in comment.splitlines()])
    return "\n".join(out)


# --- Python ---

PUBLIC = (
    ("identify_drives", "api/identification.py"),
    ("load", "api/identification.py"),
    ("Identified", "api/identification.py"),
    ("replay_drive", "api/drive_replay.py"),
    ("Replayed", "api/drive_replay.py"),
    ("Monitor", "api/monitor.py"),
    ("InputError", "base/errors.py"),
)
"""Names that ``import lpvguard`` gives, and the module that defines each."""
SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)
NAMED_ENTRIES = ("Parameters", "Returns", "Raises", "Attributes", "Yields", "Other Parameters")


def python_pages(tree: Path) -> dict[str, str]:
    """A page for each room of the package, and their list. Nothing is imported: the sources are parsed."""
    package = tree / "tools" / "src" / "lpvguard"
    out, rows = {}, []
    rooms = sorted(path.parent for path in package.glob("*/__init__.py") if path.parent.name != "extras")
    rooms += sorted(path.parent for path in package.glob("extras/*/__init__.py"))
    for room in rooms:
        own = ast.get_docstring(ast.parse((room / "__init__.py").read_text(encoding="utf-8"))) or ""
        text = [f"# {'.'.join(('lpvguard', *room.relative_to(package).parts))}", "", *docstring(own)]
        for path in sorted(room.rglob("*.py")):
            if not path.name.startswith("_"):
                text += python_module(path, package)
        out[f"reference/python/{room.name}"] = "\n".join(text)
        rows.append(f"| [{room.name}]({room.name}.md) | {markdown(summary(own))} |")
    text = ["# Python", "", "These names are those of `import lpvguard`.", ""]
    for name, module in PUBLIC:
        body = ast.parse((package / module).read_text(encoding="utf-8")).body
        (node,) = (n for n in body if isinstance(n, DEFINITIONS) and n.name == name)
        text += definition(node, "##")
    text += ["## Rooms of the package", "", "| room | what it does |", "| --- | --- |", *rows, ""]
    text += ["```{toctree}", ":hidden:", "", *(room.name for room in rooms), "```", ""]
    out["reference/python/index"] = "\n".join(text)
    return out


def summary(text: str) -> str:
    """First sentence of a docstring."""
    return re.split(r"(?<=[.:])\s", " ".join(text.split()), maxsplit=1)[0]


def python_module(path: Path, package: Path) -> list[str]:
    """A module's docstring and its public definitions."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    public = [n for n in tree.body if isinstance(n, DEFINITIONS) and not n.name.startswith("_")]
    name = ".".join(path.relative_to(package).with_suffix("").parts)
    source = f"tools/src/lpvguard/{path.relative_to(package).as_posix()}"
    text = [f"## {name}", "", f"{{source}}`{path.name} <{source}>`", ""]
    text += docstring(ast.get_docstring(tree) or "")
    for node in public:
        text += definition(node, "###")
    return text


def definition(node: Definition, level: str) -> list[str]:
    """A function or class as Markdown: its signature, its docstring and its public methods."""
    text = [f"{level} {markdown(node.name)}", "", "```python", signature(node), "```", ""]
    text += docstring(ast.get_docstring(node) or "")
    if isinstance(node, ast.ClassDef):
        for inner in node.body:
            if (
                isinstance(inner, ast.FunctionDef)
                and not inner.name.startswith("_")
                and ast.get_docstring(inner)
            ):
                text += ["```python", signature(inner), "```", "", *docstring(ast.get_docstring(inner) or "")]
    return text


def signature(node: Definition) -> str:
    """The first lines of a definition, without its body."""
    if isinstance(node, ast.ClassDef):
        bases = ", ".join(ast.unparse(base) for base in node.bases)
        fields = [ast.unparse(n) for n in node.body if isinstance(n, ast.AnnAssign)]
        return "\n".join(
            [f"class {node.name}({bases}):" if bases else f"class {node.name}:"]
            + [f"    {f}" for f in fields]
        )
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    arguments = ast.unparse(node.args)
    if len(arguments) > 80:
        arguments = "\n    " + ",\n    ".join(re.split(r", (?=\**\w+(?:[:,=]|$))", arguments)) + ",\n"
    return f"def {node.name}({arguments}){returns}"


def docstring(text: str) -> list[str]:
    """A docstring in numpydoc form as Markdown."""
    first, *rest = SECTION.split(text)
    out = comment_blocks(first.splitlines())
    for title, body in zip(rest[::2], rest[1::2], strict=True):
        out += [f"**{title}**", ""]
        if title in NAMED_ENTRIES:
            for entry in re.split(r"\n(?=\S)", body.strip("\n")):
                head, _, lines = entry.partition("\n")
                name, _, kind = head.partition(" : ")
                out.append(
                    f"- `{name}`{f' ({markdown(kind)})' if kind else ''}: {markdown(' '.join(lines.split()))}"
                )
            out.append("")
        else:
            out += comment_blocks(body.strip("\n").splitlines())
    return out
