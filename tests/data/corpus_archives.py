"""The corpus of archives: each accepted or refused for one reason. The expected image names are `IMAGES`."""

import io
import struct
import zipfile
from collections.abc import Iterator
from dataclasses import replace

from tests.data.corpus_zip import (
    STORED,
    UTF8,
    Ending,
    Entry,
    end64,
    with_descriptor,
    write_zip,
    zip64_extra,
)

IMAGES = ("berlin_000000_000019", "berlin_000001_000019")
EMPTY = b'{"objects": []}'
BOX = (
    b'{"objects": [{"label": "car", "score": 0.9, "2d": {"amodal": [900, 400, 100, 80], "modal": [900, 400, 90, 80]},'
    b' "3d": {"center": [20.5, 1.25, 0.8], "dimensions": [4.5, 1.8, 1.5], "rotation": [1, 0, 0, 0]}}]}'
)
Case = tuple[str, str, bytes]
"""Name, codes joined by "+" (none for silence), bytes."""


def file_name_of(number: int, suffix: str = "pred") -> bytes:
    """Name the file of an image."""
    return f"{IMAGES[number]}_{suffix}.json".encode()


FIRST = Entry(name=file_name_of(0), data=BOX)
SECOND = Entry(name=file_name_of(1), data=EMPTY)
PAIR = (FIRST, SECOND)


def added(extra: Entry) -> bytes:
    """Add a member to a good archive."""
    return write_zip([*PAIR, extra])


def renamed(name: bytes) -> bytes:
    """Give the second member another name."""
    return write_zip([FIRST, replace(SECOND, name=name)])


def changed(**changes: object) -> bytes:
    """Change one thing about the second member."""
    return write_zip([FIRST, replace(SECOND, **changes)])  # type: ignore[arg-type]


def ended(**changes: object) -> bytes:
    """Change one thing about the end record."""
    return write_zip(PAIR, Ending(**changes))  # type: ignore[arg-type]


def directory_span() -> tuple[int, int]:
    """Measure the good archive's directory: its size and offset."""
    offset = sum(len(entry.local()) for entry in PAIR)
    return sum(len(entry.central(0)) for entry in PAIR), offset


def _python(*, compression: int, seekable: bool = True) -> bytes:
    """Write the good archive with the standard library."""
    buffer = io.BytesIO()
    target: io.BytesIO = buffer if seekable else _Pipe(buffer)
    with zipfile.ZipFile(target, "w", compression) as archive:
        for entry in PAIR:
            archive.writestr(zipfile.ZipInfo(entry.name.decode(), (2026, 1, 1, 0, 0, 0)), entry.data, compression)
    return buffer.getvalue()


class _Pipe(io.BytesIO):
    """A stream without positions, like a pipe."""

    def __init__(self, target: io.BytesIO) -> None:
        super().__init__()
        self._target = target

    def write(self, data: object) -> int:
        return self._target.write(data)  # type: ignore[arg-type]

    def seekable(self) -> bool:
        return False

    def tell(self) -> int:
        raise OSError("a pipe has no position")

    def seek(self, *_: int) -> int:
        raise OSError("a pipe has no position")


