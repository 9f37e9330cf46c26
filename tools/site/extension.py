"""The site's own part of Sphinx: equations as MathML, links from equations and names to the code.

- A block of mathematics becomes MathML, which browsers draw without a script. A ``\\tag{T17}`` numbers it.
- "(T17)" in any page links to that equation. Below each equation stand its code and its test, from the table
  of ``lib/theory/10-code-and-tests.md``.
- `` {source}`words <path>` ``, and every literal that names a file of the tree, link to a page with its text.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import TextLexer, get_lexer_for_filename
from pygments.util import ClassNotFound
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util.docutils import SphinxDirective, SphinxRole

TREE = Path(os.environ["LPVGUARD_TREE"])
TAG = re.compile(r"\\tag\{(T\d+[ab]?)\}")
CITED = re.compile(r"\((T\d+[ab]?)\)")
PLACE = re.compile(r"((?:lib|tools|tests|firmware_sim|data)/[\w./-]+\.[A-Za-z]+)(?::([\w.-]+))?")
SYMBOL = re.compile(
    r"(?<![\w^])(max|min|[A-Za-zΔδΛΦΣαβγηθκλμνξρσφωψτ][̄̂̃]?\d?|[ŷỹê])"
    r"([_^])(?:\{([^{}]+)\}|\((\w+)\)|([A-Za-zΔδκωην0-9∞]{1,4}(?:,[A-Za-z]{1,2})?))(?![\w_])"
)
"""A symbol with a subscript or an exponent, as the theory's sentences write it."""


def code_page(path: str) -> str:
    """Name in the site of the page with the text of a file."""
    return f"code/{path}"


def line_of(path: str, symbol: str) -> int:
    """First line of ``path`` that defines ``symbol``; 1 where none is found."""
    name = re.escape(symbol.rpartition(".")[2])
    pattern = re.compile(
        rf"^\s*(?:async )?(?:def|class|struct) {name}\b|\b{name}\s*\(|\[{name}\]|^{name}\s*[:=]|\b{name}\b"
    )
    lines = (TREE / path).read_text(encoding="utf-8").splitlines()
    defined = re.compile(rf"^\s*(?:def|class|struct) {name}\b")
    for wanted in (defined, pattern):
        for number, line in enumerate(lines, 1):
            if wanted.search(line):
                return number
    return 1


class Source(SphinxRole):
    """`` {source}`words <path>` ``: a link to the text of a file of the tree."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        words, _, path = self.text.rpartition(" <")
        path = path.rstrip(">")
        if not (TREE / path).is_file():
            raise ValueError(f"no file {path}")
        node = nodes.reference("", words or path, refuri="")
        node["lpvguard_source"] = (path, 0)
        return [node], []


class Example(SphinxDirective):
    """The text of a script of ``tools/examples``, and a link to it."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        path = f"tools/examples/{self.arguments[0]}"
        text = (TREE / path).read_text(encoding="utf-8")
        link = nodes.reference("", path, refuri="")
        link["lpvguard_source"] = (path, 0)
        return [nodes.paragraph("", "", link), nodes.literal_block(text, text, language="python")]


def equations(source: Path) -> dict[str, str]:
    """Tag of every equation -> name of the page that holds it."""
    return {
        tag: path.relative_to(source).with_suffix("").as_posix()
        for path in sorted(source.rglob("*.md"))
        for tag in TAG.findall(path.read_text(encoding="utf-8"))
    }


def places(tree: Path) -> dict[str, list[list[tuple[str, str]]]]:
    """Tag -> (path, symbol) of what implements the equation, and of what tests it."""
    text = (tree / "lib" / "theory" / "10-code-and-tests.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \((T\d+)\) \|([^|]*)\|([^|]*)\|$", text, re.MULTILINE)
    return {tag: [re.findall(r"`([^`:]+):([^`]+)`", cell) for cell in cells] for tag, *cells in rows}


