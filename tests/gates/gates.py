"""The gates on the C core. Each finds nothing on a good tree; --self-test plants bugs in a copy and expects
each found.

    gates.py GATE --source DIR --scratch DIR [--self-test]      exit 0 / 1 (a finding, or a planted bug that
                                                                was missed)

    warnings     lib/ compiles without a warning by gcc and clang, float and double (by each compiler with one
                 of the two; all four with LPVGUARD_FULL=1); so do the firmware loop and the ports
    imports      the archives of the same builds import nothing but memory copies and square roots; with
                 LPVGUARD_FULL=1 another one, not optimised, too
    headers      every public header is strict C99 and strict C++17 by itself, by gcc and clang, without Eigen
    generated_c  what `lpvguard export` writes is strict C99 without a warning, by gcc and clang, float and
                 double
    misra        public headers and exported C keep MISRA C:2012, as far as cppcheck's add-on sees, but for
                 lib/MISRA.md
    misra_cpp    lib/src keeps of MISRA C++:2023 what lib/MISRA_CPP.md says a tool checks (misra_cpp.py)
    manual       every public function says what it does, when it fails and, in the head of its header, what
                 it costs, which thread may call it and what memory it takes
    requirements every requirement of lib/REQUIREMENTS.md is named by a test, and every one that a test
                 names stands there
    references   every text, equation, requirement, file and symbol that the repository names is in it
                 (references.py)
    prose        documents, public docstrings and C headers keep the rules of sentences (prose.py)
    options      every option is in the configure summary, and every preset's setting arrives there
    double       the unit tests pass with double as number type (a third of them; all with LPVGUARD_FULL=1)
    big_endian   acceptance of coefficients, and CAN, pass their unit tests on a big-endian processor
                 (PowerPC, emulated)
    sanitize     the unit tests, but for the cases tagged [many], run clean under the address and
                 undefined-behaviour sanitizers
    coverage     in the same runs every region and branch of lib/src is reached, and every condition of a
                 decision shows its independent effect (MC/DC, by clang), but for as many as coverage.json
                 says, no more, no less
    mutation     the tests notice every small change of lib/src (mutation.py, mutation_run.py): of the files
                 that a change touches, all with LPVGUARD_FULL=1; those that no test can notice stand in
                 equivalent_mutants.json with the reason, those that none notices yet in open_mutants.json
    python_mutation
                 the same of the Python numerics (python_mutation.py, python_mutation_run.py), with
                 python_equivalent_mutants.json and python_open_mutants.json

Builds stay in the scratch folder, so that a second run compiles only what changed. Gates may share one, and a
gate that builds and its self-test do, but not at once. A planted bug is looked for in the one variant of the
build, in the one file, or with the one unit test, that has to find it. Whether every bug still fits its file
is asked always. One is planted where a change touches a gate, a build file or a file of that gate's bugs; all
are with LPVGUARD_FULL=1 in the environment (tools/test --full sets it).
"""

import argparse
import hashlib
import json
import os
import random
import re
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from misra_cpp import misra_cpp_findings
from mutation_run import changed_files, listed_table, may_concern, mutation_findings
from prose import prose
from python_mutation_run import python_listed_table, python_mutation_findings
from references import references

COMPILERS = {"gcc": ("gcc", "g++"), "clang": ("clang", "clang++")}
WARNINGS = [
    "-pedantic-errors",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Wdouble-promotion",
    "-Wshadow",
    "-Werror",
]
IMPORTS_ALLOWED = re.compile(r"mem(cpy|set|move|cmp)|(sqrt|fabs)f?")
FULL = os.environ.get("LPVGUARD_FULL") == "1"
CATCH_MAIN = os.environ.get("LPVG_CATCH_MAIN", "")
"""main() of the test programs as the build has it that runs the gates (tests/catch.cmake)."""
DEFAULT_BUILD = os.environ.get("LPVG_DEFAULT_BUILD", "")
"""Folder of that build, in which the cores stand that it needs."""
ONE_CORE = "lpvguard_g80"
"""Library in which the bugs are looked for that are planted for a variant of the build."""
LEAST_COVERAGE = {"regions": 0.998, "branches": 0.999, "conditions": 0.998}  # whatever coverage.json says


