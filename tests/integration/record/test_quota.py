"""The quota ledger, in both shapes."""

import threading
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta

import pytest

from server import benchmarks, database, lifecycle, quota, submissions
from server.blobs import record_blob
from server.errors import Conflict, PhaseClosed, QuotaExceeded, TooManyRejections
from server.models import GroundTruthVersion
from tests.services.installation import Installation


def _set_rules(installation: Installation, **rules: int | None) -> None:
    with installation.services.transaction() as session:
        phase = benchmarks.find_phase(session, "cs3d", "test")
        for name, value in rules.items():
            setattr(phase, name, value)


def _used(installation: Installation) -> int:
    with installation.services.snapshot() as session:
        phase = benchmarks.find_phase(session, "cs3d", "test")
        return quota.used(session, team_id=installation.team.id, phase=phase, at=database.now(session))


def _reject(installation: Installation, submission_id: uuid.UUID) -> None:
    blobs = installation.services.blobs
    report = blobs.put_bytes(b"{}")
    with installation.services.transaction() as session:
        held = lifecycle.claim(session, submission_id, worker="w", lease_s=60)
        assert held is not None
        record_blob(session, blobs, report, 2)
        lifecycle.reject(session, held, report_sha256=report)


def test_the_quota_is_refused_with_the_time_to_wait(installation: Installation) -> None:
    """The submission beyond the quota is refused; the wait is a day less what has passed since the first."""
    _set_rules(installation, submissions_per_day=2)
    installation.submit(enqueue=False)
    installation.submit(enqueue=False)
    with pytest.raises(QuotaExceeded, match=r"within 24 hours \(2\); the next submission is possible at 20") as caught:
        installation.submit(enqueue=False)
    assert caught.value.retry_after_s is not None
    assert 86000 < caught.value.retry_after_s <= 86400
    assert _used(installation) == 2


def test_rejected_failed_and_cancelled_cost_nothing(installation: Installation) -> None:
    """Each of the three gives the reservation back."""
    _set_rules(installation, submissions_per_day=1)
    _reject(installation, installation.submit(enqueue=False))
    failed = installation.submit(enqueue=False)
    with installation.services.transaction() as session:
        held = lifecycle.claim(session, failed, worker="w", lease_s=60)
        assert held is not None
        lifecycle.fail(session, held, code="x", detail="y")
    cancelled = installation.submit(enqueue=False)
    with installation.services.transaction() as session:
        lifecycle.cancel(session, cancelled, actor="user:1")
    assert _used(installation) == 0
    installation.submit(enqueue=False)


def test_rejected_uploads_have_a_cap_of_their_own(installation: Installation) -> None:
    """Rejections are free but not endless."""
    _set_rules(installation, rejections_per_day=2)
    for _ in range(2):
        _reject(installation, installation.submit(enqueue=False))
    with pytest.raises(TooManyRejections, match="cs3d validate"):
        installation.submit(enqueue=False)


@contextmanager
def _hours_ago(hours: float) -> Iterator[None]:
    """Set the clock back; the ledger itself cannot be changed."""
    now = database.now
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(database, "now", lambda session: now(session) - timedelta(hours=hours))
        yield


def test_the_wait_is_until_there_is_room(installation: Installation) -> None:
    """What was in flight may leave more than the cap: the wait is until fewer are left, not until the oldest is gone."""
    for hours in (23, 22, 21):
        with _hours_ago(hours):
            _reject(installation, installation.submit(enqueue=False))
    for cap, hours in ((3, 1), (2, 2), (1, 3)):
        _set_rules(installation, rejections_per_day=cap)
        with pytest.raises(TooManyRejections) as caught:
            installation.submit(enqueue=False)
        assert caught.value.retry_after_s is not None
        assert 3600 * hours - 60 < caught.value.retry_after_s <= 3600 * hours


def test_a_grant_that_ends_before_what_it_allowed_lengthens_the_wait(installation: Installation) -> None:
    """Two are sent of one and one granted; when the grant ends both count against one, so the second must end, too."""
    _set_rules(installation, submissions_per_day=1)
    with _hours_ago(6), installation.services.transaction() as session:
        phase = benchmarks.find_phase(session, "cs3d", "test")
        quota.grant(session, team=installation.team, phase=phase, count=1, reason="lost day", actor="admin:test")
    for hours in (5, 0):
        with _hours_ago(hours):
            installation.submit(enqueue=False)
    with pytest.raises(QuotaExceeded) as caught:
        installation.submit(enqueue=False)
    assert caught.value.retry_after_s is not None
    assert 86000 < caught.value.retry_after_s <= 86400


