"""After the attack: is every promise kept? Participants' answers against the record, and the record against itself."""

import dataclasses
import time
from collections.abc import Iterator
from typing import Any

import httpx
import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import checker, leftovers, submissions, sweeper
from server.lifecycle import ATTEMPTS_EXHAUSTED
from server.models import Attempt, AttemptOutcome, Publication, Submission, SubmissionState
from server.services import Services
from tests.faults import diagnosis, points
from tests.faults.clients import Clients, Sent, valid_beyond_quota
from tests.faults.deployment import MAX_ATTEMPTS, Deployment


def judge(deployment: Deployment, clients: Clients) -> Iterator[str]:
    """Say everything that is not as it should be."""
    yield from _answers_were_kept(deployment, clients)
    yield from _answers_were_allowed(clients)
    yield from _messages_came_after_their_rows(deployment)
    yield from _no_task_broke_down(deployment)
    services = _without_grace(deployment.services)
    _publish_some(services)
    yield from _leaderboard_is_shown_as_computed(deployment)
    time.sleep(1.1)  # so that whatever is left over counts as old
    sweeper.sweep_files(services)
    leftovers.delete_old(services.blobs.incoming, grace_s=1.0)  # the sweep spares what might be an attempt's
    for violation in checker.check(services, recompute=True):
        yield f"{violation.rule}: {violation.subject} {violation.detail}"
    for path in services.blobs.incoming.iterdir():
        yield f"{path.name} was left behind"


def _answers_were_kept(deployment: Deployment, clients: Clients) -> Iterator[str]:
    """Every 202 is one submission of the very bytes, which ended as they deserve; and there are no others."""
    with deployment.services.snapshot() as session:
        rows = {str(row.id): row for row in session.scalars(sa.select(Submission))}
        for submission_id, sent in clients.accepted.items():
            row = rows.pop(submission_id, None)
            if row is None:
                yield f"{submission_id} was answered with 202 and is lost"
                continue
            if row.predictions_sha256 != sent.sha256:
                yield f"{submission_id} has other bytes than were sent"
            yield from _doomed_end(session, row, sent.doomed) if sent.doomed else _due_end(row, sent)
    for submission_id in rows:
        yield f"{submission_id} is a submission that nobody was told of"
    for key in clients.unanswered:
        yield f"the participant with key {key} never got a 202"
    if beyond := valid_beyond_quota(clients):
        yield f"{beyond} valid submissions were taken beyond the quota"


def _due_end(row: Submission, sent: Sent) -> Iterator[str]:
    due = SubmissionState.SCORED if sent.valid else SubmissionState.REJECTED
    if row.state is not due:
        yield f"{row.id} was answered with 202 and is {row.state}, not {due} ({row.failure_code})"


def _doomed_end(session: Session, row: Submission, code: str) -> Iterator[str]:
    """What ends every process that scores it fails once its attempts are used up, whoever counted the last one."""
    lost = session.scalar(
        sa.select(sa.func.count()).where(Attempt.submission_id == row.id, Attempt.outcome == AttemptOutcome.LOST)
    )
    if (row.state, lost) != (SubmissionState.FAILED, MAX_ATTEMPTS) or row.failure_code not in (
        code,
        ATTEMPTS_EXHAUSTED,
    ):
        yield f"{row.id} should have failed with {code} and is {row.state} ({row.failure_code}) after {lost} attempts"


def _answers_were_allowed(clients: Clients) -> Iterator[str]:
    for answer in clients.unforeseen:
        yield f"a participant was answered: {answer}"


def _messages_came_after_their_rows(deployment: Deployment) -> Iterator[str]:
    for submission_id in points.early_messages(deployment.faults):
        yield f"a message about {submission_id} came before its row"


def _no_task_broke_down(deployment: Deployment) -> Iterator[str]:
    """Workers end what they cannot do in good order; an unforeseen error in a task shows a safeguard missing."""
    for service in deployment.fronts:
        for line in diagnosis.log_of(service):
            if "raised unexpected" in line:
                yield f"{service.folder.name}: {line}"


def _without_grace(services: Services) -> Services:
    """Let the sweeper take at once what nobody owns."""
    return dataclasses.replace(services, settings=services.settings.model_copy(update={"orphan_grace_s": 0.0}))


def _publish_some(services: Services) -> None:
    """Give the leaderboards rows: the latest scored submission of every method."""
    with services.transaction() as session:
        scored = sa.select(Submission).where(
            Submission.state == SubmissionState.SCORED, Submission.held_reason.is_(None)
        )
        latest = {row.method_id: row for row in session.scalars(scored.order_by(Submission.created_at))}
        for submission in latest.values():
            submissions.publish(session, submission, "user:1")


def _leaderboard_is_shown_as_computed(deployment: Deployment) -> Iterator[str]:
    """What the public API shows is what the published scores, each computed again by the checker, come to."""
    url = f"{deployment.web.url}/api/v1/leaderboards/cs3d/test"
    shown: list[dict[str, Any]] = httpx.get(url, timeout=60).raise_for_status().json()["rows"]
    with deployment.services.snapshot() as session:
        published = sa.select(Submission).where(
            Submission.publication == Publication.PUBLISHED, Submission.phase.has(slug="test")
        )
        values = {str(row.id): row.scores[0].mds for row in session.scalars(published)}
    due = {
        key: (
            value,
            None if value is None else 1 + sum(other > value for other in values.values() if other is not None),
        )
        for key, value in values.items()
    }
    if {row["submission_id"]: (row["mds"], row["rank"]) for row in shown} != due or len(shown) != len(due):
        yield f"the leaderboard shows {shown}, computed is {due}"
