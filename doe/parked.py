"""Another arm that stands at its home pose, unloaded, while this one is measured.

Where both arms have their first joints in common, the parked arm turns with them: it rides on the joint frame of the
measured arm behind the last shared joint, and so does everything about it. Without shared joints it stands still.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from doe.capsules import Capsules, capsules, sample_frames
from doe.distances import segment_distance
from doe.weights import Weights
from identify.arrays import Floats, Ints, frozen
from identify.cell import Neighbour
from identify.kinematics import Frames, forward
from identify.study import Study

__all__ = ["Parked", "parked"]


@dataclass(frozen=True, eq=False)
class Parked:
    """The parked arm as S capsules, and the arm that is measured.

    Attributes:
        frame: Joint frame of the measured arm that they ride on.
        start: (S, 3) their beginnings in this frame, m.
        end: (S, 3) their ends, m.
        radii: (S,) m.
        arm: The capsules of the measured arm.
        first: (K,) capsule of the measured arm of each checked pair.
        second: (K,) capsule of the parked one.
        hung: What hangs on the measured arm, with the parked arm in place of its own links.
        clearance: Distance that both keep, m.
        always: Pairs that touch in every pose and are therefore not checked, by name.
    """

    frame: int
    start: Floats
    end: Floats
    radii: Floats
    arm: Capsules
    first: Ints
    second: Ints
    hung: Weights
    clearance: float
    always: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("start", "end", "radii"):
            object.__setattr__(self, key, frozen(getattr(self, key)))
        for key in ("first", "second"):
            object.__setattr__(self, key, frozen(getattr(self, key), np.int64))

    def gaps(self, frames: Frames) -> Floats:
        """(N, L) distance of the measured arm with each load to the parked one, less the clearance, m."""
        links = self.link_gaps(frames).min(axis=1, initial=np.inf)
        hung = self.hung.link_gaps(frames, self.segments(frames), self.clearance)
        return np.asarray(np.minimum(links[:, None], hung) - self.clearance)

    def segments(self, frames: Frames) -> tuple[Floats, Floats]:
        """Both ends of every capsule of the parked arm, (N, S, 3) each, base frame of the measured arm, m."""
        rotation, origin = frames.rotation[:, self.frame], frames.origin[:, self.frame]
        start, end = (origin[:, None] + points @ rotation.swapaxes(1, 2) for points in (self.start, self.end))
        return start, end

    def link_gaps(self, frames: Frames) -> Floats:
        """(N, K) distance of the checked pairs of links, m; negative where they overlap."""
        (p1, q1), (p2, q2) = self.arm.segments(frames), self.segments(frames)
        a, b = self.first, self.second
        return np.asarray(
            segment_distance(p1[:, a], q1[:, a], p2[:, b], q2[:, b]) - (self.arm.radii[a] + self.radii[b])
        )


def parked(study: Study, arm: Capsules, hung: Weights) -> Parked | None:
    """The parked arm of a study; None if there is none.

    Args:
        study: The study of the arm that is measured.
        arm: Its capsules.
        hung: What hangs on it.
    """
    other = study.neighbour
    if other is None:
        return None
    start, end, capsule = _standing(study, other)
    first, second = np.indices((len(arm.names), len(capsule.names))).reshape(2, -1)
    moves = (arm.frames[first, 1] > other.shared) & (arm.radii[first] > 0.0) & (capsule.radii[second] > 0.0)
    loads, links = len(study.loads), len(capsule.names)
    boxed = np.ones((loads, links), dtype=bool)
    hung = replace(hung, capsules=capsule, boxed=boxed, roped=boxed & (hung.hang > 0.0)[:, None], always=())
    found = Parked(
        other.shared, start, end, capsule.radii, arm, first[moves], second[moves], hung, study.constraints.clearance
    )
    always = (found.link_gaps(sample_frames(study.robot)) < 0.0).all(axis=0)
    first, second = found.first, found.second
    names = [f"{arm.names[i]} and {other.name}'s {capsule.names[j]}"
             for i, j in zip(first[always], second[always], strict=True)]  # fmt: skip
    return replace(found, first=first[~always], second=second[~always], always=tuple(names))


def _standing(study: Study, other: Neighbour) -> tuple[Floats, Floats, Capsules]:
    """Ends (S, 3) of the other arm's own capsules in the frame that they ride on, m, and the capsules."""
    cell = replace(study.constraints, link_radius=other.link_radius, self_collision=False)
    every = capsules(replace(study, robot=other.robot, constraints=cell))
    own = np.flatnonzero(every.frames[:, 1] >= other.shared)
    start, end = (ends[0, own] for ends in every.segments(forward(other.robot, other.q)))
    frames = forward(study.robot, np.zeros(study.robot.n))
    rotation, origin = frames.rotation[0, other.shared], frames.origin[0, other.shared]
    start, end = ((points @ other.rotation.T + other.origin - origin) @ rotation for points in (start, end))
    kept = replace(
        every,
        names=tuple(every.names[k] for k in own),
        **{key: getattr(every, key)[own] for key in ("radii", "frames", "ends", "moving")},
    )
    return start, end, kept
