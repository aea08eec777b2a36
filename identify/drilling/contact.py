"""The wrench between drill and board at one instant: the hole's springs, the cutting force, what the arms yield."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, frozen
from identify.drilling.cutting import Cutting, engagement, guidance
from identify.drilling.facing import Facing, across

__all__ = ["Contact", "Hole", "contact_of", "wrench_on_drill"]


@dataclass(frozen=True, eq=False)
class Contact:
    """What does not change during a run, base frame; 6-vectors hold displacement and turn, or force and moment.

    Attributes:
        cutting: Drill and board.
        axis: (6,) the feed.
        arms: (6, 6) motion of the drill against the board per wrench on its tip, from the joints of both arms, SI.
        yields: (6, 6) the same with the bending of the board.
        guide: (6, 6) stiffness of the fully guided drill, N/m and Nm/rad.
        step: Time step, s.
    """

    cutting: Cutting
    axis: Floats
    arms: Floats
    yields: Floats
    guide: Floats
    step: float

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for key in ("axis", "arms", "yields", "guide"):
            object.__setattr__(self, key, frozen(getattr(self, key)))


@dataclass(eq=False)
class Hole:
    """What one step hands to the next: the hole as drilled so far.

    Attributes:
        depth: Deepest place of the apex, m.
        rubbing: Lateral force of the last step, N.
        start: (6,) lateral place and tilt of the drill at first touch; None before.
        lean: (6,) how the hole leaves the feed direction per depth: it follows the axis of the drill at first touch.
    """

    depth: float = 0.0
    rubbing: float = 0.0
    start: Floats | None = None
    lean: Floats | None = None


def contact_of(facing: Facing, cutting: Cutting, step: float) -> Contact:
    """Compliance and guidance of both arms at the drill tip, base frame, for time steps of ``step``, s."""
    axis = np.concatenate([facing.feed, np.zeros(3)])
    plane = across(facing.feed)
    guide = np.zeros((6, 6))
    guide[:3, :3], guide[3:, 3:] = cutting.lateral_stiffness * plane, cutting.tilt_stiffness * plane
    bending = cutting.plate_compliance * np.outer(axis, axis)
    arms = facing.motion_per_wrench(facing.compliance)
    return Contact(cutting, axis, arms, arms + bending, guide, step)


def wrench_on_drill(contact: Contact, hole: Hole, free: Floats) -> Floats:
    """Wrench (6,) on the drill tip that would stand at ``free`` if it met nothing; brings the hole up to date.

    ``free`` (6,) is the place of the tip against the near face, m, and its tilt, rad. The lateral springs are
    eliminated first; what is left is one equation for the axial force.
    """
    if hole.start is None or hole.lean is None:
        if free @ contact.axis <= 0.0:
            return np.zeros(6)
        hole.start = free - (free @ contact.axis) * contact.axis
        hole.lean = np.concatenate([np.cross(free[3:], contact.axis[:3]), np.zeros(3)])
    guide = guidance(contact.cutting, hole.depth) * contact.guide
    out_of_place = free - hole.start - hole.depth * hole.lean
    sides = np.stack([-guide @ out_of_place, contact.axis], axis=1)
    at_rest, per_thrust = np.linalg.solve(np.eye(6) + guide @ contact.yields, sides).T
    ahead = contact.axis @ (free + contact.yields @ at_rest)
    softness = float(contact.axis @ contact.yields @ per_thrust)
    thrust = _thrust(contact, hole, ahead - hole.depth, softness)
    wrench: Floats = at_rest - thrust * per_thrust
    hole.depth = max(hole.depth, float(ahead - softness * thrust))
    hole.rubbing = float(np.linalg.norm(wrench[:3] - (wrench @ contact.axis) * contact.axis[:3]))
    return wrench


def _thrust(contact: Contact, hole: Hole, bite: float, softness: float) -> float:
    """Axial force, N, if the apex would be ``bite``, m, deeper than the hole without it; implicit in the speed.

    It holds the drill back to the bottom of the hole at most, and never pulls.
    """
    if bite <= 0.0:
        return 0.0
    cutting = contact.cutting
    engaged = float(engagement(cutting, hole.depth))
    slowing = engaged * cutting.drag / contact.step
    resisting = engaged * cutting.edge_force + cutting.friction * hole.rubbing
    thrust = (resisting + slowing * bite) / (1.0 + slowing * softness)
    return min(thrust, bite / softness) if softness > 0.0 else thrust
