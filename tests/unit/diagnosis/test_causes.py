"""False positives and misses by cause, and what each cause costs, on one scene that has them all."""

from dataclasses import replace

import msgspec
import pytest

from evaluator.diagnosis.causes import BACKGROUND_IOU, Causes, causes
from evaluator.diagnosis.nearest import nearest
from evaluator.diagnosis.working_point import at_working_point
from evaluator.evaluation import Evaluation, evaluate
from evaluator.protocol import CITYSCAPES3D
from tests.array_factories import Box, Rectangle, annotated, make_ground_truth, make_predictions

EVERYTHING_COUNTS = msgspec.structs.replace(CITYSCAPES3D, working_point=0.0)
"""The working point is fixed at 0, so that every prediction is active."""

CAR, POINTED_AT, MISSED = (Box(center=center) for center in ((20.0, 0.0, 0.75), (30.0, 6.0, 0.75), (40.0, -14.0, 0.75)))
TRUCK = Box(label="truck", center=(40.0, -6.0, 1.5), dimensions=(7.0, 2.5, 3.0))
BUS = Box(label="bus", center=(40.0, 15.2, 1.5), dimensions=(10.0, 2.5, 3.0))
TRUTH = annotated([CAR, POINTED_AT, MISSED, TRUCK, BUS])

INSIDE: Rectangle = (0.0, 0.0, 100.0, 99.0)
HALF_INSIDE: Rectangle = (0.0, 50.0, 100.0, 99.0)
REGION: Rectangle = (0.0, 0.0, 100.0, 99.0)
NOWHERE = Box(center=(60.0, -15.0, 0.75), modal=(1800.0, 900.0, 10.0, 10.0))

FOUND = [
    replace(TRUTH[0], score=0.95),
    replace(TRUTH[0], center=(20.4, 0.0, 0.75), score=0.85),  # duplicate
    replace(TRUTH[3], label="car", score=0.75),  # classification: it fits the truck
    replace(TRUTH[1], center=(30.0, 7.0, 0.75), score=0.65),  # localisation: half beside the car
    replace(TRUTH[4], label="car", center=(40.0, 13.2, 1.5), score=0.55),  # both: half beside the bus
    replace(NOWHERE, score=0.45),  # background
    replace(NOWHERE, modal=HALF_INSIDE, score=0.35),  # half of it in an ignore region
    replace(NOWHERE, modal=INSIDE, score=0.25),  # discarded
]


def evaluation_of(found: list[Box]) -> Evaluation:
    """Evaluate predictions for the scene."""
    truth = make_ground_truth(TRUTH, ignore=[(0, REGION)])
    return evaluate(truth, make_predictions(found), EVERYTHING_COUNTS)


@pytest.fixture(scope="module")
def explained() -> dict[str, Causes]:
    """Return the causes of each class of the scene."""
    evaluation = evaluation_of(FOUND)
    point = at_working_point(evaluation)
    return dict(zip(point.labels, causes(evaluation, point, nearest(evaluation)), strict=True))


def test_overlaps_are_what_the_scene_means_them_to_be() -> None:
    """The displaced predictions overlap enough to be something and too little to match."""
    near = nearest(evaluation_of(FOUND))
    assert BACKGROUND_IOU < near.own_iou[3] < 0.7
    assert BACKGROUND_IOU < near.other_iou[4] < 0.7
    assert near.own_iou[4] < BACKGROUND_IOU
    assert near.own_iou[5] == near.other_iou[5] == 0.0
    # rows 50 to 149 of which 50 to 99 are in the region: 50 of 100
    assert near.ignore_coverage[6] == pytest.approx(0.5)


def test_every_false_positive_has_one_cause(explained: dict[str, Causes]) -> None:
    """One of each kind, as the scene was built; what is discarded is no false positive."""
    counts = {cause.name: cause.count for cause in explained["car"].causes}
    assert counts == {
        "duplicate": 1,
        "classification": 1,
        "localisation": 1,
        "both": 1,
        "ignore_region": 1,
        "background": 1,
        "missed": 1,
    }
    assert explained["car"].false_positive_count == 6
    assert explained["car"].discarded_count == 1
    assert explained["car"].true_positive_count == 1


def test_a_missed_box_that_a_false_positive_points_at_is_counted_there(explained: dict[str, Causes]) -> None:
    """Two cars and the truck are not found; a car and the truck are pointed at."""
    assert explained["car"].missed_count == 2
    assert explained["truck"].missed_count == 1
    assert {cause.name: cause.count for cause in explained["truck"].causes}["missed"] == 0
    assert {cause.name: cause.count for cause in explained["bus"].causes}["missed"] == 1


