"""Checked tables of a study file as records in SI."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from identify.arrays import frozen
from identify.beams import Tube
from identify.cell import Box, PayloadDiagram, Station, Visibility, Wall
from identify.cell_sections import (
    ConstraintsSection,
    NormalsSection,
    PayloadDiagramSection,
    StationSection,
    VisibilitySection,
)
from identify.loads import LoadCase, LoadRange, Markers
from identify.robot import Robot
from identify.schema import (
    ArmPoseSection,
    LoadSection,
    NoiseSection,
    PlanSection,
    PointSection,
    ReduceSection,
    TestRegionSection,
    TimesSection,
    TrackerSection,
)
from identify.study import Constraints, Noise, PlanSettings, ReduceSettings, TestPose, TestRegion, Times, Tracker
from identify.transforms import roll_pitch_yaw
from identify.units import DEG, GPA, MM, UM, URAD

__all__ = [
    "constraints",
    "load_cases",
    "load_ranges",
    "markers",
    "noise_from",
    "plan_settings",
    "reduce_settings",
    "standing",
    "stations",
    "test_pose",
    "test_region",
    "times_from",
]


def markers(
    on_flange: PointSection | None,
    on_base: PointSection | None,
    choices: PointSection | None = None,
    normals: NormalsSection | None = None,
) -> Markers:
    """Markers of the flange, then those to choose from, then those of the base."""
    tables = [table.points if table else {} for table in (on_flange, choices, on_base)]
    names = tuple(name for points in tables for name in points)
    looks = {} if normals is None else normals.points
    directions = np.array([looks.get(name, [np.nan] * 3) for name in names]).reshape(-1, 3)
    return Markers(
        names=names,
        positions=np.array([point for points in tables for point in points.values()]).reshape(-1, 3) * MM,
        on_base=np.repeat([False, False, True], [len(points) for points in tables]),
        normals=directions / np.linalg.norm(directions, axis=1, keepdims=True),
    )


def stations(tables: Iterable[StationSection]) -> tuple[Station, ...]:
    """Where the tracker can stand."""
    return tuple(Station(table.id, frozen(table.position_mm) * MM) for table in tables)


def load_cases(tables: Iterable[LoadSection]) -> tuple[LoadCase, ...]:
    """The loads, with the unloaded state in front where the file has none."""
    cases = tuple(
        LoadCase(
            name=table.id,
            mass=table.mass_kg,
            attach=frozen(table.attach_mm) * MM,
            force=frozen(table.wrench[:3]),
            moment=frozen(table.wrench[3:]),
            in_flange=table.frame == "flange",
            mass_std=table.mass_std_kg,
            attach_std=table.attach_std_mm * MM,
            size=np.array(table.size_mm or [0.0] * 3) * MM,
            hang=table.hang_mm * MM,
        )
        for table in tables
    )
    if any(case.unloaded or case.name == "L0" for case in cases):
        return cases
    return (LoadCase("L0"), *cases)


def load_ranges(tables: Iterable[LoadSection]) -> dict[str, LoadRange]:
    """What a plan may choose, by id of a load; loads whose ranges leave no choice are left out."""
    found = {}
    for table in tables:
        masses = [table.mass_kg] * 2 if table.mass_range_kg is None else table.mass_range_kg
        places = [table.attach_mm] * 2 if table.attach_range_mm is None else table.attach_range_mm
        lower, upper = (np.append(mass, frozen(place) * MM) for mass, place in zip(masses, places, strict=True))
        span = LoadRange(table.id, lower, upper)
        if span.open.any():
            found[table.id] = span
    return found


def noise_from(table: NoiseSection, base: Noise) -> Noise:
    """Noise in SI; what the table does not say is taken from ``base``."""
    reading, tracker = base.reading, base.tracker
    if table.tracker is not None:
        reading, tracker = 0.0, _tracker(table.tracker)
    elif table.reading_mm is not None:
        reading, tracker = table.reading_mm * MM, None
    return Noise(
        reading=reading,
        tracker=tracker,
        pose_jitter=_scaled(table.pose_jitter_urad, URAD, base.pose_jitter),
        reading_jitter=_scaled(table.reading_jitter_urad, URAD, base.reading_jitter),
        orientation=_scaled(table.orientation_urad, URAD, base.orientation),
    )


def standing(noise: Noise, possible: Sequence[Station], named: Sequence[str]) -> Noise:
    """Noise of a tracker at the first of the named stations; a plan may choose another one of them."""
    if noise.tracker is None or not named:
        return noise
    first = next(station for station in possible if station.name == named[0])
    return replace(noise, tracker=replace(noise.tracker, station=first.position))


def _scaled(value: float | None, unit: float, default: float) -> float:
    """A value in SI, or the default where none is given."""
    return default if value is None else value * unit


def _tracker(table: TrackerSection) -> Tracker:
    """Range-dependent noise in SI."""
    return Tracker(
        radial=table.radial_um * UM,
        radial_per_m=table.radial_um_per_m * UM,
        transverse=table.transverse_um * UM,
        transverse_per_m=table.transverse_um_per_m * UM,
        station=None if table.station_mm is None else frozen(np.array(table.station_mm) * MM),
    )


def test_pose(table: ArmPoseSection, robot: Robot, weight: float) -> TestPose:
    """A test pose in SI."""
    return TestPose(
        q=np.array(table.joints_deg) * np.where(robot.prismatic, MM, DEG),
        wrench=frozen(table.wrench),
        in_flange=table.frame == "flange",
        attach=frozen(table.attach_mm) * MM,
        point=frozen(table.attach_mm if table.point_mm is None else table.point_mm) * MM,
        weight=weight,
    )


def test_region(table: TestRegionSection, robot: Robot) -> TestRegion:
    """A test region in SI."""
    units = np.where(robot.prismatic, MM, DEG)
    return TestRegion(
        lower=np.array(table.joints_min_deg) * units,
        upper=np.array(table.joints_max_deg) * units,
        wrench_lower=frozen(table.wrench_min),
        wrench_upper=frozen(table.wrench_max),
        in_flange=table.frame == "flange",
        attach=frozen(table.attach_mm) * MM,
        point=frozen(table.attach_mm if table.point_mm is None else table.point_mm) * MM,
        weight=table.weight,
        points=table.points,
    )


def plan_settings(table: PlanSection, loads: Sequence[LoadCase], possible: Sequence[Station] = ()) -> PlanSettings:
    """What the plan is asked for, in SI; it chooses among all possible stations unless it names some."""
    aims = (table.poses, table.tolerance_mm, table.time_budget_s, table.cost_budget)
    poses = 15 if all(aim is None for aim in aims) else table.poses
    loaded = [load.name for load in loads if not load.unloaded]
    return PlanSettings(
        poses=poses,
        tolerance=None if table.tolerance_mm is None else table.tolerance_mm * MM,
        confidence=table.confidence,
        loads=tuple(loaded if table.loads is None else table.loads),
        criterion=table.criterion,
        candidates=table.candidates,
        refine=table.refine,
        loads_per_pose=table.loads_per_pose,
        settings_per_load=table.settings_per_load,
        reference_rows=table.reference_rows,
        repeats=table.repeats,
        max_std_percent=table.max_std_percent,
        stations=tuple([station.name for station in possible] if table.stations is None else table.stations),
        markers=table.markers,
        curve=table.curve,
        restarts=table.restarts,
        losses=table.robust_to_losses,
        draws=table.draws,
        references=table.references,
        approach=table.approach,
        approach_turn=table.approach_deg * DEG,
        approach_slide=table.approach_mm * MM,
        time_budget=table.time_budget_s,
        cost_budget=table.cost_budget,
        pose_cost=table.pose_cost,
    )


def times_from(table: TimesSection) -> Times:
    """How long measuring takes, in SI."""
    return Times(
        pose=table.pose_s,
        reading=table.reading_s,
        load_change=table.load_change_s,
        speed=np.inf if table.speed_deg_s is None else table.speed_deg_s * DEG,
        speed_slide=np.inf if table.speed_mm_s is None else table.speed_mm_s * MM,
        start=table.start_s,
    )


def constraints(table: ConstraintsSection, slides: np.ndarray) -> Constraints:
    """What poses must keep to, in SI; ``slides`` (n,) is True for sliding joints."""
    return Constraints(
        joint_margin=table.joint_margin_deg * DEG,
        joint_margin_slide=table.joint_margin_mm * MM,
        floor=None if table.floor_mm is None else table.floor_mm * MM,
        payload_share=table.payload_share,
        self_collision=table.self_collision,
        link_radius=None if table.link_radius_mm is None else table.link_radius_mm * MM,
        clearance=table.clearance_mm * MM,
        boxes=tuple(
            Box(
                box.name,
                np.array(box.centre_mm) * MM,
                np.array(box.size_mm) * MM / 2,
                roll_pitch_yaw(np.array(box.rpy_deg) * DEG),
            )
            for box in table.boxes
        ),
        walls=tuple(
            Wall(wall.name, np.array(wall.point_mm) * MM, np.array(wall.normal) / np.linalg.norm(wall.normal))
            for wall in table.walls
        ),
        home=None if table.home_deg is None else np.array(table.home_deg) * np.where(slides, MM, DEG),
        payload_diagram=_payload_diagram(table.payload_diagram),
        wrist_moment=None if table.wrist_moment_Nm is None else np.array(table.wrist_moment_Nm),
        torque_share=table.torque_share,
        visibility=_visibility(table.visibility),
    )


def _payload_diagram(table: PayloadDiagramSection | None) -> PayloadDiagram | None:
    """The payload diagram in SI."""
    return None if table is None else PayloadDiagram(np.array(table.distance_mm) * MM, np.array(table.mass_kg))


def _visibility(table: VisibilitySection | None) -> Visibility | None:
    """What the tracker must see, in SI."""
    if table is None:
        return None
    return Visibility(
        acceptance=None if table.acceptance_deg is None else table.acceptance_deg * DEG,
        nearest=table.min_range_mm * MM,
        farthest=float("inf") if table.max_range_mm is None else table.max_range_mm * MM,
        occlusion=table.occlusion,
        required=table.required,
    )


def reduce_settings(table: ReduceSection) -> ReduceSettings:
    """How the model is reduced, in SI; names of beams have been checked."""
    tubes = {
        int(name.removeprefix("link")): Tube(
            length=beam.length_mm * MM,
            diameter=beam.diameter_mm * MM,
            wall=beam.wall_mm * MM,
            young=beam.young_GPa * GPA,
            poisson=beam.poisson,
        )
        for name, beam in table.beams.items()
    }
    return ReduceSettings(
        table.configurations, table.targets, table.directions, tuple(table.prefer), MappingProxyType(tubes)
    )
