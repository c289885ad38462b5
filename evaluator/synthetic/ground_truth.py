"""Ground-truth files of imaginary images: `<city>_<sequence>_<frame>_gtBbox3d.json`."""

from dataclasses import replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from evaluator.predictions import Float64Array
from evaluator.projection import IMAGE_HEIGHT_PX, IMAGE_WIDTH_PX
from evaluator.protocol import VEHICLE_LABELS
from evaluator.synthetic.cameras import BASELINE_M, Cameras, draw_cameras, view
from evaluator.synthetic.file_format import AnnotatedObject, Box3d, Boxes2d, GroundTruthFile, IgnoreRegion, Sensor
from evaluator.synthetic.population import PROTOTYPES, draw_labels
from evaluator.synthetic.scenes import Boxes, populate

CITIES = ("berlin", "bielefeld", "bonn", "leverkusen", "mainz", "munich")
"""The test cities of Cityscapes."""

LABEL_IDS = {
    "car": 26,
    "truck": 27,
    "bus": 28,
    "caravan": 29,
    "trailer": 30,
    "train": 31,
    "motorcycle": 32,
    "bicycle": 33,
}
"""Cityscapes label ids; an instance id is 1000 x label id + a number."""

IGNORE_REGIONS_PER_IMAGE = 0.4
UNOCCLUDED_SHARE = 0.45
MOST_OCCLUDED = 0.8
"""Beyond this the labelers annotate no box (paper, section Labeling Process)."""


def synthesize_ground_truth(images: int, seed: int) -> dict[str, bytes]:
    """Make the annotation files of imaginary images.

    Args:
        images: How many; 1525 hold about 12,500 boxes (paper, section Dataset Analysis).
        seed: Equal seeds give equal files.

    Returns:
        File name -> JSON, sorted by name. No images give an empty mapping.
    """
    rng = np.random.default_rng((seed, 1))
    cameras = draw_cameras(rng, images)
    boxes = _rounded(populate(rng, cameras, *draw_labels(rng, images)))
    annotated = _annotate(rng, cameras, boxes)
    ignored = _ignore_regions(rng, images)
    first = np.searchsorted(boxes.image_index, np.arange(images + 1))
    return {
        f"{name}_gtBbox3d.json": msgspec.json.encode(
            GroundTruthFile(
                imgWidth=IMAGE_WIDTH_PX,
                imgHeight=IMAGE_HEIGHT_PX,
                sensor=_sensor(cameras, image),
                objects=annotated[first[image] : first[image + 1]],
                ignore=ignored[image],
            )
        )
        for image, name in enumerate(image_names(images))
    }


def image_names(images: int) -> list[str]:
    """Name imaginary images of the test cities `<city>_<sequence>_<frame>`, sorted."""
    return [f"{CITIES[number * len(CITIES) // images]}_{number:06d}_000019" for number in range(images)]


def _sensor(cameras: Cameras, image: int) -> Sensor:
    """Describe one image's camera as its file does."""
    fx, fy, u0, v0 = cameras.intrinsics_px[image].tolist()
    return Sensor(fx, fy, u0, v0, BASELINE_M, cameras.sensor_from_vehicle[image].tolist())


def _rounded(boxes: Boxes) -> Boxes:
    """Keep as many digits as the data set's files do."""
    return replace(
        boxes,
        center_m=boxes.center_m.round(4),
        dimensions_m=boxes.dimensions_m.round(2),
        rotation=boxes.rotation.round(6),
    )


def _annotate(rng: np.random.Generator, cameras: Cameras, boxes: Boxes) -> list[AnnotatedObject]:
    """Turn boxes into annotations, with 2D boxes in whole pixels as in the data set."""
    seen = view(cameras[boxes.image_index], boxes.center_m, boxes.dimensions_m, boxes.rotation)
    occlusion = _occlusions(rng, len(boxes))
    amodal_px = xywh(seen.clipped_px.round())
    modal_px = visible_part(amodal_px, occlusion, from_left=rng.integers(2, size=len(boxes)) > 0)
    columns = zip(
        modal_px.astype(int).tolist(),
        amodal_px.astype(int).tolist(),
        boxes.center_m.tolist(),
        boxes.dimensions_m.tolist(),
        boxes.rotation.tolist(),
        boxes.prototype_index.tolist(),
        occlusion.tolist(),
        seen.truncation.round(1).tolist(),
        boxes.label_index.tolist(),
        strict=True,
    )
    return [
        AnnotatedObject(
            boxes_2d=Boxes2d(modal, amodal),
            box_3d=Box3d(center, dimensions, rotation, type=PROTOTYPES[prototype].name, format="CRS_ISO8855"),
            occlusion=occluded,
            truncation=abs(truncated),
            instanceId=1000 * LABEL_IDS[VEHICLE_LABELS[label]] + number % 1000,
            label=VEHICLE_LABELS[label],
        )
        for number, (modal, amodal, center, dimensions, rotation, prototype, occluded, truncated, label) in enumerate(
            columns
        )
    ]


def _occlusions(rng: np.random.Generator, count: int) -> Float64Array:
    """Draw (N,) occlusions in steps of 0.1: many of 0, the others falling off to the greatest annotated one."""
    steps = np.minimum(rng.geometric(0.3, size=count), round(10 * MOST_OCCLUDED))
    return np.where(rng.random(count) < UNOCCLUDED_SHARE, 0, steps) / 10


def visible_part(amodal_px: Float64Array, occlusion: Float64Array, *, from_left: NDArray[np.bool_]) -> Float64Array:
    """Cut the occluded share off one side of (N, 4) boxes x, y, width, height; whole pixels stay."""
    width_px = np.minimum(np.ceil(amodal_px[:, 2] * (1 - occlusion)), amodal_px[:, 2])
    modal_px = amodal_px.copy()
    modal_px[:, 0] += np.where(from_left, amodal_px[:, 2] - width_px, 0)
    modal_px[:, 2] = width_px
    return modal_px


def xywh(corners_px: Float64Array) -> Float64Array:
    """Turn (N, 4) x1, y1, x2, y2 into x, y, width, height."""
    return np.concatenate([corners_px[:, :2], corners_px[:, 2:] - corners_px[:, :2]], axis=1)


def _ignore_regions(rng: np.random.Generator, images: int) -> list[list[IgnoreRegion]]:
    """Draw crowds in which no single vehicle can be told, near the horizon, and vehicles hidden too much."""
    return [
        [_ignore_region(rng) for _ in range(count)]
        for count in rng.poisson(IGNORE_REGIONS_PER_IMAGE, size=images).tolist()
    ]


def _ignore_region(rng: np.random.Generator) -> IgnoreRegion:
    """Draw one region of 30 to 250 px around the horizon."""
    width, height = rng.integers(30, 250), rng.integers(25, 110)
    x, y = rng.integers(0, IMAGE_WIDTH_PX - width), rng.integers(400, 470)
    return IgnoreRegion((int(x), int(y), int(width), int(height)))
