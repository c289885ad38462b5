"""Recall and errors by kinds of objects."""

from dataclasses import replace

import numpy as np
import pytest

from evaluator.diagnosis.errors import pair_errors
from evaluator.diagnosis.subsets import Grouping, group, memberships
from evaluator.diagnosis.working_point import at_working_point
from evaluator.evaluation import evaluate
from tests.array_factories import Box, annotated, make_ground_truth, make_predictions


def groupings(truth: list[Box], found: list[Box], class_index: int | None = None) -> dict[str, Grouping]:
    """Evaluate one image and sort its boxes."""
    evaluation = evaluate(make_ground_truth(truth), make_predictions(found))
    point = at_working_point(evaluation)
    errors = pair_errors(evaluation, point)
    sorted_boxes = (group(part, point, errors, class_index) for part in memberships(evaluation.ground_truth))
    return {grouping.name: grouping for grouping in sorted_boxes}


def recalls(grouping: Grouping) -> dict[str, tuple[int, float]]:
    """Return count and recall of each subset."""
    return {subset.name: (subset.ground_truth_count, subset.recall) for subset in grouping.subsets}


def test_occlusion_steps_belong_to_the_group_they_end() -> None:
    """20 % is in 1-20 %, 30 % in 21-40 %, nothing said is unknown; empty groups are left out."""
    shares = [0.0, 0.2, 0.3, 0.8, np.nan]
    boxes = annotated([Box(center=(15.0, 6.0 * i - 12, 0.75), occlusion=share) for i, share in enumerate(shares)])
    found = [boxes[0], replace(boxes[2], center=(15.3, 0.0, 0.75))]
    sorted_boxes = groupings(boxes, found)["occlusion"]
    assert recalls(sorted_boxes) == {
        "0 %": (1, 1.0),
        "1-20 %": (1, 0.0),
        "21-40 %": (1, 1.0),
        "61-80 %": (1, 0.0),
        "unknown": (1, 0.0),
    }
    by_name = {subset.name: subset.errors for subset in sorted_boxes.subsets}
    assert by_name["0 %"].mean.center_m == 0.0
    assert by_name["21-40 %"].mean.center_m == pytest.approx(0.3)
    assert by_name["1-20 %"].mean.center_m is None


def test_occlusion_and_truncation_are_told_apart() -> None:
    """What is cut off by the image's edge is not hidden by something, and the other way round."""
    boxes = [Box(occlusion=0.5), Box(truncation=0.3), Box(occlusion=0.9, truncation=np.nan)]
    sorted_boxes = groupings(boxes, [])
    assert recalls(sorted_boxes["occlusion"]) == {"0 %": (1, 0.0), "41-60 %": (1, 0.0), "81-100 %": (1, 0.0)}
    assert recalls(sorted_boxes["truncation"]) == {"0 %": (1, 0.0), "21-40 %": (1, 0.0), "unknown": (1, 0.0)}


def test_prototypes_keep_their_names() -> None:
    """Objects are sorted by the annotator's size prototype."""
    boxes = annotated([Box(), Box(center=(20.0, 6.0, 0.75), prototype="Mini Car")])
    assert recalls(groupings(boxes, boxes[:1])["prototype"]) == {"Mini Car": (1, 0.0), "Sedan": (1, 1.0)}


def test_boxes_are_sorted_by_place_and_height_in_the_image() -> None:
    """The middle of the amodal box decides the third of the image, its height the size."""
    boxes = [
        Box(amodal=(0.0, 0.0, 100.0, 24.0)),  # middle at 50 px
        Box(amodal=(600.0, 0.0, 200.0, 25.0)),  # 700 px
        Box(amodal=(1500.0, 0.0, 100.0, 250.0)),  # 1550 px; thirds end at 682.7 and 1365.3
    ]
    sorted_boxes = groupings(boxes, [])
    assert list(recalls(sorted_boxes["image_region"])) == ["left", "middle", "right"]
    assert list(recalls(sorted_boxes["box_height"])) == ["below 25 px", "25-50 px", "200 px and more"]


def test_crowding_counts_touching_boxes_of_any_class() -> None:
    """A box is crowded by every other annotated box it shares a pixel with, evaluated or not."""
    boxes = [
        Box(amodal=(0.0, 0.0, 50.0, 50.0)),
        Box(amodal=(40.0, 0.0, 50.0, 50.0), label="caravan"),
        Box(amodal=(80.0, 0.0, 50.0, 50.0)),
        Box(amodal=(500.0, 0.0, 50.0, 50.0)),
    ]
    crowding = groupings(boxes, [])["crowding"]
    # the caravan has two neighbours but is not evaluated
    assert recalls(crowding) == {"alone": (1, 0.0), "1 neighbour": (2, 0.0)}


@pytest.mark.parametrize(("offset", "expected"), [(50.0, {"1 neighbour": (2, 0.0)}), (51.0, {"alone": (2, 0.0)})])
def test_one_shared_pixel_is_a_neighbour(offset: float, expected: dict[str, tuple[int, float]]) -> None:
    """A box 50 px wide reaches over columns 0 to 50, so one that begins at (50, 50) shares a corner with it."""
    boxes = [Box(amodal=(0.0, 0.0, 50.0, 50.0)), Box(amodal=(offset, offset, 50.0, 50.0))]
    assert recalls(groupings(boxes, [])["crowding"]) == expected


def test_a_class_is_sorted_by_itself() -> None:
    """Counts of one class leave out the others; every grouping holds every box once."""
    boxes = annotated([Box(), Box(center=(20.0, 6.0, 0.75)), Box(label="bus", center=(20.0, -6.0, 0.75))])
    for expected, class_index in ((3, None), (2, 0), (1, 2)):
        for grouping in groupings(boxes, boxes, class_index).values():
            assert sum(subset.ground_truth_count for subset in grouping.subsets) == expected
            assert {subset.recall for subset in grouping.subsets} == {1.0}
