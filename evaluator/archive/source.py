"""Opens a zip or a folder and reads its files in memory; nothing is ever extracted and no link is followed."""

import hashlib
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import BinaryIO, Protocol

from evaluator.archive.end_record import Archive
from evaluator.archive.file_bytes import FileBytes
from evaluator.archive.framing import check_framing
from evaluator.archive.inflate import MemberError, unpack
from evaluator.archive.member import Member
from evaluator.archive.names import check_names
from evaluator.codes import Code
from evaluator.findings import Findings
from evaluator.limits import MIB, Limits

_SMALL_BYTES = 32 * MIB
"""An archive of which every byte is needed is held in memory up to this size; reading it piece by piece takes longer."""


class Source(Protocol):
    """The files of a submission, by number."""

    @property
    def names(self) -> Sequence[str]:
        """The files' names as the uploader gave them; folders are left out."""

    def read(self, number: int) -> bytes:
        """Read one file whole; raises MemberError."""

    def sha256(self) -> str:
        """Compute the SHA-256 as `digest` does."""


class ZipSource:
    """The files of an archive that passed the framing check."""

    def __init__(self, archive: Archive, members: Sequence[Member]) -> None:
        """Keep the archive's bytes; they are unpacked one member at a time."""
        self._archive = archive
        self._bytes = archive if isinstance(archive, FileBytes) else memoryview(archive)
        self._members = members
        self.names: Sequence[str] = [member.name for member in members]

    def read(self, number: int) -> bytes:
        """Unpack and check one member."""
        return unpack(self._bytes, self._members[number])

    def sha256(self) -> str:
        """Compute the SHA-256 of the file that is open, whatever stands at its path meanwhile."""
        if not isinstance(self._archive, FileBytes):
            return hashlib.sha256(self._archive).hexdigest()
        total = hashlib.sha256()
        for start in range(0, len(self._archive), MIB):
            total.update(self._archive[start : start + MIB])
        return total.hexdigest()


class FolderSource:
    """The regular files below a folder."""

    def __init__(self, root: Path, names: Sequence[str], limits: Limits) -> None:
        """Keep the names; the files are read one at a time."""
        self._root = root
        self._limits = limits
        self.names = names

    def read(self, number: int) -> bytes:
        """Read one file, without following a link put there meanwhile."""
        try:
            descriptor = os.open(self._root / self.names[number], os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0))
            with open(descriptor, "rb") as file:  # noqa: PTH123 -- pathlib cannot open a descriptor
                data = file.read(self._limits.file_bytes + 1)
        except OSError as error:
            raise MemberError(Code.UNREADABLE, str(error.strerror)) from None
        if len(data) > self._limits.file_bytes:
            raise MemberError(Code.FILE_TOO_LARGE, f"more than {self._limits.file_bytes} bytes")
        return data

    def sha256(self) -> str:
        """Compute the SHA-256 of all files with their names."""
        return digest(self._root)


@contextmanager
def open_source(
    path: Path, limits: Limits, findings: Findings, *, checked_elsewhere: bool = False
) -> Iterator[Source | None]:
    """Open a zip or a folder; yields None when it cannot be read, with the reasons in `findings`.

    `checked_elsewhere`: another process does the same and throws away what this one makes of an unsound zip. So a small
    zip is not copied either, but mapped: if it is cut short meanwhile, the system ends this process.
    """
    if path.is_dir():
        yield _open_folder(path, limits, findings)
        return
    with open_archive(path, findings, small_bytes=_SMALL_BYTES, mapped=checked_elsewhere) as archive:
        if archive is None:
            yield None
            return
        members = check_framing(archive, limits, findings, checked_elsewhere=checked_elsewhere)
        yield None if findings.error_count else ZipSource(archive, members)


@contextmanager
def open_archive(
    path: Path, findings: Findings, *, small_bytes: int = 0, mapped: bool = False
) -> Iterator[Archive | None]:
    """Open a file for reading in place, or read or map it whole when it is small; yields None when it cannot be opened."""
    try:
        file = _open_regular(path)
    except (OSError, ValueError) as error:
        findings.add(Code.UNREADABLE, detail=getattr(error, "strerror", None) or str(error))
        yield None
        return
    with file:
        if os.fstat(file.fileno()).st_size > small_bytes:
            yield FileBytes(file.fileno())
        else:
            yield _mapped(file) if mapped else file.read()


def _mapped(file: BinaryIO) -> Archive:
    """Map a file; an empty one, which cannot be mapped, is read."""
    try:
        return mmap(file.fileno(), 0, access=ACCESS_READ)
    except ValueError:
        return file.read()


def _open_regular(path: Path) -> BinaryIO:
    """Open a regular file; opening a pipe would wait for its other end."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(0, "it is not a regular file")
    return path.open("rb")


def _open_folder(root: Path, limits: Limits, findings: Findings) -> FolderSource | None:
    """List a folder's files in sorted order and hold them against the caps."""
    names: list[str] = []
    total = 0
    for name, status in _walk(root, findings):
        if stat.S_ISREG(status.st_mode):
            names.append(name)
            total += status.st_size
        else:
            findings.add(Code.LINK_OR_DEVICE, file=name)
        if len(names) > limits.entries:
            findings.add(Code.TOO_MANY_ENTRIES, expected=f"at most {limits.entries}")
            return None
    if total > limits.expanded_bytes:
        findings.add(Code.EXPANDED_TOO_LARGE, found=f"{total} bytes", expected=f"at most {limits.expanded_bytes} bytes")
    names.sort()
    check_names(names, limits, findings)
    return None if findings.error_count else FolderSource(root, names, limits)


def _walk(root: Path, findings: Findings) -> Iterator[tuple[str, os.stat_result]]:
    """Yield every entry below a folder that is not itself a folder, by its relative name with forward slashes."""

    def note(error: OSError) -> None:
        findings.add(Code.UNREADABLE, file=str(error.filename), detail=error.strerror)

    for folder, folders, files in os.walk(root, onerror=note, followlinks=False):
        links = [name for name in folders if Path(folder, name).is_symlink()]
        for name in (*links, *files):
            path = Path(folder, name)
            yield path.relative_to(root).as_posix(), path.lstat()


def digest(path: Path) -> str:
    """Compute the SHA-256 of a file, or for a folder of its sorted names and contents; empty when unreadable.

    For a folder each file adds its name, a zero byte, its size in decimal, a zero byte and its bytes.
    """
    try:
        if path.is_dir():
            return digest_of_files(
                path, [name for name, status in _walk(path, Findings()) if stat.S_ISREG(status.st_mode)]
            )
        if not path.is_file():
            return ""
        total = hashlib.sha256()
        _digest_into(total, path)
    except (OSError, ValueError):
        return ""
    return total.hexdigest()


def digest_of_files(root: Path, names: Sequence[str]) -> str:
    """Compute the SHA-256 of a folder that has these files, or links to files; raises OSError where one is unreadable."""
    total = hashlib.sha256()
    for name in sorted(names):
        path = root / name
        total.update(f"{name}\0{path.stat().st_size}\0".encode("utf-8", "surrogateescape"))
        _digest_into(total, path)
    return total.hexdigest()


def _digest_into(total: "hashlib._Hash", path: Path) -> None:
    """Add a file's bytes piece by piece."""
    with path.open("rb") as file:
        hashlib.file_digest(file, lambda: total)
