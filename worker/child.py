"""The process that reads and scores participants' bytes: the evaluator and nothing else.

Started once per worker process with a clean environment, it imports the evaluator, gives up the network and then
forks one limited child per job: a job costs a fork, not an interpreter's start. A child that is killed, runs out of
memory or goes wild takes nothing else with it. It gets file paths and a protocol; it has no credentials.

Jobs are JSON lines on standard input, events are JSON lines on standard output; worker/sandbox.py holds the other end.
"""

import contextlib
import ctypes
import errno
import gc
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import msgspec

EXIT_MEMORY = 3
"""Exit status of a child that could not get the memory it asked for."""

_CLONE_NEWUSER, _CLONE_NEWNET, _PR_SET_PDEATHSIG = 0x10000000, 0x40000000, 1
_PROGRESS_INTERVAL_S = 0.1


class Job(msgspec.Struct, frozen=True, kw_only=True):
    """What to score, and within which limits."""

    predictions: str
    """Path of the uploaded zip."""
    ground_truth: str
    """Path of the prepared ground truth."""
    image_list: str
    """Path of the public image list, JSON."""
    predictions_sha256: str
    ground_truth_sha256: str
    protocol: str
    folder: str
    """Where `report.json`, `scores.json`, `integrity.json` and `statistics` are written."""
    memory_bytes: int
    time_s: float


class Ready(msgspec.Struct, frozen=True, tag="ready"):
    """Jobs are taken from now on."""

    has_network: bool


class Progress(msgspec.Struct, frozen=True, tag="progress"):
    """How far the job is."""

    stage: Literal["validating", "scoring"]
    done: int
    total: int


class Validated(msgspec.Struct, frozen=True, tag="validated"):
    """The report is written; the predictions have no errors; scoring begins."""


class Rejected(msgspec.Struct, frozen=True, tag="rejected"):
    """The report is written; the predictions have errors."""


class Scored(msgspec.Struct, frozen=True, tag="scored"):
    """Scores, statistics and integrity audit are written."""


class Broken(msgspec.Struct, frozen=True, tag="broken"):
    """The evaluator itself failed; trying again would not help."""

    detail: str


class Exit(msgspec.Struct, frozen=True, tag="exit"):
    """The job's process ended: 0, an exit status, or minus a signal's number."""

    status: int


Event = Ready | Progress | Validated | Rejected | Scored | Broken | Exit


def main() -> None:
    """Take jobs until standard input ends."""
    _die_with_parent(int(sys.argv[1]))
    has_network = not _leave_network()
    _load_evaluator()
    gc.collect()
    gc.freeze()  # so that collections in the children do not touch, and so copy, these pages
    _send(Ready(has_network=has_network))
    for line in sys.stdin.buffer:
        _send(Exit(status=_run_in_child(msgspec.json.decode(line, type=Job))))


def _load_evaluator() -> None:
    """Import once what every job needs."""
    import numpy.ma  # noqa: PLC0415, F401 - else NumPy loads it within every job, for `unique` of rows

    import evaluator.evaluation  # noqa: PLC0415 - after the network is gone, which needs a process without threads
    import evaluator.intake  # noqa: PLC0415
    import evaluator.integrity  # noqa: PLC0415, F401


def _run_in_child(job: Job) -> int:
    child = os.fork()
    if child == 0:
        status = 1
        try:
            _die_with_parent(os.getppid())
            limit(job)
            status = run(job, _send)
        except MemoryError:
            status = EXIT_MEMORY
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def limit(job: Job) -> None:
    """Bound what this process may use from now on. A limit that is already lower stays."""
    cpu_s = int(job.time_s) + 1
    for kind, value in (
        (resource.RLIMIT_AS, job.memory_bytes),
        (resource.RLIMIT_CPU, cpu_s),
        (resource.RLIMIT_FSIZE, job.memory_bytes),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(kind)[1]
        bound = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(kind, (bound, bound))


def run(job: Job, send: Callable[[Event], None]) -> int:
    """Read, check and score one submission.

    Returns:
        The exit status: 0 when the job came to an end, which may be a rejection.

    Raises:
        MemoryError: The limit is reached.
    """
    try:
        _evaluate(job, send)
    except MemoryError:
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno == errno.ENOMEM:  # mapping a file says it this way
            raise MemoryError from error
        traceback.print_exc()  # to the worker's log
        send(Broken(detail=_describe(error)))
    return 0


def _describe(error: BaseException) -> str:
    """Say what went wrong and where, without any of the data: the text is shown to the submission's owners."""
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    place = f"{Path(frame.tb_frame.f_code.co_filename).name}:{frame.tb_lineno}" if frame else "?"
    return f"{type(error).__name__} at {place}"


def _evaluate(job: Job, send: Callable[[Event], None]) -> None:
    from evaluator.evaluation import evaluate  # noqa: PLC0415 - loaded by `_load_evaluator`
    from evaluator.ground_truth import GroundTruth, ImageList  # noqa: PLC0415
    from evaluator.intake import read_predictions  # noqa: PLC0415
    from evaluator.integrity import audit  # noqa: PLC0415
    from evaluator.protocol import PROTOCOLS  # noqa: PLC0415

    folder = Path(job.folder)
    images = msgspec.json.decode(Path(job.image_list).read_bytes(), type=ImageList)
    intake = read_predictions(Path(job.predictions), images=images, progress=_reporter("validating", send))
    (folder / "report.json").write_bytes(msgspec.json.encode(intake.report))
    if intake.predictions is None:
        send(Rejected())
        return
    send(Validated())
    ground_truth = GroundTruth.from_bytes(Path(job.ground_truth).read_bytes())
    evaluation = evaluate(
        ground_truth,
        intake.predictions,
        PROTOCOLS[job.protocol],
        ground_truth_sha256=job.ground_truth_sha256,
        predictions_sha256=job.predictions_sha256,
        progress=_reporter("scoring", send),
    )
    (folder / "scores.json").write_bytes(msgspec.json.encode(evaluation.scores))
    (folder / "statistics").write_bytes(evaluation.statistics.to_bytes())
    (folder / "integrity.json").write_bytes(msgspec.json.encode(audit(evaluation)))
    send(Scored())


def _reporter(stage: Literal["validating", "scoring"], send: Callable[[Event], None]) -> Callable[[int, int], None]:
    """Make a progress callback that speaks at most ten times a second."""
    last_s = 0.0

    def report(done: int, total: int) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        if done == total or now_s - last_s >= _PROGRESS_INTERVAL_S:
            last_s = now_s
            send(Progress(stage=stage, done=done, total=total))

    return report


def _send(event: Event) -> None:
    """Write one event; lines are far shorter than a pipe's buffer, so they arrive whole."""
    os.write(1, msgspec.json.encode(event) + b"\n")


def _die_with_parent(parent: int) -> None:
    """Ask the kernel to kill this process when the one that started it dies, even by SIGKILL (Linux only)."""
    with contextlib.suppress(AttributeError, OSError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it died before we asked
        os._exit(1)


def _leave_network() -> bool:
    """Move to a network of our own without any interface; needs Linux, and root or unprivileged namespaces.

    Returns:
        False where the platform does not allow it; then only the clean environment keeps the child from our services.
    """
    try:
        unshare = ctypes.CDLL(None).unshare
    except (AttributeError, OSError):
        return False
    return bool(unshare(_CLONE_NEWNET) == 0 or unshare(_CLONE_NEWUSER | _CLONE_NEWNET) == 0)


if __name__ == "__main__":
    main()
