"""The life of one submission in a re-scoring; the submission itself stays `scored` all the while.

    waiting  -> running, excluded
    running  -> done, failed; waiting when the lease expires, the scoring process dies or the worker drains
    failed   -> waiting or excluded, when a maintainer says so
    excluded -> waiting, likewise

It has the functions of server/lifecycle.py that a worker needs, with the same rules: each change is a compare-and-set on
the item's row, and what a worker writes carries its attempt as a fence. The database refuses any other change by trigger.
A discarded re-scoring ends every hold on its items.
"""

from datetime import timedelta
from typing import Any, cast

import msgspec
import sqlalchemy as sa
from sqlalchemy.orm import Session

from evaluator.protocol import EVALUATOR_VERSION
from server import audit, database, lifecycle
from server.claims import Claim, Result
from server.errors import Conflict, LeaseLost
from server.models import ItemState, Rescoring, RescoringItem, RescoringState, Score
from server.ranking import Basis

WAITING, RUNNING, DONE = ItemState.WAITING, ItemState.RUNNING, ItemState.DONE
FAILED, EXCLUDED = ItemState.FAILED, ItemState.EXCLUDED

TRANSITIONS: dict[ItemState, frozenset[ItemState]] = {
    WAITING: frozenset({RUNNING, EXCLUDED}),
    RUNNING: frozenset({WAITING, DONE, FAILED}),
    DONE: frozenset(),
    FAILED: frozenset({WAITING, EXCLUDED}),
    EXCLUDED: frozenset({WAITING}),
}
"""What may follow what; migrations/ has the same table as a trigger, and a test holds them together."""


def claim(session: Session, item_id: int, *, worker: str, lease_s: float) -> Claim | None:
    """Take a waiting item: raise the attempt, start the lease.

    Args:
        session: Of the transaction; once it is committed the claim holds.
        item_id: From a message; it may be unknown, delivered twice or long done.
        worker: The worker's name.
        lease_s: Seconds until the item is taken back unless `heartbeat` renews.

    Returns:
        None when there is nothing to do: unknown, held, done, of a re-scoring that ended, or of another evaluator.
    """
    item = _lock(session, item_id, RescoringItem.state == WAITING)
    if item is None or item.rescoring.evaluator_version != EVALUATOR_VERSION:
        return None
    item.attempt += 1
    item.state = RUNNING
    item.lease_expires_at = database.now(session) + timedelta(seconds=lease_s)
    session.flush()
    rescoring, ground_truth = item.rescoring, item.rescoring.ground_truth
    return Claim(
        submission_id=item.submission_id,
        item_id=item.id,
        attempt=item.attempt,
        worker=worker,
        lease_s=lease_s,
        validated=True,
        predictions_sha256=item.submission.predictions_sha256,
        ground_truth_id=ground_truth.id,
        ground_truth_sha256=ground_truth.sha256,
        image_list_sha256=ground_truth.image_list_sha256,
        protocol=rescoring.protocol,
    )


def heartbeat(session: Session, held: Claim, *, stage: str, images_done: int, images_total: int) -> None:
    """Renew the lease; nobody waits for the progress of one item.

    Raises:
        LeaseLost: The item was taken back; stop working on it.
    """
    del stage, images_done, images_total
    changed = cast(
        "sa.CursorResult[Any]",
        session.execute(
            sa.update(RescoringItem)
            .where(*_fence(held), RescoringItem.rescoring_id.in_(_running()))
            .values(lease_expires_at=database.now(session) + timedelta(seconds=held.lease_s))
        ),
    )
    if changed.rowcount != 1:
        raise LeaseLost(_lost(held))


def record_score(session: Session, held: Claim, result: Result) -> Score:
    """Write the score beside those there are, the item's end and the audit event: all of them or none.

    What the integrity audit finds is kept with the score and holds nothing: the maintainer sees it in the diff. Where a
    re-scoring that was discarded left the same score, that one stands: an exclusion that is taken back comes here.

    Raises:
        LeaseLost: The item was taken back; its score comes from another attempt.
        Conflict: The scoring process was of another evaluator than the re-scoring.
    """
    item = _lock_held(session, held)
    score = lifecycle.new_score(session, held, result)
    if Basis.of(score) != Basis.of(item.rescoring):
        message = f"the score is by evaluator {score.evaluator_version}; restart the worker after an upgrade"
        raise Conflict(message)
    score.integrity = msgspec.to_builtins(result.integrity)
    score = _kept(session, score)
    item.state, item.score_id, item.lease_expires_at = DONE, score.id, None
    session.flush()
    audit.record(
        session,
        actor=held.actor,
        action="rescoring.scored",
        subject=f"submission:{item.submission_id}",
        rescoring=item.rescoring_id,
        attempt=held.attempt,
        score=score.id,
        mds=score.mds,
    )
    return score


