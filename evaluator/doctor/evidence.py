"""What the convention doctor looks at: plausible boxes with their cameras, and how well 2D and 3D fit together."""

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from evaluator.ground_truth import GroundTruth, ImageList
from evaluator.predictions import Float64Array, Predictions
from evaluator.projection import projected_corners_px
from evaluator.value_ranges import BOX_LIMIT_PX, CENTER_LIMIT_M, DIMENSION_RANGE_M, ROTATION_NORM_RANGE

Cameras = ImageList | GroundTruth
"""Either tells the images and their cameras."""

MOST_BOXES = 1000
"""Looked at; evenly spread over the submission. More would not make the medians better."""
FEWEST_BOXES = 20
"""With fewer nothing is concluded."""
_SMALLEST_AREA_PX = 100.0
"""2D boxes below say nothing: rounding to pixels already moves them."""


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """N boxes, N possibly 0, layout as in `Predictions`, each with its own camera."""

    label: NDArray[np.str_]
    """(N,)"""
    center_m: Float64Array
    dimensions_m: Float64Array
    rotation: Float64Array
    """(N, 4), not normalised."""
    amodal_px: Float64Array
    modal_px: Float64Array
    intrinsics_px: Float64Array
    """(N, 4), or (0, 4) when the cameras are unknown."""
    sensor_from_vehicle: Float64Array
    """(N, 3, 4), or (0, 3, 4) when the cameras are unknown."""

    def __len__(self) -> int:
        """Count the boxes."""
        return len(self.center_m)

    @classmethod
    def joined(cls, first: Self, second: Self) -> Self:
        """Put the boxes of one after those of the other."""
        both = ((field.name, getattr(first, field.name), getattr(second, field.name)) for field in fields(cls))
        return cls(**{name: np.concatenate(parts) for name, *parts in both})

    @property
    def has_cameras(self) -> bool:
        """Tell whether boxes can be projected."""
        return len(self) > 0 and len(self.intrinsics_px) == len(self)

    def with_boxes(
        self,
        *,
        center_m: Float64Array | None = None,
        dimensions_m: Float64Array | None = None,
        rotation: Float64Array | None = None,
        amodal_px: Float64Array | None = None,
    ) -> Self:
        """Put other values in place."""
        return replace(
            self,
            center_m=self.center_m if center_m is None else center_m,
            dimensions_m=self.dimensions_m if dimensions_m is None else dimensions_m,
            rotation=self.rotation if rotation is None else rotation,
            amodal_px=self.amodal_px if amodal_px is None else amodal_px,
        )

    @cached_property
    def overlaps(self) -> Float64Array:
        """How each projected 3D box agrees with its submitted amodal box.

        IoU in [0, 1], greater is better; only of the boxes large enough to tell, (K,) with K <= N, and of none when
        the cameras are unknown.
        """
        if not self.has_cameras:
            return np.empty(0)
        large = (self.amodal_px[:, 2] * self.amodal_px[:, 3] > _SMALLEST_AREA_PX) & (self.amodal_px[:, 2:] > 0).all(1)
        projected = projected_corners_px(
            self.center_m[large],
            self.dimensions_m[large],
            self.rotation[large],
            intrinsics_px=self.intrinsics_px[large],
            sensor_from_vehicle=self.sensor_from_vehicle[large],
            camera_index=np.arange(large.sum(), dtype=np.int32),
        )
        corner, size = self.amodal_px[large, :2].T, self.amodal_px[large, 2:].T
        return _iou(projected, np.concatenate([corner, corner + size]))


def _iou(first: Float64Array, second: Float64Array) -> Float64Array:
    """Intersection over union of boxes given as (4, N) corners; 0 for two boxes without area."""
    common = np.clip(np.minimum(first[2:], second[2:]) - np.maximum(first[:2], second[:2]), 0.0, None).prod(axis=0)
    union = (first[2:] - first[:2]).prod(axis=0) + (second[2:] - second[:2]).prod(axis=0) - common
    iou: Float64Array = np.divide(common, union, out=np.zeros_like(common), where=union > 0.0)
    return iou


@np.errstate(all="ignore")
def gather_evidence(predictions: Predictions, images: Cameras | None, *, before: int = 0, after: int = 0) -> Evidence:
    """Take a sample of the boxes whose values are plausible each by itself.

    The samples of the parts of a submission, joined, are the sample of the whole.

    Args:
        predictions: all boxes that could be read, of a submission with errors, too; or a part of them.
        images: cameras, where known.
        before: how many boxes the submission has before this part.
        after: how many behind it.
    """
    step = max(1, (before + len(predictions) + after) // MOST_BOXES)
    sampled = np.arange(-before % step, len(predictions), step)
    chosen = sampled[_plausible(predictions, sampled)]
    image = predictions.image_index[chosen]
    known = images is not None and len(images.intrinsics_px) == len(predictions.images) > 0
    intrinsics = np.asarray(images.intrinsics_px if images is not None and known else ()).reshape(-1, 4)
    sensors = np.asarray(images.sensor_from_vehicle if images is not None and known else ()).reshape(-1, 3, 4)
    return Evidence(
        label=np.array((*predictions.labels, ""))[predictions.label_index[chosen]],
        center_m=predictions.center_m[chosen],
        dimensions_m=predictions.dimensions_m[chosen],
        rotation=predictions.rotation[chosen],
        amodal_px=predictions.amodal_px[chosen],
        modal_px=predictions.modal_px[chosen],
        intrinsics_px=intrinsics[image] if known else intrinsics,
        sensor_from_vehicle=sensors[image] if known else sensors,
    )


def _plausible(boxes: Predictions, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Find those of some boxes with which one can calculate; scores and off-unit quaternions do not matter."""
    norm = np.linalg.norm(boxes.rotation[rows], axis=1)
    dimensions = boxes.dimensions_m[rows]
    fine: NDArray[np.bool_] = (norm > ROTATION_NORM_RANGE[0]) & (norm < ROTATION_NORM_RANGE[1])
    fine &= (np.abs(boxes.center_m[rows]) <= CENTER_LIMIT_M).all(axis=1)
    fine &= ((dimensions >= DIMENSION_RANGE_M[0]) & (dimensions <= DIMENSION_RANGE_M[1])).all(axis=1)
    for box_px in (boxes.amodal_px[rows], boxes.modal_px[rows]):
        fine &= (np.abs(box_px) <= BOX_LIMIT_PX).all(axis=1)
    return fine
