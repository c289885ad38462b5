"""How far a ranking can be trusted, as the API and the pages say it."""

import csv
import io
import re
import uuid
from collections.abc import Callable
from datetime import UTC, datetime

import numpy as np
import pytest

from evaluator.confidence import Interval
from evaluator.score_replicates import MDS, STANDARD_DRAW, Draw, ScoreReplicates
from server.models import Method, Score, Submission, Team
from server.ranking import LeaderboardRow
from server.standings import UNKNOWN, Standing, comparison, standings_from
from tests.integration.api.test_following import zip_with
from tests.integration.api.test_leaderboards import BOARD, NOTHING_FOUND, published
from tests.integration.site import Site

INTERVAL = Interval(estimate=0.5, lower=0.4, upper=0.6)


def _row(mds: float | None) -> LeaderboardRow:
    submission = Submission(id=uuid.uuid4(), created_at=datetime(2026, 1, 1, tzinfo=UTC))
    return LeaderboardRow(
        rank=None, submission=submission, method=Method(), team=Team(), score=Score(), mds=mds, summary={}
    )


def _replicates(*halves: float, interval: Interval | None = INTERVAL) -> ScoreReplicates:
    """Make replicates that hold one value in the first half of the resamples and another in the second."""
    mds = np.repeat(halves, STANDARD_DRAW.resamples // 2)
    return ScoreReplicates(draw=STANDARD_DRAW, mds=mds, detection_scores={"car": mds}, intervals={MDS: interval})


def test_methods_that_trade_places_share_ranks_and_a_letter() -> None:
    """A and B lead on half of the resamples each; C is always third and in no group."""
    rows = [_row(0.5), _row(0.49), _row(0.1)]
    kept = [_replicates(0.5, 0.4), _replicates(0.4, 0.5), _replicates(0.1, 0.1)]

    found = standings_from(rows, {row.submission.id: part for row, part in zip(rows, kept, strict=True)})

    assert [found[row.submission.id] for row in rows] == [
        Standing(interval=INTERVAL, ranks=(1, 2), groups="a"),
        Standing(interval=INTERVAL, ranks=(1, 2), groups="a"),
        Standing(interval=INTERVAL, ranks=(3, 3), groups=""),
    ]


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
    """Second minus first, .1 on half of the resamples and .3 on the others; n/a without one side, value or class."""
    first, second = _replicates(0.2, 0.1), _replicates(0.3, 0.4)
    found = comparison(first, second, 0.2)

    assert found is not None
    assert (found.difference.lower, found.difference.upper) == pytest.approx((0.1, 0.3))
    assert comparison(first, second, 0.2, "car") == found
    assert comparison(first, second, 0.2, "truck") is None
    assert comparison(None, second, 0.2) is None
    assert comparison(first, second, None) is None


def test_the_draw_is_part_of_what_is_kept() -> None:
    """Other resamples cannot be compared with the usual ones, so they must be told apart."""
    assert Draw(seed=1) != STANDARD_DRAW


def test_the_leaderboard_tells_ranks_and_groups(site: Site, archive: bytes, score: Callable[[str], None]) -> None:
    """Two equal methods share rank 1 on every resample; JSON, CSV and page agree. Two images are too few for an interval."""
    token = site.token()
    for method, body in (("first", archive), ("second", archive), ("worst", zip_with(NOTHING_FOUND))):
        published(site, token, body, method, score)
    with site.client() as visitor:
        rows = visitor.get(BOARD).json()["rows"]
        lines = list(csv.DictReader(io.StringIO(visitor.get(BOARD, params={"format": "csv"}).text)))
        page = visitor.get("/benchmarks/cs3d/test").text
    assert [row["mds_interval"] for row in rows] == [None, None, None]
    assert [row["rank_interval"] for row in rows[:2]] == [[1, 1], [1, 1]]
    assert rows[0]["groups"][0] == rows[1]["groups"][0] == "a"
    assert [(line["rank_best"], line["rank_worst"], line["groups"]) for line in lines] == [
        (str(row["rank_interval"][0]), str(row["rank_interval"][1]), row["groups"]) for row in rows
    ]
    assert all(line["mds_lower"] == line["mds_upper"] == "" for line in lines)
    assert len(re.findall(r'<span class="letter">a</span>', page)) >= 2
