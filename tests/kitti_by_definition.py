"""KITTI's 3D measures computed once more, independently and slowly: plain loops, no arrays, no geometry package.

Source: the object development kit (`evaluate_object.cpp`), `computeStatistics` with `compute_fp`: at every score the
ground-truth boxes, in the order of the file, each take the active detection with the greatest overlap that is still
free. Instead of the kit's 41 sampled scores every distinct score is taken, which is the definition of AP|R40.
"""

from collections.abc import Collection, Sequence
from math import atan2, cos, sin

from tests.array_factories import Box

Point = tuple[float, float]
RECALL_POSITIONS = 40


def kitti_scores(truth: Sequence[Box], found: Sequence[Box], labels: Sequence[str]) -> dict[str, float]:
    """Return AP_BEV and AP_3D of each class with ground truth at both overlaps, without ignore regions."""
    scores = {
        f"kitti/{label}/{name}@{min_iou}": kitti_ap(
            [box for box in truth if box.label == label],
            [box for box in found if box.label == label],
            min_iou,
            volume=name == "ap_3d",
        )
        for label in labels
        for name in ("ap_bev", "ap_3d")
        for min_iou in (0.7, 0.5)
    }
    return {name: ap for name, ap in scores.items() if ap is not None}


def kitti_ap(
    truth: Sequence[Box], found: Sequence[Box], min_iou: float, *, volume: bool, excused: Collection[int] = ()
) -> float | None:
    """Return AP_BEV or AP_3D (`volume`) at 40 recalls of boxes that are all of one class.

    Args:
        truth: Ground truth in the order of the files.
        found: Predictions.
        min_iou: A match needs more.
        volume: Measure overlap in space, not from above.
        excused: Which of `found`, by position, are no false positives when they are not matched.
    """
    if not truth:
        return None
    overlap = [[_iou(box, seen, volume=volume) if box.image == seen.image else 0.0 for seen in found] for box in truth]
    curve = []
    for score in {box.score for box in found}:
        active = {index for index, box in enumerate(found) if box.score >= score}
        free = set(active)
        for of_box in overlap:
            best = max(free, key=lambda index: of_box[index], default=None)
            if best is not None and of_box[best] > min_iou:
                free.remove(best)
        hits = len(active) - len(free)
        wrong = len(free.difference(excused))
        curve.append((hits, hits / (hits + wrong) if hits else 0.0))
    best_precisions = (
        max((precision for hits, precision in curve if hits * RECALL_POSITIONS >= k * len(truth)), default=0.0)
        for k in range(1, RECALL_POSITIONS + 1)
    )
    return sum(best_precisions) / RECALL_POSITIONS


def _iou(first: Box, second: Box, *, volume: bool) -> float:
    """Return the overlap from above, or in space."""
    common = _area(_clipped(_footprint(first), _footprint(second)))
    sizes = [box.dimensions[0] * box.dimensions[1] for box in (first, second)]
    if volume:
        top = min(box.center[2] + box.dimensions[2] / 2 for box in (first, second))
        bottom = max(box.center[2] - box.dimensions[2] / 2 for box in (first, second))
        common *= max(top - bottom, 0.0)
        sizes = [size * box.dimensions[2] for size, box in zip(sizes, (first, second), strict=True)]
    return common / (sum(sizes) - common)


def _footprint(box: Box) -> list[Point]:
    """Return the corners on the ground plane, counter-clockwise; pitch and roll are dropped."""
    w, x, y, z = box.quaternion()
    yaw = atan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z)
    length, width, _ = box.dimensions
    corners = [(length / 2, width / 2), (-length / 2, width / 2), (-length / 2, -width / 2), (length / 2, -width / 2)]
    return [
        (box.center[0] + a * cos(yaw) - b * sin(yaw), box.center[1] + a * sin(yaw) + b * cos(yaw)) for a, b in corners
    ]


def _clipped(polygon: list[Point], window: list[Point]) -> list[Point]:
    """Cut a polygon by the edges of a convex one (Sutherland and Hodgman 1974)."""
    for start, end in zip(window, window[1:] + window[:1], strict=True):
        sides = [_side(start, end, point) for point in polygon]
        kept: list[Point] = []
        for index, point in enumerate(polygon):
            here, before, last = sides[index], sides[index - 1], polygon[index - 1]
            if here * before < 0:
                share = before / (before - here)
                kept.append((last[0] + share * (point[0] - last[0]), last[1] + share * (point[1] - last[1])))
            if here >= 0:
                kept.append(point)
        polygon = kept
    return polygon


def _side(start: Point, end: Point, point: Point) -> float:
    """Tell on which side of a line a point is: positive to the left."""
    return (end[0] - start[0]) * (point[1] - start[1]) - (end[1] - start[1]) * (point[0] - start[0])


def _area(polygon: list[Point]) -> float:
    """Return the area of a polygon (shoelace formula)."""
    shifted = polygon[1:] + polygon[:1]
    return abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(polygon, shifted, strict=True))) / 2
