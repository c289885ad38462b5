"""The file a resumable upload arrives in: appended part by part, locked by whoever writes."""

import fcntl
import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from server.api.errors import UploadBusy
from server.blobs import no_room_is_said

_CHUNK_BYTES = 1 << 20


class PartFile:
    """Bytes that are still arriving; everything here blocks, so call it on a thread. A full disk is `StorageFull`."""

    def __init__(self, descriptor: int) -> None:
        """Write to an open, locked file."""
        self._descriptor = descriptor
        self.end = 0

    def begin(self, offset: int) -> int:
        """Go on at `offset`, or where the file ends if that is earlier; cut off what is beyond.

        Returns:
            Where the next byte goes.
        """
        self.end = min(offset, os.fstat(self._descriptor).st_size)
        os.ftruncate(self._descriptor, self.end)
        return self.end

    def append(self, data: bytes) -> None:
        """Write bytes at the end."""
        view = memoryview(data)
        with no_room_is_said():
            while view:
                written = os.pwrite(self._descriptor, view, self.end)
                self.end += written
                view = view[written:]

    def cut(self, offset: int) -> None:
        """Drop everything from `offset` on."""
        os.ftruncate(self._descriptor, offset)
        self.end = offset

    def make_safe(self) -> None:
        """Flush to the disk."""
        with no_room_is_said():
            os.fsync(self._descriptor)

    def sha256(self) -> str:
        """Digest the whole file."""
        digest = hashlib.sha256()
        offset = 0
        while block := os.pread(self._descriptor, _CHUNK_BYTES, offset):
            digest.update(block)
            offset += len(block)
        return digest.hexdigest()


@contextmanager
def locked(path: Path) -> Iterator[PartFile]:
    """Open a part file, making it when it is missing, for one writer at a time over all processes of the machine.

    Raises:
        UploadBusy: Somebody else is writing.
        StorageFull: The disk has no room for another file.
    """
    with no_room_is_said():
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UploadBusy from error
        yield PartFile(descriptor)
    finally:
        os.close(descriptor)
