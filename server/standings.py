"""How far a leaderboard can be trusted: intervals of mDS, rank intervals, and groups that cannot be told apart.

All of it follows from the replicates the worker kept with each score. They never change, so what follows from a given
set of resampled scores is kept in memory and the page of a leaderboard reads no replicates again.
"""

import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count, product
from string import ascii_lowercase
from typing import ClassVar

import numpy as np
import sqlalchemy as sa
from sqlalchemy.orm import Session

from evaluator.confidence import Interval
from evaluator.interval_rules import FEWEST_BOXES_FOR_DIFFERENCE
from evaluator.score_replicates import MDS, STANDARD_DRAW, ScoreReplicates
from evaluator.standings import Standings
from evaluator.uncertainty import Comparison, compare_replicates
from server import models
from server.ranking import LeaderboardRow
from server.resampling import NONE_POSSIBLE

_Key = tuple[tuple[uuid.UUID, int, bool], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """What is known of one row beside its score.

    Nothing of a score that waits for resampling, or of too few boxes (evaluator/interval_rules.py).
    """

    interval: Interval | None = None
    """Of mDS, at 95 %."""
    ranks: tuple[int, int] | None = None
    """Best and worst rank."""
    groups: tuple[str, ...] = ()
    """Letters: rows that share one cannot be told apart; none for a row that differs from all others."""


UNKNOWN = Standing()


class StandingsCache:
    """The standings of the leaderboards that were asked for last."""

    _MOST: ClassVar[int] = 64

    def __init__(self) -> None:
        """Start empty."""
        self._known: dict[_Key, dict[uuid.UUID, Standing]] = {}

    def of(self, session: Session, rows: Sequence[LeaderboardRow]) -> dict[uuid.UUID, Standing]:
        """Give the standing of each submission of a leaderboard; rows come best first, as they do there."""
        kept = _resampled(session, rows)
        key = tuple((row.submission.id, row.score.id, row.score.id in kept) for row in rows)
        found = self._known.get(key)
        if found is None:
            found = standings_from(rows, replicates_of(session, rows))
            while len(self._known) >= self._MOST:
                self._known.pop(next(iter(self._known)), None)
            self._known[key] = found
        return found


def _resampled(session: Session, rows: Sequence[LeaderboardRow]) -> frozenset[int]:
    """Find which scores have been resampled."""
    column = models.ScoreReplicates.score_id
    return frozenset(session.scalars(sa.select(column).where(column.in_([row.score.id for row in rows]))))


def replicates_of(session: Session, rows: Sequence[LeaderboardRow]) -> dict[uuid.UUID, ScoreReplicates]:
    """Read the replicates of rows, by submission.

    Left out are rows without any, with other resamples than usual, and with too few boxes to trust them.
    """
    kept = _trusted_of(session, [row.score.id for row in rows])
    return {row.submission.id: kept[row.score.id] for row in rows if row.score.id in kept}


def interval_of(session: Session, score: models.Score) -> Interval | None:
    """Give the interval of one score's mDS; None where nothing is known of it (yet)."""
    kept = _trusted_of(session, [score.id])
    return kept[score.id].intervals[MDS] if kept else None


def _trusted_of(session: Session, score_ids: Sequence[int]) -> dict[int, ScoreReplicates]:
    table = models.ScoreReplicates
    query = sa.select(table.score_id, table.data).where(table.score_id.in_(score_ids), table.data != NONE_POSSIBLE)
    found = {score_id: ScoreReplicates.from_bytes(data) for score_id, data in session.execute(query)}
    return {score_id: kept for score_id, kept in found.items() if _trusted(kept)}


def _trusted(kept: ScoreReplicates) -> bool:
    return kept.draw == STANDARD_DRAW and kept.intervals[MDS] is not None


def standings_from(
    rows: Sequence[LeaderboardRow], replicates: dict[uuid.UUID, ScoreReplicates]
) -> dict[uuid.UUID, Standing]:
    """Rank the rows of a leaderboard, best first, on every resample.

    A score without replicates has no standing; among the others it holds its place with its mDS alone.
    """
    if not replicates:
        return {row.submission.id: UNKNOWN for row in rows}
    fixed = {
        row.submission.id: np.full(STANDARD_DRAW.resamples, np.nan if row.mds is None else row.mds) for row in rows
    }
    ids = list(fixed)
    standings = Standings.of(replicates[one].mds if one in replicates else fixed[one] for one in ids)
    ranks = standings.rank_intervals()
    letters: dict[uuid.UUID, tuple[str, ...]] = dict.fromkeys(ids, ())
    known = [place for place, one in enumerate(ids) if one in replicates]
    for letter, group in zip(_letters(), standings.groups(known)):  # noqa: B905 - there are always more letters
        for place in group:
            letters[ids[place]] += (letter,)
    return {
        one: Standing(interval=replicates[one].intervals[MDS], ranks=ranks[place], groups=letters[one])
        if one in replicates
        else UNKNOWN
        for place, one in enumerate(ids)
    }


def comparison(
    first: ScoreReplicates | None, second: ScoreReplicates | None, difference: float | None
) -> Comparison | None:
    """Judge how much the mDS of the second differs from that of the first.

    Args:
        first: Of one submission; None: it has none.
        second: Of the other, for the same ground truth.
        difference: Second minus first, as scored; None: undefined.

    Returns:
        None where it is undefined or nothing is known of it.
    """
    if first is None or second is None or difference is None:
        return None
    return compare_replicates(difference, second.mds - first.mds)


def class_comparison(
    first: ScoreReplicates | None, second: ScoreReplicates | None, difference: float | None, label: str, *, boxes: float
) -> Comparison | None:
    """Judge the same of the detection score of one class, which has so many ground-truth boxes."""
    if first is None or second is None or difference is None or boxes < FEWEST_BOXES_FOR_DIFFERENCE:
        return None
    if first.intervals.get(label) is None or second.intervals.get(label) is None:
        return None
    return compare_replicates(difference, second.detection_scores[label] - first.detection_scores[label])


def _letters() -> Iterator[str]:
    """Yield a, b, ... z, aa, ab, ... zz, aaa, ... without end."""
    for length in count(1):
        yield from map("".join, product(ascii_lowercase, repeat=length))
