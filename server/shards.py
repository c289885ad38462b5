"""Sharded scoring: how the workers share the images of one submission. The rows say what is true; messages are hints.

The worker that claimed the submission holds it to the end. It divides the images into shards; any worker, itself
included, claims a shard with a lease of its own, keeps the range's statistics as a blob and writes its digest:

    waiting -> held -> done
       ^        |
       +--------+   lease ran out, process died, given back

Whatever ends the attempt deletes its shards in the same transaction (`forget`): the rows are the fence of the attempt,
as `claims` is that of the shard. Shards change no state of the submission; only its holder does.
"""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, cast

import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import database
from server.blobs import Blobs
from server.claims import Claim, ShardClaim
from server.errors import ShardLost, Unavailable
from server.models import Shard

CAP = 3
"""Claims of a shard that may be lost before its attempt is."""
EVALUATOR_ERROR, BLOB_MISSING = "evaluator_error", "blob_missing"
FINAL_CODES = frozenset({EVALUATOR_ERROR, BLOB_MISSING})
"""Failure codes of shards that no further claim would help."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """How far the shards of an attempt are."""

    images_done: int
    images_total: int
    results: tuple[str | None, ...]
    """Digest of each shard's result, in the order of the images; None: not done."""
    failure: tuple[str, str] | None
    """Code and detail of a shard that will not be done."""

    @property
    def complete(self) -> bool:
        """True when every shard is done."""
        return bool(self.results) and None not in self.results

    @property
    def digests(self) -> tuple[str, ...]:
        """The results that are there."""
        return tuple(sha256 for sha256 in self.results if sha256 is not None)


def divide(session: Session, blobs: Blobs, held: Claim, *, predictions_sha256: str, ranges: Sequence[range]) -> None:
    """Make the shards of an attempt, once. Call it in a transaction that holds the submission under its fence.

    Args:
        session: Of the transaction.
        blobs: Has the predictions.
        held: The attempt.
        predictions_sha256: The validated predictions as arrays.
        ranges: The images of each shard, in order.

    Raises:
        Unavailable: The blob is not in the store.
    """
    made = sa.exists().where(Shard.submission_id == held.submission_id, Shard.attempt == held.attempt)
    if session.scalar(sa.select(made)):
        return
    session.add_all(
        Shard(
            submission_id=held.submission_id,
            attempt=held.attempt,
            number=number,
            first_image=images.start,
            end_image=images.stop,
            predictions_sha256=predictions_sha256,
            ground_truth_sha256=held.ground_truth_sha256,
            protocol=held.protocol,
        )
        for number, images in enumerate(ranges)
    )
    session.flush()
    _require(blobs, predictions_sha256)


def claim(
    session: Session, submission_id: uuid.UUID, attempt: int, number: int | None = None, *, worker: str, lease_s: float
) -> ShardClaim | None:
    """Take a shard that waits, or whose worker was silent for longer than its lease.

    Args:
        session: Of the transaction; once it is committed the claim holds.
        submission_id: From a message, or what the caller holds.
        attempt: Likewise.
        number: Which shard; None: the last that waits. Messages name the first ones first, so the two meet late.
        worker: The worker's name.
        lease_s: Seconds until others may take it unless `heartbeat` renews.

    Returns:
        None when there is nothing to do: unknown, done, held by another worker, or lost too often.
    """
    at = database.now(session)
    query = (
        sa.select(Shard)
        .where(
            Shard.submission_id == submission_id,
            Shard.attempt == attempt,
            Shard.result_sha256.is_(None),
            sa.or_(Shard.lease_expires_at.is_(None), Shard.lease_expires_at < at),
            Shard.claims - Shard.returned < CAP,
            sa.func.coalesce(Shard.failure_code, "").not_in(FINAL_CODES),
        )
        .order_by(Shard.number.desc())
        .limit(1)
        .with_for_update(skip_locked=True)
    )
    shard = session.scalar(query if number is None else query.where(Shard.number == number))
    if shard is None:
        return None
    shard.claims += 1
    shard.worker = worker
    shard.lease_expires_at = at + timedelta(seconds=lease_s)
    shard.failure_code = shard.failure_detail = None
    session.flush()
    return ShardClaim(
        submission_id=submission_id,
        attempt=attempt,
        number=shard.number,
        claim=shard.claims,
        lease_s=lease_s,
        predictions_sha256=shard.predictions_sha256,
        ground_truth_sha256=shard.ground_truth_sha256,
        protocol=shard.protocol,
        images=range(shard.first_image, shard.end_image),
    )


