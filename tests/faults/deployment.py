"""Everything a real installation consists of, as processes that can be killed one by one and are started again.

The same in both shapes but for the database, the broker and the blobs. Two workers, one web process, one scheduler.
"""

import signal
import sys
import tempfile
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from server import accounts, benchmarks, database
from server.models import Submission, SubmissionState
from server.services import Services
from server.settings import Settings
from tests.faults import clock, hooks, points, sabotage
from tests.faults.disk import Disk
from tests.faults.points import Strike
from tests.services.broker import Broker
from tests.services.bucket import BucketServer
from tests.services.installation import SMALL_CASE, Installation
from tests.services.postgresql import PostgresqlServer
from tests.services.processes import Service, wait_until
from tests.services.web import WebProcess
from tests.services.worker import WorkerProcess, environment_of

LEASE_S = 3.0
DRAIN_S = 300.0
"""A worker ends its task within this, however slow the machine is."""
REMAINS_S = 120.0
"""What a killed database left behind is gone within this."""
MAX_ATTEMPTS = 10
"""Of the phases: a submission that every attack happens to meet is scored in the end."""
SCARCE, SCARCE_PER_DAY = "scarce", 10
"""A phase whose quota is used up and whose submissions are scored in shards; and how many valid ones it takes."""
CLOCKS_WRONG_BY_S = {"web": 1800, "worker0": -3600, "worker1": 3600, "scheduler": -1800}
"""Of all our own processes."""
COPIES = 5
"""Of every message, whoever sends it."""
TIMES: dict[str, Any] = {
    "lease_s": LEASE_S, "heartbeat_s": 0.5, "sweep_s": 1.0, "resend_s": 5.0, "broker_timeout_s": 1.5,
    "disk_floor_bytes": 0, "worker_concurrency": 1,
}  # fmt: skip

TARGETS = ("web", "worker", "worker_parent", "pool_process", "scoring_process", "scheduler", "broker", "database")


class Scheduler(Service):
    """Celery beat."""

    def __init__(self, folder: Path, settings: Settings, extra: dict[str, str]) -> None:
        """Take the settings of an installation, and more variables for the environment."""
        super().__init__("scheduler", folder)
        self.settings = settings
        self.extra = extra

    def command(self) -> Sequence[str]:
        """Run the command that operators run, with another application."""
        application = "tests.faults.worker_app"
        return [sys.executable, "-m", "celery", "--app", application, "beat", "--pidfile=", "--loglevel", "WARNING"]

    def environment(self) -> Mapping[str, str]:
        """Give the installation's settings."""
        return environment_of(self.settings, **self.extra)


