"""The C examples of lib/README.md compile as an application's would: C99, every warning an error."""

import re
import subprocess

import pytest

from lpvguard.core.compiled import library_root

EXAMPLES = re.findall(
    r"```c\n(.*?)```", (library_root() / "README.md").read_text(encoding="utf-8"), re.DOTALL
)


def test_there_is_an_example_for_either_object():
    assert ["monitor.h" in text for text in EXAMPLES] == [True, False]
    assert ["ecu.h" in text for text in EXAMPLES] == [False, True]


@pytest.mark.parametrize(("vehicle", "text"), list(zip(("g80", "truck"), EXAMPLES, strict=True)))
def test_the_examples_compile_without_a_warning(tmp_path, vehicle, text):
    source = tmp_path / "example.c"
    source.write_text(text, encoding="utf-8")
    root = library_root()
    include = [f"-I{root / 'include'}", f"-I{root / 'vehicles' / vehicle}"]
    strict = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
    command = ["cc", *strict, *include, source]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
