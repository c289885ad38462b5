"""A process that freezes while it holds SQLite's write lock delays writers, and does not hang them."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from server import database
from server.services import Services
from server.settings import Settings
from tests.integration.api.conftest import quiet_services
from tests.integration.record.three_methods import predictions
from tests.integration.site import running_site, send

__all__ = ["quiet_services"]

HOLD = """
import os, signal, sqlite3, sys
connection = sqlite3.connect(sys.argv[1], isolation_level=None)
connection.execute("BEGIN IMMEDIATE")
print("held", flush=True)
os.kill(os.getpid(), signal.SIGSTOP)
"""


@contextmanager
def _frozen_writer(settings: Settings) -> Iterator[None]:
    """Keep a stopped process that holds the write lock until the end of the block."""
    path = settings.database.removeprefix("sqlite:///")
    with subprocess.Popen([sys.executable, "-c", HOLD, path], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == b"held\n"
            yield
        finally:
            process.send_signal(signal.SIGKILL)


@pytest.mark.parametrize("shape", ["embedded"], indirect=True)
def test_writers_get_503_and_readers_go_on(quiet_services: Services, monkeypatch: pytest.MonkeyPatch) -> None:
    """While the lock is held, uploads are answered 503 after the busy timeout and leaderboards are read; then all is well."""
    monkeypatch.setattr(database, "BUSY_TIMEOUT_S", 1)
    services = Services.from_settings(quiet_services.settings)
    with running_site(services) as site, site.client(site.token()) as client:
        with _frozen_writer(services.settings):
            assert client.get("/api/v1/leaderboards/cs3d/test").status_code == 200
            refused = send(client, predictions("partial"))
            assert (refused.status_code, refused.json()["code"]) == (503, "unavailable")
        assert send(client, predictions("partial")).status_code == 202
