"""The set-up (tools/setup.sh) with a fake interpreter, apt and dpkg: an environment and a build know their
checkout; the closing line counts what broke off."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from made import ROOT

PYTHON = """#!/bin/sh
# Makes an environment whose pip writes down that it was asked.
case "$*" in
  -V) echo "Python 3.11.${PATCH:-1}" ;;
  "-m venv "*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" ;;
  "-m pip "*) echo "$*" >>"$CALLS"; case "$*" in *"$PIP_FAILS"*) echo "no wheel of it"; exit 1 ;; esac
    touch "${0%/*}/lpvguard"; chmod +x "${0%/*}/lpvguard" ;;
esac
"""


@pytest.fixture
def checkout(tmp_path):
    folder = tmp_path / "one"
    (folder / "tools").mkdir(parents=True)
    for name in ("setup.sh", "pyproject.toml"):
        shutil.copy(ROOT / "tools" / name, folder / "tools")
    shutil.copytree(ROOT / "tools" / "locks", folder / "tools" / "locks")
    (tmp_path / "python").write_text(PYTHON)
    (tmp_path / "python").chmod(0o755)
    return folder


def shell(root: Path, commands: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Commands after the set-up's functions; the interpreter is the fake."""
    script = (
        f'set -euo pipefail; root={root}; . "$root/tools/setup.sh"; '
        f"find_python() {{ python={root.parent}/python; }}; {commands}"
    )
    return subprocess.run(
        ["bash", "-c", script],
        env={**os.environ, "CALLS": str(root.parent / "calls"), "PIP_FAILS": "-nothing-", **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def calls(checkout: Path) -> int:
    """How often the package itself was installed."""
    log = checkout.parent / "calls"
    return log.read_text().count(" -e ") if log.exists() else 0


def test_the_environment_is_made_once_and_anew_for_another_path_or_interpreter(checkout):
    assert shell(checkout, "ensure_venv run").returncode == 0 and calls(checkout) == 1
    assert shell(checkout, "ensure_venv run").stderr == "" and calls(checkout) == 1
    copied = checkout.with_name("two")
    subprocess.run(["cp", "-a", checkout, copied], check=True)
    done = shell(copied, "venv_is_current run || ensure_venv run")
    assert (
        done.returncode == 0
        and "made for another path or interpreter" in done.stderr
        and calls(checkout) == 2
    )
    assert (copied / ".venv" / ".lpvguard-made").read_text().splitlines() == [str(copied), "Python 3.11.1"]
    assert shell(checkout, "ensure_venv run").stderr == "", "the original's is untouched"
    done = shell(checkout, "ensure_venv run", PATCH="9")
    assert "another path or interpreter" in done.stderr and calls(checkout) == 3


def test_a_changed_list_of_packages_is_installed_into_the_same_environment(checkout):
    shell(checkout, "ensure_venv run")
    with (checkout / "tools" / "locks" / "run.txt").open("a") as file:
        file.write("other==1\n")
    done = shell(checkout, "ensure_venv run")
    assert "anew" not in done.stderr and calls(checkout) == 2


def test_nothing_is_installed_whose_hash_is_not_pinned(checkout):
    assert shell(checkout, "ensure_venv test").returncode == 0
    for line in (checkout.parent / "calls").read_text().splitlines():
        own = f"--no-deps --no-build-isolation -e {checkout}/tools"
        assert line.endswith(own) or "--require-hashes --only-binary :all: -r" in line, line


def test_the_pins_are_what_the_package_asks_for():
    project = tomllib.loads((ROOT / "tools" / "pyproject.toml").read_text())
    extras = project["project"]["optional-dependencies"]

    def packages(words: list[str]) -> list[str]:
        """Requirements, with those of an extra in its place."""
        own = [r for r in map(Requirement, words) if r.name == "lpvguard"]
        others = [word for word in words if Requirement(word).name != "lpvguard"]
        return others + [word for r in own for extra in r.extras for word in packages(extras[extra])]

    asked = {
        "run": [*project["project"]["dependencies"], *project["build-system"]["requires"]],
        "test": [*project["project"]["dependencies"], *packages(extras["test"])],
        "lcm": extras["lcm"],
    }
    for name, wanted in asked.items():
        text = (ROOT / "tools" / "locks" / f"{name}.txt").read_text()
        blocks = re.split(r"\n(?=\S)", text.partition("\n")[2].rstrip())
        assert all(re.search(r"==\S+(.|\n)*--hash=sha256:[0-9a-f]{64}", block) for block in blocks)
        pinned: dict[str, list[str]] = {}
        for block in blocks:
            one, version = re.match(r"(\S+?)==(\S+)", block).groups()
            pinned.setdefault(canonicalize_name(one), []).append(version)
        for said in map(Requirement, wanted):
            versions = pinned[canonicalize_name(said.name)]
            assert all(said.specifier.contains(version) for version in versions), f"{name}: {said}"


def test_an_environment_of_somebody_else_is_refused_and_kept(checkout):
    (checkout / ".venv").mkdir()
    (checkout / ".venv" / "mine").write_text("")
    done = shell(checkout, "ensure_venv run")
    assert done.returncode == 2 and "not lpvguard's" in done.stderr and (checkout / ".venv" / "mine").exists()


def test_an_optional_python_package_may_fail_a_needed_one_not(checkout):
    done = shell(checkout, "ensure_venv test", PIP_FAILS="locks/lcm.txt")
    assert (
        done.returncode == 0
        and "without the Python package lcm" in done.stderr
        and "no wheel of it" in done.stderr
    )
    shutil.rmtree(checkout / ".venv")
    done = shell(checkout, "ensure_venv test", PIP_FAILS="locks/test.txt")
    assert done.returncode == 2 and "no wheel of it" in done.stderr


def test_only_cmakes_builds_of_another_checkout_are_removed(checkout):
    def build(folder: str, cache_folder: Path, home: Path, project: str = "lpvguard") -> Path:
        made = checkout / "build" / folder
        made.mkdir(parents=True, exist_ok=True)
        (made / "CMakeCache.txt").write_text(
            f"CMAKE_PROJECT_NAME:STATIC={project}\nCMAKE_CACHEFILE_DIR:INTERNAL={cache_folder}\nCMAKE_HOME_DIRECTORY:INTERNAL={home}\n"
        )
        return made

    good = build("debug", checkout / "build" / "debug", checkout)
    consumer = build(
        "consumer", checkout / "build" / "consumer", checkout / "tests" / "consumer", "lpvguard_consumer"
    )
    copied = build("double", Path("/elsewhere/build/double"), Path("/elsewhere"))
    foreign = build("foreign", Path("/elsewhere/build/foreign"), Path("/elsewhere"), "another_project")
    own = checkout / "build" / "notes"
    own.mkdir()
    assert shell(checkout, "drop_foreign_builds").returncode == 0
    assert [p.is_dir() for p in (good, consumer, copied, foreign, own)] == [True, True, False, True, True]
    build(".", checkout / "build", Path("/elsewhere"))
    assert (
        "build is a build of another checkout" in shell(checkout, "drop_foreign_builds").stderr
        and not (checkout / "build").exists()
    )


@pytest.mark.parametrize("script", ["demo", "test"])
def test_help_and_unknown_arguments_run_nothing(checkout, script):
    shutil.copy(ROOT / "tools" / script, checkout / "tools")
    with (checkout / "tools" / "setup.sh").open("a") as setup:
        setup.write('ensure_packages() { say "it runs"; exit 9; }\n')

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [checkout / "tools" / script, *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)

    for arguments in (["--help"], ["-h"]):
        done = run(*arguments)
        assert done.returncode == 0 and done.stderr == "" and f"tools/{script} --help" in done.stdout
        assert "#" not in done.stdout and "set -" not in done.stdout
    for arguments in (["--hepl"], ["out"], ["--help", "--fast"], [""], ["--fast", "--fast"]):
        done = run(*arguments)
        assert done.returncode == 2 and done.stdout == "", arguments
        assert "unknown arguments" in done.stderr and f"tools/{script} --help" in done.stderr
    assert run().returncode == 9


RUNNER = r"""#!/bin/bash
# cmake, ctest or python: notes that it was called; ctest and the serial tests wait for each other.
meet() {
  touch "$MEET/$1"
  for _ in $(seq 600); do [ ! -e "$MEET/$2" ] || return 0; sleep 0.05; done
  return 1
}
xml() { echo "<testsuite><testcase name='a'/></testsuite>" >"$1"; }
case "${0##*/} $*" in
  "cmake --build"*) exit "$BUILD" ;;
  cmake*) ;;
  "ctest"*" -N") echo "Total Tests: 9" ;;
  ctest*)
    meet ctest serial && meet ctest parallel && echo "ctest $*" >>"$CALLS"
    while [ "$1" != --output-junit ]; do shift; done
    xml "$2"
    mkdir -p build/gates/counted/work/clang
    xml build/gates/counted/work/clang/core_unit.xml
    exit 7 ;;
  *"-m serial"*) [ "$BUILD" != 0 ] || meet serial ctest; echo "serial" >>"$CALLS"; xml "$4" ;;
  *"-m not serial"*) echo "parallel" >>"$CALLS"; xml "$4"; [ "$BUILD" != 0 ] || meet parallel ctest ;;
  *summarise_tests.py*) echo "$*" >>"$CALLS" ;;
esac
"""


@pytest.mark.parametrize("build", [0, 1])
def test_what_waits_for_clocks_runs_before_the_rest_and_ctest_beside_both(checkout, tmp_path, build):
    shutil.copy(ROOT / "tools" / "test", checkout / "tools")
    with (checkout / "tools" / "setup.sh").open("a") as setup:
        setup.write("ensure_packages() { :; }; ensure_venv() { :; }\n")
    programs = checkout / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name in ("cmake", "ctest", "python"):
        (programs / name).write_text(RUNNER)
        (programs / name).chmod(0o755)
    environment = {**os.environ, "CALLS": str(tmp_path / "calls"), "MEET": str(tmp_path), "BUILD": str(build)}
    done = subprocess.run(
        [checkout / "tools" / "test"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    *tests, summary = (tmp_path / "calls").read_text().splitlines()
    assert f"--build-failed {build}" in summary
    assert [t.split()[0] for t in tests] == ["serial", "parallel"] + ([] if build else ["ctest"])
    status = checkout / "build" / "results" / "ctest.status"
    assert status.read_text() == "7\n" if build == 0 else not status.exists()
    assert status.with_name("sanitized.xml").exists() == (build == 0)


FAKE_APT = r"""
dpkg-query() { for name in "$@"; do [[ " $INSTALLED " != *" $name "* ]] || echo "installed $name"; done; }
apt-cache() { [[ "$*" != *user-mode-linux* ]]; }
apt-get() { :; }; become_root() { as_root=(); }
apt_install() { echo "apt: $*"; [[ "$*" != *cppcheck* ]] || return 1; INSTALLED+=" $*"; }
"""


def test_parts_that_cannot_be_had_are_named_and_needed_packages_all_the_same_installed(checkout):
    done = shell(
        checkout,
        FAKE_APT + "INSTALLED=; clang_runtime() { echo libclang-rt-99-dev; }; ensure_packages run test",
        LPVGUARD_WITHOUT="lcm",
    )
    assert done.returncode == 0, done.stderr
    asked = [line.split()[1:] for line in done.stdout.splitlines()]
    assert (
        "libclang-rt-99-dev" in asked[0]
        and "user-mode-linux" not in asked[0]
        and "liblcm-dev" not in asked[0]
    )
    assert (
        "without lcm (LPVGUARD_WITHOUT)" in done.stderr
        and "without uml: its tests are counted as skipped" in done.stderr
    )
    # cppcheck fails: the rest all the same, the needed ones first.
    assert "without cppcheck" in done.stderr and done.stderr.count("without") == 3
    assert asked[1][0] == "g++" and ["cppcheck"] in asked and asked[-1][-1:] == ["qemu-system-arm"]


def test_without_root_needed_packages_are_named_and_nothing_is_asked_of_apt(checkout):
    done = shell(
        checkout, FAKE_APT + "INSTALLED='g++ cmake'; become_root() { return 1; }; ensure_packages run"
    )
    assert (
        done.returncode == 2
        and "please install: apt-get install libeigen3-dev" in done.stderr
        and done.stdout == ""
    )


APT_SAYS = (
    "Reading\ndlstatus:1:30.5:Retrieving\ndlstatus:1:31:Retrieving\n"
    "pmstatus:clang:1:Unpacking clang (amd64)\npmstatus:x:2:Unpacking x (amd64)\nE: broken\n"
)


def test_progress_is_a_line_a_quarter_and_a_line_a_package(checkout, tmp_path):
    done = shell(checkout, f"printf '%s' '{APT_SAYS}' | apt_progress {tmp_path / 'log'} g++ clang")
    assert done.stderr.splitlines() == ["  downloaded 25 %", "  installing 1 of 2: clang"]
    assert (tmp_path / "log").read_text() == "Reading\nE: broken\n"


def test_the_table_has_what_each_suite_cost(tmp_path):
    """Of a gate and its self-test what they printed, of a file of pytest what was noted, else the seconds."""
    gates = "".join(
        f'<testcase name="gate.{name}" time="{seconds}"><system-out>processor: {spent} s\n{name}: 0 findings'
        "</system-out></testcase>"
        for name, seconds, spent in (("mcdc", 10, 15.5), ("mcdc.self_test", 1, 2.5), ("misra", 4, 4.5))
    )
    noted = '<properties><property name="cpu" value="7.25"/></properties>'
    texts = {
        "ctest": f'<testsuite>{gates}<testcase name="unit.x" time="3"/></testsuite>',
        "pytest": '<testsuite><testcase classname="tests.a.test_b" name="t" time="2">'
        f"{noted}</testcase></testsuite>",
        "pytest_serial": GOOD,
        "sanitized": '<testsuite><testcase name="unit.x" time="4"/></testsuite>',
    }
    for runner, text in texts.items():
        (tmp_path / f"{runner}.xml").write_text(text)
    done = subprocess.run(
        [sys.executable, ROOT / "tools" / "summarise_tests.py", tmp_path],
        capture_output=True,
        text=True,
        check=True,
    )
    rows = {" ".join(w[:-3]): w[-3:] for w in map(str.split, done.stdout.splitlines()) if len(w) > 3}
    assert rows["ctest gate.mcdc"] == ["2", "11.0", "18.0"] and rows["ctest gate.misra"] == [
        "1",
        "4.0",
        "4.5",
    ]
    assert rows["pytest a.test_b"] == ["1", "2.0", "7.2"] and rows["all"] == ["7", "25.0", "37.8"]
    assert rows["sanitized"] == ["unit", "1", "4.0"]


GOOD = '<testsuite><testcase name="a.b" time="1"/></testsuite>'


@pytest.mark.parametrize(
    ("ctest", "status", "options", "last", "says"),
    [
        (GOOD, "", [], "3 passed, 0 failed, 0 skipped", ""),
        (
            GOOD[:-15],
            "",
            [],
            "2 passed, 1 failed, 0 skipped",
            "FAILED ctest: it broke off while it wrote ctest.xml",
        ),
        ("", "", [], "2 passed, 1 failed, 0 skipped", "broke off"),
        (GOOD, "8", [], "3 passed, 1 failed, 0 skipped", "no case failed, yet it ended with status 8"),
        (
            GOOD,
            "",
            ["--clean-room", "skipped: no root"],
            "3 passed, 0 failed, 1 skipped",
            "SKIPPED clean-room ./tools/test: no root",
        ),
        (GOOD, "", ["--clean-room", "failed"], "3 passed, 1 failed, 0 skipped", "FAILED clean-room"),
        (GOOD, "", ["--fast", "7"], "3 passed, 0 failed, 0 skipped", "fast: 3 of 16 tests"),
        (GOOD, "", ["--long", "4"], "3 passed, 0 failed, 4 skipped", "SKIPPED 4 of ctest: LPVGUARD_FULL: "),
        (
            '<testsuite><testcase name="hil.x" status="notrun">'
            '<skipped message="SKIP_REGULAR_EXPRESSION_MATCHED"/>'
            "<system-out>skipped: no clang\n</system-out>"
            "</testcase></testsuite>",
            "",
            [],
            "2 passed, 0 failed, 1 skipped",
            "SKIPPED ::hil.x: no clang",
        ),
        (
            "<testsuite>"
            + 2 * '<testcase name="hil.x"><skipped message="no clang"/></testcase>'
            + '<testcase name="hil.y"><skipped message="no uml"/></testcase></testsuite>',
            "",
            [],
            "2 passed, 0 failed, 3 skipped",
            "SKIPPED 2 of ctest hil: no clang\nSKIPPED ::hil.y: no uml",
        ),
    ],
)
def test_the_closing_line_counts_what_broke_off_and_gives_reasons(
    tmp_path, ctest, status, options, last, says
):
    for runner, text in (("ctest", ctest), ("pytest", GOOD), ("pytest_serial", GOOD)):
        (tmp_path / f"{runner}.xml").write_text(text)
    (tmp_path / "pytest.collected").write_text("9\n")
    if status:
        (tmp_path / "ctest.status").write_text(status)
    done = subprocess.run(
        [sys.executable, ROOT / "tools" / "summarise_tests.py", *options, tmp_path],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (
        done.stdout.splitlines()[-1] == last
        and says in done.stdout
        and done.returncode == (" 0 failed" not in last)
    )


@pytest.mark.parametrize("part", ("run", "run test"))
def test_the_image_installs_the_lists_of_the_set_up_and_no_others(checkout, part):
    text = (ROOT / "Dockerfile").read_text()
    words = [line.split(maxsplit=1) for line in text.splitlines() if line and not line.startswith("#")]
    (command,) = [json.loads(rest) for word, rest in words if word == "RUN"]
    assert command[:-1] == ["bash", "-euo", "pipefail", "-c"] and ["FROM", "debian:bookworm-slim"] in words
    fake = command[-1].replace(
        "; ensure_packages", f"; find_python() {{ python={checkout.parent}/python; }}; "
        'ensure_packages() { packages_of "$@" >packages; }; ensure_packages', 1
    )  # fmt: skip
    done = shell(checkout, f"cd {checkout}; {fake}", PART=part)
    listed = shell(checkout, f"packages_of {part}").stdout
    assert done.returncode == 0 and (checkout / "packages").read_text() == listed and "g++" in listed
    locks = re.findall(r"locks/(\w+)\.txt", (checkout.parent / "calls").read_text())
    assert locks == (["run"] if part == "run" else ["test", "lcm"])
    container = json.loads((ROOT / ".devcontainer" / "devcontainer.json").read_text())
    assert (
        container["build"]["dockerfile"] == "../Dockerfile"
        and container["build"]["args"]["PART"] == "run test"
    )
