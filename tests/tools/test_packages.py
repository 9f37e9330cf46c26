"""Every program, header and pkg-config module that build and tests ask for is of a package on the lists of
tools/setup.sh, or of what those depend on: on a machine with nothing else, it is there. dpkg says what
belongs to whom."""

import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import pytest

from lpvguard.core import targets
from made import ROOT
from parts import PROGRAMS

EITHER = {"catch2/catch_all.hpp": "catch2/catch.hpp", "catch2/catch.hpp": "catch2/catch_all.hpp"}
"""Headers of which one is enough (tests/catch.hpp)."""
pytestmark = pytest.mark.skipif(
    shutil.which("dpkg-query") is None, reason="no dpkg here: it says what belongs to which package"
)


def output(*words: object) -> str:
    return subprocess.run([str(w) for w in words], capture_output=True, text=True, check=False).stdout


def listed(*without: str) -> set[str]:
    """Packages on the lists, but for some."""
    script = 'set -euo pipefail; root=$1; . "$root/tools/setup.sh"; packages_of run test $optional_parts'
    names = set(output("bash", "-c", script, "lists", ROOT).split())
    assert {"g++", "cmake", "libglib2.0-dev"} <= names
    return names - set(without)


@cache
def installed() -> dict[str, tuple[frozenset[str], frozenset[str]]]:
    """Package -> (packages that satisfy some dependency of it, names that it provides), of what is
    installed."""
    rows = [
        line.split("\t")
        for line in output(
            "dpkg-query",
            "-W",
            "-f",
            "${db:Status-Status}\t${Package}\t${Essential}\t${Provides}\t${Pre-Depends}, ${Depends}\n",
        ).splitlines()
    ]

    def names(text: str) -> frozenset[str]:
        return frozenset(re.sub(r"\(.*?\)|:\w+", "", word).strip() for word in re.split(r"[,|]", text)) - {""}

    return {
        row[1]: (names(row[4]), names(row[3]) | ({"essential"} if row[2] == "yes" else set()))
        for row in rows
        if row[0] == "installed"
    }


def closure(packages: set[str]) -> set[str]:
    """With everything that these packages, and the essential ones, depend on."""
    providers: dict[str, set[str]] = {}
    for package, (_, provides) in installed().items():
        for name in {package, *provides}:
            providers.setdefault(name, set()).add(package)
    closed, left = set(), {*packages, "essential"}
    while left:
        # A real package before those that provide its name too: libc6-dev, not every cross compiler's.
        name = left.pop()
        new = ({name} if name in installed() else providers.get(name, set())) - closed
        closed |= new
        left |= {dependency for package in new for dependency in installed()[package][0]}
    return closed


@cache
def owners(paths: tuple[Path, ...]) -> dict[Path, set[str]]:
    """Path -> packages; dpkg knows a file by the one or the other of /usr/lib and /lib."""
    also: dict[str, set[Path]] = {}
    for path in paths:
        for name in (
            str(path),
            str(path.resolve()),
        ):  # update-alternatives: /usr/bin/c++ is a link to what a package holds
            also.setdefault(name, set()).add(path)
            also.setdefault(name.removeprefix("/usr"), set()).add(path)
    owners_of: dict[Path, set[str]] = {path: set() for path in paths}
    for line in output("dpkg", "-S", *also).splitlines():
        packages, _, name = line.rpartition(": ")
        if name in also and not packages.startswith("diversion"):
            for path in also[name]:
                owners_of[path] |= {p.split(":")[0] for p in packages.split(", ")}
    return owners_of


def texts(*patterns: str) -> dict[Path, str]:
    matching = (p for pattern in patterns for p in ROOT.glob(pattern))
    paths = {p for p in matching if p.is_file() and p.suffix != ".pyc"}  # *.cpython-311.pyc looks like C
    return {p: p.read_text() for p in sorted(paths)}