def heartbeat(session: Session, taken: ShardClaim) -> None:
    """Renew the lease.

    Raises:
        ShardLost: It was taken by another worker, or the attempt is over; stop working on it.
    """
    _write(session, taken, lease_expires_at=database.now(session) + timedelta(seconds=taken.lease_s))


def finish(session: Session, blobs: Blobs, taken: ShardClaim, *, result_sha256: str) -> None:
    """Write the result.

    Raises:
        ShardLost: It was taken by another worker, or the attempt is over.
        Unavailable: The blob is not in the store.
    """
    _write(session, taken, lease_expires_at=None, result_sha256=result_sha256)
    _require(blobs, result_sha256)


def lose(session: Session, taken: ShardClaim, *, code: str, detail: str) -> None:
    """Let the shard wait again, with the claim counted: its process died.

    Raises:
        ShardLost: It was taken by another worker, or the attempt is over.
    """
    _write(session, taken, lease_expires_at=None, failure_code=code, failure_detail=detail)


def give_back(session: Session, taken: ShardClaim) -> None:
    """Let the shard wait again without counting the claim: the worker lacks what it needs.

    Raises:
        ShardLost: It was taken by another worker, or the attempt is over.
    """
    _write(session, taken, lease_expires_at=None, returned=Shard.returned + 1)


def standing(session: Session, held: Claim) -> Standing:
    """Say how far the shards of an attempt are; none of them when the attempt is over."""
    query = sa.select(Shard).where(Shard.submission_id == held.submission_id, Shard.attempt == held.attempt)
    shards = session.scalars(query.order_by(Shard.number)).all()
    at = database.now(session)
    spent = (shard for shard in shards if _is_spent(shard) and not (shard.lease_expires_at or at) > at)
    return Standing(
        images_done=sum(shard.end_image - shard.first_image for shard in shards if shard.result_sha256),
        images_total=sum(shard.end_image - shard.first_image for shard in shards),
        results=tuple(shard.result_sha256 for shard in shards),
        failure=next((_failure(shard) for shard in spent), None),
    )


def forget(session: Session, submission_id: uuid.UUID) -> None:
    """Delete the shards of a submission whose attempt ends; the blobs are swept after the grace time."""
    session.execute(sa.delete(Shard).where(Shard.submission_id == submission_id))


def _is_spent(shard: Shard) -> bool:
    lost_too_often = shard.claims - shard.returned >= CAP or shard.failure_code in FINAL_CODES
    return lost_too_often and not shard.result_sha256


def _failure(shard: Shard) -> tuple[str, str]:
    where = f"images {shard.first_image} to {shard.end_image - 1}"
    if shard.failure_code is None:
        return "shard_lost", f"{where}: {CAP} workers were silent for longer than their lease"
    return shard.failure_code, f"{where}: {shard.failure_detail}"


def _write(session: Session, taken: ShardClaim, **values: Any) -> None:  # noqa: ANN401 - columns
    """Change the row while this very claim holds it."""
    fence = (
        Shard.submission_id == taken.submission_id,
        Shard.attempt == taken.attempt,
        Shard.number == taken.number,
        Shard.claims == taken.claim,
        Shard.lease_expires_at.is_not(None),
    )
    changed = session.execute(sa.update(Shard).where(*fence).values(**values))
    if cast("sa.CursorResult[Any]", changed).rowcount != 1:
        message = f"claim {taken.claim} no longer holds {taken.name}"
        raise ShardLost(message)


def _require(blobs: Blobs, sha256: str) -> None:
    """Check a blob once the row that keeps it is written: the sweeper holds the table's lock while it deletes."""
    if not blobs.exists(sha256):
        message = f"blob {sha256} is not in the store any more; put it again"
        raise Unavailable(message)
