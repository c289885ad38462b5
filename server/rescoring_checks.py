"""What the checker (server/checker.py) asks of re-scorings."""

from collections.abc import Iterator

import sqlalchemy as sa
from sqlalchemy.orm import Session

from server.models import ItemState, RescoringItem, RescoringState, SubmissionState
from server.ranking import Basis
from server.services import Services


def items_have_their_scores(services: Services, session: Session) -> Iterator[tuple[str, str]]:
    """An item that is done has a score of its own submission, on the basis of its re-scoring, by its latest attempt.

    Another item may have made the score before, in a re-scoring that was discarded.
    """
    del services
    made = {(item.score_id, item.attempt) for item in session.scalars(_done())}
    for item in session.scalars(_done()):
        subject, score = f"rescoring_item:{item.id}", item.score
        if score is None or score.submission_id != item.submission_id:
            yield subject, "is done, but its score is missing or another submission's"
        elif Basis.of(score) != Basis.of(item.rescoring):
            yield subject, f"its score is on {Basis.of(score)} instead of {Basis.of(item.rescoring)}"
        elif item.attempt and (score.id, score.attempt) not in made:
            yield subject, f"attempt {item.attempt} made it, but its score says {score.attempt}"


def _done() -> sa.Select[RescoringItem]:
    return sa.select(RescoringItem).where(RescoringItem.state == ItemState.DONE)


def items_are_of_scored_submissions(services: Services, session: Session) -> Iterator[tuple[str, str]]:
    """Every item stands for a scored submission of the phase; a re-scoring that was published left none open."""
    del services
    settled = {ItemState.DONE, ItemState.EXCLUDED}
    for item in session.scalars(sa.select(RescoringItem)):
        subject, submission = f"rescoring_item:{item.id}", item.submission
        if submission.state is not SubmissionState.SCORED or submission.phase_id != item.rescoring.phase_id:
            yield subject, f"is about submission {submission.id}, {submission.state} in phase {submission.phase_id}"
        if item.rescoring.state is RescoringState.PUBLISHED and item.state not in settled:
            yield subject, f"is {item.state}, but its re-scoring is published"


def made_again(session: Session) -> set[int]:
    """Name the scores that re-scorings made."""
    query = sa.select(RescoringItem.score_id).where(RescoringItem.score_id.is_not(None), RescoringItem.attempt > 0)
    return {score_id for score_id in session.scalars(query) if score_id is not None}


RULES = (items_have_their_scores, items_are_of_scored_submissions)
