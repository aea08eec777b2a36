"""What a study file may say about the cell: obstacles, limits of the arm, line of sight, possible stations."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from identify.schema import Count, Id, NotNegative, Number, Positive, Section, Switch, Vector

__all__ = [
    "BoxSection",
    "ConstraintsSection",
    "NormalsSection",
    "PayloadDiagramSection",
    "StationSection",
    "VisibilitySection",
    "WallSection",
]

Size = Annotated[list[Positive], Field(min_length=3, max_length=3)]
Moments = Annotated[list[Positive], Field(min_length=3, max_length=3)]


class BoxSection(Section):
    """One of ``[[constraints.boxes]]``."""

    name: Id
    centre_mm: Vector
    size_mm: Size
    rpy_deg: Vector = Field(default_factory=lambda: [0.0] * 3)


class WallSection(Section):
    """One of ``[[constraints.walls]]``."""

    name: Id
    point_mm: Vector
    normal: Vector


class PayloadDiagramSection(Section):
    """``[constraints.payload_diagram]``."""

    distance_mm: Annotated[list[NotNegative], Field(min_length=1)]
    mass_kg: Annotated[list[NotNegative], Field(min_length=1)]


class VisibilitySection(Section):
    """``[constraints.visibility]``."""

    acceptance_deg: Annotated[Positive, Field(le=180)] | None = None
    min_range_mm: NotNegative = 0.0
    max_range_mm: Positive | None = None
    occlusion: Switch = True
    required: Count | None = None


class ConstraintsSection(Section):
    """``[constraints]``."""

    joint_margin_deg: NotNegative = 0.0
    joint_margin_mm: NotNegative = 0.0
    floor_mm: Number | None = None
    payload_share: Positive = 1.0
    self_collision: Switch = True
    link_radius_mm: Positive | None = None
    clearance_mm: NotNegative = 0.0
    boxes: list[BoxSection] = Field(default_factory=list)
    walls: list[WallSection] = Field(default_factory=list)
    home_deg: list[Number] | None = None
    payload_diagram: PayloadDiagramSection | None = None
    wrist_moment_Nm: Moments | None = None
    torque_share: Positive | None = None
    visibility: VisibilitySection | None = None


class NormalsSection(Section):
    """``[marker_normals]``: id -> direction into which the reflector looks, flange frame."""

    points: dict[Id, Vector]


class StationSection(Section):
    """One of ``[[tracker_stations]]``."""

    id: Id
    position_mm: Vector
