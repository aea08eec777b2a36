"""Compliance of a straight tube, round or square: the simplest estimate of a link."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats
from identify.errors import InputError

__all__ = ["Box", "Tube", "box_compliance", "tube_compliance"]


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


@dataclass(frozen=True)
class Box:
    """A tube of square section along local x, clamped at its proximal end.

    Attributes:
        length: m.
        side: Outer side of the section, m.
        wall: Thickness of the wall, m.
        young: Young's modulus, Pa; grey cast iron EN-GJL-250: 103 to 118 GPa (EN 1561).
        poisson: Poisson's ratio; 0.26 of the same iron (EN 1561).
    """

    length: float
    side: float
    wall: float
    young: float = 110e9
    poisson: float = 0.26

    def __post_init__(self) -> None:
        """Refuse what is no box.

        Raises:
            InputError: A size or a modulus that is not positive, or a wall thicker than half the side.
        """
        for key in ("length", "side", "wall", "young"):
            if not getattr(self, key) > 0:
                raise InputError(f"{key} = {getattr(self, key)}: a positive number expected")
        if 2 * self.wall > self.side:
            raise InputError(f"a wall of {self.wall:g} m is thicker than half the side of a box of {self.side:g} m")


@dataclass(frozen=True)
class _Rigidity:
    """Of a section: axial EA (N), bending EI and torsion GJ (N m^2), shear kappa G A (N), infinite if left out."""

    axial: float
    bending: float
    torsion: float
    shear: float = np.inf


def tube_compliance(tube: Tube) -> Floats:
    """Compliance (6, 6) at the free end, m/N, rad/N (m/Nm) and rad/Nm: Euler-Bernoulli bending and torsion.

    ``k11 = L/EA, k22 = k33 = L^3/3EI, k44 = L/GJ, k55 = k66 = L/EI, k26 = -k35 = L^2/2EI`` with ``J = 2 I``.
    Source of the pattern: Klimchik, Caro, Furet, Pashkevich, "Complete Stiffness Model for a Serial Robot", eq. 13.
    """
    inner = tube.diameter - 2 * tube.wall
    area = np.pi / 4 * (tube.diameter**2 - inner**2)
    inertia = np.pi / 64 * (tube.diameter**4 - inner**4)
    shear = tube.young / (2 * (1 + tube.poisson))
    return _compliance(tube.length, _Rigidity(tube.young * area, tube.young * inertia, 2 * shear * inertia))


def box_compliance(box: Box) -> Floats:
    """Compliance (6, 6) at the free end as of `tube_compliance`, with shear: ``k22 = k33 = L^3/3EI + L/(kappa G A)``.

    ``J = (side - wall)^3 wall`` (Bredt, thin wall) and ``kappa = 20 (1 + nu)/(48 + 39 nu)`` (Cowper, "The shear
    coefficient in Timoshenko's beam theory", J. Appl. Mech. 33, 1966, thin-walled square tube).
    """
    inner, nu = box.side - 2 * box.wall, box.poisson
    area, inertia = box.side**2 - inner**2, (box.side**4 - inner**4) / 12
    shear = box.young / (2 * (1 + nu))
    torsion = shear * (box.side - box.wall) ** 3 * box.wall
    kappa = 20 * (1 + nu) / (48 + 39 * nu)
    return _compliance(box.length, _Rigidity(box.young * area, box.young * inertia, torsion, kappa * shear * area))


def _compliance(length: float, of: _Rigidity) -> Floats:
    """Timoshenko cantilever along x: deflections of its free end per load there."""
    across = length**3 / (3 * of.bending) + length / of.shear
    turned = length / of.bending
    compliance: Floats = np.diag([length / of.axial, across, across, length / of.torsion, turned, turned])
    compliance[1, 5] = compliance[5, 1] = length**2 / (2 * of.bending)
    compliance[2, 4] = compliance[4, 2] = -(length**2) / (2 * of.bending)
    return compliance
