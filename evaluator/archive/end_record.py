"""Finds the end records of a zip and the central directory they point to.

Section numbers refer to PKWARE's APPNOTE.TXT 6.3.10.
"""

import struct
from dataclasses import dataclass
from mmap import mmap

from evaluator.archive.file_bytes import FileBytes
from evaluator.archive.framing_error import FramingError
from evaluator.codes import Code

Archive = bytes | mmap | FileBytes
"""All bytes of a zip; a slice of each kind is `bytes`."""

_END = struct.Struct("<4sHHHHIIH")  # 4.3.16
_END64 = struct.Struct("<4sQHHIIQQQQ")  # 4.3.14
_LOCATOR64 = struct.Struct("<4sIQI")  # 4.3.15

_END_SIGNATURE = b"PK\x05\x06"
_END64_SIGNATURE = b"PK\x06\x06"
_LOCATOR64_SIGNATURE = b"PK\x06\x07"
CENTRAL_SIGNATURE = b"PK\x01\x02"
LOCAL_SIGNATURE = b"PK\x03\x04"

_LONGEST_COMMENT = 0xFFFF
_LONGEST_LOOK = 1 << 20
_SATURATED = (0xFFFF,) * 4 + (0xFFFFFFFF,) * 2
_MAGIC = {
    b"\x1f\x8b": "gzip",
    b"Rar!": "rar",
    b"7z\xbc\xaf": "7z",
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"{": "JSON",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Directory:
    """Where the central directory is and how many entries it says it has."""

    offset: int
    size: int
    entries: int

    @property
    def end(self) -> int:
        """Give the offset of the first byte after it."""
        return self.offset + self.size


def find_directory(archive: Archive) -> Directory:
    """Find the end record, which must close the file, and from it the central directory (4.3.16).

    Raises:
        FramingError: when the file is no zip, or its end records are damaged or contradict each other.
    """
    at = _find_end_record(archive)
    narrow = _END.unpack(archive[at : at + _END.size])[1:7]
    if any(value == cap for value, cap in zip(narrow, _SATURATED, strict=True)) or _has_locator(archive, at):
        at, wide = _read_end64(archive, at)
        _check_widened(narrow, wide)
    else:
        wide = narrow
    disk, first_disk, here, entries, size, offset = wide
    if disk or first_disk or here != entries:
        raise FramingError(Code.MULTI_DISK, f"the end record is on disk {disk} with {here} of {entries} members")
    if offset + size > at:
        raise FramingError(Code.DAMAGED_DIRECTORY, f"it would reach past its end record at byte {at}")
    if offset + size < at:
        moved = archive[at - size : at - size + 4] == CENTRAL_SIGNATURE or not size
        code = Code.PREFIX_BYTES if moved else Code.HIDDEN_BYTES
        raise FramingError(code, f"{at - offset - size} bytes too many before the end record at byte {at}")
    return Directory(offset=offset, size=size, entries=entries)


def _find_end_record(archive: Archive) -> int:
    """Find the one end-of-central-directory record whose comment ends with the file."""
    if archive[:2] != b"PK":
        raise _no_zip(archive)
    tail_at = max(0, len(archive) - _END.size - _LONGEST_COMMENT)
    tail = archive[tail_at:]
    at = tail.rfind(_END_SIGNATURE)
    if at < 0 or len(tail) - at < _END.size:
        raise _no_end(archive)
    end = at + _END.size + int.from_bytes(tail[at + 20 : at + 22], "little")
    if end > len(tail):
        raise FramingError(Code.TRUNCATED_ARCHIVE, "the comment of its end record is cut off")
    if end < len(tail):
        raise FramingError(Code.SUFFIX_BYTES, f"{len(tail) - end} bytes after the end record")
    return tail_at + at


def _no_end(archive: Archive) -> FramingError:
    """Tell an archive that was cut off from one with so many bytes after it that its end record is out of reach."""
    at = archive.rfind(_END_SIGNATURE)
    if 0 <= at <= len(archive) - _END.size:
        return FramingError(Code.SUFFIX_BYTES, f"{len(archive) - at - _END.size} bytes after the end record")
    return FramingError(Code.TRUNCATED_ARCHIVE, "it has no whole end-of-central-directory record")


def _no_zip(archive: Archive) -> FramingError:
    """Say what the bytes look like instead of a zip."""
    head = archive[:512]
    if not head:
        return FramingError(Code.NOT_A_ZIP, "the file is empty")
    if archive[-_END.size :][:4] == _END_SIGNATURE or LOCAL_SIGNATURE in archive[:_LONGEST_LOOK]:
        return FramingError(Code.PREFIX_BYTES, f"the file starts with {head[:4]!r}")
    if head[257:262] == b"ustar":
        return FramingError(Code.NOT_A_ZIP, "it looks like tar")
    kinds = [kind for magic, kind in _MAGIC.items() if head.startswith(magic)]
    looks = f"it looks like {kinds[0]}" if kinds else f"it starts with {head[:4]!r}"
    return FramingError(Code.NOT_A_ZIP, looks)


def _has_locator(archive: Archive, end_at: int) -> bool:
    """Tell whether a ZIP64 locator precedes the end record."""
    at = end_at - _LOCATOR64.size
    return at >= 0 and archive[at : at + 4] == _LOCATOR64_SIGNATURE


def _read_end64(archive: Archive, end_at: int) -> tuple[int, tuple[int, ...]]:
    """Read the ZIP64 end record: its offset and disk, first disk, entries here, entries, size, offset."""
    if not _has_locator(archive, end_at):
        raise FramingError(Code.ZIP64_MISMATCH, "values are left to a ZIP64 record, but there is no locator for it")
    locator_at = end_at - _LOCATOR64.size
    _, disk, at, disks = _LOCATOR64.unpack(archive[locator_at : locator_at + _LOCATOR64.size])
    if disk or disks > 1:
        raise FramingError(Code.MULTI_DISK, f"the ZIP64 locator speaks of {disks} disks")
    if at + _END64.size > locator_at or archive[at : at + 4] != _END64_SIGNATURE:
        raise FramingError(Code.ZIP64_MISMATCH, f"there is no ZIP64 end record at byte {at}")
    _, length, _, _, *wide = _END64.unpack(archive[at : at + _END64.size])
    if at + 12 + length != locator_at:
        raise FramingError(Code.ZIP64_MISMATCH, f"the ZIP64 end record of {length} bytes does not end at its locator")
    return at, tuple(wide)


def _check_widened(narrow: tuple[int, ...], wide: tuple[int, ...]) -> None:
    """Demand that each 16- or 32-bit value is either saturated or equal to the ZIP64 value (4.4.1.4)."""
    for small, large, cap in zip(narrow, wide, _SATURATED, strict=True):
        if small not in (large, cap):
            raise FramingError(Code.ZIP64_MISMATCH, f"the end record says {small}, its ZIP64 version {large}")
