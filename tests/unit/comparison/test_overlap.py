"""Bird's-eye-view and volume IoU of pairs of boxes, worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from evaluator.comparison.boxes import Boxes
from evaluator.comparison.overlap import footprint_corners, may_overlap, overlaps


def box(x: float = 0.0, y: float = 0.0, z: float = 0.0, *, yaw: float = 0.0, length: float = 4.0) -> Boxes:
    """Return one box, 2 m wide and 1.5 m high."""
    return Boxes(
        image_index=np.zeros(1, dtype=np.int64),
        center_m=np.array([[x, y, z]]),
        dimensions_m=np.array([[length, 2.0, 1.5]]),
        yaw_rad=np.array([yaw]),
    )


def test_length_lies_along_the_heading() -> None:
    """A box that looks left has its 4 m along y."""
    corners = footprint_corners(box(yaw=np.pi / 2))[0]
    assert np.abs(corners).max(axis=0) == pytest.approx([1.0, 2.0])


@pytest.mark.parametrize(
    ("other", "bev", "volume"),
    [
        (box(), 1.0, 1.0),
        (box(x=1.0), 0.6, 0.6),  # 3 x 2 common of 8 + 8 - 6
        (box(z=0.5), 1.0, 0.5),  # heights share 1 of 1.5 m: 8 / (12 + 12 - 8)
        (box(yaw=np.pi / 2), 1 / 3, 1 / 3),  # 2 x 2 common of 8 + 8 - 4
        (box(yaw=np.pi), 1.0, 1.0),  # the overlap does not know front from back
        (box(x=3.99, y=1.99), 0.01 * 0.01 / (16 - 0.0001), 0.01 * 0.01 / (16 - 0.0001)),
        (box(z=2.0), 1.0, 0.0),
    ],
)
def test_overlap_by_hand(other: Boxes, bev: float, volume: float) -> None:
    """Both overlaps agree with paper and pencil, in either order."""
    assert np.stack(overlaps(box(), other)) == pytest.approx(np.array([[bev], [volume]]))
    assert np.stack(overlaps(other, box())) == pytest.approx(np.array([[bev], [volume]]))


@pytest.mark.parametrize("move_m", [0.0, 1e-16, 1e-15, 1e-14, 1e-13, 1e-9])
def test_boxes_that_differ_by_rounding_overlap_wholly(move_m: float) -> None:
    """Moving a box by less than anybody measures leaves its overlap with itself at 1, wherever it stands."""
    rng, count = np.random.default_rng(0), 8_000
    boxes = Boxes(
        image_index=np.zeros(count, dtype=np.int64),
        center_m=rng.uniform(-100, 100, (count, 3)),
        dimensions_m=rng.uniform((1, 0.5, 1), (12, 3, 4), (count, 3)),
        yaw_rad=rng.uniform(-np.pi, np.pi, count),
    )
    moved = replace(boxes, center_m=boxes.center_m + rng.normal(0, move_m, (count, 3)))
    assert np.stack(overlaps(boxes, moved)).min() > 1 - 1e-7


def test_far_and_flat_boxes_cannot_overlap() -> None:
    """The cheap test refuses boxes whose circles are apart, and boxes with a side that is not positive."""
    # half diagonals are sqrt(20) / 2 = 2.236 each
    assert may_overlap(box(), box(x=4.4)).all()
    assert not may_overlap(box(), box(x=4.5)).any()
    assert not may_overlap(box(), box(length=0.0)).any()
    assert not may_overlap(box(length=-4.0), box()).any()


def test_no_pairs_give_no_overlaps() -> None:
    """Empty in, empty out."""
    none = box().take(np.empty(0, dtype=np.int64))
    bev, volume = overlaps(none, none)
    assert len(bev) == len(volume) == 0
