"""Two arms that face one task: a study of each, the joints they share, and the tasks. SI inside.

The arms stand in one world: its axes are those of each study's world (z is up), its origin is where ``base`` counts
from. Arms on a common waist have the same base, and their first joints are one and the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from identify.arrays import Floats, frozen
from identify.cell import Neighbour
from identify.effects import Effect, SpringSet
from identify.kinematics import forward
from identify.model import Model
from identify.study import PlanSettings, Study, TestPose

__all__ = ["Arm", "Task", "TwoArmStudy", "beside", "shared_parameters", "task_points", "unsupported"]


@dataclass(frozen=True, eq=False)
class Arm:
    """One of two arms.

    Attributes:
        name: Its id; its own parameters are called ``<name>.<effect>.<where>``.
        study: Its own study: robot, loads, markers, noise, model, constraints.
        base: (3,) origin of its base frame in the world, m.
    """

    name: str
    study: Study
    base: Floats

    def __post_init__(self) -> None:
        """Make the array read-only."""
        object.__setattr__(self, "base", frozen(self.base))


@dataclass(frozen=True, eq=False)
class Task:
    """What both arms do at the same time.

    Attributes:
        poses: A test pose of each arm; their points should meet.
        weight: Weight in the mean square.
    """

    poses: tuple[TestPose, TestPose]
    weight: float = 1.0


@dataclass(frozen=True, eq=False)
class TwoArmStudy:
    """A validated study of two arms.

    Attributes:
        path: The study file.
        arms: The two arms.
        shared: Number of joints, counted from the base, that both chains have in common.
        tasks: Where the accuracy of one tool point relative to the other counts.
        plan: What the plan of both arms is asked for; loads and reference rows are those of each arm's own study.
        inputs: Every file that was read.
    """

    path: Path
    arms: tuple[Arm, Arm]
    shared: int
    tasks: tuple[Task, ...] = ()
    plan: PlanSettings = field(default_factory=PlanSettings)
    inputs: tuple[Path, ...] = ()


def beside(arms: tuple[Arm, Arm], shared: int) -> tuple[Arm, Arm]:
    """Both arms, each with the other one parked at its home pose, where the study of that one states it.

    Args:
        arms: The arms.
        shared: Number of joints, counted from the base, that both have in common.
    """
    first, second = arms
    return _with_neighbour(first, second, shared), _with_neighbour(second, first, shared)


def _with_neighbour(arm: Arm, other: Arm, shared: int) -> Arm:
    """An arm with the other one parked."""
    cell, robot, world = other.study.constraints, other.study.robot, arm.study.robot.world_R_base
    if cell.home is None:
        return arm
    q = np.where(np.arange(robot.n) < shared, 0.0, cell.home)
    place = world.T @ robot.world_R_base, world.T @ (other.base - arm.base)
    neighbour = Neighbour(other.name, robot, q, *place, shared, cell.link_radius)
    return replace(arm, study=replace(arm.study, neighbour=neighbour))


def task_points(study: TwoArmStudy) -> Floats:
    """(t, 2, 3) undeflected tool points of both arms at the tasks, world frame, m."""
    points = np.empty((len(study.tasks), 2, 3))
    for side, arm in enumerate(study.arms):
        for row, task in enumerate(study.tasks):
            pose = task.poses[side]
            local = forward(arm.study.robot, pose.q).point(pose.point)[0]
            points[row, side] = arm.base + arm.study.robot.world_R_base @ local
    return points


def shared_parameters(model: Model, joints: int) -> frozenset[str]:
    """Names of the parameters that sit below the first joint which is an arm's own.

    They are springs of the shared joints and of what carries these, and errors of these joints that no load causes.

    Args:
        model: The model of one arm.
        joints: Number of shared joints.
    """
    names: list[str] = []
    for effect in model.effects:
        inside = _inside(effect, joints)
        names += [parameter.name for parameter, sits in zip(effect.parameters, inside, strict=True) if sits]
    return frozenset(names)


def unsupported(model: Model, joints: int) -> list[str]:
    """What two arms on shared joints cannot have: names of effects or parameters, with the reason.

    A shared joint turns both tool points and bears the loads of both arms. For linear springs these add up;
    for anything else that yields the model of one arm does not tell what the load of the other one does.

    Args:
        model: The model of one arm.
        joints: Number of shared joints.
    """
    found: list[str] = []
    for effect in model.effects if joints else ():
        shared = {f"j{joint + 1}" for joint in range(joints)}
        if effect.springs is not None:
            found += [
                f"{term.name}: couples a shared joint with one of the arm's own"
                for term in (*effect.terms, *(term for term, _ in effect.held))
                if _below(effect.springs, term.first, joints) != _below(effect.springs, term.second, joints)
            ]
        elif effect.through and effect.adjust is not None:
            found.append(f"{effect.name}: also loads the joints that carry the other arm")
        elif effect.yields and not effect.of_reading:
            found += [
                f"{parameter.name}: no linear spring on a shared joint"
                for parameter in effect.parameters
                if shared & set(_place(parameter.name).split("-"))
            ]
    return found


def _inside(effect: Effect, joints: int) -> list[bool]:
    """Which parameters of an effect sit on what both arms share."""
    if not joints or effect.of_reading or (effect.springs is None and effect.yields):
        return [False] * len(effect.parameters)
    if effect.springs is not None:
        springs = effect.springs
        return [_below(springs, term.first, joints) and _below(springs, term.second, joints) for term in effect.terms]
    shared = {f"j{joint + 1}" for joint in range(joints)}
    return [_place(parameter.name) in shared for parameter in effect.parameters]


def _below(springs: SpringSet, spring: int, joints: int) -> bool:
    """Whether a spring sits below the first joint that is an arm's own; link i ends where joint i + 1 begins."""
    if springs == "joints":
        return spring < joints
    return joints > 0 if springs == "base" else spring // 6 < joints


def _place(name: str) -> str:
    """``j2`` of ``joint_compliance.j2``."""
    return name.split(".")[1]
