"""What a leaderboard needs beside a score is computed after it, by whichever worker gets to it, once."""

import dataclasses
import signal
from collections.abc import Generator, Iterator

import pytest
import sqlalchemy as sa

from evaluator.score_replicates import STANDARD_DRAW, ScoreReplicates
from server import audit, database, models, resampling
from server.models import Score, SubmissionState
from server.queue import PRIORITY_LATER
from tests.services.installation import Installation
from tests.services.processes import wait_until
from worker.child import EXIT_NO_ROOM
from worker.evaluation import evaluate_submission
from worker.messages import AnyJob, Broken, Event, Exit
from worker.resampling import resample_score
from worker.sandbox import Sandbox


@pytest.fixture
def sandbox() -> Iterator[Sandbox]:
    """Give a scoring process, ended after the test."""
    sandbox = Sandbox()
    yield sandbox
    sandbox.kill()


def _kept(installation: Installation) -> list[bytes]:
    """Read all replicates."""
    with installation.services.snapshot() as session:
        return list(session.scalars(sa.select(models.ScoreReplicates.data)))


def _scored(installation: Installation, sandbox: Sandbox) -> int:
    """Score a submission, nothing more, and return the score's id."""
    submission_id = installation.submit(enqueue=False)
    evaluate_submission(installation.services, sandbox, submission_id, worker="test")
    (score,) = installation.load(submission_id).scores
    return score.id


def test_a_worker_resamples_what_it_scored(installation: Installation) -> None:
    """The replicates are there soon after the score, from the draw that all scores share."""
    installation.start_worker()
    installation.wait_for(installation.submit(), SubmissionState.SCORED)
    wait_until(lambda: _kept(installation), what="replicates")
    (data,) = _kept(installation)
    assert ScoreReplicates.from_bytes(data).draw == STANDARD_DRAW


def test_a_lost_message_is_sent_again(installation: Installation, sandbox: Sandbox) -> None:
    """A score whose message was lost is resampled once the sweeper of a worker has sent it again."""
    _scored(installation, sandbox)
    installation.broker.lose_everything()
    assert _kept(installation) == []
    installation.start_worker()
    wait_until(lambda: _kept(installation), what="replicates")


def test_the_sweeper_sends_nothing_beside_messages_that_wait(installation: Installation, sandbox: Sandbox) -> None:
    """One message waits from the scoring; without it, and once it is overdue, one is sent; a resampled score needs none."""
    score_id = _scored(installation, sandbox)
    services = installation.services
    assert services.queue.depth(PRIORITY_LATER) == 1
    wait_until(lambda: _is_overdue(installation, score_id), what="that the message is overdue")
    assert resampling.sweep(services) == 0
    installation.broker.lose_everything()
    assert resampling.sweep(services) == 1
    installation.broker.lose_everything()
    resample_score(services, sandbox, score_id, worker="test")
    assert resampling.sweep(services) == 0


def _is_overdue(installation: Installation, score_id: int) -> bool:
    with installation.services.snapshot() as session:
        age = database.now(session) - session.get_one(Score, score_id).created_at
    return age.total_seconds() > installation.settings.resend_s + 1


def test_messages_twice_and_for_nothing_change_nothing(installation: Installation, sandbox: Sandbox) -> None:
    """The second message finds the work done, and what another worker writes late is dropped; unknown scores are none."""
    score_id = _scored(installation, sandbox)
    for _ in range(2):
        resample_score(installation.services, sandbox, score_id, worker="test")
    resample_score(installation.services, sandbox, score_id + 1000, worker="test")
    kept = _kept(installation)
    with installation.services.transaction() as session:
        resampling.keep(session, score_id, b"late")
        resampling.keep(session, score_id + 1000, b"of nothing")
    assert len(kept) == 1
    assert _kept(installation) == kept


def test_what_cannot_be_resampled_is_tried_once(installation: Installation, sandbox: Sandbox) -> None:
    """A score that needs more memory than there may be gets an empty row, so that it waits no longer."""
    score_id = _scored(installation, sandbox)
    services = installation.services
    too_little = services.settings.model_copy(update={"score_memory_bytes": 1 << 20})
    resample_score(dataclasses.replace(services, settings=too_little), sandbox, score_id, worker="test")
    assert _kept(installation) == [resampling.NONE_POSSIBLE]
    with services.snapshot() as session:
        assert resampling.statistics_waiting(session, score_id) is None


class _EndingSandbox(Sandbox):
    """A sandbox whose jobs end as they are told to."""

    def __init__(self, *said: Event) -> None:
        super().__init__()
        self._said = said

    def events(self, job: AnyJob, *, tick_s: float) -> Generator[Event | None, None, None]:
        """End at once."""
        del job, tick_s
        yield from self._said


KILLED = (Exit(status=-signal.SIGKILL),)
TOO_SLOW = (Exit(status=-signal.SIGXCPU),)
BROKEN = (Broken(detail="FileNotFoundError at jobs.py:1"), Exit(status=0))
DIED = (Exit(status=1),)
NO_ROOM = (Exit(status=EXIT_NO_ROOM),)


def _try(installation: Installation, score_id: int, said: tuple[Event, ...]) -> bool:
    """Resample to this end, and say whether the score still waits."""
    resample_score(installation.services, _EndingSandbox(*said), score_id, worker="test")
    with installation.services.snapshot() as session:
        return resampling.statistics_waiting(session, score_id) is not None


@pytest.mark.parametrize("said", [KILLED, TOO_SLOW, BROKEN, DIED, NO_ROOM])
def test_what_comes_to_no_end_waits_for_another_try(
    installation: Installation, sandbox: Sandbox, said: tuple[Event, ...]
) -> None:
    """A resampling that was killed, too slow, broken or without room says nothing about the score; the next one counts."""
    score_id = _scored(installation, sandbox)
    assert _try(installation, score_id, said)
    resample_score(installation.services, sandbox, score_id, worker="test")
    assert ScoreReplicates.from_bytes(_kept(installation)[0]).draw == STANDARD_DRAW


def test_what_always_takes_too_long_is_given_up(installation: Installation, sandbox: Sandbox) -> None:
    """The third try that comes to no end is the last; a full disk is no try."""
    score_id = _scored(installation, sandbox)
    ends = [TOO_SLOW, NO_ROOM, KILLED, NO_ROOM]
    assert [_try(installation, score_id, said) for said in ends] == [True] * 4
    assert not _try(installation, score_id, TOO_SLOW)
    assert _kept(installation) == [resampling.NONE_POSSIBLE]
    subject = f"score:{score_id}"
    with installation.services.snapshot() as session:
        reasons = [event.detail["reason"].split(":")[0] for event in audit.trail(session, subject)]
    assert reasons == ["time_limit", "scoring_killed", "time_limit"]


def test_the_next_try_is_not_at_once(installation: Installation, sandbox: Sandbox) -> None:
    """After a try that came to no end the sweeper leaves the score alone for a while, and sends what is not tried yet."""
    tried, untried = (_scored(installation, sandbox) for _ in range(2))
    services = installation.services
    wait_until(lambda: _is_overdue(installation, untried), what="that the messages are overdue")
    assert _try(installation, tried, TOO_SLOW)
    installation.broker.lose_everything()
    assert resampling.sweep(services) == 1
