"""KITTI's measures against the kit's procedure in plain loops, on random scenes."""

from dataclasses import replace

import pytest

from evaluator.comparison.boxes import class_boxes
from evaluator.comparison.kitti import evaluate_kitti
from tests.array_factories import Box, Rectangle, disturbed_boxes, make_ground_truth, make_predictions, scattered_boxes
from tests.kitti_by_definition import kitti_ap

IMAGES = 3
REGION: Rectangle = (0.0, 0.0, 100.0, 100.0)
OUTSIDE: Rectangle = (500.0, 500.0, 50.0, 50.0)


def aligned(boxes: list[Box]) -> list[Box]:
    """Return boxes that all look ahead, and sorted by image, as files are."""
    return sorted((replace(box, yaw=box.yaw / 50) for box in boxes), key=lambda box: box.image)


def scene(seed: int, spacing_m: tuple[float, float]) -> tuple[list[Box], list[Box]]:
    """Return ground truth and predictions of cars; of these half have equal scores among them, a third is in a region."""
    truth = aligned(scattered_boxes(seed, images=IMAGES, per_image=12, labels=("car",), spacing_m=spacing_m))
    found = aligned(disturbed_boxes(seed + 1, truth, images=IMAGES, spread=0.8))
    return truth, [
        replace(box, score=round(box.score, 1) if i % 2 else box.score, modal=OUTSIDE if i % 3 else REGION)
        for i, box in enumerate(found)
    ]


@pytest.mark.parametrize("spacing_m", [(9.0, 8.0), (1.5, 1.2), (0.4, 0.5)], ids=["apart", "crowded", "heaped"])
@pytest.mark.parametrize("seed", range(3))
def test_kitti_equals_its_definition(seed: int, spacing_m: tuple[float, float]) -> None:
    """AP_BEV and AP_3D are the kit's, also where boxes overlap, scores are equal and predictions lie in ignore regions."""
    truth, found = scene(seed, spacing_m)
    excused = range(0, len(found), 3)
    ground_truth = make_ground_truth(truth, images=IMAGES, ignore=[(image, REGION) for image in range(IMAGES)])
    cars = evaluate_kitti(class_boxes(make_predictions(found, images=IMAGES), ground_truth)).classes[0]
    for part in cars.overlaps:
        for name in ("ap_bev", "ap_3d"):
            expected = kitti_ap(truth, found, part.min_iou, volume=name == "ap_3d", excused=excused)
            assert getattr(part, name) == pytest.approx(expected, abs=1e-12), (name, part.min_iou)
