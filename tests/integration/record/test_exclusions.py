"""A submission that a maintainer excluded from a re-scoring does not rank, whatever is scored later, in both shapes."""

import pytest

from server import exclusions, ranking, rescoring, rescoring_decisions, submissions
from server.checker import check
from server.errors import NotScored
from server.models import ItemState, Rescoring, RescoringItem, RescoringState, Score
from tests.integration.record.test_rescoring import NEW_ORDER, rescored, sandbox
from tests.integration.record.three_methods import Rescored

__all__ = ["rescored", "sandbox"]

REASON = "trained on the test images"


def _exclude(rescored: Rescored, method: str) -> None:
    with rescored.services.transaction() as session:
        one = rescoring.get_running(session, rescored.phase(session))
        rescoring_decisions.exclude(session, one, rescored.ids[method], REASON, "admin:test")


def _take_back(rescored: Rescored, method: str) -> list[int]:
    with rescored.services.transaction() as session:
        one = rescoring.get_running(session, rescored.phase(session))
        return rescoring_decisions.retry(session, one, "admin:test", rescored.ids[method])


def _waiting(rescored: Rescored) -> list[int]:
    with rescored.services.snapshot() as session:
        return rescoring.waiting(session, rescoring.get_running(session, rescored.phase(session)))


def _discard(rescored: Rescored) -> None:
    with rescored.services.transaction() as session:
        rescoring_decisions.discard(session, rescored.phase(session), "admin:test")


def _publish(rescored: Rescored, method: str) -> None:
    """Publish as the team would."""
    with rescored.services.transaction() as session:
        submissions.publish(session, submissions.find(session, rescored.ids[method]), "user:1")


def _shown(rescored: Rescored, method: str) -> int:
    """Read which ground truth the score that the team sees is on."""
    with rescored.services.snapshot() as session:
        score = ranking.ranking_score(submissions.find(session, rescored.ids[method]))
    assert score is not None
    return score.ground_truth_id


def test_a_score_of_a_discarded_rescoring_does_not_rank(rescored: Rescored) -> None:
    """An exclusion taken back in a re-scoring that is discarded stands: its score is neither shown nor published.

    Once such a re-scoring is published the submission ranks, with the score that the discarded one left.
    """
    items = rescored.start()
    _exclude(rescored, "rough")
    rescored.work(*items)
    rescored.publish()
    old = _shown(rescored, "rough")
    assert rescored.start(new_ground_truth=False) == []
    rescored.work(*_take_back(rescored, "rough"))
    assert len(rescored.installation.load(rescored.ids["rough"]).scores) == 2
    assert _shown(rescored, "rough") == old
    _discard(rescored)
    assert _shown(rescored, "rough") == old
    with pytest.raises(NotScored, match=REASON):
        _publish(rescored, "rough")
    assert rescored.board() == NEW_ORDER[:2]

    rescored.start(new_ground_truth=False)
    assert rescored.counts() == {ItemState.DONE: 2, ItemState.EXCLUDED: 1}
    rescored.work(*_take_back(rescored, "rough"))
    assert len(rescored.installation.load(rescored.ids["rough"]).scores) == 2
    rescored.publish()
    _publish(rescored, "rough")
    assert rescored.board() == NEW_ORDER
    assert check(rescored.services) == []


def test_an_exclusion_lasts_as_long_as_the_ground_truth(rescored: Rescored) -> None:
    """Another protocol on the same ground truth leaves it excluded; on other ground truth it is scored again."""
    rescored.start(protocol="paper", new_ground_truth=False)
    _exclude(rescored, "rough")
    rescored.work(*_waiting(rescored))
    rescored.publish()
    rescored.start(protocol="cityscapes3d", new_ground_truth=False)
    assert rescored.counts() == {ItemState.DONE: 2, ItemState.EXCLUDED: 1}
    rescored.publish()
    # Its first score is on what ranks again.
    with pytest.raises(NotScored, match=REASON):
        _publish(rescored, "rough")
    rescored.work(*rescored.start())
    rescored.publish()
    _publish(rescored, "rough")
    assert rescored.board() == NEW_ORDER
    with rescored.services.snapshot() as session:
        assert exclusions.reason(session, submissions.find(session, rescored.ids["rough"])) is None


@pytest.mark.parametrize("state", [RescoringState.RUNNING, RescoringState.DISCARDED])
def test_the_newest_score_by_another_evaluator_was_in_force(rescored: Rescored, state: RescoringState) -> None:
    """Where the evaluator in force made no score, one that only an unpublished re-scoring made does not stand in."""
    key = rescored.ids["complete"]
    own = rescored.installation.load(key).scores[0]
    with rescored.services.transaction() as session:
        phase = rescored.phase(session)
        phase.evaluator_version = "8"
        columns = {column.name: getattr(own, column.name) for column in Score.__table__.columns if column.name != "id"}
        score = Score(**columns | {"evaluator_version": "9"})
        one = Rescoring(
            phase_id=phase.id,
            ground_truth_id=own.ground_truth_id,
            protocol=own.protocol,
            evaluator_version="9",
            state=state,
            created_at=own.created_at,
            ended_at=own.created_at if state is RescoringState.DISCARDED else None,
        )
        session.add(RescoringItem(rescoring=one, submission_id=key, state=ItemState.DONE, attempt=1, score=score))
    with rescored.services.snapshot() as session:
        assert ranking.ranking_scores(session, rescored.phase(session))[key].id == own.id
        shown = ranking.ranking_score(submissions.find(session, key))
    assert shown is not None
    assert shown.id == own.id
