"""Two arms as one subject of a plan: common parameters, blocks of either arm, and the error between the tool points.

A visit is one of one arm; the other hangs still and unloaded. Its block stands on the parameters of its own arm and
on those of shared joints, which are one parameter for both arms; all other columns are zero.

What counts at a task is ``e = p_2 - p_1``, the error of the second tool point relative to the first in the world
frame. What is an arm's own moves its own point and yields to its own load. A shared spring moves both points, and
the loads of both arms act on it:

    de/dc = sum_a (D(p_2) - D(p_1)) t(load of arm a)

so it drops out where the points coincide, whatever the loads are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from doe.observations import Observer, error_rows, observer
from identify.arrays import Floats, Ints, frozen
from identify.effects import Parameter
from identify.identifiability import Dropped, explained, why_zero
from identify.kinematics import forward, jacobian
from identify.model import Model
from identify.study import PlanSettings, TestPose
from identify.two_arm_study import TwoArmStudy, shared_parameters, task_points
from identify.units import MM

__all__ = ["TwoArmObserver", "relative_jitter", "two_arm_observer"]

_SIGNS = (-1.0, 1.0)  # of the two points in e


@dataclass(frozen=True, eq=False)
class TwoArmObserver:
    """Everything that turns poses of either arm into blocks on common parameters.

    Attributes:
        study: The study of two arms.
        arms: The observer of each arm.
        parameters: (p,) nuisance of both arms, what they share, then what is an arm's own, as ``<arm>.<name>``.
        columns: Where the parameters of each arm's model stand among these.
    """

    study: TwoArmStudy
    arms: tuple[Observer, Observer]
    parameters: tuple[Parameter, ...]
    columns: tuple[Ints, Ints]

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        object.__setattr__(self, "columns", tuple(frozen(column, np.int64) for column in self.columns))

    @property
    def path(self) -> Path:
        """The study file."""
        return self.study.path

    @property
    def settings(self) -> PlanSettings:
        """What the plan is asked for."""
        return self.study.plan

    @property
    def reference(self) -> str:
        """What readings are compared with; where the arms differ, of each."""
        first, second = (arm.reference for arm in self.arms)
        if first == second:
            return first
        return ", ".join(f"{arm.name} {own.reference}" for arm, own in zip(self.study.arms, self.arms, strict=True))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """(p,) names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def nuisance(self) -> np.ndarray:
        """(p,) True for frames and markers."""
        return np.array([parameter.nuisance for parameter in self.parameters], dtype=bool)

    @property
    def weights(self) -> Floats:
        """(t,) weights of the tasks."""
        return np.array([task.weight for task in self.study.tasks])

    def why(self, dropped: Dropped) -> str:
        """In words, why a parameter cannot be identified."""

        def reason(column: int) -> str:
            side = 0 if column in self.columns[0] else 1
            return why_zero(self.arms[side].model, int(np.flatnonzero(self.columns[side] == column)[0]))

        return explained(self.parameters, dropped, reason)

    def spread(self, side: int, rows: Floats) -> Floats:
        """Rows (..., p_a) of one arm on the common parameters, (..., p)."""
        wide = np.zeros((*rows.shape[:-1], len(self.parameters)))
        wide[..., self.columns[side]] = rows
        return wide

    def blocks(self, side: int, q: Floats, visit_loads: Ints) -> Floats:
        """Whitened blocks (N, k, p) of visits of one arm (0 or 1), see `doe.observations.Observer.blocks`."""
        return self.spread(side, self.arms[side].blocks(q, visit_loads))

    def test_rows(self) -> Floats:
        """(t, 3, p) of ``e = p_2 - p_1`` at each task, world frame, m per unit of each parameter."""
        rows = np.zeros((len(self.study.tasks), 3, len(self.parameters)))
        points = task_points(self.study)
        for side in (0, 1):
            model = self._bare(side)
            both = _on_shared_springs(model, self.study.shared)
            for task, meeting, into in zip(self.study.tasks, points, rows, strict=True):
                pose = task.poses[side]
                part = self._moved(side, model, pose, meeting[side]) * _SIGNS[side]
                if both.any():
                    other = self._moved(side, model, pose, meeting[1 - side]) * _SIGNS[1 - side]
                    part += np.where(both, other, 0.0)
                into[:, self.columns[side]] += part
        return rows

    def _bare(self, side: int) -> Model:
        """The model of an arm at a task; the masses of shared links count in the first one only."""
        model = self.arms[side].model
        masses = model.robot.masses.copy()
        masses[: self.study.shared * side] = 0.0
        return replace(model, robot=replace(model.robot, masses=masses))

    def _moved(self, side: int, model: Model, pose: TestPose, point: Floats) -> Floats:
        """(3, p_a) motion of a world point (3,) under the load of an arm, as if it were fixed to its flange."""
        arm = self.study.arms[side]
        world = arm.study.robot.world_R_base
        frames = forward(arm.study.robot, pose.q)
        local = frames.flange_rotation[0].T @ (world.T @ (point - arm.base) - frames.flange_origin[0])
        moved: Floats = world @ error_rows(model, replace(pose, point=local))
        return moved


