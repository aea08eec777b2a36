"""Distances of segments, boxes and rays, many at once; a capsule is a segment less its radius."""

from __future__ import annotations

from itertools import product

import numpy as np

from identify.arrays import Floats
from identify.springs import cross

__all__ = [
    "box_distance",
    "box_gap_axes",
    "crosses_box",
    "point_box_distance",
    "segment_box_distance",
    "segment_distance",
]

_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))  # of a box of half size 1
_EDGES = tuple(
    np.array([np.insert(side, axis, end) for axis in range(3) for side in product((-1.0, 1.0), repeat=2)])
    for end in (-1.0, 1.0)
)  # their ends
_PARALLEL = 1e-9  # sine of the angle below which two edges give no axis of their own


def segment_distance(p1: Floats, q1: Floats, p2: Floats, q2: Floats) -> Floats:
    """Distance between segments ``p1 q1`` and ``p2 q2``, (..., 3) each -> (...), m; segments may be points.

    Source: Ericson, Real-Time Collision Detection (2005), section 5.1.9: the best s on the first line, clamped, then
    the best t for it, clamped, then the best s for that. Here the last step is always taken, which needs no branch.
    """
    d1, d2, r = q1 - p1, q2 - p2, p1 - p2
    a, b, e = _dot(d1, d1), _dot(d1, d2), _dot(d2, d2)
    c, f = _dot(d1, r), _dot(d2, r)
    determinant = a * e - b * b
    parallel = determinant <= 1e-12 * a * e
    s = np.where(parallel, 0.0, (b * f - c * e) / np.where(parallel, 1.0, determinant)).clip(0.0, 1.0)
    t = ((b * s + f) / np.where(e > 0.0, e, 1.0)).clip(0.0, 1.0)
    s = ((b * t - c) / np.where(a > 0.0, a, 1.0)).clip(0.0, 1.0)
    gap = r + s[..., None] * d1 - t[..., None] * d2
    return np.asarray(np.sqrt(_dot(gap, gap)))


def point_box_distance(points: Floats, half: Floats) -> Floats:
    """Distance (...) of points (..., 3), in a box's own frame, to a box of half size ``half`` (3,), m; 0 inside."""
    beyond = points - np.clip(points, -half, half)
    return np.asarray(np.sqrt(_dot(beyond, beyond)))


def segment_box_distance(p: Floats, q: Floats, half: Floats) -> Floats:
    """Distance (...) of segments ``p q``, (..., 3) each in a box's own frame, to the box, m; 0 where they meet.

    The squared distance along the segment is convex and quadratic between the (at most six) places where the
    segment passes a plane of the box. Its slope is piecewise linear and rises, so its zero is found exactly.
    """
    d = q - p
    safe = np.where(d == 0.0, 1.0, d)
    passes = np.concatenate([(half - p) / safe, (-half - p) / safe], axis=-1).clip(0.0, 1.0)
    ends = np.broadcast_to([0.0, 1.0], (*passes.shape[:-1], 2))
    t = np.sort(np.concatenate([passes, ends], axis=-1), axis=-1)
    x = p[..., None, :] + t[..., None] * d[..., None, :]
    slope = np.einsum("...ki,...i->...k", x - np.clip(x, -half, half), d)
    k = np.clip((slope <= 0.0).sum(axis=-1), 1, t.shape[-1] - 1)[..., None]
    (t0, s0), (t1, s1) = ([np.take_along_axis(array, at, axis=-1)[..., 0] for array in (t, slope)] for at in (k - 1, k))
    rise = s1 - s0
    share = np.where(rise > 0.0, -s0 / np.where(rise > 0.0, rise, 1.0), 0.0).clip(0.0, 1.0)
    best = t0 + share * (t1 - t0)
    return point_box_distance(p + best[..., None] * d, half)


def crosses_box(p: Floats, q: Floats, half: Floats) -> np.ndarray:
    """(...) True where segments ``p q``, (..., 3) each in a box's own frame, meet the box (slab method)."""
    d = q - p
    still = np.abs(d) < 1e-12
    safe = np.where(still, 1.0, d)
    first, second = (-half - p) / safe, (half - p) / safe
    enter = np.where(still, -np.inf, np.minimum(first, second))
    leave = np.where(still, np.inf, np.maximum(first, second))
    outside = (still & (np.abs(p) > half)).any(axis=-1)
    enters, leaves = enter.max(axis=-1).clip(0.0), leave.min(axis=-1).clip(None, 1.0)
    return np.asarray((enters <= leaves) & ~outside)


def box_gap_axes(first: Floats, first_half: Floats, second: Floats, second_half: Floats) -> tuple[Floats, Floats]:
    """What two boxes of fixed orientation are separated by (separating axes, Gottschalk 1996).

    For centres at c1 and c2 the gap is ``max_k |(c1 - c2) . axis_k| - reach_k``: negative if and only if the boxes
    overlap, and never more than their distance.

    Args:
        first: (3, 3) axes of one box as columns.
        first_half: (3,) half its size, m.
        second: (3, 3) axes of the other one.
        second_half: (3,) half its size, m.

    Returns:
        (k, 3) axes and (k,) reaches, m.
    """
    edges = cross(first.T[:, None], second.T[None]).reshape(-1, 3)
    length = np.linalg.norm(edges, axis=1)
    edges = edges[length > _PARALLEL] / length[length > _PARALLEL, None]
    axes = np.vstack([first.T, second.T, edges])
    return axes, np.abs(axes @ first) @ first_half + np.abs(axes @ second) @ second_half


def box_distance(offsets: Floats, first: Floats, first_half: Floats, second: Floats, second_half: Floats) -> Floats:
    """Distance of two boxes of fixed orientation that do not overlap, m, for N offsets of their centres.

    The nearest points lie on an edge of the first box, or one of them is a corner of the second one.

    Args:
        offsets: (N, 3) centre of the first box less that of the second one.
        first: (3, 3) axes of the first box as columns.
        first_half: (3,) half its size, m.
        second: (3, 3) axes of the other one.
        second_half: (3,) half its size, m.

    Returns:
        (N,); 0 where they touch.
    """
    start, end = ((offsets[:, None] + points * first_half @ first.T) @ second for points in _EDGES)
    corners = (_CORNERS * second_half @ second.T - offsets[:, None]) @ first
    edges = segment_box_distance(start, end, second_half).min(axis=1)
    return np.asarray(np.minimum(edges, point_box_distance(corners, first_half).min(axis=1)))


def _dot(x: Floats, y: Floats) -> Floats:
    """Scalar product over the last axis."""
    return np.asarray(np.einsum("...i,...i->...", x, y))
