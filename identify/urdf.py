"""URDF files -> `Robot`. The only module that imports Pinocchio.

What is decided here:

* The chain runs from the base link to the flange link. Fixed joints are merged with their masses.
* A joint that is not on the chain (a gripper's finger, a joint behind the flange) is kept at zero and
  its links are carried along with their mass.
* A moved body is all links that are rigidly joined (in this sense) behind one joint of the chain. Its
  mass is unknown if none of its links states an ``<inertial>``, or if the stated masses add up to
  zero. Otherwise links without one (``tool0``, ``flange``) are frames and add nothing. A stated mass
  above zero is taken as it stands, dummy or not.
* Limits are unknown for continuous joints and where ``lower`` and ``upper`` are not stated; a rated
  effort of zero is unknown.
* Collision shapes of a body are read where all of them are boxes, cylinders, capsules or spheres. Meshes are not
  read, so missing ones do not matter.

The file is checked before Pinocchio sees it; Pinocchio gets a plain copy with links, joints and masses only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from identify.arrays import Floats
from identify.collision_shapes import shapes_of_body
from identify.robot import Robot, Shape
from identify.transforms import axis_frame, roll_pitch_yaw, translation
from identify.urdf_tree import SLIDING, TURNING, UrdfJoint, UrdfTree, listed, read_urdf

__all__ = ["robot_from_urdf"]


def robot_from_urdf(path: str | Path, *, base: str | None = None, flange: str | None = None) -> Robot:
    """Read the serial chain between two links of a URDF; mounted upright, standard gravity.

    Args:
        path: URDF file.
        base: Link whose frame is the base frame; default: the root of the tree.
        flange: Link that carries markers and loads; default: the end of the longest chain, if there is only one.

    Raises:
        InputError: The file is hostile, malformed or no serial chain, or has no such link.
    """
    tree = read_urdf(Path(path))
    start = tree.root if base is None else _link(tree, "base", base)
    end = _end(tree, start) if flange is None else _link(tree, "flange", flange)
    chain = _chain(tree, start, end)
    return _robot(tree, start, end, chain)


def _robot(tree: UrdfTree, start: str, end: str, chain: Sequence[UrdfJoint]) -> Robot:
    """The robot of a chain, each joint's axis folded into its placement."""
    model, flange = _pinocchio_model(tree, start, end, chain)
    carry: Floats = np.eye(4)
    placements, masses, centres = [], [], []
    for index, (joint, body) in enumerate(zip(chain, _bodies(tree, chain), strict=True), start=1):
        turn = axis_frame(joint.axis)
        placements.append(carry @ model.jointPlacements[index].homogeneous @ turn)
        carry = turn.T
        inertia = model.inertias[index]
        known = any(tree.links[link] is not None for link in body) and inertia.mass > 0
        masses.append(inertia.mass if known else math.nan)
        centres.append(turn[:3, :3].T @ inertia.lever if known else np.full(3, math.nan))
    placements.append(carry @ model.frames[flange].placement.homogeneous)
    shapes = [
        shape
        for body, (head, turn) in enumerate(_heads(start, chain))
        for shape in _shapes(tree, body, head, turn, chain)
    ]
    return Robot(
        name=tree.name,
        joints=tuple(joint.name for joint in chain),
        prismatic=np.array([joint.kind in SLIDING for joint in chain]),
        placements=np.array(placements),
        lower=np.array([joint.lower for joint in chain]),
        upper=np.array([joint.upper for joint in chain]),
        masses=np.array(masses),
        centres=np.array(centres),
        efforts=np.array([joint.effort for joint in chain]),
        shapes=tuple(shapes),
        continuous=np.array([joint.kind == "continuous" for joint in chain]),
        source=f"URDF file {tree.path.name}, links {start} to {end}",
    )


def _heads(start: str, chain: Sequence[UrdfJoint]) -> list[tuple[str, Floats]]:
    """First link of every body, base first, and the turn (4, 4) from its frame to the body's."""
    return [(start, np.eye(4)), *((joint.child, axis_frame(joint.axis)) for joint in chain)]


def _shapes(tree: UrdfTree, body: int, head: str, turn: Floats, chain: Sequence[UrdfJoint]) -> tuple[Shape, ...]:
    """Collision shapes of one body, in its frame."""
    placed: dict[str, Floats] = {head: turn.T}
    waiting = [head]
    while waiting:
        name = waiting.pop()
        for joint in tree.below[name]:
            if joint not in chain:
                step = translation(joint.xyz)
                step[:3, :3] = roll_pitch_yaw(joint.rpy)
                placed[joint.child] = placed[name] @ step
                waiting.append(joint.child)
    return shapes_of_body(body, placed, tree.collisions)


