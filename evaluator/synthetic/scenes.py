"""Boxes placed on the road: visible, not degenerate, apart from each other."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evaluator.predictions import Float64Array, IndexArray
from evaluator.synthetic.cameras import Cameras, quaternions, view
from evaluator.synthetic.population import PROTOTYPE_DIMENSIONS_M, draw_distances_m, draw_prototypes

SMALLEST_SIDE_PX = 8.0
"""Annotators leave out what is smaller; also, a box rounded to whole pixels still overlaps itself by more than 0.7."""

MOST_TRUNCATED = 0.6
"""Beyond this the labelers annotate no box (paper, section Labeling Process)."""

HALF_FIELD_OF_VIEW_RAD = 0.44
ROAD_HALF_WIDTH_M = 14.0
CROSSING_SHARE = 0.2
"""Vehicles that stand or drive across the road; the others follow it, in either direction."""

_PLACEMENTS = 60
"""How often a box that cannot be seen or stands in another one is placed anew before it is left out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Boxes:
    """Boxes in the vehicle frame, ordered by image."""

    image_index: IndexArray
    label_index: IndexArray
    prototype_index: IndexArray
    center_m: Float64Array
    dimensions_m: Float64Array
    rotation: Float64Array

    def __len__(self) -> int:
        """Count the boxes."""
        return len(self.image_index)

    def __getitem__(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> "Boxes":
        """Pick rows."""
        return Boxes(
            image_index=self.image_index[rows],
            label_index=self.label_index[rows],
            prototype_index=self.prototype_index[rows],
            center_m=self.center_m[rows],
            dimensions_m=self.dimensions_m[rows],
            rotation=self.rotation[rows],
        )


def populate(
    rng: np.random.Generator, cameras: Cameras, image_index: IndexArray, label_index: IndexArray, *, apart: bool = True
) -> Boxes:
    """Place one box per row where the row's camera sees it; `apart`: no two boxes of an image in one place.

    The few that find no place are left out.
    """
    boxes = _draw(rng, image_index, label_index)
    rows = np.arange(len(boxes))
    for _ in range(_PLACEMENTS):
        rows = rows[_unseen(cameras, boxes[rows])]
        if apart:
            rows = np.union1d(rows, np.flatnonzero(_standing_in_another(boxes)))
        if not len(rows):
            return boxes
        boxes = _put(boxes, rows, _draw(rng, image_index[rows], label_index[rows]))
    return boxes[np.setdiff1d(np.arange(len(boxes)), rows)]


def _draw(rng: np.random.Generator, image_index: IndexArray, label_index: IndexArray) -> Boxes:
    """Draw a type, a size, a place and a heading for each row."""
    count = len(label_index)
    prototype_index = draw_prototypes(rng, label_index)
    dimensions_m = PROTOTYPE_DIMENSIONS_M[prototype_index] * rng.normal(1, 0.04, (count, 3)).clip(0.85, 1.15)
    pitch_rad = rng.normal(0, 0.012, count)
    return Boxes(
        image_index=image_index,
        label_index=label_index,
        prototype_index=prototype_index,
        center_m=_places_m(rng, dimensions_m[:, 2], pitch_rad),
        dimensions_m=dimensions_m,
        rotation=quaternions(_headings_rad(rng, count), pitch_rad, rng.normal(0, 0.008, count)),
    )


def _places_m(rng: np.random.Generator, height_m: Float64Array, pitch_rad: Float64Array) -> Float64Array:
    """Draw centres on a slightly hilly road within the field of view."""
    distance_m = draw_distances_m(rng, len(height_m))
    widest_rad = np.minimum(HALF_FIELD_OF_VIEW_RAD, np.arcsin(np.minimum(ROAD_HALF_WIDTH_M / distance_m, 1)))
    bearing_rad = widest_rad * rng.uniform(-1, 1, len(height_m))
    rise_m = distance_m * (rng.normal(0, 0.004, len(height_m)) - 0.2 * pitch_rad)
    return np.stack([distance_m * np.cos(bearing_rad), distance_m * np.sin(bearing_rad), height_m / 2 + rise_m], axis=1)


def _headings_rad(rng: np.random.Generator, count: int) -> Float64Array:
    """Draw yaw angles: along the road in either direction, some across it."""
    along = rng.choice((0.0, np.pi), size=count, p=(0.6, 0.4)) + rng.normal(0, 0.08, count)
    across = rng.choice((-1.0, 1.0), size=count) * rng.normal(np.pi / 2, 0.3, count)
    return np.where(rng.random(count) < CROSSING_SHARE, across, along)


def _put(boxes: Boxes, rows: NDArray[np.integer], redrawn: Boxes) -> Boxes:
    """Replace some rows' type, size and pose."""
    changed = {}
    for name in ("prototype_index", "center_m", "dimensions_m", "rotation"):
        values = getattr(boxes, name).copy()
        values[rows] = getattr(redrawn, name)
        changed[name] = values
    return replace(boxes, **changed)


def _unseen(cameras: Cameras, boxes: Boxes) -> NDArray[np.bool_]:
    """Mark the boxes that are too small or too far outside their image to be annotated; one at the camera is too."""
    seen = view(cameras[boxes.image_index], boxes.center_m, boxes.dimensions_m, boxes.rotation)
    sides_px = seen.clipped_px[:, 2:] - seen.clipped_px[:, :2]
    small: NDArray[np.bool_] = sides_px.min(axis=1) < SMALLEST_SIDE_PX
    return small | (seen.truncation > MOST_TRUNCATED)


def _standing_in_another(boxes: Boxes) -> NDArray[np.bool_]:
    """Mark the later of every two boxes of an image whose centres are closer than half their mean length."""
    marked = np.zeros(len(boxes), dtype=bool)
    most = int(np.bincount(boxes.image_index).max(initial=1))
    for step in range(1, most):  # every pair `step` rows apart at once
        same = boxes.image_index[step:] == boxes.image_index[:-step]
        gap_m = np.linalg.norm(boxes.center_m[step:, :2] - boxes.center_m[:-step, :2], axis=1)
        reach_m = (boxes.dimensions_m[step:, 0] + boxes.dimensions_m[:-step, 0]) / 4
        marked[step:] |= same & (gap_m < reach_m)
    return marked
