"""The sweeper of re-scorings: adds what was scored meanwhile, takes back what lost workers held, sends again.

Part of every pass of server/sweeper.py, with the same rules; items are counted against bulk messages alone.
"""

from datetime import timedelta

import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import database, rescoring, rescoring_items
from server.models import ItemState, Rescoring, RescoringItem, RescoringState
from server.queue import PRIORITY_BULK
from server.services import Services


def sweep(services: Services) -> int:
    """Sweep once; nothing is locked where no re-scoring runs.

    Returns:
        How many messages were sent.
    """
    with services.snapshot() as session:
        running = list(session.scalars(sa.select(Rescoring).where(Rescoring.state == RescoringState.RUNNING)))
        if not running:
            return 0
        lost = _items(session, RescoringItem.lease_expires_at < database.now(session))
        behind = [one for one in running if rescoring.uncovered(session, one)]
    for item_id in lost:
        with services.transaction() as session:
            rescoring_items.expire(session, item_id)
    for one in behind:
        with services.transaction() as session:
            rescoring.cover(session, one, sent=False)
    return _send_again(services)


def _send_again(services: Services) -> int:
    """Send a message for every item that waits without one."""
    with services.snapshot() as session:
        deadline = database.now(session) - timedelta(seconds=services.settings.resend_s)
        unsent = _waiting(session, RescoringItem.enqueued_at.is_(None))
        overdue = _waiting(session, RescoringItem.enqueued_at < deadline)
        waiting = _waiting(session, sa.true())
    depth = services.queue.depth(PRIORITY_BULK) if unsent or overdue else None
    if depth is None:
        return 0
    due = unsent + (overdue if depth < len(waiting) else [])
    return sum(_send(services, item_id) for item_id in due)


def _send(services: Services, item_id: int) -> bool:
    """Send first and note it after, as for submissions."""
    if not services.queue.enqueue_item(item_id):
        return False
    with services.transaction() as session:
        waiting = (RescoringItem.id == item_id, RescoringItem.state == ItemState.WAITING)
        session.execute(sa.update(RescoringItem).where(*waiting).values(enqueued_at=database.now(session)))
    return True


def _waiting(session: Session, condition: sa.ColumnElement[bool]) -> list[int]:
    return _items(session, RescoringItem.state == ItemState.WAITING, condition)


def _items(session: Session, *conditions: sa.ColumnElement[bool]) -> list[int]:
    """List items of running re-scorings, oldest first."""
    query = (
        sa.select(RescoringItem.id)
        .join(RescoringItem.rescoring)
        .where(Rescoring.state == RescoringState.RUNNING, *conditions)
        .order_by(RescoringItem.id)
    )
    return list(session.scalars(query))
