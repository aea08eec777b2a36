"""First step of the two-step fit: the whole compliance of a joint at each of its levels, from an identification."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from identify.arrays import Floats, frozen
from identify.effects.compensator import NAME
from identify.effects.compensator_options import mode_of, options_of, read_levels
from identify.effects.joint_turns import axis_compliance
from identify.effects.places import joint_places
from identify.errors import InputError
from identify.identification import Identification

__all__ = ["JointLevels", "joint_levels"]


class JointLevels(NamedTuple):
    """Compliance of one joint at l joint values; what `identify.gravity_spring.spring_from_levels` starts from.

    Attributes:
        q: (l,) levels, rad.
        compliance: (l,) rad/Nm, of the joint with everything else that yields about its axis; in a reduced model also
            of the coupled link elements that the reduction has merged into it, so that a spring fitted to these levels
            has not the joint's own constants.
        covariance: (l, l) of these.
    """

    q: Floats
    compliance: Floats
    covariance: Floats


def joint_levels(found: Identification, where: str = "j2") -> JointLevels:
    """Compliance at the levels of ``gravity_compensator@where``; levels that no reading shows are left out.

    Args:
        found: A fit of a model with ``gravity_compensator`` in mode ``levels``.
        where: The joint.

    Raises:
        InputError: The model has no levels of this joint.
    """
    model, robot = found.model, found.model.robot
    joint = joint_places(NAME, robot, (where,))[0]
    first = f"{NAME}.{where}.l1"
    if first not in model.names:
        raise InputError(
            f"effect {NAME}@{where} with levels_deg is not in this model; it has {', '.join(model.names) or 'nothing'}"
        )
    options = options_of(found.study.options[NAME], joint)
    assert mode_of(options) == "levels"
    levels, _ = read_levels(options)
    start = model.names.index(first)
    rows = np.zeros((len(levels), len(model.names)))
    shares, held = axis_compliance(model.effects, robot, joint)
    for name, share in shares.items():
        rows[:, model.names.index(name)] = share
    columns = start + np.arange(len(levels))
    rows[np.arange(len(levels)), columns] = model.parameters[start].scale
    unseen = [d.column for d in found.fit.identifiability.dropped if not d.alike or np.isfinite(d.std)]
    rows, levels = rows[~np.isin(columns, unseen)], levels[~np.isin(columns, unseen)]
    return JointLevels(frozen(levels), frozen(held + rows @ found.values), frozen(rows @ found.covariance @ rows.T))
