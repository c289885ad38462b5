"""What a message leads to: claim the submission or the shard, work on it in the sandbox, record what came of it.

The claim's fence is in every write, so whatever happens twice, late or halfway changes nothing that is not due.
"""

import shutil
import uuid
from pathlib import Path
from typing import Protocol

import structlog
from celery.exceptions import SoftTimeLimitExceeded

from server import lifecycle, shards
from server.claims import Claim, ShardClaim
from server.errors import LeaseLost, NotFound, ServerError, StorageFull, Unavailable
from server.services import Services
from worker.attempt import Attempt
from worker.sandbox import Sandbox, SandboxError
from worker.sharding import ShardedAttempt, ShardWork

log = structlog.get_logger(__name__)


class Work(Protocol):
    """A claim being worked on, whatever it is of."""

    @property
    def held(self) -> Claim | ShardClaim:
        """What is held."""

    @property
    def folder(self) -> Path:
        """Where the results are written meanwhile."""

    def work(self, sandbox: Sandbox) -> None:
        """Do it."""

    def fail(self, code: str, detail: str) -> None:
        """Write that trying again would not help."""

    def lose(self, code: str, detail: str, *, again_at_once: bool = True) -> None:
        """Write that the claim is lost."""

    def give_back(self, detail: str) -> None:
        """Write that it waits again, without counting the claim."""


def evaluate_submission(services: Services, sandbox: Sandbox, submission_id: uuid.UUID, *, worker: str) -> None:
    """Do everything a waiting submission needs. Anything else than a waiting submission: nothing."""
    held = _claim(services, submission_id, worker)
    if held is not None:
        carry_out((ShardedAttempt if held.shards > 1 else Attempt)(services, held), sandbox)


def match_shard(
    services: Services, sandbox: Sandbox, submission_id: uuid.UUID, attempt: int, number: int, *, worker: str
) -> None:
    """Match the images of a shard, if it still waits."""
    try:
        with services.transaction() as session:
            taken = shards.claim(
                session, submission_id, attempt, number, worker=worker, lease_s=services.settings.lease_s
            )
    except (Unavailable, StorageFull) as error:  # the submission's holder does the shard itself
        log.warning("not_claimed", submission_id=str(submission_id), shard=number, error=str(error))
        return
    if taken is None:
        log.info("nothing_to_do", submission_id=str(submission_id), shard=number)
    else:
        carry_out(ShardWork(services, taken), sandbox)


def carry_out(work: "Work", sandbox: Sandbox) -> None:
    """Work on what a claim holds, and write whatever end it comes to."""
    try:
        work.work(sandbox)
    except LeaseLost as error:
        log.warning("lease_lost", detail=str(error))
    except NotFound as error:
        work.fail("blob_missing", str(error))
    except SoftTimeLimitExceeded:
        work.lose("time_limit", "the worker's own time limit was reached")
    except (Unavailable, StorageFull) as error:
        log.warning("given_back", submission_id=str(work.held.submission_id), error=repr(error))
        work.give_back(f"the worker lacked what it needs: {error.code}")
    except (ServerError, SandboxError, OSError) as error:
        log.exception("attempt_broke_down", submission_id=str(work.held.submission_id))
        work.lose("worker_error", f"the worker broke down: {type(error).__name__}", again_at_once=False)
    finally:
        shutil.rmtree(work.folder, ignore_errors=True)


def _claim(services: Services, submission_id: uuid.UUID, worker: str) -> Claim | None:
    """Take the submission; a database that is away or full leaves it to the sweeper's next message."""
    try:
        with services.transaction() as session:
            held = lifecycle.claim(session, submission_id, worker=worker, lease_s=services.settings.lease_s)
    except (Unavailable, StorageFull) as error:
        log.warning("not_claimed", submission_id=str(submission_id), error=str(error))
        return None
    if held is None:
        log.info("nothing_to_do", submission_id=str(submission_id))
    return held
