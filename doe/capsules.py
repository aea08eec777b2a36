"""The arm as capsules, and which of them must keep apart.

Where the robot file states collision shapes of a body (`identify.robot.Shape`) and the study no radius, these are its
capsules. Elsewhere they have one radius and run along the lines between successive joint origins, from the base to the
flange.

Two capsules are neighbours, and not checked, if the links between them are together shorter than the sum of their
radii: so short links and coinciding joints count with the links that they connect. Stated shapes are also not checked
against those of their own and of the next body. Pairs that touch in all of a fixed sample of poses say nothing about a
pose; they are left out too and named in `Capsules.always`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from doe.distances import segment_distance
from identify.arrays import Floats, Ints, frozen
from identify.kinematics import Frames, forward
from identify.robot import Robot, Shape
from identify.study import Study

__all__ = ["Capsules", "capsules", "sample_frames"]

_SAMPLE = 256  # poses that decide whether a pair of capsules always touches
_RADIUS_SHARE = 0.03  # of the reach, where no radius is stated
_POINT = 1e-9  # m: a link shorter than this is none
_STILL = 1e-6  # m: what moves less in the sample stands still


@dataclass(frozen=True, eq=False)
class Capsules:
    """The arm as S capsules, and the pairs of them that must not touch.

    Frame k < n is that of joint k before it moves (it rides on the body before), frame n is the flange.

    Attributes:
        names: What each capsule is, by the points it runs between or the link whose shape it is.
        radii: (S,) m.
        frames: (S, 2) frames of both ends.
        ends: (S, 2, 3) both ends in these frames, m.
        moving: (S,) True where a joint moves the capsule.
        first: (K,) capsule of each checked pair that is nearer to the base.
        second: (K,) the other one.
        always: Pairs that touch in every pose and are therefore not checked, by name.
    """

    names: tuple[str, ...]
    radii: Floats
    frames: Ints
    ends: Floats
    moving: np.ndarray
    first: Ints = field(default_factory=lambda: frozen([], np.int64))
    second: Ints = field(default_factory=lambda: frozen([], np.int64))
    always: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key, kind in (("radii", float), ("ends", float), ("moving", bool), ("frames", int), ("first", int)):
            object.__setattr__(self, key, frozen(getattr(self, key), kind))
        object.__setattr__(self, "second", frozen(self.second, np.int64))

    def segments(self, frames: Frames) -> tuple[Floats, Floats]:
        """Both ends of every capsule, (N, S, 3) each, base frame, m."""
        origins = np.concatenate([frames.origin, frames.flange_origin[:, None]], axis=1)
        start, end = (origins[:, self.frames[:, side]] for side in (0, 1))
        if self.ends.any():
            turns = np.concatenate([frames.rotation, frames.flange_rotation[:, None]], axis=1)
            for points, side in ((start, 0), (end, 1)):
                off = np.flatnonzero(self.ends[:, side].any(axis=1))
                turned = turns[:, self.frames[off, side]] @ self.ends[off, side, :, None]
                points[:, off] += turned[..., 0]
        return start, end

    def gaps(self, frames: Frames) -> Floats:
        """(N, K) distance of the checked pairs, m; negative where they overlap."""
        start, end = self.segments(frames)
        a, b = self.first, self.second
        distance = segment_distance(start[:, a], end[:, a], start[:, b], end[:, b])
        return np.asarray(distance - (self.radii[a] + self.radii[b]))

    @property
    def at_flange(self) -> np.ndarray:
        """(S,) True for capsules that end in the flange frame."""
        return np.asarray(self.frames[:, 1] == self.frames.max(initial=0))


def capsules(study: Study) -> Capsules:
    """The arm's capsules and the pairs of them to check."""
    robot = study.robot
    stated = robot.shapes if study.constraints.link_radius is None else ()
    arm, bodies = _drawn(robot, stated, _radius(study))
    frames = sample_frames(robot)
    start, end = arm.segments(frames)
    spread = np.maximum(np.ptp(start, axis=0), np.ptp(end, axis=0)).max(axis=1)
    arm = replace(arm, moving=spread > _STILL)
    if not study.constraints.self_collision:
        return arm
    pairs = replace(arm, first=(found := _pairs(robot, arm, bodies))[0], second=found[1])
    always = (pairs.gaps(frames) < 0.0).all(axis=0)
    first, second = pairs.first, pairs.second
    names = [f"{arm.names[i]} and {arm.names[j]}" for i, j in zip(first[always], second[always], strict=True)]
    return replace(pairs, first=first[~always], second=second[~always], always=tuple(names))


