"""How far a ranking can be trusted, as the API and the pages say it."""

import csv
import io
import uuid
from collections.abc import Callable
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np
import pytest
import sqlalchemy as sa
from sqlalchemy.orm import Session

from evaluator.confidence import Interval
from evaluator.interval_rules import FEWEST_BOXES_FOR_DIFFERENCE
from evaluator.score_replicates import MDS, STANDARD_DRAW, Draw, ScoreReplicates
from server import benchmarks, models, ranking
from server.models import Method, Score, Submission, Team
from server.ranking import LeaderboardRow
from server.standings import UNKNOWN, Standing, StandingsCache, class_comparison, comparison, standings_from
from tests.integration.api.test_following import zip_with
from tests.integration.api.test_leaderboards import BOARD, NOTHING_FOUND, published
from tests.integration.site import Site

INTERVAL = Interval(estimate=0.5, lower=0.4, upper=0.6)


def _row(mds: float | None) -> LeaderboardRow:
    submission = Submission(id=uuid.uuid4(), created_at=datetime(2026, 1, 1, tzinfo=UTC))
    return LeaderboardRow(rank=None, submission=submission, method=Method(), team=Team(), score=Score(), mds=mds)


def _replicates(*halves: float) -> ScoreReplicates:
    """Make replicates that hold one value in the first half of the resamples and another in the second."""
    mds = np.repeat(halves, STANDARD_DRAW.resamples // 2)
    return ScoreReplicates(
        draw=STANDARD_DRAW,
        mds=mds,
        detection_scores={"car": mds, "train": mds},
        intervals={MDS: INTERVAL, "car": INTERVAL, "train": None},
    )


def test_methods_that_trade_places_share_ranks_and_a_letter() -> None:
    """A and B lead on half of the resamples each; C is always third and in no group."""
    rows = [_row(0.5), _row(0.49), _row(0.1)]
    kept = [_replicates(0.5, 0.4), _replicates(0.4, 0.5), _replicates(0.1, 0.1)]

    found = standings_from(rows, {row.submission.id: part for row, part in zip(rows, kept, strict=True)})

    assert [found[row.submission.id] for row in rows] == [
        Standing(interval=INTERVAL, ranks=(1, 2), groups=("a",)),
        Standing(interval=INTERVAL, ranks=(1, 2), groups=("a",)),
        Standing(interval=INTERVAL, ranks=(3, 3), groups=()),
    ]


def test_every_group_has_a_letter_however_many_there_are() -> None:
    """Of a hundred methods each trades places with its neighbours alone, with either on half of the resamples."""
    rows = [_row(0.9 - 0.001 * place) for place in range(100)]
    kept = {
        row.submission.id: _replicates(-(place ^ 1), -(place + 1 if place % 2 else max(place - 1, 0)))
        for place, row in enumerate(rows)
    }

    found = [standings_from(rows, kept)[row.submission.id].groups for row in rows]

    assert all(set(one) & set(other) for one, other in pairwise(found))
    assert not any(set(found[place]) & set(found[place + 2]) for place in range(98))
    assert {"a", "z", "aa", "cu"} <= set().union(*found)


def test_a_score_without_replicates_keeps_its_place_and_has_no_standing() -> None:
    """The older score of .45 stands between: A is above it on half of the resamples only. Undefined ones stand last."""
    rows = [_row(0.5), _row(0.45), _row(None)]

    found = standings_from(rows, {rows[0].submission.id: _replicates(0.5, 0.4)})

    assert found[rows[0].submission.id].ranks == (1, 2)
    assert [found[row.submission.id] for row in rows[1:]] == [UNKNOWN, UNKNOWN]


def test_without_any_replicates_nothing_is_known() -> None:
    """Neither of one older score nor of an empty leaderboard."""
    row = _row(0.5)

    assert standings_from([row], {}) == {row.submission.id: UNKNOWN}
    assert standings_from([], {}) == {}


def test_differences_are_judged_where_both_have_replicates_of_the_same_draw() -> None:
    """Second minus first, .1 on half of the resamples and .3 on the others; n/a without a side, value or enough boxes."""
    first, second = _replicates(0.2, 0.1), _replicates(0.3, 0.4)
    found = comparison(first, second, 0.2)

    assert found is not None
    assert (found.difference.lower, found.difference.upper) == pytest.approx((0.1, 0.3))
    assert comparison(None, second, 0.2) is None
    assert comparison(first, second, None) is None
    boxes = FEWEST_BOXES_FOR_DIFFERENCE
    assert class_comparison(first, second, 0.2, "car", boxes=boxes) == found
    assert class_comparison(first, second, 0.2, "car", boxes=boxes - 1) is None
    assert class_comparison(first, second, 0.2, "train", boxes=boxes) is None
    assert class_comparison(first, second, 0.2, "truck", boxes=boxes) is None
    assert class_comparison(None, second, 0.2, "car", boxes=boxes) is None
    assert class_comparison(first, second, None, "car", boxes=boxes) is None


def test_the_draw_is_part_of_what_is_kept() -> None:
    """Other resamples cannot be compared with the usual ones, so they must be told apart."""
    assert Draw(seed=1) != STANDARD_DRAW


def test_too_few_images_say_nothing_of_the_ranking(site: Site, archive: bytes, score: Callable[[str], None]) -> None:
    """Two images are far too few: JSON, CSV and page agree that nothing is known, and show the ranking all the same."""
    token = site.token()
    for method, body in (("first", archive), ("worst", zip_with(NOTHING_FOUND))):
        published(site, token, body, method, score)
    with site.client() as visitor:
        rows = visitor.get(BOARD).json()["rows"]
        lines = list(csv.DictReader(io.StringIO(visitor.get(BOARD, params={"format": "csv"}).text)))
        page = visitor.get("/benchmarks/cs3d/test").text
    assert [(row["rank"], row["mds_interval"], row["rank_interval"], row["groups"]) for row in rows] == [
        (1, None, None, []),
        (2, None, None, []),
    ]
    columns = ("mds_lower", "mds_upper", "rank_best", "rank_worst", "groups")
    assert [[line[name] for name in columns] for line in lines] == [[""] * 5] * 2
    assert page.count('<span class="undefined">n/a</span>') >= 4


def test_replicates_are_kept_with_every_score(site: Site, archive: bytes, score: Callable[[str], None]) -> None:
    """The worker's replicates are in the record, once, and cannot be changed."""
    published(site, site.token(), archive, "ours", score)
    with site.services.transaction() as session:
        (stored,) = session.scalars(sa.select(models.ScoreReplicates))
        kept = ScoreReplicates.from_bytes(stored.data)
        assert kept.draw == STANDARD_DRAW
        assert kept.mds.shape == (STANDARD_DRAW.resamples,)
    with pytest.raises(sa.exc.IntegrityError, match="append-only"), site.services.transaction() as session:
        session.execute(sa.delete(models.ScoreReplicates))


def test_a_leaderboard_reads_its_replicates_once(site: Site, archive: bytes, score: Callable[[str], None]) -> None:
    """The second look at the same scores reads no replicates; another score is noticed."""
    token = site.token()
    published(site, token, archive, "ours", score)
    cache, asked = StandingsCache(), []
    sa.event.listen(site.services.engine, "before_cursor_execute", lambda *call: asked.append(call[2]))
    for expected in (1, 1):
        with site.services.transaction() as session:
            cache.of(session, _board(session))
        assert sum("score_replicates.data" in statement for statement in asked) == expected
    published(site, token, archive, "another", score)
    with site.services.transaction() as session:
        assert len(cache.of(session, _board(session))) == 2


def _board(session: Session) -> tuple[LeaderboardRow, ...]:
    return ranking.leaderboard(session, benchmarks.find_phase(session, "cs3d", "test")).rows
