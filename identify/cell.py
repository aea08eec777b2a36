"""The cell around a robot: obstacles, the instrument's view, and what the arm may carry. Frozen records in SI."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identify.arrays import Floats, frozen
from identify.robot import Robot

__all__ = ["Box", "Neighbour", "PayloadDiagram", "Station", "Visibility", "Wall"]


@dataclass(frozen=True, eq=False)
class Box:
    """A solid box.

    Attributes:
        name: Its name.
        centre: (3,) m, from the base origin; world axes, unless turned by `seen_from`.
        half: (3,) half its size along its own axes, m.
        rotation: (3, 3) its axes are the columns.
    """

    name: str
    centre: Floats
    half: Floats
    rotation: Floats

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("centre", "half", "rotation"):
            object.__setattr__(self, key, frozen(getattr(self, key)))

    def seen_from(self, world_R_base: Floats) -> Box:
        """The same box in base axes; ``world_R_base`` (3, 3)."""
        return replace(self, centre=world_R_base.T @ self.centre, rotation=world_R_base.T @ self.rotation)

    def local(self, points: Floats) -> Floats:
        """Points (..., 3) in the box's own frame, m."""
        inside: Floats = (points - self.centre) @ self.rotation
        return inside


@dataclass(frozen=True, eq=False)
class Neighbour:
    """Another arm that stands at its home pose while this one is measured.

    Attributes:
        name: Its id.
        robot: It, unloaded.
        q: (n,) its joint values, rad or m; shared joints are at zero.
        rotation: (3, 3) axes of its base in the base frame of this arm, as columns.
        origin: (3,) origin of its base there, m.
        shared: Number of joints, counted from the base, that both have in common; they turn it along.
        link_radius: Radius of its capsules, m; None: its robot file's, see `Constraints.link_radius`.
    """

    name: str
    robot: Robot
    q: Floats
    rotation: Floats
    origin: Floats
    shared: int = 0
    link_radius: float | None = None

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("q", "rotation", "origin"):
            object.__setattr__(self, key, frozen(getattr(self, key)))


@dataclass(frozen=True, eq=False)
class Wall:
    """A plane with a forbidden half space behind it.

    Attributes:
        name: Its name.
        point: (3,) on the plane, m, from the base origin; world axes, unless turned by `seen_from`.
        normal: (3,) unit vector into the free side.
    """

    name: str
    point: Floats
    normal: Floats

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("point", "normal"):
            object.__setattr__(self, key, frozen(getattr(self, key)))

    def seen_from(self, world_R_base: Floats) -> Wall:
        """The same wall in base axes; ``world_R_base`` (3, 3)."""
        return replace(self, point=world_R_base.T @ self.point, normal=world_R_base.T @ self.normal)

    def heights(self, points: Floats) -> Floats:
        """Distance (...) of points (..., 3) to the plane, m; negative behind it."""
        height: Floats = (points - self.point) @ self.normal
        return height


@dataclass(frozen=True, eq=False)
class PayloadDiagram:
    """Allowed mass against the distance of its centre from the flange centre.

    Attributes:
        distance: (k,) ascending, m.
        mass: (k,) kg, not ascending.
    """

    distance: Floats
    mass: Floats

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("distance", "mass"):
            object.__setattr__(self, key, frozen(getattr(self, key)))

    def allowed(self, distance: Floats) -> Floats:
        """Allowed mass (...) at distances (...), kg: linear between the points, nothing beyond the last one."""
        return np.asarray(np.interp(distance, self.distance, self.mass, right=0.0))


@dataclass(frozen=True, eq=False)
class Visibility:
    """What the tracker must see at a pose.

    Attributes:
        acceptance: Largest angle between a reflector's direction and its line to the tracker, rad; None: any.
        nearest: Least range, m.
        farthest: Largest range, m.
        occlusion: Arm, boxes and hung weight block the line of sight.
        required: Number of flange markers that must be seen; None: all of them.
    """

    acceptance: float | None = None
    nearest: float = 0.0
    farthest: float = float("inf")
    occlusion: bool = True
    required: int | None = None


@dataclass(frozen=True, eq=False)
class Station:
    """A place where the tracker can stand.

    Attributes:
        name: Its id.
        position: (3,) base frame, m.
    """

    name: str
    position: Floats

    def __post_init__(self) -> None:
        """Make the array read-only."""
        object.__setattr__(self, "position", frozen(self.position))
