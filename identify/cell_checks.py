"""What a study file says about the cell, checked: obstacles, limits of the arm, markers, stations and line of sight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identify.arrays import Floats
from identify.cell_sections import ConstraintsSection, PayloadDiagramSection, VisibilitySection
from identify.problems import Problems, unknown
from identify.robot import Robot
from identify.schema import PlanSection
from identify.study_file import StudyFile
from identify.study_records import constraints
from identify.units import DEG, MM

__all__ = ["check_cell"]


def check_cell(file: StudyFile, robot: Robot | None, problems: Problems) -> None:
    """Note what is wrong between values that describe the cell."""
    table = file.constraints
    _check_choices(file, problems)
    _check_normals(file, problems)
    if table is None:
        return
    for kind in ("boxes", "walls"):
        _check_names([item.name for item in getattr(table, kind)], f"[[constraints.{kind}]]", "name", problems)
    blank = [i for i, wall in enumerate(table.walls) if np.linalg.norm(wall.normal) < 1e-9]
    for i in blank:
        problems.add(f"[[constraints.walls]] {i + 1} normal", "a direction other than zero expected")
    if table.payload_diagram is not None:
        _check_diagram(table.payload_diagram, problems)
    if table.visibility is not None:
        _check_visibility(table.visibility, file, problems)
    if robot is not None:
        _check_arm(table, robot, problems)
        if not blank:
            _check_stations(table, file, robot, problems)


def _check_names(names: Sequence[str], heading: str, key: str, problems: Problems) -> None:
    """Note names that stand twice."""
    for i, name in enumerate(names):
        if name in names[:i]:
            problems.add(f"{heading} {i + 1} {key}", f"{heading} {names.index(name) + 1} has this {key}", name)


def _check_choices(file: StudyFile, problems: Problems) -> None:
    """Stations that exist, and as many markers as can be mounted."""
    stations = [station.id for station in file.tracker_stations or []]
    _check_names(stations, "[[tracker_stations]]", "id", problems)
    tracker = file.noise.tracker if file.noise is not None else None
    if stations and tracker is not None and tracker.station_mm is not None:
        problems.add("[noise.tracker] station_mm", "give it or [[tracker_stations]], not both", tracker.station_mm)
    plan = file.plan or PlanSection()
    for i, name in enumerate(plan.stations or []):
        if name not in stations and file.tracker_stations is not None:
            problems.add(f"[plan] stations, entry {i + 1}", unknown("station", name, stations), name)
        elif name in (plan.stations or [])[:i]:
            problems.add(f"[plan] stations, entry {i + 1}", "stands twice", name)
    if file.marker_choices is None:
        return
    choices = len(file.marker_choices.points)
    if choices and plan.markers is None:
        problems.add("[plan] markers", f"is missing: how many of the {choices} [marker_choices] are mounted?")
    elif plan.markers is not None and not choices and not problems.found("[marker_choices]"):
        problems.add("[plan] markers", "there are no [marker_choices] to choose from; leave it out", plan.markers)
    elif plan.markers is not None and plan.markers > choices:
        problems.add("[plan] markers", f"at most {choices}, the number of [marker_choices]", plan.markers)


def _flange_markers(file: StudyFile) -> list[str]:
    """Ids of all markers on the flange, those to choose from included."""
    tables = (file.markers, file.marker_choices)
    return [name for table in tables if table is not None for name in table.points]


def _check_normals(file: StudyFile, problems: Problems) -> None:
    """Directions of markers that are on the flange."""
    if file.marker_normals is None or file.markers is None or file.marker_choices is None:
        return
    known = _flange_markers(file)
    for name, direction in file.marker_normals.points.items():
        if name not in known:
            problems.add(f"[marker_normals] {name}", unknown("marker on the flange", name, known))
        elif np.linalg.norm(direction) < 1e-9:
            problems.add(f"[marker_normals] {name}", "a direction other than zero expected", direction)


def _check_diagram(table: PayloadDiagramSection, problems: Problems) -> None:
    """Distances ascend, masses do not."""
    key = "[constraints.payload_diagram]"
    if len(table.distance_mm) != len(table.mass_kg):
        what = f"one mass a distance expected: {len(table.distance_mm)} distances, {len(table.mass_kg)} masses"
        problems.add(f"{key} mass_kg", what, table.mass_kg)
    if (np.diff(table.distance_mm) <= 0).any():
        problems.add(f"{key} distance_mm", "ascending distances expected", table.distance_mm)
    if (np.diff(table.mass_kg) > 0).any():
        problems.add(f"{key} mass_kg", "must not rise: what hangs further out is never heavier", table.mass_kg)


def _check_visibility(table: VisibilitySection, file: StudyFile, problems: Problems) -> None:
    """Ranges, markers and stations that fit together."""
    key = "[constraints.visibility]"
    if table.max_range_mm is not None and table.min_range_mm >= table.max_range_mm:
        problems.add(f"{key} min_range_mm", f"must be below max_range_mm = {table.max_range_mm:g}", table.min_range_mm)
    tracker = file.noise.tracker if file.noise is not None else None
    stands = bool(file.tracker_stations) or (tracker is not None and tracker.station_mm is not None)
    if not stands and file.tracker_stations is not None and not problems.found("[noise"):
        problems.add(key, "the tracker stands nowhere; give [[tracker_stations]] or [noise.tracker] station_mm")
    if table.acceptance_deg is not None and file.marker_normals is not None and not file.marker_normals.points:
        what = "no marker has a direction; give them under [marker_normals], or leave this key out"
        problems.add(f"{key} acceptance_deg", what, table.acceptance_deg)
    if table.required is None or file.markers is None or file.marker_choices is None:
        return
    chosen = file.plan.markers if file.plan is not None and file.plan.markers is not None else 0
    mounted = len(file.markers.points) + chosen
    if table.required > mounted:
        problems.add(f"{key} required", f"at most {mounted}, the markers mounted on the flange", table.required)


def _check_arm(table: ConstraintsSection, robot: Robot, problems: Problems) -> None:
    """Home, wrist moments and torques of this robot."""
    _check_home(table, robot, problems)
    if table.wrist_moment_Nm is not None and robot.n < 3:
        problems.add("[constraints] wrist_moment_Nm", f"robot {robot.name} has only {robot.n} joints; leave it out")
    if table.torque_share is not None and not (robot.masses_known and np.isfinite(robot.efforts).any()):
        missing = "link masses (mass_kg, com_mm)" if not robot.masses_known else "rated torques (effort_Nm)"
        problems.add(
            "[constraints] torque_share",
            f"the robot file states no {missing}, so torques cannot be compared; state them or leave this key out",
            table.torque_share,
        )


def _check_home(table: ConstraintsSection, robot: Robot, problems: Problems) -> None:
    """One value a joint, inside the limits less the margin."""
    if table.home_deg is None:
        return
    if len(table.home_deg) != robot.n:
        what = f"{robot.n} values expected, one a joint of {robot.name}, {len(table.home_deg)} given"
        problems.add("[constraints] home_deg", what, table.home_deg)
        return
    unit = np.where(robot.prismatic, MM, DEG)
    margin = np.where(robot.prismatic, table.joint_margin_mm, table.joint_margin_deg)
    lower, upper = robot.lower / unit + margin, robot.upper / unit - margin
    for j, value in enumerate(table.home_deg):
        if not lower[j] - 1e-6 <= value <= upper[j] + 1e-6:
            problems.add(
                f"[constraints] home_deg, entry {j + 1}",
                f"outside {lower[j]:g} to {upper[j]:g}, the limits of {robot.joints[j]} less the margin",
                value,
            )


def _check_stations(table: ConstraintsSection, file: StudyFile, robot: Robot, problems: Problems) -> None:
    """No tracker inside a box, behind a wall or below the floor."""
    cell = constraints(table.model_copy(update={"home_deg": None}), robot.prismatic)
    for key, position in _stations(file):
        point = robot.world_R_base @ position
        for box in cell.boxes:
            if (np.abs(box.local(point)) < box.half).all():
                problems.add(key, f"the tracker stands inside box {box.name}; move one of them")
        for wall in cell.walls:
            if wall.heights(point) < 0:
                problems.add(
                    key, f"the tracker stands behind wall {wall.name}; move it, or turn the normal of the wall"
                )


def _stations(file: StudyFile) -> list[tuple[str, Floats]]:
    """Key and position of every place where the tracker can stand, base frame, m."""
    found = [
        (f"[[tracker_stations]] {i + 1} position_mm", np.array(station.position_mm) * MM)
        for i, station in enumerate(file.tracker_stations or [])
    ]
    tracker = file.noise.tracker if file.noise is not None else None
    if tracker is not None and tracker.station_mm is not None:
        found.append(("[noise.tracker] station_mm", np.array(tracker.station_mm) * MM))
    return found
