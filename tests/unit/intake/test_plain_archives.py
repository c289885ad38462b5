"""A plain archive is recognised at a glance only where the careful look finds the same."""

import struct
from pathlib import Path
from unittest.mock import patch

import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluator.archive import Member, check_framing, framing
from evaluator.archive.end_record import find_directory
from evaluator.archive.plain import plain_members
from evaluator.findings import Findings
from evaluator.limits import DEFAULT_LIMITS
from evaluator.report import Report
from tests.data.corpus_zip import STORED, Entry, write_zip
from tests.data.make_corpus import DATA

ARCHIVES = sorted((DATA / "archives").glob("*/*.zip"))
PLAIN = write_zip(
    [
        Entry(name=b"predictions/", method=STORED, attributes=0o040755 << 16),
        Entry(name=b"predictions/a_000000_000001_pred.json", data=b'{"objects": []}' * 3),
        Entry(name=b"b_000000_000002_pred.json", data=b"{}", method=STORED),
        Entry(name=b"c_000000_000003_pred.json", data=bytes(300), attributes=0),
    ]
)


def _checked(archive: bytes) -> tuple[tuple[Member, ...], Report]:
    findings = Findings()
    members = check_framing(archive, DEFAULT_LIMITS, findings)
    return members, findings.report(images_expected=0, images_found=0, boxes=0)


def _checked_carefully(archive: bytes) -> tuple[tuple[Member, ...], Report]:
    with patch.object(framing, "plain_members", return_value=()):
        return _checked(archive)


def test_the_glance_suffices_for_a_plain_archive() -> None:
    """Folders, stored and deflated files, with a Unix mode and without: all members are located at a glance."""
    members = plain_members(PLAIN, find_directory(PLAIN), DEFAULT_LIMITS, checked_elsewhere=False)
    assert [member.name.rpartition("/")[2][:1] for member in members] == ["", "a", "b", "c"]
    assert _checked(PLAIN) == _checked_carefully(PLAIN) == (members[1:], _checked(PLAIN)[1])


@pytest.mark.parametrize("checked_elsewhere", [False, True])
def test_a_name_that_is_too_long_takes_a_closer_look(checked_elsewhere: bool) -> None:  # noqa: FBT001 - a parameter
    """Even where names are left to another process: finding the image of one takes longer the longer it is."""
    for length, found in ((DEFAULT_LIMITS.name_bytes, 1), (DEFAULT_LIMITS.name_bytes + 1, 0)):
        short = [Entry(name=b"%d.json" % number, data=b"{}") for number in range(20)]
        archive = write_zip([Entry(name=b"_" * length, data=b"{}"), *short])
        members = plain_members(archive, find_directory(archive), DEFAULT_LIMITS, checked_elsewhere=checked_elsewhere)
        assert len(members) == 21 * found


@pytest.mark.parametrize("path", ARCHIVES, ids=lambda path: f"{path.parent.name}-{path.name.split('.')[0]}")
def test_both_looks_find_the_same_in_the_corpus(path: Path) -> None:
    """Members and report of every archive of the corpus do not depend on the glance."""
    archive = path.read_bytes()
    assert _checked(archive) == _checked_carefully(archive)


@given(
    changes=st.lists(
        st.tuples(st.integers(0, len(PLAIN) - 1), st.sampled_from([0, 1, 2, 8, 47, 80, 128, 255])), max_size=3
    )
)
def test_both_looks_find_the_same_in_a_damaged_archive(changes: list[tuple[int, int]]) -> None:
    """Whatever bytes of a plain archive are changed, members and report do not depend on the glance."""
    archive = bytearray(PLAIN)
    for at, value in changes:
        archive[at] = value
    assert _checked(bytes(archive)) == _checked_carefully(bytes(archive))


class _Watched(bytes):
    """Bytes that remember the longest part asked for."""

    longest = 0

    def __getitem__(self, part: slice) -> bytes:  # type: ignore[override]
        found = super().__getitem__(part)
        self.longest = max(self.longest, len(found))
        return found


def test_a_directory_of_any_length_is_not_read_at_once() -> None:
    """Extra fields make a directory as long as the archive may be; it is then read entry by entry."""
    padding = struct.pack("<HH", 0x7777, 60_000) + bytes(60_000)
    entries = [Entry(name=f"{number}_pred.json".encode(), central_extra=padding) for number in range(4)]
    archive = _Watched(write_zip(entries))
    members, _ = _checked(archive)
    assert len(members) == 4
    assert archive.longest < 2 * 65_536
