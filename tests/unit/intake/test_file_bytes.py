"""Reading a file in place gives what its bytes give."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

from hypothesis import given
from hypothesis import strategies as st

from evaluator.archive.file_bytes import FileBytes


@contextmanager
def file_of(data: bytes) -> Iterator[FileBytes]:
    """Write a file and open it."""
    with tempfile.TemporaryFile() as file:
        file.write(data)
        file.flush()
        yield FileBytes(file.fileno())


places = st.none() | st.integers(-220_000, 220_000)


@given(
    data=st.binary(max_size=10_000).map(lambda data: data * 20), parts=st.lists(st.tuples(places, places), max_size=20)
)
def test_parts_are_those_of_bytes(data: bytes, parts: list[tuple[int | None, int | None]]) -> None:
    """Whatever was read before, every slice is that of the same bytes in memory."""
    with file_of(data) as file:
        assert len(file) == len(data)
        for start, stop in parts:
            assert file[start:stop] == data[start:stop]


@given(data=st.lists(st.sampled_from([b"PK", b"P", b"K", b"\x05", bytes(300)])).map(b"".join))
def test_the_last_mark_is_found(data: bytes) -> None:
    """The last place of a mark is that in the same bytes in memory."""
    with file_of(data) as file:
        assert file.rfind(b"PK\x05") == data.rfind(b"PK\x05")


def test_a_mark_across_two_blocks_is_found() -> None:
    """A mark that begins at the end of one block of the search and ends in the next is found."""
    data = bytearray(3 << 20)
    at = len(data) - (1 << 20) - 2  # the search reads from the end in blocks of 1 MiB: this straddles the first border
    data[at : at + 4] = b"PK\x05\x06"
    with file_of(bytes(data)) as file:
        assert file.rfind(b"PK\x05\x06") == at


def test_large_parts_are_read_whole() -> None:
    """A part larger than what is read ahead comes whole, also after small ones."""
    data = os.urandom(100_000)
    with file_of(data) as file:
        assert file[10:20] == data[10:20]
        assert file[10:90_000] == data[10:90_000]
