"""Errors in metres and degrees, worked out by hand."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from evaluator.diagnosis.annotator_noise import ANNOTATOR_NOISE
from evaluator.diagnosis.errors import (
    ERROR_NAMES,
    PairErrors,
    error_curves,
    pair_errors,
    place_errors,
    summarize_errors,
)
from evaluator.diagnosis.working_point import at_working_point
from evaluator.evaluation import evaluate
from evaluator.protocol import CITYSCAPES3D
from tests.array_factories import Box, annotated, make_ground_truth, make_predictions

RAY = np.array([12.0, 5.0, 0.0])
"""13 m away; the unit ray is (12, 5) / 13, its left normal (-5, 12) / 13."""


def test_an_error_along_the_viewing_ray_is_longitudinal() -> None:
    """A tenth too far away on the same ray is 1.3 m longitudinal and 10 % of depth, nothing lateral."""
    errors = place_errors(RAY[None], RAY[None] * 1.1)
    assert errors == pytest.approx(np.array([[1.3, 0.0, 1.3, 10.0]]))


def test_an_error_across_the_viewing_ray_is_lateral() -> None:
    """Half a metre to the left of the ray is +0.5 m lateral; the distance hardly changes."""
    left = RAY + np.array([-5.0, 12.0, 0.0]) / 13 * 0.5
    # sqrt(13^2 + 0.5^2) / 13 - 1 = 0.0739 %
    assert place_errors(RAY[None], left[None]) == pytest.approx(np.array([[0.5, 0.5, 0.0, 0.07393]]), abs=1e-5)


def test_height_is_no_error_on_the_ground_plane() -> None:
    """A box too high by two metres is in the right place."""
    assert place_errors(RAY[None], RAY[None] + np.array([0.0, 0.0, 2.0])) == pytest.approx(np.zeros((1, 4)))


def pairs(values: np.ndarray, distance_m: tuple[float, ...] = ()) -> PairErrors:
    """Return true positives with the given signed errors."""
    return PairErrors(
        distance_m=np.array(distance_m),
        class_index=np.zeros(len(values), dtype=np.int32),
        signed=values,
        absolute=np.abs(values),
    )


def test_summary_tells_size_and_bias_of_an_error_apart() -> None:
    """+3 and -1 are 2 on average and 1 too much; a distance has no bias."""
    values = np.zeros((2, len(ERROR_NAMES)))
    values[:, 0] = [3.0, 1.0]
    values[:, ERROR_NAMES.index("yaw_deg")] = [3.0, -1.0]
    summary = summarize_errors(pairs(values))
    assert (summary.mean.yaw_deg, summary.median.yaw_deg, summary.bias.yaw_deg) == (2.0, 2.0, 1.0)
    assert (summary.mean.center_m, summary.bias.center_m) == (2.0, None)


@pytest.mark.parametrize(("found", "median"), [((9.0, -1.0, 2.0), 2.0), ((9.0, -1.0, 2.0, -4.0), 3.0)])
def test_one_gross_error_moves_the_mean_and_not_the_median(found: tuple[float, ...], median: float) -> None:
    """1, 2 and 9 are 4 on average and 2 in the middle; of 1, 2, 4 and 9 the middle is 3."""
    values = np.zeros((len(found), len(ERROR_NAMES)))
    values[:, ERROR_NAMES.index("lateral_m")] = found
    summary = summarize_errors(pairs(values))
    assert (summary.mean.lateral_m, summary.median.lateral_m) == (4.0, median)


def test_no_true_positives_leave_every_error_undefined() -> None:
    """Nothing measured is None, not 0."""
    summary = summarize_errors(pairs(np.empty((0, len(ERROR_NAMES)))))
    parts = (summary.mean, summary.median, summary.bias)
    assert {value for part in parts for value in msgspec.structs.astuple(part)} == {None}


def test_errors_of_one_true_positive_by_hand() -> None:
    """Place, angle and size of a matched pair come out as they were put in, relative to the camera."""
    # the camera stands 2 m ahead of the axle: the box at x = 22 is 20 m from it, the prediction 21 m: +5 %
    camera = (2.0, 0.0, 1.2)
    truth = annotated([Box(center=(22.0, 0.0, 0.75), dimensions=(4.0, 2.0, 1.5))], camera=camera)
    found = [Box(center=(23.0, 0.0, 0.75), dimensions=(4.4, 2.0, 1.5), yaw=np.radians(-3.0))]
    evaluation = evaluate(make_ground_truth(truth, camera=camera), make_predictions(found))
    errors = pair_errors(evaluation, at_working_point(evaluation))
    assert errors.distance_m == pytest.approx([22.0])
    # one of three sides 10 % too long: 3.33 %
    expected = [1.0, 0.0, 1.0, 5.0, -3.0, 0.0, 0.0, 10 / 3]
    assert errors.signed[0] == pytest.approx(expected, abs=1e-9)


def test_a_side_too_long_does_not_make_up_for_one_too_short() -> None:
    """A box 10 % too long and 10 % too narrow is wrong in size, and neither too large nor too small."""
    truth = annotated([Box(dimensions=(4.0, 2.0, 1.5))])
    found = [replace(truth[0], dimensions=(4.4, 1.8, 1.5))]
    modal = msgspec.structs.replace(CITYSCAPES3D, modal=True)  # the rectangles match, whatever the boxes are
    evaluation = evaluate(make_ground_truth(truth), make_predictions(found), modal)
    summary = summarize_errors(pair_errors(evaluation, at_working_point(evaluation)))
    # |10| + |-10| + |0| over three sides, and 10 - 10 + 0
    assert summary.mean.size_percent == pytest.approx(20 / 3)
    assert summary.median.size_percent == pytest.approx(20 / 3)
    assert summary.bias.size_percent == pytest.approx(0.0)


@pytest.mark.parametrize(("true_deg", "seen_deg", "error_deg"), [(179.0, -179.0, 2.0), (-179.0, 179.0, -2.0)])
def test_headings_are_compared_the_short_way_round(true_deg: float, seen_deg: float, error_deg: float) -> None:
    """Either side of straight back is 2 degrees apart, not 358."""
    truth = annotated([Box(yaw=np.radians(true_deg))])
    evaluation = evaluate(make_ground_truth(truth), make_predictions([Box(yaw=np.radians(seen_deg))]))
    values = pair_errors(evaluation, at_working_point(evaluation)).signed
    assert values[0, ERROR_NAMES.index("yaw_deg")] == pytest.approx(error_deg)


def test_curves_sort_true_positives_into_bins_and_add_them_up() -> None:
    """A bin holds its lower edge; "up to" ranges grow; what is beyond the maximum depth is in the last range."""
    values = np.zeros((4, len(ERROR_NAMES)))
    values[:, 0] = [1.0, 2.0, 3.0, 4.0]
    curves = error_curves(pairs(values, (4.9, 5.0, 9.0, 40.0)), (0, 5, 10))
    bins = [(part.lower_m, part.upper_m, part.errors.mean.center_m) for part in curves.by_distance]
    assert bins == [(0.0, 5.0, 1.0), (5.0, 10.0, 2.5), (10.0, None, 4.0)]
    up_to = [(part.upper_m, part.errors.true_positive_count) for part in curves.up_to_distance]
    assert up_to == [(5.0, 1), (10.0, 3), (None, 4)]


def test_annotator_noise_is_the_papers() -> None:
    """Eleven ranges, from 10 m to all, with the ends of the paper's curves."""
    assert [noise.up_to_m for noise in ANNOTATOR_NOISE] == [10, 20, 30, 40, 50, 60, 70, 80, 90, 100, None]
    assert (ANNOTATOR_NOISE[0].yaw_deg, ANNOTATOR_NOISE[0].center_m) == (1.78, 0.61)
    assert (ANNOTATOR_NOISE[-1].yaw_deg, ANNOTATOR_NOISE[-1].center_m) == (2.09, 0.75)
