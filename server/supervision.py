"""Child processes kept alive: started in order, restarted when they end, stopped in reverse order.

Knows nothing about what the children do; server/embedded.py says that.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Never

import structlog

from server.errors import Unavailable

log = structlog.get_logger(__name__)

FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 30.0
"""The pause before a restart doubles up to this, and starts anew after a child has run so long."""

TETHER = Path(__file__).with_name("tether.py")


@dataclass(kw_only=True)
class Child:
    """One program that should always run."""

    name: str
    command: Sequence[str]
    environment: Mapping[str, str]
    is_ready: Callable[[], bool]
    """Asked after a start until it says yes."""
    ready_within_s: float = 120.0
    """A busy machine may need half a minute for the imports alone; a child that dies is noticed at once."""
    stop_within_s: float = 10.0
    """After so long, SIGTERM is followed by SIGKILL."""
    log_file: Path | None = None
    """Where its output goes; None: where ours goes."""

    process: subprocess.Popen[bytes] | None = field(default=None, init=False)
    started_at: float = field(default=0.0, init=False)
    pause_s: float = field(default=FIRST_PAUSE_S, init=False)
    restart_at: float | None = field(default=None, init=False)

    @property
    def running(self) -> bool:
        """True while the process lives."""
        return self.process is not None and self.process.poll() is None

    def start(self) -> None:
        """Start the process in a session of its own, so that a Ctrl-C reaches only us."""
        with self._output() as output:
            self.process = subprocess.Popen(
                [sys.executable, "-S", "-E", str(TETHER), str(os.getpid()), *self.command],
                env=dict(self.environment),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )
        self.started_at, self.restart_at = time.monotonic(), None

    @contextlib.contextmanager
    def _output(self) -> Iterator[IO[bytes] | None]:
        if self.log_file is None:
            yield None
            return
        self.log_file.parent.mkdir(parents=True, exist_ok=True)
        with self.log_file.open("ab") as output:
            yield output

    def stop(self) -> None:
        """Ask the process to end in good order, wait, then end it and whatever it started."""
        if self.process is None:
            return
        self.process.send_signal(signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(self.stop_within_s)
        self.end()

    def end(self) -> int | None:
        """End the process, if it lives, and what it left behind; return its exit status."""
        if self.process is None:
            return None
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        return self.process.wait()


class Supervisor:
    """Keeps children running until told to stop. Call everything from one thread."""

    def __init__(self, children: Sequence[Child]) -> None:
        """Take children in the order in which they start."""
        self._children = list(children)

    def start(self) -> None:
        """Start every child and wait until each is ready.

        Raises:
            Unavailable: One does not come up; all are stopped again.
        """
        try:
            for child in self._children:
                child.start()
            for child in self._children:
                _wait_until_ready(child)
        except BaseException:
            self.stop()
            raise

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        """Run the children for as long as the block lasts, however it ends."""
        self.start()
        try:
            yield
        finally:
            self.stop()

    def keep_running(self) -> Never:
        """Keep the children running until an exception (Ctrl-C) ends it."""
        while True:
            self.check()
            time.sleep(0.2)

    def check(self) -> None:
        """Restart what ended, each after its pause. Call it a few times a second."""
        for child in self._children:
            if child.running:
                if time.monotonic() - child.started_at > LONGEST_PAUSE_S:
                    child.pause_s = FIRST_PAUSE_S
            elif child.restart_at is None:
                _plan_restart(child)
            elif time.monotonic() >= child.restart_at:
                child.start()

    def stop(self) -> None:
        """Stop every child, the last one first, each once those after it have ended."""
        for child in reversed(self._children):
            child.stop()


def _wait_until_ready(child: Child) -> None:
    """Wait for a child that was just started."""
    deadline = time.monotonic() + child.ready_within_s
    while not child.is_ready():
        if not child.running:
            message = f"{child.name} ended with status {child.end()}; {_where(child)}"
            raise Unavailable(message)
        if time.monotonic() > deadline:
            message = f"{child.name} was not ready within {child.ready_within_s:.0f} s; {_where(child)}"
            raise Unavailable(message)
        time.sleep(0.05)


def _where(child: Child) -> str:
    """Say where a child's output is."""
    return f"see {child.log_file}" if child.log_file else "its output stands above"


def _plan_restart(child: Child) -> None:
    """Note that a child ended, end what it left behind and set the time of its restart."""
    log.warning("child_ended", child=child.name, status=child.end(), restart_in_s=child.pause_s)
    child.restart_at = time.monotonic() + child.pause_s
    child.pause_s = min(2 * child.pause_s, LONGEST_PAUSE_S)
