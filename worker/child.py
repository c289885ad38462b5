"""The process that reads and scores participants' bytes: the evaluator and nothing else.

Started once per worker process with a clean environment, it imports the evaluator, gives up the network and all privileges
(worker/confinement.py) and then forks one limited child per job: a job costs a fork, not an interpreter's start. A child that
is killed, runs out of memory or goes wild takes nothing else with it. It gets file paths and a protocol; it has no
credentials, and where the kernel allows it opens nothing but those files.

Jobs are JSON lines on standard input, events are JSON lines on standard output (worker/messages.py); worker/sandbox.py
holds the other end. What a job is: worker/jobs.py.
"""

import contextlib
import ctypes
import errno
import gc
import os
import resource
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path

import msgspec

from worker import confinement
from worker.messages import AnyJob, Broken, Event, Exit, Ready

EXIT_MEMORY = 3
"""Exit status of a child that could not get the memory it asked for."""
EXIT_NO_ROOM = 4
"""Exit status of a child whose results found no room on the disk."""

_CLONE_NEWUSER, _CLONE_NEWNET, _PR_SET_PDEATHSIG = 0x10000000, 0x40000000, 1


def main() -> None:
    """Take jobs until standard input ends."""
    _die_with_parent(int(sys.argv[1]))
    is_alone = _leave_network()
    _load_evaluator()
    has_network = not confinement.refuse_sockets() and not is_alone
    confinement.drop_privileges()
    gc.collect()
    gc.freeze()  # so that collections in the children do not touch, and so copy, these pages
    _send(Ready(has_network=has_network, has_files=not confinement.can_confine_files()))
    for line in sys.stdin.buffer:
        _send(Exit(status=_run_in_child(msgspec.json.decode(line, type=AnyJob))))


def _load_evaluator() -> None:
    """Import once what every job needs."""
    import numpy.ma  # noqa: PLC0415 - else NumPy loads it within every job, for `unique` of rows
    import numpy.random  # noqa: PLC0415, F401 - likewise, for resampling

    import worker.jobs  # noqa: PLC0415, F401 - after the network is gone, which needs a process without threads
    from evaluator.memory import keep_freed_memory  # noqa: PLC0415 - likewise

    keep_freed_memory()


def _run_in_child(job: AnyJob) -> int:
    child = os.fork()
    if child == 0:
        status = 1
        try:
            _die_with_parent(os.getppid())
            confinement.confine_files(Path(job.folder), map(Path, job.inputs))
            limit(job)
            status = run(job, _send)
        except MemoryError:
            status = EXIT_MEMORY
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def limit(job: AnyJob) -> None:
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


def run(job: AnyJob, send: Callable[[Event], None]) -> int:
    """Do one job.

    Returns:
        The exit status: 0 when the job came to an end, which may be a rejection.

    Raises:
        MemoryError: The limit is reached.
    """
    from worker.jobs import carry_out  # noqa: PLC0415 - see `_load_evaluator`

    try:
        carry_out(job, send)
    except MemoryError:
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno == errno.ENOMEM:  # mapping a file says it this way
            raise MemoryError from error
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return EXIT_NO_ROOM
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
        False where the platform does not allow it, as in most containers.
    """
    try:
        unshare = ctypes.CDLL(None).unshare
    except (AttributeError, OSError):
        return False
    return bool(unshare(_CLONE_NEWNET) == 0 or unshare(_CLONE_NEWUSER | _CLONE_NEWNET) == 0)


if __name__ == "__main__":
    main()
