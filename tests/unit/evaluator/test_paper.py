"""The protocol `paper` where it differs from `cityscapes3d`, on cases small enough for pencil and paper."""

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from evaluator.evaluation import evaluate
from evaluator.ground_truth import GroundTruth
from evaluator.paper_matching import match_by_paper, plain_ious
from evaluator.protocol import PAPER
from evaluator.thresholds import unpacked
from tests.array_factories import Box, Rectangle, annotated, make_ground_truth, make_predictions

NEAR = Box(center=(20.0, 0.0, 0.0))
FAR = Box(center=(40.0, 8.0, 0.0))


def test_iou_is_of_plain_rectangles() -> None:
    """10 x 10 shifted by 5: 50 / 150, without the reference's extra pixel; boxes without area have none."""
    first = np.array([[0.0, 0, 10, 10], [5, 5, 5, 5]]).T
    second = np.array([[5.0, 0, 15, 10], [5, 5, 5, 5]]).T

    assert plain_ious(first, second).tolist() == pytest.approx([1 / 3, 0])


def test_annotated_rectangles_play_no_part() -> None:
    """Both sides are projected, so wrong rectangles in the files change nothing."""
    truth = make_ground_truth([NEAR])

    assert match_by_paper(truth, make_predictions([NEAR]), PAPER).prediction_index.tolist() == [0]


def test_the_higher_score_wins_even_with_the_worse_overlap() -> None:
    """The box at .9 is the true positive at every threshold up to .9; the exact one is its duplicate."""
    near = replace(NEAR, center=(20.2, 0.0, 0.0), score=0.9)

    matches = match_by_paper(make_ground_truth([NEAR]), make_predictions([replace(NEAR, score=0.3), near]), PAPER)

    assert matches.prediction_index.tolist() == [1]
    assert np.flatnonzero(unpacked(matches.pair_thresholds, 51)[0]).tolist() == list(range(46))
    assert np.bitwise_count(matches.false_positive_thresholds).tolist() == [16, 0]


def test_a_prediction_goes_for_the_box_it_overlaps_most() -> None:
    """Finding it taken it is a false positive, although the other box is free (Pascal VOC)."""
    other = replace(NEAR, center=(20.3, 0.0, 0.0))
    predictions = make_predictions([replace(NEAR, score=0.9), replace(NEAR, score=0.8)])

    matches = match_by_paper(make_ground_truth([NEAR, other]), predictions, PAPER)

    assert list(zip(matches.ground_truth_index, matches.prediction_index, strict=True)) == [(0, 0)]


def test_two_regions_together_cover_a_box() -> None:
    """Each region covers half of the predicted rectangle: neither has 70 % of it, their union has all."""
    x, y, width, height = annotated([FAR])[0].amodal
    halves = [(0, (x, y, width / 2, height)), (0, (x + width / 2, y, width / 2, height))]

    one, both = (
        match_by_paper(make_ground_truth([NEAR], ignore=regions), make_predictions([NEAR, FAR]), PAPER)
        for regions in (halves[:1], halves)
    )

    assert np.bitwise_count(one.false_positive_thresholds).tolist() == [0, 51]
    assert np.bitwise_count(both.ignored_thresholds).tolist() == [0, 51]


def test_regions_are_compared_with_the_projected_box() -> None:
    """Writing the region into the submitted modal box does not help."""
    region = (0.0, 0.0, 300.0, 300.0)
    hidden = replace(FAR, modal=region)

    matches = match_by_paper(make_ground_truth([NEAR], ignore=[(0, region)]), make_predictions([NEAR, hidden]), PAPER)

    assert np.bitwise_count(matches.false_positive_thresholds).tolist() == [0, 51]


def _in_whole_pixels(truth: list[Box], regions: Sequence[Rectangle] = ()) -> GroundTruth:
    """Make ground truth seen by a camera in which a metre, 16 m ahead, is 64 px, and the middle is (1024, 512)."""
    ground_truth = make_ground_truth(truth, ignore=[(0, region) for region in regions])
    return replace(ground_truth, intrinsics_px=np.array([[1024.0, 1024.0, 1024.0, 512.0]]))


def _facing(width_px: float) -> Box:
    """Return a box whose front, 16 m ahead, is so many pixels wide and 160 high; nothing of it is seen beside that."""
    return Box(center=(18.0, 0.0, 0.0), dimensions=(4.0, width_px / 64, 2.5))


@pytest.mark.parametrize(("width_px", "matched"), [(112, True), (111, False)])
def test_an_iou_of_exactly_the_minimum_is_a_match(width_px: float, matched: bool) -> None:  # noqa: FBT001 - a parameter
    """112 of 160 columns are an IoU of .7, which the paper requires; 111 are .694."""
    found = match_by_paper(_in_whole_pixels([_facing(160)]), make_predictions([_facing(width_px)]), PAPER)

    assert found.prediction_index.tolist() == ([0] if matched else [])


@pytest.mark.parametrize("min_iou", [0.5, 0.7, 0.9])
@pytest.mark.parametrize(("width_px", "discarded"), [(112, True), (111, False)])
def test_seventy_percent_in_an_ignore_region_are_enough(
    min_iou: float,
    width_px: float,
    discarded: bool,  # noqa: FBT001 - a parameter
) -> None:
    """At least 70 % of the box, 112 of 160 columns, whatever the IoU that a match needs."""
    truth = _in_whole_pixels([], [(944.0, 400.0, width_px, 300.0)])  # the box begins at 1024 - 80

    matches = match_by_paper(truth, make_predictions([_facing(160)]), msgspec.structs.replace(PAPER, min_iou=min_iou))

    assert np.bitwise_count(matches.ignored_thresholds).tolist() == [51 if discarded else 0]
    assert np.bitwise_count(matches.false_positive_thresholds).tolist() == [0 if discarded else 51]


def test_average_precision_uses_every_score() -> None:
    """True .905, false .901, both between the thresholds .90 and .92: AP of one box is 1, not .5."""
    predictions = make_predictions([replace(NEAR, score=0.905), replace(FAR, score=0.901)])

    scores = evaluate(make_ground_truth([NEAR]), predictions, PAPER).scores

    assert scores.classes[0].ap == 1
    assert scores.classes[0].working_point == 0.905


def test_similarities_are_integrals_over_the_whole_range() -> None:
    """Perfect boxes in two of twenty bins: 2 / 20 for each similarity."""
    scores = evaluate(make_ground_truth([NEAR, FAR]), make_predictions([NEAR, FAR]), PAPER).scores

    assert scores.classes[0].ap == 1
    assert scores.classes[0].detection_score == pytest.approx(0.1)
