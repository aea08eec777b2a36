"""Rotations of many poses at once as vectors and quaternions, and how far poses are apart."""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats

__all__ = ["matrices_of", "pose_errors", "quaternions", "rotation_vectors"]


def matrices_of(units: Floats) -> Floats:
    """Rotations (T, 3, 3) of unit quaternions (T, 4) w, x, y, z."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(units, scalar_first=True).as_matrix()).reshape(-1, 3, 3)


def rotation_vectors(rotations: Floats) -> Floats:
    """Rotation vectors (T, 3), rad, of rotations (T, 3, 3)."""
    from scipy.spatial.transform import Rotation

    if not len(rotations):
        return np.zeros((0, 3))
    return np.asarray(Rotation.from_matrix(rotations).as_rotvec())


def quaternions(rotations: Floats) -> Floats:
    """Unit quaternions (T, 4) w, x, y, z with w >= 0 of rotations (T, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotations).as_quat(canonical=True, scalar_first=True))


def pose_errors(poses: Floats, wished: Floats) -> Floats:
    """Position and turn (T, 6), m and rad, by which poses (T, 4, 4) differ from wished ones, in their common frame."""
    turn = poses[:, :3, :3] @ wished[:, :3, :3].swapaxes(1, 2)
    return np.hstack([poses[:, :3, 3] - wished[:, :3, 3], rotation_vectors(turn)])
