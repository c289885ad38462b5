"""What a re-scoring would change on the leaderboard: every published submission before and after.

For the maintainers, before they publish the re-scoring; it is kept in the audit event of the publication.
"""

import uuid

import msgspec
import sqlalchemy as sa
from sqlalchemy.orm import Session

from server import ranking
from server.models import ItemState, Phase, Rescoring, RescoringItem, Score, Submission
from server.ranking import Basis, LeaderboardRow


class RankChange(msgspec.Struct, frozen=True, kw_only=True):
    """One published submission before and after."""

    method: str
    team: str
    submission: str
    old_rank: int | None
    """None: it has no rank."""
    new_rank: int | None
    old_mds: float | None
    """In [0, 1], higher is better; None: undefined, or there is no such score."""
    new_mds: float | None
    difference: float | None
    """New mDS less old mDS; None unless both are defined."""
    item: str
    """The state of its item: only what is `done` has its new score. `missing`: the sweeper has not added it yet."""

    @property
    def change(self) -> str:
        """Say in a word what happens to its row: up, down, same, enters or leaves."""
        if self.old_rank is None or self.new_rank is None:
            same = self.old_rank == self.new_rank
            return "same" if same else "enters" if self.old_rank is None else "leaves"
        return "up" if self.new_rank < self.old_rank else "down" if self.new_rank > self.old_rank else "same"


class Finding(msgspec.Struct, frozen=True, kw_only=True):
    """What the integrity audit says of one new score, published or not."""

    submission: str
    publication: str
    reasons: list[str]
    held: str | None
    """Why it is held at present."""


class RankChanges(msgspec.Struct, frozen=True, kw_only=True):
    """The whole difference."""

    complete: bool
    """False: submissions still wait for their new score, so ranks may change."""
    rows: list[RankChange]
    """Best new rank first; those without one last."""
    findings: list[Finding]


def rank_changes(session: Session, phase: Phase, rescoring: Rescoring) -> RankChanges:
    """Compare the ranking in force with the one that a re-scoring prepares."""
    new_scores = ranking.published_scores(session, phase, Basis.of(rescoring).fits(), Score.id)
    old = {row.submission.id: row for row in ranking.leaderboard(session, phase).rows}
    new = {row.submission.id: row for row in ranking.ranked(new_scores.values())}
    states = _item_states(session, rescoring)
    rows = [
        _change((old.get(key) or new[key]).submission, old.get(key), new.get(key), states.get(key, "missing"))
        for key in {**new, **old}
    ]
    return RankChanges(
        complete=all(row.item in (ItemState.DONE, ItemState.EXCLUDED) for row in rows),
        rows=sorted(rows, key=_best_first),
        findings=_findings(session, rescoring),
    )


def _item_states(session: Session, rescoring: Rescoring) -> dict[uuid.UUID, str]:
    query = sa.select(RescoringItem.submission_id, RescoringItem.state).where(
        RescoringItem.rescoring_id == rescoring.id
    )
    return {submission_id: state.value for submission_id, state in session.execute(query)}


def _change(submission: Submission, old: LeaderboardRow | None, new: LeaderboardRow | None, item: str) -> RankChange:
    before, after = old.mds if old else None, new.mds if new else None
    return RankChange(
        method=submission.method.slug,
        team=submission.team.slug,
        submission=str(submission.id),
        old_rank=old.rank if old else None,
        new_rank=new.rank if new else None,
        old_mds=before,
        new_mds=after,
        difference=None if before is None or after is None else after - before,
        item=item,
    )


def _best_first(row: RankChange) -> tuple[bool, int, str]:
    return (row.new_rank is None, row.new_rank or row.old_rank or 0, row.submission)


def _findings(session: Session, rescoring: Rescoring) -> list[Finding]:
    """List what the audits of the new scores give as reasons to look."""
    query = (
        sa.select(Submission.id, Submission.publication, Submission.held_reason, Score.integrity)
        .join(Score, Score.submission_id == Submission.id)
        .join(RescoringItem, RescoringItem.score_id == Score.id)
        .where(RescoringItem.rescoring_id == rescoring.id)
        .order_by(RescoringItem.id)
    )
    return [
        Finding(
            submission=str(submission_id), publication=publication.value, reasons=audit["reasons"], held=held_reason
        )
        for submission_id, publication, held_reason, audit in session.execute(query)
        if audit and audit["reasons"]
    ]
