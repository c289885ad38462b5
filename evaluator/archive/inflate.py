"""Unpacks one member in memory, never past the size the directory states."""

import zlib
from collections.abc import Callable
from typing import Protocol, cast

from evaluator.archive.end_record import Archive
from evaluator.archive.member import STORED, Member
from evaluator.codes import Code

_RAW_DEFLATE = -15


class _Inflater(Protocol):
    """What zlib and isal have in common."""

    @property
    def eof(self) -> bool: ...

    @property
    def unused_data(self) -> bytes: ...

    def decompress(self, data: bytes | memoryview, max_length: int, /) -> bytes: ...


def _fastest() -> tuple[Callable[[], _Inflater], type[Exception], Callable[[bytes], int]]:
    """Take inflater, its error and checksum from isal, twice as fast, where its wheel exists, else from zlib."""
    try:
        from isal import igzip_lib, isal_zlib  # noqa: PLC0415 - not there on every machine
    except ImportError:
        return lambda: zlib.decompressobj(_RAW_DEFLATE), zlib.error, zlib.crc32
    return (
        lambda: igzip_lib.IgzipDecompressor(flag=igzip_lib.DECOMP_DEFLATE),
        cast("type[Exception]", igzip_lib.error),
        isal_zlib.crc32,
    )


_new_inflater, _InflateError, _crc32 = _fastest()


class MemberError(Exception):
    """A member cannot be read. Never leaves this package's callers: it becomes an entry of the report."""

    def __init__(self, code: Code, detail: str) -> None:
        """Remember what to report."""
        super().__init__(detail)
        self.code = code
        self.detail = detail


def unpack(archive: Archive | memoryview, member: Member) -> bytes:
    """Unpack a member and check its size and checksum; of a view nothing is copied that is packed.

    Raises:
        MemberError: when the data is damaged, not of the stated size or not of the stated checksum.
    """
    packed = archive[member.start : member.start + member.packed_bytes]
    data = bytes(packed) if member.method == STORED else _inflate(packed, member.expanded_bytes)
    if _crc32(data) != member.crc32:
        raise MemberError(Code.CHECKSUM_MISMATCH, f"CRC-32 {_crc32(data):08x} instead of {member.crc32:08x}")
    return data


def _inflate(packed: bytes | memoryview, expanded_bytes: int) -> bytes:
    """Inflate to exactly the stated size: one byte more is asked for and must not come."""
    inflater = _new_inflater()
    try:
        data = inflater.decompress(packed, expanded_bytes + 1)
    except _InflateError as error:
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
