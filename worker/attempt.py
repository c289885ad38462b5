"""One claim being worked on: the job in the sandbox, its events, and every write under the claim's fence.

What this process cannot finish it gives back; what it cannot even give back, the sweeper takes when the lease runs out.
"""

import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Protocol, TypeVar

import msgspec
import structlog
from sqlalchemy.orm import Session

from evaluator.integrity import IntegrityAudit
from evaluator.results import Scores
from server import lifecycle, mail
from server.blobs import no_room_is_said, record_blob
from server.claims import Claim, Result
from server.errors import LeaseLost, StorageFull, Unavailable
from server.models import Score, SubmissionState
from server.services import Services
from worker.child import EXIT_MEMORY, EXIT_NO_ROOM
from worker.messages import AnyJob, Broken, Event, Exit, Job, Progress, Rejected, Scored, Validated
from worker.sandbox import Sandbox

log = structlog.get_logger(__name__)

RETRY_INTERVAL_S = 0.5
"""Between tries to reach a database that is away."""

Value = TypeVar("Value")


class Record(Protocol):
    """What keeps a claim: `server.lifecycle` for submissions, or another module with these functions."""

    def heartbeat(self, session: Session, held: Claim, *, stage: str, images_done: int, images_total: int) -> None:
        """Renew the lease and write the progress."""

    def record_score(self, session: Session, held: Claim, result: Result) -> Score | None:
        """Write the score and the end of the attempt; None: it is to be scored anew."""

    def fail(self, session: Session, held: Claim, *, code: str, detail: str) -> None:
        """Write that trying again would not help."""

    def give_back(self, session: Session, held: Claim, *, detail: str) -> None:
        """Let it wait again without counting the attempt."""

    def lose(self, session: Session, held: Claim, *, code: str, detail: str) -> str:
        """Count the attempt as lost; return the state it is in afterwards."""
        ...


@dataclass(slots=True)
class Attempt:
    """One claim being worked on."""

    record: ClassVar[Record] = lifecycle

    services: Services
    held: Claim
    last_heartbeat_s: float = field(default_factory=time.monotonic)
    progress: Progress = field(default_factory=lambda: Progress(stage="validating", done=0, total=0))
    concluded: bool = False
    """True once the submission's next state is written."""

    @property
    def folder(self) -> Path:
        """Where the child writes its results: beside the blobs, so that keeping them is a rename."""
        return self.services.blobs.incoming / f"{self.held.name}.d"

    def work(self, sandbox: Sandbox) -> None:
        """Run the job and follow its events to the end."""
        with beating(self.services, self._heartbeat):
            job = self._job()
        self._run(sandbox, job)

    def _run(self, sandbox: Sandbox, job: AnyJob) -> None:
        with closing(sandbox.events(job, tick_s=self.services.settings.heartbeat_s)) as events:
            for event in events:
                self._follow(event)
                self._heartbeat_when_due()

    def _job(self) -> AnyJob:
        settings, blobs, held = self.services.settings, self.services.blobs, self.held
        return Job(
            predictions=str(blobs.local_path(held.predictions_sha256)),
            ground_truth=str(blobs.local_path(held.ground_truth_sha256)),
            image_list=str(blobs.local_path(held.image_list_sha256)),
            predictions_sha256=held.predictions_sha256,
            ground_truth_sha256=held.ground_truth_sha256,
            protocol=held.protocol,
            folder=emptied(self.folder),
            memory_bytes=settings.score_memory_bytes,
            time_s=settings.score_time_s,
        )

    def _follow(self, event: Event | None) -> None:
        match event:
            case Progress():
                self.progress = event
            case Validated():
                self._validated()
            case Rejected():
                self._rejected()
            case Scored():
                self._scored()
            case Broken(detail=detail):
                self.fail("evaluator_error", f"the evaluator broke down: {detail}")
            case Exit(status=status) if not self.concluded:
                self.lose(*cause_of(status, self.services))

    def _heartbeat_when_due(self) -> None:
        if not self.concluded and time.monotonic() - self.last_heartbeat_s >= self.services.settings.heartbeat_s:
            self._heartbeat()

    def _heartbeat(self) -> None:
        """Renew the lease; a database that is away or full for a moment is asked again at the next beat."""
        self.last_heartbeat_s = time.monotonic()
        now = self.progress
        try:
            with self.services.transaction() as session:
                self.record.heartbeat(session, self.held, stage=now.stage, images_done=now.done, images_total=now.total)
        except (Unavailable, StorageFull) as error:
            log.warning("heartbeat_failed", error=repr(error))

    def _validated(self) -> None:
        sha256, size_bytes = self._keep("report.json")

        def write(session: Session) -> None:
            record_blob(session, self.services.blobs, sha256, size_bytes)
            lifecycle.validated(session, self.held, report_sha256=sha256)

        self._write(write)
        self.last_heartbeat_s = time.monotonic()

    def _rejected(self) -> None:
        sha256, size_bytes = self._keep("report.json")

        def write(session: Session) -> None:
            record_blob(session, self.services.blobs, sha256, size_bytes)
            lifecycle.reject(session, self.held, report_sha256=sha256)

        self._conclude(write)

    def _scored(self) -> None:
        scores = msgspec.json.decode((self.folder / "scores.json").read_bytes(), type=Scores)
        kept = {name: self._keep(name) for name in ("scores.json", "statistics")}
        result = Result(
            scores=scores,
            scores_sha256=kept["scores.json"][0],
            statistics_sha256=kept["statistics"][0],
            integrity=msgspec.json.decode((self.folder / "integrity.json").read_bytes(), type=IntegrityAudit),
        )

        written: list[int] = []

        def write(session: Session) -> None:
            for sha256, size_bytes in kept.values():
                record_blob(session, self.services.blobs, sha256, size_bytes)
            score = self.record.record_score(session, self.held, result)
            written[:] = [] if score is None else [score.id]

        self._conclude(write)
        for score_id in written:
            self.services.queue.enqueue_resampling(score_id)
        self._tell_of_hold()

    def _keep(self, name: str) -> tuple[str, int]:
        """Put a result into the blob store and return its digest and size; a second call finds nothing to do."""
        data = (self.folder / name).read_bytes()
        return self.services.blobs.put_bytes(data), len(data)

    def fail(self, code: str, detail: str) -> None:
        """End the submission as failed and tell the maintainers."""
        with end_is_written_elsewhere():
            self._conclude(lambda session: self.record.fail(session, self.held, code=code, detail=detail))
            self._tell_of_failure()

    def lose(self, code: str, detail: str, *, again_at_once: bool = True) -> None:
        """Count the attempt as lost; the submission is tried again at once or by the sweeper, or fails at the cap."""
        states: list[str] = []
        with end_is_written_elsewhere():
            self._conclude(
                lambda session: states.append(self.record.lose(session, self.held, code=code, detail=detail))
            )
        if states and states[-1] == SubmissionState.FAILED:
            self._tell_of_failure()
        elif states and again_at_once:
            self._send_again()

    def _tell_of_hold(self) -> None:
        mail.tell_of_hold(self.services, self.held.submission_id)

    def _tell_of_failure(self) -> None:
        mail.tell_of_failure(self.services, self.held.submission_id)

    def _send_again(self) -> None:
        self.services.queue.enqueue(self.held.submission_id)

    def give_back(self, detail: str) -> None:
        """Let the submission wait again; the sweeper sends it once more after a while, which spares what is ailing."""
        with end_is_written_elsewhere():
            self._conclude(lambda session: self.record.give_back(session, self.held, detail=detail))

    def _conclude(self, write: Callable[[Session], object]) -> None:
        self._write(write)
        self.concluded = True

    def _write(self, write: Callable[[Session], object]) -> None:
        """Write in one transaction, with patience.

        A commit whose answer was lost may be written a second time; then the fence raises `LeaseLost`.
        """
        patiently(self.services, write)


