"""Resampling: what a leaderboard needs to say how far its ranking can be trusted, computed after the score is recorded.

Nobody waits for it: a submission is `scored` without it. A score waits for resampling as long as it has no row of
replicates; the row is written once. It needs no lease: two workers at the same score compute the same bytes, and the
second one's are dropped. A try that came to no end (killed, too slow on a busy machine) says nothing about the score: it is
made again after `RETRY_AFTER`, and the audit trail counts such tries, so that a score that ends each of them is given up.
"""

from datetime import datetime, timedelta

import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import audit, database
from server.models import AuditEvent, Score, ScoreReplicates
from server.queue import PRIORITY_LATER
from server.services import Services

NONE_POSSIBLE = b""
"""The replicates of a score that has none: too few images, or a protocol or a score that cannot be resampled."""

MOST_TRIES = 3
"""After so many that came to no end a score gets `NONE_POSSIBLE`: what always takes too long would busy a worker for ever."""

RETRY_AFTER = timedelta(hours=1)
"""Between two such tries, so that what was wrong with the machine may be over."""

_CAME_TO_NO_END = "score.not_resampled"
_MOST_AT_ONCE = 100


def statistics_waiting(session: Session, score_id: int) -> str | None:
    """Find what is to be resampled.

    Returns:
        Digest of the statistics; None when the score is unknown, is resampled already or has no statistics.
    """
    return session.scalar(sa.select(Score.statistics_sha256).where(Score.id == score_id, _waits()))


def keep(session: Session, score_id: int, replicates: bytes) -> None:
    """Write the replicates of a score, unless another worker did.

    Args:
        session: Of the transaction.
        score_id: Of which score.
        replicates: `evaluator.score_replicates.ScoreReplicates.to_bytes`, or `NONE_POSSIBLE`.
    """
    if session.scalar(sa.select(Score.id).where(Score.id == score_id).with_for_update(key_share=True)) is None:
        return
    if session.get(ScoreReplicates, score_id) is None:
        session.add(ScoreReplicates(score_id=score_id, data=replicates))
        session.flush()


def count_try(session: Session, score_id: int, *, worker: str, reason: str) -> None:
    """Write down that a try came to no end; the last of `MOST_TRIES` leaves the score without replicates.

    Args:
        session: Of the transaction.
        score_id: Of which score.
        worker: Who tried.
        reason: What ended it, for maintainers.
    """
    subject = f"{Score.__tablename__}:{score_id}"
    audit.record(session, actor=f"worker:{worker}", action=_CAME_TO_NO_END, subject=subject, reason=reason)
    session.flush()
    tries = sa.select(sa.func.count()).where(AuditEvent.subject == subject, AuditEvent.action == _CAME_TO_NO_END)
    if session.scalars(tries).one() >= MOST_TRIES:
        keep(session, score_id, NONE_POSSIBLE)


def sweep(services: Services) -> int:
    """Send a message for scores that wait for longer than usual, while no such message waits.

    Returns:
        How many messages were sent.
    """
    with services.snapshot() as session:
        now = database.now(session)
        overdue = Score.created_at < now - timedelta(seconds=services.settings.resend_s)
        query = sa.select(Score.id).where(_waits(), overdue, ~_tried_since(now - RETRY_AFTER)).order_by(Score.id.desc())
        waiting = list(session.scalars(query.limit(_MOST_AT_ONCE)))
    if not waiting or services.queue.depth(PRIORITY_LATER) != 0:
        return 0
    return sum(services.queue.enqueue_resampling(score_id) for score_id in waiting)


def _waits() -> sa.ColumnElement[bool]:
    resampled = sa.exists().where(ScoreReplicates.score_id == Score.id)
    return sa.and_(Score.statistics_sha256.is_not(None), ~resampled)


def _tried_since(moment: datetime) -> sa.ColumnElement[bool]:
    subject = sa.literal(f"{Score.__tablename__}:") + sa.cast(Score.id, sa.String)
    tried = (AuditEvent.subject == subject, AuditEvent.action == _CAME_TO_NO_END, AuditEvent.at > moment)
    return sa.exists().where(*tried)
