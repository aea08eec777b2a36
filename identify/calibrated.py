"""The region that a model was calibrated in: joint values that were measured, and loads that were on the arm.

A compliance is a straight line through what was measured. Beyond, nobody has seen whether the joint hardens or has
play, and a joint that no load has turned has no compliance at all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from identify.arrays import Floats, frozen
from identify.effects import build_scene
from identify.experiment import Experiment
from identify.kinematics import forward
from identify.robot import Robot
from identify.tool_response import Targets, target_experiment
from identify.units import DEG, MM

__all__ = ["BEYOND", "CalibratedRegion", "RegionCheck", "calibrated_region", "check_region", "region_json", "region_of"]

BEYOND = 0.1  # of each range, on both sides, that still counts as inside
_ROUNDING = 1e-5  # of the largest torque, force or moment: robot files round their axes to about this
_TINY = 1e-6  # rad, m, N or Nm


@dataclass(frozen=True, eq=False)
class CalibratedRegion:
    """What was measured.

    Attributes:
        lower: (n,) smallest joint values, rad or m.
        upper: (n,) largest ones.
        load_lower: (n,) smallest torque (force on a sliding joint) that the loads, without self-weight, put on each
            joint, Nm or N; at most 0, which the unloaded arm has.
        load_upper: (n,) largest one; at least 0.
        force: Largest force on the flange, N.
        moment: Largest moment about the origin of the flange, Nm.
    """

    lower: Floats
    upper: Floats
    load_lower: Floats
    load_upper: Floats
    force: float
    moment: float

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("lower", "upper", "load_lower", "load_upper"):
            object.__setattr__(self, key, frozen(getattr(self, key)))


@dataclass(frozen=True, eq=False)
class RegionCheck:
    """Targets against a calibrated region; m quantities: joint values, torques, force and moment.

    Attributes:
        what: (m,) the quantities in words.
        units: (m,) their units in files.
        values: (T, m) of the targets, in these units.
        lower: (m,) calibrated range, in these units.
        upper: (m,) its end.
        beyond: (m,) what is allowed beyond the range.
    """

    what: tuple[str, ...]
    units: tuple[str, ...]
    values: Floats
    lower: Floats
    upper: Floats
    beyond: Floats

    @property
    def exceeds(self) -> np.ndarray:
        """(T, m) True where a quantity is outside."""
        inside = (self.values >= self.lower - self.beyond) & (self.values <= self.upper + self.beyond)
        return np.asarray(~inside)

    @property
    def outside(self) -> np.ndarray:
        """(T,) True for targets outside the region."""
        return np.asarray(self.exceeds.any(axis=1))

    def words(self, target: int) -> str:
        """The first quantity of a target that is outside, its value and what is allowed."""
        k = int(np.flatnonzero(self.exceeds[target])[0])
        low, high = self.lower[k] - self.beyond[k], self.upper[k] + self.beyond[k]
        return (
            f"{self.what[k]} is {self.values[target, k]:.6g} {self.units[k]}; calibrated are {self.lower[k]:.6g} to "
            f"{self.upper[k]:.6g} {self.units[k]}, allowed {low:.6g} to {high:.6g} {self.units[k]} "
            f"({100 * BEYOND:g} % of the range beyond)"
        )


def calibrated_region(robot: Robot, experiment: Experiment) -> CalibratedRegion:
    """The region of an experiment.

    Args:
        robot: The nominal robot.
        experiment: What was measured.
    """
    torque, force, moment = _loads(robot, experiment)
    return CalibratedRegion(
        lower=experiment.q.min(axis=0),
        upper=experiment.q.max(axis=0),
        load_lower=torque.min(axis=0, initial=0.0),
        load_upper=torque.max(axis=0, initial=0.0),
        force=float(force.max(initial=0.0)),
        moment=float(moment.max(initial=0.0)),
    )


def _loads(robot: Robot, experiment: Experiment) -> tuple[Floats, Floats, Floats]:
    """Of loads alone: torques on the joints (S, n), size of the force (S,) and of the moment (S,) about the flange."""
    frames = forward(robot, experiment.q)
    scene = build_scene(experiment, frames, experiment.markers.positions, self_weight=False)
    on_flange = scene.torque("links")[:, -6:]  # the springs of the last link stand at the origin of the flange
    force, moment = (np.linalg.norm(part, axis=1) for part in (on_flange[:, :3], on_flange[:, 3:]))
    return scene.torque("joints"), force, moment


def check_region(region: CalibratedRegion, robot: Robot, targets: Targets) -> RegionCheck:
    """Compare targets with a calibrated region.

    Args:
        region: The region.
        robot: The nominal robot.
        targets: Wished poses and wrenches.
    """
    parts = [_loads(robot, target_experiment(part)) for part in targets.parts()]
    torque, force, moment = (np.concatenate(found) for found in zip(*parts, strict=True))
    lower = np.hstack([region.lower, region.load_lower, 0.0, 0.0])
    upper = np.hstack([region.upper, region.load_upper, region.force, region.moment])
    rounding = _ROUNDING * np.abs(np.hstack([region.load_lower, region.load_upper])).max()
    slack = np.repeat([_TINY, _TINY + rounding], [robot.n, robot.n + 2])
    scale, units = _units(robot)
    names = (
        *(f"joint {i + 1}" for i in range(robot.n)),
        *(
            f"{'force' if slides else 'torque'} of the load on joint {i + 1}"
            for i, slides in enumerate(robot.prismatic)
        ),
        "force of the load",
        "moment of the load about the flange",
    )
    values = np.column_stack([targets.q, torque, force, moment])
    beyond = BEYOND * (upper - lower) + slack
    return RegionCheck(names, units, values / scale, lower / scale, upper / scale, beyond / scale)


def _units(robot: Robot) -> tuple[Floats, tuple[str, ...]]:
    """SI value and name of the unit of each quantity."""
    scale = np.hstack([np.where(robot.prismatic, MM, DEG), np.ones(robot.n + 2)])
    joints = ["mm" if slides else "deg" for slides in robot.prismatic]
    loads = ["N" if slides else "Nm" for slides in robot.prismatic]
    return scale, (*joints, *loads, "N", "Nm")


def region_json(region: CalibratedRegion, robot: Robot) -> dict[str, Any]:
    """The region as it stands in ``identify.json``."""
    scale, units = _units(robot)
    n = robot.n
    joints = [
        {
            "joint": f"j{i + 1}",
            f"lower_{units[i]}": region.lower[i] / scale[i],
            f"upper_{units[i]}": region.upper[i] / scale[i],
            f"lower_{units[n + i]}": region.load_lower[i],
            f"upper_{units[n + i]}": region.load_upper[i],
        }
        for i in range(n)
    ]
    return {"joints": joints, "force_N": region.force, "moment_Nm": region.moment}


def region_of(content: Mapping[str, Any], robot: Robot) -> CalibratedRegion:
    """The region that a result holds.

    Args:
        content: See `region_json`.
        robot: The robot of the study.

    Raises:
        KeyError, TypeError, ValueError: The content is none, or is one of another robot.
    """
    scale, units = _units(robot)
    n = robot.n
    joints = list(content["joints"])
    if len(joints) != n:
        raise ValueError(f"calibrated: {len(joints)} joints, the robot has {n}")
    numbers = [
        [float(joints[i][f"{end}_{unit}"]) for unit in (units[i], units[n + i]) for end in ("lower", "upper")]
        for i in range(n)
    ]
    lower, upper, load_lower, load_upper = np.array(numbers).T
    region = CalibratedRegion(
        lower * scale[:n],
        upper * scale[:n],
        load_lower,
        load_upper,
        float(content["force_N"]),
        float(content["moment_Nm"]),
    )
    if not np.isfinite(numbers).all() or not np.isfinite([region.force, region.moment]).all():
        raise ValueError("calibrated: a number is not finite")
    return region
