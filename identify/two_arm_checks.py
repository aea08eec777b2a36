"""What the two studies of two arms and their tasks say together."""

from __future__ import annotations

import numpy as np

from identify.effects import Parameter
from identify.errors import InputError
from identify.model import Model, model_of
from identify.problems import Problems
from identify.robot import Robot
from identify.study import Study
from identify.two_arm_study import Arm, TwoArmStudy, shared_parameters, task_points, unsupported
from identify.units import DEG, MM

__all__ = ["check_arms", "check_points"]

_SAME = 1e-9  # m or rad: shared joints and bases agree up to this
_FAR = 1.0  # m: tool points that meet at a task are not further apart


def check_arms(study: TwoArmStudy, problems: Problems) -> None:
    """Note where the arms cannot stand in one world, share joints or be planned together."""
    first, second = study.arms
    if not np.isclose(first.study.robot.gravity, second.study.robot.gravity, rtol=0.0, atol=_SAME):
        problems.add("[[arms]] 2 study", "its [robot] gravity_ms2 is not that of the other arm", second.study.path.name)
    for index, arm in enumerate(study.arms):
        if all(load.unloaded for load in arm.study.loads):
            problems.add(
                f"[[arms]] {index + 1} study",
                "loads nothing, so no stiffness of this arm would show; state a mass or a wrench under its [[loads]]",
                arm.study.path.name,
            )
        if arm.study.load_ranges:
            problems.add(
                f"[[arms]] {index + 1} study",
                f"the load {next(iter(arm.study.load_ranges))} has mass_range_kg or attach_range_mm, which only a plan "
                "for one arm chooses; leave the ranges out and state the values to be hung",
                arm.study.path.name,
            )
    models = _models(study, problems)
    if not study.shared:
        if np.allclose(first.base, second.base, rtol=0.0, atol=_SAME):
            problems.add(
                "[[arms]] 2 base_mm",
                "stands where the other arm stands; state where, or [waist] shared_joints if they share a waist",
                (second.base / MM).tolist(),
            )
        return
    _check_waist(study, problems)
    if models is not None and not problems.found("[waist]"):
        _check_models(study, models, problems)


def check_points(study: TwoArmStudy, problems: Problems) -> None:
    """Note tasks whose shared joints differ or whose tool points are far apart."""
    units = study.arms[0].study.joint_units
    for i, (task, points) in enumerate(zip(study.tasks, task_points(study), strict=True)):
        first, second = (pose.q[: study.shared] for pose in task.poses)
        unequal = np.flatnonzero(np.abs(first - second) > _SAME)
        for joint in unequal:
            mine, other = (q[joint] / units[joint] for q in (first, second))
            problems.add(
                f"[[test_poses]] {i + 1} {study.arms[1].name} joints_deg, entry {joint + 1}",
                f"the joint is shared and {study.arms[0].name} has {mine:g} there; both must be equal",
                float(f"{other:.9g}"),
            )
        distance = float(np.linalg.norm(points[1] - points[0]))
        if distance > _FAR and not len(unequal):
            problems.add(
                f"[[test_poses]] {i + 1}",
                f"the tool points are {distance / MM:.0f} mm apart, at most {_FAR / MM:.0f} mm are taken for one task; "
                "check joints_deg, point_mm and where the bases stand",
            )


def _models(study: TwoArmStudy, problems: Problems) -> tuple[Model, Model] | None:
    """The model of each arm, or None where one cannot be made."""
    try:
        first, second = (model_of(arm.study) for arm in study.arms)
    except InputError as error:
        problems.add("[[arms]] study", str(error))
        return None
    return first, second


