"""Caps on what a submission may contain, checked before the bytes they bound are read."""

import msgspec

MIB = 1024 * 1024


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """Caps of one server. Whatever exceeds one is refused with the code named after it."""

    archive_bytes: int = 512 * MIB
    """The zip as uploaded."""
    entries: int = 20_000
    """Members of the zip, folders included; files of a folder."""
    expanded_bytes: int = 2048 * MIB
    """All members together after inflating."""
    file_bytes: int = 16 * MIB
    """One member after inflating: 1000 generously indented boxes take 1 MiB."""
    ratio: int = 50
    """Expanded over packed size of the whole zip; indented JSON of predictions reaches 15."""
    ratio_floor_bytes: int = 64 * MIB
    """The ratio is only looked at when more than this comes out: small zips of empty images pack well."""
    name_bytes: int = 1024
    """One member's name."""
    json_depth: int = 32
    """Arrays and objects inside each other; predictions need 5."""
    explained_bytes: int = 256 * MIB
    """Files that are looked at closely because something is wrong with them, together; the rest is only counted."""
    boxes_per_image: int = 1000
    """Boxes of all classes in one file."""


DEFAULT_LIMITS = Limits()

ANY_SIZE = msgspec.structs.replace(DEFAULT_LIMITS, archive_bytes=2**62)
"""For archives whose size is capped elsewhere: a server refuses a longer upload than it takes while it arrives."""
