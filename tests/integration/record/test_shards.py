"""Sharded scoring: several workers match one submission's images; whatever is lost, it ends as if one had done all."""

from collections.abc import Iterator
from datetime import timedelta

import msgspec
import pytest
import sqlalchemy as sa

from server import database, file_sweeper, shards
from server.checker import check
from server.models import AttemptOutcome, Shard, Submission, SubmissionState
from tests.faults import points
from tests.integration.record.sharded import WatchedSandbox, divide, once, shard_rows
from tests.services.installation import Installation
from tests.services.processes import wait_until
from worker.evaluation import evaluate_submission, match_shard
from worker.messages import AnyJob, Reduction, ShardJob
from worker.sandbox import Sandbox

SHARDS = 2
PATIENT = pytest.mark.parametrize("services", [{"lease_s": 60.0}], indirect=True)
"""No lease runs out by itself, however slow the machine is."""


@pytest.fixture
def sandbox() -> Iterator[WatchedSandbox]:
    """Give the scoring process of the submission's holder, ended after the test."""
    sandbox = WatchedSandbox()
    yield sandbox
    sandbox.kill()


@pytest.fixture
def other_sandbox() -> Iterator[WatchedSandbox]:
    """Give the scoring process of another worker, ended after the test."""
    sandbox = WatchedSandbox()
    yield sandbox
    sandbox.kill()


@pytest.fixture
def sharded(installation: Installation) -> Installation:
    """Give an installation whose phase is scored in two shards, of one image each."""
    divide(installation, SHARDS)
    return installation


def _results(installation: Installation, submission: Submission) -> tuple[bytes, bytes, bytes]:
    """Give what is kept of a score: scores, statistics and integrity audit."""
    (score,) = submission.scores
    assert score.statistics_sha256 is not None
    store = installation.services.blobs
    return store.read(score.scores_sha256), store.read(score.statistics_sha256), msgspec.json.encode(score.integrity)


def _whole(installation: Installation, sandbox: Sandbox) -> tuple[bytes, bytes, bytes]:
    """Score the case's predictions in one piece."""
    divide(installation, 1)
    submission_id = installation.submit(enqueue=False)
    evaluate_submission(installation.services, sandbox, submission_id, worker="whole")
    divide(installation, SHARDS)
    return _results(installation, installation.load(submission_id))


def _score(installation: Installation, sandbox: Sandbox) -> Submission:
    """Let one process do what a message asks for."""
    submission_id = installation.submit(enqueue=False)
    evaluate_submission(installation.services, sandbox, submission_id, worker="holder")
    return installation.load(submission_id)


def test_shards_score_as_one(installation: Installation, sandbox: WatchedSandbox) -> None:
    """One process alone, all messages lost, scores the same bytes in 1, 2 and 7 shards and in more than images."""
    results = []
    for count in (1, 2, 7, 64):
        divide(installation, count)
        results.append(_results(installation, _score(installation, sandbox)))
        assert shard_rows(installation) == []
    assert results == [results[0]] * 4
    assert check(installation.services) == []


@PATIENT
def test_real_workers_share_a_submission(sharded: Installation, sandbox: WatchedSandbox) -> None:
    """Two processes of a real worker, with each message sent twice, score what one process scores in one piece."""
    whole = _whole(sharded, sandbox)
    submission_id = sharded.submit()
    sharded.services.queue.enqueue(submission_id)
    sharded.services.queue.enqueue_shards(submission_id, 1, SHARDS)
    sharded.start_worker(concurrency=2)
    submission = sharded.wait_for(submission_id, SubmissionState.SCORED)
    assert _results(sharded, submission) == whole
    assert [attempt.outcome for attempt in submission.attempts] == [AttemptOutcome.SCORED]
    assert shard_rows(sharded) == []
    assert check(sharded.services) == []


@PATIENT
def test_another_worker_does_its_part(
    sharded: Installation, sandbox: WatchedSandbox, other_sandbox: WatchedSandbox
) -> None:
    """A shard that another worker finished is not done again; both results join; messages come twice without effect."""
    whole = _whole(sharded, sandbox)
    rows: list[Shard] = []

    def help_out(job: AnyJob) -> None:
        held = shard_rows(sharded)[0]
        for number in (0, 0, 1, 1, 7):  # the holder holds the last one, and there is no 7
            match_shard(sharded.services, other_sandbox, held.submission_id, held.attempt, number, worker="other")
        del job

    def look(job: AnyJob) -> AnyJob:
        if isinstance(job, Reduction):
            rows.extend(shard_rows(sharded))
        return helping(job)

    helping = once(help_out, ShardJob)
    sandbox.before = look
    submission = _score(sharded, sandbox)
    assert [(row.worker, row.claims) for row in rows] == [("other", 1), ("holder", 1)]
    assert _results(sharded, submission) == whole
    match_shard(sharded.services, other_sandbox, submission.id, 1, 0, worker="other")
    assert shard_rows(sharded) == []


def test_a_silent_workers_shard_is_taken_over(sharded: Installation, sandbox: WatchedSandbox) -> None:
    """A shard whose worker was killed waits for its lease alone; then the holder does it."""
    rows: list[Shard] = []

    def take_and_die(job: AnyJob) -> None:
        row = shard_rows(sharded)[0]
        with sharded.services.transaction() as session:
            assert shards.claim(session, row.submission_id, row.attempt, 0, worker="dead", lease_s=1)
        del job

    def look(job: AnyJob) -> AnyJob:
        if isinstance(job, Reduction):
            rows.extend(shard_rows(sharded))
        return dying(job)

    dying = once(take_and_die, ShardJob)

    sandbox.before = look
    submission = _score(sharded, sandbox)
    assert submission.state is SubmissionState.SCORED
    assert [(row.worker, row.claims) for row in rows] == [("holder", 2), ("holder", 1)]