def patiently(services: Services, act: Callable[[Session], Value], *, reads_only: bool = False) -> Value:
    """Act in one transaction; the work is done, so a database away or full is waited for, as long as a lease lasts."""
    patience_s = time.monotonic() + services.settings.lease_s
    while True:
        try:
            with services.snapshot() if reads_only else services.transaction() as session:
                return act(session)
        except (Unavailable, StorageFull) as error:
            if time.monotonic() > patience_s:
                raise
            log.warning("database_waited_for", error=repr(error))
            time.sleep(RETRY_INTERVAL_S)


@contextmanager
def beating(services: Services, beat: Callable[[], None]) -> Iterator[None]:
    """Renew a lease while blobs are fetched, which may take longer than it lasts."""
    done = threading.Event()

    def run() -> None:
        while not done.wait(services.settings.heartbeat_s):
            with suppress(LeaseLost):  # the next write says so
                beat()

    thread = threading.Thread(target=run, name="heartbeat", daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def emptied(folder: Path) -> str:
    """Make an empty folder for a job's results; a restored database may count an attempt a second time."""
    shutil.rmtree(folder, ignore_errors=True)
    with no_room_is_said():
        folder.mkdir(parents=True)
    return str(folder)


@contextmanager
def end_is_written_elsewhere() -> Iterator[None]:
    """Somebody else has the submission, or will have it when the lease runs out: then its end is theirs to write."""
    try:
        yield
    except (LeaseLost, Unavailable, StorageFull) as error:
        log.warning(error.code, detail=str(error))


def cause_of(status: int, services: Services) -> tuple[str, str]:
    """Say why a child ended without a result: failure code and detail.

    Raises:
        StorageFull: It found no room for its results, which is nobody's fault who sent something.
    """
    settings = services.settings
    if status == EXIT_NO_ROOM:
        raise StorageFull("the disk of temporary files has no room left for results")
    if status == EXIT_MEMORY:
        return "memory_limit", f"reading or scoring it needs more than {settings.score_memory_bytes >> 20} MiB"
    if status == -signal.SIGXCPU:
        return "time_limit", f"reading or scoring it takes longer than {settings.score_time_s:g} s"
    if status == -signal.SIGKILL:
        return "scoring_killed", "the scoring process was killed, probably because the machine ran out of memory"
    return "scoring_died", f"the scoring process ended with status {status}"
