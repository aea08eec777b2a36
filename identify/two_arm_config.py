"""From the study file of two arms to a `TwoArmStudy`: read, check everything, convert to SI.

The file names an ordinary study for each arm; what belongs to one arm stands there. Here stands what both have in
common: the joints they share, the tasks they face and what the plan is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from identify.config import load_study
from identify.errors import InputError
from identify.problems import Problems, read_toml, unknown
from identify.schema import ArmPoseSection, ArmSection, PlanSection, Positive, Section, TwoArmPlanSection, WaistSection
from identify.study import PlanSettings
from identify.study_checks import check_plan, check_test_pose
from identify.study_records import plan_settings, test_pose
from identify.two_arm_checks import check_arms, check_points
from identify.two_arm_study import Arm, Task, TwoArmStudy, beside
from identify.units import MM

__all__ = ["holds_two_arms", "load_two_arm_study"]

_TABLES = ("arms", "waist", "test_poses", "plan")


class _TaskSection(Section):
    """One of ``[[test_poses]]`` without what the arms do."""

    weight: Positive = 1.0


def holds_two_arms(path: str | Path) -> bool:
    """True if a study file lists ``[[arms]]``.

    Raises:
        InputError: The file cannot be read.
    """
    return "arms" in read_toml(Path(path))


def load_two_arm_study(path: str | Path) -> TwoArmStudy:
    """Read and check the study file of two arms, and the study of each.

    Args:
        path: The study file (TOML).

    Raises:
        InputError: It is wrong, or the study of an arm is; the message holds every problem.
    """
    path = Path(path)
    problems, data = Problems(path), read_toml(path)
    for name in data:
        if name not in _TABLES:
            problems.add(f"[{name}]", unknown("table", name, _TABLES))
    arms = _arms(data.get("arms"), path, problems)
    waist = problems.check(WaistSection, data.get("waist", {}), "[waist]")
    plan = _plan(data.get("plan", {}), problems)
    tasks: tuple[Task, ...] = ()
    if arms is not None:
        tasks = _tasks(data.get("test_poses", []), arms, problems)
    if arms is not None and waist is not None:
        found = TwoArmStudy(path, arms, waist.shared_joints, tasks, plan, _inputs(path, arms))
        check_arms(found, problems)
        check_points(found, problems)
        problems.settle()
        return replace(found, arms=beside(arms, waist.shared_joints))
    problems.settle()
    raise InputError(f"{path}: [[arms]] cannot be read")  # whatever is missing is a problem: only for the type checker


def _inputs(path: Path, arms: Sequence[Arm]) -> tuple[Path, ...]:
    """Every file that was read, once."""
    return tuple(dict.fromkeys([path, *(file for arm in arms for file in arm.study.inputs)]))


def _arms(tables: object, path: Path, problems: Problems) -> tuple[Arm, Arm] | None:
    """The two arms with their studies, or None where one of them cannot be had."""
    if not isinstance(tables, list) or len(tables) != 2:
        given = f"{len(tables)} given" if isinstance(tables, list) else "none given"
        problems.add("[[arms]]", f"two tables expected, each with name and study; {given}")
        return None
    sections = [problems.check(ArmSection, table, f"[[arms]] {i + 1}") for i, table in enumerate(tables)]
    arms = [_arm(table, i, path, problems) for i, table in enumerate(sections) if table is not None]
    names = [table.name for table in sections if table is not None]
    if len(set(names)) < len(names):
        problems.add("[[arms]] 2 name", "[[arms]] 1 has this name; every arm needs its own", names[1])
    if "weight" in names:
        problems.add(
            f"[[arms]] {names.index('weight') + 1} name", "is a key of [[test_poses]]; choose another", "weight"
        )
    return (arms[0], arms[1]) if len(arms) == 2 and arms[0] and arms[1] else None


def _arm(table: ArmSection, index: int, path: Path, problems: Problems) -> Arm | None:
    """One arm with its study."""
    try:
        study = load_study(path.parent / table.study)
    except InputError as error:
        problems.add(f"[[arms]] {index + 1} study", str(error), table.study)
        return None
    return Arm(table.name, study, np.array(table.base_mm) * MM)


def _plan(table: object, problems: Problems) -> PlanSettings:
    """What the plan of both arms is asked for."""
    if isinstance(table, Mapping):
        common = TwoArmPlanSection.model_fields
        single = set(PlanSection.model_fields) - set(common)
        for key in sorted(single & set(table)):
            what = f"is not for two arms; it belongs to the study of one. Allowed here: {', '.join(common)}"
            problems.add(f"[plan] {key}", what, table[key])
        table = {key: value for key, value in table.items() if key not in single}
    known = problems.check(TwoArmPlanSection, table, "[plan]") or TwoArmPlanSection()
    whole = PlanSection(**known.model_dump())
    check_plan(whole, None, problems)
    return plan_settings(whole, ())


def _tasks(tables: object, arms: Sequence[Arm], problems: Problems) -> tuple[Task, ...]:
    """The tasks that both arms face; wrong ones are left out."""
    if not isinstance(tables, list):
        problems.add("[test_poses]", "a list of tables expected, each begins with [[test_poses]]")
        return ()
    found = [_task(table, arms, f"[[test_poses]] {i + 1}", problems) for i, table in enumerate(tables)]
    return tuple(task for task in found if task is not None)


def _task(table: object, arms: Sequence[Arm], heading: str, problems: Problems) -> Task | None:
    """One task: a table for each arm, and a weight."""
    if not isinstance(table, Mapping):
        problems.add(heading, "a table expected")
        return None
    before = len(problems.lines)
    names = [arm.name for arm in arms]
    for key in table:
        if key not in {*names, "weight"}:
            problems.add(f"{heading} {key}", unknown("arm", str(key), [*names, "weight"]))
    own = {key: value for key, value in table.items() if key == "weight"}
    common = problems.check(_TaskSection, own, heading)
    sections = [_pose(table, arm, f"{heading} {arm.name}", problems) for arm in arms]
    if len(problems.lines) > before or common is None:
        return None
    first, second = (
        test_pose(section, arm.study.robot, common.weight)
        for section, arm in zip(sections, arms, strict=True)
        if section is not None
    )
    return Task((first, second), common.weight)


def _pose(table: Mapping[str, Any], arm: Arm, heading: str, problems: Problems) -> ArmPoseSection | None:
    """What one arm does at a task."""
    if arm.name not in table:
        problems.add(heading, "is missing; a task says what both arms do")
        return None
    section = problems.check(ArmPoseSection, table[arm.name], heading)
    if section is not None and not problems.found(heading):
        check_test_pose(section, arm.study.robot, f"{heading} joints_deg", problems)
    return section
