"""What study and truth files may hold: one schema a table, unknown keys forbidden, units in the keys.

Only shapes and single values are checked here; what several values say together is checked in
`identify.study_checks`. The tables of the cell stand in `identify.cell_sections`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

__all__ = [
    "EFFECT_NAMES",
    "BeamSection",
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
    "TestPoseSection",
    "TestRegionSection",
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
    size_mm: Annotated[list[Positive], Field(min_length=3, max_length=3)] | None = None
    hang_mm: NotNegative = 0.0
    mass_range_kg: Annotated[list[NotNegative], Field(min_length=2, max_length=2)] | None = None
    attach_range_mm: Annotated[list[Vector], Field(min_length=2, max_length=2)] | None = None
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
    nominal_std_percent: dict[str, Positive] = {}


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


class TestRegionSection(Section):
    """One of ``[[test_regions]]``."""

    __test__ = False

    joints_min_deg: list[Number]
    joints_max_deg: list[Number]
    wrench_min: Wrench = [0.0] * 6
    wrench_max: Wrench = [0.0] * 6
    frame: Axes = "world"
    attach_mm: Vector = [0.0, 0.0, 0.0]
    point_mm: Vector | None = None
    weight: Positive = 1.0
    points: Annotated[Count, Field(le=4096)] = 64


class TwoArmPlanSection(Section):
    """``[plan]`` of two arms: what is common to them."""

    poses: Count | None = None
    tolerance_mm: Positive | None = None
    confidence: Annotated[Positive, Field(lt=1)] = 0.95
    criterion: Literal["test_pose", "A", "D", "E", "G"] = "test_pose"
    candidates: Annotated[Count, Field(le=10_000_000)] = 10_000
    refine: Switch = True
    repeats: Switch = True
    max_std_percent: Positive = 300.0
    curve: Switch = True


class PlanSection(TwoArmPlanSection):
    """``[plan]``."""

    loads: Annotated[list[Id], Field(min_length=1)] | None = None
    loads_per_pose: Count = 1
    settings_per_load: Annotated[Count, Field(le=64)] = 8
    reference_rows: Switch = True
    stations: Annotated[list[Id], Field(min_length=1)] | None = None
    markers: Count | None = None
    restarts: Annotated[int, Field(strict=True, ge=1, le=1000)] = 1
    robust_to_losses: Annotated[int, Field(strict=True, ge=0, le=2)] = 0
    draws: Annotated[int, Field(strict=True, ge=0, le=64)] = 0
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
