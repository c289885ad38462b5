"""Workers on a re-scoring, in both shapes: behind whatever teams wait for, lost and found, never half published."""

import importlib.util
from collections.abc import Callable, Iterator
from datetime import timedelta
from pathlib import Path

import pytest
import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import database, ranking, rescoring, rescoring_decisions, rescoring_items, rescoring_sweeper, submissions
from server.checker import check
from server.claims import Claim
from server.errors import LeaseLost
from server.models import AuditEvent, ItemState, Rescoring, RescoringItem, SubmissionState
from server.queue import PRIORITY_BULK, PRIORITY_NORMAL
from tests.faults import points
from tests.integration.record.three_methods import Rescored, predictions
from tests.services.installation import Installation
from tests.services.processes import wait_until
from worker.sandbox import Sandbox


@pytest.fixture(scope="module")
def sandbox() -> Iterator[Sandbox]:
    """Give the worker's scoring process."""
    sandbox = Sandbox()
    sandbox.start()
    yield sandbox
    sandbox.kill()


@pytest.fixture
def rescored(installation: Installation, sandbox: Sandbox) -> Rescored:
    """Give an installation with two published methods."""
    rescored = Rescored(installation, sandbox)
    for method in ("complete", "partial"):
        rescored.add(method)
    return rescored


def _claim(rescored: Rescored, item_id: int) -> Claim:
    with rescored.services.transaction() as session:
        held = rescoring_items.claim(session, item_id, worker="w", lease_s=60)
    assert held is not None
    return held


def _expire(rescored: Rescored, item_id: int) -> ItemState | None:
    """Let the lease run out without waiting for it."""
    with rescored.services.transaction() as session:
        past = database.now(session) - timedelta(days=1)
        session.execute(sa.update(RescoringItem).where(RescoringItem.id == item_id).values(lease_expires_at=past))
    with rescored.services.transaction() as session:
        return rescoring_items.expire(session, item_id)


def test_first_time_submissions_do_not_wait_behind_a_rescoring(rescored: Rescored) -> None:
    """A worker with a full queue of bulk work takes every submission that a team waits for first."""
    installation, queue = rescored.installation, rescored.services.queue
    for item_id in rescored.start():
        queue.enqueue_item(item_id)
    waiting = [installation.submit(predictions("rough"), method=f"m{index}") for index in range(2)]
    assert (queue.depth(PRIORITY_BULK), queue.depth(PRIORITY_NORMAL)) == (2, 2)
    installation.start_worker(concurrency=1)
    for submission_id in waiting:
        installation.wait_for(submission_id, SubmissionState.SCORED)
    # Two items, and two more for the submissions that were scored meanwhile.
    wait_until(lambda: rescored.counts() == {ItemState.DONE: 4}, what="every item")
    with rescored.services.snapshot() as session:
        ended = ("submission.scored", "rescoring.scored")
        actions = sa.select(AuditEvent.action).where(AuditEvent.action.in_(ended)).order_by(AuditEvent.id)
        order = list(session.scalars(actions))
    # The two that were scored before it began, the two that teams waited for, then the bulk work.
    assert order == ["submission.scored"] * 4 + ["rescoring.scored"] * 4


def test_a_worker_killed_at_an_item_is_replaced(rescored: Rescored) -> None:
    """SIGKILL of a whole worker that computed an item's score: another one scores it, once, without help."""
    installation = rescored.installation
    faults = installation.folder / "faults"
    faults.mkdir()
    points.arm(faults, "scored", points.Strike(stop=True))
    first, second = rescored.start()
    rescored.services.queue.enqueue_item(first)
    rescored.services.queue.enqueue_item(second)
    installation.start_worker(module="tests.faults.worker_app", extra={points.FOLDER_VARIABLE: str(faults)})
    wait_until(lambda: points.taken_by(faults, "scored"), what="a strike")
    installation.workers[0].kill()
    installation.start_worker()
    wait_until(lambda: rescored.progress().complete, what="both items")
    with rescored.services.snapshot() as session:
        lost = list(session.scalars(sa.select(RescoringItem.lost_attempts).order_by(RescoringItem.lost_attempts)))
    assert lost == [0, 1]
    assert [len(installation.load(key).scores) for key in rescored.ids.values()] == [2, 2]
    rescored.publish()
    assert check(rescored.services) == []


