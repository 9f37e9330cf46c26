"""The gates on the C core. Each finds nothing on a good tree; --self-test plants bugs in a copy and expects each found.

    gates.py GATE --source DIR --scratch DIR [--self-test]      exit 0 / 1 (a finding, or a planted bug that was missed)

    warnings     lib/ compiles without a warning by gcc and clang, float and double
    imports      the archive imports nothing but memory copies and square roots, optimised or not, float and double
    headers      every public header is strict C99 and strict C++17 by itself, by gcc and clang, without Eigen
    generated_c  what `lpvguard export` writes is strict C99 without a warning, by gcc and clang, float and double
    options      every option is in the configure summary, and every preset's setting arrives there
    sanitize     the unit tests run clean under the address and undefined-behaviour sanitizers
    coverage     lines and branches of lib/src that the unit tests miss are as many as coverage.json says, no more, no less

Builds stay in the scratch folder, so that a second run compiles only what changed.
"""

from __future__ import annotations

import argparse
import gzip
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

COMPILERS = {"gcc": ("gcc", "g++"), "clang": ("clang", "clang++")}
WARNINGS = ["-pedantic-errors", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror"]
IMPORTS_ALLOWED = re.compile(r"mem(cpy|set|move|cmp)|(sqrt|fabs)f?")
LEAST_BRANCH_COVERAGE = 0.98


def run(*command: object, cwd: Path | None = None, env: dict[str, str] | None = None) -> tuple[int, str]:
    done = subprocess.run([str(c) for c in command], cwd=cwd, env={**os.environ, **(env or {})}, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
    return done.returncode, done.stdout


def failed(what: str, *command: object, **where: Path) -> list[str]:
    status, output = run(*command, **where)
    return [f"{what}:\n{output}"] if status else []


def vehicle_folders(tree: Path) -> list[Path]:
    return sorted(header.parent for header in (tree / "lib" / "vehicles").glob("*/lpvguard_vehicle.h"))


# --- gates: (tree, scratch) -> findings ---


def build_core(tree: Path, folder: Path, compiler: str, real: str, build_type: str) -> list[str]:
    c, cxx = COMPILERS[compiler]
    what = f"{compiler}, {real}, {build_type}"
    return (failed(what, "cmake", "-S", tree, "-B", folder, "-G", "Ninja", f"-DCMAKE_C_COMPILER={c}",
                   f"-DCMAKE_CXX_COMPILER={cxx}", f"-DCMAKE_BUILD_TYPE={build_type}", "-DLPVG_BUILD_TESTS=OFF",
                   f"-DLPVG_DOUBLE={'ON' if real == 'double' else 'OFF'}")
            or failed(what, "cmake", "--build", folder))


def warnings(tree: Path, scratch: Path) -> list[str]:
    return [finding for compiler in COMPILERS for real in ("float", "double")
            for finding in build_core(tree, scratch / f"{compiler}-{real}", compiler, real, "Release")]


def imports(tree: Path, scratch: Path) -> list[str]:
    findings = []
    for real, build_type in (("float", "Release"), ("double", "Release"), ("float", "Debug")):
        folder = scratch / f"{real}-{build_type}"
        broken = build_core(tree, folder, "gcc", real, build_type)
        archives = sorted(folder.rglob("liblpvguard_*.a"))
        if broken or not archives:
            return broken or [f"no archive in {folder}"]
        for archive in archives:
            symbols = {line.split()[1] for line in run("nm", "-u", archive)[1].splitlines() if line.strip().startswith("U ")}
            own = f"lpvg_{archive.stem.removeprefix('liblpvguard_')}_"
            findings += [f"{archive.name} ({real}, {build_type}) imports {s}" for s in sorted(symbols)
                         if not s.startswith(own) and not IMPORTS_ALLOWED.fullmatch(s)]
    return findings


def headers(tree: Path, scratch: Path) -> list[str]:
    findings = []
    scratch.mkdir(parents=True, exist_ok=True)
    include = tree / "lib" / "include"
    public = [str(h.relative_to(include)) for h in sorted(include.rglob("*.h"))]
    for folder in vehicle_folders(tree):
        for header in public + [h.name for h in sorted(folder.glob("*.h"))]:
            for language, standard, suffix in (("c", "c99", "c"), ("c++", "c++17", "cpp")):
                unit = scratch / f"unit.{suffix}"
                unit.write_text(f'#include "{header}"\n#include "{header}"\nextern int not_empty;\n')
                for pair in COMPILERS.values():
                    compiler = pair[0 if language == "c" else 1]
                    what = f"{header} as {standard} by {compiler}"
                    command = [compiler, f"-std={standard}", *WARNINGS, "-I", include, "-I", folder, unit]
                    findings += failed(what, *command, "-fsyntax-only")
                    if "eigen" in run(*command, "-M")[1].lower():
                        findings.append(f"{what}: Eigen is visible")
    return findings


def generated_c(tree: Path, scratch: Path) -> list[str]:
    unit = tree / "tests" / "unit"
    status, output = run(sys.executable, unit / "generate.py", "vehicle", unit / "toy.toml", scratch / "toy",
                         env={"PYTHONPATH": str(tree / "tools" / "src")})
    if status:
        return [f"export failed:\n{output}"]
    findings = []
    for folder in [*vehicle_folders(tree), scratch / "toy"]:
        for compiler, _ in COMPILERS.values():
            for real in ([], ["-DLPVG_DOUBLE"]):
                findings += failed(f"{folder.name} by {compiler} {' '.join(real)}", compiler, "-std=c99", *WARNINGS, *real,
                                   "-I", tree / "lib" / "include", "-I", folder, "-c", folder / "lpvguard_coeff.c",
                                   "-o", scratch / "coeff.o")
    return findings


def options(tree: Path, scratch: Path) -> list[str]:
    source = (tree / "CMakeLists.txt").read_text()
    declared = set(re.findall(r"^lpvg_option\((LPVG_\w+)", source, re.M))
    findings = [f"{name} bypasses lpvg_option" for name in re.findall(r"^\s*option\((\w+)", source, re.M) if name not in declared]
    presets = {p["name"]: p for p in json.loads((tree / "CMakePresets.json").read_text())["configurePresets"]}

    def settings(preset: dict) -> dict[str, str]:
        inherited = settings(presets[preset["inherits"]]) if "inherits" in preset else {}
        return {**inherited, **preset.get("cacheVariables", {})}

    for name, preset in presets.items():
        # Tests off: their set-up is slow, and an option on the command line has to win over the preset's.
        status, output = run("cmake", "--preset", name, "-B", scratch / name, "-DLPVG_BUILD_TESTS=OFF", cwd=tree)
        if status:
            return [f"preset {name}:\n{output}"]
        echoed = dict(re.findall(r"^--   (LPVG_\w+): (\w+)$", output, re.M))
        wanted = {k: v for k, v in settings(preset).items() if k.startswith("LPVG_")} | {"LPVG_BUILD_TESTS": "OFF"}
        findings += [f"preset {name}: {option} is not in the summary" for option in sorted(declared - set(echoed))]
        findings += [f"preset {name}: sets {k} to {v}, the summary says {echoed.get(k)}" for k, v in wanted.items()
                     if echoed.get(k) != v]
    return findings


def unit_tests(tree: Path, folder: Path, preset: str, only: str = "") -> list[str]:
    """All unit tests, or the one named ``only`` (a self-test need not build the others)."""
    return (failed("configure", "cmake", "--preset", preset, "-B", folder, f"-DPython3_EXECUTABLE={sys.executable}", cwd=tree)
            or failed("build", "cmake", "--build", folder, "--target", f"test_{only.replace('.', '_')}" if only else "all")
            or failed("tests", "ctest", "--test-dir", folder, "-L", "unit", "-R", only or ".", "-j2", "--no-tests=error", "--output-on-failure"))


def sanitize(tree: Path, scratch: Path, only: str = "") -> list[str]:
    return unit_tests(tree, scratch / "build", "sanitize", only)


def coverage_of(tree: Path, build: Path) -> dict[str, dict[str, dict]]:
    """File -> {"lines": {number: hits}, "branches": {(number, index): hits}} over lib/src, summed over vehicles and
    template instances."""
    out: dict[str, dict[str, dict]] = {}
    for data in sorted(build.rglob("*.gcda")):
        report = subprocess.run(["gcov", "--json-format", "--stdout", "--branch-probabilities", str(data)], cwd=build,
                                stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True).stdout
        report = gzip.decompress(report) if report[:2] == b"\x1f\x8b" else report
        for part in report.decode().splitlines():
            for file in json.loads(part)["files"]:
                path = Path(file["file"])
                if not path.is_relative_to(tree / "lib" / "src"):
                    continue
                sums = out.setdefault(path.name, {"lines": {}, "branches": {}})
                for line in file["lines"]:
                    number = line["line_number"]
                    sums["lines"][number] = sums["lines"].get(number, 0) + line["count"]
                    for index, branch in enumerate(line["branches"]):
                        if not branch["throw"]:
                            key = (number, index)
                            sums["branches"][key] = sums["branches"].get(key, 0) + branch["count"]
    return out


def coverage(tree: Path, scratch: Path) -> list[str]:
    build = scratch / "build"
    for stale in build.rglob("*.gcda"):
        stale.unlink()
    broken = unit_tests(tree, build, "coverage")
    if broken:
        return broken
    found = coverage_of(tree, build)
    sources = {p.name for p in (tree / "lib" / "src").iterdir()}
    findings = [f"lib/src/{name} is in no report" for name in sorted(sources - set(found))]
    limits = json.loads((tree / "tests" / "gates" / "coverage.json").read_text())
    for kind in ("lines", "branches"):
        missed = [(name, key) for name, sums in sorted(found.items()) for key, hits in sorted(sums[kind].items()) if not hits]
        total = sum(len(sums[kind]) for sums in found.values())
        print(f"{kind}: {total - len(missed)} of {total} executed")
        where = ", ".join(f"{name}:{key[0] if isinstance(key, tuple) else key}" for name, key in missed)
        limit = limits[f"missed_{kind}"]
        if len(missed) > limit:
            findings.append(f"{len(missed)} {kind} missed, {limit} allowed: {where}")
        elif len(missed) < limit:
            findings.append(f"{len(missed)} {kind} missed, fewer than the {limit} of coverage.json: lower it")
        if kind == "branches" and total and len(missed) > (1 - LEAST_BRANCH_COVERAGE) * total:
            findings.append(f"only {total - len(missed)} of {total} branches executed")
    return findings


GATES: dict[str, Callable[..., list[str]]] = {
    f.__name__: f for f in (warnings, imports, headers, generated_c, options, sanitize, coverage)}


# --- planted bugs ---


@dataclass(frozen=True)
class Plant:
    """``new`` in place of ``old`` in a file; the gate must find it, in words that match ``expect``."""

    file: str
    old: str
    new: str
    expect: str
    only: str = ""  # the only unit test to build for it


MONITOR_H = "lib/include/lpvguard/monitor.h"
PLANTS: dict[str, list[Plant]] = {
    "warnings": [
        Plant("lib/src/monitor.cpp", "Real(0.5) - Real(0.5) *", "Real(0.5) - 0.5 *", r"gcc, float(.|\n)*\[-Werror=double-promotion\]"),
        Plant("lib/src/coeff.cpp", "uint32_t crc32_byte(", "constexpr int unused = 1;\n\nuint32_t crc32_byte(", r"clang, float(.|\n)*-Wunused-const-variable"),
        Plant("lib/src/model.cpp", "next;\n", "next;\n    int rounded = self->x[0]; (void)rounded;\n", r"clang(.|\n)*-Wfloat-conversion"),
    ],
    "imports": [
        Plant("lib/src/model.cpp", "    set_speed(self, coeff, speed);", "    set_speed(self, coeff, speed);\n    Eigen::Matrix<Real, 8, 8> a = "
              "Eigen::Matrix<Real, 8, 8>::Constant(speed), b = a * a;\n    self->x[0] += b(0, 0);", r"imports (malloc|free|_Zn)"),
        Plant("lib/src/monitor.cpp", "    ++self.restarts;", "    ++self.restarts;\n    __builtin_printf(\"restart\");", r"imports (printf|puts|putchar|fwrite)"),
        Plant("lib/src/coeff.cpp", "    return ~crc;", "    return ~crc ^ static_cast<uint32_t>(std::exp(real_at(coeff, 0)));", r"imports expf?"),
    ],
    "headers": [
        Plant(MONITOR_H, "bool lpvg_monitor_take_record(", "[[nodiscard]] bool lpvg_monitor_take_record(", r"monitor\.h as c99 by gcc"),
        Plant(MONITOR_H, '#include "lpvguard/model.h"', '#include "lpvguard/model.h"\n#ifdef __cplusplus\n#include <eigen3/Eigen/Core>\n#endif',
              r"monitor\.h as c\+\+17 by clang\+\+: Eigen is visible"),
        Plant("lib/include/lpvguard/model.h", '#include "lpvguard/coeff.h"', "", r"model\.h as c99 by clang"),
    ],
    "generated_c": [
        Plant("tools/src/lpvguard/export.py", 'return f"{int(value)}U"', 'return f"-{int(value)}"', r"toy by gcc"),
        Plant("tools/src/lpvguard/export.py", 'lines += ["    },", "};", ""]', 'lines += ["    },", "};;", ""]', r"toy by clang"),
        Plant("lib/vehicles/g80/lpvguard_coeff.c", ".schema = 1U", ".schema = 0b1U", r"g80 by gcc"),
    ],
    "options": [
        Plant("CMakePresets.json", '"LPVG_SANITIZE": "ON"', '"LPVG_SANITIZER": "ON"', r"preset sanitize: sets LPVG_SANITIZER"),
        Plant("CMakeLists.txt", 'lpvg_option(LPVG_BUILD_SIM', 'option(LPVG_BUILD_SIM', r"LPVG_BUILD_SIM bypasses"),
        Plant("CMakeLists.txt", "list(APPEND lpvg_options ${name})", "", r"LPVG_DOUBLE is not in the summary"),
    ],
    "sanitize": [
        Plant("lib/src/monitor.cpp", "i < n_signals; ++i) {\n        bin.sum", "i <= n_signals; ++i) {\n        bin.sum", r"tests:(.|\n)*out of bounds", "monitor.toy"),
        Plant("lib/src/monitor.cpp", "return static_cast<uint64_t>(later) - static_cast<uint64_t>(earlier);",
              "return static_cast<uint64_t>(later - earlier);", r"tests:(.|\n)*signed integer overflow", "monitor.toy"),
    ],
    "coverage": [
        Plant("lib/src/coeff.cpp", 'extern "C" uint32_t', 'uint32_t lpvg_unused(uint32_t n) {\n    return n;\n}\n\nextern "C" uint32_t',
              r"2 lines missed, 0 allowed: coeff\.cpp:"),
        Plant("tests/gates/coverage.json", '"missed_lines": 0', '"missed_lines": 1', r"0 lines missed, fewer than the 1"),
    ],
}


def copy_of(source: Path, target: Path, plants: list[Plant]) -> Path:
    if target.exists():
        shutil.rmtree(target)
    ignore = shutil.ignore_patterns("__pycache__", ".*", "build")
    for part in ("lib", "tests", "tools/src"):
        shutil.copytree(source / part, target / part, ignore=ignore)
    for part in ("CMakeLists.txt", "CMakePresets.json"):
        shutil.copy2(source / part, target / part)
    for plant in plants:
        (target / plant.file).touch()  # the objects of an earlier self-test hold its planted bugs
    return target


def self_test(gate: str, source: Path, scratch: Path) -> list[str]:
    tree = copy_of(source, scratch / "tree", PLANTS[gate])
    missed = []
    for plant in PLANTS[gate]:
        file = tree / plant.file
        good = file.read_text()
        if good.count(plant.old) < 1:
            missed.append(f"{plant.file} no longer holds {plant.old!r}: plant another bug")
            continue
        file.write_text(good.replace(plant.old, plant.new, 1))
        findings = "\n".join(GATES[gate](tree, scratch / "work", **({"only": plant.only} if plant.only else {})))
        file.write_text(good)
        if not re.search(plant.expect, findings):
            missed.append(f"planted {plant.new!r} in {plant.file}; wanted /{plant.expect}/, found: {findings or 'nothing'}")
    return missed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("gate", choices=GATES)
    parser.add_argument("--source", type=Path, required=True)
    parser.add_argument("--scratch", type=Path, required=True)
    parser.add_argument("--self-test", action="store_true")
    a = parser.parse_args()
    source, scratch = a.source.resolve(), a.scratch.resolve()
    findings = self_test(a.gate, source, scratch) if a.self_test else GATES[a.gate](source, scratch)
    for finding in findings:
        print(finding)
    print(f"{a.gate}: {len(findings)} finding(s)")
    return 1 if findings else 0


sys.exit(main())
