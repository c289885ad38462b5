"""Average precision, working point, similarities and their average over depth bins, derived by hand."""

import numpy as np
import pytest

from evaluator.average_precision import average_precision, precision_and_recall, working_point_index
from evaluator.depth import depth_bin_index, depth_m
from evaluator.paper_scoring import all_score_curve
from evaluator.protocol import CITYSCAPES3D
from evaluator.true_positive_metrics import (
    center_similarity,
    integral_over_range,
    mean_over_bins,
    pitch_roll_similarity,
    size_similarity,
    yaw_similarity,
)


def test_precision_and_recall_are_zero_without_true_positives() -> None:
    """Three thresholds, 4 boxes to find: 2 of 4 detections right, then 1 of 1, then none."""
    precision, recall = precision_and_recall(np.array([2, 1, 0]), np.array([2, 0, 3]), np.array(4))

    assert precision.tolist() == [0.5, 1.0, 0.0]
    assert recall.tolist() == [0.5, 0.25, 0.0]


def test_average_precision_is_the_area_below_the_envelope() -> None:
    """Recall .25 at precision 1, .5 at .5, .75 at .6: .25 x 1 + .25 x .6 + .25 x .6 = .55; nothing beyond .75."""
    precision, recall = np.array([0.6, 0.5, 1.0]), np.array([0.75, 0.5, 0.25])

    assert average_precision(precision, recall) == pytest.approx(0.55)


def test_the_working_point_is_the_lowest_of_equally_good_thresholds() -> None:
    """Precision x recall is .125, .25, .25, exact in binary: the second threshold."""
    precision, recall = np.array([0.25, 0.5, 1.0]), np.array([0.5, 0.5, 0.25])

    assert working_point_index(precision, recall, np.array([0.0, 0.5, 1.0]), None) == 1


@pytest.mark.parametrize(("fixed", "index"), [(-0.5, 0), (0.0, 0), (0.3, 1), (0.5, 1), (0.51, 2), (1.0, 2), (1.3, 2)])
def test_a_fixed_working_point_goes_up_to_the_next_threshold(fixed: float, index: int) -> None:
    """Limited to [0, 1], then raised to the grid."""
    zeros = np.zeros(3)

    assert working_point_index(zeros, zeros, np.array([0.0, 0.5, 1.0]), fixed) == index


def test_depth_is_on_the_ground_and_rounded_down() -> None:
    """(3, 4) is 5 m away at any height, (0, 9.99) 9 m; bins begin at their lower edge and end before 100 m.

    What is too far away for an integer of 64 bits (2^63 is 9.2e18) lies beyond the last bin like all that is far.
    """
    center = np.array([[3.0, 4, 50], [0, 9.99, 0], [100, 0, 0], [99.99, 0, 0]])

    assert depth_m(center).tolist() == [5, 9, 100, 99]
    assert depth_bin_index(center, CITYSCAPES3D).tolist() == [1, 1, 20, 19]
    assert depth_bin_index(np.array([[1e30, 0, 0], [np.inf, 0, 0]]), CITYSCAPES3D).tolist() == [20, 20]


def test_center_similarity_falls_linearly_to_the_maximum_depth() -> None:
    """3 m and 4 m beside: 5 of 100 m away; height does not count; 300 m away is entirely wrong."""
    truth = np.zeros((2, 3))

    assert center_similarity(truth, np.array([[3.0, 4, 9], [300, 0, 0]]), 100.0).tolist() == pytest.approx([0.95, 0])


def test_yaw_similarity_is_half_at_a_right_angle() -> None:
    """Equal 1, a right angle .5, opposite 0, a whole turn 1."""
    angles = np.array([0.0, np.pi / 2, np.pi, 2 * np.pi])

    assert yaw_similarity(np.zeros(4), angles).tolist() == pytest.approx([1, 0.5, 0, 1])


def test_pitch_and_roll_count_half_each() -> None:
    """Pitch opposite and roll equal: (2 - 1 + 1) / 4."""
    assert pitch_roll_similarity(np.zeros((2, 1)), np.array([[np.pi], [0.0]])).tolist() == pytest.approx([0.5])


def test_size_similarity_multiplies_the_ratios() -> None:
    """4 against 5, 2 against 2, 1 against 2: .8 x 1 x .5."""
    assert size_similarity(np.array([[4.0, 2, 1]]), np.array([[5.0, 2, 2]])).tolist() == pytest.approx([0.4])


def test_every_filled_bin_weighs_the_same() -> None:
    """Bins of 3 and 1 true positives with means .9 and .5: (.9 + .5) / 2; the empty one does not count."""
    sums, counts = np.array([[[2.7], [0.0], [0.5]]]), np.array([[3, 0, 1]])

    assert mean_over_bins(sums, counts).tolist() == [[pytest.approx(0.7)]]


def test_a_single_filled_bin_gives_zero_as_in_the_reference() -> None:
    """Fewer than two bins: 0, however good."""
    assert mean_over_bins(np.array([[[3.0], [0.0]]]), np.array([[3, 0]])).tolist() == [[0.0]]


def test_the_integral_counts_empty_bins() -> None:
    """Means .9 and .5 over a range of four bins: 1.4 / 4."""
    sums, counts = np.array([[[2.7], [0.0], [0.5], [0.0]]]), np.array([[3, 0, 1, 0]])

    assert integral_over_range(sums, counts).tolist() == [[pytest.approx(0.35)]]


def test_the_all_score_curve_has_a_point_for_each_distinct_score() -> None:
    """True .9 and .5, false .7 and .5, 4 to find: at .9 1 of 1, at .7 1 of 2, at .5 2 of 4."""
    scores, precision, recall = all_score_curve(np.array([0.9, 0.5]), np.array([0.7, 0.5]), 4)

    assert scores.tolist() == [0.5, 0.7, 0.9]
    assert precision.tolist() == [0.5, 0.5, 1.0]
    assert recall.tolist() == [0.5, 0.25, 0.25]
