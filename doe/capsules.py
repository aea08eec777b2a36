"""Self-collision: the arm as capsules of one radius around the lines between successive joint origins.

The lines run from the base to the flange. Two capsules are neighbours, and not checked, if the links between them are
together shorter than the diameter of a capsule: so short links and coinciding joints count with the links that they
connect. Pairs that touch in all of a fixed sample of poses say nothing about a pose; they are left out too and named
in `Capsules.always`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, Ints, frozen
from identify.kinematics import Frames, forward
from identify.robot import Robot
from identify.study import Study

__all__ = ["Capsules", "capsules", "segment_distance"]

_SAMPLE = 256  # poses that decide whether a pair of capsules always touches
_RADIUS_SHARE = 0.03  # of the reach, where no radius is stated
_POINT = 1e-9  # m: a link shorter than this is none
_NONE = frozen([], np.int64)


@dataclass(frozen=True, eq=False)
class Capsules:
    """The arm as capsules of one radius, and the pairs of them that must not touch.

    Attributes:
        radius: m; 0 where nothing is checked.
        starts: (S,) capsule k runs from point ``starts[k]`` to the next one. Points are the base origin, the joint
            origins and the flange origin.
        first: (K,) capsule of each checked pair that is nearer to the base.
        second: (K,) the other one.
        always: Pairs that touch in every pose and are therefore not checked, by name.
    """

    radius: float
    starts: Ints
    first: Ints
    second: Ints
    always: tuple[str, ...] = ()

    def touching(self, frames: Frames) -> np.ndarray:
        """(N, K) True where a checked pair touches."""
        base = np.zeros((len(frames.origin), 1, 3))
        points = np.concatenate([base, frames.origin, frames.flange_origin[:, None]], axis=1)
        a, b = self.starts[self.first], self.starts[self.second]
        distance = segment_distance(points[:, a], points[:, a + 1], points[:, b], points[:, b + 1])
        return np.asarray(distance < 2 * self.radius)


def capsules(study: Study) -> Capsules:
    """The arm's capsules and the pairs of them to check."""
    robot, radius = study.robot, _radius(study)
    if radius == 0.0:
        return Capsules(0.0, _NONE, _NONE, _NONE)
    shortest = _shortest(robot)
    starts = np.flatnonzero((shortest > _POINT) | np.append(False, robot.prismatic))
    path = np.append(0.0, np.cumsum(shortest))  # length of the arm up to each point
    between = path[starts][None] - path[starts + 1][:, None]  # from the end of one capsule to the start of another
    first, second = np.nonzero(np.triu(between, k=1) >= 2 * radius)
    pairs = Capsules(radius, starts, first, second)
    always = pairs.touching(forward(robot, _sample(robot))).all(axis=0)
    names = [_pair_name(robot, starts[i], starts[j]) for i, j in zip(first[always], second[always], strict=True)]
    return Capsules(
        radius=radius,
        starts=frozen(starts, np.int64),
        first=frozen(first[~always], np.int64),
        second=frozen(second[~always], np.int64),
        always=tuple(names),
    )


def _radius(study: Study) -> float:
    """Radius of the capsules, m: the study's, else the robot's, else a share of the reach; 0: no check."""
    robot, constraints = study.robot, study.constraints
    if not constraints.self_collision:
        return 0.0
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


def _sample(robot: Robot) -> Floats:
    """(256, n) poses within the limits, always the same; one turn or 1 m where a limit is unknown."""
    span = np.where(robot.prismatic, 0.5, np.pi)
    lower = np.where(np.isfinite(robot.lower), robot.lower, np.minimum(-span, robot.upper - 2 * span))
    upper = np.where(np.isfinite(robot.upper), robot.upper, np.maximum(span, lower + 2 * span))
    return np.asarray(np.random.default_rng(0).uniform(lower, upper, (_SAMPLE, robot.n)))


def _pair_name(robot: Robot, first: int, second: int) -> str:
    """A pair of capsules by the points they run between."""
    points = ("base", *robot.joints, "flange")
    return " and ".join(f"{points[start]}..{points[start + 1]}" for start in (first, second))


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


def _dot(x: Floats, y: Floats) -> Floats:
    """Scalar product over the last axis."""
    return np.asarray(np.einsum("...i,...i->...", x, y))