def test_a_killed_process_costs_a_claim_of_its_shard(sharded: Installation, sandbox: WatchedSandbox) -> None:
    """SIGKILL of the process that matches a shard: the shard is matched again, the attempt goes on."""
    sandbox.kills = shards.CAP - 1
    submission = _score(sharded, sandbox)
    assert submission.state is SubmissionState.SCORED
    assert [attempt.outcome for attempt in submission.attempts] == [AttemptOutcome.SCORED]


def test_a_shard_lost_too_often_loses_the_attempt(sharded: Installation, sandbox: WatchedSandbox) -> None:
    """A shard that kills its process at every claim costs the attempt with its cause; the next one starts afresh."""
    sandbox.kills = shards.CAP
    submission = _score(sharded, sandbox)
    assert submission.state is SubmissionState.QUEUED
    (attempt,) = submission.attempts
    assert attempt.outcome is AttemptOutcome.LOST
    assert attempt.detail is not None
    assert attempt.detail.startswith("images 1 to 1: the scoring process was killed")
    assert shard_rows(sharded) == []
    evaluate_submission(sharded.services, sandbox, submission.id, worker="holder")
    assert sharded.state(submission.id) is SubmissionState.SCORED


def test_an_evaluator_error_in_a_shard_fails_the_submission(sharded: Installation, sandbox: WatchedSandbox) -> None:
    """Trying again would not help, so nothing is tried again."""
    sandbox.before = lambda job: msgspec.structs.replace(job, protocol="none") if isinstance(job, ShardJob) else job
    submission = _score(sharded, sandbox)
    assert (submission.state, submission.failure_code) == (SubmissionState.FAILED, "evaluator_error")
    assert submission.failure_detail is not None
    assert submission.failure_detail.startswith("images 1 to 1: the evaluator broke down: KeyError")


@PATIENT
def test_a_killed_holder_is_replaced(sharded: Installation, sandbox: WatchedSandbox) -> None:
    """SIGKILL of the whole worker that holds a submission, all shards done: the next attempt makes its own shards."""
    whole = _whole(sharded, sandbox)
    submission_id = sharded.submit()
    faults = sharded.folder / "faults"
    faults.mkdir()
    points.arm(faults, "scored", points.Strike(stop=True))
    sharded.start_worker(module="tests.faults.worker_app", extra={points.FOLDER_VARIABLE: str(faults)})
    wait_until(lambda: points.taken_by(faults, "scored"), what="a strike")
    sharded.workers[0].kill()
    assert [row.attempt for row in shard_rows(sharded) if row.result_sha256] == [1] * SHARDS
    with sharded.services.transaction() as session:  # as if its lease had run out
        past = database.now(session) - timedelta(seconds=1)
        session.execute(sa.update(Submission).where(Submission.id == submission_id).values(lease_expires_at=past))
    sharded.start_worker()
    submission = sharded.wait_for(submission_id, SubmissionState.SCORED)
    assert [attempt.outcome for attempt in submission.attempts] == [AttemptOutcome.LOST, AttemptOutcome.SCORED]
    assert _results(sharded, submission) == whole
    assert shard_rows(sharded) == []


def test_a_rejected_upload_has_no_shards(sharded: Installation, sandbox: WatchedSandbox) -> None:
    """The holder validates the whole upload before anything is divided."""
    submission_id = sharded.submit(b"not a zip", enqueue=False)
    evaluate_submission(sharded.services, sandbox, submission_id, worker="holder")
    submission = sharded.load(submission_id)
    assert submission.state is SubmissionState.REJECTED
    assert submission.report_sha256 is not None
    assert shard_rows(sharded) == []


@pytest.mark.parametrize("services", [{"heartbeat_s": 1e-5}], indirect=True)
def test_progress_is_the_sum_over_shards(sharded: Installation, sandbox: WatchedSandbox) -> None:
    """Images done are those of the shards that are done, whoever did them: 0 of 2, then 1 of 2, then 2 of 2."""
    seen: list[tuple[type[AnyJob], int, int]] = []

    def look(job: AnyJob) -> AnyJob:
        submission = sharded.load(submission_id)
        seen.append((type(job), submission.images_done, submission.images_total))
        return job

    submission_id = sharded.submit(enqueue=False)
    sandbox.before = look
    evaluate_submission(sharded.services, sandbox, submission_id, worker="holder")
    assert seen[1:] == [(ShardJob, 0, 2), (ShardJob, 1, 2), (Reduction, 2, 2)]


def test_blobs_of_shards_are_kept_while_they_are_needed(sharded: Installation, sandbox: WatchedSandbox) -> None:
    """The sweeper spares what a shard's row keeps, and deletes it once the submission is scored."""
    swept: list[int] = []

    def sweep() -> None:
        swept.append(file_sweeper.sweep_orphans(sharded.services, grace_s=-60))

    def before(job: AnyJob) -> AnyJob:
        sweep()
        return job

    sandbox.before = before
    submission = _score(sharded, sandbox)
    assert submission.state is SubmissionState.SCORED
    assert swept == [0] * 4  # one preparation, two shards, one reduction
    sweep()
    assert swept[-1] == 3  # the arrays of the predictions and two results
    assert check(sharded.services) == []
