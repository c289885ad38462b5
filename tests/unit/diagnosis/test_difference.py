"""The exact split of the difference of two submissions."""

import msgspec
import pytest

from evaluator.diagnosis.difference import explain_difference
from evaluator.errors import UsageError
from evaluator.evaluation import evaluate
from evaluator.protocol import CITYSCAPES3D
from evaluator.results import Scores
from tests.array_factories import (
    Box,
    annotated,
    disturbed_boxes,
    make_ground_truth,
    make_predictions,
    scattered_boxes,
)

LABELS = ("car", "truck", "bus", "motorcycle", "bicycle")
TRUTH = annotated(scattered_boxes(5, images=12, per_image=10, labels=LABELS))


def scores_of(seed: int, spread: float) -> Scores:
    """Score a method of some quality; there is no ground truth of trains."""
    found = disturbed_boxes(seed, TRUTH, images=12, spread=spread)
    return evaluate(make_ground_truth(TRUTH, images=12), make_predictions(found, images=12)).scores


@pytest.mark.parametrize("seed", range(5))
def test_parts_sum_up_to_the_difference(seed: int) -> None:
    """All parts of all classes are the difference of the two mDS, to the last digits."""
    first, second = scores_of(seed, 0.6), scores_of(seed + 100, 0.3)
    difference = explain_difference(first, second)
    assert first.mds is not None
    assert second.mds is not None
    assert difference.parts is not None
    assert difference.total == second.mds - first.mds
    assert difference.parts.total() == pytest.approx(difference.total, abs=1e-12)
    assert sum(part.total or 0 for part in difference.classes) == pytest.approx(difference.total, abs=1e-12)


def test_a_difference_the_other_way_round_is_the_negative() -> None:
    """Every part changes its sign when the submissions change places."""
    first, second = scores_of(1, 0.6), scores_of(2, 0.3)
    there, back = explain_difference(first, second), explain_difference(second, first)
    assert there.parts is not None
    assert back.parts is not None
    for one, other in zip(msgspec.structs.astuple(there.parts), msgspec.structs.astuple(back.parts), strict=True):
        assert one == pytest.approx(-other, abs=1e-15)


def test_only_what_changed_has_a_part() -> None:
    """Two methods that differ in the heading of cars differ in the part of yaw of cars."""
    cars = annotated([Box(center=(22.0, 0.0, 0.75)), Box(center=(42.0, 5.0, 0.75))])
    turned = [Box(center=box.center, yaw=3.141592653589793) for box in cars]
    truth = make_ground_truth(cars)
    difference = explain_difference(
        evaluate(truth, make_predictions(turned)).scores, evaluate(truth, make_predictions(cars)).scores
    )
    # one class; yaw similarity 0 -> 1 at AP 1: a quarter
    parts = difference.classes[0].parts
    assert parts is not None
    assert parts.yaw_sim == pytest.approx(0.25)
    assert (parts.ap, parts.bevcd, parts.pr_sim, parts.size_sim) == pytest.approx((0, 0, 0, 0), abs=1e-12)


def test_a_difference_names_what_it_was_made_from() -> None:
    """Both signatures stand with the numbers: protocol, evaluator and the digests of either side."""
    truth, found = make_ground_truth(TRUTH, images=12), make_predictions(TRUTH, images=12)
    sides = [
        evaluate(truth, found, ground_truth_sha256="ab12", predictions_sha256=digest).scores for digest in ("cd", "ef")
    ]
    difference = explain_difference(*sides)
    assert difference.signatures == (sides[0].signature, sides[1].signature)
    assert [signature.predictions_sha256 for signature in difference.signatures] == ["cd", "ef"]


def test_a_class_without_ground_truth_has_no_part() -> None:
    """Trains are in neither mean."""
    difference = explain_difference(scores_of(1, 0.6), scores_of(2, 0.3))
    train = next(part for part in difference.classes if part.label == "train")
    assert (train.detection_score, train.parts, train.total) == (None, None, None)


def test_nothing_against_nothing_is_undefined() -> None:
    """Without ground truth there is no difference."""
    empty = evaluate(make_ground_truth([]), make_predictions([])).scores
    difference = explain_difference(empty, empty)
    assert (difference.total, difference.parts, difference.mds) == (None, None, (None, None))


def test_other_protocols_and_other_ground_truth_are_refused() -> None:
    """Scores that depend on more than the predictions cannot be split."""
    scores = scores_of(1, 0.6)
    found = make_predictions(disturbed_boxes(1, TRUTH, images=12), images=12)
    modal = msgspec.structs.replace(CITYSCAPES3D, modal=True)
    with pytest.raises(UsageError, match="protocol"):
        explain_difference(scores, evaluate(make_ground_truth(TRUTH, images=12), found, modal).scores)
    with pytest.raises(UsageError, match="ground truth"):
        explain_difference(scores, evaluate(make_ground_truth(TRUTH[1:], images=12), found).scores)