def test_a_stale_worker_writes_nothing(rescored: Rescored) -> None:
    """Once its item was taken back and claimed again, every write of the first worker raises."""
    item_id, _ = rescored.start()
    stale = _claim(rescored, item_id)
    assert _expire(rescored, item_id) is ItemState.WAITING
    fresh = _claim(rescored, item_id)
    assert fresh.attempt == stale.attempt + 1
    writes: list[Callable[[Session], object]] = [
        lambda session: rescoring_items.heartbeat(session, stale, stage="scoring", images_done=0, images_total=1),
        lambda session: rescoring_items.fail(session, stale, code="x", detail="y"),
        lambda session: rescoring_items.give_back(session, stale, detail="z"),
        lambda session: rescoring_items.lose(session, stale, code="x", detail="y"),
    ]
    for write in writes:
        with rescored.services.transaction() as session, pytest.raises(LeaseLost):
            write(session)


def test_a_discarded_rescoring_ends_every_hold(rescored: Rescored) -> None:
    """A worker at an item of a re-scoring that was discarded has lost it; nothing claims the item again."""
    item_id, _ = rescored.start()
    held = _claim(rescored, item_id)
    with rescored.services.transaction() as session:
        rescoring_decisions.discard(session, rescored.phase(session), "admin:test")
    with rescored.services.transaction() as session:
        with pytest.raises(LeaseLost):
            rescoring_items.heartbeat(session, held, stage="scoring", images_done=0, images_total=1)
        assert rescoring_items.claim(session, item_id, worker="w", lease_s=60) is None


def test_lost_attempts_are_capped_and_retried_by_command(rescored: Rescored) -> None:
    """An item that loses three workers fails with its cause; retried, it has all its attempts again."""
    item_id, other = rescored.start()
    states = []
    for _ in range(3):
        _claim(rescored, item_id)
        states.append(_expire(rescored, item_id))
    assert states == [ItemState.WAITING, ItemState.WAITING, ItemState.FAILED]
    (failure,) = rescored.progress().failures
    assert failure.failure_code == "attempts_exhausted"
    with rescored.services.transaction() as session:
        one = rescoring.get_running(session, rescored.phase(session))
        assert rescoring_decisions.retry(session, one, "admin:test") == [item_id]
    rescored.work(item_id, other)
    assert rescored.counts() == {ItemState.DONE: 2}


def test_giving_an_item_back_costs_no_attempt(rescored: Rescored) -> None:
    """A worker that drains gives the item back; the sweeper sends a new message for it."""
    item_id, _ = rescored.start()
    for _ in range(5):
        held = _claim(rescored, item_id)
        with rescored.services.transaction() as session:
            rescoring_items.give_back(session, held, detail="drained")
    assert rescored.counts() == {ItemState.WAITING: 2}
    assert rescored.services.queue.depth(PRIORITY_BULK) == 0
    assert rescoring_sweeper.sweep(rescored.services) >= 1


def test_the_sweeper_adds_what_was_scored_meanwhile(rescored: Rescored) -> None:
    """A submission that is scored during a re-scoring gets its item, and the item its message, without a command."""
    rescored.start()
    rescored.add("rough", publish=False)
    rescoring_sweeper.sweep(rescored.services)
    assert rescored.counts() == {ItemState.WAITING: 3}
    assert rescored.progress().uncovered == 0


def test_a_reader_sees_the_old_ranking_or_the_new_one(rescored: Rescored) -> None:
    """Until the commit everybody reads the old ranking; who began to read before it finishes with the old one."""
    rescored.work(*rescored.start())
    old = [("complete", 1), ("partial", 2)]
    with rescored.services.snapshot() as reading:
        phase = rescored.phase(reading)
        with rescored.services.transaction() as session:
            rescoring_decisions.publish(session, rescored.phase(session), "admin:test")
            session.flush()
            assert rescored.board() == old
        assert [(row.method.slug, row.rank) for row in ranking.leaderboard(reading, phase).rows] == old
    assert rescored.board() == [("partial", 1), ("complete", 2)]


