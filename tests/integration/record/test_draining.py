"""A worker that is asked to stop finishes what it scores, takes nothing else and ends."""

import signal

import pytest

from server.models import AttemptOutcome, SubmissionState
from tests.faults import points
from tests.services.installation import QUICK, Installation
from tests.services.processes import wait_until

PATIENT = {**QUICK, "lease_s": 60.0, "resend_s": 60.0}
"""Nobody takes the submission from a worker that a test holds."""


@pytest.mark.parametrize("services", [PATIENT], indirect=True)
@pytest.mark.parametrize("point", ["claimed", "scored"])
def test_sigterm_lets_a_worker_finish(installation: Installation, point: str) -> None:
    """SIGTERM after the claim or before the record: the submission is scored by that very attempt, the next one waits."""
    faults = installation.folder / "faults"
    faults.mkdir()
    points.arm(faults, point, points.Strike(hold=True))
    submission_id = installation.submit()
    worker = installation.start_worker(module="tests.faults.worker_app", extra={points.FOLDER_VARIABLE: str(faults)})
    wait_until(lambda: points.taken_by(faults, point), what=f"a strike at {point}")
    (struck,) = points.strikes(faults, point)
    assert worker.process is not None
    worker.process.send_signal(signal.SIGTERM)
    wait_until(lambda: b"Warm shutdown" in worker.log_path.read_bytes(), what="that the worker stops")
    waiting_id = installation.submit()
    points.let_go(struck)
    wait_until(lambda: not worker.running, what="that the worker ends")
    assert worker.process.returncode == 0
    submission = installation.load(submission_id)
    assert submission.state is SubmissionState.SCORED
    (attempt,) = submission.attempts
    assert attempt.outcome is AttemptOutcome.SCORED
    assert attempt.worker.endswith(f":{struck.process}")
    assert installation.state(waiting_id) is SubmissionState.RECEIVED
