"""Rotations of many poses at once: the nearest one, how it turns, vectors, quaternions."""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats
from identify.springs import cross

__all__ = ["nearest_rotations", "pose_errors", "quaternions", "rotation_vectors", "turn_rates"]

_TOLERANCE = 1e-15
_MAX_STEPS = 20


def nearest_rotations(matrices: Floats) -> Floats:
    """Orthogonal polar factor of matrices (T, 3, 3) that are near a rotation.

    Newton's iteration ``X <- (X + X^-T) / 2``, which doubles the digits in each step (Higham, SIAM J. Sci. Stat.
    Comput. 7(4), 1160-1174, 1986).
    """
    current = matrices
    for _ in range(_MAX_STEPS):
        change = 0.5 * (_inverse_transposed(current) - current)
        current = current + change
        if not np.abs(change).max(initial=0.0) > _TOLERANCE:
            break
    return current


def _inverse_transposed(matrices: Floats) -> Floats:
    """``X^-T`` of (T, 3, 3): the cofactors over the determinant."""
    a, b, c = matrices[..., 0], matrices[..., 1], matrices[..., 2]
    cofactors = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=-1)
    determinant = (a * cofactors[..., 0]).sum(axis=-1)
    return np.asarray(cofactors / determinant[..., None, None])


def turn_rates(matrices: Floats, rotations: Floats, rates: Floats) -> Floats:
    """How the nearest rotation turns when the matrix changes.

    With ``A = R P``, ``S = R P R'`` and ``M = dA R'``, the turn w solves ``(tr(S) - S) w = vee(M - M')``.

    Args:
        matrices: (T, 3, 3) A.
        rotations: (T, 3, 3) R, see `nearest_rotations`.
        rates: (T, 3, 3, p) dA per unit of p unknowns.

    Returns:
        (T, 3, p) rotation vectors, rad per unit, in the frame that A maps to.
    """
    stretch = matrices @ rotations.swapaxes(1, 2)
    moved = np.einsum("tijp,tkj->tikp", rates, rotations, optimize=True)
    odd = moved - moved.swapaxes(1, 2)
    vee = np.stack([odd[:, 2, 1], odd[:, 0, 2], odd[:, 1, 0]], axis=1)
    system = np.trace(stretch, axis1=1, axis2=2)[:, None, None] * np.eye(3) - stretch
    turned: Floats = np.linalg.solve(system, vee)
    return turned


def rotation_vectors(rotations: Floats) -> Floats:
    """Rotation vectors (T, 3), rad, of rotations (T, 3, 3)."""
    from scipy.spatial.transform import Rotation

    vectors: Floats = Rotation.from_matrix(rotations).as_rotvec()
    return vectors


def quaternions(rotations: Floats) -> Floats:
    """Unit quaternions (T, 4) w, x, y, z with w >= 0 of rotations (T, 3, 3)."""
    from scipy.spatial.transform import Rotation

    units: Floats = Rotation.from_matrix(rotations).as_quat(canonical=True)[:, [3, 0, 1, 2]]
    return units


def pose_errors(poses: Floats, wished: Floats) -> Floats:
    """Position and turn (T, 6), m and rad, by which poses (T, 4, 4) differ from wished ones, in their common frame."""
    turn = poses[:, :3, :3] @ wished[:, :3, :3].swapaxes(1, 2)
    return np.hstack([poses[:, :3, 3] - wished[:, :3, 3], rotation_vectors(turn)])
