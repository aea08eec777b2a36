"""Homogeneous placements and rotations of robot files: exact at right angles."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from identify.arrays import Floats

__all__ = ["axis_frame", "roll_pitch_yaw", "rotation", "translation"]


def translation(xyz: ArrayLike) -> Floats:
    """Homogeneous (4, 4) shift by ``xyz`` (3,), m."""
    matrix: Floats = np.eye(4)
    matrix[:3, 3] = xyz
    return matrix


def rotation(axis: str, angle_deg: float) -> Floats:
    """Homogeneous (4, 4) turn about the ``x``, ``y`` or ``z`` axis by ``angle_deg``, deg (as files state it)."""
    quarter, rest = divmod(math.fmod(angle_deg, 360.0), 90.0)
    if rest == 0.0:
        c, s = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)][int(quarter) % 4]
    else:
        c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    first = {"x": 1, "y": 2, "z": 0}[axis]
    second = (first + 1) % 3
    matrix: Floats = np.eye(4)
    matrix[first, first] = matrix[second, second] = c
    matrix[second, first], matrix[first, second] = s, -s
    return matrix


def roll_pitch_yaw(angles: ArrayLike) -> Floats:
    """(3, 3) turn ``Rz(yaw) Ry(pitch) Rx(roll)``, as in URDF; ``angles`` (3,) roll, pitch, yaw, rad."""
    roll, pitch, yaw = np.degrees(np.asarray(angles, dtype=np.float64))
    return (rotation("z", yaw) @ rotation("y", pitch) @ rotation("x", roll))[:3, :3]


def axis_frame(axis: ArrayLike) -> Floats:
    """Homogeneous (4, 4) turn whose z axis points along ``axis`` (3,); the identity for z itself."""
    z = np.asarray(axis, dtype=np.float64)
    z = z / np.linalg.norm(z)
    x = np.eye(3)[np.argmin(np.abs(z))]
    x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    matrix: Floats = np.eye(4)
    matrix[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    return matrix
