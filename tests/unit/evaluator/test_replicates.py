"""Scores of weighted images, in every protocol and depth bin, are those an evaluation of these images gives."""

import tracemalloc
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from evaluator.errors import UsageError
from evaluator.evaluation import Evaluation, evaluate
from evaluator.ground_truth import read_ground_truth
from evaluator.paper_replicates import ScoreCurves
from evaluator.parts import ground_truth_of
from evaluator.predictions import Float64Array
from evaluator.protocol import CITYSCAPES3D, PAPER, Protocol
from evaluator.replicates import BIN_METRICS, METRICS, Replicates, Replicator, every_bin, replicate
from evaluator.resampling import Unit, Weighting, bootstrap_weights, leave_one_out, unit_index
from evaluator.results import Scores
from evaluator.scoring import score
from evaluator.uncertainty import intervals
from tests.array_factories import (
    Box,
    annotated,
    disturbed_boxes,
    make_ground_truth,
    make_predictions,
    scattered_boxes,
)
from tests.prediction_arrays import load_predictions

CASE = Path(__file__).parents[2] / "data" / "oracle" / "realistic60"


@pytest.fixture(scope="module", params=[CITYSCAPES3D, PAPER], ids=lambda protocol: str(protocol.name))
def evaluation(request: pytest.FixtureRequest) -> Evaluation:
    """Sixty images of the recorded realistic case under each protocol."""
    ground_truth = read_ground_truth(CASE / "gt")
    return evaluate(
        ground_truth, load_predictions(CASE / "pred", ground_truth.images, CITYSCAPES3D.labels), request.param
    )


def _forty(evaluation: Evaluation) -> Scores:
    """Evaluate the first forty images only."""
    truth = ground_truth_of(evaluation.ground_truth, slice(0, 40))
    predictions = load_predictions(CASE / "pred", truth.images, CITYSCAPES3D.labels)
    return evaluate(truth, predictions, evaluation.statistics.protocol).scores


def _equal(found: Replicates, scores: Scores) -> None:
    """Compare the only row of replicates with scores: classes, working points, depth bins."""
    _equal_metrics(found, scores)
    defined = np.array([item.working_point is not None for item in scores.classes])
    points = [item.working_point for item in scores.classes if item.working_point is not None]
    assert found.working_point[0][defined].tolist() == points


def _equal_metrics(found: Replicates, scores: Scores) -> None:
    """Compare the only row of replicates with scores: classes, depth bins."""
    classes = [[getattr(item, name) for name in METRICS] for item in scores.classes]
    bins = [[[getattr(part, name) for name in BIN_METRICS] for part in item.depth_bins] for item in scores.classes]

    assert np.allclose(found.classes[0], _numbers(classes), rtol=0, atol=1e-12, equal_nan=True)
    assert np.allclose(found.depth_bins[0], _numbers(bins), rtol=0, atol=1e-12, equal_nan=True)


def _row(found: Replicates, row: int) -> Replicates:
    """Return one row of replicates as their only one."""
    return Replicates(**{field.name: getattr(found, field.name)[[row]] for field in fields(found)})


def _numbers(values: list[list[float | None]] | list[list[list[float | None]]]) -> Float64Array:
    return np.array(values, dtype=np.float64)


def test_weights_of_one_give_the_scores(evaluation: Evaluation) -> None:
    """Every metric of every class and depth bin is that of the evaluation."""
    ones = np.ones((1, len(evaluation.statistics.images)), dtype=np.float32)

    _equal(replicate(evaluation.statistics, ones, by_depth=True), evaluation.scores)


@pytest.mark.parametrize("protocol", [CITYSCAPES3D, PAPER], ids=lambda protocol: str(protocol.name))
def test_without_images_nothing_is_defined_and_there_are_no_intervals(protocol: Protocol) -> None:
    """Evaluating no images at all is no error: every metric is undefined, on any resample too."""
    nothing = evaluate(make_ground_truth([], images=0), make_predictions([], images=0), protocol)

    found = intervals(nothing.statistics)

    assert nothing.scores.mds is None
    assert set(found.means.values()) == {None}
    assert {interval for part in found.classes.values() for interval in part.values()} == {None}


