"""The rules of a phase: given at its creation, changed while it runs."""

from typing import Any

import pytest
import sqlalchemy as sa

from server import audit, benchmarks, checker, submissions
from server.errors import PhaseClosed, QuotaExceeded
from server.models import AuditEvent, Phase
from server.services import Services
from tests.unit.admin.filled import Admin, Refused, Says, populate, score_one, send_one
from worker.sandbox import Sandbox


def _phase(services: Services, slug: str = "test") -> Phase:
    with services.snapshot() as session:
        return benchmarks.find_phase(session, "cs3d", slug)


def _changes(services: Services) -> list[dict[str, Any]]:
    """Read the details of every change of rules, oldest first."""
    with services.snapshot() as session:
        return [event.detail for event in audit.trail(session, "phase:1") if event.action == "phase.changed"]


@pytest.fixture
def phase(admin: Admin) -> list[str]:
    """A phase that takes submissions, as arguments."""
    populate(admin)
    return ["cs3d", "test"]


def test_phases_keep_their_rules(admin: Admin, services: Services) -> None:
    """The options of `create-phase` become the phase's rules; a time without a zone is UTC."""
    admin("create-benchmark", "cs3d", "--title", "Cityscapes 3D", "--description", "Vehicles in nine degrees.")
    options = ["--open", "--no-publication", "--submissions-per-day", "3", "--closes-at", "2030-01-02T03:04"]
    admin("create-phase", "cs3d", "val", "--title", "Validation", *options)
    with services.snapshot() as session:
        phase = benchmarks.find_phase(session, "cs3d", "val")
        assert (phase.is_open, phase.allows_publication, phase.submissions_per_day) == (True, False, 3)
        assert phase.closes_at is not None
        assert phase.closes_at.isoformat() == "2030-01-02T03:04:00+00:00"


def test_phases_keep_their_number_of_shards(admin: Admin, services: Services, refused: Refused) -> None:
    """`create-phase --shards` chooses it, `set-shards` another one; a number that cannot be changes nothing."""
    admin("create-benchmark", "cs3d", "--title", "Cityscapes 3D")
    admin("create-phase", "cs3d", "test", "--title", "Test", "--shards", "4")
    with services.snapshot() as session:
        assert benchmarks.find_phase(session, "cs3d", "test").shards == 4
    admin("set-shards", "cs3d", "test", "2")
    assert refused("set-shards", "cs3d", "test", "65")[0] == 1
    with services.snapshot() as session:
        assert benchmarks.find_phase(session, "cs3d", "test").shards == 2


@pytest.mark.parametrize(
    ("option", "value", "rule", "old", "new"),
    [
        ("--title", "Final test", "title", "Test", "Final test"),
        ("--open", None, "is_open", False, True),
        ("--no-publication", None, "allows_publication", True, False),
        ("--opens-at", "2030-01-02T03:04+02:00", "opens_at", None, "2030-01-02T01:04:00+00:00"),
        ("--closes-at", "2030-01-02", "closes_at", None, "2030-01-02T00:00:00+00:00"),
        ("--submissions-per-day", "0", "submissions_per_day", 10, 0),
        ("--rejections-per-day", "5", "rejections_per_day", 50, 5),
        ("--max-attempts", "1", "max_attempts", 3, 1),
    ],
)
def test_every_rule_is_changed_alone(
    admin: Admin, services: Services, phase: list[str], *, option: str, value: str | None, rule: str, old: Any, new: Any
) -> None:
    """Each option changes its rule; the trail has the old and the new value, and of nothing else."""
    changed = admin("edit-phase", *phase, option, *([] if value is None else [value]))
    assert changed == {"benchmark": "cs3d", "phase": "test", "changed": {rule: new}}
    assert _changes(services) == [{"old": {rule: old}, "new": {rule: new}}]
    (listed,) = admin("list-phases")["phases"]
    assert listed[rule] == new


def test_a_switch_is_switched_back(admin: Admin, services: Services, phase: list[str]) -> None:
    """--no-open and --publication take back what --open and --no-publication say; every step is in the trail."""
    admin("edit-phase", *phase, "--open", "--no-publication")
    admin("edit-phase", *phase, "--no-open", "--publication")
    assert (_phase(services).is_open, _phase(services).allows_publication) == (False, True)
    assert [change["new"] for change in _changes(services)] == [
        {"is_open": True, "allows_publication": False},
        {"is_open": False, "allows_publication": True},
    ]


def test_a_deadline_is_brought_forward_extended_and_taken_away(
    admin: Admin, services: Services, phase: list[str]
) -> None:
    """An early close refuses submissions at once; an extension takes them again, and so does no deadline at all."""
    admin("edit-phase", *phase, "--closes-at", "2020-01-01")
    with pytest.raises(PhaseClosed, match="closed at 2020-01-01"):
        send_one(services)
    admin("edit-phase", *phase, "--closes-at", "2090-01-01")
    send_one(services, data=b"one")
    assert admin("edit-phase", *phase, "--closes-at", "none")["changed"] == {"closes_at": None}
    send_one(services, data=b"two")
    assert _phase(services).closes_at is None


