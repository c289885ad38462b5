"""What stands in an image: how many objects of which class, type, size and distance (paper, Dataset Analysis)."""

from dataclasses import dataclass

import numpy as np

from evaluator.predictions import Float64Array, IndexArray
from evaluator.protocol import VEHICLE_LABELS


@dataclass(frozen=True, slots=True)
class Prototype:
    """One row of the paper's table of size prototypes, with how often it is drawn within its class."""

    name: str
    label: str
    height_m: float
    width_m: float
    length_m: float
    weight: float


PROTOTYPES = (
    Prototype("Mini Car", "car", 1.45, 1.65, 2.70, 0.02),
    Prototype("Small Car", "car", 1.45, 1.65, 4.00, 0.17),
    Prototype("Compact Car", "car", 1.45, 1.80, 4.30, 0.21),
    Prototype("Sedan", "car", 1.45, 1.81, 4.70, 0.19),
    Prototype("Station Wagon", "car", 1.50, 1.85, 4.90, 0.16),
    Prototype("Box Wagon", "car", 1.80, 1.80, 4.35, 0.07),
    Prototype("Sports Utility Vehicle", "car", 1.70, 1.90, 4.70, 0.08),
    Prototype("Pick-Up", "car", 1.80, 1.92, 5.30, 0.01),
    Prototype("Sports Car", "car", 1.30, 1.81, 4.13, 0.02),
    Prototype("Small Van", "car", 1.90, 1.90, 5.40, 0.04),
    Prototype("Large Van", "car", 2.60, 1.85, 6.50, 0.03),
    Prototype("Caravan", "caravan", 3.00, 2.20, 7.20, 1.0),
    Prototype("Mini Truck", "truck", 3.00, 2.20, 7.00, 0.3),
    Prototype("Small Truck", "truck", 3.45, 2.32, 7.95, 0.3),
    Prototype("Medium Truck", "truck", 4.00, 2.50, 12.00, 0.2),
    Prototype("Large Truck", "truck", 4.00, 2.55, 6.80, 0.2),
    Prototype("Truck Trailer", "trailer", 4.00, 2.55, 13.60, 1.0),
    Prototype("Urban Bus (Solo)", "bus", 3.10, 2.55, 12.00, 0.5),
    Prototype("Urban Bus (Front)", "bus", 3.10, 2.55, 7.40, 0.15),
    Prototype("Urban Bus (Back)", "bus", 3.10, 2.55, 7.40, 0.15),
    Prototype("Coach Bus", "bus", 3.80, 2.55, 14.00, 0.2),
    # The paper's table names no prototype for trains; this is one unit of a tram.
    Prototype("Train", "train", 3.40, 2.40, 18.00, 1.0),
    Prototype("Bicycle", "bicycle", 1.10, 0.42, 1.80, 1.0),
    Prototype("Motorbike", "motorcycle", 1.12, 0.80, 2.20, 1.0),
)

OBJECTS_PER_IMAGE = {
    "car": 6.44,
    "truck": 0.12,
    "bus": 0.08,
    "train": 0.04,
    "motorcycle": 0.23,
    "bicycle": 1.24,
    "caravan": 0.03,
    "trailer": 0.04,
}
"""Means: the paper's table of annotations per image (car 6.4; truck, bus and train together 0.2; bicycle 1.2;
motorbike 0.2) with one digit more, so that 1525 images hold about the data set's number; the last two are rare."""

CROWDING_SHAPE = 1.6
"""Counts vary more than Poisson's: each image's rate is gamma distributed with this shape, scaled to mean 1."""

MEDIAN_DISTANCE_M = 36.5
DISTANCE_SPREAD = 0.755
"""Log-normal distances: 90 % below exp(ln 36.5 + 1.2816 * 0.755) = 96 m, and about 100 m once boxes that
no camera would see are placed anew (paper, section Benchmark Metrics)."""

NEAREST_M = 4.0
FARTHEST_M = 250.0

PROTOTYPE_DIMENSIONS_M: Float64Array = np.array([(p.length_m, p.width_m, p.height_m) for p in PROTOTYPES])


def draw_labels(rng: np.random.Generator, images: int) -> tuple[IndexArray, IndexArray]:
    """Draw which objects stand in each image.

    Returns:
        (N,) ascending image indices and (N,) indices into `VEHICLE_LABELS`.
    """
    crowding = rng.gamma(CROWDING_SHAPE, size=images)
    crowding /= crowding.mean() if images else 1.0
    means = np.array([OBJECTS_PER_IMAGE[label] for label in VEHICLE_LABELS])
    counts = rng.poisson(crowding[:, None] * means)
    image_index = np.repeat(np.arange(images, dtype=np.int32), counts.sum(axis=1))
    label_index = np.repeat(np.tile(np.arange(len(means), dtype=np.int32), images), counts.ravel())
    return image_index, label_index


def draw_prototypes(rng: np.random.Generator, label_index: IndexArray) -> IndexArray:
    """Draw a size prototype of each object's class: (N,) indices into `PROTOTYPES`."""
    chosen = np.zeros(len(label_index), dtype=np.int32)
    for index, label in enumerate(VEHICLE_LABELS):
        rows = np.flatnonzero(label_index == index)
        options = [number for number, prototype in enumerate(PROTOTYPES) if prototype.label == label]
        weights = np.array([PROTOTYPES[number].weight for number in options])
        chosen[rows] = rng.choice(options, size=len(rows), p=weights / weights.sum())
    return chosen


def draw_distances_m(rng: np.random.Generator, count: int) -> Float64Array:
    """Draw (N,) distances on the ground plane from the rear axle, in [NEAREST_M, FARTHEST_M)."""
    distances = MEDIAN_DISTANCE_M * np.exp(DISTANCE_SPREAD * rng.standard_normal(count))
    while (outside := (distances < NEAREST_M) | (distances >= FARTHEST_M)).any():
        redrawn = rng.standard_normal(int(outside.sum()))
        distances[outside] = MEDIAN_DISTANCE_M * np.exp(DISTANCE_SPREAD * redrawn)
    return distances
