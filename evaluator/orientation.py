"""Quaternions to rotation matrices and angles, as the reference's `pyquaternion` does it.

The angles are those of a rotation R = Rx(roll) Ry(pitch) Rz(yaw). That is not the ISO order (Rz Ry Rx);
the protocol keeps it because both sides of every comparison are measured with it.
"""

import numpy as np

from evaluator.predictions import Float64Array

UNIT_TOLERANCE = 1e-14
"""A quaternion whose squared length is this close to 1 is taken as it is (`Quaternion.is_unit`)."""


def unit_quaternions(rotation: Float64Array) -> Float64Array:
    """Scale quaternions to length 1.

    Args:
        rotation: (N, 4) quaternions w, x, y, z.

    Returns:
        (4, N) unit quaternions, one row for each of w, x, y, z. q, -q and k q describe the same rotation. Zeros stay
        zeros (`Quaternion._normalise`), which makes a point of a box, and angles of 0.
    """
    columns = np.ascontiguousarray(rotation.T)
    w, x, y, z = columns
    squared = w * w + x * x + y * y + z * z
    length = np.where((np.abs(1.0 - squared) < UNIT_TOLERANCE) | (squared == 0.0), 1.0, np.sqrt(squared))
    return np.asarray(columns / length)


def rotation_matrices(rotation: Float64Array) -> Float64Array:
    """Turn quaternions into rotation matrices (`Quaternion.rotation_matrix`).

    Args:
        rotation: (N, 4) quaternions w, x, y, z of any length.

    Returns:
        (3, 3, N) matrices from the box frame to the vehicle frame.
    """
    w, x, y, z = unit_quaternions(rotation)
    return np.array(
        [
            [x * x + w * w - z * z - y * y, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), y * y - z * z + w * w - x * x, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), z * z - y * y - x * x + w * w],
        ]
    )


def yaw_pitch_roll_rad(rotation: Float64Array) -> Float64Array:
    """Turn quaternions into angles (`Quaternion.yaw_pitch_roll`).

    A pitch of 90 degrees, where rounding takes the sine above 1, is pitch 90 degrees; the reference gives NaN.

    Args:
        rotation: (N, 4) quaternions w, x, y, z of any length.

    Returns:
        (3, N) yaw in [-pi, pi], pitch in [-pi/2, pi/2], roll in [-pi, pi].
    """
    w, x, y, z = unit_quaternions(rotation)
    yaw = np.arctan2(2 * (w * z - x * y), 1 - 2 * (y * y + z * z))
    pitch = np.arcsin(np.clip(2 * (w * y + z * x), -1.0, 1.0))
    roll = np.arctan2(2 * (w * x - y * z), 1 - 2 * (x * x + y * y))
    return np.stack([yaw, pitch, roll])
