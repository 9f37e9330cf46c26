"""Compile C and C++ sources to a shared library on first use, and load it.

The library lies in ``${LPVGUARD_CACHE:-${XDG_CACHE_HOME:-~/.cache}/lpvguard}``. Its name is a hash of the
sources, the headers beside them, the flags and the compiler's version. With ``-march=native`` it covers the
processor too. A stale or foreign library is therefore never loaded. When several processes start together,
one compiles and the others wait.

The package's own kernels in ``_native`` have no second implementation: without a compiler they are refused.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import importlib.util
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
"""Contraction off: the same source gives the same bits with and without FMA. Never -ffast-math."""

_HEADER_SUFFIXES = {".h", ".hh", ".hpp", ".inc"}
_CXX_SUFFIXES = {".cpp", ".cc", ".cxx", ".o"}
"""Objects are linked as C++."""


class NativeError(RuntimeError):
    """There is no compiler, or it refused the sources; the text holds the command and its first complaint."""


def cache_dir() -> Path:
    """Return the folder of compiled libraries, made on demand.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If it cannot be made or written.
    """
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
    """Require that the cache can be written; InputError otherwise."""
    try:
        yield
    except OSError as error:
        what = f"cannot be written ({error.strerror}), and compiled code belongs there"
        raise InputError(folder, "", what, "a folder for it in LPVGUARD_CACHE") from None


def find_compiler(*, cxx: bool) -> tuple[str, ...]:
    """Find a C or C++ compiler and return the first words of its command; raise NativeError if there is none.

    ``$CC`` or ``$CXX`` comes first, then the usual names, then the Python package ziglang.
    """
    names = [
        os.environ.get("CXX" if cxx else "CC") or "",
        *(("c++", "g++", "clang++") if cxx else ("cc", "gcc", "clang")),
    ]
    for name in filter(None, names):
        path = shutil.which(name)
        if path:
            return (path,)
    if (package := importlib.util.find_spec("ziglang")) and package.origin:
        return (str(Path(package.origin).with_name("zig")), "c++" if cxx else "cc")
    language = "C++" if cxx else "C"
    raise NativeError(
        f"no {language} compiler found; install gcc, clang or lpvguard[compiler], "
        f"or set {'CXX' if cxx else 'CC'}"
    )


@functools.cache
def _compiler_version(compiler: tuple[str, ...]) -> str:
    return subprocess.run([*compiler, "--version"], capture_output=True, text=True, check=True).stdout


@functools.cache
def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith(("flags", "Features"))), platform.processor())


def _digest(
    sources: Sequence[Path], flags: Sequence[str], include_dirs: Sequence[Path], compiler: tuple[str, ...]
) -> str:
    sha = hashlib.sha256()
    for text in (*compiler, _compiler_version(compiler), platform.machine(), *flags):
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
    """Compile sources to a shared library, unless the cache has it.

    The library is C++ when any source is C++. Headers are hashed when they lie in ``include_dirs`` or beside
    a source. The compiler's version stands for the system's headers.

    Parameters
    ----------
    sources : Iterable of Path or str
    flags : Sequence[str], put in front of ``-fPIC -shared``
    include_dirs : Iterable of Path or str, optional
    name : str, prefix of the file's name, default 'native'

    Returns
    -------
    Path

    Raises
    ------
    NativeError
        If there is no compiler, a source is missing, or it does not compile.
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
    """Compile sources to a program, unless the cache has it.

    Parameters
    ----------
    sources : Iterable of Path or str
    flags : Sequence[str]
    include_dirs : Iterable of Path or str, optional
    name : str, prefix of the file's name, default 'native'

    Returns
    -------
    Path

    Raises
    ------
    NativeError
        If there is no compiler, a source is missing, or it does not compile.
    """
    return _compile(sources, tuple(flags), include_dirs, name, "")


def compile_object(
    source: Path | str,
    *,
    flags: Sequence[str] = REPRODUCIBLE_FLAGS,
    include_dirs: Iterable[Path | str] = (),
    compiler: str | None = None,
    first: Callable[[], Path | None] | None = None,
) -> Path:
    """Compile one source to an object for `compile_executable`, unless the cache has it.

    C sources are compiled as C++. Variants of a program share objects, and several compile at once.

    Parameters
    ----------
    source : Path or str
    flags : Sequence[str]
    include_dirs : Iterable of Path or str, optional
    compiler : str, optional, by default this machine's own
    first : Callable, optional, gives a `precompiled` header; called only to compile

    Returns
    -------
    Path

    Raises
    ------
    NativeError
        If there is no compiler, a source is missing, or it does not compile.
    """
    kind = (*flags, "-x", "c++", "-c")
    return _compile(
        [source], kind, include_dirs, Path(source).stem, ".o", (compiler,) if compiler else None, first
    )


def precompiled(
    header: Path, *, flags: Sequence[str], include_dirs: Iterable[Path | str], version: bytes
) -> Path | None:
    """Precompile a header for sources with the same flags; their objects keep their bytes.

    Parameters
    ----------
    header : Path
    flags : Sequence[str]
    include_dirs : Iterable of Path or str, optional
    version : bytes, versions of the system headers that it includes

    Returns
    -------
    Path of what to include instead, or None with a compiler other than GCC

    Raises
    ------
    NativeError
        If there is no compiler, the header is missing, or it does not compile.
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
    compiler: tuple[str, ...] | None = None,
    first: Callable[[], Path | None] | None = None,
) -> Path:
    """Compile sources to a cached file; ``first`` makes a header that is included before each of them."""
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
    target: Path, compiler: tuple[str, ...], flags: tuple[str, ...], includes: list[Path], paths: list[Path]
) -> Path:
    """Compile to ``target``, whole or not at all. Raises NativeError with the compiler's complaint."""
    name, suffix = target.stem, target.suffix
    with _usable(target.parent):
        handle, temporary = tempfile.mkstemp(suffix=suffix, prefix=f".{name}-", dir=target.parent)
    os.close(handle)
    command = [*compiler, *flags, *(f"-I{p}" for p in includes), *map(str, paths), "-o", temporary]
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
"""Optimisation per kernel: -O3 vectorises s1 (twice as fast); the others gain nothing."""


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    """Return a pointer to the first number of an array.

    Parameters
    ----------
    array : ndarray (N,) or any C-ordered shape, the caller keeps it alive

    Returns
    -------
    ctypes.c_void_p
    """
    return array.ctypes.data_as(ctypes.c_void_p)


@functools.cache
def kernels(name: str, *flags: str) -> ctypes.CDLL:
    """Load one of the package's own compiled kernels in ``_native``.

    Parameters
    ----------
    name : str
    *flags : str, further ones for the compiler

    Returns
    -------
    CDLL

    Raises
    ------
    InputError
        If there is no compiler, or the cache cannot be written or loaded from.
    """
    source = Path(__file__).parent / "_native" / f"{name}.c"
    kind = ("-std=c11", "-Wall", "-Wextra", "-march=native", *REPRODUCIBLE_FLAGS, _KERNEL_LEVEL[name])
    try:
        return ctypes.CDLL(str(compile_shared([source], flags=(*kind, *flags), name=f"lpvguard_{name}")))
    except (NativeError, OSError) as error:  # OSError: no library may be loaded from the cache's disk
        raise InputError(source.name, "compiling", str(error).strip(), "a C11 compiler and a cache") from None
