"""What the values of a study file say together: ids, loads, noise, effects, poses and limits."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from identify.cell_checks import check_cell
from identify.cell_sections import ConstraintsSection
from identify.problems import Problems, nearest, unknown
from identify.robot import Robot
from identify.schema import (
    EFFECT_NAMES,
    ArmPoseSection,
    LoadSection,
    NoiseSection,
    PlanSection,
    ReduceSection,
    TestRegionSection,
)
from identify.study_file import StudyFile
from identify.study_records import load_cases
from identify.units import DEG, MM

__all__ = ["check_effects", "check_plan", "check_study", "check_test_pose"]

_BUDGETS = ("time_budget_s", "cost_budget")
_EFFECT = re.compile(r"([a-z_]+)(@[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)?)?")


def check_study(file: StudyFile, robot: Robot | None, problems: Problems) -> None:
    """Note what is wrong between values."""
    _check_markers(file, problems)
    _check_loads(file, robot, problems)
    _check_ranges(file.loads or [], file.plan or PlanSection(), problems)
    if file.noise is not None and not problems.found("[noise"):
        _check_noise(file.noise, problems)
    if file.model is not None:
        check_effects(file.model.effects, "[model] effects", problems)
    for i, (choice, _) in enumerate(file.models):
        check_effects(choice.effects, f"[[models]] {i + 1} effects", problems)
        if choice.name in [other.name for other, _ in file.models[:i]]:
            problems.add(f"[[models]] {i + 1} name", "stands twice; every model needs its own", choice.name)
    if file.plan is not None:
        check_plan(file.plan, file.loads, problems)
        _check_references(file, file.plan, problems)
        _check_budget(file, file.plan, problems)
    if file.reduce is not None and robot is not None:
        _check_beams(file.reduce, robot, problems)
    if robot is not None:
        for i, pose in enumerate(file.test_poses or []):
            check_test_pose(pose, robot, f"[[test_poses]] {i + 1} joints_deg", problems)
        for i, region in enumerate(file.test_regions or []):
            _check_region(region, robot, f"[[test_regions]] {i + 1}", problems)
        if file.constraints is not None:
            _check_margins(file.constraints, robot, problems)
        if file.plan is not None and file.plan.approach == "same":
            _check_approach(file.plan, file.constraints or ConstraintsSection(), robot, problems)
    check_cell(file, robot, problems)


def _check_markers(file: StudyFile, problems: Problems) -> None:
    """At least one marker on the flange; no name twice."""
    if file.markers is None or file.fixed_markers is None:
        return
    choices = file.marker_choices.points if file.marker_choices is not None else {}
    if not file.markers.points and not choices and not problems.found("[markers]"):
        problems.add("[markers]", "at least one marker expected, for example M1 = [300.0, 120.0, -80.0]")
    for table, names, other in (
        ("fixed_markers", file.fixed_markers.points, ("markers", file.markers.points)),
        ("marker_choices", choices, ("markers", file.markers.points)),
        ("marker_choices", choices, ("fixed_markers", file.fixed_markers.points)),
    ):
        for name in set(names) & set(other[1]):
            problems.add(f"[{table}] {name}", f"this id stands in [{other[0]}] too; every marker needs its own")


def _check_loads(file: StudyFile, robot: Robot | None, problems: Problems) -> None:
    """No id twice; nothing heavier than the payload."""
    loads = file.loads or []
    for i, load in enumerate(loads):
        first = [other.id for other in loads].index(load.id)
        if first < i:
            problems.add(
                f"[[loads]] {i + 1} id", f"[[loads]] {first + 1} has this id; every load needs its own", load.id
            )
    if robot is None or not math.isfinite(robot.payload):
        return
    share = file.constraints.payload_share if file.constraints is not None else 1.0
    allowed = robot.payload * share
    if robot.tool_mass > allowed * (1 + 1e-9):
        problems.add("[tool] mass_kg", f"load above payload: at most {allowed:g} kg", robot.tool_mass)
        return
    for i, load in enumerate(loads):
        if load.mass_kg + robot.tool_mass > allowed * (1 + 1e-9):
            tool = f" with {robot.tool_mass:g} kg of tool" if robot.tool_mass else ""
            of = f" ({share:g} of the rated payload {robot.payload:g} kg)" if share != 1 else " (the rated payload)"
            problems.add(
                f"[[loads]] {i + 1} mass_kg", f"load above payload{tool}: at most {allowed:g} kg{of}", load.mass_kg
            )


def _check_ranges(loads: list[LoadSection], plan: PlanSection, problems: Problems) -> None:
    """Ranges that hold the nominal value, of loads that load the robot and that the plan chooses from."""
    for i, load in enumerate(loads):
        reason = _no_choice(load, plan)
        for key in ("mass_range_kg", "attach_range_mm"):
            given, entry = getattr(load, key), f"[[loads]] {i + 1} {key}"
            if given is not None and reason is not None:
                problems.add(entry, reason, given)
            elif key == "mass_range_kg" and given is not None:
                _check_span(given, load.mass_kg, entry, "mass_kg", problems)
                if given[0] == 0.0 and not any(load.wrench):
                    problems.add(entry, "must begin above 0: without a mass nothing hangs", given)
            elif given is not None:
                for axis, first, last, nominal in zip("xyz", *given, load.attach_mm, strict=True):
                    _check_span([first, last], nominal, f"{entry}, {axis}", "attach_mm", problems)


def _no_choice(load: LoadSection, plan: PlanSection) -> str | None:
    """Why a load must have no ranges, or None."""
    if load.mass_kg == 0.0 and not any(load.wrench):
        return f"{load.id} is unloaded, so there is nothing to choose; give mass_kg inside the range, or leave it out"
    if plan.loads is not None and load.id not in plan.loads:
        return f"the plan does not choose {load.id}; add it to [plan] loads = {plan.loads}, or leave the range out"
    return None


def _check_span(ends: list[float], nominal: float, where: str, key: str, problems: Problems) -> None:
    """A lower end that is not above the upper one, and a nominal value between them."""
    first, last = ends
    if last < first:
        said = f"reversed: the lower end comes first, the upper end must be at least {first:g}"
        problems.add(where, said, ends)
    elif not first <= nominal <= last:
        said = f"must hold the nominal value {key} = {nominal:g}; widen the range or move the nominal value"
        problems.add(where, said, ends)


def _check_noise(noise: NoiseSection, problems: Problems) -> None:
    """Exactly one instrument, and it is not perfect (readings are divided by its noise)."""
    tracker = noise.tracker
    if noise.reading_mm is not None and tracker is not None:
        problems.add("[noise] reading_mm", "give reading_mm or the table [noise.tracker], not both", noise.reading_mm)
    elif noise.reading_mm == 0:
        problems.add("[noise] reading_mm", "must be above 0: readings are weighted by their noise", 0.0)
    elif noise.reading_mm is None and tracker is None:
        problems.add("[noise] reading_mm", "is missing; give it, or the table [noise.tracker]")
    if tracker is not None:
        for axis in ("radial", "transverse"):
            if getattr(tracker, f"{axis}_um") + getattr(tracker, f"{axis}_um_per_m") == 0:
                problems.add(f"[noise.tracker] {axis}_um", "this or its _per_m must be above 0", 0.0)


def check_effects(effects: Sequence[str], key: str, problems: Problems) -> None:
    """Note effects that are no ``name`` or ``name@where``, unknown or given twice."""
    for i, effect in enumerate(effects):
        name = effect.partition("@")[0]
        entry = f"{key}, entry {i + 1}"
        if name not in EFFECT_NAMES:
            problems.add(
                entry, f"unknown effect{nearest(name, EFFECT_NAMES)}; allowed: {', '.join(EFFECT_NAMES)}", effect
            )
        elif not _EFFECT.fullmatch(effect):
            problems.add(entry, "write name or name@where, for example joint_compliance@j2", effect)
        elif effect in effects[:i]:
            problems.add(entry, "stands twice", effect)


def check_plan(plan: PlanSection, loads: list[LoadSection] | None, problems: Problems) -> None:
    """Poses, a tolerance or a budget; loads that exist and load the robot."""
    aims = [aim for aim in ("poses", "tolerance_mm", *_BUDGETS) if getattr(plan, aim) is not None]
    if len(aims) > 1:
        choice = f"{', '.join(aims[:-1])} or {aims[-1]}"
        problems.add(f"[plan] {aims[0]}", f"give {choice}, not {'both' if len(aims) == 2 else 'all'}",
                     getattr(plan, aims[0]))  # fmt: skip
    for key in ("robust_to_losses", "draws"):
        if getattr(plan, key) and plan.criterion == "E":
            problems.add(f"[plan] {key}", "is not for criterion E; choose test_pose, A, D or G", getattr(plan, key))
        if getattr(plan, key) and aims and aims[0] in _BUDGETS:
            said = f"is not for {aims[0]}: exchanges do not look at costs; give poses or tolerance_mm"
            problems.add(f"[plan] {key}", said, getattr(plan, key))
    if plan.poses is not None and plan.robust_to_losses >= plan.poses:
        problems.add("[plan] robust_to_losses", f"must be below poses = {plan.poses}", plan.robust_to_losses)
    if plan.robust_to_losses and plan.references != "same_visit":
        said = (
            f'is not for references = "{plan.references}", where one experiment is several visits; write "same_visit"'
        )
        problems.add("[plan] robust_to_losses", said, plan.robust_to_losses)
    if loads is None or plan.loads is None:
        return
    known = {case.name: case for case in load_cases(loads)}
    for i, name in enumerate(plan.loads):
        if name not in known:
            problems.add(f"[plan] loads, entry {i + 1}", unknown("load", name, list(known)), name)
        elif name in plan.loads[:i]:
            problems.add(f"[plan] loads, entry {i + 1}", "stands twice", name)
    if all(name in known and known[name].unloaded for name in plan.loads):
        loaded = [name for name, case in known.items() if not case.unloaded]
        problems.add(
            "[plan] loads",
            f"no load among them loads the robot; loaded are: {', '.join(loaded) or 'none'}. Give a mass or a wrench "
            "under [[loads]], or leave the key out to plan unloaded readings",
            plan.loads,
        )
    elif plan.loads_per_pose > len(plan.loads):
        problems.add("[plan] loads_per_pose", f"at most {len(plan.loads)}, the number of loads", plan.loads_per_pose)


def _check_references(file: StudyFile, plan: PlanSection, problems: Problems) -> None:
    """Unloaded visits of their own need unloaded readings, and readings that are compared with the model."""
    if plan.references != "own_visits":
        return
    if not plan.reference_rows:
        problems.add("[plan] references", "needs reference_rows = true: there are no unloaded readings", "own_visits")
    if file.model is not None and file.model.reference == "differences":
        problems.add(
            "[plan] references",
            'not with [model] reference = "differences", which compares readings of one visit; write "same_visit"',
            "own_visits",
        )


def _check_budget(file: StudyFile, plan: PlanSection, problems: Problems) -> None:
    """A budget needs times or costs, and must reach beyond the start."""
    times, loads = file.times, file.loads or []
    if plan.time_budget_s is not None and times is not None:
        if times.pose_s == 0:
            problems.add(
                "[times] pose_s", "is missing or zero; [plan] time_budget_s needs the time of a pose, for example 60.0"
            )
        if times.start_s >= plan.time_budget_s:
            problems.add(
                "[plan] time_budget_s", f"must be above [times] start_s = {times.start_s:g}", plan.time_budget_s
            )
    if plan.cost_budget is not None and plan.pose_cost == 0:
        loaded = [case.name for case in load_cases(loads) if not case.unloaded]
        free = [load.id for load in loads if load.cost == 0 and load.id in (plan.loads or loaded)]
        if free or not loaded:
            what = f" or a cost to the loads {', '.join(free)}" if free else ""
            problems.add("[plan] cost_budget", f"visits would cost nothing: give pose_cost{what}", plan.cost_budget)


def _check_approach(plan: PlanSection, table: ConstraintsSection, robot: Robot, problems: Problems) -> None:
    """Every joint has room to come from below."""
    for slides, key, margin, unit in (
        (False, "approach_deg", table.joint_margin_deg, DEG),
        (True, "approach_mm", table.joint_margin_mm, MM),
    ):
        tight = [
            name
            for name, low, high, kind in zip(robot.joints, robot.lower, robot.upper, robot.prismatic, strict=True)
            if kind == slides and high - low <= (2 * margin + getattr(plan, key)) * unit
        ]
        if tight:
            problems.add(f"[plan] {key}", f"leaves no range to joint {', '.join(tight)}", getattr(plan, key))


def _check_beams(table: ReduceSection, robot: Robot, problems: Problems) -> None:
    """Beams of links that exist, with walls that fit into them."""
    links = [f"link{i}" for i in range(robot.n + 1)]
    for name, beam in table.beams.items():
        if name not in links:
            problems.add(f"[reduce.beams.{name}]", unknown("link", name, links))
        elif 2 * beam.wall_mm > beam.diameter_mm:
            problems.add(f"[reduce.beams.{name}] wall_mm", "at most half of diameter_mm", beam.wall_mm)


def check_test_pose(pose: ArmPoseSection, robot: Robot, key: str, problems: Problems) -> None:
    """One value a joint, inside its limits."""
    if len(pose.joints_deg) != robot.n:
        what = f"{robot.n} values expected, one a joint of {robot.name}, {len(pose.joints_deg)} given"
        problems.add(key, what, pose.joints_deg)
        return
    for j, (value, slides) in enumerate(zip(pose.joints_deg, robot.prismatic, strict=True)):
        unit, name = (MM, "mm") if slides else (DEG, "deg")
        low, high = robot.lower[j] / unit, robot.upper[j] / unit
        if not low - 1e-6 <= value <= high + 1e-6:
            problems.add(
                f"{key}, entry {j + 1}", f"outside the limits {low:g} to {high:g} {name} of {robot.joints[j]}", value
            )


def _check_region(region: TestRegionSection, robot: Robot, key: str, problems: Problems) -> None:
    """One value a joint; no end below its beginning; every joint comes inside its limits somewhere."""
    for name in ("joints_min_deg", "joints_max_deg"):
        given = getattr(region, name)
        if len(given) != robot.n:
            what = f"{robot.n} values expected, one a joint of {robot.name}, {len(given)} given"
            problems.add(f"{key} {name}", what, given)
    if problems.found(key):
        return
    for j, (first, last) in enumerate(zip(region.joints_min_deg, region.joints_max_deg, strict=True)):
        unit, name = (MM, "mm") if robot.prismatic[j] else (DEG, "deg")
        low, high = robot.lower[j] / unit, robot.upper[j] / unit
        if last < first:
            problems.add(f"{key} joints_max_deg, entry {j + 1}", f"below joints_min_deg = {first:g}: no pose", last)
        elif last < low - 1e-6 or first > high + 1e-6:
            what = f"{robot.joints[j]} goes from {low:g} to {high:g} {name}, the region up to {last:g}: no pose"
            problems.add(f"{key} joints_min_deg, entry {j + 1}", what, first)
    for j, (least, most) in enumerate(zip(region.wrench_min, region.wrench_max, strict=True)):
        if most < least:
            problems.add(f"{key} wrench_max, entry {j + 1}", f"below wrench_min = {least:g}: no wrench", most)


def _check_margins(table: ConstraintsSection, robot: Robot, problems: Problems) -> None:
    """The margins leave every joint a range."""
    for slides, key, unit in ((False, "joint_margin_deg", DEG), (True, "joint_margin_mm", MM)):
        margin = getattr(table, key)
        tight = [
            name
            for name, low, high, kind in zip(robot.joints, robot.lower, robot.upper, robot.prismatic, strict=True)
            if kind == slides and high - low <= 2 * margin * unit
        ]
        if margin and tight:
            problems.add(f"[constraints] {key}", f"leaves no range to joint {', '.join(tight)}", margin)
