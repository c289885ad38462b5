"""What the record refuses, whoever asks: illegal transitions, late writes, changed history. In both shapes."""

import importlib.util
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import audit, database, lifecycle
from server.blobs import record_blob
from server.claims import Claim
from server.errors import IllegalTransition, LeaseLost
from server.lifecycle import TRANSITIONS
from server.models import Attempt, AttemptOutcome, AuditEvent, QuotaEntry, QuotaKind, Submission, SubmissionState
from tests.services.installation import Installation

STATES = list(SubmissionState)


def _claim(installation: Installation, submission_id: uuid.UUID, lease_s: float = 60.0) -> Claim:
    with installation.services.transaction() as session:
        held = lifecycle.claim(session, submission_id, worker="w", lease_s=lease_s)
    assert held is not None
    return held


def _report(installation: Installation) -> str:
    sha256 = installation.services.blobs.put_bytes(b"{}")
    with installation.services.transaction() as session:
        record_blob(session, installation.services.blobs, sha256, 2)
    return sha256


def _expire_now(installation: Installation, submission_id: uuid.UUID) -> SubmissionState | None:
    """Let the lease run out without waiting for it."""
    with installation.services.transaction() as session:
        past = database.now(session).replace(year=2000)
        session.execute(sa.update(Submission).where(Submission.id == submission_id).values(lease_expires_at=past))
    with installation.services.transaction() as session:
        return lifecycle.expire(session, submission_id)


def test_a_stale_worker_writes_nothing(installation: Installation) -> None:
    """Once its lease ran out and the submission was taken back, every write of the first worker raises."""
    submission_id = installation.submit(enqueue=False)
    stale = _claim(installation, submission_id)
    assert _expire_now(installation, submission_id) is SubmissionState.RECEIVED
    fresh = _claim(installation, submission_id)
    report = _report(installation)
    writes: list[Callable[[Session], object]] = [
        lambda session: lifecycle.heartbeat(session, stale, stage="scoring", images_done=1, images_total=1),
        lambda session: lifecycle.validated(session, stale, report_sha256=report),
        lambda session: lifecycle.reject(session, stale, report_sha256=report),
        lambda session: lifecycle.fail(session, stale, code="x", detail="y"),
        lambda session: lifecycle.give_back(session, stale, detail="z"),
    ]
    for write in writes:
        with installation.services.transaction() as session, pytest.raises(LeaseLost):
            write(session)
    submission = installation.load(submission_id)
    assert (submission.attempt, submission.state) == (fresh.attempt, SubmissionState.RECEIVED)


def test_an_expired_lease_that_nobody_took_still_counts(installation: Installation) -> None:
    """A worker that comes back late, before anybody took its submission, may still write: nothing was done twice."""
    submission_id = installation.submit(enqueue=False)
    held = _claim(installation, submission_id, lease_s=0.001)
    with installation.services.transaction() as session:
        lifecycle.validated(session, held, report_sha256=_report_in(session, installation))
    assert installation.state(submission_id) is SubmissionState.SCORING


def _report_in(session: Session, installation: Installation) -> str:
    sha256 = installation.services.blobs.put_bytes(b"{}")
    record_blob(session, installation.services.blobs, sha256, 2)
    return sha256


def test_lost_attempts_are_capped(installation: Installation) -> None:
    """A submission that loses every worker fails after the phase's three attempts; returned attempts do not count."""
    submission_id = installation.submit(enqueue=False)
    held = _claim(installation, submission_id)
    with installation.services.transaction() as session:
        lifecycle.give_back(session, held, detail="the worker drains")
    states = []
    for _ in range(3):
        _claim(installation, submission_id)
        states.append(_expire_now(installation, submission_id))
    assert states == [SubmissionState.RECEIVED, SubmissionState.RECEIVED, SubmissionState.FAILED]
    submission = installation.load(submission_id)
    assert submission.failure_code == lifecycle.ATTEMPTS_EXHAUSTED
    assert [attempt.outcome for attempt in submission.attempts] == [
        AttemptOutcome.RETURNED, AttemptOutcome.LOST, AttemptOutcome.LOST, AttemptOutcome.LOST,
    ]  # fmt: skip


def test_a_requeued_submission_has_its_attempts_again(installation: Installation) -> None:
    """After a re-queue the cap counts anew, and the refund of the failure stands alone."""
    submission_id = installation.submit(enqueue=False)
    held = _claim(installation, submission_id)
    with installation.services.transaction() as session:
        lifecycle.fail(session, held, code="x", detail="y")
    with installation.services.transaction() as session:
        lifecycle.requeue(session, submission_id, actor="admin:test")
    states = []
    for _ in range(3):
        _claim(installation, submission_id)
        states.append(_expire_now(installation, submission_id))
    assert states[-1] is SubmissionState.FAILED
    with installation.services.snapshot() as session:
        kinds = list(session.scalars(sa.select(QuotaEntry.kind).order_by(QuotaEntry.id)))
    assert kinds == [QuotaKind.RESERVE, QuotaKind.REFUND]