def _check_waist(study: TwoArmStudy, problems: Problems) -> None:
    """The shared joints are the same in both chains, and each arm has joints of its own."""
    first, second = (arm.study.robot for arm in study.arms)
    key = "[waist] shared_joints"
    if study.shared >= min(first.n, second.n):
        allowed = min(first.n, second.n) - 1
        problems.add(key, f"at most {allowed}: each arm needs a joint of its own", study.shared)
        return
    if not np.allclose(study.arms[0].base, study.arms[1].base, rtol=0.0, atol=_SAME):
        problems.add(key, "arms on one waist have one base; leave base_mm out", study.shared)
    if not np.allclose(first.world_R_base, second.world_R_base, rtol=0.0, atol=_SAME):
        problems.add(key, "arms on one waist have one [robot] mount_deg; the studies state two", study.shared)
    for joint in range(study.shared):
        for what, differs in _differences(first, second, joint, study.arms[0].study).items():
            if differs:
                problems.add(key, f"joint {joint + 1} is not the same in both robots: {what} {differs}", study.shared)
    if not np.allclose(
        first.link_rotations[: study.shared], second.link_rotations[: study.shared], rtol=0.0, atol=_SAME
    ):
        problems.add(key, "the link frames below the arms differ between the robot files", study.shared)


def _differences(first: Robot, second: Robot, joint: int, study: Study) -> dict[str, str]:
    """In words, what differs in one joint of two robots; empty texts where nothing does."""
    unit, name = (MM, "mm") if study.robot.prismatic[joint] else (DEG, "deg")

    def limits(robot: Robot) -> str:
        return f"{robot.lower[joint] / unit:g} to {robot.upper[joint] / unit:g} {name}"

    near = np.allclose(
        [first.lower[joint], first.upper[joint]], [second.lower[joint], second.upper[joint]], rtol=0.0, atol=_SAME
    )
    return {
        "it turns in one and slides in the other": "." if first.prismatic[joint] != second.prismatic[joint] else "",
        "its placement differs": ""
        if np.allclose(first.placements[joint], second.placements[joint], rtol=0.0, atol=_SAME)
        else "by more than 1e-9 (lengths in m)",
        "its limits are": "" if near else f"{limits(first)} and {limits(second)}",
    }


def _check_models(study: TwoArmStudy, models: tuple[Model, Model], problems: Problems) -> None:
    """What sits on the shared joints is one thing, and the sum over both arms says what it does."""
    for index, (arm, model) in enumerate(zip(study.arms, models, strict=True)):
        key = f"[[arms]] {index + 1} study"
        for why in unsupported(model, study.shared):
            problems.add(
                key,
                f"[model] effects, {why}; take it out or name its places (name@j{study.shared + 1})",
                arm.study.path.name,
            )
        if _weighs(arm, model, study.shared):
            problems.add(
                key,
                "the other arm hangs on the shared joints too, and only changes between loads are free of its weight: "
                'set [model] reference = "differences" there',
                arm.study.path.name,
            )
    first, second = ({p.name: p for p in model.parameters} for model in models)
    mine, other = (shared_parameters(model, study.shared) for model in models)
    for name in sorted(mine | other):
        _check_shared(study, name, first.get(name), second.get(name), problems)


def _weighs(arm: Arm, model: Model, joints: int) -> bool:
    """Whether absolute readings would show the weight of the other arm, which is in no model."""
    elastic = any(effect.yields and effect.springs is not None for effect in model.effects)
    compared = arm.study.reference == "differences"
    return model.self_weight and not compared and elastic and bool(shared_parameters(model, joints))


def _check_shared(
    study: TwoArmStudy, name: str, first: Parameter | None, second: Parameter | None, problems: Problems
) -> None:
    """A parameter of a shared joint is in both models, and starts at one value."""
    arms = study.arms
    if first is None or second is None:
        missing = arms[0] if first is None else arms[1]
        problems.add(
            f"[[arms]] {arms.index(missing) + 1} study",
            f"its model lacks {name}, which belongs to both arms; list the same effects of shared joints in both",
            missing.study.path.name,
        )
    elif first.nominal != second.nominal:
        problems.add(
            "[[arms]] 2 study",
            f"[model.nominal] {name} = {second.nominal:g}, the study of {arms[0].name} says {first.nominal:g}; "
            "both must be equal",
            arms[1].study.path.name,
        )
