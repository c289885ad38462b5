"""A whole installation in one of the two shapes, and rows to fill it with."""

import io
import json
import uuid
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from server import accounts, benchmarks, submissions
from server.models import Phase, Submission, SubmissionState, Team, User
from server.services import Services
from server.settings import Settings
from tests.services.broker import Broker
from tests.services.processes import wait_until
from tests.services.worker import WorkerProcess

ORACLE = Path(__file__).resolve().parents[1] / "data" / "oracle"
SMALL_CASE = ORACLE / "tiny_by_hand"
REALISTIC_CASE = ORACLE / "realistic60"

QUICK = {"lease_s": 3.0, "heartbeat_s": 0.5, "sweep_s": 0.5, "resend_s": 1.0, "worker_concurrency": 1}
"""Settings that let a test see a recovery within seconds."""


def zip_of(folder: Path) -> bytes:
    """Pack a folder's files, as a participant would."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.iterdir()):
            archive.write(path, path.name)
    return buffer.getvalue()


def with_boxes(archive: bytes, change: Callable[[dict[str, Any]], None]) -> bytes:
    """Pack the same predictions with every 3D box changed in place."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(archive)) as source, zipfile.ZipFile(buffer, "w") as target:
        for name in source.namelist():
            document = json.loads(source.read(name))
            for one in document["objects"]:
                change(one["3d"])
            target.writestr(name, json.dumps(document))
    return buffer.getvalue()


@dataclass(kw_only=True)
class Installation:
    """Services, the processes behind them, and one team with one phase to submit to."""

    services: Services
    broker: Broker
    folder: Path
    case: Path = SMALL_CASE
    user: User = field(init=False)
    team: Team = field(init=False)
    phase: Phase = field(init=False)
    workers: list[WorkerProcess] = field(default_factory=list)

    @property
    def settings(self) -> Settings:
        """The installation's settings."""
        return self.services.settings

    def populate(self, case: Path = SMALL_CASE, **phase: Any) -> None:
        """Create a user, a team, a benchmark and a phase with a case's ground truth."""
        self.case = case
        rules = {"submissions_per_day": 1000, **phase}
        with self.services.transaction() as session:
            self.user = accounts.create_user(
                session,
                email="ann@example.org",
                name="Ann",
                password_hash=None,
                is_maintainer=False,
                actor="admin:test",
            )
            self.team = accounts.create_team(session, slug="lab", name="Lab", members=[self.user], actor="admin:test")
            benchmark = benchmarks.create_benchmark(session, slug="cs3d", title="Cityscapes 3D", actor="admin:test")
            self.phase = benchmarks.create_phase(
                session, benchmark=benchmark, slug="test", title="Test", actor="admin:test", **rules
            )
            benchmarks.import_ground_truth(
                session, self.services.blobs, phase=self.phase, source=case / "gt", actor="admin:test"
            )

    def submit(self, data: bytes | None = None, *, method: str = "ours", enqueue: bool = True) -> uuid.UUID:
        """Send predictions, by default the case's own, and tell the queue."""
        data = zip_of(self.case / "pred") if data is None else data
        sha256 = self.services.blobs.put_bytes(data)
        with self.services.transaction() as session:
            submission = submissions.receive(
                session,
                phase=benchmarks.find_phase(session, "cs3d", "test"),
                team=accounts.find_team(session, "lab"),
                user=accounts.find_user(session, "ann@example.org"),
                method_slug=method,
                predictions_sha256=sha256,
                size_bytes=len(data),
                file_name="predictions.zip",
                actor=f"user:{self.user.id}",
            )
        if enqueue:
            self.services.queue.enqueue(submission.id)
        return submission.id

    def load(self, submission_id: uuid.UUID) -> Submission:
        """Read a submission with its scores and attempts."""
        with self.services.snapshot() as session:
            submission = submissions.find(session, submission_id)
            _ = (submission.scores, submission.attempts, submission.phase.ground_truth)
            return submission

    def state(self, submission_id: uuid.UUID) -> SubmissionState:
        """Read a submission's state."""
        return self.load(submission_id).state

    def wait_for(self, submission_id: uuid.UUID, state: SubmissionState, *, timeout_s: float = 60.0) -> Submission:
        """Wait until a submission is in `state`, which is terminal."""
        wait_until(lambda: self.state(submission_id).terminal, timeout_s=timeout_s, what=f"{submission_id} {state}")
        submission = self.load(submission_id)
        if submission.state is not state:
            message = f"{submission_id} is {submission.state}: {submission.failure_code} {submission.failure_detail}"
            raise AssertionError(message)
        return submission

    def start_worker(self, **options: Any) -> WorkerProcess:
        """Start a worker; it is killed at the end of the test."""
        worker = WorkerProcess(self.folder / f"worker{len(self.workers)}", self.settings, **options)
        self.workers.append(worker)
        worker.start()
        return worker

    def close(self) -> None:
        """End everything the installation started."""
        for worker in self.workers:
            worker.kill()
        self.services.close()
        self.broker.kill()