def accepted() -> Iterator[Case]:
    """Yield what honest programs write."""
    size, offset = directory_span()
    folder = Entry(name=b"predictions/", method=STORED, attributes=0o040755 << 16 | 0x10)
    stamped = struct.pack("<HHBI", 0x5455, 5, 1, 1_700_000_000)
    ids = struct.pack("<HHBBIBI", 0x7875, 11, 1, 4, 1000, 4, 1000)
    ntfs = struct.pack("<HHIHHQQQ", 0x000A, 32, 0, 1, 24, 1, 1, 1)
    apple = struct.pack("<HHII", 0x5855, 8, 1_700_000_000, 1_700_000_000)

    yield "python_deflated", "", _python(compression=zipfile.ZIP_DEFLATED)
    yield "python_stored", "", _python(compression=zipfile.ZIP_STORED)
    yield "python_streamed", "", _python(compression=zipfile.ZIP_DEFLATED, seekable=False)
    yield "plain_deflated", "", write_zip(PAIR)
    yield "plain_stored", "", write_zip([replace(entry, method=STORED) for entry in PAIR])
    yield "mixed_methods", "", write_zip([FIRST, replace(SECOND, method=STORED)])
    placed = [replace(e, name=folder.name + e.name, local_extra=stamped + ids, central_extra=ids) for e in PAIR]
    yield "info_zip", "", write_zip([folder, *placed])
    streamed = [
        replace(
            with_descriptor(e, wide=True),
            local_sizes=(0, 0xFFFFFFFF, 0xFFFFFFFF),
            local_extra=zip64_extra(0, 0),
        )
        for e in PAIR
    ]
    yield "info_zip_from_pipe", "", write_zip(streamed)
    debris = [
        Entry(name=b"__MACOSX/._" + FIRST.name, data=b"\0\5\x16\7" + bytes(40)),
        Entry(name=b".DS_Store", data=b"\0\0\0\1Bud1"),
        Entry(name=b"predictions/._" + SECOND.name, data=b"\0\5\x16\7"),
    ]
    yield (
        "macos_ditto",
        "",
        write_zip([with_descriptor(replace(e, local_extra=apple, central_extra=apple)) for e in (*PAIR, *debris)]),
    )
    yield "seven_zip", "", write_zip([replace(e, central_extra=ntfs, attributes=0x20) for e in PAIR])
    yield "descriptor_signed", "", write_zip([with_descriptor(e) for e in PAIR])
    yield "descriptor_unsigned", "", write_zip([with_descriptor(e, signed=False) for e in PAIR])
    yield "descriptor_wide", "", write_zip([with_descriptor(e, wide=True) for e in PAIR])
    yield "descriptor_wide_unsigned", "", write_zip([with_descriptor(e, wide=True, signed=False) for e in PAIR])
    yield "descriptor_and_sizes", "", write_zip([replace(with_descriptor(e), local_sizes=e.sizes) for e in PAIR])
    yield "descriptor_utf8_flag", "", write_zip([with_descriptor(replace(e, flags=UTF8)) for e in PAIR])
    yield "zip64_end_record", "", ended(zip64=end64(2, size, offset))
    yield (
        "zip64_end_record_saturated",
        "",
        ended(zip64=end64(2, size, offset), entries=0xFFFF, size=0xFFFFFFFF, offset=0xFFFFFFFF),
    )
    yield "zip64_sizes", "", write_zip([FIRST, zip64_sized(SECOND)])
    yield "archive_comment", "", ended(comment=b"made by hand")
    yield "reversed_directory", "", _reversed_directory()
    yield "wrapper_folder", "", write_zip([replace(e, name=b"my method v2/" + e.name) for e in PAIR])
    yield "city_folders", "", write_zip([replace(e, name=b"pred/test/berlin/" + e.name) for e in PAIR])
    yield "utf8_folder", "", write_zip([replace(e, name="größe/".encode() + e.name, flags=UTF8) for e in PAIR])
    yield "utf8_folder_unflagged", "", write_zip([replace(e, name="größe/".encode() + e.name) for e in PAIR])
    yield "cp437_folder", "", write_zip([replace(e, name="größe/".encode("cp437") + e.name) for e in PAIR])
    yield "dot_folder", "", write_zip([replace(e, name=b"./" + e.name) for e in PAIR])
    yield "long_suffix", "", write_zip([FIRST, replace(SECOND, name=file_name_of(1, "pred_of_net_v1.2"))])
    yield "results_file", "results_file_ignored", added(Entry(name=b"out/results.json", data=b"not even JSON"))


def zip64_sized(entry: Entry) -> Entry:
    """Move one member's sizes into ZIP64 fields."""
    crc32, packed, expanded = entry.sizes
    extra = zip64_extra(expanded, packed)
    return replace(
        entry,
        packed=entry.packed_data,
        stated_packed=0xFFFFFFFF,
        stated_expanded=0xFFFFFFFF,
        local_sizes=(crc32, 0xFFFFFFFF, 0xFFFFFFFF),
        central_extra=extra,
        local_extra=extra,
    )


def _reversed_directory() -> bytes:
    """List the members in another order than they stand in."""
    first, second = FIRST.local(), SECOND.local()
    directory = SECOND.central(len(first)) + FIRST.central(0)
    end = struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, 2, 2, len(directory), len(first + second), 0)
    return first + second + directory + end
