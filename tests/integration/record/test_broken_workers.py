"""Workers that cannot do their work: a broken one gives up loudly, one that lacks a service comes back."""

from collections.abc import Generator

import pytest

from server.errors import Unavailable
from server.models import AttemptOutcome, SubmissionState
from tests.services.installation import Installation
from worker.evaluation import evaluate_submission
from worker.messages import AnyJob, Event
from worker.sandbox import Sandbox, SandboxError


class BrokenSandbox(Sandbox):
    """Raises instead of scoring."""

    def __init__(self, error: Exception) -> None:
        """Raise `error` for every job."""
        super().__init__()
        self.error = error

    def events(self, job: AnyJob, *, tick_s: float) -> Generator[Event | None, None, None]:
        """Raise at the first event."""
        del job, tick_s
        raise self.error
        yield


@pytest.mark.parametrize("error", [SandboxError("it does not start"), OSError("too many open files")])
def test_a_broken_worker_ends_in_failed(installation: Installation, error: Exception) -> None:
    """A worker that breaks down for its own reasons uses up attempts: three, then failed, never an endless loop."""
    submission_id = installation.submit(enqueue=False)
    for _ in range(3):
        evaluate_submission(installation.services, BrokenSandbox(error), submission_id, worker="w")
    submission = installation.load(submission_id)
    assert (submission.state, submission.failure_code) == (SubmissionState.FAILED, "worker_error")
    assert [attempt.outcome for attempt in submission.attempts] == [AttemptOutcome.LOST] * 3


def test_a_service_that_is_away_costs_no_attempt(installation: Installation) -> None:
    """However long the blob store is away, the submission waits and is scored in the end."""
    submission_id = installation.submit(enqueue=False)
    for _ in range(5):
        away = BrokenSandbox(Unavailable("the blob store is away"))
        evaluate_submission(installation.services, away, submission_id, worker="w")
    assert installation.state(submission_id) is SubmissionState.RECEIVED
    sandbox = Sandbox()
    evaluate_submission(installation.services, sandbox, submission_id, worker="w")
    sandbox.kill()
    submission = installation.load(submission_id)
    assert submission.state is SubmissionState.SCORED
    assert [attempt.outcome for attempt in submission.attempts] == [AttemptOutcome.RETURNED] * 5 + [
        AttemptOutcome.SCORED
    ]
