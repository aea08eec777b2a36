"""What study and truth files may hold: one schema a table, unknown keys forbidden, units in the keys.

Only shapes and single values are checked here; what several values say together is checked in
`identify.study_checks`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

__all__ = [
    "EFFECT_NAMES",
    "STUDY_SECTIONS",
    "BeamSection",
    "ConstraintsSection",
    "FramesSection",
    "LoadSection",
    "ModelChoiceSection",
    "ModelSection",
    "NoiseSection",
    "PlanSection",
    "PointSection",
    "ReduceSection",
    "RobotSection",
    "Section",
    "StudyFile",
    "TestPoseSection",
    "TimesSection",
    "ToolSection",
    "TrackerSection",
    "TruthSection",
]

#: Names of causes, which are also the names of model effects.
EFFECT_NAMES = (
    "joint_compliance", "link_compliance", "gravity_compensator", "base_compliance", "tool_compliance",
    "joint_cross_compliance", "joint_hardening", "joint_windup", "backlash", "stiction", "approach_hysteresis",
    "transmission_error", "wrist_coupling", "geometry", "link_mass", "load_com", "load_level", "load_scale",
    "load_direction", "force_sensor_bias", "thermal_growth", "tracker_drift", "tracker_step", "tracker_scale",
    "marker_seating", "data_fault", "range_noise",
)  # fmt: skip

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Count = Annotated[int, Field(strict=True, gt=0)]
Vector = Annotated[list[Number], Field(min_length=3, max_length=3)]
Wrench = Annotated[list[Number], Field(min_length=6, max_length=6)]
Text = Annotated[str, Field(strict=True, min_length=1)]
Id = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z0-9_.-]+$")]
Axes = Literal["world", "flange"]
Switch = Annotated[bool, Field(strict=True)]


class Section(BaseModel):
    """A table of a TOML file: frozen, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class RobotSection(Section):
    """``[robot]``."""

    model: Text
    flange: Text | None = None
    base: Text | None = None
    mount_deg: Vector = [0.0, 0.0, 0.0]
    gravity_ms2: Annotated[NotNegative, Field(le=100)] | None = None


class ToolSection(Section):
    """``[tool]``."""

    mass_kg: NotNegative = 0.0
    com_mm: Vector = [0.0, 0.0, 0.0]


class PointSection(Section):
    """``[markers]`` and ``[fixed_markers]``: id -> coordinates, mm."""

    points: dict[Id, Vector]


class LoadSection(Section):
    """One of ``[[loads]]``."""

    id: Id
    mass_kg: NotNegative = 0.0
    mass_std_kg: NotNegative = 0.0
    attach_mm: Vector = [0.0, 0.0, 0.0]
    attach_std_mm: NotNegative = 0.0
    wrench: Wrench = [0.0] * 6
    frame: Axes = "world"
    cost: NotNegative = 0.0


class TrackerSection(Section):
    """``[noise.tracker]``."""

    radial_um: NotNegative = 0.0
    radial_um_per_m: NotNegative = 0.0
    transverse_um: NotNegative = 0.0
    transverse_um_per_m: NotNegative = 0.0
    station_mm: Vector | None = None


class NoiseSection(Section):
    """``[noise]``."""

    reading_mm: NotNegative | None = None
    tracker: TrackerSection | None = None
    pose_jitter_urad: NotNegative | None = None
    reading_jitter_urad: NotNegative | None = None
    orientation_urad: NotNegative | None = None


class FramesSection(Section):
    """``[frames]``."""

    measurement: Literal["free", "base"] = "free"
    markers: Literal["nominal", "exact"] = "nominal"


class ModelSection(Section):
    """``[model]`` without the tables of options."""

    effects: list[Text] = ["joint_compliance"]
    reference: Literal["absolute", "differences", "auto"] = "auto"
    equilibrium: Literal["linear", "loaded"] = "linear"
    rows: Literal["vectors", "dual_quaternions", "dual_quaternion_deviations"] = "vectors"
    nominal: dict[str, Number] = {}


class ModelChoiceSection(Section):
    """One of ``[[models]]`` without the tables of options."""

    name: Id
    effects: list[Text]


