"""What the compliances of a robot should be about, before anything is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identify.arrays import Floats, frozen
from identify.beams import Box, box_compliance
from identify.errors import InputError
from identify.robot import Robot

__all__ = ["Prior", "beam_prior", "link_boxes"]

_PAYLOAD_TURN = 2e-3  # rad
_PAYLOAD_SHIFT = 1e-4  # m


@dataclass(frozen=True, eq=False)
class Prior:
    """Expected compliances, from beams, CAD or elsewhere.

    Attributes:
        links: (n + 1, 6, 6) at the distal ends in the link frames, m/N, rad/N, rad/Nm; positive definite.
        joints: (n,) rad/Nm or m/N, positive.
        source: Where the numbers come from.
    """

    links: Floats
    joints: Floats
    source: str = ""

    def __post_init__(self) -> None:
        """Check values and make the arrays read-only.

        Raises:
            InputError: A shape that does not fit, a joint that is not positive, a link that is not positive definite.
        """
        links, joints = frozen(self.links), frozen(self.joints)
        if links.shape != (len(joints) + 1, 6, 6):
            raise InputError(f"prior: links of shape {links.shape} for {len(joints)} joints; (n + 1, 6, 6) expected")
        for number, joint in enumerate(joints, start=1):
            if not joint > 0:
                raise InputError(f"prior: the compliance of joint {number} is {joint:g}; a positive number expected")
        for number, link in enumerate(links):
            if not (np.diag(link) > 0).all() or not _positive(link):
                raise InputError(f"prior: the matrix of link {number} is not symmetric and positive definite")
        object.__setattr__(self, "links", links)
        object.__setattr__(self, "joints", joints)


def _positive(matrix: Floats) -> bool:
    """Symmetric and positive definite, whatever the units of its axes."""
    size = np.sqrt(np.diag(matrix))
    unit = matrix / np.outer(size, size)
    return bool(np.allclose(unit, unit.T, atol=1e-9) and np.linalg.eigvalsh(unit)[0] > 1e-12)


def beam_prior(robot: Robot, boxes: Sequence[Box] | None = None, joints: Floats | None = None) -> Prior:
    """Links as square tubes along local x, joints from the payload.

    A joint turns by about 2 mrad under the rated payload at the flange of the stretched arm, ``c = 2 mrad / (m g
    distance)``, or slides by 0.1 mm under its weight. That is a rule of thumb: it gives 0.3, 0.6 and 3.3 urad/Nm for
    joints 2, 3 and 5 of a 270 kg arm, where 0.1 to 0.4 and 2 to 3 are quoted.

    Args:
        robot: The robot.
        boxes: One of each link, base first; default `link_boxes`.
        joints: (n,) compliances, rad/Nm or m/N; default from the payload.

    Raises:
        InputError: A payload that is unknown and joints that are not stated, or not one box a link.
    """
    chosen = link_boxes(robot) if boxes is None else tuple(boxes)
    if len(chosen) != robot.n + 1:
        raise InputError(f"{len(chosen)} boxes for {robot.n + 1} links of robot {robot.name}; one of each, base first")
    links = np.array([box_compliance(box) for box in chosen])
    return Prior(links, _payload_joints(robot) if joints is None else joints, "square tubes; joints from the payload")


def link_boxes(robot: Robot, young: float = 110e9, poisson: float = 0.26) -> tuple[Box, ...]:
    """Square tubes for the links of a robot: sides from a ninth (base) to a twentieth (flange) of its length.

    The wall is a twentieth of the side, and no link is shorter than half its side. These proportions are a rule of
    thumb for cast arms; state what is known of the robot with `dataclasses.replace` or boxes of your own.

    Args:
        robot: The robot.
        young: Young's modulus, Pa: cast iron 110e9 (EN 1561), steel 210e9 (EN 1993-1-1).
        poisson: Poisson's ratio.
    """
    lengths = np.linalg.norm(robot.placements[:, :3, 3], axis=1)
    sides = lengths.sum() * np.linspace(1 / 9, 1 / 20, robot.n + 1)
    base = Box(1.0, 1.0, 0.1, young, poisson)
    return tuple(
        replace(base, length=float(max(length, side / 2)), side=float(side), wall=float(side / 20))
        for length, side in zip(lengths, sides, strict=True)
    )


def _payload_joints(robot: Robot) -> Floats:
    """(n,) compliances by the rule of `beam_prior`."""
    weight = robot.payload * robot.gravity
    if not np.isfinite(weight):
        raise InputError(f"robot {robot.name}: the payload is unknown, so state the prior compliances of the joints")
    lengths = np.linalg.norm(robot.placements[:, :3, 3], axis=1)
    beyond = np.cumsum(lengths[::-1])[::-1][1:]
    distance = np.maximum(beyond, lengths.sum() / 20)
    joints: Floats = np.where(robot.prismatic, _PAYLOAD_SHIFT / weight, _PAYLOAD_TURN / (weight * distance))
    return joints
