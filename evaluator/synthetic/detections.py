"""What an imaginary method of a given quality makes of scenes."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evaluator.predictions import Float64Array, IndexArray
from evaluator.protocol import EVALUATED_LABELS
from evaluator.synthetic.annotations import Scenes
from evaluator.synthetic.cameras import multiply, quaternions
from evaluator.synthetic.population import OBJECTS_PER_IMAGE, PROTOTYPE_DIMENSIONS_M
from evaluator.synthetic.quality import Quality, growth
from evaluator.synthetic.scenes import Boxes, populate

BACKGROUND_SCORE_SHAPE = 25.0
"""Boxes that fill up a list to a fixed length have scores around 1 / 26."""

SCALE_AMBIGUITY = 0.7
"""A single image tells near and small from far and large badly: this share of a distance error shows as size."""

_EVALUATED = np.array([OBJECTS_PER_IMAGE[label] for label in EVALUATED_LABELS])
_CAR_PROTOTYPE = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Detections:
    """Boxes with scores, and how much of them the method calls hidden."""

    boxes: Boxes
    score: Float64Array
    hidden: Float64Array
    hidden_left: NDArray[np.bool_]

    def __getitem__(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> "Detections":
        """Pick rows."""
        return Detections(
            boxes=self.boxes[rows],
            score=self.score[rows],
            hidden=self.hidden[rows],
            hidden_left=self.hidden_left[rows],
        )


def detect(rng: np.random.Generator, scenes: Scenes, quality: Quality, boxes_per_image: float | None) -> Detections:
    """Detect the scenes' objects, with the method's errors.

    Args:
        rng: Where all chance comes from.
        scenes: What there is to see.
        quality: How good the method is.
        boxes_per_image: Exact mean length of the lists, filled up with boxes around nothing or cut at the lowest
            scores; None leaves them as they come.

    Returns:
        Detections ordered by image, then by descending score.
    """
    found = _find_objects(rng, scenes, quality)
    parts = [found, _duplicate(rng, scenes, quality, found), _find_ignored(rng, scenes, quality)]
    parts.append(_imagine(rng, scenes, rng.poisson(quality.false_per_image, len(scenes.names)), shape=5.0))
    detections = _ordered(parts)
    if boxes_per_image is None:
        return detections
    lengths = np.diff(np.floor(np.arange(len(scenes.names) + 1) * boxes_per_image).astype(int))
    detections = _shortened(detections, lengths)
    missing = lengths - np.bincount(detections.boxes.image_index, minlength=len(lengths))
    return _ordered([detections, _imagine(rng, scenes, missing, shape=BACKGROUND_SCORE_SHAPE)])


def _find_objects(rng: np.random.Generator, scenes: Scenes, quality: Quality) -> Detections:
    """Find some of the objects; the score says how likely that was."""
    distance_m = np.linalg.norm(scenes.boxes.center_m[:, :2], axis=1)
    probability = quality.detection_probability(distance_m, scenes.hidden)
    rows = np.flatnonzero(rng.random(len(probability)) < probability)
    logits = np.log(probability[rows] / (1 - probability[rows])) + rng.normal(0, quality.score_noise, len(rows))
    boxes = _displaced(rng, scenes, quality, scenes.boxes[rows])
    return Detections(
        boxes=replace(boxes, label_index=_confused(rng, boxes.label_index, quality.confused_share)),
        score=1 / (1 + np.exp(-logits)),
        hidden=scenes.hidden[rows],
        hidden_left=scenes.hidden_left[rows],
    )


def _confused(rng: np.random.Generator, label_index: IndexArray, share: float) -> IndexArray:
    """Give a share of the boxes some other evaluated class."""
    other = (label_index + rng.integers(1, len(EVALUATED_LABELS), len(label_index))) % len(EVALUATED_LABELS)
    return np.where(rng.random(len(label_index)) < share, other, label_index).astype(np.int32)


def _displaced(rng: np.random.Generator, scenes: Scenes, quality: Quality, boxes: Boxes) -> Boxes:
    """Place boxes as precisely as the method can."""
    count = len(boxes)
    cameras = scenes.cameras[boxes.image_index]
    ray_m = boxes.center_m - cameras.position_m
    distance_m = np.linalg.norm(ray_m, axis=1)
    worse = growth(distance_m)
    farther = np.exp(quality.distance_error * worse * rng.standard_normal(count))[:, None]
    ray_m *= farther
    ray_m[:, 1:] += (distance_m / cameras.intrinsics_px[:, 0])[:, None] * rng.normal(
        0, quality.image_error_px, (count, 2)
    )
    turned = np.where(rng.random(count) < quality.turned_share, np.pi, 0)
    yaw_rad = turned + quality.yaw_error_rad * worse * rng.standard_normal(count)
    pitch_rad, roll_rad = quality.tilt_error_rad * worse * rng.standard_normal((2, count))
    scale = rng.normal(1, quality.size_error, (count, 3)).clip(0.5, 1.5)
    return replace(
        boxes,
        center_m=cameras.position_m + ray_m,
        dimensions_m=boxes.dimensions_m * scale * farther**SCALE_AMBIGUITY,
        rotation=multiply(boxes.rotation, quaternions(yaw_rad, pitch_rad, roll_rad)),
    )


def _duplicate(rng: np.random.Generator, scenes: Scenes, quality: Quality, found: Detections) -> Detections:
    """Report some boxes again, displaced once more, with a lower score."""
    again = found[rng.random(len(found.score)) < quality.duplicated_share]
    score = again.score * rng.uniform(0.2, 0.9, len(again.score))
    return replace(again, boxes=_displaced(rng, scenes, quality, again.boxes), score=score)


def _imagine(rng: np.random.Generator, scenes: Scenes, counts: NDArray[np.integer], *, shape: float) -> Detections:
    """See boxes where there is nothing: `counts` per image, with scores around 1 / (1 + shape)."""
    image_index = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    shares = _EVALUATED / _EVALUATED.sum()
    label_index = rng.choice(len(shares), size=len(image_index), p=shares).astype(np.int32)
    boxes = populate(rng, scenes.cameras, image_index, label_index, apart=False)
    return Detections(
        boxes=boxes,
        score=rng.beta(1, shape, len(boxes)),
        hidden=np.zeros(len(boxes)),
        hidden_left=np.zeros(len(boxes), dtype=bool),
    )


def _find_ignored(rng: np.random.Generator, scenes: Scenes, quality: Quality) -> Detections:
    """Find cars in the crowds that the ground truth marks as ignored."""
    regions = np.repeat(
        np.arange(len(scenes.ignore_px)), rng.poisson(quality.found_per_ignore_region, len(scenes.ignore_px))
    )
    count = len(regions)
    image_index = scenes.ignore_image_index[regions]
    cameras = scenes.cameras[image_index]
    x, y, width, height = scenes.ignore_px[regions].T
    dimensions_m = np.tile(PROTOTYPE_DIMENSIONS_M[_CAR_PROTOTYPE], (count, 1))
    # As high as this fills most of the region; half the remaining room is left on either side of the centre.
    height_px = height * rng.uniform(0.4, 0.8, count)
    fx, fy, u0, v0 = cameras.intrinsics_px.T
    depth_m = fy * dimensions_m[:, 2] / height_px
    u = x + width * rng.uniform(0.4, 0.6, count)
    v = y + height / 2 + (height - height_px) * rng.uniform(-0.4, 0.4, count)
    ray_m = np.stack([depth_m, -(u - u0) / fx * depth_m, -(v - v0) / fy * depth_m], axis=1)
    rotation = cameras.sensor_from_vehicle[:, :, :3]
    yaw_rad = rng.normal(0, 0.05, count)
    boxes = Boxes(
        image_index=image_index,
        label_index=np.zeros(count, dtype=np.int32),
        prototype_index=np.full(count, _CAR_PROTOTYPE, dtype=np.int32),
        center_m=cameras.position_m + np.einsum("nji,nj->ni", rotation, ray_m),
        dimensions_m=dimensions_m,
        rotation=quaternions(yaw_rad, np.zeros(count), np.zeros(count)),
    )
    unhidden = np.zeros(count)
    return Detections(boxes=boxes, score=rng.beta(2, 3, count), hidden=unhidden, hidden_left=unhidden > 0)


def _ordered(parts: list[Detections]) -> Detections:
    """Join detections, ordered by image, then by descending score."""
    joined = Detections(
        boxes=Boxes(
            **{
                name: np.concatenate([getattr(part.boxes, name) for part in parts])
                for name in Boxes.__dataclass_fields__
            }
        ),
        score=np.concatenate([part.score for part in parts]),
        hidden=np.concatenate([part.hidden for part in parts]),
        hidden_left=np.concatenate([part.hidden_left for part in parts]),
    )
    return joined[np.lexsort((-joined.score, joined.boxes.image_index))]


def _shortened(detections: Detections, lengths: NDArray[np.integer]) -> Detections:
    """Keep at most `lengths` detections of each image, those that come first."""
    image_index = detections.boxes.image_index
    first = np.searchsorted(image_index, np.arange(len(lengths)))
    return detections[np.arange(len(image_index)) - first[image_index] < lengths[image_index]]
