"""What a twist drill and a board do to each other: axial force from the feed, guidance by the hole.

Values that no source states for this process are marked "assumed": orders of magnitude for a carbide drill of 0.5 mm
in glass fibre laminate, to be replaced by measured ones.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from identify.arrays import Floats
from identify.errors import InputError
from identify.units import DEG, GPA, MM, UM

__all__ = ["Cutting", "engagement", "guidance"]


@dataclass(frozen=True)
class Cutting:
    """Drill and board. Diameter, carbide and thickness: Li, Zhang, Fu, Wang, section 5; the rest is assumed.

    Attributes:
        thickness: Of the board, m.
        diameter: Of the drill, m.
        point_angle: Full angle of the tip cone, rad. Assumed.
        revolutions: Of the spindle, 1/s. Assumed.
        edge_force: Axial force of the full cone at no feed, N. Assumed.
        specific_thrust: Axial force per diameter/2 and feed per revolution, N/m^2. Assumed.
        friction: Axial share of the lateral force, from rubbing in the hole. Assumed.
        overhang: Length of drill that bends, m. Assumed.
        modulus: Young's modulus of the drill, Pa. Assumed (carbide).
        foil: Thickness of the copper on each face, m. Assumed (one ounce per square foot).
        foil_factor: Axial force in copper over that in laminate; 1: none.
        plate_compliance: Bending of the board along the feed per axial force, m/N; 0: rigid.
    """

    thickness: float = 2.0 * MM
    diameter: float = 0.5 * MM
    point_angle: float = 130.0 * DEG
    revolutions: float = 300.0
    edge_force: float = 3.0
    specific_thrust: float = 2000.0 / MM**2
    friction: float = 0.3
    overhang: float = 8.0 * MM
    modulus: float = 600.0 * GPA
    foil: float = 35.0 * UM
    foil_factor: float = 1.0
    plate_compliance: float = 0.0

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            InputError: A number that is not finite or has the wrong sign, a tip that is no cone, or foils thicker than
                the board.
        """
        positive = {"thickness", "diameter", "point_angle", "revolutions", "overhang", "modulus"}
        for field in fields(self):
            value, zero = getattr(self, field.name), field.name not in positive
            if not (np.isfinite(value) and (value > 0.0 or (zero and value == 0.0))):
                raise InputError(f"{field.name} = {value:g}: a finite number, {'0 or more' if zero else 'above 0'}")
        if self.point_angle >= np.pi:
            raise InputError(f"point_angle = {self.point_angle / DEG:g} deg: below 180 deg")
        if 2.0 * self.foil > self.thickness:
            raise InputError(
                f"foil = {self.foil / MM:g} mm on both faces: at most half the thickness, {self.thickness / MM:g} mm"
            )

    @property
    def cone(self) -> float:
        """Length of the tip cone, m."""
        return 0.5 * self.diameter / float(np.tan(0.5 * self.point_angle))

    @property
    def drag(self) -> float:
        """Axial force of the full cone per speed of the tip, N s/m."""
        return 0.5 * self.specific_thrust * self.diameter / self.revolutions

    @property
    def bending(self) -> float:
        """E I of the drill, N m^2, taken as a round bar."""
        return self.modulus * np.pi * self.diameter**4 / 64.0

    @property
    def lateral_stiffness(self) -> float:
        """Force per displacement of the tip of a clamped bar, ``3 E I / L^3``, N/m."""
        return 3.0 * self.bending / self.overhang**3

    @property
    def tilt_stiffness(self) -> float:
        """Moment per turn of the tip of a clamped bar, ``E I / L``, Nm/rad."""
        return self.bending / self.overhang


def engagement(cutting: Cutting, depth: float | Floats) -> Floats:
    """Share of the cone that cuts, times the foil factor where it cuts copper.

    The mean over the cone's length of 0 outside the board, 1 in laminate and the foil factor in copper. It rises over
    one cone length at the near face and falls over one behind the far face.

    Args:
        cutting: Drill and board.
        depth: () or (T,) of the apex below the near face, m.
    """
    found: Floats = (_material(cutting, depth) - _material(cutting, depth - cutting.cone)) / cutting.cone
    return found


def _material(cutting: Cutting, depth: float | Floats) -> Floats:
    """Material met down to a depth, copper counted by its factor, m."""
    foil, far, copper = cutting.foil, cutting.thickness - cutting.foil, cutting.foil_factor * cutting.foil
    laminate = far - foil
    met = (0.0, copper, copper + laminate, 2.0 * copper + laminate)
    return np.asarray(np.interp(depth, (0.0, foil, far, cutting.thickness), met))


def guidance(cutting: Cutting, depth: float | Floats) -> Floats:
    """Share of the drill's stiffness with which the hole holds it: 0 at the surface, 1 from one diameter on."""
    return np.asarray(np.interp(depth, (0.0, cutting.diameter), (0.0, 1.0)))
