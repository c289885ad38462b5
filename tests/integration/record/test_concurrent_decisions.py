"""What maintainers decide at the same time does not undo one another. On PostgreSQL; SQLite has one writer at a time."""

import pytest

from server import integrity, submissions
from server.errors import Conflict
from tests.integration.record.test_lock_order import sandbox
from tests.integration.record.three_methods import Rescored
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
