"""Read the files of a public repository from a clone, from a plain folder, or by git over the network."""

import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from ...base.errors import InputError
from .table import DataSet


class Origin(Protocol):
    """Source of a repository's files; reading raises InputError for a missing file."""

    def read(self, commit: str, path: str) -> bytes:
        """Bytes of the file."""


class Clone:
    """A clone, bare or with files checked out."""

    def __init__(self, folder: Path, repository: str):
        self.folder, self.repository = folder, repository

    def read(self, commit: str, path: str) -> bytes:
        """Read the bytes of the file at the commit; the checked-out commit has no effect."""
        done = _git("-C", str(self.folder), "cat-file", "blob", f"{commit}:{path}")
        if done.returncode:
            raise InputError(
                self.folder,
                f"{path} at commit {commit[:12]}",
                f"git cannot read it ({_last_line(done.stderr)})",
                f"a clone of {self.repository} with that commit",
            )
        return done.stdout


class PlainFolder:
    """Folder with the repository's files, like an unpacked archive; the hashes check the commit."""

    def __init__(self, folder: Path, repository: str):
        self.folder, self.repository = folder, repository

    def read(self, commit: str, path: str) -> bytes:
        """Bytes of the file."""
        try:
            return (self.folder / path).read_bytes()
        except OSError as error:
            raise InputError(
                self.folder / path,
                "",
                f"cannot be read ({error.strerror})",
                f"the file of {self.repository} at commit {commit}",
            ) from None


@contextmanager
def origin_of(data: DataSet, folder: Path | None) -> Iterator[Origin]:
    """Open the origin of a data set: ``folder``, or by default its repository, by git over the network.

    The folder is a clone or a plain folder. Only the needed files are fetched, into a scratch folder.
    """
    if folder is not None:
        if not folder.is_dir():
            raise InputError(folder, "--from", "no such folder", f"a clone of {data.repository}")
        bare = (folder / "HEAD").is_file() and (folder / "objects").is_dir()
        kind = Clone if bare or (folder / ".git").exists() else PlainFolder
        yield kind(folder, data.repository)
        return
    with tempfile.TemporaryDirectory() as scratch:
        commits = sorted({f.commit for f in data.files})
        for words in (
            ("init", "--quiet", "--bare"),
            ("remote", "add", "origin", data.repository),
            ("fetch", "--quiet", "--depth", "1", "--filter=blob:none", "origin", *commits),
        ):
            done = _git("-C", scratch, *words)
            if done.returncode:
                raise InputError(
                    data.repository,
                    "",
                    f"git {words[0]} fails ({_last_line(done.stderr)})",
                    "a network that reaches it, or --from with a clone",
                )
        yield Clone(Path(scratch), data.repository)


def _git(*words: str) -> subprocess.CompletedProcess[bytes]:
    try:
        return subprocess.run(["git", *words], capture_output=True, check=False, stdin=subprocess.DEVNULL)
    except FileNotFoundError:
        raise InputError("git", "", "not found", "git, or --from with a folder of plain files") from None


def _last_line(text: bytes) -> str:
    lines = text.decode("utf-8", "replace").strip().splitlines()
    return lines[-1] if lines else "no message"
