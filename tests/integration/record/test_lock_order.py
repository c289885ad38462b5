"""Transactions that meet wait for each other in one order: docs/architecture.md names it. On PostgreSQL."""

import threading
import uuid
from collections.abc import Callable, Iterator

import pytest
import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import lifecycle, quota, rescoring, rescoring_decisions, submissions
from server.errors import NotScored, ServerError
from server.models import Submission
from tests.integration.record.three_methods import Rescored
from tests.services.installation import Installation
from tests.services.processes import wait_until
from worker.sandbox import Sandbox

pytestmark = pytest.mark.parametrize("shape", ["scale_out"])


@pytest.fixture(scope="module")
def sandbox() -> Iterator[Sandbox]:
    """Give the worker's scoring process."""
    sandbox = Sandbox()
    sandbox.start()
    yield sandbox
    sandbox.kill()


def _publish_meanwhile(
    installation: Installation, submission_id: uuid.UUID, first: Callable[[Session], object],
    second: Callable[[Session], object],
) -> ServerError | None:  # fmt: skip
    """Publish a submission from another thread between two steps of one transaction.

    The second step comes once the publication waits for a lock that the first one took.

    Returns:
        What the publication was refused with, None when it was not.
    """
    refusals: list[ServerError] = []

    def publish() -> None:
        try:
            with installation.services.transaction() as session:
                submissions.publish(session, submissions.find(session, submission_id), "user:1")
        except ServerError as error:
            refusals.append(error)

    thread = threading.Thread(target=publish)
    with installation.services.transaction() as session:
        first(session)
        thread.start()
        wait_until(lambda: _waiting(installation), what="the publication to wait for a lock")
        second(session)
    thread.join()
    return refusals[0] if refusals else None


def _waiting(installation: Installation) -> bool:
    """Say whether any transaction of this database waits for a lock."""
    query = sa.text(
        "SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() AND wait_event_type = 'Lock'"
    )
    with installation.services.snapshot() as session:
        return bool(session.scalar(query))


def test_a_refund_meets_a_publication(installation: Installation) -> None:
    """Cancelling locks the submission, then the team; a publication that waits for the one does not hold the other."""
    submission_id = installation.submit(enqueue=False)
    lock = sa.select(Submission.id).where(Submission.id == submission_id).with_for_update()
    refusal = _publish_meanwhile(
        installation,
        submission_id,
        lambda session: session.execute(lock),
        lambda session: lifecycle.cancel(session, submission_id, actor="user:1"),
    )
    assert isinstance(refusal, NotScored)


def test_a_submission_is_received_while_its_team_is_locked(installation: Installation) -> None:
    """Its blob's row is written before it waits for the team: the sweeper of files, which locks that table, goes first."""
    thread = threading.Thread(target=installation.submit, kwargs={"enqueue": False})
    writers = sa.text(
        "SELECT count(*) FROM pg_locks JOIN pg_database ON pg_database.oid = database AND datname = current_database()"
        " WHERE relation = 'blob'::regclass AND mode = 'RowExclusiveLock' AND granted"
    )
    with installation.services.transaction() as session:
        quota.lock_team(session, installation.team.id)
        thread.start()
        wait_until(lambda: _waiting(installation), what="the upload to wait for its team")
        assert session.scalar(writers) == 1
    thread.join()


def test_putting_a_rescoring_in_force_meets_a_publication(installation: Installation, sandbox: Sandbox) -> None:
    """Whoever publishes relies on the phase first and holds no submission that the re-scoring's publication needs."""
    rescored = Rescored(installation, sandbox)
    rescored.add("complete")
    waiting = rescored.add("partial", publish=False)
    rescored.work(*rescored.start())
    refusal = _publish_meanwhile(
        installation,
        waiting,
        lambda session: rescoring.lock_phase(session, rescored.phase(session)),
        lambda session: rescoring_decisions.publish(session, rescored.phase(session), "admin:test"),
    )
    assert refusal is None
    assert rescored.board() == [("partial", 1), ("complete", 2)]
