"""What follows a score: its images resampled in the sandbox, from the statistics alone."""

import shutil
from contextlib import closing
from pathlib import Path

import structlog

from server import resampling
from server.errors import NotFound, StorageFull, Unavailable
from server.services import Services
from worker.attempt import cause_of, emptied, patiently
from worker.child import EXIT_MEMORY
from worker.messages import Broken, Event, Exit, Resampled, Resampling
from worker.sandbox import Sandbox, SandboxError

log = structlog.get_logger(__name__)


def resample_score(services: Services, sandbox: Sandbox, score_id: int, *, worker: str) -> None:
    """Compute and keep the replicates of a score that has none. What fails for want of something is sent again."""
    try:
        with services.snapshot() as session:
            statistics_sha256 = resampling.statistics_waiting(session, score_id)
        if statistics_sha256 is None:
            log.info("nothing_to_do", score_id=score_id)
            return
        _resample(services, sandbox, score_id, statistics_sha256, worker)
    except (Unavailable, StorageFull, NotFound, SandboxError, OSError) as error:
        log.warning("not_resampled", score_id=score_id, error=repr(error))


def _resample(services: Services, sandbox: Sandbox, score_id: int, statistics_sha256: str, worker: str) -> None:
    """Run the job and write what came of it."""
    settings = services.settings
    folder = services.blobs.incoming / f"resampling-{score_id}-{worker.replace('/', '_')}.d"
    job = Resampling(
        statistics=str(services.blobs.local_path(statistics_sha256)),
        folder=emptied(folder),
        memory_bytes=settings.score_memory_bytes,
        time_s=settings.score_time_s,
    )
    try:
        with closing(sandbox.events(job, tick_s=settings.heartbeat_s)) as events:
            said = [event for event in events if event is not None]
        replicates = _replicates(folder, said)
        if replicates is not None:
            patiently(services, lambda session: resampling.keep(session, score_id, replicates))
            return
        reason = _reason(services, said)
        log.warning("resampling_ended", score_id=score_id, reason=reason)
        patiently(services, lambda session: resampling.count_try(session, score_id, worker=worker, reason=reason))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _replicates(folder: Path, said: list[Event]) -> bytes | None:
    """Give what is known for good; None when the job came to no end."""
    if Resampled() in said:
        return (folder / "replicates").read_bytes()
    return resampling.NONE_POSSIBLE if Exit(status=EXIT_MEMORY) in said else None


def _reason(services: Services, said: list[Event]) -> str:
    """Say why a job came to no end.

    Raises:
        StorageFull: There was no room for its result, which is no fault of the score's.
    """
    for event in said:
        if isinstance(event, Broken):
            return f"evaluator_error: {event.detail}"
    status = next(event.status for event in said if isinstance(event, Exit))
    return ": ".join(cause_of(status, services))
