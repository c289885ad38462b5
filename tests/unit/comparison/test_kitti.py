"""KITTI-style AP at 40 recall positions."""

from dataclasses import replace

import numpy as np
import pytest

from evaluator.comparison.boxes import class_boxes
from evaluator.comparison.kitti import KittiAp, KittiScores, average_precision, evaluate_kitti
from tests.array_factories import AWAY, Box, make_ground_truth, make_predictions


def score(truth: list[Box], found: list[Box], *, ignore: bool = False) -> KittiScores:
    """Score one image, with the whole of `AWAY` as an ignore region if wanted."""
    regions = [(0, AWAY)] if ignore else []
    return evaluate_kitti(class_boxes(make_predictions(found), make_ground_truth(truth, ignore=regions)))


def car(scores: KittiScores) -> tuple[KittiAp, ...]:
    """Return what was found out about cars."""
    return scores.classes[0].overlaps


def test_ap_interpolates_at_forty_recalls() -> None:
    """Precision at a recall is the best at any greater recall."""
    # recall 1/2 at precision 1, recall 1 at 2/3: 20 positions at 1, 20 at 2/3
    found, wrong, scores = np.array([1, 1, 2]), np.array([0, 1, 1]), np.array([0.9, 0.8, 0.7])
    assert average_precision(found, wrong, scores, 2, 40) == pytest.approx((20 + 20 * 2 / 3) / 40)


def test_equal_scores_enter_the_curve_together() -> None:
    """The order among equal scores has no effect."""
    # one point only: recall 1, precision 1/2
    scores = np.array([0.9, 0.9])
    for found, wrong in (([1, 1], [0, 1]), ([0, 1], [1, 1])):
        assert average_precision(np.array(found), np.array(wrong), scores, 1, 40) == 0.5


def test_recall_positions_not_reached_count_as_zero() -> None:
    """Half of the boxes found perfectly is an AP of one half."""
    assert average_precision(np.array([1]), np.array([0]), np.array([0.9]), 2, 40) == 0.5


def test_a_displaced_box_matches_at_the_looser_overlap_only() -> None:
    """One metre ahead of four leaves an IoU of 0.6."""
    strict, loose = car(score([Box()], [Box(center=(21.0, 0.0, 0.75))]))
    assert (strict.ap_bev, strict.ap_3d) == (0.0, 0.0)
    assert (loose.ap_bev, loose.ap_3d) == (1.0, 1.0)


def test_height_counts_in_3d_only() -> None:
    """A box half a metre too high matches from above but not in space."""
    # BEV 0.6 as above; volume 3 x 2 x 1 = 6 of 12 + 12 - 6
    _, loose = car(score([Box()], [Box(center=(21.0, 0.0, 1.25))]))
    assert (loose.ap_bev, loose.ap_3d) == (1.0, 0.0)


def test_an_overlap_of_exactly_the_minimum_is_no_match() -> None:
    """The comparison is strict, as in the development kit."""
    # 4 x 2 within 8 x 2: IoU exactly 0.5
    _, loose = car(score([Box()], [Box(dimensions=(8.0, 2.0, 1.5))]))
    assert loose.ap_bev == 0.0


def test_a_box_takes_what_overlaps_it_most_not_what_scores_highest() -> None:
    """Two boxes on almost one place: each prediction has a box, because the boxes choose."""
    # BEV IoU of boxes 4 m long, d apart: (4 - d) / (4 + d). The confident prediction at 0.8 overlaps the box at 0 by
    # 0.67 and the box at 1 by 0.90, the other at 1.6 overlaps them by 0.43 and 0.74. In score order the first would take
    # the box at 1 and leave nothing for the second.
    truth = [Box(center=(20.0, 0.0, 0.75)), Box(center=(21.0, 0.0, 0.75))]
    found = [Box(center=(20.8, 0.0, 0.75), score=0.9), Box(center=(21.6, 0.0, 0.75), score=0.8)]
    assert car(score(truth, found))[1].ap_bev == 1.0


def test_a_better_prediction_takes_the_place_of_one_in_an_ignore_region() -> None:
    """The box chooses the exact prediction; the rough one before it is excused, because the box left it."""
    truth = [Box(), Box(center=(40.0, 0.0, 0.75))]
    rough = Box(center=(20.5, 0.0, 0.75), score=0.9)
    elsewhere = (1000.0, 500.0, 50.0, 50.0)
    exact = [replace(box, modal=elsewhere, score=confidence) for box, confidence in zip(truth, (0.8, 0.7), strict=True)]
    assert car(score(truth, [rough, *exact], ignore=True))[1].ap_3d == 1.0
    # outside an ignore region the rough one is false: precision 2/3 at recall 1
    assert car(score(truth, [rough, *exact]))[1].ap_3d == pytest.approx((20 + 20 * 2 / 3) / 40)


def test_an_unmatched_prediction_in_an_ignore_region_does_not_count() -> None:
    """The same false positive halves precision outside an ignore region and costs nothing inside."""
    truth, found = [Box()], [Box(score=0.5), Box(center=(60.0, 0.0, 0.75), score=0.9)]
    assert car(score(truth, found))[0].ap_3d == 0.5
    assert car(score(truth, found, ignore=True))[0].ap_3d == 1.0


def test_a_matched_prediction_in_an_ignore_region_counts() -> None:
    """An ignore region takes nothing from a true positive."""
    assert car(score([Box()], [Box()], ignore=True))[0].ap_3d == 1.0


def test_classes_without_ground_truth_are_undefined_and_left_out_of_the_mean() -> None:
    """The mean is over the classes that can be measured."""
    scores = score([Box()], [Box(), Box(label="bus")])
    assert scores.classes[2].overlaps[0] == KittiAp(min_iou=0.7, ap_bev=None, ap_3d=None)
    assert scores.means[0].ap_3d == 1.0


def test_boxes_of_other_images_do_not_match() -> None:
    """A prediction matches in its own image only."""
    truth, found = make_ground_truth([Box()], images=2), make_predictions([Box(image=1)], images=2)
    assert car(evaluate_kitti(class_boxes(found, truth)))[1].ap_bev == 0.0
