"""What hangs on the flange as upright boxes on ropes: where they are, and how far from the links."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from doe.capsules import Capsules, sample_frames
from doe.distances import segment_box_distance, segment_distance
from doe.hung_frames import attach_points
from identify.arrays import Floats, frozen
from identify.kinematics import Frames
from identify.study import Study

__all__ = ["Weights", "weights"]


@dataclass(frozen=True, eq=False)
class Weights:
    """The hung bodies of L loads; one without size is the point at the end of its rope.

    Attributes:
        attach: (L, 3) flange frame, m.
        hang: (L,) length of the rope, m.
        half: (L, 3) half sizes along the world axes, m.
        axes: (3, 3) world axes in the base frame, as columns.
        extended: (L,) True where there is a rope or a body.
        capsules: The arm.
        boxed: (L, S) True where the body is checked against a capsule.
        roped: (L, S) True where the rope is.
        always: Pairs of load and link that touch in every pose and are therefore not checked, by name.
    """

    attach: Floats
    hang: Floats
    half: Floats
    axes: Floats
    extended: np.ndarray
    capsules: Capsules
    boxed: np.ndarray
    roped: np.ndarray
    always: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("attach", "hang", "half", "axes"):
            object.__setattr__(self, key, frozen(getattr(self, key)))
        for key in ("extended", "boxed", "roped"):
            object.__setattr__(self, key, frozen(getattr(self, key), bool))

    def tops(self, frames: Frames) -> Floats:
        """(N, L, 3) attach points, base frame, m."""
        turned: Floats = attach_points(frames, self.attach) @ frames.flange_rotation.swapaxes(1, 2)
        return frames.flange_origin[:, None] + turned

    def below(self, tops: Floats, depth: Floats) -> Floats:
        """Points (N, L, 3) that hang ``depth`` (L,) below others, base frame, m."""
        lower: Floats = tops - depth[:, None] * self.axes[:, 2]
        return lower

    def centres(self, tops: Floats) -> Floats:
        """(N, L, 3) centres of the bodies, base frame, m."""
        return self.below(tops, self.hang + self.half[:, 2])

    def link_gaps(self, frames: Frames, segments: tuple[Floats, Floats], within: float) -> Floats:
        """(N, L) least distance of body and rope to the links, m; below zero where they overlap, infinite if unchecked.

        Bodies that are further off than ``within`` count by a lower bound beyond it.
        """
        gaps = np.full((len(frames.origin), len(self.attach)), np.inf)
        tops = self.tops(frames)
        centres, ends = self.centres(tops), self.below(tops, self.hang)
        for i in np.flatnonzero(self.extended).tolist():
            pairs = self._pair_gaps(i, segments, centres[:, i], tops[:, i], ends[:, i], within)
            gaps[:, i] = np.where(np.vstack([self.boxed[i], self.roped[i]]), pairs, np.inf).min(axis=(1, 2))
        return gaps

    def _pair_gaps(
        self, i: int, segments: tuple[Floats, Floats], centre: Floats, top: Floats, end: Floats, within: float = 0.0
    ) -> Floats:
        """(N, 2, S) distance of the body and of the rope of load i to each capsule, m."""
        (start, stop), radii = segments, self.capsules.radii
        middle, half_length = (start + stop) / 2, np.linalg.norm(stop - start, axis=2) / 2
        size = np.linalg.norm(self.half[i])
        body = np.linalg.norm(middle - centre[:, None], axis=2) - half_length - size - radii
        pose, near = np.nonzero((body < within) & self.boxed[i])
        p, q = ((points[pose, near] - centre[pose]) @ self.axes for points in (start, stop))
        body[pose, near] = segment_box_distance(p, q, self.half[i]) - radii[near]
        rope = segment_distance(top[:, None], end[:, None], start, stop) - radii
        return np.stack([body, rope], axis=1)


def weights(study: Study, arm: Capsules) -> Weights:
    """The hung bodies of a study.

    Pairs of body (or rope) and link that touch in every pose of a sample say nothing and are left out, and so is the
    rope with the capsule that ends at the flange, where it hangs.
    """
    loads, robot = study.loads, study.robot
    count, shapes = len(loads), len(arm.names)
    extended = np.array([load.depth > 0.0 for load in loads])
    hung = Weights(
        attach=np.array([load.attach for load in loads]),
        hang=np.array([load.hang for load in loads]),
        half=np.array([load.size / 2 for load in loads]),
        axes=robot.world_R_base.T,
        extended=extended,
        capsules=arm,
        boxed=np.ones((count, shapes), dtype=bool),
        roped=np.tile(~arm.at_flange, (count, 1)) & (np.array([load.hang for load in loads]) > 0.0)[:, None],
    )
    if not extended.any():
        return hung
    frames = sample_frames(robot)
    tops, segments = hung.tops(frames), arm.segments(frames)
    always = np.zeros((count, 2, shapes), dtype=bool)
    for i in np.flatnonzero(extended).tolist():
        pairs = hung._pair_gaps(i, segments, hung.centres(tops)[:, i], tops[:, i], hung.below(tops, hung.hang)[:, i])
        always[i] = (pairs < 0.0).all(axis=0)
    blind = np.stack([hung.boxed, hung.roped], axis=1) & always
    names = [f"{loads[i].name} and {arm.names[k]}" for i, k in np.argwhere(blind.any(axis=1)).tolist()]
    return replace(hung, boxed=hung.boxed & ~always[:, 0], roped=hung.roped & ~always[:, 1], always=tuple(names))
