"""Real services as child processes: each with its own port and folder, killed by process group."""

import contextlib
import os
import random
import signal
import socket
import subprocess
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

TETHER = Path(__file__).resolve().parents[2] / "server" / "tether.py"

READY_S = 180.0


_PORTS = iter(random.SystemRandom().sample(range(15_000, 32_768), 10_000))
"""Below those that Linux gives to outgoing connections: nobody takes the port of a service that is down for a while."""


def free_port() -> int:
    """Find a TCP port that nobody listens on, and that was not given before."""
    for port in _PORTS:
        with socket.socket() as listener, contextlib.suppress(OSError):
            listener.bind(("127.0.0.1", port))
            return port
    message = "every port is taken"
    raise OSError(message)


def listens(port: int) -> bool:
    """Say whether somebody listens on a local port."""
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
        return True
    return False


def wait_until(condition: Callable[[], object], *, timeout_s: float = READY_S, what: str = "the condition") -> None:
    """Wait until `condition()` is true.

    Raises:
        TimeoutError: It is not within `timeout_s`.
    """
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline_s:
            message = f"{what} did not become true within {timeout_s:g} s"
            raise TimeoutError(message)
        time.sleep(0.03)


class Service(ABC):
    """One program in its own session, so that killing its group reaches everything it started."""

    def __init__(self, name: str, folder: Path) -> None:
        """Keep everything of this service in `folder`."""
        self.name = name
        self.folder = folder
        self.folder.mkdir(parents=True, exist_ok=True)
        self.process: subprocess.Popen[bytes] | None = None

    @property
    def log_path(self) -> Path:
        """Where the program's output goes."""
        return self.folder / f"{self.name}.log"

    @abstractmethod
    def command(self) -> Sequence[str]:
        """Give the command line."""

    def environment(self) -> Mapping[str, str] | None:
        """Give the environment; None: ours."""
        return None

    def user(self) -> str | None:
        """Give the user to run as; None: ours."""
        return None

    def is_ready(self) -> bool:
        """Say whether the service answers."""
        return True

    def start(self) -> None:
        """Start the program and wait until it answers."""
        self.launch()
        self.wait_until_ready()

    def launch(self) -> None:
        """Start the program without waiting."""
        with self.log_path.open("ab") as log:
            self.process = subprocess.Popen(
                [*self._tether(), *self.command()],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self.environment(),
                user=self.user(),
                extra_groups=[] if self.user() else None,
                start_new_session=True,
            )

    def _tether(self) -> Sequence[str]:
        """Let the program end with us, even by SIGKILL; another user may not be able to run our Python."""
        return () if self.user() else (sys.executable, "-S", "-E", str(TETHER), str(os.getpid()))

    def wait_until_ready(self) -> None:
        """Wait until the service answers."""
        wait_until(self._ready_or_dead, what=f"{self.name} (log: {self.log_path})")

    def _ready_or_dead(self) -> bool:
        if not self.running:
            message = f"{self.name} ended at its start: {self.log_path.read_text(errors='replace')[-2000:]}"
            raise RuntimeError(message)
        return self.is_ready()

    @property
    def running(self) -> bool:
        """Say whether the process lives."""
        return self.process is not None and self.process.poll() is None

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to the whole group."""
        if self.process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, number)

    def stop(self, *, timeout_s: float = 20.0) -> None:
        """End the service in good order; by force when it takes too long."""
        if self.process is None:
            return
        if self.running:
            self.process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(timeout_s)
        self.kill()

    def kill(self) -> None:
        """SIGKILL the whole group and wait until it is gone."""
        self.signal(signal.SIGKILL)
        if self.process is not None:
            self.process.wait()
            self.process = None
