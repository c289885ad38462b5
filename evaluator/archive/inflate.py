"""Unpacks one member in memory, never past the size the directory states."""

import importlib
import zlib
from typing import Protocol, cast

from evaluator.archive.end_record import Archive
from evaluator.archive.member import STORED, Member
from evaluator.codes import Code


class _Inflater(Protocol):
    """What zlib and isal have in common."""

    eof: bool
    unused_data: bytes
    unconsumed_tail: bytes

    def decompress(self, data: bytes, max_length: int, /) -> bytes: ...


class _Zlib(Protocol):
    """The part of the zlib module used here."""

    error: type[Exception]

    def decompressobj(self, wbits: int) -> _Inflater: ...

    def crc32(self, data: bytes, /) -> int: ...


def _fastest() -> _Zlib:
    """Take isal, twice as fast, where its wheel exists, else zlib."""
    try:
        return cast("_Zlib", importlib.import_module("isal.isal_zlib"))
    except ImportError:
        return cast("_Zlib", zlib)


_ZLIB = _fastest()
_RAW_DEFLATE = -15


class MemberError(Exception):
    """A member cannot be read. Never leaves this package's callers: it becomes an entry of the report."""

    def __init__(self, code: Code, detail: str) -> None:
        """Remember what to report."""
        super().__init__(detail)
        self.code = code
        self.detail = detail


def unpack(archive: Archive, member: Member) -> bytes:
    """Unpack a member and check its size and checksum.

    Raises:
        MemberError: when the data is damaged, not of the stated size or not of the stated checksum.
    """
    packed = archive[member.start : member.start + member.packed_bytes]
    data = packed if member.method == STORED else _inflate(packed, member.expanded_bytes)
    if _ZLIB.crc32(data) != member.crc32:
        raise MemberError(Code.CHECKSUM_MISMATCH, f"CRC-32 {_ZLIB.crc32(data):08x} instead of {member.crc32:08x}")
    return data


def _inflate(packed: bytes, expanded_bytes: int) -> bytes:
    """Inflate to exactly the stated size: one byte more is asked for and must not come."""
    inflater = _ZLIB.decompressobj(_RAW_DEFLATE)
    try:
        data = inflater.decompress(packed, expanded_bytes + 1)
    except _ZLIB.error as error:
        raise MemberError(Code.DAMAGED_MEMBER, str(error)) from None
    if len(data) > expanded_bytes:
        raise MemberError(Code.SIZE_MISMATCH, f"more than the stated {expanded_bytes} bytes come out")
    if not inflater.eof:
        raise MemberError(Code.DAMAGED_MEMBER, f"its data ends after {len(data)} of {expanded_bytes} bytes")
    if len(data) < expanded_bytes:
        raise MemberError(Code.SIZE_MISMATCH, f"{len(data)} bytes come out, {expanded_bytes} are stated")
    if inflater.unused_data:
        raise MemberError(Code.DAMAGED_MEMBER, f"{len(inflater.unused_data)} bytes follow its compressed data")
    return data
