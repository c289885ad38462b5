"""Leaderboards: the published submissions of a phase, ranked by mDS in full precision.

Equal mDS share a rank and the next rank is skipped (1, 2, 2, 4). An undefined mDS has no rank and stands last. Within
equal mDS the earliest submission stands first.
"""

import uuid
from dataclasses import dataclass
from typing import Any

import msgspec
import sqlalchemy as sa
from sqlalchemy.orm import Session, defer, joinedload

from evaluator.results import Scores
from server.models import Method, Phase, Publication, Score, Submission, SubmissionState, Team


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
    summary: dict[str, Any]
    """`summary_of` its scores."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Leaderboard:
    """A phase's ranking under its protocol and the ground truth in force."""

    phase: Phase
    rows: tuple[LeaderboardRow, ...]


def leaderboard(session: Session, phase: Phase) -> Leaderboard:
    """Rank the published submissions of a phase; no submissions, no rows."""
    scores = sorted(ranking_scores(session, phase).values(), key=_display_order)
    ranks = shared_ranks([score.mds for score in scores])
    rows = tuple(
        LeaderboardRow(
            rank=rank,
            submission=score.submission,
            method=score.submission.method,
            team=score.submission.team,
            score=score,
            mds=score.mds,
            summary=score.summary,
        )
        for rank, score in zip(ranks, scores, strict=True)
    )
    return Leaderboard(phase=phase, rows=rows)


def ranking_scores(session: Session, phase: Phase) -> dict[uuid.UUID, Score]:
    """Find the score that ranks for every published submission: the newest under the phase's protocol and ground truth."""
    query = (
        sa.select(Score)
        .join(Score.submission)
        .where(
            Submission.phase_id == phase.id,
            Submission.publication == Publication.PUBLISHED,
            Submission.state == SubmissionState.SCORED,
            Score.protocol == phase.protocol,
            Score.ground_truth_id == phase.ground_truth_id,
        )
        .options(
            joinedload(Score.submission).joinedload(Submission.method),
            joinedload(Score.submission).joinedload(Submission.team),
            defer(Score.integrity),
        )
        .order_by(Score.id)
    )
    return {score.submission_id: score for score in session.scalars(query)}


def ranking_score(submission: Submission) -> Score | None:
    """Find the score a submission is shown with: the newest under its phase's protocol and ground truth in force."""
    phase = submission.phase
    fitting = [
        score
        for score in submission.scores
        if score.protocol == phase.protocol and score.ground_truth_id == phase.ground_truth_id
    ]
    return max(fitting or submission.scores, key=lambda score: score.id, default=None)


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
        del label["recall"], label["precision"]
        for depth_bin in label["depth_bins"]:
            del depth_bin["recall"], depth_bin["precision"]
    return summary
