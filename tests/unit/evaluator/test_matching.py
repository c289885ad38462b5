"""The greedy matching, at all score thresholds at once, on cases small enough for pencil and paper."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from evaluator.errors import UsageError
from evaluator.ground_truth import GroundTruth
from evaluator.matching import Edges, Matches, match, take_edges
from evaluator.overlap import corners_px, covered_fractions, intersections_over_unions
from evaluator.paper_matching import projected_boxes
from evaluator.predictions import Float64Array
from evaluator.projection_to_the_bit import projected_to_the_bit_px
from evaluator.protocol import CITYSCAPES3D, MOST_SCORE_STEPS
from evaluator.rounding import Pairs, settled
from evaluator.thresholds import active_masks, count_by_group, prefix_masks, score_thresholds, unpacked
from tests.array_factories import Box, annotated, make_ground_truth, make_predictions

MODAL = msgspec.structs.replace(CITYSCAPES3D, modal=True)
"""Matching the boxes as they are written, so that the cases can be drawn in pixels."""


def _match(
    truth: list[Box], predictions: list[Box], *, ignore: tuple[float, float, float, float] | None = None
) -> Matches:
    regions = [] if ignore is None else [(0, ignore)]
    return match(make_ground_truth(truth, ignore=regions), make_predictions(predictions), MODAL)


def _levels(masks: np.ndarray[tuple[int, ...], np.dtype[np.uint64]]) -> list[list[int]]:
    return [np.flatnonzero(row).tolist() for row in unpacked(masks, 51)]


def test_iou_counts_pixels_inclusively() -> None:
    """10 x 10 px reach over 11 x 11 pixels; shifted by 5 they share 6 x 11: 66 / (121 + 121 - 66) = .375."""
    first, second = corners_px(np.array([[0.0, 0, 10, 10]])), corners_px(np.array([[5.0, 0, 10, 10]]))

    assert intersections_over_unions(first, second)[0] == pytest.approx(0.375)


def test_covered_fraction_is_of_the_prediction() -> None:
    """A region over 6 of 11 columns covers 6 / 11 of the box, however large the region is."""
    region, box = corners_px(np.array([[-1000.0, -1000, 1005, 3000]])), corners_px(np.array([[0.0, 0, 10, 10]]))

    assert covered_fractions(region, box)[0] == pytest.approx(6 / 11)


def test_thresholds_are_the_floating_point_grid_of_the_reference() -> None:
    """The grid's 0.7 is 0.7000000000000001, so a score of 0.7 ends at the threshold before it; 0.5 reaches its own."""
    thresholds = score_thresholds(CITYSCAPES3D)

    levels = np.bitwise_count(active_masks(np.array([0.7, 0.5, 1.0, 0.0, -0.1, 1.5, np.nan]), thresholds))

    assert len(thresholds) == 51
    assert levels.tolist() == [35, 26, 51, 1, 0, 51, 0]


@pytest.mark.parametrize("steps", range(1, MOST_SCORE_STEPS + 1))
def test_a_score_is_active_at_all_thresholds_that_it_reaches(steps: int) -> None:
    """On every grid, at each threshold and at the numbers next to it on both sides."""
    thresholds = score_thresholds(msgspec.structs.replace(CITYSCAPES3D, score_steps=steps))
    around = [np.nextafter(thresholds, side) for side in (-1.0, 2.0)]
    score = np.concatenate([thresholds, *around, np.arange(0, 1001) / 1000, np.arange(0, 129) / 128])

    levels = np.bitwise_count(active_masks(score, thresholds))

    assert levels.tolist() == (thresholds <= score[:, None]).sum(axis=1).tolist()


def test_the_better_overlap_wins_even_with_the_lower_score() -> None:
    """Up to .3 the exact box is the true positive; only above it the box with score .9."""
    truth = [Box(amodal=(0, 0, 100, 100))]
    exact, near = Box(amodal=(0, 0, 100, 100), score=0.3), Box(amodal=(0, 0, 110, 100), score=0.9)

    matches = _match(truth, [near, exact])

    assert matches.prediction_index.tolist() == [0, 1]
    # thresholds 0 ... .30 are numbers 0 ... 15, .32 ... .90 are 16 ... 45
    assert _levels(matches.pair_thresholds) == [list(range(16, 46)), list(range(16))]
    assert _levels(matches.false_positive_thresholds) == [list(range(16)), []]
    assert _levels(matches.matched_thresholds) == [list(range(46))]