class ArmPoseSection(Section):
    """What one arm does at a test pose."""

    joints_deg: list[Number]
    wrench: Wrench = [0.0] * 6
    frame: Axes = "world"
    attach_mm: Vector = [0.0, 0.0, 0.0]
    point_mm: Vector | None = None


class TestPoseSection(ArmPoseSection):
    """One of ``[[test_poses]]``."""

    __test__ = False

    weight: Positive = 1.0


class TwoArmPlanSection(Section):
    """``[plan]`` of two arms: what is common to them."""

    poses: Count | None = None
    tolerance_mm: Positive | None = None
    confidence: Annotated[Positive, Field(lt=1)] = 0.95
    criterion: Literal["test_pose", "A", "D", "E", "G"] = "test_pose"
    candidates: Count = 10_000
    refine: Switch = True
    repeats: Switch = True
    max_std_percent: Positive = 300.0


class PlanSection(TwoArmPlanSection):
    """``[plan]``."""

    loads: Annotated[list[Id], Field(min_length=1)] | None = None
    loads_per_pose: Count = 1
    reference_rows: Switch = True
    references: Literal["same_visit", "own_visits", "auto"] = "same_visit"
    approach: Literal["any", "same"] = "any"
    approach_deg: Positive = 2.0
    approach_mm: Positive = 2.0
    time_budget_s: Positive | None = None
    cost_budget: Positive | None = None
    pose_cost: NotNegative = 0.0


class TimesSection(Section):
    """``[times]``."""

    pose_s: NotNegative = 0.0
    reading_s: NotNegative = 0.0
    load_change_s: NotNegative = 0.0
    speed_deg_s: Positive | None = None
    speed_mm_s: Positive | None = None
    start_s: NotNegative = 0.0


class ArmSection(Section):
    """One of ``[[arms]]``."""

    name: Id
    study: Text
    base_mm: Vector = [0.0, 0.0, 0.0]


class WaistSection(Section):
    """``[waist]``."""

    shared_joints: Annotated[int, Field(strict=True, ge=0)] = 0


class ConstraintsSection(Section):
    """``[constraints]``."""

    joint_margin_deg: NotNegative = 0.0
    joint_margin_mm: NotNegative = 0.0
    floor_mm: Number | None = None
    payload_share: Positive = 1.0
    self_collision: Switch = True
    link_radius_mm: Positive | None = None


class BeamSection(Section):
    """One of ``[reduce.beams.link<i>]``: a tube along local x."""

    length_mm: Positive
    diameter_mm: Positive
    wall_mm: Positive
    young_GPa: Positive = 210.0
    poisson: Annotated[NotNegative, Field(lt=0.5)] = 0.3


class ReduceSection(Section):
    """``[reduce]``."""

    configurations: Annotated[Count, Field(le=100_000)] = 150
    targets: Literal["position", "pose"] = "position"
    directions: Literal["loads", "forces", "wrenches"] = "loads"
    prefer: list[Text] = []
    beams: dict[str, BeamSection] = {}


class TruthSection(Section):
    """``[truth]`` without the tables of options."""

    effects: list[Text] | None = None
    values: dict[str, Number] = {}


#: Tables of a study file and the schema of each; the second entry is True where the file holds a list of tables.
STUDY_SECTIONS: dict[str, tuple[type[Section], bool]] = {
    "robot": (RobotSection, False),
    "tool": (ToolSection, False),
    "markers": (PointSection, False),
    "fixed_markers": (PointSection, False),
    "loads": (LoadSection, True),
    "noise": (NoiseSection, False),
    "frames": (FramesSection, False),
    "model": (ModelSection, False),
    "test_poses": (TestPoseSection, True),
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
    loads: list[LoadSection] | None
    noise: NoiseSection | None
    frames: FramesSection | None
    model: ModelSection | None
    test_poses: list[TestPoseSection] | None
    plan: PlanSection | None
    constraints: ConstraintsSection | None
    reduce: ReduceSection | None
    times: TimesSection | None
    options: Mapping[str, Mapping[str, Any]]
    models: list[tuple[ModelChoiceSection, Mapping[str, Mapping[str, Any]]]]
