"""Nine named points in the life of a submission where a test can strike, and the sabotage of single safeguards.

The processes of the fault programme are the real ones; only their entry modules (web_app.py, worker_app.py beside
this file) call `install`. Production code knows nothing of it. A point is armed by a file of its name in the folder
that the environment names; the first process to pass takes the file, so each armed point strikes once.

    in a web process                                    in a worker process
    received    the whole body is there                 claimed      a worker holds the submission
    fsynced     it is flushed to the disk               parsed       the report of valid predictions is recorded
    promoted    it has its digest's name                scored       the scores are computed
    committed   the submission is a row                 commit_sent  the commit of the score has returned
    enqueued    its message is in the broker
"""

import errno
import functools
import json
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from server import blobs, lifecycle, submissions
from server.blobs import BucketBlobs, FolderBlobs
from server.queue import Queue
from server.services import Services

FOLDER_VARIABLE = "CS3D_TEST_FAULTS"
"""The folder in which points are armed; without it nothing ever strikes."""
COPIES_VARIABLE = "CS3D_TEST_COPIES"
"""How often every message is sent."""
CLOCK_VARIABLE = "CS3D_TEST_CLOCK_SHIFT_S"
"""By how much this process's clock is wrong."""

WEB_POINTS = ("received", "fsynced", "promoted", "committed", "enqueued")
WORKER_POINTS = ("claimed", "parsed", "scored", "commit_sent")
POINTS = WEB_POINTS + WORKER_POINTS


@dataclass(frozen=True, kw_only=True)
class Strike:
    """What happens at a point."""

    kill: tuple[int, ...] = ()
    """Processes to SIGKILL; negative: process groups; 0: the one that passes."""
    stop: bool = False
    """SIGSTOP the process that passes; somebody has to wake it."""
    no_space: bool = False
    """Fail as if the disk were full."""
    pause_s: float = 0.0


def arm(folder: Path, point: str, strike: Strike) -> None:
    """Let the next process that passes `point` be struck."""
    draft = folder / f".{point}"
    draft.write_text(json.dumps(asdict(strike)))
    draft.replace(folder / point)


def disarm(folder: Path, point: str) -> bool:
    """Take the strike back; False when it has happened."""
    try:
        (folder / point).unlink()
    except FileNotFoundError:
        return False
    return True


def taken_by(folder: Path, point: str) -> list[int]:
    """List the processes that were struck at `point`."""
    return [int(path.name.split(".")[2]) for path in sorted(folder.glob(f"{point}.taken.*"))]


def reach(point: str) -> None:
    """Strike if this point is armed."""
    folder = os.environ.get(FOLDER_VARIABLE)
    if not folder or point not in _live_points:
        return
    taken = Path(folder) / f"{point}.taken.{os.getpid()}.{time.monotonic_ns()}"
    try:
        (Path(folder) / point).rename(taken)
    except FileNotFoundError:
        return
    _strike(Strike(**json.loads(taken.read_text())))


def _strike(strike: Strike) -> None:
    for target in strike.kill:
        try:
            os.kill(target or os.getpid(), signal.SIGKILL) if target >= 0 else os.killpg(-target, signal.SIGKILL)
        except ProcessLookupError:
            continue  # it died before we came
    if strike.stop:
        os.kill(os.getpid(), signal.SIGSTOP)
    if strike.no_space:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    time.sleep(strike.pause_s)


_live_points: set[str] = set()


def install(points: Iterable[str]) -> None:
    """Put the points and whatever the environment asks for around the real functions of this process."""
    from tests.faults import sabotage  # noqa: PLC0415 - it builds on this module

    _live_points.update(points)
    wrap(FolderBlobs, "put_file", before="received", after="promoted")
    wrap(blobs, "_flush", after="fsynced")
    wrap(BucketBlobs, "put_file", before="fsynced")  # flushing is the store's own affair there
    wrap(BucketBlobs, "put_file", before="received", after="promoted")
    wrap(Queue, "enqueue", after="enqueued")
    _reach_after_commit()
    _send_copies(int(os.environ.get(COPIES_VARIABLE, "1")))
    _shift_clock(float(os.environ.get(CLOCK_VARIABLE, "0")))
    sabotage.install()


def wrap(owner: Any, name: str, *, before: str | None = None, after: str | None = None) -> None:
    """Reach points before and after a function."""
    original: Callable[..., Any] = getattr(owner, name)

    @functools.wraps(original)
    def wrapped(*arguments: Any, **named: Any) -> Any:
        if before:
            with blobs.no_room_is_said():
                reach(before)
        result = original(*arguments, **named)
        if after:
            reach(after)
        return result

    setattr(owner, name, wrapped)


def _reach_after_commit() -> None:
    """Reach the points that stand for a commit once it has returned."""
    original = Services.transaction

    @contextmanager
    def transaction(self: Services) -> Iterator[Any]:
        with original(self) as session:
            yield session
            done = session.info.get("done", ())
        for point in done:
            reach(point)

    Services.transaction = transaction  # type: ignore[method-assign]  # that is what this module is for
    _note(submissions, "receive", "committed")
    _note(lifecycle, "claim", "claimed")
    _note(lifecycle, "validated", "parsed")
    _note(lifecycle, "record_score", "commit_sent")


def _note(module: Any, name: str, point: str) -> None:
    """Remember in the session which point its commit reaches."""
    original: Callable[..., Any] = getattr(module, name)

    @functools.wraps(original)
    def noted(session: Any, *arguments: Any, **named: Any) -> Any:
        result = original(session, *arguments, **named)
        session.info.setdefault("done", []).append(point)
        return result

    setattr(module, name, noted)


def _send_copies(copies: int) -> None:
    original = Queue.enqueue

    @functools.wraps(original)
    def enqueue(self: Queue, *arguments: Any, **named: Any) -> bool:
        taken = [original(self, *arguments, **named) for _ in range(copies)]
        return all(taken)

    Queue.enqueue = enqueue  # type: ignore[method-assign]  # that is what this module is for


def _shift_clock(shift_s: float) -> None:
    if shift_s:
        real = time.time
        time.time = lambda: real() + shift_s