def test_ties_go_to_the_first_ground_truth_then_to_the_first_prediction() -> None:
    """Two equal boxes on both sides are paired in the order of their files."""
    box = Box(amodal=(0, 0, 100, 100))

    matches = _match([box, box], [box, box])

    assert list(zip(matches.ground_truth_index, matches.prediction_index, strict=True)) == [(0, 0), (1, 1)]


def test_an_iou_of_exactly_the_minimum_is_no_match() -> None:
    """99 x 69 in 99 x 99: 100 x 70 of 100 x 100 pixels, and the comparison is strict."""
    matches = _match([Box(amodal=(0, 0, 99, 99))], [Box(amodal=(0, 0, 99, 69))])

    assert len(matches.prediction_index) == 0
    assert _levels(matches.false_positive_thresholds) == [list(range(51))]


def test_classes_and_images_never_mix() -> None:
    """A truck does not find a car, nor does a car in the next image."""
    truth = make_ground_truth([Box(amodal=(0, 0, 100, 100))], images=2)
    predictions = make_predictions(
        [Box(amodal=(0, 0, 100, 100), label="truck"), Box(amodal=(0, 0, 100, 100), image=1)], images=2
    )

    assert len(match(truth, predictions, MODAL).prediction_index) == 0


def test_labels_that_are_not_evaluated_take_no_part() -> None:
    """Caravans are annotated, but neither found nor missed."""
    truth = make_ground_truth([Box(amodal=(0, 0, 100, 100), label="caravan")])

    matches = match(truth, make_predictions([Box(amodal=(0, 0, 100, 100))]), MODAL)

    assert matches.matched_thresholds.tolist() == [0]
    assert _levels(matches.false_positive_thresholds) == [list(range(51))]


def test_unmatched_boxes_in_an_ignore_region_are_discarded() -> None:
    """The region covers all of the second prediction; the first matches and stays a true positive inside it."""
    truth = [Box(amodal=(0, 0, 100, 100))]
    inside = Box(amodal=(10, 10, 20, 20), score=0.5)

    matches = _match(truth, [*truth, inside], ignore=(0, 0, 200, 200))

    assert matches.prediction_index.tolist() == [0]
    assert _levels(matches.ignored_thresholds) == [[], list(range(26))]
    assert matches.false_positive_thresholds.tolist() == [0, 0]


@pytest.mark.parametrize(("columns", "discarded"), [(70, False), (71, True)])
def test_more_than_seventy_percent_must_be_ignored(columns: int, discarded: bool) -> None:  # noqa: FBT001 - a parameter
    """Of 100 columns of pixels 70 are not more than 70 %, 71 are; a width of 69 px reaches over 70 columns."""
    matches = _match([], [Box(amodal=(0, 0, 99, 99))], ignore=(0, 0, columns - 1, 99))

    assert np.bitwise_count(matches.ignored_thresholds).tolist() == [51 if discarded else 0]


def test_every_active_prediction_is_exactly_one_of_three() -> None:
    """Matched, ignored or false positive: the masks of a prediction never overlap and add up to its score."""
    rng = np.random.default_rng(1)
    truth = [Box(amodal=(float(x), 0, 100, 100)) for x in rng.uniform(0, 150, 8)]
    predictions = [Box(amodal=(float(x), 0, 100, 100), score=float(s)) for x, s in rng.uniform(0, [150, 1], (40, 2))]

    matches = _match(truth, predictions, ignore=(0, 0, 120, 100))

    matched = np.zeros(len(predictions), dtype=np.uint64)
    np.bitwise_xor.at(matched, matches.prediction_index, matches.pair_thresholds)
    parts = (matched, matches.ignored_thresholds, matches.false_positive_thresholds)
    active = active_masks(np.array([box.score for box in predictions]), matches.thresholds)
    assert (parts[0] ^ parts[1] ^ parts[2]).tolist() == active.tolist()
    assert sum(int(np.bitwise_count(part).sum()) for part in parts) == int(np.bitwise_count(active).sum())


