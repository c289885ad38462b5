"""Resampling: what a leaderboard needs to say how far its ranking can be trusted, computed after the score is recorded.

Nobody waits for it: a submission is `scored` without it. A score waits for resampling as long as it has no row of
replicates; the row is written once. It needs no lease: two workers at the same score compute the same bytes, and the
second one's are dropped.
"""

from datetime import timedelta

import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import database
from server.models import Score, ScoreReplicates
from server.queue import PRIORITY_LATER
from server.services import Services

NONE_POSSIBLE = b""
"""The replicates of a score that has none: too few images, or a protocol or a score that cannot be resampled."""

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


def sweep(services: Services) -> int:
    """Send a message for scores that wait for longer than usual, while no such message waits.

    Returns:
        How many messages were sent.
    """
    with services.snapshot() as session:
        before = database.now(session) - timedelta(seconds=services.settings.resend_s)
        query = sa.select(Score.id).where(_waits(), Score.created_at < before).order_by(Score.id.desc())
        waiting = list(session.scalars(query.limit(_MOST_AT_ONCE)))
    if not waiting or services.queue.depth(PRIORITY_LATER) != 0:
        return 0
    return sum(services.queue.enqueue_resampling(score_id) for score_id in waiting)


def _waits() -> sa.ColumnElement[bool]:
    resampled = sa.exists().where(ScoreReplicates.score_id == Score.id)
    return sa.and_(Score.statistics_sha256.is_not(None), ~resampled)
