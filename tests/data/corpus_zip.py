"""Writes zips byte by byte, so that any field can lie."""

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

STORED, DEFLATED = 0, 8
DESCRIPTOR = 0x0008
UTF8 = 0x0800
REGULAR_FILE = 0o100644 << 16
SYMLINK = 0o120777 << 16
ZIP64_EXTRA = 0x0001


def deflate(data: bytes) -> bytes:
    """Compress to a raw deflate stream."""
    compressor = zlib.compressobj(9, zlib.DEFLATED, -15)
    return compressor.compress(data) + compressor.flush()


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One member. Whatever is None is written truthfully."""

    name: bytes
    data: bytes = b""
    method: int = DEFLATED
    packed: bytes | None = None
    flags: int = 0
    attributes: int = REGULAR_FILE
    stated_crc32: int | None = None
    stated_packed: int | None = None
    stated_expanded: int | None = None
    offset: int | None = None
    central_extra: bytes = b""
    local_extra: bytes = b""
    local_name: bytes | None = None
    local_method: int | None = None
    local_flags: int | None = None
    local_sizes: tuple[int, int, int] | None = None
    """crc32, packed, expanded in the member's own header."""
    descriptor: bytes = b""
    before: bytes = b""
    """Bytes put before the member."""
    disk: int = 0

    @property
    def packed_data(self) -> bytes:
        """Give the bytes as stored in the archive."""
        if self.packed is not None:
            return self.packed
        return deflate(self.data) if self.method == DEFLATED else self.data

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Give crc32, packed and expanded size as the directory states them."""
        truth = (zlib.crc32(self.data), len(self.packed_data), len(self.data))
        stated = (self.stated_crc32, self.stated_packed, self.stated_expanded)
        return tuple(true if said is None else said for said, true in zip(stated, truth, strict=True))  # type: ignore[return-value]

    def local(self) -> bytes:
        """Write the member with its own header."""
        name = self.name if self.local_name is None else self.local_name
        flags = self.flags if self.local_flags is None else self.local_flags
        method = self.method if self.local_method is None else self.local_method
        sizes = self.local_sizes or ((0, 0, 0) if flags & DESCRIPTOR else self.sizes)
        header = struct.pack(
            "<4s5H3I2H", b"PK\x03\x04", 20, flags, method, 0, 33, *sizes, len(name), len(self.local_extra)
        )
        return header + name + self.local_extra + self.packed_data + self.descriptor

    def central(self, offset: int) -> bytes:
        """Write the entry of the directory."""
        at = offset if self.offset is None else self.offset
        lengths = (len(self.name), len(self.central_extra), 0, self.disk, 0, self.attributes, at)
        made_by = 0x031E  # by Unix, version 3.0
        header = struct.pack(
            "<4s6H3I5H2I", b"PK\x01\x02", made_by, 20, self.flags, self.method, 0, 33, *self.sizes, *lengths
        )
        return header + self.name + self.central_extra


@dataclass(frozen=True, kw_only=True)
class Ending:
    """The end record. Whatever is None is written truthfully."""

    entries: int | None = None
    size: int | None = None
    offset: int | None = None
    disk: int = 0
    comment: bytes = b""
    stated_comment: int | None = None
    zip64: bytes = field(default=b"")
    """Put between directory and end record."""
    before_directory: bytes = b""


def write_zip(entries: Sequence[Entry], ending: Ending | None = None) -> bytes:
    """Write a whole archive."""
    ending = ending or Ending()
    body, directory = b"", b""
    for entry in entries:
        body += entry.before
        directory += entry.central(len(body))
        body += entry.local()
    body += ending.before_directory
    count = len(entries) if ending.entries is None else ending.entries
    size = len(directory) if ending.size is None else ending.size
    offset = len(body) if ending.offset is None else ending.offset
    comment = len(ending.comment) if ending.stated_comment is None else ending.stated_comment
    end = struct.pack("<4s4H2IH", b"PK\x05\x06", ending.disk, ending.disk, count, count, size, offset, comment)
    return body + directory + ending.zip64 + end + ending.comment


def end64(entries: int, size: int, offset: int) -> bytes:
    """Write a truthful ZIP64 end record and its locator for an archive whose directory is there."""
    record = struct.pack("<4sQ2H2I4Q", b"PK\x06\x06", 44, 45, 45, 0, 0, entries, entries, size, offset)
    return record + struct.pack("<4sIQI", b"PK\x06\x07", 0, offset + size, 1)


def zip64_extra(*values: int) -> bytes:
    """Write a ZIP64 extra field."""
    return struct.pack(f"<HH{len(values)}Q", ZIP64_EXTRA, 8 * len(values), *values)


def with_descriptor(entry: Entry, *, signed: bool = True, wide: bool = False) -> Entry:
    """Move checksum and sizes behind the data, as streaming writers do."""
    form = "<IQQ" if wide else "<III"
    descriptor = (b"PK\x07\x08" if signed else b"") + struct.pack(form, *entry.sizes)
    return replace(entry, flags=entry.flags | DESCRIPTOR, descriptor=descriptor)
