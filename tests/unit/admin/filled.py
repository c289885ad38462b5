"""What the tests of `cs3d-admin` fill an installation with."""

import uuid
from collections.abc import Callable
from typing import Any

from server import accounts, benchmarks, lifecycle, submissions
from server.models import SubmissionState
from server.services import Services
from tests.services.installation import SMALL_CASE, zip_of
from worker.evaluation import evaluate_submission
from worker.sandbox import Sandbox

Admin = Callable[..., dict[str, Any]]
"""Runs a command with --json and returns what it prints."""

Says = Callable[..., str]
"""Runs a command and returns what it prints for people."""

Refused = Callable[..., tuple[int, str]]
"""Runs a command that is refused and returns the status and what it says."""


def populate(admin: Admin) -> None:
    """Make a team with a member and a phase with ground truth."""
    admin("create-user", "ann@example.org", "--name", "Ann")
    admin("create-team", "lab", "--name", "The Lab", "--member", "ann@example.org")
    admin("create-benchmark", "cs3d", "--title", "Cityscapes 3D")
    admin("create-phase", "cs3d", "test", "--title", "Test")
    admin("import-ground-truth", "cs3d", "test", str(SMALL_CASE / "gt"))


def send_one(
    services: Services, *, phase: str = "test", team: str = "lab", method: str = "ours", data: bytes = b"zip"
) -> uuid.UUID:
    """Make a submission of Ann's that nobody works on."""
    sha256 = services.blobs.put_bytes(data)
    with services.transaction() as session:
        submission = submissions.receive(
            session,
            phase=benchmarks.find_phase(session, "cs3d", phase),
            team=accounts.find_team(session, team),
            user=accounts.find_user(session, "ann@example.org"),
            method_slug=method,
            predictions_sha256=sha256,
            size_bytes=len(data),
            file_name="a.zip",
            actor="user:1",
        )
    return submission.id


def fail_one(services: Services) -> uuid.UUID:
    """Make a submission whose worker fails."""
    submission_id = send_one(services)
    with services.transaction() as session:
        held = lifecycle.claim(session, submission_id, worker="w", lease_s=60)
        assert held is not None
        lifecycle.fail(session, held, code="out_of_memory", detail="4 GiB were not enough")
    return submission_id


def score_one(services: Services, sandbox: Sandbox, *, method: str = "ours") -> uuid.UUID:
    """Make a submission of the case's own predictions and score it as a worker does."""
    submission_id = send_one(services, method=method, data=zip_of(SMALL_CASE / "pred"))
    evaluate_submission(services, sandbox, submission_id, worker="w")
    with services.snapshot() as session:
        assert submissions.find(session, submission_id).state is SubmissionState.SCORED
    return submission_id
