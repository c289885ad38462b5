"""An upload on its way to disk: streamed to a temporary file, hashed and capped while it arrives.

Memory stays flat whatever the size. A spooled file has no name anybody else knows; it is deleted unless it becomes
a blob, and held until then: what a killed process leaves behind is swept (`server/api/sweeping.py`), a live file never.
"""

import asyncio
import hashlib
import os
import shutil
import time
import uuid
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from starlette.concurrency import run_in_threadpool

from server.api.errors import DiskFull, TooManyOwnUploads, TooManyUploads, UploadTimeout, UploadTooLarge
from server.blobs import no_room_is_said
from server.leftovers import hold

_BUFFER_BYTES = 1 << 20
"""One hop to a thread for this much: small chunks would spend more on hopping than on writing."""

FORM_OVERHEAD_BYTES = 2 << 20
"""What a form may hold besides its archive: boundaries, headers, the other fields, and whatever stands after the end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UploadLimits:
    """What one web process takes."""

    max_bytes: int
    disk_floor_bytes: int
    """Free space that uploads never take."""
    concurrency: int = 16
    """Uploads at a time; one more waits, and is then answered 503 with Retry-After."""
    concurrency_of_user: int = 3
    """Uploads of one user at a time, so that nobody holds every place."""
    patience_s: float = 10.0
    """How long an upload waits for a place before its body is read: a burst of small ones is taken one after another."""
    idle_timeout_s: float = 30.0
    """Longest silence within a body."""
    min_rate_bytes_per_s: int = 16 * 1024
    """Slowest body, in each `idle_timeout_s`: 512 MiB in nine hours. Slower clients use the resumable upload."""


@dataclass(frozen=True, slots=True)
class SpooledFile:
    """A whole upload in a temporary file."""

    path: Path
    sha256: str
    size_bytes: int


class Spool:
    """The file one upload is written to; an async context manager that deletes it in the end."""

    def __init__(self, folder: Path, limits: UploadLimits) -> None:
        """Make an empty temporary file in `folder`.

        Raises:
            StorageFull: The disk has no room for it.
        """
        self.path = folder / f"upload-{uuid.uuid4().hex}"
        with no_room_is_said():
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        self._file = os.fdopen(descriptor, "wb", buffering=0)
        hold(descriptor)
        self._limits = limits
        self._digest = hashlib.sha256()
        self._buffer = bytearray()
        self._writing: list[asyncio.Task[None]] = []
        self.size_bytes = 0

    async def __aenter__(self) -> Self:
        """Give the spool itself."""
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Delete the file; a blob store that took it over has moved or copied it."""
        try:
            # A thread that still writes must not meet another file under this descriptor.
            await asyncio.gather(*self._writing, return_exceptions=True)
        finally:
            self._file.close()
            with suppress(FileNotFoundError):
                self.path.unlink()

    async def write(self, chunk: bytes) -> None:
        """Append bytes.

        Raises:
            UploadTooLarge: The cap is passed; the bytes beyond it are never written.
            StorageFull: The disk has no room.
        """
        self.size_bytes += len(chunk)
        if self.size_bytes > self._limits.max_bytes:
            raise UploadTooLarge(self._limits.max_bytes)
        self._buffer += chunk
        if len(self._buffer) >= _BUFFER_BYTES:
            await self._flush()

    async def finish(self) -> SpooledFile:
        """Write what is buffered; the file stays held until it is deleted or a blob."""
        await self._flush()
        await self._written()
        return SpooledFile(self.path, self._digest.hexdigest(), self.size_bytes)

    async def _flush(self) -> None:
        """Let a thread hash and write what is buffered, while the next block arrives."""
        await self._written()
        block, self._buffer = self._buffer, bytearray()
        self._writing.append(asyncio.create_task(run_in_threadpool(self._store, block)))

    async def _written(self) -> None:
        """Wait for the block before; its error, if any, is raised here."""
        await asyncio.gather(*self._writing)
        self._writing.clear()

    def _store(self, block: bytearray) -> None:
        self._digest.update(block)
        check_floor(self.path.parent, self._limits, len(block))
        view = memoryview(block)
        with no_room_is_said():
            while view:
                view = view[self._file.write(view) :]