def test_cancelled_uploads_count_towards_the_cap_of_rejections(installation: Installation) -> None:
    """Sending and cancelling costs nothing, but the bytes are kept: one rejected and one cancelled fill a cap of two."""
    _set_rules(installation, rejections_per_day=2)
    _reject(installation, installation.submit(enqueue=False))
    cancelled = installation.submit(enqueue=False)
    with installation.services.transaction() as session:
        lifecycle.cancel(session, cancelled, actor="user:1")
    with pytest.raises(TooManyRejections, match="cancelled"):
        installation.submit(enqueue=False)


def test_a_grant_allows_more(installation: Installation) -> None:
    """A maintainer's grant adds to what the team may send."""
    _set_rules(installation, submissions_per_day=0)
    with installation.services.transaction() as session:
        phase = benchmarks.find_phase(session, "cs3d", "test")
        quota.grant(session, team=installation.team, phase=phase, count=1, reason="lost day", actor="admin:test")
    installation.submit(enqueue=False)
    with pytest.raises(QuotaExceeded, match="what maintainers grant alone") as caught:
        installation.submit(enqueue=False)
    assert caught.value.retry_after_s is None


def test_uploads_at_once_never_exceed_the_quota(installation: Installation) -> None:
    """Eight uploads racing for three places: three get one."""
    _set_rules(installation, submissions_per_day=3)
    outcomes: list[bool] = []

    def submit() -> None:
        try:
            installation.submit(enqueue=False)
        except QuotaExceeded:
            outcomes.append(False)
        else:
            outcomes.append(True)

    threads = [threading.Thread(target=submit) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(outcomes) == [False] * 5 + [True] * 3
    assert _used(installation) == 3


def test_an_upload_goes_by_the_rules_of_the_moment_it_is_kept(installation: Installation) -> None:
    """An upload that read the phase before its quota was lowered is refused."""
    services = installation.services
    installation.submit(enqueue=False)
    with services.snapshot() as session:
        stale = benchmarks.find_phase(session, "cs3d", "test")
    with services.transaction() as session:
        benchmarks.edit_phase(
            session, benchmarks.find_phase(session, "cs3d", "test"), actor="admin:test", submissions_per_day=1
        )
    assert stale.submissions_per_day > 1
    with services.transaction() as session, pytest.raises(QuotaExceeded):
        submissions.receive(
            session,
            phase=session.merge(stale, load=False),
            team=installation.team,
            user=installation.user,
            method_slug="ours",
            predictions_sha256=services.blobs.put_bytes(b"x"),
            size_bytes=1,
            file_name="predictions.zip",
            actor="user:1",
        )


def test_a_rule_is_changed_after_the_upload_that_is_being_kept(installation: Installation) -> None:
    """A maintainer who lowers the quota waits for an upload that was within it."""
    services = installation.services

    def lower() -> None:
        with services.transaction() as session:
            phase = benchmarks.find_phase(session, "cs3d", "test")
            benchmarks.edit_phase(session, phase, actor="admin:test", submissions_per_day=1)
            order.append("lowered")

    order: list[str] = []
    sha256 = services.blobs.put_bytes(b"x")
    maintainer = threading.Thread(target=lower)
    with services.transaction() as session:
        phase = benchmarks.find_phase(session, "cs3d", "test")
        for method in ("ours", "theirs"):
            submissions.receive(
                session,
                phase=phase,
                team=installation.team,
                user=installation.user,
                method_slug=method,
                predictions_sha256=sha256,
                size_bytes=1,
                file_name="predictions.zip",
                actor="user:1",
            )
        maintainer.start()
        maintainer.join(timeout=0.5)
        order.append("kept")
    maintainer.join()
    assert order == ["kept", "lowered"]


def test_a_phase_without_ground_truth_is_closed(installation: Installation) -> None:
    """A phase takes nothing before its ground truth is imported; importing the version in force again is refused."""
    with installation.services.transaction() as session:
        phase = benchmarks.find_phase(session, "cs3d", "test")
        version = phase.ground_truth
        assert isinstance(version, GroundTruthVersion)
        with pytest.raises(Conflict, match="in force already"):
            benchmarks.import_ground_truth(
                session,
                installation.services.blobs,
                phase=phase,
                source=installation.case / "gt",
                actor="admin:test",
            )
    _set_rules(installation, ground_truth_id=None)
    with pytest.raises(PhaseClosed, match="not imported"):
        installation.submit(enqueue=False)