def _kept(session: Session, score: Score) -> Score:
    """Add a score, unless there is one of its signature."""
    same = sa.select(Score).where(
        Score.submission_id == score.submission_id,
        Score.protocol_version == score.protocol_version,
        Basis.of(score).fits(),
    )
    known = session.scalar(same)
    if known is None:
        session.add(score)
        session.flush()
    return known or score


def fail(session: Session, held: Claim, *, code: str, detail: str) -> None:
    """End the item as `failed`: trying again would not help.

    Raises:
        LeaseLost: The item was taken back.
    """
    _fail(session, _lock_held(session, held), actor=held.actor, code=code, detail=detail)


def give_back(session: Session, held: Claim, *, detail: str) -> None:
    """Let the item wait again without counting the attempt; the sweeper sends a new message.

    Raises:
        LeaseLost: The item was taken back.
    """
    del detail
    _wait_again(session, _lock_held(session, held))


def lose(session: Session, held: Claim, *, code: str, detail: str) -> ItemState:
    """Count the attempt as lost; the item waits again, or fails at the phase's cap.

    Raises:
        LeaseLost: The item was taken back.
    """
    return _lose(session, _lock_held(session, held), actor=held.actor, code=code, detail=detail)


def expire(session: Session, item_id: int) -> ItemState | None:
    """Take an item back from a worker whose lease ran out.

    Returns:
        The state it is in now, None when its lease has not run out (any more).
    """
    item = _lock(session, item_id, RescoringItem.lease_expires_at <= database.now(session))
    if item is None:
        return None
    detail = f"attempt {item.attempt} was silent for longer than its lease"
    return _lose(session, item, actor=audit.SWEEPER, code=lifecycle.ATTEMPTS_EXHAUSTED, detail=detail)


def _lose(session: Session, item: RescoringItem, *, actor: str, code: str, detail: str) -> ItemState:
    item.lost_attempts += 1
    if item.lost_attempts >= item.rescoring.phase.max_attempts:
        _fail(session, item, actor=actor, code=code, detail=detail)
    else:
        _wait_again(session, item)
    return item.state


def _wait_again(session: Session, item: RescoringItem) -> None:
    item.state, item.lease_expires_at, item.enqueued_at = WAITING, None, None
    session.flush()


def _fail(session: Session, item: RescoringItem, *, actor: str, code: str, detail: str) -> None:
    item.state, item.lease_expires_at = FAILED, None
    item.failure_code, item.failure_detail = code, detail
    session.flush()
    audit.record(
        session,
        actor=actor,
        action="rescoring.failed",
        subject=f"submission:{item.submission_id}",
        rescoring=item.rescoring_id,
        attempt=item.attempt,
        code=code,
        detail=detail,
    )


def _running() -> sa.Select[int]:
    """Name the re-scorings that have not ended."""
    return sa.select(Rescoring.id).where(Rescoring.state == RescoringState.RUNNING)


def _fence(held: Claim) -> tuple[sa.ColumnElement[bool], ...]:
    """Match the row only while this very attempt holds it."""
    return (
        RescoringItem.id == held.item_id,
        RescoringItem.attempt == held.attempt,
        RescoringItem.state == RUNNING,
    )


def _lock_held(session: Session, held: Claim) -> RescoringItem:
    """Lock the row under the fence."""
    item = _lock(session, held.item_id, *_fence(held))
    if item is None:
        raise LeaseLost(_lost(held))
    return item


def _lost(held: Claim) -> str:
    return f"attempt {held.attempt} of re-scoring item {held.item_id} no longer holds it"


def _lock(session: Session, item_id: int | None, *conditions: sa.ColumnElement[bool]) -> RescoringItem | None:
    """Lock an item of a running re-scoring, and keep the re-scoring from ending meanwhile."""
    of_item = sa.select(RescoringItem.rescoring_id).where(RescoringItem.id == item_id).scalar_subquery()
    running = sa.select(Rescoring).where(Rescoring.id == of_item, Rescoring.state == RescoringState.RUNNING)
    if session.scalar(running.with_for_update(read=True).execution_options(populate_existing=True)) is None:
        return None
    query = sa.select(RescoringItem).where(RescoringItem.id == item_id, *conditions).with_for_update()
    return session.scalar(query.execution_options(populate_existing=True))
