"""Self-weight that is not what the robot file says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identify.arrays import Floats
from identify.effects.base import Binding, Effect, Parameter
from identify.effects.options import chosen_components
from identify.effects.places import chain_places
from identify.effects.through import NOTHING_YIELDS, through_effect
from identify.robot import Robot

__all__ = ["link_mass"]

COMPONENTS = ("mass", "mx", "my", "mz")
_TINY = 1e-9  # kg; a link without mass has its first moment at this one
#: By component: typical size, largest plausible one, and the size that is no longer worth fitting, per kg of the link.
_SIZES = {"mass": (0.1, 0.3, 1.0), "moment": (0.05, 0.2, 0.5)}


def link_mass(binding: Binding) -> Effect:
    """Errors of the masses of the links, and of their first moments.

    With ``m_i`` more mass at the stated centre ``c_i`` and ``s_i`` more first moment about the origin of the moved
    frame of joint i (its axes), a turning spring j that carries the link bears
    ``a_j . ((c_i - o_j) m_i x g + s_i x g)`` more, a sliding one ``m_i a_j . g``. Torques act through the compliances
    of other effects. Where a link mass is unknown, self-weight is left out of the model and nothing depends on it.
    Changes between loads hide it.

    Parameters ``link_mass.link<i>``, kg, the link that joint i moves; ``link_mass.link<i>.mx, .my, .mz``, kg m.
    Typical: 5 to 20 % of the mass of the link, 50 mm of its centre (engineering experience).

    Options: ``components = ["mass"]`` (default), of ``mass, mx, my, mz``.

    Args:
        binding: Robot, places ``link1 ... link<n>`` and options.

    Raises:
        InputError: A link or a component that does not exist.
    """
    robot = binding.robot
    links = chain_places("link_mass", "link", robot.n, binding.where, first=1)
    components = chosen_components("link_mass", binding.options, COMPONENTS, ("mass",))
    slots = [(link, component) for link in links for component in components]
    parameters = tuple(_parameter(robot, link, component) for link, component in slots)
    link_of = np.array([link for link, _ in slots])
    component_of = np.array([COMPONENTS.index(component) for _, component in slots])

    def adjust(base: Robot, values: Floats) -> Robot:
        change = np.zeros((base.n, 4))
        change[link_of, component_of] = values
        masses = base.masses + change[:, 0]  # may go below zero on the way of a fit: weight and moment stay linear
        if not change[:, 1:].any():
            return replace(base, masses=masses)
        masses = np.where(np.abs(masses) < _TINY, _TINY, masses)
        return replace(base, masses=masses, centres=base.centres + change[:, 1:] / masses[:, None])

    def why_zero(parameter: int) -> str:
        unknown = [f"link{link + 1}" for link in np.flatnonzero(np.isnan(robot.masses))]
        if unknown:
            return (
                f"the mass of {', '.join(unknown)} is unknown, so self-weight is left out; state mass and centre of "
                "mass of every link in the robot file"
            )
        return (
            "its weight is on no spring that these data show (changes between loads hide self-weight), "
            f"or {NOTHING_YIELDS}"
        )

    return through_effect("link_mass", parameters, why_zero, yields=False, adjust=adjust)


def _parameter(robot: Robot, link: int, component: str) -> Parameter:
    """One error of one link; its sizes are shares of the stated mass, if that is known."""
    whole = component == "mass"
    name = f"link_mass.link{link + 1}" + ("" if whole else f".{component}")
    mass = robot.masses[link]
    if not mass > 0.0:
        return Parameter(name, "kg" if whole else "kg m", 1.0)
    typical, plausible, limit = (float(share * mass) for share in _SIZES["mass" if whole else "moment"])
    return Parameter(name, "kg" if whole else "kg m", 1.0, limit=limit, plausible=plausible, typical=typical)
