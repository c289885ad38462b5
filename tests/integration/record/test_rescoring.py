"""Re-scoring a phase, in both shapes: beside what ranks, then in force all at once."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from server import (
    audit,
    backup,
    database,
    exclusions,
    lifecycle,
    ranking,
    rescoring,
    rescoring_decisions,
    rescoring_items,
    submissions,
)
from server.checker import check
from server.errors import Conflict, Held, NotFound, NotScored
from server.models import AttemptOutcome, ItemState, Publication, RescoringItem, SubmissionState
from server.rank_changes import rank_changes
from server.ranking import history, ranking_score
from server.services import Services
from server.settings import Settings
from tests.integration.record.three_methods import Rescored, predictions, run, second_ground_truth
from tests.services.installation import Installation
from tests.services.processes import wait_until
from worker.attempt import Attempt
from worker.evaluation import carry_out, evaluate_submission
from worker.rescoring import ItemAttempt
from worker.sandbox import Sandbox

OLD_ORDER = [("complete", 1), ("partial", 2), ("rough", 3)]
"""On the first ground truth `complete` is perfect; the others miss a car; `rough` is turned as well."""
NEW_ORDER = [("partial", 1), ("complete", 2), ("rough", 3)]
"""On the second one `partial` is perfect; `complete` has one box too many."""


@pytest.fixture(scope="module")
def sandbox() -> Iterator[Sandbox]:
    """Give the worker's scoring process."""
    sandbox = Sandbox()
    sandbox.start()
    yield sandbox
    sandbox.kill()


@pytest.fixture
def rescored(installation: Installation, sandbox: Sandbox) -> Rescored:
    """Give an installation with three published methods."""
    rescored = Rescored(installation, sandbox)
    for method in ("complete", "partial", "rough"):
        rescored.add(method)
    assert rescored.board() == OLD_ORDER
    return rescored


