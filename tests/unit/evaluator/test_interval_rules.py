"""Which metrics get a confidence interval."""

from dataclasses import replace

import numpy as np
import pytest

from evaluator.evaluation import evaluate, signature_of
from evaluator.interval_rules import (
    FEWEST_BOXES,
    FEWEST_BOXES_IN_BIN,
    FEWEST_FOR_INTERVALS,
    FEWEST_TRUE_POSITIVES,
    FEWEST_TRUE_POSITIVES_IN_BIN,
    FEWEST_TRUE_POSITIVES_IN_BIN_FOR_YAW,
    FEWEST_TRUE_POSITIVES_PER_BIN,
    FEWEST_TRUE_POSITIVES_PER_BIN_FOR_YAW,
    sufficient,
)
from evaluator.protocol import PAPER
from evaluator.replicates import BIN_METRICS, METRICS, Replicates, replicate
from evaluator.statistics import Statistics
from tests.array_factories import Box, annotated, make_ground_truth, make_predictions

CAR, TRUCK = 0, 1


def _found(cars_by_bin: list[int], trucks: int = 0) -> tuple[Statistics, Replicates]:
    """Make outcomes in which all boxes are found: cars in the first depth bins, trucks in the bin of 0-5 m."""
    ground_truth, predictions = make_ground_truth(annotated([Box()])), make_predictions([Box()])
    statistics = evaluate(ground_truth, predictions).statistics
    estimate = replicate(statistics, np.ones((1, 1), dtype=np.float32), by_depth=True)
    bins = statistics.grid[1]
    cells = np.repeat([*range(len(cars_by_bin)), bins * TRUCK], [*cars_by_bin, trucks]).astype(np.int32)
    counts = np.bincount(cells, minlength=int(np.prod(statistics.grid))).reshape(1, *statistics.grid)
    return (
        replace(statistics, ground_truth_cell=cells),
        replace(estimate, true_positives=counts[..., :-1].astype(np.float64)),
    )


def _given(cars_by_bin: list[int], *, trucks: int = 0, units: int = FEWEST_FOR_INTERVALS) -> tuple[set[str], set[str]]:
    """Name the metrics of the means and of cars that get an interval."""
    means, classes, _ = sufficient(*_found(cars_by_bin, trucks), units)
    return {METRICS[i] for i in np.flatnonzero(means)}, {METRICS[i] for i in np.flatnonzero(classes[CAR])}


def test_enough_boxes_give_average_precision_and_detection_score() -> None:
    """Ten boxes do, nine do not; ten in five bins are too few for similarities."""
    assert _given([2, 2, 2, 2, FEWEST_BOXES - 8])[1] == {"ap", "detection_score"}
    assert _given([2, 2, 2, 2, FEWEST_BOXES - 9])[1] == set()


def test_a_class_hardly_found_has_no_interval() -> None:
    """Ten of the boxes must be found, however many there are."""
    statistics, estimate = _found([1000])
    found = np.zeros_like(estimate.true_positives)

    for true_positives, given in (
        (FEWEST_TRUE_POSITIVES, {"ap", "detection_score"}),
        (FEWEST_TRUE_POSITIVES - 1, set()),
    ):
        found[0, CAR, 0] = true_positives
        _, classes, _ = sufficient(statistics, replace(estimate, true_positives=found), FEWEST_FOR_INTERVALS)
        assert {METRICS[i] for i in np.flatnonzero(classes[CAR])} == given


def test_thin_bins_decide_on_similarities() -> None:
    """Harmonic mean of 1000 and 30: 2 / (1/1000 + 1/30) = 58.3, below 60; of 1000 and 31: 60.1."""
    similarities = {"bevcd", "pr_sim", "size_sim"}
    assert FEWEST_TRUE_POSITIVES_PER_BIN == 60

    assert not _given([1000, 30])[1] & similarities
    assert _given([1000, 31])[1] >= similarities


def test_yaw_needs_more() -> None:
    """A hundred true positives in each bin are enough; 99 in one of sixteen are not, though no bin is thin."""
    bins = [FEWEST_TRUE_POSITIVES_PER_BIN_FOR_YAW] * 16

    assert "yaw_sim" in _given(bins)[1]
    assert "yaw_sim" not in _given([bins[0] - 1, *bins[1:]])[1]


def test_a_mean_needs_enough_of_every_class_with_ground_truth() -> None:
    """Cars alone are enough; nine trucks beside them take the interval of the means, ten give it back."""
    cars = [100, 100]

    assert _given(cars)[0] >= {"ap", "detection_score", "bevcd"}
    assert _given(cars, trucks=FEWEST_BOXES - 1)[0] == set()
    assert _given(cars, trucks=FEWEST_BOXES)[0] == {"ap", "detection_score"}


def test_few_images_or_clusters_give_nothing() -> None:
    """499 are too few, however many boxes they hold."""
    assert _given([1000] * 20, units=FEWEST_FOR_INTERVALS - 1) == (set(), set())
    assert _given([1000] * 20)[1] == set(METRICS)


def test_integrals_over_the_whole_range_give_nothing_but_average_precision() -> None:
    """Under the protocol `paper` a resample that empties any depth bin loses it: only AP scatters about the score."""
    statistics, estimate = _found([1000] * 20)
    means, classes, bins = sufficient(
        replace(statistics, signature=signature_of(PAPER)), estimate, FEWEST_FOR_INTERVALS
    )

    assert {METRICS[i] for i in np.flatnonzero(means)} == {METRICS[i] for i in np.flatnonzero(classes[CAR])} == {"ap"}
    assert bins[CAR].all()


@pytest.mark.parametrize(
    ("boxes", "metrics"),
    [
        (FEWEST_BOXES_IN_BIN - 1, set()),
        (FEWEST_BOXES_IN_BIN, {"ap"}),
        (FEWEST_TRUE_POSITIVES_IN_BIN - 1, {"ap"}),
        (FEWEST_TRUE_POSITIVES_IN_BIN, {"ap", "bevcd", "pr_sim", "size_sim"}),
        (FEWEST_TRUE_POSITIVES_IN_BIN_FOR_YAW, set(BIN_METRICS)),
    ],
)
def test_a_depth_bin_needs_its_own_boxes(boxes: int, metrics: set[str]) -> None:
    """What the other bins hold does not help."""
    _, _, bins = sufficient(*_found([1000, boxes]), FEWEST_FOR_INTERVALS)

    assert {BIN_METRICS[i] for i in np.flatnonzero(bins[CAR, 1])} == metrics
