"""Reads the entries of a zip's central directory and resolves their ZIP64 values.

Section numbers refer to PKWARE's APPNOTE.TXT 6.3.10.
"""

import struct
from collections.abc import Iterator
from typing import NamedTuple

from evaluator.archive.end_record import CENTRAL_SIGNATURE, Archive, Directory
from evaluator.archive.framing_error import FramingError
from evaluator.codes import Code

_CENTRAL = struct.Struct("<4sHHHHHHIIIHHHHHII")  # 4.3.12
_EXTRA_FIELD = struct.Struct("<HH")  # 4.5.1
_ZIP64_EXTRA = 0x0001
_SATURATED_16 = 0xFFFF
_SATURATED_32 = 0xFFFFFFFF
FLAG_UTF8 = 0x0800


class Entry(NamedTuple):
    """One entry of the central directory."""

    raw_name: bytes
    name: str | None
    """None when the bytes are not the UTF-8 they claim to be."""
    flags: int
    method: int
    crc32: int
    packed_bytes: int
    expanded_bytes: int
    header_offset: int
    unix_type: int
    """The file type bits of a Unix mode; 0 where the packer gave none."""

    @property
    def shown_name(self) -> str:
        """Name the entry in a report, whatever its bytes are."""
        return self.raw_name.decode("utf-8", "backslashreplace") if self.name is None else self.name


def read_directory(archive: Archive, directory: Directory) -> Iterator[Entry]:
    """Read every entry of the central directory, which must fill its bytes exactly.

    Raises:
        FramingError: at the first entry that is damaged, or when there are fewer or more of them than stated.
    """
    at, end = directory.offset, directory.end
    for number in range(directory.entries):
        if at == end:
            raise FramingError(Code.ENTRY_COUNT_MISMATCH, f"{directory.entries} members stated, {number} present")
        if at + _CENTRAL.size > end or archive[at : at + 4] != CENTRAL_SIGNATURE:
            raise FramingError(Code.DAMAGED_DIRECTORY, f"entry {number} at byte {at} is damaged")
        entry, at = _read_entry(archive, at)
        if at > end:
            raise FramingError(Code.DAMAGED_DIRECTORY, f"entry {number} reaches past the directory")
        yield entry
    if at < end:
        one_more = archive[at : at + 4] == CENTRAL_SIGNATURE
        code = Code.ENTRY_COUNT_MISMATCH if one_more else Code.DAMAGED_DIRECTORY
        raise FramingError(code, f"{end - at} bytes follow the {directory.entries} members stated")


def _read_entry(archive: Archive, at: int) -> tuple[Entry, int]:
    """Read one entry and give the offset after it."""
    (_, _, _, flags, method, _, _, crc32, packed, expanded, name_length, extra_length, comment_length, disk, _) = (
        fields := _CENTRAL.unpack(archive[at : at + _CENTRAL.size])
    )[:15]
    attributes, offset = fields[15:]
    name_at = at + _CENTRAL.size
    extra_at = name_at + name_length
    raw_name = archive[name_at:extra_at]
    values = (expanded, packed, offset)
    if extra_length or _SATURATED_32 in values:
        expanded, packed, offset = widen(archive[extra_at : extra_at + extra_length], values)
    if disk not in (0, _SATURATED_16):
        raise FramingError(Code.MULTI_DISK, f"a member is on disk {disk}")
    name = _decode_name(raw_name, flags)
    unix_type = (attributes >> 16) & 0xF000
    entry = Entry(raw_name, name, flags, method, crc32, packed, expanded, offset, unix_type)
    return entry, extra_at + extra_length + comment_length


def _decode_name(raw_name: bytes, flags: int) -> str | None:
    """Decode a name: UTF-8 when it is, even unannounced (macOS), otherwise code page 437 (appendix D)."""
    try:
        return raw_name.decode("utf-8")
    except UnicodeDecodeError:
        return None if flags & FLAG_UTF8 else raw_name.decode("cp437")


def widen(extra: bytes, values: tuple[int, ...]) -> tuple[int, ...]:
    """Replace each saturated 32-bit value by its ZIP64 value (4.5.3).

    Args:
        extra: the extra fields of the header.
        values: expanded size, packed size and, in the central directory, the header's offset.

    Raises:
        FramingError: when the ZIP64 field is missing, there twice, too short or contradicts a value that needs none.
    """
    wide = _zip64_values(extra)
    if wide is None:
        if _SATURATED_32 in values:
            raise FramingError(Code.ZIP64_MISMATCH, "a size or offset is left to a ZIP64 field that is missing")
        return values
    if len(wide) < values.count(_SATURATED_32):
        raise FramingError(Code.ZIP64_MISMATCH, "a ZIP64 field is too short")
    queue = iter(wide)
    resolved = tuple(next(queue) if value == _SATURATED_32 else value for value in values)
    rest = tuple(queue)
    if rest and wide[: len(values)] != resolved[: len(wide)]:
        raise FramingError(Code.ZIP64_MISMATCH, f"sizes {values} and ZIP64 values {wide} contradict each other")
    return resolved


def _zip64_values(extra: bytes) -> tuple[int, ...] | None:
    """Find the 64-bit values of the one ZIP64 field, None without such a field."""
    found: tuple[int, ...] | None = None
    at = 0
    while at + _EXTRA_FIELD.size <= len(extra):
        kind, length = _EXTRA_FIELD.unpack_from(extra, at)
        at += _EXTRA_FIELD.size
        if at + length > len(extra):
            raise FramingError(Code.DAMAGED_DIRECTORY, "an extra field reaches past its header")
        if kind == _ZIP64_EXTRA:
            if found is not None:
                raise FramingError(Code.ZIP64_MISMATCH, "a header has two ZIP64 fields")
            found = struct.unpack_from(f"<{length // 8}Q", extra, at)
        at += length
    return found