def run(*command: object, cwd: Path | None = None, env: dict[str, str] | None = None) -> tuple[int, str]:
    done = subprocess.run(
        [str(c) for c in command],
        cwd=cwd,
        env={**os.environ, **(env or {})},
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    return done.returncode, done.stdout


def failed(what: str, *command: object, **where: object) -> list[str]:
    status, output = run(*command, **where)
    return [f"{what}:\n{output}"] if status else []


def vehicle_folders(tree: Path) -> list[Path]:
    return sorted(header.parent for header in (tree / "lib" / "vehicles").glob("*/lpvguard_vehicle.h"))


# --- gates: (tree, scratch) -> findings ---


def build_core(tree: Path, scratch: Path, variant: str, target: str) -> tuple[Path, list[str]]:
    """Folder and findings; ``variant`` = compiler-real-build type."""
    compiler, real, build_type = variant.split("-")
    c, cxx = COMPILERS[compiler]
    folder = scratch / variant
    settings = {
        "CMAKE_C_COMPILER": c,
        "CMAKE_CXX_COMPILER": cxx,
        "CMAKE_BUILD_TYPE": build_type,
        "LPVG_BUILD_TESTS": "OFF",
        "LPVG_DOUBLE": "ON" if real == "double" else "OFF",
    }
    defined = [f"-D{name}={value}" for name, value in settings.items()]
    return folder, (
        failed(variant, "cmake", "-S", tree, "-B", folder, "-G", "Ninja", *defined)
        or failed(variant, "cmake", "--build", folder, "--target", target)
    )


EVERY_BUILD = [f"{compiler}-{real}-Release" for compiler in COMPILERS for real in ("float", "double")]
ONE_BUILD = "clang-double-Release"
"""The furthest from the preset default, in which warnings are errors too."""
COMPILED = re.compile(r"(?:lib|firmware_sim)/|CMake|tools/src/lpvguard/core/|tests/gates/gates\.py$")
"""What a change has to touch for another compiler to say anything new."""


def few_builds(tree: Path) -> list[str]:
    """What the gates on warnings and imports build without LPVGUARD_FULL=1."""
    if may_concern(changed_files(tree), COMPILED):
        return [ONE_BUILD]
    print(
        "no source that a compiler reads is known to have changed: LPVGUARD_FULL=1 builds by every compiler"
    )
    return []


def warnings(tree: Path, scratch: Path, only: str = "") -> list[str]:
    if only.endswith(".c"):
        return firmware_warnings(tree, scratch, only)
    variants = [only] if only else EVERY_BUILD if FULL else few_builds(tree)
    target = ONE_CORE if only else "all"
    findings = [finding for variant in variants for finding in build_core(tree, scratch, variant, target)[1]]
    return findings if only else findings + firmware_warnings(tree, scratch)


def firmware_warnings(tree: Path, scratch: Path, only: str = "") -> list[str]:
    """Of firmware_sim/ecu and firmware_sim/ports, or of files named ``only``. The bare-metal ports by clang
    only: gcc builds them as errors in lpvguard.core.targets, with the same options."""
    sim = tree / "firmware_sim"
    cortex_m = ["--target=arm-none-eabi", "-mcpu=cortex-m4", "-mfloat-abi=hard", "-ffreestanding"]
    cortex_r = ["--target=arm-none-eabi", "-mcpu=cortex-r5", "-mfloat-abi=hard", "-ffreestanding"]
    scratch.mkdir(parents=True, exist_ok=True)
    # What lpvguard.core.targets writes, in its smallest form.
    (scratch / "target_input.h").write_text(
        "#define TARGET_INPUT_SAMPLES 100U\n"
        "static const lpvg_real_t target_input[TARGET_INPUT_SAMPLES][4] = {{1.0F}};\n"
    )
    of_core = [tree / "lib" / folder for folder in ("include", "src", "vehicles/truck")]
    of_sim = [sim / folder for folder in ("ecu", "ports", "ports/ecu_process", "ports/linux")]
    includes = [f"-I{folder}" for folder in (*of_core, *of_sim, scratch)]
    jobs = [
        (path, compiler, [])
        for folder in ("ecu", "ports/host", "ports/ecu_process", "ports/linux", "ports/linux_ecu")
        for path in sorted((sim / folder).glob("*.c*"))
        for compiler in COMPILERS
    ]
    jobs += [
        (sim / "ports" / path, compiler, [])
        for path in ("target_bench.cpp", "cortex_r5_ecu/main.cpp")
        for compiler in COMPILERS
    ]
    jobs += [(path, "clang", cortex_m) for path in sorted((sim / "ports" / "bare_metal").glob("*.c"))]
    jobs += [(path, "clang", cortex_m) for path in sorted((sim / "ports" / "cortex_m").glob("*.c"))]
    jobs += [
        (path, "clang", cortex_r)
        for folder in ("cortex_r5", "cortex_r5_ecu")
        for path in sorted((sim / "ports" / folder).glob("*.c"))
    ]
    findings = []
    for path, compiler, target in jobs:
        if only not in ("", path.name):
            continue
        c, cxx = COMPILERS[compiler]
        # gnu99: registers and the bus are reached by what the standard does not have.
        language = (
            [cxx, "-std=c++17", "-fno-exceptions", "-fno-rtti"]
            if path.suffix == ".cpp"
            else [c, "-std=gnu99"]
        )
        options = [w for w in WARNINGS if w != "-pedantic-errors"]
        findings += failed(
            f"{path.relative_to(tree)} by {compiler}",
            *language,
            *options,
            *target,
            *includes,
            "-fsyntax-only",
            path,
        )
    return findings


def symbols(archive: Path, which: str) -> set[str]:
    """Names of ``nm``, over all objects of the archive."""
    status, output = run("nm", "--format=posix", which, archive)
    if status:
        raise RuntimeError(output)
    return {line.split()[0] for line in output.splitlines() if len(line.split()) > 1}


def imports(tree: Path, scratch: Path, only: str = "") -> list[str]:
    """Of the archives that it builds, and without ``only`` of those that stand in `DEFAULT_BUILD`."""
    every = [*EVERY_BUILD, "gcc-float-Debug"]
    variants = [only] if only else every if FULL else few_builds(tree)
    archives: dict[Path, str] = {}
    for variant in variants:
        folder, broken = build_core(tree, scratch, variant, ONE_CORE if only else "all")
        here = sorted(folder.rglob("liblpvguard_*.a"))
        if broken or not here:
            return broken or [f"no archive in {folder}"]
        archives |= dict.fromkeys(here, variant)
    if DEFAULT_BUILD and not only:
        shipped = {f"liblpvguard_{folder.name}.a" for folder in vehicle_folders(tree)}
        archives |= {a: "default" for a in sorted(Path(DEFAULT_BUILD).glob("*.a")) if a.name in shipped}
    findings = []
    for archive, variant in archives.items():
        # What one object lacks and another one of the archive has is no import.
        missing = symbols(archive, "--undefined-only") - symbols(archive, "--defined-only")
        findings += [
            f"{archive.name} ({variant}) imports {s}"
            for s in sorted(missing)
            if not IMPORTS_ALLOWED.fullmatch(s)
        ]
    if not archives:
        findings.append(f"no archive of a core in {DEFAULT_BUILD or 'LPVG_DEFAULT_BUILD'}")
    print(f"archives: {', '.join(f'{archive.name} ({variant})' for archive, variant in archives.items())}")
    return findings


def headers(tree: Path, scratch: Path, only: str = "") -> list[str]:
    """``only``: one header of lib/include."""
    findings = []
    scratch.mkdir(parents=True, exist_ok=True)
    include, read = tree / "lib" / "include", scratch / "read"
    public = [str(h.relative_to(include)) for h in sorted(include.rglob("*.h"))]
    for folder in vehicle_folders(tree):
        for header in public + [h.name for h in sorted(folder.glob("*.h"))]:
            if only not in ("", header):
                continue
            for language, standard, suffix in (("c", "c99", "c"), ("c++", "c++17", "cpp")):
                unit = scratch / f"unit.{suffix}"
                unit.write_text(f'#include "{header}"\n#include "{header}"\nextern int not_empty;\n')
                for pair in COMPILERS.values():
                    compiler = pair[0 if language == "c" else 1]
                    what = f"{header} as {standard} by {compiler}"
                    command = [compiler, f"-std={standard}", *WARNINGS, "-I", include, "-I", folder, unit]
                    read.write_text("")
                    findings += failed(what, *command, "-fsyntax-only", "-MD", "-MF", read)
                    if "eigen" in read.read_text().lower():
                        findings.append(f"{what}: Eigen is visible")
    return findings


def export(tree: Path, scratch: Path, name: str) -> tuple[Path, list[str]]:
    """Folder and findings; ``name``: a vehicle that the unit tests export too (tests/unit/CMakeLists.txt)."""
    unit = tree / "tests" / "unit"
    kind, project = {"toy": ("vehicle", unit / "toy.toml"), "hand_truck": ("guarded", "truck")}[name]
    return scratch / name, failed(
        f"export of {name}",
        sys.executable,
        unit / "generate.py",
        kind,
        project,
        scratch / name,
        env={"PYTHONPATH": str(tree / "tools" / "src")},
    )


def generated_c(tree: Path, scratch: Path, only: str = "") -> list[str]:
    """``only``: one vehicle's."""
    made = []
    for name in ("toy", "hand_truck"):
        if only not in ("", name):
            continue
        folder, broken = export(tree, scratch, name)
        if broken:
            return broken
        made.append(folder)
    findings = []
    for folder in [*vehicle_folders(tree), *made]:
        for source in sorted(folder.glob("*.c")) if only in ("", folder.name) else ():
            for compiler, _ in COMPILERS.values():
                for real in ([], ["-DLPVG_DOUBLE"]):
                    findings += failed(
                        f"{folder.name} by {compiler} {' '.join(real)}",
                        compiler,
                        "-std=c99",
                        *WARNINGS,
                        *real,
                        "-I",
                        tree / "lib" / "include",
                        "-I",
                        folder,
                        "-c",
                        source,
                        "-o",
                        scratch / "object.o",
                    )
    return findings


def misra(tree: Path, scratch: Path, only: str = "") -> list[str]:
    """``only``: of one source, every_header.c or an exported one."""
    include, table = tree / "lib" / "include", tree / "lib" / "MISRA.md"
    folder, findings = export(tree, scratch, "hand_truck")
    if findings:
        return findings
    headers = [str(h.relative_to(include)) for h in sorted(include.rglob("*.h"))] + [
        h.name for h in sorted(folder.glob("*.h"))
    ]
    unit = scratch / "every_header.c"
    unit.write_text("".join(f'#include "{h}"\n' for h in headers) + "extern int not_empty;\n")
    sources = [path for path in (*sorted(folder.glob("*.c")), unit) if only in ("", path.name)]
    checks = ("--std=c99", "--platform=unix32", "--enable=style", "--addon=misra")
    said = ("--quiet", "--inline-suppr", "--suppress=missingIncludeSystem", "--template={file}|{line}|{id}")
    status, output = run("cppcheck", *checks, *said, "-I", include, "-I", folder, *sources)
    if status:
        return [output]
    rows = re.findall(r"^\| (\d+\.\d+) \| advisory \| (\S+) \|", table.read_text(), re.MULTILINE)
    used = set()
    for line in output.splitlines():
        file, number, rule = line.split("|") if line.count("|") == 2 else ("", "", line)
        covering = {row for row in rows if rule == f"misra-c2012-{row[0]}" and Path(file).match(row[1])}
        used |= covering
        if not covering:
            findings.append(f"{Path(file).name}:{number}: {rule}")
    return findings + [
        f"MISRA.md: rule {rule} in {files} covers nothing"
        for rule, files in rows
        if (rule, files) not in used
    ]


def misra_cpp(tree: Path, scratch: Path, only: str = "") -> list[str]:
    """``only``: of one file."""
    folder, findings = export(tree, scratch, "hand_truck")
    return findings or misra_cpp_findings(tree, folder, FULL, only)


FUNCTION = re.compile(r"^(?:LPVG_NODISCARD )?(?:const )?(\w+)\*? (lpvg_\w+)\(", re.MULTILINE)
STRUCT_ONLY = {
    "bus.h",
    "cause.h",
    "coeff.h",
    "config.h",
    "findings.h",
    "status.h",
}  # data, or glue that only ecu.cpp calls: no object to own


def manual(tree: Path, scratch: Path) -> list[str]:
    findings = []
    for path in sorted((tree / "lib" / "include").rglob("*.h")):
        text = path.read_text()
        head = text.split("#ifndef")[0]
        findings += [
            f"{path.name}: the head does not say {word}"
            for word in ("Cost:", "RAM:", "Threads:")
            if path.name not in STRUCT_ONLY and word not in head
        ]
        for function in FUNCTION.finditer(text):
            comment = re.search(r"((?:^///[^\n]*\n)+)\Z", text[: function.start()], re.MULTILINE)
            said = comment[1] if comment else ""
            if not said:
                findings.append(f"{path.name}: {function[2]} is not described")
            elif function[1] == "lpvg_status_t" and "Returns" not in said:
                findings.append(f"{path.name}: {function[2]} does not say which status it returns when")
            elif (
                "*" in text[function.start() :].split(";")[0]
                and function[1] != "lpvg_status_t"
                and "NULL" not in said
            ):
                findings.append(f"{path.name}: {function[2]} does not say what it does with NULL")
    return findings


def requirements(tree: Path, scratch: Path) -> list[str]:
    stated = re.findall(
        r"^\| (REQ-[A-Z][A-Z0-9]*-\d+) \|", (tree / "lib" / "REQUIREMENTS.md").read_text(), re.MULTILINE
    )
    tests = tree / "tests"
    tagged = [
        (path, name)
        for path in sorted(tests.rglob("*.cpp"))
        for tags in re.findall(r'^TEST_CASE\("[^"]*",\s*"([^"]*)"', path.read_text(), re.MULTILINE)
        for name in re.findall(r"\[(REQ-[^\]]*)\]", tags)
    ]
    tagged += [
        (path, name)
        for path in sorted(tests.rglob("test_*.py"))
        for name in re.findall(r'^@pytest\.mark\.requirement\("([^"]*)"\)', path.read_text(), re.MULTILINE)
    ]
    tagged += [
        (path, name)
        for path in sorted(tests.rglob("CMakeLists.txt"))
        for name in re.findall(r"REQ-[A-Z][A-Z0-9]*-\d+", path.read_text())
    ]
    named = {name for _, name in tagged}
    print(f"{len(stated)} requirements, named {len(tagged)} times")
    return (
        [f"{name} is stated twice" for name in sorted({s for s in stated if stated.count(s) > 1})]
        + [f"{name} is named by no test" for name in stated if name not in named]
        + [
            f"{path.relative_to(tree)}: {name} is no requirement"
            for path, name in tagged
            if name not in stated
        ]
    )


def options(tree: Path, scratch: Path, only: str = "") -> list[str]:
    source = (tree / "CMakeLists.txt").read_text()
    declared = set(re.findall(r"^lpvg_option\((LPVG_\w+)", source, re.MULTILINE))
    findings = [
        f"{name} bypasses lpvg_option"
        for name in re.findall(r"^\s*option\((\w+)", source, re.MULTILINE)
        if name not in declared
    ]
    presets = {p["name"]: p for p in json.loads((tree / "CMakePresets.json").read_text())["configurePresets"]}

    def settings(preset: dict) -> dict[str, str]:
        inherited = settings(presets[preset["inherits"]]) if "inherits" in preset else {}
        return {**inherited, **preset.get("cacheVariables", {})}

    for name, preset in presets.items():
        if only not in ("", name):
            continue
        compiler = settings(preset).get("CMAKE_CXX_COMPILER")
        if compiler and not shutil.which(compiler):
            print(f"preset {name}: not configured, {compiler} not found")
            continue
        # Tests off: their set-up is slow, and an option on the command line has to win over the preset's.
        status, output = run(
            "cmake", "--preset", name, "-B", scratch / name, "-DLPVG_BUILD_TESTS=OFF", cwd=tree
        )
        if status:
            return [f"preset {name}:\n{output}"]
        echoed = dict(re.findall(r"^--   (LPVG_\w+): (\w+)$", output, re.MULTILINE))
        wanted = {k: v for k, v in settings(preset).items() if k.startswith("LPVG_")} | {
            "LPVG_BUILD_TESTS": "OFF"
        }
        findings += [
            f"preset {name}: {option} is not in the summary" for option in sorted(declared - set(echoed))
        ]
        findings += [
            f"preset {name}: sets {k} to {v}, the summary says {echoed.get(k)}"
            for k, v in wanted.items()
            if echoed.get(k) != v
        ]
    return findings


def configure(tree: Path, folder: Path, preset: str, *settings: str) -> list[str]:
    """With further ``settings``."""
    known = [f"-DPython3_EXECUTABLE={sys.executable}"]
    if CATCH_MAIN and preset != "big-endian":
        known.append(f"-DLPVG_CATCH_MAIN={CATCH_MAIN}")
    return failed("configure", "cmake", "--preset", preset, "-B", folder, *known, *settings, cwd=tree)


def built(
    tree: Path, folder: Path, preset: str, only: list[str], settings: tuple[str, ...] = ()
) -> list[str]:
    """The unit tests labelled sanitized, all with `FULL`, or those named ``only`` (a self-test need not build
    the others)."""
    every = "unit_tests" if FULL else "sanitized_tests"
    targets = [f"test_{name.replace('.', '_')}" for name in only] or [every]
    return configure(tree, folder, preset, *settings) or failed(
        "build", "cmake", "--build", folder, "--target", *targets
    )


RESULTS = "core_unit.xml"


def ran(folder: Path, only: list[str]) -> list[str]:
    """What `built` built. What all of them say stands in `RESULTS` in the folder."""
    which = f"^unit\\.({'|'.join(map(re.escape, only))})$" if only else "."
    label = "core_unit" if only or FULL else "^sanitized$"
    words = ["ctest", "--test-dir", folder, "-L", label, "-R", which, "-j2", "--no-tests=error"]
    return failed("tests", *words, "--output-on-failure", *([] if only else ["--output-junit", RESULTS]))


def unit_tests(
    tree: Path, folder: Path, preset: str, *only: str, settings: tuple[str, ...] = ()
) -> list[str]:
    names = [*filter(None, only)]
    (folder / RESULTS).unlink(missing_ok=True)
    return built(tree, folder, preset, names, settings) or ran(folder, names)


def double(tree: Path, scratch: Path, only: str = "") -> list[str]:
    wanted = [only] if only else [] if FULL else ["model.toy", "monitor.toy", "controller.toy"]
    return unit_tests(tree, scratch / "build", "double", *wanted)


def big_endian(tree: Path, scratch: Path, only: str = "") -> list[str]:
    # What looks at bytes. Tests that call the library's sine cannot run: its code asks for more than this
    # emulator has.
    wanted = [only] if only else ["coeff.toy", "can"]
    return unit_tests(tree, scratch / "build", "big-endian", *wanted)


SANITIZERS = "-fsanitize=address,undefined"
COUNTING_CLANG = "19"
"""Version of the compiler that the preset ``coverage`` names. The first that counts conditions is 18."""


def passed(build: Path) -> bool:
    """Whether all tests of ``build`` have passed since its programs were linked."""
    stamp = build / "passed"
    programs = [p for p in build.rglob("test_*") if p.is_file() and not p.suffix]
    return stamp.is_file() and all(p.stat().st_mtime_ns < stamp.stat().st_mtime_ns for p in programs)


def counted(tree: Path, build: Path, only: str) -> list[str]:
    """The unit tests under sanitizers and counters, by one build for the gates that ask about either. All of
    them run once for both."""
    names = [*filter(None, [only])]
    broken = built(tree, build, "coverage", names)
    if not broken and not only and passed(build):
        return []
    for stale in (build / "passed", *build.rglob("*.profraw"), *([] if only else [build / RESULTS])):
        stale.unlink(missing_ok=True)
    broken = broken or ran(build, names)
    if not broken and not only:
        (build / "passed").touch()
    return broken


def sanitize(tree: Path, scratch: Path, only: str = "") -> list[str]:
    """By the build that counts, too, where its compiler links, or else by clang, with which compiling takes
    less, or by gcc where clang has no sanitizers."""
    scratch.mkdir(parents=True, exist_ok=True)
    (scratch / "empty.cpp").write_text("int main() {}\n")

    def links(clang: str, *flags: str) -> bool:
        words = (clang, SANITIZERS, *flags, scratch / "empty.cpp", "-o", scratch / "empty")
        return shutil.which(clang) is not None and run(*words)[0] == 0

    if links(f"clang++-{COUNTING_CLANG}", "-fprofile-instr-generate"):
        return counted(tree, scratch / "counted", only)
    compiler = "clang" if links("clang++") else "gcc"
    c, cxx = COMPILERS[compiler]
    settings = (f"-DCMAKE_C_COMPILER={c}", f"-DCMAKE_CXX_COMPILER={cxx}")
    return unit_tests(tree, scratch / compiler, "sanitize", only, settings=settings)


Reached = dict[str, dict[str, dict[tuple[int, ...], bool]]]
"""File of lib/src -> kind -> piece -> whether any program, vehicle or template instance reached it. A piece
is where it begins and ends (line, column, line, column). Of a branch the outcome follows (1, 0), of a
condition its place in the decision."""


def reached(tree: Path, build: Path) -> Reached:
    """By the programs that ran. What is a constant of every vehicle has no branch."""
    by_file: Reached = {}

    def note(file: str, kind: str, piece: list[int], hit: bool) -> None:
        path = Path(file)
        if tree / "lib" / "src" in path.parents:
            pieces = by_file.setdefault(path.name, {kind: {} for kind in LEAST_COVERAGE})[kind]
            pieces[tuple(piece)] = pieces.get(tuple(piece), False) or hit

    for raw in sorted(build.rglob("*.profraw")):
        merged = raw.with_suffix(".profdata")
        subprocess.run([f"llvm-profdata-{COUNTING_CLANG}", "merge", raw, "-o", merged], check=True)
        words = [f"llvm-cov-{COUNTING_CLANG}", "export", raw.with_suffix(""), f"-instr-profile={merged}"]
        report = json.loads(subprocess.run(words, stdout=subprocess.PIPE, check=True).stdout)["data"][0]
        for function in report["functions"]:
            names = function["filenames"]
            for *span, hits, at, _, kind in function["regions"]:
                if kind == CODE_REGION:
                    note(names[at], "regions", span, hits > 0)
            for *span, true, false, at, _, _ in function["branches"]:
                note(names[at], "branches", [*span, 1], true > 0)
                note(names[at], "branches", [*span, 0], false > 0)
        for part in report["files"]:
            for *span, _, _, shown in part["mcdc_records"]:
                for index, effect in enumerate(shown):
                    note(part["filename"], "conditions", [*span, index], effect)
    return by_file


CODE_REGION = 0
"""How llvm-cov's export marks a region that is code."""
NO_CODE = {"begin.hpp", "control_begin.hpp", "eigen.hpp"}
"""Headers of lib/src in which nothing is executed."""


def with_code(tree: Path) -> set[str]:
    """Names of the files of lib/src that hold code."""
    return {p.name for p in (tree / "lib" / "src").rglob("*.[ch]pp")} - NO_CODE


def coverage(tree: Path, scratch: Path, only: str = "") -> list[str]:
    """Of all files, or with the unit test ``only`` of the file that it tests."""
    build = scratch / "counted"
    broken = counted(tree, build, only)
    if broken:
        return broken
    reached_pieces = reached(tree, build)
    sources = {f"{only.split('.')[0]}.cpp"} if only else with_code(tree)
    findings = [f"lib/src/{name} is in no report" for name in sorted(sources - set(reached_pieces))]
    limits = json.loads((tree / "tests" / "gates" / "coverage.json").read_text())
    for kind in LEAST_COVERAGE:
        total = missed_in_all = 0
        for name in sorted(sources & set(reached_pieces)):
            pieces = reached_pieces[name][kind]
            missed = [line for (line, *_), hit in sorted(pieces.items()) if not hit]
            limit = limits[kind].get(name, {"missed": 0})["missed"]
            if len(missed) > limit:
                findings.append(f"{name}: {len(missed)} {kind} missed, {limit} allowed: {missed}")
            elif len(missed) < limit:
                findings.append(
                    f"{name}: {len(missed)} {kind} missed, fewer than the {limit} of coverage.json: lower it"
                )
            total += len(pieces)
            missed_in_all += len(missed)
        print(f"{kind}: {total - missed_in_all} of {total} reached")
        if missed_in_all > (1 - LEAST_COVERAGE[kind]) * total:
            findings.append(f"only {total - missed_in_all} of {total} {kind} reached")
    return findings


def mutation(tree: Path, scratch: Path, only: str = "") -> list[str]:
    """``only``: the mutants of one file."""
    return mutation_findings(tree, scratch, sorted(with_code(tree)), FULL, only)


def python_mutation(tree: Path, scratch: Path, only: str = "") -> list[str]:
    """``only``: the mutants of one file."""
    return python_mutation_findings(tree, scratch, FULL, only)


GATES: dict[str, Callable[..., list[str]]] = {
    f.__name__: f
    for f in (
        warnings,
        imports,
        headers,
        generated_c,
        misra,
        misra_cpp,
        manual,
        requirements,
        references,
        prose,
        options,
        double,
        big_endian,
        sanitize,
        coverage,
        mutation,
        python_mutation,
    )
}


# --- planted bugs ---


@dataclass(frozen=True)
class Plant:
    """``new`` in place of ``old`` in a file; the gate must find it, in words that match ``expect``."""

    file: str
    old: str
    new: str
    expect: str
    only: str = ""  # the variant of the build, preset or unit test to which the gate keeps
    full: bool = False  # takes builds of everything: planted with LPVGUARD_FULL=1 only


FLOAT = "gcc-float-Release"
MONITOR_H = "lib/include/lpvguard/monitor.h"
PLANTS: dict[str, list[Plant]] = {
    "warnings": [
        Plant(
            "lib/src/monitor/monitor.cpp",
            "const Real w = Real(0.5) - window_re;",
            "const Real w = Real(0.5 - window_re);",
            r"gcc-float(.|\n)*\[-Werror=double-promotion\]",
            "gcc-float-Release",
        ),
        Plant(
            "lib/src/monitor/coeff.cpp",
            "bool frames_fit(",
            "constexpr int unused = 1;\n\nbool frames_fit(",
            r"clang-float(.|\n)*-Wunused-const-variable",
            "clang-float-Release",
        ),
        Plant(
            "lib/src/monitor/model.cpp",
            "    set_speed(self, coeff, speed);\n",
            "    set_speed(self, coeff, speed);\n    int rounded = self->x[0]; (void)rounded;\n",
            r"clang(.|\n)*-Wfloat-conversion",
            "clang-float-Release",
        ),
        Plant(
            "lib/src/monitor/coeff.cpp",
            "    for (std::size_t b = 0; b < LPVG_NBINS; ++b) {",
            "    for (std::size_t b = 0; b < LPVG_NBINS; ++b) {\n        const bool w = good; good = w;",
            r"gcc-float(.|\n)*-Werror=shadow",
            "gcc-float-Release",
        ),
        Plant(
            "firmware_sim/ecu/firmware.c",
            "    size_t i;\n",
            "    size_t i;\n    int n = n_in;\n",
            r"firmware\.c by gcc(.|\n)*firmware\.c by clang",
            "firmware.c",
        ),
        Plant(
            "firmware_sim/ports/cortex_m/startup.c",
            "return 0xFFFFFFu - SYST_CVR;",
            "return 0xFFFFFFu - SYST_CVR * 1.0;",
            r"startup\.c by clang(.|\n)*conversion",
            "startup.c",
        ),
    ],
    "imports": [
        Plant(
            "lib/src/monitor/model.cpp",
            "    set_speed(self, coeff, speed);",
            "    set_speed(self, coeff, speed);\n    Eigen::Matrix<Real, 8, 8> a = "
            "Eigen::Matrix<Real, 8, 8>::Constant(speed), b = a * a;\n    self->x[0] += b(0, 0);",
            r"imports (malloc|free|_Zn)",
            FLOAT,
        ),
        Plant(
            "lib/src/monitor/monitor.cpp",
            "    ++self.restarts;",
            '    ++self.restarts;\n    __builtin_printf("restart");',
            r"imports (printf|puts|putchar|fwrite)",
            FLOAT,
        ),
        Plant(
            "lib/src/monitor/coeff.cpp",
            "lpvg_coeff_crc32(const",
            "other_crc32(const",
            r"imports lpvg_g80_coeff_crc32",
            FLOAT,
        ),
        Plant(
            "lib/src/monitor/acceptance.hpp",
            "    return ~crc32_items(",
            "    return static_cast<uint32_t>(std::exp(item_at<lpvg_real_t>(coeff.reals, 0))) "
            "^ ~crc32_items(",
            r"imports expf?",
            FLOAT,
        ),
    ],
    "headers": [
        Plant(
            MONITOR_H,
            "bool lpvg_monitor_take_record(",
            "[[nodiscard]] bool lpvg_monitor_take_record(",
            r"monitor\.h as c99 by gcc",
            "lpvguard/monitor.h",
        ),
        Plant(
            MONITOR_H,
            '#include "lpvguard/model.h"',
            '#include "lpvguard/model.h"\n#ifdef __cplusplus\n#include <eigen3/Eigen/Core>\n#endif',
            r"monitor\.h as c\+\+17 by clang\+\+: Eigen is visible",
            "lpvguard/monitor.h",
        ),
        Plant(
            "lib/include/lpvguard/model.h",
            '#include "lpvguard/coeff.h"',
            "",
            r"model\.h as c99 by clang",
            "lpvguard/model.h",
        ),
    ],
    "generated_c": [
        Plant(
            "tools/src/lpvguard/core/seal.py",
            'return f"{int(value)}U"',
            'return f"-{int(value)}"',
            r"toy by gcc",
            "toy",
        ),
        Plant(
            "tools/src/lpvguard/core/seal.py",
            'lines += ["    },", "};", ""]',
            'lines += ["    },", "};;", ""]',
            r"toy by clang",
            "toy",
        ),
        Plant("tools/src/lpvguard/core/coefficients.py", "#define", "#  defined", r"toy by gcc", "toy"),
        Plant(
            "tools/src/lpvguard/base/layout.py",
            'struct="control_coeff"',
            'struct="control"',
            r"hand_truck by gcc",
            "hand_truck",
        ),
        Plant(
            "tools/src/lpvguard/can/bus.py",
            "= (lpvg_real_t){",
            "= (lpvg_real){",
            r"hand_truck by clang",
            "hand_truck",
        ),
        Plant("lib/vehicles/g80/lpvguard_coeff.c", ".schema = ", ".schema = 0b0U + ", r"g80 by gcc", "g80"),
    ],
    "misra": [
        Plant(
            MONITOR_H,
            "#define LPVG_NRECORDS 4",
            "#define LPVG_TWICE(x) x + x\n#define LPVG_NRECORDS 4",
            r"monitor\.h:\d+: misra-c2012-20\.7",
            "every_header.c",
        ),
        Plant(
            "tools/src/lpvguard/can/codegen.py",
            "if (!(steps > 0.0f)) {{\n        return 0u;\n    }}",
            "if (!(steps > 0.0f))\n        return 0u;",
            r"lpvg_can_codec\.c:\d+: misra-c2012-15\.6",
            "lpvg_can_codec.c",
        ),
        Plant(
            "lib/include/lpvguard/config.h",
            "cppcheck-suppress",
            "",
            r"config\.h:\d+: misra-c2012-20\.10",
            "every_header.c",
        ),
        Plant(
            "lib/MISRA.md",
            "| 15.5 |",
            "| 15.6 |",
            r"lpvguard_bus\.c:\d+: misra-c2012-15\.5(.|\n)*rule 15\.6 in \*\.c covers nothing",
            "lpvguard_bus.c",
        ),
    ],
    "manual": [
        Plant(MONITOR_H, "/// Threads:", "/// Contexts:", r"monitor\.h: the head does not say Threads:"),
        Plant(
            "lib/include/lpvguard/controller.h",
            "/// Returns bad_argument for NULL",
            "/// Refuses NULL",
            r"lpvg_control_init does not say which status",
        ),
        Plant(
            MONITOR_H,
            "/// Why the newest frame is no evidence. Returns none before the first frame and for NULL.\n",
            "",
            r"lpvg_monitor_reason is not described",
        ),
    ],
    "requirements": [
        Plant("tests/unit/test_model.cpp", "[REQ-MOD-2]", "", r"REQ-MOD-2 is named by no test"),
        Plant(
            "lib/REQUIREMENTS.md",
            "| REQ-CORE-1 |",
            "| REQ-CORE-99 |",
            r"REQ-CORE-99 is named by no test(.|\n)*REQ-CORE-1 is no requirement",
        ),
        Plant(
            "tests/golden/test_core_sizes.py",
            "REQ-CORE-5",
            "REQ-CORE-55",
            r"test_core_sizes\.py: REQ-CORE-55 is no requirement",
        ),
    ],
    "references": [
        Plant(
            "lib/include/lpvguard/model.h",
            "THEORY 3.1",
            "THEORY 3.9",
            r"model\.h:5: THEORY has no section 3\.9",
        ),
        Plant(
            "lib/src/monitor/margin.hpp", "(T17)", "(T77)", r"margin\.hpp:1: THEORY has no equation \(T77\)"
        ),
        Plant("lib/theory/7-04-invisible-faults.md", "\\tag{T25}", "", r"THEORY has no equation \(T25\)"),
        Plant(
            "lib/theory/10-code-and-tests.md",
            "| (T24) |",
            "| T24 |",
            r"\(T24\) has no row that says where it is implemented",
        ),
        Plant(
            "lib/theory/10-code-and-tests.md",
            ":EnergyTest.memories_s`",
            ":EnergyTest.memory`",
            r"energy\.py does not define EnergyTest\.memory",
        ),
        Plant(
            "lib/theory/7-03-calibration.md",
            "prediction [11]",
            "prediction [99]",
            r"work \[11\] is not cited(.|\n)*work \[99\] is not listed",
        ),
        Plant(
            "lib/theory/10-code-and-tests.md",
            "margin.hpp:dead`",
            "margin.hpp:living`",
            r"margin\.hpp does not define living",
        ),
        Plant(
            "lib/theory/10-code-and-tests.md",
            "test_margin.cpp:REQ-MON-3`",
            "test_margin.cpp:REQ-MON-13`",
            r"test_margin\.cpp does not define REQ-MON-13",
        ),
        Plant(
            "lib/theory/10-code-and-tests.md",
            "drives/dft.py:spectra`",
            "drives/fft.py:spectra`",
            r"no file tools/.*fft\.py",
        ),
        Plant(
            "lib/README.md",
            "](REQUIREMENTS.md)",
            "](REQUIREMENT.md)",
            r"README\.md:\d+: link to REQUIREMENT\.md",
        ),
        Plant(
            "lib/MISRA.md",
            "# ",
            "# Section 3 of it. See [here](THEORY.md#3-nothing). ",
            r"section 3 of no work(.|\n)*THEORY\.md has no heading #3-nothing",
        ),
        Plant(
            "tests/unit/test_ecu.cpp",
            "[REQ-ECU-5]",
            "[REQ-ECU-55]",
            r"test_ecu\.cpp:\d+: REQ-ECU-55 is no requirement",
        ),
        Plant(
            "firmware_sim/sim/ecu_node.hpp",
            "(reception.hpp)",
            "(reception.h)",
            r"ecu_node\.hpp:\d+: no file reception\.h",
        ),
        Plant(
            "firmware_sim/plant/truck.toml",
            "(Table I)",
            "(Table III; DESIGN 7, PLANT.md, paper (12), step 9, Fig. 7)",
            r"no step 9(.|\n)*no figure 7(.|\n)*no table III(.|\n)*no equation 12(.|\n)*"
            r"DESIGN is no text(.|\n)*PLANT\.md is no text",
        ),
    ],
    "prose": [
        Plant(
            "tools/site/pages/index.md",
            "lpvguard is research software.",
            "Of research software it is one, and so it has no certificate and none of the words of one "
            "and so nobody may take it to a public road or to a road beside.",
            r"index\.md:\d+: long: 3\d words(.|\n)*index\.md:\d+: inversion",
        ),
        Plant(
            "tools/src/lpvguard/api/monitor.py",
            '"""The compiled monitor',
            '"""Nor but for the compiled monitor',
            r"monitor\.py:1: inversion(.|\n)*monitor\.py:1: riddle: 'but for'",
        ),
        Plant(
            "lib/include/lpvguard/watch.h",
            "The sums below begin with the engagement.",
            "Nor do the sums below begin with the engagement.",
            r"watch\.h:\d+: inversion",
        ),
    ],
    "options": [
        Plant(
            "CMakePresets.json",
            '"LPVG_SANITIZE": "ON"',
            '"LPVG_SANITIZER": "ON"',
            r"preset sanitize: sets LPVG_SANITIZER",
            "sanitize",
        ),
        Plant(
            "CMakeLists.txt",
            "lpvg_option(LPVG_BUILD_SIM",
            "option(LPVG_BUILD_SIM",
            r"LPVG_BUILD_SIM bypasses",
            "default",
        ),
        Plant(
            "CMakeLists.txt",
            "list(APPEND lpvg_options ${name})",
            "",
            r"LPVG_DOUBLE is not in the summary",
            "double",
        ),
    ],
    "double": [
        Plant(
            "lib/src/guard/controller.cpp",
            "const Real next = x + change;",
            "const Real next = static_cast<float>(x + change);",
            r"tests:(.|\n)*the law equals a dense recursion",
            "controller.toy",
        )
    ],
    "big_endian": [
        Plant(
            "lib/src/monitor/crc32.hpp",
            "        crc ^= static_cast<uint32_t>(word >> taken);",
            "        for (std::size_t i = 0; i < 4U; ++i) {"
            " crc ^= uint32_t{reinterpret_cast<const unsigned char*>(&word)[taken / 8U + i]} << (8U * i); }",
            r"tests:(.|\n)*the exported coefficients are accepted",
            "coeff.toy",
        ),
        Plant(
            "lib/src/guard/can.cpp",
            "uint32_t bits = frame.data[first];",
            "uint16_t bits = 0U; std::memcpy(&bits, &frame.data[first], 2U);",
            r"tests:(.|\n)*limits of a signal",
            "can",
        ),
    ],
    "sanitize": [
        Plant(
            "lib/src/monitor/monitor.cpp",
            "return static_cast<uint64_t>(later) - static_cast<uint64_t>(earlier);",
            "return static_cast<uint64_t>(later - earlier);",
            r"tests:(.|\n)*signed integer overflow",
            "monitor.toy",
        )
    ],
    "mutation": [
        Plant(
            "tests/unit/test_coeff.cpp",
            "CHECK(lpvg_coeff_check(coeff) == want);\n",
            "want = lpvg_coeff_check(coeff);\n",
            r"survived: coeff\.cpp:\d+: frames_fit",
            "coeff.cpp",
            full=True,
        )
    ],
    "python_mutation": [
        Plant(
            "tests/tools/drives/test_dft.py",
            "np.testing.assert_allclose(Z[k], driven + (0.0 if cycles else OUTPUT_OFFSET), atol=1e-12)",
            "assert Z[k].shape == driven.shape",
            r"survived: drives/dft\.py:\d+: spectra: Z\[0\] \+= model\.output_offset  ->  \(left out\)",
            "drives/dft.py",
        )
    ],
    "misra_cpp": [
        Plant(
            "lib/src/guard/can.cpp",
            "constexpr CrcTable kCrc;",
            "constexpr CrcTable kCrc;\nunion Either {\n    int a;\n    float b;\n};",
            r"can\.cpp: 'union', which MISRA_CPP\.md 12\.3\.1 says is absent",
            "can.cpp",
        ),
        Plant(
            "lib/src/guard/can.cpp",
            "uint8_t crc_step(uint8_t crc, uint8_t byte) { return",
            "uint8_t crc_step(uint8_t crc, uint8_t byte) { if (crc == byte) return 0U; return",
            r"can\.cpp:\d+: statement should be inside braces",
            "can.cpp",
        ),
        Plant(
            "lib/MISRA_CPP.md",
            "`misc-no-recursion`",
            "`misc-no-recursions`",
            r"knows no misc-no-recursions",
            "can.cpp",
        ),
    ],
    "coverage": [
        Plant(
            "lib/src/monitor/model.cpp",
            "namespace {\n",
            "uint32_t lpvg_unused(uint32_t n) {\n    return n;\n}\n\nnamespace {\n",
            r"model\.cpp: \d+ regions missed, 0 allowed: \[9\b",
            "model.toy",
        ),
        Plant(
            "lib/src/guard/can.cpp",
            "if (early || watch.fast != 0U) {",
            "if (early || (watch.fast != 0U && watch.has_arrival != 2U)) {",
            r"can\.cpp: 1 conditions missed, 0 allowed",
            "can",
        ),
        Plant(
            "tests/gates/coverage.json",
            '"regions": {',
            '"regions": {"model.cpp": {"missed": 99},',
            r"model\.cpp: \d+ regions missed, fewer than the 99",
            "model.toy",
        ),
        Plant(
            "lib/src/monitor/coeff.cpp",
            'extern "C" uint32_t',
            'uint32_t lpvg_unused(uint32_t n) {\n    return n;\n}\n\nextern "C" uint32_t',
            r"coeff\.cpp: 1 regions missed, 0 allowed",
            full=True,
        ),
    ],
}


BUILDS = ("warnings", "imports", "double", "big_endian", "sanitize", "coverage")
"""Gates that build: on a copy, in which the self-test then plants its bugs, so that it compiles no more than
what they touch."""


def copy_of(source: Path, target: Path) -> Path:
    """Makes ``target`` a copy of the tree. What is right there stays as it is, so that its objects hold; what
    is not, such as a bug that an interrupted self-test left, is written anew."""
    left_out = {"__pycache__", "build", "node_modules"}
    files = [p for p in source.iterdir() if p.is_file() and not p.name.startswith(".")]
    for part in ("lib", "firmware_sim", "tests", "tools", "data"):
        for folder, folders, names in os.walk(source / part):
            folders[:] = [f for f in folders if f not in left_out and not f.startswith(".")]
            files += [Path(folder) / name for name in names if not name.startswith(".")]
    wanted = {target / file.relative_to(source): file for file in files}
    for old in [p for p in target.rglob("*") if p.is_file() and "__pycache__" not in p.parts]:
        if old not in wanted:
            old.unlink()
    for new, file in wanted.items():
        if not new.is_file() or new.read_bytes() != file.read_bytes():
            new.parent.mkdir(parents=True, exist_ok=True)
            new.write_bytes(file.read_bytes())
            shutil.copymode(file, new)
    return target


BEHIND_EVERY_GATE = re.compile(r"tests/gates/|(.*/)?CMake|.*\.cmake$")


def may_change_what_is_found(changed: set[str] | None, plants: list[Plant]) -> bool:
    """Whether with these `changed_files` a gate may find other ones of its bugs than before."""
    return may_concern(changed, BEHIND_EVERY_GATE) or any(plant.file in changed for plant in plants)


def planted_now(tree: Path, plants: list[Plant]) -> list[Plant]:
    """All with LPVGUARD_FULL=1; else one of those that cost little, drawn by the hash of their files."""
    if FULL:
        return plants
    cheap = [plant for plant in plants if not plant.full]
    seed = hashlib.sha256(b"".join((tree / plant.file).read_bytes() for plant in cheap)).hexdigest()
    return random.Random(seed).sample(cheap, min(1, len(cheap)))


def self_test(gate: str, source: Path, scratch: Path) -> list[str]:
    plants = PLANTS[gate]
    missed = [
        f"{plant.file} no longer holds {plant.old!r}: plant another bug"
        for plant in plants
        if plant.old not in (source / plant.file).read_text()
    ]
    if missed:
        return missed
    if not FULL and not may_change_what_is_found(changed_files(source), plants):
        print("skipped: LPVGUARD_FULL: no change touches a gate, a build file or a file of its bugs")
        return []
    tree = copy_of(source, scratch / "tree")
    now = planted_now(tree, plants)
    if not now:
        print("skipped: LPVGUARD_FULL: every planted bug takes builds of everything")
    print(f"planted: {len(now)} of {len(plants)} bugs")
    for plant in now:
        file = tree / plant.file
        good = file.read_text()
        file.write_text(good.replace(plant.old, plant.new, 1))
        findings = "\n".join(
            GATES[gate](tree, scratch / "work", **({"only": plant.only} if plant.only else {}))
        )
        file.write_text(good)
        if not re.search(plant.expect, findings):
            missed.append(
                f"planted {plant.new!r} in {plant.file}; wanted /{plant.expect}/, "
                f"found: {findings or 'nothing'}"
            )
    return missed


TABLES: dict[str, Callable[[Path, Path], list[str]]] = {
    "mutation": lambda source, scratch: listed_table(source, scratch, sorted(with_code(source))),
    "python_mutation": python_listed_table,
}
"""Gate -> its table by the lists, of a source and a scratch folder."""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("gate", choices=GATES)
    parser.add_argument("--source", type=Path, required=True)
    parser.add_argument("--scratch", type=Path, required=True)
    parser.add_argument("--self-test", action="store_true")
    parser.add_argument(
        "--table", action="store_true", help=f"{', '.join(TABLES)}: print the table of the lists, run nothing"
    )
    parser.add_argument(
        "--long", metavar="WHY", help="where LPVGUARD_FULL is not 1, say that it is skipped and WHY"
    )
    a = parser.parse_args()
    if a.long and not FULL:
        print(f"skipped: LPVGUARD_FULL: {a.long}")
        return 0
    source, scratch = a.source.resolve(), a.scratch.resolve()
    if a.table and a.gate not in TABLES:
        parser.error(f"--table is that of {', '.join(TABLES)}, not of {a.gate}")
    if a.table:
        print("\n".join(TABLES[a.gate](source, scratch)))
        return 0
    if a.self_test:
        findings = self_test(a.gate, source, scratch)
    elif a.gate in BUILDS:
        findings = GATES[a.gate](copy_of(source, scratch / "tree"), scratch / "work")
    else:
        findings = GATES[a.gate](source, scratch)
    for finding in findings:
        print(finding)
    spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    print(f"processor: {sum(r.ru_utime + r.ru_stime for r in spent):.1f} s")  # for tools/summarise_tests.py
    print(f"{a.gate}: {len(findings)} finding(s)")
    return 1 if findings else 0


sys.exit(main())
