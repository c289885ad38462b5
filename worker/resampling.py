"""What follows a score: its images resampled in the sandbox, from the statistics alone."""

import shutil
import signal
from contextlib import closing

import structlog

from server import resampling
from server.errors import NotFound, StorageFull, Unavailable
from server.services import Services
from worker.attempt import emptied, patiently
from worker.messages import Exit, Resampled, Resampling
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
        replicates = _resample(services, sandbox, score_id, statistics_sha256, worker)
        if replicates is not None:
            patiently(services, lambda session: resampling.keep(session, score_id, replicates))
    except (Unavailable, StorageFull, NotFound, SandboxError, OSError) as error:
        log.warning("not_resampled", score_id=score_id, error=repr(error))


def _resample(services: Services, sandbox: Sandbox, score_id: int, statistics_sha256: str, worker: str) -> bytes | None:
    """Run the job; None when it was killed and is worth another try."""
    settings = services.settings
    folder = services.blobs.incoming / f"resampling-{score_id}-{worker.replace('/', '_')}.d"
    job = Resampling(
        statistics=str(services.blobs.local_path(statistics_sha256)),
        folder=emptied(folder),
        memory_bytes=settings.score_memory_bytes,
        time_s=settings.score_time_s,
    )
    replicates: bytes | None = resampling.NONE_POSSIBLE
    try:
        with closing(sandbox.events(job, tick_s=settings.heartbeat_s)) as events:
            for event in events:
                if isinstance(event, Resampled):
                    replicates = (folder / "replicates").read_bytes()
                elif isinstance(event, Exit) and event.status == -signal.SIGKILL and not replicates:
                    replicates = None
                elif event is not None and not replicates:
                    log.warning("resampling_ended", score_id=score_id, said=repr(event))
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return replicates
