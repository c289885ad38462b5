"""Safeguards taken out one at a time, to show that the fault programme notices. Never used otherwise.

Each is a change to one function of a process of the programme, asked for by name in its environment. What goes wrong
without them is left to the programme, with one exception: `without_unique_key` says why it misbehaves itself.
"""

import functools
import os
import uuid
from collections.abc import Callable
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import lifecycle, submissions, sweeper
from server.claims import Claim
from server.models import Score, Submission
from server.queue import Queue
from server.settings import Settings

VARIABLE = "CS3D_TEST_SABOTAGE"


def install() -> None:
    """Take out what the environment names."""
    name = os.environ.get(VARIABLE)
    if name:
        SABOTAGES[name]()


def without_fence() -> None:
    """Let a worker write although it lost its submission."""

    def any_row(session: Session, held: Claim) -> Submission:
        return session.get_one(Submission, held.submission_id)

    lifecycle._lock_held = any_row


def without_unique_key() -> None:
    """Write every score twice, into a table that no longer refuses it.

    Without the key alone nothing goes wrong that could be noticed: the fence, the row's lock and the order of states
    each keep a second write away. So the second write is put in here, and what is shown is that the check sees it.
    """
    original = lifecycle.record_score

    @functools.wraps(original)
    def record_twice(session: Session, *arguments: Any) -> Score | None:
        score = original(session, *arguments)
        if score is None:
            return None
        columns = [column.name for column in sa.inspect(Score).columns if column.name != "id"]
        values = {name: getattr(score, name) for name in columns}
        session.execute(sa.insert(Score).values(**values))
        return score

    setattr(lifecycle, "record_score", record_twice)  # noqa: B010 - the checker of types minds a plain assignment


def with_early_message() -> None:
    """Send the message from inside the transaction, and not after the commit."""
    original, enqueue = submissions.receive, Queue.enqueue
    queue = Queue(Settings())
    sent: set[uuid.UUID] = set()

    @functools.wraps(original)
    def receive(session: Session, **named: Any) -> Submission:
        submission = original(session, **named)
        sent.add(submission.id)
        enqueue(queue, submission.id)
        return submission

    def enqueue_unless_sent(self: Queue, submission_id: uuid.UUID, **named: Any) -> bool:
        return submission_id in sent or enqueue(self, submission_id, **named)

    submissions.receive = receive
    setattr(Queue, "enqueue", enqueue_unless_sent)  # noqa: B010 - the checker of types minds a plain assignment


def without_sweeper() -> None:
    """Never send a message again."""
    sweeper._send_again = lambda services: 0  # noqa: ARG005 - the original's signature


SABOTAGES: dict[str, Callable[[], None]] = {
    "fence": without_fence,
    "unique_key": without_unique_key,
    "early_message": with_early_message,
    "sweeper": without_sweeper,
}
