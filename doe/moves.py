"""Straight joint moves: does the arm with what hangs on it get from one pose to another without touching anything?

The move is halved until every part of it is free for sure, or too short to matter. No point of arm or load moves more
than ``sum_j |dq_j| rho_j`` with ``rho_j`` the largest distance of anything behind joint j from its axis. Where the gap
in the middle of a part is not below half of that, the whole part is free (conservative advancement, Mirtich 1996).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from doe.gaps import Gaps, gaps_of
from identify.arrays import Floats, Ints
from identify.errors import InputError
from identify.kinematics import Frames, forward
from identify.loads import LoadCase
from identify.study import Study

__all__ = ["STEP", "free_moves"]

#: Largest motion of any point between two poses that are looked at, m; the clearance where that is larger.
STEP = 0.02

_ROUNDING = 1e-9  # m
_CHUNK = 4096  # poses at a time
_BOTH_MOVE = {"load_collision", "arm_collision"}


def free_moves(study: Study, q_from: Floats, q_to: Floats, loads: Ints | None = None) -> np.ndarray:
    """Whether straight moves in joint space keep to floor, walls, boxes, the arm and what hangs on it.

    Between two poses that are looked at no point moves more than `STEP` or the clearance, whichever is more. With a
    clearance of at least `STEP` nothing is touched on the way; without one, links may dip into an obstacle by half of
    it (hung bodies into the arm by all of it) unseen. Joint limits need no look: they hold on the way if they hold at
    both ends.

    Args:
        study: The study, with its constraints.
        q_from: (M, n) where the moves begin, rad or m; or (n,) for all of them.
        q_to: (M, n) where they end; or (n,).
        loads: (M,) index of the load that hangs on the way; None: nothing hangs.

    Returns:
        (M,) True where the move is free.

    Raises:
        InputError: Shapes do not fit.
    """
    if loads is None:
        study, loads = replace(study, loads=(LoadCase("none"),)), np.zeros(1, dtype=np.int64)
    try:
        start, end = np.broadcast_arrays(np.atleast_2d(q_from), np.atleast_2d(q_to))
        hung = np.broadcast_to(loads, len(start))
    except ValueError:
        shapes = f"{np.shape(q_from)}, {np.shape(q_to)} and {np.shape(loads)}"
        raise InputError(f"moves from, to and their loads have shapes {shapes}; needed: (M, n), (M, n), (M,)") from None
    gaps = gaps_of(study)
    length = np.abs(end - start) @ _reaches(study, np.maximum(np.abs(start), np.abs(end)).max(axis=0, initial=0.0))
    free = np.ones(len(start), dtype=bool)
    move, middle, half = (np.repeat(np.arange(len(start)), 3), np.tile([0.0, 0.5, 1.0], len(start)), 0.5)
    while len(move):
        q = start[move] + middle[:, None] * (end - start)[move]
        gap = _least(study, gaps, q, hung[move])
        free[move[gap < -_ROUNDING]] = False
        reach = length[move] * half
        inner = (middle > 0.0) & (middle < 1.0)
        open_ = inner & free[move] & (gap < reach) & (2.0 * reach > max(STEP, study.constraints.clearance))
        half /= 2.0
        move = np.repeat(move[open_], 2)
        middle = np.repeat(middle[open_], 2) + np.tile([-half, half], int(open_.sum()))
    return free


def _least(study: Study, gaps: Gaps, q: Floats, loads: Ints) -> Floats:
    """(N,) least gap of poses (N, n) with a load each (N,), m."""
    found = np.empty(len(q))
    for begin in range(0, len(q), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        found[part] = _gap(gaps, forward(study.robot, q[part]), loads[part])
    return found


def _gap(gaps: Gaps, frames: Frames, loads: Ints) -> Floats:
    """(N,) least gap; between what hangs and what moves too (links, a parked arm on shared joints) it counts half."""
    least = np.full(len(loads), np.inf)
    for reason, function in gaps.by_reason.items():
        own = function(frames)
        gap = own[:, 0] if own.shape[1] == 1 else own[np.arange(len(loads)), loads]
        least = np.minimum(least, gap / 2.0 if reason in _BOTH_MOVE else gap)
    return least


def _reaches(study: Study, largest: Floats) -> Floats:
    """(n,) largest motion of any point per unit of each joint, m per rad, or 1 where it slides; up to values (n,)."""
    robot = study.robot
    strokes = np.where(robot.prismatic, largest, 0.0)
    points = [study.markers.positions[~study.markers.on_base], *(load.attach[None] for load in study.loads)]
    tip = max(float(np.linalg.norm(points, axis=1).max(initial=0.0)) for points in points)
    lengths = np.linalg.norm(robot.placements[1:, :3, 3], axis=1) + np.append(strokes[1:], 0.0)
    lengths[-1] += tip
    reaches = np.cumsum(lengths[::-1])[::-1] + _shape_extent(study)
    return np.where(robot.prismatic, 1.0, reaches)


def _shape_extent(study: Study) -> float:
    """How far collision shapes stand out from the line of the arm, m."""
    ends = [np.linalg.norm(shape.ends, axis=1).max() + shape.radius for shape in study.robot.shapes]
    return float(max(ends, default=0.0))
