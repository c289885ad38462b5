"""3D boxes to amodal boxes in the image."""

import numpy as np
import pytest

from evaluator.orientation import rotation_matrices, yaw_pitch_roll_rad
from evaluator.projection import projected_corners_px

FX = FY = 1000.0
U0, V0 = 1024.0, 512.0


def _project(center: list[float], dimensions: list[float], rotation: list[float]) -> list[float]:
    """Project one box into a camera at the origin that looks along x."""
    boxes = projected_corners_px(
        np.array([center]),
        np.array([dimensions]),
        np.array([rotation]),
        intrinsics_px=np.array([[FX, FY, U0, V0]]),
        sensor_from_vehicle=np.eye(3, 4)[None],
        camera_index=np.zeros(1, dtype=np.int32),
    )
    return [float(value) for value in boxes[:, 0]]


def test_a_box_straight_ahead_is_as_large_as_its_near_face() -> None:
    """The near face is at 12 - 4 / 2 = 10 m: half a width of 1 m is 1000 / 10 = 100 px, half a height of 0.5 m 50 px."""
    assert _project([12, 0, 0], [4, 2, 1], [1, 0, 0, 0]) == pytest.approx([924, 462, 1124, 562])


def test_left_and_up_in_the_vehicle_are_left_and_up_in_the_image() -> None:
    """A flat box at 10 m, 1 m to the left and 2 m up: centre at u = 1024 - 100, v = 512 - 200."""
    x_min, y_min, x_max, y_max = _project([10, 1, 2], [1e-9, 0.2, 0.2], [1, 0, 0, 0])

    assert ((x_min + x_max) / 2, (y_min + y_max) / 2) == pytest.approx((924, 312))


def test_a_quarter_turn_exchanges_length_and_width() -> None:
    """Turned by 90 degrees about z, a box of 4 x 2 m looks like one of 2 x 4 m."""
    half = np.sqrt(0.5)

    assert _project([12, 0, 0], [4, 2, 1], [half, 0, 0, half]) == pytest.approx(
        _project([12, 0, 0], [2, 4, 1], [1, 0, 0, 0])
    )


def test_a_box_around_the_camera_fills_the_image() -> None:
    """Its faces are cut 1 cm in front of the camera, far outside the image on all sides."""
    assert _project([0, 0, 0], [4, 2, 2], [1, 0, 0, 0]) == [0, 0, 2047, 1023]


def test_a_cut_box_is_limited_where_its_edges_cross_the_near_plane() -> None:
    """A box from x = -1 to 1, 4 to 6 m to the left: at 1 m its right side is at u = 1024 - 4000 < 0, all off the image."""
    x_min, y_min, x_max, y_max = _project([0, 5, 0], [2, 2, 2], [1, 0, 0, 0])

    assert (x_min, x_max) == (0, 0)
    assert (y_min, y_max) == (0, 1023)


def test_a_box_behind_the_camera_is_all_zeros() -> None:
    """The reference's answer for what cannot be seen."""
    assert _project([-10, 0, 0], [4, 2, 1], [1, 0, 0, 0]) == [0, 0, 0, 0]


def test_a_box_beside_the_image_collapses_to_its_border() -> None:
    """Its clipped box has no width, but is still a box."""
    x_min, _, x_max, _ = _project([10, 50, 0], [4, 2, 1], [1, 0, 0, 0])

    assert (x_min, x_max) == (0, 0)


def test_no_boxes_give_no_boxes() -> None:
    """Empty in, empty out."""
    boxes = projected_corners_px(
        np.zeros((0, 3)),
        np.zeros((0, 3)),
        np.zeros((0, 4)),
        intrinsics_px=np.ones((1, 4)),
        sensor_from_vehicle=np.eye(3, 4)[None],
        camera_index=np.zeros(0, dtype=np.int32),
    )

    assert boxes.shape == (4, 0)


def test_quaternions_of_any_length_and_sign_turn_alike() -> None:
    """q, -q and 3 q give the same matrix and the same angles."""
    rotation = np.array([[0.9, 0.1, -0.2, 0.3]]) * np.array([[1], [-1], [3]])

    for found in (rotation_matrices(rotation), yaw_pitch_roll_rad(rotation)):
        assert found[..., 1] == pytest.approx(found[..., 0])
        assert found[..., 2] == pytest.approx(found[..., 0])


def test_angles_are_those_of_roll_after_pitch_after_yaw() -> None:
    """A turn of Rz(.4) Ry(.3) Rx(.2) gives yaw .3564, pitch .3513, roll .0748 in this order, not .4, .3, .2."""
    yaw, pitch, roll = 0.2, 0.15, 0.1
    quaternion = [
        np.cos(yaw) * np.cos(pitch) * np.cos(roll) + np.sin(yaw) * np.sin(pitch) * np.sin(roll),
        np.cos(yaw) * np.cos(pitch) * np.sin(roll) - np.sin(yaw) * np.sin(pitch) * np.cos(roll),
        np.cos(yaw) * np.sin(pitch) * np.cos(roll) + np.sin(yaw) * np.cos(pitch) * np.sin(roll),
        np.sin(yaw) * np.cos(pitch) * np.cos(roll) - np.cos(yaw) * np.sin(pitch) * np.sin(roll),
    ]

    assert yaw_pitch_roll_rad(np.array([quaternion]))[:, 0] == pytest.approx([0.3564, 0.3513, 0.0748], abs=1e-4)


def test_a_pitch_of_90_degrees_is_a_number() -> None:
    """Rounding takes the sine above 1, where the reference gives NaN."""
    rotation = np.array([[0.7071067811865477, 0.0, 0.7071067811865477, 0.0]])

    assert yaw_pitch_roll_rad(rotation)[1, 0] == pytest.approx(np.pi / 2)
