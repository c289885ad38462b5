"""The real web process."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from server.settings import Settings
from tests.services.processes import Service, free_port, listens
from tests.services.worker import environment_of


class WebProcess(Service):
    """uvicorn with our application on its own port."""

    def __init__(self, folder: Path, settings: Settings, *, application: str = "server.web:application") -> None:
        """Take the settings of an installation."""
        super().__init__("web", folder)
        self.settings = settings
        self.application = application
        self.port = free_port()
        self.extra: dict[str, str] = {}

    @property
    def url(self) -> str:
        """Where it answers."""
        return f"http://127.0.0.1:{self.port}"

    def command(self) -> Sequence[str]:
        """Run one process, as in the container."""
        place = ["--host", "127.0.0.1", "--port", str(self.port), "--log-level", "warning"]
        return [sys.executable, "-m", "uvicorn", "--factory", self.application, *place]

    def environment(self) -> Mapping[str, str]:
        """Give the installation's settings."""
        return environment_of(self.settings, **self.extra)

    def is_ready(self) -> bool:
        """Say whether it listens."""
        return listens(self.port)
