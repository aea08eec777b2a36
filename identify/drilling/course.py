"""The commanded advance, and the course of a drilling: motion and forces against time."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from identify.arrays import Floats, frozen
from identify.drilling.cutting import Cutting, guidance
from identify.drilling.facing import Facing, across
from identify.errors import InputError
from identify.units import MM

__all__ = ["Drilling", "Feed"]


@dataclass(frozen=True)
class Feed:
    """The commanded advance: constant speed, then rest.

    Attributes:
        speed: m/s; 0.001 mm a revolution, as Li, Zhang, Fu, Wang drill, at 18000 revolutions a minute (assumed).
        gap: Between apex and board at the start, without deflection, m.
        overtravel: Commanded beyond the cone's leaving the far face, m. What the arms yield has to fit in.
        rest: Time at the end, s.
        step: Time step and sample time of the compensation, s.
    """

    speed: float = 0.3 * MM
    gap: float = 0.1 * MM
    overtravel: float = 0.5 * MM
    rest: float = 0.5
    step: float = 1e-3

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            InputError: A negative number, no speed, no step, or one that is not finite.
        """
        for field in fields(self):
            value, zero = getattr(self, field.name), field.name not in {"speed", "step"}
            if not (np.isfinite(value) and (value > 0.0 or (zero and value == 0.0))):
                raise InputError(
                    f"feed: {field.name} = {value:g}: a finite number, {'0 or more' if zero else 'above 0'}"
                )

    def depth(self, cutting: Cutting) -> tuple[Floats, Floats]:
        """Times (T,), s, and commanded depth of the apex (T,), m."""
        deepest = cutting.thickness + cutting.cone + self.overtravel
        count = int(np.ceil(((self.gap + deepest) / self.speed + self.rest) / self.step)) + 1
        time = np.asarray(self.step * np.arange(count), dtype=np.float64)
        return time, np.minimum(self.speed * time - self.gap, deepest)


@dataclass(frozen=True, eq=False)
class Drilling:
    """What happened in T time steps; base frame where nothing else is said.

    Attributes:
        facing: Both arms.
        cutting: Drill and board.
        time: (T,) s.
        depth: (T,) of the apex below the near face of the board, m; negative before contact.
        speed: (T,) its rate, m/s.
        wrench: (T, 6) force, N, and moment about the meeting point, Nm, on the drill tip; the board gets the opposite.
        deviation: (T, 6) motion of the drill against the board beside the commanded advance, m, then rad.
        drill_reading: (T, 6) sensor of the arm with the drill: force, N, and moment about the flange origin, Nm, in its
            flange frame, noise included, tool weight taken off.
        board_reading: (T, 6) the same of the arm with the board.
        corrections: (T, m) of the joints, order of `Facing`, rad, or m where a joint slides.
        contact_time: First touch, s; nan if never.
        breakthrough_time: The apex leaves the far face, s; nan if never.
        through_time: The whole cone has left it, s; nan if never.
    """

    facing: Facing
    cutting: Cutting
    time: Floats
    depth: Floats
    speed: Floats
    wrench: Floats
    deviation: Floats
    drill_reading: Floats
    board_reading: Floats
    corrections: Floats
    contact_time: float
    breakthrough_time: float
    through_time: float

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, field.name, frozen(value))

    @property
    def thrust(self) -> Floats:
        """(T,) axial force against the feed, N."""
        force: Floats = -self.wrench[:, :3] @ self.facing.feed
        return force

    @property
    def lateral_force(self) -> Floats:
        """(T,) size of the force across the feed, N."""
        return np.asarray(np.linalg.norm(self.wrench[:, :3] @ across(self.facing.feed), axis=1))

    @property
    def lateral_shift(self) -> Floats:
        """(T,) displacement of the tip across the feed, m."""
        return np.asarray(np.linalg.norm(self.deviation[:, :3] @ across(self.facing.feed), axis=1))

    @property
    def tilt(self) -> Floats:
        """(T,) angle by which the drill has left the feed direction, rad."""
        return np.asarray(np.linalg.norm(self.deviation[:, 3:] @ across(self.facing.feed), axis=1))

    @property
    def cuts(self) -> np.ndarray:
        """(T,) True from contact to the moment the cone has left the board."""
        inside: np.ndarray = (self.depth > 0.0) & (self.depth < self.cutting.thickness + self.cutting.cone)
        return inside

    @property
    def guided(self) -> np.ndarray:
        """(T,) True while it cuts and the hole holds it fully, one diameter deep or more: entering is over."""
        held: np.ndarray = self.cuts & (guidance(self.cutting, self.depth) == 1.0)
        return held
