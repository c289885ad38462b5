"""Sharded scoring: a submission whose images several workers match, and the work on one shard.

The holder of the submission validates the whole upload, divides the images and tells the others. It works on shards
itself, so one process finishes alone what no other takes; then it joins all results, to the same bytes as unsharded.
"""

import shutil
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path

import structlog
from sqlalchemy.orm import Session

from evaluator.sharding import image_ranges
from server import lifecycle, shards
from server.blobs import digest_file
from server.claims import ShardClaim
from server.errors import ShardLost, StorageFull, Unavailable
from server.services import Services
from worker.attempt import Attempt, beating, cause_of, emptied, end_is_written_elsewhere, patiently
from worker.messages import (
    AnyJob,
    Broken,
    Event,
    Exit,
    Matched,
    Preparation,
    Prepared,
    Progress,
    Reduction,
    ShardJob,
)
from worker.sandbox import Sandbox

log = structlog.get_logger(__name__)

LOOK_S = 0.1
"""Between two looks at shards that other workers hold."""


class ShardedAttempt(Attempt):
    """One claim of a submission that is scored in shards."""

    images: int = 0
    """How many there are, once the predictions are validated and written as arrays."""
    arrays_sha256: str = ""
    """Of those arrays, once they are in the blob store."""

    def work(self, sandbox: Sandbox) -> None:
        """Validate, divide, work through the shards with whoever helps, and join."""
        super().work(sandbox)
        if self.concluded:
            return
        with beating(self.services, self._heartbeat):
            self._divide()
        results = self._work_through(sandbox)
        if results:
            with beating(self.services, self._heartbeat):
                reduction = self._reduction(results)
            self._run(sandbox, reduction)

    def _job(self) -> AnyJob:
        settings, blobs, held = self.services.settings, self.services.blobs, self.held
        return Preparation(
            predictions=str(blobs.local_path(held.predictions_sha256)),
            image_list=str(blobs.local_path(held.image_list_sha256)),
            folder=emptied(self.folder),
            memory_bytes=settings.score_memory_bytes,
            time_s=settings.score_time_s,
        )

    def _follow(self, event: Event | None) -> None:
        match event:
            case Prepared(images=images):
                self.images = images
            case Exit(status=0) if self.images and not self.arrays_sha256:
                pass  # the preparation is done, the submission is not
            case _:
                super()._follow(event)

    def _divide(self) -> None:
        """Make the shards and tell the other workers; a database that lost our answer finds them there."""
        self.arrays_sha256 = _keep_file(self.services, self.folder / "predictions")
        ranges = image_ranges(self.images, self.held.shards)

        def write(session: Session) -> None:
            lifecycle.heartbeat(session, self.held, stage="scoring", images_done=0, images_total=self.images)
            shards.divide(session, self.services.blobs, self.held, predictions_sha256=self.arrays_sha256, ranges=ranges)

        self._write(write)
        self.services.queue.enqueue_shards(self.held.submission_id, self.held.attempt, len(ranges))

    def _work_through(self, sandbox: Sandbox) -> tuple[str, ...] | None:
        """Work on whatever shard waits until all are done; None when one of them will never be."""
        while True:
            standing = patiently(self.services, lambda session: shards.standing(session, self.held), reads_only=True)
            self.progress = Progress(stage="scoring", done=standing.images_done, total=standing.images_total)
            self._heartbeat_when_due()
            if standing.failure:
                self._give_up(*standing.failure)
                return None
            if standing.complete:
                return standing.digests
            self._work_on_one(sandbox)

    def _work_on_one(self, sandbox: Sandbox) -> None:
        """Work on a shard that waits, or wait a moment when others hold all that remain."""
        held = self.held

        def claim(session: Session) -> ShardClaim | None:
            return shards.claim(
                session, held.submission_id, held.attempt, worker=held.worker, lease_s=self.services.settings.lease_s
            )

        taken = patiently(self.services, claim)
        if taken is None:
            time.sleep(LOOK_S)
        else:
            with suppress(ShardLost):
                ShardWork(self.services, taken, beat_also=self._heartbeat_when_due).work(sandbox)

    def _give_up(self, code: str, detail: str) -> None:
        """End the attempt as the shard ended."""
        if code in shards.FINAL_CODES:
            self.fail(code, detail)
        else:
            self.lose(code, detail)

    def _reduction(self, results: tuple[str, ...]) -> Reduction:
        settings, held = self.services.settings, self.held
        return Reduction(
            shards=tuple(str(self.services.blobs.local_path(sha256)) for sha256 in results),
            predictions=str(self.services.blobs.local_path(self.arrays_sha256)),
            predictions_sha256=held.predictions_sha256,
            ground_truth_sha256=held.ground_truth_sha256,
            protocol=held.protocol,
            folder=str(self.folder),
            memory_bytes=settings.score_memory_bytes,
            time_s=settings.score_time_s,
        )


