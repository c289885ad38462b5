"""What must hold for any input: bounds, perfect input, order of files, and what makes things worse."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluator.evaluation import evaluate
from evaluator.ground_truth import GroundTruth
from evaluator.predictions import Predictions
from evaluator.protocol import CITYSCAPES3D, PAPER, Protocol
from evaluator.results import ClassScore, Scores
from tests.array_factories import annotated, disturbed_boxes, make_ground_truth, make_predictions, scattered_boxes

SEEDS = st.integers(0, 10_000)
PROTOCOLS = pytest.mark.parametrize("protocol", [CITYSCAPES3D, PAPER], ids=lambda protocol: protocol.name)
IMAGES = 3
CLASS_METRICS = ("ap", "bevcd", "yaw_sim", "pr_sim", "size_sim", "detection_score")
MEANS = ("map", "mbevcd", "myaw_sim", "mpr_sim", "msize_sim", "mds")

some_examples = settings(max_examples=25, deadline=None)


def _case(seed: int) -> tuple[GroundTruth, Predictions]:
    """Draw ground truth whose amodal boxes are projected, with ignore regions, and disturbed predictions."""
    boxes = annotated(scattered_boxes(seed, images=IMAGES, spacing_m=(5.0, 3.0)))
    regions = [(image, (200.0 * image, 300.0, 500.0, 300.0)) for image in range(IMAGES)]
    predictions = annotated(disturbed_boxes(seed + 1, boxes, images=IMAGES))
    return make_ground_truth(boxes, images=IMAGES, ignore=regions), make_predictions(predictions, images=IMAGES)


def _rows(predictions: Predictions, rows: np.ndarray[tuple[int], np.dtype[np.intp]]) -> Predictions:
    """Take some predictions, in this order."""
    names = [name for name in Predictions.__slots__ if name not in {"images", "labels"}]
    return replace(predictions, **{name: getattr(predictions, name)[rows] for name in names})


def _numbers(scores: Scores) -> list[float | None]:
    numbers = [getattr(scores, name) for name in MEANS]
    for item in scores.classes:
        numbers += [getattr(item, name) for name in CLASS_METRICS]
        numbers += [value for depth in item.depth_bins for value in (depth.ap, depth.bevcd, depth.yaw_sim)]
    return numbers


@PROTOCOLS
@some_examples
@given(seed=SEEDS)
def test_every_score_is_within_bounds(seed: int, protocol: Protocol) -> None:
    """Everything lies in [0, 1], and AP bounds the detection score."""
    scores = evaluate(*_case(seed), protocol).scores

    assert all(value is None or 0 <= value <= 1 for value in _numbers(scores))
    for item in scores.classes:
        assert item.ap is None or item.detection_score is None or item.detection_score <= item.ap


@some_examples
@given(seed=SEEDS)
def test_ground_truth_as_prediction_is_perfect_wherever_two_bins_are_filled(seed: int) -> None:
    """AP is 1; each similarity is 1 with two filled bins, else 0, as in the reference."""
    boxes = annotated(scattered_boxes(seed, images=IMAGES))
    scores = evaluate(make_ground_truth(boxes, images=IMAGES), make_predictions(boxes, images=IMAGES)).scores

    for item in scores.classes:
        filled = sum(depth.ground_truth_count > 0 for depth in item.depth_bins)
        if item.ground_truth_count:
            assert item.ap == 1
            expected = 1.0 if filled > 1 else 0.0
            assert [item.bevcd, item.yaw_sim, item.pr_sim, item.size_sim] == pytest.approx([expected] * 4)


@some_examples
@given(seed=SEEDS)
def test_ground_truth_as_prediction_fills_every_bin_it_can_in_the_paper_protocol(seed: int) -> None:
    """AP is 1, and each similarity is the share of the depth bins that hold anything."""
    boxes = annotated(scattered_boxes(seed, images=IMAGES))
    scores = evaluate(make_ground_truth(boxes, images=IMAGES), make_predictions(boxes, images=IMAGES), PAPER).scores

    for item in scores.classes:
        filled = sum(depth.ground_truth_count > 0 for depth in item.depth_bins)
        if item.ground_truth_count:
            assert item.ap == 1
            assert item.yaw_sim == pytest.approx(filled / len(item.depth_bins))


@PROTOCOLS
@some_examples
@given(seed=SEEDS)
def test_the_order_of_boxes_changes_nothing(seed: int, protocol: Protocol) -> None:
    """Without ties, which these boxes do not have, files may list boxes in any order."""
    ground_truth, predictions = _case(seed)
    shuffled = np.random.default_rng(seed).permutation(len(predictions))
    rows = shuffled[np.argsort(predictions.image_index[shuffled], kind="stable")]

    expected = _numbers(evaluate(ground_truth, predictions, protocol).scores)
    found = _numbers(evaluate(ground_truth, _rows(predictions, rows), protocol).scores)

    assert found == pytest.approx(expected, abs=1e-12)


@PROTOCOLS
@settings(max_examples=8, deadline=None)
@given(seed=SEEDS, order=st.permutations(range(8)))
def test_the_order_of_images_changes_nothing(seed: int, order: list[int], protocol: Protocol) -> None:
    """However images are named: counts and what follows from them are equal to the bit.

    Similarities are means over true positives, summed in the order of images: these differ by rounding alone.
    """
    boxes = annotated(scattered_boxes(seed, images=len(order), spacing_m=(5.0, 3.0)))
    predictions = annotated(disturbed_boxes(seed + 1, boxes, images=len(order)))
    regions = [(image, (200.0 * image, 300.0, 500.0, 300.0)) for image in range(len(order))]

    def scores(place: Sequence[int]) -> Scores:
        truth, found = ([replace(box, image=place[box.image]) for box in side] for side in (boxes, predictions))
        ignored = sorted((place[image], region) for image, region in regions)
        ground_truth = make_ground_truth(truth, images=len(place), ignore=ignored)
        return evaluate(ground_truth, make_predictions(found, images=len(place)), protocol).scores

    expected, found = scores(range(len(order))), scores(order)

    assert [_counted(item) for item in found.classes] == [_counted(item) for item in expected.classes]
    assert _numbers(found) == pytest.approx(_numbers(expected), abs=1e-12)


def _counted(score: ClassScore) -> list[object]:
    """Give what follows from counts alone."""
    names = ("ground_truth_count", "working_point", "recall", "precision", "ap")
    bins = ("ground_truth_count", "true_positive_count", "recall", "precision", "ap")
    deep = [getattr(depth, name) for depth in score.depth_bins for name in bins]
    return [*(getattr(score, name) for name in names), *deep]


@PROTOCOLS
@some_examples
@given(seed=SEEDS, factor=st.sampled_from([-1.0, 0.25, 8.0]))
def test_the_length_and_sign_of_quaternions_change_nothing(seed: int, factor: float, protocol: Protocol) -> None:
    """A quaternion and its multiples are one rotation."""
    ground_truth, predictions = _case(seed)
    scaled = replace(predictions, rotation=predictions.rotation * factor)

    expected = _numbers(evaluate(ground_truth, predictions, protocol).scores)

    assert _numbers(evaluate(ground_truth, scaled, protocol).scores) == pytest.approx(expected, abs=1e-9)


@some_examples
@given(seed=SEEDS)
def test_scores_within_one_threshold_step_are_equal(seed: int) -> None:
    """Moving every score to the middle of its step of 0.02 changes nothing: there are only 51 thresholds."""
    ground_truth, predictions = _case(seed)
    steps = np.arange(0.0, 1.01, 0.02)
    middle = steps[np.searchsorted(steps, predictions.score, side="right") - 1] + 0.01

    expected = _numbers(evaluate(ground_truth, predictions).scores)

    assert _numbers(evaluate(ground_truth, replace(predictions, score=middle)).scores) == expected


@some_examples
@given(seed=SEEDS, power=st.sampled_from([0.25, 3.0]))
def test_rescaling_scores_changes_nothing_in_the_paper_protocol(seed: int, power: float) -> None:
    """AP over all scores depends on their order alone; in cityscapes3d it does not (see the test of steps)."""
    ground_truth, predictions = _case(seed)
    rescaled = replace(predictions, score=predictions.score**power)

    expected = [item.ap for item in evaluate(ground_truth, predictions, PAPER).scores.classes]

    assert [item.ap for item in evaluate(ground_truth, rescaled, PAPER).scores.classes] == pytest.approx(expected)


@PROTOCOLS
@some_examples
@given(seed=SEEDS)
def test_removing_a_true_positive_never_raises_ap(seed: int, protocol: Protocol) -> None:
    """With one prediction for each box, at most. With duplicates it may: the next best takes the box at more scores."""
    boxes = annotated(scattered_boxes(seed, images=IMAGES))
    rng = np.random.default_rng(seed)
    scored = [replace(box, score=float(rng.uniform(0.05, 1))) for box in boxes]
    ground_truth, predictions = make_ground_truth(boxes, images=IMAGES), make_predictions(scored, images=IMAGES)
    fewer = _rows(predictions, np.delete(np.arange(len(predictions)), int(rng.integers(len(predictions)))))

    before = evaluate(ground_truth, predictions, protocol).scores
    after = evaluate(ground_truth, fewer, protocol).scores

    for old, new in zip(before.classes, after.classes, strict=True):
        assert old.ap is None or new.ap is None or new.ap <= old.ap + 1e-12


@PROTOCOLS
@some_examples
@given(seed=SEEDS, score=st.floats(0, 1))
def test_adding_a_false_positive_never_raises_ap(seed: int, score: float, protocol: Protocol) -> None:
    """A car in the sky, far from everything and every ignore region."""
    ground_truth, predictions = _case(seed)
    sky = make_predictions(annotated([replace(scattered_boxes(seed, images=1)[0], label="car", center=(50, 0, 10.0))]))
    names = [name for name in Predictions.__slots__ if name not in {"images", "labels"}]
    sky = replace(sky, score=np.array([score]))
    joined: dict[str, Any] = {name: np.concatenate([getattr(sky, name), getattr(predictions, name)]) for name in names}
    more = replace(predictions, **joined)

    before = evaluate(ground_truth, predictions, protocol).scores.classes[0].ap
    after = evaluate(ground_truth, more, protocol).scores.classes[0].ap

    assert before is None or after is None or after <= before + 1e-12


@some_examples
@given(seed=SEEDS)
def test_predictions_of_nothing_score_zero_and_of_no_ground_truth_are_undefined(seed: int) -> None:
    """An empty submission has AP 0 where there is something to find; without ground truth everything is None."""
    ground_truth, predictions = _case(seed)
    nothing = _rows(predictions, np.zeros(0, dtype=np.intp))

    assert evaluate(ground_truth, nothing).scores.mds == 0
    empty = evaluate(make_ground_truth([], images=IMAGES), predictions).scores
    assert set(_numbers(empty)) == {None}


@some_examples
@given(seed=SEEDS, min_iou=st.sampled_from([0.3, 0.5, 0.9]))
def test_recall_never_rises_with_the_threshold(seed: int, min_iou: float) -> None:
    """Fewer active predictions never find more, at any depth: what makes one pass over all thresholds exact."""
    protocol = msgspec.structs.replace(CITYSCAPES3D, min_iou=min_iou)

    for item in evaluate(*_case(seed), protocol).scores.classes:
        for recall in (item.recall, *(depth.recall for depth in item.depth_bins)):
            assert all(later <= earlier for earlier, later in pairwise(recall))