class UploadGate:
    """Lets a bounded number of uploads in, few of them of one user, and none when the disk is nearly full."""

    def __init__(self, folder: Path, limits: UploadLimits) -> None:
        """Spool into `folder` under `limits`."""
        self.folder = folder
        self.limits = limits
        self._open: Counter[int] = Counter()
        self._freed = asyncio.Event()

    @asynccontextmanager
    async def spool(self, user_id: int, announced_bytes: int | None) -> AsyncIterator[Spool]:
        """Open a spool for an upload of the announced size, refusing before its first byte is read.

        Raises:
            UploadTooLarge: It is announced beyond the cap.
            TooManyUploads: As many as allowed are under way, in all or of this user.
            StorageFull: It would not leave the disk floor free.
        """
        self.check_room(announced_bytes)
        async with self.place(user_id), Spool(self.folder, self.limits) as spool:
            yield spool

    @asynccontextmanager
    async def place(self, user_id: int) -> AsyncIterator[None]:
        """Take one of the places for uploads, for as long as the block lasts.

        Raises:
            TooManyOwnUploads: The user has as many as one user may have.
            TooManyUploads: All are taken.
        """
        await self._wait_for_place(user_id)
        self._open[user_id] += 1
        try:
            yield
        finally:
            self._open[user_id] -= 1
            self._open += Counter()  # forgets the users at zero
            self._freed.set()
            self._freed = asyncio.Event()

    async def _wait_for_place(self, user_id: int) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(self.limits.patience_s):
                while self._refusal(user_id) is not None:
                    await self._freed.wait()
        refusal = self._refusal(user_id)
        if refusal is not None:
            raise refusal

    def _refusal(self, user_id: int) -> TooManyUploads | None:
        if self._open[user_id] >= self.limits.concurrency_of_user:
            return TooManyOwnUploads(self.limits.concurrency_of_user)
        return TooManyUploads() if self._open.total() >= self.limits.concurrency else None

    def check_room(self, announced_bytes: int | None) -> None:
        """Refuse what is announced beyond the cap or would not leave the disk floor free.

        Raises:
            UploadTooLarge: It is announced beyond the cap.
            StorageFull: It would not leave the disk floor free.
        """
        if announced_bytes is not None and announced_bytes > self.limits.max_bytes:
            raise UploadTooLarge(self.limits.max_bytes)
        with no_room_is_said():
            self.folder.mkdir(parents=True, exist_ok=True)
        check_floor(self.folder, self.limits, announced_bytes or 0)


def check_floor(folder: Path, limits: UploadLimits, more_bytes: int) -> None:
    """Refuse bytes that would not leave the disk floor free; asked again for each block, as others write, too.

    Raises:
        StorageFull: They would not.
    """
    if shutil.disk_usage(folder).free - more_bytes < limits.disk_floor_bytes:
        raise DiskFull


async def at_a_decent_pace(stream: AsyncIterator[bytes], limits: UploadLimits) -> AsyncIterator[bytes]:
    """Pass a body on, giving up on a client that stalls or trickles. Only the time spent waiting for it counts.

    Raises:
        UploadTimeout: Nothing came for `idle_timeout_s`, or in such a time less than `min_rate_bytes_per_s`.
        ClientDisconnect: The client is gone.
    """
    chunks = aiter(stream)
    waited_s, received = 0.0, 0
    while True:
        since_s = time.monotonic()
        try:
            async with asyncio.timeout(limits.idle_timeout_s):
                chunk = await anext(chunks)
        except StopAsyncIteration:
            return
        except TimeoutError as error:
            raise UploadTimeout from error
        waited_s += time.monotonic() - since_s
        received += len(chunk)
        if waited_s > limits.idle_timeout_s:
            if received < limits.min_rate_bytes_per_s * waited_s:
                raise UploadTimeout
            waited_s, received = 0.0, 0
        yield chunk
