"""Effects of elasticity: springs that yield under load and self-weight.

One mechanism serves all: a *term* is a pair of elementary springs (s, r) with compliance c, and moves the
markers by ``c (D_s t_r + D_r t_s)``, or by ``c D_s t_s`` where s = r (Klimchik, Caro, Furet, Pashkevich, eq. 3,
5 and 12). What the effects differ in is which springs they take and how they name them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from identify.arrays import Floats
from identify.effects.base import Binding, Effect, Parameter, Scene, SpringSet, Term
from identify.effects.places import chain_places, joint_places
from identify.effects.templates import Elements, check_link_options, link_constants, link_template
from identify.errors import InputError
from identify.robot import Robot
from identify.units import SI_OF

__all__ = ["joint_compliance", "link_compliance", "spring_effect"]

LIMIT = 1000.0  # urad/Nm or um/N: a hundred times the softest joint of an industrial arm


def spring_effect(
    name: str,
    terms: tuple[Term, ...],
    springs: SpringSet,
    why_zero: Callable[[int], str],
    sizes: Mapping[str, tuple[float, float]] | None = None,
) -> Effect:
    """An effect that is linear in compliances of pairs of springs.

    Args:
        name: Name of the effect.
        terms: Its p compliances.
        springs: Which springs the terms count.
        why_zero: Reason for a column of zeros.
        sizes: Largest plausible and typical size of a compliance, by its unit; none if absent.
    """
    known = sizes or {}
    parameters = tuple(
        Parameter(
            term.name, term.unit, SI_OF[term.unit], 0.0, False, LIMIT, *known.get(term.unit, (np.inf, float("nan")))
        )
        for term in terms
    )
    scale = np.array([parameter.scale for parameter in parameters])
    first = np.array([term.first for term in terms], dtype=np.int64)
    second = np.array([term.second for term in terms], dtype=np.int64)
    mutual = np.flatnonzero((first != second) & np.array([term.mutual for term in terms], dtype=bool))

    def derivative(scene: Scene, values: Floats) -> Floats:
        fields, shot = scene.fields(springs), scene.experiment.row_shot
        motion = fields.motion.swapaxes(1, 2)
        columns: Floats = motion.take(first, axis=2)
        columns *= (fields.torque[:, second] * scale)[shot][:, None]
        if len(mutual):
            back = motion.take(second[mutual], axis=2)
            back *= (fields.torque[:, first[mutual]] * scale[mutual])[shot][:, None]
            columns[:, :, mutual] += back
        return columns

    def matrix(scene: Scene, values: Floats) -> Floats:
        size = scale * values
        compliance = np.zeros((scene.torque(springs).shape[1],) * 2)
        np.add.at(compliance, (first, second), size)
        np.add.at(compliance, (second[mutual], first[mutual]), size[mutual])
        return compliance

    def displacement(scene: Scene, values: Floats) -> Floats:
        return scene.moved_by(springs, matrix(scene, values))

    def twist(scene: Scene, values: Floats) -> Floats:
        return scene.yielded(springs, matrix(scene, values))

    return Effect(
        name, parameters, displacement, derivative, why_zero, linear=True, springs=springs, terms=terms, twist=twist
    )


def joint_compliance(binding: Binding) -> Effect:
    """One linear spring about (along) the axis of each joint: gears, drives, bearings.

    Parameters ``joint_compliance.j1 ...``, urad/Nm for turning and um/N for sliding joints. Typical:
    0.1 to 5 urad/Nm for arms of 200 kg payload, 10 to 50 for arms of 5 to 10 kg.

    Args:
        binding: Robot and places ``j1 ... jn``.
    """
    robot = binding.robot
    index = joint_places("joint_compliance", robot, binding.where)
    terms = tuple(Term(f"joint_compliance.j{j + 1}", j, j, "um/N" if robot.prismatic[j] else "urad/Nm") for j in index)

    def why_zero(parameter: int) -> str:
        joint = index[parameter]
        if _always_vertical(robot, joint):
            return f"vertical loads put no torque on joint {joint + 1}, whose axis is vertical in every pose"
        action = "force along" if robot.prismatic[joint] else "torque on"
        return f"no load in these data puts a {action} joint {joint + 1}, or no marker moves with it"

    return spring_effect("joint_compliance", terms, "joints", why_zero)


def link_compliance(binding: Binding) -> Effect:
    """The 6x6 compliance of links at their distal ends, base included (link0).

    Parameters ``link_compliance.link<i>.k<ab>``: deflection a (1-3 along, 4-6 about local x, y, z; x is the beam
    axis) per load b; ``k26`` and ``k62`` are one parameter unless an element list names both. Units um/N, urad/Nm
    and urad/N. Typical of a 200 kg arm: 0.002 to 0.02 um/N, 0.02 to 0.2 urad/Nm.

    Options: ``template = "beam"`` (eq. 13, default), ``"symmetric"`` (21 elements), ``"full"`` (36), a list such as
    ``["k11", "k26"]`` or a 6x6 pattern; ``[model.link_compliance.link2] template = ...`` for one link;
    ``[model.link_compliance.constants] link2.k22 = 0.003`` for elements that are there and not fitted.

    Args:
        binding: Robot, places ``link0 ... link<n>`` and options.
    """
    robot = binding.robot
    index = chain_places("link_compliance", "link", robot.n + 1, binding.where, first=0)
    check_link_options(binding.options, robot.n + 1)
    templates = {link: link_template(binding.options, link) for link in index}
    terms = tuple(_link_term(link, element, template) for link, template in templates.items() for element in template)

    def why_zero(parameter: int) -> str:
        term = terms[parameter]
        what = f"{'about' if term.second % 6 > 2 else 'along'} local {'xyz'[term.second % 3]}"
        return f"no load in these data acts {what} at the end of link {term.second // 6}, or no marker answers to it"

    return _with_constants(spring_effect("link_compliance", terms, "links", why_zero), binding)


def _with_constants(effect: Effect, binding: Binding) -> Effect:
    """The links with elements that are not fitted too: these displace, and no column is theirs."""
    constants = link_constants(binding.options, binding.robot.n + 1)
    held = tuple(_link_term(link, element, (element,)) for link, element in constants)
    fitted = {parameter.name for parameter in effect.parameters}
    for term in held:
        if fitted & {term.name, _mirrored(term.name)}:
            raise InputError(
                f"[model.link_compliance.constants]: {term.name} stands in its link's template and is fitted"
            )
    if not held:
        return effect
    rest = spring_effect(effect.name, held, "links", effect.why_zero)
    values = np.array(list(constants.values()))

    def displacement(scene: Scene, fit: Floats) -> Floats:
        moved: Floats = effect.displacement(scene, fit) + rest.displacement(scene, values)
        return moved

    return replace(
        effect, displacement=displacement, twist=None, held=tuple(zip(held, constants.values(), strict=True))
    )


def _mirrored(name: str) -> str:
    """Name of the mirrored element: ``...k62`` for ``...k26``."""
    return f"{name[:-2]}{name[:-3:-1]}"


def _link_term(link: int, element: tuple[int, int], template: Elements) -> Term:
    """The term of one matrix element; one-sided where the template names the mirrored element too."""
    a, b = element
    unit = {0: "um/N", 1: "urad/N", 2: "urad/Nm"}[(a > 3) + (b > 3)]
    mirrored = a != b and (b, a) in template
    return Term(f"link_compliance.link{link}.k{a}{b}", 6 * link + a - 1, 6 * link + b - 1, unit, not mirrored)


def _always_vertical(robot: Robot, joint: int) -> bool:
    """True if the joint's axis is vertical in every pose: the first turning joint of an upright arm."""
    if joint != 0 or robot.prismatic[0]:
        return False
    axis = robot.world_R_base @ robot.placements[0, :3, 2]
    return bool(np.hypot(axis[0], axis[1]) < 1e-9)
