"""The usual Cityscapes camera, and the 2D boxes it sees.

Frames: vehicle (ISO 8855: x forward, y left, z up, origin on the ground below the rear axle) and camera (same
directions, origin in the optical centre), both in metres.
"""

from dataclasses import dataclass

import numpy as np

from evaluator.predictions import Float64Array, IndexArray
from evaluator.projection import IMAGE_HEIGHT_PX, IMAGE_WIDTH_PX, projected_corners_px

FOCAL_LENGTH_PX = (2262.52, 2265.3017905988554)
PRINCIPAL_POINT_PX = (1096.98, 513.137)
BASELINE_M = 0.209313
MOUNTED_AT_M = (1.7, 0.1, 1.22)
MOUNTED_DOWN_RAD = 0.038
MOUNTED_LEFT_RAD = 0.0195


@dataclass(frozen=True, slots=True)
class Cameras:
    """One camera per image."""

    intrinsics_px: Float64Array
    """(I, 4) fx, fy, u0, v0."""
    sensor_from_vehicle: Float64Array
    """(I, 3, 4) vehicle frame to camera frame."""

    def __getitem__(self, image_index: IndexArray) -> "Cameras":
        """Pick one camera per row of `image_index`."""
        return Cameras(self.intrinsics_px[image_index], self.sensor_from_vehicle[image_index])

    @property
    def position_m(self) -> Float64Array:
        """(I, 3) optical centres in the vehicle frame."""
        rotation = self.sensor_from_vehicle[:, :, :3]
        position_m: Float64Array = -np.einsum("nji,nj->ni", rotation, self.sensor_from_vehicle[:, :, 3])
        return position_m


def draw_cameras(rng: np.random.Generator, images: int) -> Cameras:
    """Draw one slightly different calibration per image around the usual one."""
    intrinsics_px = np.tile(np.array([*FOCAL_LENGTH_PX, *PRINCIPAL_POINT_PX]), (images, 1))
    intrinsics_px[:, 0] += rng.choice((0.0, 1.5), size=images)
    down = MOUNTED_DOWN_RAD + rng.normal(0, 0.001, images)
    left = MOUNTED_LEFT_RAD + rng.normal(0, 0.002, images)
    rotation = _camera_rotation(down, left)
    position_m = np.array(MOUNTED_AT_M) + rng.normal(0, 0.005, (images, 3))
    translation = -np.einsum("nij,nj->ni", rotation, position_m)
    return Cameras(intrinsics_px, np.concatenate([rotation, translation[:, :, None]], axis=2))


def _camera_rotation(down_rad: Float64Array, left_rad: Float64Array) -> Float64Array:
    """Build (I, 3, 3) rotations vehicle -> camera of cameras that look `down` and `left` of straight ahead."""
    sd, cd, sl, cl = np.sin(down_rad), np.cos(down_rad), np.sin(left_rad), np.cos(left_rad)
    zero = np.zeros_like(sd)
    rows = [[cd * cl, -cd * sl, -sd], [sl, cl, zero], [sd * cl, -sd * sl, cd]]
    return np.moveaxis(np.array(rows), 2, 0)


def quaternions(yaw_rad: Float64Array, pitch_rad: Float64Array, roll_rad: Float64Array) -> Float64Array:
    """Turn ISO 8855 yaw, pitch, roll (applied in the order roll, pitch, yaw) into (N, 4) quaternions w, x, y, z."""
    sy, cy = np.sin(yaw_rad / 2), np.cos(yaw_rad / 2)
    sp, cp = np.sin(pitch_rad / 2), np.cos(pitch_rad / 2)
    sr, cr = np.sin(roll_rad / 2), np.cos(roll_rad / 2)
    return np.stack(
        [
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
        ],
        axis=1,
    )


def multiply(first: Float64Array, second: Float64Array) -> Float64Array:
    """Multiply (N, 4) quaternions: turn by `second`, then by `first`."""
    w, x, y, z = first.T
    a, b, c, d = second.T
    return np.stack(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ],
        axis=1,
    )


@dataclass(frozen=True, slots=True)
class View:
    """What a camera sees of boxes."""

    full_px: Float64Array
    """(N, 4) x1, y1, x2, y2 of the whole projected box, beyond the image's edges too."""
    clipped_px: Float64Array
    """(N, 4) the same within the image: the amodal box."""

    @property
    def truncation(self) -> Float64Array:
        """(N,) share of the projected box outside the image, in [0, 1]; 1 for a box behind the camera."""
        return 1 - area_px(self.clipped_px) / np.maximum(area_px(self.full_px), 1e-9)


def area_px(corners_px: Float64Array) -> Float64Array:
    """Return the (N,) areas of boxes given as x1, y1, x2, y2."""
    return (corners_px[:, 2] - corners_px[:, 0]) * (corners_px[:, 3] - corners_px[:, 1])


def view(cameras: Cameras, center_m: Float64Array, dimensions_m: Float64Array, rotation: Float64Array) -> View:
    """Project boxes into their images.

    Args:
        cameras: One per box.
        center_m: (N, 3) centres in the vehicle frame.
        dimensions_m: (N, 3) length, width, height.
        rotation: (N, 4) quaternions w, x, y, z in the vehicle frame.
    """
    full_px = projected_corners_px(
        center_m,
        dimensions_m,
        rotation,
        intrinsics_px=cameras.intrinsics_px,
        sensor_from_vehicle=cameras.sensor_from_vehicle,
        camera_index=np.arange(len(center_m), dtype=np.int32),
        clip=False,
    ).T
    edges_px = np.array([IMAGE_WIDTH_PX, IMAGE_HEIGHT_PX, IMAGE_WIDTH_PX, IMAGE_HEIGHT_PX]) - 1.0
    return View(full_px, np.clip(full_px, 0, edges_px))