def test_weights_of_zero_leave_images_out(evaluation: Evaluation) -> None:
    """Weighting the last twenty images with 0 equals evaluating the first forty, c_w chosen anew."""
    weights = np.array([[1.0] * 40 + [0.0] * 20], dtype=np.float32)

    _equal(replicate(evaluation.statistics, weights, by_depth=True), _forty(evaluation))


def test_a_weight_of_two_counts_an_image_twice(evaluation: Evaluation) -> None:
    """Scores do not change when every image counts twice."""
    twos = np.full((1, len(evaluation.statistics.images)), 2, dtype=np.float32)

    _equal(replicate(evaluation.statistics, twos, by_depth=True), evaluation.scores)


@pytest.mark.parametrize("unit", ["image", "sequence", "city"])
def test_the_jackknife_equals_weights_of_zero_for_one_unit(evaluation: Evaluation, unit: Unit) -> None:
    """Subtracting a unit gives what weighting it with 0 gives, in every metric."""
    statistics = evaluation.statistics
    member = unit_index(statistics.images, unit)
    weights = (np.arange(member.max() + 1)[:, None] != member).astype(np.float32)

    expected, found = (
        replicate(statistics, weighting, by_depth=True)
        for weighting in (weights, leave_one_out(statistics.images, unit=unit))
    )

    assert np.allclose(found.classes, expected.classes, rtol=0, atol=1e-12, equal_nan=True)
    assert np.allclose(found.depth_bins, expected.depth_bins, rtol=0, atol=1e-12, equal_nan=True)
    assert np.array_equal(found.working_point, expected.working_point)


def test_each_of_many_resamples_is_what_it_is_alone(evaluation: Evaluation) -> None:
    """The first and the last of 2500 resamples, more than are computed at once, have the scores they have by themselves."""
    statistics = evaluation.statistics
    weights = bootstrap_weights(statistics.images, resamples=2500, seed=1)
    ends = [0, -1]

    many, alone = (replicate(statistics, rows, by_depth=True) for rows in (weights, weights[ends]))

    assert np.allclose(many.classes[ends], alone.classes, rtol=0, atol=1e-12, equal_nan=True)
    assert np.allclose(many.depth_bins[ends], alone.depth_bins, rtol=0, atol=1e-12, equal_nan=True)


def _photographed(boxes: list[Box], times: list[int]) -> list[Box]:
    """Return the boxes of images each of which is there so many times, under a number of its own each time."""
    images = np.repeat(np.arange(len(times)), times).tolist()
    return [replace(box, image=copy) for copy, image in enumerate(images) for box in boxes if box.image == image]


@pytest.mark.parametrize("protocol", [CITYSCAPES3D, PAPER], ids=lambda protocol: str(protocol.name))
def test_each_resample_is_what_evaluating_its_images_gives(protocol: Protocol) -> None:
    """Each row of one call, its working points its own, is the evaluation of images that are there as often as drawn.

    Under `paper` c_w may be the score of an image that was not drawn, with the same boxes above it.
    """
    same = _equal_metrics if protocol is PAPER else _equal
    images = 6
    truth = annotated(scattered_boxes(5, images=images))
    found = disturbed_boxes(6, truth, images=images, spread=0.4)
    drawn = np.random.default_rng(3).multinomial(images, [1 / images] * images, size=12)
    sides = make_ground_truth(truth, images=images), make_predictions(found, images=images)
    statistics = evaluate(*sides, protocol).statistics
    weightings: list[tuple[Weighting, list[list[int]]]] = [
        (drawn.astype(np.float32), drawn.tolist()),
        (leave_one_out(statistics.images), (1 - np.eye(images, dtype=np.int64)).tolist()),
    ]

    for weighting, rows in weightings:
        replicates = replicate(statistics, weighting, by_depth=True)

        assert len(np.unique(replicates.working_point, axis=0)) > 2
        for row, times in enumerate(rows):
            again = (
                make_ground_truth(_photographed(truth, times), images=sum(times)),
                make_predictions(_photographed(found, times), images=sum(times)),
            )
            same(_row(replicates, row), evaluate(*again, protocol).scores)


