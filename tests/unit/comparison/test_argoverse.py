"""Argoverse-2-style composite detection score."""

import math

import pytest

from evaluator.comparison.argoverse import ArgoverseScores, evaluate_argoverse
from evaluator.comparison.boxes import class_boxes
from tests.array_factories import AWAY, Box, Triple, make_ground_truth, make_predictions


def score(truth: list[Box], found: list[Box], *, ignore: bool = False) -> ArgoverseScores:
    """Score one image, with the whole of `AWAY` as an ignore region if wanted."""
    regions = [(0, AWAY)] if ignore else []
    return evaluate_argoverse(class_boxes(make_predictions(found), make_ground_truth(truth, ignore=regions)))


def test_one_box_by_hand() -> None:
    """Distance in space, size and heading of a single pair give AP, the errors and CDS."""
    # (0.42, 0, 0.56) m is 0.7 m in space; sides (2, 2, 3) against (4, 2, 1.5): 2 x 2 x 1.5 of 4 x 2 x 3
    found = Box(center=(20.42, 0.0, 1.31), dimensions=(2.0, 2.0, 3.0), yaw=0.3)
    car = score([Box()], [found]).classes[0]
    assert car.ap_by_distance == (0.0, 1.0, 1.0, 1.0)
    assert (car.ate_m, car.ase, car.aoe_rad) == pytest.approx((0.7, 0.75, 0.3))
    assert car.cds == pytest.approx(0.75 * ((1 - 0.35) + 0.25 + (1 - 0.3 / math.pi)) / 3)


def test_only_the_highest_score_near_a_box_can_match_it() -> None:
    """A confident prediction 3 m off blocks a perfect one behind it, as in av2."""
    # at 4 m: hit first, then a false positive; av2 reads the last of 101 recalls behind both, so it is 1/2 there
    found = [Box(center=(23.0, 0.0, 0.75), score=0.9), Box(score=0.8)]
    assert score([Box()], found).classes[0].ap_by_distance == pytest.approx((0.0, 0.0, 0.0, 100.5 / 101))


def test_a_far_prediction_in_an_ignore_region_blocks_nothing() -> None:
    """It is excused before the assignment, so the perfect one behind it matches."""
    found = [Box(center=(30.0, 0.0, 0.75), score=0.9), Box(score=0.8)]
    assert score([Box()], found, ignore=True).map == 1.0
    assert score([Box()], found).map == 0.0


@pytest.mark.parametrize(("offset_m", "expected"), [(3.9, (0.0, 0.0, 0.0, 1.0)), (4.0, (1.0,) * 4)])
def test_a_prediction_within_four_metres_of_a_box_is_not_excused(offset_m: float, expected: tuple[float, ...]) -> None:
    """Nearer than the greatest distance it takes the box, ignore region or not; unmatched it is no false positive."""
    found = [Box(center=(20.0 + offset_m, 0.0, 0.75), score=0.9), Box(score=0.8)]
    assert score([Box()], found, ignore=True).classes[0].ap_by_distance == expected


@pytest.mark.parametrize(
    ("center", "counted"),
    [
        ((90.0, 119.9, 0.0), True),  # sqrt(90^2 + 119.9^2) = 149.92
        ((90.0, 120.0, 0.0), False),  # 150, which is not nearer
        ((90.0, 119.9, 20.0), False),  # 151.25 in space
    ],
)
def test_boxes_nearer_than_150_m_count(center: Triple, counted: bool) -> None:  # noqa: FBT001 - a parameter
    """A far box neither has to be found nor costs anything when predicted; the distance is that in space."""
    far = Box(center=center, score=0.9)
    annotated, predicted = score([far], [far]).classes[0], score([Box()], [far, Box(score=0.8)])
    assert (annotated.ground_truth_count, annotated.ap) == ((1, 1.0) if counted else (0, None))
    # in range it goes for the only box, as in av2, and the hit behind it finds that taken
    assert predicted.map == (0.0 if counted else 1.0)


def test_a_hundred_predictions_of_an_image_count() -> None:
    """The hundred-and-first prediction is left out, even if it is the only good one."""
    clutter = [Box(center=(60.0, 0.0, 0.75), score=0.9)] * 99
    truth = [Box(), Box(center=(60.0, 20.0, 0.75))]
    kept = score(truth, [*clutter, Box(score=0.5)])
    dropped = score(truth, [*clutter, clutter[0], Box(score=0.5)])
    assert kept.classes[0].ate_m == 0.0
    assert dropped.classes[0].ate_m is None


def test_two_boxes_on_one_centre_cannot_both_be_matched() -> None:
    """Both predictions go to the same box, so ground truth against itself finds one half, as in av2."""
    # a hit, then a false positive at recall 1/2; the 51st of 101 recalls, 0.5, is read behind both, at precision 1/2
    truth = [Box(), Box(dimensions=(6.0, 2.0, 1.5))]
    assert score(truth, truth).map == pytest.approx((50 + 0.5) / 101)


def test_of_more_than_a_hundred_boxes_of_an_image_a_hundred_can_be_matched() -> None:
    """Ground truth against itself loses the hundred-and-first box, as in av2."""
    truth = [Box(center=(20.0 + 2 * (i % 50), 3.0 * (i // 50), 0.75)) for i in range(101)]
    # precision 1 up to recall 100/101, which is 100 of the 101 recalls 0, 0.01 ... 1
    assert score(truth, truth).map == pytest.approx(100 / 101)
    assert score(truth[:100], truth[:100]).map == 1.0


def test_without_a_match_errors_are_undefined_and_the_score_is_zero() -> None:
    """Nothing to measure on is None; the composite is still 0, because AP is."""
    car = score([Box()], []).classes[0]
    assert (car.ap, car.ate_m, car.ase, car.aoe_rad, car.cds) == (0.0, None, None, None, 0.0)


def test_without_ground_truth_everything_is_undefined() -> None:
    """A class that is not there has no score."""
    scores = score([], [Box()])
    assert (scores.map, scores.mcds, scores.classes[0].cds) == (None, None, None)
