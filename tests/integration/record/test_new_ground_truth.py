"""Ground truth that is imported anew while submissions are under way, in both shapes."""

from pathlib import Path

import pytest

from server import benchmarks, submissions
from server.errors import NotScored
from server.models import SubmissionState
from tests.services.installation import ORACLE, Installation
from worker.evaluation import evaluate_submission
from worker.sandbox import Sandbox


def _import(installation: Installation, source: Path) -> None:
    with installation.services.transaction() as session:
        phase = benchmarks.find_phase(session, "cs3d", "test")
        benchmarks.import_ground_truth(
            session, installation.services.blobs, phase=phase, source=source, actor="admin:test"
        )


def test_a_score_on_replaced_ground_truth_is_not_published(installation: Installation) -> None:
    """Nothing was published, so the second version is in force at once; the score on the first one ranks nowhere."""
    submission_id = installation.submit(enqueue=False)
    sandbox = Sandbox()
    try:
        evaluate_submission(installation.services, sandbox, submission_id, worker="test")
    finally:
        sandbox.kill()
    assert installation.state(submission_id) is SubmissionState.SCORED
    _import(installation, ORACLE / "depth_bins" / "gt")
    with (
        pytest.raises(NotScored, match="send the predictions again"),
        installation.services.transaction() as session,
    ):
        submissions.publish(session, submissions.find(session, submission_id), "user:1")
