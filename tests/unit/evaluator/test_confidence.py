"""What a confidence interval is made of, derived by hand and by the formulas of Efron and Tibshirani (1993)."""

import numpy as np
import pytest

from evaluator.confidence import accelerations, bca_bounds, bias, percentile_bounds
from evaluator.predictions import Float64Array
from tests.unit.evaluator.textbook_bootstrap import bca_shares, bias_correction

SPATIAL_TEST = (
    *(48, 36, 20, 29, 42, 42, 20, 42, 22, 41, 45, 14, 6),
    *(0, 33, 28, 34, 4, 32, 24, 47, 41, 24, 26, 30, 41),
)
"""The test scores A of 26 children (table 14.1)."""


def _ladder() -> Float64Array:
    """Return (1000, 1) replicates 0, 1/999 ... 1 in disorder: below each value lies the share that it says."""
    return np.random.default_rng(1).permutation(np.arange(1000) / 999)[:, None]


def _estimate_above(count: int) -> Float64Array:
    """Return an estimate with so many of the ladder's replicates below it."""
    return np.array([(count - 0.5) / 999])


def test_replicates_that_differ_by_rounding_alone_count_as_equal() -> None:
    """Around .3, .1 lies below, .5 above and .1 + .2, summed up to .30000000000000004, half and half: no bias."""
    drawn = np.array([[0.1], [0.1 + 0.2], [0.5]])

    assert bias(np.array([0.3]), drawn).tolist() == [0.0]


def test_percentile_bounds_leave_half_of_the_rest_on_each_side() -> None:
    """95 % lie between .025 and .975, 90 % between .05 and .95."""
    assert percentile_bounds(_ladder(), 0.95)[:, 0] == pytest.approx([0.025, 0.975], abs=1e-12)
    assert percentile_bounds(_ladder(), 0.9)[:, 0] == pytest.approx([0.05, 0.95], abs=1e-12)


def test_more_replicates_below_the_estimate_than_above_are_a_positive_bias_correction() -> None:
    """558 of 1000 below: the normal distribution has .558 below .146 (section 14.3); 442 is the mirror image."""
    assert bias(_estimate_above(558), _ladder()) == pytest.approx([0.146], abs=5e-4)
    assert bias(_estimate_above(442), _ladder()) == pytest.approx([-0.146], abs=5e-4)


def test_the_acceleration_of_the_books_variance_is_the_books() -> None:
    """The variance of the spatial test scores, 171.5, grows steeper than its standard error is even: a = .061."""
    scores = np.array(SPATIAL_TEST, dtype=np.float64)
    left_out = np.array([[np.delete(scores, child).var()] for child in range(len(scores))])

    assert scores.var() == pytest.approx(171.5, abs=0.05)
    assert accelerations(left_out) == pytest.approx([0.061], abs=5e-4)


def test_the_acceleration_of_a_mean_is_a_sixth_of_its_skewness() -> None:
    """0, 0, 0, 4 deviate by -1, -1, -1, 3: 24 / (6 x 12^1.5) = .0962; the mirror image has the other sign."""
    left_out = np.array([[4 / 3, -4 / 3], [4 / 3, -4 / 3], [4 / 3, -4 / 3], [0.0, 0.0]])

    assert accelerations(left_out) == pytest.approx([0.09623, -0.09623], abs=1e-5)


def test_the_lower_bca_bound_of_the_books_example_is_the_books() -> None:
    """With z0 = .146 and a = .061 the 90 % interval begins at .110 of the replicates (section 14.3)."""
    lower = bca_bounds(_estimate_above(558), _ladder(), np.array([0.061]), 0.9)[0]

    assert lower == pytest.approx([0.110], abs=5e-4)


@pytest.mark.parametrize("below", [300, 442, 500, 558, 700])
@pytest.mark.parametrize("acceleration", [-0.1, 0.0, 0.061])
@pytest.mark.parametrize("level", [0.9, 0.95])
def test_bca_bounds_reach_over_those_of_the_book_and_of_a_wider_bias(
    below: int, acceleration: float, level: float
) -> None:
    """Whatever the signs of bias and acceleration, the bounds are those of the book's formulas."""
    estimate, drawn = _estimate_above(below), _ladder()

    bounds = bca_bounds(estimate, drawn, np.array([acceleration]), level)

    z0 = bias_correction(float(estimate[0]), drawn[:, 0].tolist())
    assert bounds[:, 0] == pytest.approx(bca_shares(z0, acceleration, level), abs=1e-12)
