"""Special cases of spring pairs that have a name of their own: the foot, the flange, joints that are coupled.

They are the mechanism of `identify.effects.compliance` on chosen springs. ``base_compliance@base`` and
``tool_compliance@flange`` are elements of the first and the last link of `link_compliance`.
"""

from __future__ import annotations

from itertools import pairwise

from identify.effects.base import Binding, Effect, SpringSet, Term
from identify.effects.compliance import spring_effect
from identify.effects.options import chosen_components
from identify.effects.places import joint_pair, named_places
from identify.errors import InputError
from identify.robot import Robot

__all__ = ["base_compliance", "joint_cross_compliance", "tool_compliance"]

COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")  # along, then about
#: Unit -> largest plausible and typical size. At 5 urad/Nm a base tilts by 5 mrad under 100 kg at 1 m.
BASE_SIZES = {"urad/Nm": (5.0, 0.03)}
TOOL_SIZES = {"urad/Nm": (50.0, 0.5)}


def base_compliance(binding: Binding) -> Effect:
    """Tilt of the foundation (place ``base``) and of the column on its bearing (place ``column``).

    Parameters ``base_compliance.<place>.<component>``: springs along (``x, y, z``, um/N) and about (``rx, ry, rz``,
    urad/Nm) the axes of link 0 at its end, where joint 1 begins. Those of ``column`` turn with joint 1, so the two
    places differ only if joint 1 moves. Typical: 0.01 to 0.05 urad/Nm.

    Options: ``components = ["rx", "ry"]`` (default).

    Args:
        binding: Robot, places and options.
    """
    places = named_places("base_compliance", ("base", "column"), binding.where)
    starts = {"base": 0, "column": 6}
    chosen = {place: starts[place] for place in places}
    return _body_effect("base_compliance", binding, chosen, "base", ("rx", "ry"), BASE_SIZES)


def tool_compliance(binding: Binding) -> Effect:
    """Flange plate and gripper: springs at the flange.

    Parameters ``tool_compliance.flange.<component>``: springs along and about the axes of the last link (its x axis
    is the beam's), at the flange origin; units as in `base_compliance`. Typical: 0.2 to 1 urad/Nm.

    Options: ``components = ["ry", "rz"]`` (default).

    Args:
        binding: Robot, place ``flange`` and options.
    """
    places = named_places("tool_compliance", ("flange",), binding.where)
    starts = dict.fromkeys(places, 6 * binding.robot.n)
    return _body_effect("tool_compliance", binding, starts, "links", ("ry", "rz"), TOOL_SIZES)


def joint_cross_compliance(binding: Binding) -> Effect:
    """Two joints that yield to each other's load: ``c (D_a t_b + D_b t_a)``.

    Parameters ``joint_cross_compliance.j<a>-j<b>``, urad/Nm (urad/N where one of the two slides, um/N where both do).
    Typical: 5 to 15 % of the compliance of a wrist joint.

    Args:
        binding: Robot and places ``j<a>-j<b>`` with a < b; neighbouring joints by default.

    Raises:
        InputError: The robot has a single joint, or a place is no pair of its joints.
    """
    robot = binding.robot
    given = [joint_pair("joint_cross_compliance", robot, place) for place in dict.fromkeys(binding.where)]
    pairs = given or list(pairwise(range(robot.n)))
    if not pairs:
        raise InputError(f"effect joint_cross_compliance: robot {robot.name} has one joint, a pair needs two")
    terms = tuple(_cross_term(robot, a, b) for a, b in pairs)

    def why_zero(parameter: int) -> str:
        a, b = pairs[parameter]
        return f"no load in these data turns joint {a + 1} or joint {b + 1} while a marker answers to the other"

    return spring_effect("joint_cross_compliance", terms, "joints", why_zero)


def _body_effect(
    name: str,
    binding: Binding,
    starts: dict[str, int],
    springs: SpringSet,
    default: tuple[str, ...],
    sizes: dict[str, tuple[float, float]],
) -> Effect:
    """Springs on the diagonal of some 6x6 compliances, each of which begins at ``starts[place]``."""
    components = chosen_components(name, binding.options, COMPONENTS, default)
    terms = []
    for place, start in starts.items():
        for component in components:
            spring = start + COMPONENTS.index(component)
            unit = "urad/Nm" if component[0] == "r" else "um/N"
            terms.append(Term(f"{name}.{place}.{component}", spring, spring, unit))

    def why_zero(parameter: int) -> str:
        place, component = terms[parameter].name.split(".")[1:]
        what = f"{'turns about' if component[0] == 'r' else 'pushes along'} {component[-1]} of the {place}"
        return f"no load in these data {what}, or no marker answers to it"

    return spring_effect(name, tuple(terms), springs, why_zero, sizes)


def _cross_term(robot: Robot, a: int, b: int) -> Term:
    """The term of two joints, in the unit of their kinds."""
    unit = ("urad/Nm", "urad/N", "um/N")[int(robot.prismatic[a]) + int(robot.prismatic[b])]
    return Term(f"joint_cross_compliance.j{a + 1}-j{b + 1}", a, b, unit)
