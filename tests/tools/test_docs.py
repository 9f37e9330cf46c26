"""The documentation site: it builds without a warning, every link of it leads somewhere, and it loads nothing
from elsewhere. A planted broken link is found at each stage."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from made import ROOT
from parts import site_builder

SITE = ROOT / "tools" / "site"


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """Folder of the built pages."""
    out = tmp_path_factory.mktemp("docs")
    done = subprocess.run(
        [sys.executable, SITE / "build.py", out], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return out / "html"


@pytest.mark.slow("40 s: Sphinx builds the site")
def test_the_site_builds_strictly_and_has_every_section(site):
    index = (site / "index.html").read_text()
    for section in ("start", "concepts", "howto", "gallery", "reference", "log"):
        assert f'href="{section}/' in index
    assert len(list((site / "howto").glob("*.html"))) > 15
    assert len(list((site / "reference" / "c").glob("*.html"))) > 15
    assert "lpvg_monitor_push" in (site / "reference" / "c" / "monitor.html").read_text()
    assert "lpvguard identify" in (site / "reference" / "verbs.html").read_text()
    assert (site / "searchindex.js").is_file()


@pytest.mark.slow("40 s: Sphinx builds the site")
def test_every_equation_is_mathml_with_its_number_code_and_test(site):
    text = "".join(path.read_text() for path in (site / "concepts").glob("*.html"))
    numbers = {int(n) for n in re.findall(r'<div class="equation" id="T(\d+)">', text)}
    assert numbers == set(range(1, max(numbers) + 1)) and len(numbers) > 45
    assert text.count("<math") > len(numbers) and "merror" not in text
    assert text.count('<p class="places">Code: ') == len(numbers)


@pytest.mark.slow("40 s: Sphinx builds the site")
@pytest.mark.parametrize(
    ("planted", "says"),
    [
        ('<a href="nowhere.html">x</a>', "link to nowhere.html"),
        ('<a href="#nowhere">x</a>', "has no place #nowhere"),
        ('<script src="https://example.org/x.js"></script>', "loads https://example.org/x.js"),
    ],
)
def test_a_planted_dead_link_of_a_built_page_is_found(site, planted, says):
    page = site / "start" / "index.html"
    text = page.read_text()
    page.write_text(text.replace("</body>", f"{planted}</body>"))
    try:
        findings = site_builder().dead_links(site)
    finally:
        page.write_text(text)
    assert len(findings) == 1 and says in findings[0]


def test_a_planted_broken_link_of_a_source_stops_the_build(tmp_path):
    build = site_builder()
    (tmp_path / "README.md").write_text("# Page\n\nSee [this](missing).\n")
    with pytest.raises(build.BrokenLink, match=r"README\.md:3: link to missing"):
        build.rewritten(tmp_path, "README.md", {"README.md": "page"}, tmp_path / "source")


def test_links_between_sources_become_links_of_the_site(tmp_path):
    build = site_builder()
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "table.csv").write_text("")
    (tmp_path / "data" / "README.md").write_text("# Data\n")
    source = "[data](data/README.md#part), [table](data/table.csv), [folder](data), `[raw](missing)`\n"
    (tmp_path / "README.md").write_text(source)
    pages = {"README.md": "start/one", "data/README.md": "howto/two"}
    text = build.rewritten(tmp_path, "README.md", pages, tmp_path / "source")
    two = "../howto/two" + ".md"
    assert (
        text == f"[data]({two}#part), {{source}}`table <data/table.csv>`, [folder]({two}), `[raw](missing)`\n"
    )


def test_every_committed_picture_is_made_by_the_script_and_shown():
    pictures = {path.name for path in (SITE / "pages" / "pictures").iterdir()}
    made = (SITE / "pictures.py").read_text()
    pages = "".join(path.read_text() for path in pages_of_people())
    for name in pictures:
        assert f'"{Path(name).stem}"' in made or f'"{name}"' in made, name
        assert f"pictures/{name})" in pages, name


def pages_of_people() -> list[Path]:
    """Every Markdown page of the repository that no program writes."""
    hidden = {"build", "out", "__pycache__", "vehicles"}
    return [
        path
        for path in sorted(ROOT.rglob("*.md"))
        if not any(p.startswith(".") or p in hidden for p in path.relative_to(ROOT).parts)
    ]


def test_the_reading_path_is_short():
    """Everything but the log, the tables of tests and of rules, and generated reference: at most 250 KB."""
    left_out = {"CHANGELOG.md", "tools/DESIGN_LOG.md", "tools/FORMATS.md", "lib/COEFFICIENTS.md"}
    left_out |= {"tests/gates/MUTANTS.md", "lib/theory/10-code-and-tests.md", "lib/theory/8-1-bounds.md"}
    left_out |= {"lib/MISRA.md", "lib/MISRA_CPP.md"}  # a row a rule of the standards
    read = [p for p in pages_of_people() if p.relative_to(ROOT).as_posix() not in left_out]
    assert len(read) > 40
    assert sum(path.stat().st_size for path in read) <= 250_000


def test_readmes_have_at_most_120_lines():
    long = [p for p in pages_of_people() if p.name == "README.md" and p.read_text().count("\n") > 120]
    assert long == []
