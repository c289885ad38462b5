"""A whole installation of real processes on loopback: broker, web server, workers, one team with a token."""

import signal
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import sqlalchemy as sa

from server import accounts, database
from server.embedded import listens, process_environment, web_command
from server.models import Score, ScoreReplicates, Submission, SubmissionState
from server.services import Services
from server.settings import Settings
from tests.services.broker import Broker
from tests.services.installation import SMALL_CASE, Installation
from tests.services.processes import Service, free_port, wait_until

HOST = "127.0.0.1"
APPLICATION = "server.web:application"
IDLE_S = 300.0
"""All that was sent is worked off within this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Memory:
    """What a process occupies."""

    own_bytes: int
    """Resident and its own: without pages of files, which the kernel takes back when it needs them."""
    resident_bytes: int


class WebServer(Service):
    """uvicorn as the embedded shape starts it, with our application or another one under the same settings."""

    def __init__(self, folder: Path, settings: Settings, *, application: str = APPLICATION) -> None:
        """Choose a free port."""
        super().__init__("web", folder)
        self._environment = process_environment(settings)
        self._application = application
        self.port = free_port()

    def command(self) -> Sequence[str]:
        """Put the application in the place of ours."""
        return [self._application if part == APPLICATION else part for part in web_command(HOST, self.port)]

    def environment(self) -> Mapping[str, str]:
        """Give the installation's settings."""
        return self._environment

    def is_ready(self) -> bool:
        """Say whether it listens."""
        return listens(HOST, self.port)

    @property
    def pid(self) -> int:
        """The process, which must run."""
        if self.process is None:
            raise RuntimeError("the web server does not run")
        return self.process.pid

    def memory(self) -> Memory:
        """Memory that it occupies."""
        info = psutil.Process(self.pid).memory_info()
        return Memory(own_bytes=info.rss - info.shared, resident_bytes=info.rss)


@dataclass(frozen=True, slots=True)
class Site:
    """An installation with its web server."""

    installation: Installation
    web: WebServer
    token: str

    @property
    def url(self) -> str:
        """Where it answers."""
        return f"http://{HOST}:{self.web.port}"

    @property
    def authorization(self) -> str:
        """The header of the team's requests."""
        return f"Bearer {self.token}"

    def wait_until_idle(self) -> None:
        """Wait until no worker has anything left to do: a score is resampled after its team has it."""
        wait_until(self._is_idle, timeout_s=IDLE_S, what="the end of all work")

    def _is_idle(self) -> bool:
        under_way = Submission.state.not_in([state for state in SubmissionState if state.terminal])
        resampled = sa.exists().where(ScoreReplicates.score_id == Score.id)
        with self.installation.services.snapshot() as session:
            return not (
                session.scalar(sa.select(Submission.id).where(under_way).limit(1))
                or session.scalar(sa.select(Score.id).where(~resampled).limit(1))
            )


@contextmanager
def running_site(
    *,
    case: Path = SMALL_CASE,
    workers: int = 0,
    **settings: Any,  # noqa: ANN401 - the fields of Settings
) -> Iterator[Site]:
    """Run an installation of the embedded shape in a temporary folder.

    Args:
        case: holds the ground truth, a folder or zip named `gt`.
        workers: processes that score, all of one Celery worker; 0: none runs.
        settings: of the installation.
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that the processes below end with us
    with tempfile.TemporaryDirectory(prefix="cs3d-bench-") as name:
        folder = Path(name)
        broker = Broker(folder / "broker", socket=folder / "broker.sock")
        chosen = Settings(data_dir=folder / "data", broker_url=broker.url, **settings)
        services = Services.from_settings(chosen)
        database.migrate(services.engine)
        installation = Installation(services=services, broker=broker, folder=folder)
        web = WebServer(folder / "web", chosen)
        try:
            broker.start()
            installation.populate(case, submissions_per_day=1_000_000, rejections_per_day=1_000_000)
            web.start()
            if workers:
                installation.start_worker(concurrency=workers)
            yield Site(installation, web, _token(installation))
        finally:
            web.kill()
            installation.close()


def _token(installation: Installation) -> str:
    with installation.services.transaction() as session:
        _, secret = accounts.create_token(
            session, user=installation.user, team=installation.team, name="bench", expires_at=None, actor="admin:bench"
        )
    return secret


@contextmanager
def running_beside(site: Site, application: str) -> Iterator[WebServer]:
    """Run another application under the same uvicorn and the same settings."""
    folder = site.installation.folder / "beside"
    web = WebServer(folder, site.installation.settings, application=application)
    web.start()
    try:
        yield web
    finally:
        web.kill()


def machine() -> str:
    """Describe the machine class that the figures are from."""
    return f"{psutil.cpu_count()} processors, load {psutil.getloadavg()[0]:.1f}, Python {sys.version.split()[0]}"
