"""Compliance of a straight tube, the simplest estimate of a link."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats
from identify.errors import InputError

__all__ = ["Tube", "tube_compliance"]


@dataclass(frozen=True)
class Tube:
    """A tube along local x, clamped at its proximal end.

    Attributes:
        length: m.
        diameter: Outer diameter, m.
        wall: Thickness of the wall, m.
        young: Young's modulus, Pa.
        poisson: Poisson's ratio.
    """

    length: float
    diameter: float
    wall: float
    young: float = 210e9
    poisson: float = 0.3

    def __post_init__(self) -> None:
        """Refuse a wall thicker than the tube.

        Raises:
            InputError: The wall is thicker than the radius.
        """
        if 2 * self.wall > self.diameter:
            raise InputError(f"a wall of {self.wall:g} m is thicker than the radius of a tube of {self.diameter:g} m")


def tube_compliance(tube: Tube) -> Floats:
    """Compliance (6, 6) at the free end, m/N, rad/N (m/Nm) and rad/Nm: Euler-Bernoulli bending and torsion.

    ``k11 = L/EA, k22 = k33 = L^3/3EI, k44 = L/GJ, k55 = k66 = L/EI, k26 = -k35 = L^2/2EI`` with ``J = 2 I``.
    Source of the pattern: Klimchik, Caro, Furet, Pashkevich, "Complete Stiffness Model for a Serial Robot", eq. 13.
    """
    inner = tube.diameter - 2 * tube.wall
    area = np.pi / 4 * (tube.diameter**2 - inner**2)
    inertia = np.pi / 64 * (tube.diameter**4 - inner**4)
    shear = tube.young / (2 * (1 + tube.poisson))
    length, bending = tube.length, tube.young * inertia
    turned = length / bending
    compliance: Floats = np.diag([
        length / (tube.young * area),
        *[length**3 / (3 * bending)] * 2,
        length / (2 * shear * inertia),
        turned,
        turned,
    ])
    compliance[1, 5] = compliance[5, 1] = length**2 / (2 * bending)
    compliance[2, 4] = compliance[4, 2] = -(length**2) / (2 * bending)
    return compliance