class LinkToCode(SphinxPostTransform):
    """Links equations that are cited, and files that are named; subscripts in the theory's symbols."""

    default_priority = 5

    def run(self, **_: Any) -> None:
        doc = self.env.docname
        builder = self.app.builder
        for node in list(self.document.findall(nodes.reference)):
            if "lpvguard_source" in node:
                self._source(node, *node["lpvguard_source"])
        for literal in list(self.document.findall(nodes.literal)):
            m = PLACE.fullmatch(literal.astext())
            if m and (TREE / m[1]).is_file() and not isinstance(literal.parent, nodes.reference):
                node = nodes.reference("", "", literal.deepcopy())
                self._source(node, m[1], line_of(m[1], m[2]) if m[2] else 0)
                literal.replace_self(node)
        known = self.app.lpvguard_equations  # type: ignore[attr-defined]
        for text in list(self.document.findall(nodes.Text)):
            if isinstance(
                text.parent,
                (nodes.literal, nodes.literal_block, nodes.math_block, nodes.reference, nodes.title),
            ):
                continue
            parts = list(self._parts(text.astext(), known, doc, builder))
            if len(parts) > 1:
                text.parent.replace(text, parts)

    def _source(self, node: nodes.reference, path: str, line: int) -> None:
        self.app.lpvguard_sources.add(path)  # type: ignore[attr-defined]
        uri = self.app.builder.get_relative_uri(self.env.docname, code_page(path))
        node["refuri"] = uri + (f"#line-{line}" if line else "")
        node["internal"] = True

    def _parts(self, text: str, known: dict[str, str], doc: str, builder: Any) -> Iterator[nodes.Node]:
        end = 0
        marks = (
            CITED.finditer(text)
            if not doc.startswith("concepts/")
            else re.finditer(f"{CITED.pattern}|{SYMBOL.pattern}", text)
        )
        for m in marks:
            if m[1] and m[1] not in known:
                continue
            yield nodes.Text(text[end : m.start()])
            if m[1]:
                uri = builder.get_relative_uri(doc, known[m[1]]) + f"#{m[1]}"
                yield nodes.reference("", m[0], refuri=uri, internal=True)
            else:
                yield nodes.Text(m[2])
                small = next(words for words in m.groups()[3:] if words)
                yield (nodes.subscript if m[3] == "_" else nodes.superscript)("", small)
            end = m.end()
        yield nodes.Text(text[end:])


def inline_math(self: Any, node: nodes.math) -> None:
    self.body.append(convert(node.astext()))
    raise nodes.SkipNode


def block_math(self: Any, node: nodes.math_block) -> None:
    """MathML of an equation, its number, and the places of its code and its test."""
    latex = node.astext()
    tag = TAG.search(latex)
    place = f' id="{tag[1]}"' if tag else ""
    self.body.append(f'<div class="equation"{place}>')
    self.body.append(f'<div class="formula">{convert(TAG.sub("", latex).strip(), display="block")}</div>')
    if tag:
        self.body.append(f'<span class="number">({tag[1]})</span>')
    self.body.append("</div>")
    places = self.builder.app.lpvguard_places.get(tag[1]) if tag else None
    if places:
        cells = []
        for word, links in zip(("Code", "Test"), places, strict=True):
            made = []
            for path, symbol in links[:3]:
                self.builder.app.lpvguard_sources.add(path)
                uri = self.builder.get_relative_uri(self.builder.current_docname, code_page(path))
                shown = symbol if len(symbol) < 48 else f"{symbol[:45]}…"
                made.append(
                    f'<a href="{uri}#line-{line_of(path, symbol)}" title="{escape(path)}">'
                    f"<code>{escape(shown)}</code></a>"
                )
            cells.append(f"{word}: {', '.join(made)}")
        self.body.append(f'<p class="places">{"; ".join(cells)}.</p>')
    raise nodes.SkipNode


CODE_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{path}</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="stylesheet" href="{root}_static/pygments.css">
<link rel="stylesheet" href="{root}_static/site.css"></head>
<body class="code"><p><a href="{root}index.html">{project}</a></p><h1>{path}</h1>{text}</body></html>
"""


def source_pages(app: Sphinx, exception: Exception | None) -> None:
    """Writes a page for each file of the tree that some page links to."""
    if exception is not None:
        return
    formatter = HtmlFormatter(lineanchors="line", linenos="table", wrapcode=True)
    for path in sorted(app.lpvguard_sources):  # type: ignore[attr-defined]
        text = (TREE / path).read_text(encoding="utf-8")
        try:
            lexer = get_lexer_for_filename(path)
        except ClassNotFound:
            lexer = TextLexer()
        target = Path(app.outdir) / f"{code_page(path)}.html"
        target.parent.mkdir(parents=True, exist_ok=True)
        root = "../" * code_page(path).count("/")
        shown = highlight(text, lexer, formatter)
        page = CODE_PAGE.format(path=escape(path), root=root, project=app.config.project, text=shown)
        target.write_text(page, encoding="utf-8")


def prepare(app: Sphinx) -> None:
    app.lpvguard_equations = equations(Path(app.srcdir))  # type: ignore[attr-defined]
    app.lpvguard_places = places(TREE)  # type: ignore[attr-defined]
    app.lpvguard_sources = set()  # type: ignore[attr-defined]


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_html_math_renderer("mathml", (inline_math, None), (block_math, None))
    app.add_role("source", Source())
    app.add_directive("example", Example)
    app.add_post_transform(LinkToCode)
    app.connect("builder-inited", prepare)
    app.connect("build-finished", source_pages)
    return {"version": "1", "parallel_read_safe": False, "parallel_write_safe": False}
