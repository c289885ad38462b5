"""What a confidence interval is made of, derived by hand."""

import numpy as np

from evaluator.confidence import bias


def test_replicates_that_differ_by_rounding_alone_count_as_equal() -> None:
    """Around .3, .1 lies below, .5 above and .1 + .2, summed up to .30000000000000004, half and half: no bias."""
    drawn = np.array([[0.1], [0.1 + 0.2], [0.5]])

    assert bias(np.array([0.3]), drawn).tolist() == [0.0]
