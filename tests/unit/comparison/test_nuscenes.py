"""nuScenes-style AP over centre distances, the three errors and NDS3."""

import pytest

from evaluator.comparison.boxes import class_boxes
from evaluator.comparison.nuscenes import NuscenesScores, evaluate_nuscenes
from tests.array_factories import Box, make_ground_truth, make_predictions


def score(truth: list[Box], found: list[Box]) -> NuscenesScores:
    """Score one image."""
    return evaluate_nuscenes(class_boxes(make_predictions(found), make_ground_truth(truth)))


def test_one_box_by_hand() -> None:
    """Distance, size and heading of a single pair give AP, the errors and NDS3."""
    # 0.7 m apart: found at 1, 2 and 4 m, not at 0.5 m; half as long: size IoU 0.5; turned by 0.3 rad
    scores = score([Box()], [Box(center=(20.7, 0.0, 9.0), dimensions=(2.0, 2.0, 1.5), yaw=0.3, score=0.6)])
    car = scores.classes[0]
    assert car.ap_by_distance == pytest.approx((0.0, 1.0, 1.0, 1.0))
    assert (car.ate_m, car.ase, car.aoe_rad) == pytest.approx((0.7, 0.5, 0.3))
    # (5 x 0.75 + 0.3 + 0.5 + 0.7) / 8
    assert scores.nds3 == pytest.approx(0.65625)


def test_heading_errors_take_the_short_way_round() -> None:
    """3.0 and -3.0 rad are 0.283 rad apart, and half a turn is the worst."""
    # 2 pi - 6 = 0.2832
    assert score([Box(yaw=3.0)], [Box(yaw=-3.0)]).classes[0].aoe_rad == pytest.approx(0.28318531)
    assert score([Box()], [Box(yaw=3.14159265)]).classes[0].aoe_rad == pytest.approx(3.14159265)


def test_errors_need_a_recall_above_a_tenth() -> None:
    """One of eleven boxes is too few to measure errors on; the mean counts them as 1."""
    truth = [Box(center=(10.0, 8.0 * i, 0.75)) for i in range(-5, 6)]
    scores = score(truth, [Box(center=(10.0, 0.0, 0.75))])
    assert scores.classes[0].ate_m is None
    assert scores.mate_m == 1.0
    # AP too is cut below a recall of 0.1
    assert scores.map == 0.0
    assert scores.nds3 == 0.0


def test_low_precision_is_cut() -> None:
    """Precision counts from 0.1 upwards, scaled back."""
    # one hit behind one miss: at every sampled recall above 0.1 precision is 1/2 or, below it, rises from 0 to 1/2
    # along the line from (0, 0) to (1, 1/2): p(r) = r / 2, counted (r / 2 - 0.1) / 0.9 from r = 0.2
    scores = score([Box()], [Box(score=0.9, center=(60.0, 0.0, 0.75)), Box(score=0.5)])
    expected = sum(max(r / 200 - 0.1, 0) / 0.9 for r in range(11, 101)) / 90
    assert scores.classes[0].ap == pytest.approx(expected)


def test_far_boxes_are_left_out() -> None:
    """A box beyond 100 m neither has to be found nor costs anything when predicted."""
    far = Box(center=(99.0, 20.0, 0.75))  # 101.0 m
    scores = score([Box(), far], [Box(), Box(center=(101.0, 0.0, 0.75), score=0.99)])
    assert scores.classes[0].ground_truth_count == 1
    assert scores.map == pytest.approx(1.0)


def test_nothing_predicted_is_zero_and_nothing_annotated_is_undefined() -> None:
    """A miss counts; a class that is not there does not."""
    missed, empty = score([Box()], []), score([], [Box()])
    assert (missed.map, missed.nds3) == (0.0, 0.0)
    assert (empty.map, empty.mate_m, empty.nds3) == (None, None, None)
    assert empty.classes[0].ap_by_distance == (None,) * 4
