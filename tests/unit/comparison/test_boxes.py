"""Selection of boxes by class, headings, camera positions, ignore regions and pairs."""

import numpy as np
import pytest

from evaluator.comparison.boxes import camera_positions, class_boxes, heading
from evaluator.errors import UsageError
from tests.array_factories import Box, make_ground_truth, make_predictions


def test_heading_does_not_depend_on_the_length_or_sign_of_the_quaternion() -> None:
    """A quarter turn to the left is pi/2 however the quaternion is written."""
    half = np.sqrt(0.5)
    turned = np.array([[half, 0, 0, half], [-half, 0, 0, -half], [3 * half, 0, 0, 3 * half]])
    assert heading(turned) == pytest.approx([np.pi / 2] * 3)


def test_heading_ignores_pitch() -> None:
    """A box that noses down keeps the heading 0."""
    assert heading(np.array([[np.cos(0.1), 0, np.sin(0.1), 0]])) == pytest.approx([0.0])


def test_camera_position_undoes_rotation_and_translation() -> None:
    """The position is where the transform yields 0."""
    # a quarter turn: sensor x is vehicle y. R (x, y, z) = (y, -x, z); R (1, 2, 3) + t = 0 for t = (-2, 1, -3)
    pose = np.array([[[0.0, 1, 0, -2], [-1, 0, 0, 1], [0, 0, 1, -3]]])
    assert camera_positions(pose) == pytest.approx(np.array([[1.0, 2, 3]]))


def test_predictions_come_in_score_order_and_ties_in_file_order() -> None:
    """Highest score first; equal scores keep their order."""
    boxes = [Box(score=s, center=(x, 0, 0)) for s, x in ((0.5, 1.0), (0.9, 2.0), (0.5, 3.0))]
    (car, *_rest) = class_boxes(make_predictions(boxes), make_ground_truth([]))
    assert car.predictions.center_m[:, 0].tolist() == [2.0, 1.0, 3.0]


def test_classes_are_told_apart_by_name() -> None:
    """Ground truth and predictions number their labels differently; names decide."""
    truth = [Box(label="truck"), Box(label="car"), Box(label="caravan")]
    classes = class_boxes(make_predictions([Box(label="truck")]), make_ground_truth(truth))
    counts = {boxes.label: (len(boxes.predictions), len(boxes.ground_truth)) for boxes in classes}
    assert counts["car"] == (0, 1)
    assert counts["truck"] == (1, 1)
    assert counts["bus"] == (0, 0)
    assert "caravan" not in counts


def test_a_prediction_in_an_ignore_region_is_excused() -> None:
    """More than 70 % of the modal box with one pixel added must lie in one region of the same image."""
    # 100 x 100 px at (0, 0); region 70 px wide covers 71 * 101 / 101^2 = 0.703, one of 69 px 0.693
    predictions = make_predictions([Box(modal=(0.0, 0.0, 100.0, 100.0))] * 2 + [Box(image=1)], images=2)
    wide = class_boxes(predictions, make_ground_truth([], images=2, ignore=[(0, (0.0, 0.0, 70.0, 200.0))]))
    narrow = class_boxes(predictions, make_ground_truth([], images=2, ignore=[(0, (0.0, 0.0, 69.0, 200.0))]))
    assert wide[0].excused.tolist() == [True, True, False]
    assert narrow[0].excused.tolist() == [False, False, False]


def test_other_images_are_refused() -> None:
    """Predictions read with another image list cannot be compared."""
    with pytest.raises(UsageError, match="image list"):
        class_boxes(make_predictions([], images=1), make_ground_truth([], images=2))
