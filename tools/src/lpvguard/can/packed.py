"""Read compressed logs: .gz, .bz2, .xz, .zst, .zip. A .zip with several logs is unpacked into a folder."""

import bz2
import gzip
import lzma
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path, PurePath

from ..base.errors import InputError


def _zstandard(data: bytes) -> bytes:
    """Decompress a Zstandard stream; its frames may omit their size."""
    import pyarrow as pa

    with pa.CompressedInputStream(pa.BufferReader(data), "zstd") as stream:
        return stream.read()


_UNPACK: dict[str, Callable[[bytes], bytes]] = {
    ".gz": gzip.decompress,
    ".bz2": bz2.decompress,
    ".xz": lzma.decompress,
    ".zst": _zstandard,
}
"""Function that decompresses a file, by suffix."""
PACKED = frozenset((*_UNPACK, ".zip"))
"""Suffixes of compressed files."""


def name_inside(path: Path) -> str:
    """Return the file name of a log without its compression.

    Raises InputError unless a .zip can be read and holds exactly one file.
    """
    if path.suffix.lower() != ".zip":
        return path.stem if path.suffix.lower() in _UNPACK else path.name
    files = names_inside(path)
    if len(files) != 1:
        said = ", ".join(files[:3]) + (", ..." if len(files) > 3 else "")
        raise InputError(path, "", f"holds {len(files)} files ({said})", "one log; unpack it into a folder")
    return files[0]


def names_inside(path: Path) -> list[str]:
    """Name the files of a .zip; raise InputError if it cannot be read."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (OSError, zipfile.BadZipFile) as error:
        raise InputError(path, "", f"cannot be read ({error})", "a whole .zip") from None
    return [n for n in names if not n.endswith("/") and not n.startswith("__MACOSX")]


@cache
def _unpacked_folders() -> tempfile.TemporaryDirectory[str]:
    """A folder for the files of archives until the process ends."""
    return tempfile.TemporaryDirectory()


@cache
def unpacked_folder(path: Path) -> Path:
    """Unpack a .zip into a folder of its name, which the end of the process removes.

    Raises InputError if it cannot be unpacked.
    """
    folder = Path(tempfile.mkdtemp(dir=_unpacked_folders().name)) / path.name
    try:
        with zipfile.ZipFile(path) as archive:
            archive.extractall(folder, names_inside(path))
    except (OSError, RuntimeError, ValueError, zlib.error, zipfile.BadZipFile) as error:
        raise InputError(path, "", f"cannot be unpacked ({error})", "a whole .zip") from None
    return folder


def unpacked(path: Path, most: int | None = None) -> bytes:
    """Read a file, or its first ``most`` bytes, and decompress it according to its suffix.

    Raises InputError if the file cannot be read or is damaged.
    """
    inside = name_inside(path)
    try:
        if path.suffix.lower() not in PACKED:
            with path.open("rb") as stream:
                return stream.read(most)
        if path.suffix.lower() == ".zip":
            with zipfile.ZipFile(path) as archive:
                return archive.read(inside)[:most]
        return _UNPACK[path.suffix.lower()](path.read_bytes())[:most]
    except (
        OSError,
        EOFError,
        RuntimeError,
        ValueError,
        zlib.error,
        lzma.LZMAError,
        zipfile.BadZipFile,
    ) as error:
        raise InputError(
            path, "", f"cannot be read ({error})", "a readable file, whole if it is compressed"
        ) from None


def suffix_inside(path: Path) -> str:
    """Return the suffix of a log without its compression, in lower case; "" if there is none."""
    return PurePath(name_inside(path)).suffix.lower()
