"""The exact split of lost points, and what the score would be with one thing perfect."""

import math

import msgspec
import pytest

from evaluator.diagnosis.loss import factors, loss, split_change
from evaluator.diagnosis.oracles import oracles
from evaluator.evaluation import Evaluation, evaluate
from tests.array_factories import (
    Box,
    annotated,
    disturbed_boxes,
    make_ground_truth,
    make_predictions,
    scattered_boxes,
)

NEAR, FAR = annotated([Box(center=(22.0, 0.0, 0.75)), Box(center=(42.0, 5.0, 0.75))])
"""Two depth bins: with one the protocol's similarities are 0."""


def turned(box: Box) -> Box:
    """Return the box looking back: the same rectangle in the image, yaw similarity 0."""
    return Box(center=box.center, yaw=math.pi, score=0.9)


def evaluation_of(found: list[Box]) -> Evaluation:
    """Evaluate predictions for the two cars."""
    return evaluate(make_ground_truth([NEAR, FAR]), make_predictions(found))


def gains(evaluation: Evaluation) -> dict[str, float | None]:
    """Return each oracle's gain of the mean detection score."""
    return {oracle.name: oracle.gain for oracle in oracles(evaluation)}


def test_split_by_hand() -> None:
    """Parts are the means over both orders of change."""
    # AP 0.5 -> 1, similarities (1, 1, 1, 0.2) -> (1, 1, 1, 1): DS 0.4 -> 1
    # AP first: 0.5 x 0.8 = 0.4, then size 0.2; size first: 0.5 x 0.2 = 0.1, then AP 0.5: means 0.45 and 0.15
    parts = split_change((0.5, 1, 1, 1, 0.2), (1.0, 1, 1, 1, 1))
    assert msgspec.structs.astuple(parts) == pytest.approx((0.45, 0.0, 0.0, 0.0, 0.15))


def test_loss_and_score_make_one() -> None:
    """What is reached and the five parts of what is missing sum up to 1 exactly."""
    truth = annotated(scattered_boxes(3, images=8))
    evaluation = evaluate(
        make_ground_truth(truth, images=8), make_predictions(disturbed_boxes(4, truth, images=8, spread=0.4), images=8)
    )
    for score in evaluation.scores.classes:
        parts = loss(score)
        if score.detection_score is None:
            assert parts is None
            assert factors(score) is None
        else:
            assert parts is not None
            assert parts.total() + score.detection_score == pytest.approx(1.0, abs=1e-12)


def test_perfect_yaw_wins_what_yaw_costs() -> None:
    """Cars that look back lose a quarter; perfect yaw gives it back, other oracles nothing."""
    wins = gains(evaluation_of([turned(NEAR), turned(FAR)]))
    assert wins["perfect_yaw"] == pytest.approx(0.25)
    assert wins["perfect_boxes"] == pytest.approx(0.25)
    others = wins.keys() - {"perfect_yaw", "perfect_boxes"}
    assert {wins[name] for name in others} == {0.0}


def test_oracles_obey_the_protocol() -> None:
    """A car in a single depth bin has similarities of 0, with perfect boxes too."""
    evaluation = evaluate(make_ground_truth([NEAR]), make_predictions([NEAR]))
    assert evaluation.scores.mds == 0.0
    assert gains(evaluation)["perfect_boxes"] == 0.0


def test_perfect_detection_leaves_the_similarities() -> None:
    """Without false positives and misses the score is the mean of the similarities."""
    third = annotated([Box(center=(60.0, -6.0, 0.75))])[0]
    found = [turned(NEAR), turned(FAR), Box(center=(30.0, 9.0, 0.75), score=0.99)]
    evaluation = evaluate(make_ground_truth([NEAR, FAR, third]), make_predictions(found))
    result = {oracle.name: oracle.mds for oracle in oracles(evaluation)}
    # yaw similarity 0, the others 1
    assert result["perfect_detection"] == pytest.approx(0.75)
    # three predictions with two hits, two of three boxes: AP 2/3 at precision 2/3
    assert result["no_false_positives"] == pytest.approx(2 / 3 * 0.75)
    assert result["no_misses"] == pytest.approx(2 / 3 * 0.75)


@pytest.mark.parametrize("name", ["no_misses", "perfect_detection"])
def test_what_a_class_that_finds_nothing_would_score_is_undefined(name: str) -> None:
    """Without the missed boxes the class has no ground truth: it has no score, no gain and no part in the mean."""
    bus = annotated([Box(label="bus", center=(30.0, -6.0, 1.5), dimensions=(10.0, 2.5, 3.0))])[0]
    evaluation = evaluate(make_ground_truth([NEAR, FAR, bus]), make_predictions([NEAR, FAR]))
    oracle = next(oracle for oracle in oracles(evaluation) if oracle.name == name)
    by_label = {part.label: (part.detection_score, part.gain) for part in oracle.classes}
    assert by_label["bus"] == (None, None)
    assert by_label["car"] == pytest.approx((1.0, 0.0))
    # cars 1 and buses 0, then cars alone
    # The other class is perfect as it is: a mean of 1 instead of .5, and nothing gained.
    assert (oracle.mds, oracle.gain) == pytest.approx((1.0, 0.0))


def test_no_misses_of_nothing_found_is_undefined() -> None:
    """When no class finds anything no ground truth is left, and no score."""
    no_misses = next(oracle for oracle in oracles(evaluation_of([])) if oracle.name == "no_misses")
    assert (no_misses.mds, no_misses.gain) == (None, None)


def test_without_ground_truth_there_is_no_gain() -> None:
    """Undefined stays undefined."""
    evaluation = evaluate(make_ground_truth([]), make_predictions([NEAR]))
    assert set(gains(evaluation).values()) == {None}
