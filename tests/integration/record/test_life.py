"""The life of a submission, end to end with a real Celery worker, in both shapes."""

import os
import signal
from pathlib import Path

import msgspec
import pytest

from evaluator.results import Scores
from server import lifecycle, ranking, submissions
from server.errors import Forbidden, IllegalTransition, LeaseLost, NotScored
from server.models import AttemptOutcome, Publication, SubmissionState
from tests.faults import points
from tests.services.installation import Installation, zip_of
from tests.services.mail_sink import MailSink
from tests.services.processes import wait_until


def test_an_upload_is_scored_and_ranked(installation: Installation) -> None:
    """A valid upload is validated and scored by a worker, and ranked once its owner publishes it."""
    submission_id = installation.submit()
    installation.start_worker()
    submission = installation.wait_for(submission_id, SubmissionState.SCORED)
    (score,) = submission.scores
    scores = msgspec.json.decode(installation.services.blobs.read(score.scores_sha256), type=Scores)
    assert scores.mds == score.mds is not None
    assert scores.signature.predictions_sha256 == submission.predictions_sha256
    assert submission.phase.ground_truth is not None
    assert scores.signature.ground_truth_sha256 == submission.phase.ground_truth.sha256
    assert [attempt.outcome for attempt in submission.attempts] == [AttemptOutcome.SCORED]
    with installation.services.transaction() as session:
        submissions.publish(session, submissions.find(session, submission_id), "user:1")
    with installation.services.snapshot() as session:
        (row,) = ranking.leaderboard(session, submission.phase).rows
    assert (row.rank, row.mds, row.submission.id) == (1, score.mds, submission_id)


def test_a_bad_upload_is_rejected_with_its_report(installation: Installation) -> None:
    """Bytes that are no valid predictions end as rejected, with a report that says why."""
    submission_id = installation.submit(b"this is not a zip")
    installation.start_worker()
    submission = installation.wait_for(submission_id, SubmissionState.REJECTED)
    assert submission.report_sha256 is not None
    report = msgspec.json.decode(installation.services.blobs.read(submission.report_sha256))
    assert any(group["severity"] == "error" for group in report["groups"])
    assert [attempt.outcome for attempt in submission.attempts] == [AttemptOutcome.REJECTED]


def test_duplicate_messages_score_once(installation: Installation) -> None:
    """However often the message is delivered, there is one attempt and one score."""
    submission_id = installation.submit()
    for _ in range(4):
        installation.services.queue.enqueue(submission_id)
    installation.start_worker(concurrency=2)
    installation.wait_for(submission_id, SubmissionState.SCORED)
    last = installation.submit()  # by the time this one is scored, all duplicates before it were delivered
    installation.wait_for(last, SubmissionState.SCORED)
    submission = installation.load(submission_id)
    assert len(submission.scores) == 1
    assert len(submission.attempts) == 1


def test_lost_messages_are_sent_again(installation: Installation) -> None:
    """When the broker loses every message, the sweeper sends them again and everything is scored."""
    ids = [installation.submit(method=f"m{index}") for index in range(3)]
    installation.broker.lose_everything()
    installation.start_worker()
    for submission_id in ids:
        assert len(installation.wait_for(submission_id, SubmissionState.SCORED).scores) == 1


def test_a_dead_broker_delays_but_loses_nothing(installation: Installation) -> None:
    """While the broker is down uploads are taken; when it is back they are scored."""
    installation.broker.kill()
    submission_id = installation.submit()
    assert installation.state(submission_id) is SubmissionState.RECEIVED
    installation.broker.start()
    installation.start_worker()
    installation.wait_for(submission_id, SubmissionState.SCORED)


def _struck_worker(installation: Installation, point: str, strike: points.Strike) -> Path:
    """Start a worker that is struck at a point of its work; give the folder in which strikes are noted."""
    faults = installation.folder / "faults"
    faults.mkdir()
    points.arm(faults, point, strike)
    installation.start_worker(module="tests.faults.worker_app", extra={points.FOLDER_VARIABLE: str(faults)})
    return faults


@pytest.mark.parametrize("point", ["claimed", "scored", "commit_sent"])
def test_a_worker_killed_at_work_is_replaced(installation: Installation, point: str) -> None:
    """SIGKILL of a whole worker right after it claimed, while it scores or after its commit: scored once, without help.

    Killed before the commit, its attempt is lost and the next one scores. Killed after it, there is nothing to repeat.
    """
    submission_id = installation.submit()
    faults = _struck_worker(installation, point, points.Strike(stop=True))
    wait_until(lambda: points.taken_by(faults, point), what=f"a strike at {point}")
    installation.workers[0].kill()
    installation.start_worker()
    submission = installation.wait_for(submission_id, SubmissionState.SCORED)
    lost = [] if point == "commit_sent" else [AttemptOutcome.LOST]
    assert [attempt.outcome for attempt in submission.attempts] == [*lost, AttemptOutcome.SCORED]
    assert len(submission.scores) == 1


