"""What maintainers decide at the same time does not undo one another. On PostgreSQL; SQLite has one writer at a time."""

from collections.abc import Callable

import pytest
from sqlalchemy.orm import Session

from server import benchmarks, integrity, rescoring, rescoring_decisions, submissions
from server.errors import Conflict
from server.models import Phase, Rescoring
from tests.integration.record.test_lock_order import sandbox
from tests.integration.record.three_methods import Rescored, second_ground_truth
from tests.services.installation import Installation
from worker.sandbox import Sandbox

__all__ = ["sandbox"]

pytestmark = pytest.mark.parametrize("shape", ["scale_out"])


def test_a_release_does_not_lift_a_hold_it_has_not_seen(installation: Installation, sandbox: Sandbox) -> None:
    """A hold that another maintainer writes after the reason was read stands; read again, it is released."""
    key = Rescored(installation, sandbox).add("complete", publish=False)
    services = installation.services
    with services.transaction() as session:
        submissions.hold(session, submissions.find(session, key), reason="a copy?", actor="admin:one")
    with services.transaction() as session:
        submission = submissions.find(session, key)
        with services.transaction() as other:
            submissions.hold(other, submissions.find(other, key), reason="trained on test", actor="admin:two")
        with pytest.raises(Conflict, match="trained on test"):
            integrity.release(session, submission, "admin:one")
    assert installation.load(key).held_reason == "trained on test"
    with services.transaction() as session:
        integrity.release(session, submissions.find(session, key), "admin:one")
    assert installation.load(key).held_reason is None


@pytest.mark.parametrize("ending", [rescoring_decisions.publish, rescoring_decisions.discard])
def test_nothing_is_decided_about_a_rescoring_that_ended(
    installation: Installation, sandbox: Sandbox, ending: Callable[[Session, Phase, str], Rescoring]
) -> None:
    """One maintainer takes an exclusion back or excludes while another ends the re-scoring: the first one is refused."""
    rescored = Rescored(installation, sandbox)
    key = rescored.add("rough")
    rescored.start()
    services = installation.services
    with services.transaction() as session:
        one = rescoring.get_running(session, rescored.phase(session))
        rescoring_decisions.exclude(session, one, key, "its camera was wrong", "admin:one")
    with services.transaction() as session:
        one = rescoring.get_running(session, rescored.phase(session))
        with services.transaction() as other:
            ending(other, rescored.phase(other), "admin:two")
        with pytest.raises(Conflict, match="meanwhile"):
            rescoring_decisions.retry(session, one, "admin:one", key)
        with pytest.raises(Conflict, match="meanwhile"):
            rescoring_decisions.exclude(session, one, key, "its camera was wrong", "admin:one")


def test_ground_truth_in_force_at_once_meets_a_rescoring(
    installation: Installation, sandbox: Sandbox, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A re-scoring that begins after an import has read the phase, before it locks it, keeps what it replaces in force."""
    rescored = Rescored(installation, sandbox)
    rescored.add("complete", publish=False)
    services = installation.services
    prepared = benchmarks.prepare_ground_truth(services.blobs, second_ground_truth(installation.folder))
    lock = benchmarks._lock

    def begin_first(session: Session, phase: Phase) -> None:
        monkeypatch.setattr(benchmarks, "_lock", lock)
        with services.transaction() as other:
            rescoring.start(other, phase=rescored.phase(other), protocol="paper", actor="admin:two")
        lock(session, phase)

    monkeypatch.setattr(benchmarks, "_lock", begin_first)
    with services.transaction() as session:
        phase = rescored.phase(session)
        version = benchmarks.add_ground_truth(
            session, services.blobs, phase=phase, prepared=prepared, actor="admin:one"
        )
        assert not benchmarks.enforce_if_possible(session, phase, version, actor="admin:one")
