"""The framing check: finds where each member's bytes are and refuses whatever is not a plain, honest zip.

It never inflates. Not `zipfile`: the standard library takes members that share bytes, bytes before and between
members, and headers that contradict each other. Section numbers refer to PKWARE's APPNOTE.TXT 6.3.10.
"""

import struct
from collections.abc import Sequence

from evaluator.archive.directory import FLAG_UTF8, Entry, read_directory, widen
from evaluator.archive.end_record import LOCAL_SIGNATURE, Archive, Directory, find_directory
from evaluator.archive.framing_error import FramingError
from evaluator.archive.member import DEFLATED, STORED, UNIX_TYPES, Member
from evaluator.archive.names import check_names, is_passed_over
from evaluator.archive.plain import plain_members
from evaluator.codes import Code
from evaluator.findings import Findings
from evaluator.limits import Limits

_LOCAL = struct.Struct("<4sHHHHHIIIHH")  # 4.3.7
_DESCRIPTOR_SIGNATURE = b"PK\x07\x08"
_LARGEST_32 = 0xFFFFFFFF
_FLAG_ENCRYPTED = 0x0001 | 0x0040 | 0x2000  # 4.4.4: bit 0, bit 6 strong encryption, bit 13 masked headers
_FLAG_DESCRIPTOR = 0x0008
_FLAG_PATCHED = 0x0020
_METHODS = {
    1: "shrink",
    6: "implode",
    9: "deflate64",
    12: "bzip2",
    14: "lzma",
    93: "zstd",
    95: "xz",
    98: "ppmd",
    99: "aes",
}


def check_framing(
    archive: Archive, limits: Limits, findings: Findings, *, checked_elsewhere: bool = False
) -> tuple[Member, ...]:
    """Check the framing of a whole archive in time linear in its directory.

    Args:
        archive: all bytes of the zip.
        limits: caps on entries and sizes.
        findings: receives every problem; without an error in it afterwards the archive is sound.
        checked_elsewhere: somebody else checks the same archive and throws away what is made of an unsound one, so that
            of a plain one only the members are looked for.

    Returns:
        The members that are files, in the order of the directory; none when the archive cannot be read at all.
    """
    if len(archive) > limits.archive_bytes:
        findings.add(Code.ARCHIVE_TOO_LARGE, found=f"{len(archive)} bytes", expected=f"at most {limits.archive_bytes}")
        return ()
    try:
        directory = find_directory(archive)
        if directory.entries > limits.entries:
            findings.add(Code.TOO_MANY_ENTRIES, found=f"{directory.entries}", expected=f"at most {limits.entries}")
            return ()
        plain = plain_members(archive, directory, limits, checked_elsewhere=checked_elsewhere)
        entries = () if plain else tuple(read_directory(archive, directory))
    except FramingError as error:
        findings.add(error.code, detail=error.detail)
        return ()
    if not (plain and checked_elsewhere):
        check_names((entry.name for entry in plain or entries if entry.name is not None), limits, findings)
    _check_sizes(plain or entries, len(archive), limits, findings)
    for entry in entries:
        _check_entry(entry, limits, findings)
    located = plain or _locate_members(archive, entries, directory, findings)
    members = tuple(member for member in located if not member.name.endswith("/"))
    if not findings.error_count and all(is_passed_over(member.name) for member in members):
        findings.add(Code.EMPTY_ARCHIVE, found="folders and system files at most")
    return members


def _check_sizes(entries: Sequence[Entry | Member], archive_bytes: int, limits: Limits, findings: Findings) -> None:
    """Hold the stated sizes of all members together against the caps."""
    expanded = sum(entry.expanded_bytes for entry in entries)
    if expanded > limits.expanded_bytes:
        findings.add(
            Code.EXPANDED_TOO_LARGE, found=f"{expanded} bytes", expected=f"at most {limits.expanded_bytes} bytes"
        )
    elif expanded > limits.ratio_floor_bytes and expanded > limits.ratio * archive_bytes:
        findings.add(
            Code.RATIO_TOO_HIGH, found=f"{expanded / archive_bytes:.0f} : 1", expected=f"at most {limits.ratio} : 1"
        )


def _check_entry(entry: Entry, limits: Limits, findings: Findings) -> None:
    """Check what one entry of the directory says by itself."""
    if entry.name is None:
        findings.add(Code.UNDECODABLE_NAME, file=entry.shown_name)
    if entry.flags & _FLAG_ENCRYPTED:
        findings.add(Code.ENCRYPTED, file=entry.shown_name)
    patched = entry.flags & _FLAG_PATCHED
    if patched or entry.method not in (STORED, DEFLATED):
        method = "patched data" if patched else _METHODS.get(entry.method, str(entry.method))
        findings.add(Code.UNSUPPORTED_COMPRESSION, file=entry.shown_name, found=method, expected="deflate or store")
    if entry.unix_type not in UNIX_TYPES:
        findings.add(Code.LINK_OR_DEVICE, file=entry.shown_name)
    if entry.expanded_bytes > limits.file_bytes:
        found, expected = f"{entry.expanded_bytes} bytes", f"at most {limits.file_bytes}"
        findings.add(Code.FILE_TOO_LARGE, file=entry.shown_name, found=found, expected=expected)
    if entry.method == STORED and entry.packed_bytes != entry.expanded_bytes:
        found, expected = f"{entry.packed_bytes} bytes", f"{entry.expanded_bytes}"
        findings.add(Code.SIZE_MISMATCH, file=entry.shown_name, found=found, expected=expected)
    if entry.expanded_bytes and entry.raw_name.endswith(b"/"):
        findings.add(Code.FOLDER_WITH_DATA, file=entry.shown_name)