def two_arm_observer(study: TwoArmStudy) -> TwoArmObserver:
    """The observer of two arms."""
    first, second = (observer(arm.study) for arm in study.arms)
    shared = shared_parameters(first.model, study.shared)
    order: dict[str, tuple[int, Parameter]] = {}
    names: list[list[str]] = []
    for arm, own in zip(study.arms, (first, second), strict=True):
        names.append([p.name if p.name in shared else f"{arm.name}.{p.name}" for p in own.parameters])
        for name, parameter in zip(names[-1], own.parameters, strict=True):
            rank = 0 if parameter.nuisance else 1 if parameter.name in shared else 2
            order.setdefault(name, (rank, replace(parameter, name=name)))
    kept = sorted(order.values(), key=lambda entry: entry[0])  # stable: first arm first
    parameters = tuple(parameter for _, parameter in kept)
    place = {parameter.name: column for column, parameter in enumerate(parameters)}
    columns = [np.array([place[name] for name in each], dtype=np.int64) for each in names]
    return TwoArmObserver(study, (first, second), parameters, (columns[0], columns[1]))


def relative_jitter(study: TwoArmStudy) -> Floats:
    """(t, 3, 3) covariance of ``p_2 - p_1`` at the tasks from the pose jitter of both arms, world frame, mm^2.

    A shared joint is approached once for both arms; of the two studies' jitters the larger one counts there.
    """
    shared, points = study.shared, task_points(study)
    common = max(arm.study.noise.pose_jitter for arm in study.arms)
    parts = [_linear(study, side, points[:, side]) for side in (0, 1)]
    moves = [(parts[1][:, :, :shared] - parts[0][:, :, :shared]) * common]
    moves += [part[:, :, shared:] * arm.study.noise.pose_jitter for part, arm in zip(parts, study.arms, strict=True)]
    every = np.concatenate(moves, axis=2) / MM
    product: Floats = every @ every.swapaxes(1, 2)
    return product


def _linear(study: TwoArmStudy, side: int, points: Floats) -> Floats:
    """(t, 3, n) motion of world points (t, 3) of one arm with its joints at the tasks, world frame."""
    arm = study.arms[side]
    world = arm.study.robot.world_R_base
    frames = forward(arm.study.robot, np.stack([task.poses[side].q for task in study.tasks]))
    linear: Floats = world @ jacobian(frames, (points - arm.base) @ world)[:, :3]
    return linear


def _on_shared_springs(model: Model, joints: int) -> np.ndarray:
    """(p_a,) True for springs that carry both arms."""
    shared, marked = shared_parameters(model, joints), np.zeros(len(model.parameters), dtype=bool)
    for effect, where in zip(model.effects, model.effect_slices, strict=True):
        if effect.springs is not None:
            marked[where] = [parameter.name in shared for parameter in effect.parameters]
    return marked
