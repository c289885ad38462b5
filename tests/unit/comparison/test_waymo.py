"""Waymo-style AP by range and the longitudinal error tolerant metrics."""

from dataclasses import replace

import numpy as np
import pytest

from evaluator.comparison.boxes import class_boxes
from evaluator.comparison.waymo import WaymoClass, evaluate_waymo, integrate_curve
from evaluator.comparison.weighted_pairs import Tolerance, align_along_sight, longitudinal_affinity
from tests.array_factories import AWAY, Box, make_ground_truth, make_predictions


def car(truth: list[Box], found: list[Box], *, ignore: bool = False) -> WaymoClass:
    """Score the cars of one image seen from the origin of the vehicle frame."""
    regions = [(0, AWAY)] if ignore else []
    scores = evaluate_waymo(class_boxes(make_predictions(found), make_ground_truth(truth, ignore=regions)))
    return scores.classes[0]


def at(x: float, **other: float) -> Box:
    """Return a car x metres ahead at the height of the sensor."""
    return Box(center=(x, 0.0, 0.0), **other)  # type: ignore[arg-type]  # only numbers are given


def test_a_depth_error_is_tolerated_and_weighed() -> None:
    """Half of the tolerance used up: found for LET-3D-AP, worth one half for LET-3D-APL, lost for AP."""
    # 2 m of 4 m tolerated at 40 m; moved back it overlaps fully; unmoved the IoU is 2 / 6
    overall = car([at(40.0)], [at(42.0)]).overall
    assert (overall.ap, overall.let_ap, overall.let_apl) == pytest.approx((0.0, 1.0, 0.5))


def test_the_tolerance_ends_at_a_tenth_of_the_distance() -> None:
    """At 4 m of 40 m nothing is left."""
    overall = car([at(40.0)], [at(44.0)]).overall
    assert (overall.let_ap, overall.let_apl) == (0.0, 0.0)


def test_near_the_camera_half_a_metre_is_tolerated() -> None:
    """Below 5 m the tolerance does not shrink further."""
    # 0.25 of 0.5 m at 3 m
    affinity = longitudinal_affinity(np.array([[3.25, 0, 0]]), np.array([[3.0, 0, 0]]), Tolerance())
    assert affinity == pytest.approx([0.5])


def test_alignment_moves_along_the_line_of_sight() -> None:
    """The aligned centre is the foot of the perpendicular from the true centre."""
    # (10, 10) projected from (10, 0): (5, 5)
    assert align_along_sight(np.array([[10.0, 10, 0]]), np.array([[10.0, 0, 0]])) == pytest.approx(
        np.array([[5.0, 5, 0]])
    )


def test_predictions_belong_to_the_range_of_their_own_distance() -> None:
    """A good box just across the edge is found overall, missed by one range and undefined in the other."""
    result = car([at(29.9)], [at(30.1)])
    assert result.overall.ap == pytest.approx(1.0)
    assert [part.ap for part in result.ranges] == [0.0, None, None]
    assert [part.ground_truth_count for part in result.ranges] == [1, 0, 0]


def test_a_lower_score_takes_over_when_its_overlap_is_greater() -> None:
    """The assignment is the heaviest at each cutoff, not in score order."""
    # up to 0.5 the exact box is matched, above it the displaced one: at both the precision weighs affinity
    # displaced by 0.2 m of 2 m tolerance: affinity 0.9. Cutoffs > 0.5: one match of 0.9 of one; below: 1.0 of two
    overall = car([at(20.0)], [at(20.2, score=0.9), at(20.0, score=0.5)]).overall
    assert overall.let_ap == pytest.approx(1.0)
    assert overall.let_apl == pytest.approx(0.9)


def test_an_unmatched_prediction_in_an_ignore_region_does_not_count() -> None:
    """The same false positive halves precision outside an ignore region and costs nothing inside."""
    truth, found = [at(20.0)], [at(20.0, score=0.5), at(60.0, score=0.9)]
    assert car(truth, found).overall.ap == pytest.approx(0.5)
    assert car(truth, found, ignore=True).overall.ap == pytest.approx(1.0)


def test_gaps_of_recall_are_filled_from_behind() -> None:
    """Only the last 0.05 of a gap is a slope."""
    # 0 to 0.5 at precision 1: 0.5. From 0.5 to 1: 0.45 x 0.5 + 0.05 x 0.75
    assert integrate_curve(np.array([1.0]), np.array([0.5]), 0.05) == pytest.approx(0.5)
    assert integrate_curve(np.array([0.5, 1.0]), np.array([1.0, 0.5]), 0.05) == pytest.approx(0.7625)


def test_a_curve_that_never_leaves_recall_zero_is_worth_nothing() -> None:
    """Recall 0 at every cutoff has no area."""
    assert integrate_curve(np.array([1.0, 1.0]), np.array([0.0, 0.0]), 0.05) == 0.0


@pytest.mark.parametrize(
    ("label", "light"),
    [("car", False), ("truck", False), ("bus", False), ("train", False), ("motorcycle", True), ("bicycle", True)],
)
def test_two_wheelers_have_looser_overlaps(label: str, light: bool) -> None:  # noqa: FBT001 - a parameter of the test
    """Waymo's thresholds are 0.5 for cyclists and 0.7 for vehicles, with a tolerated depth error 0.3 and 0.5."""
    truth = Box(label=label, center=(20.0, 0.0, 0.0))
    # 4 m long: 1 m further away they share 3 of 5 m, IoU 0.6; 1.6 m long at the same place, 0.4
    further, shorter = (
        next(score.overall for score in evaluate_waymo(class_boxes(*sides)).classes if score.label == label)
        for found in (replace(truth, center=(21.0, 0.0, 0.0)), replace(truth, dimensions=(1.6, 2.0, 1.5)))
        for sides in [(make_predictions([found]), make_ground_truth([truth]))]
    )
    assert (further.ap, shorter.let_ap) == pytest.approx((1.0, 1.0) if light else (0.0, 0.0))
    assert (further.let_ap, shorter.ap) == pytest.approx((1.0, 0.0))
