"""Leaderboards: the published submissions of a phase, ranked by mDS in full precision.

Equal mDS share a rank and the next rank is skipped (1, 2, 2, 4). An undefined mDS has no rank and stands last. Within
equal mDS the earliest submission stands first.

What ranks is a basis: a protocol, an evaluator version and a version of the ground truth. A phase has one in force; a
re-scoring prepares another beside it (server/rescoring.py).
"""

import uuid
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

import msgspec
import sqlalchemy as sa
from sqlalchemy.orm import Session, defer, joinedload, object_session
from sqlalchemy.sql.base import ExecutableOption

from evaluator.protocol import Signature
from evaluator.results import Scores
from server.models import (
    Method,
    Phase,
    Publication,
    Rescoring,
    RescoringItem,
    RescoringState,
    Score,
    Submission,
    SubmissionState,
    Team,
)

_NO_CURVES: dict[str, tuple[float, ...]] = {"recall": (), "precision": ()}
"""What a summary leaves out of classes and depth bins."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Basis:
    """What scores are computed under."""

    protocol: str
    evaluator_version: str
    ground_truth_id: int | None
    """None: the phase has none yet."""

    @classmethod
    def of(cls, row: Phase | Rescoring | Score) -> "Basis":
        """Give the basis in force in a phase, the one a re-scoring prepares, or a score's own."""
        return cls(protocol=row.protocol, evaluator_version=row.evaluator_version, ground_truth_id=row.ground_truth_id)

    def fits(self) -> sa.ColumnElement[bool]:
        """Match the scores that are wholly on this basis."""
        return sa.and_(self.may_rank(), Score.evaluator_version == self.evaluator_version)

    def may_rank(self) -> sa.ColumnElement[bool]:
        """Match the scores that may rank on this basis: another evaluator version is better than no score."""
        return sa.and_(Score.protocol == self.protocol, Score.ground_truth_id == self.ground_truth_id)


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaderboardRow:
    """One method on a leaderboard."""

    rank: int | None
    """None: mDS is undefined."""
    submission: Submission
    method: Method
    team: Team
    score: Score
    mds: float | None

    @property
    def summary(self) -> dict[str, Any]:
        """`summary_of` its scores."""
        return self.score.summary


@dataclass(frozen=True, slots=True, kw_only=True)
class Leaderboard:
    """A phase's ranking under its protocol and the ground truth in force."""

    phase: Phase
    rows: tuple[LeaderboardRow, ...]


def leaderboard(session: Session, phase: Phase) -> Leaderboard:
    """Rank the published submissions of a phase; no submissions, no rows."""
    return Leaderboard(phase=phase, rows=ranked(ranking_scores(session, phase).values()))


def leaders(session: Session, phase: Phase, most: int) -> tuple[LeaderboardRow, ...]:
    """Give the first rows of a phase's leaderboard; summaries, which are large, are not read."""
    return ranked(ranking_scores(session, phase, summaries=False).values())[:most]


def ranked(scores: Iterable[Score]) -> tuple[LeaderboardRow, ...]:
    """Rank scores, one of each submission."""
    ordered = sorted(scores, key=_display_order)
    ranks = shared_ranks([score.mds for score in ordered])
    return tuple(
        LeaderboardRow(
            rank=rank,
            submission=score.submission,
            method=score.submission.method,
            team=score.submission.team,
            score=score,
            mds=score.mds,
        )
        for rank, score in zip(ranks, ordered, strict=True)
    )


def ranking_scores(session: Session, phase: Phase, *, summaries: bool = True) -> dict[uuid.UUID, Score]:
    """Find the score that ranks for every published submission.

    That is the one on the basis in force; where the evaluator version in force made none, the newest by another that
    was in force.
    """
    basis = Basis.of(phase)
    in_force = sa.case((Score.evaluator_version == basis.evaluator_version, 1), else_=0)
    condition = sa.and_(basis.may_rank(), was_in_force())
    return published_scores(session, phase, condition, in_force, Score.id, summaries=summaries)


def published_scores(
    session: Session,
    phase: Phase,
    condition: sa.ColumnElement[bool],
    *order: sa.SQLColumnExpression[Any],
    summaries: bool = True,
) -> dict[uuid.UUID, Score]:
    """Find the last score, in the given order, of every published submission that has one under a condition."""
    query = (
        sa.select(Score)
        .join(Score.submission)
        .where(
            Submission.phase_id == phase.id,
            Submission.publication == Publication.PUBLISHED,
            Submission.state == SubmissionState.SCORED,
            condition,
        )
        .options(
            joinedload(Score.submission).joinedload(Submission.method),
            joinedload(Score.submission).joinedload(Submission.team),
            *_light(summaries=summaries),
        )
        .order_by(*order)
    )
    return {score.submission_id: score for score in session.scalars(query)}


