"""Small helpers for arrays that records hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Floats", "Ints", "frozen", "rotation_of", "skew"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def frozen(values: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """Copy ``values`` into a read-only array of ``dtype``, any shape."""
    array = np.array(values, dtype=dtype)
    array.setflags(write=False)
    return array


def skew(vectors: Floats) -> Floats:
    """Matrices ``[v]x`` with ``[v]x w = v x w``; ``vectors`` (..., 3) -> (..., 3, 3)."""
    matrices = np.zeros((*vectors.shape, 3))
    for x, (y, z) in enumerate(((1, 2), (2, 0), (0, 1))):
        matrices[..., z, y] = vectors[..., x]
        matrices[..., y, z] = -vectors[..., x]
    return matrices


def rotation_of(vector: Floats) -> Floats:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), rad (Rodrigues)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    cross = skew(vector)
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    matrix: Floats = np.eye(3) + first * cross + second * cross @ cross
    return matrix
