"""An upload on its way to disk: streamed to a temporary file, hashed and capped while it arrives.

Memory stays flat whatever the size. A spooled file has no name anybody else knows; it is deleted unless it becomes
a blob, and what a killed process leaves behind is swept by age (`server.blobs.sweep_incoming`).
"""

import asyncio
import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from starlette.concurrency import run_in_threadpool

from server.api.errors import DiskFull, TooManyUploads, UploadTimeout, UploadTooLarge

_BUFFER_BYTES = 1 << 20
"""One hop to a thread for this much: small chunks would spend more on hopping than on writing."""

_PREFIX = "upload-"


@dataclass(frozen=True, slots=True, kw_only=True)
class UploadLimits:
    """What one web process takes."""

    max_bytes: int
    disk_floor_bytes: int
    """Free space that uploads never take."""
    concurrency: int = 8
    """Uploads at a time; one more is answered 503 with Retry-After."""
    idle_timeout_s: float = 30.0
    """Longest silence within a body."""
    min_rate_bytes_per_s: int = 1024
    """Slowest body, measured after the first `idle_timeout_s`; a slower client uses the resumable upload."""


@dataclass(frozen=True, slots=True)
class SpooledFile:
    """A whole upload in a temporary file."""

    path: Path
    sha256: str
    size_bytes: int


class Spool:
    """The file one upload is written to; an async context manager that deletes it in the end."""

    def __init__(self, folder: Path, limits: UploadLimits) -> None:
        """Make an empty temporary file in `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        descriptor, name = tempfile.mkstemp(prefix=_PREFIX, dir=folder)
        self.path = Path(name)
        self._file = os.fdopen(descriptor, "wb", buffering=0)
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
            DiskFull: The disk has no room.
        """
        self.size_bytes += len(chunk)
        if self.size_bytes > self._limits.max_bytes:
            raise UploadTooLarge(self._limits.max_bytes)
        self._buffer += chunk
        if len(self._buffer) >= _BUFFER_BYTES:
            await self._flush()

    async def finish(self) -> SpooledFile:
        """Write what is buffered and close the file."""
        await self._flush()
        await self._written()
        self._file.close()
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
        view = memoryview(block)
        try:
            while view:
                view = view[self._file.write(view) :]
        except OSError as error:
            raise DiskFull from error


class UploadGate:
    """Lets a bounded number of uploads in, and none when the disk is nearly full."""

    def __init__(self, folder: Path, limits: UploadLimits) -> None:
        """Spool into `folder` under `limits`."""
        self.folder = folder
        self.limits = limits
        self._open = 0

    @asynccontextmanager
    async def spool(self, announced_bytes: int | None) -> AsyncIterator[Spool]:
        """Open a spool for an upload of the announced size, refusing before its first byte is read.

        Raises:
            UploadTooLarge: It is announced beyond the cap.
            TooManyUploads: As many as allowed are under way.
            DiskFull: It would not leave the disk floor free.
        """
        self.check_room(announced_bytes)
        if self._open >= self.limits.concurrency:
            raise TooManyUploads
        self._open += 1
        try:
            async with Spool(self.folder, self.limits) as spool:
                yield spool
        finally:
            self._open -= 1

    def check_room(self, announced_bytes: int | None) -> None:
        """Refuse what is announced beyond the cap or would not leave the disk floor free."""
        if announced_bytes is not None and announced_bytes > self.limits.max_bytes:
            raise UploadTooLarge(self.limits.max_bytes)
        self.folder.mkdir(parents=True, exist_ok=True)
        if shutil.disk_usage(self.folder).free - (announced_bytes or 0) < self.limits.disk_floor_bytes:
            raise DiskFull


async def at_a_decent_pace(stream: AsyncIterator[bytes], limits: UploadLimits) -> AsyncIterator[bytes]:
    """Pass a body on, giving up on a client that stalls or trickles.

    Raises:
        UploadTimeout: Nothing came for `idle_timeout_s`, or on the whole less than `min_rate_bytes_per_s`.
        ClientDisconnect: The client is gone.
    """
    chunks = aiter(stream)
    started_s, received = time.monotonic(), 0
    while True:
        try:
            async with asyncio.timeout(limits.idle_timeout_s):
                chunk = await anext(chunks)
        except StopAsyncIteration:
            return
        except TimeoutError as error:
            raise UploadTimeout from error
        received += len(chunk)
        elapsed_s = time.monotonic() - started_s
        if elapsed_s > limits.idle_timeout_s and received < limits.min_rate_bytes_per_s * elapsed_s:
            raise UploadTimeout
        yield chunk