def test_a_raised_evaluator_version_is_put_in_force_at_once(
    rescored: Rescored, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scores by the evaluator in force rank until those by the next one are complete; other workers take no items."""
    with rescored.services.transaction() as session:
        rescored.phase(session).evaluator_version = "0"  # as if the scores there are were by an older one
    monkeypatch.setattr(rescoring, "EVALUATOR_VERSION", "2")
    items = []
    with rescored.services.transaction() as session:
        one = rescoring.start(session, phase=rescored.phase(session), actor="admin:test")
        items = rescoring.waiting(session, one)
    rescored.work(*items)  # this worker's evaluator is version 1
    assert rescored.counts() == {ItemState.WAITING: 2}


def test_a_score_by_the_evaluator_in_force_ranks_before_a_later_one(rescored: Rescored) -> None:
    """Of two scores on the same ground truth the one by the version in force ranks, whichever was made later."""
    with rescored.services.snapshot() as session:
        submission = submissions.find(session, rescored.ids["complete"])
        (score,) = submission.scores
    later = {
        name: getattr(score, name)
        for name in ("submission_id", "protocol", "protocol_version", "ground_truth_id", "attempt", "summary")
    }
    with rescored.services.transaction() as session:
        session.add(
            type(score)(
                **later,
                evaluator_version="next",
                mds=0.0,
                scores_sha256=score.scores_sha256,
                created_at=score.created_at,
            )
        )
    assert rescored.board() == [("complete", 1), ("partial", 2)]
    with rescored.services.transaction() as session:
        rescored.phase(session).evaluator_version = "next"
    assert rescored.board() == [("partial", 1), ("complete", 2)]


def test_trigger_and_code_know_the_same_transitions() -> None:
    """The table in the migration equals the one that the code goes by."""
    path = Path(database.migrations_folder()) / "versions" / "0004_rescorings.py"
    spec = importlib.util.spec_from_file_location("rescorings", path)
    assert spec is not None
    assert spec.loader is not None
    migration = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(migration)
    ours = {f"{source}>{target}" for source, targets in rescoring_items.TRANSITIONS.items() for target in targets}
    assert set(migration.ITEM_TRANSITIONS) == ours


def test_the_database_itself_refuses_illegal_items(rescored: Rescored) -> None:
    """A bare UPDATE cannot make a waiting item done, change one that is done, or delete any."""
    first, second = rescored.start()
    rescored.work(first)
    items = sa.update(RescoringItem)
    statements = (
        items.where(RescoringItem.id == second).values(state=ItemState.FAILED, failure_code="x"),
        items.where(RescoringItem.id == first).values(attempt=RescoringItem.attempt + 1),
        sa.delete(RescoringItem).where(RescoringItem.id == second),
        sa.delete(Rescoring),
        sa.update(Rescoring).values(protocol="other"),
    )
    for statement in statements:
        with pytest.raises(sa.exc.DBAPIError), rescored.services.transaction() as session:
            session.execute(statement)


@pytest.mark.parametrize("shape", ["embedded"])
def test_the_checker_finds_a_damaged_rescoring(rescored: Rescored) -> None:
    """An item with another item's score, and an open item of a published re-scoring, break their promises."""
    first, second = rescored.start()
    rescored.work(first, second)
    rescored.publish()
    with rescored.services.transaction() as session:
        for name in session.scalars(sa.text("SELECT name FROM sqlite_master WHERE type = 'trigger'")).all():
            session.execute(sa.text(f"DROP TRIGGER {name}"))
        score_id = sa.select(RescoringItem.score_id).where(RescoringItem.id == second).scalar_subquery()
        session.execute(sa.update(RescoringItem).where(RescoringItem.id == first).values(score_id=score_id))
    assert "items_have_their_scores" in {one.rule for one in check(rescored.services, recompute=False)}
    with rescored.services.transaction() as session:
        waiting = {"state": ItemState.WAITING, "score_id": None}
        session.execute(sa.update(RescoringItem).where(RescoringItem.id == first).values(waiting))
    assert "items_are_of_scored_submissions" in {one.rule for one in check(rescored.services, recompute=False)}