def programs() -> dict[str, str]:
    """Program -> who asks for it."""
    asked: dict[str, str] = {}
    python = texts("tests/**/*.py", "tools/src/**/*.py")
    cmake = texts(
        "CMakeLists.txt",
        "lib/*.cmake",
        "firmware_sim/**/CMakeLists.txt",
        "tests/**/CMakeLists.txt",
        "tests/**/*.cmake",
    )
    for path, text in python.items():
        calls = (
            r'(?:subprocess\.\w+|Popen|which)\(\s*\[?\s*"([a-z][\w.+-]*)"'
            if path.name != "gates.py"
            else r'(?:\brun|subprocess\.run)\(\s*\[?\s*"([\w.+-]+)"'
        )
        asked |= {name: str(path.relative_to(ROOT)) for name in re.findall(calls, text, re.MULTILINE)}
    for path, text in cmake.items():
        for words in re.findall(
            r"lpvg_missing\(\w+ \w+ ([\w+ -]+)\)"
            r"|find_program\(\w+ ([\w+-]+)|_(?:COMPILER|EMULATOR) ([a-z][\w+-]+)\)",
            text,
        ):
            asked |= {name: str(path.relative_to(ROOT)) for name in " ".join(words).split()}
    for text in texts("tests/hil/*.cpp").values():
        asked |= dict.fromkeys(re.findall(r'BackgroundCommand \w+\("([\w-]+)', text), "tests/hil")
    for line in re.findall(
        r"^(?:host_works|uml_works)\(\).*?\}$",
        (ROOT / "tools" / "with-vcan").read_text(),
        re.MULTILINE | re.DOTALL,
    ):
        asked |= dict.fromkeys(re.findall(r"have ([\w-]+)", line), "tools/with-vcan")
    asked |= {name: "tests/parts.py" for names in PROGRAMS.values() for name in names}
    asked |= {target.emulator[0]: "tools/src/lpvguard/core/targets.py" for target in targets.TARGETS.values()}
    asked |= dict.fromkeys(("cmake", "ctest", "ninja", "gcc", "g++"), "CMakePresets.json")
    return asked


def headers() -> dict[str, str]:
    """System header -> who includes it; what this repository holds or makes is not the system's."""
    ours = [
        f"/{p.relative_to(ROOT)}"
        for folder in ("lib", "firmware_sim", "tests")
        for p in (ROOT / folder).rglob("*.h*")
    ]
    sources = texts("lib/**/*.[ch]*", "firmware_sim/**/*.[ch]*", "tests/**/*.[ch]*")
    return {
        name: str(path.relative_to(ROOT))
        for path, text in sources.items()
        if path.suffix in (".c", ".h", ".cpp", ".hpp")
        for name in re.findall(r"^\s*#\s*include\s*<([^>]+)>", text, re.MULTILINE)
        if not name.startswith("lpvguard") and not any(path.endswith(f"/{name}") for path in ours)
    }


def modules() -> dict[str, str]:
    """pkg-config module -> who asks for it, with what modules require of one another."""
    asked: dict[str, str] = {}
    for path, text in texts("firmware_sim/CMakeLists.txt", "tools/src/**/*.py").items():
        matches = re.findall(
            r"pkg_check_modules\(\w+ (?:REQUIRED )?(?:IMPORTED_TARGET )?(\w+)\)"
            r'|"pkg-config", "[^"]+", "(\w+)"',
            text,
        )
        asked |= {name: str(path.relative_to(ROOT)) for words in matches for name in words if name}
    left = list(asked)
    while left:
        name = left.pop()
        path = module_file(name)
        required = (
            re.findall(r"^Requires(?:\.private)?:(.*)$", path.read_text(), re.MULTILINE) if path else []
        )
        for other in re.findall(r"([A-Za-z][\w.+-]*)", re.sub(r"[<>=!]+\s*[\w.]+", "", " ".join(required))):
            if other not in asked:
                package = ", ".join(owners((path,))[path])
                asked[other] = f"{name}.pc of {package}"
                left.append(other)
    return asked


