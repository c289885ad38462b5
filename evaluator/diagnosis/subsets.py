"""Recall and errors of kinds of objects: how hidden, how small, how crowded, what type, where in the image.

Each grouping puts every ground-truth box of the evaluated classes into exactly one subset, so the counts of a grouping
sum up to all boxes. Subsets without a box are left out. Recall is at the working point.
"""

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from evaluator.candidates import pairs_within_groups
from evaluator.diagnosis.errors import ErrorSummary, PairErrors, summarize_errors
from evaluator.diagnosis.working_point import BoolArray, WorkingPoint
from evaluator.ground_truth import GroundTruth
from evaluator.overlap import corners_px, intersections_px
from evaluator.predictions import Float64Array
from evaluator.projection import IMAGE_WIDTH_PX

SubsetArray = NDArray[np.intp]


class Subset(msgspec.Struct, frozen=True, kw_only=True):
    """One kind of object."""

    name: str
    ground_truth_count: int
    """At least 1."""
    found_count: int
    recall: float
    """found / ground truth, in [0, 1], greater is better."""
    errors: ErrorSummary
    """Of the objects found."""


class Grouping(msgspec.Struct, frozen=True, kw_only=True):
    """All objects, sorted by one property."""

    name: str
    """occlusion, truncation, prototype, image_region, box_height or crowding."""
    subsets: tuple[Subset, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Membership:
    """Which subset of a grouping each of M ground-truth boxes is in."""

    name: str
    subset_names: tuple[str, ...]
    subset: SubsetArray
    """(M,) index into `subset_names`."""


def memberships(ground_truth: GroundTruth) -> tuple[Membership, ...]:
    """Sort all ground-truth boxes by each property; it does not depend on any submission."""
    return (
        _by_share("occlusion", ground_truth.occlusion),
        _by_share("truncation", ground_truth.truncation),
        _by_prototype(ground_truth),
        _by_image_region(ground_truth),
        _by_box_height(ground_truth),
        _by_crowding(ground_truth),
    )


def group(membership: Membership, point: WorkingPoint, errors: PairErrors, class_index: int | None) -> Grouping:
    """Measure recall and errors of every subset, for one class or for all evaluated classes (None)."""
    chosen = point.ground_truth_class >= 0 if class_index is None else point.ground_truth_class == class_index
    pair_chosen = chosen[point.pair_ground_truth]
    pair_subset = membership.subset[point.pair_ground_truth]
    subsets = tuple(
        _measure(name, inside, point, errors.take(pair_chosen & (pair_subset == index)))
        for index, name in enumerate(membership.subset_names)
        for inside in [chosen & (membership.subset == index)]
        if inside.any()
    )
    return Grouping(name=membership.name, subsets=subsets)


def _measure(name: str, inside: BoolArray, point: WorkingPoint, errors: PairErrors) -> Subset:
    """Count one subset, which is not empty."""
    count, found = int(inside.sum()), int(point.found[inside].sum())
    return Subset(
        name=name,
        ground_truth_count=count,
        found_count=found,
        recall=found / count,
        errors=summarize_errors(errors),
    )


def _by_share(name: str, share: Float64Array) -> Membership:
    """Sort by occlusion or truncation, which annotators give in steps of 10 %."""
    edges = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0]) + 1e-9  # a step's own value belongs below it
    subset = np.where(np.isnan(share), len(edges), np.minimum(np.searchsorted(edges, share), len(edges) - 1))
    return Membership(
        name=name, subset_names=("0 %", "1-20 %", "21-40 %", "41-60 %", "61-80 %", "81-100 %", "unknown"), subset=subset
    )


def _by_prototype(ground_truth: GroundTruth) -> Membership:
    """Sort by the size prototype the annotator started from (paper, table of size prototypes)."""
    names = (*ground_truth.prototypes, "unknown")
    index = ground_truth.prototype_index.astype(np.intp)
    return Membership(name="prototype", subset_names=names, subset=np.where(index < 0, len(names) - 1, index))


def _by_image_region(ground_truth: GroundTruth) -> Membership:
    """Sort by the third of the image that holds the middle of the amodal box."""
    middle = ground_truth.amodal_px[:, 0] + ground_truth.amodal_px[:, 2] / 2
    edges = np.array([IMAGE_WIDTH_PX / 3, IMAGE_WIDTH_PX * 2 / 3])
    return Membership(
        name="image_region",
        subset_names=("left", "middle", "right"),
        subset=np.searchsorted(edges, middle, side="right"),
    )


def _by_box_height(ground_truth: GroundTruth) -> Membership:
    """Sort by the height of the amodal box in pixels."""
    edges = np.array([25.0, 50.0, 100.0, 200.0])
    names = ("below 25 px", "25-50 px", "50-100 px", "100-200 px", "200 px and more")
    return Membership(
        name="box_height",
        subset_names=names,
        subset=np.searchsorted(edges, ground_truth.amodal_px[:, 3], side="right"),
    )


def _by_crowding(ground_truth: GroundTruth) -> Membership:
    """Sort by how many other annotated boxes, of any class, share a pixel with the amodal box."""
    boxes = corners_px(ground_truth.amodal_px)
    image = ground_truth.image_index.astype(np.int64)
    neighbours = np.zeros(len(ground_truth), dtype=np.intp)
    for first, second in pairs_within_groups(image, image):
        touching = (intersections_px(boxes[:, first], boxes[:, second]) > 0) & (first != second)
        neighbours += np.bincount(first[touching], minlength=len(neighbours))
    names = ("alone", "1 neighbour", "2 neighbours", "3 and more")
    return Membership(name="crowding", subset_names=names, subset=np.minimum(neighbours, len(names) - 1))
