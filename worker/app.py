"""The Celery application: `celery -A worker.app worker`, or `cs3d-admin worker`, on any machine with the same settings.

Tasks: `cs3d.evaluate` (a submission's id), `cs3d.shard` (a range of the images of one that another process holds),
`cs3d.resample` (a score), `cs3d.rescore` (an item of a re-scoring), `cs3d.sweep` and `cs3d.sweep_files`. Every worker also
sweeps by itself, so recovery needs no scheduler; a scheduler (`celery -A worker.app beat`) is for installations whose workers
come and go.
SIGTERM drains: running submissions are finished, no new ones are taken.
"""

import os
import socket
import uuid
from dataclasses import dataclass
from functools import cache

import structlog
from celery import signals

from server import sweeper
from server.errors import ServerError
from server.queue import (
    EVALUATE_TASK,
    FILE_SWEEP_TASK,
    PRIORITY_NORMAL,
    RESAMPLE_TASK,
    RESCORE_TASK,
    SHARD_TASK,
    SWEEP_TASK,
    celery_app,
)
from server.services import Services
from server.settings import Settings
from worker import listening
from worker.confinement import hide_memory
from worker.evaluation import evaluate_submission, match_shard
from worker.resampling import resample_score
from worker.rescoring import evaluate_item
from worker.sandbox import Sandbox, SandboxError
from worker.sweeping import Sweeping

log = structlog.get_logger(__name__)

POOL_PROCESS_MEMORY_KIB = 512 * 1024
"""A pool process holds no submission's data, so one that grows beyond this is replaced."""

settings = Settings()
app = celery_app(settings)
listening.install(app)
app.conf.worker_concurrency = settings.worker_concurrency or None
app.conf.worker_max_memory_per_child = POOL_PROCESS_MEMORY_KIB
app.conf.beat_scheduler = "celery.beat:Scheduler"  # keeps no file that a crash could leave half written


@dataclass(frozen=True)
class _Process:
    """What one process of ours works with."""

    services: Services
    sandbox: Sandbox
    name: str


@cache
def _process(pid: int) -> _Process:
    """Open the services once per process: connections must not be shared over a fork."""
    sandbox = Sandbox(must_confine=settings.sandbox_required)
    return _Process(Services.from_settings(settings), sandbox, f"{socket.gethostname()}:{pid}")


@app.task(name=EVALUATE_TASK)
def evaluate(submission_id: str) -> None:
    """Validate and score a submission, if that is what it waits for."""
    this = _process(os.getpid())
    evaluate_submission(this.services, this.sandbox, uuid.UUID(submission_id), worker=this.name)


@app.task(name=RESCORE_TASK)
def rescore(item_id: int) -> None:
    """Score a submission again, if that is what an item of a re-scoring waits for."""
    this = _process(os.getpid())
    evaluate_item(this.services, this.sandbox, item_id, worker=this.name)


@app.task(name=RESAMPLE_TASK)
def resample(score_id: int) -> None:
    """Resample the images of a score, if it waits for that."""
    this = _process(os.getpid())
    resample_score(this.services, this.sandbox, score_id, worker=this.name)


@app.task(name=SHARD_TASK)
def match(submission_id: str, attempt: int, number: int) -> None:
    """Match the images of a shard of a submission that another process holds, if it still waits."""
    this = _process(os.getpid())
    match_shard(this.services, this.sandbox, uuid.UUID(submission_id), attempt, number, worker=this.name)


@app.task(name=SWEEP_TASK)
def sweep() -> None:
    """Take back what lost workers held; send again what nobody picked up. What is away is tried again next time."""
    try:
        sweeper.sweep(_process(os.getpid()).services)
    except ServerError as error:
        log.warning("sweep_failed", error=repr(error))


@app.task(name=FILE_SWEEP_TASK)
def sweep_files() -> None:
    """Delete files that belong to nobody. Never in the main process: a bucket's client leaves threads, which a fork loses.

    A pool process that replaced another one would wait for them for ever.
    """
    try:
        sweeper.sweep_files(_process(os.getpid()).services)
    except (ServerError, OSError) as error:
        log.warning("sweep_failed", error=repr(error))


_sweeping = Sweeping(settings, lambda: sweep_files.apply_async(priority=PRIORITY_NORMAL))


@signals.worker_init.connect
def _protect(**_: object) -> None:
    """Hide our credentials from the scoring processes, before any is started, and see whether they are what they must be.

    Raises:
        SystemExit: They are not, and the settings want it.
    """
    hide_memory()
    if settings.sandbox_required:
        try:
            Sandbox(must_confine=True).check()
        except SandboxError as error:
            raise SystemExit(str(error)) from error


@signals.worker_ready.connect
def _start_sweeping(**_: object) -> None:
    _sweeping.start()


@signals.worker_shutting_down.connect
def _stop_sweeping(**_: object) -> None:
    _sweeping.stopped.set()


@signals.worker_process_init.connect
def _warm_up(**_: object) -> None:
    """Start the scoring process before the first submission waits for it."""
    _process(os.getpid()).sandbox.start()


@signals.worker_process_shutdown.connect
def _shut_down(**_: object) -> None:
    this = _process(os.getpid())
    this.sandbox.kill()
    this.services.close()
