"""Real Celery processes of ours."""

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from server.embedded import worker_command
from server.settings import Settings
from tests.services.processes import Service

ROOT = Path(__file__).resolve().parents[2]


def environment_of(settings: Settings, **extra: str) -> dict[str, str]:
    """Give a process of ours its settings, and nothing of another installation's."""
    ours = {name: value for name, value in os.environ.items() if not name.startswith("CS3D_")}
    return {**ours, "PYTHONPATH": str(ROOT), **settings.environment(), **extra}


class WorkerProcess(Service):
    """A Celery worker with its pool, its sweeper and its scoring processes."""

    def __init__(
        self,
        folder: Path,
        settings: Settings,
        *,
        concurrency: int = 1,
        module: str = "worker.app",
        extra: dict[str, str] | None = None,
    ) -> None:
        """Take the settings of an installation, and more variables for the environment."""
        super().__init__("worker", folder)
        self.settings = settings
        self.concurrency = concurrency
        self.module = module
        self.extra = extra or {}

    def command(self) -> Sequence[str]:
        """Run the command that `cs3d-admin worker` runs."""
        options = ["--concurrency", str(self.concurrency), "--hostname", f"test-{os.urandom(4).hex()}@%h"]
        return worker_command(*options, application=self.module)

    def environment(self) -> Mapping[str, str]:
        """Give the installation's settings."""
        return environment_of(self.settings, **self.extra)

    def is_ready(self) -> bool:
        """Say whether it takes messages."""
        return self.log_path.exists() and b" ready." in self.log_path.read_bytes()

    def launch(self) -> None:
        """Start afresh; the log of an earlier start is kept beside the new one."""
        if self.log_path.exists():
            self.log_path.rename(self.folder / f"worker-{time.monotonic_ns()}.log")
        super().launch()
