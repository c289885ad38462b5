"""`python -m tests.faults.scoring_process`: the real scoring process, for which some predictions are deadly.

Both strike once the predictions are found to be valid, as bytes do that meet a bug of the evaluator.
"""

import functools
import os
import signal
import zipfile
from collections.abc import Callable
from typing import Any

from worker import child
from worker.messages import AnyJob, Event, Job, Validated

POISON = 0.0123456789
"""A box with this score ends the process with a segmentation fault."""

HUNGER = 0.0987654321
"""A box with this score makes it ask for more memory than it may have."""


def main() -> None:
    """Take jobs as the real one does."""
    child.run = _deadly(child.run)
    child.main()


def _deadly(run: Callable[..., int]) -> Callable[..., int]:
    @functools.wraps(run)
    def run_or_die(job: AnyJob, send: Callable[[Event], None], *more: Any) -> int:
        if not isinstance(job, Job):  # what is scored in shards is not what these predictions are sent to
            return run(job, send, *more)
        scores = _text_of(job.predictions)

        def send_and_die(event: Event) -> None:
            send(event)
            if isinstance(event, Validated):
                _die(job, scores)

        return run(job, send_and_die, *more)

    return run_or_die


def _text_of(path: str) -> bytes:
    with zipfile.ZipFile(path) as archive:
        return b"".join(archive.read(name) for name in archive.namelist())


def _die(job: Job, text: bytes) -> None:
    if str(POISON).encode() in text:
        os.kill(os.getpid(), signal.SIGSEGV)
    if str(HUNGER).encode() in text:
        bytearray(2 * job.memory_bytes)


if __name__ == "__main__":
    main()
