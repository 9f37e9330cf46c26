"""The gate on mutants, on a program so small that the fate of each of its mutants is known."""

import json
import re
import shutil
from pathlib import Path

import pytest

from mutation import Sites, merged, read, switched
from mutation_run import (
    CLANG,
    EQUIVALENT,
    OPEN,
    TOUCHED,
    Mutant,
    chosen,
    command,
    core_files,
    dumped,
    judged,
    mutants_of,
    no_longer,
    reached_by,
    surviving,
    table,
    too_many,
)

TESTS = Path(__file__).resolve().parents[1]
SOURCE = """int lpvg_limited(int x) {
    int y = 0;
    for (int i = 0; i < 3; ++i) {
        y += x;
    }
    if (y > 30) {
        y = 30;
    }
    return y;
}

int lpvg_unused(int x) { return x + 1; }
"""
CASES = """#include "catch.hpp"
int lpvg_limited(int x);
TEST_CASE("within the limit, exactly", "[unit]") { CHECK(lpvg_limited(2) == 6); }
TEST_CASE("beyond it", "[unit]") { CHECK(lpvg_limited(20) == 30); }
TEST_CASE("all but it", "[hour]") { CHECK(lpvg_limited(10) == 30); CHECK(lpvg_limited(-11) == -33); }
"""
AT_THE_BORDER = {f"if (y > 30) {{  ->  if (y {new}) {{" for new in (">= 30", "> 31", "> 29")}
"""What no case asks about; the first is no change at all."""


LONG = pytest.mark.long("10 s: a program with its mutants")


@pytest.fixture(scope="module")
def clang() -> str:
    name = f"clang++-{CLANG}"
    if shutil.which(name) is None:
        pytest.skip(f"{name} not found")
    return name


@pytest.fixture(scope="module")
def ran(clang: str, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Mutant], list[Mutant]]:
    """All mutants of the small program, and those that survive its tests."""
    folder = tmp_path_factory.mktemp("mutants")
    source = folder / "small.cpp"
    source.write_text(SOURCE)
    words = [clang, "-std=c++17", str(source)]
    sites: Sites = merged([dumped(words, folder, {str(source): read(source)})[str(source)]])
    mutants = mutants_of(source.name, sites, 0)
    source.write_text(switched(read(source), sites, 0))
    (folder / "main.cpp").write_text(
        f'#include "{TESTS}/unit/catch_main.cpp"\n#include "{TESTS}/gates/mutant_switch.cpp"\n'
    )
    (folder / "cases.cpp").write_text(CASES)
    program = folder / "test_small"
    switch = ("-include", TESTS / "gates" / "mutant_switch.h")
    files = [folder / name for name in ("small.cpp", "cases.cpp", "main.cpp")]
    command(clang, "-std=c++17", "-O0", "-w", "-I", TESTS, *switch, *files, "-o", program)
    return mutants, surviving(mutants, reached_by([program], folder), folder)


@LONG
def test_what_a_case_asks_about_is_killed_and_the_rest_survives(ran):
    mutants, survived = ran
    assert {m.key for m in survived if m.site.function == "lpvg_limited"} == AT_THE_BORDER
    assert all(m in survived for m in mutants if m.site.function == "lpvg_unused")
    assert len({(m.site.function, m.key) for m in mutants}) == len(mutants) > 20


@LONG
def test_a_loop_that_does_not_end_is_killed(ran):
    mutants, survived = ran
    [endless] = [m for m in mutants if m.key.endswith("i < 3; --i) {")]
    assert endless not in survived


@LONG
def test_the_table_and_the_findings_count_every_survivor_once(ran):
    mutants, survived = ran
    equivalent = {"small.cpp": {"lpvg_limited": {"if (y > 30) {  ->  if (y >= 30) {": "30 becomes 30"}}}
    known = {"small.cpp": {"lpvg_unused": {m.key: "" for m in survived if m.site.function == "lpvg_unused"}}}
    n_known = len(known["small.cpp"]["lpvg_unused"])
    sums = table(mutants, survived, equivalent, known)[-1].strip("| ").split(" | ")
    n, n_alive = len(mutants), len(survived)
    assert sums == ["**all**", str(n), str(n - n_alive), "1", str(n_known), str(n_alive - 1 - n_known)]
    findings = judged(mutants, survived, equivalent, known, {"small.cpp"})
    assert sorted(f.split(": ")[0] for f in findings) == ["survived", "survived"]


