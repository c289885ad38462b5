"""What is known of a file in an archive before it is unpacked."""

from typing import NamedTuple

STORED, DEFLATED = 0, 8
"""The methods taken (4.4.5)."""
UNIX_TYPES = {0x0000: "none", 0x4000: "folder", 0x8000: "regular file"}
"""The kinds of files taken, by the type bits of a Unix mode."""


class Member(NamedTuple):
    """One file of an archive: where its packed bytes are and what must come out of them."""

    name: str
    method: int
    """`STORED` or `DEFLATED`."""
    crc32: int
    start: int
    """Offset of the packed bytes in the archive."""
    packed_bytes: int
    expanded_bytes: int
