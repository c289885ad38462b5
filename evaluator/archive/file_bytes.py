"""A file's bytes, read where they are asked for.

A memory map would do the same in fewer lines, but counts as resident memory whatever the kernel reads ahead: nearly
the whole archive, in the web process that only looks at its headers.
"""

import os

_AHEAD_BYTES = 1 << 16
"""Headers and members follow each other closely; reading so much at least spares most of the calls."""
_BLOCK_BYTES = 1 << 20


class FileBytes:
    """All bytes of an open regular file; behaves like `bytes` as far as reading a zip needs it."""

    def __init__(self, descriptor: int) -> None:
        """Take the size the file has at this moment; bytes added later do not exist."""
        self._descriptor = descriptor
        self._size = os.fstat(descriptor).st_size
        self._window_at = 0
        self._window = b""

    def __len__(self) -> int:
        """Count the bytes."""
        return self._size

    def __getitem__(self, part: slice) -> bytes:
        """Read a part; beyond the end there is nothing, as with `bytes`."""
        start, stop, _ = part.indices(self._size)
        if stop <= start:
            return b""
        if start < self._window_at or stop > self._window_at + len(self._window):
            if stop - start > _AHEAD_BYTES:
                return self._read(start, stop)
            self._window_at, self._window = start, self._read(start, min(self._size, start + _AHEAD_BYTES))
        return self._window[start - self._window_at : stop - self._window_at]

    def rfind(self, mark: bytes) -> int:
        """Find the last place of a mark; -1 when it is nowhere."""
        stop = self._size
        while stop > 0:
            start = max(0, stop - _BLOCK_BYTES)
            found = self._read(start, min(self._size, stop + len(mark) - 1)).rfind(mark)
            if found >= 0:
                return start + found
            stop = start
        return -1

    def _read(self, start: int, stop: int) -> bytes:
        """Read all of a part; the system may give it in pieces, and less when the file was cut meanwhile."""
        pieces = []
        while start < stop and (piece := os.pread(self._descriptor, stop - start, start)):
            pieces.append(piece)
            start += len(piece)
        return b"".join(pieces)
