"""Annotation files read back as arrays: the scenes that imaginary methods look at."""

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from evaluator.predictions import Float64Array, IndexArray
from evaluator.protocol import VEHICLE_LABELS
from evaluator.synthetic.cameras import Cameras
from evaluator.synthetic.file_format import AnnotatedObject, GroundTruthFile
from evaluator.synthetic.population import PROTOTYPES
from evaluator.synthetic.scenes import Boxes

_PROTOTYPE_INDEX = {prototype.name: index for index, prototype in enumerate(PROTOTYPES)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenes:
    """What stands in all images."""

    names: tuple[str, ...]
    """Image names, sorted."""
    cameras: Cameras
    boxes: Boxes
    hidden: Float64Array
    """(N,) share of each box's width that cannot be seen."""
    hidden_left: NDArray[np.bool_]
    """(N,) whether it is the left part."""
    ignore_image_index: IndexArray
    ignore_px: Float64Array
    """(R, 4) ignore regions: x, y, width, height."""


def read_scenes(files: Mapping[str, bytes]) -> Scenes:
    """Read annotation files in which every object has one of the paper's classes."""
    decoder = msgspec.json.Decoder(GroundTruthFile)
    annotations = {name.rpartition("_")[0]: decoder.decode(files[name]) for name in sorted(files)}
    images = list(annotations.values())
    objects = [annotated for image in images for annotated in image.objects]
    modal_px = _rows([annotated.boxes_2d.modal for annotated in objects], 4)
    amodal_px = _rows([annotated.boxes_2d.amodal for annotated in objects], 4)
    return Scenes(
        names=tuple(annotations),
        cameras=_cameras(images),
        boxes=_boxes(_image_index([len(image.objects) for image in images]), objects),
        hidden=1 - modal_px[:, 2] / np.maximum(amodal_px[:, 2], 1),
        hidden_left=modal_px[:, 0] > amodal_px[:, 0],
        ignore_image_index=_image_index([len(image.ignore) for image in images]),
        ignore_px=_rows([region.box_px for image in images for region in image.ignore], 4),
    )


def _cameras(images: list[GroundTruthFile]) -> Cameras:
    """Gather the cameras."""
    sensors = [image.sensor for image in images]
    return Cameras(
        _rows([(sensor.fx, sensor.fy, sensor.u0, sensor.v0) for sensor in sensors], 4),
        np.array([sensor.sensor_from_vehicle for sensor in sensors], dtype=np.float64).reshape(-1, 3, 4),
    )


def _boxes(image_index: IndexArray, objects: list[AnnotatedObject]) -> Boxes:
    """Gather the 3D boxes; a type that is not in the paper's table counts as the first."""
    prototypes = [_PROTOTYPE_INDEX.get(annotated.box_3d.type or "", 0) for annotated in objects]
    return Boxes(
        image_index=image_index,
        label_index=np.array([VEHICLE_LABELS.index(annotated.label) for annotated in objects], dtype=np.int32),
        prototype_index=np.array(prototypes, dtype=np.int32),
        center_m=_rows([annotated.box_3d.center for annotated in objects], 3),
        dimensions_m=_rows([annotated.box_3d.dimensions for annotated in objects], 3),
        rotation=_rows([annotated.box_3d.rotation for annotated in objects], 4),
    )


def _image_index(counts: list[int]) -> IndexArray:
    """Number the rows' images."""
    return np.repeat(np.arange(len(counts), dtype=np.int32), counts)


def _rows(values: list[tuple[float, ...]], columns: int) -> Float64Array:
    """Make an (N, columns) array of N rows, of none too."""
    return np.array(values, dtype=np.float64).reshape(-1, columns)
