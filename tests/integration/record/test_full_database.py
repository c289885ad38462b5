"""A database whose disk is full for a while costs no attempt: workers beat, wait and give back as if it were away."""

import time
from collections.abc import Callable, Generator, Iterator
from typing import Any

import pytest
import sqlalchemy as sa

from server import sweeper
from server.models import AttemptOutcome, SubmissionState
from tests.integration.record.sharded import divide
from tests.services.installation import QUICK, Installation
from tests.services.processes import wait_until
from worker.child import EXIT_NO_ROOM
from worker.evaluation import evaluate_submission
from worker.messages import AnyJob, Event, Exit, Job, ShardJob, Validated
from worker.sandbox import Sandbox

OFTEN = {**QUICK, "heartbeat_s": 0.05, "lease_s": 60.0}
"""A heartbeat is due whenever the scoring process says something; nobody else takes the submission."""


class _Disk:
    """Refuses what is written to the database while it is full; counts what it refused."""

    def __init__(self, engine: sa.Engine) -> None:
        self.room_after: int | None = 0
        """So many refusals from now; None: never."""
        self.refused = 0
        sa.event.listen(engine, "before_cursor_execute", self._refuse)

    def _refuse(self, connection: sa.Connection, cursor: object, statement: str, *more: object) -> None:
        del connection, cursor, more
        if self.room_after == 0 or not statement.startswith(("INSERT", "UPDATE")):
            return
        self.room_after = None if self.room_after is None else self.room_after - 1
        self.refused += 1
        raise sa.exc.OperationalError(statement, {}, Exception("database or disk is full"))


class _ActingSandbox(Sandbox):
    """A real scoring process; a test acts at each thing that it says, and before the first of a job."""

    def __init__(self, act: Callable[[AnyJob, Event | None], None]) -> None:
        super().__init__()
        self._act = act

    def events(self, job: AnyJob, *, tick_s: float) -> Generator[Event | None, None, None]:
        """Yield a moment of silence, then what the job says."""
        self._act(job, None)
        time.sleep(OFTEN["heartbeat_s"])
        yield None  # a heartbeat is due
        for event in super().events(job, tick_s=tick_s):
            self._act(job, event)
            yield event


@pytest.fixture
def disk(installation: Installation) -> Iterator[_Disk]:
    """Give the database's disk; it has room again after the test."""
    disk = _Disk(installation.services.engine)
    yield disk
    disk.room_after = 0


def _score(installation: Installation, act: Callable[[AnyJob, Event | None], None]) -> list[AttemptOutcome]:
    """Score a submission, and say how its attempts ended."""
    submission_id = installation.submit(enqueue=False)
    sandbox = _ActingSandbox(act)
    try:
        evaluate_submission(installation.services, sandbox, submission_id, worker="test")
    finally:
        sandbox.kill()
    return [attempt.outcome for attempt in installation.load(submission_id).attempts]


@pytest.mark.parametrize("services", [OFTEN], indirect=True)
@pytest.mark.parametrize(("shards", "kind"), [(1, Job), (2, ShardJob)])
def test_a_heartbeat_that_finds_no_room_is_made_again(
    installation: Installation, disk: _Disk, shards: int, kind: type[Any]
) -> None:
    """No room at a heartbeat, of a submission or of a shard, ends nothing: there is room at the next one."""
    divide(installation, shards)

    def act(job: AnyJob, event: Event | None) -> None:
        if isinstance(job, kind):
            disk.room_after = None if event is None and not disk.refused else 0

    assert _score(installation, act) == [AttemptOutcome.SCORED]
    assert disk.refused > 0


@pytest.mark.parametrize("services", [OFTEN], indirect=True)
def test_what_is_done_waits_for_room(installation: Installation, disk: _Disk) -> None:
    """A report that the database has no room for is written once there is some; the work goes on from there."""

    def act(job: AnyJob, event: Event | None) -> None:
        del job
        if isinstance(event, Validated):
            disk.room_after = 2

    assert _score(installation, act) == [AttemptOutcome.SCORED]
    assert disk.refused == 2


@pytest.mark.parametrize("services", [{**QUICK, "lease_s": 0.4, "heartbeat_s": 0.05}], indirect=True)
def test_what_cannot_be_given_back_is_left_to_the_sweeper(installation: Installation, disk: _Disk) -> None:
    """Where there is no room for the end either, the worker goes on to other tasks; the sweeper takes the submission."""

    def act(job: AnyJob, event: Event | None) -> None:
        del job, event
        disk.room_after = None

    class NoRoom(_ActingSandbox):
        def events(self, job: AnyJob, *, tick_s: float) -> Generator[Event | None, None, None]:
            """End for want of room."""
            del tick_s
            self._act(job, None)
            yield Exit(status=EXIT_NO_ROOM)

    submission_id = installation.submit(enqueue=False)
    evaluate_submission(installation.services, NoRoom(act), submission_id, worker="test")
    disk.room_after = 0

    def is_taken_back() -> bool:
        sweeper.sweep(installation.services)
        return installation.state(submission_id) is SubmissionState.RECEIVED

    wait_until(is_taken_back, what="that the lease runs out")
