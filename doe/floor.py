"""The floor: which points of the arm must stay above it, and how high they are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, Ints, frozen
from identify.kinematics import Frames
from identify.loads import LoadCase
from identify.robot import Robot
from identify.study import Study

__all__ = ["FloorPoints", "floor_points", "load_points"]

_STILL = 1e-4  # m: a height that changes by less does not depend on the joints (files round angles to 1e-5 or so)
_NO_JOINTS = frozen([], np.int64)


@dataclass(frozen=True, eq=False)
class FloorPoints:
    """Points of the arm that must stay above the floor and whose height depends on the joints.

    Attributes:
        joints: (J,) joints whose origin counts.
        local: (P, 3) points in the flange frame, m: flange origin, flange markers, attach points.
        below: (P,) how far something hangs below each of these points, m.
    """

    joints: Ints
    local: Floats
    below: Floats

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        object.__setattr__(self, "joints", frozen(self.joints, np.int64))
        for key in ("local", "below"):
            object.__setattr__(self, key, frozen(getattr(self, key)))

    def heights(self, frames: Frames, local: Floats | None = None) -> Floats:
        """World heights from the base origin, of the lowest that hangs there.

        Args:
            frames: N poses.
            local: (N, P, 3) other points of each pose in place of those of the flange frame, m.

        Returns:
            (N, J + P) m.
        """
        up = frames.robot.world_R_base[2]
        up_in_flange = np.einsum("i,vij->vj", up, frames.flange_rotation)
        raised = up_in_flange @ self.local.T if local is None else np.einsum("vj,vpj->vp", up_in_flange, local)
        flange = (frames.flange_origin @ up)[:, None] + raised - self.below
        return np.concatenate([frames.origin[:, self.joints] @ up, flange], axis=1)


def floor_points(study: Study, loads: Iterable[int] = ()) -> FloorPoints:
    """Points that must stay above the floor, without those whose height no joint can change.

    Args:
        study: The study.
        loads: Indices of the loads of a visit.

    Returns:
        Joint origins, flange origin, flange markers and attach points, in this order.
    """
    robot, markers = study.robot, study.markers
    moved = [_moves(spread, robot.placements[i, :3, 3]) for i, spread in enumerate(_height_spreads(robot))]
    hung = [study.loads[i] for i in loads]
    local = np.vstack([np.zeros((1, 3)), markers.positions[~markers.on_base], *(load.attach for load in hung)])
    below = np.append(np.zeros(len(local) - len(hung)), [load.depth for load in hung])
    return _rising(robot, np.flatnonzero(moved[: robot.n]), local, below)


def load_points(robot: Robot, load: LoadCase) -> FloorPoints:
    """The same for one load alone: its attach point, if its height varies."""
    return _rising(robot, _NO_JOINTS, load.attach[None], np.array([load.depth]))


def _rising(robot: Robot, joints: Ints, local: Floats, below: Floats) -> FloorPoints:
    """Those points (P, 3) of the flange frame whose height depends on the joints."""
    *_, spread = _height_spreads(robot)
    flange = robot.placements[robot.n]
    points = local @ flange[:3, :3].T + flange[:3, 3]
    kept = [_moves(spread, point) for point in points]
    return FloorPoints(joints, local[kept], below[kept])


def _moves(spread: Floats, point: Floats) -> bool:
    """True if the height of a point (3,) depends on the joints, see `_height_spreads`."""
    return bool(np.linalg.norm(spread @ np.append(point, 1.0)) > _STILL)


def _height_spreads(robot: Robot) -> Iterator[Floats]:
    """For each placement, how the heights of points depend on the joints before it.

    The height of a point x of the moved frame of joint i - 1 is ``w(q) . (x, 1)`` with a row w of four numbers. Every
    joint multiplies it by ``K + cos(q) C + sin(q) S`` (or ``I + q E`` where it slides). The joints are independent and
    1, cos, sin are too, so all ``w(q) - w(0)`` together span the products with C, S and those of the span before with
    K, C, S. The height is constant exactly if (x, 1) is orthogonal to that span: no sample of poses is needed.

    Yields:
        (at most 4, 4) rows that span it; their products with (x, 1) are about the amplitudes of the height, m.
    """
    along, across, quarter, shift = np.zeros((4, 4, 4))
    along[[2, 3], [2, 3]] = across[[0, 1], [0, 1]] = shift[2, 3] = quarter[1, 0] = 1.0
    quarter[0, 1] = -1.0
    row, spread = np.append(robot.world_R_base[2], 0.0)[None], np.zeros((0, 4))
    for placement, slides in zip(robot.placements, [*robot.prismatic, False], strict=True):
        yield spread
        row, spread = row @ placement, spread @ placement
        if slides:
            spread = np.vstack([spread, spread @ shift, row @ shift])
        else:
            spread = np.vstack([spread @ along, spread @ across, spread @ quarter, row @ across, row @ quarter])
        _, sizes, directions = np.linalg.svd(spread, full_matrices=False)
        spread = sizes[:, None] * directions