def test_requeue_is_only_for_failed(installation: Installation) -> None:
    """A submission that waits cannot be re-queued."""
    submission_id = installation.submit(enqueue=False)
    with installation.services.transaction() as session, pytest.raises(IllegalTransition):
        lifecycle.requeue(session, submission_id, actor="admin:test")


def test_every_change_of_state_is_in_the_trail(installation: Installation) -> None:
    """The audit trail of a submission lists its states in order."""
    submission_id = installation.submit(enqueue=False)
    held = _claim(installation, submission_id)
    with installation.services.transaction() as session:
        lifecycle.validated(session, held, report_sha256=_report_in(session, installation))
    assert _expire_now(installation, submission_id) is SubmissionState.QUEUED
    with installation.services.snapshot() as session:
        events = audit.trail(session, f"submission:{submission_id}")
    assert [event.action.removeprefix("submission.") for event in events] == [
        "received", "queued", "scoring", "queued",
    ]  # fmt: skip


def test_the_database_itself_refuses_illegal_transitions(installation: Installation) -> None:
    """A bare UPDATE cannot make any transition that the lifecycle does not know."""
    submission_id = installation.submit(enqueue=False)
    for target in STATES:
        if target in TRANSITIONS[SubmissionState.RECEIVED] | {SubmissionState.RECEIVED}:
            continue
        with pytest.raises(sa.exc.DBAPIError), installation.services.transaction() as session:
            session.execute(sa.update(Submission).where(Submission.id == submission_id).values(state=target))
    assert installation.state(submission_id) is SubmissionState.RECEIVED


def test_scored_needs_a_score_in_the_database(installation: Installation) -> None:
    """A bare UPDATE from scoring to scored is refused while there is no score row of that attempt."""
    submission_id = installation.submit(enqueue=False)
    held = _claim(installation, submission_id)
    with installation.services.transaction() as session:
        lifecycle.validated(session, held, report_sha256=_report_in(session, installation))
    with (
        pytest.raises(sa.exc.DBAPIError, match="scored only by a score"),
        installation.services.transaction() as session,
    ):
        session.execute(
            sa.update(Submission)
            .where(Submission.id == submission_id)
            .values(state=SubmissionState.SCORED, lease_expires_at=None)
        )


@pytest.mark.parametrize("table", ["submission", "attempt", "quota_entry", "audit_event", "ground_truth"])
def test_nothing_of_the_record_is_deleted(installation: Installation, table: str) -> None:
    """History cannot be deleted, not even by hand."""
    _claim(installation, installation.submit(enqueue=False))
    with pytest.raises(sa.exc.DBAPIError), installation.services.transaction() as session:
        session.execute(sa.text(f"DELETE FROM {table}"))  # noqa: S608 - names from above


@pytest.mark.parametrize("model", [QuotaEntry, AuditEvent])
def test_ledgers_are_append_only(installation: Installation, model: Any) -> None:
    """A line of the quota ledger or the audit trail cannot be changed."""
    installation.submit(enqueue=False)
    column = "reason" if model is QuotaEntry else "actor"
    with pytest.raises(sa.exc.DBAPIError, match="append-only"), installation.services.transaction() as session:
        session.execute(sa.update(model).values({column: "somebody else"}))


def test_an_ended_attempt_never_changes(installation: Installation) -> None:
    """How an attempt ended stays as it was written."""
    submission_id = installation.submit(enqueue=False)
    held = _claim(installation, submission_id)
    with installation.services.transaction() as session:
        lifecycle.give_back(session, held, detail="drained")
    with pytest.raises(sa.exc.DBAPIError), installation.services.transaction() as session:
        session.execute(sa.update(Attempt).values(outcome=AttemptOutcome.SCORED))


def test_trigger_and_lifecycle_know_the_same_transitions() -> None:
    """The table in the newest guard migration equals the lifecycle's."""
    path = Path(database.migrations_folder()) / "versions" / "0002_guards.py"
    spec = importlib.util.spec_from_file_location("guards", path)
    assert spec is not None
    assert spec.loader is not None
    guards = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(guards)
    ours = {f"{source}>{target}" for source, targets in TRANSITIONS.items() for target in targets}
    assert set(guards.TRANSITIONS) == ours