def test_one_pass_equals_matching_each_threshold_by_itself() -> None:
    """Random candidate pairs with many ties: the masks agree with a plain greedy matching at every threshold."""
    rng = np.random.default_rng(2)
    for _ in range(50):
        gt_row, prediction_row = (rng.integers(0, 6, 20) for _ in range(2))
        edges = Edges(gt_row, prediction_row)
        active = prefix_masks(51)[rng.integers(0, 52, 6)]
        taken = take_edges(edges, np.full(6, prefix_masks(51)[-1]), active.copy())

        for threshold in range(51):
            free_gt, free_prediction = set(range(6)), set(np.flatnonzero(unpacked(active, 51)[:, threshold]))
            for edge, (gt, prediction) in enumerate(zip(gt_row, prediction_row, strict=True)):
                expected = gt in free_gt and prediction in free_prediction
                free_gt -= {gt} if expected else set()
                free_prediction -= {prediction} if expected else set()
                assert bool(unpacked(taken, 51)[edge, threshold]) == expected


def test_counts_by_group_equal_counting_bits() -> None:
    """Prefix masks and others are counted alike."""
    rng = np.random.default_rng(3)
    masks = np.concatenate([prefix_masks(51)[rng.integers(0, 52, 30)], rng.integers(0, 1 << 51, 30, dtype=np.uint64)])
    group = rng.integers(0, 4, 60)

    expected = [unpacked(masks[group == number], 51).sum(axis=0).tolist() for number in range(4)]
    assert count_by_group(group, masks, 4, 51).tolist() == expected


def test_different_images_are_refused() -> None:
    """The message says what both sides must share."""
    with pytest.raises(UsageError, match="same images"):
        match(make_ground_truth([], images=2), make_predictions([], images=1), CITYSCAPES3D)


def _around_the_camera() -> GroundTruth:
    """Sixteen boxes ahead of, around and behind the camera."""
    return make_ground_truth(
        [Box(center=(x, y, 0.8), yaw=yaw) for x in (-20.0, 0.5, 12.0, 60.0) for y in (-5.0, 1.0) for yaw in (0.0, 0.7)]
    )


def _to_the_bit(truth: GroundTruth, rows: slice) -> Float64Array:
    camera = truth.image_index[rows]
    return projected_to_the_bit_px(
        truth.center_m[rows],
        truth.dimensions_m[rows],
        truth.rotation[rows],
        truth.intrinsics_px[camera],
        truth.sensor_from_vehicle[camera],
    )


def test_projection_to_the_bit_agrees_with_the_fast_one() -> None:
    """Boxes ahead, around and behind the camera: the same corners to 1e-8 px."""
    truth = _around_the_camera()

    fast = projected_boxes(truth, truth)

    clipped = np.clip(fast, 0, [[2047], [1023], [2047], [1023]])
    assert np.abs(clipped - _to_the_bit(truth, slice(None))).max() < 1e-8


def test_projection_to_the_bit_does_not_depend_on_the_other_boxes() -> None:
    """Each box by itself gives the very bits that all of them together give."""
    truth = _around_the_camera()

    alone = np.concatenate([_to_the_bit(truth, slice(row, row + 1)) for row in range(len(truth))], axis=1)

    assert _to_the_bit(truth, slice(None)).tobytes() == alone.tobytes()


def test_boxes_that_differ_by_rounding_alone_are_ordered_as_in_the_reference() -> None:
    """Twice one shape, once turned by 180 degrees: both are found to hang on rounding and projected to the bit."""
    box = annotated([Box(center=(20.3, 1.7, 0.8), yaw=0.3)])[0]
    truth, predictions = make_ground_truth([box]), make_predictions([box, replace(box, yaw=0.3 + np.pi)])
    corners = corners_px(truth.amodal_px)
    pairs = Pairs(np.zeros(2, dtype=np.int64), np.arange(2), np.array([1.0, 1.0 + 1e-13]))

    exact = settled(pairs, 0.7, corners, truth, predictions)

    assert exact.iou == pytest.approx([1, 1], abs=1e-6)
    assert exact.iou.tolist() != pairs.iou.tolist()
    assert settled(pairs[np.array([0])], 0.7, corners, truth, predictions).iou.tolist() == [1.0]