def _keep_file(services: Services, path: Path) -> str:
    """Put a result into the blob store, which takes the file itself, and return its digest."""
    sha256 = digest_file(path)
    services.blobs.put_file(path, sha256)
    return sha256


def _nothing() -> None:
    """Beat nothing else."""


@dataclass(slots=True)
class ShardWork:
    """One claim of a shard being worked on."""

    services: Services
    held: ShardClaim
    beat_also: Callable[[], None] = _nothing
    """Called again and again, for another lease that must not run out meanwhile."""
    last_heartbeat_s: float = field(default_factory=time.monotonic)
    concluded: bool = False
    """True once the shard waits again or is done."""

    @property
    def folder(self) -> Path:
        """Where the child writes its result."""
        return self.services.blobs.incoming / f"{self.held.name}.d"

    def work(self, sandbox: Sandbox) -> None:
        """Run the job and follow its events to the end.

        Raises:
            ShardLost: Another worker took the shard, or its attempt is over.
        """
        try:
            with beating(self.services, self._beat):
                job = self._job()
            with closing(sandbox.events(job, tick_s=self.services.settings.heartbeat_s)) as events:
                for event in events:
                    self._follow(event)
                    self._beat()
        finally:
            shutil.rmtree(self.folder, ignore_errors=True)

    def _job(self) -> ShardJob:
        settings, blobs, held = self.services.settings, self.services.blobs, self.held
        return ShardJob(
            predictions=str(blobs.local_path(held.predictions_sha256)),
            ground_truth=str(blobs.local_path(held.ground_truth_sha256)),
            protocol=held.protocol,
            first_image=held.images.start,
            end_image=held.images.stop,
            folder=emptied(self.folder),
            memory_bytes=settings.score_memory_bytes,
            time_s=settings.score_time_s,
        )

    def _follow(self, event: Event | None) -> None:
        match event:
            case Matched():
                self._matched()
            case Broken(detail=detail):
                self.fail(shards.EVALUATOR_ERROR, f"the evaluator broke down: {detail}")
            case Exit(status=status) if not self.concluded:
                self.lose(*cause_of(status, self.services))

    def _beat(self) -> None:
        """Renew the lease, and what else there is; a database that is away or full is asked again at the next beat."""
        self.beat_also()
        if self.concluded or time.monotonic() - self.last_heartbeat_s < self.services.settings.heartbeat_s:
            return
        self.last_heartbeat_s = time.monotonic()
        try:
            with self.services.transaction() as session:
                shards.heartbeat(session, self.held)
        except (Unavailable, StorageFull) as error:
            log.warning("heartbeat_failed", error=repr(error))

    def _matched(self) -> None:
        sha256 = _keep_file(self.services, self.folder / "shard")
        self._conclude(lambda session: shards.finish(session, self.services.blobs, self.held, result_sha256=sha256))

    def fail(self, code: str, detail: str) -> None:
        """Let the holder end the submission as failed; the code says that trying again would not help."""
        self.lose(code, detail)

    def lose(self, code: str, detail: str, *, again_at_once: bool = True) -> None:
        """Count the claim as lost; the holder works on the shard again, or loses its attempt at the cap."""
        del again_at_once
        log.warning("shard_claim_lost", shard=self.held.name, code=code, detail=detail)
        with end_is_written_elsewhere():
            self._conclude(lambda session: shards.lose(session, self.held, code=code, detail=detail))

    def give_back(self, detail: str) -> None:
        """Let the shard wait again."""
        log.warning("shard_given_back", shard=self.held.name, detail=detail)
        with end_is_written_elsewhere():
            self._conclude(lambda session: shards.give_back(session, self.held))

    def _conclude(self, write: Callable[[Session], None]) -> None:
        patiently(self.services, write)
        self.concluded = True