def test_the_whole_story_by_command(
    rescored: Rescored, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Import, score again with a real worker, look at the diff, publish: the order changes at the last step only."""
    installation = rescored.installation
    source = second_ground_truth(installation.folder)

    def command(action: str, *more: str) -> dict[str, Any]:
        assert run(installation, monkeypatch, "rescore", action, "cs3d", "test", "--json", *more) == 0
        answer: dict[str, Any] = json.loads(capsys.readouterr().out)
        return answer

    assert command("start", "--ground-truth", str(source))["items"] == 3
    installation.start_worker()
    wait_until(lambda: rescored.progress().complete, what="every new score")
    assert command("status")["counts"] == {
        "waiting": 0, "running": 0, "done": 3, "failed": 0, "excluded": 0, "new": 0,
    }  # fmt: skip
    assert rescored.board() == OLD_ORDER
    rows = command("diff")["rows"]
    assert [(row["method"], row["old_rank"], row["new_rank"], row["change"]) for row in rows] == [
        ("partial", 2, 1, "up"), ("complete", 1, 2, "down"), ("rough", 3, 3, "same"),
    ]  # fmt: skip
    assert rows[0]["new_mds"] == rows[1]["old_mds"] == 1.0
    assert rows[0]["difference"] == rows[0]["new_mds"] - rows[0]["old_mds"]
    assert command("publish")["in_force"]["ground_truth_version"] == 2
    assert rescored.board() == NEW_ORDER
    assert check(rescored.services) == []


def test_history_shows_both_scores_and_who_ranks(rescored: Rescored) -> None:
    """Nobody is shown a score of a re-scoring before it is published; afterwards both stand in the history."""
    items = rescored.start()
    rescored.work(*items)
    key = rescored.ids["partial"]
    with rescored.services.snapshot() as session:
        submission = submissions.find(session, key)
        old, new = submission.scores
        assert history(submission) == [old]
        assert ranking_score(submission) is old
    version = rescored.installation.load(key).version
    rescored.publish()
    with rescored.services.snapshot() as session:
        submission = submissions.find(session, key)
        assert [score.id for score in history(submission)] == [old.id, new.id]
        shown = ranking_score(submission)
        assert shown is not None
        assert shown.id == new.id
        assert submission.version > version  # whoever polls is told


def test_publication_waits_for_every_score(rescored: Rescored) -> None:
    """While one submission lacks its score nothing is put in force; the trail then keeps the old and the new basis."""
    first, *others = rescored.start()
    rescored.work(*others)
    with pytest.raises(Conflict, match="1 of 3"):
        rescored.publish()
    assert rescored.board() == OLD_ORDER
    rescored.work(first)
    rescored.publish()
    with rescored.services.snapshot() as session:
        phase = rescored.phase(session)
        (event,) = [one for one in audit.trail(session, f"phase:{phase.id}") if one.action == "rescoring.published"]
    assert (event.detail["old"]["ground_truth_version"], event.detail["new"]["ground_truth_version"]) == (1, 2)


def test_what_is_scored_meanwhile_is_scored_again_too(rescored: Rescored) -> None:
    """A submission that is scored during the re-scoring holds the publication up until it has its second score."""
    rescored.work(*rescored.start())
    late = rescored.add("late")
    with pytest.raises(Conflict, match="1 of 4"):
        rescored.publish()
    with rescored.services.transaction() as session:
        one = rescoring.get_running(session, rescored.phase(session))
        items = rescoring.cover(session, one)
        assert rescoring.cover(session, one) == []
    rescored.work(*items)
    rescored.publish()
    # `late` predicts the same as `partial`: they share the first rank, the earlier one stands first.
    assert rescored.board() == [("partial", 1), ("late", 1), ("complete", 3), ("rough", 4)]
    assert len(rescored.installation.load(late).scores) == 2


def test_a_score_on_replaced_ground_truth_is_computed_anew(rescored: Rescored) -> None:
    """A worker that comes with a score on ground truth that was replaced meanwhile makes the submission wait again.

    Nobody sees a score that ranks nowhere, and the attempt does not count as lost.
    """
    rescored.work(*rescored.start())

    class Overtaken(Attempt):
        def _scored(self) -> None:
            rescored.publish()
            super()._scored()

    submission_id = rescored.installation.submit(predictions("partial"), method="late", enqueue=False)
    with rescored.services.transaction() as session:
        held = lifecycle.claim(session, submission_id, worker="slow", lease_s=60)
    assert held is not None
    carry_out(Overtaken(rescored.services, held), rescored.sandbox)
    assert rescored.installation.state(submission_id) is SubmissionState.QUEUED
    evaluate_submission(rescored.services, rescored.sandbox, submission_id, worker="w")
    submission = rescored.installation.load(submission_id)
    assert [attempt.outcome for attempt in submission.attempts] == [AttemptOutcome.RETURNED, AttemptOutcome.SCORED]
    assert [score.ground_truth_id for score in submission.scores] == [submission.phase.ground_truth_id]
    assert check(rescored.services) == []


def test_duplicate_messages_make_one_score(rescored: Rescored) -> None:
    """However often an item's message comes, there is one attempt and one new score."""
    items = rescored.start()
    rescored.work(*items, *items, *items)
    assert rescored.counts() == {ItemState.DONE: 3}
    with rescored.services.snapshot() as session:
        assert set(session.scalars(sa.select(RescoringItem.attempt))) == {1}
    assert [len(rescored.installation.load(key).scores) for key in rescored.ids.values()] == [2, 2, 2]


def test_an_excluded_submission_leaves_the_leaderboard(rescored: Rescored) -> None:
    """What cannot be scored again may be excluded with a reason; it is withdrawn with the publication, not before."""
    predictions_sha256 = rescored.installation.load(rescored.ids["rough"]).predictions_sha256
    items = rescored.start()
    rescored.services.blobs.delete(predictions_sha256)
    rescored.work(*items)
    (failure,) = rescored.progress().failures
    assert (failure.submission_id, failure.failure_code) == (rescored.ids["rough"], "blob_missing")
    with pytest.raises(Conflict, match="1 failed"):
        rescored.publish()
    with rescored.services.transaction() as session:
        one = rescoring.get_running(session, rescored.phase(session))
        rescoring_decisions.exclude(session, one, rescored.ids["rough"], "its bytes are lost", "admin:test")
    assert rescored.board() == OLD_ORDER
    rescored.publish()
    assert rescored.board() == NEW_ORDER[:2]
    with rescored.services.transaction() as session:
        rough = submissions.find(session, rescored.ids["rough"])
        assert rough.publication is Publication.WITHDRAWN
        assert exclusions.reason(session, rough) == "its bytes are lost"
        with pytest.raises(NotScored):
            submissions.publish(session, rough, "user:1")


def test_a_discarded_rescoring_leaves_no_trace_in_the_ranking(rescored: Rescored) -> None:
    """After `discard` the old ranking stands, late workers write nothing, and another re-scoring uses what is there."""
    first, second, _ = rescored.start()
    rescored.work(first)
    with rescored.services.transaction() as session:
        rescoring_decisions.discard(session, rescored.phase(session), "admin:test")
    rescored.work(second)
    assert rescored.board() == OLD_ORDER
    assert [len(rescored.installation.load(key).scores) for key in rescored.ids.values()] == [2, 1, 1]
    with rescored.services.transaction() as session:
        phase = rescored.phase(session)
        with pytest.raises(NotFound):
            rescoring.get_running(session, phase)
        again = rescoring.start(session, phase=phase, version=2, actor="admin:test")
        items = rescoring.waiting(session, again)
    assert len(items) == 2
    rescored.work(*items)
    rescored.publish()
    assert rescored.board() == NEW_ORDER
    assert check(rescored.services) == []


def test_another_protocol_is_put_in_force(rescored: Rescored) -> None:
    """The same ground truth under another protocol: the phase then ranks and scores by that one."""
    items = rescored.start(protocol="paper", new_ground_truth=False)
    rescored.work(*items)
    rescored.publish()
    with rescored.services.snapshot() as session:
        assert rescored.phase(session).protocol == "paper"
    assert [method for method, _ in rescored.board()] == ["complete", "partial", "rough"]


def test_nothing_is_begun_without_need(rescored: Rescored) -> None:
    """Where every submission has the score that is asked for, no re-scoring begins; nor does a second one beside one."""
    with pytest.raises(Conflict, match="nothing was begun"):
        rescored.start(new_ground_truth=False)
    rescored.start()
    with rescored.services.transaction() as session, pytest.raises(Conflict, match="already"):
        rescoring.start(session, phase=rescored.phase(session), protocol="paper", actor="admin:test")


class Suspicious(ItemAttempt):
    """Scores whose audit gives a reason to look."""

    def _scored(self) -> None:
        path = self.folder / "integrity.json"
        findings = {**json.loads(path.read_bytes()), "held": True, "reasons": ["The modal boxes gain too much."]}
        path.write_text(json.dumps(findings))
        super()._scored()


def test_findings_on_new_scores_are_the_maintainers_to_judge(
    rescored: Rescored, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the audit of a new score finds stands in the diff and takes nothing down; `hold` does, until `release`."""
    first, *others = rescored.start()
    rescored.work(*others)
    with rescored.services.transaction() as session:
        held = rescoring_items.claim(session, first, worker="w", lease_s=60)
    assert held is not None
    carry_out(Suspicious(rescored.services, held), rescored.sandbox)
    with rescored.services.snapshot() as session:
        phase = rescored.phase(session)
        (finding,) = rank_changes(session, phase, rescoring.get_running(session, phase)).findings
    assert (finding.submission, finding.held) == (str(rescored.ids["complete"]), None)
    assert finding.reasons == ["The modal boxes gain too much."]
    rescored.publish()
    assert rescored.board() == NEW_ORDER
    key = str(rescored.ids["complete"])
    assert run(rescored.installation, monkeypatch, "hold", key, "--reason", finding.reasons[0]) == 0
    assert rescored.board() == [("partial", 1), ("rough", 2)]
    with rescored.services.transaction() as session:
        complete = submissions.find(session, rescored.ids["complete"])
        with pytest.raises(Held, match="gain too much"):
            submissions.publish(session, complete, "user:1")
    assert run(rescored.installation, monkeypatch, "release", key) == 0
    assert run(rescored.installation, monkeypatch, "publish", key) == 0
    assert rescored.board() == NEW_ORDER
    assert check(rescored.services) == []


def test_decisions_by_command(
    rescored: Rescored, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Status draws a bar; a submission is excluded, taken back and excluded again; a refusal and a discard are told."""
    first, *_ = rescored.start()
    rescored.work(first)
    rough = str(rescored.ids["rough"])

    def command(action: str, *more: str) -> tuple[int, str]:
        status = run(rescored.installation, monkeypatch, "rescore", action, "cs3d", "test", *more)
        return status, capsys.readouterr().out

    status, text = command("status")
    assert (status, text) == (0, f"[{'#' * 10}{'-' * 20}] 1/3 2 waiting, 1 done\n")
    assert command("exclude", rough, "--reason", "its camera was wrong")[0] == 0
    assert "1 excluded" in command("status")[1]
    assert command("retry", rough) == (0, "1 submission waits again.\n")
    assert command("exclude", rough, "--reason", " ")[0] == 1
    status, text = command("diff")
    assert status == 0
    assert "Not complete" in text
    assert command("publish")[0] == 1
    assert command("discard") == (0, "Discarded. What ranks is unchanged.\n")
    assert command("status")[0] == 1


def test_a_backup_holds_rescorings(rescored: Rescored, tmp_path: Path) -> None:
    """A record with a published re-scoring is backed up whole, and restored it ranks and checks as before."""
    rescored.work(*rescored.start())
    rescored.publish()
    counts = backup.backup(rescored.services, tmp_path / "backup")
    assert (counts["rescoring"], counts["rescoring_item"]) == (1, 3)
    restored = Services.from_settings(
        Settings(data_dir=tmp_path / "restored", broker_url=rescored.installation.broker.url)
    )
    try:
        database.migrate(restored.engine)
        assert backup.restore(restored, tmp_path / "backup") == counts
        assert check(restored) == []
        with restored.snapshot() as session:
            rows = ranking.leaderboard(session, rescored.phase(session)).rows
        assert [(row.method.slug, row.rank) for row in rows] == NEW_ORDER
    finally:
        restored.close()
