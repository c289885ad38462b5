"""The checker finds nothing in a sound record and finds every damage that is done to it."""

from collections.abc import Callable
from pathlib import Path

import pytest
import sqlalchemy as sa

from server import lifecycle, submissions
from server.checker import check
from server.models import SubmissionState
from tests.services.installation import Installation


@pytest.fixture
def busy_installation(installation: Installation) -> Installation:
    """Give an installation with a submission in every terminal state, one of them published."""
    scored = installation.submit()
    rejected = installation.submit(b"not a zip")
    cancelled = installation.submit(enqueue=False)
    failed = installation.submit(enqueue=False)
    with installation.services.transaction() as session:
        lifecycle.cancel(session, cancelled, actor="user:1")
        held = lifecycle.claim(session, failed, worker="w", lease_s=60)
        assert held is not None
        lifecycle.fail(session, held, code="x", detail="y")
    installation.start_worker()
    installation.wait_for(scored, SubmissionState.SCORED)
    installation.wait_for(rejected, SubmissionState.REJECTED)
    with installation.services.transaction() as session:
        submissions.publish(session, submissions.find(session, scored), "user:1")
    return installation


def _execute(installation: Installation, *statements: str) -> None:
    """Damage the record as no code of ours could: without its triggers."""
    with installation.services.transaction() as session:
        if session.connection().dialect.name == "sqlite":
            for name in session.scalars(sa.text("SELECT name FROM sqlite_master WHERE type = 'trigger'")).all():
                session.execute(sa.text(f"DROP TRIGGER {name}"))
        else:
            for table in ("submission", "score", "quota_entry", "audit_event", "attempt"):
                session.execute(sa.text(f"ALTER TABLE {table} DISABLE TRIGGER USER"))
        for statement in statements:
            session.execute(sa.text(statement))


def _rules(installation: Installation) -> set[str]:
    return {violation.rule for violation in check(installation.services)}


def test_a_sound_record_has_no_violations(busy_installation: Installation) -> None:
    """After every kind of ending nothing is found, in both shapes."""
    assert check(busy_installation.services) == []


def _lose_blob(installation: Installation) -> None:
    sha256 = installation.services.blobs.put_bytes(b"not a zip")
    installation.services.blobs.delete(sha256)


def _damage_blob(installation: Installation) -> None:
    path = Path(installation.services.blobs.local_path(installation.services.blobs.put_bytes(b"not a zip")))
    path.chmod(0o644)
    path.write_bytes(b"not a zap")


DAMAGES: dict[str, tuple[Callable[[Installation], None], str]] = {
    "lost blob": (_lose_blob, "every_row_has_its_blob"),
    "changed bytes": (_damage_blob, "every_blob_is_what_its_name_says"),
    "changed score": (lambda i: _execute(i, "UPDATE score SET mds = mds / 2"), "scores_are_reproducible"),
    "lost score": (
        lambda i: _execute(i, "DELETE FROM score_replicates", "DELETE FROM score"),
        "scores_belong_to_scored",
    ),
    "second refund": (
        lambda i: _execute(
            i,
            "INSERT INTO quota_entry (team_id, phase_id, submission_id, kind, amount, reason, created_at)"
            " SELECT team_id, phase_id, id, 'refund', -1, 'x', created_at FROM submission WHERE state = 'scored'",
        ),
        "the_ledger_fits_the_states",
    ),
    "step from elsewhere": (
        lambda i: _execute(
            i,
            "UPDATE audit_event SET detail = json_set(detail, '$.source', 'queued') WHERE action = 'submission.scored'",
        ),
        "the_trail_has_every_step",
    ),
    "lost audit event": (
        lambda i: _execute(i, "DELETE FROM audit_event WHERE action = 'submission.scoring'"),
        "states_follow_the_trail",
    ),
    "lost attempt": (lambda i: _execute(i, "DELETE FROM attempt"), "attempts_add_up"),
    "quota": (
        lambda i: _execute(i, "UPDATE phase SET submissions_per_day = 0"),
        "no_quota_was_overrun",
    ),
}


@pytest.mark.parametrize("shape", ["embedded"])
def test_every_damage_is_found(busy_installation: Installation) -> None:
    """Each damage is reported under the promise it breaks."""
    missed = {}
    for name, (damage, rule) in DAMAGES.items():
        damage(busy_installation)
        if rule not in _rules(busy_installation):
            missed[name] = rule
    assert missed == {}
