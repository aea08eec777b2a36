"""What hangs on the flange: load cases, what a plan may choose of them, and measuring points."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from identify.arrays import Floats, frozen

__all__ = ["LoadCase", "LoadRange", "Markers"]


@dataclass(frozen=True, eq=False)
class LoadCase:
    """One load: a hung mass and/or a wrench at a point of the flange.

    Attributes:
        name: Its id in tables.
        mass: Hung mass, kg; its weight acts along world -z.
        attach: (3,) where it acts, flange frame, m.
        force: (3,) N, added to the weight.
        moment: (3,) Nm about the attach point.
        in_flange: True if force and moment turn with the flange; else they are world vectors.
        mass_std: 1 sigma of the mass, kg.
        attach_std: 1 sigma of each coordinate of the attach point, m.
        size: (3,) of the hung body, m: upright, its sides along the world axes; zero: a point.
        hang: Length of the rope between attach point and body, m.
    """

    name: str
    mass: float = 0.0
    attach: Floats = field(default_factory=lambda: frozen(np.zeros(3)))
    force: Floats = field(default_factory=lambda: frozen(np.zeros(3)))
    moment: Floats = field(default_factory=lambda: frozen(np.zeros(3)))
    in_flange: bool = False
    mass_std: float = 0.0
    attach_std: float = 0.0
    size: Floats = field(default_factory=lambda: frozen(np.zeros(3)))
    hang: float = 0.0

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("attach", "force", "moment", "size"):
            object.__setattr__(self, key, frozen(getattr(self, key)))

    @property
    def unloaded(self) -> bool:
        """True if nothing is hung and no wrench acts."""
        return self.mass == 0.0 and not self.force.any() and not self.moment.any()

    @property
    def depth(self) -> float:
        """How far the lowest point hangs below the attach point, m."""
        return self.hang + float(self.size[2])


@dataclass(frozen=True, eq=False)
class LoadRange:
    """What a plan may choose of one load: mass, kg, and attach point x, y, z, flange frame, m.

    Attributes:
        of: Id of the load in the study file; several settings of one load share it.
        lower: (4,) least values.
        upper: (4,) largest values; equal to ``lower`` where there is no choice.
    """

    of: str
    lower: Floats
    upper: Floats

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("lower", "upper"):
            object.__setattr__(self, key, frozen(getattr(self, key)))

    @property
    def open(self) -> np.ndarray:
        """(4,) True for values that may be chosen."""
        return np.asarray(self.upper > self.lower)


@dataclass(frozen=True, eq=False)
class Markers:
    """Measuring points.

    Attributes:
        names: Their ids, flange markers first.
        positions: (M, 3) m, in the flange frame (or the base frame where ``on_base``).
        on_base: (M,) True for targets on the base or the floor.
        normals: (M, 3) unit vectors into which the reflectors look, flange frame; nan where not stated.
    """

    names: tuple[str, ...]
    positions: Floats
    on_base: np.ndarray
    normals: Floats = field(default_factory=lambda: frozen(np.zeros((0, 3))))

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        object.__setattr__(self, "positions", frozen(self.positions))
        object.__setattr__(self, "on_base", frozen(self.on_base, bool))
        normals = self.normals if len(self.normals) else np.full((len(self.names), 3), np.nan)
        object.__setattr__(self, "normals", frozen(normals))

    def without(self, names: Collection[str]) -> Markers:
        """All markers but those of these names."""
        kept = [i for i, name in enumerate(self.names) if name not in names]
        return Markers(tuple(self.names[i] for i in kept), self.positions[kept], self.on_base[kept], self.normals[kept])