def test_gains_are_those_of_the_repaired_curves(explained: dict[str, Causes]) -> None:
    """The AP each repair wins, by hand."""
    # cars: 3 boxes, the first found at 0.95 before any false positive: AP = 1/3. Taking later false positives away
    # changes nothing. Localisation repaired: a second hit at 0.65 behind two false positives, precision 2/4:
    # 1/3 + 1/3 x 1/2. The missed car taken away: 1/2.
    gains = {cause.name: cause.ap_gain for cause in explained["car"].causes}
    assert gains == pytest.approx(
        {
            "duplicate": 0.0,
            "classification": 0.0,
            "localisation": 1 / 6,
            "both": 0.0,
            "ignore_region": 0.0,
            "background": 0.0,
            "missed": 1 / 6,
        }
    )
    # the truck: nothing predicted, then the misnamed prediction alone: AP 0 to 1
    assert {cause.name: cause.ap_gain for cause in explained["truck"].causes}["classification"] == pytest.approx(1.0)


def test_missing_every_box_has_no_price(explained: dict[str, Causes]) -> None:
    """Without the only bus, which is missed, there is no AP of buses to compare with: undefined, not free of charge."""
    missed = explained["bus"].causes[-1]
    assert (missed.name, missed.count) == ("missed", 1)
    assert (missed.ap_gain, missed.detection_score_gain) == (None, None)


def test_what_similarities_boxes_not_found_would_have_is_unknown(explained: dict[str, Causes]) -> None:
    """The repaired truck wins AP; its detection score depends on a box that nobody has measured."""
    classification = explained["truck"].causes[1]
    assert classification.name == "classification"
    assert classification.ap_gain == pytest.approx(1.0)
    assert classification.detection_score_gain is None


def test_false_positives_before_a_hit_cost() -> None:
    """Taking a confident background prediction away lifts the precision behind it."""
    # one car of three found at 0.5 behind one false positive: AP 1/2 x 1/3, then 1/3
    evaluation = evaluation_of([replace(TRUTH[0], score=0.5), replace(NOWHERE, score=0.9)])
    car = causes(evaluation, at_working_point(evaluation), nearest(evaluation))[0]
    assert {cause.name: cause.ap_gain for cause in car.causes}["background"] == pytest.approx(1 / 6)


def test_several_predictions_that_point_at_one_box_win_it_once() -> None:
    """Two localisation errors at one box are one true positive when repaired, and no false positive."""
    beside = [replace(TRUTH[1], center=(30.0, 7.0, 0.75), score=score) for score in (0.9, 0.8)]
    evaluation = evaluation_of(beside)
    car = causes(evaluation, at_working_point(evaluation), nearest(evaluation))[0]
    by_name = {cause.name: cause for cause in car.causes}
    assert by_name["localisation"].count == 2
    assert by_name["localisation"].ap_gain == pytest.approx(1 / 3)


@pytest.mark.parametrize(("hit", "error", "gain"), [(0.5, 0.9, 1 / 6), (0.9, 0.5, 0.0)])
def test_a_box_already_found_is_not_won_again(hit: float, error: float, gain: float) -> None:
    """A prediction half beside a car that another one finds is taken away, and wins it only where that one is silent."""
    # one car of three: behind the false positive AP is 1/3 x 1/2, else 1/3, which is all that can be had
    found = [replace(TRUTH[1], score=hit), replace(TRUTH[1], center=(30.0, 7.0, 0.75), score=error)]
    evaluation = evaluation_of(found)
    car = causes(evaluation, at_working_point(evaluation), nearest(evaluation))[0]
    localisation = next(cause for cause in car.causes if cause.name == "localisation")
    assert localisation.count == 1
    assert localisation.ap_gain == pytest.approx(gain)


@pytest.mark.parametrize(
    ("prediction", "cause"),
    [
        # shifted by s of 100 columns the IoU is (100 - s) / (100 + s): 19 / 181 = .105, 18 / 182 = .099
        (Box(modal=(81.0, 0.0, 99.0, 99.0)), "localisation"),
        (Box(modal=(82.0, 0.0, 99.0, 99.0)), "background"),
        (Box(modal=(81.0, 0.0, 99.0, 99.0), label="truck"), "both"),
        (Box(modal=(82.0, 0.0, 99.0, 99.0), label="truck"), "background"),
        # the region holds columns 1000 to 1010: 11 of 100, then 10, which is not more than a tenth
        (Box(modal=(1000.0, 0.0, 99.0, 99.0)), "ignore_region"),
        (Box(modal=(1001.0, 0.0, 99.0, 99.0)), "background"),
    ],
    ids=lambda value: value if isinstance(value, str) else f"{value.label} at {value.modal[0]:.0f}",
)
def test_what_overlaps_by_less_than_a_tenth_is_background(prediction: Box, cause: str) -> None:
    """TIDE's background threshold of 0.1, for boxes of the same and of another class and for ignore regions."""
    truth = make_ground_truth([Box(modal=(0.0, 0.0, 99.0, 99.0))], ignore=[(0, (1000.0, 0.0, 10.0, 99.0))])
    modal = msgspec.structs.replace(EVERYTHING_COUNTS, modal=True)
    evaluation = evaluate(truth, make_predictions([prediction]), modal)
    found = causes(evaluation, at_working_point(evaluation), nearest(evaluation))
    false_positives = [item.name for part in found for item in part.causes if item.count and item.name != "missed"]
    assert false_positives == [cause]
