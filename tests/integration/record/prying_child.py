"""`python -m tests.integration.record.prying_child PARENT [USER]`: the real scoring process, whose jobs go where they should not."""

import json
import os
import socket
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import evaluator
from worker import child
from worker.messages import AnyJob, Event, Job, Scored


def main() -> None:
    """Take jobs as the real one does, as another user if one is named."""
    child.run = pry
    if sys.argv[2:]:
        child._load_evaluator()  # which that user may not be able to read
        os.setgroups([])
        os.setresgid(*[int(sys.argv[2])] * 3)
        os.setresuid(*[int(sys.argv[2])] * 3)
    child.main()


def pry(job: AnyJob, send: Callable[[Event], None]) -> int:
    """Try everything, and write what was possible into the job's folder."""
    assert isinstance(job, Job)
    worker, ground_truth = Path("/proc") / sys.argv[1], Path(job.ground_truth)

    def overwrite() -> None:
        with suppress(PermissionError):
            ground_truth.chmod(0o666)
        with ground_truth.open("r+b") as stream:
            stream.write(b"other ground truth")

    attempts: dict[str, Callable[[], object]] = {
        "read its input": ground_truth.read_bytes,
        "read our modules": Path(evaluator.__file__).read_bytes,
        "read the worker's environment": (worker / "environ").read_bytes,
        "open the worker's memory": (worker / "mem").open,
        "read another file": Path(job.folder).with_name("secret").read_bytes,
        "overwrite the ground truth": overwrite,
        "write beside its folder": lambda: Path(job.folder).with_name("trace").write_bytes(b""),
        "make a socket": socket.socket,
        "make a local socket": lambda: socket.socket(socket.AF_UNIX),
        "execute a program": lambda: os.posix_spawn("/bin/true", ["true"], {}),
        "delete the ground truth": ground_truth.unlink,
    }
    possible = [name for name, attempt in attempts.items() if _succeeds(attempt)]
    (Path(job.folder) / "possible.json").write_text(json.dumps(possible))
    send(Scored())
    return 0


def _succeeds(attempt: Callable[[], object]) -> bool:
    try:
        attempt()
    except OSError:
        return False
    return True


if __name__ == "__main__":
    main()
