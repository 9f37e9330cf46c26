"""Compile C and C++ sources to a shared library on first use, and load it.

The library lives in ``${LPVGUARD_CACHE:-${XDG_CACHE_HOME:-~/.cache}/lpvguard}``. Its name is a hash of the
sources, the headers beside them, the flags and the compiler's version; with ``-march=native`` also of the
processor. A stale or foreign library is therefore never loaded. Writing is atomic. Of processes that start
together one compiles while the others wait.

``LPVGUARD_NO_NATIVE=1`` switches every compiled kernel off; the numpy versions give the same answers.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import InputError
from .system import locked_file

if TYPE_CHECKING:
    import numpy as np

REPRODUCIBLE_FLAGS = ("-O3", "-ffp-contract=off", "-fno-math-errno")
"""Contraction off: the same source gives the same bits whether or not the target has FMA. Never
-ffast-math."""

_HEADER_SUFFIXES = {".h", ".hh", ".hpp", ".inc"}
_CXX_SUFFIXES = {".cpp", ".cc", ".cxx", ".o"}
"""An object is linked as C++, which C objects do not mind."""


class NativeError(RuntimeError):
    """No compiler, or the compiler refused the sources; the text holds the command and its first
    complaint."""


def cache_dir() -> Path:
    """Folder of compiled libraries; made on demand. InputError where it cannot be."""
    explicit = os.environ.get("LPVGUARD_CACHE")
    base = (
        Path(explicit)
        if explicit
        else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "lpvguard"
    )
    with _usable(base):
        base.mkdir(parents=True, exist_ok=True)
    return base


@contextmanager
def _usable(folder: Path) -> Iterator[None]:
    """InputError where the cache cannot be written."""
    try:
        yield
    except OSError as error:
        what = f"cannot be written ({error.strerror}), and compiled code belongs there"
        raise InputError(folder, "", what, "a folder for it in LPVGUARD_CACHE") from None


def native_enabled() -> bool:
    """False when ``LPVGUARD_NO_NATIVE`` asks for the numpy versions."""
    return os.environ.get("LPVGUARD_NO_NATIVE", "") in ("", "0")


def find_compiler(*, cxx: bool) -> str:
    """Path of the C or C++ compiler: ``$CC`` / ``$CXX`` first, then the usual names. Raises NativeError if
    none."""
    names = [
        os.environ.get("CXX" if cxx else "CC") or "",
        *(("c++", "g++", "clang++") if cxx else ("cc", "gcc", "clang")),
    ]
    for name in filter(None, names):
        path = shutil.which(name)
        if path:
            return path
    language = "C++" if cxx else "C"
    raise NativeError(f"no {language} compiler found; install gcc or clang, or set {'CXX' if cxx else 'CC'}")


@functools.cache
def _compiler_version(compiler: str) -> str:
    return subprocess.run([compiler, "--version"], capture_output=True, text=True, check=True).stdout


@functools.cache
def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith(("flags", "Features"))), platform.processor())


def _digest(
    sources: Sequence[Path], flags: Sequence[str], include_dirs: Sequence[Path], compiler: str
) -> str:
    sha = hashlib.sha256()
    for text in (compiler, _compiler_version(compiler), platform.machine(), *flags):
        sha.update(text.encode() + b"\0")
    if "-march=native" in flags:
        sha.update(_processor().encode())
    for path in sources:
        sha.update(path.name.encode() + b"\0" + path.read_bytes())
    beside = (s.parent for s in sources if s.suffix != ".o")  # an object needs no header any more
    for folder in dict.fromkeys((*include_dirs, *beside)):
        for path in sorted(p for p in folder.rglob("*") if p.suffix in _HEADER_SUFFIXES and p.is_file()):
            sha.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes())
    return sha.hexdigest()[:24]


def compile_shared(
    sources: Iterable[Path | str],
    *,
    flags: Sequence[str] = REPRODUCIBLE_FLAGS,
    include_dirs: Iterable[Path | str] = (),
    name: str = "native",
) -> Path:
    """Path of the shared library made from ``sources``; compiled only when the cache has none with this hash.

    ``flags`` go to the compiler as they are, in front of ``-fPIC -shared``. C++ when any source is C++.
    Headers are hashed when they lie in ``include_dirs`` or beside a source; system headers are covered by the
    compiler's version only. Raises NativeError when there is no compiler, or a source is missing or does not
    compile. A flag that would let the compiler reorder floating-point arithmetic raises it too.
    """
    suffix = ".dylib" if sys.platform == "darwin" else ".so"
    return _compile(sources, (*flags, "-fPIC", "-shared"), include_dirs, name, suffix)


def compile_executable(
    sources: Iterable[Path | str],
    *,
    flags: Sequence[str] = REPRODUCIBLE_FLAGS,
    include_dirs: Iterable[Path | str] = (),
    name: str = "native",
) -> Path:
    """Path of the program made from ``sources``; otherwise as ``compile_shared``."""
    return _compile(sources, tuple(flags), include_dirs, name, "")


def compile_object(
    source: Path | str,
    *,
    flags: Sequence[str] = REPRODUCIBLE_FLAGS,
    include_dirs: Iterable[Path | str] = (),
    compiler: str | None = None,
    first: Callable[[], Path | None] | None = None,
) -> Path:
    """Path of the object file of one source, for ``compile_executable``; C sources are compiled as C++.
    Otherwise as ``compile_shared``. Objects of a program that is built in variants are then compiled once,
    and several at a time. ``compiler``: another one than this machine's own. ``first``: a `precompiled`
    header that the source includes, asked for where there is something to compile."""
    kind = (*flags, "-x", "c++", "-c")
    return _compile([source], kind, include_dirs, Path(source).stem, ".o", compiler, first)


def precompiled(
    header: Path, *, flags: Sequence[str], include_dirs: Iterable[Path | str], version: bytes
) -> Path | None:
    """What GCC is to include in the place of ``header``, which it has compiled for sources with the same
    flags; objects keep their bytes. None with another compiler: clang refuses one whose files were touched
    since.

    ``version``: what the header's own system headers say of theirs. Raises as ``compile_shared``.
    """
    compiler = find_compiler(cxx=True)
    if "Free Software Foundation" not in _compiler_version(compiler):
        return None
    name = f"{header.stem}-{hashlib.sha256(version).hexdigest()[:8]}"
    kind = (*flags, "-x", "c++-header")
    return _compile([header], kind, include_dirs, name, ".hpp.gch", compiler).with_suffix("")


def _compile(
    sources: Iterable[Path | str],
    flags: tuple[str, ...],
    include_dirs: Iterable[Path | str],
    name: str,
    suffix: str,
    compiler: str | None = None,
    first: Callable[[], Path | None] | None = None,
) -> Path:
    paths = [Path(s).resolve() for s in sources]
    includes = [Path(p).resolve() for p in include_dirs]
    missing = [str(p) for p in paths if not p.is_file()]
    if missing or not paths:
        raise NativeError(f"source not found: {', '.join(missing) or '(none given)'}")
    if {"-ffast-math", "-Ofast", "-funsafe-math-optimizations"} & set(flags):
        raise NativeError(
            "flags that reorder floating-point arithmetic are refused: results must be reproducible"
        )
    compiler = compiler or find_compiler(cxx=any(p.suffix in _CXX_SUFFIXES for p in paths))
    target = cache_dir() / f"{name}-{_digest(paths, flags, includes, compiler)}{suffix}"
    if target.is_file():
        return target
    with ExitStack() as held:
        with _usable(target.parent):  # of processes that start together one compiles
            held.enter_context(locked_file(Path(f"{target}.lock")))
        if target.is_file():
            return target
        try:
            if first and (header := first()):
                return _compile_to(target, compiler, (*flags, "-include", str(header)), includes, paths)
        except NativeError:
            pass  # GCC does not take every compiled header everywhere; a source's own error comes again
        return _compile_to(target, compiler, flags, includes, paths)


def _compile_to(
    target: Path, compiler: str, flags: tuple[str, ...], includes: list[Path], paths: list[Path]
) -> Path:
    """Compile to ``target``, whole or not at all. Raises NativeError with the compiler's complaint."""
    name, suffix = target.stem, target.suffix
    with _usable(target.parent):
        handle, temporary = tempfile.mkstemp(suffix=suffix, prefix=f".{name}-", dir=target.parent)
    os.close(handle)
    command = [compiler, *flags, *(f"-I{p}" for p in includes), *map(str, paths), "-o", temporary]
    command += [] if suffix in (".o", ".gch") else ["-lm"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise NativeError(f"{' '.join(command)}\n{done.stderr.strip()[:2000]}")
        os.chmod(temporary, 0o755)
        os.replace(temporary, target)
    finally:
        Path(temporary).unlink(missing_ok=True)
    return target


_KERNEL_LEVEL = {
    "lyapunov_barrier": "-O3",
    "s1": "-O3",
    "hann": "-O3",
    "spread": "-O3",
    "s2": "-O2",
    "ray": "-O2",
    "candump": "-O2",
    "recursion": "-O2",
}
"""Optimisation per kernel: -O3 vectorises s1 (twice as fast); the others gain nothing from its longer
compilation."""


@functools.cache
def _load_kernel(name: str) -> ctypes.CDLL | None:
    source = Path(__file__).parent / "_native" / f"{name}.c"
    flags = ("-std=c11", "-Wall", "-Wextra", "-march=native", *REPRODUCIBLE_FLAGS, _KERNEL_LEVEL[name])
    try:
        return ctypes.CDLL(str(compile_shared([source], flags=flags, name=f"lpvguard_{name}")))
    except (NativeError, InputError, OSError):  # OSError: no library may be loaded from the cache's disk
        return None


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    """To the first number of a C-ordered array (N,) of any number of axes, which the caller keeps alive."""
    return array.ctypes.data_as(ctypes.c_void_p)


def kernels(name: str) -> ctypes.CDLL | None:
    """The package's own compiled kernel of that name in ``_native``; None without a compiler or a cache, or
    when switched off.

    Callers then use numpy, or for candump plain Python.
    """
    return _load_kernel(name) if native_enabled() else None