def _drawn(robot: Robot, shapes: Sequence[Shape], radius: float) -> tuple[Capsules, Ints]:
    """All capsules, nearest to the base first, and the point k (line) or -1 (stated shape) that each begins at."""
    lines = (_shortest(robot) > _POINT) | np.append(False, robot.prismatic)
    shaped = {shape.body for shape in shapes}
    points = ("base", *robot.joints, "flange")
    foot = -robot.placements[0, :3, :3].T @ robot.placements[0, :3, 3]
    names: list[str] = []
    radii: list[float] = []
    ends: list[Floats] = []
    frames: list[tuple[int, int]] = []
    bodies: list[int] = []
    for k in range(robot.n + 1):
        if k not in shaped and lines[k]:
            names.append(f"{points[k]}..{points[k + 1]}")
            radii.append(radius)
            ends.append(np.stack([foot if k == 0 else np.zeros(3), np.zeros(3)]))
            frames.append((max(k - 1, 0), k))
            bodies.append(k)
        back = np.linalg.inv(robot.placements[k])
        for shape in (item for item in shapes if item.body == k):
            names.append(shape.name)
            radii.append(shape.radius)
            ends.append(shape.ends @ back[:3, :3].T + back[:3, 3])
            frames.append((k, k))
            bodies.append(-1 - k)
    arm = Capsules(
        tuple(names),
        np.array(radii),
        np.array(frames, dtype=np.int64).reshape(-1, 2),
        np.array(ends).reshape(-1, 2, 3),
        np.ones(len(names), dtype=bool),
    )
    return arm, np.array(bodies, dtype=np.int64)


def _pairs(robot: Robot, arm: Capsules, bodies: Ints) -> tuple[Ints, Ints]:
    """Capsules that are no neighbours; without a radius there is nothing to check."""
    path = np.append(0.0, np.cumsum(_shortest(robot)))  # length of the arm up to each point
    line = bodies >= 0
    body = np.where(line, bodies, -1 - bodies)  # line k runs along body k, between points k and k + 1
    starts, ends = path[body], path[body + 1]
    apart = starts[None] - ends[:, None] >= arm.radii[None] + arm.radii[:, None]
    both = line[None] & line[:, None]
    apart &= both | (body[None] - body[:, None] > 1)
    solid = arm.radii > 0.0
    first, second = np.nonzero(np.triu(apart & solid[None] & solid[:, None], k=1))
    return first, second


def _radius(study: Study) -> float:
    """Radius of the capsules along lines, m: the study's, else the robot's, else a share of the reach."""
    robot, constraints = study.robot, study.constraints
    if constraints.link_radius is not None:
        return constraints.link_radius
    if np.isfinite(robot.link_radius):
        return robot.link_radius
    reach = robot.reach if np.isfinite(robot.reach) else np.linalg.norm(robot.placements[:, :3, 3], axis=1).sum()
    return float(_RADIUS_SHARE * reach)


def _shortest(robot: Robot) -> Floats:
    """(n + 1,) least distance between successive points over the strokes of sliding joints, m."""
    steps = robot.placements[:, :3, 3].copy()
    slide = np.clip(-steps[1:, 2], robot.lower, robot.upper)
    steps[1:, 2] += np.where(robot.prismatic, slide, 0.0)
    return np.asarray(np.linalg.norm(steps, axis=1))


def sample_frames(robot: Robot) -> Frames:
    """256 poses within the limits, always the same; one turn or 1 m where a limit is unknown."""
    span = np.where(robot.prismatic, 0.5, np.pi)
    lower = np.where(np.isfinite(robot.lower), robot.lower, np.minimum(-span, robot.upper - 2 * span))
    upper = np.where(np.isfinite(robot.upper), robot.upper, np.maximum(span, lower + 2 * span))
    return forward(robot, np.random.default_rng(0).uniform(lower, upper, (_SAMPLE, robot.n)))