def _pinocchio_model(tree: UrdfTree, start: str, end: str, chain: Sequence[UrdfJoint]) -> tuple[Any, int]:
    """Pinocchio's model of the tree above ``start`` with the joints of the chain alone, and the frame of ``end``.

    Joint i of the chain has index i + 1. Links and joints are numbered, so that no name can clash.
    """
    import pinocchio

    order = [start, *tree.under(start)]
    names = {link: f"link{i}" for i, link in enumerate(order)}
    robot = ET.Element("robot", name="robot")
    for link in order:
        element, inertial = ET.SubElement(robot, "link", name=names[link]), tree.links[link]
        if inertial is not None and inertial.mass > 0:
            block = ET.SubElement(element, "inertial")
            ET.SubElement(block, "origin", xyz=_text(inertial.centre))
            ET.SubElement(block, "mass", value=repr(inertial.mass))
            ET.SubElement(block, "inertia", dict.fromkeys(("ixx", "iyy", "izz"), "1"), ixy="0", ixz="0", iyz="0")
    for link in order[1:]:
        joint = tree.above[link]
        kind = ("prismatic" if joint.kind in SLIDING else "revolute") if joint in chain else "fixed"
        element = ET.SubElement(robot, "joint", name=f"to_{names[link]}", type=kind)
        ET.SubElement(element, "origin", xyz=_text(joint.xyz), rpy=_text(joint.rpy))
        ET.SubElement(element, "parent", link=names[joint.parent])
        ET.SubElement(element, "child", link=names[link])
        if kind != "fixed":
            ET.SubElement(element, "axis", xyz=_text(joint.axis))
            ET.SubElement(element, "limit", lower="-1", upper="1", effort="1", velocity="1")
    try:
        model = pinocchio.buildModelFromXML(ET.tostring(robot, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        tree.fail(f"Pinocchio cannot read it: {error}")
    return model, model.getFrameId(names[end], pinocchio.BODY)


def _bodies(tree: UrdfTree, chain: Sequence[UrdfJoint]) -> list[list[str]]:
    """The links that each joint of the chain carries up to the next one."""
    heads = dict.fromkeys(joint.child for joint in chain)
    bodies = []
    for head in heads:
        waiting, body = [head], []
        while waiting:
            name = waiting.pop()
            body.append(name)
            waiting.extend(joint.child for joint in tree.below[name] if joint.child not in heads)
        bodies.append(body)
    return bodies


def _chain(tree: UrdfTree, start: str, end: str) -> list[UrdfJoint]:
    """The moving joints from ``start`` to ``end``."""
    path, link = [], end
    while link != start:
        if link == tree.root:
            tree.fail(f"link {end!r} does not hang on base {start!r}; allowed are {listed(tree.under(start))}")
        path.append(tree.above[link])
        link = tree.above[link].parent
    chain = [joint for joint in reversed(path) if joint.moves]
    if not chain:
        tree.fail(f"no moving joint between base {start!r} and flange {end!r}; a robot has at least one")
    for joint in chain:
        if joint.kind not in TURNING + SLIDING:
            tree.fail(
                f"joint {joint.name!r} has type {joint.kind!r}; allowed on the chain are revolute, continuous, "
                "prismatic and fixed"
            )
        if joint.mimics is not None:
            tree.fail(
                f"joint {joint.name!r} mimics {joint.mimics!r}; coupled joints are not allowed on the chain "
                "(state the chain's independent joints, and the coupling in the [controller] map of a robot file)"
            )
    return chain


def _end(tree: UrdfTree, start: str) -> str:
    """The one end link behind which, and beside which on the same body, no joint moves any more."""
    body = {start: start}
    waiting, ends, going_on = [start], [], set()
    while waiting:
        name = waiting.pop()
        if not tree.below[name]:
            ends.append(name)
        for joint in tree.below[name]:
            body[joint.child] = joint.child if joint.moves else body[name]
            if joint.moves:
                going_on.add(body[name])
            waiting.append(joint.child)
    last = sorted(end for end in ends if body[end] not in going_on)
    if len(last) > 1:
        tree.fail(f"the tree branches; name the flange link: flange = one of {listed(last)}")
    return last[0]


def _link(tree: UrdfTree, key: str, name: str) -> str:
    """``name``, if there is such a link."""
    if name not in tree.links:
        tree.fail(f"{key} = {name!r}: no such link; allowed are {listed(tree.links)}")
    return name


def _text(values: Sequence[float]) -> str:
    """Numbers of an XML attribute, to the last digit."""
    return " ".join(repr(float(value)) for value in values)
