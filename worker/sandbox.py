"""The worker's end of worker/child.py: starts it, hands it jobs, listens, and kills it when it must."""

import contextlib
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from pathlib import Path

import msgspec
import structlog

from worker.messages import AnyJob, Event, Exit, Ready

log = structlog.get_logger(__name__)

START_S = 60.0
"""Importing the evaluator takes a fraction of a second; a machine that needs longer than this is broken."""

PROGRAM = "worker.child"
"""The module that the scoring process runs."""

_KEPT_VARIABLES = ("PATH", "LANG", "LC_ALL", "TZ", "TMPDIR", "SYSTEMROOT")
"""All that the child gets of our environment. Everything else may hold a credential."""


class SandboxError(Exception):
    """The scoring process does not start."""


class Sandbox:
    """One scoring process, started when it is first needed and again after it was killed. Takes one job at a time."""

    def __init__(self, *, must_confine: bool = False) -> None:
        """Start nothing yet; with `must_confine` refuse to work where the kernel leaves it the network or other files."""
        self._must_confine = must_confine
        self._process: subprocess.Popen[bytes] | None = None
        self._received = b""
        self._is_ready = False

    def start(self) -> None:
        """Start the scoring process ahead of the first job, without waiting until it is ready."""
        if self._process is not None and self._process.poll() is None:
            return
        self.kill()
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", PROGRAM, str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=_clean_environment(),
            cwd="/",
            start_new_session=True,
        )
        self._is_ready = False

    def events(self, job: AnyJob, *, tick_s: float) -> Generator[Event | None, None, None]:
        """Run a job and yield what it tells, ending with `Exit`.

        Closing the iterator early kills the job. So does its time limit.

        Args:
            job: What to score.
            tick_s: None is yielded whenever the job was silent for so long.

        Raises:
            SandboxError: The scoring process does not start.
        """
        process = self._started()
        finished = False
        try:
            self._hand_over(process, job)
            deadline_s = time.monotonic() + job.time_s
            while not finished:
                event = self._next_event(process, min(tick_s, max(0.0, deadline_s - time.monotonic())))
                if event is None and time.monotonic() >= deadline_s:
                    event = Exit(status=-signal.SIGXCPU)
                else:
                    finished = isinstance(event, Exit) and process.poll() is None
                yield event
                if isinstance(event, Exit):
                    return
        finally:
            if not finished:
                self.kill()

    def check(self) -> None:
        """Start the scoring process once and end it.

        Raises:
            SandboxError: It does not start, or is not confined and must be.
        """
        try:
            self._started()
        finally:
            self.kill()

    def kill(self) -> None:
        """End the scoring process and its job at once."""
        process, self._process, self._received = self._process, None, b""
        if process is None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()

    def _started(self) -> subprocess.Popen[bytes]:
        """Wait until the scoring process takes jobs."""
        self.start()
        process = self._process
        if process is not None and not self._is_ready:
            ready = self._next_event(process, START_S)
            if not isinstance(ready, Ready):
                self.kill()
                message = f"the scoring process said {ready} instead of that it is ready; its messages are in the log"
                raise SandboxError(message)
            self._is_ready = True
            log.info("sandbox_ready", has_network=ready.has_network, has_files=ready.has_files)
            self._refuse_unless_confined(ready)
        if process is None:
            raise SandboxError("the scoring process could not be started")
        return process

    def _refuse_unless_confined(self, ready: Ready) -> None:
        kept = " and ".join(name for name, kept in (("network", ready.has_network), ("files", ready.has_files)) if kept)
        if kept and self._must_confine:
            self.kill()
            message = (
                f"this kernel leaves the scoring process its {kept}; unset CS3D_SANDBOX_REQUIRED to score all the same"
            )
            raise SandboxError(message)

    @staticmethod
    def _hand_over(process: subprocess.Popen[bytes], job: AnyJob) -> None:
        """Send the job; a process that just died is noticed by the end of its events."""
        stdin = process.stdin
        if stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                stdin.write(msgspec.json.encode(job) + b"\n")
                stdin.flush()

    def _next_event(self, process: subprocess.Popen[bytes], timeout_s: float) -> Event | None:
        """Wait for the next event; None after `timeout_s` of silence, `Exit` when the process is gone."""
        stdout = process.stdout
        if stdout is None:
            return Exit(status=-signal.SIGKILL)
        while b"\n" not in self._received:
            with selectors.DefaultSelector() as selector:
                selector.register(stdout, selectors.EVENT_READ)
                if not selector.select(timeout_s):
                    return None
            chunk = os.read(stdout.fileno(), 65536)
            if not chunk:
                return Exit(status=process.wait() or -signal.SIGKILL)
            self._received += chunk
        line, self._received = self._received.split(b"\n", 1)
        event: Event = msgspec.json.decode(line, type=Event)
        return event


def _clean_environment() -> dict[str, str]:
    """Give the child what Python and NumPy need to start, and where our packages are."""
    kept = {name: os.environ[name] for name in _KEPT_VARIABLES if name in os.environ}
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return {**kept, **single, "PYTHONPATH": str(Path(__file__).parent.parent), "PYTHONNOUSERSITE": "1"}
