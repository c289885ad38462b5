"""Between which ranks a submission stands, counted resample by resample."""

import numpy as np
import pytest

from evaluator.standings import Standings


@pytest.mark.parametrize(("level", "expected"), [(0.95, (2, 4)), (0.99, (1, 5)), (0.5, (3, 3))])
def test_a_rank_interval_leaves_out_the_tails_and_nothing_else(level: float, expected: tuple[int, int]) -> None:
    """Ranks 1 and 5 on 2 % of the resamples each, 2 and 4 on 10 %, 3 on 76 %: 95 % leave out 2.5 % on each side."""
    ahead = np.repeat([0, 1, 2, 3, 4], [20, 100, 760, 100, 20])
    others = [np.where(ahead > number, 0.9, 0.1) for number in range(4)]

    standings = Standings.of([np.full(1000, 0.5), *others], level)

    assert standings.rank_intervals()[0] == expected


def test_rank_intervals_are_the_tightest_that_leave_out_five_percent() -> None:
    """Counting who is better on each resample: at most 2.5 % on either side, one rank less leaves out no less."""
    rng = np.random.default_rng(7)
    mds = rng.normal(np.linspace(0.4, 0.6, 8)[:, None], 0.06, (8, 1000))
    ranks = [[1 + sum(other > own for other in row) for own in row] for row in mds.T.tolist()]

    intervals = Standings.of(mds).rank_intervals()

    for submission, (best, worst) in enumerate(intervals):
        own = [row[submission] for row in ranks]
        assert sum(rank < best for rank in own) <= 25 <= sum(rank <= best for rank in own)
        assert sum(rank > worst for rank in own) <= 25 <= sum(rank >= worst for rank in own)
    # The scene is one in which this says something: some intervals span several ranks, and some not all that were seen.
    assert any(worst - best > 1 for best, worst in intervals)
    assert any(
        (min(column), max(column)) != found for column, found in zip(zip(*ranks, strict=True), intervals, strict=True)
    )
