"""Nine named points in the life of a submission where a test can strike.

The processes of the fault programme are the real ones; only their entry modules (web_app.py, worker_app.py beside
this file) put the points in place (hooks.py). Production code knows nothing of it. A point is armed by a file of its
name in the folder that the environment names; the first process to pass takes the file, so each armed point strikes
once.

    in a web process                                    in a worker process
    received    the whole body is there                 claimed      a worker holds the submission
    fsynced     it is flushed to the disk               parsed       the report of valid predictions is recorded
    promoted    it has its digest's name                scored       the scores are computed
    committed   the submission is a row                 commit_sent  the commit of the score has returned
    enqueued    its message is in the broker
"""

import errno
import json
import os
import signal
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

FOLDER_VARIABLE = "CS3D_TEST_FAULTS"
"""The folder in which points are armed; without it nothing ever strikes."""

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


def is_armed(folder: Path, point: str) -> bool:
    """Say whether nobody has passed `point` since it was armed."""
    return (folder / point).exists()


def disarm(folder: Path, point: str) -> None:
    """Take the strike back unless it has happened."""
    (folder / point).unlink(missing_ok=True)


def taken_by(folder: Path, point: str) -> list[int]:
    """List the processes that were struck at `point`, in the order of the strikes."""
    return [process for _, process in _taken(folder, point)]


def last_taken_by(folder: Path, point: str) -> int:
    """Give the process that was struck last at `point`; the same one may have been struck there before."""
    return _taken(folder, point)[-1][1]


def _taken(folder: Path, point: str) -> list[tuple[int, int]]:
    """List when and which processes were struck, in this order."""
    names = [path.name.split(".") for path in folder.glob(f"{point}.taken.*")]
    return sorted((int(when_ns), int(process)) for _, _, process, when_ns in names)


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