@LONG
def test_what_no_longer_survives_is_told_and_refutes_an_argument(ran):
    mutants, survived = ran
    killed = next(m for m in mutants if m not in survived)
    for stale, why in ((killed.key, "is killed"), ("x  ->  y", "is no mutant")):
        notes = {"small.cpp": {killed.site.function: {stale: ""}}}
        stale_notes = no_longer(mutants, survived, notes, {"small.cpp"})
        assert stale_notes == [f"small.cpp: {killed.site.function}: {stale}: {why}: take it out"]
        findings = judged(mutants, survived, notes, {}, {"small.cpp"})
        assert f"equivalent_mutants.json: {stale_notes[0]}" in findings
        assert not any("take it out" in f for f in judged(mutants, survived, {}, notes, {"small.cpp"}))


@LONG
def test_more_than_a_twentieth_cannot_be_argued_away(ran):
    mutants, survived = ran
    notes: dict[str, dict[str, str]] = {}
    for mutant in survived:
        notes.setdefault(mutant.site.function, {})[mutant.key] = ""
    refused = too_many(mutants, survived, {"small.cpp": notes})
    assert refused == [f"{len(survived)} of {len(mutants)} mutants are argued equivalent: more than 5 %"]
    assert too_many(mutants, survived, {}) == []


def test_what_a_change_touches_is_asked_and_else_nothing(tmp_path):
    """In a repository of two files: without git, on the main branch, beside it, with work not committed."""
    names = ["can.cpp", "ecu.cpp"]
    source, tests = tmp_path / "lib" / "src", tmp_path / "tests" / "unit"
    for folder in (source, tests):
        folder.mkdir(parents=True)
    (source / "can.cpp").write_text("can")
    (source / "ecu.cpp").write_text("ecu")

    def git(*words: str) -> None:
        command("git", "-c", "user.name=t", "-c", "user.email=t@t", *words, cwd=tmp_path)

    def commit(path: Path) -> None:
        path.write_text(path.read_text() + "more" if path.exists() else "new")
        git("add", "-A")
        git("commit", "-q", "-m", "one change")

    def asked() -> tuple[list[str], int]:
        return chosen(tmp_path, names, full=False, only="")

    assert asked() == ([], TOUCHED), "git cannot say"
    git("init", "-q", "-b", "main")
    commit(tmp_path / "README.md")
    assert asked() == ([], TOUCHED), "no commit before it"
    commit(tmp_path / "README.md")
    assert asked() == ([], TOUCHED)
    commit(source / "can.cpp")
    assert asked() == (["can.cpp"], TOUCHED)
    commit(tests / "can.cpp")
    assert asked() == ([], TOUCHED), "a test"
    git("checkout", "-q", "-b", "beside")
    assert asked() == ([], TOUCHED)
    commit(source / "ecu.cpp")
    commit(tmp_path / "README.md")
    assert asked() == (["ecu.cpp"], TOUCHED)
    (source / "can.cpp").write_text("not committed")
    assert asked() == (names, TOUCHED)
    assert chosen(tmp_path, names, full=True, only="") == (names, 0)
    assert chosen(tmp_path, names, full=False, only="can.cpp") == (["can.cpp"], 0)


def test_the_page_has_the_table_of_the_lists():
    """``gates.py mutation --table`` counts mutants from clang's tree; what is listed is counted here."""
    here = Path(__file__).parent
    of_core, _ = (here / "MUTANTS.md").read_text().split("## Python mutants")
    equivalent, known = (json.loads((here / name).read_text()) for name in (EQUIVALENT, OPEN))
    row = r"^\| (\S+\.[a-z]+|\*\*all\*\*) \| (\d+) \| (\d+) \| (\d+) \| (\d+) \| (\d+) \|$"
    rows = re.findall(row, of_core, re.MULTILINE)
    counts = {name: [int(n) for n in numbers] for name, *numbers in rows}
    sums = counts.pop("**all**")
    assert sums == [sum(column) for column in zip(*counts.values(), strict=True)]
    without_code = {"begin.hpp", "control_begin.hpp", "eigen.hpp"}
    assert set(counts) == {p.name for p in core_files(here.parents[1])} - without_code
    for name, (n, killed, equal, still, survived) in counts.items():
        assert equal == sum(map(len, equivalent.get(name, {}).values())), name
        assert still == sum(map(len, known.get(name, {}).values())), name
        assert (n, survived) == (killed + equal + still, 0), name
