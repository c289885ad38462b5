"""A disk that can be filled: a small file system of our own where the kernel lets us mount one, else an imitation."""

import ctypes
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.faults import points
from tests.faults.points import Strike
from tests.services.processes import wait_until

SIZE_BYTES = 256 << 20

FILLED_S = 60.0
"""A moment at which nobody writes comes within this."""

_CLONE_NEWNS = 0x00020000


def can_mount() -> bool:
    """Move to a mount namespace of our own, whose mounts end with us; False where that takes rights we lack.

    Call it before any thread or process is started.
    """
    if os.geteuid() != 0 or not sys.platform.startswith("linux"):
        return False
    return ctypes.CDLL(None).unshare(_CLONE_NEWNS) == 0 and _succeeds("mount", "--make-rprivate", "/")


class Disk:
    """The file system under one folder."""

    def __init__(self, folder: Path, faults: Path, *, mount: bool) -> None:
        """Mount a file system in memory on `folder`, or imitate one that is full at the points in `faults`."""
        self._folder = folder
        self._faults = faults
        folder.mkdir(parents=True, exist_ok=True)
        self.is_real = mount and _succeeds(
            "mount", "-t", "tmpfs", "-o", f"size={SIZE_BYTES},mode=0700", "tmpfs", str(folder)
        )

    @contextmanager
    def full(self) -> Iterator[None]:
        """Leave no room until the end of the block; the imitation fails the next upload only."""
        if not self.is_real:
            points.arm(self._faults, "fsynced", Strike(no_space=True))
            try:
                yield
            finally:
                points.disarm(self._faults, "fsynced")
            return
        try:
            # When something is written between the two, the size is refused.
            wait_until(lambda: self._resize(self._used_bytes()), timeout_s=FILLED_S, what="a full disk")
            yield
        finally:
            self._resize(SIZE_BYTES)

    def _used_bytes(self) -> int:
        status = os.statvfs(self._folder)
        return (status.f_blocks - status.f_bfree) * status.f_frsize

    def _resize(self, size_bytes: int) -> bool:
        # At least a page: the kernel takes 0 for "no limit".
        return _succeeds("mount", "-o", f"remount,size={max(size_bytes, 4096)}", str(self._folder))

    def close(self) -> None:
        """Take the file system away."""
        if self.is_real:
            _succeeds("umount", "--lazy", str(self._folder))


def _succeeds(*command: str) -> bool:
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False
