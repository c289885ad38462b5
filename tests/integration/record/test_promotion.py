"""A blob's file, once there, is not replaced by another one, in both shapes."""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from server.blobs import Blobs
from server.services import Services


def _file(services: Services, sha256: str) -> tuple[Path, int]:
    path = services.blobs.local_path(sha256)
    return path, path.stat().st_ino


def test_the_same_bytes_again_leave_the_file_that_is_there(services: Services) -> None:
    """A process that was allowed this one file still may read it; nothing is left where bytes arrive."""
    sha256 = services.blobs.put_bytes(b"predictions")
    before = _file(services, sha256)
    assert services.blobs.put_bytes(b"predictions") == sha256
    assert _file(services, sha256) == before
    assert before[0].stat().st_nlink == 1
    assert list(services.blobs.incoming.iterdir()) == []


def test_bytes_come_again_after_their_file_was_deleted(services: Services) -> None:
    """What was swept can be put once more."""
    sha256 = services.blobs.put_bytes(b"predictions")
    services.blobs.delete(sha256)
    assert services.blobs.put_bytes(b"predictions") == sha256
    assert services.blobs.read(sha256) == b"predictions"


@dataclasses.dataclass
class _Overtaken:
    """Chunks of a blob, while another process copies the same one and is done first."""

    stream: Callable[[str], Iterator[bytes]]
    other: Callable[[str], Path]
    inode: int = 0

    def __call__(self, sha256: str) -> Iterator[bytes]:
        """Yield the first chunk, let the other one copy all, and go on."""
        chunks = self.stream(sha256)
        yield next(chunks)
        if not self.inode:
            self.inode = -1  # the copy of the other one is not overtaken again
            self.inode = self.other(sha256).stat().st_ino
        yield from chunks


@pytest.mark.parametrize("shape", ["scale_out"])
def test_two_processes_that_copy_a_blob_at_once_leave_the_first_copy(
    services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever comes second uses the copy of the first, which may already be being read."""
    blobs: Blobs = services.blobs
    assert blobs.cache is not None
    sha256 = blobs.put_bytes(b"predictions")
    overtaken = _Overtaken(blobs.stream, blobs.local_path)
    monkeypatch.setattr(blobs, "stream", overtaken)
    assert blobs.local_path(sha256).stat().st_ino == overtaken.inode
    assert [path.name for path in blobs.cache.iterdir()] == [sha256]