def test_a_worker_that_wakes_up_late_writes_nothing(installation: Installation) -> None:
    """A worker frozen beyond its lease finds its submission scored by another, and leaves it alone."""
    submission_id = installation.submit()
    faults = _struck_worker(installation, "scored", points.Strike(stop=True))
    wait_until(lambda: points.taken_by(faults, "scored"), what="a strike")
    installation.start_worker()
    installation.wait_for(submission_id, SubmissionState.SCORED)
    (stale,) = points.taken_by(faults, "scored")
    os.kill(stale, signal.SIGCONT)
    wait_until(lambda: b"lease_lost" in installation.workers[0].log_path.read_bytes(), what="the late write")
    submission = installation.load(submission_id)
    assert [attempt.outcome for attempt in submission.attempts] == [AttemptOutcome.LOST, AttemptOutcome.SCORED]
    assert len(submission.scores) == 1


def test_a_failed_submission_is_told_and_tried_again(installation: Installation, mail_sink: MailSink) -> None:
    """A submission whose bytes are gone fails; maintainers get a mail; re-queued after the repair it is scored."""
    data = zip_of(installation.case / "pred")
    submission_id = installation.submit(data, enqueue=False)
    blobs = installation.services.blobs
    blobs.delete(installation.load(submission_id).predictions_sha256)
    installation.services.queue.enqueue(submission_id)
    mail = {"CS3D_SMTP_HOST": "127.0.0.1", "CS3D_SMTP_PORT": str(mail_sink.port), "CS3D_MAINTAINERS_EMAIL": "m@x.org"}
    installation.start_worker(extra=mail)
    submission = installation.wait_for(submission_id, SubmissionState.FAILED)
    assert submission.failure_code == "blob_missing"
    wait_until(lambda: mail_sink.mails, what="a mail")
    assert str(submission_id) in str(mail_sink.mails[0].get_payload())
    blobs.put_bytes(data)
    with installation.services.transaction() as session:
        submissions.requeue(session, submissions.find(session, submission_id), "admin:test")
    installation.services.queue.enqueue(submission_id)
    assert len(installation.wait_for(submission_id, SubmissionState.SCORED).scores) == 1


def test_cancelling_takes_the_submission_from_its_worker(installation: Installation) -> None:
    """A cancelled submission is never claimed again, and a worker that validates it writes nothing any more."""
    submission_id = installation.submit(enqueue=False)
    with installation.services.transaction() as session:
        held = lifecycle.claim(session, submission_id, worker="w", lease_s=60)
    assert held is not None
    with installation.services.transaction() as session:
        submissions.cancel(session, submissions.find(session, submission_id), "user:1")
    with installation.services.transaction() as session:
        assert lifecycle.claim(session, submission_id, worker="w", lease_s=60) is None
        with pytest.raises(LeaseLost):
            lifecycle.heartbeat(session, held, stage="validating", images_done=1, images_total=2)
    with installation.services.transaction() as session, pytest.raises(IllegalTransition):
        submissions.cancel(session, submissions.find(session, submission_id), "user:1")


def test_publishing_another_submission_replaces_the_row(installation: Installation) -> None:
    """A method has one row: publishing a second submission withdraws the first; withdrawing empties the row."""
    first, second = installation.submit(), installation.submit()
    with installation.services.transaction() as session, pytest.raises(NotScored):
        submissions.publish(session, submissions.find(session, first), "user:1")
    installation.start_worker()
    for submission_id in (first, second):
        installation.wait_for(submission_id, SubmissionState.SCORED)
        with installation.services.transaction() as session:
            submissions.publish(session, submissions.find(session, submission_id), "user:1")
    assert installation.load(first).publication is Publication.WITHDRAWN
    with installation.services.snapshot() as session:
        rows = ranking.leaderboard(session, installation.phase).rows
    assert [row.submission.id for row in rows] == [second]
    with installation.services.transaction() as session:
        submissions.withdraw(session, submissions.find(session, second), "user:1")
    with installation.services.snapshot() as session:
        assert ranking.leaderboard(session, installation.phase).rows == ()


def test_a_phase_without_leaderboard_takes_no_publication(installation: Installation) -> None:
    """Where the phase does not allow publication, a scored submission stays private."""
    submission_id = installation.submit()
    installation.start_worker()
    installation.wait_for(submission_id, SubmissionState.SCORED)
    with installation.services.transaction() as session:
        submission = submissions.find(session, submission_id)
        submission.phase.allows_publication = False
        session.flush()
        with pytest.raises(Forbidden):
            submissions.publish(session, submission, "user:1")