def test_depth_bins_are_left_out_unless_asked_for(evaluation: Evaluation) -> None:
    """No bins; the classes are the same."""
    weights = bootstrap_weights(evaluation.statistics.images, resamples=5, seed=1)
    with_bins, without = (replicate(evaluation.statistics, weights, by_depth=by_depth) for by_depth in (True, False))

    assert without.depth_bins.size == 0
    assert np.array_equal(with_bins.classes, without.classes, equal_nan=True)


def test_depth_bins_not_asked_for_are_undefined(evaluation: Evaluation) -> None:
    """The nearest bins of all classes are what they are when all bins are computed; the others are NaN."""
    statistics = evaluation.statistics
    weights = bootstrap_weights(statistics.images, resamples=5, seed=1)
    nearest = every_bin(statistics)
    nearest[:, 4:] = False

    found = Replicator(statistics).replicate(weights, nearest)

    every = replicate(statistics, weights, by_depth=True)
    assert np.array_equal(found.depth_bins[:, :, :4], every.depth_bins[:, :, :4], equal_nan=True)
    assert not np.isnan(found.depth_bins[:, :, :4]).all()
    assert np.isnan(found.depth_bins[:, :, 4:]).all()


def test_boxes_that_come_and_go_with_the_threshold_are_counted_where_they_are() -> None:
    """Outcomes at thresholds drawn at random, which rise and fall, give the scores of the evaluation of these outcomes."""
    truth = read_ground_truth(CASE / "gt")
    statistics = evaluate(truth, load_predictions(CASE / "pred", truth.images, CITYSCAPES3D.labels)).statistics
    rng, every = np.random.default_rng(1), 2 ** len(statistics.thresholds)
    drawn = replace(
        statistics,
        pair_masks=rng.integers(0, every, len(statistics.pair_masks), dtype=np.uint64),
        false_positive_masks=rng.integers(0, every, len(statistics.false_positive_masks), dtype=np.uint64),
    )

    found = replicate(drawn, np.ones((1, len(drawn.images)), dtype=np.float32), by_depth=True)

    _equal(found, score(drawn))


def test_memory_does_not_grow_with_resamples_of_false_positives() -> None:
    """Under `paper` 20,000 false positives of a class on 500 resamples would take 40 MB of weights alone; 20 MB do."""
    truth = read_ground_truth(CASE / "gt")
    statistics = evaluate(truth, load_predictions(CASE / "pred", truth.images, PAPER.labels), PAPER).statistics
    count = 20_000
    many = replace(
        statistics,
        false_positive_image=np.resize(np.arange(60, dtype=np.int32), count),
        false_positive_cell=np.zeros(count, dtype=np.int32),
        false_positive_masks=np.zeros(count, dtype=np.uint64),
        false_positive_score=np.linspace(0, 1, count),
    )
    weights = bootstrap_weights(statistics.images, resamples=500, seed=1)

    tracemalloc.start()
    try:
        ScoreCurves(many).of_classes(weights)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert peak_bytes < 40e6


@pytest.mark.parametrize(
    ("images", "resamples", "seed", "unit", "expected"),
    [
        (("a_0_0", "a_0_1"), 0, 1, "image", "at least 1"),
        (("a_0_0", "a_0_1"), -5, 1, "image", "at least 1"),
        (("a_0_0", "a_0_1"), 10, -1, "image", "seed"),
        ((), 10, 1, "image", "at least 2"),
        (("a_0_0",), 10, 1, "image", "at least 2"),
        (("a_0_0", "a_0_1"), 10, 1, "sequence", "at least 2"),
        (("a_0_0", "a_1_0"), 10, 1, "city", "at least 2"),
        (("a_0_0", "b_1_0"), 10, 1, "country", "choose one of"),
    ],
)
def test_what_cannot_be_drawn_is_refused(
    images: tuple[str, ...], resamples: int, seed: int, unit: Unit, expected: str
) -> None:
    """No resamples, no images, one cluster only: an error of ours that says what is needed."""
    with pytest.raises(UsageError, match=expected):
        bootstrap_weights(images, resamples=resamples, seed=seed, unit=unit)
