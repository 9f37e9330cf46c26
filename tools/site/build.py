"""Builds the documentation site; `tools/docs` is the command.

The sources are Markdown pages in ``tools/site/pages`` and the pages of other folders (``PAGES``). They are
copied to OUT/source under the names of the site, with their links rewritten. Sphinx builds them to OUT/html
with warnings as errors. Every internal link of the built pages is then followed.
"""

from __future__ import annotations

import argparse
import html.parser
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote, urlsplit

import generated

SITE = Path(__file__).resolve().parent
ROOT = SITE.parents[1]
PAGES = {
    "tools/TUTORIAL.md": "start/tutorial",
    "lib/THEORY.md": "concepts/theory",
    "lib/README.md": "reference/core",
    "lib/INTEGRATION.md": "howto/integrate",
    "lib/COEFFICIENTS.md": "reference/coefficients",
    "lib/REQUIREMENTS.md": "reference/requirements",
    "lib/MISRA.md": "reference/misra_c",
    "lib/MISRA_CPP.md": "reference/misra_cpp",
    "data/README.md": "reference/data",
    "firmware_sim/README.md": "reference/simulator",
    "tests/README.md": "reference/tests",
    "tools/README.md": "reference/package",
    "CONTRIBUTING.md": "howto/contribute",
    "CHANGELOG.md": "log/changelog",
    "tools/DESIGN_LOG.md": "log/design_log",
    "tests/gates/MUTANTS.md": "log/mutants",
    "tools/FORMATS.md": "reference/formats",
}
"""Page beside what it describes -> its name in the site."""
FENCE = re.compile(r"^(```|~~~).*?^\1", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\((?![a-z]+:)([^)#\s]*)(#[^)\s]*)?\)")


class BrokenLink(Exception):
    """A link leads nowhere; the text says where it stands."""


def pages_of(tree: Path) -> dict[str, str]:
    """Every Markdown page of the site: path in ``tree`` -> name in the site."""
    own = {
        path.relative_to(tree).as_posix(): path.relative_to(tree / "tools/site/pages")
        .with_suffix("")
        .as_posix()
        for path in sorted((tree / "tools/site/pages").rglob("*.md"))
    }
    theory = {
        path.relative_to(tree).as_posix(): f"concepts/{path.stem}"
        for path in sorted((tree / "lib/theory").glob("*.md"))
    }
    return own | theory | PAGES


def rewritten(tree: Path, path: str, pages: dict[str, str], source: Path) -> str:
    """Text of a page with its links as the site has them; copies the pictures that it shows."""
    text = (tree / path).read_text(encoding="utf-8")
    name = pages[path]
    places = [m.span() for m in FENCE.finditer(text)] + [m.span() for m in re.finditer(r"`[^`\n]+`", text)]

    def link(m: re.Match[str]) -> str:
        if any(start <= m.start() < end for start, end in places):
            return m[0]
        picture, words, target, anchor = m[1], m[2], m[3], m[4] or ""
        if not target:
            return m[0]
        where = Path(os.path.normpath(Path(path).parent / target)).as_posix()
        if where in pages:
            return f"[{words}]({os.path.relpath(pages[where], Path(name).parent)}.md{anchor})"
        if picture and (tree / where).is_file():
            copy = source / "pictures" / Path(where).name
            copy.parent.mkdir(exist_ok=True)
            shutil.copyfile(tree / where, copy)
            return f"![{words}]({os.path.relpath(copy, source / Path(name).parent)})"
        if (tree / where).is_file():
            return f"{{source}}`{words.replace('`', '')} <{where}>`"
        if f"{where}/README.md" in pages:
            return f"[{words}]({os.path.relpath(pages[f'{where}/README.md'], Path(name).parent)}.md)"
        if (tree / where).is_dir():
            return words
        raise BrokenLink(
            f"{path}:{text.count(chr(10), 0, m.start()) + 1}: link to {target}, which is not there"
        )

    return LINK.sub(link, text)


def stage(tree: Path, source: Path) -> None:
    """Copies and generates every page of the site in ``source``."""
    pages = pages_of(tree)
    for path, name in pages.items():
        target = source / f"{name}.md"
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(rewritten(tree, path, pages, source), encoding="utf-8")
    theory = source / f"{PAGES['lib/THEORY.md']}.md"
    names = sorted(
        (Path(path).stem for path in pages if path.startswith("lib/theory/")),
        key=lambda name: [int(number) for number in re.findall(r"\d+", name)],
    )
    contents = "\n".join(["", "```{toctree}", ":hidden:", "", *names, "```", ""])
    theory.write_text(theory.read_text(encoding="utf-8") + contents, encoding="utf-8")
    for name, text in generated.pages(tree).items():
        target = source / f"{name}.md"
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")


class _Targets(html.parser.HTMLParser):
    """Identifiers of a built page, its links, and what it loads."""

    def __init__(self) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for key, value in attrs:
            if value is None:
                continue
            if key in ("id", "name"):
                self.ids.add(value)
            elif tag == "a" and key == "href":
                self.links.append(value)
            elif key in ("src", "href") and tag in ("script", "img", "link", "source", "iframe"):
                self.loaded.append(value)


def dead_links(folder: Path) -> list[str]:
    """Links of built pages that lead nowhere, and what a page loads from elsewhere."""
    pages = {}
    for path in sorted(folder.rglob("*.html")):
        pages[path] = _Targets()
        pages[path].feed(path.read_text(encoding="utf-8"))
    findings = []
    for path, targets in pages.items():
        name = path.relative_to(folder)
        for link in targets.links + targets.loaded:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                if link in targets.loaded and parts.scheme != "data":
                    findings.append(f"{name}: loads {link}, expected a file of the site")
                continue
            target = Path(os.path.normpath(path.parent / unquote(parts.path))) if parts.path else path
            if not target.is_file():
                findings.append(f"{name}: link to {link}, which is not there")
            elif target in pages and unquote(parts.fragment) not in pages[target].ids | {"top", ""}:
                findings.append(f"{name}: {target.name} has no place #{unquote(parts.fragment)}")
    return findings


def build(tree: Path, out: Path) -> list[str]:
    """Builds the site of ``tree`` in ``out``.

    Parameters
    ----------
    tree : Path
        Checkout whose pages are built.
    out : Path
        Folder that receives ``source`` and ``html``.

    Returns
    -------
    list of str
        Findings; the site is good when there are none.
    """
    source, target = out / "source", out / "html"
    shutil.rmtree(source, ignore_errors=True)
    shutil.rmtree(target, ignore_errors=True)
    try:
        stage(tree, source)
    except BrokenLink as error:
        return [str(error)]
    done = subprocess.run(
        [
            *(sys.executable, "-m", "sphinx", "-q", "-n", "-W", "--keep-going", "-b", "html"),
            *("-c", SITE, "-d", out / "doctrees", source, target),
        ],
        env={**os.environ, "LPVGUARD_TREE": str(tree)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    said = [line for line in done.stdout.splitlines() if line.strip()]
    return said or ([f"sphinx: status {done.returncode}"] if done.returncode else dead_links(target))


def main() -> int:
    parser = argparse.ArgumentParser(prog="tools/docs", description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, nargs="?", default=ROOT / "out" / "docs", help="default: out/docs")
    parser.add_argument("--tree", type=Path, default=ROOT, help=argparse.SUPPRESS)
    options = parser.parse_args()
    findings = build(options.tree.resolve(), options.out.resolve())
    for finding in findings:
        print(f"tools/docs: {finding}", file=sys.stderr)
    if not findings:
        print(options.out / "html" / "index.html")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
