"""`find_package(lpvguard)` in a project of C alone says which language is missing."""

import subprocess

import pytest

from lpvguard.core.compiled import library_root


@pytest.mark.unhurried
def test_a_project_of_c_alone_is_told_to_enable_cxx(tmp_path):
    lines = ["cmake_minimum_required(VERSION 3.25)", "project(firmware LANGUAGES C)"]
    lines.append("find_package(lpvguard REQUIRED NO_DEFAULT_PATH PATHS ${CORE})")
    (tmp_path / "CMakeLists.txt").write_text("\n".join(lines), encoding="utf-8")
    command = ["cmake", "-G", "Ninja", "-S", tmp_path, "-B", tmp_path / "build", f"-DCORE={library_root()}"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode != 0
    assert "CXX must be enabled: project(NAME LANGUAGES C CXX)" in " ".join(run.stderr.split())
