"""Rigid alignment of two point sets, insensitive to a few bad points."""

from __future__ import annotations

import numpy as np

from identify.arrays import Floats

__all__ = ["align", "inverse"]


def align(source: Floats, target: Floats, *, rounds: int = 10) -> Floats:
    """Placement T (4, 4) with ``target ~ T source``; points (R, 3), m.

    Least squares (Kabsch 1976), reweighted towards least absolute distances so that a few gross errors
    do not turn the frame.
    """
    weights = np.ones(len(source))
    placement = np.eye(4)
    for _ in range(rounds):
        placement = _kabsch(source, target, weights)
        distance = np.linalg.norm(source @ placement[:3, :3].T + placement[:3, 3] - target, axis=1)
        weights = 1.0 / np.maximum(distance, np.median(distance) + 1e-12)
    return placement


def _kabsch(source: Floats, target: Floats, weights: Floats) -> Floats:
    """Weighted least-squares placement."""
    share = weights / weights.sum()
    middle, goal = share @ source, share @ target
    left, _, right = np.linalg.svd((share[:, None] * (source - middle)).T @ (target - goal))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    placement = np.eye(4)
    placement[:3, :3] = (left @ flip @ right).T
    placement[:3, 3] = goal - placement[:3, :3] @ middle
    return placement


def inverse(placement: Floats) -> Floats:
    """Inverse of rigid placements (..., 4, 4)."""
    back = np.zeros_like(placement)
    back[..., :3, :3] = placement[..., :3, :3].swapaxes(-1, -2)
    back[..., :3, 3] = -(back[..., :3, :3] @ placement[..., :3, 3, None])[..., 0]
    back[..., 3, 3] = 1.0
    return back
