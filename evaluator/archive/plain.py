"""Recognises plain archives at a glance: files one after the other, described twice alike, and nothing else.

Most packers write just that. What `framing.py` demands entry by entry is proved here for all entries at once, several
times as fast; of any other archive nothing is said. Section numbers refer to PKWARE's APPNOTE.TXT 6.3.10.
"""

import numpy as np
from numpy.typing import NDArray

from evaluator.archive.directory import FLAG_UTF8
from evaluator.archive.end_record import CENTRAL_SIGNATURE, LOCAL_SIGNATURE, Archive, Directory
from evaluator.archive.member import DEFLATED, STORED, UNIX_TYPES, Member
from evaluator.limits import Limits

_HEAD = np.dtype(
    [
        *[("maker", "<u2"), ("version", "<u2"), ("flags", "<u2"), ("method", "<u2"), ("time", "<u2"), ("date", "<u2")],
        *[("crc32", "<u4"), ("packed", "<u4"), ("expanded", "<u4"), ("name", "<u2"), ("extra", "<u2")],
        *[("comment", "<u2"), ("disk", "<u2"), ("internal", "<u2"), ("attributes", "<u4"), ("offset", "<u4")],
    ]
)
"""An entry of the directory between its signature and its name (4.3.12)."""
_ALIKE = slice(2, 28)
"""What a member's own header says, too, from version to length of the extra fields (4.3.7)."""
_ENTRY_BYTES = len(CENTRAL_SIGNATURE) + _HEAD.itemsize
_LOCAL_BYTES = 30
_SATURATED = 0xFFFFFFFF


def plain_members(
    archive: Archive, directory: Directory, limits: Limits, *, checked_elsewhere: bool
) -> tuple[Member, ...]:
    """Locate the members of an archive that is plain.

    Args:
        archive: all bytes of the zip.
        directory: where its directory is.
        limits: caps on entries and sizes.
        checked_elsewhere: believe the directory without looking at the members' own headers.

    Returns:
        All members, folders included, when there is nothing wrong with any but perhaps its name; none when that takes
        a closer look.
    """
    if directory.size > directory.entries * (_ENTRY_BYTES + limits.name_bytes):
        return ()  # and is not read at once: extra fields and comments may be of any length
    entries = archive[directory.offset : directory.end].split(CENTRAL_SIGNATURE)
    heads = b"".join([entry[: _HEAD.itemsize] for entry in entries])
    if entries.pop(0) or not entries or not len(entries) == directory.entries == len(heads) / _HEAD.itemsize:
        return ()
    table = np.frombuffer(heads, dtype=_HEAD)
    names = [entry[_HEAD.itemsize :] for entry in entries]
    lengths = np.array([len(name) for name in names])
    starts = table["offset"].astype(np.int64) + _LOCAL_BYTES + lengths
    if not (
        all(map(bytes.isascii, names))
        and (table["name"] == lengths).all()
        and _are_plain(table, limits)
        and not any(name.endswith(b"/") and size for name, size in zip(names, table["expanded"].tolist(), strict=True))
        and _fill(table, starts, directory.offset)
        and (checked_elsewhere or _agree(archive, entries, table["offset"].tolist()))
    ):
        return ()
    method, crc32, packed, expanded = (table[name].tolist() for name in ("method", "crc32", "packed", "expanded"))
    decoded = (name.decode("ascii") for name in names)
    return tuple(map(Member._make, zip(decoded, method, crc32, starts.tolist(), packed, expanded, strict=True)))


def _are_plain(table: NDArray[np.void], limits: Limits) -> bool:
    """Tell whether no entry has anything unusual or too large (4.4)."""
    method, packed, expanded = table["method"], table["packed"], table["expanded"]
    plain = (table["flags"] & ~np.uint16(FLAG_UTF8)) == 0
    plain &= (method == DEFLATED) | ((method == STORED) & (packed == expanded))
    plain &= (
        table["name"] <= limits.name_bytes
    )  # also where nobody looks at names: what is done with them may cost more
    plain &= (table["extra"] == 0) & (table["comment"] == 0) & (table["disk"] == 0)
    plain &= np.isin(table["attributes"] >> 16 & 0xF000, list(UNIX_TYPES))
    plain &= (
        (packed < _SATURATED) & (table["offset"] < _SATURATED) & (expanded <= min(limits.file_bytes, _SATURATED - 1))
    )
    return bool(plain.all())


def _fill(table: NDArray[np.void], starts: NDArray[np.int64], end: int) -> bool:
    """Tell whether the members, in the order of the directory, fill the file from its first byte to the directory."""
    ends = starts + table["packed"]
    return bool((table["offset"] == np.concatenate([[0], ends[:-1]])).all() and ends[-1] == end)


def _agree(archive: Archive, entries: list[bytes], offsets: list[int]) -> bool:
    """Tell whether each member's own header says what the directory says."""
    headers = (LOCAL_SIGNATURE + entry[_ALIKE] + entry[_HEAD.itemsize :] for entry in entries)
    return all(archive[at : at + len(header)] == header for header, at in zip(headers, offsets, strict=True))
