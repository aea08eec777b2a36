"""How far the arm and what hangs on it stay from floor, walls, boxes and itself, many poses at once.

All gaps are lower bounds of a distance, less what must be kept, in m: negative where a constraint is broken and only
there. What moves as a rigid body through a space where its gap is g may move by g before anything can touch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from doe.capsules import Capsules, capsules
from doe.distances import box_distance, box_gap_axes, point_box_distance, segment_box_distance
from doe.floor import FloorPoints, floor_points, load_points
from doe.hung_frames import HungFrames
from doe.parked import Parked, parked
from doe.weights import Weights, weights
from identify.arrays import Floats
from identify.cell import Box, Wall
from identify.kinematics import Frames
from identify.study import Study

__all__ = ["Gaps", "gaps_of"]


@dataclass(frozen=True, eq=False)
class Gaps:
    """The geometry of a cell, in base axes.

    Attributes:
        floor: World height of the floor from the base origin, m; None: no floor.
        arm: Points of the arm above the floor, without the loads.
        attached: For each of L loads, its points above the floor.
        capsules: The arm's capsules.
        weights: What hangs on the flange.
        markers: (M, 3) markers on the flange, flange frame, m.
        walls: Walls.
        boxes: Boxes.
        clearance: Distance kept to walls and boxes, and by weights to the arm, m.
        parked: Another arm that stands beside, or None.
    """

    floor: float | None
    arm: FloorPoints
    attached: tuple[FloorPoints, ...]
    capsules: Capsules
    weights: Weights
    markers: Floats
    walls: tuple[Wall, ...]
    boxes: tuple[Box, ...]
    clearance: float
    parked: Parked | None = None

    @property
    def always(self) -> tuple[str, ...]:
        """Pairs that touch in every pose and are not checked, by name."""
        return (*self.capsules.always, *self.weights.always, *(self.parked.always if self.parked else ()))

    @property
    def by_reason(self) -> Mapping[str, Callable[[Frames], Floats]]:
        """Reason -> function of N poses to gaps (N, L), or (N, 1) where the load does not matter."""
        return {
            "floor": self.to_floor,
            "walls": self.to_walls,
            "boxes": self.to_boxes,
            "self_collision": self.between_links,
            "load_collision": self.weights_to_links,
            "arm_collision": self.to_parked,
        }

    def to_floor(self, frames: Frames) -> Floats:
        """(N, L) height above the floor of the lowest point of arm and load."""
        if self.floor is None:
            return _open(frames)
        heights = (self.arm.heights(frames), *self._hung_heights(frames))
        lowest = [points.min(axis=1, initial=np.inf) for points in heights]
        return np.asarray(np.minimum(np.array(lowest[1:]), lowest[0]).T - self.floor)

    def _hung_heights(self, frames: Frames) -> list[Floats]:
        """For each load, (N, P) world heights of its points, m."""
        if not isinstance(frames, HungFrames):
            return [points.heights(frames) for points in self.attached]
        points = zip(self.attached, np.moveaxis(frames.hung.attach[:, :, None], 1, 0), strict=True)
        return [stated.heights(frames, own[:, : len(stated.local)]) for stated, own in points]

    def to_walls(self, frames: Frames) -> Floats:
        """(N, L) distance in front of the nearest wall, of capsules that move, flange markers, ropes and bodies."""
        if not self.walls:
            return _open(frames)
        points, radii = self._arm_points(frames)
        tops = self.weights.tops(frames)
        centres = self.weights.centres(tops)
        gap = np.full(tops.shape[:2], np.inf)
        for wall in self.walls:
            arm = (wall.heights(points) - radii).min(axis=1, initial=np.inf)
            reach = self.weights.half @ np.abs(wall.normal @ self.weights.axes)
            hung = np.minimum(wall.heights(tops), wall.heights(centres) - reach)
            gap = np.minimum(gap, np.minimum(arm[:, None], hung))
        return gap - self.clearance

    def _arm_points(self, frames: Frames) -> tuple[Floats, Floats]:
        """Ends of moving capsules and flange markers (N, P, 3), base frame, and their radii (P,), m."""
        start, end = self.capsules.segments(frames)
        moving = self.capsules.moving
        points = np.concatenate([start[:, moving], end[:, moving], self._marker_points(frames)], axis=1)
        return points, np.append(np.tile(self.capsules.radii[moving], 2), np.zeros(len(self.markers)))

    def _marker_points(self, frames: Frames) -> Floats:
        """(N, M, 3) markers on the flange, base frame, m."""
        turned: Floats = np.einsum("vij,mj->vmi", frames.flange_rotation, self.markers)
        return frames.flange_origin[:, None] + turned

    def to_boxes(self, frames: Frames) -> Floats:
        """(N, L) distance to the nearest box, of capsules that move, flange markers, ropes and bodies."""
        if not self.boxes:
            return _open(frames)
        start, end = (ends[:, self.capsules.moving] for ends in self.capsules.segments(frames))
        radii, points = self.capsules.radii[self.capsules.moving], self._marker_points(frames)
        tops = self.weights.tops(frames)
        gap = np.full(tops.shape[:2], np.inf)
        for box in self.boxes:
            links = _segments_to_box(start, end, radii, box, self.clearance).min(axis=1, initial=np.inf)
            arm = np.minimum(links, point_box_distance(box.local(points), box.half).min(axis=1, initial=np.inf))
            gap = np.minimum(gap, np.minimum(arm[:, None], self._hung_to_box(tops, box)))
        return gap - self.clearance

    def _hung_to_box(self, tops: Floats, box: Box) -> Floats:
        """(N, L) distance of ropes and bodies to a box, m; of those further off than the clearance a lower bound."""
        hung = self.weights
        ends, centres = hung.below(tops, hung.hang), hung.centres(tops)
        gap = _segments_to_box(tops, ends, np.zeros(len(hung.hang)), box, self.clearance)
        for i in np.flatnonzero(hung.extended):
            axes, reach = box_gap_axes(box.rotation, box.half, hung.axes, hung.half[i])
            offset = centres[:, i] - box.centre
            body = (np.abs(offset @ axes.T) - reach).max(axis=1)
            near = (body >= 0.0) & (body < self.clearance)  # beside edges and corners the true distance is larger
            body[near] = box_distance(offset[near], hung.axes, hung.half[i], box.rotation, box.half)
            gap[:, i] = np.minimum(gap[:, i], body)
        return gap

    def between_links(self, frames: Frames) -> Floats:
        """(N, 1) least distance of links that are no neighbours."""
        if not self.capsules.first.size:
            return _open(frames)
        return np.asarray(self.capsules.gaps(frames).min(axis=1, keepdims=True))

    def weights_to_links(self, frames: Frames) -> Floats:
        """(N, L) least distance of hung bodies and ropes to the links."""
        if not self.weights.extended.any():
            return _open(frames)
        return self.weights.link_gaps(frames, self.capsules.segments(frames), self.clearance) - self.clearance

    def to_parked(self, frames: Frames) -> Floats:
        """(N, L) distance of the arm with each load to another one that is parked."""
        return _open(frames) if self.parked is None else self.parked.gaps(frames)


def gaps_of(study: Study) -> Gaps:
    """The geometry of a study's cell."""
    robot, constraints, arm = study.robot, study.constraints, capsules(study)
    hung = weights(study, arm)
    return Gaps(
        floor=constraints.floor,
        arm=floor_points(study),
        attached=tuple(load_points(robot, load) for load in study.loads),
        capsules=arm,
        weights=hung,
        markers=study.markers.positions[~study.markers.on_base],
        walls=tuple(wall.seen_from(robot.world_R_base) for wall in constraints.walls),
        boxes=tuple(box.seen_from(robot.world_R_base) for box in constraints.boxes),
        clearance=constraints.clearance,
        parked=parked(study, arm, hung),
    )


def _open(frames: Frames) -> Floats:
    """(N, 1) infinite: nothing is in the way."""
    return np.full((len(frames.origin), 1), np.inf)


def _segments_to_box(start: Floats, end: Floats, radii: Floats, box: Box, within: float) -> Floats:
    """(N, S) distance of capsules to a box, m; of those further off than ``within`` a lower bound beyond it."""
    half_length = np.linalg.norm(end - start, axis=2) / 2
    gap = np.linalg.norm((start + end) / 2 - box.centre, axis=2) - half_length - np.linalg.norm(box.half)
    near = gap < radii + within
    gap[near] = segment_box_distance(box.local(start[near]), box.local(end[near]), box.half)
    return np.asarray(gap - radii)
