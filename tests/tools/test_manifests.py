"""The core in other package managers and build systems: what each of its manifests says, by the real tool
where the package index has it (Conan), else against a schema of that tool's rules and a build with stand-ins
for its functions."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from jsonschema import Draft202012Validator

from lpvguard.core.compiled import eigen_include, shipped_vehicle
from made import ROOT

LIB = ROOT / "lib"
FULL = os.environ.get("LPVGUARD_FULL") == "1"
MONITOR = {"change", "coeff", "energy", "model", "monitor"}
"""Sources of a vehicle without controller."""
ANY_VEHICLE = {"diagnosis", "evidence", "isolation", "life"}
"""Services of a vehicle without controller."""
"""Sources that a vehicle without controller needs."""
VERSION = {"type": "string", "pattern": r"^\d+\.\d+\.\d+$"}
TEXT = {"type": "string", "minLength": 10}


def strict(required: dict, **optional: dict) -> dict:
    """An object of these keys and no others."""
    return {
        "type": "object",
        "required": list(required),
        "properties": {**required, **optional},
        "additionalProperties": False,
    }


NAMES = {"type": "array", "minItems": 1, "uniqueItems": True, "items": {"type": "string", "minLength": 1}}
SCHEMAS = {
    # Zephyr: "Modules" of its documentation; module.yml, paths from the folder above zephyr/ on.
    "zephyr/module.yml": strict(
        {
            "name": {"type": "string", "pattern": r"^[A-Za-z0-9_-]+$"},
            "build": strict({"cmake": {"type": "string"}, "kconfig": {"type": "string"}}),
        }
    ),
    # ESP-IDF: "Manifest File Format Reference" of its component manager.
    "idf_component.yml": strict(
        {
            "version": VERSION,
            "description": TEXT,
            "license": {"const": "MIT"},
            "dependencies": {
                "type": "object",
                "required": ["idf"],
                "additionalProperties": strict({"version": {"type": "string", "pattern": r"^[<>=~^]*\d"}}),
            },
            "files": strict({"include": NAMES}),
        }
    ),
    # PlatformIO: "library.json" of its documentation. Names have no : ; / , @ < >.
    "library.json": strict(
        {
            "name": {"type": "string", "pattern": "^[^:;/,@<>]{1,100}$"},
            "version": VERSION,
            "description": {"type": "string", "minLength": 10, "maxLength": 1000},
            "keywords": {**NAMES, "items": {"type": "string", "pattern": r"^[a-z\d\-_\+\. ]{1,50}$"}},
            "license": {"const": "MIT"},
            "frameworks": {"const": "*"},
            "platforms": {"const": "*"},
            "headers": NAMES,
            "build": strict(
                {
                    "includeDir": {"type": "string"},
                    "srcDir": {"type": "string"},
                    "flags": NAMES,
                    "unflags": NAMES,
                }
            ),
            "export": strict({"include": NAMES}),
        }
    ),
    # vcpkg: "vcpkg.json Reference" of its documentation. Names are lower case, digits and single hyphens.
    "vcpkg.json": strict(
        {
            "name": {"type": "string", "pattern": "^[a-z0-9]+(-[a-z0-9]+)*$"},
            "version": VERSION,
            "description": TEXT,
            "license": {"const": "MIT"},
            "dependencies": {**NAMES, "items": {"type": "string", "pattern": "^[a-z0-9]+(-[a-z0-9]+)*$"}},
        }
    ),
}


def manifest(name: str) -> dict:
    text = (LIB / name).read_text(encoding="utf-8")
    return json.loads(text) if name.endswith(".json") else yaml.safe_load(text)


def findings(name: str, content: object) -> list[str]:
    return [error.message for error in Draft202012Validator(SCHEMAS[name]).iter_errors(content)]


@pytest.mark.parametrize("name", SCHEMAS)
def test_a_manifest_keeps_its_tools_rules(name):
    content = manifest(name)
    assert not findings(name, content)
    for key in SCHEMAS[name]["required"]:
        assert findings(name, {k: v for k, v in content.items() if k != key})
    assert findings(name, {**content, "misspelt": 1})


def test_what_manifests_name_is_there():
    library, module, component = (
        manifest(n) for n in ("library.json", "zephyr/module.yml", "idf_component.yml")
    )
    for header in library["headers"]:
        assert (LIB / library["build"]["includeDir"] / header).is_file()
    assert list((LIB / library["build"]["srcDir"]).rglob("*.cpp"))
    assert all((LIB / name).exists() for name in library["export"]["include"])
    assert (LIB / module["build"]["cmake"] / "CMakeLists.txt").is_file()
    assert (LIB / module["build"]["kconfig"]).is_file()
    assert all(list(LIB.glob(pattern)) for pattern in component["files"]["include"])


def run(*words: object, **options) -> str:
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout + done.stderr


@pytest.mark.unhurried
def test_the_port_of_vcpkg_installs_what_a_consumer_finds(tmp_path):
    """portfile.cmake itself, with a stand-in for the function that vcpkg gives it."""
    port = tmp_path / "port.cmake"
    port.write_text(
        'function(vcpkg_install_copyright)\n  cmake_parse_arguments(arg "" "" FILE_LIST ${ARGN})\n'
        "  file(INSTALL ${arg_FILE_LIST} RENAME copyright\n"
        '    DESTINATION "${CURRENT_PACKAGES_DIR}/share/${PORT}")\n'
        f'endfunction()\ninclude("{LIB}/portfile.cmake")\n'
    )
    packages = tmp_path / "packages"
    run("cmake", f"-DCURRENT_PACKAGES_DIR={packages}", "-DPORT=lpvguard", "-P", port)
    share = packages / "share" / "lpvguard"
    assert (share / "copyright").read_bytes() == (ROOT / "LICENSE").read_bytes()
    finds_the_package(packages, tmp_path)


def finds_the_package(prefix: Path, folder: Path) -> None:
    """The shipped consumer configures against a package: its headers and sources are those of lib/."""
    for kind in ("include", "src"):
        (kept,) = (p for p in prefix.rglob(kind) if p.is_dir())
        assert {p.relative_to(kept): p.read_bytes() for p in kept.rglob("*") if p.is_file()} == {
            p.relative_to(LIB / kind): p.read_bytes() for p in (LIB / kind).rglob("*") if p.is_file()
        }
    consumer = ROOT / "tests" / "consumer"
    run("cmake", "-G", "Ninja", "-S", consumer, "-B", folder / "consumer", f"-DCMAKE_PREFIX_PATH={prefix}")


@pytest.mark.slow("Conan makes the package, and a consumer of it is configured")
def test_conan_makes_a_package_that_a_consumer_finds(tmp_path, monkeypatch):
    conan = Path(sys.executable).with_name("conan")
    if not conan.is_file():
        pytest.skip("pip install conan")
    monkeypatch.setenv("CONAN_HOME", str(tmp_path / "home"))
    run(conan, "profile", "detect")
    made = run(conan, "create", LIB, "-o", "&:eigen=system", "--no-remote", cwd=tmp_path)
    finds_the_package(Path(re.search(r"Package folder (\S+)", made)[1]), tmp_path)
    said = run(
        conan, "graph", "info", LIB, "--no-remote", "-o", "&:eigen=system", "--format=json", cwd=tmp_path
    )
    assert '"license": "MIT"' in said


STAND_INS = {
    # What Zephyr and ESP-IDF give, in terms of CMake.
    "zephyr": """
        macro(zephyr_library_named NAME)
          add_library(${NAME} STATIC)
          set(ZEPHYR_CURRENT_LIBRARY ${NAME})
        endmacro()
        macro(zephyr_library_sources)
          target_sources(${ZEPHYR_CURRENT_LIBRARY} PRIVATE ${ARGN})
        endmacro()
        macro(zephyr_include_directories)
          target_include_directories(${ZEPHYR_CURRENT_LIBRARY} PUBLIC ${ARGN})
        endmacro()
        macro(zephyr_library_include_directories)
          target_include_directories(${ZEPHYR_CURRENT_LIBRARY} PRIVATE ${ARGN})
        endmacro()
        set(CONFIG_LPVGUARD y)
        """,
    "esp-idf": """
        function(idf_component_register)
          cmake_parse_arguments(arg "" "" "SRCS;INCLUDE_DIRS;PRIV_INCLUDE_DIRS" ${ARGN})
          add_library(lpvguard STATIC ${arg_SRCS})
          target_include_directories(lpvguard PUBLIC ${arg_INCLUDE_DIRS} PRIVATE ${arg_PRIV_INCLUDE_DIRS})
        endfunction()
        set(COMPONENT_LIB lpvguard)
        set(ESP_PLATFORM 1)
        """,
}
FOLDERS = {"zephyr": LIB / "zephyr", "esp-idf": LIB}


@pytest.mark.unhurried
@pytest.mark.parametrize("services", ["ALL", "", "life"])
@pytest.mark.parametrize("vehicle", ["g80", "truck"])
@pytest.mark.parametrize("kind", STAND_INS)
def test_the_build_files_of_a_module_compile_a_vehicle(kind, vehicle, services, tmp_path):
    """What it would compile; with LPVGUARD_FULL=1 it does, and the program runs."""
    folder = shipped_vehicle(vehicle)
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.20)\nproject(firmware LANGUAGES C CXX)\n"
        "set(CMAKE_CXX_STANDARD 11)\n"
        f"{STAND_INS[kind]}"
        f'set(CONFIG_LPVGUARD_VEHICLE_DIR "{folder}")\nset(CONFIG_LPVGUARD_EIGEN_DIR "{eigen_include()}")\n'
        f'set(CONFIG_LPVGUARD_SERVICES "{services}")\n'
        f'add_subdirectory("{FOLDERS[kind]}" lpvguard)\n'
        f'add_executable(firmware "{ROOT}/tests/consumer/one_vehicle.c")\n'
        "target_link_libraries(firmware PRIVATE lpvguard m)\n"
    )
    build = tmp_path / "build"
    run("cmake", "-G", "Ninja", "-S", tmp_path, "-B", build, "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON")
    compiled = {
        Path(c["file"]): c["command"] for c in json.loads((build / "compile_commands.json").read_text())
    }
    core = {
        p
        for p in (LIB / "src").rglob("*.cpp")
        if (vehicle == "truck" or p.stem in MONITOR | ANY_VEHICLE)
        and (p.parent.name != "services" or services == "ALL" or p.stem == services)
    }
    own = {p for p in folder.glob("*.c") if services == "ALL" or "diagnosis" not in p.name}
    assert {p for p in compiled if p.name != "one_vehicle.c"} == core | own
    for source in core:
        flags = compiled[source].split()
        assert {"-fno-exceptions", "-fno-rtti", "-fno-math-errno", "-DEIGEN_NO_DEBUG"} <= set(flags)
        assert {f"-I{folder}", f"-I{eigen_include()}"} <= {f.replace("/zephyr/..", "") for f in flags}
        assert any(f in ("-std=gnu++17", "-std=c++17") for f in flags)
    if FULL and vehicle == "g80":
        run("cmake", "--build", build)
        run(build / "firmware")


def test_platformios_flags_compile_every_source():
    """Every one with LPVGUARD_FULL=1."""
    build = manifest("library.json")["build"]
    folders = [f"-I{LIB / build['includeDir']}", f"-I{LIB / build['srcDir']}", f"-I{shipped_vehicle('g80')}"]
    sources = sorted((LIB / build["srcDir"]).rglob("*.cpp" if FULL else "c[ao]*.cpp"))
    assert len(sources) > 2
    for source in sources:
        run("g++", *build["flags"], *folders, "-isystem", eigen_include(), "-fsyntax-only", source)


def test_other_projects_get_the_function_and_nothing_else(tmp_path):
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.20)\nproject(other LANGUAGES NONE)\n"
        f'add_subdirectory("{LIB}" lpvguard)\nif(NOT COMMAND lpvguard_add_vehicle)\n'
        '  message(FATAL_ERROR "no function")\nendif()\n'
        f'get_property(made DIRECTORY "{LIB}" PROPERTY BUILDSYSTEM_TARGETS)\n'
        'if(made)\n  message(FATAL_ERROR "${made}")\nendif()\n'
    )
    run("cmake", "-G", "Ninja", "-S", tmp_path, "-B", tmp_path / "build")


def test_an_unknown_service_is_refused(tmp_path):
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.20)\nproject(other LANGUAGES NONE)\n"
        f'include("{LIB}/lpvguardAddVehicle.cmake")\n'
        f'lpvguard_sources("{shipped_vehicle("g80")}" sources xcp)\n'
    )
    done = subprocess.run(
        ["cmake", "-G", "Ninja", "-S", tmp_path, "-B", tmp_path / "build"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0 and "xcp is no service of" in done.stderr
