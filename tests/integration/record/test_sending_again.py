"""When a message is sent again: by the sweeper although the broker is full of others, and after a queue was closed."""

import uuid
from datetime import timedelta

import pytest
import sqlalchemy as sa

from server import database, sweeper
from server.models import Submission
from server.queue import Queue
from tests.services.installation import Installation

RESEND_S = 1000.0
"""So long that the test's own time does not matter."""


@pytest.mark.parametrize("services", [{"resend_s": RESEND_S}], indirect=True)
@pytest.mark.parametrize(
    ("age_s", "sent"),
    [
        (0.5 * RESEND_S, 0),
        (2 * RESEND_S, 0),  # overdue, but three messages wait for one submission: one of them may be its own
        (sweeper.FAR_OVERDUE * RESEND_S + 1, 1),  # none of them was
    ],
)
def test_a_long_queue_hides_no_lost_message_for_ever(installation: Installation, age_s: float, sent: int) -> None:
    """Messages of others put off a second message, but not without end."""
    submission_id = installation.submit(enqueue=False)
    for _ in range(3):
        installation.services.queue.enqueue(uuid.uuid4())
    with installation.services.transaction() as session:
        enqueued_at = database.now(session) - timedelta(seconds=age_s)
        session.execute(sa.update(Submission).where(Submission.id == submission_id).values(enqueued_at=enqueued_at))
    assert sweeper.sweep(installation.services).sent == sent


def test_a_closed_queue_takes_the_broker_from_nobody(installation: Installation) -> None:
    """Queues of one process share their connections; whoever closes one leaves a broker that the others can send to."""
    ours = installation.services.queue
    other = Queue(installation.settings)
    assert (ours.enqueue(uuid.uuid4()), other.enqueue(uuid.uuid4())) == (True, True)
    other.close()
    assert ours.enqueue(uuid.uuid4())
    later = Queue(installation.settings)
    assert later.enqueue(uuid.uuid4())
    later.close()
    assert ours.depth() == 4