def ranking_score(submission: Submission) -> Score | None:
    """Find the score a submission is shown with: the one that ranks, else the newest that was ever in force."""
    basis = Basis.of(submission.phase)
    return max(history(submission), key=lambda score: _preference(score, basis), default=None)


def shown_scores(
    session: Session, submissions: Collection[Submission], *, summaries: bool = False
) -> dict[uuid.UUID, Score]:
    """Find the `ranking_score` of every submission that has one, by one query however many there are.

    Args:
        session: Where the submissions are from.
        submissions: With their phases.
        summaries: Read them, too; each is about 24 kB.
    """
    bases = {submission.id: Basis.of(submission.phase) for submission in submissions}
    query = sa.select(Score).where(Score.submission_id.in_(bases), was_in_force())
    found = session.scalars(query.options(*_light(summaries=summaries)))
    ordered = sorted(found, key=lambda score: _preference(score, bases[score.submission_id]))
    return {score.submission_id: score for score in ordered}


def _light(*, summaries: bool) -> list[ExecutableOption]:
    """Leave out what lists do not show."""
    return [defer(Score.integrity), *([] if summaries else [defer(Score.summary)])]


def _preference(score: Score, basis: Basis) -> tuple[bool, bool, int]:
    """Order the scores of a submission, the one it is shown with last."""
    may_rank = (score.protocol, score.ground_truth_id) == (basis.protocol, basis.ground_truth_id)
    return may_rank, may_rank and score.evaluator_version == basis.evaluator_version, score.id


def history(submission: Submission) -> list[Score]:
    """List the scores of a submission that are or were in force, oldest first.

    What a re-scoring made is not among them until it is published: nobody sees half of a new ranking.
    """
    session = object_session(submission)
    if session is None or len(submission.scores) < 2:  # noqa: PLR2004 - the first score is never a re-scoring's
        return list(submission.scores)
    query = sa.select(Score.id).where(Score.submission_id == submission.id, was_in_force())
    shown = set(session.scalars(query))
    return [score for score in submission.scores if score.id in shown]


def was_in_force() -> sa.ColumnElement[bool]:
    """Match scores that no re-scoring made, or that a published one brought into force."""
    of_score = sa.select(RescoringItem.id).where(RescoringItem.score_id == Score.id)
    published = of_score.join(RescoringItem.rescoring).where(Rescoring.state == RescoringState.PUBLISHED)
    return sa.or_(~of_score.where(RescoringItem.attempt > 0).exists(), published.exists())


def _display_order(score: Score) -> tuple[bool, float, float, str]:
    """Order best first, undefined last, then earliest submission first."""
    mds = score.mds
    created = score.submission.created_at.timestamp()
    return (mds is None, 0.0 if mds is None else -mds, created, str(score.submission_id))


def shared_ranks(values: list[float | None]) -> list[int | None]:
    """Rank values that are sorted best first, None last: equal values share the rank, None has none."""
    ranks: list[int | None] = []
    for position, value in enumerate(values, start=1):
        if value is None:
            ranks.append(None)
        elif ranks and values[position - 2] == value:
            ranks.append(ranks[-1])
        else:
            ranks.append(position)
    return ranks


def summary_of(scores: Scores) -> dict[str, Any]:
    """Give the scores without recall and precision lists, as plain JSON values."""
    summary: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(scores))
    del summary["thresholds"]
    for label in summary["classes"]:
        for part in (label, *label["depth_bins"]):
            for name in _NO_CURVES:
                del part[name]
    return summary


def signature_of(summary: dict[str, Any]) -> str:
    """Print what the score that this is a summary of depends on."""
    return str(msgspec.convert(summary["signature"], Signature))


def scores_of(summary: dict[str, Any]) -> Scores:
    """Give the scores that `summary_of` made a summary of, with empty lists of recall and precision."""
    classes = [
        {**label, **_NO_CURVES, "depth_bins": [{**depth_bin, **_NO_CURVES} for depth_bin in label["depth_bins"]]}
        for label in summary["classes"]
    ]
    return msgspec.convert({**summary, "thresholds": (), "classes": classes}, Scores)