def module_file(name: str) -> Path | None:
    folders = output("pkg-config", "--variable", "pc_path", "pkg-config").strip().split(":")
    return next((Path(f, f"{name}.pc") for f in folders if Path(f, f"{name}.pc").is_file()), None)


@cache
def places() -> dict[tuple[str, str, str], Path | None]:
    """(kind, name, who asks) -> file on this machine, None: it is not there."""
    search_path = subprocess.run(
        ["g++", "-xc++", "-E", "-v", "/dev/null"], capture_output=True, text=True, check=False
    ).stderr
    folders = [Path(line.strip()) for line in search_path.splitlines() if line.startswith(" /usr")] + [
        Path("/usr/include/eigen3")
    ]

    def first(names: list[str], where: list[Path]) -> Path | None:
        return next((folder / name for name in names for folder in where if (folder / name).exists()), None)

    all_places = {
        ("program", n, who): first([n], [Path("/usr/bin"), Path("/bin"), Path("/usr/sbin"), Path("/sbin")])
        for n, who in programs().items()
    }
    all_places |= {
        ("header", n, who): first([n, *([EITHER[n]] if n in EITHER else [])], folders)
        for n, who in headers().items()
    }
    return all_places | {("pkg-config module", n, who): module_file(n) for n, who in modules().items()}


def uncovered(packages: set[str]) -> tuple[list[str], list[str]]:
    """What no package of the lists brings, and what cannot be judged because a package of the lists is not
    installed here."""
    all_places, all_of_them = places(), closure(packages)
    owned = owners(tuple(sorted({p for p in all_places.values() if p})))
    absent = packages - set(installed())
    lost, open_ = [], []
    for (kind, name, who), path in sorted(all_places.items()):
        if path is None:
            (open_ if absent else lost).append(f"{kind} {name}, asked for by {who}: not on this machine")
        elif not owned[path] & all_of_them:
            lost.append(
                f"{kind} {name}, asked for by {who}: "
                f"of {', '.join(sorted(owned[path])) or 'no package'}, which is not on the lists"
            )
    return lost, open_


@pytest.mark.unhurried
def test_what_the_build_asks_for_is_of_a_package_on_the_lists():
    lost, open_ = uncovered(listed())
    assert lost == []
    if open_:
        pytest.skip(
            f"{', '.join(sorted(listed() - set(installed())))} not installed; "
            f"all is on the lists but, not judged: {'; '.join(open_)}"
        )


def test_the_lists_are_read_from_what_build_and_tests_call():
    assert {
        "candump",
        "cppcheck",
        "lcm-gen",
        "nm",
        "pkg-config",
        "powerpc-linux-gnu-g++",
        "qemu-ppc",
        "unshare",
        "qemu-system-aarch64",
    } <= set(programs())
    assert {
        "Eigen/Core",
        "catch2/catch_all.hpp",
        "cstring",
        "lcm/lcm-cpp.hpp",
        "linux/can.h",
        "toml++/toml.h",
    } <= set(headers())
    assert {"eigen3", "lcm"} <= set(modules())


@pytest.mark.parametrize(
    ("package", "says"),
    [
        ("cppcheck", r"program cppcheck, asked for by .*gates"),
        ("libeigen3-dev", r"header Eigen/\w+, asked for by lib"),
        ("qemu-user", "program qemu-ppc"),
        ("cmake", "program cmake"),
    ],
)
def test_a_package_missing_from_the_lists_is_found(package, says):
    if not listed() <= set(installed()) and package not in installed():
        pytest.skip(f"{package} is not installed")
    assert re.search(says, "\n".join(uncovered(listed(package))[0]))


def test_glib_missing_from_the_lists_is_found_behind_lcm():
    """liblcm-dev's lcm.pc requires glib-2.0, whose package liblcm-dev does not depend on."""
    if "liblcm-dev" not in installed():
        pytest.skip("liblcm-dev is not installed")
    without = listed("libglib2.0-dev") & set(installed())
    assert any("glib-2.0" in line and "liblcm-dev" in line for line in uncovered(without)[0])