def test_a_smaller_quota_counts_from_the_change_on(admin: Admin, services: Services, phase: list[str]) -> None:
    """Two were sent when one is allowed: a third is refused, and `check` does not call the first two an overrun."""
    send_one(services, data=b"one")
    send_one(services, data=b"two")
    admin("edit-phase", *phase, "--submissions-per-day", "1")
    with pytest.raises(QuotaExceeded):
        send_one(services, data=b"three")
    assert checker.check(services, recompute=False) == []


def test_rules_that_are_so_already_change_nothing(
    admin: Admin, services: Services, says: Says, phase: list[str]
) -> None:
    """The same title and, in another zone, the same time: it is said, and there is no event."""
    admin("edit-phase", *phase, "--closes-at", "2090-01-01T02:00+02:00")
    same = ["--title", "Test", "--closes-at", "2090-01-01"]
    assert admin("edit-phase", *phase, *same)["changed"] == {}
    assert len(_changes(services)) == 1
    assert says("edit-phase", *phase, *same) == "cs3d/test has these rules already; nothing was changed.\n"


def test_what_changed_is_said(says: Says, phase: list[str]) -> None:
    """For people the rules are named with their new values."""
    options = ["--closes-at", "2090-01-01", "--max-attempts", "2"]
    changed = "closes_at is 2090-01-01T00:00:00+00:00, max_attempts is 2"
    assert says("edit-phase", *phase, *options) == f"Changed cs3d/test: {changed}.\n"


@pytest.mark.parametrize(
    ("options", "status", "said"),
    [
        ([], 2, "say what to change"),
        (["--title", "\t"], 1, "title must have"),
        (["--submissions-per-day", "-1"], 1, "submissions_per_day must be from 0"),
        (["--rejections-per-day", "0"], 1, "rejections_per_day must be from 1"),
        (["--max-attempts", "99999999999999999999"], 1, "max_attempts must be from 1 to 1000000"),
        (["--opens-at", "2030-01-02", "--closes-at", "2030-01-01"], 1, "closes_at 2030-01-01"),
        (["--closes-at", "2029-06-01"], 1, "must be after opens_at 2029-06-01"),
        (["--closes-at", "tomorrow"], 2, "not an ISO 8601 time"),
        (["--closes-at", "0001-01-01T00:00+23:00"], 2, "not an ISO 8601 time"),
        (["--protocol", "paper"], 2, "unrecognized arguments"),
    ],
)
def test_rules_that_cannot_be_are_refused(
    admin: Admin, services: Services, refused: Refused, phase: list[str], *, options: list[str], status: int, said: str
) -> None:
    """Also beside a rule that stays: the phase opens on 2029-06-01. Nothing is changed, not even in part."""
    admin("edit-phase", *phase, "--opens-at", "2029-06-01")
    ended, message = refused("edit-phase", *phase, *(["--open", *options] if options else []))
    assert (ended, said in message) == (status, True), message
    assert not _phase(services).is_open
    assert len(_changes(services)) == 1


@pytest.mark.parametrize("closes_at", ["2029-01-01", "2030-01-01"])
def test_no_phase_closes_before_it_opens(refused: Refused, admin: Admin, services: Services, closes_at: str) -> None:
    """`create-phase` refuses a close before the opening, or with it."""
    admin("create-benchmark", "cs3d", "--title", "Cityscapes 3D")
    dates = ["--opens-at", "2030-01-01", "--closes-at", closes_at]
    status, said = refused("create-phase", "cs3d", "test", "--title", "Test", *dates)
    assert (status, "must be after opens_at 2030-01-01" in said) == (1, True)
    with services.snapshot() as session:
        assert session.scalars(sa.select(Phase)).all() == []
        assert session.scalars(sa.select(AuditEvent).where(AuditEvent.action == "phase.created")).all() == []


def test_a_phase_that_is_not_there_has_no_rules(refused: Refused, phase: list[str]) -> None:
    """Its name is in the message."""
    assert refused("edit-phase", phase[0], "final", "--open") == (
        1,
        "cs3d-admin: there is no phase 'final' in benchmark 'cs3d'\n",
    )


def test_publication_is_not_forbidden_over_a_leaderboard(
    admin: Admin, services: Services, refused: Refused, sandbox: Sandbox
) -> None:
    """As long as a submission is published it is refused; withdrawn, the phase loses its leaderboard."""
    populate(admin)
    submission_id = score_one(services, sandbox)
    admin("publish", str(submission_id))
    status, said = refused("edit-phase", "cs3d", "test", "--no-publication")
    assert (status, "has 1 published; take them off" in said) == (1, True)
    admin("publish", str(submission_id), "--withdraw")
    admin("edit-phase", "cs3d", "test", "--no-publication")
    with services.snapshot() as session:
        assert not submissions.find(session, submission_id).phase.allows_publication
