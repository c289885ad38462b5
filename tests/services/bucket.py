"""A real S3-compatible server: `moto_server`."""

import sys
import urllib.request
import uuid
from collections.abc import Sequence
from pathlib import Path

from tests.services.processes import Service, free_port, listens


class BucketServer(Service):
    """Keeps objects in memory; a bucket per installation."""

    def __init__(self, folder: Path) -> None:
        """Choose a port."""
        super().__init__("bucket", folder)
        self.port = free_port()

    @property
    def url(self) -> str:
        """Give the endpoint."""
        return f"http://127.0.0.1:{self.port}"

    def command(self) -> Sequence[str]:
        """Run moto's server."""
        return [sys.executable, "-W", "ignore", "-m", "moto.server", "-H", "127.0.0.1", "-p", str(self.port)]

    def is_ready(self) -> bool:
        """Say whether it listens."""
        return listens(self.port)

    def create_bucket(self) -> str:
        """Create an empty bucket and return its name."""
        name = f"b-{uuid.uuid4().hex[:12]}"
        request = urllib.request.Request(f"{self.url}/{name}", method="PUT")  # noqa: S310 - http, our own server
        with urllib.request.urlopen(request, timeout=10):  # noqa: S310 - likewise
            return name
