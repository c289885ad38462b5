"""After the attack: is every promise kept? Participants' answers against the record, and the record against itself."""

import dataclasses
import time
from collections.abc import Iterator

import sqlalchemy as sa

from server import checker, submissions, sweeper
from server.models import Submission, SubmissionState
from server.services import Services
from tests.faults.clients import Clients
from tests.faults.deployment import Deployment

EXPECTED_STATUSES = {202, 503, 507}


def judge(deployment: Deployment, clients: Clients) -> Iterator[str]:
    """Say everything that is not as it should be."""
    yield from _answers_were_kept(deployment, clients)
    yield from _answers_were_allowed(clients)
    yield from _no_task_broke_down(deployment)
    services = _without_grace(deployment.services)
    _publish_some(services)
    time.sleep(1.1)  # so that whatever is left over counts as old
    sweeper.sweep_files(services)
    for violation in checker.check(services, recompute=True):
        yield f"{violation.rule}: {violation.subject} {violation.detail}"
    for path in services.blobs.incoming.iterdir():
        yield f"{path.name} was left behind"


def _answers_were_kept(deployment: Deployment, clients: Clients) -> Iterator[str]:
    """Every 202 is a submission that ended as its predictions deserve."""
    with deployment.services.snapshot() as session:
        states = {str(row.id): row.state for row in session.scalars(sa.select(Submission))}
    for submission_id, with_errors in clients.accepted.items():
        due = SubmissionState.REJECTED if with_errors else SubmissionState.SCORED
        if states.get(submission_id) is not due:
            yield f"{submission_id} was answered with 202 and is {states.get(submission_id)}, not {due}"
    for key in clients.unanswered:
        yield f"the participant with key {key} never got a 202"


def _answers_were_allowed(clients: Clients) -> Iterator[str]:
    for status, count in clients.statuses.items():
        if status not in EXPECTED_STATUSES:
            yield f"{count} answers had status {status}"


def _no_task_broke_down(deployment: Deployment) -> Iterator[str]:
    """Workers end what they cannot do in good order; an unforeseen error in a task shows a safeguard missing."""
    for path, text in deployment.logs().items():
        for line in text.splitlines():
            if "raised unexpected" in line:
                yield f"{path}: {line}"


def _without_grace(services: Services) -> Services:
    """Let the sweeper take at once what nobody owns."""
    return dataclasses.replace(services, settings=services.settings.model_copy(update={"orphan_grace_s": 0.0}))


def _publish_some(services: Services) -> None:
    """Give the leaderboard rows: the latest scored submission of every method."""
    with services.transaction() as session:
        scored = sa.select(Submission).where(
            Submission.state == SubmissionState.SCORED, Submission.held_reason.is_(None)
        )
        latest = {row.method_id: row for row in session.scalars(scored.order_by(Submission.created_at))}
        for submission in latest.values():
            submissions.publish(session, submission, "user:1")