def _locate_members(
    archive: Archive, entries: tuple[Entry, ...], directory: Directory, findings: Findings
) -> tuple[Member, ...]:
    """Walk the file from its first byte to the directory: every byte must belong to exactly one member."""
    by_offset = sorted(range(len(entries)), key=lambda index: entries[index].header_offset)
    bounds = [*(entries[index].header_offset for index in by_offset), directory.offset]
    if bounds[0]:
        findings.add(Code.PREFIX_BYTES, detail=f"the first member starts at byte {bounds[0]}")
    crowded = [
        n for n, index in enumerate(by_offset) if not bounds[n] + _LOCAL.size <= bounds[n + 1] <= directory.offset
    ]
    for number in crowded:
        detail = f"its header at byte {bounds[number]} reaches past byte {min(bounds[number + 1], directory.offset)}"
        findings.add(Code.OVERLAPPING_MEMBERS, file=entries[by_offset[number]].shown_name, detail=detail)
    if crowded:
        return ()
    starts = [0] * len(entries)
    for index, end in zip(by_offset, bounds[1:], strict=True):
        try:
            starts[index] = _data_start(archive, entries[index], end)
        except FramingError as error:
            findings.add(error.code, file=entries[index].shown_name, detail=error.detail)
    return tuple(
        Member(entry.shown_name, entry.method, entry.crc32, start, entry.packed_bytes, entry.expanded_bytes)
        for entry, start in zip(entries, starts, strict=True)
    )


def _data_start(archive: Archive, entry: Entry, end: int) -> int:
    """Check a member's own header against the directory and find its packed bytes, which end at `end` (4.3.7)."""
    at = entry.header_offset
    (signature, _, flags, method, _, _, crc32, packed, expanded, name_length, extra_length) = _LOCAL.unpack(
        archive[at : at + _LOCAL.size]
    )
    name_at = at + _LOCAL.size
    extra_at = name_at + name_length
    start: int = extra_at + extra_length
    if signature != LOCAL_SIGNATURE:
        raise FramingError(Code.LOCAL_HEADER_MISMATCH, f"there is no header at byte {at}")
    if start + entry.packed_bytes > end:
        raise FramingError(Code.OVERLAPPING_MEMBERS, f"its {entry.packed_bytes} bytes reach past byte {end}")
    if archive[name_at:extra_at] != entry.raw_name:
        raise FramingError(Code.LOCAL_HEADER_MISMATCH, "the names differ")
    if extra_length:
        expanded, packed = widen(archive[extra_at:start], (expanded, packed))
    _compare(entry, flags=flags, method=method, stated=(crc32, packed, expanded))
    _check_rest(entry, flags, archive[start + entry.packed_bytes : min(end, start + entry.packed_bytes + 32)])
    return start


def _compare(entry: Entry, *, flags: int, method: int, stated: tuple[int, int, int]) -> None:
    """Compare method, encryption, checksum and sizes; with a descriptor behind the data the latter may be 0 (4.4.4)."""
    expected = (entry.crc32, entry.packed_bytes, entry.expanded_bytes)
    if method != entry.method:
        raise FramingError(Code.LOCAL_HEADER_MISMATCH, f"method {method} here, {entry.method} in the directory")
    if (flags ^ entry.flags) & _FLAG_ENCRYPTED:
        raise FramingError(Code.LOCAL_HEADER_MISMATCH, "only one of the headers says that it is encrypted")
    if (flags ^ entry.flags) & FLAG_UTF8 and not entry.raw_name.isascii():
        raise FramingError(Code.LOCAL_HEADER_MISMATCH, "only one of the headers says that the name is UTF-8")
    late = bool(flags & _FLAG_DESCRIPTOR)
    for here, there in zip(stated, expected, strict=True):
        if here != there and not (late and here == 0):
            raise FramingError(Code.LOCAL_HEADER_MISMATCH, f"checksum and sizes {stated} here, {expected} there")


def _check_rest(entry: Entry, flags: int, rest: bytes) -> None:
    """Demand that a data descriptor, and nothing else, follows the data if and only if it is announced (4.3.9)."""
    expected = {b""}
    if flags & _FLAG_DESCRIPTOR:
        bare = {
            struct.pack(f"<I{width}{width}", entry.crc32, entry.packed_bytes, entry.expanded_bytes)
            for width in ("IQ" if max(entry.packed_bytes, entry.expanded_bytes) <= _LARGEST_32 else "Q")
        }
        expected = bare | {_DESCRIPTOR_SIGNATURE + descriptor for descriptor in bare}
    if rest in expected:
        return
    if rest[:16] in expected or rest[:24] in expected or not flags & _FLAG_DESCRIPTOR:
        raise FramingError(Code.HIDDEN_BYTES, "bytes follow its data")
    raise FramingError(Code.LOCAL_HEADER_MISMATCH, "the descriptor after its data contradicts the directory")
