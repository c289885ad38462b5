"""Prediction files of an imaginary method: `<city>_<sequence>_<frame>_predBbox3d.json`."""

from collections.abc import Mapping

import msgspec
import numpy as np

from evaluator.protocol import VEHICLE_LABELS
from evaluator.synthetic.annotations import Scenes, read_scenes
from evaluator.synthetic.cameras import view
from evaluator.synthetic.detections import Detections, detect
from evaluator.synthetic.file_format import Box3d, Boxes2d, PredictedObject, PredictionFile
from evaluator.synthetic.ground_truth import visible_part, xywh
from evaluator.synthetic.quality import Quality


def synthesize_predictions(
    ground_truth_files: Mapping[str, bytes], quality: Quality, seed: int, boxes_per_image: float | None = None
) -> dict[str, bytes]:
    """Make the prediction files of a method for images whose annotations are known.

    Args:
        ground_truth_files: File name -> JSON, as `synthesize_ground_truth` makes them.
        quality: How good the method is.
        seed: Equal seeds (and other arguments) give equal files.
        boxes_per_image: Exact mean number of boxes; None leaves each list as long as it comes.

    Returns:
        File name -> JSON, one for each image, also where nothing is found; sorted by name.
    """
    scenes = read_scenes(ground_truth_files)
    detections = detect(np.random.default_rng((seed, 2)), scenes, quality, boxes_per_image)
    objects = _objects(scenes, detections)
    first = np.searchsorted(detections.boxes.image_index, np.arange(len(scenes.names) + 1))
    return {
        f"{name}_predBbox3d.json": msgspec.json.encode(PredictionFile(objects[first[image] : first[image + 1]]))
        for image, name in enumerate(scenes.names)
    }


def _objects(scenes: Scenes, detections: Detections) -> list[PredictedObject]:
    """Write detections down as methods do: with more digits than they are worth."""
    boxes = detections.boxes
    seen = view(scenes.cameras[boxes.image_index], boxes.center_m, boxes.dimensions_m, boxes.rotation)
    amodal_px = xywh(seen.clipped_px).round(8)
    columns = zip(
        visible_part(amodal_px, detections.hidden, from_left=detections.hidden_left).round(8).tolist(),
        amodal_px.tolist(),
        boxes.center_m.tolist(),
        boxes.dimensions_m.tolist(),
        boxes.rotation.tolist(),
        boxes.label_index.tolist(),
        detections.score.round(6).tolist(),
        strict=True,
    )
    return [
        PredictedObject(Boxes2d(modal, amodal), Box3d(center, dimensions, rotation), VEHICLE_LABELS[label], score)
        for modal, amodal, center, dimensions, rotation, label, score in columns
    ]