class Deployment:
    """One running installation under attack."""

    def __init__(self, shape: str, folder: Path, *, mount: bool, sabotaged: str | None = None) -> None:
        """Start everything, without waiting for our own processes, and create a team with two phases and a token."""
        self.shape = shape
        self._started: list[Service] = []
        self.faults = folder / "faults"
        self.faults.mkdir(parents=True)
        # Blobs and what is on its way to them; SQLite stays outside, for a full disk stops a database.
        local = folder / "data" / ("blobs" if shape == "embedded" else "")
        self.disk = Disk(local, self.faults, mount=mount)
        self._short = tempfile.TemporaryDirectory(prefix="cs3d-")
        socket = Path(self._short.name) / "broker.sock" if shape == "embedded" else None
        self.broker = Broker(folder / "broker", socket=socket)
        self.database = PostgresqlServer(folder / "postgresql") if shape == "scale_out" else None
        self.bucket = BucketServer(folder / "bucket") if shape == "scale_out" else None
        try:
            self._start(folder, sabotaged)
        except BaseException:
            self.close()
            raise

    def _start(self, folder: Path, sabotaged: str | None) -> None:
        for service in self._backing():
            self._started.append(service)
            service.start()
        self.services = Services.from_settings(Settings(data_dir=folder / "data", **TIMES, **self._places()))
        database.migrate(self.services.engine)
        if sabotaged == "unique_key":
            with self.services.transaction() as session:
                session.execute(sa.text("ALTER TABLE score DROP CONSTRAINT uq_score_signature"))
        self.installation = Installation(services=self.services, broker=self.broker, folder=folder)
        self._populate()
        self.token = self._create_token()
        self._sabotaged = sabotaged or ""
        self.web = WebProcess(folder / "web", self.services.settings, application="tests.faults.web_app:application")
        self.web.extra = self._environment("web")
        self.workers = [self._worker(folder / f"worker{index}") for index in range(2)]
        # Its sweeps are urgent and come as often as any message: more of them at a time and slow workers did nothing else.
        seldom = self.services.settings.model_copy(update={"sweep_s": COPIES * TIMES["sweep_s"]})
        self.scheduler = Scheduler(folder / "scheduler", seldom, self._environment("scheduler"))
        self.fronts: tuple[Service, ...] = (self.web, *self.workers, self.scheduler)
        for front in self.fronts:
            self._started.append(front)
            front.launch()

    def wait_until_ready(self) -> None:
        """Wait until everything answers."""
        for service in self._started:
            service.wait_until_ready()

    def _worker(self, folder: Path) -> WorkerProcess:
        extra = self._environment(folder.name)
        return WorkerProcess(folder, self.services.settings, module="tests.faults.worker_app", extra=extra)

    def _environment(self, name: str) -> dict[str, str]:
        """Say what is done to one of our processes: where points are armed, and what is wrong with it."""
        return {
            points.FOLDER_VARIABLE: str(self.faults), sabotage.VARIABLE: self._sabotaged,
            hooks.COPIES_VARIABLE: str(COPIES), clock.VARIABLE: str(CLOCKS_WRONG_BY_S[name]),
        }  # fmt: skip

    def _backing(self) -> list[Service]:
        return [service for service in (self.database, self.bucket, self.broker) if service is not None]

    def _places(self) -> dict[str, Any]:
        places: dict[str, Any] = {"broker_url": self.broker.url}
        if self.database is not None:
            places["database_url"] = self.database.url(self.database.create_database())
        if self.bucket is not None:
            places |= {
                "blob_url": f"s3://{self.bucket.create_bucket()}", "s3_endpoint_url": self.bucket.url,
                "s3_access_key_id": "test", "s3_secret_access_key": "test",
            }  # fmt: skip
        return places

    def _populate(self) -> None:
        plenty: dict[str, Any] = {
            "submissions_per_day": 100_000,
            "rejections_per_day": 100_000,
            "max_attempts": MAX_ATTEMPTS,
        }
        self.installation.populate(**plenty)
        with self.services.transaction() as session:
            phase = benchmarks.create_phase(
                session,
                benchmark=benchmarks.find_phase(session, "cs3d", "test").benchmark,
                slug=SCARCE,
                title="Scarce",
                actor="admin:test",
                **{**plenty, "submissions_per_day": SCARCE_PER_DAY},
            )
            phase.shards = 2
            benchmarks.import_ground_truth(
                session, self.services.blobs, phase=phase, source=SMALL_CASE / "gt", actor="admin:test"
            )

    def _create_token(self) -> str:
        with self.services.transaction() as session:
            user = accounts.find_user(session, "ann@example.org")
            team = accounts.find_team(session, "lab")
            return accounts.create_token(session, user=user, team=team, name="t", expires_at=None, actor="admin:t")[1]

    def killing(self, target: str, index: int) -> Strike:
        """Plan to kill a target.

        "worker" is everything that belongs to one; its parent and its children are targets of their own.

        Args:
            target: One of `TARGETS`.
            index: Chooses the worker.
        """
        worker = self.workers[index % len(self.workers)]
        if target in ("pool_process", "scoring_process"):
            return Strike(kill_children_of=_process(worker), scoring=target == "scoring_process")
        if target == "worker_parent":
            return Strike(kill=(_process(worker),))
        if target == "database":
            return Strike(kill=(_process(self.database),))
        groups = {"web": self.web, "worker": worker, "scheduler": self.scheduler, "broker": self.broker}
        return Strike(kill=(-_process(groups[target]),))

    def revive(self) -> None:
        """Start again what died, as a supervisor does; what others depend on is waited for."""
        for service in self._backing():
            if not service.running:
                service.kill()
                _start_patiently(service)
        self.revive_fronts()

    def revive_fronts(self) -> None:
        """Start again what died of our own processes."""
        for service in self.fronts:
            if not service.running:
                service.kill()
                service.launch()

    def unfinished(self) -> dict[uuid.UUID, SubmissionState]:
        """Look up which submissions are in no terminal state."""
        terminal = [state for state in SubmissionState if state.terminal]
        with self.services.snapshot() as session:
            query = sa.select(Submission.id, Submission.state).where(Submission.state.not_in(terminal))
            return {row.id: row.state for row in session.execute(query)}

    def drain(self) -> None:
        """Let the workers end what they are at, a task that woke up late too, and stop."""
        for worker in self.workers:
            worker.stop(timeout_s=DRAIN_S)

    def was_taken(self, submission_id: str) -> bool:
        """Say whether a worker took a message of a submission, even one that came before its row."""
        with self.services.snapshot() as session:
            row = session.get(Submission, uuid.UUID(submission_id))
            claimed = row is not None and row.attempt > 0
        return claimed or submission_id in points.early_messages(self.faults)

    def close(self) -> None:
        """End everything, what is frozen too."""
        for service in reversed(self._started):
            service.signal(signal.SIGCONT)
            service.kill()
        self.disk.close()
        self._short.cleanup()


def _process(service: Service | None) -> int:
    """Give the process of a service that is running, or was until a moment ago."""
    if service is None or service.process is None:
        message = "there is no such process to kill"
        raise ValueError(message)
    return service.process.pid


def _start_patiently(service: Service) -> None:
    """Start a service; a database that was killed needs a moment until its remains are gone."""

    def started() -> bool:
        try:
            service.start()
        except RuntimeError:
            service.kill()
            return False
        return True

    wait_until(started, timeout_s=REMAINS_S, what=f"the start of {service.name} (log: {service.log_path})")
