"""Files that killed processes leave behind: deleted once they are old, and never while a living process holds them.

A process that writes for long holds a lock on its file; the system gives it up when the process ends, however it ends.
"""

import fcntl
import os
import shutil
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path


def hold(descriptor: int) -> None:
    """Keep sweepers away from an open file of ours until it is closed; without locks its age alone protects it."""
    with suppress(OSError):
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def delete_unless_held(path: Path) -> bool:
    """Delete a file unless somebody holds it.

    Returns:
        False when it is held, or was gone already.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        # A shared lock meets every holder, too, and network file systems grant it on a file opened for reading.
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return False
    else:
        path.unlink(missing_ok=True)
        return True
    finally:
        os.close(descriptor)


def delete_old(folder: Path, *, grace_s: float, pattern: str = "*") -> int:
    """Delete what nobody wrote to for `grace_s` seconds and nobody holds, files and folders.

    Returns:
        How many were deleted; 0 when there is no such folder.
    """
    deadline = datetime.now(UTC).timestamp() - grace_s
    stale = [path for path in folder.glob(pattern) if _changed_at(path) < deadline]
    # Looked at once more: what is read from may have been touched since it was listed.
    return sum(
        _delete_folder(path) if path.is_dir() else delete_unless_held(path)
        for path in stale
        if _changed_at(path) < deadline
    )


def _delete_folder(path: Path) -> bool:
    shutil.rmtree(path, ignore_errors=True)
    return True


def _changed_at(path: Path) -> float:
    """Return when a file was last written to; a file that is gone meanwhile is as new as can be."""
    try:
        return path.stat().st_mtime
    except FileNotFoundError:
        return float("inf")
