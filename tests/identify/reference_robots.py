"""Robots and studies in memory that tests of the complete model share."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from identify.loads import LoadCase, Markers
from identify.robot import Robot
from identify.robot_files import load_robot
from identify.study import Noise, ReduceSettings, Study
from identify.transforms import axis_frame, roll_pitch_yaw, translation

#: Reflectors and the load point of the published conditions, flange frame, m.
REFLECTORS = ((0.18, 0.0, -0.17), (0.25, 0.0, 0.05), (0.02, 0.09, 0.22))
HOOK = (0.3, 0.05, -0.1)
#: The beam axis (local x) along world z: columns are the local axes.
UPRIGHT = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


def free(robot: Robot) -> Robot:
    """The same robot whose joints all turn +-180 deg."""
    return replace(robot, lower=np.full(robot.n, -np.pi), upper=np.full(robot.n, np.pi))


def kr270(base_beam: str = "x") -> Robot:
    """Series 2000 lengths, free joints, the beam axis of the base link along world x or z."""
    robot = free(load_robot("kr270_2"))
    turns = robot.link_rotations.copy()
    if base_beam == "z":
        turns[0] = UPRIGHT
    return replace(robot, link_rotations=turns)


def mixed() -> Robot:
    """Five joints about crooked axes, two of them sliding, on a tilted base."""
    rng = np.random.default_rng(11)
    placements = [translation(rng.normal(0, 0.4, 3)) @ axis_frame(rng.normal(size=3)) for _ in range(6)]
    return Robot(
        name="mixed",
        joints=tuple("abcde"),
        prismatic=np.array([False, True, False, True, False]),
        placements=np.array(placements),
        lower=np.full(5, -np.inf),
        upper=np.full(5, np.inf),
        masses=np.full(5, np.nan),
        centres=np.full((5, 3), np.nan),
        efforts=np.full(5, np.nan),
        world_R_base=roll_pitch_yaw([0.3, -0.4, 2.0]),
    )


def gantry() -> Robot:
    """Three sliding joints along x, y, z and two turning ones, all along axes of the links before them."""
    along = ([1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0, 0, 1.0], [0, 1.0, 0])
    ends = [np.eye(4)]
    for axis in along:
        ends.append(translation(np.array([0.3, 0.1, -0.2]) * len(ends)) @ axis_frame(np.array(axis)))
    ends.append(translation(np.array([1.4, 0.2, -0.9])))
    placements = [np.linalg.inv(a) @ b for a, b in pairwise(ends)]
    base = mixed()
    return replace(base, name="gantry", placements=np.array(placements), world_R_base=np.eye(3),
                   prismatic=np.array([True, True, True, False, False]))  # fmt: skip


def seven_joints() -> Robot:
    """The arm of an SDA5F without the waist."""
    robot = load_robot("sda5f_r1")
    first = robot.placements[0] @ robot.placements[1]
    cut = {
        key: getattr(robot, key)[1:]
        for key in ("joints", "prismatic", "continuous", "lower", "upper", "masses", "centres")
    }
    return replace(
        robot, placements=np.array([first, *robot.placements[2:]]), efforts=robot.efforts[1:],
        link_rotations=robot.link_rotations[1:], **cut,
    )  # fmt: skip


def study_of(
    robot: Robot,
    *,
    hook: tuple[float, ...] = HOOK,
    reflectors: tuple[tuple[float, ...], ...] = REFLECTORS,
    template: object = "beam",
    **settings: object,
) -> Study:
    """A study with one vertical unit force, in memory; ``settings`` are those of ``[reduce]``."""
    names = tuple(f"M{i + 1}" for i in range(len(reflectors)))
    return Study(
        path=Path("study.toml"),
        robot=robot,
        loads=(LoadCase("L0"), LoadCase("L1", force=np.array([0.0, 0.0, -1.0]), attach=np.array(hook))),
        markers=Markers(names, np.array(reflectors, dtype=float), np.zeros(len(names), dtype=bool)),
        noise=Noise(reading=3e-5),
        effects=("link_compliance",),
        options={"link_compliance": template if isinstance(template, dict) else {"template": template}},
        reduce=ReduceSettings(**settings),  # type: ignore[arg-type]
    )


#: Name -> builder of an arm: shipped ones, and two with sliding joints about crooked axes.
ARMS = {name: partial(load_robot, name) for name in ("sda5f_r1", "sda5f_r2", "kr270_2", "ur10")}
ARMS |= {"mixed": mixed, "gantry": gantry}


def poses_of(robot: Robot, count: int = 20, seed: int = 1) -> np.ndarray:
    """(V, n) joint values, rad or m."""
    return np.random.default_rng(seed).uniform(-3.0, 3.0, (count, robot.n))
