"""The tables of a study file together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from identify.cell_sections import ConstraintsSection, NormalsSection, StationSection
from identify.schema import (
    FramesSection,
    LoadSection,
    ModelChoiceSection,
    ModelSection,
    NoiseSection,
    PlanSection,
    PointSection,
    ReduceSection,
    RobotSection,
    Section,
    TestPoseSection,
    TestRegionSection,
    TimesSection,
    ToolSection,
)

__all__ = ["STUDY_SECTIONS", "StudyFile"]

#: Tables of a study file and the schema of each; the second entry is True where the file holds a list of tables.
STUDY_SECTIONS: dict[str, tuple[type[Section], bool]] = {
    "robot": (RobotSection, False),
    "tool": (ToolSection, False),
    "markers": (PointSection, False),
    "fixed_markers": (PointSection, False),
    "marker_choices": (PointSection, False),
    "marker_normals": (NormalsSection, False),
    "tracker_stations": (StationSection, True),
    "loads": (LoadSection, True),
    "noise": (NoiseSection, False),
    "frames": (FramesSection, False),
    "model": (ModelSection, False),
    "test_poses": (TestPoseSection, True),
    "test_regions": (TestRegionSection, True),
    "plan": (PlanSection, False),
    "constraints": (ConstraintsSection, False),
    "reduce": (ReduceSection, False),
    "times": (TimesSection, False),
}


@dataclass(frozen=True)
class StudyFile:
    """The checked tables of a study file; None where a table is missing or wrong."""

    robot: RobotSection | None
    tool: ToolSection | None
    markers: PointSection | None
    fixed_markers: PointSection | None
    marker_choices: PointSection | None
    marker_normals: NormalsSection | None
    tracker_stations: list[StationSection] | None
    loads: list[LoadSection] | None
    noise: NoiseSection | None
    frames: FramesSection | None
    model: ModelSection | None
    test_poses: list[TestPoseSection] | None
    test_regions: list[TestRegionSection] | None
    plan: PlanSection | None
    constraints: ConstraintsSection | None
    reduce: ReduceSection | None
    times: TimesSection | None
    options: Mapping[str, Mapping[str, Any]]
    models: list[tuple[ModelChoiceSection, Mapping[str, Mapping[str, Any]]]]
