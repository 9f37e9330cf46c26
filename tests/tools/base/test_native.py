"""The on-demand compiler: caching, atomicity, refusals."""

import ctypes
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from lpvguard.base import native
from lpvguard.base.errors import InputError
from lpvguard.core import compiled


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("LPVGUARD_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def source(tmp_path, text, name="f.c"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_compiles_once_and_again_when_source_header_or_flags_change(tmp_path, cache):
    header = source(tmp_path, "#define VALUE 7\n", "value.h")
    c = source(tmp_path, '#include "value.h"\nint f(void) { return VALUE; }\n')
    first = native.compile_shared([c], name="demo")
    stamp = first.stat().st_mtime_ns
    assert ctypes.CDLL(str(first)).f() == 7
    assert native.compile_shared([c], name="demo") == first and first.stat().st_mtime_ns == stamp
    header.write_text("#define VALUE 8\n")
    second = native.compile_shared([c], name="demo")
    assert second != first and ctypes.CDLL(str(second)).f() == 8
    assert native.compile_shared([c], flags=("-O0",), name="demo") not in (first, second)
    assert not [p for p in cache.iterdir() if p.name.startswith(".")]


def test_cpp_sources_find_headers_in_the_include_folders(tmp_path, cache):
    (tmp_path / "inc").mkdir()
    source(tmp_path / "inc", "constexpr int value = 5;\n", "value.hpp")
    cpp = source(tmp_path, '#include "value.hpp"\nextern "C" int f() { return value; }\n', "f.cpp")
    assert ctypes.CDLL(str(native.compile_shared([cpp], include_dirs=[tmp_path / "inc"]))).f() == 5


def test_of_several_that_start_together_one_compiles(tmp_path, cache, monkeypatch):
    c = source(tmp_path, "int f(void) { return 3; }\n")
    compiler = source(
        tmp_path,
        f'#!/bin/sh\n[ "$1" = --version ] ||'
        f' echo run >>"{tmp_path}/runs"\nexec "{shutil.which("cc")}" "$@"\n',
        "cc",
    )
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    with ThreadPoolExecutor(4) as pool:
        paths = set(pool.map(lambda _: native.compile_shared([c]), range(4)))
    assert len(paths) == 1 and ctypes.CDLL(str(paths.pop())).f() == 3
    assert (tmp_path / "runs").read_text() == "run\n"


def test_an_object_is_made_once_by_the_compiler_that_is_named(tmp_path, cache):
    cpp = source(tmp_path, "int f() { return 3; }\n", "f.cpp")
    other = source(
        tmp_path,
        f'#!/bin/sh\n[ "$1" = --version ] ||'
        f' echo "$@" >>"{tmp_path}/runs"\nexec "{shutil.which("c++")}" "$@"\n',
        "other",
    )
    other.chmod(0o755)
    own, made = native.compile_object(cpp), native.compile_object(cpp, compiler=str(other))
    assert native.compile_object(cpp, compiler=str(other)) == made != own
    (said,) = (tmp_path / "runs").read_text().splitlines()
    assert str(cpp) in said


def test_missing_sources_bad_code_and_unsafe_flags_are_refused_with_the_reason(tmp_path, cache, monkeypatch):
    with pytest.raises(native.NativeError, match="not found"):
        native.compile_shared([tmp_path / "missing.c"])
    bad = source(tmp_path, "this is not C\n", "bad.c")
    with pytest.raises(native.NativeError, match="error"):
        native.compile_shared([bad])
    with pytest.raises(native.NativeError, match="reproducible"):
        native.compile_shared([source(tmp_path, "int f;\n")], flags=("-ffast-math",))
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(native.NativeError, match="no C compiler"):
        native.compile_shared([source(tmp_path, "int f;\n", "g.c")])


def test_a_cache_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("LPVGUARD_CACHE", str(tmp_path / "file" / "cache"))
    one = source(tmp_path, "int one(void) { return 1; }\n")
    with pytest.raises(
        InputError, match=r"file/cache: cannot be written \(Not a directory\).*LPVGUARD_CACHE"
    ):
        native.compile_shared([one])
    with pytest.raises(InputError, match="cannot be written"):
        native.kernels.__wrapped__("candump")
    with pytest.raises(InputError, match="/proc: cannot be written"):  # there, and nothing can be made in it
        native._compile_to(Path("/proc/one.so"), "cc", (), [], [one])


def test_a_header_that_is_compiled_beforehand_changes_no_byte_of_an_object(tmp_path, cache, monkeypatch):
    """Nor does one that cannot be read, and a source's error is told with either."""
    folder = tmp_path / "sources"  # not above the cache, whose headers would count as its own
    folder.mkdir()
    header = source(folder, "#pragma once\nstatic int value() { return 7; }\n", "value.hpp")
    text = '#include "value.hpp"\nint f() { return value(); }\n'
    read_first = []

    def precompiled():
        compiled = native.precompiled(header, flags=("-O1",), include_dirs=(), version=b"1")
        read_first.append(compiled)
        return compiled

    compilations = []
    compile_to = native._compile_to

    def counted(target, *arguments):
        compilations.append(target.suffix)
        return compile_to(target, *arguments)

    monkeypatch.setattr(native, "_compile_to", counted)
    objects = []
    for first in (None, precompiled, lambda: tmp_path / "absent.hpp"):
        monkeypatch.setenv("LPVGUARD_CACHE", str(cache / str(len(objects))))
        cpp = source(folder, text, "f.cpp")
        objects.append(native.compile_object(cpp, flags=("-O1",), first=first).read_bytes())
        with pytest.raises(native.NativeError, match="lost"):
            bad = source(folder, text + "int g() { return lost; }\n", "g.cpp")
            native.compile_object(bad, flags=("-O1",), first=first)
    assert objects[0] == objects[1] == objects[2]
    if read_first[0] is not None:  # one source, then one with an error that is told without a header
        assert compilations == [".o"] * 2 + [".gch"] + [".o"] * 3 + [".o"] * 4
    (made, again) = read_first
    assert made == again and (made is None or made.with_suffix(".hpp.gch").is_file())


def test_the_package_ziglang_compiles_where_no_other_compiler_is(tmp_path, cache, monkeypatch):
    package = tmp_path / "site" / "ziglang"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    zig = source(
        package, f'#!/bin/sh\nword=$1; shift\n[ "$word" = cc ] && exec {shutil.which("cc")} "$@"\n', "zig"
    )
    zig.chmod(0o755)
    for name in ("CC", "CXX"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(native.shutil, "which", lambda _: None)
    with pytest.raises(native.NativeError, match=r"no C compiler found; .*lpvguard\[compiler\]"):
        native.find_compiler(cxx=False)
    with pytest.raises(InputError, match=r"candump\.c: compiling: no C compiler found"):
        native.kernels.__wrapped__("candump")
    monkeypatch.syspath_prepend(package.parent)
    assert native.find_compiler(cxx=True) == (str(zig), "c++")
    library = native.compile_shared([source(tmp_path, "int f(void) { return 9; }\n")])
    assert ctypes.CDLL(str(library)).f() == 9


def test_eigen_of_a_python_package_is_found(tmp_path, monkeypatch):
    folder = tmp_path / "cmeel.prefix" / "include" / "eigen3"
    folder.mkdir(parents=True)
    monkeypatch.setattr(compiled.shutil, "which", lambda _: None)
    monkeypatch.setattr(compiled, "EIGEN_PREFIXES", ())
    with pytest.raises(native.NativeError, match=r"Eigen 3\.4 not found"):
        compiled.eigen_include()
    monkeypatch.syspath_prepend(tmp_path)
    assert compiled.eigen_include() == str(folder)
