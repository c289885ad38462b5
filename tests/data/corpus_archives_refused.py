"""The archives that are refused, each for one reason."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace

from tests.data.corpus_archives import (
    BOX,
    EMPTY,
    FIRST,
    PAIR,
    SECOND,
    Case,
    added,
    changed,
    directory_span,
    ended,
    file_name_of,
    renamed,
    zip64_sized,
)
from tests.data.corpus_zip import STORED, SYMLINK, UTF8, Entry, deflate, end64, with_descriptor, write_zip, zip64_extra


def refused() -> Iterator[Case]:
    """Yield everything else."""
    yield from _no_archives()
    yield from _false_ends()
    yield from _false_zip64()
    yield from _false_headers()
    yield from _shared_bytes()
    yield from _bad_names()
    yield from _bad_members()
    yield from _wrong_files()


def _no_archives() -> Iterator[Case]:
    good = write_zip(PAIR)
    yield "empty_file", "not_a_zip", b""
    yield "text", "not_a_zip", b"hello\n"
    yield "json", "not_a_zip", BOX
    yield "gzip", "not_a_zip", b"\x1f\x8b\x08\x00" + bytes(30)
    yield "rar", "not_a_zip", b"Rar!\x1a\x07\x00" + bytes(30)
    yield "seven_zip_format", "not_a_zip", b"7z\xbc\xaf\x27\x1c" + bytes(30)
    yield "tar", "not_a_zip", (bytes(257) + b"ustar\x0000").ljust(1024, b"\0")
    yield "zeros", "not_a_zip", bytes(100)
    yield "only_signature", "truncated_archive", b"PK\x03\x04"
    yield "no_members", "empty_archive", write_zip([])
    yield "only_folders", "empty_archive", write_zip([Entry(name=b"predictions/", method=STORED)])
    yield "only_debris", "empty_archive", write_zip([Entry(name=b"__MACOSX/._x.json", data=b"x")])
    yield "truncated_in_member", "truncated_archive", good[:60]
    yield "truncated_in_directory", "truncated_archive", good[: -len(FIRST.central(0))]
    yield "truncated_in_end_record", "truncated_archive", good[:-5]
    yield "first_byte_lost", "prefix_bytes", good[1:]


def _false_ends() -> Iterator[Case]:
    size, offset = directory_span()
    good = write_zip(PAIR)
    yield "prefix_script", "prefix_bytes", b"#!/bin/sh\nexit\n" + good
    yield "prefix_unadjusted", "prefix_bytes", b"PK\x03\x04junk" + good
    yield "prefix_adjusted", "prefix_bytes", write_zip([replace(FIRST, before=b"PK00"), SECOND])
    yield "suffix_newline", "suffix_bytes", good + b"\n"
    yield "suffix_long", "suffix_bytes", good + bytes(70_000)
    yield "suffix_second_archive", "prefix_bytes", good + good
    yield "comment_cut", "truncated_archive", ended(comment=b"abc", stated_comment=9)
    yield "comment_overlong", "suffix_bytes", ended(comment=b"abcdef", stated_comment=2)
    yield "comment_with_end_record", "prefix_bytes", ended(comment=b"xx" + write_zip([]))
    yield "comment_with_directory", "hidden_bytes", ended(comment=_second_directory())
    yield "entries_too_few", "entry_count_mismatch", ended(entries=1)
    yield "entries_too_many", "entry_count_mismatch", ended(entries=3)
    yield "entries_none", "entry_count_mismatch", ended(entries=0)
    yield "too_many_entries", "too_many_entries", ended(entries=30_000)
    yield "other_disk", "multi_disk", ended(disk=1)
    yield "member_on_other_disk", "multi_disk", changed(disk=3)
    yield "directory_past_end", "damaged_directory", ended(offset=offset + 1000)
    yield "directory_size_small", "damaged_directory", ended(size=size - 1, offset=offset + 1)
    yield "directory_early", "prefix_bytes", ended(offset=offset - 1)
    yield "directory_overwritten", "damaged_directory", good.replace(b"PK\x01\x02", b"PK\x01\x03", 1)
    yield "gap_before_end_record", "hidden_bytes", ended(zip64=b"hidden", size=size)
    yield "gap_before_directory", "hidden_bytes", ended(before_directory=b"hidden")


def _second_directory() -> bytes:
    """Write a comment that holds a directory of its own, so that readers may disagree on which one counts."""
    size, offset = directory_span()
    directory = FIRST.central(0)
    end = struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, 1, 1, len(directory), offset + size + 22, 0)
    return directory + end


def _false_zip64() -> Iterator[Case]:
    size, offset = directory_span()
    record = end64(2, size, offset)
    yield "zip64_no_locator", "zip64_mismatch", ended(entries=0xFFFF)
    yield "zip64_other_count", "zip64_mismatch", ended(zip64=end64(3, size, offset))
    yield "zip64_other_offset", "zip64_mismatch", ended(zip64=end64(2, size, offset)[:48] + bytes(8) + record[56:])
    yield "zip64_locator_astray", "zip64_mismatch", ended(zip64=record[:-12] + struct.pack("<QI", 7, 1))
    yield "zip64_record_cut", "zip64_mismatch", ended(zip64=record[:4] + struct.pack("<Q", 4000) + record[12:])
    yield "zip64_two_disks", "multi_disk", ended(zip64=record[:-4] + struct.pack("<I", 2))
    yield "zip64_many_entries", "too_many_entries", ended(zip64=end64(2**40, size, offset), entries=0xFFFF)
    yield "zip64_size_missing", "zip64_mismatch", changed(stated_expanded=0xFFFFFFFF)
    yield (
        "zip64_field_short",
        "zip64_mismatch",
        changed(stated_expanded=0xFFFFFFFF, stated_packed=0xFFFFFFFF, central_extra=zip64_extra(15)),
    )
    yield "zip64_field_twice", "zip64_mismatch", changed(central_extra=zip64_extra(15) + zip64_extra(15))
    yield "zip64_field_contradicts", "zip64_mismatch", changed(central_extra=zip64_extra(2**33))
    yield (
        "zip64_local_differs",
        "local_header_mismatch",
        write_zip([FIRST, replace(zip64_sized(SECOND), local_extra=zip64_extra(5, 5))]),
    )
    yield (
        "zip64_huge_size",
        "expanded_too_large+file_too_large",
        changed(
            stated_expanded=0xFFFFFFFF,
            central_extra=zip64_extra(2**50),
            local_sizes=(zlib.crc32(EMPTY), len(deflate(EMPTY)), 0xFFFFFFFF),
            local_extra=zip64_extra(2**50, len(deflate(EMPTY))),
        ),
    )
    yield "extra_field_overlong", "damaged_directory", changed(central_extra=struct.pack("<HH", 0x5455, 500))


def _false_headers() -> Iterator[Case]:
    sizes = SECOND.sizes
    yield "local_name_differs", "local_header_mismatch", changed(local_name=file_name_of(1, "evil"))
    yield "local_method_differs", "local_header_mismatch", changed(local_method=STORED)
    yield "local_crc_differs", "local_header_mismatch", changed(local_sizes=(1, *sizes[1:]))
    yield "local_size_differs", "local_header_mismatch", changed(local_sizes=(sizes[0], sizes[1], 3))
    yield "local_packed_differs", "local_header_mismatch", changed(local_sizes=(sizes[0], 3, sizes[2]))
    yield "local_only_encrypted", "local_header_mismatch", changed(local_flags=1)
    yield (
        "local_utf8_differs",
        "local_header_mismatch",
        changed(name="ü/".encode("cp437") + SECOND.name, local_flags=UTF8),
    )
    good, at = write_zip(PAIR), len(FIRST.local())
    yield "local_header_overwritten", "local_header_mismatch", good[:at] + b"PK\x03\x05" + good[at + 4 :]
    descriptor = with_descriptor(SECOND)
    yield "descriptor_missing", "local_header_mismatch", write_zip([FIRST, replace(descriptor, descriptor=b"")])
    yield (
        "descriptor_wrong_crc",
        "local_header_mismatch",
        write_zip([FIRST, replace(descriptor, descriptor=b"PK\x07\x08" + struct.pack("<III", 1, *sizes[1:]))]),
    )
    yield "descriptor_unannounced", "hidden_bytes", changed(descriptor=descriptor.descriptor)
    yield (
        "descriptor_and_more",
        "hidden_bytes",
        write_zip([FIRST, replace(descriptor, descriptor=descriptor.descriptor + b"hidden")]),
    )
    yield "gap_between_members", "hidden_bytes", changed(before=b"hidden")
    yield "encrypted", "encrypted", changed(flags=1)
    yield "strongly_encrypted", "encrypted", changed(flags=0x41)
    yield "masked_headers", "encrypted", changed(flags=0x2000)
    for name, method in (("bzip2", 12), ("lzma", 14), ("deflate64", 9), ("zstd", 93), ("aes", 99), ("implode", 6)):
        yield f"method_{name}", "unsupported_compression", changed(method=method, packed=SECOND.data)

    yield "method_patched", "unsupported_compression", changed(flags=0x20)


def _shared_bytes() -> Iterator[Case]:
    yield "overlap_same_member", "overlapping_members", _twice()
    yield "overlap_quoted", "overlapping_members", _quoted_overlap()
    yield (
        "overlap_into_directory",
        "overlapping_members",
        changed(
            stated_packed=len(SECOND.packed_data) + 10, local_sizes=(SECOND.sizes[0], len(SECOND.packed_data) + 10, 15)
        ),
    )
    yield "offset_in_directory", "overlapping_members", changed(offset=len(FIRST.local() + SECOND.local()) + 4)
    yield "offset_far_away", "overlapping_members", changed(offset=2**31)
    megabyte = deflate(bytes(2**20))
    yield "bomb_lying_size", "size_mismatch", changed(packed=megabyte)
    yield "bomb_one_file", "file_too_large", changed(packed=megabyte, stated_expanded=17 * 2**20)
    bombs = [
        Entry(name=f"x/berlin_{n:06d}_000019_p.json".encode(), packed=b"\3\0", stated_expanded=15 * 2**20)
        for n in range(5)
    ]
    yield "bomb_ratio", "ratio_too_high", write_zip(bombs)
    many = [replace(bombs[0], name=f"x/berlin_{n:06d}_000019_p.json".encode()) for n in range(140)]
    yield "bomb_total", "expanded_too_large", write_zip(many)


def _twice() -> bytes:
    """List one member under two names: the second entry has no bytes of its own."""
    first = FIRST.local()
    directory = FIRST.central(0) + replace(FIRST, name=SECOND.name).central(0)
    return first + directory + struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, 2, 2, len(directory), len(first), 0)


def _quoted_overlap() -> bytes:
    """Let the first member's deflate data quote the second member's header and go on into its data."""
    inner = SECOND.local()
    header = inner[: -len(SECOND.packed_data)]
    quoting = b"\0" + struct.pack("<HH", len(header), len(header) ^ 0xFFFF) + header
    outer = replace(FIRST, data=header + EMPTY, packed=quoting + SECOND.packed_data)
    body = outer.local()
    directory = outer.central(0) + SECOND.central(len(body) - len(inner))
    return body + directory + struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, 2, 2, len(directory), len(body), 0)


def _bad_names() -> Iterator[Case]:
    name = SECOND.name
    for case, code, bad in (
        ("name_absolute", "absolute_name", b"/" + name),
        ("name_parent", "parent_name", b"../" + name),
        ("name_parent_inside", "parent_name", b"a/../../" + name),
        ("name_backslash", "backslash_name", b"pred\\" + name),
        ("name_parent_backslash", "backslash_name", b"..\\" + name),
        ("name_network_share", "backslash_name", b"\\\\host\\share\\" + name),
        ("name_drive", "drive_name", b"C:/" + name),
        ("name_drive_relative", "drive_name", b"c:" + name),
        ("name_nul", "control_character_name", name + b"\0.txt"),
        ("name_newline", "control_character_name", b"a\n/" + name),
        ("name_escape", "control_character_name", b"\x1b[31m/" + name),
        ("name_delete", "control_character_name", b"\x7f/" + name),
        ("name_c1_control", "control_character_name", "\x85/".encode() + name),
        ("name_empty", "empty_name", b""),
        ("name_empty_part", "empty_name", b"a//" + name),
        ("name_long", "name_too_long", b"a" * 1100 + b"/" + name),
    ):
        yield case, code, renamed(bad)
    yield "name_not_utf8", "undecodable_name", changed(name=b"\xff\xfe/" + name, flags=UTF8)
    yield "name_twice", "duplicate_name", added(SECOND)
    yield "name_case_collision", "colliding_names", added(replace(SECOND, name=name.upper()))
    composed, decomposed = "é/".encode(), "e\N{COMBINING ACUTE ACCENT}/".encode()
    yield (
        "name_nfc_collision",
        "colliding_names",
        write_zip([FIRST, *(replace(SECOND, name=part + name, flags=UTF8) for part in (composed, decomposed))]),
    )


def _bad_members() -> Iterator[Case]:
    yield "symlink", "link_or_device", changed(attributes=SYMLINK, data=b"/etc/passwd", method=STORED)
    for kind, mode in (("device", 0o060644), ("terminal", 0o020644), ("pipe", 0o010644), ("socket", 0o140644)):
        yield kind, "link_or_device", changed(attributes=mode << 16)
    yield "folder_with_data", "folder_with_data", added(Entry(name=b"pred/", data=b"data"))
    yield "nested_zip", "nested_archive", added(Entry(name=b"more.zip", data=write_zip([])))
    yield "nested_tar", "nested_archive", added(Entry(name=b"more.TAR.gz", data=b"x"))
    yield "nested_in_disguise", "nested_archive", changed(data=write_zip(PAIR))
    yield "crc_wrong", "checksum_mismatch", changed(stated_crc32=1)
    yield "crc_wrong_stored", "checksum_mismatch", changed(stated_crc32=1, method=STORED)
    yield "size_too_small", "size_mismatch", changed(stated_expanded=3)
    yield "size_too_large", "size_mismatch", changed(stated_expanded=30)
    yield "size_stored_differs", "size_mismatch", changed(method=STORED, stated_expanded=30)
    yield "deflate_garbage", "damaged_member", changed(packed=b"\xff" * 20)
    yield "deflate_cut", "damaged_member", changed(packed=SECOND.packed_data[:-3])
    yield "deflate_empty", "damaged_member", changed(packed=b"")
    yield "deflate_with_rest", "damaged_member", changed(packed=SECOND.packed_data + b"hidden")


def _wrong_files() -> Iterator[Case]:
    yield "image_missing", "missing_image", write_zip([FIRST])
    yield "image_unknown", "unknown_image", added(Entry(name=b"bonn_000000_000019_pred.json", data=EMPTY))
    yield "image_twice", "duplicate_image", added(replace(SECOND, name=b"b/" + SECOND.name))
    yield "image_twice_suffix", "duplicate_image", added(replace(SECOND, name=file_name_of(1, "other")))
    yield "image_misspelt", "missing_image+unknown_image", renamed(b"berlin_00001_000019_pred.json")
    yield "image_without_suffix", "missing_image+unknown_image", renamed(b"berlin_000001_000019.json")
    yield "image_in_capitals", "missing_image+unknown_image", renamed(b"Berlin_000001_000019_pred.json")
    yield "file_text", "unexpected_file", added(Entry(name=b"README.txt", data=b"hello"))
    yield "file_capital_suffix", "missing_image+unexpected_file", renamed(b"berlin_000001_000019_pred.JSON")
    yield (
        "only_results",
        "empty_archive+results_file_ignored",
        write_zip([Entry(name=b"results.json", data=b"{}")]),
    )
    yield "only_text", "empty_archive+unexpected_file", write_zip([Entry(name=b"README.txt", data=b"hello")])
    yield "json_broken_inside", "invalid_json", changed(data=EMPTY[:-1])
