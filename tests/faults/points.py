"""Nine named points in the life of a submission where a test can strike.

The processes of the fault programme are the real ones; only their entry modules (web_app.py, worker_app.py beside
this file) put the points in place (hooks.py). Production code knows nothing of it. A point is armed by a file of its
name in the folder that the environment names; the first process to pass takes the file, so each armed point strikes
once. Before it strikes it leaves an account of the strike there.

    in a web process                                    in a worker process
    received    the whole body is in a temporary file   claimed      a worker holds the submission
    fsynced     it is flushed to the disk               parsed       the report of valid predictions is recorded
    promoted    it has its digest's name                scored       the scores are computed
    committed   the commit of the row has returned      commit_sent  the commit of the score is sent, not answered
    enqueued    its message is in the broker

Two of them lie elsewhere in one shape. A bucket flushes by itself: there `fsynced` is the moment before the upload to it,
after the framing and the quota were checked. SQLite's commit is a call without a wire: there `commit_sent` is the
moment after it returned.
"""

import contextlib
import errno
import json
import os
import signal
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil

FOLDER_VARIABLE = "CS3D_TEST_FAULTS"
"""The folder in which points are armed; without it nothing ever strikes."""

WEB_POINTS = ("received", "fsynced", "promoted", "committed", "enqueued")
WORKER_POINTS = ("claimed", "parsed", "scored", "commit_sent")
POINTS = WEB_POINTS + WORKER_POINTS

SCORING_PROGRAM = "tests.faults.scoring_process"
"""What the scoring processes of the programme run; their command line tells them from pool processes."""


@dataclass(frozen=True, kw_only=True)
class Strike:
    """What happens at a point."""

    kill: tuple[int, ...] = ()
    """Processes to SIGKILL; negative: process groups."""
    kill_children_of: int = 0
    """A worker whose children are killed too, as they are at the moment of the strike; 0: none."""
    scoring: bool = False
    """Of its children kill the scoring processes; else the others, which are its pool processes."""
    stop: bool = False
    """SIGSTOP the process that passes; somebody has to wake it."""
    hold: bool = False
    """Let only the thread that passes stand still, until somebody lets it go."""
    no_space: bool = False
    """Fail as if the disk were full."""
    pause_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Struck:
    """The account of a strike."""

    file: Path
    process: int
    """The one that passed."""
    killed: tuple[int, ...]
    """What there was to kill; negative: process groups."""
    about: str
    """The submission that the process was at, where the point knows."""


def arm(folder: Path, point: str, strike: Strike) -> None:
    """Let the next process that passes `point` be struck."""
    draft = folder / f".{point}"
    draft.write_text(json.dumps(asdict(strike)))
    draft.replace(folder / point)


def disarm(folder: Path, point: str) -> None:
    """Take the strike back unless it has happened."""
    (folder / point).unlink(missing_ok=True)


def armed(folder: Path) -> list[str]:
    """List the points that nobody has passed since they were armed."""
    return [point for point in POINTS if (folder / point).exists()]


def strikes(folder: Path, point: str) -> list[Struck]:
    """Give the accounts of the strikes at `point`, oldest first; one process may be struck more than once."""
    files = sorted(folder.glob(f"{point}.taken.*"), key=lambda file: int(file.name.rpartition(".")[2]))
    return [Struck(file=file, **json.loads(file.read_text())) for file in files]


def taken_by(folder: Path, point: str) -> list[int]:
    """List the processes that were struck at `point`, in the order of the strikes."""
    return [struck.process for struck in strikes(folder, point)]


def let_go(struck: Struck) -> None:
    """Let a thread go on that a strike holds."""
    struck.file.unlink(missing_ok=True)


def is_alive(process: int) -> bool:
    """Say whether a process, or the leader of a process group (negative), has not ended."""
    try:
        return psutil.Process(abs(process)).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def victims(strike: Strike) -> list[int]:
    """List what a strike would kill at this moment."""
    return [target for target in (*strike.kill, *_children(strike)) if is_alive(target)]


def note_early_message(submission_id: object) -> None:
    """Keep that a message came before the row it speaks of; the verdict reads it."""
    if folder := os.environ.get(FOLDER_VARIABLE):
        (Path(folder) / f"early.{submission_id}").touch()


def early_messages(folder: Path) -> list[str]:
    """List the submissions of which a message came before their row."""
    return [path.name.partition(".")[2] for path in sorted(folder.glob("early.*"))]


def install(points: Iterable[str]) -> None:
    """Let these points strike in this process."""
    _live_points.update(points)


def reach(point: str, *, about: str = "") -> None:
    """Strike if this point is armed.

    Args:
        point: One of `POINTS`.
        about: Which submission it is about, for the account.
    """
    folder = os.environ.get(FOLDER_VARIABLE)
    if not folder or point not in _live_points:
        return
    passage = f"{os.getpid()}.{time.monotonic_ns()}"
    draft = Path(folder) / f".{point}.{passage}"
    try:
        (Path(folder) / point).rename(draft)
    except FileNotFoundError:
        return
    strike = Strike(**json.loads(draft.read_text()))
    killed = victims(strike)
    draft.write_text(json.dumps({"process": os.getpid(), "killed": killed, "about": about}))
    _strike(strike, killed, draft.rename(Path(folder) / f"{point}.taken.{passage}"))


def _strike(strike: Strike, killed: list[int], account: Path) -> None:
    for target in sorted(killed, key=_is_ours):
        with contextlib.suppress(ProcessLookupError):
            os.kill(target, signal.SIGKILL) if target >= 0 else os.killpg(-target, signal.SIGKILL)
    if strike.stop:
        os.kill(os.getpid(), signal.SIGSTOP)
    if strike.no_space:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    while strike.hold and account.exists():
        time.sleep(0.02)
    time.sleep(strike.pause_s)


def _is_ours(target: int) -> bool:
    """Say whether we die by it: then it comes last."""
    return target in (os.getpid(), -os.getpgrp())


def _children(strike: Strike) -> list[int]:
    """Find a worker's pool processes or its scoring processes, as they are at this moment."""
    try:
        below = psutil.Process(strike.kill_children_of).children(recursive=True) if strike.kill_children_of else []
    except psutil.NoSuchProcess:
        return []
    return [child.pid for child in below if _is_scoring(child) is strike.scoring]


def _is_scoring(process: psutil.Process) -> bool | None:
    try:
        return SCORING_PROGRAM in process.cmdline()
    except psutil.Error:
        return None  # it ended meanwhile


_live_points: set[str] = set()
