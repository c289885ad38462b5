"""Parts of a benchmark's images, with what is on them, as views."""

from dataclasses import replace

import numpy as np

from evaluator.ground_truth import GroundTruth
from evaluator.predictions import Predictions


def predictions_of(predictions: Predictions, part: slice) -> Predictions:
    """Return the predictions of a part of the images, as views."""
    first, stop, _ = part.indices(len(predictions.images))
    rows = slice(*np.searchsorted(predictions.image_index, (first, stop)).tolist())
    of_boxes = ("label_index", "score", "center_m", "dimensions_m", "rotation", "amodal_px", "modal_px")
    return replace(
        predictions,
        images=predictions.images[part],
        image_index=predictions.image_index[rows] - np.int32(first),
        **{name: getattr(predictions, name)[rows] for name in of_boxes},
    )


def ground_truth_of(ground_truth: GroundTruth, part: slice) -> GroundTruth:
    """Return the ground truth of a part of the images, as views."""
    first, stop, _ = part.indices(len(ground_truth.images))
    boxes = slice(*np.searchsorted(ground_truth.image_index, (first, stop)).tolist())
    regions = slice(*np.searchsorted(ground_truth.ignore_image_index, (first, stop)).tolist())
    of_boxes = (
        "label_index", "prototype_index", "center_m", "dimensions_m", "rotation",
        "amodal_px", "modal_px", "occlusion", "truncation",
    )  # fmt: skip
    return replace(
        ground_truth,
        images=ground_truth.images[part],
        intrinsics_px=ground_truth.intrinsics_px[part],
        sensor_from_vehicle=ground_truth.sensor_from_vehicle[part],
        image_index=ground_truth.image_index[boxes] - np.int32(first),
        ignore_image_index=ground_truth.ignore_image_index[regions] - np.int32(first),
        ignore_px=ground_truth.ignore_px[regions],
        **{name: getattr(ground_truth, name)[boxes] for name in of_boxes},
    )
